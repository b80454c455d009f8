//! From the bytes of a device's reports to the force on the hand, over a wire with faults.

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
use palpate_tests::faulty_wire::{Fault, FaultyWire, Findings, HandCodec, HandMotion, Impairments, Sabotage};
use palpate_tests::model;

const PERIOD: f64 = 1e-3;
/// Slew rate of the loop's settings, N/s.
const SLEW: f64 = 200.0;
/// Stiffness of the coupling, N/m: more than would be chosen for a device with this delay.
const STIFFNESS: f64 = 400.0;
/// Depth of a floor of 2 kN/m below the hand's starting place, m.
const FLOOR: f64 = 4e-3;
/// Largest step, in periods; a longer one is cut off.
const MAX_STEP_PERIODS: f64 = 5.0;

/// Host's loop with a device over a faulty wire, and a contact query that finds a floor.
struct Rig {
    wire: FaultyWire,
    haptic: HapticLoop,
    device: Box<dyn HapticDevice>,
    /// Height of the floor, m.
    floor: f64,
    /// Period of the loop, and time of its last step, s.
    period: f64,
    stepped: f64,
}

impl Rig {
    fn new(wire: FaultyWire, device: Box<dyn HapticDevice>, period: f64) -> Self {
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

    /// Returns the contact of the floor under the object's centre of mass.
    fn query(&self, now: f64) -> ContactUpdate {
        let center = self.haptic.body_state().pose;
        let point = center.translation;
        let depth = self.floor - point.z;
        let contact = Contact { point, scene_point: point + DVec3::Z * depth, normal: DVec3::NEG_Z, depth };
        let parameters =
            ContactParameters { stiffness: 2000.0, damping: 20.0, tolerance: 0.0, friction: Friction::NONE };
        let model = LinearContactModel::from_contacts([contact], &center, &parameters, now);
        ContactUpdate::new(model, now, depth, 1)
    }

    fn step(&mut self, now: f64) {
        let dt = (now - self.stepped).min(MAX_STEP_PERIODS * self.period);
        self.stepped = now;
        let update = self.query(now);
        self.haptic.update_contacts(&update);
        self.haptic.step_device(&mut *self.device, now, dt);
        self.wire.note_step();
    }

    /// Steps in real time until the wire's time is over, and lets the wrench fade.
    fn render(&mut self) {
        let start = Instant::now();
        let steps = (SECONDS / PERIOD) as u32;
        let mut tick = 0;
        while tick < steps {
            // Steps that are overdue are skipped.
            tick = (tick + 1).max((start.elapsed().as_secs_f64() / PERIOD) as u32);
            let deadline = start + Duration::from_secs_f64(PERIOD * f64::from(tick));
            std::thread::sleep(deadline.saturating_duration_since(Instant::now()));
            if tick + FADE_STEPS > steps {
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

/// Result of a run.
struct Outcome {
    findings: Findings,
    events: Events,
    /// Violations of the engine's own invariants, as a count and in words.
    broken: u64,
    invariants: String,
}

const SECONDS: f64 = 3.0;
/// Number of steps over which the wrench fades before the end.
const FADE_STEPS: u32 = 60;
/// Time before the loop starts, ms.
const FIRST_STEP_MS: u32 = 20;

/// Runs in simulated time, one millisecond after the other.
fn lockstep(impairments: &Impairments, sabotage: Sabotage, seed: u64) -> Outcome {
    lockstep_with(impairments, sabotage, seed, |device| Box::new(device))
}

/// Runs in simulated time with a wrapped device.
fn lockstep_with(
    impairments: &Impairments,
    sabotage: Sabotage,
    seed: u64,
    wrap: impl Fn(LinkedDevice<HandMotion>) -> Box<dyn HapticDevice>,
) -> Outcome {
    let wire = FaultyWire::new(impairments.clone(), sabotage, seed, SECONDS, SLEW);
    let other = wire.clone();
    let (mut pump, device): (Pump<HandCodec>, _) = wire.link().split(move || other.open());
    // The loop needs a device, which is there from its first report on.
    for tick in 1..=FIRST_STEP_MS {
        wire.advance(PERIOD * f64::from(tick));
        pump.round(PERIOD * f64::from(tick));
    }
    let mut rig = Rig::new(wire, wrap(device), PERIOD * f64::from(impairments.every()));
    for tick in FIRST_STEP_MS + 1..=(SECONDS / PERIOD) as u32 {
        let now = PERIOD * f64::from(tick);
        rig.wire.advance(now);
        if !rig.wire.has(Fault::PumpStalls) {
            pump.round(now);
        }
        if tick % impairments.every() == 0 && !rig.wire.has(Fault::LoopStalls) {
            rig.step(now);
        }
    }
    rig.outcome()
}

/// Returns a wire with the latencies of a good one.
fn mild() -> Impairments {
    Impairments { latency: (3e-4, 5e-4), ..Impairments::default() }
}

fn impairment_cases() -> Vec<(&'static str, Impairments)> {
    let faulty = |fault| Impairments { faults: vec![fault], ..mild() };
    vec![
        ("mild", mild()),
        ("late", Impairments { latency: (3e-3, 3e-3), ..mild() }),
        ("uneven", Impairments { jitter: 2.5e-3, ..mild() }),
        ("lossy", Impairments { lost: 0.3, ..mild() }),
        ("overtaken", Impairments { overtaken: 0.1, ..mild() }),
        ("doubled", Impairments { duplicated: 0.3, ..mild() }),
        ("cut", Impairments { truncated: 0.2, ..mild() }),
        ("flipped", Impairments { flipped: 0.2, ..mild() }),
        ("flipped, unchecked", Impairments { flipped: 0.05, unchecked: true, ..mild() }),
        ("failing writes", Impairments { failing: 0.2, ..mild() }),
        ("fast clock", Impairments { clock_rate: 0.02, ..mild() }),
        ("slow clock", Impairments { clock_rate: -0.3, ..mild() }),
        ("clock that jumps", Impairments { clock_jumps: 5.0, ..mild() }),
        ("silent", faulty(Fault::Silent)),
        ("deaf", faulty(Fault::Deaf)),
        ("deaf, but reported", Impairments { latches: true, ..faulty(Fault::Deaf) }),
        ("nonsense", faulty(Fault::Nonsense)),
        ("let go", faulty(Fault::LetsGo)),
        ("wrong units", faulty(Fault::Millimetres)),
        ("unplugged", faulty(Fault::Unplugged)),
        ("loop stalls", faulty(Fault::LoopStalls)),
        ("pump stalls", faulty(Fault::PumpStalls)),
        ("all", all()),
        ("lossy, slow loop", Impairments { lost: 0.3, skipped: 2, ..mild() }),
        ("all, slow loop", Impairments { skipped: 2, ..all() }),
    ]
}

fn all() -> Impairments {
    Impairments {
        jitter: 1.5e-3,
        lost: 0.05,
        duplicated: 0.1,
        overtaken: 0.02,
        truncated: 0.02,
        flipped: 0.05,
        failing: 0.02,
        clock_rate: 5e-3,
        clock_jumps: 1.0,
        faults: vec![
            Fault::Silent,
            Fault::Deaf,
            Fault::Millimetres,
            Fault::Nonsense,
            Fault::Unplugged,
            Fault::LetsGo,
            Fault::LoopStalls,
            Fault::PumpStalls,
        ],
        ..mild()
    }
}

/// Runs in real time, with the device's pump in its own thread, and two threads that keep the processor busy.
fn in_real_time(impairments: &Impairments, seed: u64) -> Outcome {
    let mut wire = FaultyWire::new(impairments.clone(), Sabotage::default(), seed, SECONDS, SLEW);
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

/// Bound on the hand's speed, m/s: its path asks for 0.05 m/s.
const MAX_HAND_SPEED: f64 = 0.8;

#[test]
fn no_faults_in_lockstep_hurt_the_hand() {
    for (name, impairments) in impairment_cases() {
        for seed in 1..=SEEDS {
            let Outcome { findings, broken, invariants, .. } =
                lockstep(&impairments, Sabotage::default(), seed);
            assert_eq!(broken, 0, "{name}, seed {seed}: {invariants}");
            assert!(findings.broken.is_empty(), "{name}, seed {seed}: {:?}", findings.broken);
            assert!(findings.fastest < MAX_HAND_SPEED, "{name}, seed {seed}: {} m/s", findings.fastest);
            // Wrong positions that a hand could have reached move the object away from the hand.
            let wrong = [Fault::Millimetres, Fault::Nonsense];
            let stays = !wrong.iter().any(|fault| impairments.faults.contains(fault));
            let felt = if stays { findings.force.z } else { findings.most };
            assert!(felt > 0.5, "{name}, seed {seed}: {felt} N from the floor");
        }
    }
}

/// Device whose loop does not learn that wrenches were withheld.
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

/// Without faults nothing is withheld, and the floor is felt.
#[test]
fn a_mild_wire_is_felt_without_a_fault() {
    let Outcome { findings, events, .. } = lockstep(&mild(), Sabotage::default(), 1);
    assert_eq!(
        (findings.dropouts, events.withheld, events.device_refused, events.device_jumped),
        (0, 0, 0, 0)
    );
    assert!(findings.most > 1.0 && findings.force.z > 1.0, "{} N, {} N", findings.most, findings.force);
}

/// The host learns that a device dropped its force only if the device reports it.
#[test]
fn a_force_that_the_device_dropped_comes_up_from_zero_if_it_reports_that() {
    let deaf = Impairments { faults: vec![Fault::Deaf], ..mild() };
    let regained = |latches| {
        let impairments = Impairments { latches, ..deaf.clone() };
        let runs =
            (1..=SEEDS).map(|seed| lockstep(&impairments, Sabotage::default(), seed).findings.regained);
        runs.fold(0.0, f64::max)
    };
    assert_eq!(regained(true), 0.0);
    // Without the report the host goes on as before, so the test would fail.
    assert!(regained(false) > 0.5);
}

/// The checks at the hand detect faults of host and device.
#[test]
fn the_checks_detect_faults_of_host_and_device() {
    let broken = |fault, sabotage| {
        let impairments = Impairments { faults: vec![fault], ..mild() };
        let runs = (1..=3).map(|seed| lockstep(&impairments, sabotage, seed).findings.broken);
        runs.flat_map(BTreeMap::into_keys).collect::<BTreeSet<_>>()
    };
    let repeating = Sabotage { repeats: true, ..Sabotage::default() };
    let seen = broken(Fault::Silent, repeating);
    assert!(seen.contains("long after the last report"), "{seen:?}");
    let seen = broken(Fault::LoopStalls, repeating);
    assert!(seen.contains("long after the last step"), "{seen:?}");
    let seen = broken(Fault::Silent, Sabotage { hundredfold: true, ..Sabotage::default() });
    assert!(seen.contains("grows faster than the slew") && seen.contains("above the peak"), "{seen:?}");
    let deaf_loop = Impairments { lost: 0.3, ..mild() };
    let unheard = |seed| {
        lockstep_with(&deaf_loop, Sabotage::default(), seed, |device| Box::new(Unheard(device)))
            .findings
            .broken
    };
    let seen: BTreeSet<_> = (1..=3).flat_map(|seed| unheard(seed).into_keys()).collect();
    assert!(seen.contains("grows faster than the slew"), "{seen:?}");
    let seen = broken(Fault::PumpStalls, Sabotage { never_drops: true, ..Sabotage::default() });
    assert!(seen.contains("kept by the device"), "{seen:?}");
}

/// Values that depend on the machine's load are only printed.
#[test]
#[allow(clippy::print_stdout)] // Says what was measured.
fn no_faults_in_real_time_hurt_the_hand() {
    // The host cannot know that the device receives nothing, and its threads stall when the machine lets
    // them.
    let undetectable = [Fault::Deaf, Fault::LoopStalls, Fault::PumpStalls];
    let mut random = all();
    random.faults.retain(|fault| !undetectable.contains(fault));
    for (name, impairments) in [("mild", mild()), ("all", random)] {
        let Outcome { findings, events, broken, invariants } = in_real_time(&impairments, 1);
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
        for what in ["not finite", "above the peak", "the hand's speed is not finite"] {
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
