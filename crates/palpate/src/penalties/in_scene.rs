//! The scene objects of a contact loop.

use std::sync::Arc;

use palpate_collide::{ObjectHandle, SceneQuery};
use palpate_core::Twist;
use palpate_core::glam::DVec3;
use palpate_field::FeatureMesh;

use super::group::{ContactGroup, Counterpart};
use crate::constraints::geometry::PredictedMotion;
use crate::scene::moving::MovingObject;
use crate::scene::object::Object;
use crate::scene::{Placed, SceneId};

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

/// The scene objects by their places in the contact query.
#[derive(Debug)]
pub(crate) struct SceneObjects {
    pub query: SceneQuery,
    pub objects: Vec<Option<InScene>>,
    /// Places of those that move or can be moved.
    pub moving: Vec<usize>,
    /// Bound on the speed of any point of the moving ones near the body, m/s.
    pub fastest: f64,
    /// Motion of those that contacts push, by the haptic loop.
    pub predicted: Option<triple_buffer::Output<PredictedMotion>>,
    /// Surfaces of removed ones that the haptic loop may still hold. Large ones take milliseconds to free,
    /// which is done here once it has let go.
    pub on_loan: Vec<OnLoan>,
}

impl SceneObjects {
    /// Puts objects into a query for a probe, with workspaces for the first `reserved` of them.
    pub fn new(probe: &Object, scene: &[Placed], reserved: usize) -> Self {
        let mut query = SceneQuery::new(probe.shape());
        let mut objects = Vec::with_capacity(scene.len());
        for (index, Placed { object, pose }) in scene.iter().enumerate() {
            let handle = query.add(object.shape(), pose);
            objects.push(Some(InScene::new(SceneId(index), handle, object)));
        }
        for (index, placed) in scene.iter().enumerate().take(reserved) {
            let same = |other: &&Placed| Arc::ptr_eq(&other.object.clod, &placed.object.clod);
            query.reserve(placed.object.shape(), scene[..=index].iter().filter(same).count());
        }
        let (moving, on_loan) = (Vec::new(), Vec::new());
        Self { query, objects, moving, fastest: 0.0, predicted: None, on_loan }
    }

    /// Those that there are.
    pub fn iter(&self) -> impl Iterator<Item = &InScene> {
        self.objects.iter().flatten()
    }

    /// The object at a place.
    pub fn get(&self, place: usize) -> Option<&InScene> {
        self.objects.get(place)?.as_ref()
    }

    /// Place of an object.
    pub fn place_of(&self, id: SceneId) -> Option<usize> {
        self.objects.iter().position(|object| object.as_ref().is_some_and(|object| object.id == id))
    }

    /// The objects alone, by their places.
    pub fn by_place(&self) -> Vec<Option<&Object>> {
        self.objects.iter().map(|place| place.as_ref().map(|known| &known.object)).collect()
    }

    /// The scene's side of contacts with the object at a place; still objects' without one.
    pub fn counterpart(&self, place: Option<usize>) -> Counterpart<'_> {
        let moving = || {
            let InScene { id, handle, moving, .. } = self.get(place?)?;
            let pose = *self.query.pose(*handle)?;
            Some(Counterpart::Moving { object: &moving.as_ref()?.0, id: *id, pose })
        };
        moving().unwrap_or(Counterpart::Still)
    }

    /// The groups of contacts with the moving objects.
    pub fn groups(&self) -> impl Iterator<Item = &ContactGroup> {
        self.moving.iter().filter_map(|&place| Some(&self.get(place)?.moving.as_ref()?.1))
    }

    /// The same, to change.
    pub fn groups_mut(&mut self) -> impl Iterator<Item = &mut ContactGroup> {
        self.objects.iter_mut().flatten().filter_map(|known| Some(&mut known.moving.as_mut()?.1))
    }

    /// The group of contacts with the moving object at a place, and the scene's side of it; `None` if the
    /// object stands still.
    pub fn group_of(&mut self, place: usize) -> Option<(Counterpart<'_>, &mut ContactGroup)> {
        let InScene { id, handle, moving, .. } = self.objects.get_mut(place)?.as_mut()?;
        let (object, group) = moving.as_deref_mut()?;
        Some((Counterpart::Moving { object, id: *id, pose: *self.query.pose(*handle)? }, group))
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::Pose;

    use super::*;
    use crate::constraints::test_meshes::block;

    /// Of two objects, the one that is to move has a group of contacts and is a counterpart of its own; the
    /// other one counts as still, and so does one that is gone.
    #[test]
    fn moving_objects_have_groups_of_their_own() {
        let object = Object::from_mesh("box", &block(DVec3::splat(0.01))).expect("a box");
        let placed = [-0.1, 0.1]
            .map(|x| Placed { object: object.clone(), pose: Pose::from_translation(DVec3::X * x) });
        let mut scene = SceneObjects::new(&object, &placed, 2);
        let places = [0, 1].map(|index| scene.place_of(SceneId(index)).expect("a place"));
        assert_eq!((scene.iter().count(), scene.groups().count(), scene.place_of(SceneId(2))), (2, 0, None));
        let [still, moves] = places;
        let made = (MovingObject::new(), ContactGroup::with_moving(3, 0.01));
        scene.objects[moves].as_mut().expect("an object").moving = Some(Box::new(made));
        scene.moving.push(moves);
        assert!(
            scene.group_of(still).is_none() && matches!(scene.counterpart(Some(still)), Counterpart::Still)
        );
        assert!(matches!(scene.counterpart(None), Counterpart::Still));
        let Some((Counterpart::Moving { id, pose, .. }, _)) = scene.group_of(moves) else {
            panic!("a group")
        };
        assert_eq!((id, pose.translation), (SceneId(1), DVec3::X * 0.1));
        let Counterpart::Moving { id, .. } = scene.counterpart(Some(moves)) else { panic!("it moves") };
        assert_eq!((id, scene.groups().count(), scene.groups_mut().count()), (SceneId(1), 1, 1));
        let named: Vec<_> = scene.by_place().iter().map(Option::is_some).collect();
        assert_eq!(named, [true, true]);
        scene.objects[moves] = None;
        assert!(
            scene.group_of(moves).is_none() && matches!(scene.counterpart(Some(moves)), Counterpart::Still)
        );
        assert_eq!((scene.groups().count(), scene.place_of(SceneId(1))), (0, None));
    }
}
