//! The skin of a convex patch: the polytope that no other surface may reach into, its hull or the layer below
//! a flat one.
//!
//! While a mesh is simplified, a skin may be larger than that, so that it need not be rebuilt for each
//! collapse: a vertex that moves inside it changes nothing, and one that moves out of it is included by one
//! step of quickhull, with exact visibility tests. Surface that does not reach into the skin does not reach
//! into the hull.

use glam::DVec3;

use crate::box_tree::Bounds;
use crate::hull::{Hull, Plane, Shape, elevation};
use crate::surface::bounds_of;

/// Height above a plane, in unit coordinates, beyond which the sign is certain without exact arithmetic.
const CERTAIN_HEIGHT: f64 = 1e-12;

/// The region of a patch that other surface must not reach into.
#[derive(Clone, Debug)]
pub(crate) enum Skin {
    /// No region: a single triangle, or a patch without extent.
    Bare,
    /// The layer below a flat patch.
    Layer {
        /// Its top and bottom, then its sides.
        planes: Vec<Plane>,
        /// Depth to which other surface may reach.
        depth: f64,
    },
    /// A polytope around all of the patch.
    Polytope(Polytope),
}

/// A polytope given by its boundary.
#[derive(Clone, Debug)]
pub(crate) struct Polytope {
    faces: Vec<[DVec3; 3]>,
    /// Planes of the faces; [`Plane::NONE`] for a face too narrow to have a dependable one.
    planes: Vec<Plane>,
    /// Depth to which other surface may reach.
    depth: f64,
    /// Number of times that it has grown.
    growths: u32,
}

impl Skin {
    /// The skin of a hull of points, if it is a polytope, into which other surface may reach to `depth`.
    pub fn of_hull(hull: &Hull, points: &[DVec3], depth: f64) -> Self {
        if hull.shape != Shape::Polytope {
            return Self::Bare;
        }
        let faces: Vec<_> = hull.faces.iter().map(|f| f.map(|v| points[v as usize])).collect();
        let planes = faces.iter().map(|f| plane_of(*f)).collect();
        Self::Polytope(Polytope { faces, planes, depth, growths: 0 })
    }

    /// Planes of the region; empty if there is no region.
    pub fn planes(&self) -> &[Plane] {
        match self {
            Self::Bare => &[],
            Self::Layer { planes, .. } => planes,
            Self::Polytope(polytope) => &polytope.planes,
        }
    }

    /// Depth to which other surface may reach.
    pub fn depth(&self) -> f64 {
        match self {
            Self::Bare => 0.0,
            Self::Layer { depth, .. } => *depth,
            Self::Polytope(polytope) => polytope.depth,
        }
    }

    /// Whether it has grown so often, and may be so much larger than needed, that it should be rebuilt.
    pub fn worn(&self) -> bool {
        matches!(self, Self::Polytope(p) if p.growths as usize > 8 + p.faces.len() / 8)
    }
}

impl Polytope {
    /// The faces that a point lies above, strictly.
    pub fn visible(&self, point: DVec3) -> Vec<usize> {
        let above = |k: &usize| {
            let height = self.planes[*k].height(point);
            if height.abs() > CERTAIN_HEIGHT && height.is_finite() {
                return height > 0.0;
            }
            let [a, b, c] = self.faces[*k];
            elevation(a, b, c, point) > 0.0
        };
        (0..self.faces.len()).filter(above).collect()
    }

    /// The polytope grown to include a point that sees the `visible` faces, and the box around the part
    /// added.
    pub fn grown(&self, point: DVec3, visible: &[usize]) -> (Self, Bounds) {
        let sides = |k: &usize| {
            let [a, b, c] = self.faces[*k];
            [[a, b], [b, c], [c, a]]
        };
        let inner: Vec<[DVec3; 2]> = visible.iter().flat_map(sides).collect();
        let horizon = inner.iter().filter(|[from, to]| !inner.contains(&[*to, *from]));
        let mut faces: Vec<[DVec3; 3]> = Vec::with_capacity(self.faces.len() + 2);
        let mut planes: Vec<Plane> = Vec::with_capacity(self.faces.len() + 2);
        let mut gone = visible.iter().peekable();
        for k in 0..self.faces.len() {
            if gone.next_if(|g| **g == k).is_none() {
                faces.push(self.faces[k]);
                planes.push(self.planes[k]);
            }
        }
        for [from, to] in horizon {
            let face = [*from, *to, point];
            faces.push(face);
            planes.push(plane_of(face));
        }
        let (low, high) = bounds_of(inner.as_flattened());
        (
            Self { faces, planes, depth: self.depth, growths: self.growths + 1 },
            (low.min(point), high.max(point)),
        )
    }
}

/// The plane of a face, or [`Plane::NONE`] if the face is too narrow to have a dependable one.
fn plane_of(face: [DVec3; 3]) -> Plane {
    Plane::dependable(face).unwrap_or(Plane::NONE)
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::convexity::HULL_THICKNESS;
    use crate::hull::HullBuilder;

    #[test]
    fn grows_into_the_hull_of_all_points() {
        let seed = 83;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        let mut builder = HullBuilder::default();
        for round in 0..60 {
            // Half of them on a lattice, where points are coplanar and collinear.
            let mut random = || {
                DVec3::from_array(std::array::from_fn(|_| match round % 2 {
                    0 => rng.random_range(-1.0..1.0),
                    _ => f64::from(rng.random_range(-2..=2)),
                }))
            };
            let mut points: Vec<DVec3> = (0..8).map(|_| random()).collect();
            let Skin::Polytope(mut polytope) =
                Skin::of_hull(&builder.hull(&points, HULL_THICKNESS), &points, 0.0)
            else {
                continue;
            };
            for _ in 0..30 {
                let p = random();
                points.push(p);
                let visible = polytope.visible(p);
                if !visible.is_empty() {
                    polytope = polytope.grown(p, &visible).0;
                }
            }
            let hull = builder.hull(&points, HULL_THICKNESS);
            let planes: Vec<Plane> = hull.planes(&points).collect();
            for _ in 0..100 {
                let p = 1.2 * random();
                let height = |planes: &[Plane]| planes.iter().map(|h| h.height(p)).fold(f64::MIN, f64::max);
                let (expected, found) = (height(&planes), height(&polytope.planes));
                assert!((expected - found).abs() < 1e-9, "round {round}: {expected} {found}");
            }
        }
    }
}
