//! Sessions with contacts as constraints: by an exact query of the recorded poses, surfaces do not overlap.
#![expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use std::f64::consts::{PI, TAU};

use palpate::collide::{ContactQuery, ContactSet, ContactSetSettings, QuerySettings};
use palpate::device::{Emulation, IntendedPath};
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{
    ContactSearch, ContactSettings, CouplingSettings, Response, SearchSettings, ToolSettings,
};
use palpate::{
    ContactTiming, HapticRenderer, LockstepSession, Object, Pose, Record, Scene, SceneEditor, SceneId,
    Settings, Twist,
};

use super::bodies::{ball, block, block_about, path, turned};

/// Largest overlap that constraints leave, m.
const OVERLAP: f64 = 2e-5;

/// The same where contacts found at 50 Hz are with many small faces.
const LATE_OVERLAP: f64 = 1e-4;

/// A cup whose hollow is a hemisphere of 1.2 cm, its rim at z = 0.
fn cup() -> Object {
    let hollow = |i: u32| {
        (0.012 * (0.5 * PI * f64::from(i) / 8.0).cos(), -0.012 * (0.5 * PI * f64::from(i) / 8.0).sin())
    };
    let outside = [(0.0, -0.016), (0.016, -0.016), (0.016, 0.0)];
    let profile: Vec<_> = outside.into_iter().chain((0..=8).map(hollow)).collect();
    turned("cup", &profile, 32)
}

/// Both searches for contacts.
const SEARCHES: [ContactSearch; 2] = [ContactSearch::Levels, ContactSearch::Representatives];

fn settings(response: Response, friction: f64) -> Settings {
    found_by(ContactSearch::Levels, response, friction)
}

fn found_by(method: ContactSearch, response: Response, friction: f64) -> Settings {
    Settings {
        search: SearchSettings { tolerance: Some(5e-4), method, ..SearchSettings::default() },
        tool: ToolSettings { mass: 0.05, ..ToolSettings::default() },
        coupling: CouplingSettings { stiffness: Some(500.0), ..CouplingSettings::default() },
        contact: ContactSettings { response, friction, stiffness: 5000.0, ..ContactSettings::default() },
        ..Settings::default()
    }
}

struct Rig {
    session: LockstepSession,
    editor: SceneEditor,
    poses: Vec<Pose>,
    exact: Vec<(ContactQuery, ContactSet)>,
    deepest: f64,
}

impl Rig {
    fn new(
        probe: &Object,
        scene: &[(Object, Pose)],
        path: impl Into<IntendedPath>,
        settings: Settings,
        rate: f64,
    ) -> Self {
        let device = Emulation::default().open(path).expect("an emulation");
        let mut placed = Scene::new();
        for (object, pose) in scene {
            placed = placed.with(object.clone(), *pose);
        }
        let mut renderer =
            HapticRenderer::new(probe.clone(), placed, Box::new(device), settings).expect("a session");
        let editor = renderer.scene_editor();
        let exact = |object: &Object| {
            (ContactQuery::new(probe.shape(), object.shape()), ContactSet::new(probe.shape(), object.shape()))
        };
        Self {
            session: renderer.lockstep(ContactTiming::busy(rate)),
            editor,
            exact: scene.iter().map(|(object, _)| exact(object)).collect(),
            poses: scene.iter().map(|(_, pose)| *pose).collect(),
            deepest: f64::NEG_INFINITY,
        }
    }

    fn step(&mut self) -> Record {
        let record = self.session.step_device();
        self.deepest = self.deepest.max(self.overlap(&record.object));
        record
    }

    /// Depth of the probe at a pose in the scene by exact queries at full resolution, m; negative if it is
    /// further than 0.1 mm away.
    fn overlap(&mut self, pose: &Pose) -> f64 {
        let mut deepest: f64 = -1e-4;
        for ((query, set), at) in self.exact.iter_mut().zip(&self.poses) {
            query.run(pose, at, &QuerySettings::new(1e-4)).expect("finite");
            let merged = ContactSetSettings::new(1e-6);
            let found = set.run(query.contacts(), pose, at, &merged).expect("finite");
            deepest = found.iter().map(|found| found.contact.depth).fold(deepest, f64::max);
        }
        deepest
    }
}

