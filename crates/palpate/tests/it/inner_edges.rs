//! Edges inside flat and convex surfaces do not stick out: whatever slides over them without friction is
//! pushed along the normals of the faces beside them, and of nothing else.
#![expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use std::f64::consts::TAU;

use palpate::device::{Emulation, IntendedPath};
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{ContactSearch, ContactSettings, Response, SearchSettings};
use palpate::{ContactTiming, HapticRenderer, LockstepSession, Object, Pose, Scene, Settings};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::bodies::{block, object, path};

/// Largest lateral contact force on flat floors, N, and jump of the coupling's force along an axis from step
/// to step, N: on a plane without edges, the device's encoders make it jump by 0.038 N.
const LATERAL: f64 = 0.01;
const JUMP: f64 = 0.04;

/// Largest height by which a slide lifts the object, m.
const LIFT: f64 = 3e-6;

/// Height of the top of all flat floors, m.
const TOP: f64 = 0.0;

/// A slab whose top has the vertices of a grid, each moved by a shift, and one of both diagonals in each
/// cell. Its bottom has the same, 1 cm below.
fn slab(
    (xs, ys): (&[f64], &[f64]),
    mut place: impl FnMut(f64, f64, bool) -> DVec3,
    mut is_other_diagonal: impl FnMut(usize, usize) -> bool,
) -> Object {
    let (nx, ny) = (xs.len(), ys.len());
    let inner = |i: usize, j: usize| i > 0 && j > 0 && i + 1 < nx && j + 1 < ny;
    let mut vertices: Vec<DVec3> =
        (0..nx * ny).map(|k| place(xs[k / ny], ys[k % ny], inner(k / ny, k % ny))).collect();
    let count = vertices.len() as u32;
    for k in 0..nx * ny {
        vertices.push(DVec3 { z: TOP - 0.01, ..vertices[k] });
    }
    let at = |i: usize, j: usize| (i * ny + j) as u32;
    let mut triangles = Vec::new();
    for i in 0..nx - 1 {
        for j in 0..ny - 1 {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            let cell = if is_other_diagonal(i, j) { [[a, b, d], [b, c, d]] } else { [[a, b, c], [a, c, d]] };
            for [a, b, c] in cell {
                triangles.extend([[a, b, c], [a + count, c + count, b + count]]);
            }
        }
    }
    let mut wall = |a: u32, b: u32| {
        triangles.extend([[a, a + count, b + count], [a, b + count, b]]);
    };
    for i in 0..nx - 1 {
        wall(at(i, 0), at(i + 1, 0));
        wall(at(i + 1, ny - 1), at(i, ny - 1));
    }
    for j in 0..ny - 1 {
        wall(at(nx - 1, j), at(nx - 1, j + 1));
        wall(at(0, j + 1), at(0, j));
    }
    object("floor", vertices, triangles)
}

/// Numbers from −`half` to `half`.
fn even(half: f64, steps: usize) -> Vec<f64> {
    (0..=steps).map(|i| half * (2.0 * i as f64 / steps as f64 - 1.0)).collect()
}

fn flat(x: f64, y: f64, _: bool) -> DVec3 {
    DVec3::new(x, y, TOP)
}

/// Exactly flat floors of 10 cm, by name.
fn floors() -> Vec<(&'static str, Object)> {
    let mut rng = StdRng::seed_from_u64(0x1ED6E);
    let half = 0.05;
    let irregular = |steps: usize, rng: &mut StdRng| {
        let edge = 2.0 * half / steps as f64;
        let xs = even(half, steps);
        let shifts: Vec<f64> = (0..2 * (steps + 1).pow(2)).map(|_| rng.random_range(-0.22..0.22)).collect();
        let flips: Vec<bool> = (0..steps * steps).map(|_| rng.random_range(0.0..1.0) < 0.5).collect();
        let mut next = 0;
        let place = |x: f64, y: f64, is_inner: bool| {
            next += 2;
            let share = if is_inner { edge } else { 0.0 };
            DVec3::new(x + share * shifts[next - 2], y + share * shifts[next - 1], TOP)
        };
        slab((&xs, &xs), place, |i, j| flips[i * steps + j])
    };
    let slivers = [-half, -0.0101, -0.01, -0.002, 0.0, 1e-4, 2e-4, 0.013, 0.01301, half];
    let graded = [-half, -0.02, -0.01, -0.005, -0.0025, -0.00125, 0.0, 0.00125, 0.005, 0.02, half];
    vec![
        ("two triangles", slab((&even(half, 1), &even(half, 1)), flat, |_, _| false)),
        ("eight triangles", slab((&even(half, 2), &even(half, 2)), flat, |i, j| i == j)),
        ("irregular, 17 mm", irregular(6, &mut rng)),
        ("irregular, 2 mm", irregular(50, &mut rng)),
        ("slivers", slab((&slivers, &even(half, 3)), flat, |i, j| (i + j) % 2 == 0)),
        ("graded", slab((&graded, &graded), flat, |i, j| (i + j) % 2 == 0)),
    ]
}

