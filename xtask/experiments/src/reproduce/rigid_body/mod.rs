//! Spoon that falls into a cup and slides along its wall (§3.5.4, Figs. 3.17 to 3.19).

pub mod profile;
pub mod velocity;

use std::f64::consts::FRAC_PI_2;

use palpate::collide::{ErrorMetrics, VelocityMetric};
use palpate::glam::{DQuat, DVec3};
use palpate::{Object, Pose, Twist};
use palpate_rigid_body::{BodyState, QuerySample, RigidBody, Settings, Simulation};

/// Error threshold s₀ relative to the spoon's radius (§3.5.4).
const ERROR: f64 = 0.035;
/// Tolerance d relative to the spoon's radius.
const TOLERANCE: f64 = 1e-3;
/// Mass of the spoon, kg.
const MASS: f64 = 0.05;
/// Duration of a step, s.
const STEP: f64 = 1e-3;
/// Steps per frame of the figures: 30 ms.
const FRAME: usize = 30;
/// Number of frames that Fig. 3.19 shows.
const FRAMES: usize = 35;

/// Spoon and cup.
struct Scenario {
    spoon: Object,
    cup: Object,
}

/// Error metrics that are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Metric {
    Exact,
    /// Constant s₀ of [`ERROR`].
    Haptic,
    /// s₀ proportional to the speed: [`ERROR`] at 1 m/s.
    Velocity,
}

impl Scenario {
    fn open(spoon: &str, cup: &str) -> Result<Self, String> {
        use super::rendering::open;
        Ok(Self { spoon: open(spoon)?, cup: open(cup)? })
    }

    fn error(&self, metric: Metric, twist: Twist) -> ErrorMetrics {
        let length = ERROR * self.spoon.bounding_radius();
        match metric {
            Metric::Exact => ErrorMetrics::EXACT,
            Metric::Haptic => length.into(),
            Metric::Velocity => {
                ErrorMetrics { velocity: Some(VelocityMetric { time: length, twist }), ..ErrorMetrics::EXACT }
            }
        }
    }

    fn tolerance(&self) -> f64 {
        TOLERANCE * self.spoon.bounding_radius()
    }

    /// Returns the initial state: bowl down, leaning, over the middle of the mouth, at rest.
    fn start(&self, body: &RigidBody) -> BodyState {
        const GAP: f64 = 5e-3;
        let rotation =
            DQuat::from_scaled_axis(DVec3::new(0.1, 0.2, 0.3)) * DQuat::from_rotation_y(-FRAC_PI_2);
        let heights = |object: &Object, rotation: DQuat| {
            object.clod.vertices.iter().map(|vertex| (rotation * *vertex).z).collect::<Vec<_>>()
        };
        let rim = heights(&self.cup, DQuat::IDENTITY).into_iter().fold(f64::NEG_INFINITY, f64::max);
        let lowest = heights(&self.spoon, rotation).into_iter().fold(f64::INFINITY, f64::min);
        let bowl = rotation * (0.04 * DVec3::X);
        let place = DVec3::new(-bowl.x, -bowl.y, rim + GAP - lowest);
        body.state(&Pose::new(place, rotation), Twist::ZERO)
    }

    /// Simulates a fall of so many frames with a metric, and returns its queries frame by frame.
    fn fall(&self, metric: Metric, frames: usize) -> Result<Vec<Vec<QuerySample>>, String> {
        let body = RigidBody::solid(self.spoon.shape(), MASS).map_err(|error| error.to_string())?;
        let settings = Settings { error: self.error(metric, Twist::ZERO), ..Settings::new(self.tolerance()) };
        let (spoon, cup) = (self.spoon.shape(), self.cup.shape());
        let mut simulation = Simulation::new(body, spoon, cup, Pose::IDENTITY, self.start(&body), settings)
            .map_err(|error| error.to_string())?;
        (0..frames)
            .map(|_| {
                let mut samples = Vec::new();
                for _ in 0..FRAME {
                    simulation.step(STEP).map_err(|error| error.to_string())?;
                    samples.extend_from_slice(simulation.samples());
                }
                Ok(samples)
            })
            .collect()
    }
}
