//! Coulomb friction of a contact (absent in the dissertation, §6.2.1).
//!
//! The body's point is held along the contact's plane by a spring and a damper with the gains k and b of the contact
//! itself, from an anchor in the world. With ξ the way from the anchor and v_t the velocity, both along the plane,
//!
//! F_t = −s (k ξ + b v_t),  s = min(1, μ λ / ‖k ξ + b v_t‖),
//!
//! so that a contact sticks (s = 1) as long as it can, without drift, and slides at the Coulomb limit otherwise. At the
//! end of each step the anchor is drawn after the point, as far as the spring alone exceeds the limit: it never holds more
//! energy than it was given. Between sticking and sliding the force is continuous. The coefficient falls with the speed of
//! sliding, from the static one to the dynamic one, μ = μ_d + (μ_s − μ_d) / (1 + (v / v_s)²) (Stribeck), so that neither
//! is there a jump when a contact breaks away.
//!
//! A contact that stands for a patch of contacts, of radius ρ, resists spinning too: by ρ² (k τ + b ω_n), with τ the angle
//! that it has turned about its normal. Sliding and spinning share the limit, (F_t / μ λ)² + (T_n / ρ μ λ)² ≤ 1, the
//! ellipsoid that is usual for soft fingers (Howe and Cutkosky 1996): a patch that spins slides easily.

use arrayvec::ArrayVec;
use glam::{DMat3, DQuat, DVec3};
use palpate_core::{Twist, Wrench};

use crate::body::BodyState;
use crate::contact::{ContactState, LinearContactModel, MAX_CONSTRAINTS, PlaneConstraint, Surface};
use crate::jacobian::{Block6, WrenchJacobian, outer};
use crate::rotation::{skew, skew_skew};
use crate::system::{Lateral, Linear, six};

/// v_s: speed of sliding at which the coefficient is half way from static to dynamic, m/s.
const STRIBECK_SPEED: f64 = 0.005;

/// What keeps the system of [`LinearContactModel::take_over_friction`] regular, as a part of its entries.
const REGULAR: f64 = 1e-9;

/// Rounds in which what some contacts cannot hold is left to others.
const ROUNDS: usize = 3;

/// Coulomb friction between two surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Friction {
    /// μ_s: the most that a contact holds before it slides, over its normal force.
    pub static_coefficient: f64,
    /// μ_d: what it resists sliding with, over its normal force.
    pub dynamic_coefficient: f64,
}

impl Friction {
    /// No friction.
    pub const NONE: Self = Self { static_coefficient: 0.0, dynamic_coefficient: 0.0 };

    /// Friction with the same coefficient at rest and in motion.
    pub const fn coulomb(coefficient: f64) -> Self {
        Self { static_coefficient: coefficient, dynamic_coefficient: coefficient }
    }

    /// Whether there is any.
    pub fn is_some(&self) -> bool {
        self.static_coefficient > 0.0 || self.dynamic_coefficient > 0.0
    }

    /// μ at a speed of sliding, given its square, m²/s².
    pub(crate) fn coefficient(&self, speed_squared: f64) -> f64 {
        self.dynamic_coefficient + (self.static_coefficient - self.dynamic_coefficient) / below(speed_squared)
    }

    /// s: which part of a `trial` force (N) of a contact that slides so (m/s) friction holds under a normal force
    /// (N, not negative).
    #[inline(always)]
    pub(crate) fn share(&self, trial: &Strain, slide: &Strain, normal_force: f64) -> f64 {
        let surely = self.least() * normal_force;
        let square = trial.length_squared();
        if square <= surely * surely {
            return 1.0;
        }
        sticking(self.coefficient(slide.length_squared()) * normal_force, square.sqrt())
    }

    /// The least that μ can be.
    fn least(&self) -> f64 {
        self.static_coefficient.min(self.dynamic_coefficient)
    }

    /// dμ/dv over v, s²/m², given v².
    fn falling(&self, speed_squared: f64) -> f64 {
        let below = below(speed_squared);
        -2.0 * (self.static_coefficient - self.dynamic_coefficient)
            / (below * below * STRIBECK_SPEED * STRIBECK_SPEED)
    }
}

