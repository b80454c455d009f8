//! The surface of a level as one mesh, and colours that tell its patches apart.
//!
//! Nodes share no vertices, so the patches are sewn together at vertices that coincide exactly. Colours are given
//! greedily, to the patch with most neighbours first, such that neighbours differ; a patch keeps the colour of its
//! largest child where that is free, so that patches can be followed from level to level.

use std::collections::HashMap;

use palpate::TriMesh;
use palpate::core::Clod;
use palpate::core::clod::Node;

/// The surface of a level that is not free.
pub(crate) struct Surface {
    pub mesh: TriMesh,
    /// The patch of each triangle, counted within the level.
    pub owners: Vec<u32>,
    /// Whether the edge opposite each corner of a triangle is on its patch's boundary.
    pub boundary: Vec<[bool; 3]>,
    /// Pairs of patches that share an edge, the lower number first, in order.
    pub neighbours: Vec<(u32, u32)>,
}

impl Surface {
    /// The surface of level `level`; empty for a free level.
    pub fn of(clod: &Clod, level: usize) -> Self {
        let mut known: HashMap<[u64; 3], u32> = HashMap::new();
        let mut vertices = Vec::new();
        let mut triangles = Vec::new();
        let mut owners = Vec::new();
        for (owner, node) in (0..).zip(clod.level(level)) {
            let hull = clod.hull(&node);
            for triangle in clod.patch(node) {
                triangles.push(triangle.map(|corner| {
                    let point = hull[corner as usize];
                    // Both zeros are one number with two patterns of bits.
                    let key = point.to_array().map(|coordinate| (coordinate + 0.0).to_bits());
                    *known.entry(key).or_insert_with(|| {
                        vertices.push(point);
                        vertices.len() as u32 - 1
                    })
                }));
                owners.push(owner);
            }
        }
        let sides = sides(&triangles);
        let mut boundary = vec![[false; 3]; triangles.len()];
        let mut neighbours = Vec::new();
        for edge in sides.chunk_by(|a, b| a.edge == b.edge) {
            let owner = |side: &Side| owners[side.triangle as usize];
            let inner = edge.len() == 2 && owner(&edge[0]) == owner(&edge[1]);
            for side in edge {
                boundary[side.triangle as usize][side.corner as usize] = !inner;
            }
            for pair in edge.windows(2) {
                let (a, b) = (owner(&pair[0]), owner(&pair[1]));
                if a != b {
                    neighbours.push((a.min(b), a.max(b)));
                }
            }
        }
        neighbours.sort_unstable();
        neighbours.dedup();
        // Indices are in range as they come from a hierarchy; one too large for a mesh is drawn as nothing.
        let mesh = TriMesh::new(vertices, triangles).unwrap_or_default();
        Self { mesh, owners, boundary, neighbours }
    }
}

/// One side of a triangle.
#[derive(Clone, Copy)]
pub(crate) struct Side {
    /// Its vertices, the lower number first.
    pub edge: (u32, u32),
    pub triangle: u32,
    /// The corner opposite it.
    pub corner: u8,
}

/// All sides of triangles, those of one edge together.
pub(crate) fn sides(triangles: &[[u32; 3]]) -> Vec<Side> {
    let mut sides: Vec<Side> = (0..)
        .zip(triangles)
        .flat_map(|(triangle, corners)| {
            [0_u8, 1, 2].map(|corner| {
                let (a, b) = (corners[(usize::from(corner) + 1) % 3], corners[(usize::from(corner) + 2) % 3]);
                Side { edge: (a.min(b), a.max(b)), triangle, corner }
            })
        })
        .collect();
    sides.sort_unstable_by_key(|side| (side.edge, side.triangle, side.corner));
    sides
}

/// Colours that tell neighbours apart, sRGB.
const PALETTE: [u32; 12] = [
    0x4e79a7, 0xf28e2b, 0xd94f54, 0x6fb5b0, 0x59a14f, 0xecc846, 0xa86fa0, 0xf39aa6, 0x93684f, 0x9fd67f,
    0x8fc7ea, 0x6a5fc0,
];

/// Linear RGB of a colour's number.
pub(crate) fn color(number: u8) -> [f32; 3] {
    let packed = PALETTE[usize::from(number) % PALETTE.len()];
    [16, 8, 0].map(|shift| {
        let encoded = (packed >> shift & 0xff) as f32 / 255.0;
        if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
    })
}

