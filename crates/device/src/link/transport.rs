//! What carries reports between a device and the host.

use std::time::Duration;

/// The longest report that is read or written, bytes.
pub const LONGEST_REPORT: usize = 128;

/// Why a report could not be carried.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TransportError {
    /// The device has gone: what opened it may open it again.
    #[error("the device is not connected")]
    Disconnected,
    /// This time only.
    #[error("the report was not carried")]
    Failed,
}

/// Carries reports of at most [`LONGEST_REPORT`] bytes, each whole. Over HID, numbered reports begin with their number, and
/// written ones begin with 0 where they have none.
pub trait Transport: Send {
    /// The report that has waited longest, and its length; 0 where none comes in time.
    ///
    /// # Errors
    /// See [`TransportError`].
    fn read(
        &mut self,
        report: &mut [u8; LONGEST_REPORT],
        patience: Duration,
    ) -> Result<usize, TransportError>;

    /// Sends a report.
    ///
    /// # Errors
    /// See [`TransportError`].
    fn write(&mut self, report: &[u8]) -> Result<(), TransportError>;

    /// Sets a feature report, which may take seconds.
    ///
    /// # Errors
    /// See [`TransportError`].
    fn set_feature(&mut self, report: &[u8]) -> Result<(), TransportError> {
        let _ = report;
        Err(TransportError::Failed)
    }

    /// Gets the feature report whose number stands in its first byte, and its length; it may take seconds.
    ///
    /// # Errors
    /// See [`TransportError`].
    fn get_feature(&mut self, report: &mut [u8; LONGEST_REPORT]) -> Result<usize, TransportError> {
        let _ = report;
        Err(TransportError::Failed)
    }
}

impl<T: Transport + ?Sized> Transport for Box<T> {
    fn read(
        &mut self,
        report: &mut [u8; LONGEST_REPORT],
        patience: Duration,
    ) -> Result<usize, TransportError> {
        (**self).read(report, patience)
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        (**self).write(report)
    }

    fn set_feature(&mut self, report: &[u8]) -> Result<(), TransportError> {
        (**self).set_feature(report)
    }

    fn get_feature(&mut self, report: &mut [u8; LONGEST_REPORT]) -> Result<usize, TransportError> {
        (**self).get_feature(report)
    }
}
