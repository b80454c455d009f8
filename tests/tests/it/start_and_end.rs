//! Ends of sessions, observed from the device. Where a process is killed, stopped or panics, it is one of its
//! own, and the device is at the other end of a socket.

#![allow(clippy::print_stdout, reason = "what was measured")]

use std::env;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use palpate::device::link::{
    Codec, LONGEST_REPORT, Link, Malformed, Motion, Report, Transport, TransportError,
};
use palpate::device::{Axes, DeviceError, DeviceState, Emulation, HapticDevice, Specification, Status, Task};
use palpate::dynamics::{ContactParameters, Friction, LinearContactModel};
use palpate::glam::DVec3;
use palpate::threads::{Role, set_up};
use palpate::{Contact, ContactUpdate, HapticRenderer, Pose, Scene, Settings, Twist, Wrench, explore};
use palpate_tests::model;

/// Names of the environment variables for the folder of the host process's sockets, and for how it ends.
const FOLDER: &str = "PALPATE_TESTS_FOLDER";
const ENDS: &str = "PALPATE_TESTS_ENDS";
/// Message of the host before it ends: no force is that short.
const END_MESSAGE: &[u8] = b"ends";
/// Time for which the device keeps a force without a report from the host.
const DEVICE_TIMEOUT: Duration = Duration::from_millis(50);
const PERIOD: Duration = Duration::from_millis(1);

/// Codec of the handle's position and of the force on it, as three numbers.
#[derive(Default)]
struct Plain;

impl Codec for Plain {
    type Sample = [f64; 3];

    fn decode(&mut self, report: &[u8], sample: &mut [f64; 3]) -> Result<(), Malformed> {
        *sample = numbers(report).ok_or(Malformed)?;
        Ok(())
    }

    fn encode(&mut self, wrench: &Wrench, _: &[f64; 3], say: &mut dyn FnMut(Report)) {
        let bytes = bytes(wrench.force.to_array());
        say(Report::new(&bytes, bytes.len()));
    }
}

impl Motion for Plain {
    type Sample = [f64; 3];

    fn advance(&mut self, sample: &[f64; 3], _: Option<f64>, _: f64) -> (Pose, Twist, u32) {
        (Pose::from_translation(DVec3::from(*sample)), Twist::ZERO, 0)
    }
}

fn bytes(numbers: [f64; 3]) -> Vec<u8> {
    numbers.into_iter().flat_map(f64::to_le_bytes).collect()
}

fn numbers(bytes: &[u8]) -> Option<[f64; 3]> {
    let mut numbers = [0.0; 3];
    let whole = bytes.len() == 24;
    for (number, part) in numbers.iter_mut().zip(bytes.chunks_exact(8)) {
        *number = f64::from_le_bytes(part.try_into().ok()?);
    }
    whole.then_some(numbers)
}

/// Host's end of the socket.
struct Socket(UnixDatagram);

impl Socket {
    fn open(folder: &Path) -> std::io::Result<Self> {
        let path = folder.join("host");
        let _ = std::fs::remove_file(&path);
        let socket = UnixDatagram::bind(path)?;
        socket.connect(folder.join("device"))?;
        Ok(Self(socket))
    }
}

impl Transport for Socket {
    fn read(
        &mut self,
        report: &mut [u8; LONGEST_REPORT],
        patience: Duration,
    ) -> Result<usize, TransportError> {
        let waits = !patience.is_zero();
        let set =
            self.0.set_nonblocking(!waits).and_then(|()| self.0.set_read_timeout(waits.then_some(patience)));
        set.map_err(|_| TransportError::Failed)?;
        Ok(self.0.recv(report).unwrap_or(0))
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        self.0.send(report).map(drop).map_err(|_| TransportError::Failed)
    }
}

fn specification() -> Specification {
    let emulated = Emulation::default().specification;
    Specification {
        name: "at the other end of a socket".into(),
        sensed: Axes::TRANSLATION,
        actuated: Axes::TRANSLATION,
        peak_torque: 0.0,
        continuous_torque: 0.0,
        angular_stiffness: 0.0,
        angular_damping: 0.0,
        handle: None,
        ..emulated
    }
}

