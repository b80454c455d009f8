//! `palpate run`: renders a probe against a scene through a device.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::ProgressBar;
use palpate::device::{HapticDevice, HoldToEnable, RecordingWriter, Steering, Tap, Taps};
use palpate::errors::RendererError;
use palpate::settings::GripperSettings;
use palpate::tool::{HingedRecord, ToolFile};
use palpate::{
    ContactTiming, HapticRenderer, Object, Pose, Record, RecordWriter, Recorded, Scene, SceneFile, Session,
    Settings, Summary, explore,
};
use palpate_report::{Machine, Rendered, Report};

use crate::arguments::RunArguments;
use crate::failure::Failure;
use crate::textures::Detail;
use crate::{output, progress, textures};

/// Duration of a session without `--seconds`, s.
const DEFAULT_SECONDS: f64 = 10.0;
/// Largest duration of a session, s: a day.
const MAX_SECONDS: f64 = 86_400.0;
/// Largest number of steps in a report, which holds them in memory: about 1 GB.
const MAX_REPORTED_STEPS: f64 = 4e6;
/// Rate of contact queries under `--lockstep` without `--contact-rate`, Hz.
const DEFAULT_CONTACT_RATE: f64 = 500.0;

pub fn run(arguments: &RunArguments) -> Result<(), Failure> {
    match &arguments.tool {
        None => render(arguments, None),
        Some(tool) => render_tool(arguments, tool),
    }
}

/// `palpate view`: a session with a window.
pub fn view(arguments: &crate::arguments::ViewArguments) -> Result<(), Failure> {
    if !cfg!(feature = "view") {
        let (probe, scene) = (&arguments.run.probe, &arguments.run.scene);
        return Err(Failure::Message(format!(
            "this build has no window; build one with the cargo feature `view`: `{} {probe} {scene}`",
            view_command()
        )));
    }
    let screenshot = arguments.screenshot.clone();
    if arguments.run.tool.is_some() {
        return Err(Failure::Message(
            "--tool: a window shows a rigid probe; give it to `palpate run`".to_owned(),
        ));
    }
    if arguments.run.lockstep {
        return Err(Failure::Message(
            "--lockstep: a window shows real time; give it to `palpate run`".to_owned(),
        ));
    }
    if screenshot.is_some() && arguments.run.seconds.is_none() {
        return Err(Failure::Message(
            "--screenshot: give --seconds as well, after which it is taken".to_owned(),
        ));
    }
    render(&arguments.run, Some(Window { screenshot }))
}

/// A window in place of a progress bar.
struct Window {
    screenshot: Option<PathBuf>,
}

fn render(arguments: &RunArguments, window: Option<Window>) -> Result<(), Failure> {
    let seconds = arguments.seconds.unwrap_or(if window.is_some() { MAX_SECONDS } else { DEFAULT_SECONDS });
    let seconds = checked_seconds(seconds)?;
    check_rate(arguments.contact_rate)?;
    check_files(arguments, window.as_ref())?;
    let probe =
        textures::open(&arguments.probe, &arguments.textures.of_probe(), &arguments.reading.of_probe())?;
    let (scene, settings) = open_scene(arguments, &arguments.scene)?;
    let (settings, timing) = session_settings(arguments, settings, &probe, probe.bounding_radius())?;
    let (device, steering) = if window.is_some() {
        explore::open_steered_device(&arguments.device, &probe, &scene, &settings)?
    } else {
        (explore::open_device_for(&arguments.device, &probe, &scene, &settings)?, None)
    };
    if arguments.report.is_some() && seconds * settings.timing.rate > MAX_REPORTED_STEPS {
        let most = MAX_REPORTED_STEPS / settings.timing.rate;
        return Err(Failure::Message(format!(
            "--report takes at most {most} s; --record takes longer sessions"
        )));
    }
    let (device, taps) = wrapped(arguments, device)?;
    let shown = window.is_some();
    let mut renderer = prepared(|| HapticRenderer::new(probe, scene, device, settings))?;
    renderer.set_integrator(Arc::new(arguments.physics.integrator()));
    let rendered = Rendered::of(&renderer);

    let stop = stop_on_interrupt()?;
    let bar = progress::bar("rendering");
    let mut recorder = Recorder::open(arguments, taps, &bar, seconds)?;
    let sink = |row: &Record| recorder.take(row);
    let session = match window {
        Some(window) => show(renderer, steering, arguments, window, &stop, sink)?,
        None if arguments.lockstep => renderer.run_lockstep(seconds, timing, &stop, sink)?,
        None => renderer.run_realtime(seconds, &stop, sink)?,
    };
    bar.finish_and_clear();
    let summary = session.summary();
    let kept = recorder.close()?;
    if let (Some(records), Some(path)) = (kept, &arguments.report) {
        write_report(arguments, path, &summary, &records, &rendered)?;
    }
    print(arguments, &summary, &next_steps(arguments, shown))
}

