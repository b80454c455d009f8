//! Steps with more contacts than impulses are found for: those that the step presses against make up a
//! working set; the others, which mostly lie beside them on the same surface, are checked. Those that the
//! step would pass take the places of contacts that push least, and the step is solved again.

use palpate_core::Twist;

use super::solver::{COMPLIANCE, ROUND_TOLERANCE};
use super::{Constraint, MAX_CONSTRAINTS};

/// Largest number of times that contacts are exchanged. With fewer, more steps are shortened.
pub(super) const MAX_EXCHANGES: u32 = 4;

/// Approach beyond its limit with which a contact counts as passed, m/s, and relative to the largest without
/// impulses. With less, contacts are passed by how far the others are from solved, and steps are shortened;
/// with more, surfaces overlap.
const PASSED: (f64, f64) = (1e-6, 2.0 * (COMPLIANCE + ROUND_TOLERANCE));

/// Splits off the contacts that are not solved for.
fn split(contacts: &mut [Constraint], most: usize) -> (&mut [Constraint], &mut [Constraint]) {
    contacts.split_at_mut(contacts.len().min(most))
}

/// Moves the contacts to solve for, at most so many, to the front, if not all of them can be: those that
/// pushed in the last step, and those that the free velocity passes most. The others do not push. Returns the
/// approach with which one counts as passed, m/s.
pub(crate) fn choose(
    contacts: &mut [Constraint],
    most: usize,
    free: &Twist,
    (dt, recovery): (f64, f64),
) -> f64 {
    if contacts.len() <= most {
        return PASSED.0;
    }
    let room = |contact: &Constraint| {
        let pushed = contact.normal.dot(contact.impulse) > 0.0;
        if pushed { f64::NEG_INFINITY } else { -contact.excess(free, dt, recovery) }
    };
    contacts.select_nth_unstable_by(most - 1, |a, b| room(a).total_cmp(&room(b)));
    let (solved, others) = split(contacts, most);
    for other in others {
        other.impulse = Default::default();
    }
    let excesses = solved.iter().map(|contact| contact.excess(free, dt, recovery));
    PASSED.0 + PASSED.1 * excesses.fold(0.0, f64::max)
}

/// Exchanges contacts for others that a velocity passes (m/s): makes overlap, or overlap more. Those that
/// push least give way first: with that many on one surface, the others hold it without them. Returns whether
/// there were any.
pub(super) fn exchange(contacts: &mut [Constraint], held: &Twist, passed: f64, dt: f64) -> bool {
    let (solved, others) = split(contacts, MAX_CONSTRAINTS);
    let push = |contact: &Constraint| contact.normal.dot(contact.impulse);
    let mut exchanged = 0;
    for other in others.iter_mut().filter(|other| other.excess(held, dt, 0.0) > passed) {
        // Those that have come in are at the front.
        let rest = exchanged..solved.len();
        let Some(least) = rest.min_by(|a, b| push(&solved[*a]).total_cmp(&push(&solved[*b]))) else { break };
        solved.swap(exchanged, least);
        std::mem::swap(&mut solved[exchanged], other);
        other.impulse = Default::default();
        exchanged += 1;
    }
    exchanged > 0
}

/// Share of a step at which it reaches the first surface of those that are not solved for. Overlaps are left
/// to the next step, which solves for them first.
pub(crate) fn share(contacts: &mut [Constraint], most: usize, held: &Twist, passed: f64, dt: f64) -> f64 {
    split(contacts, most).1.iter().filter(|other| other.gap > 0.0).fold(1.0, |share: f64, other| {
        let excess = other.excess(held, dt, 0.0);
        if excess > passed { share.min(other.gap / (other.gap + dt * excess)) } else { share }
    })
}
