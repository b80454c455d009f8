//! One probe against many placed objects: a broad phase finds the objects that may be within reach, and each of those gets
//! its [contact query](crate::ContactQuery).
//!
//! An object is within reach when its bounding sphere, and its box in its own axes, come within the tolerance of the
//! probe's bounding sphere. How far it is from that is a way that the probe and the object have to go together, so that
//! the object sleeps until they may have: the probe's way is added up once for all, and an object that is moved wakes
//! earlier by as much. A run looks at the objects that are awake only. They come first in a heap, so that the cost for the
//! others is nothing while nothing moves, and grows with the logarithm of their number for each one that is moved.
//!
//! Why no tree of boxes: it has to be descended in every run, to find what was there before, and refitted for every object
//! that moves, where a heap gives the objects that may matter. Of 10,000 instances, with every tenth moving, a run takes
//! less time in all than refitting and asking parry's tree (f64), and nothing measurable while nothing moves; only a probe
//! that leaps across the scene wakes all at once, for 0.7 ms (`cargo bench -p palpate-benches --bench broad_phase`).
//! `obvhs`, the broad phase of other crates here, holds its boxes in f32, which would have to be widened.
//!
//! Only objects within reach hold a workspace. Those that an object has left go to others of the same shape, of which
//! there may be thousands.

mod wake_queue;

use std::time::Instant;

use palpate_core::Pose;
use palpate_core::glam::{DQuat, DVec3};

use self::wake_queue::WakeQueue;
use crate::ball::Ball;
use crate::contact::PatchContact;
use crate::error::{QueryError, QueryObject};
use crate::query::{Budget, ContactQuery, QueryOutcome, QuerySettings};
use crate::shape::Shape;
use crate::tolerances::{COORDINATE_ROUNDING, ROUNDING_SLACK, SCENE_MOTION_LIMIT, UNIT_QUATERNION_SLACK};

/// Contacts and pairs of nodes that a workspace has room for when it is made in passing.
const CONTACTS: usize = 64;
const PAIRS: usize = 256;

/// An object of a [`SceneQuery`]. Handles are ordered as the objects' contacts are, and none is used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ObjectHandle {
    slot: u32,
    generation: u32,
}

impl ObjectHandle {
    /// The object's place among those of its query, in the order in which they were added; that of an object that was removed
    /// is taken by the next.
    pub fn place(&self) -> usize {
        self.slot as usize
    }
}

/// The contacts with one object.
#[derive(Clone, Copy, Debug)]
pub struct ObjectContacts<'a> {
    /// The object.
    pub object: ObjectHandle,
    /// Its contacts, as [`ContactQuery::contacts`] has them.
    pub contacts: &'a [PatchContact],
    /// What its query found and what it cost.
    pub outcome: &'a QueryOutcome,
}

/// What a run found and what it cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SceneOutcome {
    /// All queries together: sums, largest values (of the smallest distance the smallest), and flags that were set in any.
    pub query: QueryOutcome,
    /// Objects that the broad phase looked at: those that were awake.
    pub tested: usize,
    /// Objects within reach, each of which got a query.
    pub queried: usize,
    /// Objects that got none because their pose is not [valid](Pose::is_valid) or their shape has no nodes. They are
    /// looked at again in every run.
    pub invalid: usize,
}

/// Contact queries of one probe with many objects.
///
/// Adding objects and reserving workspaces allocates. A run allocates only while it exceeds what was there before: when
/// more objects of a shape are within reach at once than ever, or a workspace has more to do than ever.
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
    /// By slot.
    objects: Vec<Object>,
    vacant: Vec<u32>,
    queue: WakeQueue,
    awake: Vec<u32>,
    /// Slots of the objects that got a query in the last run.
    in_reach: Vec<u32>,
    /// Of those that were within reach when they were last looked for without queries.
    near: Vec<u32>,
    /// Where the centre of the probe's sphere was, m, and the tolerance, m.
    last: Option<(DVec3, f64)>,
    /// The way that the probe has come, m.
    way: f64,
}

/// Objects of one shape.
#[derive(Clone, Debug)]
struct Kind {
    shape: Shape,
    ball: Ball,
    /// Corners of the box, m.
    low: DVec3,
    high: DVec3,
    /// Furthest corner from the sphere's centre, m.
    corner: f64,
    /// Workspaces that no object holds; room for all that there are.
    #[expect(clippy::vec_box, reason = "as objects hold them, to be handed on without being copied")]
    spare: Vec<Box<Workspace>>,
    workspaces: usize,
    /// Objects of the shape.
    count: usize,
}

#[derive(Clone, Debug)]
struct Workspace {
    query: ContactQuery,
    outcome: QueryOutcome,
}

