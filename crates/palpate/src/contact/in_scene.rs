//! The scene objects of a contact loop.

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
    /// Motion of the object and the contacts with it, if it moves or can be moved.
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
