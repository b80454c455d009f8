//! Foreign calls to Haption's library.

use std::ffi::{CStr, c_char, c_int, c_void};

use palpate_core::Wrench;

use super::{Library, functions, text};
use crate::DeviceError;

functions! {
    Functions: "C";
    fn virtOpen(*const c_char) -> *mut c_void;
    fn virtClose(*mut c_void) -> c_int;
    fn virtGetErrorCode(*mut c_void) -> c_int;
    fn virtGetErrorMessage(c_int) -> *const c_char;
    fn virtSetIndexingMode(*mut c_void, c_int) -> c_int;
    fn virtSetForceFactor(*mut c_void, f32) -> c_int;
    fn virtSetSpeedFactor(*mut c_void, f32) -> c_int;
    fn virtSetTimeStep(*mut c_void, f32) -> c_int;
    fn virtSetBaseFrame(*mut c_void, *mut f32) -> c_int;
    fn virtSetObservationFrame(*mut c_void, *mut f32) -> c_int;
    fn virtSetCommandType(*mut c_void, c_int) -> c_int;
    fn virtSetPowerOn(*mut c_void, c_int) -> c_int;
    fn virtGetPowerOn(*mut c_void, *mut c_int) -> c_int;
    fn virtGetPosition(*mut c_void, *mut f32) -> c_int;
    fn virtGetSpeed(*mut c_void, *mut f32) -> c_int;
    fn virtGetButton(*mut c_void, c_int, *mut c_int) -> c_int;
    fn virtSetForce(*mut c_void, *mut f32) -> c_int;
    optional fn virtSetTimeoutValue(*mut c_void, f32) -> c_int;
    optional fn virtGetDeviceID(*mut c_void, *mut c_int, *mut c_int) -> c_int;
}

const COMMAND_TYPE_IMPEDANCE: c_int = 3;
/// Indexing mode in which the offset button moves the workspace, with no force while it is held.
const INDEXING_ALL_FORCE_FEEDBACK_INHIBITION: c_int = 3;
/// Number of button indices that are tried.
const BUTTONS: c_int = 4;

/// An open device. Dropping it sends zero force, switches its power off and closes it.
pub struct Device {
    functions: Functions,
    context: *mut c_void,
    /// Buttons that the device has, one bit each.
    buttons: u32,
}

// SAFETY: a context may be used from any thread, by one at a time, as the maker's examples do; only the owner
// of a `Device` uses it.
unsafe impl Send for Device {}

impl Device {
    /// Opens the device of a controller, for forces renewed every `period` seconds.
    pub fn open(library: &Library, host: &CStr, period: f32) -> Result<Result<Self, String>, DeviceError> {
        let functions = Functions::resolve(library)?;
        // SAFETY: the host's name is zero-terminated and only read.
        let context = unsafe { (functions.virtOpen)(host.as_ptr()) };
        if context.is_null() {
            return Ok(Err(message(&functions, context)));
        }
        let mut device = Self { functions, context, buttons: 0 };
        if !device.set_up(period) {
            return Ok(Err(message(&functions, context)));
        }
        for number in 0..BUTTONS {
            if device.button(number).is_some() {
                device.buttons |= 1 << number;
            }
        }
        Ok(Ok(device))
    }

    /// Sets forces and motion to be unscaled, in the axes of the base.
    fn set_up(&self, period: f32) -> bool {
        let Self { functions, context, .. } = *self;
        let mut base = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        if let Some(set) = functions.virtSetTimeoutValue {
            // SAFETY: the context is open.
            unsafe { set(context, 0.1) };
        }
        // SAFETY: the context is open, and the frames are seven local numbers.
        let set = unsafe {
            (functions.virtSetIndexingMode)(context, INDEXING_ALL_FORCE_FEEDBACK_INHIBITION) == 0
                && (functions.virtSetForceFactor)(context, 1.0) == 0
                && (functions.virtSetSpeedFactor)(context, 1.0) == 0
                && (functions.virtSetTimeStep)(context, period) == 0
                && (functions.virtSetBaseFrame)(context, base.as_mut_ptr()) == 0
                && (functions.virtSetObservationFrame)(context, base.as_mut_ptr()) == 0
                && (functions.virtSetCommandType)(context, COMMAND_TYPE_IMPEDANCE) == 0
        };
        if set {
            // The user can also switch the power on later; whether it is on is checked in each round.
            // SAFETY: the context is open.
            unsafe { (functions.virtSetPowerOn)(context, 1) };
        }
        set
    }

    /// Number of the model, if the library reports it.
    pub fn model(&self) -> Option<c_int> {
        let (mut model, mut serial) = (0, 0);
        // SAFETY: the context is open, and the pointers are to local numbers.
        let code = unsafe { (self.functions.virtGetDeviceID?)(self.context, &mut model, &mut serial) };
        (code == 0).then_some(model)
    }

    /// Position, m, and orientation as a quaternion x, y, z, w.
    pub fn pose(&self) -> Option<[f32; 7]> {
        let mut pose = [f32::NAN; 7];
        // SAFETY: the context is open, and there is room for seven numbers.
        let code = unsafe { (self.functions.virtGetPosition)(self.context, pose.as_mut_ptr()) };
        (code == 0).then_some(pose)
    }

    /// Linear velocity, m/s, and angular velocity, rad/s.
    pub fn speed(&self) -> Option<[f32; 6]> {
        let mut speed = [f32::NAN; 6];
        // SAFETY: the context is open, and there is room for six numbers.
        let code = unsafe { (self.functions.virtGetSpeed)(self.context, speed.as_mut_ptr()) };
        (code == 0).then_some(speed)
    }

    /// Whether the motors have power.
    pub fn is_powered(&self) -> Option<bool> {
        let mut power = 0;
        // SAFETY: the context is open, and the pointer is to a local number.
        let code = unsafe { (self.functions.virtGetPowerOn)(self.context, &mut power) };
        (code == 0).then_some(power != 0)
    }

    /// Buttons held down.
    pub fn buttons(&self) -> u32 {
        let numbers = (0..BUTTONS).filter(|number| self.buttons & 1 << number != 0);
        numbers.fold(0, |held, number| held | u32::from(self.button(number) == Some(true)) << number)
    }

    fn button(&self, number: c_int) -> Option<bool> {
        let mut state = 0;
        // SAFETY: the context is open, and the pointer is to a local number.
        let code = unsafe { (self.functions.virtGetButton)(self.context, number, &mut state) };
        (code == 0).then_some(state != 0)
    }

    /// Commands a wrench (N, N·m); gives whether that succeeded.
    pub fn set_wrench(&self, wrench: &Wrench) -> bool {
        let (force, torque) = (wrench.force.as_vec3(), wrench.torque.as_vec3());
        let mut tensor = [force.x, force.y, force.z, torque.x, torque.y, torque.z];
        // SAFETY: the context is open, and the tensor is six local numbers.
        unsafe { (self.functions.virtSetForce)(self.context, tensor.as_mut_ptr()) == 0 }
    }
}

/// The library's message about its last failure.
fn message(functions: &Functions, context: *mut c_void) -> String {
    // SAFETY: the context is open, or null if opening failed; the text is the library's own.
    unsafe { text((functions.virtGetErrorMessage)((functions.virtGetErrorCode)(context))) }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.set_wrench(&Wrench::ZERO);
        // SAFETY: the context is open, and not used after this.
        unsafe {
            (self.functions.virtSetPowerOn)(self.context, 0);
            (self.functions.virtClose)(self.context);
        }
    }
}
