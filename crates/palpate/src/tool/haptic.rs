//! The haptic loop of a tool of two bodies: read device and gripper, move the tool by a step of seven unknowns, send wrench and torque.
//!
//! A step never allocates, locks, blocks or panics; what goes wrong is counted in [`HapticTelemetry::events`]. Wrench and torque come
//! up, fade and are let go of together: where either the device or the gripper is lost, both are.

use palpate_core::glam::DVec3;
use palpate_core::{Pose, Wrench};
use palpate_device::{DeviceState, Specification, Status};
use palpate_dynamics::{
    ArticulatedBody, ArticulatedFrame, ArticulatedState, ArticulatedStep, BodyState, ContactBlend,
    DeviceMotion, GripperCoupling, SlewLimit, VirtualCoupling, articulated_step,
};

use super::gripper::{Gripper, GripperSettings};
use super::record::ArticulatedRecord;
use super::tool::ToolBody;
use crate::contact::ContactUpdate;
use crate::haptic::invariants::Invariants;
use crate::haptic::output::{Moment, Output};
use crate::haptic::presence::Presence;
use crate::haptic::reactions::{Reacting, Reactions};
use crate::haptic::tracking::{Reading, Tracking};
use crate::haptic::workspace::{Workspace, motion_at};
use crate::haptic::{Found, LONGEST_STEP, STORED_IN_CONTACTS, times_of_step};
use crate::scene::placement::HandlePlacement;
use crate::telemetry::HapticTelemetry;

/// The state of the haptic loop: the tool, its couplings to device and gripper, and the newest contact models of its bodies.
///
/// A clone tells nobody what it pushes.
#[derive(Clone, Debug)]
pub struct ArticulatedLoop {
    body: ArticulatedBody,
    coupling: VirtualCoupling,
    grip: GripperCoupling,
    state: ArticulatedState,
    /// Centres of mass in the meshes' frames, m.
    centers: [DVec3; 2],
    /// The frame that the coupling holds, in the first mesh's frame.
    grasp: Pose,
    /// Where the device's handle is, in the first mesh's frame, m.
    handle: DVec3,
    tracking: Tracking,
    gripper: Gripper,
    workspace: Workspace,
    presence: Presence,
    output: Output,
    /// The longest time that a step integrates, s.
    longest_step: f64,
    found: [Found; 2],
    contacts: [ContactBlend; 2],
    reacting: Reacting,
    /// Time of the first step, s, from which the first contact models are waited for, and of the last one; NaN before.
    started: f64,
    now: f64,
    telemetry: HapticTelemetry,
}

/// What an [`ArticulatedLoop`] is made of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grasped {
    pub body: ArticulatedBody,
    pub coupling: VirtualCoupling,
    pub grip: GripperCoupling,
    pub centers: [DVec3; 2],
    pub grasp: Pose,
    pub placement: HandlePlacement,
    pub clutch_button: Option<u32>,
    pub contact_timeout: f64,
    pub engagement: f64,
    /// Lags of velocity and angular velocity for the coupling's dampers, s; 0 for the device's own.
    pub velocity_lags: (f64, f64),
    /// Of the gripper's rate, s.
    pub gripper_lag: f64,
    pub slew: SlewLimit,
    /// Most damping of the passivity controller, N·s/m and N·m·s/rad at the device; 0 where it is off.
    pub max_damping: (f64, f64),
    /// Period of the loop, s.
    pub period: f64,
}

impl ArticulatedLoop {
    /// Starts with the tool at rest in the device's hand, and the hinge where
    /// the gripper (rad) is, as far as its limits allow.
    pub(super) fn new(
        grasped: Grasped,
        state: ArticulatedState,
        device: &DeviceState,
        specification: &Specification,
        gripper: &GripperSettings,
        gripper_angle: f64,
    ) -> Self {
        let Grasped { slew, max_damping, engagement, period, .. } = grasped;
        let none = Found { time: f64::NAN, pose: Pose::IDENTITY, depth: 0.0, contacts: 0 };
        Self {
            body: grasped.body,
            coupling: grasped.coupling,
            grip: grasped.grip,
            state,
            centers: grasped.centers,
            grasp: grasped.grasp,
            handle: grasped.placement.handle(),
            tracking: Tracking::new(*device, grasped.velocity_lags, period),
            gripper: Gripper::new(gripper, gripper_angle, grasped.gripper_lag, period),
            workspace: Workspace::new(*grasped.placement.mapping(), grasped.clutch_button),
            presence: Presence::new(grasped.contact_timeout, engagement),
            output: Output::new(specification, slew, max_damping, engagement, period),
            longest_step: (LONGEST_STEP.0 * period).max(LONGEST_STEP.1),
            found: [none; 2],
            contacts: [ContactBlend::new(), ContactBlend::new()],
            reacting: Reacting::default(),
            started: f64::NAN,
            now: f64::NAN,
            telemetry: HapticTelemetry::default(),
        }
    }

    /// The tool: bodies about their centres of mass, in their meshes' axes.
    pub fn body(&self) -> &ArticulatedBody {
        &self.body
    }

