//! Selects the samples of the surfaces that a query reads.
//!
//! A selection is made at one pose and holds at all poses around it. Meanwhile the next selection is made
//! step by step, at a later pose, so that no query has to make a whole one while the bodies move steadily.

use std::time::{Duration, Instant};

use palpate_core::Pose;
use palpate_core::glam::DVec3;

use crate::front::{COARSEST_LEVEL, Front};
use crate::sampling::Sampling;
use crate::selection::{Held, Selection};
use crate::side::Side;
use crate::slack::Motion;

/// The next stage of a level of samples; its number is the side.
#[derive(Clone, Copy, Debug)]
enum Stage {
    /// Reads the first two of each four samples.
    First(usize),
    /// Reads the others, where they are needed.
    Others(usize),
    /// Goes on to the next level.
    Descent(usize),
}

/// What a selection may take from now until it has to be finished.
#[derive(Clone, Copy, Debug)]
pub struct Limit {
    /// Work, as that of [`Selector::effort`].
    pub effort: usize,
    /// Start and length of the time, if that is limited.
    pub time: Option<(Instant, Duration)>,
}

/// A maker of selections, from the coarsest samples to the finest, in steps.
#[derive(Clone, Debug)]
pub struct Selector {
    motion: Motion,
    fronts: [Front; 2],
    sampling: Sampling,
    /// Pose of the selection in progress, probe to scene object.
    pose: Option<Pose>,
    level: usize,
    stage: Stage,
    is_done: bool,
    limit: Option<Limit>,
    /// Work that had been done when the limit was set.
    limited_at: usize,
    is_complete: bool,
    selections: [Selection; 2],
}

impl Selector {
    pub fn new(fronts: [Front; 2], across: u32) -> Self {
        Self {
            motion: Motion::new(),
            fronts,
            sampling: Sampling::new(across),
            pose: None,
            level: 0,
            stage: Stage::First(0),
            is_done: false,
            limit: None,
            limited_at: 0,
            is_complete: true,
            selections: [0; 2].map(|_| Selection::new()),
        }
    }

    /// Forgets the last pose and the selection in progress.
    pub fn reset(&mut self) {
        self.motion.reset();
        self.pose = None;
        self.is_done = false;
    }

    /// Pose of the selection in progress.
    pub fn pose(&self) -> Option<&Pose> {
        self.pose.as_ref()
    }

    /// Begins a selection at a pose of the probe, whose surface is within a sphere (center, radius), m.
    /// Selects surfaces within `reach` (m) of each other; the sides are those at the pose.
    pub fn begin(&mut self, pose: &Pose, (center, radius): (DVec3, f64), reach: f64, sides: &[Side; 2]) {
        let changes = self.motion.advance(pose, center, radius, reach);
        let mut fronts = self.fronts.iter_mut().zip(sides).zip(changes);
        if !fronts.all(|((front, side), change)| front.clocks.advance(side.samples, &change)) {
            // The clocks would overflow.
            self.fronts.iter_mut().for_each(Front::forget);
        }
        self.fronts.iter_mut().zip(sides).for_each(|(front, side)| front.begin(side.samples));
        self.selections.iter_mut().for_each(Selection::clear);
        self.sampling.clear();
        self.pose = Some(*pose);
        self.level = sides.iter().map(|side| side.samples.levels.len()).max().unwrap_or(0) - 1;
        (self.stage, self.is_done) = (Stage::First(0), false);
        (self.limit, self.is_complete) = (None, true);
    }

    /// Limits the selection in progress: it leaves out the finest samples beyond that.
    pub fn limit(&mut self, limit: Limit) {
        (self.limit, self.limited_at) = (Some(limit), self.effort());
    }

    /// Whether the limit is too near for the next level of samples, which takes about as long as all before
    /// it.
    fn is_at_limit(&self) -> bool {
        let effort = self.effort();
        self.limit.is_some_and(|Limit { effort: limit, time }| {
            2 * effort - self.limited_at > limit
                || time.is_some_and(|(begun, length)| 2 * begun.elapsed() > length)
        })
    }

