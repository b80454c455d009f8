//! `palpate run`: renders a probe against a scene through a device.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::ProgressBar;
use palpate::{ContactTiming, HapticRenderer, Pose, Record, RecordWriter, Scene, Session, Summary};
use palpate_report::Report;

use crate::arguments::RunArguments;
use crate::failure::Failure;
use crate::{output, progress};

/// Longest session, s: a day.
const LONGEST: f64 = 86_400.0;

pub fn run(arguments: &RunArguments) -> Result<(), Failure> {
    let seconds = arguments.seconds;
    if !(seconds > 0.0 && seconds <= LONGEST) {
        return Err(Failure::Message(format!("--seconds {seconds}: give more than 0, at most {LONGEST}")));
    }
    let timing = timing(arguments)?;
    let options = arguments.reading.options();
    let probe = progress::open(&arguments.probe, &options)?;
    let object = progress::open(&arguments.scene, &options)?;
    let scene = Scene::new().with(object, Pose::IDENTITY);
    let settings = arguments.physics.settings(probe.bounding_radius());
    let device = palpate::explore::open_device(&arguments.device, &probe, &scene)?;
    let renderer = HapticRenderer::new(probe, scene, device, settings)?;

    let stop = stop_on_interrupt()?;
    let bar = progress::bar("rendering");
    let mut recorder = Recorder::open(arguments, &bar)?;
    let session = if arguments.lockstep {
        renderer.run_lockstep(seconds, timing, &stop, |row| recorder.take(row))?
    } else {
        renderer.run_realtime(seconds, &stop, |row| recorder.take(row))?
    };
    bar.finish_and_clear();
    let summary = session.summary();
    recorder.close(arguments, &summary)?;
    output::result(&arguments.json, &summary, |table| show(table, &session, &summary))
}

fn timing(arguments: &RunArguments) -> Result<ContactTiming, Failure> {
    let rate = arguments.contact_rate;
    if rate.is_finite() && rate > 0.0 {
        Ok(ContactTiming::busy(rate))
    } else {
        Err(Failure::Message(format!("--contact-rate {rate}: give a rate above 0 Hz")))
    }
}

/// A flag that Ctrl-C sets: the session then ends in order, with its recording complete.
fn stop_on_interrupt() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Release))
        .map_err(|error| Failure::Message(format!("Ctrl-C cannot be caught: {error}")))?;
    Ok(stop)
}

/// Takes the rows of a session: to a file as they come, and kept where a report wants them.
struct Recorder<'a> {
    file: Option<(&'a Path, RecordWriter<File>)>,
    kept: Option<Vec<Record>>,
    bar: &'a ProgressBar,
    seconds: f64,
}

impl<'a> Recorder<'a> {
    fn open(arguments: &'a RunArguments, bar: &'a ProgressBar) -> Result<Self, Failure> {
        let file = match &arguments.record {
            None => None,
            Some(path) => {
                let file = RecordWriter::create(path).map_err(|error| Failure::writing(path, error))?;
                Some((path.as_path(), file))
            }
        };
        let kept = arguments.report.is_some().then(Vec::new);
        Ok(Self { file, kept, bar, seconds: arguments.seconds })
    }

    fn take(&mut self, row: &Record) -> Result<(), Failure> {
        if let Some((path, file)) = &mut self.file {
            file.write(row).map_err(|error| Failure::writing(path, error))?;
        }
        if let Some(kept) = &mut self.kept {
            kept.push(*row);
        }
        progress::set(self.bar, row.time / self.seconds);
        Ok(())
    }

    fn close(self, arguments: &RunArguments, summary: &Summary) -> Result<(), Failure> {
        if let Some((path, file)) = self.file {
            file.finish().map_err(|error| Failure::writing(path, error))?;
        }
        if let (Some(records), Some(path)) = (self.kept, &arguments.report) {
            let title = format!("{} against {}", arguments.probe, arguments.scene);
            let command = std::env::args().collect::<Vec<_>>().join(" ");
            let report = Report { title: &title, command: &command, summary, records: &records };
            std::fs::write(path, report.to_html()?).map_err(|error| Failure::writing(path, error))?;
        }
        Ok(())
    }
}

fn show(table: &mut output::Table, session: &Session, summary: &Summary) {
    for (name, value) in palpate_report::measured(summary) {
        table.row([&name, &value]);
    }
    let faded = session.haptic.events.faded;
    if faded > 0 {
        table
            .row([&"note", &format!("the contact model was too old in {faded} steps; the wrench was faded")]);
    }
}
