//! The teeth of both jaws: their measures, cusps and places.
//!
//! Widths are the textbook averages of permanent teeth; their sums along the arch are what makes the jaws
//! interdigitate. Cusps are given as (mesiodistal, buccolingual, height) in mm.

use palpate_core::glam::{DVec2, DVec3};

use super::{
    arch::Arch,
    tooth::{Form, Ridge, Tooth},
};

/// Distance of the upper arch outside the lower one at the front and at the molars, mm. At the molars it is
/// half the distance between a tooth's rows of cusps, so that a row stands over the other jaw's fissure.
const OVERJET: [f64; 2] = [3.4, 2.9];
/// The upper teeth's occlusal plane lies this much above the lower ones', mm.
const PLANE_GAP: f64 = 0.3;

/// The measures of a kind of tooth.
pub(super) struct Species {
    pub(super) width: f64,
    pub(super) depth: f64,
    pub(super) height: f64,
    squareness: f64,
    blade: f64,
    /// Outward lean per mm of height.
    lean: f64,
    /// Distance that it stands out of the arch, mm.
    out: f64,
    /// Ridges and cusps: (from, to, slope).
    ridges: &'static [([f64; 3], [f64; 3], f64)],
}

const fn cusp(m: f64, b: f64, height: f64) -> ([f64; 3], [f64; 3], f64) {
    // A cusp's own ridge runs down towards the middle of the table.
    ([m, b, height], [0.55 * m, 0.42 * b, height - 0.95], 0.85)
}

const fn margin(m: f64, half: f64, height: f64) -> ([f64; 3], [f64; 3], f64) {
    ([m, -half, height], [m, half, height], 0.8)
}

const fn edge(half: f64, left: f64, right: f64) -> ([f64; 3], [f64; 3], f64) {
    ([-half, 0.0, left], [half, 0.0, right], 0.9)
}

/// The lower teeth from the front.
pub(super) const LOWER: [Species; 7] = [
    Species {
        width: 5.3,
        depth: 6.0,
        height: 9.0,
        squareness: 2.6,
        blade: 1.0,
        lean: 0.12,
        out: 0.0,
        ridges: &[edge(1.5, 1.3, 1.2)],
    },
    Species {
        width: 5.7,
        depth: 6.2,
        height: 9.0,
        squareness: 2.6,
        blade: 1.0,
        lean: 0.10,
        out: 0.0,
        ridges: &[edge(1.6, 1.3, 1.0)],
    },
    Species {
        width: 6.8,
        depth: 7.4,
        height: 9.2,
        squareness: 2.3,
        blade: 0.9,
        lean: 0.04,
        out: -0.6,
        ridges: &[([-0.2, 0.0, 1.7], [-3.0, 0.0, 0.5], 0.6), ([-0.2, 0.0, 1.7], [3.2, 0.0, 0.0], 0.6)],
    },
    Species {
        width: 7.0,
        depth: 7.6,
        height: 8.0,
        squareness: 2.4,
        blade: 0.15,
        lean: 0.0,
        out: 0.0,
        ridges: &[
            cusp(0.0, 1.5, 1.7),
            cusp(-0.2, -2.4, -0.2),
            margin(-2.6, 1.2, -0.3),
            margin(2.6, 1.3, -0.4),
        ],
    },
    Species {
        width: 7.1,
        depth: 8.3,
        height: 7.5,
        squareness: 2.6,
        blade: 0.0,
        lean: -0.02,
        out: 0.0,
        ridges: &[
            cusp(-0.1, 2.1, 1.3),
            cusp(-1.4, -2.5, 0.7),
            cusp(1.6, -2.4, 0.4),
            margin(-2.7, 1.6, -0.1),
            margin(2.7, 1.6, -0.2),
        ],
    },
    Species {
        width: 11.2,
        depth: 10.4,
        height: 7.2,
        squareness: 3.2,
        blade: 0.0,
        lean: -0.05,
        out: 0.0,
        ridges: &[
            cusp(-3.2, 2.9, 1.2),
            cusp(0.4, 3.1, 1.1),
            cusp(3.7, 2.2, 0.8),
            cusp(-2.7, -3.0, 1.2),
            cusp(2.3, -3.0, 1.1),
            margin(-4.6, 1.8, -0.2),
            margin(4.7, 1.6, -0.3),
        ],
    },
    Species {
        width: 10.6,
        depth: 10.0,
        height: 6.8,
        squareness: 3.1,
        blade: 0.0,
        lean: -0.06,
        out: 0.0,
        ridges: &[
            cusp(-2.6, 2.9, 1.2),
            cusp(2.5, 2.8, 1.1),
            cusp(-2.5, -2.8, 1.1),
            cusp(2.4, -2.8, 1.0),
            margin(-4.3, 1.8, -0.2),
            margin(4.3, 1.7, -0.3),
        ],
    },
];

