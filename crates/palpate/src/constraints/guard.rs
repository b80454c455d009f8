//! The contact loop's part of contacts as constraints: which points of the surfaces the haptic loop has to
//! guard, and how far the body may move before it could touch another one.
//!
//! Points start at the nearest convex feature in each small cell of the region of contact, and at each tip
//! there. Each descends to a local minimum of the distance between the surfaces.

use std::cmp::Ordering;
use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::sync::Arc;

use arrayvec::ArrayVec;
use foldhash::fast::FixedState;
use palpate_core::Pose;
use palpate_core::glam::{DVec3, Vec3};
use palpate_dynamics::MAX_CONSTRAINTS;
use palpate_field::{FeatureMesh, Leash, Place};

use super::geometry::{ContactGeometry, MAX_OBJECTS, MAX_POINTS, MAX_RESERVES, NearObject, in_turn};
use super::guarded_point::{Frames, GuardedPoint, PlaceKey, Reserve};
use super::near_features::NearFeature;

/// Distance of surfaces up to which the finest cells are smallest, in edges of theirs; beyond it they grow.
/// With less, points that are soon needed are missing; with more, there are more points.
const NEAR: f32 = 4.0;

/// Number of cells of tips along the edge of another, and along their distance if that is longer. With fewer,
/// tips beside each other are one; with more, there are more points.
const TIPS: f32 = 8.0;

/// Largest growth: cells as large as the first, second or third power of the distance. With less, cells are
/// large where surfaces are near each other; with more, few points are left of a surface that is far.
const MAX_GROWTH: u32 = 3;

/// Largest number of points that near. With more, steps take longer in close fits; with fewer, surfaces that
/// lie along each other touch between points.
const MAX_NEAR: usize = 3 * MAX_CONSTRAINTS / 2;

/// Number of times that the distance from which they grow is halved, before their edge is doubled. With
/// fewer, cells of close fits hide places; with more, those of surfaces a little apart do.
const MAX_HALVINGS: u32 = 2;

/// Coarseness from which their edge is doubled.
const COARSE: u32 = MAX_GROWTH - 1 + MAX_HALVINGS;

/// Largest coarseness of cells.
const MAX_COARSENESS: u32 = 12;

/// Largest number of cells whose points are made, some of which come out as the same. With more, a query
/// takes longer.
const MAX_CELLS: usize = 2 * MAX_POINTS;

/// The same for points that near.
const MAX_NEAR_CELLS: usize = 3 * MAX_NEAR;

/// Largest distance of a point over that of a start in its cell, in edges of the smallest cells, with which
/// it goes on from the last query. With less, points are searched anew that do not have to be; with more,
/// they miss surfaces that have come nearer.
const MAX_LATER: f64 = 0.02;

/// Motion since a point has descended up to which it stays where it is, in its distance. With more, points of
/// far surfaces lag behind their minima; with less, queries take longer.
const STALE: f64 = 0.25;

/// Length of a point's leash, in that of its cell, up to which it goes on from the last query. With more,
/// points of finer cells leave them; with less, points are searched anew that do not have to be.
const LONGER: f32 = 2.0;

/// Share of the room for points that finer cells have to fit in. With more, queries try finer cells in vain;
/// with less, cells stay coarse.
const FINER: f64 = 0.9;

/// Share of a point's slack from which that of its start need not be known better. With more, starts are
/// measured that do not have to be; with less, steps measure more of them.
const KNOWN: f32 = 0.8;

/// Bit of the keys of features.
const FEATURE: u64 = 1 << 63;

/// Starts that there is room for from the start: those of close fits.
const RESERVED_STARTS: usize = 32_768;

/// The same for points and cells.
const RESERVED: usize = 2048;

/// Number of lists of points for which room is reserved: more than wait for the haptic loop.
const RESERVED_HANDED: usize = 16;

