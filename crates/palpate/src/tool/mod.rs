//! What a device can hold: one [rigid](Rigid) body, or two with a [hinge](Hinged) between them. A tool knows how it moves and what it
//! is coupled to; the loops, drivers, editors and recordings are the same for each.

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
    BodyState, DeviceMotion, GripperMotion, LinearContactModel, StepStatus, VirtualCoupling,
};

use crate::telemetry::record::{Recorded, StepData};

/// A kind of tool: [`Rigid`] or [`Hinged`].
pub trait Tool: Moves {
    /// One row of a recording.
    type Record: Recorded;
    /// One value for each body: `X` for one body, `[X; 2]` for two.
    type PerBody<X>;

    /// The record of a step.
    #[doc(hidden)]
    fn record(&self, data: &StepData, step: &ToolStep) -> Self::Record;

    /// A value for each body, in order; `None` if there are too few.
    #[doc(hidden)]
    fn per_body<X>(values: impl Iterator<Item = X>) -> Option<Self::PerBody<X>>;
}

#[doc(hidden)]
/// How a tool moves. A step allocates nothing and never panics.
pub trait Moves: Clone + Debug + Send + 'static {
    /// State of a body; the pose is that of its centre of mass, in its mesh's axes.
    fn body_state(&self, body: usize) -> BodyState;

    /// Centre of mass of a body in its mesh's frame, m.
    fn center_of_mass(&self, body: usize) -> DVec3;

    /// The coupling that holds the first body.
    fn coupling(&self) -> &VirtualCoupling;

    /// Changes the coupling that holds the first body.
    fn set_coupling(&mut self, coupling: VirtualCoupling);

    /// Name of the method that integrates the tool's motion.
    fn integrator(&self) -> &'static str;

    /// Energy in the couplings and in the tool's motion, J.
    fn energy(&self, hand: &Hand) -> f64;

    /// Advances the tool by `dt` (s), with a contact model for each body.
    fn step<'a>(
        &mut self,
        hand: &Hand,
        contacts: impl Fn(usize) -> &'a LinearContactModel,
        dt: f64,
    ) -> ToolStep;

    /// Puts the tool, at rest, where its couplings are relaxed; `false` if there is no such place.
    fn reseat(&mut self, hand: &Hand) -> bool;

    /// Pose of a body's mesh frame.
    fn object_pose(&self, body: usize) -> Pose {
        self.body_state(body).pose * Pose::from_translation(-self.center_of_mass(body))
    }
}

/// What holds a tool during a step, in the world.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct Hand {
    /// The device, at the grasp.
    pub device: DeviceMotion,
    /// The gripper; at rest at 0 where there is none.
    pub gripper: GripperMotion,
}

/// How a step of a tool went.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct ToolStep {
    /// How the step went.
    pub status: StepStatus,
    /// The coupling's wrench on the device, about the grasp.
    pub coupling: Wrench,
    /// The torque on the gripper about the hinge's axis, N·m: positive where it opens it.
    pub gripper: f64,
    /// The torque of the hinge's stops on the second body, N·m: positive where it opens the hinge.
    pub stop: f64,
    /// The contacts' wrench on each body, about its centre of mass.
    pub contacts: [Wrench; 2],
}
