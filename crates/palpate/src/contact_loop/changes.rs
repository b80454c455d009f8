//! Changes of the scene and of live settings between the steps of the contact loop.

use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist};
use palpate_dynamics::BodyState;

use super::{ContactLoop, any_refined, query_settings};
use crate::constraints::geometry::PredictedMotion;
use crate::penalties::group::ContactGroup;
use crate::penalties::in_scene::InScene;
use crate::penalties::textures::Textures;
use crate::scene::SceneId;
use crate::scene::editor::{Edit, Needs, SceneEditor};
use crate::scene::moving::{DynamicBody, HandMotion, MovingObject};
use crate::scene::object::Object;
use crate::search::unfit;
use crate::settings::live::{ContactTuning, Ramp};
use crate::settings::{ContactSearch, Response};

impl ContactLoop {
    /// Puts a scene object at a pose (mesh frame to world) from the next step on; `false` if it does not
    /// exist. Contacts are rendered as if the object stood still there ([`SceneEditor::set_pose`]).
    pub fn set_pose(&mut self, object: SceneId, pose: &Pose) -> bool {
        let Some(place) = self.scene.place_of(object) else { return false };
        let Some(InScene { handle, moving, .. }) = &mut self.scene.objects[place] else { return false };
        if let Some(moving) = moving {
            moving.0.stop();
        }
        let handle = *handle;
        self.penalties.scene_has_changed();
        self.scene.query.set_pose(handle, pose)
    }

    /// Sets the pose and the velocity of a moving scene object at the time of the next step; `false` if it
    /// does not exist ([`SceneEditor::set_motion`]).
    pub fn set_motion(&mut self, object: SceneId, pose: &Pose, twist: &Twist) -> bool {
        self.set_motion_at(object, (pose, twist), self.timing.time)
    }

    /// Sets the pose and the velocity that a moving scene object had at a time (s); `false` if it does not
    /// exist.
    fn set_motion_at(&mut self, object: SceneId, (pose, twist): (&Pose, &Twist), time: f64) -> bool {
        self.moving(object).map(|moving| moving.set_motion(pose, twist, time)).is_some()
    }

    /// Follows the objects that contacts push, as the haptic loop moves them.
    pub(crate) fn follow_predicted(&mut self, predicted: triple_buffer::Output<PredictedMotion>) {
        self.scene.predicted = Some(predicted);
    }

    /// Sets how contacts move a scene object, from the next step on; `false` if it does not exist
    /// ([`SceneEditor::set_dynamics`]).
    pub fn set_dynamics(&mut self, object: SceneId, body: Option<DynamicBody>) -> bool {
        self.moving(object).map(|moving| moving.set_dynamics(body)).is_some()
    }

    /// Motion of a scene object, which becomes a moving one if it was still.
    fn moving(&mut self, object: SceneId) -> Option<&mut MovingObject> {
        let place = self.scene.place_of(object)?;
        let InScene { moving, .. } = self.scene.objects[place].as_mut()?;
        if moving.is_none() {
            self.scene.moving.push(place);
        }
        let radius = self.probe.bounding_radius();
        let clusters = self.all_settings.search.clusters;
        let made = || Box::new((MovingObject::new(), ContactGroup::with_moving(clusters, radius)));
        Some(&mut moving.get_or_insert_with(made).0)
    }

    /// Adds an object at a pose (mesh frame to world) from the next step on; `false` if the id is taken or
    /// its texture cannot be rendered. Allocates.
    pub fn add(&mut self, id: SceneId, object: &Object, pose: &Pose) -> bool {
        let added = self.insert(id, object, pose);
        if let Some(editor) = self.live.editor.as_ref().filter(|_| added) {
            editor.note(id, Some(object));
        }
        added
    }

    fn insert(&mut self, id: SceneId, object: &Object, pose: &Pose) -> bool {
        self.scene.place_of(id).is_none() && self.exchange(None, id, object, pose)
    }

