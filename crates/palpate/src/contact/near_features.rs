//! The convex features of two surfaces near each other, where guarded points start, and how far the bodies
//! may move before any other feature could touch.
//!
//! Each body's features are in a [hierarchy](FeatureTree) of spheres. A sphere's distance from the other
//! surface is read at its centre, exactly, and holds to within the motion since: it is read again only when
//! that motion could decide whether the sphere is within reach. So a query costs what has changed, and what
//! is left out bounds the motion by a distance that is proved: first contacts are at convex features alone.

use std::ops::Range;

use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::MotionBound;
use palpate_field::{FeatureMesh, FeatureNode, FeatureTree, Leash, Place};

/// Radius of spheres that one start stands for, as fractions of the distance and of the smallest cells' edge.
/// With more, minima of the distance are missed; with less, there are more starts.
const SHARE: (f64, f64) = (0.6, 0.5);

/// Least share of a distance that is read that the true one may be. With more, it takes longer to read; with
/// less, more distances are read.
const EXACT: f64 = 0.85;

/// Radius of a sphere out of reach from which it is divided, as a fraction of its distance. With more, the
/// bound on motion is far below the true distance; with less, more distances are read.
const COARSE: f64 = 0.25;

/// Motion after which a distance that does not show whether a sphere is out of reach is read again, as
/// fractions of that distance and of the reach. With more, starts are chosen by older distances and some are
/// out of reach; with less, more distances are read.
const STALE: (f64, f64) = (0.3, 0.05);

/// Motion after which a distance out of reach is read again, as a fraction of it. With more, the bound on
/// motion of a body that leaves a surface stays behind the true distance; with less, more distances are read.
const WORN: f64 = 0.15;

/// Number of readings of a query after which spheres out of reach are not divided further. With more, the
/// first query of bodies far apart takes longer; with less, its bound is lower.
const MAX_READ: usize = 1024;

/// Largest distance between starts on an edge over one flat part of the other surface, in edges of cells.
/// With more, the surface may end between them unseen; with less, edges that lie on faces have many contacts.
const FLAT_STEP: f64 = 4.0;

/// Smallest cosine of the angle between faces of a flat part.
const FLAT: f64 = 1.0 - 1e-9;

/// Rounding of distances in single precision, as a fraction of them.
const ROUNDING: f64 = 1e-6;

/// A feature near the other surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct NearFeature {
    pub place: Place,
    /// Whether it is on the probe.
    pub is_probe: bool,
    /// Whether its neighbours do not stand for it.
    pub is_tip: bool,
    /// Its position in its own body's frame, m.
    pub point: DVec3,
    /// Its distance from the other surface, and by how much that may be off, m.
    pub distance: f64,
    pub apart: f64,
    /// Lower bound on the distance of what it stands for, m.
    pub least: f64,
    /// Where what it stands for is: its point may move as far.
    pub leash: Leash,
    /// Hint for a search of the other surface from there.
    pub hint: u32,
}

/// Distances of a search.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reaches {
    /// Distance within which features are passed on, m.
    pub reach: f64,
    /// Distance beyond which a bound on motion need not be known, m.
    pub enough: f64,
    /// Edge of the smallest cells, m.
    pub edge: f64,
    /// Length above which edges are searched by themselves, m.
    pub long: f64,
}

/// What is known of the distances between two bodies.
#[derive(Clone, Debug, Default)]
pub(super) struct NearFeatures {
    /// Of the probe's features, and of the scene object's.
    sides: [Readings; 2],
    /// Pose of the probe's mesh in the object's frame at the last query.
    last: Option<Pose>,
    /// Sum of the motions from query to query, m.
    moved: f64,
    /// The last of them, m; infinite if it is not known.
    since: f64,
    /// Workspaces: nodes to go to, and parts of an edge: number, ends as shares of its length, and hint.
    nodes: Vec<u32>,
    ways: Vec<(usize, f64, f64, u32)>,
}

#[derive(Clone, Debug, Default)]
struct Readings {
    vertices: Vec<Reading>,
    edges: Vec<Reading>,
    /// Of the halves of each long edge, then of their halves, and so on.
    parts: Vec<Vec<Reading>>,
}

/// The distance of a sphere's centre from the other surface.
#[derive(Clone, Copy, Debug)]
struct Reading {
    /// m; the true one is not above it, and not below [`EXACT`] times it.
    distance: f32,
    hint: u32,
    /// Motion at which it was read, m; NaN before.
    at: f64,
}

