//! Contact geometry for the haptic loop: points of the surfaces near each other, and the surfaces themselves.
//!
//! At each step the haptic loop measures the points that the step may bring into contact, exactly and at the
//! bodies' present poses. Each [guarded point](GuardedPoint) first descends over the features of its own
//! surface to where that is nearest to the other one.

pub(crate) mod stepping;
pub(crate) mod taken;

use std::sync::Arc;

use arrayvec::ArrayVec;
use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};
use palpate_dynamics::{Constraint, Friction, MAX_CONSTRAINTS, MotionBound, MovingBody};
use palpate_field::FeatureMesh;

use super::guarded_point::{Frames, GuardedPoint, Reserve};
use crate::scene::SceneId;
use crate::scene::moving::Pushable;

/// Largest number of guarded points. With more, it takes longer to copy them; with fewer, minima of the
/// distance between detailed surfaces are missed.
pub(crate) const MAX_POINTS: usize = 2048;

/// Distance of unit normals up to which planes are one. With more, contacts with other faces are taken for
/// those with one; with less, more of them are measured and followed along a step.
const LEVEL_NORMAL: f64 = 1e-4;

/// Gap from which a contact is one at a distance, in margins between surfaces. With more, bodies that pass
/// edges that closely are held; with less, steps that end at a surface are taken more often.
const APART: f64 = 0.01;

/// Share of the margin up to which surfaces are clear of each other. With more, contacts that yield a little
/// are not; with less, bodies sink into edges that they pass.
const CLEAR: f64 = 0.8;

/// Largest number of reserves: the nearest. With more, steps take longer; with fewer, minima of the distance
/// that come near between points are met late.
pub(crate) const MAX_RESERVES: usize = 4096;

/// Largest number of reserves that a step measures. With more, steps take longer; with fewer, fast bodies
/// among many others go into them.
const MAX_LOOKS: usize = 512;

/// Largest number of points that a step may reach. With fewer, more of a body's motion waits where it touches
/// much at once; with more, it takes longer to tell their contacts apart.
const MAX_REACHED: usize = 1024;

/// Number of numbers that are compared at once.
const LANES: usize = 8;

/// Largest number of scene objects near the body. With more, a geometry takes longer to hand over.
pub(crate) const MAX_OBJECTS: usize = 64;

/// Largest number of objects whose bounds are held against where the body has come to. With more, steps take
/// longer; with fewer, a body that leaves many objects fast waits for contacts.
pub(crate) const MAX_FAR: usize = 64;

/// Distance within which a step's contacts are found, in lengths of a step at the present speed, and
/// acceleration for which it has room beyond that, m/s² at the device. With less, an object that speeds up is
/// held back for a step.
const REACH: f64 = 2.0;
const ACCELERATION: f64 = 30.0;

/// Shortest time for which the acceleration counts, s: several steps of a fast loop.
const MIN_TIME: f64 = 1e-3;

/// Distance within which contacts with a scene object are wanted beyond that of the body's own motion, in
/// lengths of the object's motion in this step.
const OBJECT_REACH: f64 = 2.0;

/// Longest time that scene objects move on from where a query found them, s.
pub(crate) const MAX_OBJECT_MOTION: f64 = 0.05;

/// Largest distance, in bounding radii of the body, and smallest cosine of the angle between normals of
/// contacts that are one. With less, points that have descended to the same place use up the contacts of a
/// step.
const SAME_PLACE: f64 = 6e-4;
const SAME_NORMAL: f64 = 0.999;

/// The same for contacts of two steps that are one, where the points have changed.
const NEAR_PLACE: f64 = 6e-3;
const NEAR_NORMAL: f64 = 0.95;

/// Number of measurements of points in all the times that a step is taken again. With fewer, bodies that meet
/// many surfaces at once are held at edges; with more, steps may take longer.
const MAX_MEASURED: u32 = 1024;

/// Largest share of the friction cone, in the last step, with which a contact still sticks.
const MAX_STICKING: f64 = 0.999;

