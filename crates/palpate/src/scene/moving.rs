//! Scene objects that move (§6.2.2): their motion between the poses that a host sets, and the stiffness of
//! contacts with them.
//!
//! A host sets poses and twists at its own rate, which may be that of a display. In between, an object
//! continues with its last twist. It approaches a new pose with a constant twist over one interval, so that
//! neither the surface nor the contact force jumps, and contacts see the velocity of the surface that they
//! touch. If the host sets nothing for [`MAX_EXTRAPOLATION`], the object stands still.
//!
//! A [`DynamicBody`] responds late: an impulse reaches it in a step of its own world, and its new pose
//! reaches the contact loop one more step later. Where contacts are constraints, the haptic loop moves it
//! until then ([`PushedBody`](palpate_dynamics::PushedBody)). Stiffness and damping of penalty contacts with
//! it are limited to values that are stable with this delay, for its effective mass at the contact point
//! along the normal.

use palpate_core::glam::{DMat3, DVec3};
use palpate_core::{Pose, Twist};
use palpate_dynamics::{Body, ContactParameters, HostState, MovingBody};

use crate::scene::SceneId;

/// Time for which an object continues after its host last set its pose, s. A longer time lets it run further
/// away when the host stops; a shorter one stops it between the poses of a slow host.
const MAX_EXTRAPOLATION: f64 = 0.05;

/// Interval within which two poses count as set at the same time, s. It keeps a division by almost zero from
/// giving a huge twist.
const MIN_INTERVAL: f64 = 1e-6;

/// Weight of the last interval between poses in their mean. With a larger weight, a single late pose changes
/// the velocity more.
const INTERVAL_WEIGHT: f64 = 0.25;

/// Largest natural frequency of a contact with a dynamic body, times the delay T: k ≤ m (MAX_FREQUENCY / T)²
/// for an effective mass m. A spring with a delay T needs damping of at least k T; much stiffer contacts
/// would oscillate.
const MAX_FREQUENCY: f64 = 0.25;
/// Largest damping of a contact with a dynamic body, times T / m: b ≤ m MAX_DAMPING / T. Damping with a delay
/// T is stable below π/2 m / T.
const MAX_DAMPING: f64 = 0.5;

/// Time from an impulse on a dynamic body to the host's answer, in steps of the host and of the contact loop.
/// With less, the haptic loop takes answers for later ones; with more, it is slower to see whether the body
/// gives way.
const ANSWER: f64 = 1.25;

/// Time after which a host that says nothing means that the body is as it was, in its steps.
const SILENCE: f64 = 3.0;

/// Mass properties of a scene object that contacts push, in the host's simulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DynamicBody {
    /// Mass, kg.
    pub mass: f64,
    /// Inertia about the centre of mass, in the axes of the mesh, kg·m².
    pub inertia: DMat3,
    /// Centre of mass in the mesh's frame, m.
    pub center_of_mass: DVec3,
    /// Acceleration by gravity and other forces that do not come from contacts, m/s², world axes. A wrong one
    /// makes contacts with a body that falls, or lies in the hand, restless.
    pub gravity: DVec3,
    /// Time between two steps of the world that moves the body, s.
    pub period: f64,
}

impl DynamicBody {
    /// Whether a rigid body can have these properties.
    pub(crate) fn is_valid(&self) -> bool {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        positive(self.mass)
            && positive(self.period)
            && self.center_of_mass.is_finite()
            && self.gravity.is_finite()
            && self.inertia.inverse().is_finite()
            && palpate_dynamics::Body::new(self.mass, self.inertia).is_ok()
    }
}

/// Scene object that a host moves, or that contacts push.
#[derive(Debug)]
pub(crate) struct MovingObject {
    motion: Option<Motion>,
    /// Pose of the mesh's frame and velocity of its origin, if the host has set them since the last step.
    given: Option<(Pose, Twist)>,
    /// What the host said last, and before that.
    reported: Option<Reported>,
    reported_before: Option<Reported>,
    /// Pose and velocity to which the haptic loop has moved it.
    predicted: Option<(Pose, Twist)>,
    /// Dynamic body, with its inverse inertia.
    body: Option<(DynamicBody, DMat3)>,
    /// Motion of the object in another hand that this one is.
    leader: Option<triple_buffer::Output<HandMotion>>,
}

