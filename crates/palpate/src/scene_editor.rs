//! Changes to the scene while a session runs.
//!
//! They wait in a lock-free ring for the contact loop, which takes them at the beginning of its next step: what an object
//! needs is allocated there or before, and given back there, never in the haptic loop. That renders the contacts known so far meanwhile.

use palpate_core::{Pose, Twist};
use rtrb::{Consumer, Producer, RingBuffer};

use crate::moving::Mobility;
use crate::object::Object;

/// Changes that may wait for the contact loop.
const WAITING: usize = 1024;

/// An object of a running scene. Those that a session begins with have the numbers of their places in
/// [`Scene::objects`](crate::Scene::objects); none is used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SceneId(pub usize);

/// A change.
#[derive(Clone, Debug)]
pub(crate) enum Edit {
    Add(SceneId, Object, Pose),
    Replace(SceneId, Object, Pose),
    Move(SceneId, Pose),
    Motion(SceneId, Pose, Twist),
    Mobility(SceneId, Option<Mobility>),
    Remove(SceneId),
}

/// Why a change was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EditError {
    /// As many as may wait for the contact loop do: it is slower than the host, or the session has ended.
    #[error("{WAITING} changes wait for the contact loop; make fewer, or see whether the session still runs")]
    Full,
    /// A pose is none.
    #[error("a pose is not finite, or its quaternion not of unit length")]
    Pose,
    /// A velocity is none.
    #[error("a velocity is not finite")]
    Twist,
    /// No body has such a mobility.
    #[error(
        "a mobility's mass, period or principal moments of inertia are not above 0, or not finite, or no body has them"
    )]
    Mobility,
}

/// Changes the scene of a session, from any thread. Made by
/// [`HapticRenderer::scene_editor`](crate::HapticRenderer::scene_editor), and by
/// [`ArticulatedRenderer::scene_editor`](crate::ArticulatedRenderer::scene_editor) for both bodies of a tool.
///
/// A change that cannot be made, as of an object that is not there any more, is passed over and
/// [counted](crate::Events::edit_refused).
#[derive(Debug)]
pub struct SceneEditor {
    /// Of each contact loop.
    edits: Vec<Producer<Edit>>,
    next: usize,
}

impl SceneEditor {
    /// For a scene that begins with so many objects.
    pub(crate) fn new(objects: usize) -> (Self, Consumer<Edit>) {
        let mut editor = Self { edits: Vec::new(), next: objects };
        let waiting = editor.also();
        (editor, waiting)
    }

    /// For one more contact loop with the same scene.
    pub(crate) fn also(&mut self) -> Consumer<Edit> {
        let (edits, waiting) = RingBuffer::new(WAITING);
        self.edits.push(edits);
        waiting
    }

    /// Adds an object, its mesh's frame at a pose in the world.
    ///
    /// What a hierarchy needs to be queried is prepared here, in the caller's thread.
    ///
    /// # Errors
    /// If the pose is none, or too many changes wait.
    #[cfg_attr(feature = "tracing", tracing::instrument(skip_all, fields(object = object.name), err))]
    pub fn add(&mut self, object: &Object, pose: Pose) -> Result<SceneId, EditError> {
        object.shape();
        let id = SceneId(self.next);
        self.send(&pose, |pose| Edit::Add(id, object.clone(), pose))?;
        self.next += 1;
        Ok(id)
    }

    /// Puts another object in the place of one, as itself [scaled](Object::scaled), at a pose.
    ///
    /// # Errors
    /// As [`add`](Self::add).
    pub fn replace(&mut self, id: SceneId, object: &Object, pose: Pose) -> Result<(), EditError> {
        object.shape();
        self.send(&pose, |pose| Edit::Replace(id, object.clone(), pose))
    }

    /// Puts an object elsewhere, at once. Contacts are rendered as if it stood still there: what moves is told of by
    /// [`set_motion`](Self::set_motion).
    ///
    /// # Errors
    /// As [`add`](Self::add).
    pub fn set_pose(&mut self, id: SceneId, pose: Pose) -> Result<(), EditError> {
        self.send(&pose, |pose| Edit::Move(id, pose))
    }

    /// Tells where an object that moves is, and how fast: `linear` being the velocity of its mesh frame's origin. To be told
    /// as often as the host knows anew, 20 times a second at least. The object goes on meanwhile, and goes over smoothly to
    /// what it is told; without, it stands still after 50 ms.
    ///
    /// # Errors
    /// As [`add`](Self::add), or if the velocity is not finite.
    pub fn set_motion(&mut self, id: SceneId, pose: Pose, twist: Twist) -> Result<(), EditError> {
        if !twist.is_finite() {
            return Err(EditError::Twist);
        }
        self.send(&pose, |pose| Edit::Motion(id, pose, twist))
    }

    /// Says how an object is moved by what touches it: contacts then push it back, which
    /// [`Reactions`](crate::Reactions) tell, and are as soft as is stable with one so light. With none, it is not to be moved
    /// by contacts.
    ///
    /// # Errors
    /// If no body has such a mobility, or too many changes wait.
    pub fn set_mobility(&mut self, id: SceneId, mobility: Option<Mobility>) -> Result<(), EditError> {
        if mobility.is_some_and(|mobility| !mobility.is_valid()) {
            return Err(EditError::Mobility);
        }
        self.push(Edit::Mobility(id, mobility))
    }

    /// Takes an object out.
    ///
    /// # Errors
    /// If too many changes wait.
    pub fn remove(&mut self, id: SceneId) -> Result<(), EditError> {
        self.push(Edit::Remove(id))
    }

    fn send(&mut self, pose: &Pose, edit: impl FnOnce(Pose) -> Edit) -> Result<(), EditError> {
        if !pose.is_valid() {
            return Err(EditError::Pose);
        }
        self.push(edit(*pose))
    }

    /// To all loops, or to none.
    fn push(&mut self, edit: Edit) -> Result<(), EditError> {
        if self.edits.iter().any(Producer::is_full) {
            return Err(EditError::Full);
        }
        for edits in &mut self.edits {
            edits.push(edit.clone()).map_err(|_| EditError::Full)?;
        }
        Ok(())
    }
}
