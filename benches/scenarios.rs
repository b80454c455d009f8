//! Pairs of a probe and a scene object with paths of the probe at 1 kHz, on which contact queries are
//! compared.
//!
//! A path is recorded, or generated: the probe moves along a direction until it touches, slides along a small
//! closed loop in light penetration (`PATH_DEPTH` of its radius), and leaves in the reverse direction. At
//! each of `STATIONS` on the loop the depth is adjusted by moving along the direction until the contact query
//! at full resolution reports it; a smooth curve runs through the resulting poses.

use std::error::Error;
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use palpate::clod_build::unwatched;
use palpate::device::{Interpolation, Keyframe, MotionPath};
use palpate::glam::{DQuat, DVec3};
use palpate::{Object, OpenOptions, Pose, TriMesh, open_mesh};

use crate::engine::EngineQuery;
use crate::method::Method as _;

/// Tolerance d relative to the probe's radius.
pub const TOLERANCE: f64 = 0.01;
/// Depth of generated paths, relative to the probe's radius.
const PATH_DEPTH: f64 = 0.002;
/// Error of the depth at a station, relative to the probe's radius.
const PATH_DEPTH_ERROR: f64 = 1e-4;
/// Distance of the start of generated paths from the first contact, relative to the probe's radius.
const CLEARANCE: f64 = 0.05;
/// Number of poses on the loop whose depth is adjusted.
const STATIONS: usize = 32;
/// Number of poses of a generated path, at 1 kHz, and the shares of the approach and of the loop.
const POSES: usize = 1000;
const APPROACH: f64 = 0.2;
const LOOP: f64 = 0.6;
/// Thread pitch of the test data's M16 bolt, m; and start of the nut, m, from which it is clear of the bolt
/// for two turns.
const THREAD_PITCH: f64 = 0.002;
const THREAD_START: f64 = 0.006;

/// Probe, scene object that stands at the origin, and path of the probe.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Name by which it is selected.
    pub name: String,
    /// Moving object.
    pub probe: Body,
    /// Fixed object.
    pub scene: Body,
    /// Poses of the probe, 1 ms apart.
    pub poses: Vec<Pose>,
    /// Tolerance d, m: closer surfaces are in contact.
    pub tolerance: f64,
}

/// Object with the mesh that it was made from.
#[derive(Clone, Debug)]
pub struct Body {
    /// Object with its hierarchy, from the user's cache if it was built before.
    pub object: Object,
    /// Mesh, exactly welded, m.
    pub mesh: TriMesh,
}

impl Body {
    /// Returns the model's name, or the file's without its folder.
    pub fn short_name(&self) -> &str {
        let name = &self.object.name;
        name.rsplit_once('/').map_or(name, |(_, file)| file)
    }
}

/// Definition of a scenario: built-in models, or files of the optional test data (`shared` beside the
/// repository).
struct Entry {
    name: &'static str,
    probe: &'static str,
    scene: &'static str,
    motion: Motion,
}