/// A prism of a radius and length, m, along the axis that a turn gives to z; its lowest point or face there.
fn prism(sides: u32, (radius, length): (f64, f64), turn: DQuat, phase: f64) -> Object {
    let mut vertices = vec![DVec3::Z * (-0.5 * length), DVec3::Z * (0.5 * length)];
    for i in 0..sides {
        let (sin, cos) = (TAU * (f64::from(i) + phase) / f64::from(sides)).sin_cos();
        vertices.extend([-0.5, 0.5].map(|end| DVec3::new(radius * cos, radius * sin, end * length)));
    }
    let mut triangles = Vec::new();
    for i in 0..sides {
        let [a, b] = [i, (i + 1) % sides].map(|i| 2 + 2 * i);
        triangles.extend([[0, b, a], [1, a + 1, b + 1], [a, b, b + 1], [a, b + 1, a + 1]]);
    }
    let vertices: Vec<DVec3> = vertices.into_iter().map(|v| turn * v).collect();
    object("prism", vertices, triangles)
}

/// What slides, by name, with the height of its origin over what it lies on, m.
fn sliders() -> Vec<(&'static str, Object, f64)> {
    let lying = DQuat::from_rotation_x(0.25 * TAU);
    vec![
        ("box", block(DVec3::new(0.02, 0.012, 0.008)), 0.004),
        ("hexagonal prism, standing", prism(6, (0.008, 0.012), DQuat::IDENTITY, 0.2), 0.006),
        ("hexagonal prism, lying", prism(6, (0.008, 0.012), lying, 0.0), 0.008 * (TAU / 12.0).cos()),
        ("cylinder, standing", prism(48, (0.008, 0.012), DQuat::IDENTITY, 0.0), 0.006),
        ("cylinder, lying on an edge", prism(48, (0.008, 0.012), lying, 0.0), 0.008),
        ("cylinder, lying on a face", prism(48, (0.008, 0.012), lying, 0.5), 0.008 * (TAU / 96.0).cos()),
    ]
}

fn settings(search: ContactSearch, response: Response) -> Settings {
    Settings {
        search: SearchSettings { method: search, ..SearchSettings::default() },
        contact: ContactSettings { response, friction: 0.0, ..ContactSettings::default() },
        ..Settings::default()
    }
}

/// Time in which a hand comes down, time of a slide, and time that it takes to get under way, s.
const DOWN: f64 = 0.5;
const SLIDE: f64 = 1.0;
const UNDER_WAY: f64 = 0.1;

/// A hand that comes down by 2 mm onto a floor and 2 mm into it, and slides between two places in a plane,
/// turned about the vertical.
fn sliding(height: f64, [from, to]: [DVec3; 2], turn: f64) -> IntendedPath {
    let at = move |time: f64| {
        let pressed = (time / (0.6 * DOWN)).min(1.0);
        let share = ((time - DOWN) / SLIDE).clamp(0.0, 1.0);
        from.lerp(to, share) + DVec3::Z * (TOP + height + 0.002 - 0.004 * pressed)
    };
    path(move |time| (at(time), DQuat::from_rotation_z(turn)))
}

/// The largest values of a slide.
#[derive(Clone, Copy, Debug, Default)]
struct Felt {
    /// Contact force along the floor, N, and relative to the normal force.
    lateral: f64,
    slope: f64,
    /// Contact force, N.
    force: f64,
    /// Jump of the coupling's force along an axis in a step, N.
    jump: f64,
    /// Largest height over the lowest, m.
    lift: f64,
    /// Mean normal force, N.
    normal: f64,
}

fn slide(probe: &Object, floor: &Object, path: IntendedPath, settings: Settings, rate: f64) -> Felt {
    let device = Emulation::default().open(path).expect("an emulation");
    let scene = Scene::new().with(floor.clone(), Pose::IDENTITY);
    let renderer = HapticRenderer::new(probe.clone(), scene, Box::new(device), settings).expect("a session");
    let mut session: LockstepSession = renderer.lockstep(ContactTiming::busy(rate));
    let mut felt = Felt::default();
    let (mut low, mut high, mut steps) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
    let mut before: Option<DVec3> = None;
    for _ in 0..((DOWN + SLIDE) * 1e3) as u32 {
        let record = session.step_device();
        if record.time < DOWN + UNDER_WAY {
            continue;
        }
        let (force, z) = (record.contact.force, record.object.translation.z);
        (low, high, steps) = (low.min(z), high.max(z), steps + 1.0);
        let lateral = force.x.hypot(force.y);
        felt.lateral = felt.lateral.max(lateral);
        felt.slope = felt.slope.max(lateral / force.z.max(0.05));
        felt.force = felt.force.max(force.length());
        felt.normal += force.z;
        let force = record.coupling.force;
        felt.jump = felt.jump.max(before.map_or(0.0, |before| (force - before).abs().max_element()));
        before = Some(force);
    }
    felt.lift = high - low;
    felt.normal /= steps;
    felt
}

