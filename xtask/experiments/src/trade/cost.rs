//! Instructions of contact and haptic steps, counted by callgrind in a separate process.
//!
//! Virtual machines seldom have hardware counters, and times on shared machines vary by tens of per cent;
//! instruction counts are reproducible. The work is written to a file that the process reads: recorded states
//! of the grasped object, and settings. Callgrind is enabled when all is loaded, counts only within one
//! function, and writes its count before each call of it.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;

use palpate::core::Clod;
use palpate::device::{Interpolation, Keyframe, MotionPath, ReplayDevice};
use palpate::dynamics::{BodyState, IntegratorKind};
use palpate::{ContactUpdate, HapticRenderer, Object, Pose, Scene, Settings, Twist};
use palpate_benches::callgrind;
use serde::{Deserialize, Serialize};

use super::scenario::{self, Scenario};

/// Number of contact steps before counting begins, and with those that are counted.
const WARM_UP: usize = 8;
const STATES: usize = WARM_UP + 16;
/// Number of counted haptic steps.
const HAPTIC_STEPS: u32 = 50;

/// Work of a counting process.
#[derive(Deserialize, Serialize)]
pub struct Job {
    scenario: String,
    /// Hierarchies of probe and scene object, if these define the objects completely.
    hierarchies: Option<[PathBuf; 2]>,
    /// Poses and velocities of the centre of mass, and the time between them, s.
    states: Vec<(Pose, Twist)>,
    period: f64,
    settings: Vec<(Settings, IntegratorKind)>,
}

/// Mean instructions of a contact step and of a haptic step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instructions {
    pub contact: f64,
    pub haptic: f64,
}

impl Job {
    /// Returns a job with the states nearest to the middle of a path.
    pub fn new(
        scenario: &Scenario,
        states: &[BodyState],
        period: f64,
        settings: Vec<(Settings, IntegratorKind)>,
    ) -> Self {
        let first = (states.len() / 2).saturating_sub(STATES / 2);
        let states = states.iter().skip(first).take(STATES);
        let states = states.map(|state| (state.pose, state.twist)).collect();
        Self { scenario: scenario.name.to_owned(), hierarchies: None, states, period, settings }
    }

    /// Counts instructions for each of the settings; `None` if valgrind is not installed.
    ///
    /// # Errors
    /// If the process fails, or callgrind's output cannot be parsed.
    pub fn count(mut self, scenario: &Scenario, folder: &Path) -> Result<Option<Vec<Instructions>>, String> {
        if !callgrind::is_installed() {
            return Ok(None);
        }
        let folder = folder.join(format!("callgrind-{}", self.scenario));
        let fail =
            |what: &str, error: &dyn std::fmt::Display| format!("{}: {what}: {error}", folder.display());
        if folder.exists() {
            std::fs::remove_dir_all(&folder).map_err(|error| fail("cannot be removed", &error))?;
        }
        std::fs::create_dir_all(&folder).map_err(|error| fail("cannot be made", &error))?;
        if let (false, [placed]) = (scenario.textured, scenario.scene.objects()) {
            let files = ["probe.clod", "scene.clod"].map(|name| folder.join(name));
            for (object, file) in [&scenario.probe, &placed.object].into_iter().zip(&files) {
                object.clod.save(file).map_err(|error| error.to_string())?;
            }
            self.hierarchies = Some(files);
        }
        let job = folder.join("job.json");
        let text = serde_json::to_string(&self).map_err(|error| error.to_string())?;
        std::fs::write(&job, text).map_err(|error| fail("cannot be written", &error))?;
        let program = std::env::current_exe().map_err(|error| error.to_string())?;
        let output = Command::new("valgrind")
            .args(["--tool=callgrind", "--instr-atstart=no", "--collect-atstart=no", "--quiet"])
            .args([
                format!("--toggle-collect={COUNTED_FUNCTION}"),
                format!("--dump-before={COUNTED_FUNCTION}"),
            ])
            .arg(format!("--callgrind-out-file={}", folder.join("out").display()))
            .arg(program)
            .args(["trade", "--counted"])
            .arg(&job)
            .output()
            .map_err(|error| fail("valgrind cannot be started", &error))?;
        if !output.status.success() {
            return Err(fail("valgrind failed", &String::from_utf8_lossy(&output.stderr).trim()));
        }
        let counts = dumps(&folder)?;
        let expected = 2 * self.settings.len();
        if counts.len() != expected {
            return Err(fail("callgrind", &format!("{} counts in place of {expected}", counts.len())));
        }
        let per_step = |pair: &[f64]| Instructions {
            contact: pair[0] / self.states.len().saturating_sub(WARM_UP).max(1) as f64,
            haptic: pair[1] / f64::from(HAPTIC_STEPS),
        };
        Ok(Some(counts.chunks(2).map(per_step).collect()))
    }

