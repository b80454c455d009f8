//! The engine's contact query between a probe and a scene object that stands at the origin, and its contact
//! set.

use std::sync::Arc;

use palpate::collide::{
    ContactQuery, ContactSet, ContactSetSettings, PatchContact, QueryOutcome, QuerySettings,
};
use palpate::core::clod::Node;
use palpate::{Object, Pose};
use palpate_field::AreaContact;

use crate::method::Method;

/// Contact query with its objects.
#[derive(Clone, Debug)]
pub struct EngineQuery {
    /// Size of both objects' hierarchies and shapes, which workspaces share.
    object_bytes: usize,
    /// Areas of the nodes' patches, of the probe and of the scene object, m².
    areas: [Arc<[f64]>; 2],
    query: ContactQuery,
    outcome: QueryOutcome,
    /// Settings of each query.
    pub settings: QuerySettings,
    /// Whether each query starts from the roots, rather than from the last one's front.
    pub cold: bool,
}

impl EngineQuery {
    /// Returns a query for contacts within a tolerance (m), at full resolution.
    pub fn new(probe: &Object, scene: &Object, tolerance: f64) -> Self {
        Self {
            object_bytes: object_bytes(probe, scene),
            areas: [probe, scene].map(patch_areas),
            query: ContactQuery::new(probe.shape(), scene.shape()),
            outcome: QueryOutcome::default(),
            settings: QuerySettings::new(tolerance),
            cold: false,
        }
    }

    /// Returns the contacts of the last query.
    pub fn contacts(&self) -> &[PatchContact] {
        self.query.contacts()
    }

    fn append(&self, contacts: &[PatchContact], found: &mut Vec<AreaContact>) {
        let [probe, scene] = &self.areas;
        found.extend(contacts.iter().map(|c| {
            let area = probe[c.probe_node as usize].min(scene[c.scene_node as usize]);
            AreaContact { contact: c.contact, area: c.weight * area }
        }));
    }

    /// Returns the result and the cost of the last query.
    pub fn outcome(&self) -> &QueryOutcome {
        &self.outcome
    }
}

impl Method for EngineQuery {
    fn run(&mut self, pose: &Pose) {
        if self.cold {
            self.query.reset();
        }
        self.outcome =
            self.query.run(pose, &Pose::IDENTITY, &self.settings).expect("valid poses and settings");
    }

    fn append_contacts(&self, _: &Pose, found: &mut Vec<AreaContact>) {
        self.append(self.contacts(), found);
    }

    /// Includes both objects and the workspace.
    fn bytes(&self) -> usize {
        self.object_bytes + self.query.bytes()
    }
}

fn object_bytes(probe: &Object, scene: &Object) -> usize {
    [probe, scene].map(|object| object.clod.total_bytes() + object.shape().bytes()).iter().sum()
}

fn patch_areas(object: &Object) -> Arc<[f64]> {
    let clod = &object.clod;
    let area = |node: Node| {
        let hull = clod.hull(&node);
        let triangles = clod.patch(&node).iter().map(|triangle| triangle.map(|v| hull[v as usize]));
        triangles.map(|[a, b, c]| (b - a).cross(c - a).length() / 2.0).sum()
    };
    clod.nodes().map(area).collect()
}

/// Query with the contact set of its contacts.
#[derive(Clone, Debug)]
pub struct EngineSet {
    query: EngineQuery,
    set: ContactSet,
    settings: ContactSetSettings,
}

impl EngineSet {
    /// Returns a query with a set of one contact per region of intersection, or more at the noticeable
    /// spacing, and with separated contacts merged within the query's tolerance.
    pub fn new(mut query: EngineQuery, probe: &Object, scene: &Object, spaced: bool) -> Self {
        let set = ContactSet::new(probe.shape(), scene.shape());
        let mut settings = ContactSetSettings::new(query.settings.tolerance);
        if spaced {
            settings.spacing = set.noticeable_spacing();
        }
        // Contact sets add to the objects' shapes.
        query.object_bytes = object_bytes(probe, scene);
        Self { query, set, settings }
    }
}

impl Method for EngineSet {
    fn run(&mut self, pose: &Pose) {
        self.query.run(pose);
        self.set
            .run(self.query.contacts(), pose, &Pose::IDENTITY, &self.settings)
            .expect("valid poses and settings");
    }

    fn append_contacts(&self, _: &Pose, found: &mut Vec<AreaContact>) {
        self.query.append(self.set.contacts(), found);
    }

    fn bytes(&self) -> usize {
        self.query.bytes() + self.set.bytes()
    }
}
