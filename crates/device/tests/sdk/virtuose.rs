//! A substitute with the functions of Haption's library that palpate calls, and no device. Positions in m.

#![allow(non_snake_case, clippy::missing_safety_doc)]

mod door;
mod numbers;

use std::ffi::{CStr, c_char, c_int, c_void};

use door::*;
use numbers::*;

static CONTEXT: u8 = 0;

fn context() -> *mut c_void {
    (&raw const CONTEXT).cast_mut().cast()
}

fn call(context: *mut c_void, fails: usize) -> c_int {
    called();
    if context != self::context() || fake_get(OPENS) - fake_get(CLOSES) != 1.0 {
        count(FAULTS);
    }
    if is(fails) { -1 } else { 0 }
}

/// Counts a violated condition as a fault.
fn expect(holds: bool) {
    if !holds {
        count(FAULTS);
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn virtOpen(host: *const c_char) -> *mut c_void {
    called();
    if is(FAILS_TO_OPEN) || unsafe { CStr::from_ptr(host) } != c"127.0.0.1#53210" {
        return std::ptr::null_mut();
    }
    count(OPENS);
    context()
}

#[unsafe(no_mangle)]
pub extern "C" fn virtClose(context: *mut c_void) -> c_int {
    let code = call(context, COUNT - 1);
    count(CLOSES);
    code
}

#[unsafe(no_mangle)]
pub extern "C" fn virtGetErrorCode(_: *mut c_void) -> c_int {
    called();
    6
}

#[unsafe(no_mangle)]
pub extern "C" fn virtGetErrorMessage(code: c_int) -> *const c_char {
    called();
    if code == 6 { c"time out".as_ptr() } else { std::ptr::null() }
}

#[unsafe(no_mangle)]
pub extern "C" fn virtSetIndexingMode(context: *mut c_void, mode: c_int) -> c_int {
    expect(mode == 3);
    call(context, COUNT - 1)
}

#[unsafe(no_mangle)]
pub extern "C" fn virtSetForceFactor(context: *mut c_void, factor: f32) -> c_int {
    expect(factor == 1.0);
    call(context, COUNT - 1)
}

#[unsafe(no_mangle)]
pub extern "C" fn virtSetSpeedFactor(context: *mut c_void, factor: f32) -> c_int {
    expect(factor == 1.0);
    call(context, COUNT - 1)
}

#[unsafe(no_mangle)]
pub extern "C" fn virtSetTimeStep(context: *mut c_void, step: f32) -> c_int {
    expect(step == 1e-3);
    call(context, COUNT - 1)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn virtSetBaseFrame(context: *mut c_void, frame: *mut f32) -> c_int {
    expect(unsafe { *frame.cast::<[f32; 7]>() } == [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    call(context, COUNT - 1)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn virtSetObservationFrame(context: *mut c_void, frame: *mut f32) -> c_int {
    expect(unsafe { *frame.cast::<[f32; 7]>() } == [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    call(context, COUNT - 1)
}

#[unsafe(no_mangle)]
pub extern "C" fn virtSetCommandType(context: *mut c_void, kind: c_int) -> c_int {
    expect(kind == 3);
    call(context, COUNT - 1)
}

#[unsafe(no_mangle)]
pub extern "C" fn virtSetPowerOn(context: *mut c_void, power: c_int) -> c_int {
    fake_set(ENABLED, f64::from(power));
    call(context, COUNT - 1)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn virtGetPowerOn(context: *mut c_void, power: *mut c_int) -> c_int {
    unsafe { *power = c_int::from(is(ENABLED)) };
    call(context, FAILS_TO_READ)
}

#[unsafe(no_mangle)]
#[cfg(not(lacking))]
pub unsafe extern "C" fn virtGetPosition(context: *mut c_void, pose: *mut f32) -> c_int {
    count(READS);
    unsafe { *pose.cast::<[f32; 7]>() = several::<7>(POSE).map(|number| number as f32) };
    call(context, FAILS_TO_READ)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn virtGetSpeed(context: *mut c_void, speed: *mut f32) -> c_int {
    unsafe { *speed.cast::<[f32; 6]>() = several::<6>(VELOCITY).map(|number| number as f32) };
    call(context, NO_VELOCITY)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn virtGetButton(context: *mut c_void, number: c_int, state: *mut c_int) -> c_int {
    if !(1..=2).contains(&number) {
        return -1;
    }
    unsafe { *state = c_int::from(fake_get(BUTTONS) as u32 & 1 << number != 0) };
    call(context, FAILS_TO_READ)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn virtSetForce(context: *mut c_void, tensor: *mut f32) -> c_int {
    if call(context, FAILS_TO_WRITE) != 0 {
        return -1;
    }
    let tensor = unsafe { *tensor.cast::<[f32; 6]>() };
    tensor.into_iter().enumerate().for_each(|(axis, part)| fake_set(WRENCH + axis, f64::from(part)));
    0
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn virtGetDeviceID(
    context: *mut c_void,
    model: *mut c_int,
    serial: *mut c_int,
) -> c_int {
    unsafe { (*model, *serial) = (fake_get(MODEL) as c_int, 1234) };
    call(context, COUNT - 1)
}