#[derive(Clone, Debug)]
struct Object {
    pose: Pose,
    /// Of its bounding sphere, in the world, m.
    center: DVec3,
    kind: u32,
    workspace: Option<Box<Workspace>>,
    generation: u32,
    /// Whether it is in the scene, and not disabled.
    present: bool,
    enabled: bool,
}

impl Kind {
    fn new(shape: &Shape) -> Self {
        let points = || shape.clod().vertices.iter().copied();
        let (low, high) =
            (points().fold(DVec3::INFINITY, DVec3::min), points().fold(DVec3::NEG_INFINITY, DVec3::max));
        let ball = shape.ball();
        let corner = (high - ball.center).abs().max((low - ball.center).abs()).length();
        Self { shape: shape.clone(), ball, low, high, corner, spare: Vec::new(), workspaces: 0, count: 0 }
    }

    /// Adds a workspace to the spare ones.
    fn add_workspace(&mut self, query: ContactQuery) {
        self.workspaces += 1;
        self.spare.reserve(self.workspaces - self.spare.len());
        self.spare.push(Box::new(Workspace { query, outcome: QueryOutcome::default() }));
    }
}

impl SceneQuery {
    /// Queries of a probe with nothing yet.
    pub fn new(probe: &Shape) -> Self {
        Self {
            probe: probe.clone(),
            kinds: Vec::new(),
            objects: Vec::new(),
            vacant: Vec::new(),
            queue: WakeQueue::default(),
            awake: Vec::new(),
            in_reach: Vec::new(),
            near: Vec::new(),
            last: None,
            way: 0.0,
        }
    }

    /// Adds an object at a pose (object frame to world). Objects of one shape, which may be at any number of places, share
    /// it and their workspaces.
    pub fn add(&mut self, shape: &Shape, pose: &Pose) -> ObjectHandle {
        let kind = self.kind(shape) as u32;
        let slot = self.vacant.pop().unwrap_or(self.objects.len() as u32);
        let center = pose.transform_point(self.kinds[kind as usize].ball.center);
        let object = Object {
            pose: *pose,
            center,
            kind,
            workspace: None,
            generation: 0,
            present: true,
            enabled: true,
        };
        self.kinds[kind as usize].count += 1;
        match self.objects.get_mut(slot as usize) {
            Some(old) => *old = Object { generation: old.generation.wrapping_add(1), ..object },
            None => self.objects.push(object),
        }
        let count = self.objects.len();
        self.queue.reserve(count);
        self.awake.reserve(count.saturating_sub(self.awake.len()));
        self.in_reach.reserve(count.saturating_sub(self.in_reach.len()));
        self.near.reserve(count.saturating_sub(self.near.len()));
        self.queue.set(slot, f64::NEG_INFINITY);
        ObjectHandle { slot, generation: self.objects[slot as usize].generation }
    }

    /// Takes an object out; `false` if it is not there. Its workspace is kept for others of its shape; with the last of these, the
    /// shape goes as well.
    pub fn remove(&mut self, object: ObjectHandle) -> bool {
        let removed = self.set_enabled(object, false);
        if removed {
            let Object { present, kind, .. } = &mut self.objects[object.slot as usize];
            *present = false;
            let kind = *kind;
            self.vacant.push(object.slot);
            self.kinds[kind as usize].count -= 1;
            if self.kinds[kind as usize].count == 0 {
                self.drop_kind(kind);
            }
        }
        removed
    }

    /// Forgets a shape that no object has; the last one takes its place.
    fn drop_kind(&mut self, kind: u32) {
        self.kinds.swap_remove(kind as usize);
        let moved = self.kinds.len() as u32;
        for object in self.objects.iter_mut().filter(|object| object.kind == moved) {
            object.kind = kind;
        }
    }

    /// Moves an object (object frame to world); `false` if it is not there. While its pose is not
    /// [valid](Pose::is_valid), runs leave the object out and [count](SceneOutcome::invalid) it.
    pub fn set_pose(&mut self, object: ObjectHandle, pose: &Pose) -> bool {
        if self.find(object).is_none() {
            return false;
        }
        let moved = &mut self.objects[object.slot as usize];
        let kind = &self.kinds[moved.kind as usize];
        let center = pose.transform_point(kind.ball.center);
        // No point of the sphere or the box has come further.
        let way = center.distance(moved.center) + turn(moved.pose.rotation, pose.rotation) * kind.corner;
        let rounding = rounding(center) + rounding(moved.center);
        let wake = self.queue.wake(object.slot) - way * (1.0 + ROUNDING_SLACK) - rounding;
        let known = moved.pose.is_valid() && pose.is_valid() && wake.is_finite();
        (moved.pose, moved.center) = (*pose, center);
        if moved.enabled {
            self.queue.set(object.slot, if known { wake } else { f64::NEG_INFINITY });
        }
        true
    }

