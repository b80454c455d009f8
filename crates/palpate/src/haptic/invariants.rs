//! The invariants of every wrench that the engine writes, checked independently at every write.
//!
//! The checks do not depend on how the wrench was computed: they use only the writes before, their times, and
//! the handle's motion. The page "What the engine promises to your hand" (docs/promises.md) states each
//! invariant with its number.

use std::collections::BTreeMap;
use std::fmt;

use palpate_core::glam::DVec3;
use palpate_core::{Twist, Wrench};
use palpate_device::{Axes, Specification};
use palpate_dynamics::SlewLimit;
use serde::Serialize;

use crate::haptic::heat::{HeatingTime, Warmth, is_limited};
use crate::haptic::presence::smooth;

/// Fraction of the peak below which a wrench cannot drive a handle away from a hand.
pub(crate) const HARMLESS_SHARE: f64 = 0.1;

/// Time after a fault within which the wrench falls to zero, s.
pub const FAULT_TIME: f64 = 0.05;

/// Largest energy that may come out beyond the stored one, as a distance (m) and an angle (rad) moved under
/// the device's peaks: together 61 mJ for 8.5 N and 0.19 N·m.
pub const ENERGY_BOUND: (f64, f64) = (5e-3, 0.1);

/// Speed of the handle along the wrench, m/s and rad/s, above which a wrench of more than a tenth of the peak
/// is dropped.
pub const RUNAWAY_SPEED: (f64, f64) = (0.8, 20.0);

/// Largest rounding of a displacement by encoders on three axes, in encoder steps: √3.
const DIAGONAL: f64 = 1.732_050_807_568_877_2;

/// Relative amount by which a value may exceed its bound due to rounding.
const ROUNDING: f64 = 1e-6;

/// Property of every wrench that is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Invariant {
    /// The wrench is finite.
    Finite,
    /// The wrench is within the device's peaks, and zero along axes that are not driven.
    Peak,
    /// The wrench grows and turns no faster than the slew allows. It may shrink along its direction.
    Slew,
    /// The wrench is zero [`FAULT_TIME`] after a fault was detected, and while it lasts. Faults are a lost
    /// device or bad readings, a step without a finite solution, and a newest contact model older than the
    /// [timeout](crate::settings::TimingSettings::contact_timeout).
    Fault,
    /// After the start, and after a failure of the device or the step, the wrench comes up along the
    /// engagement.
    Engagement,
    /// Since the wrench was last zero, the energy that came out minus the energy that went in is at most the
    /// largest stored energy plus [`ENERGY_BOUND`]. It is not checked for devices that sense axes which they
    /// do not drive: a hand's work along those comes out along the others, as with a tool that is turned as a
    /// lever.
    Energy,
    /// The actuators get no warmer than at their continuous load.
    Heat,
    /// A wrench is dropped if the handle runs along it faster than [`RUNAWAY_SPEED`].
    Runaway,
}

impl Invariant {
    /// All invariants.
    pub const ALL: [Self; 8] = [
        Self::Finite,
        Self::Peak,
        Self::Slew,
        Self::Fault,
        Self::Engagement,
        Self::Energy,
        Self::Heat,
        Self::Runaway,
    ];

    /// Name of the invariant in summaries.
    pub fn name(self) -> &'static str {
        match self {
            Self::Finite => "finite",
            Self::Peak => "peak",
            Self::Slew => "slew",
            Self::Fault => "fault",
            Self::Engagement => "engagement",
            Self::Energy => "energy",
            Self::Heat => "heat",
            Self::Runaway => "runaway",
        }
    }
}

/// Record of the checks of one invariant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct InvariantRecord {
    /// Number of writes that broke the invariant.
    pub broken: u64,
    /// Largest value that was reached, as a fraction of the bound; more than 1 if the invariant was broken.
    pub worst: f64,
}

/// Bounds that wrenches are checked against.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    /// Peak force (N) and torque (N·m).
    peak: (f64, f64),
    /// Continuous force (N) and torque (N·m).
    continuous: (f64, f64),
    actuated: Axes,
    /// Steps of the encoders, m and rad.
    steps: (f64, f64),
    /// Energy bound, J; infinite if energy is not checked.
    energy: f64,
    slew: SlewLimit,
    /// Engagement time, s.
    engagement: f64,
}

