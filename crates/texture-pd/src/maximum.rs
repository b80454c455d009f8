//! Depth and derivatives from what the kernels found around the largest overlap.

use std::f64::consts::TAU;

use glam::{DMat2, DMat3, DVec2, DVec3};

use crate::kernels::Answer;

pub(crate) type Matrix6 = [[f64; 6]; 6];

/// A depth with its derivatives by how A moves: along u, v and n, and about those axes through some point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LocalDepth {
    pub depth: f64,
    pub gradient: [f64; 6],
    pub second: Matrix6,
}

/// The smooth maximum, with its derivatives by turns about the frame's origin. `at` is the texel of the largest overlap
/// (m). None where all that overlaps most lies on the border of the grid or of the domain.
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

/// The jet whose slopes are the gradient's: A's where B ends and A does not.
fn reference_jet(answer: &Answer) -> [f32; 6] {
    if answer.ends == 2 { answer.jet_a } else { answer.jet_b }
}

/// The largest overlap between texels, and its derivatives by turns about the frame's origin. `at` is its texel (m).
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
    // φ = h_A − h_B over the grid: the way to its maximum, as far as it is curved towards one, and the inverse of its
    // curvature there.
    let slope = slope_a - slope_b;
    let (mut way, mut inverse) = (DVec2::ZERO, DMat2::ZERO);
    if answer.ends == 0 {
        for (value, axis) in crests(&(curvature_a - curvature_b)) {
            let along = -slope.dot(axis) / value;
            // Further away a neighbour would be higher, but for what the second order leaves out.
            if along.abs() <= 1.5 * step {
                way += axis * along;
                inverse += DMat2::from_cols(axis * (axis.x / value), axis * (axis.y / value));
            }
        }
    }
    let height = height + slope_a.dot(way) + 0.5 * way.dot(curvature_a * way);
    let point = (at + way).extend(height);
    let slope_there = slope_b + curvature_b * way;
    let mut local = LocalDepth {
        depth: depth + 0.5 * slope.dot(way),
        gradient: gradient(point, slope_there),
        second: second(point, slope_there, &curvature_b),
    };
    // How the gradient changes along A's surface.
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

/// Eigenvalues and unit eigenvectors of a symmetric matrix, of those that are negative and no thousandth of the other: along
/// a ridge there is no maximum to be found.
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

/// By how A moves, of the overlap at a point of A over B's height function with a slope.
fn gradient(point: DVec3, slope: DVec2) -> [f64; 6] {
    let linear = DVec3::new(-slope.x, -slope.y, 1.0);
    let angular = point.cross(linear);
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}

/// Its second derivatives.
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

/// Adds what a turn moves a point by in the second order, ½ θ × (θ × r), times a gradient.
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
    /// With derivatives by turns about `center` in place of the frame's origin.
    pub fn about(&self, center: DVec3) -> Self {
        // The origin moves by x + θ × a + ½ θ × (θ × a) with a = −center.
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

    /// Gradients by shift and turn, and second derivatives, in the axes that the frame's are given in.
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
