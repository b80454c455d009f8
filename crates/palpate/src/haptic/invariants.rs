//! What the engine promises of every wrench that it writes, checked at every write by figures of its own.
//!
//! The checks know nothing of how the wrench came about: only what was written before, when, and where the handle went. The page
//! "What the engine promises to your hand" (docs/promises.md) states each with its number.

use std::collections::BTreeMap;
use std::fmt;

use palpate_core::glam::DVec3;
use palpate_core::{Twist, Wrench};
use palpate_device::{Axes, Specification};
use palpate_dynamics::SlewLimit;
use serde::Serialize;

use crate::haptic::heat::{Warmth, is_limited};
use crate::haptic::presence::smooth;

/// A wrench of less than this part of the peak drives no handle off.
pub(crate) const HARMLESS_SHARE: f64 = 0.1;

/// Time after a fault by which nothing is sent any more, s.
pub const FAULT_TIME: f64 = 0.05;

/// Most energy that may come out beyond what was stored, as a way (m) and a turn (rad) under the device's peaks: together 61 mJ for
/// 8.5 N and 0.19 N·m.
pub const ENERGY_BOUND: (f64, f64) = (5e-3, 0.1);

/// Speed of the handle along the wrench, m/s and rad/s, from which a wrench above a tenth of the peak is let go of.
pub const RUNAWAY_SPEED: (f64, f64) = (0.8, 20.0);

/// How far rounding on three axes reaches, in steps.
const DIAGONAL: f64 = 1.732_050_807_568_877_2;

/// By how much a figure may be above its bound for rounding.
const ROUNDING: f64 = 1e-6;

/// Something that holds of every wrench that is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Invariant {
    /// It is finite.
    Finite,
    /// It is within the device's peaks, and zero along axes that are not driven.
    Peak,
    /// It grows and turns no faster than the slew allows. It may shrink along itself.
    Slew,
    /// It is zero [`FAULT_TIME`] after a fault was found, and while it lasts: the device lost or its readings bad, a step without a
    /// finite solution, the newest contact model older than the [timeout](crate::settings::TimingSettings::contact_timeout).
    Fault,
    /// After the start, and after the device or the step has failed, it comes up along the engagement.
    Engagement,
    /// Since it was last zero, no more energy has come out of it beyond what went in than was stored at any time, but for
    /// [`ENERGY_BOUND`]. Of devices that sense axes which they do not drive nothing is checked: what a hand does along those is felt
    /// along the others, as when it turns a tool that is a lever.
    Energy,
    /// It leaves actuators no warmer than what they can keep up does.
    Heat,
    /// A handle that runs along it faster than [`RUNAWAY_SPEED`] is let go of.
    Runaway,
}

impl Invariant {
    /// All of them.
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

    /// Its name in summaries.
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

/// What was found of one invariant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Kept {
    /// Writes in which it was broken.
    pub broken: u64,
    /// The largest part of its bound that was reached: more than 1 where it was broken.
    pub worst: f64,
}

/// What the invariants are checked against.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    /// N, N·m.
    peak: (f64, f64),
    continuous: (f64, f64),
    actuated: Axes,
    /// Of the encoders, m and rad.
    steps: (f64, f64),
    /// J: infinite where energy is not checked.
    energy: f64,
    slew: SlewLimit,
    /// s.
    engagement: f64,
}

/// The [energy bound](ENERGY_BOUND) of a device, J: infinite for one that does not drive all axes that it senses.
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

/// A write, with what is known at the time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Write {
    /// Device axes, about the handle's origin.
    pub wrench: Wrench,
    /// What the loop integrates in this step, and the time since the last write, s.
    pub dt: f64,
    pub elapsed: f64,
    /// What the handle has moved by since the last write, m and rad.
    pub displacement: Twist,
    /// Whether the device or the step has failed, how long contact models have been overdue (s, negative before), and whether the
    /// wrench has to come up from nothing after a failure.
    pub faulty: bool,
    pub overdue: f64,
    pub released: bool,
    /// Most that what is rendered may give back, J.
    pub stored: f64,
}

