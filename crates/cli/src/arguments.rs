//! Commands and options of `palpate`.

use std::path::{Path, PathBuf};

use clap::{Args, Parser, Subcommand};
use palpate::device::Task;
use palpate::dynamics::IntegratorKind;
use palpate::settings::{
    ContactSearch, ContactSettings, CouplingSettings, DetailSettings, DeviceSettings, OutputSettings,
    Response, SearchSettings, TextureSettings, TimingSettings, ToolSettings,
};
use palpate::{Object, OpenOptions, Settings};

use crate::failure::Failure;
use crate::textures::Detail;

#[derive(Parser)]
#[command(name = "palpate", version, about = "6-DoF haptic rendering: feel one mesh touching another")]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Subcommand)]
pub enum Command {
    /// List the built-in models
    Models(ModelsArguments),
    /// Write a built-in model as a mesh file
    Export(ExportArguments),
    /// Check a mesh: whether it is ready to be touched, closed, 2-manifold, oriented, free of
    /// self-intersections; counts, size
    Check(CheckArguments),
    /// Build the hierarchy of a mesh
    Build(BuildArguments),
    /// Show the levels of a hierarchy as a table and as pictures
    Inspect(InspectArguments),
    /// Replay a trajectory of the probe and time the contact queries
    Query(QueryArguments),
    /// Find the most accurate settings with which contact steps fit into a given time
    Recommend(Box<RecommendArguments>),
    /// Render a session: feel a probe touch a scene through a device
    Run(Box<RunArguments>),
    /// Render in a window that shows the contacts; the mouse moves the emulated hand
    /// [build with the cargo feature `view`]
    View(Box<ViewArguments>),
    /// List the devices and what they can do
    Devices(DevicesArguments),
    /// Check whether this machine is fit for haptics: scheduling, timer, processors, graphics, devices, cache
    Doctor(DoctorArguments),
}

/// Destination of the machine-readable result.
#[derive(Args)]
pub struct Json {
    /// Print the result as JSON, or write it to FILE
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    pub json: Option<PathBuf>,
}

impl Json {
    /// File to write, if one was given.
    pub fn file(&self) -> Option<&Path> {
        self.json.as_deref().filter(|path| *path != Path::new("-"))
    }
}

/// Options of reading a mesh.
#[derive(Args)]
pub struct Reading {
    /// Factor on the mesh's lengths: 0.001 for files in millimetres
    #[arg(long, default_value_t = 1.0, value_name = "S")]
    pub scale: f64,
    /// Repair the mesh into an oriented 2-manifold without self-intersections, and report what changed
    #[arg(long)]
    pub repair: bool,
}

impl Reading {
    pub fn options(&self) -> OpenOptions {
        OpenOptions { scale: self.scale, repair: self.repair, ..OpenOptions::default() }
    }
}

/// Options of reading two meshes that touch each other.
#[derive(Args)]
pub struct PairReading {
    /// Factor on the lengths of both meshes: 0.001 for files in millimetres; objects of a scene file have
    /// their own
    #[arg(long, default_value_t = 1.0, value_name = "S")]
    scale: f64,
    /// Factor on the probe's lengths alone [default: --scale]
    #[arg(long, value_name = "S")]
    probe_scale: Option<f64>,
    /// Factor on the scene's lengths alone [default: --scale]
    #[arg(long, value_name = "S")]
    scene_scale: Option<f64>,
    /// Repair both meshes into oriented 2-manifolds without self-intersections, and report what changed
    #[arg(long)]
    repair: bool,
    /// Repair the probe alone
    #[arg(long)]
    probe_repair: bool,
    /// Repair the scene's mesh alone
    #[arg(long)]
    scene_repair: bool,
}

impl PairReading {
    /// Options for the probe.
    pub fn of_probe(&self) -> OpenOptions {
        self.options(self.probe_scale, self.probe_repair)
    }

    /// Options for the scene's mesh.
    pub fn of_scene(&self) -> OpenOptions {
        self.options(self.scene_scale, self.scene_repair)
    }

