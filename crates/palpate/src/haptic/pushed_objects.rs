//! Scene objects that contacts push, which the haptic loop moves until their host answers.

use arrayvec::ArrayVec;
use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist};
use palpate_dynamics::{Constraint, HostState, MotionBound, PushedBody};

use super::joined::Joined;
use super::reactions::ReactionFeed;
use crate::constraints::geometry::{ContactGeometry, MAX_OBJECTS, NearObject, PredictedMotion};
use crate::scene::SceneId;
use crate::scene::moving::{HandMotion, Pushable};

/// Scene objects that the contacts of a tool push.
#[derive(Clone, Debug)]
pub(super) struct PushedObjects {
    bodies: ArrayVec<PushedBody, MAX_OBJECTS>,
    /// Those of the same indices.
    places: ArrayVec<Placing, MAX_OBJECTS>,
    /// Lengths of the world for those at the device.
    scale: f64,
}

/// How an object's mesh lies about its centre of mass.
#[derive(Clone, Copy, Debug)]
struct Placing {
    id: SceneId,
    /// Centre of mass in the mesh's frame, m.
    center: DVec3,
    /// Bounding radius about it, m.
    radius: f64,
    /// Set of the tool's bodies that it is near.
    near: u8,
}

impl Placing {
    fn mesh(&self, body: &PushedBody) -> Pose {
        *body.pose() * Pose::from_translation(-self.center)
    }
}

impl PushedObjects {
    /// None, in a world in which lengths are `scale` times those at the device.
    pub fn new(scale: f64) -> Self {
        Self { bodies: ArrayVec::new(), places: ArrayVec::new(), scale }
    }

    /// Takes over the objects that were found near a body of the tool, with what their hosts say of them.
    pub fn take(&mut self, body: usize, geometry: &mut ContactGeometry) {
        let near = 1_u8 << body;
        for place in &mut self.places {
            place.near &= !near;
        }
        for object in &geometry.objects {
            let Some(pushable) = &object.pushable else { continue };
            let Some((index, is_new)) = self.known(object) else { continue };
            let (Some(body), Some(place)) = (self.bodies.get_mut(index), self.places.get_mut(index)) else {
                continue;
            };
            place.near |= near;
            body.set_delay(pushable.delay);
            if pushable.in_hand {
                // The other haptic loop says more.
            } else if pushable.is_placed {
                body.place(&pushable.host_state);
            } else {
                body.set_load(&pushable.load);
                if let (true, Some(acceleration)) = (is_new, &pushable.acceleration) {
                    body.start_response(acceleration);
                }
                body.apply_host_state(&pushable.host_state);
                body.update_response();
            }
        }
        for index in (0..self.places.len()).rev() {
            if self.places[index].near == 0 {
                self.places.swap_remove(index);
                self.bodies.swap_remove(index);
            }
        }
        self.move_objects(geometry);
    }

    /// Index of an object that contacts push, and whether it was added now; `None` if there is no room.
    fn known(&mut self, object: &NearObject) -> Option<(usize, bool)> {
        let pushable = object.pushable.as_ref()?;
        let known = self.places.iter().position(|place| place.id == pushable.id);
        if let Some(known) = known {
            return Some((known, false));
        }
        let Pushable { id, center, radius, .. } = *pushable;
        let pose = object.pose * Pose::from_translation(center);
        let Twist { angular, .. } = object.motion.twist;
        let twist = Twist::new(object.motion.twist.velocity_at(pose.translation), angular);
        let mut body = PushedBody::new(&pushable.body, &pushable.host_state).at_scale(self.scale);
        body.start(&pose, &twist);
        self.places.try_push(Placing { id, center, radius, near: 0 }).ok()?;
        self.bodies.try_push(body).ok()?;
        Some((self.places.len() - 1, true))
    }

    /// Numbers an object and places it where it is by now. Returns it, if contacts push it, with a bound on
    /// how far any of its points was from there, m: whatever moved it, a step, a jump that its host told, or
    /// another body of the tool.
    fn place(&self, object: &mut NearObject) -> Option<(&PushedBody, &Placing, f64)> {
        let id = object.pushable.as_ref()?.id;
        let index = self.places.iter().position(|place| place.id == id);
        object.pushed = index.map(|index| index as u8);
        let (body, place) = (self.bodies.get(index?)?, self.places.get(index?)?);
        let from = object.pose * Pose::from_translation(place.center);
        let moved = MotionBound { from, radius: place.radius, ..MotionBound::NONE }.displacement(body.pose());
        object.pose = place.mesh(body);
        object.moved += moved;
        Some((body, place, moved))
    }

