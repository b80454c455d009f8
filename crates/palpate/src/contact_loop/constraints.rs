//! The step of the contact loop that finds contact geometry.

use std::sync::Arc;

use arrayvec::ArrayVec;
use palpate_collide::ObjectHandle;
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::{BodyState, MotionBound, MovingBody};
use palpate_field::FeatureMesh;

use super::ContactLoop;
use crate::constraints::geometry::{
    ContactGeometry, FarObject, MAX_FAR, MAX_OBJECT_MOTION, MAX_OBJECTS, NearObject, reach_of_step,
};
use crate::constraints::guard::{Guard, Limits, Start};
use crate::constraints::guarded_point::{GuardedPoint, OVERLAP};
use crate::constraints::near_features::{NearFeature, Reaches};
use crate::constraints::pairs::{Found, Pull};
use crate::penalties::in_scene::InScene;

/// Edge of the cells in each of which a point starts, in bounding radii of the body. With larger cells, local
/// minima of the distance are missed; with smaller ones there are more points.
const CELL: f64 = 0.02;

/// Distance at which surfaces are held apart, in bounding radii of the body. Without it rounding lets them
/// overlap, and directions between them are lost.
const MARGIN: f64 = 7e-5;

/// Speed up to which bodies are taken to be at rest, in tolerances d a second, and largest distance that this
/// comes to, in d: they are guarded as far beyond what they move, and twice as far at least. With less, a
/// body at rest is held where it is when it starts to move; with more, queries take longer. Where objects
/// move by themselves it is the largest: they do not wait in a step that is longer than the time between
/// queries.
const AT_REST: f64 = 30.0;
const MAX_AT_REST: f64 = 1.0;

/// Number of query intervals for which a body has room: one passes before a query's answer is in use, another
/// before that of the next one is, and one is a margin. With fewer, a body waits for queries.
const INTERVALS: f64 = 3.0;

/// Longest query interval for which it has room, s. With more, a body whose queries are late searches most of
/// the scene.
const MAX_INTERVAL: f64 = 0.1;

/// Query interval for which a body that is clear of all surfaces has room before any is known, s.
const FIRST_INTERVAL: f64 = 0.02;

/// Acceleration of a body that its coupling pulls, m/s² at the device. With less, a body that speeds up is
/// held back; with more, points are guarded that it does not reach.
const ACCELERATION: f64 = 5.0;

/// The same of a body that has waited: nothing holds it against its coupling then.
const WAITED_ACCELERATION: f64 = 50.0;

/// Least motion that points without room leave to a body, in tolerances d. With none, a body that more points
/// touch than there is room for could not come away; with more, these points overlap.
const MIN_ROOM: f64 = 0.02;

/// Largest number of starts: the nearest. With more, queries of fast bodies take longer; with fewer, they
/// wait near surfaces.
const MAX_STARTS: usize = 131_072;

/// Length of edges that are searched by themselves, in edges of cells. With more, places at which coarse
/// meshes touch are left out; with less, edges of fine meshes are searched one by one.
const LONG: f64 = 2.0;

/// Acceleration of a hand, m/s² at the device, at which a body that is clear of all surfaces is not held
/// back. With more, it takes longer to find how far it is clear of them.
const HAND_ACCELERATION: f64 = 50.0;

/// Time of motion within which a step may meet a point, s. With more, cells are larger than they need to be.
const NEAR_TIME: f64 = 1e-3;

/// The same for a body at rest, in tolerances d, if the reach of a step is not more.
const MIN_NEAR: f64 = 0.1;

/// Distance beyond which a bound on motion need not be known near a surface, in lengths of the reach. With
/// more, close fits are searched further than a body in them comes.
const ENOUGH: f64 = 1.25;

/// Largest edge of cells that starts are as fine as, in that of the smallest. With more, one start may stand
/// for all of a body.
const MAX_CELL: f64 = 8.0;

