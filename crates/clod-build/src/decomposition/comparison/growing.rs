//! One patch after the other is grown from a seed, a triangle at a time: Chazelle et al. (1997), Ehmann and Lin (2001).

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};

use super::{Problem, Tests, ascending, descending};
use crate::decomposition::{Decomposition, NO_PATCH};

/// From which triangle a patch is grown next, of those that are in none.
#[derive(Clone, Copy, Debug)]
pub(super) enum Seed {
    First,
    Largest,
    Smallest,
}

impl Seed {
    pub const ALL: [(Self, &str); 3] =
        [(Self::First, "first"), (Self::Largest, "largest"), (Self::Smallest, "smallest")];
}

/// Which triangle across the border of a patch is tried next.
#[derive(Clone, Copy, Debug)]
pub(super) enum Next {
    BreadthFirst,
    DepthFirst,
    /// Across the edge with the smallest dihedral angle (between normals).
    Flattest,
    Sharpest,
    Largest,
}

impl Next {
    pub const ALL: [(Self, &str); 5] = [
        (Self::BreadthFirst, "breadth first"),
        (Self::DepthFirst, "depth first"),
        (Self::Flattest, "flattest edge"),
        (Self::Sharpest, "sharpest edge"),
        (Self::Largest, "largest triangle"),
    ];
}

pub(super) fn grow(
    problem: &Problem,
    seed: Seed,
    next: Next,
    tests: &mut Tests<'_>,
) -> Option<Decomposition> {
    let (mut members, mut patch_of) = problem.start(tests);
    let mut free: Vec<bool> =
        members.iter().map(|m| m.as_ref().is_some_and(|m| m.patch.triangles.len() == 1)).collect();
    let mut seeds: Vec<u32> = (0..free.len() as u32).filter(|t| free[*t as usize]).collect();
    match seed {
        Seed::First => {}
        Seed::Largest => seeds.sort_by_key(|t| descending(problem.area(*t))),
        Seed::Smallest => seeds.sort_by_key(|t| ascending(problem.area(*t))),
    }
    for seed in seeds {
        if !std::mem::replace(&mut free[seed as usize], false) {
            continue;
        }
        let mut member = members[seed as usize].take()?;
        let mut border = BinaryHeap::new();
        let mut tried = HashSet::new();
        let mut age = 0;
        let mut newest = Some(seed);
        loop {
            if let Some(from) = newest.take() {
                for (_, t) in problem.across(from).filter(|(_, t)| free[*t as usize] && !tried.contains(t)) {
                    age += 1;
                    let key = match next {
                        Next::BreadthFirst => age,
                        Next::DepthFirst => u64::MAX - age,
                        Next::Flattest => ascending(problem.angle(from, t)),
                        Next::Sharpest => descending(problem.angle(from, t)),
                        Next::Largest => descending(problem.area(t)),
                    };
                    border.push(Reverse((key, t)));
                }
            }
            let Some(Reverse((_, t))) = border.pop() else { break };
            // What fails once for a patch fails for ever.
            if !free[t as usize] || !tried.insert(t) {
                continue;
            }
            if tests.given_up() {
                return None;
            }
            let mine = |u: u32| u == t || [seed, NO_PATCH].contains(&patch_of[u as usize]);
            let single = tests.convexity.single(t);
            if let Some(join) = tests.join(&member.patch, &single, mine) {
                member.patch.take_in(single, join, &tests.convexity);
                members[t as usize] = None;
                patch_of[t as usize] = seed;
                free[t as usize] = false;
                newest = Some(t);
            }
        }
        members[seed as usize] = Some(member);
    }
    Some(Decomposition::new(members.into_iter().flatten().map(|m| m.patch).collect(), patch_of))
}
