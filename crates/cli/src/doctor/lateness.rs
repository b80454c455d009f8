//! Lateness with which the machine's timer wakes a thread that sleeps as the haptic thread does.

use palpate::machine::WakeLateness;
use serde::Serialize;

use super::finding::{Finding, Verdict};

/// Rate of wake-ups, Hz: that of the haptic loop.
pub const RATE: f64 = 1000.0;
/// Duration of the measurement, s. A shorter one misses rare late wake-ups.
pub const SECONDS: f64 = 4.0;

/// Largest 99th percentile of the lateness for the verdict "good", µs: a tenth of the period at 1 kHz.
const MAX_GOOD_P99: f64 = 100.0;
/// Largest 99th percentile of the lateness for "could be better", µs: above it, steps hardly end in their
/// period.
const MAX_FAIR_P99: f64 = 500.0;
/// Largest fraction of missed periods for "could be better": above it, forces stutter.
const MAX_FAIR_MISSED: f64 = 1e-3;
/// Upper ends of the plot's rows, µs.
const ENDS: [f64; 13] =
    [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, 10_000.0];
/// Length of the longest bar of the plot, columns.
const MAX_BAR: usize = 40;

/// Lateness of wake-ups, µs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Lateness {
    pub p50: f64,
    pub p99: f64,
    pub p999: f64,
    pub max: f64,
    /// Number of wake-ups.
    pub wakes: u64,
    /// Number of periods that the thread slept through.
    pub missed: u64,
    pub rate_hz: f64,
    pub scheduling: String,
    pub histogram: Vec<Bin>,
}

/// Number of wake-ups in a range of lateness (µs): later than `from`, at most `to` (`None`: without bound).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bin {
    pub from: f64,
    pub to: Option<f64>,
    pub count: u64,
}

impl Lateness {
    pub fn new(measured: &WakeLateness) -> Self {
        let times = &measured.lateness;
        let at = times.percentiles(1000.0);
        let nanoseconds = |microseconds: f64| (1000.0 * microseconds) as u64;
        let mut histogram = Vec::new();
        let mut seen = 0;
        let mut from = 0.0;
        for to in ENDS {
            // Counts are cumulative, so that a bucket of the histogram across an end is counted once.
            let up_to = times.count_between(0, nanoseconds(to));
            histogram.push(Bin { from, to: Some(to), count: up_to.saturating_sub(seen) });
            (seen, from) = (up_to.max(seen), to);
        }
        histogram.push(Bin { from, to: None, count: times.count().saturating_sub(seen) });
        Self {
            p50: at.p50,
            p99: at.p99,
            p999: at.p999,
            max: at.max,
            wakes: times.count(),
            missed: measured.missed,
            rate_hz: RATE,
            scheduling: measured.setup.scheduling_line(),
            histogram,
        }
    }
}

pub fn finding(lateness: &Lateness, realtime: bool) -> Finding {
    let Lateness { p50, p99, p999, max, wakes, missed, .. } = lateness;
    let periods = wakes + missed;
    let missed_part = if periods > 0 { *missed as f64 / periods as f64 } else { 0.0 };
    let verdict = if *wakes == 0 {
        Verdict::Unknown
    } else if *p99 <= MAX_GOOD_P99 && *missed == 0 {
        Verdict::Good
    } else if *p99 <= MAX_FAIR_P99 && missed_part <= MAX_FAIR_MISSED {
        Verdict::CouldBeBetter
    } else {
        Verdict::Bad
    };
    let measured = format!(
        "median {p50:.1}, p99 {p99:.1}, p99.9 {p999:.1}, max {max:.1} µs at 1 kHz; {missed} of {periods} periods were missed"
    );
    let finding = Finding::new("timer lateness", verdict, measured);
    match verdict {
        Verdict::Good | Verdict::Unknown => finding,
        _ if realtime => finding.with_remedy(
            "close other programs; render on a physical machine rather than a virtual one; a kernel with PREEMPT_RT wakes late \
             even less often",
        ),
        _ => finding.with_remedy("allow real-time scheduling (above), and close other programs"),
    }
}

