//! The contact query Q(A, B, d) between two hierarchies (§3.4.1, §3.4.2).
//!
//! Both hierarchies are descended in tandem. A pair of nodes stays where it is when its bounding spheres, or
//! then its hulls, are further apart than d + h(a) + h(b) (Eq. 3.5); otherwise one of them is split, down to
//! pairs whose missing detail is below the threshold s₀ ([`refinement`]), which are examined for contacts.
//! With a threshold, the node with the coarser children is split (§3.4.2). At full resolution (s₀ = 0) it is
//! the larger node, down to pairs of leaves. By §3.4.1, their contacts are a superset of the local minima of
//! the distance if the objects are disjoint, and local penetration depths if they overlap. Only surfaces that
//! meet make contacts: an object wholly inside another, deeper than the thickness of the other's patches, has
//! none. A [contact set](crate::ContactSet) and [`Containment`](crate::Containment) find that it is inside.
//!
//! A query starts from the [front] of the last one (§3.4.2), raised and lowered in place. The answer is that
//! of a query from the roots: a pair is skipped only while the bodies have not moved enough to change its
//! answer, or its hulls are still apart along the [axis](separating_axis) that separated them before, and
//! searches that start from old nearest points find the same ones. With a threshold, the two were seen
//! to end at different levels for one pair in some thousand poses; the reason is not known.
//!
//! The [descent] passes pairs that may have contacts to a sink: they are examined [at once](immediate), after
//! the descent on several threads ([`deferred`]), or in the order of their urgency until a budget is spent
//! ([`budgeted`]).
//!
//! At full resolution the contacts are those of all patches within reach, which are not spread evenly over
//! the area of contact. This is for inspection, and for measuring the error of a threshold. In real time,
//! allow an error: with 2.5 % of the probe's radius a query takes a twenty-fifth to two thirds of the time.
//!
//! With a threshold, the contacts are those between the surfaces of coarser levels, each within s of the
//! mesh. Contacts can be interpolated from one level to the next as s* nears s₀ (§3.4.4), and a time-critical
//! query refines the pairs with the largest s*/s₀ first, until its budget is spent.
//!
//! Departures: hulls of many points are not tested above the leaves; hull queries there only decide whether a
//! pair is within reach, and stop as soon as either bound on the distance decides it; nodes with a single
//! child are skipped if they are refined anyway. In §3.4.2 every node of the front is
//! tested in every query.

mod bodies;
mod budgeted;
mod context;
mod deferred;
mod descent;
mod front;
mod immediate;
mod metrics;
mod outcome;
mod overlap;
mod patch_query;
mod refinement;
mod separating_axis;
mod settings;
mod triangles;

use palpate_core::Pose;

use self::bodies::Bodies;
use self::budgeted::Budgeted;
use self::context::Tracking;
use self::deferred::Deferred;
use self::descent::Descent;
use self::immediate::Immediate;
use self::outcome::Report;
use crate::contact::PatchContact;
use crate::error::{QueryError, QueryObject};
use crate::shape::Shape;

pub use self::metrics::{Combination, ErrorMetrics, VelocityMetric, ViewMetric};
pub use self::outcome::{MAX_CONTACTS, QueryOutcome};
pub use self::settings::{Budget, QuerySettings};

/// Number of contacts that a new workspace has room for.
const CONTACTS: usize = 1 << 14;

/// Number of pairs of nodes that a new workspace has room for.
const PAIRS: usize = 1 << 15;

/// Largest number of pairs of nodes, on and above the front, that a workspace keeps, some 0.6 GB. Further
/// ones are tested again in every query ([`QueryOutcome::front_overflow`]): the answer is the same, but takes
/// longer.
pub const MAX_PAIRS: usize = 1 << 22;

