//! The saturating spring law, limited to the force that the device can render (§5.3.3, Fig. 5.4), and limits
//! of the rate of a wrench.
//!
//! The law has three pieces, joined with continuous slope: linear while the force is under [`LINEAR_SHARE`]
//! of the limit, a cubic Hermite piece, and the constant limit. The cubic starts with the spring's own slope
//! and ends flat; its range is chosen so that the third-order term vanishes and the slope falls linearly from
//! k to 0: the law is concave and the tangent stiffness (Eq. 5.31) is between 0 and k.

use std::f64::consts::PI;

use glam::DVec3;
use palpate_core::Wrench;

/// Share of the limit up to which the spring is linear. With more, the slope falls more suddenly.
const LINEAR_SHARE: f64 = 0.75;

/// Magnitude and slope of the force of a spring of `stiffness` at a `deviation` ≥ 0, limited to `limit`.
///
/// Units are the caller's (N/m, m, N or N·m/rad, rad, N·m). An infinite limit leaves the spring linear; a
/// limit that is zero, negative or NaN gives no force.
pub fn spring_force(stiffness: f64, deviation: f64, limit: f64) -> (f64, f64) {
    let linear = stiffness * deviation;
    if limit == f64::INFINITY {
        return (linear, stiffness);
    }
    if limit.is_nan() || limit <= 0.0 {
        return (0.0, 0.0);
    }
    if linear <= LINEAR_SHARE * limit {
        return (linear, stiffness);
    }
    // With the share s, the Hermite piece from (s, s), slope 1, to (2 − s, 1), slope 0, is a parabola.
    let width = 2.0 * (1.0 - LINEAR_SHARE);
    let t = (linear / limit - LINEAR_SHARE) / width;
    if t >= 1.0 {
        return (limit, 0.0);
    }
    (limit * (LINEAR_SHARE + width * t * (1.0 - 0.5 * t)), stiffness * (1.0 - t))
}

/// Energy (J) stored in the spring of [`spring_force`] at a `deviation` ≥ 0: the integral of its law.
pub(crate) fn spring_energy(stiffness: f64, deviation: f64, limit: f64) -> f64 {
    let linear = stiffness * deviation;
    if limit == f64::INFINITY {
        return 0.5 * linear * deviation;
    }
    if limit.is_nan() || limit <= 0.0 {
        return 0.0;
    }
    if linear <= LINEAR_SHARE * limit {
        return 0.5 * linear * deviation;
    }
    let width = 2.0 * (1.0 - LINEAR_SHARE);
    let t = ((linear / limit - LINEAR_SHARE) / width).min(1.0);
    let bent = width * t * (LINEAR_SHARE + width * t * (0.5 - t / 6.0));
    let flat = (linear / limit - LINEAR_SHARE - width).max(0.0);
    limit * limit / stiffness * (0.5 * LINEAR_SHARE * LINEAR_SHARE + bent + flat)
}

/// Angle from which an angular spring fades, rad: 150°. With more, its negative slope is steeper.
const FADE_FROM: f64 = 5.0 / 6.0 * PI;

/// Magnitude and slope of the torque of an angular spring of `stiffness` (N·m/rad) at an `angle` of 0 to π
/// (rad), limited to `limit` (N·m).
///
/// It is the law of [`spring_force`] up to 150°. From there it fades along a cubic, with continuous slope, to
/// zero at 180°, where the shorter rotation changes direction: the torque is continuous through a half turn.
/// The slope is negative where it fades.
pub fn angular_spring_torque(stiffness: f64, angle: f64, limit: f64) -> (f64, f64) {
    let (torque, slope) = spring_force(stiffness, angle, limit);
    if angle <= FADE_FROM {
        return (torque, slope);
    }
    let width = PI - FADE_FROM;
    let t = ((angle - FADE_FROM) / width).min(1.0);
    let share = 1.0 - t * t * (3.0 - 2.0 * t);
    let share_slope = -6.0 * t * (1.0 - t) / width;
    (torque * share, slope * share + torque * share_slope)
}

