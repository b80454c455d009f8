//! What counts as stable, and the conditions of theory that simulation is held against.

/// What became of a motion after it was disturbed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Outcome {
    /// It came to rest within the floor.
    Quiet,
    /// It is above the floor but dies away.
    Decaying,
    /// It goes on, neither growing out of bounds nor dying away: a limit cycle.
    Oscillating,
    /// It left all bounds, or a number was not finite.
    Diverged,
}

impl Outcome {
    pub fn is_stable(self) -> bool {
        self <= Self::Decaying
    }

    pub fn word(self) -> &'static str {
        match self {
            Self::Quiet => "quiet",
            Self::Decaying => "decaying",
            Self::Oscillating => "oscillating",
            Self::Diverged => "diverged",
        }
    }

    /// Its place on a heat map's scale.
    pub fn shade(self) -> f64 {
        match self {
            Self::Quiet => 0.0,
            Self::Decaying => 0.2,
            Self::Oscillating => 0.55,
            Self::Diverged => 1.0,
        }
    }

    /// What the shades mean.
    pub fn legend() -> Vec<(f64, String)> {
        [Self::Quiet, Self::Decaying, Self::Oscillating, Self::Diverged]
            .map(|outcome| (outcome.shade(), outcome.word().to_owned()))
            .to_vec()
    }
}

/// A motion that, half a second on, has kept more than this of its amplitude does not die away.
const DECAY: f64 = 0.8;

/// Judges a motion by its last second, given as its two halves, each a sequence of samples of all coordinates.
///
/// With a the peak to peak amplitude, the largest over the coordinates: quiet if a of the second half is no more than
/// `floor`, decaying if it is less than 0.8 of that of the first half.
pub fn judge<const N: usize>(halves: [&[[f64; N]]; 2], floor: f64) -> (Outcome, f64) {
    let [before, after] = halves.map(peak_to_peak);
    let outcome = if !before.is_finite() || !after.is_finite() {
        Outcome::Diverged
    } else if after <= floor {
        Outcome::Quiet
    } else if after < DECAY * before {
        Outcome::Decaying
    } else {
        Outcome::Oscillating
    };
    (outcome, after)
}

/// The largest range that a coordinate goes through; not finite if a sample is not.
fn peak_to_peak<const N: usize>(samples: &[[f64; N]]) -> f64 {
    let mut largest: f64 = 0.0;
    for coordinate in 0..N {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for sample in samples {
            let value = sample[coordinate];
            if !value.is_finite() {
                return f64::INFINITY;
            }
            (low, high) = (low.min(value), high.max(value));
        }
        largest = largest.max(high - low);
    }
    largest
}

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

    fn diolaiti_with_delay(&self, delay: f64) -> bool {
        self.device_damping >= self.stiffness * (0.5 * self.period + delay)
            && self.friction >= 0.5 * self.stiffness * self.quantum
    }
}
