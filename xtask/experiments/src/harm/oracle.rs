//! True distances between solids, by parry's GJK and EPA on their convex pieces. They know nothing of the
//! engine's fields, features and patches.

use palpate::Pose;
use palpate::glam::DVec3;
use parry3d_f64::math::{Pose as Isometry, Rotation, Vector};
use parry3d_f64::query::details::contact_support_map_support_map_with_params;
use parry3d_f64::query::gjk::{GJKResult, VoronoiSimplex};
use parry3d_f64::shape::SupportMap;

use super::solids::Solid;

/// Share of a distance by which a result of GJK or EPA may differ from what its own direction proves, and
/// the smallest such difference, relative to the probe's radius.
const PROOF: (f64, f64) = (1e-3, 1e-7);

/// Points whose convex hull is a piece.
struct Hull {
    points: Vec<Vector>,
    center: Vector,
    radius: f64,
}

impl Hull {
    fn new(points: &[DVec3], scale: f64) -> Self {
        let points: Vec<Vector> = points.iter().map(|point| vector(*point * scale)).collect();
        let center = points.iter().copied().sum::<Vector>() / points.len() as f64;
        let radius = points.iter().map(|point| point.distance(center)).fold(0.0, f64::max);
        Self { points, center, radius }
    }
}

impl SupportMap for Hull {
    fn local_support_point(&self, direction: Vector) -> Vector {
        let mut best = (f64::NEG_INFINITY, Vector::ZERO);
        for point in &self.points {
            let along = point.dot(direction);
            if along > best.0 {
                best = (along, *point);
            }
        }
        best.1
    }
}

fn vector(of: DVec3) -> Vector {
    Vector::from_array(of.to_array())
}

fn isometry(pose: &Pose, scale: f64) -> Isometry {
    Isometry::from_parts(vector(pose.translation * scale), Rotation::from_array(pose.rotation.to_array()))
}

/// A piece of the probe and one of the scene.
struct Pair {
    probe: usize,
    object: usize,
    piece: usize,
    /// Path of the probe up to which the two are certainly apart.
    apart: f64,
}

/// Distances between a probe and the objects of a scene, for poses that follow each other. Lengths within
/// are in radii of the probe, as GJK's tolerances are absolute.
pub struct Oracle {
    scale: f64,
    probe: Vec<Hull>,
    /// Pieces of each object, and its pose.
    objects: Vec<(Vec<Hull>, Isometry)>,
    pairs: Vec<Pair>,
    /// Path of the probe's fastest point since the start; the pose there.
    path: f64,
    pose: Option<Pose>,
    /// Pairs that neither GJK nor EPA could tell apart.
    pub unsolved: u64,
}

impl Oracle {
    pub fn new(probe: &Solid, objects: &[(&Solid, Pose)]) -> Self {
        let scale = 1.0 / probe.radius();
        let hulls = |solid: &Solid| solid.pieces.iter().map(|piece| Hull::new(piece, scale)).collect();
        let objects: Vec<(Vec<Hull>, Isometry)> =
            objects.iter().map(|(solid, pose)| (hulls(solid), isometry(pose, scale))).collect();
        let probe: Vec<Hull> = hulls(probe);
        let pairs = objects
            .iter()
            .enumerate()
            .flat_map(|(object, (pieces, _))| (0..pieces.len()).map(move |piece| (object, piece)));
        let pairs = pairs.flat_map(|(object, piece)| {
            (0..probe.len()).map(move |probe| Pair { probe, object, piece, apart: f64::NEG_INFINITY })
        });
        Self { pairs: pairs.collect(), scale, probe, objects, path: 0.0, pose: None, unsolved: 0 }
    }

    /// Takes the probe to a pose.
    pub fn place(&mut self, pose: &Pose) {
        if let Some(last) = self.pose {
            let turn = last.rotation_vector_to(pose).length();
            // The probe's mesh is about its origin, within its radius.
            self.path += last.translation.distance(pose.translation) * self.scale + turn;
        }
        self.pose = Some(*pose);
    }

