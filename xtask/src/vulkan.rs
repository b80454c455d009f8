//! Makes sure that the GPU tests have a Vulkan driver: on Linux a software one (lavapipe) will do.

use std::path::Path;
use std::process::Command;

use crate::Failure;

/// The Debian and Ubuntu package of Mesa's Vulkan drivers, lavapipe among them; it brings the loader with it.
const PACKAGE: &str = "mesa-vulkan-drivers";

/// Installs a Vulkan driver with apt where none is found and that is allowed.
///
/// # Errors
/// With what to install by hand, when it cannot be done here. Other systems than Linux bring a GPU API of their own.
pub fn ensure_driver() -> Result<(), Failure> {
    if !cfg!(target_os = "linux") || driver_present() {
        return Ok(());
    }
    println!("no Vulkan driver found; installing {PACKAGE}");
    let advice = format!(
        "no Vulkan driver found, and the GPU tests need one. Install a software driver: on Debian and Ubuntu \
         `sudo apt-get install {PACKAGE}`, on Fedora `sudo dnf install {PACKAGE}`, on Arch `sudo pacman -S vulkan-swrast`"
    );
    for arguments in [&["update", "-q"][..], &["install", "-y", "-q", "--no-install-recommends", PACKAGE]] {
        if !apt_get(arguments) {
            return Err(advice.into());
        }
    }
    if driver_present() { Ok(()) } else { Err(advice.into()) }
}

/// Whether a driver manifest lies where the Vulkan loader looks for one.
fn driver_present() -> bool {
    if ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].iter().any(|name| std::env::var_os(name).is_some()) {
        return true;
    }
    ["/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/etc/vulkan/icd.d"].iter().any(|folder| {
        Path::new(folder).read_dir().is_ok_and(|mut entries| {
            entries
                .any(|entry| entry.is_ok_and(|entry| entry.path().extension().is_some_and(|e| e == "json")))
        })
    })
}

/// Runs apt-get, through sudo where that asks for no password; whether it succeeded.
fn apt_get(arguments: &[&str]) -> bool {
    let direct = ("apt-get", &[][..]);
    let through_sudo = ("sudo", &["-n", "apt-get"][..]);
    [direct, through_sudo].iter().any(|(program, prefix)| {
        Command::new(program)
            .args(*prefix)
            .args(arguments)
            .env("DEBIAN_FRONTEND", "noninteractive")
            .status()
            .is_ok_and(|status| status.success())
    })
}
