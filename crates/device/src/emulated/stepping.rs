//! Time and commands of an emulation, in whole substeps.

use std::collections::VecDeque;

/// The substeps of an emulation, counted from the driver's time 0.
#[derive(Clone, Debug)]
pub(super) struct Substeps {
    /// Length of a substep, s.
    pub length: f64,
    /// Largest number of substeps simulated at once.
    max_at_once: u64,
    /// Substeps so far, and how many of them were left out.
    pub count: u64,
    pub skipped: u64,
}

impl Substeps {
    /// Substeps of a length (s), with at most `catch_up` (s) simulated at once.
    pub fn new(length: f64, catch_up: f64) -> Self {
        Self { length, max_at_once: (catch_up / length).round().max(1.0) as u64, count: 0, skipped: 0 }
    }

    /// The number of substeps to simulate up to the time `now` (s). If that is more than are simulated at
    /// once, the earlier ones are left out, and the second value is true.
    pub fn due(&mut self, now: f64) -> (u64, bool) {
        // A time that is a multiple of the substep may come out one rounding below it. The cast saturates.
        let target = (now / self.length + 1e-6) as u64;
        let steps = target.saturating_sub(self.count);
        if steps <= self.max_at_once {
            return (steps, false);
        }
        self.skipped = self.skipped.saturating_add(steps - self.max_at_once);
        self.count = target - self.max_at_once;
        (self.max_at_once, true)
    }

    /// Time of the last substep, s.
    pub fn time(&self) -> f64 {
        self.count as f64 * self.length
    }

    /// Time without the substeps left out, s: the handle, the hand's path and the delays all pause for those.
    pub fn simulated_time(&self) -> f64 {
        (self.count - self.skipped) as f64 * self.length
    }
}

/// A command that takes effect after a delay.
#[derive(Clone, Debug)]
pub(super) struct Delayed<T> {
    /// The command in effect.
    pub current: T,
    /// Commands not yet in effect, each with the substep in which it is due.
    pub pending: VecDeque<(u64, T)>,
    /// Delay, in substeps.
    delay: u64,
}

impl<T: Copy> Delayed<T> {
    /// A command with a delay (s) in whole substeps of a length (s).
    pub fn new(initial: T, delay: f64, length: f64) -> Self {
        let delay = (delay / length).round() as u64;
        // Room for one command in each substep of the delay, and one written when the first is due.
        Self { current: initial, pending: VecDeque::with_capacity(delay as usize + 1), delay }
    }

    /// Takes a command written in substep `now`. If several are written in one substep, the last one counts.
    pub fn write(&mut self, command: T, now: u64) {
        if self.delay == 0 {
            self.current = command;
            return;
        }
        let due = now + self.delay;
        match self.pending.back_mut() {
            Some((last, pending)) if *last == due => *pending = command,
            _ => self.pending.push_back((due, command)),
        }
    }

    /// Puts commands into effect that are due in substep `now`.
    pub fn arrive(&mut self, now: u64) {
        while let Some((_, command)) = self.pending.pop_front_if(|(due, _)| *due <= now) {
            self.current = command;
        }
    }

    /// Puts a command into effect at once, and drops those not yet in effect.
    pub fn replace(&mut self, command: T) {
        self.pending.clear();
        self.current = command;
    }
}
