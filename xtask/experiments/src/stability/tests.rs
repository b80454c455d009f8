//! Tests of the judging functions, and of the cheap maps from end to end.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::path::Path;

use palpate::Pose;
use palpate::device::Hand;
use palpate::glam::DVec3;

use super::geometry::Geometry;
use super::grid::ScanCase;
use palpate_measure::{Outcome, judge};

use super::conditions::SampledWall;
use super::page::{Entry, Section, Verdict, render};
use super::rig::{Rig, ball};
use super::wall::{Motion, Velocity, WallCase};
use super::{Arguments, Name, meshes, pressing, run};

/// One second of an oscillation at 20 Hz that grows by `rate` (1/s), with one coordinate at rest.
fn oscillation(amplitude: f64, rate: f64) -> Vec<[f64; 2]> {
    (0..10_000)
        .map(|sample| {
            let time = f64::from(sample) * 1e-4;
            [0.3, amplitude * (rate * time).exp() * (TAU * 20.0 * time).sin()]
        })
        .collect()
}

fn judged(amplitude: f64, rate: f64, floor: f64) -> Outcome {
    judge(&oscillation(amplitude, rate), floor).0
}

#[test]
fn a_motion_is_judged_by_its_amplitude_and_its_decay() {
    assert_eq!(judged(1e-3, 0.0, 2.1e-3), Outcome::Quiet);
    assert_eq!(judged(1e-3, 0.0, 1.9e-3), Outcome::Oscillating);
    // The limit is a decrease by a fifth in half a second: ln 0.8 / 0.5 s = −0.446/s.
    assert_eq!(judged(1e-3, -0.44, 1e-5), Outcome::Oscillating);
    assert_eq!(judged(1e-3, -0.46, 1e-5), Outcome::Decaying);
    assert_eq!(judged(1e-3, 2.0, 1e-5), Outcome::Oscillating);
    assert_eq!(judged(1e-3, 2.0, 1.0), Outcome::Quiet);
    for (bad, sample) in [(f64::NAN, 100), (f64::INFINITY, 4321), (f64::NEG_INFINITY, 9999)] {
        let mut spoilt = oscillation(1e-9, 0.0);
        spoilt[sample][1] = bad;
        assert_eq!(judge(&spoilt, 1.0).0, Outcome::Diverged, "{bad} at {sample}");
    }
    // One early peak does not turn a steady cycle into a decay.
    let mut bumpy = oscillation(1e-3, 0.0);
    bumpy[100][1] = 3e-3;
    assert_eq!(judge(&bumpy, 1e-5).0, Outcome::Oscillating);
    assert!(Outcome::Quiet.is_stable() && Outcome::Decaying.is_stable());
    assert!(!Outcome::Oscillating.is_stable() && !Outcome::Diverged.is_stable());
}

#[test]
fn amplitudes_are_from_peak_to_peak() {
    let (_, amplitude) = judge(&oscillation(1e-3, 0.0), 0.0);
    assert!((amplitude - 2e-3).abs() < 1e-8, "{amplitude}");
}

#[test]
fn conditions_hold_up_to_their_limits() {
    let wall = SampledWall {
        device_damping: 1.0,
        friction: 0.04,
        stiffness: 1000.0,
        damping: 0.0,
        lag: 0.0,
        period: 1e-3,
        delay: 0.0,
        quantum: 3e-5,
    };
    // b > K T/2 + |B|: 1 > 0.5 + |B|.
    for (damping, passive) in [(0.0, true), (0.49, true), (0.5, false), (-0.49, true), (-0.51, false)] {
        assert_eq!(SampledWall { damping, ..wall }.colgate_schenkel(), passive, "B = {damping}");
    }
    // K ≤ min(2 · 1/0.001, 2 · 0.04/Δ).
    for (stiffness, quantum, passive) in [
        (1999.0, 3e-5, true),
        (2001.0, 3e-5, false),
        (1999.0, 5e-5, false),
        (1599.0, 5e-5, true),
        (1999.0, 0.0, true),
    ] {
        let wall = SampledWall { stiffness, quantum, delay: 5e-3, ..wall };
        assert_eq!(wall.abbott_okamura(), passive, "K = {stiffness}, Δ = {quantum}: whatever the delay");
    }
    // b ≥ K (T/2 + t_d): K ≤ 1/(0.5 ms + t_d).
    for (stiffness, delay, passive) in
        [(666.0, 1e-3, true), (667.0, 1e-3, false), (181.0, 5e-3, true), (182.0, 5e-3, false)]
    {
        assert_eq!(SampledWall { stiffness, delay, ..wall }.diolaiti(), passive, "K = {stiffness}");
    }
    assert!(!SampledWall { friction: 0.0, ..wall }.diolaiti(), "nothing makes up for rounding");
}

