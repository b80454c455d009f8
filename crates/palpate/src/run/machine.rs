//! Load of the machine, as far as the operating system reports it: it explains why a thread with little work
//! wakes late.

use std::time::Instant;

/// Ticks of `/proc/stat` per second: `USER_HZ`, which is 100 on all architectures of Linux except Alpha.
const TICKS_PER_SECOND: f64 = 100.0;

/// Counters of the operating system at one moment, for the machine and for the calling thread. The difference
/// of two samples is a [`MachineLoad`].
#[derive(Clone, Copy, Debug)]
pub struct MachineSample {
    taken: Instant,
    processors: Option<ProcessorTime>,
    /// Number of times that the thread was preempted.
    preempted: Option<u64>,
    /// Time for which the thread was ready to run but waited for a processor, ns.
    run_delay: Option<u64>,
    /// Number of page faults of the thread.
    page_faults: Option<u64>,
}

/// Time of all processors.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ProcessorTime {
    /// Total time, s.
    total: f64,
    /// Time that the hypervisor gave to other virtual machines, s.
    stolen: f64,
}

/// Load of the machine, and of one thread, between two [samples](MachineSample). Values that the operating
/// system does not report are `None`: on systems other than Linux, all but the time that passed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MachineLoad {
    /// Time between the samples, s.
    pub seconds: f64,
    /// Processor time that the hypervisor gave to other virtual machines, summed over all processors, s.
    pub stolen_s: Option<f64>,
    /// Stolen processor time as a fraction of the time of all processors, 0 to 1.
    pub stolen_fraction: Option<f64>,
    /// Number of times that the thread lost its processor to another thread (involuntary context switches).
    pub preempted: Option<u64>,
    /// Time for which the thread was ready to run but waited for a processor, s.
    pub run_delay_s: Option<f64>,
    /// Number of page faults: the thread touched a page that was not mapped, for example for the first time,
    /// and waited until the system had mapped it.
    pub page_faults: Option<u64>,
}

impl MachineSample {
    /// Reads the present counters; those of a thread are the calling thread's. It reads files under `/proc`
    /// and allocates: not for use in a real-time loop.
    pub fn take() -> Self {
        let read = |path: &str| std::fs::read_to_string(path).ok();
        Self {
            taken: Instant::now(),
            processors: read("/proc/stat").and_then(|text| processor_time(&text)),
            preempted: read("/proc/thread-self/status").and_then(|text| preemptions(&text)),
            run_delay: read("/proc/thread-self/schedstat").and_then(|text| run_delay(&text)),
            // Read last, so that page faults of taking the first sample are not counted.
            page_faults: read("/proc/thread-self/stat").and_then(|text| page_faults(&text)),
        }
    }

    /// Load since an earlier sample that the same thread took.
    pub fn since(&self, earlier: &Self) -> MachineLoad {
        let both = self.processors.zip(earlier.processors);
        let time = both.map(|(now, then)| ProcessorTime {
            total: (now.total - then.total).max(0.0),
            stolen: (now.stolen - then.stolen).max(0.0),
        });
        let counted = |now: Option<u64>, then: Option<u64>| Some(now?.saturating_sub(then?));
        MachineLoad {
            seconds: self.taken.saturating_duration_since(earlier.taken).as_secs_f64(),
            stolen_s: time.map(|time| time.stolen),
            stolen_fraction: time.filter(|time| time.total > 0.0).map(|time| time.stolen / time.total),
            preempted: counted(self.preempted, earlier.preempted),
            run_delay_s: counted(self.run_delay, earlier.run_delay).map(|ns| ns as f64 * 1e-9),
            page_faults: counted(self.page_faults, earlier.page_faults),
        }
    }
}

/// Reads the first line of `/proc/stat`:
/// `cpu user nice system idle iowait irq softirq steal guest guest_nice`, of which the last two are included
/// in the first two.
fn processor_time(stat: &str) -> Option<ProcessorTime> {
    let line = stat.lines().next()?.strip_prefix("cpu ")?;
    let ticks: Vec<u64> = line.split_whitespace().map_while(|field| field.parse().ok()).take(8).collect();
    let stolen = *ticks.get(7)?;
    let total: u64 = ticks.iter().sum();
    Some(ProcessorTime { total: total as f64 / TICKS_PER_SECOND, stolen: stolen as f64 / TICKS_PER_SECOND })
}