    /// Whether an option for the scene's mesh alone was given.
    pub fn is_scene_given(&self) -> bool {
        self.scene_scale.is_some() || self.scene_repair
    }

    /// Words of the command line that give these options.
    pub fn words(&self) -> Vec<String> {
        let scales = [
            ("--scale", (self.scale != 1.0).then_some(self.scale)),
            ("--probe-scale", self.probe_scale),
            ("--scene-scale", self.scene_scale),
        ];
        let repairs = [
            ("--repair", self.repair),
            ("--probe-repair", self.probe_repair),
            ("--scene-repair", self.scene_repair),
        ];
        let scales = scales.into_iter().filter_map(|(name, scale)| Some(format!("{name} {}", scale?)));
        scales
            .chain(repairs.into_iter().filter(|(_, given)| *given).map(|(name, _)| name.to_owned()))
            .collect()
    }

    fn options(&self, scale: Option<f64>, repair: bool) -> OpenOptions {
        OpenOptions {
            scale: scale.unwrap_or(self.scale),
            repair: repair || self.repair,
            ..OpenOptions::default()
        }
    }
}

#[derive(Args)]
pub struct ModelsArguments {
    #[command(flatten)]
    pub json: Json,
}

#[derive(Args)]
pub struct ExportArguments {
    /// Built-in model, NAME or NAME@TRIANGLES
    pub model: String,
    /// OBJ file to write
    #[arg(short, long, value_name = "FILE.obj")]
    pub output: PathBuf,
}

#[derive(Args)]
#[command(allow_negative_numbers = true)] // Refused with a reason, not for looking like an option.
pub struct CheckArguments {
    /// Mesh file (.obj .glb .gltf .stl .ply) or built-in model
    pub mesh: String,
    #[command(flatten)]
    pub reading: Reading,
    #[command(flatten)]
    pub json: Json,
}

#[derive(Args)]
#[command(allow_negative_numbers = true)] // Refused with a reason, not for looking like an option.
pub struct BuildArguments {
    /// Mesh file (.obj .glb .gltf .stl .ply) or built-in model
    pub mesh: String,
    /// Hierarchy to write
    #[arg(short, long, value_name = "FILE.clod")]
    pub output: PathBuf,
    #[command(flatten)]
    pub reading: Reading,
    #[command(flatten)]
    pub json: Json,
}

#[derive(Args)]
#[command(allow_negative_numbers = true)] // Refused with a reason, not for looking like an option.
pub struct InspectArguments {
    /// Hierarchy (.clod), mesh file or built-in model
    pub hierarchy: String,
    #[command(flatten)]
    pub reading: Reading,
    #[command(flatten)]
    pub pictures: Pictures,
    #[command(flatten)]
    pub json: Json,
}

/// Pictures of levels.
#[derive(Args)]
#[command(allow_negative_numbers = true)] // Directions may be negative.
pub struct Pictures {
    /// Write a PNG picture of each level, with its patches in colours, and a contact sheet, levels.png, into
    /// this folder
    #[arg(long, value_name = "DIR")]
    pub render: Option<PathBuf>,
    /// Width of the pictures, pixels; they are three quarters as high
    #[arg(long, value_name = "N", default_value_t = 800, requires = "render",
        value_parser = clap::value_parser!(u32).range(200..=2000))]
    pub size: u32,
    /// Levels to draw, such as 0,3,6 [default: all]
    #[arg(long, value_name = "LEVELS", value_delimiter = ',', requires = "render")]
    pub levels: Vec<usize>,
    /// Azimuth of the camera: degrees about the vertical, from x towards y
    /// [default: a view that shows the object well]
    #[arg(long, value_name = "DEGREES", requires = "render", value_parser = angle)]
    pub azimuth: Option<f64>,
    /// Elevation of the camera above the horizon, degrees
    #[arg(long, value_name = "DEGREES", requires = "render", value_parser = angle)]
    pub elevation: Option<f64>,
}

fn angle(text: &str) -> Result<f64, String> {
    let degrees = text.parse().ok().filter(|degrees: &f64| degrees.abs() <= 360.0);
    degrees.ok_or_else(|| "give degrees from -360 to 360".to_owned())
}

