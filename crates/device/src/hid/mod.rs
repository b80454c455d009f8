//! Devices that speak HID, over USB or Bluetooth.
//!
//! A driver is a [`Codec`] (bytes to a sample and a wrench to bytes; no clock, no system call) and a [`Motion`] (samples to
//! poses and twists). A [`Link`] makes a device of them and of whatever carries their reports ([`Transport`]): hidapi, or a
//! [`FakeWire`] in tests. A driver of one's own needs no more than these.

mod fake;
#[cfg(feature = "hid")]
mod host;
mod link;
mod pid;
mod space_mouse;
mod transport;
mod udev;
mod wooden_haptics;

pub use fake::{FakeTransport, FakeWire, QUEUE};
#[cfg(feature = "hid")]
pub(crate) use host::{Connected, connected, open, open_numbered};
pub use link::{Codec, Link, LinkedDevice, Malformed, Motion, Pump, Report};
pub use pid::{NotPid, PEAK_FORCE, PidCodec, Stick, StickMotion};
pub use space_mouse::{Deflection, RateControl, SpaceMouseCodec};
pub use transport::{LONGEST_REPORT, Transport, TransportError};
pub use udev::udev_rules;
pub use wooden_haptics::{EncodedMotion, Encoders, WoodenHapticsCodec, WoodenHapticsModel};

/// The drivers of HID devices in this crate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Driver {
    SpaceMouse,
    WoodenHaptics,
}

/// Vendor and product numbers that have a driver, with their names.
fn known() -> impl Iterator<Item = (u16, u16, &'static str, Driver)> {
    let caps = space_mouse::KNOWN
        .into_iter()
        .map(|(vendor, product, name)| (vendor, product, name, Driver::SpaceMouse));
    let (vendor, product, name) = wooden_haptics::KNOWN;
    caps.chain([(vendor, product, name, Driver::WoodenHaptics)])
}
