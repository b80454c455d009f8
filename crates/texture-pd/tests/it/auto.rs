//! The choice between backends, and the fallback where one fails.

use std::time::Duration;

use crate::common::{Plates, turned_over};
use glam::{DVec2, DVec3};
use palpate_texture_pd::{
    Answer, AutoBackend, Backend, BackendError, Batch, CpuBackend, DepthQuery, DepthSettings, SurfaceSet,
};

/// A backend that waits before it answers like the CPU, and fails after some batches.
struct Other {
    processor: CpuBackend,
    wait: Duration,
    /// Number of batches until it fails.
    left: usize,
}

impl Backend for Other {
    fn name(&self) -> &str {
        "other"
    }

    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError> {
        std::thread::sleep(self.wait);
        answers.clear();
        if self.left == 0 {
            return Err(BackendError::Device { device: "other".into(), reason: "it is lost".into() });
        }
        self.left -= 1;
        if self.wait.is_zero() {
            // Empty answers are the fastest.
            answers.resize(1, Answer::default());
            return Ok(());
        }
        self.processor.evaluate(surfaces, batch, answers)
    }
}

fn chosen(wait: Duration, left: usize) -> (AutoBackend, Option<f64>) {
    let plates = Plates { half: 0.03, relief_a: &|_| 0.0, relief_b: &|at| 0.001 * (500.0 * at.x).cos() };
    let (surfaces, ids) = plates.surfaces(64);
    let contacts = [plates.contact(ids, turned_over(DVec2::ZERO, 0.0, DVec3::ZERO), 0.02)];
    let settings = DepthSettings { grid: 200, ..DepthSettings::default() };
    let other = Box::new(Other { processor: CpuBackend::new(), wait, left });
    let mut backend = AutoBackend::choose(other, &surfaces, &contacts, &settings).unwrap();
    let mut query = DepthQuery::new();
    let depths = query.run(&surfaces, &contacts, &settings, &mut backend).unwrap();
    let depth = depths[0].map(|found| found.depth);
    (backend, depth)
}

#[test]
fn slower_backend_is_not_chosen() {
    let (backend, depth) = chosen(Duration::from_millis(300), usize::MAX);
    assert_eq!(backend.name(), "CPU");
    assert!(backend.failure().is_none() && (depth.unwrap() - 0.001).abs() < 1e-4, "{depth:?}");
    assert!(backend.times()[0] < backend.times()[1]);
}

#[test]
fn lost_backend_is_replaced_by_the_cpu() {
    // One batch to warm up and nine timed ones; the next fails.
    let (backend, depth) = chosen(Duration::ZERO, 10);
    assert_eq!(backend.name(), "CPU");
    assert!(backend.failure().unwrap().to_string().contains("it is lost"));
    assert_eq!(backend.failures(), 1);
    assert!((depth.unwrap() - 0.001).abs() < 1e-4, "{depth:?}");
}

#[test]
fn faster_backend_is_chosen_unless_it_fails_at_once() {
    let (backend, depth) = chosen(Duration::ZERO, usize::MAX);
    assert_eq!((backend.name(), backend.failures(), depth), ("other", 0, None));
    let (backend, depth) = chosen(Duration::ZERO, 0);
    assert_eq!(backend.name(), "CPU");
    assert_eq!(backend.failures(), 1);
    assert!(backend.failure().is_some() && backend.times()[1].is_infinite() && depth.is_some());
}
