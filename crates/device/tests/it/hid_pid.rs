//! Force feedback devices: report descriptors, commands, and descriptors that are not valid.

use glam::DVec3;
use palpate_core::Wrench;
use palpate_device::hid::{PEAK_FORCE, PidCodec, Stick};
use palpate_device::link::{Codec, FakeWire, Link, Pump};
use palpate_device::{Axes, HapticDevice, Status};
use rand::rngs::StdRng;
use rand::{Rng as _, RngExt as _, SeedableRng as _};

/// Builds a report descriptor, item by item.
#[derive(Default)]
struct Descriptor(Vec<u8>);

impl Descriptor {
    fn item(mut self, key: u8, value: i32) -> Self {
        let size = if i8::try_from(value).is_ok() { 1 } else { 2 };
        self.0.push(key | size);
        self.0.extend(&value.to_le_bytes()[..size.into()]);
        self
    }

    fn page(self, page: i32) -> Self {
        self.item(0x04, page)
    }

    fn usage(self, usage: i32) -> Self {
        self.item(0x08, usage)
    }

    fn range(self, from: i32, to: i32) -> Self {
        self.item(0x14, from).item(0x24, to)
    }

    fn collection(self, usage: i32, inner: impl FnOnce(Self) -> Self) -> Self {
        let mut all = inner(self.usage(usage).item(0xa0, 2));
        all.0.push(0xc0);
        all
    }

    fn number(self, number: i32) -> Self {
        self.item(0x84, number)
    }

    /// A field of a width with a usage, in a main item: 0x80 input, 0x90 output, 0xb0 feature.
    fn field(self, usage: i32, width: i32, main: u8) -> Self {
        self.usage(usage).item(0x74, width).item(0x94, 1).item(main, 2)
    }

    /// An array of usages.
    fn list(self, collection: i32, usages: std::ops::RangeInclusive<i32>, main: u8) -> Self {
        let count = usages.clone().count() as i32;
        self.collection(collection, |inner| {
            let inner = usages.fold(inner.range(1, count), Self::usage);
            inner.item(0x74, 8).item(0x94, 1).item(main, 0)
        })
    }
}

const INPUT: u8 = 0x80;
const OUTPUT: u8 = 0x90;
const FEATURE: u8 = 0xb0;

/// Usage of the duration of an effect.
const DURATION: i32 = 0x50;

/// A joystick of two axes and eight buttons with constant forces, a short form of OpenFFBoard's descriptor.
fn joystick() -> Vec<u8> {
    joystick_with(|d| d.range(0, 32767).field(DURATION, 16, OUTPUT))
}

/// The same with a different field for the duration, of 16 bits.
fn joystick_with(duration: impl Fn(Descriptor) -> Descriptor) -> Vec<u8> {
    let effect = |d: Descriptor| {
        let d = d.number(0x01).range(1, 40).field(0x22, 8, OUTPUT).list(0x25, 0x26..=0x29, OUTPUT);
        let d = duration(d).range(0, 255).field(0x52, 8, OUTPUT);
        d.field(0x53, 8, OUTPUT).collection(0x55, |d| {
            let d = d.page(1).range(0, 1).field(0x30, 1, OUTPUT).field(0x31, 1, OUTPUT);
            // Padding, up to a whole byte.
            d.page(0x0f).item(0x74, 6).item(0x94, 1).item(OUTPUT, 3)
        })
    };
    let force = |d: Descriptor| {
        let d = d.number(0x05).range(1, 40).field(0x22, 8, OUTPUT);
        d.range(-10_000, 10_000).field(0x70, 16, OUTPUT)
    };
    let operation = |d: Descriptor| {
        let d = d.number(0x0a).range(1, 40).field(0x22, 8, OUTPUT).list(0x78, 0x79..=0x7b, OUTPUT);
        d.range(0, 255).field(0x7c, 8, OUTPUT)
    };
    let create = |d: Descriptor| {
        let d = d.number(0x11).list(0x25, 0x26..=0x29, FEATURE);
        d.page(1).range(0, 511).field(0x3b, 16, FEATURE).page(0x0f)
    };
    let load = |d: Descriptor| {
        let d = d.number(0x12).range(1, 40).field(0x22, 8, FEATURE).list(0x8b, 0x8c..=0x8e, FEATURE);
        d.range(0, 32767).field(0xac, 16, FEATURE)
    };
    let input = Descriptor::default().page(1).usage(4).item(0xa0, 1).number(1).range(-32767, 32767);
    let input = input.field(0x30, 16, INPUT).field(0x31, 16, INPUT).page(9).range(0, 1);
    let input = (1..=8).fold(input, |d, button| d.field(button, 1, INPUT)).page(0x0f);
    let pid = input.collection(0x21, effect).collection(0x73, force).collection(0x77, operation);
    let pid = pid.collection(0x95, |d| d.number(0x0c).list(0x96, 0x97..=0x9c, OUTPUT));
    let pid = pid.collection(0x7d, |d| d.number(0x0d).range(0, 255).field(0x7e, 8, OUTPUT));
    let mut all = pid.collection(0xab, create).collection(0x89, load);
    all.0.push(0xc0);
    all.0
}

