//! The convex features of two surfaces near each other, where guarded points start, and how far the bodies
//! may move before any other feature could touch: first contacts are at convex features alone.
//!
//! Each body's features are in a [hierarchy](palpate_field::FeatureTree) of spheres, and those of long edges
//! in halves of them, and so on. A front through these is followed from query to query. Its regions within
//! reach are starts; the others wait, in the order in which they could touch. A query takes up those whose
//! turn it is: it reads a region's distance from the other surface at its centre, exactly, and makes it a
//! start, divides it, or lets it wait for longer. It does so for a number of readings at most, and what it
//! has not come to bounds the motion by a distance that is proved.

mod feature;
mod flat_run;
mod region;
mod search;

use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashMap};

use foldhash::fast::FixedState;
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::MotionBound;
use palpate_field::{FeatureMesh, Leash, Place};

use self::feature::leash;
pub(crate) use self::feature::{NearFeature, Reaches};
use self::flat_run::{FLAT_STEP, FlatRun};
use self::region::{Region, Sphere, Within, is_long};
use self::search::{Nearest, Reading, Search, Side};

/// Radius of a sphere out of reach from which it is divided, as fractions of its distance and of the smallest
/// cells' edge. With more, the bound on motion is far below the true distance; with less, more distances are
/// read.
const COARSE: (f64, f64) = (0.25, 0.5);

/// The same of a sphere that takes the place of those below it again, as a fraction of its distance.
const MERGED: f64 = 0.5 * COARSE.0;

/// Motion after which a distance out of reach is read again, as a fraction of it. With more, the bound on
/// motion of a body that leaves a surface stays behind the true distance; with less, more distances are read.
const WORN: f64 = 0.15;

/// Distance up to which a start waits where it is, in lengths of the reach. With less, what is at the end of
/// the reach starts anew in each query; with more, there are more starts to go through.
const LEFT: f64 = 2.0;

/// Number of entries of regions that no longer wait beside those that do, from which they are taken out.
const MAX_LOST: usize = 4096;

/// What is known of the distances between two bodies.
#[derive(Clone, Debug, Default)]
pub(crate) struct NearFeatures {
    /// The front, and what is divided above it.
    front: HashMap<Region, State, FixedState>,
    waiting: BinaryHeap<Waiting>,
    starts: Vec<Start>,
    /// Pose of the probe's mesh in the object's frame at the last query, and its cells' and long edges'
    /// lengths, m.
    last: Option<Pose>,
    lengths: (f64, f64),
    /// Sum of the motions from query to query, m.
    moved: f64,
    /// The last of them, m; infinite if it is not known.
    since: f64,
    /// Regions that may take the place of the starts below them in the next query, with hints.
    whole: Vec<(Region, u32)>,
    /// Workspaces: starts to read again, with what is left of their distances, m; those on edges, by bodies,
    /// edges and places on them.
    stale: Vec<(f32, u32)>,
    edges: Vec<(bool, u32, f32, u32)>,
}

/// A region's place in the front.
#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    /// It waits until a motion (m).
    Waiting(f64),
    Start,
    /// The front goes on below it.
    Divided,
}

/// A region that waits.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    /// Motion up to which it does not touch, m.
    until: f64,
    region: Region,
    reading: Reading,
}

/// A region within reach.
#[derive(Clone, Copy, Debug)]
struct Start {
    region: Region,
    reading: Reading,
    sphere: Sphere,
    /// Its nearest feature, and the reading there.
    nearest: Nearest,
    leash: Leash,
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Waiting {}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// What could touch first is the greatest.
impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> Ordering {
        other.until.total_cmp(&self.until).then_with(|| other.region.cmp(&self.region))
    }
}