/// A colour's number for every node of the hierarchy.
pub(crate) fn colors(clod: &Clod) -> Vec<u8> {
    let mut colors = vec![0; clod.nodes().len()];
    let mut neighbours: Vec<(u32, u32)> = Vec::new();
    for (index, level) in clod.levels.iter().enumerate() {
        // Hulls of a free level are neighbours where any of their children are.
        neighbours = if level.free {
            let finer = clod.levels[index.saturating_sub(1)].nodes.start;
            let parent = |child: u32| clod.node(finer + child).parent.wrapping_sub(level.nodes.start);
            let mut merged: Vec<(u32, u32)> = neighbours
                .iter()
                .map(|(a, b)| (parent(*a), parent(*b)))
                .filter(|(a, b)| a != b)
                .map(|(a, b)| (a.min(b), a.max(b)))
                .collect();
            merged.sort_unstable();
            merged.dedup();
            merged
        } else {
            Surface::of(clod, index).neighbours
        };
        let inherited: Vec<Option<u8>> = clod
            .level(index)
            .iter()
            .map(|node| {
                let size = |child: &Node| (child.triangles.len(), child.vertices.len());
                // Of equals the first, as max_by takes the last.
                let largest = (node.children.start..node.children.end)
                    .rev()
                    .max_by_key(|child| size(&clod.node(*child)));
                largest.map(|child| colors[child as usize])
            })
            .collect();
        let start = level.nodes.start as usize;
        colors[start..start + inherited.len()].copy_from_slice(&distinct(&inherited, &neighbours));
    }
    colors
}

/// A colour for each of some patches, the wanted one where neighbours leave it; `pairs` of neighbours in order.
fn distinct(wanted: &[Option<u8>], pairs: &[(u32, u32)]) -> Vec<u8> {
    let mut around: Vec<Vec<u32>> = vec![Vec::new(); wanted.len()];
    for (a, b) in pairs {
        around[*a as usize].push(*b);
        around[*b as usize].push(*a);
    }
    let mut order: Vec<u32> = (0..wanted.len() as u32).collect();
    order.sort_by_key(|patch| std::cmp::Reverse(around[*patch as usize].len()));
    let mut colors: Vec<Option<u8>> = vec![None; wanted.len()];
    for patch in order {
        // How often each colour is seen next to the patch, which weighs most, and one further.
        let mut seen = [0_usize; PALETTE.len()];
        for neighbour in &around[patch as usize] {
            if let Some(color) = colors[*neighbour as usize] {
                seen[usize::from(color)] += 1 << 32;
            }
            for second in &around[*neighbour as usize] {
                if let Some(color) = colors[*second as usize] {
                    seen[usize::from(color)] += 1;
                }
            }
        }
        let wanted = wanted[patch as usize].filter(|color| seen[usize::from(*color)] < 1 << 32);
        // Where colours are equally rare, each patch begins with another.
        let first = (patch.wrapping_mul(0x9e37_79b9) >> 16) as usize;
        let rarest = (0..PALETTE.len())
            .map(|k| (first + k) % PALETTE.len())
            .min_by_key(|color| seen[*color])
            .map(|color| color as u8);
        colors[patch as usize] = wanted.or(rarest);
    }
    colors.into_iter().map(Option::unwrap_or_default).collect()
}

#[cfg(test)]
mod tests {
    use palpate::clod_build::{BuildOptions, build, unwatched};
    use palpate::models::Model;

    use super::*;

    #[test]
    fn neighbouring_patches_differ_and_the_surface_is_sewn_up() {
        let mesh = Model::Torus.generate(2_000).expect("torus");
        let options = BuildOptions::default();
        let clod = build(&mesh, &options, &mut unwatched).expect("hierarchy");
        let colors = colors(&clod);
        for (index, level) in clod.levels.iter().enumerate().filter(|(_, level)| !level.free) {
            let surface = Surface::of(&clod, index);
            assert_eq!(surface.mesh.triangles().len(), level.triangles as usize);
            let report = surface.mesh.validate();
            assert!(report.closed && report.manifold && report.oriented, "level {index} is sewn up");
            assert!(!surface.neighbours.is_empty());
            for (a, b) in surface.neighbours {
                let [a, b] = [a, b].map(|patch| colors[(level.nodes.start + patch) as usize]);
                assert_ne!(a, b, "level {index}");
            }
            // An edge is on a boundary in both its triangles or in neither.
            let lined = surface.boundary.iter().flatten().filter(|lined| **lined).count();
            assert!(lined > 0 && lined.is_multiple_of(2));
        }
    }

    #[test]
    fn a_patch_keeps_the_colour_that_it_wants_where_it_is_free() {
        assert_eq!(distinct(&[Some(3), None, Some(5)], &[(0, 1), (1, 2)])[2], 5);
        let both = distinct(&[Some(3), Some(3)], &[(0, 1)]);
        assert!(both.contains(&3) && both[0] != both[1], "{both:?}");
        assert!(distinct(&[], &[]).is_empty());
    }

    #[test]
    fn more_mutual_neighbours_than_colours_still_have_one_each() {
        let count = PALETTE.len() as u32 + 3;
        let pairs: Vec<(u32, u32)> = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b))).collect();
        let colors = distinct(&vec![None; count as usize], &pairs);
        let used: std::collections::HashSet<u8> = colors.into_iter().collect();
        assert_eq!(used.len(), PALETTE.len());
    }
}
