//! Any device, any two models: contact force, live in the terminal.
//!
//! `cargo run --release --features terminal --example feel -- [PROBE SCENE] --device ADDRESS`
//!
//! Without a device, the keys move an emulated hand. If the output is not a terminal, the hand explores the
//! scene by itself, and only the summary is printed.

mod screen;

use std::error::Error;
use std::io::{IsTerminal, stdin, stdout};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use palpate::device::Steering;
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{ContactSettings, DeviceSettings};
use palpate::{HapticRenderer, Pose, Record, Scene, Session, Settings, explore};
use palpate_examples::{CommandLine, open, say, write_report};
use palpate_report::{Live, Rendered};
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// Displacement of the hand per key press, bounding radii of the probe, and rotation, rad.
const STEP: f64 = 0.02;
const TURN: f64 = 0.05;
/// Time between two drawings.
const FRAME: Duration = Duration::from_millis(50);

struct Arguments {
    probe: String,
    scene: String,
    device: String,
    /// Length of the session, s.
    seconds: f64,
    workspace_scale: f64,
    friction: f64,
    report: Option<PathBuf>,
}

const HELP: [&str; 7] = [
    "PROBE SCENE    The objects: mesh files, .clod files or built-in models [default: ellipsoid@2000 golf-ball@20000]",
    "--device D     emulated, emulated:PRESET,task=press, replay:FILE, spacemouse, ...: one that `palpate devices` lists",
    "--seconds S    Render for so long, at most an hour [default: 60]",
    "--workspace-scale S",
    "               The object moves so far for a metre at the device [default: 1]",
    "--friction MU  Coefficient of friction [default: 0]",
    "--report FILE  Write an HTML report with plots",
];

impl Arguments {
    fn parse() -> Result<Self, Box<dyn Error>> {
        let mut line =
            CommandLine::new("Feels one model touch another, with a live display in the terminal", &HELP);
        let report: String = line.value("--report", String::new())?;
        let device = line.value("--device", "emulated".to_owned())?;
        let seconds = line.seconds(60.0)?;
        let workspace_scale = line.value("--workspace-scale", 1.0)?;
        let friction = line.value("--friction", 0.0)?;
        let (probe, scene) = match &line.others()?[..] {
            [] => ("ellipsoid@2000".to_owned(), "golf-ball@20000".to_owned()),
            [probe, scene] => (probe.clone(), scene.clone()),
            _ => return Err("give two objects, or none: see --help".into()),
        };
        let report = (!report.is_empty()).then(|| report.into());
        Ok(Self { probe, scene, device, seconds, workspace_scale, friction, report })
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse()?;
    let probe = open(&arguments.probe)?;
    let scene = Scene::new().with(open(&arguments.scene)?, Pose::IDENTITY);
    let step = STEP * probe.bounding_radius();
    let on_terminal = stdout().is_terminal() && stdin().is_terminal();
    let settings = Settings {
        device: DeviceSettings { workspace_scale: arguments.workspace_scale, ..DeviceSettings::default() },
        contact: ContactSettings { friction: arguments.friction, ..ContactSettings::default() },
        ..Settings::default()
    };
    let period = 1.0 / settings.timing.rate;
    let (device, steering) = if on_terminal {
        explore::open_steered_device(&arguments.device, &probe, &scene, &settings)?
    } else {
        (explore::open_device_for(&arguments.device, &probe, &scene, &settings)?, None)
    };
    let renderer = HapticRenderer::new(probe, scene, device, settings)?;
    let rendered = Rendered::of(&renderer);
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Release))?;

    let title = format!("{} against {}", arguments.probe, arguments.scene);
    let mut records = Vec::new();
    let keep = |record: &Record| {
        if arguments.report.is_some() {
            records.push(*record);
        }
    };
    let session = if on_terminal {
        let live = Live::new(renderer.device().specification(), period);
        let keyboard = steering.map(|steering| Keyboard { steering, step: step / arguments.workspace_scale });
        show(renderer, arguments.seconds, live, &title, keyboard, &stop, keep)?
    } else {
        run(renderer, arguments.seconds, &stop, keep)
    };
    for (name, value) in palpate_report::measured(&session.summary()) {
        say(name, value)?;
    }
    if let Some(report) = &arguments.report {
        write_report(report, &title, &session.summary(), &records, &rendered)?;
    }
    Ok(())
}

fn run(renderer: HapticRenderer, seconds: f64, stop: &AtomicBool, mut keep: impl FnMut(&Record)) -> Session {
    let Ok(session) = renderer.run_realtime(seconds, stop, |record| {
        keep(record);
        Ok::<(), std::convert::Infallible>(())
    });
    session
}

