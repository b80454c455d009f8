//! The ellipsoid of §3.5.2 that explores the golf ball: strictly convex, with three different axes.
//!
//! The vertices lie in rings on a sphere, which is then stretched along its axes. Neighbouring rings are
//! joined as their convex hull, so that the mesh is the convex hull of its vertices; stretching keeps that.
//! Consecutive rings are turned against each other so that no four vertices share a plane, and the hull is
//! strictly convex.

use std::f64::consts::{PI, TAU};

use palpate_core::{TriMesh, glam::DVec3};

use crate::stitched::Stitched;

pub(crate) const MIN_TRIANGLES: usize = 60;

/// Half the lengths along x, y and z, mm; a golf ball's radius is 21.
const AXES: DVec3 = DVec3::new(16.0, 10.0, 7.5);

/// Numbers of vertices of the rings from pole to pole: `triangles / 2` in all, since each ring of n bounds 2
/// n triangles.
fn rings(triangles: usize) -> Vec<usize> {
    let vertices = triangles / 2;
    // Equilateral triangles of side a: rings 0.87 a apart, and 4π / (0.87 a²) vertices.
    let side = (4.0 * PI / (0.75_f64.sqrt() * vertices as f64)).sqrt();
    let count = ((PI / (0.75_f64.sqrt() * side)).round() as usize - 1).max(3);
    let weights: Vec<f64> = (1..=count).map(|ring| (PI * ring as f64 / (count + 1) as f64).sin()).collect();
    let share = vertices as f64 / weights.iter().sum::<f64>();
    // Rounding the running sum keeps the total exact.
    let mut sum = 0.0;
    let mut given = 0;
    weights
        .iter()
        .map(|weight| {
            sum += share * weight;
            let ring = (sum.round() as usize - given).max(3);
            given += ring;
            ring
        })
        .collect()
}

fn greatest_common_divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

pub(crate) fn build(triangles: usize) -> TriMesh {
    let counts = rings(triangles);
    let mut mesh = Stitched::default();
    let mut below: Option<(Vec<u32>, Vec<f64>)> = None;
    let south = mesh.vertex(-AXES * DVec3::X);
    let mut turned = 0.0;
    for (index, &count) in counts.iter().enumerate() {
        let polar = PI * (index + 1) as f64 / (counts.len() + 1) as f64;
        if let Some((_, turns)) = &below {
            // The middles of the edges of two rings come no closer than half of one step of their common
            // division.
            let before = turns.len();
            let common = before * count / greatest_common_divisor(before, count);
            turned += 0.5 / common as f64 + 0.5 / before as f64 - 0.5 / count as f64;
        }
        let turns: Vec<f64> = (0..count).map(|place| turned + place as f64 / count as f64).collect();
        let ring: Vec<u32> = turns
            .iter()
            .map(|turn| {
                let (sin, cos) = (TAU * turn).sin_cos();
                mesh.vertex(AXES * DVec3::new(-polar.cos(), polar.sin() * cos, polar.sin() * sin))
            })
            .collect();
        match &below {
            None => {
                for place in 0..count {
                    mesh.triangle([ring[(place + 1) % count], ring[place], south]);
                }
            }
            Some((lower, lower_turns)) => mesh.gather((lower, lower_turns), (&ring, &turns)),
        }
        below = Some((ring, turns));
    }
    let north = mesh.vertex(AXES * DVec3::X);
    if let Some((ring, _)) = below {
        for place in 0..ring.len() {
            mesh.triangle([ring[place], ring[(place + 1) % ring.len()], north]);
        }
    }
    mesh.finish(1e-3)
}
