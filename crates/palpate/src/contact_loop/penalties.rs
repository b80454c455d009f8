//! The step of the contact loop that finds penalty contacts, those of its proxy, and assembles their model:
//! each group is reduced to few contacts, whose gains are limited.

use palpate_collide::{Cluster, PatchContact, QuerySettings, SceneQuery};
use palpate_core::glam::DVec3;
use palpate_core::{Contact, Pose, Twist};
use palpate_dynamics::{
    BodyState, ContactClass, ContactParameters, ContactPatch, CurvedContact, FoundContact,
    LinearContactModel, MovingBody,
};

use super::monitor::{ContactForce, MonitorFeed};
use super::{ContactLoop, ContactUpdate};
use crate::penalties::group::{ContactGroup, Counterpart};
use crate::penalties::in_scene::InScene;
use crate::penalties::merging::Plane;
use crate::penalties::proxy::{LevelFinder, carried, motion_between};
use crate::penalties::textures::Textures;
use crate::search::by_fields::{FieldFinder, in_steps};

impl ContactLoop {
    /// Finds the contacts that are penalty contacts, for the grasped object's state at `time` (s).
    pub(super) fn find_penalties(&mut self, body: &BodyState, time: f64) -> ContactUpdate {
        let interval = self.interval;
        let ahead = self.lookahead.horizon(interval);
        let tolerance = self.parameters.tolerance;
        let near = tolerance + self.textures.as_ref().map_or(0.0, Textures::protrusion);
        let lag = self.lookahead.limited_lag(self.proxy.lag());
        let motion = self.lookahead.motion_bound(&body.twist, self.fastest, ahead);
        let behind = if self.is_by_fields() { in_steps(lag, tolerance) } else { lag };
        let reach = (near + behind + motion).min(self.max_reach());
        self.move_proxy(&body.pose, reach);
        let depths = self.proxy.contacts().map(|found| found.contact.contact.depth);
        self.lookahead.adapt((motion, lag), near, depths);
        self.sort(body, ahead);
        self.show_patches(time);
        let probe_pose = body.pose * Pose::from_translation(-self.center_of_mass);
        let mut model = LinearContactModel::empty(&body.pose, time);
        let braking = self.braking_parameters(ahead);
        if self.is_by_fields() {
            self.push_represented(&mut model, body, interval);
        } else {
            self.push_touching(&mut model, &probe_pose, interval);
        }
        let mut depth = self.groups().fold(0.0, |depth: f64, group| depth.max(group.deepest()));
        let coarse = self.push_textured(&mut model, &mut depth, body, &braking, interval, ahead);
        self.push_approaching(&mut model, &braking, (&probe_pose, interval), (reach, ahead));
        let events = &mut self.telemetry.events;
        events.contact_refused += u64::from(model.refused());
        events.contact_overflow += u64::from(model.overflow());
        let contacts = self.groups().map(|group| group.touching.len()).sum::<usize>() + coarse;
        ContactUpdate::new(model, time, depth, contacts as u32)
    }

    /// Moves the proxy towards a pose of the body, with contacts found within a reach (m), and counts the
    /// queries' events.
    fn move_proxy(&mut self, goal: &Pose, reach: f64) {
        let Self { proxy, scene, .. } = self;
        let report = match &mut self.by_fields {
            Ok(by_fields) if self.textures.is_none() => {
                proxy.follow(goal, &mut FieldFinder { by_fields, scene, reach })
            }
            _ => {
                let settings = QuerySettings { tolerance: reach, ..self.settings };
                proxy.follow(goal, &mut LevelFinder { scene, settings })
            }
        };
        let events = &mut self.telemetry.events;
        events.contact_overflow += report.dropped as u64;
        events.contact_refused += u64::from(report.refused);
        events.not_converged += report.not_converged as u64;
        events.proxy_engaged += u64::from(proxy.pose() != goal);
    }

    /// Largest reach of the contact search, m.
    fn max_reach(&self) -> f64 {
        match &self.by_fields {
            Ok(fields) if self.textures.is_none() => fields.max_reach(),
            _ => self.probe.shape().max_tolerance(),
        }
    }

