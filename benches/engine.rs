//! The engine's contact query between a probe and a scene object that stands at the origin.

use palpate::collide::{ContactQuery, PatchContact, QueryOutcome, QuerySettings};
use palpate::{Object, Pose};

/// A contact query with the objects that it is asked about.
#[derive(Clone, Debug)]
pub struct EngineQuery {
    /// Of both objects' hierarchies and shapes, which workspaces share.
    object_bytes: usize,
    query: ContactQuery,
    /// What each query asks for.
    pub settings: QuerySettings,
    /// Whether each query starts from the roots, rather than from the last one's front.
    pub cold: bool,
}

impl EngineQuery {
    /// A query for contacts within a tolerance (m), at full resolution.
    pub fn new(probe: &Object, scene: &Object, tolerance: f64) -> Self {
        let bytes = |object: &Object| object.clod.total_bytes() + object.shape().bytes();
        Self {
            object_bytes: bytes(probe) + bytes(scene),
            query: ContactQuery::new(probe.shape(), scene.shape()),
            settings: QuerySettings::new(tolerance),
            cold: false,
        }
    }

    /// Finds the contacts at a pose of the probe.
    pub fn run(&mut self, pose: &Pose) -> QueryOutcome {
        if self.cold {
            self.query.reset();
        }
        self.query.run(pose, &Pose::IDENTITY, &self.settings)
    }

    /// The contacts of the last query.
    pub fn contacts(&self) -> &[PatchContact] {
        self.query.contacts()
    }

    /// Bytes of memory that both objects and the workspace hold.
    pub fn bytes(&self) -> usize {
        self.object_bytes + self.query.bytes()
    }
}
