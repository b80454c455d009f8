//! Scene objects that move (§6.2.2): where they are between the poses that a host sets, and how stiff contacts with them may be.
//!
//! A host sets poses and twists at its own rate, which may be a display's. In between an object moves on with its last twist. A new pose
//! is approached with a constant twist over one interval, so that neither the surface nor the force on it jumps, and contacts see the
//! velocity of the surface that they touch. An object whose host is silent for [`LONGEST`] stands still.
//!
//! A [`DynamicBody`] responds late: an impulse reaches it in a step of its own world, and its new pose reaches the contact loop one more
//! step later. Contacts with it are no stiffer and no more damped than is stable with such a delay, for its effective mass at the
//! contact's point along the normal.

use palpate_core::glam::{DMat3, DVec3};
use palpate_core::{Pose, Twist};
use palpate_dynamics::{ContactParameters, MovingBody};

use crate::scene::SceneId;

/// Time that an object moves on after its host last set its pose, s.
const LONGEST: f64 = 0.05;

/// Poses that are set within this time, s, are one.
const AT_ONCE: f64 = 1e-6;

/// Part of the difference by which the mean interval between poses follows the last one.
const SMOOTHING: f64 = 0.25;

/// With a delay T and an effective mass m, contacts are no stiffer than m (STIFFEST / T)² and no more damped than
/// m MOST_DAMPED / T: a spring that late needs damping of at least k T, and damping that late is stable below π/2 m / T.
const STIFFEST: f64 = 0.25;
const MOST_DAMPED: f64 = 0.5;

/// An object that contacts move, in the host's simulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DynamicBody {
    /// kg.
    pub mass: f64,
    /// About the centre of mass, in the axes of the mesh, kg·m².
    pub inertia: DMat3,
    /// In the mesh's frame, m.
    pub center_of_mass: DVec3,
    /// Time between two steps of the world that moves it, s.
    pub period: f64,
}

impl DynamicBody {
    /// Whether a body can have them.
    pub(crate) fn is_valid(&self) -> bool {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        positive(self.mass)
            && positive(self.period)
            && self.center_of_mass.is_finite()
            && self.inertia.inverse().is_finite()
            && palpate_dynamics::Body::new(self.mass, self.inertia).is_ok()
    }
}

/// A scene object that moves, or that contacts move.
#[derive(Debug)]
pub(crate) struct MovingObject {
    motion: Option<Motion>,
    /// Pose of the mesh's frame and velocity of its origin, if the host has set them since the last step.
    given: Option<(Pose, Twist)>,
    /// The dynamic body, with its inverse inertia.
    body: Option<(DynamicBody, DMat3)>,
    /// Whether contacts push it.
    reacts: bool,
    /// The motion of another session's object that this one follows.
    leader: Option<triple_buffer::Output<(Pose, Twist)>>,
}

/// Motion between two poses of the host.
#[derive(Clone, Copy, Debug)]
struct Motion {
    /// At a time (s), with a twist until another (s).
    pose: Pose,
    time: f64,
    twist: Twist,
    until: f64,
    /// The twist that was last set, when, and the mean time between settings, s.
    given: Twist,
    set_at: f64,
    interval: f64,
}

impl MovingObject {
    /// An object that a host moves.
    pub fn new() -> Self {
        Self { motion: None, given: None, body: None, reacts: false, leader: None }
    }

    /// An object that follows another session's.
    pub fn following(leader: triple_buffer::Output<(Pose, Twist)>, body: DynamicBody) -> Self {
        let mut moving = Self::new();
        moving.leader = Some(leader);
        moving.set_dynamics(Some(body));
        moving.reacts = false;
        moving
    }

    /// Sets the pose of the mesh's frame and the velocity of its origin.
    pub fn set_motion(&mut self, pose: &Pose, twist: &Twist) {
        self.given = Some((*pose, *twist));
    }

    pub fn set_dynamics(&mut self, body: Option<DynamicBody>) {
        self.body = body.map(|body| (body, body.inertia.inverse()));
        self.reacts = self.body.is_some();
    }

    /// Stands still from now on.
    pub fn stop(&mut self) {
        (self.motion, self.given) = (None, None);
    }

    /// Where the mesh's frame is at a time (s); `None` if it has not moved.
    pub fn advance(&mut self, now: f64) -> Option<Pose> {
        if let Some(leader) = &mut self.leader
            && leader.update()
        {
            self.given = Some(*leader.output_buffer_mut());
        }
        let given = self.given.take();
        if self.motion.is_none() && given.is_none() {
            return None;
        }
        let motion = self.motion.as_mut().map(|motion| motion.advance(now));
        match (motion, given) {
            (Some(motion), Some((pose, twist))) => motion.set_motion(&pose, &twist, now),
            (None, Some((pose, twist))) => self.motion = Some(Motion::new(&pose, &twist, now)),
            (_, None) => {}
        }
        self.motion.map(|motion| motion.pose)
    }

