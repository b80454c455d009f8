//! The share of the wrench that is sent: less than all while contact models are overdue, after events that
//! would let a force appear at once, and before the end of the session.

/// Longest time in which the wrench fades out, s, after contact models are overdue or when the session ends.
/// With more, the hand feels contacts that no longer exist.
pub(crate) const FADE: f64 = 0.05;

/// The shares that the wrench is multiplied by. All change in time between 0 and 1, along a smooth curve.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Presence {
    /// Share by the contact models: falls while they are overdue, or were found far from the object's
    /// present pose.
    fresh: f64,
    /// Share by the engagement: rises after the start and after a failure of the device or the step, falls
    /// while the clutch is held.
    engaged: f64,
    /// Share by the session's end: falls before it.
    staying: f64,
    leaving: bool,
    /// Age of a contact model at which the wrench begins to fade, s.
    timeout: f64,
    /// Time in which it fades, s.
    fade: f64,
    /// Time in which the wrench comes up, s.
    engagement: f64,
}

impl Presence {
    /// Starts with a share of 0.
    pub fn new(timeout: f64, engagement: f64) -> Self {
        let fade = timeout.min(FADE);
        Self { fresh: 1.0, engaged: 0.0, staying: 1.0, leaving: false, timeout, fade, engagement }
    }

    /// Advances by `dt` seconds with contact models `waited` seconds old: the share is 1 until the timeout
    /// and 0 a [`FADE`] later. Likewise for the distance `strayed` of the object from where they were found,
    /// in distances that they are valid for: the share is 1 up to 1 and 0 from 2 on. The wrench comes up over
    /// the engagement time, or goes down while the clutch is held.
    pub fn pass(&mut self, waited: f64, strayed: f64, clutched: bool, dt: f64) {
        let allowed = (1.0 - (waited - self.timeout) / self.fade).min(2.0 - strayed);
        self.fresh = (self.fresh + dt / self.fade).min(allowed).clamp(0.0, 1.0);
        let change = if self.engagement > 0.0 { dt / self.engagement } else { 1.0 };
        self.engaged = (self.engaged + if clutched { -change } else { change }).clamp(0.0, 1.0);
        if self.leaving {
            self.staying = (self.staying - dt / FADE).max(0.0);
        }
    }

    /// Age of a contact model at which the wrench begins to fade, s.
    pub fn timeout(&self) -> f64 {
        self.timeout
    }

    /// Sets the share to 0; it comes up from there.
    pub fn release(&mut self) {
        self.engaged = 0.0;
    }

    /// Fades the wrench out for the rest of the session.
    pub fn leave(&mut self) {
        self.leaving = true;
    }

    /// Whether the wrench is reduced because contact models are or were overdue, or were found elsewhere.
    pub fn fading(&self) -> bool {
        self.fresh < 1.0
    }

    /// Time since contact models `waited` seconds old are overdue, s; negative if they are not.
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

/// Smooth step x² (3 − 2 x): from 0 at 0 to 1 at 1 with no slope at either end.
pub(crate) fn smooth(x: f64) -> f64 {
    x * x * (3.0 - 2.0 * x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_never_steps_except_at_a_failure() {
        let mut presence = Presence::new(0.1, 0.2);
        let (dt, mut waited, mut last) = (1e-3, 0.0, 0.0);
        let (mut lowest, mut highest) = (1.0_f64, 0.0_f64);
        for step in 0..3200 {
            // Models stop at 0.5 s and resume at 1 s; the clutch is held from 1.5 s to 1.6 s and from 2 s to
            // 2.5 s; the object strays at 2.7 s, and the session begins to end at 3.1 s.
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