fn linked() -> (FakeWire, Pump<PidCodec>, impl HapticDevice) {
    let wire = FakeWire::new();
    // Two effects are loaded, as 3 and 4.
    wire.answer(&[0x12, 3, 1, 0, 0]);
    wire.answer(&[0x12, 4, 1, 0, 0]);
    let other = wire.clone();
    let link = Link::pid("stick", PidCodec::new(&joystick()).unwrap());
    let (pump, device) = link.split(move || Some(Box::new(other.open()?)));
    (wire, pump, device)
}

#[test]
fn a_stick_is_read_by_its_descriptor() {
    let mut codec = PidCodec::new(&joystick()).unwrap();
    let mut stick = Stick::default();
    codec.decode(&[1, 0xff, 0x7f, 0x01, 0x80, 0b1000_0001], &mut stick).unwrap();
    assert_eq!(stick, Stick { axes: [1.0, -1.0], buttons: 0x81 });
    let before = stick;
    assert!(codec.decode(&[1, 0, 0], &mut stick).is_err() && codec.decode(&[], &mut stick).is_err());
    assert_eq!(stick, before, "what is too short changes nothing");
    codec.decode(&[2, 9, 9, 9], &mut stick).unwrap();
    assert_eq!(stick, before, "nor does another report");
}

#[test]
fn a_constant_force_is_kept_for_each_axis() {
    let (wire, mut pump, mut device) = linked();
    let constant = [0x11, 1, 0, 0];
    assert_eq!(wire.features_set(), [constant, constant]);
    let effect = |index: u8, axis: u8| vec![1, index, 1, 50, 0, 0xff, 0xff, axis];
    let expected = [
        vec![0x0c, 3],
        vec![0x0c, 1],
        vec![0x0d, 0xff],
        effect(3, 1),
        vec![5, 3, 0, 0],
        vec![0x0a, 3, 1, 1],
        effect(4, 2),
        vec![5, 4, 0, 0],
        vec![0x0a, 4, 1, 1],
    ];
    assert_eq!(wire.written(), expected);
    let specification = device.specification().clone();
    assert_eq!(specification.actuated, Axes { translation: [true, true, false], rotation: [false; 3] });
    let mut now = 0.0;
    let mut write = |force: DVec3| {
        now += 1e-3;
        let status = device.read(now).unwrap().status;
        device.write(&Wrench::new(force, DVec3::ZERO)).unwrap();
        pump.round(now);
        (wire.written(), status)
    };
    // Half the force to the right, a quarter away from the user, where HID's y points at the user.
    let (written, _) = write(DVec3::new(0.5, 0.25, 0.1) * PEAK_FORCE);
    assert_eq!(written, [vec![5, 3, 0x88, 0x13], vec![5, 4, 0x3c, 0xf6]]);
    assert!(write(DVec3::new(0.5, 0.25, 0.3) * PEAK_FORCE).0.is_empty(), "the same again is not said");
    let (written, _) = write(DVec3::X * -99.0);
    assert_eq!(written, [vec![5, 3, 0xf0, 0xd8], vec![5, 4, 0, 0]]);
    assert_eq!(write(DVec3::ZERO), (vec![vec![5, 3, 0, 0]], Status::FORCE_CLIPPED));
    drop(device);
    pump.end();
    assert_eq!(wire.written(), [[0x0c, 3]], "all stopped");
}

