//! HID devices, over USB or Bluetooth.
//!
//! Each kind is a codec and a motion, from which a [`Link`](crate::link::Link) makes a device; hidapi carries
//! the reports.

#[cfg(feature = "hid")]
mod host;
#[cfg(feature = "hid")]
mod pid;
mod space_mouse;
mod udev;
mod wooden_haptics;

#[cfg(feature = "hid")]
pub use host::{PluggedIn, plugged_in};
#[cfg(feature = "hid")]
pub(crate) use host::{open, open_numbered};
#[cfg(feature = "hid")]
pub use pid::{NotPid, PEAK_FORCE, PidCodec, Stick, StickMotion};
pub use space_mouse::{Deflection, RateControl, SpaceMouseCodec};
pub use udev::udev_rules;
pub use wooden_haptics::{EncodedMotion, Encoders, WoodenHapticsCodec, WoodenHapticsModel};

/// Longest HID report that is read or written here, in bytes, with its number.
#[cfg(feature = "hid")]
const LONGEST_HID_REPORT: usize = 65;

/// The drivers of HID devices in this crate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Driver {
    SpaceMouse,
    WoodenHaptics,
}

/// Vendor and product numbers of devices with a driver, with their names.
fn known() -> impl Iterator<Item = (u16, u16, &'static str, Driver)> {
    let caps = space_mouse::KNOWN
        .into_iter()
        .map(|(vendor, product, name)| (vendor, product, name, Driver::SpaceMouse));
    let (vendor, product, name) = wooden_haptics::KNOWN;
    caps.chain([(vendor, product, name, Driver::WoodenHaptics)])
}