/// 1 + (v / v_s)², given v².
fn below(speed_squared: f64) -> f64 {
    1.0 + speed_squared * (1.0 / (STRIBECK_SPEED * STRIBECK_SPEED))
}

/// Where friction holds a point of the body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grip {
    /// The anchor in the world, m; only its place along the contact's plane counts.
    pub anchor: DVec3,
    /// Orientation of the body in which the contact is not twisted; [`DQuat::IDENTITY`] also where nothing resists spinning.
    pub rotation: DQuat,
}

impl Default for Grip {
    fn default() -> Self {
        Self { anchor: DVec3::ZERO, rotation: DQuat::IDENTITY }
    }
}

/// How a contact is strained along its plane: ξ or v_t, m or m/s, and ρ τ or ρ ω_n likewise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Strain {
    pub along: DVec3,
    pub spin: f64,
}

impl Strain {
    pub fn length(&self) -> f64 {
        self.length_squared().sqrt()
    }

    pub fn length_squared(&self) -> f64 {
        self.along.length_squared() + self.spin * self.spin
    }

    pub fn scaled(&self, by: f64) -> Self {
        Self { along: self.along * by, spin: self.spin * by }
    }

    pub fn plus(&self, other: &Self) -> Self {
        Self { along: self.along + other.along, spin: self.spin + other.spin }
    }
}

/// What friction does at one state.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Hold {
    /// F_t on the body, N.
    pub force: DVec3,
    /// Moment on the body about the contact's normal, N·m.
    pub moment: f64,
    /// k ξ + b v_t, N.
    pub trial: Strain,
    /// v_t, m/s.
    pub slide: Strain,
    /// s.
    share: f64,
}

impl PlaneConstraint {
    /// ξ.
    #[inline(always)]
    pub(crate) fn stretch(&self, state: &BodyState, at: &ContactState) -> Strain {
        let along = self.along_plane(state.pose.translation + at.arm - self.grip.anchor);
        if self.radius == 0.0 {
            return Strain { along, spin: 0.0 };
        }
        Strain { along, spin: self.twisted(state) }
    }

    /// ρ τ.
    #[inline(never)]
    fn twisted(&self, state: &BodyState) -> f64 {
        let (turn, real) = self.turned(state);
        self.radius * 2.0 * real.signum() * turn.dot(self.normal)
    }

    /// v_t.
    #[inline]
    pub(crate) fn slide(&self, state: &BodyState, at: &ContactState) -> Strain {
        let angular = state.twist.angular - self.surface.angular;
        self.velocity_strain(at.velocity, self.normal.dot(at.velocity), angular)
    }

    /// What a motion strains the contact by, m/s, given the velocity of the point, its part along the normal, and the
    /// angular velocity.
    #[inline]
    pub(crate) fn velocity_strain(&self, velocity: DVec3, rate: f64, angular: DVec3) -> Strain {
        Strain { along: velocity - self.normal * rate, spin: self.radius * self.normal.dot(angular) }
    }

    /// By how much the surface's motion strains the contact less, m/s.
    #[inline]
    pub(crate) fn carried_strain(&self) -> Strain {
        let Surface { velocity, angular, .. } = self.surface;
        self.velocity_strain(velocity, self.normal.dot(velocity), angular)
    }

    fn along_plane(&self, vector: DVec3) -> DVec3 {
        vector - self.normal * self.normal.dot(vector)
    }

    /// Vector and real part of the turn since the contact was not twisted.
    fn turned(&self, state: &BodyState) -> (DVec3, f64) {
        let turn = state.pose.rotation * self.grip.rotation.conjugate();
        (turn.xyz(), turn.w)
    }

    /// What friction does while the contact pushes with λ.
    #[inline(always)]
    pub(crate) fn hold(&self, state: &BodyState, at: &ContactState, normal_force: f64) -> Hold {
        self.hold_before(0.0, state, at, normal_force)
    }

    /// What it did where the surface was so long (s) before, with the body at the same state.
    #[inline(always)]
    pub(crate) fn hold_before(
        &self,
        time: f64,
        state: &BodyState,
        at: &ContactState,
        normal_force: f64,
    ) -> Hold {
        let slide = self.slide(state, at);
        let stretch = self.stretch(state, at).plus(&self.carried_strain().scaled(time));
        let trial = stretch.scaled(self.stiffness).plus(&slide.scaled(self.damping));
        let share = self.friction.share(&trial, &slide, normal_force);
        let felt = trial.scaled(-share);
        Hold { force: felt.along, moment: self.radius * felt.spin, trial, slide, share }
    }

