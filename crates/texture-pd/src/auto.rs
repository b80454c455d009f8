//! Choice of the faster of two backends.

use std::time::{Duration, Instant};

use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, SurfaceSet};
use crate::cpu::CpuBackend;
use crate::depth::{DepthError, DepthQuery, DepthSettings, TextureContact};
use crate::fallback::Fallback;
use crate::kernels::Answer;

/// Number of timed runs per backend; their median counts.
const RUNS: usize = 9;

/// Backend that timed the CPU and another backend, usually the GPU, and uses the faster one. Batches that the
/// other backend fails at later, for example because the GPU is lost, run on the CPU; the only interruption
/// is the time until the failure is known. See [`Fallback`] and [`failure`](Self::failure).
pub struct AutoBackend {
    chosen: Fallback,
    times: [f64; 2],
}

impl AutoBackend {
    /// Chooses between the CPU and the fastest GPU for contacts such as `contacts`. Without a GPU it is the
    /// CPU.
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

    /// Chooses between the CPU and another backend for contacts such as `contacts`. Each runs once before it
    /// is timed.
    ///
    /// # Errors
    /// If the settings are out of range.
    pub fn choose(
        mut other: Box<dyn Backend>,
        surfaces: &SurfaceSet,
        contacts: &[TextureContact],
        settings: &DepthSettings,
    ) -> Result<Self, DepthError> {
        let mut cpu = CpuBackend::new();
        let on_cpu = median_time(&mut cpu, surfaces, contacts, settings)?;
        let (on_other, chosen) = match median_time(&mut *other, surfaces, contacts, settings) {
            Ok(time) if time < on_cpu => (time, Fallback::new(other)),
            Ok(time) => (time, Fallback::default()),
            Err(DepthError::Backend(error)) => (f64::INFINITY, Fallback::failed(error)),
            Err(error) => return Err(error),
        };
        Ok(Self { chosen, times: [on_cpu, on_other] })
    }

    /// Median times of the query on the CPU and on the other backend, s. The second is infinite if the other
    /// backend failed, and NaN if there is none.
    pub fn times(&self) -> [f64; 2] {
        self.times
    }

    /// Latest error of the other backend, if it has failed.
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
