//! The conditions of theory that simulation is held against.

use std::f64::consts::{PI, TAU};

/// The longest whole number of samples in which a hand comes back to where it was, but for slow ones.
const SAMPLES: u32 = 40;
/// The slowest motion of a hand that is looked at, s, and the most samples of one.
const SLOWEST: f64 = 0.1;
const MANY: f64 = 1000.0;

/// What the conditions speak of: a device with a wall. Units of translation, or their equals in rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampledWall {
    /// Viscous damping of the device, b, N·s/m.
    pub device_damping: f64,
    /// Coulomb friction of the device, f_c, N.
    pub friction: f64,
    /// K, N/m.
    pub stiffness: f64,
    /// B, N·s/m.
    pub damping: f64,
    /// τ, the lag of the velocity that it acts on, s.
    pub lag: f64,
    /// T, s.
    pub period: f64,
    /// t_d, s.
    pub delay: f64,
    /// Δ, m.
    pub quantum: f64,
}

impl SampledWall {
    /// Colgate and Schenkel 1994: b > K T/2 + |B|. For a velocity that is the backward difference of an exact position,
    /// without delay.
    pub fn colgate_schenkel(&self) -> bool {
        self.device_damping > 0.5 * self.stiffness * self.period + self.damping.abs()
    }

    /// Abbott and Okamura 2005: K ≤ min(2 b/T, 2 f_c/Δ). For a spring alone, with a rounded position, without delay.
    pub fn abbott_okamura(&self) -> bool {
        self.diolaiti_with_delay(0.0)
    }

    /// Diolaiti, Niemeyer, Barbagli and Salisbury 2006: viscous damping makes up for the hold and for the delay, b ≥ K (T/2
    /// + t_d), and friction for rounding, f_c ≥ K Δ/2. For a spring alone.
    pub fn diolaiti(&self) -> bool {
        self.diolaiti_with_delay(self.delay)
    }

    /// The stiffest spring that a device without friction has the damping for while nobody holds it, N/m: b > K (T/2 + t_d).
    pub fn stiffest_let_go(&self) -> f64 {
        self.device_damping / (0.5 * self.period + self.delay)
    }

    /// The stiffest spring beside the damper that is passive by the condition of Colgate and Schenkel with a delay (derived in
    /// `palpate_dynamics`' `port.rs`), N/m.
    pub fn stiffest_passive(&self) -> f64 {
        // Below it the need is convex in K, and less than b for K = 0.
        let most = self.stiffest_let_go() * (1.0 + self.damping / self.device_damping);
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

    /// The motion of a hand for which the device needs most damping.
    pub fn worst_shake(&self) -> Shake {
        let quick =
            (2..=SAMPLES).flat_map(|samples| (1..=samples / 2).map(move |turns| Shake { turns, samples }));
        let slowest = (SLOWEST / self.period).min(MANY) as u32;
        let slow = (SAMPLES..=slowest).map(|samples| Shake { turns: 1, samples });
        let need = |shake: &Shake| self.needed_at(shake.angle());
        quick.chain(slow).max_by(|a, b| need(a).total_cmp(&need(b))).unwrap_or(Shake { turns: 1, samples: 2 })
    }

    /// The damping that a motion at an angle ωT asks of the device, N·s/m.
    fn needed_at(&self, angle: f64) -> f64 {
        let (whole, part) = self.whole_and_part();
        let half = (0.5 * angle).sin();
        // (1 − z⁻¹)/(2 (1 − cos ωT)) without cancellation.
        let hold = (0.5, 0.25 * angle.sin() / (half * half));
        let (back, law) = (turned(-angle), self.law(angle));
        let q = times(times(hold, turned(-whole * angle)), (self.period * law.0, self.period * law.1));
        let sigma = (1.0 - part + part * back.0, part * back.1);
        let real = times(q, sigma).0;
        0.5 * (real + (real * real + square(q) * (1.0 - square(sigma)).max(0.0)).sqrt())
    }

    /// Force by position at an angle ωT: H.
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

    /// Where a hand that moves by `shake`, 1 m to each side at the samples, is at a time (s), and how fast, to get most out of
    /// device and wall: straight from sample to sample, but for where the force changes between.
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

/// A hand that moves to and fro so many times in so many samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shake {
    pub turns: u32,
    pub samples: u32,
}

impl Shake {
    /// ωT.
    fn angle(self) -> f64 {
        (TAU * f64::from(self.turns) / f64::from(self.samples)).min(PI)
    }
}

/// Of complex numbers: e^(jφ), a b and |a|².
fn turned(angle: f64) -> (f64, f64) {
    (angle.cos(), angle.sin())
}

fn times(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0)
}

fn square(a: (f64, f64)) -> f64 {
    a.0 * a.0 + a.1 * a.1
}