    /// Returns the largest overlap of two pieces at this pose, m; 0 if all are apart.
    pub fn overlap(&mut self) -> f64 {
        let Some(pose) = self.pose.map(|pose| isometry(&pose, self.scale)) else { return 0.0 };
        let mut deepest: f64 = 0.0;
        for at in 0..self.pairs.len() {
            if self.pairs[at].apart <= self.path {
                deepest = deepest.max(-self.measure(at, &pose, 0.1));
            }
        }
        deepest / self.scale
    }

    /// Returns whether all objects are further away at this pose than a distance, m.
    pub fn is_beyond(&mut self, distance: f64) -> bool {
        let Some(pose) = self.pose.map(|pose| isometry(&pose, self.scale)) else { return true };
        let distance = distance * self.scale;
        for at in 0..self.pairs.len() {
            let known = self.pairs[at].apart - self.path;
            if known <= distance && self.measure(at, &pose, 1.2 * distance + 0.1) <= distance {
                // The next question starts with the pair that is near.
                self.pairs.swap(0, at);
                return false;
            }
        }
        true
    }

    /// Returns the distance of a pair at a pose, negative in an overlap, as far as `reach`.
    fn measure(&mut self, at: usize, pose: &Isometry, reach: f64) -> f64 {
        let Pair { probe, object, piece, .. } = self.pairs[at];
        let (probe, (pieces, place)) = (&self.probe[probe], &self.objects[object]);
        let piece = &pieces[piece];
        let between = (*pose * probe.center).distance(*place * piece.center) - probe.radius - piece.radius;
        let distance = if between > reach {
            between
        } else if let Some(found) = distance(probe, piece, &(pose.inverse() * *place), reach) {
            found
        } else {
            self.unsolved += 1;
            reach
        };
        self.pairs[at].apart = self.path + distance.max(0.0);
        distance
    }
}

/// Returns the distance of two hulls, negative where they overlap, and `reach` where they are further apart.
/// `None` if no direction of the start gives a result that its own direction proves.
fn distance(a: &Hull, b: &Hull, b_in_a: &Isometry, reach: f64) -> Option<f64> {
    let starts =
        [*b_in_a * b.center - a.center, Vector::X, Vector::Y, Vector::Z, Vector::new(-0.3, 0.5, -0.7)];
    starts.into_iter().find_map(|start| {
        let start = start.try_normalize()?;
        let mut simplex = VoronoiSimplex::new();
        match contact_support_map_support_map_with_params(b_in_a, a, b, reach, &mut simplex, Some(start)) {
            GJKResult::ClosestPoints(on_a, on_b, normal) => {
                let found = (on_b - on_a).dot(normal);
                let off = (gap(a, b, b_in_a, normal) - found).abs();
                (off <= PROOF.0 * found.abs() + PROOF.1).then_some(found)
            }
            // Parry gives a direction that separates them, or any if it has failed.
            GJKResult::NoIntersection(direction) => {
                let proved = gap(a, b, b_in_a, direction).max(gap(a, b, b_in_a, -direction));
                (proved > (1.0 - PROOF.0) * reach - PROOF.1).then_some(reach)
            }
            GJKResult::Intersection | GJKResult::Proximity(_) => None,
        }
    })
}

/// Returns the gap between two hulls along a direction: the distance is at least as large, and they overlap
/// by no more than its negative.
fn gap(a: &Hull, b: &Hull, b_in_a: &Isometry, direction: Vector) -> f64 {
    let far = a.local_support_point(direction).dot(direction);
    let back = -(b_in_a.rotation.inverse() * direction);
    (*b_in_a * b.local_support_point(back)).dot(direction) - far
}

#[cfg(test)]
mod tests {
    use palpate::glam::DQuat;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::super::solids::polygon;
    use super::*;

