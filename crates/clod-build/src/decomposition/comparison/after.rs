//! What might make fewer patches of those that there are.

use std::collections::{BTreeMap, HashMap, HashSet};

use super::{Problem, Tests, ascending};
use crate::convexity::Patch;
use crate::decomposition::{Decomposition, NO_PATCH};

/// Groups of patches that have more triangles are left as they are.
const LARGEST_GROUP: usize = 200;

/// Patches of up to `largest` triangles are dissolved where each triangle can go to a patch beside it.
pub(super) fn dissolve(
    problem: &Problem,
    made: Decomposition,
    largest: usize,
    tests: &mut Tests<'_>,
) -> Option<Decomposition> {
    let Decomposition { patches, mut patch_of } = made;
    let mut patches: Vec<Option<Patch>> = patches.into_iter().map(Some).collect();
    let mut failed: HashSet<(u32, u32)> = HashSet::new();
    loop {
        let mut order: Vec<(usize, u32)> = (0..patches.len() as u32)
            .filter_map(|p| Some((patches[p as usize].as_ref()?.triangles.len(), p)))
            .filter(|(size, _)| *size <= largest)
            .collect();
        order.sort_unstable();
        let mut dissolved = 0;
        for (_, p) in order {
            let mut left = patches[p as usize].as_ref()?.triangles.clone();
            let mut undo: Vec<(u32, u32, Patch)> = Vec::new();
            loop {
                let count = left.len();
                left.retain(|&t| {
                    let mut around: Vec<u32> = problem
                        .across(t)
                        .map(|(_, u)| patch_of[u as usize])
                        .filter(|q| ![p, NO_PATCH].contains(q) && !failed.contains(&(*q, t)))
                        .collect();
                    around.sort_unstable();
                    around.dedup();
                    for q in around {
                        let Some(mut own) = patches[q as usize].clone() else { continue };
                        let single = tests.convexity.single(t);
                        let mine = |u: u32| u == t || [q, NO_PATCH].contains(&patch_of[u as usize]);
                        let Some(join) = tests.join(&own, &single, mine) else {
                            if undo.iter().all(|(_, grown, _)| *grown != q) {
                                failed.insert((q, t));
                            }
                            continue;
                        };
                        undo.push((t, q, own.clone()));
                        own.take_in(single, join, &tests.convexity);
                        patches[q as usize] = Some(own);
                        patch_of[t as usize] = q;
                        return false;
                    }
                    true
                });
                if left.is_empty() || left.len() == count {
                    break;
                }
            }
            if left.is_empty() {
                patches[p as usize] = None;
                dissolved += 1;
            } else {
                for (t, q, patch) in undo.into_iter().rev() {
                    patches[q as usize] = Some(patch);
                    patch_of[t as usize] = p;
                }
            }
            if tests.given_up() {
                return None;
            }
        }
        if dissolved == 0 {
            break;
        }
    }
    Some(Decomposition::new(patches.into_iter().flatten().collect(), patch_of))
}

/// Each patch in turn is taken apart together with some that are near, and their triangles are joined anew, smallest
/// unions first but for a random part; what comes of it is kept if it is no more patches.
pub(super) fn join_anew(
    problem: &Problem,
    made: Decomposition,
    rounds: u64,
    tests: &mut Tests<'_>,
) -> Option<Decomposition> {
    let Decomposition { patches, mut patch_of } = made;
    let mut patches: Vec<Option<Patch>> = patches.into_iter().map(Some).collect();
    let count = patches.len() as u64;
    for seed in (0..rounds).flat_map(|round| (0..count).map(move |p| (round << 32) | p)) {
        let first = seed as u32;
        if patches[first as usize].is_none() {
            continue;
        }
        let group = group(problem, &patches, &patch_of, first);
        let triangles: Vec<u32> = group
            .iter()
            .flat_map(|q| patches[*q as usize].iter().flat_map(|p| &p.triangles))
            .copied()
            .collect();
        if group.len() < 2 || triangles.len() > LARGEST_GROUP {
            continue;
        }
        let fresh = joined(problem, &patch_of, &triangles, seed, tests);
        if tests.given_up() {
            return None;
        }
        if fresh.len() <= group.len() {
            for q in &group {
                patches[*q as usize] = None;
            }
            for (patch, q) in fresh.into_iter().zip(group) {
                for t in &patch.triangles {
                    patch_of[*t as usize] = q;
                }
                patches[q as usize] = Some(patch);
            }
        }
    }
    Some(Decomposition::new(patches.into_iter().flatten().collect(), patch_of))
}

