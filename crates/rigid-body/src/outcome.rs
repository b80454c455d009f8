//! Results of a step.

use glam::DVec3;
use palpate_collide::{QueryError, QueryOutcome};
use palpate_core::{Pose, Twist};

/// One impact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impact {
    /// Time since the simulation began, s.
    pub time: f64,
    /// Number of contacts that took an impulse.
    pub contacts: usize,
    /// Whether all contacts approached slowly enough to count as resting or sliding contact.
    pub micro: bool,
    /// Largest approach speed, m/s.
    pub approach: f64,
    /// Sum of the impulses on the body, N·s, world axes.
    pub impulse: DVec3,
    /// Kinetic energy before the impact, J.
    pub energy_before: f64,
    /// Kinetic energy after the impact, J.
    pub energy_after: f64,
}

/// A contact query of a step, with the body's motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuerySample {
    /// Time since the simulation began, s.
    pub time: f64,
    /// Pose of the body's frame.
    pub pose: Pose,
    /// Velocity of the origin of the body's frame, and angular velocity, world axes.
    pub twist: Twist,
    /// Outcome of the query.
    pub outcome: QueryOutcome,
}

/// Counts and extremes of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepOutcome {
    /// Number of collision events that were followed.
    pub events: usize,
    /// Number of those with a change of resolution within the flight.
    pub switched: usize,
    /// Number of events at whose time no surfaces touch. The response is applied at the event's own contact.
    pub estimated: usize,
    /// Number of flights with more events than are followed.
    pub exhausted: usize,
    /// Number of impacts, including micro-collisions.
    pub impacts: usize,
    /// Number of micro-collisions.
    pub micro: usize,
    /// Number of queries.
    pub queries: usize,
    /// Deepest penetration at the end of a flight or at an event, m; 0 without penetration.
    pub depth: f64,
    /// Potential energy added by projection out of penetration, J; negative if it was reduced.
    pub lifted: f64,
}

/// Reason why a step was refused. The state is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StepError {
    /// The duration is not positive and finite.
    #[error("a step of {duration} s; it must be positive and finite")]
    Duration {
        /// Duration that was given, s.
        duration: f64,
    },
    /// The body moves too far in the step for the queries that find collisions.
    #[error(
        "the body moves at {speed} m/s, too fast for a step of {duration} s with a query every {travel} m; take shorter steps"
    )]
    TooFast {
        /// Speed of the fastest point of the body, m/s.
        speed: f64,
        /// Duration of the step, s.
        duration: f64,
        /// Largest distance between queries, m.
        travel: f64,
    },
    /// A contact query failed at a pose in the step.
    #[error("a contact query in the step failed: {0}")]
    Query(#[from] QueryError),
}
