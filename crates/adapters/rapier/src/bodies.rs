//! Bodies of a world that a session touches: motion in one direction, impulses in the other.

use palpate::errors::EditError;
use palpate::glam::DVec3;
use palpate::{DynamicBody, Object, Pose, Reaction, Reactions, SceneEditor, SceneId, Twist};
use rapier3d::dynamics::{RigidBody, RigidBodyHandle, RigidBodySet};
use rapier3d::math::Vector;

use crate::convert::{pose, to_vector, vector};
use crate::dynamic_body::dynamic_body;

/// Reason why a body cannot be touched, or an update did not reach the session.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TouchError {
    /// The world has no such body.
    #[error("the world has no body {0:?}")]
    NoBody(RigidBodyHandle),
    /// The body was added before.
    #[error("body {0:?} is touched already; to touch it as another object, remove it first")]
    Already(RigidBodyHandle),
    /// The body was not added, or has been removed.
    #[error("body {0:?} is not touched; add it first")]
    NotTouched(RigidBodyHandle),
    /// A dynamic body has no mass.
    #[error(
        "body {0:?} is dynamic and has no mass; give it a collider that has, or, if its mass is its own, step the world once"
    )]
    NoMass(RigidBodyHandle),
    /// The session refused a change.
    #[error("body {body:?}: {source}")]
    Edit {
        /// The body.
        body: RigidBodyHandle,
        /// Error of the session.
        source: EditError,
    },
}

/// Bodies of a rapier world as objects of a session's scene. The frame of an object's mesh is that of its
/// body.
///
/// Each session that touches a world has its own instance.
#[derive(Debug)]
pub struct TouchedBodies {
    /// Period of the world's steps, s, and its gravity, m/s².
    world: (f64, DVec3),
    bodies: Vec<Touched>,
    /// Index of the first body to update next: the session had room for those before it.
    next: usize,
}

/// Touched body, and its state as last sent to the session.
#[derive(Debug)]
struct Touched {
    body: RigidBodyHandle,
    object: SceneId,
    /// Bounding radius of its mesh, m.
    radius: f64,
    pose: Pose,
    twist: Twist,
    dynamic_body: Option<DynamicBody>,
}

impl TouchedBodies {
    /// Returns an empty set for a world with a gravity that is stepped every `period` (s):
    /// `IntegrationParameters::dt` if the world keeps pace with the clock.
    pub fn new(period: f64, gravity: Vector) -> Self {
        Self { world: (period, vector(gravity)), bodies: Vec::new(), next: 0 }
    }

    /// Adds a body as an object whose mesh has the body's frame. It is felt from the session's next contact
    /// step on, and pushed back if it is dynamic. Its shape in rapier does not matter here.
    ///
    /// # Errors
    /// If there is no such body, it was added before, it is dynamic without mass, or the session refuses it
    /// ([`EditError`]), for example for a period that is not above 0.
    pub fn add(
        &mut self,
        scene: &mut SceneEditor,
        bodies: &RigidBodySet,
        body: RigidBodyHandle,
        object: &Object,
    ) -> Result<SceneId, TouchError> {
        if self.scene_id(body).is_some() {
            return Err(TouchError::Already(body));
        }
        let found = bodies.get(body).ok_or(TouchError::NoBody(body))?;
        let radius = object.clod.source.center.length() + object.bounding_radius();
        if found.is_dynamic() && dynamic_body(found, radius, self.world).is_none() {
            return Err(TouchError::NoMass(body));
        }
        let refused = |source| TouchError::Edit { body, source };
        let pose = pose(found.position());
        let id = scene.add(object, pose).map_err(refused)?;
        let mut touched = Touched { body, object: id, radius, pose, twist: Twist::ZERO, dynamic_body: None };
        match touched.send_dynamics(scene, found, self.world) {
            // The update is repeated as soon as there is room.
            Ok(()) | Err(EditError::Full) => self.bodies.push(touched),
            Err(source) => {
                scene.remove(id).map_err(refused)?;
                return Err(refused(source));
            }
        }
        Ok(id)
    }

