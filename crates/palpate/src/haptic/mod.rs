//! The haptic loop (§5.1.2): read the device, move the grasped object by a step of the integrator, send the
//! coupling wrench.
//!
//! A step never allocates, locks, blocks or panics; faults are counted in [`HapticTelemetry::events`].

mod body_contacts;
mod channels;
mod exchange;
pub(crate) mod gripper;
pub(crate) mod heat;
pub(crate) mod invariants;
mod joined;
mod observer;
pub(crate) mod output;
pub(crate) mod presence;
mod pushed_objects;
pub(crate) mod reactions;
mod tools;
pub(crate) mod tracking;
pub(crate) mod workspace;

use std::sync::Arc;

use arrayvec::ArrayVec;
use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist, Wrench};
use palpate_device::{DeviceState, Specification, Status};
use palpate_dynamics::{
    ContactBlend, DeviceMapping, GripperMotion, MotionBound, SlewLimit, StepFailure, VirtualCoupling,
};
use rtrb::Consumer;

use self::body_contacts::BodyContacts;
use self::channels::Channels;
use self::gripper::Gripper;
use self::invariants::{Invariants, Moment};
use self::joined::Joined;
use self::output::Output;
use self::presence::Presence;
use self::pushed_objects::PushedObjects;
use self::reactions::Reactions;
use self::tracking::{Reading, Tracking};
use self::workspace::{Workspace, motion_at};
use crate::constraints::geometry::PredictedMotion;
use crate::constraints::geometry::taken::Taken;
use crate::contact_loop::monitor::ConstraintForces;
use crate::contact_loop::{ContactUpdate, Pull};
use crate::scene::SceneId;
use crate::scene::clock::SessionClock;
use crate::scene::moving::HandMotion;
use crate::scene::placement::HandlePlacement;
use crate::settings::live::{HapticTuning, Ramp};
use crate::telemetry::HapticTelemetry;
use crate::telemetry::record::{ModelData, StepData};
use crate::tool::rigid::Rigid;
use crate::tool::{BodyLoads, Hand, Tool, ToolStep};

/// The state of the haptic loop: the tool, its coupling to the device and the newest contact models.
///
/// The wrench and the torque of a gripper come up, fade and end together: where either the device or the
/// gripper is lost, neither is sent.
///
/// A clone has neither followers nor reactions, and no settings editor reaches it.
#[derive(Clone, Debug)]
pub struct HapticLoop<T: Tool = Rigid> {
    pub(crate) tool: T,
    /// The [grasp](crate::settings::ToolSettings::grasp), in the first mesh's frame.
    grasp: Pose,
    /// Position of the device's handle in the first mesh's frame, m.
    handle: DVec3,
    tracking: Tracking,
    /// The gripper of a tool with a hinge.
    gripper: Option<Gripper>,
    workspace: Workspace,
    presence: Presence,
    output: Output,
    /// Longest time that a step integrates, s.
    max_step: f64,
    /// Number of failed steps in a row.
    failed_steps: u32,
    /// Whether the tool has waited for contacts that its newest ones leave out.
    waited: bool,
    bodies: Box<[BodyContacts]>,
    /// Scene objects that contacts push.
    pushed: Box<PushedObjects>,
    /// Motion of the hand in the last step.
    hand: Option<Hand>,
    /// Whether no more contacts will be found.
    contacts_ended: bool,
    channels: Channels,
    /// Ramp of the coupling to newly set gains.
    tuning: Option<Ramp<VirtualCoupling>>,
    /// Time of the first step, s, from which the age of a contact model that never came counts; NaN before.
    started: f64,
    /// Time of the last step, s; NaN before.
    now: f64,
    telemetry: HapticTelemetry,
}

