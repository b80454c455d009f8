//! The whole way from the bytes of a device's reports to the force on the hand, over a wire that is cruel to them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use palpate::device::link::{LinkedDevice, Pump};
use palpate::device::{DeviceError, DeviceState, HapticDevice, Specification, Status};
use palpate::dynamics::{ContactParameters, Friction, LinearContactModel};
use palpate::glam::DVec3;
use palpate::settings::{CouplingSettings, OutputSettings, TimingSettings};
use palpate::threads::{Role, set_up};
use palpate::{Contact, ContactUpdate, Events, HapticLoop, HapticRenderer, Scene, Settings, Wrench};
use palpate_tests::cruel_wire::{CruelWire, Cruelty, Findings, HandCodec, HandMotion, Sabotage, Trouble};
use palpate_tests::model;

const PERIOD: f64 = 1e-3;
/// The slew that the loop is asked for, N/s.
const SLEW: f64 = 200.0;
/// Stiffness of the coupling, N/m: more than is chosen for so late a device.
const STIFFNESS: f64 = 400.0;
/// Depth of a floor of 2 kN/m under where the hand begins, m.
const FLOOR: f64 = 4e-3;
/// Most periods that a step makes up for.
const MOST_PERIODS: f64 = 5.0;

/// A host's loop with a device over a cruel wire, and a contact query that finds a floor.
struct Rig {
    wire: CruelWire,
    haptic: HapticLoop,
    device: Box<dyn HapticDevice>,
    /// Height of the floor, m.
    floor: f64,
    /// Of the loop, and the time of the last step, s.
    period: f64,
    stepped: f64,
}

impl Rig {
    fn new(wire: CruelWire, device: Box<dyn HapticDevice>, period: f64) -> Self {
        let settings = Settings {
            timing: TimingSettings { rate: 1.0 / period, ..TimingSettings::default() },
            coupling: CouplingSettings { stiffness: Some(STIFFNESS), ..CouplingSettings::default() },
            output: OutputSettings { force_slew: Some(SLEW), ..OutputSettings::default() },
            ..Settings::default()
        };
        let renderer = HapticRenderer::new(model("ellipsoid@500"), Scene::new(), device, settings);
        let (haptic, _, device) = renderer.expect("a renderer").into_loops();
        let floor = haptic.body_state().pose.translation.z - FLOOR;
        Self { wire, haptic, device, floor, period, stepped: f64::NEG_INFINITY }
    }

    /// What a contact query finds under the object's centre of mass.
    fn query(&self, now: f64) -> ContactUpdate {
        let center = self.haptic.body_state().pose;
        let point = center.translation;
        let depth = self.floor - point.z;
        let contact = Contact { point, scene_point: point + DVec3::Z * depth, normal: DVec3::NEG_Z, depth };
        let parameters =
            ContactParameters { stiffness: 2000.0, damping: 20.0, tolerance: 0.0, friction: Friction::NONE };
        let model = LinearContactModel::from_contacts([contact], &center, &parameters, now);
        ContactUpdate { model, time: now, depth, contacts: 1 }
    }

    fn step(&mut self, now: f64) {
        let dt = (now - self.stepped).min(MOST_PERIODS * self.period);
        self.stepped = now;
        let update = self.query(now);
        self.haptic.update_contacts(&update);
        self.haptic.step_device(&mut *self.device, now, dt);
        self.wire.note_step();
    }

    /// Steps in real time until the wire's time is over, then lets the wrench fade.
    fn render(&mut self) {
        let start = Instant::now();
        let steps = (SECONDS / PERIOD) as u32;
        let mut tick = 0;
        while tick < steps {
            // Steps that it is too late for are left out.
            tick = (tick + 1).max((start.elapsed().as_secs_f64() / PERIOD) as u32);
            let deadline = start + Duration::from_secs_f64(PERIOD * f64::from(tick));
            std::thread::sleep(deadline.saturating_duration_since(Instant::now()));
            if tick + FADING > steps {
                self.haptic.leave();
            }
            self.step(PERIOD * f64::from(tick));
        }
    }

