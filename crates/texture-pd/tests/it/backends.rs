//! Tests of every backend: known answers, and comparisons between backends on random surfaces. The GPU's
//! tests fail without an adapter; a software driver is enough (`cargo xtask test` installs one).

use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError};

use crate::common::{Plates, square, turned_over};
use glam::{DQuat, DVec2, DVec3};
use palpate_core::mesh::UvMesh;
use palpate_core::{Pose, TriMesh};
use palpate_texture_pd::{
    Backend, Batch, CpuBackend, DepthQuery, DepthSettings, Domain, HalfSpace, HeightImage, ReferenceBackend,
    SurfaceId, SurfaceSet, TextureContact, TextureDepth, TextureFilter, TexturedSurface, Wrap,
};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

/// All backends, for one test at a time, because creating one compiles its kernels.
fn backends() -> MutexGuard<'static, Vec<Box<dyn Backend>>> {
    static BACKENDS: LazyLock<Mutex<Vec<Box<dyn Backend>>>> = LazyLock::new(|| {
        Mutex::new(vec![
            Box::new(ReferenceBackend::new()),
            Box::new(CpuBackend::new()),
            #[cfg(feature = "gpu")]
            Box::new(palpate_texture_pd::WgpuBackend::new().unwrap_or_else(|error| panic!("{error}"))),
        ])
    });
    BACKENDS.lock().unwrap_or_else(PoisonError::into_inner)
}

fn depths(
    backend: &mut dyn Backend,
    surfaces: &SurfaceSet,
    contacts: &[TextureContact],
    settings: &DepthSettings,
) -> Vec<Option<TextureDepth>> {
    let mut query = DepthQuery::new();
    query.run(surfaces, contacts, settings, backend).unwrap_or_else(|error| panic!("{error}")).to_vec()
}

const WRAPS: [Wrap; 3] = [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror];
/// Largest displacement of random surfaces, m.
const AMPLITUDE: f32 = 1e-3;

/// A bumpy square of 2 × `cells`² triangles, with heights of up to 2 mm, and a random texture.
fn random_surface(rng: &mut StdRng) -> Arc<TexturedSurface> {
    let cells = rng.random_range(1..8_u32);
    let half = 0.02;
    let rise = rng.random_range(0.0..0.002);
    let tiles = rng.random_range(0.2..3.0);
    let corner = |i: u32| {
        let at = DVec2::new((i % (cells + 1)).into(), (i / (cells + 1)).into()) / f64::from(cells);
        (at * 2.0 - 1.0) * half
    };
    let count = (cells + 1) * (cells + 1);
    let vertices = (0..count).map(|i| corner(i).extend(rng.random_range(-1.0..1.0) * rise)).collect();
    let triangles: Vec<[u32; 3]> = (0..cells * cells)
        .flat_map(|i| {
            let first = i / cells * (cells + 1) + i % cells;
            [[first, first + 1, first + cells + 2], [first, first + cells + 2, first + cells + 1]]
        })
        .collect();
    let uv = triangles.iter().map(|t| t.map(|i| corner(i) / half * tiles)).collect();
    let mesh = UvMesh::new(TriMesh::new(vertices, triangles).unwrap(), uv).unwrap();
    if rng.random_bool(0.2) {
        return Arc::new(TexturedSurface::plain(mesh.mesh()).unwrap());
    }
    let (width, height) = (rng.random_range(1..40_u32), rng.random_range(1..40_u32));
    let heights = (0..width * height).map(|_| rng.random_range(-AMPLITUDE..AMPLITUDE)).collect();
    let wrap = [0, 1].map(|_| WRAPS[rng.random_range(0..3)]);
    let image = HeightImage::new(width, height, heights, wrap).unwrap();
    Arc::new(TexturedSurface::textured(&mesh, &image, 1.0).unwrap())
}

