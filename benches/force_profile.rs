//! Profiles of contact force and torque along a path, at several errors s₀ against full resolution, as in
//! Figs. 3.15 and 3.16 (§3.5.3): same path, same stiffness, penalties at five clusters of the query's
//! contacts.
//!
//! `cargo bench -p palpate-benches --bench force_profile -- --scenario jaws golf --svg FOLDER`, where the
//! pictures are written. Profiles are magnitudes, a value a millisecond; torques are about the probe's centre
//! of mass. `in contact` leaves out the parts of the path without force at full resolution, on which all
//! agree easily. §3.5.3 calls profiles alike whose second derivatives are almost identical, and does not say
//! how these were taken: here they are central differences, of the profiles as they are and smoothed by a
//! Gaussian (`--smoothing`, its standard deviation in ms). The deviation is that of the profiles about their
//! means, |(F − F̄) − (F₀ − F̄₀)|, in percent of the mean at full resolution: a coarser surface lies
//! elsewhere, which shifts the mean.

#![allow(missing_docs, clippy::print_stdout, reason = "it prints tables")]

use std::error::Error;
use std::path::{Path, PathBuf};

use clap::Parser;
use palpate_benches::engine::EngineQuery;
use palpate_benches::method::Method as _;
use palpate_benches::penalty::Penalty;
use palpate_benches::scenarios::{self, Scenario};
use palpate_measure::{correlation, mean};
use palpate_report::{Curve, Figure, draw};

