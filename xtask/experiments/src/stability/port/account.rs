//! The energy that a hand gives to device and session.

use std::sync::{Arc, Mutex, PoisonError};

use palpate::Wrench;
use palpate::device::{DeviceError, DeviceState, EmulatedDevice, Emulation, HapticDevice, Specification};

/// Heat from which on the share of it counts that the hand gave, J.
const ENOUGH: f64 = 1e-5;

/// Energy that a hand has given to device and session.
#[derive(Clone, Copy, Debug)]
pub struct Energy {
    /// What became heat in the device, J.
    heat: f64,
    /// Least and most that had been given at any time, J.
    pub least: f64,
    pub most: f64,
    /// Least part of the heat that had been given, once there was enough.
    pub share: f64,
}

impl Default for Energy {
    fn default() -> Self {
        Self { heat: 0.0, least: 0.0, most: 0.0, share: f64::INFINITY }
    }
}

/// Access to the account of a device that a session owns.
#[derive(Clone, Debug, Default)]
pub struct Account(Arc<Mutex<Energy>>);

impl Account {
    pub fn energy(&self) -> Energy {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Emulated device whose energy is counted at each of its substeps.
pub struct Counted {
    device: EmulatedDevice,
    account: Account,
    ticks: u64,
}

impl Counted {
    pub fn new(device: EmulatedDevice) -> (Self, Account) {
        let account = Account::default();
        (Self { device, account: account.clone(), ticks: 0 }, account)
    }

    fn count(&mut self) {
        let Emulation { handle, substep, .. } = *self.device.emulation();
        let twist = self.device.handle().1;
        let (speed, turning) = (twist.linear.length(), twist.angular.length());
        // As the emulation's steps, with the velocity at their end.
        let power = (handle.damping * speed + handle.friction) * speed
            + (handle.angular_damping * turning + handle.angular_friction) * turning;
        let mut energy = self.account.0.lock().unwrap_or_else(PoisonError::into_inner);
        energy.heat += power * substep;
        let given = energy.heat - self.device.work();
        energy.least = energy.least.min(given);
        energy.most = energy.most.max(given);
        if energy.heat > ENOUGH {
            energy.share = energy.share.min(given / energy.heat);
        }
    }
}

impl HapticDevice for Counted {
    fn specification(&self) -> &Specification {
        self.device.specification()
    }

    fn read(&mut self, now: f64) -> Result<DeviceState, DeviceError> {
        let substep = self.device.emulation().substep;
        let mut state = self.device.read(self.ticks as f64 * substep)?;
        for _ in self.ticks..(now / substep).round() as u64 {
            self.ticks += 1;
            state = self.device.read(self.ticks as f64 * substep)?;
            self.count();
        }
        Ok(state)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        self.device.write(wrench)
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.device.close()
    }
}