/// The upper teeth from the front.
pub(super) const UPPER: [Species; 7] = [
    Species {
        width: 8.5,
        depth: 7.0,
        height: 10.3,
        squareness: 2.8,
        blade: 1.0,
        lean: 0.22,
        out: 0.0,
        ridges: &[edge(2.6, 2.1, 1.8)],
    },
    Species {
        width: 6.6,
        depth: 6.2,
        height: 9.4,
        squareness: 2.6,
        blade: 1.0,
        lean: 0.20,
        out: 0.3,
        ridges: &[edge(1.7, 1.6, 1.3)],
    },
    Species {
        width: 7.6,
        depth: 8.0,
        height: 9.8,
        squareness: 2.3,
        blade: 0.9,
        lean: 0.14,
        out: 0.6,
        ridges: &[([-0.1, 0.0, 3.0], [-3.2, 0.0, 1.0], 0.6), ([-0.1, 0.0, 3.0], [3.4, 0.0, 0.5], 0.6)],
    },
    Species {
        width: 7.0,
        depth: 9.0,
        height: 7.6,
        squareness: 2.5,
        blade: 0.0,
        lean: 0.08,
        out: 0.0,
        ridges: &[cusp(0.1, 2.7, 1.7), cusp(-0.5, -2.5, 1.1), margin(-2.6, 1.8, 0.0), margin(2.6, 1.8, -0.1)],
    },
    Species {
        width: 6.8,
        depth: 9.0,
        height: 7.2,
        squareness: 2.5,
        blade: 0.0,
        lean: 0.06,
        out: 0.0,
        ridges: &[cusp(0.0, 2.7, 1.3), cusp(-0.4, -2.5, 1.1), margin(-2.5, 1.8, 0.0), margin(2.5, 1.8, -0.1)],
    },
    Species {
        width: 10.3,
        depth: 11.2,
        height: 7.0,
        squareness: 3.1,
        blade: 0.0,
        lean: 0.06,
        out: 0.0,
        ridges: &[
            cusp(-2.6, 3.5, 1.2),
            cusp(2.2, 3.4, 1.1),
            cusp(-1.9, -2.9, 1.2),
            cusp(2.9, -3.2, 0.8),
            // The oblique ridge.
            ([-1.9, -2.9, 0.6], [2.2, 3.4, 0.4], 0.9),
            margin(-4.2, 2.2, -0.1),
            margin(4.2, 2.0, -0.3),
        ],
    },
    Species {
        width: 9.7,
        depth: 11.0,
        height: 6.6,
        squareness: 2.9,
        blade: 0.0,
        lean: 0.07,
        out: 0.0,
        ridges: &[
            cusp(-2.4, 3.4, 1.2),
            cusp(2.0, 3.2, 1.0),
            cusp(-1.8, -2.9, 1.2),
            cusp(2.5, -2.9, 0.6),
            margin(-3.9, 2.1, -0.1),
            margin(3.9, 1.8, -0.3),
        ],
    },
];

/// The curve on which the upper teeth stand.
pub(super) fn upper_arch(lower: &Arch) -> Arch {
    lower.offset(|along| OVERJET[0] + (OVERJET[1] - OVERJET[0]) * (along / 40.0).min(1.0))
}

pub(super) fn lower(arch: &Arch) -> Vec<Tooth> {
    place(&LOWER, arch, 0.0, 1.0)
}

pub(super) fn upper(lower_arch: &Arch) -> Vec<Tooth> {
    place(&UPPER, &upper_arch(lower_arch), PLANE_GAP, -1.0)
}

/// Stands the teeth side by side along both halves of the arch.
fn place(species: &[Species], arch: &Arch, plane: f64, up: f64) -> Vec<Tooth> {
    let mut teeth = Vec::new();
    let mut start = 0.0;
    for (i, kind) in species.iter().enumerate() {
        let (point, distal, _) = arch.at(start + 0.5 * kind.width);
        start += kind.width;
        for side in [1.0, -1.0] {
            // No mouth is symmetrical: teeth stand a little turned and shifted, each in its own way.
            let whim = (2.4 * i as f64 + 1.1 * side + 0.7 * up).sin();
            let turned = DVec2::from_angle(0.035 * whim).rotate(distal);
            let distal = DVec2::new(side * turned.x, turned.y);
            let outwards = DVec2::new(side * turned.perp().x, turned.perp().y);
            let origin = DVec2::new(side * point.x, point.y) + (kind.out + 0.15 * whim) * outwards;
            let ridges = kind
                .ridges
                .iter()
                .map(|(from, to, slope)| Ridge { from: (*from).into(), to: (*to).into(), slope: *slope })
                .collect();
            let form = Form {
                width: 1.02 * kind.width,
                depth: kind.depth,
                height: kind.height,
                squareness: kind.squareness,
                blade: kind.blade,
                ridges,
            };
            let origin = DVec3::new(origin.x, origin.y, plane);
            teeth.push(Tooth::new(form, origin, [distal, outwards], up, kind.lean));
        }
    }
    teeth
}
