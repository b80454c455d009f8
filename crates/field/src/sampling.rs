//! How densely the surroundings of each place have been sampled, and how much the samples of a level count.
//!
//! Each level has two halves: one of two neighbouring samples is read first, standing for both, then the other. With each half there
//! are twice as many samples in contact around a place, and where there are enough, the finer ones need not be read. Weights go over
//! from one half to the next gradually, so that the wrench does not jump where a number passes a limit.

use glam::UVec3;
use wide::f32x4;

/// Samples around each place, at least: fewer may be as deep as one another by chance.
const FEWEST: f32 = 4.0;
/// Samples begin to count where there are as many as are needed, and count in full where there are this part more.
const BLEND: f32 = 0.5;

/// A sample within reach.
#[derive(Clone, Copy, Debug)]
pub struct Touch {
    /// Among the samples of the level.
    pub index: u32,
    /// How far within reach, in reaches.
    pub reach: f32,
    /// What it stands for among the samples that are looked at, as a part of a cell's squared edge: in these units nothing is too small
    /// for single precision.
    pub area: f32,
    /// What it stands for in the selection, likewise.
    pub counted: f32,
    /// The cube that the first of its four is in, by which it is decided how much it counts.
    pub place: u32,
}

/// A cube of the probe's surroundings. With w how much of a sample counts and p = w a (δ + d), sums are those of p, p² / w and
/// p (δ + d).
///
/// (Σ p)² / Σ (p² / w) is the number of samples that carry the load, and Σ p (δ + d) / Σ p their mean δ + d.
#[derive(Clone, Copy, Debug)]
struct Cube {
    /// Over the samples that count.
    settled: f32x4,
    /// Over those of the present half.
    present: f32x4,
    /// How many samples carry the load around the cube, and the mean of their δ + d, in tolerances.
    around: [f32; 2],
    /// How much of what the samples of the present half push with counts.
    share: f32,
    /// How much of what the samples of the present level push with is left to those of the next.
    rest: f32,
    is_used: bool,
}

impl Cube {
    const EMPTY: Self = Self {
        settled: f32x4::ZERO,
        present: f32x4::ZERO,
        around: [0.0; 2],
        share: 0.0,
        rest: 1.0,
        is_used: false,
    };
}

/// The cubes of the probe's surroundings.
#[derive(Clone, Debug)]
pub struct Sampling {
    /// Cubes along each axis.
    across: u32,
    cubes: Vec<Cube>,
    /// Those that hold contacts.
    used: Vec<u32>,
    /// Whether samples of the present level count anywhere.
    counts: bool,
    /// Whether there is no time for another level.
    is_ended: bool,
}

impl Sampling {
    /// With so many cubes along each axis.
    pub fn new(across: u32) -> Self {
        let count = across.pow(3) as usize;
        Self {
            across,
            cubes: vec![Cube::EMPTY; count],
            used: Vec::with_capacity(count),
            counts: false,
            is_ended: false,
        }
    }

    pub fn clear(&mut self) {
        (self.counts, self.is_ended) = (false, false);
        for cube in self.used.drain(..) {
            self.cubes[cube as usize] = Cube::EMPTY;
        }
    }

    /// Adds a sample of the present half: `area` is that of all such samples, of which it has a part.
    #[inline]
    pub fn add(&mut self, sample: &Touch, area: f32) {
        let cube = &mut self.cubes[sample.place as usize];
        if !cube.is_used {
            cube.is_used = true;
            self.used.push(sample.place);
        }
        let pressure = sample.area * sample.reach;
        let moment = pressure * sample.reach;
        cube.present += f32x4::new([pressure, moment * area, moment, 0.0]);
    }

    /// Decides how much counts of the samples of the present half of a level (0 or 1), given how many are needed around a place. Where
    /// contacts push by less than elsewhere, proportionally fewer will do: for the error of the wrench they make up for one another,
    /// and it is least for its price so.
    pub fn settle(&mut self, needed: f32, half: usize) {
        let n = self.across;
        for index in &self.used {
            // Samples stand for half as much as those of the half before. What is settled is as if it had been sampled as densely.
            self.cubes[*index as usize].settled *= f32x4::new([1.0, 0.5, 1.0, 1.0]);
        }
        let mut most = 0.0f32;
        for index in &self.used {
            let at = UVec3::new(index % n, index / n % n, index / (n * n));
            let (low, high) = (at.saturating_sub(UVec3::ONE), (at + 1).min(UVec3::splat(n - 1)));
            let mut sum = f32x4::ZERO;
            for z in low.z..=high.z {
                for y in low.y..=high.y {
                    let row = ((z * n + y) * n) as usize;
                    for cube in &self.cubes[row + low.x as usize..=row + high.x as usize] {
                        sum += cube.settled + cube.present;
                    }
                }
            }
            let [pressure, squares, moment, _] = sum.to_array();
            let around =
                if squares > 0.0 { [pressure * pressure / squares, moment / pressure] } else { [0.0; 2] };
            self.cubes[*index as usize].around = around;
            most = most.max(around[1]);
        }
        self.counts &= half > 0;
        for index in &self.used {
            let cube = &mut self.cubes[*index as usize];
            let [count, mean] = cube.around;
            let needed = (needed * mean / most).max(FEWEST);
            cube.share = ((count / needed - 1.0) / BLEND).clamp(0.0, 1.0);
            cube.rest = if half == 0 { 1.0 } else { cube.rest } * (1.0 - cube.share);
            cube.settled += cube.present * f32x4::splat(cube.share);
            cube.present = f32x4::ZERO;
            self.counts |= cube.share > 0.0;
        }
    }

    /// Lets all of the samples of the present half count, so that none of the next do. Returns whether that was so anyway.
    pub fn end(&mut self) -> bool {
        let mut was_enough = true;
        for index in &self.used {
            let cube = &mut self.cubes[*index as usize];
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

    /// How much counts of what the samples of the present half in a cube push with.
    #[inline]
    pub fn share(&self, cube: u32) -> f32 {
        self.cubes[cube as usize].share
    }

    /// How much of what the samples of the present level in a cube push with is left to those of the next.
    #[inline]
    pub fn rest(&self, cube: u32) -> f32 {
        self.cubes[cube as usize].rest
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
        self.cubes.capacity() * size_of::<Cube>() + self.used.capacity() * size_of::<u32>()
    }
}
