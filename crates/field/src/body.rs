//! Bodies prepared for queries.

use glam::{DVec3, Vec3};
use palpate_core::TriMesh;
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};
use rayon::prelude::*;
use wide::f32x4;

use crate::bricks::DistanceField;
use crate::exact::ExactDistance;
use crate::format::{FormatError, Reader, Writer};
use crate::samples::SurfaceSamples;

/// Fraction of a body's memory for its field; the samples get the rest.
const FIELD_SHARE: f64 = 0.6;
/// Smallest lattice constant of a field, in tolerances; larger where memory is short. A larger one costs
/// accuracy near edges.
const MIN_LATTICE: f64 = 0.5;
/// Smallest spacing of the finest samples, in tolerances; larger where memory is short. A larger one misses
/// small contacts.
const MIN_SPACING: f64 = 0.3;
/// Default band, in tolerances.
const DEFAULT_BAND: f64 = 2.0;
/// Number of places at which the field is compared with exact distances.
const TESTED_PLACES: usize = 4096;
/// Seed of these places.
const SEED: u64 = 0x7E57;

/// Options for preparing a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldOptions {
    /// d: surfaces closer than this are in contact, m.
    pub tolerance: f64,
    /// Largest distance known on either side of the surface, m: no query looks further, and bodies that
    /// penetrate deeper push as if they were this deep.
    pub band: f64,
    /// Memory for the body, in bytes. Bodies that are large in comparison with d are sampled more coarsely
    /// to fit.
    pub memory: usize,
}

impl FieldOptions {
    /// Options for queries within a tolerance (d, m), with a band of twice that, and 28 MB a body.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, band: DEFAULT_BAND * tolerance, memory: 28_000_000 }
    }

    /// Lattice constant (m) of the field of a body with a surface area (m²); that of a long and thin body may
    /// be larger.
    pub fn lattice(&self, area: f64) -> f64 {
        DistanceField::lattice(area, self.band, FIELD_SHARE * self.memory as f64)
            .max(MIN_LATTICE * self.tolerance)
    }
}

/// A body prepared for queries: a distance field, and samples of its surface.
#[derive(Clone, Debug)]
pub struct FieldBody {
    pub(crate) center: DVec3,
    pub(crate) radius: f64,
    pub(crate) field: DistanceField,
    pub(crate) samples: SurfaceSamples,
    pub(crate) error: f64,
}

impl FieldBody {
    /// Prepares the body of a mesh.
    ///
    /// # Panics
    /// If the mesh has no triangles, the tolerance is not finite and above 0, or the band is smaller than the
    /// tolerance.
    pub fn new(mesh: &TriMesh, options: &FieldOptions) -> Self {
        let FieldOptions { tolerance, band, memory } = *options;
        let is_band = band.is_finite() && tolerance > 0.0 && band >= tolerance;
        assert!(is_band, "a tolerance of {tolerance} m and a band of {band} m");
        let area: f64 = (0..mesh.triangles().len()).map(|t| area(mesh.corners(t))).sum();
        let memory = memory as f64;
        let spacing =
            SurfaceSamples::spacing(area, (1.0 - FIELD_SHARE) * memory).max(MIN_SPACING * tolerance);
        let lattice = options.lattice(area).max(DistanceField::finest_lattice(mesh, band));
        Self::with(mesh, lattice, (tolerance, band), spacing)
    }

    /// Prepares the body of a mesh, with a lattice constant, a tolerance and a band, and a spacing of the
    /// finest samples (m).
    pub(crate) fn with(mesh: &TriMesh, lattice: f64, (tolerance, band): (f64, f64), spacing: f64) -> Self {
        let exact = ExactDistance::new(mesh);
        let sphere = mesh.bounding_sphere();
        let (field, samples) = rayon::join(
            || DistanceField::new(mesh, &exact, lattice, band),
            || SurfaceSamples::new(mesh, spacing),
        );
        let error = error(&field, &samples, &exact, tolerance);
        Self { center: sphere.center, radius: sphere.radius, field, samples, error }
    }

    /// Largest error of depths in this body's field, m: the largest difference from exact distances at some
    /// thousand places within the tolerance of its surface.
    pub fn error(&self) -> f64 {
        self.error
    }

    /// Centre of its bounding sphere, in the mesh's frame, m.
    pub fn center(&self) -> DVec3 {
        self.center
    }

    /// Bounding radius, m.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.field.bytes() + self.samples.bytes()
    }

    /// Writes the body as bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut writer = Writer(Vec::with_capacity(self.bytes()));
        writer.vec(self.center);
        writer.f64([self.radius, self.error]);
        self.field.write(&mut writer);
        self.samples.write(&mut writer);
        writer.finish()
    }

    /// Reads the body that [`to_bytes`](Self::to_bytes) wrote.
    ///
    /// # Errors
    /// If the bytes are not those of a body, are damaged, or have another version of the format.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormatError> {
        let mut reader = Reader::new(bytes)?;
        let body = Self {
            center: reader.vec()?,
            radius: reader.positive()?,
            error: reader.f64()?,
            field: DistanceField::read_from(&mut reader)?,
            samples: SurfaceSamples::read_from(&mut reader)?,
        };
        reader.finish()?;
        Ok(body)
    }
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    (b - a).cross(c - a).length() / 2.0
}

/// Largest error of a field at places within the tolerance of the surface, m.
fn error(field: &DistanceField, samples: &SurfaceSamples, exact: &ExactDistance, tolerance: f64) -> f64 {
    let fours = samples.fours(0);
    let errors = (0..TESTED_PLACES.min(fours)).into_par_iter().map(|index| {
        let mut rng = SmallRng::seed_from_u64(SEED ^ index as u64);
        let on = samples.four(0, (index * fours) / TESTED_PLACES.min(fours)).map(|axis| axis.to_array()[0]);
        let off = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        let point = Vec3::from(on).as_dvec3() + tolerance * off.clamp_length_max(1.0);
        let at = (point - field.origin()) / field.spacing();
        let [found, ..] = field.read::<false>(&at.as_vec3().to_array().map(f32x4::splat));
        (f64::from(found.to_array()[0]) * field.spacing() - exact.nearest(point, 0).distance).abs()
    });
    errors.reduce(|| 0.0, f64::max)
}