#[derive(Parser)]
#[command(about = "Force profiles at several errors against full resolution")]
struct Arguments {
    /// Scenarios; all of them by default
    #[arg(long, num_args = 1.., value_name = "NAME")]
    scenario: Vec<String>,
    /// Standard deviation of the smoothing before second derivatives are taken, ms
    #[arg(long, default_value_t = 10.0)]
    smoothing: f64,
    /// Folder for a picture of each scenario's profiles
    #[arg(long)]
    svg: Option<PathBuf>,
    /// Argument that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

/// Error thresholds s₀, relative to the probe's radius.
const ERRORS: [f64; 4] = [0.004, 0.01, 0.025, 0.05];

/// Magnitudes along the path, for stiffness 1.
struct Profile {
    /// Forces, m.
    force: Vec<f64>,
    /// Torques, m².
    torque: Vec<f64>,
}

impl Profile {
    /// Computes the profile at an error threshold relative to the probe's radius.
    fn new(scenario: &Scenario, error: f64, interpolate: bool) -> Self {
        let Scenario { probe, scene, poses, tolerance, .. } = scenario;
        let mut query = EngineQuery::new(&probe.object, &scene.object, *tolerance);
        query.settings.error = (error * probe.object.bounding_radius()).into();
        query.settings.interpolate = interpolate;
        let mut penalty = Penalty::default();
        let about = probe.object.clod.source.center_of_mass;
        let wrenches = poses.iter().map(|pose| {
            query.run(pose);
            let wrench = penalty.wrench(query.contacts(), *tolerance, pose, about);
            (wrench.force.length(), wrench.torque.length())
        });
        let (force, torque) = wrenches.unzip();
        Self { force, torque }
    }
}

/// Smooths by a Gaussian with a standard deviation in samples, cut off at three of them and at the ends.
fn smoothed(values: &[f64], deviation: f64) -> Vec<f64> {
    let reach = (3.0 * deviation).ceil() as usize;
    let weight =
        |apart: usize| if apart == 0 { 1.0 } else { (-0.5 * (apart as f64 / deviation).powi(2)).exp() };
    let at = |index: usize| {
        let near = index.saturating_sub(reach)..(index + reach + 1).min(values.len());
        let sum: f64 = near.clone().map(|other| weight(other.abs_diff(index)) * values[other]).sum();
        sum / near.map(|other| weight(other.abs_diff(index))).sum::<f64>()
    };
    (0..values.len()).map(at).collect()
}

/// Returns second differences.
fn curvature(values: &[f64]) -> Vec<f64> {
    values.windows(3).map(|three| three[0] - 2.0 * three[1] + three[2]).collect()
}

fn average(values: &[f64]) -> f64 {
    mean(values.iter().copied())
}

/// Returns the largest deviation about the means, relative to the mean of the exact profile.
fn deviation(values: &[f64], exact: &[f64]) -> f64 {
    let (center, exact_center) = (average(values), average(exact));
    let off = values.iter().zip(exact).map(|(x, y)| ((x - center) - (y - exact_center)).abs());
    off.fold(0.0, f64::max) / exact_center
}

fn compare(scenario: &Scenario, arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let exact = Profile::new(scenario, 0.0, false);
    let in_contact = |values: &[f64]| -> Vec<f64> {
        values.iter().zip(&exact.force).filter(|(_, exact)| **exact > 0.0).map(|(value, _)| *value).collect()
    };
    println!(
        "## {}: {} on {}, {} poses\n",
        scenario.name,
        scenario.probe.short_name(),
        scenario.scene.short_name(),
        scenario.poses.len()
    );
    println!(
        "| s₀, % | interpolated | correlation of force | in contact | of torque | of the force's 2nd derivative | smoothed | of the torque's, smoothed | mean force, % of exact | force off about the mean, % | torque |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let [mut force, mut torque] = [&exact.force, &exact.torque].map(|values| {
        [false, true].map(|interpolate| (interpolate, vec![("exact".to_owned(), values.clone())]))
    });
    for error in ERRORS {
        for interpolate in [false, true] {
            let profile = Profile::new(scenario, error, interpolate);
            let of_curvature = |values: &[f64], exact: &[f64], smoothing: f64| {
                correlation(&curvature(&smoothed(values, smoothing)), &curvature(&smoothed(exact, smoothing)))
            };
            println!(
                "| {} | {} | {:.4} | {:.4} | {:.4} | {:.3} | {:.3} | {:.3} | {:.1} | {:.1} | {:.1} |",
                100.0 * error,
                if interpolate { "yes" } else { "no" },
                correlation(&profile.force, &exact.force),
                correlation(&in_contact(&profile.force), &in_contact(&exact.force)),
                correlation(&profile.torque, &exact.torque),
                of_curvature(&profile.force, &exact.force, 0.0),
                of_curvature(&profile.force, &exact.force, arguments.smoothing),
                of_curvature(&profile.torque, &exact.torque, arguments.smoothing),
                100.0 * average(&profile.force) / average(&exact.force),
                100.0 * deviation(&profile.force, &exact.force),
                100.0 * deviation(&profile.torque, &exact.torque),
            );
            let name = format!("{} %", 100.0 * error);
            force[usize::from(interpolate)].1.push((name.clone(), profile.force));
            torque[usize::from(interpolate)].1.push((name, profile.torque));
        }
    }
    println!();
    if let Some(folder) = &arguments.svg {
        let figure = |quantity: &str, scale: f64, interpolate: bool, profiles: Vec<(String, Vec<f64>)>| {
            let curve = |(name, values): (String, Vec<f64>)| {
                let points = (0..).zip(values).map(|(step, value)| (1e-3 * f64::from(step), scale * value));
                Curve { name, points: points.collect() }
            };
            let how = if interpolate { ", interpolated" } else { "" };
            Figure {
                caption: String::new(),
                across: "s".to_owned(),
                axis: format!("{quantity}{how}"),
                curves: profiles.into_iter().map(curve).collect(),
            }
        };
        let of_force = force.into_iter().map(|(how, own)| figure("|F|/k, mm", 1e3, how, own));
        let of_torque = torque.into_iter().map(|(how, own)| figure("|T|/k, mm²", 1e6, how, own));
        let figures: Vec<Figure> = of_force.chain(of_torque).collect();
        write(folder, &scenario.name, &draw(&figures)?)?;
    }
    Ok(())
}

fn write(folder: &Path, name: &str, picture: &str) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join(name).with_extension("svg"), picture)
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    scenarios::each(&arguments.scenario, |scenario| compare(scenario, &arguments))
}
