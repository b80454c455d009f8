//! The points of a geometry as the haptic loop's steps move them.
//!
//! There are three kinds. Those *in turn* are the points that the query has made, each object's after those
//! of the last one. Their starts are in [reserve](Reserve): where surfaces come near one of them, a point
//! *wakes* there, beside those in turn. So does a point that pushed when a geometry took the place of
//! another: what holds the body does not depend on which points the next query finds.

use std::sync::Arc;

use arrayvec::ArrayVec;
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::{BodyState, Constraint, MAX_CONSTRAINTS};
use palpate_field::ClosestPoint;

use super::{
    APART, CLEAR, ContactGeometry, LANES, MAX_LOOKS, MAX_OBJECTS, MAX_POINTS, MAX_RESERVES, NearObject,
    OBJECT_REACH, SAME_PLACE, StepContacts, StepMotion, is_level,
};
use crate::constraints::guarded_point::{Frames, GuardedPoint, Measured, Reserve, below};

/// Largest number of points beside those in turn: as many that pushed as there may be, and as many from
/// reserves.
const MAX_WOKEN: usize = 2 * MAX_CONSTRAINTS;

/// The guarded points of a geometry where the haptic loop's steps have moved them.
#[derive(Debug)]
pub(crate) struct Points {
    /// Those of each object in turn, and then those beside them. Their indices are the keys of contacts.
    pub(super) guarded: Vec<GuardedPoint>,
    /// Distances that the bodies may move before those in turn have to be measured again, m: a step passes
    /// over all of them in a few instructions.
    slacks: Vec<f32>,
    /// Number of points of the objects up to each.
    ends: ArrayVec<u16, MAX_OBJECTS>,
    /// The same for the reserves.
    reserve_slacks: Vec<f32>,
    reserve_ends: ArrayVec<u16, MAX_OBJECTS>,
    /// What is known of the points beside those in turn.
    woken: Vec<Woken>,
    /// Motion of the body and of each object since the query, m.
    motions: ArrayVec<f64, MAX_OBJECTS>,
}

/// A point beside those in turn.
#[derive(Clone, Copy, Debug)]
struct Woken {
    /// Index of its reserve; `None` for one that pushed with the last geometry.
    from: Option<u16>,
    /// Whether no other point has come to the same place.
    is_awake: bool,
    /// Distance that the bodies may move before it has to be measured again, m.
    slack: f32,
}

/// Points that pushed, with their slacks, m.
pub(crate) type Carried = ArrayVec<(GuardedPoint, f32), MAX_CONSTRAINTS>;

/// What a step may reach: keys of points, and indices of reserves, those of each object in turn.
#[derive(Default)]
pub(super) struct Near {
    points: ArrayVec<u16, MAX_POINTS>,
    woken: ArrayVec<u16, MAX_WOKEN>,
    reserves: ArrayVec<u16, MAX_RESERVES>,
    /// Number of points beside those in turn, up to each object.
    woken_ends: ArrayVec<u16, MAX_OBJECTS>,
}

/// What a step may reach of an object.
pub(super) struct Reached<'a> {
    pub frames: Frames<'a>,
    pub object: &'a NearObject,
    /// Distance within which contacts are wanted, m, and distance at which surfaces are held apart, m.
    pub reach: f64,
    pub margin: f64,
    /// Motion of the bodies since the query, and of the object in the step, m.
    pub since: f64,
    pub ahead: f64,
    /// Centre of mass of the body, world, m.
    pub center: DVec3,
    pub friction: f64,
    /// Index of the first contact with it.
    pub own: usize,
}

/// A point that has come to rest in a step. Those that were at the same place follow it there: points from
/// all sides end at the minimum that holds the body.
pub(super) struct Lead {
    was: GuardedPoint,
    now: GuardedPoint,
    /// Whether its contact is within reach.
    is_near: bool,
}

impl ContactGeometry {
    /// Finds the contacts that a step from a state of the body may reach, with the scene's objects where they
    /// are at its start. The impulses of the last step's contacts, `before`, are taken over.
    ///
    /// Points lose what the bodies have really moved, whatever the length of the steps: a host's steps vary,
    /// and the velocity of this step may be that after a push.
    pub fn contacts(
        &mut self,
        points: &mut Points,
        state: &BodyState,
        motion: &StepMotion,
        before: &StepContacts,
        found: &mut StepContacts,
    ) {
        found.clear();
        found.radius = self.bound.radius;
        let StepMotion { moved, reach, dt } = *motion;
        let to_mesh = Pose::from_translation(-self.center_of_mass);
        let mesh = state.pose * to_mesh;
        let Self { probe, objects, margin, friction, reserves, .. } = self;
        let near = points.pass(objects, (moved, reach, dt), found);
        for (index, object) in objects.iter_mut().enumerate() {
            object.before = object.pose;
            let Some((own, woken, own_reserves)) = near.of(index, points) else { continue };
            let frames = object.frames((probe, &mesh), &object.pose, *margin);
            let ahead = object.speed * dt;
            let at = Reached {
                frames,
                object,
                reach: reach + OBJECT_REACH * ahead,
                margin: *margin,
                since: points.since(index),
                ahead,
                center: state.pose.translation,
                friction: friction.static_coefficient,
                own: found.contacts.len(),
            };
            let mut lead = None;
            own.iter().for_each(|key| points.meet(*key, &at, &mut lead, found));
            woken.iter().for_each(|key| points.meet_woken(*key, &at, found));
            own_reserves.iter().for_each(|place| points.look(*place, reserves, &at, found));
        }
        found.take_over(before, friction);
    }
}

