//! Devices through makers' libraries, against substitute libraries that are built here with the functions
//! that palpate calls.
#![cfg(all(unix, feature = "force-dimension", feature = "open-haptics", feature = "haption"))]
#![expect(unsafe_code, reason = "the fake libraries' back doors")]

#[path = "sdk/numbers.rs"]
mod numbers;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};
use palpate_device::link::{Codec, LONGEST_REPORT, Malformed, Motion, Report};
use palpate_device::sdk::{SdkCodec, SdkMotion, SdkState, wrench_of};
use palpate_device::{Axes, DeviceError, DeviceState, Emulation, HapticDevice, Status};
use rand::rngs::StdRng;
use rand::{Rng as _, RngExt as _, SeedableRng as _};

use numbers::*;

/// Number of random reports.
const FUZZED: usize = 1_000_000;
/// Timeout for events that take milliseconds, on a machine that others use as well.
const LONG: Duration = Duration::from_secs(20);

/// Builds a library of `tests/sdk`.
fn build(name: &str, options: &[&str], to: &Path) -> PathBuf {
    let file = to.join(format!("{name}{}.so", options.len()));
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/sdk").join(format!("{name}.rs"));
    let compiler = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let mut command = Command::new(compiler);
    command.args(["--edition", "2024", "--crate-type", "cdylib", "--check-cfg", "cfg(lacking)"]);
    let built = command.args(options).arg(source).arg("-o").arg(&file).output().expect("rustc");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    file
}

/// A substitute library and its test interface.
struct Fake {
    library: libloading::Library,
    file: PathBuf,
}

impl Fake {
    fn new(name: &str, to: &Path) -> Self {
        let file = build(name, &[], to);
        // SAFETY: it was built from `tests/sdk`, and does nothing when it is loaded.
        Self { library: unsafe { libloading::Library::new(&file) }.unwrap(), file }
    }

    fn get(&self, index: usize) -> f64 {
        // SAFETY: the type is that of its declaration in `tests/sdk/door.rs`.
        unsafe { (self.library.get::<extern "C" fn(usize) -> f64>("fake_get").unwrap())(index) }
    }

    fn set(&self, index: usize, number: f64) {
        // SAFETY: as above.
        unsafe { (self.library.get::<extern "C" fn(usize, f64)>("fake_set").unwrap())(index, number) }
    }

    fn set_all(&self, first: usize, numbers: &[f64]) {
        numbers.iter().enumerate().for_each(|(index, number)| self.set(first + index, *number));
    }

    fn reset(&self) {
        // SAFETY: as above.
        unsafe { (self.library.get::<extern "C" fn()>("fake_reset").unwrap())() }
    }

    fn has_seen_me(&self) -> bool {
        // SAFETY: as above.
        unsafe { (self.library.get::<extern "C" fn() -> bool>("fake_has_seen_me").unwrap())() }
    }

    fn wrench(&self) -> [f64; 6] {
        std::array::from_fn(|axis| self.get(WRENCH + axis))
    }
}

struct Fakes {
    dhd: Fake,
    hd: Fake,
    virtuose: Fake,
    folder: tempfile::TempDir,
}

/// Each library has one state for the process: tests take turns.
fn fakes() -> MutexGuard<'static, Fakes> {
    static FAKES: LazyLock<Mutex<Fakes>> = LazyLock::new(|| {
        let folder = tempfile::tempdir().unwrap();
        let [dhd, hd, virtuose] = ["dhd", "hd", "virtuose"].map(|name| Fake::new(name, folder.path()));
        Mutex::new(Fakes { dhd, hd, virtuose, folder })
    });
    let fakes = FAKES.lock().unwrap_or_else(PoisonError::into_inner);
    for fake in [&fakes.dhd, &fakes.hd, &fakes.virtuose] {
        fake.reset();
    }
    fakes
}

impl Fakes {
    /// Address of each device, with the unit of its lengths, m, and of its torques, N·m.
    fn each(&self) -> [(&Fake, String, f64, f64); 3] {
        let address = |before: &str, fake: &Fake| format!("{before}@{}", fake.file.display());
        [
            (&self.dhd, address("force-dimension:", &self.dhd), 1.0, 1.0),
            (&self.hd, address("open-haptics:", &self.hd), 1e-3, 1e-3),
            (&self.virtuose, address("haption:127.0.0.1#53210", &self.virtuose), 1.0, 1.0),
        ]
    }
}

