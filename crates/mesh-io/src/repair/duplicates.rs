//! Removal of triangles at the same positions as an earlier one.
//!
//! Where two solids share a face that is cut in the same way, its triangles are there twice, facing each
//! other. Both go if there is material on both sides; else one stays. After a union, whose pieces are there
//! once, such pairs are gaps or walls thinner than rounding, and both go, so that the surface around them
//! stays closed.

use std::collections::HashMap;

use super::orientation::winding_number;
use super::{Work, root};
use crate::weld::equal_positions;

/// Winding number above which a face is inside a solid. About a closed surface it is whole; cracks and
/// rounding change it by less.
const INSIDE: f64 = 0.999;

/// Largest number of solid angles that are evaluated to decide which faces are inside, about a second's
/// worth.
const MAX_SOLID_ANGLES: usize = 1 << 25;

impl Work {
    pub(super) fn drop_duplicates(&mut self) {
        let same = equal_positions(&self.points);
        // The pieces at the same positions, in order of the first.
        let mut number: HashMap<[u32; 3], usize> = HashMap::new();
        let mut stacks: Vec<Vec<u32>> = Vec::new();
        let mut keep = vec![true; self.pieces.len()];
        let mut any = false;
        for (i, piece) in (0u32..).zip(&self.pieces) {
            let mut key = piece.corners.map(|v| same[v as usize]);
            key.sort_unstable();
            if key[0] == key[1] || key[1] == key[2] {
                continue;
            }
            let stack = *number.entry(key).or_insert_with(|| {
                stacks.push(Vec::new());
                stacks.len() - 1
            });
            keep[i as usize] = stacks[stack].is_empty();
            any |= !stacks[stack].is_empty();
            stacks[stack].push(i);
        }
        if !any {
            return;
        }
        let hidden = self.shared_faces(&same, &stacks);
        hidden.iter().for_each(|i| keep[*i as usize] = false);
        self.summary.hidden_triangles += hidden.len();
        self.summary.duplicate_triangles += self.retain(|i| keep[i]) - hidden.len();
    }

    /// The first of two pieces that face each other inside a solid.
    fn shared_faces(&self, same: &[u32], stacks: &[Vec<u32>]) -> Vec<u32> {
        let ids = |i: u32| self.pieces[i as usize].corners.map(|v| same[v as usize]);
        let even = |i: u32| {
            let [a, b, c] = ids(i);
            (a < b) ^ (b < c) ^ (c < a)
        };
        let pairs: Vec<[u32; 2]> = (stacks.iter())
            .filter_map(|stack| match stack[..] {
                [a, b] if even(a) != even(b) => Some([a, b]),
                _ => None,
            })
            .collect();
        if self.united {
            return pairs.iter().map(|[first, _]| *first).collect();
        }
        // Pairs connected across edges are one face: a point on one of them decides.
        let mut face: Vec<u32> = (0..pairs.len() as u32).collect();
        let mut at_edge: HashMap<[u32; 2], u32> = HashMap::new();
        for (p, [first, _]) in (0u32..).zip(&pairs) {
            let [a, b, c] = ids(*first);
            for [u, v] in [[a, b], [b, c], [c, a]] {
                let other = *at_edge.entry([u.min(v), u.max(v)]).or_insert(p);
                let (x, y) = (root(&mut face, p), root(&mut face, other));
                face[x.max(y) as usize] = x.min(y);
            }
        }
        let mut left = MAX_SOLID_ANGLES;
        let mut inside: HashMap<u32, bool> = HashMap::new();
        let mut hidden = Vec::new();
        for (p, [first, second]) in (0u32..).zip(&pairs) {
            let face = root(&mut face, p);
            let decided = *inside.entry(face).or_insert_with(|| {
                if left < self.pieces.len() {
                    return false;
                }
                left -= self.pieces.len();
                let corners = |i: usize| self.positions(self.pieces[i].corners);
                let [a, b, c] = corners(*first as usize);
                let others = (0..self.pieces.len()).filter(|i| ![*first, *second].contains(&(*i as u32)));
                winding_number(others.map(corners), (a + b + c) / 3.0).abs() > INSIDE
            });
            if decided {
                hidden.push(*first);
            }
        }
        hidden
    }
}
