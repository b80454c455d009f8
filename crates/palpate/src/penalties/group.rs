//! Groups of contacts: those with all still objects, or those with one moving object.
//!
//! Each group is reduced to a few contacts of its own, with gains that suit its object, before they go into
//! the contact model.

use palpate_collide::{Cluster, Clustering, PatchContact};
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::{
    ContactClass, ContactParameters, ContactPatch, LinearContactModel, MAX_APPROACHING, MovingBody,
};

use super::merging::Merging;
use crate::scene::SceneId;
use crate::scene::moving::MovingObject;
use crate::settings::Response;

/// Contacts that a group has room for from the start.
const RESERVED: usize = 512;

/// Largest number of clusters of contacts with one moving object: enough to hold a face. With more, two such
/// objects and the still ones would exceed the budget of a contact model.
const MOVING_CLUSTERS: usize = 3;

/// Smallest mass of an object that contacts push as constraints, in masses of the body in the hand. With
/// less, lighter ones that lean on soft ones are restless where their host answers late; with more, contacts
/// with heavier ones are as soft as penalties have to be.
const MIN_MASS: f64 = 0.5;

/// The scene's side of a group.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Counterpart<'a> {
    /// All still objects.
    Still,
    /// A moving object with its mesh's frame at a pose.
    Moving { object: &'a MovingObject, id: SceneId, pose: Pose },
}

impl Counterpart<'_> {
    /// Motion of the object.
    pub fn body(&self) -> MovingBody {
        match self {
            Self::Still => MovingBody::STILL,
            Self::Moving { object, id, pose } => object.moving_body(*id, pose),
        }
    }

    /// Whether contacts with the object are no penalty contacts, for a body in the hand of a mass (kg).
    pub fn is_constraint(&self, response: Response, held: f64) -> bool {
        let Self::Moving { object, .. } = self else { return response == Response::Constraints };
        let is_light = object.is_lighter(MIN_MASS * held);
        object.is_felt_elsewhere() || response == Response::Constraints && !is_light
    }

    /// Gains of one of `count` contacts with the object, at a point (m) with a normal, limited to what is
    /// stable with an object of its mass when contacts are found every `interval` (s).
    pub fn gains(
        &self,
        gains: &ContactParameters,
        at: (DVec3, DVec3),
        count: usize,
        interval: f64,
    ) -> ContactParameters {
        match self {
            Self::Still => *gains,
            Self::Moving { object, pose, .. } => object.limited_gains(gains, pose, at, count, interval),
        }
    }
}

/// Contacts of a group, with the clusters carried from step to step.
#[derive(Debug)]
pub(crate) struct ContactGroup {
    /// Contacts within d.
    pub touching: Vec<PatchContact>,
    /// Contacts further apart that the body approaches.
    approaching: Vec<PatchContact>,
    clustering: Clustering,
    /// `None` if only the nearest approaching contact is kept.
    approaching_clusters: Option<Clustering>,
    /// Reduces the contacts found in fields.
    pub merging: Merging,
}

impl ContactGroup {
    /// Makes the group of all still objects, with at most `clusters` clusters, for a probe of a radius (m).
    pub fn with_still(clusters: usize, radius: f64) -> Self {
        Self {
            touching: Vec::with_capacity(RESERVED),
            approaching: Vec::with_capacity(RESERVED),
            clustering: Clustering::new(clusters),
            approaching_clusters: Some(Clustering::new(MAX_APPROACHING)),
            merging: Merging::new(clusters, radius),
        }
    }

    /// Makes the group of one moving object.
    pub fn with_moving(clusters: usize, radius: f64) -> Self {
        let clusters = clusters.min(MOVING_CLUSTERS);
        Self {
            touching: Vec::new(),
            approaching: Vec::new(),
            clustering: Clustering::new(clusters),
            approaching_clusters: None,
            merging: Merging::new(clusters, radius),
        }
    }

    /// Removes the contacts of the last step; clusters are carried on.
    pub fn clear(&mut self) {
        self.touching.clear();
        self.approaching.clear();
    }

    /// Adds a contact that the body approaches.
    pub fn add_approaching(&mut self, contact: PatchContact) {
        match self.approaching.first_mut() {
            Some(nearest) if self.approaching_clusters.is_none() => {
                if nearest.contact.depth < contact.contact.depth {
                    *nearest = contact;
                }
            }
            _ => self.approaching.push(contact),
        }
    }

    /// Largest penetration, m; 0 without any.
    pub fn deepest(&self) -> f64 {
        self.touching.iter().fold(0.0, |most: f64, found| most.max(found.contact.depth))
    }

    /// Clusters the contacts within d and adds the clusters to a model. `shown` gets each cluster with its
    /// gains.
    pub fn push_touching(
        &mut self,
        model: &mut LinearContactModel,
        with: &Counterpart<'_>,
        gains: &ContactParameters,
        (probe_pose, interval): (&Pose, f64),
        mut shown: impl FnMut(&Cluster, &ContactParameters),
    ) {
        if self.touching.is_empty() && matches!(with, Counterpart::Moving { .. }) {
            self.clustering.reset();
            return;
        }
        let clusters = self.clustering.run(&self.touching, gains.tolerance, probe_pose);
        let body = with.body();
        for cluster in clusters {
            let Cluster { contact, radius, .. } = *cluster;
            let gains = with.gains(gains, (contact.point, contact.normal), clusters.len(), interval);
            model.push(ContactClass::Touching, ContactPatch { contact, radius }, &gains, &body);
            shown(cluster, &gains);
        }
    }