/// Energy (J) stored in the spring of [`angular_spring_torque`].
pub(crate) fn angular_spring_energy(stiffness: f64, angle: f64, limit: f64) -> f64 {
    let held = spring_energy(stiffness, angle.min(FADE_FROM), limit);
    if angle <= FADE_FROM {
        return held;
    }
    // Between its joints the law is a polynomial of degree five at most, which Gauss quadrature with three
    // points integrates exactly.
    let joint = |share: f64| (share * limit / stiffness).clamp(FADE_FROM, angle);
    let ends = [FADE_FROM, joint(LINEAR_SHARE), joint(2.0 - LINEAR_SHARE), angle];
    let faded: f64 = ends
        .windows(2)
        .map(|piece| {
            let (middle, half) = (0.5 * (piece[0] + piece[1]), 0.5 * (piece[1] - piece[0]));
            let torque = |x: f64| angular_spring_torque(stiffness, middle + half * x, limit).0;
            let node = 0.6_f64.sqrt();
            half / 9.0 * (5.0 * (torque(-node) + torque(node)) + 8.0 * torque(0.0))
        })
        .sum();
    held + faded
}

/// Limits the magnitudes of a wrench's force and torque to `max_force` (N) and `max_torque` (N·m) by the law
/// of [`spring_force`], without changing their directions: unchanged up to three quarters of the limit,
/// smooth beyond. A force or torque that is not finite becomes zero, since this is the last function before a
/// motor.
pub fn saturate(wrench: &Wrench, max_force: f64, max_torque: f64) -> Wrench {
    Wrench { force: limited(wrench.force, max_force), torque: limited(wrench.torque, max_torque) }
}

/// Largest rate of change of a wrench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlewLimit {
    /// Rate of the force, N/s; infinite for no limit.
    pub force: f64,
    /// Rate of the torque, N·m/s; infinite for no limit.
    pub torque: f64,
}

impl SlewLimit {
    /// No limit.
    pub const NONE: Self = Self { force: f64::INFINITY, torque: f64::INFINITY };

    /// The wrench nearest to `wanted`, in force and in torque, that `previous` may change to within `dt` (s).
    /// A part of `wanted` that is not finite counts as zero; with a `dt` of 0 nothing changes.
    pub fn approach(&self, previous: &Wrench, wanted: &Wrench, dt: f64) -> Wrench {
        Wrench {
            force: approached(previous.force, wanted.force, self.force * dt),
            torque: approached(previous.torque, wanted.torque, self.torque * dt),
        }
    }

    /// Lets `previous` shrink towards `wanted` within `elapsed` (s), along its direction and no further than
    /// its part in `wanted`; without a limit if it is no longer than `free` (N, N·m). To be followed by
    /// [`Self::approach`], which lets it grow and turn.
    ///
    /// Called with a higher limit than `approach`, it lets the force follow a hand that leaves a surface: a
    /// force that lags while it falls puts energy into the hand.
    pub fn unload(&self, previous: &Wrench, wanted: &Wrench, elapsed: f64, free: (f64, f64)) -> Wrench {
        let shrunk = |previous: DVec3, wanted: DVec3, limit: f64, free: f64| {
            let limit = if previous.length() <= free { f64::INFINITY } else { limit };
            approached(previous, part_wanted(previous, wanted), limit)
        };
        Wrench {
            force: shrunk(previous.force, wanted.force, self.force * elapsed, free.0),
            torque: shrunk(previous.torque, wanted.torque, self.torque * elapsed, free.1),
        }
    }
}

/// The part of `previous`, along it and no longer, that is nearest to `wanted`.
fn part_wanted(previous: DVec3, wanted: DVec3) -> DVec3 {
    let part = previous.dot(wanted) / previous.length_squared();
    if part > 0.0 { previous * part.min(1.0) } else { DVec3::ZERO }
}

/// `wanted`, or the point at the distance `limit` from `previous` towards it if that is nearer.
fn approached(previous: DVec3, wanted: DVec3, limit: f64) -> DVec3 {
    let wanted = if wanted.is_finite() { wanted } else { DVec3::ZERO };
    let change = wanted - previous;
    let length = change.length();
    // An infinite rate does not limit, not even within a time of 0, where `limit` is 0 · ∞ = NaN.
    if length <= limit || limit.is_nan() || !length.is_finite() {
        return wanted;
    }
    previous + change * (limit.max(0.0) / length)
}

