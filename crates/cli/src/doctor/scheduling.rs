//! Real-time scheduling: whether the haptic thread may have SCHED_FIFO, and how to allow it.

use palpate::{REALTIME_PRIORITY, WakeLateness};

use super::finding::{Finding, Verdict};

const NAME: &str = "real-time scheduling";

pub fn finding(measured: &WakeLateness) -> Finding {
    let limit = limit();
    let said = limit.map(|limit| format!("; limit on real-time priority (RLIMIT_RTPRIO): {limit}"));
    let said = said.unwrap_or_default();
    if measured.realtime {
        return Finding::new(NAME, Verdict::Good, format!("{} was granted{said}", measured.scheduling));
    }
    if !cfg!(target_os = "linux") {
        let seen = "palpate asks for real-time scheduling on Linux only";
        return Finding::new(NAME, Verdict::CouldBeBetter, seen.to_owned())
            .with_remedy("close other programs while you render");
    }
    let remedy = if limit.is_some_and(|limit| limit >= u64::from(REALTIME_PRIORITY)) {
        "the limit would allow it: look for a container or control group that forbids real-time threads \
         (cpu.rt_runtime_us, --cap-add sys_nice)"
            .to_owned()
    } else {
        let line = limits_line();
        format!("add the line `{line}` to /etc/security/limits.conf, then log out and in again")
    };
    let seen = format!("SCHED_FIFO was refused{said}");
    Finding::new(NAME, Verdict::CouldBeBetter, seen).with_remedy(remedy)
}

/// The line for `/etc/security/limits.conf` that lets the current user have the priority that palpate asks for.
pub fn limits_line() -> String {
    format!("{} - rtprio {REALTIME_PRIORITY}", user())
}

/// The name of the current user; what numbers it in limits.conf where it has none.
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

/// The highest real-time priority that an unprivileged thread may take.
#[cfg(target_os = "linux")]
fn limit() -> Option<u64> {
    use nix::sys::resource::{Resource, getrlimit};
    getrlimit(Resource::RLIMIT_RTPRIO).ok().map(|(soft, _)| soft)
}

#[cfg(not(target_os = "linux"))]
fn limit() -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_comes_with_the_line_that_helps() {
        let mut measured = palpate::measure_wake_lateness(1000.0, 0.0);
        (measured.realtime, measured.scheduling) = (false, "normal".to_owned());
        let refused = finding(&measured);
        assert_eq!(refused.verdict, Verdict::CouldBeBetter);
        let wanted =
            if limit().is_some_and(|limit| limit >= 80) { "container".to_owned() } else { limits_line() };
        if cfg!(target_os = "linux") {
            assert!(refused.remedy.is_some_and(|remedy| remedy.contains(&wanted)));
        }
        (measured.realtime, measured.scheduling) = (true, "SCHED_FIFO, priority 80".to_owned());
        let granted = finding(&measured);
        assert_eq!((granted.verdict, granted.remedy), (Verdict::Good, None));
        assert!(granted.measured.starts_with("SCHED_FIFO, priority 80 was granted"));
    }
}
