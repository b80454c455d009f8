//! A tool of two objects with a hinge, and the renderer that puts it into the hand.

use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_device::{DeviceState, Specification};
use palpate_dynamics::{
    ArticulatedBody, ArticulatedState, Body, BodyError, ContactParameters, Friction, GripperCoupling,
    IntegratorKind, Joint, JointError, JointLimits, PortLimits, Sampling, VirtualCoupling,
};

use super::gripper::{GripperSettings, STIFFNESS};
use super::haptic::{ArticulatedLoop, Grasped};
use crate::contact::representative::FieldError;
use crate::contact::textures::TextureError;
use crate::contact::{ContactLoop, ContactLoopError};
use crate::haptic::reactions::Reactions;
use crate::scene::Scene;
use crate::scene::editor::SceneEditor;
use crate::scene::object::Object;
use crate::scene::placement::HandlePlacement;
use crate::scene::size::{UnitsError, check_sizes};
use crate::settings::{ContactSearch, Settings, SettingsError};
use crate::tool::gains::{coupling, max_damping, port_limits, slew, usual_tolerance};

/// Two objects joined by a hinge.
///
/// The hinge's frame is given in each mesh's frame; its z axis is the hinge's axis, and at angle 0 the two frames coincide. The
/// second body turns about z by the angle, right-handed, as the gripper's angle grows.
#[derive(Clone, Debug)]
pub struct ArticulatedTool {
    /// The body that the device holds.
    pub first: Object,
    /// The body that turns against it.
    pub second: Object,
    /// The hinge's frame in the mesh frames of the first and of the second.
    pub hinge: [Pose; 2],
    /// Smallest and largest angle, rad: where the blades meet, and how wide they open.
    pub limits: [f64; 2],
    /// Masses, kg.
    pub masses: [f64; 2],
    /// Of the hinge's stops, N·m/rad.
    pub stop_stiffness: f64,
}

/// One of a tool's two bodies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToolBody {
    /// The one that the device holds.
    First,
    /// The one that turns against it.
    Second,
}

/// Why a session with a tool could not be started.
#[derive(Debug, thiserror::Error)]
pub enum ArticulatedError {
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// One of the bodies has no usable mass or inertia.
    #[error("{name}: {source}")]
    Body {
        /// The object's name.
        name: String,
        /// Why.
        source: BodyError,
    },
    /// The hinge cannot be.
    #[error(transparent)]
    Joint(#[from] JointError),
    /// Tools with a hinge have an integrator of their own.
    #[error(
        "the integrator is {integrator}; a tool with a hinge takes {} alone",
        IntegratorKind::SemiImplicit
    )]
    Integrator {
        /// The one that was asked for.
        integrator: IntegratorKind,
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
}

impl From<ContactLoopError> for ArticulatedError {
    fn from(error: ContactLoopError) -> Self {
        match error {
            ContactLoopError::Texture(error) => error.into(),
            ContactLoopError::Field(error) => error.into(),
        }
    }
}

/// A session with a tool of two bodies: [run by a host](Self::host), [on a simulated clock](Self::lockstep), or [taken
/// apart](Self::into_loops).
#[derive(Debug)]
pub struct ArticulatedRenderer {
    pub(super) haptic: ArticulatedLoop,
    /// Of the first body and of the second.
    pub(super) contacts: [ContactLoop; 2],
    /// Period of the haptic loop, s.
    pub(super) period: f64,
}

impl ArticulatedTool {
    /// The two bodies about their centres of mass, and the hinge in their axes.
    fn body(&self) -> Result<ArticulatedBody, ArticulatedError> {
        let body = |object: &Object, mass: f64| {
            Body::new(mass, object.clod.source.unit_inertia * mass)
                .map_err(|source| ArticulatedError::Body { name: object.name.clone(), source })
        };
        let [first, second] = self.centers_of_mass().map(|centre| Pose::from_translation(-centre));
        let joint = Joint {
            in_first: first * self.hinge[0],
            in_second: second * self.hinge[1],
            limits: JointLimits { low: self.limits[0], high: self.limits[1], stiffness: self.stop_stiffness },
        };
        let (first, second) = (body(&self.first, self.masses[0])?, body(&self.second, self.masses[1])?);
        Ok(ArticulatedBody::new(first, second, joint)?)
    }

    /// In the meshes' frames, m.
    fn centers_of_mass(&self) -> [DVec3; 2] {
        [&self.first, &self.second].map(|object| object.clod.source.center_of_mass)
    }
}

