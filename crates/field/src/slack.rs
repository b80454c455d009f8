//! Samples that need not be read again until the bodies have moved by a certain distance.

use palpate_core::Pose;
use palpate_core::glam::{DMat3, DVec3};
use wide::{f32x4, i32x4};

use crate::samples::SurfaceSamples;
use crate::sparse::Pages;

/// Number of steps in a tolerance: motion is counted in whole steps.
const STEPS_PER_TOLERANCE: f64 = 256.0;
/// Longest validity of a reading, in steps: some four thousand tolerances.
const MAX_VALIDITY: u32 = 1 << 20;
/// Largest count of a clock, in steps, after which all readings are forgotten. Readings pack a time and four
/// bits into 32 bits.
const MAX_CLOCK: u32 = 1 << 27;
/// Largest number of regions of a body's surface, each with its own clock.
const REGIONS: usize = 256;
/// Rounding of positions in single precision, as a fraction of them.
const ROUNDING: f64 = 1e-6;
/// Largest distance of the centre of a sphere around part of a region from the region's centre, in radii of
/// the region: the centres are middles of boxes.
const CENTER_OFFSET: f32 = 1.1;

/// Motion of a probe relative to a scene object from one query to the next.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Pose of the last query, probe to scene object.
    last: Option<Pose>,
    /// d, m; 0 before the first query.
    tolerance: f64,
}

/// Bounds of the motion of points of one body relative to the other.
#[derive(Clone, Copy, Debug, Default)]
pub struct Change {
    /// Map from a vector between two points of the body (m) to the difference of their displacements, in
    /// steps.
    turned: DMat3,
    /// A point of the body near the other one, m, and its displacement, in steps.
    about: DVec3,
    shift: DVec3,
    /// Radius about it of the parts that matter, m.
    radius: f64,
    /// 2 sin θ/2: largest difference of the displacements of two points, in steps per metre between them.
    turn: f32,
    /// Largest change of the distance of a point of either body from the other's surface, in steps.
    most: u32,
}

impl Motion {
    pub fn new() -> Self {
        Self { last: None, tolerance: 0.0 }
    }

    /// Forgets where the bodies were.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// Advances to a pose of a probe whose surface is within a sphere (m). Returns the motion of the probe's
    /// points and of the scene object's; where that is not known, a motion beyond the validity of all
    /// readings.
    pub fn advance(&mut self, pose: &Pose, center: DVec3, radius: f64, tolerance: f64) -> [Change; 2] {
        let last = self.last.replace(*pose).filter(|_| self.tolerance == tolerance);
        self.tolerance = tolerance;
        last.map_or([Change::ANYWHERE; 2], |last| changes(&last, pose, center, radius, tolerance))
    }
}

/// The motion of points of one body that are given about a centre, in single precision.
#[derive(Clone, Copy, Debug)]
struct ChangeAbout {
    /// Rows of the map from a point (m) to its displacement, in steps.
    rows: [[f32; 4]; 3],
    turn: f32,
    /// Rounding of a point in single precision, m.
    rounding: f32,
}

impl Change {
    /// A motion beyond the validity of all readings.
    const ANYWHERE: Self = Self {
        turned: DMat3::ZERO,
        about: DVec3::ZERO,
        shift: DVec3::ZERO,
        radius: 0.0,
        turn: 0.0,
        most: MAX_VALIDITY,
    };

    /// The motion of points about a centre in the body's frame, m.
    fn around(&self, center: DVec3) -> ChangeAbout {
        let shift = self.shift + self.turned * (center - self.about);
        ChangeAbout {
            rows: [0, 1, 2].map(|axis| {
                let row = self.turned.row(axis);
                [row.x, row.y, row.z, shift[axis]].map(|part| part as f32)
            }),
            turn: self.turn,
            rounding: (ROUNDING * (self.about.distance(center) + self.radius)) as f32,
        }
    }

    /// Largest motion of any point within some spheres about a centre in the body's frame (m), given four at
    /// a time, and largest change of any distance between the bodies, m, for a tolerance (m).
    pub fn largest<'a>(
        &self,
        center: DVec3,
        spheres: impl Iterator<Item = &'a [f32x4; 4]>,
        tolerance: f64,
    ) -> [f64; 2] {
        let metres = |steps: f64| steps * tolerance / STEPS_PER_TOLERANCE;
        let most = if self.most == MAX_VALIDITY { f64::INFINITY } else { metres(self.most.into()) };
        let own = self.around(center);
        let largest = spheres.map(|four| own.of(four)).fold(f32x4::ZERO, f32x4::fast_max);
        let largest = largest.to_array().into_iter().fold(0.0, f32::max);
        [most.min(metres(largest.into())), most]
    }
}