#[test]
fn passive_walls_are_stable_and_stiff_ones_on_a_bare_device_are_not() {
    for motion in Motion::ALL {
        let bare = WallCase {
            hand: ("none", Hand::NONE),
            friction: false,
            quantum: 0.0,
            velocity: Velocity::BackwardDifference,
            ..WallCase::base(motion)
        };
        let passive = WallCase { stiffness: 500.0, damping: 0.2, ..bare };
        assert!(passive.sampled().colgate_schenkel());
        let result = passive.run().unwrap();
        assert!(result.outcome.is_stable() && result.hand_energy > -1e-5, "{motion:?}: {result:?}");
        let stiff = WallCase { stiffness: 15_000.0, ..bare };
        let result = stiff.run().unwrap();
        assert!(!result.outcome.is_stable(), "{motion:?}: {result:?}");
        let late = WallCase { stiffness: 1000.0, delay: 5e-3, ..bare };
        let result = late.run().unwrap();
        assert!(!result.outcome.is_stable(), "{motion:?}: {result:?}");
    }
}

#[test]
fn a_rounded_wall_wanders_unless_friction_holds_it() {
    let bare =
        WallCase { hand: ("none", Hand::NONE), stiffness: 1000.0, ..WallCase::base(Motion::Translation) };
    let held = bare.run().unwrap();
    assert!(held.outcome.is_stable() && held.amplitude < bare.quantum, "{held:?}");
    let slippery = WallCase { friction: false, quantum: 1e-3, ..bare }.run().unwrap();
    assert!(slippery.amplitude > 1e-4, "{slippery:?}");
}

#[test]
fn a_ball_pressed_by_the_rig_is_held_by_springs_in_series() {
    let rig = |stiffness, frozen, rate| {
        let rig = Rig::new(ball(0.1).unwrap(), Pose::IDENTITY, stiffness, Geometry::Plane);
        Rig { frozen, contact_rate: rate, ..rig }.run(pressing::path).unwrap()
    };
    let result = rig(2000.0, false, 1000.0);
    assert!(result.outcome.is_stable() && result.refused == 0, "{result:?}");
    // Springs in series: the hand's 300 N/m, the coupling's 400 and the contact's 2000, pressed by 4 mm and
    // the contact's tolerance.
    let series = 1.0 / (1.0 / 300.0 + 1.0 / 400.0 + 1.0 / 2000.0);
    let expected = series * (pressing::PRESS + 1e-4);
    // Friction and encoder leave the handle anywhere within their dead zones.
    assert!((result.held_force - expected).abs() < 0.05, "{} N of {expected} N", result.held_force);
    let frozen = rig(1e5, true, 100.0);
    assert!(!frozen.outcome.is_stable(), "{frozen:?}");
    assert!(rig(1e5, false, 500.0).outcome.is_stable());
}

#[test]
fn every_shape_touches_at_its_stated_depth() {
    let shapes = [Geometry::Plane, Geometry::Bump, Geometry::Groove, Geometry::underside(9, 5)];
    for mut geometry in shapes {
        let mut found = Vec::new();
        for depth in [-1e-4, 0.0, 2e-4] {
            let state = palpate::dynamics::BodyState::at_rest(Pose::from_translation(DVec3::NEG_Z * depth));
            geometry.contacts(&state, 1e-3, &mut found);
            assert!(!found.is_empty(), "{geometry:?} at {depth}");
            for contact in &found {
                assert!((contact.depth - depth).abs() < 1e-9, "{geometry:?}: {contact:?} at {depth}");
                assert!((contact.normal - DVec3::NEG_Z).length() < 1e-9, "{geometry:?}: {contact:?}");
            }
        }
        let away = palpate::dynamics::BodyState::at_rest(Pose::from_translation(DVec3::Z * 2e-3));
        geometry.contacts(&away, 1e-3, &mut found);
        assert!(found.is_empty(), "{geometry:?}: {found:?}");
    }
}

