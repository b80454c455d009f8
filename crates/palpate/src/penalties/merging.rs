//! Reduction of many weighted contacts to a few planes that push with the same wrench.
//!
//! Contacts are assigned to seeds by place on the probe and by normal. The assignment is soft: the nearest
//! seed takes all of a contact where every other is more than about twice as far, and the shares change
//! smoothly in between. The shares of a contact add up to 1, so the planes' force is exactly that of the
//! contacts, whatever the seeds are; seeds only decide how the force changes as the body moves on. The torque
//! is the same except for its part along each plane's normal, which a single force cannot produce.
//!
//! Seeds are kept in the probe's frame. In each call they move a fraction of the distance to the mean of
//! their contacts. A seed without contacts is dropped; where there is room, a seed is added at the contact
//! that is represented worst.

use palpate_core::glam::{DMat3, DVec3};
use palpate_core::{Contact, Pose};

/// Smallest ratio, nearest squared distance over that of a seed, at which the seed has a share of a contact.
/// With 1 contacts would jump from seed to seed.
const MIN_DISTANCE_RATIO: f64 = 0.25;

/// Blur of distances, in radii of the probe: contacts that move by less hardly change their shares.
const BLUR: f64 = 0.05;

/// Distance between opposite normals, in radii of the probe. With less, planes mix contacts that face
/// different directions.
const OPPOSITE_NORMALS: f64 = 2.0;

/// Fraction of the distance to the mean of its contacts that a seed moves in a call. With more, planes jump
/// with the contacts.
const SEED_STEP: f64 = 0.125;

/// Number of steps of Lloyd's method when there are no seeds yet.
const FIRST_STEPS: u32 = 8;

/// Largest distance of a plane's point from the mean of its contacts, in radii of these. It is moved there to
/// produce their torque.
const MAX_OFFSET: f64 = 1.0;

/// Smallest net push of a plane's contacts as a fraction of the sum of their pushes. Below, the pushes cancel
/// and the direction of the rest is rounding: the plane is left out.
const MIN_NET_PUSH: f64 = 1e-9;

/// A contact with its weight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WeightedContact {
    /// The contact, in world axes.
    pub contact: Contact,
    /// Fraction of the stiffness that it pushes with, above 0.
    pub weight: f64,
}

/// A plane that pushes like a group of contacts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    /// The contact with the plane, in world axes.
    pub contact: Contact,
    /// Fraction of the stiffness that it pushes with.
    pub weight: f64,
    /// Root mean square distance of the group's contacts from the plane's point, m.
    pub radius: f64,
}

/// The workspace, with the seeds carried from call to call.
#[derive(Clone, Debug)]
pub(crate) struct Merging {
    capacity: usize,
    /// Bounding radius of the probe, m.
    radius: f64,
    /// Places and unit normals of the seeds, in the probe's frame.
    seeds: Vec<(DVec3, DVec3)>,
    sums: Vec<Sums>,
    planes: Vec<Plane>,
}

/// A seed with sums over its shares of contacts. **p** is a contact's point relative to the seed, w its
/// weight times the share, f = w (δ + d) its push.
#[derive(Clone, Copy, Debug)]
struct Sums {
    /// Place and unit normal of the seed, in world axes.
    point: DVec3,
    normal: DVec3,
    /// Squared distance from the contact being shared out, m², and the seed's claim to it.
    distance: f64,
    share: f64,
    /// Σ f, m.
    push: f64,
    /// Σ f **p**, m².
    moment: DVec3,
    /// Σ f |**p**|², m³.
    spread: f64,
    /// Σ f **n**, m.
    force: DVec3,
    /// Σ f **p** × **n**, m².
    torque: DVec3,
    /// Σ w **n** **n**ᵀ.
    stiffness: DMat3,
}

