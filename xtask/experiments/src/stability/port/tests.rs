//! Tests of the judging against theory, and of its negative controls.

use palpate::device::Emulation;
use palpate::glam::DVec3;
use palpate::{Pose, Wrench};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::super::conditions::SampledWall;
use super::ball::BallOnTable;
use super::boundary::Case;
use super::certificate::{Certificate, left};
use super::driven::{PERIOD, Port};
use super::hands::{self, Genes};
use super::multisine::{self, C64, Design, Matrix};
use super::passivity::{measure, sessions};
use super::states::{Conditions, Scenery, State};

/// A spring along x, y and z, and about them.
struct Spring(f64, f64);

impl Port for Spring {
    fn step(&mut self, handle: &Pose) -> Wrench {
        let turn = Pose::IDENTITY.rotation_vector_to(handle);
        Wrench::new(handle.translation * -self.0, turn * -self.1)
    }
}

/// b > K (T/2 + t_d), and the same about the axes, however the delay divides the period.
#[test]
fn a_spring_needs_the_damping_of_theory() {
    let handle = Emulation::default().handle;
    for delay in [0.0, 1e-3, 2.5e-3] {
        let wall = SampledWall {
            device_damping: handle.damping,
            friction: 0.0,
            stiffness: 0.0,
            damping: 0.0,
            lag: 0.0,
            period: PERIOD,
            delay,
            quantum: 0.0,
        };
        let limit = wall.stiffest_passive();
        for (share, passive) in [(0.97, true), (1.03, false)] {
            let mut spring = Spring(share * limit, 0.0);
            let response =
                multisine::measure(&mut spring, &Pose::IDENTITY, &Design { amplitude: 1e-5, sets: 3 }, 1);
            let found = Certificate::of(&response, &handle, delay);
            assert_eq!(found.holds(), passive, "delay {delay}, {share} of the limit: {found:?}");
            assert!(found.noise < 1e-6, "{found:?}");
        }
    }
}

/// A steady torque is no stiffness: its work depends on the way only to third order.
#[test]
fn a_steady_torque_gives_a_symmetric_response() {
    struct Steady;
    impl Port for Steady {
        fn step(&mut self, _: &Pose) -> Wrench {
            Wrench::new(DVec3::ZERO, DVec3::new(0.1, -0.05, 0.02))
        }
    }
    let design = Design { amplitude: 1e-5, sets: 3 };
    let response = multisine::measure(&mut Steady, &Pose::IDENTITY, &design, 3);
    let found = Certificate::of(&response, &Emulation::default().handle, 0.0);
    // Without the correction the response is the antisymmetric matrix of the torque itself, 0.1 N·m/rad.
    let largest = response.samples[0][0].iter().map(|entry| entry.norm()).fold(0.0, f64::max);
    assert!(largest < 0.06, "{largest}");
    assert!(found.largest_noise < 1.0, "{found:?}");
}

/// A spring whose force is off by something random at each step, in the first half of a second by much.
struct Noisy {
    rng: StdRng,
    steps: usize,
}

impl Noisy {
    const STIFFNESS: f64 = 50.0;

    fn new(seed: u64) -> Self {
        Self { rng: StdRng::seed_from_u64(seed), steps: 0 }
    }
}

impl Port for Noisy {
    fn step(&mut self, handle: &Pose) -> Wrench {
        self.steps += 1;
        let size = if self.steps < 500 { 1.0 } else { 1e-4 };
        let mut any = || self.rng.random_range(-size..=size);
        let off = DVec3::new(any(), any(), any());
        Wrench::new(handle.translation * -Self::STIFFNESS + off, DVec3::ZERO)
    }
}