/// Pose of an object's mesh frame and velocity of its origin at a time (s), as its host said.
#[derive(Clone, Copy, Debug)]
struct Reported {
    time: f64,
    pose: Pose,
    twist: Twist,
}

/// Motion of the object in a hand, for another session.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HandMotion {
    /// Pose of the mesh's frame.
    pub pose: Pose,
    /// Velocity of its origin, and angular velocity.
    pub twist: Twist,
    /// Acceleration of the centre of mass, and angular one, by all but the other session's contacts: m/s² and
    /// rad/s².
    pub load: Twist,
}

/// What the haptic loop needs to move an object that contacts push.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pushable {
    pub id: SceneId,
    pub body: Body,
    /// Centre of mass in the mesh's frame, m.
    pub center: DVec3,
    pub host_state: HostState,
    /// Whether the object was put where it is, rather than moved there.
    pub is_placed: bool,
    /// Whether it is in another hand, whose haptic loop tells more.
    pub in_hand: bool,
    /// Time from an impulse to the host's answer, s.
    pub delay: f64,
    /// Acceleration by other forces, m/s² and rad/s².
    pub load: Twist,
    /// Its acceleration between the last two states that its host told, m/s² and rad/s². A table holds it
    /// where this is not the load.
    pub acceleration: Option<Twist>,
    /// Bounding radius about the centre of mass, m.
    pub radius: f64,
}

/// Motion between two poses of the host.
#[derive(Clone, Copy, Debug)]
struct Motion {
    /// Pose at `time` (s); the object has `twist` until the time `until` (s).
    pose: Pose,
    time: f64,
    twist: Twist,
    until: f64,
    /// Twist that the host last set, the time at which it was set (s), and the mean interval between poses
    /// (s).
    given: Twist,
    set_at: f64,
    interval: f64,
}

impl MovingObject {
    /// Makes an object that a host moves.
    pub fn new() -> Self {
        Self {
            motion: None,
            given: None,
            reported: None,
            reported_before: None,
            predicted: None,
            body: None,
            leader: None,
        }
    }

    /// Makes an object that is in another hand. Without a body it is one that is only waited for: the other
    /// session finds the contacts with it.
    pub fn in_hand(leader: triple_buffer::Output<HandMotion>, body: Option<DynamicBody>) -> Self {
        let mut moving = Self::new();
        moving.leader = Some(leader);
        moving.set_dynamics(body);
        moving
    }

    /// Whether the object is in another hand.
    pub fn is_in_hand(&self) -> bool {
        self.leader.is_some()
    }

    /// Whether another session finds the contacts with the object.
    pub fn is_felt_elsewhere(&self) -> bool {
        self.leader.is_some() && self.body.is_none()
    }

    /// Sets the pose of the mesh's frame and the velocity of its origin, as they were at a time (s).
    pub fn set_motion(&mut self, pose: &Pose, twist: &Twist, time: f64) {
        self.given = Some((*pose, *twist));
        self.reported_before = self.reported.replace(Reported { time, pose: *pose, twist: *twist });
    }

    /// Takes over the motion that the haptic loop has found, or no longer does.
    pub fn set_predicted(&mut self, predicted: Option<(Pose, Twist)>) {
        self.predicted = predicted;
    }

    /// The object as the haptic loop moves it, with its mesh's frame at a pose, a bounding radius about its
    /// centre of mass (m) and contacts found every `interval` (s), at a time (s); `None` if contacts do not
    /// push it.
    pub fn pushable(
        &self,
        id: SceneId,
        (pose, radius): (&Pose, f64),
        (interval, now): (f64, f64),
    ) -> Option<Pushable> {
        let (dynamics, _) = self.body.as_ref()?;
        let DynamicBody { mass, inertia, center_of_mass, gravity, period } = *dynamics;
        let never = Reported { time: f64::NEG_INFINITY, pose: *pose, twist: Twist::ZERO };
        let mut told = self.reported.unwrap_or(never);
        let mut acceleration = self.reported_before.map(|before| told.acceleration_since(&before, dynamics));
        if self.reported.is_some() && now - told.time > SILENCE * period {
            // No newer state: the last one is extrapolated, and then the object stands.
            told = told.extrapolated(now - period);
            acceleration = Some(Twist::ZERO);
        }
        let Reported { time, pose, .. } = told;
        Some(Pushable {
            id,
            body: Body::new(mass, inertia).ok()?,
            center: center_of_mass,
            host_state: HostState {
                time,
                pose: pose * Pose::from_translation(center_of_mass),
                twist: told.twist_of(center_of_mass),
            },
            is_placed: self.reported.is_none(),
            in_hand: self.leader.is_some(),
            delay: ANSWER * (period + if self.leader.is_some() { period } else { interval.max(0.0) }),
            load: Twist::new(gravity, DVec3::ZERO),
            acceleration,
            radius,
        })
    }