/// Reads the involuntary context switches in `/proc/thread-self/status`.
fn preemptions(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("nonvoluntary_ctxt_switches:"))?;
    line.trim().parse().ok()
}

/// Reads the second field of `/proc/thread-self/schedstat`: time on a processor (ns), time waiting for one
/// (ns), and number of time slices.
fn run_delay(schedstat: &str) -> Option<u64> {
    schedstat.split_whitespace().nth(1)?.parse().ok()
}

/// Reads the minor and major page faults in `/proc/thread-self/stat`, the tenth and twelfth field, and adds
/// them. The second field is a name in brackets that may hold any characters.
fn page_faults(stat: &str) -> Option<u64> {
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().take(10).collect();
    let at = |number: usize| fields.get(number - 3)?.parse::<u64>().ok();
    Some(at(10)? + at(12)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counters_are_read_from_what_linux_writes() {
        let stat = "cpu  199237 14293 15896 88672 1369 0 105 574 7 3\ncpu0 1 2 3 4 5 6 7 8 9 10\nintr 5\n";
        let time = processor_time(stat).expect("a line of all processors");
        assert_eq!(time.stolen, 5.74);
        assert!((time.total - 3201.46).abs() < 1e-9, "{time:?}: guests are counted once");
        let status = "Name:\tpalpate\nvoluntary_ctxt_switches:\t7\nnonvoluntary_ctxt_switches:\t35\n";
        assert_eq!(preemptions(status), Some(35));
        assert_eq!(run_delay("123 82994 1\n"), Some(82_994));
        let stat = "7 (a ) thread) S 1 7 7 0 -1 4194304 90 0 2 0 0 1 0 0 20 0";
        assert_eq!(page_faults(stat), Some(92));
    }

    #[test]
    fn missing_counters_stay_unknown() {
        for text in ["", "cpu", "cpu 1 2 3", "cpu a b c d e f g h", "Name: x"] {
            let read = (processor_time(text), preemptions(text), page_faults(text));
            assert_eq!(read, (None, None, None), "{text}");
        }
        assert_eq!((run_delay(""), run_delay("5"), run_delay("5 x")), (None, None, None));
        let bare = MachineSample {
            taken: Instant::now(),
            processors: None,
            preempted: None,
            run_delay: None,
            page_faults: None,
        };
        let counted = MachineSample { preempted: Some(4), run_delay: Some(9), ..bare };
        let MachineLoad { stolen_s, stolen_fraction, preempted, run_delay_s, page_faults, .. } =
            counted.since(&bare);
        assert_eq!((stolen_s, stolen_fraction, preempted), (None, None, None));
        assert_eq!((run_delay_s, page_faults), (None, None));
    }

    #[test]
    fn a_load_is_the_difference_of_two_samples() {
        let time = |total, stolen| Some(ProcessorTime { total, stolen });
        let earlier = MachineSample {
            taken: Instant::now(),
            processors: time(100.0, 1.0),
            preempted: Some(5),
            run_delay: Some(1_000_000),
            page_faults: Some(9),
        };
        let later = MachineSample {
            taken: earlier.taken + std::time::Duration::from_secs(2),
            processors: time(108.0, 3.0),
            preempted: Some(40),
            run_delay: Some(3_000_000),
            page_faults: Some(12),
        };
        let load = later.since(&earlier);
        assert_eq!((load.seconds, load.stolen_s, load.stolen_fraction), (2.0, Some(2.0), Some(0.25)));
        assert_eq!((load.preempted, load.page_faults), (Some(35), Some(3)));
        assert!((load.run_delay_s.expect("counted") - 0.002).abs() < 1e-12);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn time_passes_between_samples() {
        let earlier = MachineSample::take();
        std::thread::sleep(std::time::Duration::from_millis(20));
        let load = MachineSample::take().since(&earlier);
        assert!(load.seconds >= 0.02, "{load:?}");
        assert!(load.stolen_fraction.is_none_or(|part| (0.0..=1.0).contains(&part)), "{load:?}");
    }
}
