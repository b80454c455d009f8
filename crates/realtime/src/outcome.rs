//! Outcomes of requests to the operating system.

use std::fmt;

use serde::Serialize;

/// State of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// The request was granted, perhaps not in full.
    Granted,
    /// The request was refused: a privilege is missing.
    Refused,
    /// The request was not made: it is of no use here, or not supported on this system.
    NotAsked,
}

/// Outcome of a request to the operating system.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Outcome {
    /// State of the request.
    pub state: State,
    /// Human-readable result, or the reason for a refusal.
    pub detail: String,
    /// Advice by which the request would be granted in full; `None` if there is nothing to do.
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

    /// Returns whether the request was granted.
    pub fn is_granted(&self) -> bool {
        self.state == State::Granted
    }
}

/// Writes the detail, and the remedy if there is one.
impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.detail)?;
        self.remedy.as_ref().map_or(Ok(()), |remedy| write!(f, "; {remedy}"))
    }
}
