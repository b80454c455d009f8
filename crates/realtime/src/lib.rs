//! What a thread asks of the operating system to be on time.
//!
//! A session has three kinds of threads that time matters to ([`Role`]). Each asks once, before its loop, with [`set_up`]; the
//! process asks once for its memory, with [`lock_memory`]. Nothing of it is needed to render: what is refused is reported as an
//! [`Outcome`], with the remedy, and the thread goes on without it. All of it is asked for on Linux alone, but for the stack
//! and denormal numbers.
//!
//! | | device | haptic | contact |
//! |---|---|---|---|
//! | scheduling | SCHED_FIFO 85 | SCHED_FIFO 80 | normal |
//! | processors, where four or more are allowed | the last two | the last two | the others |
//! | timer slack | 1 ns | 1 ns | 1 ns |
//! | first bytes of the stack touched | yes | yes | yes |
//! | denormal numbers flushed | yes | yes | no |
//!
//! **Device above haptic.** The device's thread carries what the haptic thread computed to the device, and its watchdog takes
//! back what is not renewed. It runs for a small part of a period: the haptic thread can spare that, where the device cannot
//! spare the haptic thread's step.
//!
//! **Contact at normal priority.** A contact thread looks for contacts without end. Under SCHED_FIFO it would take a processor
//! from every program with normal priority, and two of them (a tool of two bodies) a whole machine of two; Linux would then
//! stop them, and the haptic thread with them, for 50 ms a second. Nor SCHED_BATCH: it would wait for other programs' time
//! slices when a new state of the body comes, and models would be older. A contact thread that inherits SCHED_FIFO from the
//! thread that started it gives it back.
//!
//! **The last two processors.** Interrupts are served by the first ones as a rule. Device and haptic thread share two, so that
//! neither waits for a processor of its own while another is free.
//!
//! **Denormal numbers.** A filter that decays towards zero comes to numbers below 2.2e-308, which many processors compute with
//! much slower; device and haptic thread have such filters and take such numbers as zero. A contact query has none,
//! and the threads that it divides its work among, which others may use, would inherit the mode.

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

/// What a thread does in a session.
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
    /// The SCHED_FIFO priority that a thread of this role asks for; none where it is scheduled as usual.
    pub const fn priority(self) -> Option<u8> {
        match self {
            Self::Device => Some(85),
            Self::Haptic => Some(80),
            Self::Contact => None,
        }
    }
}

/// What a thread asked for, and what came of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ThreadSetup {
    /// What the thread does.
    pub role: Role,
    /// Its scheduling class and priority.
    pub scheduling: Outcome,
    /// The processors that it runs on.
    pub processors: Outcome,
    /// How late a timer may wake it for the sake of others.
    pub timer_slack: Outcome,
    /// Its stack, touched before it is needed.
    pub stack: Outcome,
    /// Denormal numbers, taken as zero.
    pub denormals: Outcome,
}

impl ThreadSetup {
    /// What was asked for, with the name of each.
    pub fn outcomes(&self) -> [(&'static str, &Outcome); 5] {
        [
            ("scheduling", &self.scheduling),
            ("processors", &self.processors),
            ("timer slack", &self.timer_slack),
            ("stack", &self.stack),
            ("denormal numbers", &self.denormals),
        ]
    }

    /// How the thread is scheduled, in a line: the class and the priority, or `normal` and why no better.
    pub fn scheduling_line(&self) -> String {
        match self.scheduling.state {
            State::Granted => self.scheduling.to_string(),
            State::Refused | State::NotAsked => format!("normal: {}", self.scheduling),
        }
    }
}

/// Sets up the calling thread for its role, for as long as it lives: call it once, before the loop. It makes system calls and
/// allocates, and needs 256 KiB of stack; it never fails.
pub fn set_up(role: Role) -> ThreadSetup {
    // The slack first: Linux takes no other for a thread under SCHED_FIFO.
    let timer_slack = scheduling::ask_for_exact_timers();
    let scheduling = scheduling::ask(role);
    let realtime = scheduling.state == State::Granted;
    ThreadSetup {
        role,
        processors: affinity::ask(role, realtime),
        timer_slack,
        stack: memory::touch_stack(),
        denormals: if role == Role::Contact {
            Outcome::not_asked("kept: the threads that it divides its work among would inherit the mode")
        } else {
            denormals::flush()
        },
        scheduling,
    }
}