/// A place at which a guarded point may start.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    on: Place,
    /// Whether it is on the body in the hand, or on the scene object.
    is_probe: bool,
    /// Whether its neighbours do not stand for it.
    is_tip: bool,
    /// Index of the scene object among those near, and its place in the scene.
    object: (u8, u16),
    /// Number of the axis that the normal, or the edge, is nearest to; starts nearby are told apart by it.
    side: u8,
    /// Centre and length of its point's leash, in its own body's frame, m.
    home: Vec3,
    leash: f32,
    /// Distance from the other surface, and by how much that may be off, m.
    distance: f32,
    apart: f32,
    /// Lower bound on the distance of the features that it stands for, m.
    least: f32,
    /// Index of its cell among those chosen.
    cell: u32,
    /// Hint for a search of the other surface from there.
    hint: u32,
    /// Place from the body's centre of mass, in its axes, m.
    at: Vec3,
}

/// The nearest start of a cell, which stands for the others in it.
#[derive(Clone, Copy, Debug)]
struct Chosen {
    /// Its index, and key of the cell.
    start: u32,
    key: u64,
    /// Those of [`Start`], for all starts in the cell, m.
    distance: f32,
    leash: Leash,
    least: f32,
    /// Largest distance of the tips in the cell, where they are far from the other surface, m.
    hidden: f32,
}

/// The workspace.
#[derive(Debug, Default)]
pub(crate) struct Guard {
    pub starts: Vec<Start>,
    /// Motion since the last query relative to each object near, m; infinite if it is not known.
    pub since: ArrayVec<f64, MAX_OBJECTS>,
    /// Indices of the chosen starts of the cells.
    cells: HashMap<u64, u32, FixedState>,
    chosen: Vec<Chosen>,
    /// Coarseness of the last query's cells.
    coarseness: u32,
    /// Share of the cells that are left as points, and of those that near: for each coarseness that was
    /// tried.
    left: [Option<(f64, f64)>; MAX_COARSENESS as usize + 1],
    points: Vec<GuardedPoint>,
    /// Places of points that are among them.
    places: HashSet<PlaceKey, FixedState>,
    /// Where they started.
    reserves: Vec<Reserve>,
    /// Lists of geometries that the haptic loop has, or has had.
    handed_points: Handed<GuardedPoint>,
    handed_reserves: Handed<Reserve>,
    known: Known,
}

/// Lists that were handed over. They are kept, so that those who read them never free them.
#[derive(Debug)]
struct Handed<T>(Vec<Arc<Vec<T>>>);

impl<T> Default for Handed<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> Handed<T> {
    fn new() -> Self {
        Self(Vec::with_capacity(RESERVED_HANDED))
    }

    /// A list for at most so many: one that is no longer read, or a new one.
    fn take(&mut self, most: usize) -> Arc<Vec<T>> {
        let free = self.0.iter_mut().position(|list| Arc::get_mut(list).is_some());
        free.map_or_else(|| Arc::new(Vec::with_capacity(most)), |free| self.0.swap_remove(free))
    }
}

/// Points of a query, by the features and the cells that they started from.
#[derive(Debug, Default)]
struct PointsByStart {
    points: Vec<KnownPoint>,
    indices: HashMap<u64, u32, FixedState>,
}

/// A point with the motion of the bodies since it has descended, m.
#[derive(Clone, Copy, Debug)]
struct KnownPoint {
    point: GuardedPoint,
    gone: f64,
}

/// Points of the last query, from which those of the next one start.
#[derive(Debug, Default)]
struct Known {
    last: PointsByStart,
    /// Those of this query.
    next: PointsByStart,
    /// The surfaces that they are on by their places in the scene, and the cells' coarseness.
    objects: ArrayVec<(usize, Arc<FeatureMesh>), MAX_OBJECTS>,
    coarseness: u32,
}

