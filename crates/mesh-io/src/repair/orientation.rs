//! Orientation: turns triangles to agree with each other, and closed components to face outwards.
//!
//! Each component (triangles connected across edges that exactly two share) is oriented by flooding, the
//! orientation of the majority of its triangles winning; then closed components are turned to face outwards.
//!
//! Outwards means a positive enclosed volume, except for cavities. If all closed components together enclose
//! a negative volume, the file counts as inside out and all are turned. A component that is then still
//! negative is a cavity, and left as it is, if it lies inside one that is positive; otherwise it is turned.
//! Whether it lies inside is decided by the winding number (Van Oosterom and Strackee 1983) of the other
//! about one of its vertices.

use std::collections::HashMap;

use glam::DVec3;
use palpate_core::TriMesh;

/// Largest number of solid angles evaluated in the search for cavities, a few seconds' worth: then the
/// remaining components count as separate bodies.
const MAX_SOLID_ANGLES: usize = 1 << 26;

/// The components of a mesh, each with an orientation of its own.
pub(super) struct Components {
    /// The triangles of each component.
    members: Vec<Vec<u32>>,
    /// Whether each triangle is to be turned over.
    pub flipped: Vec<bool>,
    pub nonorientable: Vec<bool>,
    /// Whether the boundary of each component is empty, so that it encloses a volume.
    closed: Vec<bool>,
}

impl Components {
    pub fn new(mesh: &TriMesh) -> Self {
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
        // A component may be closed although an edge is not shared by exactly two triangles: its sides there
        // must cancel.
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

    /// The triangles of each component.
    pub fn members(&self) -> &[Vec<u32>] {
        &self.members
    }

    /// Whether a component encloses a volume.
    pub fn is_closed(&self, component: usize) -> bool {
        self.closed[component]
    }

    /// Turns closed components to face outwards, cavities inwards. Returns how many were turned.
    pub fn face_outwards(&mut self, mesh: &TriMesh) -> usize {
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
        // Relative to a point of the component, so that a small one far from the origin keeps its digits.
        let origin = mesh.corners(self.members[component][0] as usize)[0];
        let six_fold = self.members[component].iter().map(|&t| {
            let [a, b, c] = self.corners(mesh, t).map(|p| p - origin);
            a.dot(b.cross(c))
        });
        six_fold.sum::<f64>() / 6.0
    }

    /// Winding number of a component about a point: 1 inside a body that faces outwards, 0 outside.
    fn winding_number(&self, mesh: &TriMesh, component: usize, point: DVec3) -> f64 {
        winding_number(self.members[component].iter().map(|&t| self.corners(mesh, t)), point)
    }
}

/// Winding number of some triangles about a point, as a sum of solid angles.
pub(super) fn winding_number(triangles: impl Iterator<Item = [DVec3; 3]>, point: DVec3) -> f64 {
    let angles = triangles.map(|corners| {
        let [a, b, c] = corners.map(|p| p - point);
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        // tan Ω/2 = a·(b × c) / (|a||b||c| + (a·b)|c| + (b·c)|a| + (c·a)|b|)
        let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        2.0 * a.dot(b.cross(c)).atan2(below)
    });
    angles.sum::<f64>() / (4.0 * std::f64::consts::PI)
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