impl NearFeatures {
    /// Begins a query of a probe and a scene object (surfaces, with their poses). `center` and `radius` (m)
    /// are of a sphere around the probe, in its mesh's frame.
    pub fn begin(
        &mut self,
        (probe, mesh): (&FeatureMesh, &Pose),
        (scene, pose): (&FeatureMesh, &Pose),
        (center, radius): (DVec3, f64),
        reaches: &Reaches,
    ) {
        let to_scene = pose.inverse() * *mesh;
        // No distance between a point of one body and the other surface changes by more than this.
        self.since = self.last.replace(to_scene).map_or(f64::INFINITY, |last| {
            let at = |pose: &Pose| Pose { translation: pose.transform_point(center), ..*pose };
            MotionBound { from: at(&last), radius, ..MotionBound::NONE }.displacement(&at(&to_scene))
        });
        let lengths = (reaches.edge, reaches.long);
        if self.since.is_finite() && lengths == self.lengths {
            self.moved += self.since;
            let search = self.search([probe, scene], reaches, 0);
            self.make_whole(&search);
            self.give_back(&search);
        } else {
            let [low, high] = scene.bounds();
            let at = to_scene.transform_point(center);
            self.start_over([probe, scene], lengths, at.distance(at.clamp(low, high)) - radius);
        }
    }

    /// Goes on with a query, for a number of readings. Returns how far the bodies may move before another
    /// feature could touch than those that are found (m), and how many of the readings are left: any if there
    /// is nothing more to find.
    pub fn go_on(&mut self, surfaces: [&FeatureMesh; 2], reaches: &Reaches, readings: usize) -> (f64, usize) {
        let mut search = self.search(surfaces, reaches, readings);
        let room = self.take_up(&mut search);
        (room, search.left)
    }

