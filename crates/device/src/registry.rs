//! Devices by address, as they are written on a command line.

use std::path::Path;

use palpate_core::Pose;
use serde::Serialize;

use crate::{DeviceError, Emulation, HapticDevice, ReplayDevice, Specification};

/// A device that can be opened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Listing {
    /// What [`open`] takes; in capitals what is to be filled in.
    pub address: String,
    /// What it is, in a line.
    pub description: String,
    /// What it can do; absent where that depends on what is filled in.
    pub specification: Option<Specification>,
}

/// Opens a device: `emulated` (a Phantom Premium 1.5), `emulated:PRESET`, or `replay:FILE`.
///
/// The hand of a device emulated this way holds still at the centre of the workspace; [`Emulation::open`] gives
/// it a path to follow.
pub fn open(address: &str) -> Result<Box<dyn HapticDevice>, DeviceError> {
    let (kind, rest) = match address.split_once(':') {
        Some((kind, rest)) => (kind, Some(rest)),
        None => (address, None),
    };
    let unknown = || DeviceError::Unknown {
        address: address.chars().take(80).collect(),
        known: list()
            .into_iter()
            .map(|listing| format!("`{}`", listing.address))
            .collect::<Vec<_>>()
            .join(", "),
    };
    match (kind, rest) {
        ("emulated", None) => Ok(Box::new(Emulation::default().open(Pose::IDENTITY)?)),
        ("emulated", Some(preset)) => {
            Ok(Box::new(Emulation::preset(preset).ok_or_else(unknown)?.open(Pose::IDENTITY)?))
        }
        ("replay", Some(file)) if !file.is_empty() => Ok(Box::new(ReplayDevice::open(Path::new(file))?)),
        _ => Err(unknown()),
    }
}

/// The devices that can be opened.
pub fn list() -> Vec<Listing> {
    let emulated = Emulation::presets().map(|(name, description)| Listing {
        address: format!("emulated:{name}"),
        description: format!("emulated {description}"),
        specification: Emulation::preset(name).map(|emulation| emulation.specification),
    });
    let replay = Listing {
        address: "replay:FILE.csv".into(),
        description: format!("replays a recorded motion ({})", crate::PATH_HEADER),
        specification: None,
    };
    emulated.chain([replay]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_listed_opens() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("with:colon.csv");
        std::fs::write(&file, format!("{}\n0,0,0,0,0,0,0,1\n", crate::PATH_HEADER)).unwrap();
        for listing in list() {
            let address = listing.address.replace("FILE.csv", &file.display().to_string());
            let mut device = open(&address).unwrap_or_else(|error| panic!("{address}: {error}"));
            if let Some(specification) = listing.specification {
                assert_eq!(device.specification(), &specification);
            }
            assert!(device.read(0.01).unwrap().pose.is_valid());
        }
        assert_eq!(open("emulated").unwrap().specification(), &Emulation::default().specification);
    }

    #[test]
    fn unknown_addresses_are_refused_with_what_there_is() {
        for address in
            ["", "emulated:", "emulated:phantom", "replay", "replay:", "spacemouse", ":", "Emulated"]
        {
            let message = open(address).err().expect(address).to_string();
            assert!(
                message.contains("`emulated:premium-1.5`") && message.contains("`replay:FILE.csv`"),
                "{message}"
            );
        }
        assert!(open("replay:no/such/file.csv").err().unwrap().to_string().contains("no/such/file.csv"));
    }
}