/// The workspace of a contact query between two objects. It keeps the front of the last query, from which the
/// next one starts: keep one workspace for each pair of objects, and run it at pose after pose.
///
/// ```
/// use palpate_collide::{ContactQuery, QueryError, QuerySettings, Shape};
/// use palpate_core::Pose;
/// use palpate_core::glam::DVec3;
///
/// # use palpate_clod_build::{BuildOptions, build, unwatched};
/// # use palpate_core::TriMesh;
/// # let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)) * 0.1;
/// # let cube = TriMesh::new((0..8).map(corner).collect(), vec![
/// #     [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
/// #     [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
/// # ])?;
/// # let tips = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z].map(|tip| 0.05 * tip);
/// # let octahedron = TriMesh::new(tips.to_vec(), vec![
/// #     [0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5],
/// # ])?;
/// # let shape_of = |mesh: &TriMesh| build(mesh, &BuildOptions::default(), &mut unwatched).map(Shape::new);
/// # let (octahedron, cube) = (shape_of(&octahedron)?, shape_of(&cube)?);
/// // An octahedron, 50 mm from centre to tip, comes down on a cube whose top is at z = 100 mm.
/// let mut query = ContactQuery::new(&octahedron, &cube);
/// let settings = QuerySettings::new(0.002);
/// let at = |height: f64| Pose::from_translation(DVec3::new(0.04, 0.05, 0.15 + height));
/// for step in 0..100 {
///     let height = 0.005 - 1e-4 * f64::from(step);
///     let outcome = query.run(&at(height), &Pose::IDENTITY, &settings)?;
///     match outcome.deepest {
///         None => assert!(height > 0.002, "no contact within the tolerance"),
///         Some(depth) => assert!((depth + height).abs() < 1e-9),
///     }
/// }
///
/// // A query with invalid settings is an error, and the next query works again.
/// let most = octahedron.max_tolerance();
/// let refused = query.run(&at(0.0), &Pose::IDENTITY, &QuerySettings::new(1.0));
/// assert_eq!(refused, Err(QueryError::Tolerance { given: 1.0, most }));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct ContactQuery {
    descent: Descent,
    tracking: Tracking,
    deferred: Deferred,
    budgeted: Budgeted,
    report: Report,
}

impl ContactQuery {
    /// A workspace for queries between two objects.
    pub fn new(probe: &Shape, scene: &Shape) -> Self {
        Self::with_capacity(probe, scene, CONTACTS, PAIRS)
    }

    /// A workspace with initial room for a number of contacts, and of pairs of nodes on and above the front.
    pub fn with_capacity(probe: &Shape, scene: &Shape, contacts: usize, pairs: usize) -> Self {
        let bodies = Bodies { probe: probe.clone(), scene: scene.clone() };
        Self {
            descent: Descent::new(bodies, pairs.clamp(1, MAX_PAIRS), MAX_PAIRS),
            tracking: Tracking::default(),
            deferred: Deferred::default(),
            // At most all pairs of the front wait.
            budgeted: Budgeted::with_capacity(pairs),
            report: Report::with_capacity(contacts),
        }
    }

    /// Memory held by the workspace, bytes.
    pub fn bytes(&self) -> usize {
        self.descent.bytes()
            + self.deferred.bytes()
            + self.budgeted.bytes()
            + self.report.contacts.capacity() * size_of::<PatchContact>()
    }

    /// Discards the front: the next query starts from the roots.
    pub fn reset(&mut self) {
        self.tracking.reset();
    }

    /// Finds the contacts between the probe and the scene object at the given poses (object frame to world).
    ///
    /// The cost grows with the number of pairs of patches within the tolerance, and with the motion of the
    /// objects since the last query.
    ///
    /// # Errors
    /// If a pose is not valid, or the tolerance or an error metric is out of bounds. There are no
    /// contacts then, and the next query continues from the last one that succeeded.
    pub fn run(
        &mut self,
        probe_pose: &Pose,
        scene_pose: &Pose,
        settings: &QuerySettings,
    ) -> Result<QueryOutcome, QueryError> {
        self.report.clear();
        QueryError::check_pose(probe_pose, QueryObject::Probe)?;
        QueryError::check_pose(scene_pose, QueryObject::Scene)?;
        let Bodies { probe, scene } = &self.descent.bodies;
        settings.check(probe)?;
        let (context, update) = self.tracking.advance([probe, scene], [probe_pose, scene_pose], settings);
        let capacities = self.capacities();
        let Self { descent, deferred, budgeted, report, .. } = self;
        descent.begin(update, context.exact);
        match settings.budget {
            Some(budget) => budgeted.run(budget, descent, report, &context),
            None if settings.parallel => deferred.run(descent, report, &context),
            None => descent.run(&mut Immediate(report), &context),
        }
        descent.add_costs(&mut report.outcome);
        self.report.outcome.reallocated = self.capacities() != capacities;
        Ok(self.report.outcome)
    }

    /// Capacities of all buffers, which show whether one has grown.
    fn capacities(&self) -> ([usize; 4], [usize; 3]) {
        let Self { descent, deferred, budgeted, report, .. } = self;
        (descent.capacities(), [deferred.bytes(), budgeted.capacity(), report.contacts.capacity()])
    }

    /// The contacts of the last query, in world axes, in the order of the descent.
    pub fn contacts(&self) -> &[PatchContact] {
        &self.report.contacts
    }
}