    /// Whether an object can be touched; `false` if it is not there.
    pub fn set_enabled(&mut self, object: ObjectHandle, enabled: bool) -> bool {
        if self.find(object).is_none() {
            return false;
        }
        let changed = &mut self.objects[object.slot as usize];
        changed.enabled = enabled;
        if enabled {
            self.queue.set(object.slot, f64::NEG_INFINITY);
        } else {
            self.queue.remove(object.slot);
            self.give_back(object.slot);
        }
        true
    }

    /// Where an object is (object frame to world), if it is there.
    pub fn pose(&self, object: ObjectHandle) -> Option<&Pose> {
        self.find(object).map(|found| &found.pose)
    }

    /// The shape of an object, if it is there.
    pub fn shape(&self, object: ObjectHandle) -> Option<&Shape> {
        self.find(object).map(|found| &self.kinds[found.kind as usize].shape)
    }

    /// Number of objects, disabled ones included.
    pub fn len(&self) -> usize {
        self.objects.len() - self.vacant.len()
    }

    /// Whether there are no objects.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Makes workspaces, as large as those of [`ContactQuery::new`], for as many objects of a shape within reach at once.
    pub fn reserve(&mut self, shape: &Shape, objects: usize) {
        let kind = self.kind(shape);
        let kind = &mut self.kinds[kind];
        while kind.workspaces < objects {
            kind.add_workspace(ContactQuery::new(&self.probe, shape));
        }
    }

    /// Drops the workspaces that no object holds.
    pub fn shrink(&mut self) {
        for kind in &mut self.kinds {
            kind.workspaces -= kind.spare.len();
            kind.spare = Vec::with_capacity(kind.workspaces);
        }
    }

    /// Forgets all that was found out: the next run looks at all objects, and starts every query from the roots.
    pub fn reset(&mut self) {
        self.last = None;
        for workspace in self.objects.iter_mut().filter_map(|object| object.workspace.as_mut()) {
            workspace.query.reset();
        }
    }

    /// Bytes of memory held, besides the shapes.
    pub fn bytes(&self) -> usize {
        let spare = self.kinds.iter().flat_map(|kind| &kind.spare);
        let held = self.objects.iter().filter_map(|object| object.workspace.as_ref());
        let lists =
            self.awake.capacity() + self.in_reach.capacity() + self.near.capacity() + self.vacant.capacity();
        spare.chain(held).map(|workspace| size_of::<Workspace>() + workspace.query.bytes()).sum::<usize>()
            + self.kinds.iter().map(|kind| size_of::<Kind>() + 8 * kind.spare.capacity()).sum::<usize>()
            + self.objects.capacity() * size_of::<Object>()
            + self.queue.bytes()
            + lists * size_of::<u32>()
    }

    /// Finds the contacts of the probe at a pose (object frame to world) with all objects.
    ///
    /// A budget is for all queries together: each gets an equal part of what those before it have left.
    ///
    /// # Errors
    /// If the probe's pose is not valid, or the tolerance or an error metric is out of bounds. There are
    /// no contacts then. An object whose own pose is not valid is left out and [counted](SceneOutcome::invalid).
    pub fn run(&mut self, probe_pose: &Pose, settings: &QuerySettings) -> Result<SceneOutcome, QueryError> {
        let mut outcome = SceneOutcome::default();
        self.in_reach.clear();
        QueryError::check_pose(probe_pose, QueryObject::Probe)?;
        settings.check(&self.probe)?;
        self.find_in_reach(probe_pose, settings.tolerance, &mut outcome);
        self.hand_out(&mut outcome);
        let begun = Instant::now();
        for (index, slot) in self.in_reach.iter().enumerate() {
            let Object { pose, workspace: Some(workspace), .. } = &mut self.objects[*slot as usize] else {
                continue;
            };
            let left = self.in_reach.len() - index;
            let budget = settings.budget.map(|budget| match budget {
                Budget::Time(time) => Budget::Time(time.saturating_sub(begun.elapsed()) / left as u32),
                Budget::Queries(queries) => {
                    Budget::Queries(queries.saturating_sub(outcome.query.convex_queries) / left)
                }
            });
            workspace.outcome =
                workspace.query.run(probe_pose, pose, &QuerySettings { budget, ..*settings })?;
            outcome.query.add(&workspace.outcome);
        }
        outcome.queried = self.in_reach.len();
        Ok(outcome)
    }