/// The [energy bound](ENERGY_BOUND) of a device, J; infinite for one that does not drive all axes that it
/// senses.
pub(crate) fn energy_bound(specification: &Specification) -> f64 {
    let Specification { sensed, actuated, peak_force, peak_torque, .. } = specification;
    let felt = |sensed: [bool; 3], driven: [bool; 3], peak: f64| {
        sensed.into_iter().zip(driven).all(|(sensed, driven)| !sensed || (driven && peak > 0.0))
    };
    let complete = felt(sensed.translation, actuated.translation, *peak_force)
        && felt(sensed.rotation, actuated.rotation, *peak_torque);
    if complete { ENERGY_BOUND.0 * peak_force + ENERGY_BOUND.1 * peak_torque } else { f64::INFINITY }
}

impl Bounds {
    pub fn of(specification: &Specification, slew: SlewLimit, engagement: f64) -> Self {
        Self {
            peak: (specification.peak_force, specification.peak_torque),
            continuous: (specification.continuous_force, specification.continuous_torque),
            actuated: specification.actuated,
            steps: (specification.encoder_step, specification.angular_encoder_step),
            energy: energy_bound(specification),
            slew,
            engagement,
        }
    }
}

/// State of the loop at a write.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment {
    /// Time that is integrated in this step, s.
    pub dt: f64,
    /// Time since the last write, s.
    pub elapsed: f64,
    /// Share of the wrench that is sent, 0 to 1.
    pub share: f64,
    /// Whether the device or the step has failed, so that nothing is sent.
    pub faulty: bool,
    /// Time since contact models are overdue, s; negative if they are not.
    pub overdue: f64,
    /// Whether the wrench starts to come up from zero.
    pub released: bool,
    /// Largest energy that the rendered springs can give back, J at the device.
    pub stored: f64,
}

/// Checks of every wrench that is written.
#[derive(Clone, Debug)]
pub struct Invariants {
    bounds: Bounds,
    last: Wrench,
    /// Time since the first write with a failure, while it lasts, s.
    faulty: Option<f64>,
    /// Time since contact models were first reported as overdue, while they are, s.
    overdue: Option<f64>,
    /// Time since the wrench started to come up from zero, s.
    up: f64,
    /// Energy that may come out, J; negative for energy that came out beyond what went in.
    reserve: f64,
    /// Largest stored energy since the wrench was last zero, J.
    max_stored: f64,
    warmth: [Warmth; 2],
    records: [InvariantRecord; Invariant::ALL.len()],
}

impl Invariants {
    pub(crate) fn new(bounds: Bounds) -> Self {
        Self {
            bounds,
            last: Wrench::ZERO,
            faulty: None,
            overdue: None,
            up: 0.0,
            reserve: 0.0,
            max_stored: 0.0,
            warmth: [Warmth::COLD; 2],
            records: [InvariantRecord::default(); Invariant::ALL.len()],
        }
    }

    pub(crate) fn set_slew(&mut self, slew: SlewLimit) {
        self.bounds.slew = slew;
    }

    /// Takes the device's wrench to be zero, whatever was written last.
    pub(crate) fn forget(&mut self) {
        (self.last, self.up) = (Wrench::ZERO, 0.0);
    }

    /// The record of one invariant.
    pub fn record(&self, invariant: Invariant) -> InvariantRecord {
        self.records[invariant as usize]
    }

    /// Sum of the numbers of writes that broke each invariant.
    pub fn broken(&self) -> u64 {
        self.records.iter().map(|record| record.broken).sum()
    }

