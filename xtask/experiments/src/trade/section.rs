//! Measurements on a scenario as text, JSON and plots, and all of them as a section of the page.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use palpate_report::{Curve, LogAxis, LogPlot, draw_log_log};
use serde_json::{Value, json};

use super::cost::Instructions;
use super::measured::Measured;
use super::pareto::front;
use super::variation::Axis;
use super::{Trade, scenario};

/// Smallest relative error that plots distinguish.
const MIN_PLOTTED_ERROR: f64 = 1e-4;

/// Columns of the printed table after the first, which is the setting.
const COLUMNS: [&str; 11] = [
    "contact step, µs",
    "p99",
    "k instr.",
    "haptic step, ns",
    "instr.",
    "MB",
    "force off, %",
    "torque off, %",
    "correlation",
    "above 20 Hz, N",
    "depth, mm / margin",
];

impl Measured {
    fn is_of_the_haptic_step(&self) -> bool {
        matches!(self.variation.axis, Axis::Integrator | Axis::HapticRate)
    }

    fn cells(&self, counted: Option<&Instructions>) -> [String; COLUMNS.len()] {
        let Self { contact, haptic, bytes, felt, penetration, stability_margin, .. } = self;
        let share =
            |off: f64, of: f64| if of > 0.0 { format!("{:.1}", 100.0 * off / of) } else { "-".to_owned() };
        let count = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.0}"));
        [
            format!("{:.1}", 1e6 * contact[0]),
            format!("{:.1}", 1e6 * contact[1]),
            count(counted.map(|counted| 1e-3 * counted.contact)),
            format!("{:.0}", 1e9 * haptic[0]),
            count(counted.map(|counted| counted.haptic)),
            format!("{:.1}", *bytes as f64 / 1e6),
            share(felt.force.mean, felt.force.exact_rms),
            share(felt.torque.mean, felt.torque.exact_rms),
            format!("{:.3}", felt.force.correlation),
            format!("{:.4}", felt.force.vibration),
            format!("{:.3} / {stability_margin}", 1e3 * penetration),
        ]
    }

    fn value(&self, scenario: &str, counted: Option<&Instructions>) -> Value {
        let Self { variation, contact, haptic, bytes, rendered, felt, penetration, stability_margin } = self;
        json!({
            "scenario": scenario,
            "axis": variation.axis.word(),
            "value": variation.value,
            "contact_us": contact.map(|seconds| 1e6 * seconds),
            "haptic_ns": haptic.map(|seconds| 1e9 * seconds),
            "contact_instructions": counted.map(|counted| counted.contact),
            "haptic_instructions": counted.map(|counted| counted.haptic),
            "bytes": bytes,
            "rendered": rendered,
            "felt": felt,
            "felt_error": self.felt_error(),
            "penetration": penetration,
            "stability_margin": stability_margin,
            "cells": self.cells(counted),
        })
    }
}

