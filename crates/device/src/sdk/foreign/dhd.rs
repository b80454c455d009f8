//! Calls of Force Dimension's library.

use std::ffi::{c_char, c_int, c_uchar, c_uint};

use palpate_core::Wrench;

use super::{Library, functions, text};
use crate::DeviceError;

functions! {
    Functions: "system";
    fn dhdOpen() -> c_int;
    fn dhdOpenID(c_char) -> c_int;
    fn dhdClose(c_char) -> c_int;
    fn dhdErrorGetLastStr() -> *const c_char;
    fn dhdGetSystemName(c_char) -> *const c_char;
    fn dhdHasWrist(c_char) -> u8;
    fn dhdHasActiveWrist(c_char) -> u8;
    fn dhdEnableForce(c_uchar, c_char) -> c_int;
    fn dhdGetButtonMask(c_char) -> c_uint;
    fn dhdGetPositionAndOrientationFrame(*mut f64, *mut f64, *mut f64, *mut [f64; 3], c_char) -> c_int;
    fn dhdGetLinearVelocity(*mut f64, *mut f64, *mut f64, c_char) -> c_int;
    fn dhdGetAngularVelocityRad(*mut f64, *mut f64, *mut f64, c_char) -> c_int;
    fn dhdSetForceAndTorqueAndGripperForce(f64, f64, f64, f64, f64, f64, f64, c_char) -> c_int;
    optional fn dhdConfigLinearVelocity(c_int, c_int, c_char) -> c_int;
    optional fn dhdConfigAngularVelocity(c_int, c_int, c_char) -> c_int;
    optional fn dhdEnableExpertMode() -> c_int;
    optional fn dhdDisableExpertMode() -> c_int;
    optional fn dhdSetWatchdog(c_uchar, c_char) -> c_int;
    optional fn dhdGetStatus(*mut c_int, c_char) -> c_int;
}

/// Of the status: whether the force is on; the cause for which it was last off, where that is the watchdog; and room for more numbers
/// than any version has.
const FORCE_ON: usize = 5;
const FORCE_OFF_CAUSE: usize = 14;
const WATCHDOG: c_int = 3;
const STATUS: usize = 64;
/// The window of velocities by differences.
const WINDOWING: c_int = 0;

/// A device that is open; dropped, it gets zero force, its force output is disabled, and it is closed.
pub struct Device {
    functions: Functions,
    id: c_char,
}

impl Device {
    /// Opens the first device, or that of a number.
    pub fn open(library: &Library, number: Option<u8>) -> Result<Result<Self, String>, DeviceError> {
        let functions = Functions::resolve(library)?;
        // SAFETY: these take numbers only.
        let id = unsafe {
            match number {
                None => (functions.dhdOpen)(),
                Some(number) => (functions.dhdOpenID)(number as c_char),
            }
        };
        if id < 0 {
            // SAFETY: it gives a text of its own.
            return Ok(Err(unsafe { text((functions.dhdErrorGetLastStr)()) }));
        }
        Ok(Ok(Self { functions, id: id as c_char }))
    }

    /// Make and model.
    pub fn name(&self) -> String {
        // SAFETY: it gives a text of its own.
        unsafe { text((self.functions.dhdGetSystemName)(self.id)) }
    }

    /// Whether the wrist is sensed, and whether it is driven.
    pub fn wrist(&self) -> (bool, bool) {
        // SAFETY: these take numbers only.
        unsafe {
            ((self.functions.dhdHasWrist)(self.id) != 0, (self.functions.dhdHasActiveWrist)(self.id) != 0)
        }
    }

    /// Takes differences over so long a window for velocities, ms, where it may be said.
    pub fn set_window(&self, window: c_int) {
        let Functions { dhdConfigLinearVelocity, dhdConfigAngularVelocity, .. } = self.functions;
        for configure in [dhdConfigLinearVelocity, dhdConfigAngularVelocity].into_iter().flatten() {
            // SAFETY: these take numbers only.
            unsafe { configure(window, WINDOWING, self.id) };
        }
    }