    /// Blocks that lie on one another or apart, and cylinders in tubes, at known distances.
    #[test]
    fn distances_are_those_of_the_construction() {
        let mut rng = StdRng::seed_from_u64(3);
        for round in 0..300 {
            let half = DVec3::from_array([(); 3].map(|()| rng.random_range(0.1..1.0)));
            let (under, over) = (Solid::block(half * 3.0, &mut rng), Solid::block(half, &mut rng));
            let wanted = rng.random_range(-0.02..0.05) * if round % 3 == 0 { 1e-4 } else { 1.0 };
            let turn = DQuat::from_rotation_z(rng.random_range(0.0..6.0));
            let at = Pose::new(DVec3::new(0.1, -0.1, 4.0 * half.z + wanted), turn);
            let world = Pose::new(
                DVec3::from_array([(); 3].map(|()| rng.random_range(-2.0..2.0))),
                DQuat::from_euler(palpate::glam::EulerRot::XYZ, rng.random_range(0.0..6.0), 0.4, 1.0),
            );
            let mut oracle = Oracle::new(&over, &[(&under, world)]);
            oracle.place(&(world * at));
            let overlap = oracle.overlap();
            assert!((overlap - (-wanted).max(0.0)).abs() < 1e-9, "{overlap} for {wanted}");
            assert_eq!(oracle.is_beyond(wanted.max(0.0) * 0.999), wanted > 0.0);
            assert!(!oracle.is_beyond(wanted.max(0.0) * 1.001 + 1e-9));
            assert_eq!(oracle.unsolved, 0);
        }
        // A shaft in a tube with the sides of both aligned.
        let section =
            [[1.0, -0.5], [2.0, -0.5], [2.0, 0.5], [1.0, 0.5]].map(|[x, y]| palpate::glam::DVec2::new(x, y));
        let tube = Solid::turned_ring(&section, 24);
        let shaft = Solid::prism(&polygon(24, 0.9), 3.0, &mut rng);
        let flat = (std::f64::consts::TAU / 48.0).cos();
        for shift in [0.0, 0.05, 0.0999, 0.1001, 0.13] {
            let out =
                DVec3::new((std::f64::consts::TAU / 48.0).cos(), (std::f64::consts::TAU / 48.0).sin(), 0.0);
            let mut oracle = Oracle::new(&shaft, &[(&tube, Pose::IDENTITY)]);
            oracle.place(&Pose::from_translation(out * (shift * flat)));
            let wanted = (shift - 0.1) * flat;
            assert!((oracle.overlap() - wanted.max(0.0)).abs() < 1e-9, "{} for {wanted}", oracle.overlap());
        }
    }

    /// What is known of earlier poses does not change the answer.
    #[test]
    fn poses_that_follow_each_other_are_measured_as_each_alone() {
        let mut rng = StdRng::seed_from_u64(4);
        let (ball, block) = (Solid::ball(1.0, 8, 12, &mut rng), Solid::block(DVec3::ONE, &mut rng));
        let objects = [(&block, Pose::IDENTITY), (&ball, Pose::from_translation(DVec3::new(3.0, 0.5, 0.0)))];
        let mut oracle = Oracle::new(&ball, &objects);
        let (mut overlaps, mut free) = (0, 0);
        for step in 0..2000 {
            let time = 0.005 * f64::from(step);
            let pose = Pose::new(
                DVec3::new(3.0 * time.sin(), 2.5 * (1.7 * time).cos(), 0.3),
                DQuat::from_rotation_y(2.0 * time),
            );
            let mut alone = Oracle::new(&ball, &objects);
            oracle.place(&pose);
            alone.place(&pose);
            let (seen, wanted) = (oracle.overlap(), alone.overlap());
            assert!((seen - wanted).abs() < 1e-9, "step {step}: {seen}, alone {wanted}");
            let beyond = oracle.is_beyond(0.2);
            assert_eq!(beyond, alone.is_beyond(0.2), "step {step}");
            overlaps += usize::from(seen > 0.0);
            free += usize::from(beyond);
        }
        assert!(overlaps > 100 && free > 100, "{overlaps} and {free}");
    }
}
