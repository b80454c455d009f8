//! From a mesh to its hierarchy: the order of the steps, what can be asked of them and why they may refuse.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat3, DVec3};
use palpate_core::clod::Source;
use palpate_core::mesh::{Adjacency, NO_NEIGHBOUR};
use palpate_core::{Clod, TriMesh};
use rayon::prelude::*;

use crate::convexity::{HULL_THICKNESS, Patch, layer_below};
use crate::decomposition::{Decomposition, decompose};
use crate::hierarchy::merge_to_root;
use crate::hull::{HullBuilder, Plane};
use crate::layout::{Parts, lay_out};
use crate::parameters::{finest_resolution, support_areas};
use crate::surface::Surface;

/// Edges shorter than this fraction of the bounding radius join copies of a vertex.
const NEGLIGIBLE: f64 = 1e-9;

/// Faces of a thin hull below which a point inside of it is looked for.
const MAX_FACES_TRIED: usize = 64;

/// Lengths (m) from the reciprocal of this to this are accepted: their fifth powers, which inertia needs, are far within the
/// range of f64.
const LARGEST_LENGTH: f64 = 1e50;

/// Counts the changes after which the same mesh and options give another hierarchy: whoever keeps built hierarchies can
/// tell by it that one is out of date.
pub const REVISION: u32 = 2;

/// What can be chosen about a build.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildOptions {
    /// How far a patch's surface may lie inside its own hull, and how deep other surface may reach into it, before the
    /// patch counts as not convex (§3.3.1). A fraction of the bounding radius.
    pub tolerance: f64,
    /// Distance tolerance of support areas (§3.3.5) along a vertex normal: a fraction of the bounding radius.
    pub support_distance: f64,
    /// Half angle of the normal cone of support areas (§3.3.5), rad.
    pub support_cone: f64,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self { tolerance: 1e-6, support_distance: 0.025, support_cone: std::f64::consts::FRAC_PI_3 }
    }
}

/// What a build is doing, for its progress callback.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stage {
    /// Checking and indexing the mesh.
    Mesh,
    /// Surface convex decomposition (§3.3.1).
    Decomposition,
    /// Merging patches up to the root (§3.3.3).
    Hierarchy,
    /// Error metric parameters (§3.3.5).
    Parameters,
}

impl std::fmt::Display for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Mesh => "mesh",
            Self::Decomposition => "convex decomposition",
            Self::Hierarchy => "hierarchy",
            Self::Parameters => "parameters",
        })
    }
}

/// Why a hierarchy could not be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BuildError {
    /// The mesh has no triangles.
    #[error(
        "the mesh has no triangles (of {vertices} vertices), so there is nothing to touch: check the file that it came from"
    )]
    Empty {
        /// How many vertices it has.
        vertices: usize,
    },
    /// A vertex of a triangle is not finite.
    #[error(
        "triangle {triangle} uses vertex {vertex} at {position}, which is not finite: run with --repair to drop such triangles"
    )]
    NonFinite {
        /// Index of the first such triangle.
        triangle: usize,
        /// Index of the vertex.
        vertex: usize,
        /// Where it is, m.
        position: DVec3,
    },
    /// The mesh is a single point, or too small, large or far away for arithmetic.
    #[error(
        "the {triangles} triangles are bounded by a sphere of radius {radius} m, {distance} m from the origin, where lengths \
         have to be between 1e-50 and 1e50 m: check the mesh's units and the scale it was loaded with"
    )]
    Extent {
        /// How many triangles there are.
        triangles: usize,
        /// Radius of the bounding sphere, m.
        radius: f64,
        /// Distance of its centre from the origin, m.
        distance: f64,
    },
    /// Every triangle names a vertex twice.
    #[error(
        "each of the {triangles} triangles names a vertex twice, so there is no surface: check the file that the mesh came from"
    )]
    NoSurface {
        /// How many triangles there are.
        triangles: usize,
    },
    /// The hierarchy would need more hull vertices than 32-bit indices can name.
    #[error(
        "the hierarchy needs {hull_vertices} hull vertices, more than 32-bit indices can name: simplify the mesh, or build its parts as separate objects"
    )]
    TooLarge {
        /// How many it needs.
        hull_vertices: usize,
    },
    /// An option is out of range.
    #[error("the build option `{option}` is {value}, but has to be {wanted}")]
    Option {
        /// Its name.
        option: &'static str,
        /// What it was set to.
        value: f64,
        /// What it may be.
        wanted: &'static str,
    },
}

