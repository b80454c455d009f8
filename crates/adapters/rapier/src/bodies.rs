//! The bodies of a world that a session touches: motion one way, impulses the other.

use palpate::errors::EditError;
use palpate::{DynamicBody, Object, Pose, Reaction, Reactions, SceneEditor, SceneId, Twist};
use rapier3d::dynamics::{RigidBody, RigidBodyHandle, RigidBodySet};

use crate::convert::{pose, to_vector, vector};
use crate::mobility::mobility;

/// Why a body cannot be touched, or the session was not told of it.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TouchError {
    /// The world has no such body.
    #[error("the world has no body {0:?}")]
    NoBody(RigidBodyHandle),
    /// It was added before.
    #[error("body {0:?} is touched already; to touch it as another object, remove it first")]
    Already(RigidBodyHandle),
    /// It was not added, or removed since.
    #[error("body {0:?} is not touched; add it first")]
    NotTouched(RigidBodyHandle),
    /// A dynamic body has no mass.
    #[error(
        "body {0:?} is dynamic and has no mass; give it a collider that has, or, if its mass is its own, step the world once"
    )]
    NoMass(RigidBodyHandle),
    /// The session did not take a change.
    #[error("body {body:?}: {source}")]
    Edit {
        /// The body.
        body: RigidBodyHandle,
        /// Why.
        source: EditError,
    },
}

/// Bodies of a rapier world as objects of a session's scene. The frame of an object's mesh is that of its body.
///
/// Each session that touches a world has one of these.
#[derive(Debug)]
pub struct TouchedBodies {
    /// Between two steps of the world, s.
    period: f64,
    bodies: Vec<Touched>,
    /// Where telling goes on: those before could be told when the session took no more.
    next: usize,
}

/// A body that is touched, and what the session was last told of it.
#[derive(Debug)]
struct Touched {
    body: RigidBodyHandle,
    object: SceneId,
    /// Bounding radius of its mesh, m.
    radius: f64,
    pose: Pose,
    twist: Twist,
    mobility: Option<DynamicBody>,
}

impl TouchedBodies {
    /// None yet, of a world that is stepped every `period` (s): `IntegrationParameters::dt`, where the world keeps pace with the
    /// clock.
    pub fn new(period: f64) -> Self {
        Self { period, bodies: Vec::new(), next: 0 }
    }

