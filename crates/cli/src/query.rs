//! `palpate query`: replays a trajectory of the probe and times each contact query.
//!
//! At full resolution the contacts reported are the contact set: local minima of the distance and one contact for each
//! region of intersection, made of the query's contacts between patches and timed with it. With an error or a budget
//! they are those between patches: making the set would take longer than such a query does, and contacts that fade in and
//! out between levels would lose their weights.

use std::path::Path;
use std::time::{Duration, Instant};

use palpate::collide::{
    Budget, Clustering, ContactQuery, ContactSet, ContactSetSettings, PatchContact, QueryError, QuerySettings,
};
use palpate::device::{Interpolation, MotionPath};
use palpate::{Object, Pose, Wrench};
use serde::Serialize;

use crate::arguments::{QueryArguments, detail_error};
use crate::failure::Failure;
use crate::{output, progress};

/// Separated contacts that are closer to one another than this part of the tolerance are merged in contact sets.
const MERGED: f64 = 0.1;

#[derive(Serialize)]
struct Replay {
    summary: Summary,
    poses: Vec<PoseEntry>,
}

#[derive(Serialize)]
struct Summary {
    poses: usize,
    median_us: f64,
    p99_us: f64,
    max_us: f64,
    front_median: f64,
    front_max: f64,
    contacts_median: f64,
    memory_bytes: usize,
}

#[derive(Serialize)]
struct PoseEntry {
    t: f64,
    query_us: f64,
    front: usize,
    contacts: usize,
    depth_max: f64,
    distance_min: Option<f64>,
    force: [f64; 3],
    torque: [f64; 3],
}

pub fn run(arguments: &QueryArguments) -> Result<(), Failure> {
    if !(arguments.stiffness.is_finite() && arguments.stiffness >= 0.0) {
        let message = format!("--stiffness {}: give N/m, 0 or more", arguments.stiffness);
        return Err(Failure::Message(message));
    }
    if !(1..=palpate::dynamics::MAX_CLUSTERS).contains(&arguments.clusters) {
        let most = palpate::dynamics::MAX_CLUSTERS;
        return Err(Failure::Message(format!("--clusters {}: give 1 to {most}", arguments.clusters)));
    }
    let read = [Path::new(&arguments.probe), Path::new(&arguments.scene), &arguments.trajectory];
    let written: Vec<&Path> =
        arguments.contacts.as_deref().into_iter().chain(arguments.json.file()).collect();
    output::check_files(&read, &written)?;
    let trajectory = MotionPath::load(&arguments.trajectory, Interpolation::Linear)?;
    let probe = progress::open(&arguments.probe, &arguments.reading.of_probe())?;
    let scene = progress::open(&arguments.scene, &arguments.reading.of_scene())?;
    let error = arguments.error.map_or(Ok(0.0), |error| detail_error(error, &probe))?;
    let settings = QuerySettings {
        error: error.into(),
        interpolate: arguments.interpolate,
        budget: arguments.budget_us.map(|us| Budget::Time(Duration::from_micros(us))),
        parallel: arguments.parallel,
        ..QuerySettings::new(arguments.tolerance.metres(probe.bounding_radius()))
    };
    settings.check(probe.shape()).map_err(|error| refused(error, &probe))?;
    let mut contacts_file = match &arguments.contacts {
        None => None,
        Some(path) => Some((path, contacts_writer(path)?)),
    };

    let mut query = ContactQuery::new(probe.shape(), scene.shape());
    let full_resolution = error == 0.0 && settings.budget.is_none();
    let mut set = full_resolution.then(|| ContactSet::new(probe.shape(), scene.shape()));
    let set_settings = ContactSetSettings::new(MERGED * settings.tolerance);
    let mut clustering = Clustering::new(arguments.clusters);
    let mut poses = Vec::with_capacity(trajectory.keyframes().len());
    let bar = progress::bar("contact queries");
    for sample in trajectory.keyframes() {
        if arguments.cold {
            query.reset();
        }
        let begun = Instant::now();
        let outcome = query
            .run(&sample.pose, &Pose::IDENTITY, &settings)
            .map_err(|error| Failure::Message(format!("the query at t = {} s: {error}", sample.time)))?;
        let found = match &mut set {
            Some(set) => {
                set.run(query.contacts(), &sample.pose, &Pose::IDENTITY, &set_settings).map_err(|error| {
                    Failure::Message(format!("the contact set at t = {} s: {error}", sample.time))
                })?
            }
            None => query.contacts(),
        };
        let query_us = begun.elapsed().as_secs_f64() * 1e6;
        let wrench = penalty(&mut clustering, found, &settings, arguments.stiffness, &sample.pose);
        if let Some((path, file)) = &mut contacts_file {
            write_contacts(file, sample.time, found, &probe, &scene)
                .map_err(|error| Failure::writing(path, error))?;
        }
        poses.push(PoseEntry {
            t: sample.time,
            query_us,
            front: outcome.front,
            contacts: found.len(),
            depth_max: found.iter().map(|found| found.contact.depth).fold(0.0, f64::max),
            distance_min: outcome.smallest_distance,
            force: wrench.force.to_array(),
            torque: wrench.torque.to_array(),
        });
        progress::set(&bar, poses.len() as f64 / trajectory.keyframes().len() as f64);
    }
    bar.finish_and_clear();
    if let Some((path, mut file)) = contacts_file {
        file.flush().map_err(|error| Failure::writing(path, error))?;
    }
    let memory = [&probe, &scene]
        .map(|object| object.clod.total_bytes() + object.shape().bytes())
        .iter()
        .sum::<usize>()
        + query.bytes()
        + set.as_ref().map_or(0, ContactSet::bytes);
    let replay = Replay { summary: summarise(&poses, memory), poses };
    output::result(&arguments.json, &replay, |table| {
        let Summary {
            poses,
            median_us,
            p99_us,
            max_us,
            front_median,
            front_max,
            contacts_median,
            memory_bytes,
        } = &replay.summary;
        table.row([&"poses", poses]);
        table.row([&"query", &format!("median {median_us:.1}, p99 {p99_us:.1}, max {max_us:.1} µs")]);
        table.row([&"front", &format!("median {front_median}, max {front_max} pairs of nodes")]);
        table.row([&"contacts", &format!("median {contacts_median}")]);
        let deepest = replay.poses.iter().map(|pose| pose.depth_max).fold(0.0, f64::max);
        table.row([&"deepest penetration", &format!("{:.6} mm", 1e3 * deepest)]);
        let nearest = replay.poses.iter().filter_map(|pose| pose.distance_min).reduce(f64::min);
        let nearest =
            nearest.map_or("none within the tolerance".to_owned(), |d| format!("{:.6} mm", 1e3 * d));
        table.row([&"smallest distance", &nearest]);
        table.row([&"memory", &format!("{:.1} MB", *memory_bytes as f64 / 1e6)]);
    })
}

