//! Judges the wrenches that a device is asked for by what is visible at the device alone, independently of
//! the engine's own checks.

use palpate::device::{DeviceState, Specification};
use palpate::glam::DVec3;
use palpate::promises::FAULT_TIME;
use palpate::settings::Response;
use palpate::{Settings, Wrench};

/// Relative growth of a wrench that counts as rounding.
const ROUNDING: f64 = 1e-6;

/// Readings that repeat for longer are those of a lost device, s.
const STALE_TIME: f64 = 0.025;

/// Number of periods' growth that a wrench may make up at once, however late a step is.
const MAX_GROWTH_PERIODS: f64 = 2.0;

/// Shortest time to reach the peak unless settings give a slew rate, s.
const SLEW_TIME: f64 = 0.01;

/// Inputs of a step, as the host knows them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Step {
    /// Time and duration of the step as the host reports them, s.
    pub now: f64,
    pub dt: f64,
    /// Time of the newest contact model, s.
    pub contacts: f64,
}

/// Largest values relative to their bounds: above 1 where a bound was broken.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Parts {
    pub finite: f64,
    pub peak: f64,
    pub slew: f64,
    pub silence: f64,
}

/// Judges the wrenches written to a device.
#[derive(Clone, Debug)]
pub struct Judge {
    specification: Specification,
    period: f64,
    timeout: f64,
    /// Slew rates, N/s and N·m/s: now, and before the last change, which the next write may still use.
    slew: (f64, f64),
    before: (f64, f64),
    held: Wrench,
    /// Times since which the device has not answered, its readings were bad or repeated, and contact models
    /// were overdue, s.
    unread: Option<f64>,
    bad: Option<f64>,
    same: Option<f64>,
    old: Option<f64>,
    stamped: bool,
    good: Option<DeviceState>,
    pub parts: Parts,
}

impl Judge {
    pub fn new(specification: &Specification, settings: &Settings) -> Self {
        let slew = slew(specification, settings);
        Self {
            specification: specification.clone(),
            period: 1.0 / settings.timing.rate,
            // Constraints of surfaces that stand still hold for half a second.
            timeout: match settings.contact.response {
                Response::Constraints => settings.timing.contact_timeout.max(0.5),
                Response::Penalty => settings.timing.contact_timeout,
            },
            slew,
            before: slew,
            held: Wrench::ZERO,
            unread: None,
            bad: None,
            same: None,
            old: None,
            stamped: false,
            good: None,
            parts: Parts::default(),
        }
    }

    /// Applies changed settings from the next step on.
    pub fn change(&mut self, settings: &Settings) {
        self.slew = slew(&self.specification, settings);
    }

    /// Notes that the device renders nothing, whatever it was asked for.
    pub fn forget(&mut self) {
        self.held = Wrench::ZERO;
    }

    /// Notes a reading at a time (s); `None` where the device does not answer.
    pub fn read(&mut self, state: Option<&DeviceState>, time: f64) {
        let Some(state) = state else {
            self.unread.get_or_insert(time);
            return;
        };
        self.unread = None;
        let turn = state.pose.rotation;
        let is_good = state.pose.translation.is_finite()
            && (turn.length() - 1.0).abs() < 1e-3
            && state.twist.linear.is_finite()
            && state.twist.angular.is_finite();
        if !is_good {
            self.bad.get_or_insert(time);
            return;
        }
        self.bad = None;
        // A device with time stamps is stale when neither time nor pose advances.
        let stays = |last: &DeviceState| state.time <= last.time && state.pose == last.pose;
        if self.stamped && self.good.as_ref().is_some_and(stays) {
            self.same.get_or_insert(time);
            return;
        }
        self.same = None;
        self.stamped |= self.good.as_ref().is_some_and(|last| state.time > last.time);
        self.good = Some(*state);
    }

    /// Judges a wrench that is written at a time (s).
    pub fn write(&mut self, wrench: &Wrench, time: f64, step: &Step) {
        let finite = wrench.force.is_finite() && wrench.torque.is_finite();
        raise(&mut self.parts.finite, if finite { 0.0 } else { f64::INFINITY });
        let Specification { actuated, peak_force, peak_torque, .. } = &self.specification;
        let peak = |axes: [bool; 3], asked: DVec3, peak: f64| {
            let beside = axes.iter().zip(asked.to_array()).any(|(driven, part)| !driven && part != 0.0);
            if beside { f64::INFINITY } else { part(asked.length(), peak) }
        };
        let of_force = peak(actuated.translation, wrench.force, *peak_force);
        raise(&mut self.parts.peak, of_force.max(peak(actuated.rotation, wrench.torque, *peak_torque)));

        // The wrench may grow by the slew rate times the step, and shrink at any rate.
        let longest = MAX_GROWTH_PERIODS * self.period;
        let allowed = if step.dt.is_nan() { longest } else { step.dt.clamp(0.0, longest) };
        let slew = (self.slew.0.max(self.before.0), self.slew.1.max(self.before.1));
        let of_force = part(grown(wrench.force, self.held.force), slew.0 * allowed);
        let of_torque = part(grown(wrench.torque, self.held.torque), slew.1 * allowed);
        raise(&mut self.parts.slew, of_force.max(of_torque));
        self.before = self.slew;
        self.held = *wrench;

        self.old = (self.overdue(step) > 0.0).then(|| self.old.unwrap_or(time));
        let silent = wrench.force == DVec3::ZERO && wrench.torque == DVec3::ZERO;
        let faulty = if silent { 0.0 } else { self.faulty(time, step) };
        raise(&mut self.parts.silence, faulty);
    }