/// A hand that presses a box on a plate, and slides, turns and tilts it around a place.
fn rubbing(at: DVec3) -> IntendedPath {
    path(move |time| rubbed_pose(at, time))
}

/// Position (m) and orientation of the box at a time, s.
fn rubbed_pose(at: DVec3, time: f64) -> (DVec3, DQuat) {
    let pressed = (time / 0.3).min(1.0);
    let angle = 4.0 * (time - 0.3).max(0.0);
    let circle = 0.01 * DVec3::new(angle.cos() - 1.0, angle.sin(), 0.0);
    let tilt = DQuat::from_rotation_x(0.2 * (2.3 * angle).sin());
    let turn = DQuat::from_rotation_z(0.3 * angle.sin()) * tilt;
    (at + circle + DVec3::Z * (0.018 - 0.006 * pressed), turn)
}

/// Largest overlap (m) of a box that is rubbed on a plate around a place, and the mean force on the hand, N.
fn rubbed(at: DVec3, settings: Settings, rate: f64) -> (f64, f64) {
    let (probe, plate) = (block(DVec3::splat(0.03)), block(DVec3::new(0.1, 0.1, 0.005)));
    let below = Pose::from_translation(DVec3::NEG_Z * 0.0025);
    let mut rig = Rig::new(&probe, &[(plate, below)], rubbing(at), settings, rate);
    let force: f64 = (0..2000).map(|_| rig.step().coupling.force.z).sum();
    (rig.deepest, force / 2000.0)
}

#[test]
fn a_box_that_is_rubbed_on_a_plate_does_not_enter_it() {
    for search in SEARCHES {
        for (rate, friction) in [(500.0, 0.0), (500.0, 0.3), (100.0, 0.3), (50.0, 0.0), (50.0, 0.3)] {
            let settings = found_by(search, Response::Constraints, friction);
            let (deepest, force) = rubbed(DVec3::ZERO, settings, rate);
            println!("{search:?}, {rate} Hz, μ {friction}: {deepest:.1e} m, {force:.2} N");
            assert!(deepest < OVERLAP, "{search:?}, {rate} Hz, μ {friction}: {deepest} m");
            assert!(force > 0.4, "{search:?}, {rate} Hz, μ {friction}: pressed with {force} N");
        }
    }
    let (deepest, _) = rubbed(DVec3::ZERO, settings(Response::Penalty, 0.0), 50.0);
    assert!(deepest > 20.0 * OVERLAP, "with penalties {deepest} m, and nothing is shown");
}

/// Over the rim of the plate, where corners leave it and edges begin to cross.
#[test]
fn a_box_that_is_rubbed_over_a_rim_does_not_enter_it() {
    for search in SEARCHES {
        for rate in [500.0, 50.0] {
            let settings = found_by(search, Response::Constraints, 0.2);
            let (deepest, force) = rubbed(DVec3::X * -0.02, settings, rate);
            println!("{search:?}, {rate} Hz: {deepest:.1e} m, {force:.2} N");
            assert!(deepest < OVERLAP && force > 0.4, "{search:?}, {rate} Hz: {deepest} m, {force} N");
        }
    }
}

/// Also where the origin of its mesh, at which it is held, is far from it: the lever makes the coupling soft.
/// With late contacts it waits for none, so that its force is that with contacts in each step.
#[test]
fn a_box_with_late_contacts_slides_as_with_early_ones() {
    let settings = settings(Response::Constraints, 0.0);
    let plate = block(DVec3::new(0.06, 0.06, 0.005));
    let below = Pose::from_translation(DVec3::NEG_Z * 0.0025);
    for (center, least) in [(DVec3::ZERO, 0.4), (DVec3::X * 0.7, 0.05)] {
        let probe = block_about(center, DVec3::splat(0.03));
        let [early, late] = [1000.0, 100.0].map(|rate| {
            let hand = path(move |time| {
                let (position, turn) = rubbed_pose(DVec3::ZERO, time);
                (position - turn * center, turn)
            });
            let mut rig = Rig::new(&probe, &[(plate.clone(), below)], hand, settings, rate);
            let force = (0..1000).map(|_| rig.step().coupling.force.z).sum::<f64>() / 1000.0;
            let waited = rig.session.events().waited;
            println!("about {center}, {rate} Hz: {force:.4} N, waits {waited} steps, {:.1e} m", rig.deepest);
            assert!(waited < 10, "about {center}: waits in {waited} of 1000 steps");
            assert!(rig.deepest < OVERLAP, "about {center}: {} m", rig.deepest);
            force
        });
        assert!(early > least && (late - early).abs() < 0.05 * early, "{center}: {early} N, {late} N");
    }
}

