//! hidapi's own path, on a SpaceMouse that umockdev simulates: found, opened, set up, read and lost. Skipped
//! where `umockdev-run` is not installed (`apt-get install umockdev`).

use std::io::Write as _;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use palpate_core::Wrench;
use palpate_device::{DeviceError, HapticDevice as _, Status};

/// Environment variable that is set inside umockdev.
const INSIDE: &str = "PALPATE_INSIDE_UMOCKDEV";

/// Output when everything but the end has passed.
const MOVED: &str = "found, opened, lit, and moved";

/// Number of attempts at the device's disappearance.
const TRIES: usize = 20;

const DEVICE: &str = "\
P: /devices/pci0000:00/0000:00:14.0/usb1/1-1/1-1:1.0/0003:256F:C635.0001/hidraw/hidraw0
N: hidraw0
E: DEVNAME=/dev/hidraw0
E: SUBSYSTEM=hidraw
A: dev=242:0

P: /devices/pci0000:00/0000:00:14.0/usb1/1-1/1-1:1.0/0003:256F:C635.0001
E: SUBSYSTEM=hid
E: HID_ID=0003:0000256F:0000C635
E: HID_NAME=3Dconnexion SpaceMouse Compact
E: HID_PHYS=usb-0000:00:14.0-1/input0
E: HID_UNIQ=
H: report_descriptor=05010908A101C0

P: /devices/pci0000:00/0000:00:14.0/usb1/1-1/1-1:1.0
E: SUBSYSTEM=usb
E: DEVTYPE=usb_interface
A: bInterfaceNumber=00

P: /devices/pci0000:00/0000:00:14.0/usb1/1-1
E: SUBSYSTEM=usb
E: DEVTYPE=usb_device
A: idVendor=256f
A: idProduct=c635
A: manufacturer=3Dconnexion
A: product=SpaceMouse Compact
";

const CONTROLS: &str = "@DEV /dev/hidraw0\nHIDIOCGRDESCSIZE 0 07000000\n";

/// The light is switched on, then the cap is held to the right. Bytes below 32 are written as letters after a
/// `^`; `^` itself is `^``.
fn script() -> String {
    let right = "r 10 ^A^`^A^@^@^@^@\n";
    format!("w 0 ^D^A\n{}", right.repeat(40))
}

#[test]
fn a_device_is_found_opened_read_and_lost() {
    if std::env::var_os(INSIDE).is_some() {
        return inside();
    }
    if Command::new("umockdev-run").arg("--version").output().is_err() {
        let _ = writeln!(std::io::stderr(), "skipped: umockdev-run is not installed");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    };
    let play = || {
        let played = Command::new("umockdev-run")
            .args(["--device", &file("device", DEVICE)])
            .args(["--ioctl", &format!("/dev/hidraw0={}", file("controls", CONTROLS))])
            .args(["--script", &format!("/dev/hidraw0={}", file("script", &script()))])
            .arg("--")
            .arg(std::env::current_exe().unwrap())
            .args(["--exact", "hid_umockdev::a_device_is_found_opened_read_and_lost", "--nocapture"])
            .env(INSIDE, "1")
            .env("TMPDIR", folder.path())
            .output()
            .unwrap();
        String::from_utf8_lossy(&played.stdout).into_owned() + &String::from_utf8_lossy(&played.stderr)
    };
    // The player is ended from inside, so that its own status means nothing. If that comes in the middle of a
    // call, umockdev's preloaded part ends the process inside: then try again.
    for _ in 0..TRIES {
        let said = play();
        assert!(said.contains(MOVED), "{said}");
        if said.contains("1 passed") {
            return;
        }
        assert!(said.contains("libumockdev-preload: Error communicating"), "{said}");
    }
    panic!("umockdev ended the process {TRIES} times");
}

/// The part of the test that runs inside umockdev.
fn inside() {
    let listed = palpate_device::list();
    let found = listed.iter().find(|listing| listing.address == "hid:256f:c635").expect("it is listed");
    assert!(found.description.contains("SpaceMouse Compact"), "{}", found.description);
    assert!(matches!(palpate_device::open("woodenhaptics"), Err(DeviceError::NotConnected { .. })));
    assert!(!Path::new("/dev/hidraw9").exists());

    let mut device = palpate_device::open("spacemouse").unwrap();
    assert_eq!(device.specification().name, "SpaceMouse Compact");
    let start = Instant::now();
    let mut step = || {
        std::thread::sleep(Duration::from_millis(1));
        assert!(start.elapsed() < Duration::from_secs(20), "neither moved nor lost");
        let state = device.read(start.elapsed().as_secs_f64());
        let _ = device.write(&Wrench::ZERO);
        state
    };
    // The script goes on only after the light has been switched on, and at 0.1 m/s.
    while step().expect("it is there").pose.translation.x < 0.01 {}
    let _ = writeln!(std::io::stderr(), "{MOVED}");
    // The device is gone with its player, and cannot be opened again: umockdev would end the process.
    let played = std::env::var_os("UMOCKDEV_DIR").expect("umockdev names its folder");
    std::fs::remove_file(Path::new(&played).join("dev/hidraw0")).unwrap();
    let player = std::os::unix::process::parent_id().to_string();
    assert!(Command::new("kill").args(["-KILL", &player]).status().unwrap().success());
    loop {
        match step() {
            Ok(_) => {}
            Err(DeviceError::Lost { status: Status::DISCONNECTED }) => break,
            Err(error) => panic!("{error}"),
        }
    }
}
