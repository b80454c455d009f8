//! Wavefront OBJ: the `v` and `f` lines, and where texture coordinates are asked for the `vt` lines; everything else does
//! not bear on the surface and is skipped.
//!
//! Read here rather than through the crate `tobj` (which the tests hold it against), because a file that anyone may
//! hand in asks for what that lacks: it takes polylines (`l`) of three and more points for faces, overflows on relative
//! texture indices that are out of range, refuses whole files for a comment that is not UTF-8, and can say neither the
//! line of an error nor the file's number of a vertex, since it renumbers them object by object.
//!
//! Departures from the letter of the format, as other readers have them: numbers such as `nan`, `inf` and MSVC's
//! `1.#IND` are read as what they mean; faces of fewer than three corners are skipped with a warning; the weight `w`
//! of a vertex, meant for rational curves, is ignored. So is the third texture coordinate.

use std::path::Path;

use glam::{DVec2, DVec3};

use crate::LoadError;
use crate::formats::surface::{Skipped, Surface, Wanted};
use crate::formats::text::{parse_number, quoted};

const REMEDY: &str = "correct that line or export the model again";

pub(crate) fn read(bytes: &[u8], path: &Path, wanted: Wanted) -> Result<Surface, LoadError> {
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
    let textured = wanted == Wanted::Textured;
    let mut vertices = Vec::new();
    let mut coordinates = Vec::new();
    let mut corners = Named::new("vertex", "vertices");
    // As many as `corners`, if textured.
    let mut places = Named::new("texture coordinate", "texture coordinates");
    let mut untextured = Untextured::default();
    // Where each face starts in `corners`.
    let mut faces: Vec<usize> = Vec::new();
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
            Some(b"vt") if textured => {
                if coordinates.len() >= u32::MAX as usize - 1 {
                    return Err(malformed(number, "too many texture coordinates for 32-bit indices".into()));
                }
                coordinates.push(texture_coordinate(words).map_err(|reason| malformed(number, reason))?);
            }
            Some(b"f" | b"fo") => {
                let start = corners.indices.len();
                let mut missing = None;
                for (corner, word) in words.enumerate() {
                    let mut fields = word.split(|&b| b == b'/');
                    corners
                        .push(fields.next().unwrap_or(word), word, vertices.len(), number)
                        .map_err(|reason| malformed(number, reason))?;
                    match fields.next().filter(|field| !field.is_empty()) {
                        Some(field) if textured => places
                            .push(field, word, coordinates.len(), number)
                            .map_err(|reason| malformed(number, reason))?,
                        None if textured => {
                            places.indices.push(0);
                            missing = missing.or(Some(corner));
                        }
                        _ => {}
                    }
                }
                match corners.indices.len() - start {
                    0..=2 => {
                        corners.indices.truncate(start);
                        places.indices.truncate(start);
                        skipped.incomplete.push(number);
                    }
                    _ => {
                        faces.push(start);
                        untextured.count(missing, number);
                    }
                }
            }
            Some(b"l") => skipped.lines += 1,
            Some(b"p") => skipped.points += 1,
            Some(b"curv" | b"curv2" | b"surf") => skipped.freeform += 1,
            _ => {}
        }
    }
    for (named, count) in [(&corners, vertices.len()), (&places, coordinates.len())] {
        named.check(count).map_err(|(number, reason)| malformed(number, reason))?;
    }
    untextured.check(faces.len(), path)?;
    let (corners, places) = (corners.indices, places.indices);
    let mut surface = Surface { triangles: Vec::with_capacity(faces.len()), ..Surface::default() };
    let ends = faces.iter().skip(1).copied().chain([corners.len()]);
    for (&start, end) in faces.iter().zip(ends) {
        skipped.cut(&corners[start..end], &vertices, |cut| {
            surface.triangles.push(cut.map(|corner| corners[start + corner]));
            if textured {
                surface.coordinates.push(cut.map(|corner| coordinates[places[start + corner] as usize]));
            }
        });
    }
    Ok(Surface { vertices, warnings: skipped.warnings("line"), ..surface })
}

