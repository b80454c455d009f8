//! Contacts whose depth is more than the distance from a plane: those of detailed surfaces (§5.4.4).
//!
//! Such a contact is known by its depth, the gradient (g_x, g_θ) of that by a shift and a turn of the body, and the second
//! derivatives. Its potential is U = ½ k (δ + d)² as everywhere, and hence its wrench −λ ∇δ. It is made of
//!
//! - the plane along g_x, through the point of the body that lies on the wrench's axis, of stiffness k ‖g_x‖² and so on:
//!   that has the gradient (g_x, a × g_x),
//! - a twist, which adds the rest of the torque, pitch · g_x per newton (a smooth maximum over several places has one),
//! - bends ½ (b · q)² along the directions b in which δ has a positive second derivative beyond that of the plane, with q the
//!   motion since the contact was found: the [`BENDS`] largest. Negative ones are left out: with them the wrench would push away
//!   from crests, and no implicit step would be sure to have a solution. With positive ones δ is convex but for the turning of
//!   the plane's lever arm, so U is, and the stiffness that comes of them is positive semi-definite.
//!
//! A bend turns the plane by no more than [`STEEPEST`], beyond which it goes on straight: it is known where the contact was
//! found only.

use arrayvec::ArrayVec;
use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};

use crate::body::BodyState;
use crate::contact::{ContactParameters, PlaneConstraint, Surface};
use crate::eigen::{Matrix6, eigen};
use crate::friction::Grip;

/// The most bends that a curved contact has.
pub const BENDS: usize = 2;

/// Those of a model, and of one that goes: twists included, of eight contacts each.
pub(crate) const MAX_BENDS: usize = 2 * 8 * (BENDS + 1);

/// The most that a bend changes ‖∇δ‖ by: at the body's lever arm for turns.
const STEEPEST: f64 = 1.0;

/// The most that a slope stiffens a contact: ‖g_x‖².
const STIFFEST: f64 = 4.0;

/// A contact of detailed surfaces, in world axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvedContact {
    /// Where the surfaces touch, m.
    pub point: DVec3,
    /// δ, m.
    pub depth: f64,
    /// ∂δ/∂x, by a shift of the body.
    pub linear: DVec3,
    /// ∂δ/∂θ, by a turn of it about its centre of mass, m/rad.
    pub angular: DVec3,
    /// Second derivatives by shift and turn, 1/m, 1, and m: symmetric.
    pub second: [[f64; 6]; 6],
    /// About the size of the body, m: makes turns comparable with shifts.
    pub lever: f64,
}

/// What a contact's depth is more than the distance from a plane: slope · s + ½ curvature · s², with s linear in the motion
/// of the body since the contact was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bend {
    /// Place of the contact's plane in the model.
    pub constraint: usize,
    /// Where the contact was found.
    origin: Pose,
    /// s by a shift and by a turn.
    linear: DVec3,
    angular: DVec3,
    slope: f64,
    curvature: f64,
    /// Where the curvature ends.
    limit: f64,
}

/// A bend seen from a state.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bent {
    /// What it adds to δ, m.
    pub value: f64,
    /// By s.
    pub slope: f64,
    pub curvature: f64,
    /// s by a shift and by a turn.
    pub linear: DVec3,
    pub angular: DVec3,
}

impl Bend {
    pub const NONE: Self = Self {
        constraint: 0,
        origin: Pose::IDENTITY,
        linear: DVec3::ZERO,
        angular: DVec3::ZERO,
        slope: 0.0,
        curvature: 0.0,
        limit: 0.0,
    };

    fn along((linear, angular): (DVec3, DVec3), origin: &Pose, limit: f64) -> Self {
        Self { linear, angular, limit, origin: *origin, ..Self::NONE }
    }

    /// The same of another contact.
    pub fn of(&self, constraint: usize) -> Self {
        Self { constraint, ..*self }
    }

    pub fn at(&self, state: &BodyState) -> Bent {
        // Twice the half angle's sine in place of the angle, the short way round.
        let turn: DQuat = state.pose.rotation * self.origin.rotation.conjugate();
        let turn = turn * turn.w.signum();
        let shift = state.pose.translation - self.origin.translation;
        let s = self.linear.dot(shift) + 2.0 * self.angular.dot(turn.xyz());
        let within = s.clamp(-self.limit, self.limit);
        Bent {
            value: self.slope * s + self.curvature * within * (s - 0.5 * within),
            slope: self.slope + self.curvature * within,
            curvature: if s == within { self.curvature } else { 0.0 },
            linear: self.linear,
            angular: self.angular * turn.w + turn.xyz().cross(self.angular),
        }
    }
}

