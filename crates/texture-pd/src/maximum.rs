//! Depth and its derivatives from the kernels' answer for a pair.

use std::f64::consts::TAU;

use glam::{DMat2, DMat3, DVec2, DVec3};

use crate::kernels::Answer;

pub(crate) type Matrix6 = [[f64; 6]; 6];

/// A depth with its derivatives by the motion of A: translation along u, v and n, and rotation about those
/// axes through some point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LocalDepth {
    pub depth: f64,
    pub gradient: [f64; 6],
    pub second: Matrix6,
}

/// Returns the smooth maximum, with derivatives by rotations about the frame's origin. `at` is the texel of
/// the largest overlap (m). `None` if all texels that count lie on the border of the grid or of the domain,
/// where their weight is 0.
///
/// With weights w and gradients g over the texels, δ = δ_max + τ ln (Σ w · step² / 2 π τ ρ), ∇δ = ⟨g⟩ and
/// ∇²δ = ⟨∇²φ⟩ + cov(g) / τ, where ⟨ ⟩ is the weighted mean.
pub(crate) fn smooth(
    answer: &Answer,
    at: DVec2,
    temperature: f64,
    step: f64,
    half_size: f64,
) -> Option<LocalDepth> {
    let weight = f64::from(answer.weight);
    if weight <= 0.0 {
        return None;
    }
    let mean = |sum: f32| f64::from(sum) / weight;
    let [height, ..] = answer.jet_a.map(f64::from);
    let [_, slope_u, slope_v, ..] = reference_jet(answer).map(f64::from);
    let reference = gradient(at.extend(height), DVec2::new(slope_u, slope_v));
    // Gradients are summed relative to the largest overlap's: ⟨g⟩ = g₀ + ⟨g − g₀⟩.
    let shift = answer.gradient.map(mean);
    let area = TAU * temperature * half_size;
    let mut local = LocalDepth {
        depth: f64::from(answer.depth) + temperature * (weight * step * step / area).ln(),
        gradient: std::array::from_fn(|i| reference[i] + shift[i]),
        second: [[0.0; 6]; 6],
    };
    let mut entry = 0;
    for i in 0..6 {
        for j in i..6 {
            let covariance = mean(answer.spread[entry]) - shift[i] * shift[j];
            local.second[i][j] = mean(answer.curvature[entry]) + covariance / temperature;
            local.second[j][i] = local.second[i][j];
            entry += 1;
        }
    }
    Some(local)
}

/// Returns the derivatives of the surface whose slopes make the gradient: A's where B ends and A does not,
/// else B's.
fn reference_jet(answer: &Answer) -> [f32; 6] {
    if answer.ends == 2 { answer.jet_a } else { answer.jet_b }
}

/// Returns the largest overlap, refined between texels, with derivatives by rotations about the frame's
/// origin. `at` is its texel (m).
pub(crate) fn largest(answer: &Answer, at: DVec2, step: f64) -> LocalDepth {
    let [height, au, av, auu, auv, avv] = answer.jet_a.map(f64::from);
    let [_, bu, bv, buu, buv, bvv] = answer.jet_b.map(f64::from);
    let (slope_a, slope_b) = (DVec2::new(au, av), DVec2::new(bu, bv));
    let symmetric = |uu, uv, vv| DMat2::from_cols(DVec2::new(uu, uv), DVec2::new(uv, vv));
    let (curvature_a, curvature_b) = (symmetric(auu, auv, avv), symmetric(buu, buv, bvv));
    let depth = f64::from(answer.depth);
    if answer.ends == 2 {
        let gradient = gradient(at.extend(height), slope_a);
        return LocalDepth { depth, gradient, second: [[0.0; 6]; 6] };
    }
    // Newton's step s = −φ_ss⁻¹ φ_s to the maximum of φ = h_A − h_B over the grid, along the axes with
    // negative curvature only, and the inverse φ_ss⁻¹ there.
    let slope = slope_a - slope_b;
    let (mut offset, mut inverse) = (DVec2::ZERO, DMat2::ZERO);
    if answer.ends == 0 {
        for (value, axis) in crests(&(curvature_a - curvature_b)) {
            let along = -slope.dot(axis) / value;
            // A maximum farther away contradicts that this texel is the highest: the second order does not
            // hold there.
            if along.abs() <= 1.5 * step {
                offset += axis * along;
                inverse += DMat2::from_cols(axis * (axis.x / value), axis * (axis.y / value));
            }
        }
    }
    let height = height + slope_a.dot(offset) + 0.5 * offset.dot(curvature_a * offset);
    let point = (at + offset).extend(height);
    let slope_there = slope_b + curvature_b * offset;
    let mut local = LocalDepth {
        depth: depth + 0.5 * slope.dot(offset),
        gradient: gradient(point, slope_there),
        second: second(point, slope_there, &curvature_b),
    };
    // φ_qs: change of the gradient with the point's position s on A's surface. As the maximum moves with q,
    // the second derivative gains −φ_qs φ_ss⁻¹ φ_sq.
    let normal = DVec3::new(-slope_there.x, -slope_there.y, 1.0);
    let along = |axis: DVec2| {
        let tangent = axis.extend(slope_there.dot(axis));
        let change = (-(curvature_b * axis)).extend(0.0);
        let turn = tangent.cross(normal) + point.cross(change);
        [change.x, change.y, 0.0, turn.x, turn.y, turn.z]
    };
    let (by_u, by_v) = (along(DVec2::X), along(DVec2::Y));
    for i in 0..6 {
        let row = inverse * DVec2::new(by_u[i], by_v[i]);
        for j in 0..6 {
            local.second[i][j] -= row.dot(DVec2::new(by_u[j], by_v[j]));
        }
    }
    local
}

