//! STL, binary and ASCII.
//!
//! Binary files are read by the crate `stl_io`, once the header's count of triangles has been checked against
//! the file's size. ASCII files are read here: that crate stops at the end of the first solid, wants `solid`
//! in lower case and followed by a space, rounds to f32, and cannot say on which line an error is.
//!
//! A file is binary if its size agrees with its count (many binary files start with `solid`), else ASCII if
//! it starts with `solid`.

use std::io::Cursor;
use std::path::Path;

use glam::DVec3;

use crate::formats::surface::Surface;
use crate::formats::text::{parse_number, quoted};
use crate::{LoadError, LoadWarning};

/// Number of bytes before the triangles: 80 of comment and the count.
const HEADER_BYTES: usize = 84;
/// Number of bytes of a triangle: its normal and corners as f32, and two bytes of attributes.
const TRIANGLE_BYTES: usize = 50;

pub(crate) fn read(bytes: &[u8], path: &Path) -> Result<Surface, LoadError> {
    let announced = bytes
        .get(HEADER_BYTES - 4..HEADER_BYTES)
        .map(|count| u32::from_le_bytes([count[0], count[1], count[2], count[3]]));
    let expected = announced.map(|count| HEADER_BYTES as u64 + TRIANGLE_BYTES as u64 * u64::from(count));
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    let named_solid = text.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    if named_solid && expected != Some(bytes.len() as u64) {
        return read_ascii(bytes, path);
    }
    let (Some(announced), Some(expected)) = (announced, expected) else {
        return Err(truncated(
            path,
            format!("the header of a binary file takes {HEADER_BYTES} bytes, the file has {}", bytes.len()),
        ));
    };
    if expected > bytes.len() as u64 {
        let reason = format!(
            "the header announces {announced} triangles, which take {expected} bytes, but the file has {}",
            bytes.len()
        );
        return Err(truncated(path, reason));
    }
    let mut surface = read_binary(bytes, path)?;
    let rest = bytes.len() as u64 - expected;
    if rest > 0 {
        surface.warnings.push(LoadWarning::TrailingBytes { count: rest });
    }
    Ok(surface)
}

fn truncated(path: &Path, reason: String) -> LoadError {
    LoadError::Malformed {
        file: path.into(),
        place: "header".into(),
        reason,
        remedy: "the file is cut off or not STL: get it again",
    }
}

fn read_binary(bytes: &[u8], path: &Path) -> Result<Surface, LoadError> {
    let failed = |source| LoadError::Read { file: path.into(), source };
    // The reader would take a header that starts with "solid " for ASCII.
    let mut bytes = bytes.to_vec();
    bytes[..HEADER_BYTES - 4].fill(0);
    let mut cursor = Cursor::new(bytes);
    let mut surface = Surface::default();
    for triangle in stl_io::create_stl_reader(&mut cursor).map_err(failed)? {
        push(
            &mut surface,
            triangle.map_err(failed)?.vertices.map(|v| DVec3::from_array(v.0.map(f64::from))),
            path,
        )?;
    }
    Ok(surface)
}

fn read_ascii(bytes: &[u8], path: &Path) -> Result<Surface, LoadError> {
    let mut surface = Surface::default();
    let mut corners = Vec::with_capacity(3);
    let mut in_facet = false;
    let separator = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    for (number, line) in bytes.split(|&b| b == separator).enumerate() {
        let malformed = |reason: String| LoadError::Malformed {
            file: path.into(),
            place: format!("line {}", number + 1),
            reason,
            remedy: "correct that line or export the model again",
        };
        let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        let keyword = words.next().unwrap_or_default().to_ascii_lowercase();
        match keyword.as_slice() {
            b"facet" => {
                if in_facet {
                    return Err(malformed("a facet starts before the last one has ended".into()));
                }
                in_facet = true;
                corners.clear();
            }
            b"vertex" => {
                let mut position = [0.0; 3];
                for (coordinate, name) in position.iter_mut().zip(["x", "y", "z"]) {
                    let word = words
                        .next()
                        .ok_or_else(|| malformed(format!("the vertex has no {name} coordinate")))?;
                    *coordinate = parse_number(word)
                        .ok_or_else(|| malformed(format!("{} is not a number", quoted(word))))?;
                }
                if !in_facet || corners.len() == 3 {
                    return Err(malformed("a vertex beyond the three of a facet".into()));
                }
                corners.push(DVec3::from_array(position));
            }
            b"endfacet" => {
                let &[a, b, c] = corners.as_slice() else {
                    return Err(malformed(format!(
                        "the facet has {} vertices instead of three",
                        corners.len()
                    )));
                };
                if !in_facet {
                    return Err(malformed("a facet ends that has not started".into()));
                }
                in_facet = false;
                push(&mut surface, [a, b, c], path)?;
            }
            // Names, which follow some of these keywords, may contain anything.
            b"" | b"solid" | b"endsolid" | b"outer" | b"endloop" | b"color" => {}
            other => return Err(malformed(format!("{} is no keyword of ASCII STL", quoted(other)))),
        }
    }
    if in_facet {
        return Err(LoadError::Malformed {
            file: path.into(),
            place: "end of file".into(),
            reason: format!("facet {} is not finished", surface.triangles.len() + 1),
            remedy: "the file is cut off: get it again",
        });
    }
    Ok(surface)
}

fn push(surface: &mut Surface, corners: [DVec3; 3], path: &Path) -> Result<(), LoadError> {
    let first = u32::try_from(surface.vertices.len()).ok().filter(|first| *first < u32::MAX - 3);
    let Some(first) = first else {
        return Err(LoadError::Malformed {
            file: path.into(),
            place: format!("triangle {}", surface.triangles.len()),
            reason: "more corners than 32-bit indices can name".into(),
            remedy: "split the model",
        });
    };
    surface.vertices.extend(corners);
    surface.triangles.push([first, first + 1, first + 2]);
    Ok(())
}
