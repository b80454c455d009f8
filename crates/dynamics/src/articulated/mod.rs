//! A grasped tool of two rigid bodies with one hinge, as scissors or forceps: seven degrees of freedom
//! (§6.2.3).
//!
//! The dissertation sketches it for sinus surgery: the grasped object is "two rigid bodies with a 1-DoF
//! articulation", the collision response is unchanged, and the rigid body simulation and the virtual
//! coupling are modified. Here the first body is held by a [`VirtualCoupling`](crate::VirtualCoupling), like
//! a single body, and the hinge by a spring and damper to the gripper's angle
//! ([`GripperCoupling`]), whose reaction is the torque for the gripper.
//!
//! Coordinates are those of the joint-coordinate form (Featherstone, *Rigid Body Dynamics Algorithms*, 2008,
//! chapters 3 and 6): a placement of the first body and the hinge's angle q, so that the bodies cannot come
//! apart. With the hinge's axis e (unit, out of the first body), b the second body's centre of mass from the
//! hinge, d that from the first's, μ_i = m_i/(m_1 + m_2), and c_1 = −μ_2 d, c_2 = μ_1 d the centres of mass
//! from the tool's own, all in world axes, the bodies' velocities are
//!
//! v_1 = V + ω × c_1 − μ_2 (e × b) q̇,  ω_1 = ω,  v_2 = V + ω × c_2 + μ_1 (e × b) q̇,  ω_2 = ω + e q̇,
//!
//! with V the velocity of the tool's centre of mass. In (V, ω, q̇) the linear momentum depends on V alone,
//! which makes its conservation exact ([`articulated_step`]).

mod constrained;
mod coordinates;
mod gripper;
mod inertia;
mod linkage;
mod step;
mod tool_system;

use glam::{DMat3, DQuat, DVec3};
use palpate_core::{Pose, Twist};

use crate::body::{Body, BodyState};
use inertia::CompositeInertia;
use linkage::Linkage;

pub use constrained::{ConstrainedToolStep, constrained_articulated_step};
pub use gripper::{GripperCoupling, GripperMotion};
pub use step::{ArticulatedFrame, ArticulatedStep, articulated_step};
pub use tool_system::MAX_ARTICULATED_SOLVES;

/// Range of a hinge, and the stiffness of its stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// Smallest angle, rad; −∞ for none.
    pub low: f64,
    /// Largest angle, rad; ∞ for none.
    pub high: f64,
    /// Stiffness of the stops, N·m/rad: beyond its limit the hinge yields by the torque on it divided by the
    /// stiffness. Stops have no damper, whose torque would jump when they close; the implicit step damps
    /// stops much stiffer than J/h².
    pub stiffness: f64,
}

/// The hinge of a tool. Its axis is the z axis of a frame that each body has; at angle 0 the two frames
/// coincide, and the second body turns about z by the angle, right-handed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// The hinge's frame in the first body's axes, from its centre of mass (m).
    pub in_first: Pose,
    /// The hinge's frame in the second body's axes, from its centre of mass (m).
    pub in_second: Pose,
    /// Range of the hinge.
    pub limits: JointLimits,
}

/// Reason why a joint was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum JointError {
    /// A frame of the hinge is not a rigid placement.
    #[error(
        "the hinge's frame in the {body} body is {pose:?}; it must be finite, with a quaternion of unit length"
    )]
    Frame {
        /// Which body: "first" or "second".
        body: &'static str,
        /// The frame given.
        pose: Pose,
    },
    /// The limits allow no angle.
    #[error("the hinge's limits are {low} to {high} rad; the first must not exceed the second, nor be NaN")]
    Limits {
        /// Smallest angle given, rad.
        low: f64,
        /// Largest angle given, rad.
        high: f64,
    },
    /// The stiffness of the stops is negative or not finite.
    #[error("the hinge's stops have a stiffness of {stiffness} N·m/rad; give a finite one, 0 or more")]
    Stops {
        /// Stiffness given, N·m/rad.
        stiffness: f64,
    },
}

/// Mass and inertia of two bodies, and the hinge that joins them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ArticulatedBody {
    /// The body that the device holds.
    pub first: Body,
    /// The body that turns against it.
    pub second: Body,
    /// Hinge between the two bodies.
    pub joint: Joint,
}

/// State of a tool of two bodies: its seven coordinates and velocities.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArticulatedState {
    /// State of the first body.
    pub first: BodyState,
    /// Angle q of the hinge, rad.
    pub angle: f64,
    /// Rate q̇ of the angle, rad/s.
    pub rate: f64,
}

impl ArticulatedState {
    /// A state at rest.
    pub const fn at_rest(first: Pose, angle: f64) -> Self {
        Self { first: BodyState::at_rest(first), angle, rate: 0.0 }
    }

    /// Whether the pose is a rigid placement and every number is finite.
    pub fn is_valid(&self) -> bool {
        self.first.is_valid() && self.angle.is_finite() && self.rate.is_finite()
    }
}

/// −μ_2 and μ_1: shares of e × b q̇ in the velocities of the bodies' centres of mass.
type Shares = [f64; 2];