impl Default for Points {
    /// Room for as many as there may be, so that none is made later.
    fn default() -> Self {
        Self {
            guarded: Vec::with_capacity(MAX_POINTS + MAX_WOKEN),
            slacks: Vec::with_capacity(MAX_POINTS),
            ends: ArrayVec::new(),
            reserve_slacks: Vec::with_capacity(MAX_RESERVES),
            reserve_ends: ArrayVec::new(),
            woken: Vec::with_capacity(MAX_WOKEN),
            motions: ArrayVec::new(),
        }
    }
}

impl Clone for Points {
    /// With as much room.
    fn clone(&self) -> Self {
        let Self { guarded, slacks, ends, reserve_slacks, reserve_ends, woken, motions } = self;
        let mut copy = Self::default();
        copy.guarded.clone_from(guarded);
        copy.slacks.clone_from(slacks);
        copy.reserve_slacks.clone_from(reserve_slacks);
        copy.woken.clone_from(woken);
        (copy.ends, copy.reserve_ends, copy.motions) = (ends.clone(), reserve_ends.clone(), motions.clone());
        copy
    }
}

impl Points {
    /// Copies those of a geometry.
    pub fn assign(&mut self, found: &ContactGeometry) {
        let Self { guarded, slacks, ends, reserve_slacks, reserve_ends, woken, motions } = self;
        guarded.clear();
        guarded.extend(found.points.iter().take(MAX_POINTS).copied());
        slacks.clear();
        slacks.extend(guarded.iter().map(|point| point.slack));
        reserve_slacks.clear();
        reserve_slacks.extend(found.reserves.iter().take(MAX_RESERVES).map(|reserve| reserve.slack));
        woken.clear();
        ends.clear();
        reserve_ends.clear();
        for index in 0..found.objects.len() {
            let end = guarded.partition_point(|point| usize::from(point.object) <= index);
            ends.push(end as u16);
            let end = found.reserves.partition_point(|reserve| usize::from(reserve.object) <= index);
            reserve_ends.push(end.min(MAX_RESERVES) as u16);
        }
        motions.clear();
        motions.extend(found.objects.iter().map(|_| 0.0));
    }

    /// Index of the scene object of the point of a key.
    pub fn object_of(&self, key: u16) -> Option<u8> {
        self.guarded.get(usize::from(key)).map(|point| point.object)
    }

    /// Motion of the body and of an object since the query, m.
    pub fn since(&self, object: usize) -> f64 {
        self.motions.get(object).copied().unwrap_or(0.0)
    }

    /// Takes into account that the bodies have moved since the query: the one in the hand by `moved` (m), and
    /// the scene's by as much as they have been moved on.
    pub fn shift(&mut self, objects: &mut [NearObject], moved: f64) {
        let Self { slacks, ends, reserve_slacks, reserve_ends, motions, .. } = self;
        let (mut first, mut first_reserve) = (0, 0);
        let ends = ends.iter().zip(&*reserve_ends);
        for ((object, since), (end, reserve_end)) in objects.iter_mut().zip(motions).zip(ends) {
            let gone = moved + std::mem::take(&mut object.moved);
            *since += gone;
            let (end, reserve_end) = (usize::from(*end), usize::from(*reserve_end));
            let own = slacks[first..end].iter_mut();
            own.chain(&mut reserve_slacks[first_reserve..reserve_end])
                .for_each(|slack| *slack -= gone as f32);
            (first, first_reserve) = (end, reserve_end);
        }
    }