    /// Advances the selection in progress by a step, with the same sides and reach (m) as it began with.
    /// `needed` is the number of samples within reach needed around each place.
    pub fn step(&mut self, sides: &[Side; 2], reach: f64, needed: f32) {
        let Self { fronts, sampling, level, .. } = self;
        let level = *level;
        let is_sampled = level <= COARSEST_LEVEL;
        // Bodies with different numbers of levels begin at different times, and end together.
        let has_level = |side: &Side| level < side.samples.levels.len();
        match self.stage {
            Stage::First(side) => {
                if has_level(&sides[side]) {
                    if level == fronts[side].clocks.level() {
                        self.selections[side].near.clear();
                        self.selections[side].near.extend(fronts[side].now());
                    }
                    if !fronts[side].visit(&sides[side], level, reach) {
                        return;
                    }
                }
                if side == 0 {
                    self.stage = Stage::First(1);
                } else if is_sampled {
                    for (front, side) in fronts.iter().zip(sides).filter(|(_, side)| has_level(side)) {
                        front.add_to(sampling, 2.0 * side.area(level));
                    }
                    sampling.settle(needed, 0);
                    fronts.iter_mut().for_each(|front| front.count(sampling));
                    self.stage = Stage::Others(0);
                } else {
                    self.stage = Stage::Descent(0);
                }
            }
            Stage::Others(side) => {
                if has_level(&sides[side]) && !fronts[side].visit_others(&sides[side], level, sampling, reach)
                {
                    return;
                }
                if side == 0 {
                    self.stage = Stage::Others(1);
                } else {
                    self.end_level(sides, needed);
                    self.stage = Stage::Descent(0);
                    self.is_done = level == 0 || self.sampling.is_ended();
                }
            }
            Stage::Descent(side) => {
                if has_level(&sides[side]) && !fronts[side].descend(&sides[side], level, sampling, reach) {
                    return;
                }
                if side == 0 {
                    self.stage = Stage::Descent(1);
                } else {
                    self.level -= 1;
                    self.stage = Stage::First(0);
                }
            }
        }
    }

    /// Sets the weights of the samples of a level, and selects them.
    fn end_level(&mut self, sides: &[Side; 2], needed: f32) {
        let is_at_limit = self.is_at_limit();
        let Self { fronts, sampling, level, .. } = self;
        let level = *level;
        for (front, side) in fronts.iter().zip(sides).filter(|(_, side)| level < side.samples.levels.len()) {
            front.add_to(sampling, side.area(level));
        }
        if level > 0 {
            sampling.settle(needed, 1);
        } else {
            sampling.end();
        }
        if level > 0 && is_at_limit {
            self.is_complete = sampling.end();
        }
        let fronts = fronts.iter_mut().zip(sides).zip(&mut self.selections);
        for ((front, side), selection) in fronts {
            front.count(sampling);
            front.select(side, level, selection);
        }
    }

    /// The level of each body whose samples represent a region each; 0 if there are no regions.
    pub fn region_levels(&self) -> [usize; 2] {
        self.fronts.each_ref().map(|front| front.clocks.level())
    }

    /// Moves the finished selection into `to`, and reuses the memory that was there.
    pub fn finish(&mut self, to: &mut Held) {
        std::mem::swap(&mut self.selections, &mut to.sides);
        to.at = self.pose.take();
        to.is_complete = self.is_complete;
        self.is_done = false;
        to.changes = None;
    }

    /// Whether a selection is finished and waits for [`finish`](Self::finish).
    pub fn is_done(&self) -> bool {
        self.is_done
    }

    /// Numbers of readings of spheres and of samples for the selection in progress.
    pub fn read(&self) -> [usize; 2] {
        [0, 1].map(|kind| self.fronts.iter().map(|front| front.read[kind]).sum())
    }

    /// Work on the selection in progress, in units of about one reading of a sample.
    pub fn effort(&self) -> usize {
        let visited: usize = self.fronts.iter().map(|front| front.visited).sum();
        2 * visited + self.read().iter().sum::<usize>()
    }

    /// Cubes along each axis of the probe's surroundings.
    pub fn across(&self) -> u32 {
        self.sampling.across()
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.sampling.bytes()
            + self.fronts.iter().map(Front::bytes).sum::<usize>()
            + self.selections.iter().map(Selection::bytes).sum::<usize>()
    }
}