    /// Ends a query: reads distances again that are old, as many as given, and passes on the features that
    /// are within reach of each other. Returns how far the bodies may move before one of the others could
    /// touch that were found before, m, and how many of the readings are left.
    pub fn end(
        &mut self,
        surfaces: [&FeatureMesh; 2],
        (reaches, readings): (&Reaches, usize),
        mut to: impl FnMut(&NearFeature),
    ) -> (f64, usize) {
        let mut search = self.search(surfaces, reaches, readings);
        self.read_again(&mut search);
        let left = search.left;
        let mut room = f64::INFINITY;
        self.edges.clear();
        for (index, start) in (0..).zip(&self.starts) {
            let near = start.near(self.moved);
            if near.least > reaches.reach {
                room = room.min(near.least);
            } else if let Place::Edge(edge, at) = near.place {
                self.edges.push((near.is_probe, edge, at, index));
            } else {
                to(&near);
            }
        }
        // Along each edge.
        self.edges.sort_unstable_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)).then(a.2.total_cmp(&b.2)));
        for edge in self.edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let mut run = FlatRun::default();
            for (is_probe, .., index) in edge {
                let near = self.starts[*index as usize].near(self.moved);
                let normal = search.side(*is_probe).other.normal_of(near.hint);
                run.add(near, normal, FLAT_STEP * reaches.edge, &mut to);
            }
            run.end(&mut to);
        }
        (room, left)
    }

    /// A search of a probe's surface and a scene object's.
    fn search<'a>(&self, [probe, scene]: [&'a FeatureMesh; 2], reaches: &Reaches, left: usize) -> Search<'a> {
        let to_scene = self.last.unwrap_or(Pose::IDENTITY);
        let to_probe = to_scene.inverse();
        let side = |own, other, to_other, to_own| Side { own, other, to_other, to_own };
        let sides = [side(scene, probe, to_probe, to_scene), side(probe, scene, to_scene, to_probe)];
        Search { sides, reaches: *reaches, moved: self.moved, left }
    }

    /// Begins anew, with all features of both bodies at a distance of at least `least`, and lengths of cells
    /// and of long edges, m.
    fn start_over(&mut self, surfaces: [&FeatureMesh; 2], lengths: (f64, f64), least: f64) {
        // Those that overlap may be anywhere.
        let until = if least > 0.0 { least } else { f64::NEG_INFINITY };
        self.front.clear();
        self.waiting.clear();
        self.starts.clear();
        self.whole.clear();
        (self.moved, self.lengths) = (0.0, lengths);
        for (surface, is_probe) in surfaces.into_iter().zip([true, false]) {
            let tree = surface.tree();
            let vertices = (!tree.vertices.is_empty()).then_some(Within::Vertices(0));
            let edges = tree.edges.first().filter(|node| is_long(node, lengths.1)).map(|_| Within::Edges(0));
            for within in vertices.into_iter().chain(edges) {
                self.wait(Region { is_probe, within }, until, Reading::from(0));
            }
        }
    }

    fn wait(&mut self, region: Region, until: f64, reading: Reading) {
        self.front.insert(region, State::Waiting(until));
        self.waiting.push(Waiting { until, region, reading });
    }

    /// Lets starts wait that have left the reach, or stand for too much for the distance that is known.
    fn give_back(&mut self, search: &Search<'_>) {
        let Self { starts, front, waiting, moved, .. } = self;
        starts.retain(|start| {
            let least = start.least(*moved);
            let stands = start.sphere.is_single || search.is_small(start.sphere.radius, least);
            let is_kept = stands && least <= LEFT * search.reaches.reach;
            if !is_kept {
                let until = *moved + least;
                front.insert(start.region, State::Waiting(until));
                waiting.push(Waiting { until, region: start.region, reading: start.reading });
            }
            is_kept
        });
    }

    /// Lets regions wait in the place of the starts below them.
    fn make_whole(&mut self, search: &Search<'_>) {
        let mut whole = std::mem::take(&mut self.whole);
        let mut any = false;
        for (region, hint) in whole.drain(..) {
            let below = region.below(search.tree(region), search.reaches.long);
            if !below.iter().all(|below| self.front.get(below) == Some(&State::Start)) {
                continue;
            }
            for below in &below {
                self.front.remove(below);
            }
            // As the starts were within reach, it has its turn at once.
            self.wait(region, self.moved, Reading::from(hint));
            any = true;
        }
        self.whole = whole;
        if any {
            let Self { starts, front, .. } = self;
            starts.retain(|start| front.get(&start.region) == Some(&State::Start));
        }
    }

    /// The region above a start that could take the place of it and of those beside it, as their last
    /// readings are.
    fn whole_of(&self, search: &Search<'_>, start: &Start) -> Option<Region> {
        let tree = search.tree(start.region);
        let above = start.region.above(tree)?;
        let sphere = search.sphere(above);
        let (distance, apart) = start.reading.known(self.moved);
        let least = distance - apart - sphere.center.distance(start.sphere.center) - sphere.extent;
        if !search.is_small(2.0 * sphere.radius, least) || !search.is_one(above, &sphere, least) {
            return None;
        }
        let is_start = |below: &Region| self.front.get(below) == Some(&State::Start);
        above.below(tree, search.reaches.long).iter().all(is_start).then_some(above)
    }

    /// Takes up regions that wait until it is known how far the bodies may move, or no readings are left.
    /// Returns how far that is, m.
    fn take_up(&mut self, search: &mut Search<'_>) -> f64 {
        let Reaches { reach, enough, .. } = search.reaches;
        loop {
            let Some(next) = self.waiting.peek() else { return f64::INFINITY };
            let Waiting { until, region, mut reading } = *next;
            let room = until - self.moved;
            let is_lost = self.front.get(&region) != Some(&State::Waiting(until));
            if !is_lost && (room >= enough || search.left == 0) {
                return room;
            }
            self.waiting.pop();
            if is_lost {
                continue;
            }
            let sphere = search.sphere(region);
            let gone = self.moved - reading.at;
            // What is out of reach is read again where it has moved by much; what may be within, in any case.
            let is_known = gone == 0.0 || room > reach && gone <= WORN * f64::from(reading.distance).abs();
            let mut point = None;
            if !is_known {
                let found = search.read(region.is_probe, sphere.center, reading.hint);
                (reading, point) = (found.0, Some(found.1));
            }
            let (distance, apart) = reading.known(self.moved);
            let least = distance - apart - sphere.extent;
            let until = self.moved + least;
            if least > reach {
                let coarse = (COARSE.0 * least).max(COARSE.1 * search.reaches.edge);
                if least < enough && !sphere.is_single && sphere.radius > coarse {
                    self.divide(search, region, &sphere, &reading);
                } else if is_known {
                    self.wait(region, until, reading);
                    return least;
                } else if !self.merge(search, region, &sphere, &reading) {
                    self.wait(region, until, reading);
                }
                continue;
            }
            if search.is_one(region, &sphere, least) {
                let near =
                    point.unwrap_or_else(|| search.read(region.is_probe, sphere.center, reading.hint).1);
                let nearest = search.nearest(region, &sphere, (&reading, near));
                let leash = leash(sphere.center, sphere.extent);
                self.front.insert(region, State::Start);
                self.starts.push(Start { region, reading, sphere, nearest, leash });
            } else {
                self.divide(search, region, &sphere, &reading);
            }
        }
    }

    /// Lets what is below a region wait in its place.
    fn divide(&mut self, search: &Search<'_>, region: Region, sphere: &Sphere, reading: &Reading) {
        self.front.insert(region, State::Divided);
        let (distance, apart) = reading.known(self.moved);
        for below in region.below(search.tree(region), search.reaches.long) {
            let Sphere { center, extent, .. } = search.sphere(below);
            let least = distance - apart - sphere.extent.min(center.distance(sphere.center) + extent);
            self.wait(below, self.moved + least, Reading::from(reading.hint));
        }
    }

    /// Lets the region above one that is far away wait in its place and in those of the others below, if all
    /// of them wait. Returns whether they do.
    fn merge(&mut self, search: &Search<'_>, region: Region, sphere: &Sphere, reading: &Reading) -> bool {
        let tree = search.tree(region);
        let Some(above) = region.above(tree) else { return false };
        let Sphere { center, radius, extent, .. } = search.sphere(above);
        let (distance, apart) = reading.known(self.moved);
        let least = distance - apart - center.distance(sphere.center) - extent;
        if least <= LEFT * search.reaches.reach || radius > MERGED * least {
            return false;
        }
        let below = above.below(tree, search.reaches.long);
        let waits =
            |below: &Region| *below == region || matches!(self.front.get(below), Some(State::Waiting(_)));
        if !below.iter().all(waits) {
            return false;
        }
        for below in &below {
            self.front.remove(below);
        }
        self.wait(above, self.moved + least, Reading::from(reading.hint));
        if self.waiting.len() > 2 * self.front.len() + MAX_LOST {
            let Self { waiting, front, .. } = self;
            waiting.retain(|entry| front.get(&entry.region) == Some(&State::Waiting(entry.until)));
        }
        true
    }

    /// Reads the distances of starts again that are no longer those of now: with too few readings left, of
    /// those of which the least is left.
    fn read_again(&mut self, search: &mut Search<'_>) {
        let Self { starts, stale, moved, .. } = self;
        stale.clear();
        // What has left the reach bounds the motion, as what waits does.
        let is_stale = |start: &Start| match start.least(*moved) > search.reaches.reach {
            true => *moved - start.reading.at > WORN * f64::from(start.reading.distance),
            false => search.is_stale(&start.reading),
        };
        let left = |start: &Start| start.reading.distance - (*moved - start.reading.at) as f32;
        stale.extend(
            (0..)
                .zip(starts.iter())
                .filter(|(_, start)| is_stale(start))
                .map(|(index, start)| (left(start), index)),
        );
        if stale.len() > search.left {
            stale.select_nth_unstable_by(search.left, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            stale.truncate(search.left);
        }
        let stale = std::mem::take(&mut self.stale);
        for (_, index) in &stale {
            let start = &mut self.starts[*index as usize];
            let region = start.region;
            let (reading, near) = search.read(region.is_probe, start.sphere.center, start.reading.hint);
            start.reading = reading;
            start.nearest = search.nearest(region, &start.sphere, (&reading, near));
            let whole = self.whole_of(search, &self.starts[*index as usize]);
            self.whole.extend(whole.map(|whole| (whole, reading.hint)));
        }
        self.stale = stale;
    }

    /// Motion of the bodies between the last two queries, m; infinite if it is not known.
    pub fn since(&self) -> f64 {
        self.since
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.front.capacity() * size_of::<(Region, State)>()
            + self.waiting.capacity() * size_of::<Waiting>()
            + self.starts.capacity() * size_of::<Start>()
    }
}

impl Start {
    /// Lower bound on the distance of what it stands for, m.
    fn least(&self, moved: f64) -> f64 {
        let (distance, apart) = self.reading.known(moved);
        distance - apart - self.sphere.extent
    }

    fn near(&self, moved: f64) -> NearFeature {
        let Self { nearest: Nearest { place, point, is_tip, reading }, leash, .. } = *self;
        let (distance, apart) = reading.known(moved);
        let (is_probe, hint, least) = (self.region.is_probe, reading.hint, self.least(moved));
        NearFeature { place, is_probe, is_tip, point, distance, apart, least, leash, hint }
    }
}

#[cfg(test)]
mod tests;
