//! Sessions with haptic textures under faults: a backend that fails, a hand that is too fast, no texture at
//! all.

use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, Interpolation, Keyframe, MotionPath};
use palpate::glam::DVec3;
use palpate::models::Model;
use palpate::settings::{TextureBackend, TextureSettings};
use palpate::texture_pd::{Answer, Backend, BackendError, Batch, CpuBackend, SurfaceSet};
use palpate::{ContactTiming, HapticRenderer, Object, Pose, Record, Scene, Settings, Summary};
use palpate_tests::ridged_plate;

/// Returns ridges half a millimetre high and 2 mm apart.
fn ridges() -> Object {
    ridged_plate(5e-4, 2e-3)
}

/// Returns a probe that is pressed onto the plate and drawn over it at a speed (m/s) from 0.3 s on.
fn renderer(scene: Object, speed: f64, textures: TextureSettings) -> HapticRenderer {
    let samples = (0..80).map(|i| {
        let time = i as f64 * 0.01;
        let height = 0.0105 - 0.0025 * (time / 0.2).min(1.0);
        let place = DVec3::new(speed * (time - 0.3).max(0.0) - 0.02, 0.0, height);
        Keyframe { time, pose: Pose::from_translation(place) }
    });
    let path = MotionPath::new(samples.collect(), Interpolation::Smooth).unwrap();
    let device = Box::new(Emulation::default().open(path).unwrap());
    let probe = Object::from_mesh("stylus", &Model::Stylus.generate(2000).unwrap()).unwrap();
    let settings = Settings { textures, ..Settings::default() };
    HapticRenderer::new(probe, Scene::new().with(scene, Pose::IDENTITY), device, settings).unwrap()
}

fn run(renderer: HapticRenderer) -> (Vec<Record>, Summary) {
    let mut records = Vec::new();
    let session = renderer
        .run_lockstep(0.6, ContactTiming::busy(500.0), &AtomicBool::new(false), |record| {
            records.push(*record);
            Ok::<_, std::convert::Infallible>(())
        })
        .unwrap();
    (records, session.summary())
}

/// Backend that fails the first time.
struct Broken;

impl Backend for Broken {
    fn name(&self) -> &str {
        "broken"
    }

    fn evaluate(&mut self, _: &SurfaceSet, _: &Batch, _: &mut Vec<Answer>) -> Result<(), BackendError> {
        Err(BackendError::Device { device: "a".into(), reason: "b".into() })
    }
}

#[test]
fn the_processor_takes_over_when_a_backend_fails() {
    let whole = renderer(ridges(), 0.05, TextureSettings::default());
    let mut broken = renderer(ridges(), 0.05, TextureSettings::default());
    broken.set_texture_backend(Box::new(Broken));
    assert_eq!(broken.stages()["textures"], "on, computed by broken: scene ridges");
    let ((expected, _), (records, summary)) = (run(whole), run(broken));
    assert_eq!(records.last().map(|r| r.object), expected.last().map(|r| r.object));
    assert!(records.iter().any(|record| record.contact.force.z > 0.1));
    assert_eq!(summary.events.texture_backend_lost, 1);
    assert_eq!(summary.stages["textures"], "on, computed by CPU: scene ridges");
}

/// Backend that computes as the processor does, but returns slopes and curvatures that are not numbers in
/// every n-th answer.
struct Spoiling {
    processor: CpuBackend,
    every: usize,
}

impl Backend for Spoiling {
    fn name(&self) -> &str {
        "spoiling"
    }

    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError> {
        self.processor.evaluate(surfaces, batch, answers)?;
        for answer in answers.iter_mut().step_by(self.every) {
            // All but the positions of the heights: the sums, from the first gradient on.
            bytemuck::bytes_of_mut(answer)[20..4 * 53].fill(0xff);
        }
        Ok(())
    }
}

/// One quarter of each grid is invalid: the others go on pushing, and what is left out is counted.
#[test]
fn a_depth_that_is_not_finite_is_left_out_and_counted() {
    let whole = renderer(ridges(), 0.05, TextureSettings::default());
    let (_, summary) = run(whole);
    assert_eq!(summary.events.contact_refused, 0);
    for (every, pushes) in [(4, true), (1, false)] {
        let mut spoilt = renderer(ridges(), 0.05, TextureSettings::default());
        spoilt.set_texture_backend(Box::new(Spoiling { processor: CpuBackend::new(), every }));
        let (records, summary) = run(spoilt);
        let pushed = records.iter().filter(|record| record.contact.force.z > 0.1).count();
        let refused = summary.events.contact_refused;
        assert!(refused > 100, "{refused} refused, {pushed} steps pushed");
        assert_eq!(pushed > 100, pushes, "{refused} refused, {pushed} steps pushed");
        assert_eq!(summary.events.texture_backend_lost, 0);
    }
}

#[test]
fn a_scene_without_textures_has_no_backend_even_if_one_is_requested() {
    let plate = Object::from_mesh("plate", &Model::Plate.generate(12).unwrap()).unwrap();
    let textures = TextureSettings { backend: TextureBackend::Auto, ..TextureSettings::default() };
    let mut renderer = renderer(plate, 0.05, textures);
    renderer.set_texture_backend(Box::new(Broken));
    let (_, summary) = run(renderer);
    assert_eq!(summary.stages["textures"], "off: no object has a haptic texture");
    assert_eq!(summary.events.texture_backend_lost, 0);
}

/// Both backends render the same, at least on the software driver.
#[test]
fn the_faster_backend_renders_as_the_processor_does() {
    let auto = TextureSettings { backend: TextureBackend::Auto, ..TextureSettings::default() };
    let (expected, _) = run(renderer(ridges(), 0.05, TextureSettings::default()));
    let (records, summary) = run(renderer(ridges(), 0.05, auto));
    assert_eq!(summary.events.texture_backend_lost, 0);
    for (record, expected) in records.iter().zip(&expected) {
        let apart = record.object.translation.distance(expected.object.translation);
        assert!(apart < 1e-5, "{apart} m at {} s", record.time);
    }
}

/// Ridges that are passed faster than contacts are found are not felt correctly, which is counted.
#[test]
fn sliding_too_fast_for_the_texture_is_counted() {
    let [slow, fast] = [0.005, 0.5].map(|speed| {
        let (_, summary) = run(renderer(ridges(), speed, TextureSettings::default()));
        summary.events.texture_undersampled
    });
    assert!(slow == 0 && fast > 20, "{slow}, {fast}");
}

#[test]
fn settings_out_of_range_are_refused() {
    let default = TextureSettings::default();
    for (textures, name) in [
        (TextureSettings { grid: 1, ..default }, "texture grid"),
        (TextureSettings { grid: 5000, ..default }, "texture grid"),
        (TextureSettings { half_size: Some(0.0), ..default }, "texture half-size"),
        (TextureSettings { half_size: Some(f64::NAN), ..default }, "texture half-size"),
        (TextureSettings { temperature: Some(-1.0), ..default }, "texture temperature"),
    ] {
        let error = Settings { textures, ..Settings::default() }.check().unwrap_err();
        assert_eq!(error.name, name);
    }
}