#[derive(Args)]
#[command(allow_negative_numbers = true)] // Refused with a reason, not for looking like an option.
pub struct QueryArguments {
    /// The object that moves: mesh file, .clod file or built-in model
    pub probe: String,
    /// The object that it touches
    pub scene: String,
    /// Poses of the probe in the scene's frame: CSV with the header t,px,py,pz,qx,qy,qz,qw, or a recording
    /// by `run --record`
    #[arg(long, value_name = "T.csv")]
    pub trajectory: PathBuf,
    /// Report contacts closer than this: metres, or a percentage of the probe's bounding radius such as 1%
    #[arg(long, value_name = "D")]
    pub tolerance: Length,
    /// Report a few contacts at exact geometry, each with the area that it represents, with an error of
    /// about EPS: metres, or a percentage of the probe's bounding radius, 0.02% to 1% [default EPS:
    /// 0.05%]
    #[arg(long, value_name = "EPS", num_args = 0..=1, default_missing_value = "0.05%",
        conflicts_with_all = ["error", "exact", "interpolate", "parallel"])]
    pub representative: Option<Length>,
    /// Leave out detail whose error, averaged over the area of contact (s*), is at most this: metres, or a
    /// percentage of the probe's bounding radius such as 2.5%, at most 100% [default: full resolution]
    #[arg(long, value_name = "S0", conflicts_with = "exact")]
    pub error: Option<Length>,
    /// Report contacts at full resolution: local minima of the distance, merged within 10 % of D, and one
    /// contact for each region of intersection. This is the default without --representative, --error and
    /// --budget-us; with either of the last two, every pair of patches in contact is reported
    #[arg(long)]
    pub exact: bool,
    /// Blend contacts smoothly from one level of detail to the next
    #[arg(long, conflicts_with = "exact")]
    pub interpolate: bool,
    /// Time-critical mode: refine the most important detail first, and stop after about this many
    /// microseconds; with --representative, leave out the finest samples that do not fit
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub budget_us: Option<u64>,
    /// Use all processors where there are many contacts; the result is the same
    #[arg(long, conflicts_with = "budget_us")]
    pub parallel: bool,
    /// Start each query from the roots rather than from the previous query's front
    #[arg(long)]
    pub cold: bool,
    /// Stiffness of the penalty force, N/m
    #[arg(long, default_value_t = 1000.0, value_name = "K")]
    pub stiffness: f64,
    /// Number of contact clusters
    #[arg(long, default_value_t = 5, value_name = "N")]
    pub clusters: usize,
    /// Write each contact, before clustering, as CSV
    #[arg(long, value_name = "FILE.csv")]
    pub contacts: Option<PathBuf>,
    #[command(flatten)]
    pub reading: PairReading,
    #[command(flatten)]
    pub json: Json,
}

#[derive(Args)]
#[command(allow_negative_numbers = true)] // Refused with a reason, not for looking like an option.
pub struct RunArguments {
    /// The object in the hand: mesh file, .clod file or built-in model; with --tool, the scene
    pub probe: String,
    /// The object that it touches, or a scene file (.toml) with several and settings
    #[arg(required_unless_present = "tool", default_value = "", hide_default_value = true)]
    pub scene: String,
    /// Hold the tool with a hinge of this file, in place of a probe, on a device with a gripper
    /// (emulated:gripper=FILE.csv)
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["integrator", "mass", "probe_detail",
        "probe_heights", "probe_repair", "probe_scale", "report", "scene"])]
    pub tool: Option<PathBuf>,
    /// emulated, emulated:PRESET,KEY=VALUE,... (task=press, hand=firm, encoder_step=0, path=FILE.csv, ...),
    /// replay:FILE (a trajectory, a recording of a session or of a device), or one that `palpate devices`
    /// lists
    #[arg(long, default_value = "emulated")]
    pub device: String,
    /// Send forces only while this button of the device, counted from 0, is held [default: always]
    #[arg(long, value_name = "N")]
    pub enable_button: Option<u32>,
    /// How long to render, s [default: 10; in a window, until it is closed]
    #[arg(long)]
    pub seconds: Option<f64>,
    /// Run on a simulated clock in one thread: reproducible bit for bit
    #[arg(long)]
    pub lockstep: bool,
    /// Contact queries a second under --lockstep, Hz, at most --rate [default: 500]
    #[arg(long, value_name = "HZ", requires = "lockstep")]
    pub contact_rate: Option<f64>,
    /// Record the session as CSV, one row for each haptic step
    #[arg(long, value_name = "FILE.csv")]
    pub record: Option<PathBuf>,
    /// Record the device's readings, to replay them exactly with --device replay:FILE: text if FILE ends in
    /// .csv, else compact
    #[arg(long, value_name = "FILE")]
    pub record_device: Option<PathBuf>,
    /// Write a self-contained HTML report
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    #[command(flatten)]
    pub physics: Physics,
    #[command(flatten)]
    pub resolution: Resolution,
    #[command(flatten)]
    pub textures: Textures,
    #[command(flatten)]
    pub reading: PairReading,
    #[command(flatten)]
    pub json: Json,
}