fn random_contact(rng: &mut StdRng, [a, b]: [SurfaceId; 2]) -> TextureContact {
    let mut vector = |most: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-most..most)));
    // Poses are far from the origin, as in a large scene.
    let away = vector(1.0);
    let frame = DQuat::from_scaled_axis(vector(1.0));
    let turned = |pose: Pose| Pose::new(away + frame * pose.translation, (frame * pose.rotation).normalize());
    let pose_a = turned_over(vector(0.01).truncate(), 0.0, vector(0.2));
    let normal = (-DVec3::Z + vector(0.2)).normalize();
    TextureContact {
        a,
        pose_a: turned(pose_a),
        center: away + vector(0.02),
        b,
        pose_b: turned(Pose::IDENTITY),
        normal: (frame * normal).normalize(),
        point: away + vector(0.005),
        half_size: rng.random_range(0.001..0.03),
        reach: 0.02,
        domain: Domain::WHOLE,
    }
}

/// Up to eight half-spaces around a contact's point, at any angle to its normal.
fn random_domain(rng: &mut StdRng, contact: &TextureContact) -> Domain {
    let mut domain = Domain::WHOLE;
    for _ in 0..rng.random_range(0..=Domain::MAX_HALF_SPACES) {
        let mut vector = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        let (direction, place) = (vector(), vector());
        let beyond = rng.random_range(-0.2..1.0) * direction;
        let through = contact.point + contact.half_size * (beyond + 0.1 * place);
        assert!(domain.cut(HalfSpace { through, direction }));
    }
    domain
}

#[test]
fn backends_agree_on_random_surfaces() {
    let seed = 51;
    let mut rng = StdRng::seed_from_u64(seed);
    // The same backends for all cases, so that their buffers see batches grow and shrink.
    let mut backends = backends();
    let names: Vec<_> = backends.iter().map(|backend| backend.name().to_owned()).collect();
    let (mut compared, mut folded) = (0, 0);
    for case in 0..80 {
        let mut surfaces = SurfaceSet::default();
        let ids: Vec<_> =
            (0..rng.random_range(2..6)).map(|_| surfaces.add(&random_surface(&mut rng)).unwrap()).collect();
        let contacts: Vec<_> = (0..rng.random_range(1..8))
            .map(|_| {
                let pair = [0, 1].map(|_| ids[rng.random_range(0..ids.len())]);
                let contact = random_contact(&mut rng, pair);
                TextureContact { domain: random_domain(&mut rng, &contact), ..contact }
            })
            .collect();
        // Software drivers take a second for some hundred thousand texels.
        let settings = DepthSettings {
            grid: rng.random_range(2..64),
            temperature: [0.0, 1e-5][rng.random_range(0..2)],
            refinements: rng.random_range(0..5),
            filter: [TextureFilter::Finest, TextureFilter::Footprint][rng.random_range(0..2)],
        };
        let answers: Vec<_> = backends
            .iter_mut()
            .map(|backend| depths(&mut **backend, &surfaces, &contacts, &settings))
            .collect();
        for (other, name) in answers[1..].iter().zip(&names[1..]) {
            for (contact, (one, other)) in answers[0].iter().zip(other).enumerate() {
                let about =
                    format!("seed {seed}, case {case}, contact {contact}, {settings:?}: {one:?} {other:?}");
                assert_eq!(one.is_some(), other.is_some(), "{about}");
                let (Some(one), Some(other)) = (one, other) else { continue };
                assert!((one.depth - other.depth).abs() < 1e-5 * f64::from(AMPLITUDE), "{about}");
                compared += 1;
                folded += usize::from(one.folded > 0.0);
                // The CPU backend counts only texels that it displaced.
                assert!(*name == "CPU" || (one.folded - other.folded).abs() < 0.02, "{about}");
                // With equal overlaps at several texels, backends may choose different ones.
                if one.point.distance(other.point) < 1e-9 {
                    assert!((one.linear - other.linear).length() < 1e-3 * one.linear.length(), "{about}");
                    let lever = 0.02 * one.linear.length();
                    assert!((one.angular - other.angular).length() < 1e-3 * lever, "{about}");
                }
            }
        }
    }
    assert!(compared > 200 && folded > 5, "{compared} compared, {folded} folded");
}

fn flat(_: DVec2) -> f64 {
    0.0
}

