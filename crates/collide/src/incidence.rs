//! The triangles at each vertex of a mesh.

/// Lists the triangles at each vertex. Returns the start of each vertex's range, with one more at the end,
/// and the triangles of all ranges.
pub(crate) fn triangles_at_vertices(
    vertices: usize,
    triangles: impl Iterator<Item = [u32; 3]> + Clone,
) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0u32; vertices + 1];
    for vertex in triangles.clone().flatten() {
        starts[vertex as usize + 1] += 1;
    }
    for index in 0..vertices {
        starts[index + 1] += starts[index];
    }
    let mut next = starts.clone();
    let mut at = vec![0; starts[vertices] as usize];
    for (index, corners) in (0u32..).zip(triangles) {
        for vertex in corners {
            at[next[vertex as usize] as usize] = index;
            next[vertex as usize] += 1;
        }
    }
    (starts, at)
}
