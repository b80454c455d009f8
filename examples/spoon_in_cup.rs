//! Spoon that falls into a cup, bounces, slides along the wall and comes to rest: rigid-body simulation with
//! contact levels of detail, on a simulated clock, without a haptic device (§3.5.4, Fig. 3.17).
//!
//! `cargo run --release --example spoon_in_cup`, and with `-- --metric velocity`, `view` or `exact` at
//! another resolution.

use std::error::Error;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Instant;

use palpate::collide::{ErrorMetrics, VelocityMetric, ViewMetric};
use palpate::glam::{DQuat, DVec3};
use palpate::{Object, Pose, Twist};
use palpate_examples::{CommandLine, open, say};
use palpate_report::{Curve, Figure, draw};
use palpate_rigid_body::{BodyState, RigidBody, Settings, Simulation};

/// Error threshold s₀ relative to the spoon's radius (§3.5.4); with the velocity metric, at 1 m/s.
const ERROR: f64 = 0.035;
/// Tolerance d relative to the spoon's radius.
const TOLERANCE: f64 = 1e-3;
/// View of the origin with a field of view of 45°.
const VIEW: ViewMetric =
    ViewMetric { pixels: 2.0, camera: DVec3::new(0.0, -1.0, 0.1), near: 0.1, frustum: 0.083, image: 1000.0 };
/// Duration of a step, s.
const STEP: f64 = 1e-3;
/// Mass of the spoon, kg.
const MASS: f64 = 0.05;
/// Time without motion after which the spoon counts as at rest, s.
const REST_TIME: f64 = 0.5;

/// Metric that decides which detail is left out.
#[derive(Clone, Copy, Debug)]
enum Metric {
    /// No detail
    Exact,
    /// Detail below 3.5 % of the spoon's radius
    Haptic,
    /// Detail below 3.5 % of the radius times the speed over 1 m/s
    Velocity,
    /// Detail below two pixels of a picture of 1000 × 1000, seen from a metre away
    View,
}

impl FromStr for Metric {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "exact" => Ok(Self::Exact),
            "haptic" => Ok(Self::Haptic),
            "velocity" => Ok(Self::Velocity),
            "view" => Ok(Self::View),
            _ => Err("give exact, haptic, velocity or view"),
        }
    }
}

const HELP: [&str; 3] = [
    "--metric NAME  Leave detail out by this metric: exact (none), haptic, velocity or view [default: haptic]",
    "--seconds S    Simulate at most so long [default: 5]",
    "--output DIR   Write the table and the plot there [default: target/spoon_in_cup]",
];

