//! Derivatives by central differences, and random states, that the tests of the analytic Jacobians share.

use glam::{DMat3, DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};
use rand::{RngExt as _, rngs::StdRng};

use crate::body::BodyState;
use crate::jacobian::{Block6, WrenchJacobian};

pub(crate) fn random_vector(rng: &mut StdRng, size: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-size..size)))
}

pub(crate) fn random_direction(rng: &mut StdRng) -> DVec3 {
    loop {
        let v = random_vector(rng, 1.0);
        if (0.01..1.0).contains(&v.length_squared()) {
            return v.normalize();
        }
    }
}

/// A placement anywhere within `size` (m), turned by up to π.
pub(crate) fn random_pose(rng: &mut StdRng, size: f64) -> Pose {
    let turn = random_direction(rng) * rng.random_range(0.0..std::f64::consts::PI);
    Pose::new(random_vector(rng, size), DQuat::from_scaled_axis(turn))
}

pub(crate) fn random_twist(rng: &mut StdRng, linear: f64, angular: f64) -> Twist {
    Twist::new(random_vector(rng, linear), random_vector(rng, angular))
}

/// Five-point central difference at 0, of order h⁴.
pub(crate) fn derivative(f: impl Fn(f64) -> Wrench, h: f64) -> Wrench {
    ((f(h) - f(-h)) * 8.0 - (f(2.0 * h) - f(-2.0 * h))) * (1.0 / (12.0 * h))
}

/// The derivatives of a wrench by placement and velocity, by central differences.
pub(crate) fn wrench_jacobian(f: impl Fn(&BodyState) -> Wrench, at: &BodyState) -> WrenchJacobian {
    let (h_pose, h_twist) = (3e-4, 1e-1);
    let by = |motion: Twist| derivative(|s| f(&BodyState { pose: at.pose.moved(&motion, s), ..*at }), h_pose);
    let pose = block(|e| by(Twist::new(e, DVec3::ZERO)), |e| by(Twist::new(DVec3::ZERO, e)));
    let by = |linear: DVec3, angular: DVec3| {
        derivative(
            |s| {
                let twist = Twist::new(at.twist.linear + linear * s, at.twist.angular + angular * s);
                f(&BodyState { twist, ..*at })
            },
            h_twist,
        )
    };
    let twist = block(|e| by(e, DVec3::ZERO), |e| by(DVec3::ZERO, e));
    WrenchJacobian { pose, twist }
}

fn block(linear: impl Fn(DVec3) -> Wrench, angular: impl Fn(DVec3) -> Wrench) -> Block6 {
    let l = DVec3::AXES.map(linear);
    let a = DVec3::AXES.map(angular);
    Block6 {
        force_linear: DMat3::from_cols(l[0].force, l[1].force, l[2].force),
        force_angular: DMat3::from_cols(a[0].force, a[1].force, a[2].force),
        torque_linear: DMat3::from_cols(l[0].torque, l[1].torque, l[2].torque),
        torque_angular: DMat3::from_cols(a[0].torque, a[1].torque, a[2].torque),
    }
}

pub(crate) fn largest(m: &DMat3) -> f64 {
    m.to_cols_array().iter().fold(0.0, |most: f64, x| most.max(x.abs()))
}

/// The largest error of any 3×3 block, relative to that block's own largest entry.
pub(crate) fn relative_error(found: &WrenchJacobian, expected: &WrenchJacobian) -> f64 {
    let blocks = |j: &WrenchJacobian| {
        [j.pose, j.twist].map(|b| [b.force_linear, b.force_angular, b.torque_linear, b.torque_angular])
    };
    let (found, expected) = (blocks(found), blocks(expected));
    let mut worst: f64 = 0.0;
    for (f, e) in found.as_flattened().iter().zip(expected.as_flattened()) {
        let size = largest(e).max(largest(f));
        if size > 0.0 {
            worst = worst.max(largest(&(*f - *e)) / size);
        }
    }
    worst
}