/// Settings of a [`HapticLoop`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct LoopSettings {
    /// Grasp in the first mesh's frame.
    pub grasp: Pose,
    pub placement: HandlePlacement,
    pub clutch_button: Option<u32>,
    pub contact_timeout: f64,
    pub engagement: f64,
    /// Lags of velocity and angular velocity for the coupling's dampers, s; 0 for the device's own.
    pub velocity_lags: (f64, f64),
    pub slew: SlewLimit,
    /// Largest damping of the passivity controller, N·s/m and N·m·s/rad at the device; 0 where it is off.
    pub max_damping: (f64, f64),
    /// Period of the loop, s.
    pub period: f64,
}

/// Energy that contacts may store for each joule in the coupling and in the body's motion: contacts are at
/// least as stiff as the coupling, so at most as much again.
const STORED_IN_CONTACTS: f64 = 1.0;

/// Longest time that a step integrates: the larger of this many periods and this many s. Longer steps of an
/// unstable host would throw the object; shorter ones would leave it behind a slow host.
const MAX_STEP: (f64, f64) = (5.0, 0.02);

/// Motion of the hand, m and rad, during the part of a late step that is not integrated, from which on the
/// wrench comes up anew: the object is left behind by as much, and would be dragged after it.
const MAX_LATE_MOTION: (f64, f64) = (2e-3, 0.05);

/// Contact force from which on the body touches something, N at the device: beyond the rounding of forces
/// that cancel, and far below what a hand feels.
const TOUCH_FORCE: f64 = 1e-6;

/// Number of failed steps in a row after which the tool is placed where the hand is.
const MAX_FAILED_STEPS: u32 = 20;

/// The time since the last step, and the part of it that a step integrates, s. An invalid `dt` counts as 0, a
/// long one as `longest`. `since` is by the clock, and wins over a host's smaller `dt`.
fn times_of_step(since: f64, dt: f64, longest: f64) -> (f64, f64) {
    let integrated = if dt > 0.0 && dt.is_finite() { dt.min(longest) } else { 0.0 };
    (since.max(integrated), integrated)
}

impl<T: Tool> HapticLoop<T> {
    /// Starts with the tool at rest at the device; `radii` are its bodies' bounding radii about their centres
    /// of mass, m.
    pub(crate) fn new(
        tool: T,
        settings: LoopSettings,
        device: DeviceState,
        specification: &Specification,
        gripper: Option<Gripper>,
        radii: &[f64],
    ) -> Self {
        let LoopSettings { placement, slew, max_damping, engagement, period, .. } = settings;
        let scale = placement.mapping().scale;
        let bodies = radii.iter().enumerate();
        let bodies =
            bodies.map(|(body, radius)| BodyContacts::new(tool.body_state(body).pose, *radius, scale));
        Self {
            grasp: settings.grasp,
            handle: placement.handle(),
            tracking: Tracking::new(device, settings.velocity_lags, period)
                .between_steps((specification.encoder_step, specification.angular_encoder_step)),
            gripper,
            workspace: Workspace::new(*placement.mapping(), settings.clutch_button),
            presence: Presence::new(settings.contact_timeout, engagement),
            output: Output::new(specification, slew, max_damping, engagement, period),
            max_step: (MAX_STEP.0 * period).max(MAX_STEP.1),
            failed_steps: 0,
            waited: false,
            bodies: bodies.collect(),
            pushed: Box::new(PushedObjects::new(scale)),
            hand: None,
            contacts_ended: false,
            channels: Channels::default(),
            tuning: None,
            started: f64::NAN,
            now: f64::NAN,
            telemetry: HapticTelemetry::default(),
            tool,
        }
    }

    /// The virtual coupling between device and tool, in the world.
    pub fn coupling(&self) -> &VirtualCoupling {
        self.tool.coupling()
    }

    /// Lags of the device's velocity and angular velocity that the coupling's dampers act on, s; 0 where the
    /// device's own velocity is used.
    pub fn velocity_lags(&self) -> (f64, f64) {
        self.tracking.lags()
    }

