//! From a mesh to its hierarchy: the order of the steps, what can be asked of them and why they may refuse.

use std::f64::consts::FRAC_PI_2;
use std::ops::ControlFlow;

use glam::{DMat3, DVec3};
use palpate_core::clod::Source;
use palpate_core::mesh::OffendingEdge;
use palpate_core::{Clod, TriMesh};

use crate::bounding::bound_descendants;
use crate::decomposition::decompose;
use crate::hierarchy::merge_to_root;
use crate::levels::{Regular, assemble};
use crate::parameters::{finest_resolution, support_areas};
use crate::progress::{Progress, Stage};
use crate::requirements::{check_intersections, check_surface};
use crate::simplify::{Limits, simplify};
use crate::surface::Surface;

/// Edges shorter than this fraction of the bounding radius join copies of a vertex.
const NEGLIGIBLE: f64 = 1e-9;

/// Lengths (m) from the reciprocal of this to this are accepted: their fifth powers, which inertia needs, are far within the
/// range of f64.
const LARGEST_LENGTH: f64 = 1e50;

/// Counts the changes after which the same mesh and options give another hierarchy: whoever keeps built hierarchies can
/// tell by it that one is out of date.
pub const REVISION: u32 = 3;

/// What can be chosen about a build.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildOptions {
    /// How far a patch's surface may lie inside its own hull, and how deep other surface may reach into it, before the
    /// patch counts as not convex (§3.3.1). A fraction of the bounding radius.
    pub tolerance: f64,
    /// Distance tolerance of support areas (§3.3.5) along a vertex normal: a fraction of the bounding radius.
    pub support_distance: f64,
    /// Whether to make levels of detail by simplification (§3.3.3) before patches are merged freely. Without, every level but
    /// the full mesh's is free.
    pub simplify: bool,
    /// Where simplification ends: at the resolution (Eq. 3.1) that is this over the bounding radius.
    pub coarsest: f64,
    /// Whether patches are carried through the collapses, as in the dissertation; else each level's are made anew.
    pub carried: bool,
    /// How many points of its descendants a hull may be given at most to bound them better (§3.6.2): with 0 it is that of its
    /// patch, as in the dissertation; with [`u32::MAX`] every hull contains its descendants.
    pub bounding_points: u32,
    /// Half angle of the normal cone of support areas (§3.3.5), rad.
    pub support_cone: f64,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            tolerance: 1e-6,
            support_distance: 0.025,
            support_cone: std::f64::consts::FRAC_PI_3,
            simplify: true,
            coarsest: 4.0,
            carried: true,
            bounding_points: 16,
        }
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
    /// A triangle names a vertex twice or has no area: its height over its longest side is below 10⁻¹² bounding radii.
    #[error(
        "triangle {triangle} at {} m has no area (the first of {count}): run with --repair to take such triangles out",
        place(*position)
    )]
    Degenerate {
        /// How many.
        count: usize,
        /// Index of the first.
        triangle: u32,
        /// Its centre, m.
        position: DVec3,
    },
    /// A triangle lies on an earlier one.
    #[error(
        "triangle {triangle} at {} m repeats an earlier one (the first of {count}): run with --repair to drop such triangles",
        place(*position)
    )]
    Duplicate {
        /// How many.
        count: usize,
        /// Index of the first.
        triangle: u32,
        /// Its centre, m.
        position: DVec3,
    },
    /// Three or more triangles meet at an edge.
    #[error(
        "more than two triangles meet at the edge between vertices {} and {} of triangle {} at {} m (the first of {count}): \
         run with --repair to part the sheets that meet there",
        edge.vertices[0], edge.vertices[1], edge.triangle, place(*position)
    )]
    NonManifoldEdge {
        /// How many edges.
        count: usize,
        /// The first.
        edge: OffendingEdge,
        /// Its middle, m.
        position: DVec3,
    },
    /// Two triangles that share an edge face opposite sides.
    #[error(
        "triangle {} and its neighbour at the edge between vertices {} and {} at {} m disagree on which side is outside (the \
         first of {count}): run with --repair to turn such triangles",
        edge.triangle, edge.vertices[0], edge.vertices[1], place(*position)
    )]
    Misoriented {
        /// At how many edges.
        count: usize,
        /// The first.
        edge: OffendingEdge,
        /// Its middle, m.
        position: DVec3,
    },
    /// The triangles around a vertex are not one fan.
    #[error(
        "sheets of triangles meet at nothing but vertex {vertex} at {} m (the first of {count}): run with --repair to part them",
        place(*position)
    )]
    NonManifoldVertex {
        /// How many fans there are beyond the first of each vertex.
        count: usize,
        /// The first such vertex.
        vertex: u32,
        /// Where it is, m.
        position: DVec3,
    },
    /// A closed surface encloses a negative volume.
    #[error(
        "the triangles face inwards, so that the mesh encloses {volume:.6e} m³: run with --repair to turn them all"
    )]
    InsideOut {
        /// The signed volume, m³.
        volume: f64,
    },
    /// Two triangles have more points in common than the vertices and edges that they share.
    #[error(
        "triangles {} and {} intersect near {} m (the first of {count} triangles that do): run with --repair to cut them out",
        triangles[0], triangles[1], place(*position)
    )]
    SelfIntersecting {
        /// How many triangles intersect another.
        count: usize,
        /// The first pair, in lexicographic order.
        triangles: [u32; 2],
        /// The middle of what their bounding boxes have in common, m.
        position: DVec3,
    },
    /// The hierarchy would need more hull vertices than 32-bit indices can name.
    #[error(
        "the hierarchy needs {hull_vertices} hull vertices, more than 32-bit indices can name: simplify the mesh, or build its parts as separate objects"
    )]
    TooLarge {
        /// How many it needs.
        hull_vertices: usize,
    },
    /// The progress callback asked for an end.
    #[error("the build was cancelled")]
    Cancelled,
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

