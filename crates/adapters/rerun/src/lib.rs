//! Logs sessions to [Rerun](https://rerun.io), where they can be watched while they run and scrubbed
//! afterwards: the object in the hand, the scene, the patches that touch in the colour of their level of
//! detail, what pushes where, and forces, torques and depths over time.
//!
//! A [`SessionLog`] is fed where a session's records are taken, never in the haptic or the contact thread:
//! neither knows of it. It writes to any [`RecordingStream`]: a file, a viewer that runs, or memory. Times
//! are on the timeline [`TIMELINE`], lengths are metres.
//!
//! | entity | is |
//! |---|---|
//! | `world/grasped` | the object in the hand: mesh and pose; below it `touching`, its patches in touch |
//! | `world/handle` | axes where the coupling has the device |
//! | `world/scene/N NAME` | a scene object by the number of its [`SceneId`]; below it `touching` |
//! | `world/pushes` | what pushes the grasped object: arrows that end where they push, [`ARROW`] long |
//! | `contact/force`, `contact/torque` | contact wrench on the grasped object, N and N·m about its centre of mass, world axes |
//! | `device/force`, `device/torque` | wrench sent to the device, N and N·m about its handle's origin, in its axes |
//! | `depth`, `contacts`, `model_age` | deepest penetration (m), contacts, and age of the contact model (s) |
//!
//! ```no_run
//! use std::sync::atomic::AtomicBool;
//!
//! use palpate::device::{Emulation, Task};
//! use palpate::{HapticRenderer, Object, Pose, Scene, Settings, explore};
//! use palpate_rerun::{SessionLog, layout, re_sdk::RecordingStreamBuilder};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let probe = Object::model("ellipsoid@500")?;
//! let scene = Scene::new().with(Object::model("golf-ball@5000")?, Pose::IDENTITY);
//! let device = Emulation::default().open(explore::path(Task::default(), &probe, &scene)?)?;
//! let mut renderer = HapticRenderer::new(probe.clone(), scene.clone(), Box::new(device), Settings::default())?;
//!
//! let stream = RecordingStreamBuilder::new("my simulator").with_default_blueprint(layout());
//! let stream = stream.save("session.rrd")?;
//! let mut log = SessionLog::new(stream, &probe, &scene)?;
//! let mut contacts = renderer.contact_monitor();
//! renderer.run_realtime(10.0, &AtomicBool::new(false), |record| {
//!     log.contacts(contacts.latest())?;
//!     log.record(record)
//! })?;
//! log.finish()?;
//! # Ok(())
//! # }
//! ```

mod layout;
mod meshes;

pub use layout::layout;

use std::collections::{BTreeMap, BTreeSet};

use palpate::glam::DVec3;
use palpate::{ContactSnapshot, Object, Pose, Record, Scene, SceneId};
pub use re_sdk;
use re_sdk::log::TimeColumn;
use re_sdk::{EntityPath, EntityPathPart, RecordingStream};
use re_sdk_types::archetypes::{Arrows3D, Clear, Scalars, SeriesLines, Transform3D, TransformAxes3D};
use re_sdk_types::components::{RotationQuat, Translation3D};
use re_sdk_types::datatypes::Quaternion;

/// Name of the timeline: s since the start of the session.
pub const TIMELINE: &str = "session";

/// Length of an arrow, in radii of the grasped object per newton.
pub const ARROW: f64 = 0.2;

/// Number of records that are sent at once.
const BATCH: usize = 128;

/// Time between logged contact snapshots, s: the rate of a display.
const SNAPSHOT_INTERVAL: f64 = 1.0 / 60.0;

/// Thickness of an arrow and length of the handle's axes, in radii of the grasped object.
const THICKNESS: f64 = 0.01;
const AXES: f64 = 0.5;

/// Colours of the grasped object, of scene objects, and of force arrows.
const GRASPED: [u8; 4] = [120, 160, 200, 255];
const SCENE: [u8; 4] = [200, 190, 165, 255];
const PUSH: [u8; 4] = [255, 200, 40, 255];

/// Error of logging.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LogError {
    /// Rerun refused it.
    #[error("Rerun refused {what}: {source}")]
    Refused {
        /// Refused part of the log.
        what: &'static str,
        /// Error of Rerun.
        source: re_sdk::RecordingStreamError,
    },
    /// The log could not be written, or sent to a viewer.
    #[error("the Rerun log could not be written: {0}")]
    NotWritten(#[from] re_sdk::sink::SinkFlushError),
}

/// Log of a session. Buffered records are sent when it is [finished](Self::finish) or dropped.
#[derive(Debug)]
pub struct SessionLog {
    stream: RecordingStream,
    probe: Object,
    /// Objects of the scene, and their paths in the log.
    scene: BTreeMap<SceneId, (Object, EntityPath)>,
    records: Vec<Record>,
    /// Time of the latest logged snapshot, s, and the entities that it showed touching.
    last_snapshot: f64,
    touching: BTreeSet<EntityPath>,
}