impl ArticulatedRenderer {
    /// Puts a tool into the hand that holds a device of that specification, where the device and its gripper (rad) now are, and
    /// `scene` around it.
    ///
    /// Of the settings, `mass` does not count, for the tool has masses of its own; the [grasp](Settings::grasp) is in the first
    /// body's mesh frame, by default at its centre of mass; the tolerance is by default 1 % of the smaller body's bounding radius, and the contact damping
    /// critical for the tool's mass. Contacts are found by levels of detail unless representatives are asked for.
    ///
    /// # Errors
    /// If a setting is out of range, a body cannot be given its mass, the hinge cannot be, another integrator than the semi-implicit
    /// one is asked for, an object's size suggests a wrong unit, or textures are too large.
    pub fn new(
        tool: &ArticulatedTool,
        scene: &Scene,
        specification: &Specification,
        device: &DeviceState,
        gripper_angle: f64,
        settings: &Settings,
        gripper: &GripperSettings,
    ) -> Result<Self, ArticulatedError> {
        settings.check()?;
        gripper.check()?;
        if settings.integrator != IntegratorKind::SemiImplicit {
            return Err(ArticulatedError::Integrator { integrator: settings.integrator });
        }
        check_sizes([&tool.first, &tool.second], scene.objects(), settings)?;
        let body = tool.body()?;
        let centers = tool.centers_of_mass();
        let objects = [&tool.first, &tool.second];
        let radius = objects.map(Object::bounding_radius).into_iter().fold(f64::INFINITY, f64::min);
        if let Some(value) = settings.tolerance.filter(|&tolerance| tolerance > radius) {
            let expected = "metres, at most the bounding radius of the smaller body";
            return Err(SettingsError { name: "tolerance", value, expected }.into());
        }
        let parameters = ContactParameters {
            stiffness: settings.contact_stiffness,
            damping: settings
                .contact_damping
                .unwrap_or(2.0 * (settings.contact_stiffness * body.mass()).sqrt()),
            tolerance: settings.tolerance.unwrap_or_else(|| usual_tolerance(settings, radius)),
            friction: Friction {
                static_coefficient: settings.static_friction.unwrap_or(settings.friction),
                dynamic_coefficient: settings.friction,
            },
        };

        let [low, high] = tool.limits;
        let asked = if gripper_angle.is_finite() { gripper_angle } else { 0.0 };
        let angle = asked.max(low).min(high);
        let grasp = settings.grasp.unwrap_or(Pose::from_translation(centers[0]));
        let period = 1.0 / settings.rate;
        let scale = settings.workspace_scale;
        let placement = HandlePlacement::at(settings, grasp.translation, specification);
        let limits = port_limits(specification, period).with_lever(placement.lever(&grasp));
        let held = hold(&body, settings, Pose::from_translation(-centers[0]) * grasp, angle, &limits);
        let port = PortLimits { rotation: gripper.port, ..limits }.in_world(scale).rotation;
        // Its rate is the difference of its angles.
        let of_gripper = Sampling { velocity_delay: 0.0, ..limits.sampling };
        let grip = GripperCoupling::auto(&body, &port, STIFFNESS, &limits.sampling);
        let grip = GripperCoupling {
            stiffness: gripper.stiffness.unwrap_or(grip.stiffness),
            max_torque: grip.max_torque,
            ..GripperCoupling::critically_damped(&body, gripper.stiffness.unwrap_or(grip.stiffness))
        };
        let grip = GripperCoupling { damping: gripper.damping.unwrap_or(grip.damping), ..grip };
        let grasped = Grasped {
            body,
            coupling: held,
            grip,
            centers,
            grasp,
            placement,
            clutch_button: settings.clutch_button,
            contact_timeout: settings.contact_timeout,
            engagement: settings.engagement,
            velocity_lags: limits.in_world(scale).velocity_lags(&held),
            gripper_lag: port.velocity_lag(grip.stiffness, grip.damping, &of_gripper),
            slew: slew(settings, &limits),
            max_damping: max_damping(settings, &held, &limits),
            period,
        };
        let pose = placement.mesh_pose(&device.pose) * Pose::from_translation(centers[0]);
        let state = ArticulatedState::at_rest(pose, angle);
        let haptic = ArticulatedLoop::new(grasped, state, device, specification, gripper, asked);
        // By the area law narrow jaws slide off sideways: what they close on is in contact beyond their edges.
        let search = match settings.search {
            ContactSearch::Automatic => ContactSearch::Levels,
            asked => asked,
        };
        let settings = Settings { search, ..*settings };
        let of = |object: &Object, body: Body, centre: DVec3| {
            ContactLoop::new(object, body, centre, scene.objects(), parameters, &settings)
        };
        let contacts = [of(&tool.first, body.first, centers[0])?, of(&tool.second, body.second, centers[1])?];
        Ok(Self { haptic, contacts, period })
    }

    /// An editor that changes the scene from elsewhere while the session runs. Each call gives another handle to the same
    /// editor.
    pub fn scene_editor(&mut self) -> SceneEditor {
        let [first, second] = &mut self.contacts;
        let editor = first.editor();
        second.follow_editor(&editor);
        editor
    }

    /// Takes what contacts of both bodies push the scene's objects with. Each call gives another handle to the same queue.
    pub fn reactions(&mut self) -> Reactions {
        self.haptic.reactions()
    }

    /// The loops, for a host that runs them itself: [`ArticulatedLoop::step`] once a period, and [`ContactLoop::step`] of each body
    /// on its [state](ArticulatedLoop::body_state) as often as it can, with [`ArticulatedLoop::update_contacts`] of what that gives.
    pub fn into_loops(self) -> (ArticulatedLoop, [ContactLoop; 2]) {
        (self.haptic, self.contacts)
    }
}

/// The coupling that the settings ask for, the rest chosen for the device and the whole tool with its hinge at an angle (rad);
/// the grasp is from the first body's centre of mass.
fn hold(
    body: &ArticulatedBody,
    settings: &Settings,
    grasp: Pose,
    angle: f64,
    limits: &PortLimits,
) -> VirtualCoupling {
    let (whole, centre) = body.composite(angle);
    let about_centre = Pose::new(grasp.translation - centre, grasp.rotation);
    VirtualCoupling { grasp, ..coupling(settings, &whole, about_centre, limits) }
}
