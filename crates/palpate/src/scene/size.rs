//! Refuses objects whose size suggests that their file is in another unit: what is felt of them is of no use, and surprises.
//!
//! A mesh of a few centimetres that was read with its millimetres as metres has a millionfold moment of inertia, and its centre
//! of mass is tens of metres from the handle: at the least turn of it the coupling pulls with all that the device has.

use std::ops::RangeInclusive;

use palpate_mesh_io::LoadWarning;

use crate::scene::Placed;
use crate::scene::object::Object;
use crate::settings::Settings;

/// Bounding radii of objects in the hand, and of those to be felt with them, m: the largest object of a scene may be a building.
const IN_HAND: RangeInclusive<f64> = 1e-3..=2.0;
const IN_SCENE: RangeInclusive<f64> = 5e-4..=20.0;

/// An object's size suggests that it was read in another unit than its file is in.
///
/// That is a bounding radius below 1 mm or above 2 m in the hand, or below 0.5 mm or above 20 m in the scene, both in the world and, by the
/// [workspace scale](crate::settings::DeviceSettings::workspace_scale), at the device.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{name}: the bounding radius of {radius:.3e} m suggests a wrong unit; {}, or set Settings::unusual_size to feel it as it is",
    remedy(*.suggested)
)]
pub struct UnitsError {
    /// The object's name.
    pub name: String,
    /// Its bounding radius, m.
    pub radius: f64,
    /// A factor on its lengths that would give it a usual size, if one of the usual units does.
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
/// With the object.
pub(crate) fn check_sizes<'a>(
    probes: impl IntoIterator<Item = &'a Object>,
    scene: &[Placed],
    settings: &Settings,
) -> Result<(), UnitsError> {
    if settings.tool.unusual_size {
        return Ok(());
    }
    let in_hand = probes.into_iter().map(|object| (object, IN_HAND));
    let in_scene = scene.iter().map(|Placed { object, .. }| (object, IN_SCENE));
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

    /// A tetrahedron of a bounding radius, m.
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
        for said in ["7.770e1 m", "OpenOptions::scale by 0.001", "Settings::unusual_size"] {
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
    fn objects_of_the_scene_may_be_larger() {
        assert_eq!(check(0.05, 15.0, Settings::default()), Ok(()));
        assert!(check(15.0, 15.0, Settings::default()).is_err());
        assert!(check(0.05, 50.0, Settings::default()).is_err());
        assert!(check(0.05, 1e-5, Settings::default()).is_err());
    }

    /// What is of a usual size at the device is meant so, and what is of a usual size in the world is not scaled away.
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