/// A dome of radius 5 cm pressed 2 mm into a plane.
#[test]
fn dome_pressed_into_a_plane_has_that_depth() {
    let dome = |at: DVec2| (0.0025 - at.length_squared()).sqrt() - 0.05;
    let plates = Plates { half: 0.03, relief_a: &dome, relief_b: &flat };
    let (surfaces, ids) = plates.surfaces(256);
    let place = DVec2::new(0.0013, -0.0007);
    let contact = plates.contact(ids, turned_over(place, -0.002, DVec3::ZERO), 0.02);
    for backend in backends().iter_mut() {
        for (grid, within) in [(33, 1e-8), (50, 1e-8), (128, 1e-8)] {
            let settings = DepthSettings { grid, filter: TextureFilter::Finest, ..DepthSettings::default() };
            let found = depths(&mut **backend, &surfaces, &[contact], &settings)[0].unwrap();
            assert!((found.depth - 0.002).abs() < within, "{}, grid {grid}: {found:?}", backend.name());
            assert!((found.linear + DVec3::Z).length() < 1e-6);
            assert!(found.point.distance(place.extend(-0.002)) < 0.04 / f64::from(grid), "{found:?}");
        }
    }
}

/// Two sine plates: δ_n = a_A + a_B where their crests meet. A shift by half a wave moves that place.
#[test]
fn crests_that_meet_add_up() {
    let wave = |amplitude: f64| move |at: DVec2| amplitude * (std::f64::consts::TAU * at.x / 0.01).cos();
    let (a, b) = (wave(0.001), wave(0.0005));
    let plates = Plates { half: 0.03, relief_a: &a, relief_b: &b };
    let (surfaces, ids) = plates.surfaces(512);
    for backend in backends().iter_mut() {
        for (shift, expected) in [(0.0, 0.0015), (0.005, 0.0005)] {
            let contact = plates.contact(ids, turned_over(DVec2::X * shift, 0.0, DVec3::ZERO), 0.018);
            let settings =
                DepthSettings { grid: 100, filter: TextureFilter::Finest, ..DepthSettings::default() };
            let found = depths(&mut **backend, &surfaces, &[contact], &settings)[0].unwrap();
            assert!((found.depth - expected).abs() < 2e-8, "{}, {shift}: {found:?}", backend.name());
        }
    }
}

/// Two bumps on B under a flat A, each with a contact whose grid contains both.
#[test]
fn domains_separate_the_bumps_of_neighbouring_contacts() {
    let (near, far) = (DVec2::new(-0.004, 0.001), DVec2::new(0.004, -0.002));
    let bump = |at: DVec2, height: f64| height * (-at.length_squared() / 2e-6).exp();
    let bumps = move |at: DVec2| bump(at - near, 0.0004) + bump(at - far, 0.0006);
    let plates = Plates { half: 0.03, relief_a: &flat, relief_b: &bumps };
    let (surfaces, ids) = plates.surfaces(512);
    let pose = turned_over(DVec2::ZERO, 0.0001, DVec3::ZERO);
    let points = [near, far].map(|at| at.extend(0.001));
    let contact =
        |i: usize, domain| TextureContact { point: points[i], domain, ..plates.contact(ids, pose, 0.012) };
    let parted = [0, 1].map(|i| contact(i, Domain::nearest(points[i], [points[1 - i]], -DVec3::Z)));
    let whole = [0, 1].map(|i| contact(i, Domain::WHOLE));
    for backend in backends().iter_mut() {
        for temperature in [0.0, 2e-6] {
            let filter = TextureFilter::Finest;
            let settings = DepthSettings { grid: 100, temperature, filter, ..DepthSettings::default() };
            let expected = [(whole, [(far, 0.0005); 2]), (parted, [(near, 0.0003), (far, 0.0005)])];
            for (contacts, expected) in expected {
                let found = depths(&mut **backend, &surfaces, &contacts, &settings);
                for (found, (place, depth)) in found.iter().zip(expected) {
                    let found = found.unwrap();
                    assert!(found.point.truncate().distance(place) < 0.0002, "{found:?} is not at {place}");
                    let within = 1e-6 + 4.0 * temperature;
                    assert!((found.depth - depth).abs() < within, "{found:?} is not {depth} deep");
                }
            }
        }
    }
}