/// Not a test: the host process that the tests start. It presses on a floor 5 mm under the hand.
#[test]
#[ignore = "the other tests start it"]
fn host() {
    let (Some(folder), Ok(ends)) = (env::var_os(FOLDER).map(PathBuf::from), env::var(ENDS)) else { return };
    let wire = Socket::open(&folder).expect("the device's socket");
    let own = wire.0.try_clone().expect("a socket");
    let mut wire = Some(wire);
    let link = Link {
        codec: Plain,
        motion: Plain,
        specification: specification(),
        read_timeout: Duration::from_millis(2),
        silence: 0.01,
    };
    let device = link.spawn(move || wire.take().map(|wire| Box::new(wire) as Box<dyn Transport>));
    let device: Box<dyn HapticDevice> = Box::new(device.expect("a thread"));
    let renderer = HapticRenderer::new(model("ellipsoid@500"), Scene::new(), device, Settings::default());
    let (mut haptic, _, mut device) = renderer.expect("a renderer").into_loops();
    let floor = haptic.body_state().pose.translation.z + 5e-3;
    let start = Instant::now();
    let mut last = 0.0;
    set_up(Role::Haptic);
    while start.elapsed() < Duration::from_secs(30) {
        std::thread::sleep(PERIOD);
        let now = start.elapsed().as_secs_f64();
        let pose = haptic.body_state().pose;
        let point = pose.translation;
        let depth = floor - point.z;
        let contact = Contact { point, scene_point: point + DVec3::Z * depth, normal: DVec3::NEG_Z, depth };
        let parameters =
            ContactParameters { stiffness: 2000.0, damping: 20.0, tolerance: 0.0, friction: Friction::NONE };
        let model = LinearContactModel::from_contacts([contact], &pose, &parameters, now);
        haptic.update_contacts(&ContactUpdate::new(model, now, depth, 1));
        haptic.step_device(&mut *device, now, (now - last).min(5e-3));
        last = now;
        if ends == "panics" && now > 1.0 {
            std::panic::set_hook(Box::new(|_| std::thread::sleep(Duration::from_millis(500))));
            own.send(END_MESSAGE).expect("the device hears it");
            panic!("the haptic thread panics, as this test wants");
        }
    }
}

/// Device at the other end of the host's socket, whose hand holds still.
struct Device {
    folder: tempfile::TempDir,
    socket: UnixDatagram,
    host: Child,
    start: Instant,
    /// Time and magnitude (N) of each force.
    forces: Vec<(Duration, f64)>,
    /// Time at which the host announced its end.
    ending: Option<Duration>,
}

impl Device {
    /// Starts a host that presses on the device.
    fn pressed(ends: &str) -> Self {
        // A device keeps time whatever else the machine does.
        set_up(Role::Device);
        let folder = tempfile::tempdir().expect("a folder");
        let socket = UnixDatagram::bind(folder.path().join("device")).expect("a socket");
        socket.set_nonblocking(true).expect("a socket");
        let host = Command::new(env::current_exe().expect("this test"))
            .args(["--exact", "start_and_end::host", "--ignored", "--nocapture"])
            .env(FOLDER, folder.path())
            .env(ENDS, ends)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the host's process");
        let start = Instant::now();
        let mut device = Self { folder, socket, host, start, forces: Vec::new(), ending: None };
        while device.forces.last().is_none_or(|(_, force)| *force < 1.5) {
            assert!(device.start.elapsed() < Duration::from_secs(60), "{:?}", device.forces.last());
            device.pass(Duration::from_millis(10));
        }
        device
    }

    /// Sends the position each millisecond, and takes the forces that arrive.
    fn pass(&mut self, time: Duration) {
        let until = Instant::now() + time;
        while Instant::now() < until {
            // If the host does not read, the newest reports are lost.
            let _ = self.socket.send_to(&bytes([0.0; 3]), self.folder.path().join("host"));
            let mut report = [0; 64];
            while let Ok(length) = self.socket.recv(&mut report) {
                let came = self.start.elapsed();
                match numbers(&report[..length]) {
                    Some(force) => self.forces.push((came, DVec3::from(force).length())),
                    None => self.ending = self.ending.or(Some(came)),
                }
            }
            std::thread::sleep(PERIOD / 2);
        }
    }

    fn signal(&self, name: &str) {
        let kill = Command::new("kill").args([format!("-{name}"), self.host.id().to_string()]).status();
        assert!(kill.expect("kill").success());
    }

    /// Returns time and magnitude of the last force.
    fn last(&self) -> (Duration, f64) {
        *self.forces.last().expect("a force")
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        let _ = self.host.kill();
        let _ = self.host.wait();
    }
}

/// The host repeats its force before a device would drop it, and nothing of a killed process goes on sending.
#[test]
fn a_process_that_is_killed_sends_nothing_more() {
    let mut device = Device::pressed("killed");
    device.pass(Duration::from_millis(500));
    let (_, pressed) = device.last();
    assert!(pressed > 1.5, "{pressed} N");
    device.signal("KILL");
    let killed = device.start.elapsed();
    device.pass(4 * DEVICE_TIMEOUT);
    let (last, _) = device.last();
    let late = last.saturating_sub(killed);
    println!("the last force came {late:?} after the process was killed");
    assert!(late < DEVICE_TIMEOUT, "forces came until {late:?} after it");
}