/// Settings and timing of a session: those of the scene file, with the options of the command line.
fn session_settings(
    arguments: &RunArguments,
    settings: Settings,
    probe: &Object,
    radius: f64,
) -> Result<(Settings, ContactTiming), Failure> {
    let settings = arguments.physics.applied_to(arguments.textures.applied_to(settings), radius);
    let settings = arguments.resolution.applied_to(settings, probe)?;
    settings.check().map_err(RendererError::from)?;
    Ok((settings, timing(arguments, &settings)?))
}

/// Makes a renderer, with a spinner: distance fields may have to be made.
fn prepared<R>(make: impl FnOnce() -> Result<R, RendererError>) -> Result<R, Failure> {
    let waiting = progress::waiting("preparing contacts");
    let renderer = make();
    waiting.finish_and_clear();
    Ok(renderer?)
}

/// Writes the HTML report of a session.
fn write_report(
    arguments: &RunArguments,
    path: &Path,
    summary: &Summary,
    records: &[Record],
    rendered: &Rendered,
) -> Result<(), Failure> {
    let title = &format!("{} against {}", arguments.probe, arguments.scene);
    let words = std::env::args_os().map(|word| word.to_string_lossy().into_owned());
    let command = &words.collect::<Vec<_>>().join(" ");
    let report = Report { title, command, summary, records, rendered, machine: &Machine::this() };
    std::fs::write(path, report.to_html()?).map_err(|error| Failure::writing(path, error))
}

/// Prints the summary of a session, and lines after it.
fn print(arguments: &RunArguments, summary: &Summary, lines: &[String]) -> Result<(), Failure> {
    output::result(&arguments.json, summary, |table| {
        for (name, value) in palpate_report::measured(summary) {
            table.row([&name, &value]);
        }
        if !lines.is_empty() {
            table.row([]);
        }
        lines.iter().for_each(|line| table.row([line]));
    })
}

/// Renders a session with a tool with a hinge, without a window.
fn render_tool(arguments: &RunArguments, path: &Path) -> Result<(), Failure> {
    let seconds = checked_seconds(arguments.seconds.unwrap_or(DEFAULT_SECONDS))?;
    check_rate(arguments.contact_rate)?;
    check_files(arguments, None)?;
    let file = ToolFile::load(path)?;
    let tool = progress::open_all(&path.display().to_string(), |progress| file.open(path, progress))?;
    let (scene, settings) = open_scene(arguments, &arguments.probe)?;
    let radius = tool.first.bounding_radius().min(tool.second.bounding_radius());
    let (settings, timing) = session_settings(arguments, settings, &tool.first, radius)?;
    let device = explore::open_device_for(&arguments.device, &tool.first, &scene, &settings)?;
    let (device, taps) = wrapped(arguments, device)?;
    let gripper = GripperSettings::default();
    let renderer = prepared(|| HapticRenderer::hinged(&tool, scene, device, settings, &gripper))?;

    let stop = stop_on_interrupt()?;
    let bar = progress::bar("rendering");
    let mut recorder = Recorder::open(arguments, taps, &bar, seconds)?;
    let sink = |row: &HingedRecord| recorder.take(row);
    let session = if arguments.lockstep {
        renderer.run_lockstep(seconds, timing, &stop, sink)?
    } else {
        renderer.run_realtime(seconds, &stop, sink)?
    };
    bar.finish_and_clear();
    recorder.close()?;
    print(arguments, &session.summary(), &[])
}

/// Refuses a duration (s) that is out of range.
fn checked_seconds(seconds: f64) -> Result<f64, Failure> {
    if seconds > 0.0 && seconds <= MAX_SECONDS {
        return Ok(seconds);
    }
    Err(Failure::Message(format!("--seconds {seconds}: give more than 0, at most {MAX_SECONDS}")))
}