    /// Moves the objects of a geometry to where they are by now, as contacts of this step see them.
    pub fn move_objects(&self, geometry: &mut ContactGeometry) {
        let mut most: f64 = 0.0;
        for object in &mut geometry.objects {
            if let Some((body, place, moved)) = self.place(object) {
                let Twist { linear, angular } = *body.surface_twist();
                object.speed = linear.length() + angular.length() * place.radius;
                let linear = linear - angular.cross(body.pose().translation);
                object.motion.twist = Twist { linear, angular };
                most = most.max(moved);
            }
        }
        // Each object comes nearer by its own motion only.
        geometry.bound.room -= most;
    }

    /// The objects, by the indices that contacts have.
    pub fn bodies(&self) -> &[PushedBody] {
        &self.bodies
    }

    /// Takes note of what the haptic loops of other hands say of the objects that they hold, and of the
    /// impulses that were sent there since.
    pub fn follow_hands(&mut self, joined: &[Joined], reacting: &ReactionFeed) {
        for other in joined.iter().filter(|other| other.is_new) {
            let Some(index) = self.places.iter().position(|place| place.id == other.id) else { continue };
            let HandMotion { pose, twist, load } = *other.motion();
            let (Some(body), Some(place)) = (self.bodies.get_mut(index), self.places.get(index)) else {
                continue;
            };
            let arm = pose.rotation * place.center;
            let pose = pose * Pose::from_translation(place.center);
            body.set_load(&load);
            // It was so after the last step, but for impulses that wait: without these, what they do would be
            // taken back, and the object be pushed for it again.
            let struck = body.change(reacting.waiting_for(other.id, pose.translation));
            let linear = twist.velocity_at(arm) + struck.linear;
            let twist = Twist::new(linear, twist.angular + struck.angular);
            body.apply_host_state(&HostState { time: f64::INFINITY, pose, twist });
        }
    }

    /// Begins a step of `dt` (s).
    pub fn begin(&mut self, dt: f64) {
        if dt > 0.0 {
            self.bodies.iter_mut().for_each(|body| body.begin(dt));
        }
    }

    /// Pushes the objects by contacts with a body of the tool, whose arms are from a centre of mass (m). Adds
    /// the impulses to a feed. Returns the number of objects for which it had no room.
    pub fn push(
        &mut self,
        objects: &[NearObject],
        contacts: &[Constraint],
        center: DVec3,
        reacting: &mut ReactionFeed,
    ) -> u64 {
        let mut lost = 0;
        for contact in contacts.iter().filter(|contact| contact.impulse != DVec3::ZERO) {
            let Some(index) = contact.pushed else { continue };
            let point = center + contact.arm;
            if let Some(body) = self.bodies.get_mut(usize::from(index)) {
                body.push(contact.impulse, point);
            }
            let object = objects.iter().find(|object| object.pushed == Some(index));
            if let Some(number) = object.and_then(|object| object.motion.object) {
                lost += reacting.push(number, contact.impulse, point.cross(contact.impulse));
            }
        }
        lost
    }

    /// Ends a step of `dt` (s) at a time (s): the objects move.
    pub fn end(&mut self, dt: f64, time: f64) {
        if dt > 0.0 {
            self.bodies.iter_mut().for_each(|body| body.end(dt, time));
        }
    }