/// Histogram as text: one row per range, with bars on a logarithmic scale so that a few late wake-ups show
/// beside many good ones.
pub fn plot(lateness: &Lateness) -> Vec<String> {
    let Lateness { p50, p99, p999, max, wakes, histogram, .. } = lateness;
    let mut lines = vec![format!("lateness of {wakes} wake-ups, µs (bars are logarithmic)")];
    let last = histogram.iter().rposition(|bin| bin.count > 0).map_or(0, |last| last + 1);
    let most = histogram.iter().map(|bin| bin.count).max().unwrap_or(0);
    for bin in &histogram[..last] {
        let range = match bin.to {
            Some(to) => format!("{:>6} to {to:>6}", bin.from),
            None => format!("  over {:>6}", bin.from),
        };
        lines.push(format!("{range:>16} {} {}", bar(bin.count, most), bin.count));
    }
    let marks = [("median", p50), ("p99", p99), ("p99.9", p999), ("max", max)];
    let marks: Vec<String> = marks.iter().map(|(name, value)| format!("{name} {value:.1}")).collect();
    lines.push(format!("{:>16} {}", "", marks.join("   ")));
    lines
}

/// Bar of a count, in eighths of a column: its length is proportional to ln(1 + count).
fn bar(count: u64, most: u64) -> String {
    const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];
    if count == 0 || most == 0 {
        return "·".to_owned();
    }
    let share = (1.0 + count as f64).ln() / (1.0 + most as f64).ln();
    let eighths = ((8 * MAX_BAR) as f64 * share).round() as usize;
    "█".repeat(eighths / 8) + EIGHTHS[eighths % 8]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(microseconds: &[u64], missed: u64) -> WakeLateness {
        let mut measured = palpate::machine::measure_wake_lateness(RATE, 0.0);
        for microsecond in microseconds {
            measured.lateness.record(1000 * microsecond);
        }
        measured.missed = missed;
        measured
    }

    #[test]
    fn each_wake_up_is_in_one_range() {
        let times: Vec<u64> = (1..=20_000).collect();
        let lateness = Lateness::new(&measured(&times, 0));
        assert_eq!(lateness.histogram.iter().map(|bin| bin.count).sum::<u64>(), 20_000);
        // The histogram has a precision of three digits.
        for bin in &lateness.histogram {
            let expected = bin.to.unwrap_or(20_000.0) - bin.from;
            assert!(
                (bin.count as f64 - expected).abs() <= 0.002 * bin.to.unwrap_or(20_000.0) + 1.0,
                "{bin:?}"
            );
        }
        let lines = plot(&lateness);
        assert_eq!(lines.len(), 1 + lateness.histogram.len() + 1, "{lines:?}");
        assert!(lines[14].contains("over") && lines[14].contains("10000"), "{lines:?}");
    }

    #[test]
    fn verdicts_follow_lateness_and_missed_periods() {
        let verdict = |times: &[u64], missed| finding(&Lateness::new(&measured(times, missed)), true).verdict;
        assert_eq!(verdict(&[10; 1000], 0), Verdict::Good);
        assert_eq!(verdict(&[10; 1000], 1), Verdict::CouldBeBetter);
        assert_eq!(verdict(&[300; 1000], 0), Verdict::CouldBeBetter);
        assert_eq!(verdict(&[700; 1000], 0), Verdict::Bad);
        assert_eq!(verdict(&[10; 1000], 50), Verdict::Bad);
        assert_eq!(verdict(&[], 0), Verdict::Unknown);
    }

    #[test]
    fn bars_are_longer_for_more() {
        assert_eq!(bar(0, 10), "·");
        assert_eq!(bar(1000, 1000).chars().count(), MAX_BAR);
        let lengths: Vec<usize> = [1, 10, 100, 1000].map(|count| bar(count, 1000).chars().count()).into();
        assert!(lengths.is_sorted() && lengths[0] >= 1 && lengths[0] < lengths[3], "{lengths:?}");
    }
}
