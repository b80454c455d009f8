//! The physical settings of a session, in SI units.

pub(crate) mod gripper;
pub(crate) mod live;
pub(crate) mod response;

use std::ops::RangeInclusive;

pub use self::gripper::GripperSettings;
pub use self::response::Response;
use palpate_core::Pose;
use palpate_dynamics::MAX_CLUSTERS;
use serde::{Deserialize, Serialize};

/// Shortest time in which the wrench rises from zero to the device's peak by default, s. A shorter one lets
/// contacts kick the hand harder; a longer one delays the force of stiff contacts.
pub(crate) const SLEW_TIME: f64 = 0.01;

/// Settings of a session. Values that are left out of a file are the defaults; those that are `None` are
/// derived from the grasped object and the device.
///
/// Contact, coupling, detail and output are [`LiveSettings`]: they may change while the session runs. The
/// rest is fixed when the session is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Stiffness, damping and friction of contacts.
    pub contact: ContactSettings,
    /// Gains of the virtual coupling.
    pub coupling: CouplingSettings,
    /// Geometric detail that contacts leave out.
    pub detail: DetailSettings,
    /// Limits on changes of the wrench at the device.
    pub output: OutputSettings,
    /// Search for contacts.
    pub search: SearchSettings,
    /// The grasped object.
    pub tool: ToolSettings,
    /// The device's workspace.
    pub device: DeviceSettings,
    /// Rates and times.
    pub timing: TimingSettings,
    /// Sampling of contacts with textured objects.
    pub textures: TextureSettings,
}

/// The settings that may change while a session runs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LiveSettings {
    /// Stiffness, damping and friction of contacts.
    pub contact: ContactSettings,
    /// Gains of the virtual coupling.
    pub coupling: CouplingSettings,
    /// Geometric detail that contacts leave out.
    pub detail: DetailSettings,
    /// Limits on changes of the wrench at the device.
    pub output: OutputSettings,
}

/// Stiffness, damping and friction of contacts. May change while a session runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactSettings {
    /// How contacts act on the grasped object.
    pub response: Response,
    /// Stiffness k of each contact cluster, N/m.
    pub stiffness: f64,
    /// Damping b of each contact cluster, N·s/m; by default critical for the grasped mass on one cluster.
    pub damping: Option<f64>,
    /// Coulomb coefficient of friction μ of sliding contacts, 0 by default.
    pub friction: f64,
    /// Coulomb coefficient of friction of contacts at rest, which slide when they exceed it; by default that
    /// of sliding contacts.
    pub static_friction: Option<f64>,
}

impl ContactSettings {
    /// Penalty contacts of a stiffness, N/m.
    pub fn penalties(stiffness: f64) -> Self {
        Self { response: Response::Penalty, stiffness, ..Self::default() }
    }
}

impl Default for ContactSettings {
    fn default() -> Self {
        Self {
            response: Response::default(),
            stiffness: 2000.0,
            damping: None,
            friction: 0.0,
            static_friction: None,
        }
    }
}

/// Gains of the virtual coupling between device and object. May change while a session runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CouplingSettings {
    /// Stiffness k_c of the virtual coupling, N/m. By default the stiffness that the device renders
    /// passively with a margin, at most half of the maximum stable stiffness that its maker states
    /// ([`VirtualCoupling::auto`](palpate_dynamics::VirtualCoupling::auto)); 500 N/m where the device sets
    /// no limit.
    pub stiffness: Option<f64>,
    /// Damping b_c of the virtual coupling, N·s/m; by default critical, and less for heavy objects, whose
    /// damper would lag by more than 10 ms
    /// ([`VirtualCoupling::damped_within`](palpate_dynamics::VirtualCoupling::damped_within)).
    pub damping: Option<f64>,
    /// Angular stiffness k_θ of the virtual coupling in the world, N·m/rad; by default chosen as the
    /// stiffness is, 3 N·m/rad where the device sets no limit or renders no torque.
    pub angular_stiffness: Option<f64>,
    /// Angular damping b_θ of the virtual coupling, N·m·s/rad; by default critical for the largest principal
    /// moment of inertia about the grasp, and less for heavy objects. Both dampers act on a velocity of the
    /// device that lags as much as passivity requires, and by up to 20 ms for heavy objects.
    pub angular_damping: Option<f64>,
}

/// Geometric detail that contacts leave out, where they are found by levels of detail. May change while a
/// session runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DetailSettings {
    /// Error threshold s₀, m: contacts leave out detail whose deviation, averaged over the area of contact,
    /// is at most this (§3.4.3). 0, the default, for full resolution.
    pub error: f64,
    /// Whether forces blend smoothly from one level of detail to the next, where detail is left out
    /// (§3.4.4). Without blending, forces jump where the level changes, and a query takes a little less
    /// time.
    pub interpolation: bool,
    /// Time limit of a contact query, s. The query refines the most important detail first, and leaves out
    /// detail that does not fit in (§3.4.3). With a limit, sessions on a simulated clock are not
    /// reproducible. No limit by default.
    pub query_budget: Option<f64>,
}

