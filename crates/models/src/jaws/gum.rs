//! The gums: a ridge along the arch on a flat base, and in the upper jaw the palate.

use palpate_core::glam::DVec3;

use super::{
    arch::Arch,
    dentition::{self, LOWER, UPPER},
};
use crate::surface::{smooth_max, smooth_min, smooth_step};

/// Height of the base's flat side from the occlusal plane, mm.
pub(super) const BASE: f64 = 21.0;

/// Largest height of the gum, relative to the occlusal plane, mm.
const MAX_HEIGHT: f64 = -2.5;

pub(super) struct Gum {
    arch: Arch,
    /// Arc length at which each tooth ends, from the front, and its crown's height.
    necks: Vec<(f64, f64)>,
    upper: bool,
}

impl Gum {
    pub(super) fn new(lower_arch: Arch, upper: bool) -> Self {
        let arch = if upper { dentition::upper_arch(&lower_arch) } else { lower_arch };
        let mut end = 0.0;
        let necks = if upper { &UPPER } else { &LOWER }
            .iter()
            .map(|species| {
                end += species.width;
                (end, species.height)
            })
            .collect();
        Self { arch, necks, upper }
    }

    pub(super) fn value(&self, p: DVec3) -> f64 {
        // Height over the occlusal plane, towards the teeth.
        let z = if self.upper { -p.z } else { p.z };
        if z > MAX_HEIGHT + 1.5 {
            return z - MAX_HEIGHT;
        }
        let foot = self.arch.foot(p.x, p.y);
        let (margin, between) = self.margin(foot.along);
        let behind = smooth_step(0.0, 50.0, foot.along);
        let deep = smooth_step(-6.0, -BASE, z);
        // Roots show through the gum's outer side.
        let eminence = 0.5 * (0.5 - between) * (1.0 - deep) * smooth_step(0.0, 2.0, foot.side);
        let flare = if self.upper { 2.0 } else { 3.8 };
        let half = 4.0 + 2.0 * behind + (flare - 0.8 * behind) * deep + eminence;
        let across = foot.distance - half;
        // The margin is a dome: lowest at the teeth's outer and inner faces, closing the gap between their
        // necks.
        let dome = 1.8 * (1.0 - (foot.distance / half).powi(2)).max(0.0);
        let ridge = smooth_max(across, z - margin - dome, 3.0);
        let body = if self.upper { smooth_min(ridge, palate(p, foot.side), 5.0) } else { ridge };
        smooth_max(body, -BASE - z, 4.0)
    }

    /// Height of the gum's margin, and 1 between two teeth, 0 in the middle of one.
    fn margin(&self, along: f64) -> (f64, f64) {
        let mut start = 0.0;
        let mut before = self.necks[0].1;
        for (i, &(end, height)) in self.necks.iter().enumerate() {
            if along < end {
                let t = (along - start) / (end - start);
                let between = 0.5 + 0.5 * (std::f64::consts::TAU * t).cos();
                // Blend the heights so that they agree where teeth meet.
                let after = self.necks.get(i + 1).map_or(height, |n| n.1);
                let other = if t < 0.5 { before } else { after };
                let height = height + 0.5 * between * (other - height);
                return (-height + 2.0 * between, between);
            }
            (start, before) = (end, height);
        }
        // Behind the last molar the ridge falls off.
        let past = along - start;
        (-before + 2.0 - 3.5 * smooth_step(0.0, 7.0, past), 1.0 - 0.5 * smooth_step(0.0, 4.0, past))
    }
}

/// The vault of the palate, `side` being the distance from the arch, outwards positive.
fn palate(p: DVec3, side: f64) -> f64 {
    // Folds across its front.
    let front = smooth_step(21.0, 27.0, p.y) * smooth_step(5.0, 9.0, -side);
    let folds = 0.35 * (1.9 * p.y + 0.12 * p.x.abs()).sin() * front;
    let vault = 6.5 + 9.0 * smooth_step(3.0, 17.0, -side) - folds;
    let inside = smooth_max(side, -7.0 - p.y, 4.0);
    smooth_max(inside, 0.8 * (vault - p.z), 2.0)
}
