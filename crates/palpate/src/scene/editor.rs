//! Changes to the scene while a session runs.
//!
//! Changes wait in a lock-free ring for the contact loop, which makes them at the beginning of its next step.
//! Memory of objects is allocated there or in the caller's thread, and freed there, never in the haptic loop,
//! which meanwhile renders the contacts known so far.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use palpate_core::{Pose, Twist};
use palpate_field::FieldOptions;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::scene::SceneId;
use crate::scene::clock::SessionClock;
use crate::scene::moving::DynamicBody;
use crate::scene::object::Object;

/// Capacity of the ring of changes to a contact loop. When it is full, changes are refused.
const MAX_WAITING: usize = 1024;

/// Change to the scene.
#[derive(Clone, Debug)]
pub(crate) enum Edit {
    Add(SceneId, Object, Pose),
    Replace(SceneId, Object, Pose),
    Move(SceneId, Pose),
    /// Pose and twist at a time of the session, s.
    Motion(SceneId, Pose, Twist, f64),
    DynamicBody(SceneId, Option<DynamicBody>),
    Remove(SceneId),
}

/// A change to the scene was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EditError {
    /// The ring of changes is full: the contact loop is slower than the host, or the session has ended.
    #[error(
        "{MAX_WAITING} changes wait for the contact loop; make fewer, or check that the session still runs"
    )]
    Full,
    /// The scene has no such object.
    #[error("the scene has no object {}; it was removed, or belongs to another session", .0.0)]
    Unknown(SceneId),
    /// The pose is invalid.
    #[error("a pose is not finite, or its quaternion is not of unit length")]
    Pose,
    /// The velocity is not finite.
    #[error("a velocity is not finite")]
    Twist,
    /// The dynamic body is invalid.
    #[error(
        "a dynamic body's mass, period and principal moments of inertia must be finite and above 0, and no moment may exceed \
         the sum of the other two"
    )]
    DynamicBody,
}

/// Editor of the scene of a session, for all bodies of a tool, usable from any thread. Made by
/// [`HapticRenderer::scene_editor`](crate::HapticRenderer::scene_editor).
///
/// A clone edits the same scene: objects added by one clone can be edited by the others.
///
/// If the contact loop cannot make a change, such as adding an object whose texture cannot be rendered, it
/// skips the change and [counts](crate::Events::edit_refused) it.
#[derive(Clone, Debug)]
pub struct SceneEditor(Arc<Mutex<Edits>>);

/// State that all editors of a scene share. The contact loops never lock it: they hold the other ends of the
/// rings.
#[derive(Debug)]
struct Edits {
    /// Ring of changes to each contact loop.
    waiting: Vec<Producer<Edit>>,
    known: BTreeMap<SceneId, Object>,
    next: usize,
    needs: Needs,
    /// The objects in the hand, one for each loop.
    probes: Vec<Object>,
    /// Time of the haptic loop.
    clock: Arc<SessionClock>,
}

/// What contact steps need of objects.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Needs {
    /// Options of the objects' fields, if contacts are found in fields.
    pub fields: Option<FieldOptions>,
    /// Whether contacts are constraints, which need the linked features of the objects' surfaces.
    pub features: bool,
}

impl SceneEditor {
    /// Makes the editor of a scene with these objects, which has no contact loop yet.
    pub(crate) fn new(objects: impl IntoIterator<Item = (SceneId, Object)>, needs: Needs) -> Self {
        let known: BTreeMap<SceneId, Object> = objects.into_iter().collect();
        let next = known.last_key_value().map_or(0, |(last, _)| last.0 + 1);
        let (waiting, probes, clock) = (Vec::new(), Vec::new(), Arc::default());
        Self(Arc::new(Mutex::new(Edits { waiting, known, next, needs, probes, clock })))
    }

    /// Adds the ring of changes to a contact loop with an object in the hand.
    pub(crate) fn add_loop(&self, probe: &Object) -> Consumer<Edit> {
        let (changes, waiting) = RingBuffer::new(MAX_WAITING);
        let mut edits = self.edits();
        edits.waiting.push(changes);
        edits.probes.push(probe.clone());
        waiting
    }

    /// Prepares all objects for contacts as constraints, in the caller's thread.
    pub(crate) fn prepare_constraints(&self) {
        let objects: Vec<Object> = {
            let mut edits = self.edits();
            edits.needs.features = true;
            edits.known.values().chain(&edits.probes).cloned().collect()
        };
        // The lock is free meanwhile.
        objects.iter().for_each(|object| drop(object.features()));
    }

    /// Tells the time by the clock of a haptic loop from now on.
    pub(crate) fn set_clock(&self, clock: Arc<SessionClock>) {
        self.edits().clock = clock;
    }

    /// Identifier of the next object.
    pub(crate) fn next_id(&self) -> SceneId {
        SceneId(self.edits().next)
    }

    /// Notes an object that was added without an editor, or the removal of one.
    pub(crate) fn note(&self, id: SceneId, added: Option<&Object>) {
        let mut edits = self.edits();
        if let Some(object) = added {
            edits.known.insert(id, object.clone());
            edits.next = edits.next.max(id.0 + 1);
        } else {
            edits.known.remove(&id);
        }
    }

