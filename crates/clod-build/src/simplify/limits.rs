//! Limits of a simplification.

/// Limits of a simplification.
pub(crate) struct Limits {
    /// Largest height that counts as convex, in unit coordinates.
    pub tolerance: f64,
    /// Radius of the object's bounding sphere, in unit coordinates.
    pub radius: f64,
    /// Lowest resolution of an edge that is collapsed, in the inverse of the radius.
    pub coarsest: f64,
    /// Whether patches are carried through collapses as long as possible; if false, each level is decomposed
    /// anew.
    pub carried: bool,
}
