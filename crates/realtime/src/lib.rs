//! Real-time setup of threads: scheduling, processors, timers, stack and memory.
//!
//! A session has three kinds of threads with deadlines ([`Role`]). Each makes its requests to the operating
//! system once, before its loop, with [`set_up`]; the process locks its memory once, with [`lock_memory`].
//! None of this is required to render: a refusal is reported as an [`Outcome`] with a remedy, and the thread
//! continues without it. Apart from the stack and denormal numbers, requests are made on Linux only.
//!
//! | | device | haptic | contact |
//! |---|---|---|---|
//! | scheduling | SCHED_FIFO 85 | SCHED_FIFO 80 | normal |
//! | processors, if four or more are allowed | the last two | the last two | the others |
//! | timer slack | 1 ns | 1 ns | 1 ns |
//! | first bytes of the stack touched | yes | yes | yes |
//! | denormal numbers flushed | yes | yes | no |
//!
//! **Device above haptic.** The device's thread sends the haptic thread's wrench to the device, and its
//! watchdog withdraws a wrench that is not renewed. It runs for a small part of a period, which the haptic
//! thread can spare. The device cannot wait for a whole haptic step.
//!
//! **Contact at normal priority.** A contact thread runs without a pause. Under SCHED_FIFO it would take a
//! processor from every program with normal priority, and two contact threads (a tool of two bodies) all of a
//! machine with two. Linux would then throttle them, and the haptic thread with them, for 50 ms every second.
//! SCHED_BATCH is not suitable either: on a new state of the body the thread would wait for other programs'
//! time slices, and contact models would be older. A contact thread that inherits SCHED_FIFO from its parent
//! returns to normal scheduling.
//!
//! **The last two processors.** Interrupts usually go to the first ones. The device and haptic threads share
//! two, so that neither waits for its own processor while the other one is free.
//!
//! **Denormal numbers.** A filter that decays towards zero reaches numbers below 2.2e-308, with which many
//! processors compute much slower. The device and haptic threads have such filters and treat such numbers as
//! zero. Contact queries have none, and their worker threads, which may be shared, would inherit the mode.

mod affinity;
#[expect(unsafe_code, reason = "the floating-point control register has no other access")]
mod denormals;
mod memory;
mod outcome;
mod scheduling;

use serde::Serialize;

pub use memory::{lock_memory, locked_bytes};
pub use outcome::{Outcome, State};
pub use scheduling::{priority_limit, realtime_priority};

/// Role of a thread in a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Exchanges reports with a device.
    Device,
    /// Takes haptic steps.
    Haptic,
    /// Finds contacts.
    Contact,
}

impl Role {
    /// Returns the SCHED_FIFO priority that a thread of this role requests; `None` for normal scheduling.
    pub const fn priority(self) -> Option<u8> {
        match self {
            Self::Device => Some(85),
            Self::Haptic => Some(80),
            Self::Contact => None,
        }
    }
}

/// Requests of a thread and their outcomes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ThreadSetup {
    /// Role of the thread.
    pub role: Role,
    /// Scheduling class and priority.
    pub scheduling: Outcome,
    /// Processors that the thread may run on.
    pub processors: Outcome,
    /// Timer slack: by how much the system may delay a wake-up to combine it with others.
    pub timer_slack: Outcome,
    /// Stack, touched before it is used.
    pub stack: Outcome,
    /// Flushing of denormal numbers to zero.
    pub denormals: Outcome,
}

impl ThreadSetup {
    /// Returns all outcomes with their names.
    pub fn outcomes(&self) -> [(&'static str, &Outcome); 5] {
        [
            ("scheduling", &self.scheduling),
            ("processors", &self.processors),
            ("timer slack", &self.timer_slack),
            ("stack", &self.stack),
            ("denormal numbers", &self.denormals),
        ]
    }

    /// Describes the thread's scheduling in a line: class and priority, or `normal` and the reason.
    pub fn scheduling_line(&self) -> String {
        match self.scheduling.state {
            State::Granted => self.scheduling.to_string(),
            State::Refused | State::NotAsked => format!("normal: {}", self.scheduling),
        }
    }
}

/// Sets up the calling thread for its role. Call it once, before the loop. It makes system calls, allocates,
/// and needs 256 KiB of stack; it never fails.
pub fn set_up(role: Role) -> ThreadSetup {
    // The slack comes first: Linux ignores it for a thread under SCHED_FIFO.
    let timer_slack = scheduling::ask_for_exact_timers();
    let scheduling = scheduling::ask(role);
    let realtime = scheduling.state == State::Granted;
    ThreadSetup {
        role,
        processors: affinity::ask(role, realtime),
        timer_slack,
        stack: memory::touch_stack(),
        denormals: if role == Role::Contact {
            Outcome::not_asked("kept: its worker threads would inherit the mode")
        } else {
            denormals::flush()
        },
        scheduling,
    }
}
