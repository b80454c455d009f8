use std::f64::consts::PI;
use std::ops::{Add, Mul};

use glam::{DMat3, DVec3};
use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

use super::*;

/// Values of a Phantom Premium.
fn limits(sampling: Sampling) -> PortLimits {
    PortLimits {
        translation: PortAxes {
            stiffness: 800.0,
            damping: 2.0,
            viscous: Some(1.0),
            friction: Some(0.04),
            peak: 8.5,
            step: 3e-5,
        },
        rotation: PortAxes {
            stiffness: 0.3,
            damping: 0.002,
            viscous: Some(1e-3),
            friction: Some(1e-3),
            peak: 0.188,
            step: 1e-4,
        },
        lever: 0.0,
        sampling,
    }
}

fn sampling(period: f64, delay: f64) -> Sampling {
    Sampling { period, delay, velocity_delay: 3e-3 }
}

#[derive(Clone, Copy)]
struct Complex(f64, f64);

impl Complex {
    fn real(x: f64) -> Self {
        Self(x, 0.0)
    }

    fn turned(angle: f64) -> Self {
        Self(angle.cos(), angle.sin())
    }

    fn square(self) -> f64 {
        self.0 * self.0 + self.1 * self.1
    }

    fn inverse(self) -> Self {
        Self(self.0 / self.square(), -self.1 / self.square())
    }
}

impl Add for Complex {
    type Output = Self;
    fn add(self, b: Self) -> Self {
        Self(self.0 + b.0, self.1 + b.1)
    }
}

impl Mul for Complex {
    type Output = Self;
    fn mul(self, b: Self) -> Self {
        Self(self.0 * b.0 - self.1 * b.1, self.0 * b.1 + self.1 * b.0)
    }
}

/// (1 − z⁻¹)/T at an angle ωT, and H of a spring and a damper on it through a lag.
fn law(stiffness: f64, damping: f64, lag: f64, period: f64, angle: f64) -> (Complex, Complex) {
    let gain = period / (lag + period);
    let back = Complex::turned(-angle);
    let rate = (Complex::real(1.0) + back * Complex::real(-1.0)) * Complex::real(1.0 / period);
    let pole = Complex::real(1.0) + back * Complex::real(gain - 1.0);
    (rate, Complex::real(stiffness) + rate * pole.inverse() * Complex::real(damping * gain))
}

/// q of a law, and σ.
fn late(law: Complex, sampling: &Sampling, angle: f64) -> (Complex, Complex) {
    let Sampling { period, delay, .. } = *sampling;
    let whole = (delay / period + 1e-9).floor();
    let part = (delay / period - whole).max(0.0);
    let back = Complex::turned(-angle);
    // 1 − z⁻¹ and the square of its size, 2 (1 − cos ωT), without cancellation.
    let half = (0.5 * angle).sin();
    let difference = Complex(2.0 * half * half, angle.sin());
    let size = Complex::real(period / (4.0 * half * half));
    (
        size * difference * Complex::turned(-whole * angle) * law,
        Complex::real(1.0 - part) + back * Complex::real(part),
    )
}

/// The right-hand side of the general condition for a law, by its definition in complex numbers.
fn needed_at(law: Complex, sampling: &Sampling, angle: f64) -> f64 {
    let (q, sigma) = late(law, sampling, angle);
    let real = (q * sigma).0;
    0.5 * (real + (real * real + q.square() * (1.0 - sigma.square()).max(0.0)).sqrt())
}

/// Angles ωT up to half the sampling rate, closer where they are small.
fn angles(count: u32) -> impl Iterator<Item = f64> {
    (1..=count).map(move |i| PI * (f64::from(i) / f64::from(count)).powf(1.5))
}

/// Largest damping that spring and lagged damper need at any frequency.
fn needed(stiffness: f64, damping: f64, lag: f64, sampling: &Sampling) -> f64 {
    angles(2000)
        .map(|angle| needed_at(law(stiffness, damping, lag, sampling.period, angle).1, sampling, angle))
        .fold(f64::NEG_INFINITY, f64::max)
}

/// Delays of zero, whole periods, and parts of periods.
fn random_delay(rng: &mut StdRng, kind: usize, period: f64) -> f64 {
    period
        * match kind % 5 {
            0 => 0.0,
            1 => f64::from(rng.random_range(1..6)),
            2 => rng.random_range(0.0..1.0),
            3 => rng.random_range(0.0..10.0),
            _ => rng.random_range(10.0..50.0),
        }
}

