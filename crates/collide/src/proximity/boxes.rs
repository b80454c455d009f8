//! Oriented boxes around the triangles below each node, and a lower bound on the distance of two (Gottschalk, Lin and
//! Manocha 1996).
//!
//! A box is aligned with the principal axes of the points below. It is a looser bound than the hull where there is no
//! missing detail, but some ten times as cheap, so that it decides most pairs before a convex query is made. Boxes are
//! stored in single precision, and enlarged to stay conservative.

use palpate_core::Clod;
use palpate_core::glam::{DMat3, DVec3, Mat3, Vec3};

use crate::convex::Placement;

/// By how much of its size a box is enlarged for being stored in single precision.
const ENLARGED: f64 = 1e-6;

/// Sweeps of Jacobi's method; a few are enough for three axes.
const SWEEPS: usize = 12;

/// Squared sine below which the common normal of two boxes' edges is not tried: a face's normal is as good.
const PARALLEL: f64 = 1e-6;

/// A box, in its body's frame, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OrientedBox {
    center: DVec3,
    /// Unit axes, as columns.
    axes: Mat3,
    /// Half the lengths along the axes.
    half: Vec3,
}

impl OrientedBox {
    /// The boxes around the triangles below each node of a hierarchy.
    pub fn all(clod: &Clod) -> Vec<Self> {
        // The vertices of the leaves below a node are contiguous.
        let mut ranges: Vec<(u32, u32)> = vec![(0, 0); clod.nodes.len()];
        let mut boxes: Vec<Self> = Vec::with_capacity(clod.nodes.len());
        for (index, node) in clod.nodes.iter().enumerate().rev() {
            ranges[index] = if node.children.is_empty() {
                (node.vertices.start, node.vertices.end)
            } else {
                (ranges[node.children.start as usize].0, ranges[node.children.end as usize - 1].1)
            };
            let (start, end) = ranges[index];
            boxes.push(Self::around(&clod.vertices[start as usize..end as usize]));
        }
        boxes.reverse();
        boxes
    }

    /// The box around some points (m), at least one.
    fn around(points: &[DVec3]) -> Self {
        let mean = points.iter().sum::<DVec3>() / points.len() as f64;
        let mut covariance = DMat3::ZERO;
        for p in points {
            let p = *p - mean;
            covariance += DMat3::from_cols(p * p.x, p * p.y, p * p.z);
        }
        let axes = principal_axes(covariance).as_mat3();
        let wide = axes.as_dmat3().transpose();
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for p in points {
            let along = wide * (*p - mean);
            (low, high) = (low.min(along), high.max(along));
        }
        let half = (high - low) / 2.0;
        Self {
            center: mean + axes.as_dmat3() * ((low + high) / 2.0),
            axes,
            half: (half + ENLARGED * half.length()).as_vec3(),
        }
    }
}

/// Eigenvectors of a symmetric matrix, by Jacobi's rotations; orthonormal.
fn principal_axes(mut matrix: DMat3) -> DMat3 {
    let mut axes = DMat3::IDENTITY;
    for _ in 0..SWEEPS {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let off = matrix.col(q)[p];
            if off == 0.0 {
                continue;
            }
            let angle = 0.5 * (2.0 * off).atan2(matrix.col(q)[q] - matrix.col(p)[p]);
            let (sine, cosine) = angle.sin_cos();
            let mut turn = DMat3::IDENTITY;
            turn.col_mut(p)[p] = cosine;
            turn.col_mut(q)[q] = cosine;
            turn.col_mut(q)[p] = sine;
            turn.col_mut(p)[q] = -sine;
            matrix = turn.transpose() * matrix * turn;
            axes *= turn;
        }
    }
    axes
}

/// Lower bound on the distance of two boxes, m: the largest gap along the boxes' axes, and, where that is less than
/// `enough`, along their common normals. Negative where none separates them.
pub(crate) fn gap(a: &OrientedBox, b: &OrientedBox, placement: &Placement, enough: f64) -> f64 {
    let (axes_a, half_a, half_b) = (a.axes.as_dmat3(), a.half.as_dvec3(), b.half.as_dvec3());
    let to_a = axes_a.transpose();
    // b's axes and centre along a's axes.
    let turn = to_a * (placement.rotation * b.axes.as_dmat3());
    let center = to_a * (placement.point(b.center) - a.center);
    let turned = DMat3::from_cols(turn.x_axis.abs(), turn.y_axis.abs(), turn.z_axis.abs());
    let faces_a = center.abs() - half_a - turned * half_b;
    let back = turn.transpose();
    let faces_b = (back * center).abs() - half_b - turned.transpose() * half_a;
    let mut gap = faces_a.max(faces_b).max_element();
    if gap >= enough {
        return gap;
    }
    for i in 0..3 {
        let (u, v) = ((i + 1) % 3, (i + 2) % 3);
        for j in 0..3 {
            // Axis i of a crossed with axis j of b is (0, −b_v, b_u) in the order i, u, v.
            let (column, absolute) = (turn.col(j), turned.col(j));
            let square = column[u] * column[u] + column[v] * column[v];
            if square < PARALLEL {
                continue;
            }
            let apart = (center[v] * column[u] - center[u] * column[v]).abs();
            let of_a = half_a[u] * absolute[v] + half_a[v] * absolute[u];
            let (k, l) = ((j + 1) % 3, (j + 2) % 3);
            let of_b = half_b[k] * turned.col(l)[i] + half_b[l] * turned.col(k)[i];
            let excess = apart - of_a - of_b;
            if excess > 0.0 {
                gap = gap.max(excess / square.sqrt());
            }
        }
    }
    gap
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convex::{Hull, Limits, Start, gjk};
    use palpate_core::glam::DQuat;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    /// Never more than the distance of the points' hulls, and mostly not much less.
    #[test]
    fn the_gap_bounds_the_distance() {
        const SEED: u64 = 0xB0CE;
        let mut rng = StdRng::seed_from_u64(SEED);
        let (mut separated, mut sum) = (0, 0.0);
        for round in 0..3000 {
            let mut random = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0f64)));
            let (stretch, offset) = (random(), 1.7 * random());
            let flat = [1.0, 0.0, 1e-9][round % 3];
            let a: Vec<DVec3> = (0..12).map(|_| random() * stretch * DVec3::new(1.0, 1.0, flat)).collect();
            let turn = DQuat::from_scaled_axis(3.0 * random());
            let b: Vec<DVec3> = (0..12).map(|_| turn * (random() * stretch) + offset).collect();
            let placement = Placement {
                rotation: DMat3::from_quat(DQuat::from_scaled_axis(random())),
                translation: random(),
            };
            let limits = Limits { beyond: f64::INFINITY, share: 0.0, enough: -1.0, precision: 1e-12 };
            let exact =
                gjk::distance(&Hull::new(&a), &Hull::new(&b), &placement, Start::Axis(DVec3::X), &limits);
            let (box_a, box_b) = (OrientedBox::around(&a), OrientedBox::around(&b));
            let bound = gap(&box_a, &box_b, &placement, f64::INFINITY);
            assert!(bound <= exact.distance, "seed {SEED:#x}, round {round}: {bound} {}", exact.distance);
            if exact.distance > 0.5 {
                separated += 1;
                sum += bound / exact.distance;
            }
        }
        assert!(separated > 500 && sum > 0.6 * f64::from(separated), "{sum} of {separated}");
    }
}
