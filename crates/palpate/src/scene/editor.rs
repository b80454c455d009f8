//! Changes to the scene while a session runs.
//!
//! They wait in a lock-free ring for the contact loop, which takes them at the beginning of its next step: what an object
//! needs is allocated there or before, and given back there, never in the haptic loop. That renders the contacts known so far meanwhile.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use palpate_core::{Pose, Twist};
use palpate_field::FieldOptions;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::scene::SceneId;
use crate::scene::moving::DynamicBody;
use crate::scene::object::Object;

/// Changes that may wait for the contact loop.
const WAITING: usize = 1024;

/// A change.
#[derive(Clone, Debug)]
pub(crate) enum Edit {
    Add(SceneId, Object, Pose),
    Replace(SceneId, Object, Pose),
    Move(SceneId, Pose),
    Motion(SceneId, Pose, Twist),
    DynamicBody(SceneId, Option<DynamicBody>),
    Remove(SceneId),
}

/// Why a change was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EditError {
    /// The contact loop has as many changes to make as may wait for it: it is slower than the host, or the session has ended.
    #[error("{WAITING} changes wait for the contact loop; make fewer, or see whether the session still runs")]
    Full,
    /// The scene has no such object.
    #[error("the scene has no object {}; it was removed, or belongs to another session", .0.0)]
    Unknown(SceneId),
    /// The pose is invalid.
    #[error("a pose is not finite, or its quaternion not of unit length")]
    Pose,
    /// The velocity is not finite.
    #[error("a velocity is not finite")]
    Twist,
    /// The dynamic body is invalid.
    #[error(
        "a dynamic body's mass, period or principal moments of inertia are not above 0, or not finite, or no body has them"
    )]
    DynamicBody,
}

/// Changes the scene of a session, from any thread. Made by
/// [`HapticRenderer::scene_editor`](crate::HapticRenderer::scene_editor), for all bodies of a tool.
///
/// A clone edits the same scene: an object that one adds is known to the others.
///
/// The contact loop skips a change that it cannot make, such as adding an object whose texture cannot be rendered, and
/// [counts](crate::Events::edit_refused) it.
#[derive(Clone, Debug)]
pub struct SceneEditor(Arc<Mutex<Edits>>);

/// What all editors of a scene share. The contact loop never waits for it: it has the other ends of the rings.
#[derive(Debug)]
struct Edits {
    /// To each contact loop.
    waiting: Vec<Producer<Edit>>,
    known: BTreeSet<SceneId>,
    next: usize,
    /// What an object is to have besides its hierarchy.
    fields: Option<FieldOptions>,
}

impl SceneEditor {
    /// For a scene that begins with these objects.
    pub(crate) fn new(
        objects: impl IntoIterator<Item = SceneId>,
        fields: Option<FieldOptions>,
    ) -> (Self, Consumer<Edit>) {
        let known: BTreeSet<SceneId> = objects.into_iter().collect();
        let next = known.last().map_or(0, |last| last.0 + 1);
        let editor = Self(Arc::new(Mutex::new(Edits { waiting: Vec::new(), known, next, fields })));
        let waiting = editor.also();
        (editor, waiting)
    }

    /// For one more contact loop with the same scene.
    pub(crate) fn also(&self) -> Consumer<Edit> {
        let (edits, waiting) = RingBuffer::new(WAITING);
        self.edits().waiting.push(edits);
        waiting
    }

    /// The number that the next object gets.
    pub(crate) fn next_id(&self) -> SceneId {
        SceneId(self.edits().next)
    }

    /// Takes note of an object that was added, or removed, otherwise than by an editor.
    pub(crate) fn note(&self, id: SceneId, is_there: bool) {
        let mut edits = self.edits();
        if is_there {
            edits.known.insert(id);
            edits.next = edits.next.max(id.0 + 1);
        } else {
            edits.known.remove(&id);
        }
    }

    /// Adds an object, its mesh's frame at a pose in the world.
    ///
    /// The caller's thread prepares the object's hierarchy for queries, and where contacts are [found in
    /// fields](crate::settings::ContactSearch::Representatives) makes its field. An object whose surface is not closed is not added there.
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
        edits.known.insert(id);
        Ok(id)
    }

    /// Replaces an object by another one, as itself [scaled](Object::scaled), at a pose.
    ///
    /// # Errors
    /// As [`add`](Self::add), or if the scene has no such object.
    pub fn replace(&mut self, id: SceneId, object: &Object, pose: Pose) -> Result<(), EditError> {
        self.prepare(object);
        check(&pose)?;
        self.change(id, Edit::Replace(id, object.clone(), pose))
    }

    /// Puts an object elsewhere, at once. Contacts are rendered as if it stood still there: for an object that moves, use
    /// [`set_motion`](Self::set_motion).
    ///
    /// # Errors
    /// As [`replace`](Self::replace).
    pub fn set_pose(&mut self, id: SceneId, pose: Pose) -> Result<(), EditError> {
        check(&pose)?;
        self.change(id, Edit::Move(id, pose))
    }

    /// Sets pose and velocity of an object that moves, `linear` being the velocity of its mesh frame's origin. Call it as often as
    /// the host has new values, at least 20 times a second: in between the object moves on at that velocity, and goes over
    /// smoothly to the next values; after 50 ms without any it stands still.
    ///
    /// # Errors
    /// As [`replace`](Self::replace), or if the velocity is not finite.
    pub fn set_motion(&mut self, id: SceneId, pose: Pose, twist: Twist) -> Result<(), EditError> {
        if !twist.is_finite() {
            return Err(EditError::Twist);
        }
        check(&pose)?;
        self.change(id, Edit::Motion(id, pose, twist))
    }

    /// Sets how contacts move an object: they then push it back, which [`Reactions`](crate::Reactions) report, and are as
    /// soft as is stable with one so light. With `None`, contacts do not move it.
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

    /// Lets the caller wait for what takes long, not the contact loop.
    fn prepare(&self, object: &Object) {
        object.shape();
        let fields = self.edits().fields;
        if let Some(fields) = fields {
            // Where there is none, the contact loop refuses the object.
            drop(object.field(fields));
        }
    }

    /// A change of an object that is there.
    fn change(&self, id: SceneId, edit: Edit) -> Result<(), EditError> {
        let mut edits = self.edits();
        if !edits.known.contains(&id) {
            return Err(EditError::Unknown(id));
        }
        let removed = matches!(edit, Edit::Remove(_));
        edits.push(edit)?;
        if removed {
            edits.known.remove(&id);
        }
        Ok(())
    }

    fn edits(&self) -> MutexGuard<'_, Edits> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Edits {
    /// To all loops, or to none.
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
