//! The values that all pairs of a query share, and the motion of the bodies since the queries before.

use palpate_core::Pose;
use palpate_core::glam::DVec3;

use super::settings::QuerySettings;
use crate::convex::Placement;
use crate::motion::Motion;
use crate::shape::Shape;
use crate::tolerances::{COORDINATE_ROUNDING, PAIR_MOTION_LIMIT};

/// Fraction of s₀ over which contacts are interpolated from one resolution to the next. With less, forces
/// change faster; with more, more pairs have contacts on both levels.
const INTERPOLATION_BAND: f64 = 0.5;

/// Values that all pairs of a query share.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Context {
    pub placement: Placement,
    pub probe_pose: Pose,
    pub settings: QuerySettings,
    /// Rounding of coordinates, m.
    pub rounding: f64,
    /// Distance by which a hull may stand off the surface that it was built for, on either body, m.
    pub looseness: f64,
    pub now: Progress,
    /// Whether the query is at full resolution.
    pub exact: bool,
    /// s₀, m, if it is the same everywhere.
    pub constant_error: Option<f64>,
    /// Fraction of s₀ over which contacts are interpolated; 0 without interpolation.
    pub band: f64,
}

/// Changes since earlier queries, which decide whether their answers are still valid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Progress {
    /// Bound on the bodies' relative motion ([`Motion::bound`]), m.
    pub motion_bound: f64,
    /// Bound on the bodies' relative rotation ([`Motion::turn`]), rad.
    pub turn: f64,
    /// Whether the threshold s₀ may differ from that of the query before.
    pub threshold_changed: bool,
}

/// Values that all pairs of triangles of two patches share.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PairContext<'a> {
    pub placement: &'a Placement,
    /// d, m.
    pub tolerance: f64,
    /// Smallest length that counts as more than zero, m.
    pub precision: f64,
    /// Distance by which a hull may stand off the surface that it was built for, m.
    pub looseness: f64,
}

/// Change to the front of the last query before the next one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum FrontUpdate {
    /// The query starts from the front.
    Keep,
    /// The query starts from the roots.
    Restart,
    /// The query starts from the front, and the motion bound, which was this value (m), counts from zero
    /// again.
    Rebase(f64),
}

/// The motion of the bodies, and the settings of the last query.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tracking {
    motion: Motion,
    last: Option<QuerySettings>,
}

impl Tracking {
    /// Discards the last query: the next one starts from the roots.
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// Adds the bodies' motion since the last query.
    pub fn advance(
        &mut self,
        [probe, scene]: [&Shape; 2],
        [probe_pose, scene_pose]: [&Pose; 2],
        settings: &QuerySettings,
    ) -> (Context, FrontUpdate) {
        let placement = Placement::between(probe_pose, scene_pose);
        let coordinates =
            probe.coordinates() + scene.coordinates() + placement.translation.abs().max_element();
        let rounding = COORDINATE_ROUNDING * coordinates;
        let radii = probe.clod().bounding_radius() + scene.clod().bounding_radius();
        let last = self.last.replace(*settings);
        if last.is_none() {
            self.motion.reset();
        }
        self.motion.step(&probe.ball(), &scene.ball(), &placement, rounding);
        let (update, threshold_changed) = self.compare(last, settings, PAIR_MOTION_LIMIT * radii);
        let built_to = probe.clod().source.tolerance.max(scene.clod().source.tolerance);
        let constant_error =
            settings.error.is_constant().then(|| settings.error.threshold(DVec3::ZERO, probe_pose));
        let context = Context {
            placement,
            probe_pose: *probe_pose,
            settings: *settings,
            rounding,
            looseness: 2.0 * built_to * radii,
            now: Progress { motion_bound: self.motion.bound(), turn: self.motion.turn(), threshold_changed },
            exact: settings.error.is_exact(),
            constant_error,
            band: if settings.interpolate { INTERPOLATION_BAND } else { 0.0 },
        };
        (context, update)
    }

