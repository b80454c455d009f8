//! Repair: drops triangles that bound nothing, and turns the rest to agree with each other and face outwards.
//!
//! In this order: triangles with a coordinate that is not finite, degenerate ones (decided exactly) and duplicates are dropped;
//! then each component (triangles connected across edges that exactly two share) is oriented by flooding, the orientation
//! of the majority of its triangles winning; then closed components are turned to face outwards.
//!
//! Outwards means a positive enclosed volume, except for cavities. If all closed components together enclose a negative
//! volume, the file is taken to be inside out and all are turned. A component that is then still negative is
//! a cavity, and left as it is, if it lies inside one that is positive; otherwise it is turned. Whether it lies
//! inside is decided by the winding number (Van Oosterom and Strackee 1983) of the other about one of its vertices.
//!
//! Holes are not filled, crossings not resolved and no vertex is moved.

use std::collections::{HashMap, HashSet};

use glam::DVec3;
use palpate_core::TriMesh;
use serde::Serialize;

use crate::intersect::{collinear, normalise};
use crate::weld;

/// What [`repair`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RepairSummary {
    /// Triangles dropped because a corner is infinite or not a number.
    pub nonfinite_triangles: usize,
    /// Triangles dropped because two corners are the same vertex, or all three lie on a line (zero area, decided exactly).
    pub degenerate_triangles: usize,
    /// Triangles dropped because an earlier one has the same three vertices, in either orientation.
    pub duplicate_triangles: usize,
    /// Triangles turned over, to agree with their neighbours or to face outwards.
    pub flipped_triangles: usize,
    /// Closed components that were turned as a whole to face outwards.
    pub inverted_components: usize,
    /// Components without a consistent orientation (like a Möbius strip): some edges stay misoriented.
    pub nonorientable_components: usize,
    /// Vertices dropped because no triangle uses them (any more).
    pub unreferenced_vertices: usize,
}

/// Solid angles evaluated in the search for cavities before the rest are taken for separate bodies: a few seconds' worth.
const MAX_SOLID_ANGLES: usize = 1 << 26;

/// Repairs a mesh: see the summary's fields for what is done, in that order. Vertices are taken as the same only if their
/// indices are: [`weld`](crate::weld()) first. The triangles that are kept stay in order.
pub fn repair(mesh: &TriMesh) -> (TriMesh, RepairSummary) {
    let mut summary = RepairSummary::default();
    let mut scaled = mesh.vertices().to_vec();
    normalise(&mut scaled);
    let mut seen = HashSet::new();
    let mut triangles = Vec::with_capacity(mesh.triangles().len());
    for &triangle in mesh.triangles() {
        let [a, b, c] = triangle.map(|v| scaled[v as usize]);
        let mut key = triangle;
        key.sort_unstable();
        if !(a.is_finite() && b.is_finite() && c.is_finite()) {
            summary.nonfinite_triangles += 1;
        } else if key[0] == key[1] || key[1] == key[2] || collinear(a, b, c) {
            summary.degenerate_triangles += 1;
        } else if !seen.insert(key) {
            summary.duplicate_triangles += 1;
        } else {
            triangles.push(triangle);
        }
    }
    let mesh = with_triangles(mesh, triangles);
    let mut components = Components::new(&mesh);
    summary.nonorientable_components = components.nonorientable.iter().filter(|&&n| n).count();
    summary.inverted_components = components.face_outwards(&mesh);
    summary.flipped_triangles = components.flipped.iter().filter(|&&f| f).count();
    let turned = mesh.triangles().iter().zip(&components.flipped);
    let oriented = turned.map(|(&[a, b, c], &flip)| if flip { [a, c, b] } else { [a, b, c] }).collect();
    let repaired = weld::drop_unreferenced(&with_triangles(&mesh, oriented));
    summary.unreferenced_vertices = mesh.vertices().len() - repaired.vertices().len();
    (repaired, summary)
}