#[test]
fn without_delay_the_closed_form_is_the_worst_frequency_of_the_general_condition() {
    let seed = 71;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..500 {
        let (stiffness, damping) = (rng.random_range(0.0..3000.0), rng.random_range(0.0..50.0));
        let sampling = sampling(10_f64.powf(rng.random_range(-4.0..-2.0)), 0.0);
        let lag = if case % 5 == 0 { 0.0 } else { 10_f64.powf(rng.random_range(-4.5..-1.0)) };
        let closed = PortAxes::needed_viscous(stiffness, damping, lag, &sampling);
        let worst = needed(stiffness, damping, lag, &sampling);
        assert!((worst / closed - 1.0).abs() < 1e-9, "seed {seed}, case {case}: {worst}, {closed}");
    }
}

#[test]
#[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
fn with_a_delay_the_bound_is_above_the_general_condition_and_near_it() {
    let seed = 75;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut of_springs, mut of_long_lags, mut of_all) = (f64::INFINITY, f64::INFINITY, f64::INFINITY);
    for case in 0..1500 {
        let period = 10_f64.powf(rng.random_range(-4.0..-2.0));
        let sampling = sampling(period, random_delay(&mut rng, case, period));
        let stiffness = rng.random_range(0.0..3000.0);
        let damping = if case % 3 == 0 { 0.0 } else { rng.random_range(0.0..50.0) };
        let lag = if case % 7 == 0 { 0.0 } else { 10_f64.powf(rng.random_range(-4.5..-0.5)) };
        let bound = PortAxes::needed_viscous(stiffness, damping, lag, &sampling);
        let share = needed(stiffness, damping, lag, &sampling) / bound;
        assert!(share < 1.0 + 1e-9, "seed {seed}, case {case}: {share} of {bound}, {sampling:?}, lag {lag}");
        of_all = of_all.min(share);
        if damping == 0.0 {
            of_springs = of_springs.min(share);
        } else if lag > 30.0 * sampling.effective_delay() {
            of_long_lags = of_long_lags.min(share);
        }
    }
    println!(
        "least share of the bound: springs {of_springs:.4}, long lags {of_long_lags:.3}, all {of_all:.3}"
    );
    assert!(of_springs > 0.994 && of_long_lags > 0.75 && of_all > 0.4);
}

#[test]
fn a_delay_needs_more_damping() {
    let at = |delay| needed(400.0, 5.0, 10e-3, &sampling(1e-3, delay));
    let none = PortAxes::needed_viscous(400.0, 5.0, 10e-3, &sampling(1e-3, 0.0));
    assert!(at(0.0) <= none * (1.0 + 1e-9));
    assert!(at(2e-3) > 3.0 * none, "{} of {none}", at(2e-3));
}

/// A body between the coupling and a free world is in series with it.
#[test]
fn a_free_body_needs_no_more_than_one_that_stands_still() {
    let seed = 76;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..600 {
        let period = 10_f64.powf(rng.random_range(-4.0..-2.0));
        let sampling = sampling(period, random_delay(&mut rng, case, period));
        let mass = 10_f64.powf(rng.random_range(-4.0..2.0));
        let body = Body::new(mass, DMat3::from_diagonal(DVec3::splat(1e-4 * mass))).unwrap();
        let limits = limits(sampling);
        let coupling = VirtualCoupling::auto(&body, Pose::IDENTITY, &limits);
        let (stiffness, damping) = (coupling.linear_stiffness, coupling.linear_damping);
        let (lag, _) = limits.velocity_lags(&coupling);
        let lag = lag.max(sampling.velocity_delay);
        for angle in angles(1000) {
            let (rate, law) = law(stiffness, damping, lag, period, angle);
            let inertia = rate * rate * Complex::real(mass);
            let held = Complex::real(stiffness) + rate * Complex::real(damping);
            let series = law * (Complex::real(1.0) + held * inertia.inverse()).inverse();
            let needed = needed_at(series, &sampling, angle);
            assert!(needed < 0.9 + 1e-6, "seed {seed}, case {case}: {needed} at {angle}, {sampling:?}");
        }
    }
}

fn random_body(rng: &mut StdRng) -> (Body, f64) {
    let mass = 10_f64.powf(rng.random_range(-4.0..2.0));
    let size = 10_f64.powf(rng.random_range(-2.5..0.0));
    let inertia = DMat3::from_diagonal(DVec3::new(0.3, 0.9, 1.0)) * (0.1 * mass * size * size);
    (Body::new(mass, inertia).unwrap(), size)
}