    /// Sorts the proxy's contacts, carried to the body's pose, into those within d and those that the body
    /// approaches within `ahead` (s). Contacts with a moving object go to its group, all others to that of
    /// the still objects.
    fn sort(&mut self, body: &BodyState, ahead: f64) {
        let tolerance = self.parameters.tolerance;
        self.still.clear();
        for &place in &self.moving {
            if let Some(InScene { moving: Some(moving), .. }) = &mut self.objects[place] {
                moving.1.clear();
            }
        }
        let textured = |object| self.textures.as_ref().is_some_and(|textures| textures.has(object));
        let (response, mass) = (self.response, self.mass);
        for found in self.proxy.contacts().filter(|found| !textured(found.object)) {
            let contact = carried(&found.contact.contact, self.proxy.pose(), &body.pose);
            let patch = PatchContact { contact, ..found.contact };
            let (with, group) = match moving_group(&mut self.objects, &self.scene, found.object) {
                Some(moving) => moving,
                None => (Counterpart::Still, &mut self.still),
            };
            if with.is_constraint(response, mass) {
                continue;
            }
            if contact.depth > -tolerance {
                group.touching.push(patch);
            } else if self.braking && comes_within(&contact, body, &with.body(), tolerance, ahead) {
                group.add_approaching(patch);
            }
        }
    }

    /// Adds the planes of representative contacts to a model, each with its share of the gains.
    fn push_represented(&mut self, model: &mut LinearContactModel, body: &BodyState, interval: f64) {
        let Ok(fields) = &mut self.by_fields else { return };
        let to_mesh = Pose::from_translation(-self.center_of_mass);
        let poses = (self.proxy.pose(), &body.pose);
        let tolerance = self.parameters.tolerance;
        let objects = (&mut self.still, self.objects.as_mut_slice(), self.moving.as_slice());
        let planes = fields.planes(poses, self.proxy.lag(), &to_mesh, tolerance, &mut self.scene, objects);
        let count_of = |place: Option<usize>| planes.iter().filter(|(of, _)| *of == place).count();
        for &(place, Plane { contact, weight, radius }) in planes {
            let gains = shared(&self.parameters, weight);
            let patch = ContactPatch { contact, radius };
            let with = counterpart(&self.objects, &self.scene, place);
            if with.is_constraint(self.response, self.mass) {
                continue;
            }
            let count = place.map_or(1, |_| count_of(place));
            let gains = with.gains(&gains, (contact.point, contact.normal), count, interval);
            model.push(ContactClass::Touching, patch, &gains, &with.body());
            show(&mut self.monitored, &contact, &gains);
        }
    }

    /// Adds the clusters of all groups' contacts within d to a model.
    fn push_touching(&mut self, model: &mut LinearContactModel, probe_pose: &Pose, interval: f64) {
        let Self { objects, scene, moving, still, monitored, parameters, .. } = self;
        let mut show =
            |cluster: &Cluster, gains: &ContactParameters| show(monitored, &cluster.contact, gains);
        let at = (probe_pose, interval);
        still.push_touching(model, &Counterpart::Still, parameters, at, &mut show);
        for &place in moving.iter() {
            if let Some((with, group)) = moving_group(objects, scene, place) {
                group.push_touching(model, &with, parameters, at, &mut show);
            }
        }
    }

    /// Adds the approaching contacts of all groups to a model.
    fn push_approaching(
        &mut self,
        model: &mut LinearContactModel,
        braking: &ContactParameters,
        at: (&Pose, f64),
        ahead: (f64, f64),
    ) {
        let Self { objects, scene, moving, still, .. } = self;
        still.push_approaching(model, &Counterpart::Still, braking, at, ahead);
        for &place in moving.iter() {
            if let Some((with, group)) = moving_group(objects, scene, place) {
                group.push_approaching(model, &with, braking, at, ahead);
            }
        }
    }

