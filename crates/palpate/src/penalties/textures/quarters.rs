//! The quarters of a contact's grid, and how those that find the same contact are joined.
//!
//! Surfaces may touch in several places of one grid: on both flanks of a groove, or at the corners of a face.
//! A single contact would let the body fall from one to the next, so the quarters of the grid are evaluated
//! on their own. Quarters that find the same contact, at their common corner, are joined. Contacts are the
//! same where the gradients of their depths are alike, by degrees, so that forces are continuous while one
//! contact splits into two.

use arrayvec::ArrayVec;
use palpate_dynamics::CurvedContact;
use palpate_texture_pd::{HalfSpace, TextureContact};

/// Number of quarters of a grid.
pub(super) const QUARTERS: usize = 4;

/// Distance by which a quarter reaches past the middle of the grid, in half sizes of the grid: overlaps near
/// the middle of the grid are not at the border of the quarter's own grid, where the texture depth fades out.
const OVERLAP: f64 = 0.25;

/// Distance between the gradients of two depths (turns at the body's lever) from which on they are two
/// contacts; below it they are joined in part.
const DISTINCT_GRADIENTS: f64 = 1.0;

/// Temperature of joining, in tolerances d, where the depth is the largest overlap alone (τ = 0).
const MIN_TEMPERATURE: f64 = 1e-3;

/// Share of a joined contact below which a quarter adds no contact of its own.
const MIN_SHARE: f64 = 1e-3;

/// The quarters of a grid.
pub(super) fn quarters(grid: &TextureContact) -> [TextureContact; QUARTERS] {
    let (u, v) = grid.normal.any_orthonormal_pair();
    let half_size = quarter_size(grid.half_size);
    [(u, v), (-u, v), (u, -v), (-u, -v)].map(|(u, v)| {
        let mut domain = grid.domain;
        for direction in [-u, -v] {
            // Where the domain has no room for another half-space, quarters overlap, and are joined there.
            let _ = domain.cut(HalfSpace { through: grid.point, direction });
        }
        let point = grid.point + (u + v) * (grid.half_size - half_size);
        TextureContact { point, half_size, domain, ..*grid }
    })
}

/// Half the side of a quarter's grid, m, from half the side of the whole grid.
pub(super) fn quarter_size(half_size: f64) -> f64 {
    0.5 * (1.0 + OVERLAP) * half_size
}

/// Joins the contact of each quarter with those that are like it, and gives its share of the stiffness.
///
/// With likenesses l_j and the temperature s, the joined depth is the smooth maximum δ = s ln Σ l_j exp(δ_j /
/// s). The weights w_j = l_j exp((δ_j − δ) / s) sum up to 1, the gradient is Σ w_j ∇δ_j, and the second
/// derivative Σ w_j (∇²δ_j + (∇δ_j − ∇δ)(∇δ_j − ∇δ)ᵀ / s). Four quarters that are all alike give the smooth
/// maximum over the whole grid, with its derivatives, in shares that sum up to 1.
pub(super) fn joined(
    quarters: &[CurvedContact],
    temperature: f64,
    tolerance: f64,
) -> ArrayVec<(CurvedContact, f64), QUARTERS> {
    let soft = temperature.max(MIN_TEMPERATURE * tolerance);
    let join = |own: &CurvedContact| {
        let likeness: ArrayVec<f64, QUARTERS> = quarters.iter().map(|other| likeness(own, other)).collect();
        let alike = || quarters.iter().zip(&likeness).filter(|(_, likeness)| **likeness > 0.0);
        // Exponents are of depths below the deepest, so that none overflows.
        let deepest = alike().fold(own.depth, |deepest, (other, _)| deepest.max(other.depth));
        let weight = |depth: f64| ((depth - deepest) / soft).exp();
        let total: f64 = alike().map(|(other, likeness)| likeness * weight(other.depth)).sum();
        let weighted = || alike().map(|(other, likeness)| (other, likeness * weight(other.depth) / total));
        let mut contact = CurvedContact {
            point: weighted().map(|(one, weight)| one.point * weight).sum(),
            depth: deepest + soft * total.ln(),
            linear: weighted().map(|(one, weight)| one.linear * weight).sum(),
            angular: weighted().map(|(one, weight)| one.angular * weight).sum(),
            second: [[0.0; 6]; 6],
            ..*own
        };
        for (one, weight) in weighted() {
            let (linear, angular) = (one.linear - contact.linear, one.angular - contact.angular);
            let apart = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
            for (i, row) in contact.second.iter_mut().enumerate() {
                for (j, value) in row.iter_mut().enumerate() {
                    *value += weight * (one.second[i][j] + apart[i] * apart[j] / soft);
                }
            }
        }
        (contact, weight(own.depth) / total)
    };
    quarters.iter().map(join).filter(|(_, share)| *share > MIN_SHARE).collect()
}

