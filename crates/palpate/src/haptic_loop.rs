//! The haptic loop (§5.1.2): read the device, move the grasped object by a step of the integrator, send the coupling wrench.
//!
//! A step never allocates, locks, blocks or panics; what goes wrong is counted in [`HapticTelemetry::events`].

use std::sync::{Arc, OnceLock};

use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist, Wrench};
use palpate_device::{Axes, DeviceError, DeviceState, HapticDevice, Specification};
use palpate_dynamics::{
    Body, BodyState, ContactBlend, DeviceMapping, DeviceMotion, Frame, Integrator, IntegratorKind,
    PassivityController, SlewLimit, Step, VirtualCoupling, saturate,
};
use rtrb::Consumer;

use crate::contact_loop::ContactUpdate;
use crate::presence::Presence;
use crate::reactions::{Reacting, Reactions};
use crate::record::Record;
use crate::settings_editor::{HapticTuning, Ramp};
use crate::telemetry::HapticTelemetry;
use crate::tracking::{Reading, Tracking};
use crate::workspace::{Workspace, motion_at};

/// The state of the haptic loop: the grasped object, its coupling to the device and the newest contact model.
///
/// A clone tells nobody what it pushes, nor where its object is, and is tuned by nobody.
#[derive(Clone, Debug)]
pub struct HapticLoop {
    pub(crate) body: Body,
    pub(crate) coupling: VirtualCoupling,
    /// The grasped object; the pose is that of its centre of mass.
    state: BodyState,
    /// Centre of mass in the mesh's frame, m.
    center_of_mass: DVec3,
    /// The [grasp](crate::Settings::grasp), in the mesh's frame.
    grasp: Pose,
    limits: Limits,
    slew: SlewLimit,
    tracking: Tracking,
    workspace: Workspace,
    presence: Presence,
    passivity: PassivityController,
    /// The wrench that the device holds, as far as known.
    sent: Wrench,
    /// What the newest contact model was found with.
    found: Found,
    contacts: ContactBlend,
    integrator: IntegratorKind,
    told: Told,
    /// Where the coupling goes over to.
    tuning: Option<Ramp<VirtualCoupling>>,
    /// Time of the first step, s, from which the first contact model is waited for, and of the last one; NaN before.
    started: f64,
    now: f64,
    telemetry: HapticTelemetry,
}

/// What a [`ContactUpdate`] says beside its model.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found {
    pub time: f64,
    pub depth: f64,
    pub contacts: u32,
}

/// What the device can render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Limits {
    /// N.
    pub force: f64,
    /// N·m.
    pub torque: f64,
    pub actuated: Axes,
}

