//! The haptic loop (§5.1.2): read the device, move the grasped object by a step of the integrator, send the coupling wrench.
//!
//! A step never allocates, locks, blocks or panics; what goes wrong is counted in [`HapticTelemetry::events`].

pub(crate) mod invariants;
pub(crate) mod output;
pub(crate) mod presence;
pub(crate) mod reactions;
pub(crate) mod tracking;
pub(crate) mod workspace;

use std::sync::{Arc, OnceLock};

use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist};
use palpate_device::{DeviceError, DeviceState, HapticDevice, Specification, Status};
use palpate_dynamics::{
    Body, BodyState, ContactBlend, DeviceMapping, DeviceMotion, Frame, HeldBecause, Integrator,
    IntegratorKind, SlewLimit, Step, VirtualCoupling,
};
use rtrb::Consumer;

use crate::contact::ContactUpdate;
use crate::haptic::invariants::Invariants;
use crate::haptic::output::{Moment, Output};
use crate::haptic::presence::Presence;
use crate::haptic::reactions::{Reacting, Reactions};
use crate::haptic::tracking::{Reading, Tracking};
use crate::haptic::workspace::{Workspace, motion_at};
use crate::scene::placement::HandlePlacement;
use crate::settings::live::{HapticTuning, Ramp};
use crate::telemetry::HapticTelemetry;
use crate::telemetry::record::Record;

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
    /// Where the device's handle is, in the mesh's frame, m.
    handle: DVec3,
    tracking: Tracking,
    workspace: Workspace,
    presence: Presence,
    output: Output,
    /// The longest time that a step integrates, s.
    longest_step: f64,
    /// How far the object may go, m, from where its contact model was found before that holds no more.
    roam: f64,
    /// Bounding radius about the centre of mass, m.
    radius: f64,
    /// Steps in a row that were refused.
    stuck: u32,
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
    /// Where the object was.
    pub pose: Pose,
    pub depth: f64,
    pub contacts: u32,
}

/// What a [`HapticLoop`] is made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grasped {
    pub body: Body,
    pub coupling: VirtualCoupling,
    pub center_of_mass: DVec3,
    /// Bounding radius about the centre of mass, m.
    pub radius: f64,
    pub grasp: Pose,
    pub placement: HandlePlacement,
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

/// The longest time that a step integrates: in periods, and no less than in s. What a host gives beyond is left out.
pub(crate) const LONGEST_STEP: (f64, f64) = (5.0, 0.02);

/// After a step that comes later than [`LONGEST_STEP`] in periods, the wrench comes up anew if the hand has gone further than this
/// meanwhile, m and rad: the object is left behind by as much.
const LATE_WAY: (f64, f64) = (2e-3, 0.05);

/// How far an object may go from where its contact model was found: in bounding radii, and no less than in m at the device.
const ROAM: (f64, f64) = (0.5, 0.01);

/// Steps in a row that may be refused before the object is put where the hand is.
const MOST_STUCK: u32 = 20;

/// The time since the step before, and what a step integrates of it, s: nothing of a `dt` that is no time, and of a long one what makes
/// up for some of it. By clocks that go on, no more has passed than they tell, whatever a host says.
pub(crate) fn times_of_step(since: f64, dt: f64, longest: f64) -> (f64, f64) {
    let integrated = if dt > 0.0 && dt.is_finite() { dt.min(longest) } else { 0.0 };
    (since.max(integrated), integrated)
}

