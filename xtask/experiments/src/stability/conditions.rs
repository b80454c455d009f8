//! Stability conditions from the literature that simulations are compared with.

use std::f64::consts::{PI, TAU};

/// Longest period of fast hand motions, in samples. The motion is periodic in a whole number of samples.
const MAX_FAST_SAMPLES: u32 = 40;
/// Longest period of a hand motion, s, and its largest number of samples.
const MAX_MOTION_PERIOD: f64 = 0.1;
const MAX_SLOW_SAMPLES: f64 = 1000.0;

/// Device with a sampled wall, to which the conditions apply. Units are those of translation, or their
/// equivalents in rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampledWall {
    /// Viscous damping of the device, b, N·s/m.
    pub device_damping: f64,
    /// Coulomb friction of the device, f_c, N.
    pub friction: f64,
    /// Stiffness of the wall K, N/m.
    pub stiffness: f64,
    /// Damping of the wall B, N·s/m.
    pub damping: f64,
    /// Lag τ of the velocity that the wall's damping acts on, s.
    pub lag: f64,
    /// Sampling period T, s.
    pub period: f64,
    /// Delay t_d, s.
    pub delay: f64,
    /// Encoder step Δ, m.
    pub quantum: f64,
}

impl SampledWall {
    /// Colgate and Schenkel 1994: b > K T/2 + |B|. Assumes a velocity that is the backward difference of
    /// an exact position, and no delay.
    pub fn colgate_schenkel(&self) -> bool {
        self.device_damping > 0.5 * self.stiffness * self.period + self.damping.abs()
    }

    /// Abbott and Okamura 2005: K ≤ min(2 b/T, 2 f_c/Δ). Assumes a spring alone, a rounded position, and no
    /// delay.
    pub fn abbott_okamura(&self) -> bool {
        self.diolaiti_with_delay(0.0)
    }

    /// Diolaiti, Niemeyer, Barbagli and Salisbury 2006: viscous damping compensates the hold and the delay, b
    /// ≥ K (T/2 + t_d), and friction the rounding, f_c ≥ K Δ/2. Assumes a spring alone.
    pub fn diolaiti(&self) -> bool {
        self.diolaiti_with_delay(self.delay)
    }

    /// Returns the stiffest stable spring on a device without friction or hand, N/m: b > K (T/2 + t_d).
    pub fn stiffest_without_hand(&self) -> f64 {
        self.device_damping / (0.5 * self.period + self.delay)
    }

    /// Returns the stiffest spring that is passive together with the damper, by the condition of Colgate and
    /// Schenkel with a delay (derived in `palpate_dynamics`' `port.rs`), N/m.
    pub fn stiffest_passive(&self) -> f64 {
        // The damping that is needed is convex in K and below b at K = 0, so bisection finds the only
        // crossing.
        let most = self.stiffest_without_hand() * (1.0 + self.damping / self.device_damping);
        let (mut low, mut high) = (0.0, 2.0 * most);
        for _ in 0..40 {
            let stiffness = 0.5 * (low + high);
            let wall = Self { stiffness, ..*self };
            let worst = wall.worst_shake();
            if wall.needed_at(worst.angle()) <= self.device_damping {
                low = stiffness
            } else {
                high = stiffness
            }
        }
        low
    }

    /// Returns the hand motion that needs the most device damping.
    pub fn worst_shake(&self) -> Shake {
        let quick = (2..=MAX_FAST_SAMPLES)
            .flat_map(|samples| (1..=samples / 2).map(move |turns| Shake { turns, samples }));
        let slowest = (MAX_MOTION_PERIOD / self.period).min(MAX_SLOW_SAMPLES) as u32;
        let slow = (MAX_FAST_SAMPLES..=slowest).map(|samples| Shake { turns: 1, samples });
        let need = |shake: &Shake| self.needed_at(shake.angle());
        quick.chain(slow).max_by(|a, b| need(a).total_cmp(&need(b))).unwrap_or(Shake { turns: 1, samples: 2 })
    }

    /// Returns the device damping that a motion at an angle ωT needs, N·s/m.
    fn needed_at(&self, angle: f64) -> f64 {
        let (whole, part) = self.whole_and_part();
        let half = (0.5 * angle).sin();
        // hold = (1 − z⁻¹)/(2 (1 − cos ωT)), without cancellation.
        let hold = (0.5, 0.25 * angle.sin() / (half * half));
        let (back, law) = (turned(-angle), self.law(angle));
        let q = times(times(hold, turned(-whole * angle)), (self.period * law.0, self.period * law.1));
        let sigma = (1.0 - part + part * back.0, part * back.1);
        let real = times(q, sigma).0;

        // b = ½ (Re qσ + √((Re qσ)² + |q|² (1 − |σ|²))).
        0.5 * (real + (real * real + square(q) * (1.0 - square(sigma)).max(0.0)).sqrt())
    }

    /// Returns the wall's response H (force over position) at an angle ωT.
    fn law(&self, angle: f64) -> (f64, f64) {
        let weight = self.period / (self.lag + self.period);
        let back = turned(-angle);
        let pole = (1.0 - (1.0 - weight) * back.0, -(1.0 - weight) * back.1);
        let size = self.damping * weight / (self.period * square(pole));
        let damper = times((1.0 - back.0, -back.1), (pole.0, -pole.1));
        (self.stiffness + size * damper.0, size * damper.1)
    }

    fn whole_and_part(&self) -> (f64, f64) {
        let periods = self.delay / self.period;
        let whole = (periods + 1e-6).floor();
        (whole, (periods - whole).max(0.0))
    }

    /// Returns position and velocity at a time (s) of a hand that extracts the most energy from device and
    /// wall. It moves by `shake`, 1 m to each side, at the samples, and straight from sample to sample except
    /// where the force changes in between.
    pub fn worst_path(&self, shake: Shake, time: f64) -> (f64, f64) {
        let (angle, (whole, part)) = (shake.angle(), self.whole_and_part());
        let index = (time / self.period + 1e-9).floor();
        let at = |index: f64| (angle * index).cos();
        let (from, to) = (at(index), at(index + 1.0));
        let since = time - index * self.period;
        if part == 0.0 {
            return (from + (to - from) * since / self.period, (to - from) / self.period);
        }
        let force = |index: f64| times(self.law(angle), turned(angle * (index - whole))).0;
        let rise = force(index) - force(index - 1.0);
        let push = 0.5 * part * (1.0 - part) * rise * self.period / self.device_damping;
        let (turn, middle) = (part * self.period, (1.0 - part) * from + part * to + push);
        if since < turn * (1.0 - 1e-9) {
            (from + (middle - from) * since / turn, (middle - from) / turn)
        } else {
            let rest = self.period - turn;
            (middle + (to - middle) * (since - turn) / rest, (to - middle) / rest)
        }
    }

    fn diolaiti_with_delay(&self, delay: f64) -> bool {
        self.device_damping >= self.stiffness * (0.5 * self.period + delay)
            && self.friction >= 0.5 * self.stiffness * self.quantum
    }
}

/// Periodic hand motion: `turns` periods in so many samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shake {
    pub turns: u32,
    pub samples: u32,
}

impl Shake {
    /// Returns ωT.
    fn angle(self) -> f64 {
        (TAU * f64::from(self.turns) / f64::from(self.samples)).min(PI)
    }
}

/// Complex numbers as pairs: e^(jφ), a b and |a|².
fn turned(angle: f64) -> (f64, f64) {
    (angle.cos(), angle.sin())
}

fn times(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0)
}

fn square(a: (f64, f64)) -> f64 {
    a.0 * a.0 + a.1 * a.1
}
