//! Stages that a scene does not need: they report that they are off and why, take no memory, and change no
//! result.

use std::sync::atomic::AtomicBool;

use allocation_counter::measure;
use palpate::settings::{
    ContactSearch, ContactSettings, DetailSettings, OutputSettings, SearchSettings, TextureSettings,
};
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Record, Scene, Settings, Wrench, explore};
use palpate_tests::{model, penalties, ridged_plate};

fn renderer(probe: &Object, objects: &[Object], settings: Settings) -> HapticRenderer {
    let scene = objects.iter().fold(Scene::new(), |scene, object| scene.with(object.clone(), Pose::IDENTITY));
    let device = explore::open_device("emulated", probe, &scene).expect("emulated device");
    HapticRenderer::new(probe.clone(), scene, device, settings).expect("renderer")
}

/// Runs a session on a simulated clock and returns its records.
fn records(renderer: HapticRenderer) -> Vec<Record> {
    let mut records = Vec::new();
    let ran = renderer.run_lockstep(4.0, ContactTiming::busy(500.0), &AtomicBool::new(false), |record| {
        records.push(*record);
        Ok::<_, std::convert::Infallible>(())
    });
    assert!(ran.is_ok());
    records
}

#[test]
fn stages_report_whether_they_are_on_and_why() {
    let (hull, ball, ridges) = (model("ellipsoid@500"), model("golf-ball@2000"), ridged_plate(5e-4, 2e-3));
    let error =
        |error| Settings { detail: DetailSettings { error, ..DetailSettings::default() }, ..penalties() };
    let check = |renderer: &HapticRenderer, expected: &[(&str, &str)]| {
        let stages = renderer.stages();
        for (stage, why) in expected {
            assert!(stages[stage].contains(why), "{stage}: {why}: {stages:?}");
        }
    };
    let plain = renderer(&hull, std::slice::from_ref(&hull), penalties());
    check(
        &plain,
        &[
            ("contact query", "on: one scene object"),
            ("contact response", "penalties: by the setting"),
            ("interpolation between levels", "off: full resolution is set"),
            ("friction", "off: its coefficient is 0"),
            ("textures", "off: no object has a haptic texture"),
            ("braking", "on: by its setting"),
            ("proxy", "on: by its setting"),
            ("passivity controller", "off: by its setting"),
            ("time-critical queries", "off: no limit is set"),
            ("watch", "off: no monitor"),
        ],
    );
    let jumping = Settings {
        detail: DetailSettings { interpolation: false, query_budget: Some(1e-4), ..error(1e-3).detail },
        ..error(1e-3)
    };
    check(
        &renderer(&hull, std::slice::from_ref(&ball), jumping),
        &[
            ("interpolation between levels", "off by its setting: detail is left out up to 0.001 m"),
            ("time-critical queries", "on: at most 100 µs each"),
        ],
    );
    let switched = Settings {
        search: SearchSettings { braking: false, proxy: false, ..error(1e-3).search },
        output: OutputSettings { passivity_controller: true, ..error(1e-3).output },
        contact: ContactSettings { friction: 0.2, static_friction: Some(0.3), ..error(1e-3).contact },
        ..error(1e-3)
    };
    let mut all = renderer(&hull, &[ball, ridges], switched);
    let _watch = all.contact_monitor();
    check(
        &all,
        &[
            ("contact query", "on: 2 scene objects"),
            ("hierarchy", "scene golf-ball@2000: on, "),
            ("interpolation between levels", "on: detail is left out up to 0.001 m"),
            ("friction", "on: coefficient 0.2, at rest 0.3"),
            ("textures", "on, computed by CPU: scene ridges"),
            ("braking", "off: by its setting"),
            ("proxy", "off: by its setting"),
            ("passivity controller", "on: by its setting"),
            ("watch", "on: contacts are shown"),
        ],
    );
    // With constraints, the default, only contacts with textured objects are penalties.
    let (ball, ridges) = (model("golf-ball@2000"), ridged_plate(5e-4, 2e-3));
    check(
        &renderer(&hull, &[ball, ridges], Settings::default()),
        &[
            ("contact response", "constraints; penalties with ridges (textured)"),
            ("braking", "on: by its setting, for penalties with ridges (textured)"),
            ("clustering", "on beyond 5 contacts, for penalties with ridges (textured)"),
            ("proxy", "on: by its setting, for penalties with ridges (textured)"),
            (
                "contact search",
                "on the meshes; for penalties: levels of detail: an object has a haptic texture",
            ),
        ],
    );
    check(
        &renderer(&hull, std::slice::from_ref(&hull), error(1e-3)),
        &[("interpolation between levels", "off: every object is one convex hull")],
    );
}

/// Two convex hulls have no detail to leave out: the result is the same, bit for bit.
#[test]
fn convex_hulls_do_not_depend_on_the_error_threshold() {
    let hull = model("ellipsoid@500");
    let with = |object: &Object, error| {
        let settings = Settings {
            search: SearchSettings { method: ContactSearch::Levels, ..SearchSettings::default() },
            detail: DetailSettings { error, ..DetailSettings::default() },
            ..penalties()
        };
        records(renderer(&hull, std::slice::from_ref(object), settings))
    };
    let felt = with(&hull, 0.0);
    assert!(felt.iter().any(|record| record.contact.force.length() > 0.1), "nothing is touched");
    let bits = |records: &[Record]| -> Vec<u64> {
        let numbers = |record: &Record| {
            let Wrench { force, torque } = record.contact;
            let Pose { translation, rotation } = record.object;
            let numbers = [force.to_array(), torque.to_array(), translation.to_array()].concat();
            numbers.into_iter().chain(rotation.to_array()).map(f64::to_bits).collect::<Vec<_>>()
        };
        records.iter().flat_map(numbers).collect()
    };
    assert!(bits(&felt) == bits(&with(&hull, 5e-3)), "one hull has no detail");
    let ball = model("golf-ball@5000");
    assert!(bits(&with(&ball, 0.0)) != bits(&with(&ball, 5e-3)), "a ball with dimples has some");
}

/// The memory of a session without textures does not depend on their settings.
#[test]
fn no_memory_is_taken_for_absent_textures() {
    let (probe, plate, ridges) = (model("ellipsoid@500"), model("plate"), ridged_plate(5e-4, 2e-3));
    let bytes = |object: &Object, grid: u32, steps: u32| {
        let textures = TextureSettings { grid, ..TextureSettings::default() };
        let scene = Scene::new().with(object.clone(), Pose::IDENTITY);
        // Runs once before, since shapes are built at first use.
        let settings = Settings { textures, ..penalties() };
        drop(renderer(&probe, std::slice::from_ref(object), settings));
        let device = explore::open_device("emulated", &probe, &scene).expect("emulated device");
        let probe = probe.clone();
        let taken = measure(|| {
            let made = HapticRenderer::new(probe, scene, device, settings).expect("renderer");
            let (mut haptic, mut contact, mut device) = made.into_loops();
            for step in 1..=steps {
                let now = f64::from(step) * 1e-3;
                let update = contact.step(haptic.body_state(), now);
                haptic.update_contacts(&update);
                haptic.step_device(device.as_mut(), now, 1e-3);
            }
        });
        taken.bytes_total
    };
    assert_eq!(bytes(&plate, 2, 1500), bytes(&plate, 1024, 1500));
    assert!(bytes(&ridges, 50, 1) > bytes(&plate, 50, 1), "a texture takes some");
}
