//! The renderer: a tool in the hand, a scene, a device, and the loops that connect them.

use std::sync::Arc;

use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_device::{DeviceError, DeviceState, HapticDevice};
use palpate_dynamics::{ArticulatedState, Body, BodyState, Integrator, Recovery, SemiImplicit};
use palpate_texture_pd::Backend;

use crate::contact_loop::monitor::ContactMonitor;
use crate::contact_loop::{ContactLoop, ContactLoopError};
use crate::haptic::gripper::Gripper;
use crate::haptic::reactions::Reactions;
use crate::haptic::{HapticLoop, LoopSettings};
use crate::penalties::textures::TextureError;
use crate::run::settings_editor::SettingsEditor;
use crate::scene::Scene;
use crate::scene::SceneId;
use crate::scene::editor::SceneEditor;
use crate::scene::moving::DynamicBody;
use crate::scene::object::Object;
use crate::scene::size::{UnitsError, check_sizes};
use crate::search::representative::FieldError;
use crate::settings::gripper::GripperSettings;
use crate::settings::{ContactSearch, Response, SearchSettings, Settings, SettingsError};
use crate::tool::Tool;
use crate::tool::error::ToolError;
use crate::tool::gains::{Gains, Grasped, gripper_port};
use crate::tool::hinged::{Hinged, HingedTool, grip};
use crate::tool::rigid::Rigid;

/// Haptic rendering session. [`run_realtime`](Self::run_realtime) and [`run_lockstep`](Self::run_lockstep)
/// run it, and [`into_loops`](Self::into_loops) takes it apart for a host that owns its loops.
pub struct HapticRenderer<T: Tool = Rigid> {
    pub(crate) haptic: HapticLoop<T>,
    /// Contact loop of each body of the tool.
    pub(crate) contacts: Vec<ContactLoop>,
    pub(crate) device: Box<dyn HapticDevice>,
    /// Period of the haptic loop, s.
    pub(crate) period: f64,
    /// Objects of the tool.
    probes: Vec<Object>,
    grasped: Grasped,
    scene: Scene,
    settings: Settings,
    /// Settings with those that are `None` filled in.
    settings_in_force: Settings,
    settings_editor: Option<SettingsEditor>,
}