enum Motion {
    /// A trajectory file.
    Recorded(&'static str),
    Sliding(Sliding),
    /// Nut that is screwed down a bolt, pressed by so much (m) onto the flanks of the thread.
    Screwing {
        pressed: f64,
    },
    /// Ball that comes from afar, passes the rim of its socket, is pressed against it, and turns about each
    /// axis.
    Seating,
}

/// Parameters of a probe that slides over an object.
#[derive(Clone, Copy)]
struct Sliding {
    /// Position of the probe's origin at the start, m; `None` for clear of the scene object with the
    /// bounding spheres' centres in line.
    start: Option<DVec3>,
    /// Direction in which it moves until it touches.
    direction: DVec3,
    /// Largest shift across the direction, relative to the probe's radius.
    shift: f64,
    /// Largest rotation vector, rad.
    turn: DVec3,
    /// Pivot of the rotation, a point of the probe, m; `None` for its bounding sphere's centre.
    pivot: Option<DVec3>,
}

impl Sliding {
    const DOWN: Self = Self {
        start: None,
        direction: DVec3::NEG_Z,
        shift: 0.02,
        turn: DVec3::new(0.01, 0.01, 0.03),
        pivot: None,
    };
}

const SCENARIOS: [Entry; 15] = [
    Entry {
        name: "ellipsoid",
        probe: "ellipsoid",
        scene: "golf-ball",
        motion: Motion::Sliding(Sliding { shift: 0.3, turn: DVec3::splat(0.2), ..Sliding::DOWN }),
    },
    Entry {
        name: "spoon-cup",
        probe: "models/scenarios/spoon.obj",
        scene: "models/scenarios/cup.obj",
        motion: Motion::Recorded("trajectories/spooncup.csv"),
    },
    Entry {
        name: "golf",
        probe: "golf-club",
        scene: "golf-ball",
        motion: Motion::Sliding(Sliding {
            start: Some(DVec3::new(-0.03, 0.0, 0.005)),
            direction: DVec3::X,
            ..Sliding::DOWN
        }),
    },
    Entry {
        name: "jaws",
        probe: "models/scenarios/jaw_lower.obj",
        scene: "models/scenarios/jaw_upper.obj",
        motion: Motion::Recorded("trajectories/jaws.csv"),
    },
    Entry {
        name: "ball-joint",
        probe: "ball-joint-ball",
        scene: "ball-joint-socket",
        motion: Motion::Sliding(Sliding {
            start: Some(DVec3::ZERO),
            direction: DVec3::X,
            shift: 0.0,
            turn: DVec3::new(0.1, 0.1, 0.05),
            pivot: Some(DVec3::ZERO),
        }),
    },
    Entry {
        name: "ball-joint-turned",
        probe: "ball-joint-ball",
        scene: "ball-joint-socket",
        motion: Motion::Seating,
    },
    Entry {
        name: "built-in-jaws",
        probe: "upper-jaw",
        scene: "lower-jaw",
        motion: Motion::Recorded("assets/trajectories/jaws.csv"),
    },
    Entry {
        name: "built-in-spoon-cup",
        probe: "spoon",
        scene: "cup",
        motion: Motion::Sliding(Sliding::DOWN),
    },
    Entry {
        name: "dental-casts",
        probe: "models/good/dental_cast_upper.obj",
        scene: "models/good/dental_cast_lower.obj",
        motion: Motion::Sliding(Sliding { start: Some(DVec3::new(0.0, 0.0, 0.003)), ..Sliding::DOWN }),
    },
    Entry {
        name: "peg-hole",
        probe: "models/good/peg_8mm.obj",
        scene: "models/good/hole_8mm.obj",
        motion: Motion::Sliding(Sliding {
            start: Some(DVec3::ZERO),
            direction: DVec3::X,
            turn: DVec3::new(0.0, 0.0, 0.1),
            ..Sliding::DOWN
        }),
    },
    Entry {
        name: "nut-bolt",
        probe: "models/good/nut_m16.obj",
        scene: "models/good/bolt_m16.obj",
        motion: Motion::Sliding(Sliding {
            start: Some(DVec3::new(0.0, 0.0, 0.002)),
            shift: 0.001,
            turn: DVec3::new(0.0, 0.0, 0.1),
            ..Sliding::DOWN
        }),
    },
    Entry {
        name: "nut-screwed",
        probe: "models/good/nut_m16.obj",
        scene: "models/good/bolt_m16.obj",
        motion: Motion::Screwing { pressed: 0.0 },
    },
    Entry {
        name: "nut-pressed",
        probe: "models/good/nut_m16.obj",
        scene: "models/good/bolt_m16.obj",
        motion: Motion::Screwing { pressed: 20e-6 },
    },
    Entry {
        name: "gears",
        probe: "models/good/gear_medium.obj",
        scene: "models/good/gear_large.obj",
        motion: Motion::Sliding(Sliding {
            start: Some(DVec3::ZERO),
            direction: DVec3::Y,
            shift: 0.005,
            turn: DVec3::new(0.0, 0.0, 0.01),
            ..Sliding::DOWN
        }),
    },
    Entry {
        name: "spoon-mug",
        probe: "models/good/ycb_spoon.obj",
        scene: "models/good/ycb_mug.obj",
        motion: Motion::Sliding(Sliding::DOWN),
    },
];

/// Returns the names of all scenarios.
pub fn names() -> impl Iterator<Item = &'static str> {
    SCENARIOS.iter().map(|entry| entry.name)
}