impl Limits {
    /// The wrench as far as the device can render it, and whether its actuators are too weak for it.
    pub fn fit(&self, wanted: &Wrench) -> (Wrench, bool) {
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
    pub mapping: DeviceMapping,
    pub clutch_button: Option<u32>,
    pub contact_timeout: f64,
    pub integrator: IntegratorKind,
    pub engagement: f64,
    /// Lags of velocity and angular velocity for the coupling's dampers, s; 0 for the device's own.
    pub velocity_lags: (f64, f64),
    pub slew: SlewLimit,
    /// Most damping of the passivity controller, N·s/m and N·m·s/rad at the device; 0 where it is off.
    pub max_damping: (f64, f64),
    /// Period of the loop, s.
    pub period: f64,
}

/// Who takes what contacts push the scene's objects with, who follows the grasped one, and who tunes the loop.
#[derive(Debug, Default)]
struct Told {
    tunings: Option<Consumer<HapticTuning>>,
    reacting: Reacting,
    followers: Vec<triple_buffer::Input<(Pose, Twist)>>,
    /// The device's first error. Only this loop sets it, so that it never waits.
    device_error: Arc<OnceLock<DeviceError>>,
}

impl Clone for Told {
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// Energy that contacts may store for each joule in the coupling and in the body's motion: as much again, for they are
/// at least as stiff.
pub(crate) const STORED_IN_CONTACTS: f64 = 1.0;

impl HapticLoop {
    /// Starts with the object at rest in the device's hand: the mesh's frame coincides with the device's.
    pub(crate) fn new(grasped: Grasped, device: DeviceState, specification: &Specification) -> Self {
        let steps = (specification.encoder_step, specification.angular_encoder_step);
        let pose = grasped.mapping.pose(&device.pose) * Pose::from_translation(grasped.center_of_mass);
        Self {
            body: grasped.body,
            coupling: grasped.coupling,
            state: BodyState::at_rest(pose),
            center_of_mass: grasped.center_of_mass,
            grasp: grasped.grasp,
            limits: Limits {
                force: specification.peak_force,
                torque: specification.peak_torque,
                actuated: specification.actuated,
            },
            slew: grasped.slew,
            tracking: Tracking::new(device, grasped.velocity_lags, grasped.period),
            workspace: Workspace::new(grasped.mapping, grasped.clutch_button),
            presence: Presence::new(grasped.contact_timeout, grasped.engagement),
            passivity: PassivityController::new(grasped.max_damping, steps),
            sent: Wrench::ZERO,
            found: Found { time: f64::NAN, depth: 0.0, contacts: 0 },
            contacts: ContactBlend::new(),
            integrator: grasped.integrator,
            told: Told::default(),
            tuning: None,
            started: f64::NAN,
            now: f64::NAN,
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

    /// The coupling that holds the object, in the world: as chosen for the device, or as the settings ask.
    pub fn coupling(&self) -> &VirtualCoupling {
        &self.coupling
    }

    /// The [grasp](crate::Settings::grasp) that the coupling holds the object at, in the mesh's frame.
    pub fn grasp(&self) -> &Pose {
        &self.grasp
    }

    /// Where the device's workspace is in the world now; each release of the clutch moves it.
    pub fn mapping(&self) -> &DeviceMapping {
        self.workspace.mapping()
    }

    /// Holds the clutch, from the next step on, or lets it go: while it is held, by this or by its button, the device
    /// moves without the object, which stays where the hand's image was.
    pub fn set_clutch(&mut self, held: bool) {
        self.workspace.ask_clutch(held);
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
    /// longer than [`ContactBlend::LONGEST`].
    pub fn update_contacts(&mut self, update: &ContactUpdate) {
        let &ContactUpdate { ref model, time, depth, contacts } = update;
        let since = time - self.found.time;
        let duration = if since.is_nan() { 0.0 } else { since.min(ContactBlend::LONGEST) };
        self.contacts.arrive(model, &self.state, self.now - time, duration);
        self.found = Found { time, depth, contacts };
        let telemetry = &mut self.telemetry;
        telemetry.depth_max = telemetry.depth_max.max(depth);
        telemetry.contacts_max = telemetry.contacts_max.max(contacts);
        telemetry.contacts_now = contacts;
    }

    /// One step of `dt` seconds up to time `now` (s) on a device: reads it, steps and writes the wrench. A device that
    /// does not answer is taken to stand still, and is sent no wrench.
    pub fn step_device(&mut self, device: &mut dyn HapticDevice, now: f64, dt: f64) -> Record {
        let state = device.read(now).map_err(|error| self.keep_device_error(error)).ok();
        let record = self.advance(state.as_ref(), now, dt);
        if let Err(error) = device.write(&record.coupling) {
            self.telemetry.events.device_refused += u64::from(state.is_some());
            self.keep_device_error(error);
            // What it holds is not known; when it takes wrenches again they come up from zero.
            self.presence.release();
            self.sent = Wrench::ZERO;
        }
        record
    }

    /// The first error that the device gave, if any.
    pub fn device_error(&self) -> Option<&DeviceError> {
        self.told.device_error.get()
    }

    /// The same, to be seen from elsewhere while the loop runs.
    pub(crate) fn shared_device_error(&self) -> Arc<OnceLock<DeviceError>> {
        Arc::clone(&self.told.device_error)
    }

    /// Keeps an error of the device if it is the first: it is moved, and put into words elsewhere.
    pub(crate) fn keep_device_error(&self, error: DeviceError) {
        let _ = self.told.device_error.set(error);
    }

    /// One step of `dt` seconds up to time `now` (s) for a host that reads and writes its device itself. The wrench to
    /// send is the record's [`coupling`](Record::coupling).
    pub fn step(&mut self, device: &DeviceState, now: f64, dt: f64) -> Record {
        self.advance(Some(device), now, dt)
    }

    fn advance(&mut self, device: Option<&DeviceState>, now: f64, dt: f64) -> Record {
        self.telemetry.steps += 1;
        let reading = self.tracking.take(device, dt, &mut self.telemetry.events);
        if self.started.is_nan() {
            self.started = now;
        }
        if self.found.contacts > 0 {
            self.telemetry.first_touch.get_or_insert(now);
        }
        // A step may come late.
        let elapsed = (now - std::mem::replace(&mut self.now, now)).max(dt);
        let handle = self.workspace.locate(&self.tracking.damped_state());
        let motion = motion_at(&handle, &self.grasp);
        let arm = motion.pose.translation - handle.pose.translation;
        self.observe(&motion);

        self.tune(dt);
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
        self.tell_others(step.status.held.is_none(), dt);

        self.pass(reading, &step, now, dt);
        let sound = step.status.held.is_none() && reading != Reading::Lost;
        let wanted = self.workspace.mapping().wrench(&step.coupling.about(-arm)) * self.presence.share();
        self.sent = match device {
            Some(_) if sound && self.presence.share() > 0.0 => {
                // Overdue, it has to be nothing in time.
                let elapsed = if self.presence.fading() { elapsed } else { dt };
                self.fit(&wanted, dt, elapsed)
            }
            // The device still holds the last wrench. It goes down as fast as it may, also for the time that a step is late.
            Some(_) => self.slew.approach(&self.sent, &self.passivity.rest(), elapsed),
            None => self.passivity.rest(),
        };
        self.passivity.hold(&self.sent);
        let record = Record {
            time: now,
            device: self.tracking.state().pose,
            handle: handle.pose,
            object: self.object_pose(),
            coupling: self.sent,
            contact: step.contact,
            depth: self.found.depth,
            contacts: self.found.contacts,
            model_age: now - self.found.time,
        };
        let telemetry = &mut self.telemetry;
        telemetry.coupling_force_max = telemetry.coupling_force_max.max(self.sent.force.length());
        telemetry.stretch_max = telemetry.stretch_max.max(record.stretch(self.grasp.translation));
        record
    }

    /// Goes over to what the loop is tuned to.
    fn tune(&mut self, dt: f64) {
        while let Some(tuning) = self.told.tunings.as_mut().and_then(|tunings| tunings.pop().ok()) {
            self.tuning = Some(Ramp::new(self.coupling, tuning.coupling));
            self.tracking.set_lags(tuning.velocity_lags);
            self.slew = tuning.slew;
            self.passivity.set_max_damping(tuning.max_damping);
        }
        if let Some(ramp) = &mut self.tuning {
            let (coupling, ended) = ramp.advance(dt);
            self.coupling = coupling;
            if ended {
                self.tuning = None;
            }
        }
    }

    pub(crate) fn set_tunings(&mut self, tunings: Consumer<HapticTuning>) {
        self.told.tunings = Some(tunings);
    }

    /// Lets others know where the object is, and what a step of `dt` (s) pushed the scene with, if it was taken.
    fn tell_others(&mut self, taken: bool, dt: f64) {
        let Told { reacting, .. } = &mut self.told;
        if taken {
            self.telemetry.events.reaction_dropped += reacting.add(self.contacts.contacts(), &self.state, dt);
        }
        reacting.pass_on();
        if !self.told.followers.is_empty() {
            let motion = self.motion();
            for follower in &mut self.told.followers {
                follower.write(motion);
            }
        }
    }

    /// Pose of the mesh's frame, and the velocity of its origin with the angular velocity, in the world.
    pub(crate) fn motion(&self) -> (Pose, Twist) {
        let pose = self.object_pose();
        let arm = pose.translation - self.state.pose.translation;
        let Twist { angular, .. } = self.state.twist;
        (pose, Twist { linear: self.state.twist.velocity_at(arm), angular })
    }

    /// Lets what contacts push the scene's objects with be taken elsewhere, from the next step on.
    pub(crate) fn reactions(&mut self) -> Reactions {
        self.told.reacting.open()
    }

    /// Lets the grasped object be followed from elsewhere.
    pub(crate) fn lead(&mut self) -> triple_buffer::Output<(Pose, Twist)> {
        let (input, output) = triple_buffer::triple_buffer(&self.motion());
        self.told.followers.push(input);
        output
    }

    /// Counts the energy that flowed over the last period.
    fn observe(&mut self, motion: &DeviceMotion) {
        let scale = self.workspace.mapping().scale;
        let stored = (1.0 + STORED_IN_CONTACTS)
            * (self.coupling.potential_energy(&self.state, motion) + self.body.kinetic_energy(&self.state));
        self.passivity.observe(self.tracking.displacement(), stored / (scale * scale));
        let telemetry = &mut self.telemetry;
        telemetry.energy = self.passivity.energy();
        telemetry.energy_min = telemetry.energy_min.min(telemetry.energy);
        telemetry.dissipated = self.passivity.dissipated();
    }

    /// Lets the wrench's share come up, fade or fall to nothing, and counts why.
    fn pass(&mut self, reading: Reading, step: &Step, now: f64, dt: f64) {
        let waited = now - if self.found.time.is_nan() { self.started } else { self.found.time };
        let taken = step.status.held.is_none();
        // A step that is refused may be so because of its `dt`.
        let dt = if taken { dt } else { 0.0 };
        if !taken || matches!(reading, Reading::Lost | Reading::Back) {
            self.presence.release();
        }
        self.presence.pass(
            waited,
            self.workspace.clutched(),
            if reading == Reading::Lost { 0.0 } else { dt },
        );
        let events = &mut self.telemetry.events;
        events.faded += u64::from(self.presence.fading());
        events.engaging += u64::from(self.presence.engaging());
        events.clutched += u64::from(self.workspace.clutched());
    }

    /// What is sent of a wrench: with the passivity controller's damping, within what the device renders, and no
    /// further from the last than it may change in `dt` (s), or shrink in the time that has `elapsed` (s).
    fn fit(&mut self, wanted: &Wrench, dt: f64, elapsed: f64) -> Wrench {
        let damping = self.passivity.damping(&self.tracking.damped_state().twist, dt);
        let (fitting, limited) = self.limits.fit(&(*wanted + damping));
        let sent = self.slew.approach_late(&self.sent, &fitting, dt, elapsed);
        let events = &mut self.telemetry.events;
        events.damped += u64::from(damping != Wrench::ZERO);
        events.saturated += u64::from(limited);
        events.slewed += u64::from(sent != fitting);
        sent
    }
}