#[derive(Args)]
#[command(allow_negative_numbers = true)] // Refused with a reason, not for looking like an option.
pub struct RecommendArguments {
    /// The object in the hand: mesh file, .clod file or built-in model
    pub probe: String,
    /// The object that it touches
    pub scene: String,
    /// Task of the emulated hand: explore, press, stroke, scrub, tap or peg-insertion [default: explore]
    #[arg(long, value_name = "NAME", conflicts_with = "trajectory", value_parser = task)]
    pub task: Option<Task>,
    /// Poses that the hand moves the probe through: CSV with the header t,px,py,pz,qx,qy,qz,qw, or a
    /// recording by `run --record`
    #[arg(long, value_name = "T.csv")]
    pub trajectory: Option<PathBuf>,
    /// How long the hand moves the probe, s
    #[arg(long, default_value_t = 3.0, value_name = "S")]
    pub seconds: f64,
    /// Time limit of a contact step, microseconds [default: the haptic period]
    #[arg(long, value_name = "N")]
    pub budget_us: Option<f64>,
    #[command(flatten)]
    pub physics: Physics,
    #[command(flatten)]
    pub textures: Textures,
    #[command(flatten)]
    pub reading: PairReading,
    #[command(flatten)]
    pub json: Json,
}

fn task(text: &str) -> Result<Task, String> {
    Task::named(text).ok_or_else(|| {
        let names: Vec<&str> = Task::ALL.iter().map(|(name, _)| *name).collect();
        format!("give one of {}", names.join(", "))
    })
}

/// Haptic textures: fine detail that is felt from images.
#[derive(Args)]
pub struct Textures {
    /// Height image (PNG, TIFF, OpenEXR, JPEG or WebP) that displaces the probe, a mesh file with texture
    /// coordinates
    #[arg(long, value_name = "IMAGE", requires = "amplitude", conflicts_with = "probe_detail")]
    probe_heights: Option<PathBuf>,
    /// Height image that displaces the scene's object
    #[arg(long, value_name = "IMAGE", requires = "amplitude", conflicts_with = "scene_detail")]
    scene_heights: Option<PathBuf>,
    /// Displacement by height images: metres from black to white, or metres per unit of a float image; mid
    /// grey is zero
    #[arg(long, value_name = "A")]
    amplitude: Option<f64>,
    /// Detailed mesh or built-in model, in the probe's frame, whose detail is baked onto the coarse probe
    #[arg(long, value_name = "MESH")]
    probe_detail: Option<String>,
    /// Detailed mesh or built-in model whose detail is baked onto the scene's object
    #[arg(long, value_name = "MESH")]
    scene_detail: Option<String>,
    /// Size of the baked texels, m [default: a 400th of the bounding radius]
    #[arg(long, value_name = "T")]
    texel: Option<f64>,
    /// How far around a contact its texture is sampled, m [default: as far as the grid resolves the texture]
    #[arg(long, value_name = "R")]
    texture_reach: Option<f64>,
    /// Texels along each side of the grid on which a textured contact is sampled [default: 50]
    #[arg(long, value_name = "N")]
    texture_grid: Option<u32>,
}

