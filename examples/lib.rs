//! Shared by the examples of palpate: `cargo run --release --example jaws` renders ten seconds in real time
//! and writes a recording and a report; `-- --lockstep` does the same on a simulated clock, reproducibly.

pub mod assembly;
mod command_line;

use std::error::Error;
use std::io::{Write, stdout};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use palpate::device::{Interpolation, Keyframe, MotionPath, PathError};
use palpate::errors::OpenError;
use palpate::models::Model;
use palpate::texture_pd::BakeOptions;
use palpate::{
    ContactTiming, HapticRenderer, Object, OpenOptions, Pose, Record, RecordWriter, Session, Summary,
};
use palpate_report::{Machine, Rendered, Report};

pub use command_line::{CommandLine, Options};

/// Angle from which edges of coarse meshes are creases, rad.
const CREASE: f64 = 0.6;

impl Options {
    /// Runs the session of the example of that name, writes its recording and its report, and prints the
    /// results. On the simulated clock, contacts are found 500 times a second.
    ///
    /// # Errors
    /// If a file cannot be written, or the session cannot start.
    pub fn render(
        &self,
        name: &str,
        title: &str,
        renderer: HapticRenderer,
    ) -> Result<(Session, Vec<Record>), Box<dyn Error>> {
        let folder = self.output.clone().unwrap_or_else(|| Path::new("target").join(name));
        std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        let recording = folder.join("recording.csv");
        let report = folder.join("report.html");

        let rendered = Rendered::of(&renderer);
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        ctrlc::set_handler(move || flag.store(true, Ordering::Release))?;
        let bar = bar("rendering");
        let mut writer = RecordWriter::create(&recording)?;
        let mut records = Vec::new();
        let sink = |row: &Record| {
            records.push(*row);
            bar.set_position((1000.0 * row.time / self.seconds) as u64);
            writer.write(row)
        };
        let session = if self.lockstep {
            renderer.run_lockstep(self.seconds, ContactTiming::busy(500.0), &stop, sink)?
        } else {
            renderer.run_realtime(self.seconds, &stop, sink)?
        };
        bar.finish_and_clear();
        writer.finish()?;

        let summary = session.summary();
        for (name, value) in palpate_report::measured(&summary) {
            say(name, value)?;
        }
        say("written", shown(&recording).display())?;
        write_report(&report, title, &summary, &records, &rendered)?;
        Ok((session, records))
    }
}

/// Writes a report with plots, and prints its path.
///
/// # Errors
/// If it cannot be written.
pub fn write_report(
    file: &Path,
    title: &str,
    summary: &Summary,
    records: &[Record],
    rendered: &Rendered,
) -> Result<(), Box<dyn Error>> {
    let words = std::env::args_os().map(|word| word.to_string_lossy().into_owned());
    let command = words.collect::<Vec<_>>().join(" ");
    let html = Report { title, command: &command, summary, records, rendered, machine: &Machine::this() }
        .to_html()?;
    std::fs::write(file, html).map_err(|error| format!("{}: {error}", file.display()))?;
    Ok(say("written", shown(file).display())?)
}

/// Opens a mesh file, a .clod file or a built-in model, with its hierarchy built or from the cache.
///
/// # Errors
/// If there is no such file or model, or the mesh cannot be used.
pub fn open(name: &str) -> Result<Object, Box<dyn Error>> {
    let [object] = open_all([name])?;
    Ok(object)
}

/// Opens several objects in parallel.
///
/// # Errors
/// The same as [`open`].
pub fn open_all<const N: usize>(names: [&str; N]) -> Result<[Object; N], Box<dyn Error>> {
    let bars = MultiProgress::new();
    let opened = std::thread::scope(|scope| {
        let begun = names.map(|name| scope.spawn(|| open_one(name, &bars)));
        begun.map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    });
    let mut objects = Vec::new();
    for object in opened {
        let object = object?;
        let (triangles, patches) = (object.clod.source.triangles, object.clod.leaves().len());
        say(&object.name, format_args!("{triangles} triangles, {patches} convex patches"))?;
        objects.push(object);
    }
    objects.try_into().map_err(|_| "not all objects were opened".into())
}

fn open_one(name: &str, bars: &MultiProgress) -> Result<Object, OpenError> {
    let mut shown = None;
    let object = Object::open(name, &OpenOptions::default(), &mut |stage, fraction| {
        let bar = shown.get_or_insert_with(|| {
            // If progress bars are hidden, a line says why it takes time.
            let _ = bars.suspend(|| say(name, "building contact levels of detail, cached for the next run"));
            bars.add(bar(name))
        });
        bar.set_message(format!("{name}: {stage}"));
        bar.set_position((1000.0 * stage.of_build(fraction)) as u64);
        ControlFlow::Continue(())
    });
    if let Some(bar) = shown {
        bar.finish_and_clear();
    }
    object
}

/// Returns a built-in model with so many triangles and a texture, with texels of a size (m), baked from it at
/// full resolution.
///
/// # Errors
/// If there is no such model, or it cannot have that size.
pub fn detailed(name: &str, coarse: usize, texel: f64) -> Result<Object, Box<dyn Error>> {
    let bar = bar(name);
    bar.set_message(format!("{name}: baking"));
    let (model, triangles) = Model::parse(name)?;
    let (coarse, full) = (model.generate(coarse)?, model.generate(triangles)?);
    let options = BakeOptions { texel, reach: None, crease: CREASE };
    let (object, report) = Object::detailed(name, &coarse, &full, &options, &mut |fraction| {
        bar.set_position((1000.0 * fraction) as u64);
        ControlFlow::Continue(())
    })?;
    bar.finish_and_clear();
    let patches = object.clod.leaves().len();
    let sizes = (full.triangles().len(), coarse.triangles().len());
    say(name, format_args!("{} triangles on {}, {patches} convex patches. {report}", sizes.0, sizes.1))?;
    Ok(object)
}

/// Returns the intended path of an object as 100 poses a second, from the pose at a time (s).
///
/// # Errors
/// If a pose is out of a path's range.
pub fn path(seconds: f64, intended: impl Fn(f64) -> Pose) -> Result<MotionPath, PathError> {
    // Slightly longer than the session, so that the hand never reaches the end of its path.
    let samples = ((seconds + 0.1) * 100.0) as usize + 1;
    let keyframe = |sample: usize| {
        let time = sample as f64 / 100.0;
        Keyframe { time, pose: intended(time) }
    };
    MotionPath::new((0..samples).map(keyframe).collect(), Interpolation::Smooth)
}

/// Prints a line of a table.
///
/// # Errors
/// If the terminal is closed.
pub fn say(name: &str, value: impl std::fmt::Display) -> std::io::Result<()> {
    writeln!(stdout(), "{name:36}{value}")
}

/// Returns a smooth step from 0 at 0 to 1 at 1, with zero slope at both.
pub fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// Returns a progress bar on the terminal, from 0 to 1000.
fn bar(message: &str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:36}{bar:30} {percent:>3} %, {eta} left");
    let bar = ProgressBar::new(1000).with_message(message.to_owned());
    if let Ok(style) = style { bar.with_style(style) } else { bar }
}

/// Returns the absolute path.
fn shown(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}
