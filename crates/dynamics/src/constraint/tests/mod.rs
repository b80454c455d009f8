//! Steps with constraints against their optimality conditions and penalty contacts in the limit.

mod fits;
mod hosts;
mod many;
mod motion;

use arrayvec::ArrayVec;
use glam::{DMat3, DQuat, DVec3};
use palpate_core::{Contact, Pose, Twist};
use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

use super::*;
use crate::algebra::linear_solve::solve;
use crate::body::{Body, BodyState};
use crate::coupling::{DeviceMotion, VirtualCoupling};
use crate::differences::{random_direction, random_pose, random_twist, random_vector};
use crate::penalty::{ContactParameters, Friction, LinearContactModel};
use crate::step::{Frame, Solution, StepFailure, System, semi_implicit_step};
use crate::system::six;

const DT: f64 = 1e-3;
const GRAVITY: f64 = 9.81;

/// Compliance of a contact relative to the body's mobility along it, as the solver documents it.
const COMPLIANCE: f64 = 1e-4;

/// Largest violation of the conditions on normal impulses, relative to the largest approach.
const TOLERANCE: f64 = 1e-9;

/// The same of the law of friction: that to which a step iterates.
const FRICTION_TOLERANCE: f64 = 2e-4;

/// Largest violation of the body's equation, relative to its largest term: the share of geometric stiffness
/// in the step's matrix that is not symmetric, which impulses do not see.
const ASYMMETRY: f64 = 3e-3;

/// Largest speed of recovery, m/s.
const RECOVERY: f64 = 0.02;

/// A body and all that acts on it but contacts.
struct Rig {
    body: Body,
    coupling: VirtualCoupling,
    device: DeviceMotion,
    state: BodyState,
    gravity: DVec3,
    contacts: LinearContactModel,
    /// Recovery velocity of the step before, m/s.
    recovery: f64,
}

impl Rig {
    /// A cube of 0.1 kg and 4 cm that nothing holds.
    fn free() -> Self {
        let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(0.1 * 0.04 * 0.04 / 6.0))).unwrap();
        let coupling = VirtualCoupling {
            linear_stiffness: 0.0,
            linear_damping: 0.0,
            angular_stiffness: 0.0,
            angular_damping: 0.0,
            ..VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 1.0, 1.0)
        };
        Self {
            body,
            coupling,
            device: DeviceMotion::default(),
            state: BodyState::default(),
            gravity: DVec3::ZERO,
            contacts: LinearContactModel::empty(&Pose::IDENTITY, 0.0),
            recovery: 0.0,
        }
    }

    /// A held body of any mass that moves at up to 0.1 m/s.
    fn random(rng: &mut StdRng) -> Self {
        let turn = DMat3::from_quat(random_pose(rng, 1.0).rotation);
        let squares = DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.1..1.0)));
        let mass = 10_f64.powf(rng.random_range(-2.0..0.5));
        let moments = DVec3::new(squares.y + squares.z, squares.z + squares.x, squares.x + squares.y);
        let inertia = turn * DMat3::from_diagonal(moments * (mass * 4e-4)) * turn.transpose();
        let body = Body::new(mass, inertia).unwrap();
        let coupling = VirtualCoupling::critically_damped(&body, random_pose(rng, 0.02), 500.0, 0.5);
        let state = BodyState { pose: random_pose(rng, 0.1), twist: random_twist(rng, 0.1, 2.0) };
        let device =
            DeviceMotion::at_rest((state.pose * coupling.grasp).moved(&random_twist(rng, 2e-3, 0.05), 1.0));
        let recovery = rng.random_range(0.0..RECOVERY);
        Self { body, coupling, device, state, recovery, ..Self::free() }
    }

    fn frame(&self) -> Frame<'_> {
        let Self { body, device, coupling, contacts, gravity, .. } = self;
        Frame { body, device, coupling, contacts, gravity: *gravity }
    }

    fn step(&self, contacts: &mut [Constraint]) -> ConstrainedStep {
        self.step_of(DT, contacts)
    }

    /// A step of `dt` (s).
    fn step_of(&self, dt: f64, contacts: &mut [Constraint]) -> ConstrainedStep {
        let recovery = self.recovered();
        constrained_step(&self.frame(), &self.state, contacts, &[], &MotionBound::NONE, &recovery, dt)
    }

    fn recovered(&self) -> Recovery {
        Recovery { speed: self.recovery, scale: 1.0 }
    }

    /// Matrix and right-hand side of the step without contacts.
    fn system(&self) -> ([[f64; 6]; 6], [f64; 6]) {
        let frame = self.frame();
        let mut candidates = ArrayVec::new();
        let mut system = System::new(&frame, &self.state, DT, &mut candidates);
        let Solution { active, .. } = system.solve().expect("regular");
        let linear = system.assemble(active);
        (linear.matrix, linear.right)
    }
}