/// A session could not be started.
#[derive(Debug, thiserror::Error)]
pub enum RendererError {
    /// The tool cannot be held with the settings.
    #[error(transparent)]
    Tool(#[from] ToolError),
    /// The size of an object suggests a wrong unit.
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

impl From<SettingsError> for RendererError {
    fn from(error: SettingsError) -> Self {
        Self::Tool(error.into())
    }
}

impl From<ContactLoopError> for RendererError {
    fn from(error: ContactLoopError) -> Self {
        match error {
            ContactLoopError::Texture(error) => error.into(),
            ContactLoopError::Field(error) => error.into(),
        }
    }
}

/// Tool prepared for a session, with the parameters of its loops.
struct Prepared<T> {
    tool: T,
    /// Objects of the tool, with their masses.
    bodies: Vec<(Object, Body)>,
    grasped: Grasped,
    gains: Gains,
    gripper: Option<Gripper>,
    /// Method by which contacts are found; it may differ from the settings'.
    search: ContactSearch,
}

impl HapticRenderer {
    /// Makes a session with `probe` in the hand, at the present pose of `device`, and `scene` around it.
    ///
    /// # Errors
    /// If a setting is out of range, the probe cannot have the mass, an object's size suggests a wrong unit,
    /// textures are too large, or the device does not answer.
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
        settings.check()?;
        let source = &probe.clod.source;
        let body = Body::new(settings.tool.mass, source.unit_inertia * settings.tool.mass)
            .map_err(|source| ToolError::Body { name: probe.name.clone(), source })?;
        let center_of_mass = source.center_of_mass;
        let grasped = Grasped {
            whole: body,
            center: DVec3::ZERO,
            first_center: center_of_mass,
            radius: probe.bounding_radius(),
        };
        let gains = Gains::new(&settings, &grasped, device.specification())?;
        check_sizes([&probe], scene.objects(), &settings)?;
        let state = device.read(0.0)?;
        let pose = gains.placement.mesh_pose(&state.pose) * Pose::from_translation(center_of_mass);
        let tool = Rigid {
            body,
            coupling: gains.coupling,
            state: BodyState::at_rest(pose),
            recovery: Recovery::at_scale(settings.device.workspace_scale),
            center_of_mass,
            integrator: Arc::new(SemiImplicit),
        };
        let prepared = Prepared {
            tool,
            bodies: vec![(probe, body)],
            grasped,
            gains,
            gripper: None,
            search: settings.search.method,
        };
        Self::assemble(prepared, scene, device, state, settings)
    }

    /// Grasped object.
    pub fn probe(&self) -> &Object {
        &self.probes[0]
    }

    /// Lets the objects in the hands of two sessions touch each other. The other object becomes one of this
    /// session's scene, which moves as the other hand moves it. This session finds the contacts between both,
    /// with its own settings, and pushes the other object: what acts on one object acts on the other with the
    /// opposite sign. This object becomes one of the other session's scene, too, which waits for it. Returns
    /// the identifier of the other object in this session, and that of this object in the other one; `None`
    /// if a texture of one of them cannot be rendered.
    ///
    /// Call it before either session runs.
    pub fn join(&mut self, other: &mut Self) -> Option<(SceneId, SceneId)> {
        let HapticRenderer { haptic, contacts, probes, period, .. } = other;
        let Body { mass, inertia, .. } = haptic.tool.body;
        let body = DynamicBody {
            mass,
            inertia,
            center_of_mass: probes[0].clod.source.center_of_mass,
            gravity: DVec3::ZERO,
            period: period.max(self.period),
        };
        let pose = haptic.object_pose();
        let there = self.contacts[0].add_in_hand(&probes[0], &pose, haptic.lead(), Some(body))?;
        self.haptic.follow(there, haptic, probes[0].radius_about(DVec3::ZERO));
        self.haptic.push(there, haptic);
        let pose = self.haptic.object_pose();
        let here = contacts[0].add_in_hand(&self.probes[0], &pose, self.haptic.lead(), None)?;
        haptic.follow(here, &mut self.haptic, self.probes[0].radius_about(DVec3::ZERO));
        Some((there, here))
    }
}

impl HapticRenderer<Hinged> {
    /// Makes a session with a hinged tool in the hand, at the present pose of `device` and of its gripper,
    /// and `scene` around it.
    ///
    /// The settings apply as follows. `mass` is ignored, since the tool has its own masses. The
    /// [grasp](crate::settings::ToolSettings::grasp) is in the first body's mesh frame, by default at its
    /// centre of mass. By default the tolerance is 1 % of the smaller body's bounding radius, and the contact
    /// damping is critical for the tool's mass. Penalty contacts are found by levels of detail unless the
    /// settings require representatives.
    ///
    /// # Errors
    /// If a setting is out of range, a body cannot have its mass, the hinge is invalid, an object's size
    /// suggests a wrong unit, textures are too large, or the device has no gripper or does not answer.
    pub fn hinged(
        tool: &HingedTool,
        scene: Scene,
        mut device: Box<dyn HapticDevice>,
        settings: Settings,
        gripper: &GripperSettings,
    ) -> Result<Self, RendererError> {
        settings.check()?;
        gripper.check()?;
        check_sizes([&tool.first, &tool.second], scene.objects(), &settings)?;
        let body = tool.body()?;
        let state = device.read(0.0)?;
        let fingers = device.gripper().ok_or(ToolError::NoGripper)?;
        let (asked, port) = (fingers.read(0.0)?.angle, gripper_port(fingers.specification()));
        let port = gripper.port.unwrap_or(port);
        let angle = tool.angle_for(asked);
        let grasped = tool.grasped(&body, angle);
        let gains = Gains::new(&settings, &grasped, device.specification())?;
        let (grip, lag) = grip(&body, gripper, &port, &gains, settings.device.workspace_scale);
        let centers = tool.centers_of_mass();
        let pose = gains.placement.mesh_pose(&state.pose) * Pose::from_translation(centers[0]);
        let held = Hinged {
            body,
            coupling: gains.coupling,
            grip,
            state: ArticulatedState::at_rest(pose, angle),
            recovery: Recovery::at_scale(settings.device.workspace_scale),
            centers,
        };
        let prepared = Prepared {
            tool: held,
            bodies: vec![(tool.first.clone(), body.first), (tool.second.clone(), body.second)],
            grasped,
            gains,
            gripper: Some(Gripper::new(gripper, &port, asked, lag, 1.0 / settings.timing.rate)),
            // With the area law narrow jaws slide off sideways, since the object between them is in contact
            // beyond their edges.
            search: match (settings.search.method, settings.contact.response) {
                (ContactSearch::Automatic, Response::Penalty) => ContactSearch::Levels,
                (asked, _) => asked,
            },
        };
        Self::assemble(prepared, scene, device, state, settings)
    }

