//! What the grasped object can touch.

pub(crate) mod cache;
pub(crate) mod editor;
pub(crate) mod field;
#[cfg(feature = "scene-files")]
pub(crate) mod file;
pub(crate) mod moving;
pub(crate) mod object;
pub(crate) mod placement;
pub(crate) mod size;
pub(crate) mod walls;

use palpate_core::Pose;

use crate::scene::object::Object;

/// The static objects around the grasped one.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    pub(crate) objects: Vec<Placed>,
}

/// An object of a running scene. Those that a session begins with have the numbers of their places in
/// [`Scene::objects`]; none is used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SceneId(pub usize);

/// An object at its place.
#[derive(Clone, Debug)]
pub struct Placed {
    /// The object.
    pub object: Object,
    /// Pose of its mesh's frame in the world.
    pub pose: Pose,
}

impl Scene {
    /// An empty scene: the grasped object moves in free space.
    pub fn new() -> Self {
        Self::default()
    }

    /// The scene with one more object, its mesh's frame at `pose`.
    #[must_use]
    pub fn with(mut self, object: Object, pose: Pose) -> Self {
        self.objects.push(Placed { object, pose });
        self
    }

    /// The objects.
    pub fn objects(&self) -> &[Placed] {
        &self.objects
    }
}
