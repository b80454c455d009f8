//! The renderer: an object in the hand, a scene, a device, and the two loops that join them.

use palpate_core::Pose;
use palpate_device::{DeviceError, HapticDevice};
use palpate_dynamics::{Body, BodyError, ContactParameters, Friction, VirtualCoupling};

use crate::contact_loop::ContactLoop;
use crate::haptic_loop::{Grasped, HapticLoop};
use crate::object::Object;
use crate::scene::Scene;
use crate::settings::{Settings, SettingsError};

/// A haptic rendering session, to be run by [`run_lockstep`](Self::run_lockstep) or
/// [`run_realtime`](Self::run_realtime), or taken apart by a host that owns its loops.
pub struct HapticRenderer {
    pub(crate) haptic: HapticLoop,
    pub(crate) contact: ContactLoop,
    pub(crate) device: Box<dyn HapticDevice>,
    /// Period of the haptic loop, s.
    pub(crate) period: f64,
    probe: Object,
    scene: Scene,
    settings: Settings,
}

/// Why a session could not be started.
#[derive(Debug, thiserror::Error)]
pub enum RendererError {
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The grasped object has no usable mass or inertia.
    #[error("{name}: {source}")]
    Body {
        /// The object's name.
        name: String,
        /// Why.
        source: BodyError,
    },
    /// The device did not answer.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

impl HapticRenderer {
    /// Puts `probe` into the hand that holds `device`, where the device now is, and `scene` around it. The device's axes
    /// are the world's: motion is neither scaled nor turned between them.
    ///
    /// # Errors
    /// If a setting is out of range, the probe cannot be given a mass, or the device does not answer.
    pub fn new(
        probe: Object,
        scene: Scene,
        mut device: Box<dyn HapticDevice>,
        settings: Settings,
    ) -> Result<Self, RendererError> {
        settings.check()?;
        let source = &probe.clod.source;
        let body = Body::new(settings.mass, source.unit_inertia * settings.mass)
            .map_err(|source| RendererError::Body { name: probe.name.clone(), source })?;
        let specification = device.specification().clone();
        let grasp = settings.grasp.unwrap_or(Pose::from_translation(source.center_of_mass));
        let grasp_in_body = Pose::from_translation(-source.center_of_mass) * grasp;
        let coupling = coupling(&settings, &body, &specification, grasp_in_body);
        let radius = probe.bounding_radius();
        if let Some(value) = settings.tolerance.filter(|&tolerance| tolerance > radius) {
            let expected = "metres, at most the bounding radius of the grasped object";
            return Err(SettingsError { name: "tolerance", value, expected }.into());
        }
        let parameters = ContactParameters {
            stiffness: settings.contact_stiffness,
            damping: settings
                .contact_damping
                .unwrap_or(2.0 * (settings.contact_stiffness * settings.mass).sqrt()),
            tolerance: settings.tolerance.unwrap_or(0.01 * radius),
            friction: Friction {
                static_coefficient: settings.static_friction.unwrap_or(settings.friction),
                dynamic_coefficient: settings.friction,
            },
        };
        let state = device.read(0.0)?;
        let grasped = Grasped {
            body,
            coupling,
            center_of_mass: source.center_of_mass,
            grasp,
            contact_timeout: settings.contact_timeout,
            integrator: settings.integrator,
        };
        let haptic = HapticLoop::new(grasped, state, &specification);
        let contact = ContactLoop::new(&probe, source.center_of_mass, scene.objects(), parameters, &settings);
        Ok(Self { haptic, contact, device, period: 1.0 / settings.rate, probe, scene, settings })
    }

    /// The device.
    pub fn device(&self) -> &dyn HapticDevice {
        self.device.as_ref()
    }

    /// The settings given.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The grasped object.
    pub fn probe(&self) -> &Object {
        &self.probe
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The two loops and the device, for a host that runs them itself: [`HapticLoop::step_device`] once a period,
    /// [`ContactLoop::step`] on its [`body_state`](HapticLoop::body_state) as often as it can, in another thread or the
    /// same, and [`HapticLoop::update_contacts`] with what that gives. The host closes the device.
    pub fn into_loops(self) -> (HapticLoop, ContactLoop, Box<dyn HapticDevice>) {
        (self.haptic, self.contact, self.device)
    }
}

/// Stiffness of the coupling where the device sets no limit: the upper values of §5.5.1, N/m and N·m/rad.
const STIFFNESS: f64 = 500.0;
const ANGULAR_STIFFNESS: f64 = 3.0;

/// Half of what the device renders stably; `otherwise` where it sets no limit, or renders nothing along these axes.
fn default_stiffness(device: f64, otherwise: f64) -> f64 {
    if device > 0.0 && device.is_finite() { 0.5 * device } else { otherwise }
}

/// The coupling that the settings ask for, the rest chosen for the body and the device.
fn coupling(
    settings: &Settings,
    body: &Body,
    specification: &palpate_device::Specification,
    grasp: Pose,
) -> VirtualCoupling {
    let linear = settings.coupling_stiffness.unwrap_or(default_stiffness(specification.stiffness, STIFFNESS));
    let angular = settings
        .angular_stiffness
        .unwrap_or(default_stiffness(specification.angular_stiffness, ANGULAR_STIFFNESS));
    let mut coupling = VirtualCoupling::critically_damped(body, grasp, linear, angular);
    // Pressing harder than the device can render must not press the object deeper (§5.3.3). Axes that it does not
    // render at all still have to move the object.
    let limit = |peak: f64| if peak > 0.0 { peak } else { f64::INFINITY };
    coupling.max_force = limit(specification.peak_force);
    coupling.max_torque = limit(specification.peak_torque);
    if let Some(damping) = settings.coupling_damping {
        coupling.linear_damping = damping;
    }
    if let Some(damping) = settings.angular_damping {
        coupling.angular_damping = damping;
    }
    coupling
}