    /// Objects of the tool: the first and the second body of the [`HingedTool`].
    pub fn probes(&self) -> [&Object; 2] {
        [&self.probes[0], &self.probes[1]]
    }
}

impl<T: Tool> HapticRenderer<T> {
    /// Makes the loops of a session.
    fn assemble(
        prepared: Prepared<T>,
        scene: Scene,
        device: Box<dyn HapticDevice>,
        state: DeviceState,
        settings: Settings,
    ) -> Result<Self, RendererError> {
        let Prepared { tool, bodies, grasped, gains, gripper, search } = prepared;
        let period = 1.0 / settings.timing.rate;
        let loop_settings = LoopSettings {
            grasp: gains.grasp,
            placement: gains.placement,
            clutch_button: settings.device.clutch_button,
            contact_timeout: settings.timing.contact_timeout,
            engagement: settings.timing.engagement,
            velocity_lags: gains.velocity_lags,
            slew: gains.slew,
            max_damping: gains.max_damping,
            period,
        };
        let radii: Vec<f64> =
            bodies.iter().map(|(object, _)| object.radius_about(object.clod.source.center_of_mass)).collect();
        let specification = device.specification();
        let mut haptic = HapticLoop::new(tool, loop_settings, state, specification, gripper, &radii);
        let searching = Settings { search: SearchSettings { method: search, ..settings.search }, ..settings };
        let contacts = bodies.iter().map(|(object, body)| {
            let center = object.clod.source.center_of_mass;
            let mut contact =
                ContactLoop::new(object, *body, center, scene.objects(), gains.contacts, &searching)?;
            contact.follow_predicted(haptic.predict());
            Ok::<_, ContactLoopError>(contact)
        });
        let contacts = contacts.collect::<Result<_, _>>()?;
        haptic.hold(settings.contact.response == Response::Constraints);
        Ok(Self {
            haptic,
            contacts,
            device,
            period,
            probes: bodies.into_iter().map(|(object, _)| object).collect(),
            grasped,
            settings_in_force: gains.fill_in(&settings),
            scene,
            settings,
            settings_editor: None,
        })
    }

    /// Device of the session.
    pub fn device(&self) -> &dyn HapticDevice {
        self.device.as_ref()
    }

    /// Settings as given.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Settings at the start of the session: those given, with the ones that are `None` chosen for the tool
    /// and the device. [`TextureSettings`](crate::settings::TextureSettings) are not filled in.
    pub fn settings_in_force(&self) -> &Settings {
        &self.settings_in_force
    }

    /// [Grasp](crate::settings::ToolSettings::grasp) at which the coupling holds the tool, in the first
    /// mesh's frame.
    pub fn grasp(&self) -> &Pose {
        self.haptic.grasp()
    }

