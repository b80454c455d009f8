//! Memory that is present before it is used: a touched stack and locked pages.

use crate::Outcome;

pub use system::{lock_memory, locked_bytes};

/// Size of the touched part of a thread's stack, bytes: several times the use of a step.
const STACK_BYTES: usize = 128 * 1024;

/// Touches the next [`STACK_BYTES`] bytes of the calling thread's stack.
#[inline(never)]
pub fn touch_stack() -> Outcome {
    std::hint::black_box(&mut [0_u8; STACK_BYTES]);
    Outcome::granted(format!("{} KiB touched", STACK_BYTES / 1024))
}

#[cfg(target_os = "linux")]
mod system {
    use nix::libc::MCL_ONFAULT;
    use nix::sys::mman::{MlockAllFlags, mlockall};
    use nix::sys::resource::{RLIM_INFINITY, Resource, getrlimit};

    use crate::Outcome;

    /// Bit of CAP_IPC_LOCK in a set of capabilities.
    const CAP_IPC_LOCK: u32 = 14;
    /// Advice for a user whose memory is not locked.
    const REMEDY: &str =
        "allow it with the limit `memlock unlimited` in /etc/security/limits.conf, or CAP_IPC_LOCK";

    /// Locks the process's memory until it ends: mapped pages are loaded and stay in memory, and pages mapped
    /// later stay from their first touch on. The first call may take some hundred milliseconds. Call it after
    /// all memory of the threads is allocated, and before they start.
    ///
    /// The request is made only if locked memory is unlimited. Under a limit, a process with locked memory
    /// that needs more than the limit fails to allocate and ends.
    pub fn lock_memory() -> Outcome {
        let limit = getrlimit(Resource::RLIMIT_MEMLOCK).map_or(0, |(soft, _)| soft);
        if limit != RLIM_INFINITY && !may_lock() {
            let kib = limit / 1024;
            return refused(format!("not locked: the limit is {kib} KiB"));
        }
        // Two calls, so that only present mappings are filled: later reservations may be much larger than
        // their use.
        let later = MlockAllFlags::MCL_FUTURE | MlockAllFlags::from_bits_retain(MCL_ONFAULT);
        match mlockall(MlockAllFlags::MCL_CURRENT).and_then(|()| mlockall(later)) {
            Ok(()) => Outcome::granted("locked: mapped pages now, and later ones from their first touch on"),
            Err(why) => refused(format!("not locked ({})", why.desc())),
        }
    }

    /// Returns a refusal with the remedy.
    fn refused(detail: String) -> Outcome {
        Outcome { remedy: Some(REMEDY.to_owned()), ..Outcome::refused(detail) }
    }

    /// Returns whether the process has CAP_IPC_LOCK.
    fn may_lock() -> bool {
        status("CapEff:")
            .and_then(|text| u64::from_str_radix(&text, 16).ok())
            .is_some_and(|capabilities| capabilities >> CAP_IPC_LOCK & 1 == 1)
    }

    /// Returns the size of this process's locked memory, bytes; `None` if the system does not report it.
    pub fn locked_bytes() -> Option<u64> {
        let text = status("VmLck:")?;
        text.strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| 1024 * kib)
    }

    /// Returns the entry of `/proc/thread-self/status` with a name.
    fn status(name: &str) -> Option<String> {
        let text = std::fs::read_to_string("/proc/thread-self/status").ok()?;
        text.lines().find_map(|line| line.strip_prefix(name)).map(|rest| rest.trim().to_owned())
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    use crate::Outcome;

    /// Locks the process's memory; not supported on this system.
    pub fn lock_memory() -> Outcome {
        Outcome::not_asked("memory is locked on Linux only")
    }

    /// Returns the size of this process's locked memory; not known on this system.
    pub fn locked_bytes() -> Option<u64> {
        None
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use nix::sys::resource::{UsageWho, getrusage};

    use super::*;

    /// Returns the number of page faults of the calling thread.
    fn faults() -> i64 {
        getrusage(UsageWho::RUSAGE_THREAD).expect("Linux counts them").minor_page_faults()
    }

    #[inline(never)]
    fn use_stack(bytes: &mut [u8; STACK_BYTES / 2]) -> u8 {
        bytes.iter_mut().for_each(|byte| *byte = byte.wrapping_add(1));
        std::hint::black_box(bytes)[7]
    }

    #[test]
    fn touched_stack_causes_no_page_faults() {
        let deep = || {
            let before = faults();
            use_stack(std::hint::black_box(&mut [0; STACK_BYTES / 2]));
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
            // Memory mapped later is locked as well; threads of other tests that end release some of theirs.
            let later = vec![1_u8; 64 << 20];
            assert!(locked_bytes().is_some_and(|now| now >= locked + later.len() as u64 / 2));
        } else {
            println!("skipped: {outcome}");
            assert_eq!(locked, 0);
            assert!(outcome.remedy.is_some_and(|remedy| remedy.contains("memlock")));
        }
    }
}
