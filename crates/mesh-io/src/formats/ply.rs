//! PLY: ASCII and binary of either byte order; the positions of the element `vertex` and the polygons of
//! `face`.
//!
//! Read here rather than through a crate: `ply-rs-bw` (the kept-up one) refuses `.5`, `1.` and `nan` in ASCII
//! files and comments that are not UTF-8, and loops over as many elements as the header announces even when
//! each takes no bytes. Here every count is checked against the bytes that are left before anything is read
//! or allocated.

use std::path::Path;

use glam::DVec3;

use crate::LoadError;
use crate::formats::surface::{Skipped, Surface};
use crate::formats::text::{parse_number, quoted};

const REMEDY: &str = "the file is damaged or cut off: get it or export it again";

#[derive(Clone, Copy, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn named(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// The value of `size` bytes in little-endian order. All integers are exact in f64.
    fn decode(self, b: [u8; 8]) -> f64 {
        match self {
            Self::I8 => f64::from(b[0] as i8),
            Self::U8 => f64::from(b[0]),
            Self::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            Self::I32 => f64::from(i32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::U32 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F32 => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

struct Property {
    name: Vec<u8>,
    /// The type of the count, if it is a list.
    count: Option<Scalar>,
    value: Scalar,
}

struct Element {
    name: Vec<u8>,
    count: u64,
    properties: Vec<Property>,
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

pub(crate) fn read(bytes: &[u8], path: &Path) -> Result<Surface, LoadError> {
    let malformed = |place: String, reason: String| LoadError::Malformed {
        file: path.into(),
        place,
        reason,
        remedy: REMEDY,
    };
    let (encoding, elements, mut data) =
        read_header(bytes).map_err(|(line, reason)| malformed(format!("header, line {line}"), reason))?;
    let mut surface = Surface::default();
    let mut skipped = Skipped::default();
    // Corners as they stand in the file, until all vertices are known; `faces` holds the start of each face
    // in them.
    let mut corners: Vec<f64> = Vec::new();
    let mut faces: Vec<usize> = Vec::new();
    for element in &elements {
        let name = quoted(&element.name);
        // The smallest size of an instance: lists may be empty; in ASCII each property takes a digit and a
        // separator.
        let least: u64 = match encoding {
            Encoding::Ascii => 2 * element.properties.len() as u64,
            _ => element.properties.iter().map(|p| p.count.unwrap_or(p.value).size() as u64).sum(),
        };
        let left = data.bytes.len() as u64 + 1;
        if element.count > 0 && (least == 0 || element.count.saturating_mul(least) > left) {
            let reason = format!("{} instances announced, more than the file has bytes for", element.count);
            return Err(malformed(format!("element {name}"), reason));
        }
        let index_of = |wanted: &[u8]| element.properties.iter().position(|p| p.name == wanted);
        let xyz = match (element.name.as_slice(), index_of(b"x"), index_of(b"y"), index_of(b"z")) {
            (b"vertex", Some(x), Some(y), Some(z))
                if [x, y, z].iter().all(|&i| element.properties[i].count.is_none()) =>
            {
                Some([x, y, z])
            }
            (b"vertex", ..) if element.count > 0 => {
                return Err(malformed(format!("element {name}"), "has no coordinates x, y and z".into()));
            }
            _ => None,
        };
        let polygon = (element.name == b"face")
            .then(|| index_of(b"vertex_indices").or_else(|| index_of(b"vertex_index")))
            .flatten();
        if let Some(polygon) = polygon {
            let property = &element.properties[polygon];
            if property.count.is_none() || !property.value.is_integer() {
                return Err(malformed(
                    format!("element {name}"),
                    "its vertex indices are not a list of integers".into(),
                ));
            }
        } else if element.name == b"face" && element.count > 0 {
            return Err(malformed(format!("element {name}"), "has no list vertex_indices".into()));
        }
        if element.name == b"tristrips" && element.count > 0 {
            return Err(LoadError::Unsupported {
                file: path.into(),
                feature: "triangle strips (element tristrips)".into(),
                remedy: "export the model with faces",
            });
        }
        for instance in 0..element.count {
            let at = |reason: String| malformed(format!("{name} {instance}"), reason);
            data.next_instance();
            let mut position = [0.0; 3];
            for (i, property) in element.properties.iter().enumerate() {
                let Some(count_type) = property.count else {
                    let value = data.value(property.value).map_err(at)?;
                    if let Some(axis) = xyz.and_then(|xyz| xyz.iter().position(|&k| k == i)) {
                        position[axis] = value;
                    }
                    continue;
                };
                let count = data.value(count_type).map_err(at)?;
                if !(count >= 0.0
                    && count <= (data.bytes.len() + data.line.len()) as f64
                    && count.fract() == 0.0)
                {
                    return Err(at(format!("a list of {count} entries is more than the file has bytes for")));
                }
                let start = corners.len();
                for _ in 0..count as usize {
                    let value = data.value(property.value).map_err(at)?;
                    if polygon == Some(i) {
                        corners.push(value);
                    }
                }
                if polygon == Some(i) {
                    if count < 3.0 {
                        corners.truncate(start);
                        skipped.incomplete.push(instance as usize);
                    } else {
                        faces.push(start);
                    }
                }
            }
            if xyz.is_some() {
                surface.vertices.push(DVec3::from_array(position));
            }
        }
    }
    let count = surface.vertices.len();
    if let Some(bad) = corners.iter().position(|&c| !(c >= 0.0 && c < count as f64)) {
        let face = faces.partition_point(|&start| start <= bad) - 1;
        let reason = format!("names vertex {}, but the file has {count}, counted from 0", corners[bad]);
        return Err(malformed(format!("face {face} of at least three corners"), reason));
    }
    let corners: Vec<u32> = corners.iter().map(|&c| c as u32).collect();
    let ends = faces.iter().skip(1).copied().chain([corners.len()]);
    for (&start, end) in faces.iter().zip(ends) {
        let polygon = &corners[start..end];
        let triangles = &mut surface.triangles;
        skipped.cut(polygon, &surface.vertices, |cut| triangles.push(cut.map(|corner| polygon[corner])));
    }
    surface.warnings = skipped.warnings("face");
    Ok(surface)
}

/// Reads the header; returns it with the data that follow. The error names a line of the header and a reason.
fn read_header(bytes: &[u8]) -> Result<(Encoding, Vec<Element>, Data<'_>), (usize, String)> {
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut rest = bytes;
    let mut number = 0;
    loop {
        number += 1;
        let Some(end) = rest.iter().position(|&b| b == b'\n' || b == b'\r') else {
            return Err((number, "the header does not end with end_header".into()));
        };
        let line = &rest[..end];
        // A line may end with CR LF. Binary data that start with LF follow a header with plain LF.
        let width = if rest[end..].starts_with(b"\r\n") { 2 } else { 1 };
        rest = &rest[end + width..];
        let words: Vec<&[u8]> =
            line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).take(8).collect();
        if number == 1 {
            if words != [b"ply"] {
                return Err((1, "the file does not start with the line \"ply\"".into()));
            }
            continue;
        }
        match words.as_slice() {
            [b"format", name, ..] => {
                encoding = Some(match *name {
                    b"ascii" => Encoding::Ascii,
                    b"binary_little_endian" => Encoding::Little,
                    b"binary_big_endian" => Encoding::Big,
                    other => return Err((number, format!("{} is no PLY format", quoted(other)))),
                });
            }
            [] | [b"comment" | b"obj_info", ..] => {}
            [b"element", name, count, ..] => {
                let count = std::str::from_utf8(count)
                    .ok()
                    .and_then(|count| count.parse().ok())
                    .ok_or_else(|| (number, format!("{} is not a count", quoted(count))))?;
                elements.push(Element { name: name.to_vec(), count, properties: Vec::new() });
            }
            [b"property", kind @ .., name] => {
                let scalar = |word: &[u8]| {
                    Scalar::named(word).ok_or_else(|| (number, format!("{} is not a type", quoted(word))))
                };
                let (count, value) = match kind {
                    [b"list", count, value] => (Some(scalar(count)?), scalar(value)?),
                    [value] => (None, scalar(value)?),
                    _ => return Err((number, "the property is neither a scalar nor a list".into())),
                };
                if count.is_some_and(|count| !count.is_integer()) {
                    return Err((number, "the length of a list is not an integer".into()));
                }
                let element =
                    elements.last_mut().ok_or((number, "a property comes before any element".into()))?;
                element.properties.push(Property { name: name.to_vec(), count, value });
            }
            [b"end_header"] => break,
            [word, ..] => return Err((number, format!("{} is no keyword of a PLY header", quoted(word)))),
        }
    }
    let encoding = encoding.ok_or((number, "the header names no format".into()))?;
    Ok((encoding, elements, Data { bytes: rest, line: &[], encoding }))
}

/// The data that are still to be read.
struct Data<'a> {
    bytes: &'a [u8],
    /// The rest of the current line, in ASCII.
    line: &'a [u8],
    encoding: Encoding,
}

impl Data<'_> {
    /// Goes on to the next instance of an element; in ASCII, each stands on a line of its own.
    fn next_instance(&mut self) {
        if self.encoding != Encoding::Ascii {
            return;
        }
        self.line = &[];
        while self.line.is_empty() && !self.bytes.is_empty() {
            let end = self.bytes.iter().position(|&b| b == b'\n' || b == b'\r').unwrap_or(self.bytes.len());
            self.line = self.bytes[..end].trim_ascii();
            self.bytes = &self.bytes[(end + 1).min(self.bytes.len())..];
        }
    }

    fn value(&mut self, scalar: Scalar) -> Result<f64, String> {
        if self.encoding == Encoding::Ascii {
            let end = self.line.iter().position(u8::is_ascii_whitespace).unwrap_or(self.line.len());
            let (word, rest) = self.line.split_at(end);
            self.line = rest.trim_ascii_start();
            if word.is_empty() {
                return Err("the line ends too early".into());
            }
            let value = parse_number(word).ok_or_else(|| format!("{} is not a number", quoted(word)))?;
            if scalar.is_integer() && value.fract() != 0.0 {
                return Err(format!("{} is not an integer", quoted(word)));
            }
            return Ok(value);
        }
        let size = scalar.size();
        let Some((word, rest)) = self.bytes.split_at_checked(size) else {
            return Err("the file ends too early".into());
        };
        self.bytes = rest;
        let mut le = [0; 8];
        le[..size].copy_from_slice(word);
        if self.encoding == Encoding::Big {
            le[..size].reverse();
        }
        Ok(scalar.decode(le))
    }
}