#[test]
fn a_ball_swirls_in_a_cup() {
    let (probe, cup) = (ball(0.01, (12, 24)), cup());
    for (search, rate, steps) in [(0, 250.0, 800), (0, 50.0, 1500), (1, 250.0, 800), (1, 50.0, 1500)] {
        let swirl = |time: f64| {
            let (angle, down) = (TAU * time, (time / 0.3).min(1.0));
            let aside = 0.004 * DVec3::new(angle.cos(), angle.sin(), 0.0);
            (aside + DVec3::Z * (0.014 - 0.018 * down), DQuat::from_rotation_z(0.5 * angle.sin()))
        };
        let settings = found_by(SEARCHES[search], Response::Constraints, 0.2);
        let mut rig = Rig::new(&probe, &[(cup.clone(), Pose::IDENTITY)], path(swirl), settings, rate);
        let force = (0..steps).map(|_| rig.step().coupling.force.length()).fold(0.0, f64::max);
        let overflow = rig.session.events().contact_overflow;
        println!("{search}, {rate} Hz: {:.1e} m, {force:.2} N, {overflow} too many points", rig.deepest);
        let most = if rate > 100.0 { OVERLAP } else { LATE_OVERLAP };
        assert!(rig.deepest < most, "{rate} Hz: {} m", rig.deepest);
        assert!(force > 0.5, "{rate} Hz: pressed with {force} N");
    }
}

/// Largest overlap with, and lowest height over, a wall of 0.2 mm at which a box is thrown at 2 m/s, m.
fn thrown(settings: Settings, rate: f64, tilt: DQuat) -> (f64, f64) {
    let (probe, wall) = (block(DVec3::splat(0.02)), block(DVec3::new(0.06, 0.06, 2e-4)));
    let hit = move |time: f64| (DVec3::Z * (0.05 - 2.0 * (time - 0.05).max(0.0)).max(-0.01), tilt);
    let mut rig = Rig::new(&probe, &[(wall, Pose::IDENTITY)], path(hit), settings, rate);
    let lowest = (0..400).map(|_| rig.step().object.translation.z).fold(f64::INFINITY, f64::min);
    (rig.deepest, lowest)
}

#[test]
fn a_thin_wall_holds_what_is_thrown_at_it() {
    let throws = [(500.0, DVec3::X * 0.3), (50.0, DVec3::X * 0.3), (50.0, DVec3::new(0.5, 0.4, 0.2))];
    for (search, (rate, turn)) in SEARCHES.iter().flat_map(|&search| throws.map(|throw| (search, throw))) {
        let settings = found_by(search, Response::Constraints, 0.2);
        let (deepest, lowest) = thrown(settings, rate, DQuat::from_scaled_axis(turn));
        println!("{search:?}, {rate} Hz, {turn}: {deepest:.1e} m, lowest {lowest}");
        assert!(deepest < OVERLAP && lowest > 0.01, "{search:?}, {rate} Hz, {turn}: {deepest} m, {lowest}");
        assert!(lowest < 0.015, "{search:?}, {rate} Hz, {turn}: held back at {lowest}");
    }
    let (deepest, lowest) = thrown(settings(Response::Penalty, 0.2), 50.0, DQuat::from_rotation_x(0.3));
    assert!(deepest > 1e-3 && lowest < 0.0, "with penalties {deepest} m, lowest {lowest}: nothing is shown");
}

