//! How much of the wrench is sent: all of it, or less while contact models are overdue, and after anything that would
//! let a force appear at once.

/// The shares that the wrench is faded by. Both go in time from 0 to 1 and back, along a smooth curve.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Presence {
    /// Falls while contact models are overdue.
    fresh: f64,
    /// Rises after the start and after the device or the step has failed; falls while the clutch is held.
    engaged: f64,
    /// Age of a contact model from which the wrench fades, s.
    timeout: f64,
    /// Time in which the wrench comes up, s.
    engagement: f64,
}

impl Presence {
    /// Nothing is sent yet.
    pub fn new(timeout: f64, engagement: f64) -> Self {
        Self { fresh: 1.0, engaged: 0.0, timeout, engagement }
    }

    /// Passes `dt` seconds with contact models `waited` seconds old: all of the wrench while that is less than the
    /// timeout, nothing from twice the timeout on, and back over the length of the timeout. Likewise the wrench comes
    /// up over the time of engagement, or goes down while the clutch is held.
    pub fn pass(&mut self, waited: f64, clutched: bool, dt: f64) {
        let allowed = 2.0 - waited / self.timeout;
        self.fresh = (self.fresh + dt / self.timeout).min(allowed).clamp(0.0, 1.0);
        let change = if self.engagement > 0.0 { dt / self.engagement } else { 1.0 };
        self.engaged = (self.engaged + if clutched { -change } else { change }).clamp(0.0, 1.0);
    }

    /// Nothing more is sent, and it comes up from there.
    pub fn release(&mut self) {
        self.engaged = 0.0;
    }

    /// Whether contact models are, or lately were, overdue.
    pub fn fading(&self) -> bool {
        self.fresh < 1.0
    }

    /// Whether the wrench is coming up, or down for the clutch.
    pub fn engaging(&self) -> bool {
        self.engaged < 1.0
    }

    /// The share of the wrench to send.
    pub fn share(&self) -> f64 {
        smooth(self.fresh) * smooth(self.engaged)
    }
}

/// From 0 at 0 to 1 at 1 with no slope at either.
fn smooth(x: f64) -> f64 {
    x * x * (3.0 - 2.0 * x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_never_steps_whatever_happens_but_a_failure() {
        let mut presence = Presence::new(0.1, 0.2);
        let (dt, mut waited, mut last) = (1e-3, 0.0, 0.0);
        let (mut lowest, mut highest) = (1.0_f64, 0.0_f64);
        for step in 0..3000 {
            // Models stop at 0.5 s and come again at 1 s; the clutch is held from 1.5 s to 1.6 s and at 2 s.
            waited = if (500..1000).contains(&step) { waited + dt } else { 0.0 };
            presence.pass(waited, (1500..1600).contains(&step) || (2000..2500).contains(&step), dt);
            let share = presence.share();
            assert!((share - last).abs() <= 1.5 * dt / 0.1 + 1e-12, "step {step}: {last} to {share}");
            if step > 300 {
                (lowest, highest) = (lowest.min(share), highest.max(share));
            }
            last = share;
        }
        assert_eq!((lowest, highest, last), (0.0, 1.0, 1.0));
        presence.release();
        assert_eq!(presence.share(), 0.0);
    }
}
