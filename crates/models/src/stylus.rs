//! The probe of §5.5.4: a cylinder 10 cm long with a spherical tip of 1 cm radius. It stands upright; the
//! tip's centre is the origin.

use std::f64::consts::{FRAC_PI_2, TAU};

use palpate_core::{TriMesh, glam::DVec3};

use crate::stitched::{Stitched, cells, fit};

pub(crate) const MIN_TRIANGLES: usize = 60;

/// Radius, and length of the straight part, mm.
const RADIUS: f64 = 10.0;
const LENGTH: f64 = 90.0;

/// Steps around, and from pole to pole: along the tip, the side and the end.
struct Plan {
    around: usize,
    rows: [usize; 3],
}

impl Plan {
    fn new(edge: f64, stretch: f64) -> Self {
        let rows = [FRAC_PI_2 * RADIUS, LENGTH, RADIUS].map(|length| cells(length, edge * stretch, 1));
        Self { around: cells(TAU * RADIUS, edge / stretch, 5), rows }
    }

    fn triangles(&self) -> usize {
        2 * self.around * (self.rows.iter().sum::<usize>() - 1)
    }

    /// Radius and height of the rings between the poles, from below.
    fn rings(&self) -> Vec<(f64, f64)> {
        let [tip, side, end] = self.rows;
        let part = |row: usize, of: usize| row as f64 / of as f64;
        let tip = (1..=tip).map(|row| {
            let (sin, cos) = (FRAC_PI_2 * part(row, tip)).sin_cos();
            (RADIUS * sin, -RADIUS * cos)
        });
        let side = (1..=side).map(|row| (RADIUS, LENGTH * part(row, side)));
        let end = (1..end).map(|row| (RADIUS * (1.0 - part(row, end)), LENGTH));
        tip.chain(side).chain(end).collect()
    }
}

pub(crate) fn build(triangles: usize) -> TriMesh {
    let area = TAU * RADIUS * (RADIUS + LENGTH + 0.5 * RADIUS);
    let plan = fit(triangles, area, Plan::new, Plan::triangles);
    let mut mesh = Stitched::default();
    let below = mesh.vertex(DVec3::NEG_Z * RADIUS);
    let rings: Vec<Vec<u32>> = plan
        .rings()
        .into_iter()
        .map(|(radius, height)| {
            mesh.ring(plan.around, |turn| {
                let (sin, cos) = (TAU * turn).sin_cos();
                DVec3::new(radius * cos, radius * sin, height)
            })
        })
        .collect();
    let above = mesh.vertex(DVec3::Z * LENGTH);
    rings.windows(2).for_each(|pair| mesh.band(&pair[0], &pair[1]));
    let next = |index: usize| (index + 1) % plan.around;
    if let (Some(first), Some(last)) = (rings.first(), rings.last()) {
        for index in 0..plan.around {
            mesh.triangle([first[next(index)], first[index], below]);
            mesh.triangle([last[index], last[next(index)], above]);
        }
    }
    mesh.finish(1e-3)
}