    fn outcome(&self) -> Outcome {
        Outcome {
            findings: self.wire.findings(),
            events: self.haptic.telemetry().events,
            broken: self.haptic.invariants().broken(),
            invariants: self.haptic.invariants().to_string(),
        }
    }
}

/// What a run came to.
struct Outcome {
    findings: Findings,
    events: Events,
    /// What was broken of the engine's own invariants, and in words.
    broken: u64,
    invariants: String,
}

const SECONDS: f64 = 3.0;
/// Steps over which the wrench fades before the end.
const FADING: u32 = 60;
/// Milliseconds before the loop begins.
const FIRST: u32 = 20;

/// In simulated time, a millisecond after the other.
fn lockstep(cruelty: &Cruelty, sabotage: Sabotage, seed: u64) -> Outcome {
    lockstep_with(cruelty, sabotage, seed, |device| Box::new(device))
}

/// The same with a device that is wrapped.
fn lockstep_with(
    cruelty: &Cruelty,
    sabotage: Sabotage,
    seed: u64,
    wrap: impl Fn(LinkedDevice<HandMotion>) -> Box<dyn HapticDevice>,
) -> Outcome {
    let wire = CruelWire::new(cruelty.clone(), sabotage, seed, SECONDS, SLEW);
    let other = wire.clone();
    let (mut pump, device): (Pump<HandCodec>, _) = wire.link().split(move || other.open());
    // Before its first report there is no device to make a loop for.
    for tick in 1..=FIRST {
        wire.advance(PERIOD * f64::from(tick));
        pump.round(PERIOD * f64::from(tick));
    }
    let mut rig = Rig::new(wire, wrap(device), PERIOD * f64::from(cruelty.every()));
    for tick in FIRST + 1..=(SECONDS / PERIOD) as u32 {
        let now = PERIOD * f64::from(tick);
        rig.wire.advance(now);
        if !rig.wire.has(Trouble::PumpStalls) {
            pump.round(now);
        }
        if tick % cruelty.every() == 0 && !rig.wire.has(Trouble::LoopStalls) {
            rig.step(now);
        }
    }
    rig.outcome()
}

/// A wire with the delays of a good one.
fn mild() -> Cruelty {
    Cruelty { latency: (3e-4, 5e-4), ..Cruelty::default() }
}

fn cruelties() -> Vec<(&'static str, Cruelty)> {
    let troubled = |trouble| Cruelty { troubles: vec![trouble], ..mild() };
    vec![
        ("mild", mild()),
        ("late", Cruelty { latency: (3e-3, 3e-3), ..mild() }),
        ("uneven", Cruelty { jitter: 2.5e-3, ..mild() }),
        ("lossy", Cruelty { lost: 0.3, ..mild() }),
        ("overtaken", Cruelty { overtaken: 0.1, ..mild() }),
        ("doubled", Cruelty { doubled: 0.3, ..mild() }),
        ("cut", Cruelty { cut: 0.2, ..mild() }),
        ("flipped", Cruelty { flipped: 0.2, ..mild() }),
        ("flipped, unchecked", Cruelty { flipped: 0.05, unchecked: true, ..mild() }),
        ("failing writes", Cruelty { failing: 0.2, ..mild() }),
        ("fast clock", Cruelty { clock_rate: 0.02, ..mild() }),
        ("slow clock", Cruelty { clock_rate: -0.3, ..mild() }),
        ("clock that jumps", Cruelty { clock_jumps: 5.0, ..mild() }),
        ("silent", troubled(Trouble::Silent)),
        ("deaf", troubled(Trouble::Deaf)),
        ("deaf, but told", Cruelty { latches: true, ..troubled(Trouble::Deaf) }),
        ("nonsense", troubled(Trouble::Nonsense)),
        ("let go", troubled(Trouble::LetsGo)),
        ("wrong units", troubled(Trouble::Millimetres)),
        ("unplugged", troubled(Trouble::Unplugged)),
        ("loop stalls", troubled(Trouble::LoopStalls)),
        ("pump stalls", troubled(Trouble::PumpStalls)),
        ("all", all()),
        ("lossy, slow loop", Cruelty { lost: 0.3, left_out: 2, ..mild() }),
        ("all, slow loop", Cruelty { left_out: 2, ..all() }),
    ]
}

