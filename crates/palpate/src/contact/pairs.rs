//! What is known of the distances between the body and the scene's objects, from query to query.

use std::ops::Range;
use std::sync::Arc;

use palpate_collide::ObjectHandle;
use palpate_field::FeatureMesh;

use super::geometry::{FarObject, NearObject};
use super::near_features::NearFeatures;

/// Number of queries after which what is known of an object that was not near in them is forgotten.
const KEPT: u64 = 256;

/// How the hand pulls a body, by the haptic loop. Contacts are found as far as that may take the body until
/// the next ones.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pull {
    /// Bound on how far any point of the body is from where the hand would hold it, m.
    pub stretch: f64,
    /// Bound on the speed of any point of a body in the hand, m/s.
    pub speed: f64,
    /// Whether the body has waited for contacts that its newest ones leave out.
    pub waited: bool,
}

/// An object near the body, its starts, the least distance of what they stand for, m, and the motion since
/// the last query, m.
#[derive(Debug)]
pub(super) struct Found {
    pub object: NearObject,
    pub starts: Range<usize>,
    pub least: f64,
    pub since: f64,
}

/// What is known of the distances from the scene objects, by their places.
#[derive(Debug, Default)]
pub(super) struct Pairs {
    pairs: Vec<Option<Pair>>,
    /// Number of queries so far.
    queries: u64,
    /// Workspaces.
    pub handles: Vec<ObjectHandle>,
    pub found: Vec<Found>,
    pub far: Vec<FarObject>,
}

#[derive(Debug)]
struct Pair {
    near: NearFeatures,
    surface: Arc<FeatureMesh>,
    /// Whether the bodies overlapped when they first came near each other, if they have.
    overlapped: Option<bool>,
    /// Query in which the object was last near.
    used: u64,
}

impl Pairs {
    /// What is known of the object at a place, with a surface.
    pub fn of(&mut self, place: usize, surface: &Arc<FeatureMesh>) -> &mut NearFeatures {
        if self.pairs.len() <= place {
            self.pairs.resize_with(place + 1, || None);
        }
        let kept = self.pairs[place].take().filter(|pair| Arc::ptr_eq(&pair.surface, surface));
        let made = || Pair {
            near: NearFeatures::default(),
            surface: Arc::clone(surface),
            overlapped: None,
            used: 0,
        };
        let pair = self.pairs[place].insert(kept.unwrap_or_else(made));
        pair.used = self.queries;
        &mut pair.near
    }

    /// Whether the body and the object at a place overlapped when they first came near each other: if it is
    /// not known yet, whether they do now.
    pub fn overlapped(&mut self, place: usize, overlap: impl FnOnce() -> bool) -> bool {
        let pair = self.pairs.get_mut(place).and_then(Option::as_mut);
        pair.is_some_and(|pair| *pair.overlapped.get_or_insert_with(overlap))
    }

    /// Forgets the object at a place.
    pub fn remove(&mut self, place: usize) {
        if let Some(pair) = self.pairs.get_mut(place) {
            *pair = None;
        }
    }

    /// Ends a query: forgets objects that have not been near for long.
    pub fn end(&mut self) {
        self.queries += 1;
        let queries = self.queries;
        for pair in &mut self.pairs {
            pair.take_if(|pair| pair.used + KEPT < queries);
        }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.pairs.iter().flatten().map(|pair| pair.near.bytes()).sum()
    }
}
