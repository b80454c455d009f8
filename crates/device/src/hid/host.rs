//! HID devices of this machine, through hidapi. Enumerating and opening may take long: never on the haptic
//! thread.

use std::ffi::{CStr, CString};
use std::time::Duration;

use hidapi::{HidApi, HidError};

use super::wooden_haptics::WoodenHapticsModel;
use super::{Driver, LONGEST_HID_REPORT, PidCodec, known};
use crate::link::{LONGEST_REPORT, Link, Transport, TransportError};
use crate::{DeviceError, HapticDevice};

const PERMISSION: &str = "let your user open it: `palpate devices --udev | sudo tee /etc/udev/rules.d/70-palpate.rules`, \
                          then `sudo udevadm control --reload` and plug it in again";
const IN_USE: &str = "close what else uses it, and plug it in again";

/// A device that is plugged in and has a driver here.
#[derive(Clone, Debug)]
pub(crate) struct Connected {
    pub vendor: u16,
    pub product: u16,
    pub name: &'static str,
    pub driver: Driver,
    path: CString,
}

/// Devices that are plugged in and have a driver here, each once.
pub(crate) fn connected() -> Vec<Connected> {
    let Ok(api) = HidApi::new() else { return Vec::new() };
    let mut found: Vec<Connected> = Vec::new();
    for device in api.device_list() {
        let numbers = (device.vendor_id(), device.product_id());
        let Some((vendor, product, name, driver)) =
            known().find(|(vendor, product, ..)| (*vendor, *product) == numbers)
        else {
            continue;
        };
        // hidapi lists a device once for each of its usages.
        if found.iter().all(|known| known.path.as_c_str() != device.path()) {
            found.push(Connected { vendor, product, name, driver, path: device.path().to_owned() });
        }
    }
    found
}

/// A HID device that is plugged in and has a driver in this crate.
#[derive(Debug)]
pub struct PluggedIn {
    /// Address for [`open`](crate::open): `hid:VENDOR:PRODUCT`.
    pub address: String,
    /// Its name.
    pub name: &'static str,
    /// Reason why it cannot be opened; `None` if it can.
    pub refusal: Option<DeviceError>,
}

/// HID devices that are plugged in and have a driver in this crate. Each is opened and closed again, which
/// may take long.
pub fn plugged_in() -> Vec<PluggedIn> {
    let try_each = |device: Connected| PluggedIn {
        address: format!("hid:{:04x}:{:04x}", device.vendor, device.product),
        name: device.name,
        refusal: device.refusal(),
    };
    connected().into_iter().map(try_each).collect()
}

impl Connected {
    /// Reason why it cannot be opened, if so.
    pub fn refusal(&self) -> Option<DeviceError> {
        self.transport().err()
    }

    fn transport(&self) -> Result<HidTransport, DeviceError> {
        open_path(&self.path, self.name)
    }
}

/// Opens the first plugged-in device of a driver; `model` is that of a WoodenHaptics.
pub(crate) fn open(driver: Driver, model: Option<&str>) -> Result<Box<dyn HapticDevice>, DeviceError> {
    open_any(
        |device| device.driver == driver,
        model,
        || match driver {
            Driver::SpaceMouse => "SpaceMouse".into(),
            Driver::WoodenHaptics => "WoodenHaptics".into(),
        },
    )
}

/// Opens the first device with these numbers: with its own driver if there is one, else as a force feedback
/// device by its report descriptor.
pub(crate) fn open_numbered(vendor: u16, product: u16) -> Result<Box<dyn HapticDevice>, DeviceError> {
    if known().any(|(known, of, ..)| (known, of) == (vendor, product)) {
        let named = || format!("HID device {vendor:04x}:{product:04x}");
        return open_any(|device| (device.vendor, device.product) == (vendor, product), None, named);
    }
    let name = format!("HID device {vendor:04x}:{product:04x}");
    let path = path_of(vendor, product).ok_or_else(|| DeviceError::NotConnected { device: name.clone() })?;
    let transport = open_path(&path, &name)?;
    let not_opened = |reason: String| DeviceError::NotOpened {
        device: name.clone(),
        reason,
        remedy: "give a device that `palpate devices` lists, or one with force feedback",
    };
    let mut descriptor = [0; hidapi::MAX_REPORT_DESCRIPTOR_SIZE];
    let length = transport.0.get_report_descriptor(&mut descriptor);
    let length = length.map_err(|error| not_opened(error.to_string()))?.min(descriptor.len());
    let codec = PidCodec::new(&descriptor[..length]).map_err(|error| not_opened(error.to_string()))?;
    let opened = Link::pid(&name, codec).spawn(opener(transport, vendor, product, name.clone()));
    Ok(Box::new(opened.map_err(|error| not_opened(error.to_string()))?))
}

