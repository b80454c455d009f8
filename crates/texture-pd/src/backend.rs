//! Backends that compute directional penetration depths.

use std::time::Duration;

use thiserror::Error;

use crate::batch::{Batch, SurfaceSet};
use crate::kernels::{self, Answer};

/// Reason why a backend could not be used.
#[derive(Debug, Error)]
pub enum BackendError {
    /// There is no GPU, and no software driver that replaces one.
    #[error(
        "no GPU adapter was found ({reason}); install a Vulkan driver: on Debian and Ubuntu `apt-get install \
         mesa-vulkan-drivers`, on Fedora `dnf install mesa-vulkan-drivers`, on Arch `pacman -S vulkan-swrast` (each \
         brings a software driver that needs no GPU), for an NVIDIA card its own driver; or use the CPU backend"
    )]
    NoAdapter {
        /// Adapters that were tried.
        reason: String,
    },
    /// The adapter provided no device.
    #[error("{adapter} provided no device ({reason}); update its driver, or use the CPU backend")]
    NoDevice {
        /// Name of the adapter.
        adapter: String,
        /// Error message of the adapter.
        reason: String,
    },
    /// The batch is too large for the device.
    #[error("{what} take {bytes} bytes and {device} binds at most {limit}; evaluate the batch in parts")]
    TooLarge {
        /// Name of the buffer that is too large.
        what: &'static str,
        /// Size of the buffer, bytes.
        bytes: u64,
        /// Largest size that the device binds, bytes.
        limit: u64,
        /// Name of the device.
        device: String,
    },
    /// The answers did not arrive in time; the device may still be working.
    #[error("{device} gave no answer within {deadline:?}; let another backend compute the batch")]
    Late {
        /// Name of the device.
        device: String,
        /// Time after which the wait ended ([`Backend::set_deadline`]).
        deadline: Duration,
    },
    /// The device failed.
    #[error("{device} failed: {reason}; make a new backend, or use the CPU one")]
    Device {
        /// Name of the device.
        device: String,
        /// Error message of the device.
        reason: String,
    },
}

impl BackendError {
    /// Returns whether the next batch would fail as well: not if this one was too large, or its answers were
    /// late.
    pub fn is_lasting(&self) -> bool {
        !matches!(self, Self::TooLarge { .. } | Self::Late { .. })
    }
}

/// An evaluator of batches. Every backend gives the same answers, to within rounding.
pub trait Backend: Send {
    /// Name of the device that it runs on.
    fn name(&self) -> &str;

    /// Replaces `answers` by those for the pairs of a batch, in order. The surfaces' textures are uploaded
    /// again only if the set is a different one, or has grown.
    ///
    /// # Errors
    /// If the device fails, is too small, or does not answer in time.
    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError>;

    /// Sets how long [`evaluate`](Self::evaluate) may wait for a device. Backends without a device ignore it.
    fn set_deadline(&mut self, _deadline: Duration) {}

    /// Number of batches so far that failed and were computed by a fallback. 0 for backends without a
    /// fallback.
    fn failures(&self) -> u64 {
        0
    }
}

/// The kernels' CPU twins, run one after the other. Other backends are tested against it. It cannot fail.
#[derive(Clone, Debug, Default)]
pub struct ReferenceBackend {
    heights: Vec<[u32; 2]>,
}

impl ReferenceBackend {
    /// A backend with an empty workspace.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Backend for ReferenceBackend {
    fn name(&self) -> &str {
        "reference"
    }

    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError> {
        let SurfaceSet { levels, coefficients, .. } = surfaces;
        let Batch { header, triangles, images, pairs } = batch;
        self.heights.resize(batch.texels(), [0; 2]);
        answers.resize(pairs.len(), Answer::default());
        kernels::height_images(header, triangles, images, levels, coefficients, &mut self.heights);
        kernels::overlaps(header, triangles, images, levels, coefficients, &self.heights, pairs, answers);
        Ok(())
    }
}
