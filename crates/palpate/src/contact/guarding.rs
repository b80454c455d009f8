//! The step of the contact loop that finds contact geometry.

use std::sync::Arc;

use arrayvec::ArrayVec;
use palpate_collide::{ObjectHandle, QuerySettings};
use palpate_core::glam::DVec3;
use palpate_core::{Clod, Pose};
use palpate_dynamics::{BodyState, MotionBound, MovingBody};
use palpate_field::FeatureMesh;

use super::ContactLoop;
use super::assemble::counterpart;
use super::by_fields::{NearFields, in_steps};
use super::geometry::{ContactGeometry, MAX_OBJECT_MOTION, NearObject};
use super::guard::{Guard, Limits, Start, StartPlace};
use super::near_samples::{Sampled, sample_long_edges};
use super::proxy::{ContactFinder as _, LevelFinder, QueryReport};
use crate::settings::Response;

/// Edge of the cells in each of which a point starts, in bounding radii of the body. With larger cells, local
/// minima of the distance are missed; with smaller ones there are more points.
const CELL: f64 = 0.02;

/// Distance at which surfaces are held apart, in bounding radii of the body. Without it rounding lets them
/// overlap, and directions between them are lost.
const MARGIN: f64 = 7e-5;

/// Smallest distance within which points are guarded, in tolerances d. With less, a body at rest is held
/// where it is when it starts to move.
const MIN_REACH: f64 = 2.0;

/// Distance within which points are guarded, in tolerances d, if patches within a larger one have more starts
/// than [`MAX_STARTS`]. With less, a fast body waits near surfaces; with more, queries take longer.
const NARROW_REACH: f64 = 4.0;

/// Largest distance within which parts of surfaces are guarded beyond the fields' band, in tolerances d. With
/// less, a fast body waits for queries; with more, the parts are too large to be guarded by a point each.
const FAR_REACH: f64 = 16.0;

/// Sizes of these parts that are tried, relative to the distance from which they are. With smaller ones,
/// there are more points; with larger ones, minima of the distance are missed.
const FAR_SIZES: [f64; 4] = [0.5, 1.0, 2.0, 4.0];

/// Largest number of them on a surface.
const MAX_FAR: usize = 128;

/// Acceleration of a body in a hand, m/s², for which it has room until newer contacts. With less, a body that
/// speeds up is held back; with more, points are guarded that it does not reach.
const ACCELERATION: f64 = 5.0;

/// Number of starts in patches from which a narrower distance is searched. With more, queries of fast bodies
/// take longer.
const MAX_STARTS: usize = 16_384;

/// Length of long edges, in edges of cells. With more, samples of faces leave out places at which coarse
/// meshes touch; with less, edges of fine meshes are sampled one by one.
const LONG: f64 = 2.0;

/// Speed of the hand, m/s, at which a body that is clear of all surfaces is not held back. With more, it
/// takes longer to find how far it is clear of them.
const HAND_SPEED: f64 = 2.0;

/// Time of motion within which a step may meet a point, s. With more, cells are larger than they need to be.
const NEAR_TIME: f64 = 1e-3;

/// The same for a body at rest, in tolerances d.
const MIN_NEAR: f64 = 0.1;

/// Largest distance of a point from where it starts, in edges of cells and at least the reach, where edges
/// cross. With less, edges that slide over each other lose it; with more, crossings that are apart become
/// one.
const CROSSING_LEASH: f64 = 4.0;

impl ContactLoop {
    /// Whether contacts with the object at a place are constraints. Contacts with light objects that they
    /// push, and with textured ones, are penalty contacts.
    pub(super) fn is_guarded(&self, place: usize) -> bool {
        counterpart(&self.objects, &self.scene, Some(place)).is_constraint(self.response, self.mass)
            && !self.textures.as_ref().is_some_and(|textures| textures.has(place))
    }

