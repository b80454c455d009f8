//! Scenarios of the measurements: objects, and the motion of a hand.

use palpate::device::{Emulation, IntendedPath, Interpolation, Keyframe, MotionPath, Task};
use palpate::models::Model;
use palpate::settings::{ContactSearch, ContactSettings, SearchSettings};
use palpate::{HandlePlacement, Object, Pose, Scene, Settings, explore};
use palpate_benches::scenarios;

use crate::reproduce::relief;

/// Scenarios of the benchmarks that are measured, with their titles, and the factors by which their paths, of
/// 1 ms from pose to pose, are slowed down. The last two use scanned objects. The ball joint's contact steps
/// take milliseconds at full resolution, so it gets less time.
const RIGID: [(&str, &str, f64); 6] = [
    ("jaws", "built-in-jaws", 2.0),
    ("golf", "golf", 2.0),
    ("ball-joint", "ball-joint", 0.5),
    ("spoon-cup", "built-in-spoon-cup", 2.0),
    ("dental-casts", "dental-casts", 2.0),
    ("spoon-mug", "spoon-mug", 2.0),
];
/// Scenario with haptic textures.
const TEXTURED: &str = "file-on-part";
/// Time for which the file scrapes, s.
const SCRAPING: f64 = 3.0;

/// Probe, scene, and motion of a hand.
pub struct Scenario {
    pub name: &'static str,
    pub probe: Object,
    pub scene: Scene,
    pub settings: Settings,
    pub textured: bool,
    /// Length of the session, s.
    pub seconds: f64,
    hand: Option<MotionPath>,
}

impl Scenario {
    /// Returns whether all objects are closed, as distance fields require.
    pub fn is_closed(&self) -> bool {
        let others = self.scene.objects().iter().map(|placed| &placed.object);
        std::iter::once(&self.probe).chain(others).all(|object| object.clod.source.solid)
    }

    /// Returns the intended path of an emulated device's handle.
    ///
    /// # Errors
    /// If an object is out of range.
    pub fn hand(&self) -> Result<IntendedPath, String> {
        match &self.hand {
            Some(path) => {
                let specification = Emulation::default().specification;
                let placement = HandlePlacement::new(&self.settings, &self.probe, &specification);
                Ok(explore::mesh_path(path.clone(), &self.settings, placement))
            }
            None => explore::path(Task::Explore, &self.probe, &self.scene).map_err(|error| error.to_string()),
        }
    }
}

/// Returns the names of all scenarios.
pub fn names() -> impl Iterator<Item = &'static str> {
    RIGID.iter().map(|(name, ..)| *name).chain([TEXTURED])
}

/// Opens a scenario by its name; `None` if its files, which are optional test data, are absent.
///
/// # Errors
/// If there is no such scenario, or its objects cannot be made.
pub fn open(name: &str) -> Result<Option<Scenario>, String> {
    if name == TEXTURED {
        return file_on_part().map(Some);
    }
    let Some((name, benchmark, slower)) = RIGID.into_iter().find(|(known, ..)| *known == name) else {
        let known: Vec<&str> = names().collect();
        return Err(format!("no scenario is called '{name}'; the names are: {}", known.join(" ")));
    };
    let opened = scenarios::open(benchmark).map_err(|error| error.to_string())?;
    opened.map(|opened| rigid(name, opened, slower)).transpose()
}

fn rigid(name: &'static str, opened: scenarios::Scenario, slower: f64) -> Result<Scenario, String> {
    let scenarios::Scenario { probe, scene, poses, tolerance, .. } = opened;
    let keyframes: Vec<Keyframe> = (0..)
        .zip(poses)
        .map(|(index, pose)| Keyframe { time: slower * 1e-3 * f64::from(index), pose })
        .collect();
    let path = MotionPath::new(keyframes, Interpolation::Smooth).map_err(|error| error.to_string())?;
    Ok(Scenario {
        name,
        probe: probe.object,
        scene: Scene::new().with(scene.object, Pose::IDENTITY),
        settings: Settings {
            contact: ContactSettings::penalties(ContactSettings::default().stiffness),
            search: SearchSettings {
                method: ContactSearch::Levels,
                tolerance: Some(tolerance),
                ..SearchSettings::default()
            },
            ..Settings::default()
        },
        textured: false,
        seconds: path.keyframes().last().map_or(0.0, |last| last.time),
        hand: Some(path),
    })
}

fn file_on_part() -> Result<Scenario, String> {
    let scene = Scene::new().with(relief::object(Model::CadPart, 8008, true)?, Pose::IDENTITY);
    Ok(Scenario {
        name: TEXTURED,
        probe: relief::object(Model::File, 632, true)?,
        scene,
        settings: relief::scraping(),
        textured: true,
        seconds: SCRAPING,
        hand: None,
    })
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// Returns a small scenario: a hand explores a golf ball with an ellipsoid.
    pub fn small() -> Scenario {
        let open = |name| Object::model(name).unwrap();
        Scenario {
            name: "small",
            probe: open("ellipsoid@500"),
            scene: Scene::new().with(open("golf-ball@5000"), Pose::IDENTITY),
            settings: Settings {
                contact: ContactSettings::penalties(ContactSettings::default().stiffness),
                search: SearchSettings { method: ContactSearch::Levels, ..SearchSettings::default() },
                ..Settings::default()
            },
            textured: false,
            seconds: 1.5,
            hand: None,
        }
    }

    #[test]
    fn unknown_scenarios_are_refused() {
        assert!(open("jams").err().unwrap().contains("jaws"));
    }
}
