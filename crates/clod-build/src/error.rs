//! Errors of a build. Each message says what is wrong, where, and what to do.

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
        /// Number of its vertices.
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
        /// Its position, m.
        position: DVec3,
    },
    /// The mesh is a single point, or too small, large or far away for arithmetic.
    #[error(
        "the {triangles} triangles are bounded by a sphere of radius {radius} m, {distance} m from the origin, where lengths \
         have to be between 1e-50 and 1e50 m: check the mesh's units and the scale it was loaded with"
    )]
    Extent {
        /// Number of triangles.
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
        /// Number of triangles.
        triangles: usize,
    },
    /// A triangle names a vertex twice or has no area: its height over its longest side is below 10⁻¹²
    /// bounding radii.
    #[error(
        "triangle {triangle} at {} m has no area (the first of {count}): repair the mesh to remove such triangles",
        place(*position)
    )]
    Degenerate {
        /// Number of such triangles.
        count: usize,
        /// Index of the first.
        triangle: u32,
        /// Its centre, m.
        position: DVec3,
    },
    /// A triangle has the same three positions as an earlier one.
    #[error(
        "triangle {triangle} at {} m repeats an earlier one (the first of {count}): repair the mesh to drop such triangles",
        place(*position)
    )]
    Duplicate {
        /// Number of such triangles.
        count: usize,
        /// Index of the first.
        triangle: u32,
        /// Its centre, m.
        position: DVec3,
    },
    /// Three or more triangles meet at an edge.
    #[error(
        "more than two triangles meet at the edge between vertices {} and {} of triangle {} at {} m (the first of {count}): \
         repair the mesh to separate the sheets that meet there",
        edge.vertices[0], edge.vertices[1], edge.triangle, place(*position)
    )]
    NonManifoldEdge {
        /// Number of such edges.
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
        /// Number of such edges.
        count: usize,
        /// The first.
        edge: OffendingEdge,
        /// Its middle, m.
        position: DVec3,
    },
    /// The triangles around a vertex are not one fan.
    #[error(
        "sheets of triangles meet only at vertex {vertex} at {} m (the first of {count}): repair the mesh to separate them",
        place(*position)
    )]
    NonManifoldVertex {
        /// Number of fans beyond the first of each vertex.
        count: usize,
        /// The first such vertex.
        vertex: u32,
        /// Its position, m.
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
        /// Number of triangles that intersect another.
        count: usize,
        /// The first pair, in lexicographic order.
        triangles: [u32; 2],
        /// The middle of the overlap of their bounding boxes, m.
        position: DVec3,
    },
    /// The hierarchy would need more hull vertices than 32-bit indices can name.
    #[error(
        "the hierarchy needs {hull_vertices} hull vertices, more than 32-bit indices can name: simplify the mesh, or build its parts as separate objects"
    )]
    TooLarge {
        /// Number of hull vertices that it needs.
        hull_vertices: usize,
    },
    /// The hierarchy built breaks an invariant: a fault of the builder.
    #[error(
        "the hierarchy that was built is not valid, which is a fault of the builder, not of the mesh: {what}"
    )]
    Invalid {
        /// The invariant broken.
        what: String,
    },
    /// The progress callback cancelled the build.
    #[error("the build was cancelled")]
    Cancelled,
    /// An option is out of range.
    #[error("the build option `{option}` is {value}, but has to be {wanted}")]
    Option {
        /// Its name.
        option: &'static str,
        /// Its value.
        value: f64,
        /// Its permitted range, in words.
        wanted: &'static str,
    },
}

impl BuildError {
    /// Whether repairing the mesh removes the reason for this error.
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

/// A position (m) in words, for an error message.
fn place(position: DVec3) -> String {
    let [x, y, z] = position.to_array().map(|x| {
        let plain = x == 0.0 || (1e-3..1e6).contains(&x.abs());
        if plain { format!("{x:.6}") } else { format!("{x:.5e}") }
    });
    format!("({x}, {y}, {z})")
}
