//! The haptic loop (§5.1.2): read the device, move the grasped object by a step of the integrator, send the coupling wrench.
//!
//! A step never allocates, locks, blocks or panics; what goes wrong is counted in [`HapticTelemetry::events`].

use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist, Wrench};
use palpate_device::{Axes, DeviceState, HapticDevice, Specification, Status};
use palpate_dynamics::{
    Body, BodyState, ContactBlend, DeviceMotion, Frame, Integrator, IntegratorKind, VirtualCoupling, saturate,
};

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
    /// The last good state of the device.
    device: DeviceState,
    update: ContactUpdate,
    contacts: ContactBlend,
    contact_timeout: f64,
    integrator: IntegratorKind,
    /// Time of the first step, s, from which the first contact model is waited for; NaN before it.
    started: f64,
    /// Share of the wrench that is sent: see [`Self::fade`].
    presence: f64,
    telemetry: HapticTelemetry,
}

/// The longest time over which one contact model goes over to the next, s.
const LONGEST_BLEND: f64 = 5e-3;

/// What the device can render.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Limits {
    /// N.
    force: f64,
    /// N·m.
    torque: f64,
    actuated: Axes,
}

impl Limits {
    /// The wrench as far as the device can render it, and whether its actuators are too weak for it.
    fn fit(&self, wanted: &Wrench) -> (Wrench, bool) {
        let force = DVec3::select(self.actuated.translation.into(), wanted.force, DVec3::ZERO);
        let torque = DVec3::select(self.actuated.rotation.into(), wanted.torque, DVec3::ZERO);
        let actuated = Wrench::new(force, torque);
        let sent = saturate(&actuated, self.force, self.torque);
        (sent, sent != actuated)
    }
}

/// What a [`HapticLoop`] is made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grasped {
    pub body: Body,
    pub coupling: VirtualCoupling,
    pub center_of_mass: DVec3,
    pub grasp: Pose,
    pub contact_timeout: f64,
    pub integrator: IntegratorKind,
}

impl HapticLoop {
    /// Starts with the object at rest in the device's hand: the mesh's frame coincides with the device's.
    pub(crate) fn new(grasped: Grasped, device: DeviceState, specification: &Specification) -> Self {
        let Grasped { body, coupling, center_of_mass, grasp, contact_timeout, integrator } = grasped;
        let pose = device.pose * Pose::from_translation(center_of_mass);
        Self {
            body,
            coupling,
            state: BodyState::at_rest(pose),
            center_of_mass,
            grasp,
            limits: Limits {
                force: specification.peak_force,
                torque: specification.peak_torque,
                actuated: specification.actuated,
            },
            device,
            update: ContactUpdate::none(),
            contacts: ContactBlend::new(),
            contact_timeout,
            integrator,
            started: f64::NAN,
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

    /// Takes a newer contact model into use: [gradually](ContactBlend), over as long as lies between the last two, but no
    /// longer than 5 ms.
    pub fn update_contacts(&mut self, update: &ContactUpdate) {
        let since = update.time - self.update.time;
        let duration = if since.is_nan() { 0.0 } else { since.min(LONGEST_BLEND) };
        self.contacts.arrive(&update.model, &self.state, duration);
        self.update = *update;
        self.telemetry.depth_max = self.telemetry.depth_max.max(update.depth);
    }

    /// One step of `dt` seconds up to time `now` (s) on a device: reads it, steps and writes the wrench. A device that
    /// does not answer is taken to stand still, and is sent no wrench.
    pub fn step_device(&mut self, device: &mut dyn HapticDevice, now: f64, dt: f64) -> Record {
        let state = device.read(now).ok();
        let record = self.advance(state.as_ref(), now, dt);
        if device.write(&record.coupling).is_err() && state.is_some() {
            self.telemetry.events.device_refused += 1;
        }
        record
    }

    /// One step of `dt` seconds up to time `now` (s) for a host that reads and writes its device itself. The wrench to
    /// send is the record's [`coupling`](Record::coupling).
    pub fn step(&mut self, device: &DeviceState, now: f64, dt: f64) -> Record {
        self.advance(Some(device), now, dt)
    }

    fn advance(&mut self, device: Option<&DeviceState>, now: f64, dt: f64) -> Record {
        self.telemetry.steps += 1;
        self.take_or_hold(device);
        if self.started.is_nan() {
            self.started = now;
        }
        let model_age = now - self.update.time;
        let held = self.device.pose * self.grasp;
        let arm = held.translation - self.device.pose.translation;
        let twist = Twist::new(self.device.twist.velocity_at(arm), self.device.twist.angular);
        let motion = DeviceMotion { pose: held, twist };

        self.contacts.advance(&self.state, dt);
        let frame = Frame {
            body: &self.body,
            device: &motion,
            coupling: &self.coupling,
            contacts: self.contacts.contacts(),
            gravity: DVec3::ZERO,
        };
        let step = self.integrator.step(&frame, &self.state, dt);
        self.telemetry.events.step_refused += u64::from(step.status.held.is_some());
        self.telemetry.events.contacts_unsettled += u64::from(step.status.active_set_unsettled);
        self.telemetry.events.step_unconverged += u64::from(step.status.unconverged);
        self.state = step.state;

        let waited = now - if self.update.time.is_nan() { self.started } else { self.update.time };
        let taken = step.status.held.is_none();
        // A step that is refused may be so because of its `dt`.
        let dt = if taken { dt } else { 0.0 };
        self.fade(taken && device.is_some(), waited, dt);
        let (sent, limited) = self.limits.fit(&(step.coupling.about(-arm) * self.presence));
        self.telemetry.events.saturated += u64::from(limited);
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

    /// Takes the device's state, or, where there is none or it is not finite, holds the last good one at rest.
    fn take_or_hold(&mut self, device: Option<&DeviceState>) {
        let events = &mut self.telemetry.events;
        match device {
            Some(state) if state.pose.is_valid() && state.twist.is_finite() => {
                self.device = *state;
                events.device_refused += u64::from(state.status.contains(Status::HELD));
                events.device_ended += u64::from(state.status.contains(Status::ENDED));
            }
            _ => {
                self.device.twist = Twist::ZERO;
                events.device_refused += 1;
            }
        }
    }

    /// Sets the share of the wrench to send: all of it while contact models are younger than the timeout, nothing from
    /// twice that age on, and nothing without a wrench to trust (`sound`). It comes back over the length of the timeout,
    /// so that no force appears at once.
    fn fade(&mut self, sound: bool, waited: f64, dt: f64) {
        let allowed = if sound { 2.0 - waited / self.contact_timeout } else { 0.0 };
        let recovered = self.presence + dt / self.contact_timeout;
        self.presence = recovered.min(allowed).clamp(0.0, 1.0);
        self.telemetry.events.faded += u64::from(self.presence < 1.0);
    }
}
