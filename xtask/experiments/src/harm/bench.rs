//! Device of a session: an emulated one with its hand, and all faults between it and the engine.

use palpate::device::{DeviceError, DeviceState, EmulatedDevice, Hand, HapticDevice, Specification, Status};
use palpate::{Pose, Settings, Twist, Wrench};
use rand::rngs::StdRng;

use super::faults::{Fault, Kind};
use super::judge::{Judge, Step};

/// Changes the wrench that the engine asks for (first argument) while the device holds another (second). The
/// identity except in tests of the judge.
pub type Tamper = fn(&Wrench, &Wrench) -> Wrench;

pub struct Bench {
    device: EmulatedDevice,
    /// Hand that holds the device unless it lets go.
    hand: Hand,
    /// True time, s.
    pub time: f64,
    pub step: Step,
    /// Faults that act in this step.
    pub faults: Vec<Fault>,
    /// Displacement of the device since contact with it was lost.
    offset: Pose,
    last: Option<DeviceState>,
    pub judge: Judge,
    tamper: Tamper,
    rng: StdRng,
    held: Wrench,
    holds: Option<Kind>,
}

impl Bench {
    pub fn new(device: EmulatedDevice, settings: &Settings, tamper: Tamper, rng: StdRng) -> Self {
        Self {
            hand: device.emulation().hand,
            judge: Judge::new(device.specification(), settings),
            device,
            time: 0.0,
            step: Step::default(),
            faults: Vec::new(),
            offset: Pose::IDENTITY,
            last: None,
            tamper,
            rng,
            held: Wrench::ZERO,
            holds: None,
        }
    }

    /// Returns the emulated device with its hand.
    pub fn device(&self) -> &EmulatedDevice {
        &self.device
    }

    /// Returns the wrench that the device renders, in the axes of its readings.
    pub fn held(&self) -> &Wrench {
        &self.held
    }

    /// Returns the true motion of the handle, in the same axes.
    pub fn twist(&self) -> Twist {
        let Twist { linear, angular } = self.device.handle().1;
        Twist::new(self.offset.rotation * linear, self.offset.rotation * angular)
    }

    pub fn is_there(&self, kind: Kind) -> Option<&Fault> {
        self.faults.iter().find(|fault| fault.kind == kind)
    }

    /// Lets the hand release or grasp the handle where that has changed.
    pub fn take_hold(&mut self) -> Result<(), DeviceError> {
        let wanted = [Kind::LetGo, Kind::Gripped].into_iter().find_map(|kind| self.is_there(kind)).copied();
        let kind = wanted.map(|fault| fault.kind);
        if kind == self.holds {
            return Ok(());
        }
        self.holds = kind;
        self.device.hold_with(match wanted {
            Some(fault) if fault.kind == Kind::Gripped => {
                Hand { stiffness: fault.between(1.0, 5e3), damping: fault.between(0.05, 50.0), ..self.hand }
            }
            Some(_) => Hand::NONE,
            None => self.hand,
        })
    }

    /// Presses or releases the device's button.
    pub fn press(&mut self) {
        let pressed = self.is_there(Kind::Pressed).is_some();
        self.device.set_buttons(u32::from(pressed));
    }

    /// Makes the device render nothing, whatever it was asked for.
    fn withhold(&mut self) -> Result<(), DeviceError> {
        self.held = Wrench::ZERO;
        self.judge.forget();
        self.device.write(&Wrench::ZERO)
    }
}

impl HapticDevice for Bench {
    fn specification(&self) -> &Specification {
        self.device.specification()
    }

    fn read(&mut self, _: f64) -> Result<DeviceState, DeviceError> {
        let mut state = self.device.read(self.time)?;
        if let Some(elsewhere) = self.is_there(Kind::Elsewhere) {
            let (translation, turn) = elsewhere.offset();
            self.offset = Pose::new(translation, turn);
        }
        if self.offset != Pose::IDENTITY {
            state.pose = self.offset * state.pose;
            state.pose.rotation = state.pose.rotation.normalize();
            let Twist { linear, angular } = state.twist;
            state.twist = Twist::new(self.offset.rotation * linear, self.offset.rotation * angular);
        }
        if self.is_there(Kind::Unread).or(self.is_there(Kind::Elsewhere)).is_some() {
            self.judge.read(None, self.time);
            self.withhold()?;
            return Err(DeviceError::Closed);
        }
        for fault in &self.faults {
            fault.spoil(&mut state, self.last.as_ref(), &mut self.rng);
        }
        // After the other faults: a driver knows what it has withheld itself.
        if self.is_there(Kind::Withheld).is_some() {
            self.withhold()?;
            state.status |= Status::WITHHELD;
        }
        self.judge.read(Some(&state), self.time);
        self.last = Some(state);
        Ok(state)
    }

    fn write(&mut self, wrench: &Wrench) -> Result<(), DeviceError> {
        let wrench = (self.tamper)(wrench, &self.held);
        self.judge.write(&wrench, self.time, &self.step);
        let lost = [Kind::Unread, Kind::Elsewhere, Kind::Unwritten];
        if lost.into_iter().any(|kind| self.is_there(kind).is_some()) {
            self.withhold()?;
            return Err(DeviceError::Closed);
        }
        self.held = wrench;
        // The device's axes turned with its displacement.
        let back = self.offset.rotation.conjugate();
        self.device.write(&Wrench::new(back * wrench.force, back * wrench.torque))
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        self.device.close()
    }
}
