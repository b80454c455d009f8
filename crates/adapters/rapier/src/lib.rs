//! Rigid bodies of a [rapier] world, touched with [`palpate`]: the object in the hand pushes and levers them,
//! and the hand feels their weight, their inertia and what they lean on.
//!
//! The object in the hand belongs to palpate: it is simulated in the haptic loop, coupled to the device, and
//! is not in the rapier world. The bodies that it touches belong to rapier: dynamic bodies are pushed,
//! kinematic and fixed ones only felt. [`TouchedBodies`] transfers motion in one direction and impulses in
//! the other, around each step of the world, and owns neither:
//!
//! ```text
//! touched.before_step(&mut reactions, &mut bodies);   // contact impulses to the bodies
//! world.step();
//! touched.after_step(&mut scene, &bodies)?;           // poses and velocities to the contact loop
//! ```
//!
//! Any kind of session will do: one that [runs in threads of its own](palpate::HapticRenderer::spawn), one
//! whose haptic step [the host makes](palpate::HostedSession), or one whose [two
//! loops](palpate::HapticRenderer::into_loops) it runs. Momentum is conserved: a body gains exactly the
//! impulse of the haptic steps' contact wrenches, up to the rounding of rapier's `f32`, however late it is
//! applied.
//!
//! # Contact stiffness
//!
//! The haptic loop moves a body itself until the world answers, so that contacts are hard even where the
//! world is stepped at the rate of a display. What a body leans on is felt as rapier has it: its contacts are
//! soft, the softer the lighter the bodies are, and where it is stepped at 60 Hz light bodies are restless
//! there.
//!
//! Contacts with bodies lighter than half the object in the hand, and penalty contacts
//! ([`Response`](palpate::settings::Response)), are as stiff as is stable with a body of that mass in a world
//! that answers a step late ([`DynamicBody`](palpate::DynamicBody)): a world that is stepped at 500 Hz to
//! 1 kHz makes them feel crisp, one at 60 Hz soft. Under its own weight, such a body on a held object sinks
//! in by g (T / 0.25)² to three times as much, whatever its mass, with T two steps of the world and one
//! interval between contact steps: 2.5 mm to 7.4 mm at 1 kHz and 500 Hz. It may sink in deeper than a tool is
//! thick: the tool's proxy keeps it on its side.
//!
//! Set rapier's `IntegrationParameters::length_unit` to about the size of the bodies: by default rapier lets
//! bodies overlap by 5 mm, and puts those to sleep that move slower than 5 cm/s.
//!
//! # Example
//!
//! ```
//! use palpate::device::{DeviceState, Specification, Status};
//! use palpate::glam::DVec3;
//! use palpate::{HostedSession, Object, Pose, Scene, Settings, Twist};
//! use palpate_rapier::{TouchedBodies, solid_collider};
//! use rapier3d::prelude::*;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! const STEP: f64 = 1e-3;
//! let ball = Object::model("golf-ball@2000")?;
//! let mut world = PhysicsWorld { gravity: Vector::ZERO, ..PhysicsWorld::default() };
//! world.integration_parameters.dt = STEP as f32;
//! world.integration_parameters.length_unit = 0.05;
//! // The ball's mesh with a mass of 46 g, at its coarsest level: one convex hull.
//! let coarsest = ball.clod.levels.len() - 1;
//! let below = RigidBodyBuilder::dynamic().translation(Vector::new(0.0, 0.0, -0.06));
//! let (body, _) = world.insert(below, solid_collider(&ball, coarsest, 0.046)?);
//!
//! // A probe in a hand, and the ball in its scene.
//! let device = DeviceState { time: 0.0, pose: Pose::IDENTITY, twist: Twist::ZERO, buttons: 0, status: Status::OK };
//! let probe = Object::model("ellipsoid@500")?;
//! let specification = palpate::device::Emulation::default().specification;
//! let mut session = HostedSession::new(probe, Scene::new(), specification, device, Settings::default())?;
//! let mut touched = TouchedBodies::new(STEP, world.gravity);
//! touched.add(&mut session.scene, &world.bodies, body, &ball)?;
//!
//! for _ in 0..10 {
//!     let wrench = session.step(STEP, &device); // for the device
//!     touched.before_step(&mut session.reactions, &mut world.bodies);
//!     world.step();
//!     touched.after_step(&mut session.scene, &world.bodies)?;
//! }
//! # Ok(())
//! # }
//! ```
//!
//! [rapier]: https://rapier.rs

mod bodies;
mod colliders;
mod convert;
mod dynamic_body;

pub use bodies::{TouchError, TouchedBodies};
pub use colliders::{ColliderError, solid_collider, surface_collider};
/// Physics engine of the version that this crate is built for.
pub use rapier3d;
