//! The output stage, the last before the driver: it limits the wanted wrench to the device's peaks and heat,
//! limits its rate, and drops it where it would harm. It is the same for every kind of tool.

use palpate_core::Wrench;
use palpate_core::glam::DVec3;
use palpate_device::{Axes, Specification};
use palpate_dynamics::{PassivityController, SlewLimit, saturate};

use crate::haptic::heat::{Heat, HeatingTime};
use crate::haptic::invariants::{Bounds, HARMLESS_SHARE, Invariants, Moment, RUNAWAY_SPEED, energy_bound};
use crate::haptic::tracking::Tracking;
use crate::scene::placement::renders;
use crate::settings::SLEW_TIME;
use crate::telemetry::Events;

/// Largest time, in periods, that a wrench grows over in one write. With more, a late write steps the force.
const MAX_GROWTH_PERIODS: f64 = 2.0;

/// Fraction of the peak below which a wrench may shrink at once. With more, the hand feels the step.
const FREE_SHARE: f64 = 0.2;

/// Fraction of the [energy bound](super::invariants::ENERGY_BOUND) at which the wrench is dropped. With more,
/// the energy of the time until it has fallen exceeds the bound.
const ENERGY_SHARE: f64 = 0.5;

/// Limits of what the device can render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Limits {
    /// Peak force, N.
    pub force: f64,
    /// Peak torque, N·m.
    pub torque: f64,
    pub actuated: Axes,
    /// Whether the device renders any force or torque.
    pub renders: bool,
}

impl Limits {
    pub fn of(specification: &Specification) -> Self {
        let Specification { peak_force, peak_torque, actuated, .. } = *specification;
        let renders = renders(specification);
        Self { force: peak_force, torque: peak_torque, actuated, renders }
    }

    /// Returns the part of a wrench on the actuated axes, limited to a force (N) and a torque (N·m), and
    /// whether it was limited.
    fn fit(&self, wanted: &Wrench, (force_limit, torque_limit): (f64, f64)) -> (Wrench, bool) {
        let force = DVec3::select(self.actuated.translation.into(), wanted.force, DVec3::ZERO);
        let torque = DVec3::select(self.actuated.rotation.into(), wanted.torque, DVec3::ZERO);
        let actuated = Wrench::new(force, torque);
        let sent = saturate(&actuated, force_limit, torque_limit);
        (sent, sent != actuated)
    }
}

/// The output stage.
#[derive(Clone, Debug)]
pub(crate) struct Output {
    limits: Limits,
    slew: SlewLimit,
    /// Rate at which the wrench may shrink: at least the peak in 10 ms, whatever the slew.
    falling: SlewLimit,
    heat: [Heat; 2],
    pub passivity: PassivityController,
    /// Energy account since the wrench was last zero, by which the wrench is dropped.
    account: PassivityController,
    /// Energy beyond the stored one that may come out before the wrench is dropped, J.
    max_created: f64,
    /// Largest energy that was stored since the wrench was last zero, J.
    max_stored: f64,
    /// Period of the loop, s.
    period: f64,
    /// The wrench that the device holds, as far as known.
    sent: Wrench,
    invariants: Invariants,
}

impl Output {
    pub fn new(
        specification: &Specification,
        slew: SlewLimit,
        max_damping: (f64, f64),
        engagement: f64,
        period: f64,
    ) -> Self {
        let Specification { peak_force, peak_torque, continuous_force, continuous_torque, .. } =
            *specification;
        let steps = (specification.encoder_step, specification.angular_encoder_step);
        let bounds = Bounds::of(specification, slew, engagement);
        let mut output = Self {
            limits: Limits::of(specification),
            slew,
            falling: slew,
            heat: [Heat::new(continuous_force, peak_force), Heat::new(continuous_torque, peak_torque)],
            passivity: PassivityController::new(max_damping, steps),
            account: PassivityController::new((0.0, 0.0), steps),
            max_created: ENERGY_SHARE * energy_bound(specification),
            max_stored: 0.0,
            period,
            sent: Wrench::ZERO,
            invariants: Invariants::new(bounds),
        };
        output.set_slew(slew);
        output
    }

    /// Sets the limit of the wrench's rate of change.
    pub fn set_slew(&mut self, slew: SlewLimit) {
        let faster = |slew: f64, peak: f64| if peak > 0.0 { slew.max(peak / SLEW_TIME) } else { slew };
        self.slew = slew;
        self.falling = SlewLimit {
            force: faster(slew.force, self.limits.force),
            torque: faster(slew.torque, self.limits.torque),
        };
        self.invariants.set_slew(slew);
    }

    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// The checks of all writes so far.
    pub fn invariants(&self) -> &Invariants {
        &self.invariants
    }

