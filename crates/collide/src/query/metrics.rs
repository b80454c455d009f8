//! Error metrics (§3.4.3): the threshold s₀ on the weighted surface deviation s* at a contact.

use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist};

use crate::error::QueryError;

/// The threshold s₀, by any combination of metrics. A plain length converts to the haptic metric alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorMetrics {
    /// Haptic metric: s₀ itself, m. §3.5.2 finds 2.5 to 5 % of the objects' radii unnoticed.
    pub haptic: Option<f64>,
    /// Velocity-dependent metric: s₀ grows with the relative speed of the surfaces.
    pub velocity: Option<VelocityMetric>,
    /// View-dependent metric: s₀ is the size of a number of pixels at the contact.
    pub view: Option<ViewMetric>,
    /// Rule by which several metrics are combined.
    pub combination: Combination,
}

/// The rule by which several metrics are combined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Combination {
    /// The smallest s₀: detail is left out if all metrics allow it.
    #[default]
    Strictest,
    /// The largest s₀: detail is left out if any metric allows it.
    Loosest,
}

/// Metric with the distance by which the surfaces slide past one another in a time as s₀: the faster they
/// move, the less noticeable a gap is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityMetric {
    /// s₀ over the relative speed at the contact, s.
    pub time: f64,
    /// Velocity of the probe relative to the scene object: of the origin of the probe's frame, world axes.
    pub twist: Twist,
}

/// Metric with s₀ = N l f / (n i) (Eq. 3.8).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewMetric {
    /// N: admissible error on the screen, pixels.
    pub pixels: f64,
    /// Position of the camera, world axes, m; its distance from the contact is l.
    pub camera: DVec3,
    /// n: distance of the near plane from the camera, m.
    pub near: f64,
    /// f: size of the view frustum at the near plane, m.
    pub frustum: f64,
    /// i: size of the image, pixels, along the same side as f.
    pub image: f64,
}

impl From<f64> for ErrorMetrics {
    fn from(haptic: f64) -> Self {
        Self { haptic: Some(haptic), ..Self::default() }
    }
}

impl ErrorMetrics {
    /// Full resolution.
    pub const EXACT: Self =
        Self { haptic: None, velocity: None, view: None, combination: Combination::Strictest };

    /// Whether s₀ is 0 everywhere, which means full resolution: no metric, or an error of 0.
    pub fn is_exact(&self) -> bool {
        let one = matches!(self.haptic, None | Some(0.0));
        let others = self.velocity.is_none() && self.view.is_none();
        one && (others || (self.haptic.is_some() && self.combination == Combination::Strictest))
    }

    /// Whether s₀ is the same at all contacts and at all times.
    pub(crate) fn is_constant(&self) -> bool {
        self.is_exact() || (self.velocity.is_none() && self.view.is_none())
    }

    /// Checks that all numbers are finite and none is negative, or zero if it must be positive.
    pub(crate) fn check(&self) -> Result<(), QueryError> {
        let length = |x: f64| x.is_finite() && x >= 0.0;
        let velocity = |v: VelocityMetric| length(v.time) && v.twist.is_finite();
        let view = |v: ViewMetric| {
            length(v.pixels)
                && v.camera.is_finite()
                && [v.near, v.frustum, v.image].iter().all(|x| x.is_finite() && *x > 0.0)
        };
        if let Some(given) = self.haptic.filter(|given| !length(*given)) {
            return Err(QueryError::HapticMetric { given });
        }
        if !self.velocity.is_none_or(velocity) {
            return Err(QueryError::VelocityMetric);
        }
        if !self.view.is_none_or(view) {
            return Err(QueryError::ViewMetric);
        }
        Ok(())
    }

    /// s₀ at a contact, m, world axes.
    pub(crate) fn threshold(&self, contact: DVec3, probe_pose: &Pose) -> f64 {
        let velocity = self
            .velocity
            .map(|metric| metric.time * metric.twist.velocity_at(contact - probe_pose.translation).length());
        let view = self.view.map(|metric| {
            let distance = metric.camera.distance(contact);
            metric.pixels * distance * metric.frustum / (metric.near * metric.image)
        });
        let all = [self.haptic, velocity, view].into_iter().flatten();
        let threshold = match self.combination {
            Combination::Strictest => all.reduce(f64::min),
            Combination::Loosest => all.reduce(f64::max),
        };
        threshold.unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_are_as_printed() {
        let contact = DVec3::new(0.0, 0.0, 2.0);
        let pose = Pose::from_translation(DVec3::new(1.0, 0.0, 2.0));
        let velocity = VelocityMetric { time: 0.01, twist: Twist::new(DVec3::X, 3.0 * DVec3::Z) };
        let view = ViewMetric { pixels: 2.0, camera: DVec3::ZERO, near: 0.1, frustum: 0.08, image: 1000.0 };
        let of = |metrics: ErrorMetrics| metrics.threshold(contact, &pose);
        assert_eq!(of(0.02.into()), 0.02);
        // One metre beside the axis at 3 rad/s, and 1 m/s across that.
        let moving = ErrorMetrics { velocity: Some(velocity), ..ErrorMetrics::EXACT };
        assert!((of(moving) - 0.01 * 10f64.sqrt()).abs() < 1e-15);
        let seen = ErrorMetrics { view: Some(view), ..ErrorMetrics::EXACT };
        assert!((of(seen) - 2.0 * 2.0 * 0.08 / (0.1 * 1000.0)).abs() < 1e-15);
        let all = ErrorMetrics { haptic: Some(0.02), velocity: Some(velocity), view: Some(view), ..seen };
        assert_eq!(of(all), of(seen));
        assert_eq!(of(ErrorMetrics { combination: Combination::Loosest, ..all }), of(moving));
        assert!(!all.is_constant() && !all.is_exact() && all.check().is_ok());
        assert!(ErrorMetrics::from(0.0).is_exact() && ErrorMetrics::EXACT.is_exact());
        assert!(ErrorMetrics { haptic: Some(0.0), ..all }.is_exact());
        let loose = ErrorMetrics { haptic: Some(0.0), combination: Combination::Loosest, ..all };
        assert!(!loose.is_exact());
        let (far, eternal) =
            (ViewMetric { near: 0.0, ..view }, VelocityMetric { time: f64::INFINITY, ..velocity });
        assert_eq!(ErrorMetrics::from(-1.0).check(), Err(QueryError::HapticMetric { given: -1.0 }));
        assert!(matches!(ErrorMetrics::from(f64::NAN).check(), Err(QueryError::HapticMetric { .. })));
        assert_eq!(ErrorMetrics { view: Some(far), ..all }.check(), Err(QueryError::ViewMetric));
        assert_eq!(ErrorMetrics { velocity: Some(eternal), ..all }.check(), Err(QueryError::VelocityMetric));
    }
}
