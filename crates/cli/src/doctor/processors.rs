//! Check of processors: their number, their frequency, and the time that a hypervisor takes.

use std::collections::BTreeSet;
use std::path::Path;

use palpate::machine::MachineLoad;

use super::finding::{Finding, Verdict};

/// Largest stolen fraction of the processors' time for the verdict "good": a larger one is felt.
const MAX_GOOD_STOLEN: f64 = 1e-3;
/// Largest stolen fraction of the processors' time for "could be better": with a larger one, no haptic loop
/// keeps its rate.
const MAX_FAIR_STOLEN: f64 = 0.02;
/// Smallest number of processors for "good": the rest of the system has its own beside those of the two
/// loops.
const MIN_GOOD_PROCESSORS: usize = 4;

pub fn stolen_time(load: &MachineLoad) -> Finding {
    const NAME: &str = "stolen time";
    let (Some(seconds), Some(part)) = (load.stolen_s, load.stolen_fraction) else {
        let seen = "this operating system does not report the time that a hypervisor takes".to_owned();
        return Finding::new(NAME, Verdict::Unknown, seen);
    };
    let verdict = match part {
        part if part <= MAX_GOOD_STOLEN => Verdict::Good,
        part if part <= MAX_FAIR_STOLEN => Verdict::CouldBeBetter,
        _ => Verdict::Bad,
    };
    let measured = format!(
        "other virtual machines took {seconds:.2} s, {:.1} % of all processors' time while the timer was measured",
        100.0 * part
    );
    let finding = Finding::new(NAME, verdict, measured);
    if verdict == Verdict::Good {
        finding
    } else {
        finding.with_remedy("render on a physical machine, or on dedicated processors")
    }
}

pub fn frequency() -> Finding {
    governors(Path::new("/sys/devices/system/cpu"))
}

/// Finding about the frequency governors under a folder with one folder per processor.
fn governors(folder: &Path) -> Finding {
    const NAME: &str = "processor frequency";
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let found: BTreeSet<String> = entries
        .filter(|entry| {
            let name = entry.file_name().to_string_lossy().into_owned();
            name.strip_prefix("cpu").is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
        })
        .filter_map(|entry| std::fs::read_to_string(entry.path().join("cpufreq/scaling_governor")).ok())
        .map(|governor| governor.trim().to_owned())
        .collect();
    if found.is_empty() {
        let seen =
            "the frequency governor cannot be read, as in virtual machines and on systems other than Linux";
        return Finding::new(NAME, Verdict::Unknown, seen.to_owned());
    }
    let fast = found.iter().all(|governor| governor == "performance");
    let found = found.into_iter().collect::<Vec<_>>().join(", ");
    let seen = format!("frequency governor: {found}");
    if fast {
        Finding::new(NAME, Verdict::Good, seen)
    } else {
        Finding::new(NAME, Verdict::CouldBeBetter, seen).with_remedy(
            "set processors to full frequency: `sudo cpupower frequency-set --governor performance`",
        )
    }
}

pub fn count() -> Finding {
    const NAME: &str = "processors";
    let Ok(count) = std::thread::available_parallelism().map(usize::from) else {
        return Finding::new(NAME, Verdict::Unknown, "their number is unknown".to_owned());
    };
    verdict_on(NAME, count)
}

fn verdict_on(name: &'static str, count: usize) -> Finding {
    let needed = "the haptic loop and the contact loop need one each; textures on the processor use more";
    let measured = format!("{count}; {needed}");
    match count {
        0 | 1 => Finding::new(name, Verdict::Bad, measured).with_remedy(
            "render on a machine with two processors or more, or allow this process more (taskset, cpuset)",
        ),
        count if count < MIN_GOOD_PROCESSORS => Finding::new(name, Verdict::CouldBeBetter, measured)
            .with_remedy("close other programs, which otherwise share processors with the loops"),
        _ => Finding::new(name, Verdict::Good, measured),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn governors_of_all_processors_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let set = |processor: &str, governor: &str| {
            let at = folder.path().join(processor).join("cpufreq");
            std::fs::create_dir_all(&at).unwrap();
            std::fs::write(at.join("scaling_governor"), format!("{governor}\n")).unwrap();
        };
        assert_eq!(governors(folder.path()).verdict, Verdict::Unknown);
        assert_eq!(governors(&folder.path().join("missing")).verdict, Verdict::Unknown);
        set("cpufreq", "powersave"); // Not the folder of a processor.
        set("cpu0", "performance");
        assert_eq!(governors(folder.path()).verdict, Verdict::Good);
        set("cpu12", "powersave");
        let mixed = governors(folder.path());
        assert_eq!(mixed.verdict, Verdict::CouldBeBetter);
        assert!(mixed.measured.ends_with("performance, powersave") && mixed.remedy.is_some(), "{mixed:?}");
    }

    #[test]
    fn verdicts_follow_stolen_time_and_the_number_of_processors() {
        let stolen = |part: Option<f64>| {
            let load = MachineLoad { stolen_s: part, stolen_fraction: part, ..MachineLoad::default() };
            stolen_time(&load).verdict
        };
        assert_eq!(stolen(None), Verdict::Unknown);
        assert_eq!(stolen(Some(0.0)), Verdict::Good);
        assert_eq!(stolen(Some(0.01)), Verdict::CouldBeBetter);
        assert_eq!(stolen(Some(0.1)), Verdict::Bad);
        let verdict = |count| verdict_on("processors", count).verdict;
        assert_eq!([1, 2, 8].map(verdict), [Verdict::Bad, Verdict::CouldBeBetter, Verdict::Good]);
    }
}