    /// The records of all invariants, by name.
    pub fn summary(&self) -> BTreeMap<&'static str, InvariantRecord> {
        Invariant::ALL.into_iter().map(|invariant| (invariant.name(), self.record(invariant))).collect()
    }

    /// Checks the write of a wrench (device axes, about the handle's origin), given the handle's displacement
    /// since the last write (m, rad): each invariant's value as a fraction of its bound.
    pub(crate) fn check(&mut self, wrench: &Wrench, displacement: &Twist, at: &Moment) {
        let (wrench, Moment { dt, elapsed, .. }) = (*wrench, *at);
        let parts = [(wrench.force, self.last.force), (wrench.torque, self.last.torque)];
        let Bounds { peak, slew, engagement, .. } = self.bounds;
        self.note(Invariant::Finite, if wrench.is_finite() { 0.0 } else { f64::INFINITY });
        self.note(Invariant::Peak, self.of_peak(&wrench));
        let rates = [slew.force, slew.torque];
        let slewed = parts.iter().zip(rates).map(|(&(now, last), rate)| grown(now, last) / (rate * elapsed));
        self.note(Invariant::Slew, slewed.filter(|part| !part.is_nan()).fold(0.0, f64::max));

        // Times count from the first write that reports a fault.
        let since =
            |lasts: bool, known: Option<f64>| lasts.then(|| known.map_or(0.0, |known| known + elapsed));
        self.faulty = since(at.faulty, self.faulty);
        // A model may already be long overdue when it arrives; before, that could not be detected.
        let overdue = since(at.overdue > 0.0, self.overdue);
        self.overdue = overdue.map(|known| known.min(at.overdue));
        let faulty = self.faulty.unwrap_or(0.0).max(self.overdue.unwrap_or(0.0));
        self.note(Invariant::Fault, if wrench == Wrench::ZERO { 0.0 } else { faulty / FAULT_TIME });

        self.up = if at.released { 0.0 } else { self.up } + dt;
        if engagement > 0.0 {
            let share = smooth((self.up / engagement).min(1.0));
            let grows = parts.iter().zip([peak.0, peak.1]).map(|(&(now, last), peak)| {
                let (now, last) = (now.length(), last.length());
                if now > last { part_of(now, peak * share) } else { 0.0 }
            });
            self.note(Invariant::Engagement, grows.fold(0.0, f64::max));
        }
        self.note_power(&wrench, displacement, at);
        self.last = wrench;
    }

    /// Checks the effects of the last wrench up to now: energy, heat and a handle that runs away.
    ///
    /// The reserve changes by minus the work of the wrench and is at most the stored energy; then −reserve is
    /// the energy created.
    fn note_power(&mut self, wrench: &Wrench, displacement: &Twist, at: &Moment) {
        let Moment { elapsed, stored, .. } = *at;
        let Bounds { peak, continuous, energy, .. } = self.bounds;
        let last = self.last;
        let work = charged((last.force, wrench.force), displacement.linear, self.bounds.steps.0)
            + charged((last.torque, wrench.torque), displacement.angular, self.bounds.steps.1);
        self.reserve = (self.reserve - work).min(stored.max(0.0));
        self.max_stored = self.max_stored.max(stored);
        if last == Wrench::ZERO {
            (self.reserve, self.max_stored) = (0.0, stored);
        }
        let created = -self.reserve - self.max_stored;
        self.note(Invariant::Energy, if *wrench == Wrench::ZERO { 0.0 } else { part_of(created, energy) });

        let limited = [(continuous.0, peak.0), (continuous.1, peak.1)];
        let held = [last.force.length(), last.torque.length()];
        let time = HeatingTime::new(elapsed);
        for (index, (continuous, peak)) in limited.into_iter().enumerate() {
            if is_limited(continuous, peak) {
                self.warmth[index].pass(held[index] / continuous, &time);
            }
        }
        self.note(Invariant::Heat, self.warmth[0].total().max(self.warmth[1].total()));

        let speed = |held: DVec3, peak: f64, still: bool, moved: DVec3| {
            let size = held.length();
            let drives = size > HARMLESS_SHARE * peak && !still;
            if drives && elapsed > 0.0 { moved.dot(held) / (size * elapsed) } else { 0.0 }
        };
        let linear = speed(last.force, peak.0, wrench.force == DVec3::ZERO, displacement.linear);
        let angular = speed(last.torque, peak.1, wrench.torque == DVec3::ZERO, displacement.angular);
        self.note(Invariant::Runaway, (linear / RUNAWAY_SPEED.0).max(angular / RUNAWAY_SPEED.1));
    }

    /// The largest part of a wrench as a fraction of its peak; infinite if it has a part on an axis that is
    /// not driven.
    fn of_peak(&self, wrench: &Wrench) -> f64 {
        let Bounds { peak, actuated, .. } = self.bounds;
        let undriven = DVec3::select(actuated.translation.into(), DVec3::ZERO, wrench.force) != DVec3::ZERO
            || DVec3::select(actuated.rotation.into(), DVec3::ZERO, wrench.torque) != DVec3::ZERO;
        if undriven {
            return f64::INFINITY;
        }
        part_of(wrench.force.length(), peak.0).max(part_of(wrench.torque.length(), peak.1))
    }

    /// Records a value as a fraction of the invariant's bound; NaN counts as broken.
    fn note(&mut self, invariant: Invariant, part: f64) {
        let record = &mut self.records[invariant as usize];
        record.worst = record.worst.max(part);
        record.broken += u64::from(part.is_nan() || part > 1.0 + ROUNDING);
    }
}

