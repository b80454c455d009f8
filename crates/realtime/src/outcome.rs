//! What came of a request.

use std::fmt;

use serde::Serialize;

/// Whether a request was granted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Yes, if perhaps not in full.
    Granted,
    /// No: a privilege is absent.
    Refused,
    /// It was not made: there is no use for it here, or no such thing on this system.
    NotAsked,
}

/// What came of a request to the operating system.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Outcome {
    /// Whether it was granted.
    pub state: State,
    /// What was obtained, or why not, for a person to read.
    pub detail: String,
    /// What would let it be granted in full; none where nothing needs doing.
    pub remedy: Option<String>,
}

impl Outcome {
    pub(crate) fn granted(detail: impl Into<String>) -> Self {
        Self { state: State::Granted, detail: detail.into(), remedy: None }
    }

    pub(crate) fn refused(detail: impl Into<String>) -> Self {
        Self { state: State::Refused, detail: detail.into(), remedy: None }
    }

    pub(crate) fn not_asked(detail: impl Into<String>) -> Self {
        Self { state: State::NotAsked, detail: detail.into(), remedy: None }
    }

    /// Whether it was granted.
    pub fn is_granted(&self) -> bool {
        self.state == State::Granted
    }
}

/// What was obtained, or why not, and what to do about it.
impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.detail)?;
        self.remedy.as_ref().map_or(Ok(()), |remedy| write!(f, "; {remedy}"))
    }
}
