//! The real-time path does not allocate: 100,000 haptic steps with penalties and 40,000 with constraints, and
//! contact steps in steady state.

use allocation_counter::measure;
use palpate::device::Task;
use palpate::glam::DVec3;
use palpate::settings::{ContactSearch, ContactSettings, Response, SearchSettings};
use palpate::{DynamicBody, HapticRenderer, Object, Pose, Scene, SceneId, Settings, Twist, explore};
use palpate_tests::{model, ridged_plate};

/// Number of clusters: fewer than there are contacts at times.
const CLUSTERS: usize = 2;

/// Returns the number of allocations in `work`.
fn allocations_in(work: impl FnOnce()) -> u64 {
    measure(work).count_total
}

#[test]
fn the_loops_do_not_allocate_with_penalties() {
    do_not_allocate(Response::Penalty, 100_000);
}

#[test]
fn the_loops_do_not_allocate_with_constraints() {
    do_not_allocate(Response::Constraints, 40_000);
}

fn do_not_allocate(response: Response, steps: u32) {
    assert!(allocations_in(|| drop(std::hint::black_box(vec![1u8]))) > 0, "the counter counts");
    // More contacts than clusters at times.
    let by_levels = Settings {
        search: SearchSettings {
            method: ContactSearch::Levels,
            clusters: CLUSTERS,
            ..SearchSettings::default()
        },
        contact: ContactSettings { response, ..ContactSettings::default() },
        ..Settings::default()
    };
    let contacts = run(&model("spoon@5000"), model("cup@5000"), steps, false, by_levels);
    assert!(contacts > CLUSTERS, "{contacts} contacts at most, so that nothing was tested");
    let contacts = run(&model("stylus@2000"), ridged_plate(1e-3, 5e-3), 22_000, false, by_levels);
    assert!(contacts > 0, "the stylus never touched the ridges");
    let (probe, ball) = (model("ellipsoid@500"), model("golf-ball@5000"));
    let by_fields = Settings {
        search: SearchSettings {
            method: ContactSearch::Representatives,
            representative_error: Some(0.002 * probe.bounding_radius()),
            ..by_levels.search
        },
        ..by_levels
    };
    for settings in [by_levels, by_fields] {
        let contacts = run(&probe, ball.clone(), 22_000, true, settings);
        assert!(contacts > 0, "the moving ball was never touched: {settings:?}");
    }
    let contacts = run(&probe, ball, 22_000, false, by_fields);
    assert!(contacts > CLUSTERS, "{contacts} contacts at most, so that nothing was tested");
}

/// Runs haptic steps of a session with an object that may move to and fro and be pushed; returns the largest
/// number of contacts.
fn run(probe: &Object, object: Object, steps: u32, moves: bool, settings: Settings) -> usize {
    let source = &object.clod.source;
    let mobility = DynamicBody {
        mass: 0.1,
        inertia: source.unit_inertia * 0.1,
        center_of_mass: source.center_of_mass,
        gravity: DVec3::ZERO,
        period: 1e-3,
    };
    let scene = Scene::new().with(object, Pose::IDENTITY);
    let device = explore::open_device("emulated", probe, &scene).expect("emulated device");
    let mut renderer = HapticRenderer::new(probe.clone(), scene, device, settings).expect("renderer");
    let (mut watch, mut other) = (renderer.contact_monitor(), renderer.contact_monitor());
    let (mut editor, mut reactions) = (renderer.scene_editor(), renderer.reactions());
    if moves {
        editor.set_dynamics(SceneId(0), Some(mobility)).expect("room");
    }
    let mut pushed = false;
    let (mut haptic, mut contact, mut device) = renderer.into_loops();

    let (mut in_haptic, mut in_contact, mut contacts) = (0, 0, 0);
    for step in 1..=steps {
        let now = f64::from(step) * 1e-3;
        if moves {
            let (sine, cosine) = (20.0 * now).sin_cos();
            let twist = Twist::new(DVec3::X * (20.0 * 1e-4 * cosine), DVec3::ZERO);
            in_haptic += allocations_in(|| {
                let pose = Pose::from_translation(DVec3::X * (1e-4 * sine));
                assert!(editor.set_motion(SceneId(0), pose, twist).is_ok());
                pushed |= reactions.take().is_some();
            });
        }
        if step % 4 == 0 {
            let mut update = None;
            let count = allocations_in(|| update = Some(contact.step(haptic.body_state(), now)));
            // The exploration repeats every ten seconds: in the first round the workspaces grow to the scene.
            in_contact += if now > Task::Explore.cycle() { count } else { 0 };
            let update = update.expect("a contact step ran");
            in_contact += allocations_in(|| assert_eq!(watch.latest().time.to_bits(), now.to_bits()));
            assert_eq!(watch.latest(), other.latest());
            in_haptic += allocations_in(|| haptic.update_contacts(&update));
        }
        in_haptic += allocations_in(|| {
            let record = haptic.step_device(device.as_mut(), now, 1e-3);
            contacts = contacts.max(record.contacts as usize);
        });
    }
    assert_eq!(pushed, moves, "whether it was pushed");
    let response = settings.contact.response;
    assert_eq!(in_haptic, 0, "{response:?}: allocations in {steps} haptic steps");
    assert_eq!(in_contact, 0, "{response:?}: allocations in contact steps after the first ten seconds");
    contacts
}