    /// The [grasp](crate::settings::ToolSettings::grasp) that the coupling holds the tool at, in the first
    /// mesh's frame.
    pub fn grasp(&self) -> &Pose {
        &self.grasp
    }

    /// The mapping of the device's workspace into the world, for its handle; each release of the clutch moves
    /// it.
    pub fn mapping(&self) -> &DeviceMapping {
        self.workspace.mapping()
    }

    /// Engages the clutch from the next step on, or releases it. While it is engaged, by this or by its
    /// button, the device moves without the tool, which stays where it is held. A gripper has no clutch.
    pub fn set_clutch(&mut self, held: bool) {
        self.workspace.ask_clutch(held);
    }

    /// The measurements so far. Readings of a gripper count as those of the device.
    pub fn telemetry(&self) -> &HapticTelemetry {
        &self.telemetry
    }

    /// The checks so far of the wrenches that were sent; the torque of a gripper is not checked.
    pub fn invariants(&self) -> &Invariants {
        self.output.invariants()
    }

    /// The measurements so far, to add to.
    pub(crate) fn telemetry_mut(&mut self) -> &mut HapticTelemetry {
        &mut self.telemetry
    }

    /// Puts a newer contact model of a body into use: [gradually](ContactBlend), over the time between the
    /// last two models, at most [`ContactBlend::MAX_DURATION`].
    pub(crate) fn take_model(&mut self, body: usize, update: &ContactUpdate) {
        let state = self.tool.body_state(body);
        let Some(known) = self.bodies.get_mut(body) else { return };
        let &ContactUpdate { ref model, time, depth, contacts, ref geometry } = update;
        let since = time - known.found.time;
        let duration = if since.is_nan() { 0.0 } else { since.min(ContactBlend::MAX_DURATION) };
        let age = self.now - time;
        known.blend.arrive(model, &state, age, duration);
        let age = if age > 0.0 { age } else { 0.0 };
        known.take((body, geometry.as_ref()), (&state, age), &mut self.pushed, &self.channels.joined);
        known.found = ModelData { time, pose: *model.pose(), depth, contacts };
        known.penalties = (depth, contacts);
        self.waited = false;
    }

    /// Holds the tool where it is until contacts are found, or lets it go.
    pub(crate) fn hold(&mut self, held: bool) {
        self.bodies.iter_mut().for_each(|body| body.hold(held));
    }

    /// Counts contacts that were found as overdue once they are as old as any: no more will be found.
    pub(crate) fn end_contacts(&mut self) {
        self.contacts_ended = true;
    }

    /// How the hand pulls a body, for the contact loop.
    pub(crate) fn pull_of(&self, body: usize) -> Pull {
        let (Some(hand), Some(contacts)) = (&self.hand, self.bodies.get(body)) else {
            return Pull::default();
        };
        let [first, own] = [0, body].map(|body| self.tool.body_state(body).pose);
        let held = self.tool.coupling().relaxed_pose(&hand.device.pose);
        // A body at a hinge is pulled by the first one, and turns with the gripper.
        let radius = own.translation.distance(first.translation) + contacts.radius();
        let rate = if body == 0 { 0.0 } else { 2.0 * contacts.radius() * hand.gripper.rate.abs() };
        let lever = held.translation.distance(hand.device.pose.translation) + radius;
        let Twist { linear, angular } = hand.device.twist;
        Pull {
            stretch: MotionBound { from: held, radius, ..MotionBound::NONE }.displacement(&first),
            speed: linear.length() + angular.length() * lever + rate,
            waited: self.waited,
        }
    }

    /// Number of contacts of all bodies, before clustering.
    fn contacts(&self) -> u32 {
        self.bodies.iter().map(|body| body.found.contacts).sum()
    }

    /// Fades the wrench out from now on, before the session ends.
    pub fn leave(&mut self) {
        self.presence.leave();
    }

