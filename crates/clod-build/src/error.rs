//! Why a hierarchy could not be built: what is wrong, where, and what to do.

use glam::DVec3;
use palpate_core::mesh::OffendingEdge;

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
        "triangle {triangle} uses vertex {vertex} at {position}, which is not finite: repair the mesh to drop such triangles"
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
        "triangle {triangle} at {} m has no area (the first of {count}): repair the mesh to take such triangles out",
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
        "triangle {triangle} at {} m repeats an earlier one (the first of {count}): repair the mesh to drop such triangles",
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
         repair the mesh to part the sheets that meet there",
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
         first of {count}): repair the mesh to turn such triangles",
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
        "sheets of triangles meet at nothing but vertex {vertex} at {} m (the first of {count}): repair the mesh to part them",
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
        "the triangles face inwards, so that the mesh encloses {volume:.6e} m³: repair the mesh to turn them all"
    )]
    InsideOut {
        /// The signed volume, m³.
        volume: f64,
    },
    /// Two triangles have more points in common than the vertices and edges that they share.
    #[error(
        "triangles {} and {} intersect near {} m (the first of {count} triangles that do): repair the mesh to cut them out",
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
    /// What was built breaks an invariant of hierarchies: a fault of the builder.
    #[error(
        "the hierarchy that was built is not valid, which is a fault of the builder, not of the mesh: {what}"
    )]
    Invalid {
        /// What is wrong with it.
        what: String,
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

impl BuildError {
    /// Whether a repaired mesh would not be refused for this.
    pub fn is_mended_by_repair(&self) -> bool {
        match self {
            Self::NonFinite { .. }
            | Self::Degenerate { .. }
            | Self::Duplicate { .. }
            | Self::NonManifoldEdge { .. }
            | Self::Misoriented { .. }
            | Self::NonManifoldVertex { .. }
            | Self::InsideOut { .. }
            | Self::SelfIntersecting { .. } => true,
            Self::Empty { .. }
            | Self::Extent { .. }
            | Self::NoSurface { .. }
            | Self::TooLarge { .. }
            | Self::Invalid { .. }
            | Self::Cancelled
            | Self::Option { .. } => false,
        }
    }
}

/// A position (m) as a message gives it.
fn place(position: DVec3) -> String {
    let [x, y, z] = position.to_array().map(|x| {
        let plain = x == 0.0 || (1e-3..1e6).contains(&x.abs());
        if plain { format!("{x:.6}") } else { format!("{x:.5e}") }
    });
    format!("({x}, {y}, {z})")
}