/// Checks each wrench that is written.
#[derive(Clone, Debug)]
pub struct Invariants {
    bounds: Bounds,
    last: Wrench,
    /// Time since the first write that knew of a failure, while it lasts; for which contact models have been known to be overdue; and since
    /// the wrench was to come up from nothing, s.
    faulty: Option<f64>,
    overdue: Option<f64>,
    up: f64,
    /// Energy that may come out, J; negative for what came out beyond what went in; and the most that was stored meanwhile.
    reserve: f64,
    most_stored: f64,
    warmth: [Warmth; 2],
    kept: [Kept; Invariant::ALL.len()],
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
            most_stored: 0.0,
            warmth: [Warmth::COLD; 2],
            kept: [Kept::default(); Invariant::ALL.len()],
        }
    }

    pub(crate) fn set_slew(&mut self, slew: SlewLimit) {
        self.bounds.slew = slew;
    }

    /// The device holds nothing, whatever was written last.
    pub(crate) fn forget(&mut self) {
        (self.last, self.up) = (Wrench::ZERO, 0.0);
    }

    /// What was found of one of them.
    pub fn kept(&self, invariant: Invariant) -> Kept {
        self.kept[invariant as usize]
    }

    /// Writes in which one was broken, of all of them.
    pub fn broken(&self) -> u64 {
        self.kept.iter().map(|kept| kept.broken).sum()
    }

    /// What was found of each, by name.
    pub fn summary(&self) -> BTreeMap<&'static str, Kept> {
        Invariant::ALL.into_iter().map(|invariant| (invariant.name(), self.kept(invariant))).collect()
    }

    pub(crate) fn check(&mut self, write: &Write) {
        let Write { wrench, dt, elapsed, .. } = *write;
        let parts = [(wrench.force, self.last.force), (wrench.torque, self.last.torque)];
        let Bounds { peak, slew, engagement, .. } = self.bounds;
        self.note(Invariant::Finite, if wrench.is_finite() { 0.0 } else { f64::INFINITY });
        self.note(Invariant::Peak, self.of_peak(&wrench));
        let rates = [slew.force, slew.torque];
        let slewed = parts.iter().zip(rates).map(|(&(now, last), rate)| grown(now, last) / (rate * elapsed));
        self.note(Invariant::Slew, slewed.filter(|part| !part.is_nan()).fold(0.0, f64::max));

        // What the first write after a fault sends was the first to know of it.
        let since =
            |is_there: bool, known: Option<f64>| is_there.then(|| known.map_or(0.0, |known| known + elapsed));
        self.faulty = since(write.faulty, self.faulty);
        // Models may be of long ago when they come: that is known from then on.
        let overdue = since(write.overdue > 0.0, self.overdue);
        self.overdue = overdue.map(|known| known.min(write.overdue));
        let faulty = self.faulty.unwrap_or(0.0).max(self.overdue.unwrap_or(0.0));
        self.note(Invariant::Fault, if wrench == Wrench::ZERO { 0.0 } else { faulty / FAULT_TIME });

        self.up = if write.released { 0.0 } else { self.up } + dt;
        if engagement > 0.0 {
            let share = smooth((self.up / engagement).min(1.0));
            let grows = parts.iter().zip([peak.0, peak.1]).map(|(&(now, last), peak)| {
                let (now, last) = (now.length(), last.length());
                if now > last { part_of(now, peak * share) } else { 0.0 }
            });
            self.note(Invariant::Engagement, grows.fold(0.0, f64::max));
        }
        self.note_power(write);
        self.last = wrench;
    }

    /// What the last wrench has done by now: energy, heat, and a handle that runs off.
    fn note_power(&mut self, write: &Write) {
        let Write { wrench, elapsed, displacement, stored, .. } = *write;
        let Bounds { peak, continuous, energy, .. } = self.bounds;
        let last = self.last;
        let work = charged((last.force, wrench.force), displacement.linear, self.bounds.steps.0)
            + charged((last.torque, wrench.torque), displacement.angular, self.bounds.steps.1);
        self.reserve = (self.reserve - work).min(stored.max(0.0));
        self.most_stored = self.most_stored.max(stored);
        if last == Wrench::ZERO {
            (self.reserve, self.most_stored) = (0.0, stored);
        }
        let created = -self.reserve - self.most_stored;
        self.note(Invariant::Energy, if wrench == Wrench::ZERO { 0.0 } else { part_of(created, energy) });

        let limited = [(continuous.0, peak.0), (continuous.1, peak.1)];
        let held = [last.force.length(), last.torque.length()];
        for (index, (continuous, peak)) in limited.into_iter().enumerate() {
            if is_limited(continuous, peak) {
                self.warmth[index].pass(held[index] / continuous, elapsed);
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

    fn of_peak(&self, wrench: &Wrench) -> f64 {
        let Bounds { peak, actuated, .. } = self.bounds;
        let beside = DVec3::select(actuated.translation.into(), DVec3::ZERO, wrench.force) != DVec3::ZERO
            || DVec3::select(actuated.rotation.into(), DVec3::ZERO, wrench.torque) != DVec3::ZERO;
        if beside {
            return f64::INFINITY;
        }
        part_of(wrench.force.length(), peak.0).max(part_of(wrench.torque.length(), peak.1))
    }

    fn note(&mut self, invariant: Invariant, part: f64) {
        let kept = &mut self.kept[invariant as usize];
        kept.worst = kept.worst.max(part);
        // A part that is no number is of something broken.
        kept.broken += u64::from(part.is_nan() || part > 1.0 + ROUNDING);
    }
}

impl fmt::Display for Invariants {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, invariant) in Invariant::ALL.into_iter().enumerate() {
            let Kept { broken, worst } = self.kept(invariant);
            let comma = if index > 0 { ", " } else { "" };
            write!(f, "{comma}{}: {worst:.3} of its bound", invariant.name())?;
            if broken > 0 {
                write!(f, ", broken {broken} times")?;
            }
        }
        Ok(())
    }
}

