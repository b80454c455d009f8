//! Summaries of sessions: what they say of touch is what the recording shows, at any rate of contact queries,
//! and what they say of stages comes from those that ran.

use std::f64::consts::TAU;

use palpate::device::{
    DeviceError, DeviceState, Emulation, HapticDevice, IntendedPath, Interpolation, Keyframe, MotionPath,
    ReplayDevice, Specification, Status,
};
use palpate::glam::{DMat3, DQuat, DVec3};
use palpate::settings::{
    ContactSearch, ContactSettings, DetailSettings, Response, SearchSettings, ToolSettings,
};
use palpate::telemetry::Span;
use palpate::{
    ContactTiming, DynamicBody, HapticRenderer, LockstepSession, Pose, Record, Scene, Settings, Summary,
    Twist, Wrench,
};

use super::bodies::{ball, block, named, path};

/// Radius of the ball, m.
const RADIUS: f64 = 0.01;

/// Contact force from which on a row of a recording shows a touch, N: beyond rounding.
const FORCE: f64 = 1e-6;

/// A hand whose probe is at a height (m) above where it touches the plate, by time (s).
fn hand(height: impl Fn(f64) -> f64 + Send + 'static) -> IntendedPath {
    path(move |time| (DVec3::Z * (RADIUS + height(time)), DQuat::IDENTITY))
}

/// A session of the ball in a hand over a plate, whose face is at z = 0.
fn renderer(path: IntendedPath, settings: Settings) -> HapticRenderer {
    on(Emulation::default().open(path).expect("an emulation"), settings)
}

/// The same on a device.
fn on(device: impl HapticDevice + 'static, settings: Settings) -> HapticRenderer {
    let plate = named("plate", block(DVec3::new(0.06, 0.06, 0.01)));
    let scene = Scene::new().with(plate, Pose::from_translation(DVec3::NEG_Z * 0.005));
    HapticRenderer::new(ball(RADIUS, (16, 32)), scene, Box::new(device), settings).expect("a session")
}

fn by(method: ContactSearch, response: Response) -> Settings {
    Settings {
        search: SearchSettings { method, tolerance: Some(3e-4), ..SearchSettings::default() },
        contact: ContactSettings { response, ..ContactSettings::default() },
        tool: ToolSettings { mass: 0.05, ..ToolSettings::default() },
        ..Settings::default()
    }
}

/// Both responses, found by both searches.
fn sessions() -> impl Iterator<Item = Settings> {
    let methods = [ContactSearch::Representatives, ContactSearch::Levels];
    let with = |method| [Response::Constraints, Response::Penalty].map(|response| by(method, response));
    methods.into_iter().flat_map(with)
}

fn steps(session: &mut LockstepSession, count: usize) -> Vec<Record> {
    (0..count).map(|_| session.step_device()).collect()
}

fn run(mut session: LockstepSession, count: usize) -> (Vec<Record>, Summary) {
    let records = steps(&mut session, count);
    (records, session.finish().summary())
}

/// Time of the first row that shows a contact force, s.
fn first_push(records: &[Record]) -> Option<f64> {
    records.iter().find(|row| row.contact.force.length() > FORCE).map(|row| row.time)
}

/// The hand descends by 3 mm in 0.3 s, after 0.2 s, presses by 1 mm and rises again. As many contact queries
/// as haptic steps, nearly as many, or few: the touch is that of the recording. It was read before the newest
/// contacts were taken over, from the step before, and so never with a query in each step.
#[test]
fn the_first_touch_is_that_of_the_recording_at_any_contact_rate() {
    for settings in sessions() {
        for rate in [1000.0, 999.0, 500.0, 333.0, 50.0] {
            let path =
                hand(|time| 2e-3 - 3e-3 * (0.5 - 0.5 * (TAU * ((time - 0.2) / 0.6).clamp(0.0, 1.0)).cos()));
            let session = renderer(path, settings).lockstep(ContactTiming::busy(rate));
            let (records, summary) = run(session, 1000);
            let first = first_push(&records);
            let with = format!("{:?}, {:?}, {rate} Hz", settings.search.method, settings.contact.response);
            assert!(first.is_some_and(|time| (0.25..0.55).contains(&time)), "{with}: {first:?}");
            assert_eq!(summary.first_touch_s, first, "{with}");
            assert_eq!(records.last().map(|row| row.contact.force.length() > FORCE), Some(false), "{with}");
        }
    }
}

