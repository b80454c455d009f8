//! A substitute with the functions of Force Dimension's library that palpate calls, and no device. Positions
//! in m.

#![allow(non_snake_case, clippy::missing_safety_doc)]

mod door;
mod numbers;

use std::ffi::{c_char, c_int, c_uchar, c_uint};
use std::sync::atomic::{AtomicU64, Ordering};

use door::*;
use numbers::*;

const ID: c_char = 5;

/// Records the call; gives whether it may be made and is to succeed.
fn call(id: c_char, fails: usize) -> bool {
    called();
    if id != ID || fake_get(OPENS) - fake_get(CLOSES) != 1.0 {
        count(FAULTS);
    }
    !is(fails)
}

fn code(success: bool) -> c_int {
    if success { 0 } else { -1 }
}

fn open(number: f64) -> c_int {
    called();
    fake_set(ASKED, number);
    if is(FAILS_TO_OPEN) {
        return -1;
    }
    count(OPENS);
    ID.into()
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdOpen() -> c_int {
    open(-1.0)
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdOpenID(id: c_char) -> c_int {
    open(f64::from(id))
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdClose(id: c_char) -> c_int {
    call(id, COUNT - 1);
    count(CLOSES);
    0
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdErrorGetLastStr() -> *const c_char {
    called();
    c"no device found".as_ptr()
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdGetSystemName(id: c_char) -> *const c_char {
    call(id, COUNT - 1);
    if is(DRIVES_WRIST) { c"sigma.7".as_ptr() } else { c"omega.6".as_ptr() }
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdHasWrist(id: c_char) -> bool {
    call(id, COUNT - 1);
    is(SENSES_WRIST)
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdHasActiveWrist(id: c_char) -> bool {
    call(id, COUNT - 1);
    is(DRIVES_WRIST)
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdEnableForce(enabled: c_uchar, id: c_char) -> c_int {
    call(id, COUNT - 1);
    fake_set(ENABLED, f64::from(enabled));
    fake_set(OFF_CAUSE, 0.0);
    0
}

#[unsafe(no_mangle)]
#[cfg(not(lacking))]
pub extern "system" fn dhdGetButtonMask(id: c_char) -> c_uint {
    call(id, COUNT - 1);
    fake_get(BUTTONS) as c_uint
}

#[unsafe(no_mangle)]
pub unsafe extern "system" fn dhdGetPositionAndOrientationFrame(
    x: *mut f64,
    y: *mut f64,
    z: *mut f64,
    matrix: *mut [f64; 3],
    id: c_char,
) -> c_int {
    if !call(id, FAILS_TO_READ) {
        return -1;
    }
    count(READS);
    let stall = fake_get(STALLS);
    fake_set(STALLS, 0.0);
    std::thread::sleep(std::time::Duration::from_secs_f64(stall * 1e-3));
    let columns = columns();
    unsafe {
        (*x, *y, *z) = (fake_get(POSE), fake_get(POSE + 1), fake_get(POSE + 2));
        for row in 0..3 {
            *matrix.add(row) = [columns[0][row], columns[1][row], columns[2][row]];
        }
    }
    0
}

unsafe fn velocity(first: usize, [x, y, z]: [*mut f64; 3], id: c_char) -> c_int {
    if !call(id, FAILS_TO_READ) || is(NO_VELOCITY) {
        return -1;
    }
    unsafe {
        (*x, *y, *z) = (fake_get(first), fake_get(first + 1), fake_get(first + 2));
    }
    0
}

#[unsafe(no_mangle)]
pub unsafe extern "system" fn dhdGetLinearVelocity(
    x: *mut f64,
    y: *mut f64,
    z: *mut f64,
    id: c_char,
) -> c_int {
    unsafe { velocity(VELOCITY, [x, y, z], id) }
}

#[unsafe(no_mangle)]
pub unsafe extern "system" fn dhdGetAngularVelocityRad(
    x: *mut f64,
    y: *mut f64,
    z: *mut f64,
    id: c_char,
) -> c_int {
    unsafe { velocity(VELOCITY + 3, [x, y, z], id) }
}

#[unsafe(no_mangle)]
#[allow(clippy::too_many_arguments)]
pub extern "system" fn dhdSetForceAndTorqueAndGripperForce(
    fx: f64,
    fy: f64,
    fz: f64,
    tx: f64,
    ty: f64,
    tz: f64,
    gripper: f64,
    id: c_char,
) -> c_int {
    if !call(id, FAILS_TO_WRITE) {
        return -1;
    }
    if gripper != 0.0 {
        count(FAULTS);
    }
    [fx, fy, fz, tx, ty, tz].into_iter().enumerate().for_each(|(axis, part)| fake_set(WRENCH + axis, part));
    // The code for a saturated motor.
    2
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdConfigLinearVelocity(window: c_int, mode: c_int, id: c_char) -> c_int {
    fake_set(WINDOW, f64::from(window));
    code(call(id, COUNT - 1) && mode == 0)
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdConfigAngularVelocity(_window: c_int, mode: c_int, id: c_char) -> c_int {
    code(call(id, COUNT - 1) && mode == 0)
}

static EXPERT: AtomicU64 = AtomicU64::new(0);

#[unsafe(no_mangle)]
pub extern "system" fn dhdEnableExpertMode() -> c_int {
    EXPERT.store(1, Ordering::SeqCst);
    0
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdDisableExpertMode() -> c_int {
    EXPERT.store(0, Ordering::SeqCst);
    0
}

#[unsafe(no_mangle)]
pub extern "system" fn dhdSetWatchdog(time: c_uchar, id: c_char) -> c_int {
    if EXPERT.load(Ordering::SeqCst) == 0 {
        return -1;
    }
    fake_set(WATCHDOG, f64::from(time));
    code(call(id, COUNT - 1))
}

#[unsafe(no_mangle)]
pub unsafe extern "system" fn dhdGetStatus(status: *mut c_int, id: c_char) -> c_int {
    unsafe {
        *status.add(5) = fake_get(ENABLED) as c_int;
        *status.add(14) = fake_get(OFF_CAUSE) as c_int;
    }
    code(call(id, COUNT - 1))
}
