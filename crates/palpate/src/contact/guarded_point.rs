//! A point of one surface that must not pass the other.

use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_field::{ClosestPoint, FeatureMesh, Leash, Place};

/// Largest number of moves that a point tries in a measurement. With more, a step takes longer; with fewer,
/// points follow fast motion late.
const MAX_MOVES: u32 = 3;

/// The same for a point that is new.
const MAX_FIRST_MOVES: u32 = 32;

/// Smallest fraction of the way along an edge that a point tries first. With less, points follow motion late.
const MIN_STRIDE: f32 = 1.0 / 64.0;

/// Factors on that fraction after a move that leads down, and after one that does not where the distance is
/// not convex.
const LONGER: f32 = 4.0;
const SHORTER: f64 = 0.25;

/// Smallest gain in distance for which a point moves, m. With less, rounding moves it.
const MIN_DESCENT: f64 = 1e-8;

/// A point on the vertices and edges of one surface, kept where it is nearest to the other.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GuardedPoint {
    /// Place on its own body's surface.
    place: Place,
    /// Part of that surface that it stays in.
    leash: Leash,
    /// Face of the other body's surface that is nearest.
    face: u32,
    /// Index of the scene object.
    pub object: u8,
    /// Whether it is on the body in the hand, or on the scene object.
    is_probe: bool,
    /// Fraction of the way along an edge that it tries next.
    stride: f32,
    /// Distance that the bodies may move before it has to be measured again, m.
    pub slack: f32,
}

/// A guarded point, measured.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measured {
    /// The point on the body in the hand, world, m.
    pub point: DVec3,
    /// Unit normal out of the body in the hand, world axes.
    pub normal: DVec3,
    /// Signed distance of the surfaces, negative where they overlap, m.
    pub distance: f64,
}

impl GuardedPoint {
    /// The place on the vertices and edges of a surface nearest to `home` (m, its mesh's frame), with the
    /// bodies' meshes at poses. It stays within `length` (m) of there.
    pub fn new(
        (home, length): (DVec3, f64),
        is_probe: bool,
        index: u8,
        probe: (&FeatureMesh, &Pose),
        object: (&FeatureMesh, &Pose),
    ) -> Self {
        let (own, other) = if is_probe { (probe, object) } else { (object, probe) };
        let place = own.0.place_near(home);
        let to_other = other.1.inverse() * *own.1;
        let face = other.0.nearest(to_other.transform_point(own.0.position(&place))).face;
        let leash = Leash { home: home.as_vec3(), length: length as f32 };
        let mut point = Self { place, leash, face, object: index, is_probe, stride: 1.0, slack: 0.0 };
        point.slack = point.descend(own, other, MAX_FIRST_MOVES).1.distance as f32;
        point
    }

    /// Moves the point to where its surface is nearest to the other one, and measures it.
    pub fn measure(&mut self, probe: (&FeatureMesh, &Pose), object: (&FeatureMesh, &Pose)) -> Measured {
        let (own, other) = if self.is_probe { (probe, object) } else { (object, probe) };
        let (position, closest) = self.descend(own, other, MAX_MOVES);
        let outward = other.1.transform_vector(closest.normal);
        if self.is_probe {
            let point = own.1.transform_point(position);
            Measured { point, normal: -outward, distance: closest.distance }
        } else {
            let point = other.1.transform_point(closest.point);
            Measured { point, normal: outward, distance: closest.distance }
        }
    }

    /// Moves the point down, in at most so many moves. Returns its position in its own body's frame (m), and
    /// the point of the other surface nearest to it, in that body's frame.
    fn descend(
        &mut self,
        (own, own_pose): (&FeatureMesh, &Pose),
        (other, other_pose): (&FeatureMesh, &Pose),
        moves: u32,
    ) -> (DVec3, ClosestPoint) {
        let to_other = other_pose.inverse() * *own_pose;
        let to_own = to_other.rotation.conjugate();
        let mut position = own.position(&self.place);
        let mut closest = other.walk(to_other.transform_point(position), self.face);
        let mut stride = self.stride;
        for _ in 0..moves {
            let normal = to_own * closest.normal;
            let Some(place) = own.descend(&self.place, normal, stride.into(), &self.leash) else {
                break;
            };
            let next = own.position(&place);
            let found = other.walk(to_other.transform_point(next), closest.face);
            if found.distance > closest.distance - MIN_DESCENT {
                let way = next - position;
                let Some(share) = self.share(&place, &closest, &found, [normal, to_own * found.normal], way)
                else {
                    break;
                };
                stride *= share;
                continue;
            }
            stride = (LONGER * stride).min(1.0);
            (self.place, position, closest) = (place, next, found);
        }
        self.stride = stride.max(MIN_STRIDE);
        self.face = closest.face;
        (position, closest)
    }

    /// The share to try of a way (m) to a place that is no lower; `None` if nothing lower is expected there.
    /// Along an edge the distance is above its tangents at both ends of the way, and lowest near where these
    /// meet: exactly there if it has a kink, as over another edge.
    fn share(
        &self,
        to: &Place,
        before: &ClosestPoint,
        after: &ClosestPoint,
        normals: [DVec3; 2],
        way: DVec3,
    ) -> Option<f32> {
        if matches!((self.place, to), (Place::Edge(from, _), Place::Edge(to, _)) if from != *to) {
            // Ways across a face have no share.
            return None;
        }
        let [slope, beyond] = normals.map(|normal| normal.dot(way));
        let share = (after.distance - before.distance - beyond) / (slope - beyond);
        let share = if beyond > 0.0 && share > 0.0 && share < 1.0 { share } else { SHORTER };
        (-slope * share > MIN_DESCENT).then_some(share as f32)
    }

    /// Key by which points that have descended to the same place are found.
    pub fn place_key(&self) -> (u8, bool, u32, u32, u64, u32) {
        let (feature, at) = match self.place {
            Place::Vertex(vertex) => (vertex, u64::MAX),
            Place::Edge(edge, at) => (edge, (at * 256.0) as u64),
        };
        (self.object, self.is_probe, self.face, feature, at, self.leash.length.to_bits())
    }
}

#[cfg(test)]
mod tests;
