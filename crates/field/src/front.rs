//! The front of a selection in the hierarchy of one body's samples: the samples still to be visited, and
//! earlier readings.

use std::ops::Range;

use wide::f32x4;

use crate::samples::{Sample, SurfaceSamples};
use crate::sampling::{Sampling, Touch};
use crate::selection::Selection;
use crate::side::{Side, bits};
use crate::slack::{Clocks, Known, LastRead, after, steps_per};

/// Largest change of interpolated distances between two points beyond the points' distance, in lattice
/// constants: interpolation bends near creases.
pub const SLACK: f32 = 0.25;
/// Largest slope of interpolated distances, √3 and a margin: along each axis it is at most 1.
pub const MAX_SLOPE: f32 = 1.74;

/// Number of fours visited in a step.
const BATCH: usize = 128;

/// Coarsest level whose samples are read: the levels above have too few points to represent a contact.
pub const COARSEST_LEVEL: usize = 5;

/// Four samples of a level that may be in reach, or something below them.
#[derive(Clone, Copy, Debug)]
struct Four {
    index: u32,
    /// Largest weight that they can have.
    weight: f32,
}

/// Four samples of which some are to be read.
#[derive(Clone, Copy, Debug)]
struct Active {
    index: u32,
    weight: f32,
    /// The cube that the first of them is in.
    place: u32,
    /// Bit masks of those to read: of the two that are read first, and of the others.
    awake: [u8; 2],
}

/// Four samples with something below them that may be in reach.
#[derive(Clone, Copy, Debug)]
struct Open {
    index: u32,
    weight: f32,
    /// Bit mask of the samples below which something may be in reach.
    lanes: u8,
    /// Bit mask of those for which that has to be read.
    unknown: u8,
}

/// Distance beyond reach, in reaches, up to which regions count as near.
pub const NEAR_MARGIN: f32 = 2.0;

/// Bit mask of the two of four samples that are read first: one of the first two, one of the last two, at
/// random.
#[inline]
fn first_lanes(level: usize, four: usize) -> u32 {
    const MASKS: [u32; 4] = [0b0101, 0b1001, 0b0110, 0b1010];
    let hash = (four as u32 ^ (level as u32) << 27).wrapping_mul(0x9E37_79B9);
    MASKS[(hash >> 30) as usize]
}

/// Points to be read, about the centre of the body's samples, m: four at a time, and the rest.
#[derive(Clone, Debug)]
struct Queue {
    fours: Vec<[f32x4; 3]>,
    rest: [[f32; 4]; 3],
    count: usize,
}

impl Queue {
    fn clear(&mut self) {
        self.fours.clear();
        self.count = 0;
    }

    /// Appends some of four points.
    #[inline]
    fn push(&mut self, points: &[f32x4; 3], lanes: u32) {
        let used = self.count % 4;
        if lanes == 15 && used == 0 {
            self.fours.push(*points);
            self.count += 4;
            return;
        }
        let [x, y, z] = points.map(f32x4::to_array);
        for lane in bits(lanes) {
            let place = self.count % 4;
            (self.rest[0][place], self.rest[1][place], self.rest[2][place]) = (x[lane], y[lane], z[lane]);
            self.count += 1;
            if place == 3 {
                self.fours.push(self.rest.map(f32x4::new));
            }
        }
    }

    /// Completes the last four by repeating the last point; returns the number of points.
    fn finish(&mut self) -> usize {
        if !self.count.is_multiple_of(4) {
            for axis in &mut self.rest {
                let last = axis[(self.count - 1) % 4];
                axis[self.count % 4..].fill(last);
            }
            self.fours.push(self.rest.map(f32x4::new));
        }
        self.count
    }

    fn bytes(&self) -> usize {
        self.fours.capacity() * size_of::<[f32x4; 3]>()
    }
}

/// One body's samples in a query.
#[derive(Clone, Debug)]
pub struct Front {
    known: Known,
    pub clocks: Clocks,
    /// Fours of the present level; after [`Self::descend`], of the next.
    now: Vec<Four>,
    /// Index of the first that has not been visited, in `now`, `active` or `open`.
    next: usize,
    /// Fours whose samples are read.
    active: Vec<Active>,
    /// Fours to descend from.
    open: Vec<Open>,
    queue: Queue,
    /// Values read for the points of the queue, in lattice constants.
    found: Vec<f32>,
    /// Samples of the present level within reach.
    touching: Vec<Touch>,
    /// Numbers of readings of spheres and of samples so far.
    pub read: [usize; 2],
    /// Number of fours visited so far.
    pub visited: usize,
}

impl Front {
    pub fn new(samples: &SurfaceSamples) -> Self {
        Self {
            known: Known::new(samples),
            clocks: Clocks::new(samples),
            now: Vec::new(),
            next: 0,
            active: Vec::new(),
            open: Vec::new(),
            queue: Queue { fours: Vec::new(), rest: [[0.0; 4]; 3], count: 0 },
            found: Vec::new(),
            touching: Vec::new(),
            read: [0; 2],
            visited: 0,
        }
    }

