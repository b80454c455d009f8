//! Velocity from timed positions that are rounded to encoder steps.
//!
//! The difference of two readings has an error of up to one step over the time between them: at 1 kHz and 30
//! µm, 30 mm/s. A longer window reduces the noise and adds delay:
//!
//! - [`AdaptiveWindow`] uses the longest window over which a straight line explains every reading to within
//!   the noise: long in slow and steady motion, short when the motion changes. Under a steady acceleration it
//!   lags by half its window, [`AdaptiveWindow::delay`].
//! - [`LowPass`] is a first-order low-pass of differences, with a constant delay.

use glam::DVec3;

/// Longest window of an [`AdaptiveWindow`], in readings.
pub const LONGEST_WINDOW: usize = 32;

/// First-order adaptive windowing with an end fit, each axis by itself (F. Janabi-Sharifi, V. Hayward, C.-S.
/// J. Chen, "Discrete-time adaptive windowing for velocity estimation", IEEE Transactions on Control Systems
/// Technology 8(6), 2000).
///
/// The velocity is the slope of the line from the newest reading to the earliest one for which all readings
/// between are within the noise of the line.
#[derive(Clone, Debug)]
pub struct AdaptiveWindow {
    /// Largest error of a reading, m or rad.
    noise: f64,
    /// Times (s) and values of the readings, newest first.
    times: [f64; LONGEST_WINDOW + 1],
    values: [DVec3; LONGEST_WINDOW + 1],
    count: usize,
    velocity: DVec3,
    delay: DVec3,
}

impl AdaptiveWindow {
    /// An estimator for readings with an error of up to `noise` (m or rad, not negative): the encoder's step.
    pub fn new(noise: f64) -> Self {
        Self {
            noise,
            times: [0.0; LONGEST_WINDOW + 1],
            values: [DVec3::ZERO; LONGEST_WINDOW + 1],
            count: 0,
            velocity: DVec3::ZERO,
            delay: DVec3::ZERO,
        }
    }

    /// The velocity after a reading at a time (s). A reading that is not finite or no later than the one
    /// before is ignored.
    pub fn push(&mut self, time: f64, value: DVec3) -> DVec3 {
        let later = self.count == 0 || time > self.times[0];
        if !(later && time.is_finite() && value.is_finite()) {
            return self.velocity;
        }
        self.times.copy_within(..LONGEST_WINDOW, 1);
        self.values.copy_within(..LONGEST_WINDOW, 1);
        (self.times[0], self.values[0]) = (time, value);
        self.count = (self.count + 1).min(LONGEST_WINDOW + 1);
        for axis in 0..3 {
            (self.velocity[axis], self.delay[axis]) = self.fit(axis);
        }
        self.velocity
    }

    /// Clears the window, for example after a gap: earlier readings do not describe the motion after it.
    pub fn clear(&mut self) {
        *self = Self::new(self.noise);
    }

    /// Delay of the velocity under a steady acceleration at the last reading, by axis, s: half the window.
    pub fn delay(&self) -> DVec3 {
        self.delay
    }

    /// Slope and delay of the longest fitting line along an axis.
    fn fit(&self, axis: usize) -> (f64, f64) {
        let newest = self.values[0][axis];
        let age = |i: usize| self.times[0] - self.times[i];
        let mut fitted = (0.0, 0.0);
        // Lengthen the window while the line from its oldest reading to the newest stays within the noise of
        // all readings between; the longest such line gives the velocity.
        for back in 1..self.count {
            let slope = (newest - self.values[back][axis]) / age(back);
            let off = |i: usize| (newest - slope * age(i) - self.values[i][axis]).abs();
            // Readings exactly at the bound must not depend on rounding.
            if (1..back).any(|i| off(i) > self.noise * (1.0 + 1e-9)) {
                break;
            }
            fitted = (slope, 0.5 * age(back));
        }
        fitted
    }
}

/// A first-order low-pass of differences: it lags behind a steady acceleration by the delay τ, and an encoder
/// step Δ appears as a pulse of height Δ/(τ + h) for readings every h.
#[derive(Clone, Debug)]
pub struct LowPass {
    /// Delay τ, s.
    delay: f64,
    velocity: DVec3,
}

impl LowPass {
    /// A filter with a delay (s, not negative).
    pub fn new(delay: f64) -> Self {
        Self { delay, velocity: DVec3::ZERO }
    }

    /// The velocity after a motion by `difference` (m or rad) in a time (s, above zero).
    pub fn push(&mut self, difference: DVec3, time: f64) -> DVec3 {
        let velocity = self.velocity + (difference / time - self.velocity) * (time / (self.delay + time));
        // Decay stalls at the smallest subnormal, and subnormal numbers are slow: flush them to zero.
        let none = velocity.abs().cmplt(DVec3::splat(f64::MIN_POSITIVE));
        self.velocity = DVec3::select(none, DVec3::ZERO, velocity);
        self.velocity
    }

