//! Touch, Touch X and Phantom Premium devices through 3D Systems' OpenHaptics (HDAPI).
//!
//! The library reports millimetres and takes torques in mN·m, as public wrappers scale them; other wrappers
//! state the axes. Its angular velocity is that of the gimbal in a frame that no source names: the handle's
//! is estimated from its orientation instead. The header states that a callback which returns `DONE` is not
//! called again. The devices are calibrated with the maker's own tool.
//!
//! The process has one scheduler, and therefore one device. A wrench that is not renewed for 10 frames is set
//! to zero. No source states what the device does if the process ends without closing it.

use std::ffi::CString;
use std::time::{Duration, Instant};

use super::connection::{Address, Failures, open as open_with, specification, write_state};
use super::foreign::Library;
use super::foreign::hd::{Device, Frame, Model};
use super::orientation::orientation;
use super::{SdkLibrary, SdkMotion, SdkState, wrench_of};
use crate::link::{Found, LONGEST_REPORT, Transport, TransportError};
use crate::{Axes, DeviceError, HapticDevice};

const LIBRARY: SdkLibrary = SdkLibrary::OPEN_HAPTICS;
const MAKER: &str = LIBRARY.maker;
/// Time from one frame to the next, s.
const FRAME: f64 = 1e-3;
/// Interval at which the driver checks for a new frame.
const POLL_PERIOD: Duration = Duration::from_micros(100);
/// Metres in a millimetre.
const MILLIMETRE: f64 = 1e-3;

/// Opens the default device, or the one with the name in the address.
pub(crate) fn open(address: Option<&str>) -> Option<Result<Box<dyn HapticDevice>, DeviceError>> {
    let address = Address::parse(address);
    let name = match &address.which {
        None => None,
        Some(name) => Some(CString::new(name.as_str()).ok()?),
    };
    let mut loaded = None;
    let connect = move || {
        let library = match &loaded {
            Some(library) => library,
            None => &*loaded.insert(Library::open(&LIBRARY, address.library.as_deref())?),
        };
        let opened = Device::open(library, name.as_deref())?;
        opened.map(|(device, model)| found(device, &model)).map_err(|reason| DeviceError::NotOpened {
            device: match &address.which {
                Some(name) => format!("the device `{name}` of {MAKER}"),
                None => format!("the default device of {MAKER}"),
            },
            reason,
            remedy: "plug it in, set it up by the maker's tool, and close what else uses it",
        })
    };
    Some(open_with(MAKER, connect))
}

fn found(device: Device, model: &Model) -> Found<SdkMotion> {
    let lower = model.name.to_lowercase();
    let preset = if lower.contains("premium") {
        Some(if lower.contains("3.0") { "premium-3.0" } else { "premium-1.5" })
    } else {
        // The Touch X is stronger than the Touch, whose figures therefore hold for it as well.
        None
    };
    let axes = |all: bool| if all { Axes::ALL } else { Axes::TRANSLATION };
    let name = format!("{MAKER} {}", model.name);
    let (sensed, driven) = (axes(model.input >= 6), axes(model.output >= 6));
    let mut specification = specification(name, preset, sensed, driven, FRAME);
    if model.peak_force > 0.0 {
        specification.peak_force = specification.peak_force.min(model.peak_force);
        specification.continuous_force = specification.continuous_force.min(model.peak_force);
    }
    let motion = SdkMotion::new(&specification);
    let transport = Frames { device, failures: Failures::default() };
    Found { transport: Box::new(transport), specification, motion }
}

struct Frames {
    device: Device,
    failures: Failures,
}

impl Transport for Frames {
    fn read(
        &mut self,
        report: &mut [u8; LONGEST_REPORT],
        timeout: Duration,
    ) -> Result<usize, TransportError> {
        let start = Instant::now();
        let frame = loop {
            match self.device.frame() {
                Some(frame) => break frame,
                None if start.elapsed() >= timeout => return Ok(0),
                None => std::thread::sleep(POLL_PERIOD),
            }
        };
        let state = (!frame.failed).then(|| sdk_state(&frame));
        write_state(state, &mut self.failures, report)
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        let wrench = wrench_of(report).map_err(|_| TransportError::Failed)?;
        self.device.set_wrench(&wrench);
        Ok(())
    }
}

fn sdk_state(frame: &Frame) -> SdkState {
    let column = |index: usize| [0, 1, 2].map(|row| frame.transform[4 * index + row]);
    SdkState {
        position: column(3).map(|part| part * MILLIMETRE),
        orientation: orientation([0, 1, 2].map(column)),
        linear: Some(frame.velocity.map(|part| part * MILLIMETRE)),
        angular: None,
        buttons: frame.buttons,
        ready: !frame.timed_out,
    }
}
