//! Tools that a device can hold: one [rigid](Rigid) body, or two bodies with a [hinge](Hinged). A tool
//! implements its motion and its coupling to the hand; the loops, drivers, editors and recordings are the
//! same for all tools.

pub(crate) mod error;
#[cfg(feature = "scene-files")]
pub(crate) mod file;
pub(crate) mod gains;
pub(crate) mod hinged;
pub(crate) mod rigid;

#[cfg(feature = "scene-files")]
pub use self::file::{HingeFrame, ToolFile, ToolPart};
pub use self::hinged::{Hinged, HingedTool, ToolBody};
pub use self::rigid::Rigid;
pub use crate::telemetry::hinged_record::HingedRecord;
use std::fmt::Debug;

use palpate_core::glam::DVec3;
use palpate_core::{Pose, Wrench};
use palpate_dynamics::{
    BodyState, Constraint, DeviceMotion, GripperMotion, LinearContactModel, MotionBound, PushedBody,
    StepStatus, VirtualCoupling,
};

use crate::telemetry::record::{Recorded, StepData};

/// A kind of tool: [`Rigid`] or [`Hinged`].
pub trait Tool: Moves {
    /// Row of a recording.
    type Record: Recorded;
    /// One value for each body: `X` for one body, `[X; 2]` for two.
    type PerBody<X>;

    /// Makes the record of a step.
    #[doc(hidden)]
    fn record(&self, data: &StepData, step: &ToolStep) -> Self::Record;

    /// Collects one value for each body, in order; `None` if there are too few.
    #[doc(hidden)]
    fn per_body<X>(values: impl Iterator<Item = X>) -> Option<Self::PerBody<X>>;
}

#[doc(hidden)]
/// Motion of a tool. A step allocates nothing and never panics.
pub trait Moves: Clone + Debug + Send + 'static {
    /// State of a body; the pose is that of its centre of mass, in its mesh's axes.
    fn body_state(&self, body: usize) -> BodyState;

    /// Centre of mass of a body in its mesh's frame, m.
    fn center_of_mass(&self, body: usize) -> DVec3;

    /// Coupling that holds the first body.
    fn coupling(&self) -> &VirtualCoupling;

    /// Changes the coupling that holds the first body.
    fn set_coupling(&mut self, coupling: VirtualCoupling);

    /// Name of the method that integrates the tool's motion.
    fn integrator(&self) -> &'static str;

    /// Potential energy of the couplings plus kinetic energy of the tool, J.
    fn energy(&self, hand: &Hand) -> f64;

    /// Advances the tool by `dt` (s), with the contacts of each body and the scene objects that they push.
    fn step(&mut self, hand: &Hand, loads: &mut [BodyLoads<'_>], pushed: &[PushedBody], dt: f64) -> ToolStep;

    /// Pushes the tool with an impulse (N·s), and an angular one about its centre of mass (N·m·s). Only tools
    /// of one body can be pushed.
    fn push(&mut self, _linear: DVec3, _angular: DVec3) {}

    /// Places the tool, at rest, where its couplings are relaxed; `false` if that place is not finite.
    fn reseat(&mut self, hand: &Hand) -> bool;

    /// Pose of a body's mesh frame.
    fn object_pose(&self, body: usize) -> Pose {
        self.body_state(body).pose * Pose::from_translation(-self.center_of_mass(body))
    }
}

/// Motion of the hand that holds a tool during a step, in the world.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct Hand {
    /// Motion of the device, at the grasp.
    pub device: DeviceMotion,
    /// Motion of the gripper; at rest at angle 0 if there is no gripper.
    pub gripper: GripperMotion,
}

/// Penalty contacts of a body without any.
static NO_CONTACTS: LinearContactModel = LinearContactModel::empty(&Pose::IDENTITY, f64::NAN);

/// Contacts of a body in a step.
#[doc(hidden)]
#[derive(Debug)]
pub struct BodyLoads<'a> {
    /// Penalty contacts.
    pub model: &'a LinearContactModel,
    /// Whether contacts are constraints.
    pub constrained: bool,
    /// Contacts as constraints.
    pub constraints: &'a mut [Constraint],
    /// Bound on the body's motion.
    pub bound: MotionBound,
}

/// Result of a tool's step.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct ToolStep {
    /// Status of the step.
    pub status: StepStatus,
    /// Whether the step was shortened by the bound on motion.
    pub waited: bool,
    /// Wrench of the coupling on the device, about the grasp.
    pub coupling: Wrench,
    /// Torque on the gripper about the hinge's axis, N·m; a positive one opens the gripper.
    pub gripper: f64,
    /// Torque of the hinge's stops on the second body, N·m; a positive one opens the hinge.
    pub stop: f64,
    /// Wrench of the contacts on each body, about its centre of mass.
    pub contacts: [Wrench; 2],
}
