//! One probe against many placed objects: a broad phase finds the objects that may be within reach, and each
//! of those gets its [contact query](crate::ContactQuery).
//!
//! An object is within reach if its bounding sphere, and its box in its own axes, come within the tolerance
//! of the probe's bounding sphere. The gap to that is the distance that the probe and the object have to move
//! together before the object has to be tested again. The probe's motion is added up once for all objects,
//! and an object that is moved is due for a recheck earlier by its motion. A run tests only objects that are
//! due. They come first in a [heap](recheck_queue), so that the others cost nothing while nothing moves, and
//! each object that is moved costs the logarithm of their number.
//!
//! A tree of boxes would have to be descended in every run, to find the same objects as before, and refitted
//! for every object that moves. With 10,000 instances, of which every tenth moves, a run takes less time in
//! all than refitting and querying parry's tree (f64), and no measurable time while nothing moves; only a
//! probe that jumps across the scene makes all objects due at once, for 0.7 ms (`cargo bench -p
//! palpate-benches --bench broad_phase`). `obvhs`, the broad phase of other crates here, has boxes in f32,
//! which would have to be widened.
//!
//! Only objects within reach hold a workspace. An object that leaves returns it for others of the same shape,
//! of which there may be thousands.

mod bounds;
mod kinds;
mod recheck_queue;

use std::time::Instant;

use palpate_core::Pose;
use palpate_core::glam::DVec3;

use self::bounds::{Placed, probe_motion};
use self::kinds::{Kind, Workspace};
use self::recheck_queue::RecheckQueue;
use crate::ball::Ball;
use crate::contact::PatchContact;
use crate::error::{QueryError, QueryObject};
use crate::query::{Budget, ContactQuery, QueryOutcome, QuerySettings};
use crate::shape::Shape;
use crate::tolerances::{SCENE_MOTION_LIMIT, UNIT_QUATERNION_SLACK};

/// Number of contacts that a workspace has room for when it is made during a run.
const CONTACTS: usize = 64;

/// Number of pairs of nodes that a workspace has room for when it is made during a run.
const PAIRS: usize = 256;

/// Handle of an object of a [`SceneQuery`]. Handles are in the order of the objects' contacts, and are not
/// reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ObjectHandle {
    slot: u32,
    generation: u32,
}

impl ObjectHandle {
    /// The object's place among those of its query, in the order in which they were added. The place of a
    /// removed object goes to the next one.
    pub fn place(&self) -> usize {
        self.slot as usize
    }
}

/// The contacts with one object.
#[derive(Clone, Copy, Debug)]
pub struct ObjectContacts<'a> {
    /// The object.
    pub object: ObjectHandle,
    /// Contacts with it, as in [`ContactQuery::contacts`].
    pub contacts: &'a [PatchContact],
    /// Results and costs of its query.
    pub outcome: &'a QueryOutcome,
}

/// Results and costs of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SceneOutcome {
    /// All queries together: sums, largest values, the smallest distance, and flags that were set in any.
    pub query: QueryOutcome,
    /// Number of objects that the broad phase tested: those that were due for a recheck.
    pub tested: usize,
    /// Number of objects within reach, each of which got a query.
    pub queried: usize,
    /// Number of objects without a query because their pose is not [valid](Pose::is_valid). They are tested
    /// again in every run.
    pub invalid: usize,
}

/// Contact queries of one probe with many objects.
///
/// Adding objects and reserving workspaces allocates. A run allocates only when more objects of a shape are
/// within reach at once than ever before, or a workspace needs more memory than ever before.
///
/// ```
/// use palpate_collide::{QuerySettings, SceneQuery, Shape};
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
/// // A row of cubes, 100 mm wide, 1 m apart; the octahedron's tip is 1 mm inside the third.
/// let mut scene = SceneQuery::new(&octahedron);
/// let cubes: Vec<_> =
///     (0..1000).map(|x| scene.add(&cube, &Pose::from_translation(DVec3::X * f64::from(x)))).collect();
/// let probe_pose = Pose::from_translation(DVec3::new(2.04, 0.05, 0.149));
/// let outcome = scene.run(&probe_pose, &QuerySettings::new(0.002))?;
/// assert_eq!((outcome.queried, outcome.invalid), (1, 0));
/// for with in scene.contacts() {
///     assert_eq!(with.object, cubes[2]);
///     assert!(with.contacts.iter().any(|found| (found.contact.depth - 0.001).abs() < 1e-9));
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct SceneQuery {
    probe: Shape,
    kinds: Vec<Kind>,
    /// Objects by slot.
    objects: Vec<Object>,
    /// Slots of objects that were removed.
    vacant: Vec<u32>,
    queue: RecheckQueue,
    /// Slots of the objects that are due for a recheck.
    due: Vec<u32>,
    /// Slots of the objects that got a query in the last run.
    in_reach: Vec<u32>,
    /// Slots of the objects that were within reach in the last call of [`find_near`](Self::find_near).
    near: Vec<u32>,
    /// Centre of the probe's sphere, m, and tolerance, m, of the last run.
    last: Option<(DVec3, f64)>,
    /// Bound on the approach of objects at rest by the probe's motion, m.
    motion_bound: f64,
}

