//! The haptic loop (§5.1.2): read the device, move the grasped object by an implicit step, send the coupling wrench.
//!
//! A step never allocates, locks, blocks or panics; what goes wrong is counted in [`HapticTelemetry::events`].

use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist, Wrench};
use palpate_device::{DeviceState, HapticDevice, Specification, Status};
use palpate_dynamics::{Body, BodyState, DeviceMotion, VirtualCoupling, saturate, semi_implicit_step};

use crate::contact_loop::ContactUpdate;
use crate::record::Record;
use crate::telemetry::HapticTelemetry;

/// The state of the haptic loop: the grasped object, its coupling to the device and the newest contact model.
#[derive(Clone, Debug)]
pub struct HapticLoop {
    pub(crate) body: Body,
    pub(crate) coupling: VirtualCoupling,
    /// The grasped object; the pose is that of its centre of mass.
    state: BodyState,
    /// Centre of mass in the mesh's frame, m.
    center_of_mass: DVec3,
    /// The grasp: the frame that the coupling holds, in the mesh's frame, which the device's frame stands for.
    grasp: Pose,
    limits: Limits,
    device: DeviceState,
    update: ContactUpdate,
    contact_timeout: f64,
    /// Share of the wrench that is sent: below 1 while contact models are overdue.
    presence: f64,
    telemetry: HapticTelemetry,
}

/// What the device can render.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Limits {
    force: f64,
    torque: f64,
}

/// What a [`HapticLoop`] is made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grasped {
    pub body: Body,
    pub coupling: VirtualCoupling,
    pub center_of_mass: DVec3,
    pub grasp: Pose,
    pub contact_timeout: f64,
}

impl HapticLoop {
    /// Starts with the object at rest in the device's hand: the mesh's frame coincides with the device's.
    pub(crate) fn new(grasped: Grasped, device: DeviceState, specification: &Specification) -> Self {
        let Grasped { body, coupling, center_of_mass, grasp, contact_timeout } = grasped;
        let pose = device.pose * Pose::from_translation(center_of_mass);
        Self {
            body,
            coupling,
            state: BodyState::at_rest(pose),
            center_of_mass,
            grasp,
            limits: Limits { force: specification.peak_force, torque: specification.peak_torque },
            device,
            update: ContactUpdate::none(),
            contact_timeout,
            presence: 1.0,
            telemetry: HapticTelemetry::default(),
        }
    }

    /// The grasped object; the pose is that of its centre of mass, in the mesh's axes.
    pub fn body_state(&self) -> &BodyState {
        &self.state
    }

    /// Pose of the grasped object's mesh frame.
    pub fn object_pose(&self) -> Pose {
        self.state.pose * Pose::from_translation(-self.center_of_mass)
    }

    /// What was measured so far.
    pub fn telemetry(&self) -> &HapticTelemetry {
        &self.telemetry
    }

    /// What was measured so far, to add to.
    pub(crate) fn telemetry_mut(&mut self) -> &mut HapticTelemetry {
        &mut self.telemetry
    }

    /// Takes a newer contact model into use.
    pub fn update_contacts(&mut self, update: &ContactUpdate) {
        self.update = *update;
        self.telemetry.depth_max = self.telemetry.depth_max.max(update.depth);
    }

    /// One step of `dt` seconds up to time `now` (s) on a device: reads it, steps and writes the wrench.
    pub fn step_device(&mut self, device: &mut dyn HapticDevice, now: f64, dt: f64) -> Record {
        match device.read(now) {
            Ok(state) => {
                let record = self.step(&state, now, dt);
                if device.write(&record.coupling).is_err() {
                    self.telemetry.events.device_refused += 1;
                }
                record
            }
            Err(_) => {
                self.telemetry.events.device_refused += 1;
                let held = DeviceState { twist: Twist::ZERO, ..self.device };
                let record = self.step(&held, now, dt);
                // The device does not answer; whether it takes this wrench makes no difference to the count above.
                let _ = device.write(&Wrench::ZERO);
                record
            }
        }
    }

    /// One step of `dt` seconds up to time `now` (s) for a host that reads and writes its device itself. The wrench to
    /// send is the record's [`coupling`](Record::coupling).
    pub fn step(&mut self, device: &DeviceState, now: f64, dt: f64) -> Record {
        self.telemetry.steps += 1;
        self.hold_or_take(device);
        let model_age = now - self.update.time;
        let held = self.device.pose * self.grasp;
        let arm = held.translation - self.device.pose.translation;
        let twist = Twist::new(self.device.twist.velocity_at(arm), self.device.twist.angular);
        let motion = DeviceMotion { pose: held, twist };

        let step = semi_implicit_step(
            &self.body,
            &self.state,
            &motion,
            &self.coupling,
            &self.update.model,
            DVec3::ZERO,
            dt,
        );
        if !step.status.is_ok() {
            self.telemetry.events.step_refused += 1;
        }
        self.state = step.state;

        let wanted = step.coupling.about(-arm) * self.presence(model_age, dt);
        let sent = saturate(&wanted, self.limits.force, self.limits.torque);
        if sent != wanted {
            self.telemetry.events.saturated += 1;
        }
        self.telemetry.coupling_force_max = self.telemetry.coupling_force_max.max(sent.force.length());
        self.telemetry.energy -= sent.power(&self.device.twist) * dt;
        self.telemetry.energy_min = self.telemetry.energy_min.min(self.telemetry.energy);

        Record {
            time: now,
            device: self.device.pose,
            object: self.object_pose(),
            coupling: sent,
            contact: step.contact,
            depth: self.update.depth,
            contacts: self.update.contacts,
            model_age,
        }
    }

    /// Takes the device's state, or holds the last good one where it is not finite.
    fn hold_or_take(&mut self, device: &DeviceState) {
        let events = &mut self.telemetry.events;
        if device.pose.is_valid() && device.twist.is_finite() {
            self.device = *device;
            events.device_ended += u64::from(device.status.contains(Status::ENDED));
        } else {
            self.device.twist = Twist::ZERO;
            events.device_refused += 1;
        }
    }

    /// The share of the wrench to send: all of it up to the timeout of the contact model, nothing at twice its age, and
    /// back to all of it over as long a time when models arrive again.
    fn presence(&mut self, age: f64, dt: f64) -> f64 {
        let overdue = if age.is_nan() { 0.0 } else { age / self.contact_timeout - 1.0 };
        let recovered = self.presence + dt / self.contact_timeout;
        self.presence = recovered.min(1.0 - overdue).clamp(0.0, 1.0);
        self.telemetry.events.faded += u64::from(self.presence < 1.0);
        self.presence
    }
}