fn main() -> Result<(), Box<dyn Error>> {
    let mut line =
        CommandLine::new("Drops a spoon into a cup, and writes what happens as a table and a plot", &HELP);
    let metric = line.value("--metric", Metric::Haptic)?;
    let (seconds, output) =
        (line.seconds(5.0)?, line.value("--output", PathBuf::from("target/spoon_in_cup"))?);
    line.finish()?;
    let (spoon, cup) = (open("spoon")?, open("cup")?);
    let radius = spoon.bounding_radius();
    let error = match metric {
        Metric::Exact => ErrorMetrics::EXACT,
        Metric::Haptic => (ERROR * radius).into(),
        Metric::Velocity => {
            let metric = VelocityMetric { time: ERROR * radius, twist: Twist::ZERO };
            ErrorMetrics { velocity: Some(metric), ..ErrorMetrics::EXACT }
        }
        Metric::View => ErrorMetrics { view: Some(VIEW), ..ErrorMetrics::EXACT },
    };
    let settings = Settings { error, ..Settings::new(TOLERANCE * radius) };
    let body = RigidBody::solid(spoon.shape(), MASS)?;
    let start = above(&body, &spoon, &cup);
    let mut simulation = Simulation::new(body, spoon.shape(), cup.shape(), Pose::IDENTITY, start, settings)?;

    let mut csv = String::from("t,x,y,z,speed,energy,events,switched,impacts,queries,front,depth\n");
    let (mut height, mut energy, mut front) = (Vec::new(), Vec::new(), Vec::new());
    let (mut events, mut switched, mut impacts, mut micro, mut queries) = (0, 0, 0, 0, 0);
    let (mut first_hit, mut deepest, mut rising) = (None, 0.0f64, 0usize);
    let began = simulation.energy();
    let clock = Instant::now();
    while simulation.time() < seconds && simulation.still_for() < REST_TIME {
        let outcome = simulation.step(STEP)?;
        let time = simulation.time();
        let nodes = simulation.samples().last().map_or(0, |sample| sample.outcome.front);
        first_hit = first_hit.or(simulation.impacts().first().map(|impact| (impact.time, impact.approach)));
        rising += simulation.impacts().iter().filter(|hit| hit.energy_after > hit.energy_before).count();
        events += outcome.events;
        switched += outcome.switched;
        impacts += outcome.impacts;
        micro += outcome.micro;
        queries += outcome.queries;
        deepest = deepest.max(outcome.depth);
        let place = simulation.state().pose.translation;
        let speed = simulation.state().twist.linear.length();
        height.push((time, 1e3 * place.z));
        energy.push((time, 1e3 * simulation.energy()));
        front.push((time, nodes as f64));
        let DVec3 { x, y, z } = place;
        writeln!(
            csv,
            "{time:.3},{x:.7},{y:.7},{z:.7},{speed:.6},{:.9},{},{},{},{},{nodes},{:.9}",
            simulation.energy(),
            outcome.events,
            outcome.switched,
            outcome.impacts,
            outcome.queries,
            outcome.depth
        )?;
    }
    let took = clock.elapsed().as_secs_f64();
    let time = simulation.time();

    if let Some((time, approach)) = first_hit {
        say("first hit", format_args!("{time:.4} s at {approach:.2} m/s"))?;
    }
    say("impacts", format_args!("{impacts}, {micro} of them micro-collisions"))?;
    say("impacts at which energy rose", rising)?;
    say("collision events", format_args!("{events}, {switched} of them with a change of resolution"))?;
    say("deepest penetration", format_args!("{:.1} µm", 1e6 * deepest))?;
    say(
        "energy",
        format_args!("{:.1} mJ at first, {:.1} mJ at last", 1e3 * began, 1e3 * simulation.energy()),
    )?;
    if simulation.still_for() >= REST_TIME {
        say("at rest after", format_args!("{:.3} s", time - simulation.still_for()))?;
    } else {
        say("at rest after", format_args!("not in {time:.1} s"))?;
    }
    say("queries", format_args!("{queries}, {took:.2} s for {time:.2} s simulated"))?;

    std::fs::create_dir_all(&output)?;
    let figure = |axis: &str, points| Figure {
        caption: String::new(),
        across: "s".to_owned(),
        axis: axis.to_owned(),
        curves: vec![Curve { name: axis.to_owned(), points }],
    };
    let figures = [figure("height, mm", height), figure("energy, mJ", energy), figure("front, pairs", front)];
    for (name, text) in [("motion.csv", csv), ("motion.svg", draw(&figures)?)] {
        let file = output.join(name);
        std::fs::write(&file, text).map_err(|error| format!("{}: {error}", file.display()))?;
        say("written", file.display())?;
    }
    Ok(())
}

/// Returns the initial state: bowl first, leaning, over the middle of the mouth.
fn above(body: &RigidBody, spoon: &Object, cup: &Object) -> BodyState {
    const GAP: f64 = 5e-3;
    let upright = DQuat::from_rotation_y(-0.5 * std::f64::consts::PI);
    let rotation = DQuat::from_scaled_axis(DVec3::new(0.1, 0.2, 0.3)) * upright;
    let rim = cup.clod.vertices.iter().map(|vertex| vertex.z).fold(f64::NEG_INFINITY, f64::max);
    let lowest =
        spoon.clod.vertices.iter().map(|vertex| (rotation * *vertex).z).fold(f64::INFINITY, f64::min);
    let bowl = rotation * (0.04 * DVec3::X);
    let place = DVec3::new(-bowl.x, -bowl.y, rim + GAP - lowest);
    body.state(&Pose::new(place, rotation), Twist::ZERO)
}
