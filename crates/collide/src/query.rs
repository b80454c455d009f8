//! The contact query between two hierarchies (§3.4.1).

use palpate_core::{Clod, Contact, Pose};

/// What a query asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuerySettings {
    /// d: surfaces closer than this are in contact, m.
    pub tolerance: f64,
    /// Never allocate: contacts beyond the reserved capacity are dropped and [`QueryOutcome::overflow`] is set.
    pub fixed_capacity: bool,
}

impl QuerySettings {
    /// Settings with a tolerance (d, m) and defaults for the rest.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, fixed_capacity: false }
    }
}

/// A contact, and the pair of leaf patches that it was found between.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchContact {
    /// The contact, in world axes.
    pub contact: Contact,
    /// Node of the probe's hierarchy.
    pub probe_node: u32,
    /// Node of the scene object's hierarchy.
    pub scene_node: u32,
}

/// What a query found and what it cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QueryOutcome {
    /// Number of contacts reported.
    pub contacts: usize,
    /// Smallest separation distance found within the tolerance, m; 0 when something penetrates, `None` without contacts.
    pub smallest_distance: Option<f64>,
    /// Largest depth, m: negative when all contacts are separated; `None` without contacts.
    pub deepest: Option<f64>,
    /// Pairs of nodes visited.
    pub visited: usize,
    /// Convex queries made.
    pub convex_queries: usize,
    /// Convex queries that did not converge.
    pub not_converged: usize,
    /// Whether contacts were dropped for want of capacity.
    pub overflow: bool,
    /// Whether a buffer had to grow during this query.
    pub reallocated: bool,
}

/// The workspace of a contact query.
#[derive(Clone, Debug)]
pub struct ContactQuery {
    contacts: Vec<PatchContact>,
}

impl ContactQuery {
    /// A workspace for queries between two hierarchies.
    pub fn new(probe: &Clod, scene: &Clod) -> Self {
        let _ = (probe, scene);
        Self { contacts: Vec::new() }
    }

    /// Finds the contacts between the probe and the scene object at the given poses (object frame to world).
    pub fn run(
        &mut self,
        probe: &Clod,
        probe_pose: &Pose,
        scene: &Clod,
        scene_pose: &Pose,
        settings: &QuerySettings,
    ) -> QueryOutcome {
        let _ = (probe, probe_pose, scene, scene_pose, settings);
        self.contacts.clear();
        QueryOutcome::default()
    }

    /// The contacts of the last query, in world axes.
    pub fn contacts(&self) -> &[PatchContact] {
        &self.contacts
    }
}
