//! The interlocking ball joint of Table 3.2 and Fig. 3.13.
//!
//! The ball is a knob of 30 mm with shallow lobes, on a stem with a flange and a screw thread; it points up
//! (+z). The socket's cavity is the knob's own shape, widened by [`CLEARANCE`], and reaches [`RIM`] below the
//! ball's equator, so that it holds the ball; its stem points up. Both have the knob's centre as origin: with
//! identical poses the joint is assembled and nothing touches. Tilting it far brings the stem against the
//! rim; turning it brings lobe against lobe, since the lobes are higher than the clearance.

use palpate_core::{TriMesh, glam::DVec3};

use crate::surface::{Surface, smooth_max, smooth_min, triangulate};

pub(crate) const MIN_TRIANGLES: usize = 3_000;

/// Mean radius of the knob, mm.
const RADIUS: f64 = 30.0;
/// Height of the lobes over the mean radius (and depth of the valleys), mm.
const LOBE: f64 = 0.5;
/// Lobes around the axis.
const LOBES: f64 = 8.0;
/// Gap between knob and cavity when assembled, mm.
const CLEARANCE: f64 = 0.6;
/// Distance of the socket's rim below the equator, mm.
const RIM: f64 = 11.0;
/// Outer radius of the socket's cup, mm.
const CUP: f64 = 39.0;
/// From the knob's centre to the stems' ends, mm.
const END: f64 = 92.0;

/// The ball half, m; the knob's centre is the origin, the stem points down (−z).
pub(crate) fn ball(triangles: usize) -> TriMesh {
    triangulate(&Ball, triangles, 1e-3)
}

/// The socket half, m; the cavity's centre is the origin, the stem points up (+z).
pub(crate) fn socket(triangles: usize) -> TriMesh {
    triangulate(&Socket, triangles, 1e-3)
}

struct Ball;
struct Socket;

fn knob(p: DVec3) -> f64 {
    let r = p.length();
    if r < 1.0 {
        return -RADIUS;
    }
    let around = p.x.hypot(p.y);
    r - RADIUS - LOBE * (around / r).powi(3) * (LOBES * p.y.atan2(p.x)).cos()
}

/// A stem up the z axis from the origin: a shank, a six-sided flange and a screw thread to the end.
fn stem(p: DVec3) -> f64 {
    let around = p.x.hypot(p.y);
    let shank = smooth_max(around - 10.0, p.z - 62.0, 1.0);
    let turn = std::f64::consts::FRAC_PI_3;
    let angle = p.y.atan2(p.x).rem_euclid(turn) - 0.5 * turn;
    let flats = smooth_max(around * angle.cos() - 18.0, around - 19.8, 1.0);
    let flange = smooth_max(flats, (p.z - 64.0).abs() - 5.0, 2.0);
    let wave = (p.y.atan2(p.x) + std::f64::consts::TAU * p.z / 4.0).sin();
    let thread =
        smooth_max(around - 10.0 - 0.55 * wave, (p.z - 0.5 * (60.0 + END)).abs() - 0.5 * (END - 60.0), 3.0);
    smooth_min(smooth_min(shank, flange, 4.0), thread, 1.0)
}

impl Surface for Ball {
    fn value(&self, p: DVec3) -> f64 {
        smooth_min(knob(p), stem(DVec3::new(p.x, p.y, -p.z)).max(p.z), 7.0)
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        (DVec3::new(-31.0, -31.0, -END), DVec3::splat(31.0))
    }

    fn feature(&self) -> f64 {
        2.0
    }
}

impl Surface for Socket {
    fn value(&self, p: DVec3) -> f64 {
        let r = p.length();
        let around = p.x.hypot(p.y);
        // Six ribs run down the cup, to a collar around its rim.
        let rib = (0.5 + 0.5 * (6.0 * p.y.atan2(p.x)).cos()).powi(3) * (around / CUP).min(1.0).powi(3);
        let collar = (around - RADIUS - 9.0).hypot(p.z + RIM - 4.0) - 4.5;
        let outside = smooth_min(r - CUP - 1.8 * rib, collar, 2.0);
        let body = smooth_min(outside, stem(p).max(-p.z), 8.0);
        let hollow = smooth_max(body, CLEARANCE - knob(p), 1.0);
        smooth_max(hollow, -RIM - p.z, 2.0)
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        (DVec3::new(-46.0, -46.0, -RIM), DVec3::new(46.0, 46.0, END))
    }

    fn feature(&self) -> f64 {
        2.0
    }
}