/// Sizes of cells. The coarser, the faster they first grow with the distance, and then from nearer; then the
/// smallest are doubled.
#[derive(Clone, Copy, Debug)]
struct Cells {
    /// Edge of the smallest, m.
    edge: f64,
    /// Power of the distance that they are as large as, where they grow.
    growth: u32,
    /// Distance of surfaces up to which they are smallest, in edges.
    near: f32,
}

impl Cells {
    /// Cells of a coarseness, of which the finest have an edge (m).
    fn new(edge: f64, coarseness: u32) -> Self {
        let growth = (1 + coarseness).min(MAX_GROWTH);
        let halvings = (1 + coarseness - growth).min(MAX_HALVINGS);
        let doublings = 1 + coarseness - growth - halvings;
        Self { edge: edge * f64::from(1 << doublings), growth, near: NEAR / (1 << halvings) as f32 }
    }
}

impl PointsByStart {
    fn new() -> Self {
        Self {
            points: Vec::with_capacity(RESERVED),
            indices: HashMap::with_capacity_and_hasher(2 * RESERVED, FixedState::default()),
        }
    }

    fn clear(&mut self) {
        self.points.clear();
        self.indices.clear();
    }

    fn get(&self, key: u64) -> Option<&KnownPoint> {
        self.points.get(*self.indices.get(&key)? as usize)
    }

    fn insert(&mut self, keys: [u64; 2], point: KnownPoint) {
        let index = self.points.len() as u32;
        self.points.push(point);
        self.indices.extend(keys.map(|key| (key, index)));
    }
}

impl KnownPoint {
    /// The point after a further motion of the bodies (m), where it need not descend again: those that it
    /// stands for are at least at a distance `least` (m).
    fn gone_on(&self, object: u8, since: f64, least: f32) -> Self {
        let Self { mut point, gone } = *self;
        point.go(object, since, least);
        Self { point, gone: gone + since }
    }

    /// Whether it is far away for the motion since it has descended, and beyond a distance `near` (m).
    fn is_fresh(&self, near: f64) -> bool {
        let slack = f64::from(self.point.slack);
        slack > near && self.gone <= STALE * slack
    }
}

impl Known {
    fn new() -> Self {
        Self {
            last: PointsByStart::new(),
            next: PointsByStart::new(),
            objects: ArrayVec::new(),
            coarseness: 0,
        }
    }

    fn step(&mut self) {
        std::mem::swap(&mut self.last, &mut self.next);
        self.next.clear();
    }

    /// Forgets points if another object is in the place of one that they are on, and the cells that they
    /// started in if there are other ones now.
    fn keep(&mut self, objects: &[NearObject], coarseness: u32) {
        let is_other = |near: &NearObject| {
            let known = self.objects.iter().find(|(place, _)| *place == near.place);
            known.is_some_and(|(_, surface)| !Arc::ptr_eq(surface, &near.surface))
        };
        if objects.iter().any(is_other) {
            self.last.clear();
        }
        if self.coarseness != coarseness {
            self.last.indices.retain(|key, _| *key >= FEATURE);
        }
        self.objects = objects.iter().map(|near| (near.place, Arc::clone(&near.surface))).collect();
        self.coarseness = coarseness;
    }
}

/// Limits on the guarded points of a geometry.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Edge of the smallest cells, m.
    pub edge: f64,
    /// Distance within which at most [`MAX_NEAR`] points are, since a step may meet all of them, m.
    pub near: f64,
    /// How far the body is to be able to move, m.
    pub room: f64,
}

/// How far the body is to be able to move with cells of a coarseness, m: the coarser they are, the less.
fn room_at(coarseness: u32, limits: &Limits) -> f64 {
    match coarseness.checked_sub(COARSE) {
        Some(doublings) => limits.room / f64::from(1 << doublings),
        None => f64::INFINITY,
    }
}

