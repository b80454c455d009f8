//! Wavefront OBJ, read by the crate `tobj`.
//!
//! [`Feed`] passes on the lines that describe the surface, `v` and `f`, and `vt` where texture coordinates
//! are asked for. On the way it removes or rewrites what `tobj` reads wrongly:
//!
//! - objects, groups and materials: `tobj` starts a new model at each, with vertices of its own;
//! - polylines: `tobj` takes them for faces;
//! - names and comments: `tobj` refuses any that are not UTF-8, and takes a comment after data for data;
//! - lines continued with a backslash, lines that end in a carriage return alone, and the keyword `fo`;
//! - the weight of a vertex, by which `tobj` divides, and its colour, without which `tobj` refuses some files
//!   where other vertices have one;
//! - texture coordinates without v, and numbers as Microsoft's C library prints them, such as `1.#IND`.
//!
//! `tobj` renumbers the vertices of each model; each carries its number in the file as its colour, so that
//! they all stay in one pool. Polygons are triangulated here: `tobj` cuts even concave ones into fans. Where
//! a texture coordinate is missing or has the number 0, `tobj` makes one up, and on relative ones out of
//! range it overflows, so these faces are checked before it sees them. Its errors name no line:
//! [`first_fault`] finds the line that it refuses.
//!
//! Departures from the letter of the format, as other readers have them: `nan` and `inf` are numbers; faces
//! of fewer than three corners are skipped with a warning; the weight of a vertex, meant for rational curves,
//! is ignored. So is the third texture coordinate.

mod fault;
mod feed;
mod lines;

use std::path::Path;

use glam::{DVec2, DVec3};

use self::fault::first_fault;
use self::feed::Feed;
use crate::LoadError;
use crate::formats::surface::{Surface, Wanted};

const REMEDY: &str = "correct that line or export the model again";

/// Number of faces that `tobj` gets before a new model is started. Many more, and its working set no longer
/// fits the processor's cache.
const FACES_PER_MODEL: usize = 4096;

pub(crate) fn read(bytes: &[u8], path: &Path, wanted: Wanted) -> Result<Surface, LoadError> {
    let malformed = |place: String, reason: String| LoadError::Malformed {
        file: path.into(),
        place,
        reason,
        remedy: REMEDY,
    };
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if bytes.starts_with(b"\xff\xfe")
        || bytes.starts_with(b"\xfe\xff")
        || bytes[..bytes.len().min(64)].contains(&0)
    {
        return Err(LoadError::Malformed {
            file: path.into(),
            place: "line 1".into(),
            reason: "the file is not ASCII or UTF-8 text (UTF-16, or binary)".into(),
            remedy: "save it as UTF-8 text",
        });
    }
    let textured = wanted == Wanted::Textured;
    let read = |faces_per_model| {
        let mut feed = Feed::new(bytes, textured, faces_per_model);
        let no_materials = |_: &Path| Err(tobj::LoadError::OpenFileFailed);
        tobj::load_obj_buf(&mut feed, &tobj::LoadOptions::default(), no_materials)
            .map(|(models, _)| (models, feed))
    };
    // A face may name vertices that come later in the file, but not in a later model.
    let (models, feed) = read(FACES_PER_MODEL).or_else(|_| read(usize::MAX)).map_err(|error| {
        match first_fault(bytes, textured) {
            Some((line, reason)) => malformed(format!("line {line}"), reason),
            None => malformed("text".into(), format!("refused by tobj: {error}")),
        }
    })?;
    let Feed { counts, faces, mut skipped, untextured, .. } = feed;
    untextured.check(faces, path)?;
    if counts.vertices >= u32::MAX as usize {
        return Err(malformed("vertices".into(), "more than 32-bit indices can name".into()));
    }
    let mut surface = Surface { triangles: Vec::with_capacity(faces), ..Surface::default() };
    // Vertices that no face names stay NaN, so that no other vertex is welded with them.
    surface.vertices.resize(counts.vertices, DVec3::NAN);
    let mut polygon = Vec::new();
    for tobj::Model { mesh, .. } in models {
        let numbers: Vec<u32> = mesh.vertex_color.chunks_exact(3).map(|colour| colour[0] as u32).collect();
        for (&number, position) in numbers.iter().zip(mesh.positions.chunks_exact(3)) {
            surface.vertices[number as usize] = DVec3::from_slice(position);
        }
        // Without arities, all faces are triangles.
        let mut arities = mesh.face_arities.iter().map(|&arity| arity as usize);
        let mut end = 0;
        while end < mesh.indices.len() {
            let corners = end..end + arities.next().unwrap_or(3);
            end = corners.end;
            polygon.clear();
            polygon.extend(mesh.indices[corners.clone()].iter().map(|&vertex| numbers[vertex as usize]));
            let places = mesh.texcoord_indices.get(corners);
            skipped.cut(&polygon, &surface.vertices, |cut| {
                surface.triangles.push(cut.map(|corner| polygon[corner]));
                if let Some(places) = places {
                    // In OBJ, v points up.
                    surface.coordinates.push(cut.map(|corner| {
                        let place = 2 * places[corner] as usize;
                        DVec2::new(mesh.texcoords[place], 1.0 - mesh.texcoords[place + 1])
                    }));
                }
            });
        }
    }
    surface.warnings = skipped.warnings("line");
    Ok(surface)
}
