//! Registry of the kinds of devices, which opens devices by address.

use std::path::Path;

use glam::DVec3;
use palpate_core::Pose;
use serde::Serialize;

use crate::emulated::KIND;
use crate::{
    DeviceError, EmulatedHand, Emulation, HapticDevice, RecordedDevice, Recording, ReplayDevice,
    Specification, TaskSite,
};

/// Largest size of a task done without a scene, m. The size is otherwise the radius of the workspace.
const MAX_SITE_SIZE: f64 = 0.1;

/// Kinds of devices whose drivers need a cargo feature, and that feature.
const BY_FEATURE: [(&str, &str); 7] = [
    ("spacemouse", "hid"),
    ("woodenhaptics", "hid"),
    ("hid", "hid"),
    ("haply", "haply"),
    ("force-dimension", "force-dimension"),
    ("open-haptics", "open-haptics"),
    ("haption", "haption"),
];

/// A device that can be opened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Listing {
    /// The address that [`open`] takes; words in capitals are placeholders.
    pub address: String,
    /// One-line description.
    pub description: String,
    /// The device's specification; `None` if it depends on the placeholders.
    pub specification: Option<Specification>,
}

/// A device, or the reason why it could not be opened.
pub type Opened = Result<Box<dyn HapticDevice>, DeviceError>;

/// A kind of device: the part of an address before the colon, with its driver.
#[derive(Clone, Copy, Debug)]
pub struct DeviceKind {
    /// Name of the kind: letters, digits and `-`.
    pub name: &'static str,
    /// Opens a device, given the part of its address after the colon.
    pub open: fn(Option<&str>) -> Opened,
    /// Lists the devices of this kind that can be opened.
    pub list: fn() -> Vec<Listing>,
}

/// The kinds of devices that can be opened: those of this crate, and drivers from elsewhere.
#[derive(Clone, Debug)]
pub struct Registry {
    kinds: Vec<DeviceKind>,
}

impl Default for Registry {
    /// The kinds of this crate.
    fn default() -> Self {
        let emulated = DeviceKind { name: KIND, open: open_emulated, list: list_emulated };
        let replay = DeviceKind { name: "replay", open: open_replay, list: list_replay };
        let own = [emulated, replay].into_iter();
        #[cfg(feature = "hid")]
        let own = own.chain(real::KINDS);
        #[cfg(feature = "haply")]
        let own = own.chain([DeviceKind { name: "haply", open: open_haply, list: list_haply }]);
        #[cfg(feature = "force-dimension")]
        let own = own.chain([sdk::FORCE_DIMENSION]);
        #[cfg(feature = "open-haptics")]
        let own = own.chain([sdk::OPEN_HAPTICS]);
        #[cfg(feature = "haption")]
        let own = own.chain([sdk::HAPTION]);
        Self { kinds: own.collect() }
    }
}

impl Registry {
    /// Adds a kind; it replaces an earlier kind of the same name.
    #[must_use]
    pub fn with(mut self, kind: DeviceKind) -> Self {
        self.kinds.retain(|known| known.name != kind.name);
        self.kinds.push(kind);
        self
    }

    /// Opens a device by its address, `KIND` or `KIND:WHICH`.
    ///
    /// # Errors
    /// If there is no such kind or device, its driver is not in this build, or it cannot be opened.
    pub fn open(&self, address: &str) -> Opened {
        let (name, which) = match address.split_once(':') {
            Some((name, which)) => (name, Some(which)),
            None => (address, None),
        };
        let unknown = || DeviceError::Unknown {
            address: address.chars().take(80).collect(),
            known: self
                .list()
                .into_iter()
                .map(|listing| format!("`{}`", listing.address))
                .collect::<Vec<_>>()
                .join(", "),
        };
        let Some(kind) = self.kinds.iter().find(|kind| kind.name == name) else {
            let optional = BY_FEATURE.into_iter().find(|(kind, _)| *kind == name);
            return Err(
                optional.map_or_else(unknown, |(kind, feature)| DeviceError::NotCompiledIn { kind, feature })
            );
        };
        (kind.open)(which).map_err(|error| match error {
            DeviceError::Unknown { .. } => unknown(),
            error => error,
        })
    }

    /// The devices that can be opened.
    pub fn list(&self) -> Vec<Listing> {
        self.kinds.iter().flat_map(|kind| (kind.list)()).collect()
    }
}

/// Opens a device of this crate: `emulated` (a Phantom Premium 1.5), `emulated:PRESET,KEY=VALUE,…` (see
/// [`EmulatedHand::at`]), `replay:FILE`, `spacemouse`, `woodenhaptics`, `woodenhaptics:MODEL` or
/// `hid:VENDOR:PRODUCT` (in hexadecimal; a joystick with force feedback as well), and by feature `haply`,
/// `force-dimension`, `open-haptics` and `haption:HOST` ([`sdk`](crate::sdk)).
///
/// The hand of an emulated device holds still at the centre of the workspace, or does its task there;
/// [`Emulation::open`](crate::Emulation::open) gives it a path to follow.
///
/// # Errors
/// See [`Registry::open`].
pub fn open(address: &str) -> Opened {
    Registry::default().open(address)
}

