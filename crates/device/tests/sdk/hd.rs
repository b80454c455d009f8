//! A substitute with the functions of OpenHaptics' HDAPI that palpate calls, a scheduler, and no device.
//! Positions in mm.

#![allow(non_snake_case, clippy::missing_safety_doc)]

mod door;
mod numbers;

use std::ffi::{CStr, c_char, c_int, c_uint, c_ulong, c_ushort, c_void};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{JoinHandle, ThreadId};
use std::time::Duration;

use door::*;
use numbers::*;

const HANDLE: c_uint = 3;
const SCHEDULED: c_ulong = 11;

#[repr(C)]
pub struct ErrorInfo {
    code: c_uint,
    internal: c_int,
    device: c_uint,
}

type Callback = unsafe extern "system" fn(*mut c_void) -> c_uint;

static RUNNING: AtomicBool = AtomicBool::new(false);
static IN_FRAME: AtomicBool = AtomicBool::new(false);
static SCHEDULER: Mutex<Option<JoinHandle<()>>> = Mutex::new(None);
/// The callback and its data.
static OPERATION: Mutex<Option<(Callback, usize)>> = Mutex::new(None);
/// Id of the scheduler's thread.
static SERVO: Mutex<Option<ThreadId>> = Mutex::new(None);
/// The error on the stack.
static ERROR: AtomicU64 = AtomicU64::new(0);

fn is_servo() -> bool {
    *SERVO.lock().unwrap() == Some(std::thread::current().id())
}

/// Records a call outside the scheduler's frames.
fn host() {
    called();
    if is_servo() {
        count(FAULTS);
    }
}

