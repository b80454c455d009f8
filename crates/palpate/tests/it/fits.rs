//! Bodies that start in an overlap from opposite sides, which no motion undoes, with contacts as constraints.
#![expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use palpate::device::Emulation;
use palpate::glam::{DQuat, DVec3};
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Record, Scene, Settings};

use super::bodies::{ball, block, halved, object, path};

/// A prism along an axis `up` from −`half` to `half` (m), of outlines around it counterclockwise, of which
/// quadrangles of corners make up the caps.
fn prism(name: &str, half: f64, outlines: &[&[DVec3]], up: DVec3, caps: &[[u32; 4]]) -> Object {
    let corners: Vec<DVec3> = outlines.iter().flat_map(|outline| outline.iter().copied()).collect();
    let count = corners.len() as u32;
    let lifted = |side: f64| corners.iter().map(move |corner| *corner + up * (side * half));
    let mut faces: Vec<[u32; 4]> = Vec::new();
    let mut first = 0;
    for outline in outlines {
        let length = outline.len() as u32;
        faces.extend((0..length).map(|i| {
            let (a, b) = (first + i, first + (i + 1) % length);
            [a, b, b + count, a + count]
        }));
        first += length;
    }
    for &[a, b, c, d] in caps {
        faces.push([a, b, c, d].map(|i| i + count));
        faces.push([d, c, b, a]);
    }
    object(name, lifted(-1.0).chain(lifted(1.0)).collect(), halved(faces))
}

/// A plate 15 mm thick with a square hole of 9.9 mm along z.
fn plate() -> Object {
    let square = |half: f64| {
        [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].map(|(x, y)| DVec3::new(x, y, 0.0) * half)
    };
    let (outer, mut inner) = (square(0.015), square(0.00495));
    // Corners of the hole: 4 at (1, 1), and the other way round.
    inner[1..].reverse();
    let caps = [[0, 1, 7, 4], [1, 2, 6, 7], [2, 3, 5, 6], [3, 0, 4, 5]];
    prism("plate", 0.0075, &[&outer, &inner], DVec3::Z, &caps)
}

/// Records of a hand that follows a path with a probe in a scene, and the smallest energy at the device, J.
fn session(
    probe: &Object,
    scene: &[(&Object, DVec3)],
    hand: impl Fn(f64) -> (DVec3, DQuat) + Send + 'static,
    (rate, seconds): (f64, f64),
) -> (Vec<Record>, f64) {
    let device = Emulation::default().open(path(hand)).expect("an emulation");
    let placed = scene
        .iter()
        .fold(Scene::new(), |scene, (object, at)| scene.with((*object).clone(), Pose::from_translation(*at)));
    let renderer = HapticRenderer::new(probe.clone(), placed, Box::new(device), Settings::default());
    let mut session = renderer.expect("a session").lockstep(ContactTiming::busy(rate));
    let records = (0..(seconds * 1e3) as u32).map(|_| session.step_device()).collect();
    (records, session.finish().haptic.energy_min)
}

/// A shaft that starts in a hole narrower by 0.1 mm than itself goes along it with the hand.
#[test]
fn a_shaft_that_starts_in_a_press_fit_is_free_along_its_hole() {
    let (shaft, plate) = (block(DVec3::new(0.01, 0.01, 0.04)), plate());
    let hand = |time: f64| (DVec3::Z * 0.005 * (2.0 * (time - 0.2).max(0.0)).sin(), DQuat::IDENTITY);
    let (records, energy) = session(&shaft, &[(&plate, DVec3::ZERO)], hand, (500.0, 2.0));
    let apart =
        records.iter().map(|r| (r.object.translation - r.handle.translation).length()).fold(0.0, f64::max);
    let force = records.iter().map(|r| r.coupling.force.length()).fold(0.0, f64::max);
    let depth = records.last().expect("steps").depth;
    println!("{apart:.1e} m apart, {force:.3} N, {energy:.1e} J, {depth:.1e} m deep");
    assert!(depth > 4e-5, "{depth} m: it is in no press fit");
    assert!(apart < 3e-4 && force < 0.3, "{apart} m, {force} N along the hole");
    assert!(energy > -1e-4, "{energy} J");
}

/// A ball that two plates overlap by 0.5 mm each is dragged along them and out over their edges.
#[test]
fn a_ball_between_plates_that_overlap_it_is_free_along_them() {
    let (ball, plate) = (ball(0.005, (18, 36)), block(DVec3::new(0.04, 0.04, 0.02)));
    let hand = |time: f64| (DVec3::X * 0.03 * (time - 0.2).clamp(0.0, 1.0), DQuat::IDENTITY);
    let plates = [1.0, -1.0].map(|side| (&plate, DVec3::Z * (0.0145 * side)));
    for rate in [1000.0, 500.0, 100.0] {
        let (records, energy) = session(&ball, &plates, hand, (rate, 1.4));
        let apart = records
            .iter()
            .map(|r| (r.object.translation - r.handle.translation).length())
            .fold(0.0, f64::max);
        let force = records.iter().map(|r| r.coupling.force.length()).fold(0.0, f64::max);
        let depth = records.iter().map(|r| r.depth).fold(0.0, f64::max);
        let out = records.last().expect("steps").object.translation.x;
        println!("{rate} Hz: {apart:.1e} m apart, {force:.3} N, {energy:.1e} J, {depth:.1e} m deep");
        assert!(depth > 4e-4, "{rate} Hz: {depth} m: the plates do not overlap it");
        assert!(out > 0.029, "{rate} Hz: {out} m: it stays between the plates");
        // Where the plates' edges come into the ball, steps are held for a millisecond.
        assert!(apart < 5e-4 && force < 0.5, "{rate} Hz: {apart} m, {force} N along the plates");
        assert!(energy > -1e-4, "{rate} Hz: {energy} J");
    }
}

/// Golf balls that start deep in each other come free: between their dimples, no direction out of one of them
/// is a normal of the other one.
#[test]
#[cfg(feature = "models")]
fn golf_balls_that_start_deep_in_each_other_come_free() {
    let ball = Object::model("golf-ball@5000").expect("a model");
    // 2 mm deep; the hand stays where it is.
    let start = DVec3::Z * 0.0407;
    let (records, energy) =
        session(&ball, &[(&ball, DVec3::ZERO)], move |_| (start, DQuat::IDENTITY), (500.0, 2.0));
    let (first, last) = (&records[100], records.last().expect("steps"));
    let force = records.iter().map(|r| r.coupling.force.length()).fold(0.0, f64::max);
    println!("{:.1e} m, then {:.1e} m deep, {force:.2} N, {energy:.1e} J", first.depth, last.depth);
    assert!(first.depth > 1e-3, "{} m at the start", first.depth);
    assert!(last.depth < 1e-5, "still {} m deep", last.depth);
    // It lies on the other one, and what it does to the hand is what its weak push takes there.
    assert!(force > 0.1 && force < 0.6 && energy > -1e-3, "{force} N, {energy} J");
}