    /// Adds the contacts with textured objects to a model and raises `depth` (m) to the deepest of them.
    /// Returns the number of coarse contacts that they were found from.
    fn push_textured(
        &mut self,
        model: &mut LinearContactModel,
        depth: &mut f64,
        body: &BodyState,
        braking: &ContactParameters,
        interval: f64,
        ahead: f64,
    ) -> usize {
        let Some(textures) = &mut self.textures else { return 0 };
        let tolerance = self.parameters.tolerance;
        textures.clear();
        let mut coarse = 0;
        for found in self.proxy.found() {
            coarse += usize::from(textures.take(found.object, &found.contact, tolerance));
        }
        let pose = *self.proxy.pose();
        let mesh = pose * Pose::from_translation(-self.center_of_mass);
        let object_at = |place: usize| self.objects.get(place)?.as_ref();
        let pose_of = |place: usize| self.scene.pose(object_at(place)?.handle).copied();
        let events = &mut self.telemetry.events;
        let motion = motion_between(&pose, &body.pose);
        for found in textures.run(&mesh, pose.translation, pose_of, tolerance, events) {
            let CurvedContact { point, linear, .. } = found.contact;
            // The depth is found at the proxy; the body feels its expansion at its own pose.
            let now = found.depth_after(&motion);
            let normal = linear.normalize_or_zero();
            let with = counterpart(&self.objects, &self.scene, Some(found.object));
            let moving_body = with.body();
            let twist = relative_twist(&body.twist, pose.translation, &moving_body);
            let (class, gains) = if now > -tolerance {
                *depth = depth.max(now);
                let missed = found.is_undersampled(&twist, pose.translation, interval);
                events.texture_undersampled += u64::from(missed);
                if let Some(monitored) = &mut self.monitored {
                    let force = linear * (-self.parameters.stiffness * found.share * (now + tolerance));
                    monitored.snapshot().add_force(ContactForce { point, normal, force, depth: now });
                }
                (ContactClass::Touching, &self.parameters)
            } else if self.braking && now + found.rate(&twist) * ahead > -tolerance {
                (ContactClass::Approaching { braking_time: ahead }, braking)
            } else {
                continue;
            };
            let gains = with.gains(&shared(gains, found.share), (point, normal), 1, interval);
            model.push(class, FoundContact::Curved(&found.contact, &pose), &gains, &moving_body);
        }
        coarse
    }

    /// Gains of contacts that brake in a time t (s): damping b = 10 m / t, which stops a mass m in a tenth of
    /// the time.
    fn braking_parameters(&self, time: f64) -> ContactParameters {
        let damping = if time > 0.0 { 10.0 * self.mass / time } else { 0.0 };
        ContactParameters { damping: damping.max(self.parameters.damping), ..self.parameters }
    }
}

/// A contact's gains times its share.
fn shared(parameters: &ContactParameters, share: f64) -> ContactParameters {
    let ContactParameters { stiffness, damping, .. } = *parameters;
    ContactParameters { stiffness: stiffness * share, damping: damping * share, ..*parameters }
}

/// Whether a contact comes within a distance (m) in a time t (s) at the present velocities: δ + δ̇ t >
/// −distance, with δ̇ = (**v** − **v**_object) · **n**.
fn comes_within(contact: &Contact, body: &BodyState, object: &MovingBody, distance: f64, time: f64) -> bool {
    let arm = contact.point - body.pose.translation;
    let velocity = body.twist.velocity_at(arm) - object.twist.velocity_at(contact.point);
    let rate = velocity.dot(contact.normal);
    contact.depth + rate * time > -distance
}

/// The twist of a body about its `center` (m) relative to a moving object.
fn relative_twist(twist: &Twist, center: DVec3, object: &MovingBody) -> Twist {
    Twist {
        linear: twist.linear - object.twist.velocity_at(center),
        angular: twist.angular - object.twist.angular,
    }
}

/// The scene's side of contacts with the object at a place; still objects' without one.
pub(super) fn counterpart<'a>(
    objects: &'a [Option<InScene>],
    scene: &SceneQuery,
    place: Option<usize>,
) -> Counterpart<'a> {
    let moving = || {
        let InScene { id, handle, moving, .. } = objects.get(place?)?.as_ref()?;
        Some(Counterpart::Moving { object: &moving.as_ref()?.0, id: *id, pose: *scene.pose(*handle)? })
    };
    moving().unwrap_or(Counterpart::Still)
}

/// The group of contacts with the moving object at a place, and the scene's side of it; none if the object
/// stands still.
fn moving_group<'a>(
    objects: &'a mut [Option<InScene>],
    scene: &SceneQuery,
    place: usize,
) -> Option<(Counterpart<'a>, &'a mut ContactGroup)> {
    let InScene { id, handle, moving, .. } = objects.get_mut(place)?.as_mut()?;
    let (object, group) = moving.as_deref_mut()?;
    Some((Counterpart::Moving { object, id: *id, pose: *scene.pose(*handle)? }, group))
}

/// Adds the penalty force −k (δ + d) **n** of a contact to the snapshot, if there is a monitor.
fn show(monitored: &mut Option<MonitorFeed>, contact: &Contact, gains: &ContactParameters) {
    let Some(monitored) = monitored else { return };
    let Contact { point, normal, depth, .. } = *contact;
    let force = normal * (-gains.stiffness * (depth + gains.tolerance));
    monitored.snapshot().add_force(ContactForce { point, normal, force, depth });
}