impl Sums {
    fn at(point: DVec3, normal: DVec3) -> Self {
        Self {
            point,
            normal,
            distance: 0.0,
            share: 0.0,
            push: 0.0,
            moment: DVec3::ZERO,
            spread: 0.0,
            force: DVec3::ZERO,
            torque: DVec3::ZERO,
            stiffness: DMat3::ZERO,
        }
    }

    /// Mean place and direction of the contacts; those of the seed where there are none.
    fn mean(&self) -> (DVec3, DVec3) {
        if self.push > 0.0 {
            (self.point + self.moment / self.push, self.force.try_normalize().unwrap_or(self.normal))
        } else {
            (self.point, self.normal)
        }
    }

    /// Adds a contact with its weight times the seed's share.
    fn add(&mut self, contact: &Contact, weight: f64, tolerance: f64) {
        let (arm, normal) = (contact.point - self.point, contact.normal);
        let push = weight * (contact.depth + tolerance);
        self.push += push;
        self.moment += push * arm;
        self.spread += push * arm.length_squared();
        self.force += push * normal;
        self.torque += arm.cross(push * normal);
        self.stiffness += DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z) * weight;
    }

    /// The plane with the contacts' net push **F** = Σ f **n** and torque **T** = Σ f **p** × **n**; none if
    /// the pushes cancel.
    fn plane(&self, tolerance: f64) -> Option<Plane> {
        let size = self.force.length();
        if self.push <= 0.0 || size <= MIN_NET_PUSH * self.push {
            return None;
        }
        let normal = self.force / size;
        // As stiff along its normal as the contacts together: w = **n**ᵀ (Σ w **n** **n**ᵀ) **n**, and
        // w (δ + d) = |**F**|.
        let weight = normal.dot(self.stiffness * normal);
        let depth = size / weight - tolerance;
        let mean = self.moment / self.push;
        let radius = (self.spread / self.push - mean.length_squared()).max(0.0).sqrt();
        // **F** at the mean lacks the torque **L** = **T** − **m** × **F**. An offset **F** × **L** /
        // |**F**|² adds all of it but the part along **F**.
        let missing = self.torque - mean.cross(self.force);
        let offset = self.force.cross(missing) / (size * size);
        let point = self.point + mean + offset.clamp_length_max(MAX_OFFSET * radius);
        let contact = Contact { point, scene_point: point - depth * normal, normal, depth };
        (weight > 0.0 && depth.is_finite()).then_some(Plane { contact, weight, radius })
    }
}

impl Merging {
    /// Makes the workspace for at most `capacity` planes (at least one) on a probe of a bounding radius (m).
    pub fn new(capacity: usize, radius: f64) -> Self {
        let capacity = capacity.max(1);
        Self {
            capacity,
            radius,
            seeds: Vec::with_capacity(capacity),
            sums: Vec::with_capacity(capacity),
            planes: Vec::with_capacity(capacity),
        }
    }

    /// Reduces the contacts within a tolerance (m) to planes, with the probe at a pose. Deterministic;
    /// allocates nothing.
    pub fn run(&mut self, contacts: &[WeightedContact], tolerance: f64, probe_pose: &Pose) -> &[Plane] {
        self.sums.clear();
        let place = |(point, normal)| {
            Sums::at(probe_pose.transform_point(point), probe_pose.transform_vector(normal))
        };
        self.sums.extend(self.seeds.iter().copied().map(place));
        if self.sums.is_empty() {
            while self.add_seed(contacts, tolerance) {}
            for _ in 0..FIRST_STEPS {
                self.share(contacts, tolerance);
                for sums in &mut self.sums {
                    let (point, normal) = sums.mean();
                    *sums = Sums::at(point, normal);
                }
            }
        } else {
            self.add_seed(contacts, tolerance);
        }
        self.share(contacts, tolerance);
        self.planes.clear();
        self.planes.extend(self.sums.iter().filter_map(|sums| sums.plane(tolerance)));
        self.carry(probe_pose);
        &self.planes
    }