#[test]
fn auto_gains_are_passive_for_every_mass_rate_and_delay() {
    let seed = 72;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..2000 {
        let (body, size) = random_body(&mut rng);
        let period = 1.0 / rng.random_range(100.0..10_000.0);
        let sampling = sampling(period, random_delay(&mut rng, case, period));
        let limits = limits(sampling).in_world(10_f64.powf(rng.random_range(-2.0..2.0)));
        let grasp = Pose::from_translation(DVec3::X * rng.random_range(0.0..size));
        let coupling = VirtualCoupling::auto(&body, grasp, &limits);
        let (lag, angular_lag) = limits.velocity_lags(&coupling);
        for (axes, stiffness, damping, lag) in [
            (limits.translation, coupling.linear_stiffness, coupling.linear_damping, lag),
            (limits.rotation, coupling.angular_stiffness, coupling.angular_damping, angular_lag),
        ] {
            let lag = if lag == 0.0 { sampling.velocity_delay } else { lag };
            let needed = PortAxes::needed_viscous(stiffness, damping, lag, &sampling);
            let has = axes.viscous.unwrap();
            assert!(needed <= 0.9 * has * (1.0 + 1e-9), "seed {seed}, case {case}: {needed} of {has}");
            assert!(stiffness <= axes.friction.unwrap() / axes.step * (1.0 + 1e-12));
            let answer = (stiffness + damping / (lag + period)) * axes.step;
            assert!(answer <= 1.8 * axes.friction.unwrap() * (1.0 + 1e-9), "seed {seed}, case {case}");
            assert!(stiffness <= 0.5 * axes.stiffness * (1.0 + 1e-12), "seed {seed}, case {case}");
            assert!(stiffness > 0.0 && damping > 0.0 && lag.is_finite(), "seed {seed}, case {case}");
        }
    }
}

/// Smallest rest of the device's damping at an angle ωT: the smaller eigenvalue of diag(b, b_θ)
/// less the Hermitian part of what the coupling renders, each divided by the root of its damping. For delays
/// of whole periods.
fn left_at(limits: &PortLimits, coupling: &VirtualCoupling, lags: (f64, f64), angle: f64) -> f64 {
    let PortLimits { translation, rotation, lever, sampling } = limits;
    let q = |stiffness, damping, lag| {
        late(law(stiffness, damping, lag, sampling.period, angle).1, sampling, angle).0
    };
    let (k, b) = (coupling.linear_stiffness, coupling.linear_damping);
    // The force responds to v and ω, and turns the handle by the lever.
    let (along, across) = (q(k, b, lags.0), q(k, b, lags.1));
    let own = q(coupling.angular_stiffness, coupling.angular_damping, lags.1);
    let (v, w) = (translation.viscous.unwrap(), rotation.viscous.unwrap());
    let first = 1.0 - along.0 / v;
    let second = 1.0 - (own.0 + across.0 * lever * lever) / w;
    let mixed = Complex(across.0 + along.0, across.1 - along.1);
    let mixed = 0.25 * mixed.square() * lever * lever / (v * w);
    0.5 * (first + second) - (0.25 * (first - second).powi(2) + mixed).sqrt()
}

fn least_left(limits: &PortLimits, coupling: &VirtualCoupling, (lag, angular_lag): (f64, f64)) -> f64 {
    let felt = |lag: f64| if lag == 0.0 { limits.sampling.velocity_delay } else { lag };
    let lags = (felt(lag), felt(angular_lag));
    angles(400).map(|angle| left_at(limits, coupling, lags, angle)).fold(f64::INFINITY, f64::min)
}

