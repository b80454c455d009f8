//! Contacts held against where a step leads.
//!
//! A contact bounds a step by a plane: that through the nearest points at its start. Where the surfaces are
//! still apart, the plane says too much and too little. Beyond the end of a face it holds a body that would
//! pass, as at the next tile of a floor (a ghost collision); around an edge it lets one in that comes towards
//! another face. Where such a contact has pushed, the step is taken again without those at a distance. What
//! it meets then, first of all, gets a contact where it is met, with the gap that is now along the normal
//! there, and so does what overlaps at its end. A blow turns bodies in a single step, and with them normals:
//! where surfaces come to touch, the normal is that at the step's end.

use std::cmp::Reverse;

use arrayvec::ArrayVec;
use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist};
use palpate_dynamics::{Constraint, MAX_CONSTRAINTS, MotionBound};
use palpate_field::ClosestPoint;

use super::stepping::Points;
use super::{
    APART, CLEAR, ContactGeometry, Frames, MAX_REACHED, NEAR_PLACE, NearObject, SAME_PLACE, StepContacts,
    is_level,
};
use crate::constraints::guarded_point::{GuardedPoint, Measured};

/// Number of times that a step is taken at most, but for normals that turn: the last time, with all contacts
/// at a distance if it met one of them. With fewer, bodies that meet many surfaces at once are held at edges;
/// with more, steps may take longer.
const MAX_TAKEN: u32 = 8;

/// Distance in margins up to which planes of faces are one. With more, contacts with other faces are taken
/// for those with one; with less, more of them are followed along a step.
const LEVEL: f64 = 0.5;

/// Motion in a step from which its end is looked at, in margins between surfaces. With more, bodies go
/// further into edges that they pass; with less, slow steps take longer.
const MIN_AHEAD: f64 = 8.0;

/// Shares of a step from one pose to the next at which surfaces are to be clear. With more at most, a body
/// may pass a thin part; with more at least, contacts have the normals of surfaces that are further apart.
const LONGEST: f64 = 0.25;
const SHORTEST: f64 = LONGEST / 64.0;

/// Part at least of the way between a pose at which surfaces are clear and one at which they are not that
/// the next pose is away from both. With less, it takes more poses where distances bend.
const LEAST_PART: f64 = 0.1;

/// Number of poses at most. With fewer, bodies are held that come near a surface without meeting it; with
/// more, steps may take longer.
const MAX_POSES: u32 = 32;

/// Share of a step within which contacts are met at once. With less, steps are taken more often; with more,
/// bodies meet what others keep them from.
const AT_ONCE: f64 = 0.1;

/// Distance, in bounding radii of the body, within which what is met first keeps the body from what is met
/// later than it by the shortest share. With more, steps are taken more often; with less, surfaces are pushed
/// sideways beside where they meet.
const BESIDE: f64 = 0.05;

/// Distance up to which surfaces meet, in margins, and depth up to which they do where nothing nearer than
/// that is clear. With more, contacts have normals of places that come no nearer.
const MET: f64 = 4.0;
const MET_DEPTH: f64 = 16.0;

/// Distance in margins of a reserve up to which it is looked at whether surfaces overlap where a point
/// descends from there. With less, edges that cross beside it are held late; with more, steps take longer.
const BEFORE: f64 = 64.0;

/// Depth in margins up to which an overlap is held against a step's end, too. With more, steps take longer
/// where bodies overlap deeply; with less, those that turn sink further in.
const HELD_DEPTH: f64 = 128.0;

/// Cosine of the angle from which the normal at a step's end is another one.
const AHEAD_NORMAL: f64 = 0.98;

/// Distance of unit normals from which one has turned in a step. With less, steps are taken more often; with
/// more, blows that turn a body push it sideways by this share of them.
const TURNED: f64 = 5e-4;

/// Number of times that a step is taken again at most since normals have turned. With fewer, they may not
/// have come to rest; with more, steps may take longer.
const MAX_TURNED: u32 = 3;

/// What a point meets in a step.
#[derive(Clone, Copy, Debug)]
struct Met {
    /// Share of the step up to there.
    share: f64,
    /// The contact where it is met, if it can be told.
    contact: Option<Constraint>,
}

/// What overlaps at the end of a step.
#[derive(Clone, Copy, Debug)]
struct Ahead {
    /// The contact that holds it.
    contact: Constraint,
    /// What takes the place of that contact if it is known and does not hold enough.
    closer: Option<Constraint>,
}

/// A step of the body that was taken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Taken {
    /// Poses of the body's centre of mass before and after it.
    pub poses: [Pose; 2],
    /// Time of the step, s.
    pub dt: f64,
}

impl Taken {
    /// Displacement of the centre of mass, m, and the rotation vector about it, rad.
    fn motion(&self) -> Twist {
        let [from, to] = &self.poses;
        Twist::new(to.translation - from.translation, from.rotation_vector_to(to))
    }

