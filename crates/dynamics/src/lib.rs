//! Dynamics of the grasped body: implicit integration, virtual coupling and penalty contact (Otaduy 2004,
//! chapter 5).
//!
//! One haptic frame is one call of [`semi_implicit_step`]: it takes the body ([`Body`], [`BodyState`]), the
//! sampled device ([`DeviceMotion`]), the spring between them ([`VirtualCoupling`]) and the latest contacts
//! ([`LinearContactModel`]), and returns the body's next state and the wrench for the device. The step
//! allocates nothing, takes no lock, never panics and never returns NaN: if it cannot be computed, the state
//! is held and [`StepStatus`] has the reason. Other methods implement [`Integrator`]; the feature
//! `integrators` has some for comparison. A tool of two bodies with a hinge between them is advanced by
//! [`articulated_step`].
//!
//! # Conventions
//!
//! Positions are those of the body's centre of mass; body axes are the mesh's axes moved to it. All wrenches
//! on the body are about the centre of mass, in world axes. Orientation increments are right-handed rotation
//! vectors φ in world axes, R ← exp(φ*) R, so a state has six coordinates to differentiate by, (x, φ), and
//! six velocities, (v, ω); the dissertation uses a quaternion and momenta, thirteen in all. The test
//! `thirteen_variables` holds this crate's step against that formulation.
//!
//! ```
//! use palpate_core::{Contact, Pose, glam::{DMat3, DVec3}};
//! use palpate_dynamics::{
//!     Body, BodyState, ContactParameters, DeviceMotion, Friction, LinearContactModel, VirtualCoupling,
//!     semi_implicit_step,
//! };
//!
//! // A 10 g ball of 1 cm radius held over a floor whose surface is z = 0; the hand pushes 5 mm below it.
//! let body = Body::new(0.010, DMat3::from_diagonal(DVec3::splat(4e-7)))?;
//! let coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 200.0, 0.6);
//! let touch = Contact {
//!     point: DVec3::new(0.0, 0.0, 0.0),
//!     scene_point: DVec3::ZERO,
//!     normal: DVec3::NEG_Z, // out of the ball
//!     depth: 0.0,
//! };
//! let mut state = BodyState::at_rest(Pose::from_translation(DVec3::new(0.0, 0.0, 0.01)));
//! let parameters = ContactParameters { stiffness: 1000.0, damping: 1.0, tolerance: 0.0, friction: Friction::NONE };
//! let contacts = LinearContactModel::from_contacts([touch], &state.pose, &parameters, 0.0);
//! let device = DeviceMotion::at_rest(Pose::from_translation(DVec3::new(0.0, 0.0, 0.005)));
//! let mut felt = DVec3::ZERO;
//! for _ in 0..200 {
//!     let step = semi_implicit_step(&body, &state, &device, &coupling, &contacts, DVec3::ZERO, 1e-3);
//!     assert!(step.status.is_ok());
//!     state = step.state;
//!     felt = step.coupling.force;
//! }
//! // Two springs in series carry 200 · 1000 / 1200 N/m × 5 mm, and the hand is pushed up.
//! assert!((felt - DVec3::Z * 5.0 / 6.0).length() < 1e-6);
//! # Ok::<(), palpate_dynamics::BodyError>(())
//! ```

mod algebra;
mod articulated;
mod body;
mod constrained_motion;
mod constraint;
mod coupling;
#[cfg(test)]
mod differences;
mod integrators;
mod jacobian;
mod mapping;
mod passivity;
mod penalty;
mod port;
mod saturation;
mod step;
mod system;

pub use articulated::{
    ArticulatedBody, ArticulatedFrame, ArticulatedState, ArticulatedStep, ConstrainedToolStep,
    GripperCoupling, GripperMotion, Joint, JointError, JointLimits, MAX_ARTICULATED_SOLVES, articulated_step,
    constrained_articulated_step,
};
pub use body::{Body, BodyError, BodyState};
pub use constrained_motion::{MotionLimit, constrained_motion};
pub use constraint::{
    ConstrainedStep, Constraint, HostState, MAX_CONSTRAINTS, MotionBound, PushedBody, Recovery,
    constrained_step,
};
pub use coupling::{CouplingResponse, DeviceMotion, VirtualCoupling};
#[cfg(feature = "integrators")]
pub use integrators::{
    ForwardEuler, FullyImplicit, IntegratorKind, QuasiStatic, RungeKutta4, SymplecticEuler, UnknownIntegrator,
};
pub use integrators::{Integrator, SemiImplicit};
pub use jacobian::{Block6, WrenchJacobian};
pub use mapping::DeviceMapping;
pub use passivity::{PassivityController, PassivityObserver};
pub use penalty::{
    ContactBlend, ContactClass, ContactParameters, ContactPatch, ContactResponse, CurvedContact,
    FoundContact, Friction, FrictionAnchor, LinearContactModel, MAX_APPROACHING, MAX_CLUSTERS,
    MAX_PENALTY_CONTACTS, MovingBody, PenaltyContact, SurfaceMotion,
};
pub use port::{LONGEST_LAG, PortAxes, PortLimits, Sampling};
pub use saturation::{SlewLimit, angular_spring_torque, saturate, spring_force};
pub use step::{Frame, MAX_SOLVES, Step, StepFailure, StepStatus, semi_implicit_step};