    /// Shares the contacts out among the seeds: seed i at squared distance D_i gets s_i / Σ s_j with
    /// s_i = max(0, D_min / D_i − [`MIN_DISTANCE_RATIO`]).
    fn share(&mut self, contacts: &[WeightedContact], tolerance: f64) {
        let touching = contacts.iter().filter(|one| one.contact.depth > -tolerance);
        for WeightedContact { contact, weight } in touching {
            let mut nearest = f64::INFINITY;
            for sums in &mut self.sums {
                sums.distance = distance(sums, contact, self.radius);
                nearest = nearest.min(sums.distance);
            }
            let mut claims = 0.0;
            for sums in &mut self.sums {
                sums.share = (nearest / sums.distance - MIN_DISTANCE_RATIO).max(0.0);
                claims += sums.share;
            }
            for sums in self.sums.iter_mut().filter(|sums| sums.share > 0.0) {
                sums.add(contact, weight * (sums.share / claims), tolerance);
            }
        }
    }

    /// Adds a seed at the contact that is represented worst: the one with the largest push times squared
    /// distance to its nearest seed. Returns `false` if there is no room or no need.
    fn add_seed(&mut self, contacts: &[WeightedContact], tolerance: f64) -> bool {
        if self.sums.len() == self.capacity {
            return false;
        }
        let blur = (BLUR * self.radius).powi(2);
        let mut worst = (None, 0.0);
        for WeightedContact { contact, weight } in contacts {
            let away = self.sums.iter().map(|sums| distance(sums, contact, self.radius) - blur);
            // A contact within the blur of a seed is represented by it.
            let away = away.reduce(f64::min).map_or(1.0, |away| if away > blur { away } else { 0.0 });
            let cost = weight * (contact.depth + tolerance) * away;
            if cost > worst.1 {
                worst = (Some(contact), cost);
            }
        }
        let Some(contact) = worst.0 else { return false };
        self.sums.push(Sums::at(contact.point, contact.normal));
        true
    }

    /// Moves the seeds towards the means of their contacts for the next call, and drops those without
    /// contacts.
    fn carry(&mut self, probe_pose: &Pose) {
        let to_probe = probe_pose.inverse();
        self.seeds.clear();
        for sums in self.sums.iter().filter(|sums| sums.push > 0.0) {
            let (point, normal) = sums.mean();
            let point = sums.point.lerp(point, SEED_STEP);
            let normal = sums.normal.lerp(normal, SEED_STEP).try_normalize().unwrap_or(normal);
            self.seeds.push((to_probe.transform_point(point), to_probe.transform_vector(normal)));
        }
    }
}

/// Squared distance of a contact from a seed by place and direction, blurred, m²:
/// |**p** − **s**|² + (r |**n** − **n**_s|)² + blur². Never 0, since it is divided by.
fn distance(seed: &Sums, contact: &Contact, radius: f64) -> f64 {
    let turned = 0.5 * OPPOSITE_NORMALS * radius * seed.normal.distance(contact.normal);
    let blur = BLUR * radius;
    seed.point.distance_squared(contact.point) + turned * turned + blur * blur + f64::MIN_POSITIVE
}

#[cfg(test)]
mod tests {
    use palpate_core::Wrench;
    use palpate_core::glam::DQuat;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    const D: f64 = 0.01;