    /// Pose of the body after a share of the step.
    fn at(&self, share: f64) -> Pose {
        self.poses[0].moved(&self.motion(), share)
    }
}

impl ContactGeometry {
    /// Holds contacts against where a step with them has led. Returns whether they have changed, so that the
    /// step is to be taken again from where it started.
    pub fn revise(&self, points: &mut Points, step: &Taken, found: &mut StepContacts) -> bool {
        found.taken += 1;
        if found.taken >= MAX_TAKEN {
            return false;
        }
        if found.taken == 1 && found.set_aside(APART * self.margin) {
            return true;
        }
        let [from, to] = step.poses;
        let moved = MotionBound { from, radius: self.bound.radius, ..MotionBound::NONE }.displacement(&to);
        if self.take_back(points, step, moved, found) {
            return true;
        }
        let is_fast = moved > MIN_AHEAD * self.margin;
        if is_fast && self.turn(points, step, moved, found) {
            // Times for this are counted by themselves, so that what overlaps at the end has its own.
            found.taken -= 1;
            return true;
        }
        let known = found.near.len();
        self.wake_ahead(points, step, moved, found);
        // A slow step meets nothing new at the points that are known.
        self.add_ahead(points, step, moved, if is_fast { 0 } else { known }, found)
    }

    /// Takes contacts back whose surfaces are not clear of each other in a step in which no point of the body
    /// moves by more than `moved` (m). Returns whether there is any.
    fn take_back(&self, points: &Points, step: &Taken, moved: f64, found: &mut StepContacts) -> bool {
        let StepContacts { aside, contacts, taken, left, .. } = found;
        let motion = step.motion();
        let is_last = *taken + 1 >= MAX_TAKEN;
        // Share of the step after which a contact's plane is passed. What the step stays on this side of is
        // not met.
        let passed_at = |contact: &Constraint| {
            let by = contact.normal.dot(motion.velocity_at(contact.arm) - contact.velocity * step.dt);
            (by > contact.gap).then(|| contact.gap / by)
        };
        // There is room for those that come back, as they were among the others, unless ends have taken it.
        let are_level = self.take_level(points, |contact| passed_at(contact).is_some(), aside, contacts);
        let mut met = |contact: &Constraint| self.met(contact, points, (step, moved), left);
        // In the order in which planes are passed, up to those too late for what is met by then.
        let mut order = ArrayVec::<(f64, usize), MAX_REACHED>::new();
        order.extend(
            aside.iter().enumerate().filter_map(|(index, contact)| Some((passed_at(contact)?, index))),
        );
        order.sort_unstable_by(|(a, _), (b, _)| a.total_cmp(b));
        if is_last && order.iter().any(|(_, index)| met(&aside[*index]).is_some()) {
            while let Some(contact) = aside.pop() {
                let _ = contacts.try_push(contact);
            }
            return true;
        }
        let mut all = ArrayVec::<(usize, DVec3, Met), MAX_CONSTRAINTS>::new();
        let mut first: f64 = 1.0;
        for (share, index) in order {
            if all.is_full() || share > first + AT_ONCE {
                break;
            }
            if let Some(met) = met(&aside[index]) {
                first = first.min(met.share);
                all.push((index, aside[index].arm, met));
            }
        }
        // What is met first may keep the body from the others, and does from those beside it.
        let within = BESIDE * self.bound.radius;
        let is_next = |(_, arm, met): &&(usize, DVec3, Met)| {
            let is_before = |(_, at, other): &(usize, DVec3, Met)| {
                other.share < met.share - SHORTEST && at.distance_squared(*arm) < within * within
            };
            met.share <= first + AT_ONCE && !all.iter().any(is_before)
        };
        let mut back: ArrayVec<_, MAX_CONSTRAINTS> = all.iter().filter(is_next).copied().collect();
        // From the last, so that the others stay where they are.
        back.sort_unstable_by_key(|(index, ..)| Reverse(*index));
        for (index, _, met) in back {
            let contact = aside.swap_remove(index);
            let _ = contacts.try_push(met.contact.unwrap_or(contact));
        }
        are_level || !all.is_empty()
    }

    /// Takes contacts back that are with the planes of faces which hold the body, if any of them is passed:
    /// where it lies on a face, step after step would turn it on to the next of them. Returns whether there
    /// is any.
    fn take_level(
        &self,
        points: &Points,
        is_passed: impl Fn(&Constraint) -> bool,
        aside: &mut ArrayVec<Constraint, MAX_REACHED>,
        contacts: &mut ArrayVec<Constraint, MAX_REACHED>,
    ) -> bool {
        let is_level = |contact: &Constraint, held: &[Constraint]| {
            let is_own = |held: &Constraint| points.object_of(held.key) == points.object_of(contact.key);
            held.iter().any(|held| is_level(held, contact, LEVEL * self.margin) && is_own(held))
        };
        if !aside.iter().any(|contact| is_passed(contact) && is_level(contact, contacts)) {
            return false;
        }
        for index in (0..aside.len()).rev() {
            if is_level(&aside[index], contacts) {
                let _ = contacts.try_push(aside.swap_remove(index));
            }
        }
        true
    }

