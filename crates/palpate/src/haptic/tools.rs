//! The public interface of the haptic loop for each kind of tool.

use palpate_core::Pose;
use palpate_device::DeviceState;
use palpate_dynamics::{ArticulatedBody, ArticulatedState, BodyState, GripperCoupling};

use super::HapticLoop;
use crate::contact_loop::{ContactUpdate, Pull};
use crate::telemetry::hinged_record::HingedRecord;
use crate::telemetry::record::Record;
use crate::tool::Moves as _;
use crate::tool::hinged::{Hinged, ToolBody};
use crate::tool::rigid::Rigid;

impl HapticLoop<Rigid> {
    /// State of the grasped object; the pose is that of its centre of mass, in the mesh's axes.
    pub fn body_state(&self) -> &BodyState {
        &self.tool.state
    }

    /// Pose of the grasped object's mesh frame.
    pub fn object_pose(&self) -> Pose {
        self.tool.object_pose(0)
    }

    /// How the hand pulls the object, for [`ContactLoop::step_pulled`](crate::ContactLoop::step_pulled).
    pub fn pull(&self) -> Pull {
        self.pull_of(0)
    }

    /// [Blends](palpate_dynamics::ContactBlend) into a newer contact model, over the time between the last
    /// two models, but no longer than [`MAX_DURATION`](palpate_dynamics::ContactBlend::MAX_DURATION).
    pub fn update_contacts(&mut self, update: &ContactUpdate) {
        self.take_model(0, update);
    }

    /// Takes one step of `dt` seconds up to time `now` (s), for a host that reads and writes its device
    /// itself. The wrench to send is the record's [`coupling`](Record::coupling).
    pub fn step(&mut self, device: &DeviceState, now: f64, dt: f64) -> Record {
        self.advance(Some(device), None, now, dt).0
    }
}

impl HapticLoop<Hinged> {
    /// The tool: bodies about their centres of mass, in their meshes' axes.
    pub fn body(&self) -> &ArticulatedBody {
        &self.tool.body
    }

    /// State of the tool; the pose is that of the first body's centre of mass.
    pub fn state(&self) -> &ArticulatedState {
        &self.tool.state
    }

    /// State of one of the bodies; the pose is that of its centre of mass, in its mesh's axes.
    pub fn body_state(&self, body: ToolBody) -> BodyState {
        self.tool.body_state(body as usize)
    }

    /// Poses of the two bodies' mesh frames.
    pub fn object_poses(&self) -> [Pose; 2] {
        ToolBody::ALL.map(|body| self.tool.object_pose(body as usize))
    }

    /// The coupling of gripper and hinge, in world units.
    pub fn grip(&self) -> &GripperCoupling {
        &self.tool.grip
    }

    /// How the hand pulls one body, for [`ContactLoop::step_pulled`](crate::ContactLoop::step_pulled).
    pub fn pull(&self, body: ToolBody) -> Pull {
        self.pull_of(body as usize)
    }

    /// Blends into a newer contact model of one body, as a loop of one body does.
    pub fn update_contacts(&mut self, body: ToolBody, update: &ContactUpdate) {
        self.take_model(body as usize, update);
    }

    /// Takes one step of `dt` seconds up to time `now` (s), for a device and a gripper (rad) that the host
    /// has read. The wrench and the torque to send are the record's [`coupling`](HingedRecord::coupling) and
    /// [`torque`](HingedRecord::torque).
    pub fn step(&mut self, device: &DeviceState, gripper_angle: f64, now: f64, dt: f64) -> HingedRecord {
        self.advance(Some(device), Some(gripper_angle), now, dt).0
    }
}
