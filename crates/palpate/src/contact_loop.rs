//! The contact loop (§5.1.2): query the scene at the object's pose, cluster the contacts, linearise their response.

use std::sync::Arc;

use palpate_collide::{Cluster, Clustering, ObjectHandle, PatchContact, QuerySettings, SceneQuery};
use palpate_core::glam::DVec3;
use palpate_core::{Contact, Pose};
use palpate_dynamics::{
    Body, BodyState, ContactParameters, ContactPatch, LinearContactModel, MAX_APPROACHING,
};

use crate::object::Object;
use crate::proxy::{Proxy, carried};
use crate::scene::Placed;
use crate::settings::Settings;
use crate::telemetry::ContactTelemetry;

/// Scene objects that have a full workspace from the start. Those of further ones are made, or grow, when they are first
/// within reach.
const RESERVED: usize = 16;

/// Approaching contacts are looked for as far as the body comes in this many intervals between queries: one passes before
/// a query's answer is in use, another while it goes over to it, and one more before the next.
const INTERVALS: f64 = 4.0;

/// The longest interval that is reckoned with, s, and the furthest way, in radii of the probe.
const LONGEST_INTERVAL: f64 = 0.02;
const FURTHEST: f64 = 0.5;

/// How far the query looks ahead goes in steps of this, in tolerances.
const STEP: f64 = 0.25;

/// Contacts further apart than d are to be no more than this, or than those within d, so that looking ahead costs no
/// more than the contacts themselves. How far the query looks is halved where they are more, and grows by as much where it
/// is not far enough and they are not.
const FAR_CONTACTS: usize = 64;
const GROWTH: f64 = 1.01;

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
    /// In the scene's order.
    objects: Vec<ObjectHandle>,
    settings: QuerySettings,
    parameters: ContactParameters,
    /// Contacts with all scene objects.
    contacts: Vec<PatchContact>,
    clustering: Clustering,
    /// Contacts further apart than d that the body comes at, and their clusters.
    approaching: Vec<PatchContact>,
    approaching_clusters: Clustering,
    braking: bool,
    /// Whether contacts further away than d matter.
    looks_ahead: bool,
    /// Of the grasped object, kg.
    mass: f64,
    /// Bounding radius of the probe about its centre of mass, m.
    radius: f64,
    /// How much further than d the query may look, m.
    outlook: f64,
    /// Of the last step, s.
    time: f64,
    telemetry: ContactTelemetry,
}

impl ContactLoop {
    pub(crate) fn new(
        probe: &Object,
        body: Body,
        center_of_mass: DVec3,
        scene: &[Placed],
        parameters: ContactParameters,
        settings: &Settings,
    ) -> Self {
        let Settings { error, clusters, braking, proxy, .. } = *settings;
        let radius = probe.bounding_radius() + probe.clod.source.center_of_mass.length();
        let mut query = SceneQuery::new(probe.shape());
        let objects = scene.iter().map(|placed| query.add(placed.object.shape(), &placed.pose)).collect();
        for (index, placed) in scene.iter().enumerate().take(RESERVED) {
            let same = |other: &&Placed| Arc::ptr_eq(&other.object.clod, &placed.object.clod);
            query.reserve(placed.object.shape(), scene[..=index].iter().filter(same).count());
        }
        Self {
            center_of_mass,
            scene: query,
            proxy: Proxy::new(body, center_of_mass, radius, parameters.tolerance, proxy),
            objects,
            settings: QuerySettings {
                error: error.into(),
                interpolate: error > 0.0,
                ..QuerySettings::new(parameters.tolerance)
            },
            parameters,
            contacts: Vec::new(),
            clustering: Clustering::new(clusters),
            approaching: Vec::new(),
            approaching_clusters: Clustering::new(MAX_APPROACHING),
            braking,
            looks_ahead: braking || proxy,
            mass: body.mass,
            radius,
            outlook: FURTHEST * radius,
            time: f64::NAN,
            telemetry: ContactTelemetry::default(),
        }
    }