    /// Adds an object, its mesh's frame at a pose in the world.
    ///
    /// All that contact steps need of the object is prepared in the caller's thread: its hierarchy, the
    /// features of its surface for constraints, and its field where contacts are [found in
    /// fields](crate::settings::ContactSearch::Representatives). The contact loop then refuses an object with
    /// an open surface.
    ///
    /// # Errors
    /// If the pose is invalid, or too many changes wait.
    #[cfg_attr(feature = "tracing", tracing::instrument(skip_all, fields(object = object.name), err))]
    pub fn add(&mut self, object: &Object, pose: Pose) -> Result<SceneId, EditError> {
        self.prepare(object);
        check(&pose)?;
        let mut edits = self.edits();
        let id = SceneId(edits.next);
        edits.push(Edit::Add(id, object.clone(), pose))?;
        edits.next += 1;
        edits.known.insert(id, object.clone());
        Ok(id)
    }

    /// Replaces an object by another one, such as itself [scaled](Object::scaled), at a pose.
    ///
    /// # Errors
    /// As [`add`](Self::add), or if the scene has no such object.
    pub fn replace(&mut self, id: SceneId, object: &Object, pose: Pose) -> Result<(), EditError> {
        self.prepare(object);
        check(&pose)?;
        self.change(id, Edit::Replace(id, object.clone(), pose))
    }

    /// Places an object at another pose, at once. Contacts are rendered as if the object stood still there:
    /// for an object that moves, use [`set_motion`](Self::set_motion).
    ///
    /// # Errors
    /// As [`replace`](Self::replace).
    pub fn set_pose(&mut self, id: SceneId, pose: Pose) -> Result<(), EditError> {
        check(&pose)?;
        self.change(id, Edit::Move(id, pose))
    }

    /// Sets pose and velocity of an object that moves; `linear` is the velocity of its mesh frame's origin.
    /// Call it as often as the host has new values, at least 20 times a second. In between the object
    /// continues at that velocity, and it changes smoothly to the next values; after 50 ms without new values
    /// it stands still.
    ///
    /// # Errors
    /// As [`replace`](Self::replace), or if the velocity is not finite.
    pub fn set_motion(&mut self, id: SceneId, pose: Pose, twist: Twist) -> Result<(), EditError> {
        if !twist.is_finite() {
            return Err(EditError::Twist);
        }
        check(&pose)?;
        let time = self.edits().clock.now();
        self.change(id, Edit::Motion(id, pose, twist, time))
    }

    /// Sets the mass and inertia of an object that contacts push. The [`Reactions`](crate::Reactions) on it
    /// are reported, and until the host answers the haptic loop moves it as they would; penalty contacts with
    /// it are only as stiff as is stable with such a mass. With `None`, contacts do not push it.
    ///
    /// # Errors
    /// If the dynamic body is invalid, the scene has no such object, or too many changes wait.
    pub fn set_dynamics(&mut self, id: SceneId, body: Option<DynamicBody>) -> Result<(), EditError> {
        if body.is_some_and(|body| !body.is_valid()) {
            return Err(EditError::DynamicBody);
        }
        self.change(id, Edit::DynamicBody(id, body))
    }

    /// Removes an object.
    ///
    /// # Errors
    /// If the scene has no such object, or too many changes wait.
    pub fn remove(&mut self, id: SceneId) -> Result<(), EditError> {
        self.change(id, Edit::Remove(id))
    }

    /// Prepares an object for queries in the caller's thread, so that the contact loop need not.
    fn prepare(&self, object: &Object) {
        object.shape();
        let (Needs { fields, features }, probes) = {
            let edits = self.edits();
            (edits.needs, edits.probes.clone())
        };
        if features {
            drop(object.features());
        }
        // If the object can have no field or no texture, the contact loop refuses it.
        if let Some(fields) = fields {
            drop(object.field(fields));
        }
        for probe in &probes {
            if object.texture().is_some() || probe.texture().is_some() {
                drop((object.surface(), probe.surface()));
            }
        }
    }

    /// Sends a change of an object that exists.
    fn change(&self, id: SceneId, edit: Edit) -> Result<(), EditError> {
        let mut edits = self.edits();
        if !edits.known.contains_key(&id) {
            return Err(EditError::Unknown(id));
        }
        let replaced = if let Edit::Replace(_, object, _) = &edit { Some(object.clone()) } else { None };
        let removed = matches!(edit, Edit::Remove(_));
        edits.push(edit)?;
        if removed {
            edits.known.remove(&id);
        }
        if let Some(object) = replaced {
            edits.known.insert(id, object);
        }
        Ok(())
    }

    fn edits(&self) -> MutexGuard<'_, Edits> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Edits {
    /// Sends a change to all loops, or to none.
    fn push(&mut self, edit: Edit) -> Result<(), EditError> {
        if self.waiting.iter().any(Producer::is_full) {
            return Err(EditError::Full);
        }
        for edits in &mut self.waiting {
            edits.push(edit.clone()).map_err(|_| EditError::Full)?;
        }
        Ok(())
    }
}

fn check(pose: &Pose) -> Result<(), EditError> {
    if pose.is_valid() { Ok(()) } else { Err(EditError::Pose) }
}
