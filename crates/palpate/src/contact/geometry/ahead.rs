//! Contacts held against where a step leads.
//!
//! A contact bounds a step by a plane: that through the nearest points at its start. Where the surfaces are
//! still apart, the plane says too much and too little. Beyond the end of a face it holds a body that would
//! pass, as at the next tile of a floor (a ghost collision); around an edge it lets one in that comes towards
//! another face. So the step is taken again: without those contacts at a distance that have pushed, of which
//! come back whose surfaces it does not pass clear of each other, and with contacts for what overlaps at its
//! end, with the gaps that are now along the normals there.

use arrayvec::ArrayVec;
use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};
use palpate_dynamics::{MAX_UNILATERAL, MotionBound, UnilateralContact};

use super::{ContactGeometry, Frames, NearObject, StepContacts};
use crate::contact::guarded_point::{GuardedPoint, Measured};

/// Number of times that a step is taken at most: without contacts at a distance, with some of them, with all.
const MAX_TAKEN: u32 = 8;

/// Gap from which a contact is one at a distance, in margins between surfaces. With more, bodies that pass
/// edges that closely are held; with less, steps that end at a surface are taken more often.
const APART: f64 = 0.1;

/// Motion in a step from which its end is looked at, in margins between surfaces. With more, bodies go further
/// into edges that they pass; with less, slow steps take longer.
const MIN_AHEAD: f64 = 8.0;

/// Share of the margin up to which surfaces are clear of each other. With more, contacts that yield a little
/// are not; with less, bodies sink into edges that they pass.
const CLEAR: f64 = 0.8;

/// Shares of a step from one pose to the next at which surfaces are to be clear. With more at most, a body may
/// pass a thin part; with more at least, contacts have the normals of surfaces that are further apart.
const LONGEST: f64 = 0.25;
const SHORTEST: f64 = LONGEST / 64.0;

/// Number of poses at most. With fewer, bodies are held that come near a surface without meeting it; with
/// more, steps may take longer.
const MAX_MEASURED: u32 = 32;

/// Number of times that a point is measured on until it has no further to go. With fewer, points that move fast
/// over a surface are not where it is nearest.
const MAX_SETTLING: u32 = 8;

/// Share of a step within which contacts are met at once. With less, steps are taken more often; with more,
/// bodies meet what others keep them from.
const AT_ONCE: f64 = 0.1;

/// Distance up to which surfaces meet, in margins. With more, they have normals of places that come no nearer.
const MET: f64 = 4.0;

/// Cosine of the angle from which the normal at a step's end is another one.
const AHEAD_NORMAL: f64 = 0.98;

/// A step of the body that was taken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Taken {
    /// Poses of the body's centre of mass before and after it.
    pub poses: [Pose; 2],
    /// Time of the step, s.
    pub dt: f64,
}

impl Taken {
    /// Pose of the body after a share of the step.
    fn at(&self, share: f64) -> Pose {
        let [from, to] = &self.poses;
        let turn = DQuat::from_scaled_axis(from.rotation_vector_to(to) * share);
        Pose {
            translation: from.translation.lerp(to.translation, share),
            rotation: (turn * from.rotation).normalize(),
        }
    }
}

impl ContactGeometry {
    /// Holds contacts against where a step with them has led. Returns whether they have changed, so that the
    /// step is to be taken again from where it started.
    pub fn revise(&self, step: &Taken, found: &mut StepContacts) -> bool {
        found.taken += 1;
        if found.taken >= MAX_TAKEN {
            return false;
        }
        if found.taken == 1 && found.set_aside(APART * self.margin) {
            return true;
        }
        let [from, to] = step.poses;
        let moved = MotionBound { from, radius: self.bound.radius, ..MotionBound::NONE }.displacement(&to);
        if self.take_back(step, moved, found) {
            return true;
        }
        moved > MIN_AHEAD * self.margin && self.add_ahead(step, moved, found)
    }

