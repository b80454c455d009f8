//! Reasons why a device or a recorded motion could not be used. Each message says what is wrong, where, and
//! what to do.

use std::path::PathBuf;

use thiserror::Error;

/// Reason why a device could not be opened or used.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// The address names no device.
    #[error("no device `{address}`; there are {known}")]
    Unknown {
        /// The address that was given.
        address: String,
        /// The known addresses.
        known: String,
    },
    /// This build has no driver for this kind of device.
    #[error("this build has no driver for `{kind}` devices; build it with the cargo feature `{feature}`")]
    NotCompiledIn {
        /// The kind: the part of an address before the colon.
        kind: &'static str,
        /// Cargo feature of `palpate` and `palpate-cli` that adds the driver.
        feature: &'static str,
    },
    /// A parameter is out of range.
    #[error("{parameter} is {value}; give {expected}")]
    Parameter {
        /// Name of the parameter, with its unit.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// Its valid range.
        expected: String,
    },
    /// A setting in an address is not valid.
    #[error("`{setting}`: give {expected}")]
    Setting {
        /// The setting.
        setting: String,
        /// What is valid.
        expected: String,
    },
    /// The device was closed before.
    #[error("the device is closed; open it again")]
    Closed,
    /// The device does not respond; it may come back.
    #[error("the device is lost ({status}); plug it in again, or look after its cable and its power")]
    Lost {
        /// Reason, as a status.
        status: crate::Status,
    },
    /// No such device is connected.
    #[error("no {device} is connected; plug it in and switch it on (`palpate devices` lists what is seen)")]
    NotConnected {
        /// The device that was searched for.
        device: String,
    },
    /// The device is present, but cannot be opened.
    #[error("{device} cannot be opened ({reason}); {remedy}")]
    NotOpened {
        /// The device.
        device: String,
        /// Reason, in the system's words.
        reason: String,
        /// What the user can do.
        remedy: &'static str,
    },
    /// A file that describes a device could not be used.
    #[error("{}: {reason}; {remedy}", file.display())]
    Model {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        reason: String,
        /// What the user can do.
        remedy: &'static str,
    },
    /// A recorded motion could not be used.
    #[error(transparent)]
    Path(#[from] PathError),
    /// Any other error of a driver, in its own words ([`DeviceError::driver`]).
    #[error(transparent)]
    Driver(Box<dyn std::error::Error + Send + Sync>),
}

impl DeviceError {
    /// Wraps an error of a driver from elsewhere: a text or an error type.
    pub fn driver(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self::Driver(error.into())
    }
}

/// Reason why a recorded motion could not be read, used or written.
#[derive(Debug, Error)]
pub enum PathError {
    /// The file could not be opened, read or written.
    #[error("{}: {source}; check that the file is there and may be {access}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// The failed access: "read" or "written".
        access: &'static str,
        /// The system's error.
        source: std::io::Error,
    },
    /// A line of the file is not a valid sample.
    #[error("{what} at {}:{line}; {remedy}", file.display())]
    Line {
        /// What is wrong.
        what: String,
        /// The file.
        file: PathBuf,
        /// The line, counted from 1.
        line: u64,
        /// What the user can do.
        remedy: &'static str,
    },
    /// A sample given in memory is not valid.
    #[error("{what} at sample {sample}; {remedy}")]
    Sample {
        /// What is wrong.
        what: String,
        /// The sample, counted from 0.
        sample: usize,
        /// What the user can do.
        remedy: &'static str,
    },
    /// The motion has no sample.
    #[error("{} holds no sample; a motion needs at least one", named(file))]
    Empty {
        /// The file, if the motion came from one.
        file: Option<PathBuf>,
    },
}

fn named(file: &Option<PathBuf>) -> String {
    file.as_ref().map_or_else(|| "the motion".into(), |file| file.display().to_string())
}
