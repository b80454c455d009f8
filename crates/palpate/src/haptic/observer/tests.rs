//! Known motions whose readings are rounded to steps, compared with the motions; and a handle with friction,
//! simulated plainly.

use std::f64::consts::TAU;

use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::*;

const STEP: f64 = 3e-5;
const PERIOD: f64 = 1e-3;
const LAG: f64 = 3e-3;

/// An observer of one axis, with the readings before.
struct Axis {
    observer: StepObserver,
    reading: f64,
    estimate: f64,
}

impl Axis {
    /// Starts at a position, m. With a `step` of 0 the readings are rounded and the estimates are readings.
    fn new(step: f64, lag: f64, position: f64) -> Self {
        let reading = rounded(position);
        Self { observer: StepObserver::new(step, lag), reading, estimate: reading }
    }

    /// Reads a position (m) and returns the estimate.
    fn read(&mut self, position: f64) -> f64 {
        let reading = rounded(position);
        let moved = DVec3::X * (reading - std::mem::replace(&mut self.reading, reading));
        self.estimate += self.observer.advance(moved, PERIOD).x;
        let off = self.estimate - reading;
        assert!((off - self.observer.offset().x).abs() < 1e-12, "the displacements do not add up: {off}");
        self.estimate
    }
}

fn rounded(position: f64) -> f64 {
    (position / STEP).round() * STEP
}

/// Errors of estimates and readings, m rms after half a second, and the largest of the estimates.
fn errors(motion: impl Fn(f64) -> f64) -> (f64, f64, f64) {
    let (mut axis, mut sums, mut largest) = (Axis::new(STEP, LAG, motion(0.0)), (0.0, 0.0), 0.0_f64);
    for i in 1..=3000 {
        let position = motion(f64::from(i) * PERIOD);
        let error = axis.read(position) - position;
        largest = largest.max((axis.estimate - axis.reading).abs());
        if i > 500 {
            sums = (sums.0 + error * error, sums.1 + (axis.reading - position).powi(2));
        }
    }
    ((sums.0 / 2500.0).sqrt(), (sums.1 / 2500.0).sqrt(), largest)
}

/// Steady motion, and that of a hand that swings, are found to a small part of a step; readings are off by
/// Δ/√12.
#[test]
fn even_motion_is_found_between_the_steps() {
    for speed in [0.0011, 0.0031, 0.0123, 0.0501, 0.1999] {
        let (found, read, _) = errors(|time| 0.37 * STEP + speed * time);
        assert!(found < 0.2 * STEP && read > 0.2 * STEP, "{speed} m/s: {found} and {read} m");
    }
    for (amplitude, rate) in [(5e-3, 0.2), (2e-2, 0.5), (6e-2, 0.53)] {
        let (found, read, _) = errors(|time| amplitude * (TAU * rate * time).sin());
        assert!(found < 0.2 * STEP && read > 0.25 * STEP, "{rate} Hz: {found} and {read} m");
    }
}

/// However it moves and whenever it is read, the estimate stays in the cell, and comes to rest at the reading
/// once the handle rests. Without steps it is the reading.
#[test]
fn estimates_stay_in_the_cell_and_come_to_rest() {
    let seed = 29;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..200 {
        let size = 10_f64.powf(rng.random_range(-6.0..-2.0));
        let (mut observer, mut exact) = (StepObserver::new(STEP, LAG), StepObserver::new(0.0, LAG));
        for _ in 0..2000 {
            let mut steps = || f64::from(rng.random_range(-3..=3)) * (size / STEP).round() * STEP;
            let moved = DVec3::new(steps(), steps(), steps());
            let interval = PERIOD * 10_f64.powf(rng.random_range(-0.6..1.5));
            let before = observer.offset();
            let found = observer.advance(moved, interval);
            let off = observer.offset();
            assert!(off.abs().max_element() <= 0.5 * STEP, "seed {seed}, case {case}: {off}");
            assert!((found - moved - off + before).length() < 1e-12 + 1e-9 * size);
            assert_eq!(exact.advance(moved, interval), moved);
        }
        let mut steps = 0;
        while !observer.is_at_rest() && steps < 5000 {
            observer.advance(DVec3::ZERO, PERIOD);
            steps += 1;
        }
        assert!(steps < 3000 && observer.offset() == DVec3::ZERO, "seed {seed}, case {case}: {steps}");
    }
}

