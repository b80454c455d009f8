//! The build of a hierarchy from a mesh: its options, its checks and the order of its steps.

use std::f64::consts::FRAC_PI_2;
use std::ops::ControlFlow;

use glam::{DMat3, DVec3};
use palpate_core::clod::Source;
use palpate_core::{Clod, TriMesh};

use crate::bounding::bound_descendants;
use crate::decomposition::decompose;
use crate::error::BuildError;
use crate::hierarchy::merge_to_root;
use crate::levels::{Regular, assemble};
use crate::parameters::{Support, finest_resolution, support_areas};
use crate::progress::{Progress, Stage};
use crate::requirements::{check_intersections, check_surface};
use crate::simplify::{Limits, simplify};
use crate::surface::Surface;

/// Length of an edge, as a fraction of the bounding radius, below which its ends count as copies of one
/// vertex.
const MIN_EDGE_LENGTH: f64 = 1e-9;

/// Largest length accepted, m; the smallest bounding radius is its reciprocal. Fifth powers of such lengths,
/// which inertia needs, are far within the range of f64.
const MAX_LENGTH: f64 = 1e50;

/// Revision of the builder, raised whenever the same mesh and options give another hierarchy: a cache of
/// built hierarchies compares it to find those that are out of date.
pub const REVISION: u32 = 7;

/// Options of a build.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildOptions {
    /// Convexity tolerance (§3.3.1), as a fraction of the bounding radius: the surface of a convex patch may
    /// lie this far inside its own hull, and other surface may reach this deep into it.
    pub tolerance: f64,
    /// Distance tolerance of support areas (§3.3.5) along a vertex normal: a fraction of the bounding
    /// radius.
    pub support_distance: f64,
    /// Largest distance of a support area from its vertex: a fraction of the bounding radius.
    pub support_radius: f64,
    /// Whether to make levels of detail by simplification (§3.3.3) before patches are merged freely. If
    /// false, every level but the full mesh's is free.
    pub simplify: bool,
    /// Lowest resolution (Eq. 3.1) to which simplification goes, times the bounding radius.
    pub coarsest: f64,
    /// Whether patches are carried through the collapses, as in the dissertation; if false, each level is
    /// decomposed anew.
    pub carried: bool,
    /// Largest number of points of its descendants that a hull gets so as to bound them better (§3.6.2):
    /// with 0 it is the hull of its patch, as in the dissertation; with [`u32::MAX`] every hull contains
    /// its descendants.
    pub bounding_points: u32,
    /// Half angle of the normal cone of support areas (§3.3.5), rad.
    pub support_cone: f64,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            tolerance: 1e-6,
            support_distance: 3e-4,
            support_radius: 0.05,
            support_cone: std::f64::consts::FRAC_PI_3,
            simplify: true,
            coarsest: 4.0,
            carried: true,
            bounding_points: 16,
        }
    }
}

