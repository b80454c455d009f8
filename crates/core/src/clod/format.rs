//! The `.clod` file format: a header and a body of fixed-size little-endian records.
//!
//! | part | content |
//! |---|---|
//! | header, 24 bytes | magic `palpclod`, version u32, length of the body u64, CRC-32 (IEEE) of the body u32 |
//! | counts | u32 each: levels, nodes, hull vertices, patch triangles |
//! | source | vertices, triangles, flags u32 (bit 0: solid), tolerance, bounding radius, centre, volume, centre of mass, inertia by columns |
//! | levels | nodes start and end, triangles, flags u32 (bit 0: free), resolution |
//! | nodes | parent, children start and end, level, vertices start and end, extreme, added, triangles start and end, flags u32 (bit 0: contained, bit 1: all real), centre, radius, deviation, Hausdorff distance |
//! | arrays | hull vertices (3 f64 each), their support areas (f64), patch triangles (3 u32 each) |
//!
//! Indices are u32, numbers f64, both as in [`Parts`]; there is no padding. Records of a fixed size, rather
//! than a self-describing encoding, let a reader compare the counts with the length of the body before it
//! allocates, and decode at the speed of copying. Nothing in a file is trusted: memory grows with the bytes
//! that are really there, and what was read passes [`Parts::validate`] before a caller sees it.

use std::fs::File;
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};

use super::{Clod, Level, Node, Parts, Source};

const MAGIC: [u8; 8] = *b"palpclod";
const VERSION: u32 = 3;
const HEADER_BYTES: usize = 24;
const COUNTS_BYTES: usize = 16;
const SOURCE_BYTES: usize = 3 * 4 + 18 * 8;
const LEVEL_BYTES: usize = 4 * 4 + 8;
const NODE_BYTES: usize = 11 * 4 + 6 * 8;
const VERTEX_BYTES: usize = 3 * 8;
const AREA_BYTES: usize = 8;
const TRIANGLE_BYTES: usize = 3 * 4;

/// Bytes in words, for an error message.
fn hex(bytes: &[u8]) -> String {
    if bytes.is_empty() {
        return "nothing: it is empty".to_owned();
    }
    let digits: Vec<String> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("the bytes {} (hexadecimal)", digits.join(" "))
}

/// Number of bytes read at a time: memory that a file claims but does not have costs no more than this.
const BLOCK_BYTES: usize = 1 << 16;

/// Why a hierarchy could not be read or written, or is not one.
#[derive(Debug, thiserror::Error)]
pub enum ClodError {
    /// The operating system refused.
    #[error("cannot {doing}{}: {source}", path.as_ref().map(|p| format!(" {}", p.display())).unwrap_or_default())]
    Io {
        /// The action that failed, such as `open`.
        doing: &'static str,
        /// The file, when it is known.
        path: Option<PathBuf>,
        /// The operating system's error.
        source: io::Error,
    },
    /// The file is not in this format at all.
    #[error("not a .clod file: it begins with {}; build one from a mesh", hex(found))]
    NotClod {
        /// The bytes in place of the format's magic number.
        found: Vec<u8>,
    },
    /// The file is of another version of the format.
    #[error(
        "the .clod file has format version {found}, but this program reads version {VERSION}: build it again from its mesh"
    )]
    Version {
        /// The file's version.
        found: u32,
    },
    /// The file ends early.
    #[error("the .clod file is cut short: it has {found} of {expected} bytes; copy or build it again")]
    Truncated {
        /// Number of bytes that there should be.
        expected: u64,
        /// Number of bytes that there are.
        found: u64,
    },
    /// The file goes on after its end.
    #[error(
        "the .clod file has {found} bytes where {expected} are expected: it is damaged; copy or build it again"
    )]
    Overlong {
        /// Number of bytes that there should be.
        expected: u64,
        /// Number of bytes that there are.
        found: u64,
    },
    /// The numbers of elements do not fit the length of the file.
    #[error(
        "the .clod file is damaged: its elements take {expected} bytes, but its body has {found}; copy or build it again"
    )]
    Counts {
        /// Number of bytes that the elements take.
        expected: u64,
        /// Number of bytes that the body has.
        found: u64,
    },
    /// The content is not what was written.
    #[error(
        "the .clod file is damaged: its checksum is {computed:08x} where {stored:08x} was stored; copy or build it again"
    )]
    Checksum {
        /// The checksum in the header.
        stored: u32,
        /// The checksum of the body.
        computed: u32,
    },
    /// An element breaks an invariant that queries rely on.
    #[error("not a valid hierarchy: {place}: {what}; build it again from its mesh")]
    Invalid {
        /// The element, such as `node 17`.
        place: String,
        /// The defect.
        what: String,
    },
}

