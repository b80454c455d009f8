//! Depth, gradient and second derivatives of analytic surfaces, by each method, compared with differences of
//! the exact depth. `cargo test --release -p palpate-texture-pd --test it derivatives:: -- --nocapture`
//! prints the errors.

#![allow(clippy::print_stdout, clippy::needless_range_loop, reason = "it prints a table of matrices' errors")]

use std::f64::consts::TAU;

use crate::common::{Plates, moved, turned_over};
use glam::{DVec2, DVec3};
use palpate_core::Pose;
use palpate_texture_pd::{
    CpuBackend, DepthQuery, DepthSettings, SurfaceSet, TextureContact, TextureDepth, TextureFilter,
};
use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

/// Half the plates' side, m, and texels along it.
const HALF: f64 = 0.02;
const TEXELS: u32 = 512;
/// Half the grid's side, m.
const WINDOW: f64 = 0.006;

/// Largest errors of depth, gradient and second derivatives, m; derivatives by rotations are scaled by
/// [`LEVER`] (m).
#[derive(Clone, Copy, Debug, Default)]
struct Errors {
    depth: f64,
    gradient: f64,
    second: f64,
}
const LEVER: f64 = 0.01;

/// A depth (m), its gradient and second derivatives by shifts and turns, world axes.
type Local = (f64, [f64; 6], [[f64; 6]; 6]);

/// Central differences (Eq. 4.8, 5.57, 5.58) of a depth by shifts, in steps of `step` (m), and turns over
/// [`LEVER`].
fn central_differences(step: f64, depth: impl Fn(DVec3, DVec3) -> f64) -> Local {
    let depth = |change: [f64; 6]| depth(DVec3::from_slice(&change[..3]), DVec3::from_slice(&change[3..]));
    let step = |i: usize| if i < 3 { step } else { step / LEVER };
    let unit = |i: usize, sign: f64, change: [f64; 6]| {
        let mut change = change;
        change[i] += sign * step(i);
        change
    };
    let here = depth([0.0; 6]);
    let mut gradient = [0.0; 6];
    let mut second = [[0.0; 6]; 6];
    for i in 0..6 {
        let [up, down] = [1.0, -1.0].map(|sign| depth(unit(i, sign, [0.0; 6])));
        gradient[i] = (up - down) / (2.0 * step(i));
        second[i][i] = (up - 2.0 * here + down) / step(i).powi(2);
        for j in 0..i {
            let mixed = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]
                .map(|(p, q)| p * q * depth(unit(j, q, unit(i, p, [0.0; 6]))));
            second[i][j] = mixed.iter().sum::<f64>() / (4.0 * step(i) * step(j));
            second[j][i] = second[i][j];
        }
    }
    (here, gradient, second)
}

/// The exact derivatives.
fn exact(plates: &Plates, contact: &TextureContact) -> Local {
    let inside = contact.pose_a.inverse().transform_point(contact.point).truncate();
    central_differences(2e-6, |shift, turn| {
        plates.depth(&moved(&contact.pose_a, contact.center, shift, turn), inside, 0.9 * WINDOW)
    })
}

/// The largest overlap of the texels alone, m.
fn of_texels(found: &TextureDepth, contact: &TextureContact) -> f64 {
    (found.point - found.scene_point).dot(contact.normal)
}

/// The dissertation's derivatives: differences, a texel apart, of the depth that the texels give.
fn differences(surfaces: &SurfaceSet, contact: &TextureContact, settings: &DepthSettings) -> Local {
    let step = 2.0 * contact.half_size / f64::from(settings.grid);
    central_differences(step, |shift, turn| {
        let pose_a = moved(&contact.pose_a, contact.center, shift, turn);
        let found = found(surfaces, &TextureContact { pose_a, ..*contact }, settings);
        if settings.temperature > 0.0 { found.depth } else { of_texels(&found, contact) }
    })
}

fn found(surfaces: &SurfaceSet, contact: &TextureContact, settings: &DepthSettings) -> TextureDepth {
    let mut query = DepthQuery::new();
    query.run(surfaces, &[*contact], settings, &mut CpuBackend::new()).unwrap()[0].unwrap()
}

/// Those of slopes and curvatures at the maximum.
fn at_maximum(surfaces: &SurfaceSet, contact: &TextureContact, settings: &DepthSettings) -> Local {
    let found = found(surfaces, contact, settings);
    let [a, b] = [found.linear, found.angular].map(|part| part.to_array());
    (found.depth, [a[0], a[1], a[2], b[0], b[1], b[2]], found.second)
}