/// A device in a loop of 1 kHz.
struct Session {
    device: Box<dyn HapticDevice>,
    start: Instant,
    wrench: Wrench,
}

impl Session {
    fn open(address: &str) -> Self {
        let device = palpate_device::open(address).unwrap_or_else(|error| panic!("{address}: {error}"));
        Self { device, start: Instant::now(), wrench: Wrench::ZERO }
    }

    fn tick(&mut self) -> Result<DeviceState, DeviceError> {
        std::thread::sleep(Duration::from_millis(1));
        let state = self.device.read(self.start.elapsed().as_secs_f64());
        let _ = self.device.write(&self.wrench);
        state
    }

    /// Ticks until a condition holds for the state read.
    fn until(
        &mut self,
        what: &str,
        mut holds: impl FnMut(&Result<DeviceState, DeviceError>) -> bool,
    ) -> DeviceState {
        let start = Instant::now();
        loop {
            let state = self.tick();
            if holds(&state) {
                return state.unwrap_or(DeviceState {
                    time: 0.0,
                    pose: Pose::IDENTITY,
                    twist: Twist::ZERO,
                    buttons: 0,
                    status: Status::OK,
                });
            }
            assert!(start.elapsed() < LONG, "{what} is not seen; last {state:?}");
        }
    }
}

fn near(left: DVec3, right: DVec3) -> bool {
    (left - right).length() < 1e-6
}

/// Whether no thread of a device is left, judged by the name of the pump's thread.
fn no_threads_left() -> bool {
    let names = |task: std::io::Result<std::fs::DirEntry>| {
        std::fs::read_to_string(task.ok()?.path().join("comm")).ok()
    };
    match std::fs::read_dir("/proc/self/task") {
        Ok(tasks) => !tasks.filter_map(names).any(|name| name.starts_with("palpate-device")),
        // Only Linux lists threads.
        Err(_) => true,
    }
}

/// Waits for a condition that soon holds.
fn soon(holds: impl Fn() -> bool) -> bool {
    let start = Instant::now();
    while !holds() && start.elapsed() < LONG {
        std::thread::sleep(Duration::from_micros(100));
    }
    holds()
}

#[test]
fn poses_velocities_and_buttons_come_in_palpates_units() {
    let fakes = fakes();
    let turn = DQuat::from_rotation_z(0.5) * DQuat::from_rotation_x(-0.25);
    for (fake, address, metre, _) in fakes.each() {
        fake.set(SENSES_WRIST, 1.0);
        let at = |place: DVec3| fake.set_all(POSE, &(place / metre).to_array());
        at(DVec3::new(0.01, -0.02, 0.03));
        let mut session = Session::open(&address);
        let first = session.until("a state", Result::is_ok).pose;
        // Haption's origin is where the handle is held when the device is opened.
        let center = if address.starts_with("haption") { DVec3::new(0.01, -0.02, 0.03) } else { DVec3::ZERO };
        assert!(near(first.translation, DVec3::new(0.01, -0.02, 0.03) - center), "{address}: {first:?}");
        assert!(first.rotation.angle_between(DQuat::IDENTITY) < 1e-6);

        let place = DVec3::new(-0.004, 0.05, 0.006);
        at(place);
        fake.set_all(POSE + 3, &turn.to_array());
        fake.set_all(VELOCITY, &(DVec3::new(0.1, -0.2, 0.3) / metre).to_array());
        fake.set_all(VELOCITY + 3, &[1.0, 2.0, -3.0]);
        fake.set(BUTTONS, 2.0);
        let state = session.until("the button", |state| state.as_ref().is_ok_and(|state| state.buttons == 2));
        assert!(near(state.pose.translation, place - center), "{address}: {state:?}");
        assert!(state.pose.rotation.angle_between(turn) < 1e-6, "{address}: {state:?}");
        assert!(near(state.twist.linear, DVec3::new(0.1, -0.2, 0.3)), "{address}: {state:?}");
        if address.starts_with("open-haptics") {
            // Estimated from the handle's rotation, which has stopped.
            session
                .until("rest", |state| state.as_ref().is_ok_and(|state| state.twist.angular == DVec3::ZERO));
        } else {
            assert!(near(state.twist.angular, DVec3::new(1.0, 2.0, -3.0)), "{address}: {state:?}");
        }
        // A library without velocities: they are estimated, and nothing moves.
        if !address.starts_with("open-haptics") {
            fake.set(NO_VELOCITY, 1.0);
            let rest = |state: &Result<DeviceState, DeviceError>| {
                state.as_ref().is_ok_and(|state| state.twist == Twist::ZERO && state.buttons == 2)
            };
            session.until("rest", rest);
        }
        assert_eq!(fake.get(FAULTS), 0.0, "{address}");
    }
}