impl fmt::Display for Invariants {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, invariant) in Invariant::ALL.into_iter().enumerate() {
            let InvariantRecord { broken, worst } = self.record(invariant);
            let comma = if index > 0 { ", " } else { "" };
            write!(f, "{comma}{}: {worst:.3} of its bound", invariant.name())?;
            if broken > 0 {
                write!(f, ", broken {broken} times")?;
            }
        }
        Ok(())
    }
}

/// Change of a vector apart from shrinking along itself: its distance from the segment between 0 and the last
/// one.
fn grown(now: DVec3, last: DVec3) -> f64 {
    let length = last.length_squared();
    let part = if length > 0.0 { (now.dot(last) / length).clamp(0.0, 1.0) } else { 0.0 };
    let grown = now.distance(last * part);
    // Rounding is not growth.
    if grown <= ROUNDING * last.length() { 0.0 } else { grown }
}

/// Work of the force held before over the handle's displacement, J. Over as much of it as may be one encoder
/// step, it is the work of the mean of the force before and the force now: the handle moved half of a step
/// before the encoder saw it, so that a spring K would seem to give K Δ²/2 at each step Δ.
fn charged((before, now): (DVec3, DVec3), moved: DVec3, step: f64) -> f64 {
    let work = before.dot(moved);
    if step > 0.0 { work + 0.5 * (now - before).dot(moved.clamp_length_max(DIAGONAL * step)) } else { work }
}

/// A value as a fraction of its bound; 0 for a value of 0, even if the bound is 0.
fn part_of(value: f64, bound: f64) -> f64 {
    if value <= 0.0 { 0.0 } else { value / bound }
}

#[cfg(test)]
mod tests {
    use palpate_device::Emulation;

    use super::*;

    const DT: f64 = 1e-3;

    /// A write with the state of the loop at its time.
    #[derive(Clone, Copy)]
    struct Write {
        wrench: Wrench,
        elapsed: f64,
        displacement: Twist,
        faulty: bool,
        overdue: f64,
        released: bool,
        stored: f64,
    }

    impl Write {
        fn check(&self, invariants: &mut Invariants) {
            let Self { wrench, elapsed, displacement, faulty, overdue, released, stored } = *self;
            let at = Moment { dt: DT, elapsed, share: 1.0, faulty, overdue, released, stored };
            invariants.check(&wrench, &displacement, &at);
        }
    }

    fn checked(writes: impl IntoIterator<Item = Write>) -> Invariants {
        let slew = SlewLimit { force: 850.0, torque: 18.8 };
        let mut invariants = Invariants::new(Bounds::of(&Emulation::default().specification, slew, 0.2));
        writes.into_iter().for_each(|write| write.check(&mut invariants));
        invariants
    }

    fn push(force: f64) -> Write {
        Write {
            wrench: Wrench::new(DVec3::Z * force, DVec3::ZERO),
            elapsed: DT,
            displacement: Twist::ZERO,
            faulty: false,
            overdue: 0.0,
            released: false,
            stored: 0.0,
        }
    }

    /// Up to a force over 400 ms, well below the engagement.
    fn up_to(force: f64) -> impl Iterator<Item = Write> {
        (0..=400).map(move |step| push(force * smooth(f64::from(step) / 400.0)))
    }