impl Start {
    /// A start at a feature near the object at a place in the scene, at a position from the probe's centre
    /// of mass in its axes (m), with a direction there: the normal out of the feature, or that of an edge.
    pub fn new(near: &NearFeature, place_of_object: usize, (at, direction): (DVec3, DVec3)) -> Self {
        let axis = direction.abs().max_position();
        let side = 2 * axis as u8 + u8::from(direction[axis] < 0.0);
        let NearFeature { place, is_probe, is_tip, hint, .. } = *near;
        let NearFeature { distance, apart, least, leash, .. } = *near;
        let [distance, apart, least] = [distance, apart, least].map(|of| of as f32);
        let home = leash.home.as_vec3();
        // By how much its centre is off.
        let leash = leash.length + leash.home.distance(home.as_dvec3()) as f32;
        let object = (0, place_of_object as u16);
        Self {
            on: place,
            is_probe,
            is_tip,
            object,
            side,
            home,
            leash,
            distance,
            apart,
            least,
            cell: 0,
            hint,
            at: at.as_vec3(),
        }
    }

    /// A key for the feature itself, which no cell has.
    fn feature(&self) -> u64 {
        let (feature, is_edge) = match self.on {
            Place::Vertex(vertex) => (vertex, 0),
            Place::Edge(edge, at) => (edge ^ at.to_bits().rotate_left(16), 1),
        };
        let kind = u64::from(self.is_probe) << 1 | is_edge;
        FEATURE | kind << 61 | u64::from(self.object.1) << 32 | u64::from(feature)
    }

    fn leash(&self) -> Leash {
        Leash { home: self.home.as_dvec3(), length: self.leash }
    }

    /// A lower bound on the distance of the features that it stands for, m.
    pub fn least(&self) -> f64 {
        self.least.into()
    }

    /// The cell. Those that are 4096 edges apart have the same key.
    fn cell(&self, cells: &Cells) -> u64 {
        let edge = cells.edge as f32;
        let size = (cells.growth * ((self.distance / (cells.near * edge)).max(1.0) as u32).ilog2()).min(8);
        if !self.is_tip && self.leash > edge * (1 << size) as f32 {
            // It stands for more than a cell.
            return self.feature();
        }
        // Of tips, only those that are very near each other for their distance are one.
        let (parts, size) = if self.is_tip {
            (TIPS, ((self.distance / edge).max(1.0) as u32).ilog2().min(15))
        } else {
            (1.0, size)
        };
        let scale = parts / (edge * (1 << size) as f32);
        let [x, y, z] = (self.at * scale).floor().to_array().map(|at| (at as i32 & 0xFFF) as u64);
        let is_on_edge = matches!(self.on, Place::Edge(..));
        let kind = u64::from(self.is_probe) | u64::from(is_on_edge) << 1 | u64::from(self.is_tip) << 2;
        let others = [(u64::from(self.side), 3), (size.into(), 4), (kind, 3), (u64::from(self.object.1), 16)];
        others.iter().fold(x << 24 | y << 12 | z, |key, (part, bits)| key << bits | part)
    }
}

/// The nearest points first.
fn order(a: &GuardedPoint, b: &GuardedPoint) -> Ordering {
    a.slack.total_cmp(&b.slack).then_with(|| a.place_key().cmp(&b.place_key()))
}

impl Guard {
    pub fn new() -> Self {
        Self {
            starts: Vec::with_capacity(RESERVED_STARTS),
            since: ArrayVec::new(),
            cells: HashMap::with_capacity_and_hasher(RESERVED, FixedState::default()),
            coarseness: 0,
            left: [None; MAX_COARSENESS as usize + 1],
            chosen: Vec::with_capacity(RESERVED),
            places: HashSet::with_capacity_and_hasher(RESERVED, FixedState::default()),
            points: Vec::with_capacity(RESERVED),
            reserves: Vec::with_capacity(MAX_RESERVES),
            handed_points: Handed::new(),
            handed_reserves: Handed::new(),
            known: Known::new(),
        }
    }

