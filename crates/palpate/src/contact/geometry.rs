//! Contact geometry for the haptic loop: points of the two surfaces near each other, whose distances it reads
//! again in the bodies' fields at each step, at the body's present pose.

use std::sync::Arc;

use arrayvec::ArrayVec;
use palpate_core::Pose;
use palpate_core::glam::{DVec3, Vec3};
use palpate_dynamics::{BodyState, MAX_UNILATERAL, MotionBound, UnilateralContact};

use crate::scene::field::Field;

/// Largest number of surface points.
pub(crate) const MAX_POINTS: usize = 128;

/// Largest number of scene objects near the body.
pub(crate) const MAX_OBJECTS: usize = 8;

/// A scene object near the body.
#[derive(Clone, Debug)]
pub(crate) struct NearObject {
    pub field: Arc<Field>,
    /// Pose of its mesh's frame.
    pub pose: Pose,
}

/// A point of one surface that must not pass the other.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GuardedPoint {
    /// Position in the mesh's frame of its own body, m.
    pub point: Vec3,
    /// Index of the scene object.
    pub object: u8,
    /// Whether it is on the body in the hand, or on the scene object.
    pub is_probe: bool,
}

/// What the haptic loop needs to hold the body out of surfaces until the next query.
#[derive(Clone, Debug)]
pub(crate) struct ContactGeometry {
    /// The field of the body in the hand.
    pub probe: Arc<Field>,
    /// Centre of mass of the body in its mesh's frame, m.
    pub center_of_mass: DVec3,
    pub objects: ArrayVec<NearObject, MAX_OBJECTS>,
    pub points: ArrayVec<GuardedPoint, MAX_POINTS>,
    /// Where the points are all that can be touched.
    pub bound: MotionBound,
    /// Coefficient of friction.
    pub friction: f64,
    /// Distance at which surfaces count as touching, m.
    pub margin: f64,
}

/// The contacts of one step.
#[derive(Clone, Debug, Default)]
pub(crate) struct StepContacts {
    pub contacts: ArrayVec<UnilateralContact, MAX_UNILATERAL>,
    /// Their indices among the points.
    pub points: ArrayVec<u8, MAX_UNILATERAL>,
    /// Largest motion of any point of the body in the step, m.
    pub room: f64,
    /// Smallest distance found, m.
    pub least: f64,
}

impl ContactGeometry {
    /// Finds the contacts at a state of the body that a step may reach, of at most `reach` (m). `before` are
    /// those of the last step, whose impulses are taken over.
    pub fn contacts(&self, state: &BodyState, reach: f64, before: &StepContacts, found: &mut StepContacts) {
        found.contacts.clear();
        found.points.clear();
        found.room = f64::INFINITY;
        found.least = f64::INFINITY;
        let mesh = state.pose * Pose::from_translation(-self.center_of_mass);
        let mut first = 0;
        for (index, object) in self.objects.iter().enumerate() {
            for is_probe in [true, false] {
                let run = self.points[first..]
                    .iter()
                    .take_while(|point| usize::from(point.object) == index && point.is_probe == is_probe)
                    .count();
                let (own, other, field) = if is_probe {
                    (&mesh, &object.pose, &object.field)
                } else {
                    (&object.pose, &mesh, &self.probe)
                };
                let to_other = other.inverse() * *own;
                for (four, points) in self.points[first..first + run].chunks(4).enumerate() {
                    let at = std::array::from_fn(|lane| {
                        to_other.transform_point(points[lane.min(points.len() - 1)].point.as_dvec3())
                    });
                    let read = field.body().distances(at);
                    for (lane, point) in points.iter().enumerate() {
                        let (distance, gradient) = read[lane];
                        let gap = distance - self.margin;
                        found.least = found.least.min(distance);
                        let outward = other.transform_vector(gradient.normalize_or(DVec3::Z));
                        let normal = if is_probe { -outward } else { outward };
                        let mut place = own.transform_point(point.point.as_dvec3());
                        if !is_probe {
                            place -= normal * distance;
                        }
                        let contact = UnilateralContact {
                            arm: place - state.pose.translation,
                            normal,
                            gap,
                            velocity: DVec3::ZERO,
                            friction: self.friction,
                            impulse: DVec3::ZERO,
                        };
                        found.push(contact, (first + 4 * four + lane) as u8, reach);
                    }
                }
                first += run;
            }
        }
        for (contact, point) in found.contacts.iter_mut().zip(&found.points) {
            if let Some(known) = before.points.iter().position(|known| known == point) {
                contact.impulse = before.contacts[known].impulse;
            }
        }
    }
}

impl StepContacts {
    fn push(&mut self, contact: UnilateralContact, point: u8, reach: f64) {
        if contact.gap > reach {
            self.room = self.room.min(contact.gap);
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
