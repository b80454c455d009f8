//! Check of object sizes: an object whose size suggests that its file is in another unit is refused.
//!
//! A mesh of a few centimetres whose millimetres were read as metres has a moment of inertia that is too
//! large by a factor of 10⁶, and its centre of mass is tens of metres from the handle: at the slightest
//! rotation the coupling pulls with the device's peak force.

use std::ops::RangeInclusive;

use palpate_mesh_io::LoadWarning;

use crate::scene::Placed;
use crate::scene::object::Object;
use crate::settings::Settings;

/// Usual bounding radii of objects in the hand, m. Objects outside the range are refused.
const USUAL_IN_HAND: RangeInclusive<f64> = 1e-3..=2.0;
/// Usual bounding radii of scene objects, m; the largest may be a building. Objects outside the range are
/// refused.
const USUAL_IN_SCENE: RangeInclusive<f64> = 5e-4..=20.0;

/// The size of an object suggests that it was read in a wrong unit.
///
/// Its bounding radius is below 1 mm or above 2 m in the hand, or below 0.5 mm or above 20 m in the scene,
/// both in the world and, by the [workspace scale](crate::settings::DeviceSettings::workspace_scale), at the
/// device.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{name}: the bounding radius of {radius:.3e} m suggests a wrong unit; {}, or set ToolSettings::unusual_size to accept it",
    remedy(*.suggested)
)]
pub struct UnitsError {
    /// Name of the object.
    pub name: String,
    /// Bounding radius of the object, m.
    pub radius: f64,
    /// Factor on the object's lengths that would give it a usual size, if one of the usual units does.
    pub suggested: Option<f64>,
}

fn remedy(suggested: Option<f64>) -> String {
    match suggested {
        Some(factor) => format!("multiply OpenOptions::scale by {factor}"),
        None => "set OpenOptions::scale to the metres per unit of its file".to_owned(),
    }
}

/// Refuses the first object whose size suggests a wrong unit, unless the settings allow it.
///
/// # Errors
/// Names that object.
pub(crate) fn check_sizes<'a>(
    probes: impl IntoIterator<Item = &'a Object>,
    scene: &[Placed],
    settings: &Settings,
) -> Result<(), UnitsError> {
    if settings.tool.unusual_size {
        return Ok(());
    }
    let in_hand = probes.into_iter().map(|object| (object, USUAL_IN_HAND));
    let in_scene = scene.iter().map(|Placed { object, .. }| (object, USUAL_IN_SCENE));
    for (object, usual) in in_hand.chain(in_scene) {
        let radius = object.bounding_radius();
        if ![radius, radius / settings.device.workspace_scale].iter().any(|radius| usual.contains(radius)) {
            let suggested = match LoadWarning::of_size(radius) {
                Some(LoadWarning::Units { suggested, .. }) => suggested,
                _ => None,
            };
            return Err(UnitsError { name: object.name.clone(), radius, suggested });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DVec3;
    use palpate_core::{Pose, TriMesh};

    use super::*;
    use crate::settings::{DeviceSettings, ToolSettings};

    /// Tetrahedron with a bounding radius (m).
    fn object(radius: f64) -> Object {
        let corners = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
        let corners = corners.map(|corner| DVec3::from(corner) / 3.0_f64.sqrt() * radius);
        let mesh = TriMesh::new(corners.into(), vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]);
        Object::from_mesh("tetrahedron", &mesh.expect("indices")).expect("a hierarchy")
    }

    fn check(probe: f64, scene: f64, settings: Settings) -> Result<(), UnitsError> {
        let placed = Placed { object: object(scene), pose: Pose::IDENTITY };
        check_sizes([&object(probe)], &[placed], &settings)
    }

    #[test]
    fn a_probe_in_millimetres_is_refused_with_the_factor() {
        let refused = check(77.7, 0.05, Settings::default()).expect_err("77.7 m in the hand");
        assert_eq!((refused.name.as_str(), refused.suggested), ("tetrahedron", Some(1e-3)));
        assert!((refused.radius - 77.7).abs() < 1e-9);
        let text = refused.to_string();
        for said in ["7.770e1 m", "OpenOptions::scale by 0.001", "ToolSettings::unusual_size"] {
            assert!(text.contains(said), "{text}");
        }
        let insisted = Settings {
            tool: ToolSettings { unusual_size: true, ..ToolSettings::default() },
            ..Settings::default()
        };
        assert_eq!(check(77.7, 0.05, insisted), Ok(()));
        assert_eq!(check(0.0777, 0.05, Settings::default()), Ok(()));
        for (radius, usual) in [(1e-5, false), (9e-4, false), (1.1e-3, true), (1.9, true), (2.1, false)] {
            assert_eq!(check(radius, 0.05, Settings::default()).is_ok(), usual, "{radius} m");
        }
    }

    #[test]
    fn scene_objects_may_be_larger() {
        assert_eq!(check(0.05, 15.0, Settings::default()), Ok(()));
        assert!(check(15.0, 15.0, Settings::default()).is_err());
        assert!(check(0.05, 50.0, Settings::default()).is_err());
        assert!(check(0.05, 1e-5, Settings::default()).is_err());
    }

    /// A usual size at the device is enough, and so is a usual size in the world.
    #[test]
    fn the_workspace_scale_counts() {
        let scaled = |workspace_scale| Settings {
            device: DeviceSettings { workspace_scale, ..DeviceSettings::default() },
            ..Settings::default()
        };
        assert_eq!(check(77.7, 77.7, scaled(1000.0)), Ok(()));
        assert_eq!(check(1e-5, 1e-5, scaled(1e-3)), Ok(()));
        assert_eq!(check(0.05, 0.05, scaled(1e-3)), Ok(()));
        assert!(check(77.7, 0.05, scaled(2.0)).is_err());
    }
}