    /// Slack of the nearest point of the last query, m.
    pub fn nearest(&self) -> f64 {
        self.points.first().map_or(f64::INFINITY, |point| point.slack.into())
    }

    /// Edge of the last query's cells, in that of the finest.
    pub fn cell(&self) -> f64 {
        Cells::new(1.0, self.coarseness).edge
    }

    /// Room for the points of a geometry and their starts: where the haptic loop no longer reads some,
    /// theirs.
    pub fn room(&mut self) -> (Arc<Vec<GuardedPoint>>, Arc<Vec<Reserve>>) {
        (self.handed_points.take(MAX_POINTS), self.handed_reserves.take(MAX_RESERVES))
    }

    /// Keeps the starts with some objects, given as ranges in turn.
    pub fn keep(&mut self, objects: impl Iterator<Item = Range<usize>>) {
        let mut kept = 0;
        for (index, own) in objects.enumerate() {
            for place in own {
                let start =
                    Start { object: (index as u8, self.starts[place].object.1), ..self.starts[place] };
                self.starts[kept] = start;
                kept += 1;
            }
        }
        self.starts.truncate(kept);
    }

    /// Keeps the nearest starts, as many as given. Returns the least distance of the others, m.
    pub fn limit(&mut self, most: usize) -> f64 {
        if self.starts.len() <= most {
            return f64::INFINITY;
        }
        self.starts.select_nth_unstable_by(most, |a, b| a.least.total_cmp(&b.least));
        self.starts.drain(most..).map(|start| start.least()).fold(f64::INFINITY, f64::min)
    }

    /// Makes the points of the starts: one for each cell. Where surfaces lie along each other, cells are made
    /// coarser until there is room. The coarser they are, the more they hide: what the body need not reach is
    /// left out first. Returns the distance of the nearest point for which there is no room, m, and the
    /// number of these within the body's reach.
    pub fn fill(&mut self, geometry: &mut ContactGeometry, mesh: &Pose, limits: &Limits) -> (f64, usize) {
        let mut left_out = f64::INFINITY;
        // Cells are made finer again where their points should fit: about as many of them are left as when
        // that was last tried, or else as now.
        let now = self.left[self.coarseness as usize].unwrap_or((1.0, 1.0));
        while let Some(finer) = self.coarseness.checked_sub(1) {
            self.choose(&Cells::new(limits.edge, finer), MAX_CELLS);
            let (all, near) = self.left[finer as usize].unwrap_or(now);
            let fit = |cells: usize, left: f64, most: usize| cells as f64 * left <= FINER * most as f64;
            let fits =
                fit(self.chosen.len(), all, MAX_POINTS) && fit(self.near_cells(limits.near), near, MAX_NEAR);
            if !fits || self.are_too_many(limits.near) {
                break;
            }
            self.coarseness = finer;
        }
        loop {
            let cells = Cells::new(limits.edge, self.coarseness);
            let is_last = self.coarseness == MAX_COARSENESS;
            let most = if is_last { usize::MAX } else { MAX_CELLS };
            self.choose(&cells, most);
            if self.are_too_many(limits.near) {
                let nearest = self.limit_to(&cells, room_at(self.coarseness, limits));
                if nearest < f64::INFINITY {
                    left_out = left_out.min(nearest);
                    self.choose(&cells, most);
                }
            }
            if is_last || !self.are_too_many(limits.near) {
                self.make(geometry, mesh, limits, &cells);
                let mut near = self.near(limits.near);
                if near > MAX_NEAR {
                    self.merge(limits.near);
                    near = self.near(limits.near);
                }
                let share = |left: usize, cells: usize| left as f64 / cells.max(1) as f64;
                let of_near = share(near, self.near_cells(limits.near));
                self.left[self.coarseness as usize] =
                    Some((share(self.points.len(), self.chosen.len()), of_near));
                let fits = |next: &GuardedPoint| room_at(self.coarseness, limits) <= next.slack.into();
                let all_fit = self.points.get(MAX_POINTS).is_none_or(fits);
                if is_last || (all_fit && near <= MAX_NEAR) {
                    break;
                }
            }
            self.coarseness += 1;
        }
        let objects = geometry.objects.len();
        if let Some(points) = Arc::get_mut(&mut geometry.points) {
            in_turn((&self.points, MAX_POINTS), objects, |point| point.object, points);
        }
        if let Some(reserves) = Arc::get_mut(&mut geometry.reserves) {
            in_turn((&self.reserves, MAX_RESERVES), objects, |reserve| reserve.object, reserves);
        }
        self.handed_points.0.push(Arc::clone(&geometry.points));
        self.handed_reserves.0.push(Arc::clone(&geometry.reserves));
        // What those hide for which there is no room bounds the motion.
        let hiding = self.reserves.iter().skip(MAX_RESERVES).filter(|reserve| reserve.hides());
        left_out = hiding.map(|reserve| f64::from(reserve.slack)).fold(left_out, f64::min);
        let nearest = self.points.get(MAX_POINTS).map_or(f64::INFINITY, |point| point.slack.into());
        let is_missed = |point: &&GuardedPoint| f64::from(point.slack) < limits.room;
        let missed = self.points.iter().skip(MAX_POINTS).take_while(is_missed).count();
        (nearest.min(left_out), missed)
    }