#[derive(Clone, Debug)]
struct Object {
    placed: Placed,
    /// Index into [`SceneQuery::kinds`].
    kind: u32,
    workspace: Option<Box<Workspace>>,
    generation: u32,
    /// Whether the object is in the scene.
    present: bool,
}

impl SceneQuery {
    /// Queries of a probe with an empty scene.
    pub fn new(probe: &Shape) -> Self {
        Self {
            probe: probe.clone(),
            kinds: Vec::new(),
            objects: Vec::new(),
            vacant: Vec::new(),
            queue: RecheckQueue::default(),
            due: Vec::new(),
            in_reach: Vec::new(),
            near: Vec::new(),
            last: None,
            motion_bound: 0.0,
        }
    }

    /// Adds an object at a pose (object frame to world). Objects of the same shape share it and their
    /// workspaces.
    pub fn add(&mut self, shape: &Shape, pose: &Pose) -> ObjectHandle {
        let index = self.kind(shape);
        let kind = &mut self.kinds[index];
        kind.objects += 1;
        let object = Object {
            placed: Placed::new(pose, kind),
            kind: index as u32,
            workspace: None,
            generation: 0,
            present: true,
        };
        let slot = self.vacant.pop().unwrap_or(self.objects.len() as u32);
        match self.objects.get_mut(slot as usize) {
            Some(old) => *old = Object { generation: old.generation.wrapping_add(1), ..object },
            None => self.objects.push(object),
        }
        let count = self.objects.len();
        self.queue.reserve(count);
        for list in [&mut self.due, &mut self.in_reach, &mut self.near] {
            list.reserve(count.saturating_sub(list.len()));
        }
        self.queue.set(slot, f64::NEG_INFINITY);
        ObjectHandle { slot, generation: self.objects[slot as usize].generation }
    }

    /// Removes an object; `false` if it does not exist. Its workspace is kept for others of its shape; with
    /// the last of them, the shape is removed as well.
    pub fn remove(&mut self, object: ObjectHandle) -> bool {
        if self.find(object).is_none() {
            return false;
        }
        self.queue.remove(object.slot);
        self.give_back(object.slot);
        let Object { present, kind, .. } = &mut self.objects[object.slot as usize];
        *present = false;
        let kind = *kind;
        self.vacant.push(object.slot);
        self.kinds[kind as usize].objects -= 1;
        if self.kinds[kind as usize].objects == 0 {
            self.drop_kind(kind);
        }
        true
    }

    /// Removes a shape that no object has; the last one takes its place.
    fn drop_kind(&mut self, kind: u32) {
        self.kinds.swap_remove(kind as usize);
        let moved = self.kinds.len() as u32;
        for object in self.objects.iter_mut().filter(|object| object.kind == moved) {
            object.kind = kind;
        }
    }

    /// Moves an object to a pose (object frame to world); `false` if it does not exist. While its pose is not
    /// [valid](Pose::is_valid), runs leave the object out and [count](SceneOutcome::invalid) it.
    pub fn set_pose(&mut self, object: ObjectHandle, pose: &Pose) -> bool {
        if self.find(object).is_none() {
            return false;
        }
        let Object { placed, kind, .. } = &mut self.objects[object.slot as usize];
        let kind = &self.kinds[*kind as usize];
        let moved = Placed::new(pose, kind);
        let recheck_at = placed.recheck_after_move(self.queue.recheck_at(object.slot), &moved, kind);
        let known = placed.pose.is_valid() && pose.is_valid() && recheck_at.is_finite();
        *placed = moved;
        self.queue.set(object.slot, if known { recheck_at } else { f64::NEG_INFINITY });
        true
    }

