//! Representative contacts of palpate: integrals over the area of contact, in distance fields of both bodies.

use std::sync::Arc;

use palpate::Pose;
use palpate_field::{AreaContact, FieldBody, FieldOutcome, FieldQuery, FieldSettings};

use crate::method::Method;
use crate::reference::LAW_REACH;

/// Query for representative contacts.
pub struct Representative {
    probe: Arc<FieldBody>,
    scene: Arc<FieldBody>,
    query: FieldQuery,
    settings: FieldSettings,
    /// Whether each query starts anew, rather than from what the last one found to be out of reach.
    pub cold: bool,
}

impl Representative {
    /// Returns a query between two bodies.
    pub fn new(probe: Arc<FieldBody>, scene: Arc<FieldBody>, settings: FieldSettings) -> Self {
        let query = FieldQuery::new(&probe, &scene, LAW_REACH);
        Self { probe, scene, query, settings, cold: false }
    }

    /// Returns the cost of the last query.
    pub fn outcome(&self) -> FieldOutcome {
        self.query.outcome()
    }
}

impl Method for Representative {
    fn run(&mut self, pose: &Pose) {
        if self.cold {
            self.query.reset();
        }
        self.query.run(&self.probe, &self.scene, pose, &Pose::IDENTITY, &self.settings);
    }

    fn append_contacts(&self, pose: &Pose, found: &mut Vec<AreaContact>) {
        self.query.append_contacts(&self.probe, pose, found);
    }

    fn error(&self) -> Option<f64> {
        Some(self.outcome().error)
    }

    fn bytes(&self) -> usize {
        self.probe.bytes() + self.scene.bytes() + self.query.bytes()
    }
}