impl ChangeAbout {
    /// Largest motion of any point within four spheres of the body's surface (centres and radii, m), in
    /// steps.
    #[inline]
    fn of(&self, [x, y, z, radius]: &[f32x4; 4]) -> f32x4 {
        let along = |[a, b, c, d]: [f32; 4]| {
            f32x4::splat(a) * *x + f32x4::splat(b) * *y + f32x4::splat(c) * *z + f32x4::splat(d)
        };
        let [x, y, z] = self.rows.map(along);
        let spread =
            f32x4::splat(self.turn) * (f32x4::splat(CENTER_OFFSET) * *radius + f32x4::splat(self.rounding));
        f32x4::splat(1.0001) * ((x * x + y * y + z * z).sqrt() + spread)
    }
}

/// 2 sin θ/2: displacement of a point at 1 m from the axis of the rotation from one pose to another, m.
fn chord(from: &Pose, to: &Pose) -> f64 {
    let turn = (from.rotation.inverse() * to.rotation).normalize();
    // The vector part of the quaternion is sin θ/2 long.
    2.0 * DVec3::new(turn.x, turn.y, turn.z).length()
}

/// Upper bound of the change of any distance between the bodies' surfaces from one pose to another, m, for a
/// probe whose surface is within a sphere (m).
pub fn motion_bound(from: &Pose, to: &Pose, center: DVec3, radius: f64) -> f64 {
    from.transform_point(center).distance(to.transform_point(center)) + radius * chord(from, to)
}

/// Motions, from one pose to another (probe to scene object), of the points of a probe whose surface is
/// within a sphere (m), and of a scene object's.
pub fn changes(from: &Pose, to: &Pose, center: DVec3, radius: f64, tolerance: f64) -> [Change; 2] {
    if from == to {
        return [Change::default(); 2];
    }
    let turn = chord(from, to);
    let per_metre = STEPS_PER_TOLERANCE / tolerance;
    let most = (motion_bound(from, to, center, radius) * per_metre).ceil();
    if most.is_nan() || most >= f64::from(MAX_VALIDITY) {
        return [Change::ANYWHERE; 2];
    }
    let change = |from: &Pose, to: &Pose, about: DVec3| {
        // Displacement of a point x: (R′ − R) (x − about), and the motion of `about`.
        let matrix = DMat3::from_quat(to.rotation) - DMat3::from_quat(from.rotation);
        let shift = to.transform_point(about) - from.transform_point(about);
        Change {
            turned: matrix * per_metre,
            about,
            shift: shift * per_metre,
            radius,
            turn: (turn * per_metre) as f32,
            most: most as u32,
        }
    };
    // The scene object's point at the probe's centre moves as far as that centre does.
    [change(from, to, center), change(&from.inverse(), &to.inverse(), to.transform_point(center))]
}

/// Number of steps in a unit of length (m).
pub fn steps_per(unit: f64, tolerance: f64) -> f32 {
    (unit * STEPS_PER_TOLERANCE / tolerance) as f32
}

/// Accumulated motion of each region of a body's surface relative to the other body, in steps. A region is
/// the part of the surface that a sample of a certain level represents.
#[derive(Clone, Debug)]
pub struct Clocks {
    level: usize,
    regions: Vec<u32>,
    /// Upper bound of all regions' motion.
    whole: u32,
}

impl Clocks {
    pub fn new(samples: &SurfaceSamples) -> Self {
        let nodes = |level: usize| 4 * samples.levels[level].spheres.len();
        let level = (1..samples.levels.len()).find(|level| nodes(*level) <= REGIONS).unwrap_or(0);
        let regions = if level == 0 { 0 } else { nodes(level) };
        Self { level, regions: vec![1; regions], whole: 1 }
    }

    /// Resets all clocks.
    pub fn reset(&mut self) {
        self.regions.fill(1);
        self.whole = 1;
    }

    /// Advances the clocks by a motion. Returns false if they would overflow.
    pub fn advance(&mut self, samples: &SurfaceSamples, change: &Change) -> bool {
        if change.most >= MAX_CLOCK - self.whole {
            return false;
        }
        self.whole += change.most;
        if change.most == 0 || self.regions.is_empty() {
            return true;
        }
        if change.most == MAX_VALIDITY {
            self.regions.iter_mut().for_each(|region| *region += MAX_VALIDITY);
            return true;
        }
        let spheres = &samples.levels[self.level].spheres;
        let change_about = change.around(samples.center());
        for (regions, spheres) in self.regions.as_chunks_mut().0.iter_mut().zip(spheres) {
            let moved = change_about.of(spheres).to_array();
            let regions: &mut [u32; 4] = regions;
            for (region, moved) in regions.iter_mut().zip(moved) {
                // Casts saturate, and round down.
                *region += (moved as u32 + 1).min(change.most);
            }
        }
        true
    }