/// Number of distances that a query reads at most, for each second of the time between queries: about as many
/// as it reads in that time. With fewer, what is new to a fast body waits for the next queries, and the body
/// with it; with more, a query takes the longer for the last one having been late.
const READINGS: f64 = 1.5e6;

/// The same of the first query. With fewer, a body that starts near a surface waits for longer; with more, it
/// takes longer until it is held.
const FIRST_READINGS: usize = 2048;

/// Least and largest number of them of others.
const MIN_READINGS: usize = 4096;
const MAX_READINGS: usize = 32_768;

/// Share of them that is kept for starts that are known. With less, points start by older distances where
/// much is new; with more, what is new waits.
const FOR_STARTS: f64 = 0.25;

impl ContactLoop {
    /// Whether contacts with the object at a place are constraints. Contacts with light objects that they
    /// push, and with textured ones, are penalty contacts.
    pub(super) fn is_guarded(&self, place: usize) -> bool {
        self.scene.counterpart(Some(place)).is_constraint(self.response, self.mass)
            && !self.penalties.is_textured(place)
    }

    /// Whether contacts with all objects are constraints.
    pub(super) fn guards_all(&self) -> bool {
        (0..self.scene.objects.len()).all(|place| self.scene.get(place).is_none() || self.is_guarded(place))
    }

    /// Finds what the haptic loop needs to hold the body out of the objects that are guarded; `None` if the
    /// body has no surface.
    pub(super) fn guard(&mut self, body: &BodyState, pull: &Pull) -> Option<ContactGeometry> {
        let tolerance = self.parameters.tolerance;
        // Steps of a loop between those of another one take turns of one and of two.
        let longest = self.timing.interval.max(self.timing.before);
        let interval = if longest > 0.0 { longest.min(MAX_INTERVAL) } else { 0.0 };
        let ahead = INTERVALS * interval;
        let speed =
            body.twist.linear.length() + body.twist.angular.length() * self.radius + self.scene.fastest;
        // A body that waits is slow, and goes on with the hand.
        let scale = self.all_settings.device.workspace_scale;
        let acceleration = scale * if pull.waited { WAITED_ACCELERATION } else { ACCELERATION };
        let pulled = (0.5 * acceleration * ahead * ahead).min(pull.stretch + pull.speed * ahead);
        let at_rest =
            if self.scene.moving.is_empty() { (AT_REST * ahead).min(MAX_AT_REST) } else { MAX_AT_REST };
        let at_rest = at_rest * tolerance;
        let reach = (at_rest + speed * ahead + pulled).max(2.0 * at_rest);
        let radius = self.probe.bounding_radius();
        let edge = CELL * radius;
        let enough = {
            let ahead = INTERVALS * if interval > 0.0 { interval } else { FIRST_INTERVAL };
            reach + (pull.speed + 0.5 * scale * HAND_ACCELERATION * ahead) * ahead
        };
        // A body that touches a surface is held there anyway, if it speeds up.
        let enough =
            if self.constraints.guard.nearest() < reach { enough.min(ENOUGH * reach) } else { enough };
        let cell = edge * self.constraints.guard.cell().min(MAX_CELL);
        let reaches = Reaches { reach, enough, edge, cell, long: LONG * edge };
        let (points, reserves) = self.constraints.guard.room();
        let mut geometry = ContactGeometry {
            probe: self.probe.features()?,
            center_of_mass: self.center_of_mass,
            objects: Default::default(),
            points,
            reserves,
            bound: MotionBound { from: body.pose, room: reach, step: f64::INFINITY, radius: self.radius },
            friction: self.parameters.friction,
            margin: (MARGIN * radius).min(0.05 * tolerance),
            far: ArrayVec::new(),
            beyond: 0.0,
            far_speed: 0.0,
            age: 0.0,
        };
        let mesh = body.pose * Pose::from_translation(-self.center_of_mass);
        let mut guard = std::mem::take(&mut self.constraints.guard);
        guard.starts.clear();
        let readings = match interval > 0.0 {
            true => ((READINGS * interval) as usize).clamp(MIN_READINGS, MAX_READINGS),
            false => FIRST_READINGS,
        };
        let room = self.start(&mut guard, &mut geometry, &mesh, &reaches, readings);
        let room = room.min(guard.limit(MAX_STARTS).max(MIN_ROOM * tolerance));
        let near = (MIN_NEAR * tolerance).max(reach_of_step(0.0, 0.0, scale)) + speed * NEAR_TIME;
        let limits = Limits { edge, near, room: reach };
        let (nearest, dropped) = guard.fill(&mut geometry, &mesh, &limits);
        // Points for which there is no room are further away than all others.
        let room = room.max(0.0).min(nearest.max(MIN_ROOM * tolerance));
        geometry.bound.room = geometry.far.iter().fold(room, |room, far| room.min(far.room)).max(0.0);
        geometry.beyond = room - geometry.bound.room;
        geometry.far_speed = self.far_speed(&geometry);
        let overlap = -OVERLAP * geometry.margin;
        let is_deep = |point: &GuardedPoint| f64::from(point.slack) < overlap;
        for (index, object) in geometry.objects.iter_mut().enumerate() {
            let mut own = geometry.points.iter().filter(|point| usize::from(point.object) == index);
            object.overlapped = self.constraints.pairs.overlapped(object.place, || own.any(is_deep));
        }
        self.constraints.guard = guard;
        self.telemetry.events.contact_overflow += dropped as u64;
        Some(geometry)
    }