fn errors(found: &Local, (depth, gradient, second): &Local) -> Errors {
    let lever = |i: usize| if i < 3 { 1.0 } else { LEVER };
    let mut errors = Errors { depth: (found.0 - depth).abs(), ..Errors::default() };
    for i in 0..6 {
        errors.gradient = errors.gradient.max((found.1[i] - gradient[i]).abs() / lever(i));
        for j in 0..6 {
            let error = (found.2[i][j] - second[i][j]).abs() / (lever(i) * lever(j));
            errors.second = errors.second.max(error);
        }
    }
    errors
}

/// Median errors over random placements of the surfaces.
fn compare(name: &str, plates: &Plates, tilt: f64) -> [Errors; 4] {
    let seed = 71;
    let mut rng = StdRng::seed_from_u64(seed);
    let (surfaces, ids) = plates.surfaces(TEXELS);
    let grid = 128;
    let plain = DepthSettings { grid, ..DepthSettings::default() };
    let smooth = DepthSettings { temperature: 2e-6, ..plain };
    type Method = fn(&SurfaceSet, &TextureContact, &DepthSettings) -> Local;
    let methods: [(&str, Method, DepthSettings); 4] = [
        ("largest, slopes and curvatures", at_maximum, plain),
        ("smooth, slopes and curvatures", at_maximum, smooth),
        ("largest, differences", differences, plain),
        ("smooth, differences", differences, smooth),
    ];
    let mut all = [const { Vec::new() }; 4];
    for _ in 0..15 {
        let mut random = |most: f64| rng.random_range(-most..most);
        let place = DVec2::new(random(0.004), random(0.004));
        let turn = DVec3::new(random(tilt), random(tilt), random(0.5));
        let pose: Pose = turned_over(place, 0.0005, turn);
        let contact = plates.contact(ids, pose, WINDOW);
        let exact = exact(plates, &contact);
        for ((_, method, settings), all) in methods.iter().zip(&mut all) {
            all.push(errors(&method(&surfaces, &contact, settings), &exact));
        }
    }
    let median = |of: &dyn Fn(&Errors) -> f64, all: &[Errors]| {
        let mut values: Vec<f64> = all.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    println!("{name} (seed {seed}): median error of depth, m; gradient; second derivatives, 1/m");
    let summary = all.map(|all| Errors {
        depth: median(&|e| e.depth, &all),
        gradient: median(&|e| e.gradient, &all),
        second: median(&|e| e.second, &all),
    });
    for ((method, ..), Errors { depth, gradient, second }) in methods.iter().zip(&summary) {
        println!("  {method:32} {depth:10.2e} {gradient:10.2e} {second:10.2e}");
    }
    summary
}

fn sphere(radius: f64) -> impl Fn(DVec2) -> f64 {
    move |at| (radius * radius - at.length_squared()).max(0.0).sqrt() - radius
}

fn ridges(amplitude: f64, length: f64, angle: f64) -> impl Fn(DVec2) -> f64 {
    move |at| amplitude * (TAU * at.dot(DVec2::from_angle(angle)) / length).cos()
}

#[test]
fn sphere_on_ridges() {
    let (a, b) = (sphere(0.03), ridges(0.0002, 0.008, 0.3));
    let plates = Plates { half: HALF, relief_a: &a, relief_b: &b };
    let [largest, smooth, differences, _] = compare("sphere on ridges", &plates, 0.05);
    assert!(largest.depth < 1e-9 && largest.gradient < 2e-5 && largest.second < 0.2, "{largest:?}");
    assert!(smooth.gradient < 1e-3, "{smooth:?}");
    assert!(10.0 * largest.gradient < differences.gradient, "{differences:?}");
}

#[test]
fn ridges_on_ridges() {
    let bump = sphere(0.1);
    let fine = ridges(0.0001, 0.005, 1.2);
    let a = move |at: DVec2| bump(at) + fine(at);
    let b = ridges(0.0002, 0.007, 0.3);
    let plates = Plates { half: HALF, relief_a: &a, relief_b: &b };
    let [largest, smooth, differences, _] = compare("ridges on ridges", &plates, 0.02);
    assert!(largest.depth < 1e-8 && largest.gradient < 2e-4 && largest.second < 2.0, "{largest:?}");
    assert!(smooth.gradient < 1e-2, "{smooth:?}");
    assert!(10.0 * largest.gradient < differences.gradient, "{differences:?}");
}

#[test]
fn cone_on_ridges() {
    let a = |at: DVec2| -0.5 * at.length();
    let b = ridges(0.0002, 0.008, 0.3);
    let plates = Plates { half: HALF, relief_a: &a, relief_b: &b };
    // The apex is rounded by the texels, of 80 um.
    let [largest, smooth, ..] = compare("cone on ridges", &plates, 0.05);
    assert!(largest.depth < 4e-5 && largest.gradient < 5e-3, "{largest:?}");
    assert!(smooth.gradient < 1e-2, "{smooth:?}");
}

/// A cylinder that lies along ridges has its largest overlap along a whole line.
#[test]
fn line_of_largest_overlaps_is_found_between_texels() {
    let a = |at: DVec2| -15.0 * at.x * at.x;
    let b = |at: DVec2| 0.0002 * (TAU * at.x / 0.008).cos();
    let plates = Plates { half: HALF, relief_a: &a, relief_b: &b };
    let (surfaces, ids) = plates.surfaces(TEXELS);
    let settings = DepthSettings { grid: 64, filter: TextureFilter::Finest, ..DepthSettings::default() };
    for shift in [0.0003, 0.00117, -0.0022] {
        let contact = plates.contact(ids, turned_over(DVec2::X * shift, 0.0, DVec3::ZERO), WINDOW);
        let overlap = |x: f64| a(DVec2::X * (x - shift)) + b(DVec2::X * x);
        let places = (-400_000..400_000).map(|i| shift + f64::from(i) * 1e-8);
        let at = places.max_by(|x, y| overlap(*x).total_cmp(&overlap(*y))).unwrap();
        let slope = -0.0002 * TAU / 0.008 * (TAU * at / 0.008).sin();
        let found = found(&surfaces, &contact, &settings);
        let wanted = DVec3::new(slope, 0.0, -1.0);
        assert!((found.depth - overlap(at)).abs() < 2e-9, "{shift}: {} {}", found.depth, overlap(at));
        assert!((found.linear - wanted).length() < 2e-4, "{shift}: {:?} {wanted}", found.linear);
    }
}

/// The error of the largest overlap at texels is of second order in their size; between texels it is of
/// fourth order.
#[test]
fn error_of_the_depth_falls_with_the_grid() {
    let (a, b) = (sphere(0.02), ridges(0.0002, 0.008, 0.3));
    let plates = Plates { half: HALF, relief_a: &a, relief_b: &b };
    let (surfaces, ids) = plates.surfaces(TEXELS);
    let seed = 72;
    let mut rng = StdRng::seed_from_u64(seed);
    let mut random = |most: f64| rng.random_range(-most..most);
    let poses: Vec<Pose> = (0..15)
        .map(|_| {
            let place = DVec2::new(random(0.004), random(0.004));
            turned_over(place, 0.0005, DVec3::new(random(0.05), random(0.05), random(0.5)))
        })
        .collect();
    let exact: Vec<f64> = poses
        .iter()
        .map(|pose| {
            let inside = pose.inverse().transform_point(pose.translation.with_z(0.0)).truncate();
            plates.depth(pose, inside, 0.9 * WINDOW)
        })
        .collect();
    let errors = |grid, alone: bool| {
        let settings = DepthSettings { grid, filter: TextureFilter::Finest, ..DepthSettings::default() };
        let error = |(pose, exact): (&Pose, &f64)| {
            let contact = plates.contact(ids, *pose, WINDOW);
            let found = found(&surfaces, &contact, &settings);
            (if alone { of_texels(&found, &contact) } else { found.depth }) - exact
        };
        let errors: Vec<f64> = poses.iter().zip(&exact).map(error).collect();
        (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
    };
    println!(
        "sphere on ridges (seed {seed}): root mean square error of depth, m: texels alone; between them"
    );
    let grids = [12, 24, 48, 96];
    let all = grids.map(|grid| [errors(grid, true), errors(grid, false)]);
    for (grid, [alone, between]) in grids.iter().zip(&all) {
        println!("  {grid:3} {alone:10.2e} {between:10.2e}");
    }
    for two in all.windows(2) {
        assert!(two[1][0] < 0.4 * two[0][0], "{all:?}");
        assert!(two[1][1] < 0.15 * two[0][1] || two[1][1] < 5e-9, "{all:?}");
    }
}