/// Contacts at arms of 2 cm, with gaps that a step may close, and overlaps.
fn random_contacts(rng: &mut StdRng, most: usize, friction: f64) -> Vec<Constraint> {
    let random = |rng: &mut StdRng| Constraint {
        velocity: random_vector(rng, 0.02),
        friction,
        ..Constraint::new(random_direction(rng) * 0.02, random_direction(rng), rng.random_range(-2e-5..1e-4))
    };
    (0..rng.random_range(1..=most)).map(|_| random(rng)).collect()
}

/// What contacts' velocities should be: their largest approaches, m/s. An overlap fades in 5 ms, or as fast
/// as it may beside others.
fn limits(rig: &Rig, contacts: &[Constraint]) -> Vec<f64> {
    let recovery = recovery(rig, contacts);
    let factor = step::mobility_factor(rig.system().0).expect("regular");
    let side = |c: &Constraint| normals::Side {
        row: solver::scaled(&factor, &six(c.normal, c.arm.cross(c.normal))),
        excess: 0.0,
        stiffness: 0.0,
    };
    let sides: Vec<_> = contacts.iter().map(side).collect();
    let shared = overlaps::shared(contacts, &sides, (DT, recovery));
    let limit = |(index, contact): (usize, &Constraint)| {
        let out = shared.as_ref().map_or(0.0, |out| out[index]);
        contact.normal.dot(contact.velocity) + if contact.gap < 0.0 { -out } else { contact.gap / DT }
    };
    contacts.iter().enumerate().map(limit).collect()
}

/// What the recovery velocity should be in a step, m/s: a fifth of the way to its goal, for T = 5 ms.
fn recovery(rig: &Rig, contacts: &[Constraint]) -> f64 {
    let most = (0.05 / rig.coupling.linear_damping).min(RECOVERY);
    let deepest = contacts.iter().map(|contact| -contact.gap).fold(0.0, f64::max);
    let before = rig.recovery.min(most);
    before + 0.2 * ((deepest / 5e-3).min(most) - before)
}

fn mobility(matrix: &[[f64; 6]; 6], arm: DVec3, axis: DVec3) -> f64 {
    let row = six(axis, arm.cross(axis));
    let response = solve(*matrix, row).expect("regular");
    row.iter().zip(response).map(|(a, b)| a * b).sum()
}

fn apply(matrix: &[[f64; 6]; 6], x: [f64; 6]) -> [f64; 6] {
    std::array::from_fn(|i| (0..6).map(|j| matrix[i][j] * x[j]).sum())
}

/// Largest violation of A Δ = b − Σ Jᵀ p, relative to the largest term.
fn residual(rig: &Rig, contacts: &[Constraint], step: &ConstrainedStep) -> f64 {
    let (matrix, right) = rig.system();
    let (before, after) = (rig.state.twist, step.step.state.twist);
    let change = six(after.linear - before.linear, after.angular - before.angular);
    let mut off = apply(&matrix, change);
    let mut size = off;
    for (off, right) in off.iter_mut().zip(right) {
        *off -= right;
    }
    for contact in contacts {
        let pushed = six(contact.impulse, contact.arm.cross(contact.impulse));
        for ((off, size), pushed) in off.iter_mut().zip(&mut size).zip(pushed) {
            *off += pushed;
            *size = size.abs().max(pushed.abs());
        }
    }
    // Forces and torques have sizes of their own.
    let most = |of: &[f64]| of.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    (most(&off[..3]) / most(&size[..3])).max(most(&off[3..]) / most(&size[3..]))
}

