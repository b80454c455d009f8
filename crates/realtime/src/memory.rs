//! Memory that is there before it is needed.

use crate::Outcome;

pub use system::{lock_memory, locked_bytes};

/// How much of a thread's stack is touched, bytes: several times what a step uses.
const STACK: usize = 128 * 1024;

/// Touches the next [`STACK`] bytes of the calling thread's stack.
#[inline(never)]
pub fn touch_stack() -> Outcome {
    std::hint::black_box(&mut [0_u8; STACK]);
    Outcome::granted(format!("{} KiB touched", STACK / 1024))
}

#[cfg(target_os = "linux")]
mod system {
    use nix::libc::MCL_ONFAULT;
    use nix::sys::mman::{MlockAllFlags, mlockall};
    use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit};

    use crate::Outcome;

    /// Bit of CAP_IPC_LOCK in a set of capabilities.
    const CAP_IPC_LOCK: u32 = 14;
    const REMEDY: &str =
        "allow it with the limit `memlock unlimited` in /etc/security/limits.conf, or CAP_IPC_LOCK";

    /// Locks the process's memory for as long as it lives: what is mapped now is brought in and stays, what is mapped later
    /// stays from its first touch on. It may take some hundred milliseconds the first time. Call it where all that the threads
    /// need is allocated, and before they start.
    ///
    /// Asked for only where there is no limit on locked memory: under one, a process whose memory is locked cannot have more
    /// than that, and ends where it needs it.
    pub fn lock_memory() -> Outcome {
        let limit = getrlimit(Resource::RLIMIT_MEMLOCK).map_or(0, |(soft, _)| soft);
        if limit != RLIM_INFINITY && !may_lock() {
            let kib = limit / 1024;
            return refused(format!("not locked: the limit is {kib} KiB"));
        }
        // Two calls, since the first alone fills memory: what is reserved later may be much more than is ever used.
        let later = MlockAllFlags::MCL_FUTURE | MlockAllFlags::from_bits_retain(MCL_ONFAULT);
        match mlockall(MlockAllFlags::MCL_CURRENT).and_then(|()| mlockall(later)) {
            Ok(()) => {
                Outcome::granted("locked: what is mapped now, and what will be from its first touch on")
            }
            Err(why) => refused(format!("not locked ({})", why.desc())),
        }
    }

    fn refused(detail: String) -> Outcome {
        Outcome { remedy: Some(REMEDY.to_owned()), ..Outcome::refused(detail) }
    }

    fn may_lock() -> bool {
        status("CapEff:")
            .and_then(|text| u64::from_str_radix(&text, 16).ok())
            .is_some_and(|capabilities| capabilities >> CAP_IPC_LOCK & 1 == 1)
    }

    /// Memory of this process that is locked, bytes; none where the system does not report it.
    pub fn locked_bytes() -> Option<u64> {
        let text = status("VmLck:")?;
        text.strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| 1024 * kib)
    }

    /// What `/proc/thread-self/status` has under a name.
    fn status(name: &str) -> Option<String> {
        let text = std::fs::read_to_string("/proc/thread-self/status").ok()?;
        text.lines().find_map(|line| line.strip_prefix(name)).map(|rest| rest.trim().to_owned())
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    use crate::Outcome;

    /// Locks the process's memory: not on this system.
    pub fn lock_memory() -> Outcome {
        Outcome::not_asked("memory is locked on Linux only")
    }

    /// Memory of this process that is locked: not known on this system.
    pub fn locked_bytes() -> Option<u64> {
        None
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use nix::sys::resource::{UsageWho, getrusage};

    use super::*;

    /// Pages that the calling thread has touched first.
    fn faults() -> i64 {
        getrusage(UsageWho::RUSAGE_THREAD).expect("Linux counts them").minor_page_faults()
    }

    #[inline(never)]
    fn use_stack(bytes: &mut [u8; STACK / 2]) -> u8 {
        bytes.iter_mut().for_each(|byte| *byte = byte.wrapping_add(1));
        std::hint::black_box(bytes)[7]
    }

    #[test]
    fn a_stack_that_was_touched_is_there() {
        let deep = || {
            let before = faults();
            use_stack(std::hint::black_box(&mut [0; STACK / 2]));
            faults() - before
        };
        let untouched = std::thread::spawn(deep).join().expect("no panic");
        let touched = std::thread::spawn(move || {
            touch_stack();
            deep()
        });
        let touched = touched.join().expect("no panic");
        assert!(touched == 0, "{touched} pages were touched first, {untouched} without");
    }

    #[test]
    #[allow(clippy::print_stdout)] // Says what could not be tried.
    fn memory_is_locked_or_the_remedy_is_named() {
        let outcome = lock_memory();
        let locked = locked_bytes().expect("Linux reports it");
        if outcome.is_granted() {
            assert!(locked > 0, "{outcome}");
            // What is mapped later is locked, too; threads of other tests that end give some of theirs back.
            let later = vec![1_u8; 64 << 20];
            assert!(locked_bytes().is_some_and(|now| now >= locked + later.len() as u64 / 2));
        } else {
            println!("skipped: {outcome}");
            assert_eq!(locked, 0);
            assert!(outcome.remedy.is_some_and(|remedy| remedy.contains("memlock")));
        }
    }
}
