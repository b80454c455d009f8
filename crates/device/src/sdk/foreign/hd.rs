//! Foreign calls to OpenHaptics' HDAPI. Those that read and drive the device are made in its scheduler's
//! thread.

use std::ffi::{CStr, c_char, c_int, c_uint, c_ulong, c_ushort, c_void};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use palpate_core::Wrench;

use super::{Library, functions, text};
use crate::DeviceError;

/// Type of the scheduler's callback.
type Callback = unsafe extern "system" fn(*mut c_void) -> c_uint;

functions! {
    Functions: "system";
    fn hdInitDevice(*const c_char) -> c_uint;
    fn hdDisableDevice(c_uint);
    fn hdMakeCurrentDevice(c_uint);
    fn hdBeginFrame(c_uint);
    fn hdEndFrame(c_uint);
    fn hdGetError() -> ErrorInfo;
    fn hdGetErrorString(c_uint) -> *const c_char;
    fn hdEnable(c_uint);
    fn hdDisable(c_uint);
    fn hdGetIntegerv(c_uint, *mut c_int);
    fn hdGetDoublev(c_uint, *mut f64);
    fn hdGetString(c_uint) -> *const c_char;
    fn hdSetDoublev(c_uint, *const f64);
    fn hdStartScheduler();
    fn hdStopScheduler();
    fn hdScheduleAsynchronous(Callback, *mut c_void, c_ushort) -> c_ulong;
    fn hdUnschedule(c_ulong);
}

/// `HDErrorInfo`.
#[repr(C)]
#[derive(Clone, Copy)]
struct ErrorInfo {
    code: c_uint,
    internal: c_int,
    device: c_uint,
}

const HD_CURRENT_BUTTONS: c_uint = 0x2000;
const HD_CURRENT_VELOCITY: c_uint = 0x2051;
const HD_CURRENT_TRANSFORM: c_uint = 0x2052;
const HD_DEVICE_MODEL_TYPE: c_uint = 0x2501;
const HD_INPUT_DOF: c_uint = 0x2553;
const HD_OUTPUT_DOF: c_uint = 0x2554;
const HD_NOMINAL_MAX_FORCE: c_uint = 0x2603;
const HD_CURRENT_FORCE: c_uint = 0x2700;
const HD_CURRENT_TORQUE: c_uint = 0x2701;
const HD_FORCE_OUTPUT: c_uint = 0x4000;
const HD_DEFAULT_SCHEDULER_PRIORITY: c_ushort = c_ushort::MAX / 2;
const HD_CALLBACK_DONE: c_uint = 0;
const HD_CALLBACK_CONTINUE: c_uint = 1;
const HD_SUCCESS: c_uint = 0;
/// Error codes 0x200 to 0x2ff concern forces: warm motors, or a force beyond the limit. The device continues.
const FORCE_ERRORS: std::ops::Range<c_uint> = 0x200..0x300;
/// Largest number of errors taken off the library's stack at once.
const ERRORS: usize = 16;
/// Number of frames after which a wrench that is not renewed is set to zero.
const RENEWAL_FRAMES: u32 = 10;
/// Longest time that closing waits for the last frame.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(100);

/// Whether a device is open; the process has one scheduler.
static IN_USE: AtomicBool = AtomicBool::new(false);

/// State of the device in one frame of the scheduler.
#[derive(Clone, Copy, Debug, Default)]
pub struct Frame {
    /// Transform, 4 × 4, column by column, mm.
    pub transform: [f64; 16],
    /// Linear velocity, mm/s.
    pub velocity: [f64; 3],
    pub buttons: u32,
    /// Whether the device or the library has failed.
    pub failed: bool,
    /// Whether a wrench timed out and no zero wrench has come since: until then, zero is rendered.
    pub timed_out: bool,
}

/// A wrench to render (N, N·m), and its number.
type Order = (Wrench, u64);

/// Handshake between the frames and the thread that closes the device.
#[derive(Default)]
struct Shutdown {
    requested: AtomicBool,
    done: AtomicBool,
}

/// Data of the scheduler's callback, which owns it once scheduled.
struct Servo {
    functions: Functions,
    handle: c_uint,
    torque: bool,
    published: triple_buffer::Input<Frame>,
    orders: triple_buffer::Output<Order>,
    shutdown: Arc<Shutdown>,
    /// Number of the last order, and frames since it came.
    order: u64,
    age: u32,
    timed_out: bool,
}

