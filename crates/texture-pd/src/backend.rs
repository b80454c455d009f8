//! Where directional penetration depths are computed.

use thiserror::Error;

use crate::kernels;
use crate::pairs::{DirectionalDepth, PatchPairs};

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
    /// The device failed.
    #[error("{device} failed: {reason}; make a new backend, or use the CPU one")]
    Device {
        /// The device.
        device: String,
        /// What it says.
        reason: String,
    },
}

/// Computes directional penetration depths. Every backend gives the same answers, but for overlaps below
/// 1.2e-38 m, which a GPU may flush to zero.
pub trait Backend: Send {
    /// What it runs on.
    fn name(&self) -> &str;

    /// The directional penetration depth of each pair, in their order, in place of what `depths` held. A pair
    /// that shares no texel has none.
    fn directional_depths(
        &mut self,
        pairs: &PatchPairs,
        depths: &mut Vec<Option<DirectionalDepth>>,
    ) -> Result<(), BackendError>;
}

/// The reference backend: one thread, pair after pair. It cannot fail, and allocates only to grow `depths`.
#[derive(Clone, Copy, Debug, Default)]
pub struct CpuBackend;

impl Backend for CpuBackend {
    fn name(&self) -> &str {
        "CPU"
    }

    fn directional_depths(
        &mut self,
        pairs: &PatchPairs,
        depths: &mut Vec<Option<DirectionalDepth>>,
    ) -> Result<(), BackendError> {
        depths.clear();
        depths.extend(pairs.pairs().iter().map(|pair| {
            let mut overlap = [[0; 2]];
            kernels::directional_depth(pairs.texels(), pairs.heights(), &[*pair], &mut overlap);
            pairs.decode(overlap[0])
        }));
        Ok(())
    }
}
