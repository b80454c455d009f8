//! How a body responds to impulses, as its host's answers show.
//!
//! A body that stands on a floor does not give way as a free one does. R is the share of the expected changes
//! of velocity that the host's answers have shown lately: the solution of w = R u by least squares, for the
//! changes u of a free body with the impulses, and the changes w that the host told of. Both are what is left
//! of the velocity without its slow part. In coordinates z = (√m v, Lᵀ Qᵀ ω) with the inertia L Lᵀ in body
//! axes and the orientation Q, the kinetic energy is ½ ‖z‖², and R is symmetric with eigenvalues from 0 to 1,
//! as that of a body under constraints is. With R = 1 throughout, the hand would sink into a body on a floor
//! until the host answers; with R = 0, it would throw one that gives way.

use crate::algebra::eigen::{Matrix6, eigen};
use crate::algebra::linear_solve::inverse_definite;
use crate::algebra::vector::{Six, dot, identity};

/// Time over which responses are compared, in delays. With less, they are known less well; with more, a body
/// that comes free still counts as blocked.
const MEMORY: f64 = 4.0;

/// Velocity below which responses are not known, m/s at the device. With less, the noise of the host's
/// answers looks like a response; with more, bodies on a floor sink in further before they are known to
/// stand.
const NOISE: f64 = 3e-3;

/// What is known of how a body responds.
#[derive(Clone, Debug)]
pub(super) struct Response {
    /// Changes of velocity that the host has not told of yet, and what was to be seen of them so far.
    awaited: Six,
    expected: Six,
    /// Slow part of the host's velocity.
    slow: Six,
    /// Σ u uᵀ and Σ w uᵀ.
    squares: Matrix6,
    products: Matrix6,
    /// R = C Cᵀ.
    share: Matrix6,
    pub root: Matrix6,
}

impl Response {
    /// The response of a free body with a velocity.
    pub fn free(slow: Six) -> Self {
        Self {
            awaited: [0.0; 6],
            expected: [0.0; 6],
            slow,
            squares: [[0.0; 6]; 6],
            products: [[0.0; 6]; 6],
            share: identity(),
            root: identity(),
        }
    }

    /// What [`observe`](Self::observe) converges to where other forces would accelerate a free body by `load`
    /// and the host shows `seen` instead, with the velocity that it told of last.
    pub fn steady(load: &Six, seen: &Six, told: &Six, delay: f64) -> Self {
        let [expected, seen] = [load, seen].map(|rate| rate.map(|rate| rate * delay));
        let slow = std::array::from_fn(|index| told[index] - seen[index]);
        let outer = |rows: &Six| rows.map(|row| expected.map(|column| MEMORY * delay * row * column));
        let (squares, products) = (outer(&expected), outer(&seen));
        Self { awaited: expected, expected, squares, products, ..Self::free(slow) }
    }

    /// R z.
    pub fn shared(&self, z: &Six) -> Six {
        std::array::from_fn(|row| dot(&self.share[row], z))
    }

    /// Adds a step of `dt` (s) with impulses, an acceleration by other forces and the velocity that the host
    /// told of last.
    pub fn observe(&mut self, pushed: &Six, load: &Six, told: &Six, dt: f64, delay: f64) {
        let (share, memory) = ((dt / delay).min(1.0), (dt / (MEMORY * delay)).min(1.0));
        for index in 0..6 {
            self.awaited[index] += pushed[index] + load[index] * dt - self.awaited[index] * share;
            self.expected[index] += (self.awaited[index] - self.expected[index]) * share;
            self.slow[index] += (told[index] - self.slow[index]) * share;
        }
        for (row, (squares, products)) in self.squares.iter_mut().zip(&mut self.products).enumerate() {
            let (expected, seen) = (self.expected[row], told[row] - self.slow[row]);
            for (index, (square, product)) in squares.iter_mut().zip(products).enumerate() {
                *square += dt * expected * self.expected[index] - memory * *square;
                *product += dt * seen * self.expected[index] - memory * *product;
            }
        }
    }

    /// Finds R from what was seen, of a body with √m, times the scale of the world.
    pub fn update(&mut self, root_mass: f64, delay: f64) {
        // What is not known responds as a free body does.
        let unknown = (root_mass * NOISE).powi(2) * MEMORY * delay;
        let (mut squares, mut products) = (self.squares, self.products);
        for index in 0..6 {
            squares[index][index] += unknown;
            products[index][index] += unknown;
        }
        let Some(inverse) = inverse_definite(squares) else { return };
        let solution: Matrix6 = std::array::from_fn(|i| {
            std::array::from_fn(|j| (0..6).map(|k| products[i][k] * inverse[k][j]).sum())
        });
        let symmetric: Matrix6 =
            std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (solution[i][j] + solution[j][i])));
        let (values, vectors) = eigen(symmetric);
        let values = values.map(|value| value.clamp(0.0, 1.0));
        if values.iter().any(|value| value.is_nan()) {
            return;
        }
        self.root = std::array::from_fn(|i| std::array::from_fn(|k| vectors[i][k] * values[k].sqrt()));
        self.share = std::array::from_fn(|i| std::array::from_fn(|j| dot(&self.root[i], &self.root[j])));
    }
}
