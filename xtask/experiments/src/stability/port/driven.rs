//! A session whose device goes where it is told, without a hand: what the session answers is measured alone.

use std::collections::VecDeque;

use palpate::device::{DeviceError, DeviceState, HapticDevice, LowPass, Specification, Status};
use palpate::glam::{DQuat, DVec3};
use palpate::settings::Response;
use palpate::{
    ContactLoop, ContactUpdate, HandlePlacement, HapticLoop, HapticRenderer, Object, Pose, Scene, Settings,
    Twist, Wrench,
};

/// Period of the haptic loop, s.
pub const PERIOD: f64 = 1e-3;

/// What is driven at its port: a session, or a law that is compared with one.
pub trait Port {
    /// Takes a step of [`PERIOD`] with the handle at a pose at its end. Returns the wrench on the hand, in
    /// device axes.
    fn step(&mut self, handle: &Pose) -> Wrench;
}

/// Loops of a session in lockstep, with the readings of a device that is driven.
pub struct Driven {
    haptic: HapticLoop,
    contact: ContactLoop,
    readings: Readings,
    /// Steps from one contact query to the next, each of which takes as long.
    every: u64,
    steps: u64,
    pending: VecDeque<(u64, ContactUpdate)>,
}

impl Driven {
    /// Starts a session that holds `probe` at a pose of its mesh, with contacts at a rate (Hz).
    ///
    /// # Errors
    /// If the session cannot start.
    pub fn start(
        (probe, scene): (&Object, &Scene),
        specification: &Specification,
        settings: Settings,
        rate: f64,
        mesh: &Pose,
    ) -> Result<(Self, Pose), String> {
        let handle = HandlePlacement::new(&settings, probe, specification).device_pose(mesh);
        let readings = Readings::new(specification, &handle);
        let device = Standing { specification: specification.clone(), state: readings.state(0.0) };
        let renderer = HapticRenderer::new(probe.clone(), scene.clone(), Box::new(device), settings)
            .map_err(|error| error.to_string())?;
        let (haptic, contact, _) = renderer.into_loops();
        let every = (1.0 / (rate * PERIOD)).round().max(1.0) as u64;
        Ok((Self { haptic, contact, readings, every, steps: 0, pending: VecDeque::new() }, handle))
    }

    pub fn haptic(&self) -> &HapticLoop {
        &self.haptic
    }
}

impl Port for Driven {
    fn step(&mut self, handle: &Pose) -> Wrench {
        if self.steps.is_multiple_of(self.every) {
            let update = self.contact.step(self.haptic.body_state(), self.steps as f64 * PERIOD);
            self.pending.push_back((self.steps + self.every, update));
        }
        self.steps += 1;
        while let Some((_, update)) = self.pending.pop_front_if(|(from, _)| *from <= self.steps) {
            self.haptic.update_contacts(&update);
        }
        let now = self.steps as f64 * PERIOD;
        self.readings.take(handle);
        self.haptic.step(&self.readings.state(now), now, PERIOD).coupling
    }
}

/// The engine's settings with contacts as constraints.
pub fn constrained() -> Settings {
    let mut settings = Settings::default();
    settings.contact.response = Response::Constraints;
    settings
}

/// Readings of the encoders of an emulated device, rounded as it rounds them.
struct Readings {
    step: f64,
    angular_step: f64,
    pose: Pose,
    linear: LowPass,
    angular: LowPass,
}

impl Readings {
    fn new(specification: &Specification, handle: &Pose) -> Self {
        let mut readings = Self {
            step: specification.encoder_step,
            angular_step: specification.angular_encoder_step,
            pose: Pose::IDENTITY,
            linear: LowPass::new(specification.velocity_delay),
            angular: LowPass::new(specification.velocity_delay),
        };
        readings.pose = readings.rounded(handle);
        readings
    }

    fn take(&mut self, handle: &Pose) {
        let pose = self.rounded(handle);
        self.linear.push(pose.translation - self.pose.translation, PERIOD);
        self.angular.push(self.pose.rotation_vector_to(&pose), PERIOD);
        self.pose = pose;
    }

    fn rounded(&self, handle: &Pose) -> Pose {
        let to = |vector: DVec3, step: f64| (vector / step).round() * step;
        let mut pose = *handle;
        if self.step > 0.0 {
            pose.translation = to(pose.translation, self.step);
        }
        if self.angular_step > 0.0 {
            let turn = to(Pose::IDENTITY.rotation_vector_to(&pose), self.angular_step);
            pose.rotation = DQuat::from_scaled_axis(turn);
        }
        pose
    }

    fn state(&self, time: f64) -> DeviceState {
        let twist = Twist::new(self.linear.velocity(), self.angular.velocity());
        DeviceState { time, pose: self.pose, twist, buttons: 0, status: Status::OK }
    }
}

/// A device at which a session starts.
struct Standing {
    specification: Specification,
    state: DeviceState,
}

impl HapticDevice for Standing {
    fn specification(&self) -> &Specification {
        &self.specification
    }

    fn read(&mut self, _: f64) -> Result<DeviceState, DeviceError> {
        Ok(self.state)
    }

    fn write(&mut self, _: &Wrench) -> Result<(), DeviceError> {
        Ok(())
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}