/// A jump of the handle by many steps is followed in the same reading, and after a gap the estimate starts
/// anew.
#[test]
fn a_step_of_the_hand_is_followed_at_once() {
    let mut axis = Axis::new(STEP, LAG, 0.0);
    for i in 1..200 {
        let position = if i < 100 { 1e-4 * f64::from(i) } else { 0.02 };
        let found = axis.read(position);
        assert!((found - position).abs() <= STEP * (1.0 + 1e-9), "{i}: {found} m");
    }
    let moved = axis.observer.advance(DVec3::X * 1e-3, 2.0 * LONGEST_INTERVAL);
    assert!(axis.observer.is_at_rest() && (moved.x - 1e-3).abs() < 0.51 * STEP);
}

/// Stopping keeps the place and drops the velocity.
#[test]
fn an_observer_that_is_stopped_stays() {
    let mut axis = Axis::new(STEP, LAG, 0.0);
    for i in 1..100 {
        axis.read(1.03e-5 * f64::from(i));
    }
    let offset = axis.observer.offset();
    assert!(offset.x != 0.0);
    axis.observer.rest();
    assert_eq!((axis.observer.offset(), axis.observer.velocity), (offset, DVec3::ZERO));
    axis.observer.reset();
    assert!(axis.observer.is_at_rest());
}

/// A coupling to a body that stands still at 0: stiffness, damping (N/m, N·s/m), the damper's lag and that
/// which the observer is told, s, and the device's delay in periods.
#[derive(Clone, Copy)]
struct Coupled {
    stiffness: f64,
    damping: f64,
    lag: f64,
    told: f64,
    delay: usize,
}

impl Coupled {
    /// A coupling of the default device to a body (kg), damped critically, with the lag that passivity needs
    /// at a damping of the handle of 1 N·s/m.
    fn critical(mass: f64, stiffness: f64, delay: usize) -> Self {
        Self::damped(2.0 * (stiffness * mass).sqrt(), stiffness, delay)
    }

    fn damped(damping: f64, stiffness: f64, delay: usize) -> Self {
        let late = (0.5 + delay as f64) * PERIOD;
        let passive = damping * late / (0.9 - stiffness * late) - 0.5 * PERIOD;
        let lag = passive.max(3e-3);
        Self { stiffness, damping, lag, told: lag, delay }
    }

    /// The same with damping and lag as they are by default for heavy bodies: lower and longer.
    fn to(mass: f64, stiffness: f64, delay: usize) -> Self {
        let critical = Self::critical(mass, stiffness, delay);
        let longest = palpate_dynamics::LONGEST_LAG;
        let share = (longest + 0.5 * PERIOD) / (critical.lag + 0.5 * PERIOD);
        if share >= 1.0 {
            return critical;
        }
        let lag = critical.lag.min(2.0 * longest);
        Self { damping: critical.damping * share, lag, told: lag, ..critical }
    }
}

/// Damping of a hand, its stiffness and its mass, N·s/m, N/m and kg.
type Held = (f64, f64, f64);

/// Positions of a Phantom Premium's handle (m) with a friction (N), and the coupling's force (N), at each
/// period of `seconds`. A hand that aims at `aim` (m) pulls it, and a coupling holds it on estimates, or on
/// readings with a `step` of 0.
fn handle(
    coupled: &Coupled,
    step: f64,
    (hand, friction): (Held, f64),
    (start, seconds): (f64, f64),
    aim: impl Fn(f64) -> f64,
) -> Vec<(f64, f64)> {
    const SUBSTEPS: u32 = 50;
    let (mass, damping) = (0.075 + hand.2, 1.0);
    let dt = PERIOD / f64::from(SUBSTEPS);
    let (mut place, mut speed, mut lagged) = (start, 0.0, 0.0);
    let mut axis = Axis::new(step, coupled.told, place);
    let periods = (seconds / PERIOD).round() as usize;
    let mut found = Vec::with_capacity(periods);
    for period in 0..periods {
        let before = axis.estimate;
        let estimate = axis.read(place);
        lagged += ((estimate - before) / PERIOD - lagged) * PERIOD / (coupled.lag + PERIOD);
        found.push((place, -coupled.stiffness * estimate - coupled.damping * lagged));
        let force = period.checked_sub(coupled.delay).map_or(0.0, |sent| found[sent].1);
        for substep in 0..SUBSTEPS {
            let time = (period as f64 + f64::from(substep) / f64::from(SUBSTEPS)) * PERIOD;
            let aimed = (aim(time + dt) - aim(time)) / dt;
            let momentum: f64 = mass * speed + dt * (force + hand.1 * (aim(time) - place) + hand.0 * aimed);
            let slides = if momentum == 0.0 { 0.0 } else { (1.0 - friction * dt / momentum.abs()).max(0.0) };
            speed = momentum * slides / (mass + dt * (damping + hand.0 + dt * hand.1));
            place += dt * speed;
        }
    }
    found
}

