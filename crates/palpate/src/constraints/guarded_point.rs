//! A point of one surface that must not pass the other.

mod reserve;
mod touching_features;

pub(crate) use reserve::Reserve;
pub(crate) use touching_features::OVERLAP;

use palpate_core::Pose;
use palpate_core::glam::{DAffine3, DVec3};
use palpate_field::{ClosestPoint, FeatureMesh, Leash, MeshFeature, Place, lowest_share};

/// Largest number of moves that a point tries in a measurement. With more, a step takes longer; with fewer,
/// points follow fast motion late.
const MAX_MOVES: u32 = 3;

/// The same for a point that has not come to rest in them. With fewer, more is taken for near than is.
const MAX_SETTLING_MOVES: u32 = 32;

/// The same for a point that is new. With more, queries may take longer over fine meshes; with fewer, less is
/// known of how far from the other surface it is.
const MAX_FIRST_MOVES: u32 = 256;

/// Factor on that fraction after a move that leads down.
const LONGER: f32 = 4.0;

/// Smallest gain in distance for which a point moves, as a fraction of the size of the body in the hand. With
/// less, rounding moves it.
const MIN_DESCENT: f64 = 1e-8;

/// Distance beside a face up to which what is at its edge is over it, as a fraction of that size. With less,
/// what slides over tiles that are level is pushed sideways at their edges; with more, so is what passes
/// beside an edge.
const OFF_FACE: f64 = 7e-6;

/// Distance up to which surfaces touch, in margins: nothing is much nearer. With more, what comes in from
/// beside is met late; with less, points that touch look around in each step.
const TOUCHING: f64 = 4.0;

/// Fall of a distance relative to how far the point has moved, beyond 1, that is rounding. With more, a point
/// moves to where the far side of a wall looks like a deep overlap.
const ROUNDING: f64 = 1e-6;

/// Motion, in lengths of an overlap that was searched for in the whole surface, after which it is searched
/// for again: up to 1, the point is still inside. With more, an overlap that fades is told as deeper than it
/// is; with less, steps take longer where bodies overlap deeply.
const TRUSTED: f64 = 0.25;

/// How much the margin shrinks at an edge, relative to a mitre of the margins of its faces. At 1 a body that
/// slides across level with a face just touches the edge; with more, edges are held nearer than faces.
const MITER: f64 = 1.5;

/// Least share of the margin. With less, surfaces that yield a little overlap.
const LEAST_HELD: f64 = 0.25;

#[cfg(test)]
thread_local! {
    /// Number of searches of a whole surface for an overlap, in this thread.
    pub(crate) static SEARCHES: std::cell::Cell<u32> = const { std::cell::Cell::new(0) };
}

/// A point on the vertices and edges of one surface, kept where it is nearest to the other.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GuardedPoint {
    /// Place on its own body's surface.
    place: Place,
    /// Part of that surface that it stays in.
    leash: Leash,
    /// Face of the other body's surface that is nearest.
    face: u32,
    /// Edge of that surface that was nearest; none if another feature was.
    edge: Option<u32>,
    /// Index of the scene object.
    pub object: u8,
    /// Whether it is on the body in the hand, or on the scene object.
    is_probe: bool,
    /// Whether it would be at rest on any leash.
    is_free: bool,
    /// Fraction of the way along an edge that it tries next.
    stride: f32,
    /// Distance that the bodies may move before it has to be measured again, m: when it was last measured.
    pub slack: f32,
    /// Distance that the bodies may move before an overlap has to be searched for in the whole surface, m.
    trust: f32,
    /// Motion of the bodies since the query up to which the other surface is no nearer than is known, m.
    clear: f32,
}

/// Key of a place at which a point may be: the scene object, whose surface it is on, the nearest face of the
/// other one, its feature and the place on that; and the point's leash.
pub(crate) type PlaceKey = ((u8, bool, u32, u32, u64), u32);