    /// Takes the motion since the last step off all slacks, of the body (`moved`, m) and of each object.
    /// Returns what a step of `dt` (s) may reach, with the `reach` of the body's own motion (m).
    pub(super) fn pass(
        &mut self,
        objects: &mut [NearObject],
        (moved, reach, dt): (f64, f64, f64),
        found: &mut StepContacts,
    ) -> Near {
        let Self { guarded, slacks, ends, reserve_slacks, reserve_ends, woken, motions } = self;
        let mut near = Near::default();
        let (mut first, mut first_reserve) = (0, 0);
        let ends = ends.iter().zip(&*reserve_ends);
        for (index, ((object, since), (end, reserve_end))) in
            objects.iter_mut().zip(motions).zip(ends).enumerate()
        {
            let (own, kept) = (first..usize::from(*end), first_reserve..usize::from(*reserve_end));
            (first, first_reserve) = (own.end, kept.end);
            if !object.felt_elsewhere {
                // What is beyond the reach is met neither by the body's motion nor by the object's.
                let ahead = object.speed * dt;
                let reach = (reach + OBJECT_REACH * ahead) as f32;
                let gone = moved + std::mem::take(&mut object.moved);
                *since += gone;
                let gone = gone as f32;
                let of_points = pass(gone, reach, &mut slacks[own.clone()], own.start, &mut near.points);
                let kept_slacks = &mut reserve_slacks[kept.clone()];
                let of_reserves = pass(gone, reach, kept_slacks, kept.start, &mut near.reserves);
                let mut room = of_points.min(of_reserves);
                let awake = (slacks.len()..).zip(woken.iter_mut()).filter(|(_, woken)| woken.is_awake);
                for (key, woken) in awake.filter(|(key, _)| usize::from(guarded[*key].object) == index) {
                    woken.slack -= gone;
                    if woken.slack > reach {
                        room = room.min(woken.slack);
                    } else {
                        near.woken.push(key as u16);
                    }
                }
                found.room = found.room.min(f64::from(room) - ahead);
            }
            near.woken_ends.push(near.woken.len() as u16);
        }
        if near.reserves.len() > MAX_LOOKS {
            // The nearest of all objects; the others bound the motion.
            let slack = |place: &u16| reserve_slacks[usize::from(*place)];
            near.reserves.select_nth_unstable_by(MAX_LOOKS, |a, b| slack(a).total_cmp(&slack(b)));
            let left_out = near.reserves.drain(MAX_LOOKS..).map(|place| f64::from(slack(&place)));
            found.room = left_out.fold(found.room, f64::min);
            near.reserves.sort_unstable();
        }
        near
    }

    /// Measures a point in turn, and adds its contact if it is within reach. The last one that was measured
    /// may `lead` it.
    pub(super) fn meet(
        &mut self,
        key: u16,
        at: &Reached<'_>,
        lead: &mut Option<Lead>,
        found: &mut StepContacts,
    ) {
        let (point, slack) = (&mut self.guarded[usize::from(key)], &mut self.slacks[usize::from(key)]);
        if let Some(Lead { was, now, is_near }) = lead
            && point.follow((was, now), &at.frames, SAME_PLACE * found.radius)
        {
            *slack = point.slack;
            if *is_near && found.near.try_push(key).is_err() {
                found.room = 0.0;
            }
            return;
        }
        let was = *point;
        let (measured, gap) = at.measure(point, *slack);
        *slack = point.slack;
        *lead = measured.is_settled.then_some(Lead { was, now: *point, is_near: gap <= at.reach });
        at.add(key, &measured, gap, *slack, found);
    }

    /// The same for a point beside those in turn. Where another one has come to the same place, it sleeps; so
    /// does one that has pushed, where another one holds the body along the same plane.
    pub(super) fn meet_woken(&mut self, key: u16, at: &Reached<'_>, found: &mut StepContacts) {
        let woken = &mut self.woken[usize::from(key) - self.slacks.len()];
        let point = &mut self.guarded[usize::from(key)];
        let (measured, gap) = at.measure(point, woken.slack);
        woken.slack = point.slack;
        let contact = at.contact(key, &measured, gap);
        let is_held = |known: &Constraint| {
            let within = APART * at.margin;
            known.gap <= gap + within && is_level(known, &contact, within)
        };
        let is_held = || woken.from.is_none() && found.contacts[at.own..].iter().any(is_held);
        if gap <= at.reach && (found.at(at.own, contact.arm, contact.normal).is_some() || is_held()) {
            woken.is_awake = false;
        } else {
            at.add(key, &measured, gap, woken.slack, found);
        }
    }

    /// Measures a reserve that may be within reach. Where surfaces are not clear of each other, a point
    /// starts there; where they are, it is one of those `coming`.
    pub(super) fn look(
        &mut self,
        place: u16,
        reserves: &[Reserve],
        at: &Reached<'_>,
        found: &mut StepContacts,
    ) {
        let reserve = &reserves[usize::from(place)];
        let ClosestPoint { distance, face, .. } = reserve.closest(&at.frames);
        let slack = reserve.slack_at(distance);
        self.reserve_slacks[usize::from(place)] = slack;
        let is_near = distance - at.margin <= at.reach;
        if reserve.hides() || !is_near {
            found.room = found.room.min(f64::from(slack) - at.ahead);
        }
        let is_awake = || self.woken.iter().any(|woken| woken.is_awake && woken.from == Some(place));
        if !is_near || is_awake() {
            return;
        }
        if distance >= CLEAR * at.margin {
            found.coming.push(place);
        } else if let Some(key) = self.wake(place, reserve, face) {
            self.meet_woken(key, at, found);
        }
    }