impl Trade {
    /// Returns a table for a person; a star marks Pareto-optimal settings.
    pub fn text(&self) -> String {
        let mut lines = vec![[vec![self.scenario.to_owned()], COLUMNS.map(str::to_owned).to_vec()].concat()];
        let best = self.best();
        for (index, measured) in self.rows.iter().enumerate() {
            let star = if best[index] { " *" } else { "" };
            let name = format!("{} {}{star}", measured.variation.axis.word(), measured.variation.value);
            lines.push([vec![name], measured.cells(self.counted(index)).to_vec()].concat());
        }
        let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..=COLUMNS.len()).map(width).collect();
        let mut text = String::new();
        for line in &lines {
            let cells = line.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}"));
            let _ = writeln!(text, "{}", cells.collect::<Vec<_>>().join("  ").trim_end());
        }
        text
    }

    /// Returns the measurements as JSON values.
    pub fn values(&self) -> Vec<Value> {
        let best = self.best();
        let value = |(index, measured): (usize, &Measured)| {
            let mut value = measured.value(self.scenario, self.counted(index));
            value["best"] = best[index].into();
            value
        };
        self.rows.iter().enumerate().map(value).collect()
    }

    /// Stores the measurements with their plots in a folder.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn keep(&self, folder: &Path) -> Result<(), String> {
        let text = serde_json::to_string_pretty(&self.values()).map_err(|error| error.to_string())?;
        let mut files = vec![(kept(folder, self.scenario), text)];
        for (kind, plot) in self.plots()? {
            files.push((folder.join(format!("trade-{}-{kind}.svg", self.scenario)), plot));
        }
        for (path, text) in files {
            std::fs::write(&path, text).map_err(|error| format!("{}: {error}", path.display()))?;
        }
        Ok(())
    }

    /// Returns the instructions with a setting, where they were counted.
    pub fn counted(&self, index: usize) -> Option<&Instructions> {
        self.instructions.get(index)?.as_ref()
    }

    /// Returns which settings are Pareto-optimal, among those of the contact step and among those of the
    /// haptic step.
    fn best(&self) -> Vec<bool> {
        let front_of = |haptic: bool| {
            let none = (f64::NAN, f64::NAN);
            let point =
                |row: &Measured| if row.is_of_the_haptic_step() == haptic { point(row) } else { none };
            front(&self.rows.iter().map(point).collect::<Vec<_>>())
        };
        front_of(false).into_iter().zip(front_of(true)).map(|(contact, haptic)| contact || haptic).collect()
    }

    /// Plots accuracy over time: of settings of the contact step, and of those of the haptic step, where
    /// there are any.
    ///
    /// # Errors
    /// If a plot cannot be drawn.
    pub fn plots(&self) -> Result<Vec<(&'static str, String)>, String> {
        let has = |haptic: bool| self.rows.iter().any(|row| row.is_of_the_haptic_step() == haptic);
        let kinds = [("contact", false), ("haptic", true)].into_iter().filter(|(_, haptic)| has(*haptic));
        kinds.map(|(kind, haptic)| Ok((kind, self.plot(haptic)?))).collect()
    }

    fn plot(&self, haptic: bool) -> Result<String, String> {
        let rows = || self.rows.iter().filter(|row| row.is_of_the_haptic_step() == haptic);
        let points: Vec<(f64, f64)> = rows().map(point).collect();
        let mut best: Vec<(f64, f64)> = front(&points)
            .into_iter()
            .zip(&points)
            .filter(|(best, _)| *best)
            .map(|(_, point)| *point)
            .collect();
        best.sort_by(|x, y| x.0.total_cmp(&y.0));
        let scattered = Axis::ALL.into_iter().filter_map(|axis| {
            let points: Vec<(f64, f64)> =
                rows().filter(|row| row.variation.axis == axis).map(point).collect();
            (!points.is_empty()).then(|| Curve { name: axis.word().to_owned(), points })
        });
        let (step, marks) = if haptic {
            ("haptic step, ns", vec![1e3, 2e3, 5e3, 1e4, 2e4])
        } else {
            ("contact step, µs", vec![10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1e3, 2e3, 5e3, 1e4])
        };
        let within = |mark: &f64| {
            let reach = points
                .iter()
                .fold((f64::INFINITY, 0.0_f64), |(low, high), (x, _)| (low.min(*x), high.max(*x)));
            *mark > 0.5 * reach.0 && *mark < 2.0 * reach.1
        };
        let plot = LogPlot {
            title: format!("{}: what is felt, against time", self.scenario),
            x: LogAxis { name: format!("median {step}"), marks: marks.into_iter().filter(within).collect() },
            y: LogAxis { name: "wrench at the device off by, %".to_owned(), marks: vec![1.0, 10.0, 100.0] },
            curves: vec![Curve { name: "none is better".to_owned(), points: best }],
            scattered: scattered.collect(),
        };
        draw_log_log(&plot).map_err(|error| error.to_string())
    }
}