    /// Takes one step with the readings of device and gripper (rad), without a device if it did not answer.
    /// Returns the record, and the wrench to send.
    pub(crate) fn advance(
        &mut self,
        device: Option<&DeviceState>,
        gripper_angle: Option<f64>,
        now: f64,
        dt: f64,
    ) -> (T::Record, Wrench) {
        self.telemetry.steps += 1;
        if self.started.is_nan() {
            self.started = now;
        }
        let (elapsed, dt) = times_of_step(now - std::mem::replace(&mut self.now, now), dt, self.max_step);
        let reading = self.read(device, gripper_angle, elapsed, dt);
        if self.workspace.clutched() {
            // The hand's image stays, and on release it must not drift while an estimate settles.
            self.tracking.drop_estimate();
        }
        let handle = self.workspace.locate(&self.tracking.damped_state());
        let hand = Hand {
            device: motion_at(&handle, &(Pose::from_translation(-self.handle) * self.grasp)),
            gripper: self.gripper.as_ref().map_or(GripperMotion::default(), Gripper::motion),
        };
        // From the handle, which the device's torque is about, to the grasp.
        let arm = hand.device.pose.translation - handle.pose.translation;
        self.hand = Some(hand);
        let stored = self.observe(&hand);
        let events = &mut self.telemetry.events;
        let harmful = self.output.is_harmful(&self.tracking, (stored, elapsed), events);

        self.tune(dt);
        let step = self.step_tool(&hand, dt);
        let failed = step.status.failure.is_some() || reading == Reading::Lost;
        let released = failed || harmful || reading == Reading::Back;
        if released {
            self.presence.release();
        }
        let overdue = self.pass(failed, now, dt);
        let share = self.presence.share();
        let at = Moment { dt, elapsed, share, faulty: failed, overdue, released, stored };
        let wanted = self.workspace.mapping().wrench(&step.coupling.about(-arm));
        let sends = device.is_some() && !harmful && !failed && share > 0.0;
        let sent = self.limit((&wanted, step.gripper), device.is_none() || harmful, sends, &at);
        self.telemetry.pass(elapsed);
        let handle = handle.pose * Pose::from_translation(-self.handle);
        (self.record(&handle, &step, sent), sent)
    }

    /// Takes the readings of device and gripper, `elapsed` (s) after the last ones, of which a step
    /// integrates `dt` (s). Returns the worse of the two results.
    fn read(
        &mut self,
        device: Option<&DeviceState>,
        gripper_angle: Option<f64>,
        elapsed: f64,
        dt: f64,
    ) -> Reading {
        let before = self.tracking.damped_state().pose;
        let events = &mut self.telemetry.events;
        let mut reading = self.tracking.take(device, elapsed, events);
        let of_device = reading;
        if let (Some(gripper), Some(angle)) = (&mut self.gripper, gripper_angle) {
            let (of_gripper, energy) = gripper.take(angle, elapsed, events);
            self.output.exchange(energy);
            reading = reading.or_worse(of_gripper);
        }
        if device.is_some_and(|state| state.status.contains(Status::WITHHELD)) {
            events.withheld += 1;
            self.presence.release();
            self.output.forget();
        }
        // The hand may have moved while it was lost; the mapping moves instead, so that the tool is not
        // dragged after it.
        if of_device == Reading::Back && self.output.limits().renders {
            let rebased = self.workspace.rebase(&before, &self.tracking.state().pose);
            events.rebased += u64::from(rebased);
        }
        let Twist { linear, angular } = *self.tracking.displacement();
        let left_out = elapsed > 1.5 * dt;
        if left_out && (linear.length() > MAX_LATE_MOTION.0 || angular.length() > MAX_LATE_MOTION.1) {
            events.late += 1;
            self.presence.release();
        }
        reading
    }