    /// Derivatives of what friction does.
    pub(crate) fn hold_jacobian(
        &self,
        state: &BodyState,
        at: &ContactState,
        normal_force: f64,
        hold: &Hold,
    ) -> WrenchJacobian {
        let (n, angular) = (self.normal, state.twist.angular);
        let plane = DMat3::IDENTITY - outer(n, n);
        let by_turn = plane * -skew(at.arm);
        // Of ξ by (δx, φ), and of v_t by φ and by (v, ω).
        let swept = plane * skew(angular) * -skew(at.arm);
        let spin_by_turn = if self.radius > 0.0 {
            let (turn, real) = self.turned(state);
            (n * real + turn.cross(n)) * (self.radius * real.signum())
        } else {
            DVec3::ZERO
        };
        let mut pose = StrainBy {
            linear: plane * self.stiffness,
            angular: by_turn * self.stiffness + swept * self.damping,
            spin: Row { linear: DVec3::ZERO, angular: spin_by_turn * self.stiffness },
        };
        let mut twist = StrainBy {
            linear: plane * self.damping,
            angular: by_turn * self.damping,
            spin: Row { linear: DVec3::ZERO, angular: n * (self.radius * self.damping) },
        };
        if hold.share < 1.0 {
            let size = hold.trial.length();
            let direction = hold.trial.scaled(1.0 / size);
            // μ λ by pose and twist.
            let Hold { slide, .. } = hold;
            let coefficient = self.friction.coefficient(slide.length_squared());
            let falling = self.friction.falling(slide.length_squared()) * normal_force;
            let normal_by_turn = at.moment * self.stiffness + self.swept(at, angular);
            let sliding = Row {
                linear: slide.along,
                angular: at.arm.cross(slide.along) + n * (self.radius * slide.spin),
            };
            let limit_by_pose = Row {
                linear: n * (coefficient * self.stiffness),
                angular: normal_by_turn * coefficient + swept.transpose() * slide.along * falling,
            };
            let limit_by_twist = Row {
                linear: n * (coefficient * self.damping) + sliding.linear * falling,
                angular: at.moment * (coefficient * self.damping) + sliding.angular * falling,
            };
            pose.limit(hold.share, &direction, &limit_by_pose);
            twist.limit(hold.share, &direction, &limit_by_twist);
        }
        let mut pose = pose.wrench(at, n, self.radius);
        pose.torque_angular += skew_skew(hold.force, at.arm);
        WrenchJacobian { pose, twist: twist.wrench(at, n, self.radius) }
    }

    /// Draws the anchor after the point where the spring exceeds what friction holds.
    #[inline]
    fn settle(&mut self, state: &BodyState, rotation: &DMat3) {
        let at = self.at(state, rotation);
        let stretch = self.stretch(state, &at);
        let share = self.share_of_spring(state, &at, &stretch);
        if share < 1.0 {
            self.hold_at(state, &at, &stretch.scaled(share));
        }
    }

    /// Which part of the spring's force friction alone holds.
    #[inline]
    fn share_of_spring(&self, state: &BodyState, at: &ContactState, stretch: &Strain) -> f64 {
        let spring = stretch.scaled(self.stiffness);
        self.friction.share(&spring, &self.slide(state, at), self.gripping_force(at))
    }

    /// The wrench, about the centre of mass, that a strain's spring is strained with.
    fn spring_wrench(&self, at: &ContactState, stretch: &Strain) -> Wrench {
        let spring = stretch.scaled(self.stiffness);
        let couple = self.normal * (self.radius * spring.spin);
        Wrench::new(spring.along, at.arm.cross(spring.along) + couple)
    }

    /// Puts the anchor where the contact is strained so.
    fn hold_at(&mut self, state: &BodyState, at: &ContactState, stretch: &Strain) {
        self.grip.anchor = state.pose.translation + at.arm - stretch.along;
        if self.radius > 0.0 {
            let half = (0.5 * stretch.spin / self.radius).clamp(-1.0, 1.0);
            let turn = DQuat::from_vec4((self.normal * half).extend((1.0 - half * half).sqrt()));
            self.grip.rotation = (turn.conjugate() * state.pose.rotation).normalize();
        }
    }
}

