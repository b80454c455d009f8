//! Every triangle starts as a patch, and neighbouring patches are joined, in one order or another.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use glam::DVec3;

use super::{Problem, Tests, ascending, descending};
use crate::convexity::Patch;
use crate::decomposition::{Decomposition, NO_PATCH};

/// Which pair of neighbouring patches is joined next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Pair {
    /// Fewest triangles; then by index. The order of [`decompose`](crate::decomposition::decompose).
    SmallestUnion,
    /// Fewest triangles, then fewest open neighbours.
    SmallestMostBound,
    /// Fewest triangles, then sharpest edge.
    SmallestSharpest,
    /// Fewest triangles, then shortest diagonal.
    SmallestShortest,
    LargestUnion,
    LeastArea,
    /// Shortest diagonal of the box around both.
    Shortest,
    /// Across the edge with the smallest dihedral angle (between normals).
    Flattest,
    Sharpest,
    /// Least perimeter² by area.
    MostCompact,
    /// Longest common border in terms of the shorter perimeter.
    LongestBorder,
    /// Least spread of normals, weighted by area.
    LeastSpread,
    /// Fewest neighbours that the two may yet be joined with.
    FewestOpen,
}

impl Pair {
    pub const ALL: [(Self, &str); 13] = [
        (Self::SmallestUnion, "smallest union"),
        (Self::SmallestMostBound, "smallest union, then fewest open neighbours"),
        (Self::SmallestSharpest, "smallest union, then sharpest edge"),
        (Self::SmallestShortest, "smallest union, then shortest diagonal"),
        (Self::LargestUnion, "largest union"),
        (Self::LeastArea, "least area"),
        (Self::Shortest, "shortest diagonal"),
        (Self::Flattest, "flattest edge"),
        (Self::Sharpest, "sharpest edge"),
        (Self::MostCompact, "most compact"),
        (Self::LongestBorder, "longest common border"),
        (Self::LeastSpread, "least spread of normals"),
        (Self::FewestOpen, "fewest open neighbours"),
    ];
}

/// The common border of two patches.
#[derive(Clone, Copy)]
struct Shared {
    /// Whether the two were found not to make one patch.
    blocked: bool,
    length: f64,
    flattest: f64,
    sharpest: f64,
}

struct Region {
    patch: Patch,
    links: BTreeMap<u32, Shared>,
    open: u64,
    area: f64,
    perimeter: f64,
    normals: DVec3,
}

fn key(order: Pair, a: &Region, b: &Region, shared: &Shared) -> (u64, u64) {
    let size = (a.patch.triangles.len() + b.patch.triangles.len()) as u64;
    let area = a.area + b.area;
    let diagonal = || {
        let low = a.patch.bounds.0.min(b.patch.bounds.0);
        ascending(low.distance(a.patch.bounds.1.max(b.patch.bounds.1)))
    };
    let first = match order {
        Pair::SmallestUnion => size,
        Pair::SmallestMostBound => return (size, a.open + b.open),
        Pair::SmallestSharpest => return (size, descending(shared.sharpest)),
        Pair::SmallestShortest => return (size, diagonal()),
        Pair::LargestUnion => u64::MAX - size,
        Pair::LeastArea => ascending(area),
        Pair::Shortest => diagonal(),
        Pair::Flattest => ascending(shared.flattest),
        Pair::Sharpest => descending(shared.sharpest),
        Pair::MostCompact => ascending((a.perimeter + b.perimeter - 2.0 * shared.length).powi(2) / area),
        Pair::LongestBorder => descending(shared.length / a.perimeter.min(b.perimeter)),
        Pair::LeastSpread => ascending(area - (a.normals + b.normals).length()),
        Pair::FewestOpen => a.open + b.open,
    };
    (first, 0)
}

