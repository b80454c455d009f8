//! The rigid body: mass, principal moments of inertia and their axes, and the state of motion (§5.2.1).

use glam::{DMat3, DQuat, DVec3};
use palpate_collide::Shape;
use palpate_core::{Pose, Twist};

/// Reason why a body was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BodyError {
    /// The mass is not a positive finite number.
    #[error(
        "body mass is {mass} kg; it must be positive and finite (is the mesh closed and the density positive?)"
    )]
    Mass {
        /// Mass that was given, kg.
        mass: f64,
    },
    /// No solid has this inertia.
    #[error(
        "body inertia {inertia} kg·m² has principal moments {moments}; give it symmetric, about the centre of mass, with \
         positive moments of which none exceeds the sum of the others"
    )]
    Inertia {
        /// Inertia that was given, kg·m².
        inertia: DMat3,
        /// Its principal moments, kg·m².
        moments: DVec3,
    },
    /// The centre of mass is not finite.
    #[error("the centre of mass, {center} m, is not finite")]
    Center {
        /// Centre of mass that was given, m.
        center: DVec3,
    },
}

/// Relative tolerance of the inertia's symmetry and triangle inequality. Thin plates and rods lie on the
/// boundary of the latter, so without it rounding would refuse them.
const INERTIA_TOLERANCE: f64 = 1e-6;

/// Smallest accepted ratio of principal moments. At smaller ones rotations about the axis of the smallest
/// lose all digits.
const MIN_MOMENT_RATIO: f64 = 1e-9;

/// Mass properties of a rigid body, in its own frame (the mesh's).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidBody {
    mass: f64,
    center: DVec3,
    /// Principal moments, kg·m².
    moments: DVec3,
    /// Rotation from principal axes to the body's.
    axes: DQuat,
}

impl RigidBody {
    /// Creates a body from its mass (kg), its centre of mass in its frame (m), and its inertia about that, in
    /// the frame's axes (kg·m²).
    ///
    /// # Errors
    /// If no solid has such a mass or inertia.
    pub fn new(mass: f64, center: DVec3, inertia: DMat3) -> Result<Self, BodyError> {
        if !(mass.is_finite() && mass > 0.0) {
            return Err(BodyError::Mass { mass });
        }
        if !center.is_finite() {
            return Err(BodyError::Center { center });
        }
        let (moments, axes) = principal(&inertia);
        let size = inertia.to_cols_array().iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        let skewness = (inertia - inertia.transpose()).to_cols_array();
        // A solid's inertia is symmetric and positive, and no moment exceeds the sum of the other two.
        let solid = inertia.is_finite()
            && skewness.iter().all(|x| x.abs() <= INERTIA_TOLERANCE * size)
            && moments.min_element() > MIN_MOMENT_RATIO * moments.max_element()
            && 2.0 * moments.max_element() <= moments.element_sum() * (1.0 + INERTIA_TOLERANCE);
        if !solid {
            return Err(BodyError::Inertia { inertia, moments });
        }
        Ok(Self { mass, center, moments, axes })
    }

    /// Creates a solid of a mass (kg) and uniform density, in the shape's frame.
    ///
    /// # Errors
    /// If the mass is not positive and finite, or the shape is flat.
    pub fn solid(shape: &Shape, mass: f64) -> Result<Self, BodyError> {
        let source = &shape.clod().source;
        Self::new(mass, source.center_of_mass, source.unit_inertia * mass)
    }

    /// Mass, kg.
    pub fn mass(&self) -> f64 {
        self.mass
    }

    /// Centre of mass in the body's frame, m.
    pub fn center_of_mass(&self) -> DVec3 {
        self.center
    }

    /// Principal moments of inertia, kg·m², and the rotation from their axes to the body's.
    pub fn principal_moments(&self) -> (DVec3, DQuat) {
        (self.moments, self.axes)
    }

    /// Returns the pose of the body's frame.
    pub fn frame(&self, state: &BodyState) -> Pose {
        let Pose { translation, rotation } = state.pose;
        Pose { translation: translation - rotation * self.center, rotation }
    }

    /// Returns the state with the body's frame at a pose, and the velocity of the centre of mass and angular
    /// velocity of `twist`, world axes.
    pub fn state(&self, frame: &Pose, twist: Twist) -> BodyState {
        BodyState { pose: Pose { translation: frame.transform_point(self.center), ..*frame }, twist }
    }

    /// Returns the velocity of the origin of the body's frame, and the angular velocity, world axes.
    pub fn frame_twist(&self, state: &BodyState) -> Twist {
        let arm = -(state.pose.rotation * self.center);
        Twist { linear: state.twist.velocity_at(arm), ..state.twist }
    }

    /// Kinetic energy, J.
    pub fn kinetic_energy(&self, state: &BodyState) -> f64 {
        let spin = self.principal_rotation(state).conjugate() * state.twist.angular;
        0.5 * (self.mass * state.twist.linear.length_squared() + (self.moments * spin).dot(spin))
    }

    /// Potential energy under gravity (m/s²), J: 0 with the centre of mass at the world's origin.
    pub fn potential_energy(&self, state: &BodyState, gravity: DVec3) -> f64 {
        -self.mass * gravity.dot(state.pose.translation)
    }