#[test]
fn wrenches_go_in_the_makers_units_and_are_clipped_to_the_peaks() {
    let fakes = fakes();
    for (fake, address, _, newton_metre) in fakes.each() {
        for all in [false, true] {
            fake.reset();
            fake.set(SENSES_WRIST, 1.0);
            fake.set(DRIVES_WRIST, all.into());
            // Haption's model with three driven axes, and the one with six.
            fake.set(MODEL, if address.starts_with("haption") { if all { 3.0 } else { 1.0 } } else { 0.0 });
            let mut session = Session::open(&address);
            let preset = match (address.split(':').next(), all) {
                (Some("force-dimension"), true) => "sigma.7",
                (Some("force-dimension"), false) => "omega",
                (Some("open-haptics"), true) => "premium-3.0",
                (Some("haption"), true) => "virtuose-6d",
                _ => "touch",
            };
            let known = Emulation::preset(preset).unwrap().specification;
            let specification = session.device.specification().clone();
            assert_eq!(specification.actuated, if all { Axes::ALL } else { Axes::TRANSLATION }, "{address}");
            // The library states 7.9 N for the Phantom.
            let peak = if preset == "premium-3.0" { 7.9 } else { known.peak_force };
            assert_eq!(specification.peak_force, peak, "{address}");
            assert_eq!(specification.peak_torque, if all { known.peak_torque } else { 0.0 }, "{address}");
            session.until("a state", Result::is_ok);

            session.wrench = Wrench::new(DVec3::new(0.5, -1.0, 1.5), DVec3::new(0.01, -0.02, 0.03));
            let torque = if all { session.wrench.torque / newton_metre } else { DVec3::ZERO };
            let arrives = |force: DVec3, torque: DVec3| {
                let [fx, fy, fz, tx, ty, tz] = fake.wrench();
                near(DVec3::new(fx, fy, fz), force) && (DVec3::new(tx, ty, tz) - torque).length() < 1e-5
            };
            let force = session.wrench.force;
            session.until("the wrench", |_| arrives(force, torque));

            session.wrench = Wrench::new(DVec3::Y * 1000.0, DVec3::Z * 1000.0);
            let clipped = session.until("a clipped wrench", |state| {
                state.as_ref().is_ok_and(|state| state.status.contains(Status::FORCE_CLIPPED))
            });
            assert_eq!(clipped.status.contains(Status::TORQUE_CLIPPED), all, "{address}");
            let torque = DVec3::Z * specification.peak_torque / newton_metre;
            session.until("the peak", |_| arrives(DVec3::Y * peak, torque));

            // A wrench that is not finite is refused.
            session.wrench = Wrench::new(DVec3::NAN, DVec3::ZERO);
            session.until("no wrench", |_| fake.wrench() == [0.0; 6]);
            assert_eq!(fake.get(FAULTS), 0.0, "{address}");
        }
    }
}

#[test]
fn closed_or_dropped_it_gets_zero_and_no_power_and_no_thread_is_left() {
    let fakes = fakes();
    for (fake, address, ..) in fakes.each() {
        for drops in [false, true] {
            fake.reset();
            let mut session = Session::open(&address);
            session.wrench = Wrench::new(DVec3::X, DVec3::ZERO);
            session.until("the force", |_| fake.get(WRENCH) == 1.0);
            assert_eq!((fake.get(ENABLED), fake.get(OPENS), fake.get(CLOSES)), (1.0, 1.0, 0.0), "{address}");
            if drops {
                drop(session);
            } else {
                session.device.close().unwrap();
                assert!(matches!(session.tick(), Err(DeviceError::Closed)));
            }
            assert!(soon(|| fake.get(CLOSES) == 1.0 && no_threads_left()), "{address}");
            assert_eq!(
                (fake.wrench(), fake.get(ENABLED), fake.get(OPENS)),
                ([0.0; 6], 0.0, 1.0),
                "{address}"
            );
            // Even opening was not done by the calling thread.
            assert!(!fake.has_seen_me() && fake.get(CALLERS) == 1.0, "{address}: {}", fake.get(CALLERS));
            assert_eq!(fake.get(FAULTS), 0.0, "{address}");
        }
    }
}