    /// Takes contacts back whose surfaces are not clear of each other in a step in which no point of the body
    /// moves by more than `moved` (m). Returns whether there is any.
    fn take_back(&self, step: &Taken, moved: f64, found: &mut StepContacts) -> bool {
        let StepContacts { aside, contacts, taken, .. } = found;
        let [from, to] = &step.poses;
        let (shift, turn) = (to.translation - from.translation, from.rotation_vector_to(to));
        let met = |contact: &UnilateralContact| {
            // What the step stays on this side of is not met.
            let by = shift + turn.cross(contact.arm) - contact.velocity * step.dt;
            let is_near = contact.normal.dot(by) > contact.gap;
            is_near.then(|| self.met(contact, step, moved)).flatten()
        };
        // Contacts that are held then may lead to others: all of them in the end.
        if *taken + 1 >= MAX_TAKEN {
            let any = aside.iter().any(|contact| met(contact).is_some());
            if any {
                // There is room, as they were among them.
                contacts.extend(aside.drain(..));
            }
            return any;
        }
        // What is met first may keep the body from what it meets then.
        let mut all = ArrayVec::<(usize, UnilateralContact, f64), MAX_UNILATERAL>::new();
        for (index, contact) in aside.iter().enumerate() {
            if let Some((back, share)) = met(contact)
                && all.try_push((index, back, share)).is_err()
            {
                break;
            }
        }
        let first = all.iter().fold(1.0, |first: f64, (.., share)| first.min(*share));
        for (index, back, share) in all.iter().rev() {
            if *share <= first + AT_ONCE {
                aside.swap_remove(*index);
                contacts.push(*back);
            }
        }
        !all.is_empty()
    }

    /// What a point meets in a step that passes its contact's plane: the contact where the surfaces are last
    /// clear of each other, with the share of the step up to there, or `None` if they always are. Where the direction between them turns round while
    /// they come that near, one may have passed the other.
    fn met(&self, contact: &UnilateralContact, step: &Taken, moved: f64) -> Option<(UnilateralContact, f64)> {
        let (mut point, object) = self.point(contact.key)?;
        let all = moved + object.speed * step.dt;
        let (mut share, mut next) = (0.0, LONGEST);
        let (mut normal, mut distance, mut last) = (contact.normal, contact.gap + self.margin, None);
        let mut first = None;
        let mut left = MAX_MEASURED;
        while share < 1.0 && next >= SHORTEST && left > 0 {
            left -= 1;
            let at = (share + next).min(1.0);
            let (mut there, motion) = (point, (at - share) * all);
            let least = f64::from(point.slack) - motion;
            let frames = self.frames_at(object, step, at);
            let measured = settled(&mut there, &frames, least, MET * self.margin);
            there.slack = measured.distance.max(least) as f32;
            let may_have_passed =
                measured.normal.dot(normal) <= 0.0 && distance + measured.distance <= motion;
            if may_have_passed || measured.distance < CLEAR * measured.held * self.margin {
                (next, first) = (0.5 * next, Some((measured, at)));
                continue;
            }
            (point, share, next) = (there, at, (2.0 * next).min(LONGEST));
            // At an infinite distance it is another point that is nearer.
            if measured.distance.is_finite() {
                (normal, distance, last) = (measured.normal, measured.distance, Some((measured, at)));
            }
        }
        if share >= 1.0 {
            return None;
        }
        let is_near = |(measured, _): &(Measured, f64)| measured.distance.abs() <= MET * self.margin;
        let near = last
            .filter(is_near)
            .or(first.filter(|(measured, _)| measured.distance.abs() <= 4.0 * MET * self.margin));
        let met = near.map(|(measured, at)| self.contact_at(contact.key, object, step, at, &measured));
        // From beyond a plane the body has come around an edge.
        Some((met.filter(|met| met.gap >= -self.margin).unwrap_or(*contact), share))
    }

    /// The contact that a measurement after a share of a step gives at its start: the gap is that along the
    /// normal there.
    fn contact_at(
        &self,
        key: u16,
        object: &NearObject,
        step: &Taken,
        share: f64,
        measured: &Measured,
    ) -> UnilateralContact {
        let Measured { point, normal, distance, held, .. } = *measured;
        let from = &step.poses[0];
        let back = *from * step.at(share).inverse();
        let object_back = object.pose * object.moved_on(step.dt * share).inverse();
        let [here, surface] = [back, object_back].map(|back| back.transform_point(point));
        UnilateralContact {
            arm: here - from.translation,
            normal,
            gap: distance - held * self.margin + normal.dot(surface - here),
            velocity: object.motion.twist.velocity_at(here),
            friction: self.friction.static_coefficient,
            impulse: DVec3::ZERO,
            pushed: object.pushed,
            key,
        }
    }

