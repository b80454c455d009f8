//! Sessions whose contacts are found in distance fields.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::device::DeviceState;
use palpate::dynamics::BodyState;
use palpate::errors::RendererError;
use palpate::glam::{DQuat, DVec3};
use palpate::representative::RepresentativeQuery;
use palpate::settings::{ContactSearch, ContactSettings, SearchSettings, TimingSettings};
use palpate::{
    ContactLoop, ContactTiming, HapticRenderer, Object, Pose, Record, Scene, SceneId, Session, Settings,
    TriMesh, Twist, explore,
};
use palpate_tests::{first_touch, model, penalties, ridged_plate};

/// EPS relative to the probe's radius: larger than usual, so that fields are built fast.
const ERROR: f64 = 0.0015;

fn settings(probe: &Object) -> Settings {
    Settings {
        search: SearchSettings {
            method: ContactSearch::Representatives,
            representative_error: Some(ERROR * probe.bounding_radius()),
            ..SearchSettings::default()
        },
        ..penalties()
    }
}

fn contact_loop(probe: &Object, scene: Scene, settings: Settings) -> ContactLoop {
    let device = explore::open_device("emulated", probe, &scene).expect("a device");
    HapticRenderer::new(probe.clone(), scene, device, settings).expect("a session").into_loops().1
}

fn lockstep(probe: &Object, scene: Scene, settings: Settings, seconds: f64) -> (Session, Vec<Record>) {
    let device = explore::open_device("emulated:task=stroke", probe, &scene).expect("a device");
    let renderer = HapticRenderer::new(probe.clone(), scene, device, settings).expect("a session");
    let mut records = Vec::new();
    let Ok(session) =
        renderer.run_lockstep(seconds, ContactTiming::busy(500.0), &AtomicBool::new(false), |record| {
            records.push(*record);
            Ok::<_, Infallible>(())
        });
    (session, records)
}

/// The model's force at the pose of the query is that of the force law. Its torque is close to it: planes
/// lack only the torque about their normals.
#[test]
fn a_model_pushes_by_the_force_law() {
    let (probe, object) = (model("ellipsoid@2000"), model("golf-ball@5000"));
    let settings = settings(&probe);
    let tolerance = 0.01 * probe.bounding_radius();
    let mut query = RepresentativeQuery::new(&probe, &object, tolerance, ERROR * probe.bounding_radius())
        .expect("fields");
    let touch = first_touch(&probe, &object);
    let center = probe.clod.source.center_of_mass;
    let (mut pushed, mut torque_off) = (0, 0.0_f64);
    for step in 0..40 {
        // The depth stays within what the proxy allows, so that the proxy is where the body is.
        let turn = DQuat::from_rotation_z(0.02 * f64::from(step));
        let depth = tolerance * (0.15 - 0.03 * f64::from(step));
        let mesh = Pose::new(touch, DQuat::IDENTITY) * Pose::new(DVec3::NEG_Z * depth, turn);
        let body = BodyState::at_rest(mesh * Pose::from_translation(center));
        let mut contacts = contact_loop(&probe, Scene::new().with(object.clone(), Pose::IDENTITY), settings);
        let update = contacts.step(&body, 0.0);
        // From scratch, as the query of the new loop is.
        query.reset();
        query.run(&mesh, &Pose::IDENTITY);
        let stiffness = settings.search.clusters as f64 * settings.contact.stiffness;
        let wanted = query.wrench(&mesh, stiffness).about(body.pose.translation - mesh.translation);
        let found = update.model.wrench(&body);
        let size = wanted.force.length();
        if contacts.telemetry().events.proxy_engaged > 0 || size < 1e-3 {
            continue;
        }
        pushed += 1;
        assert!(found.force.distance(wanted.force) < 1e-6 * size, "step {step}: {found:?} for {wanted:?}");
        torque_off = torque_off.max(found.torque.distance(wanted.torque) / (size * probe.bounding_radius()));
        assert!(update.model.contacts().len() <= settings.search.clusters);
    }
    assert!(pushed > 20, "{pushed} poses pushed");
    assert!(torque_off < 0.05, "a lever of {torque_off} radii is missing");
}

