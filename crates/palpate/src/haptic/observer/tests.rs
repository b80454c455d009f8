//! Known motions whose readings are rounded to steps, compared with the motions; and a handle with friction,
//! simulated plainly.

use std::f64::consts::TAU;

use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::*;

const STEP: f64 = 3e-5;
const PERIOD: f64 = 1e-3;

/// An observer of one axis, with the readings before.
struct Axis {
    observer: StepObserver,
    reading: f64,
    estimate: f64,
}

impl Axis {
    /// Starts at a position, m. With a `step` of 0 the readings are rounded and the estimates are readings.
    fn new(step: f64, position: f64) -> Self {
        let reading = rounded(position);
        Self { observer: StepObserver::new(step), reading, estimate: reading }
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
    let (mut axis, mut sums, mut largest) = (Axis::new(STEP, motion(0.0)), (0.0, 0.0), 0.0_f64);
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
        assert!(found < 0.15 * STEP && read > 0.2 * STEP, "{speed} m/s: {found} and {read} m");
    }
    for (amplitude, rate) in [(5e-3, 0.2), (2e-2, 0.5), (6e-2, 0.53)] {
        let (found, read, _) = errors(|time| amplitude * (TAU * rate * time).sin());
        assert!(found < 0.16 * STEP && read > 0.25 * STEP, "{rate} Hz: {found} and {read} m");
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
        let (mut observer, mut exact) = (StepObserver::new(STEP), StepObserver::new(0.0));
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
    let mut axis = Axis::new(STEP, 0.0);
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
    let mut axis = Axis::new(STEP, 0.0);
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

/// A coupling to a body that stands still at 0: stiffness, damping (N/m, N·s/m), and the damper's lag, s.
#[derive(Clone, Copy)]
struct Coupled {
    stiffness: f64,
    damping: f64,
    lag: f64,
}

/// Damping of a hand, its stiffness and its mass, N·s/m, N/m and kg.
type Held = (f64, f64, f64);

/// Positions of a Phantom Premium's handle at each period, pulled by a hand that aims at `aim` (m), and held
/// by a coupling on estimates, or on readings with a `step` of 0.
fn handle(coupled: &Coupled, step: f64, hand: Held, start: f64, aim: impl Fn(f64) -> f64) -> Vec<f64> {
    const SUBSTEPS: u32 = 50;
    let (mass, damping, friction) = (0.075 + hand.2, 1.0, 0.04);
    let dt = PERIOD / f64::from(SUBSTEPS);
    let (mut place, mut speed, mut lagged) = (start, 0.0, 0.0);
    let mut axis = Axis::new(step, place);
    let mut places = Vec::with_capacity(8000);
    for period in 0..8000 {
        let before = axis.estimate;
        let found = axis.read(place);
        lagged += ((found - before) / PERIOD - lagged) * PERIOD / (coupled.lag + PERIOD);
        let force = -coupled.stiffness * found - coupled.damping * lagged;
        for substep in 0..SUBSTEPS {
            let time = (f64::from(period) + f64::from(substep) / f64::from(SUBSTEPS)) * PERIOD;
            let aimed = (aim(time + dt) - aim(time)) / dt;
            let momentum: f64 = mass * speed + dt * (force + hand.1 * (aim(time) - place) + hand.0 * aimed);
            let slides = (1.0 - friction * dt / momentum.abs()).max(0.0);
            speed = momentum * slides / (mass + dt * (damping + hand.0 + dt * hand.1));
            place += dt * speed;
        }
        places.push(place);
    }
    places
}

/// Stiffest spring that friction brings to rest, N/m, for pushes between the forces of two steps.
fn stiffest(step: f64) -> f64 {
    const PUSHING: f64 = 20.0;
    let rests = |stiffness: f64| {
        let coupled = Coupled { stiffness, damping: 0.0, lag: PERIOD };
        (0..4).all(|part| {
            let steps = (0.02 / STEP).floor() + f64::from(part) / 4.0;
            let aim = -steps * STEP * (stiffness + PUSHING) / PUSHING;
            let places = handle(&coupled, step, (0.0, PUSHING, 0.0), 5e-3, |_| aim);
            let last = &places[places.len() - 500..];
            let least = last.iter().copied().fold(f64::INFINITY, f64::min);
            last.iter().copied().fold(f64::NEG_INFINITY, f64::max) - least < 1e-6 * STEP
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

/// A handle that fingertips slide evenly, with a heavy body on it, swings by less than half a step. With a
/// slower tracker it swings further: a lag asks for 0.38 (K + B/(τ + T))/ω of damping, and handle and fingers
/// have 3 N·s/m.
#[test]
fn a_sliding_handle_does_not_swing_up() {
    let coupled = Coupled { stiffness: 500.0, damping: 141.0, lag: 0.281 };
    for speed in [2e-3, 2e-2, 1e-1] {
        let places = handle(&coupled, STEP, (2.0, 100.0, 0.05), 0.0, |time| speed * time);
        // The second difference over 20 ms of what is not a parabola.
        let bends = places[4000..].windows(61).map(|w| (w[0] - 3.0 * w[20] + 3.0 * w[40] - w[60]) / 8.0);
        let (mut sum, mut count) = (0.0, 0.0);
        for bend in bends {
            (sum, count) = (sum + bend * bend, count + 1.0);
        }
        let swing = f64::sqrt(sum / count);
        assert!(swing < 0.5 * STEP / 2_f64.sqrt(), "{speed} m/s: {swing} m rms");
    }
}