impl Textures {
    pub fn of_probe(&self) -> Detail<'_> {
        self.detail(self.probe_heights.as_deref(), self.probe_detail.as_deref())
    }

    pub fn of_scene(&self) -> Detail<'_> {
        self.detail(self.scene_heights.as_deref(), self.scene_detail.as_deref())
    }

    fn detail<'a>(&self, heights: Option<&'a Path>, mesh: Option<&'a str>) -> Detail<'a> {
        match (heights, self.amplitude, mesh) {
            (Some(image), Some(amplitude), _) => Detail::Heights(image, amplitude),
            (_, _, Some(mesh)) => Detail::Mesh(mesh, self.texel),
            _ => Detail::None,
        }
    }

    /// Applies these options to the settings.
    pub fn applied_to(&self, settings: Settings) -> Settings {
        let default = settings.textures;
        let grid = self.texture_grid.unwrap_or(default.grid);
        let half_size = self.texture_reach.or(default.half_size);
        Settings { textures: TextureSettings { half_size, grid, ..default }, ..settings }
    }
}

/// Search method and level of detail of contact queries.
#[derive(Args)]
pub struct Resolution {
    /// Find a few contacts at exact geometry, each with the area that it represents, with an error of about
    /// EPS: metres, or a percentage of the probe's bounding radius, 0.02% to 1% [default EPS: 0.05%]. The
    /// default on closed objects without thin walls or textures
    #[arg(long, value_name = "EPS", num_args = 0..=1, default_missing_value = "0.05%",
        conflicts_with_all = ["error", "no_interpolation", "budget_us"])]
    representative: Option<Length>,
    /// Find contacts by levels of detail, and leave out detail whose error, averaged over the area of
    /// contact, is at most this: metres, or a percentage of the probe's bounding radius such as 2.5%, at
    /// most 100%; 0 for full resolution
    #[arg(long, value_name = "S0")]
    error: Option<Length>,
    /// Let forces jump where the level of detail changes, which takes a little less time
    #[arg(long)]
    no_interpolation: bool,
    /// Time limit of a contact query, microseconds; detail that does not fit is left out [default: no limit]
    #[arg(long, value_name = "N")]
    budget_us: Option<f64>,
}

impl Resolution {
    /// Applies these options to the settings for a probe.
    pub fn applied_to(&self, settings: Settings, probe: &Object) -> Result<Settings, Failure> {
        let error = self.error.map(|error| detail_error(error, probe)).transpose()?;
        let (method, representative_error) = match self.representative {
            Some(error) => (ContactSearch::Representatives, Some(error.metres(probe.bounding_radius()))),
            // Constraints are found at full resolution in any case.
            None if error.is_some() && settings.contact.response == Response::Penalty => {
                (ContactSearch::Levels, settings.search.representative_error)
            }
            None => (settings.search.method, settings.search.representative_error),
        };
        Ok(Settings {
            search: SearchSettings { method, representative_error, ..settings.search },
            detail: DetailSettings {
                error: error.unwrap_or(settings.detail.error),
                interpolation: settings.detail.interpolation && !self.no_interpolation,
                query_budget: self.budget_us.map(|us| 1e-6 * us).or(settings.detail.query_budget),
            },
            ..settings
        })
    }
}

/// Value of `--error` in metres for a probe.
///
/// # Errors
/// If the value is larger than the probe, so that no detail would be left.
pub fn detail_error(error: Length, probe: &Object) -> Result<f64, Failure> {
    let radius = probe.bounding_radius();
    let metres = error.metres(radius);
    if metres <= radius {
        return Ok(metres);
    }
    let name = &probe.name;
    Err(Failure::Message(format!(
        "--error {error}: detail as large as {name} would be left out; give at most 100%, its bounding radius ({radius:.3e} m)"
    )))
}