    /// Velocity of the mesh's origin, and angular velocity, as contacts see it.
    pub fn twist(&self) -> Twist {
        self.motion.map_or(Twist::ZERO, |motion| motion.twist)
    }

    /// What contacts with it, its mesh's frame being at a pose, are to know of it.
    pub fn moving_body(&self, id: SceneId, pose: &Pose) -> MovingBody {
        let Twist { linear, angular } = self.twist();
        let object = u32::try_from(id.0 + 1).ok().and_then(std::num::NonZeroU32::new);
        MovingBody {
            twist: Twist { linear: linear - angular.cross(pose.translation), angular },
            object: object.filter(|_| self.reacts),
        }
    }

    /// Gains of `count` contacts with it, of which this is one, at a point (m) with a normal, the mesh's frame being at a pose and
    /// contacts being looked for every `interval` (s).
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
        let turn = DMat3::from_quat(pose.rotation);
        let lever = (point - pose.transform_point(*center_of_mass)).cross(normal);
        let along = turn.transpose() * lever;
        let effective = 1.0 / (1.0 / mass + along.dot(*inverse_inertia * along));
        let late = 2.0 * period + if interval > 0.0 { interval } else { 0.0 };
        let share = effective / count.max(1) as f64;
        ContactParameters {
            stiffness: parameters.stiffness.min(share * (STIFFEST / late).powi(2)),
            damping: parameters.damping.min(share * MOST_DAMPED / late),
            ..*parameters
        }
    }
}

impl Motion {
    fn new(pose: &Pose, twist: &Twist, now: f64) -> Self {
        Self { pose: *pose, time: now, twist: *twist, until: now, given: *twist, set_at: now, interval: 0.0 }
    }

    fn advance(&mut self, now: f64) -> &mut Self {
        if self.time < self.until {
            let then = now.min(self.until);
            self.move_to(then);
        }
        if now > self.time {
            self.twist = self.given;
            let end = self.set_at + LONGEST;
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

    /// Approaches the pose where the new twist takes the object.
    fn set_motion(&mut self, pose: &Pose, twist: &Twist, now: f64) {
        let since = now - self.set_at;
        if since > LONGEST {
            *self = Self::new(pose, twist, now);
            return;
        }
        if since > AT_ONCE {
            // A host that is late once is not late again: a way that is to be gone in the shortest interval is gone too fast.
            let share = if self.interval > 0.0 { SMOOTHING } else { 1.0 };
            self.interval += share * (since - self.interval);
        }
        (self.given, self.set_at) = (*twist, now);
        if self.interval > 0.0 {
            let target = pose.moved(twist, self.interval);
            let way = target.translation - self.pose.translation;
            let turn = self.pose.rotation_vector_to(&target);
            let rate = 1.0 / self.interval;
            self.twist = Twist { linear: way * rate, angular: turn * rate };
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

    /// Set at 60 Hz and looked at 1000 times a second, both a little irregularly.
    #[test]
    fn a_motion_is_followed_without_steps() {
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
                moving.set_motion(&pose(now), &twist(now));
                next += 1.0 / 60.0;
            }
            let found = moving.advance(now).expect("it moves");
            let off = found.translation.distance(pose(now).translation);
            // An interval is a way of 5 mm; what it turns by meanwhile, 5 % of that.
            assert!(off < 2e-4, "{now} s: {off} m off");
            if let Some(last) = last {
                let went = found.translation.distance(last.translation);
                assert!(went < 1.5 * 1.4e-3 * radius * rate, "{now} s: a step of {went} m");
            }
            let speed = moving.twist().linear.length();
            assert!((speed - radius * rate).abs() < 0.05 * radius * rate, "{now} s: {speed} m/s");
            last = Some(found);
        }
        // Without a host it stops.
        let end = moving.advance(2.5).expect("it moved");
        let later = moving.advance(3.0).expect("it moved");
        assert_eq!((later.translation, moving.twist()), (end.translation, Twist::ZERO));
    }

    /// Poses at 60 Hz of which every other one is set 12 ms late: two within 5 ms are no reason to hurry.
    #[test]
    fn a_host_that_is_late_by_turns_makes_no_spikes_of_velocity() {
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
    fn an_object_that_no_host_moves_stays() {
        let mut moving = MovingObject::new();
        assert_eq!(moving.advance(1.0), None);
        assert_eq!(moving.twist(), Twist::ZERO);
    }

    #[test]
    fn light_objects_are_touched_softly() {
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
        // 10 mm off the centre of mass half of the mass is felt.
        let aside = at(&moving, DVec3::ZERO);
        assert!((aside.stiffness - 0.5 * centre).abs() < 1e-9, "{aside:?}");
        assert!((aside.damping - 0.5 * 0.01 * 0.5 / 0.003).abs() < 1e-9, "{aside:?}");
    }
}
