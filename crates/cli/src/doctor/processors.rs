//! Processors: how many, at what frequency, and whether a hypervisor takes them away.

use std::collections::BTreeSet;
use std::path::Path;

use palpate::machine::MachineLoad;

use super::finding::{Finding, Verdict};

/// Part of the processors' time that may go to other virtual machines before it is felt.
const STOLEN: f64 = 1e-3;
/// Part of it with which no haptic loop keeps its rate.
const MUCH_STOLEN: f64 = 0.02;
/// Processors that leave one to the rest of the system beside the two loops.
const ENOUGH: usize = 4;

pub fn stolen_time(load: &MachineLoad) -> Finding {
    const NAME: &str = "stolen time";
    let (Some(seconds), Some(part)) = (load.stolen_s, load.stolen_fraction) else {
        let seen = "this operating system does not report what a hypervisor takes".to_owned();
        return Finding::new(NAME, Verdict::Unknown, seen);
    };
    let verdict = match part {
        part if part <= STOLEN => Verdict::Good,
        part if part <= MUCH_STOLEN => Verdict::CouldBeBetter,
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
        finding.with_remedy("render on a machine that is not virtual, or on dedicated processors")
    }
}

pub fn frequency() -> Finding {
    governors(Path::new("/sys/devices/system/cpu"))
}

/// The frequency governors under a folder with a folder a processor.
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
        let seen = "the frequency governor is not to be seen, as in virtual machines and on systems other than Linux";
        return Finding::new(NAME, Verdict::Unknown, seen.to_owned());
    }
    let fast = found.iter().all(|governor| governor == "performance");
    let found = found.into_iter().collect::<Vec<_>>().join(", ");
    let seen = format!("frequency governor: {found}");
    if fast {
        Finding::new(NAME, Verdict::Good, seen)
    } else {
        Finding::new(NAME, Verdict::CouldBeBetter, seen).with_remedy(
            "let processors run at full frequency: `sudo cpupower frequency-set --governor performance`",
        )
    }
}

pub fn count() -> Finding {
    const NAME: &str = "processors";
    let Ok(count) = std::thread::available_parallelism().map(usize::from) else {
        return Finding::new(NAME, Verdict::Unknown, "their number is not known".to_owned());
    };
    verdict_on(NAME, count)
}

fn verdict_on(name: &'static str, count: usize) -> Finding {
    let needed = "the haptic and the contact loop need one each; textures on the processor use more";
    let measured = format!("{count}; {needed}");
    match count {
        0 | 1 => Finding::new(name, Verdict::Bad, measured).with_remedy(
            "render on a machine with two processors or more, or let this process use more (taskset, cpuset)",
        ),
        count if count < ENOUGH => Finding::new(name, Verdict::CouldBeBetter, measured)
            .with_remedy("close other programs, which otherwise run in turns with the loops"),
        _ => Finding::new(name, Verdict::Good, measured),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn governors_are_read_of_all_processors() {
        let folder = tempfile::tempdir().unwrap();
        let set = |processor: &str, governor: &str| {
            let at = folder.path().join(processor).join("cpufreq");
            std::fs::create_dir_all(&at).unwrap();
            std::fs::write(at.join("scaling_governor"), format!("{governor}\n")).unwrap();
        };
        assert_eq!(governors(folder.path()).verdict, Verdict::Unknown);
        assert_eq!(governors(&folder.path().join("missing")).verdict, Verdict::Unknown);
        set("cpufreq", "powersave"); // A folder beside those of processors.
        set("cpu0", "performance");
        assert_eq!(governors(folder.path()).verdict, Verdict::Good);
        set("cpu12", "powersave");
        let mixed = governors(folder.path());
        assert_eq!(mixed.verdict, Verdict::CouldBeBetter);
        assert!(mixed.measured.ends_with("performance, powersave") && mixed.remedy.is_some(), "{mixed:?}");
    }

    #[test]
    fn verdicts_follow_what_is_stolen_and_how_many_there_are() {
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