    /// Leaves out the furthest starts if the cells of those within a distance (m) fit. Returns the least
    /// distance of those, m.
    fn limit_to(&mut self, cells: &Cells, room: f64) -> f64 {
        self.starts.sort_unstable_by(|a, b| a.least.total_cmp(&b.least));
        self.cells.clear();
        let kept = self.starts.iter().position(|start| {
            self.cells.insert(start.cell(cells), 0);
            self.cells.len() > MAX_CELLS
        });
        let Some(kept) = kept else { return f64::INFINITY };
        let least = self.starts[kept].least();
        if least < room {
            return f64::INFINITY;
        }
        self.starts.truncate(kept);
        least
    }

    /// Whether the chosen starts are so many that not all of their points would find room, though some of
    /// them come out as the same.
    fn are_too_many(&self, near: f64) -> bool {
        self.chosen.len() > MAX_CELLS || self.near_cells(near) > MAX_NEAR_CELLS
    }

    /// Number of chosen starts within a distance (m).
    fn near_cells(&self, near: f64) -> usize {
        let near = near as f32;
        self.chosen.iter().filter(|chosen| chosen.distance < near).count()
    }

    /// Number of points within a distance (m).
    fn near(&self, distance: f64) -> usize {
        self.points.partition_point(|point| f64::from(point.slack) < distance)
    }

    /// Makes the points within a distance (m) that have descended to the same place one.
    fn merge(&mut self, distance: f64) {
        let near = self.near(distance);
        let slack = |point: &GuardedPoint| f64::from(point.slack);
        self.points[..near]
            .sort_unstable_by(|a, b| a.place_key().cmp(&b.place_key()).then(a.slack.total_cmp(&b.slack)));
        self.points.dedup_by(|next, kept| {
            let is_same = slack(next) < distance && next.is_at(kept);
            if is_same {
                kept.stand_for(next);
            }
            is_same
        });
        self.points.sort_unstable_by(order);
    }

    /// Chooses the nearest start of each cell, and ends early with more than `most` cells.
    fn choose(&mut self, cells: &Cells, most: usize) {
        self.cells.clear();
        self.chosen.clear();
        for (index, start) in self.starts.iter_mut().enumerate() {
            let key = start.cell(cells);
            let next = self.chosen.len() as u32;
            start.cell = *self.cells.entry(key).or_insert(next);
            let Start { distance, least, .. } = *start;
            let leash = start.leash();
            let made = Chosen { start: index as u32, key, distance, leash, least, hidden: 0.0 };
            match self.chosen.get_mut(start.cell as usize) {
                Some(chosen) if distance < chosen.distance => *chosen = made,
                Some(_) => {}
                None => self.chosen.push(made),
            }
            if self.chosen.len() > most {
                return;
            }
        }
    }

