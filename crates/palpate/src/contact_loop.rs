//! The contact loop (§5.1.2): query the scene at the object's pose, cluster the contacts, linearise their response.

use palpate_collide::{Clustering, ContactQuery, PatchContact, QuerySettings};
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::{BodyState, ContactParameters, LinearContactModel};

use crate::object::Object;
use crate::scene::Placed;
use crate::telemetry::ContactTelemetry;

/// What a contact step hands to the haptic loop.
#[derive(Clone, Copy, Debug)]
pub struct ContactUpdate {
    /// The linearised contacts.
    pub model: LinearContactModel,
    /// Time of the body state that the query saw, s; NaN before the first query.
    pub time: f64,
    /// Deepest penetration, m; 0 when disjoint.
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
#[derive(Debug)]
pub struct ContactLoop {
    /// Centre of mass of the probe in its mesh's frame, m.
    center_of_mass: DVec3,
    scene: Vec<(Placed, ContactQuery)>,
    settings: QuerySettings,
    parameters: ContactParameters,
    /// Contacts with all scene objects.
    contacts: Vec<PatchContact>,
    clustering: Clustering,
    telemetry: ContactTelemetry,
}

impl ContactLoop {
    pub(crate) fn new(
        probe: &Object,
        center_of_mass: DVec3,
        scene: &[Placed],
        parameters: ContactParameters,
        error: f64,
        clusters: usize,
    ) -> Self {
        let scene = scene
            .iter()
            .map(|placed| (placed.clone(), ContactQuery::new(probe.shape(), placed.object.shape())))
            .collect();
        Self {
            center_of_mass,
            scene,
            settings: QuerySettings {
                error: error.into(),
                interpolate: error > 0.0,
                ..QuerySettings::new(parameters.tolerance)
            },
            parameters,
            contacts: Vec::new(),
            clustering: Clustering::new(clusters),
            telemetry: ContactTelemetry::default(),
        }
    }

    /// Contacts for the grasped object's state at `time` (s). Allocates only while its workspaces grow to the scene's
    /// need.
    pub fn step(&mut self, body: &BodyState, time: f64) -> ContactUpdate {
        let probe_pose = body.pose * Pose::from_translation(-self.center_of_mass);
        self.contacts.clear();
        let mut depth: f64 = 0.0;
        for (placed, query) in &mut self.scene {
            let outcome = query.run(&probe_pose, &placed.pose, &self.settings);
            depth = depth.max(outcome.deepest.unwrap_or(0.0));
            self.telemetry.events.contact_overflow += u64::from(outcome.overflow);
            self.telemetry.events.contact_refused += u64::from(outcome.refused);
            self.telemetry.events.not_converged += outcome.not_converged as u64;
            self.contacts.extend_from_slice(query.contacts());
        }
        let clusters = self.clustering.run(&self.contacts, self.parameters.tolerance, &probe_pose);
        let representatives = clusters.iter().map(|cluster| cluster.contact);
        let model = LinearContactModel::from_contacts(representatives, &body.pose, &self.parameters, time);
        self.telemetry.events.contact_refused += u64::from(model.refused());
        ContactUpdate { model, time, depth, contacts: self.contacts.len() as u32 }
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
