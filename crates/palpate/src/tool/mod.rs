//! A tool of two bodies with a hinge in the hand, as forceps or scissors, on a device of six degrees of freedom with a gripper
//! (§6.2.3).
//!
//! The first body is held by the device as any grasped object is; the gripper opens and closes the hinge, and is sent a torque. Each
//! body has contacts of its own with the scene, found by a [`ContactLoop`](crate::ContactLoop) of its own and gone over to by a
//! [`ContactBlend`](palpate_dynamics::ContactBlend) of its own; one [`articulated_step`](palpate_dynamics::articulated_step) moves
//! both. The two bodies do not collide with each other: where the blades meet is the hinge's lower limit. What is between them is
//! felt as both touch it, and pushed by both if it has a [`Mobility`](crate::Mobility).
//!
//! Textures, friction, braking, proxies and levels of detail are those of the contact loops. A proxy follows one body, without
//! knowing of the hinge.

pub(crate) mod gains;
mod gripper;
mod haptic;
mod record;
mod session;
mod tool;

pub use gripper::GripperSettings;
pub use haptic::ArticulatedLoop;
pub use record::{ARTICULATED_COLUMNS, ArticulatedRecord};
pub use session::{ArticulatedLockstep, ArticulatedSession};
pub use tool::{ArticulatedError, ArticulatedRenderer, ArticulatedTool, ToolBody};