fn all() -> Cruelty {
    Cruelty {
        jitter: 1.5e-3,
        lost: 0.05,
        doubled: 0.1,
        overtaken: 0.02,
        cut: 0.02,
        flipped: 0.05,
        failing: 0.02,
        clock_rate: 5e-3,
        clock_jumps: 1.0,
        troubles: vec![
            Trouble::Silent,
            Trouble::Deaf,
            Trouble::Millimetres,
            Trouble::Nonsense,
            Trouble::Unplugged,
            Trouble::LetsGo,
            Trouble::LoopStalls,
            Trouble::PumpStalls,
        ],
        ..mild()
    }
}

/// In real time, the device's pump in its own thread, with two threads that keep the processor busy.
fn in_real_time(cruelty: &Cruelty, seed: u64) -> Outcome {
    let mut wire = CruelWire::new(cruelty.clone(), Sabotage::default(), seed, SECONDS, SLEW);
    wire.run();
    let other = wire.clone();
    let device = wire.link().spawn(move || other.open()).expect("a thread");
    let mut rig = Rig::new(wire, Box::new(device), PERIOD);
    let ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !ended.load(Ordering::Acquire) {
                    std::hint::spin_loop();
                }
            });
        }
        let rendered = scope.spawn(|| {
            set_up(Role::Haptic);
            rig.render();
            rig
        });
        let rig = rendered.join();
        ended.store(true, Ordering::Release);
        let mut rig = rig.expect("no panic of the loop");
        rig.device.close().expect("a device");
        std::thread::sleep(Duration::from_millis(100));
        rig.outcome()
    })
}

const SEEDS: u64 = 5;

/// The hand goes no faster: its path asks for 0.05 m/s.
const FASTEST: f64 = 0.8;

#[test]
fn no_cruelty_in_lockstep_hurts_the_hand() {
    for (name, cruelty) in cruelties() {
        for seed in 1..=SEEDS {
            let Outcome { findings, broken, invariants, .. } = lockstep(&cruelty, Sabotage::default(), seed);
            assert_eq!(broken, 0, "{name}, seed {seed}: {invariants}");
            assert!(findings.broken.is_empty(), "{name}, seed {seed}: {:?}", findings.broken);
            assert!(findings.fastest < FASTEST, "{name}, seed {seed}: {} m/s", findings.fastest);
            // What is wrong, but what a hand could have done, moves the object from the hand.
            let wrong = [Trouble::Millimetres, Trouble::Nonsense];
            let stays = !wrong.iter().any(|trouble| cruelty.troubles.contains(trouble));
            let felt = if stays { findings.force.z } else { findings.most };
            assert!(felt > 0.5, "{name}, seed {seed}: {felt} N from the floor");
        }
    }
}

/// A device whose loop is not told of withheld wrenches.
struct Unheard<D>(D);

impl<D: HapticDevice> HapticDevice for Unheard<D> {
    fn specification(&self) -> &Specification {
        self.0.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        self.0.read(now).map(|state| DeviceState { status: Status::OK, ..state })
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        self.0.write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.0.close()
    }
}

/// Without any cruelty nothing is withheld, and the floor is felt.
#[test]
fn a_mild_wire_is_felt_without_a_fault() {
    let Outcome { findings, events, .. } = lockstep(&mild(), Sabotage::default(), 1);
    assert_eq!(
        (findings.dropouts, events.withheld, events.device_refused, events.device_jumped),
        (0, 0, 0, 0)
    );
    assert!(findings.most > 1.0 && findings.force.z > 1.0, "{} N, {} N", findings.most, findings.force);
}

