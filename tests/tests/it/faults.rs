//! Faults of a hand, a device, a host or a machine that could hurt: each test shows the wrench that it would
//! cause.

use std::f64::consts::TAU;

use palpate::device::{DeviceState, Emulation, Status};
use palpate::dynamics::{ContactParameters, Friction, LinearContactModel};
use palpate::glam::{DQuat, DVec3};
use palpate::promises::{ENERGY_BOUND, Invariant};
use palpate::settings::{CouplingSettings, OutputSettings, TimingSettings};
use palpate::{
    Contact, ContactUpdate, HapticLoop, HapticRenderer, Pose, Record, Scene, Settings, Twist, Wrench,
};
use palpate_tests::model;

const PERIOD: f64 = 1e-3;
/// Peak force of the device, N.
const PEAK: f64 = 8.5;

/// Host's loop, with a contact query that finds a floor.
struct Rig {
    haptic: HapticLoop,
    /// Height over the world's origin (m) and damping (N·s/m) of a floor of 2 kN/m, if there is one.
    floor: Option<(f64, f64)>,
    /// Whether contacts are found.
    queries: bool,
    now: f64,
}

impl Rig {
    fn new(settings: Settings) -> Self {
        let device = Box::new(Emulation::default().open(Pose::IDENTITY).expect("an emulated device"));
        let renderer = HapticRenderer::new(model("ellipsoid@500"), Scene::new(), device, settings);
        let (haptic, _, _) = renderer.expect("a renderer").into_loops();
        Self { haptic, floor: None, queries: true, now: 0.0 }
    }

    /// Returns a rig with a floor of 2 kN/m whose surface is `depth` (m) above the object.
    fn on_floor(settings: Settings, depth: f64) -> Self {
        let rig = Self::new(settings);
        let height = rig.haptic.body_state().pose.translation.z + depth;
        Self { floor: Some((height, 20.0)), ..rig }
    }

    /// Returns the contact of the floor under the object's centre of mass.
    fn query(&self) -> ContactUpdate {
        let center = self.haptic.body_state().pose;
        let none = LinearContactModel::empty(&center, self.now);
        let Some((height, damping)) = self.floor else {
            return ContactUpdate::new(none, self.now, 0.0, 0);
        };
        let point = center.translation;
        let depth = height - point.z;
        let contact = Contact { point, scene_point: point + DVec3::Z * depth, normal: DVec3::NEG_Z, depth };
        let parameters =
            ContactParameters { stiffness: 2000.0, damping, tolerance: 0.0, friction: Friction::NONE };
        let model = LinearContactModel::from_contacts([contact], &center, &parameters, self.now);
        ContactUpdate::new(model, self.now, depth, 1)
    }

    fn step_by(&mut self, state: DeviceState, elapsed: f64, dt: f64) -> Record {
        self.now += elapsed;
        if self.queries {
            self.haptic.update_contacts(&self.query());
        }
        self.haptic.step(&state, self.now, dt)
    }

    fn step(&mut self, state: DeviceState) -> Record {
        self.step_by(state, PERIOD, PERIOD)
    }

    fn rest(&mut self, steps: usize, place: DVec3) -> Record {
        (0..steps)
            .map(|_| {
                let state = self.moving(place, DVec3::ZERO, PERIOD);
                self.step(state)
            })
            .last()
            .expect("a step")
    }

    /// Returns a state of the device `elapsed` (s) from now, with the host's time.
    fn moving(&self, place: DVec3, velocity: DVec3, elapsed: f64) -> DeviceState {
        DeviceState {
            time: self.now + elapsed,
            pose: Pose::from_translation(place),
            twist: Twist::new(velocity, DVec3::ZERO),
            buttons: 0,
            status: Status::OK,
        }
    }
}

