//! `palpate doctor`: checks whether this machine is fit for haptics.
//!
//! Checks of unknown duration (drivers, devices, folders on a network) run in separate threads, and are
//! abandoned after [`TIMEOUT`]. Then the lateness of the timer is measured, with nothing else running.

mod cache;
mod devices;
mod finding;
mod graphics;
mod lateness;
mod libraries;
mod privileges;
mod processors;

use std::sync::mpsc;
use std::time::{Duration, Instant};

use palpate_report::Machine;
use serde::Serialize;

use crate::arguments::DoctorArguments;
use crate::failure::Failure;
use crate::output;
use finding::{Finding, Verdict};
use lateness::Lateness;

/// Time limit of the checks of drivers, devices and folders. With a shorter one, slow drivers are reported as
/// unknown.
const TIMEOUT: Duration = Duration::from_secs(3);

#[derive(Serialize)]
struct Report {
    machine: Machine,
    findings: Vec<Finding>,
    lateness_us: Lateness,
    /// Line for `/etc/security/limits.conf` that allows this user real-time scheduling.
    limits_line: String,
}

pub fn run(arguments: &DoctorArguments) -> Result<(), Failure> {
    output::check_files(&[], arguments.json.file().as_slice())?;
    let [graphics, hid, libraries, cache] = run_all([
        ("graphics adapters", graphics::finding),
        ("HID devices", devices::finding),
        ("libraries of device makers", libraries::finding),
        ("cache of hierarchies", cache::finding),
    ]);
    let measured = palpate::machine::measure_wake_lateness(lateness::RATE, lateness::SECONDS);
    let lateness = Lateness::new(&measured);
    let findings = vec![
        privileges::finding(&measured.setup),
        lateness::finding(&lateness, measured.setup.scheduling.is_granted()),
        privileges::memory(),
        processors::stolen_time(&measured.machine),
        processors::frequency(),
        processors::count(),
        graphics,
        hid,
        libraries,
        cache,
    ];
    let report = Report {
        machine: Machine::this(),
        findings,
        lateness_us: lateness,
        limits_line: privileges::limits_line(),
    };
    output::text_or_json(&arguments.json, &report, || print(&report))
}

type Check = fn() -> Finding;

/// Runs all checks at once. A check that takes too long or fails is reported as unknown.
fn run_all<const N: usize>(checks: [(&'static str, Check); N]) -> [Finding; N] {
    let deadline = Instant::now() + TIMEOUT;
    let checks = checks.map(|(name, check)| {
        let (send, found) = mpsc::channel();
        let begun = std::thread::Builder::new().name(name.to_owned()).spawn(move || {
            // The receiver is gone if the check took too long.
            let _ = send.send(check());
        });
        (name, begun.is_ok(), found)
    });
    checks.map(|(name, begun, found)| {
        if !begun {
            return Finding::new(name, Verdict::Unknown, "no thread could be started".to_owned());
        }
        let left = deadline.saturating_duration_since(Instant::now());
        found.recv_timeout(left).unwrap_or_else(|error| {
            let cause = match error {
                mpsc::RecvTimeoutError::Timeout => format!(
                    "no answer within {} s: a driver hangs, or the machine is very busy",
                    TIMEOUT.as_secs()
                ),
                mpsc::RecvTimeoutError::Disconnected => "the check failed".to_owned(),
            };
            Finding::new(name, Verdict::Unknown, cause)
        })
    })
}

/// Writes the report as text.
fn print(report: &Report) -> String {
    let mut lines = vec![report.machine.build(), report.machine.processor_line(), String::new()];
    for finding in &report.findings {
        lines.push(format!("{:<17}{}: {}", finding.verdict.to_string(), finding.name, finding.measured));
        lines.extend(finding.remedy.as_ref().map(|remedy| format!("{:<17}-> {remedy}", "")));
    }
    lines.push(String::new());
    lines.extend(lateness::plot(&report.lateness_us));
    lines.push(String::new());
    let count = |verdict| report.findings.iter().filter(|finding| finding.verdict == verdict).count();
    let bad = count(Verdict::Bad);
    let better = count(Verdict::CouldBeBetter);
    lines.push(match (bad, better) {
        (0, 0) => "This machine is fit for haptics, as far as these checks show.".to_owned(),
        (0, better) => format!("This machine is fit for haptics; {better} of its findings could be better."),
        (bad, _) => format!("This machine is not fit for haptics yet: {bad} of its findings are bad."),
    });
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checks_that_hang_or_fail_are_unknown_and_the_others_are_not() {
        let good: Check = || Finding::new("quick", Verdict::Good, "there".to_owned());
        let hangs: Check = || {
            std::thread::sleep(Duration::from_secs(3600));
            Finding::new("slow", Verdict::Good, "late".to_owned())
        };
        let fails: Check = || std::panic::resume_unwind(Box::new("broken"));
        let begun = Instant::now();
        let [slow, quick, broken] = run_all([("slow", hangs), ("quick", good), ("broken", fails)]);
        assert!(begun.elapsed() < TIMEOUT + Duration::from_secs(2));
        assert_eq!((slow.name, slow.verdict), ("slow", Verdict::Unknown));
        assert_eq!((quick.name, quick.verdict), ("quick", Verdict::Good));
        assert_eq!((broken.name, broken.verdict), ("broken", Verdict::Unknown));
    }
}