impl ClodError {
    pub(super) fn invalid(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self::Invalid { place: place.into(), what: what.into() }
    }

    fn reading(source: io::Error) -> Self {
        Self::Io { doing: "read the hierarchy", path: None, source }
    }

    /// Names the file in an error of the operating system.
    fn at(self, file: &Path) -> Self {
        match self {
            Self::Io { doing, source, .. } => Self::Io { doing, path: Some(file.to_owned()), source },
            other => other,
        }
    }
}

impl Parts {
    /// Writes the hierarchy in the `.clod` format. The same hierarchy gives the same bytes.
    ///
    /// # Errors
    /// If the hierarchy is not [valid](Self::validate), so that it could not be read back, or `out` refuses.
    pub fn write(&self, out: impl Write) -> Result<(), ClodError> {
        self.validate()?;
        // The checksum precedes the body: encode once for it, and again for the output, rather than hold a
        // copy.
        let mut checksum = Checksum { digest: crc32fast::Hasher::new(), bytes: 0 };
        let mut out = BufWriter::with_capacity(BLOCK_BYTES, out);
        let mut write = || {
            self.write_body(&mut checksum)?;
            out.write_all(&MAGIC)?;
            out.write_all(&VERSION.to_le_bytes())?;
            out.write_all(&checksum.bytes.to_le_bytes())?;
            out.write_all(&checksum.digest.clone().finalize().to_le_bytes())?;
            self.write_body(&mut out)?;
            out.flush()
        };
        write().map_err(|source| ClodError::Io { doing: "write the hierarchy", path: None, source })
    }

    /// Writes the hierarchy to a file in the `.clod` format.
    ///
    /// # Errors
    /// As [`write`](Self::write); also if the file cannot be created.
    pub fn save(&self, path: &Path) -> Result<(), ClodError> {
        self.validate()?;
        let file = File::create(path).map_err(|source| ClodError::Io {
            doing: "create",
            path: Some(path.to_owned()),
            source,
        })?;
        self.write(file).map_err(|error| error.at(path))
    }

    /// Reads a hierarchy in the `.clod` format, and nothing beyond its end.
    ///
    /// # Errors
    /// If the bytes are not a complete, undamaged and [valid](Self::validate) hierarchy of this version of
    /// the format, or the input fails. Allocates no more than a small multiple of the bytes read, whatever
    /// the file claims.
    pub fn read(input: impl Read) -> Result<Self, ClodError> {
        Self::read_expecting(input, None)
    }

    /// Reads a hierarchy from a file in the `.clod` format.
    ///
    /// # Errors
    /// As [`read`](Self::read); also if the file cannot be opened or goes on after the hierarchy's end.
    pub fn load(path: &Path) -> Result<Self, ClodError> {
        let open = || {
            let file = File::open(path)?;
            let metadata = file.metadata()?;
            Ok((file, metadata.is_file().then_some(metadata.len())))
        };
        let (file, length) =
            open().map_err(|source| ClodError::Io { doing: "open", path: Some(path.to_owned()), source })?;
        Self::read_expecting(file, length).map_err(|error| error.at(path))
    }

    /// Reads a hierarchy from an input whose length (bytes) is known or not.
    fn read_expecting(mut input: impl Read, length: Option<u64>) -> Result<Self, ClodError> {
        let mut header = Vec::with_capacity(HEADER_BYTES);
        input.by_ref().take(HEADER_BYTES as u64).read_to_end(&mut header).map_err(ClodError::reading)?;
        let magic = &header[..header.len().min(MAGIC.len())];
        if magic.is_empty() || *magic != MAGIC[..magic.len()] {
            return Err(ClodError::NotClod { found: magic.to_vec() });
        }
        if header.len() < HEADER_BYTES {
            return Err(ClodError::Truncated { expected: HEADER_BYTES as u64, found: header.len() as u64 });
        }
        let mut fields = Fields(&header[MAGIC.len()..]);
        let version = fields.u32();
        if version != VERSION {
            return Err(ClodError::Version { found: version });
        }
        let body_bytes = fields.u64();
        let stored = fields.u32();
        let expected = body_bytes.saturating_add(HEADER_BYTES as u64);
        match length {
            Some(found) if found < expected => return Err(ClodError::Truncated { expected, found }),
            Some(found) if found > expected => return Err(ClodError::Overlong { expected, found }),
            _ => {}
        }
        let mut body = Body {
            input,
            digest: crc32fast::Hasher::new(),
            bytes_read: HEADER_BYTES as u64,
            bytes_expected: expected,
            length_known: length.is_some(),
            block: Vec::with_capacity(BLOCK_BYTES + 32),
        };
        let clod = body.read(body_bytes)?;
        let computed = body.digest.finalize();
        if computed != stored {
            return Err(ClodError::Checksum { stored, computed });
        }
        clod.validate()?;
        Ok(clod)
    }

