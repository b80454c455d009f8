//! Smooth edges of a coarse mesh: those at which the displaced surfaces of two triangles meet.

use glam::DVec3;
use palpate_core::TriMesh;
use palpate_core::mesh::{EdgeKind, HalfEdge};

use super::sheet::Sheet;

/// Largest difference between directions at a corner that count as equal.
const DIRECTION_TOLERANCE: f64 = 1e-9;

/// Maximum number of triangles that are crossed to a place. After that the surface is assumed to continue.
const MAX_CROSSED: usize = 16;

/// Largest distance outside of a triangle of a place that counts as inside, as a part of a side's length.
const EDGE_TOLERANCE: f64 = 1e-9;

/// An edge as a side of a triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    pub triangle: usize,
    /// Corners of the triangle at the edge's first and second end.
    pub ends: [usize; 2],
}

impl Side {
    fn new(side: HalfEdge, reversed: bool) -> Self {
        let from = side.side() as usize;
        let to = (from + 1) % 3;
        Self { triangle: side.triangle() as usize, ends: if reversed { [to, from] } else { [from, to] } }
    }

    /// Returns the weights of the second and the third corner at a fraction of the edge's length.
    pub fn along(&self, share: f64) -> [f64; 2] {
        let mut weights = [0.0; 3];
        weights[self.ends[0]] = 1.0 - share;
        weights[self.ends[1]] = share;
        [weights[1], weights[2]]
    }

    /// Returns the corner opposite the edge.
    fn third(&self) -> usize {
        3 - self.ends[0] - self.ends[1]
    }
}

/// Edges between two triangles with area whose directions of displacement agree there.
pub(super) struct SmoothEdges {
    /// Smooth edges, each with its two sides.
    pub edges: Vec<[Side; 2]>,
    /// Edge opposite each corner of each triangle: the triangle's side, and the neighbour's.
    across: Vec<[Option<[Side; 2]>; 3]>,
}

impl SmoothEdges {
    pub fn new(coarse: &TriMesh, sheets: &[Sheet]) -> Self {
        let adjacency = coarse.adjacency();
        let edges: Vec<[Side; 2]> = (0..adjacency.edges().len() as u32)
            .filter(|edge| adjacency.edge_kind(*edge) == EdgeKind::Manifold)
            .filter_map(|edge| match *adjacency.edge_sides(edge) {
                [here, there] => Some([Side::new(here, false), Side::new(there, true)]),
                _ => None,
            })
            .filter(|sides| is_smooth(sheets, sides))
            .collect();
        let mut across = vec![[None; 3]; sheets.len()];
        for &[here, there] in &edges {
            across[here.triangle][here.third()] = Some([here, there]);
            across[there.triangle][there.third()] = Some([there, here]);
        }
        Self { edges, across }
    }

    /// Returns whether a place on a triangle's continued plane is on the coarse surface after neighbours
    /// across smooth edges are unfolded into that plane. It is not if a sharp edge or the mesh's border comes
    /// first.
    pub fn reach(&self, sheets: &[Sheet], triangle: usize, at: [f64; 2]) -> bool {
        let (mut here, mut at) = (triangle, at);
        for _ in 0..MAX_CROSSED {
            let sheet = &sheets[here];
            let distances = sheet.distances(at);
            let farthest = (1..3).fold(0, |least, k| if distances[k] < distances[least] { k } else { least });
            let slack = EDGE_TOLERANCE * sheet.corners[farthest].distance(sheet.corners[(farthest + 1) % 3]);
            if distances[farthest] >= -slack {
                return true;
            }
            let Some([from, to]) = self.across[here][farthest] else { return false };
            // Unfold: the same foot on the edge, and the same distance from it, in the next triangle's plane.
            let next = &sheets[to.triangle];
            let [a, b] = from.ends.map(|corner| sheet.corners[corner]);
            let edge = (b - a).normalize_or_zero();
            let inwards = (next.corners[to.third()] - a).reject_from(edge).normalize_or_zero();
            let foot = a + edge * (sheet.base(at) - a).dot(edge);
            at = next.weights(foot - distances[farthest] * inwards);
            here = to.triangle;
        }
        true
    }
}

/// Returns whether both triangles at an edge have an area and equal directions at its ends.
fn is_smooth(sheets: &[Sheet], sides: &[Side; 2]) -> bool {
    let has_area = sides.iter().all(|side| sheets[side.triangle].has_area());
    let same = |end: usize| {
        let [p, q]: [DVec3; 2] = sides.map(|side| sheets[side.triangle].directions[side.ends[end]]);
        p.distance(q) <= DIRECTION_TOLERANCE
    };
    has_area && same(0) && same(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::sheet::sheets;

    /// Three unit squares in a row, as triangles: the second is coplanar with the first, the third turns
    /// down.
    fn step() -> TriMesh {
        let line = [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X, DVec3::new(2.0, 0.0, -1.0)];
        let vertices = line.into_iter().flat_map(|p| [p, p + DVec3::Y]).collect();
        let squares = (0..3).flat_map(|i| [[2 * i, 2 * i + 2, 2 * i + 3], [2 * i, 2 * i + 3, 2 * i + 1]]);
        TriMesh::new(vertices, squares.collect()).unwrap()
    }

    #[test]
    fn places_past_a_sharp_edge_or_the_border_are_off_the_surface() {
        let mesh = step();
        let sheets = sheets(&mesh, 0.5);
        let smooth = SmoothEdges::new(&mesh, &sheets);
        assert_eq!(smooth.edges.len(), 4);
        let reach = |x: f64, y: f64| smooth.reach(&sheets, 0, sheets[0].weights(DVec3::new(x, y, 0.0)));
        assert!(reach(0.9, 0.5) && reach(0.1, 0.9) && reach(1.9, 0.9) && reach(1.1, 0.2));
        assert!(!reach(2.1, 0.5) && !reach(0.5, -0.1) && !reach(-0.1, 0.5) && !reach(1.5, 1.1));
        let smooth = SmoothEdges::new(&mesh, &super::super::sheet::sheets(&mesh, 2.0));
        assert_eq!(smooth.edges.len(), 5);
        assert!(smooth.reach(&sheets, 0, sheets[0].weights(DVec3::new(2.1, 0.5, 0.0))));
    }
}