/// 40 mm in 40 ms are 1 m/s, even though the late step integrates only 5 ms of them.
#[test]
fn a_late_wake_up_makes_no_spike_of_velocity() {
    let mut rig = Rig::new(Settings::default());
    let speed = DVec3::X;
    let mut place = DVec3::ZERO;
    let mut last = Wrench::ZERO;
    for _ in 0..400 {
        place += speed * PERIOD;
        let state = rig.moving(place, speed, PERIOD);
        last = rig.step(state).coupling;
    }
    place += speed * 0.04;
    let state = rig.moving(place, speed, 0.04);
    let late = rig.step_by(state, 0.04, 0.005).coupling;
    let grown = (late.force - last.force).length();
    assert!(grown < 0.2 * PEAK || late == Wrench::ZERO, "{grown} N in one write");
    let mut most = late.force.length();
    for _ in 0..300 {
        place += speed * PERIOD;
        let state = rig.moving(place, speed, PERIOD);
        most = most.max(rig.step(state).coupling.force.length());
    }
    assert!(most < 0.5 * PEAK, "{most} N after a wake-up 40 ms late, without contact");
}

/// A device that reports every other step keeps its velocity, instead of zero and twice as much in turn.
#[test]
fn stale_readings_do_not_count_as_rest() {
    let ripple = |every: usize| {
        let mut rig = Rig::new(Settings::default());
        let speed = DVec3::X * 0.3;
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut state = rig.moving(DVec3::ZERO, speed, PERIOD);
        for step in 0..500 {
            if step % every == 0 {
                let time = rig.now + PERIOD;
                state = rig.moving(speed * time, DVec3::ZERO, PERIOD);
            }
            let force = rig.step(state).coupling.force.x;
            if step >= 300 {
                (low, high) = (low.min(force), high.max(force));
            }
        }
        high - low
    };
    let (each, other) = (ripple(1), ripple(2));
    assert!(each < 1e-3, "{each} N though each step has a reading");
    assert!(other < 0.2, "{other} N of ripple at half the rate");
}

/// A device whose readings are mostly nonsense is not trusted for the plausible ones.
#[test]
fn a_device_that_reports_nonsense_gets_no_wrench() {
    let mut rig = Rig::on_floor(Settings::default(), 5e-3);
    let before = rig.rest(400, DVec3::ZERO).coupling.force.z;
    assert!(before > 1.0, "{before} N");
    let mut last = Wrench::ZERO;
    let mut held = 0;
    for step in 0..200 {
        let nonsense = step % 4 != 0;
        let far = DVec3::new(f64::from(step % 7) - 3.0, 1.0, f64::from(step % 5));
        let state = rig.moving(if nonsense { far } else { DVec3::ZERO }, DVec3::ZERO, PERIOD);
        last = rig.step(state).coupling;
        held += u32::from(last != Wrench::ZERO);
    }
    assert!(
        last == Wrench::ZERO && held <= 50,
        "{} N, of three bad readings in four, for {held} ms",
        last.force
    );
    let after = rig.rest(400, DVec3::ZERO).coupling.force.z;
    assert!((after - before).abs() < 0.01 * before, "{after} N once its readings are good");
    // Only one reading in ten is refused.
    let mut least = f64::INFINITY;
    for step in 0..500 {
        let state = rig.moving(if step % 10 == 0 { DVec3::ONE } else { DVec3::ZERO }, DVec3::ZERO, PERIOD);
        least = least.min(rig.step(state).coupling.force.z);
    }
    assert!(least > 0.9 * before, "{least} N of {before} N with a bad reading in ten");
}

/// A wrench that the driver withdrew comes up from zero.
#[test]
fn a_wrench_that_the_driver_withheld_comes_up_from_zero() {
    let mut rig = Rig::on_floor(Settings::default(), 5e-3);
    let before = rig.rest(400, DVec3::ZERO).coupling.force.z;
    assert!(before > 1.0, "{before} N");
    let withheld = DeviceState { status: Status::WITHHELD, ..rig.moving(DVec3::ZERO, DVec3::ZERO, PERIOD) };
    let first = rig.step(withheld).coupling.force.z;
    assert!(first.abs() < 0.01 * before, "{first} N in the first write after it, {before} N before");
    let early = rig.rest(19, DVec3::ZERO).coupling.force.z;
    assert!(early.abs() < 0.1 * before, "{early} N after 20 ms");
    let back = rig.rest(300, DVec3::ZERO).coupling.force.z;
    assert!((back - before).abs() < 1e-3, "{back} N");
}