/// s: which part of a trial force is within a limit.
fn sticking(limit: f64, trial: f64) -> f64 {
    if trial > limit { limit / trial } else { 1.0 }
}

/// The derivative of a strain by a motion.
#[derive(Clone, Copy)]
struct StrainBy {
    linear: DMat3,
    angular: DMat3,
    spin: Row,
}

/// The derivative of a number by a motion.
#[derive(Clone, Copy)]
struct Row {
    linear: DVec3,
    angular: DVec3,
}

impl StrainBy {
    /// Of a strain's `direction` times the limit, where this was that of the strain, of which `share` is held.
    fn limit(&mut self, share: f64, direction: &Strain, limit: &Row) {
        let d = direction.along;
        let across = direction.spin;
        // Of its length.
        let linear = self.linear.transpose() * d + self.spin.linear * across;
        let angular = self.angular.transpose() * d + self.spin.angular * across;
        let linear = limit.linear - linear * share;
        let angular = limit.angular - angular * share;
        self.linear = self.linear * share + outer(d, linear);
        self.angular = self.angular * share + outer(d, angular);
        self.spin.linear = self.spin.linear * share + linear * across;
        self.spin.angular = self.spin.angular * share + angular * across;
    }

    fn wrench(&self, at: &ContactState, normal: DVec3, radius: f64) -> Block6 {
        let arm = skew(at.arm);
        Block6 {
            force_linear: -self.linear,
            force_angular: -self.angular,
            torque_linear: -(arm * self.linear) - outer(normal, self.spin.linear * radius),
            torque_angular: -(arm * self.angular) - outer(normal, self.spin.angular * radius),
        }
    }
}

impl LinearContactModel {
    /// To be called with the state at the end of each step: lets contacts slide where friction does not hold them.
    pub fn settle(&mut self, state: &BodyState) {
        let rotation = DMat3::from_quat(state.pose.rotation);
        for constraint in self.constraints_mut().iter_mut().filter(|c| c.friction.is_some()) {
            constraint.settle(state, &rotation);
        }
    }

    /// Strains the contacts such that friction holds the body with the springs' wrench of `other`, the model before, as far
    /// as they can: as if they had been there when the body was moved by one small displacement, which is found by a 6×6
    /// solve. What some cannot hold is left to the others, in a few rounds. The contacts of a body at rest hence never
    /// creep, however often they are found anew.
    pub fn take_over_friction(&mut self, other: &Self, state: &BodyState) {
        let rotation = DMat3::from_quat(state.pose.rotation);
        let wanted = other.springs(state, &rotation);
        let mut straining: ArrayVec<_, MAX_CONSTRAINTS> = self
            .constraints_mut()
            .iter_mut()
            .filter(|constraint| constraint.friction.is_some())
            .map(|constraint| Straining::new(constraint, state, &rotation))
            .collect();
        let mut missing = wanted;
        for _ in 0..ROUNDS {
            let found = (missing != Wrench::ZERO).then(|| displacement_for(&missing, &straining));
            let Some(displacement) = found.flatten() else { break };
            let mut yielded = false;
            for one in straining.iter_mut().filter(|one| !one.yields) {
                one.strain_by(&displacement, state);
                yielded |= one.yields;
            }
            if !yielded {
                break;
            }
            missing = straining.iter().fold(wanted, |missing, one| missing - one.wrench());
        }
        for Straining { constraint, at, stretch, .. } in &mut straining {
            constraint.hold_at(state, at, stretch);
        }
    }

    /// The wrench, about the centre of mass, that friction's springs are strained with.
    fn springs(&self, state: &BodyState, rotation: &DMat3) -> Wrench {
        let rubbing = self.constraints().iter().filter(|c| c.friction.is_some());
        rubbing.fold(Wrench::ZERO, |sum, c| {
            let at = c.at(state, rotation);
            sum + c.spring_wrench(&at, &c.stretch(state, &at))
        })
    }
}