impl Default for DetailSettings {
    fn default() -> Self {
        Self { error: 0.0, interpolation: true, query_budget: None }
    }
}

/// Limits on changes of the wrench at the device. May change while a session runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutputSettings {
    /// Largest rate of change of the force at the device, N/s; by default the peak force in 10 ms.
    pub force_slew: Option<f64>,
    /// Largest rate of change of the torque at the device, N·m/s; by default the peak torque in 10 ms.
    pub torque_slew: Option<f64>,
    /// Whether the session damps the device when more energy has come out of the session than went in
    /// ([`PassivityController`](palpate_dynamics::PassivityController)).
    pub passivity_controller: bool,
}

/// Search for contacts. Fixed when a session is made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SearchSettings {
    /// Search method; by default representative contacts where these are valid, else levels of detail.
    pub method: ContactSearch,
    /// Distance tolerance d of the contact query, m, at most the grasped object's bounding radius; by
    /// default 1 % of that radius, and at most 2 mm at the device.
    pub tolerance: Option<f64>,
    /// Largest depth error EPS of representative contacts, approximately, m: 0.02 % to 1 % of the grasped
    /// object's bounding radius; by default 0.05 %, and at most a twentieth of the tolerance d.
    pub representative_error: Option<f64>,
    /// Largest number K of contact clusters (§5.4.2). Representative contacts, found in distance fields,
    /// push with a total stiffness of K k wherever bodies touch, as K clusters of contacts by levels of
    /// detail do.
    pub clusters: usize,
    /// Whether to brake the grasped object before it touches a surface that it approaches fast, so that it
    /// is not inside or behind the surface when a contact query finds it (§5.6.1).
    pub braking: bool,
    /// Whether to keep a proxy of the grasped object on the side of surfaces that it came from. Contacts
    /// push the object back to the proxy, so that it cannot be pressed or driven through a surface
    /// (§5.6.1).
    pub proxy: bool,
}

impl Default for SearchSettings {
    fn default() -> Self {
        Self {
            method: ContactSearch::default(),
            tolerance: None,
            representative_error: None,
            clusters: 5,
            braking: true,
            proxy: true,
        }
    }
}

/// Mass and grasp of the grasped object. Fixed when a session is made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ToolSettings {
    /// Mass of the grasped object, kg.
    pub mass: f64,
    /// Frame, fixed to the grasped object and given in its mesh's frame, that the virtual coupling acts on;
    /// by default at the centre of mass.
    ///
    /// The device's [handle](ToolSettings::handle) is there too by default: to hold a tool by its handle,
    /// set the grasp to the handle's position in the mesh. Only the grasp's position matters, since the
    /// coupling is equally stiff in all directions.
    pub grasp: Option<Pose>,
    /// Place of the device's handle on the grasped object. It does not place the object: while the handle is
    /// in the middle of its workspace, not rotated, and the coupling is not stretched, the mesh's frame is
    /// at the [device frame](DeviceSettings::frame).
    pub handle: HandlePlace,
    /// Whether to render objects whose size suggests a [wrong unit](crate::errors::UnitsError). A session
    /// with such objects is refused otherwise.
    pub unusual_size: bool,
}

impl Default for ToolSettings {
    fn default() -> Self {
        Self { mass: 0.1, grasp: None, handle: HandlePlace::default(), unusual_size: false }
    }
}

/// The device's workspace in the world. Fixed when a session is made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DeviceSettings {
    /// Length in the world per length at the device. Forces at the device are those of the world divided by
    /// the scale, torques those divided by its square ([`DeviceMapping`](palpate_dynamics::DeviceMapping),
    /// §5.3.3).
    pub workspace_scale: f64,
    /// The device's axes in the world, and the pose of the mesh's frame while the handle is in the middle of
    /// its workspace.
    pub frame: Pose,
    /// Index of the device button, from 0, that is the clutch: while it is held the device moves without the
    /// object.
    pub clutch_button: Option<u32>,
}

impl Default for DeviceSettings {
    fn default() -> Self {
        Self { workspace_scale: 1.0, frame: Pose::IDENTITY, clutch_button: None }
    }
}

