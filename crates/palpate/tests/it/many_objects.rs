//! Scenes of many objects: those that are far do not hold a body, and none takes much memory.
#![expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use std::f64::consts::TAU;

use palpate::device::{Emulation, IntendedPath};
use palpate::dynamics::BodyState;
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{ContactSearch, ContactSettings, Response, SearchSettings};
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Record, Scene, SceneId, Settings};

use super::bodies::{ball, block, path};

/// Largest overlap, m.
const OVERLAP: f64 = 2e-5;

fn settings(method: ContactSearch, response: Response) -> Settings {
    Settings {
        contact: ContactSettings { response, ..ContactSettings::default() },
        search: SearchSettings { method, ..SearchSettings::default() },
        ..Settings::default()
    }
}

fn placed(objects: impl IntoIterator<Item = (Object, DVec3)>) -> Scene {
    let with = |scene: Scene, (object, at)| scene.with(object, Pose::from_translation(at));
    objects.into_iter().fold(Scene::new(), with)
}

/// A rod of 20 cm, and cubes within its bounding sphere, none of which is within 20 mm of it. The first is
/// beside its middle, 25 mm towards +x; none is in the way to that.
fn rod_among_cubes(count: u32) -> (Object, Vec<(Object, DVec3)>) {
    let cube = block(DVec3::splat(0.01));
    let at = |i: u32| {
        let share = f64::from(i) / f64::from(count);
        let (sin, cos) = (TAU * if i == 0 { 0.0 } else { 1.0 / 6.0 + 2.0 / 3.0 * share }).sin_cos();
        DVec3::new(0.032 * cos, 0.032 * sin, if i == 0 { 0.0 } else { 0.14 * (share - 0.5) })
    };
    (block(DVec3::new(0.004, 0.004, 0.2)), (0..count).map(|i| (cube.clone(), at(i))).collect())
}

/// The hand moves the rod along its axis and to all sides, 5 mm, and from 1 s on against the first cube, as
/// far as 5 mm behind its face.
fn about_and_aside(time: f64) -> DVec3 {
    let (sin, cos) = (TAU * (time - 0.2).clamp(0.0, 0.5) / 0.25).sin_cos();
    let aside = 0.03 * ((time - 1.0) / 0.3).clamp(0.0, 1.0);
    DVec3::new(0.005 * sin + aside, 0.005 * (1.0 - cos) / 2.0, 0.01 * sin)
}

/// Number of steps in which nothing is in the way.
const FREE: usize = 1000;

/// Records of a rod in a scene, with contacts at a rate (Hz), and how often it waited.
fn records(rod: &Object, scene: Vec<(Object, DVec3)>, settings: Settings, rate: f64) -> (Vec<Record>, u64) {
    let hand = path(|time| (about_and_aside(time), DQuat::IDENTITY));
    let device = Emulation::default().open(hand).expect("an emulation");
    let renderer = HapticRenderer::new(rod.clone(), placed(scene), Box::new(device), settings);
    let mut session = renderer.expect("a session").lockstep(ContactTiming::busy(rate));
    let records = (0..1600).map(|_| session.step_device()).collect();
    (records, session.events().waited)
}

/// A rod moves among objects in its bounding sphere as if they were not there, until it comes to one, which
/// holds it.
#[test]
fn a_rod_moves_freely_among_objects_that_are_far_from_it() {
    for (count, method) in [9, 12, 32]
        .into_iter()
        .flat_map(|count| [ContactSearch::Levels, ContactSearch::Representatives].map(|by| (count, by)))
    {
        for rate in [500.0, 50.0] {
            let (rod, cubes) = rod_among_cubes(count);
            let made = settings(method, Response::Constraints);
            let (alone, _) = records(&rod, Vec::new(), made, rate);
            let (among, waited) = records(&rod, cubes, made, rate);
            let between = |a: &Record, b: &Record| a.object.translation.distance(b.object.translation);
            let apart = alone[..FREE].iter().zip(&among).map(|(a, b)| between(a, b)).fold(0.0, f64::max);
            let way = among[..FREE].windows(2).map(|two| between(&two[0], &two[1])).sum::<f64>();
            let furthest = among.iter().map(|r| r.object.translation.x).fold(f64::NEG_INFINITY, f64::max);
            let [free, held] = [&alone, &among].map(|records| records[records.len() - 1]);
            let pressed = -held.coupling.force.x;
            let case = format!("{count} objects, {method:?}, {rate} Hz");
            println!(
                "{case}: {apart:.1e} m off in {way:.3} m, waited {waited}; to {furthest:.6} m, {pressed:.2} N"
            );
            assert!(
                apart < 1e-6 && way > 0.1 && waited == 0,
                "{case}: {apart} m off in {way} m, waited {waited}"
            );
            assert!((furthest - 0.025).abs() < OVERLAP && pressed > 0.5, "{case}: {furthest} m, {pressed} N");
            // Negative control: without objects it goes on.
            assert!(free.object.translation.x > 0.029, "{case}: alone to {} m", free.object.translation.x);
        }
    }
}

/// A plate of 8 cm between 64 beads and a slab, which it touches, beads first.
fn beads_and_a_slab() -> (Object, Vec<(Object, DVec3)>) {
    let (bead, slab) = (ball(2.8e-3, (28, 28)), block(DVec3::new(0.1, 0.1, 0.02)));
    let at = |i: u32| DVec3::new(f64::from(i % 8) - 3.5, f64::from(i / 8) - 3.5, -0.4) * 0.007;
    let mut scene: Vec<_> = (0..64).map(|i| (bead.clone(), at(i))).collect();
    scene.push((slab, DVec3::Z * 0.03));
    (block(DVec3::new(0.08, 0.08, 0.02)), scene)
}

/// A pair with penalty contacts takes two and a half megabytes, nearly all of them from the start. Of objects
/// that are removed nothing is kept. With a table of all parts of the probe's surroundings a pair took 19.
#[test]
fn pairs_with_penalties_take_little_memory() {
    for method in [ContactSearch::Levels, ContactSearch::Representatives] {
        let (plate, scene) = beads_and_a_slab();
        let count = scene.len();
        let at = Pose::from_translation(DVec3::Z * 0.0099);
        let device = Emulation::default().open(IntendedPath::Still(at)).expect("an emulation");
        let made = settings(method, Response::Penalty);
        let made = HapticRenderer::new(plate, placed(scene), Box::new(device), made);
        let mut renderer = made.expect("a session");
        let mut editor = renderer.scene_editor();
        let (_, mut contact, _) = renderer.into_loops();
        let reserved = contact.workspace_bytes();
        let mut step = |time: f64| {
            let _ = contact.step(&BodyState::at_rest(at), time);
            (contact.workspace_bytes(), contact.contacts().count())
        };
        let (near, touching) = step(0.0);
        (0..count).for_each(|index| editor.remove(SceneId(index)).expect("room"));
        let (left, none) = step(2e-3);
        println!("{method:?}: {reserved} bytes, {near} with {touching} contacts, {left} without objects");
        assert!(touching > 64 && none == 0, "{method:?}: {touching} contacts, {none} without objects");
        assert!(near - left < count * 3_000_000, "{method:?}: {near} bytes, {left} without objects");
        assert!(near - reserved < count * 400_000, "{method:?}: {near} bytes, {reserved} from the start");
        assert!(left < 25_000_000, "{method:?}: {left} bytes without objects");
    }
}