    /// Puts a new object in the place of the one at a place, if there is one; `false`, and the old one stays,
    /// if the new one cannot be rendered.
    fn exchange(&mut self, old: Option<usize>, id: SceneId, object: &Object, pose: &Pose) -> bool {
        let handle = self.scene.query.add(object.shape(), pose);
        let place = handle.place();
        if self.scene.objects.len() <= place {
            self.scene.objects.resize_with(place + 1, || None);
        }
        let mut before = old.and_then(|old| self.scene.objects[old].take());
        let mut made = InScene::new(id, handle, object);
        made.moving = before.as_mut().and_then(|before| before.moving.take());
        self.scene.objects[place] = Some(made);
        // Textures are as they were if they cannot be made; then the field is not looked at.
        let is_textured = |object: Option<&Object>| object.is_some_and(|object| object.texture().is_some());
        let renews = is_textured(Some(object)) || is_textured(before.as_ref().map(|before| &before.object));
        let is_rendered = self.retexture(renews);
        if is_rendered && self.insert_field(place, object) {
            if let (Some(before), Some(old)) = (&before, old) {
                self.let_go(old, before);
                if self.scene.get(place).is_some_and(|object| !object.stands()) {
                    self.scene.moving.push(place);
                }
            }
            self.penalties.scene_has_changed();
            self.ran.objects = self.ran.objects.max(self.scene.iter().count());
            return true;
        }
        let made = self.scene.objects[place].take();
        self.constraints.pairs.remove(place);
        self.scene.query.remove(handle);
        if let (Some(old), Some(mut before)) = (old, before) {
            before.moving = made.and_then(|made| made.moving);
            self.scene.objects[old] = Some(before);
        }
        if is_rendered {
            self.retexture(renews);
        }
        false
    }

    /// Adds an object's field at its place, if contacts are found in fields. If the object has no suitable
    /// field, the search changes to levels; `false` if the settings rule that out.
    fn insert_field(&mut self, place: usize, object: &Object) -> bool {
        let Ok(fields) = &mut self.penalties.by_fields else { return true };
        if self.all_settings.search.method == ContactSearch::Automatic
            && let Some(why) = unfit(&fields.needs, object)
        {
            self.penalties.by_fields = Err(why);
            return true;
        }
        fields.insert(place, object, false).is_ok()
    }

    /// Removes an object from the next step on; `false` if it does not exist.
    pub fn remove(&mut self, id: SceneId) -> bool {
        if let Some(editor) = &self.live.editor {
            editor.note(id, None);
        }
        self.delete(id)
    }

    fn delete(&mut self, id: SceneId) -> bool {
        let Some(place) = self.scene.place_of(id) else { return false };
        let Some(removed) = self.scene.objects[place].take() else { return false };
        self.penalties.scene_has_changed();
        self.let_go(place, &removed);
        self.retexture(removed.object.texture().is_some())
    }

    /// Lets go of an object that was at a place.
    fn let_go(&mut self, place: usize, removed: &InScene) {
        if let Ok(fields) = &mut self.penalties.by_fields {
            fields.remove(place);
        }
        self.constraints.pairs.remove(place);
        self.scene.query.remove(removed.handle);
        self.scene.moving.retain(|&moving| moving != place);
        self.scene.on_loan.push(removed.on_loan());
    }

    /// Replaces an object by another, which keeps its id and its dynamics; `false` if that cannot be
    /// rendered, and the object stays.
    fn replace(&mut self, id: SceneId, object: &Object, pose: &Pose) -> bool {
        let Some(place) = self.scene.place_of(id) else { return false };
        if !self.exchange(Some(place), id, object, pose) {
            return false;
        }
        let known = self.scene.place_of(id).and_then(|place| self.scene.objects[place].as_mut());
        if let Some(moving) = known.and_then(|known| known.moving.as_mut()) {
            moving.0.stop();
        }
        true
    }

    /// Adds an object that is in another hand, at a pose (mesh frame to world). Without a body, the other
    /// session finds the contacts with it.
    pub(crate) fn add_in_hand(
        &mut self,
        object: &Object,
        pose: &Pose,
        leader: triple_buffer::Output<HandMotion>,
        body: Option<DynamicBody>,
    ) -> Option<SceneId> {
        let id = self.next_id();
        if !self.add(id, object, pose) {
            return None;
        }
        let place = self.scene.place_of(id)?;
        let radius = self.probe.bounding_radius();
        let moving = MovingObject::in_hand(leader, body);
        let group = ContactGroup::with_moving(self.all_settings.search.clusters, radius);
        self.scene.objects[place].as_mut()?.moving = Some(Box::new((moving, group)));
        self.scene.moving.push(place);
        Some(id)
    }

    fn next_id(&self) -> SceneId {
        if let Some(editor) = &self.live.editor {
            return editor.next_id();
        }
        SceneId(self.scene.iter().map(|object| object.id.0 + 1).max().unwrap_or(0))
    }

    /// Rebuilds the textures of the scene if the object that was added or removed is textured, or any other;
    /// `false` if they cannot be rendered, and are as they were.
    fn retexture(&mut self, is_textured: bool) -> bool {
        if self.penalties.textures.is_none() && !is_textured && self.probe.texture().is_none() {
            return true;
        }
        let objects = self.scene.by_place();
        let tolerance = self.parameters.tolerance;
        let made = Textures::renew(
            &mut self.penalties.textures,
            &self.probe,
            &objects,
            &self.all_settings,
            tolerance,
            self.radius,
        );
        self.penalties.keep_recesses();
        made.is_ok()
    }

