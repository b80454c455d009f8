//! The contact loop (§5.1.2): query the scene at the object's pose, cluster the contacts, linearise their response.

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
pub(crate) mod textures;
mod touching;

use std::sync::Arc;
use std::time::Duration;

use palpate_collide::{Budget, Cluster, PatchContact, QuerySettings, SceneQuery};
use palpate_core::glam::DVec3;
use palpate_core::{Contact, Pose, Twist};
use palpate_dynamics::{
    Body, BodyState, ContactClass, ContactParameters, ContactPatch, FoundContact, LinearContactModel,
    MovingBody,
};
use palpate_texture_pd::Backend;
use rtrb::Consumer;

use self::by_fields::{ByFields, FieldSearch, in_steps};
use self::group::{ContactGroup, Counterpart};
use self::in_scene::{InScene, objects_of};
use self::lookahead::Lookahead;
pub(crate) use self::search::ByLevels;
use self::search::choose;
use self::touching::Patches;
use crate::contact::merging::Plane;
use crate::contact::monitor::{ContactForce, ContactMonitor, MonitorFeed, TouchingPatches};
use crate::contact::proxy::{Found, LevelSearch, Proxy, carried, motion_between};
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
        let followed = match &mut self.by_fields {
            Some(by_fields) if self.textures.is_none() => {
                self.proxy.follow(&body.pose, &mut FieldSearch { by_fields, scene: &mut self.scene, reach })
            }
            _ => {
                let settings = QuerySettings { tolerance: reach, ..self.settings };
                self.proxy.follow(&body.pose, &mut LevelSearch { scene: &mut self.scene, settings })
            }
        };
        let events = &mut self.telemetry.events;
        events.contact_overflow += followed.dropped as u64;
        events.contact_refused += u64::from(followed.refused);
        events.not_converged += followed.not_converged as u64;
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

    /// Adds the planes of representative contacts to a model.
    fn push_represented(&mut self, model: &mut LinearContactModel, body: &BodyState, interval: f64) {
        let Some(fields) = &mut self.by_fields else { return };
        let to_mesh = Pose::from_translation(-self.center_of_mass);
        let poses = (self.proxy.pose(), &body.pose);
        let tolerance = self.parameters.tolerance;
        let objects = (&mut self.still, self.objects.as_mut_slice(), self.moving.as_slice());
        let planes = fields.planes(poses, self.proxy.lag(), &to_mesh, tolerance, &mut self.scene, objects);
        let count_of = |place: Option<usize>| planes.iter().filter(|(of, _)| *of == place).count();
        for &(place, Plane { contact, weight, radius }) in planes {
            let gains = shared(&self.parameters, weight);
            let patch = ContactPatch { contact, radius };
            let with = counterpart(&self.objects, &self.scene, place);
            let count = place.map_or(1, |_| count_of(place));
            let gains = with.gains(&gains, (contact.point, contact.normal), count, interval);
            model.push(ContactClass::Touching, patch, &gains, &with.body());
            if let Some(monitored) = &mut self.monitored {
                let force = contact.normal * (-gains.stiffness * (contact.depth + tolerance));
                let Contact { point, normal, depth, .. } = contact;
                monitored.snapshot().add_force(ContactForce { point, normal, force, depth });
            }
        }
    }

    /// Goes over to what the loop is tuned to, in the time (s) since the last step.
    fn tune(&mut self, interval: f64) {
        while let Some(tuning) = self.tunings.as_mut().and_then(|tunings| tunings.pop().ok()) {
            let ContactTuning { parameters, error, interpolation, query_budget } = tuning;
            let objects = self.objects.iter().flatten().map(|object| &object.object);
            let error = if any_refined(objects.chain([&self.probe])) { error } else { 0.0 };
            // On the way to full resolution levels still go over into one another.
            let coarsest = error.max(self.error);
            self.settings = query_settings(parameters.tolerance, coarsest, interpolation, query_budget);
            if let Some(fields) = &mut self.by_fields {
                fields.needs.set_budget(query_budget);
            }
            self.tuning = Some(Ramp::new((self.parameters, self.error), (parameters, error)));
        }
        if let Some(ramp) = &mut self.tuning {
            let ((parameters, error), ended) = ramp.advance(interval);
            (self.parameters, self.error) = (parameters, error);
            self.settings.error = error.into();
            if ended {
                self.settings.interpolate &= error > 0.0 || self.settings.budget.is_some();
                self.tuning = None;
            }
        }
    }

    pub(crate) fn set_tunings(&mut self, tunings: Consumer<ContactTuning>) {
        self.tunings = Some(tunings);
    }

    /// Moves the objects that move on to a time (s).
    fn move_objects(&mut self, body: &BodyState, time: f64) {
        self.fastest = 0.0;
        for &place in &self.moving {
            let Some(InScene { handle, object, moving: Some(moving), .. }) = &mut self.objects[place] else {
                continue;
            };
            let Some(pose) = moving.0.advance(time) else { continue };
            let Some(before) = self.scene.pose(*handle).copied() else { continue };
            if before == pose {
                continue;
            }
            self.scene.set_pose(*handle, &pose);
            if let Some(fields) = &mut self.by_fields {
                fields.scene_has_changed();
            }
            let size = object.bounding_radius();
            if pose.translation.distance(body.pose.translation)
                < size + self.radius + self.lookahead.outlook()
            {
                self.proxy.object_has_moved(place, &before, &pose);
                let Twist { linear, angular } = moving.0.twist();
                self.fastest = self.fastest.max(linear.length() + angular.length() * size);
            }
        }
    }

    /// Adds the contacts of all groups within d to a model.
    fn push_touching(&mut self, model: &mut LinearContactModel, probe_pose: &Pose, interval: f64) {
        let Self { objects, scene, moving, still, monitored, parameters, .. } = self;
        let mut show = |cluster: &Cluster, gains: &ContactParameters| show(monitored, cluster, gains);
        let at = (probe_pose, interval);
        still.push_touching(model, &Counterpart::Still, parameters, at, &mut show);
        for &place in moving.iter() {
            if let Some((with, group)) = moving_group(objects, scene, place) {
                group.push_touching(model, &with, parameters, at, &mut show);
            }
        }
    }

    /// Adds the contacts of all groups that the body comes at to a model.
    fn push_approaching(
        &mut self,
        model: &mut LinearContactModel,
        braking: &ContactParameters,
        at: (&Pose, f64),
        ahead: (f64, f64),
    ) {
        let Self { objects, scene, moving, still, .. } = self;
        still.push_approaching(model, &Counterpart::Still, braking, at, ahead);
        for &place in moving.iter() {
            if let Some((with, group)) = moving_group(objects, scene, place) {
                group.push_approaching(model, &with, braking, at, ahead);
            }
        }
    }

    /// Adds contacts with textured objects to a model, and their depth; how many coarse ones there are.
    fn push_textured(
        &mut self,
        model: &mut LinearContactModel,
        depth: &mut f64,
        body: &BodyState,
        braking: &ContactParameters,
        interval: f64,
        ahead: f64,
    ) -> usize {
        let Some(textures) = &mut self.textures else { return 0 };
        let tolerance = self.parameters.tolerance;
        textures.clear();
        let mut coarse = 0;
        for found in self.proxy.found() {
            coarse += usize::from(textures.take(found.object, &found.contact, tolerance));
        }
        let pose = *self.proxy.pose();
        let mesh = pose * Pose::from_translation(-self.center_of_mass);
        let object_at = |place: usize| self.objects.get(place)?.as_ref();
        let pose_of = |place: usize| self.scene.pose(object_at(place)?.handle).copied();
        let events = &mut self.telemetry.events;
        let motion = motion_between(&pose, &body.pose);
        for found in textures.run(&mesh, pose.translation, pose_of, tolerance, events) {
            let now = found.depth_after(&motion);
            let with = counterpart(&self.objects, &self.scene, Some(found.object));
            let gains = |gains: &ContactParameters| {
                let at = (found.contact.point, found.contact.linear.normalize_or_zero());
                with.gains(&shared(gains, found.share), at, 1, interval)
            };
            let moving_body = with.body();
            let twist = beside(&body.twist, pose.translation, &moving_body);
            let curved = FoundContact::Curved(&found.contact, &pose);
            if now > -tolerance {
                *depth = depth.max(now);
                let missed = found.is_undersampled(&twist, pose.translation, interval);
                events.texture_undersampled += u64::from(missed);
                if let Some(monitored) = &mut self.monitored {
                    let force =
                        found.contact.linear * (-self.parameters.stiffness * found.share * (now + tolerance));
                    let normal = found.contact.linear.normalize_or_zero();
                    let point = found.contact.point;
                    monitored.snapshot().add_force(ContactForce { point, normal, force, depth: now });
                }
                model.push(ContactClass::Touching, curved, &gains(&self.parameters), &moving_body);
            } else if self.braking && now + found.rate(&twist) * ahead > -tolerance {
                let class = ContactClass::Approaching { braking_time: ahead };
                model.push(class, curved, &gains(braking), &moving_body);
            }
        }
        coarse
    }

    /// Sorts the proxy's contacts, as they hold the body, into those that are closed, or within d, and those that the body
    /// comes at; those with objects that move, by object.
    fn sort(&mut self, body: &BodyState, ahead: f64) {
        let tolerance = self.parameters.tolerance;
        self.still.clear();
        for &place in &self.moving {
            if let Some(InScene { moving: Some(moving), .. }) = &mut self.objects[place] {
                moving.1.clear();
            }
        }
        let textured = |object| self.textures.as_ref().is_some_and(|textures| textures.has(object));
        for found in self.proxy.contacts().filter(|found| !textured(found.object)) {
            let contact = carried(&found.contact.contact, self.proxy.pose(), &body.pose);
            let patch = PatchContact { contact, ..found.contact };
            let (with, group) = match moving_group(&mut self.objects, &self.scene, found.object) {
                Some(moving) => moving,
                None => (Counterpart::Still, &mut self.still),
            };
            if contact.depth > -tolerance {
                group.touching.push(patch);
            } else if self.braking && comes_within(&contact, body, &with.body(), tolerance, ahead) {
                group.add_approaching(patch);
            }
        }
    }

    /// Gains of contacts that brake in `time` (s): damping that takes all of a body's speed in a tenth of it.
    fn braking_parameters(&self, time: f64) -> ContactParameters {
        let damping = if time > 0.0 { 10.0 * self.mass / time } else { 0.0 };
        ContactParameters { damping: damping.max(self.parameters.damping), ..self.parameters }
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

    /// Begins to show what is seen at a time (s), with the patches that touch, of textured objects the coarse ones; those of
    /// representatives where the deepest are.
    fn show_patches(&mut self, time: f64) {
        let is_by_fields = self.is_by_fields();
        let Some(monitored) = &mut self.monitored else { return };
        let snapshot = monitored.begin(time);
        let is_near = |found: &&Found| found.contact.contact.depth > -self.parameters.tolerance;
        if !is_by_fields {
            for found in self.proxy.contacts().filter(is_near) {
                let PatchContact { probe_node, scene_node, weight, .. } = found.contact;
                let object = self.objects.get(found.object).and_then(Option::as_ref);
                let object = object.map_or(found.object, |object| object.id.0);
                snapshot.add_patches(TouchingPatches { object, probe_node, scene_node, weight });
            }
            return;
        }
        self.patches.choose(self.proxy.contacts().filter(is_near));
        let probe = (*self.proxy.pose() * Pose::from_translation(-self.center_of_mass)).inverse();
        for index in 0..self.patches.deepest.len() {
            let Found { contact: PatchContact { contact, .. }, object } = self.patches.deepest[index];
            let Some(Some(InScene { id, handle, object, .. })) = self.objects.get(object) else { continue };
            let Some(scene) = self.scene.pose(*handle) else { continue };
            let own = self.patches.leaf_at(&self.probe.clod, probe.transform_point(contact.point));
            let at = scene.inverse().transform_point(contact.scene_point);
            let other = self.patches.leaf_at(&object.clod, at);
            if let (Some(probe_node), Some(scene_node)) = (own, other) {
                snapshot.add_patches(TouchingPatches { object: id.0, probe_node, scene_node, weight: 1.0 });
            }
        }
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

/// A share of a contact's gains.
fn shared(parameters: &ContactParameters, share: f64) -> ContactParameters {
    let ContactParameters { stiffness, damping, .. } = *parameters;
    ContactParameters { stiffness: stiffness * share, damping: damping * share, ..*parameters }
}

/// Whether a contact comes within a distance (m) in a time (s) if the body and what it is with move on as they do.
fn comes_within(contact: &Contact, body: &BodyState, object: &MovingBody, distance: f64, time: f64) -> bool {
    let arm = contact.point - body.pose.translation;
    let velocity = body.twist.velocity_at(arm) - object.twist.velocity_at(contact.point);
    let rate = velocity.dot(contact.normal);
    contact.depth + rate * time > -distance
}

/// The motion of a body, whose reference point is at `center` (m), beside an object.
fn beside(twist: &Twist, center: DVec3, object: &MovingBody) -> Twist {
    Twist {
        linear: twist.linear - object.twist.velocity_at(center),
        angular: twist.angular - object.twist.angular,
    }
}

/// The scene's side of contacts with the object at a place; still where there is none.
fn counterpart<'a>(
    objects: &'a [Option<InScene>],
    scene: &SceneQuery,
    place: Option<usize>,
) -> Counterpart<'a> {
    let moving = || {
        let InScene { id, handle, moving, .. } = objects.get(place?)?.as_ref()?;
        Some(Counterpart::Moving { object: &moving.as_ref()?.0, id: *id, pose: *scene.pose(*handle)? })
    };
    moving().unwrap_or(Counterpart::Still)
}

/// The contacts with the object at a place, and the scene's side of them; none if it stands still.
fn moving_group<'a>(
    objects: &'a mut [Option<InScene>],
    scene: &SceneQuery,
    place: usize,
) -> Option<(Counterpart<'a>, &'a mut ContactGroup)> {
    let InScene { id, handle, moving, .. } = objects.get_mut(place)?.as_mut()?;
    let (object, group) = moving.as_deref_mut()?;
    Some((Counterpart::Moving { object, id: *id, pose: *scene.pose(*handle)? }, group))
}

/// Shows the force of a cluster to whoever looks on.
fn show(monitored: &mut Option<MonitorFeed>, cluster: &Cluster, gains: &ContactParameters) {
    let Some(monitored) = monitored else { return };
    let Contact { point, normal, depth, .. } = cluster.contact;
    let force = normal * (-gains.stiffness * (depth + gains.tolerance));
    monitored.snapshot().add_force(ContactForce { point, normal, force, depth });
}