#[test]
fn gap_is_a_negative_depth() {
    let plates = Plates { half: 0.03, relief_a: &flat, relief_b: &flat };
    let (surfaces, ids) = plates.surfaces(4);
    let contact = plates.contact(ids, turned_over(DVec2::ZERO, 0.25e-3, DVec3::ZERO), 0.01);
    for backend in backends().iter_mut() {
        let found = depths(&mut **backend, &surfaces, &[contact], &DepthSettings::default())[0].unwrap();
        assert!((found.depth + 0.25e-3).abs() < 1e-9, "{found:?}");
    }
}

#[test]
fn surfaces_that_are_not_above_each_other_have_no_depth() {
    let plates = Plates { half: 0.01, relief_a: &flat, relief_b: &flat };
    let (surfaces, ids) = plates.surfaces(4);
    let beside = plates.contact(ids, turned_over(DVec2::X * 0.03, 0.0, DVec3::ZERO), 0.01);
    let from_behind = plates.contact(ids, Pose::IDENTITY, 0.01);
    let nonsense = TextureContact { half_size: f64::NAN, ..from_behind };
    let mut domain = Domain::WHOLE;
    assert!(domain.cut(HalfSpace { through: DVec3::X * 0.02, direction: -DVec3::X }));
    let here = plates.contact(ids, turned_over(DVec2::ZERO, -1e-3, DVec3::ZERO), 0.01);
    for backend in backends().iter_mut() {
        let all = [beside, nonsense, here, from_behind, TextureContact { domain, ..here }];
        let found = depths(&mut **backend, &surfaces, &all, &DepthSettings::default());
        assert_eq!(found.iter().map(Option::is_some).collect::<Vec<_>>(), [false, false, true, false, false]);
        assert!((found[2].unwrap().depth - 1e-3).abs() < 1e-9);
        assert!(depths(&mut **backend, &surfaces, &[], &DepthSettings::default()).is_empty());
        let mut answers = Vec::new();
        assert!(backend.evaluate(&surfaces, &Batch::default(), &mut answers).is_ok() && answers.is_empty());
    }
}

/// B is a small plate on which a large one lies obliquely: the largest overlap is at the end of B, and A's
/// slope determines the force.
#[test]
fn slope_of_the_other_surface_counts_where_one_ends() {
    let small = Arc::new(TexturedSurface::plain(square(0.004).mesh()).unwrap());
    let large = Arc::new(TexturedSurface::plain(square(0.02).mesh()).unwrap());
    let mut surfaces = SurfaceSet::default();
    let [small, large] = [&small, &large].map(|surface| surfaces.add(surface).unwrap());
    let tilt = 0.1_f64;
    let lying = turned_over(DVec2::ZERO, 0.0, DVec3::Y * tilt);
    let contact = |a, b| TextureContact {
        a,
        pose_a: lying,
        center: DVec3::ZERO,
        b,
        pose_b: Pose::IDENTITY,
        normal: -DVec3::Z,
        point: DVec3::ZERO,
        half_size: 0.01,
        reach: 0.02,
        domain: Domain::WHOLE,
    };
    let slope = DVec3::new(-tilt.tan(), 0.0, -1.0);
    for backend in backends().iter_mut() {
        let both = [contact(large, small), contact(small, large)];
        let found = depths(&mut **backend, &surfaces, &both, &DepthSettings::default());
        assert!((found[0].unwrap().linear - slope).length() < 1e-5, "{:?}", found[0]);
        assert!((found[1].unwrap().linear + DVec3::Z).length() < 1e-5, "{:?}", found[1]);
    }
}

#[test]
fn wrong_settings_are_refused_with_the_accepted_values() {
    let surfaces = SurfaceSet::default();
    let plain = DepthSettings::default();
    for (settings, what) in [
        (DepthSettings { grid: 1, ..plain }, "grid is 1; give 2 to 1024"),
        (DepthSettings { grid: 4096, ..plain }, "grid is 4096"),
        (DepthSettings { temperature: f64::NAN, ..plain }, "temperature is NaN"),
    ] {
        let mut query = DepthQuery::new();
        let error = query.run(&surfaces, &[], &settings, &mut CpuBackend::new()).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    }
}
