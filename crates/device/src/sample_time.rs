//! Times of the samples of a recorded motion, which may be time stamps.
//!
//! Stamps of a clock that counts since 1970 are some 1.8e9 s, where neighbouring numbers of 64 bits are
//! 2.4e-7 s apart. They count from the first of them, which is subtracted before anything is rounded: whole
//! seconds and fractions of a second apart.

/// Largest time of a first sample, s, up to which times are taken as they are: eleven days. Beyond it they
/// are stamps, of which the first becomes 0. With more, times lose the nanoseconds by which samples may
/// differ.
const MAX_START: f64 = 1e6;

/// Largest stamp, s: of the year 5138. Those that count milliseconds since 1970 are larger.
const MAX_STAMP: f64 = 1e11;

/// Reason why a sample is refused, and the remedy.
pub(crate) struct Refusal {
    pub what: String,
    pub remedy: &'static str,
}

/// A time as it was given, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SampleTime {
    /// The nearest number.
    seconds: f64,
    /// Whole seconds, and the fraction of a second, of the same sign.
    whole: f64,
    fraction: f64,
}

impl SampleTime {
    pub const ZERO: Self = Self { seconds: 0.0, whole: 0.0, fraction: 0.0 };

    /// The time of a decimal number; `None` if the text is none.
    pub fn parse(text: &str) -> Option<Self> {
        let seconds: f64 = text.parse().ok()?;
        let Some(point) = text.find('.') else { return Some(seconds.into()) };
        // With an exponent, or without digits on both sides, the nearest number has all that is known.
        let (whole, fraction) = text.split_at(point);
        let is_plain = fraction[1..].bytes().all(|byte| byte.is_ascii_digit());
        Some(match (whole.parse::<i64>(), fraction.parse::<f64>()) {
            (Ok(whole), Ok(fraction)) if is_plain => {
                Self { seconds, whole: whole as f64, fraction: fraction.copysign(seconds) }
            }
            _ => seconds.into(),
        })
    }
}

impl From<f64> for SampleTime {
    fn from(seconds: f64) -> Self {
        let whole = seconds.trunc();
        Self { seconds, whole, fraction: seconds - whole }
    }
}

/// Whether the first time of a motion, s, is a stamp that times count from.
pub(crate) fn is_stamp(first: f64) -> bool {
    first.abs() > MAX_START
}

/// Where the times of a motion count from. Its first sample decides.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Origin(Option<SampleTime>);

impl Origin {
    /// Time of the next sample, s.
    pub fn time_of(&mut self, sample: impl Into<SampleTime>) -> Result<f64, Refusal> {
        let sample: SampleTime = sample.into();
        let origin = match self.0 {
            Some(origin) => origin,
            None => *self.0.insert(Self::by(&sample)?),
        };
        if origin == SampleTime::ZERO {
            return Ok(sample.seconds);
        }
        Ok((sample.whole - origin.whole) + (sample.fraction - origin.fraction))
    }

    /// Where times count from if this is the first.
    fn by(first: &SampleTime) -> Result<SampleTime, Refusal> {
        if first.seconds.is_nan() || first.seconds.abs() > MAX_STAMP {
            let remedy = "give finite seconds, not milliseconds or nanoseconds";
            return Err(Refusal { what: format!("time {} s", first.seconds), remedy });
        }
        Ok(if is_stamp(first.seconds) { *first } else { SampleTime::ZERO })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times<const N: usize>(texts: [&str; N]) -> [f64; N] {
        let mut origin = Origin::default();
        texts.map(|text| {
            let time = origin.time_of(SampleTime::parse(text).expect("a number"));
            time.unwrap_or_else(|refusal| panic!("{}", refusal.what))
        })
    }

    /// Nanoseconds of time stamps are kept. As 64-bit numbers of seconds since 1970 the same stamps are off
    /// by up to 1.2e-7 s.
    #[test]
    fn stamps_count_from_the_first_to_the_nanosecond() {
        let stamps = ["1767225600.123456789", "1767225600.123456790", "1767225601", "1767225661.000000001"];
        let found = times(stamps);
        for (time, nanoseconds) in found.into_iter().zip([0.0, 1.0, 876_543_211.0, 60_876_543_212.0]) {
            assert!((time - 1e-9 * nanoseconds).abs() < 1e-14 + 1e-16 * time, "{time} s, {nanoseconds} ns");
        }
        let rounded = stamps.map(|text| text.parse::<f64>().expect("a number"));
        assert!(rounded[1] == rounded[0], "negative control: a number of 64 bits has no room for them");
        // Before 1970, and in other notations.
        assert!((times(["-1767225600.75", "-1767225600.5"])[1] - 0.25).abs() < 1e-15);
        assert_eq!(times(["1.7672256e9", "+1767225600.5", "1767225601."]), [0.0, 0.5, 1.0]);
    }

    /// Other times keep every bit, wherever they begin.
    #[test]
    fn times_that_are_no_stamps_are_taken_as_they_are() {
        let given = ["0.3333333333333333", "0.1e1", "7.1", "999999.9", "1000000000"];
        assert_eq!(times(given), given.map(|text| text.parse::<f64>().expect("a number")));
        assert_eq!(times(["-1000000", ".5"]), [-1e6, 0.5]);
    }

    #[test]
    fn milliseconds_and_what_is_no_time_are_refused() {
        for text in ["1767225600123", "1767225600123456789", "-1e300", "inf", "NaN"] {
            let refused = Origin::default().time_of(SampleTime::parse(text).expect("a number"));
            let remedy = refused.err().map(|refusal| refusal.remedy);
            assert!(remedy.is_some_and(|remedy| remedy.contains("not milliseconds")), "{text}: {remedy:?}");
        }
        for text in ["", ".", "-", "1.5s", "1,5", "0x1"] {
            assert_eq!(SampleTime::parse(text), None, "{text}");
        }
    }
}