/// A suspended process does not go on where it was: the force comes up from zero.
#[test]
fn a_process_that_was_suspended_starts_from_zero() {
    let mut device = Device::pressed("killed");
    device.pass(Duration::from_millis(300));
    device.signal("STOP");
    device.pass(Duration::from_millis(100));
    let before = device.forces.len();
    device.pass(Duration::from_millis(400));
    assert_eq!(device.forces.len(), before, "a suspended process sends nothing");
    // The first forces wait in the socket while `kill` ends, so the rise is timed from the signal.
    let resumed = device.start.elapsed();
    device.signal("CONT");
    device.pass(Duration::from_millis(800));
    let (_, first) = device.forces[before];
    println!("{first} N came first");
    assert_eq!(first, 0.0, "N, after it was suspended");
    let peak = specification().peak_force;
    for pair in device.forces[before..].windows(2) {
        let ([(then, last), (now, force)], up) = ([pair[0], pair[1]], pair[1].0 - resumed);
        // It comes up over 200 ms.
        let share = (up.as_secs_f64() / 0.2).min(1.0);
        assert!(force <= peak * share * share * 3.0 + 1e-9, "{force} N after {up:?}");
        let slew = peak / 0.01 * (now - then).as_secs_f64().max(2e-3);
        assert!(force - last <= slew, "{last} to {force} N in {:?}", now - then);
    }
    let (_, pressed) = device.last();
    assert!(pressed > 1.5, "{pressed} N at the end");
}

/// The panic's message may take its time: the pump's watchdog does not wait for it.
#[test]
fn a_haptic_thread_that_panics_leaves_no_force() {
    let mut device = Device::pressed("panics");
    while device.ending.is_none() {
        assert!(device.start.elapsed() < Duration::from_secs(60), "no panic");
        device.pass(Duration::from_millis(10));
    }
    device.pass(Duration::from_millis(300));
    let ending = device.ending.expect("a panic");
    let after: Vec<_> = device.forces.iter().filter(|(came, _)| *came > ending).collect();
    let (zero, _) = after.iter().find(|(_, force)| *force == 0.0).expect("a force of zero");
    let taken = *zero - ending;
    println!("{taken:?} from the panic to no force");
    assert!(taken < Duration::from_millis(50), "{taken:?} from the panic to no force");
    assert!(after.iter().all(|(came, force)| came < zero || *force == 0.0), "it came back: {after:?}");
    assert!(device.host.try_wait().expect("a process").is_none(), "the hook is not done yet");
}

/// Emulated device that keeps the forces written to it.
struct Kept {
    inner: Box<dyn HapticDevice>,
    written: Arc<Mutex<Vec<(Instant, f64)>>>,
}

impl HapticDevice for Kept {
    fn specification(&self) -> &Specification {
        self.inner.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        // The hand stays where it presses.
        let state = self.inner.read(now.min(2.0))?;
        Ok(DeviceState { time: now, status: Status::OK, ..state })
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        self.written.lock().expect("no panic").push((Instant::now(), wrench.force.length()));
        self.inner.write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.inner.close()
    }
}

/// A session that ends while the hand presses fades its force over 50 ms, not at once.
#[test]
fn a_session_in_real_time_fades_at_its_end() {
    let [probe, ball] = ["ellipsoid@500", "golf-ball@5000"].map(model);
    let scene = Scene::new().with(ball, Pose::IDENTITY);
    let path = explore::path(Task::Press, &probe, &scene).expect("a path");
    let inner = Box::new(Emulation::default().open(path).expect("an emulated device"));
    let written = Arc::new(Mutex::new(Vec::with_capacity(10_000)));
    let device = Box::new(Kept { inner, written: written.clone() });
    let renderer = HapticRenderer::new(probe, scene, device, Settings::default()).expect("a renderer");
    let session = renderer.spawn().expect("threads");
    std::thread::sleep(Duration::from_millis(2500));
    let session = session.stop().expect("no panic");
    let written = written.lock().expect("no panic");
    let (end, last) = *written.last().expect("a write");
    assert_eq!(last, 0.0, "N at the end");
    let fading: Vec<_> = written.iter().filter(|(at, _)| end - *at < Duration::from_millis(80)).collect();
    let full = fading[0].1;
    assert!(full > 0.05, "{full} N before the end");
    for pair in fading.windows(2) {
        let (passed, fell) = (pair[1].0 - pair[0].0, pair[0].1 - pair[1].1);
        // The steepest slope of the smooth step is one and a half times its mean.
        let most = full * (1.5 * passed.as_secs_f64().max(1e-3) / 0.05 + 0.05);
        assert!(fell < most, "{fell} N in {passed:?} of {full} N");
    }
    assert_eq!(session.haptic.events.device_refused, 0);
}
