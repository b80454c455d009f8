//! Failure of a command, as one line.

use std::fmt;
use std::io;
use std::path::Path;

/// Failure of a command. Its message names the fault, its place, and what to do.
#[derive(Debug)]
pub enum Failure {
    /// The reader of standard output closed it.
    ClosedPipe,
    /// Any other failure.
    Message(String),
}

impl Failure {
    /// Failure to write standard output.
    pub fn printing(error: &io::Error) -> Self {
        if error.kind() == io::ErrorKind::BrokenPipe {
            Self::ClosedPipe
        } else {
            Self::Message(format!("standard output could not be written: {error}"))
        }
    }

    /// Failure to write a file.
    pub fn writing(path: &Path, error: impl fmt::Display) -> Self {
        Self::Message(format!("{} could not be written: {error}", path.display()))
    }

    /// Whether the reader of standard output closed it.
    pub fn is_closed_pipe(&self) -> bool {
        matches!(self, Self::ClosedPipe)
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ClosedPipe => f.write_str("standard output was closed"),
            // Messages from elsewhere may contain line breaks; the failure is one line.
            Self::Message(message) => f.write_str(&message.trim_end().replace(char::is_control, " ")),
        }
    }
}

/// Adds the command that builds a missing driver in.
impl From<palpate::device::DeviceError> for Failure {
    fn from(error: palpate::device::DeviceError) -> Self {
        Self::Message(match &error {
            palpate::device::DeviceError::NotCompiledIn { feature, .. } => {
                format!("{error}: `cargo run --release -p palpate-cli --features {feature} -- ...`")
            }
            error => error.to_string(),
        })
    }
}

macro_rules! from_error {
    ($($error:ty),*) => {$(
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Self::Message(error.to_string())
            }
        }
    )*};
}

/// Names options as on the command line.
impl From<palpate::errors::OpenError> for Failure {
    fn from(error: palpate::errors::OpenError) -> Self {
        Self::Message(match error {
            palpate::errors::OpenError::AlreadyBuilt { path } => {
                format!("{path} is already built; give --scale and --repair when building it")
            }
            palpate::errors::OpenError::Build { name, source } => format!("{name}: {}", Self::from(source)),
            palpate::errors::OpenError::Mesh(error @ palpate::mesh_io::LoadError::NonFinite { .. }) => {
                format!("{error} (--repair)")
            }
            error => error.to_string(),
        })
    }
}

/// Adds the option that repairs the mesh, where it helps.
impl From<palpate::clod_build::BuildError> for Failure {
    fn from(error: palpate::clod_build::BuildError) -> Self {
        let option = if error.is_mended_by_repair() { " (--repair)" } else { "" };
        Self::Message(format!("{error}{option}"))
    }
}

/// Adds the option that the error is about.
impl From<palpate::representative::FieldError> for Failure {
    fn from(error: palpate::representative::FieldError) -> Self {
        let remedy = match error {
            palpate::representative::FieldError::Open { .. } => "; close it, or leave --representative out",
            palpate::representative::FieldError::Error { .. } => " (--representative)",
            palpate::representative::FieldError::FarFromOrigin { .. } => "",
        };
        Self::Message(format!("{error}{remedy}"))
    }
}

impl From<palpate::errors::SceneFileError> for Failure {
    fn from(error: palpate::errors::SceneFileError) -> Self {
        match error {
            palpate::errors::SceneFileError::Open(error) => error.into(),
            error => Self::Message(error.to_string()),
        }
    }
}

impl From<palpate::errors::RendererError> for Failure {
    fn from(error: palpate::errors::RendererError) -> Self {
        let units = match error {
            palpate::errors::RendererError::Units(units) => units,
            palpate::errors::RendererError::Field(error) => return error.into(),
            error => return Self::Message(error.to_string()),
        };
        let palpate::errors::UnitsError { name, radius, suggested } = units;
        let remedy = match suggested {
            Some(factor) => format!("multiply its scale (--scale, or --probe-scale or --scene-scale for it alone) by {factor}"),
            None => "give the metres per unit of its file as --scale, or for it alone as --probe-scale or --scene-scale".to_owned(),
        };
        Self::Message(format!(
            "{name}: the bounding radius of {radius:.3e} m suggests a wrong unit; {remedy}, or give --unusual-size to \
             accept it"
        ))
    }
}

impl From<palpate_measure::MeasureError> for Failure {
    fn from(error: palpate_measure::MeasureError) -> Self {
        match error {
            palpate_measure::MeasureError::Renderer(error) => error.into(),
            error => Self::Message(error.to_string()),
        }
    }
}

from_error!(palpate::device::PathError, palpate::models::ModelError, palpate_report::PlotError);