/// A guarded point, measured.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measured {
    /// The point on the body in the hand, world, m.
    pub point: DVec3,
    /// Unit normal out of the body in the hand, world axes.
    pub normal: DVec3,
    /// Signed distance of the surfaces along it, negative where they overlap, m; infinite where another point
    /// is nearer.
    pub distance: f64,
    /// Signed distance of the point from the other surface, m.
    pub nearest: f64,
    /// Whether no point near it on its own surface is nearer.
    pub is_settled: bool,
    /// Share of the margin between surfaces at which they are held apart there.
    pub held: f64,
}

/// Where a descent ends.
#[derive(Clone, Copy, Debug)]
struct Descent {
    /// Position of the point in its own body's frame, m.
    position: DVec3,
    /// The point of the other surface nearest to it, in that body's frame.
    closest: ClosestPoint,
    /// Whether it has no further to go.
    is_settled: bool,
}

/// The surfaces of the body in the hand and of a scene object, at their poses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frames<'a> {
    probe: (&'a FeatureMesh, DAffine3),
    object: (&'a FeatureMesh, DAffine3),
    to_object: DAffine3,
    to_probe: DAffine3,
    /// Smallest gain in distance for which a point moves, m.
    min_descent: f64,
    /// Distance beside a face up to which what is at its edge is over it, m.
    off_face: f64,
    /// Distance at which the surfaces are held apart, m, if they have overlapped from the start.
    margin: Option<f64>,
}

/// A point's own surface and the other one, with the transforms into their frames.
#[derive(Clone, Copy)]
struct Sides<'a> {
    own: &'a FeatureMesh,
    other: &'a FeatureMesh,
    to_other: &'a DAffine3,
    to_own: &'a DAffine3,
    /// Distance beside a face up to which what is at its edge is over it, m.
    off_face: f64,
}

impl<'a> Frames<'a> {
    /// Two surfaces with the poses of their meshes' frames.
    pub fn new(probe: (&'a FeatureMesh, &Pose), object: (&'a FeatureMesh, &Pose)) -> Self {
        let affine = |pose: &Pose| DAffine3::from_rotation_translation(pose.rotation, pose.translation);
        let to_object = object.1.inverse() * *probe.1;
        Self {
            probe: (probe.0, affine(probe.1)),
            object: (object.0, affine(object.1)),
            to_object: affine(&to_object),
            to_probe: affine(&to_object.inverse()),
            min_descent: MIN_DESCENT * probe.0.size(),
            off_face: OFF_FACE * probe.0.size(),
            margin: None,
        }
    }

    /// The surfaces of bodies that have overlapped from the start, held apart by a margin (m).
    pub fn overlapping(self, margin: f64) -> Self {
        Self { margin: Some(margin), ..self }
    }

    /// The surface of the body in the hand, or of the scene object.
    #[cfg(test)]
    pub fn own(&self, is_probe: bool) -> &'a FeatureMesh {
        if is_probe { self.probe.0 } else { self.object.0 }
    }

    /// The two sides of a point on the body in the hand, or on the scene object.
    #[inline(always)]
    fn sides(&self, is_probe: bool) -> Sides<'_> {
        let Self { probe, object, to_object, to_probe, off_face, .. } = self;
        let off_face = *off_face;
        if is_probe {
            Sides { own: probe.0, other: object.0, to_other: to_object, to_own: to_probe, off_face }
        } else {
            Sides { own: object.0, other: probe.0, to_other: to_probe, to_own: to_object, off_face }
        }
    }
}