/// A patch and the five nearest to it over the surface.
fn group(problem: &Problem, patches: &[Option<Patch>], patch_of: &[u32], first: u32) -> Vec<u32> {
    let mut group = vec![first];
    let mut done = 0;
    while let Some(q) = group.get(done) {
        done += 1;
        let mut around: Vec<u32> = patches[*q as usize]
            .iter()
            .flat_map(|patch| &patch.triangles)
            .flat_map(|t| problem.across(*t).map(|(_, u)| patch_of[u as usize]))
            .filter(|q| *q != NO_PATCH && !group.contains(q))
            .collect();
        around.sort_unstable();
        around.dedup();
        group.extend(around);
        if group.len() >= 6 {
            group.truncate(6);
            break;
        }
    }
    group
}

/// Joins triangles, the smallest unions first but for a random part.
fn joined(
    problem: &Problem,
    patch_of: &[u32],
    triangles: &[u32],
    seed: u64,
    tests: &mut Tests<'_>,
) -> Vec<Patch> {
    let index: HashMap<u32, usize> = triangles.iter().enumerate().map(|(k, t)| (*t, k)).collect();
    let mut patches: Vec<Option<Patch>> =
        triangles.iter().map(|t| Some(tests.convexity.single(*t))).collect();
    let mut within: Vec<usize> = (0..triangles.len()).collect();
    let mut blocked: BTreeMap<(usize, usize), bool> = BTreeMap::new();
    for (k, t) in triangles.iter().enumerate() {
        for (_, u) in problem.across(*t) {
            blocked.extend(index.get(&u).filter(|j| **j > k).map(|j| ((k, *j), false)));
        }
    }
    while !tests.given_up() {
        let size = |k: usize| patches[k].as_ref().map_or(0, |p| p.triangles.len()) as f64;
        let priority = |a: usize, b: usize| {
            ascending(size(a) + size(b) + 3.0 * random(seed ^ ((a as u64) << 52) ^ ((b as u64) << 42)))
        };
        let open =
            blocked.iter().filter(|(_, blocked)| !**blocked).map(|((a, b), _)| (priority(*a, *b), *a, *b));
        let Some((_, a, b)) = open.min() else { break };
        let (Some(first), Some(second)) = (&patches[a], &patches[b]) else { break };
        let mine = |t: u32| {
            patch_of[t as usize] == NO_PATCH || index.get(&t).is_some_and(|k| [a, b].contains(&within[*k]))
        };
        let Some(join) = tests.join(first, second, mine) else {
            blocked.insert((a, b), true);
            continue;
        };
        let Some(lost) = patches[b].take() else { break };
        for t in &lost.triangles {
            within[index[t]] = a;
        }
        if let Some(patch) = &mut patches[a] {
            patch.take_in(lost, join, &tests.convexity);
        }
        let inherited: Vec<_> = blocked.extract_if(.., |(x, y), _| *x == b || *y == b).collect();
        for ((x, y), was) in inherited {
            let other = if x == b { y } else { x };
            if other != a {
                *blocked.entry((other.min(a), other.max(a))).or_insert(false) |= was;
            }
        }
    }
    patches.into_iter().flatten().collect()
}

/// A number in 0..1 without a pattern (the finaliser of splitmix64).
fn random(seed: u64) -> f64 {
    let x = (seed ^ (seed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}
