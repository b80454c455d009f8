//! What a simulation is told, and what it refuses.

use glam::DVec3;
use palpate_collide::{ErrorMetrics, QueryError, QuerySettings};
use palpate_core::Pose;

use crate::body::BodyState;

/// How bodies collide, and how that is found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Acceleration in free flight, m/s², world axes.
    pub gravity: DVec3,
    /// e: the part of the approach speed that a collision gives back, 0 to 1. Where giving it back at several contacts, or
    /// with friction, would raise the kinetic energy, it is less.
    pub restitution: f64,
    /// μ of Coulomb friction, not negative.
    pub friction: f64,
    /// d: surfaces closer than this are found, m. §3.5.4 chooses a thousandth of the objects' radii. Closer than half of it
    /// they collide; the other half is what instants of collisions are interpolated from.
    pub tolerance: f64,
    /// s₀, constant, velocity- or view-dependent (§3.4.3). The twist of a velocity metric is replaced by the body's, at
    /// every query. Coarse levels do not contain the surface (§3.6.2): bodies penetrate by up to what levels deviate, and
    /// where that is more than a wall is thick, as with meshes of few triangles, they can come through it.
    pub error: ErrorMetrics,
    /// Furthest that any point of the body goes from one query to the next, m: less than the thinnest part of either body,
    /// or they may pass one another unseen.
    pub travel: f64,
}

impl Settings {
    /// Settings with a tolerance (d, m) and defaults for the rest: at full resolution, standard gravity along −z, e = 0.5,
    /// μ = 0.3, and 5 d from query to query.
    pub fn new(tolerance: f64) -> Self {
        Self {
            gravity: DVec3::new(0.0, 0.0, -9.80665),
            restitution: 0.5,
            friction: 0.3,
            tolerance,
            error: ErrorMetrics::EXACT,
            travel: 5.0 * tolerance,
        }
    }

    /// Closer than this surfaces collide, m.
    pub(crate) fn touch(&self) -> f64 {
        0.5 * self.tolerance
    }

    pub(crate) fn query(&self) -> QuerySettings {
        QuerySettings { error: self.error, ..QuerySettings::new(self.tolerance) }
    }

    pub(crate) fn validate(&self, start: &BodyState, scene: &Pose) -> Result<(), SettingsError> {
        let Self { gravity, restitution, friction, tolerance, travel, .. } = *self;
        let positive = |x: f64| x.is_finite() && x > 0.0;
        if !gravity.is_finite() {
            return Err(SettingsError::Gravity { gravity });
        }
        if !(0.0..=1.0).contains(&restitution) {
            return Err(SettingsError::Restitution { restitution });
        }
        if !(friction.is_finite() && friction >= 0.0) {
            return Err(SettingsError::Friction { friction });
        }
        if !positive(tolerance) {
            return Err(SettingsError::Tolerance { tolerance });
        }
        if !positive(travel) {
            return Err(SettingsError::Travel { travel });
        }
        if !start.is_valid() || !scene.is_valid() {
            return Err(SettingsError::State);
        }
        Ok(())
    }
}

/// Why a simulation was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// Gravity is not finite.
    #[error("gravity, {gravity} m/s², is not finite")]
    Gravity {
        /// Given, m/s².
        gravity: DVec3,
    },
    /// e is not between 0 and 1.
    #[error("the coefficient of restitution is {restitution}; it must be 0 to 1")]
    Restitution {
        /// Given.
        restitution: f64,
    },
    /// μ is negative or not finite.
    #[error("the coefficient of friction is {friction}; it must be finite and not negative")]
    Friction {
        /// Given.
        friction: f64,
    },
    /// d is not positive and finite.
    #[error(
        "the tolerance is {tolerance} m; it must be positive and finite: about a thousandth of the body's radius"
    )]
    Tolerance {
        /// Given, m.
        tolerance: f64,
    },
    /// The way between queries is not positive and finite.
    #[error(
        "the way from query to query is {travel} m; it must be positive, finite and less than the thinnest part"
    )]
    Travel {
        /// Given, m.
        travel: f64,
    },
    /// A pose or velocity is not finite, or a rotation not of unit length.
    #[error("a pose or velocity is not finite, or a rotation is not of unit length")]
    State,
    /// The objects cannot be queried with these settings.
    #[error("the objects cannot be queried: {0}")]
    Query(#[from] QueryError),
}
