//! Settings of a simulation, and their validation.

use glam::DVec3;
use palpate_collide::{ErrorMetrics, QueryError, QuerySettings};
use palpate_core::Pose;

use crate::body::BodyState;

/// Settings of collisions and of their detection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Gravity, m/s², world axes.
    pub gravity: DVec3,
    /// Coefficient of restitution e, 0 to 1: ratio of separation to approach speed in a collision. The
    /// effective value is smaller where several contacts, or friction, would otherwise raise the kinetic
    /// energy.
    pub restitution: f64,
    /// Coefficient μ of Coulomb friction, not negative.
    pub friction: f64,
    /// Tolerance d of queries, m: surfaces closer than this are found. §3.5.4 chooses a thousandth of the
    /// objects' radii. Surfaces collide at half of it; the other half lets times of collisions be
    /// interpolated.
    pub tolerance: f64,
    /// Error metric s₀: constant, velocity- or view-dependent (§3.4.3). The twist of a velocity metric is
    /// replaced by the body's at every query. Coarse levels do not contain the surface (§3.6.2), so bodies
    /// penetrate by up to the levels' deviation. If that exceeds the thickness of a wall, as with meshes of
    /// few triangles, they can pass through it.
    pub error: ErrorMetrics,
    /// Largest distance that any point of the body moves between queries, m. It has to be less than the
    /// thinnest part of either body, or they may pass through one another undetected.
    pub travel: f64,
}

impl Settings {
    /// Returns settings with a tolerance (d, m) and defaults for the rest: full resolution, standard gravity
    /// along −z, e = 0.5, μ = 0.3, and 5 d between queries.
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

    /// Distance at which surfaces collide, m.
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

/// Reason why a simulation was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// Gravity is not finite.
    #[error("gravity, {gravity} m/s², is not finite")]
    Gravity {
        /// Gravity that was given, m/s².
        gravity: DVec3,
    },
    /// e is not between 0 and 1.
    #[error("the coefficient of restitution is {restitution}; it must be 0 to 1")]
    Restitution {
        /// Coefficient that was given.
        restitution: f64,
    },
    /// μ is negative or not finite.
    #[error("the coefficient of friction is {friction}; it must be finite and not negative")]
    Friction {
        /// Coefficient that was given.
        friction: f64,
    },
    /// d is not positive and finite.
    #[error(
        "the tolerance is {tolerance} m; it must be positive and finite: about a thousandth of the body's radius"
    )]
    Tolerance {
        /// Tolerance that was given, m.
        tolerance: f64,
    },
    /// The distance between queries is not positive and finite.
    #[error(
        "the distance between queries is {travel} m; it must be positive, finite and less than the thinnest part"
    )]
    Travel {
        /// Distance that was given, m.
        travel: f64,
    },
    /// A pose or velocity is not finite, or a rotation not of unit length.
    #[error("a pose or velocity is not finite, or a rotation is not of unit length")]
    State,
    /// The objects cannot be queried with these settings.
    #[error("the objects cannot be queried: {0}")]
    Query(#[from] QueryError),
}