/// A vector limited by [`spring_force`]; zero if it is not finite.
fn limited(vector: DVec3, limit: f64) -> DVec3 {
    if !vector.is_finite() {
        return DVec3::ZERO;
    }
    let largest = vector.abs().max_element();
    if largest == 0.0 {
        return DVec3::ZERO;
    }
    // Scaled first, so that the length of a huge finite vector does not overflow.
    let scaled = vector / largest;
    let direction = scaled / scaled.length();
    let magnitude = (largest * scaled.length()).min(f64::MAX);
    let (magnitude_out, _) = spring_force(1.0, magnitude, limit);
    if magnitude_out == magnitude { vector } else { direction * magnitude_out }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_is_linear_then_concave_then_flat_with_continuous_slope() {
        let (k, limit) = (200.0, 3.0);
        let mut previous = (0.0, k);
        for i in 0..=3000 {
            let deviation = f64::from(i) * 1e-5;
            let (force, slope) = spring_force(k, deviation, limit);
            assert!(force <= k * deviation + 1e-15 && force <= limit);
            assert!((0.0..=k).contains(&slope) && slope <= previous.1 + 1e-12, "slope rises at {deviation}");
            assert!(force >= previous.0, "force falls at {deviation}");
            assert!(previous.1 - slope < k * 0.01, "slope jumps at {deviation}");
            previous = (force, slope);
        }
        assert_eq!(spring_force(k, 0.01, limit), (2.0, k));
        assert_eq!(spring_force(k, 0.02, limit), (limit, 0.0));
    }

    #[test]
    fn slope_is_the_derivative() {
        let h = 1e-7;
        for deviation in [0.001, 0.0115, 0.013, 0.016, 0.0184, 0.03] {
            let f = |d| spring_force(200.0, d, 3.0).0;
            let difference = (f(deviation + h) - f(deviation - h)) / (2.0 * h);
            assert!((difference - spring_force(200.0, deviation, 3.0).1).abs() < 1e-5);
        }
    }

    #[test]
    fn energy_is_the_integral_of_the_force() {
        let h = 1e-6;
        for deviation in [0.001, 0.0115, 0.013, 0.016, 0.0184, 0.03] {
            let e = |d| spring_energy(200.0, d, 3.0);
            let difference = (e(deviation + h) - e(deviation - h)) / (2.0 * h);
            assert!((difference - spring_force(200.0, deviation, 3.0).0).abs() < 1e-6, "at {deviation}");
        }
        assert_eq!(spring_energy(200.0, 0.1, f64::INFINITY), 1.0);
    }

    #[test]
    fn angular_law_fades_to_nothing_at_a_half_turn_with_continuous_slope() {
        for limit in [0.5, 2.0, 2.6, 5.0, f64::INFINITY] {
            let f = |angle| angular_spring_torque(1.0, angle, limit);
            let e = |angle| angular_spring_energy(1.0, angle, limit);
            let (h, mut previous) = (1e-6, f(0.0).1);
            for i in 1..3140 {
                let angle = f64::from(i) * 1e-3;
                let (torque, slope) = f(angle);
                assert!((0.0..=limit.min(angle)).contains(&torque), "limit {limit}, angle {angle}: {torque}");
                assert!(angle > FADE_FROM || (torque, slope) == spring_force(1.0, angle, limit));
                let difference = (f(angle + h).0 - f(angle - h).0) / (2.0 * h);
                assert!((difference - slope).abs() < 1e-4, "limit {limit}, angle {angle}: slope {slope}");
                let difference = (e(angle + h) - e(angle - h)) / (2.0 * h);
                assert!((difference - torque).abs() < 1e-6, "limit {limit}, angle {angle}: energy");
                assert!((slope - previous).abs() < 0.1, "limit {limit}, angle {angle}: slope jumps");
                previous = slope;
            }
            assert!(f(PI).0.abs() < 1e-12 && f(PI).1.abs() < 1e-9, "limit {limit}");
        }
    }

    #[test]
    fn slew_limit_approaches_in_bounded_steps_and_arrives() {
        let slew = SlewLimit { force: 100.0, torque: 2.0 };
        let wanted = Wrench::new(DVec3::new(3.0, -4.0, 0.0), DVec3::Z * 0.01);
        let mut now = Wrench::ZERO;
        for step in 1..=60 {
            let next = slew.approach(&now, &wanted, 1e-3);
            assert!(
                (next - now).force.length() <= 0.1 + 1e-12 && (next - now).torque.length() <= 0.002 + 1e-15
            );
            assert!((next.force.length() - (0.1 * f64::from(step)).min(5.0)).abs() < 1e-9, "step {step}");
            now = next;
        }
        assert_eq!(now, wanted);
        assert_eq!(SlewLimit::NONE.approach(&Wrench::ZERO, &wanted, 0.0), wanted);
        assert_eq!(slew.approach(&now, &Wrench::ZERO, 0.0), now);
        let nan = Wrench::new(DVec3::NAN, DVec3::INFINITY);
        assert!(slew.approach(&now, &nan, 1e-3).is_finite());
    }

    #[test]
    fn a_wrench_unloads_along_itself_and_at_once_if_it_is_small() {
        let slew = SlewLimit { force: 100.0, torque: 2.0 };
        let held = Wrench::new(DVec3::new(0.3, -0.4, 0.0), DVec3::Z * 0.01);
        let none = (0.0, 0.0);
        let far = Wrench::new(DVec3::new(-3.0, 4.0, 1.0), DVec3::X);
        for wanted in [Wrench::ZERO, held * 0.5, held * 3.0, far] {
            let next = slew.unload(&held, &wanted, 4e-3, none);
            assert!(
                next.force.length() <= held.force.length() && next.force.cross(held.force).length() < 1e-15
            );
            assert!((next - held).force.length() <= 0.4 + 1e-12 && next.force.dot(held.force) >= 0.0);
        }
        // 0.1 N a millisecond, and 0.002 N·m.
        let next = slew.unload(&held, &Wrench::ZERO, 4e-3, none);
        assert!((next.force - held.force * 0.2).length() < 1e-12, "{next:?}");
        assert!((next.torque - held.torque * 0.2).length() < 1e-15, "{next:?}");
        assert_eq!(slew.unload(&held, &Wrench::ZERO, 6e-3, none), Wrench::ZERO);
        // It shrinks no further than wanted, and not at all if more is wanted.
        let next = slew.unload(&held, &(held * 0.9), 4e-3, none);
        assert!((next - held * 0.9).force.length() < 1e-12, "{next:?}");
        assert_eq!(slew.unload(&held, &(held * 3.0), 4e-3, none), held);
        // Below `free` it shrinks at once.
        let next = slew.unload(&held, &Wrench::ZERO, 1e-3, (0.6, 0.001));
        assert_eq!((next.force, next.torque), (DVec3::ZERO, DVec3::Z * 0.008));
        let nan = Wrench::new(DVec3::NAN, DVec3::INFINITY);
        assert!(slew.unload(&held, &nan, 1e-3, none).is_finite());
        assert!(slew.unload(&Wrench::ZERO, &held, f64::NAN, none).is_finite());
        assert_eq!(SlewLimit::NONE.unload(&held, &far, 1e-3, none).force, DVec3::ZERO);
    }

    #[test]
    fn saturation_keeps_direction_limits_magnitude_and_zeroes_nan() {
        let wrench = Wrench::new(DVec3::new(3.0, -4.0, 12.0), DVec3::new(0.001, 0.0, 0.0));
        let out = saturate(&wrench, 3.3, 0.1);
        assert!((out.force.length() - 3.3).abs() < 1e-12);
        assert!(out.force.cross(wrench.force).length() < 1e-12 && out.force.dot(wrench.force) > 0.0);
        assert_eq!(out.torque, wrench.torque);
        assert_eq!(saturate(&wrench, f64::INFINITY, f64::INFINITY), wrench);
        let huge = Wrench::new(DVec3::splat(1e308), DVec3::splat(-1e308));
        let out = saturate(&huge, 3.3, 0.1);
        assert!((out.force.length() - 3.3).abs() < 1e-12 && (out.torque.length() - 0.1).abs() < 1e-12);
        let nan = Wrench::new(DVec3::new(f64::NAN, 1.0, 0.0), DVec3::splat(f64::INFINITY));
        assert_eq!(saturate(&nan, 3.3, 0.1), Wrench::ZERO);
        for limit in [0.0, -1.0, f64::NAN] {
            assert_eq!(saturate(&wrench, limit, limit), Wrench::ZERO);
        }
    }
}