/// A scene object near the body.
#[derive(Clone, Debug)]
pub(crate) struct NearObject {
    /// Place in the scene.
    pub place: usize,
    pub surface: Arc<FeatureMesh>,
    /// Pose of its mesh's frame.
    pub pose: Pose,
    /// The same at the start of the last step.
    pub before: Pose,
    pub motion: MovingBody,
    /// Bound on the speed of any of its points in this step, m/s; 0 for one in another hand that contacts do
    /// not push here.
    pub speed: f64,
    /// Bound on how far any of its points has moved since its points were last measured, m.
    pub moved: f64,
    /// Whether another session finds the contacts with it, so that it only bounds the body's motion here.
    pub felt_elsewhere: bool,
    /// Whether it overlapped with the body when it first came near.
    pub overlapped: bool,
    /// What the haptic loop needs to move it, if contacts push it.
    pub pushable: Option<Pushable>,
    /// Index among the bodies that the haptic loop moves.
    pub pushed: Option<u8>,
    /// Held by all who hold the surface: while there are others, the contact loop keeps the surface, too, so
    /// that they never free it.
    pub on_loan: Arc<()>,
}

/// A scene object that stands still and bounds the body's motion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FarObject {
    /// Pose of its mesh's frame, and its lower and upper bounds there, m.
    pub pose: Pose,
    pub bounds: [DVec3; 2],
    /// Largest motion of any point of the body from the query's pose with which it touches nothing else of
    /// the object, m.
    pub room: f64,
}

/// Motion of scene objects by the haptic loop: pose of the mesh's frame, and velocity of its origin.
pub(crate) type PredictedMotion = ArrayVec<(SceneId, Pose, Twist), MAX_OBJECTS>;

/// What the haptic loop needs to hold the body out of surfaces until the next query.
#[derive(Clone, Debug)]
pub(crate) struct ContactGeometry {
    /// Surface of the body in the hand.
    pub probe: Arc<FeatureMesh>,
    /// Centre of mass of the body in its mesh's frame, m.
    pub center_of_mass: DVec3,
    pub objects: ArrayVec<NearObject, MAX_OBJECTS>,
    /// Those of each object in turn. The contact loop keeps them, too, so that the haptic loop never frees
    /// them.
    pub points: Arc<Vec<GuardedPoint>>,
    /// Where they started, those of each object in turn, kept in the same way.
    pub reserves: Arc<Vec<Reserve>>,
    /// The region in which the points are all that can be touched.
    pub bound: MotionBound,
    /// Objects that bound it, and the room that the others leave beyond it, m.
    pub far: ArrayVec<FarObject, MAX_FAR>,
    pub beyond: f64,
    pub friction: Friction,
    /// Distance at which surfaces are held apart, m.
    pub margin: f64,
    /// Bound on the speed of other scene objects that may come near, m/s.
    pub far_speed: f64,
    /// Time since the query, s.
    pub age: f64,
}

/// The contacts of one step.
#[derive(Clone, Debug, Default)]
pub(crate) struct StepContacts {
    /// With the indices of their points as keys.
    pub contacts: ArrayVec<Constraint, MAX_REACHED>,
    /// Whether these indices are those of the next step's points, too.
    is_known: bool,
    /// Where their arms are along x when they are found, by which most are told apart, m; infinite in the
    /// lanes beyond the last.
    along: ArrayVec<[f64; LANES], { MAX_REACHED.div_ceil(LANES) }>,
    /// Distances of their points from the other surfaces when they are found, m.
    nearest: ArrayVec<f64, MAX_REACHED>,
    /// Largest motion of any point of the body in the step that meets no other point, m.
    pub room: f64,
    /// Largest depth, m; 0 if nothing overlaps.
    pub depth: f64,
    /// Bounding radius of the body about its centre of mass, m.
    radius: f64,
    /// Indices of the points that the step may bring into contact.
    near: ArrayVec<u16, MAX_REACHED>,
    /// Contacts without which the step is taken again.
    aside: Box<ArrayVec<Constraint, MAX_REACHED>>,
    /// Number of times that the step was taken, but for those since normals had turned.
    taken: u32,
    /// Number of times that it was taken again since normals had turned.
    turned: u32,
    /// Number of measurements of points that are left for taking it again.
    left: u32,
    /// Indices of reserves that are asleep and that the step may reach.
    coming: ArrayVec<u16, MAX_LOOKS>,
}

/// Motion of the body from one step to the next.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StepMotion {
    /// Bound on how far any point of the body has moved since points were last measured, m.
    pub moved: f64,
    /// Distance within which contacts are wanted, m.
    pub reach: f64,
    /// Time of the step, s.
    pub dt: f64,
}