#[test]
fn full_device_or_one_with_stalled_features_is_retried() {
    let wire = FakeWire::new();
    wire.stall_features(true);
    let other = wire.clone();
    let link = Link::pid("stick", PidCodec::new(&joystick()).unwrap());
    let (mut pump, mut device) = link.split(move || Some(Box::new(other.open()?)));
    let mut now = 0.0;
    let mut run = |pump: &mut Pump<_>, steps: usize| {
        let mut read = false;
        for _ in 0..steps {
            now += 1e-3;
            pump.round(now);
            read = device.read(now).is_ok();
            let _ = device.write(&Wrench::new(DVec3::X, DVec3::ZERO));
        }
        read
    };
    assert!(!run(&mut pump, 700));
    // It answers, but is full.
    wire.stall_features(false);
    wire.answer(&[0x12, 1, 2, 0, 0]);
    assert!(!run(&mut pump, 600));
    wire.answer(&[0x12, 1, 1, 0, 0]);
    wire.answer(&[0x12, 2, 1, 0, 0]);
    wire.written();
    assert!(run(&mut pump, 600));
    assert!(wire.written().iter().any(|report| report[..2] == [5, 1] && report[2..] != [0, 0]));
}

#[test]
fn descriptors_of_other_devices_are_refused_with_what_they_lack() {
    let check = |descriptor: &[u8], what: &str| {
        let error = PidCodec::new(descriptor).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    };
    let mouse = Descriptor::default().page(1).usage(2).item(0xa0, 1).range(-127, 127);
    let mut mouse = mouse.field(0x30, 8, INPUT).field(0x31, 8, INPUT).0;
    mouse.push(0xc0);
    check(&mouse, "constant forces");
    check(&[], "");
    let whole = joystick();
    // Without its axes.
    let mut deaf = whole.clone();
    let at = deaf.windows(2).position(|item| item == [0x09, 0x30]).unwrap();
    deaf[at + 1] = 0x40;
    let at = deaf.windows(2).position(|item| item == [0x09, 0x31]).unwrap();
    deaf[at + 1] = 0x41;
    check(&deaf, "axes");
}

#[test]
fn any_descriptor_and_any_bytes_end_well() {
    let mut rng = StdRng::seed_from_u64(91);
    let whole = joystick();
    let (mut reports, mut said) = (0, 0);
    for i in 0..30_000 {
        let mut descriptor = whole.clone();
        if i % 4 == 0 {
            descriptor.truncate(rng.random_range(0..whole.len()));
            rng.fill_bytes(&mut descriptor);
        } else {
            for _ in 0..rng.random_range(0..4) {
                let at = rng.random_range(0..whole.len());
                descriptor[at] = (rng.next_u32() >> 8) as u8;
            }
        }
        let Ok(mut codec) = PidCodec::new(&descriptor) else { continue };
        let wire = FakeWire::new();
        for _ in 0..2 {
            wire.answer(&[0x12, 1, 1, 0, 0]);
        }
        let _ = codec.start(&mut wire.open().unwrap());
        let mut stick = Stick::default();
        for _ in 0..120 {
            let mut bytes = [0; 65];
            let length = rng.random_range(0..=65);
            rng.fill_bytes(&mut bytes[..length]);
            bytes[0] = rng.random_range(0..3);
            let _ = codec.decode(&bytes[..length], &mut stick);
            reports += 1;
            assert!(stick.axes.iter().all(|axis| (-1.0..=1.0).contains(axis)), "{stick:?}");
            let force = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1e3..1e3)));
            codec.encode(&Wrench::new(force, DVec3::ZERO), &stick, &mut |_| said += 1);
        }
    }
    assert!(reports >= 1_000_000 && said > 100_000, "{reports} {said}");
}

/// Force that a [`joystick`] renders, from the reports written to it: its effects end by themselves.
#[derive(Default)]
struct Player {
    /// Magnitude, duration (ms) and start (ms) of each effect.
    effects: std::collections::HashMap<u8, (i16, u16, Option<u64>)>,
    /// Number of reports taken.
    reports: usize,
}

