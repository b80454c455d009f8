//! Builder of sessions, with defaults for what is not given.

use palpate_core::Pose;
use palpate_device::{DeviceState, HapticDevice, Specification};

use crate::run::hosted::{HostError, HostedSession};
use crate::run::renderer::{HapticRenderer, RendererError};
use crate::scene::Scene;
use crate::scene::object::Object;
use crate::settings::Settings;

/// Builder of a session, made by [`HapticRenderer::builder`]. The device comes last, and makes the session.
///
/// ```
/// use palpate::device::{Emulation, Task};
/// use palpate::{HapticRenderer, Object, Pose, Scene, explore};
///
/// let probe = Object::model("ellipsoid@500")?;
/// let ball = Object::model("golf-ball@2000")?;
/// let scene = Scene::new().with(ball, Pose::IDENTITY);
/// let device = Emulation::default().open(explore::path(Task::default(), &probe, &scene)?)?;
/// let mut session = HapticRenderer::builder(probe)
///     .scene(scene)
///     .tune(|settings| settings.contact.friction = 0.3)
///     .on(Box::new(device))?
///     .spawn()?;
/// while session.latest().is_none() {
///     std::thread::yield_now();
/// }
/// println!("{}", session.stop()?.summary().depth_max);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
#[must_use = "`on` or `hosted` makes the session"]
pub struct RendererBuilder {
    probe: Object,
    scene: Scene,
    settings: Settings,
}

impl HapticRenderer {
    /// Begins a session with `probe` in the hand, an empty scene and default settings.
    pub fn builder(probe: Object) -> RendererBuilder {
        RendererBuilder { probe, scene: Scene::new(), settings: Settings::default() }
    }
}

impl RendererBuilder {
    /// Sets the scene.
    pub fn scene(self, scene: Scene) -> Self {
        Self { scene, ..self }
    }

    /// Adds an object to the scene, its mesh's frame at `pose`.
    pub fn touching(self, object: Object, pose: Pose) -> Self {
        Self { scene: self.scene.with(object, pose), ..self }
    }

    /// Sets the settings.
    pub fn settings(self, settings: Settings) -> Self {
        Self { settings, ..self }
    }

    /// Changes some settings.
    pub fn tune(mut self, change: impl FnOnce(&mut Settings)) -> Self {
        change(&mut self.settings);
        self
    }

    /// Makes the session with a device. The probe starts where the device is now.
    ///
    /// # Errors
    /// As [`HapticRenderer::new`].
    pub fn on(self, device: Box<dyn HapticDevice>) -> Result<HapticRenderer, RendererError> {
        HapticRenderer::new(self.probe, self.scene, device, self.settings)
    }

    /// Makes the session for a host that owns its device and steps the session itself, with the device's
    /// specification and state.
    ///
    /// # Errors
    /// As [`HostedSession::new`].
    pub fn hosted(
        self,
        specification: Specification,
        device: DeviceState,
    ) -> Result<HostedSession, HostError> {
        HostedSession::new(self.probe, self.scene, specification, device, self.settings)
    }
}
