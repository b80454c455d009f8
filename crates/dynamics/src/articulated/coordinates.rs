//! The tool's coordinates (V, ω, q̇): the bodies' motion by them, and the linear system in them.

use glam::{DMat3, DVec3};
use palpate_core::Twist;

use super::linkage::Linkage;
use crate::algebra::linear_solve::{solve, solve_definite};
use crate::algebra::rotation::{skew, skew_skew};
use crate::system::{Linear, six};

/// A 6×7 matrix that takes (V, ω, q̇) to a body's twist.
pub(super) type Columns = [[f64; 7]; 6];

/// A tool's velocities (V, ω, q̇) or their changes.
#[derive(Clone, Copy, Default)]
pub(super) struct Motion {
    pub linear: DVec3,
    pub angular: DVec3,
    pub rate: f64,
}

impl Motion {
    /// The sum with a multiple of another one.
    pub fn plus(&self, other: &Self, share: f64) -> Self {
        Self {
            linear: self.linear + other.linear * share,
            angular: self.angular + other.angular * share,
            rate: self.rate + other.rate * share,
        }
    }

    pub fn from_array([vx, vy, vz, wx, wy, wz, rate]: [f64; 7]) -> Self {
        Self { linear: DVec3::new(vx, vy, vz), angular: DVec3::new(wx, wy, wz), rate }
    }
}

/// Motion of one body by the tool's coordinates: J and S.
#[derive(Clone, Copy)]
pub(super) struct Follower {
    /// c, m.
    pub centre: DVec3,
    /// s: velocity of the body's centre of mass by the rate of the hinge, a share of e × b, m/rad.
    pub sweep: DVec3,
    /// e for the second body, zero for the first.
    pub axis: DVec3,
    /// J.
    pub columns: Columns,
    /// S, the derivative of J u_0 by the placement: its linear part by the rotation φ and by the angle q,
    /// its angular part by φ.
    turning: (DMat3, DVec3, DMat3),
}

impl Follower {
    pub fn new(linkage: &Linkage, [centre, sweep, axis]: [DVec3; 3], start: &Motion) -> Self {
        let (angular, rate) = (start.angular, start.rate);
        // v = V + ω × c + q̇ s and the angular velocity ω + q̇ e.
        let mut columns = [[0.0; 7]; 6];
        for (i, unit) in DVec3::AXES.into_iter().enumerate() {
            let by_turn = unit.cross(centre);
            for (j, row) in columns.iter_mut().enumerate().take(3) {
                row[i] = f64::from(i == j);
                row[3 + i] = by_turn[j];
            }
            columns[3 + i][3 + i] = 1.0;
            columns[i][6] = sweep[i];
            columns[3 + i][6] = axis[i];
        }
        // By φ the linear part changes by ω × (φ × c) + q̇ φ × s and the angular one by q̇ φ × e; by q the
        // linear part changes by ω × s + q̇ e × s.
        let by_turn = skew_skew(angular, centre) * -1.0 - skew(sweep) * rate;
        let by_angle = angular.cross(sweep) + linkage.axis.cross(sweep) * rate;
        let spin_by_turn = skew(axis) * -rate;
        Self { centre, sweep, axis, columns, turning: (by_turn, by_angle, spin_by_turn) }
    }

    /// h S u.
    pub fn arc(&self, motion: &Motion, dt: f64) -> Twist {
        let (by_turn, by_angle, spin_by_turn) = &self.turning;
        Twist {
            linear: (*by_turn * motion.angular + *by_angle * motion.rate) * dt,
            angular: *spin_by_turn * motion.angular * dt,
        }
    }

    /// J + h S.
    pub fn columns_at_end(&self, dt: f64) -> Columns {
        let (by_turn, by_angle, spin_by_turn) = &self.turning;
        let mut columns = self.columns;
        for i in 0..3 {
            for j in 0..3 {
                columns[i][3 + j] += dt * by_turn.col(j)[i];
                columns[3 + i][3 + j] += dt * spin_by_turn.col(j)[i];
            }
            columns[i][6] += dt * by_angle[i];
        }
        columns
    }

    /// J u.
    pub fn follow(&self, motion: &Motion) -> Twist {
        Twist {
            linear: motion.linear + motion.angular.cross(self.centre) + self.sweep * motion.rate,
            angular: motion.angular + self.axis * motion.rate,
        }
    }
}

/// The matrix and right-hand side of a linear system in (V, ω, q̇).
pub(super) struct Linear7 {
    pub matrix: [[f64; 7]; 7],
    pub right: [f64; 7],
}

impl Linear7 {
    /// Adds blocks in the rows and columns of ω and q̇.
    pub fn add_turning(&mut self, turning: &DMat3, by_rate: DVec3, hinge_by_turn: DVec3, hinge: f64) {
        for i in 0..3 {
            for j in 0..3 {
                self.matrix[3 + i][3 + j] += turning.col(j)[i];
            }
            self.matrix[3 + i][6] += by_rate[i];
            self.matrix[6][3 + i] += hinge_by_turn[i];
        }
        self.matrix[6][6] += hinge;
    }

    /// Adds a body's system A, r, with J = `columns` and J + h S = `at_end`: Jᵀ A (J + h S) on the left and
    /// Jᵀ (r − A · arc) on the right, arc = h S u_0.
    pub fn add_follower(&mut self, body: &Linear, columns: &Columns, at_end: &Columns, arc: &Twist) {
        let arc = six(arc.linear, arc.angular);
        let mut product = [[0.0; 7]; 6];
        let mut load = body.right;
        for (i, row) in body.matrix.iter().enumerate() {
            for (value, along) in row.iter().zip(at_end) {
                for (entry, column) in product[i].iter_mut().zip(along) {
                    *entry += value * column;
                }
            }
            load[i] -= row.iter().zip(arc).map(|(value, along)| value * along).sum::<f64>();
        }
        for (column, (row, load)) in columns.iter().zip(product.iter().zip(load)) {
            for (i, share) in column.iter().enumerate() {
                for (entry, value) in self.matrix[i].iter_mut().zip(row) {
                    *entry += share * value;
                }
                self.right[i] += share * load;
            }
        }
    }

    pub fn solution(&self, definite: bool) -> Option<[f64; 7]> {
        let quick = if definite { solve_definite(self.matrix, self.right) } else { None };
        quick.or_else(|| solve(self.matrix, self.right))
    }
}

/// A vector of seven components: linear, angular and hinge.
pub(super) fn seven(linear: DVec3, angular: DVec3, hinge: f64) -> [f64; 7] {
    let [a, b, c, d, e, f] = six(linear, angular);
    [a, b, c, d, e, f, hinge]
}