    /// What a point meets in a step that passes its contact's plane; `None` if the surfaces always are clear
    /// of each other. Where the direction between them turns round while they are near, one may have passed
    /// the other. Without measurements `left`, what is not known to be clear may be met.
    fn met(
        &self,
        contact: &Constraint,
        points: &Points,
        (step, moved): (&Taken, f64),
        left: &mut u32,
    ) -> Option<Met> {
        let (mut point, object) = self.point(points, contact.key)?;
        let all = moved + object.speed * step.dt;
        let (mut normal, mut distance) = (contact.normal, contact.gap + self.margin);
        // The last pose at which they are clear, and the first at which they are not. Between these the
        // distance is about linear.
        let (mut clear, mut blocked) = (None, None::<(Measured, f64)>);
        let (mut share, mut stride, mut poses) = (0.0, LONGEST, MAX_POSES);
        while share < 1.0 && poses > 0 && *left > 0 {
            let next = match &blocked {
                None => stride,
                Some((Measured { distance: there, .. }, at)) => {
                    // To half of the distance at which they are clear.
                    let way = (distance - 0.5 * CLEAR * self.margin).max(0.0);
                    let part = if *there < distance { way / (distance - there) } else { 0.0 };
                    (at - share) * part.clamp(LEAST_PART, 1.0 - LEAST_PART)
                }
            };
            if next < SHORTEST {
                break;
            }
            poses -= 1;
            let at = (share + next).min(1.0);
            let (mut there, motion) = (point, (at - share) * all);
            let least = f64::from(point.slack) - motion;
            let frames = self.frames_at(object, step, at);
            // Where the point has come to as it is, and from there to where its surface is nearest. Beyond a
            // thin part, the other side of that is nearest.
            let is_beyond = |measured: &Measured| {
                measured.normal.dot(normal) <= 0.0 && distance + measured.distance <= motion
            };
            let still = point.still(&frames);
            let measured = settled(&mut there, &frames, least, MET * self.margin, left);
            let is_turned = is_beyond(&still) || is_beyond(&measured);
            let overlaps = self.overlap(object, &measured);
            if is_turned || overlaps || still.distance < 0.0 && !object.is_left_at(&measured) {
                // Whether it has turned depends on the pose that it is seen from.
                stride = 0.5 * next;
                blocked = (overlaps && !is_turned).then_some((measured, at));
                if blocked.is_some() && measured.distance >= 0.0 && measured.nearest >= 0.0 {
                    break;
                }
                continue;
            }
            let is_finite = measured.distance.is_finite();
            there.slack = measured.distance.min(measured.nearest).max(least) as f32;
            (point, share, stride) = (there, at, (2.0 * stride).min(LONGEST));
            // At an infinite distance it is another point that is nearer.
            if is_finite {
                (normal, distance, clear) = (measured.normal, measured.distance, Some((measured, at)));
            }
        }
        if share >= 1.0 {
            return None;
        }
        let within =
            |most: f64| move |(measured, _): &(Measured, f64)| measured.distance.abs() <= most * self.margin;
        // A point that stays at one surface meets another one first where it overlaps with that. Inside, the
        // nearest way out may be through another face than that through which it came.
        let is_outside = |(measured, _): &(Measured, f64)| measured.nearest >= 0.0;
        let near = blocked
            .filter(within(MET))
            .filter(is_outside)
            .or(clear.filter(within(MET)))
            .or(blocked.filter(within(MET_DEPTH)));
        let contact = near.map(|(measured, at)| self.contact_at(contact.key, object, step, at, &measured));
        if let Some((Measured { distance: there, .. }, at)) = &blocked {
            share += (at - share) * ((distance - CLEAR * self.margin) / (distance - there)).clamp(0.0, 1.0);
        }
        // From beyond a plane the body has come around an edge.
        Some(Met { share, contact: contact.filter(|contact| contact.gap >= -MET * self.margin) })
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
    ) -> Constraint {
        let Measured { point, normal, distance, held, .. } = *measured;
        let from = &step.poses[0];
        let back = *from * step.at(share).inverse();
        let object_back = object.before * object.moved_on(step.dt * share).inverse();
        let [here, surface] = [back, object_back].map(|back| back.transform_point(point));
        let arm = here - from.translation;
        let velocity = object.motion.twist.velocity_at(here);
        // In the equations of a step, points go along their tangents, v + ω × r. By how much nearer that
        // brings them than their ways do, the surface recedes, so that the same step ends where it did.
        let tangents = step.motion().velocity_at(arm) - velocity * step.dt;
        let body_ahead = step.poses[1] * from.inverse();
        let object_ahead = object.moved_on(step.dt) * object.before.inverse();
        let ways =
            (body_ahead.transform_point(here) - here) - (object_ahead.transform_point(surface) - surface);
        let bent = normal.dot(tangents - ways);
        Constraint {
            arm,
            normal,
            gap: distance - held * self.margin + normal.dot(surface - here),
            velocity: velocity + normal * (bent / step.dt),
            friction: self.friction.static_coefficient,
            impulse: DVec3::ZERO,
            pushed: object.pushed,
            key,
        }
    }