/// Records a call that must be made in a frame.
fn frame() {
    if !is_servo() || !IN_FRAME.load(Ordering::SeqCst) {
        count(FAULTS);
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "system" fn hdInitDevice(name: *const c_char) -> c_uint {
    host();
    let right = name.is_null() || unsafe { CStr::from_ptr(name) } == c"Left Device";
    fake_set(ASKED, if name.is_null() { -1.0 } else { 1.0 });
    if is(FAILS_TO_OPEN) || !right {
        ERROR.store(0x301, Ordering::SeqCst);
        return u32::MAX;
    }
    count(OPENS);
    HANDLE
}

#[unsafe(no_mangle)]
pub extern "system" fn hdDisableDevice(handle: c_uint) {
    host();
    if handle != HANDLE || RUNNING.load(Ordering::SeqCst) {
        count(FAULTS);
    }
    count(CLOSES);
}

#[unsafe(no_mangle)]
pub extern "system" fn hdMakeCurrentDevice(handle: c_uint) {
    host();
    if handle != HANDLE {
        count(FAULTS);
    }
}

#[unsafe(no_mangle)]
pub extern "system" fn hdBeginFrame(_: c_uint) {
    if !is_servo() || IN_FRAME.swap(true, Ordering::SeqCst) {
        count(FAULTS);
    }
}

#[unsafe(no_mangle)]
pub extern "system" fn hdEndFrame(_: c_uint) {
    frame();
    IN_FRAME.store(false, Ordering::SeqCst);
    if is(FAILS_TO_READ) {
        ERROR.store(0x302, Ordering::SeqCst);
    }
}

#[unsafe(no_mangle)]
pub extern "system" fn hdGetError() -> ErrorInfo {
    let code = ERROR.swap(0, Ordering::SeqCst) as c_uint;
    ErrorInfo { code, internal: -7, device: HANDLE }
}

#[unsafe(no_mangle)]
pub extern "system" fn hdGetErrorString(code: c_uint) -> *const c_char {
    if code == 0x301 { c"HD_DEVICE_ALREADY_INITIATED".as_ptr() } else { c"HD_COMM_ERROR".as_ptr() }
}

#[unsafe(no_mangle)]
pub extern "system" fn hdEnable(capability: c_uint) {
    host();
    if capability == 0x4000 {
        fake_set(ENABLED, 1.0);
    }
}

#[unsafe(no_mangle)]
pub extern "system" fn hdDisable(capability: c_uint) {
    host();
    if capability == 0x4000 {
        fake_set(ENABLED, 0.0);
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "system" fn hdGetIntegerv(name: c_uint, value: *mut c_int) {
    let number = match name {
        0x2000 => {
            frame();
            fake_get(BUTTONS) as c_int
        }
        0x2553 => 6,
        0x2554 if is(DRIVES_WRIST) => 6,
        0x2554 => 3,
        _ => {
            count(FAULTS);
            0
        }
    };
    unsafe { *value = number };
}

#[unsafe(no_mangle)]
pub unsafe extern "system" fn hdGetDoublev(name: c_uint, values: *mut f64) {
    let columns = columns();
    let numbers: Vec<f64> = match name {
        0x2052 => {
            frame();
            count(READS);
            let [x, y, z] = several(POSE);
            let [a, b, c] = columns.map(|[x, y, z]| [x, y, z, 0.0]);
            [a, b, c, [x, y, z, 1.0]].concat()
        }
        0x2051 => {
            frame();
            several::<3>(VELOCITY).to_vec()
        }
        // The peak force of a device may differ from that of its model's name.
        0x2603 => vec![if is(MODEL) { fake_get(MODEL) } else { 7.9 }],
        _ => {
            count(FAULTS);
            vec![]
        }
    };
    numbers.into_iter().enumerate().for_each(|(index, number)| unsafe { *values.add(index) = number });
}

#[unsafe(no_mangle)]
pub extern "system" fn hdGetString(name: c_uint) -> *const c_char {
    match name {
        0x2501 if is(DRIVES_WRIST) => c"PHANTOM Premium 3.0 6DOF".as_ptr(),
        0x2501 => c"Touch".as_ptr(),
        _ => std::ptr::null(),
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "system" fn hdSetDoublev(name: c_uint, values: *const f64) {
    frame();
    let first = match name {
        0x2700 => WRENCH,
        0x2701 if is(DRIVES_WRIST) => WRENCH + 3,
        _ => {
            count(FAULTS);
            return;
        }
    };
    (0..3).for_each(|axis| fake_set(first + axis, unsafe { *values.add(axis) }));
}

#[unsafe(no_mangle)]
pub unsafe extern "system" fn hdScheduleAsynchronous(
    callback: Callback,
    data: *mut c_void,
    _: c_ushort,
) -> c_ulong {
    host();
    let before = OPERATION.lock().unwrap().replace((callback, data as usize));
    if before.is_some() {
        count(FAULTS);
    }
    SCHEDULED
}

#[unsafe(no_mangle)]
pub extern "system" fn hdUnschedule(handle: c_ulong) {
    host();
    if handle != SCHEDULED {
        count(FAULTS);
    }
    *OPERATION.lock().unwrap() = None;
}

#[unsafe(no_mangle)]
pub extern "system" fn hdStartScheduler() {
    host();
    if RUNNING.swap(true, Ordering::SeqCst) {
        count(FAULTS);
        return;
    }
    *SCHEDULER.lock().unwrap() = Some(std::thread::spawn(|| {
        *SERVO.lock().unwrap() = Some(std::thread::current().id());
        while RUNNING.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(1));
            let mut operation = OPERATION.lock().unwrap();
            if let Some((callback, data)) = operation.filter(|_| !is(STANDS_STILL)) {
                let goes_on = unsafe { callback(data as *mut c_void) };
                if goes_on == 0 {
                    *operation = None;
                }
            }
        }
        *SERVO.lock().unwrap() = None;
    }));
}

#[unsafe(no_mangle)]
pub extern "system" fn hdStopScheduler() {
    host();
    RUNNING.store(false, Ordering::SeqCst);
    if let Some(thread) = SCHEDULER.lock().unwrap().take() {
        thread.join().unwrap();
    }
}
