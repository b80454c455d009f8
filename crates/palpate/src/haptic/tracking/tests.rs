//! Sequences of device readings with known outcomes.

use palpate_core::glam::DQuat;

use super::*;

const PERIOD: f64 = 1e-3;

fn tracking(lags: (f64, f64)) -> Tracking {
    Tracking::new(reading(0.0, 0.0), lags, PERIOD)
}

/// A reading at a time (s) with the handle at x (m).
fn reading(time: f64, x: f64) -> DeviceState {
    let pose = Pose::new(DVec3::X * x, DQuat::IDENTITY);
    DeviceState { time, pose, twist: Twist::new(DVec3::Y, DVec3::ZERO), buttons: 0, status: Status::OK }
}

/// Takes `count` readings of a handle that moves at a speed (m/s), from a step on, and returns the outcome of
/// the last.
fn move_on(tracking: &mut Tracking, from: u32, count: u32, speed: f64) -> Reading {
    let mut events = Events::default();
    let mut last = Reading::Lost;
    for step in from..from + count {
        let time = PERIOD * f64::from(step);
        last = tracking.take(Some(&reading(time, speed * time)), PERIOD, &mut events);
    }
    assert_eq!(events, Events::default());
    last
}

#[test]
fn the_first_reading_has_no_displacement_and_the_next_are_good() {
    let mut tracking = tracking((0.0, 0.0));
    assert_eq!(move_on(&mut tracking, 1, 1, 0.1), Reading::Back);
    assert_eq!(tracking.displacement().linear, DVec3::ZERO);
    assert_eq!(move_on(&mut tracking, 2, 1, 0.1), Reading::Good);
    assert!((tracking.displacement().linear.x - 1e-4).abs() < 1e-12);
    // Without a lag the velocity is the device's own.
    assert_eq!(tracking.damped_state().twist.linear, DVec3::Y);
}

/// With a lag τ the velocity is that of positions through a first-order filter: 1 − (1 + T/τ)⁻ⁿ of it after n
/// periods T.
#[test]
fn the_velocity_has_the_given_lag() {
    let (lag, speed) = (5e-3, 0.2);
    let mut tracking = tracking((lag, lag));
    move_on(&mut tracking, 1, 1, speed);
    for n in 1..50 {
        move_on(&mut tracking, 1 + n, 1, speed);
        let wanted = speed * (1.0 - (1.0 + PERIOD / lag).powi(-(n as i32)));
        let found = tracking.damped_state().twist.linear;
        assert!((found.x - wanted).abs() < 1e-9 && found.y == 0.0, "period {n}: {found}, not {wanted}");
    }
}

/// Readings that are not finite, that the driver holds, or that no hand could make are replaced by the last
/// good one, at rest; after 10 ms the device counts as lost.
#[test]
fn bad_readings_are_held_and_then_lost() {
    let mut held = reading(0.0, 0.0);
    held.status = Status::HELD;
    let mut broken = reading(0.0, f64::NAN);
    broken.pose.translation.y = f64::INFINITY;
    for bad in [held, broken, reading(0.05, 0.5)] {
        let mut tracking = tracking((1e-3, 1e-3));
        move_on(&mut tracking, 1, 20, 0.1);
        let last = tracking.state().pose;
        let mut events = Events::default();
        for n in 1..=20 {
            // The pose keeps jumping, so that it is never accepted.
            let mut state = bad;
            state.pose.translation.x += f64::from(n % 2);
            let found = tracking.take(Some(&state), PERIOD, &mut events);
            // At 10 ms itself rounding decides.
            assert!(n == 10 || found == if n < 10 { Reading::Held } else { Reading::Lost }, "reading {n}");
            assert_eq!((tracking.state().pose, tracking.state().twist), (last, Twist::ZERO));
            assert_eq!(*tracking.displacement(), Twist::ZERO);
        }
        assert_eq!(events.device_refused + events.device_jumped, 20);
    }
}

#[test]
fn a_device_that_does_not_answer_is_lost_at_once() {
    let mut tracking = tracking((0.0, 0.0));
    move_on(&mut tracking, 1, 5, 0.1);
    let mut events = Events::default();
    assert_eq!(tracking.take(None, PERIOD, &mut events), Reading::Lost);
    assert_eq!(events.device_refused, 1);
    assert_eq!(tracking.take(Some(&reading(7e-3, 7e-4)), PERIOD, &mut events), Reading::Back);
}