/// A search for one body's features.
struct Search<'a, F> {
    own: &'a FeatureMesh,
    other: &'a FeatureMesh,
    to_other: Pose,
    is_probe: bool,
    is_closed: bool,
    moved: f64,
    reaches: Reaches,
    /// Number of readings.
    read: usize,
    /// Least distance of what was not passed on, m.
    room: f64,
    stack: &'a mut Vec<u32>,
    ways: &'a mut Vec<(usize, f64, f64, u32)>,
    to: F,
}

impl Reading {
    const NONE: Self = Self { distance: 0.0, hint: 0, at: f64::NAN };
}

impl Readings {
    /// Makes room for the features of a surface.
    fn fit(&mut self, tree: &FeatureTree) {
        self.vertices.resize(tree.vertices.len(), Reading::NONE);
        self.edges.resize(tree.edges.len(), Reading::NONE);
        self.parts.resize(tree.edges.len(), Vec::new());
    }

    fn bytes(&self) -> usize {
        let readings = self.vertices.capacity() + self.edges.capacity();
        let parts = self.parts.iter().map(Vec::capacity).sum::<usize>();
        (readings + parts) * size_of::<Reading>() + self.parts.capacity() * size_of::<Vec<Reading>>()
    }
}

impl NearFeatures {
    /// Passes on the features of a probe and of a scene object (surfaces, with their poses) that are within
    /// reach of each other. Returns how far the bodies may move before another feature could touch, m.
    ///
    /// `center` and `radius` (m) are of a sphere around the probe, in its mesh's frame.
    pub fn find(
        &mut self,
        (probe, mesh): (&FeatureMesh, &Pose),
        (scene, pose): (&FeatureMesh, &Pose),
        (center, radius): (DVec3, f64),
        reaches: &Reaches,
        mut to: impl FnMut(&NearFeature),
    ) -> f64 {
        let to_scene = pose.inverse() * *mesh;
        // No distance between a point of one body and the other surface changes by more than this.
        let since = self.last.replace(to_scene).map_or(f64::INFINITY, |last| {
            let at = |pose: &Pose| Pose { translation: pose.transform_point(center), ..*pose };
            MotionBound { from: at(&last), radius, ..MotionBound::NONE }.displacement(&at(&to_scene))
        });
        if since.is_finite() {
            self.moved += since;
        } else {
            *self = Self { last: self.last, ..Self::default() };
        }
        self.since = since;
        let surfaces = [(probe, scene, to_scene), (scene, probe, to_scene.inverse())];
        let mut room = f64::INFINITY;
        for (side, (own, other, to_other)) in surfaces.into_iter().enumerate() {
            let tree = own.tree();
            let readings = &mut self.sides[side];
            readings.fit(tree);
            let mut search = Search {
                own,
                other,
                to_other,
                is_probe: side == 0,
                is_closed: other.is_closed(),
                moved: self.moved,
                reaches: *reaches,
                read: 0,
                room,
                stack: &mut self.nodes,
                ways: &mut self.ways,
                to: &mut to,
            };
            search.vertices(&tree.vertices, &mut readings.vertices);
            search.edges(&tree.edges, readings);
            room = search.room;
        }
        room
    }

    /// Motion of the bodies between the last two queries, m; infinite if it is not known.
    pub fn since(&self) -> f64 {
        self.since
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.sides.iter().map(Readings::bytes).sum::<usize>()
    }
}