    /// Removes a body. Impulses on it so far are not lost if [`before_step`](Self::before_step) is called
    /// first.
    ///
    /// # Errors
    /// If it was not added, or too many changes wait.
    pub fn remove(&mut self, scene: &mut SceneEditor, body: RigidBodyHandle) -> Result<(), TouchError> {
        let place = self.bodies.iter().position(|touched| touched.body == body);
        let place = place.ok_or(TouchError::NotTouched(body))?;
        remove(scene, self.bodies[place].object).map_err(|source| TouchError::Edit { body, source })?;
        self.bodies.remove(place);
        Ok(())
    }

    /// Returns the body's id in the session's scene.
    pub fn scene_id(&self, body: RigidBodyHandle) -> Option<SceneId> {
        self.bodies.iter().find(|touched| touched.body == body).map(|touched| touched.object)
    }

    /// Returns the body of an object of the session's scene.
    pub fn body(&self, object: SceneId) -> Option<RigidBodyHandle> {
        self.bodies.iter().find(|touched| touched.object == object).map(|touched| touched.body)
    }

    /// Returns the number of bodies.
    pub fn len(&self) -> usize {
        self.bodies.len()
    }

    /// Returns whether there are no bodies.
    pub fn is_empty(&self) -> bool {
        self.bodies.is_empty()
    }

    /// Applies the contact impulses since the last call to the bodies, and wakes these: to be called before
    /// each step of the world. Reactions of objects that are not bodies are discarded; a host that has such
    /// objects takes the reactions itself, and passes the others to [`apply`](Self::apply).
    pub fn before_step(&self, reactions: &mut Reactions, bodies: &mut RigidBodySet) {
        while let Some(reaction) = reactions.take() {
            self.apply(&reaction, bodies);
        }
    }

    /// Applies the impulse of a reaction to its body, and wakes it; returns `false` if its object is not a
    /// dynamic body of this set.
    pub fn apply(&self, reaction: &Reaction, bodies: &mut RigidBodySet) -> bool {
        let body = self.body(reaction.object).and_then(|body| bodies.get_mut(body));
        let Some(body) = body.filter(|body| body.is_dynamic()) else { return false };
        let center = center_of_mass(body);
        body.apply_impulse(to_vector(reaction.linear), true);
        body.apply_torque_impulse(to_vector(reaction.angular_about(center)), true);
        true
    }

    /// Sends poses and velocities of the bodies to the session: to be called after each step of the world.
    /// Bodies that are unchanged and at rest, such as sleeping ones, are skipped. Bodies that the world no
    /// longer has are removed, and changes of a body's mass or type are sent.
    ///
    /// # Errors
    /// The first update that the session refused; the others are sent. If too many changes wait, the updates
    /// that were not sent come first in the next call. An object whose body has a pose or velocity that is
    /// not finite stays where it was.
    pub fn after_step(&mut self, scene: &mut SceneEditor, bodies: &RigidBodySet) -> Result<(), TouchError> {
        let mut result = Ok(());
        let mut gone = false;
        let count = self.bodies.len();
        let first = self.next.min(count.saturating_sub(1));
        self.next = 0;
        for turn in 0..count {
            let place = (first + turn) % count;
            let touched = &mut self.bodies[place];
            let sent = match bodies.get(touched.body) {
                Some(body) => touched.send(scene, body, self.world),
                None => remove(scene, touched.object).inspect(|()| {
                    gone = true;
                    touched.body = RigidBodyHandle::invalid();
                }),
            };
            if let Err(source) = sent {
                result = result.and(Err(TouchError::Edit { body: touched.body, source }));
                if source == EditError::Full {
                    self.next = place;
                    break;
                }
            }
        }
        if gone {
            let before = self.bodies[..self.next].iter().filter(|touched| touched.is_gone()).count();
            self.next -= before;
            self.bodies.retain(|touched| !touched.is_gone());
        }
        result
    }
}