    /// Writes the motion of all objects.
    pub fn write(&self, to: &mut PredictedMotion) {
        to.clear();
        for (body, place) in self.bodies.iter().zip(&self.places) {
            let Twist { linear, angular } = *body.surface_twist();
            let mesh = place.mesh(body);
            let arm = mesh.translation - body.pose().translation;
            to.push((place.id, mesh, Twist { linear: linear + angular.cross(arm), angular }));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use palpate_core::TriMesh;
    use palpate_core::glam::DMat3;
    use palpate_dynamics::{Body, Friction, MovingBody};
    use palpate_field::FeatureMesh;

    use super::*;

    const ID: SceneId = SceneId(3);
    const RADIUS: f64 = 0.1;

    /// A geometry with an object in another hand that contacts push, at rest about the origin.
    fn geometry() -> ContactGeometry {
        let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let corners = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].into_iter().map(|at| at * RADIUS);
        let surface =
            Arc::new(FeatureMesh::new(&TriMesh::new(corners.collect(), triangles).expect("a tetrahedron")));
        let told = HostState { time: f64::NEG_INFINITY, pose: Pose::IDENTITY, twist: Twist::ZERO };
        let pushable = Pushable {
            id: ID,
            body: Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4))).expect("a body"),
            center: DVec3::ZERO,
            host_state: told,
            is_placed: false,
            in_hand: true,
            delay: 2e-3,
            load: Twist::ZERO,
            acceleration: None,
            radius: RADIUS,
        };
        let mut objects = ArrayVec::new();
        objects.push(NearObject {
            place: 0,
            surface: Arc::clone(&surface),
            pose: Pose::IDENTITY,
            before: Pose::IDENTITY,
            motion: MovingBody::STILL,
            speed: 0.0,
            moved: 0.0,
            felt_elsewhere: false,
            overlapped: false,
            pushable: Some(pushable),
            pushed: None,
            on_loan: Arc::default(),
        });
        ContactGeometry {
            probe: surface,
            center_of_mass: DVec3::ZERO,
            objects,
            points: Arc::default(),
            reserves: Arc::default(),
            bound: MotionBound { room: 1.0, ..MotionBound::NONE },
            friction: Friction::NONE,
            margin: 0.0,
            far: ArrayVec::new(),
            beyond: 0.0,
            far_speed: 0.0,
            age: 0.0,
        }
    }

    /// The other hand tells of a jump, which is too far to be taken over gradually: the points lose it, those
    /// of both bodies of a tool.
    #[test]
    fn a_jump_that_another_hand_tells_counts_as_motion() {
        let (mut geometries, mut pushed) = ([geometry(), geometry()], PushedObjects::new(1.0));
        for (body, geometry) in geometries.iter_mut().enumerate() {
            pushed.take(body, geometry);
            assert_eq!((geometry.objects[0].moved, geometry.bound.room), (0.0, 1.0));
        }
        let at = |shift: f64| HandMotion {
            pose: Pose::from_translation(DVec3::X * shift),
            twist: Twist::ZERO,
            load: Twist::ZERO,
        };
        let (mut hand, motion) = triple_buffer::triple_buffer(&at(0.0));
        let mut joined = Joined::new(ID, motion, RADIUS);
        let mut step = |told: f64, time: f64| {
            hand.write(at(told));
            joined.update(time);
            pushed.follow_hands(std::slice::from_ref(&joined), &ReactionFeed::default());
            pushed.begin(1e-3);
            pushed.end(1e-3, time);
            geometries.each_mut().map(|geometry| {
                geometry.bound.room = 1.0;
                pushed.move_objects(geometry);
                (std::mem::take(&mut geometry.objects[0].moved), 1.0 - geometry.bound.room)
            })
        };
        // A small motion is taken over gradually.
        for (moved, gone) in step(1e-3, 1e-3) {
            assert!(moved > 1e-4 && moved < 1e-3 && (gone - moved).abs() < 1e-12, "{moved} m, {gone} m");
        }
        for (moved, gone) in step(0.06, 2e-3) {
            assert!(moved > 0.055 && moved < 0.061 && (gone - moved).abs() < 1e-12, "{moved} m, {gone} m");
        }
    }

    /// The way of an object in another hand since a query, however old that is.
    #[test]
    fn the_way_of_another_hand_covers_the_age_of_a_query() {
        let at = |shift: f64| HandMotion {
            pose: Pose::from_translation(DVec3::X * shift),
            twist: Twist::ZERO,
            load: Twist::ZERO,
        };
        let (mut hand, motion) = triple_buffer::triple_buffer(&at(0.0));
        let mut joined = Joined::new(ID, motion, RADIUS);
        // 1 mm to and fro in each step of 0.3 ms: it is always near, and its way long.
        for count in 1..=400 {
            hand.write(at(1e-3 * f64::from(count % 2)));
            joined.update(3e-4 * f64::from(count));
        }
        for age in [0.0, 1e-3, 0.0117, 0.05] {
            let (moved, wanted) = (joined.moved_in(age), 1e-3 * age / 3e-4);
            // It is known to about a millisecond.
            assert!(moved >= wanted - 1e-9 && moved <= wanted + 5e-3, "{age} s: {moved} m of {wanted} m");
        }
        assert!((joined.moved_in(10.0) - 0.4).abs() < 1e-9, "{}", joined.moved_in(10.0));
    }
}
