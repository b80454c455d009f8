//! Scene objects that contacts push, which the haptic loop moves until their host answers.

use arrayvec::ArrayVec;
use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist};
use palpate_dynamics::{HostState, PushedBody, UnilateralContact};

use super::joined::Joined;
use super::reactions::ReactionFeed;
use crate::contact::geometry::{ContactGeometry, MAX_OBJECTS, NearObject, PredictedMotion};
use crate::scene::SceneId;
use crate::scene::moving::{HandMotion, Pushable};

/// Scene objects that the contacts of a tool push.
#[derive(Clone, Debug, Default)]
pub(super) struct PushedObjects {
    bodies: ArrayVec<PushedBody, MAX_OBJECTS>,
    /// Those of the same indices.
    places: ArrayVec<Placing, MAX_OBJECTS>,
}

/// How an object's mesh lies about its centre of mass, and how it has moved.
#[derive(Clone, Copy, Debug)]
struct Placing {
    id: SceneId,
    /// Centre of mass in the mesh's frame, m.
    center: DVec3,
    /// Bounding radius about it, m.
    radius: f64,
    /// Set of the tool's bodies that it is near.
    near: u8,
    /// Bound on the motion of any point of the object in the last step, m.
    moved: f64,
}

impl Placing {
    fn mesh(&self, body: &PushedBody) -> Pose {
        *body.pose() * Pose::from_translation(-self.center)
    }
}

impl PushedObjects {
    /// Takes over the objects that were found near a body of the tool, with what their hosts say of them.
    pub fn take(&mut self, body: usize, geometry: &mut ContactGeometry) {
        let near = 1_u8 << body;
        for place in &mut self.places {
            place.near &= !near;
        }
        for object in &geometry.objects {
            let Some(pushable) = &object.pushable else { continue };
            let Some(index) = self.known(object) else { continue };
            let (Some(body), Some(place)) = (self.bodies.get_mut(index), self.places.get_mut(index)) else {
                continue;
            };
            place.near |= near;
            body.set_delay(pushable.delay);
            if pushable.in_hand {
                // The other haptic loop says more.
            } else if pushable.is_placed {
                body.place(&pushable.told);
            } else {
                body.set_load(&pushable.load);
                body.hear(&pushable.told);
                body.learn();
            }
        }
        for index in (0..self.places.len()).rev() {
            if self.places[index].near == 0 {
                self.places.swap_remove(index);
                self.bodies.swap_remove(index);
            }
        }
        for object in &mut geometry.objects {
            let found = object.pose;
            if let Some((body, place)) = self.place(object) {
                let shift = found.transform_point(place.center).distance(body.pose().translation);
                object.moved = shift + found.rotation_vector_to(&object.pose).length() * place.radius;
            }
        }
    }

    /// Index of an object that contacts push, which is added if it is not known; `None` if there is no room.
    fn known(&mut self, object: &NearObject) -> Option<usize> {
        let pushable = object.pushable.as_ref()?;
        let known = self.places.iter().position(|place| place.id == pushable.id);
        if known.is_some() {
            return known;
        }
        let Pushable { id, center, radius, .. } = *pushable;
        let pose = object.pose * Pose::from_translation(center);
        let Twist { angular, .. } = object.motion.twist;
        let twist = Twist::new(object.motion.twist.velocity_at(pose.translation), angular);
        let mut body = PushedBody::new(&pushable.body, &pushable.told);
        body.start(&pose, &twist);
        self.places.try_push(Placing { id, center, radius, near: 0, moved: 0.0 }).ok()?;
        self.bodies.try_push(body).ok()?;
        Some(self.places.len() - 1)
    }

    /// Numbers an object and places it where it is by now. Returns it, if contacts push it.
    fn place(&self, object: &mut NearObject) -> Option<(&PushedBody, &Placing)> {
        let id = object.pushable.as_ref()?.id;
        let index = self.places.iter().position(|place| place.id == id);
        object.pushed = index.map(|index| index as u8);
        let (body, place) = (self.bodies.get(index?)?, self.places.get(index?)?);
        object.pose = place.mesh(body);
        Some((body, place))
    }

    /// Whether it moves an object.
    pub fn moves(&self, id: SceneId) -> bool {
        self.places.iter().any(|place| place.id == id)
    }

    /// The objects, by the indices that contacts have.
    pub fn bodies(&self) -> &[PushedBody] {
        &self.bodies
    }

    /// Takes note of what the haptic loops of other hands say of the objects that they hold.
    pub fn listen(&mut self, joined: &[Joined]) {
        for other in joined.iter().filter(|other| other.is_new) {
            let Some(index) = self.places.iter().position(|place| place.id == other.id) else { continue };
            let HandMotion { pose, twist, load } = *other.motion();
            let (Some(body), Some(place)) = (self.bodies.get_mut(index), self.places.get(index)) else {
                continue;
            };
            let arm = pose.rotation * place.center;
            body.set_load(&load);
            // It was so after the last step.
            body.hear(&HostState {
                time: f64::INFINITY,
                pose: pose * Pose::from_translation(place.center),
                twist: Twist::new(twist.velocity_at(arm), twist.angular),
            });
        }
    }

    /// Begins a step of `dt` (s).
    pub fn begin(&mut self, dt: f64) {
        if dt > 0.0 {
            self.bodies.iter_mut().for_each(|body| body.begin(dt));
        }
    }

    /// Moves the objects of a geometry as contacts of this step see them. In a new one their last motion
    /// counts twice, which is safe.
    pub fn move_objects(&self, geometry: &mut ContactGeometry) {
        for object in &mut geometry.objects {
            if let Some((body, place)) = self.place(object) {
                object.moved = place.moved;
                let Twist { linear, angular } = *body.surface_twist();
                let linear = linear - angular.cross(body.pose().translation);
                object.motion.twist = Twist { linear, angular };
            }
        }
    }

    /// Pushes the objects by contacts with a body of the tool, whose arms are from a centre of mass (m). Adds
    /// the impulses to a feed. Returns the number of objects for which it had no room.
    pub fn push(
        &mut self,
        objects: &[NearObject],
        contacts: &[UnilateralContact],
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
        for (body, place) in self.bodies.iter_mut().zip(&mut self.places) {
            let (shift, turn) = if dt > 0.0 { body.end(dt, time) } else { (0.0, 0.0) };
            place.moved = shift + turn * place.radius;
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
