//! The physical settings of a session, in SI units.

pub(crate) mod gripper;
pub(crate) mod live;

pub use self::gripper::GripperSettings;
use palpate_core::Pose;
use serde::{Deserialize, Serialize};

/// Time in which the wrench may rise from zero to the device's peak, s.
pub(crate) const SLEW_TIME: f64 = 0.01;

/// What a session renders with. Values that are left out of a file are the defaults; those that are `None` are derived from the
/// grasped object and the device.
///
/// Contact, coupling, detail and output are [`LiveSettings`]: they may change while the session runs. The rest is fixed when it is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// How contacts push.
    pub contact: ContactSettings,
    /// Gains of the virtual coupling.
    pub coupling: CouplingSettings,
    /// Which detail is left out.
    pub detail: DetailSettings,
    /// How the wrench at the device may change.
    pub output: OutputSettings,
    /// How contacts are found.
    pub search: SearchSettings,
    /// The grasped object.
    pub tool: ToolSettings,
    /// The device's workspace.
    pub device: DeviceSettings,
    /// Rates and times.
    pub timing: TimingSettings,
    /// How contacts with textured objects are sampled.
    pub textures: TextureSettings,
}

/// The settings that may change while a session runs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LiveSettings {
    /// How contacts push.
    pub contact: ContactSettings,
    /// Gains of the virtual coupling.
    pub coupling: CouplingSettings,
    /// Which detail is left out.
    pub detail: DetailSettings,
    /// How the wrench at the device may change.
    pub output: OutputSettings,
}

/// How contacts push the grasped object. May change while a session runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactSettings {
    /// Contact stiffness k, N/m, of each contact cluster.
    pub stiffness: f64,
    /// Contact damping b, N·s/m; by default critical for the grasped mass on one cluster.
    pub damping: Option<f64>,
    /// Coulomb coefficient of friction μ of sliding contacts, 0 by default.
    pub friction: f64,
    /// That of contacts at rest, which they have to exceed to slide; by default the same.
    pub static_friction: Option<f64>,
}

impl Default for ContactSettings {
    fn default() -> Self {
        Self { stiffness: 2000.0, damping: None, friction: 0.0, static_friction: None }
    }
}

/// Gains of the virtual coupling between device and object. May change while a session runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CouplingSettings {
    /// Stiffness of the virtual coupling k_c, N/m; by default what the device renders passively with a margin, at most
    /// half of what its maker calls stable ([`VirtualCoupling::auto`](palpate_dynamics::VirtualCoupling::auto)); 500 N/m
    /// where it sets no limit.
    pub stiffness: Option<f64>,
    /// Damping of the virtual coupling b_c, N·s/m; by default critical.
    pub damping: Option<f64>,
    /// Angular stiffness of the virtual coupling k_θ, N·m/rad, in the world; by default likewise, 3 N·m/rad where the
    /// device sets no limit or renders no torque.
    pub angular_stiffness: Option<f64>,
    /// Angular damping of the virtual coupling b_θ, N·m·s/rad; by default critical for the largest principal moment of
    /// inertia about the grasp. Both dampers act on a velocity of the device that lags as much as passivity asks for.
    pub angular_damping: Option<f64>,
}

/// Which detail contacts leave out, where they are found by levels of detail. May change while a session runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DetailSettings {
    /// s₀, m: with levels of detail, detail is left out of contacts where it would not be felt, its deviation averaged over the area of contact
    /// being no more than this (§3.4.3), and forces go over smoothly from one level of detail to the next. 0, the
    /// default, for full resolution.
    pub error: f64,
    /// Whether forces go over smoothly from one level of detail to the next, where detail is left out (§3.4.4); without, they
    /// jump where the level changes, for a little less time.
    pub interpolation: bool,
    /// Time that a contact query may take, s: detail that matters most comes first, and what does not fit in is left out
    /// (§3.4.3). A session on a simulated clock is then not the same each time. None by default.
    pub query_budget: Option<f64>,
}

impl Default for DetailSettings {
    fn default() -> Self {
        Self { error: 0.0, interpolation: true, query_budget: None }
    }
}

/// How the wrench at the device may change. May change while a session runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutputSettings {
    /// Largest change of the force at the device, N/s; by default its peak in 10 ms.
    pub force_slew: Option<f64>,
    /// Largest change of the torque at the device, N·m/s; by default its peak in 10 ms.
    pub torque_slew: Option<f64>,
    /// Whether the session damps the device where more energy came out of the session than went in
    /// ([`PassivityController`](palpate_dynamics::PassivityController)).
    pub passivity_controller: bool,
}

