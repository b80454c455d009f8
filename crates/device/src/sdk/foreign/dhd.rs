//! Foreign calls to Force Dimension's library.

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

/// Indices into the status: whether the force is on, and the reason why it was last switched off; the code of
/// that reason for the watchdog; and a buffer size larger than any version needs.
const FORCE_ON: usize = 5;
const FORCE_OFF_CAUSE: usize = 14;
const WATCHDOG: c_int = 3;
const STATUS: usize = 64;
/// Mode of velocity estimation by differences over a window.
const WINDOWING: c_int = 0;

/// An open device. Dropping it sends zero force, disables the force output and closes it.
pub struct Device {
    functions: Functions,
    id: c_char,
}

impl Device {
    /// Opens the first device, or the one with this number.
    pub fn open(library: &Library, number: Option<u8>) -> Result<Result<Self, String>, DeviceError> {
        let functions = Functions::resolve(library)?;
        // SAFETY: these functions take numbers only.
        let id = unsafe {
            match number {
                None => (functions.dhdOpen)(),
                Some(number) => (functions.dhdOpenID)(number as c_char),
            }
        };
        if id < 0 {
            // SAFETY: the text that it returns is the library's own.
            return Ok(Err(unsafe { text((functions.dhdErrorGetLastStr)()) }));
        }
        Ok(Ok(Self { functions, id: id as c_char }))
    }

    /// Make and model.
    pub fn name(&self) -> String {
        // SAFETY: the text that it returns is the library's own.
        unsafe { text((self.functions.dhdGetSystemName)(self.id)) }
    }

    /// Whether the wrist is sensed, and whether it is driven.
    pub fn wrist(&self) -> (bool, bool) {
        // SAFETY: these functions take numbers only.
        unsafe {
            ((self.functions.dhdHasWrist)(self.id) != 0, (self.functions.dhdHasActiveWrist)(self.id) != 0)
        }
    }

    /// Sets the window for velocities, ms, if the library has that function.
    pub fn set_window(&self, window: c_int) {
        let Functions { dhdConfigLinearVelocity, dhdConfigAngularVelocity, .. } = self.functions;
        for configure in [dhdConfigLinearVelocity, dhdConfigAngularVelocity].into_iter().flatten() {
            // SAFETY: the function takes numbers only.
            unsafe { configure(window, WINDOWING, self.id) };
        }
    }

    /// Sets the time without a command after which the device disables its force, in units of 125 µs. Older
    /// libraries and devices lack this.
    pub fn set_watchdog(&self, time: u8) {
        let Functions { dhdEnableExpertMode, dhdDisableExpertMode, dhdSetWatchdog, .. } = self.functions;
        if let (Some(enable), Some(disable), Some(set)) =
            (dhdEnableExpertMode, dhdDisableExpertMode, dhdSetWatchdog)
        {
            // SAFETY: these functions take numbers only.
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
        // SAFETY: the array has room for every number of the status.
        let code = unsafe { get(status.as_mut_ptr(), self.id) };
        (code >= 0).then_some(status)
    }

    /// Whether the force is on; true if the library does not report it.
    pub fn is_force_on(&self) -> bool {
        self.status().is_none_or(|status| status[FORCE_ON] != 0)
    }

    /// Whether the watchdog has disabled the force.
    pub fn is_off_by_watchdog(&self) -> bool {
        self.status().is_some_and(|status| status[FORCE_OFF_CAUSE] == WATCHDOG)
    }

    /// Enables or disables the force; gives whether that succeeded.
    pub fn enable_force(&self, enabled: bool) -> bool {
        // SAFETY: the function takes numbers only.
        unsafe { (self.functions.dhdEnableForce)(enabled.into(), self.id) >= 0 }
    }

    /// Position, m, and the rows of the rotation matrix.
    pub fn pose(&self) -> Option<([f64; 3], [[f64; 3]; 3])> {
        let ([mut x, mut y, mut z], mut rows) = ([f64::NAN; 3], [[f64::NAN; 3]; 3]);
        // SAFETY: all pointers are to local numbers, the matrix with nine of them.
        let code = unsafe {
            let get = self.functions.dhdGetPositionAndOrientationFrame;
            get(&mut x, &mut y, &mut z, rows.as_mut_ptr(), self.id)
        };
        (code >= 0).then_some(([x, y, z], rows))
    }

    /// Linear velocity, m/s.
    pub fn linear_velocity(&self) -> Option<[f64; 3]> {
        self.vector(self.functions.dhdGetLinearVelocity)
    }

    /// Angular velocity, rad/s.
    pub fn angular_velocity(&self) -> Option<[f64; 3]> {
        self.vector(self.functions.dhdGetAngularVelocityRad)
    }

    fn vector(
        &self,
        get: unsafe extern "system" fn(*mut f64, *mut f64, *mut f64, c_char) -> c_int,
    ) -> Option<[f64; 3]> {
        let [mut x, mut y, mut z] = [f64::NAN; 3];
        // SAFETY: all pointers are to local numbers.
        let code = unsafe { get(&mut x, &mut y, &mut z, self.id) };
        (code >= 0).then_some([x, y, z])
    }

    /// Buttons held down, one bit each.
    pub fn buttons(&self) -> u32 {
        // SAFETY: the function takes a number only.
        unsafe { (self.functions.dhdGetButtonMask)(self.id) }
    }

    /// Commands a wrench (N, N·m) with zero gripper force; gives whether that succeeded.
    pub fn set_wrench(&self, wrench: &Wrench) -> bool {
        let (force, torque) = (wrench.force, wrench.torque);
        // SAFETY: the function takes numbers only.
        let set = unsafe {
            let set = self.functions.dhdSetForceAndTorqueAndGripperForce;
            set(force.x, force.y, force.z, torque.x, torque.y, torque.z, 0.0, self.id)
        };
        // A positive code means that a motor is saturated or that the call came early.
        set >= 0
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.set_wrench(&Wrench::ZERO);
        self.enable_force(false);
        // SAFETY: the function takes a number only; the device is not used after this.
        unsafe { (self.functions.dhdClose)(self.id) };
    }
}
