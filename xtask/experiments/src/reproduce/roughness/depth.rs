//! Depth of a spherical probe over a sinusoidal plate, by `DepthQuery` (§4.5.1, Fig. 4.7).

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use palpate::Pose;
use palpate::core::TriMesh;
use palpate::core::mesh::UvMesh;
use palpate::glam::{DQuat, DVec2, DVec3};
use palpate::texture_pd::{
    CpuBackend, DepthQuery, DepthSettings, Domain, HeightImage, SurfaceId, SurfaceSet, TextureContact,
    TextureFilter, TexturedSurface, Wrap,
};

/// Height of the plate from groove to ridge, m. The dissertation gives none; this is the height of the raised
/// dots on Klatzky and Lederman's plates.
pub const HEIGHT: f64 = 0.4e-3;

/// Texels of the plate's image along one period, and of the probe's image along and across the motion.
const PERIOD_TEXELS: u32 = 64;
const PROBE_TEXELS: [u32; 2] = [512, 32];

/// Half-width of the probe's image about its lowest point, relative to its radius: it contains slopes of up
/// to 3. The grid covers the same width.
const IMAGE_HALF_WIDTH: f64 = 0.96;

/// Resolution at which depths are sampled.
#[derive(Clone, Copy, Debug)]
pub struct Sampling {
    /// Positions in one period.
    pub positions: usize,
    /// Texels along a side of the grid.
    pub grid: u32,
}

/// δ_n and dδ_n/du over one period of the plate, at equal distances from a ridge on. The probe moves at the
/// fixed height at which it touches the mean plane of the ridges and grooves.
#[derive(Clone, Debug)]
pub struct Profile {
    /// Distance of ridges, m.
    pub spacing: f64,
    /// δ_n, m.
    pub depths: Vec<f64>,
    /// dδ_n/du.
    pub gradients: Vec<f64>,
}

impl Profile {
    /// Computes the profile of a sphere of `diameter` (m) over ridges `spacing` (m) apart.
    ///
    /// In the plane of the motion the sphere is the dissertation's disk. It is also curved across, so that
    /// its largest overlap is one point. Both surfaces are narrow strips along the motion, since nothing else
    /// would touch.
    ///
    /// # Errors
    /// If a surface is refused, or the probe has no plate below it.
    pub fn new(diameter: f64, spacing: f64, sampling: &Sampling) -> Result<Self, String> {
        let mut surfaces = SurfaceSet::default();
        let mut add = |surface: TexturedSurface| surfaces.add(&Arc::new(surface)).map_err(text);
        let ids = [add(probe(diameter)?)?, add(plate(diameter, spacing)?)?];
        let settings =
            DepthSettings { grid: sampling.grid, filter: TextureFilter::Finest, ..DepthSettings::default() };
        let (mut query, mut backend) = (DepthQuery::new(), CpuBackend::new());
        let mut profile = Self { spacing, depths: Vec::new(), gradients: Vec::new() };
        for index in 0..sampling.positions {
            let place = spacing * index as f64 / sampling.positions as f64;
            let contact = contact(ids, diameter, place);
            let found = query.run(&surfaces, &[contact], &settings, &mut backend).map_err(text)?;
            let found = found[0].ok_or_else(|| format!("no depth at {place} m of {spacing} m"))?;
            profile.depths.push(found.depth);
            profile.gradients.push(found.linear.x);
        }
        Ok(profile)
    }

    /// Returns dδ_n/du at `place` (m) from a ridge, interpolated between the positions.
    pub fn gradient(&self, place: f64) -> f64 {
        let count = self.gradients.len();
        let at = (place / self.spacing).rem_euclid(1.0) * count as f64;
        let (index, part) = (at as usize, at.fract());
        let [low, high] = [index, index + 1].map(|index| self.gradients[index % count]);
        low + part * (high - low)
    }
}

/// Returns the contact of the probe at `place` (m) from a ridge with the plate.
fn contact([a, b]: [SurfaceId; 2], diameter: f64, place: f64) -> TextureContact {
    let place = DVec3::X * place;
    TextureContact {
        a,
        pose_a: Pose::new(place, DQuat::from_rotation_x(PI)),
        center: place,
        b,
        pose_b: Pose::IDENTITY,
        normal: -DVec3::Z,
        point: place,
        half_size: 0.5 * IMAGE_HALF_WIDTH * diameter,
        reach: diameter,
        domain: Domain::WHOLE,
    }
}

/// Returns the lower side of a sphere, upside down: its lowest point is the origin.
fn probe(diameter: f64) -> Result<TexturedSurface, String> {
    let radius = 0.5 * diameter;
    let [width, height] = PROBE_TEXELS;
    let half = DVec2::new(1.0, f64::from(height) / f64::from(width)) * IMAGE_HALF_WIDTH * radius;
    let at = |index: u32, count: u32| (f64::from(index) + 0.5) / f64::from(count) * 2.0 - 1.0;
    let sphere = (0..width * height).map(|texel| {
        let at = half * DVec2::new(at(texel % width, width), at(texel / width, height));
        ((radius * radius - at.length_squared()).sqrt() - radius) as f32
    });
    let image = HeightImage::new(width, height, sphere.collect(), [Wrap::Clamp; 2]).map_err(text)?;
    strip([-half.x, half.x], half.y, [0.0, 1.0], &image)
}

/// Returns a sinusoid along x with a ridge at the origin, long enough for a probe that moves over one period.
fn plate(diameter: f64, spacing: f64) -> Result<TexturedSurface, String> {
    let cosine = |texel: u32| (TAU * (f64::from(texel) + 0.5) / f64::from(PERIOD_TEXELS)).cos();
    let ridge = (0..PERIOD_TEXELS).map(|texel| (0.5 * HEIGHT * cosine(texel)) as f32).collect();
    let image = HeightImage::new(PERIOD_TEXELS, 1, ridge, [Wrap::Repeat; 2]).map_err(text)?;
    let ends = [-diameter, spacing + diameter];
    strip(ends, diameter, ends.map(|end| end / spacing), &image)
}

/// Returns a plane strip between two places along x, m, with the image's u at its ends and v across.
fn strip(ends: [f64; 2], half: f64, u: [f64; 2], image: &HeightImage) -> Result<TexturedSurface, String> {
    let corners = [[0, 0], [1, 0], [1, 1], [0, 1]];
    let vertices = corners.map(|[x, y]| DVec3::new(ends[x], if y == 0 { -half } else { half }, 0.0));
    let uv = corners.map(|[x, y]| DVec2::new(u[x], y as f64));
    let triangles = vec![[0, 1, 2], [0, 2, 3]];
    let coordinates = triangles.iter().map(|triangle| triangle.map(|corner| uv[corner as usize])).collect();
    let mesh = TriMesh::new(vertices.to_vec(), triangles).map_err(text)?;
    let mesh = UvMesh::new(mesh, coordinates).map_err(text)?;
    TexturedSurface::textured(&mesh, image, 0.5).map_err(text)
}

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}