    /// Returns the duration of a detectable fault, relative to the time after which no wrench may be sent.
    fn faulty(&self, time: f64, step: &Step) -> f64 {
        if self.unread.is_some() {
            return f64::INFINITY;
        }
        let bad = self.bad.map_or(0.0, |since| time - since);
        let same = self.same.map_or(0.0, |since| time - since - STALE_TIME);
        let old = self.old.map_or(0.0, |since| time - since).min(self.overdue(step));
        bad.max(same).max(old) / FAULT_TIME
    }

    /// Returns by how much the contact models exceed their largest age, s.
    fn overdue(&self, step: &Step) -> f64 {
        step.now - step.contacts - self.timeout
    }
}

fn slew(specification: &Specification, settings: &Settings) -> (f64, f64) {
    let Specification { actuated, peak_force, peak_torque, .. } = specification;
    let usual = |axes: [bool; 3], peak: f64| if axes.contains(&true) { peak / SLEW_TIME } else { 0.0 };
    (
        settings.output.force_slew.unwrap_or(usual(actuated.translation, *peak_force)),
        settings.output.torque_slew.unwrap_or(usual(actuated.rotation, *peak_torque)),
    )
}

fn raise(part: &mut f64, to: f64) {
    // NaN means that something is broken.
    *part = if to.is_nan() { f64::INFINITY } else { part.max(to) };
}

/// Returns a value relative to its bound.
fn part(figure: f64, bound: f64) -> f64 {
    if figure <= 0.0 { 0.0 } else { figure / bound }
}

/// Returns the distance of a vector from the nearest to which the one before can have shrunk.
fn grown(now: DVec3, before: DVec3) -> f64 {
    let length = before.length();
    if !(length > 0.0 && length.is_finite()) {
        return now.length();
    }
    let along = before / length;
    let nearest = along * now.dot(along).clamp(0.0, length);
    let grown = (now - nearest).length();
    if grown <= ROUNDING * length { 0.0 } else { grown }
}

#[cfg(test)]
mod tests {
    use palpate::device::{Emulation, Status};
    use palpate::{Pose, Twist};

    use super::*;

    const DT: f64 = 1e-3;

    fn push(force: f64) -> Wrench {
        Wrench::new(DVec3::Z * force, DVec3::ZERO)
    }

    /// Returns the values reached by wrenches written each millisecond, with a reading before each.
    fn parts(writes: &[Wrench], reading: impl Fn(usize) -> Option<DeviceState>, contacts: f64) -> Parts {
        let mut judge = Judge::new(&Emulation::default().specification, &Settings::default());
        for (index, wrench) in writes.iter().enumerate() {
            let now = index as f64 * DT;
            judge.read(reading(index).as_ref(), now);
            judge.write(wrench, now, &Step { now, dt: DT, contacts: now.min(contacts) });
        }
        judge.parts
    }

    fn state(time: f64, place: f64) -> DeviceState {
        let pose = Pose::from_translation(DVec3::X * place);
        DeviceState { time, pose, twist: Twist::ZERO, buttons: 0, status: Status::OK }
    }

    fn good(index: usize) -> Option<DeviceState> {
        Some(state(index as f64 * DT, 0.0))
    }

    #[test]
    fn each_value_is_raised_by_its_own_fault() {
        let rising: Vec<Wrench> = (0..8).map(|step| push(0.8 * f64::from(step))).collect();
        let usual = parts(&rising, good, 1.0);
        assert!(usual.finite == 0.0 && usual.peak < 1.0 && usual.slew < 1.0 && usual.silence == 0.0);
        assert!(parts(&[push(f64::NAN)], good, 1.0).finite > 1.0);
        assert!(parts(&[push(8.6)], good, 1.0).peak > 1.0);
        assert!(parts(&[push(0.8), push(1.7)], good, 1.0).slew > 1.0, "0.9 N in 1 ms");
        assert!(parts(&[push(0.8), push(1.6), push(0.0)], good, 1.0).slew < 1.0, "it may shrink");
        let kept = vec![push(0.5); 120];
        assert!(parts(&kept, good, 1.0).silence < 1.0);
        assert!(parts(&kept, |index| (index != 5).then(|| state(0.0, 0.0)), 1.0).silence > 1.0, "no answer");
        let bad = |from, to| {
            move |index| {
                let place = if (from..to).contains(&index) { f64::NAN } else { 0.0 };
                Some(state(index as f64 * DT, place))
            }
        };
        assert!(parts(&kept, bad(10, 60), 1.0).silence < 1.0, "for 50 ms");
        assert!(parts(&kept, bad(10, 65), 1.0).silence > 1.0, "for 55 ms");
        let same = |index: usize| Some(state(DT * index.min(20) as f64, 0.0));
        assert!(parts(&kept[..90], same, 1.0).silence < 1.0);
        assert!(parts(&kept, same, 1.0).silence > 1.0, "the same for 100 ms");
        assert!(parts(&kept, good, 0.01).silence < 1.0, "contacts of 110 ms ago");
        assert!(parts(&[push(0.5); 620], good, 0.01).silence > 1.0, "contacts of 610 ms ago");
    }
}