/// How contacts are found. Fixed when a session is made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SearchSettings {
    /// How contacts are found; by default as representatives where these hold, and else by levels of detail.
    pub method: ContactSearch,
    /// Distance tolerance d of the contact query, m, at most the grasped object's bounding radius; by default 1 % of it, and no
    /// more than 2 mm at the device.
    pub tolerance: Option<f64>,
    /// EPS, m: representative contacts are off by about this at most, 0.02 % to 1 % of the grasped object's bounding radius; by
    /// default 0.05 %, and no more than a twentieth of the tolerance d.
    pub representative_error: Option<f64>,
    /// K: how many representative contacts there may be (§5.4.2). Those found in distance fields push with K k wherever bodies
    /// touch, as K clusters of contacts do that are found by levels of detail.
    pub clusters: usize,
    /// Brake the grasped object before it touches what it comes at fast, so that it is not inside or behind it by the time
    /// that a contact query finds it (§5.6.1).
    pub braking: bool,
    /// Keep a proxy of the grasped object on the side of surfaces that it came from, and have contacts push the object
    /// there, so that it does not come out behind what it is pressed or driven through (§5.6.1).
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

/// The grasped object, and how it is held and moves. Fixed when a session is made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ToolSettings {
    /// Mass of the grasped object, kg.
    pub mass: f64,
    /// The grasp: the frame, fixed to the grasped object and given in its mesh's frame, that the virtual coupling acts on; by
    /// default at the centre of mass.
    ///
    /// The device's handle [is there](ToolSettings::handle) too: to hold a tool by its handle, set the grasp to where that is in its mesh. Only
    /// the grasp's position matters, since the coupling is equally stiff in all directions.
    pub grasp: Option<Pose>,
    /// Where on the grasped object the device's handle is. It does not place the object: while the handle is in the middle of its
    /// workspace, unturned, and the coupling is not stretched, the mesh's frame is at the [device frame](DeviceSettings::frame).
    pub handle: HandlePlace,
    /// Whether to render objects whose size suggests a [wrong unit](crate::errors::UnitsError). Without, a session does not start
    /// with them.
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
    /// How far in the world a metre at the device is. Forces at the device are those of the world divided by it, torques
    /// by its square ([`DeviceMapping`](palpate_dynamics::DeviceMapping), §5.3.3).
    pub workspace_scale: f64,
    /// The device's axes in the world, and where the mesh's frame is while the handle is in the middle of its workspace.
    pub frame: Pose,
    /// The device's button, counted from 0, that is the clutch: while it is held the device moves without the object.
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
    /// Age of the newest contact model, s, from which the wrench fades out, to nothing 50 ms later, or at twice this age where that
    /// is sooner; it fades in again over as long a time. It fades likewise where the object has gone further than half its bounding
    /// radius, and than 1 cm at the device, from where its contacts were found.
    pub contact_timeout: f64,
    /// Time, s, over which the wrench comes up from zero: after the start, wherever the object then is, and after the
    /// device or the step has failed. It goes down and comes up over as long a time for the clutch.
    pub engagement: f64,
}

impl Default for TimingSettings {
    fn default() -> Self {
        Self { rate: 1000.0, contact_timeout: 0.05, engagement: 0.2 }
    }
}

/// How the contacts of a session are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ContactSearch {
    /// As [representatives](Self::Representatives) where these hold, and else by [levels](Self::Levels): where detail is to be left out
    /// ([`DetailSettings::error`]) or queries have a [time limit](DetailSettings::query_budget), where an object has a haptic texture or an open
    /// surface, where one has walls thinner than d or a field that is not true to a quarter of d, and for [tools with a
    /// hinge](crate::tool::Hinged). It is decided when the session is made. The stage `representative contacts` of its summary says what was decided, and why.
    ///
    /// An object of that kind that is added later makes the session go over to levels, for good.
    #[default]
    Automatic,
    /// By the hierarchies: contacts of convex patches, at full resolution or with detail left out.
    Levels,
    /// In distance fields: few contacts at true geometry, each with the area that it stands for. Where an object's surface is not
    /// closed, or one has a haptic texture, contacts are found by levels nevertheless.
    Representatives,
}

/// Where on the grasped object the device's handle is: what turns of the handle leave in place, and what the torque at the device is
/// about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum HandlePlace {
    /// [At the grasp](Self::Grasp); [at the mesh's origin](Self::MeshOrigin) with a device that renders nothing, as one that replays a
    /// motion of the mesh's frame.
    #[default]
    Automatic,
    /// At the [grasp](ToolSettings::grasp), however far the mesh's origin is from it. The coupling then has no lever at the device.
    Grasp,
    /// At the mesh's origin: the device's pose is that of the mesh's frame. The coupling acts at the end of a lever as long as the
    /// grasp is away from there, and is the softer for it.
    MeshOrigin,
}