    /// How contacts act, in words.
    pub(crate) fn response_stage(&self) -> String {
        let light = self.moving.iter().any(|&place| !self.is_guarded(place));
        match self.response {
            Response::Penalty => "penalties".to_owned(),
            Response::Constraints if self.textures.is_some() => {
                "constraints; penalties with textured objects".to_owned()
            }
            Response::Constraints if light => "constraints; penalties with light objects".to_owned(),
            Response::Constraints => "constraints".to_owned(),
        }
    }

    /// Whether all contacts are constraints.
    pub(crate) fn guards_only(&self) -> bool {
        self.response == Response::Constraints && self.guards_all()
    }

    /// Whether contacts with all objects are constraints.
    pub(super) fn guards_all(&self) -> bool {
        (0..self.objects.len()).all(|place| self.objects[place].is_none() || self.is_guarded(place))
    }

    /// Finds what the haptic loop needs to hold the body out of the objects that are guarded; `None` if the
    /// body has no surface.
    pub(super) fn guard(&mut self, body: &BodyState) -> Option<ContactGeometry> {
        let tolerance = self.parameters.tolerance;
        let ahead = self.lookahead.horizon(self.interval);
        let speed = body.twist.linear.length() + body.twist.angular.length() * self.radius + self.fastest;
        let motion = (speed + 0.5 * ACCELERATION * ahead) * ahead;
        // In patches a wide search takes long, so that the body has room for its present speed alone.
        let searched = if self.is_by_fields() { motion } else { speed * ahead };
        let mut reach =
            in_steps(tolerance + searched, tolerance).max(MIN_REACH * tolerance).min(self.max_reach());
        let radius = self.probe.bounding_radius();
        let mut geometry = ContactGeometry {
            probe: self.probe.features()?,
            center_of_mass: self.center_of_mass,
            objects: Default::default(),
            points: Default::default(),
            bound: MotionBound { from: body.pose, room: reach, step: f64::INFINITY, radius: self.radius },
            friction: self.parameters.friction,
            margin: (MARGIN * radius).min(0.05 * tolerance),
            far_speed: 0.0,
            age: 0.0,
        };
        let mesh = body.pose * Pose::from_translation(-self.center_of_mass);
        let mut guard = std::mem::take(&mut self.guard);
        guard.starts.clear();
        guard.far.clear();
        let mut report = QueryReport::default();
        let edge = CELL * radius;
        let room = if self.is_by_fields() {
            let enough = reach + (2.0 * motion).max(HAND_SPEED * ahead);
            let wanted = (tolerance + motion).min(FAR_REACH * tolerance).max(reach);
            let reaches = [reach, wanted, enough.min(self.probe.shape().max_tolerance()).max(wanted)];
            let room = self.start_in_fields(&mut guard, &mut geometry, (&mesh, edge), reaches, &mut report);
            reach = wanted;
            room
        } else {
            let at = (&mesh, edge);
            let wide = self.start_at_patches(&mut guard, &mut geometry, at, (reach, MAX_STARTS), &mut report);
            wide.unwrap_or_else(|| {
                reach = reach.min(NARROW_REACH * tolerance);
                guard.starts.clear();
                geometry.objects.clear();
                let all = (reach, usize::MAX);
                self.start_at_patches(&mut guard, &mut geometry, at, all, &mut report).unwrap_or(0.0)
            })
        };
        let near = MIN_NEAR * tolerance + speed * NEAR_TIME;
        let (nearest, dropped) = guard.fill(&mut geometry, &mesh, &Limits { reach, edge, near });
        geometry.bound.room = if report.refused { 0.0 } else { room.min(nearest.max(0.0)) };
        geometry.far_speed = self.far_speed(&geometry);
        self.guard = guard;
        let events = &mut self.telemetry.events;
        events.contact_refused += u64::from(report.refused);
        events.contact_overflow += (report.dropped + dropped) as u64;
        events.not_converged += report.not_converged as u64;
        Some(geometry)
    }