    /// Pose of an object (object frame to world), if it exists.
    pub fn pose(&self, object: ObjectHandle) -> Option<&Pose> {
        self.find(object).map(|found| &found.placed.pose)
    }

    /// Shape of an object, if it exists.
    pub fn shape(&self, object: ObjectHandle) -> Option<&Shape> {
        self.find(object).map(|found| &self.kinds[found.kind as usize].shape)
    }

    /// Number of objects.
    pub fn len(&self) -> usize {
        self.objects.len() - self.vacant.len()
    }

    /// Whether there are no objects.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Makes workspaces, as large as those of [`ContactQuery::new`], for a number of objects of a shape that
    /// are within reach at once.
    pub fn reserve(&mut self, shape: &Shape, objects: usize) {
        let kind = self.kind(shape);
        let kind = &mut self.kinds[kind];
        while kind.workspaces < objects {
            kind.add_workspace(ContactQuery::new(&self.probe, shape));
        }
    }

    /// Discards the results of earlier runs: the next run tests all objects and starts every query from the
    /// roots.
    pub fn reset(&mut self) {
        self.last = None;
        for workspace in self.objects.iter_mut().filter_map(|object| object.workspace.as_mut()) {
            workspace.query.reset();
        }
    }

    /// Memory held, bytes, without the shapes.
    pub fn bytes(&self) -> usize {
        let held = self.objects.iter().filter_map(|object| object.workspace.as_ref());
        let lists = [&self.due, &self.in_reach, &self.near, &self.vacant].map(Vec::capacity);
        held.map(|workspace| workspace.bytes()).sum::<usize>()
            + self.kinds.iter().map(Kind::bytes).sum::<usize>()
            + self.objects.capacity() * size_of::<Object>()
            + self.queue.bytes()
            + lists.iter().sum::<usize>() * size_of::<u32>()
    }

    /// Finds the contacts of the probe at a pose (object frame to world) with all objects.
    ///
    /// A budget is for all queries together: each gets an equal share of the rest that those before it left.
    ///
    /// # Errors
    /// If the probe's pose is not valid, or the tolerance or an error metric is out of bounds. There are no
    /// contacts then. An object whose own pose is not valid is left out and [counted](SceneOutcome::invalid).
    pub fn run(&mut self, probe_pose: &Pose, settings: &QuerySettings) -> Result<SceneOutcome, QueryError> {
        let mut outcome = SceneOutcome::default();
        self.in_reach.clear();
        QueryError::check_pose(probe_pose, QueryObject::Probe)?;
        settings.check(&self.probe)?;
        self.find_in_reach(probe_pose, settings.tolerance, &mut outcome);
        self.hand_out(&mut outcome);
        let begun = Instant::now();
        for (index, slot) in self.in_reach.iter().enumerate() {
            let Object { placed, workspace: Some(workspace), .. } = &mut self.objects[*slot as usize] else {
                continue;
            };
            let left = self.in_reach.len() - index;
            let budget = settings.budget.map(|budget| match budget {
                Budget::Time(time) => Budget::Time(time.saturating_sub(begun.elapsed()) / left as u32),
                Budget::Queries(queries) => {
                    Budget::Queries(queries.saturating_sub(outcome.query.convex_queries) / left)
                }
            });
            let settings = QuerySettings { budget, ..*settings };
            workspace.outcome = workspace.query.run(probe_pose, &placed.pose, &settings)?;
            outcome.query.add(&workspace.outcome);
        }
        outcome.queried = self.in_reach.len();
        Ok(outcome)
    }

    /// Finds the objects within reach of the probe at a pose (object frame to world) without queries, for
    /// callers that find contacts by other means. There are [no contacts](Self::contacts) then. Returns the
    /// number of objects that are left out because their pose is not valid. The tolerance may be as large as
    /// any distance (m).
    ///
    /// # Errors
    /// If the probe's pose is not valid, or the tolerance is negative or not finite.
    pub fn find_near(&mut self, probe_pose: &Pose, tolerance: f64) -> Result<usize, QueryError> {
        self.in_reach.clear();
        self.near.clear();
        QueryError::check_pose(probe_pose, QueryObject::Probe)?;
        if !(0.0..f64::INFINITY).contains(&tolerance) {
            return Err(QueryError::Tolerance { given: tolerance, most: f64::MAX });
        }
        let mut outcome = SceneOutcome::default();
        self.find_in_reach(probe_pose, tolerance, &mut outcome);
        std::mem::swap(&mut self.in_reach, &mut self.near);
        Ok(outcome.invalid)
    }

