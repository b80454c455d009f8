//! Sessions with HID devices over a simulated wire.

use palpate::device::hid::WoodenHapticsModel;
use palpate::device::link::{FakeWire, Link};
use palpate::device::{HapticDevice, Specification};
use palpate::glam::DVec3;
use palpate::{ContactLoop, HapticLoop, HapticRenderer, Pose, Scene, Settings};
use palpate_tests::model;

/// Session in the loops of a host, including the device's pump.
struct Rig<P> {
    wire: FakeWire,
    pump: P,
    haptic: HapticLoop,
    contact: ContactLoop,
    device: Box<dyn HapticDevice>,
    now: f64,
}

/// Returns the loops of an ellipsoid above a block, held by a device.
fn loops(device: impl HapticDevice + 'static) -> (HapticLoop, ContactLoop, Box<dyn HapticDevice>) {
    let scene = Scene::new().with(model("block@300"), Pose::from_translation(-DVec3::Z * 0.2));
    let renderer = HapticRenderer::new(model("ellipsoid@500"), scene, Box::new(device), Settings::default());
    renderer.expect("a session").into_loops()
}

impl<P: FnMut(f64)> Rig<P> {
    /// Advances by a millisecond; returns the object's position and the coupling force.
    fn tick(&mut self, report: &[u8]) -> (DVec3, DVec3) {
        self.now += 1e-3;
        self.wire.send(report);
        (self.pump)(self.now);
        let record = self.haptic.step_device(&mut *self.device, self.now, 1e-3);
        let update = self.contact.step(self.haptic.body_state(), self.now);
        self.haptic.update_contacts(&update);
        (record.object.translation, record.coupling.force)
    }
}

#[test]
fn an_object_follows_a_cap() {
    let wire = FakeWire::new();
    let other = wire.clone();
    let (mut pump, device) = Link::space_mouse("cap").split(move || Some(Box::new(other.open()?)));
    let (haptic, contact, device) = loops(device);
    let pump = move |now| {
        pump.round(now);
    };
    let mut rig = Rig { wire, pump, haptic, contact, device, now: 0.0 };
    let mut place = DVec3::ZERO;
    for _ in 0..500 {
        place = rig.tick(&[1, 0x5e, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]).0;
    }
    // At 0.1 m/s, and slightly behind.
    assert!((0.03..0.051).contains(&place.x) && place.y.abs() < 1e-6, "{place}");
    for _ in 0..500 {
        place = rig.tick(&[1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]).0;
    }
    assert!((place.x - 0.05).abs() < 1e-3, "{place}");
    let events = rig.haptic.telemetry().events;
    assert_eq!((events.device_refused, events.device_jumped, events.step_refused), (0, 0, 0));
}

#[test]
fn a_session_outlives_its_device() {
    let wire = FakeWire::new();
    let other = wire.clone();
    let report = |across: i16| -> Vec<u8> {
        [across, 1333, 2547, 0, 0, 0, 0].into_iter().flat_map(i16::to_le_bytes).collect()
    };
    let link = Link::wooden_haptics("unit", WoodenHapticsModel::WOODEN_HAPTICS);
    let (mut pump, mut device) = link.split(move || Some(Box::new(other.open()?)));
    wire.send(&report(0));
    pump.round(0.0);
    device.read(0.0).expect("its first word");
    let limits: Specification = device.specification().clone();
    let (haptic, contact, device) = loops(device);
    let pump = move |now| {
        pump.round(now);
    };
    let mut rig = Rig { wire, pump, haptic, contact, device, now: 0.0 };
    // Pulled along, the object's inertia is felt.
    let mut largest = 0.0_f64;
    for i in 0..400 {
        largest = largest.max(rig.tick(&report(2 * i)).1.length());
    }
    assert!(largest > 1e-3 && largest <= limits.peak_force, "{largest}");
    rig.wire.unplug();
    for _ in 0..200 {
        assert_eq!(rig.tick(&report(800)).1, DVec3::ZERO);
    }
    assert!(rig.haptic.telemetry().events.device_refused >= 199, "{:?}", rig.haptic.telemetry().events);
    rig.wire.plug_in();
    let mut place = DVec3::ZERO;
    for _ in 0..1500 {
        place = rig.tick(&report(800)).0;
    }
    let handle = WoodenHapticsModel::WOODEN_HAPTICS.pose(&[800, 1333, 2547, 0, 0, 0]).translation;
    assert!(place.distance(handle) < 1e-3, "{place} {handle}");
}
