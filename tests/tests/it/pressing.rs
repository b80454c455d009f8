//! A wall pressed through the whole loop, on every emulated device with its defaults: bounded, settled, and
//! nearly passive.
//!
//! The energy that the session creates is measured as the work that the written wrenches do on the true
//! handle. Its bound is the energy that the coupling's spring takes up over two distances: the travel of the
//! hand before a contact model accounts for it (two contact periods, since a query that takes its whole
//! period is answered at the end of the next), and an encoder step.

use std::convert::Infallible;
use std::f64::consts::TAU;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use palpate::core::{Twist, Wrench};
use palpate::device::{
    DeviceError, DeviceState, EmulatedDevice, Emulation, HapticDevice, IntendedPath, Specification,
};
use palpate::glam::{DQuat, DVec3};
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Scene, Settings};
use palpate_tests::{first_touch, model};

/// Observations at the handle itself.
#[derive(Clone, Copy, Debug, Default)]
struct Handle {
    position: DVec3,
    intended: DVec3,
    /// Work done on handle and hand, J: now, and its largest value.
    work: f64,
    most_work: f64,
    fastest: f64,
}

/// Device that also shows the handle's true motion.
struct Metered {
    device: EmulatedDevice,
    handle: Arc<Mutex<Handle>>,
}

impl HapticDevice for Metered {
    fn specification(&self) -> &Specification {
        self.device.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        let state = self.device.read(now);
        let mut handle = self.handle.lock().expect("one thread");
        let (pose, twist) = self.device.handle();
        handle.position = pose.translation;
        handle.intended = self.device.intended().0.translation;
        handle.work = self.device.work();
        handle.most_work = handle.most_work.max(handle.work);
        handle.fastest = handle.fastest.max(twist.linear.length());
        state
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        self.device.write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.device.close()
    }
}

const CLEARANCE: f64 = 3e-3;
const PRESS: f64 = 6e-3;
/// Times at which the hand starts, has arrived, begins to rub, starts back, has arrived, and rests, s.
const PHASES: [f64; 6] = [0.1, 0.6, 1.4, 2.2, 2.7, 3.2];

/// Returns the hand's intended motion: down onto the ball, 6 mm beyond the touch, rubbing and twisting, and
/// up again.
fn intended(touch: DVec3, time: f64) -> (Pose, Twist) {
    let [down, below, rub, up, above, _] = PHASES;
    let ramp = |from: f64, to: f64| {
        let x = ((time - from) / (to - from)).clamp(0.0, 1.0);
        (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / (to - from))
    };
    let ((lowered, lowering), (raised, raising)) = (ramp(down, below), ramp(up, above));
    let travel = CLEARANCE + PRESS;
    let rate = TAU / (up - rub);
    let (sine, cosine) = ((time.clamp(rub, up) - rub) * rate).sin_cos();
    let cosine = if (rub..up).contains(&time) { cosine } else { 0.0 };
    (
        Pose::new(
            touch + DVec3::new(1.5e-3 * sine, 0.0, CLEARANCE - travel * (lowered - raised)),
            DQuat::from_rotation_z(0.1 * sine),
        ),
        Twist::new(
            DVec3::new(1.5e-3 * rate * cosine, 0.0, -travel * (lowering - raising)),
            DVec3::Z * (0.1 * rate * cosine),
        ),
    )
}

fn press(name: &str, rate: f64, probe: &Object, ball: &Object, touch: DVec3) {
    let emulation = Emulation::preset(name).expect("a preset");
    let specification = emulation.specification.clone();
    let handle = Arc::new(Mutex::new(Handle::default()));
    let path = IntendedPath::function(move |time| intended(touch, time));
    let device = Metered { device: emulation.open(path).expect("a preset"), handle: handle.clone() };
    let scene = Scene::new().with(ball.clone(), Pose::IDENTITY);
    let renderer =
        HapticRenderer::new(probe.clone(), scene, Box::new(device), Settings::default()).expect("renderer");

    let context = format!("{name}, contacts at {rate} Hz");
    let (mut held, mut last_force) = (Vec::new(), DVec3::ZERO);
    let mut object = DVec3::ZERO;
    let session = renderer
        .run_lockstep(PHASES[5], ContactTiming::busy(rate), &AtomicBool::new(false), |row| {
            if (1.1..PHASES[2]).contains(&row.time) {
                held.push((row.coupling.force, handle.lock().expect("one thread").position));
            }
            (object, last_force) = (row.object.translation, row.coupling.force);
            Ok::<_, Infallible>(())
        })
        .expect("the sink never fails");
    let handle = *handle.lock().expect("one thread");
    let summary = session.summary();

    // The wall presses with the force of the hand's spring, or a little more while passing.
    let count = held.len() as f64;
    let force = held.iter().map(|h| h.0).sum::<DVec3>() / count;
    let hand = palpate::device::Hand::default().stiffness * PRESS;
    assert!(force.z > 0.3 * hand && force.z < hand, "{context}: {force} N of {hand} N");
    assert!(summary.coupling_force_max < 1.5 * force.z, "{context}: {} N", summary.coupling_force_max);
    // Settled: the handle, held by its friction, slips by no more than three encoder steps.
    let position = held.iter().map(|h| h.1).sum::<DVec3>() / count;
    let wander = held.iter().map(|h| h.1.distance(position)).fold(0.0, f64::max);
    assert!(wander < 3.0 * specification.encoder_step, "{context}: the handle wanders by {wander} m");

    let stiffness = 0.5 * specification.stiffness;
    let unseen = 2.0 * handle.fastest / rate;
    let bound = stiffness * (0.5 * unseen * unseen + specification.encoder_step.powi(2));
    assert!(handle.most_work < bound, "{context}: created {} J, bound {bound} J", handle.most_work);
    // At 50 Hz the stiffest couplings return more of the one unseen impact than the rest of the session
    // absorbs.
    assert!(rate < 200.0 || handle.work < 0.0, "{context}: {} J created over the whole session", handle.work);
    assert!(session.haptic.energy_min > -bound, "{context}: {} J", session.haptic.energy_min);

    // Nothing is left of the touch after it.
    assert!(last_force.length() < 0.05, "{context}: {last_force} N in free space");
    assert!(object.distance(handle.position) < 2.0 * specification.encoder_step, "{context}");
    assert!(handle.position.distance(handle.intended) < 1e-3, "{context}");
    let events = summary.events;
    assert_eq!((events.step_refused, events.device_refused, events.saturated), (0, 0, 0), "{context}");
}

#[test]
fn every_device_presses_a_ball_steadily_at_fast_and_slow_contact_rates() {
    let (probe, ball) = (model("ellipsoid@2000"), model("golf-ball@20000"));
    let touch = first_touch(&probe, &ball);
    let names: Vec<&str> = Emulation::presets().map(|(name, _)| name).collect();
    assert!(names.len() >= 6);
    std::thread::scope(|scope| {
        for name in names {
            let (probe, ball) = (&probe, &ball);
            scope.spawn(move || [1000.0, 200.0, 50.0].map(|rate| press(name, rate, probe, ball, touch)));
        }
    });
}
