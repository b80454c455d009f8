//! How fast each overlap is undone: none faster than all of them can be undone at once.
//!
//! An overlap asks for a velocity r out of the surface. Overlaps from opposite sides, as those of a shaft
//! that starts in a hole too narrow for it, cannot both have it: no velocity meets both, and the impulses
//! that come nearest to it are tens of kilonewtons, of which the little that does not cancel drives the body
//! along the surfaces. Where they are nearly opposite, as in a slender wedge, it is met by a fast motion
//! along them. So a step first looks for the motion u that undoes overlaps best: the one with the least
//!
//! ½ uᵀ A u + Σ (n · u + r)²₊ / 2 c,   n · u h ≤ g for what does not overlap,
//!
//! with compliances c that are small against the body's mobility. It is slowed down to a multiple of the
//! slowest motion that undoes the worst overlap alone, in the kinetic energy's norm. u is the velocity r in
//! front of a floor, at most that multiple of it in a wedge, and 0 between opposite overlaps of a depth.
//!
//! Overlaps of which u undoes less than half as fast as they ask for are held as deep as they are, and u is
//! looked for again, until there are no more of these. The others ask for their share −n · u. All of that can
//! be had at once, by u: so impulses stay small, contacts give the body no more velocity than u, and it comes
//! free along the surfaces that hold it.

use arrayvec::ArrayVec;

use super::normals::{Normals, Side};
use super::{Constraint, MAX_CONSTRAINTS, RECOVERY_TIME};
use crate::algebra::vector::{Vector, dot};

/// Compliance c of an overlap relative to the body's mobility. With more, overlaps of many points are undone
/// before those of few; with less, rounding drives bodies whose overlaps oppose each other.
const YIELD: f64 = 1e-3;

/// The same of what must not overlap more. With more, it gives way to many overlaps, and impulses grow; with
/// less, it is lost in rounding.
const FIRM: f64 = 1e-7;

/// Largest motion, in those that undo one overlap. With more, bodies leave wedges fast; with less, overlaps
/// at the ends of long bodies, or with floor and walls, are undone slowly.
const FASTEST: f64 = 3.0;

/// Share of its velocity below which an overlap is held. With more, bodies stay in blunt wedges; with less,
/// they are driven out of slender ones against the hand.
const HELD: f64 = 0.5;

/// Largest number of motions that are looked for. With fewer, overlaps that could be undone are held.
const MAX_MOTIONS: u32 = 6;

impl Constraint {
    /// Velocity out of an overlap that it asks for, at most `recovery` (m/s); 0 if there is none.
    #[inline(always)]
    pub(super) fn wanted(&self, recovery: f64) -> f64 {
        (-self.gap / RECOVERY_TIME).min(recovery).max(0.0)
    }
}

/// Velocities (m/s) out of the overlaps of contacts with scaled rows, in a step of `dt` (s) with a largest
/// one. `None` without overlaps.
pub(super) fn shared<const N: usize>(
    contacts: &[Constraint],
    sides: &[Side<N>],
    (dt, recovery): (f64, f64),
) -> Option<ArrayVec<f64, MAX_CONSTRAINTS>> {
    let mut left: ArrayVec<f64, MAX_CONSTRAINTS> =
        contacts.iter().take(MAX_CONSTRAINTS).map(|contact| contact.wanted(recovery)).collect();
    if left.iter().all(|wanted| *wanted == 0.0) {
        return None;
    }
    for _ in 0..MAX_MOTIONS {
        let Some(motion) = undoing(contacts, sides, &left, dt) else { break };
        let mut gave_up = false;
        for (wanted, side) in left.iter_mut().zip(sides) {
            if *wanted > 0.0 && dot(&side.row, &motion) < HELD * *wanted {
                (*wanted, gave_up) = (0.0, true);
            }
        }
        if !gave_up {
            for (wanted, side) in left.iter_mut().zip(sides) {
                *wanted = wanted.min(dot(&side.row, &motion));
            }
            return Some(left);
        }
    }
    left.iter_mut().for_each(|wanted| *wanted = 0.0);
    Some(left)
}

/// The motion y that undoes overlaps best, by the velocities (m/s) out of them that are wanted. `None` if
/// there are none, or the search did not end.
fn undoing<const N: usize>(
    contacts: &[Constraint],
    sides: &[Side<N>],
    wanted: &[f64],
    dt: f64,
) -> Option<Vector<N>> {
    let (mut most, mut alone) = (0.0_f64, 0.0_f64);
    let mut normals = Normals::<N>::default();
    for ((contact, Side { row, .. }), &wanted) in contacts.iter().zip(sides).zip(wanted) {
        let mobility = dot(row, row);
        let (excess, compliance) =
            if wanted > 0.0 { (wanted, YIELD) } else { (-contact.gap.max(0.0) / dt, FIRM) };
        if wanted > 0.0 {
            (most, alone) = (most.max(wanted), alone.max(wanted * wanted / mobility));
        }
        normals.push(Side { row: *row, excess, stiffness: 1.0 / (compliance * mobility) }, wanted > 0.0);
    }
    if most == 0.0 {
        return None;
    }
    let (motion, ended) = normals.solve(&[0.0; N], most);
    let (square, limit) = (dot(&motion, &motion), FASTEST * FASTEST * alone);
    let share = if square > limit { (limit / square).sqrt() } else { 1.0 };
    ended.then(|| motion.map(|entry| share * entry))
}