/// Sessions are measured until the noise is small enough, as far as the first one tells how many it takes.
#[test]
fn more_sessions_bring_the_noise_down_to_what_is_allowed() {
    assert_eq!(sessions(0.0), 1);
    assert_eq!(sessions(1.0), 1);
    assert_eq!(sessions(1.001), 5, "half of what is allowed needs four times the samples");
    assert_eq!(sessions(100.0), 8, "not without end");
    assert_eq!(sessions(f64::INFINITY), 8);
    let handle = Emulation::default().handle;
    let design = Design { amplitude: 1e-5, sets: 3 };
    let part = |seed| multisine::measure(&mut Noisy::new(seed), &Pose::IDENTITY, &design, seed);
    let mut response = part(1);
    let first = Certificate::of(&response, &handle, 0.0).largest_noise;
    // What is off by much, before anything is measured, counts for nothing.
    assert!(first > 0.0 && first < 0.5, "{first}");
    (2..=16).for_each(|seed| response.add(part(seed)));
    let all = Certificate::of(&response, &handle, 0.0).largest_noise;
    assert!((0.15..0.35).contains(&(all / first)), "{first} of one session, {all} of sixteen");
    assert_eq!(response.samples[0].len(), 48);
}

#[test]
fn the_damping_left_without_a_session_is_all() {
    let handle = Emulation::default().handle;
    let none = left(&Matrix::zeros(), 100.0, &handle, 1.5e-3);
    assert!((none - Matrix::identity()).norm() < 1e-12);
    let spring = left(&Matrix::from_diagonal_element(C64::from(100.0)), 100.0, &handle, 0.0);
    // 1 − K T/(2 b) along the axes.
    assert!((spring[(0, 0)].re - 0.95).abs() < 1e-9, "{spring}");
}

/// Without a damper the exact limit of a light handle without a push is b = K (T/2 + t_d) (Gil et al. 2009).
#[test]
fn the_exact_limit_is_that_of_theory() {
    for delay in [0.0, 1e-3, 5e-3] {
        let case = Case { mass: 0.3, device_damping: 0.2, damping: 0.0, delay };
        let theory = case.device_damping / (0.5 * PERIOD + delay);
        let found = case.limit();
        assert!((found / theory - 1.0).abs() < 0.15, "delay {delay}: {found} of {theory}");
    }
}

/// A pressed ball is felt as the coupling and leaves the port passive; where the session is not told of the
/// device's delay, the same measurement finds that the port is not.
#[test]
fn a_pressed_ball_is_passive_with_the_delay_that_the_session_is_told() {
    let BallOnTable { ball, scene } = BallOnTable::new().unwrap();
    let scenery = [Scenery { name: "ball", held: ball, scene }];
    let start = BallOnTable::above(1e-4);
    let state = State { scenery: 0, start, way: (DVec3::NEG_Z, DVec3::ZERO), press: 0.5 };
    let delay = 5e-3;
    for (told_delay, passive) in [(delay, true), (0.0, false)] {
        let at = Conditions { delay, told_delay, encoders: false, rate: 100.0, friction: 0.0 };
        let found = measure(&state, &scenery, &at).unwrap().expect("the ball touches the table");
        assert_eq!(found.certificate.holds(), passive, "told {told_delay} s: {found:?}");
        assert!(found.certificate.largest_noise < 0.1, "{found:?}");
        assert!(found.rendered.deviation < 0.05, "{found:?}");
    }
}

#[test]
fn a_session_is_stable_up_to_the_exact_limit() {
    let pressed = BallOnTable::new().unwrap();
    let case = Case { mass: 0.075, device_damping: 1.0, damping: 5.0, delay: 1e-3 };
    for (share, settles) in [(0.95, true), (1.05, false)] {
        assert_eq!(case.settles(share * case.limit(), &pressed), Ok(settles), "{share} of the limit");
    }
}

#[test]
fn hands_draw_energy_from_a_coupling_that_is_too_stiff_alone() {
    let pressed = BallOnTable::new().unwrap();
    let drawn = |stiffness| {
        let hold = (0..10).filter(|&seed| Genes::random(seed).run(&pressed, stiffness).unwrap().holds());
        10 - hold.count()
    };
    assert_eq!(drawn(None), 0);
    assert!(drawn(Some(hands::too_stiff())) > 0);
}
