//! The contact loop (§5.1.2): query the scene at the object's pose, cluster the contacts, linearise their response.

mod assemble;
mod by_fields;
mod changes;
mod group;
mod in_scene;
mod lookahead;
pub(crate) mod merging;
pub(crate) mod monitor;
pub(crate) mod proxy;
pub mod representative;
mod search;
mod snapshot;
pub(crate) mod textures;
mod touching;

use std::sync::Arc;
use std::time::Duration;

use palpate_collide::{Budget, PatchContact, QuerySettings, SceneQuery};
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::{Body, BodyState, ContactParameters, LinearContactModel};
use palpate_texture_pd::Backend;
use rtrb::Consumer;

use self::by_fields::{ByFields, FieldFinder, in_steps};
use self::group::ContactGroup;
use self::in_scene::{InScene, objects_of};
use self::lookahead::Lookahead;
pub(crate) use self::search::ByLevels;
use self::search::choose;
use self::touching::Patches;
use crate::contact::monitor::{ContactMonitor, MonitorFeed};
use crate::contact::proxy::{LevelFinder, Proxy};
use crate::contact::representative::FieldError;
use crate::contact::textures::{TextureError, Textures};
use crate::scene::Placed;
use crate::scene::SceneId;
use crate::scene::editor::{Edit, SceneEditor};
use crate::scene::object::Object;
use crate::settings::live::{ContactTuning, Ramp};
use crate::settings::{DetailSettings, SearchSettings, Settings};
use crate::telemetry::ContactTelemetry;

/// Scene objects that have a full workspace from the start. Those of further ones are made, or grow, when they are first
/// within reach.
const RESERVED: usize = 16;

