//! What came of a step.

use glam::DVec3;
use palpate_collide::{QueryError, QueryOutcome};
use palpate_core::{Pose, Twist};

/// What one impact did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impact {
    /// When, since the simulation began, s.
    pub time: f64,
    /// Contacts that took an impulse.
    pub contacts: usize,
    /// Whether all of them approached so slowly that they count as resting or sliding contact.
    pub micro: bool,
    /// Fastest approach, m/s.
    pub approach: f64,
    /// Sum of the impulses on the body, N·s, world axes.
    pub impulse: DVec3,
    /// Kinetic energy before and after it, J.
    pub energy_before: f64,
    /// J.
    pub energy_after: f64,
}

/// A query of a step: where the body was and what the query cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuerySample {
    /// Since the simulation began, s.
    pub time: f64,
    /// Of the body's frame.
    pub pose: Pose,
    /// Of the origin of the body's frame, world axes.
    pub twist: Twist,
    /// What the query found.
    pub outcome: QueryOutcome,
}

/// What happened in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepOutcome {
    /// Collision events that were followed.
    pub events: usize,
    /// Events among them with a change of resolution within the flight.
    pub switched: usize,
    /// Events at whose instant no surfaces touch: their response is applied with the contact of the event.
    pub estimated: usize,
    /// Flights with more events than are followed.
    pub exhausted: usize,
    /// Impacts, micro-collisions included.
    pub impacts: usize,
    /// Micro-collisions among them.
    pub micro: usize,
    /// Queries made.
    pub queries: usize,
    /// Deepest penetration at the end of a flight or at an event, m; 0 where there was none.
    pub depth: f64,
    /// Potential energy that projection out of penetration added, J; negative where it took some.
    pub lifted: f64,
}

/// Why a step was refused. The state is what it was.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StepError {
    /// The duration is not positive and finite.
    #[error("a step of {duration} s; it must be positive and finite")]
    Duration {
        /// Given, s.
        duration: f64,
    },
    /// The body moves too far in the step to look for collisions on the way.
    #[error(
        "the body moves at {speed} m/s, too fast for a step of {duration} s with a query every {travel} m; take shorter steps"
    )]
    TooFast {
        /// Of the fastest point of the body, m/s.
        speed: f64,
        /// s.
        duration: f64,
        /// m.
        travel: f64,
    },
    /// The objects cannot be queried where the body got to in the step.
    #[error("no contact query on the way of the step: {0}")]
    Query(#[from] QueryError),
}