impl SessionLog {
    /// Starts a log of a session with an object in the hand and a scene.
    ///
    /// # Errors
    /// If Rerun refuses their meshes.
    pub fn new(stream: RecordingStream, probe: &Object, scene: &Scene) -> Result<Self, LogError> {
        let mut log = Self {
            stream,
            probe: probe.clone(),
            scene: BTreeMap::new(),
            records: Vec::with_capacity(BATCH),
            last_snapshot: f64::NEG_INFINITY,
            touching: BTreeSet::new(),
        };
        let mesh = meshes::whole(&probe.clod, GRASPED);
        log.stream.log_static(grasped(), &mesh).map_err(refused("mesh"))?;
        let axes = TransformAxes3D::new((AXES * probe.bounding_radius()) as f32);
        log.stream.log_static(path(["world", "handle"]), &axes).map_err(refused("axes"))?;
        for wrench in ["contact", "device"] {
            for part in ["force", "torque"] {
                let names = SeriesLines::new().with_names(["x", "y", "z"]);
                log.stream.log_static(path([wrench, part]), &names).map_err(refused("names"))?;
            }
        }
        for (place, placed) in scene.objects().iter().enumerate() {
            log.add(SceneId(place), &placed.object, &placed.pose, 0.0)?;
        }
        Ok(log)
    }

    /// Adds an object to the scene at a time (s), or replaces the one with its id.
    ///
    /// # Errors
    /// If Rerun refuses its mesh.
    pub fn add(&mut self, id: SceneId, object: &Object, pose: &Pose, time: f64) -> Result<(), LogError> {
        self.remove(id, time)?;
        let entity = path(["world", "scene", &format!("{} {}", id.0, object.name)]);
        self.log(time, &entity, "mesh", &meshes::whole(&object.clod, SCENE))?;
        self.scene.insert(id, (object.clone(), entity));
        self.set_pose(id, pose, time)
    }

    /// Moves a scene object to a pose at a time (s). Unknown objects are ignored.
    ///
    /// # Errors
    /// If Rerun refuses it.
    pub fn set_pose(&mut self, id: SceneId, pose: &Pose, time: f64) -> Result<(), LogError> {
        let Some((_, entity)) = self.scene.get(&id) else { return Ok(()) };
        self.log(time, entity, "pose", &transform([*pose]))
    }

    /// Removes a scene object at a time (s). Unknown objects are ignored.
    ///
    /// # Errors
    /// If Rerun refuses it.
    pub fn remove(&mut self, id: SceneId, time: f64) -> Result<(), LogError> {
        let Some((_, entity)) = self.scene.remove(&id) else { return Ok(()) };
        self.log(time, &entity, "removal", &Clear::new(true))
    }

    /// Logs a haptic step. Records are sent in batches.
    ///
    /// # Errors
    /// If Rerun refuses them.
    pub fn record(&mut self, record: &Record) -> Result<(), LogError> {
        self.records.push(*record);
        if self.records.len() < BATCH { Ok(()) } else { self.send() }
    }

    /// Logs a snapshot of the contacts. Snapshots more frequent than sixty a second are ignored.
    ///
    /// # Errors
    /// If Rerun refuses it.
    pub fn contacts(&mut self, sight: &ContactSnapshot) -> Result<(), LogError> {
        // Before the first contact step the time is NaN.
        if sight.time.is_nan() || sight.time < self.last_snapshot + SNAPSHOT_INTERVAL {
            return Ok(());
        }
        self.last_snapshot = sight.time;
        let radius = self.probe.bounding_radius();
        let arrows = sight.forces.iter().map(|push| push.force * (ARROW * radius));
        let origins = sight.forces.iter().zip(arrows.clone()).map(|(push, arrow)| push.point - arrow);
        let arrows = Arrows3D::from_vectors(arrows.map(|arrow| arrow.to_array()))
            .with_origins(origins.map(|origin| origin.to_array()))
            .with_radii([(THICKNESS * radius) as f32])
            .with_colors([PUSH]);
        self.log(sight.time, &path(["world", "pushes"]), "pushes", &arrows)?;

        let mut shown = BTreeSet::new();
        let probe = sight.patches.iter().map(|pair| pair.probe_node).collect();
        self.patches(sight.time, &grasped(), &self.probe, &probe, &mut shown)?;
        for (id, (object, entity)) in &self.scene {
            let of_it = sight.patches.iter().filter(|pair| pair.object == id.0);
            let nodes = of_it.map(|pair| pair.scene_node).collect();
            self.patches(sight.time, entity, object, &nodes, &mut shown)?;
        }
        for ended in self.touching.difference(&shown) {
            self.log(sight.time, ended, "end of a contact", &Clear::new(false))?;
        }
        self.touching = shown;
        Ok(())
    }

