//! How much of the wrench is sent: all of it, or less while contact models are overdue, after anything that would let a force
//! appear at once, and before the end.

/// The longest time that the wrench takes to fade out, s, once contact models are overdue or the session ends.
pub(crate) const FADE: f64 = 0.05;

/// The shares that the wrench is faded by. All go in time from 0 to 1 and back, along a smooth curve.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Presence {
    /// Falls while contact models are overdue, or were found far from where the object now is.
    fresh: f64,
    /// Rises after the start and after the device or the step has failed; falls while the clutch is held.
    engaged: f64,
    /// Falls before the end.
    staying: f64,
    leaving: bool,
    /// Age of a contact model from which the wrench fades, and how long that takes, s.
    timeout: f64,
    fade: f64,
    /// Time in which the wrench comes up, s.
    engagement: f64,
}

impl Presence {
    /// Nothing is sent yet.
    pub fn new(timeout: f64, engagement: f64) -> Self {
        let fade = timeout.min(FADE);
        Self { fresh: 1.0, engaged: 0.0, staying: 1.0, leaving: false, timeout, fade, engagement }
    }

    /// Passes `dt` seconds with contact models `waited` seconds old: all of the wrench while that is less than the timeout, and
    /// nothing a [`FADE`] later. Likewise for the part `strayed` that the object has gone of how far contact models hold: all up
    /// to 1, nothing from 2 on. The wrench comes up over the time of engagement, or goes down while the clutch is held.
    pub fn pass(&mut self, waited: f64, strayed: f64, clutched: bool, dt: f64) {
        let allowed = (1.0 - (waited - self.timeout) / self.fade).min(2.0 - strayed);
        self.fresh = (self.fresh + dt / self.fade).min(allowed).clamp(0.0, 1.0);
        let change = if self.engagement > 0.0 { dt / self.engagement } else { 1.0 };
        self.engaged = (self.engaged + if clutched { -change } else { change }).clamp(0.0, 1.0);
        if self.leaving {
            self.staying = (self.staying - dt / FADE).max(0.0);
        }
    }

    /// Nothing more is sent, and it comes up from there.
    pub fn release(&mut self) {
        self.engaged = 0.0;
    }

    /// The end is near: the wrench fades out, for good.
    pub fn leave(&mut self) {
        self.leaving = true;
    }

    /// Whether contact models are, or lately were, overdue or of elsewhere.
    pub fn fading(&self) -> bool {
        self.fresh < 1.0
    }

    /// How long contact models `waited` seconds old have been overdue, s; negative if they are not.
    pub fn overdue(&self, waited: f64) -> f64 {
        waited - self.timeout
    }

    /// Whether the wrench is coming up, or down for the clutch.
    pub fn engaging(&self) -> bool {
        self.engaged < 1.0
    }

    /// The share of the wrench to send.
    pub fn share(&self) -> f64 {
        smooth(self.fresh) * smooth(self.engaged) * smooth(self.staying)
    }
}

/// From 0 at 0 to 1 at 1 with no slope at either.
pub(crate) fn smooth(x: f64) -> f64 {
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
        for step in 0..3200 {
            // Models stop at 0.5 s and come again at 1 s; the clutch is held from 1.5 s to 1.6 s and at 2 s; the object strays at
            // 2.7 s, and the end is at 3.1 s.
            waited = if (500..1000).contains(&step) { waited + dt } else { 0.0 };
            let strayed = if (2700..2900).contains(&step) { 0.02 * f64::from(step - 2700) } else { 0.0 };
            if step == 3100 {
                presence.leave();
            }
            presence.pass(waited, strayed, (1500..1600).contains(&step) || (2000..2500).contains(&step), dt);
            let share = presence.share();
            assert!((share - last).abs() <= 1.5 * dt / FADE + 1e-12, "step {step}: {last} to {share}");
            if step > 300 {
                (lowest, highest) = (lowest.min(share), highest.max(share));
            }
            if [660, 2050, 2850, 3151].contains(&step) {
                assert!(step == 2050 || share == 0.0, "step {step}: {share}");
            }
            if [499, 1499, 1999, 2699, 3099].contains(&step) {
                assert_eq!(share, 1.0, "step {step}");
            }
            last = share;
        }
        assert_eq!((lowest, highest, last), (0.0, 1.0, 0.0));
        presence.release();
        assert_eq!(presence.share(), 0.0);
    }
}
