//! The dental arch: the curve in the occlusal plane along which the teeth stand.

use palpate_core::glam::{DVec2, DVec3};

/// The jaws' origin in the arch's axes (where the front of the arch is at y = [`DEPTH`]), mm.
pub(super) const ORIGIN: DVec3 = DVec3::new(0.0, 15.5, 0.0);

/// Depth of the arch, mm.
const DEPTH: f64 = 44.0;
/// Half of its width at that depth, mm.
const HALF_WIDTH: f64 = 26.0;
/// Greatest |x| of the curve, behind the last molar, mm.
const END: f64 = 27.3;
const SAMPLES: usize = 96;

/// The right half of the arch, sampled; the left one is its mirror image.
pub(super) struct Arch {
    points: Vec<DVec2>,
    /// Arc length from the front to each point, mm.
    lengths: Vec<f64>,
}

/// The point of the arch closest to another.
pub(super) struct Foot {
    /// Arc length from the front, mm, the same on both sides.
    pub(super) along: f64,
    /// Distance from the arch, mm.
    pub(super) distance: f64,
    /// Distance from the arch's tangent there, outwards (buccal) positive, mm: also behind the arch's end,
    /// where the distance from the arch would jump from one sign to the other.
    pub(super) side: f64,
}

impl Arch {
    pub(super) fn new() -> Self {
        let points: Vec<DVec2> = (0..=SAMPLES)
            .map(|i| {
                let x = END * (1.0 - (1.0 - i as f64 / SAMPLES as f64).powf(1.6));
                let w = (x / HALF_WIDTH).powi(2);
                DVec2::new(x, DEPTH * (1.0 - 0.55 * w - 0.45 * w * w))
            })
            .collect();
        let mut lengths = vec![0.0];
        for pair in points.windows(2) {
            lengths.push(lengths[lengths.len() - 1] + pair[0].distance(pair[1]));
        }
        Self { points, lengths }
    }

    /// The same arch, moved outwards by `offset(arc length)`.
    pub(super) fn offset(&self, offset: impl Fn(f64) -> f64) -> Self {
        let mut points: Vec<DVec2> = self
            .lengths
            .iter()
            .map(|s| {
                let (point, _, outwards) = self.at(*s);
                point + outwards * offset(*s)
            })
            .collect();
        points[0].x = 0.0;
        let mut lengths = vec![0.0];
        for pair in points.windows(2) {
            lengths.push(lengths[lengths.len() - 1] + pair[0].distance(pair[1]));
        }
        Self { points, lengths }
    }

    /// Point on the right half, the direction away from the front (distal) and the direction outwards
    /// (buccal).
    pub(super) fn at(&self, along: f64) -> (DVec2, DVec2, DVec2) {
        let i = self.lengths.partition_point(|s| *s <= along).clamp(1, SAMPLES) - 1;
        let t = (along - self.lengths[i]) / (self.lengths[i + 1] - self.lengths[i]);
        // Tangents are averaged at the samples and turn linearly in between: a tooth's direction is then
        // continuous.
        let chord =
            |k: usize| (self.points[(k + 1).min(SAMPLES)] - self.points[k.saturating_sub(1)]).normalize();
        let first = if i == 0 { DVec2::X } else { chord(i) };
        let distal = first.lerp(chord(i + 1), t).normalize();
        (self.points[i].lerp(self.points[i + 1], t), distal, distal.perp())
    }

    pub(super) fn foot(&self, x: f64, y: f64) -> Foot {
        let p = DVec2::new(x.abs(), y);
        // The distance has one minimum along the half arch: find it among a few samples, then among those
        // between.
        let distance = |i: &usize| self.points[*i].distance_squared(p);
        let nearest_of = |samples: &mut dyn Iterator<Item = usize>| {
            samples.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
        };
        let rough = nearest_of(&mut (0..=SAMPLES).step_by(8));
        let nearest = nearest_of(&mut (rough.saturating_sub(8)..=(rough + 8).min(SAMPLES)));
        let mut best = Foot { along: 0.0, distance: f64::INFINITY, side: 0.0 };
        for i in nearest.saturating_sub(1)..(nearest + 1).min(SAMPLES) {
            let (a, b) = (self.points[i], self.points[i + 1]);
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            let offset = p - a.lerp(b, t);
            let distance = offset.length();
            if distance < best.distance {
                let along = self.lengths[i] + t * (self.lengths[i + 1] - self.lengths[i]);
                best = Foot { along, distance, side: (b - a).normalize().perp_dot(offset) };
            }
        }
        best
    }
}
