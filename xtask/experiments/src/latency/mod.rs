//! Delays of a session in real time while other programs keep the processors busy.
//!
//! `cargo xtask latency [--seconds S] [--busy N] [--normal-pump]` renders two jaws for an emulated hand whose
//! device is behind a simulated wire, so that all threads of a session with a real device run: the device's
//! pump, the haptic and the contact thread, and the recorder.

mod wire;

use std::convert::Infallible;
use std::error::Error;
use std::sync::atomic::{AtomicBool, Ordering};

use palpate::telemetry::Percentiles;
use palpate::{HapticRenderer, Object, Pose, Record, Scene, Session, Settings, Summary, explore};

use wire::Noted;

/// Arguments of `cargo xtask latency`.
#[derive(clap::Args, Clone, Debug)]
pub struct Arguments {
    /// Length of the session, s.
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
    /// Number of threads at normal priority that keep the processors busy.
    #[arg(long, default_value_t = 2)]
    busy: usize,
    /// Leaves the device's pump at normal priority, for comparison.
    #[arg(long)]
    normal_pump: bool,
    /// Object in the hand.
    #[arg(long, default_value = "lower-jaw@5000")]
    probe: String,
    /// Object that it touches.
    #[arg(long, default_value = "upper-jaw@5000")]
    scene: String,
}

/// Largest acceptable ages at p99.9, in periods of the haptic loop: of a wrench when it is written, and when
/// the next one replaces it. The device asks for the next one up to a period of its own later.
const MAX_AGE_WRITTEN: f64 = 2.0;
const MAX_AGE_REPLACED: f64 = 3.0;

/// Renders, and prints the delays.
///
/// # Errors
/// If a model is unknown, or the session cannot start.
pub fn run(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    if !(arguments.seconds > 0.0 && arguments.seconds.is_finite()) {
        return Err(format!("--seconds {}: give more than 0", arguments.seconds).into());
    }
    let (session, noted) = measure(arguments)?;
    print(arguments, &session.summary(), &noted);
    Ok(())
}

fn measure(arguments: &Arguments) -> Result<(Session, Noted), Box<dyn Error>> {
    let (probe, scene) = (Object::model(&arguments.probe)?, Object::model(&arguments.scene)?);
    let scene = Scene::new().with(scene, Pose::IDENTITY);
    let hand = explore::open_device("emulated", &probe, &scene)?;
    let (device, shared) = wire::wired(hand, arguments.normal_pump)?;
    let renderer = HapticRenderer::new(probe, scene, Box::new(device), Settings::default())?;
    let (stop, idle) = (AtomicBool::new(false), AtomicBool::new(false));
    let session = std::thread::scope(|scope| {
        for _ in 0..arguments.busy {
            scope.spawn(|| {
                while !idle.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            });
        }
        let session = renderer.run_realtime(arguments.seconds, &stop, |_: &Record| Ok::<_, Infallible>(()));
        idle.store(true, Ordering::Relaxed);
        session
    });
    let Ok(session) = session;
    let noted = shared.noted().clone();
    Ok((session, noted))
}

fn print(arguments: &Arguments, summary: &Summary, noted: &Noted) {
    let Arguments { seconds, busy, probe, scene, .. } = arguments;
    println!("{probe} against {scene}, {seconds} s, {busy} busy threads");
    if let Some(setup) = &summary.realtime {
        let threads = [("haptic", Some(&setup.haptic)), ("contact", setup.contact.as_ref())];
        let device = if arguments.normal_pump { None } else { setup.device.as_ref() };
        for (name, thread) in [("device", device)].into_iter().chain(threads) {
            println!("{name:8} {}", thread.map_or("normal, as asked".to_owned(), |it| it.scheduling_line()));
        }
        println!("{:8} {}", "memory", setup.memory);
    }
    println!("\n{:44}{:>10}{:>10}{:>10}{:>10}", "µs", "median", "p99", "p99.9", "max");
    let scaled = |of: &Percentiles, by: f64| [of.p50, of.p99, of.p999, of.max].map(|it| it * by);
    let rows = [
        ("haptic wake-up, lateness", scaled(&summary.haptic.wake_us, 1.0)),
        ("haptic step", scaled(&summary.haptic.step_ns, 1e-3)),
        ("contact query", scaled(&summary.contact.query_us, 1.0)),
        ("wrench, age when written", scaled(&noted.written.percentiles(1e3), 1.0)),
        ("wrench, age when the next one was written", scaled(&noted.replaced.percentiles(1e3), 1.0)),
        ("time between writes", scaled(&noted.between.percentiles(1e3), 1.0)),
    ];
    for (name, values) in rows {
        let values: String = values.iter().map(|value| format!("{value:>10.1}")).collect();
        println!("{name:44}{values}");
    }
    let haptic = &summary.haptic;
    println!("\n{} steps, {}", haptic.steps, haptic.missed_verdict());
    println!("{} writes, {} dropouts of force", noted.written.count(), noted.dropouts);
    let period = 1e3 / Settings::default().timing.rate;
    let [written, in_force] = [&noted.written, &noted.replaced].map(|ages| ages.percentiles(1e6).p999);
    let good =
        written < MAX_AGE_WRITTEN * period && in_force < MAX_AGE_REPLACED * period && noted.dropouts == 0;
    println!(
        "at p99.9, {written:.3} ms old when written (below {MAX_AGE_WRITTEN} periods) and {in_force:.3} ms when replaced (below {MAX_AGE_REPLACED}), without a \
         dropout: {}",
        if good { "holds" } else { "falls short" }
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All threads run, and each written wrench has an age.
    #[test]
    fn each_written_wrench_has_an_age() {
        let arguments = Arguments {
            seconds: 0.5,
            busy: 0,
            normal_pump: false,
            probe: "ellipsoid@500".to_owned(),
            scene: "golf-ball@1000".to_owned(),
        };
        let (session, noted) = measure(&arguments).expect("measured");
        let (writes, steps) = (noted.written.count(), session.haptic.steps);
        assert!(writes > 50 && steps > 50, "{writes} writes, {steps} steps");
        assert_eq!(noted.replaced.count(), noted.between.count());
        assert!(noted.replaced.percentiles(1.0).p50 >= noted.written.percentiles(1.0).p50);
        let setup = session.summary().realtime.expect("in real time");
        assert!(setup.device.is_some(), "the device has a thread");
    }
}