/// Returns the negative eigenvalues of a symmetric matrix, with unit eigenvectors. Those smaller in magnitude
/// than a thousandth of the other are left out: along a ridge there is no maximum.
fn crests(matrix: &DMat2) -> impl Iterator<Item = (f64, DVec2)> {
    let DMat2 { x_axis: DVec2 { x: a, y: b }, y_axis: DVec2 { y: c, .. } } = *matrix;
    let angle = 0.5 * (2.0 * b).atan2(a - c);
    let (mean, radius) = (0.5 * (a + c), (0.5 * (a - c)).hypot(b));
    let largest = mean.abs() + radius;
    let axis = DVec2::from_angle(angle);
    [(mean + radius, axis), (mean - radius, axis.perp())]
        .into_iter()
        .filter(move |(value, _)| *value < 0.0 && -value > 1e-3 * largest)
}

/// Returns the gradient of the overlap at a point r of A over B's height function: g = (−slope, 1) and r × g.
fn gradient(point: DVec3, slope: DVec2) -> [f64; 6] {
    let linear = DVec3::new(-slope.x, -slope.y, 1.0);
    let angular = point.cross(linear);
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}

/// Returns the second derivatives of that overlap: −Jᵀ ∇²h_B J, where J moves the point, and the turn's
/// second order.
fn second(point: DVec3, slope: DVec2, curvature: &DMat2) -> Matrix6 {
    let linear = DVec3::new(-slope.x, -slope.y, 1.0);
    let motion: [DVec3; 6] =
        std::array::from_fn(|i| if i < 3 { DVec3::AXES[i] } else { DVec3::AXES[i - 3].cross(point) });
    let mut second = [[0.0; 6]; 6];
    for (row, p) in second.iter_mut().zip(&motion) {
        for (value, q) in row.iter_mut().zip(&motion) {
            *value = -p.truncate().dot(*curvature * q.truncate());
        }
    }
    add_turns(&mut second, point, linear);
    second
}

/// Adds the second order of a rotation, which moves a point by ½ θ × (θ × r), times a gradient g:
/// ½ (r gᵀ + g rᵀ) − (r · g) 1.
fn add_turns(second: &mut Matrix6, arm: DVec3, linear: DVec3) {
    let (r, g) = (arm.to_array(), linear.to_array());
    for i in 0..3 {
        for j in 0..3 {
            second[3 + i][3 + j] +=
                0.5 * (r[i] * g[j] + g[i] * r[j]) - if i == j { arm.dot(linear) } else { 0.0 };
        }
    }
}

impl LocalDepth {
    /// Returns the depth with derivatives by rotations about `center` instead of the frame's origin.
    pub fn about(&self, center: DVec3) -> Self {
        // The frame's origin moves by x + θ × a + ½ θ × (θ × a) with a = −center: derivatives transform by
        // the columns of `map`, and the second order adds its own term.
        let arm = -center;
        let [x, y, z, ..] = self.gradient;
        let linear = DVec3::new(x, y, z);
        let map: [[f64; 6]; 6] = std::array::from_fn(|i| {
            let swept = if i < 3 { DVec3::AXES[i] } else { DVec3::AXES[i - 3].cross(arm) };
            let turn = if i < 3 { DVec3::ZERO } else { DVec3::AXES[i - 3] };
            [swept.x, swept.y, swept.z, turn.x, turn.y, turn.z]
        });
        let dot = |a: &[f64; 6], b: &[f64; 6]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut moved = Self { depth: self.depth, gradient: [0.0; 6], second: [[0.0; 6]; 6] };
        for i in 0..6 {
            moved.gradient[i] = dot(&map[i], &self.gradient);
            let row: [f64; 6] = std::array::from_fn(|k| dot(&map[i], &self.second[k]));
            moved.second[i] = map.map(|column| dot(&row, &column));
        }
        add_turns(&mut moved.second, arm, linear);
        moved
    }

    /// Returns the gradients by translation and rotation, and the second derivatives, in the axes in which
    /// the frame's axes are given.
    pub fn in_axes(&self, axes: &DMat3) -> (DVec3, DVec3, Matrix6) {
        let [a, b, c, d, e, f] = self.gradient;
        let mut second = [[0.0; 6]; 6];
        for (block_i, block_j) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
            let column =
                |j: usize| DVec3::from_array(std::array::from_fn(|i| self.second[block_i + i][block_j + j]));
            let turned = *axes * DMat3::from_cols(column(0), column(1), column(2)) * axes.transpose();
            for i in 0..3 {
                for j in 0..3 {
                    second[block_i + i][block_j + j] = turned.col(j)[i];
                }
            }
        }
        (*axes * DVec3::new(a, b, c), *axes * DVec3::new(d, e, f), second)
    }
}