    /// What the motion since its last measurement has left of a reserve's slack, m.
    pub(super) fn reserve_slack(&self, place: u16) -> f32 {
        self.reserve_slacks[usize::from(place)]
    }

    /// Starts a point at a reserve, over a face of the other surface. Returns its key; `None` if there is no
    /// room for it.
    pub(super) fn wake(&mut self, place: u16, reserve: &Reserve, face: u32) -> Option<u16> {
        let slack = self.reserve_slack(place);
        let woken = Woken { from: Some(place), is_awake: true, slack };
        let point = reserve.wake(face, slack);
        let Some(slot) = self.woken.iter().position(|woken| woken.from == Some(place)) else {
            return self.push_woken(&point, woken);
        };
        let key = self.slacks.len() + slot;
        (self.guarded[key], self.woken[slot]) = (point, woken);
        Some(key as u16)
    }

    fn push_woken(&mut self, point: &GuardedPoint, woken: Woken) -> Option<u16> {
        let key = self.guarded.len() as u16;
        let is_room = self.woken.len() < MAX_WOKEN;
        is_room.then(|| {
            self.woken.push(woken);
            self.guarded.push(*point);
            key
        })
    }

    /// The points whose contacts push, for a geometry `next` that takes the place of the `last` one, after a
    /// motion of the body (m).
    pub fn pushing(
        &self,
        contacts: &StepContacts,
        (last, next): (&ContactGeometry, &ContactGeometry),
        moved: f64,
    ) -> Carried {
        if !Arc::ptr_eq(&last.probe, &next.probe) {
            return Carried::new();
        }
        let carried = |contact: &Constraint| {
            let key = usize::from(contact.key);
            let point = self.guarded.get(key)?;
            let object = last.objects.get(usize::from(point.object))?;
            let is_it =
                |now: &NearObject| now.place == object.place && Arc::ptr_eq(&now.surface, &object.surface);
            let index = next.objects.iter().position(is_it)?;
            let slack = match self.slacks.get(key) {
                Some(slack) => *slack,
                None => self.woken.get(key - self.slacks.len())?.slack,
            };
            // Where one that moves is now is not known before it is measured.
            let is_still = object.is_still() && next.objects[index].is_still();
            let left = if is_still { below(f64::from(slack) - moved) } else { f32::NEG_INFINITY };
            Some((point.carried(index as u8, self.since(usize::from(point.object))), left))
        };
        contacts.pushing().filter_map(carried).collect()
    }

    /// Adds points that pushed with the last geometry.
    pub fn carry(&mut self, carried: &Carried) {
        for (point, slack) in carried {
            self.push_woken(point, Woken { from: None, is_awake: true, slack: *slack });
        }
    }
}

impl Near {
    /// The points in turn, those beside them, and the reserves of an object; `None` if there is none.
    pub fn of(&self, index: usize, points: &Points) -> Option<(&[u16], &[u16], &[u16])> {
        let range = |ends: &[u16]| {
            let first = index.checked_sub(1).map_or(Some(&0), |before| ends.get(before))?;
            ends.get(index).map(|end| *first..*end)
        };
        let own = |near: &'_ [u16], ends: &[u16]| {
            let range = range(ends)?;
            let at = |end: u16| near.partition_point(|index| *index < end);
            Some(at(range.start)..at(range.end))
        };
        let Self { points: near, woken, reserves, woken_ends } = self;
        let range = range(woken_ends)?;
        let near = &near[own(near, &points.ends)?];
        let woken = &woken[usize::from(range.start)..usize::from(range.end)];
        let reserves = &reserves[own(reserves, &points.reserve_ends)?];
        (!near.is_empty() || !woken.is_empty() || !reserves.is_empty()).then_some((near, woken, reserves))
    }
}