/// A session is reproducible, keeps the probe outside the surface, and pushes about as hard as one with
/// levels of detail.
#[test]
fn a_session_is_reproducible_and_close_to_one_by_levels() {
    let (probe, object) = (model("ellipsoid@500"), model("golf-ball@5000"));
    let scene = Scene::new().with(object, Pose::IDENTITY);
    let (session, records) = lockstep(&probe, scene.clone(), settings(&probe), 2.0);
    let (_, again) = lockstep(&probe, scene.clone(), settings(&probe), 2.0);
    let same = |(one, other): (&Record, &Record)| format!("{one:?}") == format!("{other:?}");
    assert!(records.len() == again.len() && records.iter().zip(&again).all(same), "it is not the same again");
    let levels = Settings {
        search: SearchSettings { method: ContactSearch::Levels, ..SearchSettings::default() },
        ..penalties()
    };
    let (levels, by_levels) = lockstep(&probe, scene, levels, 2.0);
    let stages =
        [session.summary().stages, levels.summary().stages].map(|stages| stages["contact search"].clone());
    assert!(
        stages[0].starts_with("distance fields, depth error about") && stages[1].starts_with("levels"),
        "{stages:?}"
    );
    let rms = |records: &[Record]| {
        let squares = records.iter().map(|record| record.coupling.force.length_squared());
        (squares.sum::<f64>() / records.len() as f64).sqrt()
    };
    let (own, other) = (rms(&records), rms(&by_levels));
    assert!(own > 0.0 && (0.5..1.5).contains(&(own / other)), "{own} N for {other} N");
    let summary = session.summary();
    assert!(summary.depth_max < 0.1 * probe.bounding_radius(), "{} m deep", summary.depth_max);
    assert_eq!(
        summary.events.step_refused + summary.events.contact_refused + summary.events.contact_overflow,
        0
    );
}

/// Returns a cube of 4 cm with its top at z = 0.
fn cube() -> Object {
    let corner = |i: u32| {
        let part = DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2));
        0.04 * (part - DVec3::new(0.5, 0.5, 1.0))
    };
    #[rustfmt::skip]
    let triangles = vec![
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ];
    let mesh = TriMesh::new((0..8).map(corner).collect(), triangles).expect("a cube");
    Object::from_mesh("cube", &mesh).expect("a hierarchy")
}

/// A cube pressed onto another comes to rest with faces in contact.
#[test]
fn a_face_rests_on_a_face() {
    let (probe, plate) = (cube(), model("plate"));
    let scene = Scene::new().with(plate, Pose::IDENTITY);
    // Held 2 mm inside the plate, slightly tilted.
    let turn = DQuat::from_rotation_x(0.05) * DQuat::from_rotation_z(0.3);
    let held = Pose::new(DVec3::Z * 0.038, turn);
    for friction in [0.0, 0.5] {
        let settings = Settings {
            contact: ContactSettings { friction, ..settings(&probe).contact },
            timing: TimingSettings { engagement: 0.0, ..settings(&probe).timing },
            search: SearchSettings { clusters: 8, ..settings(&probe).search },
            ..settings(&probe)
        };
        let start = Pose::new(DVec3::Z * 0.05, turn);
        let device = explore::open_device("emulated", &probe, &scene).expect("a device");
        let renderer =
            HapticRenderer::new(probe.clone(), scene.clone(), device, settings).expect("a session");
        let (mut haptic, mut contact, mut idle) = renderer.into_loops();
        let start_state = idle.read(0.0).expect("a device");
        let (mut rest, mut last) = (f64::NAN, Vec::new());
        for step in 0..3000 {
            let now = f64::from(step) * 1e-3;
            let part = (now / 0.5).min(1.0);
            let pose = Pose::new(start.translation.lerp(held.translation, part), turn);
            let device = DeviceState { time: now, pose, twist: Twist::ZERO, ..start_state };
            if step % 2 == 0 {
                let update = contact.step(haptic.body_state(), now);
                haptic.update_contacts(&update);
            }
            let record = haptic.step(&device, now, 1e-3);
            if step >= 2000 {
                last.push(record.coupling.force.length());
                rest = haptic.body_state().twist.linear.length();
            }
        }
        let mean = last.iter().sum::<f64>() / last.len() as f64;
        let most = last.iter().map(|force| (force - mean).abs()).fold(0.0, f64::max);
        assert!(mean > 0.1, "{mean} N: it was never pressed");
        assert!(most < 0.01 * mean, "friction {friction}: the force varies by {most} of {mean} N at rest");
        assert!(rest < 1e-4, "friction {friction}: it moves with {rest} m/s at rest");
    }
}