/// Failing calls: the device is lost and its force zero, within milliseconds. It comes back when calls
/// succeed again, and then gives no force that was commanded before.
#[test]
fn a_device_whose_calls_fail_is_let_go_and_comes_back() {
    let fakes = fakes();
    for (fake, address, ..) in fakes.each() {
        let mut session = Session::open(&address);
        session.wrench = Wrench::new(DVec3::X, DVec3::ZERO);
        let mut took = Vec::new();
        for round in 0..5 {
            session.until("the force", |_| fake.get(WRENCH) == 1.0);
            let begun = Instant::now();
            fake.set(FAILS_TO_READ, 1.0);
            let mut zero = None;
            session.until("its loss", |state| {
                if fake.get(WRENCH) == 0.0 {
                    zero.get_or_insert(begun.elapsed());
                }
                matches!(state, Err(DeviceError::Lost { status: Status::DISCONNECTED }))
            });
            assert!(soon(|| fake.get(WRENCH) == 0.0 && fake.get(ENABLED) == 0.0), "{address}");
            took.push(zero.unwrap_or_else(|| begun.elapsed()));
            assert!(soon(|| fake.get(CLOSES) == f64::from(round + 1)), "{address}");
            // Nothing is commanded while it is lost.
            assert!(session.device.write(&session.wrench).is_err());
            fake.set(FAILS_TO_READ, 0.0);
            session.until("its return", Result::is_ok);
        }
        took.sort_unstable();
        assert!(took[2] < Duration::from_millis(10), "{address}: {took:?}");
        session.until("the force", |_| fake.get(WRENCH) == 1.0);
        assert_eq!((fake.get(OPENS), fake.get(CLOSES), fake.get(FAULTS)), (6.0, 5.0, 0.0), "{address}");
    }
}

#[test]
fn a_device_that_takes_no_wrench_is_let_go_as_well() {
    let fakes = fakes();
    for (fake, address, ..) in fakes.each() {
        if address.starts_with("open-haptics") {
            // Its frames have one outcome for both.
            continue;
        }
        let mut session = Session::open(&address);
        session.wrench = Wrench::new(DVec3::X, DVec3::ZERO);
        session.until("the force", |_| fake.get(WRENCH) == 1.0);
        fake.set(FAILS_TO_WRITE, 1.0);
        session.until("its loss", |state| {
            matches!(state, Err(DeviceError::Lost { status: Status::DISCONNECTED }))
        });
        assert!(soon(|| fake.get(ENABLED) == 0.0 && fake.get(CLOSES) >= 1.0), "{address}");
        assert_eq!(fake.get(FAULTS), 0.0, "{address}");
    }
}

/// States that are not valid are reported, ignored, and give no force.
#[test]
fn invalid_states_give_no_force() {
    let fakes = fakes();
    for (fake, address, ..) in fakes.each() {
        fake.set(SENSES_WRIST, 1.0);
        let mut session = Session::open(&address);
        session.wrench = Wrench::new(DVec3::X, DVec3::ZERO);
        session.until("the force", |_| fake.get(WRENCH) == 1.0);
        fake.set(POSE + 1, f64::NAN);
        let mut reported = false;
        session.until("silence", |state| {
            reported |= state.as_ref().is_ok_and(|state| state.status.contains(Status::MALFORMED));
            if let Ok(state) = state {
                assert!(state.pose.is_valid() && state.twist.is_finite());
            }
            matches!(state, Err(DeviceError::Lost { status: Status::SILENT }))
        });
        assert!(reported, "{address}");
        assert!(soon(|| fake.get(WRENCH) == 0.0), "{address}");
        fake.set(POSE + 1, 0.0);
        // Not an orientation.
        session.until("its return", Result::is_ok);
        fake.set(POSE + 6, 0.0);
        fake.set(POSE + 3, f64::INFINITY);
        session.until("silence", |state| matches!(state, Err(DeviceError::Lost { status: Status::SILENT })));
        assert!(soon(|| fake.get(WRENCH) == 0.0), "{address}");
    }
}

