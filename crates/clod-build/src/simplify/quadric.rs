//! Quadric error metric (Garland and Heckbert 1997): the sum of squared distances from planes.

use glam::{DMat3, DVec3};

/// Weight of a boundary edge relative to the triangles beside it. With less, borders lose their shape.
const BOUNDARY_WEIGHT: f64 = 10.0;

/// Weight of the distance from the middle of the edge, relative to the planes. It determines the minimum
/// where the planes do not; more pulls the minimum off the planes.
const MIDDLE_WEIGHT: f64 = 1e-4;

/// The function x·A x + 2 b·x + c, without c, which is not needed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Quadric {
    a: DMat3,
    b: DVec3,
}

impl Quadric {
    /// The quadric of no planes.
    pub const NONE: Self = Self { a: DMat3::ZERO, b: DVec3::ZERO };

    /// The quadric of the squared distance from the plane n·x = d, times a weight.
    pub fn plane(normal: DVec3, offset: f64, weight: f64) -> Self {
        let n = normal;
        Self { a: DMat3::from_cols(n * n.x, n * n.y, n * n.z) * weight, b: -offset * weight * n }
    }

    /// The quadric of a boundary edge: of the plane through it perpendicular to its triangle, so that the
    /// border keeps its shape.
    pub fn border(from: DVec3, to: DVec3, normal: DVec3) -> Self {
        let across = (to - from).cross(normal).normalize_or_zero();
        Self::plane(across, across.dot(from), BOUNDARY_WEIGHT * from.distance_squared(to))
    }

    /// The sum of two quadrics.
    pub fn plus(&self, other: &Self) -> Self {
        Self { a: self.a + other.a, b: self.b + other.b }
    }

    /// The point of the least value. Where the planes do not determine it, on a flat place or along a crease,
    /// the one nearest to `middle`: the squared distance from there is added with a small weight, which makes
    /// the matrix regular.
    pub fn minimum(&self, middle: DVec3) -> DVec3 {
        let trace = self.a.x_axis.x + self.a.y_axis.y + self.a.z_axis.z;
        let held = self.a + DMat3::from_diagonal(DVec3::splat(MIDDLE_WEIGHT * trace));
        if !(trace > 0.0 && held.determinant() != 0.0) {
            return middle;
        }
        let step = held.inverse() * -(self.a * middle + self.b);
        if step.is_finite() { middle + step } else { middle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corner_crease_and_plane() {
        let corner = [DVec3::X, DVec3::Y, DVec3::Z]
            .iter()
            .fold(Quadric::NONE, |q, n| q.plus(&Quadric::plane(*n, 2.0, 0.7)));
        let middle = DVec3::new(2.3, 1.8, 2.1);
        let p = corner.minimum(middle);
        assert!((p - DVec3::splat(2.0)).length() < 1e-3 * middle.distance(DVec3::splat(2.0)), "{p}");
        let crease = Quadric::plane(DVec3::X, 2.0, 1.0).plus(&Quadric::plane(DVec3::Y, 2.0, 3.0));
        let p = crease.minimum(middle);
        assert!((p - DVec3::new(2.0, 2.0, 2.1)).length() < 1e-3, "{p}");
        let plane = Quadric::plane(DVec3::Z, 2.0, 5.0);
        assert!((plane.minimum(middle) - DVec3::new(2.3, 1.8, 2.0)).length() < 1e-3);
        assert_eq!(Quadric::NONE.minimum(middle), middle);
    }

    #[test]
    fn border_holds_the_edge_but_not_along_it() {
        let border =
            Quadric::border(DVec3::ZERO, DVec3::X, DVec3::Z).plus(&Quadric::plane(DVec3::Z, 0.0, 1.0));
        let p = border.minimum(DVec3::new(0.4, 0.2, 0.1));
        assert!((p - DVec3::X * 0.4).length() < 1e-3, "{p}");
    }
}
