//! Derivatives where a displaced surface is folded as seen along the contact: they are finite, and no steeper
//! than the visible surface.

use std::sync::Arc;

use crate::common::{plate, turned_over};
use glam::{DVec2, DVec3};
use palpate_core::mesh::UvMesh;
use palpate_core::{Pose, TriMesh};
use palpate_texture_pd::{
    Backend, CpuBackend, DepthQuery, DepthSettings, Domain, HeightImage, ReferenceBackend, SurfaceSet,
    TextureContact, TextureDepth, TexturedSurface, Wrap,
};

/// Radius of the bowl, m, and half the side of the square that it covers.
const RADIUS: f64 = 0.01;
const HALF: f64 = 0.004;

/// A part of a sphere around the origin, seen from inside: `cells`² squares that face upwards, displaced by
/// `rise` (m) towards the centre of the sphere, with a ripple of an amplitude (m).
fn bowl(cells: u32, rise: f32, ripple: f32) -> Arc<TexturedSurface> {
    let place = |i: u32| {
        DVec2::new((i % (cells + 1)).into(), (i / (cells + 1)).into()) / f64::from(cells) * 2.0 - 1.0
    };
    let vertices = (0..(cells + 1) * (cells + 1))
        .map(|i| (place(i) * HALF).extend(-(RADIUS * RADIUS - (place(i) * HALF).length_squared()).sqrt()))
        .collect();
    let triangles: Vec<[u32; 3]> = (0..cells * cells)
        .flat_map(|i| {
            let first = i / cells * (cells + 1) + i % cells;
            [[first, first + 1, first + cells + 2], [first, first + cells + 2, first + cells + 1]]
        })
        .collect();
    let uv = triangles.iter().map(|t| t.map(|i| 0.5 * (place(i) + 1.0))).collect();
    let mesh = UvMesh::new(TriMesh::new(vertices, triangles).unwrap(), uv).unwrap();
    let heights = (0..16 * 16).map(|i| rise + ripple * ((7 * i % 16) as f32 / 8.0 - 1.0)).collect();
    let image = HeightImage::new(16, 16, heights, [Wrap::Clamp; 2]).unwrap();
    Arc::new(TexturedSurface::textured(&mesh, &image, 1.0).unwrap())
}

/// Depths of a flat plate over the bowl, and of the bowl over the plate.
fn depths(
    backend: &mut dyn Backend,
    bowl: &Arc<TexturedSurface>,
    temperature: f64,
) -> Vec<Option<TextureDepth>> {
    let mut surfaces = SurfaceSet::default();
    let flat = plate(0.03, 256, &|at| -60.0 * at.length_squared());
    let [flat, bowl] = [&flat, bowl].map(|surface| surfaces.add(surface).unwrap());
    let below = turned_over(DVec2::ZERO, 0.0, DVec3::new(0.03, 0.02, 0.0));
    let contact = |a, b, normal: DVec3, [pose_a, pose_b]: [Pose; 2]| TextureContact {
        a,
        pose_a,
        center: DVec3::new(0.001, 0.002, 0.01),
        b,
        pose_b,
        normal,
        point: DVec3::new(1e-4, 2e-4, 0.0),
        half_size: 0.6 * HALF,
        reach: 0.05,
        domain: Domain::WHOLE,
    };
    let upright = Pose::IDENTITY;
    let contacts =
        [contact(flat, bowl, -DVec3::Z, [below, upright]), contact(bowl, flat, DVec3::Z, [upright, below])];
    let settings = DepthSettings { grid: 40, temperature, ..DepthSettings::default() };
    DepthQuery::new().run(&surfaces, &contacts, &settings, backend).unwrap().to_vec()
}

fn steepest(found: &TextureDepth) -> f64 {
    let all = found.linear.to_array().into_iter().chain(found.angular.to_array().map(|it| it / RADIUS));
    all.map(f64::abs).fold(0.0, |most, value| if value.is_nan() { f64::NAN } else { most.max(value) })
}

/// A displacement by its radius moves the whole bowl to one point; with similar displacements it is folded in
/// places.
#[test]
fn derivatives_are_finite_in_folds() {
    let mut backends: Vec<Box<dyn Backend>> = vec![
        Box::new(ReferenceBackend::new()),
        Box::new(CpuBackend::new()),
        #[cfg(feature = "gpu")]
        Box::new(palpate_texture_pd::WgpuBackend::new().unwrap_or_else(|error| panic!("{error}"))),
    ];
    let radius = RADIUS as f32;
    let mut folded = 0;
    for (cells, rise, ripple) in [
        (1, radius, 0.0),
        (4, radius, 0.0),
        (4, radius, 1e-4),
        (8, 0.97 * radius, 3e-4),
        (8, 1.2 * radius, 3e-4),
        (3, 0.5 * radius, 1e-3),
    ] {
        let bowl = bowl(cells, rise, ripple);
        for temperature in [0.0, 2e-5] {
            let answers: Vec<_> =
                backends.iter_mut().map(|backend| depths(&mut **backend, &bowl, temperature)).collect();
            for (backend, found) in backends.iter().zip(&answers) {
                for found in found.iter().flatten() {
                    let about = format!(
                        "{}: {cells} cells, {rise} m, ripple {ripple} m, τ {temperature} m: {found:?}",
                        backend.name()
                    );
                    let numbers = found.second.as_flattened();
                    assert!(
                        found.depth.is_finite() && numbers.iter().all(|value| value.is_finite()),
                        "{about}"
                    );
                    assert!(steepest(found) < 30.0, "{}: {about}", steepest(found));
                    folded += usize::from(found.folded > 0.5);
                }
            }
            for other in &answers[1..] {
                for (one, other) in answers[0].iter().zip(other) {
                    let (Some(one), Some(other)) = (one, other) else { panic!("{one:?} {other:?}") };
                    assert!((one.depth - other.depth).abs() < 1e-7, "{one:?} {other:?}");
                }
            }
        }
    }
    assert!(folded > 20, "{folded}");
}