/// Builds the hierarchy of contact levels of detail of a mesh.
///
/// Any finite mesh builds. Where it is not a closed, oriented 2-manifold, inside and outside are not defined: no hull can
/// then be verified to lie inside the object, [`Node::contained`](palpate_core::clod::Node::contained) is false and so is
/// [`Source::solid`](palpate_core::clod::Source::solid).
///
/// `progress` is called from the calling thread with the fraction of the stage that is done.
///
/// # Errors
/// If the mesh has no triangles, no extent or a vertex that is not finite, or an option is out of range.
pub fn build(
    mesh: &TriMesh,
    options: &BuildOptions,
    progress: &mut dyn FnMut(Stage, f64),
) -> Result<Clod, BuildError> {
    options.check()?;
    let (center, radius) = check_extent(mesh)?;

    progress(Stage::Mesh, 0.0);
    let solid = mesh.validate().is_solid();
    let adjacency = mesh.adjacency();
    let surface = Surface::new(mesh, center, radius);
    progress(Stage::Mesh, 1.0);

    let tolerance = options.tolerance * radius * surface.scale;
    let decomposition =
        decompose(&surface, &adjacency, tolerance, &mut |done| progress(Stage::Decomposition, done));
    let contained: Vec<bool> = decomposition
        .patches
        .par_iter()
        .map_init(HullBuilder::default, |hulls, patch| {
            solid && lies_inside(&surface, patch, tolerance, hulls)
        })
        .collect();
    let all_real: Vec<bool> =
        (0..decomposition.patches.len()).map(|patch| is_closed(&decomposition, patch, &adjacency)).collect();
    progress(Stage::Decomposition, 1.0);

    let levels = merge_to_root(&surface.points, &decomposition, &adjacency, &mut |done| {
        progress(Stage::Hierarchy, done);
    });
    progress(Stage::Hierarchy, 1.0);

    progress(Stage::Parameters, 0.0);
    let parts = Parts {
        mesh,
        decomposition: &decomposition,
        levels: &levels,
        support_areas: &support_areas(
            mesh,
            &adjacency,
            options.support_distance * radius,
            options.support_cone,
        ),
        resolution: finest_resolution(mesh, &adjacency, NEGLIGIBLE * radius),
        contained: &contained,
        all_real: &all_real,
        scale: surface.scale,
        center,
    };
    let hull_vertices: usize = levels.iter().flatten().map(|cluster| cluster.extreme.len()).sum();
    if hull_vertices + 3 * mesh.triangles().len() >= u32::MAX as usize {
        return Err(BuildError::TooLarge { hull_vertices });
    }
    let clod = lay_out(&parts, source_of(mesh, solid, center, radius));
    progress(Stage::Parameters, 1.0);
    Ok(clod)
}

impl BuildOptions {
    fn check(&self) -> Result<(), BuildError> {
        for (option, value, range, wanted) in [
            ("tolerance", self.tolerance, 0.0..=0.1, "between 0 and 0.1 of the bounding radius"),
            ("support_distance", self.support_distance, 1e-9..=1e9, "between 1e-9 and 1e9 bounding radii"),
            ("support_cone", self.support_cone, 0.0..=FRAC_PI_2, "between 0 and π/2 rad"),
        ] {
            if !range.contains(&value) {
                return Err(BuildError::Option { option, value, wanted });
            }
        }
        Ok(())
    }
}

