//! The scene objects of a contact loop.

use std::sync::Arc;

use palpate_collide::ObjectHandle;
use palpate_core::Twist;
use palpate_core::glam::DVec3;
use palpate_field::FeatureMesh;

use super::group::ContactGroup;
use crate::scene::SceneId;
use crate::scene::moving::MovingObject;
use crate::scene::object::Object;

/// An object of the scene.
#[derive(Debug)]
pub(crate) struct InScene {
    pub id: SceneId,
    pub handle: ObjectHandle,
    pub object: Object,
    /// Motion of the object and the contacts with it, if it moves or can be moved.
    pub moving: Option<Box<(MovingObject, ContactGroup)>>,
    /// Held by all contact geometry with its surface.
    pub on_loan: Arc<()>,
}

/// Surface of an object that was removed while the haptic loop may still hold it.
#[derive(Debug)]
pub(crate) struct OnLoan {
    on_loan: Arc<()>,
    _surface: Option<Arc<FeatureMesh>>,
}

impl InScene {
    /// An object that stands still.
    pub fn new(id: SceneId, handle: ObjectHandle, object: &Object) -> Self {
        Self { id, handle, object: object.clone(), moving: None, on_loan: Arc::default() }
    }

    /// What is left of it when it is removed.
    pub fn on_loan(&self) -> OnLoan {
        OnLoan { on_loan: Arc::clone(&self.on_loan), _surface: self.object.known_features() }
    }

    /// Whether it neither moves nor can be moved.
    pub fn stands(&self) -> bool {
        self.moving.is_none()
    }

    /// Whether it is in another hand, whose motion the haptic loop knows.
    pub fn is_in_hand(&self) -> bool {
        self.moving.as_ref().is_some_and(|moving| moving.0.is_in_hand())
    }

    /// Bound on the speed of any of its points, m/s.
    pub fn speed(&self) -> f64 {
        let twist = self.moving.as_ref().map_or(Twist::ZERO, |moving| moving.0.twist());
        twist.linear.length() + twist.angular.length() * self.object.radius_about(DVec3::ZERO)
    }
}

impl OnLoan {
    /// Whether contact geometry still holds the surface.
    pub fn is_held(&mut self) -> bool {
        // The haptic loop lets go of the surface before it lets go of this.
        Arc::get_mut(&mut self.on_loan).is_none()
    }
}

/// The objects by their places in the query.
pub(crate) fn objects_of(objects: &[Option<InScene>]) -> Vec<Option<&Object>> {
    objects.iter().map(|place| place.as_ref().map(|object| &object.object)).collect()
}
