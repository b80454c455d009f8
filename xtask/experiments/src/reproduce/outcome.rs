//! Outcomes of the experiments.

use std::fmt::Write as _;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::stability::page::Table;

/// Claim of the dissertation with our measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Claim of the dissertation.
    pub claim: String,
    /// Measured result, in numbers.
    pub measured: String,
    /// Condition under which the claim holds.
    pub condition: String,
    /// Whether the condition is met.
    pub holds: bool,
}

/// Finding with the values that it is based on.
#[derive(Clone, Debug)]
pub struct Reproduction {
    pub finding: Finding,
    pub table: Table,
    /// Times, which differ from run to run.
    pub timing: Option<Table>,
    /// Plot, an SVG document.
    pub plot: String,
}

impl Reproduction {
    /// Writes values and plot into a folder.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, folder: &Path, name: &str) -> Result<(), String> {
        self.table.write(folder)?;
        self.timing.iter().try_for_each(|timing| timing.write(folder))?;
        let path = folder.join(format!("{name}.svg"));
        std::fs::write(&path, &self.plot).map_err(|error| format!("cannot write {}: {error}", path.display()))
    }
}

/// Finding in the form in which it is printed and stored.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct Outcome {
    pub name: String,
    pub claim: String,
    pub measured: String,
    pub condition: String,
    /// "holds" or "falls short".
    pub verdict: String,
    /// Wall time of the experiment, s.
    pub seconds: f64,
}

impl Outcome {
    pub fn new(name: String, finding: Finding, seconds: f64) -> Self {
        let Finding { claim, measured, condition, holds } = finding;
        let verdict = if holds { "holds" } else { "falls short" };
        let verdict = verdict.to_owned();
        Self { name, claim, measured, condition, verdict, seconds: (seconds * 100.0).round() / 100.0 }
    }
}

impl Outcome {
    /// Stores the outcome in a folder.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), String> {
        let path = folder.join(format!("{}.json", self.name));
        let text = serde_json::to_string_pretty(self).map_err(|error| error.to_string())?;
        std::fs::write(&path, text).map_err(|error| format!("cannot write {}: {error}", path.display()))
    }

    /// Removes the outcome of that name from a folder.
    ///
    /// # Errors
    /// If it exists and cannot be removed.
    pub fn forget(folder: &Path, name: &str) -> Result<(), String> {
        let path = folder.join(format!("{name}.json"));
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(format!("cannot remove {}: {error}", path.display()))
            }
            _ => Ok(()),
        }
    }

    /// Reads the outcome of that name from a folder; `None` if there is none.
    ///
    /// # Errors
    /// If its file has other contents.
    pub fn read(folder: &Path, name: &str) -> Result<Option<Self>, String> {
        let path = folder.join(format!("{name}.json"));
        let Ok(text) = std::fs::read_to_string(&path) else { return Ok(None) };
        serde_json::from_str(&text).map(Some).map_err(|error| format!("{}: {error}", path.display()))
    }
}

/// Width of the table's text, characters.
const WIDTH: usize = 96;

/// Formats outcomes as text: names, verdicts and times, with claim, condition and measurement below each.
pub fn table(outcomes: &[Outcome]) -> String {
    let mut text = String::new();
    for Outcome { name, claim, measured, condition, verdict, seconds } in outcomes {
        let _ = writeln!(text, "{name:10} {verdict:12} {seconds:8.1} s");
        for (title, said) in [("claim", claim), ("condition", condition), ("measured", measured)] {
            for (index, line) in wrapped(said).iter().enumerate() {
                let title = if index == 0 { title } else { "" };
                let _ = writeln!(text, "  {title:10} {line}");
            }
        }
    }
    text
}

/// Breaks a text at spaces into lines of [`WIDTH`].
fn wrapped(text: &str) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let fits = |line: &String| line.is_empty() || line.chars().count() + word.chars().count() < WIDTH;
        match lines.last_mut() {
            Some(line) if fits(line) => {
                if !line.is_empty() {
                    line.push(' ');
                }
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outcomes_print_as_table_and_json() {
        let words = |count| vec!["word"; count].join(" ");
        let finding = Finding { claim: words(50), measured: words(1), condition: words(2), holds: false };
        let outcome = Outcome::new("fig-0.0".to_owned(), finding, 1.234);
        let text = table(std::slice::from_ref(&outcome));
        assert_eq!(text.matches("word").count(), 53, "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH + 13), "{text}");
        assert!(text.starts_with("fig-0.0    falls short       1.2 s\n"), "{text}");
        let json = serde_json::to_value(&outcome).unwrap();
        let keys = ["name", "claim", "measured", "condition", "verdict", "seconds"];
        assert!(keys.iter().all(|key| json.get(key).is_some()), "{json}");
        assert_eq!(json["seconds"], 1.23);
    }
}