/// Returns median time, µs or ns, and error, %.
fn point(row: &Measured) -> (f64, f64) {
    let time = if row.is_of_the_haptic_step() { 1e9 * row.haptic[0] } else { 1e6 * row.contact[0] };
    (time, 100.0 * row.felt_error().max(MIN_PLOTTED_ERROR))
}

fn kept(folder: &Path, scenario: &str) -> PathBuf {
    folder.join(format!("trade-{scenario}.json"))
}

/// Removes the measurements of a scenario from a folder.
///
/// # Errors
/// If they exist and cannot be removed.
pub fn forget(folder: &Path, scenario: &str) -> Result<(), String> {
    let path = kept(folder, scenario);
    match std::fs::remove_file(&path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(format!("{}: {error}", path.display()))
        }
        _ => Ok(()),
    }
}

/// Returns the section of the page, from the measurements that runs have left in a folder; `None` if there
/// are none.
///
/// # Errors
/// If a file cannot be parsed.
pub fn section(folder: &Path) -> Result<Option<String>, String> {
    let (mut parts, mut missing) = (String::new(), Vec::new());
    for name in scenario::names() {
        let path = kept(folder, name);
        let Ok(text) = std::fs::read_to_string(&path) else {
            missing.push(name);
            continue;
        };
        let rows: Vec<Value> =
            serde_json::from_str(&text).map_err(|error| format!("{}: {error}", path.display()))?;
        let _ = write!(parts, "<h3>{name}</h3>");
        for kind in ["contact", "haptic"] {
            let plot = folder.join(format!("trade-{name}-{kind}.svg"));
            parts.push_str(&std::fs::read_to_string(plot).unwrap_or_default());
        }
        let heads: String = COLUMNS.iter().map(|name| format!("<th>{name}</th>")).collect();
        let _ = write!(parts, "<table><tr><th></th>{heads}</tr>");
        for row in &rows {
            let words = |value: &Value| value.as_str().unwrap_or_default().to_owned();
            let cells = row["cells"].as_array().map_or(&[][..], Vec::as_slice);
            let cells: String = cells.iter().map(|cell| format!("<td>{}</td>", words(cell))).collect();
            let name = format!("{} {}", words(&row["axis"]), words(&row["value"]));
            let name = if row["best"] == true { format!("<b>{name}</b>") } else { name };
            let _ = write!(parts, "<tr><td>{name}</td>{cells}</tr>");
        }
        parts.push_str("</table>");
    }
    if parts.is_empty() {
        return Ok(None);
    }
    if !missing.is_empty() {
        let missing = missing.join(", ");
        let _ = write!(
            parts,
            "<p>Not here, for want of their files or because they were not run: {missing}.</p>"
        );
    }
    Ok(Some(format!(
        "<section id=\"trade\"><h2>Speed against accuracy</h2><p>Made by <code>cargo xtask trade</code>. One setting is \
         changed at a time, and the same hand does the same. What is off, and correlates, is the wrench at the device, against a session \
         at full resolution with a contact step in each haptic step; the margin is by how much stiffer contacts may be with the \
         object at rest. In bold: settings that none betters in both time and accuracy.</p>{parts}</section>"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_shows_the_results_of_earlier_runs() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(section(folder.path()), Ok(None));
        let row = json!({"axis": "s0", "value": "1 %", "cells": ["12.5"], "best": true});
        std::fs::write(kept(folder.path(), "golf"), json!([row]).to_string()).unwrap();
        std::fs::write(folder.path().join("trade-golf-contact.svg"), "<svg>plot</svg>").unwrap();
        let html = section(folder.path()).unwrap().unwrap();
        for said in ["<b>s0 1 %</b>", "<td>12.5</td>", "<svg>plot</svg>", "not run: jaws, ball-joint,"] {
            assert!(html.contains(said), "{said}: {html}");
        }
        forget(folder.path(), "golf").unwrap();
        assert_eq!(section(folder.path()), Ok(None));
    }
}