/// A position (m) as a message gives it.
fn place(position: DVec3) -> String {
    let [x, y, z] = position.to_array().map(|x| {
        let plain = x == 0.0 || (1e-3..1e6).contains(&x.abs());
        if plain { format!("{x:.6}") } else { format!("{x:.5e}") }
    });
    format!("({x}, {y}, {z})")
}

/// Builds the hierarchy of contact levels of detail of a mesh.
///
/// The mesh has to be an oriented 2-manifold, with or without boundary, of triangles with an area, that does not intersect
/// itself (decided exactly; surfaces may touch at vertices and edges that they have in common or that coincide) and, if it is closed, does not
/// enclose a negative volume. `palpate_mesh_io::repair` makes such a mesh of any other. Where there is a boundary,
/// inside and outside are not defined: no hull can then be verified to lie inside the object,
/// [`Node::contained`](palpate_core::clod::Node::contained) is false and so is
/// [`Source::solid`](palpate_core::clod::Source::solid).
///
/// `progress` is called from the calling thread with the fraction of the stage that is done, at most some 25 times a second
/// besides the beginning and end of each stage; when it breaks, the build ends with [`BuildError::Cancelled`].
///
/// # Errors
/// If it is cancelled, the mesh is none of the above, has no triangles, no extent or a vertex that is not finite, or an
/// option is out of range.
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

    let areas = support_areas(mesh, &adjacency, options.support_distance * radius, options.support_cone);
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
    let finest = finest_resolution(mesh, &adjacency, NEGLIGIBLE * radius);
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
    let source = source_of(mesh, solid, center, radius);
    let mut clod = assemble(&regular, &free, source, tolerance);
    if !simplified.is_empty() {
        bound_descendants(&mut clod, options.bounding_points, surface.scale)
            .map_err(|hull_vertices| BuildError::TooLarge { hull_vertices })?;
    }
    progress.end()?;
    Ok(clod)
}

impl BuildOptions {
    fn check(&self) -> Result<(), BuildError> {
        for (option, value, range, wanted) in [
            ("tolerance", self.tolerance, 0.0..=0.1, "between 0 and 0.1 of the bounding radius"),
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