    /// The level whose samples represent a region each; 0 if there are no regions.
    pub fn level(&self) -> usize {
        self.level
    }

    /// The clocks of the samples of a level.
    pub fn at(&self, level: usize) -> Clock<'_> {
        let regions = |level: usize| {
            if level <= self.level && self.level > 0 {
                (&self.regions[..], 2 * (self.level - level) as u32)
            } else {
                (std::slice::from_ref(&self.whole), u32::BITS - 1)
            }
        };
        Clock { each: regions(level), fours: regions(level + 1), differs: level == self.level && level > 0 }
    }
}

/// The clocks of the samples of a level, each with all samples below it: regions, and the shift from a
/// sample's index to that of its region.
#[derive(Clone, Copy, Debug)]
pub struct Clock<'a> {
    each: (&'a [u32], u32),
    fours: (&'a [u32], u32),
    /// Whether the samples of a four belong to different regions.
    differs: bool,
}

impl Clock<'_> {
    /// The clock of a sample.
    #[inline]
    pub fn of(&self, sample: usize) -> u32 {
        let (regions, shift) = self.each;
        regions[sample >> shift]
    }

    /// The clock of four samples together.
    #[inline]
    pub fn of_four(&self, four: usize) -> u32 {
        let (regions, shift) = self.fours;
        regions[four >> shift]
    }

    /// The clocks of each of four samples.
    #[inline]
    pub fn of_each(&self, four: usize) -> i32x4 {
        if self.differs {
            i32x4::new([0, 1, 2, 3].map(|lane| self.of(4 * four + lane).cast_signed()))
        } else {
            i32x4::splat(self.of_four(four).cast_signed())
        }
    }
}

/// The time of a clock `steps` later; the same time if `steps` is not positive.
#[inline]
pub fn after(now: u32, steps: f32) -> u32 {
    // Casts saturate, and NaN becomes 0.
    now + (steps as u32).min(MAX_VALIDITY)
}

/// Readings of one body's samples, each with the time until which it holds, in steps of motion. Expired
/// readings are unknown.
#[derive(Clone, Debug)]
pub struct Known {
    levels: Vec<Level>,
}

/// Readings of one level.
#[derive(Clone, Debug)]
pub struct Level {
    /// Readings of samples, four by four: of the two that are read first, and of the other two.
    pub fours: Pages<[LastRead; 2]>,
    /// Readings of spheres, four by four.
    pub spheres: Pages<Spheres>,
}

/// Last reading of two samples: in the lower four bits, a mask among four of those in contact; in the others,
/// the time until which the others are not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LastRead(u32);

impl LastRead {
    /// No reading.
    pub const UNKNOWN: Self = Self(0);

    pub fn new(in_contact: u32, until: u32) -> Self {
        Self(until << 4 | in_contact)
    }

    /// Mask of the samples to read, of those in `all`.
    #[inline]
    pub fn awake(self, all: u32, now: u32) -> u32 {
        if self.until() <= now { all } else { self.in_contact() }
    }

    #[inline]
    pub fn in_contact(self) -> u32 {
        self.0 & 15
    }

    #[inline]
    pub fn until(self) -> u32 {
        self.0 >> 4
    }
}

/// Last readings of four spheres: in the lowest bit, whether a sphere is in reach; in the others, the time
/// until which this holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spheres(i32x4);

impl Spheres {
    /// No reading.
    pub const UNKNOWN: Self = Self(i32x4::ZERO);

    /// Bit mask of the spheres that may be in reach.
    #[inline]
    pub fn open(self, now: i32x4) -> u32 {
        (self.is_in_reach() | !self.is_known(now)).to_bitmask()
    }

    /// Bit mask of the spheres without a valid reading.
    #[inline]
    pub fn unknown(self, now: i32x4) -> u32 {
        (!self.is_known(now)).to_bitmask()
    }

    /// Bit mask of the spheres in reach.
    #[inline]
    pub fn in_reach(self) -> u32 {
        self.is_in_reach().to_bitmask()
    }

    /// Flags of the spheres in reach, in the sign bits.
    #[inline]
    fn is_in_reach(self) -> i32x4 {
        self.0 << 31
    }

    #[inline]
    fn is_known(self, now: i32x4) -> i32x4 {
        self.until().simd_gt(now)
    }

    #[inline]
    fn until(self) -> i32x4 {
        self.0 >> 1
    }

    /// Steps until the first of the readings expires.
    pub fn left(self, now: i32x4) -> u32 {
        (self.until() - now).reduce_min().max(0).cast_unsigned()
    }