    /// Angular momentum about the centre of mass, world axes, kg·m²/s.
    pub fn angular_momentum(&self, state: &BodyState) -> DVec3 {
        let to_world = self.principal_rotation(state);
        to_world * (self.moments * (to_world.conjugate() * state.twist.angular))
    }

    /// Returns the rotation from principal axes to the world's.
    pub(crate) fn principal_rotation(&self, state: &BodyState) -> DQuat {
        state.pose.rotation * self.axes
    }

    /// Returns the inverse of the inertia, world axes, 1/(kg·m²).
    pub(crate) fn inverse_inertia(&self, state: &BodyState) -> DMat3 {
        let to_world = DMat3::from_quat(self.principal_rotation(state));
        to_world * DMat3::from_diagonal(self.moments.recip()) * to_world.transpose()
    }
}

/// Pose and velocity of a body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BodyState {
    /// Placement of the body's axes; the translation is the centre of mass in the world, m.
    pub pose: Pose,
    /// Velocity of the centre of mass and angular velocity, world axes.
    pub twist: Twist,
}

impl BodyState {
    /// Returns a state at rest.
    pub const fn at_rest(pose: Pose) -> Self {
        Self { pose, twist: Twist::ZERO }
    }

    /// Returns whether the pose is a rigid placement and all numbers are finite.
    pub fn is_valid(&self) -> bool {
        self.pose.is_valid() && self.twist.is_finite()
    }
}

/// Returns the principal moments of an inertia and the rotation from their axes, by cyclic Jacobi rotations.
fn principal(inertia: &DMat3) -> (DVec3, DQuat) {
    const SWEEPS: usize = 20;
    let mut matrix = (*inertia + inertia.transpose()) * 0.5;
    let mut axes = DMat3::IDENTITY;
    for _ in 0..SWEEPS {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let off = matrix.col(q)[p];
            if off == 0.0 || !off.is_finite() {
                continue;
            }
            // The rotation by θ with cot 2θ = (a_qq − a_pp) / 2 a_pq makes a_pq zero; `tangent` is the
            // smaller root of tan θ.
            let ratio = (matrix.col(q)[q] - matrix.col(p)[p]) / (2.0 * off);
            let tangent = ratio.signum() / (ratio.abs() + ratio.hypot(1.0));
            let cosine = tangent.hypot(1.0).recip();
            let mut turn = DMat3::IDENTITY;
            turn.col_mut(p)[p] = cosine;
            turn.col_mut(q)[q] = cosine;
            turn.col_mut(q)[p] = tangent * cosine;
            turn.col_mut(p)[q] = -tangent * cosine;
            matrix = turn.transpose() * matrix * turn;
            // These entries are zero except for rounding.
            matrix.col_mut(p)[q] = 0.0;
            matrix.col_mut(q)[p] = 0.0;
            axes *= turn;
        }
    }
    let moments = DVec3::new(matrix.x_axis.x, matrix.y_axis.y, matrix.z_axis.z);
    (moments, DQuat::from_mat3(&axes).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn principal_axes_reproduce_the_inertia() {
        let moments = DVec3::new(1.0, 2.0, 2.5);
        for angle in [0.0, 0.3, 1.0, 2.7] {
            let turn =
                DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(0.2, -0.7, 0.5).normalize() * angle));
            let inertia = turn * DMat3::from_diagonal(moments) * turn.transpose();
            let body = RigidBody::new(1.0, DVec3::ZERO, inertia).unwrap();
            let inverse = body.inverse_inertia(&BodyState::default());
            let identity = (inverse * inertia - DMat3::IDENTITY).to_cols_array();
            assert!(identity.iter().all(|x| x.abs() < 1e-14), "angle {angle}: {identity:?}");
        }
    }

    #[test]
    fn bodies_that_cannot_exist_are_refused() {
        let good = DMat3::from_diagonal(DVec3::new(1.0, 2.0, 2.5));
        let body = |mass, inertia| RigidBody::new(mass, DVec3::ZERO, inertia);
        assert!(body(1.0, good).is_ok());
        for mass in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(body(mass, good), Err(BodyError::Mass { .. })));
        }
        let mut bent = good;
        bent.x_axis.y = 0.1;
        let mut broken = good;
        broken.x_axis.y = f64::NAN;
        let diagonal = |x, y, z| DMat3::from_diagonal(DVec3::new(x, y, z));
        let others =
            [DMat3::ZERO, diagonal(-1.0, 1.0, 1.0), diagonal(1.0, 1.0, 2.1), diagonal(0.0, 1.0, 1.0)];
        for inertia in others.into_iter().chain([bent, broken]) {
            assert!(matches!(body(1.0, inertia), Err(BodyError::Inertia { .. })), "{inertia}");
        }
        assert!(body(1.0, diagonal(1.0, 1.0, 2.0)).is_ok(), "a flat plate is a body");
        let nowhere = RigidBody::new(1.0, DVec3::NAN, good);
        assert!(matches!(nowhere, Err(BodyError::Center { .. })));
    }
}