    /// An editor that changes the scene from another thread, from the next step on. Each call returns another
    /// handle to the same editor.
    pub fn editor(&mut self) -> SceneEditor {
        if let Some(editor) = &self.live.editor {
            return editor.clone();
        }
        let fields = self.penalties.by_fields.as_ref().ok().map(|fields| fields.needs.options());
        let needs = Needs { fields, features: self.response == Response::Constraints };
        let known = self.scene.iter().map(|known| (known.id, known.object.clone()));
        let editor = SceneEditor::new(known, needs);
        self.live.edits = Some(editor.add_loop(&self.probe));
        self.live.editor.insert(editor).clone()
    }

    /// Connects the editor of another loop with the same scene to this one as well.
    pub(crate) fn follow_editor(&mut self, editor: &SceneEditor) {
        if self.live.editor.is_none() {
            self.live.edits = Some(editor.add_loop(&self.probe));
            self.live.editor = Some(editor.clone());
        }
    }

    /// Makes the pending changes of the scene.
    pub(super) fn make_edits(&mut self) {
        while let Some(edit) = self.live.edits.as_mut().and_then(|edits| edits.pop().ok()) {
            let made = match edit {
                Edit::Add(id, object, pose) => self.insert(id, &object, &pose),
                Edit::Replace(id, object, pose) => self.replace(id, &object, &pose),
                Edit::Move(id, pose) => self.set_pose(id, &pose),
                Edit::Motion(id, pose, twist, time) => {
                    let time = if time.is_nan() { self.timing.time } else { time };
                    self.set_motion_at(id, (&pose, &twist), time)
                }
                Edit::DynamicBody(id, body) => self.set_dynamics(id, body),
                Edit::Remove(id) => self.delete(id),
            };
            self.telemetry.events.edit_refused += u64::from(!made);
        }
    }

    /// Moves gains and s₀ towards the tuned ones over the time (s) since the last step.
    pub(super) fn tune(&mut self, interval: f64) {
        while let Some(tuning) = self.live.tunings.as_mut().and_then(|tunings| tunings.pop().ok()) {
            let ContactTuning { response, parameters, error, interpolation, query_budget } = tuning;
            if self.may_constrain {
                self.response = response;
            }
            let objects = self.scene.iter().map(|object| &object.object);
            let error = if any_refined(objects.chain([&self.probe])) { error } else { 0.0 };
            // Levels are interpolated until full resolution is reached.
            let coarsest = error.max(self.error);
            self.penalties.settings =
                query_settings(parameters.tolerance, coarsest, interpolation, query_budget);
            if let Ok(fields) = &mut self.penalties.by_fields {
                fields.needs.set_budget(query_budget);
            }
            self.live.tuning = Some(Ramp::new((self.parameters, self.error), (parameters, error)));
        }
        if let Some(ramp) = &mut self.live.tuning {
            let ((parameters, error), ended) = ramp.advance(interval);
            (self.parameters, self.error) = (parameters, error);
            self.penalties.settings.error = error.into();
            if ended {
                self.penalties.settings.interpolate &=
                    error > 0.0 || self.penalties.settings.budget.is_some();
                self.live.tuning = None;
            }
        }
    }

    /// Advances the moving objects to a time (s). The proxy's contacts with those near the body move along.
    pub(super) fn move_objects(&mut self, body: &BodyState, time: f64) {
        self.scene.fastest = 0.0;
        let predicted = self.scene.predicted.as_mut().map(triple_buffer::Output::read);
        for &place in &self.scene.moving {
            let Some(moved) = &mut self.scene.objects[place] else { continue };
            if let Some(moving) = &mut moved.moving {
                let own = predicted.and_then(|all| all.iter().find(|(id, _, _)| *id == moved.id));
                moving.0.set_predicted(own.map(|(_, pose, twist)| (*pose, *twist)));
            }
            let Some(pose) = moved.moving.as_mut().and_then(|moving| moving.0.advance(time)) else {
                continue;
            };
            let Some(before) = self.scene.query.pose(moved.handle).copied() else { continue };
            if before == pose {
                continue;
            }
            self.scene.query.set_pose(moved.handle, &pose);
            if let Ok(fields) = &mut self.penalties.by_fields {
                fields.scene_has_changed();
            }
            let size = moved.object.radius_about(DVec3::ZERO);
            if pose.translation.distance(body.pose.translation)
                < size + self.radius + self.penalties.lookahead.max_motion()
            {
                self.penalties.proxy.object_has_moved(place, &before, &pose);
                self.scene.fastest = self.scene.fastest.max(moved.speed());
            }
        }
    }
}

#[cfg(test)]
mod tests;
