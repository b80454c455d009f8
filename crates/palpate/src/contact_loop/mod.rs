//! The contact loop (§5.1.2): at the object's pose it finds what the haptic loop needs to hold the object by
//! [constraints](crate::constraints), and [penalty contacts](crate::penalties), linearised, with what is left
//! to those.

mod changes;
mod constraints;
pub(crate) mod monitor;
mod penalties;
mod snapshot;
mod stages;
mod state;
mod touching;

use std::time::Duration;

use palpate_collide::{Budget, PatchContact, QuerySettings};
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::{Body, BodyState, ContactParameters, LinearContactModel};
use palpate_texture_pd::Backend;
use rtrb::Consumer;

use self::state::{ConstraintSearch, Live, PenaltySearch, Shown, Timing};
use self::touching::Patches;
use crate::constraints::geometry::ContactGeometry;
use crate::constraints::guard::Guard;
use crate::constraints::pairs::Pairs;
pub use crate::constraints::pairs::Pull;
use crate::contact_loop::monitor::{ContactMonitor, MonitorFeed};
use crate::penalties::group::ContactGroup;
use crate::penalties::in_scene::{OnLoan, SceneObjects};
use crate::penalties::lookahead::Lookahead;
use crate::penalties::proxy::Proxy;
use crate::penalties::textures::{TextureError, Textures};
use crate::scene::Placed;
use crate::scene::object::Object;
pub(crate) use crate::search::ByLevels;
use crate::search::representative::FieldError;
use crate::search::{RESERVED, choose};
use crate::settings::live::ContactTuning;
use crate::settings::{DetailSettings, Response, SearchSettings, Settings};
use crate::telemetry::ContactTelemetry;

/// Error of making a contact loop.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ContactLoopError {
    #[error(transparent)]
    Texture(#[from] TextureError),
    #[error(transparent)]
    Field(#[from] FieldError),
}

/// Result of a contact step, for the haptic loop.
#[derive(Clone, Debug)]
pub struct ContactUpdate {
    /// The linearised contacts.
    pub model: LinearContactModel,
    /// Time of the body state that the query saw, s; NaN before the first query.
    pub time: f64,
    /// Largest penetration, m, by the planes of penalty contacts; 0 if disjoint.
    pub depth: f64,
    /// Number of penalty contacts found, before clustering.
    pub contacts: u32,
    /// What the haptic loop needs to hold the body out of surfaces, if contacts are constraints.
    pub(crate) geometry: Option<ContactGeometry>,
}

/// Guarded points that a contact step has found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guarded {
    /// Their number.
    pub points: usize,
    /// Largest motion of any point of the body up to which nothing else can be touched, m.
    pub room: f64,
}

impl ContactUpdate {
    /// An update with penalty contacts.
    pub fn new(model: LinearContactModel, time: f64, depth: f64, contacts: u32) -> Self {
        Self { model, time, depth, contacts, geometry: None }
    }

    /// What holds the body out of surfaces until the next contact step; `None` if all contacts are penalty
    /// contacts.
    pub fn guarded(&self) -> Option<Guarded> {
        self.geometry.as_ref().map(|found| Guarded { points: found.points.len(), room: found.bound.room })
    }

    /// No contact, before any query.
    pub fn none() -> Self {
        Self {
            model: LinearContactModel::empty(&Pose::IDENTITY, f64::NAN),
            time: f64::NAN,
            depth: 0.0,
            contacts: 0,
            geometry: None,
        }
    }
}

/// What has run in the steps so far.
#[derive(Clone, Copy, Debug, Default)]
struct Ran {
    /// Whether constraints were found, and penalty contacts searched for.
    constraints: bool,
    penalties: bool,
    /// Largest number of scene objects at once.
    objects: usize,
}