/// One long step of a host does not bring the wrench up at once.
#[test]
fn a_long_step_of_a_host_does_not_complete_the_engagement() {
    let mut rig = Rig::on_floor(Settings::default(), 5e-3);
    let state = rig.moving(DVec3::ZERO, DVec3::ZERO, 0.2);
    let first = rig.step_by(state, 0.2, 0.2).coupling.force.length();
    assert!(first < 0.02 * PEAK, "{first} N in the first write");
}

/// Old contacts do not push.
#[test]
fn old_planes_do_not_push() {
    let mut rig = Rig::on_floor(Settings::default(), 5e-3);
    let before = rig.rest(400, DVec3::ZERO).coupling.force.z;
    assert!(before > 1.0, "{before} N");
    rig.queries = false;
    let after = rig.rest(101, DVec3::ZERO).coupling;
    assert_eq!(after, Wrench::ZERO, "100 ms after the last contact model");
}

/// Contacts found far away do not push.
#[test]
fn planes_found_far_away_do_not_push() {
    let mut rig = Rig::on_floor(Settings::default(), 5e-3);
    rig.rest(400, DVec3::ZERO);
    rig.queries = false;
    // In 30 ms the hand is 15 cm aside, three radii of the held object.
    let speed = DVec3::X * 5.0;
    let mut place = DVec3::ZERO;
    let mut pushed = 0.0;
    for _ in 0..30 {
        place += speed * PERIOD;
        let state = rig.moving(place, speed, PERIOD);
        pushed = rig.step(state).coupling.force.z;
    }
    assert!(pushed.abs() < 0.05, "{pushed} N along the normal of a plane that is 15 cm behind");
}

/// A device that comes back elsewhere leaves the object where it is.
#[test]
fn a_hand_that_is_found_elsewhere_does_not_drag_the_object() {
    let mut rig = Rig::new(Settings::default());
    rig.rest(300, DVec3::ZERO);
    let held = rig.haptic.object_pose();
    // No reading is good for 50 ms; then the hand is 8 cm aside and turned.
    for _ in 0..50 {
        let mut state = rig.moving(DVec3::ZERO, DVec3::ZERO, PERIOD);
        state.pose.translation.x = f64::NAN;
        rig.step(state);
    }
    let mut most = 0.0_f64;
    for _ in 0..500 {
        let mut state = rig.moving(DVec3::X * 0.08, DVec3::ZERO, PERIOD);
        state.pose.rotation = DQuat::from_rotation_z(0.6);
        most = most.max(rig.step(state).coupling.force.length());
    }
    let dragged = rig.haptic.object_pose().translation.distance(held.translation);
    assert!(dragged < 1e-3 && most < 0.05, "dragged by {dragged} m with {most} N");
    // The object follows from there.
    for step in 1..=300 {
        let x = 0.08 + 1e-4 * f64::from(step);
        let mut state = rig.moving(DVec3::X * x, DVec3::X * 0.1, PERIOD);
        state.pose.rotation = DQuat::from_rotation_z(0.6);
        rig.step(state);
    }
    let moved = rig.haptic.object_pose().translation - held.translation;
    assert!((moved - DVec3::X * 0.03).length() < 2e-3, "{moved}");
}

/// The same for a device that has moved before the first step.
#[test]
fn a_hand_that_moved_before_the_first_step_does_not_drag_the_object() {
    let mut rig = Rig::new(Settings::default());
    let held = rig.haptic.object_pose();
    let most = (0..500)
        .map(|_| {
            let state = rig.moving(DVec3::Y * 0.07, DVec3::ZERO, PERIOD);
            rig.step(state).coupling.force.length()
        })
        .fold(0.0, f64::max);
    let dragged = rig.haptic.object_pose().translation.distance(held.translation);
    assert!(dragged < 1e-3 && most < 0.05, "dragged by {dragged} m with {most} N");
}

