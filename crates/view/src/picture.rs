//! Contacts of a session at one time, as triangles: patches in contact, and force arrows.

use std::collections::BTreeSet;
use std::f32::consts::TAU;

use palpate::core::Clod;
use palpate::core::clod::Node;
use palpate::glam::{DVec3, Vec3};
use palpate::{ContactSnapshot, Pose, Scene, level_color};

/// Number of sides of an arrow.
const SIDES: u32 = 10;
/// Length of an arrow for a full force and thickness of arrows, in radii of the probe.
const FULL_ARROW: f64 = 0.8;
const THICKNESS: f64 = 0.015;
/// Colour of the force arrows.
const PUSH: [u8; 4] = [255, 220, 40, 255];

/// Corner of a triangle in the GPU's layout.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Corner {
    /// Position, m.
    pub position: [f32; 3],
    /// Red, green, blue and opacity.
    pub color: [u8; 4],
}

/// Level of detail in contact, for a legend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelColor {
    /// Index of the scene object; `None` for the probe.
    pub object: Option<usize>,
    /// Level; 0 is the full mesh.
    pub level: u32,
    /// Colour of the level.
    pub color: [u8; 4],
    /// Number of its patches in contact.
    pub patches: usize,
}

/// Triangles in world axes, three corners each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// Patches in contact, in the colour of their level.
    pub patches: Vec<Corner>,
    /// Contact forces on the probe: arrows that end where they act.
    pub arrows: Vec<Corner>,
    /// Levels of the patches.
    pub levels: Vec<LevelColor>,
}

impl Picture {
    /// Returns the picture of a snapshot with the probe's mesh frame at a pose. A force of `full` (N) has an
    /// arrow nearly as long as the probe's radius.
    pub fn new(sight: &ContactSnapshot, probe: &Clod, pose: &Pose, scene: &Scene, full: f64) -> Self {
        let mut picture = Self::default();
        let touching: BTreeSet<(Option<usize>, u32)> = sight
            .patches
            .iter()
            .flat_map(|pair| [(None, pair.probe_node), (Some(pair.object), pair.scene_node)])
            .collect();
        for (object, node) in touching {
            let (clod, pose) = match object.map(|object| scene.objects().get(object)) {
                None => (probe, pose),
                Some(Some(placed)) => (&*placed.object.clod, &placed.pose),
                Some(None) => continue,
            };
            picture.add_patch(object, clod, node, pose);
        }
        let radius = probe.bounding_radius();
        for push in &sight.forces {
            let length = (push.force.length() / full).min(2.0) * FULL_ARROW * radius;
            let direction = push.force.normalize_or_zero();
            add_arrow(&mut picture.arrows, push.point, direction * length, THICKNESS * radius);
        }
        picture
    }

    fn add_patch(&mut self, object: Option<usize>, clod: &Clod, node: u32, pose: &Pose) {
        let Some(node) = clod.get(node) else { return };
        let color = level_color(clod, node.level);
        match self.levels.iter_mut().find(|known| (known.object, known.level) == (object, node.level)) {
            Some(known) => known.patches += 1,
            None => self.levels.push(LevelColor { object, level: node.level, color, patches: 1 }),
        }
        let hull = clod.hull(&node);
        for corner in clod.patch(&node).iter().flatten() {
            let position = pose.transform_point(hull[corner as usize]).as_vec3().to_array();
            self.patches.push(Corner { position, color });
        }
    }
}

/// Returns the full mesh of a hierarchy, in its own frame.
pub fn mesh_corners(clod: &Clod) -> Vec<Corner> {
    let of_leaf = |node: Node| {
        let hull = clod.hull(&node);
        clod.patch(&node).iter().flatten().map(move |corner| hull[corner as usize])
    };
    let corners = clod.leaves().iter().flat_map(of_leaf);
    corners.map(|place| Corner { position: place.as_vec3().to_array(), color: [255; 4] }).collect()
}

