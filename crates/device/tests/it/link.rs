//! A device behind a faulty connection: each fault sets its status at the next tick, and force is zero within
//! 10 ms.

use std::time::{Duration, Instant};

use glam::DVec3;
use palpate_core::Wrench;
use palpate_device::hid::{Deflection, EncodedMotion, RateControl, WoodenHapticsCodec, WoodenHapticsModel};
use palpate_device::link::{Codec, FakeWire, Link, LinkedDevice, Malformed, Pump, Report};
use palpate_device::{DeviceError, DeviceState, HapticDevice, Status};

const MODEL: WoodenHapticsModel = WoodenHapticsModel::WOODEN_HAPTICS;
const FORCE: Wrench = Wrench { force: DVec3::X, torque: DVec3::ZERO };

/// A report near the middle of the workspace.
fn report(count: i16) -> Vec<u8> {
    [count % 1000, 1333, 2547, 0, 0, 0, 0].into_iter().flat_map(i16::to_le_bytes).collect()
}

/// A WoodenHaptics, its pump and the haptic thread, in steps of a millisecond.
pub struct Bench {
    pub wire: FakeWire,
    pub pump: Pump<WoodenHapticsCodec>,
    pub device: LinkedDevice<EncodedMotion>,
    pub now: f64,
    /// Currents written last, mA.
    pub currents: [i16; 3],
    /// Whether the device answers.
    pub alive: bool,
    count: i16,
}

impl Bench {
    pub fn new() -> Self {
        let wire = FakeWire::new();
        let link = Link::wooden_haptics("test", MODEL);
        let other = wire.clone();
        let (pump, device) = link.split(move || Some(Box::new(other.open()?)));
        let mut bench = Self { wire, pump, device, now: 0.0, currents: [0; 3], alive: true, count: 0 };
        for _ in 0..20 {
            bench.tick().0.unwrap();
        }
        assert!(bench.currents[0] != 0, "a force is rendered");
        bench
    }

    /// State that the haptic thread reads, and whether its wrench was accepted.
    pub fn tick(&mut self) -> (Result<DeviceState, DeviceError>, bool) {
        self.device_speaks();
        let state = self.haptic();
        (state, self.device.write(&FORCE).is_ok())
    }

    pub fn device_speaks(&mut self) {
        self.now += 1e-3;
        if self.alive {
            self.count += 1;
            self.wire.send(&report(self.count));
        }
        self.pump.round(self.now);
        for report in self.wire.written() {
            assert_eq!(report.len(), 65);
            self.currents = [1, 3, 5].map(|at: usize| i16::from_le_bytes([report[at], report[at + 1]]));
        }
    }

    pub fn haptic(&mut self) -> Result<DeviceState, DeviceError> {
        self.device.read(self.now)
    }

    /// Ticks until the currents are zero; gives their number and the first state.
    fn until_zero(&mut self) -> (usize, Result<DeviceState, DeviceError>) {
        let first = self.tick().0;
        let mut ticks = 1;
        while self.currents != [0; 3] && ticks < 100 {
            let _ = self.tick();
            ticks += 1;
        }
        (ticks, first)
    }
}

