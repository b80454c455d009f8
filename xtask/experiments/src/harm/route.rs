//! Route of a grasped object: moves from pose to pose, each smooth from rest to rest.

use palpate::Pose;
use palpate::glam::DVec3;
use palpate_tests::smooth;

/// Largest acceleration of a hand, m/s².
const ACCELERATION: f64 = 30.0;
/// Largest angular speed, rad/s.
const TURNING: f64 = 3.0;

/// Poses at times, s.
#[derive(Clone, Debug)]
pub struct Route {
    stops: Vec<(f64, Pose)>,
    /// Largest speed of a move, m/s.
    speed: f64,
}

impl Route {
    /// Starts a route at a pose, with moves that reach at most a speed, m/s.
    pub fn from(pose: Pose, speed: f64) -> Self {
        Self { stops: vec![(0.0, pose)], speed }
    }

    pub fn start(&self) -> Pose {
        self.stops[0].1
    }

    /// Returns the end of the route.
    pub fn last(&self) -> (f64, Pose) {
        self.stops[self.stops.len() - 1]
    }

    /// Stays for a time, s.
    pub fn rest(&mut self, time: f64) {
        let (since, pose) = self.last();
        self.stops.push((since + time, pose));
    }

    /// Moves to a pose at the route's speed, or more slowly where that would take more acceleration than a
    /// hand has.
    pub fn go(&mut self, pose: Pose) {
        let (since, from) = self.last();
        let length = from.translation.distance(pose.translation);
        // The smooth step is at most half as fast again as the mean, and accelerates by 6 lengths in the
        // square of its time.
        let time = (1.5 * length / self.speed)
            .max((6.0 * length / ACCELERATION).sqrt())
            .max(1.5 * from.rotation_vector_to(&pose).length() / TURNING);
        self.stops.push((since + time.max(2e-3), pose));
    }

    /// Moves in a direction, m.
    pub fn shift(&mut self, by: DVec3) {
        let (_, pose) = self.last();
        self.go(Pose::new(pose.translation + by, pose.rotation));
    }

    /// Returns the pose at a time, s.
    pub fn at(&self, time: f64) -> Pose {
        let next = self.stops.partition_point(|(then, _)| *then <= time);
        let Some(&(end, to)) = self.stops.get(next) else { return self.last().1 };
        let (start, from) = self.stops[next - 1];
        let part = smooth(start, end, time);
        let turn = from.rotation_vector_to(&to) * part;
        Pose::new(
            from.translation.lerp(to.translation, part),
            palpate::glam::DQuat::from_scaled_axis(turn) * from.rotation,
        )
    }

    /// Returns the route seen from other axes.
    #[must_use]
    pub fn placed(mut self, axes: &Pose) -> Self {
        self.stops.iter_mut().for_each(|(_, pose)| *pose = *axes * *pose);
        self
    }

    /// Returns all poses at which a move starts or ends.
    pub fn stops(&self) -> impl Iterator<Item = &Pose> {
        self.stops.iter().map(|(_, pose)| pose)
    }
}