/// How contacts with textured objects are looked at (§4.4).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TextureSettings {
    /// Texels along a side of a contact's grid.
    pub grid: u32,
    /// Half the side of a grid, m: what lies further from a contact along its plane is not felt. By default such that the grid's
    /// texels are as large as the smallest of the textures', but no more than the grasped object's bounding radius.
    pub half_size: Option<f64>,
    /// τ, m: a contact pushes where the largest overlaps are, by a smooth maximum that goes over from one to another that
    /// grows larger within some times of it; 0 for the largest alone. By default half the tolerance d.
    pub temperature: Option<f64>,
    /// What computes.
    pub backend: TextureBackend,
}

/// What computes textured contacts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum TextureBackend {
    /// The processor: a session on a simulated clock is the same each time.
    #[default]
    Processor,
    /// The processor or the fastest GPU, whichever is faster when the session is made; the processor where there is no GPU.
    Auto,
    /// The fastest GPU, or the software driver that stands in for one, in f32: a session without one is refused.
    Gpu,
}

impl Default for TextureSettings {
    /// A grid of 50 × 50 (§4.5.2), on the processor.
    fn default() -> Self {
        Self { grid: 50, half_size: None, temperature: None, backend: TextureBackend::default() }
    }
}

/// A setting that was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{name} is {value}; give {expected}")]
pub struct SettingsError {
    /// The setting's name.
    pub name: &'static str,
    /// What was given.
    pub value: f64,
    /// What would do.
    pub expected: &'static str,
}

impl Settings {
    /// The part that may change while a session runs.
    pub fn live(&self) -> LiveSettings {
        let Self { contact, coupling, detail, output, .. } = *self;
        LiveSettings { contact, coupling, detail, output }
    }

    /// These settings with another part that may change while a session runs.
    #[must_use]
    pub fn with_live(self, live: &LiveSettings) -> Self {
        let LiveSettings { contact, coupling, detail, output } = *live;
        Self { contact, coupling, detail, output, ..self }
    }

    /// Refuses values that no physical object or device can have.
    ///
    /// # Errors
    /// Names the first setting out of range.
    pub fn check(&self) -> Result<(), SettingsError> {
        let positive = [
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
            ("tolerance", self.search.tolerance, "metres above 0", f64::MIN_POSITIVE..=f64::MAX),
            ("error", Some(self.detail.error), "metres, 0 or more", 0.0..=f64::MAX),
            (
                "representative error",
                self.search.representative_error,
                "metres above 0",
                f64::MIN_POSITIVE..=f64::MAX,
            ),
            ("query budget", self.detail.query_budget, "seconds from 1e-6 to 10", 1e-6..=10.0),
            (
                "contact-timeout",
                Some(self.timing.contact_timeout),
                "seconds above 0",
                f64::MIN_POSITIVE..=f64::MAX,
            ),
            ("engagement", Some(self.timing.engagement), "seconds from 0 to 10", 0.0..=10.0),
            ("workspace-scale", Some(self.device.workspace_scale), "a factor from 1e-4 to 1e4", 1e-4..=1e4),
            ("force-slew", self.output.force_slew, "N/s above 0", f64::MIN_POSITIVE..=f64::INFINITY),
            ("torque-slew", self.output.torque_slew, "N·m/s above 0", f64::MIN_POSITIVE..=f64::INFINITY),
            ("texture grid", Some(self.textures.grid.into()), "2 to 1024 texels", 2.0..=1024.0),
            ("texture half-size", self.textures.half_size, "metres above 0", f64::MIN_POSITIVE..=f64::MAX),
            ("texture temperature", self.textures.temperature, "metres, 0 or more", 0.0..=f64::MAX),
            ("clutch-button", self.device.clutch_button.map(f64::from), "a button from 0 to 31", 0.0..=31.0),
            (
                "clusters",
                Some(self.search.clusters as f64),
                CLUSTER_RANGE,
                1.0..=palpate_dynamics::MAX_CLUSTERS as f64,
            ),
        ];
        for (name, value, expected, range) in positive {
            if let Some(value) = value.filter(|value| !range.contains(value)) {
                return Err(SettingsError { name, value, expected });
            }
        }
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
const _: () = assert!(palpate_dynamics::MAX_CLUSTERS == 16, "CLUSTER_RANGE names the limit");