/// Slides over a flat floor across and beside its edges, with a turn about the vertical.
const WAYS: [([f64; 4], f64); 2] = [([-0.018, 0.0, 0.012, 0.0], 0.0), ([-0.011, 0.013, 0.009, -0.007], 0.4)];

fn ends([from_x, from_y, to_x, to_y]: [f64; 4]) -> [DVec3; 2] {
    [DVec3::new(from_x, from_y, 0.0), DVec3::new(to_x, to_y, 0.0)]
}

/// Slides what is named over floors, and holds it against the bounds.
fn check(search: ContactSearch, response: Response, rate: f64, is_asked: impl Fn(&str, &str) -> bool) {
    let (floors, sliders) = (floors(), sliders());
    for (floor_name, floor) in &floors {
        for (name, probe, height) in sliders.iter().filter(|(name, ..)| is_asked(floor_name, name)) {
            for (way, turn) in WAYS {
                let path = sliding(*height, ends(way), turn);
                let felt = slide(probe, floor, path, settings(search, response), rate);
                let what = format!("{search:?}, {response:?}, {name} on {floor_name}, turned by {turn}");
                println!("{what}: {felt:.4?}");
                assert!(felt.lateral < LATERAL, "{what}: pushed sideways, {felt:?}");
                // Springs and dampers rise and fall with the encoders' steps.
                let is_still = response == Response::Penalty || felt.jump < JUMP && felt.lift < LIFT;
                assert!(is_still, "{what}: a blow, {felt:?}");
                assert!(felt.normal > 0.3, "{what}: pressed with {} N", felt.normal);
            }
        }
    }
}

/// Before directions were held against the normals of features, 0.3 to 5 N along most of these floors.
#[test]
fn flat_floors_push_up_only() {
    check(ContactSearch::Levels, Response::Constraints, 500.0, |_, _| true);
}

/// Also with points that start at samples of fields.
#[test]
fn flat_floors_found_in_fields_push_up_only() {
    let is_asked = |floor: &str, slider: &str| {
        matches!((floor, slider), ("eight triangles", "box" | "cylinder, lying on an edge"))
    };
    check(ContactSearch::Representatives, Response::Constraints, 500.0, is_asked);
}

/// What holds penalties is not the haptic loop's points, but the query's contacts.
#[test]
fn flat_floors_push_up_only_by_penalties() {
    let is_asked = |floor: &str, slider: &str| floor == "eight triangles" && slider == "box";
    check(ContactSearch::Levels, Response::Penalty, 500.0, is_asked);
}

/// An edge that does stick out is felt: by 50 µm, between slopes of one in two.
#[test]
fn an_edge_that_sticks_out_is_felt() {
    let xs = [-0.05, -1e-4, 0.0, 1e-4, 0.05];
    let ridge = |x: f64, y: f64, _| DVec3::new(x, y, TOP + if x == 0.0 { 5e-5 } else { 0.0 });
    let floor = slab((&xs, &even(0.05, 2)), ridge, |_, _| false);
    let probe = block(DVec3::new(0.02, 0.012, 0.008));
    let path = sliding(0.004, ends([-0.025, 0.0, 0.015, 0.0]), 0.0);
    let felt = slide(&probe, &floor, path, settings(ContactSearch::Levels, Response::Constraints), 500.0);
    println!("{felt:.4?}");
    assert!(felt.lateral > 10.0 * LATERAL && felt.lift > 4e-5, "{felt:?}");
}

/// On a bent floor of fine facets, the force leans by no more than their normals do.
#[test]
fn a_bent_floor_pushes_along_its_facets() {
    let (bend, edge) = (0.1, 0.002);
    let bent = |x: f64, y: f64, _| DVec3::new(x, y, TOP - 0.5 * x * x / bend);
    let floor = slab((&even(0.02, 20), &even(0.05, 50)), bent, |i, j| (i + j) % 2 == 0);
    for (name, probe, height) in sliders() {
        let path = sliding(height, ends([0.0, -0.018, 0.0, 0.012]), 0.0);
        let felt = slide(&probe, &floor, path, settings(ContactSearch::Levels, Response::Constraints), 500.0);
        println!("{name}: {felt:.4?}");
        assert!(felt.slope < edge / bend + LATERAL, "{name}: {felt:?}");
    }
}

/// Over the floor's outer edge and down beside it.
#[test]
fn a_slide_over_the_rim_is_no_blow() {
    let floor = slab((&even(0.05, 4), &even(0.05, 4)), flat, |i, j| (i + j) % 2 == 0);
    for (name, probe, height) in sliders() {
        let path = sliding(height, ends([0.035, 0.003, 0.075, 0.003]), 0.0);
        let felt = slide(&probe, &floor, path, settings(ContactSearch::Levels, Response::Constraints), 500.0);
        println!("{name}: {felt:.4?}");
        assert!(felt.force < 1.5 && felt.jump < 0.2, "{name}: {felt:?}");
    }
}
