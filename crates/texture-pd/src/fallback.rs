//! A backend with the processor behind it.

use std::time::Duration;

use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, SurfaceSet};
use crate::cpu::CpuBackend;
use crate::kernels::Answer;

/// A backend, or none, with the processor behind it, so that it cannot fail. What the backend fails at the processor computes,
/// and it is counted ([`failures`](Backend::failures)). The backend is asked again for the next batch, unless its error
/// [lasts](BackendError::is_lasting): then the processor computes all batches, of which that one alone is counted.
#[derive(Default)]
pub struct Fallback {
    processor: CpuBackend,
    other: Option<Box<dyn Backend>>,
    failures: u64,
    failure: Option<BackendError>,
}

impl Fallback {
    /// The processor behind a backend.
    pub fn new(backend: Box<dyn Backend>) -> Self {
        Self { other: Some(backend), ..Self::default() }
    }

    /// The processor alone, as a backend could not be had: this is counted, but not that there is no GPU.
    pub fn failed(failure: BackendError) -> Self {
        let failures = u64::from(!matches!(failure, BackendError::NoAdapter { .. }));
        Self { failures, failure: Some(failure), ..Self::default() }
    }

    /// The latest error of the backend, if it has failed.
    pub fn failure(&self) -> Option<&BackendError> {
        self.failure.as_ref()
    }

    /// Whether the backend failed for good.
    fn is_lost(&self) -> bool {
        self.failure.as_ref().is_some_and(BackendError::is_lasting)
    }

    /// Whether there is a backend, lost or not.
    pub fn has_other(&self) -> bool {
        self.other.is_some()
    }
}

impl Backend for Fallback {
    fn name(&self) -> &str {
        let other = self.other.as_ref().filter(|_| !self.is_lost());
        other.map_or(self.processor.name(), |other| other.name())
    }

    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError> {
        let lost = self.is_lost();
        // A backend that is lost is kept: to drop it may take its time.
        if let Some(other) = self.other.as_mut().filter(|_| !lost) {
            match other.evaluate(surfaces, batch, answers) {
                Ok(()) => return Ok(()),
                Err(error) => {
                    self.failures += 1;
                    self.failure = Some(error);
                }
            }
        }
        self.processor.evaluate(surfaces, batch, answers)
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