impl ArticulatedBody {
    /// Joins two bodies.
    ///
    /// # Errors
    /// If a frame of the hinge is not a rigid placement, its limits allow no angle, or its stops' stiffness
    /// is negative or not finite.
    pub fn new(first: Body, second: Body, joint: Joint) -> Result<Self, JointError> {
        for (body, pose) in [("first", joint.in_first), ("second", joint.in_second)] {
            if !pose.is_valid() {
                return Err(JointError::Frame { body, pose });
            }
        }
        let JointLimits { low, high, stiffness } = joint.limits;
        if low.is_nan() || high.is_nan() || low > high || low == f64::INFINITY || high == f64::NEG_INFINITY {
            return Err(JointError::Limits { low, high });
        }
        if !(stiffness.is_finite() && stiffness >= 0.0) {
            return Err(JointError::Stops { stiffness });
        }
        Ok(Self { first, second, joint })
    }

    /// Mass of both bodies, kg.
    pub fn mass(&self) -> f64 {
        self.first.mass + self.second.mass
    }

    /// The second body's pose in the frame of the first (its axes, from its centre of mass) at an angle
    /// (rad).
    pub fn second_in_first(&self, angle: f64) -> Pose {
        let turned = Pose::new(DVec3::ZERO, DQuat::from_rotation_z(angle));
        self.joint.in_first * turned * self.joint.in_second.inverse()
    }

    /// State of the second body.
    pub fn second(&self, state: &ArticulatedState) -> BodyState {
        let first = &state.first;
        let linkage = self.linkage(first.pose.rotation, state.angle);
        let from_first = linkage.centres[1] - linkage.centres[0];
        BodyState {
            pose: Pose::new(first.pose.translation + from_first, linkage.second),
            twist: Twist {
                linear: first.twist.velocity_at(from_first) + linkage.sweep * state.rate,
                angular: first.twist.angular + linkage.axis * state.rate,
            },
        }
    }

    /// The tool with its hinge held at an angle (rad), as one body in the first body's axes, and its centre
    /// of mass from the first body's, in the same axes (m).
    pub fn composite(&self, angle: f64) -> (Body, DVec3) {
        let linkage = self.linkage(DQuat::IDENTITY, angle);
        let inertia = self.inertia(&self.first.inertia, &linkage).whole;
        (Body { mass: self.mass(), inertia }, -linkage.centres[0])
    }

    /// Inertia of the second body about the hinge, kg·m², which turns when the first is held.
    pub fn second_about_hinge(&self) -> f64 {
        let axis = self.joint.in_second.rotation * DVec3::Z;
        axis.dot(self.second.inertia_about(self.joint.in_second.translation) * axis)
    }

    /// Kinetic energy at a state, J.
    pub fn kinetic_energy(&self, state: &ArticulatedState) -> f64 {
        self.first.kinetic_energy(&state.first) + self.second.kinetic_energy(&self.second(state))
    }

    /// Linear momentum (kg·m/s), and angular momentum about the tool's centre of mass (kg·m²/s), in world
    /// axes.
    pub fn momenta(&self, state: &ArticulatedState) -> (DVec3, DVec3) {
        let second = self.second(state);
        let linear = state.first.twist.linear * self.first.mass + second.twist.linear * self.second.mass;
        let centre = (state.first.pose.translation * self.first.mass
            + second.pose.translation * self.second.mass)
            / self.mass();
        let about = |body: &Body, state: &BodyState| {
            let arm = state.pose.translation - centre;
            arm.cross(state.twist.linear * body.mass) + body.angular_momentum(state)
        };
        (linear, about(&self.first, &state.first) + about(&self.second, &second))
    }

    /// The bodies' relative placement with the first one's axes turned to `rotation`.
    fn linkage(&self, rotation: DQuat, angle: f64) -> Linkage {
        let Joint { in_first, in_second, .. } = &self.joint;
        let hinge = rotation * in_first.rotation * DQuat::from_rotation_z(angle);
        let second = (hinge * in_second.rotation.conjugate()).normalize();
        let axis = rotation * (in_first.rotation * DVec3::Z);
        let from_hinge = -(second * in_second.translation);
        let from_first = rotation * in_first.translation + from_hinge;
        let [first_share, second_share] = self.shares();
        Linkage {
            second,
            axis,
            centres: [from_first * first_share, from_first * second_share],
            sweep: axis.cross(from_hinge),
        }
    }

    /// −μ_2 and μ_1.
    fn shares(&self) -> Shares {
        let mass = self.mass();
        [-self.second.mass / mass, self.first.mass / mass]
    }

