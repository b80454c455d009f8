//! Contact geometry for the haptic loop: points of the two surfaces near each other, whose distances it reads
//! again in the bodies' fields at each step, at the body's present pose.

use std::sync::Arc;

use arrayvec::ArrayVec;
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::{BodyState, MAX_UNILATERAL, MotionBound, UnilateralContact};
use palpate_field::{ClosestPoint, FeatureMesh, Leash, Place};

/// Largest number of surface points.
pub(crate) const MAX_POINTS: usize = 512;

/// Largest number of scene objects near the body.
pub(crate) const MAX_OBJECTS: usize = 8;

/// A scene object near the body.
#[derive(Clone, Debug)]
pub(crate) struct NearObject {
    pub surface: Arc<FeatureMesh>,
    /// Pose of its mesh's frame.
    pub pose: Pose,
}

/// A point of one surface that must not pass the other.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GuardedPoint {
    /// Place on its own body's surface.
    pub place: Place,
    /// Part of that surface that it stays in.
    pub leash: Leash,
    /// Face of the other body's surface that is nearest.
    pub face: u32,
    /// Index of the scene object.
    pub object: u8,
    /// Whether it is on the body in the hand, or on the scene object.
    pub is_probe: bool,
    /// Fraction of the way along an edge that it tries next.
    pub stride: f64,
    /// Distance that any point of the body may move before this one has to be measured again, m.
    pub slack: f64,
}

/// What the haptic loop needs to hold the body out of surfaces until the next query.
#[derive(Clone, Debug)]
pub(crate) struct ContactGeometry {
    /// Surface of the body in the hand.
    pub probe: Arc<FeatureMesh>,
    /// Centre of mass of the body in its mesh's frame, m.
    pub center_of_mass: DVec3,
    pub objects: ArrayVec<NearObject, MAX_OBJECTS>,
    pub points: ArrayVec<GuardedPoint, MAX_POINTS>,
    /// Where the points are all that can be touched.
    pub bound: MotionBound,
    /// Coefficient of friction.
    pub friction: f64,
    /// Distance at which surfaces are held apart, m.
    pub margin: f64,
}

/// The contacts of one step.
#[derive(Clone, Debug, Default)]
pub(crate) struct StepContacts {
    pub contacts: ArrayVec<UnilateralContact, MAX_UNILATERAL>,
    /// Their indices among the points.
    pub points: ArrayVec<u16, MAX_UNILATERAL>,
    /// Largest motion of any point of the body in the step, m.
    pub room: f64,
}

/// Largest distance (m) and smallest cosine of the angle between normals of contacts that are one. With less,
/// points that have descended to the same place use up the contacts of a step.
const SAME_PLACE: f64 = 2e-5;
const SAME_NORMAL: f64 = 0.999;

/// Largest number of moves of a point in a step.
const MAX_MOVES: u32 = 3;

/// Smallest fraction of the way along an edge that a point tries. With less, it follows fast motion late.
const MIN_STRIDE: f64 = 1.0 / 64.0;

/// Smallest gain in distance for which a point moves, m.
const MIN_DESCENT: f64 = 1e-8;

impl ContactGeometry {
    /// Finds the contacts at a state of the body that a step may reach: those nearer than `reach` (m). No
    /// point of the body has moved by more than `moved` (m) since the last step. The impulses of that step's
    /// contacts, `before`, are taken over.
    pub fn contacts(
        &mut self,
        state: &BodyState,
        (moved, reach): (f64, f64),
        before: &StepContacts,
        found: &mut StepContacts,
    ) {
        found.contacts.clear();
        found.points.clear();
        found.room = f64::INFINITY;
        let mesh = state.pose * Pose::from_translation(-self.center_of_mass);
        let Self { probe, objects, points, .. } = self;
        for (index, guarded) in points.iter_mut().enumerate() {
            guarded.slack -= moved;
            if guarded.slack > reach {
                found.room = found.room.min(guarded.slack);
                continue;
            }
            let Some(object) = objects.get(usize::from(guarded.object)) else { continue };
            let (own, other) = if guarded.is_probe {
                ((&**probe, &mesh), (&*object.surface, &object.pose))
            } else {
                ((&*object.surface, &object.pose), (&**probe, &mesh))
            };
            let (place, closest) = guarded.measure(own, other);
            let gap = closest.distance - self.margin;
            guarded.slack = gap;
            if gap > reach {
                found.room = found.room.min(gap);
                continue;
            }
            let outward = other.1.transform_vector(closest.normal);
            let (normal, at) = if guarded.is_probe {
                (-outward, place)
            } else {
                (outward, other.1.transform_point(closest.point))
            };
            let contact = UnilateralContact {
                arm: at - state.pose.translation,
                normal,
                gap,
                velocity: DVec3::ZERO,
                friction: self.friction,
                impulse: DVec3::ZERO,
            };
            found.push(contact, index as u16);
        }
        for (contact, point) in found.contacts.iter_mut().zip(&found.points) {
            if let Some(known) = before.points.iter().position(|known| known == point) {
                contact.impulse = before.contacts[known].impulse;
            }
        }
    }
}

impl GuardedPoint {
    /// Moves the point to the place of its surface that is nearest to the other one. Returns its position in
    /// the world, m, and the point of the other surface nearest to it, in that body's frame.
    fn measure(
        &mut self,
        (own, own_pose): (&FeatureMesh, &Pose),
        (other, other_pose): (&FeatureMesh, &Pose),
    ) -> (DVec3, ClosestPoint) {
        let to_other = other_pose.inverse() * *own_pose;
        let to_own = to_other.inverse();
        let mut position = own.position(&self.place);
        let mut closest = other.walk(to_other.transform_point(position), self.face);
        for _ in 0..MAX_MOVES {
            let normal = to_own.transform_vector(closest.normal);
            let Some(place) = own.descend(&self.place, normal, self.stride, &self.leash) else { break };
            let next = own.position(&place);
            let found = other.walk(to_other.transform_point(next), closest.face);
            if found.distance > closest.distance - MIN_DESCENT {
                self.stride = (0.25 * self.stride).max(MIN_STRIDE);
                continue;
            }
            self.stride = (4.0 * self.stride).min(1.0);
            (self.place, position, closest) = (place, next, found);
        }
        self.face = closest.face;
        (own_pose.transform_point(position), closest)
    }
}

impl StepContacts {
    fn push(&mut self, contact: UnilateralContact, point: u16) {
        let same = |known: &&mut UnilateralContact| {
            known.arm.distance_squared(contact.arm) < SAME_PLACE * SAME_PLACE
                && known.normal.dot(contact.normal) > SAME_NORMAL
        };
        if let Some(known) = self.contacts.iter_mut().find(same) {
            known.gap = known.gap.min(contact.gap);
            return;
        }
        if self.contacts.is_full() {
            let furthest = self.contacts.iter().enumerate().max_by(|a, b| a.1.gap.total_cmp(&b.1.gap));
            let Some((furthest, gap)) = furthest.map(|(index, known)| (index, known.gap)) else { return };
            self.room = self.room.min(gap.max(contact.gap));
            if gap <= contact.gap {
                return;
            }
            self.contacts[furthest] = contact;
            self.points[furthest] = point;
            return;
        }
        self.contacts.push(contact);
        self.points.push(point);
    }
}
