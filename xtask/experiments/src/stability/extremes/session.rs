//! A session with an emulated hand, and what the map of extremes measures of it.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::device::{EmulatedDevice, Emulation, IntendedPath, Task};
use palpate::{
    ContactTiming, HandlePlacement, HapticRenderer, Object, Pose, Record, Scene, Settings, Twist, explore,
};
use palpate_measure::{Deepest, Held, Level, Vibration};

/// Most that an exact query may find of penetration, m.
pub const DEPTH: f64 = 1e-4;
/// Most force above 20 Hz at the device, root mean square in free space, at rest and in sliding, N.
pub const FREE: f64 = 0.005;
pub const REST: f64 = 0.01;
pub const SLIDING: f64 = 0.05;

/// Time of the descent of a hand that pauses ([`Hands::Paused`]), of its pause, and of its strokes, s.
const DESCENT: f64 = 1.2;
const PAUSE: f64 = 0.9;
const STROKES: f64 = 2.4;
/// Share of the task's period in which it comes down.
const DESCENDING: f64 = 0.2;

/// What the hand of the default device does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hands {
    /// Explores for 5 s: `palpate run --device emulated --seconds 5`.
    Exploring,
    /// Presses, holds and withdraws: `palpate run --device emulated:premium-1.5,task=press --seconds 4`.
    Pressing,
    /// Explores, but comes down faster, and pauses before the strokes.
    Paused,
}

/// A session on a simulated clock.
pub struct Case<'a> {
    pub probe: &'a Object,
    pub scene: &'a Scene,
    pub settings: Settings,
    pub contact_rate: f64,
}

/// Measurements of a session.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Deepest penetration that the session's own queries found, m.
    pub told: f64,
    pub exact: Deepest,
    /// Number of steps.
    pub steps: usize,
    pub vibration: Vibration,
}

impl Hands {
    /// Duration of a session, s.
    fn seconds(self) -> f64 {
        match self {
            Self::Exploring => 5.0,
            Self::Pressing => Task::Press.cycle(),
            Self::Paused => DESCENT + PAUSE + STROKES,
        }
    }

    fn task(self) -> Task {
        match self {
            Self::Exploring | Self::Paused => Task::Explore,
            Self::Pressing => Task::Press,
        }
    }

    /// Time of the task at a time of the session, s, and how fast it goes.
    fn progress(self, time: f64) -> (f64, f64) {
        let down = DESCENDING * self.task().cycle();
        match self {
            Self::Paused if time < DESCENT => (time * down / DESCENT, down / DESCENT),
            Self::Paused if time < DESCENT + PAUSE => (down, 0.0),
            Self::Paused => (time - DESCENT - PAUSE + down, 1.0),
            Self::Exploring | Self::Pressing => (time, 1.0),
        }
    }
}

impl Case<'_> {
    /// Runs the session and measures it.
    ///
    /// # Errors
    /// If the held object is larger than the device's workspace, the session cannot start, or a pose is not
    /// valid.
    pub fn measure(&self, hands: Hands) -> Result<Measured, String> {
        let emulation = Emulation::default();
        let mut path = self.intended(hands)?;
        let device = emulation.clone().open(self.intended(hands)?).map_err(|error| error.to_string())?;
        let records = self.records(hands, device)?;
        let place = HandlePlacement::new(&self.settings, self.probe, &emulation.specification);
        let IntendedPath::Function(intended) = &mut path else { return Err("a task moves".to_owned()) };
        let hand: Vec<Pose> =
            records.iter().map(|record| place.mesh_pose(&intended(record.time).0)).collect();
        let poses: Vec<Pose> = records.iter().map(|record| record.object).collect();
        let exact = Deepest::of(&poses, self.probe, self.scene, DEPTH).map_err(|error| error.to_string())?;
        let held = Held::new(self.probe, &emulation);
        Ok(Measured {
            told: records.iter().fold(0.0, |most: f64, record| most.max(record.depth)),
            exact,
            steps: records.len(),
            vibration: Vibration::of(&records, &hand, self.settings.timing.rate, &held),
        })
    }

    /// Returns the path that the hand intends for the handle. Its movements are multiples of the probe's
    /// bounding radius, as on the command line for probes within the device's workspace.
    fn intended(&self, hands: Hands) -> Result<IntendedPath, String> {
        if self.probe.bounding_radius() > Emulation::default().specification.workspace_radius {
            return Err(format!("{} is larger than the device's workspace", self.probe.name));
        }
        let path = explore::path(hands.task(), self.probe, self.scene).map_err(|error| error.to_string())?;
        let IntendedPath::Function(mut path) = path else { return Err("a task moves".to_owned()) };
        Ok(IntendedPath::function(move |time| {
            let (time, speed) = hands.progress(time);
            let (pose, twist) = path(time);
            (pose, Twist::new(twist.linear * speed, twist.angular * speed))
        }))
    }

    fn records(&self, hands: Hands, device: EmulatedDevice) -> Result<Vec<Record>, String> {
        let (probe, scene) = (self.probe.clone(), self.scene.clone());
        let renderer = HapticRenderer::new(probe, scene, Box::new(device), self.settings)
            .map_err(|error| error.to_string())?;
        let mut records = Vec::new();
        let stop = AtomicBool::new(false);
        let timing = ContactTiming::busy(self.contact_rate);
        let Ok(_) = renderer.run_lockstep(hands.seconds(), timing, &stop, |record| {
            records.push(*record);
            Ok::<_, Infallible>(())
        });
        Ok(records)
    }
}

impl Measured {
    /// Share of the steps that are deeper than [`DEPTH`].
    pub fn beyond(&self) -> f64 {
        self.exact.beyond as f64 / self.steps.max(1) as f64
    }

    /// Duration of contact, s.
    pub fn touching(&self) -> f64 {
        self.vibration.rest.seconds + self.vibration.sliding.seconds
    }

    /// Names of the bounds that the session is not within.
    pub fn outside(&self) -> Vec<&'static str> {
        let Vibration { free, rest, sliding, .. } = &self.vibration;
        [
            (self.exact.depth > DEPTH, "depth"),
            (free.force > FREE, "free"),
            (rest.force > REST, "rest"),
            (sliding.force > SLIDING, "sliding"),
        ]
        .into_iter()
        .filter_map(|(is, name)| is.then_some(name))
        .collect()
    }
}

/// Returns centre (Hz) and level over threshold of the third octave that is felt most; zeros if there is
/// none.
pub fn worst(level: &Level) -> [f64; 2] {
    level.worst().map_or([0.0; 2], |band| [band.center, band.ratio()])
}

#[cfg(test)]
mod tests;
