//! Virtuose devices through Haption's library.
//!
//! The library connects to a controller over a network, in metres, newtons and single precision. Pose,
//! velocities and wrench are in the axes of the base, about the middle of the handle. Where the header is not
//! enough, the maker's documentation was read as quoted by public wrappers: the offset button inhibits the
//! force in the indexing mode chosen here, and the controller drops the force and the connection after 2 s
//! without a command. Model numbers are those of one wrapper. No source gives the middle of the workspace: it
//! is taken to be where the handle is held when the device is opened.
//!
//! The user switches the power on; there is no force until then. If the host stops, the controller keeps the
//! last wrench for those 2 s: the library has no call for a shorter time.

use std::ffi::CString;
use std::time::Duration;

use super::connection::{Address, Failures, open as open_with, specification, write_state};
use super::foreign::Library;
use super::foreign::virtuose::Device;
use super::pace::Pace;
use super::{SdkLibrary, SdkMotion, SdkState, wrench_of};
use crate::link::{Found, LONGEST_REPORT, Transport, TransportError};
use crate::{Axes, DeviceError, HapticDevice};

const LIBRARY: SdkLibrary = SdkLibrary::HAPTION;
const MAKER: &str = LIBRARY.maker;
/// Shortest time from one round to the next, passed to the library as its time step.
const PERIOD: Duration = Duration::from_millis(1);
/// Numbers of the models that drive three axes, and of the one whose figures are known.
const THREE_AXES: [i32; 3] = [1, 2, 9];
const VIRTUOSE_6D: i32 = 3;

/// Opens the device of the controller in the address.
pub(crate) fn open(address: Option<&str>) -> Option<Result<Box<dyn HapticDevice>, DeviceError>> {
    let address = Address::parse(address);
    let host = address.which?;
    let name = CString::new(host.clone()).ok()?;
    let mut loaded = None;
    let connect = move || {
        let library = match &loaded {
            Some(library) => library,
            None => &*loaded.insert(Library::open(&LIBRARY, address.library.as_deref())?),
        };
        let device = Device::open(library, &name, PERIOD.as_secs_f32())?;
        device.map(found).map_err(|reason| DeviceError::NotOpened {
            device: format!("{MAKER} controller at {host}"),
            reason,
            remedy: "switch it on, check its address, and close what else uses it",
        })
    };
    Some(open_with(MAKER, connect))
}

fn found(device: Device) -> Found<SdkMotion> {
    let model = device.model();
    let (name, preset) = match model {
        Some(VIRTUOSE_6D) => (format!("{MAKER} Virtuose 6D"), Some("virtuose-6d")),
        Some(model) => (format!("{MAKER} device of type {model}"), None),
        None => (format!("{MAKER} device"), None),
    };
    let three = model.is_some_and(|model| THREE_AXES.contains(&model));
    let actuated = if three { Axes::TRANSLATION } else { Axes::ALL };
    let specification = specification(name, preset, Axes::ALL, actuated, PERIOD.as_secs_f64());
    let motion = SdkMotion::from_here(&specification);
    let (reads, writes) = Default::default();
    let transport = Calls { device, pace: Pace::new(PERIOD), reads, writes };
    Found { transport: Box::new(transport), specification, motion }
}

struct Calls {
    device: Device,
    pace: Pace,
    reads: Failures,
    writes: Failures,
}

impl Calls {
    fn state(&self) -> Option<SdkState> {
        let [x, y, z, orientation @ ..] = self.device.pose()?.map(f64::from);
        let speed = self.device.speed().map(|speed| speed.map(f64::from));
        let (linear, angular) = match speed {
            Some([x, y, z, rotation @ ..]) => (Some([x, y, z]), Some(rotation)),
            None => (None, None),
        };
        Some(SdkState {
            position: [x, y, z],
            orientation,
            linear,
            angular,
            buttons: self.device.buttons(),
            ready: self.device.is_powered()?,
        })
    }
}

impl Transport for Calls {
    fn read(
        &mut self,
        report: &mut [u8; LONGEST_REPORT],
        timeout: Duration,
    ) -> Result<usize, TransportError> {
        if !self.pace.wait(timeout) {
            return Ok(0);
        }
        write_state(self.state(), &mut self.reads, report)
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        let wrench = wrench_of(report).map_err(|_| TransportError::Failed)?;
        let set = self.device.set_wrench(&wrench);
        self.writes.judge(set.then_some(()))
    }
}
