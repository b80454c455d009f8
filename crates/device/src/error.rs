//! Why a device or a recorded motion could not be used. Each message says what, where, and what to do.

use std::path::PathBuf;

use thiserror::Error;

/// Why a device could not be opened or used.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// No device goes by this address.
    #[error("no device `{address}`; there are {known}")]
    Unknown {
        /// The address asked for.
        address: String,
        /// The addresses there are.
        known: String,
    },
    /// This build has no driver for such devices.
    #[error("this build has no driver for `{kind}` devices; build it with the cargo feature `{feature}`")]
    NotCompiledIn {
        /// What their addresses begin with.
        kind: &'static str,
        /// The feature of the crates `palpate` and `palpate-cli` that has the driver.
        feature: &'static str,
    },
    /// A parameter lies outside what it may be.
    #[error("{parameter} is {value}; give {expected}")]
    Parameter {
        /// The parameter, with its unit.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        expected: String,
    },
    /// A setting in an address is none.
    #[error("`{setting}`: give {expected}")]
    Setting {
        /// The setting.
        setting: String,
        /// What it may be.
        expected: String,
    },
    /// The device was closed before.
    #[error("the device is closed; open it again")]
    Closed,
    /// The device does not answer; it may come back.
    #[error("the device is lost ({status}); plug it in again, or look after its cable and its power")]
    Lost {
        /// Why.
        status: crate::Status,
    },
    /// No such device is connected.
    #[error("no {device} is connected; plug it in and switch it on (`palpate devices` lists what is seen)")]
    NotConnected {
        /// What was looked for.
        device: String,
    },
    /// The device is there, but may not be opened.
    #[error("{device} cannot be opened ({reason}); {remedy}")]
    NotOpened {
        /// The device.
        device: String,
        /// What the system says.
        reason: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A file that describes a device could not be used.
    #[error("{}: {reason}; {remedy}", file.display())]
    Model {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        reason: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The motion to play or to follow could not be used.
    #[error(transparent)]
    Path(#[from] PathError),
    /// Anything else that a driver has to say, in its words ([`DeviceError::driver`]).
    #[error(transparent)]
    Driver(Box<dyn std::error::Error + Send + Sync>),
}

impl DeviceError {
    /// An error of a driver of your own: a text, or an error type.
    pub fn driver(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self::Driver(error.into())
    }
}

/// Why a recorded motion could not be read, used or written.
#[derive(Debug, Error)]
pub enum PathError {
    /// The file could not be opened, read or written.
    #[error("{}: {source}; check that the file is there and may be {access}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// What was to be done with it: "read" or "written".
        access: &'static str,
        /// What the system says.
        source: std::io::Error,
    },
    /// A line of the file is not a sample of a motion.
    #[error("{what} at {}:{line}; {remedy}", file.display())]
    Line {
        /// What is wrong.
        what: String,
        /// The file.
        file: PathBuf,
        /// The line in it, from 1.
        line: u64,
        /// What to do.
        remedy: &'static str,
    },
    /// A sample given in memory is not one of a motion.
    #[error("{what} at sample {sample}; {remedy}")]
    Sample {
        /// What is wrong.
        what: String,
        /// Which sample, from 0.
        sample: usize,
        /// What to do.
        remedy: &'static str,
    },
    /// There is no sample.
    #[error("{} holds no sample; a motion needs at least one", named(file))]
    Empty {
        /// The file, where there is one.
        file: Option<PathBuf>,
    },
}

fn named(file: &Option<PathBuf>) -> String {
    file.as_ref().map_or_else(|| "the motion".into(), |file| file.display().to_string())
}