/// Runs the session in a thread of its own, and shows it in this one until it ends or the user ends it.
fn show(
    renderer: HapticRenderer,
    seconds: f64,
    live: Live,
    title: &str,
    mut keyboard: Option<Keyboard>,
    stop: &AtomicBool,
    mut keep: impl FnMut(&Record) + Send,
) -> Result<Session, Box<dyn Error>> {
    let keys = if keyboard.is_some() { KEYS } else { "q ends" };
    // Records are received by the recorder's thread, which may wait; the haptic thread never does.
    let live = Mutex::new(live);
    let live = &live;
    let locked = || live.lock().unwrap_or_else(PoisonError::into_inner);
    let mut terminal = ratatui::init();
    let session = std::thread::scope(|scope| {
        let session = scope.spawn(|| {
            run(renderer, seconds, stop, |record| {
                keep(record);
                locked().take(record);
            })
        });
        let mut outcome = Ok(());
        while !session.is_finished() {
            let seen = locked().clone();
            outcome = terminal
                .draw(|frame| screen::draw(frame, &seen, title, keys))
                .and_then(|_| take_keys(&mut keyboard, stop));
            if outcome.is_err() {
                stop.store(true, Ordering::Release);
                break;
            }
        }
        (session.join(), outcome)
    });
    ratatui::restore();
    let (session, outcome) = session;
    let session = session.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    outcome?;
    Ok(session)
}

/// Handles the keys that are pressed until the next drawing is due.
fn take_keys(keyboard: &mut Option<Keyboard>, stop: &AtomicBool) -> std::io::Result<()> {
    let mut patience = FRAME;
    while event::poll(patience)? {
        patience = Duration::ZERO;
        let Event::Key(key) = event::read()? else { continue };
        if ends(&key) {
            stop.store(true, Ordering::Release);
        } else if let Some(keyboard) = keyboard {
            keyboard.press(key.code);
        }
    }
    Ok(())
}

/// Returns whether a key ends the session. Ctrl-C arrives as a key, since the terminal is in raw mode.
fn ends(key: &KeyEvent) -> bool {
    let interrupted = key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
    key.kind != KeyEventKind::Release
        && (interrupted || matches!(key.code, KeyCode::Char('q') | KeyCode::Esc))
}

const KEYS: &str = "arrows: move in x and y   PageUp, PageDown or w, s: up and down   a, d: turn   q: end";

/// Keys that steer an emulated hand.
struct Keyboard {
    steering: Steering,
    /// Displacement per key press, m.
    step: f64,
}

impl Keyboard {
    fn press(&mut self, key: KeyCode) {
        let (step, turn) = match key {
            KeyCode::Right => (DVec3::X, 0.0),
            KeyCode::Left => (DVec3::NEG_X, 0.0),
            KeyCode::Up => (DVec3::Y, 0.0),
            KeyCode::Down => (DVec3::NEG_Y, 0.0),
            KeyCode::PageUp | KeyCode::Char('w') => (DVec3::Z, 0.0),
            KeyCode::PageDown | KeyCode::Char('s') => (DVec3::NEG_Z, 0.0),
            KeyCode::Char('a') => (DVec3::ZERO, TURN),
            KeyCode::Char('d') => (DVec3::ZERO, -TURN),
            _ => return,
        };
        let Pose { translation, rotation } = self.steering.aimed();
        let rotation = (DQuat::from_rotation_z(turn) * rotation).normalize();
        self.steering.aim(Pose::new(translation + step * self.step, rotation));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_steer_and_end() {
        let (steering, _path) = Steering::new(Pose::IDENTITY);
        let mut keyboard = Keyboard { steering, step: 1e-3 };
        for key in [
            KeyCode::Right,
            KeyCode::Right,
            KeyCode::Down,
            KeyCode::PageUp,
            KeyCode::Char('a'),
            KeyCode::Char('x'),
        ] {
            keyboard.press(key);
        }
        let aimed = keyboard.steering.aimed();
        assert!(aimed.translation.distance(DVec3::new(2e-3, -1e-3, 1e-3)) < 1e-15);
        assert!(aimed.rotation.angle_between(DQuat::from_rotation_z(TURN)) < 1e-12);
        let pressed = |code, modifiers| ends(&KeyEvent::new(code, modifiers));
        assert!(pressed(KeyCode::Char('q'), KeyModifiers::NONE) && pressed(KeyCode::Esc, KeyModifiers::NONE));
        assert!(
            pressed(KeyCode::Char('c'), KeyModifiers::CONTROL)
                && !pressed(KeyCode::Char('c'), KeyModifiers::NONE)
        );
    }
}