    /// Sends the buffered records, and waits until all is written.
    ///
    /// # Errors
    /// If Rerun refuses them, or they cannot be written.
    pub fn finish(mut self) -> Result<(), LogError> {
        self.send()?;
        Ok(self.stream.flush_blocking()?)
    }

    /// Logs the patches of an object in contact, if there are any, and adds its entity to those shown.
    fn patches(
        &self,
        time: f64,
        entity: &EntityPath,
        object: &Object,
        nodes: &BTreeSet<u32>,
        shown: &mut BTreeSet<EntityPath>,
    ) -> Result<(), LogError> {
        let Some(mesh) = meshes::patches(&object.clod, nodes) else { return Ok(()) };
        let entity = entity.join(&path(["touching"]));
        self.log(time, &entity, "patches", &mesh)?;
        shown.insert(entity);
        Ok(())
    }

    fn log(
        &self,
        time: f64,
        entity: &EntityPath,
        what: &'static str,
        components: &dyn re_sdk::AsComponents,
    ) -> Result<(), LogError> {
        let send = || {
            let batches = components.as_serialized_batches().into_iter();
            let columns: Result<Vec<_>, _> = batches
                .map(|batch| {
                    let all = [batch.array.len()];
                    batch.partitioned(all)
                })
                .collect();
            let time = TimeColumn::new_duration_secs(TIMELINE, [time]);
            self.stream.send_columns(entity.clone(), [time], columns?)
        };
        send().map_err(refused(what))
    }

    /// Sends the buffered records.
    fn send(&mut self) -> Result<(), LogError> {
        if self.records.is_empty() {
            return Ok(());
        }
        let records = std::mem::replace(&mut self.records, Vec::with_capacity(BATCH));
        let times = || [TimeColumn::new_duration_secs(TIMELINE, records.iter().map(|record| record.time))];
        let poses = |entity: EntityPath, pose: fn(&Record) -> Pose| {
            let columns = transform(records.iter().map(pose)).columns_of_unit_batches()?;
            self.stream.send_columns(entity, times(), columns)
        };
        poses(grasped(), |record| record.object).map_err(refused("poses"))?;
        poses(path(["world", "handle"]), |record| record.handle).map_err(refused("poses"))?;
        let vectors = |entity: [&str; 2], vector: fn(&Record) -> DVec3| {
            let numbers = records.iter().flat_map(|record| vector(record).to_array());
            let columns = Scalars::new(numbers).columns(std::iter::repeat_n(3, records.len()))?;
            self.stream.send_columns(path(entity), times(), columns)
        };
        vectors(["contact", "force"], |record| record.contact.force).map_err(refused("forces"))?;
        vectors(["contact", "torque"], |record| record.contact.torque).map_err(refused("torques"))?;
        vectors(["device", "force"], |record| record.coupling.force).map_err(refused("forces"))?;
        vectors(["device", "torque"], |record| record.coupling.torque).map_err(refused("torques"))?;
        let numbers = |entity: &str, number: fn(&Record) -> f64| {
            let columns = Scalars::new(records.iter().map(number)).columns_of_unit_batches()?;
            self.stream.send_columns(path([entity]), times(), columns)
        };
        numbers("depth", |record| record.depth).map_err(refused("depths"))?;
        numbers("contacts", |record| f64::from(record.contacts)).map_err(refused("contacts"))?;
        numbers("model_age", |record| record.model_age).map_err(refused("ages"))
    }
}

impl Drop for SessionLog {
    fn drop(&mut self) {
        // Errors are available from `finish`.
        let _ = self.send();
    }
}

fn refused(what: &'static str) -> impl Fn(re_sdk::RecordingStreamError) -> LogError {
    move |source| LogError::Refused { what, source }
}

fn grasped() -> EntityPath {
    path(["world", "grasped"])
}

fn path<'a>(parts: impl IntoIterator<Item = &'a str>) -> EntityPath {
    parts.into_iter().map(EntityPathPart::new).collect::<Vec<_>>().into()
}

/// Returns poses as transforms of an entity.
fn transform(poses: impl IntoIterator<Item = Pose> + Clone) -> Transform3D {
    let translations =
        poses.clone().into_iter().map(|pose| Translation3D::from(pose.translation.as_vec3().to_array()));
    let quaternions =
        poses.into_iter().map(|pose| RotationQuat(Quaternion(pose.rotation.as_quat().to_array())));
    Transform3D::update_fields().with_many_translation(translations).with_many_quaternion(quaternions)
}