/// Opener of a device: first the transport that is open already, later the device with its numbers, which may
/// have come back at another path.
fn opener(
    first: HidTransport,
    vendor: u16,
    product: u16,
    name: String,
) -> impl FnMut() -> Option<Box<dyn Transport>> + Send + 'static {
    let mut first = Some(first);
    move || {
        let again = || open_path(&path_of(vendor, product)?, &name).ok();
        Some(Box::new(first.take().or_else(again)?))
    }
}

fn path_of(vendor: u16, product: u16) -> Option<CString> {
    let api = HidApi::new().ok()?;
    let mut devices = api.device_list();
    let found = devices.find(|device| (device.vendor_id(), device.product_id()) == (vendor, product))?;
    Some(found.path().to_owned())
}

fn open_path(path: &CStr, name: &str) -> Result<HidTransport, DeviceError> {
    let opened = HidApi::new().and_then(|api| api.open_path(path));
    opened.map(HidTransport).map_err(|error| {
        let reason = error.to_string();
        let denied = reason.to_lowercase().contains("permission denied");
        DeviceError::NotOpened {
            device: format!("{name} ({})", path.to_string_lossy()),
            reason,
            remedy: if denied { PERMISSION } else { IN_USE },
        }
    })
}

fn open_any(
    wanted: impl Fn(&Connected) -> bool,
    model: Option<&str>,
    named: impl Fn() -> String,
) -> Result<Box<dyn HapticDevice>, DeviceError> {
    let model = match model {
        Some(model) => WoodenHapticsModel::open(model)?,
        None => WoodenHapticsModel::WOODEN_HAPTICS,
    };
    let Some(device) = connected().into_iter().find(wanted) else {
        return Err(DeviceError::NotConnected { device: named() });
    };
    let (vendor, product, name) = (device.vendor, device.product, device.name);
    let open = opener(device.transport()?, vendor, product, name.to_owned());
    let opened: std::io::Result<Box<dyn HapticDevice>> = match device.driver {
        Driver::SpaceMouse => Link::space_mouse(name).spawn(open).map(|device| Box::new(device) as _),
        Driver::WoodenHaptics => {
            Link::wooden_haptics(name, model).spawn(open).map(|device| Box::new(device) as _)
        }
    };
    opened.map_err(|error| DeviceError::NotOpened {
        device: name.into(),
        reason: error.to_string(),
        remedy: "end other programs and try again",
    })
}

struct HidTransport(hidapi::HidDevice);

impl Transport for HidTransport {
    fn read(
        &mut self,
        report: &mut [u8; LONGEST_REPORT],
        timeout: Duration,
    ) -> Result<usize, TransportError> {
        self.0.read_timeout(&mut report[..LONGEST_HID_REPORT], timeout.as_millis() as i32).map_err(|error| {
            match cause(&error) {
                // A signal interrupted the call.
                Some(std::io::ErrorKind::Interrupted | std::io::ErrorKind::WouldBlock) => {
                    TransportError::Failed
                }
                _ => TransportError::Disconnected,
            }
        })
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        self.0.write(report).map(|_| ()).map_err(|error| refused(&error))
    }

    fn set_feature(&mut self, report: &[u8]) -> Result<(), TransportError> {
        self.0.send_feature_report(report).map_err(|error| refused(&error))
    }

    fn get_feature(&mut self, report: &mut [u8; LONGEST_REPORT]) -> Result<usize, TransportError> {
        self.0.get_feature_report(&mut report[..LONGEST_HID_REPORT]).map_err(|error| refused(&error))
    }
}

fn refused(error: &HidError) -> TransportError {
    match error {
        HidError::IoError { error } if is_gone(error) => TransportError::Disconnected,
        _ => TransportError::Failed,
    }
}

fn cause(error: &HidError) -> Option<std::io::ErrorKind> {
    if let HidError::IoError { error } = error { Some(error.kind()) } else { None }
}

/// Whether the error is ENODEV or ENXIO, which have no kind of their own.
fn is_gone(error: &std::io::Error) -> bool {
    matches!(error.raw_os_error(), Some(19 | 6))
}