/// Moving objects are felt to move, are pushed back, and may be added and removed.
#[test]
fn objects_move_and_are_added_and_removed() {
    let (probe, ball) = (model("ellipsoid@500"), model("golf-ball@5000"));
    let touch = first_touch(&probe, &ball);
    let scene = Scene::new().with(ball.clone(), Pose::IDENTITY);
    let mut contacts = contact_loop(&probe, scene, settings(&probe));
    let body = BodyState::at_rest(Pose::from_translation(touch + probe.clod.source.center_of_mass));
    let depth_of = |contacts: &mut ContactLoop, time: f64| {
        let update = contacts.step(&body, time);
        let force = update.model.wrench(&body).force;
        (update.contacts, force.z)
    };
    let (count, still) = depth_of(&mut contacts, 0.0);
    assert!(count > 0 && still > 0.0, "{count} contacts push with {still} N");
    // It rises by a tenth of a tolerance, and so pushes harder.
    let tolerance = 0.01 * probe.bounding_radius();
    let raised = Pose::from_translation(DVec3::Z * (0.1 * tolerance));
    assert!(contacts.set_motion(SceneId(0), &raised, &Twist::ZERO));
    let (_, more) = depth_of(&mut contacts, 0.001);
    assert!(more > 1.02 * still, "{more} N after {still} N");
    assert!(contacts.remove(SceneId(0)));
    assert_eq!(depth_of(&mut contacts, 0.002), (0, 0.0));
    assert!(contacts.add(SceneId(1), &ball, &Pose::IDENTITY));
    let (_, again) = depth_of(&mut contacts, 0.003);
    assert!((again - still).abs() < 1e-6 * still, "{again} N for {still} N");
    let mut editor = contacts.editor();
    let other = editor.add(&ball, Pose::from_translation(DVec3::Z * 10.0)).expect("room");
    let far = depth_of(&mut contacts, 0.004).1;
    assert!((far - still).abs() < 1e-6 * still, "{far} N for {still} N");
    editor.set_pose(other, Pose::IDENTITY).expect("it is there");
    assert!(depth_of(&mut contacts, 0.005).0 > count, "both touch");
    assert_eq!(contacts.telemetry().events.edit_refused, 0);
}

#[test]
fn objects_without_a_field_are_refused_or_found_by_levels() {
    let probe = model("stylus@2000");
    // An open sheet has no inside.
    let corners = [DVec3::ZERO, DVec3::X, DVec3::Y].map(|corner| 0.1 * corner);
    let sheet = TriMesh::new(corners.to_vec(), vec![[0, 1, 2]]).expect("a mesh");
    let sheet = Object::from_mesh("sheet", &sheet).expect("a hierarchy");
    let open = |scene: Scene, settings: Settings| {
        let device = explore::open_device("emulated", &probe, &scene).expect("a device");
        HapticRenderer::new(probe.clone(), scene, device, settings)
    };
    let with_sheet = open(Scene::new().with(sheet.clone(), Pose::IDENTITY), settings(&probe));
    let stages = with_sheet.expect("contacts are found by levels").stages();
    let why = &stages["contact search"];
    assert!(why.starts_with("levels of detail: sheet: its surface is not closed"), "{why}");
    let wild = Settings {
        search: SearchSettings { representative_error: Some(1.0), ..settings(&probe).search },
        ..settings(&probe)
    };
    let refused = open(Scene::new(), wild).map(drop);
    assert!(matches!(&refused, Err(RendererError::Field(_))), "{refused:?}");
    // An open object that is added to a session is left out.
    let mut session = open(Scene::new(), settings(&probe)).expect("an empty scene");
    let mut editor = session.scene_editor();
    editor.add(&sheet, Pose::IDENTITY).expect("room");
    let (_, mut contact, _) = session.into_loops();
    contact.step(&BodyState::at_rest(Pose::IDENTITY), 0.0);
    assert_eq!(contact.telemetry().events.edit_refused, 1);
    // Textures need contacts from levels of detail.
    let textured = open(Scene::new().with(ridged_plate(1e-3, 5e-3), Pose::IDENTITY), settings(&probe));
    let stages = textured.expect("a textured scene").stages();
    assert!(stages["contact search"].contains("texture"), "{stages:?}");
}
