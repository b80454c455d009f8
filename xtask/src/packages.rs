//! System packages that tests need. On Linux, missing ones are installed with apt where that is possible.
//!
//! The GPU tests need a Vulkan driver; a software driver (lavapipe) suffices. umockdev emulates HID devices,
//! and Xvfb a display: tests that need one report that they were skipped where it is missing.

use std::path::Path;
use std::process::Command;

use crate::Failure;

/// Debian and Ubuntu package of Mesa's Vulkan drivers, lavapipe among them. It depends on the loader.
const VULKAN: &str = "mesa-vulkan-drivers";

/// Debian and Ubuntu packages of a virtual display, and of the libraries that a window loads.
const DISPLAY: [&str; 6] =
    ["xvfb", "libx11-xcb1", "libxcursor1", "libxi6", "libxkbcommon-x11-0", "libxrandr2"];

/// Folders in which the Vulkan loader looks for drivers' manifests; the last is NixOS's.
const MANIFESTS: [&str; 5] = [
    "/usr/share/vulkan/icd.d",
    "/usr/local/share/vulkan/icd.d",
    "/etc/vulkan/icd.d",
    "/usr/local/etc/vulkan/icd.d",
    "/run/opengl-driver/share/vulkan/icd.d",
];

/// Installs a Vulkan driver with apt where none is found.
///
/// # Errors
/// If that fails, with instructions for installing one by hand. Systems other than Linux have a GPU API of
/// their own.
pub fn ensure_vulkan() -> Result<(), Failure> {
    if !cfg!(target_os = "linux") || driver_present() {
        return Ok(());
    }
    println!("no Vulkan driver found; installing {VULKAN}");
    if install(&[VULKAN]) && driver_present() {
        return Ok(());
    }
    Err(format!(
        "no Vulkan driver found, and the GPU tests need one. Install a software driver: on Debian and Ubuntu \
         `sudo apt-get install {VULKAN}`, on Fedora `sudo dnf install {VULKAN} vulkan-loader`, on Arch \
         `sudo pacman -S vulkan-swrast vulkan-icd-loader`, on Alpine `apk add mesa-vulkan-swrast vulkan-loader`. \
         Without one, `cargo test --workspace --exclude palpate-texture-pd` runs the other tests"
    )
    .into())
}

/// Tries to install the programs that emulate devices and displays.
pub fn try_players() {
    for (program, packages, without) in [
        ("umockdev-run", &["umockdev"][..], "the test of devices over hidapi is skipped"),
        ("Xvfb", &DISPLAY, "the test of the window is skipped"),
    ] {
        let present = Command::new(program).arg("-version").output().is_ok();
        if cfg!(target_os = "linux") && !present {
            println!("{program} not found; installing it");
            if !install(packages) {
                println!("without {program} {without}");
            }
        }
    }
}

/// Installs packages with apt-get and returns whether it succeeded.
fn install(packages: &[&str]) -> bool {
    // Where the package lists cannot be updated, the present ones may do.
    apt_get(&["update", "-q"]);
    apt_get(&[&["install", "-y", "-q", "--no-install-recommends"], packages].concat())
}

/// Returns whether the environment names a driver, or a manifest lies where the loader looks for one.
fn driver_present() -> bool {
    if ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].iter().any(|name| std::env::var_os(name).is_some()) {
        return true;
    }
    MANIFESTS.iter().any(|folder| {
        Path::new(folder).read_dir().is_ok_and(|mut entries| {
            entries
                .any(|entry| entry.is_ok_and(|entry| entry.path().extension().is_some_and(|e| e == "json")))
        })
    })
}

/// Runs apt-get as root, or through sudo where that needs no password, and returns whether it succeeded.
fn apt_get(arguments: &[&str]) -> bool {
    let prefix: &[&str] = if is_root() { &[] } else { &["sudo", "-n"] };
    let command = [prefix, &["env", "DEBIAN_FRONTEND=noninteractive", "apt-get"], arguments].concat();
    Command::new(command[0]).args(&command[1..]).status().is_ok_and(|status| status.success())
}

fn is_root() -> bool {
    Command::new("id").arg("-u").output().is_ok_and(|output| output.stdout.trim_ascii() == b"0")
}
