//! Where directional penetration depths are computed.

use std::time::Duration;

use thiserror::Error;

use crate::batch::{Batch, SurfaceSet};
use crate::kernels::{self, Answer};

/// Why a backend could not be used.
#[derive(Debug, Error)]
pub enum BackendError {
    /// There is no GPU, nor a software driver that stands in for one.
    #[error(
        "no GPU adapter was found ({reason}); install a Vulkan driver: on Debian and Ubuntu `apt-get install \
         mesa-vulkan-drivers`, on Fedora `dnf install mesa-vulkan-drivers`, on Arch `pacman -S vulkan-swrast` (each \
         brings a software driver that needs no GPU), for an NVIDIA card its own driver; or use the CPU backend"
    )]
    NoAdapter {
        /// What was tried.
        reason: String,
    },
    /// The adapter gives no device.
    #[error("{adapter} gives no device ({reason}); update its driver, or use the CPU backend")]
    NoDevice {
        /// The adapter.
        adapter: String,
        /// What it says.
        reason: String,
    },
    /// The batch is larger than the device takes at once.
    #[error("{what} take {bytes} bytes and {device} binds at most {limit}; evaluate the batch in parts")]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// Its size.
        bytes: u64,
        /// The largest size.
        limit: u64,
        /// The device.
        device: String,
    },
    /// The answers did not come in time; the device may still be at work.
    #[error("{device} gave no answer within {deadline:?}; let another backend compute the batch")]
    Late {
        /// The device.
        device: String,
        /// How long it was waited for ([`Backend::set_deadline`]).
        deadline: Duration,
    },
    /// The device failed.
    #[error("{device} failed: {reason}; make a new backend, or use the CPU one")]
    Device {
        /// The device.
        device: String,
        /// What it says.
        reason: String,
    },
}

impl BackendError {
    /// Whether the next batch fails as well: not where this one was too large, or its answers were late.
    pub fn is_lasting(&self) -> bool {
        !matches!(self, Self::TooLarge { .. } | Self::Late { .. })
    }
}

/// Evaluates batches. Every backend gives the same answers, to within rounding.
pub trait Backend: Send {
    /// What it runs on.
    fn name(&self) -> &str;

    /// Answers for the pairs of a batch, in their order, in place of what `answers` held. The surfaces' textures are looked at
    /// again only where the set is another one, or has grown.
    ///
    /// # Errors
    /// If the device fails, is too small, or does not answer in time.
    fn evaluate(
        &mut self,
        surfaces: &SurfaceSet,
        batch: &Batch,
        answers: &mut Vec<Answer>,
    ) -> Result<(), BackendError>;

    /// How long [`evaluate`](Self::evaluate) may wait for a device from now on, where there is one.
    fn set_deadline(&mut self, _deadline: Duration) {}

    /// How many batches failed so far that it had another backend compute, where it has one to go over to.
    fn failures(&self) -> u64 {
        0
    }
}

/// The kernels' twins on the processor, one after the other: what the other backends are held against. It cannot fail.
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