    /// Stores the reading of one of the spheres.
    #[inline]
    pub fn set(&mut self, lane: usize, is_in_reach: bool, until: u32) {
        self.0.as_mut_array()[lane] = (until << 1 | u32::from(is_in_reach)).cast_signed();
    }
}

impl Known {
    pub fn new(samples: &SurfaceSamples) -> Self {
        let of = |(index, level): (usize, &crate::samples::Level)| Level {
            fours: Pages::new(samples.fours(index), [LastRead::UNKNOWN; 2]),
            spheres: Pages::new(level.spheres.len(), Spheres::UNKNOWN),
        };
        Self { levels: samples.levels.iter().enumerate().map(of).collect() }
    }

    /// Forgets all readings.
    pub fn forget(&mut self) {
        for level in &mut self.levels {
            level.fours.forget();
            level.spheres.forget();
        }
    }

    /// A level, and the one above it.
    pub fn level(&mut self, level: usize) -> (&mut Level, Option<&mut Level>) {
        let (below, above) = self.levels.split_at_mut(level + 1);
        (&mut below[level], above.first_mut())
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        let of = |level: &Level| level.fours.bytes() + level.spheres.bytes();
        self.levels.iter().map(of).sum()
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DQuat;
    use palpate_models::Model;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    #[test]
    fn no_point_moves_further_than_is_counted() {
        let mut rng = StdRng::seed_from_u64(0x51AC);
        let mut random = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        let mesh = Model::Torus.generate(2000).expect("in range");
        let (center, radius) = (mesh.bounding_sphere().center, mesh.bounding_sphere().radius);
        let tolerance = 0.01 * radius;
        let samples = SurfaceSamples::new(&mesh, 0.02 * radius);
        let count = samples.count();
        let points: Vec<(usize, DVec3)> = (0..200)
            .map(|index| {
                let sample = index * 997 % count;
                let four = samples.four(0, sample / 4).map(|axis| axis.to_array()[sample % 4]);
                (sample, samples.center() + DVec3::from_array(four.map(f64::from)))
            })
            .collect();
        let mut motion = Motion::new();
        let mut clocks = Clocks::new(&samples);
        assert!(!clocks.regions.is_empty());
        let mut pose = Pose::IDENTITY;
        let unknown = |changes: [Change; 2]| changes.iter().all(|change| change.most == MAX_VALIDITY);
        assert!(unknown(motion.advance(&pose, center, radius, tolerance)), "nothing was known");
        let (mut total, mut counted_in_all, mut most) = (0.0, 0.0, 0.0);
        let metres = tolerance / STEPS_PER_TOLERANCE;
        for size in [1e-7, 1e-4, 1e-2, 0.2] {
            for _ in 0..100 {
                // A rotation about a point of the surface, as of bodies that touch there.
                let about = pose.transform_point(points[0].1);
                let turn = DQuat::from_scaled_axis(size * random());
                let shift = 0.1 * size * radius * random();
                let next = Pose::new(turn * (pose.translation - about) + about + shift, turn * pose.rotation);
                let [own, other] = motion.advance(&next, center, radius, tolerance);
                for (change, from, to) in [(own, pose, next), (other, pose.inverse(), next.inverse())] {
                    let mut clocks = clocks.clone();
                    let before = clocks.clone();
                    assert!(clocks.advance(&samples, &change));
                    for (sample, point) in &points {
                        let way = from.transform_point(*point).distance(to.transform_point(*point));
                        let counted = clocks.at(0).of(*sample) - before.at(0).of(*sample);
                        let whole = clocks.whole - before.whole;
                        // Only what is around the probe moves no further than the whole.
                        let way = way.min(f64::from(whole) * metres);
                        assert!(way <= f64::from(counted) * metres, "{way} {counted}");
                        (total, counted_in_all) = (total + way, counted_in_all + f64::from(counted));
                        most += f64::from(whole);
                    }
                }
                pose = next;
                assert!(clocks.advance(&samples, &own));
            }
        }
        assert!(counted_in_all * metres < 2.0 * total, "{counted_in_all} counted for {total}");
        assert!(counted_in_all < 0.9 * most, "{counted_in_all} counted, {most} for the whole");
        let before = clocks.clone();
        let [own, _] = motion.advance(&pose, center, radius, tolerance);
        assert!(clocks.advance(&samples, &own));
        assert_eq!(clocks.regions, before.regions, "at rest");
        assert_eq!(clocks.whole, before.whole, "at rest");
        assert!(unknown(motion.advance(&pose, center, radius, 2.0 * tolerance)), "another tolerance");
    }
}
