//! Instruction counts of functions by valgrind's callgrind: without hardware counters, and reproducible.

use std::collections::HashMap;
use std::io;
use std::path::Path;
use std::process::Command;

/// Calls of a function, and the instructions in it and in its callees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cost {
    /// Number of calls.
    pub calls: u64,
    /// Instructions of all calls together.
    pub instructions: u64,
}

impl Cost {
    /// Returns instructions per call; `None` for a function that was never called.
    pub fn per_call(&self) -> Option<f64> {
        (self.calls > 0).then(|| self.instructions as f64 / self.calls as f64)
    }
}

/// Returns whether valgrind can be run.
pub fn is_installed() -> bool {
    Command::new("valgrind").arg("--version").output().is_ok_and(|output| output.status.success())
}

/// Runs a program under callgrind, and returns the costs of functions by parts of their names.
///
/// # Errors
/// If valgrind or the program fails, or the profile cannot be read.
pub fn count<const N: usize>(
    program: &Path,
    arguments: &[&str],
    functions: [&str; N],
    profile: &Path,
) -> io::Result<[Cost; N]> {
    let output = Command::new("valgrind")
        .arg("--tool=callgrind")
        .arg(format!("--callgrind-out-file={}", profile.display()))
        .arg(program)
        .args(arguments)
        .output()?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        return Err(io::Error::other(format!("valgrind on {}: {said}", program.display())));
    }
    let profile = std::fs::read_to_string(profile)?;
    Ok(functions.map(|function| of_calls(&profile, function)))
}

/// Returns the inclusive cost of all calls to functions whose names contain a part. Callgrind's format is
/// `cfn=(id) name`, with the name omitted once it is known, then `calls=N …`, then a line with a position and
/// the cost.
fn of_calls(profile: &str, part: &str) -> Cost {
    let mut named: HashMap<&str, bool> = HashMap::new();
    let mut total = Cost::default();
    let mut called = false;
    let mut lines = profile.lines();
    while let Some(line) = lines.next() {
        if let Some((kind, function)) = line.split_once('=').filter(|(kind, _)| matches!(*kind, "fn" | "cfn"))
        {
            let (id, name) = function.split_once(' ').unwrap_or((function, ""));
            // Uncompressed names are written in full.
            let known = if id.starts_with('(') { (!name.is_empty()).then_some(name) } else { Some(function) };
            let matches = match known {
                Some(name) => *named.entry(id).or_insert(name.contains(part)),
                None => named.get(id).copied().unwrap_or(false),
            };
            if kind == "cfn" {
                called = matches;
            }
        } else if let Some(calls) = line.strip_prefix("calls=") {
            let cost = lines.next().and_then(|line| line.split(' ').nth(1)?.parse::<u64>().ok());
            if std::mem::take(&mut called) {
                total.calls +=
                    calls.split(' ').next().and_then(|calls| calls.parse::<u64>().ok()).unwrap_or(0);
                total.instructions += cost.unwrap_or(0);
            }
        }
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn costs_of_calls_are_added_up_by_name() {
        let profile = "events: Ir\n\
                       fn=(1) main\n12 5\n\
                       cfn=(2) steps::counted_step\ncalls=3 40\n13 900\n\
                       cfn=(3) steps::other\ncalls=7 41\n+1 70\n\
                       fn=(2)\n40 300\n\
                       cfn=(3)\ncalls=3 41\n* 600\n\
                       fn=(4) more\n50 1\n\
                       cob=(1)\ncfi=(2)\ncfn=(2)\ncalls=1 40\n+2 310\n";
        assert_eq!(of_calls(profile, "counted_step"), Cost { calls: 4, instructions: 1210 });
        assert_eq!(of_calls(profile, "other"), Cost { calls: 10, instructions: 670 });
        assert_eq!(of_calls(profile, "absent").per_call(), None);
        let uncompressed = "fn=main\n1 2\ncfn=counted_step\ncalls=2 0\n1 50\ncfn=other\ncalls=1 0\n1 7\n";
        assert_eq!(of_calls(uncompressed, "counted_step").per_call(), Some(25.0));
    }
}