    /// The velocity.
    pub fn velocity(&self) -> DVec3 {
        self.velocity
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = 3e-5;

    fn rounded(x: f64) -> DVec3 {
        DVec3::new((x / STEP).round() * STEP, 0.0, 0.0)
    }

    /// Velocity errors (root mean square) at 1 kHz of the adaptive window, a low-pass, and plain differences.
    fn errors(position: impl Fn(f64) -> f64, velocity: impl Fn(f64) -> f64, delay: f64) -> [f64; 3] {
        let (mut adaptive, mut low_pass) = (AdaptiveWindow::new(STEP), LowPass::new(delay));
        let mut sums = [0.0; 3];
        let mut last = rounded(position(0.0));
        for i in 1..=2000 {
            let time = f64::from(i) * 1e-3;
            let reading = rounded(position(time));
            let found = [
                adaptive.push(time, reading).x,
                low_pass.push(reading - last, 1e-3).x,
                (reading - last).x / 1e-3,
            ];
            last = reading;
            if i > 100 {
                for (sum, found) in sums.iter_mut().zip(found) {
                    *sum += (found - velocity(time)).powi(2);
                }
            }
        }
        sums.map(|sum| (sum / 1900.0_f64).sqrt())
    }

    #[test]
    fn slow_motion_is_smoother_and_fast_motion_less_late_than_with_a_low_pass() {
        let [slow, slow_pass, slow_plain] = errors(|t| 5e-3 * t, |_| 5e-3, 3e-3);
        assert!(slow < 0.1 * slow_plain && slow < slow_pass, "{slow} {slow_pass} {slow_plain}");
        // 0.25 m/s at 8 Hz.
        let (way, rate) = (5e-3, 50.0);
        let [fast, fast_pass, _] =
            errors(|t| way * (rate * t).sin(), |t| way * rate * (rate * t).cos(), 3e-3);
        assert!(fast < fast_pass, "{fast} {fast_pass}");
    }

    #[test]
    fn a_line_within_the_noise_is_found_over_the_whole_window() {
        let mut window = AdaptiveWindow::new(STEP);
        for i in 0..100 {
            window.push(f64::from(i) * 1e-3, DVec3::new(1e-5, 2e-5, -3e-5) * f64::from(i));
        }
        assert!((window.velocity - DVec3::new(0.01, 0.02, -0.03)).length() < 1e-9);
        assert!((window.delay() - DVec3::splat(0.016)).length() < 1e-9, "{}", window.delay());
        // At rest, with noise only.
        for i in 100..200 {
            window.push(f64::from(i) * 1e-3, DVec3::X * STEP * f64::from(i % 2));
        }
        assert!(window.velocity.x.abs() <= STEP / 0.032 + 1e-12, "{}", window.velocity);
    }

    #[test]
    fn the_stated_delay_is_that_of_a_steady_acceleration() {
        // No line stays within the noise for long: the window is short, and the stated delay accounts for the
        // error.
        let (mut window, acceleration) = (AdaptiveWindow::new(1e-5), 40.0);
        for i in 0..500 {
            let time = f64::from(i) * 1e-3;
            let found = window.push(time, DVec3::X * 0.5 * acceleration * time * time).x;
            let expected = acceleration * (time - window.delay().x);
            assert!(i < 2 || (found - expected).abs() < 1e-6, "{i}: {found} {expected}");
        }
        assert!((1e-4..2e-3).contains(&window.delay().x), "{}", window.delay().x);
    }

    #[test]
    fn a_low_pass_comes_to_rest() {
        for (delay, time) in [(3e-3, 1e-3), (1e-4, 1e-3), (5e-2, 1e-4), (0.0, 1e-3)] {
            let mut pass = LowPass::new(delay);
            for step in 0..100 {
                pass.push(DVec3::new(1e-4, -1e-7, 1e-12 * f64::from(step)), time);
            }
            let mut rests = 0;
            while pass.velocity() != DVec3::ZERO && rests < 1_000_000 {
                pass.push(DVec3::ZERO, time);
                rests += 1;
                let slowest = pass.velocity().abs().to_array().into_iter().filter(|speed| *speed > 0.0);
                assert!(slowest.fold(1.0, f64::min).is_normal(), "{delay} s: {:?}", pass.velocity());
            }
            // e^−709 is the smallest normal number.
            let longest = 10.0 + 720.0 * (1.0 + delay / time);
            assert!(f64::from(rests) < longest, "{delay} s: {} after {rests} steps", pass.velocity());
        }
    }

    #[test]
    fn bad_readings_change_nothing() {
        let mut window = AdaptiveWindow::new(STEP);
        for i in 0..50 {
            window.push(f64::from(i) * 1e-3, DVec3::Y * 1e-4 * f64::from(i));
        }
        let before = window.velocity;
        for (time, value) in
            [(0.01, DVec3::ZERO), (0.049, DVec3::ZERO), (f64::NAN, DVec3::ZERO), (1.0, DVec3::NAN)]
        {
            assert_eq!(window.push(time, value), before);
        }
        window.clear();
        assert_eq!(window.push(0.1, DVec3::ONE), DVec3::ZERO);
    }
}
