//! Whether a motion is stable, by how it goes on after it was disturbed.

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
    /// Whether it came to rest, or will.
    pub fn is_stable(self) -> bool {
        self <= Self::Decaying
    }

    /// It in a word.
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

/// A motion that, half a second on, has kept more than this of its amplitude does not die away; nor does one that, a
/// quarter of a second on, has kept more than [`STEADY`] of it.
const DECAY: f64 = 0.8;
const STEADY: f64 = 0.97;

/// Judges a motion by its last second, a sequence of samples of all coordinates, and gives its amplitude in the last
/// half of it.
///
/// Of three windows of half a second, a quarter of a second apart, two amplitudes are taken: from peak to peak, and the
/// standard deviation, each the largest over the coordinates. The motion is quiet if that from peak to peak ends at no
/// more than `floor`, and decaying if both fall from window to window, and by a fifth from the first to the last. A limit
/// cycle that is irregular may by chance do one of these, but hardly all.
pub fn judge<const N: usize>(last_second: &[[f64; N]], floor: f64) -> (Outcome, f64) {
    let quarter = last_second.len() / 4;
    let windows = [0, 1, 2].map(|start| &last_second[start * quarter..(start + 2) * quarter]);
    let amplitudes = windows.map(amplitudes);
    let finite = amplitudes.iter().flatten().all(|amplitude| amplitude.is_finite());
    let [first, middle, last] = amplitudes;
    let falls = |i: usize| {
        last[i] < DECAY * first[i] && last[i] < STEADY * middle[i] && middle[i] < STEADY * first[i]
    };
    let outcome = if !finite {
        Outcome::Diverged
    } else if last[0] <= floor {
        Outcome::Quiet
    } else if falls(0) && falls(1) {
        Outcome::Decaying
    } else {
        Outcome::Oscillating
    };
    (outcome, last[0])
}

/// The largest range that a coordinate goes through, and the largest standard deviation; not finite if a sample is not.
fn amplitudes<const N: usize>(samples: &[[f64; N]]) -> [f64; 2] {
    let count = samples.len() as f64;
    let mut largest: [f64; 2] = [0.0; 2];
    for coordinate in 0..N {
        let values = || samples.iter().map(|sample| sample[coordinate]);
        if !values().all(f64::is_finite) {
            return [f64::INFINITY; 2];
        }
        let (low, high) =
            values().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        let mean = values().sum::<f64>() / count;
        let square = values().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        largest = [largest[0].max(high - low), largest[1].max(square.sqrt())];
    }
    largest
}