fn with_triangles(mesh: &TriMesh, triangles: Vec<[u32; 3]>) -> TriMesh {
    TriMesh::new(mesh.vertices().to_vec(), triangles)
        .expect("a selection of a valid mesh's triangles is valid")
}

/// The components of a mesh, each with an orientation of its own.
struct Components {
    /// The triangles of each component.
    members: Vec<Vec<u32>>,
    /// Whether each triangle is to be turned over.
    flipped: Vec<bool>,
    nonorientable: Vec<bool>,
    /// Whether the boundary of each component is empty, so that it encloses a volume.
    closed: Vec<bool>,
}

impl Components {
    fn new(mesh: &TriMesh) -> Self {
        let adjacency = mesh.adjacency();
        let count = mesh.triangles().len();
        let mut component = vec![usize::MAX; count];
        let mut flipped = vec![false; count];
        let (mut members, mut nonorientable) = (Vec::new(), Vec::new());
        for seed in 0..count {
            if component[seed] != usize::MAX {
                continue;
            }
            let number = members.len();
            component[seed] = number;
            let mut reached = vec![seed as u32];
            let mut contradiction = false;
            let mut next = 0;
            while next < reached.len() {
                let triangle = reached[next];
                next += 1;
                let corners = mesh.triangles()[triangle as usize];
                for side in 0..3 {
                    let Some(other) = adjacency.neighbour(triangle, side as u32) else { continue };
                    let edge = [corners[side], corners[(side + 1) % 3]];
                    // Neighbours agree if they run along their edge in opposite directions.
                    let disagree = has_side(mesh.triangles()[other as usize], edge);
                    let flip = flipped[triangle as usize] ^ disagree;
                    if component[other as usize] == usize::MAX {
                        component[other as usize] = number;
                        flipped[other as usize] = flip;
                        reached.push(other);
                    } else {
                        contradiction |= flipped[other as usize] != flip;
                    }
                }
            }
            let turned = reached.iter().filter(|&&t| flipped[t as usize]).count();
            if 2 * turned > reached.len() {
                reached.iter().for_each(|&t| flipped[t as usize] ^= true);
            }
            members.push(reached);
            nonorientable.push(contradiction);
        }
        // Where an edge is not shared by two triangles, the component may still be closed: its sides there must cancel.
        let mut sides: HashMap<(usize, [u32; 2]), i64> = HashMap::new();
        for (t, corners) in mesh.triangles().iter().enumerate() {
            for side in 0..3 {
                if adjacency.neighbour(t as u32, side as u32).is_none() {
                    let [a, b] = [corners[side], corners[(side + 1) % 3]];
                    let direction = if (a < b) ^ flipped[t] { 1 } else { -1 };
                    *sides.entry((component[t], [a.min(b), a.max(b)])).or_default() += direction;
                }
            }
        }
        let mut closed: Vec<bool> = nonorientable.iter().map(|n| !n).collect();
        for ((component, _), sum) in sides {
            closed[component] &= sum == 0;
        }
        Self { members, flipped, nonorientable, closed }
    }

    /// Turns closed components to face outwards, cavities inwards. Returns how many were turned.
    fn face_outwards(&mut self, mesh: &TriMesh) -> usize {
        let mut volumes: Vec<f64> = (0..self.members.len()).map(|c| self.volume(mesh, c)).collect();
        let mut turned = vec![false; volumes.len()];
        if volumes.iter().sum::<f64>() < 0.0 {
            for (c, volume) in volumes.iter_mut().enumerate() {
                turned[c] = self.closed[c];
                *volume = -*volume;
            }
        }
        for c in (0..volumes.len()).filter(|&c| turned[c]) {
            self.turn(c);
        }
        let boxes: Vec<[DVec3; 2]> = self.members.iter().map(|members| bounds(mesh, members)).collect();
        let outer: Vec<usize> = (0..volumes.len()).filter(|&c| volumes[c] > 0.0).collect();
        let mut work = 0;
        for c in 0..volumes.len() {
            if volumes[c] >= 0.0 {
                continue;
            }
            let point = mesh.corners(self.members[c][0] as usize)[0];
            let mut inside = false;
            for &o in &outer {
                let encloses = boxes[o][0].cmplt(boxes[c][0]).all() && boxes[c][1].cmplt(boxes[o][1]).all();
                work += 1;
                if encloses && work + self.members[o].len() <= MAX_SOLID_ANGLES {
                    work += self.members[o].len();
                    inside |= self.winding_number(mesh, o, point) > 0.5;
                }
                if inside || work > MAX_SOLID_ANGLES {
                    break;
                }
            }
            if !inside {
                self.turn(c);
                turned[c] ^= true;
            }
        }
        turned.iter().filter(|&&t| t).count()
    }