/// Runs a function on the scenarios of these names, or on all if there are none; prints which are skipped.
///
/// # Errors
/// If a scenario cannot be [opened](open), or the function fails.
#[expect(clippy::print_stdout, reason = "for benchmarks, which print tables")]
pub fn each(
    chosen: &[String],
    mut run: impl FnMut(&Scenario) -> Result<(), Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    let all: Vec<&str> =
        if chosen.is_empty() { names().collect() } else { chosen.iter().map(String::as_str).collect() };
    for name in all {
        match open(name)? {
            None => println!("## {name}\n\nskipped: its files are absent\n"),
            Some(scenario) => run(&scenario)?,
        }
    }
    Ok(())
}

/// Loads a scenario; `None` if its files, which are optional test data, are absent.
///
/// # Errors
/// If there is no such scenario, one of its files is refused, or the generated path finds no contact.
pub fn open(name: &str) -> Result<Option<Scenario>, Box<dyn Error>> {
    let Some(entry) = SCENARIOS.iter().find(|entry| entry.name == name) else {
        let known: Vec<&str> = names().collect();
        return Err(format!("no scenario is called '{name}'; the names are: {}", known.join(" ")).into());
    };
    let (Some(probe), Some(scene)) = (body(entry.probe)?, body(entry.scene)?) else {
        return Ok(None);
    };
    let poses = match &entry.motion {
        Motion::Sliding(sliding) => sliding.path(&probe, &scene)?,
        Motion::Screwing { pressed } => screwing(*pressed),
        Motion::Seating => seating()?,
        Motion::Recorded(file) => {
            let file = data_file(file);
            if !file.exists() {
                return Ok(None);
            }
            recorded(&file)?
        }
    };
    let tolerance = TOLERANCE * probe.object.bounding_radius();
    Ok(Some(Scenario { name: entry.name.to_owned(), probe, scene, poses, tolerance }))
}

/// Loads a scenario of the user's: mesh files or built-in models, and a trajectory file; the tolerance (d) in
/// metres, or in percent of the probe's radius ("1%").
///
/// # Errors
/// If one of the files is refused, or the tolerance is invalid.
pub fn own(probe: &str, scene: &str, trajectory: &Path, tolerance: &str) -> Result<Scenario, Box<dyn Error>> {
    let [probe, scene] = [load(probe)?, load(scene)?];
    let (number, unit) = match tolerance.strip_suffix('%') {
        Some(percent) => (percent, probe.object.bounding_radius() / 100.0),
        None => (tolerance, 1.0),
    };
    let tolerance = number.trim().parse().ok().map(|number: f64| number * unit);
    let tolerance = tolerance.filter(|d| d.is_finite() && *d > 0.0);
    let tolerance = tolerance.ok_or("--tolerance has to be a length above 0 in metres, or in percent: 1%")?;
    let name = format!("{} on {}", probe.short_name(), scene.short_name());
    Ok(Scenario { name, poses: recorded(trajectory)?, probe, scene, tolerance })
}

/// Returns poses of a scenario's probe anywhere on the scene object, in any orientation: from apart by twice
/// the tolerance to deeper by the tolerance than `PATH_DEPTH`. They are deterministic and equidistributed, by
/// multiples of powers of a root of x⁷ = x + 1.
///
/// # Errors
/// If hardly any of the probe's lines of approach lead to the scene object.
pub fn anywhere(scenario: &Scenario, count: usize) -> Result<Vec<Pose>, Box<dyn Error>> {
    const ROOT: f64 = 1.112_775_684_278_705_4;
    let Scenario { probe, scene, tolerance, .. } = scenario;
    let radius = probe.object.bounding_radius();
    let (own, other) = (probe.mesh.bounding_sphere(), scene.mesh.bounding_sphere());
    let apart = own.radius + other.radius;
    let mut press = Press {
        query: EngineQuery::new(&probe.object, &scene.object, 2.0 * PATH_DEPTH * radius),
        radius,
        farthest: 2.0 * apart,
    };
    let mut poses = Vec::with_capacity(count);
    for index in 1..=10 * count {
        let [a, b, c, d, e, f] = [1, 2, 3, 4, 5, 6].map(|axis| (index as f64 / ROOT.powi(axis)).fract());
        // Uniform random rotation: K. Shoemake, Graphics Gems III, 1992.
        let ((s, t), (u, v)) = ((TAU * b).sin_cos(), (TAU * c).sin_cos());
        let (p, q) = ((1.0 - a).sqrt(), a.sqrt());
        let rotation = DQuat::from_xyzw(p * s, p * t, q * u, q * v).normalize();
        let (sine, cosine) = (TAU * d).sin_cos();
        let along = 2.0 * e - 1.0;
        let direction =
            DVec3::new(cosine * (1.0 - along * along).sqrt(), sine * (1.0 - along * along).sqrt(), along);
        let start = other.center - direction * apart - rotation * own.center;
        let pose = |advance: f64| Pose::new(start + direction * advance, rotation);
        let Ok(advance) = press.advance(pose, 0.0) else { continue };
        poses.push(pose(advance + tolerance * (3.0 * f - 2.0)));
        if poses.len() == count {
            return Ok(poses);
        }
    }
    Err("hardly any line leads the probe to the scene object".into())
}

