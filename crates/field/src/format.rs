//! The file format of bodies: a header and a body of fixed-size little-endian records.
//!
//! | part | content |
//! |---|---|
//! | header, 24 bytes | magic `palpfeld`, version u32, length of the body u64, CRC-32 (IEEE) of the body u32 |
//! | body | centre and radius of the bounding sphere, error (5 f64) |
//! | field | origin, lattice constant, band, step (6 f64), bricks along each axis (3 u32), samples (u32) |
//! | | index of each brick's samples (u32), whether it is inside (u8); coarse squares (f32); samples (i16) |
//! | samples | centre (3 f64), area of a sample (f64), samples (u32), levels (u32); the finest (i8) |
//! | | for each level above: number of fours (u32), samples (12 f32 each), spheres (16 f32 each) |
//! | tree | centre (3 f64), nodes (u32), triangles (u32), connected parts (u32) |
//! | | each node: centre, axes, half edges (15 f32), link (u32); corners (9 f32); points of the parts (3 f32) |
//!
//! Files are not trusted: the length and the checksum are checked first, every count is compared with its
//! only valid value, and indices are checked.

use glam::{DVec3, UVec3};
use wide::f32x4;

const MAGIC: [u8; 8] = *b"palpfeld";
const VERSION: u32 = 2;
const HEADER_BYTES: usize = 24;

/// Error of reading a body from bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FormatError {
    /// The bytes do not begin with the format's magic number.
    #[error("not a distance field of palpate: make it again from its mesh")]
    NotAField,
    /// The bytes have another version of the format.
    #[error(
        "the distance field has format version {found}, but this program reads version {VERSION}: make it again from its mesh"
    )]
    Version {
        /// The version of the bytes.
        found: u32,
    },
    /// The bytes are not those that were written.
    #[error("the distance field is damaged: make it again from its mesh")]
    Damaged,
}

/// A writer of records.
pub(crate) struct Writer(pub Vec<u8>);

impl Writer {
    /// The bytes written, after the header.
    pub fn finish(mut self) -> Vec<u8> {
        let mut all = Self(Vec::with_capacity(HEADER_BYTES + self.0.len()));
        all.u8(MAGIC);
        all.u32([VERSION]);
        all.u8((self.0.len() as u64).to_le_bytes());
        all.u32([crc32fast::hash(&self.0)]);
        all.0.append(&mut self.0);
        all.0
    }

    pub fn u8(&mut self, values: impl IntoIterator<Item = u8>) {
        self.0.extend(values);
    }

    pub fn u32(&mut self, values: impl IntoIterator<Item = u32>) {
        values.into_iter().for_each(|value| self.0.extend_from_slice(&value.to_le_bytes()));
    }

    pub fn f32(&mut self, values: impl IntoIterator<Item = f32>) {
        values.into_iter().for_each(|value| self.0.extend_from_slice(&value.to_le_bytes()));
    }

    pub fn f64(&mut self, values: impl IntoIterator<Item = f64>) {
        values.into_iter().for_each(|value| self.0.extend_from_slice(&value.to_le_bytes()));
    }

    pub fn vec(&mut self, value: DVec3) {
        self.f64(value.to_array());
    }

    pub fn fours<const N: usize>(&mut self, fours: &[[f32x4; N]]) {
        for four in fours.iter().flatten() {
            self.f32(four.to_array());
        }
    }
}

