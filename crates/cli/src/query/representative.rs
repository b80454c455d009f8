//! Replay of a trajectory with representative contacts.

use std::time::{Duration, Instant};

use palpate::collide::Containment;
use palpate::device::MotionPath;
use palpate::representative::{AreaContact, RepresentativeQuery};
use palpate::{Object, Pose};

use super::inside;
use super::{ContactsFile, PoseEntry, Reached, Replay, each_pose, settings_for, summarise};
use crate::arguments::{Length, QueryArguments};
use crate::failure::Failure;
use crate::progress;

pub fn replay(
    arguments: &QueryArguments,
    error: Length,
    objects @ [probe, scene]: [&Object; 2],
    trajectory: &MotionPath,
) -> Result<Replay, Failure> {
    let tolerance = settings_for(arguments, probe)?.tolerance;
    let error = error.metres(probe.bounding_radius());
    let bar = progress::bar("distance fields");
    let made = RepresentativeQuery::new(probe, scene, tolerance, error);
    bar.finish_and_clear();
    let budget = arguments.budget_us.map(Duration::from_micros);
    let mut query = made?.with_budget(budget);
    let mut containment = Containment::new(probe.shape(), scene.shape());
    let mut contacts_file = ContactsFile::create(arguments.contacts.as_deref(), &["area"])?;
    let poses = each_pose(trajectory, |sample| {
        if arguments.cold {
            query.reset();
        }
        let begun = Instant::now();
        let outcome = query.run(&sample.pose, &Pose::IDENTITY);
        let query_us = begun.elapsed().as_secs_f64() * 1e6;
        let wrench = query.wrench(&sample.pose, arguments.stiffness);
        for AreaContact { contact, area } in query.contacts() {
            contacts_file.write(sample.time, contact, [area.to_string()])?;
        }
        let (inside, depth) = inside::look(&mut containment, sample, objects)?;
        Ok(PoseEntry {
            t: sample.time,
            query_us,
            front: outcome.asked,
            contacts: outcome.contacts,
            depth_max: outcome.deepest.map_or(depth, |deepest| deepest.max(depth)),
            distance_min: inside.distance(outcome.deepest.map(|depth| (-depth).max(0.0))),
            force: wrench.force.to_array(),
            torque: wrench.torque.to_array(),
            inside,
            reached: Some(Reached {
                eps: outcome.error,
                complete: outcome.is_complete,
                too_deep: outcome.is_too_deep,
            }),
        })
    })?;
    contacts_file.finish()?;
    Ok(Replay { summary: summarise(&poses, query.bytes()), poses })
}