/// Removes an object that may have been removed before by others.
fn remove(scene: &mut SceneEditor, object: SceneId) -> Result<(), EditError> {
    match scene.remove(object) {
        Err(EditError::Unknown(_)) => Ok(()),
        other => other,
    }
}

impl Touched {
    /// Returns whether its body is gone and the session has removed it.
    fn is_gone(&self) -> bool {
        self.body == RigidBodyHandle::invalid()
    }

    /// Sends what has changed.
    fn send(
        &mut self,
        scene: &mut SceneEditor,
        body: &RigidBody,
        world: (f64, DVec3),
    ) -> Result<(), EditError> {
        self.send_dynamics(scene, body, world)?;
        let pose = pose(body.position());
        let twist = twist(body, &pose);
        if (pose, twist) == (self.pose, self.twist) && twist == Twist::ZERO {
            return Ok(());
        }
        if body.is_fixed() {
            // A fixed body moves only by being placed elsewhere.
            scene.set_pose(self.object, pose)?;
        } else {
            scene.set_motion(self.object, pose, twist)?;
        }
        (self.pose, self.twist) = (pose, twist);
        Ok(())
    }

    /// Sends the response of the body to contacts, if it has changed.
    fn send_dynamics(
        &mut self,
        scene: &mut SceneEditor,
        body: &RigidBody,
        world: (f64, DVec3),
    ) -> Result<(), EditError> {
        let dynamic_body = if body.is_dynamic() { dynamic_body(body, self.radius, world) } else { None };
        if dynamic_body != self.dynamic_body {
            scene.set_dynamics(self.object, dynamic_body)?;
            self.dynamic_body = dynamic_body;
        }
        Ok(())
    }
}

/// Returns the centre of mass in the world, m. Rapier's own value is that of the last step, even if the pose
/// was set since.
fn center_of_mass(body: &RigidBody) -> palpate::glam::DVec3 {
    pose(body.position()).transform_point(vector(body.local_center_of_mass()))
}

/// Returns the velocity of the origin of a body's frame and its angular velocity. Rapier's linear velocity is
/// that of the centre of mass.
fn twist(body: &RigidBody, pose: &Pose) -> Twist {
    let angular = vector(body.angvel());
    let arm = pose.translation - center_of_mass(body);
    Twist { linear: vector(body.linvel()) + angular.cross(arm), angular }
}

#[cfg(test)]
mod tests {
    use rapier3d::prelude::*;

    use super::*;

    /// A body turns about a centre of mass that is not its origin: the origin moves by the computed velocity.
    #[test]
    fn the_velocity_sent_is_that_of_the_origin() {
        let mut world = PhysicsWorld { gravity: Vector::ZERO, ..PhysicsWorld::default() };
        world.integration_parameters.dt = 1e-3;
        let properties = MassProperties::new(Vector::new(0.1, -0.05, 0.02), 1.0, Vector::splat(1e-2));
        let builder = RigidBodyBuilder::dynamic()
            .translation(Vector::new(0.3, 0.2, -0.1))
            .rotation(Vector::new(0.4, 0.1, -0.8))
            .additional_mass_properties(properties)
            .linvel(Vector::new(0.05, 0.0, 0.02))
            .angvel(Vector::new(1.0, 2.0, -1.5))
            .can_sleep(false);
        let handle = world.insert_body(builder);
        world.step();
        let of = |world: &PhysicsWorld| {
            let body = &world.bodies[handle];
            let pose = pose(body.position());
            (pose, twist(body, &pose))
        };
        for _ in 0..100 {
            let (before, then) = of(&world);
            world.step();
            let (after, now) = of(&world);
            let went = (after.translation - before.translation) / 1e-3;
            let mean = (then.linear + now.linear) * 0.5;
            // Positions in f32 are 3e-8 m apart.
            assert!((went - mean).length() < 2e-4, "{went} and {mean} m/s");
            assert!(mean.length() > 0.1, "{mean} m/s");
        }
    }
}
