//! Points that are chosen in turn, each at a minimum distance from those before, in a hash grid with cells of
//! that size.

use palpate_core::glam::DVec3;

/// Index that stands for no point.
const NONE: u32 = u32::MAX;

/// The chosen pairs of points, each with a label. Only pairs of the same label are compared.
#[derive(Clone, Debug, Default)]
pub(crate) struct Spaced {
    /// Minimum distance, m.
    reach: f64,
    /// For each hash of a cell, the last pair chosen there.
    heads: Vec<u32>,
    chosen: Vec<Chosen>,
}

#[derive(Clone, Copy, Debug)]
struct Chosen {
    points: [DVec3; 2],
    label: u32,
    /// The pair chosen before it with the same hash.
    next: u32,
}

impl Spaced {
    /// Removes all pairs, and prepares for about `count` pairs with a minimum distance `reach` (m, above 0).
    pub fn clear(&mut self, reach: f64, count: usize) {
        self.reach = reach;
        self.chosen.clear();
        self.heads.clear();
        self.heads.resize((2 * count).next_power_of_two().max(64), NONE);
    }

    pub fn capacity(&self) -> usize {
        self.heads.capacity() * size_of::<u32>() + self.chosen.capacity() * size_of::<Chosen>()
    }

    /// Index, in the order of choice, of a chosen pair with this label whose points are both within reach.
    pub fn near(&self, points: [DVec3; 2], label: u32) -> Option<usize> {
        let cell = self.cell(points[0]);
        let offsets = (0..27).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]);
        offsets.map(|offset| [0, 1, 2].map(|axis| cell[axis].saturating_add(offset[axis]))).find_map(|cell| {
            let mut index = self.heads[self.hash(cell)];
            while let Some(chosen) = self.chosen.get(index as usize) {
                let near = |i: usize| chosen.points[i].distance(points[i]) <= self.reach;
                if chosen.label == label && near(0) && near(1) {
                    return Some(index as usize);
                }
                index = chosen.next;
            }
            None
        })
    }

    /// Chooses a pair of points.
    pub fn choose(&mut self, points: [DVec3; 2], label: u32) {
        let hash = self.hash(self.cell(points[0]));
        let next = std::mem::replace(&mut self.heads[hash], self.chosen.len() as u32);
        self.chosen.push(Chosen { points, label, next });
    }

    fn cell(&self, point: DVec3) -> [i64; 3] {
        point.to_array().map(|x| (x / self.reach).floor() as i64)
    }

    fn hash(&self, cell: [i64; 3]) -> usize {
        // Teschner et al. 2003, Optimized Spatial Hashing for Collision Detection of Deformable Objects.
        let [x, y, z] = cell;
        let mixed = x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ z.wrapping_mul(83_492_791);
        mixed as usize & (self.heads.len() - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    #[test]
    fn agrees_with_a_linear_search() {
        let mut rng = StdRng::seed_from_u64(0x0071_1111);
        let mut spaced = Spaced::default();
        for reach in [1e-9, 0.05, 0.3, 5.0] {
            spaced.clear(reach, 300);
            let mut plain: Vec<([DVec3; 2], u32)> = Vec::new();
            for _ in 0..300 {
                let mut vector = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
                let point = vector();
                let points = [point, 0.5 * point + 0.05 * vector()];
                let label = u32::from(points[0].x > 0.3);
                let expected = plain.iter().any(|(others, other)| {
                    *other == label && (0..2).all(|i| others[i].distance(points[i]) <= reach)
                });
                assert_eq!(spaced.near(points, label).is_some(), expected);
                if !expected {
                    spaced.choose(points, label);
                    plain.push((points, label));
                }
            }
            assert!(reach > 0.2 || plain.len() > 250);
            assert!(reach < 0.2 || plain.len() < 290, "{reach}: {}", plain.len());
        }
    }
}