/// How far a vector is from what the last one may have shrunk to along itself.
fn grown(now: DVec3, last: DVec3) -> f64 {
    let length = last.length_squared();
    let part = if length > 0.0 { (now.dot(last) / length).clamp(0.0, 1.0) } else { 0.0 };
    let grown = now.distance(last * part);
    // What is left by rounding.
    if grown <= ROUNDING * last.length() { 0.0 } else { grown }
}

/// The work of what was held before over what the handle moved by, J; over as much as may be one step of its encoders, of the mean of
/// that and of what now answers it. Half of a step lies before where it is seen, so that a spring K would seem to give K Δ²/2 at each.
fn charged((before, now): (DVec3, DVec3), moved: DVec3, step: f64) -> f64 {
    let work = before.dot(moved);
    if step > 0.0 { work + 0.5 * (now - before).dot(moved.clamp_length_max(DIAGONAL * step)) } else { work }
}

/// A figure as a part of its bound; nothing of a bound of 0 is nothing.
fn part_of(figure: f64, bound: f64) -> f64 {
    if figure <= 0.0 { 0.0 } else { figure / bound }
}

#[cfg(test)]
mod tests {
    use palpate_device::Emulation;

    use super::*;

    const DT: f64 = 1e-3;

    fn checked(writes: impl IntoIterator<Item = Write>) -> Invariants {
        let slew = SlewLimit { force: 850.0, torque: 18.8 };
        let mut invariants = Invariants::new(Bounds::of(&Emulation::default().specification, slew, 0.2));
        writes.into_iter().for_each(|write| invariants.check(&write));
        invariants
    }

    fn push(force: f64) -> Write {
        Write {
            wrench: Wrench::new(DVec3::Z * force, DVec3::ZERO),
            dt: DT,
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
        let broken = |invariant: &Invariant| invariants.kept(*invariant).broken > 0;
        Invariant::ALL.into_iter().filter(broken).map(Invariant::name).collect()
    }

    /// A spring that is felt in the steps of an encoder seems to give K Δ²/2 at each, on the way out and back; it gives nothing. What
    /// a spring gives that pulls harder on the way back is given for all that.
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
                invariants.check(&Write { displacement, stored, ..push(-stiffness * back * place) });
                last = place;
            }
            invariants.kept(Invariant::Energy)
        };
        let (passive, active) = (spring(1.0), spring(1.2));
        assert!(passive.broken == 0 && passive.worst < 0.2, "{passive:?}");
        assert!(active.broken > 0, "{active:?}");
    }

    /// Each is broken by what breaks it, and by nothing else.
    #[test]
    fn each_is_broken_by_what_breaks_it() {
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
        assert_eq!(then(vec![late]), [""; 0], "it is the first that knows");
        assert_eq!(then(vec![late; 2]), ["fault"]);
        let overdue = |overdue, times| then(vec![Write { overdue, ..push(1.2) }; times]);
        assert_eq!((overdue(0.05, 60), overdue(0.051, 52)), (vec![], vec!["fault"]));
        assert_eq!((overdue(7.0, 51), overdue(7.0, 52)), (vec![], vec!["fault"]), "of long ago as they come");
        let late = |overdue| Write { overdue, ..push(1.2) };
        let [late, old] = [0.01, 7.0].map(late);
        let than = |old_ones| then([vec![late; 200], vec![old; old_ones]].concat());
        assert_eq!((than(40), than(41)), (vec![], vec!["fault"]), "of long ago, after such as were late");
        let released = Write { faulty: true, released: true, ..push(0.0) };
        assert_eq!(then(vec![released, push(0.3)]), ["engagement"]);
        assert_eq!(then(vec![released, push(5e-4)]), [""; 0]);
        let giving = Write { displacement: Twist::new(DVec3::Z * 5e-4, DVec3::ZERO), ..push(1.2) };
        assert_eq!(then(vec![giving; 60]), [""; 0], "36 mJ");
        assert_eq!(then(vec![giving; 110]), ["energy"], "66 mJ of 61 mJ");
        let stored = Write { stored: 0.01, ..giving };
        assert_eq!(then(vec![stored; 110]), [""; 0], "66 mJ of 61 mJ and 10 mJ");
        let long = |force: f64| vec![Write { elapsed: 1.0, ..push(force) }; 6000];
        assert_eq!(then(long(1.45)), ["heat"], "1.4 N can be kept up");
        assert_eq!(then(long(1.39)), [""; 0]);
        let running = Write { displacement: Twist::new(DVec3::Z * 9e-4, DVec3::ZERO), ..push(1.2) };
        assert_eq!(then(vec![running]), ["runaway"]);
        assert_eq!(then(vec![Write { wrench: Wrench::ZERO, ..running }]), [""; 0], "let go of at once");
    }
}
