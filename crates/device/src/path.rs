//! A motion given by samples of a pose over time, as a curve with a pose and a twist at every instant.
//!
//! Between two samples the position is a cubic Hermite curve and the orientation is q(t) = exp(w(t)) q₀,
//! where the rotation vector w (world axes) is a cubic Hermite curve from 0 to the short way round to the
//! next sample. The twist is the exact derivative of the curve: with the left Jacobian J of the rotation
//! group, ω = J(w) ẇ. (J and its inverse: T. D. Barfoot,
//! *State Estimation for Robotics*, 2017, §7.1.)
//!
//! [`Interpolation::Smooth`] takes the twist at a sample from a parabola through it and its neighbours (a
//! central difference where the spacing is even), at most three times as fast as the slower of the two
//! segments that meet there: a hold stays a hold, and unevenly spaced samples cannot fling the curve away.
//! The twist is then continuous. [`Interpolation::Linear`] takes each segment's own mean twist (lerp and
//! slerp).

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};

use crate::PathError;
use crate::sample_time::{Origin, Refusal};

/// Latest time (s) and largest coordinate (m) accepted: a held device is within both, and no derivative
/// overflows.
const MAX_TIME: f64 = 1e9;
const MAX_POSITION: f64 = 1e6;
/// Remedy for a time beyond the latest.
const LATE: &str = "give finite seconds, at most 1e9 after the first sample";
/// Shortest time between two samples, s: below it, velocities are not meaningful.
const MIN_SPACING: f64 = 1e-9;
/// Largest deviation of a quaternion's length from 1 that passes as rounding; the quaternion is then
/// normalised.
const UNIT_TOLERANCE: f64 = 1e-3;
/// Largest ratio of the speed at a sample to that of the slower adjacent segment. Up to it a cubic through
/// increasing values stays monotonic (F. N. Fritsch and R. E. Carlson, *Monotone piecewise cubic
/// interpolation*, 1980).
const SPEED_RATIO: f64 = 3.0;

/// A pose at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keyframe {
    /// Time, s.
    pub time: f64,
    /// Pose, m and a unit quaternion.
    pub pose: Pose,
}

/// Interpolation between the samples of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Interpolation {
    /// Constant twist between samples: lerp and slerp.
    Linear,
    /// Cubic, with a continuous twist.
    #[default]
    Smooth,
}

/// A point of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// The pose.
    pub pose: Pose,
    /// Exact derivative of the pose, world axes; zero before the first sample and from the last one on.
    pub twist: Twist,
    /// Whether the path has ended.
    pub ended: bool,
}

/// A motion given by samples. Its clock starts at the first sample; before that and after the last one it is
/// at rest.
///
/// If the first sample's time is more than 1e6 s from 0, as a time stamp since 1970 is, the times of all
/// samples become those since the first.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionPath {
    keyframes: Vec<Keyframe>,
    /// The twist at each sample; empty for linear interpolation.
    twists: Vec<Twist>,
}

impl MotionPath {
    /// Interpolates `keyframes`: at least one, finite, at strictly increasing times, with unit quaternions
    /// (to 1e-3; they are normalised).
    ///
    /// # Errors
    /// If there is no sample, or one is not valid: the first such.
    pub fn new(mut keyframes: Vec<Keyframe>, interpolation: Interpolation) -> Result<Self, PathError> {
        let (mut origin, mut previous) = (Origin::default(), None);
        for (sample, keyframe) in keyframes.iter_mut().enumerate() {
            let time = origin.time_of(keyframe.time);
            *keyframe = time
                .and_then(|time| checked(Keyframe { time, ..*keyframe }, previous))
                .map_err(|Refusal { what, remedy }| PathError::Sample { what, sample, remedy })?;
            previous = Some(keyframe.time);
        }
        if keyframes.is_empty() {
            return Err(PathError::Empty { file: None });
        }
        Ok(Self::from_checked(keyframes, interpolation))
    }

    /// Interpolates samples that have each passed [`checked`].
    pub(crate) fn from_checked(keyframes: Vec<Keyframe>, interpolation: Interpolation) -> Self {
        let twists = match interpolation {
            Interpolation::Linear => Vec::new(),
            Interpolation::Smooth => (0..keyframes.len()).map(|i| twist_at_sample(&keyframes, i)).collect(),
        };
        Self { keyframes, twists }
    }

