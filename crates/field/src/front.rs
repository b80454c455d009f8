//! What a query knows of one body's samples, and what of them it has yet to look at.

use std::ops::Range;

use wide::f32x4;

use crate::samples::{Sample, SurfaceSamples};
use crate::sampling::{Sampling, Touch};
use crate::selection::Selection;
use crate::side::{Side, bits};
use crate::slack::{Clocks, Known, LastRead, after, steps_per};

/// What interpolated distances may change by more than points are apart, in lattice constants: they bend near creases.
pub const SLACK: f32 = 0.25;
/// Slope of interpolated distances at most, √3 and a little: along each axis they change by no more than the way.
pub const STEEPEST: f32 = 1.74;

/// So many fours are looked at in a step.
const TOGETHER: usize = 128;

/// Levels of samples above this one are not read: too few points to stand for a contact.
pub const COARSEST: usize = 5;

/// Four samples of a level that may be in reach, or something below them.
#[derive(Clone, Copy, Debug)]
struct Four {
    index: u32,
    /// How much of what they push with may count.
    weight: f32,
}

/// Four samples of which some are to be read.
#[derive(Clone, Copy, Debug)]
struct Active {
    index: u32,
    weight: f32,
    /// The cube that the first of them is in.
    place: u32,
    /// Bit by bit: which of them to read, of those that are read first and of the others.
    awake: [u8; 2],
}

/// Four samples with something below them that may be in reach.
#[derive(Clone, Copy, Debug)]
struct Open {
    index: u32,
    weight: f32,
    /// Bit by bit: below which.
    lanes: u8,
    /// Bit by bit: of which that is to be found out.
    unknown: u8,
}

/// Regions that are no further out of reach than this are near, in reaches.
pub const FURTHER: f32 = 2.0;

/// The two of four samples that are read first, bit by bit: one of the first two, one of the last two, at random.
#[inline]
fn first_lanes(level: usize, four: usize) -> u32 {
    const EACH: [u32; 4] = [0b0101, 0b1001, 0b0110, 0b1010];
    let hash = (four as u32 ^ (level as u32) << 27).wrapping_mul(0x9E37_79B9);
    EACH[(hash >> 30) as usize]
}

/// Points that wait to be read, in the body's frame, m: four at a time, and those that do not make up four.
#[derive(Clone, Debug)]
struct Queue {
    fours: Vec<[f32x4; 3]>,
    rest: [[f32; 4]; 3],
    count: usize,
}

impl Queue {
    fn with_capacity(fours: usize) -> Self {
        Self { fours: Vec::with_capacity(fours), rest: [[0.0; 4]; 3], count: 0 }
    }

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

    /// All of the points, the last repeated so that there are only whole fours; how many there were.
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
    /// Of the present level, and of the next after [`Self::descend`].
    now: Vec<Four>,
    /// The first that has not been looked at: of them, or of what is active or open.
    next: usize,
    active: Vec<Active>,
    open: Vec<Open>,
    queue: Queue,
    /// Of each point of the queue, how far inside of reach it is, in lattice constants.
    found: Vec<f32>,
    /// Within reach, of the present level.
    touching: Vec<Touch>,
    /// Readings of spheres and of samples so far.
    pub read: [usize; 2],
    /// Fours looked at so far.
    pub visited: usize,
}

impl Front {
    pub fn new(samples: &SurfaceSamples) -> Self {
        const USUAL: usize = 4096;
        Self {
            known: Known::new(samples),
            clocks: Clocks::new(samples),
            now: Vec::with_capacity(USUAL),
            next: 0,
            active: Vec::with_capacity(USUAL),
            open: Vec::with_capacity(USUAL),
            queue: Queue::with_capacity(USUAL),
            found: Vec::with_capacity(2 * USUAL),
            touching: Vec::with_capacity(2 * USUAL),
            read: [0; 2],
            visited: 0,
        }
    }

    /// Nothing is known any more.
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

    /// The fours of the present level that are to be looked at.
    pub fn now(&self) -> impl Iterator<Item = u32> {
        self.now.iter().map(|four| four.index)
    }