    /// Lets the device disable its force where none is commanded for so long, in 125 µs. Older libraries and devices have no such thing.
    pub fn set_watchdog(&self, time: u8) {
        let Functions { dhdEnableExpertMode, dhdDisableExpertMode, dhdSetWatchdog, .. } = self.functions;
        if let (Some(enable), Some(disable), Some(set)) =
            (dhdEnableExpertMode, dhdDisableExpertMode, dhdSetWatchdog)
        {
            // SAFETY: these take numbers only.
            unsafe {
                enable();
                set(time, self.id);
                disable();
            }
        }
    }

    fn status(&self) -> Option<[c_int; STATUS]> {
        let get = self.functions.dhdGetStatus?;
        let mut status = [0; STATUS];
        // SAFETY: there is room for all numbers of the status.
        let told = unsafe { get(status.as_mut_ptr(), self.id) };
        (told >= 0).then_some(status)
    }

    /// Whether the force is on; where the library does not tell, it is taken to be so.
    pub fn is_force_on(&self) -> bool {
        self.status().is_none_or(|status| status[FORCE_ON] != 0)
    }

    /// Whether the watchdog has disabled the force.
    pub fn is_off_by_watchdog(&self) -> bool {
        self.status().is_some_and(|status| status[FORCE_OFF_CAUSE] == WATCHDOG)
    }

    /// Enables or disables the force. Whether that was done.
    pub fn enable_force(&self, enabled: bool) -> bool {
        // SAFETY: it takes numbers only.
        unsafe { (self.functions.dhdEnableForce)(enabled.into(), self.id) >= 0 }
    }

    /// Position, m, and the rows of the rotation matrix.
    pub fn pose(&self) -> Option<([f64; 3], [[f64; 3]; 3])> {
        let ([mut x, mut y, mut z], mut rows) = ([f64::NAN; 3], [[f64::NAN; 3]; 3]);
        // SAFETY: all pointers are to numbers of ours, nine of them to the matrix.
        let told = unsafe {
            let get = self.functions.dhdGetPositionAndOrientationFrame;
            get(&mut x, &mut y, &mut z, rows.as_mut_ptr(), self.id)
        };
        (told >= 0).then_some(([x, y, z], rows))
    }

    /// m/s.
    pub fn linear_velocity(&self) -> Option<[f64; 3]> {
        self.vector(self.functions.dhdGetLinearVelocity)
    }

    /// rad/s.
    pub fn angular_velocity(&self) -> Option<[f64; 3]> {
        self.vector(self.functions.dhdGetAngularVelocityRad)
    }

    fn vector(
        &self,
        get: unsafe extern "system" fn(*mut f64, *mut f64, *mut f64, c_char) -> c_int,
    ) -> Option<[f64; 3]> {
        let [mut x, mut y, mut z] = [f64::NAN; 3];
        // SAFETY: all pointers are to numbers of ours.
        let told = unsafe { get(&mut x, &mut y, &mut z, self.id) };
        (told >= 0).then_some([x, y, z])
    }

    /// Buttons held down.
    pub fn buttons(&self) -> u32 {
        // SAFETY: it takes a number only.
        unsafe { (self.functions.dhdGetButtonMask)(self.id) }
    }

    /// Asks for a wrench (N, N·m) and no force of the gripper. Whether that was done.
    pub fn set_wrench(&self, wrench: &Wrench) -> bool {
        let (force, torque) = (wrench.force, wrench.torque);
        // SAFETY: it takes numbers only.
        let set = unsafe {
            let set = self.functions.dhdSetForceAndTorqueAndGripperForce;
            set(force.x, force.y, force.z, torque.x, torque.y, torque.z, 0.0, self.id)
        };
        // Above zero it says that a motor is saturated, or that it came early.
        set >= 0
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.set_wrench(&Wrench::ZERO);
        self.enable_force(false);
        // SAFETY: it takes a number only; nobody uses the device after this.
        unsafe { (self.functions.dhdClose)(self.id) };
    }
}
