//! A dead-man switch: the wrench is rendered only while a button is held.

use palpate_core::Wrench;
use palpate_realtime::ThreadSetup;

use crate::{
    DeviceError, DeviceState, Gripper, GripperSpecification, GripperState, HapticDevice, Specification,
    Status,
};

/// Time in which the wrench rises from zero after the button is pressed, s.
const RISE_TIME: f64 = 0.2;

/// A device that renders a wrench only while one of its buttons is held. When the button is released, the
/// wrench is zero from the next write on, and [`Status::NOT_ENABLED`] is set, with [`Status::WITHHELD`] if
/// another wrench was commanded. When it is pressed, the wrench rises smoothly.
///
/// The haptic loop sees this in the status only: its energy figures are those of the commanded wrench.
#[derive(Debug)]
pub struct HoldToEnable<D>(Held<D>);

/// The device with the state of its button. It is also the gripper of the public type, whose torque it
/// withholds in the same way.
#[derive(Debug)]
struct Held<D> {
    device: D,
    /// Specification of the device's gripper, if it has one.
    gripper: Option<GripperSpecification>,
    /// The button's bit.
    button: u32,
    /// Time at which the button was pressed, s.
    held: Option<f64>,
    now: f64,
    /// Events of the wrench, and of the gripper's torque, since the last read.
    events: Status,
    gripper_events: Status,
}

impl<D: HapticDevice> HoldToEnable<D> {
    /// Enables the wrench by a button, counted from 0; a button beyond the 32nd is never held.
    pub fn new(mut device: D, button: u32) -> Self {
        Self(Held {
            gripper: device.gripper().map(|gripper| *gripper.specification()),
            device,
            button: 1_u32.checked_shl(button).unwrap_or(0),
            held: None,
            now: 0.0,
            events: Status::OK,
            gripper_events: Status::OK,
        })
    }
}

impl<D> Held<D> {
    /// Fraction of the wrench that is rendered, 0 to 1.
    fn share(&self) -> f64 {
        let x = self.held.map_or(0.0, |since| ((self.now - since) / RISE_TIME).clamp(0.0, 1.0));
        x * x * (3.0 - 2.0 * x)
    }
}

impl<D: HapticDevice> HapticDevice for HoldToEnable<D> {
    fn specification(&self) -> &Specification {
        self.0.device.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        let this = &mut self.0;
        let state = this.device.read(now);
        if now.is_finite() {
            this.now = this.now.max(now);
        }
        let pressed = state.as_ref().is_ok_and(|state| state.buttons & this.button != 0);
        this.held = pressed.then(|| this.held.unwrap_or(this.now));
        let mut state = state?;
        state.status |= std::mem::take(&mut this.events);
        if !pressed {
            state.status |= Status::NOT_ENABLED;
        }
        Ok(state)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        let this = &mut self.0;
        match this.share() {
            0.0 => {
                if *wrench != Wrench::ZERO {
                    this.events |= Status::WITHHELD;
                }
                this.device.write(&Wrench::ZERO)
            }
            share => this.device.write(&(*wrench * share)),
        }
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.0.device.close()
    }

    fn thread_setup(&self) -> Option<&ThreadSetup> {
        self.0.device.thread_setup()
    }

    fn gripper(&mut self) -> Option<&mut dyn Gripper> {
        self.0.gripper.is_some().then_some(&mut self.0 as _)
    }
}

impl<D: HapticDevice> Held<D> {
    fn inner(&mut self) -> Result<&mut dyn Gripper, DeviceError> {
        self.device.gripper().ok_or(DeviceError::Closed)
    }
}

impl<D: HapticDevice> Gripper for Held<D> {
    fn specification(&self) -> &GripperSpecification {
        // `gripper` gives this out only if there is a specification.
        self.gripper.as_ref().unwrap_or(&GripperSpecification::SENSED)
    }

    fn read(&mut self, now: f64) -> Result<GripperState, DeviceError> {
        let mut state = self.inner()?.read(now)?;
        state.status |= std::mem::take(&mut self.gripper_events);
        if self.held.is_none() {
            state.status |= Status::NOT_ENABLED;
        }
        Ok(state)
    }

