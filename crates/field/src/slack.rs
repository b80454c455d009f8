//! What need not be read again until the bodies have moved so far.

use palpate_core::Pose;
use palpate_core::glam::DVec3;

use crate::samples::SurfaceSamples;

/// Steps that the tolerance is divided into, to count motion in whole numbers.
const STEPS: f64 = 256.0;
/// Motion is counted up to here before all is forgotten: some 4 million tolerances.
const MOST: u32 = 1 << 30;

/// How far a probe has moved relative to a scene object, at most: no distance of a point of either from the other's surface changes
/// by more.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Of the last query, probe to scene object.
    last: Option<Pose>,
    /// d, m; 0 before the first query.
    tolerance: f64,
    /// Steps so far.
    moved: u32,
}

impl Motion {
    pub fn new() -> Self {
        Self { last: None, tolerance: 0.0, moved: 0 }
    }

    /// Forgets where the bodies were.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// Moves on to a pose of a probe whose surface is within a sphere (m). Returns whether what is known still holds.
    pub fn advance(&mut self, pose: &Pose, center: DVec3, radius: f64, tolerance: f64) -> bool {
        let last = self.last.replace(*pose);
        let known = last.filter(|_| self.tolerance == tolerance).map(|last| {
            let shift = last.transform_point(center).distance(pose.transform_point(center));
            let turn = (last.rotation.inverse() * pose.rotation).normalize();
            // A chord is 2 sin θ/2 long, and the vector part of the quaternion sin θ/2.
            shift + 2.0 * radius * DVec3::new(turn.x, turn.y, turn.z).length()
        });
        self.tolerance = tolerance;
        let steps = known.map(|way| (way / self.step()).ceil());
        match steps.filter(|steps| *steps < f64::from(MOST - self.moved)) {
            Some(steps) => {
                self.moved += steps as u32;
                true
            }
            None => {
                self.moved = 1;
                false
            }
        }
    }

    /// One step, m.
    fn step(&self) -> f64 {
        self.tolerance / STEPS
    }

    /// Steps so far.
    pub fn moved(&self) -> u32 {
        self.moved
    }

    /// Steps in a unit of length of so many metres.
    pub fn per_unit(&self, unit: f64) -> f32 {
        (unit / self.step()) as f32
    }

    /// When the bodies will have moved by a number of steps, if that is positive.
    #[inline]
    pub fn after(&self, steps: f32) -> u32 {
        // Casts saturate, and what is not a number becomes 0.
        self.moved + (steps as u32).min(MOST)
    }
}

/// Until when what is known of one body's samples holds, in steps of motion. What has passed is not known.
#[derive(Clone, Debug)]
pub struct Known {
    levels: Vec<Level>,
}

/// Of one level.
#[derive(Clone, Debug)]
pub struct Level {
    /// Four by four: until when none of these samples is in contact.
    pub apart: Vec<u32>,
    /// Of each sphere.
    pub spheres: Vec<[Sphere; 4]>,
}

/// Twice until when it is known whether a sphere is in reach, and 1 more if it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sphere(u32);

impl Sphere {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self(0);

    pub fn new(is_in_reach: bool, until: u32) -> Self {
        Self(until << 1 | u32::from(is_in_reach))
    }

    #[inline]
    pub fn is_in_reach(self) -> bool {
        self.0 & 1 == 1
    }

    #[inline]
    pub fn until(self) -> u32 {
        self.0 >> 1
    }
}

impl Known {
    pub fn new(samples: &SurfaceSamples) -> Self {
        let of = |(index, level): (usize, &crate::samples::Level)| Level {
            apart: vec![0; samples.fours(index)],
            spheres: vec![[Sphere::UNKNOWN; 4]; level.spheres.len()],
        };
        Self { levels: samples.levels.iter().enumerate().map(of).collect() }
    }

    /// Nothing is known any more.
    pub fn forget(&mut self) {
        for level in &mut self.levels {
            level.apart.fill(0);
            level.spheres.fill([Sphere::UNKNOWN; 4]);
        }
    }

    /// A level, and the one above it.
    pub fn level(&mut self, level: usize) -> (&mut Level, Option<&mut Level>) {
        let (below, above) = self.levels.split_at_mut(level + 1);
        (&mut below[level], above.first_mut())
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        let of = |level: &Level| {
            level.apart.capacity() * size_of::<u32>() + level.spheres.capacity() * size_of::<[Sphere; 4]>()
        };
        self.levels.iter().map(of).sum()
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DQuat;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    #[test]
    fn no_point_moves_further_than_is_counted() {
        let mut rng = StdRng::seed_from_u64(0x51AC);
        let mut random = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        let (center, radius, tolerance) = (DVec3::new(0.3, -0.2, 0.9), 2.0, 0.02);
        let mut motion = Motion::new();
        let mut pose = Pose::IDENTITY;
        assert!(!motion.advance(&pose, center, radius, tolerance), "nothing was known");
        let (mut total, mut most) = (0.0, 0.0f64);
        let points: Vec<DVec3> = (0..100).map(|_| center + radius * random().normalize()).collect();
        for size in [1e-7, 1e-4, 1e-2, 0.5] {
            for _ in 0..100 {
                let next = Pose::new(
                    pose.translation + size * random(),
                    DQuat::from_scaled_axis(size * random()) * pose.rotation,
                );
                let before = motion.moved();
                assert!(motion.advance(&next, center, radius, tolerance));
                let counted = f64::from(motion.moved() - before) * motion.step();
                let way = points.iter().map(|p| pose.transform_point(*p).distance(next.transform_point(*p)));
                let furthest = way.fold(0.0, f64::max);
                assert!(furthest <= counted, "{furthest} {counted}");
                (total, most) = (total + furthest, most + counted);
                pose = next;
            }
        }
        assert!(most < 2.0 * total, "{most} counted for {total}");
        let before = motion.moved();
        assert!(motion.advance(&pose, center, radius, tolerance));
        assert_eq!(motion.moved(), before, "at rest");
        assert!(!motion.advance(&pose, center, radius, 2.0 * tolerance), "another tolerance");
    }
}