fn range(values: impl Iterator<Item = f64>) -> f64 {
    let (least, most) = values
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    most - least
}

/// Stiffest spring that friction brings to rest, N/m, for pushes between the forces of two steps.
fn stiffest(step: f64) -> f64 {
    const PUSHING: f64 = 20.0;
    let rests = |stiffness: f64| {
        let coupled = Coupled { stiffness, damping: 0.0, lag: PERIOD, told: PERIOD, delay: 0 };
        (0..4).all(|part| {
            let steps = (0.02 / STEP).floor() + f64::from(part) / 4.0;
            let aim = -steps * STEP * (stiffness + PUSHING) / PUSHING;
            let found = handle(&coupled, step, ((0.0, PUSHING, 0.0), 0.04), (5e-3, 8.0), |_| aim);
            range(found[found.len() - 500..].iter().map(|(place, _)| *place)) < 1e-6 * STEP
        })
    };
    let (mut low, mut high) = (500.0_f64, 4000.0);
    for _ in 0..8 {
        let middle = (low * high).sqrt();
        if rests(middle) { low = middle } else { high = middle }
    }
    (low * high).sqrt()
}

/// The stiffest spring that comes to rest is that of readings, within the lower of the two conditions of
/// theory, 2 b/T and 2 f_c/Δ: 2,000 and 2,667 N/m.
#[test]
fn friction_absorbs_estimates_as_it_absorbs_readings() {
    let (readings, estimates) = (stiffest(0.0), stiffest(STEP));
    assert!((readings / 2000.0 - 1.0).abs() < 0.05, "{readings} N/m");
    assert!((estimates / readings - 1.0).abs() < 0.05, "{estimates} of {readings} N/m");
}

/// Swing of the force (N) in front of a wall that a soft hand pushes a handle without friction to: the widest
/// of eight places in a cell.
fn widest(coupled: &Coupled, step: f64, hand: Held) -> f64 {
    let swing = |part: u32| {
        let depth = 5e-3 + f64::from(part) * 0.37 * STEP;
        let aim = |time: f64| -depth * (1.0 - (-time / 0.2).exp());
        let found = handle(coupled, step, (hand, 0.0), (0.0, 4.0), aim);
        range(found[3000..].iter().map(|(_, force)| *force))
    };
    (0..8).map(swing).fold(0.0, f64::max)
}

/// A handle without friction swings by about a step of its encoders on readings. On estimates the force
/// swings by less, with stiffness and damping as chosen for each delay, where a hand damps the handle. Where
/// nothing but its own viscous damping does, it may swing by two steps. With the damping that
/// is critical for a heavy body, whose lag is long, it would swing twice as far as on readings.
#[test]
fn estimates_let_a_handle_swing_by_less_than_readings() {
    let (released, hands) = ((0.0, 100.0, 0.0), [(2.0, 100.0, 0.05), (5.0, 300.0, 0.1)]);
    for mass in [1e-3, 1e-2, 0.1, 1.0, 10.0] {
        for delay in [0, 1, 2, 5] {
            let coupled = Coupled::to(mass, 400.0 / (1.0 + 2.0 * delay as f64), delay);
            assert!(coupled.lag <= LONGEST_LAG, "{mass} kg, {delay} ms: {} s", coupled.lag);
            for hand in hands {
                let (estimates, readings) = (widest(&coupled, STEP, hand), widest(&coupled, 0.0, hand));
                let within = estimates <= 0.8 * readings + 1e-9;
                assert!(within, "{mass} kg, {delay} ms, hand {hand:?}: {estimates} of {readings} N");
            }
            let estimates = widest(&coupled, STEP, released);
            let most = if mass < 0.5 { 0.05 } else { 0.1 };
            assert!(estimates <= most, "{mass} kg, {delay} ms: {estimates} N");
        }
    }
    let heavy = Coupled { told: PERIOD, ..Coupled::critical(10.0, 400.0, 0) };
    let (estimates, readings) = (widest(&heavy, STEP, released), widest(&heavy, 0.0, released));
    assert!(heavy.lag > LONGEST_LAG && estimates > 2.0 * readings, "{estimates} of {readings} N");
}

