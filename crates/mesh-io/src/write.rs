//! Writing Wavefront OBJ.

use std::io::{self, Write};

use palpate_core::TriMesh;

/// Writes a mesh as Wavefront OBJ: `v` lines in the shortest decimal form that reads back as the same f64, then `f` lines.
/// The lengths are written as they are (m). Writes in small pieces: give it a buffered writer.
///
/// # Errors
/// Those of the writer.
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