impl GuardedPoint {
    /// A point that starts at a place and stays on a leash. `hint` is for a search of the other surface.
    /// Nothing that it stands for is nearer to that than `least` (m).
    pub fn new(
        (place, leash): (Place, Leash),
        hint: u32,
        is_probe: bool,
        index: u8,
        (frames, least): (&Frames<'_>, f32),
    ) -> Self {
        let Sides { own, other, to_other, .. } = frames.sides(is_probe);
        let face = other.face_near(to_other.transform_point3(own.position(&place)), hint);
        let mut point = Self::at((place, leash), face, is_probe, index);
        point.settle(frames, least);
        point
    }

    /// A point at a place, over a face of the other surface, of which nothing else is known.
    fn at((place, leash): (Place, Leash), face: u32, is_probe: bool, object: u8) -> Self {
        Self {
            place,
            leash,
            face,
            edge: None,
            object,
            is_probe,
            is_free: false,
            stride: 1.0,
            slack: 0.0,
            trust: 0.0,
            clear: 0.0,
        }
    }

    /// The point of an earlier query at new poses, on another leash. `index` is that of the scene object now.
    pub fn resumed(&self, (index, leash): (u8, Leash), frames: &Frames<'_>, least: f32) -> Self {
        // How far the bodies have moved is not known.
        let mut point = Self { object: index, leash, trust: 0.0, ..*self };
        point.settle(frames, least);
        point
    }

    /// The point after a motion of the bodies (m), without a measurement. `index` is that of the scene object
    /// now. What it stands for is no nearer than `least` (m).
    pub fn go(&mut self, index: u8, motion: f64, least: f32) {
        let left = |length: f32| below(f64::from(length) - motion);
        (self.object, self.trust) = (index, 0.0);
        (self.slack, self.clear) = (left(self.slack), left(self.clear).min(least));
    }

    /// The point where motion is counted anew, after so much since the query, m. `index` is that of the scene
    /// object now.
    pub fn carried(&self, index: u8, motion: f64) -> Self {
        Self { object: index, clear: below(f64::from(self.clear) - motion), ..*self }
    }

    /// Descends as far as it goes. Should it not end, points near it may be nearer by twice the leash, but
    /// are no nearer than is known.
    fn settle(&mut self, frames: &Frames<'_>, least: f32) {
        let Descent { closest, is_settled, .. } = self.descend(frames, MAX_FIRST_MOVES, f64::INFINITY);
        let distance = closest.distance as f32;
        let nearer = (self.least_beside(closest.distance) as f32).max(least).max(0.0);
        self.clear = distance.min(least);
        self.slack = if is_settled { distance } else { distance.min(nearer) };
    }

    /// A lower bound on the distance of all places on the leash of a point at a distance (m) from the other
    /// surface, m.
    pub fn least_beside(&self, distance: f64) -> f64 {
        distance - 2.0 * f64::from(self.leash.length)
    }

    /// Moves the point to where its surface is nearest to the other one, and measures it. `slack` (m) is what
    /// the motion since its last measurement has left of its own; contacts beyond a `reach` (m) are not asked
    /// for.
    #[inline(always)]
    pub fn measure(&mut self, frames: &Frames<'_>, slack: f32, reach: f64) -> Measured {
        self.measure_in(MAX_MOVES, frames, slack, reach)
    }

    /// Goes on with a measurement in which the point has not come to rest.
    #[inline(never)]
    pub fn measure_on(&mut self, frames: &Frames<'_>, slack: f32, reach: f64) -> Measured {
        self.measure_in(MAX_SETTLING_MOVES, frames, slack, reach)
    }

    #[inline(always)]
    fn measure_in(&mut self, moves: u32, frames: &Frames<'_>, slack: f32, reach: f64) -> Measured {
        let descent = match self.at_rest(frames) {
            Some((position, closest)) => {
                self.trust = 0.0;
                let descent = Descent { position, closest, is_settled: true };
                // From a vertex that is the lowest over a face, the direction is a normal of both sides.
                let is_over = matches!((self.place, self.edge), (Place::Vertex(_), None));
                if is_over && self.is_normal(frames, &closest) {
                    return self.measured(frames, &descent);
                }
                descent
            }
            None => {
                self.trust -= self.slack - slack;
                self.descend(frames, moves, slack.into())
            }
        };
        if descent.closest.distance > reach {
            return self.measured(frames, &descent);
        }
        self.touching(frames, &descent)
    }

    /// The measurement of a point by the direction from the other surface.
    #[inline(always)]
    fn measured(&self, frames: &Frames<'_>, descent: &Descent) -> Measured {
        let Descent { position, closest, is_settled } = *descent;
        let (point, normal) = if self.is_probe {
            let outward = frames.object.1.transform_vector3(closest.normal);
            (frames.probe.1.transform_point3(position), -outward)
        } else {
            let outward = frames.probe.1.transform_vector3(closest.normal);
            (frames.probe.1.transform_point3(closest.point), outward)
        };
        let is_over_face = self.is_probe && matches!(closest.feature, MeshFeature::Face(_));
        let held = if is_over_face { 1.0 } else { self.held(frames, closest.feature, normal) };
        let distance = closest.distance;
        Measured { point, normal, distance, nearest: distance, is_settled, held }
    }

    /// Share of the margin at which surfaces are held apart at features with a normal out of the body in the
    /// hand: all of it over the object's faces, less at its edges and vertices by how far the normal is from
    /// those of the faces beside them. So they are within what the margin of these faces leaves free, and a
    /// body that slides from one object over another that is level with it does not meet the edge between.
    #[inline(always)]
    fn held(&self, frames: &Frames<'_>, feature: MeshFeature, normal: DVec3) -> f64 {
        let feature = if self.is_probe { feature } else { self.place.into() };
        let out = frames.object.1.matrix3.transpose() * -normal;
        (1.0 - MITER * (1.0 - frames.object.0.facing(feature, out))).clamp(LEAST_HELD, 1.0)
    }

    /// Turns to the nearest face of the whole surface where another than the one that the point knows may be
    /// nearer by now, after a motion of the bodies since the query (m): before it could be within reach of
    /// contacts, and within reach, before it could be at half of the distance. `margin` is that at which
    /// surfaces are held apart, m. Returns how far the bodies may move until then, m, and whether it has
    /// turned.
    pub fn look_around(
        &mut self,
        frames: &Frames<'_>,
        distance: f64,
        (reach, margin): (f64, f64),
        motion: f64,
    ) -> (f64, bool) {
        let left = f64::from(self.clear) - motion;
        if !distance.is_finite() || distance <= TOUCHING * margin || left >= distance {
            return (distance, false);
        }
        if left > reach {
            return (left, false);
        }
        if distance <= reach && left > 0.5 * distance {
            return (distance, false);
        }
        let Sides { own, other, to_other, .. } = frames.sides(self.is_probe);
        let nearer = other.nearer(to_other.transform_point3(own.position(&self.place)), distance);
        let clear = nearer.map_or(distance, |nearer| nearer.distance);
        self.clear = below(clear + motion);
        let is_lower = |nearer: &ClosestPoint| nearer.distance < distance - frames.min_descent;
        let other = nearer.filter(|nearer| nearer.face != self.face && is_lower(nearer));
        if let Some(nearer) = other {
            (self.face, self.edge) = (nearer.face, None);
        }
        (clear, other.is_some())
    }

    /// The measurement of the point where it is, without moving it.
    pub fn still(&self, frames: &Frames<'_>) -> Measured {
        let Sides { own, other, to_other, .. } = frames.sides(self.is_probe);
        let position = own.position(&self.place);
        let closest = other.walk(to_other.transform_point3(position), self.face);
        self.measured(frames, &Descent { position, closest, is_settled: false })
    }

    /// The nearest points of both surfaces, in the frames of the probe's and of the object's mesh, m.
    pub fn ends(&self, frames: &Frames<'_>) -> [DVec3; 2] {
        let Frames { probe, object, to_object, to_probe, .. } = frames;
        if self.is_probe {
            let own = probe.0.position(&self.place);
            [own, object.0.walk(to_object.transform_point3(own), self.face).point]
        } else {
            let own = object.0.position(&self.place);
            [probe.0.walk(to_probe.transform_point3(own), self.face).point, own]
        }
    }

    /// What [`Self::descend`] finds at a place that is the lowest and over the face or the edge that was
    /// nearest, as most points that touch are, in fewer instructions; `None` for any other point.
    #[inline(always)]
    fn at_rest(&mut self, frames: &Frames<'_>) -> Option<(DVec3, ClosestPoint)> {
        let Sides { own, other, to_other, to_own, .. } = frames.sides(self.is_probe);
        let place = match (self.place, self.edge) {
            // Edges that cross are nearest where they do.
            (Place::Edge(edge, _), Some(crossed)) => {
                let line = other.ends(crossed).map(|end| to_own.transform_point3(end));
                own.place_nearest(edge, line, &self.leash)?
            }
            (place, _) => place,
        };
        let position = own.position(&place);
        let at = to_other.transform_point3(position);
        let closest = match self.edge {
            Some(edge) => other.over_edge(at, edge, self.face),
            None => other.over(at, self.face),
        }?;
        let normal = to_own.transform_vector3(closest.normal);
        let is_lowest = |leash: &Leash| own.is_lowest(&place, normal, self.stride.into(), leash);
        let is_free = is_lowest(&self.leash.unbounded());
        (is_free || is_lowest(&self.leash)).then(|| {
            (self.place, self.face, self.is_free) = (place, closest.face, is_free);
            (position, closest)
        })
    }

    /// Moves the point down, in at most so many moves. Its distance is known to be at least `least` (m), but
    /// for overlaps that were not there.
    ///
    /// A walk over faces may end on the far side of a wall, which looks like an overlap: where the point
    /// comes to one, the whole surface is searched. Since a distance falls by no more than the point has
    /// moved, a move on which it falls by more is not made.
    fn descend(&mut self, frames: &Frames<'_>, moves: u32, least: f64) -> Descent {
        let sides = frames.sides(self.is_probe);
        let Sides { own, other, to_other, to_own, .. } = sides;
        let mut position = own.position(&self.place);
        let mut closest = other.walk(to_other.transform_point3(position), self.face);
        closest = self.checked(&sides, position, closest, least);
        let (mut stride, mut is_settled, mut is_free) = (self.stride, false, true);
        let (mut is_moved, mut is_cut) = (false, false);
        for _ in 0..moves {
            let normal = to_own.transform_vector3(closest.normal);
            let lower = |leash: &Leash| own.descend(&self.place, normal, stride.into(), leash);
            let Some(place) = lower(&self.leash) else {
                (is_settled, is_free) = (true, lower(&self.leash.unbounded()).is_none());
                break;
            };
            let next = own.position(&place);
            let mut found = other.walk(to_other.transform_point3(next), closest.face);
            if found.distance < 0.0 && closest.distance >= 0.0 {
                found = self.searched(&sides, next, found, f64::NEG_INFINITY);
            }
            let way = next - position;
            let fallen = closest.distance - found.distance;
            if fallen > 0.0 && fallen * fallen > (1.0 + ROUNDING) * way.length_squared() {
                is_settled = true;
                break;
            }
            let normals = [normal, to_own.transform_vector3(found.normal)];
            // A short way may lead down by too little where a longer one does not.
            let goes_on = !is_cut && stride < 1.0 && fallen > 0.0 && normals[1].dot(way) < 0.0;
            if fallen < frames.min_descent && !goes_on {
                let Some(share) = self.share(&place, (&closest, &found), normals, way, frames.min_descent)
                else {
                    is_settled = true;
                    break;
                };
                stride *= share;
                is_cut = true;
                continue;
            }
            is_cut &= fallen < frames.min_descent;
            stride = (LONGER * stride).min(1.0);
            self.trust -= way.length() as f32;
            is_moved = true;
            (self.place, position, closest) = (place, next, found);
        }
        // Where it has stayed at an overlap, that was checked before.
        if is_moved || closest.distance >= 0.0 {
            closest = self.checked(&sides, position, closest, f64::NEG_INFINITY);
        }
        self.stride = stride.max(FeatureMesh::MIN_STRIDE as f32);
        self.face = closest.face;
        self.is_free = is_settled && is_free;
        self.edge = match closest.feature {
            MeshFeature::Edge(edge) => Some(edge),
            _ => None,
        };
        Descent { position, closest, is_settled }
    }

    /// What a walk from a position (m) has found, if it is no overlap, or one that is there: an overlap that
    /// is new, or has moved by a share of its depth, is searched for in the whole surface. Where that is
    /// nearer on another side of a wall, the point still is on the side on which it came in: there, it is at
    /// no less than a distance `least` (m).
    #[inline(always)]
    fn checked(
        &mut self,
        sides: &Sides<'_>,
        position: DVec3,
        found: ClosestPoint,
        least: f64,
    ) -> ClosestPoint {
        if found.distance >= 0.0 {
            self.trust = 0.0;
            return found;
        }
        if self.trust > 0.0 && found.distance >= least {
            return found;
        }
        self.searched(sides, position, found, least)
    }

    #[inline(never)]
    fn searched(
        &mut self,
        sides: &Sides<'_>,
        position: DVec3,
        found: ClosestPoint,
        least: f64,
    ) -> ClosestPoint {
        #[cfg(test)]
        SEARCHES.with(|searches| searches.set(searches.get() + 1));
        let at = sides.to_other.transform_point3(position);
        let nearest = sides.other.nearer(at, -found.distance).unwrap_or(found);
        self.trust = (TRUSTED * -nearest.distance).max(0.0) as f32;
        if nearest.distance < 0.0 && found.distance >= least { found } else { nearest }
    }

    /// The share to try of a way (m) to a place that is no lower; `None` if nothing lower is expected there.
    fn share(
        &self,
        to: &Place,
        (before, after): (&ClosestPoint, &ClosestPoint),
        normals: [DVec3; 2],
        way: DVec3,
        min_descent: f64,
    ) -> Option<f32> {
        if matches!((self.place, to), (Place::Edge(from, _), Place::Edge(to, _)) if from != *to) {
            // Ways across a face have no share.
            return None;
        }
        let slopes = normals.map(|normal| normal.dot(way));
        let share = lowest_share(after.distance - before.distance, slopes);
        (-slopes[0] * share > min_descent).then_some(share as f32)
    }

    /// Follows another point that `was` at the same features, within a distance (m), and is at rest `now` on
    /// any leash. This one would come to rest there, too, if its own leash reaches that far; otherwise it
    /// stays as it is. Returns whether it has followed.
    pub fn follow(&mut self, (was, now): (&Self, &Self), frames: &Frames<'_>, within: f64) -> bool {
        let on = |point: &Self| (point.is_probe, MeshFeature::from(point.place));
        if on(self) != on(was) || on(now) != on(was) || (self.face, self.edge) != (was.face, was.edge) {
            return false;
        }
        let own = frames.sides(self.is_probe).own;
        let [here, there, to] = [self, was, now].map(|point| own.position(&point.place));
        let follows = now.is_free && here.distance_squared(there) <= within * within && self.leash.holds(to);
        if follows {
            *self = Self { leash: self.leash, object: self.object, ..*now };
        }
        follows
    }

    pub fn leash(&self) -> &Leash {
        &self.leash
    }

    /// Whether another point has descended to the same place.
    pub fn is_at(&self, other: &Self) -> bool {
        self.place_key().0 == other.place_key().0
    }

    /// Lets the point go wherever another one may.
    pub fn stand_for(&mut self, other: &Self) {
        self.leash = self.leash.joined(&other.leash);
    }

    /// Key of the place that the point has descended to, and its leash.
    pub fn place_key(&self) -> PlaceKey {
        let (feature, at) = match self.place {
            Place::Vertex(vertex) => (vertex, u64::MAX),
            Place::Edge(edge, at) => (edge, (at * 256.0) as u64),
        };
        ((self.object, self.is_probe, self.face, feature, at), self.leash.length.to_bits())
    }
}

/// The largest number in single precision that is not above another one.
pub(crate) fn below(number: f64) -> f32 {
    let rounded = number as f32;
    if f64::from(rounded) > number { rounded.next_down() } else { rounded }
}

#[cfg(test)]
mod tests;