    /// Moves the tool by `dt` (s). After [`MAX_FAILED_STEPS`] it is placed where the hand holds it.
    fn step_tool(&mut self, hand: &Hand, dt: f64) -> ToolStep {
        let other_hands = self.channels.other_hands.take(&self.tool.body_state(0));
        if let Some((linear, angular)) = other_hands {
            self.tool.push(linear, angular);
        }
        self.channels.joined.iter_mut().for_each(|other| other.update(self.now));
        self.pushed.follow_hands(&self.channels.joined, &self.channels.reacting);
        self.pushed.begin(dt);
        let before = self.tool.body_state(0).twist;
        let mut bounds = [MotionBound::NONE; 2];
        for ((index, body), bound) in self.bodies.iter_mut().enumerate().zip(&mut bounds) {
            let state = self.tool.body_state(index);
            body.blend.advance(&state, dt);
            *bound = body.find(&state, dt, &self.pushed, &self.channels.joined);
        }
        let mut step = self.bounded_step(hand, bounds, dt);
        self.channels.other_hands.observe(&before, &self.tool.body_state(0).twist, dt);
        if let Some((linear, angular)) = other_hands.filter(|_| dt > 0.0) {
            step.contacts[0] += Wrench { force: linear / dt, torque: angular / dt };
        }
        for body in &self.bodies {
            let lost = body.push(&mut self.pushed, &mut self.channels.reacting);
            self.telemetry.events.reaction_dropped += lost;
        }
        self.pushed.end(dt, self.now);
        if self.telemetry.first_touch.is_none() && self.touches(&step, dt) {
            self.telemetry.first_touch = Some(self.now);
        }
        let contacts = self.contacts();
        let depth = self.bodies.iter().map(|body| body.found.depth).fold(0.0, f64::max);
        let telemetry = &mut self.telemetry;
        telemetry.depth_max = telemetry.depth_max.max(depth);
        telemetry.contacts_max = telemetry.contacts_max.max(contacts);
        telemetry.contacts_now = contacts;
        let events = &mut self.telemetry.events;
        let is_held = self.bodies.iter().any(BodyContacts::is_held);
        events.waited += u64::from(step.waited && !is_held);
        self.waited |= step.waited && !is_held;
        events.step_refused += u64::from(step.status.failure.is_some());
        events.contacts_unsettled += u64::from(step.status.active_set_unsettled);
        events.step_unconverged += u64::from(step.status.unconverged);
        // An invalid `dt` is the host's fault, and moving the tool would not help.
        let failed = step.status.failure.is_some_and(|why| why != StepFailure::TimeStep);
        self.failed_steps = if failed { self.failed_steps + 1 } else { 0 };
        if self.failed_steps >= MAX_FAILED_STEPS && self.tool.reseat(hand) {
            self.failed_steps = 0;
            events.reseated += 1;
        }
        self.publish(step.status.failure.is_none(), dt);
        step
    }

    /// Moves the tool by `dt` (s) within bounds on its bodies' motion. It is moved again from where it was as
    /// long as its contacts change with where it comes to.
    fn bounded_step(&mut self, hand: &Hand, bounds: [MotionBound; 2], dt: f64) -> ToolStep {
        let before = self.tool.clone();
        loop {
            let mut loads = ArrayVec::<BodyLoads<'_>, 2>::new();
            for (body, bound) in self.bodies.iter_mut().zip(bounds) {
                let constrained = body.is_constrained();
                let (model, constraints) = body.contacts();
                loads.push(BodyLoads { model, constrained, constraints, bound });
            }
            let step = self.tool.step(hand, &mut loads, self.pushed.bodies(), dt);
            drop(loads);
            let mut revised = false;
            for (index, body) in self.bodies.iter_mut().enumerate() {
                let poses = [&before, &self.tool].map(|tool| tool.body_state(index).pose);
                revised |= step.status.failure.is_none() && body.revise(&Taken { poses, dt });
            }
            if !revised {
                return step;
            }
            self.tool.clone_from(&before);
        }
    }