/// Over the plate by 3 µm, contacts are known and none of them pushes: nothing is touched. Penalty contacts
/// push from the tolerance on, so that they are held at three times that distance.
#[test]
fn contacts_that_are_near_and_do_not_push_are_no_touch() {
    let mut near = 0;
    for settings in sessions() {
        let height = match settings.contact.response {
            Response::Constraints => 3e-6,
            Response::Penalty => 9e-4,
        };
        // A device that replays the motion is exactly there: a hand has friction in its way. It descends
        // slowly, so that the ball does not wait for contacts.
        let at = |time: f64, height: f64| Keyframe {
            time,
            pose: Pose::from_translation(DVec3::Z * (RADIUS + height)),
        };
        let path = vec![at(0.0, height + 1e-3), at(1.5, height), at(3.0, height)];
        let path = MotionPath::new(path, Interpolation::Linear).expect("a path");
        let session = on(ReplayDevice::new("hover", path), settings).lockstep(ContactTiming::busy(500.0));
        let (records, summary) = run(session, 2000);
        assert_eq!(first_push(&records), None, "it is in the air");
        let lowest = records.last().map_or(f64::NAN, |row| row.object.translation.z - RADIUS);
        assert!((lowest - height).abs() < 1e-6, "{lowest} m above the plate");
        assert_eq!(summary.first_touch_s, None, "{:?}", settings.contact.response);
        assert_eq!(summary.depth_max, 0.0);
        near += u32::from(summary.contacts_max > 0);
    }
    assert!(near > 0, "negative control: contacts are known in no session");
}

/// A box that is lighter than half of the ball is pushed by penalties, and other contacts are constraints.
/// The summary says of which objects each is true; before, all lines said "on" of sessions with constraints
/// alone.
#[test]
fn stages_are_those_that_ran() {
    let above = || hand(|_| 2e-3);
    let settings = by(ContactSearch::Automatic, Response::Constraints);
    let alone = run(renderer(above(), settings).lockstep(ContactTiming::busy(500.0)), 20).1.stages;
    for stage in ["braking", "clustering", "proxy"] {
        assert_eq!(alone[stage], "off: contacts are constraints", "{stage}");
    }
    assert_eq!(alone["contact response"], "constraints");

    let mut mixed = renderer(above(), settings);
    let mut editor = mixed.scene_editor();
    let feather = named("feather", block(DVec3::splat(0.01)));
    let id = editor.add(&feather, Pose::from_translation(DVec3::X * 0.1)).expect("room");
    let body = DynamicBody {
        mass: 1e-3,
        inertia: DMat3::from_diagonal(DVec3::splat(1e-8)),
        center_of_mass: DVec3::ZERO,
        gravity: DVec3::ZERO,
        period: 1e-3,
    };
    editor.set_dynamics(id, Some(body)).expect("room");
    let mut session = mixed.lockstep(ContactTiming::busy(500.0));
    steps(&mut session, 20);
    let stages = session.finish().summary().stages;
    assert_eq!(stages["contact response"], "constraints; penalties with feather (light)");
    assert_eq!(stages["proxy"], "on: by its setting, for penalties with feather (light)");
    assert_eq!(stages["clustering"], "on beyond 5 contacts, for penalties with feather (light)");
    assert_eq!(stages["contact query"], "on: 2 scene objects", "the one that was added as well");

    // Once it is gone, what ran is still told.
    let mut left = renderer(above(), settings);
    let mut editor = left.scene_editor();
    let id = editor.add(&feather, Pose::from_translation(DVec3::X * 0.1)).expect("room");
    editor.set_dynamics(id, Some(body)).expect("room");
    let mut session = left.lockstep(ContactTiming::busy(500.0));
    steps(&mut session, 20);
    editor.remove(id).expect("room");
    steps(&mut session, 20);
    let stages = session.finish().summary().stages;
    assert_eq!(stages["contact response"], "constraints; penalties before");
    assert_eq!(stages["contact query"], "on: 2 scene objects");

    let penalties = run(
        renderer(above(), by(ContactSearch::Automatic, Response::Penalty))
            .lockstep(ContactTiming::busy(500.0)),
        20,
    );
    assert_eq!(penalties.1.stages["contact response"], "penalties: by the setting");
    assert_eq!(penalties.1.stages["braking"], "on: by its setting");
}