    /// Whether contacts move an object of less than a mass (kg), at once or in another session.
    pub fn is_lighter(&self, mass: f64) -> bool {
        self.body.is_some_and(|(body, _)| body.mass < mass)
    }

    /// Centre of mass in the mesh's frame of an object that contacts push, m.
    pub fn center_of_mass(&self) -> Option<DVec3> {
        self.body.map(|(body, _)| body.center_of_mass)
    }

    pub fn set_dynamics(&mut self, body: Option<DynamicBody>) {
        self.body = body.map(|body| (body, body.inertia.inverse()));
    }

    /// Stops the object where it is.
    pub fn stop(&mut self) {
        (self.motion, self.given, self.predicted) = (None, None, None);
        (self.reported, self.reported_before) = (None, None);
    }

    /// Pose of the mesh's frame at a time (s); `None` if the host has never moved it.
    pub fn advance(&mut self, now: f64) -> Option<Pose> {
        if let Some(leader) = &mut self.leader
            && leader.update()
        {
            let HandMotion { pose, twist, .. } = *leader.output_buffer();
            self.reported = Some(Reported { time: now, pose, twist });
        }
        if self.leader.is_some() && self.predicted.is_none() {
            // It is told as often as it moves.
            self.predicted = self.reported.map(|told| (told.pose, told.twist));
        }
        let given = self.given.take();
        if self.motion.is_none() && given.is_none() {
            return self.predicted.map(|(pose, _)| pose);
        }
        let motion = self.motion.as_mut().map(|motion| motion.advance(now));
        match (motion, given) {
            (Some(motion), Some((pose, twist))) => motion.set_motion(&pose, &twist, now),
            (None, Some((pose, twist))) => self.motion = Some(Motion::new(&pose, &twist, now)),
            (_, None) => {}
        }
        let predicted = self.predicted.map(|(pose, _)| pose);
        predicted.or(self.motion.map(|motion| motion.pose))
    }

    /// Velocity of the mesh's origin, and angular velocity, as contacts see it.
    pub fn twist(&self) -> Twist {
        let predicted = self.predicted.map(|(_, twist)| twist);
        predicted.or(self.motion.map(|motion| motion.twist)).unwrap_or(Twist::ZERO)
    }

    /// Motion of the object as contacts use it, with its mesh's frame at a pose: the twist at the world's
    /// origin, and the number of the object if reactions on it are reported.
    pub fn moving_body(&self, id: SceneId, pose: &Pose) -> MovingBody {
        let Twist { linear, angular } = self.twist();
        let object = u32::try_from(id.0 + 1).ok().and_then(std::num::NonZeroU32::new);
        MovingBody {
            twist: Twist { linear: linear - angular.cross(pose.translation), angular },
            object: object.filter(|_| self.body.is_some()),
        }
    }