/// The state of the contact loop, with the workspaces of its queries.
///
/// The contacts between patches are clustered as the queries find them, without reducing them to a [contact
/// set](palpate_collide::ContactSet) first. A contact set keeps only local minima: when a face that rests
/// flat on another tilts slightly, only its lowest corner would remain and the torque would jump. Nor would
/// contacts fade in and out between levels of detail.
#[derive(Debug)]
pub struct ContactLoop {
    probe: Object,
    /// Centre of mass of the probe in its mesh's frame, m.
    center_of_mass: DVec3,
    /// Bounding radius of the probe about its centre of mass, m.
    radius: f64,
    /// Mass of the grasped object, kg.
    mass: f64,
    scene: SceneObjects,
    /// Settings that textures are rebuilt with.
    all_settings: Settings,
    /// s₀, m; 0 for full resolution.
    error: f64,
    parameters: ContactParameters,
    response: Response,
    /// Whether contacts may be constraints.
    may_constrain: bool,
    constraints: ConstraintSearch,
    penalties: PenaltySearch,
    /// Pending changes of the scene and of settings.
    live: Live,
    timing: Timing,
    telemetry: ContactTelemetry,
    /// What has run so far.
    ran: Ran,
    shown: Shown,
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
        if settings.contact.response == Response::Constraints {
            // Made now, since it takes longer than a step.
            let surfaces = std::iter::once(probe).chain(scene.iter().map(|placed| &placed.object));
            surfaces.for_each(|object| drop(object.features()));
        }
        let radius = probe.radius_about(center_of_mass);
        let objects = SceneObjects::new(probe, scene, RESERVED);
        let with_places = objects.by_place();
        let textures = Textures::new(probe, &with_places, settings, parameters.tolerance, radius)?;
        let by_fields = choose(probe, &with_places, parameters.tolerance, settings)?;
        let recesses = textures.as_ref().map_or_else(Vec::new, Textures::recesses);
        let error =
            if any_refined(objects.iter().map(|known| &known.object).chain([probe])) { error } else { 0.0 };
        Ok(Self {
            probe: probe.clone(),
            center_of_mass,
            radius,
            mass: body.mass,
            scene: objects,
            all_settings: *settings,
            error,
            parameters,
            response: settings.contact.response,
            may_constrain: true,
            constraints: ConstraintSearch { guard: Guard::new(), pairs: Pairs::default() },
            penalties: PenaltySearch {
                proxy: Proxy::new(body, center_of_mass, radius, parameters.tolerance, recesses, proxy),
                settings: query_settings(parameters.tolerance, error, interpolation, query_budget),
                still: ContactGroup::with_still(clusters, probe.bounding_radius()),
                by_fields,
                textures,
                braking,
                lookahead: Lookahead::new(braking || proxy, parameters.tolerance, radius),
            },
            live: Live::default(),
            timing: Timing::NONE,
            telemetry: ContactTelemetry::default(),
            ran: Ran { objects: scene.len(), ..Ran::default() },
            shown: Shown { monitored: None, patches: Patches::new() },
        })
    }

    /// The distance tolerance d, m.
    pub(crate) fn tolerance(&self) -> f64 {
        self.parameters.tolerance
    }

    /// Finds the contacts for the grasped object's state at `time` (s), where it is at rest in the hand or
    /// moves with it. Allocates only while the workspaces grow to the size that the scene needs.
    pub fn step(&mut self, body: &BodyState, time: f64) -> ContactUpdate {
        self.step_pulled(body, &Pull::default(), time)
    }

    /// The same for an object that the hand pulls ([`HapticLoop::pull`](crate::HapticLoop::pull)): without
    /// it, one that lags behind a fast hand near surfaces may wait for contacts.
    pub fn step_pulled(&mut self, body: &BodyState, pull: &Pull, time: f64) -> ContactUpdate {
        self.timing.pass(time);
        self.scene.on_loan.retain_mut(OnLoan::is_held);
        self.make_edits();
        self.tune(self.timing.interval);
        self.move_objects(body, time);
        let geometry = if self.response == Response::Constraints { self.guard(body, pull) } else { None };
        let guards_all = geometry.is_some() && self.guards_all();
        self.note(geometry.is_some(), !guards_all);
        let update = if guards_all {
            self.begin_snapshot(time);
            ContactUpdate::new(LinearContactModel::empty(&body.pose, time), time, 0.0, 0)
        } else {
            self.find_penalties(body, time)
        };
        if let Some(geometry) = &geometry {
            self.show_guarded(geometry, &(body.pose * Pose::from_translation(-self.center_of_mass)));
        }
        if let Some(monitored) = &mut self.shown.monitored {
            monitored.publish();
        }
        ContactUpdate { geometry, ..update }
    }

    /// The groups of contacts: that of all still objects, then those of each moving object.
    fn groups(&self) -> impl Iterator<Item = &ContactGroup> {
        std::iter::once(&self.penalties.still).chain(self.scene.groups())
    }

    /// Whether contacts are found in fields.
    pub(crate) fn is_by_fields(&self) -> bool {
        self.penalties.is_by_fields()
    }

    /// The error of contacts found in fields, m, or the reason why they are found by levels.
    pub(crate) fn search(&self) -> Result<f64, &ByLevels> {
        match &self.penalties.by_fields {
            Ok(_) if self.penalties.textures.is_some() => Err(&ByLevels::Texture),
            found => found.as_ref().map(|fields| fields.needs.error()),
        }
    }

    /// Renders all contacts as penalty contacts from now on.
    pub(crate) fn use_penalties(&mut self) {
        (self.response, self.may_constrain) = (Response::Penalty, false);
        self.all_settings.contact.response = Response::Penalty;
        if matches!(self.penalties.by_fields, Err(ByLevels::Constraints)) {
            let objects = self.scene.by_place();
            // It fails if the contact error is out of range, which was checked when the session was made.
            if let Ok(found) = choose(&self.probe, &objects, self.parameters.tolerance, &self.all_settings) {
                self.penalties.by_fields = found;
            }
        }
    }

    pub(crate) fn set_tunings(&mut self, tunings: Consumer<ContactTuning>) {
        self.live.tunings = Some(tunings);
    }

    /// Makes a monitor that receives the contacts in another thread, from the next step on. There may be
    /// several.
    pub fn contact_monitor(&mut self) -> ContactMonitor {
        match &mut self.shown.monitored {
            Some(monitored) => monitored.add_monitor(),
            None => {
                let (monitored, monitor) = MonitorFeed::new();
                self.shown.monitored = Some(monitored);
                monitor
            }
        }
    }

    /// Whether there is a contact monitor.
    pub(crate) fn is_watched(&self) -> bool {
        self.shown.monitored.is_some()
    }

    /// Error threshold s₀, m; 0 for full resolution.
    pub(crate) fn error(&self) -> f64 {
        self.error
    }

    /// Name of the backend of textured contacts; `None` without textures.
    pub(crate) fn texture_backend(&self) -> Option<&str> {
        self.penalties.textures.as_ref().map(Textures::backend)
    }

    pub(crate) fn set_texture_backend(&mut self, backend: Box<dyn Backend>) {
        if let Some(textures) = &mut self.penalties.textures {
            textures.set_backend(backend);
        }
    }

    /// Contacts of the last step with objects that are not textured, before clustering, world axes. Those
    /// found in fields are the deepest places of each cell and have no nodes
    /// ([`NO_NODE`](palpate_core::clod::NO_NODE)).
    pub fn contacts(&self) -> impl Iterator<Item = &PatchContact> {
        self.groups().flat_map(|group| &group.touching)
    }

    /// Memory that the query workspaces and the objects' fields hold, bytes; the objects' hierarchies are not
    /// counted.
    pub fn workspace_bytes(&self) -> usize {
        let fields = self.penalties.by_fields.as_ref().map_or(0, |fields| fields.bytes());
        self.scene.query.bytes() + self.constraints.pairs.bytes() + fields
    }

    /// Telemetry since the start.
    pub fn telemetry(&self) -> &ContactTelemetry {
        &self.telemetry
    }

    pub(crate) fn telemetry_mut(&mut self) -> &mut ContactTelemetry {
        &mut self.telemetry
    }
}

/// Whether some object has levels of detail; an object of one hull has no detail to leave out.
fn any_refined<'a>(mut objects: impl Iterator<Item = &'a Object>) -> bool {
    objects.any(|object| object.clod.levels.len() > 1)
}

/// Query settings for contacts within a tolerance (m).
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
