//! What goes out to the device of the wrench that is wanted: within what its actuators stand, no faster than may be, and nothing
//! where it would hurt. It is the last stage before the driver, and the same for every kind of tool.

use palpate_core::Wrench;
use palpate_core::glam::DVec3;
use palpate_device::{Axes, Specification};
use palpate_dynamics::{PassivityController, SlewLimit, saturate};

use crate::haptic::heat::Heat;
use crate::haptic::invariants::{Bounds, HARMLESS_SHARE, Invariants, RUNAWAY_SPEED, Write, energy_bound};
use crate::haptic::tracking::Tracking;
use crate::scene::placement::renders;
use crate::settings::SLEW_TIME;
use crate::telemetry::Events;

/// Periods that a wrench may grow over in one write, however late that is.
const MOST_GROWTH: f64 = 2.0;

/// Below this part of the peak a wrench shrinks as fast as is wanted.
const FREE_SHARE: f64 = 0.2;

/// Part of the [energy bound](ENERGY_BOUND) at which the wrench is let go of.
const ENERGY_SHARE: f64 = 0.5;

/// What the device can render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Limits {
    /// N.
    pub force: f64,
    /// N·m.
    pub torque: f64,
    pub actuated: Axes,
    /// Whether anything reaches the hand.
    pub renders: bool,
}

impl Limits {
    pub fn of(specification: &Specification) -> Self {
        let Specification { peak_force, peak_torque, actuated, .. } = *specification;
        let renders = renders(specification);
        Self { force: peak_force, torque: peak_torque, actuated, renders }
    }

    /// The wrench as far as the device can render it now, and whether its actuators are too weak for it.
    fn fit(&self, wanted: &Wrench, (force_limit, torque_limit): (f64, f64)) -> (Wrench, bool) {
        let force = DVec3::select(self.actuated.translation.into(), wanted.force, DVec3::ZERO);
        let torque = DVec3::select(self.actuated.rotation.into(), wanted.torque, DVec3::ZERO);
        let actuated = Wrench::new(force, torque);
        let sent = saturate(&actuated, force_limit, torque_limit);
        (sent, sent != actuated)
    }
}

/// The way out to the device.
#[derive(Clone, Debug)]
pub(crate) struct Output {
    limits: Limits,
    slew: SlewLimit,
    /// How fast the wrench may shrink: no slower than the peak in 10 ms, whatever the slew.
    falling: SlewLimit,
    heat: [Heat; 2],
    pub passivity: PassivityController,
    /// The same account, begun anew where nothing is held: by it the wrench is let go of.
    account: PassivityController,
    /// Energy that may come out beyond what was stored before the wrench is let go of, and the most that was stored since it was
    /// last zero, J.
    most_created: f64,
    most_stored: f64,
    /// Period of the loop, s.
    period: f64,
    /// The wrench that the device holds, as far as known.
    sent: Wrench,
    invariants: Invariants,
}

