//! Simulation of a free rigid body that falls onto a static one, bounces, slides and comes to rest, with
//! contact levels of detail (§3.4.4, §3.5.4).
//!
//! The simulation is impulse-based, after Mirtich (*Impulse-based Dynamic Simulation of Rigid Body Systems*,
//! 1996): between collisions the body flies freely ([`fly`]), and all contact, including resting and sliding
//! contact, is a train of impulses ([`impact`]). Contact queries find collisions, and
//! [`CollisionEvents`](palpate_collide::CollisionEvents) finds their times, also if the resolution changes
//! within a step.
//!
//! ```
//! use palpate_clod_build::{BuildOptions, build, unwatched};
//! use palpate_collide::Shape;
//! use palpate_core::{Pose, glam::DVec3};
//! use palpate_models::Model;
//! use palpate_rigid_body::{BodyState, RigidBody, Settings, Simulation};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let shape = |model: Model, triangles| -> Result<Shape, Box<dyn std::error::Error>> {
//!     Ok(Shape::new(build(&model.generate(triangles)?, &BuildOptions::default(), &mut unwatched)?))
//! };
//! let (ball, plate) = (shape(Model::Ellipsoid, 200)?, shape(Model::Plate, 12)?);
//! let body = RigidBody::solid(&ball, 0.05)?;
//! // Contact begins at a thousandth of the radius.
//! let settings = Settings::new(1e-3 * ball.clod().bounding_radius());
//! let start = BodyState::at_rest(Pose::from_translation(0.1 * DVec3::Z));
//! let mut simulation = Simulation::new(body, &ball, &plate, Pose::IDENTITY, start, settings)?;
//! while simulation.still_for() < 0.1 && simulation.time() < 5.0 {
//!     let outcome = simulation.step(1e-3)?;
//!     assert!(simulation.impacts().iter().all(|impact| impact.energy_after <= impact.energy_before));
//!     assert_eq!(outcome.exhausted, 0);
//! }
//! # Ok(())
//! # }
//! ```
//!
//! World axes and SI units throughout. Guarantees: the same input gives the same output, bit by bit; a step
//! always advances time by its full duration; kinetic energy never rises at an impact; a step makes a bounded
//! number of queries, does not panic, and allocates only if there are more contacts, impacts or queries than
//! ever before.

mod body;
mod contacts;
mod flight;
pub mod impact;
mod outcome;
mod settings;
mod simulation;

pub use body::{BodyError, BodyState, RigidBody};
pub use flight::fly;
pub use outcome::{Impact, QuerySample, StepError, StepOutcome};
pub use settings::{Settings, SettingsError};
pub use simulation::Simulation;