impl Bent {
    /// ds/dt.
    pub fn rate(&self, twist: &Twist) -> f64 {
        self.linear.dot(twist.linear) + self.angular.dot(twist.angular)
    }
}

impl CurvedContact {
    /// The plane, with its bends, as found while the body was at `pose`; `None` if the contact is not finite or has no
    /// gradient.
    pub(crate) fn constraint(
        &self,
        pose: &Pose,
        parameters: &ContactParameters,
    ) -> Option<(PlaneConstraint, ArrayVec<Bend, { BENDS + 1 }>)> {
        let square = self.linear.length_squared();
        let finite = self.point.is_finite() && self.angular.is_finite() && self.depth.is_finite();
        let sized = self.lever > 0.0 && self.lever.is_finite();
        if !(finite && sized && square.is_finite() && square > f64::EPSILON) {
            return None;
        }
        let steepness = square.sqrt();
        let normal = self.linear / steepness;
        // On the wrench's axis, where that is nearest to the point.
        let off_axis = normal.cross(self.angular) / steepness;
        let arm = off_axis + normal * normal.dot(self.point - pose.translation);
        let stiffer = square.min(STIFFEST);
        let plane = PlaneConstraint {
            point: pose.rotation.conjugate() * arm,
            scene_point: pose.translation + arm - normal * (self.depth / steepness),
            normal,
            stiffness: parameters.stiffness * stiffer,
            damping: parameters.damping * stiffer,
            tolerance: parameters.tolerance / steepness,
            braking_time: 0.0,
            friction: parameters.friction,
            radius: 0.0,
            grip: Grip { anchor: pose.translation + arm, rotation: pose.rotation },
            surface: Surface::STILL,
        };
        let twist = (DVec3::ZERO, normal * (normal.dot(self.angular) / steepness));
        let twist = Bend { slope: 1.0, ..Bend::along(twist, pose, 0.0) };
        let root = steepness.sqrt();
        let bends = self.bends(arm).into_iter().map(|(linear, angular)| {
            let size = linear.length().hypot(angular.length() / self.lever);
            let limit = STEEPEST / (size * root);
            Bend { curvature: 1.0, ..Bend::along((linear / root, angular / root), pose, limit) }
        });
        let twists = twist.angular.length_squared() > 0.0;
        Some((plane, twists.then_some(twist).into_iter().chain(bends).collect()))
    }