/// Reads the poses of a trajectory file.
fn recorded(file: &Path) -> Result<Vec<Pose>, Box<dyn Error>> {
    let path = MotionPath::load(file, Interpolation::Linear)?;
    Ok(path.keyframes().iter().map(|keyframe| keyframe.pose).collect())
}

/// Returns the path of a nut that is screwed down by two turns in two seconds.
fn screwing(pressed: f64) -> Vec<Pose> {
    let pose = |step: usize| {
        let turns = 1e-3 * step as f64;
        let height = THREAD_START - THREAD_PITCH * turns - pressed;
        Pose::new(DVec3::Z * height, DQuat::from_rotation_z(-TAU * turns))
    };
    (0..2000).map(pose).collect()
}

/// Returns the path of a ball into its socket, where it turns by up to 0.1 rad about each axis in turn.
fn seating() -> Result<Vec<Pose>, Box<dyn Error>> {
    let pressed = 1e-3 * DVec3::new(0.65, 0.0, 0.2);
    let turned = |axis: DVec3| Pose::new(pressed, DQuat::from_scaled_axis(axis));
    let mut keyframes = vec![
        Keyframe { time: 0.0, pose: Pose::from_translation(-0.08 * DVec3::Z) },
        Keyframe { time: 0.25, pose: Pose::IDENTITY },
        Keyframe { time: 0.3, pose: Pose::from_translation(pressed) },
    ];
    let turns = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| 0.1 * axis);
    let ends = turns.into_iter().flat_map(|turn| [turn, -turn, DVec3::ZERO]);
    keyframes.extend(
        ends.zip(1..)
            .map(|(turn, step)| Keyframe { time: 0.3 + 0.7 / 9.0 * f64::from(step), pose: turned(turn) }),
    );
    let path = MotionPath::new(keyframes, Interpolation::Smooth)?;
    Ok((0..POSES).map(|step| path.at(1e-3 * step as f64).pose).collect())
}

/// Returns the path of a file in the repository's `assets`, or else in the optional test data.
fn data_file(file: &str) -> PathBuf {
    let folder = if file.starts_with("assets/") { "/.." } else { "/../../shared" };
    Path::new(&[env!("CARGO_MANIFEST_DIR"), folder].concat()).join(file)
}

/// Loads a built-in model or, if it names a file, one of the optional test data.
fn body(name: &str) -> Result<Option<Body>, Box<dyn Error>> {
    let file = data_file(name);
    let argument = if name.contains('/') {
        if !file.exists() {
            return Ok(None);
        }
        file.to_str().ok_or("the repository's path is not Unicode")?
    } else {
        name
    };
    load(argument).map(Some)
}

fn load(argument: &str) -> Result<Body, Box<dyn Error>> {
    let options = OpenOptions::default();
    let mesh = open_mesh(argument, &options)?.mesh;
    let object = Object::open(argument, &options, &mut unwatched)?;
    Ok(Body { object, mesh })
}