/// Physical settings, SI units.
#[derive(Args)]
pub struct Physics {
    /// Mass of the grasped object, kg [default: 0.1]
    #[arg(long)]
    mass: Option<f64>,
    /// Contact stiffness, N/m [default: 2000]
    #[arg(long)]
    contact_stiffness: Option<f64>,
    /// How contacts act: constraints hold surfaces apart and measure them exactly in each haptic step,
    /// penalty springs push them apart [default: constraints; recommend: penalty]
    #[arg(long, value_enum)]
    response: Option<ResponseName>,
    /// Contact damping, N·s/m [default: critical]
    #[arg(long)]
    contact_damping: Option<f64>,
    /// Stiffness of the virtual coupling, N/m [default: as stiff as the device renders passively]
    #[arg(long)]
    coupling_stiffness: Option<f64>,
    /// Damping of the virtual coupling, N·s/m [default: critical]
    #[arg(long)]
    coupling_damping: Option<f64>,
    /// Angular stiffness of the virtual coupling, N·m/rad [default: as stiff as the device renders
    /// passively]
    #[arg(long)]
    angular_stiffness: Option<f64>,
    /// Angular damping of the virtual coupling, N·m·s/rad [default: critical]
    #[arg(long)]
    angular_damping: Option<f64>,
    /// Coulomb coefficient of friction [default: 0]
    #[arg(long, value_name = "MU")]
    friction: Option<f64>,
    /// Coefficient of friction of contacts at rest [default: --friction]
    #[arg(long, value_name = "MU")]
    static_friction: Option<f64>,
    /// Distance at which contact begins: metres, or a percentage of the probe's radius [default: 1%]
    #[arg(long, value_name = "D")]
    tolerance: Option<Length>,
    /// Number of contact clusters, 1 to 16 [default: 5]
    #[arg(long)]
    clusters: Option<usize>,
    /// Rate of the haptic loop, Hz [default: 1000]
    #[arg(long)]
    rate: Option<f64>,
    /// Integrator of the object's motion: semi-implicit, fully-implicit, forward-euler, symplectic-euler,
    /// runge-kutta-4 or quasi-static [default: semi-implicit]
    #[arg(long, value_name = "NAME")]
    integrator: Option<IntegratorKind>,
    /// Length that the object moves per metre at the device; forces are divided by it, torques by its square
    /// [default: 1]
    #[arg(long, value_name = "S")]
    workspace_scale: Option<f64>,
    /// Clutch: while this button, counted from 0, is held, the device moves without the object
    /// [default: none]
    #[arg(long, value_name = "N")]
    clutch_button: Option<u32>,
    /// Damp the device when more energy has come out of the session than went in
    #[arg(long)]
    passivity_controller: bool,
    /// Render objects whose size suggests a wrong unit
    #[arg(long)]
    unusual_size: bool,
}

impl Physics {
    /// Integrator of the object's motion.
    pub fn integrator(&self) -> IntegratorKind {
        self.integrator.unwrap_or_default()
    }

    /// Rate of the haptic loop (Hz), if given.
    pub fn rate(&self) -> Option<f64> {
        self.rate
    }

    /// Applies these options to the settings for a probe of the given bounding radius, m.
    pub fn applied_to(&self, default: Settings, radius: f64) -> Settings {
        Settings {
            timing: TimingSettings { rate: self.rate.unwrap_or(default.timing.rate), ..default.timing },
            device: DeviceSettings {
                workspace_scale: self.workspace_scale.unwrap_or(default.device.workspace_scale),
                clutch_button: self.clutch_button.or(default.device.clutch_button),
                ..default.device
            },
            output: OutputSettings {
                passivity_controller: self.passivity_controller || default.output.passivity_controller,
                ..default.output
            },
            tool: ToolSettings {
                unusual_size: self.unusual_size || default.tool.unusual_size,
                mass: self.mass.unwrap_or(default.tool.mass),
                ..default.tool
            },
            contact: ContactSettings {
                response: self.response.map_or(default.contact.response, Response::from),
                stiffness: self.contact_stiffness.unwrap_or(default.contact.stiffness),
                damping: self.contact_damping.or(default.contact.damping),
                friction: self.friction.unwrap_or(default.contact.friction),
                static_friction: self.static_friction.or(default.contact.static_friction),
            },
            coupling: CouplingSettings {
                stiffness: self.coupling_stiffness.or(default.coupling.stiffness),
                damping: self.coupling_damping.or(default.coupling.damping),
                angular_stiffness: self.angular_stiffness.or(default.coupling.angular_stiffness),
                angular_damping: self.angular_damping.or(default.coupling.angular_damping),
            },
            search: SearchSettings {
                tolerance: self
                    .tolerance
                    .map(|tolerance| tolerance.metres(radius))
                    .or(default.search.tolerance),
                clusters: self.clusters.unwrap_or(default.search.clusters),
                ..default.search
            },
            ..default
        }
    }
}