/// Wraps the device as the options require: with a button that enables it, and recorded.
fn wrapped(
    arguments: &RunArguments,
    device: Box<dyn HapticDevice>,
) -> Result<(Box<dyn HapticDevice>, Option<Tapped<'_>>), Failure> {
    let device = match arguments.enable_button {
        None => device,
        Some(button) => Box::new(HoldToEnable::new(device, button)) as Box<dyn HapticDevice>,
    };
    let Some(path) = &arguments.record_device else { return Ok((device, None)) };
    let (tap, taps) = Tap::new(device);
    let writer = RecordingWriter::create(path, tap.specification());
    let writer = writer.map_err(|error| Failure::writing(path, error))?;
    Ok((Box::new(tap), Some((path.as_path(), taps, writer))))
}

/// Hints on how to view the session.
fn next_steps(arguments: &RunArguments, shown: bool) -> Vec<String> {
    let (probe, scene) = (&arguments.probe, &arguments.scene);
    let report = match &arguments.report {
        Some(path) => format!("The report is {0}; open it in a browser: {OPENER} {0}", path.display()),
        None => "--report FILE.html writes a report with plots and a picture.".to_owned(),
    };
    let window = (!shown).then(|| format!("See it move in a window: {} {probe} {scene}", view_command()));
    std::iter::once(report).chain(window).collect()
}

/// Command that opens a file in a browser.
const OPENER: &str = if cfg!(windows) {
    "start"
} else if cfg!(target_os = "macos") {
    "open"
} else {
    "xdg-open"
};

/// Command that opens a window, with this build or another.
fn view_command() -> &'static str {
    if cfg!(feature = "view") {
        "palpate view"
    } else {
        "cargo run --release -p palpate-cli --features view -- view"
    }
}

/// Opens the scene, and reads the settings of a scene file.
fn open_scene(arguments: &RunArguments, scene: &str) -> Result<(Scene, Settings), Failure> {
    let path = Path::new(scene);
    let detail = arguments.textures.of_scene();
    if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml")) {
        let object = textures::open(scene, &detail, &arguments.reading.of_scene())?;
        return Ok((Scene::new().with(object, Pose::IDENTITY), Settings::default()));
    }
    if !matches!(detail, Detail::None) {
        let scene = path.display();
        return Err(Failure::Message(format!(
            "{scene}: --scene-heights and --scene-detail are for a single object"
        )));
    }
    if arguments.reading.is_scene_given() {
        let scene = path.display();
        return Err(Failure::Message(format!(
            "{scene}: --scene-scale and --scene-repair are for a single object; give `scale` and `repair` in the scene file"
        )));
    }
    let file = SceneFile::load(path)?;
    let scene = progress::open_all(scene, |progress| file.open(path, progress))?;
    for placed in scene.objects() {
        progress::warn_of_loading(&placed.object.name, placed.object.warnings());
    }
    Ok((scene, file.settings))
}

#[cfg(feature = "view")]
fn show(
    renderer: HapticRenderer,
    steering: Option<Steering>,
    arguments: &RunArguments,
    window: Window,
    stop: &AtomicBool,
    sink: impl FnMut(&Record) -> Result<(), Failure> + Send,
) -> Result<Session, Failure> {
    let options = palpate_view::ViewOptions {
        title: format!("palpate: {} against {}", arguments.probe, arguments.scene),
        seconds: arguments.seconds,
        screenshot: window.screenshot,
    };
    palpate_view::show(renderer, steering, &options, stop, sink).map_err(|error| match error {
        palpate_view::ViewError::Sink(failure) => failure,
        error => Failure::Message(error.to_string()),
    })
}

#[cfg(not(feature = "view"))]
fn show(
    _: HapticRenderer,
    _: Option<Steering>,
    _: &RunArguments,
    _: Window,
    _: &AtomicBool,
    _: impl FnMut(&Record) -> Result<(), Failure>,
) -> Result<Session, Failure> {
    Err(Failure::Message("there is no window without the feature `view`".to_owned()))
}

/// File of the path that an emulated hand follows, by the device's address.
fn followed(device: &str) -> Option<&str> {
    let followed = device.split_once("path=").filter(|_| device.starts_with("emulated"));
    followed.map(|(_, file)| file)
}