/// Likeness of two contacts: 1 where their depths have the same gradient, 0 from [`DISTINCT_GRADIENTS`] on,
/// smooth between.
fn likeness(a: &CurvedContact, b: &CurvedContact) -> f64 {
    let apart = (a.linear - b.linear).length().hypot((a.angular - b.angular).length() / a.lever);
    let alike = (1.0 - apart / DISTINCT_GRADIENTS).clamp(0.0, 1.0);
    alike * alike * (3.0 - 2.0 * alike)
}

#[cfg(test)]
mod tests {
    use palpate_core::Pose;
    use palpate_core::glam::DVec3;
    use palpate_texture_pd::{Domain, SurfaceSet};

    use super::*;

    /// Temperature and tolerance, m.
    const TAU: f64 = 1e-5;
    const TOLERANCE: f64 = 1e-3;

    fn contact(depth: f64, slope: f64) -> CurvedContact {
        CurvedContact {
            point: DVec3::new(depth, 0.0, 0.0),
            depth,
            linear: DVec3::new(slope, 0.0, -1.0),
            angular: DVec3::ZERO,
            second: [[0.0; 6]; 6],
            lever: 0.02,
        }
    }

    #[test]
    fn quarters_that_are_alike_are_one_contact_in_shares() {
        let depths = [2e-5, 1e-5, 0.0, -1e-5];
        let quarters = depths.map(|depth| contact(depth, 0.1));
        let joined = joined(&quarters, TAU, TOLERANCE);
        let smooth_maximum = TAU * depths.iter().map(|depth| (depth / TAU).exp()).sum::<f64>().ln();
        let shares: f64 = joined.iter().map(|(_, share)| share).sum();
        assert!((shares - 1.0).abs() < 1e-12, "{shares}");
        for (found, _) in &joined {
            assert!((found.depth - smooth_maximum).abs() < 1e-15, "{found:?}");
            assert!((found.linear - quarters[0].linear).length() < 1e-12);
        }
    }

    #[test]
    fn distinct_quarters_stay_contacts_of_their_own() {
        let quarters = [contact(2e-5, 0.8), contact(1e-5, -0.8)];
        let joined = joined(&quarters, TAU, TOLERANCE);
        assert_eq!(joined.len(), 2);
        for ((found, share), own) in joined.iter().zip(&quarters) {
            assert!((share - 1.0).abs() < 1e-12 && (found.depth - own.depth).abs() < 1e-15, "{found:?}");
        }
    }

    /// The total force is continuous while two flanks become one contact.
    #[test]
    fn total_depth_is_continuous_in_how_alike_quarters_are() {
        let total = |slope: f64| -> f64 {
            let quarters = [contact(2e-5, slope), contact(2e-5, -slope)];
            joined(&quarters, TAU, TOLERANCE).iter().map(|(found, share)| found.depth * share).sum()
        };
        let totals: Vec<f64> = (0..=1000).map(|i| total(0.6 * f64::from(i) / 1000.0)).collect();
        let range = totals[1000] - totals[0];
        let largest_step = totals.windows(2).map(|two| (two[1] - two[0]).abs()).fold(0.0, f64::max);
        assert!(range > 1e-5 && largest_step < 0.01 * range, "{range} {largest_step}");
    }

    /// The gradient is the derivative of the joined depth, and the second derivative that of the gradient.
    #[test]
    fn derivatives_are_those_of_the_joined_depth() {
        // Two linear depths along x: at x they are depth + slope x.
        let at = |x: f64| {
            let quarters =
                [(2e-5, 0.1), (1e-5, -0.1)].map(|(depth, slope)| contact(depth + slope * x, slope));
            joined(&quarters, TAU, TOLERANCE)[0].0
        };
        let h = 1e-8;
        let (here, up, down) = (at(0.0), at(h), at(-h));
        let slope = (up.depth - down.depth) / (2.0 * h);
        let curvature = (up.linear.x - down.linear.x) / (2.0 * h);
        assert!((here.linear.x - slope).abs() < 1e-6, "{} {slope}", here.linear.x);
        assert!((here.second[0][0] / curvature - 1.0).abs() < 1e-6, "{} {curvature}", here.second[0][0]);
    }

    #[test]
    fn quarters_cover_the_grid_and_overlap_at_its_middle() {
        let mut surfaces = SurfaceSet::default();
        let triangle = palpate_core::TriMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]);
        let surface = palpate_texture_pd::TexturedSurface::plain(&triangle.expect("a triangle"));
        let id = surfaces.add(&std::sync::Arc::new(surface.expect("a surface"))).expect("a surface");
        let grid = TextureContact {
            a: id,
            pose_a: Pose::IDENTITY,
            center: DVec3::ZERO,
            b: id,
            pose_b: Pose::IDENTITY,
            normal: DVec3::NEG_Z,
            point: DVec3::ZERO,
            half_size: 0.01,
            reach: 0.01,
            domain: Domain::WHOLE,
        };
        for quarter in quarters(&grid) {
            let offset = quarter.point - grid.point;
            let along = offset.abs().max_element();
            assert!((along + quarter.half_size - grid.half_size).abs() < 1e-15, "reaches the border");
            assert!((quarter.half_size - along - OVERLAP * grid.half_size).abs() < 1e-15, "{along}");
        }
    }
}