    /// Directions b, linear (m^-½) and angular (m^½), of the largest positive second derivatives beyond those of the plane that
    /// has its point at `arm`: none where these are not finite.
    fn bends(&self, arm: DVec3) -> ArrayVec<(DVec3, DVec3), BENDS> {
        // Turns by how far they move what is at the lever.
        let scale = |i: usize| if i < 3 { 1.0 } else { self.lever };
        let (a, g) = (arm.to_array(), self.linear.to_array());
        let along = arm.dot(self.linear);
        let of_plane = |i: usize, j: usize| {
            let (i, j) = (i.checked_sub(3)?, j.checked_sub(3)?);
            Some(0.5 * (a[i] * g[j] + g[i] * a[j]) - if i == j { along } else { 0.0 })
        };
        let beyond: Matrix6 = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                (self.second[i][j] - of_plane(i, j).unwrap_or(0.0)) / (scale(i) * scale(j))
            })
        });
        if !beyond.iter().flatten().all(|value| value.is_finite()) {
            return ArrayVec::new();
        }
        let (values, vectors) = eigen(beyond);
        let mut order = [0, 1, 2, 3, 4, 5];
        order.sort_unstable_by(|&i, &j| values[j].total_cmp(&values[i]));
        let chosen = order.into_iter().take(BENDS).filter(|&k| values[k] > 0.0);
        let direction = |k: usize| {
            let [x, y, z, a, b, c] = std::array::from_fn(|i| vectors[i][k] * values[k].sqrt() * scale(i));
            (DVec3::new(x, y, z), DVec3::new(a, b, c))
        };
        chosen.map(direction).collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use palpate_core::Wrench;
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::contact::Carrier;
    use crate::contact::LinearContactModel;
    use crate::differences::{random_pose, random_twist, random_vector, relative_error, wrench_jacobian};
    use crate::friction::Friction;

    const PARAMETERS: ContactParameters =
        ContactParameters { stiffness: 2000.0, damping: 0.0, tolerance: 5e-4, friction: Friction::NONE };

    /// A depth as a quadratic function, of a body of about 5 cm, with curvatures of either sign.
    fn random_contact(rng: &mut StdRng, pose: &Pose) -> CurvedContact {
        let lever = 0.05;
        let entries: Matrix6 =
            std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-100.0..100.0)));
        let scale = |i: usize| if i < 3 { 1.0 } else { lever };
        let second = std::array::from_fn(|i| {
            std::array::from_fn(|j| entries[i.max(j)][i.min(j)] * scale(i) * scale(j))
        });
        CurvedContact {
            point: pose.translation + random_vector(rng, lever),
            depth: rng.random_range(1e-3..2e-3),
            linear: random_vector(rng, 1.0),
            angular: random_vector(rng, lever),
            second,
            lever,
        }
    }

    fn model(contact: &CurvedContact, pose: &Pose, parameters: &ContactParameters) -> LinearContactModel {
        let mut model = LinearContactModel::empty(pose, 0.0);
        model.push_curved(contact, pose, parameters, 0.0, &Carrier::STILL);
        model
    }

    fn product(contact: &CurvedContact, motion: &Twist) -> f64 {
        let q = [motion.linear.to_array(), motion.angular.to_array()].concat();
        (0..6).map(|i| (0..6).map(|j| q[i] * contact.second[i][j] * q[j]).sum::<f64>()).sum()
    }

    #[test]
    fn wrench_where_it_was_found_is_that_of_the_potential() {
        let seed = 121;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..500 {
            let pose = random_pose(&mut rng, 0.3);
            let contact = random_contact(&mut rng, &pose);
            let square = contact.linear.length_squared();
            if square < 0.01 {
                continue;
            }
            let wrench = model(&contact, &pose, &PARAMETERS).wrench(&BodyState::at_rest(pose));
            let push = PARAMETERS.stiffness * (contact.depth + PARAMETERS.tolerance);
            let off = wrench - Wrench::new(contact.linear * -push, contact.angular * -push);
            assert!(off.force.length() < 1e-9 * push, "seed {seed}, case {case}: {off:?}");
            assert!(off.torque.length() < 1e-9 * push, "seed {seed}, case {case}: {off:?}");
        }
    }

    /// Where all curvatures are positive and two directions have them, depth follows its second order.
    #[test]
    fn energy_follows_the_second_order_of_the_depth() {
        let seed = 122;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..300 {
            let pose = random_pose(&mut rng, 0.3);
            let mut contact = random_contact(&mut rng, &pose);
            // A point on a surface that curves up along two directions.
            contact.linear = contact.linear.normalize();
            let arm = contact.point - pose.translation;
            contact.angular = arm.cross(contact.linear);
            let (u, v) = contact.linear.any_orthonormal_pair();
            let curved = [u, v].map(|axis| (axis, arm.cross(axis), rng.random_range(1.0..300.0)));
            let (a, g) = (arm.to_array(), contact.linear.to_array());
            contact.second = std::array::from_fn(|i| {
                std::array::from_fn(|j| {
                    let along = |(l, m, curvature): (DVec3, DVec3, f64)| {
                        let q = [l.to_array(), m.to_array()].concat();
                        curvature * q[i] * q[j]
                    };
                    let plane = if i >= 3 && j >= 3 {
                        let unit = f64::from(u8::from(i == j));
                        0.5 * (a[i - 3] * g[j - 3] + g[i - 3] * a[j - 3]) - unit * arm.dot(contact.linear)
                    } else {
                        0.0
                    };
                    plane + curved.into_iter().map(along).sum::<f64>()
                })
            });
            let model = model(&contact, &pose, &PARAMETERS);
            let motion = random_twist(&mut rng, 1.0, 20.0);
            let mut errors = [1e-4, 5e-5].map(|step| {
                let q = Twist::new(motion.linear * step, motion.angular * step);
                let depth = contact.depth
                    + contact.linear.dot(q.linear)
                    + contact.angular.dot(q.angular)
                    + 0.5 * product(&contact, &q);
                let expected = 0.5 * PARAMETERS.stiffness * (depth + PARAMETERS.tolerance).powi(2);
                (model.potential_energy(&pose.moved(&q, 1.0)) - expected).abs()
            });
            errors[1] *= 5.0;
            assert!(
                errors[0] < 1e-9 && errors[1] < errors[0] + 1e-15,
                "seed {seed}, case {case}: {errors:?}"
            );
        }
    }

    #[test]
    fn jacobian_equals_central_differences() {
        let seed = 123;
        let mut rng = StdRng::seed_from_u64(seed);
        let mut bent = 0;
        for case in 0..500 {
            let found_at = random_pose(&mut rng, 0.3);
            let contact = random_contact(&mut rng, &found_at);
            if contact.linear.length() < 0.3 {
                continue;
            }
            let parameters = ContactParameters { stiffness: 2000.0, tolerance: 0.02, ..PARAMETERS };
            let model = model(&contact, &found_at, &parameters);
            let state = BodyState {
                pose: found_at.moved(&random_twist(&mut rng, 5e-4, 0.01), 1.0),
                twist: random_twist(&mut rng, 0.1, 1.0),
            };
            let response = model.evaluate(&state);
            let expected = wrench_jacobian(|s| model.wrench(s), &state);
            let error = relative_error(&response.jacobian, &expected);
            // The bends' turn is taken to first order.
            assert!(error < 1e-2, "seed {seed}, case {case}: relative error {error}");
            bent += usize::from(model.bends().len() > 1);
        }
        assert!(bent > 200, "{bent} were bent");
    }

    /// But for its arm's turning a curved contact is stiff in no direction that it would be driven along.
    #[test]
    fn stiffness_of_bends_is_semi_definite_wherever_the_body_is() {
        let seed = 124;
        let mut rng = StdRng::seed_from_u64(seed);
        let mut pushed = 0;
        for case in 0..1000 {
            let pose = random_pose(&mut rng, 0.3);
            let contact = random_contact(&mut rng, &pose);
            let model = model(&contact, &pose, &PARAMETERS);
            let state = BodyState::at_rest(pose.moved(&random_twist(&mut rng, 0.02, 0.5), 1.0));
            let response = model.evaluate(&state);
            if response.active == 0 {
                continue;
            }
            pushed += 1;
            let at = model.at(0, &state, &DMat3::from_quat(state.pose.rotation));
            let force = model.constraints()[0].normal_force(&at);
            for bend in model.bends() {
                let bent = bend.at(&state);
                let change = if bend.curvature > 0.0 {
                    bent.linear.length().hypot(bent.angular.length() / contact.lever)
                        * bent.slope.abs()
                        * contact.linear.length()
                } else {
                    0.0
                };
                assert!(change <= STEEPEST * (1.0 + 1e-9), "seed {seed}, case {case}: turned by {change}");
            }
            for _ in 0..10 {
                let way = random_twist(&mut rng, 1.0, 20.0);
                let resisting = response.jacobian.pose.apply(&way);
                let turning =
                    crate::rotation::skew_skew(model.constraints()[0].normal * -force, at.arm) * way.angular;
                let energy = -resisting.force.dot(way.linear) - (resisting.torque - turning).dot(way.angular);
                assert!(energy >= -1e-9 * force.max(1.0), "seed {seed}, case {case}: {energy}");
            }
        }
        assert!(pushed > 300, "{pushed} pushed");
    }

    #[test]
    fn what_is_not_finite_is_refused() {
        let mut rng = StdRng::seed_from_u64(125);
        let pose = random_pose(&mut rng, 0.3);
        let good = random_contact(&mut rng, &pose);
        let mut crooked = good;
        crooked.second[2][3] = f64::NAN;
        let bad = [
            CurvedContact { depth: f64::NAN, ..good },
            CurvedContact { linear: DVec3::ZERO, ..good },
            CurvedContact { angular: DVec3::splat(f64::INFINITY), ..good },
            CurvedContact { lever: 0.0, ..good },
        ];
        let mut model = LinearContactModel::empty(&pose, 0.0);
        for contact in bad {
            model.push_curved(&contact, &pose, &PARAMETERS, 0.0, &Carrier::STILL);
        }
        assert_eq!((model.constraints().len(), model.refused()), (0, 4));
        // A plane is left of one whose curvature is unknown.
        model.push_curved(&crooked, &pose, &PARAMETERS, 0.0, &Carrier::STILL);
        assert!(model.bends().iter().all(|bend| bend.curvature == 0.0) && model.constraints().len() == 1);
    }
}