impl Reached<'_> {
    /// Measures a point, with what the motion since its last measurement has left of its slack, m. Returns
    /// the gap, too: its distance beyond that at which surfaces are held apart, m.
    #[inline(always)]
    fn measure(&self, point: &mut GuardedPoint, slack: f32) -> (Measured, f64) {
        let Self { frames, reach, margin, since, .. } = self;
        let (reach, left) = (*reach, f64::from(slack));
        let mut measured = point.measure(frames, slack, margin + reach);
        // Until it has come to rest, no more is known than what it has been clear of, and how far other
        // places on its leash are.
        if !measured.is_settled && measured.distance >= left {
            measured = point.measure_on(frames, slack, margin + reach);
        }
        let (mut clear, turned) = point.look_around(frames, measured.distance, (reach, *margin), *since);
        if turned {
            // It goes down anew, from where another face is nearer.
            measured = point.measure_on(frames, slack, margin + reach);
            clear = measured.distance;
        }
        let gap = measured.distance - measured.held * margin;
        // One that has further to go is measured again in the next step.
        let known = match (measured.is_settled, gap.is_finite()) {
            (true, _) => gap.min(clear).min(measured.nearest),
            (false, true) => {
                let others = point.least_beside(measured.nearest).max(left.clamp(0.0, reach));
                gap.min(measured.nearest).min(others)
            }
            (false, false) => measured.nearest.clamp(0.0, reach),
        };
        point.slack = below(known);
        (measured, gap)
    }

    #[inline(always)]
    fn contact(&self, key: u16, measured: &Measured, gap: f64) -> Constraint {
        Constraint {
            arm: measured.point - self.center,
            normal: measured.normal,
            gap,
            velocity: self.object.motion.twist.velocity_at(measured.point),
            friction: self.friction,
            impulse: DVec3::ZERO,
            pushed: self.object.pushed,
            key,
        }
    }

    /// Adds the contact of a point if it is within reach; else it bounds the motion by its `slack`, m.
    #[inline(always)]
    fn add(&self, key: u16, measured: &Measured, gap: f64, slack: f32, found: &mut StepContacts) {
        let Self { object, reach, ahead, own, .. } = *self;
        if object.overlapped {
            // Deepest are places that others hold, too.
            found.depth = found.depth.max(-measured.nearest);
        }
        if gap > reach {
            // Where another point is nearer, that one bounds the motion.
            let room = if gap.is_finite() { slack.into() } else { reach };
            found.room = found.room.min(room - ahead);
            return;
        }
        found.depth = found.depth.max(-measured.distance);
        let contact = self.contact(key, measured, gap);
        if !found.add(own, contact, measured.nearest) || found.near.try_push(key).is_err() {
            found.room = 0.0;
        }
    }
}

