//! `palpate query`: replays a trajectory of the probe and times each contact query.
//!
//! At full resolution it reports the contact set: local minima of the distance and one contact for each
//! region of intersection, made from the query's contacts between patches and timed with it. With an error or
//! a budget it reports the contacts between patches: making the set would take longer than such a query, and
//! contacts that blend between levels would lose their weights. Representative contacts are found in distance
//! fields instead.

mod inside;
mod representative;

use std::fmt::Display;
use std::path::Path;
use std::time::{Duration, Instant};

use palpate::collide::{
    Budget, Clustering, ContactQuery, ContactSet, ContactSetSettings, Containment, PatchContact, QueryError,
    QueryOutcome, QuerySettings,
};
use palpate::device::{Interpolation, Keyframe, MotionPath};
use palpate::{Contact, Object, Pose, Wrench};
use serde::Serialize;

use self::inside::{Inside, Insides};
use crate::arguments::{QueryArguments, detail_error};
use crate::failure::Failure;
use crate::{output, progress};

/// Distance below which separated contacts are merged in contact sets, in tolerances. With a smaller one, a
/// nearly flat region gives many contacts; with a larger one, distinct contacts are merged.
const MERGE_DISTANCE: f64 = 0.1;

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
    /// At how many poses a part of the one object is wholly inside the other.
    #[serde(flatten)]
    inside: Insides,
    /// Largest error EPS of representative contacts, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    eps: Option<f64>,
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
    #[serde(flatten)]
    inside: Inside,
    /// Accuracy of representative contacts.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    reached: Option<Reached>,
}

/// Accuracy that a query of representative contacts reached.
#[derive(Clone, Copy, Serialize)]
struct Reached {
    /// Error of depths, m.
    eps: f64,
    /// Whether all samples were read.
    complete: bool,
    /// Whether the objects penetrate deeper than the fields' distances reach.
    too_deep: bool,
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
    let objects = [&probe, &scene];
    let replay = match arguments.representative {
        Some(error) => representative::replay(arguments, error, objects, &trajectory)?,
        None => replay(arguments, objects, &trajectory)?,
    };
    output::result(&arguments.json, &replay, |table| {
        print(&replay, arguments.representative.is_some(), table)
    })
}

/// Replays a trajectory with contacts by levels of detail.
fn replay(
    arguments: &QueryArguments,
    objects @ [probe, scene]: [&Object; 2],
    trajectory: &MotionPath,
) -> Result<Replay, Failure> {
    let error = arguments.error.map_or(Ok(0.0), |error| detail_error(error, probe))?;
    let settings = QuerySettings {
        error: error.into(),
        interpolate: arguments.interpolate,
        budget: arguments.budget_us.map(|us| Budget::Time(Duration::from_micros(us))),
        parallel: arguments.parallel,
        ..settings_for(arguments, probe)?
    };
    let columns = ["level_probe", "level_scene"];
    let mut contacts_file = ContactsFile::create(arguments.contacts.as_deref(), &columns)?;
    let level = |object: &Object, node: u32| object.clod.node(node).level.to_string();

    let mut query = ContactQuery::new(probe.shape(), scene.shape());
    let full_resolution = error == 0.0 && settings.budget.is_none();
    let mut set = full_resolution.then(|| ContactSet::new(probe.shape(), scene.shape()));
    let mut containment = Containment::new(probe.shape(), scene.shape());
    let mut clustering = Clustering::new(arguments.clusters);
    let poses = each_pose(trajectory, |sample @ Keyframe { time, pose }| {
        if arguments.cold {
            query.reset();
        }
        let begun = Instant::now();
        let (outcome, found, contained) = contacts(&mut query, set.as_mut(), &settings, sample)?;
        let query_us = begun.elapsed().as_secs_f64() * 1e6;
        let wrench = penalty(&mut clustering, found, &settings, arguments.stiffness, pose);
        for PatchContact { contact, probe_node, scene_node, .. } in found {
            let levels = [level(probe, *probe_node), level(scene, *scene_node)];
            contacts_file.write(*time, contact, levels)?;
        }
        let (inside, depth) = match contained {
            Some(parts) => (Inside::of(parts, objects), 0.0),
            None => inside::look(&mut containment, sample, objects)?,
        };
        Ok(PoseEntry {
            t: *time,
            query_us,
            front: outcome.front,
            contacts: found.len(),
            depth_max: found.iter().map(|found| found.contact.depth).fold(depth, f64::max),
            distance_min: inside.distance(outcome.smallest_distance),
            force: wrench.force.to_array(),
            torque: wrench.torque.to_array(),
            inside,
            reached: None,
        })
    })?;
    contacts_file.finish()?;
    let bytes = objects.map(|object| object.clod.total_bytes() + object.shape().bytes());
    let memory = bytes[0] + bytes[1] + query.bytes() + set.as_ref().map_or(0, ContactSet::bytes);
    Ok(Replay { summary: summarise(&poses, memory), poses })
}

