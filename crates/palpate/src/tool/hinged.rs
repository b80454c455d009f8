//! A tool of two bodies with a hinge, as forceps or scissors, on a device of six degrees of freedom with a gripper (§6.2.3).
//!
//! The device holds the first body as any grasped object; the gripper opens and closes the hinge, and is sent a torque. Each body has
//! contacts of its own with the scene, found by a [`ContactLoop`](crate::ContactLoop) of its own; one
//! [`articulated_step`](palpate_dynamics::articulated_step) moves both. The two bodies do not collide with each other: where the
//! blades meet is the hinge's lower limit. An object between them is felt as both touch it, and pushed by both if it has a
//! [`DynamicBody`](crate::DynamicBody).
//!
//! Textures, friction, braking, proxies and levels of detail are those of the contact loops. A proxy follows one body, without
//! regard to the hinge.

use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::{
    ArticulatedBody, ArticulatedFrame, ArticulatedState, Body, BodyState, GripperCoupling, Integrator as _,
    Joint, JointLimits, LinearContactModel, PortAxes, PortLimits, Sampling, SemiImplicit, VirtualCoupling,
    articulated_step,
};

use super::error::ToolError;
use super::gains::{Gains, Grasped};
use super::{Hand, Moves, Tool, ToolStep};
use crate::scene::object::Object;
use crate::settings::gripper::{GripperSettings, USUAL_STIFFNESS};
use crate::telemetry::hinged_record::HingedRecord;
use crate::telemetry::record::StepData;

/// Two objects joined by a hinge.
///
/// The hinge's frame is given in each mesh's frame; its z axis is the hinge's axis, and at angle 0 the two frames coincide. The
/// second body turns about z by the angle, right-handed, as the gripper's angle grows.
#[derive(Clone, Debug)]
pub struct HingedTool {
    /// The body that the device holds.
    pub first: Object,
    /// The body that turns against it.
    pub second: Object,
    /// The hinge's frame in the mesh frames of the first and of the second.
    pub hinge: [Pose; 2],
    /// Smallest and largest angle, rad: where the blades meet, and how wide they open.
    pub limits: [f64; 2],
    /// Masses, kg.
    pub masses: [f64; 2],
    /// Of the hinge's stops, N·m/rad.
    pub stop_stiffness: f64,
}

/// One of a tool's two bodies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToolBody {
    /// The one that the device holds.
    First,
    /// The one that turns against it.
    Second,
}

impl ToolBody {
    pub(crate) const ALL: [Self; 2] = [Self::First, Self::Second];
}

impl HingedTool {
    /// The two bodies about their centres of mass, and the hinge in their axes.
    pub(crate) fn body(&self) -> Result<ArticulatedBody, ToolError> {
        let body = |object: &Object, mass: f64| {
            Body::new(mass, object.clod.source.unit_inertia * mass)
                .map_err(|source| ToolError::Body { name: object.name.clone(), source })
        };
        let [first, second] = self.centers_of_mass().map(|center| Pose::from_translation(-center));
        let joint = Joint {
            in_first: first * self.hinge[0],
            in_second: second * self.hinge[1],
            limits: JointLimits { low: self.limits[0], high: self.limits[1], stiffness: self.stop_stiffness },
        };
        let (first, second) = (body(&self.first, self.masses[0])?, body(&self.second, self.masses[1])?);
        Ok(ArticulatedBody::new(first, second, joint)?)
    }

    /// Centres of mass in the meshes' frames, m.
    pub(crate) fn centers_of_mass(&self) -> [DVec3; 2] {
        [&self.first, &self.second].map(|object| object.clod.source.center_of_mass)
    }

    /// The hinge's angle (rad) nearest to that of a gripper.
    pub(crate) fn angle_for(&self, gripper: f64) -> f64 {
        let [low, high] = self.limits;
        gripper.max(low).min(high)
    }

    /// The whole tool, with its hinge at an angle (rad).
    pub(crate) fn grasped(&self, body: &ArticulatedBody, angle: f64) -> Grasped {
        let (whole, center) = body.composite(angle);
        let radii = [&self.first, &self.second].map(Object::bounding_radius);
        let radius = radii.into_iter().fold(f64::INFINITY, f64::min);
        Grasped { whole, center, first_center: self.centers_of_mass()[0], radius }
    }
}

