//! Marching tetrahedra: a first triangulation of an implicit surface.
//!
//! Space is cut into cubes and each cube into six tetrahedra around a diagonal (Kuhn's subdivision, the same
//! in every cube, so that faces match). A tetrahedron whose corners differ in sign contributes one or two
//! triangles. Unlike marching cubes there is no ambiguous case, hence the result is always a closed
//! 2-manifold without self-intersections. Its triangles are badly shaped; [`crate::remesh`] is to follow.

use std::collections::HashMap;

use palpate_core::{TriMesh, glam::DVec3};

use crate::surface::Surface;

/// Number of cubes along a block's side. A block that the surface cannot reach is skipped after one
/// evaluation at its centre.
const BLOCK: i64 = 8;

/// Kuhn's six tetrahedra as corners of the cube (bit 0 of a corner is x, bit 1 y, bit 2 z), positively
/// oriented.
const KUHN: [[usize; 4]; 6] =
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];

/// Triangulates the surface on cubes of side `cell`.
pub(crate) fn extract<S: Surface>(surface: &S, cell: f64) -> TriMesh {
    let (low, high) = surface.bounds();
    // Off the round numbers that models are built from: a node right on the surface is not wrong, but makes
    // for poor triangles.
    let origin = low - DVec3::new(1.37, 1.41, 1.43) * cell;
    let cubes = ((high - origin) / cell).ceil() + DVec3::splat(2.0);
    let blocks = (cubes / BLOCK as f64).ceil().as_i64vec3();
    let mut march = March { cell, origin, nodes: blocks * BLOCK + 1, ..March::default() };
    let reach = S::STEEPNESS * 0.5 * 3f64.sqrt() * BLOCK as f64 * cell;
    for z in 0..blocks.z {
        for y in 0..blocks.y {
            for x in 0..blocks.x {
                let corner = [x * BLOCK, y * BLOCK, z * BLOCK];
                let center = march.position(corner) + DVec3::splat(0.5 * BLOCK as f64 * cell);
                if surface.value(center).abs() <= reach {
                    march.block(surface, corner);
                }
            }
        }
    }
    TriMesh::new(march.vertices, march.triangles).expect("every index is that of a vertex")
}

#[derive(Default)]
struct March {
    cell: f64,
    origin: DVec3,
    nodes: palpate_core::glam::I64Vec3,
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// Vertex on the grid edge (lower node, direction): looked up only, never iterated, so the order is
    /// fixed.
    on_edge: HashMap<(i64, usize), u32>,
}

impl March {
    fn position(&self, node: [i64; 3]) -> DVec3 {
        self.origin + self.cell * DVec3::new(node[0] as f64, node[1] as f64, node[2] as f64)
    }

    fn node(&self, [x, y, z]: [i64; 3]) -> i64 {
        (z * self.nodes.y + y) * self.nodes.x + x
    }

    fn block<S: Surface>(&mut self, surface: &S, corner: [i64; 3]) {
        let side = BLOCK as usize + 1;
        let mut values = vec![0.0; side * side * side];
        let at = |i: usize, j: usize, k: usize| (k * side + j) * side + i;
        let global =
            |i: usize, j: usize, k: usize| [corner[0] + i as i64, corner[1] + j as i64, corner[2] + k as i64];
        for k in 0..side {
            for j in 0..side {
                for i in 0..side {
                    values[at(i, j, k)] = surface.value(self.position(global(i, j, k)));
                }
            }
        }
        for k in 0..side - 1 {
            for j in 0..side - 1 {
                for i in 0..side - 1 {
                    let cube: [f64; 8] =
                        std::array::from_fn(|c| values[at(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2))]);
                    let inside = cube.iter().filter(|v| **v < 0.0).count();
                    if inside != 0 && inside != 8 {
                        self.cube(&cube, global(i, j, k));
                    }
                }
            }
        }
    }

    fn cube(&mut self, values: &[f64; 8], base: [i64; 3]) {
        for tetrahedron in KUHN {
            let mut inside = [0; 4];
            let mut outside = [0; 4];
            let (mut n_in, mut n_out) = (0, 0);
            let mut swaps = 0;
            for (position, corner) in tetrahedron.into_iter().enumerate() {
                if values[corner] < 0.0 {
                    // Parity of the permutation (inside corners first) decides the orientation.
                    swaps += position - n_in;
                    inside[n_in] = corner;
                    n_in += 1;
                } else {
                    outside[n_out] = corner;
                    n_out += 1;
                }
            }
            let mut cut = |a: usize, b: usize| self.cut(values, base, a, b);
            let mut quad = [0; 4];
            let corners = match n_in {
                1 => {
                    (0..3).for_each(|i| quad[i] = cut(inside[0], outside[i]));
                    3
                }
                3 => {
                    (0..3).for_each(|i| quad[i] = cut(inside[i], outside[0]));
                    3
                }
                2 => {
                    let pairs = [(0, 0), (0, 1), (1, 1), (1, 0)];
                    (0..4).for_each(|i| quad[i] = cut(inside[pairs[i].0], outside[pairs[i].1]));
                    4
                }
                _ => continue,
            };
            if swaps % 2 == 1 {
                quad[..corners].reverse();
            }
            self.triangles.push([quad[0], quad[1], quad[2]]);
            if corners == 4 {
                self.triangles.push([quad[0], quad[2], quad[3]]);
            }
        }
    }

    /// The vertex where the surface crosses the edge between two corners of a cube.
    fn cut(&mut self, values: &[f64; 8], base: [i64; 3], a: usize, b: usize) -> u32 {
        // The corners of a Kuhn tetrahedron are nested: the greater of two holds the lesser's bits.
        let (a, b) = (a.min(b), a.max(b));
        let corner =
            |c: usize| [base[0] + (c & 1) as i64, base[1] + (c >> 1 & 1) as i64, base[2] + (c >> 2) as i64];
        let (low, high) = (corner(a), corner(b));
        let key = (self.node(low), a ^ b);
        if let Some(&vertex) = self.on_edge.get(&key) {
            return vertex;
        }
        // Away from the ends, so that no triangle is degenerate.
        let t = (values[a] / (values[a] - values[b])).clamp(0.1, 0.9);
        let vertex = self.vertices.len() as u32;
        let position = self.position(low).lerp(self.position(high), t);
        self.vertices.push(position);
        self.on_edge.insert(key, vertex);
        vertex
    }
}