/// Rates and times of the loops. Fixed when a session is made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TimingSettings {
    /// Rate of the haptic loop, Hz.
    pub rate: f64,
    /// Age of the newest contact model at which the wrench begins to fade out, s. It is zero 50 ms later, or
    /// at twice this age where that is sooner, and fades in over the same time. Constraints of surfaces that
    /// all stand still hold for 0.5 s if that is longer: the object does not leave the region that they
    /// cover. With penalty contacts, it also fades when the object has moved, from where these were found, by
    /// more than half its bounding radius and by more than 1 cm at the device.
    pub contact_timeout: f64,
    /// Time over which the wrench rises from zero, s: after the start, wherever the object then is, and
    /// after a failure of the device or of a step. With the clutch, it falls and rises over the same
    /// time.
    pub engagement: f64,
}

impl Default for TimingSettings {
    fn default() -> Self {
        Self { rate: 1000.0, contact_timeout: 0.05, engagement: 0.2 }
    }
}

/// Method by which a session finds contacts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ContactSearch {
    /// [Representatives](Self::Representatives) where these are valid, else [levels](Self::Levels). The
    /// session uses levels if
    ///
    /// - contacts are [constraints](Response::Constraints), which are found on the meshes: then only the
    ///   penalty contacts with light objects that they push are found by levels,
    /// - detail is to be left out ([`DetailSettings::error`]),
    /// - an object has a haptic texture, an open surface, walls thinner than the tolerance d, or a field
    ///   whose error is more than a quarter of d,
    /// - or the tool [has a hinge](crate::tool::Hinged).
    ///
    /// It is decided when the session is made; the stage `contact search` of its summary gives the
    /// decision and its reason. If such an object is added later, the session changes to levels and stays
    /// with them.
    #[default]
    Automatic,
    /// Contacts of convex patches, found by the hierarchies at full resolution or with detail left out.
    Levels,
    /// A few contacts at exact geometry, each with the area that it represents, found in distance fields. If
    /// an object has an open surface or a haptic texture, levels are used all the same.
    Representatives,
}

/// Place of the device's handle on the grasped object: the point that rotations of the handle leave in place,
/// and the reference point of the torque at the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum HandlePlace {
    /// The [grasp](Self::Grasp); the [mesh's origin](Self::MeshOrigin) with a device that renders nothing,
    /// such as one that replays a motion of the mesh's frame.
    #[default]
    Automatic,
    /// The [grasp](ToolSettings::grasp), however far the mesh's origin is from it. The coupling then has no
    /// lever at the device.
    Grasp,
    /// The mesh's origin: the device's pose is that of the mesh's frame. The coupling then acts on the handle
    /// through a lever as long as the distance from the origin to the grasp, and is softer because of it.
    MeshOrigin,
}

/// Sampling of contacts with textured objects (§4.4).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TextureSettings {
    /// Number of texels along a side of a contact's grid.
    pub grid: u32,
    /// Half the side of a contact's grid, m: detail further from the contact along its plane is not felt. By
    /// default such that the grid's texels are as large as the smallest texels of the textures, but at most
    /// the grasped object's bounding radius.
    pub half_size: Option<f64>,
    /// Temperature τ of the smooth maximum over the overlaps in a grid, m: overlaps within a few τ of the
    /// largest share the force, so that it moves smoothly from one peak to another; 0 for the largest alone.
    /// By default half the tolerance d.
    pub temperature: Option<f64>,
    /// Processor or GPU that computes textured contacts.
    pub backend: TextureBackend,
}

/// Processor or GPU that computes textured contacts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum TextureBackend {
    /// The processor. Sessions on a simulated clock are reproducible.
    #[default]
    Processor,
    /// The processor or the fastest GPU, whichever is faster when the session is made; the processor where
    /// there is no GPU.
    Auto,
    /// The fastest GPU, or a software driver in place of one, in f32. A session without either is refused.
    Gpu,
}

impl Default for TextureSettings {
    /// A grid of 50 × 50 texels (§4.5.2), computed by the processor.
    fn default() -> Self {
        Self { grid: 50, half_size: None, temperature: None, backend: TextureBackend::default() }
    }
}

/// A setting that was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{name} is {value}; give {expected}")]
pub struct SettingsError {
    /// Name of the setting.
    pub name: &'static str,
    /// Value given.
    pub value: f64,
    /// Values that are accepted.
    pub expected: &'static str,
}

/// A setting that is given and that nothing in a session uses
/// ([`HapticRenderer::unused_settings`](crate::HapticRenderer::unused_settings)).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, thiserror::Error)]
#[error("{name}: {why}")]
pub struct UnusedSetting {
    /// Path of the setting, as in a scene file.
    pub name: &'static str,
    /// Reason why it has no effect.
    pub why: &'static str,
}

impl Settings {
    /// The settings that may change while a session runs.
    pub fn live(&self) -> LiveSettings {
        let Self { contact, coupling, detail, output, .. } = *self;
        LiveSettings { contact, coupling, detail, output }
    }

