//! One suite for every backend: known answers, a plain oracle on random heights, and the backends against each
//! other. The GPU's tests fail where there is no adapter: a software driver is enough (`cargo xtask test`
//! installs one).

use palpate_texture_pd::{Backend, CpuBackend, DirectionalDepth, PatchPairs};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

type Backends = Vec<Box<dyn Backend>>;

fn backends() -> Backends {
    vec![
        Box::new(CpuBackend),
        #[cfg(feature = "gpu")]
        Box::new(palpate_texture_pd::WgpuBackend::new().unwrap_or_else(|error| panic!("{error}"))),
    ]
}

fn depths(backend: &mut dyn Backend, pairs: &PatchPairs) -> Vec<Option<DirectionalDepth>> {
    let mut depths = vec![None; 3]; // What was there goes.
    backend.directional_depths(pairs, &mut depths).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(depths.len(), pairs.len());
    depths
}

/// The depth of one pair on every backend, which must agree.
fn depth(backends: &mut Backends, size: u32, a: &[f32], b: &[f32]) -> Option<DirectionalDepth> {
    let mut pairs = PatchPairs::new(size).unwrap();
    let (a, b) = (pairs.add_patch(a).unwrap(), pairs.add_patch(b).unwrap());
    pairs.add_pair(a, b).unwrap();
    let answers: Vec<_> = backends.iter_mut().map(|backend| depths(&mut **backend, &pairs)[0]).collect();
    assert!(answers.windows(2).all(|two| two[0] == two[1]), "{answers:?}");
    answers[0]
}

/// The definition, spelled out: of all texels with two surfaces, the first in the order of falling overlap.
fn oracle(size: u32, a: &[f32], b: &[f32]) -> Option<DirectionalDepth> {
    let mut overlaps: Vec<_> = (0..a.len())
        .filter(|&i| a[i].is_finite() && b[i].is_finite())
        .map(|i| DirectionalDepth { depth: a[i] - b[i], column: i as u32 % size, row: i as u32 / size })
        .collect();
    overlaps.sort_by(|x, y| y.depth.partial_cmp(&x.depth).unwrap()); // Stable: ties stay in the order of the texels.
    overlaps.first().copied()
}

/// Heights in mm steps where `ties` is set, so that many overlaps are equal, with texels of no surface strewn in.
fn random_patch(rng: &mut StdRng, size: u32, ties: bool) -> Vec<f32> {
    let holes = [0.0, 0.1, 0.9, 1.0][rng.random_range(0..4)];
    (0..size * size)
        .map(|_| {
            if rng.random_bool(holes) {
                [f32::NAN, -f32::NAN, f32::NEG_INFINITY, f32::INFINITY][rng.random_range(0..4)]
            } else if ties {
                rng.random_range(-2_i32..=2) as f32 * 1e-3
            } else {
                rng.random_range(-0.1..0.1)
            }
        })
        .collect()
}

#[test]
fn random_batches_agree_with_the_definition_for_every_grid_size() {
    const SEED: u64 = 51;
    let mut rng = StdRng::seed_from_u64(SEED);
    // The same backends throughout: their buffers meet batches that grow and shrink.
    let mut backends = backends();
    for size in (1..=64).chain([65, 100, 256]) {
        let mut pairs = PatchPairs::new(size).unwrap();
        let ties = size % 2 == 0;
        let heights: Vec<_> =
            (0..rng.random_range(1..20)).map(|_| random_patch(&mut rng, size, ties)).collect();
        let patches: Vec<_> = heights.iter().map(|heights| pairs.add_patch(heights).unwrap()).collect();
        let chosen: Vec<_> = (0..rng.random_range(1..60))
            .map(|_| [rng.random_range(0..patches.len()), rng.random_range(0..patches.len())])
            .collect();
        for &[a, b] in &chosen {
            pairs.add_pair(patches[a], patches[b]).unwrap();
        }
        let expected: Vec<_> = chosen.iter().map(|&[a, b]| oracle(size, &heights[a], &heights[b])).collect();
        for backend in &mut backends {
            assert_eq!(
                depths(&mut **backend, &pairs),
                expected,
                "{} at size {size}, seed {SEED}",
                backend.name()
            );
        }
    }
}

/// A sphere of radius r whose lowest point is pressed e into the plane z = 0. A is the sphere, n points down; h
/// = −z.
#[test]
fn a_sphere_pressed_into_a_plane_is_as_deep_as_it_is_pressed() {
    let mut backends = backends();
    let (radius, pressed, size) = (0.05_f64, 0.002, 33);
    let spacing = 0.06 / f64::from(size - 1);
    let sphere: Vec<f32> = (0..size * size)
        .map(|i| {
            let (u, v) = (f64::from(i % size) * spacing - 0.03, f64::from(i / size) * spacing - 0.03);
            let lowest = (radius - pressed) - (radius * radius - u * u - v * v).sqrt();
            -lowest as f32
        })
        .collect();
    let plane = vec![0.0; (size * size) as usize];
    let deepest = depth(&mut backends, size, &sphere, &plane).unwrap();
    assert!((f64::from(deepest.depth) - pressed).abs() < 1e-8);
    assert_eq!((deepest.column, deepest.row), (16, 16));
}