    /// Adds contacts for what overlaps at the end of a step in which no point of the body moves by more than
    /// `moved` (m). Returns whether there is any.
    fn add_ahead(&self, step: &Taken, moved: f64, found: &mut StepContacts) -> bool {
        let margin = self.margin;
        let known = found.contacts.len();
        let mut last: Option<(u8, Frames<'_>)> = None;
        for index in 0..found.near.len() {
            let key = found.near[index];
            let Some((mut point, object)) = self.point(key) else { continue };
            let least = f64::from(point.slack) - moved - object.speed * step.dt;
            if least > CLEAR * margin {
                continue;
            }
            let frames = match last {
                Some((of, frames)) if of == point.object => frames,
                _ => self.frames_at(object, step, 1.0),
            };
            last = Some((point.object, frames));
            let later = settled(&mut point, &frames, least, 0.0);
            // A step brings nothing nearer by more than the motion in it.
            if !(least..CLEAR * later.held * margin).contains(&later.distance) {
                continue;
            }
            // Where it was already in contact, it has gone on from there.
            let end = self.contact_at(key, object, step, 1.0, &later);
            let start = UnilateralContact { gap: f64::from(point.slack), ..end };
            let met = self.met(&start, step, moved).map(|(met, _)| met);
            let contact = met.filter(|met| met.gap != start.gap).unwrap_or(end);
            let is_same = |known: &UnilateralContact| {
                known.key == key && known.normal.dot(contact.normal) > AHEAD_NORMAL
            };
            // What overlaps though the step leads away from it has come in from elsewhere.
            let was_there = contact.gap < f64::from(point.slack).min(0.0) - margin;
            if !was_there && !found.contacts.iter().any(is_same) {
                // What there is no room for is met in the next step.
                let _ = found.contacts.try_push(contact);
            }
        }
        found.contacts.len() > known
    }

    /// A point with its object.
    fn point(&self, key: u16) -> Option<(GuardedPoint, &NearObject)> {
        let point = *self.points.get(usize::from(key))?;
        Some((point, self.objects.get(usize::from(point.object))?))
    }

    /// The surfaces of the body and of an object after a share of a step.
    fn frames_at<'a>(&'a self, object: &'a NearObject, step: &Taken, share: f64) -> Frames<'a> {
        let mesh = step.at(share) * Pose::from_translation(-self.center_of_mass);
        let pose = object.moved_on(step.dt * share);
        Frames::new((&self.probe, &mesh), (&object.surface, &pose))
    }
}

/// The measurement of a point that has moved to where its surface is nearest to the other one.
fn settled(point: &mut GuardedPoint, frames: &Frames<'_>, least: f64, reach: f64) -> Measured {
    let mut measured = point.measure(frames, least as f32, reach);
    for _ in 0..MAX_SETTLING {
        if measured.is_settled {
            break;
        }
        measured = point.measure(frames, least as f32, reach);
    }
    measured
}

impl NearObject {
    /// Pose of its mesh's frame after a time (s).
    fn moved_on(&self, dt: f64) -> Pose {
        let twist = self.motion.twist;
        self.pose.moved(&Twist { linear: twist.velocity_at(self.pose.translation), ..twist }, dt)
    }
}

impl StepContacts {
    /// Sets contacts beyond a gap (m) aside if one of them has pushed. Returns whether there is any.
    fn set_aside(&mut self, gap: f64) -> bool {
        let Self { contacts, aside, .. } = self;
        let is_apart = |contact: &UnilateralContact| contact.gap > gap;
        if !contacts.iter().any(|it| is_apart(it) && it.impulse.dot(it.normal) > 0.0) {
            return false;
        }
        aside.extend(contacts.iter().filter(|it| is_apart(it)).copied());
        contacts.retain(|contact| !is_apart(contact));
        true
    }
}
