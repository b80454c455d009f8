//! CPU affinity: the processors that a thread may run on.

use crate::{Outcome, Role};

/// Smallest number of allowed processors that are divided among roles. With fewer, each thread is better off
/// on whichever is free.
const MIN_PROCESSORS: usize = 4;
/// Number of processors that the device and haptic threads share.
const RESERVED_PROCESSORS: usize = 2;

/// Returns the part of the allowed processors for a role; `None` if there are too few to divide.
fn part_of(allowed: &[usize], role: Role) -> Option<&[usize]> {
    let split = allowed.len().checked_sub(RESERVED_PROCESSORS).filter(|_| allowed.len() >= MIN_PROCESSORS)?;
    let (others, reserved) = allowed.split_at(split);
    Some(if role == Role::Contact { others } else { reserved })
}

/// Requests a role's processors for the calling thread; `realtime` says whether it has its real-time
/// priority.
pub fn ask(role: Role, realtime: bool) -> Outcome {
    if role != Role::Contact && !realtime {
        // Without real-time priority the thread could not preempt other programs on these two processors.
        return Outcome::not_asked("all that are allowed: reserved processors need real-time scheduling");
    }
    let allowed = match system::allowed() {
        Ok(allowed) => allowed,
        Err(why) => return Outcome::not_asked(why),
    };
    let Some(part) = part_of(&allowed, role) else {
        return Outcome::not_asked(format!(
            "all {} that are allowed: fewer than {MIN_PROCESSORS} are not divided",
            allowed.len()
        ));
    };
    let named: Vec<String> = part.iter().map(ToString::to_string).collect();
    let named = named.join(", ");
    match system::keep_to(part) {
        Ok(()) => Outcome::granted(format!("{named} of {} that are allowed", allowed.len())),
        Err(why) => Outcome::refused(format!("{named} were refused ({why})")),
    }
}

#[cfg(target_os = "linux")]
mod system {
    use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
    use nix::unistd::Pid;

    /// Returns the processors that the calling thread may run on, in ascending order.
    pub fn allowed() -> Result<Vec<usize>, String> {
        let set = sched_getaffinity(Pid::from_raw(0)).map_err(|why| why.desc().to_owned())?;
        Ok((0..CpuSet::count()).filter(|&processor| set.is_set(processor) == Ok(true)).collect())
    }

    /// Restricts the calling thread to some processors.
    pub fn keep_to(processors: &[usize]) -> Result<(), String> {
        let mut set = CpuSet::new();
        for &processor in processors {
            set.set(processor).map_err(|why| why.desc().to_owned())?;
        }
        sched_setaffinity(Pid::from_raw(0), &set).map_err(|why| why.desc().to_owned())
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    const ELSEWHERE: &str = "processors are chosen on Linux only";

    pub fn allowed() -> Result<Vec<usize>, &'static str> {
        Err(ELSEWHERE)
    }

    pub fn keep_to(_: &[usize]) -> Result<(), &'static str> {
        Err(ELSEWHERE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_processors_are_divided_and_fewer_are_not() {
        for role in [Role::Device, Role::Haptic, Role::Contact] {
            for few in [&[][..], &[0], &[0, 1], &[1, 5, 7]] {
                assert_eq!(part_of(few, role), None, "{role:?} {few:?}");
            }
        }
        let allowed = [0, 2, 3, 8, 9];
        assert_eq!(part_of(&allowed, Role::Contact), Some(&[0, 2, 3][..]));
        assert_eq!(part_of(&allowed, Role::Haptic), Some(&[8, 9][..]));
        assert_eq!(part_of(&allowed, Role::Device), Some(&[8, 9][..]));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn thread_stays_on_its_processors() {
        let thread = std::thread::spawn(|| {
            let last = system::allowed()?.pop().ok_or("none is allowed")?;
            system::keep_to(&[last])?;
            Ok::<_, String>((last, system::allowed()?))
        });
        let (last, kept) = thread.join().expect("no panic").expect("processors");
        assert_eq!(kept, [last]);
    }
}
