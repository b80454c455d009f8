//! Derivatives of a wrench by the body's placement and velocity, in 3×3 blocks.

use std::ops::{Add, AddAssign};

use glam::{DMat3, DVec3};
use palpate_core::{Twist, Wrench};

/// A 6×6 matrix that takes a motion (linear, angular) to a wrench (force, torque).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Block6 {
    /// Force by linear motion, N/m or N·s/m.
    pub force_linear: DMat3,
    /// Force by angular motion, N/rad or N·s/rad.
    pub force_angular: DMat3,
    /// Torque by linear motion, N or N·s.
    pub torque_linear: DMat3,
    /// Torque by angular motion, N·m/rad or N·m·s/rad.
    pub torque_angular: DMat3,
}

impl Block6 {
    /// All zero.
    pub const ZERO: Self = Self {
        force_linear: DMat3::ZERO,
        force_angular: DMat3::ZERO,
        torque_linear: DMat3::ZERO,
        torque_angular: DMat3::ZERO,
    };

    /// The wrench that a motion (a twist, or a displacement held in one) makes.
    pub fn apply(&self, motion: &Twist) -> Wrench {
        Wrench {
            force: self.force_linear * motion.linear + self.force_angular * motion.angular,
            torque: self.torque_linear * motion.linear + self.torque_angular * motion.angular,
        }
    }

    /// The outer product of a wrench direction (force part, torque part) with a row (linear part, angular
    /// part).
    pub(crate) fn outer(wrench: (DVec3, DVec3), row: (DVec3, DVec3)) -> Self {
        Self {
            force_linear: outer(wrench.0, row.0),
            force_angular: outer(wrench.0, row.1),
            torque_linear: outer(wrench.1, row.0),
            torque_angular: outer(wrench.1, row.1),
        }
    }
}

/// The matrix a bᵀ.
pub(crate) fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

impl Add for Block6 {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            force_linear: self.force_linear + other.force_linear,
            force_angular: self.force_angular + other.force_angular,
            torque_linear: self.torque_linear + other.torque_linear,
            torque_angular: self.torque_angular + other.torque_angular,
        }
    }
}

impl AddAssign for Block6 {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

/// First derivatives of a wrench on the body, about its centre of mass, in world axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WrenchJacobian {
    /// By the placement (δx, φ): x ← x + δx, R ← exp(φ*) R, at constant (v, ω).
    pub pose: Block6,
    /// By the velocity (v, ω).
    pub twist: Block6,
}

impl WrenchJacobian {
    /// All zero.
    pub const ZERO: Self = Self { pose: Block6::ZERO, twist: Block6::ZERO };
}

impl AddAssign for WrenchJacobian {
    fn add_assign(&mut self, other: Self) {
        self.pose += other.pose;
        self.twist += other.twist;
    }
}
