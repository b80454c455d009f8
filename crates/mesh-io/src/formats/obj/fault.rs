//! The search for the faulty line of an OBJ file, and the reason: `tobj` names no line.

use std::path::Path;

use super::lines::{Counts, Lines, words};
use crate::LoadError;
use crate::formats::text::{parse_number, quoted};

/// The first line that `tobj` refuses or must not read, and the reason, for a message; called once a fault is
/// known to exist. Faces that name a vertex or coordinate that the file does not have are looked for last.
pub(super) fn first_fault(bytes: &[u8], textured: bool) -> Option<(usize, String)> {
    let mut all = None;
    for _ in 0..2 {
        let mut lines = Lines::new(bytes);
        let mut so_far = Counts::default();
        while let Some((number, line)) = lines.next() {
            let mut words = words(line);
            let keyword = words.next();
            let checked = match keyword {
                Some(b"v") => {
                    check_numbers(words, "vertex", &["x coordinate", "y coordinate", "z coordinate"])
                }
                Some(b"vt") if textured => {
                    let given = words.clone().count().clamp(1, 2);
                    check_numbers(words, "texture coordinate", &["u", "v"][..given])
                }
                Some(b"f" | b"fo") if words.clone().count() >= 3 => {
                    check_corners(line, textured, so_far, all).map(drop)
                }
                _ => Ok(()),
            };
            if let Err(reason) = checked {
                return Some((number, reason));
            }
            so_far.add(keyword);
        }
        all = Some(so_far);
    }
    None
}

fn check_numbers<'a>(
    mut words: impl Iterator<Item = &'a [u8]>,
    what: &str,
    names: &[&str],
) -> Result<(), String> {
    for name in names {
        let word = words.next().ok_or_else(|| format!("the {what} has no {name}"))?;
        parse_number(word).ok_or_else(|| format!("{} is not a number", quoted(word)))?;
    }
    Ok(())
}

/// Checks that every corner of a face (`7`, `7/1`, `7//3`, `-1/…`) names elements that exist in a file with
/// `all` of them, or that may still come where `all` is not known. Returns the first corner without texture
/// coordinate, if they are asked for.
pub(super) fn check_corners(
    line: &[u8],
    textured: bool,
    so_far: Counts,
    all: Option<Counts>,
) -> Result<Option<usize>, String> {
    let vertex =
        Named { one: "vertex", many: "vertices", so_far: so_far.vertices, all: all.map(|all| all.vertices) };
    let place = Named {
        one: "texture coordinate",
        many: "texture coordinates",
        so_far: so_far.coordinates,
        all: all.map(|all| all.coordinates),
    };
    let mut missing = None;
    for (corner, word) in words(line).skip(1).enumerate() {
        let mut fields = word.split(|&b| b == b'/');
        vertex.check(fields.next().unwrap_or_default(), word)?;
        if textured {
            match fields.next().filter(|field| !field.is_empty()) {
                Some(field) => place.check(field, word)?,
                None => missing = missing.or(Some(corner)),
            }
        }
    }
    Ok(missing)
}

/// The elements that a corner of a face can name: vertices or texture coordinates.
struct Named {
    one: &'static str,
    many: &'static str,
    /// Number of them before the face.
    so_far: usize,
    /// Number of them in the file, where that is known.
    all: Option<usize>,
}

impl Named {
    fn check(&self, field: &[u8], corner: &[u8]) -> Result<(), String> {
        let Self { one, many, so_far, all } = self;
        let index = parse_index(field).ok_or_else(|| format!("{} is not a {one} index", quoted(corner)))?;
        let beyond = |count: usize| index.unsigned_abs() > count as u64;
        match (index, *all) {
            (0, _) => Err(format!("the face names {one} 0, but {many} count from 1")),
            (..0, _) if beyond(*so_far) => {
                Err(format!("the face names {one} {index}, but only {so_far} come before it"))
            }
            (1.., Some(all)) if beyond(all) => {
                Err(format!("the face names {one} {index}, but the file has {all}"))
            }
            _ => Ok(()),
        }
    }
}

fn parse_index(field: &[u8]) -> Option<i64> {
    std::str::from_utf8(field).ok()?.parse().ok()
}

/// Faces with a corner that names no texture coordinate.
#[derive(Default)]
pub(super) struct Untextured {
    faces: usize,
    /// Line of the first such face, and its corner.
    first: Option<(usize, usize)>,
}

impl Untextured {
    pub(super) fn count(&mut self, corner: Option<usize>, line: usize) {
        if let Some(corner) = corner {
            self.faces += 1;
            self.first = self.first.or(Some((line, corner)));
        }
    }

    pub(super) fn check(&self, faces: usize, path: &Path) -> Result<(), LoadError> {
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
