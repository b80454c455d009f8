//! The faster of two backends.

use std::time::Instant;

use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, SurfaceSet};
use crate::cpu::CpuBackend;
use crate::depth::{DepthError, DepthQuery, DepthSettings, TextureContact};
use crate::kernels::Answer;

/// How often each backend is measured.
const RUNS: usize = 9;

/// A backend that measured itself and another one, usually the GPU's, and goes on with the faster of both. Should the other
/// one fail later, as where a GPU is lost, it goes on by itself, without an interruption but for the time until that was
/// known: see [`failure`](Self::failure).
pub struct AutoBackend {
    processor: CpuBackend,
    other: Option<Box<dyn Backend>>,
    times: [f64; 2],
    failure: Option<BackendError>,
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
            Err(error) => {
                let processor = CpuBackend::new();
                Ok(Self { processor, other: None, times: [f64::NAN; 2], failure: Some(error) })
            }
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
        let (on_other, failure) = match median_time(&mut *other, surfaces, contacts, settings) {
            Ok(time) => (time, None),
            Err(DepthError::Backend(error)) => (f64::INFINITY, Some(error)),
            Err(error) => return Err(error),
        };
        let other = (on_other < on_processor).then_some(other);
        Ok(Self { processor, other, times: [on_processor, on_other], failure })
    }

    /// Median time of the measured query on the processor and on the other backend, s: infinite where that failed, NaN where
    /// there is none.
    pub fn times(&self) -> [f64; 2] {
        self.times
    }

    /// Why the other backend is out of use, if it failed.
    pub fn failure(&self) -> Option<&BackendError> {
        self.failure.as_ref()
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
        self.other.as_ref().map_or(self.processor.name(), |other| other.name())
    }

    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError> {
        if let Some(other) = &mut self.other {
            match other.evaluate(surfaces, batch, answers) {
                Ok(()) => return Ok(()),
                Err(error) => {
                    self.failure = Some(error);
                    self.other = None;
                }
            }
        }
        self.processor.evaluate(surfaces, batch, answers)
    }
}
