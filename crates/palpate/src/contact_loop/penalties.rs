//! The step of the contact loop that finds penalty contacts, those of its proxy, and assembles their model:
//! each group is reduced to few contacts, whose gains are limited.

use palpate_collide::{Cluster, PatchContact, QuerySettings};
use palpate_core::glam::DVec3;
use palpate_core::{Contact, Pose, Twist};
use palpate_dynamics::{
    BodyState, ContactClass, ContactParameters, ContactPatch, CurvedContact, FoundContact,
    LinearContactModel, MovingBody,
};

use super::monitor::ContactForce;
use super::state::PenaltySearch;
use super::{ContactLoop, ContactUpdate};
use crate::penalties::group::{ContactGroup, Counterpart};
use crate::penalties::merging::Plane;
use crate::penalties::proxy::{LevelFinder, carried, motion_between};
use crate::penalties::textures::Textures;
use crate::search::by_fields::{FieldFinder, in_steps};

impl ContactLoop {
    /// Finds the contacts that are penalty contacts, for the grasped object's state at `time` (s).
    pub(super) fn find_penalties(&mut self, body: &BodyState, time: f64) -> ContactUpdate {
        let interval = self.timing.interval;
        let ahead = self.penalties.lookahead.horizon(interval);
        let tolerance = self.parameters.tolerance;
        let near = tolerance + self.penalties.textures.as_ref().map_or(0.0, Textures::protrusion);
        let lag = self.penalties.lookahead.limited_lag(self.penalties.proxy.lag());
        let motion = self.penalties.lookahead.motion_bound(&body.twist, self.scene.fastest, ahead);
        let behind = if self.is_by_fields() { in_steps(lag, tolerance) } else { lag };
        let reach = (near + behind + motion).min(self.max_reach());
        self.move_proxy(&body.pose, reach);
        let depths = self.penalties.proxy.contacts().map(|found| found.contact.contact.depth);
        self.penalties.lookahead.adapt((motion, lag), near, depths);
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
        let scene = &mut self.scene.query;
        let PenaltySearch { proxy, settings, by_fields, textures, .. } = &mut self.penalties;
        let report = match by_fields {
            Ok(by_fields) if textures.is_none() => {
                proxy.follow(goal, &mut FieldFinder { by_fields, scene, reach })
            }
            _ => {
                let settings = QuerySettings { tolerance: reach, ..*settings };
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
        match &self.penalties.by_fields {
            Ok(fields) if self.penalties.textures.is_none() => fields.max_reach(),
            _ => self.probe.shape().max_tolerance(),
        }
    }

    /// Sorts the proxy's contacts, carried to the body's pose, into those within d and those that the body
    /// approaches within `ahead` (s). Contacts with a moving object go to its group, all others to that of
    /// the still objects.
    fn sort(&mut self, body: &BodyState, ahead: f64) {
        let tolerance = self.parameters.tolerance;
        let (response, mass) = (self.response, self.mass);
        let PenaltySearch { proxy, still, textures, braking, .. } = &mut self.penalties;
        still.clear();
        self.scene.groups_mut().for_each(ContactGroup::clear);
        let textured = |object| textures.as_ref().is_some_and(|textures| textures.has(object));
        for found in proxy.contacts().filter(|found| !textured(found.object)) {
            let contact = carried(&found.contact.contact, proxy.pose(), &body.pose);
            let patch = PatchContact { contact, ..found.contact };
            let (with, group) = match self.scene.group_of(found.object) {
                Some(moving) => moving,
                None => (Counterpart::Still, &mut *still),
            };
            if with.is_constraint(response, mass) {
                continue;
            }
            if contact.depth > -tolerance {
                group.touching.push(patch);
            } else if *braking && comes_within(&contact, body, &with.body(), tolerance, ahead) {
                group.add_approaching(patch);
            }
        }
    }

    /// Adds the planes of representative contacts to a model, each with its share of the gains.
    fn push_represented(&mut self, model: &mut LinearContactModel, body: &BodyState, interval: f64) {
        let Ok(fields) = &mut self.penalties.by_fields else { return };
        let to_mesh = Pose::from_translation(-self.center_of_mass);
        let poses = (self.penalties.proxy.pose(), &body.pose);
        let tolerance = self.parameters.tolerance;
        let objects =
            (&mut self.penalties.still, self.scene.objects.as_mut_slice(), self.scene.moving.as_slice());
        let planes = fields.planes(
            poses,
            self.penalties.proxy.lag(),
            &to_mesh,
            tolerance,
            &mut self.scene.query,
            objects,
        );
        let count_of = |place: Option<usize>| planes.iter().filter(|(of, _)| *of == place).count();
        for &(place, Plane { contact, weight, radius }) in planes {
            let gains = shared(&self.parameters, weight);
            let patch = ContactPatch { contact, radius };
            let with = self.scene.counterpart(place);
            if with.is_constraint(self.response, self.mass) {
                continue;
            }
            let count = place.map_or(1, |_| count_of(place));
            let gains = with.gains(&gains, (contact.point, contact.normal), count, interval);
            model.push(ContactClass::Touching, patch, &gains, &with.body());
            self.shown.add(&contact, &gains);
        }
    }

    /// Adds the clusters of all groups' contacts within d to a model.
    fn push_touching(&mut self, model: &mut LinearContactModel, probe_pose: &Pose, interval: f64) {
        let Self { scene, penalties, shown, parameters, .. } = self;
        let mut show = |cluster: &Cluster, gains: &ContactParameters| shown.add(&cluster.contact, gains);
        let at = (probe_pose, interval);
        penalties.still.push_touching(model, &Counterpart::Still, parameters, at, &mut show);
        for index in 0..scene.moving.len() {
            if let Some((with, group)) = scene.group_of(scene.moving[index]) {
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
        let Self { scene, penalties, .. } = self;
        penalties.still.push_approaching(model, &Counterpart::Still, braking, at, ahead);
        for index in 0..scene.moving.len() {
            if let Some((with, group)) = scene.group_of(scene.moving[index]) {
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
        let Some(textures) = &mut self.penalties.textures else { return 0 };
        let tolerance = self.parameters.tolerance;
        textures.clear();
        let mut coarse = 0;
        for found in self.penalties.proxy.found() {
            coarse += usize::from(textures.take(found.object, &found.contact, tolerance));
        }
        let pose = *self.penalties.proxy.pose();
        let mesh = pose * Pose::from_translation(-self.center_of_mass);
        let object_at = |place: usize| self.scene.get(place);
        let pose_of = |place: usize| self.scene.query.pose(object_at(place)?.handle).copied();
        let events = &mut self.telemetry.events;
        let motion = motion_between(&pose, &body.pose);
        for found in textures.run(&mesh, pose.translation, pose_of, tolerance, events) {
            let CurvedContact { point, linear, .. } = found.contact;
            // The depth is found at the proxy; the body feels its expansion at its own pose.
            let now = found.depth_after(&motion);
            let normal = linear.normalize_or_zero();
            let with = self.scene.counterpart(Some(found.object));
            let moving_body = with.body();
            let twist = relative_twist(&body.twist, pose.translation, &moving_body);
            let (class, gains) = if now > -tolerance {
                *depth = depth.max(now);
                let missed = found.is_undersampled(&twist, pose.translation, interval);
                events.texture_undersampled += u64::from(missed);
                if let Some(monitored) = &mut self.shown.monitored {
                    let force = linear * (-self.parameters.stiffness * found.share * (now + tolerance));
                    monitored.snapshot().add_force(ContactForce { point, normal, force, depth: now });
                }
                (ContactClass::Touching, &self.parameters)
            } else if self.penalties.braking && now + found.rate(&twist) * ahead > -tolerance {
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
