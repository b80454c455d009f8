//! The penalty force of textured contacts (§4.3.2) and its derivatives (§5.4.4).
//!
//! A contact stores the energy U = ½ k (δ_n + d)² while δ_n + d > 0 (Eq. 4.4, begun at the distance d as all
//! contacts are, §5.4.3). Force and torque on the moving surface A are −∇U: with g = ∇δ_n,
//!
//! (F, T) = −k (δ_n + d) g,  ∂(F, T)/∂(x, θ) = −k (g gᵀ + (δ_n + d) ∇²δ_n)  (Eqs. 4.5, 5.51–5.56).
//!
//! The tangential forces are proportional to the normal force, as perceived roughness is. Forces of contacts
//! add up.
//!
//! Across the crest of a ridge the energy falls to both sides, so the second term is a negative stiffness
//! there. An implicit integration step has to leave such directions out.

use palpate_core::Wrench;

use crate::depth::TextureDepth;
use crate::maximum::Matrix6;

/// Force of a textured contact on the moving surface A.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureForce {
    /// Stored energy U, J.
    pub energy: f64,
    /// Wrench on A about the contact's `center`, world axes.
    pub wrench: Wrench,
    /// Stiffness against a translation and rotation of A: −∂(F, T)/∂(x, θ), N/m, N and N·m; symmetric.
    pub stiffness: Matrix6,
}

impl TextureForce {
    /// Computes the force of a contact with stiffness k (N/m) that begins at the distance d (m, `tolerance`).
    pub fn new(found: &TextureDepth, stiffness: f64, tolerance: f64) -> Self {
        // k (δ_n + d), and k as long as the contact pushes.
        let overlap = (found.depth + tolerance).max(0.0);
        let push = stiffness * overlap;
        let gradient = [found.linear.to_array(), found.angular.to_array()].concat();
        let share = if overlap > 0.0 { stiffness } else { 0.0 };
        Self {
            energy: 0.5 * push * overlap,
            wrench: Wrench { force: found.linear * -push, torque: found.angular * -push },
            stiffness: std::array::from_fn(|i| {
                std::array::from_fn(|j| share * gradient[i] * gradient[j] + push * found.second[i][j])
            }),
        }
    }
}

/// Sums up the wrenches of contacts (§4.3.2). Contacts without a depth add nothing.
pub fn sum_of_forces<'a>(
    depths: impl IntoIterator<Item = &'a Option<TextureDepth>>,
    stiffness: f64,
    tolerance: f64,
) -> Wrench {
    depths.into_iter().flatten().fold(Wrench::ZERO, |mut sum, found| {
        sum += TextureForce::new(found, stiffness, tolerance).wrench;
        sum
    })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;

    fn random_depth(rng: &mut StdRng) -> TextureDepth {
        let mut vector =
            |most: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-most..most)));
        let (linear, angular, point) = (vector(1.0), vector(0.05), vector(0.1));
        let lever = |k: usize| if k < 3 { 1.0 } else { 0.05 };
        let values: Matrix6 =
            std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-200.0..200.0)));
        let second = std::array::from_fn(|i| {
            std::array::from_fn(|j| values[i.max(j)][i.min(j)] * lever(i) * lever(j))
        });
        let depth = rng.random_range(-0.001..0.003);
        TextureDepth { depth, linear, angular, second, point, scene_point: point, folded: 0.0 }
    }

    #[test]
    fn separated_contact_exerts_no_force() {
        let mut rng = StdRng::seed_from_u64(83);
        let apart = TextureDepth { depth: -0.001, ..random_depth(&mut rng) };
        let force = TextureForce::new(&apart, 1000.0, 0.0005);
        assert_eq!((force.energy, force.wrench.force, force.stiffness), (0.0, DVec3::ZERO, [[0.0; 6]; 6]));
        let deep = TextureDepth { depth: 0.001, ..apart };
        let sum = sum_of_forces(&[Some(apart), None, Some(deep), Some(deep)], 1000.0, 0.0005);
        let one = TextureForce::new(&deep, 1000.0, 0.0005).wrench;
        assert!((sum.force - one.force * 2.0).length() < 1e-12 && one.force.length() > 0.1);
    }
}