    fn turn(&mut self, component: usize) {
        self.members[component].iter().for_each(|&t| self.flipped[t as usize] ^= true);
    }

    fn corners(&self, mesh: &TriMesh, triangle: u32) -> [DVec3; 3] {
        let [a, b, c] = mesh.corners(triangle as usize);
        if self.flipped[triangle as usize] { [a, c, b] } else { [a, b, c] }
    }

    /// The volume (m³) that a component encloses, negative if it is inside out; 0 if it is not closed.
    fn volume(&self, mesh: &TriMesh, component: usize) -> f64 {
        if !self.closed[component] {
            return 0.0;
        }
        // About a point of its own, so that a small component far from the origin keeps its digits.
        let origin = mesh.corners(self.members[component][0] as usize)[0];
        let six_fold = self.members[component].iter().map(|&t| {
            let [a, b, c] = self.corners(mesh, t).map(|p| p - origin);
            a.dot(b.cross(c))
        });
        six_fold.sum::<f64>() / 6.0
    }

    /// How often a component winds around a point: 1 inside a body that faces outwards, 0 outside.
    fn winding_number(&self, mesh: &TriMesh, component: usize, point: DVec3) -> f64 {
        let angles = self.members[component].iter().map(|&t| {
            let [a, b, c] = self.corners(mesh, t).map(|p| p - point);
            let (la, lb, lc) = (a.length(), b.length(), c.length());
            let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
            2.0 * a.dot(b.cross(c)).atan2(below)
        });
        angles.sum::<f64>() / (4.0 * std::f64::consts::PI)
    }
}

/// Whether a triangle runs along an edge in the given direction.
fn has_side(corners: [u32; 3], edge: [u32; 2]) -> bool {
    (0..3).any(|side| [corners[side], corners[(side + 1) % 3]] == edge)
}