#[test]
fn calls_are_no_more_than_4000_a_second() {
    let fakes = fakes();
    for (fake, address, ..) in fakes.each() {
        let _session = Session::open(&address);
        let (before, start) = (fake.get(READS), Instant::now());
        std::thread::sleep(Duration::from_millis(500));
        let rate = (fake.get(READS) - before) / start.elapsed().as_secs_f64();
        assert!((50.0..=4040.0).contains(&rate), "{address}: {rate}");
    }
}

#[test]
fn force_dimensions_watchdog_and_window_are_set_and_its_trip_is_undone() {
    let fakes = fakes();
    let fake = &fakes.dhd;
    let mut session = Session::open(&format!("force-dimension:3@{}", fake.file.display()));
    assert_eq!((fake.get(WATCHDOG), fake.get(WINDOW), fake.get(ASKED)), (255.0, 4.0, 3.0));
    // A call that takes long holds up the commands for longer than the watchdog waits, and the device
    // disables its force: by the watchdog (3), or by the user's button (1), which stays so.
    for (cause, enabled) in [(3.0, 1.0), (1.0, 0.0)] {
        session.until("a state", Result::is_ok);
        fake.set(ENABLED, 0.0);
        fake.set(OFF_CAUSE, cause);
        fake.set(STALLS, 40.0);
        assert!(soon(|| fake.get(STALLS) == 0.0));
        let reads = fake.get(READS);
        session.until("more reads", |state| state.is_ok() && fake.get(READS) > reads + 100.0);
        assert_eq!(fake.get(ENABLED), enabled, "{cause}");
    }
    // A force switched off by the button is reported, and zero is commanded until it is on again.
    session.wrench = Wrench::new(DVec3::X, DVec3::ZERO);
    let off = Status::NOT_ENABLED | Status::WITHHELD;
    session.until("that it is off", |state| state.as_ref().is_ok_and(|state| state.status.contains(off)));
    assert_eq!(fake.get(WRENCH), 0.0);
    fake.set(ENABLED, 1.0);
    session.until("the force", |_| fake.get(WRENCH) == 1.0);
    assert_eq!(fake.get(FAULTS), 0.0);
}

#[test]
fn open_haptics_frames_that_stand_still_are_silence_and_closing_does_not_wait_for_them() {
    let fakes = fakes();
    let fake = &fakes.hd;
    let mut session = Session::open(&format!("open-haptics:Left Device@{}", fake.file.display()));
    assert_eq!(fake.get(ASKED), 1.0);
    // The process has one scheduler.
    let second = palpate_device::open(&format!("open-haptics:@{}", fake.file.display()));
    let message = second.err().expect("one is open").to_string();
    assert!(message.contains("another is open in this process"), "{message}");
    session.until("a state", Result::is_ok);
    fake.set(STANDS_STILL, 1.0);
    session.until("silence", |state| matches!(state, Err(DeviceError::Lost { status: Status::SILENT })));
    let start = Instant::now();
    drop(session);
    assert!(start.elapsed() < Duration::from_secs(5));
    assert!(soon(|| fake.get(CLOSES) == 1.0 && no_threads_left()));
    assert_eq!((fake.get(ENABLED), fake.get(FAULTS)), (0.0, 0.0));
    // Another device may be opened now.
    fake.reset();
    Session::open(&format!("open-haptics:@{}", fake.file.display())).until("a state", Result::is_ok);
}

#[test]
fn without_power_a_virtuose_gets_no_force() {
    let fakes = fakes();
    let (fake, address, ..) = &fakes.each()[2];
    let mut session = Session::open(address);
    session.wrench = Wrench::new(DVec3::X, DVec3::ZERO);
    session.until("the force", |_| fake.get(WRENCH) == 1.0);
    fake.set(ENABLED, 0.0);
    session.until("no force", |_| fake.get(WRENCH) == 0.0);
    let off = Status::NOT_ENABLED | Status::WITHHELD;
    session.until("that it is off", |state| state.as_ref().is_ok_and(|state| state.status.contains(off)));
    fake.set(ENABLED, 1.0);
    session.until("the force", |_| fake.get(WRENCH) == 1.0);
}

