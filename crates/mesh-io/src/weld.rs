//! Exact welding: vertices at bitwise equal positions become one (−0 counts as 0).
//!
//! STL repeats every corner, and OBJ and glTF exporters split vertices along seams of normals and texture
//! coordinates. Nothing is moved: no tolerance is used, so that two surfaces that nearly touch stay two.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use glam::DVec3;
use palpate_core::TriMesh;

/// Joins vertices at equal positions (−0 counts as 0) and drops those that no triangle uses.
///
/// The new vertices are in the order of first use by position in the old vertex list; triangles keep their
/// order and number, also those that become degenerate. Vertices with a coordinate that is not a number are
/// joined by bit pattern.
pub fn weld(mesh: &TriMesh) -> TriMesh {
    let same = equal_positions(mesh.vertices());
    let mut used = vec![false; mesh.vertices().len()];
    for corner in mesh.triangles().iter().flatten() {
        used[same[*corner as usize] as usize] = true;
    }
    renumber(mesh, &same, &used)
}

/// Drops the vertices that no triangle uses; nothing else changes.
pub(crate) fn drop_unreferenced(mesh: &TriMesh) -> TriMesh {
    let itself: Vec<u32> = (0..mesh.vertices().len() as u32).collect();
    let mut used = vec![false; itself.len()];
    for corner in mesh.triangles().iter().flatten() {
        used[*corner as usize] = true;
    }
    renumber(mesh, &itself, &used)
}

/// Index of the first vertex at the same position, for each vertex.
pub(crate) fn equal_positions(vertices: &[DVec3]) -> Vec<u32> {
    let mut first: HashMap<[u64; 3], u32, BuildHasherDefault<BitsHasher>> =
        HashMap::with_capacity_and_hasher(vertices.len(), BuildHasherDefault::default());
    vertices
        .iter()
        .enumerate()
        // Adding 0 turns −0 into 0 and leaves every other number alone.
        .map(|(i, v)| *first.entry(v.to_array().map(|x| (x + 0.0).to_bits())).or_insert(i as u32))
        .collect()
}

/// Replaces each corner by the `target` of its vertex and keeps only the `kept` vertices, in their order.
/// Every target of a corner must be kept.
pub(crate) fn renumber(mesh: &TriMesh, target: &[u32], kept: &[bool]) -> TriMesh {
    let mut number = vec![u32::MAX; kept.len()];
    let mut vertices = Vec::new();
    for (i, v) in mesh.vertices().iter().enumerate().filter(|&(i, _)| kept[i]) {
        number[i] = vertices.len() as u32;
        vertices.push(*v);
    }
    let triangles = mesh.triangles().iter().map(|t| t.map(|v| number[target[v as usize] as usize])).collect();
    TriMesh::new(vertices, triangles)
        .expect("a renumbered mesh has no more vertices or triangles than before")
}

/// A fixed hash of coordinate bits: multiply and fold, after wyhash. The map is only probed, never iterated,
/// and the default SipHash would dominate the time of welding. Crafted collisions cost time only in
/// proportion to the file's size.
#[derive(Default)]
pub(crate) struct BitsHasher(u64);

impl Hasher for BitsHasher {
    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.write_u64(u64::from_le_bytes(word));
        }
    }

    fn write_u64(&mut self, word: u64) {
        let wide = u128::from(self.0 ^ word ^ 0xa076_1d64_78bd_642f) * 0xe703_7ed1_a0b4_28db;
        self.0 = (wide as u64) ^ ((wide >> 64) as u64);
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn joins_zeros_and_drops_the_unused() {
        let v = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let vertices = vec![
            v(9.0, 9.0),
            v(0.0, 0.0),
            v(1.0, 0.0),
            v(-0.0, 1.0),
            v(0.0, -0.0),
            v(0.0, 1.0),
            v(1.0, f64::EPSILON),
        ];
        let mesh = TriMesh::new(vertices, vec![[1, 2, 3], [5, 4, 6], [4, 1, 2]]).unwrap();
        let welded = weld(&mesh);
        assert_eq!(welded.vertices(), [v(0.0, 0.0), v(1.0, 0.0), v(0.0, 1.0), v(1.0, f64::EPSILON)]);
        assert_eq!(welded.triangles(), [[0, 1, 2], [2, 0, 3], [0, 0, 1]]);
        assert_eq!(weld(&welded), welded);
    }

    #[test]
    fn agrees_with_comparing_all_with_all() {
        let seed = 3;
        let mut random = StdRng::seed_from_u64(seed);
        let vertices: Vec<DVec3> = (0..2000)
            .map(|_| DVec3::from_array(std::array::from_fn(|_| f64::from(random.random_range(-4..4)) * -0.5)))
            .collect();
        let plain: Vec<u32> =
            vertices.iter().map(|v| vertices.iter().position(|w| w == v).unwrap() as u32).collect();
        assert_eq!(equal_positions(&vertices), plain, "seed {seed}");
    }
}