    fn write_body(&self, out: &mut impl Write) -> io::Result<()> {
        // Validation has checked that the counts fit into u32.
        for count in [self.levels.len(), self.nodes.len(), self.vertices.len(), self.triangles.len()] {
            out.write_all(&(count as u32).to_le_bytes())?;
        }
        let source = &self.source;
        write_u32s(out, [source.vertices, source.triangles, u32::from(source.solid)])?;
        write_f64s(out, [source.tolerance, source.bounding_radius])?;
        write_f64s(out, source.center.to_array())?;
        write_f64s(out, [source.volume])?;
        write_f64s(out, source.center_of_mass.to_array())?;
        write_f64s(out, source.unit_inertia.to_cols_array())?;
        for level in &self.levels {
            write_u32s(out, [level.nodes.start, level.nodes.end, level.triangles, u32::from(level.free)])?;
            write_f64s(out, [level.resolution])?;
        }
        for node in &self.nodes {
            write_u32s(out, [node.parent, node.children.start, node.children.end, node.level])?;
            write_u32s(out, [node.vertices.start, node.vertices.end, node.extreme, node.added])?;
            write_u32s(out, [node.triangles.start, node.triangles.end])?;
            write_u32s(out, [u32::from(node.contained) | u32::from(node.all_real) << 1])?;
            write_f64s(out, node.center.to_array())?;
            write_f64s(out, [node.radius, node.deviation, node.hausdorff])?;
        }
        for vertex in &self.vertices {
            write_f64s(out, vertex.to_array())?;
        }
        for area in &self.support_areas {
            write_f64s(out, [*area])?;
        }
        for triangle in &self.triangles {
            write_u32s(out, *triangle)?;
        }
        Ok(())
    }
}

impl Clod {
    /// Writes the hierarchy in the `.clod` format. The same hierarchy gives the same bytes.
    ///
    /// # Errors
    /// If `out` refuses.
    pub fn write(&self, out: impl Write) -> Result<(), ClodError> {
        self.parts().write(out)
    }

    /// Writes the hierarchy to a file in the `.clod` format.
    ///
    /// # Errors
    /// As [`write`](Self::write); also if the file cannot be created.
    pub fn save(&self, path: &Path) -> Result<(), ClodError> {
        self.parts().save(path)
    }

    /// Reads a hierarchy in the `.clod` format, and nothing beyond its end.
    ///
    /// # Errors
    /// As [`Parts::read`], and those of [`pack`](Self::pack).
    pub fn read(input: impl Read) -> Result<Self, ClodError> {
        Self::pack_valid(&Parts::read(input)?)
    }

    /// Reads a hierarchy from a file in the `.clod` format.
    ///
    /// # Errors
    /// As [`read`](Self::read); also if the file cannot be opened or goes on after the hierarchy's end.
    pub fn load(path: &Path) -> Result<Self, ClodError> {
        Self::pack_valid(&Parts::load(path)?)
    }
}

fn write_u32s<const N: usize>(out: &mut impl Write, values: [u32; N]) -> io::Result<()> {
    out.write_all(values.map(u32::to_le_bytes).as_flattened())
}

fn write_f64s<const N: usize>(out: &mut impl Write, values: [f64; N]) -> io::Result<()> {
    out.write_all(values.map(f64::to_le_bytes).as_flattened())
}

/// An output that only counts the body's bytes and computes their checksum.
struct Checksum {
    digest: crc32fast::Hasher,
    bytes: u64,
}

impl Write for Checksum {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.digest.update(bytes);
        self.bytes += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The fields of a record, read one after the other. The record must have enough bytes.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let (field, rest) = self.0.split_first_chunk().expect("records are as long as their fields");
        self.0 = rest;
        *field
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.bytes())
    }

    fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.bytes())
    }

    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.bytes())
    }

    fn vector(&mut self) -> DVec3 {
        DVec3::new(self.f64(), self.f64(), self.f64())
    }

    fn range(&mut self) -> std::ops::Range<u32> {
        self.u32()..self.u32()
    }

    /// Reads a word of flags; sets `unknown` if one is set that is not among the `known`.
    fn flags(&mut self, known: u32, unknown: &mut bool) -> u32 {
        let flags = self.u32();
        *unknown |= flags & !known != 0;
        flags
    }
}