/// A contact that takes over friction.
struct Straining<'a> {
    constraint: &'a mut PlaneConstraint,
    at: ContactState,
    stretch: Strain,
    /// Whether it cannot hold more.
    yields: bool,
}

impl<'a> Straining<'a> {
    /// Not strained yet.
    fn new(constraint: &'a mut PlaneConstraint, state: &BodyState, rotation: &DMat3) -> Self {
        let at = constraint.at(state, rotation);
        Self { constraint, at, stretch: Strain::default(), yields: false }
    }

    /// Strains it by a displacement (m, rad) of the body, as far as friction holds.
    fn strain_by(&mut self, displacement: &Twist, state: &BodyState) {
        let c = &*self.constraint;
        let way = displacement.velocity_at(self.at.arm);
        let more = c.velocity_strain(way, c.normal.dot(way), displacement.angular);
        let stretch = self.stretch.plus(&more);
        let share = c.share_of_spring(state, &self.at, &stretch);
        self.stretch = stretch.scaled(share);
        self.yields = share < 1.0;
    }

    fn wrench(&self) -> Wrench {
        self.constraint.spring_wrench(&self.at, &self.stretch)
    }
}

/// The displacement (m, rad) of the body to which the springs of all contacts that do not yield answer with −`held`.
fn displacement_for(held: &Wrench, straining: &[Straining<'_>]) -> Option<Twist> {
    let holding = || straining.iter().filter(|one| !one.yields);
    // Angles are counted as way at this distance.
    let reach = holding()
        .map(|one| one.constraint.point.length() + one.constraint.radius)
        .fold(f64::MIN_POSITIVE, f64::max);
    let mut linear = Linear::with_right(six(held.force, held.torque / reach));
    let mut lateral = Lateral::NONE;
    for Straining { constraint: c, at, .. } in holding() {
        lateral.add(c.stiffness, at.arm / reach);
        // Along the normal friction does nothing.
        let direction = six(c.normal, at.moment / reach);
        linear.add_along(&direction, &direction.map(|value| -c.stiffness * value));
        let radius = c.radius / reach;
        linear.add(3, 3, &outer(c.normal, c.normal * (c.stiffness * radius * radius)));
    }
    linear.add_lateral(&lateral);
    let trace: f64 = (0..6).map(|i| linear.matrix[i][i]).sum();
    (0..6).for_each(|i| linear.matrix[i][i] += REGULAR * trace);
    let [x, y, z, a, b, c] = linear.solution(true)?;
    Some(Twist { linear: DVec3::new(x, y, z), angular: DVec3::new(a, b, c) / reach })
}

#[cfg(test)]
mod tests {
    use palpate_core::Pose;
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::differences::{
        derivative, random_direction, random_pose, random_twist, random_vector, relative_error,
        wrench_jacobian,
    };

    /// A contact that pushes, strained and sliding at random.
    fn random_constraint(rng: &mut StdRng, state: &BodyState) -> PlaneConstraint {
        let point = random_vector(rng, 0.1);
        let at = state.pose.transform_point(point);
        let normal = random_direction(rng);
        let twist = DQuat::from_scaled_axis(random_vector(rng, 0.05));
        PlaneConstraint {
            point,
            scene_point: at - normal * rng.random_range(0.004..0.01),
            normal,
            stiffness: rng.random_range(100.0..1e4),
            damping: rng.random_range(0.0..20.0),
            tolerance: rng.random_range(0.0..0.005),
            braking_time: 0.0,
            friction: if rng.random_bool(0.5) {
                Friction::coulomb(rng.random_range(0.1..1.0))
            } else {
                let dynamic_coefficient = rng.random_range(0.1..1.0);
                Friction { static_coefficient: 2.0 * dynamic_coefficient, dynamic_coefficient }
            },
            radius: if rng.random_bool(0.5) { rng.random_range(0.001..0.02) } else { 0.0 },
            grip: Grip { anchor: at - random_vector(rng, 0.01), rotation: twist * state.pose.rotation },
            surface: Surface::STILL,
        }
    }

    #[test]
    fn jacobian_equals_central_differences_whether_it_sticks_or_slides() {
        let seed = 61;
        let mut rng = StdRng::seed_from_u64(seed);
        let (mut stuck, mut slid) = (0, 0);
        for case in 0..2000 {
            let state =
                BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 0.3, 3.0) };
            let mut constraint = random_constraint(&mut rng, &state);
            if case % 2 == 1 {
                let (velocity, angular) = (random_vector(&mut rng, 0.1), random_vector(&mut rng, 1.0));
                constraint.surface = Surface { velocity, angular, ..Surface::STILL };
            }
            let mut model = LinearContactModel::empty(&state.pose, 0.0);
            assert!(model.push(constraint));
            let at = constraint.at(&state, &DMat3::from_quat(state.pose.rotation));
            let hold = constraint.hold(&state, &at, constraint.normal_force(&at));
            // The differences reach 6e-4 m and 0.2 m/s, over which the contact has to stay open or closed, and stuck or not.
            let limit =
                constraint.friction.coefficient(hold.slide.length_squared()) * constraint.normal_force(&at);
            let margin = 0.4 * constraint.damping + 0.002 * constraint.stiffness;
            let clear = constraint.normal_force(&at) > 3.0 * margin
                && (hold.trial.length() - limit).abs() > 3.0 * margin
                && hold.slide.length() > 0.1;
            if !clear {
                continue;
            }
            let found = model.evaluate(&state).jacobian;
            let falls = constraint.friction.static_coefficient > constraint.friction.dynamic_coefficient;
            let error = if falls {
                // Along one motion, in steps so small that the coefficient changes little.
                let (way, change) = (random_twist(&mut rng, 1.0, 10.0), random_twist(&mut rng, 1.0, 10.0));
                let at = |s: f64| BodyState {
                    pose: state.pose.moved(&way, s),
                    twist: Twist::new(
                        state.twist.linear + change.linear * s,
                        state.twist.angular + change.angular * s,
                    ),
                };
                let expected = derivative(|s| model.wrench(&at(s)), 1e-5);
                let off = found.pose.apply(&way) + found.twist.apply(&change) - expected;
                (off.force.length() / expected.force.length())
                    .max(off.torque.length() / expected.torque.length())
            } else {
                relative_error(&found, &wrench_jacobian(|s| model.wrench(s), &state))
            };
            assert!(error < 1e-5, "seed {seed}, case {case}, share {}: relative error {error}", hold.share);
            stuck += usize::from(hold.share == 1.0);
            slid += usize::from(hold.share < 1.0);
        }
        assert!(stuck > 15 && slid > 50, "{stuck} stuck and {slid} slid");
    }

    #[test]
    fn the_coefficient_falls_as_its_derivative_says() {
        let friction = Friction { static_coefficient: 0.8, dynamic_coefficient: 0.5 };
        for speed in [1e-4, 1e-3, 0.005, 0.02, 0.3] {
            let h = 1e-6 * speed;
            let at = |speed: f64| friction.coefficient(speed * speed);
            let slope = (at(speed + h) - at(speed - h)) / (2.0 * h);
            let expected = friction.falling(speed * speed) * speed;
            assert!((slope - expected).abs() < 1e-6 * slope.abs(), "at {speed} m/s");
        }
        assert_eq!(friction.coefficient(0.0), 0.8);
        assert!((friction.coefficient(1.0) - 0.5).abs() < 1e-4);
    }

    #[test]
    fn the_coulomb_limit_holds_in_every_state() {
        let seed = 62;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..5000 {
            let state =
                BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 1.0, 10.0) };
            let constraint = random_constraint(&mut rng, &state);
            let at = constraint.at(&state, &DMat3::from_quat(state.pose.rotation));
            let normal = constraint.normal_force(&at);
            let hold = constraint.hold(&state, &at, normal);
            let most = constraint.friction.static_coefficient.max(constraint.friction.dynamic_coefficient);
            let over = if constraint.radius > 0.0 { hold.moment / constraint.radius } else { 0.0 };
            let felt = (hold.force.length_squared() + over * over).sqrt();
            assert!(felt <= most * normal * (1.0 + 1e-9), "seed {seed}, case {case}: {felt} N of {normal} N");
            assert!(hold.force.dot(constraint.normal).abs() <= 1e-9 * felt, "seed {seed}, case {case}");
        }
    }

    /// Settling takes energy out of the springs, never puts any in, and the same state settles once.
    #[test]
    fn settling_never_stretches_a_spring() {
        let seed = 63;
        let mut rng = StdRng::seed_from_u64(seed);
        let mut yielded = 0;
        for case in 0..2000 {
            let state =
                BodyState { pose: random_pose(&mut rng, 0.5), twist: random_twist(&mut rng, 0.3, 3.0) };
            let rotation = DMat3::from_quat(state.pose.rotation);
            let before = random_constraint(&mut rng, &state);
            let mut after = before;
            after.settle(&state, &rotation);
            let at = before.at(&state, &rotation);
            let (x, y) = (before.stretch(&state, &at), after.stretch(&state, &at));
            assert!(y.length() <= x.length() * (1.0 + 1e-9), "seed {seed}, case {case}");
            yielded += usize::from(y.length() < 0.99 * x.length());
            let limit = before.friction.coefficient(before.slide(&state, &at).length_squared())
                * before.normal_force(&at);
            let small_turn = 0.5 * y.spin.abs() < 0.1 * before.radius;
            assert!(
                !small_turn || before.stiffness * y.length() <= limit * (1.0 + 1e-6) + 1e-9,
                "seed {seed}, case {case}: {} N of {limit}",
                before.stiffness * y.length()
            );
        }
        assert!(yielded > 200, "{yielded} yielded");
    }

    /// Contacts found anew, elsewhere and another number of them, hold the body with the same wrench.
    #[test]
    fn friction_goes_over_to_new_contacts() {
        let seed = 64;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..500 {
            let pose = random_pose(&mut rng, 0.5);
            let state = BodyState::at_rest(pose);
            let mut model = |count: usize| {
                let mut model = LinearContactModel::empty(&pose, 0.0);
                for _ in 0..count {
                    let mut constraint = random_constraint(&mut rng, &state);
                    constraint.friction = Friction::coulomb(1e6);
                    model.push(constraint);
                }
                model
            };
            let (old, mut new) = (model(3), model(5));
            new.take_over_friction(&old, &state);
            let friction = |model: &LinearContactModel| {
                let mut smooth = *model;
                smooth.constraints_mut().iter_mut().for_each(|c| c.friction = Friction::NONE);
                model.wrench(&state) - smooth.wrench(&state)
            };
            let (was, is) = (friction(&old), friction(&new));
            let (force, torque) = ((was - is).force.length(), (was - is).torque.length());
            // The old springs' own wrench, large turns of theirs apart.
            assert!(force < 1e-3 * was.force.length(), "seed {seed}, case {case}: {was:?} {is:?}");
            assert!(
                torque < 1e-2 * (was.torque.length() + 0.1 * was.force.length()),
                "seed {seed}, case {case}"
            );
        }
    }

    #[test]
    fn friction_of_the_same_contacts_stays_however_often_they_are_found_anew() {
        let pose = Pose::from_translation(DVec3::Z * 0.02);
        let parameters = crate::ContactParameters {
            stiffness: 1000.0,
            damping: 1.0,
            tolerance: 0.001,
            friction: Friction::coulomb(0.5),
        };
        let touch = |x: f64, y: f64, depth: f64| palpate_core::Contact {
            point: DVec3::new(x, y, 0.0),
            scene_point: DVec3::new(x, y, depth),
            normal: DVec3::NEG_Z,
            depth,
        };
        let found = [touch(0.01, 0.0, 0.001), touch(-0.01, 0.01, 0.0015), touch(0.0, -0.01, 0.0005)];
        let fresh = LinearContactModel::from_contacts(found, &pose, &parameters, 0.0);
        let moved = BodyState::at_rest(Pose::new(
            pose.translation + DVec3::new(2e-4, -1e-4, 0.0),
            DQuat::from_rotation_z(0.01),
        ));
        let mut model = fresh;
        let held = model.wrench(&moved);
        for _ in 0..30_000 {
            let mut next = fresh;
            next.take_over_friction(&model, &moved);
            model = next;
        }
        let after = model.wrench(&moved);
        assert!((after - held).force.length() < 1e-3 * held.force.length(), "{held:?} {after:?}");
        assert!((after - held).torque.length() < 1e-3 * held.torque.length(), "{held:?} {after:?}");
    }
}