/// Two sine plates: δ_n = a_A + a_B where their crests meet, which a shift by half a wave moves.
#[test]
fn crests_that_meet_add_up() {
    let mut backends = backends();
    let size = 64;
    let wave = |shift: u32, amplitude: f32| -> Vec<f32> {
        (0..size * size)
            .map(|i| amplitude * (std::f32::consts::TAU * ((i % size + shift) % 16) as f32 / 16.0).cos())
            .collect()
    };
    let (a, b) = (wave(0, 1e-3), wave(8, 5e-4));
    let deepest = depth(&mut backends, size, &a, &b).unwrap();
    assert!((deepest.depth - 1.5e-3).abs() < 1e-9);
    assert_eq!((deepest.column, deepest.row), (0, 0), "of the equal crests the first");
    let apart = depth(&mut backends, size, &a, &wave(0, 1e-3)).unwrap();
    assert_eq!((apart.depth, apart.column), (0.0, 0));
}

#[test]
fn a_gap_is_a_negative_depth() {
    let mut backends = backends();
    let deepest = depth(&mut backends, 2, &[-0.5, -0.25, -0.75, -0.5], &[0.0; 4]).unwrap();
    assert_eq!(deepest, DirectionalDepth { depth: -0.25, column: 1, row: 0 });
}

#[test]
fn of_equal_overlaps_the_lowest_texel_wins() {
    let mut backends = backends();
    for size in [1, 2, 7, 8, 9, 16, 64] {
        let count = (size * size) as usize;
        assert_eq!(depth(&mut backends, size, &vec![0.25; count], &vec![0.125; count]).unwrap().depth, 0.125);
        // Equal maxima from texel `first` on, wherever that falls among the invocations.
        for first in [0, 1, 62, 63, 64, 65, 127, 128, 1000, count - 1] {
            if first >= count {
                continue;
            }
            let a: Vec<f32> = (0..count).map(|i| if i >= first { 1.0 } else { 0.5 }).collect();
            let deepest = depth(&mut backends, size, &a, &vec![0.0; count]).unwrap();
            assert_eq!((deepest.column + deepest.row * size) as usize, first);
        }
    }
    let signed = depth(&mut backends, 2, &[-0.0, 0.0, -0.0, 0.0], &[0.0; 4]).unwrap();
    assert_eq!((signed.depth, signed.column, signed.row), (0.0, 0, 0), "zeros are equal whatever their sign");
}

#[test]
fn texels_without_a_surface_do_not_count() {
    let mut backends = backends();
    let none =
        [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, 2_f32.powi(64), -2_f32.powi(64)];
    for hole in none {
        // On either side, alone and beside a surface.
        assert_eq!(depth(&mut backends, 1, &[hole], &[0.0]), None, "{hole}");
        assert_eq!(depth(&mut backends, 1, &[0.0], &[hole]), None, "{hole}");
        let deepest = depth(&mut backends, 2, &[hole, 0.5, 0.25, 0.75], &[0.0, 0.0, 0.0, hole]).unwrap();
        assert_eq!(deepest, DirectionalDepth { depth: 0.5, column: 1, row: 0 }, "{hole}");
    }
    let large = 2_f32.powi(63);
    assert_eq!(
        depth(&mut backends, 1, &[large], &[-large]).unwrap().depth,
        2.0 * large,
        "just below the bound still counts"
    );
    assert_eq!(depth(&mut backends, 8, &[f32::NAN; 64], &[f32::NAN; 64]), None);
}

/// More pairs than one dimension of a dispatch holds.
#[test]
fn batches_beyond_65535_pairs_are_whole() {
    let mut pairs = PatchPairs::new(1).unwrap();
    let flat = pairs.add_patch(&[0.0]).unwrap();
    let count = 70_001;
    for i in 0..count {
        let a = pairs.add_patch(&[i as f32]).unwrap();
        pairs.add_pair(a, flat).unwrap();
    }
    for backend in &mut backends() {
        let depths = depths(&mut **backend, &pairs);
        assert!((0..count).all(|i| depths[i].unwrap().depth == i as f32), "{}", backend.name());
    }
}

#[test]
fn an_empty_batch_has_no_depths() {
    for backend in &mut backends() {
        assert!(depths(&mut **backend, &PatchPairs::new(8).unwrap()).is_empty());
    }
}
