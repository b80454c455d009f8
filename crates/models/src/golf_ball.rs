//! The golf ball of Table 3.2: a sphere of 21.335 mm with 332 spherical dimples.
//!
//! The dimples' centres are a Fibonacci lattice on the sphere, relaxed by mutual repulsion until the spacing
//! is even to a few per cent.

use std::sync::OnceLock;

use palpate_core::{
    TriMesh,
    glam::{DVec3, IVec3},
};

use crate::surface::{Surface, smooth_max, triangulate};

pub(crate) const MIN_TRIANGLES: usize = 500;

/// Radius of the ball, mm: half the least diameter that the rules of golf allow (42.67 mm).
const RADIUS: f64 = 21.335;
/// Number of dimples.
const DIMPLES: usize = 332;
/// Radius of a dimple's rim, mm.
const RIM: f64 = 1.85;
/// Depth of a dimple below the sphere, mm.
const DEPTH: f64 = 0.25;
/// Depth over which the rim is rounded, mm.
const ROUNDING: f64 = 0.06;

/// A golf ball about the origin, m.
pub(crate) fn build(triangles: usize) -> TriMesh {
    static BALL: OnceLock<GolfBall> = OnceLock::new();
    triangulate(BALL.get_or_init(GolfBall::new), triangles, 1e-3)
}

struct GolfBall {
    /// Unit vectors to the dimples' centres.
    dimples: Vec<DVec3>,
    /// For each cell of a grid over the cube [-1, 1]³, the dimples that may be the nearest for a direction
    /// in it.
    near: Vec<Vec<u16>>,
}

/// Cells along the grid's side.
const GRID: i32 = 16;

fn cell(direction: DVec3) -> IVec3 {
    ((direction + 1.0) * (0.5 * f64::from(GRID))).as_ivec3().clamp(IVec3::ZERO, IVec3::splat(GRID - 1))
}

fn index(cell: IVec3) -> usize {
    ((cell.z * GRID + cell.y) * GRID + cell.x) as usize
}

impl GolfBall {
    fn new() -> Self {
        let dimples = spread(DIMPLES);
        let mut near = vec![Vec::new(); (GRID * GRID * GRID) as usize];
        // A dimple matters within its rim; one more cell's diagonal covers the grid's coarseness.
        let reach = RIM / RADIUS + 3f64.sqrt() * 2.0 / f64::from(GRID);
        for z in 0..GRID {
            for y in 0..GRID {
                for x in 0..GRID {
                    let at = IVec3::new(x, y, z);
                    let middle = (at.as_dvec3() + 0.5) * (2.0 / f64::from(GRID)) - 1.0;
                    let cell = &mut near[index(at)];
                    cell.extend(
                        (0..DIMPLES as u16).filter(|d| dimples[*d as usize].distance(middle) < reach),
                    );
                }
            }
        }
        Self { dimples, near }
    }
}

impl Surface for GolfBall {
    fn value(&self, p: DVec3) -> f64 {
        let radius = p.length();
        let Some(direction) = p.try_normalize() else { return -RADIUS };
        let nearest = self.near[index(cell(direction))]
            .iter()
            .map(|d| direction.distance_squared(self.dimples[*d as usize]))
            .fold(f64::INFINITY, f64::min);
        // The dimple is a paraboloid, a sphere as nearly as makes no difference at this depth; both surfaces
        // are heights over the sphere, and the lower one counts.
        let x = nearest.min(0.04) * RADIUS * RADIUS / (RIM * RIM);
        let height = -smooth_max(0.0, DEPTH * (1.0 - x), ROUNDING) + smooth_max(0.0, -DEPTH, ROUNDING);
        radius - RADIUS - height
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        (DVec3::splat(-RADIUS), DVec3::splat(RADIUS))
    }

    fn feature(&self) -> f64 {
        2.0
    }
}

/// `n` unit vectors, spread evenly.
fn spread(n: usize) -> Vec<DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let mut points: Vec<DVec3> = (0..n)
        .map(|i| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
            let (sin, cos) = (golden * i as f64).sin_cos();
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * cos, r * sin, z)
        })
        .collect();
    let spacing = (8.0 * std::f64::consts::PI / 3f64.sqrt() / n as f64).sqrt();
    for round in 0..300 {
        // A steep repulsion of the nearest neighbours only; the step shrinks so that it settles.
        let step = spacing * 0.1 * (1.0 - f64::from(round) / 300.0);
        let moved: Vec<DVec3> = points
            .iter()
            .map(|p| {
                let push: DVec3 = points
                    .iter()
                    .map(|q| (*p - *q, p.distance_squared(*q) / (spacing * spacing)))
                    .filter(|(_, d)| *d > 0.0 && *d < 4.0)
                    .map(|(offset, d)| offset / spacing * d.powi(-4))
                    .sum();
                (*p + step * push.clamp_length_max(1.0)).normalize()
            })
            .collect();
        points = moved;
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dimples_do_not_overlap_and_leave_no_bald_spot() {
        let dimples = spread(DIMPLES);
        for (i, a) in dimples.iter().enumerate() {
            let others = dimples.iter().enumerate().filter(|(j, _)| *j != i);
            let nearest = RADIUS * others.map(|(_, b)| a.distance(*b)).fold(f64::INFINITY, f64::min);
            assert!((2.0 * RIM..2.6 * RIM).contains(&nearest), "dimple {i}: neighbour at {nearest} mm");
        }
    }
}