/// It is moved to the scheduler's thread.
const _: fn() = || {
    fn sent<T: Send>() {}
    sent::<Servo>();
};

/// An open device whose frames run in the scheduler's thread. Dropping it renders a last frame with zero
/// force, disables the force output, stops the scheduler and closes the device.
pub struct Device {
    functions: Functions,
    handle: c_uint,
    scheduled: c_ulong,
    shutdown: Arc<Shutdown>,
    heard: triple_buffer::Output<Frame>,
    asked: triple_buffer::Input<Order>,
    number: u64,
}

/// Properties of a device as the library reports them.
#[derive(Clone, Debug)]
pub struct Model {
    pub name: String,
    /// Degrees of freedom that are sensed and that are driven.
    pub input: c_int,
    pub output: c_int,
    /// Peak force, N; zero if not reported.
    pub peak_force: f64,
}

/// Claims the scheduler for one device.
struct Claim;

impl Claim {
    fn new() -> Option<Self> {
        (!IN_USE.swap(true, Ordering::AcqRel)).then_some(Self)
    }

    /// Keeps the claim for an open device, which releases it when dropped.
    fn keep(self) {
        std::mem::forget(self);
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        IN_USE.store(false, Ordering::Release);
    }
}

impl Device {
    /// Opens the default device, or the one with this name, and starts its frames.
    pub fn open(
        library: &Library,
        name: Option<&CStr>,
    ) -> Result<Result<(Self, Model), String>, DeviceError> {
        let functions = Functions::resolve(library)?;
        let Some(claim) = Claim::new() else {
            return Ok(Err("another is open in this process, and one may be".into()));
        };
        functions.failure();
        // SAFETY: the name is null or zero-terminated, and only read.
        let handle = unsafe { (functions.hdInitDevice)(name.map_or(std::ptr::null(), CStr::as_ptr)) };
        if let Some(failure) = functions.failure() {
            return Ok(Err(failure));
        }
        let model = functions.model(handle);
        let (published, heard) = triple_buffer::triple_buffer(&Frame::default());
        let (asked, orders) = triple_buffer::triple_buffer(&Order::default());
        let shutdown = Arc::<Shutdown>::default();
        let servo = Box::new(Servo {
            functions,
            handle,
            torque: model.output >= 6,
            published,
            orders,
            shutdown: shutdown.clone(),
            order: 0,
            age: u32::MAX,
            timed_out: false,
        });
        // SAFETY: the callback owns the servo from here on, and frees it in its last frame.
        let scheduled = unsafe {
            (functions.hdEnable)(HD_FORCE_OUTPUT);
            let data = Box::into_raw(servo).cast::<c_void>();
            let scheduled = (functions.hdScheduleAsynchronous)(frame, data, HD_DEFAULT_SCHEDULER_PRIORITY);
            (functions.hdStartScheduler)();
            scheduled
        };
        claim.keep();
        let device = Self { functions, handle, scheduled, shutdown, heard, asked, number: 0 };
        match functions.failure() {
            None => Ok(Ok((device, model))),
            Some(failure) => Ok(Err(failure)),
        }
    }

    /// The newest frame, if there is one since the last call.
    pub fn frame(&mut self) -> Option<Frame> {
        self.heard.update().then(|| *self.heard.output_buffer())
    }

    /// Commands a wrench (N, N·m) for the frames to come.
    pub fn set_wrench(&mut self, wrench: &Wrench) {
        self.number += 1;
        self.asked.write((*wrench, self.number));
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.shutdown.requested.store(true, Ordering::Release);
        let start = Instant::now();
        while !self.shutdown.done.load(Ordering::Acquire) && start.elapsed() < CLOSE_TIMEOUT {
            std::thread::sleep(Duration::from_micros(200));
        }
        // The order is that of the maker's examples. If the frames stopped before their last one, the servo
        // is leaked, since they might still go on.
        // SAFETY: the handles are the library's, and not used after this.
        unsafe {
            (self.functions.hdMakeCurrentDevice)(self.handle);
            (self.functions.hdDisable)(HD_FORCE_OUTPUT);
            (self.functions.hdStopScheduler)();
            (self.functions.hdUnschedule)(self.scheduled);
            (self.functions.hdDisableDevice)(self.handle);
        }
        self.functions.failure();
        drop(Claim);
    }
}

