//! Scene objects: their geometry, placement, motion and edits.

pub(crate) mod cache;
pub(crate) mod clock;
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

#[cfg(feature = "scene-files")]
pub use self::file::ObjectEntry;
pub use self::object::NamedMesh;

use crate::scene::object::Object;

/// Objects that the grasped one can touch, at their initial poses.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    pub(crate) objects: Vec<Placed>,
}

/// Identifier of an object in a running session. The objects that the session begins with have their indices
/// in [`Scene::objects`]; no identifier is used twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SceneId(pub usize);

/// Object at a pose.
#[derive(Clone, Debug)]
pub struct Placed {
    /// The object.
    pub object: Object,
    /// Pose of the mesh's frame in the world.
    pub pose: Pose,
}

impl Scene {
    /// Makes an empty scene: the grasped object moves in free space.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an object, its mesh's frame at `pose`.
    #[must_use]
    pub fn with(mut self, object: Object, pose: Pose) -> Self {
        self.objects.push(Placed { object, pose });
        self
    }

    /// Objects of the scene.
    pub fn objects(&self) -> &[Placed] {
        &self.objects
    }
}