fn regions(problem: &Problem, tests: &mut Tests<'_>) -> (Vec<Option<Region>>, Vec<u32>) {
    let (members, patch_of) = problem.start(tests);
    let region = |patch: Patch| {
        let t = patch.triangles[0];
        let corners = problem.surface.corners(t);
        let length = |side: usize| corners[side].distance(corners[(side + 1) % 3]);
        let mut links = BTreeMap::new();
        if patch.triangles.len() == 1 {
            for (side, other) in problem.across(t) {
                let angle = problem.angle(t, other);
                let edge = Shared { blocked: false, length: length(side), flattest: angle, sharpest: angle };
                links.entry(other).and_modify(|s: &mut Shared| s.length += edge.length).or_insert(edge);
            }
        }
        let area = problem.area(t);
        Region {
            patch,
            open: links.len() as u64,
            links,
            area,
            perimeter: (0..3).map(length).sum(),
            normals: area * problem.surface.planes[t as usize].normal,
        }
    };
    (members.into_iter().map(|member| Some(region(member?.patch))).collect(), patch_of)
}

type Queue = BinaryHeap<Reverse<((u64, u64), u32, u32)>>;

fn push(queue: &mut Queue, regions: &[Option<Region>], order: Pair, a: u32) {
    let Some(own) = &regions[a as usize] else { return };
    for (b, shared) in own.links.iter().filter(|(_, shared)| !shared.blocked) {
        if let Some(other) = &regions[*b as usize] {
            queue.push(Reverse((key(order, own, other, shared), a.min(*b), a.max(*b))));
        }
    }
}

pub(super) fn join_pairs(problem: &Problem, order: Pair, tests: &mut Tests<'_>) -> Option<Decomposition> {
    let (mut regions, mut patch_of) = regions(problem, tests);
    let mut queue = Queue::new();
    for a in 0..regions.len() as u32 {
        push(&mut queue, &regions, order, a);
    }
    while let Some(Reverse((stored, a, b))) = queue.pop() {
        let (Some(first), Some(second)) = (&regions[a as usize], &regions[b as usize]) else { continue };
        let Some(shared) = first.links.get(&b).copied().filter(|shared| !shared.blocked) else { continue };
        if key(order, first, second, &shared) != stored {
            continue;
        }
        if tests.given_up() {
            return None;
        }
        let mine = |t: u32| [a, b, NO_PATCH].contains(&patch_of[t as usize]);
        let Some(join) = tests.join(&first.patch, &second.patch, mine) else {
            for (p, q) in [(a, b), (b, a)] {
                if let Some(region) = &mut regions[p as usize] {
                    region.open -= 1;
                    region.links.entry(q).and_modify(|shared| shared.blocked = true);
                }
            }
            if matches!(order, Pair::FewestOpen | Pair::SmallestMostBound) {
                push(&mut queue, &regions, order, a);
                push(&mut queue, &regions, order, b);
            }
            continue;
        };
        let (kept, gone) =
            if first.patch.triangles.len() >= second.patch.triangles.len() { (a, b) } else { (b, a) };
        let lost = regions[gone as usize].take()?;
        for t in &lost.patch.triangles {
            patch_of[*t as usize] = kept;
        }
        let mut touched = vec![kept];
        for (other, shared) in lost.links.iter().filter(|(other, _)| **other != kept) {
            for (p, q) in [(kept, *other), (*other, kept)] {
                if let Some(region) = &mut regions[p as usize] {
                    region
                        .links
                        .entry(q)
                        .and_modify(|s| {
                            s.blocked |= shared.blocked;
                            s.length += shared.length;
                            s.flattest = s.flattest.min(shared.flattest);
                            s.sharpest = s.sharpest.max(shared.sharpest);
                        })
                        .or_insert(*shared);
                }
            }
            touched.push(*other);
        }
        for p in touched {
            if let Some(region) = &mut regions[p as usize] {
                region.links.remove(&gone);
                region.open = region.links.values().filter(|shared| !shared.blocked).count() as u64;
            }
        }
        if let Some(region) = &mut regions[kept as usize] {
            region.area += lost.area;
            region.perimeter += lost.perimeter - 2.0 * shared.length;
            region.normals += lost.normals;
            region.patch.take_in(lost.patch, join, &tests.convexity);
        }
        push(&mut queue, &regions, order, kept);
    }
    Some(Decomposition::new(regions.into_iter().flatten().map(|r| r.patch).collect(), patch_of))
}