    /// The samples, in order of time.
    pub fn keyframes(&self) -> &[Keyframe] {
        &self.keyframes
    }

    /// Time from the first sample to the last, s.
    pub fn duration(&self) -> f64 {
        self.keyframes[self.keyframes.len() - 1].time - self.keyframes[0].time
    }

    /// Point of the path `elapsed` seconds after its first sample. A NaN counts as 0.
    pub fn at(&self, elapsed: f64) -> PathPoint {
        self.at_near(elapsed, &mut 0)
    }

    /// As [`at`](Self::at), with `segment` as a hint: the index of the segment last used, where the search
    /// begins.
    pub fn at_near(&self, elapsed: f64, segment: &mut usize) -> PathPoint {
        let frames = &self.keyframes;
        let last = frames.len() - 1;
        let time = frames[0].time + if elapsed.is_nan() { 0.0 } else { elapsed };
        if time < frames[0].time || last == 0 {
            return PathPoint {
                pose: frames[0].pose,
                twist: Twist::ZERO,
                ended: last == 0 && time >= frames[0].time,
            };
        }
        if time >= frames[last].time {
            return PathPoint { pose: frames[last].pose, twist: Twist::ZERO, ended: true };
        }
        // Times mostly advance a little: try the last segment and the next before searching all of them.
        let holds = |i: usize| i < last && frames[i].time <= time && time < frames[i + 1].time;
        let i = if holds(*segment) {
            *segment
        } else if holds(segment.saturating_add(1)) {
            *segment + 1
        } else {
            frames.partition_point(|frame| frame.time <= time) - 1
        };
        *segment = i;
        let (pose, twist) = self.on_segment(i, time);
        PathPoint { pose, twist, ended: false }
    }

    /// Pose and twist at `time` (s) on segment `i`, between samples `i` and `i + 1`.
    fn on_segment(&self, i: usize, time: f64) -> (Pose, Twist) {
        let (from, to) = (&self.keyframes[i], &self.keyframes[i + 1]);
        let duration = to.time - from.time;
        let s = (time - from.time) / duration;
        // Derivatives below are by s, from 0 to 1 on the segment: twists times the duration.
        let step = to.pose.translation - from.pose.translation;
        let turn = from.pose.rotation_vector_to(&to.pose);
        let (start, end) = match (self.twists.get(i), self.twists.get(i + 1)) {
            // ẇ = J(w)⁻¹ ω; at the start w = 0 and J is the identity.
            (Some(start), Some(end)) => (
                Twist::new(start.linear * duration, start.angular * duration),
                Twist::new(end.linear * duration, inverse_left_jacobian(turn, end.angular * duration)),
            ),
            _ => (Twist::new(step, turn), Twist::new(step, turn)),
        };
        // p(s) = p₀ + offset(s); q(s) = exp(w(s)) q₀, with ω = J(w) ẇ.
        let (offset, velocity) = hermite(step, start.linear, end.linear, s);
        let (rotation, rate) = hermite(turn, start.angular, end.angular, s);
        let pose = Pose {
            translation: from.pose.translation + offset,
            rotation: (DQuat::from_scaled_axis(rotation) * from.pose.rotation).normalize(),
        };
        (pose, Twist::new(velocity / duration, left_jacobian(rotation, rate / duration)))
    }
}

/// The sample with its quaternion normalised, if it is valid after a sample at time `previous`.
pub(crate) fn checked(mut keyframe: Keyframe, previous: Option<f64>) -> Result<Keyframe, Refusal> {
    let Keyframe { time, pose } = keyframe;
    if time.is_nan() || time.abs() > MAX_TIME {
        return Err(Refusal { what: format!("time {time} s"), remedy: LATE });
    }
    if let Some(previous) = previous
        && time - previous < MIN_SPACING
    {
        return Err(Refusal {
            what: format!("time {time} s after {previous} s"),
            remedy: "sort the samples by time and drop repeated ones (1 ns apart at least)",
        });
    }
    if pose.translation.is_nan() || pose.translation.abs().max_element() > MAX_POSITION {
        return Err(Refusal {
            what: format!("position {}", pose.translation),
            remedy: "give finite metres, at most 1e6",
        });
    }
    let length = pose.rotation.length();
    if length.is_nan() || (length - 1.0).abs() > UNIT_TOLERANCE {
        return Err(Refusal {
            what: format!("quaternion {} of length {length}", pose.rotation),
            remedy: "give unit quaternions in the order x, y, z, w",
        });
    }
    // A quaternion of unit length keeps its bits.
    if (length - 1.0).abs() > 4.0 * f64::EPSILON {
        keyframe.pose.rotation = pose.rotation.normalize();
    }
    Ok(keyframe)
}