pub fn status(state: Result<DeviceState, DeviceError>) -> Status {
    match state {
        Ok(state) => state.status,
        Err(DeviceError::Lost { status }) => status,
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn all_is_well_where_it_is() {
    let mut bench = Bench::new();
    for _ in 0..1000 {
        let (state, taken) = bench.tick();
        let state = state.unwrap();
        assert!(state.status.is_ok() && taken, "{state:?}");
        assert!(bench.now - state.time < 1.5e-3);
    }
    bench.device.close().unwrap();
    bench.device_speaks();
    assert_eq!(bench.currents, [0; 3]);
    assert!(matches!(bench.device.read(bench.now), Err(DeviceError::Closed)));
}

#[test]
fn an_unplugged_device_is_lost_at_once_and_taken_up_again() {
    let mut bench = Bench::new();
    bench.wire.unplug();
    let (state, taken) = bench.tick();
    assert!(status(state) == Status::DISCONNECTED && !taken);
    bench.wire.plug_in();
    let mut back = 0;
    while bench.tick().0.is_err() {
        back += 1;
        assert!(back < 600, "looked for twice a second");
    }
    // The wrench commanded before it went is not rendered now: it is zero up to the next order.
    assert_eq!(bench.currents, [0; 3]);
    bench.tick().0.unwrap();
    bench.tick().0.unwrap();
    assert!(bench.currents[0] != 0);
}

#[test]
fn a_silent_device_gets_no_force_and_is_lost_after_10_ms() {
    let mut bench = Bench::new();
    bench.alive = false;
    let (ticks, _) = bench.until_zero();
    assert!(ticks <= 10, "{ticks} ms");
    let mut silent = 0;
    for _ in 0..30 {
        if let (Err(error), taken) = bench.tick() {
            assert!(matches!(error, DeviceError::Lost { status: Status::SILENT }) && !taken, "{error}");
            silent += 1;
        }
    }
    assert!(silent >= 19, "{silent}");
    bench.alive = true;
    assert!(bench.tick().0.is_ok());
}

#[test]
fn a_haptic_thread_that_stands_still_leaves_no_force() {
    let mut bench = Bench::new();
    let mut ticks = 0;
    while bench.currents != [0; 3] {
        bench.device_speaks();
        ticks += 1;
        assert!(ticks <= 10, "{ticks} ms");
    }
    assert!(ticks > 2);
}

#[test]
fn malformed_reports_are_ignored_and_reported() {
    let mut bench = Bench::new();
    bench.wire.send(&[1, 2, 3]);
    let before = bench.count;
    let state = bench.tick().0.unwrap();
    assert_eq!(state.status, Status::MALFORMED);
    assert_eq!(bench.count, before + 1, "the good one is used");
    assert!(bench.tick().0.unwrap().status.is_ok());
    // Only such reports: the device is silent.
    bench.alive = false;
    let mut last = Status::OK;
    for _ in 0..30 {
        bench.wire.send(&[9; 13]);
        last = status(bench.tick().0);
    }
    assert!(last == Status::SILENT && bench.currents == [0; 3], "{last}");
}

#[test]
fn signals_and_floods_change_nothing() {
    let mut bench = Bench::new();
    for times in 1..=4 {
        bench.wire.interrupt(times);
        assert!(bench.tick().0.unwrap().status.is_ok());
    }
    // A full queue: the newest report that was kept counts, in one round.
    for _ in 0..500 {
        bench.wire.send(&report(0));
    }
    assert!(bench.tick().0.unwrap().status.is_ok());
    assert!(bench.tick().0.unwrap().status.is_ok());
}

#[test]
fn writes_that_fail_are_reported() {
    let mut bench = Bench::new();
    bench.wire.stall(true);
    assert_eq!(bench.tick().0.unwrap().status, Status::UNWRITTEN);
    bench.wire.stall(false);
    bench.tick().0.unwrap();
    assert!(bench.tick().0.unwrap().status.is_ok());
}

#[test]
fn wrenches_that_are_not_finite_are_refused() {
    let mut bench = Bench::new();
    bench.device.write(&Wrench::new(DVec3::NAN, DVec3::ZERO)).unwrap();
    bench.device_speaks();
    assert_eq!(bench.currents, [0; 3]);
    assert_eq!(bench.haptic().unwrap().status, Status::WRENCH_REFUSED);
    bench.device.write(&Wrench::new(DVec3::X * 1e9, DVec3::ZERO)).unwrap();
    assert_eq!(bench.haptic().unwrap().status, Status::FORCE_CLIPPED);
}

/// The haptic thread's reads and writes take no longer while each write to the device takes 20 ms, measured
/// by the thread's own processor time, which leaves out other threads.
#[test]
fn a_slow_device_does_not_hold_up_the_haptic_thread() {
    let wire = FakeWire::new();
    wire.delay_writes(Duration::from_millis(20));
    let other = wire.clone();
    let mut device =
        Link::wooden_haptics("test", MODEL).spawn(move || Some(Box::new(other.open()?))).unwrap();
    let start = Instant::now();
    let mut counted = Vec::new();
    for i in 0..200_i16 {
        wire.send(&report(i));
        let began = Instant::now();
        let _ = device.read(start.elapsed().as_secs_f64());
        let _ = device.write(&FORCE);
        counted.push(began.elapsed());
        std::thread::sleep(Duration::from_millis(1));
    }
    counted.sort_unstable();
    assert!(counted[100] < Duration::from_millis(1), "{:?} in the median", counted[100]);
    // Dropping it writes a last zero.
    drop(device);
    let last = wire.written().pop().expect("a report");
    assert_eq!(last, [0; 65]);
}

#[test]
fn a_cap_greets_and_says_farewell_and_may_be_silent() {
    let wire = FakeWire::new();
    let other = wire.clone();
    let link = Link::space_mouse("cap");
    let (mut pump, mut device): (_, LinkedDevice<RateControl>) =
        link.split(move || Some(Box::new(other.open()?)));
    assert_eq!(wire.written(), [[4, 1]]);
    let mut now = 0.0;
    let mut run = |pump: &mut Pump<_>, device: &mut LinkedDevice<_>, steps: usize| {
        let mut state = None;
        for _ in 0..steps {
            now += 1e-3;
            pump.round(now);
            state = Some(device.read(now).unwrap());
            device.write(&FORCE).unwrap();
        }
        state.unwrap()
    };
    assert!(run(&mut pump, &mut device, 1000).status.is_ok());
    wire.send(&[1, 0x5e, 1, 0, 0, 0, 0]);
    let state = run(&mut pump, &mut device, 100);
    assert!((state.pose.translation.x - 0.01).abs() < 3e-4 && state.status.is_ok(), "{state:?}");
    wire.send(&[1, 0, 0, 0, 0, 0, 0]);
    wire.send(&[3, 2]);
    let state = run(&mut pump, &mut device, 100);
    assert_eq!(state.buttons, 2);
    pump.end();
    assert_eq!(wire.written(), [[4, 0]]);
}

/// A driver from elsewhere whose pump panics.
#[derive(Debug)]
struct Faulty;

impl Codec for Faulty {
    type Sample = Deflection;

    fn decode(&mut self, _: &[u8], _: &mut Deflection) -> Result<(), Malformed> {
        panic!("a fault of the driver, as the test has it");
    }

    fn encode(&mut self, _: &Wrench, _: &Deflection, _: &mut dyn FnMut(Report)) {}
}

#[test]
fn a_driver_that_panics_is_a_lost_device() {
    let wire = FakeWire::new();
    let other = wire.clone();
    let Link { motion, specification, read_timeout, silence, .. } = Link::space_mouse("cap");
    let link = Link { codec: Faulty, motion, specification, read_timeout, silence };
    let mut device = link.spawn(move || Some(Box::new(other.open()?))).unwrap();
    assert!(device.read(0.0).is_ok());
    wire.send(&[1, 0, 0, 0, 0, 0, 0]);
    let start = Instant::now();
    while device.read(start.elapsed().as_secs_f64()).is_ok() {
        assert!(start.elapsed() < Duration::from_secs(10), "it is never reported");
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(matches!(device.read(20.0), Err(DeviceError::Lost { status: Status::DISCONNECTED })));
}