/// Outcome and contacts of a query, with the number of parts of either object that are wholly inside the
/// other.
type Answer<'a> = (QueryOutcome, &'a [PatchContact], Option<[usize; 2]>);

/// Finds the contacts at a pose: those between patches, or those of the contact set, with the number of parts
/// of either object that are wholly inside the other.
fn contacts<'a>(
    query: &'a mut ContactQuery,
    set: Option<&'a mut ContactSet>,
    settings: &QuerySettings,
    Keyframe { time, pose }: &Keyframe,
) -> Result<Answer<'a>, Failure> {
    let failed =
        |what: &str, error: &dyn Display| Failure::Message(format!("{what} at t = {time} s: {error}"));
    let outcome = query.run(pose, &Pose::IDENTITY, settings).map_err(|error| failed("the query", &error))?;
    let Some(set) = set else { return Ok((outcome, query.contacts(), None)) };
    let merging = ContactSetSettings::new(MERGE_DISTANCE * settings.tolerance);
    set.run(query.contacts(), pose, &Pose::IDENTITY, &merging)
        .map_err(|error| failed("the contact set", &error))?;
    let contained = set.outcome().contained;
    Ok((outcome, set.contacts(), Some(contained)))
}

/// Query settings at full resolution, with the tolerance checked.
fn settings_for(arguments: &QueryArguments, probe: &Object) -> Result<QuerySettings, Failure> {
    let settings = QuerySettings::new(arguments.tolerance.metres(probe.bounding_radius()));
    settings.check(probe.shape()).map_err(|error| refused(error, probe))?;
    Ok(settings)
}

/// Runs a query at each pose of a trajectory.
fn each_pose(
    trajectory: &MotionPath,
    mut query: impl FnMut(&Keyframe) -> Result<PoseEntry, Failure>,
) -> Result<Vec<PoseEntry>, Failure> {
    let keyframes = trajectory.keyframes();
    let bar = progress::bar("contact queries");
    let mut poses = Vec::with_capacity(keyframes.len());
    for sample in keyframes {
        poses.push(query(sample)?);
        progress::set(&bar, poses.len() as f64 / keyframes.len() as f64);
    }
    bar.finish_and_clear();
    Ok(poses)
}