    /// Whether a contact pushed the tool in a step of `dt` (s): one of its own, or one that another session
    /// found. Contacts that are only near are no touch.
    fn touches(&self, step: &ToolStep, dt: f64) -> bool {
        let force = TOUCH_FORCE * self.workspace.mapping().scale;
        let push =
            |(index, body): (usize, &BodyContacts)| body.largest_push(&self.tool.body_state(index), dt);
        step.status.failure.is_none()
            && dt > 0.0
            && (step.contacts.iter().any(|contact| contact.force.length() > force)
                || self.bodies.iter().enumerate().any(|body| push(body) > force))
    }

    /// Applies newly set gains, gradually.
    fn tune(&mut self, dt: f64) {
        while let Some(tuning) = self.channels.tunings.as_mut().and_then(|tunings| tunings.pop().ok()) {
            self.tuning = Some(Ramp::new(*self.tool.coupling(), tuning.coupling));
            self.tracking.set_lags(tuning.velocity_lags);
            self.output.set_slew(tuning.slew);
            self.output.passivity.set_max_damping(tuning.max_damping);
        }
        if let Some(ramp) = &mut self.tuning {
            let (coupling, ended) = ramp.advance(dt);
            self.tool.set_coupling(coupling);
            if ended {
                self.tuning = None;
            }
        }
    }

    pub(crate) fn set_tunings(&mut self, tunings: Consumer<HapticTuning>) {
        self.channels.tunings = Some(tunings);
    }

    /// Publishes the first body's motion and, if a step of `dt` (s) was taken, its contacts' forces on the
    /// scene.
    fn publish(&mut self, taken: bool, dt: f64) {
        let reacting = &mut self.channels.reacting;
        if taken {
            for (index, body) in self.bodies.iter().enumerate() {
                let state = self.tool.body_state(index);
                self.telemetry.events.reaction_dropped += reacting.add(body.blend.model(), &state, dt);
            }
        }
        self.telemetry.events.reaction_dropped += reacting.pass_on();
        for (index, monitor) in &mut self.channels.constraints {
            let Some(body) = self.bodies.get(*index) else { continue };
            body.write_constraints(&self.tool.body_state(*index), dt, monitor.input_buffer_mut());
            monitor.publish();
        }
        for predicted in &mut self.channels.predicted {
            self.pushed.write(predicted.input_buffer_mut());
            predicted.publish();
        }
        self.channels.clock.set(self.now);
        if !self.channels.followers.is_empty() {
            let motion = self.hand_motion();
            for follower in &mut self.channels.followers {
                follower.write(motion);
            }
        }
    }

    /// Motion of the first body, for another session.
    fn hand_motion(&self) -> HandMotion {
        let (pose, state) = (self.tool.object_pose(0), self.tool.body_state(0));
        let arm = pose.translation - state.pose.translation;
        let twist = Twist { linear: state.twist.velocity_at(arm), angular: state.twist.angular };
        HandMotion { pose, twist, load: self.channels.other_hands.load() }
    }

    /// Opens the queue of contact forces on the scene's objects, filled from the next step on.
    pub(crate) fn reactions(&mut self) -> Reactions {
        self.channels.reacting.open()
    }

    /// Opens a view of the forces of a body's constraints for a contact monitor.
    pub(crate) fn constraint_monitor(&mut self, body: usize) -> triple_buffer::Output<ConstraintForces> {
        let (input, output) = triple_buffer::triple_buffer(&ConstraintForces::new());
        self.channels.constraints.push((body, input));
        output
    }

    /// Opens a view of the motion of the objects that contacts push.
    pub(crate) fn predict(&mut self) -> triple_buffer::Output<PredictedMotion> {
        let (input, output) = triple_buffer::triple_buffer(&PredictedMotion::new());
        self.channels.predicted.push(input);
        output
    }