/// A reader of records.
pub(crate) struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// A reader of the body, once the header before it is checked.
    pub fn new(bytes: &'a [u8]) -> Result<Self, FormatError> {
        let mut reader = Reader(bytes.strip_prefix(&MAGIC).ok_or(FormatError::NotAField)?);
        let found = reader.u32()?;
        if found != VERSION {
            return Err(FormatError::Version { found });
        }
        let length = u64::from_le_bytes(reader.array()?);
        let stored = reader.u32()?;
        let is_whole = length == reader.0.len() as u64 && stored == crc32fast::hash(reader.0);
        is_whole.then_some(reader).ok_or(FormatError::Damaged)
    }

    /// Checks that nothing is left to read.
    pub fn finish(self) -> Result<(), FormatError> {
        if self.0.is_empty() { Ok(()) } else { Err(FormatError::Damaged) }
    }

    /// Reads the bytes of `count` records of `each` bytes.
    pub fn bytes(&mut self, count: usize, each: usize) -> Result<&'a [u8], FormatError> {
        let length = count.checked_mul(each).ok_or(FormatError::Damaged)?;
        let (taken, left) = self.0.split_at_checked(length).ok_or(FormatError::Damaged)?;
        self.0 = left;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], FormatError> {
        self.bytes(1, N)?.try_into().map_err(|_| FormatError::Damaged)
    }

    pub fn u32(&mut self) -> Result<u32, FormatError> {
        self.array().map(u32::from_le_bytes)
    }

    pub fn u32s(&mut self, count: usize) -> Result<Vec<u32>, FormatError> {
        Ok(self.bytes(count, 4)?.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect())
    }

    /// Reads numbers, none of which may be NaN.
    pub fn f32s(&mut self, count: usize) -> Result<Vec<f32>, FormatError> {
        let values: Vec<f32> =
            self.bytes(count, 4)?.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        if values.iter().any(|value| value.is_nan()) { Err(FormatError::Damaged) } else { Ok(values) }
    }

    /// Reads a number, which must be finite.
    pub fn f64(&mut self) -> Result<f64, FormatError> {
        let value = f64::from_le_bytes(self.array()?);
        if value.is_finite() { Ok(value) } else { Err(FormatError::Damaged) }
    }

    /// Reads a number, which must be finite and above 0.
    pub fn positive(&mut self) -> Result<f64, FormatError> {
        self.f64().and_then(|value| if value > 0.0 { Ok(value) } else { Err(FormatError::Damaged) })
    }

    pub fn vec(&mut self) -> Result<DVec3, FormatError> {
        Ok(DVec3::new(self.f64()?, self.f64()?, self.f64()?))
    }

    pub fn uvec(&mut self) -> Result<UVec3, FormatError> {
        Ok(UVec3::new(self.u32()?, self.u32()?, self.u32()?))
    }

    pub fn fours<const N: usize>(&mut self, count: usize) -> Result<Vec<[f32x4; N]>, FormatError> {
        let values = self.f32s(count.checked_mul(4 * N).ok_or(FormatError::Damaged)?)?;
        let fours = values.as_chunks::<4>().0.iter().map(|four| f32x4::new(*four)).collect::<Vec<_>>();
        Ok(fours.as_chunks().0.to_vec())
    }
}

#[cfg(test)]
mod tests {
    use palpate_models::Model;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;
    use crate::body::{FieldBody, FieldOptions};

    #[test]
    fn a_body_survives_its_bytes_and_damage_is_refused() {
        let mesh = Model::Torus.generate(2000).expect("in range");
        let options =
            FieldOptions { memory: 500_000, ..FieldOptions::new(0.03 * mesh.bounding_sphere().radius) };
        let body = FieldBody::new(&mesh, &options);
        let bytes = body.to_bytes();
        assert_eq!(FieldBody::from_bytes(&bytes, body.features.clone()).expect("whole").to_bytes(), bytes);
        let refused =
            |bytes: &[u8]| FieldBody::from_bytes(bytes, body.features.clone()).expect_err("damaged");
        assert_eq!(refused(b""), FormatError::NotAField);
        assert_eq!(refused(&bytes[..bytes.len() - 1]), FormatError::Damaged);
        assert_eq!(refused(&[bytes.clone(), vec![0]].concat()), FormatError::Damaged);
        let mut other = bytes.clone();
        other[8] += 1;
        assert_eq!(refused(&other), FormatError::Version { found: VERSION + 1 });
        // With a corrected checksum, damaged content is refused or harmless.
        let mut rng = StdRng::seed_from_u64(0xF11E);
        for _ in 0..300 {
            let mut other = bytes.clone();
            let end = if rng.random_bool(0.5) { HEADER_BYTES + 200 } else { other.len() };
            let place = rng.random_range(HEADER_BYTES..end);
            other[place] ^= 1 << rng.random_range(0..8);
            assert_eq!(refused(&other), FormatError::Damaged);
            let sum = crc32fast::hash(&other[HEADER_BYTES..]).to_le_bytes();
            other[HEADER_BYTES - 4..HEADER_BYTES].copy_from_slice(&sum);
            if let Ok(read) = FieldBody::from_bytes(&other, body.features.clone()) {
                assert_eq!(read.samples.count(), body.samples.count());
            }
        }
    }
}