/// A reader of records that counts their bytes and computes their checksum.
struct Body<R> {
    input: R,
    digest: crc32fast::Hasher,
    bytes_read: u64,
    bytes_expected: u64,
    length_known: bool,
    block: Vec<u8>,
}

impl<R: Read> Body<R> {
    /// Reads the whole body, whose length is `body_bytes` according to the header.
    fn read(&mut self, body_bytes: u64) -> Result<Parts, ClodError> {
        let mut unknown = false;
        let mut counts = Fields(self.block(COUNTS_BYTES)?);
        let [level_count, node_count, vertex_count, triangle_count] = [0; 4].map(|_| counts.u32());
        let elements = [
            (level_count, LEVEL_BYTES),
            (node_count, NODE_BYTES),
            (vertex_count, VERTEX_BYTES + AREA_BYTES),
            (triangle_count, TRIANGLE_BYTES),
        ];
        // Four products of 32-bit counts with small sizes cannot overflow.
        let expected = (COUNTS_BYTES + SOURCE_BYTES) as u64
            + elements.map(|(count, size)| u64::from(count) * size as u64).iter().sum::<u64>();
        if expected != body_bytes {
            return Err(ClodError::Counts { expected, found: body_bytes });
        }

        let mut fields = Fields(self.block(SOURCE_BYTES)?);
        let source = Source {
            vertices: fields.u32(),
            triangles: fields.u32(),
            solid: fields.flags(1, &mut unknown) & 1 != 0,
            tolerance: fields.f64(),
            bounding_radius: fields.f64(),
            center: fields.vector(),
            volume: fields.f64(),
            center_of_mass: fields.vector(),
            unit_inertia: DMat3::from_cols(fields.vector(), fields.vector(), fields.vector()),
        };
        let levels = self.array::<LEVEL_BYTES, _>(level_count, |mut fields| {
            let nodes = fields.range();
            let triangles = fields.u32();
            let free = fields.flags(1, &mut unknown) & 1 != 0;
            Level { nodes, triangles, resolution: fields.f64(), free }
        })?;
        let nodes = self.array::<NODE_BYTES, _>(node_count, |mut fields| {
            let parent = fields.u32();
            let children = fields.range();
            let level = fields.u32();
            let vertices = fields.range();
            let extreme = fields.u32();
            let added = fields.u32();
            let triangles = fields.range();
            let flags = fields.flags(3, &mut unknown);
            Node {
                parent,
                children,
                level,
                vertices,
                extreme,
                added,
                triangles,
                center: fields.vector(),
                radius: fields.f64(),
                deviation: fields.f64(),
                hausdorff: fields.f64(),
                contained: flags & 1 != 0,
                all_real: flags & 2 != 0,
            }
        })?;
        let vertices = self.array::<VERTEX_BYTES, _>(vertex_count, |mut fields| fields.vector())?;
        let support_areas = self.array::<AREA_BYTES, _>(vertex_count, |mut fields| fields.f64())?;
        let triangles =
            self.array::<TRIANGLE_BYTES, _>(triangle_count, |mut fields| [0; 3].map(|_| fields.u32()))?;
        if unknown {
            return Err(ClodError::invalid("flags", "some that this version does not know are set"));
        }
        Ok(Parts { levels, nodes, vertices, support_areas, triangles, source })
    }

    /// Reads the next bytes.
    fn block(&mut self, bytes: usize) -> Result<&[u8], ClodError> {
        self.block.clear();
        self.input.by_ref().take(bytes as u64).read_to_end(&mut self.block).map_err(ClodError::reading)?;
        self.bytes_read += self.block.len() as u64;
        if self.block.len() < bytes {
            return Err(ClodError::Truncated { expected: self.bytes_expected, found: self.bytes_read });
        }
        self.digest.update(&self.block);
        Ok(&self.block)
    }

    /// Reads the next `count` records of `N` bytes. Allocates as they come, unless the file is known to be
    /// long enough.
    fn array<const N: usize, T>(
        &mut self,
        count: u32,
        mut decode: impl FnMut(Fields<'_>) -> T,
    ) -> Result<Vec<T>, ClodError> {
        let per_block = BLOCK_BYTES / N;
        let mut remaining = count as usize;
        let mut records = Vec::with_capacity(if self.length_known { remaining } else { 0 });
        while remaining > 0 {
            let now = remaining.min(per_block);
            let block = self.block(now * N)?;
            records.extend(block.as_chunks::<N>().0.iter().map(|record| decode(Fields(record))));
            remaining -= now;
        }
        Ok(records)
    }
}
