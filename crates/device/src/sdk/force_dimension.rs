//! omega, sigma, lambda and delta devices through Force Dimension's library.
//!
//! Units are SI throughout. The indices into the status, the watchdog's unit of 125 µs and its expert mode
//! were read in the header and in public wrappers of the library. That its calls may be made from any thread,
//! one at a time, is general knowledge. The library's velocity window of 20 ms is shortened, so that
//! velocities lag no more than the specification says.
//!
//! If the host stops, the device's watchdog switches the force off after 32 ms, if library and device have
//! one. If the user switches the force off at the device, it is zero, and comes up from zero when it is on
//! again.

use std::time::{Duration, Instant};

use super::connection::{Address, Failures, open as open_with, specification, write_state};
use super::foreign::Library;
use super::foreign::dhd::Device;
use super::orientation::orientation;
use super::pace::Pace;
use super::{SdkLibrary, SdkMotion, SdkState, wrench_of};
use crate::link::{Found, LONGEST_REPORT, Transport, TransportError};
use crate::{Axes, DeviceError, HapticDevice};

const LIBRARY: SdkLibrary = SdkLibrary::FORCE_DIMENSION;
const MAKER: &str = LIBRARY.maker;
/// Shortest time from one round to the next.
const PERIOD: Duration = Duration::from_micros(250);
/// Velocity window, ms.
const VELOCITY_WINDOW: i32 = 4;
/// Time without a command after which the device switches its force off, in units of 125 µs: the longest
/// possible, 31.9 ms.
const WATCHDOG_TIME: u8 = u8::MAX;
/// Time since the last command after which the watchdog may have switched the force off.
const WATCHDOG_GAP: Duration = Duration::from_millis(25);
/// Interval at which the driver checks whether the force is on.
const CHECK_PERIOD: Duration = Duration::from_millis(10);

/// Opens the first device, or the one with the number in the address.
pub(crate) fn open(address: Option<&str>) -> Option<Result<Box<dyn HapticDevice>, DeviceError>> {
    let address = Address::parse(address);
    let number = match &address.which {
        None => None,
        Some(number) => Some(number.parse::<u8>().ok().filter(|number| *number < 128)?),
    };
    let mut loaded = None;
    let connect = move || {
        let library = match &loaded {
            Some(library) => library,
            None => &*loaded.insert(Library::open(&LIBRARY, address.library.as_deref())?),
        };
        let refused = |reason| DeviceError::NotOpened {
            device: format!("{MAKER} device"),
            reason,
            remedy: "plug it in, switch it on, and close what else uses it",
        };
        let device = Device::open(library, number)?.map_err(refused)?;
        device.set_watchdog(WATCHDOG_TIME);
        if !device.enable_force(true) {
            return Err(refused("its force cannot be enabled".into()));
        }
        Ok(found(device))
    };
    Some(open_with(MAKER, connect))
}

fn found(device: Device) -> Found<SdkMotion> {
    let name = device.name();
    let lower = name.to_lowercase();
    let preset = ["sigma", "omega"].into_iter().find(|family| lower.contains(family));
    let preset = preset.map(|family| if family == "sigma" { "sigma.7" } else { family });
    let (senses, drives) = device.wrist();
    let axes = |all: bool| if all { Axes::ALL } else { Axes::TRANSLATION };
    let specification = specification(
        format!("{MAKER} {name}"),
        preset,
        axes(senses),
        axes(senses && drives),
        PERIOD.as_secs_f64(),
    );
    device.set_window(VELOCITY_WINDOW);
    let motion = SdkMotion::new(&specification);
    let transport = Calls {
        device,
        senses_wrist: senses,
        pace: Pace::new(PERIOD),
        commanded: Instant::now(),
        checked: None,
        force: true,
        reads: Failures::default(),
        writes: Failures::default(),
    };
    Found { transport: Box::new(transport), specification, motion }
}

struct Calls {
    device: Device,
    senses_wrist: bool,
    pace: Pace,
    /// Time of the last command.
    commanded: Instant,
    /// Time of the last check whether the force is on, and its result.
    checked: Option<Instant>,
    force: bool,
    reads: Failures,
    writes: Failures,
}

impl Calls {
    fn state(&mut self) -> Option<SdkState> {
        if self.checked.is_none_or(|checked| checked.elapsed() >= CHECK_PERIOD) {
            (self.checked, self.force) = (Some(Instant::now()), self.device.is_force_on());
        }
        let (position, [a, b, c]) = self.device.pose()?;
        let orientation = if self.senses_wrist {
            // The maker's matrix is given by rows.
            orientation([0, 1, 2].map(|column: usize| [a[column], b[column], c[column]]))
        } else {
            SdkState::default().orientation
        };
        Some(SdkState {
            position,
            orientation,
            linear: self.device.linear_velocity(),
            angular: if self.senses_wrist { self.device.angular_velocity() } else { Some([0.0; 3]) },
            buttons: self.device.buttons(),
            ready: self.force,
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
        let last = std::mem::replace(&mut self.commanded, Instant::now());
        // A force that the user has disabled stays disabled.
        if last.elapsed() > WATCHDOG_GAP && self.device.is_off_by_watchdog() {
            self.device.enable_force(true);
        }
        let set = self.device.set_wrench(&wrench);
        self.writes.judge(set.then_some(()))
    }
}