fn check_files(arguments: &RunArguments, window: Option<&Window>) -> Result<(), Failure> {
    let device = &arguments.device;
    let replayed = device.strip_prefix("replay:").or_else(|| followed(device)).map(Path::new);
    let named = [Path::new(&arguments.probe), Path::new(&arguments.scene)];
    let read: Vec<&Path> = named.into_iter().chain(arguments.tool.as_deref()).chain(replayed).collect();
    let given = [
        arguments.record.as_deref(),
        arguments.record_device.as_deref(),
        arguments.report.as_deref(),
        arguments.json.file(),
        window.and_then(|window| window.screenshot.as_deref()),
    ];
    let written: Vec<&Path> = given.into_iter().flatten().collect();
    output::check_files(&read, &written)
}

fn check_rate(given: Option<f64>) -> Result<(), Failure> {
    match given {
        Some(rate) if !(rate.is_finite() && rate > 0.0) => {
            Err(Failure::Message(format!("--contact-rate {rate}: give a rate above 0 Hz")))
        }
        _ => Ok(()),
    }
}

fn timing(arguments: &RunArguments, settings: &Settings) -> Result<ContactTiming, Failure> {
    let most = settings.timing.rate;
    match arguments.contact_rate {
        Some(rate) if rate > most => Err(Failure::Message(format!(
            "--contact-rate {rate}: the haptic loop takes one contact model per step, so it cannot exceed --rate; give at most \
             {most} Hz"
        ))),
        given => Ok(ContactTiming::busy(given.unwrap_or(DEFAULT_CONTACT_RATE))),
    }
}

/// Flag that Ctrl-C sets: the session then ends in order, with its recording complete.
fn stop_on_interrupt() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Release))
        .map_err(|error| Failure::Message(format!("Ctrl-C cannot be caught: {error}")))?;
    Ok(stop)
}

/// Readings of a device, and the file that they are written to.
type Tapped<'a> = (&'a Path, Taps, RecordingWriter<File>);

/// Recorder of a session's rows: writes them to a file as they come, and keeps them for a report.
struct Recorder<'a, R: Recorded> {
    file: Option<(&'a Path, RecordWriter<File, R>)>,
    device: Option<Tapped<'a>>,
    kept: Option<Vec<R>>,
    bar: &'a ProgressBar,
    seconds: f64,
}

impl<'a, R: Recorded> Recorder<'a, R> {
    fn open(
        arguments: &'a RunArguments,
        device: Option<Tapped<'a>>,
        bar: &'a ProgressBar,
        seconds: f64,
    ) -> Result<Self, Failure> {
        let file = match &arguments.record {
            None => None,
            Some(path) => {
                let file = RecordWriter::create(path).map_err(|error| Failure::writing(path, error))?;
                Some((path.as_path(), file))
            }
        };
        let kept = arguments.report.is_some().then(Vec::new);
        Ok(Self { file, device, kept, bar, seconds })
    }

    fn take(&mut self, row: &R) -> Result<(), Failure> {
        if let Some((path, file)) = &mut self.file {
            file.write(row).map_err(|error| Failure::writing(path, error))?;
        }
        if let Some(kept) = &mut self.kept {
            kept.push(*row);
        }
        self.take_readings()?;
        let time = row.row().next().unwrap_or(0.0);
        progress::set(self.bar, time / self.seconds);
        Ok(())
    }

    fn take_readings(&mut self) -> Result<(), Failure> {
        let Some((path, taps, writer)) = &mut self.device else { return Ok(()) };
        while let Some(reading) = taps.take() {
            writer.write(&reading).map_err(|error| Failure::writing(path, error))?;
        }
        Ok(())
    }

    /// Completes the files. Returns the rows that were kept for a report.
    fn close(mut self) -> Result<Option<Vec<R>>, Failure> {
        if let Some((path, file)) = self.file.take() {
            file.finish().map_err(|error| Failure::writing(path, error))?;
        }
        self.take_readings()?;
        if let Some((path, taps, writer)) = self.device.take() {
            writer.finish().map_err(|error| Failure::writing(path, error))?;
            if taps.lost() > 0 {
                let lost = format!("{} readings were lost: record to a faster disk", taps.lost());
                progress::warn(&path.display().to_string(), &[lost]);
            }
        }
        Ok(self.kept)
    }
}