/// Twist of a smooth path at sample `i`: the derivative of the parabola through it and its neighbours,
/// limited in speed; at an end, the mean twist of the one segment there.
fn twist_at_sample(frames: &[Keyframe], i: usize) -> Twist {
    let mean = |a: usize, b: usize| {
        let duration = frames[b].time - frames[a].time;
        let step = frames[b].pose.translation - frames[a].pose.translation;
        (duration, Twist::new(step / duration, frames[a].pose.rotation_vector_to(&frames[b].pose) / duration))
    };
    match (i.checked_sub(1), (i + 1 < frames.len()).then_some(i + 1)) {
        (Some(before), Some(after)) => {
            let (duration_before, before) = mean(before, i);
            let (duration_after, after) = mean(i, after);
            // The parabola's derivative at the middle of three samples is (h₁ v₀ + h₀ v₁)/(h₀ + h₁), for mean
            // velocities v₀, v₁ over segments of durations h₀, h₁.
            let weight = duration_after / (duration_before + duration_after);
            let blend = |before: DVec3, after: DVec3| {
                let slower = before.length().min(after.length());
                (before * weight + after * (1.0 - weight)).clamp_length_max(SPEED_RATIO * slower)
            };
            Twist::new(blend(before.linear, after.linear), blend(before.angular, after.angular))
        }
        (Some(before), None) => mean(before, i).1,
        (None, Some(after)) => mean(i, after).1,
        (None, None) => Twist::ZERO,
    }
}

/// Value and derivative at `s` of the cubic from 0 to `end` over [0, 1] with these end derivatives.
fn hermite(end: DVec3, derivative_0: DVec3, derivative_1: DVec3, s: f64) -> (DVec3, DVec3) {
    // p(s) = d₀ s + (3 e − 2 d₀ − d₁) s² + (d₀ + d₁ − 2 e) s³
    let square = end * 3.0 - derivative_0 * 2.0 - derivative_1;
    let cube = derivative_0 + derivative_1 - end * 2.0;
    ((derivative_0 + (square + cube * s) * s) * s, derivative_0 + (square * 2.0 + cube * (3.0 * s)) * s)
}

/// J(w) x: the angular velocity of exp(w) when w changes at rate x.
fn left_jacobian(w: DVec3, x: DVec3) -> DVec3 {
    let angle_squared = w.length_squared();
    // J(w) x = x + a w×x + b w×(w×x), with θ = ‖w‖, a = (1 − cos θ)/θ², b = (θ − sin θ)/θ³; near zero their
    // series, whose next terms are below 2e-11.
    let (a, b) = if angle_squared < 1e-4 {
        (0.5 - angle_squared / 24.0, 1.0 / 6.0 - angle_squared / 120.0)
    } else {
        let angle = angle_squared.sqrt();
        ((1.0 - angle.cos()) / angle_squared, (angle - angle.sin()) / (angle * angle_squared))
    };
    let across = w.cross(x);
    x + across * a + w.cross(across) * b
}

