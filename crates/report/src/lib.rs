//! Presentation of palpate's results: self-contained HTML [`Report`]s of sessions with plots over time,
//! figures and pictures of contact levels of detail ([`Table32`], [`LevelFigures`], [`LevelPictures`]),
//! [plots](draw), [logarithmic plots](draw_log_log) and [heat maps](draw_heat_maps) of other measurements,
//! and pictures of meshes drawn in software ([`raster`], [`sheet`], [`views`]).

mod events;
mod heat_map;
mod lettering;
mod level_pictures;
mod levels;
mod live;
mod log_plot;
mod machine;
mod patches;
mod picture;
mod plot;
mod quantity;
pub mod raster;
mod scene_picture;
mod series;
mod settings_table;
pub mod sheet;
mod summary;
pub mod views;

use std::fmt::Write;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use palpate::{HapticRenderer, Object, Record, Scene, Settings, Summary};

use scene_picture::Moment;

pub use events::{Counted, EVENTS};
pub use heat_map::{Boundary, CellAxis, HeatMap, draw_heat_maps};
pub use level_pictures::{LevelPictures, grouped};
pub use levels::{LevelFigures, Spread, Table32};
pub use live::{COLUMN, Extremes, Live, Rates};
pub use log_plot::{LogAxis, LogPlot, draw_log_log};
pub use machine::Machine;
pub use picture::Picture;
pub use plot::{Curve, Figure, PlotError, draw};
pub use summary::measured;

/// Contents of a report.
#[derive(Clone, Copy, Debug)]
pub struct Report<'a> {
    /// Title, for example "upper-jaw against lower-jaw".
    pub title: &'a str,
    /// Command that made the report.
    pub command: &'a str,
    /// Summary of the session.
    pub summary: &'a Summary,
    /// Recording, in order of time.
    pub records: &'a [Record],
    /// Settings and objects of the session.
    pub rendered: &'a Rendered,
    /// Machine on which the session ran.
    pub machine: &'a Machine,
}

/// Settings and objects of a session. They are kept separately, because running consumes the renderer.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// Settings in force.
    pub settings: Settings,
    /// Grasped object.
    pub probe: Object,
    /// Scene that it touches.
    pub scene: Scene,
}

impl Rendered {
    /// Returns the settings and objects of a renderer; objects are shared with it.
    pub fn of(renderer: &HapticRenderer) -> Self {
        Self {
            settings: *renderer.settings_in_force(),
            probe: renderer.probe().clone(),
            scene: renderer.scene().clone(),
        }
    }
}

impl Report<'_> {
    /// Returns the report as an HTML document without references to other files.
    ///
    /// # Errors
    /// If a plot or the picture cannot be drawn.
    pub fn to_html(&self) -> Result<String, PlotError> {
        let mut plots = String::new();
        for figure in series::figures(self.records, self.summary.grasp) {
            plots.push_str("<figure>");
            plots.push_str(&plot::draw(std::slice::from_ref(&figure))?);
            let _ = writeln!(plots, "<figcaption>{}</figcaption></figure>", escape(&figure.caption));
        }
        Ok(format!(
            include_str!("report.html"),
            title = escape(self.title),
            command = escape(self.command),
            picture = self.picture()?,
            rows = table(&measured(self.summary)),
            plots = plots,
            settings = table(&settings_table::rows(&self.rendered.settings)),
            machine = table(&[
                ("build", self.machine.build()),
                ("processor", self.machine.processor_line()),
                ("kernel", self.machine.kernel.clone().unwrap_or_else(|| "unknown".to_owned())),
            ]),
        ))
    }

    /// Returns the picture of the scene as an HTML figure; empty for an empty recording.
    fn picture(&self) -> Result<String, PlotError> {
        let Some(moment) = Moment::of(self.records) else { return Ok(String::new()) };
        let Rendered { probe, scene, .. } = self.rendered;
        let png = scene_picture::png(probe, scene, &moment.record.object)?;
        let caption = moment.caption(&probe.name);
        Ok(format!(
            "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{}\"><figcaption>{caption}</figcaption></figure>",
            BASE64_STANDARD.encode(png),
            caption = escape(&caption),
        ))
    }
}

/// Returns rows of an HTML table.
fn table<N: AsRef<str>>(rows: &[(N, String)]) -> String {
    rows.iter().fold(String::new(), |mut text, (name, value)| {
        let _ = writeln!(text, "<tr><th>{}</th><td>{}</td></tr>", escape(name.as_ref()), escape(value));
        text
    })
}

/// Escapes text for HTML.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