#[test]
fn missing_libraries_functions_and_devices_are_named() {
    let fakes = fakes();
    let message = |address: &str| palpate_device::open(address).err().expect(address).to_string();
    for (kind, variable) in [
        ("force-dimension:", "PALPATE_DHD_LIBRARY"),
        ("open-haptics:", "PALPATE_HD_LIBRARY"),
        ("haption:127.0.0.1#53210", "PALPATE_VIRTUOSE_LIBRARY"),
    ] {
        let missing = message(&format!("{kind}@/no/such/library.so"));
        assert!(missing.contains("`/no/such/library.so`") && missing.contains(variable), "{missing}");
        let other = message(&format!("{kind}@{}", fakes.folder.path().display()));
        assert!(other.contains(&fakes.folder.path().display().to_string()), "{other}");
    }
    for (name, address, symbol) in [
        ("dhd", "force-dimension:", "dhdGetButtonMask"),
        ("virtuose", "haption:127.0.0.1#53210", "virtGetPosition"),
    ] {
        let file = build(name, &["--cfg", "lacking"], fakes.folder.path());
        let lacking = message(&format!("{address}@{}", file.display()));
        assert!(lacking.contains(symbol) && lacking.contains(&file.display().to_string()), "{lacking}");
    }
    // No device: the error has the library's words.
    for (fake, address, ..) in fakes.each() {
        fake.set(FAILS_TO_OPEN, 1.0);
        let refused = message(&address);
        let words = ["no device found", "HD_DEVICE_ALREADY_INITIATED", "time out"];
        assert!(words.iter().any(|words| refused.contains(words)), "{refused}");
        assert!(soon(no_threads_left), "{address}");
    }
    assert!(
        message("haption:192.168.0.9@").contains("192.168.0.9")
            || message("haption").contains("`haption:HOST`")
    );
    for address in ["force-dimension:left", "force-dimension:128", "haption", "haption:"] {
        assert!(matches!(palpate_device::open(address), Err(DeviceError::Unknown { .. })), "{address}");
    }
}

#[test]
fn the_environment_names_the_library_and_listing_loads_none() {
    let fakes = fakes();
    let variable = "PALPATE_DHD_LIBRARY";
    // SAFETY: all tests that read the environment take turns, and the standard library's own reads lock it.
    unsafe { std::env::set_var(variable, "/no/such/library.so") };
    let listed = palpate_device::list();
    for address in ["force-dimension", "open-haptics", "haption:HOST"] {
        assert!(listed.iter().any(|listing| listing.address == address), "{address}");
    }
    let missing = palpate_device::open("force-dimension").err().expect("no library").to_string();
    assert!(missing.contains("/no/such/library.so"), "{missing}");
    // SAFETY: as above.
    unsafe { std::env::set_var(variable, &fakes.dhd.file) };
    let mut session = Session::open("force-dimension");
    session.until("a state", Result::is_ok);
    assert_eq!((fakes.dhd.get(ASKED), fakes.dhd.get(OPENS)), (-1.0, 1.0));
    // SAFETY: as above.
    unsafe { std::env::remove_var(variable) };
}

fn said(wrench: &Wrench, state: &SdkState) -> Report {
    let mut said = None;
    SdkCodec.encode(wrench, state, &mut |report| assert!(said.replace(report).is_none(), "two reports"));
    said.expect("a report")
}

