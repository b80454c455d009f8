//! Session in real time that is logged to Rerun: the jaws, or any two meshes or models, touched by an
//! emulated hand.
//!
//! `cargo run --release -p palpate-rerun --example watch_in_rerun [-- PROBE OBJECT]` writes `session.rrd`,
//! which `rerun session.rrd` shows; with `--connect` it sends the log to a running viewer.

#![allow(clippy::print_stdout, reason = "it prints the file name")]

use std::error::Error;
use std::sync::atomic::AtomicBool;

use palpate::clod_build::unwatched;
use palpate::device::{Emulation, Task};
use palpate::{HapticRenderer, Object, OpenOptions, Pose, Scene, Settings, explore};
use palpate_rerun::re_sdk::RecordingStreamBuilder;
use palpate_rerun::{SessionLog, layout};

const SECONDS: f64 = 10.0;
const FILE: &str = "session.rrd";

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let connect = arguments.iter().any(|argument| argument == "--connect");
    arguments.retain(|argument| argument != "--connect");
    let (probe, object) = match arguments.as_slice() {
        [] => ("upper-jaw@5000", "lower-jaw@5000"),
        [probe, object] if !probe.starts_with('-') => (probe.as_str(), object.as_str()),
        _ => return Err("usage: watch_in_rerun [--connect] [PROBE OBJECT]".into()),
    };
    let open = |name: &str| Object::open(name, &OpenOptions::default(), &mut unwatched);
    let (probe, object) = (open(probe)?, open(object)?);
    let scene = Scene::new().with(object, Pose::IDENTITY);
    let device = Emulation::default().open(explore::path(Task::default(), &probe, &scene)?)?;
    let mut renderer =
        HapticRenderer::new(probe.clone(), scene.clone(), Box::new(device), Settings::default())?;

    let stream = RecordingStreamBuilder::new("palpate").with_default_blueprint(layout());
    let stream = if connect { stream.connect_grpc()? } else { stream.save(FILE)? };
    let mut log = SessionLog::new(stream, &probe, &scene)?;
    let mut contacts = renderer.contact_monitor();
    // Records are taken in this thread; the threads of the two loops do not log.
    let session = renderer.run_realtime(SECONDS, &AtomicBool::new(false), |record| {
        log.contacts(contacts.latest())?;
        log.record(record)
    })?;
    log.finish()?;
    let summary = session.summary();
    println!(
        "{} steps, {} deadlines missed; {}",
        summary.haptic.steps,
        summary.haptic.missed_deadlines,
        if connect { "they are in the viewer".to_owned() } else { format!("`rerun {FILE}` shows them") }
    );
    Ok(())
}