    /// Has contacts that push hold along the normals at the end of a step in which no point of the body moves
    /// by more than `moved` (m), where surfaces have come to touch. Returns whether any has turned.
    fn turn(&self, points: &Points, step: &Taken, moved: f64, found: &mut StepContacts) -> bool {
        let StepContacts { contacts, left, turned, .. } = found;
        if *turned >= MAX_TURNED {
            return false;
        }
        let mut has_turned = false;
        let come = |it: &&mut Constraint| it.gap > APART * self.margin && it.impulse.dot(it.normal) > 0.0;
        for known in contacts.iter_mut().filter(come) {
            if *left == 0 {
                break;
            }
            let Some((mut point, object)) = self.point(points, known.key) else { continue };
            let least = f64::from(point.slack) - moved - object.speed * step.dt;
            let frames = self.frames_at(object, step, 1.0);
            let later = settled(&mut point, &frames, least, MET * self.margin, left);
            if let Some(turned) = self.turned(known, object, step, &later) {
                (*known, has_turned) = (turned, true);
            }
        }
        *turned += u32::from(has_turned);
        has_turned
    }

    /// A contact with the normal at a step's end, as measured `later`, if surfaces touch there, and do not
    /// overlap, along one that has turned.
    fn turned(
        &self,
        known: &Constraint,
        object: &NearObject,
        step: &Taken,
        later: &Measured,
    ) -> Option<Constraint> {
        let by = later.normal.distance_squared(known.normal);
        let end = self.contact_at(known.key, object, step, 1.0, later);
        let is_turned = later.is_settled
            && later.distance.abs() < MET * self.margin
            && !self.overlap(object, later)
            && end.gap >= -MET * self.margin
            && (TURNED * TURNED..2.0 - 2.0 * AHEAD_NORMAL).contains(&by);
        is_turned.then_some(Constraint { impulse: known.impulse, friction: known.friction, ..end })
    }

    /// Starts points from reserves where surfaces are not clear of each other at the end of a step in which
    /// no point of the body moves by more than `moved` (m).
    fn wake_ahead(&self, points: &mut Points, step: &Taken, moved: f64, found: &mut StepContacts) {
        let StepContacts { coming, near, left, .. } = found;
        coming.retain(|place| {
            let Some(reserve) = self.reserves.get(usize::from(*place)) else { return false };
            let Some(object) = self.objects.get(usize::from(reserve.object)) else { return false };
            let within = BEFORE * self.margin;
            let slack = points.reserve_slack(*place);
            let least = reserve.distance(slack) - moved - object.speed * step.dt;
            if least >= within || *left == 0 {
                return true;
            }
            *left -= 1;
            let frames = self.frames_at(object, step, 1.0);
            let ClosestPoint { distance, face, .. } = reserve.closest(&frames);
            if distance >= within || *left == 0 {
                return true;
            }
            let later = settled(&mut reserve.wake(face, slack), &frames, least, MET * self.margin, left);
            let is_woken = later.is_settled
                && self.overlap(object, &later)
                && points.wake(*place, reserve, face).is_some_and(|key| near.try_push(key).is_ok());
            !is_woken
        });
    }

