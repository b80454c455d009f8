//! The bounding sphere, whose radius is the unit of relative lengths and tolerances: centred on the middle of
//! the axis-aligned bounding box, with the radius that reaches the farthest vertex. It is not the smallest
//! sphere (its radius is at most √3 times that one's), but it is defined in one line, needs no iteration and
//! does not depend on the vertices' order.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::TriMesh;

/// A sphere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sphere {
    /// Centre, m.
    pub center: DVec3,
    /// Radius, m; not negative.
    pub radius: f64,
}

impl Sphere {
    /// The sphere about the middle of the points' axis-aligned bounding box that reaches the farthest point.
    /// Points that are not finite are left out; without any point it is the origin with radius 0.
    pub fn about_box(points: impl Iterator<Item = DVec3> + Clone) -> Self {
        let finite = points.filter(|p| p.is_finite());
        let (low, high) = finite
            .clone()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        if !low.is_finite() {
            return Self::default();
        }
        // Halved before they are added, and measured in units of the box, so that neither huge nor tiny
        // coordinates leave the range of f64 on the way.
        let center = low * 0.5 + high * 0.5;
        let half_extent = (high * 0.5 - low * 0.5).max_element();
        if half_extent == 0.0 {
            return Self { center, radius: 0.0 };
        }
        let unit = power_of_two_near(half_extent);
        let reach = finite.map(|p| ((p - center) / unit).length_squared()).fold(0.0, f64::max).sqrt();
        Self { center, radius: unit * reach }
    }
}

/// A power of two within a factor of two of a positive length, so that division by it is exact. It and its
/// reciprocal are normal numbers.
pub(super) fn power_of_two_near(length: f64) -> f64 {
    2f64.powi(length.log2().floor().clamp(-1021.0, 1021.0) as i32)
}

impl TriMesh {
    /// The bounding sphere of the vertices that triangles refer to: centred on the middle of their
    /// axis-aligned bounding box, reaching the farthest of them. Its radius is the *bounding radius* that
    /// tolerances are given in.
    pub fn bounding_sphere(&self) -> Sphere {
        let mut referenced = vec![false; self.vertices.len()];
        for &v in self.triangles.iter().flatten() {
            referenced[v as usize] = true;
        }
        let referenced = &referenced;
        Sphere::about_box(
            self.vertices.iter().zip(referenced).filter(|(_, used)| **used).map(|(position, _)| *position),
        )
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    use super::super::test_shapes::{cuboid, tangle};
    use super::*;

    #[test]
    fn a_box_reaches_its_corners() {
        let sphere = cuboid(DVec3::new(1.0, 2.0, 3.0), DVec3::new(3.0, 6.0, 7.0)).bounding_sphere();
        assert_eq!(sphere, Sphere { center: DVec3::new(2.0, 4.0, 5.0), radius: 3.0 });
    }

    #[test]
    fn only_finite_vertices_of_triangles_count() {
        let mut vertices = vec![DVec3::X, DVec3::NEG_X, DVec3::ZERO, DVec3::NAN, DVec3::Y * f64::INFINITY];
        vertices.push(DVec3::splat(100.0));
        let mesh = TriMesh::new(vertices, vec![[0, 1, 2], [3, 4, 2]]).unwrap();
        assert_eq!(mesh.bounding_sphere(), Sphere { center: DVec3::ZERO, radius: 1.0 });
        assert_eq!(TriMesh::default().bounding_sphere(), Sphere::default());
        let nothing_finite = TriMesh::new(vec![DVec3::NAN; 3], vec![[0, 1, 2]]).unwrap();
        assert_eq!(nothing_finite.bounding_sphere(), Sphere::default());
    }

    #[test]
    fn it_encloses_every_vertex_and_touches_one_at_any_scale() {
        const SEED: u64 = 21;
        let random = &mut StdRng::seed_from_u64(SEED);
        for _ in 0..200 {
            let count = random.random_range(1..30);
            let mesh = tangle(random, count, 20);
            let unit = mesh.bounding_sphere();
            let used = mesh.triangles().iter().flatten().map(|v| mesh.vertices()[*v as usize]);
            let farthest = used.map(|p| p.distance(unit.center)).fold(0.0, f64::max);
            assert!((farthest - unit.radius).abs() <= 1e-15 * unit.radius, "seed {SEED}");
            for exponent in [-1000, -500, 500, 1000] {
                let scale = 2f64.powi(exponent);
                let scaled = super::super::test_shapes::mapped(&mesh, |p| p * scale).bounding_sphere();
                assert!((scaled.radius / scale - unit.radius).abs() <= 1e-14 * unit.radius, "seed {SEED}");
            }
        }
    }
}
