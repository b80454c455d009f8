//! State that a device reports at one time.

use std::fmt;
use std::ops::{BitOr, BitOrAssign};

use palpate_core::{Pose, Twist};
use serde::{Deserialize, Serialize};

/// The state of a device's handle at one time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceState {
    /// Driver's time for which the state holds, s: at most the time asked for.
    pub time: f64,
    /// Pose of the handle in the device's axes; finite, the quaternion of unit length.
    pub pose: Pose,
    /// Velocity of the handle's reference point and angular velocity of the handle, device axes; finite.
    pub twist: Twist,
    /// Buttons held down, one bit each, the first button in bit 0.
    pub buttons: u32,
    /// Present conditions, and events since the previous read.
    pub status: Status,
}

/// A set of conditions of a device; empty if all is well.
#[derive(Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Status(u32);

impl Status {
    /// All is well.
    pub const OK: Self = Self(0);
    /// A wrench that is not finite was written; zero was applied in its place.
    pub const WRENCH_REFUSED: Self = Self(1);
    /// The force was clipped to the device's peak.
    pub const FORCE_CLIPPED: Self = Self(1 << 1);
    /// The torque was clipped to the device's peak.
    pub const TORQUE_CLIPPED: Self = Self(1 << 2);
    /// The handle is outside the workspace.
    pub const OUTSIDE_WORKSPACE: Self = Self(1 << 3);
    /// The time asked for was not finite or ran back; the state is that of the latest valid time.
    pub const CLOCK: Self = Self(1 << 4);
    /// Reads were further apart than the device catches up with; the time between was left out.
    pub const GAP: Self = Self(1 << 5);
    /// The prescribed motion has ended; its last pose is held.
    pub const ENDED: Self = Self(1 << 6);
    /// The motion was not finite, or the position was beyond four radii of the workspace; the last valid one
    /// is held.
    pub const HELD: Self = Self(1 << 7);

    /// The device is not connected.
    pub const DISCONNECTED: Self = Self(1 << 8);
    /// The device has not been heard from for too long.
    pub const SILENT: Self = Self(1 << 9);
    /// A report from the device was not understood, and was ignored.
    pub const MALFORMED: Self = Self(1 << 10);
    /// A report could not be written to the device.
    pub const UNWRITTEN: Self = Self(1 << 11);
    /// The wrench is zero: the button that enables it is not held, or the device is not ready (not
    /// calibrated, or without power).
    pub const NOT_ENABLED: Self = Self(1 << 12);

    /// The driver has sent zero instead of the commanded wrench since the previous read; the wrench has to
    /// rise from zero.
    pub const WITHHELD: Self = Self(1 << 13);

    const NAMES: [(Self, &str); 14] = [
        (Self::WRENCH_REFUSED, "wrench refused"),
        (Self::FORCE_CLIPPED, "force clipped"),
        (Self::TORQUE_CLIPPED, "torque clipped"),
        (Self::OUTSIDE_WORKSPACE, "outside the workspace"),
        (Self::CLOCK, "clock ran back or is not finite"),
        (Self::GAP, "time left out"),
        (Self::ENDED, "motion ended"),
        (Self::HELD, "last good motion held"),
        (Self::DISCONNECTED, "not connected"),
        (Self::SILENT, "silent"),
        (Self::MALFORMED, "report not understood"),
        (Self::UNWRITTEN, "report not written"),
        (Self::NOT_ENABLED, "not enabled"),
        (Self::WITHHELD, "wrench withheld"),
    ];

    /// The conditions as bits, for files.
    pub(crate) fn bits(self) -> u32 {
        self.0
    }

    /// The set with these bits; unknown bits are dropped.
    pub(crate) fn from_bits(bits: u32) -> Self {
        Self(bits & Self::NAMES.iter().fold(0, |all, (flag, _)| all | flag.0))
    }

    /// Whether every condition of `other` is in this set.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether all is well.
    pub fn is_ok(self) -> bool {
        self == Self::OK
    }

    /// Names of the conditions in this set.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMES.iter().filter(move |(flag, _)| self.contains(*flag)).map(|&(_, name)| name)
    }
}

impl BitOr for Status {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for Status {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_ok() {
            return f.write_str("ok");
        }
        for (i, name) in self.names().enumerate() {
            if i > 0 {
                f.write_str(", ")?;
            }
            f.write_str(name)?;
        }
        Ok(())
    }
}

impl fmt::Debug for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Status({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_are_distinct_and_named() {
        let all = Status::NAMES.iter().fold(Status::OK, |set, &(flag, _)| set | flag);
        assert_eq!(all.0.count_ones() as usize, Status::NAMES.len());
        assert_eq!((Status::GAP | Status::ENDED).to_string(), "time left out, motion ended");
        assert_eq!(Status::OK.to_string(), "ok");
        assert!(all.contains(Status::CLOCK) && !Status::CLOCK.contains(all));
    }
}
