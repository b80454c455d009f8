//! Surface convex decomposition (§3.3.1): a partition of the triangles into convex surface patches.
//!
//! Ehmann and Lin (2001) grow one patch after the other from a seed, a triangle at a time, and so have to
//! update a hull that may be large for every triangle. Here every triangle starts as a patch, and
//! neighbouring patches are joined while the union is a convex patch. Patches of like size are joined first,
//! so that the work is O(n log n) hull points even where the object is convex. Since two patches that fail
//! the test fail it in all patches that contain them (see [`convexity`](crate::convexity)), each pair is
//! tested once and failures are inherited. The same test serves the merging of patches during simplification.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use palpate_core::mesh::{Adjacency, EdgeKind};

use crate::convexity::{Convexity, JoinBuffers, MAX_PATCH_TRIANGLES, Patch};
use crate::progress::{Cancelled, Progress};
use crate::surface::Surface;

/// The patch of a triangle that names a vertex twice.
pub(crate) const NO_PATCH: u32 = u32::MAX;

/// Inverse of the fraction by which a pair must have grown in the queue for it to be queued anew. (Small
/// pairs are at once; for a large patch with many neighbours, all its pairs would otherwise be queued anew
/// for every triangle that it gains.)
const GROWTH_DIVISOR: usize = 8;

/// A neighbouring patch.
#[derive(Clone, Copy, Debug)]
struct Link {
    patch: u32,
    /// Whether the two were found not to make one patch.
    blocked: bool,
}

/// A patch with its neighbours, in ascending order.
#[derive(Debug)]
struct Member {
    patch: Patch,
    links: Vec<Link>,
}

/// The convex surface patches of a mesh; each of its triangles belongs to exactly one, but for those that
/// name a vertex twice: they add no surface and belong to none.
#[derive(Debug)]
pub(crate) struct Decomposition {
    /// The patches.
    pub patches: Vec<Patch>,
    /// The patch of each triangle, or [`NO_PATCH`].
    pub patch_of: Vec<u32>,
}

impl Decomposition {
    /// Puts patches in the order of their first triangles; `patch_of` is [`NO_PATCH`] for triangles that
    /// belong to none.
    fn new(mut patches: Vec<Patch>, mut patch_of: Vec<u32>) -> Self {
        for patch in &mut patches {
            patch.triangles.sort_unstable();
        }
        patches.sort_unstable_by_key(|p| p.triangles[0]);
        for (k, patch) in patches.iter().enumerate() {
            for t in &patch.triangles {
                patch_of[*t as usize] = k as u32;
            }
        }
        Self { patches, patch_of }
    }
}

/// Decomposes a surface; `tolerance` in its unit coordinates.
pub(crate) fn decompose(
    surface: &Surface,
    adjacency: &Adjacency,
    tolerance: f64,
    progress: &mut Progress<'_>,
) -> Result<Decomposition, Cancelled> {
    let convexity = Convexity::new(surface, adjacency.neighbours(), tolerance);
    let mut buffers = JoinBuffers::default();
    let (mut members, mut patch_of) = start(surface, adjacency, &convexity, &mut buffers);
    let mut queue = BinaryHeap::new();
    for a in 0..members.len() as u32 {
        for link in members[a as usize].iter().flat_map(|m| &m.links).filter(|link| link.patch > a) {
            queue.push(Reverse((size(&members, a, link.patch), a, link.patch)));
        }
    }
    let (mut done, mut next_report) = (0, 0);
    while let Some(Reverse((stored, a, b))) = queue.pop() {
        done += 1;
        if done >= next_report {
            progress.at(f64::from(done) / (f64::from(done) + queue.len() as f64))?;
            next_report = done + 4096;
        }
        let (Some(first), Some(second)) = (&members[a as usize], &members[b as usize]) else { continue };
        if !first.links.binary_search_by_key(&b, |l| l.patch).is_ok_and(|k| !first.links[k].blocked) {
            continue;
        }
        let now = size(&members, a, b);
        if now > stored + stored / GROWTH_DIVISOR {
            queue.push(Reverse((now, a, b)));
            continue;
        }
        let mine = |t: u32| [a, b, NO_PATCH].contains(&patch_of[t as usize]);
        let Some(join) = convexity.join(&first.patch, &second.patch, mine, &mut buffers) else {
            link(&mut members, a, b, true);
            link(&mut members, b, a, true);
            continue;
        };
        // The larger patch takes the smaller one in, so that only the few triangles and links of the smaller
        // one change.
        let (kept, gone) =
            if first.patch.triangles.len() >= second.patch.triangles.len() { (a, b) } else { (b, a) };
        let Some(gone_member) = members[gone as usize].take() else { continue };
        for t in &gone_member.patch.triangles {
            patch_of[*t as usize] = kept;
        }
        for Link { patch: other, blocked } in gone_member.links {
            unlink(&mut members, other, gone);
            if other == kept {
                continue;
            }
            let (fresh, blocked) = link(&mut members, kept, other, blocked);
            link(&mut members, other, kept, blocked);
            if fresh && !blocked {
                queue.push(Reverse((size(&members, kept, other), kept.min(other), kept.max(other))));
            }
        }
        if let Some(member) = &mut members[kept as usize] {
            member.patch.take_in(gone_member.patch, join, &convexity);
        }
    }

    let patches = members.into_iter().flatten().map(|m| m.patch).collect();
    Ok(Decomposition::new(patches, patch_of))
}