/// Takes a motion (m) off all slacks, those from the index `first` on. Appends the indices of those within a
/// reach (m), and returns the least of the others, m.
fn pass<const N: usize>(
    gone: f32,
    reach: f32,
    slacks: &mut [f32],
    first: usize,
    near: &mut ArrayVec<u16, N>,
) -> f32 {
    let mut least = [f32::INFINITY; LANES];
    for (chunk, slacks) in slacks.chunks_mut(LANES).enumerate() {
        let mut any = 0;
        for (slack, least) in slacks.iter_mut().zip(&mut least) {
            *slack -= gone;
            let is_far = *slack > reach;
            any |= u32::from(!is_far);
            let far = if is_far { *slack } else { f32::INFINITY };
            *least = if far < *least { far } else { *least };
        }
        if any == 0 {
            continue;
        }
        for (lane, slack) in slacks.iter().enumerate() {
            if *slack <= reach || slack.is_nan() {
                near.push((first + LANES * chunk + lane) as u16);
            }
        }
    }
    least.into_iter().fold(f32::INFINITY, f32::min)
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use palpate_core::glam::DQuat;
    use palpate_field::{FeatureMesh, Leash};

    use super::super::taken::Taken;
    use super::super::tests::{geometry, without_points};
    use super::*;
    use crate::constraints::guarded_point::SEARCHES;
    use crate::constraints::test_meshes::{ball, block};

    /// Half an edge of a cube over a plate, its height over that, and the margin, m.
    const HALF: f64 = 0.01;
    const HEIGHT: f64 = 1e-4;
    const MARGIN: f64 = 1e-6;

    /// Two opposite corners of the cube's bottom.
    const CORNERS: [DVec3; 2] = [DVec3::new(-HALF, -HALF, -HALF), DVec3::new(HALF, HALF, -HALF)];

    /// A cube over a plate, with a point at one of its corners and a reserve at another one, if wanted.
    /// Neither descends to another corner.
    fn over_a_plate(point: Option<DVec3>, reserve: Option<DVec3>) -> ContactGeometry {
        let cube = Arc::new(FeatureMesh::new(&block(DVec3::splat(2.0 * HALF))));
        let plate = Arc::new(FeatureMesh::new(&block(DVec3::new(0.2, 0.2, 0.02))));
        let mut made = without_points((&cube, &plate), [(DVec3::Z * (-0.01 - HALF - HEIGHT), 0.0)]);
        (made.margin, made.bound.radius) = (MARGIN, 2.0 * HALF);
        let start = |at: DVec3| (cube.place_near(at), Leash { home: at, length: 1e-3 });
        let frames = Frames::new((&cube, &Pose::IDENTITY), (&plate, &made.objects[0].pose));
        let points = point.map(|at| GuardedPoint::new(start(at), 0, true, 0, (&frames, 0.0)));
        made.points = Arc::new(points.into_iter().collect());
        let reserves = reserve.map(|at| Reserve::new(start(at), 0, true, 0, (HEIGHT, 0.0)));
        made.reserves = Arc::new(reserves.into_iter().collect());
        made
    }

    /// The contacts of a step from a pose after a motion (m).
    fn found(made: &mut ContactGeometry, points: &mut Points, (pose, moved): (Pose, f64)) -> StepContacts {
        let mut found = StepContacts::default();
        let motion = StepMotion { moved, reach: 5e-4, dt: 1e-3 };
        let state = BodyState::at_rest(pose);
        made.contacts(points, &state, &motion, &StepContacts::default(), &mut found);
        found
    }

    fn holds(found: &StepContacts, pose: &Pose, corner: DVec3) -> bool {
        found
            .contacts
            .iter()
            .any(|contact| (pose.translation + contact.arm).distance(pose.transform_point(corner)) < 1e-6)
    }

    /// A step turns a cube about the corner that its point is at, so that the opposite one would go into the
    /// plate, where a point has started and is no more. It is held there, in this step and the next ones,
    /// until another point is there.
    #[test]
    fn a_start_that_is_left_is_held_when_it_comes_near() {
        let turn = DQuat::from_axis_angle(DVec3::new(-1.0, 1.0, 0.0).normalize(), 7e-3);
        let about = CORNERS[0];
        let end = Pose::new(about - turn * about, turn);
        let depth = -(end.transform_point(CORNERS[1]).z + HALF + HEIGHT);
        assert!((5e-5..2e-4).contains(&depth), "{depth} m");
        let step = Taken { poses: [Pose::IDENTITY, end], dt: 1e-3 };
        for reserve in [None, Some(CORNERS[1])] {
            let mut made = over_a_plate(Some(about), reserve);
            let mut points = Points::default();
            points.assign(&made);
            let mut at_start = found(&mut made, &mut points, (Pose::IDENTITY, 0.0));
            assert_eq!(at_start.contacts.len(), 1, "{at_start:?}");
            let is_known = made.revise(&mut points, &step, &mut at_start);
            assert_eq!(is_known, reserve.is_some(), "{at_start:?}");
            assert_eq!(holds(&at_start, &Pose::IDENTITY, CORNERS[1]), is_known, "{at_start:?}");
            let next = found(&mut made, &mut points, (Pose::IDENTITY, 0.0));
            assert_eq!(holds(&next, &Pose::IDENTITY, CORNERS[1]), is_known, "{next:?}");
        }
        // What has come into the margin is held at once, and by one point.
        let low = Pose::from_translation(DVec3::NEG_Z * (HEIGHT - 0.5 * MARGIN));
        for (point, awake) in [(CORNERS[0], 1), (CORNERS[1], 0)] {
            let mut made = over_a_plate(Some(point), Some(CORNERS[1]));
            let mut points = Points::default();
            points.assign(&made);
            let at_low = found(&mut made, &mut points, (low, HEIGHT));
            assert!(holds(&at_low, &low, CORNERS[1]), "{at_low:?}");
            assert_eq!(at_low.contacts.len(), 1 + awake, "{at_low:?}");
            assert_eq!(points.woken.iter().filter(|woken| woken.is_awake).count(), awake);
        }
    }

    /// The corner that would go into the plate also slides to its side, which is nearer then than the face
    /// that it goes through: it is held by that face.
    #[test]
    fn what_goes_in_beside_an_edge_is_held_by_the_face_that_it_meets() {
        const ABOVE: f64 = 1.5 * MARGIN;
        const SLIDES: f64 = 1.3e-3;
        const BESIDE: f64 = 2e-5;
        let turn = DQuat::from_axis_angle(DVec3::new(-1.0, 1.0, 0.0).normalize(), 4e-3);
        let start = Pose::from_translation(DVec3::NEG_Z * (HEIGHT - ABOVE));
        let about = CORNERS[0];
        let end = start * Pose::new(about - turn * about + DVec3::X * SLIDES, turn);
        let corner = end.transform_point(CORNERS[1]);
        assert!(-(corner.z + HALF + HEIGHT) > 2.0 * BESIDE, "{corner}");
        let mut made = over_a_plate(Some(about), Some(CORNERS[1]));
        made.objects[0].pose.translation.x = corner.x + BESIDE - 0.1;
        let mut points = Points::default();
        points.assign(&made);
        let mut at_start = found(&mut made, &mut points, (start, HEIGHT));
        let step = Taken { poses: [start, end], dt: 1e-3 };
        assert!(made.revise(&mut points, &step, &mut at_start), "{at_start:?}");
        let held = at_start.contacts.iter().find(|it| it.arm.distance(CORNERS[1]) < 1e-6);
        let held = held.unwrap_or_else(|| panic!("{at_start:?}"));
        assert!(held.normal.distance(DVec3::NEG_Z) < 1e-2, "{held:?}");
        assert!((held.gap - (ABOVE - MARGIN)).abs() < 1e-7, "{held:?}");
    }

    /// A point that pushes goes on when a geometry without it takes the place of its own: not onto a surface
    /// that has taken the place of the one it was near, and not where another point holds the same plane.
    #[test]
    fn what_pushes_goes_on_with_the_next_geometry() {
        let low = Pose::from_translation(DVec3::NEG_Z * (HEIGHT - 0.5 * MARGIN));
        let mut last = over_a_plate(Some(CORNERS[0]), None);
        let mut points = Points::default();
        points.assign(&last);
        let mut pushing = found(&mut last, &mut points, (low, HEIGHT));
        assert_eq!(pushing.contacts.len(), 1, "{pushing:?}");
        // With a point at the other corner, if wanted, and with the cube at a pose.
        let held = |pushing: &StepContacts, is_same: bool, (other, pose): (Option<DVec3>, &Pose)| {
            let points_there = over_a_plate(other, None).points;
            let mut next = ContactGeometry { points: points_there, ..last.clone() };
            if !is_same {
                next.objects[0].surface = Arc::clone(&over_a_plate(None, None).objects[0].surface);
            }
            let carried = points.pushing(pushing, (&last, &next), 0.0);
            let mut points = Points::default();
            points.assign(&next);
            points.carry(&carried);
            holds(&found(&mut next, &mut points, (*pose, HEIGHT)), pose, CORNERS[0])
        };
        let none = (None, &low);
        assert!(!held(&pushing, true, none), "it does not push");
        pushing.contacts[0].impulse = pushing.contacts[0].normal;
        assert!(held(&pushing, true, none) && !held(&pushing, false, none));
        assert!(!held(&pushing, true, (Some(CORNERS[1]), &low)), "the other corner holds the floor");
        // A tenth of the margin higher there, it does not.
        let tilt = DQuat::from_axis_angle(DVec3::new(-1.0, 1.0, 0.0).normalize(), -0.05 * MARGIN / HALF);
        let tilted = Pose { rotation: tilt, ..low };
        assert!(held(&pushing, true, (Some(CORNERS[1]), &tilted)));
    }

    /// Of more reserves than a step measures, it measures the nearest, of whatever object.
    #[test]
    fn the_nearest_reserves_are_measured() {
        let mut made = geometry([2.0, 3.0, 4.0], 0);
        let place = made.probe.place_near(DVec3::ZERO);
        let leash = Leash { home: DVec3::ZERO, length: 1.0 };
        let reserve = |object: u8, slack: f64| Reserve::new((place, leash), 0, true, object, (slack, 0.0));
        let many = (0..MAX_LOOKS + 10).map(|i| reserve(0, 1e-3 * i as f64));
        made.reserves = Arc::new(many.chain([reserve(2, 1.5e-3)]).collect());
        let mut points = Points::default();
        points.assign(&made);
        let mut found = StepContacts::default();
        found.clear();
        let near = points.pass(&mut made.objects, (0.0, 1.0, 0.0), &mut found);
        let of = |index: usize| near.of(index, &points).map_or(0, |(.., reserves)| reserves.len());
        assert_eq!([0, 1, 2].map(of), [MAX_LOOKS - 1, 0, 1]);
        let left_out = 1e-3 * (MAX_LOOKS - 1) as f64;
        assert!((found.room - left_out).abs() < 1e-6, "the others bound the motion: {} m", found.room);
    }

    #[test]
    fn slacks_that_are_passed_over_are_those_that_are_far() {
        let mut rng = StdRng::seed_from_u64(0x51AC);
        for round in 0..500 {
            let count = round % 50;
            let before: Vec<f32> = (0..count).map(|_| rng.random_range(-1.0..3.0)).collect();
            let (gone, reach) = (rng.random_range(0.0..0.5), rng.random_range(0.0..2.0));
            let (mut slacks, mut near) = (before.clone(), ArrayVec::<u16, MAX_POINTS>::new());
            let least = pass(gone, reach, &mut slacks, 0, &mut near);
            let after: Vec<f32> = before.iter().map(|slack| slack - gone).collect();
            let wanted: Vec<u16> = (0..count as u16).filter(|i| after[usize::from(*i)] <= reach).collect();
            let far = after.iter().copied().filter(|slack| *slack > reach).fold(f32::INFINITY, f32::min);
            assert_eq!((slacks, near.as_slice(), least), (after, wanted.as_slice(), far), "round {round}");
        }
        // What is not a number is measured anew.
        let mut near = ArrayVec::<u16, MAX_POINTS>::new();
        assert_eq!(pass(0.0, 1.0, &mut [2.0, f32::NAN], 0, &mut near), 2.0);
        assert_eq!(near.as_slice(), [1]);
    }

    #[test]
    fn points_are_kept_in_the_order_of_the_objects() {
        let mut points = Points::default();
        let mut copy = geometry([9.0, 8.0, 7.0], 1);
        for (heights, count) in [([2.0, 3.0, 4.0], 10), ([5.0, 3.0, 4.0], 7), ([2.0, 3.0, 4.0], 0)] {
            let found = geometry(heights, count);
            copy.assign(&found);
            points.assign(&copy);
            let order: Vec<u8> = points.guarded.iter().map(|point| point.object).collect();
            let wanted =
                |object: u8| (0..count).filter(move |i| i % 3 == usize::from(object)).map(move |_| object);
            assert_eq!(order, [0, 1, 2].into_iter().flat_map(wanted).collect::<Vec<u8>>());
            let of_points: Vec<f32> = points.guarded.iter().map(|point| point.slack).collect();
            assert_eq!(points.slacks, of_points);
            let ends: Vec<usize> = points.ends.iter().map(|end| usize::from(*end)).collect();
            let until = |object: u8| order.iter().filter(|own| **own <= object).count();
            assert_eq!(ends, [0, 1, 2].map(until));
            for (copy, found) in copy.objects.iter().zip(&found.objects) {
                assert!(Arc::ptr_eq(&copy.surface, &found.surface) && copy.pose == found.pose);
            }
            // Each object's points lose its own motion, once, and the room the largest.
            let before = points.clone();
            copy.bound.room = 1.0;
            copy.advance(0.01);
            points.shift(&mut copy.objects, 0.5);
            points.shift(&mut copy.objects, 0.0);
            for ((after, before), point) in points.slacks.iter().zip(&before.slacks).zip(&*points.guarded) {
                let gone = 0.5 + 0.01 * heights[usize::from(point.object)];
                assert!((f64::from(before - after) - gone).abs() < 1e-6, "{before} to {after}");
            }
            let most = 0.01 * heights.into_iter().fold(0.0, f64::max);
            assert!((copy.bound.room - (1.0 - most)).abs() < 1e-12, "{}", copy.bound.room);
        }
    }

    /// Every deep point searched the whole surface in each measurement.
    #[test]
    fn deep_overlaps_are_searched_for_when_the_bodies_have_moved() {
        const RADIUS: f64 = 0.02;
        const DEPTH: f64 = 5e-3;
        let mut rng = StdRng::seed_from_u64(0x5EA2);
        let surface = Arc::new(FeatureMesh::new(&ball(RADIUS, 48)));
        let below = DVec3::NEG_Z * (2.0 * RADIUS - DEPTH);
        let mut made = without_points((&surface, &surface), [(below, 0.0)]);
        (made.margin, made.bound.radius) = (1e-6, RADIUS);
        // Places on both surfaces that are in the other one.
        let points: Vec<GuardedPoint> = {
            let frames = &made.frames(&Pose::IDENTITY)[0];
            let point = |i: u32| {
                let is_probe = i.is_multiple_of(2);
                let down = if is_probe { DVec3::NEG_Z } else { DVec3::Z };
                let turn = DQuat::from_rotation_arc(DVec3::Z, down);
                let (around, aside) = (rng.random_range(-3.0..3.0), rng.random_range(0.0..0.3));
                let at = turn * (DQuat::from_rotation_z(around) * DQuat::from_rotation_x(aside) * DVec3::Z);
                let place = surface.place_near(at * RADIUS);
                let leash = Leash { home: surface.position(&place), length: (0.02 * RADIUS) as f32 };
                let within = (place, leash);
                GuardedPoint::new(within, 0, is_probe, 0, (frames, 0.0))
            };
            (0..200).map(point).collect()
        };
        made.points = Arc::new(points);
        for overlapped in [false, true] {
            made.objects[0].overlapped = overlapped;
            let (mut made, mut points) = (made.clone(), Points::default());
            points.assign(&made);
            let mut found = StepContacts::default();
            // The number of searches for a point in 100 steps to and fro by a motion, m.
            let mut searches = |motion: f64| {
                SEARCHES.set(0);
                for step in 0..100 {
                    let at = DVec3::X * motion * f64::from(step % 2);
                    let state = BodyState::at_rest(Pose::from_translation(at));
                    let motion = StepMotion { moved: motion, reach: 1e-4, dt: 1e-3 };
                    made.contacts(&mut points, &state, &motion, &StepContacts::default(), &mut found);
                    assert!(points.guarded.iter().all(|point| point.slack < -2e-3), "all are deep");
                }
                f64::from(SEARCHES.get()) / points.guarded.len() as f64
            };
            // The first ones, and then none where they are at rest, or nearly so.
            searches(0.0);
            assert_eq!([searches(0.0), searches(1e-9)], [0.0; 2]);
            let (slow, fast) = (searches(1e-5), searches(1e-4));
            assert!(slow < 2.0 && (5.0..20.0).contains(&fast), "{slow}, {fast} searches for a point");
        }
    }
}