    /// Where it is and how it moves; the pose is that of the first body's centre of mass.
    pub fn state(&self) -> &ArticulatedState {
        &self.state
    }

    /// Where one of its bodies is and how it moves; the pose is that of its centre of mass, in its mesh's axes.
    pub fn body_state(&self, body: ToolBody) -> BodyState {
        match body {
            ToolBody::First => self.state.first,
            ToolBody::Second => self.body.second(&self.state),
        }
    }

    /// Poses of the two bodies' mesh frames.
    pub fn object_poses(&self) -> [Pose; 2] {
        let of = |body: ToolBody, centre: DVec3| self.body_state(body).pose * Pose::from_translation(-centre);
        [of(ToolBody::First, self.centers[0]), of(ToolBody::Second, self.centers[1])]
    }

    /// The coupling that holds the first body, in the world.
    pub fn coupling(&self) -> &VirtualCoupling {
        &self.coupling
    }

    /// The coupling of gripper and hinge, in the world.
    pub fn grip(&self) -> &GripperCoupling {
        &self.grip
    }

    /// Holds the clutch, from the next step on, or lets it go; as [`HapticLoop::set_clutch`](crate::HapticLoop::set_clutch). The
    /// gripper has none.
    pub fn set_clutch(&mut self, held: bool) {
        self.workspace.ask_clutch(held);
    }

    /// What was measured so far. Readings of the gripper count as those of the device.
    pub fn telemetry(&self) -> &HapticTelemetry {
        &self.telemetry
    }

    /// What was checked so far of the wrenches that were sent; the gripper's torque is not among them.
    pub fn invariants(&self) -> &Invariants {
        self.output.invariants()
    }

    /// Takes a newer contact model of one body into use: [gradually](ContactBlend), over as long as lies between the last two, but no
    /// longer than [`ContactBlend::LONGEST`].
    pub fn update_contacts(&mut self, body: ToolBody, update: &ContactUpdate) {
        let state = self.body_state(body);
        let (found, contacts) = match body {
            ToolBody::First => (&mut self.found[0], &mut self.contacts[0]),
            ToolBody::Second => (&mut self.found[1], &mut self.contacts[1]),
        };
        let &ContactUpdate { ref model, time, depth, contacts: count } = update;
        let since = time - found.time;
        let duration = if since.is_nan() { 0.0 } else { since.min(ContactBlend::LONGEST) };
        contacts.arrive(model, &state, self.now - time, duration);
        *found = Found { time, pose: *model.pose(), depth, contacts: count };
        self.telemetry.depth_max = self.telemetry.depth_max.max(depth);
    }

    /// One step of `dt` seconds up to time `now` (s), for a device and a gripper (rad) that the host has read. The wrench and the torque
    /// to send are the record's [`coupling`](ArticulatedRecord::coupling) and [`torque`](ArticulatedRecord::torque).
    pub fn step(&mut self, device: &DeviceState, gripper_angle: f64, now: f64, dt: f64) -> ArticulatedRecord {
        self.telemetry.steps += 1;
        if self.started.is_nan() {
            self.started = now;
        }
        let (elapsed, dt) = times_of_step(now - std::mem::replace(&mut self.now, now), dt, self.longest_step);
        let reading = self.read(device, gripper_angle, elapsed);
        let handle = self.workspace.locate(&self.tracking.damped_state());
        let motion = motion_at(&handle, &(Pose::from_translation(-self.handle) * self.grasp));
        let arm = motion.pose.translation - handle.pose.translation;
        let stored = self.observe(&motion);
        let harmful = self.output.is_harmful(&self.tracking, (stored, elapsed), &mut self.telemetry.events);

        let second = self.body_state(ToolBody::Second);
        self.contacts[0].advance(&self.state.first, dt);
        self.contacts[1].advance(&second, dt);
        let gripper = self.gripper.motion();
        let frame = ArticulatedFrame {
            tool: &self.body,
            device: &motion,
            coupling: &self.coupling,
            gripper: &gripper,
            grip: &self.grip,
            contacts: [self.contacts[0].contacts(), self.contacts[1].contacts()],
            gravity: DVec3::ZERO,
        };
        let step = articulated_step(&frame, &self.state, dt);
        self.telemetry.events.step_refused += u64::from(step.status.held.is_some());
        self.telemetry.events.contacts_unsettled += u64::from(step.status.active_set_unsettled);
        self.state = step.state;
        self.react(&step, dt);

        let failed = step.status.held.is_some() || reading == Reading::Lost;
        let released = failed || harmful || reading == Reading::Back;
        if released {
            self.presence.release();
        }
        let overdue = self.pass(reading, &step, now, dt);
        let share = self.presence.share();
        let at = Moment { dt, elapsed, share, faulty: failed, overdue, released, stored };
        let sent = if harmful {
            self.gripper.release(elapsed);
            self.output.drop(&self.tracking, &at)
        } else if !failed && share > 0.0 {
            self.send(&step, arm, &at)
        } else {
            self.gripper.release(elapsed);
            self.output.let_go(&self.tracking, &at)
        };
        self.telemetry.coupling_force_max = self.telemetry.coupling_force_max.max(sent.force.length());
        self.record(&handle, &step, sent, now)
    }

