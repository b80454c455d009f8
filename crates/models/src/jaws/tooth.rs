//! One tooth as a field: a tapering superelliptic crown under an occlusal surface of cusps and ridges.

use palpate_core::glam::{DVec2, DVec3};

use crate::surface::{smooth_max, smooth_step};

/// A ridge of the occlusal surface from one point to another (a cusp if they are the same): mesiodistal
/// (distal positive), buccolingual (buccal positive) and height over the occlusal plane, mm.
#[derive(Clone, Copy)]
pub(super) struct Ridge {
    pub(super) from: DVec3,
    pub(super) to: DVec3,
    /// Fall per mm away from the ridge.
    pub(super) slope: f64,
}

/// A tooth's measures, mm.
pub(super) struct Form {
    /// Mesiodistal width.
    pub(super) width: f64,
    /// Buccolingual depth.
    pub(super) depth: f64,
    /// From the gum's margin to the occlusal plane.
    pub(super) height: f64,
    /// Exponent of the cross-section: 2 is an ellipse, more is squarer.
    pub(super) squareness: f64,
    /// 0: the crown keeps its depth up to the table; 1: it narrows to an incisal edge.
    pub(super) blade: f64,
    pub(super) ridges: Vec<Ridge>,
}

/// A tooth in its place.
pub(super) struct Tooth {
    form: Form,
    /// Intersection of its axis with the occlusal plane.
    origin: DVec3,
    distal: DVec2,
    buccal: DVec2,
    /// +1 for teeth that point up, −1 for those that point down.
    up: f64,
    /// Outward lean per mm of height.
    lean: f64,
}

/// Depth of the tooth below its neck, mm.
const ROOT: f64 = 3.0;
/// Largest height of a cusp over the occlusal plane, mm.
const TIP: f64 = 3.2;

impl Tooth {
    pub(super) const fn new(form: Form, origin: DVec3, axes: [DVec2; 2], up: f64, lean: f64) -> Self {
        Self { form, origin, distal: axes[0], buccal: axes[1], up, lean }
    }

    /// A lower bound of the distance to the tooth: that to a box around it.
    pub(super) fn bound(&self, p: DVec3) -> f64 {
        let form = &self.form;
        let offset = p - self.origin;
        let z = self.up * offset.z;
        let flat = offset.truncate();
        // Leaning and the blade's shift move the crown sideways by at most this much.
        let sway = self.lean.abs() * form.height + 0.3 * form.blade * form.depth;
        let beyond = DVec3::new(
            flat.dot(self.distal).abs() - 0.5 * form.width,
            flat.dot(self.buccal).abs() - 0.5 * form.depth - sway,
            (z - TIP).max(-(z + form.height + ROOT)),
        );
        beyond.max(DVec3::ZERO).length() - 0.1
    }

    pub(super) fn value(&self, p: DVec3) -> f64 {
        let form = &self.form;
        let offset = p - self.origin;
        let z = self.up * offset.z;
        let flat = offset.truncate();
        let m = flat.dot(self.distal);
        let mut b = flat.dot(self.buccal) - self.lean * z;
        // Height along the crown: 0 at the neck, 1 at the occlusal plane.
        let t = ((z + form.height) / form.height).clamp(-0.5, 1.3);
        let bulge = 1.0 - ((t - 0.62) / 0.62).powi(2).min(1.5);
        let flare = smooth_step(-0.2, 0.85, t);
        let round_width = 0.84 + 0.16 * bulge;
        let round_depth = 0.86 + 0.14 * bulge;
        let blade_width = 0.70 + 0.30 * flare;
        let blade_depth = 1.0 - 0.64 * smooth_step(-0.25, 1.15, t);
        let half_width = 0.5 * form.width * (round_width + form.blade * (blade_width - round_width));
        let half_depth = 0.5 * form.depth * (round_depth + form.blade * (blade_depth - round_depth));
        // A blade's labial face is nearly straight; it is the lingual one that slopes.
        b += form.blade * 0.21 * form.depth * (1.0 - t);
        let side = superellipse(DVec2::new(m, b), DVec2::new(half_width, half_depth), form.squareness);
        let side = smooth_max(side, -(z + form.height + ROOT), 1.0);
        let top = 0.82 * (z - self.table(m, b));
        smooth_max(side, top, 1.6)
    }

    /// Height of the occlusal surface.
    fn table(&self, m: f64, b: f64) -> f64 {
        let p = DVec2::new(m, b);
        let mut height = -1e3;
        for ridge in &self.form.ridges {
            let (from, to) = (ridge.from.truncate(), ridge.to.truncate());
            let along = to - from;
            let t = ((p - from).dot(along) / along.length_squared().max(1e-9)).clamp(0.0, 1.0);
            let away = p.distance(from + t * along);
            let crest = ridge.from.z + t * (ridge.to.z - ridge.from.z);
            height = smooth_max(height, crest - ridge.slope * (away.hypot(0.7) - 0.7), 0.3);
        }
        height
    }
}

/// Distance from a superellipse with the given half axes, to first order.
fn superellipse(p: DVec2, half: DVec2, exponent: f64) -> f64 {
    let scaled = (p / half).abs().max(DVec2::splat(1e-9));
    let powers = DVec2::new(scaled.x.powf(exponent), scaled.y.powf(exponent));
    let norm = (powers.x + powers.y).powf(1.0 / exponent);
    // The norm's gradient depends on the direction only, and so would jump at the centre: go over to a mean
    // there.
    let slope = (powers / scaled / half).length() * norm / (powers.x + powers.y);
    let least = half.min_element();
    // Round at the centre as well, since a thin blade's crest feels it.
    let rounded = (norm * norm + 0.2).sqrt() - 1.2f64.sqrt();
    1.2f64.sqrt() * rounded * (least + (1.0 / slope - least) * (norm * norm).min(1.0))
}