    /// Limits the gains of one of `count` contacts with the object, at a point (m) with a normal. The mesh's
    /// frame is at `pose`, and contacts are searched every `interval` (s).
    pub fn limited_gains(
        &self,
        parameters: &ContactParameters,
        pose: &Pose,
        (point, normal): (DVec3, DVec3),
        count: usize,
        interval: f64,
    ) -> ContactParameters {
        let Some((DynamicBody { mass, center_of_mass, period, .. }, inverse_inertia)) = &self.body else {
            return *parameters;
        };
        // Effective mass at the point along the normal: 1 / m_eff = 1 / m + (r × n)ᵀ I⁻¹ (r × n), in the
        // mesh's axes.
        let rotation = DMat3::from_quat(pose.rotation);
        let lever = (point - pose.transform_point(*center_of_mass)).cross(normal);
        let lever = rotation.transpose() * lever;
        let effective = 1.0 / (1.0 / mass + lever.dot(*inverse_inertia * lever));
        let delay = 2.0 * period + if interval > 0.0 { interval } else { 0.0 };
        let share = effective / count.max(1) as f64;
        ContactParameters {
            stiffness: parameters.stiffness.min(share * (MAX_FREQUENCY / delay).powi(2)),
            damping: parameters.damping.min(share * MAX_DAMPING / delay),
            ..*parameters
        }
    }
}

impl Reported {
    /// The state at a time (s) if its host says nothing more: it moves on for a while, and then stands.
    fn extrapolated(&self, time: f64) -> Self {
        let pose = self.pose.moved(&self.twist, (time - self.time).clamp(0.0, MAX_EXTRAPOLATION));
        let twist = if time - self.time < MAX_EXTRAPOLATION { self.twist } else { Twist::ZERO };
        Self { time, pose, twist }
    }

    /// Velocity of a centre of mass in the mesh's frame (m), and angular velocity.
    fn twist_of(&self, center_of_mass: DVec3) -> Twist {
        let arm = self.pose.rotation * center_of_mass;
        Twist::new(self.twist.velocity_at(arm), self.twist.angular)
    }

    /// Mean acceleration of the centre of mass since an earlier state, and angular one. Two states that come
    /// at once are a step of the host's apart.
    fn acceleration_since(&self, before: &Self, body: &DynamicBody) -> Twist {
        let rate = 1.0 / (self.time - before.time).max(body.period);
        let [now, then] = [self, before].map(|told| told.twist_of(body.center_of_mass));
        Twist::new((now.linear - then.linear) * rate, (now.angular - then.angular) * rate)
    }
}

impl Motion {
    fn new(pose: &Pose, twist: &Twist, now: f64) -> Self {
        Self { pose: *pose, time: now, twist: *twist, until: now, given: *twist, set_at: now, interval: 0.0 }
    }

    /// Moves the object to the time `now` (s): with the approaching twist until `until`, with the host's
    /// twist after that, and not at all once the host has been silent for [`MAX_EXTRAPOLATION`].
    fn advance(&mut self, now: f64) -> &mut Self {
        if self.time < self.until {
            let then = now.min(self.until);
            self.move_to(then);
        }
        if now > self.time {
            self.twist = self.given;
            let end = self.set_at + MAX_EXTRAPOLATION;
            if now <= end {
                self.move_to(now);
            } else {
                self.move_to(end.max(self.time));
                (self.twist, self.time) = (Twist::ZERO, now);
            }
        }
        self
    }

    fn move_to(&mut self, time: f64) {
        self.pose = self.pose.moved(&self.twist, time - self.time);
        self.time = time;
    }

