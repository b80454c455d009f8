//! What was found about one subject.

use std::fmt;

use serde::Serialize;

/// What was found about one subject.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The subject.
    pub name: &'static str,
    pub verdict: Verdict,
    /// What was measured or seen.
    pub measured: String,
    /// What to do about it; none where nothing needs doing.
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