/// Of a device that lets go by itself the host knows only what it is told.
#[test]
fn a_force_that_the_device_let_go_of_comes_up_from_nothing_where_it_tells() {
    let deaf = Cruelty { troubles: vec![Trouble::Deaf], ..mild() };
    let regained = |latches| {
        let cruelty = Cruelty { latches, ..deaf.clone() };
        let runs = (1..=SEEDS).map(|seed| lockstep(&cruelty, Sabotage::default(), seed).findings.regained);
        runs.fold(0.0, f64::max)
    };
    assert_eq!(regained(true), 0.0);
    // The test can tell: without being told, the host goes on as before.
    assert!(regained(false) > 0.5);
}

/// The watch at the hand sees what a host or a device does wrong.
#[test]
fn the_watch_sees_what_is_wrong() {
    let broken = |trouble, sabotage| {
        let cruelty = Cruelty { troubles: vec![trouble], ..mild() };
        let runs = (1..=3).map(|seed| lockstep(&cruelty, sabotage, seed).findings.broken);
        runs.flat_map(BTreeMap::into_keys).collect::<BTreeSet<_>>()
    };
    let stubborn = Sabotage { stubborn: true, ..Sabotage::default() };
    let seen = broken(Trouble::Silent, stubborn);
    assert!(seen.contains("long after the last report"), "{seen:?}");
    let seen = broken(Trouble::LoopStalls, stubborn);
    assert!(seen.contains("long after the last step"), "{seen:?}");
    let seen = broken(Trouble::Silent, Sabotage { hundredfold: true, ..Sabotage::default() });
    assert!(seen.contains("grows faster than the slew") && seen.contains("above the peak"), "{seen:?}");
    let deaf_loop = Cruelty { lost: 0.3, ..mild() };
    let unheard = |seed| {
        lockstep_with(&deaf_loop, Sabotage::default(), seed, |device| Box::new(Unheard(device)))
            .findings
            .broken
    };
    let seen: BTreeSet<_> = (1..=3).flat_map(|seed| unheard(seed).into_keys()).collect();
    assert!(seen.contains("grows faster than the slew"), "{seen:?}");
    let seen = broken(Trouble::PumpStalls, Sabotage { keeps: true, ..Sabotage::default() });
    assert!(seen.contains("kept by the device"), "{seen:?}");
}

/// What depends on how late the machine is, is told only.
#[test]
#[allow(clippy::print_stdout)] // Says what was measured.
fn no_cruelty_in_real_time_hurts_the_hand() {
    // The host cannot know that the device hears nothing; and its threads stall as the machine lets them.
    let untold = [Trouble::Deaf, Trouble::LoopStalls, Trouble::PumpStalls];
    let mut cruel = all();
    cruel.troubles.retain(|trouble| !untold.contains(trouble));
    for (name, cruelty) in [("mild", mild()), ("all", cruel)] {
        let Outcome { findings, events, broken, invariants } = in_real_time(&cruelty, 1);
        let [age, gap] = [&findings.ages, &findings.gaps].map(|times| times.percentiles(1e6));
        println!(
            "{name}: wrenches {:.2} ms old as they are written in the median, {:.2} ms at 99.9 %; forces {:.2} ms and {:.2} ms apart",
            age.p50, age.p999, gap.p50, gap.p999
        );
        println!(
            "{name}: {} dropouts, most {} N, {events:?}, {:?}",
            findings.dropouts, findings.most, findings.broken
        );
        assert_eq!(broken, 0, "{name}: {invariants}");
        for what in ["not finite", "above the peak", "a hand that is nowhere"] {
            assert!(!findings.broken.contains_key(what), "{name}: {:?}", findings.broken);
        }
        assert_eq!(findings.force, DVec3::ZERO, "{name}: at the end");
        assert!(findings.taken > 100, "{name}: {} forces reached the device", findings.taken);
        let faults = events.withheld
            + events.device_refused
            + events.device_jumped
            + events.late
            + events.runaway
            + events.energy_created
            + events.step_refused;
        assert!(findings.dropouts <= faults, "{name}: {} dropouts, {faults} faults", findings.dropouts);
    }
}
