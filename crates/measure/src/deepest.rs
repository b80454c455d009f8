//! Deepest penetration along recorded poses, by exact queries.

use palpate::collide::{ContactQuery, ContactSet, ContactSetSettings, QuerySettings};
use palpate::{Object, Pose, Scene};
use rayon::prelude::*;
use serde::Serialize;

use crate::error::MeasureError;

/// Distance (m) below which surfaces count as in contact, at most a hundredth of the probe's bounding radius.
/// It has no influence on penetration; larger ones take longer.
const TOLERANCE: f64 = 1e-4;
const RELATIVE_TOLERANCE: f64 = 0.01;
/// Distance below which separated contacts are merged, in tolerances.
const MERGE_DISTANCE: f64 = 0.1;
/// Number of poses that are queried one after the other, each from where the one before ended.
const CHUNK: usize = 250;

/// Deepest penetration in a sequence of poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Deepest {
    /// Depth, m; 0 without penetration.
    pub depth: f64,
    /// Index of the first pose with this depth; none without penetration.
    pub index: Option<usize>,
    /// Number of poses deeper than the bound that was given.
    pub beyond: usize,
}

impl Deepest {
    /// Queries poses of the probe's mesh frame in the scene at full resolution, as `palpate query --exact`
    /// does: the depths are those of contact sets, whose regions of intersection count as a whole. `bound` is
    /// the depth (m) that deeper poses are counted from. Poses are divided among the threads of the caller's
    /// rayon pool; the result is the same for any number of them.
    ///
    /// # Errors
    /// If a query fails, because a pose is not valid.
    pub fn of(poses: &[Pose], probe: &Object, scene: &Scene, bound: f64) -> Result<Self, MeasureError> {
        let chunks: Vec<Result<Vec<f64>, MeasureError>> =
            poses.par_chunks(CHUNK).map(|chunk| depths(chunk, probe, scene)).collect();
        let mut deepest = Self::default();
        let mut index = 0;
        for depths in chunks {
            for depth in depths? {
                if depth > deepest.depth {
                    (deepest.depth, deepest.index) = (depth, Some(index));
                }
                deepest.beyond += usize::from(depth > bound);
                index += 1;
            }
        }
        Ok(deepest)
    }
}

/// Returns the deepest penetration at each pose, m.
fn depths(poses: &[Pose], probe: &Object, scene: &Scene) -> Result<Vec<f64>, MeasureError> {
    let settings = QuerySettings::new(TOLERANCE.min(RELATIVE_TOLERANCE * probe.bounding_radius()));
    let merging = ContactSetSettings::new(MERGE_DISTANCE * settings.tolerance);
    let mut depths = vec![0.0_f64; poses.len()];
    for placed in scene.objects() {
        let mut query = ContactQuery::new(probe.shape(), placed.object.shape());
        let mut set = ContactSet::new(probe.shape(), placed.object.shape());
        for (pose, deepest) in poses.iter().zip(&mut depths) {
            query.run(pose, &placed.pose, &settings)?;
            let found = set.run(query.contacts(), pose, &placed.pose, &merging)?;
            *deepest = found.iter().map(|found| found.contact.depth).fold(*deepest, f64::max);
        }
    }
    Ok(depths)
}

#[cfg(test)]
mod tests {
    use palpate::TriMesh;
    use palpate::glam::{DQuat, DVec3};

    use super::*;

    fn block(half: DVec3) -> Object {
        let corner = |index: usize| {
            let side = |bit: usize| if index >> bit & 1 == 1 { 1.0 } else { -1.0 };
            DVec3::new(side(0), side(1), side(2)) * half
        };
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let mesh = TriMesh::new((0..8).map(corner).collect(), triangles).expect("a block");
        Object::from_mesh("block", &mesh).expect("an object")
    }

    /// An edge that dips into the top of a block goes as deep as its height below the top, whatever the
    /// number of threads.
    #[test]
    fn the_deepest_pose_is_that_of_the_lowest_edge() {
        let (probe, floor) = (block(DVec3::splat(0.01)), block(DVec3::new(0.1, 0.1, 0.02)));
        let place = Pose::new(DVec3::new(0.3, -0.2, 0.1), DQuat::from_rotation_z(0.4));
        let scene = Scene::new().with(floor, place);
        let tilt = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_4);
        let half_diagonal = 0.01 * std::f64::consts::SQRT_2;
        let pose = |index: usize| {
            let depth = 1.5e-3 * (1e-3 * index as f64 * std::f64::consts::PI).sin() - 1e-4;
            place * Pose::new(DVec3::Z * (0.02 + half_diagonal - depth), tilt)
        };
        let poses: Vec<Pose> = (0..1000).map(pose).collect();
        let found = [1, 3].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| Deepest::of(&poses, &probe, &scene, 1e-3)).expect("queries")
        });
        assert_eq!(found[0], found[1]);
        assert!((found[0].depth - 1.4e-3).abs() < 1e-7, "{:?}", found[0]);
        assert_eq!(found[0].index, Some(500));
        // sin x > 1.1/1.5.
        let beyond = 1000.0 * (1.0 - 2.0 * (1.1_f64 / 1.5).asin() / std::f64::consts::PI);
        assert!((found[0].beyond as f64 - beyond).abs() < 2.0, "{:?} for {beyond}", found[0]);
        let apart = Deepest::of(&poses[..10], &probe, &scene, 0.0).expect("queries");
        assert_eq!(apart, Deepest::default(), "they begin apart");
    }
}