#[test]
fn generated_meshes_are_closed_and_face_outwards() {
    for (object, middle) in [
        (meshes::block("block", DVec3::new(0.03, 0.02, 0.01)).unwrap(), 0.0),
        (meshes::peg(4e-3, 0.03).unwrap(), 0.015),
        (meshes::hole(4.1e-3, 0.012, 0.02).unwrap(), -0.01),
    ] {
        let source = &object.clod.source;
        assert!((source.center_of_mass - DVec3::Z * middle).length() < 1e-9, "{}", object.name);
        let body = palpate::dynamics::Body::new(0.1, source.unit_inertia * 0.1);
        assert!(body.is_ok(), "{}: {body:?}", object.name);
    }
}

#[test]
fn numbers_in_tables_are_short_and_read_back() {
    for (value, text) in [
        (0.0, "0"),
        (-0.0, "0"),
        (1.0 / 3.0, "0.333333"),
        (2e-5, "2e-5"),
        (12_345.678, "12345.7"),
        (1e-200, "1e-200"),
    ] {
        assert_eq!(value.entry(), text);
    }
    assert_eq!(f64::INFINITY.entry(), "inf");
}

#[test]
fn the_page_counts_the_verdicts_that_hold() {
    let section = Section {
        title: "A map",
        verdicts: vec![Verdict::new("one", true, "1"), Verdict::new("two", false, "2 of 3")],
        ..Section::default()
    };
    let page = render("cargo xtask stability body", &[section]);
    for words in [
        "cargo xtask stability body",
        "Of 2 conditions 1 hold",
        "**holds**: one (1)",
        "**falls short**: two (2 of 3)",
    ] {
        assert!(page.contains(words), "{words} is not in {page}");
    }
}

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(Result::unwrap);
    entries
        .map(|entry| (entry.file_name().into_string().unwrap(), std::fs::read(entry.path()).unwrap()))
        .collect()
}

#[test]
fn cheap_maps_are_the_same_with_any_number_of_threads() {
    let names = vec![Name::Body, Name::Contacts, Name::Lever, Name::Turn, Name::Peg, Name::Session];
    let made = [1, 3].map(|threads| {
        let folder = tempfile::tempdir().unwrap();
        let arguments = Arguments {
            scans: Vec::new(),
            names: names.clone(),
            quick: true,
            out: folder.path().to_owned(),
            steps: Some(20_000),
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&arguments).unwrap());
        files(folder.path())
    });
    assert!(made[0] == made[1], "files differ");
    let made = &made[0];
    for name in ["body", "contacts", "lever", "turn", "peg", "session"] {
        assert!(made.contains_key(&format!("{name}.csv")), "{name}");
        assert!(made[&format!("{name}.svg")].starts_with(b"<svg"), "{name}");
    }
    let page = String::from_utf8(made["stability.md"].clone()).unwrap();
    assert!(
        page.contains("cargo xtask stability body contacts lever turn peg session --quick --steps 20000")
    );
    // Verdicts that have held since the first version.
    for words in [
        "**holds**: no wrench and no pose is ever not finite (0 of 20000 steps)",
        "**holds**: the wrench is always within what the device renders (0 of 20000 steps)",
    ] {
        assert!(page.contains(words), "{words} is not in {page}");
    }
}

#[test]
fn a_case_of_scans_is_read_as_it_is_written() {
    let case: ScanCase = "ycb_mug.obj,femur_left.stl,0.001,50".parse().unwrap();
    assert_eq!((case.held.as_str(), case.touched.as_str()), ("ycb_mug.obj", "femur_left.stl"));
    assert_eq!((case.mass, case.rate, case.to_string().parse()), (1e-3, 50.0, Ok(case.clone())));
    for wrong in ["", "a,b,1", "a,b,1,2,3", "a,b,one,2"] {
        assert!(wrong.parse::<ScanCase>().is_err(), "{wrong}");
    }
}