    fn vector(rng: &mut StdRng) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
    }

    /// Random contacts on a sphere's lower side.
    fn contacts(rng: &mut StdRng, count: usize) -> Vec<WeightedContact> {
        let one = |rng: &mut StdRng| {
            let normal = (vector(rng) - 1.5 * DVec3::Z).normalize();
            let (point, depth) = (normal + 0.05 * vector(rng), rng.random_range(-0.9 * D..3.0 * D));
            let contact = Contact { point, scene_point: point - depth * normal, normal, depth };
            WeightedContact { contact, weight: rng.random_range(0.01..0.2) }
        };
        (0..count).map(|_| one(rng)).collect()
    }

    fn wrench<'a>(planes: impl Iterator<Item = (&'a Contact, f64)>) -> Wrench {
        planes.fold(Wrench::ZERO, |sum, (contact, weight)| {
            let force = -contact.normal * weight * (contact.depth + D);
            sum + Wrench { force, torque: contact.point.cross(force) }
        })
    }

    #[test]
    fn planes_push_as_the_contacts_do() {
        let mut rng = StdRng::seed_from_u64(0x3E26);
        for capacity in [1, 3, 8, 16] {
            let mut merging = Merging::new(capacity, 1.0);
            let mut most: f64 = 0.0;
            for round in 0..200 {
                let count = rng.random_range(1..120);
                let found = contacts(&mut rng, count);
                let pose = Pose::new(0.1 * vector(&mut rng), DQuat::from_scaled_axis(0.1 * vector(&mut rng)));
                let planes = merging.run(&found, D, &pose);
                assert!(planes.len() <= capacity && !planes.is_empty(), "{} planes", planes.len());
                let wanted = wrench(found.iter().map(|one| (&one.contact, one.weight)));
                let own = wrench(planes.iter().map(|plane| (&plane.contact, plane.weight)));
                let size = wanted.force.length();
                assert!(
                    own.force.distance(wanted.force) < 1e-9 * size,
                    "round {round}: {own:?} for {wanted:?}"
                );
                most = most.max(own.torque.distance(wanted.torque) / size);
                let stiffness: f64 = planes.iter().map(|plane| plane.weight).sum();
                let whole: f64 = found.iter().map(|one| one.weight).sum();
                assert!(stiffness <= whole * (1.0 + 1e-9), "{stiffness} is stiffer than {whole}");
            }
            // The missing torque is about the planes' normals.
            assert!(most < 0.5 / capacity as f64, "{capacity} planes: a lever of {most} radii is left");
        }
    }

    #[test]
    fn with_as_many_planes_each_plane_is_a_contact() {
        let mut rng = StdRng::seed_from_u64(0x3E27);
        let mut merging = Merging::new(16, 1.0);
        let ends = [(-DVec3::X, DVec3::Z), (DVec3::X, DVec3::Z), (DVec3::X, -DVec3::Z), (DVec3::Y, DVec3::Y)];
        let found: Vec<WeightedContact> = ends
            .into_iter()
            .map(|(point, normal)| {
                let depth = rng.random_range(-0.5 * D..D);
                let contact = Contact { point, scene_point: point - depth * normal, normal, depth };
                WeightedContact { contact, weight: rng.random_range(0.1..1.0) }
            })
            .collect();
        let planes = merging.run(&found, D, &Pose::IDENTITY);
        assert_eq!(planes.len(), found.len());
        for WeightedContact { contact, weight } in &found {
            let same = |plane: &&Plane| {
                plane.contact.point.distance(contact.point) < 1e-9
                    && plane.contact.normal.distance(contact.normal) < 1e-9
                    && (plane.contact.depth - contact.depth).abs() < 1e-12
                    && (plane.weight - weight).abs() < 1e-12
            };
            assert!(planes.iter().any(|plane| same(&plane)), "{contact:?} in {planes:?}");
        }
    }

    #[test]
    fn contacts_that_cancel_are_left_out() {
        let mut merging = Merging::new(1, 1.0);
        let contact = |normal: DVec3| WeightedContact {
            contact: Contact { point: DVec3::ZERO, scene_point: DVec3::ZERO, normal, depth: 0.0 },
            weight: 0.5,
        };
        assert!(merging.run(&[contact(DVec3::Z), contact(-DVec3::Z)], D, &Pose::IDENTITY).is_empty());
        assert!(merging.run(&[], D, &Pose::IDENTITY).is_empty());
        assert_eq!(merging.run(&[contact(DVec3::Z)], D, &Pose::IDENTITY).len(), 1);
    }
}