    /// Objects of the tool.
    pub(crate) fn bodies(&self) -> &[Object] {
        &self.probes
    }

    /// Scene at the start of the session.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Makes a monitor of the contacts of each body, for another thread while the session runs. There may be
    /// several.
    pub fn contact_monitor(&mut self) -> T::PerBody<ContactMonitor> {
        let Self { contacts, haptic, .. } = self;
        per_body::<T, _>(contacts.iter_mut().enumerate().map(|(body, contact)| {
            contact.contact_monitor().with_constraints(haptic.constraint_monitor(body))
        }))
    }

    /// Editor that changes the scene from other threads while the session runs. Each call returns another
    /// handle to the same editor.
    pub fn scene_editor(&mut self) -> SceneEditor {
        let (first, others) = self.contacts.split_at_mut(1);
        let editor = first[0].editor();
        editor.set_clock(self.haptic.clock());
        others.iter_mut().for_each(|other| other.follow_editor(&editor));
        editor
    }

    /// Editor that changes settings from other threads while the session runs. Each call returns another
    /// handle to the same editor.
    pub fn settings_editor(&mut self) -> SettingsEditor {
        if let Some(editor) = &self.settings_editor {
            return editor.clone();
        }
        let (scene, specification) = (self.scene_editor(), self.device.specification().clone());
        let by_fields = self.contacts.iter().any(ContactLoop::is_by_fields);
        let editor = SettingsEditor::new(self.settings, self.grasped, specification, scene, by_fields);
        self.haptic.set_tunings(editor.add_haptic_loop());
        self.contacts.iter_mut().for_each(|contact| contact.set_tunings(editor.add_contact_loop()));
        self.settings_editor.insert(editor).clone()
    }

    /// The editor of settings, if there is one.
    pub(crate) fn editor_of_settings(&self) -> Option<&SettingsEditor> {
        self.settings_editor.as_ref()
    }

    /// Queue of contact reactions on scene objects, for other threads while the session runs. Each call
    /// returns another handle to the same queue.
    pub fn reactions(&mut self) -> Reactions {
        self.haptic.reactions()
    }

    /// Takes the session apart into its loops and the device, for a host that runs them itself:
    /// [`HapticLoop::step_device`] once per period, [`ContactLoop::step`] on the state of each body as often
    /// as possible, in the same thread or another one, and `update_contacts` with its result. The host closes
    /// the device.
    pub fn into_loops(self) -> (HapticLoop<T>, T::PerBody<ContactLoop>, Box<dyn HapticDevice>) {
        (self.haptic, per_body::<T, _>(self.contacts.into_iter()), self.device)
    }
}

impl HapticRenderer {
    /// Sets the method that integrates the motion of the grasped object, to compare it with the semi-implicit
    /// step. With another one all contacts are penalty contacts. Explicit methods are unstable with a light
    /// object.
    pub fn set_integrator(&mut self, integrator: Arc<dyn Integrator>) {
        if integrator.name() != SemiImplicit.name() {
            self.contacts.iter_mut().for_each(ContactLoop::use_penalties);
            self.haptic.hold(false);
        }
        self.haptic.tool.integrator = integrator;
    }

    /// Sets a backend that computes textured contacts, such as one on the host's own GPU device
    /// (`WgpuBackend::with_device` with the feature `gpu`). In a scene without textures it has no effect. If
    /// the backend fails, the processor takes over.
    pub fn set_texture_backend(&mut self, backend: Box<dyn Backend>) {
        self.contacts[0].set_texture_backend(backend);
    }
}

/// Collects one value for each body of a tool.
#[expect(clippy::expect_used, reason = "a session has a contact loop for each body")]
pub(crate) fn per_body<T: Tool, X>(values: impl Iterator<Item = X>) -> T::PerBody<X> {
    T::per_body(values).expect("a value for each body")
}
