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
    /// s₀: detail is left out where its deviation, averaged over the area of contact (s*, Eq. 3.7), is no
    /// more than this. [Exact](ErrorMetrics::EXACT) for full resolution.
    pub error: ErrorMetrics,
    /// Where s* nears s₀, report the contacts of the coarser and of the finer patches, with
    /// [weights](crate::PatchContact::weight) that go over from one to the other (§3.4.4).
    pub interpolate: bool,
    /// Time-critical: refine in the order of s*/s₀, and stop when this is spent
    /// ([`QueryOutcome::out_of_budget`](crate::QueryOutcome::out_of_budget)).
    pub budget: Option<Budget>,
    /// Examine pairs on all threads of the current rayon pool, where there are many. The answer is the same. A
    /// time-critical query does not.
    pub parallel: bool,
}

/// Cost that a time-critical query may have. Pairs above the coarsest level that is not free have to be gone
/// through in any case, and every pair that the query stops at costs one convex query more.
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