    /// Contacts for the grasped object's state at `time` (s). Allocates only while its workspaces grow to the scene's
    /// need.
    pub fn step(&mut self, body: &BodyState, time: f64) -> ContactUpdate {
        let ahead = self.time_ahead(time);
        let tolerance = self.parameters.tolerance;
        let settings = QuerySettings { tolerance: tolerance + self.way(body, ahead), ..self.settings };
        let followed = self.proxy.follow(&body.pose, &settings, &mut self.scene);
        let events = &mut self.telemetry.events;
        events.contact_overflow += u64::from(followed.overflow);
        events.contact_refused += u64::from(followed.refused);
        events.not_converged += followed.not_converged as u64;
        events.held_back += u64::from(*self.proxy.pose() != body.pose);
        self.adapt_outlook(settings.tolerance - tolerance);
        self.sort(body, ahead);
        let depth = self.contacts.iter().fold(0.0, |most: f64, found| most.max(found.contact.depth));

        let probe_pose = body.pose * Pose::from_translation(-self.center_of_mass);
        let clusters = self.clustering.run(&self.contacts, tolerance, &probe_pose);
        let representatives =
            clusters.iter().map(|&Cluster { contact, radius, .. }| ContactPatch { contact, radius });
        let model = LinearContactModel::from_contacts(representatives, &body.pose, &self.parameters, time);
        let braking = self.braking_parameters(ahead);
        let clusters = self.approaching_clusters.run(&self.approaching, settings.tolerance, &probe_pose);
        let representatives = clusters.iter().map(|cluster| cluster.contact);
        let model = model.with_approaching(representatives, &braking, ahead);
        self.telemetry.events.contact_refused += u64::from(model.refused());
        ContactUpdate { model, time, depth, contacts: self.contacts.len() as u32 }
    }

    /// Sorts the proxy's contacts, as they hold the body, into those that are closed, or within d, and those that the body
    /// comes at.
    fn sort(&mut self, body: &BodyState, ahead: f64) {
        let tolerance = self.parameters.tolerance;
        self.contacts.clear();
        self.approaching.clear();
        for found in self.proxy.contacts() {
            let contact = carried(&found.contact, self.proxy.pose(), &body.pose);
            let found = PatchContact { contact, ..*found };
            if contact.depth > -tolerance {
                self.contacts.push(found);
            } else if self.braking && comes_within(&contact, body, tolerance, ahead) {
                self.approaching.push(found);
            }
        }
    }

    /// How far ahead contacts are looked for, s: none where nothing asks for them.
    fn time_ahead(&mut self, time: f64) -> f64 {
        let interval = time - std::mem::replace(&mut self.time, time);
        if self.looks_ahead && interval > 0.0 { INTERVALS * interval.min(LONGEST_INTERVAL) } else { 0.0 }
    }

    /// Gains of contacts that brake in `time` (s): damping that takes all of a body's speed in a tenth of it.
    fn braking_parameters(&self, time: f64) -> ContactParameters {
        let damping = if time > 0.0 { 10.0 * self.mass / time } else { 0.0 };
        ContactParameters { damping: damping.max(self.parameters.damping), ..self.parameters }
    }

    /// At least how far any point of the body comes in a time (s), m, as far as the query looks ahead at all, and in whole
    /// steps, so that its reach seldom changes.
    fn way(&self, body: &BodyState, time: f64) -> f64 {
        let speed = body.twist.linear.length() + body.twist.angular.length() * self.radius;
        let step = STEP * self.parameters.tolerance;
        let way = (speed * time).min(self.outlook);
        if way > step { (way / step).ceil() * step } else { 0.0 }
    }

    /// Looks less far ahead next time if too much was found further than d apart, within so much more (m), or further
    /// again if that was as far as it looks.
    fn adapt_outlook(&mut self, ahead: f64) {
        let tolerance = self.parameters.tolerance;
        let found = self.proxy.contacts().count();
        let near = self.proxy.contacts().filter(|found| found.contact.depth > -tolerance).count();
        if found - near > near.max(FAR_CONTACTS) {
            self.outlook = (0.5 * ahead).max(STEP * tolerance);
        } else if ahead >= self.outlook {
            self.outlook = (GROWTH * self.outlook).min(FURTHEST * self.radius);
        }
    }

    /// Moves a scene object, by its place in [`Scene::objects`](crate::Scene::objects), to a pose of its mesh's frame in the
    /// world, from the next step on; `false` if there is none. Contacts are rendered as if the object stood still there:
    /// its velocity does not enter into damping.
    pub fn set_pose(&mut self, object: usize, pose: &Pose) -> bool {
        self.proxy.scene_has_changed();
        self.objects.get(object).is_some_and(|object| self.scene.set_pose(*object, pose))
    }

    /// Contacts of the last step, before clustering, world axes.
    pub fn contacts(&self) -> &[PatchContact] {
        &self.contacts
    }

    /// What was measured so far.
    pub fn telemetry(&self) -> &ContactTelemetry {
        &self.telemetry
    }

    pub(crate) fn telemetry_mut(&mut self) -> &mut ContactTelemetry {
        &mut self.telemetry
    }
}

/// Whether a contact comes within a distance (m) in a time (s) if the body moves on as it does.
fn comes_within(contact: &Contact, body: &BodyState, distance: f64, time: f64) -> bool {
    let arm = contact.point - body.pose.translation;
    let rate = body.twist.velocity_at(arm).dot(contact.normal);
    contact.depth + rate * time > -distance
}
