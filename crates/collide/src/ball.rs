//! Bounding spheres.

use palpate_core::glam::DVec3;

/// A bounding sphere, in its body's frame or another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ball {
    /// Centre, m.
    pub center: DVec3,
    /// Radius, m.
    pub radius: f64,
}

impl Ball {
    /// The smallest sphere about a triangle's centroid that contains the triangle.
    pub fn around(corners: &[DVec3; 3]) -> Self {
        let center = (corners[0] + corners[1] + corners[2]) / 3.0;
        let radius = corners.iter().map(|c| c.distance_squared(center)).fold(0.0, f64::max).sqrt();
        Self { center, radius }
    }
}
