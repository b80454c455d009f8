//! Parts of a jaw: the gum and the teeth, distinguished by the fields whose union is the jaw.

use palpate_core::glam::DVec3;

use super::{ENLARGEMENT, Jaw, arch};
use crate::Model;

/// Part of a jaw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum JawPart {
    /// The gum, with the base under it and the upper jaw's palate.
    Gum,
    /// The crown of a tooth. From the front backwards, the right one (x > 0) of each pair before the left
    /// one: 0 and 1 are the central incisors.
    Crown(usize),
}

impl JawPart {
    /// Number of teeth of a jaw.
    pub const TEETH: usize = 14;

    /// The part to which a point (m) on or near the surface of a built-in jaw belongs; `None` for models that
    /// are not jaws.
    pub fn of(model: Model, point: DVec3) -> Option<Self> {
        let jaw = match model {
            Model::LowerJaw => Jaw::lower(),
            Model::UpperJaw => Jaw::upper(),
            _ => return None,
        };
        Some(jaw.part(point / (1e-3 * ENLARGEMENT)))
    }
}

impl Jaw {
    /// The part whose field is the lowest, that is, which is the nearest, or in which the point lies the
    /// deepest. Fields are compared before they are blended, and before the teeth are worn: neither makes a
    /// crown of gum.
    fn part(&self, p: DVec3) -> JawPart {
        let p = p + arch::ORIGIN;
        let teeth = self.teeth.iter().map(|tooth| tooth.value(p)).enumerate();
        let nearest = teeth.min_by(|a, b| a.1.total_cmp(&b.1));
        match nearest {
            Some((tooth, value)) if value < self.gum.value(p) => JawPart::Crown(tooth),
            _ => JawPart::Gum,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    /// Area and lowest and highest point (m) of each part, over the triangles of a jaw by their middle.
    fn parts(model: Model) -> BTreeMap<JawPart, (f64, DVec3, DVec3)> {
        let mesh = model.generate(20_000).unwrap();
        let mut parts = BTreeMap::new();
        for triangle in 0..mesh.triangles().len() {
            let [a, b, c] = mesh.corners(triangle);
            let middle = (a + b + c) / 3.0;
            let part = JawPart::of(model, middle).unwrap();
            let (area, low, high) = parts.entry(part).or_insert((0.0, DVec3::INFINITY, DVec3::NEG_INFINITY));
            *area += 0.5 * (b - a).cross(c - a).length();
            (*low, *high) = (low.min(middle), high.max(middle));
        }
        parts
    }

    #[test]
    fn every_tooth_has_a_crown_of_its_own_size_over_the_gum() {
        for (model, up) in [(Model::LowerJaw, 1.0), (Model::UpperJaw, -1.0)] {
            let parts = parts(model);
            assert_eq!(parts.len(), 1 + JawPart::TEETH, "{}", model.name());
            let (gum, low, high) = parts[&JawPart::Gum];
            for tooth in 0..JawPart::TEETH {
                let (area, crown_low, crown_high) = parts[&JawPart::Crown(tooth)];
                let context = format!("{} tooth {tooth}: {area} m²", model.name());
                // Life-size, from a wedge of 5 x 6 x 8 mm with neighbours at its sides to five sides of a
                // cube of 11 mm.
                assert!((80e-6..605e-6).contains(&(area / ENLARGEMENT.powi(2))), "{context}");
                assert!(area < 0.1 * gum, "{context}");
                assert!(crown_low.x * crown_high.x > -1e-5, "{context} is on one side");
                let right = 0.5 * (crown_low.x + crown_high.x) > 0.0;
                assert_eq!(right, tooth % 2 == 0, "{context}");
                // Its tip stands clear of all gum, and its neck does not reach the base.
                let (tip, crest) = if up > 0.0 { (crown_high.z, high.z) } else { (-crown_low.z, -low.z) };
                assert!(tip > crest + 0.5e-3, "{context}: tip at {tip}, gum up to {crest}");
            }
        }
    }

    #[test]
    fn teeth_go_from_the_front_backwards() {
        let parts = parts(Model::LowerJaw);
        let y = |tooth: usize| {
            let (_, low, high) = parts[&JawPart::Crown(tooth)];
            0.5 * (low.y + high.y)
        };
        for tooth in 2..JawPart::TEETH {
            assert!(y(tooth) < y(tooth - 2), "tooth {tooth}");
        }
    }

    #[test]
    fn the_base_is_gum_and_nothing_else_has_parts() {
        assert_eq!(JawPart::of(Model::LowerJaw, DVec3::new(0.03, 0.0, -0.03)), Some(JawPart::Gum));
        assert_eq!(JawPart::of(Model::GolfBall, DVec3::ZERO), None);
    }
}
