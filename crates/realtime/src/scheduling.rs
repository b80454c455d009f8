//! Scheduling classes, priorities and timer slack.

pub use system::{priority_limit, realtime_priority};

use crate::{Outcome, Role};

/// Detail of requests on other systems.
#[cfg(not(target_os = "linux"))]
const ELSEWHERE: &str = "SCHED_FIFO is asked for on Linux only";

/// Requests the scheduling of a role for the calling thread.
pub fn ask(role: Role) -> Outcome {
    match role.priority() {
        Some(priority) => system::ask_for_fifo(priority),
        None => system::ask_for_normal(),
    }
}

/// Requests the smallest timer slack for the calling thread.
pub fn ask_for_exact_timers() -> Outcome {
    system::ask_for_exact_timers()
}

#[cfg(target_os = "linux")]
mod system {
    use std::io;

    use nix::sys::prctl::set_timerslack;
    use nix::sys::resource::{Resource, getrlimit};
    use thread_priority::{
        NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue,
        ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id, thread_schedule_policy,
        thread_schedule_policy_param,
    };

    use crate::{Outcome, Role};

    /// Smallest timer slack that Linux accepts, ns: 0 would mean the default of 50,000.
    const MIN_SLACK: u64 = 1;
    const FIFO: ThreadSchedulePolicy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    /// Value of `thread_priority` for a niceness of 0.
    const NORMAL_PRIORITY: u8 = 48;
    const NORMAL: ThreadSchedulePolicy = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);

    pub fn ask_for_fifo(priority: u8) -> Outcome {
        let Err(why) = set(FIFO, priority) else {
            return Outcome::granted(format!("SCHED_FIFO, priority {priority}"));
        };
        let limit = priority_limit().unwrap_or(0);
        // A lower priority is better than normal scheduling.
        let lower = u8::try_from(limit).ok().filter(|&lower| lower > 0 && lower < priority);
        if let Some(lower) = lower.filter(|&lower| set(FIFO, lower).is_ok()) {
            let detail = format!("SCHED_FIFO, priority {lower} instead of {priority}");
            return Outcome { remedy: Some(remedy(limit)), ..Outcome::granted(detail) };
        }
        let refused = Outcome::refused(format!("SCHED_FIFO was refused ({why})"));
        Outcome { remedy: Some(remedy(limit)), ..refused }
    }

    fn remedy(limit: u64) -> String {
        // The highest priority of all roles.
        let needed = Role::Device.priority().unwrap_or_default();
        if limit >= u64::from(needed) {
            "the limit on real-time priority would allow it: look for a container or control group that forbids real-time threads"
                .to_owned()
        } else {
            format!(
                "allow it with a `rtprio` limit of {needed} in /etc/security/limits.conf (it is {limit}), or CAP_SYS_NICE"
            )
        }
    }

    pub fn ask_for_normal() -> Outcome {
        match thread_schedule_policy() {
            Ok(ThreadSchedulePolicy::Realtime(_)) => match set(NORMAL, NORMAL_PRIORITY) {
                Ok(()) => Outcome::granted("normal, instead of inherited real-time scheduling"),
                Err(why) => Outcome::refused(format!("inherited real-time scheduling stays ({why})")),
            },
            _ => Outcome::granted("normal, as intended"),
        }
    }

    /// Sets the calling thread's policy and priority.
    fn set(policy: ThreadSchedulePolicy, priority: u8) -> Result<(), String> {
        let priority = ThreadPriority::Crossplatform(ThreadPriorityValue::try_from(priority)?);
        set_thread_priority_and_policy(thread_native_id(), priority, policy).map_err(|error| match error {
            thread_priority::Error::OS(number) => io::Error::from_raw_os_error(number).to_string(),
            other => format!("{other:?}"),
        })
    }

    /// Returns the SCHED_FIFO priority of the calling thread as the system reports it; `None` under another
    /// policy.
    pub fn realtime_priority() -> Option<u8> {
        match thread_schedule_policy_param(thread_native_id()) {
            Ok((FIFO, parameters)) => u8::try_from(parameters.sched_priority).ok(),
            _ => None,
        }
    }

    /// Returns the highest real-time priority of threads without privileges (RLIMIT_RTPRIO); `None` if the
    /// system has no such limit.
    pub fn priority_limit() -> Option<u64> {
        getrlimit(Resource::RLIMIT_RTPRIO).ok().map(|(soft, _)| soft)
    }

    pub fn ask_for_exact_timers() -> Outcome {
        match set_timerslack(MIN_SLACK) {
            Ok(()) => Outcome::granted(format!("{MIN_SLACK} ns")),
            Err(why) => Outcome::refused(format!("as it was ({})", why.desc())),
        }
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    use super::ELSEWHERE;
    use crate::Outcome;

    pub fn ask_for_fifo(_: u8) -> Outcome {
        Outcome::not_asked(ELSEWHERE)
    }

    pub fn ask_for_normal() -> Outcome {
        Outcome::granted("normal, as intended")
    }

    /// Returns the SCHED_FIFO priority of the calling thread; not supported on this system.
    pub fn realtime_priority() -> Option<u8> {
        None
    }

    /// Returns the highest real-time priority of threads without privileges; this system has no such limit.
    pub fn priority_limit() -> Option<u64> {
        None
    }

    pub fn ask_for_exact_timers() -> Outcome {
        Outcome::not_asked("timer slack is set on Linux only")
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use crate::{State, set_up};

    /// Returns the niceness of the calling thread.
    fn niceness() -> i64 {
        let stat = std::fs::read_to_string("/proc/thread-self/stat").expect("Linux has it");
        let after_name = &stat[stat.rfind(')').expect("a name in brackets") + 1..];
        after_name.split_whitespace().nth(16).and_then(|field| field.parse().ok()).expect("a niceness")
    }

    /// The system reports the granted priority, or the one from before.
    #[test]
    #[allow(clippy::print_stdout)] // Says what could not be tried.
    fn thread_has_the_granted_priority() {
        for role in [Role::Device, Role::Haptic, Role::Contact] {
            let thread = std::thread::spawn(move || (realtime_priority(), set_up(role), realtime_priority()));
            let (before, setup, after) = thread.join().expect("no panic");
            assert_eq!(before, None, "the tests run at normal priority");
            match setup.scheduling.state {
                State::Granted => assert_eq!(after, role.priority(), "{setup:?}"),
                _ => {
                    assert_eq!(after, None);
                    let remedy = setup.scheduling.remedy.as_deref().unwrap_or_default();
                    assert!(remedy.contains("rtprio") || remedy.contains("control group"), "{setup:?}");
                    println!("skipped: {}", setup.scheduling);
                }
            }
        }
    }

    #[test]
    fn contact_thread_leaves_inherited_real_time_scheduling() {
        let thread = std::thread::spawn(|| {
            let niceness_before = niceness();
            let haptic = set_up(Role::Haptic);
            let inherited = std::thread::spawn(|| {
                let inherited = realtime_priority();
                (inherited, set_up(Role::Contact).scheduling, realtime_priority(), niceness())
            });
            (haptic.scheduling, niceness_before, inherited.join().expect("no panic"))
        });
        let (haptic, niceness_before, (inherited, contact, after, niceness_after)) =
            thread.join().expect("no panic");
        assert_eq!(inherited.is_some(), haptic.is_granted());
        assert!(contact.is_granted() && contact.detail.starts_with("normal"), "{contact}");
        assert_eq!(after, None);
        // A thread that inherited real-time scheduling has niceness 0; others keep theirs.
        assert_eq!(niceness_after, if inherited.is_some() { 0 } else { niceness_before });
    }

    #[test]
    fn timers_are_exact() {
        let slack = std::thread::spawn(|| {
            assert!(ask_for_exact_timers().is_granted());
            nix::sys::prctl::get_timerslack()
        });
        assert_eq!(slack.join().expect("no panic"), Ok(1));
    }
}