#[test]
fn a_coupling_at_a_lever_is_passive_in_translation_and_rotation_together() {
    let seed = 77;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut without, mut apart, mut unequal) = (0, 0, 0);
    for case in 0..1000 {
        let (body, size) = random_body(&mut rng);
        let period = 1.0 / rng.random_range(200.0..5000.0);
        let sampling = sampling(period, random_delay(&mut rng, case % 2, period));
        let scale = 10_f64.powf(rng.random_range(-1.0..1.0));
        let lever = 10_f64.powf(rng.random_range(-6.0..0.0));
        let at_origin = limits(sampling);
        let limits = at_origin.with_lever(lever).in_world(scale);
        let grasp = Pose::from_translation(DVec3::X * rng.random_range(0.0..size));
        let coupling = VirtualCoupling::auto(&body, grasp, &limits);
        let lags = limits.velocity_lags(&coupling);
        let left = least_left(&limits, &coupling, lags);
        assert!(left > -1e-9, "seed {seed}, case {case}: {left} at {lever} m, lags {lags:?}");
        unequal += usize::from(lags.0 != lags.1);

        // By the handle's limits alone, as if the force did not turn it, and with lags of each port's own, it
        // is not.
        let blind = VirtualCoupling::auto(&body, grasp, &at_origin.in_world(scale));
        let own = at_origin.in_world(scale).velocity_lags(&blind);
        without += usize::from(least_left(&limits, &blind, own) < 0.0);
        let (translation, rotation) = limits.loads(&coupling);
        let own =
            (limits.translation.lag(&translation, &sampling), limits.rotation.lag(&rotation, &sampling));
        apart += usize::from(least_left(&limits, &coupling, own) < 0.0);
    }
    assert!(without > 200 && apart > 20 && unequal > 100, "{without}, {apart}, {unequal} of 1000");
}

/// Couplings need lags of at most [`LONGEST_LAG`], and are damped critically if that does not.
#[test]
fn heavy_bodies_are_damped_by_what_the_longest_lag_allows() {
    let seed = 5;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut critical, mut less) = (0, 0);
    for case in 0..1000 {
        let (body, size) = random_body(&mut rng);
        let period = 1.0 / rng.random_range(500.0..5000.0);
        let sampling = sampling(period, random_delay(&mut rng, case % 2, period));
        let lever = if case % 3 == 0 { 0.0 } else { 10_f64.powf(rng.random_range(-4.0..-1.0)) };
        let limits = limits(sampling).with_lever(lever);
        let grasp = Pose::from_translation(DVec3::X * rng.random_range(0.0..size));
        let (linear, angular) = limits.stiffest();
        let full = VirtualCoupling::critically_damped(&body, grasp, linear, angular);
        let lowered = full.damped_within(&limits);
        let lag = |coupling| {
            let (linear, angular) = limits.velocity_lags(coupling);
            linear.max(angular)
        };
        assert!(lag(&lowered) <= LONGEST_LAG * (1.0 + 1e-9), "seed {seed}, case {case}: {} s", lag(&lowered));
        if lag(&full) <= LONGEST_LAG {
            assert_eq!(lowered, full, "seed {seed}, case {case}");
            critical += 1;
        } else if lever == 0.0 {
            // By no more than needed.
            assert!(lag(&lowered) > LONGEST_LAG * (1.0 - 1e-9), "seed {seed}, case {case}");
            less += 1;
        }
    }
    assert!(critical > 100 && less > 100, "{critical} critical, {less} less");
}

#[test]
fn a_lever_takes_of_the_rotation_and_then_of_the_translation() {
    let at = |lever| limits(sampling(1e-3, 0.0)).with_lever(lever).stiffest();
    assert_eq!(at(0.0), (400.0, 0.15));
    let (mut before, _) = at(0.0);
    for lever in [1e-4, 1e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 1.0, 50.0] {
        let (linear, angular) = at(lever);
        assert!(linear <= before && (0.0749999..=0.15).contains(&angular), "{lever} m");
        assert!(linear > 0.0 && angular + linear * lever * lever <= 0.15 * (1.0 + 1e-12), "{lever} m");
        before = linear;
    }
    // √(b/b_θ) = 31.6/m adds a tenth of the lever's own share to ℓ² at 0.1 m.
    assert!((at(0.1).0 - 0.075 / (0.01 + 0.1 / 1000_f64.sqrt())).abs() < 1e-9, "{}", at(0.1).0);

    // If no torque reaches the hand, no lever limits it; if no force does, the rotation has all of its
    // own.
    let mut one_sided = limits(sampling(1e-3, 0.0)).with_lever(0.1);
    one_sided.rotation.peak = 0.0;
    assert_eq!(one_sided.stiffest(), (400.0, ANGULAR_STIFFNESS));
    let mut other_sided = limits(sampling(1e-3, 0.0)).with_lever(0.1);
    other_sided.translation.peak = 0.0;
    let (linear, angular) = other_sided.stiffest();
    assert!((linear - 7.5).abs() < 1e-9 && (angular - 0.075).abs() < 1e-12, "{linear}, {angular}");
}