/// A handle that fingertips slide evenly swings by less than half a step.
#[test]
fn a_sliding_handle_does_not_swing_up() {
    for mass in [1e-3, 1e-2, 0.1, 0.2] {
        let coupled = Coupled::to(mass, 500.0, 0);
        assert!(coupled.lag <= LONGEST_LAG);
        for speed in [2e-3, 2e-2, 1e-1] {
            let aim = |time: f64| speed * time;
            let found = handle(&coupled, STEP, ((2.0, 100.0, 0.05), 0.04), (0.0, 8.0), aim);
            // The second difference over 20 ms of what is not a parabola.
            let place = |at: &(f64, f64)| at.0;
            let bends = found[4000..]
                .windows(61)
                .map(|w| (place(&w[0]) - 3.0 * place(&w[20]) + 3.0 * place(&w[40]) - place(&w[60])) / 8.0);
            let (mut sum, mut count) = (0.0, 0.0);
            for bend in bends {
                (sum, count) = (sum + bend * bend, count + 1.0);
            }
            let swing = f64::sqrt(sum / count);
            assert!(swing < 0.5 * STEP / 2_f64.sqrt(), "{mass} kg, {speed} m/s: {swing} m rms");
        }
    }
}

/// A velocity through a lag, of the positions at each period.
fn lagged(positions: impl Iterator<Item = f64>, lag: f64) -> Vec<f64> {
    let (mut last, mut velocity) = (f64::NAN, 0.0);
    let next = |position: f64| {
        let moved = position - std::mem::replace(&mut last, position);
        if !moved.is_nan() {
            velocity += (moved / PERIOD - velocity) * PERIOD / (lag + PERIOD);
        }
        velocity
    };
    positions.map(next).collect()
}

/// The velocity that a damper gets from estimates is that which it would get from the true positions, through
/// the same lag: in slow and fast motion to a small part of the error of readings, and always, at a start, a
/// stop and a turn too, within the change by an encoder step, Δ/(τ + T). The lag that the passivity of the
/// port counts on is nearly the whole lag: a tremor of a few steps is estimated less than a millisecond late.
#[test]
fn velocities_are_true_and_lag_by_no_more() {
    let off = |motion: &dyn Fn(f64) -> f64| {
        let positions: Vec<f64> = (0..3000).map(|i| motion(f64::from(i) * PERIOD)).collect();
        let mut axis = Axis::new(STEP, LAG, positions[0]);
        let estimates: Vec<f64> = positions.iter().map(|position| axis.read(*position)).collect();
        let truth = lagged(positions.iter().copied(), LAG);
        let errors = |positions: &mut dyn Iterator<Item = f64>| {
            let errors = lagged(positions, LAG).into_iter().zip(&truth).map(|(found, true_)| found - true_);
            errors.collect::<Vec<_>>()
        };
        let (found, read) =
            (errors(&mut estimates.iter().copied()), errors(&mut positions.iter().map(|at| rounded(*at))));
        let rms = |of: &[f64]| (of[500..].iter().map(|off| off * off).sum::<f64>() / 2500.0).sqrt();
        let worst = found.iter().fold(0.0, |worst: f64, off| worst.max(off.abs()));
        (rms(&found), rms(&read), worst)
    };
    let most = STEP / (LAG + PERIOD);
    for speed in [1.1e-3, 1.23e-2, 5.01e-2, 0.1999] {
        let (found, read, worst) = off(&|time| speed * time);
        assert!(found < 0.3 * read && worst <= most, "{speed} m/s: {found} and {read}, at most {worst} m/s");
    }
    let reversing = |time: f64| 0.05 * (time % 1.0 - 0.5).abs();
    let stopping = |time: f64| 0.03 * time.min(1.1) + 0.01 * (time - 2.0).max(0.0);
    let braking = |time: f64| if time < 1.0 { 0.2 * time - 0.1 * time * time } else { 0.1 };
    for motion in [&reversing as &dyn Fn(f64) -> f64, &stopping, &braking] {
        let (found, read, worst) = off(motion);
        assert!(found < 0.6 * read && worst <= 1.5 * most, "{found} and {read}, at most {worst} m/s");
    }
    // The phase of a tremor, by its correlation with sine and cosine.
    for (amplitude, rate) in [(1e-4, 8.0), (1e-3, 8.0), (1e-3, 20.0)] {
        let mut axis = Axis::new(STEP, LAG, 0.0);
        let (mut sine, mut cosine) = (0.0, 0.0);
        for i in 1..=3000 {
            let phase = TAU * rate * f64::from(i) * PERIOD;
            let found = axis.read(amplitude * phase.sin());
            if i > 1000 {
                (sine, cosine) = (sine + found * phase.sin(), cosine + found * phase.cos());
            }
        }
        let (late, size) = (-cosine.atan2(sine) / (TAU * rate), sine.hypot(cosine) / 1000.0);
        assert!(late.abs() < 1e-3 && (size / amplitude - 1.0).abs() < 0.1, "{late} s, {size} m");
    }
}