impl Functions {
    /// Clears the library's error stack; gives the text of the last error that does not concern forces.
    fn failure(&self) -> Option<String> {
        // SAFETY: the text that it returns is the library's own.
        self.error().map(|code| unsafe { text((self.hdGetErrorString)(code)) })
    }

    /// As [`failure`](Self::failure), but gives the code.
    fn error(&self) -> Option<c_uint> {
        let mut last = None;
        for _ in 0..ERRORS {
            // SAFETY: the function takes no argument.
            let code = unsafe { (self.hdGetError)() }.code;
            if code == HD_SUCCESS {
                break;
            }
            if !FORCE_ERRORS.contains(&code) {
                last = Some(code);
            }
        }
        last
    }

    fn model(&self, handle: c_uint) -> Model {
        let (mut input, mut output, mut peak_force) = (0, 0, 0.0);
        // SAFETY: the device is open, each pointer is to a local number, and the text is the library's own.
        let name = unsafe {
            (self.hdMakeCurrentDevice)(handle);
            (self.hdGetIntegerv)(HD_INPUT_DOF, &mut input);
            (self.hdGetIntegerv)(HD_OUTPUT_DOF, &mut output);
            (self.hdGetDoublev)(HD_NOMINAL_MAX_FORCE, &mut peak_force);
            text((self.hdGetString)(HD_DEVICE_MODEL_TYPE))
        };
        // Parameters that the library does not report stay zero.
        self.error();
        Model { name, input, output, peak_force }
    }
}

impl Servo {
    /// Reads the device and renders the commanded wrench. It neither allocates, locks nor waits.
    fn step(&mut self) {
        let (wrench, number) = *self.orders.read();
        self.age = if number == self.order { self.age.saturating_add(1) } else { 0 };
        self.order = number;
        // The caller does not know that its wrench timed out: rendering resumes only after a zero wrench.
        self.timed_out = wrench != Wrench::ZERO && (self.timed_out || self.age >= RENEWAL_FRAMES);
        let wrench = if self.timed_out { Wrench::ZERO } else { wrench };
        let frame = Frame { timed_out: self.timed_out, ..self.render(&wrench) };
        self.published.write(frame);
    }

    fn render(&self, wrench: &Wrench) -> Frame {
        let Self { functions, handle, .. } = self;
        let mut frame = Frame { transform: [f64::NAN; 16], velocity: [f64::NAN; 3], ..Frame::default() };
        let mut buttons = 0;
        // Torques are in mN·m.
        let (force, torque) = (wrench.force.to_array(), (wrench.torque * 1e3).to_array());
        // SAFETY: the device is open, and each pointer is to as many local numbers as the parameter has.
        unsafe {
            (functions.hdBeginFrame)(*handle);
            (functions.hdGetDoublev)(HD_CURRENT_TRANSFORM, frame.transform.as_mut_ptr());
            (functions.hdGetDoublev)(HD_CURRENT_VELOCITY, frame.velocity.as_mut_ptr());
            (functions.hdGetIntegerv)(HD_CURRENT_BUTTONS, &mut buttons);
            (functions.hdSetDoublev)(HD_CURRENT_FORCE, force.as_ptr());
            if self.torque {
                (functions.hdSetDoublev)(HD_CURRENT_TORQUE, torque.as_ptr());
            }
            (functions.hdEndFrame)(*handle);
        }
        frame.buttons = buttons as u32;
        frame.failed = functions.error().is_some();
        frame
    }
}

