//! Settings of a query.

use std::time::Duration;

use super::metrics::ErrorMetrics;
use crate::error::QueryError;
use crate::shape::Shape;

/// Settings of a query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuerySettings {
    /// d: surfaces closer than this are in contact, m; 0 to the probe's
    /// [`max_tolerance`](Shape::max_tolerance).
    pub tolerance: f64,
    /// s₀: detail is left out if its deviation, averaged over the area of contact (s*, Eq. 3.7), is at most
    /// this. [Exact](ErrorMetrics::EXACT) for full resolution.
    pub error: ErrorMetrics,
    /// Whether contacts of the coarser and of the finer patches are both reported when s* is close to s₀,
    /// with [weights](crate::PatchContact::weight) that change smoothly from one to the other (§3.4.4).
    pub interpolate: bool,
    /// Budget of a time-critical query, which refines pairs in the order of s*/s₀ and stops when it is spent
    /// ([`QueryOutcome::out_of_budget`](crate::QueryOutcome::out_of_budget)).
    pub budget: Option<Budget>,
    /// Whether many pairs are examined on all threads of the current rayon pool, with the same answer. It
    /// has no effect on time-critical queries.
    pub parallel: bool,
}

/// Budget of a time-critical query. Pairs above the coarsest level that is not free are tested in any case,
/// and every pair at which the query stops costs one more convex query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// Time.
    Time(Duration),
    /// Number of convex queries.
    Queries(usize),
}

impl QuerySettings {
    /// Settings with a tolerance (d, m) and defaults for the rest.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, error: ErrorMetrics::EXACT, interpolate: false, budget: None, parallel: false }
    }

    /// Checks that queries of a probe can be made with these settings.
    ///
    /// # Errors
    /// If the tolerance is not 0 to the probe's [`max_tolerance`](Shape::max_tolerance), or an error metric
    /// is negative or not finite.
    pub fn check(&self, probe: &Shape) -> Result<(), QueryError> {
        let (given, most) = (self.tolerance, probe.max_tolerance());
        if !(0.0..=most).contains(&given) {
            return Err(QueryError::Tolerance { given, most });
        }
        self.error.check()
    }
}