/// What to change on the command line where a query does not take its settings.
fn refused(error: QueryError, probe: &Object) -> Failure {
    Failure::Message(match error {
        QueryError::Tolerance { given, most } => format!(
            "--tolerance is {given} m; give metres, at most the bounding radius of {} ({most:.3e} m)",
            probe.name
        ),
        other => other.to_string(),
    })
}

/// The penalty wrench of the clustered contacts on the probe (N; N·m about the probe's origin): each pushes along −n with
/// k(δ + d), Eq. 5.37 without damping.
fn penalty(
    clustering: &mut Clustering,
    contacts: &[PatchContact],
    settings: &QuerySettings,
    stiffness: f64,
    probe_pose: &Pose,
) -> Wrench {
    let clusters = clustering.run(contacts, settings.tolerance, probe_pose);
    clusters.iter().map(|cluster| cluster.contact).fold(Wrench::ZERO, |sum, contact| {
        let force = contact.normal * (-stiffness * (contact.depth + settings.tolerance).max(0.0));
        sum + Wrench::from_force_at(force, contact.point - probe_pose.translation)
    })
}

type CsvFile = csv::Writer<std::fs::File>;

fn contacts_writer(path: &Path) -> Result<CsvFile, Failure> {
    let mut file = csv::Writer::from_path(path).map_err(|error| Failure::writing(path, error))?;
    file.write_record(["t", "px", "py", "pz", "nx", "ny", "nz", "depth", "level_probe", "level_scene"])
        .map_err(|error| Failure::writing(path, error))?;
    Ok(file)
}

fn write_contacts(
    file: &mut CsvFile,
    time: f64,
    contacts: &[PatchContact],
    probe: &Object,
    scene: &Object,
) -> csv::Result<()> {
    for PatchContact { contact, probe_node, scene_node, .. } in contacts {
        let (p, n) = (contact.point, contact.normal);
        for number in [time, p.x, p.y, p.z, n.x, n.y, n.z, contact.depth] {
            file.write_field(number.to_string())?;
        }
        file.write_field(probe.clod.node(*probe_node).level.to_string())?;
        file.write_field(scene.clod.node(*scene_node).level.to_string())?;
        file.write_record(None::<&[u8]>)?;
    }
    Ok(())
}

fn summarise(poses: &[PoseEntry], memory_bytes: usize) -> Summary {
    let sorted = |value: &dyn Fn(&PoseEntry) -> f64| {
        let mut values: Vec<f64> = poses.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let times = sorted(&|pose| pose.query_us);
    let fronts = sorted(&|pose| pose.front as f64);
    let contacts = sorted(&|pose| pose.contacts as f64);
    Summary {
        poses: poses.len(),
        median_us: quantile(&times, 0.5),
        p99_us: quantile(&times, 0.99),
        max_us: quantile(&times, 1.0),
        front_median: quantile(&fronts, 0.5),
        front_max: quantile(&fronts, 1.0),
        contacts_median: quantile(&contacts, 0.5),
        memory_bytes,
    }
}

/// The quantile of sorted values by the nearest rank; 0 when there are none.
fn quantile(sorted: &[f64], fraction: f64) -> f64 {
    let rank = (fraction * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}