impl<F: FnMut(&NearFeature)> Search<'_, F> {
    /// Reads the distance of a point (own frame, m) from the other surface. Behind an open surface it counts
    /// as positive: there is no inside.
    fn read(&mut self, p: DVec3, hint: u32) -> Reading {
        self.read += 1;
        let (distance, hint) = self.other.distance(self.to_other.transform_point(p), hint, EXACT);
        let distance = if self.is_closed { distance } else { distance.abs() };
        Reading { distance: distance as f32, hint, at: self.moved }
    }

    /// A distance, and how much the true one may differ from it, m.
    fn known(&self, reading: &Reading) -> (f64, f64) {
        let gone = self.moved - reading.at;
        let (distance, off) = (f64::from(reading.distance), 0.5 * (1.0 - EXACT));
        let middle = distance - off * distance.max(0.0);
        let apart = off * distance.max(0.0) + ROUNDING * distance.abs();
        (middle, if gone.is_nan() { f64::INFINITY } else { gone + apart })
    }

    fn is_stale(&self, reading: &Reading) -> bool {
        let gone = self.moved - reading.at;
        let most = STALE.0 * f64::from(reading.distance).abs() + STALE.1 * self.reaches.reach;
        gone.is_nan() || gone > most
    }

    /// Whether a distance is too old to bound the motion closely.
    fn is_worn(&self, reading: &Reading) -> bool {
        let gone = self.moved - reading.at;
        self.read <= MAX_READ && gone > WORN * f64::from(reading.distance).abs()
    }

    /// Whether nothing in a sphere of a radius, all of it at least `least` away, has to be passed on or to be
    /// measured more closely (m).
    fn is_out(&self, least: f64, radius: f64) -> bool {
        let Reaches { reach, enough, .. } = self.reaches;
        least > reach && (least >= enough || radius <= COARSE * least || self.read > MAX_READ)
    }

    /// Distance (m) of a sphere's centre `at`, and how much it may be off, as exactly as the search needs it.
    /// What is in the sphere is up to `extent` (m) from there.
    fn distance(
        &mut self,
        at: DVec3,
        (radius, extent): (f64, f64),
        reading: &mut Reading,
        is_divided: impl FnOnce(&Self, f64) -> bool,
    ) -> (f64, f64) {
        let known = self.known(reading);
        let (distance, apart) = known;
        let least = distance - apart - extent;
        let is_near = distance + apart - extent <= self.reaches.reach;
        let suffices = if self.is_out(least, radius) {
            least >= self.reaches.enough || !self.is_worn(reading)
        } else {
            (is_near && is_divided(self, least)) || !self.is_stale(reading)
        };
        if suffices {
            return known;
        }
        *reading = self.read(at, reading.hint);
        self.known(reading)
    }

    /// Whether one start stands for a sphere at least so far away (m).
    fn is_one(&self, node: &FeatureNode, least: f64) -> bool {
        !node.has_tip && node.radius <= (SHARE.0 * least).max(SHARE.1 * self.reaches.edge)
    }

    fn vertices(&mut self, nodes: &[FeatureNode], readings: &mut [Reading]) {
        self.stack.extend((!nodes.is_empty()).then_some(0));
        while let Some(index) = self.stack.pop() {
            let node = &nodes[index as usize];
            // Edges reach out of the sphere by half of their length, until another end stands for them.
            let extent = node.radius + node.extent.min(0.5 * self.reaches.long);
            let size = (node.radius, extent);
            let (distance, apart) =
                self.distance(node.center, size, &mut readings[index as usize], |search, least| {
                    !node.children.is_empty() && !search.is_one(node, least)
                });
            let least = distance - apart - extent;
            if self.is_out(least, node.radius) {
                self.room = self.room.min(least);
            } else if node.children.is_empty() {
                self.pass_vertex(node, &readings[index as usize], (least, leash(node.center, extent)));
            } else if least <= self.reaches.reach && self.is_one(node, least) {
                let nearest = self.nearest_below(nodes, index, readings);
                let stands_for = (least, leash(node.center, extent));
                self.pass_vertex(&nodes[nearest as usize], &readings[nearest as usize], stands_for);
            } else {
                let hint = readings[index as usize].hint;
                self.stack.extend(with_hint(node, readings, hint));
            }
        }
    }

    fn pass_vertex(&mut self, node: &FeatureNode, reading: &Reading, (least, leash): (f64, Leash)) {
        let (distance, apart) = self.known(reading);
        let place = Place::Vertex(node.feature);
        let near = NearFeature {
            place,
            is_probe: self.is_probe,
            is_tip: node.has_tip,
            point: node.center,
            distance,
            apart,
            least,
            leash,
            hint: reading.hint,
        };
        (self.to)(&near);
    }

    /// The node of the feature below another node that is the nearest, by a descent to nearer spheres.
    fn nearest_below(&mut self, nodes: &[FeatureNode], mut index: u32, readings: &mut [Reading]) -> u32 {
        while !nodes[index as usize].children.is_empty() {
            let hint = readings[index as usize].hint;
            let mut best = (f64::INFINITY, index);
            for child in with_hint(&nodes[index as usize], readings, hint) {
                let (node, reading) = (&nodes[child as usize], &mut readings[child as usize]);
                if self.is_stale(reading) {
                    *reading = self.read(node.center, reading.hint);
                }
                let least = self.known(reading).0 - node.radius;
                if least < best.0 || best.1 == index {
                    best = (least, child);
                }
            }
            index = best.1;
        }
        index
    }

    fn edges(&mut self, nodes: &[FeatureNode], readings: &mut Readings) {
        let Readings { edges: readings, parts, .. } = readings;
        self.stack.extend((!nodes.is_empty()).then_some(0));
        while let Some(index) = self.stack.pop() {
            let node = &nodes[index as usize];
            if 2.0 * node.extent <= self.reaches.long {
                continue;
            }
            let size = (node.radius, node.radius);
            let reading = &mut readings[index as usize];
            let (distance, apart) =
                self.distance(node.center, size, reading, |_, _| !node.children.is_empty());
            let least = distance - apart - node.radius;
            if self.is_out(least, node.radius) {
                self.room = self.room.min(least);
            } else if node.children.is_empty() {
                let reading = readings[index as usize];
                self.pass_edge(node, &reading, &mut parts[index as usize]);
            } else {
                let hint = readings[index as usize].hint;
                self.stack.extend(with_hint(node, readings, hint));
            }
        }
    }

    /// Passes on the parts of a long edge that are within reach: one for each cell, and fewer over flat parts
    /// of the other surface, where the edge is lowest at an end. `whole` is the reading at its middle.
    fn pass_edge(&mut self, node: &FeatureNode, whole: &Reading, readings: &mut Vec<Reading>) {
        let [from, to] = self.own.ends_of(node.feature);
        let length = from.distance(to);
        // The halves of part i are parts 2 i and 2 i + 1.
        self.ways.push((1, 0.0, 1.0, whole.hint));
        let mut run = FlatRun::default();
        while let Some((part, first, last, hint)) = self.ways.pop() {
            let share = 0.5 * (first + last);
            let half = 0.5 * length * (last - first);
            let point = from + (to - from) * share;
            if readings.len() <= part {
                readings.resize(part + 1, Reading::NONE);
            }
            if readings[part].at.is_nan() {
                readings[part].hint = hint;
            }
            let is_whole = 2.0 * half <= self.reaches.edge;
            let (distance, apart) = self.distance(point, (half, half), &mut readings[part], |_, _| !is_whole);
            let least = distance - apart - half;
            if self.is_out(least, half) {
                self.room = self.room.min(least);
            } else if 2.0 * half <= self.reaches.edge.max(least) {
                let place = self.own.place_at(node.feature, share);
                let (is_probe, is_tip, hint) = (self.is_probe, false, readings[part].hint);
                let leash = leash(point, half);
                let near =
                    NearFeature { place, is_probe, is_tip, point, distance, apart, least, leash, hint };
                let normal = self.other.normal_of(hint);
                run.add(near, normal, FLAT_STEP * self.reaches.edge, &mut self.to);
            } else {
                let hint = readings[part].hint;
                // Along the edge, so that its parts come in their order.
                self.ways.extend([(2 * part + 1, share, last, hint), (2 * part, first, share, hint)]);
            }
        }
        run.end(&mut self.to);
    }
}