    /// Adds contacts for what overlaps at the end of a step in which no point of the body moves by more than
    /// `moved` (m), of the points near from the index `first` on. Returns whether there is any.
    fn add_ahead(
        &self,
        points: &Points,
        step: &Taken,
        moved: f64,
        first: usize,
        found: &mut StepContacts,
    ) -> bool {
        let StepContacts { contacts, near, left, .. } = found;
        let mut is_changed = false;
        let mut last: Option<(u8, Frames<'_>)> = None;
        for &key in &near[first..] {
            if *left == 0 {
                break;
            }
            let Some((mut point, object)) = self.point(points, key) else { continue };
            let gap = f64::from(point.slack);
            let least = gap - moved - object.speed * step.dt;
            if least > CLEAR * self.margin || gap < -HELD_DEPTH * self.margin {
                continue;
            }
            let frames = match last {
                Some((of, frames)) if of == point.object => frames,
                _ => self.frames_at(object, step, 1.0),
            };
            last = Some((point.object, frames));
            let mut later = settled(&mut point, &frames, least, gap - least, left);
            // Where it has come to, another part of the surface may be nearer than that which it was near.
            let since = points.since(usize::from(point.object)) + gap - least;
            let within = (self.margin, self.margin);
            if *left > 0 && point.look_around(&frames, later.distance, within, since).1 {
                later = settled(&mut point, &frames, least, gap - least, left);
            }
            if let Some(ahead) = self.overlap_ahead(points, (step, moved), (key, gap, &later), left) {
                is_changed |= self.hold(points, contacts, &ahead);
            }
        }
        is_changed
    }

    /// What overlaps at the end of a step at the point of a key, at a `gap` (m) at the start and as measured
    /// `later`; `None` if nothing does that the step has brought there.
    fn overlap_ahead(
        &self,
        points: &Points,
        (step, moved): (&Taken, f64),
        (key, gap, later): (u16, f64, &Measured),
        left: &mut u32,
    ) -> Option<Ahead> {
        // Edges may cross deep in an overlap though the points on them are outside. Those of points that are
        // far outside pass beside each other where they hardly overlap.
        let is_beside = later.nearest > HELD_DEPTH * self.margin && later.distance > -MET_DEPTH * self.margin;
        let (point, object) = self.point(points, key)?;
        let motion = moved + object.speed * step.dt;
        // A step brings nothing nearer by more than the motion in it; what is met may be another wall than
        // that at the gap.
        if is_beside || !self.overlap(object, later) || later.distance < gap.min(0.0) - motion {
            return None;
        }
        let end = self.contact_at(key, object, step, 1.0, later);
        // What overlaps deeply at the start is met there.
        let met = if gap < -MET_DEPTH * self.margin {
            None
        } else {
            // At an edge the end is nearest to another face than that which is met.
            let start = point.still(&self.frames_at(object, step, 0.0));
            let normal = if start.nearest > 0.0 { start.normal } else { end.normal };
            self.met(&Constraint { gap, normal, ..end }, points, (step, moved), left)
        };
        let contact =
            met.and_then(|met| met.contact).or_else(|| later.distance.is_finite().then_some(end))?;
        // What overlaps though the step leads away from it has come in from elsewhere.
        let leads_out = end.gap < later.distance;
        if leads_out && contact.gap < gap.min(0.0) - self.margin {
            return None;
        }
        let sinks_in = later.distance.is_finite() && later.distance < gap.min(0.0) - self.margin;
        // Where it sinks in beyond a bent surface's plane at the start, that at the end holds it, unless the
        // step leads out through that.
        let closer = sinks_in.then_some(if leads_out { contact } else { end });
        Some(Ahead { contact, closer })
    }

    /// Adds a contact, or has it hold closer if it is known. Returns whether that has changed anything.
    fn hold(
        &self,
        points: &Points,
        contacts: &mut ArrayVec<Constraint, MAX_REACHED>,
        &Ahead { contact, closer }: &Ahead,
    ) -> bool {
        let is_same = |known: &Constraint| {
            // A point may have gone from one end of its edge to the other.
            let share = if known.key == contact.key { NEAR_PLACE } else { SAME_PLACE };
            let within = share * self.bound.radius;
            points.object_of(known.key) == points.object_of(contact.key)
                && known.normal.dot(contact.normal) > AHEAD_NORMAL
                && known.arm.distance_squared(contact.arm) < within * within
        };
        let Some(known) = contacts.iter_mut().find(|known| is_same(known)) else {
            // What there is no room for is met in the next step.
            return contacts.try_push(contact).is_ok();
        };
        if let Some(held) = closer {
            *known = Constraint { impulse: known.impulse, friction: known.friction, ..held };
        }
        closer.is_some()
    }

    /// Whether the surface of an object is not clear of the body's at a point: where it is or at features
    /// that touch.
    fn overlap(&self, object: &NearObject, measured: &Measured) -> bool {
        let is_held = measured.distance < CLEAR * measured.held * self.margin;
        is_held || measured.nearest < 0.0 && !object.is_left_at(measured)
    }

    /// A point with its object.
    fn point(&self, points: &Points, key: u16) -> Option<(GuardedPoint, &NearObject)> {
        let point = *points.guarded.get(usize::from(key))?;
        Some((point, self.objects.get(usize::from(point.object))?))
    }

    /// The surfaces of the body and of an object after a share of a step.
    fn frames_at<'a>(&'a self, object: &'a NearObject, step: &Taken, share: f64) -> Frames<'a> {
        let mesh = step.at(share) * Pose::from_translation(-self.center_of_mass);
        object.frames((&self.probe, &mesh), &object.moved_on(step.dt * share), self.margin)
    }
}

/// The measurement of a point that has moved to where its surface is nearest to the other one, as far as it
/// gets by the measurements `left`.
fn settled(
    point: &mut GuardedPoint,
    frames: &Frames<'_>,
    least: f64,
    reach: f64,
    left: &mut u32,
) -> Measured {
    let measured = point.measure(frames, least as f32, reach);
    *left = left.saturating_sub(1);
    if measured.is_settled || *left == 0 {
        return measured;
    }
    *left -= 1;
    point.measure_on(frames, least as f32, reach)
}

impl NearObject {
    /// Whether a point passes out of an overlap that was there from the start.
    fn is_left_at(&self, measured: &Measured) -> bool {
        self.overlapped && measured.distance == f64::INFINITY
    }

