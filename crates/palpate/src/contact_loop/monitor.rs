//! Snapshots of the contacts for a window or a host's debug view, while the session runs.
//!
//! They go through a triple buffer, where the latest wins: the contact loop neither waits for a monitor nor
//! allocates for one.

use arrayvec::ArrayVec;
use palpate_core::Clod;
use palpate_core::glam::DVec3;
use palpate_dynamics::MAX_CONSTRAINTS;

/// Largest number of patches and of forces in a snapshot; further ones are left out.
const CAPACITY: usize = 512;

/// Two patches that touch, or are within the tolerance of each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchingPatches {
    /// The scene object, by the number of its [`SceneId`](crate::SceneId).
    pub object: usize,
    /// The probe's patch: a node of its hierarchy, whose level says at which resolution it is felt.
    pub probe_node: u32,
    /// The scene object's patch: a node of its hierarchy.
    pub scene_node: u32,
    /// Weight of the contact, 0 to 1; finer patches have the rest.
    pub weight: f64,
}

/// Force on the probe of a cluster of contacts, of a textured contact, or of a constraint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactForce {
    /// Point of the contact on the probe's surface, m; world axes.
    pub point: DVec3,
    /// Unit normal of the contact, out of the probe; world axes. For a textured contact, the direction in
    /// which the depth grows fastest as the probe moves.
    pub normal: DVec3,
    /// Force on the probe, N; world axes. A penalty force is k(δ + d) along −`normal`, without damping and
    /// friction; that of a constraint has its friction.
    pub force: DVec3,
    /// Penetration depth δ, m; negative where the surfaces are apart.
    pub depth: f64,
}

/// Contacts of one contact step.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactSnapshot {
    /// Time of the body state that the contacts are for, s; NaN before the first.
    pub time: f64,
    /// The patches that touch.
    pub patches: Vec<TouchingPatches>,
    /// The forces on the probe.
    pub forces: Vec<ContactForce>,
}

impl Default for ContactSnapshot {
    /// Empty, with room for all that a snapshot may hold.
    fn default() -> Self {
        Self { time: f64::NAN, patches: Vec::with_capacity(CAPACITY), forces: Vec::with_capacity(CAPACITY) }
    }
}

impl ContactSnapshot {
    /// Clears the snapshot for the contacts at `time` (s).
    fn clear(&mut self, time: f64) {
        self.time = time;
        self.patches.clear();
        self.forces.clear();
    }

    fn copy_from(&mut self, other: &Self) {
        self.clear(other.time);
        self.patches.extend_from_slice(&other.patches);
        self.forces.extend_from_slice(&other.forces);
    }

    /// Adds patches, if there is room.
    pub(crate) fn add_patches(&mut self, patches: TouchingPatches) {
        if self.patches.len() < CAPACITY {
            self.patches.push(patches);
        }
    }

    /// Adds a force, if there is room.
    pub(crate) fn add_force(&mut self, force: ContactForce) {
        if self.forces.len() < CAPACITY {
            self.forces.push(force);
        }
    }
}

/// Colour of a level's patches, from red for the full mesh to blue for the coarsest level that can be felt.
/// Red, green, blue and opacity, 0 to 255.
pub fn level_color(clod: &Clod, level: u32) -> [u8; 4] {
    let coarsest = clod.levels.iter().rposition(|level| !level.free).unwrap_or(0).max(1);
    let hue = 4.0 * (f64::from(level) / coarsest as f64).clamp(0.0, 1.0);
    // Red, yellow, green, cyan, blue.
    let channel = |peak: f64| ((2.0 - (hue - peak).abs()).clamp(0.0, 1.0) * 255.0).round() as u8;
    [channel(0.0), channel(2.0), channel(4.0), 255]
}

/// Forces on the probe of the constraints of one haptic step.
pub(crate) type ConstraintForces = ArrayVec<ContactForce, MAX_CONSTRAINTS>;

/// Receives the contacts of a session in any thread. Made by
/// [`HapticRenderer::contact_monitor`](crate::HapticRenderer::contact_monitor).
#[derive(Debug)]
pub struct ContactMonitor {
    contacts: triple_buffer::Output<ContactSnapshot>,
    /// Forces of constraints, which the haptic loop finds.
    constraints: Option<triple_buffer::Output<ConstraintForces>>,
    /// The latest of both.
    latest: ContactSnapshot,
}

impl ContactMonitor {
    fn new(contacts: triple_buffer::Output<ContactSnapshot>) -> Self {
        Self { contacts, constraints: None, latest: ContactSnapshot::default() }
    }

    /// Also receives the forces of constraints.
    pub(crate) fn with_constraints(self, forces: triple_buffer::Output<ConstraintForces>) -> Self {
        Self { constraints: Some(forces), ..self }
    }

    /// The latest snapshot.
    pub fn latest(&mut self) -> &ContactSnapshot {
        let Self { contacts, constraints, latest } = self;
        latest.copy_from(contacts.read());
        if let Some(constraints) = constraints {
            constraints.read().iter().for_each(|force| latest.add_force(*force));
        }
        latest
    }
}

/// The contact loop's end, with a buffer for each monitor. A snapshot is written to the first and copied to
/// the others.
#[derive(Debug)]
pub(crate) struct MonitorFeed {
    first: triple_buffer::Input<ContactSnapshot>,
    others: Vec<triple_buffer::Input<ContactSnapshot>>,
}

impl MonitorFeed {
    pub fn new() -> (Self, ContactMonitor) {
        let (first, output) = triple_buffer::TripleBuffer::default().split();
        (Self { first, others: Vec::new() }, ContactMonitor::new(output))
    }

    /// Adds a monitor.
    pub fn add_monitor(&mut self) -> ContactMonitor {
        let (input, output) = triple_buffer::TripleBuffer::default().split();
        self.others.push(input);
        ContactMonitor::new(output)
    }

    /// Begins a snapshot at `time` (s).
    pub fn begin(&mut self, time: f64) -> &mut ContactSnapshot {
        let snapshot = self.first.input_buffer_mut();
        snapshot.clear(time);
        snapshot
    }

    /// The snapshot that is being written.
    pub fn snapshot(&mut self) -> &mut ContactSnapshot {
        self.first.input_buffer_mut()
    }

    /// Publishes the snapshot.
    pub fn publish(&mut self) {
        let Self { first, others } = self;
        let seen = first.input_buffer_mut();
        for other in others {
            let copy = other.input_buffer_mut();
            copy.copy_from(seen);
            other.publish();
        }
        first.publish();
    }
}
