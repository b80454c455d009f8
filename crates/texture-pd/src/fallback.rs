//! A backend that falls back to the CPU.

use std::time::Duration;

use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, SurfaceSet};
use crate::cpu::CpuBackend;
use crate::kernels::Answer;

/// An optional backend with the CPU as its fallback, so that it cannot fail. A batch that the backend fails
/// at is counted ([`failures`](Backend::failures)) and computed on the CPU. The next batch is given to the
/// backend again, unless its error [lasts](BackendError::is_lasting): then the CPU computes all further
/// batches, which are not counted.
#[derive(Default)]
pub struct Fallback {
    cpu: CpuBackend,
    other: Option<Box<dyn Backend>>,
    failures: u64,
    failure: Option<BackendError>,
}

impl Fallback {
    /// A backend with the CPU as its fallback.
    pub fn new(backend: Box<dyn Backend>) -> Self {
        Self { other: Some(backend), ..Self::default() }
    }

    /// The CPU alone, because a backend could not be created. That counts as a failure, unless there is no
    /// GPU.
    pub fn failed(failure: BackendError) -> Self {
        let failures = u64::from(!matches!(failure, BackendError::NoAdapter { .. }));
        Self { failures, failure: Some(failure), ..Self::default() }
    }

    /// Latest error of the backend, if it has failed.
    pub fn failure(&self) -> Option<&BackendError> {
        self.failure.as_ref()
    }

    /// Returns whether the backend has failed permanently.
    fn is_lost(&self) -> bool {
        self.failure.as_ref().is_some_and(BackendError::is_lasting)
    }

    /// Returns whether there is a backend besides the CPU, lost or not.
    pub fn has_other(&self) -> bool {
        self.other.is_some()
    }
}

impl Backend for Fallback {
    fn name(&self) -> &str {
        let other = self.other.as_ref().filter(|_| !self.is_lost());
        other.map_or(self.cpu.name(), |other| other.name())
    }

    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError> {
        let lost = self.is_lost();
        // A lost backend is kept, since dropping it may block.
        if let Some(other) = self.other.as_mut().filter(|_| !lost) {
            match other.evaluate(surfaces, batch, answers) {
                Ok(()) => return Ok(()),
                Err(error) => {
                    self.failures += 1;
                    self.failure = Some(error);
                }
            }
        }
        self.cpu.evaluate(surfaces, batch, answers)
    }

    fn set_deadline(&mut self, deadline: Duration) {
        if let Some(other) = &mut self.other {
            other.set_deadline(deadline);
        }
    }

    fn failures(&self) -> u64 {
        self.failures + self.other.as_ref().map_or(0, |other| other.failures())
    }
}