/// A lasting force is limited to what the actuators can keep up.
#[test]
fn a_lasting_force_falls_to_the_continuous_force_of_the_device() {
    let continuous = Emulation::default().specification.continuous_force;
    let mut rig = Rig::on_floor(
        Settings {
            timing: TimingSettings { rate: 50.0, ..TimingSettings::default() },
            coupling: CouplingSettings { stiffness: Some(400.0), ..CouplingSettings::default() },
            ..Settings::default()
        },
        0.015,
    );
    let mut rest = |seconds: f64| {
        (0..(50.0 * seconds) as usize)
            .map(|_| {
                let state = rig.moving(DVec3::ZERO, DVec3::ZERO, 0.02);
                rig.step_by(state, 0.02, 0.02).coupling.force.length()
            })
            .last()
            .expect("a step")
    };
    let early = rest(2.0);
    assert!(early > 2.0 * continuous, "{early} N at first");
    let late = rest(3600.0);
    assert!(late <= continuous * 1.01, "{late} N after an hour, {continuous} N can be kept up");
    assert!(late > 0.9 * continuous, "{late} N is less than what can be kept up");
}

/// A handle that nobody holds is not driven off.
#[test]
fn a_handle_that_is_let_go_does_not_run_away() {
    let handle = Emulation::default().handle;
    let mut rig = Rig::on_floor(Settings::default(), 0.05);
    let pressed = rig.rest(300, DVec3::ZERO).coupling.force.z;
    assert!(pressed > 0.8 * PEAK, "{pressed} N");
    // A released handle is moved by its force alone.
    let (mut place, mut speed, mut force, mut fastest) = (0.0, 0.0, pressed, 0.0_f64);
    for _ in 0..300 {
        speed += force / handle.mass * PERIOD;
        speed -= handle.damping / handle.mass * speed * PERIOD;
        place += speed * PERIOD;
        fastest = fastest.max(speed);
        let state = rig.moving(DVec3::Z * place, DVec3::Z * speed, PERIOD);
        force = rig.step(state).coupling.force.z;
    }
    assert!(fastest < 1.0, "it flies off at {fastest} m/s");
}

/// A surface that is present only on the hand's way out gives no more energy than the bound, with the
/// passivity controller off.
#[test]
fn a_surface_that_creates_energy_stops_pushing() {
    let specification = Emulation::default().specification;
    let bound = ENERGY_BOUND.0 * specification.peak_force + ENERGY_BOUND.1 * specification.peak_torque;
    let mut rig = Rig::new(Settings::default());
    rig.rest(400, DVec3::ZERO);
    let surface = Some((rig.haptic.body_state().pose.translation.z + 2e-3, 20.0));
    let (mut given, mut most_given, mut last) = (0.0, 0.0_f64, DVec3::ZERO);
    // 8 mm down and up again, twenty times, 0.4 s each way.
    for step in 0..16_000 {
        let phase = TAU * f64::from(step) / 800.0;
        let depth = DVec3::NEG_Z * 4e-3 * (1.0 - phase.cos());
        let velocity = DVec3::NEG_Z * 4e-3 * phase.sin() * TAU / 0.8;
        rig.floor = surface.filter(|_| velocity.z > 0.0);
        let state = rig.moving(depth, velocity, PERIOD);
        let force = rig.step(state).coupling.force;
        given += last.dot(velocity) * PERIOD;
        most_given = most_given.max(given);
        last = force;
    }
    let events = rig.haptic.telemetry().events;
    assert!(events.energy_created > 0, "{most_given} J were given");
    let kept = rig.haptic.invariants().record(Invariant::Energy);
    assert!(kept.broken == 0 && most_given > bound, "{kept:?} of {bound} J, {most_given} J given in all");
}