/// Parts of an edge, in their order, over one flat part of the other surface.
#[derive(Default)]
struct FlatRun {
    /// The last part that was passed on, and the last one that was not.
    passed: Option<NearFeature>,
    waiting: Option<NearFeature>,
    normal: DVec3,
}

impl FlatRun {
    /// Adds a part of the edge over a face with a normal. Passes on the first and the last one of each run,
    /// and those that are up to a step (m) apart.
    fn add(&mut self, near: NearFeature, normal: DVec3, step: f64, to: &mut impl FnMut(&NearFeature)) {
        let gap = |from: &NearFeature| from.point.distance(near.point);
        let last = self.waiting.or(self.passed);
        let goes_on = self.normal.dot(normal) > FLAT
            && last.is_some_and(|last| gap(&last) <= 2.0 * f64::from(near.leash.length + last.leash.length));
        if goes_on && self.passed.is_some_and(|passed| gap(&passed) < step) {
            self.waiting = Some(near);
            return;
        }
        if !goes_on {
            self.end(to);
        }
        self.pass(near, step, to);
        (self.waiting, self.normal) = (None, normal);
    }

    /// Passes on the last part of a run.
    fn end(&mut self, to: &mut impl FnMut(&NearFeature)) {
        if let Some(last) = self.waiting.take() {
            self.pass(last, 0.0, to);
        }
    }

    /// Passes on a part, whose point may move along the edge by a length (m).
    fn pass(&mut self, near: NearFeature, length: f64, to: &mut impl FnMut(&NearFeature)) {
        self.passed = Some(near);
        let leash = leash(near.point, length + f64::from(near.leash.length));
        to(&NearFeature { leash, ..near });
    }
}

fn leash(home: DVec3, length: f64) -> Leash {
    Leash { home, length: (length as f32).next_up() }
}

/// The nodes below one. Those that were not read yet are read from a hint.
fn with_hint(node: &FeatureNode, readings: &mut [Reading], hint: u32) -> Range<u32> {
    let children = node.children.start as usize..node.children.end as usize;
    for reading in readings[children].iter_mut().filter(|reading| reading.at.is_nan()) {
        reading.hint = hint;
    }
    node.children.clone()
}

#[cfg(test)]
mod tests;