    /// Starts points at the features of the body and of the objects near it, as far as these are found by a
    /// number of readings. Returns how far the body may move before it could touch something else than those
    /// or the far objects, m; 0 if an object could not be searched.
    fn start(
        &mut self,
        guard: &mut Guard,
        geometry: &mut ContactGeometry,
        mesh: &Pose,
        reaches: &Reaches,
        readings: usize,
    ) -> f64 {
        let events = &mut self.telemetry.events;
        let Ok(invalid) = self.scene.query.find_near(mesh, reaches.enough) else {
            events.contact_refused += 1;
            return 0.0;
        };
        events.contact_refused += u64::from(invalid > 0);
        let mut room = if invalid > 0 { 0.0 } else { reaches.enough };
        let mut pairs = std::mem::take(&mut self.constraints.pairs);
        let mut handles = std::mem::take(&mut pairs.handles);
        handles.clear();
        handles.extend(self.scene.query.near());
        let ball = (self.center_of_mass, self.radius);
        let mut near = std::mem::take(&mut pairs.found);
        let mut far = std::mem::take(&mut pairs.far);
        far.clear();
        for &handle in &handles {
            let Some(object) = self.near_object(handle) else { continue };
            let known = pairs.of(object.place, &object.surface);
            known.begin((&geometry.probe, mesh), (&object.surface, &object.pose), ball, reaches);
            near.push(Found::new(object));
        }
        let probe = &*geometry.probe;
        let for_starts = (FOR_STARTS * readings as f64) as usize;
        let mut left = for_starts + pairs.search(probe, &mut near, reaches, readings - for_starts);
        for found in &mut near {
            let Found { object, starts, least, since, room: clear, .. } = found;
            let (to_probe, scene) = (mesh.inverse() * object.pose, &*object.surface);
            starts.start = guard.starts.len();
            let known = pairs.of(object.place, &object.surface);
            let pass = |near: &NearFeature| {
                let (at, direction) = if near.is_probe {
                    (near.point, probe.direction(&near.place))
                } else {
                    let direction = to_probe.transform_vector(scene.direction(&near.place));
                    (to_probe.transform_point(near.point), direction)
                };
                *least = least.min(near.least);
                guard.starts.push(Start::new(near, object.place, (at - ball.0, direction)));
            };
            let (others, rest) = known.end([probe, scene], (reaches, left), pass);
            (starts.end, left, *since) = (guard.starts.len(), rest, known.since());
            let clear = clear.min(others).max(0.0);
            let stands = self.scene.get(object.place).is_some_and(InScene::stands);
            if stands && clear < reaches.enough {
                far.push(FarObject { pose: object.pose, bounds: scene.bounds(), room: clear });
            } else {
                room = room.min(clear);
            }
        }
        near.retain(|found| !found.starts.is_empty());
        if near.len() > MAX_OBJECTS {
            // Those without room bound the motion by their distance.
            near.select_nth_unstable_by(MAX_OBJECTS, |a, b| a.least.total_cmp(&b.least));
            let least = MIN_ROOM * self.parameters.tolerance;
            self.telemetry.events.contact_overflow += (near.len() - MAX_OBJECTS) as u64;
            room = near.drain(MAX_OBJECTS..).map(|found| found.least.max(least)).fold(room, f64::min);
            near.sort_unstable_by_key(|found| found.starts.start);
        }
        if far.len() > MAX_FAR {
            far.select_nth_unstable_by(MAX_FAR, |a, b| a.room.total_cmp(&b.room));
            room = far.drain(MAX_FAR..).map(|far| far.room).fold(room, f64::min);
        }
        geometry.far.extend(far.iter().copied());
        guard.keep(near.iter().map(|found| found.starts.clone()));
        guard.since = near.iter().map(|found| found.since).collect();
        geometry.objects.extend(near.drain(..).map(|found| found.object));
        (pairs.handles, pairs.found, pairs.far) = (handles, near, far);
        pairs.end();
        self.constraints.pairs = pairs;
        room
    }

