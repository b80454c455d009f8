//! Contacts whose domain is a part of their grid.

use std::f64::consts::FRAC_PI_4;
use std::sync::Arc;

use crate::common::{Plates, turned_over};
use glam::{DVec2, DVec3};
use palpate_core::mesh::UvMesh;
use palpate_core::{Pose, TriMesh};
use palpate_texture_pd::{
    CpuBackend, DepthQuery, DepthSettings, Domain, HalfSpace, HeightImage, SurfaceSet, TextureContact,
    TextureDepth, TexturedSurface, Wrap,
};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

fn found(surfaces: &SurfaceSet, contact: &TextureContact, settings: &DepthSettings) -> Option<TextureDepth> {
    let mut query = DepthQuery::new();
    query.run(surfaces, &[*contact], settings, &mut CpuBackend::new()).unwrap()[0]
}

fn inside(half_space: HalfSpace) -> Domain {
    let mut domain = Domain::WHOLE;
    assert!(domain.cut(half_space));
    domain
}

/// Number of cells along a surface's side, and half the side, m.
const CELLS: u32 = 20;
const HALF: f64 = 0.02;

/// Position of a corner, seen from above.
fn corner(i: u32) -> DVec2 {
    (DVec2::new((i % (CELLS + 1)).into(), (i / (CELLS + 1)).into()) / f64::from(CELLS) * 2.0 - 1.0) * HALF
}

/// A square with corners at the given heights, displaced by an image.
fn surface(heights: &[f64], image: &HeightImage) -> Arc<TexturedSurface> {
    let vertices = (0..).zip(heights).map(|(i, height)| corner(i).extend(*height)).collect();
    let triangles: Vec<[u32; 3]> = (0..CELLS * CELLS)
        .flat_map(|i| {
            let first = i / CELLS * (CELLS + 1) + i % CELLS;
            [[first, first + 1, first + CELLS + 2], [first, first + CELLS + 2, first + CELLS + 1]]
        })
        .collect();
    let uv = triangles.iter().map(|t| t.map(|i| corner(i) / HALF)).collect();
    let mesh = UvMesh::new(TriMesh::new(vertices, triangles).unwrap(), uv).unwrap();
    Arc::new(TexturedSurface::textured(&mesh, image, 1.0).unwrap())
}

#[test]
fn surfaces_outside_of_the_domain_have_no_influence() {
    let seed = 57;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut differ = 0;
    for case in 0..40 {
        let mut random = |most: f64| rng.random_range(-most..most);
        let heights: Vec<f64> = (0..(CELLS + 1) * (CELLS + 1)).map(|_| random(3e-4)).collect();
        let half = HalfSpace {
            through: DVec3::new(random(0.003), random(0.003), random(0.01)),
            direction: DVec3::new(random(1.0), random(1.0), random(1.0)),
        };
        let out = half.direction.truncate().normalize();
        // Directions at a corner depend on the cells around it.
        let clear = 3.0 * 2.0 * HALF / f64::from(CELLS);
        let changed: Vec<f64> = (0..)
            .zip(&heights)
            .map(|(i, height)| {
                let beyond = out.dot(corner(i) - half.through.truncate()) > clear;
                height + if beyond { random(2e-3) } else { 0.0 }
            })
            .collect();
        let image = (0..64 * 64).map(|_| random(1e-4) as f32).collect();
        let image = HeightImage::new(64, 64, image, [Wrap::Repeat; 2]).unwrap();
        let place = DVec2::new(random(0.002), random(0.002));
        let depth = |heights: &[f64], domain, temperature| {
            let mut surfaces = SurfaceSet::default();
            let [a, b] = [&surface(&vec![0.0; heights.len()], &image), &surface(heights, &image)]
                .map(|surface| surfaces.add(surface).unwrap());
            let contact = TextureContact {
                a,
                pose_a: turned_over(place, 0.0, DVec3::new(0.01, 0.02, 0.3)),
                center: DVec3::ZERO,
                b,
                pose_b: Pose::IDENTITY,
                normal: -DVec3::Z,
                point: place.extend(0.0),
                half_size: 0.012,
                reach: 0.01,
                domain,
            };
            found(&surfaces, &contact, &DepthSettings { temperature, ..DepthSettings::default() })
        };
        for temperature in [0.0, 1e-5] {
            let both = |domain| [&heights, &changed].map(|heights| depth(heights, domain, temperature));
            let [before, after] = both(inside(half));
            assert!(before.is_some() && before == after, "seed {seed}, case {case}: {before:?} {after:?}");
            let [before, after] = both(Domain::WHOLE);
            differ += u32::from(before != after);
        }
    }
    assert!(differ > 40, "without domains {differ} of 80 differ");
}

/// A border sweeps over a dome's top in steps of 10 µm, with texels of 0.4 mm.
#[test]
fn smooth_maximum_is_continuous_as_its_domain_moves() {
    let dome = |at: DVec2| (0.0025 - at.length_squared()).sqrt() - 0.05;
    let plates = Plates { half: 0.03, relief_a: &dome, relief_b: &|_| 0.0 };
    let (surfaces, ids) = plates.surfaces(256);
    let temperature = 1e-5;
    let settings = DepthSettings { temperature, ..DepthSettings::default() };
    let contact = plates.contact(ids, turned_over(DVec2::ZERO, -0.002, DVec3::ZERO), 0.01);
    let mut jumps = Vec::new();
    for angle in [0.0, 0.3, FRAC_PI_4] {
        let direction = DVec2::from_angle(angle).extend(0.0);
        let depth = |i: i32| {
            let domain = inside(HalfSpace { through: 1e-5 * f64::from(i) * direction, direction });
            found(&surfaces, &TextureContact { domain, ..contact }, &settings).unwrap().depth
        };
        let depths: Vec<_> = (-150..150).map(depth).collect();
        jumps.push(depths.windows(2).map(|pair| (pair[1] - pair[0]).abs() / temperature).fold(0.0, f64::max));
    }
    assert!(jumps.iter().all(|jump| *jump < 0.1), "{jumps:?}");
}
