//! State of the substitute libraries that the tests read and set through their test interfaces: numbers, by
//! index.
#![allow(dead_code, reason = "each uses some")]

/// Set: opening fails, reading fails, writing fails; the scheduler stands still; the force cannot be enabled.
pub const FAILS_TO_OPEN: usize = 0;
pub const FAILS_TO_READ: usize = 1;
pub const FAILS_TO_WRITE: usize = 2;
pub const STANDS_STILL: usize = 3;
/// Set: the wrist is sensed, the wrist is driven.
pub const SENSES_WRIST: usize = 4;
pub const DRIVES_WRIST: usize = 5;
/// Set: the library does not report velocities.
pub const NO_VELOCITY: usize = 6;
/// Buttons held down; set.
pub const BUTTONS: usize = 7;
/// Whether the force is enabled, and why it is not, in the maker's codes.
pub const ENABLED: usize = 8;
pub const OFF_CAUSE: usize = 9;
/// Number of times it was opened, closed and read.
pub const OPENS: usize = 10;
pub const CLOSES: usize = 11;
pub const READS: usize = 12;
/// Number of threads that have made calls, and of calls made where they are not allowed.
pub const CALLERS: usize = 13;
pub const FAULTS: usize = 14;
/// The watchdog's time, and the window for velocities.
pub const WATCHDOG: usize = 15;
pub const WINDOW: usize = 16;
/// Number of the model.
pub const MODEL: usize = 17;
/// Number of the device that was opened; −1 for the first or the default one.
pub const ASKED: usize = 18;
/// Duration of the next read, ms; set.
pub const STALLS: usize = 19;
/// Six components of the last commanded wrench, in the maker's units.
pub const WRENCH: usize = 20;
/// Seven numbers of the pose (position, quaternion x, y, z, w) and six of the velocities, in the maker's
/// units; set.
pub const POSE: usize = 30;
pub const VELOCITY: usize = 40;
pub const COUNT: usize = 64;
