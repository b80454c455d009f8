//! The surface that a displacement makes of a coarse triangle.

use glam::{DMat3, DVec3};
use palpate_core::TriMesh;

use super::tree::nearest_in;

/// A side this much longer than the triangle is high makes one without area.
const SLENDERNESS: f64 = 1e-12;

/// Steps of Newton's method until a point is on the surface that is displaced to it.
const STEPS: usize = 20;

/// b(s, t) + h N(s, t): the plane of a triangle, displaced along directions interpolated linearly between its corners'.
#[derive(Clone, Debug)]
pub(super) struct Sheet {
    pub corners: [DVec3; 3],
    /// Along which the corners are displaced.
    pub directions: [DVec3; 3],
    /// Unit normal; 0 without area.
    pub normal: DVec3,
}

/// Where a point is on a sheet.
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
        let flat = cross.length() <= SLENDERNESS * longest;
        Self { corners, directions, normal: if flat { DVec3::ZERO } else { cross.normalize_or_zero() } }
    }

    pub fn has_area(&self) -> bool {
        self.normal != DVec3::ZERO
    }

    /// The point on the triangle's plane, m.
    pub fn base(&self, at: [f64; 2]) -> DVec3 {
        weighted(self.corners, at)
    }

    /// The direction of displacement there.
    pub fn direction(&self, at: [f64; 2]) -> DVec3 {
        weighted(self.directions, at)
    }

    pub fn point(&self, place: Place) -> DVec3 {
        self.base(place.at) + self.direction(place.at) * place.height
    }

    /// The weights of a point on the triangle's plane.
    pub fn weights(&self, point: DVec3) -> [f64; 2] {
        let [a, b, c] = self.corners;
        let area = (b - a).cross(c - a).dot(self.normal);
        let (from, normal) = (point - a, self.normal);
        [from.cross(c - a).dot(normal) / area, (b - a).cross(from).dot(normal) / area]
    }

    /// How far inwards of the side across from each corner a point of the plane is, m.
    pub fn distances(&self, [s, t]: [f64; 2]) -> [f64; 3] {
        let [a, b, c] = self.corners;
        let area = (b - a).cross(c - a).length();
        [(1.0 - s - t) * area / b.distance(c), s * area / c.distance(a), t * area / a.distance(b)]
    }

    /// The weights of the nearest point of the triangle to one on its plane.
    pub fn confined(&self, at: [f64; 2]) -> [f64; 2] {
        self.weights(nearest_in(self.corners, self.base(at)))
    }

    /// Where on the triangle, with what displacement, a point is: Newton's method from the point above the nearest of
    /// the triangle. None if the point is beyond the triangle's sides.
    pub fn locate(&self, point: DVec3) -> Option<Place> {
        if !self.has_area() {
            return None;
        }
        let [a, b, c] = self.corners;
        let [na, nb, nc] = self.directions;
        let foot = nearest_in(self.corners, point);
        let mut place = Place { at: self.weights(foot), height: (point - foot).dot(self.normal) };
        let size = (b - a).length().max((c - a).length());
        for _ in 0..STEPS {
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

/// The sheets of a coarse mesh.
pub(super) fn sheets(coarse: &TriMesh, crease: f64) -> Vec<Sheet> {
    let directions = crate::corner_directions(coarse, crease);
    directions
        .into_iter()
        .enumerate()
        .map(|(t, directions)| Sheet::new(coarse.corners(t), directions))
        .collect()
}

/// Whether weights are those of a point in the triangle, to within a slack.
pub(super) fn is_inside([s, t]: [f64; 2], slack: f64) -> bool {
    s >= -slack && t >= -slack && s + t <= 1.0 + slack
}

fn weighted([a, b, c]: [DVec3; 3], [s, t]: [f64; 2]) -> DVec3 {
    a + (b - a) * s + (c - a) * t
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_found_where_they_were_put() {
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
