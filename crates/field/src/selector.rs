//! Selects the samples of the surfaces that a query reads.
//!
//! They are selected at one pose, and serve at all poses around it. In the meantime the next selection is made step by step, at a
//! later pose, so that no query has to make a whole one while the bodies move steadily.

use std::time::{Duration, Instant};

use palpate_core::Pose;
use palpate_core::glam::DVec3;

use crate::front::{COARSEST, Front};
use crate::sampling::Sampling;
use crate::selection::{Held, Selection};
use crate::side::Side;
use crate::slack::Motion;

/// What is done next of a level of samples, side by side.
#[derive(Clone, Copy, Debug)]
enum Stage {
    /// Reads the first two of each four samples.
    First(usize),
    /// Reads the others, where they are needed.
    Others(usize),
    /// Goes on to the next level.
    Descent(usize),
}

/// Makes selections, from the coarsest samples to the finest, in steps.
#[derive(Clone, Debug)]
pub struct Selector {
    motion: Motion,
    fronts: [Front; 2],
    sampling: Sampling,
    /// The pose that a selection is being made at, probe to scene object.
    pose: Option<Pose>,
    level: usize,
    stage: Stage,
    is_done: bool,
    /// From when there is a limit of time, that limit, and how long it took to the end of the last level.
    limit: Option<(Instant, Duration)>,
    last: Duration,
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
            last: Duration::ZERO,
            is_complete: true,
            selections: [0; 2].map(|_| Selection::new()),
        }
    }

    /// Forgets where the bodies were, and what was begun.
    pub fn reset(&mut self) {
        self.motion.reset();
        self.pose = None;
        self.is_done = false;
    }

    /// The pose that a selection is being made at.
    pub fn pose(&self) -> Option<&Pose> {
        self.pose.as_ref()
    }

    /// Begins at a pose of the probe, whose surface is within a sphere (center, radius), m. Surfaces within a distance (m) of each other
    /// are selected; the sides are those at the pose.
    pub fn begin(&mut self, pose: &Pose, (center, radius): (DVec3, f64), reach: f64, sides: &[Side; 2]) {
        let changes = self.motion.advance(pose, center, radius, reach);
        let mut fronts = self.fronts.iter_mut().zip(sides).zip(changes);
        if !fronts.all(|((front, side), change)| front.clocks.advance(side.samples, &change)) {
            // They have moved too far to count.
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

    /// Leaves the finest samples out of the selection that has been begun, for which there is no time by a limit: from when, and how long.
    pub fn limit(&mut self, limit: Option<(Instant, Duration)>) {
        (self.limit, self.last) = (limit, Duration::ZERO);
    }

    /// Goes on by a step, at the pose that was begun at and with the same sides and reach (m). So many samples within reach are needed
    /// around each place.
    pub fn step(&mut self, sides: &[Side; 2], reach: f64, needed: f32) {
        let Self { fronts, sampling, level, .. } = self;
        let level = *level;
        let is_sampled = level <= COARSEST;
        // Bodies of different sizes begin at levels of their own, and end together.
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

    /// Decides how much counts of the samples of a level, and selects them.
    fn end_level(&mut self, sides: &[Side; 2], needed: f32) {
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
        if let Some((begun, budget)) = self.limit.filter(|_| level > 0) {
            // The next level takes about as long as all before it.
            let spent = begun.elapsed();
            if spent + spent.saturating_sub(self.last) > budget {
                self.is_complete = sampling.end();
            }
            self.last = spent;
        }
        let fronts = fronts.iter_mut().zip(sides).zip(&mut self.selections);
        for ((front, side), selection) in fronts {
            front.count(sampling);
            front.select(side, level, selection);
        }
    }

    /// The level of each body whose samples stand for a region each; 0 where there are no regions.
    pub fn region_levels(&self) -> [usize; 2] {
        self.fronts.each_ref().map(|front| front.clocks.level())
    }

    /// Hands the finished selection over, and takes another's memory.
    pub fn finish(&mut self, to: &mut Held) {
        std::mem::swap(&mut self.selections, &mut to.sides);
        to.at = self.pose.take();
        self.is_done = false;
        to.changes = None;
    }

    /// Whether a selection waits to be handed over.
    pub fn is_done(&self) -> bool {
        self.is_done
    }

    /// Whether all samples were selected that there are to be; not so where there was no time.
    pub fn is_complete(&self) -> bool {
        self.is_complete
    }

    /// Readings of spheres and of samples since the present selection was begun.
    pub fn read(&self) -> [usize; 2] {
        [0, 1].map(|kind| self.fronts.iter().map(|front| front.read[kind]).sum())
    }

    /// What has been done of the present selection, in about the work of reading one sample.
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