/// The largest approach of a contact, beyond its limit, that a step without contacts has, m/s.
fn largest_approach(rig: &Rig, contacts: &[Constraint]) -> f64 {
    let free = rig.step(&mut []).step.state.twist;
    let approach = |(c, limit): (&Constraint, f64)| (c.normal.dot(free.velocity_at(c.arm)) - limit).abs();
    contacts.iter().zip(limits(rig, contacts)).map(approach).fold(0.0, f64::max)
}

#[test]
#[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
fn impulses_without_friction_meet_the_conditions() {
    let seed = 301;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut pushing, mut free, mut unconverged, mut worst) = (0, 0, 0, 0.0_f64);
    for case in 0..600 {
        let rig = Rig::random(&mut rng);
        let mut contacts = random_contacts(&mut rng, [3, 12, MAX_CONSTRAINTS][case % 3], 0.0);
        let step = rig.step(&mut contacts);
        assert!(step.step.status.failure.is_none() && !step.held_back, "seed {seed}, case {case}");
        unconverged += u32::from(step.step.status.unconverged);
        let (matrix, _) = rig.system();
        let off = residual(&rig, &contacts, &step);
        assert!(off < ASYMMETRY, "seed {seed}, case {case}: body equation off by {off}");
        let size = largest_approach(&rig, &contacts);
        for (contact, limit) in contacts.iter().zip(limits(&rig, &contacts)) {
            let impulse = contact.normal.dot(contact.impulse);
            let along = contact.impulse - contact.normal * impulse;
            assert!(impulse >= 0.0 && along.length() <= 1e-12 * impulse, "seed {seed}, case {case}");
            let yields = COMPLIANCE * mobility(&matrix, contact.arm, contact.normal) * impulse;
            let approach = contact.normal.dot(step.step.state.twist.velocity_at(contact.arm));
            let slack = limit - approach + yields;
            worst = worst.max(-slack / size).max(if impulse > 0.0 { slack / size } else { 0.0 });
            assert!(slack > -TOLERANCE * size, "seed {seed}, case {case}: closes by {slack} m/s");
            if impulse > 0.0 {
                assert!(
                    slack < TOLERANCE * size,
                    "seed {seed}, case {case}: pushes {slack} m/s before it closes"
                );
                pushing += 1;
            } else {
                free += 1;
            }
        }
    }
    println!("largest violation {worst:.1e} of the largest approach, {unconverged} searches did not end");
    assert!(unconverged == 0, "{unconverged} searches did not end");
    assert!(pushing > 500 && free > 500, "{pushing} push, {free} do not: the cases show nothing");
}

/// Violations of Coulomb's law by a contact after a step: how far its friction is outside of the cone, as a
/// velocity of the body; its slip if the friction is inside; and the slip across the friction if it is at the
/// limit, m/s.
fn violations(rig: &Rig, contact: &Constraint, twist: &Twist, inside: f64) -> (f64, f64, f64) {
    let (matrix, _) = rig.system();
    let normal = contact.normal.dot(contact.impulse);
    let along = contact.impulse - contact.normal * normal;
    let direction = along.normalize_or(contact.normal.any_orthonormal_vector());
    // In velocities, so that light bodies count as much as heavy ones.
    let over = (along.length() - contact.friction * normal) * mobility(&matrix, contact.arm, direction);
    let slip = (twist.velocity_at(contact.arm) - contact.velocity).reject_from(contact.normal);
    if over < -inside {
        return (over, slip.length(), 0.0);
    }
    // The body drags the surface along: the impulse on the body opposes the slip.
    let dragged = slip.dot(direction).max(0.0);
    (over, 0.0, if normal > 0.0 { (slip - direction * dragged).length() } else { 0.0 })
}

