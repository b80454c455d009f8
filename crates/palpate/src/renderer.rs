//! The renderer: an object in the hand, a scene, a device, and the two loops that join them.

use palpate_core::Pose;
use palpate_device::{DeviceError, HapticDevice, Specification};
use palpate_dynamics::{
    Body, BodyError, ContactParameters, DeviceMapping, Friction, PortAxes, PortLimits, SlewLimit,
    VirtualCoupling,
};

use palpate_texture_pd::Backend;

use crate::contact_loop::ContactLoop;
use crate::haptic_loop::{Grasped, HapticLoop};
use crate::object::Object;
use crate::scene::Scene;
use crate::scene_editor::SceneEditor;
use crate::settings::{Settings, SettingsError};
use crate::textures::TextureError;
use crate::watch::Watch;

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
    /// Textures cannot be rendered.
    #[error(transparent)]
    Texture(#[from] TextureError),
    /// The device did not answer.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

impl HapticRenderer {
    /// Puts `probe` into the hand that holds `device`, where the device now is, and `scene` around it.
    ///
    /// # Errors
    /// If a setting is out of range, the probe cannot be given a mass, textures are too large, or the device does not answer.
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
        let limits = port_limits(&specification, 1.0 / settings.rate);
        let coupling = coupling(&settings, &body, grasp_in_body, &limits);
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
            mapping: DeviceMapping::new(settings.workspace_scale, settings.device_frame),
            clutch_button: settings.clutch_button,
            contact_timeout: settings.contact_timeout,
            integrator: settings.integrator,
            engagement: settings.engagement,
            velocity_lags: limits.in_world(settings.workspace_scale).velocity_lags(&coupling),
            slew: slew(&settings, &limits),
            max_damping: max_damping(&settings, &coupling, &limits),
            period: limits.period,
        };
        let haptic = HapticLoop::new(grasped, state, &specification);
        let contact =
            ContactLoop::new(&probe, body, source.center_of_mass, scene.objects(), parameters, &settings)?;
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

    /// Lets the contacts be watched from elsewhere while the session runs; an earlier watcher sees nothing new then.
    pub fn watch(&mut self) -> Watch {
        self.contact.watch()
    }

    /// Lets the scene be changed from elsewhere while the session runs; an earlier editor changes nothing any more.
    pub fn scene_editor(&mut self) -> SceneEditor {
        self.contact.editor()
    }

    /// Lets a backend of the host compute textured contacts, as one on its own GPU device
    /// ([`WgpuBackend::with_device`](palpate_texture_pd::WgpuBackend::with_device)); nothing changes in a scene without
    /// textures. Should it fail, the processor goes on.
    pub fn set_texture_backend(&mut self, backend: Box<dyn Backend>) {
        self.contact.set_texture_backend(backend);
    }

    /// The two loops and the device, for a host that runs them itself: [`HapticLoop::step_device`] once a period,
    /// [`ContactLoop::step`] on its [`body_state`](HapticLoop::body_state) as often as it can, in another thread or the
    /// same, and [`HapticLoop::update_contacts`] with what that gives. The host closes the device.
    pub fn into_loops(self) -> (HapticLoop, ContactLoop, Box<dyn HapticDevice>) {
        (self.haptic, self.contact, self.device)
    }
}

/// What the device's specification says of its port, sampled every `period` seconds.
pub(crate) fn port_limits(specification: &Specification, period: f64) -> PortLimits {
    let handle = specification.handle.as_ref();
    // Nothing reaches the hand along or about axes that are not driven.
    let driven = |axes: [bool; 3], peak: f64| if axes.contains(&true) { peak } else { 0.0 };
    PortLimits {
        translation: PortAxes {
            stiffness: specification.stiffness,
            damping: specification.damping,
            viscous: handle.map(|handle| handle.damping),
            friction: handle.map(|handle| handle.friction),
            peak: driven(specification.actuated.translation, specification.peak_force),
            step: specification.encoder_step,
        },
        rotation: PortAxes {
            stiffness: specification.angular_stiffness,
            damping: specification.angular_damping,
            viscous: handle.map(|handle| handle.angular_damping),
            friction: handle.map(|handle| handle.angular_friction),
            peak: driven(specification.actuated.rotation, specification.peak_torque),
            step: specification.angular_encoder_step,
        },
        velocity_delay: specification.velocity_delay,
        period,
    }
}

/// The coupling that the settings ask for, the rest chosen for the body and the device.
pub(crate) fn coupling(
    settings: &Settings,
    body: &Body,
    grasp: Pose,
    limits: &PortLimits,
) -> VirtualCoupling {
    let limits = limits.in_world(settings.workspace_scale);
    let chosen = VirtualCoupling::auto(body, grasp, &limits);
    let linear = settings.coupling_stiffness.unwrap_or(chosen.linear_stiffness);
    let angular = settings.angular_stiffness.unwrap_or(chosen.angular_stiffness);
    let mut coupling = VirtualCoupling::critically_damped(body, grasp, linear, angular).limited_to(&limits);
    coupling.linear_damping = settings.coupling_damping.unwrap_or(coupling.linear_damping);
    coupling.angular_damping = settings.angular_damping.unwrap_or(coupling.angular_damping);
    coupling
}

/// Time in which the wrench may rise from zero to the device's peak, s.
pub(crate) const SLEW_TIME: f64 = 0.01;

/// How fast the wrench at the device may change.
pub(crate) fn slew(settings: &Settings, limits: &PortLimits) -> SlewLimit {
    SlewLimit {
        force: settings.force_slew.unwrap_or(limits.translation.peak / SLEW_TIME),
        torque: settings.torque_slew.unwrap_or(limits.rotation.peak / SLEW_TIME),
    }
}

/// The most damping (N·s/m, N·m·s/rad) that the passivity controller may put at the device: what is passive there beside
/// the coupling's springs; none where it is off.
pub(crate) fn max_damping(
    settings: &Settings,
    coupling: &VirtualCoupling,
    limits: &PortLimits,
) -> (f64, f64) {
    if !settings.passivity_controller {
        return (0.0, 0.0);
    }
    let scale = settings.workspace_scale;
    let (lag, angular_lag) = limits.in_world(scale).velocity_lags(coupling);
    let largest = |axes: &PortAxes, stiffness: f64, lag: f64| {
        axes.largest_damping(stiffness, lag.max(limits.velocity_delay), limits.velocity_delay, limits.period)
    };
    (
        largest(&limits.translation, coupling.linear_stiffness, lag),
        largest(&limits.rotation, coupling.angular_stiffness / (scale * scale), angular_lag),
    )
}
