//! Bodies prepared for queries.

use std::sync::Arc;

use glam::DVec3;
use palpate_core::TriMesh;
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};
use rayon::prelude::*;

use crate::bricks::DistanceField;
use crate::exact::ExactDistance;
use crate::features::FeatureMesh;
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

    /// Lattice constant of the field of a mesh, m.
    fn lattice_of(&self, mesh: &TriMesh) -> f64 {
        self.lattice(whole_area(mesh)).max(DistanceField::finest_lattice(mesh, self.band))
    }
}

/// A body prepared for queries: a distance field, and samples of its surface.
#[derive(Clone, Debug)]
pub struct FieldBody {
    pub(crate) center: DVec3,
    pub(crate) radius: f64,
    pub(crate) field: DistanceField,
    pub(crate) samples: SurfaceSamples,
    /// The surface itself, on which the deepest places are measured.
    pub(crate) features: Arc<FeatureMesh>,
    pub(crate) error: f64,
}

impl FieldBody {
    /// Prepares the body of a mesh.
    ///
    /// # Panics
    /// If the mesh has no triangles, the tolerance is not finite and above 0, or the band is smaller than the
    /// tolerance.
    pub fn new(mesh: &TriMesh, options: &FieldOptions) -> Self {
        Self::sharing(mesh, Arc::new(FeatureMesh::new(mesh)), options)
    }

    /// The same for a mesh with its linked features.
    ///
    /// # Panics
    /// As [`new`](Self::new).
    pub fn sharing(mesh: &TriMesh, features: Arc<FeatureMesh>, options: &FieldOptions) -> Self {
        let FieldOptions { tolerance, band, memory } = *options;
        let is_band = band.is_finite() && tolerance > 0.0 && band >= tolerance;
        assert!(is_band, "a tolerance of {tolerance} m and a band of {band} m");
        let area = whole_area(mesh);
        let memory = memory as f64;
        let spacing =
            SurfaceSamples::spacing(area, (1.0 - FIELD_SHARE) * memory).max(MIN_SPACING * tolerance);
        Self::made(mesh, features, options.lattice_of(mesh), (tolerance, band), spacing)
    }

    /// The [error](Self::error) of the body of a mesh, m, without preparing it.
    ///
    /// # Panics
    /// As [`new`](Self::new).
    pub fn expected_error(mesh: &TriMesh, options: &FieldOptions) -> f64 {
        let FieldOptions { tolerance, band, .. } = *options;
        error(mesh, &ExactDistance::new(mesh), (options.lattice_of(mesh), band), tolerance)
    }

    /// Prepares the body of a mesh, with a lattice constant, a tolerance and a band, and a spacing of the
    /// finest samples (m).
    fn made(
        mesh: &TriMesh,
        features: Arc<FeatureMesh>,
        lattice: f64,
        (tolerance, band): (f64, f64),
        spacing: f64,
    ) -> Self {
        let exact = &features.exact;
        let sphere = mesh.bounding_sphere();
        let (field, samples) = rayon::join(
            || DistanceField::new(mesh, exact, lattice, band),
            || SurfaceSamples::new(mesh, spacing),
        );
        let error = error(mesh, exact, (lattice, band), tolerance);
        Self { center: sphere.center, radius: sphere.radius, field, samples, features, error }
    }

    /// The body of a mesh with a lattice constant, a tolerance and a band, and a spacing of the finest
    /// samples (m).
    #[cfg(test)]
    pub(crate) fn with(mesh: &TriMesh, lattice: f64, bands: (f64, f64), spacing: f64) -> Self {
        Self::made(mesh, Arc::new(FeatureMesh::new(mesh)), lattice, bands, spacing)
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
        self.field.bytes() + self.samples.bytes() + self.features.bytes()
    }

