//! What palpate's results look like to a person: self-contained HTML [`Report`]s of sessions with plots over time,
//! figures and pictures of contact levels of detail ([`Table32`], [`LevelFigures`], [`LevelPictures`]), [plots](draw),
//! [logarithmic ones](draw_log_log) and
//! [heat maps](draw_heat_maps) of other measurements, and pictures of meshes drawn in software ([`raster`], [`sheet`], [`views`]).

mod heat_map;
mod lettering;
mod level_pictures;
mod levels;
mod live;
mod log_plot;
mod machine;
mod patches;
mod plot;
pub mod raster;
mod series;
pub mod sheet;
pub mod views;

use std::fmt::Write;

use palpate::{Record, Summary};

pub use heat_map::{Boundary, CellAxis, HeatMap, draw_heat_maps};
pub use level_pictures::{LevelPictures, grouped};
pub use levels::{LevelFigures, Spread, Table32};
pub use live::{COLUMN, Extremes, Live, Rates};
pub use log_plot::{LogAxis, LogPlot, draw_log_log};
pub use machine::Machine;
pub use plot::{Curve, Figure, PlotError, draw};

/// What a report is about.
#[derive(Clone, Copy, Debug)]
pub struct Report<'a> {
    /// Title, for example "upper-jaw against lower-jaw".
    pub title: &'a str,
    /// The command that made it.
    pub command: &'a str,
    /// What the session measured of itself.
    pub summary: &'a Summary,
    /// The recording, in order of time.
    pub records: &'a [Record],
}

impl Report<'_> {
    /// The report as one HTML document without references to other files.
    ///
    /// # Errors
    /// If a plot cannot be drawn.
    pub fn to_html(&self) -> Result<String, PlotError> {
        let mut plots = String::new();
        for figure in series::figures(self.records) {
            plots.push_str("<figure>");
            plots.push_str(&plot::draw(std::slice::from_ref(&figure))?);
            let _ = writeln!(plots, "<figcaption>{}</figcaption></figure>", escape(&figure.caption));
        }
        let mut rows = String::new();
        for (name, value) in measured(self.summary) {
            let _ = writeln!(rows, "<tr><th>{}</th><td>{}</td></tr>", escape(name), escape(&value));
        }
        Ok(format!(
            include_str!("report.html"),
            title = escape(self.title),
            command = escape(self.command),
            rows = rows,
            plots = plots,
        ))
    }
}

/// What a session measured, as rows of a name and a value for a person to read.
pub fn measured(summary: &Summary) -> Vec<(&'static str, String)> {
    let Summary { haptic, contact, .. } = summary;
    // On a simulated clock no step is late.
    let real = |value: String| {
        if haptic.scheduling == "lockstep" { "none: simulated clock".to_owned() } else { value }
    };
    let mut rows = vec![
        ("duration", format!("{:.3} s", summary.seconds)),
        ("haptic rate", format!("{:.1} Hz, {} steps", haptic.rate_hz, haptic.steps)),
        ("missed deadlines", real(haptic.missed_deadlines.to_string())),
        ("haptic step", percentiles(&haptic.step_ns, "ns")),
        ("wake-up lateness", real(percentiles(&haptic.wake_us, "µs"))),
        ("scheduling of the haptic thread", haptic.scheduling.clone()),
        ("contact rate", format!("{:.1} Hz", contact.rate_hz)),
        ("contact query time", percentiles(&contact.query_us, "µs")),
        ("deepest penetration", format!("{:.4} mm", 1e3 * summary.depth_max)),
        ("largest coupling force", format!("{:.3} N", summary.coupling_force_max)),
        ("smallest energy at the device port", format!("{:.6} J", summary.energy_min_j)),
    ];
    rows.extend(summary.stages.iter().map(|(&stage, why)| (stage, why.clone())));
    let events = serde_json::to_value(summary.events).unwrap_or_default();
    let counted = events.as_object().into_iter().flatten().filter(|(_, count)| count.as_u64() != Some(0));
    let counted: Vec<String> = counted.map(|(name, count)| format!("{name}: {count}")).collect();
    rows.push(("events", if counted.is_empty() { "none".to_owned() } else { counted.join(", ") }));
    rows
}

fn percentiles(p: &palpate::Percentiles, unit: &str) -> String {
    format!("median {:.1}, p99 {:.1}, p99.9 {:.1}, max {:.1} {unit}", p.p50, p.p99, p.p999, p.max)
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
