//! Settings of a contact set, and results of a run.

/// Most vertices whose distance from the other surface a run measures, by default.
const MOST_VERTICES: usize = 1 << 16;

/// Settings of a contact set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactSetSettings {
    /// Separated contacts whose points on both surfaces are no further than this from those of a closer
    /// contact that stays are dropped, m. Not negative; 0 drops equal ones only.
    pub merge: f64,
    /// Local maxima of the depth in one region stay if they are further apart than this, m. Infinite (the
    /// default): one contact for each region. Not negative.
    ///
    /// A region that goes around something, as that of a peg in a tight hole does, needs several to be pushed
    /// back right. [`ContactSet::noticeable_spacing`](crate::ContactSet::noticeable_spacing) is a value for
    /// that.
    pub spacing: f64,
    /// Vertices whose distance from the other surface may be measured. Beyond, depths are lower bounds, and
    /// [`ContactSetOutcome::truncated`] says so.
    pub most_vertices: usize,
}

impl ContactSetSettings {
    /// Settings with a distance (m) within which separated contacts are merged, and defaults for the rest.
    pub fn new(merge: f64) -> Self {
        Self { merge, spacing: f64::INFINITY, most_vertices: MOST_VERTICES }
    }
}

/// Results and costs of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactSetOutcome {
    /// Connected regions of intersection.
    pub regions: usize,
    /// Contacts of the regions: one each, and the further maxima.
    pub penetrating: usize,
    /// Separated contacts that are local minima, before they are merged.
    pub minima: usize,
    /// Separated contacts that stay.
    pub separated: usize,
    /// Regions whose depth is that of a vertex, rather than of two patches.
    pub by_vertices: usize,
    /// Vertices whose distance was measured.
    pub measured: usize,
    /// Vertices found inside the other object.
    pub inside: usize,
    /// Whether there were more vertices to measure than [`ContactSetSettings::most_vertices`].
    pub truncated: bool,
    /// Whether a buffer grew: there was more to do than ever before.
    pub reallocated: bool,
}