    fn objects(&self) -> Result<(Object, Scene), String> {
        let Some([probe, scene]) = &self.hierarchies else {
            let scenario = scenario::open(&self.scenario)?;
            let scenario = scenario.ok_or_else(|| format!("{}: its files are absent", self.scenario))?;
            return Ok((scenario.probe, scenario.scene));
        };
        let load = |file: &Path| {
            let clod = Clod::load(file).map_err(|error| error.to_string())?;
            Ok::<_, String>(Object::from_clod(&self.scenario, clod))
        };
        Ok((load(probe)?, Scene::new().with(load(scene)?, Pose::IDENTITY)))
    }

    /// Runs the counted functions.
    fn run(&self) -> Result<(), String> {
        let (probe, scene) = self.objects()?;
        let states: Vec<BodyState> =
            self.states.iter().map(|&(pose, twist)| BodyState { pose, twist }).collect();
        let last = states.last().ok_or("no states")?;
        switch_on()?;
        for (settings, integrator) in &self.settings {
            let center = probe.clod.source.center_of_mass;
            let here = Keyframe { time: 0.0, pose: last.pose * Pose::from_translation(-center) };
            let path =
                MotionPath::new(vec![here], Interpolation::Linear).map_err(|error| error.to_string())?;
            let device = Box::new(ReplayDevice::new("still", path));
            let renderer = HapticRenderer::new(probe.clone(), scene.clone(), device, *settings);
            let mut renderer = renderer.map_err(|error| error.to_string())?;
            renderer.set_integrator(Arc::new(*integrator));
            let (mut haptic, mut contact, mut device) = renderer.into_loops();
            let (warming, rest) = states.split_at(WARM_UP.min(states.len()));
            for (index, state) in warming.iter().enumerate() {
                contact.step(state, index as f64 * self.period);
            }
            let mut update = ContactUpdate::none();
            counted(&mut || {
                for (index, state) in rest.iter().enumerate() {
                    update = contact.step(state, (WARM_UP + index) as f64 * self.period);
                }
            });
            haptic.update_contacts(&update);
            let state = device.read(0.0).map_err(|error| error.to_string())?;
            let period = 1.0 / settings.timing.rate;
            counted(&mut || {
                for step in 1..=HAPTIC_STEPS {
                    haptic.step(&state, f64::from(step) * period, period);
                }
            });
        }
        Ok(())
    }
}

/// Makes callgrind, under which this process runs, start to instrument: before that, all is several times
/// faster.
fn switch_on() -> Result<(), String> {
    let process = std::process::id().to_string();
    let control = |arguments: &[&str]| {
        Command::new("callgrind_control").args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn()
    };
    let mut switch: Child =
        control(&["--instr=on", &process]).map_err(|error| format!("callgrind_control: {error}"))?;
    // Callgrind reacts only while this process executes instructions, so it must not wait in the kernel.
    loop {
        match switch.try_wait() {
            Ok(None) => std::hint::spin_loop(),
            Ok(Some(status)) if status.success() => return Ok(()),
            Ok(Some(status)) => return Err(format!("callgrind_control failed ({status})")),
            Err(error) => return Err(format!("callgrind_control: {error}")),
        }
    }
}

/// Function that callgrind counts.
const COUNTED_FUNCTION: &str = concat!(module_path!(), "::counted");

#[inline(never)]
fn counted(work: &mut dyn FnMut()) {
    work();
}

/// Runs the job in a file, to be counted by callgrind.
///
/// # Errors
/// If the file cannot be read, or a setting is refused.
pub fn run_counted(job: &Path) -> Result<(), String> {
    let text = std::fs::read_to_string(job).map_err(|error| format!("{}: {error}", job.display()))?;
    let job: Job = serde_json::from_str(&text).map_err(|error| format!("{}: {error}", job.display()))?;
    job.run()
}

/// Returns the counts of callgrind's dumps in the order of time, without the first, which ends where counting
/// begins.
fn dumps(folder: &Path) -> Result<Vec<f64>, String> {
    let entries = std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut files: Vec<(u32, PathBuf)> = entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            let name = path.file_name()?.to_str()?.strip_prefix("out")?.to_owned();
            // The dump at the end has no number.
            let number = name.strip_prefix('.').map_or(Some(u32::MAX), |number| number.parse().ok())?;
            Some((number, path))
        })
        .collect();
    files.sort();
    let total = |path: &Path| -> Result<f64, String> {
        let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
        let line =
            text.lines().find_map(|line| line.strip_prefix("totals:").or(line.strip_prefix("summary:")));
        let number = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
        number.ok_or_else(|| format!("{}: no count in it", path.display()))
    };
    files.iter().skip(1).map(|(_, path)| total(path)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_read_in_the_order_of_time() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        // Callgrind's last dump has no number.
        for (name, total) in [("out.1", 0), ("out.2", 20), ("out.10", 100), ("out.9", 90), ("out", 7)] {
            write(name, &format!("version: 1\nevents: Ir\ntotals: {total}\n"));
        }
        write("job.json", "{}");
        assert_eq!(dumps(folder.path()).unwrap(), [20.0, 90.0, 100.0, 7.0]);
        write("out.11", "nothing");
        assert!(dumps(folder.path()).unwrap_err().contains("out.11"));
    }
}
