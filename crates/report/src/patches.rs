//! The surface of a level as one mesh, and a colouring of its patches.
//!
//! Nodes share no vertices, so patches are joined at vertices that coincide exactly. Colours are assigned
//! greedily, in order of decreasing number of neighbours, so that neighbours differ. A patch keeps the colour
//! of its largest child if that is free, so that patches can be followed from level to level.

use std::collections::HashMap;

use palpate::TriMesh;
use palpate::core::Clod;
use palpate::core::clod::Node;

/// Surface of a level that is not free.
pub(crate) struct Surface {
    pub mesh: TriMesh,
    /// Patch of each triangle, numbered within the level.
    pub owners: Vec<u32>,
    /// Whether the edge opposite each corner of a triangle is on its patch's boundary.
    pub boundary: Vec<[bool; 3]>,
    /// Pairs of patches that share an edge, the lower number first, in order.
    pub neighbours: Vec<(u32, u32)>,
}

impl Surface {
    /// Returns the surface of level `level`; empty for a free level.
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
                    // Adding 0 turns −0 into 0, so both have the same bits.
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
        // Indices come from a hierarchy, so they are in range; if it is too large for a mesh, nothing is
        // drawn.
        let mesh = TriMesh::new(vertices, triangles).unwrap_or_default();
        Self { mesh, owners, boundary, neighbours }
    }
}

/// A side of a triangle.
#[derive(Clone, Copy)]
pub(crate) struct Side {
    /// Vertices, the lower number first.
    pub edge: (u32, u32),
    pub triangle: u32,
    /// Opposite corner.
    pub corner: u8,
}

/// Returns all sides of triangles, sorted so that those of an edge are adjacent.
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

/// Colours of patches, sRGB.
const PALETTE: [u32; 12] = [
    0x4e79a7, 0xf28e2b, 0xd94f54, 0x6fb5b0, 0x59a14f, 0xecc846, 0xa86fa0, 0xf39aa6, 0x93684f, 0x9fd67f,
    0x8fc7ea, 0x6a5fc0,
];

/// Returns the linear RGB of a colour number.
pub(crate) fn color(number: u8) -> [f32; 3] {
    let packed = PALETTE[usize::from(number) % PALETTE.len()];
    [16, 8, 0].map(|shift| {
        let encoded = (packed >> shift & 0xff) as f32 / 255.0;
        if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
    })
}

/// Returns a colour number for each node of a hierarchy.
pub(crate) fn colors(clod: &Clod) -> Vec<u8> {
    let mut colors = vec![0; clod.nodes().len()];
    let mut neighbours: Vec<(u32, u32)> = Vec::new();
    for (index, level) in clod.levels.iter().enumerate() {
        // Hulls of a free level are neighbours if any of their children are.
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
                // The first of equal ones; `max_by_key` returns the last, hence the reversal.
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

/// Assigns a colour to each patch: the wanted one if no neighbour has it. `pairs` are neighbours, in order.
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
        // Number of uses of each colour by neighbours, in the upper half, and by neighbours of neighbours.
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
        // Patches start at different colours, so that equally rare colours are all used.
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
    fn neighbouring_patches_differ_and_the_surface_is_closed() {
        let mesh = Model::Torus.generate(2_000).expect("torus");
        let options = BuildOptions::default();
        let clod = build(&mesh, &options, &mut unwatched).expect("hierarchy");
        let colors = colors(&clod);
        for (index, level) in clod.levels.iter().enumerate().filter(|(_, level)| !level.free) {
            let surface = Surface::of(&clod, index);
            assert_eq!(surface.mesh.triangles().len(), level.triangles as usize);
            let report = surface.mesh.validate();
            assert!(report.closed && report.manifold && report.oriented, "level {index} is closed");
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
    fn patch_gets_the_wanted_colour_if_it_is_free() {
        assert_eq!(distinct(&[Some(3), None, Some(5)], &[(0, 1), (1, 2)])[2], 5);
        let both = distinct(&[Some(3), Some(3)], &[(0, 1)]);
        assert!(both.contains(&3) && both[0] != both[1], "{both:?}");
        assert!(distinct(&[], &[]).is_empty());
    }

    #[test]
    fn more_mutual_neighbours_than_colours_use_all_colours() {
        let count = PALETTE.len() as u32 + 3;
        let pairs: Vec<(u32, u32)> = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b))).collect();
        let colors = distinct(&vec![None; count as usize], &pairs);
        let used: std::collections::HashSet<u8> = colors.into_iter().collect();
        assert_eq!(used.len(), PALETTE.len());
    }
}
