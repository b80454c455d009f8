//! Wavefront OBJ: the `v` and `f` lines; everything else does not bear on the surface and is skipped.
//!
//! Read here rather than through the crate `tobj` (which the tests hold it against), because a file that anyone may
//! hand in asks for what that lacks: it takes polylines (`l`) of three and more points for faces, overflows on relative
//! texture indices that are out of range, refuses whole files for a comment that is not UTF-8, and can say neither the
//! line of an error nor the file's number of a vertex, since it renumbers them object by object.
//!
//! Departures from the letter of the format, as other readers have them: numbers such as `nan`, `inf` and MSVC's
//! `1.#IND` are read as what they mean; faces of fewer than three corners are skipped with a warning; the weight `w`
//! of a vertex, meant for rational curves, is ignored.

use std::path::Path;

use glam::DVec3;

use crate::LoadError;
use crate::formats::surface::{Skipped, Surface};
use crate::formats::text::{parse_number, quoted};

const REMEDY: &str = "correct that line or export the model again";

pub(crate) fn read(bytes: &[u8], path: &Path) -> Result<Surface, LoadError> {
    let malformed = |line: usize, reason: String| LoadError::Malformed {
        file: path.into(),
        place: format!("line {line}"),
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
    let mut vertices = Vec::new();
    let mut corners: Vec<u32> = Vec::new();
    // Where each face starts in `corners`.
    let mut faces: Vec<usize> = Vec::new();
    // A corner may name a vertex that comes later in the file: checked at the end.
    let mut furthest: Option<(u64, usize)> = None;
    let mut skipped = Skipped::default();
    let mut joined = Vec::new();
    let separator = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    let mut lines = bytes.split(|&b| b == separator).enumerate();
    while let Some((number, line)) = lines.next() {
        let number = number + 1;
        // A backslash at its end continues a line.
        let mut line = line.trim_ascii();
        if line.ends_with(b"\\") {
            joined.clear();
            while let Some(part) = line.strip_suffix(b"\\") {
                joined.extend_from_slice(part);
                joined.push(b' ');
                line = lines.next().map_or(&[][..], |(_, next)| next.trim_ascii());
            }
            joined.extend_from_slice(line);
            line = &joined;
        }
        let mut words = line
            .split(u8::is_ascii_whitespace)
            .filter(|word| !word.is_empty())
            .take_while(|word| !word.starts_with(b"#"));
        match words.next() {
            Some(b"v") => {
                let mut position = [0.0; 3];
                for (coordinate, name) in position.iter_mut().zip(["x", "y", "z"]) {
                    let word = words
                        .next()
                        .ok_or_else(|| malformed(number, format!("the vertex has no {name} coordinate")))?;
                    *coordinate = parse_number(word)
                        .ok_or_else(|| malformed(number, format!("{} is not a number", quoted(word))))?;
                }
                if vertices.len() >= u32::MAX as usize - 1 {
                    return Err(malformed(number, "too many vertices for 32-bit indices".into()));
                }
                vertices.push(DVec3::from_array(position));
            }
            Some(b"f" | b"fo") => {
                let start = corners.len();
                for word in words {
                    let index = resolve(word, vertices.len()).map_err(|reason| malformed(number, reason))?;
                    if index >= vertices.len() as u64 && furthest.is_none_or(|(far, _)| index > far) {
                        furthest = Some((index, number));
                    }
                    // Below 2³², or refused at the end.
                    corners.push(index as u32);
                }
                match corners.len() - start {
                    0..=2 => {
                        corners.truncate(start);
                        skipped.incomplete.push(number);
                    }
                    _ => faces.push(start),
                }
            }
            Some(b"l") => skipped.lines += 1,
            Some(b"p") => skipped.points += 1,
            Some(b"curv" | b"curv2" | b"surf") => skipped.freeform += 1,
            _ => {}
        }
    }
    if let Some((index, number)) = furthest.filter(|&(index, _)| index >= vertices.len() as u64) {
        let reason = format!("the face names vertex {}, but the file has {}", index + 1, vertices.len());
        return Err(malformed(number, reason));
    }
    let mut triangles = Vec::with_capacity(faces.len());
    let ends = faces.iter().skip(1).copied().chain([corners.len()]);
    for (&start, end) in faces.iter().zip(ends) {
        skipped.cut(&corners[start..end], &vertices, &mut triangles);
    }
    Ok(Surface { vertices, triangles, warnings: skipped.warnings("line") })
}

/// The vertex that a face's corner (`7`, `7/1`, `7//3`, `-1/…`) names, counted from zero. May lie beyond the vertices
/// so far.
fn resolve(word: &[u8], vertices: usize) -> Result<u64, String> {
    let index = word.split(|&b| b == b'/').next().unwrap_or(word);
    let index: i64 = std::str::from_utf8(index)
        .ok()
        .and_then(|s| s.parse().ok())
        .ok_or_else(|| format!("{} is not a vertex index", quoted(word)))?;
    match index {
        1.. => Ok(index as u64 - 1),
        0 => Err("the face names vertex 0, but vertices count from 1".into()),
        _ => (vertices as u64)
            .checked_sub(index.unsigned_abs())
            .ok_or_else(|| format!("the face names vertex {index}, but only {vertices} come before it")),
    }
}