impl Player {
    fn take(&mut self, reports: Vec<Vec<u8>>, now: u64) {
        self.reports += reports.len();
        for report in reports {
            let word = |at: usize| u16::from_le_bytes([report[at], report[at + 1]]);
            match report[0] {
                // All effects stopped.
                0x0c if report[1] == 3 => self.effects.values_mut().for_each(|effect| effect.2 = None),
                0x01 => self.effects.entry(report[1]).or_default().1 = word(3),
                0x05 => self.effects.entry(report[1]).or_default().0 = word(2) as i16,
                0x0a => {
                    let effect = self.effects.entry(report[1]).or_default();
                    // 255 loops are endless.
                    let loops = if report[3] == 255 { u16::MAX } else { report[3].into() };
                    effect.1 = effect.1.saturating_mul(loops);
                    effect.2 = Some(now);
                }
                _ => {}
            }
        }
    }

    /// Magnitudes along x and y.
    fn force(&self, now: u64) -> [i16; 2] {
        [3, 4].map(|index| match self.effects.get(&index) {
            Some((magnitude, duration, Some(started))) if now - started < (*duration).into() => *magnitude,
            _ => 0,
        })
    }
}

/// A host at 1 kHz.
struct Host<D> {
    wire: FakeWire,
    pump: Pump<PidCodec>,
    device: D,
    player: Player,
    now: u64,
}

impl<D: HapticDevice> Host<D> {
    /// A round that commands a force, `late` (ms) after the last one.
    fn round(&mut self, force: DVec3, late: u64) {
        self.now += late;
        let now = 1e-3 * self.now as f64;
        let _ = self.device.read(now);
        let _ = self.device.write(&Wrench::new(force, DVec3::ZERO));
        self.pump.round(now);
        self.player.take(self.wire.written(), self.now);
    }
}

fn host() -> Host<impl HapticDevice> {
    let (wire, pump, device) = linked();
    let mut host = Host { wire, pump, device, player: Player::default(), now: 0 };
    host.round(DVec3::ZERO, 1);
    host
}

const PUSH: DVec3 = DVec3::new(0.5 * PEAK_FORCE, 0.25 * PEAK_FORCE, 0.0);
const PUSHED: [i16; 2] = [5000, -2500];

#[test]
fn the_force_of_a_host_that_was_killed_ends_by_itself() {
    let mut host = host();
    for _ in 0..100 {
        host.round(PUSH, 1);
    }
    assert_eq!(host.player.force(host.now), PUSHED);
    let left = (0..10_000).take_while(|after| host.player.force(host.now + after) != [0; 2]).count();
    assert!(left <= 50, "the stick still pushes {left} ms after the last report");
}

#[test]
fn a_force_that_is_kept_up_does_not_drop_though_rounds_are_late() {
    let mut host = host();
    host.round(PUSH, 1);
    for i in 0..2000_u64 {
        let late = if i % 50 == 49 { 24 } else { 1 };
        for passed in 0..late {
            assert_eq!(host.player.force(host.now + passed), PUSHED, "{i}");
        }
        host.round(PUSH, late);
    }
    // A constant force costs a report every 5 ms, and a changing one no more than that on top.
    host.player.reports = 0;
    for _ in 0..1000 {
        host.round(PUSH, 1);
    }
    assert!((200..=205).contains(&host.player.reports), "{} reports in a second", host.player.reports);
    let mut most = 0;
    for i in 0..1000 {
        let before = host.player.reports;
        host.round(PUSH * (0.5 + 4e-4 * f64::from(i)), 1);
        most = most.max(host.player.reports - before);
    }
    assert!(most <= 3, "{most} reports in a round");
}

#[test]
fn force_ends_although_the_report_that_ends_it_was_lost() {
    let mut host = host();
    for _ in 0..100 {
        host.round(PUSH, 1);
    }
    host.wire.stall(true);
    host.round(DVec3::ZERO, 1);
    host.wire.stall(false);
    let mut left = 0;
    while host.player.force(host.now) != [0; 2] && left < 1000 {
        host.round(DVec3::ZERO, 1);
        left += 1;
    }
    assert!(left <= 25, "{left} ms of a force that was taken back");
}

/// The duration that a codec sets, in the device's counts, or the error.
fn duration(field: impl Fn(Descriptor) -> Descriptor) -> Result<u16, String> {
    let mut codec = PidCodec::new(&joystick_with(field)).map_err(|error| error.to_string())?;
    let wire = FakeWire::new();
    wire.answer(&[0x12, 3, 1, 0, 0]);
    wire.answer(&[0x12, 4, 1, 0, 0]);
    codec.start(&mut wire.open().unwrap()).unwrap();
    let effects = wire.written().into_iter().filter(|report| report[0] == 1);
    let counts: Vec<u16> = effects.map(|effect| u16::from_le_bytes([effect[3], effect[4]])).collect();
    assert!(counts.len() == 2 && counts[0] == counts[1], "{counts:?}");
    Ok(counts[0])
}

