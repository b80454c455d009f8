//! Parts common to the drivers for makers' SDKs: addresses, timeouts, specifications and the count of failed
//! calls.

use std::path::PathBuf;
use std::time::Duration;

use super::motion::SdkMotion;
use super::{SdkCodec, SdkState};
use crate::link::{Found, LONGEST_REPORT, Link, TransportError};
use crate::{Axes, DeviceError, Emulation, HapticDevice, Specification};

/// Longest time that a round waits for a state.
const READ_TIMEOUT: Duration = Duration::from_millis(5);
/// Time without a state after which a device counts as lost, s.
const SILENCE_TIMEOUT: f64 = 0.02;
/// Number of consecutive failed calls after which a device counts as disconnected.
const MAX_FAILURES: u32 = 4;

/// The part of an address after the colon: the device and the library, `WHICH@LIBRARY`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Address {
    /// `None` if left out.
    pub which: Option<String>,
    pub library: Option<PathBuf>,
}

impl Address {
    pub fn parse(address: Option<&str>) -> Self {
        let address = address.unwrap_or_default();
        let (which, library) = address.split_once('@').unwrap_or((address, ""));
        let given = |part: &str| (!part.is_empty()).then(|| part.to_owned());
        Self { which: given(which), library: given(library).map(PathBuf::from) }
    }
}

/// Opens a device through `connect`, which is called in the pump's thread.
pub(super) fn open(
    maker: &str,
    connect: impl FnMut() -> Result<Found<SdkMotion>, DeviceError> + Send + 'static,
) -> Result<Box<dyn HapticDevice>, DeviceError> {
    let specification = specification(maker.into(), None, Axes::ALL, Axes::NONE, 0.0);
    let motion = SdkMotion::new(&specification);
    let link =
        Link { codec: SdkCodec, motion, specification, read_timeout: READ_TIMEOUT, silence: SILENCE_TIMEOUT };
    Ok(Box::new(link.spawn_apart(connect)?))
}

/// Specification of a device: that of the emulation `preset`, or of the weakest one if the model is not
/// known. Torque is nonzero only if the device drives rotations. `round` is the shortest time from one round
/// of the pump to the next, s.
pub(super) fn specification(
    name: String,
    preset: Option<&str>,
    sensed: Axes,
    actuated: Axes,
    round: f64,
) -> Specification {
    let figures = |preset: &str| Emulation::preset(preset).unwrap_or_default().specification;
    let of = figures(preset.unwrap_or("touch"));
    let turns =
        if actuated == Axes::ALL && of.peak_torque == 0.0 { figures("premium-1.5") } else { of.clone() };
    let torque = |figure: f64| if actuated == Axes::ALL { figure } else { 0.0 };
    Specification {
        name,
        peak_torque: torque(turns.peak_torque),
        continuous_torque: torque(turns.continuous_torque),
        angular_stiffness: torque(turns.angular_stiffness),
        angular_damping: torque(turns.angular_damping),
        sensed,
        actuated,
        // A reading is answered after the next one has been read, and the device takes that up in its own
        // round.
        delay: 2.0 * round,
        // The handle of an emulation does not describe a real unit.
        handle: None,
        ..of
    }
}

/// Number of consecutive failed calls.
#[derive(Debug, Default)]
pub(super) struct Failures(u32);

impl Failures {
    /// Counts the outcome of a call: `Disconnected` after the last of [`MAX_FAILURES`] consecutive failures,
    /// `Failed` before.
    pub fn judge<T>(&mut self, outcome: Option<T>) -> Result<T, TransportError> {
        self.0 = if outcome.is_some() { 0 } else { self.0.saturating_add(1) };
        outcome.ok_or(if self.0 < MAX_FAILURES {
            TransportError::Failed
        } else {
            TransportError::Disconnected
        })
    }
}

/// Writes a state into `report`; gives its length.
pub(super) fn write_state(
    state: Option<SdkState>,
    failures: &mut Failures,
    report: &mut [u8; LONGEST_REPORT],
) -> Result<usize, TransportError> {
    let state = failures.judge(state)?.to_report();
    report[..state.len()].copy_from_slice(&state);
    Ok(state.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_name_a_device_and_a_library() {
        let address = |which: Option<&str>, library: Option<&str>| Address {
            which: which.map(str::to_owned),
            library: library.map(PathBuf::from),
        };
        assert_eq!(Address::parse(None), address(None, None));
        assert_eq!(Address::parse(Some("")), address(None, None));
        assert_eq!(Address::parse(Some("Left Device")), address(Some("Left Device"), None));
        assert_eq!(Address::parse(Some("@/a/b.so")), address(None, Some("/a/b.so")));
        assert_eq!(
            Address::parse(Some("127.0.0.1:53210#5125@C:\\x.dll")),
            address(Some("127.0.0.1:53210#5125"), Some("C:\\x.dll"))
        );
    }

    #[test]
    fn figures_are_those_of_the_emulation_and_torque_is_for_those_that_drive_it() {
        let omega = specification("omega.6".into(), Some("omega"), Axes::ALL, Axes::TRANSLATION, 1e-3);
        assert_eq!((omega.peak_force, omega.peak_torque, omega.angular_stiffness), (12.0, 0.0, 0.0));
        let sigma = specification("sigma.7".into(), Some("sigma.7"), Axes::ALL, Axes::ALL, 1e-3);
        assert_eq!((sigma.peak_force, sigma.peak_torque), (20.0, 0.4));
        // An unknown device has the smallest figures.
        let unknown = specification("?".into(), None, Axes::ALL, Axes::ALL, 1e-3);
        for (preset, _) in Emulation::presets() {
            let known = Emulation::preset(preset).unwrap().specification;
            assert!(unknown.peak_force <= known.peak_force, "{preset}");
            assert!(known.peak_torque == 0.0 || unknown.peak_torque <= known.peak_torque, "{preset}");
        }
        assert_eq!((unknown.handle, unknown.delay), (None, 2e-3));
    }

    #[test]
    fn failures_are_counted() {
        let mut failures = Failures::default();
        for _ in 0..2 {
            for _ in 1..MAX_FAILURES {
                assert_eq!(failures.judge::<()>(None), Err(TransportError::Failed));
            }
            assert_eq!(failures.judge(Some(7)), Ok(7));
        }
        let last = (0..MAX_FAILURES).map(|_| failures.judge::<()>(None)).last();
        assert_eq!(last, Some(Err(TransportError::Disconnected)));
    }
}
