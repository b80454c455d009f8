//! An emulated hand moves an upper jaw over a lower one: it opens, closes, grinds sideways and back and forth, and opens.
//!
//! `cargo run --release --example jaws` renders ten seconds in real time and writes a recording and a report;
//! `-- --lockstep` does the same on a simulated clock, with the same result each time.

use std::error::Error;
use std::f64::consts::TAU;
use std::io::{Write, stdout};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use palpate::device::{Emulation, Interpolation, Keyframe, MotionPath};
use palpate::glam::DVec3;
use palpate::{ContactTiming, HapticRenderer, Object, OpenOptions, Pose, RecordWriter, Scene, Settings};
use palpate_report::Report;

#[derive(Parser)]
struct Arguments {
    /// Simulated clock, one thread, reproducible
    #[arg(long)]
    lockstep: bool,
    /// How long to render, s; at most an hour
    #[arg(long, default_value_t = 10.0, value_parser = seconds)]
    seconds: f64,
    /// Folder for the recording and the report
    #[arg(long, default_value = "target/jaws")]
    output: PathBuf,
}

fn seconds(text: &str) -> Result<f64, String> {
    let within = |seconds: &f64| *seconds > 0.0 && *seconds <= 3600.0;
    text.parse().ok().filter(within).ok_or_else(|| "give more than 0 and at most 3600".to_owned())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    let folder = &arguments.output;
    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let recording = folder.join("recording.csv");
    let report = folder.join("report.html");

    let upper = open("upper-jaw")?;
    let lower = open("lower-jaw")?;
    let path = MotionPath::new(chewing(arguments.seconds), Interpolation::Smooth)?;
    let device = Emulation::default().open(path)?;
    let scene = Scene::new().with(lower, Pose::IDENTITY);
    // Contact begins at 0.1 mm: a small part of the teeth's relief.
    let settings = Settings { tolerance: Some(1e-4), ..Settings::default() };
    let renderer = HapticRenderer::new(upper, scene, Box::new(device), settings)?;

    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Release))?;
    let bar = bar("rendering");
    let mut writer = RecordWriter::create(&recording)?;
    let mut records = Vec::new();
    let sink = |row: &palpate::Record| {
        records.push(*row);
        bar.set_position((1000.0 * row.time / arguments.seconds) as u64);
        writer.write(row)
    };
    let session = if arguments.lockstep {
        renderer.run_lockstep(arguments.seconds, ContactTiming::busy(500.0), &stop, sink)?
    } else {
        renderer.run_realtime(arguments.seconds, &stop, sink)?
    };
    bar.finish_and_clear();
    writer.finish()?;

    let summary = session.summary();
    let words = std::env::args_os().map(|word| word.to_string_lossy().into_owned());
    let command = words.collect::<Vec<_>>().join(" ");
    let title = "Upper jaw over lower jaw";
    let html = Report { title, command: &command, summary: &summary, records: &records }.to_html()?;
    std::fs::write(&report, html)?;
    for (name, value) in palpate_report::measured(&summary) {
        writeln!(stdout(), "{name:36}{value}")?;
    }
    for file in [&recording, &report] {
        writeln!(stdout(), "{:36}{}", "written", shown(file).display())?;
    }
    Ok(())
}

/// Where the hand means the upper jaw to be, as 100 poses a second. The jaws are closed when their frames coincide; the
/// hand bites 3 mm further, which its springiness turns into a force.
fn chewing(seconds: f64) -> Vec<Keyframe> {
    const OPEN: f64 = 8e-3;
    const BITE: f64 = -3e-3;
    // A little longer than the session, so that the hand never comes to the end of its path.
    let samples = ((seconds + 0.1) * 100.0) as usize + 1;
    (0..samples)
        .map(|sample| {
            let time = sample as f64 / 100.0;
            let phase = (time / 10.0).fract();
            let ramp = |from: f64, to: f64| {
                let x = ((phase - from) / (to - from)).clamp(0.0, 1.0);
                x * x * (3.0 - 2.0 * x)
            };
            let closed = ramp(0.0, 0.3) - ramp(0.8, 1.0);
            let grinding = ramp(0.3, 0.35) - ramp(0.7, 0.75);
            let sideways = 3e-3 * (TAU * 5.0 * phase).sin() * grinding;
            let forth = 2e-3 * (TAU * 3.0 * phase).sin() * grinding;
            let offset = DVec3::new(sideways, forth, OPEN + (BITE - OPEN) * closed);
            Keyframe { time, pose: Pose::from_translation(offset) }
        })
        .collect()
}

fn open(name: &str) -> Result<Object, Box<dyn Error>> {
    let bar = bar(name);
    let (object, _) = Object::open(name, &OpenOptions::default(), &mut |stage, fraction| {
        bar.set_message(format!("{name}: {stage}"));
        bar.set_position((1000.0 * fraction) as u64);
        ControlFlow::Continue(())
    })?;
    bar.finish_and_clear();
    let source = &object.clod.source;
    let patches = object.clod.leaves().len();
    writeln!(stdout(), "{name:36}{} triangles, {patches} convex patches", source.triangles)?;
    Ok(object)
}

/// A progress bar on the terminal, from 0 to 1000.
fn bar(message: &str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:36}{bar:30} {percent:>3} %");
    let bar = ProgressBar::new(1000).with_message(message.to_owned());
    if let Ok(style) = style { bar.with_style(style) } else { bar }
}

/// The absolute path, to be found from anywhere.
fn shown(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}