    /// Lets a body be touched, as an object whose mesh has the body's frame: felt from the session's next contact step on, and pushed back if
    /// it is dynamic. Which shape rapier has for it does not matter here.
    ///
    /// # Errors
    /// If there is no such body, it is touched already, it is dynamic without mass, or the session does not take it
    /// ([`EditError`]); among these a period that is not above 0.
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
        if found.is_dynamic() && mobility(found, radius, self.period).is_none() {
            return Err(TouchError::NoMass(body));
        }
        let refused = |source| TouchError::Edit { body, source };
        let pose = pose(found.position());
        let id = scene.add(object, pose).map_err(refused)?;
        let mut touched = Touched { body, object: id, radius, pose, twist: Twist::ZERO, mobility: None };
        match touched.tell_mobility(scene, found, self.period) {
            // That is told as soon as there is room.
            Ok(()) | Err(EditError::Full) => self.bodies.push(touched),
            Err(source) => {
                scene.remove(id).map_err(refused)?;
                return Err(refused(source));
            }
        }
        Ok(id)
    }

    /// Lets a body be touched no more. What contacts have pushed it with by then is not lost if [`before_step`](Self::before_step) is
    /// called first.
    ///
    /// # Errors
    /// If it is not touched, or too many changes wait.
    pub fn remove(&mut self, scene: &mut SceneEditor, body: RigidBodyHandle) -> Result<(), TouchError> {
        let place = self.bodies.iter().position(|touched| touched.body == body);
        let place = place.ok_or(TouchError::NotTouched(body))?;
        remove(scene, self.bodies[place].object).map_err(|source| TouchError::Edit { body, source })?;
        self.bodies.remove(place);
        Ok(())
    }

    /// The number that a body has in the session's scene.
    pub fn scene_id(&self, body: RigidBodyHandle) -> Option<SceneId> {
        self.bodies.iter().find(|touched| touched.body == body).map(|touched| touched.object)
    }

    /// The body that an object of the session's scene is.
    pub fn body(&self, object: SceneId) -> Option<RigidBodyHandle> {
        self.bodies.iter().find(|touched| touched.object == object).map(|touched| touched.body)
    }

    /// How many bodies are touched.
    pub fn len(&self) -> usize {
        self.bodies.len()
    }

    /// Whether none is.
    pub fn is_empty(&self) -> bool {
        self.bodies.is_empty()
    }

    /// Gives the bodies the impulses that contacts have pushed them with since the last time, and wakes those: to be called before
    /// each step of the world. Reactions of objects that are no bodies are passed over; a host that has such takes
    /// the reactions itself, and gives the others to [`apply`](Self::apply).
    pub fn before_step(&self, reactions: &mut Reactions, bodies: &mut RigidBodySet) {
        while let Some(reaction) = reactions.take() {
            self.apply(&reaction, bodies);
        }
    }

    /// Gives a body the impulse of a reaction, and wakes it; `false` if its object is no body that is touched and dynamic.
    pub fn apply(&self, reaction: &Reaction, bodies: &mut RigidBodySet) -> bool {
        let body = self.body(reaction.object).and_then(|body| bodies.get_mut(body));
        let Some(body) = body.filter(|body| body.is_dynamic()) else { return false };
        let center = center_of_mass(body);
        body.apply_impulse(to_vector(reaction.linear), true);
        body.apply_torque_impulse(to_vector(reaction.angular_about(center)), true);
        true
    }

    /// Tells the session where the bodies are and how fast they move: to be called after each step of the world. Nothing is told of
    /// bodies that are where they were and at rest, as those that sleep are. Bodies that the world has no more are removed, and a
    /// change of a body's mass or type is told.
    ///
    /// # Errors
    /// The first thing that the session did not take. Where too many changes wait, those that were not told come first
    /// the next time; where a body's pose or velocity is not finite, its object stays where it was. The others are told.
    pub fn after_step(&mut self, scene: &mut SceneEditor, bodies: &RigidBodySet) -> Result<(), TouchError> {
        let mut result = Ok(());
        let mut gone = false;
        let count = self.bodies.len();
        let first = self.next.min(count.saturating_sub(1));
        self.next = 0;
        for turn in 0..count {
            let place = (first + turn) % count;
            let touched = &mut self.bodies[place];
            let told = match bodies.get(touched.body) {
                Some(body) => touched.tell(scene, body, self.period),
                None => remove(scene, touched.object).inspect(|()| {
                    gone = true;
                    touched.body = RigidBodyHandle::invalid();
                }),
            };
            if let Err(source) = told {
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

/// Removes an object that somebody else may have removed before.
fn remove(scene: &mut SceneEditor, object: SceneId) -> Result<(), EditError> {
    match scene.remove(object) {
        Err(EditError::Unknown(_)) => Ok(()),
        other => other,
    }
}

impl Touched {
    /// Whether its body is no more, and the session knows.
    fn is_gone(&self) -> bool {
        self.body == RigidBodyHandle::invalid()
    }

    /// Tells what has changed.
    fn tell(&mut self, scene: &mut SceneEditor, body: &RigidBody, period: f64) -> Result<(), EditError> {
        self.tell_mobility(scene, body, period)?;
        let pose = pose(body.position());
        let twist = twist(body, &pose);
        if (pose, twist) == (self.pose, self.twist) && twist == Twist::ZERO {
            return Ok(());
        }
        if body.is_fixed() {
            // It moves by being put elsewhere alone.
            scene.set_pose(self.object, pose)?;
        } else {
            scene.set_motion(self.object, pose, twist)?;
        }
        (self.pose, self.twist) = (pose, twist);
        Ok(())
    }

    /// Tells how the body is moved by what touches it, where that has changed.
    fn tell_mobility(
        &mut self,
        scene: &mut SceneEditor,
        body: &RigidBody,
        period: f64,
    ) -> Result<(), EditError> {
        let mobility = if body.is_dynamic() { mobility(body, self.radius, period) } else { None };
        if mobility != self.mobility {
            scene.set_dynamics(self.object, mobility)?;
            self.mobility = mobility;
        }
        Ok(())
    }
}

/// Where the centre of mass is in the world, m; rapier's own is that of the last step, whatever the pose was set to since.
fn center_of_mass(body: &RigidBody) -> palpate::glam::DVec3 {
    pose(body.position()).transform_point(vector(body.local_center_of_mass()))
}

/// The velocity of the origin of a body's frame, which is at a pose, and its angular velocity; rapier's is that of the centre of mass.
fn twist(body: &RigidBody, pose: &Pose) -> Twist {
    let angular = vector(body.angvel());
    let arm = pose.translation - center_of_mass(body);
    Twist { linear: vector(body.linvel()) + angular.cross(arm), angular }
}

#[cfg(test)]
mod tests {
    use rapier3d::prelude::*;

    use super::*;

    /// A body that turns about a centre of mass that is not its origin: the origin goes where its velocity says.
    #[test]
    fn the_velocity_told_is_that_of_the_origin() {
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
            // Positions of f32 are 3e-8 m apart.
            assert!((went - mean).length() < 2e-4, "{went} and {mean} m/s");
            assert!(mean.length() > 0.1, "{mean} m/s");
        }
    }
}