#[test]
fn reports_are_known_byte_by_byte() {
    let state = SdkState {
        position: [1.0, -2.0, 0.5],
        orientation: [0.0, 0.6, 0.0, 0.8],
        linear: None,
        angular: Some([0.0, 0.25, 0.0]),
        buttons: 0x0102_0304,
        ready: true,
    };
    let mut expected = vec![5, 0, 0, 0, 4, 3, 2, 1];
    for number in [1.0, -2.0, 0.5, 0.0, 0.6, 0.0, 0.8, 0.0, 0.0, 0.0, 0.0, 0.25, 0.0_f64] {
        expected.extend(number.to_bits().to_le_bytes());
    }
    // Two of the numbers by hand.
    assert_eq!(expected[8..16], [0, 0, 0, 0, 0, 0, 0xf0, 0x3f]);
    assert_eq!(expected[16..24], [0, 0, 0, 0, 0, 0, 0, 0xc0]);
    assert_eq!(state.to_report().as_slice(), expected);
    assert!(expected.len() <= LONGEST_REPORT);
    assert_eq!(SdkState::from_report(&expected), Ok(state));
    let mut sample = SdkState::default();
    for (at, byte) in [(0, 8), (3, 1), (15, 0x7f), (14, 0xff), (63, 0)] {
        let mut broken = expected.clone();
        broken[at] = byte;
        if at == 14 {
            broken[15] = 0x7f;
        }
        assert_eq!(SdkCodec.decode(&broken, &mut sample), Err(Malformed), "{at}");
    }
    assert_eq!(SdkCodec.decode(&expected[1..], &mut sample), Err(Malformed));
    assert_eq!(sample, SdkState::default(), "nothing is changed");

    let wrench = Wrench::new(DVec3::new(1.0, 0.0, -2.0), DVec3::new(0.0, 0.5, 0.0));
    let report = said(&wrench, &state);
    let bytes: Vec<u8> = [1.0, 0.0, -2.0, 0.0, 0.5, 0.0_f64].into_iter().flat_map(f64::to_le_bytes).collect();
    assert_eq!((report.bytes(), wrench_of(report.bytes())), (bytes.as_slice(), Ok(wrench)));
    // Not ready: zero.
    assert_eq!(said(&wrench, &SdkState { ready: false, ..state }).bytes(), [0; 48]);
    assert_eq!(wrench_of(&bytes[..47]), Err(Malformed));
    let mut broken = bytes;
    broken[6..8].copy_from_slice(&[0xf8, 0x7f]);
    assert_eq!(wrench_of(&broken), Err(Malformed));
}

#[test]
fn any_reports_give_motion_that_is_finite_or_none() {
    let mut rng = StdRng::seed_from_u64(41);
    let specification = Emulation::default().specification;
    let mut motion = SdkMotion::new(&specification);
    let (mut read, mut sample) = (0, SdkState::default());
    let good =
        SdkState { linear: Some([0.1; 3]), angular: Some([0.2; 3]), ..SdkState::default() }.to_report();
    for i in 0..FUZZED {
        let mut report = good;
        match i % 3 {
            // Noise alone, a few bytes of it, or a number of arbitrary bits.
            0 => rng.fill_bytes(&mut report),
            1 => (0..rng.random_range(1..4)).for_each(|_| {
                let at = rng.random_range(0..report.len());
                report[at] = (rng.next_u32() >> 8) as u8;
            }),
            _ => {
                let at = 8 * rng.random_range(0..report.len() / 8);
                report[at..at + 8].copy_from_slice(&rng.next_u64().to_le_bytes());
            }
        }
        let length = if i % 10 == 0 { rng.random_range(0..=report.len()) } else { report.len() };
        let before = sample;
        if SdkCodec.decode(&report[..length], &mut sample).is_err() {
            assert!(sample == before);
            continue;
        }
        read += 1;
        let (pose, twist, _) = motion.advance(&sample, Some(1e-3 * i as f64), 1e-3 * i as f64);
        assert!(pose.is_valid() && twist.is_finite(), "{i}: {sample:?}");
        // A round trip.
        assert_eq!(SdkState::from_report(&sample.to_report()), Ok(sample), "{i}");
        let force = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1e3..1e3)));
        let wrench = Wrench::new(force, -force);
        let expected = if sample.ready { wrench } else { Wrench::ZERO };
        assert_eq!(wrench_of(said(&wrench, &sample).bytes()), Ok(expected));
    }
    assert!(read > FUZZED / 10, "{read}");
}

/// A velocity that the library does not report is estimated, with the sign and the size of the reported one.
#[test]
fn velocities_that_are_not_reported_are_estimated() {
    let specification = Emulation::preset("touch").unwrap().specification;
    let mut motion = SdkMotion::from_here(&specification);
    let (speed, rate) = (DVec3::new(0.1, 0.0, -0.05), DVec3::new(0.0, 0.7, 0.0));
    let mut last = Twist::ZERO;
    for i in 0..200 {
        let time = 1e-3 * f64::from(i);
        let state = SdkState {
            position: (DVec3::X + speed * time).to_array(),
            orientation: DQuat::from_scaled_axis(rate * time).to_array(),
            ..SdkState::default()
        };
        let (pose, twist, _) = motion.advance(&state, Some(time), time);
        assert!(near(pose.translation, speed * time), "{pose:?}");
        last = twist;
    }
    assert!((last.linear - speed).length() < 1e-3 && (last.angular - rate).length() < 1e-3, "{last:?}");
}
