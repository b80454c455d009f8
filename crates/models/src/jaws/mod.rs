//! The upper and lower jaws of Table 3.2 and Fig. 3.12: fourteen teeth each, from incisors to second molars,
//! on gums.
//!
//! Teeth have the usual mesiodistal widths and stand on one dental arch, the upper ones a few millimetres
//! further out and, since the upper incisors are wider, half a tooth further back: every upper cusp meets a
//! fissure or an embrasure below, and the other way round (Angle's class I occlusion). What would still
//! overlap is cut away from both along the surface midway between the two fields, like the facets that teeth
//! wear into each other. Hence the jaws close, at equal poses, to a gap of about [`CLEARANCE`], and cannot
//! slide sideways.
//!
//! The frame, common to both: z up, y forward, x to the (viewer's) right, the occlusal plane near z = 0, the
//! origin in the middle of the jaws. The lower jaw's teeth point up. Lengths in these modules are life-size
//! millimetres; the meshes are larger by [`ENLARGEMENT`], so that a sphere of 6 cm bounds each jaw, as in
//! §5.5.3.

mod arch;
mod dentition;
mod gum;
mod part;
mod tooth;

use std::sync::OnceLock;

use palpate_core::{TriMesh, glam::DVec3};

use crate::surface::{Surface, smooth_max, smooth_min, smooth_step, triangulate};
use arch::Arch;
use gum::Gum;
pub use part::JawPart;
use tooth::Tooth;

pub(crate) const MIN_TRIANGLES: usize = 3_000;

/// Size of the meshes relative to a life-size jaw.
const ENLARGEMENT: f64 = 1.45;
/// Gap between the closed jaws' teeth, life-size mm.
const CLEARANCE: f64 = 0.25;
/// Fillet between neighbouring teeth, mm: small, so that they stay apart to the eye.
const CONTACT_FILLET: f64 = 0.9;
/// Fillet between tooth and gum, mm.
const GUM_FILLET: f64 = 1.0;

/// The lower jaw, m.
pub(crate) fn lower(triangles: usize) -> TriMesh {
    triangulate(Jaw::lower(), triangles, 1e-3 * ENLARGEMENT)
}

/// The upper jaw, m.
pub(crate) fn upper(triangles: usize) -> TriMesh {
    triangulate(Jaw::upper(), triangles, 1e-3 * ENLARGEMENT)
}

struct Jaw {
    gum: Gum,
    teeth: Vec<Tooth>,
    antagonists: Vec<Tooth>,
    upper: bool,
}

impl Jaw {
    fn lower() -> &'static Self {
        static JAW: OnceLock<Jaw> = OnceLock::new();
        JAW.get_or_init(|| Self::new(false))
    }

    fn upper() -> &'static Self {
        static JAW: OnceLock<Jaw> = OnceLock::new();
        JAW.get_or_init(|| Self::new(true))
    }

    fn new(upper: bool) -> Self {
        let arch = Arch::new();
        let lower_teeth = dentition::lower(&arch);
        let upper_teeth = dentition::upper(&arch);
        let (teeth, antagonists) =
            if upper { (upper_teeth, lower_teeth) } else { (lower_teeth, upper_teeth) };
        Self { gum: Gum::new(arch, upper), teeth, antagonists, upper }
    }
}

/// Union of the teeth; far from them a lower bound of the distance.
fn crowns(teeth: &[Tooth], p: DVec3) -> f64 {
    let mut value = f64::INFINITY;
    for tooth in teeth {
        let bound = tooth.bound(p);
        if bound > 4.0 {
            value = value.min(bound);
        } else if bound < value + CONTACT_FILLET {
            value = smooth_min(value.min(1e3), tooth.value(p), CONTACT_FILLET);
        }
    }
    value
}

impl Surface for Jaw {
    fn value(&self, p: DVec3) -> f64 {
        let p = p + arch::ORIGIN;
        let teeth = crowns(&self.teeth, p);
        let jaw = smooth_min(teeth, self.gum.value(p), GUM_FILLET);
        if jaw > 3.0 {
            return jaw;
        }
        let worn = 0.5 * (teeth.min(jaw) - crowns(&self.antagonists, p) + CLEARANCE);
        smooth_max(jaw, worn, 0.3)
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        let (low, high) = if self.upper { (-4.0, gum::BASE) } else { (-gum::BASE, 4.0) };
        (DVec3::new(-40.0, -22.0, low) - arch::ORIGIN, DVec3::new(40.0, 56.0, high) - arch::ORIGIN)
    }

    fn feature(&self) -> f64 {
        0.8
    }

    fn sizing(&self, p: DVec3) -> f64 {
        // Fine on edges and cusps, coarse on the base.
        let height = if self.upper { p.z } else { -p.z };
        0.65 + 0.2 * smooth_step(1.0, 5.0, height) + 0.85 * smooth_step(7.0, 16.0, height)
    }
}