/// The coupling of gripper and hinge that the settings ask for, the rest chosen for the gripper's port; and the lag of the gripper's
/// rate, s.
pub(crate) fn grip(
    body: &ArticulatedBody,
    gripper: &GripperSettings,
    port: &PortAxes,
    gains: &Gains,
    scale: f64,
) -> (GripperCoupling, f64) {
    let Gains { limits, .. } = gains;
    let port = PortLimits { rotation: *port, ..*limits }.in_world(scale).rotation;
    let chosen = GripperCoupling::auto(body, &port, USUAL_STIFFNESS, &limits.sampling);
    let stiffness = gripper.stiffness.unwrap_or(chosen.stiffness);
    let critical = GripperCoupling::critically_damped(body, stiffness);
    let damping = gripper.damping.unwrap_or(critical.damping);
    let grip = GripperCoupling { stiffness, damping, max_torque: chosen.max_torque };
    // The rate is the difference of angles.
    let sampling = Sampling { velocity_delay: 0.0, ..limits.sampling };
    (grip, port.velocity_lag(stiffness, damping, &sampling))
}

/// A tool of two bodies with a hinge, as [`HapticRenderer::hinged`](crate::HapticRenderer::hinged) holds it.
#[derive(Clone, Debug)]
pub struct Hinged {
    pub(crate) body: ArticulatedBody,
    pub(crate) coupling: VirtualCoupling,
    pub(crate) grip: GripperCoupling,
    pub(crate) state: ArticulatedState,
    /// Centres of mass in the meshes' frames, m.
    pub(crate) centers: [DVec3; 2],
}

impl Moves for Hinged {
    fn body_state(&self, body: usize) -> BodyState {
        if body == ToolBody::First as usize { self.state.first } else { self.body.second(&self.state) }
    }

    fn center_of_mass(&self, body: usize) -> DVec3 {
        self.centers[usize::from(body != ToolBody::First as usize)]
    }

    fn integrator(&self) -> &'static str {
        SemiImplicit.name()
    }

    fn coupling(&self) -> &VirtualCoupling {
        &self.coupling
    }

    fn set_coupling(&mut self, coupling: VirtualCoupling) {
        self.coupling = coupling;
    }

    fn energy(&self, hand: &Hand) -> f64 {
        let springs = self.coupling.potential_energy(&self.state.first, &hand.device)
            + self.grip.potential_energy(&self.state, &hand.gripper);
        springs + self.body.kinetic_energy(&self.state)
    }

    fn step<'a>(
        &mut self,
        hand: &Hand,
        contacts: impl Fn(usize) -> &'a LinearContactModel,
        dt: f64,
    ) -> ToolStep {
        let frame = ArticulatedFrame {
            tool: &self.body,
            device: &hand.device,
            coupling: &self.coupling,
            gripper: &hand.gripper,
            grip: &self.grip,
            contacts: [contacts(0), contacts(1)],
            gravity: DVec3::ZERO,
        };
        let step = articulated_step(&frame, &self.state, dt);
        self.state = step.state;
        ToolStep {
            status: step.status,
            coupling: step.coupling,
            gripper: step.gripper,
            stop: step.stop,
            contacts: step.contacts,
        }
    }

    fn reseat(&mut self, hand: &Hand) -> bool {
        let relaxed = self.coupling.relaxed_pose(&hand.device.pose);
        let JointLimits { low, high, .. } = self.body.joint.limits;
        let state = ArticulatedState::at_rest(relaxed, hand.gripper.angle.max(low).min(high));
        let valid = state.is_valid();
        if valid {
            self.state = state;
        }
        valid
    }
}

impl Tool for Hinged {
    type Record = HingedRecord;
    type PerBody<X> = [X; 2];

    fn record(&self, data: &StepData, step: &ToolStep) -> HingedRecord {
        let [first, second] = &data.models;
        // The first comparison is false where one is NaN.
        let older = if first.time < second.time || first.time.is_nan() { first } else { second };
        HingedRecord {
            time: data.time,
            device: data.device,
            handle: data.handle,
            gripper: data.gripper,
            objects: [self.object_pose(0), self.object_pose(1)],
            angle: self.state.angle,
            coupling: data.coupling,
            torque: data.torque,
            stop: step.stop,
            contact: step.contacts,
            depth: [first.depth, second.depth],
            contacts: [first.contacts, second.contacts],
            model_age: data.time - older.time,
        }
    }

    fn per_body<X>(mut values: impl Iterator<Item = X>) -> Option<[X; 2]> {
        Some([values.next()?, values.next()?])
    }
}