/// What else is known when a wrench goes out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment {
    /// What is integrated in this step, and the time since the last, s.
    pub dt: f64,
    pub elapsed: f64,
    /// Share of the wrench that is sent, 0 to 1.
    pub share: f64,
    /// Whether something has failed, so that nothing is to be sent; how long contact models have been overdue, s, negative if they
    /// are not; and whether the wrench comes up from nothing.
    pub faulty: bool,
    pub overdue: f64,
    pub released: bool,
    /// Most that what is rendered may give back, J at the device.
    pub stored: f64,
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
            most_created: ENERGY_SHARE * energy_bound(specification),
            most_stored: 0.0,
            period,
            sent: Wrench::ZERO,
            invariants: Invariants::new(bounds),
        };
        output.set_slew(slew);
        output
    }

    /// Changes how fast the wrench may change.
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

    /// What was checked so far.
    pub fn invariants(&self) -> &Invariants {
        &self.invariants
    }

    /// The device holds nothing: it was lost, or its driver has taken back what it was asked for.
    pub fn forget(&mut self) {
        self.sent = Wrench::ZERO;
        self.passivity.hold(&Wrench::ZERO);
        self.account.hold(&Wrench::ZERO);
        self.invariants.forget();
    }

    /// Counts the energy that flowed with the handle's motion since the last write. `stored` is the most (J) that may come back.
    pub fn observe(&mut self, tracking: &Tracking, stored: f64) {
        self.passivity.observe(tracking.displacement(), stored);
        self.account.observe(tracking.displacement(), stored);
    }

    /// Takes energy (J) that flowed in at another port, before [`Self::observe`].
    pub fn exchange(&mut self, energy: f64) {
        self.passivity.exchange(energy);
        self.account.exchange(energy);
    }

    /// Whether what the device has held for the time that has `elapsed` (s) must be let go of at once: the handle runs along it
    /// faster than a hand would let it, or it has given more energy than it may with what is `stored` (J).
    ///
    /// To be asked after [`Self::observe`].
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
        self.most_stored = self.most_stored.max(stored);
        if self.sent == Wrench::ZERO {
            self.most_stored = stored;
            self.account.restart();
        }
        let created = self.account.created() > self.most_created + self.most_stored;
        events.runaway += u64::from(runaway);
        events.energy_created += u64::from(created);
        if created {
            self.passivity.forgive();
        }
        runaway || created
    }

    /// Sends as much of a wanted wrench (device axes) as may be.
    pub fn send(&mut self, wanted: &Wrench, tracking: &Tracking, at: &Moment, events: &mut Events) -> Wrench {
        let damping = self.passivity.damping(&tracking.damped_state().twist, at.dt);
        let [force, torque] = self.heat.map(|heat| heat.allowed());
        let limits = (force.min(self.limits.force * at.share), torque.min(self.limits.torque * at.share));
        let (fitting, limited) = self.limits.fit(&(*wanted * at.share + damping), limits);
        let free = (FREE_SHARE * self.limits.force, FREE_SHARE * self.limits.torque);
        let unloaded = self.falling.unload(&self.sent, &fitting, at.elapsed, free);
        let sent = self.slew.approach(&unloaded, &fitting, at.dt.min(MOST_GROWTH * self.period));
        events.damped += u64::from(damping != Wrench::ZERO);
        events.saturated += u64::from(limited);
        events.hot += u64::from(self.heat.iter().any(|heat| heat.is_hot()));
        events.slewed += u64::from(sent != fitting);
        self.hold(sent, tracking, at)
    }

    /// Lets the wrench fall as fast as it may: it is not wanted.
    pub fn let_go(&mut self, tracking: &Tracking, at: &Moment) -> Wrench {
        let rest = self.passivity.rest();
        let sent = self.falling.unload(&self.sent, &rest, at.elapsed, (0.0, 0.0));
        self.hold(sent, tracking, at)
    }

    /// Sends nothing, at once.
    pub fn drop(&mut self, tracking: &Tracking, at: &Moment) -> Wrench {
        let rest = self.passivity.rest();
        self.hold(rest, tracking, at)
    }

    fn hold(&mut self, sent: Wrench, tracking: &Tracking, at: &Moment) -> Wrench {
        self.invariants.check(&Write {
            wrench: sent,
            dt: at.dt,
            elapsed: at.elapsed,
            displacement: *tracking.displacement(),
            faulty: at.faulty,
            overdue: at.overdue,
            released: at.released,
            stored: at.stored,
        });
        debug_assert!(self.invariants.broken() == 0, "{}", self.invariants);
        self.heat[0].pass(self.sent.force.length(), at.elapsed);
        self.heat[1].pass(self.sent.torque.length(), at.elapsed);
        self.sent = sent;
        self.passivity.hold(&sent);
        self.account.hold(&sent);
        sent
    }
}