    /// Pose of its mesh's frame a time (s) after the start of the step.
    fn moved_on(&self, dt: f64) -> Pose {
        let twist = self.motion.twist;
        self.before.moved(&Twist { linear: twist.velocity_at(self.before.translation), ..twist }, dt)
    }
}

impl StepContacts {
    /// Sets contacts beyond a gap (m) aside if one of them has pushed. Returns whether there is any.
    fn set_aside(&mut self, gap: f64) -> bool {
        let Self { contacts, aside, .. } = self;
        let is_apart = |contact: &Constraint| contact.gap > gap;
        if !contacts.iter().any(|it| is_apart(it) && it.impulse.dot(it.normal) > 0.0) {
            return false;
        }
        aside.extend(contacts.iter().filter(|it| is_apart(it)).copied());
        contacts.retain(|contact| !is_apart(contact));
        true
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DQuat;
    use palpate_dynamics::BodyState;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::super::tests::geometry_at;
    use super::super::{MAX_MEASURED, StepMotion};
    use super::*;

    /// Two objects of which one is pushed may be at the same place: each has its own contact there, also
    /// after the step is taken again, and where it was not near at the start.
    #[test]
    fn objects_at_one_place_are_held_by_a_contact_each() {
        const GAP: f64 = 0.05;
        // The probe's corner at x = 1 is before a face of both.
        let at = DVec3::new(1.0 + GAP, -0.25, -0.25);
        let mut made = geometry_at([(at, 0.0), (at, 0.0), (DVec3::splat(9.0), 0.0)], 30);
        (made.margin, made.bound.radius, made.objects[1].pushed) = (1e-3, 1.0, Some(0));
        let mut points = Points::default();
        points.assign(&made);
        let (mut at_start, state) =
            (StepContacts::default(), BodyState::at_rest(Pose::from_translation(made.center_of_mass)));
        let motion = StepMotion { moved: 0.0, reach: 4.0 * GAP, dt: 1e-3 };
        made.contacts(&mut points, &state, &motion, &StepContacts::default(), &mut at_start);
        let both = |found: &StepContacts| {
            let pushed: Vec<_> = found.contacts.iter().map(|contact| contact.pushed).collect();
            let [a, b] = found.contacts.as_slice() else { panic!("{found:?}") };
            assert!(pushed.contains(&None) && pushed.contains(&Some(0)), "{found:?}");
            assert!(a.arm.distance(b.arm) < 1e-9 && a.normal.distance(b.normal) < 1e-9, "{found:?}");
            assert!(a.normal.distance(DVec3::X) < 1e-9, "{found:?}");
        };
        both(&at_start);
        let mut found = at_start.clone();
        let poses = [made.center_of_mass, made.center_of_mass + 2.0 * GAP * DVec3::X];
        let step = Taken { poses: poses.map(Pose::from_translation), dt: 1e-3 };
        // Both have pushed at a distance; then both are met.
        found.contacts.iter_mut().for_each(|contact| contact.impulse = contact.normal);
        assert!(made.revise(&mut points, &step, &mut found) && found.contacts.is_empty(), "{found:?}");
        assert!(made.revise(&mut points, &step, &mut found));
        both(&found);
        // One is known; the other one is met by the step's end.
        for kept in [None, Some(0)] {
            let mut found = at_start.clone();
            found.contacts.retain(|contact| contact.pushed == kept);
            assert!(found.contacts.len() == 1 && made.revise(&mut points, &step, &mut found), "{found:?}");
            both(&found);
        }
    }

    /// A step that would meet three faces one after the other is taken again with the first, and with what is
    /// met at about that time elsewhere; not with what comes later, nor with what the first is beside.
    #[test]
    fn what_is_met_first_comes_back_first() {
        const GAP: f64 = 0.05;
        // The probe's corner at x = 1 meets faces halfway, a little later, and much later.
        let at = |share: f64| DVec3::new(1.0 + 2.0 * share * GAP, -0.25, -0.25);
        let met = |second: f64, radius: f64| {
            let mut made = geometry_at([(at(0.5), 0.0), (at(second), 0.0), (at(0.95), 0.0)], 30);
            (made.margin, made.bound.radius) = (1e-4, 1.0);
            let mut points = Points::default();
            points.assign(&made);
            let (mut found, state) =
                (StepContacts::default(), BodyState::at_rest(Pose::from_translation(made.center_of_mass)));
            let motion = StepMotion { moved: 0.0, reach: 4.0 * GAP, dt: 1e-3 };
            made.contacts(&mut points, &state, &motion, &StepContacts::default(), &mut found);
            let objects = |points: &Points, found: &StepContacts| {
                let mut objects: Vec<_> =
                    found.contacts.iter().filter_map(|it| points.object_of(it.key)).collect();
                objects.sort_unstable();
                objects
            };
            assert_eq!(objects(&points, &found), [0, 1, 2], "{found:?}");
            let poses = [made.center_of_mass, made.center_of_mass + 2.0 * GAP * DVec3::X];
            let step = Taken { poses: poses.map(Pose::from_translation), dt: 1e-3 };
            found.contacts.iter_mut().for_each(|contact| contact.impulse = contact.normal);
            assert!(made.revise(&mut points, &step, &mut found) && found.contacts.is_empty(), "{found:?}");
            made.bound.radius = radius;
            assert!(made.take_back(&points, &step, 2.0 * GAP, &mut found));
            objects(&points, &found)
        };
        assert_eq!(met(0.5, 1.0), [0, 1], "at once");
        assert_eq!(met(0.55, 1.0), [0], "a little later, beside it");
        assert_eq!(met(0.55, 0.0), [0, 1], "a little later, elsewhere");
        assert_eq!(met(0.7, 0.0), [0], "later");
    }

    /// A contact at a point of a geometry of three objects, to which keys belong in turn by tens.
    fn contact(key: u16, arm: DVec3, normal: DVec3, gap: f64) -> Constraint {
        Constraint { impulse: normal, key, ..Constraint::new(arm, normal, gap) }
    }

    /// What is on the plane of a face that holds the body comes back at once, if any of it is passed.
    #[test]
    fn contacts_with_one_face_come_back_together() {
        let mut made = geometry_at([(DVec3::X, 0.0); 3], 30);
        made.margin = 1e-6;
        let mut points = Points::default();
        points.assign(&made);
        let (down, slope) = (DVec3::NEG_Z, DVec3::new(0.01, 0.0, -1.0).normalize());
        let held = contact(0, DVec3::NEG_Z, down, 0.0);
        let (on, off) = (DVec3::new(0.3, 0.0, -0.9999), DVec3::new(0.3, 0.0, -0.99));
        // Two on the plane; one on another object's, one aslant and one on another plane.
        let aside = [(1, on, down, 1e-4), (2, on, down, 1e-4), (10, on, down, 1e-4)];
        let aside = [&aside[..], &[(3, on, slope, 1e-4), (4, off, down, 1e-4)]].concat();
        let aside = aside.iter().map(|(key, arm, normal, gap)| contact(*key, *arm, *normal, *gap));
        for (passed, wanted) in [(Some(1), vec![0, 1, 2]), (Some(10), vec![0]), (None, vec![0])] {
            let mut left: ArrayVec<_, MAX_REACHED> = aside.clone().collect();
            let mut contacts = ArrayVec::from_iter([held]);
            let is_passed = |contact: &Constraint| Some(contact.key) == passed;
            assert_eq!(made.take_level(&points, is_passed, &mut left, &mut contacts), wanted.len() > 1);
            let mut keys: Vec<u16> = contacts.iter().map(|contact| contact.key).collect();
            keys.sort_unstable();
            assert_eq!((keys, left.len()), (wanted.clone(), 6 - wanted.len()), "{passed:?} is passed");
        }
    }

    /// What a blow turns is held along the normal that it has by then: not along another facet's, nor around
    /// an edge.
    #[test]
    fn contacts_turn_with_what_they_hold() {
        let mut made = geometry_at([(DVec3::X, 0.0); 3], 3);
        made.margin = 1e-5;
        let start = Pose::IDENTITY;
        let (dt, turn) = (1e-3, 0.004);
        let step = Taken { poses: [start, start.moved(&Twist::new(DVec3::ZERO, DVec3::Y), turn)], dt };
        let (arm, down) = (DVec3::NEG_Z, DVec3::NEG_Z);
        let turned = |angle: f64| DQuat::from_rotation_y(angle) * down;
        let measured = |normal: DVec3, distance: f64| Measured {
            point: step.poses[1].transform_point(arm),
            normal,
            distance,
            nearest: distance,
            is_settled: true,
            held: 1.0,
        };
        let known = contact(0, arm, down, 1e-4);
        let change = |later: Measured| made.turned(&known, &made.objects[0], &step, &later);
        let touches = made.margin;
        let found = change(measured(turned(turn), touches)).expect("it has turned");
        // The same step ends where it did.
        let by = step.motion().velocity_at(found.arm) - found.velocity * dt;
        assert!((found.gap - found.normal.dot(by)).abs() < 1e-12, "{found:?}");
        assert_eq!((found.normal, found.impulse), (turned(turn), down));
        let unsettled = Measured { is_settled: false, ..measured(turned(turn), touches) };
        for (case, later) in [
            ("is another facet", measured(turned(0.3), touches)),
            ("has hardly turned", measured(turned(1e-4), touches)),
            ("does not touch", measured(turned(turn), 1e-3)),
            ("overlaps", measured(turned(turn), 0.0)),
            ("comes around an edge", measured(turned(-0.1), touches)),
            ("has not settled", unsettled),
        ] {
            assert!(change(later).is_none(), "what {case} is turned");
        }
    }

    /// Bodies that turn: a step's equations, of motion along tangents, bring what meets as far into each
    /// other as the step did.
    #[test]
    fn contacts_allow_for_how_bodies_turn() {
        const DT: f64 = 1e-3;
        let mut rng = StdRng::seed_from_u64(0xBE27);
        let mut random =
            |size: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-size..size)));
        let mut most: f64 = 0.0;
        for round in 0..300 {
            let mut made = geometry_at([(DVec3::X, 0.0); 3], 1);
            let twist = Twist::new(random(2.0), random(100.0));
            let object = &mut made.objects[0];
            (object.before, object.motion.twist) = (object.pose, Twist::new(random(1.0), random(50.0)));
            let start = Pose::new(random(0.1), DQuat::from_scaled_axis(random(3.0)));
            let step = Taken { poses: [start, start.moved(&twist, DT)], dt: DT };
            let share = [0.25, 0.5, 1.0][round % 3];
            let (point, normal) = (step.at(share).translation + random(0.1), random(1.0).normalize());
            let distance = -1e-5 * (round % 5) as f64;
            let (nearest, is_settled, held) = (distance, true, 1.0);
            let measured = Measured { point, normal, distance, nearest, is_settled, held };
            let object = &made.objects[0];
            let contact = made.contact_at(0, object, &step, share, &measured);
            // Where the points that meet are at the end of the step.
            let body_end = (step.poses[1] * step.at(share).inverse()).transform_point(point);
            let surface_end =
                (object.moved_on(DT) * object.moved_on(share * DT).inverse()).transform_point(point);
            let wanted = distance + normal.dot(surface_end - body_end);
            let end =
                |surface: DVec3| contact.gap - normal.dot(twist.velocity_at(contact.arm) - surface) * DT;
            let found = end(contact.velocity);
            assert!((found - wanted).abs() < 1e-12, "round {round}: {found} m, not {wanted} m");
            let surface = object.motion.twist.velocity_at(start.translation + contact.arm);
            most = most.max((end(surface) - wanted).abs());
            assert!((contact.velocity - surface).reject_from(normal).length() < 1e-9, "round {round}");
        }
        assert!(most > 1e-4, "along tangents alone they would be off by {most} m");
    }

    /// Points that are deep inside another body at the start of a step cost it a measurement, and not one for
    /// each pose along it, and none if they are deeper; those at the surface are measured along it, a bounded
    /// number of times.
    #[test]
    fn deep_overlaps_are_not_followed_along_a_step() {
        let left = |margin: f64, depth: f64| {
            // The probe's corner at x = 1 is inside, between two faces and the slanted one.
            let mut made = geometry_at([(DVec3::new(3.0 * depth, -depth, -depth), 0.0); 3], 30);
            (made.margin, made.bound.radius) = (margin, 1.0);
            let mut points = Points::default();
            points.assign(&made);
            let (mut found, state) =
                (StepContacts::default(), BodyState::at_rest(Pose::from_translation(made.center_of_mass)));
            let motion = StepMotion { moved: 1.0, reach: 0.1, dt: 1e-3 };
            made.contacts(&mut points, &state, &motion, &StepContacts::default(), &mut found);
            assert!((found.depth - depth).abs() < 0.5 * depth && found.near.len() == 30, "{found:?}");
            let poses = [made.center_of_mass, made.center_of_mass + 0.02 * DVec3::Y];
            let step = Taken { poses: poses.map(Pose::from_translation), dt: 1e-3 };
            let taken = (0..20).take_while(|_| made.revise(&mut points, &step, &mut found)).count();
            assert!(taken < 8, "taken {taken} times");
            found.left
        };
        assert_eq!([left(1e-4, 0.05), left(1e-3, 0.05)], [MAX_MEASURED, MAX_MEASURED - 30]);
        let near = left(1e-3, 0.002);
        assert!(near < MAX_MEASURED - 20 && near > 0, "{near} measurements are left");
    }
}