#[derive(Args)]
pub struct ViewArguments {
    #[command(flatten)]
    pub run: RunArguments,
    /// Write a picture of the window at the end of the session
    #[arg(long, value_name = "FILE.png")]
    pub screenshot: Option<PathBuf>,
}

#[derive(Args)]
pub struct DevicesArguments {
    /// Print udev rules that let your user open HID devices on Linux
    #[arg(long, conflicts_with = "json")]
    pub udev: bool,
    #[command(flatten)]
    pub json: Json,
}

#[derive(Args)]
pub struct DoctorArguments {
    #[command(flatten)]
    pub json: Json,
}

/// Length in metres, or as a fraction of the probe's bounding radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Length {
    /// Metres.
    Metres(f64),
    /// Fraction of the probe's bounding radius.
    OfRadius(f64),
}

impl Length {
    /// Length in metres for a probe of the given bounding radius, m.
    pub fn metres(self, radius: f64) -> f64 {
        match self {
            Self::Metres(length) => length,
            Self::OfRadius(fraction) => fraction * radius,
        }
    }
}

impl std::fmt::Display for Length {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Metres(length) => write!(f, "{length}"),
            Self::OfRadius(fraction) => write!(f, "{}%", 100.0 * fraction),
        }
    }
}

impl std::str::FromStr for Length {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (number, percent) = match text.strip_suffix('%') {
            Some(number) => (number, true),
            None => (text, false),
        };
        match number.trim().parse::<f64>() {
            Ok(value) if value.is_finite() && value >= 0.0 => {
                Ok(if percent { Self::OfRadius(value / 100.0) } else { Self::Metres(value) })
            }
            _ => {
                Err("give metres, such as 0.001, or a percentage of the probe's radius, such as 1%"
                    .to_owned())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arguments_are_consistent() {
        use clap::CommandFactory;
        Arguments::command().debug_assert();
    }

    #[test]
    fn the_words_of_reading_options_give_the_same_options() {
        let parse = |words: &[&str]| {
            let run = ["palpate", "run", "a.obj", "b.obj"];
            match Arguments::parse_from(run.iter().chain(words)).command {
                Command::Run(run) => run.reading,
                _ => panic!("it is `run`"),
            }
        };
        assert!(parse(&[]).words().is_empty());
        let reading = parse(&["--scale", "0.001", "--scene-scale", "1", "--probe-repair"]);
        assert_eq!(reading.words(), ["--scale 0.001", "--scene-scale 1", "--probe-repair"]);
        assert_eq!((reading.of_probe().scale, reading.of_probe().repair), (0.001, true));
        assert_eq!((reading.of_scene().scale, reading.of_scene().repair), (1.0, false));
    }

    #[test]
    fn lengths_are_metres_or_percent_of_the_radius() {
        assert_eq!("0.002".parse::<Length>().map(|l| l.metres(7.0)), Ok(0.002));
        assert_eq!("2.5%".parse::<Length>().map(|l| l.metres(2.0)), Ok(0.05));
        for refused in ["", "-1", "nan", "1cm", "%"] {
            assert!(refused.parse::<Length>().is_err(), "{refused}");
        }
    }
}

/// How contacts act.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum ResponseName {
    Constraints,
    Penalty,
}

impl From<ResponseName> for Response {
    fn from(name: ResponseName) -> Self {
        match name {
            ResponseName::Constraints => Self::Constraints,
            ResponseName::Penalty => Self::Penalty,
        }
    }
}