#[test]
fn gains_that_were_given_stay_and_lags_follow_the_lever() {
    let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4))).unwrap();
    let given = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 100.0, 0.05);
    let lags = |lever| limits(sampling(1e-3, 0.0)).with_lever(lever).velocity_lags(&given);
    let (short, long) = (lags(0.02), lags(0.1));
    assert!(short.0 == short.1 && long.0 == long.1 && long.0 > short.0, "{short:?}, {long:?}");
    assert!(lags(0.0).0 < short.0 && lags(0.0).1 < short.0, "{:?}, {short:?}", lags(0.0));
    let damping = |lever| limits(sampling(1e-3, 0.0)).with_lever(lever).largest_dampings(&given);
    // On the same lag, the springs at the lever leave less of the device's damping.
    assert!(damping(0.02).1 / (short.1 + 5e-4) < damping(0.0).1 / (3e-3 + 5e-4));
}

/// The stiffness that the maker states as stable at 1 kHz is passive for a device of some damping. With that
/// damping, the gains chosen from the maker's values alone are passive too, at any rate and delay.
#[test]
fn the_makers_figures_alone_are_enough_with_a_delay() {
    let seed = 78;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..1000 {
        let period = 1.0 / rng.random_range(100.0..10_000.0);
        let sampling = sampling(period, random_delay(&mut rng, case, period));
        let made = Sampling { period: MAKER_PERIOD, delay: 0.0, ..sampling };
        let axes = PortAxes {
            stiffness: 10_f64.powf(rng.random_range(2.0..4.0)),
            damping: rng.random_range(0.5..10.0),
            viscous: None,
            friction: None,
            ..limits(sampling).translation
        };
        let has = PortAxes::needed_viscous(axes.stiffness, axes.damping, made.velocity_delay, &made);
        let stiffness = axes.largest_stiffness(&sampling);
        let damping = rng.random_range(0.0..50.0);
        let lag = axes.velocity_lag(stiffness, damping, &sampling).max(sampling.velocity_delay);
        let needed = needed(stiffness, damping, lag, &sampling);
        assert!(needed <= has, "seed {seed}, case {case}: {needed} of {has}, {sampling:?}");
    }
}

#[test]
fn unknown_and_unrendered_limits_use_defaults() {
    let at = |period| sampling(period, 0.0);
    let known = limits(at(1e-3));
    assert_eq!(known.translation.largest_stiffness(&at(1e-3)), 400.0);
    let mut unknown = known.translation;
    (unknown.viscous, unknown.friction) = (None, None);
    assert_eq!(unknown.largest_stiffness(&at(1e-3)), 400.0);
    assert_eq!(unknown.largest_stiffness(&at(1e-4)), 400.0);
    assert_eq!(unknown.largest_stiffness(&at(2e-3)), 200.0);
    // Half a millisecond was counted; two more make five times as much.
    assert!((unknown.largest_stiffness(&sampling(1e-3, 2e-3)) - 80.0).abs() < 1e-9);
    // The maker's 2 N·s/m through the device's 3 ms are rendered without more lag; twice as much is not.
    assert!((unknown.velocity_lag(400.0, 2.0, &at(1e-3)) - 3e-3).abs() < 1e-12);
    assert!((unknown.velocity_lag(400.0, 4.0, &at(1e-3)) - 6.5e-3).abs() < 1e-12);
    let none = PortAxes { stiffness: 0.0, peak: 0.0, ..known.rotation };
    let free = PortAxes {
        stiffness: f64::INFINITY,
        damping: f64::INFINITY,
        viscous: None,
        friction: None,
        peak: f64::INFINITY,
        step: 0.0,
    };
    let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-4))).unwrap();
    for lever in [0.0, 0.1] {
        for rotation in [none, free] {
            let limits = PortLimits { translation: free, rotation, lever, ..known };
            let coupling = VirtualCoupling::auto(&body, Pose::IDENTITY, &limits);
            assert_eq!((coupling.linear_stiffness, coupling.angular_stiffness), (500.0, 3.0));
            assert_eq!((coupling.max_force, coupling.max_torque), (f64::INFINITY, f64::INFINITY));
            assert_eq!(limits.velocity_lags(&coupling), (0.0, 0.0));
            assert!(!limits.largest_dampings(&coupling).0.is_nan());
        }
    }
}
