//! The renderer: an object in the hand, a scene, a device, and the two loops that join them.

use palpate_core::Pose;
use palpate_device::{DeviceError, HapticDevice};
use palpate_dynamics::{Body, BodyError};
use palpate_texture_pd::Backend;

use crate::contact::monitor::Watch;
use crate::contact::representative::FieldError;
use crate::contact::textures::TextureError;
use crate::contact::{ContactLoop, ContactLoopError};
use crate::haptic::reactions::Reactions;
use crate::haptic::{Grasped, HapticLoop};
use crate::run::settings_editor::SettingsEditor;
use crate::scene::Scene;
use crate::scene::editor::{SceneEditor, SceneId};
use crate::scene::moving::Mobility;
use crate::scene::object::Object;
use crate::scene::size::{UnitsError, check_sizes};
use crate::settings::{Settings, SettingsError};
use crate::tool::gains::Gains;

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
    /// The same with what they leave open filled in.
    settings_in_force: Settings,
    settings_editor: Option<SettingsEditor>,
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
    /// An object's size suggests a wrong unit.
    #[error(transparent)]
    Units(#[from] UnitsError),
    /// Textures cannot be rendered.
    #[error(transparent)]
    Texture(#[from] TextureError),
    /// Representative contacts cannot be found.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// The device did not answer.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

impl From<ContactLoopError> for RendererError {
    fn from(error: ContactLoopError) -> Self {
        match error {
            ContactLoopError::Texture(error) => error.into(),
            ContactLoopError::Field(error) => error.into(),
        }
    }
}

impl HapticRenderer {
    /// Puts `probe` into the hand that holds `device`, where the device now is, and `scene` around it.
    ///
    /// # Errors
    /// If a setting is out of range, the probe cannot be given a mass, an object's size suggests a wrong unit, textures are too
    /// large, or the device does not answer.
    #[cfg_attr(
        feature = "tracing",
        tracing::instrument(skip_all, fields(probe = probe.name, objects = scene.objects().len()), err)
    )]
    pub fn new(
        probe: Object,
        scene: Scene,
        mut device: Box<dyn HapticDevice>,
        settings: Settings,
    ) -> Result<Self, RendererError> {
        let gains = Gains::new(&settings, &probe, device.specification())?;
        check_sizes([&probe], scene.objects(), &settings)?;
        let state = device.read(0.0)?;
        let settings_in_force = gains.fill_in(&settings);
        let source = &probe.clod.source;
        let grasped = Grasped {
            body: gains.body,
            coupling: gains.coupling,
            center_of_mass: source.center_of_mass,
            radius: probe.bounding_radius() + source.center_of_mass.distance(source.center),
            grasp: gains.grasp,
            placement: gains.placement,
            clutch_button: settings.clutch_button,
            contact_timeout: settings.contact_timeout,
            integrator: settings.integrator,
            engagement: settings.engagement,
            velocity_lags: gains.velocity_lags,
            slew: gains.slew,
            max_damping: gains.max_damping,
            period: 1.0 / settings.rate,
        };
        let haptic = HapticLoop::new(grasped, state, device.specification());
        let contact = ContactLoop::new(
            &probe,
            gains.body,
            source.center_of_mass,
            scene.objects(),
            gains.contacts,
            &settings,
        )?;
        Ok(Self {
            haptic,
            contact,
            device,
            period: 1.0 / settings.rate,
            probe,
            scene,
            settings,
            settings_in_force,
            settings_editor: None,
        })
    }

    /// The device.
    pub fn device(&self) -> &dyn HapticDevice {
        self.device.as_ref()
    }

    /// The settings given.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The settings that the session begins with: those given, and what they leave open as it was chosen for the grasped
    /// object and the device. How textured contacts are sampled stays open.
    pub fn settings_in_force(&self) -> &Settings {
        &self.settings_in_force
    }

    /// The [grasp](Settings::grasp) that the coupling holds the object at, in the mesh's frame.
    pub fn grasp(&self) -> &Pose {
        self.haptic.grasp()
    }

    /// The grasped object.
    pub fn probe(&self) -> &Object {
        &self.probe
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// A watch that shows the contacts elsewhere while the session runs. There may be several.
    pub fn watch(&mut self) -> Watch {
        self.contact.watch()
    }

    /// An editor that changes the scene from elsewhere while the session runs. Each call gives another handle to the same
    /// editor.
    pub fn scene_editor(&mut self) -> SceneEditor {
        self.contact.editor()
    }

    /// An editor that changes settings from elsewhere while the session runs. Each call gives another handle to the same
    /// editor.
    pub fn settings_editor(&mut self) -> SettingsEditor {
        if let Some(editor) = &self.settings_editor {
            return editor.clone();
        }
        let specification = self.device.specification().clone();
        let by_fields = self.contact.is_by_fields();
        let (editor, haptic, contact) =
            SettingsEditor::new(self.settings, self.probe.clone(), specification, by_fields);
        self.haptic.set_tunings(haptic);
        self.contact.set_tunings(contact);
        self.settings_editor.insert(editor).clone()
    }

    /// Takes what contacts push the scene's objects with, elsewhere while the session runs. Each call gives another handle to
    /// the same queue.
    pub fn reactions(&mut self) -> Reactions {
        self.haptic.reactions()
    }

    /// Lets the objects in the hands of two sessions touch each other: each becomes an object of the other's scene, that moves
    /// as the other hand moves it. Both sessions then render the contact, each with its own settings. The numbers that they have
    /// there, the other's in this one's first; none if one of them is textured and that cannot be rendered.
    ///
    /// To be called before either session runs.
    pub fn join(&mut self, other: &mut Self) -> Option<(SceneId, SceneId)> {
        let there = follow(self, other)?;
        let here = follow(other, self)?;
        Some((there, here))
    }

    /// Lets a backend of the host compute textured contacts, as one on its own GPU device
    /// (`WgpuBackend::with_device` with the feature `gpu`); nothing changes in a scene without
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

/// Puts the object of one session, as it moves, into the scene of another.
fn follow(session: &mut HapticRenderer, leader: &mut HapticRenderer) -> Option<SceneId> {
    let HapticRenderer { haptic, probe, period, .. } = leader;
    let Body { mass, inertia, .. } = haptic.body;
    let mobility = Mobility {
        mass,
        inertia,
        center_of_mass: probe.clod.source.center_of_mass,
        period: period.max(session.period),
    };
    let (pose, _) = haptic.motion();
    session.contact.add_following(probe, &pose, haptic.lead(), mobility)
}