    /// Time of the last step, for other threads.
    pub(crate) fn clock(&self) -> Arc<SessionClock> {
        Arc::clone(&self.channels.clock)
    }

    /// Opens a view of the first body's motion for another session.
    pub(crate) fn lead(&mut self) -> triple_buffer::Output<HandMotion> {
        let (input, output) = triple_buffer::triple_buffer(&self.hand_motion());
        self.channels.followers.push(input);
        output
    }

    /// Follows the object in another hand, of a bounding radius (m), which is in this scene.
    pub(crate) fn follow(&mut self, id: SceneId, other: &mut Self, radius: f64) {
        self.channels.joined.push(Joined::new(id, other.lead(), radius));
    }

    /// Lets contacts with an object of this scene, which is in another hand, act on it there.
    pub(crate) fn push(&mut self, id: SceneId, other: &mut Self) {
        other.channels.other_hands.add(self.channels.reacting.route(id));
    }

    /// Counts the energy that flowed over the last period. Returns the largest energy that may come back, J
    /// at the device.
    fn observe(&mut self, hand: &Hand) -> f64 {
        let scale = self.workspace.mapping().scale;
        let stored = (1.0 + STORED_IN_CONTACTS) * self.tool.energy(hand) / (scale * scale);
        self.output.observe(&self.tracking, stored);
        let passivity = &self.output.passivity;
        let telemetry = &mut self.telemetry;
        telemetry.energy = passivity.energy() + self.gripper.as_ref().map_or(0.0, Gripper::energy);
        telemetry.energy_min = telemetry.energy_min.min(telemetry.energy);
        telemetry.dissipated = passivity.dissipated();
        stored
    }

    /// Raises or lowers the share of the wrench, and counts why. Returns the time since contact models have
    /// been overdue, s.
    fn pass(&mut self, failed: bool, now: f64, dt: f64) -> f64 {
        let timeout = self.presence.timeout();
        let waited = |body: &BodyContacts| {
            let found = body.found.time;
            let longer = if self.contacts_ended { 0.0 } else { body.holds_for(timeout) - timeout };
            now - if found.is_nan() { self.started } else { found } - longer
        };
        let waited = self.bodies.iter().map(waited).fold(f64::NEG_INFINITY, f64::max);
        // A step may have failed because of its `dt`.
        let dt = if failed { 0.0 } else { dt };
        let bodies = self.bodies.iter().enumerate();
        let strayed = bodies.map(|(index, body)| body.strayed(&self.tool.body_state(index).pose));
        let strayed = strayed.fold(0.0, f64::max);
        self.presence.pass(waited, strayed, self.workspace.clutched(), dt);
        let events = &mut self.telemetry.events;
        events.faded += u64::from(self.presence.fading());
        events.engaging += u64::from(self.presence.engaging());
        events.clutched += u64::from(self.workspace.clutched());
        self.presence.overdue(waited)
    }

    fn record(&mut self, handle: &Pose, step: &ToolStep, sent: Wrench) -> T::Record {
        let found =
            |body: usize| self.bodies.get(body).map_or(ModelData::none(Pose::IDENTITY), |body| body.found);
        let gripper = self.gripper.as_ref();
        let data = StepData {
            time: self.now,
            device: self.tracking.state().pose,
            handle: *handle,
            gripper: gripper.map_or(0.0, |gripper| gripper.motion().angle),
            coupling: sent,
            torque: gripper.map_or(0.0, Gripper::torque),
            models: [found(0), found(1)],
        };
        let grasp = self.grasp.translation;
        let stretch = handle.transform_point(grasp).distance(self.tool.object_pose(0).transform_point(grasp));
        let telemetry = &mut self.telemetry;
        telemetry.coupling_force_max = telemetry.coupling_force_max.max(sent.force.length());
        telemetry.stretch_max = telemetry.stretch_max.max(stretch);
        self.tool.record(&data, step)
    }
}