    /// Looks at some of the fours of a level: reads the first two samples of each where they may be in contact, and leaves fours out
    /// that neither are nor have anything in reach below them. Returns whether it has looked at all of them.
    pub fn visit(&mut self, side: &Side, level: usize, tolerance: f64) -> bool {
        if self.next == 0 {
            self.touching.clear();
            self.active.clear();
            self.open.clear();
        }
        self.queue.clear();
        let first = self.active.len();
        let some = self.next..(self.next + TOGETHER).min(self.now.len());
        self.visited += some.len();
        self.next = some.end;
        let (known, mut above) = self.known.level(level);
        let (clock, clock_above) = (self.clocks.at(level), self.clocks.at(level + 1));
        let is_sampled = level <= COARSEST;
        for Four { index, weight } in self.now[some].iter().copied() {
            let four = index as usize;
            let now = clock.of_four(four);
            // Steps until something is to be looked at again, if nothing is now.
            let mut left = u32::MAX;
            let mut is_awake = false;
            if is_sampled {
                let [first, others] = known.fours[four];
                left = first.until().min(others.until()).saturating_sub(now);
                is_awake = left == 0 || first.in_contact() | others.in_contact() != 0;
            }
            let (mut lanes, mut unknown) = (0, 0);
            if level > 0 {
                let now = clock.of_each(four);
                let spheres = known.spheres[four];
                (lanes, unknown) = (spheres.open(now), spheres.unknown(now));
                if lanes == 0 {
                    left = left.min(spheres.left(now));
                }
            }
            if !is_awake && lanes == 0 {
                if let Some(above) = &mut above {
                    let until = after(clock_above.of(four), left as f32);
                    above.spheres[four / 4].set(four % 4, false, until);
                }
                continue;
            }
            if is_awake {
                let sample = side.samples.four(level, four);
                let [first, others] = known.fours[four];
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

    /// Adds the samples within reach to those of each cube; each of them stands for an area, as a part of a cell's squared edge.
    pub fn add_to(&self, sampling: &mut Sampling, area: f32) {
        self.touching.iter().for_each(|touch| sampling.add(touch, area));
    }

    /// Counts as much of each sample as there is enough of them.
    pub fn count(&mut self, sampling: &Sampling) {
        for touch in &mut self.touching {
            touch.counted += sampling.share(touch.place) * touch.area;
        }
    }

    /// Goes on to the other two samples of some of the fours, where there are not enough of those read so far. Returns whether it has
    /// looked at all of them.
    pub fn visit_others(&mut self, side: &Side, level: usize, sampling: &Sampling, tolerance: f64) -> bool {
        if self.next == 0 {
            // Each of those read so far stands for half as much now.
            for touch in &mut self.touching {
                touch.area *= 0.5 * (1.0 - sampling.share(touch.place));
            }
        }
        self.queue.clear();
        let some = self.next..(self.next + TOGETHER).min(self.active.len());
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

    /// Whether all of so many have been looked at; then the next look begins at the first again.
    fn is_end(&mut self, count: usize) -> bool {
        let is_end = self.next == count;
        if is_end {
            self.next = 0;
        }
        is_end
    }

    /// Reads the samples of the queue, which are those that are awake of one half of each four, and notes which are in contact and until
    /// when the others are not.
    fn read(&mut self, side: &Side, level: usize, half: usize, some: Range<usize>, tolerance: f64) {
        let (known, _) = self.known.level(level);
        self.read[1] += self.queue.finish();
        self.found.clear();
        for point in &self.queue.fours {
            self.found.extend_from_slice(side.inside(point).as_array());
        }
        let per_unit = steps_per(side.field.spacing(), tolerance);
        // The first two of four stand for all.
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
            let known = &mut known.fours[index][half];
            let now = clock.of_four(index);
            let mut until = after(now, (-nearest - SLACK).max(-nearest / STEEPEST) * per_unit);
            if known.until() > now {
                // The others were left alone.
                until = until.min(known.until());
            }
            *known = LastRead::new(in_contact, until);
        }
    }

    /// Selects those samples of the present level that count.
    pub fn select(&self, side: &Side, level: usize, to: &mut Selection) {
        for touch in self.touching.iter().filter(|touch| touch.counted > 0.0) {
            let sample = Sample { level: level as u8, index: touch.index };
            to.push(side.samples.point(sample), touch.counted, touch.reach, sample);
        }
    }

    /// Goes on from some of the fours to the samples of the next level, where there are not enough of this one and there may be some
    /// within reach. Returns whether it has gone on from all of them.
    pub fn descend(&mut self, side: &Side, level: usize, sampling: &Sampling, tolerance: f64) -> bool {
        self.queue.clear();
        let some = self.next..(self.next + TOGETHER).min(self.open.len());
        self.next = some.end;
        let counts = level <= COARSEST && sampling.counts();
        let spheres = &side.samples.levels[level].spheres;
        let (known, _) = self.known.level(level);
        // Of which it has to be found out first whether they are in reach.
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
        // Regions are looked at that are further away: each is near, or so far away that it matters little how far it moves.
        let further = if level > self.clocks.level() { FURTHER * side.reach() } else { 0.0 };
        let reach = side.reach() + further + SLACK;
        let per_unit = steps_per(side.field.spacing(), tolerance);
        let clock = self.clocks.at(level);
        let mut found = self.found.iter();
        for four in self.open[some].iter_mut().filter(|four| four.weight > 0.0) {
            let index = four.index as usize;
            if four.unknown != 0 {
                let known = &mut known.spheres[index];
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