    /// Bound on the speed of moving objects that may come near before the next query and have no points in a
    /// geometry, m/s; but for those in other hands.
    fn far_speed(&self, geometry: &ContactGeometry) -> f64 {
        let MotionBound { from, room, radius, .. } = geometry.bound;
        let speeds = self.moving.iter().filter_map(|place| {
            if geometry.objects.iter().any(|object| object.place == *place) {
                return None;
            }
            let object = self.objects.get(*place)?.as_ref()?;
            if object.is_in_hand() {
                return None;
            }
            let speed = object.speed();
            let apart = self.scene.pose(object.handle)?.translation.distance(from.translation);
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
        let near = self.objects.get(place)?.as_ref()?;
        let surface: Arc<FeatureMesh> = near.object.features()?;
        let pose = *self.scene.pose(handle)?;
        let motion: MovingBody = counterpart(&self.objects, &self.scene, Some(place)).body();
        let pushable = near.moving.as_ref().and_then(|moving| {
            let radius = near.object.radius_about(moving.0.center_of_mass()?);
            moving.0.pushable(near.id, (&pose, radius), (self.interval, self.time))
        });
        let felt_elsewhere = near.moving.as_ref().is_some_and(|moving| moving.0.is_felt_elsewhere());
        Some(NearObject {
            place,
            surface,
            pose,
            motion,
            // The haptic loop knows better how one in another hand moves.
            speed: if near.is_in_hand() { 0.0 } else { near.speed() },
            moved: 0.0,
            felt_elsewhere,
            pushable,
            pushed: None,
            on_loan: Arc::clone(&near.on_loan),
        })
    }

    /// Starts points at the samples in fields within the first of three reaches (m), at long edges, and in
    /// parts of surfaces within the second. Returns how far the body may move before it could touch something
    /// else, up to the third, m.
    fn start_in_fields(
        &mut self,
        guard: &mut Guard,
        geometry: &mut ContactGeometry,
        (mesh, edge): (&Pose, f64),
        [reach, wanted, enough]: [f64; 3],
        report: &mut QueryReport,
    ) -> f64 {
        let Guard { starts, far, .. } = guard;
        let Ok(invalid) = self.scene.find_near(mesh, enough) else {
            report.refused = true;
            return 0.0;
        };
        report.refused |= invalid > 0;
        let (mut room, long) = (enough, LONG * edge);
        let handles: ArrayVec<ObjectHandle, 64> = self.scene.near().take(64).collect();
        for handle in handles {
            let Some(object) = self.near_object(handle) else { continue };
            let Ok(fields) = &mut self.by_fields else { continue };
            let settings = fields.needs.settings(reach);
            let Some(NearFields { probe, scene, probe_places, samples }) = fields.near(handle.place()) else {
                continue;
            };
            let to_object = object.pose.inverse() * *mesh;
            let clearance = probe.body().clearance(scene.body(), &to_object, (wanted, enough));
            if clearance > wanted || geometry.objects.is_full() {
                room = room.min(clearance);
                continue;
            }
            let index = geometry.objects.len() as u8;
            let probe = (probe.body(), &*geometry.probe, mesh);
            let scene = (scene.body(), &*object.surface, &object.pose);
            samples.find(probe, probe_places, scene, long, &settings, |sample, place| {
                let on = StartPlace::Known(place);
                let (at, direction) = (sample.on_probe.as_dvec3(), sample.normal.as_dvec3());
                let (is_probe, distance) = (sample.is_probe, sample.distance);
                starts.push(Start::new(on, (is_probe, false), index, (at, direction), distance));
            });
            for (own, other, is_probe) in [(probe, scene, true), (scene, probe, false)] {
                let to_probe = if is_probe { Pose::IDENTITY } else { to_object.inverse() };
                sample_long_edges(own, other, (long, edge), reach, |sample| {
                    let on = StartPlace::Known(sample.place);
                    let at = to_probe.transform_point(sample.point);
                    let along = to_probe.transform_vector(sample.along);
                    starts.push(Start::new(on, (is_probe, true), index, (at, along), sample.distance));
                });
            }
            let sides = [(probe, scene, true), (scene, probe, false)];
            room = room.min(start_all_far(far, sides, index, (reach, wanted)));
            geometry.objects.push(object);
        }
        room
    }

    /// Starts points where patches within a reach (m) may touch. Returns how far the body may move before
    /// it could touch something else, m; `None` if there are more than `most` starts.
    fn start_at_patches(
        &mut self,
        guard: &mut Guard,
        geometry: &mut ContactGeometry,
        (mesh, edge): (&Pose, f64),
        (reach, most): (f64, usize),
        report: &mut QueryReport,
    ) -> Option<f64> {
        let settings = QuerySettings::new(reach);
        let mut finder = LevelFinder { scene: &mut self.scene, settings };
        let complete = finder.find(mesh, report);
        let to_probe = mesh.inverse();
        let mut room = if complete { reach } else { 0.0 };
        for found in self.scene.contacts() {
            let Some(object) = self.near_object(found.object) else { continue };
            if geometry.objects.is_full() {
                room = 0.0;
                break;
            }
            let index = geometry.objects.len() as u8;
            let to_object = object.pose.inverse();
            let Some(scene) = self.objects.get(found.object.place()).and_then(Option::as_ref) else {
                continue;
            };
            let Guard { starts, patches, .. } = &mut *guard;
            for patch in found.contacts {
                if starts.len() > most {
                    return None;
                }
                let contact = patch.contact;
                let mut start = |at: DVec3, is_probe: bool, distance: f64, along: Option<DVec3>| {
                    let on_probe = to_probe.transform_point(at);
                    let home = if is_probe { on_probe } else { to_object.transform_point(at) };
                    let on = StartPlace::Near(home.as_vec3());
                    // A corner of several patches is one start.
                    let direction = along.map_or(DVec3::Z, |along| to_probe.transform_vector(along));
                    let kind = (is_probe, along.is_some());
                    let mut start = Start::new(on, kind, index, (on_probe, direction), distance);
                    if along.is_some() {
                        start.leash = (CROSSING_LEASH * edge).max(reach) as f32;
                    }
                    starts.push(start);
                };
                start(contact.point, true, -contact.depth, None);
                start(contact.scene_point, false, -contact.depth, None);
                let probe = (&*self.probe.clod, patch.probe_node, mesh);
                let scene = (&*scene.object.clod, patch.scene_node, &object.pose);
                // The contact itself stands for small patches.
                let radius = |(clod, node, _): (&Clod, u32, &Pose)| clod.node(node).radius;
                if radius(probe).max(radius(scene)) < edge {
                    continue;
                }
                patches.find(probe, scene, &contact, reach, start);
            }
            geometry.objects.push(object);
        }
        Some(room)
    }
}

/// Starts points in parts of two surfaces that are further from each other than the first of two reaches (m).
/// Returns how far the bodies are from touching in any other part, m: the second reach, or less where its
/// parts are too many.
fn start_all_far(
    far: &mut Vec<Start>,
    sides: [(Sampled<'_>, Sampled<'_>, bool); 2],
    object: u8,
    (reach, wanted): (f64, f64),
) -> f64 {
    let first = far.len();
    let mut within = wanted;
    while within > reach {
        for size in FAR_SIZES {
            if sides.into_iter().all(|sides| start_far(far, sides, object, (reach, within), size * reach)) {
                return within;
            }
            far.truncate(first);
        }
        within *= 0.5;
    }
    reach
}

/// Starts points in parts of about a size (m) of a surface that are within reaches (m) of another one;
/// `false` if there are too many.
fn start_far(
    far: &mut Vec<Start>,
    (own, other, is_probe): (Sampled<'_>, Sampled<'_>, bool),
    object: u8,
    reaches: (f64, f64),
    size: f64,
) -> bool {
    let to_other = other.2.inverse() * *own.2;
    own.0.parts_within(other.0, &to_other, reaches, (size, MAX_FAR), |part| {
        let on = StartPlace::Near(part.center.as_vec3());
        let mut start = Start::new(on, (is_probe, false), object, (DVec3::ZERO, DVec3::Z), part.distance);
        start.leash = 2.0 * part.radius as f32;
        far.push(start);
    })
}
