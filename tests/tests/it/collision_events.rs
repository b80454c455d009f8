//! Collision events for hosts that step through time (§3.4.4): surfaces that meet, also while the resolution
//! changes.

use palpate::Pose;
use palpate::clod_build::{BuildOptions, build, unwatched};
use palpate::collide::{CollisionEvents, ContactQuery, PatchContact, QuerySettings, Shape};
use palpate::glam::DVec3;
use palpate::models::Model;

struct Fall {
    ball: Shape,
    torus: Shape,
    query: ContactQuery,
    radius: f64,
}

impl Fall {
    fn new() -> Self {
        let shape = |model: Model, triangles| {
            let mesh = model.generate(triangles).expect("in range");
            let clod = build(&mesh, &BuildOptions::default(), &mut unwatched);
            Shape::new(clod.expect("built-in models can be built"))
        };
        let (ball, torus) = (shape(Model::GolfBall, 4000), shape(Model::Torus, 3000));
        let radius = ball.clod().bounding_radius();
        Self { query: ContactQuery::new(&ball, &torus), ball, torus, radius }
    }

    /// Returns the contacts at a gap between the bodies' bounding spheres with an error, both in radii of the
    /// ball.
    fn contacts(&mut self, gap: f64, error: f64) -> Vec<PatchContact> {
        let x = self.torus.clod().bounding_radius() + (1.0 + gap) * self.radius;
        let pose = Pose::from_translation(x * DVec3::X);
        let settings =
            QuerySettings { error: (error * self.radius).into(), ..QuerySettings::new(self.tolerance()) };
        self.query.run(&pose, &Pose::IDENTITY, &settings).unwrap();
        self.query.contacts().to_vec()
    }

    fn tolerance(&self) -> f64 {
        0.05 * self.radius
    }
}

fn deepest(contacts: &[PatchContact]) -> f64 {
    contacts.iter().map(|found| found.contact.depth).fold(f64::NEG_INFINITY, f64::max)
}

/// Returns the largest gap at which the surfaces penetrate, to within 1e-9 radii.
fn touching_gap(fall: &mut Fall, error: f64) -> f64 {
    let (mut apart, mut pressed) = (0.04, -0.2);
    while apart - pressed > 1e-9 {
        let middle = 0.5 * (apart + pressed);
        if deepest(&fall.contacts(middle, error)) > 0.0 { pressed = middle } else { apart = middle }
    }
    pressed
}

#[test]
fn surfaces_meet_when_they_touch() {
    let mut fall = Fall::new();
    for error in [0.0, 0.025] {
        let touch = touching_gap(&mut fall, error);
        for step in [1e-2, 1e-3, 1e-4] {
            let mut events = CollisionEvents::new(&fall.ball, &fall.torus);
            let (from, to) = (touch + 0.4 * step, touch - 0.6 * step);
            let first = fall.contacts(from, error);
            assert!(events.step(&first, fall.tolerance()).is_empty(), "no beginning is known");
            let last = fall.contacts(to, error);
            assert!(deepest(&first) < 0.0 && deepest(&last) > 0.0);
            let found = events.step(&last, fall.tolerance());
            let event = found.first().expect("the surfaces met");
            assert!(error > 0.0 || !event.switched);
            // The touching gap is known to 1e-9; where the resolution changed, the instant is an estimate.
            let off = if event.switched { 0.4 } else { 1e-6 + 1e-9 / step };
            assert!((event.fraction - 0.4).abs() < off, "s₀ {error}, step {step}: {event:?}");
            assert!((event.normal.length() - 1.0).abs() < 1e-9 && event.point.is_finite());
            assert!(found.is_sorted_by(|x, y| x.fraction <= y.fraction));
            assert!(events.step(&last, fall.tolerance()).is_empty(), "they penetrate already");
            events.reset();
            assert!(events.step(&last, fall.tolerance()).is_empty(), "the beginning was forgotten");
        }
    }
}

/// At one resolution the surfaces are apart at both ends of the step, at the other they penetrate at both: no
/// search would find an instant at which either meet.
#[test]
fn surfaces_meet_once_when_the_resolution_changes() {
    let mut fall = Fall::new();
    let mut touches = [0.0, 0.05].map(|error| (touching_gap(&mut fall, error), error));
    touches.sort_by(|x, y| x.0.total_cmp(&y.0));
    let [(late_touch, late), (early_touch, early)] = touches;
    assert!(early_touch > late_touch + 1e-3, "{touches:?}");
    let (from, to) = (early_touch - 3e-4, early_touch - 6e-4);
    let mut events = CollisionEvents::new(&fall.ball, &fall.torus);
    let tolerance = fall.tolerance();
    for (gap, error, expected) in
        [(from, late, false), (to, early, true), (to, early, false), (to, late, false), (from, late, false)]
    {
        let contacts = fall.contacts(gap, error);
        assert_eq!(deepest(&contacts) > 0.0, error == early);
        let found = events.step(&contacts, tolerance);
        assert_eq!(!found.is_empty(), expected, "gap {gap}, s₀ {error}: {found:?}");
        for event in found {
            assert!(event.switched && (0.0..=1.0).contains(&event.fraction), "{event:?}");
        }
    }
}