fn bounds(mesh: &TriMesh, members: &[u32]) -> [DVec3; 2] {
    members
        .iter()
        .flat_map(|&t| mesh.corners(t as usize))
        .fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], p| [low.min(p), high.max(p)])
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    const QUADS: [[u32; 4]; 6] =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];

    /// Adds a cube to a mesh's lists, facing outwards.
    fn cube(
        vertices: &mut Vec<DVec3>,
        triangles: &mut Vec<[u32; 3]>,
        center: DVec3,
        half: f64,
        inwards: bool,
    ) {
        let first = vertices.len() as u32;
        let sign = |i: u32, bit: u32| if i >> bit & 1 == 1 { half } else { -half };
        vertices.extend((0..8).map(|i| center + DVec3::new(sign(i, 0), sign(i, 1), sign(i, 2))));
        for [a, b, c, d] in QUADS.map(|q| q.map(|v| first + v)) {
            triangles.extend(if inwards { [[a, c, b], [a, d, c]] } else { [[a, b, c], [a, c, d]] });
        }
    }

    fn cubes(list: &[(f64, f64, bool)]) -> TriMesh {
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for &(x, half, inwards) in list {
            cube(&mut vertices, &mut triangles, DVec3::X * x, half, inwards);
        }
        TriMesh::new(vertices, triangles).unwrap()
    }

    fn volume(mesh: &TriMesh) -> f64 {
        (0..mesh.triangles().len()).map(|t| mesh.corners(t)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    #[test]
    fn counts_what_it_drops() {
        let mesh = cubes(&[(0.0, 1.0, false)]);
        let mut vertices = mesh.vertices().to_vec();
        vertices.extend([DVec3::NAN, DVec3::new(0.0, -1.0, -1.0), DVec3::splat(9.0)]);
        let mut triangles = mesh.triangles().to_vec();
        // Not finite; two corners the same; three on a line; a copy, and one turned over.
        triangles.extend([[0, 1, 8], [3, 3, 4], [0, 1, 9], [2, 3, 0], [3, 2, 0]]);
        let (repaired, summary) = repair(&TriMesh::new(vertices, triangles).unwrap());
        let expected = RepairSummary {
            nonfinite_triangles: 1,
            degenerate_triangles: 2,
            duplicate_triangles: 2,
            unreferenced_vertices: 3,
            ..RepairSummary::default()
        };
        assert_eq!(summary, expected);
        assert_eq!(repaired, mesh);
    }

    #[test]
    fn any_turning_of_triangles_is_undone() {
        let seed = 29;
        let mut random = StdRng::seed_from_u64(seed);
        let mesh = cubes(&[(0.0, 1.0, false), (5.0, 2.0, false)]);
        for case in 0..200 {
            let turned =
                mesh.triangles().iter().map(|&[a, b, c]| if random.random() { [a, c, b] } else { [a, b, c] });
            let (repaired, summary) = repair(&with_triangles(&mesh, turned.collect()));
            assert_eq!(summary.nonorientable_components, 0);
            let bounds = repaired
                .adjacency()
                .edge_kinds()
                .iter()
                .all(|k| *k == palpate_core::mesh::EdgeKind::Manifold);
            assert!(bounds, "seed {seed}, case {case}: some edge is misoriented");
            assert!((volume(&repaired) - 72.0).abs() < 1e-9, "seed {seed}, case {case}");
        }
    }

    #[test]
    fn cavities_stay_and_bodies_face_outwards() {
        for (name, shells, expected, inverted) in [
            ("inside out", vec![(0.0, 1.0, true)], 8.0, 1),
            ("hollow", vec![(0.0, 2.0, false), (0.0, 1.0, true)], 56.0, 0),
            ("hollow, inside out", vec![(0.0, 2.0, true), (0.0, 1.0, false)], 56.0, 2),
            ("two bodies, one inside out", vec![(0.0, 2.0, false), (9.0, 1.0, true)], 72.0, 1),
            (
                "a body in a cavity",
                vec![(0.0, 3.0, false), (0.0, 2.0, true), (0.0, 1.0, false)],
                216.0 - 64.0 + 8.0,
                0,
            ),
            ("overlapping, not inside", vec![(0.0, 2.0, false), (2.0, 1.0, true)], 72.0, 1),
        ] {
            let (repaired, summary) = repair(&cubes(&shells));
            assert!((volume(&repaired) - expected).abs() < 1e-9, "{name}: {}", volume(&repaired));
            assert_eq!(summary.inverted_components, inverted, "{name}");
        }
    }

    #[test]
    fn a_moebius_strip_is_named() {
        // Five triangles in a ring: a strip with an odd number of half turns.
        let vertices =
            (0..5).map(|i| DVec3::new(f64::from(i), f64::from(i * i), f64::from(i * i * i))).collect();
        let strip = TriMesh::new(vertices, (0..5).map(|i| [i, (i + 1) % 5, (i + 2) % 5]).collect()).unwrap();
        let (repaired, summary) = repair(&strip);
        assert_eq!(summary.nonorientable_components, 1);
        assert_eq!(repaired.triangles().len(), 5);
        assert_eq!(repair(&TriMesh::default()), (TriMesh::default(), RepairSummary::default()));
    }
}