/// The bounding sphere of a mesh that has something to build from.
fn check_extent(mesh: &TriMesh) -> Result<(DVec3, f64), BuildError> {
    let (vertices, triangles) = (mesh.vertices(), mesh.triangles());
    if triangles.is_empty() {
        return Err(BuildError::Empty { vertices: vertices.len() });
    }
    if let Some((triangle, vertex)) = triangles
        .iter()
        .enumerate()
        .flat_map(|(t, corners)| corners.map(|v| (t, v as usize)))
        .find(|(_, v)| !vertices[*v].is_finite())
    {
        return Err(BuildError::NonFinite { vertex, triangle, position: vertices[vertex] });
    }
    let sphere = mesh.bounding_sphere();
    if !(1.0 / LARGEST_LENGTH..=LARGEST_LENGTH).contains(&sphere.radius)
        || sphere.center.abs().max_element() > LARGEST_LENGTH
    {
        return Err(BuildError::Extent {
            triangles: triangles.len(),
            radius: sphere.radius,
            distance: sphere.center.length(),
        });
    }
    if triangles.iter().all(|[a, b, c]| a == b || b == c || c == a) {
        return Err(BuildError::NoSurface { triangles: triangles.len() });
    }
    Ok((sphere.center, sphere.radius))
}

/// Whether the hull of a patch lies inside a solid. No surface reaches deeper into it than the tolerance, so that one point
/// deeper than that speaks for all; a hull without such a point is part of the surface. So does one point in the layer below
/// a flat hull, which no surface reaches into either. A single triangle is its own hull.
fn lies_inside(surface: &Surface, patch: &Patch, tolerance: f64, hulls: &mut HullBuilder) -> bool {
    if patch.triangles.len() == 1 {
        return true;
    }
    let points: Vec<DVec3> = patch.extreme.iter().map(|v| surface.points[*v as usize]).collect();
    if patch.flat {
        let plane = surface.planes[patch.lead as usize];
        let middle = surface.corners(patch.lead).iter().sum::<DVec3>() / 3.0;
        let below = middle - 1.5 * tolerance * plane.normal;
        let narrow = layer_below(&plane, &points, 3.0 * tolerance).any(|p| p.height(below) >= -tolerance);
        return narrow || surface.winding_number(below).is_some_and(|turns| turns > 0);
    }
    let planes: Vec<Plane> = hulls.hull(&points, HULL_THICKNESS).planes(&points).collect();
    let depth = |p: DVec3| planes.iter().map(|plane| -plane.height(p)).fold(f64::INFINITY, f64::min);
    let below_faces = patch.triangles.iter().take(MAX_FACES_TRIED).map(|t| {
        let plane = surface.planes[*t as usize];
        let thickness = points.iter().map(|p| -plane.height(*p)).fold(0.0, f64::max);
        surface.corners(*t).iter().sum::<DVec3>() / 3.0 - 0.5 * thickness * plane.normal
    });
    let middle = points.iter().sum::<DVec3>() / points.len() as f64;
    let mut deepest = (middle, depth(middle));
    // In a hull that is thick nearly everywhere the middle is deep enough; in a sheet it may be near the surface.
    if deepest.1 <= 4.0 * tolerance {
        for p in below_faces {
            let depth = depth(p);
            if depth > deepest.1 {
                deepest = (p, depth);
            }
        }
    }
    deepest.1 <= tolerance || surface.winding_number(deepest.0).is_some_and(|turns| turns > 0)
}

/// Whether a patch has no boundary, so that it covers its whole hull.
fn is_closed(decomposition: &Decomposition, patch: usize, adjacency: &Adjacency) -> bool {
    let own = &decomposition.patches[patch];
    !own.flat
        && own.triangles.iter().all(|t| {
            adjacency.neighbours()[*t as usize]
                .iter()
                .all(|n| *n != NO_NEIGHBOUR && decomposition.patch_of[*n as usize] == patch as u32)
        })
}

fn source_of(mesh: &TriMesh, solid: bool, center: DVec3, radius: f64) -> Source {
    let mass = if solid { mesh.mass_properties(1.0).ok() } else { None };
    let (volume, center_of_mass, unit_inertia) = match mass {
        Some(m) => (m.volume, m.center_of_mass, m.inertia * (1.0 / m.mass)),
        None => (0.0, center, DMat3::from_diagonal(DVec3::splat(0.4 * radius * radius))),
    };
    Source {
        vertices: mesh.vertices().len() as u32,
        triangles: mesh.triangles().len() as u32,
        solid: mass.is_some(),
        bounding_radius: radius,
        center,
        volume,
        center_of_mass,
        unit_inertia,
    }
}