    /// Writes the body as bytes, without the features of its mesh.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut writer = Writer(Vec::with_capacity(self.bytes()));
        writer.vec(self.center);
        writer.f64([self.radius, self.error]);
        self.field.write(&mut writer);
        self.samples.write(&mut writer);
        writer.finish()
    }

    /// Reads the body that [`to_bytes`](Self::to_bytes) wrote, of a mesh with these features.
    ///
    /// # Errors
    /// If the bytes are not those of a body, are damaged, or have another version of the format.
    pub fn from_bytes(bytes: &[u8], features: Arc<FeatureMesh>) -> Result<Self, FormatError> {
        let mut reader = Reader::new(bytes)?;
        let body = Self {
            center: reader.vec()?,
            radius: reader.positive()?,
            error: reader.f64()?,
            field: DistanceField::read_from(&mut reader)?,
            samples: SurfaceSamples::read_from(&mut reader)?,
            features,
        };
        reader.finish()?;
        Ok(body)
    }
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    (b - a).cross(c - a).length() / 2.0
}

fn whole_area(mesh: &TriMesh) -> f64 {
    (0..mesh.triangles().len()).map(|t| area(mesh.corners(t))).sum()
}

/// Largest error of the field of a mesh, with a lattice constant and a band, at places within the tolerance
/// of the surface, m. The field need not exist: distances at the corners of some thousand cells make the same
/// numbers.
fn error(mesh: &TriMesh, exact: &ExactDistance, (lattice, band): (f64, f64), tolerance: f64) -> f64 {
    let expected = DistanceField::expected(mesh, exact, (lattice, band));
    let whole = whole_area(mesh);
    // Places are equally spaced in the running sum of the triangles' areas.
    let mut before = 0.0;
    let ends: Vec<f64> = (0..mesh.triangles().len())
        .map(|t| {
            before += area(mesh.corners(t));
            before
        })
        .collect();
    let errors = (0..TESTED_PLACES).into_par_iter().map(|index| {
        let mut rng = SmallRng::seed_from_u64(SEED ^ index as u64);
        let at = (index as f64 + rng.random_range(0.0..1.0)) / TESTED_PLACES as f64 * whole;
        let triangle = ends.partition_point(|end| *end <= at).min(ends.len() - 1);
        let [a, b, c] = mesh.corners(triangle);
        let (mut u, mut v): (f64, f64) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        let off = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        let point = a + u * (b - a) + v * (c - a) + tolerance * off.clamp_length_max(1.0);
        (expected(point) - exact.nearest(point, 0).distance).abs()
    });
    errors.reduce(|| 0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use glam::DQuat;
    use palpate_core::Pose;
    use palpate_models::Model;
    use wide::f32x4;

    use super::*;
    use crate::query::{FieldQuery, FieldSettings};

    /// A body and its mesh's triangles about `origin` (m) in place of the mesh's own origin.
    fn moved(mesh: &TriMesh, scale: f64, origin: DVec3) -> TriMesh {
        let vertices = mesh.vertices().iter().map(|vertex| scale * *vertex + origin).collect();
        TriMesh::new(vertices, mesh.triangles().to_vec()).expect("a mesh")
    }

    /// CAD parts are often placed in the frame of their assembly, so that their own origin is far away.
    /// Single precision has steps of 0.24 mm at 4 km: what it holds has to be relative to the body.
    #[test]
    fn a_body_far_from_its_meshs_origin_has_the_same_contacts() {
        let mesh = Model::Torus.generate(2000).expect("in range");
        let unit = 1.0 / mesh.bounding_sphere().radius;
        let turn = DQuat::from_scaled_axis(DVec3::new(0.3, 0.2, 1.0));
        let places = [(0.02, 4e3), (0.002, 360.0), (0.02, 1e6), (1.0, 1e7)];
        for (radius, away) in places {
            let tolerance = 0.02 * radius;
            // How far apart they touch is searched about the origin.
            let mut apart = 2.0;
            let found = [0.0, away].map(|away| {
                let origins = [DVec3::new(away, -0.3 * away, 0.1 * away), DVec3::new(0.0, away, away)];
                let options = FieldOptions { memory: 200_000, ..FieldOptions::new(tolerance) };
                let [probe, scene] =
                    origins.map(|origin| FieldBody::new(&moved(&mesh, unit * radius, origin), &options));
                // Poses that undo the places of the meshes in their frames.
                let pose =
                    |turn: DQuat, center: DVec3, origin: DVec3| Pose::new(center - turn * origin, turn);
                let scene_pose = pose(DQuat::IDENTITY, DVec3::ZERO, origins[1]);
                let mut query = FieldQuery::new(&probe, &scene, 0.25);
                let mut contacts = Vec::new();
                loop {
                    let at = pose(turn, DVec3::new(apart, 0.2, 0.0) * radius, origins[0]);
                    query.reset();
                    query.run(&probe, &scene, &at, &scene_pose, &FieldSettings::new(tolerance));
                    contacts.clear();
                    query.append_contacts(&probe, &at, &mut contacts);
                    if away > 0.0 || contacts.iter().any(|found| found.contact.depth > 0.3 * tolerance) {
                        break;
                    }
                    apart -= 0.01;
                }
                let deepest =
                    contacts.iter().map(|found| found.contact.depth).fold(f64::NEG_INFINITY, f64::max);
                let area: f64 = contacts.iter().map(|found| found.area).sum();
                (probe.error() / radius, deepest / radius, area / (radius * radius))
            });
            let [(error, depth, area), (far_error, far_depth, far_area)] = found;
            assert!(depth > 0.0 && area > 0.0, "{depth} {area}");
            assert!((far_depth - depth).abs() < 1e-3, "{radius} m at {away} m: {far_depth} for {depth}");
            assert!((far_area / area - 1.0).abs() < 0.1, "{radius} m at {away} m: {far_area} for {area}");
            assert!(far_error < 1.5 * error + 1e-4, "{radius} m at {away} m: {far_error} for {error}");
        }
    }

    /// A field's error is known before it is made: what it would be read as, it is read as.
    #[test]
    fn the_error_is_known_without_the_field() {
        let mesh = Model::Gear.generate(2000).expect("in range");
        let radius = mesh.bounding_sphere().radius;
        let options = FieldOptions { memory: 500_000, ..FieldOptions::new(0.03 * radius) };
        let body = FieldBody::new(&mesh, &options);
        assert_eq!(FieldBody::expected_error(&mesh, &options), body.error());
        let exact = ExactDistance::new(&mesh);
        let expected = DistanceField::expected(&mesh, &exact, (body.field.spacing(), options.band));
        let mut rng = SmallRng::seed_from_u64(0xE55);
        let (mut largest, mut found_largest) = (0.0_f64, 0.0_f64);
        for index in 0..20_000 {
            let off = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let [a, b, c] = mesh.corners(index % mesh.triangles().len());
            let point = (a + b + c) / 3.0 + options.tolerance * off.clamp_length_max(1.0);
            let spacing = body.field.spacing();
            let at = ((point - body.field.origin()) / spacing).as_vec3().to_array().map(f32x4::splat);
            let [read, ..] = body.field.read::<false>(&at);
            let read = f64::from(read.to_array()[0]) * spacing;
            largest = largest.max((read - expected(point)).abs());
            found_largest = found_largest.max((read - exact.nearest(point, 0).distance).abs());
        }
        assert!(largest < 1e-4 * options.tolerance, "{largest} m off");
        // The error told is that of the field, at other places: not far below the largest.
        let (told, found) = (body.error(), found_largest);
        assert!(told > 0.6 * found && told < 2.0 * found, "{told} told, {found} found");
    }

    /// The cubes around a probe are many, and those with contacts few.
    #[test]
    fn the_workspace_of_a_query_is_as_large_as_what_it_finds() {
        let mesh = Model::Torus.generate(2000).expect("in range");
        let radius = mesh.bounding_sphere().radius;
        let body = FieldBody::new(&mesh, &FieldOptions::new(0.01 * radius));
        let run = |edge: f64, away: f64| {
            let mut query = FieldQuery::new(&body, &body, edge);
            let empty = query.bytes();
            let pose = Pose::from_translation(DVec3::X * away * radius);
            query.run(&body, &body, &pose, &Pose::IDENTITY, &FieldSettings::new(0.01 * radius));
            (empty, query.bytes(), query.outcome().contacts)
        };
        for edge in [0.25, 0.05] {
            let (empty, apart, none) = run(edge, 3.0);
            let (_, touching, some) = run(edge, 1.99);
            let (_, deep, many) = run(edge, 1.8);
            assert!(none == 0 && some > 20 && many > some, "{none}, {some}, {many} contacts");
            // A table of the finer cubes alone would take 25 MB.
            assert!(empty < 200_000 && apart < 250_000, "{empty} and {apart} bytes");
            assert!(touching < 1_500_000 && deep < 8_000_000, "{touching} and {deep} bytes");
        }
    }
}
