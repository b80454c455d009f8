//! A session whose device goes where it is told, without a hand: what the session answers is measured alone.

use std::sync::{Arc, Mutex, PoisonError};

use palpate::device::{DeviceError, DeviceState, HapticDevice, LowPass, Specification, Status};
use palpate::glam::{DQuat, DVec3};
use palpate::settings::Response;
use palpate::{
    ContactTiming, HandlePlacement, HapticLoop, HapticRenderer, LockstepSession, Object, Pose, Record, Scene,
    Settings, Twist, Wrench,
};

/// Period of the haptic loop, s.
pub const PERIOD: f64 = 1e-3;

/// What is driven at its port: a session, or a law that is compared with one.
pub trait Port {
    /// Takes a step of [`PERIOD`] with the handle at a pose at its end. Returns the wrench on the hand, in
    /// device axes.
    fn step(&mut self, handle: &Pose) -> Wrench;
}

/// A session in lockstep with a device that is driven.
pub struct Driven {
    session: LockstepSession,
    handle: Arc<Mutex<Pose>>,
}

impl Driven {
    /// Starts a session that holds `probe` at a pose of its mesh, with contacts at a rate (Hz). Returns it
    /// with the handle's pose.
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
        let at = HandlePlacement::new(&settings, probe, specification).device_pose(mesh);
        let handle = Arc::new(Mutex::new(at));
        let device = Led::new(specification, at, handle.clone());
        let renderer = HapticRenderer::new(probe.clone(), scene.clone(), Box::new(device), settings)
            .map_err(|error| error.to_string())?;
        Ok((Self { session: renderer.lockstep(ContactTiming::busy(rate)), handle }, at))
    }

    pub fn haptic(&self) -> &HapticLoop {
        self.session.haptic()
    }

    /// Takes a step of [`PERIOD`] with the handle at a pose at its end.
    pub fn advance(&mut self, handle: &Pose) -> Record {
        *self.handle.lock().unwrap_or_else(PoisonError::into_inner) = *handle;
        self.session.step_device()
    }
}

impl Port for Driven {
    fn step(&mut self, handle: &Pose) -> Wrench {
        self.advance(handle).coupling
    }
}

/// The engine's settings with contacts as constraints.
pub fn constrained() -> Settings {
    let mut settings = Settings::default();
    settings.contact.response = Response::Constraints;
    settings
}

/// A device whose handle is wherever it is led. It reads as an emulated one does, rounded to encoder steps,
/// but renders nothing.
struct Led {
    specification: Specification,
    handle: Arc<Mutex<Pose>>,
    reading: Pose,
    linear: LowPass,
    angular: LowPass,
}

impl Led {
    fn new(specification: &Specification, at: Pose, handle: Arc<Mutex<Pose>>) -> Self {
        Self {
            reading: rounded(&at, specification),
            linear: LowPass::new(specification.velocity_delay),
            angular: LowPass::new(specification.velocity_delay),
            specification: specification.clone(),
            handle,
        }
    }
}

/// A pose rounded to encoder steps, by axis and by component of the rotation vector.
pub fn rounded(pose: &Pose, specification: &Specification) -> Pose {
    let to = |vector: DVec3, step: f64| (vector / step).round() * step;
    let Specification { encoder_step, angular_encoder_step, .. } = *specification;
    let mut pose = *pose;
    if encoder_step > 0.0 {
        pose.translation = to(pose.translation, encoder_step);
    }
    if angular_encoder_step > 0.0 {
        let turn = to(Pose::IDENTITY.rotation_vector_to(&pose), angular_encoder_step);
        pose.rotation = DQuat::from_scaled_axis(turn);
    }
    pose
}

impl HapticDevice for Led {
    fn specification(&self) -> &Specification {
        &self.specification
    }

    fn read(&mut self, time: f64) -> Result<DeviceState, DeviceError> {
        let handle = *self.handle.lock().unwrap_or_else(PoisonError::into_inner);
        let pose = rounded(&handle, &self.specification);
        self.linear.push(pose.translation - self.reading.translation, PERIOD);
        self.angular.push(self.reading.rotation_vector_to(&pose), PERIOD);
        self.reading = pose;
        let twist = Twist::new(self.linear.velocity(), self.angular.velocity());
        Ok(DeviceState { time, pose, twist, buttons: 0, status: Status::OK })
    }

    fn write(&mut self, _: &Wrench) -> Result<(), DeviceError> {
        Ok(())
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}