/// J(w)⁻¹ x for ‖w‖ ≤ π.
fn inverse_left_jacobian(w: DVec3, x: DVec3) -> DVec3 {
    let angle_squared = w.length_squared();
    // J(w)⁻¹ x = x − w×x/2 + c w×(w×x), with c = 1/θ² − cot(θ/2)/(2θ); near zero its series.
    let c = if angle_squared < 1e-4 {
        1.0 / 12.0 + angle_squared / 720.0
    } else {
        let angle = angle_squared.sqrt();
        1.0 / angle_squared - 0.5 / (angle * (0.5 * angle).tan())
    };
    let across = w.cross(x);
    x - across * 0.5 + w.cross(across) * c
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    fn random_vector(rng: &mut StdRng, size: f64) -> DVec3 {
        DVec3::new(
            rng.random_range(-size..size),
            rng.random_range(-size..size),
            rng.random_range(-size..size),
        )
    }

    fn random_path(rng: &mut StdRng, interpolation: Interpolation) -> MotionPath {
        let mut time = -3.0;
        let mut pose = Pose::IDENTITY;
        let keyframes = (0..30)
            .map(|_| {
                time += rng.random_range(0.05..0.5);
                pose = pose.moved(&Twist::new(random_vector(rng, 1.0), random_vector(rng, 1.5)), 1.0);
                Keyframe { time, pose }
            })
            .collect();
        MotionPath::new(keyframes, interpolation).unwrap()
    }

    #[test]
    fn jacobian_and_inverse_cancel_up_to_half_a_turn() {
        let mut rng = StdRng::seed_from_u64(1);
        for angle in [0.0, 1e-8, 1e-3, 0.0099, 0.0101, 1.0, 3.0, std::f64::consts::PI] {
            let w = random_vector(&mut rng, 1.0).normalize() * angle;
            let x = random_vector(&mut rng, 1.0);
            let error = (inverse_left_jacobian(w, left_jacobian(w, x)) - x).length();
            assert!(error < 1e-10, "angle {angle}: {error}");
        }
    }

    #[test]
    fn samples_are_met_exactly() {
        let mut rng = StdRng::seed_from_u64(2);
        for interpolation in [Interpolation::Linear, Interpolation::Smooth] {
            let path = random_path(&mut rng, interpolation);
            let start = path.keyframes()[0].time;
            for keyframe in path.keyframes() {
                let elapsed = keyframe.time - start;
                let pose = path.at(elapsed).pose;
                assert!((pose.translation - keyframe.pose.translation).length() < 1e-12);
                assert!(pose.rotation_vector_to(&keyframe.pose).length() < 1e-12);
            }
        }
    }

    #[test]
    fn twist_is_the_derivative_of_the_pose() {
        let mut rng = StdRng::seed_from_u64(3);
        for interpolation in [Interpolation::Linear, Interpolation::Smooth] {
            let path = random_path(&mut rng, interpolation);
            for _ in 0..2000 {
                let h = 1e-6;
                let t = rng.random_range(2.0 * h..path.duration() - 2.0 * h);
                let (before, after, here) = (path.at(t - h), path.at(t + h), path.at(t));
                if interpolation == Interpolation::Linear
                    && (before.twist.linear - after.twist.linear).length() > 1e-9
                {
                    continue; // A corner of the path.
                }
                let linear = (after.pose.translation - before.pose.translation) / (2.0 * h);
                let angular = before.pose.rotation_vector_to(&after.pose) / (2.0 * h);
                assert!((linear - here.twist.linear).length() < 1e-4, "{interpolation:?} at {t}");
                assert!((angular - here.twist.angular).length() < 1e-4, "{interpolation:?} at {t}");
            }
        }
    }

    #[test]
    fn smooth_paths_have_a_continuous_twist_at_the_samples() {
        let mut rng = StdRng::seed_from_u64(4);
        let path = random_path(&mut rng, Interpolation::Smooth);
        let start = path.keyframes()[0].time;
        for keyframe in &path.keyframes()[1..29] {
            let elapsed = keyframe.time - start;
            let (before, after) = (path.at(elapsed - 1e-9).twist, path.at(elapsed + 1e-9).twist);
            assert!((before.linear - after.linear).length() < 1e-5);
            assert!((before.angular - after.angular).length() < 1e-5);
        }
    }

    #[test]
    fn linear_paths_are_lerp_and_slerp() {
        let mut rng = StdRng::seed_from_u64(5);
        let path = random_path(&mut rng, Interpolation::Linear);
        for pair in path.keyframes().windows(2) {
            let s = rng.random_range(0.0..1.0);
            let time = pair[0].time + s * (pair[1].time - pair[0].time);
            let pose = path.at(time - path.keyframes()[0].time).pose;
            let position = pair[0].pose.translation.lerp(pair[1].pose.translation, s);
            let rotation = pair[0].pose.rotation.slerp(pair[1].pose.rotation, s);
            assert!((pose.translation - position).length() < 1e-12);
            assert!(pose.rotation_vector_to(&Pose::new(position, rotation)).length() < 1e-7);
        }
    }

    /// A densely sampled analytic motion is recovered with its velocity.
    #[test]
    fn smooth_paths_converge_to_the_motion_sampled() {
        let motion = |t: f64| {
            Pose::new(
                DVec3::new(t.sin(), t.cos(), 0.3 * t),
                DQuat::from_rotation_y(0.7 * t) * DQuat::from_rotation_x(t),
            )
        };
        let error = |spacing: f64| {
            let keyframes = (0..=(2.0 / spacing) as usize)
                .map(|i| Keyframe { time: i as f64 * spacing, pose: motion(i as f64 * spacing) })
                .collect();
            let path = MotionPath::new(keyframes, Interpolation::Smooth).unwrap();
            (0..1000)
                .map(|i| {
                    let t = 0.5 + i as f64 / 1000.0;
                    let point = path.at(t);
                    let velocity = DVec3::new(t.cos(), -t.sin(), 0.3);
                    let spin = DQuat::from_rotation_y(0.7 * t) * DVec3::X + DVec3::Y * 0.7;
                    (point.twist.linear - velocity).length().max((point.twist.angular - spin).length())
                })
                .fold(0.0, f64::max)
        };
        let (coarse, fine) = (error(0.1), error(0.05));
        assert!(coarse < 0.01 && fine < coarse / 3.5, "second order: {coarse} then {fine}");
    }

    #[test]
    fn holds_do_not_overshoot() {
        let at = |time, x| Keyframe { time, pose: Pose::from_translation(DVec3::X * x) };
        let path = MotionPath::new(
            vec![at(0.0, 0.0), at(1.0, 0.0), at(1.001, 1.0), at(9.0, 1.0)],
            Interpolation::Smooth,
        );
        let path = path.unwrap();
        for i in 0..9000 {
            let x = path.at(i as f64 / 1000.0 + 0.0003).pose.translation.x;
            assert!((-1e-12..=1.0 + 1e-12).contains(&x), "{x} at {i} ms");
        }
    }

    #[test]
    fn ends_hold_and_the_search_hint_does_not_matter() {
        let mut rng = StdRng::seed_from_u64(6);
        let path = random_path(&mut rng, Interpolation::Smooth);
        assert_eq!(path.at(-1.0).pose, path.keyframes()[0].pose);
        assert_eq!(path.at(f64::NAN).pose, path.at(0.0).pose);
        let end = path.at(path.duration() + 5.0);
        assert!(end.ended && end.twist == Twist::ZERO && end.pose == path.keyframes()[29].pose);
        assert!(path.at(f64::INFINITY).ended && !path.at(f64::NEG_INFINITY).ended);
        for _ in 0..1000 {
            let t = rng.random_range(-0.5..path.duration() + 0.5);
            let mut hint = if rng.random_bool(0.1) { usize::MAX } else { rng.random_range(0..40) };
            assert_eq!(path.at_near(t, &mut hint), path.at(t));
        }
    }

    #[test]
    fn wrong_samples_are_refused_with_their_place() {
        let good = Keyframe { time: 0.0, pose: Pose::IDENTITY };
        let with = |change: &dyn Fn(&mut Keyframe)| {
            let mut keyframe = Keyframe { time: 1.0, ..good };
            change(&mut keyframe);
            MotionPath::new(vec![good, keyframe], Interpolation::Smooth).map_err(|error| error.to_string())
        };
        assert!(with(&|_| ()).is_ok());
        for (change, word) in [
            (&(|k: &mut Keyframe| k.time = 0.0) as &dyn Fn(&mut Keyframe), "time 0 s after 0 s at sample 1"),
            (&|k| k.time = -1.0, "sort the samples"),
            (&|k| k.time = f64::NAN, "finite seconds"),
            (&|k| k.time = f64::INFINITY, "finite seconds"),
            (&|k| k.pose.translation.y = f64::NAN, "finite metres"),
            (&|k| k.pose.translation.z = f64::NEG_INFINITY, "finite metres"),
            (&|k| k.pose.translation.z = 1e300, "finite metres"),
            (&|k| k.pose.rotation = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), "unit quaternions"),
            (&|k| k.pose.rotation = DQuat::from_xyzw(f64::NAN, 0.0, 0.0, 1.0), "unit quaternions"),
            (&|k| k.pose.rotation = DQuat::from_xyzw(0.0, 1.0, 0.0, 1.0), "unit quaternions"),
        ] {
            let message = with(change).unwrap_err();
            assert!(message.contains(word), "{message}");
        }
        assert!(
            MotionPath::new(Vec::new(), Interpolation::Linear).unwrap_err().to_string().contains("no sample")
        );
    }
}