    /// Adds the approaching contacts, found within a reach (m), to a model: they brake the body from
    /// `braking_time` (s) before it would touch.
    pub fn push_approaching(
        &mut self,
        model: &mut LinearContactModel,
        with: &Counterpart<'_>,
        gains: &ContactParameters,
        (probe_pose, interval): (&Pose, f64),
        (reach, braking_time): (f64, f64),
    ) {
        let body = with.body();
        let class = ContactClass::Approaching { braking_time };
        match &mut self.approaching_clusters {
            Some(clustering) => {
                for cluster in clustering.run(&self.approaching, reach, probe_pose) {
                    model.push(class, cluster.contact, gains, &body);
                }
            }
            None => {
                for PatchContact { contact, .. } in &self.approaching {
                    let gains = with.gains(gains, (contact.point, contact.normal), 1, interval);
                    model.push(class, *contact, &gains, &body);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::{Contact, Twist};
    use palpate_dynamics::{BodyState, Friction};

    use super::*;
    use crate::scene::moving::DynamicBody;

    const GAINS: ContactParameters =
        ContactParameters { stiffness: 1000.0, damping: 0.0, tolerance: 1e-3, friction: Friction::NONE };

    fn contact(point: DVec3, depth: f64) -> PatchContact {
        let contact = Contact { point, scene_point: point - DVec3::Z * depth, normal: DVec3::Z, depth };
        PatchContact { contact, probe_node: 0, scene_node: 0, weight: 1.0 }
    }

    fn model() -> LinearContactModel {
        LinearContactModel::empty(&Pose::IDENTITY, 0.0)
    }

    /// However many contacts a face has, it is as stiff as its clusters, and none is dropped from the model.
    #[test]
    fn a_group_pushes_no_more_contacts_than_its_clusters() {
        for clusters in [1, 3, 5] {
            let mut group = ContactGroup::with_still(clusters, 0.1);
            for i in 0..100 {
                let (x, y) = (f64::from(i % 10), f64::from(i / 10));
                group.touching.push(contact(DVec3::new(x, y, 0.0) * 0.01, 1e-4));
            }
            let (mut model, mut shown) = (model(), 0);
            group.push_touching(&mut model, &Counterpart::Still, &GAINS, (&Pose::IDENTITY, 1e-3), |_, _| {
                shown += 1
            });
            assert_eq!((model.contacts().len(), model.overflow()), (clusters, 0));
            assert_eq!(shown, clusters);
            let force = model.wrench(&BodyState::at_rest(Pose::IDENTITY)).force;
            let wanted = -(clusters as f64) * GAINS.stiffness * (1e-4 + GAINS.tolerance);
            assert!((force.z - wanted).abs() < 1e-9 * wanted.abs(), "{force} N, not {wanted}");
            assert_eq!(group.deepest(), 1e-4);
        }
    }

    #[test]
    fn the_nearest_approaching_contact_with_a_moving_object_is_kept() {
        let mut group = ContactGroup::with_moving(5, 0.1);
        for depth in [-4e-3, -2e-3, -3e-3] {
            group.add_approaching(contact(DVec3::ZERO, depth));
        }
        let object = MovingObject::new();
        let with = Counterpart::Moving { object: &object, id: SceneId(0), pose: Pose::IDENTITY };
        let mut model = model();
        group.push_approaching(&mut model, &with, &GAINS, (&Pose::IDENTITY, 1e-3), (5e-3, 0.01));
        let [kept] = model.contacts() else { panic!("{} contacts", model.contacts().len()) };
        assert!((kept.scene_point.z - 2e-3).abs() < 1e-15 && kept.braking_time == 0.01);
    }

    /// Contacts with a light object are soft, and softer the more of them there are.
    #[test]
    fn the_gains_of_a_light_object_are_shared_among_its_clusters() {
        let body = DynamicBody {
            mass: 0.01,
            inertia: palpate_core::glam::DMat3::from_diagonal(DVec3::splat(1e-6)),
            center_of_mass: DVec3::ZERO,
            gravity: DVec3::ZERO,
            period: 1e-3,
        };
        let mut object = MovingObject::new();
        object.set_dynamics(Some(body));
        let with = Counterpart::Moving { object: &object, id: SceneId(0), pose: Pose::IDENTITY };
        let stiff = ContactParameters { stiffness: 1e6, ..GAINS };
        let mut group = ContactGroup::with_moving(2, 0.1);
        group.touching.extend([-0.05, 0.05].map(|x| contact(DVec3::X * x, 0.0)));
        let mut model = model();
        group.push_touching(&mut model, &with, &stiff, (&Pose::IDENTITY, 1e-3), |_, _| ());
        for contact in model.contacts() {
            let at = (contact.point, DVec3::Z);
            let alone = with.gains(&stiff, at, 1, 1e-3).stiffness;
            assert!(alone < 1e6 && (contact.stiffness - 0.5 * alone).abs() < 1e-9 * alone);
        }
        assert_eq!(model.contacts().len(), 2);
        assert_eq!(with.body().twist, Twist::ZERO);
    }

    #[test]
    fn a_cleared_group_pushes_nothing() {
        let mut group = ContactGroup::with_still(5, 0.1);
        group.touching.push(contact(DVec3::ZERO, 1e-4));
        group.add_approaching(contact(DVec3::X, -2e-3));
        group.clear();
        let mut model = model();
        group.push_touching(&mut model, &Counterpart::Still, &GAINS, (&Pose::IDENTITY, 1e-3), |_, _| ());
        group.push_approaching(
            &mut model,
            &Counterpart::Still,
            &GAINS,
            (&Pose::IDENTITY, 1e-3),
            (5e-3, 0.01),
        );
        assert!(model.is_empty() && group.deepest() == 0.0);
    }
}
