//! The density of samples around each place, and the weights of the samples of a level.
//!
//! Each level has two halves: one of two neighbouring samples is read first, and represents both, then the
//! other. With each half there are twice as many samples in contact around a place, and where there are
//! enough, the finer ones need not be read. Weights blend from one half to the next, so that the wrench does
//! not jump where a number passes a limit.

use glam::UVec3;
use wide::f32x4;

use crate::sparse::Index;

/// Smallest number of samples needed around a place: fewer may have equal depths by chance.
const MIN_SAMPLES: f32 = 4.0;
/// Width of the blend, as a fraction of the number of samples needed: a half begins to count where there are
/// as many as needed, and counts in full where there are more by this fraction.
const BLEND: f32 = 0.5;

/// A sample within reach.
#[derive(Clone, Copy, Debug)]
pub struct Touch {
    /// Index among the samples of the level.
    pub index: u32,
    /// Distance inside the limit of reach, in reaches: (δ + d) / d.
    pub reach: f32,
    /// Area that it represents among the samples visited, as a fraction of a cell's squared edge: in these
    /// units no area is too small for single precision.
    pub area: f32,
    /// Area that it represents in the selection, in the same unit.
    pub counted: f32,
    /// The cube that the first of its four is in, which determines its weight.
    pub place: u32,
}

/// A cube of the probe's surroundings, with sums of p, p² / w and p (δ + d) over its samples, where w is the
/// weight of a sample, a its area and p = w a (δ + d).
///
/// (Σ p)² / Σ (p² / w) is the number of samples that carry the load, and Σ p (δ + d) / Σ p their mean δ + d.
#[derive(Clone, Copy, Debug)]
struct Cube {
    /// Sums over the samples that count.
    settled: f32x4,
    /// Sums over the samples of the present half.
    present: f32x4,
    /// Number of samples that carry the load around the cube, and the mean of their δ + d, in tolerances.
    around: [f32; 2],
    /// Weight of the samples of the present half.
    share: f32,
    /// Weight that the samples of the present level leave to those of the next.
    rest: f32,
    /// Its number in the probe's surroundings.
    place: u32,
}

/// The cubes of the probe's surroundings that hold contacts.
#[derive(Clone, Debug)]
pub struct Sampling {
    /// Cubes along each axis of the surroundings.
    across: u32,
    cubes: Vec<Cube>,
    /// Places in `cubes`, by their numbers.
    index: Index,
    /// Whether samples of the present level count anywhere.
    counts: bool,
    /// Whether there is no time for another level.
    is_ended: bool,
}

impl Sampling {
    /// Empty cubes, `across` along each axis.
    pub fn new(across: u32) -> Self {
        Self { across, cubes: Vec::new(), index: Index::default(), counts: false, is_ended: false }
    }

    pub fn clear(&mut self) {
        (self.counts, self.is_ended) = (false, false);
        self.cubes.clear();
        self.index.clear();
    }

    /// Adds a sample of the present half; `area` is that of a sample of weight 1.
    #[inline]
    pub fn add(&mut self, sample: &Touch, area: f32) {
        let place = self.index.get_or_insert(sample.place, self.cubes.len());
        if place == self.cubes.len() {
            self.cubes.push(Cube {
                settled: f32x4::ZERO,
                present: f32x4::ZERO,
                around: [0.0; 2],
                share: 0.0,
                rest: 1.0,
                place: sample.place,
            });
        }
        let pressure = sample.area * sample.reach;
        let moment = pressure * sample.reach;
        self.cubes[place].present += f32x4::new([pressure, moment * area, moment, 0.0]);
    }

    /// Sets the weights of the samples of the present half (0 or 1) of a level, given the number needed
    /// around a place. Where contacts push less than elsewhere, proportionally fewer are needed: this gives
    /// the smallest error of the wrench for a number of samples.
    pub fn settle(&mut self, needed: f32, half: usize) {
        let n = self.across;
        for cube in &mut self.cubes {
            // Samples represent half the area of those of the half before: the sums are rescaled as if
            // sampled as densely, so that Σ p² / w halves.
            cube.settled *= f32x4::new([1.0, 0.5, 1.0, 1.0]);
        }
        // Sums over each cube and its neighbours: (Σ p)² / Σ (p² / w), and Σ p (δ + d) / Σ p.
        let mut most = 0.0f32;
        for own in 0..self.cubes.len() {
            let index = self.cubes[own].place;
            let at = UVec3::new(index % n, index / n % n, index / (n * n));
            let (low, high) = (at.saturating_sub(UVec3::ONE), (at + 1).min(UVec3::splat(n - 1)));
            let mut sum = f32x4::ZERO;
            for z in low.z..=high.z {
                for y in low.y..=high.y {
                    let row = (z * n + y) * n;
                    for cube in (low.x..=high.x).filter_map(|x| self.index.get(row + x)) {
                        sum += self.cubes[cube].settled + self.cubes[cube].present;
                    }
                }
            }
            let [pressure, squares, moment, _] = sum.to_array();
            let around =
                if squares > 0.0 { [pressure * pressure / squares, moment / pressure] } else { [0.0; 2] };
            self.cubes[own].around = around;
            most = most.max(around[1]);
        }
        self.counts &= half > 0;
        for cube in &mut self.cubes {
            let [count, mean] = cube.around;
            let needed = (needed * mean / most).max(MIN_SAMPLES);
            cube.share = ((count / needed - 1.0) / BLEND).clamp(0.0, 1.0);
            cube.rest = if half == 0 { 1.0 } else { cube.rest } * (1.0 - cube.share);
            cube.settled += cube.present * f32x4::splat(cube.share);
            cube.present = f32x4::ZERO;
            self.counts |= cube.share > 0.0;
        }
    }

    /// Gives the samples of the present half their full weight, so that none is left to the next. Returns
    /// whether they had it already.
    pub fn end(&mut self) -> bool {
        let mut was_enough = true;
        for cube in &mut self.cubes {
            was_enough &= cube.share == 1.0;
            cube.share = 1.0;
        }
        self.is_ended = true;
        was_enough
    }

    /// Cubes along each axis.
    pub fn across(&self) -> u32 {
        self.across
    }

    /// Weight of the samples of the present half in a cube.
    #[inline]
    pub fn share(&self, cube: u32) -> f32 {
        self.index.get(cube).map_or(0.0, |cube| self.cubes[cube].share)
    }

    /// Weight that the samples of the present level in a cube leave to those of the next.
    #[inline]
    pub fn rest(&self, cube: u32) -> f32 {
        self.index.get(cube).map_or(1.0, |cube| self.cubes[cube].rest)
    }

    /// Whether samples of the present level count anywhere.
    pub fn counts(&self) -> bool {
        self.counts
    }

    /// Whether there is no time for another level.
    pub fn is_ended(&self) -> bool {
        self.is_ended
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.cubes.capacity() * size_of::<Cube>() + self.index.bytes()
    }
}