    /// Finds the objects within reach of the probe at a pose (object frame to world), without any query: for those who look for contacts
    /// otherwise. There are [no contacts](Self::contacts) then. How many are left out because their pose is not valid.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn find_near(&mut self, probe_pose: &Pose, tolerance: f64) -> Result<usize, QueryError> {
        self.in_reach.clear();
        self.near.clear();
        QueryError::check_pose(probe_pose, QueryObject::Probe)?;
        QuerySettings::new(tolerance).check(&self.probe)?;
        let mut outcome = SceneOutcome::default();
        self.find_in_reach(probe_pose, tolerance, &mut outcome);
        std::mem::swap(&mut self.in_reach, &mut self.near);
        Ok(outcome.invalid)
    }

    /// The objects that were within reach when [they were last looked for](Self::find_near), by handle.
    pub fn near(&self) -> impl Iterator<Item = ObjectHandle> {
        self.near
            .iter()
            .map(|slot| ObjectHandle { slot: *slot, generation: self.objects[*slot as usize].generation })
    }

    /// The objects that got a query in the last run, those without contacts included, with their contacts, by handle.
    pub fn contacts(&self) -> impl Iterator<Item = ObjectContacts<'_>> {
        self.in_reach.iter().filter_map(|slot| {
            let Object { generation, workspace, .. } = &self.objects[*slot as usize];
            let Workspace { query, outcome } = workspace.as_deref()?;
            let object = ObjectHandle { slot: *slot, generation: *generation };
            Some(ObjectContacts { object, contacts: query.contacts(), outcome })
        })
    }

    /// Lists the objects within reach, and puts the others to sleep that were awake.
    fn find_in_reach(&mut self, probe_pose: &Pose, tolerance: f64, outcome: &mut SceneOutcome) {
        let Ball { center, radius } = self.probe.ball();
        let center = probe_pose.transform_point(center);
        self.way += match self.last.replace((center, tolerance)) {
            Some((last, before)) if last == center && before == tolerance => 0.0,
            Some((last, before)) => {
                let way = center.distance(last) + (tolerance - before).abs();
                way * (1.0 + ROUNDING_SLACK) + rounding(center) + rounding(last)
            }
            None => f64::INFINITY,
        };
        // Before rounding tells.
        if self.way.is_nan() || self.way > SCENE_MOTION_LIMIT * radius {
            self.way = 0.0;
            self.queue.wake_all();
        }
        self.awake.clear();
        self.queue.awake(self.way, &mut self.awake);
        outcome.tested = self.awake.len();
        for index in 0..self.awake.len() {
            let slot = self.awake[index];
            let object = &self.objects[slot as usize];
            let kind = &self.kinds[object.kind as usize];
            let invalid = QueryError::check_pose(&object.pose, QueryObject::Scene).is_err();
            let gap = gap(
                object,
                kind,
                center,
                radius + tolerance + UNIT_QUATERNION_SLACK * self.probe.coordinates(),
            );
            let wake = if gap > 0.0 && !invalid { self.way + gap } else { f64::NEG_INFINITY };
            if wake != self.queue.wake(slot) {
                self.queue.set(slot, wake);
            }
            outcome.invalid += usize::from(invalid);
            if gap > 0.0 || invalid {
                self.give_back(slot);
            } else {
                self.in_reach.push(slot);
            }
        }
        self.in_reach.sort_unstable();
    }

    /// Sees to it that all objects within reach have a workspace.
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

    /// Takes an object's workspace back.
    fn give_back(&mut self, slot: u32) {
        let Object { kind, workspace, .. } = &mut self.objects[slot as usize];
        self.kinds[*kind as usize].spare.extend(workspace.take());
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

/// How far an object is from being within `reach` (m) of a point in the world, at least.
fn gap(object: &Object, kind: &Kind, center: DVec3, reach: f64) -> f64 {
    let distance = center.distance(object.center);
    let spheres = distance - kind.ball.radius;
    let local = object.pose.inverse().transform_point(center);
    let boxes = local.distance(local.clamp(kind.low, kind.high));
    let slack = UNIT_QUATERNION_SLACK * (distance + reach + kind.ball.radius + kind.shape.coordinates());
    spheres.max(boxes) - reach - slack - rounding(center) - rounding(object.center)
}

/// Bound on how far a point of the unit sphere goes from one orientation to another.
fn turn(from: DQuat, to: DQuat) -> f64 {
    // Half the angle between the quaternions is a quarter of that of the rotation.
    2.0 * (from - to).length().min((from + to).length())
}

/// Of a point's coordinates, m.
fn rounding(point: DVec3) -> f64 {
    COORDINATE_ROUNDING * point.abs().max_element()
}
