//! Contact between two models: the probe approaches until it touches, presses slightly, slides to and fro and
//! turns.

use std::f64::consts::TAU;

use palpate::Pose;
use palpate::collide::{ContactQuery, QuerySettings, Shape};
use palpate::core::Clod;
use palpate::glam::{DQuat, DVec3};
use palpate::models::Model;

/// Number of poses of the approach, and of the sliding after it.
const APPROACH: usize = 20;
const SLIDING: usize = 40;

/// Clearance, penetration and displacement relative to the probe's bounding radius, and rotation, rad.
const CLEARANCE: f64 = 0.1;
const PRESS: f64 = 0.01;
const SLIDE: f64 = 0.05;
const TURN: f64 = 0.05;

/// Resolution of the first touch, relative to the probe's bounding radius.
const TOUCH_PRECISION: f64 = 1e-4;

/// Approach of the probe to the scene object, whose frame is the world's.
struct Encounter {
    /// Pose at the start, apart from the scene object.
    start: Pose,
    /// Direction of the approach; a unit vector.
    direction: DVec3,
    /// Displacement along the surface, m.
    slide: f64,
    /// Pivot of the rotation, in the probe's frame.
    pivot: DVec3,
}

impl Encounter {
    fn between(models: [Model; 2], probe: &Clod, scene: &Clod) -> Self {
        let radius = probe.bounding_radius();
        // From above, to the middle.
        let height = 1.01 * (radius + scene.bounding_radius());
        let falling = Self {
            start: Pose::from_translation(scene.source.center + height * DVec3::Z - probe.source.center),
            direction: DVec3::NEG_Z,
            slide: SLIDE * radius,
            pivot: probe.source.center,
        };
        match models {
            // The knob's centre is the origin of both; the socket only leaves room to turn.
            [Model::BallJointBall, Model::BallJointSocket] => {
                Self { start: Pose::IDENTITY, direction: DVec3::X, slide: 0.0, pivot: DVec3::ZERO }
            }
            // From the middle of the club's face to the ball's centre.
            [Model::GolfClub, Model::GolfBall] => {
                let start = Pose::from_translation(DVec3::new(-2.0 * scene.bounding_radius(), 0.0, 0.0));
                Self { start, direction: DVec3::X, pivot: DVec3::ZERO, ..falling }
            }
            // Bowl first, inside the cup, with the handle leaning towards its own side.
            [Model::Spoon, Model::Cup] => {
                let rotation = DQuat::from_rotation_y(-1.3);
                Self { start: Pose::new(DVec3::new(0.017, 0.0, 0.136), rotation), ..falling }
            }
            _ => falling,
        }
    }
}

/// Returns the probe's poses.
///
/// # Errors
/// If the probe is in contact at the start, or misses the scene object.
pub fn poses(models: [Model; 2], probe: &Clod, scene: &Clod) -> Result<Vec<Pose>, String> {
    let encounter = Encounter::between(models, probe, scene);
    let radius = probe.bounding_radius();
    let travel = first_touch(&encounter, probe, scene)?;
    let along = |distance: f64| encounter.start.translation + distance * encounter.direction;
    let first = (travel - CLEARANCE * radius).max(0.0);
    let pressed = travel + PRESS * radius;
    let approach = (0..APPROACH).map(|k| {
        let fraction = k as f64 / APPROACH as f64;
        Pose::new(along(first + (pressed - first) * fraction), encounter.start.rotation)
    });
    let (u, v) = encounter.direction.any_orthonormal_pair();
    let sliding = (0..SLIDING).map(|k| {
        let phase = TAU * k as f64 / SLIDING as f64;
        let offset = encounter.slide * (phase.sin() * u + (2.0 * phase).sin() * v);
        let turn = DQuat::from_scaled_axis(
            TURN * ((3.0 * phase).sin() * encounter.direction + (2.0 * phase).sin() * u + phase.sin() * v),
        );
        let rotation = turn * encounter.start.rotation;
        let held = encounter.start.rotation * encounter.pivot - rotation * encounter.pivot;
        Pose::new(along(pressed) + offset + held, rotation)
    });
    Ok(approach.chain(sliding).collect())
}

/// Returns the distance at which the probe touches, m, by conservative advancement: each step is no longer
/// than the separation.
fn first_touch(encounter: &Encounter, probe: &Clod, scene: &Clod) -> Result<f64, String> {
    let radius = probe.bounding_radius();
    let farthest = 4.0 * (radius + scene.bounding_radius());
    let settings = QuerySettings::new(CLEARANCE * radius);
    let mut query = ContactQuery::new(&Shape::new(probe.clone()), &Shape::new(scene.clone()));
    let mut travel = 0.0;
    while travel < farthest {
        let translation = encounter.start.translation + travel * encounter.direction;
        let pose = Pose::new(translation, encounter.start.rotation);
        let outcome = query.run(&pose, &Pose::IDENTITY, &settings).map_err(|error| error.to_string())?;
        let distance = outcome.smallest_distance.unwrap_or(settings.tolerance);
        if travel == 0.0 && distance == 0.0 {
            return Err("they are in contact from the start".to_owned());
        }
        if distance < TOUCH_PRECISION * radius {
            return Ok(travel);
        }
        travel += distance;
    }
    Err("they do not touch".to_owned())
}