/// Keys of items: physical minimum and maximum of a field, the exponent of its unit, and the unit.
const PHYSICAL: [u8; 2] = [0x34, 0x44];
const EXPONENT: u8 = 0x54;
const UNIT: u8 = 0x64;

#[test]
fn the_duration_is_set_in_the_devices_units() {
    let plain = |d: Descriptor| d.field(DURATION, 16, OUTPUT);
    // Seconds as a unit, with or without an exponent; the other fields are without a unit again.
    let unit = |d: Descriptor, exponent: i32| d.item(EXPONENT, exponent).item(UNIT, 0x1003);
    let none = |d: Descriptor| d.item(EXPONENT, 0).item(UNIT, 0);
    let whole = |d: Descriptor| d.range(0, 32767);
    assert_eq!(duration(|d| plain(whole(d))), Ok(50));
    assert_eq!(duration(|d| none(plain(unit(whole(d), -3)))), Ok(50), "0xfd");
    assert_eq!(duration(|d| none(plain(unit(whole(d), 13)))), Ok(50), "the standard's -3");
    assert_eq!(duration(|d| none(plain(unit(whole(d), -4)))), Ok(500), "0.1 ms");
    assert_eq!(duration(|d| none(plain(unit(whole(d), -2)))), Ok(5), "10 ms");
    assert_eq!(duration(|d| none(plain(unit(whole(d), 0)))), Ok(1), "1 s is the shortest");
    // Counts of 2 ms, and counts that start at 20 ms.
    let physical = |d: Descriptor, least: i32, most: i32| d.item(PHYSICAL[0], least).item(PHYSICAL[1], most);
    assert_eq!(duration(|d| physical(plain(physical(d.range(0, 5000), 0, 10_000)), 0, 0)), Ok(25));
    assert_eq!(duration(|d| physical(plain(physical(d.range(0, 1000), 20, 1020)), 0, 0)), Ok(30));
    // Neither 0 nor the largest count, which may mean endless.
    assert_eq!(duration(|d| plain(d.range(0, 50))), Ok(49));
    assert_eq!(duration(|d| physical(plain(physical(d.range(0, 2), 0, 32)), 0, 0)).unwrap_err(), TOO_SHORT);
    assert_eq!(duration(|d| none(plain(unit(whole(d), -6)))), Ok(32_766), "33 ms are the longest");
    let error = duration(|d| d.range(0, 32767).field(0x51, 16, OUTPUT)).unwrap_err();
    assert!(error.contains("lacks the duration of an effect"), "{error}");
}

const TOO_SHORT: &str = "no force feedback device (its effects last 16.0 ms at most, and 30 ms are needed)";

/// A stick that reports every other millisecond while it is moved, and nothing at rest.
#[test]
fn a_stick_that_is_moved_has_a_steady_speed_and_at_rest_none() {
    let (wire, mut pump, mut device) = linked();
    let mut speeds = Vec::new();
    for step in 0..400_i16 {
        let now = 1e-3 * f64::from(step);
        if step % 2 == 0 && step < 200 {
            let [low, high] = (65 * step).to_le_bytes();
            wire.send(&[1, low, high, 0, 0, 0]);
        }
        pump.round(now);
        let state = device.read(now + 1e-4 * f64::from(step * 7 % 10)).unwrap();
        assert!(state.status.is_ok() && state.time <= now + 1e-3, "{state:?}");
        speeds.push(state.twist.linear.x);
    }
    // 65 counts of 1.5 µm a millisecond.
    let speed = 65.0 * 0.1 / 65.534;
    let (low, high) = speeds[20..200]
        .iter()
        .fold((f64::INFINITY, 0.0_f64), |(low, high), speed| (low.min(*speed), high.max(*speed)));
    assert!(low > 0.98 * speed && high < 1.02 * speed, "{low} to {high} m/s, where it is {speed} m/s");
    assert_eq!(speeds[220..], [0.0; 180], "at rest");
}