    /// Compares the settings with those of the last query, and restarts the motion bound if it exceeds a
    /// limit, m. Returns the change to the front, and whether the threshold s₀ may have changed.
    fn compare(
        &mut self,
        last: Option<QuerySettings>,
        settings: &QuerySettings,
        limit: f64,
    ) -> (FrontUpdate, bool) {
        let (mut update, mut threshold_changed) = (FrontUpdate::Restart, false);
        if let Some(last) = last {
            // A change of the tolerance counts as motion: a pair that is out of reach by more than that stays
            // so.
            self.motion.add((settings.tolerance - last.tolerance).abs());
            threshold_changed = last.error != settings.error
                || !settings.error.is_constant()
                || last.interpolate != settings.interpolate;
            // At full resolution, different nodes are split than with a threshold.
            if last.error.is_exact() == settings.error.is_exact() {
                update = FrontUpdate::Keep;
            }
        }
        let bound = self.motion.bound();
        if bound > limit || bound.is_nan() {
            self.motion.restart();
            if !bound.is_finite() {
                update = FrontUpdate::Restart;
            } else if update == FrontUpdate::Keep {
                update = FrontUpdate::Rebase(bound);
            }
        }
        (update, threshold_changed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_clod_build::{BuildOptions, build, unwatched};
    use palpate_core::TriMesh;

    fn octahedron() -> Shape {
        let tips = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z];
        #[rustfmt::skip]
        let mesh = TriMesh::new(tips.to_vec(), vec![
            [0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5],
        ]).unwrap();
        Shape::new(build(&mesh, &BuildOptions::default(), &mut unwatched).unwrap())
    }

    #[test]
    fn a_front_is_kept_while_its_answers_can_be_compared() {
        let shape = octahedron();
        let mut tracking = Tracking::default();
        let mut advance = |x: f64, settings: &QuerySettings| {
            let pose = Pose::from_translation(x * DVec3::X);
            tracking.advance([&shape, &shape], [&pose, &Pose::IDENTITY], settings)
        };
        let exact = QuerySettings::new(0.1);
        let coarse = QuerySettings { error: 0.1.into(), ..exact };
        let (context, update) = advance(0.0, &exact);
        assert_eq!((update, context.now.motion_bound), (FrontUpdate::Restart, 0.0), "at first");
        let (context, update) = advance(0.5, &exact);
        assert_eq!(update, FrontUpdate::Keep);
        assert!((context.now.motion_bound - 0.5).abs() < 1e-6 && !context.now.threshold_changed);
        // A change of the tolerance counts as motion.
        let (context, update) = advance(0.5, &QuerySettings { tolerance: 0.3, ..exact });
        assert_eq!(update, FrontUpdate::Keep);
        assert!((context.now.motion_bound - 0.7).abs() < 1e-6);
        // With a threshold different nodes are split; for another threshold the splits are tested again.
        let tolerance = 0.3;
        let (context, update) = advance(0.5, &QuerySettings { tolerance, ..coarse });
        assert!(update == FrontUpdate::Restart && context.now.threshold_changed);
        let (context, update) = advance(0.5, &QuerySettings { error: 0.2.into(), tolerance, ..coarse });
        assert!(update == FrontUpdate::Keep && context.now.threshold_changed);
        let (context, update) = advance(0.5, &QuerySettings { error: 0.2.into(), tolerance, ..coarse });
        assert!(update == FrontUpdate::Keep && !context.now.threshold_changed);
        // A large bound counts from zero again, before its rounding exceeds the gaps that it is compared
        // with.
        let (context, update) = advance(1e4, &QuerySettings { error: 0.2.into(), tolerance, ..coarse });
        assert!(matches!(update, FrontUpdate::Rebase(bound) if (bound - 1e4).abs() < 1.0), "{update:?}");
        assert_eq!(context.now.motion_bound, 0.0);
    }
}
