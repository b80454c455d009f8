//! Settings of a contact set, and results of a run.

/// Default limit of the number of vertices whose distance from the other surface a run measures.
const MAX_VERTICES: usize = 1 << 16;

/// Settings of a contact set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactSetSettings {
    /// Distance, m, within which a separated contact is merged into a closer one, by their points on both
    /// surfaces. Not negative; 0 merges equal ones only.
    pub merge: f64,
    /// Minimum distance, m, between local maxima of the depth in one region. Infinite (the
    /// default): one contact for each region. Not negative.
    ///
    /// A region that surrounds something, as that of a peg in a tight hole, needs several contacts for a
    /// correct force. [`ContactSet::noticeable_spacing`](crate::ContactSet::noticeable_spacing) is a
    /// suitable value.
    pub spacing: f64,
    /// Largest number of vertices whose distance from the other surface is measured. With more, depths are
    /// lower bounds, and [`ContactSetOutcome::truncated`] is set.
    pub max_vertices: usize,
}

impl ContactSetSettings {
    /// Settings with a distance (m) within which separated contacts are merged, and defaults for the rest.
    pub fn new(merge: f64) -> Self {
        Self { merge, spacing: f64::INFINITY, max_vertices: MAX_VERTICES }
    }
}

/// Results and costs of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactSetOutcome {
    /// Number of connected parts of the probe, and of the scene object, that are wholly inside the other.
    /// Nothing is inside an open mesh.
    pub contained: [usize; 2],
    /// Number of connected regions of intersection, and of parts wholly inside.
    pub regions: usize,
    /// Number of contacts of the regions: one each, and further maxima.
    pub penetrating: usize,
    /// Number of separated contacts that are local minima, before merging.
    pub minima: usize,
    /// Number of separated contacts after merging.
    pub separated: usize,
    /// Number of regions whose depth is that of a vertex, rather than of two patches.
    pub by_vertices: usize,
    /// Number of vertices whose distance was measured.
    pub measured: usize,
    /// Number of vertices inside the other object, without those of parts wholly inside.
    pub inside: usize,
    /// Whether there were more vertices to measure than [`ContactSetSettings::max_vertices`].
    pub truncated: bool,
    /// Whether a buffer grew: the run needed more memory than any before.
    pub reallocated: bool,
}
