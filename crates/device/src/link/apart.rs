//! Devices that are also opened in the pump's thread: for libraries that want all their calls from one
//! thread.

use super::codec::{Codec, Motion};
use super::device::LinkedDevice;
use super::transport::Transport;
use super::{FIRST_REPORT_TIMEOUT, Link, run};
use crate::{DeviceError, Specification};

/// An opened device with its specification and motion.
pub(crate) struct Found<M> {
    pub transport: Box<dyn Transport>,
    pub specification: Specification,
    pub motion: M,
}

impl<C: Codec, M: Motion<Sample = C::Sample> + 'static> Link<C, M> {
    /// Spawns a device with its pump in a thread. Only that thread calls `open`, now and whenever the device
    /// is gone. The first device that it opens gives specification and motion.
    pub(crate) fn spawn_apart(
        self,
        mut open: impl FnMut() -> Result<Found<M>, DeviceError> + Send + 'static,
    ) -> Result<LinkedDevice<M>, DeviceError> {
        let name = self.specification.name.clone();
        let not_opened = |reason: String| DeviceError::NotOpened {
            device: name,
            reason,
            remedy: "end other programs and try again",
        };
        let (answer, answered) = std::sync::mpsc::channel();
        let mut answer = Some(answer);
        let open = move || {
            let (transport, found) = match open() {
                Ok(found) => (Some(found.transport), Ok((found.specification, found.motion))),
                Err(error) => (None, Err(error)),
            };
            if let Some(answer) = answer.take() {
                // The caller may have given up.
                let _ = answer.send(found);
            }
            transport
        };
        let (pump, mut device) = self.closed(open);
        if let Err(error) = run(pump, &mut device) {
            return Err(not_opened(error.to_string()));
        }
        let (specification, motion) =
            answered.recv().map_err(|_| not_opened("its driver failed".into()))??;
        device.specify(specification, motion);
        device.await_first_report(FIRST_REPORT_TIMEOUT);
        Ok(device)
    }
}