/// One frame of the scheduler.
///
/// # Safety
/// `data` is a servo that was passed to the scheduler with this callback. The scheduler calls this again only
/// after it has returned, and only if it returned [`HD_CALLBACK_CONTINUE`].
unsafe extern "system" fn frame(data: *mut c_void) -> c_uint {
    let servo = data.cast::<Servo>();
    // SAFETY: as the caller guarantees, nothing else accesses it now.
    let now = unsafe { &mut *servo };
    if !now.shutdown.requested.load(Ordering::Acquire) {
        now.step();
        return HD_CALLBACK_CONTINUE;
    }
    now.render(&Wrench::ZERO);
    let shutdown = now.shutdown.clone();
    // SAFETY: it came from a box, and nothing accesses it after this.
    drop(unsafe { Box::from_raw(servo) });
    shutdown.done.store(true, Ordering::Release);
    HD_CALLBACK_DONE
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    /// Functions with what little the frames need: a device at rest that stores its force.
    fn functions() -> Functions {
        static FORCE: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
        extern "system" fn initialise(_: *const c_char) -> c_uint {
            0
        }
        extern "system" fn number(_: c_uint) {}
        extern "system" fn nothing() {}
        extern "system" fn no_error() -> ErrorInfo {
            ErrorInfo { code: HD_SUCCESS, internal: 0, device: 0 }
        }
        extern "system" fn no_text(_: c_uint) -> *const c_char {
            std::ptr::null()
        }
        extern "system" fn no_integer(_: c_uint, _: *mut c_int) {}
        unsafe extern "system" fn force(name: c_uint, to: *mut f64) {
            if name == HD_CURRENT_VELOCITY {
                // SAFETY: there is room for three numbers.
                unsafe { *to = f64::from_bits(FORCE.load(Ordering::Relaxed)) };
            }
        }
        unsafe extern "system" fn keep(name: c_uint, from: *const f64) {
            if name == HD_CURRENT_FORCE {
                // SAFETY: it points to three numbers.
                FORCE.store(unsafe { *from }.to_bits(), Ordering::Relaxed);
            }
        }
        extern "system" fn schedule(_: Callback, _: *mut c_void, _: c_ushort) -> c_ulong {
            0
        }
        extern "system" fn unschedule(_: c_ulong) {}
        Functions {
            hdInitDevice: initialise,
            hdDisableDevice: number,
            hdMakeCurrentDevice: number,
            hdBeginFrame: number,
            hdEndFrame: number,
            hdGetError: no_error,
            hdGetErrorString: no_text,
            hdEnable: number,
            hdDisable: number,
            hdGetIntegerv: no_integer,
            hdGetDoublev: force,
            hdGetString: no_text,
            hdSetDoublev: keep,
            hdStartScheduler: nothing,
            hdStopScheduler: nothing,
            hdScheduleAsynchronous: schedule,
            hdUnschedule: unschedule,
        }
    }

    #[test]
    fn frames_do_not_allocate_and_withdraw_wrenches_that_are_not_renewed() {
        let (published, mut heard) = triple_buffer::triple_buffer(&Frame::default());
        let (mut asked, orders) = triple_buffer::triple_buffer(&Order::default());
        let shutdown = Arc::<Shutdown>::default();
        let servo = Servo {
            functions: functions(),
            handle: 0,
            torque: true,
            published,
            orders,
            shutdown: shutdown.clone(),
            order: 0,
            age: u32::MAX,
            timed_out: false,
        };
        let data = Box::into_raw(Box::new(servo)).cast::<c_void>();
        let mut frames = 0;
        let counted = allocation_counter::measure(|| {
            for number in 1..=100 {
                asked.write((Wrench::new(DVec3::X * 2.0, DVec3::ZERO), 2 * number));
                // SAFETY: the servo belongs to this test and stays alive.
                while unsafe { frame(data) } == HD_CALLBACK_CONTINUE {
                    frames += 1;
                    // The force of the frame before this one.
                    let Frame { velocity: [force, ..], timed_out, .. } = *heard.read();
                    let age = (frames - 1) % 15;
                    let renders = (1..=10).contains(&age) && (frames - 1) / 15 % 2 == 0;
                    assert_eq!(force, if renders { 2.0 } else { 0.0 }, "{frames}");
                    assert_eq!(timed_out, age >= 10 || (frames - 1) / 15 % 2 == 1, "{frames}");
                    if frames % 15 == 0 {
                        break;
                    }
                }
                // After every second timeout, a zero wrench is commanded, and the next wrench is rendered.
                if number % 2 == 0 {
                    asked.write((Wrench::ZERO, 2 * number + 1));
                    // SAFETY: as above.
                    assert_eq!(unsafe { frame(data) }, HD_CALLBACK_CONTINUE);
                    assert!(!heard.read().timed_out);
                }
            }
        });
        assert_eq!((frames, counted.count_total), (1500, 0));
        shutdown.requested.store(true, Ordering::Release);
        // SAFETY: as above; this is the last frame.
        assert_eq!(unsafe { frame(data) }, HD_CALLBACK_DONE);
        assert!(shutdown.done.load(Ordering::Acquire));
    }
}