/// Distance within which contacts are wanted in a step of `dt` (s) of a body at a speed (m/s), m. `scale` is
/// that of the workspace.
pub(crate) fn reach_of_step(speed: f64, dt: f64, scale: f64) -> f64 {
    REACH * speed * dt + scale * ACCELERATION * dt.max(MIN_TIME).powi(2)
}

impl ContactGeometry {
    /// The region around the body at a pose in which the points are all that can be touched: objects that it
    /// has left behind no longer bound it by how near they were.
    pub fn bound_at(&self, pose: &Pose) -> MotionBound {
        let MotionBound { room, radius, .. } = self.bound;
        let moved = self.bound.displacement(pose);
        let apart = |far: &FarObject| far.distance(pose.translation) - radius - self.margin;
        let far = self.far.iter().map(|far| (far.room - moved).max(apart(far)));
        let left = far.fold(room + self.beyond - moved, f64::min);
        if left > room - moved { MotionBound { from: *pose, room: left, ..self.bound } } else { self.bound }
    }

    /// Whether no object that may come near moves.
    pub fn is_still(&self) -> bool {
        self.far_speed == 0.0 && self.objects.iter().all(|object| object.is_still())
    }

    /// Copies another geometry.
    pub fn assign(&mut self, found: &Self) {
        let Self { probe, center_of_mass, objects, points, reserves, bound, far, beyond, .. } = self;
        let Self { friction, margin, far_speed, age, .. } = self;
        points.clone_from(&found.points);
        reserves.clone_from(&found.reserves);
        if !Arc::ptr_eq(probe, &found.probe) {
            probe.clone_from(&found.probe);
        }
        (*center_of_mass, *bound) = (found.center_of_mass, found.bound);
        (*friction, *margin, *age) = (found.friction, found.margin, found.age);
        (*far_speed, *beyond) = (found.far_speed, found.beyond);
        far.clone_from(&found.far);
        objects.truncate(found.objects.len());
        let known = objects.len();
        for (object, found) in objects.iter_mut().zip(&found.objects) {
            object.assign(found);
        }
        objects.extend(found.objects[known..].iter().cloned());
    }

    /// The surfaces at their poses, by scene object, with the mesh of the body in the hand at a pose.
    pub fn frames(&self, mesh: &Pose) -> ArrayVec<Frames<'_>, MAX_OBJECTS> {
        let probe = (&*self.probe, mesh);
        self.objects.iter().map(|it| Frames::new(probe, (&it.surface, &it.pose))).collect()
    }

    /// Moves the scene objects on by a time (s), but those that the haptic loop moves otherwise.
    pub fn advance(&mut self, dt: f64) {
        let dt = dt.min(MAX_OBJECT_MOTION - self.age).max(0.0);
        self.age += dt;
        let mut most = self.far_speed * dt;
        for object in &mut self.objects {
            if object.pushed.is_some() || object.speed == 0.0 {
                continue;
            }
            let Pose { translation, rotation } = object.pose;
            let twist = object.motion.twist;
            let turn = DQuat::from_scaled_axis(twist.angular * dt);
            object.pose = Pose {
                translation: turn * translation + twist.linear * dt,
                rotation: (turn * rotation).normalize(),
            };
            object.moved += object.speed * dt;
            most = most.max(object.speed * dt);
        }
        // Each object comes nearer by its own motion only.
        self.bound.room -= most;
    }

    /// Bound on how far an object that the haptic loop moves goes in a step of `dt` (s), m.
    pub fn ahead(&self, dt: f64) -> f64 {
        let pushed = self.objects.iter().filter(|object| object.pushed.is_some());
        pushed.fold(0.0, |most: f64, object| most.max(object.speed * dt))
    }

    /// Whether it has the object of an identifier, as one that the haptic loop moves.
    pub fn moves(&self, id: SceneId) -> bool {
        let is_it = |object: &NearObject| object.pushable.is_some_and(|pushable| pushable.id == id);
        self.objects.iter().any(|object| object.pushed.is_some() && is_it(object))
    }
}

impl FarObject {
    /// Distance of a point from its bounds, m.
    fn distance(&self, point: DVec3) -> f64 {
        let [low, high] = self.bounds;
        let at = self.pose.inverse().transform_point(point);
        at.distance(at.clamp(low, high))
    }
}

