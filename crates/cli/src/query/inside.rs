//! What is told of objects of which a part is wholly inside the other.
//!
//! At full resolution the contact set finds such parts. Queries by levels of detail and of representative
//! contacts know surfaces that are near each other only, so that they are looked for beside them.

use std::fmt;

use palpate::collide::Containment;
use palpate::device::Keyframe;
use palpate::{Object, Pose};
use serde::Serialize;

use crate::failure::Failure;

/// Whether a connected part of the probe is wholly inside the scene object at a pose, and the reverse; none
/// where that is not defined, because the mesh of the other object is open.
#[derive(Clone, Copy, Serialize)]
pub struct Inside {
    probe_inside: Option<bool>,
    scene_inside: Option<bool>,
}

impl Inside {
    /// From the numbers of the probe's and the scene object's parts that are inside.
    pub fn of([of_probe, of_scene]: [usize; 2], [probe, scene]: [&Object; 2]) -> Self {
        let is_solid = |object: &Object| object.clod.source.solid;
        Self {
            probe_inside: is_solid(scene).then_some(of_probe > 0),
            scene_inside: is_solid(probe).then_some(of_scene > 0),
        }
    }

    /// The smallest separation distance, m: what a query found, or 0 where a part is inside.
    pub fn distance(&self, found: Option<f64>) -> Option<f64> {
        let is_inside = self.probe_inside == Some(true) || self.scene_inside == Some(true);
        if is_inside { Some(0.0) } else { found }
    }
}

/// Looks for parts that are wholly inside at a pose. Also returns the largest depth of one, m; 0 without any.
pub fn look(
    containment: &mut Containment,
    Keyframe { time, pose }: &Keyframe,
    objects: [&Object; 2],
) -> Result<(Inside, f64), Failure> {
    let found = containment
        .run(pose, &Pose::IDENTITY)
        .map_err(|error| Failure::Message(format!("the search for parts inside at t = {time} s: {error}")))?;
    let depth = found.iter().map(|found| found.contact.depth).fold(0.0, f64::max);
    Ok((Inside::of(containment.parts(), objects), depth))
}

/// At how many poses each object, or a part of it, is wholly inside the other; none where that is not
/// defined.
#[derive(Serialize)]
pub struct Insides {
    probe_inside: Option<usize>,
    scene_inside: Option<usize>,
}

impl FromIterator<Inside> for Insides {
    fn from_iter<I: IntoIterator<Item = Inside>>(poses: I) -> Self {
        let none = Self { probe_inside: Some(0), scene_inside: Some(0) };
        poses.into_iter().fold(none, |sum, pose| {
            let add = |sum: Option<usize>, inside: Option<bool>| Some(sum? + usize::from(inside?));
            Self {
                probe_inside: add(sum.probe_inside, pose.probe_inside),
                scene_inside: add(sum.scene_inside, pose.scene_inside),
            }
        })
    }
}

impl fmt::Display for Insides {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = |name: &str, other: &str, poses: Option<usize>| match poses {
            Some(0) => format!("{name} at none"),
            Some(poses) => format!("{name} at {poses} poses"),
            None => format!("{name} unknown, since {other} is open"),
        };
        let of_probe = line("the probe", "the scene object's mesh", self.probe_inside);
        let of_scene = line("the scene object", "the probe's mesh", self.scene_inside);
        write!(formatter, "{of_probe}, {of_scene}")
    }
}
