//! Devices that are reached through their makers' libraries: Force Dimension's, 3D Systems' and Haption's.
//!
//! The libraries are loaded when a device is opened, and never linked: palpate builds and runs without them.
//! Each is a [`Transport`](crate::link::Transport) whose reports carry the results of its calls, so that its
//! device is a [`Link`](crate::link::Link); all use one report format ([`SdkCodec`]). All calls, the first
//! included, are made in the pump's thread, except those of OpenHaptics that must be made in its scheduler's
//! thread. They are limited to 4,000 rounds a second. A device whose calls fail four times in a row is
//! released (zero force, force output off, closed), reported as
//! [`DISCONNECTED`](crate::Status::DISCONNECTED), and searched for twice a second.
//!
//! | feature | address | library | axes, as the maker has them |
//! |---|---|---|---|
//! | `force-dimension` | `force-dimension:NUMBER` (the first where it is left out) | `PALPATE_DHD_LIBRARY`, else libdhd or libdrd | x towards the user, y to the right, z up; from the middle of the workspace |
//! | `open-haptics` | `open-haptics:NAME` (the default device where it is left out) | `PALPATE_HD_LIBRARY`, else libHD | x to the right, y up, z towards the user; from the middle of the workspace |
//! | `haption` | `haption:HOST` | `PALPATE_VIRTUOSE_LIBRARY`, else libVirtuoseAPI | those of the base; from where the handle is held when it is opened |
//!
//! Any of these addresses may end in `@FILE`, the library to load:
//! `force-dimension:@/opt/sdk/lib/libdhd.so.3`.
//!
//! Sources:
//!
//! - Signatures, constants and their units: the makers' headers, as public repositories have them (dhdc.h of
//!   SDK 3.7, hd*.h of OpenHaptics 3.0, VirtuoseAPI.h of 4.04).
//! - Public wrappers: millimetres and mN·m of OpenHaptics, its axes and its order of closing; the watchdog's
//!   unit of 125 µs and its expert mode; the modes and the 2 s of Haption's controller; the libraries' names
//!   on Linux and Windows.
//! - General knowledge: Force Dimension's axes, the origins, the threads from which calls may be made, names
//!   on macOS.
//!
//! No unit has been tried with any of them, nor any of the makers' libraries themselves: the tests run
//! against substitute libraries.

#[cfg(any(feature = "force-dimension", feature = "open-haptics", feature = "haption"))]
mod connection;
#[cfg(feature = "force-dimension")]
pub(crate) mod force_dimension;
#[cfg(any(feature = "force-dimension", feature = "open-haptics", feature = "haption"))]
#[expect(unsafe_code, reason = "foreign calls")]
mod foreign;
#[cfg(feature = "haption")]
pub(crate) mod haption;
mod library;
mod motion;
#[cfg(feature = "open-haptics")]
pub(crate) mod open_haptics;
#[cfg(any(feature = "force-dimension", feature = "open-haptics"))]
mod orientation;
#[cfg(any(feature = "force-dimension", feature = "haption"))]
mod pace;
mod report;

pub use library::SdkLibrary;
pub use motion::SdkMotion;
pub use report::{SdkCodec, SdkState, wrench_of};