/// Moves scene objects along z at a speed (m/s) from their poses for a time (s), as a host does at 60 Hz, and
/// then stops them.
fn drive(rig: &mut Rig, speeds: &[f64], seconds: f64, rest: f64) -> Record {
    let start = rig.poses.clone();
    let steps = (seconds / 1e-3).round() as u32;
    let mut last = rig.step();
    for step in 0..steps + (rest / 1e-3).round() as u32 {
        let time = f64::from(step.min(steps)) * 1e-3;
        for (index, (pose, speed)) in start.iter().zip(speeds).enumerate() {
            let now = Pose { translation: pose.translation + DVec3::Z * (speed * time), ..*pose };
            let speed = if step < steps { *speed } else { 0.0 };
            rig.poses[index] = now;
            if step % 16 == 0 || step == steps {
                let twist = Twist::new(DVec3::Z * speed, DVec3::ZERO);
                rig.editor.set_motion(SceneId(index), now, twist).expect("room");
            }
        }
        last = rig.step();
    }
    last
}

#[test]
fn a_plate_that_a_host_moves_pushes_the_body() {
    let (probe, plate) = (block(DVec3::splat(0.03)), block(DVec3::new(0.1, 0.1, 0.005)));
    let below = Pose::from_translation(DVec3::NEG_Z * 0.0185);
    for rate in [500.0, 100.0] {
        let settings = settings(Response::Constraints, 0.3);
        let still = IntendedPath::Still(Pose::IDENTITY);
        let mut rig = Rig::new(&probe, &[(plate.clone(), below)], still, settings, rate);
        let speed = 0.03;
        let last = drive(&mut rig, &[speed], 0.4, 0.2);
        println!("{rate} Hz: {:.1e} m, at {}", rig.deepest, last.object.translation);
        // The plate's top was 1 mm below the box, and rose by 12 mm.
        assert!(
            (last.object.translation.z - 0.011).abs() < 1e-3,
            "{rate} Hz: at {}",
            last.object.translation
        );
        // A query sees where the host has moved it by then.
        assert!(rig.deepest < speed / rate + OVERLAP, "{rate} Hz: {} m", rig.deepest);
        assert!(last.coupling.force.z > 0.5, "{rate} Hz: {}", last.coupling.force);
    }
}

/// Plates that close to 1 mm less than the body's height: it is squeezed, and stays between them.
#[test]
fn closing_plates_squeeze_the_body() {
    let (probe, plate) = (block(DVec3::splat(0.03)), block(DVec3::new(0.1, 0.1, 0.005)));
    let scene = [1.0, -1.0].map(|side| (plate.clone(), Pose::from_translation(DVec3::Z * (side * 0.02))));
    let still = IntendedPath::Still(Pose::IDENTITY);
    let mut rig = Rig::new(&probe, &scene, still, settings(Response::Constraints, 0.3), 200.0);
    let last = drive(&mut rig, &[-0.02, 0.02], 0.15, 0.3);
    println!("{:.1e} m, at {}", rig.deepest, last.object.translation);
    assert!(last.object.translation.length() < 1e-3, "at {}", last.object.translation);
    assert!(last.coupling.force.is_finite() && last.coupling.force.length() < 1.0, "{}", last.coupling.force);
    // Each overlaps by half of what there is no room for.
    assert!(rig.deepest < 1e-3 && rig.deepest > 4e-4, "{} m", rig.deepest);
    assert_eq!(rig.session.events().step_refused, 0);
}

#[test]
fn an_object_that_is_removed_holds_the_body_no_longer() {
    let (probe, plate) = (block(DVec3::splat(0.03)), block(DVec3::new(0.1, 0.1, 0.005)));
    let below = Pose::from_translation(DVec3::NEG_Z * 0.0025);
    let settings = settings(Response::Constraints, 0.3);
    let mut rig = Rig::new(&probe, &[(plate, below)], rubbing(DVec3::ZERO), settings, 50.0);
    let mut held = rig.step();
    for _ in 0..700 {
        held = rig.step();
    }
    assert!(held.contacts > 0 && held.contact.force.z > 0.3, "{held:?}");
    rig.editor.remove(SceneId(0)).expect("room");
    // A query sees it gone, and its result arrives a period later.
    for _ in 0..60 {
        rig.step();
    }
    for _ in 0..500 {
        let free = rig.step();
        assert!(free.contacts == 0 && free.contact.force == DVec3::ZERO && free.depth == 0.0, "{free:?}");
    }
    let free = rig.step();
    let lag = free.object.translation.distance(free.handle.translation);
    assert!(free.object.translation.z < 0.013 && lag < 2e-3, "{free:?}");
}