    /// Lets the point of each chosen start go wherever those may that it stands for. From one tip it does not
    /// descend to another.
    fn lengthen(&mut self, cells: &Cells) {
        for start in &self.starts {
            let Start { at, is_tip, distance, least, cell, .. } = *start;
            let Some(chosen) = self.chosen.get_mut(cell as usize) else { continue };
            let away = self.starts[chosen.start as usize].at.distance(at);
            chosen.leash = chosen.leash.joined(&start.leash());
            chosen.least = chosen.least.min(least);
            if is_tip && distance > cells.edge as f32 {
                chosen.hidden = chosen.hidden.max(away);
            }
        }
    }

    /// Makes the points of the chosen starts, the nearest first.
    fn make(&mut self, geometry: &ContactGeometry, mesh: &Pose, limits: &Limits, cells: &Cells) {
        self.lengthen(cells);
        self.points.clear();
        self.reserves.clear();
        self.known.keep(&geometry.objects, self.coarseness);
        let Self { starts, since, chosen, known, points, places, reserves, .. } = &mut *self;
        // The order of the cells is that of the starts.
        chosen.sort_unstable_by(|a, b| a.distance.total_cmp(&b.distance).then(a.start.cmp(&b.start)));
        let frames: ArrayVec<Frames<'_>, MAX_OBJECTS> = geometry.frames(mesh);
        let later = MAX_LATER * limits.edge;
        for &Chosen { start, key, leash, least, hidden, .. } in chosen.iter() {
            let start = &starts[start as usize];
            let Start { on, is_probe, object: (object, _), .. } = *start;
            let Some(frames) = frames.get(usize::from(object)) else { continue };
            let leash = Leash { length: leash.length.max(cells.edge as f32), ..leash };
            let feature = start.feature();
            let since = since.get(usize::from(object)).copied().unwrap_or(f64::INFINITY);
            // It may have gone on to where a surface is no longer the nearest.
            let most = f64::from(start.distance + start.apart) + later;
            let is_near = |known: &KnownPoint| f64::from(known.point.slack) + 2.0 * known.gone < most;
            let before = known.last.get(feature).or_else(|| known.last.get(key));
            // In another place of the cell before, it had another leash.
            let joined = |known: &KnownPoint| known.point.leash().joined(&leash);
            let before = before.filter(|known| joined(known).length <= LONGER * leash.length);
            let fresh = before.filter(|known| known.point.leash().covers(&leash));
            let fresh = fresh.map(|known| known.gone_on(object, since, least));
            let fresh = fresh.filter(|known| known.is_fresh(limits.near) && is_near(known));
            let resumed = || {
                let point = before?.point.resumed((object, joined(before?)), frames, least);
                Some(KnownPoint { point, gone: 0.0 }).filter(is_near)
            };
            let made = fresh.or_else(resumed).unwrap_or_else(|| {
                let point = GuardedPoint::new((on, leash), start.hint, is_probe, object, (frames, least));
                KnownPoint { point, gone: 0.0 }
            });
            points.push(made.point);
            let least = (f64::from(start.distance - start.apart), hidden);
            let mut reserve = Reserve::new((on, leash), start.hint, is_probe, object, least);
            // Where it bounds the motion more than its point does, its distance has to be that of now.
            if reserve.slack < KNOWN * made.point.slack {
                reserve.slack = reserve.slack_at(reserve.closest(frames).distance);
            }
            reserves.push(reserve);
            known.next.insert([key, feature], made);
        }
        known.step();
        points.sort_unstable_by(order);
        places.clear();
        points.retain(|point| places.insert(point.place_key()));
    }
}

#[cfg(test)]
mod tests;
