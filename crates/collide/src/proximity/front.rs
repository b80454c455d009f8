//! Pairs of nodes that a search left behind, each with a lower bound on its distance that the motion since then uses up.
//!
//! A pair found to be at least L apart after a [way](crate::motion) m is at least L + m − M apart after a way M, so it
//! needs no second look before the way reaches L + m less the distance asked about. Kept in a heap by L + m, the pairs
//! that do come first, and no others are touched: the generalized front tracking of Ehmann and Lin (2001), with the
//! conservative bounds of Mirtich (1996).

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use palpate_core::glam::DVec3;

/// A pair of nodes with a lower bound on the distance of their surfaces.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    /// The lower bound, m, plus the way at which it was found.
    pub expires: f64,
    pub a: u32,
    pub b: u32,
    /// A direction from b to a that separates them best as far as known, a's frame; zero if unknown.
    pub axis: [f32; 3],
}

impl Pair {
    pub fn axis(&self) -> DVec3 {
        DVec3::from_array(self.axis.map(f64::from))
    }

    /// Keeps a direction (of any length).
    pub fn set_axis(&mut self, axis: DVec3) {
        self.axis = axis.normalize_or_zero().to_array().map(|x| x as f32);
    }
}

/// The first to expire is the greatest.
impl Ord for Pair {
    fn cmp(&self, other: &Self) -> Ordering {
        other.expires.total_cmp(&self.expires).then_with(|| (other.a, other.b).cmp(&(self.a, self.b)))
    }
}

impl PartialOrd for Pair {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Pair {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Pair {}

/// The pairs left behind, the first to expire at the top.
pub(super) type Front = BinaryHeap<Pair>;