#[test]
#[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
fn friction_meets_coulombs_law() {
    let seed = 302;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut sticking, mut sliding, mut cold, mut unconverged, mut worst) = (0, 0, 0, 0, [0.0_f64; 3]);
    let cases = 800;
    for case in 0..cases {
        let mut rig = Rig::random(&mut rng);
        let friction = rng.random_range(0.05..0.8);
        let mut contacts = random_contacts(&mut rng, 6, friction);
        if case % 2 == 0 {
            // Pressed on surfaces that move slowly, so that some stick.
            rig.state.twist = Twist::ZERO;
            let pressed = |c: &mut Constraint| (c.gap, c.velocity) = (0.0, c.velocity * 1e-2);
            contacts.iter_mut().for_each(pressed);
        }
        let size = largest_approach(&rig, &contacts);
        let mut step = rig.step(&mut contacts).step;
        cold += u32::from(step.status.unconverged);
        for _ in 0..4 {
            step = rig.step(&mut contacts).step;
        }
        assert!(step.status.failure.is_none(), "seed {seed}, case {case}");
        let off = residual(&rig, &contacts, &ConstrainedStep::from(step));
        assert!(off < ASYMMETRY, "seed {seed}, case {case}: body equation off by {off}");
        if step.status.unconverged {
            unconverged += 1;
            continue;
        }
        for contact in contacts.iter().filter(|contact| contact.normal.dot(contact.impulse) > 0.0) {
            let inside = FRICTION_TOLERANCE * size;
            let (over, slip, across) = violations(&rig, contact, &step.state.twist, inside);
            for (worst, found) in worst.iter_mut().zip([over, slip, across]) {
                *worst = worst.max(found / size);
            }
            sticking += u32::from(over < -inside);
            sliding += u32::from(over >= -inside);
        }
    }
    println!(
        "outside of the cone {:.1e}, slip {:.1e}, across {:.1e} of the largest approach",
        worst[0], worst[1], worst[2]
    );
    println!(
        "{sticking} stick, {sliding} slide, {cold} of {cases} steps unconverged, {unconverged} if repeated"
    );
    assert!(worst[0] < FRICTION_TOLERANCE, "{worst:?}");
    assert!(worst[1] < 10.0 * FRICTION_TOLERANCE && worst[2] < 10.0 * FRICTION_TOLERANCE, "{worst:?}");
    assert!(sticking > 40 && sliding > 100, "{sticking} stick, {sliding} slide: the cases show nothing");
    // Random normals wedge the body more than surfaces do.
    assert!(unconverged * 8 < cases, "{unconverged} of {cases} unconverged");
}

/// Penalty contacts approach the constraints as their stiffness grows.
#[test]
fn stiff_penalty_contacts_approach_the_constraints() {
    let seed = 303;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut compared, mut errors, mut differs) = (0, [0.0_f64; 3], 0);
    for _ in 0..300 {
        let mut rig = Rig::random(&mut rng);
        let all = random_contacts(&mut rng, 3, 0.0);
        let mut contacts: Vec<_> =
            all.iter().map(|c| Constraint { gap: c.gap.abs(), velocity: DVec3::ZERO, ..*c }).collect();
        let free = rig.step(&mut []).step.state.twist;
        let held = rig.step(&mut contacts).step.state.twist;
        // Speeds of points at the contacts' distance, where a contact pushes.
        let apart =
            |a: &Twist, b: &Twist| (a.linear - b.linear).length() + 0.02 * (a.angular - b.angular).length();
        let pushed = apart(&free, &held);
        if pushed < 1e-3 {
            continue;
        }
        let mut softened = [0.0; 3];
        let mut settled = true;
        for (error, stiffness) in softened.iter_mut().zip([1e4, 1e6, 1e8]) {
            let parameters =
                ContactParameters { stiffness, damping: 0.0, tolerance: 0.0, friction: Friction::NONE };
            let found = contacts.iter().map(|c| {
                let point = rig.state.pose.translation + c.arm;
                Contact { point, scene_point: point + c.normal * c.gap, normal: c.normal, depth: -c.gap }
            });
            rig.contacts = LinearContactModel::from_contacts(found, &rig.state.pose, &parameters, 0.0);
            let step = semi_implicit_step(
                &rig.body,
                &rig.state,
                &rig.device,
                &rig.coupling,
                &rig.contacts,
                DVec3::ZERO,
                DT,
            );
            // A contact left to the next step is none here.
            settled &= step.status.is_ok() && !step.status.geometric_stiffness_dropped;
            *error = apart(&step.state.twist, &held) / pushed;
        }
        if settled {
            compared += 1;
            differs += u32::from(softened[2] > 0.05);
            for (sum, error) in errors.iter_mut().zip(softened) {
                *sum += error;
            }
        }
    }
    let [soft, _, stiff] = errors.map(|sum| sum / f64::from(compared));
    assert!(compared > 100, "{compared} compared");
    assert!(stiff < 0.01 && soft > 10.0 * stiff, "{errors:?} of {compared}");
    assert!(differs * 50 < compared, "{differs} of {compared} differ");
}