    fn broken_by(writes: impl IntoIterator<Item = Write>) -> Vec<&'static str> {
        let invariants = checked(writes);
        let broken = |invariant: &Invariant| invariants.record(*invariant).broken > 0;
        Invariant::ALL.into_iter().filter(broken).map(Invariant::name).collect()
    }

    /// A spring that is felt through the steps Δ of an encoder seems to give K Δ²/2 at each, but gives
    /// nothing. A spring that pulls harder on the way back does give energy.
    #[test]
    fn steps_of_an_encoder_create_no_energy() {
        let (stiffness, encoder_step) = (400.0, 1e-3);
        let spring = |harder: f64| {
            let mut specification = Emulation::default().specification;
            specification.encoder_step = encoder_step;
            let slew = SlewLimit { force: 850.0, torque: 18.8 };
            let mut invariants = Invariants::new(Bounds::of(&specification, slew, 0.2));
            let mut last = 10e-3;
            for step in 0..40_000 {
                let phase = f64::from(step) * 5e-3;
                let place = ((10e-3 + 6.5e-3 * phase.sin()) / encoder_step).round() * encoder_step;
                let moved = place - last;
                let back = if phase.cos() < 0.0 { harder } else { 1.0 };
                let displacement = Twist::new(DVec3::Z * moved, DVec3::ZERO);
                let stored = 0.5 * stiffness * place * place;
                Write { displacement, stored, ..push(-stiffness * back * place) }.check(&mut invariants);
                last = place;
            }
            invariants.record(Invariant::Energy)
        };
        let (passive, active) = (spring(1.0), spring(1.2));
        assert!(passive.broken == 0 && passive.worst < 0.2, "{passive:?}");
        assert!(active.broken > 0, "{active:?}");
    }

    /// Each invariant is broken by writes just beyond its bound, and by no others.
    #[test]
    fn each_invariant_is_broken_just_beyond_its_bound() {
        assert_eq!(broken_by(up_to(1.2)), Vec::<&str>::new());
        let then = |writes: Vec<Write>| broken_by(up_to(1.2).chain(writes));
        assert_eq!(then(vec![push(f64::NAN)]), ["finite", "peak", "engagement"][..1], "not a number");
        assert_eq!(broken_by(up_to(8.6)), ["peak", "engagement"]);
        let turned = Write { wrench: Wrench::new(DVec3::X * 1.2, DVec3::ZERO), ..push(0.0) };
        assert_eq!(then(vec![turned]), ["slew"]);
        assert_eq!(then(vec![push(2.1)]), ["slew"], "0.9 N in 1 ms");
        assert_eq!(then(vec![push(0.1)]), [""; 0], "it may shrink");
        let faulty = Write { faulty: true, ..push(1.2) };
        assert_eq!(then(vec![faulty; 51]), [""; 0]);
        assert_eq!(then(vec![faulty; 52]), ["fault"]);
        let late = Write { elapsed: 0.06, ..faulty };
        assert_eq!(then(vec![late]), [""; 0], "the first write that reports it");
        assert_eq!(then(vec![late; 2]), ["fault"]);
        let overdue = |overdue, times| then(vec![Write { overdue, ..push(1.2) }; times]);
        assert_eq!((overdue(0.05, 60), overdue(0.051, 52)), (vec![], vec!["fault"]));
        assert_eq!(
            (overdue(7.0, 51), overdue(7.0, 52)),
            (vec![], vec!["fault"]),
            "long overdue when it arrives"
        );
        let late = |overdue| Write { overdue, ..push(1.2) };
        let [late, old] = [0.01, 7.0].map(late);
        let than = |old_ones| then([vec![late; 200], vec![old; old_ones]].concat());
        assert_eq!((than(40), than(41)), (vec![], vec!["fault"]), "long overdue, after slightly late ones");
        let released = Write { faulty: true, released: true, ..push(0.0) };
        assert_eq!(then(vec![released, push(0.3)]), ["engagement"]);
        assert_eq!(then(vec![released, push(5e-4)]), [""; 0]);
        let giving = Write { displacement: Twist::new(DVec3::Z * 5e-4, DVec3::ZERO), ..push(1.2) };
        assert_eq!(then(vec![giving; 60]), [""; 0], "36 mJ");
        assert_eq!(then(vec![giving; 110]), ["energy"], "66 mJ of 61 mJ");
        let stored = Write { stored: 0.01, ..giving };
        assert_eq!(then(vec![stored; 110]), [""; 0], "66 mJ of 61 mJ and 10 mJ");
        let long = |force: f64| vec![Write { elapsed: 1.0, ..push(force) }; 6000];
        assert_eq!(then(long(1.45)), ["heat"], "1.4 N is the continuous force");
        assert_eq!(then(long(1.39)), [""; 0]);
        let running = Write { displacement: Twist::new(DVec3::Z * 9e-4, DVec3::ZERO), ..push(1.2) };
        assert_eq!(then(vec![running]), ["runaway"]);
        assert_eq!(then(vec![Write { wrench: Wrench::ZERO, ..running }]), [""; 0], "dropped at once");
    }
}
