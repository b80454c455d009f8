//! Writing Wavefront OBJ.

use std::io::{self, Write};

use palpate_core::TriMesh;

/// Writes a mesh as Wavefront OBJ: `v` lines in the shortest decimal form that reads back as the same f64,
/// then `f` lines. The lengths are written as they are (m). Writes in small pieces: pass a buffered writer.
///
/// # Errors
/// If the writer fails.
pub fn write_obj(mesh: &TriMesh, mut out: impl Write) -> io::Result<()> {
    writeln!(out, "# {} vertices, {} triangles, metres", mesh.vertices().len(), mesh.triangles().len())?;
    for v in mesh.vertices() {
        writeln!(out, "v {:?} {:?} {:?}", v.x, v.y, v.z)?;
    }
    for [a, b, c] in mesh.triangles() {
        // In 64 bits, since the last vertex a mesh may have is number 2³² − 1 when counted from one.
        writeln!(out, "f {} {} {}", u64::from(*a) + 1, u64::from(*b) + 1, u64::from(*c) + 1)?;
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DVec3;

    use super::*;
    use crate::formats::surface::Wanted;

    #[test]
    fn numbers_survive_to_the_last_bit() {
        let awkward = DVec3::new(0.1 + 0.2, -1e-310, 1.7976931348623157e308);
        let mesh = TriMesh::new(vec![awkward, DVec3::ZERO, DVec3::ONE / 3.0], vec![[2, 1, 0]]).unwrap();
        let mut bytes = Vec::new();
        write_obj(&mesh, &mut bytes).unwrap();
        let read = crate::formats::obj::read(&bytes, "memory".as_ref(), Wanted::Surface).unwrap();
        assert_eq!(
            (read.vertices.as_slice(), read.triangles.as_slice()),
            (mesh.vertices(), mesh.triangles())
        );
    }
}