    /// These settings with other values of those that may change while a session runs.
    #[must_use]
    pub fn with_live(self, live: &LiveSettings) -> Self {
        let LiveSettings { contact, coupling, detail, output } = *live;
        Self { contact, coupling, detail, output, ..self }
    }

    /// Refuses values that no physical object or device can have.
    ///
    /// # Errors
    /// If a setting is out of range: names the first one.
    pub fn check(&self) -> Result<(), SettingsError> {
        let SearchSettings { tolerance, representative_error, clusters, .. } = self.search;
        check_ranges([
            ("mass", Some(self.tool.mass), "kilograms from 1e-5 to 1e4", 1e-5..=1e4),
            ("rate", Some(self.timing.rate), "a rate from 10 to 20000 Hz", 10.0..=20_000.0),
            ("contact-stiffness", Some(self.contact.stiffness), "N/m from 0 to 1e8", 0.0..=1e8),
            ("contact-damping", self.contact.damping, "N·s/m from 0 to 1e6", 0.0..=1e6),
            ("friction", Some(self.contact.friction), "a coefficient from 0 to 100", 0.0..=100.0),
            ("static-friction", self.contact.static_friction, "a coefficient from 0 to 100", 0.0..=100.0),
            ("coupling-stiffness", self.coupling.stiffness, "N/m from 0 to 1e7", 0.0..=1e7),
            ("coupling-damping", self.coupling.damping, "N·s/m from 0 to 1e6", 0.0..=1e6),
            ("angular-stiffness", self.coupling.angular_stiffness, "N·m/rad from 0 to 1e6", 0.0..=1e6),
            ("angular-damping", self.coupling.angular_damping, "N·m·s/rad from 0 to 1e6", 0.0..=1e6),
            ("tolerance", tolerance, "metres above 0", ABOVE_ZERO),
            ("error", Some(self.detail.error), "metres, 0 or more", 0.0..=f64::MAX),
            ("representative error", representative_error, "metres above 0", ABOVE_ZERO),
            ("query budget", self.detail.query_budget, "seconds from 1e-6 to 10", 1e-6..=10.0),
            ("contact-timeout", Some(self.timing.contact_timeout), "seconds above 0", ABOVE_ZERO),
            ("engagement", Some(self.timing.engagement), "seconds from 0 to 10", 0.0..=10.0),
            ("workspace-scale", Some(self.device.workspace_scale), "a factor from 1e-4 to 1e4", 1e-4..=1e4),
            ("force-slew", self.output.force_slew, "N/s above 0", ABOVE_ZERO_OR_UNLIMITED),
            ("torque-slew", self.output.torque_slew, "N·m/s above 0", ABOVE_ZERO_OR_UNLIMITED),
            ("texture grid", Some(self.textures.grid.into()), "2 to 1024 texels", 2.0..=1024.0),
            ("texture half-size", self.textures.half_size, "metres above 0", ABOVE_ZERO),
            ("texture temperature", self.textures.temperature, "metres, 0 or more", 0.0..=f64::MAX),
            ("clutch-button", self.device.clutch_button.map(f64::from), "a button from 0 to 31", 0.0..=31.0),
            ("clusters", Some(clusters as f64), CLUSTER_RANGE, 1.0..=MAX_CLUSTERS as f64),
        ])?;
        let poses = [
            ("grasp rotation's length", self.tool.grasp),
            ("device-frame rotation's length", Some(self.device.frame)),
        ];
        for (name, pose) in poses {
            if let Some(pose) = pose.filter(|pose| !pose.is_valid()) {
                let expected = "a finite pose with a unit quaternion";
                return Err(SettingsError { name, value: pose.rotation.length(), expected });
            }
        }
        Ok(())
    }
}

const CLUSTER_RANGE: &str = "a number of clusters from 1 to 16";
const _: () = assert!(MAX_CLUSTERS == 16, "CLUSTER_RANGE names the limit");

const ABOVE_ZERO: RangeInclusive<f64> = f64::MIN_POSITIVE..=f64::MAX;
const ABOVE_ZERO_OR_UNLIMITED: RangeInclusive<f64> = f64::MIN_POSITIVE..=f64::INFINITY;

/// Refuses the first setting (name, value, expected values, range) that is given and out of its range.
fn check_ranges(
    settings: impl IntoIterator<Item = (&'static str, Option<f64>, &'static str, RangeInclusive<f64>)>,
) -> Result<(), SettingsError> {
    for (name, value, expected, range) in settings {
        if let Some(value) = value.filter(|value| !range.contains(value)) {
            return Err(SettingsError { name, value, expected });
        }
    }
    Ok(())
}