/// The devices of this crate that can be opened.
pub fn list() -> Vec<Listing> {
    Registry::default().list()
}

/// The error for a device that does not exist in a kind; [`Registry::open`] adds those that do.
fn no_such_device() -> DeviceError {
    DeviceError::Unknown { address: String::new(), known: String::new() }
}

fn open_emulated(which: Option<&str>) -> Opened {
    let mut hand = EmulatedHand::named(which).ok_or_else(no_such_device)??;
    let path = match (hand.path.take(), hand.task) {
        (Some(path), _) => path.into(),
        (None, Some(task)) => {
            let size = hand.emulation.specification.workspace_radius.min(MAX_SITE_SIZE);
            hand.task_parameters
                .path(task, &TaskSite { touch: task.beside() * size, pivot: DVec3::ZERO, size })?
        }
        (None, None) => Pose::IDENTITY.into(),
    };
    Ok(Box::new(hand.open(path)?))
}

fn list_emulated() -> Vec<Listing> {
    let listing = |(name, description)| Listing {
        address: format!("emulated:{name}"),
        description: format!("emulated {description}"),
        specification: Emulation::preset(name).map(|emulation| emulation.specification),
    };
    let settings = Listing {
        address: "emulated:PRESET,KEY=VALUE,...".into(),
        description:
            "one with settings: hand=firm, task=tap, peak_force=5, ...; an unknown key lists all keys".into(),
        specification: None,
    };
    Emulation::presets().map(listing).chain([settings]).collect()
}

fn open_replay(file: Option<&str>) -> Opened {
    let file = file.filter(|file| !file.is_empty()).ok_or_else(no_such_device)?;
    let file = Path::new(file);
    if Recording::is_one(file) {
        return Ok(Box::new(RecordedDevice::new(Recording::load(file)?)));
    }
    Ok(Box::new(ReplayDevice::open(file)?))
}

fn list_replay() -> Vec<Listing> {
    vec![Listing {
        address: "replay:FILE.csv".into(),
        description: format!(
            "replays a recorded motion ({}), a recording of a session, or a recorded device",
            crate::PATH_HEADER
        ),
        specification: None,
    }]
}

#[cfg(feature = "haply")]
fn open_haply(address: Option<&str>) -> Opened {
    crate::haply::open(address.unwrap_or(crate::haply::ADDRESS))
}

#[cfg(feature = "haply")]
fn list_haply() -> Vec<Listing> {
    vec![Listing {
        address: "haply".into(),
        description: "Haply Inverse3 by the service of its maker, three axes of force; haply:ADDRESS:PORT for another machine".into(),
        specification: None,
    }]
}

/// Kinds reached through makers' libraries. Listing them loads no library.
#[cfg(any(feature = "force-dimension", feature = "open-haptics", feature = "haption"))]
mod sdk {
    use super::{DeviceKind, Listing, Opened, no_such_device};

    fn listing(address: &str, description: &str) -> Vec<Listing> {
        vec![Listing { address: address.into(), description: description.into(), specification: None }]
    }

    #[cfg(feature = "force-dimension")]
    pub const FORCE_DIMENSION: DeviceKind = DeviceKind {
        name: "force-dimension",
        open: |which| -> Opened {
            crate::sdk::force_dimension::open(which).unwrap_or_else(|| Err(no_such_device()))
        },
        list: || {
            listing(
                "force-dimension",
                "the first omega, sigma, lambda or delta by Force Dimension's SDK, where that is installed; force-dimension:NUMBER for another",
            )
        },
    };

    #[cfg(feature = "open-haptics")]
    pub const OPEN_HAPTICS: DeviceKind = DeviceKind {
        name: "open-haptics",
        open: |which| -> Opened {
            crate::sdk::open_haptics::open(which).unwrap_or_else(|| Err(no_such_device()))
        },
        list: || {
            listing(
                "open-haptics",
                "the default Touch or Phantom by 3D Systems' OpenHaptics, where that is installed; open-haptics:NAME for another",
            )
        },
    };

    #[cfg(feature = "haption")]
    pub const HAPTION: DeviceKind = DeviceKind {
        name: "haption",
        open: |which| -> Opened { crate::sdk::haption::open(which).unwrap_or_else(|| Err(no_such_device())) },
        list: || {
            listing(
                "haption:HOST",
                "the Virtuose of a controller by Haption's SDK, where that is installed; hold its handle in the middle of its workspace",
            )
        },
    };
}

