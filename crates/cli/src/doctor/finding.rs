//! Findings of the doctor.

use std::fmt;

use serde::Serialize;

/// Finding about one subject.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Name of the subject.
    pub name: &'static str,
    pub verdict: Verdict,
    /// Measurement or observation.
    pub measured: String,
    /// Remedy, if one is needed.
    pub remedy: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Verdict {
    #[serde(rename = "good")]
    Good,
    #[serde(rename = "could be better")]
    CouldBeBetter,
    #[serde(rename = "bad")]
    Bad,
    #[serde(rename = "unknown")]
    Unknown,
}

impl Finding {
    pub fn new(name: &'static str, verdict: Verdict, measured: String) -> Self {
        Self { name, verdict, measured, remedy: None }
    }

    #[must_use]
    pub fn with_remedy(self, remedy: impl Into<String>) -> Self {
        Self { remedy: Some(remedy.into()), ..self }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Good => "good",
            Self::CouldBeBetter => "could be better",
            Self::Bad => "bad",
            Self::Unknown => "unknown",
        })
    }
}
