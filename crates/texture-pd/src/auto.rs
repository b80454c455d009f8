//! The faster of two backends.

use std::time::{Duration, Instant};

use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, SurfaceSet};
use crate::cpu::CpuBackend;
use crate::depth::{DepthError, DepthQuery, DepthSettings, TextureContact};
use crate::fallback::Fallback;
use crate::kernels::Answer;

/// How often each backend is measured.
const RUNS: usize = 9;

/// A backend that measured itself and another one, usually the GPU's, and goes on with the faster of both. What the other one
/// fails at later, as where a GPU is lost, it computes by itself, without an interruption but for the time until that was
/// known: see [`Fallback`] and [`failure`](Self::failure).
pub struct AutoBackend {
    chosen: Fallback,
    times: [f64; 2],
}

impl AutoBackend {
    /// The faster for such contacts, of the processor and the fastest GPU there is, or the processor where there is none.
    ///
    /// # Errors
    /// If the settings are out of range.
    #[cfg(feature = "gpu")]
    pub fn new(
        surfaces: &SurfaceSet,
        contacts: &[TextureContact],
        settings: &DepthSettings,
    ) -> Result<Self, DepthError> {
        match crate::gpu::WgpuBackend::new() {
            Ok(gpu) => Self::choose(Box::new(gpu), surfaces, contacts, settings),
            Err(error) => Ok(Self { chosen: Fallback::failed(error), times: [f64::NAN; 2] }),
        }
    }

    /// The faster for such contacts, of the processor and another backend: each runs once, and then is measured.
    ///
    /// # Errors
    /// If the settings are out of range.
    pub fn choose(
        mut other: Box<dyn Backend>,
        surfaces: &SurfaceSet,
        contacts: &[TextureContact],
        settings: &DepthSettings,
    ) -> Result<Self, DepthError> {
        let mut processor = CpuBackend::new();
        let on_processor = median_time(&mut processor, surfaces, contacts, settings)?;
        let (on_other, chosen) = match median_time(&mut *other, surfaces, contacts, settings) {
            Ok(time) if time < on_processor => (time, Fallback::new(other)),
            Ok(time) => (time, Fallback::default()),
            Err(DepthError::Backend(error)) => (f64::INFINITY, Fallback::failed(error)),
            Err(error) => return Err(error),
        };
        Ok(Self { chosen, times: [on_processor, on_other] })
    }

    /// Median time of the measured query on the processor and on the other backend, s: infinite where that failed, NaN where
    /// there is none.
    pub fn times(&self) -> [f64; 2] {
        self.times
    }

    /// The latest error of the other backend, if it failed.
    pub fn failure(&self) -> Option<&BackendError> {
        self.chosen.failure()
    }
}

fn median_time(
    backend: &mut dyn Backend,
    surfaces: &SurfaceSet,
    contacts: &[TextureContact],
    settings: &DepthSettings,
) -> Result<f64, DepthError> {
    let mut query = DepthQuery::new();
    query.run(surfaces, contacts, settings, backend)?;
    let mut times = [0.0; RUNS];
    for time in &mut times {
        let start = Instant::now();
        query.run(surfaces, contacts, settings, backend)?;
        *time = start.elapsed().as_secs_f64();
    }
    times.sort_by(f64::total_cmp);
    Ok(times[RUNS / 2])
}

impl Backend for AutoBackend {
    fn name(&self) -> &str {
        self.chosen.name()
    }

    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError> {
        self.chosen.evaluate(surfaces, batch, answers)
    }

    fn set_deadline(&mut self, deadline: Duration) {
        self.chosen.set_deadline(deadline);
    }

    fn failures(&self) -> u64 {
        self.chosen.failures()
    }
}