    /// Lets what contacts push the scene's objects with be taken elsewhere, from the next step on.
    pub(super) fn reactions(&mut self) -> Reactions {
        self.reacting.open()
    }

    /// Tells what a step of `dt` (s) pushed the scene with, if it was taken.
    fn react(&mut self, step: &ArticulatedStep, dt: f64) {
        let states = [self.state.first, self.body.second(&self.state)];
        for (contacts, state) in self.contacts.iter().zip(&states).filter(|_| step.status.held.is_none()) {
            self.telemetry.events.reaction_dropped += self.reacting.add(contacts.contacts(), state, dt);
        }
        self.reacting.pass_on();
    }

    /// Takes the readings of device and gripper, `elapsed` (s) after those before: what came of the worse.
    fn read(&mut self, device: &DeviceState, gripper_angle: f64, elapsed: f64) -> Reading {
        let before = self.tracking.state().pose;
        let events = &mut self.telemetry.events;
        let of_device = self.tracking.take(Some(device), elapsed, events);
        let (of_gripper, energy) = self.gripper.take(gripper_angle, elapsed, events);
        self.output.exchange(energy);
        if device.status.contains(Status::WITHHELD) {
            events.withheld += 1;
            self.presence.release();
            self.output.forget();
        }
        if of_device == Reading::Back && self.output.limits().renders {
            events.rebased += u64::from(self.workspace.rebase(&before, &self.tracking.state().pose));
        }
        let either = |reading: Reading| of_device == reading || of_gripper == reading;
        [Reading::Lost, Reading::Back, Reading::Held]
            .into_iter()
            .find(|&reading| either(reading))
            .unwrap_or(Reading::Good)
    }

    /// Counts the energy that flowed over the last period. The most (J at the device) that may come back.
    fn observe(&mut self, motion: &DeviceMotion) -> f64 {
        let scale = self.workspace.mapping().scale;
        let springs = self.coupling.potential_energy(&self.state.first, motion)
            + self.grip.potential_energy(&self.state, &self.gripper.motion());
        let stored =
            (1.0 + STORED_IN_CONTACTS) * (springs + self.body.kinetic_energy(&self.state)) / (scale * scale);
        self.output.observe(&self.tracking, stored);
        let passivity = &self.output.passivity;
        let telemetry = &mut self.telemetry;
        telemetry.energy = passivity.energy() + self.gripper.energy();
        telemetry.energy_min = telemetry.energy_min.min(telemetry.energy);
        telemetry.dissipated = passivity.dissipated();
        stored
    }

    /// Lets the share of wrench and torque come up, fade or fall to nothing, and counts why. How long contact models have been
    /// overdue, s.
    fn pass(&mut self, reading: Reading, step: &ArticulatedStep, now: f64, dt: f64) -> f64 {
        let since = |found: &Found| now - if found.time.is_nan() { self.started } else { found.time };
        let waited = since(&self.found[0]).max(since(&self.found[1]));
        // A step that is refused may be so because of its `dt`.
        let dt = if step.status.held.is_none() && reading != Reading::Lost { dt } else { 0.0 };
        self.presence.pass(waited, 0.0, self.workspace.clutched(), dt);
        let events = &mut self.telemetry.events;
        events.faded += u64::from(self.presence.fading());
        events.engaging += u64::from(self.presence.engaging());
        events.clutched += u64::from(self.workspace.clutched());
        self.presence.overdue(waited)
    }

    /// Sends device and gripper what they get of a step.
    fn send(&mut self, step: &ArticulatedStep, arm: DVec3, at: &Moment) -> Wrench {
        let mapping = *self.workspace.mapping();
        let events = &mut self.telemetry.events;
        // As any torque (§5.3.3).
        let torque = step.gripper * at.share / (mapping.scale * mapping.scale);
        self.gripper.send(torque, at, events);
        let wanted = mapping.wrench(&step.coupling.about(-arm));
        self.output.send(&wanted, &self.tracking, at, events)
    }

    fn record(
        &self,
        handle: &DeviceMotion,
        step: &ArticulatedStep,
        sent: Wrench,
        now: f64,
    ) -> ArticulatedRecord {
        let [first, second] = &self.found;
        ArticulatedRecord {
            time: now,
            device: self.tracking.state().pose,
            handle: handle.pose * Pose::from_translation(-self.handle),
            gripper: self.gripper.motion().angle,
            objects: self.object_poses(),
            angle: self.state.angle,
            coupling: sent,
            torque: self.gripper.torque(),
            stop: step.stop,
            contact: step.contacts,
            depth: [first.depth, second.depth],
            contacts: [first.contacts, second.contacts],
            // The first comparison is false where one is NaN.
            model_age: if first.time < second.time || first.time.is_nan() {
                now - first.time
            } else {
                now - second.time
            },
        }
    }
}