    fn write(&mut self, torque: f64) -> Result<(), DeviceError> {
        match self.share() {
            0.0 => {
                if torque != 0.0 {
                    self.gripper_events |= Status::WITHHELD;
                }
                self.inner()?.write(0.0)
            }
            share => self.inner()?.write(torque * share),
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use palpate_core::Pose;

    use super::*;
    use crate::{Emulation, GripperEmulation};

    const WRENCH: Wrench = Wrench { force: DVec3::X, torque: DVec3::ZERO };

    #[test]
    fn wrench_is_zero_unless_the_button_is_held() {
        let mut device = HoldToEnable::new(Emulation::default().open(Pose::IDENTITY).unwrap(), 2);
        let applied = |device: &mut HoldToEnable<crate::EmulatedDevice>, now: f64, buttons: u32| {
            device.0.device.set_buttons(buttons);
            let status = device.read(now).unwrap().status;
            device.write(&WRENCH).unwrap();
            (device.0.device.applied_wrench().force.x, status.contains(Status::NOT_ENABLED))
        };
        assert_eq!(applied(&mut device, 0.0, 0), (0.0, true));
        assert_eq!(applied(&mut device, 0.1, 0b011), (0.0, true), "another button");
        let mut last = 0.0;
        for i in 0..=300 {
            let (force, disabled) = applied(&mut device, 0.2 + f64::from(i) * 1e-3, 0b100);
            assert!(!disabled && force >= last && force - last < 0.01, "{i}: {force}");
            last = force;
        }
        assert_eq!(last, 1.0);
        assert_eq!(applied(&mut device, 0.501, 0), (0.0, true), "let go");
        assert!(applied(&mut device, 0.502, 0b100).0 < 0.01, "it comes up again");
    }

    #[test]
    fn a_wrench_that_is_cut_to_zero_is_reported() {
        let mut device = HoldToEnable::new(Emulation::default().open(Pose::IDENTITY).unwrap(), 0);
        let mut withheld = |now: f64, buttons: u32, wrench: Wrench| {
            device.0.device.set_buttons(buttons);
            let status = device.read(now).unwrap().status;
            device.write(&wrench).unwrap();
            status.contains(Status::WITHHELD)
        };
        assert!(!withheld(0.0, 0, Wrench::ZERO));
        assert!(!withheld(0.1, 0, WRENCH), "zero was asked for");
        assert!(withheld(0.2, 1, WRENCH));
        assert!(withheld(0.3, 1, WRENCH), "pressed this instant, it was zero");
        assert!(!withheld(0.4, 0, WRENCH));
        assert!(withheld(0.5, 0, WRENCH), "let go");
    }

    #[test]
    fn the_torque_of_a_gripper_is_withheld_as_the_wrench_is() {
        let device = Emulation::default().open(Pose::IDENTITY).unwrap();
        assert!(HoldToEnable::new(device, 0).gripper().is_none());
        let device = Emulation::default().open(Pose::IDENTITY).unwrap();
        let mut device = HoldToEnable::new(device.with_gripper(GripperEmulation::default(), 0.3).unwrap(), 0);
        let mut applied = |now: f64, buttons: u32| {
            device.0.device.set_buttons(buttons);
            device.read(now).unwrap();
            let gripper = device.gripper().unwrap();
            let status = gripper.read(now).unwrap().status;
            gripper.write(0.1).unwrap();
            (device.0.device.emulated_gripper().unwrap().applied_torque(), status)
        };
        assert_eq!(applied(0.0, 0), (0.0, Status::NOT_ENABLED));
        assert_eq!(applied(0.1, 0), (0.0, Status::NOT_ENABLED | Status::WITHHELD));
        assert_eq!(applied(0.2, 1), (0.0, Status::WITHHELD));
        let (half, status) = applied(0.3, 1);
        assert!(
            (half - 0.05).abs() < 1e-12 && status == Status::WITHHELD,
            "{half} in half the time of the rise"
        );
        assert_eq!(applied(0.4, 1), (0.1, Status::OK));
        assert_eq!(applied(0.401, 0), (0.0, Status::NOT_ENABLED));
    }

    #[test]
    fn a_wrench_that_is_not_finite_is_refused() {
        let mut device = HoldToEnable::new(Emulation::default().open(Pose::IDENTITY).unwrap(), 0);
        device.0.device.set_buttons(1);
        device.read(0.0).unwrap();
        device.read(0.15).unwrap();
        device.write(&Wrench::new(DVec3::NAN, DVec3::ZERO)).unwrap();
        assert!(device.read(0.16).unwrap().status.contains(Status::WRENCH_REFUSED));
        assert_eq!(device.0.device.applied_wrench(), Wrench::ZERO);
        assert!(HoldToEnable::new(device, 40).read(0.2).unwrap().status.contains(Status::NOT_ENABLED));
    }
}
