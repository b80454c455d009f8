//! Displaced surfaces of coarse triangles.

use glam::{DMat3, DVec3};
use palpate_core::TriMesh;

use super::tree::nearest_in;

/// Ratio of a triangle's height to its longest side at or below which it counts as having no area.
const MIN_SLENDERNESS: f64 = 1e-12;

/// Maximum number of Newton steps to the point of a sheet that is displaced to a given point.
const MAX_NEWTON_STEPS: usize = 20;

/// The plane of a triangle, displaced along directions that are interpolated linearly between its corners:
/// p(s, t, h) = b(s, t) + h N(s, t).
#[derive(Clone, Debug)]
pub(super) struct Sheet {
    pub corners: [DVec3; 3],
    /// Directions of displacement at the corners.
    pub directions: [DVec3; 3],
    /// Unit normal; zero for a triangle without area.
    pub normal: DVec3,
}

/// Coordinates of a point on a sheet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Weights of the second and the third corner.
    pub at: [f64; 2],
    /// Displacement, m.
    pub height: f64,
}

impl Sheet {
    pub fn new(corners: [DVec3; 3], directions: [DVec3; 3]) -> Self {
        let [a, b, c] = corners;
        let cross = (b - a).cross(c - a);
        let longest = [b - a, c - b, a - c].iter().map(|side| side.length_squared()).fold(0.0, f64::max);
        let flat = cross.length() <= MIN_SLENDERNESS * longest;
        Self { corners, directions, normal: if flat { DVec3::ZERO } else { cross.normalize_or_zero() } }
    }

    /// Returns whether the triangle has an area.
    pub fn has_area(&self) -> bool {
        self.normal != DVec3::ZERO
    }

    /// Returns the point b of the triangle's plane, m.
    pub fn base(&self, at: [f64; 2]) -> DVec3 {
        weighted(self.corners, at)
    }

    /// Returns the direction of displacement N.
    pub fn direction(&self, at: [f64; 2]) -> DVec3 {
        weighted(self.directions, at)
    }

    /// Returns the displaced point, m.
    pub fn point(&self, place: Place) -> DVec3 {
        self.base(place.at) + self.direction(place.at) * place.height
    }

    /// Returns the weights s, t of a point on the triangle's plane.
    pub fn weights(&self, point: DVec3) -> [f64; 2] {
        let [a, b, c] = self.corners;
        let area = (b - a).cross(c - a).dot(self.normal);
        let (from, normal) = (point - a, self.normal);
        [from.cross(c - a).dot(normal) / area, (b - a).cross(from).dot(normal) / area]
    }

    /// Returns the distances of a point of the plane from the side opposite each corner, m: positive inside.
    pub fn distances(&self, [s, t]: [f64; 2]) -> [f64; 3] {
        let [a, b, c] = self.corners;
        let area = (b - a).cross(c - a).length();
        [(1.0 - s - t) * area / b.distance(c), s * area / c.distance(a), t * area / a.distance(b)]
    }

    /// Returns the weights of the point of the triangle that is nearest to a point of its plane.
    pub fn confined(&self, at: [f64; 2]) -> [f64; 2] {
        self.weights(nearest_in(self.corners, self.base(at)))
    }

    /// Returns the place on the sheet of a point, by Newton's method from the nearest point of the triangle.
    /// `None` if the point is beyond the triangle's sides.
    pub fn locate(&self, point: DVec3) -> Option<Place> {
        if !self.has_area() {
            return None;
        }
        let [a, b, c] = self.corners;
        let [na, nb, nc] = self.directions;
        let foot = nearest_in(self.corners, point);
        let mut place = Place { at: self.weights(foot), height: (point - foot).dot(self.normal) };
        let size = (b - a).length().max((c - a).length());
        // Solves b(s, t) + h N(s, t) = point for (s, t, h); the Jacobian's columns are ∂p/∂s, ∂p/∂t and N.
        for _ in 0..MAX_NEWTON_STEPS {
            let rest = point - self.point(place);
            let h = place.height;
            let jacobian =
                DMat3::from_cols(b - a + h * (nb - na), c - a + h * (nc - na), self.direction(place.at));
            let step = jacobian.inverse() * rest;
            if !step.is_finite() {
                return None;
            }
            place = Place { at: [place.at[0] + step.x, place.at[1] + step.y], height: h + step.z };
            if rest.length() <= 1e-14 * size {
                break;
            }
        }
        let converged = self.point(place).distance(point) <= 1e-9 * size;
        (converged && is_inside(place.at, 1e-9)).then_some(place)
    }
}

/// Returns the sheets of a coarse mesh's triangles.
pub(super) fn sheets(coarse: &TriMesh, crease: f64) -> Vec<Sheet> {
    let directions = crate::corner_directions(coarse, crease);
    directions
        .into_iter()
        .enumerate()
        .map(|(t, directions)| Sheet::new(coarse.corners(t), directions))
        .collect()
}

/// Returns whether weights are those of a point in the triangle, to within a tolerance.
pub(super) fn is_inside([s, t]: [f64; 2], slack: f64) -> bool {
    s >= -slack && t >= -slack && s + t <= 1.0 + slack
}

/// Interpolates linearly between three corners.
fn weighted([a, b, c]: [DVec3; 3], [s, t]: [f64; 2]) -> DVec3 {
    a + (b - a) * s + (c - a) * t
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn displaced_points_are_located() {
        let corners = [DVec3::new(0.1, 0.0, 0.0), DVec3::new(0.0, 0.2, 0.0), DVec3::new(0.0, 0.0, 0.1)];
        let sheet = Sheet::new(corners, corners.map(DVec3::normalize));
        for (at, height) in [([0.2, 0.3], 0.02), ([0.0, 0.0], -0.01), ([0.5, 0.5], 0.0), ([0.9, 0.05], -0.03)]
        {
            let place = sheet.locate(sheet.point(Place { at, height })).unwrap();
            assert!((place.height - height).abs() < 1e-12, "{place:?}");
            assert!((place.at[0] - at[0]).abs() + (place.at[1] - at[1]).abs() < 1e-10, "{place:?}");
        }
        assert!(sheet.locate(sheet.point(Place { at: [0.7, 0.4], height: 0.01 })).is_none());
        assert!(!Sheet::new([DVec3::ZERO, DVec3::X, DVec3::X * 2.0], [DVec3::Z; 3]).has_area());
    }
}