fn print(replay: &Replay, are_representative: bool, table: &mut output::Table) {
    let Summary {
        poses,
        median_us,
        p99_us,
        max_us,
        front_median,
        front_max,
        contacts_median,
        memory_bytes,
        inside,
        eps,
    } = &replay.summary;
    table.row([&"poses", poses]);
    table.row([&"query", &format!("median {median_us:.1}, p99 {p99_us:.1}, max {max_us:.1} µs")]);
    let of = if are_representative { "distances computed, four at a time" } else { "pairs of nodes" };
    table.row([&"front", &format!("median {front_median}, max {front_max} {of}")]);
    table.row([&"contacts", &format!("median {contacts_median}")]);
    let deepest = replay.poses.iter().map(|pose| pose.depth_max).fold(0.0, f64::max);
    table.row([&"wholly inside", inside]);
    table.row([&"deepest penetration", &format!("{:.6} mm", 1e3 * deepest)]);
    let nearest = replay.poses.iter().filter_map(|pose| pose.distance_min).reduce(f64::min);
    let nearest = nearest.map_or("none within the tolerance".to_owned(), |d| format!("{:.6} mm", 1e3 * d));
    table.row([&"smallest distance", &nearest]);
    if let Some(eps) = eps {
        table.row([&"largest error", &format!("{:.6} mm", 1e3 * eps)]);
    }
    let count = |is: fn(&Reached) -> bool| {
        replay.poses.iter().filter_map(|pose| pose.reached.as_ref()).filter(|r| is(r)).count()
    };
    let (short, deep) = (count(|reached| !reached.complete), count(|reached| reached.too_deep));
    if short > 0 {
        table.row([&"out of time", &format!("at {short} poses, where fewer samples were used")]);
    }
    if deep > 0 {
        table.row([&"too deep", &format!("at {deep} poses, where forces are too small: raise --tolerance")]);
    }
    table.row([&"memory", &format!("{:.1} MB", *memory_bytes as f64 / 1e6)]);
}

/// Failure that names the option to change if a query refuses its settings.
fn refused(error: QueryError, probe: &Object) -> Failure {
    Failure::Message(match error {
        QueryError::Tolerance { given, most } => format!(
            "--tolerance is {given} m; give metres, at most the bounding radius of {} ({most:.3e} m)",
            probe.name
        ),
        other => other.to_string(),
    })
}

/// Penalty wrench of the clustered contacts on the probe (N; N·m about the probe's origin): each pushes along
/// −n with k(δ + d), Eq. 5.37 without damping.
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

/// Writer of contacts to a file, if `--contacts` was given, with extra columns for the kind of contacts.
struct ContactsFile<'a>(Option<(&'a Path, csv::Writer<std::fs::File>)>);

impl<'a> ContactsFile<'a> {
    fn create(path: Option<&'a Path>, columns: &[&str]) -> Result<Self, Failure> {
        let Some(path) = path else { return Ok(Self(None)) };
        let failed = |error: csv::Error| Failure::writing(path, error);
        let mut file = csv::Writer::from_path(path).map_err(failed)?;
        let all = ["t", "px", "py", "pz", "nx", "ny", "nz", "depth"];
        file.write_record(all.iter().chain(columns)).map_err(failed)?;
        Ok(Self(Some((path, file))))
    }

    fn write(
        &mut self,
        time: f64,
        contact: &Contact,
        more: impl IntoIterator<Item = String>,
    ) -> Result<(), Failure> {
        let Some((path, file)) = &mut self.0 else { return Ok(()) };
        let Contact { point: p, normal: n, depth, .. } = contact;
        let all = [time, p.x, p.y, p.z, n.x, n.y, n.z, *depth].map(|number| number.to_string());
        file.write_record(all.into_iter().chain(more)).map_err(|error| Failure::writing(path, error))
    }

    fn finish(self) -> Result<(), Failure> {
        let Some((path, mut file)) = self.0 else { return Ok(()) };
        file.flush().map_err(|error| Failure::writing(path, error))
    }
}

fn summarise(poses: &[PoseEntry], memory_bytes: usize) -> Summary {
    let sorted = |value: &dyn Fn(&PoseEntry) -> f64| {
        let mut values: Vec<f64> = poses.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let eps = poses.iter().filter_map(|pose| pose.reached).map(|reached| reached.eps).reduce(f64::max);
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
        inside: poses.iter().map(|pose| pose.inside).collect(),
        eps,
    }
}

/// Quantile of sorted values by the nearest rank; 0 without values.
fn quantile(sorted: &[f64], fraction: f64) -> f64 {
    let rank = (fraction * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}