/// A pose that the device has jumped to is accepted after five readings there, without a displacement.
#[test]
fn a_lasting_jump_is_accepted() {
    let mut tracking = tracking((0.0, 0.0));
    move_on(&mut tracking, 1, 10, 0.0);
    let mut events = Events::default();
    for n in 1..=5 {
        let state = reading(0.01 + PERIOD * f64::from(n), 1.0);
        let found = tracking.take(Some(&state), PERIOD, &mut events);
        assert_eq!(found, if n < 5 { Reading::Held } else { Reading::Back }, "reading {n}");
    }
    assert_eq!(tracking.state().pose.translation.x, 1.0);
}

/// A reading with the stamp of the one before keeps the velocity for 25 ms.
#[test]
fn a_stale_reading_holds_the_velocity() {
    let mut tracking = tracking((1e-3, 1e-3));
    move_on(&mut tracking, 1, 50, 0.1);
    let (velocity, last) = (tracking.damped_state().twist, *tracking.state());
    let mut events = Events::default();
    for n in 1..=30 {
        let found = tracking.take(Some(&last), PERIOD, &mut events);
        if n < 25 {
            assert_eq!((found, tracking.damped_state().twist), (Reading::Stale, velocity), "reading {n}");
        } else if n > 25 {
            assert_eq!(found, Reading::Lost, "reading {n}");
        }
    }
    assert_eq!(events.device_stale, 30);
}

/// Between encoder steps the pose is estimated, in the cell of the reading, and the velocity is that of the
/// estimates. A device that is held stays where it was estimated; one that comes back is where it is read.
#[test]
fn motion_is_estimated_between_the_steps() {
    let (step, turn, lag) = (3e-5, 1e-3, 3e-3);
    let at = |n: u32| {
        let (x, angle) = (1.3e-5 * f64::from(n), 0.4e-3 * f64::from(n));
        let rounded = |value: f64, step: f64| (value / step).round() * step;
        let mut state = reading(PERIOD * f64::from(n), rounded(x, step));
        state.pose.rotation = DQuat::from_rotation_y(rounded(angle, turn));
        (state, x, DQuat::from_rotation_y(angle))
    };
    for estimated in [true, false] {
        let steps = if estimated { (step, turn) } else { (0.0, 0.0) };
        let mut tracking = tracking((lag, lag)).between_steps(steps);
        let mut events = Events::default();
        let mut worst = (0.0_f64, 0.0_f64, 0.0_f64);
        for n in 0..600 {
            let (state, x, rotation) = at(n);
            tracking.take(Some(&state), PERIOD, &mut events);
            let found = tracking.damped_state();
            assert!((found.pose.translation.x - state.pose.translation.x).abs() <= 0.5001 * step);
            assert!(found.pose.rotation.angle_between(state.pose.rotation) <= 0.5001 * turn);
            if n > 300 {
                let turned = found.pose.rotation.angle_between(rotation);
                worst.0 = worst.0.max((found.pose.translation.x - x).abs() / step);
                worst.1 = worst.1.max(turned / turn);
                worst.2 = worst.2.max((found.twist.linear.x - 0.013).abs() / 0.013);
            }
        }
        let close = worst.0 < 0.3 && worst.1 < 0.3 && worst.2 < 0.1;
        assert_eq!(close, estimated, "{worst:?}");
        assert_eq!(tracking.state().pose, at(599).0.pose);

        let last = tracking.damped_state().pose;
        let mut held = at(600).0;
        held.status = Status::HELD;
        assert_eq!(tracking.take(Some(&held), PERIOD, &mut events), Reading::Held);
        assert_eq!((tracking.damped_state().pose, tracking.damped_state().twist), (last, Twist::ZERO));
        assert_eq!(tracking.take(None, PERIOD, &mut events), Reading::Lost);
        assert_eq!(tracking.take(Some(&at(603).0), PERIOD, &mut events), Reading::Back);
        assert_eq!(tracking.damped_state().pose, at(603).0.pose);
    }
}

#[test]
fn the_worse_of_two_ports_counts() {
    use Reading::{Back, Good, Held, Lost, Stale};
    for (one, other, worse) in
        [(Good, Good, Good), (Stale, Good, Good), (Good, Held, Held), (Back, Held, Back), (Lost, Back, Lost)]
    {
        assert_eq!((one.or_worse(other), other.or_worse(one)), (worse, worse));
    }
}