impl HapticLoop {
    /// Starts with the object at rest in the device's hand.
    pub(crate) fn new(grasped: Grasped, device: DeviceState, specification: &Specification) -> Self {
        let Grasped { placement, center_of_mass, grasp, .. } = grasped;
        let pose = placement.mesh_pose(&device.pose) * Pose::from_translation(center_of_mass);
        let Grasped { slew, max_damping, engagement, period, radius, .. } = grasped;
        Self {
            body: grasped.body,
            coupling: grasped.coupling,
            state: BodyState::at_rest(pose),
            center_of_mass,
            grasp,
            handle: placement.handle(),
            tracking: Tracking::new(device, grasped.velocity_lags, period),
            workspace: Workspace::new(*placement.mapping(), grasped.clutch_button),
            presence: Presence::new(grasped.contact_timeout, engagement),
            output: Output::new(specification, slew, max_damping, engagement, period),
            longest_step: (LONGEST_STEP.0 * period).max(LONGEST_STEP.1),
            roam: (ROAM.0 * radius).max(ROAM.1 * placement.mapping().scale),
            radius,
            stuck: 0,
            found: Found { time: f64::NAN, pose, depth: 0.0, contacts: 0 },
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

    /// Where the device's workspace is in the world now, for its handle; each release of the clutch moves it.
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

    /// What was checked so far of the wrenches that were sent.
    pub fn invariants(&self) -> &Invariants {
        self.output.invariants()
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
        self.found = Found { time, pose: *model.pose(), depth, contacts };
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
            self.output.forget();
        }
        record
    }

    /// Lets the wrench fade out from now on, for good: the end is near.
    pub fn leave(&mut self) {
        self.presence.leave();
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
        if self.started.is_nan() {
            self.started = now;
        }
        if self.found.contacts > 0 {
            self.telemetry.first_touch.get_or_insert(now);
        }
        let (elapsed, dt) = times_of_step(now - std::mem::replace(&mut self.now, now), dt, self.longest_step);
        let reading = self.read(device, elapsed, dt);
        let handle = self.workspace.locate(&self.tracking.damped_state());
        let motion = motion_at(&handle, &(Pose::from_translation(-self.handle) * self.grasp));
        let arm = motion.pose.translation - handle.pose.translation;
        let stored = self.observe(&motion);
        let events = &mut self.telemetry.events;
        let harmful = self.output.is_harmful(&self.tracking, (stored, elapsed), events);

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
        self.take(&step, &motion);
        self.tell_others(step.status.held.is_none(), dt);

        let failed = step.status.held.is_some() || reading == Reading::Lost;
        let released = failed || harmful || reading == Reading::Back;
        if released {
            self.presence.release();
        }
        let overdue = self.pass(reading, &step, now, dt);
        let share = self.presence.share();
        let at = Moment { dt, elapsed, share, faulty: failed, overdue, released, stored };
        let wanted = self.workspace.mapping().wrench(&step.coupling.about(-arm));
        let sent = match device {
            // It holds nothing, or must not.
            None => self.output.drop(&self.tracking, &at),
            Some(_) if harmful => self.output.drop(&self.tracking, &at),
            Some(_) if !failed && share > 0.0 => {
                self.output.send(&wanted, &self.tracking, &at, &mut self.telemetry.events)
            }
            Some(_) => self.output.let_go(&self.tracking, &at),
        };
        let record = Record {
            time: now,
            device: self.tracking.state().pose,
            handle: handle.pose * Pose::from_translation(-self.handle),
            object: self.object_pose(),
            coupling: sent,
            contact: step.contact,
            depth: self.found.depth,
            contacts: self.found.contacts,
            model_age: now - self.found.time,
        };
        let telemetry = &mut self.telemetry;
        telemetry.coupling_force_max = telemetry.coupling_force_max.max(sent.force.length());
        telemetry.stretch_max = telemetry.stretch_max.max(record.stretch(self.grasp.translation));
        record
    }

    /// Takes a reading `elapsed` (s) after the one before, of which a step integrates `dt` (s).
    fn read(&mut self, device: Option<&DeviceState>, elapsed: f64, dt: f64) -> Reading {
        let before = self.tracking.state().pose;
        let reading = self.tracking.take(device, elapsed, &mut self.telemetry.events);
        if device.is_some_and(|state| state.status.contains(Status::WITHHELD)) {
            self.telemetry.events.withheld += 1;
            self.presence.release();
            self.output.forget();
        }
        // Nothing is to be dragged to where the hand was found.
        if reading == Reading::Back && self.output.limits().renders {
            let rebased = self.workspace.rebase(&before, &self.tracking.state().pose);
            self.telemetry.events.rebased += u64::from(rebased);
        }
        let Twist { linear, angular } = *self.tracking.displacement();
        let left_out = elapsed > 1.5 * dt;
        if left_out && (linear.length() > LATE_WAY.0 || angular.length() > LATE_WAY.1) {
            self.telemetry.events.late += 1;
            self.presence.release();
        }
        reading
    }

    /// Takes a step as far as it was one. An object that no step moves is put where the hand, as it moves, holds it.
    fn take(&mut self, step: &Step, motion: &DeviceMotion) {
        let events = &mut self.telemetry.events;
        events.step_refused += u64::from(step.status.held.is_some());
        events.contacts_unsettled += u64::from(step.status.active_set_unsettled);
        events.step_unconverged += u64::from(step.status.unconverged);
        self.state = step.state;
        // A host's `dt` is not what holds the object.
        let stuck = step.status.held.is_some_and(|why| why != HeldBecause::TimeStep);
        self.stuck = if stuck { self.stuck + 1 } else { 0 };
        let relaxed = self.coupling.relaxed_pose(&motion.pose);
        if self.stuck >= MOST_STUCK && relaxed.is_valid() {
            self.state = BodyState::at_rest(relaxed);
            self.stuck = 0;
            events.reseated += 1;
        }
    }

    /// Goes over to what the loop is tuned to.
    fn tune(&mut self, dt: f64) {
        while let Some(tuning) = self.told.tunings.as_mut().and_then(|tunings| tunings.pop().ok()) {
            self.tuning = Some(Ramp::new(self.coupling, tuning.coupling));
            self.tracking.set_lags(tuning.velocity_lags);
            self.output.set_slew(tuning.slew);
            self.output.passivity.set_max_damping(tuning.max_damping);
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

    /// Counts the energy that flowed over the last period. The most (J at the device) that may come back.
    fn observe(&mut self, motion: &DeviceMotion) -> f64 {
        let scale = self.workspace.mapping().scale;
        let stored = (1.0 + STORED_IN_CONTACTS)
            * (self.coupling.potential_energy(&self.state, motion) + self.body.kinetic_energy(&self.state))
            / (scale * scale);
        self.output.observe(&self.tracking, stored);
        let passivity = &self.output.passivity;
        let telemetry = &mut self.telemetry;
        telemetry.energy = passivity.energy();
        telemetry.energy_min = telemetry.energy_min.min(telemetry.energy);
        telemetry.dissipated = passivity.dissipated();
        stored
    }

    /// Lets the wrench's share come up, fade or fall to nothing, and counts why. How long contact models have been overdue, s.
    fn pass(&mut self, reading: Reading, step: &Step, now: f64, dt: f64) -> f64 {
        let waited = now - if self.found.time.is_nan() { self.started } else { self.found.time };
        // A step that is refused may be so because of its `dt`.
        let dt = if step.status.held.is_none() && reading != Reading::Lost { dt } else { 0.0 };
        let strayed = self.strayed() / self.roam;
        self.presence.pass(waited, strayed, self.workspace.clutched(), dt);
        let events = &mut self.telemetry.events;
        events.faded += u64::from(self.presence.fading());
        events.engaging += u64::from(self.presence.engaging());
        events.clutched += u64::from(self.workspace.clutched());
        self.presence.overdue(waited)
    }

    /// How far any point of the object has gone, at most, from where its contact model was found, m; 0 without contacts.
    fn strayed(&self) -> f64 {
        let Found { pose, contacts, .. } = &self.found;
        if *contacts == 0 {
            return 0.0;
        }
        let turn = 0.5 * pose.rotation_vector_to(&self.state.pose).length();
        pose.translation.distance(self.state.pose.translation) + 2.0 * self.radius * turn.sin()
    }
}
