//! Scene objects that contacts push, which the haptic loop moves until their host answers.

use arrayvec::ArrayVec;
use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist};
use palpate_dynamics::{HostState, PushedBody, UnilateralContact};

use super::joined::Joined;
use super::reactions::ReactionFeed;
use crate::contact::geometry::{ContactGeometry, MAX_OBJECTS, PredictedMotion};
use crate::scene::SceneId;
use crate::scene::moving::HandMotion;

/// Scene objects that contacts with one body push.
#[derive(Clone, Debug, Default)]
pub(super) struct PushedObjects {
    bodies: ArrayVec<PushedBody, MAX_OBJECTS>,
    /// Those of the same indices.
    places: ArrayVec<Placing, MAX_OBJECTS>,
}

/// How an object's mesh lies about its centre of mass.
#[derive(Clone, Copy, Debug)]
struct Placing {
    id: SceneId,
    /// Centre of mass in the mesh's frame, m.
    center: DVec3,
    /// Bounding radius about it, m.
    radius: f64,
}

impl Placing {
    /// Bound on the motion of any point of the object, for a shift of its centre of mass (m) and a turn
    /// (rad).
    fn motion(&self, (shift, turn): (f64, f64)) -> f64 {
        shift + turn * self.radius
    }

    fn mesh(&self, body: &PushedBody) -> Pose {
        *body.pose() * Pose::from_translation(-self.center)
    }
}

impl PushedObjects {
    /// Takes over objects that were found, with what their hosts say of them; the geometry's objects are
    /// placed where they are by now.
    pub fn take(&mut self, geometry: &mut ContactGeometry) {
        let known = |id: &SceneId| {
            let near = geometry.objects.iter().filter_map(|object| object.pushable.as_ref());
            near.clone().any(|near| near.id == *id)
        };
        for index in (0..self.places.len()).rev() {
            if !known(&self.places[index].id) {
                self.places.swap_remove(index);
                self.bodies.swap_remove(index);
            }
        }
        for object in &mut geometry.objects {
            let Some(pushable) = object.pushable else { continue };
            let found = self.places.iter().position(|place| place.id == pushable.id);
            let index = found.unwrap_or(self.places.len());
            if found.is_none() {
                let pose = object.pose * Pose::from_translation(pushable.center);
                let twist = Twist::new(
                    object.motion.twist.velocity_at(pose.translation),
                    object.motion.twist.angular,
                );
                let mut body = PushedBody::new(&pushable.body, &pushable.told);
                body.start(&pose, &twist);
                let placing = Placing { id: pushable.id, center: pushable.center, radius: pushable.radius };
                // There are no more than the geometry has objects.
                if self.bodies.try_push(body).is_err() || self.places.try_push(placing).is_err() {
                    continue;
                }
            }
            let (Some(body), Some(place)) = (self.bodies.get_mut(index), self.places.get(index)) else {
                continue;
            };
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
            let (found, now) = (object.pose, place.mesh(body));
            // The mesh's origin is as good a point as any.
            let center = found.transform_point(place.center);
            let shift = center.distance(body.pose().translation);
            object.moved = place.motion((shift, found.rotation_vector_to(&now).length()));
            object.pose = now;
            object.pushed = Some(index as u8);
        }
    }

    /// Whether it moves an object.
    pub fn moves(&self, id: SceneId) -> bool {
        self.places.iter().any(|place| place.id == id)
    }

    /// Forgets all objects.
    pub fn clear(&mut self) {
        self.bodies.clear();
        self.places.clear();
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

    /// Begins a step of `dt` (s): the geometry's objects move as contacts see them.
    pub fn begin(&mut self, geometry: &mut ContactGeometry, dt: f64) {
        for object in &mut geometry.objects {
            let Some(body) = object.pushed.and_then(|index| self.bodies.get_mut(usize::from(index))) else {
                continue;
            };
            body.begin(dt);
            let Twist { linear, angular } = *body.surface_twist();
            let linear = linear - angular.cross(body.pose().translation);
            object.motion.twist = Twist { linear, angular };
        }
    }

    /// The objects, by the indices that contacts have.
    pub fn bodies(&self) -> &[PushedBody] {
        &self.bodies
    }

    /// Ends a step of `dt` (s) at a time (s), with contacts whose arms are from a centre of mass (m): pushes
    /// the objects, and moves them. Their impulses are added to a feed. Returns the number of objects for
    /// which it had no room.
    pub fn end(
        &mut self,
        geometry: &mut ContactGeometry,
        (contacts, center): (&[UnilateralContact], DVec3),
        (dt, time): (f64, f64),
        reacting: &mut ReactionFeed,
    ) -> u64 {
        let mut lost = 0;
        for contact in contacts.iter().filter(|contact| contact.impulse != DVec3::ZERO) {
            let Some(index) = contact.pushed else { continue };
            let point = center + contact.arm;
            if let Some(body) = self.bodies.get_mut(usize::from(index)) {
                body.push(contact.impulse, point);
            }
            let object = geometry.objects.iter().find(|object| object.pushed == Some(index));
            if let Some(number) = object.and_then(|object| object.motion.object) {
                lost += reacting.push(number, contact.impulse, point.cross(contact.impulse));
            }
        }
        for object in &mut geometry.objects {
            let Some(index) = object.pushed.map(usize::from) else { continue };
            let (Some(body), Some(place)) = (self.bodies.get_mut(index), self.places.get(index)) else {
                continue;
            };
            object.moved = place.motion(body.end(dt, time));
            object.pose = place.mesh(body);
        }
        lost
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
