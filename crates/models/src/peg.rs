//! A round peg and a block with a hole that it fits, both with a chamfer.

use std::f64::consts::{PI, TAU};

use palpate_core::{TriMesh, glam::DVec3};

use crate::stitched::{Cap, Stitched, cells, fit, reversed};
use crate::{MAX_TRIANGLES, ModelError};

pub(crate) const MIN_TRIANGLES: usize = 800;

/// Fewest corners of the polygons that stand for circles.
const MIN_CORNERS: usize = 16;

/// Dimensions of a peg and its hole, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PegFit {
    /// Diameter of the peg.
    pub diameter: f64,
    /// Difference of the radii of hole and peg.
    pub clearance: f64,
    /// Length of the peg.
    pub length: f64,
    /// Depth of the hole, which goes through its block.
    pub depth: f64,
    /// Length and width of the chamfers at the peg's tip and at the hole's mouth, 45°.
    pub chamfer: f64,
}

impl PegFit {
    /// A peg of 8 mm with a loose fit: 0.05 mm of clearance all around.
    pub const LOOSE_8_MM: Self =
        Self { diameter: 0.008, clearance: 0.05e-3, length: 0.03, depth: 0.02, chamfer: 0.5e-3 };

    /// Generates the peg with about `triangles` triangles. It stands on its tip at the origin, along z. The
    /// vertices are on the cylinder, so that no part of the peg is beyond it.
    ///
    /// # Errors
    /// If the dimensions are not those of a peg and a hole, or the number of triangles is out of range.
    pub fn peg(&self, triangles: usize) -> Result<TriMesh, ModelError> {
        self.check("peg", triangles)?;
        Ok(peg(self, triangles))
    }

    /// Generates a round block with the hole, with about `triangles` triangles. Its mouth is at z = 0, about
    /// the origin; the block reaches down from there. The middles of the bore's edges are on the cylinder, so
    /// that the clearance is never less than stated.
    ///
    /// # Errors
    /// As [`PegFit::peg`].
    pub fn hole(&self, triangles: usize) -> Result<TriMesh, ModelError> {
        self.check("hole", triangles)?;
        Ok(hole(self, triangles))
    }

    fn check(&self, model: &'static str, asked: usize) -> Result<(), ModelError> {
        let parts =
            |length: f64, low: f64, high: f64| (low * self.diameter..=high * self.diameter).contains(&length);
        let sound = (1e-4..=1.0).contains(&self.diameter)
            && parts(self.clearance, 0.0, 0.5)
            && parts(self.length, 0.5, 10.0)
            && parts(self.depth, 0.5, 10.0)
            && parts(self.chamfer, 0.01, 0.2);
        if !sound {
            let expected = "a diameter of 0.1 mm to 1 m; in diameters, a clearance of up to 0.5, a length and a \
                            depth of 0.5 to 10, and a chamfer of 0.01 to 0.2";
            return Err(ModelError::Dimensions { model, expected });
        }
        if !(MIN_TRIANGLES..=MAX_TRIANGLES).contains(&asked) {
            return Err(ModelError::OutOfRange { model, asked, min: MIN_TRIANGLES, max: MAX_TRIANGLES });
        }
        Ok(())
    }
}

fn around_axis(radius: f64, turn: f64, z: f64) -> DVec3 {
    let (sin, cos) = (TAU * turn).sin_cos();
    DVec3::new(radius * cos, radius * sin, z)
}

/// Divides surfaces of revolution: corners around, and rows along the length.
fn divide(fit: &PegFit, length: f64, edge: f64, stretch: f64) -> (usize, usize) {
    let around = cells(1e3 * PI * fit.diameter, edge * stretch, MIN_CORNERS);
    (around, cells(1e3 * length, 4.0 * edge / stretch, 1))
}

fn cap(around: usize) -> Cap {
    Cap::new(around, (around as f64 / TAU).round() as usize)
}

pub(crate) fn peg(dimensions: &PegFit, triangles: usize) -> TriMesh {
    let [radius, length, chamfer] =
        [0.5 * dimensions.diameter, dimensions.length, dimensions.chamfer].map(|length| 1e3 * length);
    let (around, rows) = fit(
        triangles,
        TAU * radius * (length + radius),
        |edge, stretch| divide(dimensions, dimensions.length, edge, stretch),
        |&(around, rows)| 2 * around * (rows + 1) + 2 * cap(around).triangles(),
    );
    let turn = |index: usize| index as f64 / around as f64;
    let mut mesh = Stitched::default();
    let tip = mesh.ring(around, |turn| around_axis(radius - chamfer, turn, 0.0));
    let shoulder = mesh.tube(&tip, 1, |_, index| around_axis(radius, turn(index), chamfer));
    let end = mesh.tube(&shoulder, rows, |row, index| {
        around_axis(radius, turn(index), chamfer + (length - chamfer) * row as f64 / rows as f64)
    });
    mesh.cap(&end, &cap(around), |part, turn| around_axis(part * radius, turn, length));
    mesh.cap(&reversed(&tip), &cap(around), |part, turn| {
        around_axis(part * (radius - chamfer), 1.0 - turn, 0.0)
    });
    mesh.finish(1e-3)
}

pub(crate) fn hole(dimensions: &PegFit, triangles: usize) -> TriMesh {
    let bore = 1e3 * (0.5 * dimensions.diameter + dimensions.clearance);
    let [outer, depth, chamfer] =
        [1.5 * dimensions.diameter, dimensions.depth, dimensions.chamfer].map(|length| 1e3 * length);
    // Rows across a face of the block; outside and inside have equally many along its depth.
    let across = |around: usize| cells(outer - bore, 2.0 * TAU * outer / around as f64, 1);
    let (around, rows) = fit(
        triangles,
        TAU * (outer + bore) * (depth + outer - bore),
        |edge, stretch| divide(dimensions, dimensions.depth, edge, stretch),
        |&(around, rows)| 2 * around * (2 * rows + 1 + 2 * across(around)),
    );
    let across = across(around);
    let stretch = 1.0 / (PI / around as f64).cos();
    let at =
        |radius: f64, index: usize, z: f64| around_axis(stretch * radius, index as f64 / around as f64, z);
    let part = |row: usize, of: usize| row as f64 / of as f64;
    let mut mesh = Stitched::default();
    let low = mesh.ring(around, |turn| around_axis(stretch * outer, turn, -depth));
    let rim = mesh.tube(&low, rows, |row, index| at(outer, index, -depth + depth * part(row, rows)));
    let mouth = mesh.tube(&rim, across, |row, index| {
        at(outer + (bore + chamfer - outer) * part(row, across), index, 0.0)
    });
    let throat = mesh.tube(&mouth, 1, |_, index| at(bore, index, -chamfer));
    let foot = mesh
        .tube(&throat, rows, |row, index| at(bore, index, -chamfer + (chamfer - depth) * part(row, rows)));
    let below = mesh
        .tube(&foot, across - 1, |row, index| at(bore + (outer - bore) * part(row, across), index, -depth));
    mesh.band(&below, &low);
    mesh.finish(1e-3)
}
