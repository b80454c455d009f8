//! Places where two convex patches may touch first when they move: the corners of each that are near the
//! other, and the crossings of their edges.
//!
//! A query has one contact for each pair of patches. Patches that lie flat on each other, or nearly so, touch
//! at any of these places after a small turn.

use palpate_core::glam::DVec3;
use palpate_core::{Clod, Contact, Pose};

/// Smallest cosine of the angle between faces that are one: their edge is no feature.
const FLAT: f64 = 1.0 - 1e-9;

/// Edges of triangles of a patch that there is room for from the start.
const RESERVED: usize = 1024;

/// The workspace.
#[derive(Debug, Default)]
pub(super) struct PatchStarts {
    probe: Side,
    scene: Side,
}

/// Edges of a patch near the other one, world, m.
#[derive(Debug, Default)]
struct Side {
    edges: Vec<[DVec3; 2]>,
    /// Edges of triangles by their corners, with the triangles' normals.
    sides: Vec<([u32; 2], DVec3)>,
    low: DVec3,
    high: DVec3,
}

impl PatchStarts {
    /// A workspace with room for large patches.
    pub fn new() -> Self {
        Self { probe: Side::reserved(), scene: Side::reserved() }
    }

    /// Passes on the places of a contact's patches, nodes of hierarchies at poses, that are within about
    /// `reach` (m) of each other: positions (m, world), whether on the probe, distances (m), and along which
    /// edge if edges cross there: each of the two. Where edges that cross overlap, the nearest surface from
    /// one of them may be a face that the other does not meet, as the wall under a rim.
    pub fn find(
        &mut self,
        (probe, probe_node, probe_pose): (&Clod, u32, &Pose),
        (scene, scene_node, scene_pose): (&Clod, u32, &Pose),
        contact: &Contact,
        reach: f64,
        mut to: impl FnMut(DVec3, bool, f64, Option<DVec3>),
    ) {
        let Contact { point, scene_point, normal, .. } = *contact;
        let under_probe = |v: DVec3| normal.dot(scene_point - v);
        let over_scene = |v: DVec3| normal.dot(v - point);
        self.probe.collect((probe, probe_node, probe_pose), reach, under_probe);
        self.scene.collect((scene, scene_node, scene_pose), reach, over_scene);
        let Self { probe, scene } = self;
        for (own, other, is_probe) in [(&*probe, &*scene, true), (&*scene, &*probe, false)] {
            for v in own.edges.as_flattened() {
                let distance = if is_probe { under_probe(*v) } else { over_scene(*v) };
                if distance <= reach && other.is_near(*v, *v, reach) {
                    to(*v, is_probe, distance, None);
                }
            }
        }
        for own in probe.edges.iter().filter(|[a, b]| scene.is_near(a.min(*b), a.max(*b), reach)) {
            for other in &scene.edges {
                // Edges that do not cross yet may do so after a small motion.
                let (places, distance) = crossing(own, other);
                if distance <= reach {
                    to(places[0], true, distance, Some(own[1] - own[0]));
                    to(places[1], false, distance, Some(other[1] - other[0]));
                }
            }
        }
    }
}

impl Side {
    fn reserved() -> Self {
        Self { edges: Vec::with_capacity(RESERVED), sides: Vec::with_capacity(RESERVED), ..Self::default() }
    }

    /// Collects the edges of a patch with an end at a height up to `reach` (m).
    fn collect(
        &mut self,
        (clod, node, pose): (&Clod, u32, &Pose),
        reach: f64,
        height: impl Fn(DVec3) -> f64,
    ) {
        let Self { edges, sides, low, high } = self;
        edges.clear();
        sides.clear();
        (*low, *high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let node = clod.node(node);
        let hull = clod.hull(&node);
        let at = |corner: u32| pose.transform_point(hull[corner as usize]);
        for triangle in clod.patch(&node).iter() {
            let corners = triangle.map(u32::from);
            let [a, b, c] = corners.map(at);
            if height(a).min(height(b)).min(height(c)) > reach {
                continue;
            }
            let normal = (b - a).cross(c - a).normalize_or_zero();
            for i in 0..3 {
                let (from, to) = (corners[i], corners[(i + 1) % 3]);
                sides.push(([from.min(to), from.max(to)], normal));
            }
        }
        sides.sort_unstable_by_key(|side| side.0);
        for same in sides.chunk_by(|a, b| a.0 == b.0) {
            let is_flat = same.len() == 2 && same[0].1.dot(same[1].1) > FLAT;
            let [from, to] = same[0].0.map(at);
            if !is_flat && height(from).min(height(to)) <= reach {
                edges.push([from, to]);
                (*low, *high) = (low.min(from).min(to), high.max(from).max(to));
            }
        }
    }

    /// Whether a box is within `reach` (m) of the box around the edges.
    fn is_near(&self, low: DVec3, high: DVec3, reach: f64) -> bool {
        (low - reach).cmple(self.high).all() && (high + reach).cmpge(self.low).all()
    }
}

/// The points of two edges nearest to each other, and their distance, m (Ericson 2005, §5.1.9).
fn crossing([a, b]: &[DVec3; 2], [c, d]: &[DVec3; 2]) -> ([DVec3; 2], f64) {
    let (u, v, w) = (b - a, d - c, a - c);
    let (uu, uv, vv) = (u.dot(u), u.dot(v), v.dot(v));
    let (uw, vw) = (u.dot(w), v.dot(w));
    let share = |above: f64, below: f64| if below > 0.0 { (above / below).clamp(0.0, 1.0) } else { 0.0 };
    let s = share(uv * vw - vv * uw, uu * vv - uv * uv);
    let t = share(uv * s + vw, vv);
    let s = share(uv * t - uw, uu);
    let places = [a + u * s, c + v * t];
    (places, places[0].distance(places[1]))
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    #[test]
    fn crossings_against_a_grid() {
        let mut rng = StdRng::seed_from_u64(0xC055);
        for round in 0..300 {
            let mut random = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let (first, second) = ([random(), random()], [random(), random()]);
            let (places, found) = crossing(&first, &second);
            let n = 200;
            let at = |edge: &[DVec3; 2], i: u32| edge[0].lerp(edge[1], f64::from(i) / f64::from(n));
            let all = (0..=n).flat_map(|i| (0..=n).map(move |j| (i, j)));
            let least =
                all.map(|(i, j)| at(&first, i).distance(at(&second, j))).fold(f64::INFINITY, f64::min);
            assert!(found < least + 1e-12 && found > least - 0.02, "round {round}: {found}, {least}");
            for (place, edge) in places.into_iter().zip([first, second]) {
                let along = (place - edge[0]).cross(edge[1] - edge[0]).length();
                assert!(along < 1e-12, "round {round}: {place} is off the edge");
            }
        }
        // Parallel edges, and an edge without a length.
        let along = [DVec3::ZERO, DVec3::X];
        assert_eq!(crossing(&along, &[DVec3::new(0.5, 2.0, 0.0), DVec3::new(3.0, 2.0, 0.0)]).1, 2.0);
        assert_eq!(crossing(&along, &[DVec3::new(0.5, 2.0, 0.0); 2]).1, 2.0);
        assert_eq!(crossing(&[DVec3::Y; 2], &along).1, 1.0);
    }
}