/// The first members of a decomposition, closed convex pieces as a whole and all other triangles alone; and
/// the member of each triangle, or [`NO_PATCH`].
fn start(
    surface: &Surface,
    adjacency: &Adjacency,
    convexity: &Convexity<'_>,
    buffers: &mut JoinBuffers,
) -> (Vec<Option<Member>>, Vec<u32>) {
    let count = surface.triangles.len();
    let collapsed = |t: u32| {
        let [a, b, c] = surface.triangles[t as usize];
        a == b || b == c || c == a
    };
    let mut patch_of: Vec<u32> = (0..count as u32).map(|t| if collapsed(t) { NO_PATCH } else { t }).collect();
    let mut members: Vec<Option<Member>> = (0..count as u32)
        .map(|t| {
            if collapsed(t) {
                return None;
            }
            let mut links: Vec<Link> = (0..3)
                .filter(|side| {
                    let edge = adjacency.triangle_edges()[t as usize][*side as usize];
                    edge != u32::MAX && adjacency.edge_kind(edge) == EdgeKind::Manifold
                })
                .filter_map(|side| adjacency.neighbour(t, side))
                .map(|patch| Link { patch, blocked: false })
                .collect();
            links.sort_unstable_by_key(|link| link.patch);
            links.dedup_by_key(|link| link.patch);
            Some(Member { patch: convexity.single(t), links })
        })
        .collect();

    for piece in closed_convex_pieces(convexity, adjacency, count as u32) {
        if piece.len() > MAX_PATCH_TRIANGLES && piece.len() < count {
            continue;
        }
        let member = patch_of[piece[0] as usize];
        for t in &piece {
            patch_of[*t as usize] = member;
        }
        let mine = |t: u32| [member, NO_PATCH].contains(&patch_of[t as usize]);
        if let Some(patch) = convexity.whole(&piece, mine, buffers) {
            for t in &piece {
                members[*t as usize] = None;
            }
            members[member as usize] = Some(Member { patch, links: Vec::new() });
        } else {
            for t in &piece {
                patch_of[*t as usize] = *t;
            }
        }
    }
    (members, patch_of)
}

/// The connected pieces of surface that are closed and all of whose edges are convex: most are one patch, and
/// a large one is found much faster whole than triangle by triangle.
fn closed_convex_pieces(convexity: &Convexity<'_>, adjacency: &Adjacency, count: u32) -> Vec<Vec<u32>> {
    let mut seen = vec![false; count as usize];
    let mut pieces = Vec::new();
    for first in 0..count {
        if std::mem::replace(&mut seen[first as usize], true) {
            continue;
        }
        let mut piece = vec![first];
        let (mut done, mut closed_convex) = (0, true);
        while let Some(&t) = piece.get(done) {
            done += 1;
            for side in 0..3 {
                let edge = adjacency.triangle_edges()[t as usize][side as usize];
                let Some(other) = adjacency.neighbour(t, side) else {
                    closed_convex = false;
                    continue;
                };
                closed_convex = closed_convex
                    && adjacency.edge_kind(edge) == EdgeKind::Manifold
                    && convexity.is_convex(t, other);
                if !std::mem::replace(&mut seen[other as usize], true) {
                    piece.push(other);
                }
            }
        }
        if closed_convex {
            pieces.push(piece);
        }
    }
    pieces
}

/// Number of triangles of two patches together: the smallest unions are tried first. (No other order makes
/// noticeably fewer patches on all models: `docs/decomposition.md` compares them.)
fn size(members: &[Option<Member>], a: u32, b: u32) -> usize {
    [a, b].iter().flat_map(|k| &members[*k as usize]).map(|member| member.patch.triangles.len()).sum()
}

/// Makes `other` a neighbour of a patch, blocked if `blocked` is set or it already was. Returns whether it is
/// a new neighbour, and whether it is blocked.
fn link(members: &mut [Option<Member>], patch: u32, other: u32, blocked: bool) -> (bool, bool) {
    let Some(member) = &mut members[patch as usize] else { return (false, true) };
    match member.links.binary_search_by_key(&other, |l| l.patch) {
        Ok(k) => {
            member.links[k].blocked |= blocked;
            (false, member.links[k].blocked)
        }
        Err(k) => {
            member.links.insert(k, Link { patch: other, blocked });
            (true, blocked)
        }
    }
}

fn unlink(members: &mut [Option<Member>], patch: u32, other: u32) {
    if let Some(member) = &mut members[patch as usize]
        && let Ok(k) = member.links.binary_search_by_key(&other, |l| l.patch)
    {
        member.links.remove(k);
    }
}