    /// Forgets all readings.
    pub fn forget(&mut self) {
        self.known.forget();
        self.clocks.reset();
    }

    /// Begins at the coarsest level.
    pub fn begin(&mut self, samples: &SurfaceSamples) {
        self.read = [0; 2];
        self.visited = 0;
        self.touching.clear();
        self.now.clear();
        self.next = 0;
        if samples.levels.len() > 1 {
            self.now.push(Four { index: 0, weight: 1.0 });
        }
    }

    /// The fours of the present level to be visited.
    pub fn now(&self) -> impl Iterator<Item = u32> {
        self.now.iter().map(|four| four.index)
    }

    /// Visits some of the fours of a level: reads the first two samples of each where they may be in contact,
    /// and drops fours that are not in contact and have nothing in reach below them. Returns whether all have
    /// been visited.
    pub fn visit(&mut self, side: &Side, level: usize, tolerance: f64) -> bool {
        if self.next == 0 {
            self.touching.clear();
            self.active.clear();
            self.open.clear();
        }
        self.queue.clear();
        let first = self.active.len();
        let some = self.next..(self.next + BATCH).min(self.now.len());
        self.visited += some.len();
        self.next = some.end;
        let (known, mut above) = self.known.level(level);
        let (clock, clock_above) = (self.clocks.at(level), self.clocks.at(level + 1));
        let is_sampled = level <= COARSEST_LEVEL;
        for Four { index, weight } in self.now[some].iter().copied() {
            let four = index as usize;
            let now = clock.of_four(four);
            // Steps until something has to be read again, if nothing has to be now.
            let mut left = u32::MAX;
            let mut is_awake = false;
            if is_sampled {
                let [first, others] = known.fours.get(four);
                left = first.until().min(others.until()).saturating_sub(now);
                is_awake = left == 0 || first.in_contact() | others.in_contact() != 0;
            }
            // Below the samples: spheres in reach, and those that have to be read.
            let (mut lanes, mut unknown) = (0, 0);
            if level > 0 {
                let now = clock.of_each(four);
                let spheres = known.spheres.get(four);
                (lanes, unknown) = (spheres.open(now), spheres.unknown(now));
                if lanes == 0 {
                    left = left.min(spheres.left(now));
                }
            }
            // Nothing to do: the sphere around it, in the level above, counts as out of reach until then.
            if !is_awake && lanes == 0 {
                if let Some(above) = &mut above {
                    let until = after(clock_above.of(four), left as f32);
                    above.spheres.get_mut(four / 4).set(four % 4, false, until);
                }
                continue;
            }
            if is_awake {
                let sample = side.samples.four(level, four);
                let [first, others] = known.fours.get(four);
                let half = first_lanes(level, four);
                let awake = [first.awake(half, now), others.awake(15 - half, now)];
                if awake[0] != 0 {
                    self.queue.push(&sample, awake[0]);
                }
                let place = side.cube(&sample);
                self.active.push(Active { index, weight, place, awake: awake.map(|lanes| lanes as u8) });
            }
            if lanes != 0 {
                let [lanes, unknown] = [lanes, unknown].map(|lanes| lanes as u8);
                self.open.push(Open { index, weight, lanes, unknown });
            }
        }
        if is_sampled {
            self.read(side, level, 0, first..self.active.len(), tolerance);
        }
        let is_end = self.is_end(self.now.len());
        if is_end {
            self.now.clear();
        }
        is_end
    }

    /// Adds the samples within reach to the sums of their cubes; each represents an area, as a fraction of a
    /// cell's squared edge.
    pub fn add_to(&self, sampling: &mut Sampling, area: f32) {
        self.touching.iter().for_each(|touch| sampling.add(touch, area));
    }

    /// Adds to the counted area of each sample, by the weight of the present half.
    pub fn count(&mut self, sampling: &Sampling) {
        for touch in &mut self.touching {
            touch.counted += sampling.share(touch.place) * touch.area;
        }
    }

    /// Visits the other two samples of some of the fours, where those read so far are not enough. Returns
    /// whether all have been visited.
    pub fn visit_others(&mut self, side: &Side, level: usize, sampling: &Sampling, tolerance: f64) -> bool {
        if self.next == 0 {
            // Each sample read so far represents half as much now.
            for touch in &mut self.touching {
                touch.area *= 0.5 * (1.0 - sampling.share(touch.place));
            }
        }
        self.queue.clear();
        let some = self.next..(self.next + BATCH).min(self.active.len());
        self.next = some.end;
        for four in &mut self.active[some.clone()] {
            four.weight *= 1.0 - sampling.share(four.place);
            if four.weight == 0.0 {
                four.awake[1] = 0;
            } else if four.awake[1] != 0 {
                self.queue.push(&side.samples.four(level, four.index as usize), four.awake[1].into());
            }
        }
        self.read(side, level, 1, some, tolerance);
        self.is_end(self.active.len())
    }

