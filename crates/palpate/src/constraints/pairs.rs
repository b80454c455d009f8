//! What is known of the distances between the body and the scene's objects, from query to query.

use std::ops::Range;
use std::sync::Arc;

use palpate_collide::ObjectHandle;
use palpate_field::FeatureMesh;

use super::geometry::{FarObject, NearObject};
use super::near_features::{NearFeatures, Reaches};

/// Number of queries after which what is known of an object that was not near in them is forgotten.
const KEPT: u64 = 256;

/// Number of readings for one object until it is seen which could touch first. With more, others wait.
const AT_A_TIME: usize = 16;

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

/// An object near the body.
#[derive(Debug)]
pub(crate) struct Found {
    pub object: NearObject,
    /// Its starts, and the least distance of what they stand for, m.
    pub starts: Range<usize>,
    pub least: f64,
    /// Motion since the last query, m.
    pub since: f64,
    /// How far the bodies may move before what is not found yet could touch, m, and whether there is nothing
    /// more to find.
    pub room: f64,
    pub is_searched: bool,
}

impl Found {
    pub fn new(object: NearObject) -> Self {
        let (least, since, room) = (f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY);
        Self { object, starts: 0..0, least, since, room, is_searched: false }
    }
}

/// What is known of the distances from the scene objects, by their places.
#[derive(Debug, Default)]
pub(crate) struct Pairs {
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

    /// Searches a probe's surface and those of objects, those first that could touch first, with a number of
    /// readings. Returns how many are left.
    pub fn search(
        &mut self,
        probe: &FeatureMesh,
        found: &mut [Found],
        reaches: &Reaches,
        mut readings: usize,
    ) -> usize {
        while readings > 0 {
            // Where that bounds the motion most that is known best, the others may be known less.
            let next = found.iter_mut().min_by(|a, b| a.room.total_cmp(&b.room));
            let Some(next) = next.filter(|next| !next.is_searched) else { break };
            let most = readings.min(AT_A_TIME);
            let NearObject { place, surface, .. } = &next.object;
            let (room, left) = self.of(*place, surface).go_on([probe, surface], reaches, most);
            readings -= most - left;
            (next.room, next.is_searched) = (room, left > 0);
        }
        readings
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