    /// The inertia in the axes of a linkage, given the first body's in them.
    fn inertia(&self, first: &DMat3, linkage: &Linkage) -> CompositeInertia {
        let turn = DMat3::from_quat(linkage.second);
        let second = turn * self.second.inertia * turn.transpose();
        let reduced = self.first.mass * self.second.mass / self.mass();
        CompositeInertia::new(first, second, reduced, linkage)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::differences::{random_pose, random_twist};

    /// Two bodies of uneven shape with a hinge anywhere, without limits.
    pub(super) fn random_tool(rng: &mut StdRng, mass: f64) -> ArticulatedBody {
        let mut body = || {
            let mass = mass * rng.random_range(0.3..1.0);
            let squares =
                DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.1..1.0) * 4e-4 * mass));
            let moments = DVec3::new(squares.y + squares.z, squares.z + squares.x, squares.x + squares.y);
            let turn = DMat3::from_quat(random_pose(rng, 1.0).rotation);
            let inertia = turn * DMat3::from_diagonal(moments) * turn.transpose();
            Body::new(mass, inertia).unwrap()
        };
        let (first, second) = (body(), body());
        let limits = JointLimits { low: f64::NEG_INFINITY, high: f64::INFINITY, stiffness: 0.0 };
        let joint = Joint { in_first: random_pose(rng, 0.05), in_second: random_pose(rng, 0.05), limits };
        ArticulatedBody::new(first, second, joint).unwrap()
    }

    pub(super) fn random_state(rng: &mut StdRng) -> ArticulatedState {
        let first = BodyState { pose: random_pose(rng, 0.5), twist: random_twist(rng, 0.3, 5.0) };
        ArticulatedState { first, angle: rng.random_range(-2.0..2.0), rate: rng.random_range(-5.0..5.0) }
    }

    #[test]
    fn the_second_body_turns_about_the_hinge() {
        let seed = 111;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..200 {
            let tool = random_tool(&mut rng, 0.1);
            let state = random_state(&mut rng);
            let second = tool.second(&state);
            let expected = state.first.pose * tool.second_in_first(state.angle);
            assert!(
                (second.pose.translation - expected.translation).length() < 1e-14,
                "seed {seed}, case {case}"
            );
            assert!(second.pose.rotation_vector_to(&expected).length() < 1e-14, "seed {seed}, case {case}");
            let hinge = second.pose * tool.joint.in_second;
            let wanted = state.first.pose * tool.joint.in_first;
            assert!((hinge.translation - wanted.translation).length() < 1e-14, "seed {seed}, case {case}");
            // Its twist is the derivative of its pose.
            let after = |time: f64| {
                let first =
                    BodyState { pose: state.first.pose.moved(&state.first.twist, time), ..state.first };
                tool.second(&ArticulatedState { first, angle: state.angle + state.rate * time, ..state }).pose
            };
            let h = 1e-6;
            let (before, later) = (after(-h), after(h));
            let linear = (later.translation - before.translation) / (2.0 * h);
            let angular = before.rotation_vector_to(&later) / (2.0 * h);
            assert!((linear - second.twist.linear).length() < 1e-7, "seed {seed}, case {case}");
            assert!((angular - second.twist.angular).length() < 1e-7, "seed {seed}, case {case}");
        }
    }

    #[test]
    fn impossible_hinges_are_refused() {
        let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(1e-5))).unwrap();
        let limits = JointLimits { low: 0.0, high: 1.0, stiffness: 10.0 };
        let joint = Joint { in_first: Pose::IDENTITY, in_second: Pose::IDENTITY, limits };
        assert!(ArticulatedBody::new(body, body, joint).is_ok());
        let with = |limits: JointLimits| ArticulatedBody::new(body, body, Joint { limits, ..joint });
        for (low, high) in [(1.0, 0.0), (f64::NAN, 1.0), (0.0, f64::NAN), (f64::INFINITY, f64::INFINITY)] {
            assert!(matches!(with(JointLimits { low, high, ..limits }), Err(JointError::Limits { .. })));
        }
        for gain in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(with(JointLimits { stiffness: gain, ..limits }), Err(JointError::Stops { .. })));
        }
        let bent = Pose::new(DVec3::ZERO, DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0));
        let refused = ArticulatedBody::new(body, body, Joint { in_second: bent, ..joint });
        assert!(matches!(refused, Err(JointError::Frame { body: "second", .. })));
    }

    #[test]
    fn the_composite_has_the_energy_and_momentum_of_its_bodies() {
        let seed = 112;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..200 {
            let tool = random_tool(&mut rng, 0.1);
            let state = ArticulatedState { rate: 0.0, ..random_state(&mut rng) };
            let (body, centre) = tool.composite(state.angle);
            let arm = state.first.pose.transform_vector(centre);
            let twist = Twist { linear: state.first.twist.velocity_at(arm), ..state.first.twist };
            let pose = Pose::new(state.first.pose.translation + arm, state.first.pose.rotation);
            let whole = BodyState { pose, twist };
            let energy = tool.kinetic_energy(&state);
            assert!((body.kinetic_energy(&whole) / energy - 1.0).abs() < 1e-12, "seed {seed}, case {case}");
            let (linear, angular) = tool.momenta(&state);
            assert!((linear - twist.linear * body.mass).length() < 1e-14, "seed {seed}, case {case}");
            assert!((angular - body.angular_momentum(&whole)).length() < 1e-14, "seed {seed}, case {case}");
        }
    }
}