    /// Bound on the speed of moving objects that may come near before the next query and have no points in a
    /// geometry, m/s; but for those in other hands.
    fn far_speed(&self, geometry: &ContactGeometry) -> f64 {
        let MotionBound { from, room, radius, .. } = geometry.bound;
        let speeds = self.scene.moving.iter().filter_map(|place| {
            if geometry.objects.iter().any(|object| object.place == *place) {
                return None;
            }
            let object = self.scene.get(*place)?;
            if object.is_in_hand() {
                return None;
            }
            let speed = object.speed();
            let apart = self.scene.query.pose(object.handle)?.translation.distance(from.translation);
            let clear = apart - object.object.radius_about(DVec3::ZERO) - radius;
            (clear < room + speed * MAX_OBJECT_MOTION).then_some(speed)
        });
        speeds.fold(0.0, f64::max)
    }

    /// A scene object near the body, by its place; `None` if it is not guarded.
    fn near_object(&self, handle: ObjectHandle) -> Option<NearObject> {
        let place = handle.place();
        if !self.is_guarded(place) {
            return None;
        }
        let near = self.scene.get(place)?;
        let surface: Arc<FeatureMesh> = near.object.features()?;
        let pose = *self.scene.query.pose(handle)?;
        let motion: MovingBody = self.scene.counterpart(Some(place)).body();
        let pushable = near.moving.as_ref().and_then(|moving| {
            let radius = near.object.radius_about(moving.0.center_of_mass()?);
            moving.0.pushable(near.id, (&pose, radius), (self.timing.interval, self.timing.time))
        });
        let felt_elsewhere = near.moving.as_ref().is_some_and(|moving| moving.0.is_felt_elsewhere());
        Some(NearObject {
            place,
            surface,
            pose,
            before: pose,
            motion,
            // The haptic loop knows better how one in another hand moves.
            speed: if near.is_in_hand() { 0.0 } else { near.speed() },
            moved: 0.0,
            felt_elsewhere,
            overlapped: false,
            pushable,
            pushed: None,
            on_loan: Arc::clone(&near.on_loan),
        })
    }
}
