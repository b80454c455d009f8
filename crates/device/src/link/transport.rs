//! Transport of reports between a device and the host.

use std::time::Duration;

/// Longest report that is read or written, bytes.
pub const LONGEST_REPORT: usize = 128;

/// Reason why a report could not be carried.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TransportError {
    /// The device is gone; its opener may open it again.
    #[error("the device is not connected")]
    Disconnected,
    /// The report failed; the next one may not.
    #[error("the report was not carried")]
    Failed,
}

/// Carries reports of at most [`LONGEST_REPORT`] bytes, each whole. Over HID, numbered reports begin with
/// their number; reports without one are written with a leading 0.
pub trait Transport: Send {
    /// Takes the oldest waiting report; gives its length, or 0 if none comes in time.
    ///
    /// # Errors
    /// See [`TransportError`].
    fn read(&mut self, report: &mut [u8; LONGEST_REPORT], timeout: Duration)
    -> Result<usize, TransportError>;

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

    /// Gets the feature report whose number is in its first byte; gives its length. It may take seconds.
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
        timeout: Duration,
    ) -> Result<usize, TransportError> {
        (**self).read(report, timeout)
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
