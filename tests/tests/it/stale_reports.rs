//! A device that reports at half the rate of the loop, from its reports to the wrench.

use palpate::device::hid::{EncodedMotion, Encoders, WoodenHapticsModel};
use palpate::device::link::{FakeWire, Link, Motion};
use palpate::device::{DeviceError, DeviceState, HapticDevice, Specification};
use palpate::glam::DVec3;
use palpate::settings::ToolSettings;
use palpate::{HapticRenderer, Pose, Scene, Settings, Twist, Wrench};
use palpate_tests::model;

const PERIOD: f64 = 1e-3;

/// Device whose readings have the time of the read, instead of the report's.
struct StampedWhenRead<D>(D);

impl<D: HapticDevice> HapticDevice for StampedWhenRead<D> {
    fn specification(&self) -> &Specification {
        self.0.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        self.0.read(now).map(|state| DeviceState { time: now, ..state })
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        self.0.write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.0.close()
    }
}

/// Motion codec with the times of reports, or with those of reads.
struct Stamped {
    motion: EncodedMotion,
    when_read: bool,
}

impl Motion for Stamped {
    type Sample = Encoders;

    fn advance(&mut self, sample: &Encoders, came: Option<f64>, now: f64) -> (Pose, Twist, u32) {
        self.motion.advance(sample, if self.when_read { Some(now) } else { came }, now)
    }
}

/// Runs a loop on a WoodenHaptics that moves steadily at 0.2 m/s in free space and reports every `every`
/// steps. Returns the largest change of the force in a step, N, and the number of readings that counted as
/// stale.
fn ripple(every: i16, stamped_when_read: bool) -> (f64, u64) {
    let wire = FakeWire::new();
    let other = wire.clone();
    let Link { codec, motion, specification, read_timeout, silence } =
        Link::wooden_haptics("wooden", WoodenHapticsModel::WOODEN_HAPTICS);
    let motion = Stamped { motion, when_read: stamped_when_read };
    let link = Link { codec, motion, specification, read_timeout, silence };
    let (mut pump, device) = link.split(move || Some(Box::new(other.open()?)));
    let device: Box<dyn HapticDevice> =
        if stamped_when_read { Box::new(StampedWhenRead(device)) } else { Box::new(device) };
    let settings =
        Settings { tool: ToolSettings { mass: 0.5, ..ToolSettings::default() }, ..Settings::default() };
    // The loop needs a device, which is there from its first report on.
    let encoders = |step: i16| [5 * step, 1333, 2547, 0, 0, 0, 0].map(i16::to_le_bytes).concat();
    wire.send(&encoders(0));
    pump.round(0.0);
    let renderer = HapticRenderer::new(model("ellipsoid@500"), Scene::new(), device, settings);
    let (mut haptic, mut contact, mut device) = renderer.expect("a renderer").into_loops();
    let (mut last, mut ripple) = (DVec3::ZERO, 0.0_f64);
    for step in 1..500_i16 {
        let now = PERIOD * f64::from(step);
        if step % every == 0 {
            wire.send(&encoders(step));
        }
        pump.round(now);
        haptic.update_contacts(&contact.step(haptic.body_state(), now));
        let force = haptic.step_device(&mut *device, now, PERIOD).coupling.force;
        if step >= 300 {
            ripple = ripple.max(force.distance(last));
        }
        last = force;
    }
    (ripple, haptic.telemetry().events.device_stale)
}

#[test]
fn half_the_rate_of_reports_gives_no_ripple_of_the_force() {
    let (each, none) = ripple(1, false);
    let (other, stale) = ripple(2, false);
    let (wrong, unseen) = ripple(2, true);
    assert!(
        none == 0 && unseen == 0 && (240..=250).contains(&stale),
        "{none} {unseen} {stale} stale readings"
    );
    assert!(other < 2.0 * each + 0.05, "{other} N at half the rate, {each} N at the whole");
    // Without detection of stale readings the test fails.
    assert!(wrong > 2.0 * other, "{wrong} N with stale readings unnoticed, {other} N with them noticed");
}