impl Sliding {
    /// Returns poses 1 ms apart.
    fn path(&self, probe: &Body, scene: &Body) -> Result<Vec<Pose>, Box<dyn Error>> {
        let radius = probe.object.bounding_radius();
        let (own, other) = (probe.mesh.bounding_sphere(), scene.mesh.bounding_sphere());
        let apart = own.radius + other.radius;
        let start = self.start.unwrap_or(other.center - own.center - self.direction * apart);
        let (across, along) = self.direction.any_orthonormal_pair();
        let pivot = self.pivot.unwrap_or(own.center);
        // Phase 0 to 1 is a closed loop: shift (sin, 1 − cos) across the direction, turn by the sine.
        let pose = |phase: f64, advance: f64| {
            let (sine, cosine) = (TAU * phase).sin_cos();
            let rotation = DQuat::from_scaled_axis(self.turn * sine);
            let shift = self.shift * radius * (across * sine + along * (1.0 - cosine) / 2.0);
            Pose::new(start + pivot - rotation * pivot + shift + self.direction * advance, rotation)
        };

        let mut press = Press {
            query: EngineQuery::new(&probe.object, &scene.object, 2.0 * PATH_DEPTH * radius),
            radius,
            farthest: 2.0 * apart,
        };
        let mut advances = Vec::with_capacity(STATIONS);
        for station in 0..STATIONS {
            let phase = station as f64 / STATIONS as f64;
            let guess = advances.last().copied().unwrap_or(0.0);
            advances.push(press.advance(|advance| pose(phase, advance), guess)?);
        }
        let first = advances[0];
        let clear = (first - CLEARANCE * radius).max(0.0);
        let mut keyframes = vec![Keyframe { time: 0.0, pose: pose(0.0, clear) }];
        keyframes.extend((0..=STATIONS).map(|station| {
            let phase = station as f64 / STATIONS as f64;
            Keyframe { time: APPROACH + LOOP * phase, pose: pose(phase, advances[station % STATIONS]) }
        }));
        keyframes.push(Keyframe { time: 2.0 * APPROACH + LOOP, pose: pose(0.0, clear) });
        let path = MotionPath::new(keyframes, Interpolation::Smooth)?;
        Ok((0..POSES).map(|step| path.at(1e-3 * step as f64).pose).collect())
    }
}

/// Finds the displacement of a probe along a line to a given light penetration.
struct Press {
    query: EngineQuery,
    radius: f64,
    farthest: f64,
}

impl Press {
    /// Returns the displacement, near a first guess, at which the depth is [`PATH_DEPTH`]; the probe comes
    /// from before it.
    fn advance(&mut self, pose: impl Fn(f64) -> Pose, guess: f64) -> Result<f64, Box<dyn Error>> {
        let light = PATH_DEPTH * self.radius;
        // No step passes through a surface that was out of reach before it.
        let step = light;
        let mut above = guess;
        while self.is_deep(&pose(above)) {
            above -= step;
            if above < -self.farthest {
                return Err("the probe does not come clear of the scene object".into());
            }
        }
        let mut below = above + step;
        while !self.is_deep(&pose(below)) {
            (above, below) = (below, below + step);
            if below > self.farthest {
                return Err("the probe does not meet the scene object".into());
            }
        }
        // Bisection between a clear and a deep displacement.
        while below - above > PATH_DEPTH_ERROR * self.radius {
            let middle = f64::midpoint(above, below);
            if self.is_deep(&pose(middle)) {
                below = middle;
            } else {
                above = middle;
            }
        }
        Ok(above)
    }

    fn is_deep(&mut self, pose: &Pose) -> bool {
        self.query.run(pose);
        self.query.outcome().deepest.is_some_and(|depth| depth >= PATH_DEPTH * self.radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_generated_path_touches_lightly_and_leaves() {
        let body = |name: &str| -> Result<Body, Box<dyn Error>> {
            let mesh = open_mesh(name, &OpenOptions::default())?.mesh;
            Ok(Body { object: Object::from_mesh(name, &mesh)?, mesh })
        };
        let (probe, scene) =
            (body("ellipsoid@500").expect("a model"), body("golf-ball@5000").expect("a model"));
        let sliding = Sliding { shift: 0.3, turn: DVec3::splat(0.2), ..Sliding::DOWN };
        let poses = sliding.path(&probe, &scene).expect("they meet");
        assert_eq!(poses.len(), POSES);
        let radius = probe.object.bounding_radius();
        let mut query = EngineQuery::new(&probe.object, &scene.object, TOLERANCE * radius);
        let mut depths = poses.iter().map(|pose| {
            query.run(pose);
            query.outcome().deepest
        });
        assert_eq!(depths.next(), Some(None), "clear at first");
        let contacts: Vec<f64> = depths.by_ref().take(800).flatten().collect();
        assert!(contacts.len() > 600, "{} poses in contact", contacts.len());
        let deepest = contacts.iter().copied().fold(0.0, f64::max);
        assert!((0.9 * PATH_DEPTH..3.0 * PATH_DEPTH).contains(&(deepest / radius)), "{deepest} of {radius}");
        assert_eq!(depths.last(), Some(None), "clear at last");
    }
}