impl NearObject {
    /// Its surface at a pose and that of the body in the hand, which are held apart by a margin (m).
    fn frames<'a>(&'a self, probe: (&'a FeatureMesh, &Pose), pose: &Pose, margin: f64) -> Frames<'a> {
        let frames = Frames::new(probe, (&self.surface, pose));
        if self.overlapped { frames.overlapping(margin) } else { frames }
    }

    fn is_still(&self) -> bool {
        self.speed == 0.0 && self.pushable.is_none() && !self.felt_elsewhere
    }

    fn assign(&mut self, found: &Self) {
        let Self { place, surface, pose, before, motion, speed, moved, felt_elsewhere, .. } = self;
        let Self { overlapped, pushable, pushed, on_loan, .. } = self;
        if !Arc::ptr_eq(on_loan, &found.on_loan) {
            // The surface first: what is on loan is kept until then.
            surface.clone_from(&found.surface);
            on_loan.clone_from(&found.on_loan);
        }
        (*place, *pose, *before) = (found.place, found.pose, found.before);
        (*motion, *speed) = (found.motion, found.speed);
        (*moved, *felt_elsewhere, *overlapped) = (found.moved, found.felt_elsewhere, found.overlapped);
        (*pushable, *pushed) = (found.pushable, found.pushed);
    }
}

/// Copies at most so many, those of each object in turn.
pub(crate) fn in_turn<T: Copy>(
    (all, most): (&[T], usize),
    objects: usize,
    object_of: impl Fn(&T) -> u8,
    to: &mut Vec<T>,
) {
    to.clear();
    let all = &all[..all.len().min(most)];
    for object in 0..objects {
        to.extend(all.iter().filter(|one| usize::from(object_of(one)) == object));
    }
}

/// Whether two contacts with an object are with the same plane, to within a distance (m).
fn is_level(a: &Constraint, b: &Constraint, within: f64) -> bool {
    let apart = a.normal.dot(a.arm - b.arm) + a.gap - b.gap;
    apart.abs() < within && a.normal.distance_squared(b.normal) < LEVEL_NORMAL * LEVEL_NORMAL
}

impl StepContacts {
    pub fn clear(&mut self) {
        self.contacts.clear();
        self.along.clear();
        self.nearest.clear();
        self.is_known = true;
        self.room = f64::INFINITY;
        self.depth = 0.0;
        self.near.clear();
        self.aside.clear();
        (self.taken, self.turned, self.left) = (0, 0, MAX_MEASURED);
        self.coming.clear();
    }

    /// Forgets which points the contacts are of; they are found again by their places.
    pub fn forget(&mut self) {
        self.is_known = false;
    }

    /// The index of the contact at a place with a normal, of those with the same object: from the index `own`
    /// on.
    #[inline(always)]
    fn at(&self, own: usize, arm: DVec3, normal: DVec3) -> Option<usize> {
        let same_place = SAME_PLACE * self.radius;
        let is_near = |along: f64| (along - arm.x).abs() < same_place;
        let blocks = self.along.iter().zip(self.contacts.chunks(LANES)).enumerate();
        for (block, (along, contacts)) in blocks.skip(own / LANES) {
            // Without branches, several are compared at once.
            if !along.iter().fold(false, |any, along| any | is_near(*along)) {
                continue;
            }
            let first = block * LANES;
            let is_same = |known: &Constraint| {
                known.arm.distance_squared(arm) < same_place * same_place
                    && known.normal.dot(normal) > SAME_NORMAL
            };
            let others = own.saturating_sub(first);
            let same = contacts.iter().zip(along).skip(others).position(|(known, _)| is_same(known));
            if let Some(index) = same {
                return Some(first + others + index);
            }
        }
        None
    }

    /// Adds the contact of a point at a distance `nearest` (m) from the other surface, or merges it with one
    /// that is the same, of those with its own object: from the index `own` on. The nearest of the points
    /// that meet one place stands for them, as the others may be on leashes elsewhere. Returns whether there
    /// was room for it.
    #[inline(always)]
    fn add(&mut self, own: usize, contact: Constraint, nearest: f64) -> bool {
        if let Some(index) = self.at(own, contact.arm, contact.normal) {
            let (known, least) = (&mut self.contacts[index], &mut self.nearest[index]);
            let gap = known.gap.min(contact.gap);
            if nearest < *least {
                (*known, *least) = (contact, nearest);
                self.along[index / LANES][index % LANES] = contact.arm.x;
            }
            known.gap = gap;
        } else if self.contacts.is_full() {
            return false;
        } else {
            self.nearest.push(nearest);
            self.push(contact);
        }
        true
    }

