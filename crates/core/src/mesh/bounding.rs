//! The bounding sphere that lengths and tolerances are given in proportion to: centred on the middle of the axis-aligned
//! bounding box, with the radius that reaches the farthest vertex. It is not the smallest sphere (its radius is at most
//! √3 times that one's), but it is defined in one line, needs no iteration and does not depend on the vertices' order.

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
        // Halved before they are added, and measured in units of the box, so that neither huge nor tiny coordinates
        // leave the range of f64 on the way.
        let center = low * 0.5 + high * 0.5;
        let unit = (high * 0.5 - low * 0.5).max_element();
        if unit == 0.0 {
            return Self { center, radius: 0.0 };
        }
        let reach = finite.map(|p| ((p - center) / unit).length_squared()).fold(0.0, f64::max).sqrt();
        Self { center, radius: unit * reach }
    }
}

impl TriMesh {
    /// The bounding sphere of the vertices that triangles refer to: centred on the middle of their axis-aligned
    /// bounding box, reaching the farthest of them. Its radius is the *bounding radius* that tolerances are given in.
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