/// Settings that nothing uses are named with the reason, and those that are used are not.
#[test]
fn settings_without_an_effect_are_named() {
    let named = |settings: Settings| -> Vec<&'static str> {
        renderer(hand(|_| 2e-3), settings).unused_settings().into_iter().map(|unused| unused.name).collect()
    };
    let given = |response| Settings {
        search: SearchSettings { braking: false, proxy: false, clusters: 3, ..SearchSettings::default() },
        contact: ContactSettings { response, stiffness: 500.0, ..ContactSettings::default() },
        ..Settings::default()
    };
    assert_eq!(
        named(given(Response::Constraints)),
        ["contact.stiffness", "search.clusters", "search.braking", "search.proxy"]
    );
    assert_eq!(named(given(Response::Penalty)), [""; 0]);
    assert_eq!(named(Settings::default()), [""; 0]);
    let detail = DetailSettings { error: 1e-4, interpolation: false, query_budget: Some(1e-3) };
    let detailed = |response| Settings { detail, ..by(ContactSearch::Levels, response) };
    assert_eq!(
        named(detailed(Response::Constraints)),
        ["detail.error", "detail.interpolation", "detail.query_budget"]
    );
    assert_eq!(named(detailed(Response::Penalty)), [""; 0]);
    let mut levels = by(ContactSearch::Levels, Response::Penalty);
    levels.search.representative_error = Some(1e-5);
    levels.textures.grid = 20;
    assert_eq!(named(levels), ["search.representative_error", "textures"]);
}

/// What lasts for several steps is told as how often and how long, also where steps vary in length. The hand
/// is lost twice, so that the wrench rises from zero three times.
#[test]
fn events_that_last_are_counted_once_and_timed() {
    let settings = by(ContactSearch::Levels, Response::Constraints);
    let (mut haptic, mut contact, mut device) = renderer(hand(|_| 2e-3), settings).into_loops();
    let (mut now, mut lost) = (0.0, 0.0);
    for step in 0..1500 {
        let dt = [5e-4, 1e-3, 2e-3][step % 3];
        now += dt;
        let update = contact.step(haptic.body_state(), now);
        haptic.update_contacts(&update);
        if [700..720, 1000..1020].iter().any(|gone| gone.contains(&step)) {
            lost += dt;
            haptic.step_device(&mut Gone, now, dt);
        } else {
            haptic.step_device(device.as_mut(), now, dt);
        }
    }
    let (events, spans) = (haptic.telemetry().events, haptic.telemetry().spans);
    assert_eq!((spans.engaging.times, spans.device_refused.times), (3, 2), "{events:?}");
    assert!((spans.device_refused.seconds - lost).abs() < 1e-9, "{spans:?}");
    // Each time it takes the engagement's 0.2 s, beside the time for which the device is away.
    let expected = 3.0 * settings.timing.engagement + lost;
    assert!((spans.engaging.seconds - expected).abs() < 0.02, "{} of {expected} s", spans.engaging.seconds);
    assert_eq!(spans.clutched, Span::default());
    assert!(events.engaging > 500, "negative control: its count is one of steps");
}

/// A device that does not answer.
struct Gone;

impl HapticDevice for Gone {
    fn specification(&self) -> &Specification {
        unreachable!("it is only read and written")
    }

    fn read(&mut self, _: f64) -> Result<DeviceState, DeviceError> {
        Err(DeviceError::Lost { status: Status::DISCONNECTED })
    }

    fn write(&mut self, _: &Wrench) -> Result<(), DeviceError> {
        Ok(())
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// Of two hands, one session finds the contacts between their objects. Both touch, and at the same time but
/// for the step by which an impulse arrives late.
#[test]
fn both_of_two_hands_touch() {
    for response in [Response::Constraints, Response::Penalty] {
        let settings = by(ContactSearch::Automatic, response);
        let open = |path: IntendedPath| {
            let device = Box::new(Emulation::default().open(path).expect("an emulation"));
            HapticRenderer::new(ball(RADIUS, (16, 32)), Scene::new(), device, settings).expect("a session")
        };
        let near = |time: f64| RADIUS + 1e-3 - 2e-3 * ((time - 0.2) / 0.3).clamp(0.0, 1.0);
        let still = |z: f64| (Pose::from_translation(DVec3::Z * z), Twist::ZERO);
        let mut upper = open(IntendedPath::function(move |time| still(near(time))));
        let mut lower = open(IntendedPath::function(move |time| still(-near(time))));
        upper.join(&mut lower).expect("not textured");
        let [mut upper, mut lower] = [upper, lower].map(|it| it.lockstep(ContactTiming::busy(500.0)));
        let mut records = [Vec::new(), Vec::new()];
        for _ in 0..800 {
            records[0].push(upper.step_device());
            records[1].push(lower.step_device());
        }
        let summaries = [upper, lower].map(|session| session.finish().summary());
        let touched = [0, 1].map(|hand| {
            let first = first_push(&records[hand]);
            assert!(first.is_some(), "{response:?}: hand {hand} is not pushed");
            assert_eq!(summaries[hand].first_touch_s, first, "{response:?}: hand {hand}");
            first.unwrap_or(f64::NAN)
        });
        assert!((touched[0] - touched[1]).abs() < 3e-3, "{response:?}: {touched:?} s");
    }
}
