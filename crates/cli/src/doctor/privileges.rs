//! Check of privileges: whether the threads may use SCHED_FIFO and the process may lock its memory, and how
//! to allow it.

use palpate::threads::{Outcome, Role, State, ThreadSetup, lock_memory, priority_limit, set_up};

use super::finding::{Finding, Verdict};

const PRIORITY: &str = "real-time scheduling";
const MEMORY: &str = "locked memory";

/// Privileges that a thread of the role obtains.
fn obtained(role: Role) -> Option<ThreadSetup> {
    std::thread::spawn(move || set_up(role)).join().ok()
}

/// Finding about scheduling; `haptic` are the privileges that a haptic thread obtained.
pub fn finding(haptic: &ThreadSetup) -> Finding {
    let device = obtained(Role::Device);
    let threads = device.iter().map(|setup| ("device", setup)).chain([("haptic", haptic)]);
    verdict_on(&threads.map(|(name, setup)| (name, &setup.scheduling)).collect::<Vec<_>>(), priority_limit())
}

fn verdict_on(threads: &[(&str, &Outcome)], limit: Option<u64>) -> Finding {
    let said: Vec<String> =
        threads.iter().map(|(name, outcome)| format!("{name} thread: {}", outcome.detail)).collect();
    let limit_said = limit.map(|limit| format!("; limit on real-time priority (RLIMIT_RTPRIO): {limit}"));
    let seen = said.join(", ") + &limit_said.unwrap_or_default();
    if threads.iter().all(|(_, outcome)| outcome.is_granted() && outcome.remedy.is_none()) {
        return Finding::new(PRIORITY, Verdict::Good, seen);
    }
    let finding = Finding::new(PRIORITY, Verdict::CouldBeBetter, seen);
    if threads.iter().any(|(_, outcome)| outcome.state == State::NotAsked) {
        finding.with_remedy("close other programs while you render")
    } else if limit.is_some_and(|limit| limit >= u64::from(highest_priority())) {
        finding.with_remedy(
            "the limit would allow it: look for a container or control group that forbids real-time threads \
             (cpu.rt_runtime_us, --cap-add sys_nice)",
        )
    } else {
        finding.with_remedy(add_line(&limits_line()))
    }
}

/// Finding about locked memory.
pub fn memory() -> Finding {
    verdict_on_memory(&lock_memory())
}

fn verdict_on_memory(outcome: &Outcome) -> Finding {
    let seen = outcome.detail.clone();
    match outcome.state {
        State::Granted => Finding::new(MEMORY, Verdict::Good, seen),
        State::Refused => Finding::new(MEMORY, Verdict::CouldBeBetter, seen)
            .with_remedy(add_line(&format!("{} - memlock unlimited", user()))),
        State::NotAsked => Finding::new(MEMORY, Verdict::CouldBeBetter, seen)
            .with_remedy("close programs that need much memory while you render"),
    }
}

fn add_line(line: &str) -> String {
    format!("add the line `{line}` to /etc/security/limits.conf, then log out and in again")
}

/// Highest priority that palpate requests.
fn highest_priority() -> u8 {
    Role::Device.priority().max(Role::Haptic.priority()).unwrap_or_default()
}

/// Line for `/etc/security/limits.conf` that allows the current user the priorities that palpate requests.
pub fn limits_line() -> String {
    format!("{} - rtprio {}", user(), highest_priority())
}

/// Name of the current user; a user without a name is given by number, in the syntax of limits.conf.
#[cfg(unix)]
fn user() -> String {
    let id = nix::unistd::geteuid();
    let known = nix::unistd::User::from_uid(id).ok().flatten();
    known.map_or_else(|| format!("{id}:"), |user| user.name)
}

#[cfg(not(unix))]
fn user() -> String {
    std::env::var("USERNAME").unwrap_or_else(|_| "USER".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(state: State, detail: &str, remedy: Option<&str>) -> Outcome {
        Outcome { state, detail: detail.to_owned(), remedy: remedy.map(str::to_owned) }
    }

    #[test]
    fn a_refusal_gives_the_line_for_limits_conf() {
        let refused = outcome(State::Refused, "SCHED_FIFO was refused", Some("allow it"));
        let granted = outcome(State::Granted, "SCHED_FIFO, priority 80", None);
        let less = outcome(State::Granted, "SCHED_FIFO, priority 80 in place of 85", Some("allow it"));
        for (device, haptic) in [(&refused, &refused), (&less, &granted)] {
            let threads = [("device", device), ("haptic", haptic)];
            let limited = verdict_on(&threads, Some(80));
            assert_eq!(limited.verdict, Verdict::CouldBeBetter);
            assert!(limited.measured.contains("(RLIMIT_RTPRIO): 80"), "{limited:?}");
            assert!(limited.remedy.is_some_and(|remedy| remedy.contains(&limits_line())));
            let allowed = verdict_on(&threads, Some(99));
            assert!(allowed.remedy.is_some_and(|remedy| remedy.contains("container")));
        }
        let all = verdict_on(&[("device", &granted), ("haptic", &granted)], None);
        assert_eq!((all.verdict, all.remedy), (Verdict::Good, None));
        assert_eq!(
            all.measured,
            "device thread: SCHED_FIFO, priority 80, haptic thread: SCHED_FIFO, priority 80"
        );
        assert!(limits_line().ends_with(" - rtprio 85"));
    }

    #[test]
    fn unlocked_memory_gives_the_line_for_limits_conf() {
        let refused = verdict_on_memory(&outcome(State::Refused, "not locked", Some("allow it")));
        assert!(refused.remedy.is_some_and(|remedy| remedy.contains(" - memlock unlimited")));
        let granted = verdict_on_memory(&outcome(State::Granted, "locked", None));
        assert_eq!((granted.verdict, granted.remedy), (Verdict::Good, None));
        let elsewhere = verdict_on_memory(&outcome(State::NotAsked, "not on this system", None));
        assert_eq!(elsewhere.verdict, Verdict::CouldBeBetter);
    }
}
