//! The objects of the scene that a contact loop knows.

use palpate_collide::ObjectHandle;

use super::group::ContactGroup;
use crate::scene::SceneId;
use crate::scene::moving::MovingObject;
use crate::scene::object::Object;

/// An object of the scene.
#[derive(Debug)]
pub(super) struct InScene {
    pub id: SceneId,
    pub handle: ObjectHandle,
    pub object: Object,
    /// Of an object that moves, or can be moved: its motion, and the contacts with it.
    pub moving: Option<Box<(MovingObject, ContactGroup)>>,
}

impl InScene {
    /// An object that stands still.
    pub fn new(id: SceneId, handle: ObjectHandle, object: &Object) -> Self {
        Self { id, handle, object: object.clone(), moving: None }
    }
}

/// The objects by their places in the query.
pub(super) fn objects_of(objects: &[Option<InScene>]) -> Vec<Option<&Object>> {
    objects.iter().map(|place| place.as_ref().map(|object| &object.object)).collect()
}