    /// Approaches the pose that the object will have one interval after the given pose.
    fn set_motion(&mut self, pose: &Pose, twist: &Twist, now: f64) {
        let since = now - self.set_at;
        if since > MAX_EXTRAPOLATION {
            *self = Self::new(pose, twist, now);
            return;
        }
        if since > MIN_INTERVAL {
            // The mean interval, not the last one: two poses that come close together because the first was
            // late would otherwise be approached far too fast.
            let weight = if self.interval > 0.0 { INTERVAL_WEIGHT } else { 1.0 };
            self.interval += weight * (since - self.interval);
        }
        (self.given, self.set_at) = (*twist, now);
        if self.interval > 0.0 {
            let target = pose.moved(twist, self.interval);
            let shift = target.translation - self.pose.translation;
            let turn = self.pose.rotation_vector_to(&target);
            let rate = 1.0 / self.interval;
            self.twist = Twist { linear: shift * rate, angular: turn * rate };
            self.until = now + self.interval;
        } else {
            *self = Self::new(pose, twist, now);
        }
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DQuat;

    use super::*;

    /// Poses are set at 60 Hz and read at 1 kHz, both a little irregularly.
    #[test]
    fn motion_between_host_poses_is_smooth() {
        let (radius, rate) = (0.1, 3.0);
        let pose = |t: f64| {
            let turn = DQuat::from_rotation_z(rate * t);
            Pose::new(turn * DVec3::X * radius, turn)
        };
        let twist = |t: f64| {
            let angular = DVec3::Z * rate;
            Twist { linear: angular.cross(pose(t).translation), angular }
        };
        let mut moving = MovingObject::new();
        let (mut next, mut last) = (0.0, None::<Pose>);
        for step in 0..2000 {
            let now = f64::from(step) * 1e-3 + 2e-4 * (f64::from(step) * 1.7).sin();
            if now >= next {
                moving.set_motion(&pose(now), &twist(now), now);
                next += 1.0 / 60.0;
            }
            let found = moving.advance(now).expect("it moves");
            let off = found.translation.distance(pose(now).translation);
            // The object moves by 5 mm per interval; the bound is 4 % of that.
            assert!(off < 2e-4, "{now} s: {off} m off");
            if let Some(last) = last {
                let moved = found.translation.distance(last.translation);
                assert!(moved < 1.5 * 1.4e-3 * radius * rate, "{now} s: a step of {moved} m");
            }
            let speed = moving.twist().linear.length();
            assert!((speed - radius * rate).abs() < 0.05 * radius * rate, "{now} s: {speed} m/s");
            last = Some(found);
        }
        // It stops when the host is silent.
        let end = moving.advance(2.5).expect("it moved");
        let later = moving.advance(3.0).expect("it moved");
        assert_eq!((later.translation, moving.twist()), (end.translation, Twist::ZERO));
    }

    /// Every other pose at 60 Hz is set 12 ms late, so that two come within 5 ms.
    #[test]
    fn late_poses_of_a_host_do_not_cause_velocity_spikes() {
        let speed = 0.3;
        let mut moving = MovingObject::new();
        let mut fastest = 0.0_f64;
        let mut picture = 0;
        for step in 0..1000 {
            let now = 1e-3 * f64::from(step);
            let due = f64::from(picture) / 60.0;
            if now >= due + if picture % 2 == 1 { 0.012 } else { 0.0 } {
                moving.set_motion(
                    &Pose::from_translation(DVec3::X * speed * due),
                    &Twist::new(DVec3::X * speed, DVec3::ZERO),
                    now,
                );
                picture += 1;
            }
            moving.advance(now);
            if step > 200 {
                fastest = fastest.max(moving.twist().linear.length());
            }
        }
        assert!(fastest < 1.5 * speed, "{fastest} m/s of an object that moves at {speed} m/s");
    }

    #[test]
    fn an_object_without_host_poses_stays() {
        let mut moving = MovingObject::new();
        assert_eq!(moving.advance(1.0), None);
        assert_eq!(moving.twist(), Twist::ZERO);
    }

    #[test]
    fn gains_of_contacts_with_light_bodies_are_limited() {
        let parameters = ContactParameters {
            stiffness: 2000.0,
            damping: 30.0,
            tolerance: 1e-4,
            friction: palpate_dynamics::Friction::NONE,
        };
        let body = DynamicBody {
            mass: 0.01,
            inertia: DMat3::from_diagonal(DVec3::splat(1e-6)),
            center_of_mass: DVec3::X * 0.01,
            gravity: DVec3::ZERO,
            period: 1e-3,
        };
        let mut moving = MovingObject::new();
        let at = |moving: &MovingObject, point| {
            moving.limited_gains(&parameters, &Pose::IDENTITY, (point, DVec3::Z), 1, 1e-3)
        };
        assert_eq!(at(&moving, DVec3::ZERO), parameters);
        moving.set_dynamics(Some(body));
        let centre = at(&moving, DVec3::X * 0.01).stiffness;
        assert!((centre - 0.01 * (0.25_f64 / 0.003).powi(2)).abs() < 1e-9, "{centre}");
        // The effective mass 10 mm off the centre of mass is half the mass.
        let aside = at(&moving, DVec3::ZERO);
        assert!((aside.stiffness - 0.5 * centre).abs() < 1e-9, "{aside:?}");
        assert!((aside.damping - 0.5 * 0.01 * 0.5 / 0.003).abs() < 1e-9, "{aside:?}");
    }
}
