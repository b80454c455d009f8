//! Effect of scene edits on the haptic step: sessions in real time, without changes of the scene and with
//! large objects added, moved, replaced and removed all the time.
//!
//! `cargo bench -p palpate-benches --bench scene_edits [-- --seconds 20 --model golf-ball]`

#![expect(clippy::print_stdout, reason = "prints a table")]

use std::error::Error;
use std::time::{Duration, Instant};

use clap::Parser;
use palpate::device::{Emulation, Task};
use palpate::glam::DVec3;
use palpate::{HapticRenderer, Object, Pose, Scene, SceneEditor, Settings, Summary, explore};

#[derive(Parser)]
struct Arguments {
    /// Length of each session, s.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Model that is added and removed.
    #[arg(long, default_value = "golf-ball")]
    model: String,
    /// Argument that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

/// Time between changes.
const EDIT_INTERVAL: Duration = Duration::from_millis(40);

fn main() -> Result<(), Box<dyn Error>> {
    let Arguments { seconds, model, .. } = Arguments::parse();
    let large = Object::model(&model)?;
    large.shape();
    println!("{model}: {} triangles\n", large.clod.source.triangles);
    println!(
        "| scene | changes | haptic step p50, p99, p99.9, max | wake-up p99.9 | missed | contact step p99, max |"
    );
    println!("|---|---|---|---|---|---|");
    for (name, edited) in [("still", false), ("edited", true), ("still again", false)] {
        let (changes, summary) = session(&large, seconds, edited)?;
        let Summary { haptic, contact, .. } = &summary;
        let (step, wake, query) = (&haptic.step_ns, &haptic.wake_us, &contact.query_us);
        println!(
            "| {name} | {changes} | {:.0}, {:.0}, {:.0}, {:.0} ns | {:.0} µs | {} | {:.0}, {:.0} µs |",
            step.p50, step.p99, step.p999, step.max, wake.p999, haptic.missed_deadlines, query.p99, query.max
        );
    }
    Ok(())
}

/// Runs a session; returns the number of changes, and its summary.
fn session(large: &Object, seconds: f64, edited: bool) -> Result<(usize, Summary), Box<dyn Error>> {
    let probe = Object::model("ellipsoid@500")?;
    let scene = Scene::new().with(Object::model("golf-ball@5000")?, Pose::IDENTITY);
    let device = Emulation::default().open(explore::path(Task::Scrub, &probe, &scene)?)?;
    let renderer = HapticRenderer::new(probe, scene, Box::new(device), Settings::default())?;
    let mut running = renderer.spawn()?;
    let begun = Instant::now();
    let mut changes = 0;
    while begun.elapsed().as_secs_f64() < seconds {
        if edited {
            changes += change(&mut running.scene, large, changes)?;
        }
        std::thread::sleep(EDIT_INTERVAL);
    }
    Ok((changes, running.stop()?.summary()))
}

/// Adds a large object away from the probe, moves, scales or removes it.
fn change(scene: &mut SceneEditor, large: &Object, so_far: usize) -> Result<usize, Box<dyn Error>> {
    let at = |step: f64| Pose::from_translation((0.5 + 0.001 * step) * DVec3::X);
    let id = scene.add(large, at(0.0))?;
    scene.set_pose(id, at(so_far as f64))?;
    // A new hierarchy each time, made by the caller.
    let grown = large.scaled(1.0 + 1e-3 * (so_far % 7) as f64).ok_or("the object cannot be scaled")?;
    scene.replace(id, &grown, at(1.0))?;
    scene.remove(id)?;
    Ok(4)
}