    /// Takes the device's wrench to be zero: it was lost, or its driver has sent zero itself.
    pub fn forget(&mut self) {
        self.sent = Wrench::ZERO;
        self.passivity.hold(&Wrench::ZERO);
        self.account.hold(&Wrench::ZERO);
        self.invariants.forget();
    }

    /// Accounts for the energy of the handle's motion since the last write. `stored` is the largest energy
    /// (J) that may come back.
    pub fn observe(&mut self, tracking: &Tracking, stored: f64) {
        self.passivity.observe(tracking.displacement(), stored);
        self.account.observe(tracking.displacement(), stored);
    }

    /// Accounts for energy (J) that flowed in at another port; called before [`Self::observe`].
    pub fn exchange(&mut self, energy: f64) {
        self.passivity.exchange(energy);
        self.account.exchange(energy);
    }

    /// Whether the wrench that the device has held for the time `elapsed` (s) must be dropped at once: the
    /// handle runs along it faster than a hand would let it, or it gave more energy than allowed with
    /// `stored` (J).
    ///
    /// Called after [`Self::observe`].
    pub fn is_harmful(
        &mut self,
        tracking: &Tracking,
        (stored, elapsed): (f64, f64),
        events: &mut Events,
    ) -> bool {
        let displacement = tracking.displacement();
        let peaks = (self.limits.force, self.limits.torque);
        let runs = |held: DVec3, peak: f64, moved: DVec3, fastest: f64| {
            let size = held.length();
            size > HARMLESS_SHARE * peak && moved.dot(held) > fastest * elapsed * size
        };
        let runaway = runs(self.sent.force, peaks.0, displacement.linear, RUNAWAY_SPEED.0)
            || runs(self.sent.torque, peaks.1, displacement.angular, RUNAWAY_SPEED.1);
        self.max_stored = self.max_stored.max(stored);
        if self.sent == Wrench::ZERO {
            self.max_stored = stored;
            self.account.restart();
        }
        let created = self.account.created() > self.max_created + self.max_stored;
        events.runaway += u64::from(runaway);
        events.energy_created += u64::from(created);
        if created {
            self.passivity.forgive();
        }
        runaway || created
    }

    /// Sends a wanted wrench (device axes) with the controller's damping, within all limits: first the share,
    /// heat and peak limit its size, then it shrinks towards the result as fast as allowed, then it grows and
    /// turns within the slew.
    pub fn send(&mut self, wanted: &Wrench, tracking: &Tracking, at: &Moment, events: &mut Events) -> Wrench {
        let damping = self.passivity.damping(&tracking.damped_state().twist, at.dt);
        let [force, torque] = self.heat.map(|heat| heat.allowed());
        let limits = (force.min(self.limits.force * at.share), torque.min(self.limits.torque * at.share));
        let (fitting, limited) = self.limits.fit(&(*wanted * at.share + damping), limits);
        let free = (FREE_SHARE * self.limits.force, FREE_SHARE * self.limits.torque);
        let unloaded = self.falling.unload(&self.sent, &fitting, at.elapsed, free);
        let sent = self.slew.approach(&unloaded, &fitting, at.dt.min(MAX_GROWTH_PERIODS * self.period));
        events.damped += u64::from(damping != Wrench::ZERO);
        events.saturated += u64::from(limited);
        events.hot += u64::from(self.heat.iter().any(|heat| heat.is_hot()));
        events.slewed += u64::from(sent != fitting);
        self.hold(sent, tracking, at)
    }

    /// Lets the wrench fall to zero as fast as allowed.
    pub fn let_go(&mut self, tracking: &Tracking, at: &Moment) -> Wrench {
        let rest = self.passivity.rest();
        let sent = self.falling.unload(&self.sent, &rest, at.elapsed, (0.0, 0.0));
        self.hold(sent, tracking, at)
    }

    /// Drops the wrench to zero at once.
    pub fn drop(&mut self, tracking: &Tracking, at: &Moment) -> Wrench {
        let rest = self.passivity.rest();
        self.hold(rest, tracking, at)
    }

    /// Checks a wrench and accounts for it as the one that the device holds from now on.
    fn hold(&mut self, sent: Wrench, tracking: &Tracking, at: &Moment) -> Wrench {
        self.invariants.check(&sent, tracking.displacement(), at);
        debug_assert!(self.invariants.broken() == 0, "{}", self.invariants);
        let time = HeatingTime::new(at.elapsed);
        self.heat[0].pass(self.sent.force.length(), &time);
        self.heat[1].pass(self.sent.torque.length(), &time);
        self.sent = sent;
        self.passivity.hold(&sent);
        self.account.hold(&sent);
        sent
    }
}