/// The coordinates of a `vt` line, with v turned over: in OBJ it points up. A missing v is 0.
fn texture_coordinate<'a>(mut words: impl Iterator<Item = &'a [u8]>) -> Result<DVec2, String> {
    let parsed = |word: &[u8]| parse_number(word).ok_or_else(|| format!("{} is not a number", quoted(word)));
    let u = parsed(words.next().ok_or("the texture coordinate has no u")?)?;
    let v = words.next().map_or(Ok(0.0), parsed)?;
    Ok(DVec2::new(u, 1.0 - v))
}

/// What the corners of faces name: vertices or texture coordinates.
struct Named {
    one: &'static str,
    many: &'static str,
    /// Counted from zero.
    indices: Vec<u32>,
    /// The largest index of what came later in the file, if at all, and the line that names it: checked at the end.
    furthest: Option<(u64, usize)>,
}

impl Named {
    fn new(one: &'static str, many: &'static str) -> Self {
        Self { one, many, indices: Vec::new(), furthest: None }
    }

    /// Adds what `field` of a corner (`7`, `7/1`, `7//3`, `-1/…`) names when there are `so_far`.
    fn push(&mut self, field: &[u8], corner: &[u8], so_far: usize, line: usize) -> Result<(), String> {
        let index = self.resolve(field, corner, so_far)?;
        if index >= so_far as u64 && self.furthest.is_none_or(|(far, _)| index > far) {
            self.furthest = Some((index, line));
        }
        // Below 2³², or refused at the end.
        self.indices.push(index as u32);
        Ok(())
    }

    /// Counted from zero. May lie beyond those so far.
    fn resolve(&self, field: &[u8], corner: &[u8], so_far: usize) -> Result<u64, String> {
        let (one, many) = (self.one, self.many);
        let index: i64 = std::str::from_utf8(field)
            .ok()
            .and_then(|s| s.parse().ok())
            .ok_or_else(|| format!("{} is not a {one} index", quoted(corner)))?;
        match index {
            1.. => Ok(index as u64 - 1),
            0 => Err(format!("the face names {one} 0, but {many} count from 1")),
            _ => (so_far as u64)
                .checked_sub(index.unsigned_abs())
                .ok_or_else(|| format!("the face names {one} {index}, but only {so_far} come before it")),
        }
    }

    /// Whether all that is named is among the `count` of the file; else the line and why.
    fn check(&self, count: usize) -> Result<(), (usize, String)> {
        match self.furthest.filter(|&(index, _)| index >= count as u64) {
            Some((index, line)) => {
                Err((line, format!("the face names {} {}, but the file has {count}", self.one, index + 1)))
            }
            None => Ok(()),
        }
    }
}

/// Faces with a corner that names no texture coordinate.
#[derive(Default)]
struct Untextured {
    faces: usize,
    /// Line of the first such face, and its corner.
    first: Option<(usize, usize)>,
}

impl Untextured {
    fn count(&mut self, corner: Option<usize>, line: usize) {
        if let Some(corner) = corner {
            self.faces += 1;
            self.first = self.first.or(Some((line, corner)));
        }
    }

    fn check(&self, faces: usize, path: &Path) -> Result<(), LoadError> {
        let Some((line, corner)) = self.first else { return Ok(()) };
        let corner = corner + 1;
        Err(LoadError::TextureCoordinates {
            file: path.into(),
            place: format!("line {line}"),
            reason: match self.faces {
                1 => format!("corner {corner} of the face has no texture coordinate"),
                n if n == faces => "no face of the file has texture coordinates at all its corners".into(),
                n => format!(
                    "corner {corner} of the face has no texture coordinate; so in {n} faces of {faces}"
                ),
            },
            remedy: "unwrap the whole model and export it with texture coordinates",
        })
    }
}
