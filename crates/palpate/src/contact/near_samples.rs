//! Samples of two bodies' surfaces near each other, found in their fields: where guarded points start.
//!
//! Samples on faces whose sharp edges are all long are left out, since it is these edges that touch first.
//! The edges have samples of their own, at even steps.

use arrayvec::ArrayVec;
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_field::{FeatureMesh, FieldBody, FieldQuery, FieldSettings, Place, SurfacePoint};

use crate::scene::field::{Field, new_fine_query};

/// For each sample of a body, the place on the vertices and edges of its surface nearest to it. It is found
/// when it is first needed.
#[derive(Debug)]
pub(super) struct SamplePlaces(Vec<SamplePlace>);

#[derive(Clone, Copy, Debug)]
enum SamplePlace {
    Unknown,
    /// Long edges stand for it.
    LeftOut,
    At(Place),
}

/// The query of two bodies.
#[derive(Debug)]
pub(super) struct NearSamples {
    query: FieldQuery,
    scene: SamplePlaces,
}

/// A body with its field and its surface.
pub(super) type Sampled<'a> = (&'a FieldBody, &'a FeatureMesh, &'a Pose);

impl SamplePlaces {
    pub fn new(field: &Field) -> Self {
        Self(vec![SamplePlace::Unknown; field.body().samples()])
    }

    fn of(&mut self, sample: usize, point: DVec3, surface: &FeatureMesh, long: f64) -> Option<Place> {
        let place = self.0.get_mut(sample)?;
        if matches!(place, SamplePlace::Unknown) {
            let found = surface.place_among_short(point, long);
            *place = found.map_or(SamplePlace::LeftOut, SamplePlace::At);
        }
        if let SamplePlace::At(place) = *place { Some(place) } else { None }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.0.capacity() * size_of::<SamplePlace>()
    }
}

impl NearSamples {
    pub fn new(probe: &Field, scene: &Field) -> Self {
        Self { query: new_fine_query(probe, scene), scene: SamplePlaces::new(scene) }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.query.bytes() + self.scene.bytes()
    }

    /// Passes on the samples within the reach of the settings, where the surfaces have sharp edges of at most
    /// `long` (m): samples whose points are on their places, and those places.
    pub fn find(
        &mut self,
        probe: Sampled<'_>,
        probe_places: &mut SamplePlaces,
        scene: Sampled<'_>,
        long: f64,
        settings: &FieldSettings,
        mut to: impl FnMut(&SurfacePoint, Place),
    ) {
        let Self { query, scene: scene_places } = self;
        query.run(probe.0, scene.0, probe.2, scene.2, settings);
        query.surface_points((probe.0, probe.2), (scene.0, scene.2), |sample| {
            let (places, surface) =
                if sample.is_probe { (&mut *probe_places, probe.1) } else { (&mut *scene_places, scene.1) };
            if let Some(place) = places.of(sample.sample, sample.point, surface, long) {
                to(sample, place);
            }
        });
    }
}

/// A sample of a long edge near another body.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdgeSample {
    pub place: Place,
    /// Position in its own body's frame, m.
    pub point: DVec3,
    /// Direction of the edge, in that frame.
    pub along: DVec3,
    /// Signed distance from the other body, approximately, m.
    pub distance: f64,
}

/// Passes on samples, `step` (m) apart or less, of the edges longer than `long` (m) of a body that are within
/// `reach` (m) of another one.
pub(super) fn sample_long_edges(
    own: Sampled<'_>,
    other: Sampled<'_>,
    (long, step): (f64, f64),
    reach: f64,
    mut to: impl FnMut(EdgeSample),
) {
    let (surface, field) = (own.1, other.0);
    let to_other = other.2.inverse() * *own.2;
    let read = |points: [DVec3; 4]| field.distances(points.map(|point| to_other.transform_point(point)));
    // Most edges are far from the other body's bounding sphere.
    let center = to_other.inverse().transform_point(field.center());
    let near = |[from, end]: &[DVec3; 2]| {
        let most = field.radius() + 0.5 * from.distance(*end) + reach;
        from.midpoint(*end).distance_squared(center) <= most * most
    };
    let mut long = surface.long_edges(long).filter(|(_, ends)| near(ends));
    loop {
        let four: ArrayVec<(u32, [DVec3; 2]), 4> = long.by_ref().take(4).collect();
        let Some(&last) = four.last() else { return };
        let middle = |lane: usize| four.get(lane).unwrap_or(&last).1;
        let middles = read(std::array::from_fn(|lane| middle(lane)[0].midpoint(middle(lane)[1])));
        for (&(edge, [from, end]), (middle, _)) in four.iter().zip(middles) {
            let along = end - from;
            let length = along.length();
            if middle - 0.5 * length > reach {
                continue;
            }
            let steps = (length / step).ceil().max(1.0) as u32;
            for first in (0..=steps).step_by(4) {
                let shares = [0, 1, 2, 3].map(|lane| f64::from((first + lane).min(steps)) / f64::from(steps));
                let points = shares.map(|share| from + along * share);
                let count = (steps + 1 - first) as usize;
                for (lane, (distance, _)) in read(points).into_iter().enumerate().take(count) {
                    if distance <= reach {
                        let place = surface.place_at(edge, shares[lane]);
                        to(EdgeSample { place, point: points[lane], along: along / length, distance });
                    }
                }
            }
        }
    }
}
