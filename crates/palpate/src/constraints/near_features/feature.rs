//! What a search for near features passes on, and how far it goes.

use palpate_core::glam::DVec3;
use palpate_field::{Leash, Place};

/// A feature near the other surface.
#[derive(Clone, Copy, Debug)]
pub struct NearFeature {
    pub place: Place,
    /// Whether it is on the probe.
    pub is_probe: bool,
    /// Whether its neighbours do not stand for it.
    pub is_tip: bool,
    /// Its position in its own body's frame, m.
    pub point: DVec3,
    /// Its distance from the other surface, and by how much that may be off, m.
    pub distance: f64,
    pub apart: f64,
    /// Lower bound on the distance of what it stands for, m.
    pub least: f64,
    /// Where what it stands for is: its point may move as far.
    pub leash: Leash,
    /// Hint for a search of the other surface from there.
    pub hint: u32,
}

/// Distances of a search.
#[derive(Clone, Copy, Debug)]
pub struct Reaches {
    /// Distance within which features are passed on, m.
    pub reach: f64,
    /// Distance beyond which a bound on motion need not be known, m.
    pub enough: f64,
    /// Edge of the smallest cells, m, and of those that are in use: at least that.
    pub edge: f64,
    pub cell: f64,
    /// Length above which edges are searched by themselves, m.
    pub long: f64,
}

/// A leash that is no shorter than a length (m).
pub fn leash(home: DVec3, length: f64) -> Leash {
    Leash { home, length: (length as f32).next_up() }
}
