//! Tools of two bodies with a hinge, such as forceps or scissors, on a 6-DoF device with a gripper (§6.2.3).
//!
//! The device holds the first body like any grasped object; the gripper opens and closes the hinge, and
//! receives a torque. Each body has its own [`ContactLoop`](crate::ContactLoop), which finds its contacts
//! with the scene; one [`articulated_step`](palpate_dynamics::articulated_step) moves both bodies. The bodies
//! do not collide with each other: the hinge's lower limit is the angle at which the blades meet. An object
//! between the blades touches both, and both push it if it has a [`DynamicBody`](crate::DynamicBody).
//!
//! Textures, friction, braking, proxies and levels of detail are those of the contact loops. A proxy follows
//! one body, and ignores the hinge.

use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::{
    ArticulatedBody, ArticulatedFrame, ArticulatedState, Body, BodyState, ConstrainedToolStep,
    GripperCoupling, Integrator as _, Joint, JointLimits, PortAxes, PortLimits, PushedBody, Recovery,
    Sampling, SemiImplicit, VirtualCoupling, articulated_step, constrained_articulated_step,
};

use super::error::ToolError;
use super::gains::{Gains, Grasped};
use super::{BodyLoads, Hand, Moves, NO_CONTACTS, Tool, ToolStep};
use crate::scene::object::Object;
use crate::settings::gripper::{DEFAULT_STIFFNESS, GripperSettings};
use crate::telemetry::hinged_record::HingedRecord;
use crate::telemetry::record::StepData;

/// Two objects joined by a hinge.
///
/// The hinge's frame is given in each mesh's frame; its z axis is the hinge's axis, and at angle 0 the two
/// frames coincide. As the gripper's angle grows, the second body rotates about z, right-handed.
#[derive(Clone, Debug)]
pub struct HingedTool {
    /// Body that the device holds.
    pub first: Object,
    /// Body that rotates relative to the first.
    pub second: Object,
    /// The hinge's frame in the mesh frames of the first and of the second body.
    pub hinge: [Pose; 2],
    /// Smallest and largest angle of the hinge, rad: blades closed, and fully open.
    pub limits: [f64; 2],
    /// Masses of the bodies, kg.
    pub masses: [f64; 2],
    /// Stiffness of the hinge's stops, N·m/rad.
    pub stop_stiffness: f64,
}

/// One of a tool's two bodies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToolBody {
    /// The body that the device holds.
    First,
    /// The body that rotates relative to the first.
    Second,
}

impl ToolBody {
    pub(crate) const ALL: [Self; 2] = [Self::First, Self::Second];
}

impl HingedTool {
    /// Two bodies about their centres of mass, with the hinge in their axes.
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

    /// Angle of the hinge (rad) nearest to a gripper's angle.
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

/// Coupling of gripper and hinge, with the gains that the settings give and the others chosen for the
/// gripper's port; and the lag of the gripper's angular rate, s.
pub(crate) fn grip(
    body: &ArticulatedBody,
    gripper: &GripperSettings,
    port: &PortAxes,
    gains: &Gains,
    scale: f64,
) -> (GripperCoupling, f64) {
    let Gains { limits, .. } = gains;
    let port = PortLimits { rotation: *port, ..*limits }.in_world(scale).rotation;
    let chosen = GripperCoupling::auto(body, &port, DEFAULT_STIFFNESS, &limits.sampling);
    let stiffness = gripper.stiffness.unwrap_or(chosen.stiffness);
    let critical = GripperCoupling::critically_damped(body, stiffness);
    let damping = gripper.damping.unwrap_or(critical.damping);
    let grip = GripperCoupling { stiffness, damping, max_torque: chosen.max_torque };
    // The rate is a finite difference of angles, so it has none of the delay of a device's own velocity.
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
    pub(crate) recovery: Recovery,
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

    fn step(&mut self, hand: &Hand, loads: &mut [BodyLoads<'_>], pushed: &[PushedBody], dt: f64) -> ToolStep {
        let contacts = |body: usize| loads.get(body).map_or(&NO_CONTACTS, |load| load.model);
        let frame = ArticulatedFrame {
            tool: &self.body,
            device: &hand.device,
            coupling: &self.coupling,
            gripper: &hand.gripper,
            grip: &self.grip,
            contacts: [contacts(0), contacts(1)],
            gravity: DVec3::ZERO,
        };
        let ConstrainedToolStep { step, held_back, recovery } = match loads {
            [first, second] if first.constrained || second.constrained => {
                let bounds = [first.bound, second.bound];
                let contacts = [&mut *first.constraints, &mut *second.constraints];
                constrained_articulated_step(
                    &frame,
                    &self.state,
                    contacts,
                    pushed,
                    &bounds,
                    &self.recovery,
                    dt,
                )
            }
            _ => articulated_step(&frame, &self.state, dt).into(),
        };
        (self.state, self.recovery.speed) = (step.state, recovery);
        ToolStep {
            status: step.status,
            waited: held_back,
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
        // A body without a query yet has time NaN, and counts as the older one.
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