    /// The objects within reach in the last call of [`find_near`](Self::find_near), by handle.
    pub fn near(&self) -> impl Iterator<Item = ObjectHandle> {
        self.near.iter().map(|slot| self.handle(*slot))
    }

    /// The objects that got a query in the last run, including those without contacts, with their contacts,
    /// by handle.
    pub fn contacts(&self) -> impl Iterator<Item = ObjectContacts<'_>> {
        self.in_reach.iter().filter_map(|slot| {
            let Workspace { query, outcome } = self.objects[*slot as usize].workspace.as_deref()?;
            Some(ObjectContacts { object: self.handle(*slot), contacts: query.contacts(), outcome })
        })
    }

    /// Lists the objects within reach, and stores when the others are due again.
    fn find_in_reach(&mut self, probe_pose: &Pose, tolerance: f64, outcome: &mut SceneOutcome) {
        let Ball { center, radius } = self.probe.ball();
        let center = probe_pose.transform_point(center);
        let last = self.last.replace((center, tolerance));
        self.motion_bound += last.map_or(f64::INFINITY, |last| probe_motion(last, (center, tolerance)));
        // Restart the bound before the rounding of the sum matters.
        if self.motion_bound.is_nan() || self.motion_bound > SCENE_MOTION_LIMIT * radius {
            self.motion_bound = 0.0;
            self.queue.recheck_all();
        }
        self.due.clear();
        self.queue.due(self.motion_bound, &mut self.due);
        outcome.tested = self.due.len();
        let reach = radius + tolerance + UNIT_QUATERNION_SLACK * self.probe.coordinates();
        for index in 0..self.due.len() {
            let slot = self.due[index];
            let object = &self.objects[slot as usize];
            let invalid = !object.placed.pose.is_valid();
            let gap = object.placed.gap(&self.kinds[object.kind as usize], center, reach);
            let out_of_reach = gap > 0.0 && !invalid;
            let recheck_at = if out_of_reach { self.motion_bound + gap } else { f64::NEG_INFINITY };
            if recheck_at != self.queue.recheck_at(slot) {
                self.queue.set(slot, recheck_at);
            }
            outcome.invalid += usize::from(invalid);
            if out_of_reach || invalid {
                self.give_back(slot);
            } else {
                self.in_reach.push(slot);
            }
        }
        self.in_reach.sort_unstable();
    }

    /// Gives all objects within reach a workspace.
    fn hand_out(&mut self, outcome: &mut SceneOutcome) {
        let Self { objects, kinds, probe, in_reach, .. } = self;
        for slot in in_reach {
            let object = &mut objects[*slot as usize];
            if object.workspace.is_some() {
                continue;
            }
            let kind = &mut kinds[object.kind as usize];
            if kind.spare.is_empty() {
                outcome.query.reallocated = true;
                kind.add_workspace(ContactQuery::with_capacity(probe, &kind.shape, CONTACTS, PAIRS));
            }
            object.workspace = kind.spare.pop();
            if let Some(workspace) = &mut object.workspace {
                workspace.query.reset();
            }
        }
    }

    /// Returns an object's workspace to the spare ones.
    fn give_back(&mut self, slot: u32) {
        let Object { kind, workspace, .. } = &mut self.objects[slot as usize];
        self.kinds[*kind as usize].spare.extend(workspace.take());
    }

    fn handle(&self, slot: u32) -> ObjectHandle {
        ObjectHandle { slot, generation: self.objects[slot as usize].generation }
    }

    fn find(&self, object: ObjectHandle) -> Option<&Object> {
        let found = self.objects.get(object.slot as usize)?;
        (found.present && found.generation == object.generation).then_some(found)
    }

    /// Index of a shape's kind.
    fn kind(&mut self, shape: &Shape) -> usize {
        let same = |kind: &Kind| std::ptr::eq(kind.shape.clod(), shape.clod());
        self.kinds.iter().position(same).unwrap_or_else(|| {
            self.kinds.push(Kind::new(shape));
            self.kinds.len() - 1
        })
    }
}