    /// Whether all of `count` have been visited; then the next visit begins at the first again.
    fn is_end(&mut self, count: usize) -> bool {
        let is_end = self.next == count;
        if is_end {
            self.next = 0;
        }
        is_end
    }

    /// Reads the samples of the queue, the awake ones of one half of each four, and stores which are in
    /// contact and until when the others are not.
    fn read(&mut self, side: &Side, level: usize, half: usize, some: Range<usize>, tolerance: f64) {
        let (known, _) = self.known.level(level);
        self.read[1] += self.queue.finish();
        self.found.clear();
        for point in &self.queue.fours {
            self.found.extend_from_slice(side.inside(point).as_array());
        }
        let per_unit = steps_per(side.field.spacing(), tolerance);
        // The first two of four represent all four.
        let area = if half == 0 { 2.0 } else { 1.0 } * side.area(level);
        let clock = self.clocks.at(level);
        let mut found = self.found.iter();
        let scale = 1.0 / side.reach();
        for four in self.active[some].iter().filter(|four| four.awake[half] != 0) {
            let (mut in_contact, mut nearest) = (0, f32::NEG_INFINITY);
            for (lane, inside) in bits(four.awake[half].into()).zip(&mut found) {
                if *inside > 0.0 {
                    in_contact |= 1 << lane;
                    self.touching.push(Touch {
                        index: 4 * four.index + lane as u32,
                        reach: scale * inside,
                        area: four.weight * area,
                        counted: 0.0,
                        place: four.place,
                    });
                } else {
                    nearest = nearest.max(*inside);
                }
            }
            let index = four.index as usize;
            let known = &mut known.fours.get_mut(index)[half];
            let now = clock.of_four(index);
            let mut until = after(now, (-nearest - SLACK).max(-nearest / MAX_SLOPE) * per_unit);
            if known.until() > now {
                // The others were not read: their reading still holds.
                until = until.min(known.until());
            }
            *known = LastRead::new(in_contact, until);
        }
    }

    /// Selects the samples of the present level with a weight.
    pub fn select(&self, side: &Side, level: usize, to: &mut Selection) {
        for touch in self.touching.iter().filter(|touch| touch.counted > 0.0) {
            let sample = Sample { level: level as u8, index: touch.index };
            to.push(side.samples.point(sample), touch.counted, touch.reach, sample);
        }
    }

    /// Descends from some of the fours to the samples of the next level, where those of this one are not
    /// enough and some may be within reach. Returns whether it has descended from all.
    pub fn descend(&mut self, side: &Side, level: usize, sampling: &Sampling, tolerance: f64) -> bool {
        self.queue.clear();
        let some = self.next..(self.next + BATCH).min(self.open.len());
        self.next = some.end;
        let counts = level <= COARSEST_LEVEL && sampling.counts();
        let spheres = &side.samples.levels[level].spheres;
        let (known, _) = self.known.level(level);
        // Reads the spheres for which it is not known whether they are in reach.
        for four in &mut self.open[some.clone()] {
            let index = four.index as usize;
            if counts {
                four.weight *= sampling.rest(side.cube(&side.samples.four(level, index)));
            }
            if four.weight > 0.0 && four.unknown != 0 {
                let [x, y, z, _] = spheres[index];
                self.queue.push(&[x, y, z], four.unknown.into());
            }
        }
        self.read[0] += self.queue.finish();
        self.found.clear();
        for point in &self.queue.fours {
            self.found.extend_from_slice(side.distances(point).as_array());
        }
        let scale = 1.0 / side.field.spacing() as f32;
        // Above the level of regions, spheres are followed further: each region is near, or so far away that
        // its motion hardly matters.
        let further = if level > self.clocks.level() { NEAR_MARGIN * side.reach() } else { 0.0 };
        let reach = side.reach() + further + SLACK;
        let per_unit = steps_per(side.field.spacing(), tolerance);
        let clock = self.clocks.at(level);
        let mut found = self.found.iter();
        for four in self.open[some].iter_mut().filter(|four| four.weight > 0.0) {
            let index = four.index as usize;
            if four.unknown != 0 {
                let known = known.spheres.get_mut(index);
                for (lane, distance) in bits(four.unknown.into()).zip(&mut found) {
                    let apart = distance - spheres[index][3].as_array()[lane] * scale - reach;
                    let now = clock.of(4 * index + lane);
                    known.set(lane, apart <= 0.0, after(now, apart.abs() * per_unit));
                }
                four.lanes &= known.in_reach() as u8;
            }
            for lane in bits(four.lanes.into()) {
                self.now.push(Four { index: 4 * four.index + lane as u32, weight: four.weight });
            }
        }
        self.is_end(self.open.len())
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.known.bytes()
            + self.queue.bytes()
            + self.found.capacity() * size_of::<f32>()
            + self.now.capacity() * size_of::<Four>()
            + self.active.capacity() * size_of::<Active>()
            + self.open.capacity() * size_of::<Open>()
            + self.touching.capacity() * size_of::<Touch>()
    }
}