/// Why there can be no contact loop.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ContactLoopError {
    #[error(transparent)]
    Texture(#[from] TextureError),
    #[error(transparent)]
    Field(#[from] FieldError),
}

/// What a contact step hands to the haptic loop.
#[derive(Clone, Copy, Debug)]
pub struct ContactUpdate {
    /// The linearised contacts.
    pub model: LinearContactModel,
    /// Time of the body state that the query saw, s; NaN before the first query.
    pub time: f64,
    /// Deepest penetration, m, by the contacts' planes; 0 when disjoint.
    pub depth: f64,
    /// Contacts found, before clustering.
    pub contacts: u32,
}

impl ContactUpdate {
    /// No contact, before any query.
    pub fn none() -> Self {
        Self {
            model: LinearContactModel::empty(&Pose::IDENTITY, f64::NAN),
            time: f64::NAN,
            depth: 0.0,
            contacts: 0,
        }
    }
}

/// The state of the contact loop, with the workspaces of its queries.
///
/// Contacts are clustered as the queries find them, between patches, and not made a
/// [contact set](palpate_collide::ContactSet) of before. That would leave few of those that are close to one another in
/// depth: of a face that rests flat on another one, the corner alone that is closest by a trace, as soon as it tilts, so
/// that the torque jumps; and contacts that fade in and out between levels of detail would not.
#[derive(Debug)]
pub struct ContactLoop {
    /// Centre of mass of the probe in its mesh's frame, m.
    center_of_mass: DVec3,
    scene: SceneQuery,
    proxy: Proxy,
    probe: Object,
    /// By their places in the query.
    objects: Vec<Option<InScene>>,
    /// Places of those that move, or can be moved, and how fast a point of those that are near moves at most, m/s.
    moving: Vec<usize>,
    fastest: f64,
    /// Changes that wait, where someone may make them, and the editor that makes them.
    edits: Option<Consumer<Edit>>,
    editor: Option<SceneEditor>,
    tunings: Option<Consumer<ContactTuning>>,
    /// Where gains and s₀ go over to.
    tuning: Option<Ramp<(ContactParameters, f64)>>,
    /// What textures are made with.
    all_settings: Settings,
    /// s₀, m; 0 for full resolution.
    error: f64,
    settings: QuerySettings,
    parameters: ContactParameters,
    /// Contacts with all scene objects that are not textured and do not move.
    still: ContactGroup,
    /// Where contacts are found in fields, or why they are not.
    by_fields: Option<Box<ByFields>>,
    by_levels: Option<ByLevels>,
    /// Where an object is textured.
    textures: Option<Textures>,
    braking: bool,
    /// Of the grasped object, kg.
    mass: f64,
    /// Bounding radius of the probe about its centre of mass, m.
    radius: f64,
    lookahead: Lookahead,
    /// Of the last step, s.
    time: f64,
    telemetry: ContactTelemetry,
    /// Where someone looks on, and what finds the patches that touch.
    monitored: Option<MonitorFeed>,
    patches: Patches,
}

impl ContactLoop {
    pub(crate) fn new(
        probe: &Object,
        body: Body,
        center_of_mass: DVec3,
        scene: &[Placed],
        parameters: ContactParameters,
        settings: &Settings,
    ) -> Result<Self, ContactLoopError> {
        let DetailSettings { error, interpolation, query_budget } = settings.detail;
        let SearchSettings { clusters, braking, proxy, .. } = settings.search;
        let radius = probe.bounding_radius() + probe.clod.source.center_of_mass.length();
        let mut query = SceneQuery::new(probe.shape());
        let objects: Vec<Option<InScene>> = (0..)
            .map(SceneId)
            .zip(scene)
            .map(|(id, Placed { object, pose })| {
                let handle = query.add(object.shape(), pose);
                Some(InScene::new(id, handle, object))
            })
            .collect();
        for (index, placed) in scene.iter().enumerate().take(RESERVED) {
            let same = |other: &&Placed| Arc::ptr_eq(&other.object.clod, &placed.object.clod);
            query.reserve(placed.object.shape(), scene[..=index].iter().filter(same).count());
        }
        let textures = Textures::new(probe, &objects_of(&objects), settings, parameters.tolerance, radius)?;
        let with_places = objects.iter().enumerate().filter_map(|(place, object)| {
            object.as_ref().map(|InScene { object, .. }| (place, object, place < RESERVED))
        });
        let (by_fields, by_levels) = match choose(probe, with_places, parameters.tolerance, settings)? {
            Ok(fields) => (Some(fields), None),
            Err(why) => (None, Some(why)),
        };
        let recesses = textures.as_ref().map_or_else(Vec::new, Textures::recesses);
        let objects_with_probe = std::iter::once(probe).chain(scene.iter().map(|placed| &placed.object));
        let error = if any_refined(objects_with_probe) { error } else { 0.0 };
        Ok(Self {
            center_of_mass,
            scene: query,
            proxy: Proxy::new(body, center_of_mass, radius, parameters.tolerance, recesses, proxy),
            probe: probe.clone(),
            objects,
            moving: Vec::new(),
            fastest: 0.0,
            edits: None,
            editor: None,
            tunings: None,
            tuning: None,
            all_settings: *settings,
            error,
            settings: query_settings(parameters.tolerance, error, interpolation, query_budget),
            parameters,
            still: ContactGroup::with_still(clusters, probe.bounding_radius()),
            by_fields,
            by_levels,
            textures,
            braking,
            mass: body.mass,
            radius,
            lookahead: Lookahead::new(braking || proxy, parameters.tolerance, radius),
            time: f64::NAN,
            telemetry: ContactTelemetry::default(),
            monitored: None,
            patches: Patches::new(),
        })
    }

    /// The distance tolerance d that contacts are looked for within, m.
    pub(crate) fn tolerance(&self) -> f64 {
        self.parameters.tolerance
    }

    /// Contacts for the grasped object's state at `time` (s). Allocates only while its workspaces grow to the scene's
    /// need.
    pub fn step(&mut self, body: &BodyState, time: f64) -> ContactUpdate {
        self.make_edits();
        let interval = time - std::mem::replace(&mut self.time, time);
        self.tune(interval);
        self.move_objects(body, time);
        let ahead = self.lookahead.horizon(interval);
        let tolerance = self.parameters.tolerance;
        let near = tolerance + self.textures.as_ref().map_or(0.0, Textures::protrusion);
        let lag = self.lookahead.limited_lag(self.proxy.lag());
        let motion = self.lookahead.motion_bound(&body.twist, self.fastest, ahead);
        let behind = if self.is_by_fields() { in_steps(lag, tolerance) } else { lag };
        // No further than queries look.
        let reach = (near + behind + motion).min(self.furthest());
        let report = match &mut self.by_fields {
            Some(by_fields) if self.textures.is_none() => {
                self.proxy.follow(&body.pose, &mut FieldFinder { by_fields, scene: &mut self.scene, reach })
            }
            _ => {
                let settings = QuerySettings { tolerance: reach, ..self.settings };
                self.proxy.follow(&body.pose, &mut LevelFinder { scene: &mut self.scene, settings })
            }
        };
        let events = &mut self.telemetry.events;
        events.contact_overflow += report.dropped as u64;
        events.contact_refused += u64::from(report.refused);
        events.not_converged += report.not_converged as u64;
        events.held_back += u64::from(*self.proxy.pose() != body.pose);
        let depths = self.proxy.contacts().map(|found| found.contact.contact.depth);
        self.lookahead.adapt((motion, lag), near, depths);
        self.sort(body, ahead);
        self.show_patches(time);
        let probe_pose = body.pose * Pose::from_translation(-self.center_of_mass);
        let mut model = LinearContactModel::empty(&body.pose, time);
        let braking = self.braking_parameters(ahead);
        if self.is_by_fields() {
            self.push_represented(&mut model, body, interval);
        } else {
            self.push_touching(&mut model, &probe_pose, interval);
        }
        let mut depth = self.groups().fold(0.0, |depth: f64, group| depth.max(group.deepest()));
        let coarse = self.push_textured(&mut model, &mut depth, body, &braking, interval, ahead);
        self.push_approaching(&mut model, &braking, (&probe_pose, interval), (reach, ahead));
        let events = &mut self.telemetry.events;
        events.contact_refused += u64::from(model.refused());
        events.contact_overflow += u64::from(model.overflow());
        if let Some(monitored) = &mut self.monitored {
            monitored.publish();
        }
        let contacts = self.groups().map(|group| group.touching.len()).sum::<usize>() + coarse;
        ContactUpdate { model, time, depth, contacts: contacts as u32 }
    }

    /// The groups of contacts: with all that stands still, and with each object that moves.
    fn groups(&self) -> impl Iterator<Item = &ContactGroup> {
        let moving =
            self.moving.iter().filter_map(|&place| Some(&self.objects[place].as_ref()?.moving.as_ref()?.1));
        std::iter::once(&self.still).chain(moving)
    }

    /// Whether contacts are found in fields.
    pub(crate) fn is_by_fields(&self) -> bool {
        self.by_fields.is_some() && self.textures.is_none()
    }

    /// How contacts are found: off by so much (m) in fields, or by levels, and why.
    pub(crate) fn search(&self) -> Result<f64, &ByLevels> {
        match (&self.by_levels, &self.by_fields) {
            (Some(why), _) => Err(why),
            _ if self.textures.is_some() => Err(&ByLevels::Texture),
            (None, Some(fields)) => Ok(fields.needs.error()),
            (None, None) => Err(&ByLevels::AskedFor),
        }
    }

    /// How far contacts can be looked for, m.
    fn furthest(&self) -> f64 {
        match &self.by_fields {
            Some(fields) if self.textures.is_none() => fields.furthest(),
            _ => self.probe.shape().max_tolerance(),
        }
    }

    pub(crate) fn set_tunings(&mut self, tunings: Consumer<ContactTuning>) {
        self.tunings = Some(tunings);
    }

    /// A monitor that shows the contacts in another thread, from the next step on. There may be several.
    pub fn contact_monitor(&mut self) -> ContactMonitor {
        match &mut self.monitored {
            Some(monitored) => monitored.add_monitor(),
            None => {
                let (monitored, monitor) = MonitorFeed::new();
                self.monitored = Some(monitored);
                monitor
            }
        }
    }

    /// Whether someone looks on.
    pub(crate) fn is_watched(&self) -> bool {
        self.monitored.is_some()
    }

    /// The detail that is left out, m; 0 where there is none, or full resolution is asked for.
    pub(crate) fn error(&self) -> f64 {
        self.error
    }

    /// What computes textured contacts; `None` without textures.
    pub(crate) fn texture_backend(&self) -> Option<&str> {
        self.textures.as_ref().map(Textures::backend)
    }

    pub(crate) fn set_texture_backend(&mut self, backend: Box<dyn Backend>) {
        if let Some(textures) = &mut self.textures {
            textures.set_backend(backend);
        }
    }

    /// Contacts of the last step with objects that are not textured, before clustering, world axes. Those found in fields are of no
    /// nodes ([`NO_NODE`](palpate_core::clod::NO_NODE)): the deepest places of each cell.
    pub fn contacts(&self) -> impl Iterator<Item = &PatchContact> {
        self.groups().flat_map(|group| &group.touching)
    }

    /// Memory that the workspaces of its queries hold, besides the objects' hierarchies: with their fields, where contacts are found
    /// in these.
    pub fn workspace_bytes(&self) -> usize {
        self.scene.bytes() + self.by_fields.as_ref().map_or(0, |fields| fields.bytes())
    }

    /// What was measured so far.
    pub fn telemetry(&self) -> &ContactTelemetry {
        &self.telemetry
    }

    pub(crate) fn telemetry_mut(&mut self) -> &mut ContactTelemetry {
        &mut self.telemetry
    }
}

/// Whether some have detail to leave out: where all are one hull, nothing is to be measured for it.
fn any_refined<'a>(mut objects: impl Iterator<Item = &'a Object>) -> bool {
    objects.any(|object| object.clod.levels.len() > 1)
}

/// What contacts are looked for with, within a tolerance (m).
fn query_settings(
    tolerance: f64,
    error: f64,
    interpolation: bool,
    query_budget: Option<f64>,
) -> QuerySettings {
    QuerySettings {
        error: error.into(),
        interpolate: interpolation && (error > 0.0 || query_budget.is_some()),
        budget: query_budget.map(|seconds| Budget::Time(Duration::from_secs_f64(seconds))),
        ..QuerySettings::new(tolerance)
    }
}
