//! Judgement of stability from the motion after a disturbance.

/// Outcome of a motion after a disturbance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Outcome {
    /// The motion came to rest within the floor.
    Quiet,
    /// The motion is above the floor but decays.
    Decaying,
    /// The motion neither grows without bound nor decays: a limit cycle.
    Oscillating,
    /// The motion grew without bound, or a number was not finite.
    Diverged,
}

impl Outcome {
    /// Returns whether the motion is at rest or decays.
    pub fn is_stable(self) -> bool {
        self <= Self::Decaying
    }

    /// Returns the outcome as a word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Quiet => "quiet",
            Self::Decaying => "decaying",
            Self::Oscillating => "oscillating",
            Self::Diverged => "diverged",
        }
    }

    /// Returns the position on a heat map's scale.
    pub fn shade(self) -> f64 {
        match self {
            Self::Quiet => 0.0,
            Self::Decaying => 0.2,
            Self::Oscillating => 0.55,
            Self::Diverged => 1.0,
        }
    }

    /// Returns the legend of the shades.
    pub fn legend() -> Vec<(f64, String)> {
        [Self::Quiet, Self::Decaying, Self::Oscillating, Self::Diverged]
            .map(|outcome| (outcome.shade(), outcome.word().to_owned()))
            .to_vec()
    }
}

/// Ratio of amplitudes half a second apart below which a motion decays.
const HALF_SECOND_RATIO: f64 = 0.8;
/// Ratio of amplitudes a quarter of a second apart below which a motion decays.
const QUARTER_SECOND_RATIO: f64 = 0.97;

/// Judges a motion by its last second, a sequence of samples of all coordinates. Returns the outcome and the
/// amplitude in the last half second.
///
/// Two amplitudes are computed in three windows of half a second, a quarter of a second apart: peak to peak,
/// and the standard deviation, each the largest over the coordinates. The motion is quiet if the last
/// peak-to-peak amplitude is at most `floor`, and decaying if both amplitudes fall from window to window, and
/// by a fifth from the first to the last. An irregular limit cycle may meet one of these conditions by
/// chance, but hardly all.
pub fn judge<const N: usize>(last_second: &[[f64; N]], floor: f64) -> (Outcome, f64) {
    let quarter = last_second.len() / 4;
    let windows = [0, 1, 2].map(|start| &last_second[start * quarter..(start + 2) * quarter]);
    let amplitudes = windows.map(amplitudes);
    let finite = amplitudes.iter().flatten().all(|amplitude| amplitude.is_finite());
    let [first, middle, last] = amplitudes;
    let falls = |i: usize| {
        last[i] < HALF_SECOND_RATIO * first[i]
            && last[i] < QUARTER_SECOND_RATIO * middle[i]
            && middle[i] < QUARTER_SECOND_RATIO * first[i]
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

/// Returns the largest range and the largest standard deviation of a coordinate; infinite if a sample is not
/// finite.
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