/// Kinds of HID devices, listed if they are plugged in.
#[cfg(feature = "hid")]
mod real {
    use super::{DeviceKind, Listing, Opened, no_such_device};
    use crate::hid::{self, Driver, WoodenHapticsModel};

    pub const KINDS: [DeviceKind; 3] = [
        DeviceKind { name: "spacemouse", open: open_space_mouse, list: list_space_mouse },
        DeviceKind { name: "woodenhaptics", open: open_wooden_haptics, list: list_wooden_haptics },
        DeviceKind { name: "hid", open: open_numbered, list: list_connected },
    ];

    fn open_space_mouse(which: Option<&str>) -> Opened {
        if which.is_some() {
            return Err(no_such_device());
        }
        hid::open(Driver::SpaceMouse, None)
    }

    fn list_space_mouse() -> Vec<Listing> {
        vec![Listing {
            address: "spacemouse".into(),
            description: "the first SpaceMouse that is plugged in, 6 axes without force".into(),
            specification: None,
        }]
    }

    fn open_wooden_haptics(model: Option<&str>) -> Opened {
        hid::open(Driver::WoodenHaptics, Some(model.unwrap_or("woodenhaptics")))
    }

    fn list_wooden_haptics() -> Vec<Listing> {
        let models = WoodenHapticsModel::MODELS.map(|(name, _)| name).join(", ");
        vec![Listing {
            address: "woodenhaptics:MODEL".into(),
            description: format!(
                "the first WoodenHaptics that is plugged in: {models} or a woodenhaptics.json"
            ),
            specification: None,
        }]
    }

    fn open_numbered(numbers: Option<&str>) -> Opened {
        let number = |text: &str| u16::from_str_radix(text, 16).ok();
        let parsed = numbers.and_then(|numbers| numbers.split_once(':'));
        let parsed = parsed.and_then(|(vendor, product)| number(vendor).zip(number(product)));
        let (vendor, product) = parsed.ok_or_else(no_such_device)?;
        hid::open_numbered(vendor, product)
    }

    /// The devices that are plugged in, with the reason if one cannot be opened.
    fn list_connected() -> Vec<Listing> {
        let listing = |device: hid::PluggedIn| Listing {
            address: device.address,
            description: match device.refusal {
                None => format!("{}, plugged in", device.name),
                Some(refusal) => refusal.to_string(),
            },
            specification: None,
        };
        let mut listings: Vec<Listing> = hid::plugged_in().into_iter().map(listing).collect();
        if listings.is_empty() {
            listings.push(Listing {
                address: "hid:VENDOR:PRODUCT".into(),
                description: "a HID device with a driver here (none is plugged in) or with force feedback; for permission to open \
                              one on Linux, see `palpate devices --udev`"
                    .into(),
                specification: None,
            });
        }
        listings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_listed_opens() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("with:colon.csv");
        std::fs::write(&file, format!("{}\n0,0,0,0,0,0,0,1\n", crate::PATH_HEADER)).unwrap();
        for listing in list().into_iter().filter(|listing| listing.address.starts_with(['e', 'r'])) {
            let address = listing.address.replace("FILE.csv", &file.display().to_string());
            let address = address.replace("PRESET,KEY=VALUE,...", "omega,hand=firm,task=tap");
            let mut device = open(&address).unwrap_or_else(|error| panic!("{address}: {error}"));
            if let Some(specification) = listing.specification {
                assert_eq!(device.specification(), &specification);
            }
            assert!(device.read(0.01).unwrap().pose.is_valid());
        }
        assert_eq!(open("emulated").unwrap().specification(), &Emulation::default().specification);
    }

    #[test]
    fn a_driver_that_is_not_compiled_in_is_named_with_its_feature() {
        for (kind, feature) in BY_FEATURE {
            if Registry::default().kinds.iter().any(|known| known.name == kind) {
                continue;
            }
            let message = open(&format!("{kind}:1")).err().expect(kind).to_string();
            assert!(message.contains(kind) && message.contains(&format!("feature `{feature}`")), "{message}");
        }
        assert!(
            Registry { kinds: Vec::new() }.open("haply").err().unwrap().to_string().contains("no driver")
        );
    }

    #[test]
    fn unknown_addresses_are_refused_with_the_known_ones() {
        for address in [
            "",
            "emulated:",
            "emulated:phantom",
            "emulated:phantom,hand=firm",
            "replay",
            "replay:",
            "spacemouse:2",
            "hid:1",
            "hid:x:y",
            ":",
            "Emulated",
        ] {
            let message = open(address).err().expect(address).to_string();
            assert!(
                message.contains("`emulated:premium-1.5`") && message.contains("`replay:FILE.csv`"),
                "{message}"
            );
        }
        assert!(open("replay:no/such/file.csv").err().unwrap().to_string().contains("no/such/file.csv"));
    }
}