    #[inline(always)]
    fn push(&mut self, contact: Constraint) {
        let lane = self.contacts.len() % LANES;
        if lane == 0 {
            self.along.push([f64::INFINITY; LANES]);
        }
        if let Some(block) = self.along.last_mut() {
            block[lane] = contact.arm.x;
        }
        self.contacts.push(contact);
    }

    /// The contacts that push, as many as a step finds impulses for. Before a step, and after one that was
    /// refused, more may have one that was taken over.
    pub fn pushing(&self) -> impl Iterator<Item = &Constraint> {
        self.contacts.iter().filter(|contact| contact.impulse != DVec3::ZERO).take(MAX_CONSTRAINTS)
    }

    /// Takes over the impulses of the last step, and the lower coefficient of friction where a contact slid.
    fn take_over(&mut self, before: &Self, friction: &Friction) {
        let mut pushed = ArrayVec::<&Constraint, MAX_CONSTRAINTS>::new();
        pushed.extend(before.pushing());
        // The order is mostly the same: the search goes on from the last one that was found.
        let mut next = 0;
        let near_place = NEAR_PLACE * self.radius;
        for contact in &mut self.contacts {
            let near = |known: &Constraint| {
                known.arm.distance_squared(contact.arm) < near_place * near_place
                    && known.normal.dot(contact.normal) > NEAR_NORMAL
            };
            let is_same = |index: &usize| {
                let known = pushed[*index];
                if before.is_known { known.key == contact.key } else { near(known) }
            };
            let is_next = next < pushed.len() && is_same(&next);
            let found = is_next.then_some(next);
            let found = found.or_else(|| (next..pushed.len()).chain(0..next).find(is_same));
            let Some(index) = found else { continue };
            next = index + 1;
            let known = pushed[index];
            contact.impulse = known.impulse;
            let along = known.impulse.dot(known.normal);
            let across = (known.impulse - known.normal * along).length_squared();
            if along > 0.0 && across >= (MAX_STICKING * known.friction * along).powi(2) {
                contact.friction = friction.dynamic_coefficient;
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use palpate_core::TriMesh;
    use palpate_field::Leash;

    use super::*;

    /// A body that leaves a plate may go on, and may not come back to another place of it, nor go nearer to
    /// other objects.
    #[test]
    fn what_a_body_leaves_behind_does_not_hold_it() {
        let mut made = geometry_at([(DVec3::ZERO, 0.0); 3], 1);
        let half = DVec3::new(0.2, 0.2, 0.01);
        let plate = FarObject { pose: Pose::IDENTITY, bounds: [-half, half], room: 0.02 };
        let from = Pose::from_translation(DVec3::Z * 0.05);
        (made.margin, made.beyond) = (1e-6, 0.5);
        made.bound = MotionBound { from, room: 0.02, step: f64::INFINITY, radius: 0.02 };
        made.far.push(plate);
        let left = |made: &ContactGeometry, at: DVec3| {
            let pose = Pose::from_translation(at);
            let bound = made.bound_at(&pose);
            bound.room - bound.displacement(&pose)
        };
        let [up, aside, away] =
            [DVec3::Z * 0.1, DVec3::new(0.1, 0.0, 0.05), DVec3::Z * 0.5].map(|at| left(&made, at));
        assert!((up - (0.1 - 0.01 - 0.02 - 1e-6)).abs() < 1e-12, "{up} m");
        assert!((aside - (0.05 - 0.01 - 0.02 - 1e-6)).abs() < 1e-12, "{aside} m");
        assert!((away - (0.52 - 0.45)).abs() < 1e-12, "{away} m, for the other objects");
        // From where it is, the surface is known better than by the bounds.
        made.far[0].bounds[1].z = 0.04;
        assert!((left(&made, DVec3::Z * 0.05) - 0.02).abs() < 1e-12);
        made.far.clear();
        made.beyond = 0.0;
        assert!(left(&made, DVec3::Z * 0.1) < 0.0);
    }

    fn tetrahedron() -> Arc<FeatureMesh> {
        let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let mesh = TriMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z], triangles);
        Arc::new(FeatureMesh::new(&mesh.expect("a tetrahedron")))
    }

    /// A geometry with points of three objects in turn, at heights (m), which also are their speeds.
    pub(crate) fn geometry(heights: [f64; 3], count: usize) -> ContactGeometry {
        geometry_at(heights.map(|height| (DVec3::Z * height, height)), count)
    }

    /// A geometry without points of a surface and objects with another one at places (m), with speeds (m/s).
    pub(crate) fn without_points<const N: usize>(
        (probe, surface): (&Arc<FeatureMesh>, &Arc<FeatureMesh>),
        objects: [(DVec3, f64); N],
    ) -> ContactGeometry {
        let object = |(at, speed)| NearObject {
            place: 0,
            surface: Arc::clone(surface),
            pose: Pose::from_translation(at),
            before: Pose::IDENTITY,
            motion: MovingBody::STILL,
            speed,
            moved: 0.0,
            felt_elsewhere: false,
            overlapped: false,
            pushable: None,
            pushed: None,
            on_loan: Arc::default(),
        };
        ContactGeometry {
            probe: Arc::clone(probe),
            center_of_mass: DVec3::ZERO,
            objects: objects.into_iter().map(object).collect(),
            points: Arc::default(),
            reserves: Arc::default(),
            bound: MotionBound::NONE,
            friction: Friction::NONE,
            margin: 0.0,
            far: ArrayVec::new(),
            beyond: 0.0,
            far_speed: 0.0,
            age: 0.0,
        }
    }

    /// A geometry of objects at places (m), with speeds (m/s), and points of each in turn.
    pub(crate) fn geometry_at(objects: [(DVec3, f64); 3], count: usize) -> ContactGeometry {
        let surface = tetrahedron();
        let mut made = without_points((&surface, &surface), objects);
        made.center_of_mass = DVec3::splat(0.25);
        let points: Vec<GuardedPoint> = {
            let frames = made.frames(&Pose::IDENTITY);
            let point = |i: usize| {
                let place = frames[i % 3].own(true).place_near(DVec3::X);
                let leash = Leash { home: frames[i % 3].own(true).position(&place), length: 0.1 };
                let within = (place, leash);
                GuardedPoint::new(within, 0, true, (i % 3) as u8, (&frames[i % 3], 0.0))
            };
            (0..count).map(point).collect()
        };
        in_turn((&points, MAX_POINTS), 3, |point| point.object, Arc::make_mut(&mut made.points));
        made
    }

    /// A place that several points come to is one contact with each object, and not one of all.
    #[test]
    fn contacts_with_different_objects_stay_apart() {
        let contact = |x: f64| Constraint::new(DVec3::X * x, DVec3::NEG_Z, 1e-6);
        for count in [1, LANES - 1, LANES, LANES + 1, 3 * LANES] {
            let mut made = StepContacts { radius: 0.03, ..StepContacts::default() };
            made.clear();
            assert!((0..count).all(|i| made.add(0, contact(i as f64), 2e-6)));
            let last = contact((count - 1) as f64);
            for (gap, nearest, key) in [(2e-6, 1e-6, 1), (0.0, 3e-6, 2)] {
                made.add(count - 1, Constraint { gap, key, ..last }, nearest);
            }
            assert_eq!(made.contacts.len(), count, "{count}: with its own");
            let merged = made.contacts[count - 1];
            assert_eq!((merged.gap, merged.key), (0.0, 1), "{count}: the least gap, and the nearest point");
            made.add(count, last, 0.0);
            assert_eq!(made.contacts.len(), count + 1, "{count}: with another object's");
        }
    }

    /// After a step that was refused, contacts may still have impulses that were taken over, more than a step
    /// finds.
    #[test]
    fn impulses_of_more_contacts_than_a_step_solves_for_are_taken_over() {
        let contacts = |impulse: f64| {
            let mut made = StepContacts::default();
            made.clear();
            for key in 0..2 * MAX_CONSTRAINTS as u16 {
                let contact = Constraint::new(DVec3::X * 1e-3 * f64::from(key), DVec3::NEG_Z, 0.0);
                made.push(Constraint { impulse: DVec3::NEG_Z * impulse, key, ..contact });
            }
            made
        };
        let (before, mut now) = (contacts(1.0), contacts(0.0));
        now.take_over(&before, &Friction::NONE);
        assert_eq!((before.pushing().count(), now.pushing().count()), (MAX_CONSTRAINTS, MAX_CONSTRAINTS));
    }
}