/// An object that no step can move is put where the hand is.
#[test]
fn an_object_that_is_stuck_comes_back_to_the_hand() {
    let mut rig = Rig::new(Settings::default());
    rig.rest(300, DVec3::ZERO);
    rig.floor = Some((rig.haptic.body_state().pose.translation.z + 1e-3, f64::INFINITY));
    let mut place = DVec3::ZERO;
    for _ in 0..100 {
        place += DVec3::new(4e-4, 0.0, -4e-4);
        let state = rig.moving(place, DVec3::new(0.4, 0.0, -0.4), PERIOD);
        rig.step(state);
    }
    let refused = rig.haptic.telemetry().events.step_refused;
    assert!(refused > 90, "{refused} steps were refused");
    rig.floor = None;
    let most = (0..500)
        .map(|_| {
            let state = rig.moving(place, DVec3::ZERO, PERIOD);
            rig.step(state).coupling.force.length()
        })
        .fold(0.0, f64::max);
    assert!(most < 0.5, "dragged to the hand with {most} N");
}

/// A small wrench drops as fast as the hand comes off, whatever the slew limit.
#[test]
fn unloading_is_not_delayed() {
    let settings = Settings {
        output: OutputSettings { force_slew: Some(20.0), ..OutputSettings::default() },
        ..Settings::default()
    };
    let mut rig = Rig::on_floor(settings, 3e-3);
    let before = rig.rest(1000, DVec3::ZERO).coupling.force.z;
    assert!(before > 0.5 && before < 0.2 * PEAK, "{before} N");
    rig.floor = None;
    let after = rig.rest(40, DVec3::ZERO).coupling.force.z;
    assert!(after < 0.05 * before, "{after} N of {before} N, 40 ms after the surface was gone");
}

/// If a host's `dt` disagrees with its clock, the clock counts: no actuator heats up for hours in a
/// millisecond.
#[test]
fn a_host_that_reports_hours_heats_nothing() {
    let mut rig = Rig::on_floor(Settings::default(), 0.01);
    let before = rig.rest(400, DVec3::ZERO).coupling.force.z;
    let continuous = Emulation::default().specification.continuous_force;
    assert!(before > 1.5 * continuous, "{before} N");
    for dt in [3600.0, f64::INFINITY] {
        let state = rig.moving(DVec3::ZERO, DVec3::ZERO, PERIOD);
        rig.step_by(state, PERIOD, dt);
    }
    let warm = rig.haptic.invariants().record(Invariant::Heat).worst;
    assert!(warm < 0.5, "{warm} of what is kept up");
    let after = rig.rest(400, DVec3::ZERO).coupling.force.z;
    assert!((after - before).abs() < 1e-3, "{after} N of {before} N");
}

/// A step of no or negative duration is refused: the wrench comes up after it as after any refused step.
#[test]
fn a_step_of_no_time_keeps_the_promises() {
    for dt in [0.0, -6e-4, -3.0, f64::NAN, f64::NEG_INFINITY] {
        let mut rig = Rig::on_floor(Settings::default(), 5e-3);
        let before = rig.rest(400, DVec3::ZERO).coupling.force.z;
        let state = rig.moving(DVec3::ZERO, DVec3::ZERO, PERIOD);
        rig.step_by(state, PERIOD, dt);
        let after = rig.rest(400, DVec3::ZERO).coupling.force.z;
        assert!((after - before).abs() < 1e-3, "{dt}: {after} N of {before} N");
        assert_eq!(rig.haptic.invariants().broken(), 0, "{dt}: {}", rig.haptic.invariants());
    }
}

/// Contacts without a valid time, or older than the newest, are dropped, and are known only as they arrive.
#[test]
fn contacts_of_another_time_are_dropped() {
    for time in [f64::NAN, f64::NEG_INFINITY, 0.1] {
        let mut rig = Rig::on_floor(Settings::default(), 5e-3);
        let before = rig.rest(600, DVec3::ZERO).coupling.force.z;
        assert!(before > 1.0, "{before} N");
        rig.queries = false;
        let mut update = rig.query();
        update.time = time;
        rig.haptic.update_contacts(&update);
        let after = rig.rest(30, DVec3::ZERO).coupling;
        assert_eq!(after, Wrench::ZERO, "{time}");
        assert_eq!(rig.haptic.invariants().broken(), 0, "{time}: {}", rig.haptic.invariants());
    }
}