/// Builds the hierarchy of contact levels of detail of a mesh.
///
/// The mesh has to be an oriented 2-manifold, with or without boundary, of triangles with an area, that does
/// not intersect itself (tested exactly; surfaces may touch at vertices and edges that they share or that
/// coincide) and, if it is closed, does not enclose a negative volume. `palpate_mesh_io::repair` makes such a
/// mesh from any other. Where there is a boundary, inside and outside are not defined: no hull can then be
/// verified to lie inside the object, [`Node::contained`](palpate_core::clod::Node::contained) is false and
/// so is [`Source::solid`](palpate_core::clod::Source::solid).
///
/// `progress` is called from the calling thread with the fraction of the stage that is done, at most some 25
/// times a second besides the beginning and end of each stage; if it returns `Break`, the build ends with
/// [`BuildError::Cancelled`].
///
/// # Errors
/// If it is cancelled, the mesh is not as described above, has no triangles, no extent or a vertex that is
/// not finite, or an option is out of range.
pub fn build(
    mesh: &TriMesh,
    options: &BuildOptions,
    progress: &mut dyn FnMut(Stage, f64) -> ControlFlow<()>,
) -> Result<Clod, BuildError> {
    options.check()?;
    let (center, radius) = check_extent(mesh)?;
    let mut progress = Progress::new(progress);

    progress.begin(Stage::Mesh)?;
    let report = mesh.validate();
    check_surface(mesh, &report)?;
    let solid = report.is_solid();
    let adjacency = mesh.adjacency();
    let surface = Surface::new(mesh, center, radius);
    check_intersections(mesh, &surface)?;
    progress.end()?;

    let tolerance = options.tolerance * radius * surface.scale;
    progress.begin(Stage::Decomposition)?;
    let decomposition = decompose(&surface, &adjacency, tolerance, &mut progress)?;
    progress.end()?;

    let support = Support {
        distance: options.support_distance * radius,
        radius: options.support_radius * radius,
        cone: options.support_cone,
    };
    let areas = support_areas(mesh, &adjacency, &support);
    let simplified = if options.simplify {
        let limits = Limits {
            tolerance,
            radius: radius * surface.scale,
            coarsest: options.coarsest,
            carried: options.carried,
        };
        progress.begin(Stage::Simplification)?;
        let levels = simplify(mesh, &surface, &decomposition, &areas, &limits, &mut progress)?;
        progress.end()?;
        levels
    } else {
        Vec::new()
    };
    let free = {
        let (points, coarsest, links) = match simplified.last() {
            Some((level, _)) => (&level.surface.points, &level.decomposition, &level.mesh.adjacency()),
            None => (&surface.points, &decomposition, &adjacency),
        };
        progress.begin(Stage::Hierarchy)?;
        merge_to_root(points, coarsest, links, radius * surface.scale, &mut progress)?
    };
    progress.end()?;

    progress.begin(Stage::Parameters)?;
    let first =
        Regular { mesh, surface: &surface, decomposition: &decomposition, areas: &areas, trace: None };
    let finest = finest_resolution(mesh, &adjacency, MIN_EDGE_LENGTH * radius);
    let regular: Vec<(Regular<'_>, f64)> = std::iter::once((first, finest))
        .chain(simplified.iter().map(|(level, trace)| {
            let resolution = finest.min(level.resolution * surface.scale);
            (Regular::simplified(level, trace), resolution)
        }))
        .collect();
    let hull_vertices: usize = regular
        .iter()
        .flat_map(|(level, _)| &level.decomposition.patches)
        .map(|patch| patch.extreme.len())
        .chain(free[1..].iter().flatten().map(|cluster| cluster.extreme.len()))
        .sum();
    let corners: usize = regular.iter().map(|(level, _)| 3 * level.mesh.triangles().len()).sum();
    if hull_vertices + corners >= u32::MAX as usize {
        return Err(BuildError::TooLarge { hull_vertices });
    }
    let source = source_of(mesh, solid, options.tolerance, (center, radius));
    let mut parts = assemble(&regular, &free, source, tolerance);
    if !simplified.is_empty() {
        bound_descendants(&mut parts, options.bounding_points, surface.scale)
            .map_err(|hull_vertices| BuildError::TooLarge { hull_vertices })?;
    }
    let clod = Clod::pack(&parts).map_err(|error| BuildError::Invalid { what: error.to_string() })?;
    progress.end()?;
    Ok(clod)
}

impl BuildOptions {
    fn check(&self) -> Result<(), BuildError> {
        for (option, value, range, wanted) in [
            ("tolerance", self.tolerance, 0.0..=0.1, "between 0 and 0.1 of the bounding radius"),
            ("support_radius", self.support_radius, 1e-9..=1e9, "between 1e-9 and 1e9 bounding radii"),
            ("support_distance", self.support_distance, 1e-9..=1e9, "between 1e-9 and 1e9 bounding radii"),
            ("coarsest", self.coarsest, 0.0..=1e9, "between 0 and 1e9 over the bounding radius"),
            ("support_cone", self.support_cone, 0.0..=FRAC_PI_2, "between 0 and π/2 rad"),
        ] {
            if !range.contains(&value) {
                return Err(BuildError::Option { option, value, wanted });
            }
        }
        Ok(())
    }
}

/// Returns the bounding sphere of a mesh; refuses a mesh that has no surface to build from.
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
    if !(1.0 / MAX_LENGTH..=MAX_LENGTH).contains(&sphere.radius)
        || sphere.center.abs().max_element() > MAX_LENGTH
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

fn source_of(mesh: &TriMesh, solid: bool, tolerance: f64, (center, radius): (DVec3, f64)) -> Source {
    let mass = if solid { mesh.mass_properties(1.0).ok() } else { None };
    let (volume, center_of_mass, unit_inertia) = match mass {
        Some(m) => (m.volume, m.center_of_mass, m.inertia * (1.0 / m.mass)),
        None => (0.0, center, DMat3::from_diagonal(DVec3::splat(0.4 * radius * radius))),
    };
    Source {
        vertices: mesh.vertices().len() as u32,
        triangles: mesh.triangles().len() as u32,
        tolerance,
        solid: mass.is_some(),
        bounding_radius: radius,
        center,
        volume,
        center_of_mass,
        unit_inertia,
    }
}