/// Adds an arrow along a vector that ends at a point.
fn add_arrow(corners: &mut Vec<Corner>, end: DVec3, vector: DVec3, thickness: f64) {
    let (end, vector, thickness) = (end.as_vec3(), vector.as_vec3(), thickness as f32);
    let (direction, length) = (vector.normalize_or(Vec3::Z), vector.length());
    let head = (3.0 * thickness).min(length.max(thickness));
    let (across, other) = direction.any_orthonormal_pair();
    let rim = |side: u32, radius: f32| {
        let (sin, cos) = (side as f32 * TAU / SIDES as f32).sin_cos();
        (across * cos + other * sin) * radius
    };
    let neck = end - direction * head;
    let start = end - direction * length.max(head);
    for side in 0..SIDES {
        let (wide, next) = (rim(side, thickness), rim(side + 1, thickness));
        let (thin, after) = (wide * 0.4, next * 0.4);
        let triangles = [
            [end, neck + wide, neck + next],
            [neck, neck + next, neck + wide],
            [neck + thin, start + thin, start + after],
            [neck + thin, start + after, neck + after],
            [start, start + after, start + thin],
        ];
        let places = triangles.as_flattened().iter();
        corners.extend(places.map(|place| Corner { position: place.to_array(), color: PUSH }));
    }
}

#[cfg(test)]
mod tests {
    use palpate::{ContactForce, Object, TouchingPatches};

    use super::*;

    #[test]
    fn patches_are_coloured_by_level_and_arrows_end_where_they_push() {
        let probe = Object::model("ellipsoid@500").unwrap();
        let torus = Object::model("torus@2000").unwrap();
        let place = Pose::from_translation(DVec3::X);
        let scene = Scene::new().with(torus.clone(), place);
        let coarse = torus.clod.levels.iter().rposition(|level| !level.free).unwrap();
        let nodes = [torus.clod.levels[0].nodes.start, torus.clod.levels[coarse].nodes.start];
        let pair = |scene_node| TouchingPatches { object: 0, probe_node: 0, scene_node, weight: 1.0 };
        let push = ContactForce { point: DVec3::Y, normal: -DVec3::Z, force: DVec3::Z * 2.0, depth: 1e-3 };
        let sight = ContactSnapshot {
            time: 1.0,
            // Nodes that do not exist are left out.
            patches: vec![
                pair(nodes[0]),
                pair(nodes[1]),
                pair(nodes[0]),
                TouchingPatches { object: 9, ..pair(0) },
            ],
            forces: vec![push],
        };
        let picture = Picture::new(&sight, &probe.clod, &Pose::IDENTITY, &scene, 2.0);

        let expected =
            3 * nodes.iter().map(|node| torus.clod.patch(torus.clod.node(*node)).len()).sum::<usize>();
        let of_probe = 3 * probe.clod.patch(probe.clod.node(0)).len();
        assert_eq!(picture.patches.len(), expected + of_probe);
        let red = picture.patches.iter().filter(|corner| corner.color == [255, 0, 0, 255]);
        assert!(
            red.clone().count() >= 3 && picture.patches.iter().any(|corner| corner.color == [0, 0, 255, 255])
        );
        assert!(picture.patches.iter().filter(|corner| corner.position[0] > 0.5).count() == expected);
        let legend: Vec<_> =
            picture.levels.iter().map(|level| (level.object, level.level, level.patches)).collect();
        assert!(
            legend.contains(&(Some(0), 0, 1)) && legend.contains(&(Some(0), coarse as u32, 1)),
            "{legend:?}"
        );

        let heights = picture.arrows.iter().map(|corner| corner.position[2]);
        let (low, high) = heights.fold((f32::MAX, f32::MIN), |(low, high), z| (low.min(z), high.max(z)));
        let length = FULL_ARROW * probe.bounding_radius();
        assert!(high.abs() < 1e-6 && (f64::from(low) + length).abs() < 1e-6, "{low} {high}");
    }

    #[test]
    fn a_mesh_is_all_of_its_triangles() {
        let torus = Object::model("torus@2000").unwrap();
        assert_eq!(mesh_corners(&torus.clod).len(), 3 * torus.clod.source.triangles as usize);
    }
}
