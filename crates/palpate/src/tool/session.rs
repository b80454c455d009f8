//! The two ways to run a session with a tool: by a host, with contacts found in threads beside it, and in lockstep on a simulated
//! clock.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use palpate_core::{Pose, Wrench};
use palpate_device::DeviceState;
use palpate_dynamics::BodyState;
use rtrb::{Consumer, RingBuffer};

use super::haptic::ArticulatedLoop;
use super::record::ArticulatedRecord;
use super::tool::{ArticulatedRenderer, ToolBody};
use crate::contact::{ContactLoop, ContactUpdate};
use crate::run::lockstep::ContactTiming;
use crate::run::realtime::{MODEL_RING, run_contact};
use crate::telemetry::Events;

const BODIES: [ToolBody; 2] = [ToolBody::First, ToolBody::Second];

/// A session with a tool that a host steps. Its contact threads, one for each body, end when it is dropped.
#[derive(Debug)]
pub struct ArticulatedSession {
    haptic: ArticulatedLoop,
    beside: [Beside; 2],
    now: f64,
    latest: Option<ArticulatedRecord>,
    ended: Arc<AtomicBool>,
}

/// The host's end of a contact thread.
#[derive(Debug)]
struct Beside {
    models: Consumer<ContactUpdate>,
    state: triple_buffer::Input<(f64, BodyState)>,
    thread: Option<JoinHandle<()>>,
}

impl Beside {
    fn new(mut contact: ContactLoop, body: BodyState, ended: &Arc<AtomicBool>) -> std::io::Result<Self> {
        let (models_in, models) = RingBuffer::new(MODEL_RING);
        let (state, state_out) = triple_buffer::triple_buffer(&(0.0, body));
        let flag = Arc::clone(ended);
        let thread = std::thread::Builder::new()
            .name("palpate contacts".to_owned())
            .spawn(move || drop(run_contact(&mut contact, state_out, models_in, &flag)))?;
        Ok(Self { models, state, thread: Some(thread) })
    }
}

impl ArticulatedRenderer {
    /// A session for a host that owns device and gripper, with contacts found in two threads as fast as they can be.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn host(self) -> std::io::Result<ArticulatedSession> {
        let Self { haptic, contacts: [first, second], .. } = self;
        let ended = Arc::new(AtomicBool::new(false));
        let made = || {
            let first = Beside::new(first, haptic.body_state(ToolBody::First), &ended)?;
            let second = Beside::new(second, haptic.body_state(ToolBody::Second), &ended)?;
            Ok([first, second])
        };
        match made() {
            Ok(beside) => Ok(ArticulatedSession { haptic, beside, now: 0.0, latest: None, ended }),
            Err(error) => {
                // The first thread may run already.
                ended.store(true, Ordering::Release);
                Err(error)
            }
        }
    }

    /// The session on a simulated clock: the same each time.
    pub fn lockstep(self, timing: ContactTiming) -> ArticulatedLockstep {
        ArticulatedLockstep {
            haptic: self.haptic,
            contacts: self.contacts,
            period: self.period,
            query_period: (1.0 / timing.rate).max(self.period),
            latency: timing.latency,
            steps: 0,
            queries: 0,
            pending: VecDeque::new(),
        }
    }
}

impl ArticulatedSession {
    /// A haptic step of `dt` seconds, device and gripper (rad) being in a state: the wrench to send to the device, in its axes, about its
    /// handle's origin, and the torque (N·m) to send to the gripper, positive where it opens it. A `dt` that is not above 0 changes
    /// nothing, and gives those of the last step.
    pub fn step(&mut self, dt: f64, device: &DeviceState, gripper_angle: f64) -> (Wrench, f64) {
        if !(dt > 0.0 && dt.is_finite()) {
            return self.latest.map_or((Wrench::ZERO, 0.0), |record| (record.coupling, record.torque));
        }
        for (body, beside) in BODIES.into_iter().zip(&mut self.beside) {
            while let Ok(update) = beside.models.pop() {
                self.haptic.update_contacts(body, &update);
            }
        }
        self.now += dt;
        let record = self.haptic.step(device, gripper_angle, self.now, dt);
        for (body, beside) in BODIES.into_iter().zip(&mut self.beside) {
            beside.state.write((self.now, self.haptic.body_state(body)));
        }
        self.latest = Some(record);
        (record.coupling, record.torque)
    }

    /// What the last step gave; none before the first.
    pub fn latest(&self) -> Option<&ArticulatedRecord> {
        self.latest.as_ref()
    }

    /// Poses of the two bodies' mesh frames in the world.
    pub fn object_poses(&self) -> [Pose; 2] {
        self.haptic.object_poses()
    }

    /// Holds the clutch, or lets it go ([`ArticulatedLoop::set_clutch`]).
    pub fn set_clutch(&mut self, held: bool) {
        self.haptic.set_clutch(held);
    }

    /// What happened out of the ordinary in haptic steps.
    pub fn events(&self) -> Events {
        self.haptic.telemetry().events
    }
}

impl Drop for ArticulatedSession {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        for thread in self.beside.iter_mut().filter_map(|beside| beside.thread.take()) {
            // It does not panic; should it, there is nobody to tell.
            let _ = thread.join();
        }
    }
}

/// A session with a tool on a simulated clock, in one thread.
#[derive(Debug)]
pub struct ArticulatedLockstep {
    haptic: ArticulatedLoop,
    contacts: [ContactLoop; 2],
    /// s.
    period: f64,
    query_period: f64,
    latency: f64,
    steps: u64,
    queries: u64,
    /// What queries gave, with when it arrives, s.
    pending: VecDeque<(f64, [ContactUpdate; 2])>,
}

impl ArticulatedLockstep {
    /// A haptic step of a period, device and gripper (rad) being in a state at its end.
    ///
    /// Query k of both bodies starts at k / rate and sees the newest state of that time; its result is in use from the first haptic step
    /// that is the latency later. The records depend on nothing but the arguments. Contact steps allocate while their workspaces grow.
    pub fn step(&mut self, device: &DeviceState, gripper_angle: f64) -> ArticulatedRecord {
        let (seen, now) = (self.steps as f64 * self.period, (self.steps + 1) as f64 * self.period);
        // Absorbs the rounding of products of periods.
        let slack = 1e-6 * self.period;
        let start = self.queries as f64 * self.query_period;
        if start < now - slack {
            let [first, second] = &mut self.contacts;
            let updates = [
                first.step(&self.haptic.body_state(ToolBody::First), seen),
                second.step(&self.haptic.body_state(ToolBody::Second), seen),
            ];
            self.pending.push_back((start + self.latency, updates));
            self.queries += 1;
        }
        while let Some((_, updates)) = self.pending.pop_front_if(|(arrival, _)| *arrival <= now + slack) {
            for (body, update) in BODIES.into_iter().zip(&updates) {
                self.haptic.update_contacts(body, update);
            }
        }
        self.steps += 1;
        self.haptic.step(device, gripper_angle, now, self.period)
    }

    /// Period of a step, s.
    pub fn period(&self) -> f64 {
        self.period
    }

    /// The haptic loop.
    pub fn haptic(&self) -> &ArticulatedLoop {
        &self.haptic
    }

    /// Holds the clutch, or lets it go ([`ArticulatedLoop::set_clutch`]).
    pub fn set_clutch(&mut self, held: bool) {
        self.haptic.set_clutch(held);
    }

    /// What happened out of the ordinary in both loops.
    pub fn events(&self) -> Events {
        let [first, second] = &self.contacts;
        self.haptic.telemetry().events.and(&first.telemetry().events).and(&second.telemetry().events)
    }
}
