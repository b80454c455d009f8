//! Many weighed contacts become few planes that push with the same wrench.
//!
//! Contacts gather around seeds, by their places on the probe and their normals. A contact is shared: the nearest seed has all of
//! it where every other is more than about twice as far, and shares pass smoothly from one to the other in between. All of its
//! push is with some seed, so that the planes' force is exactly that of the contacts, whatever the seeds are; they decide only how
//! it changes as the body moves on. The torque is the same but for its part along each plane's normal, which no plane can have.
//!
//! The seeds are kept in the probe's frame and go a part of the way to the mean of their contacts in each call; one that has none is
//! dropped, and where there is room for more, one is added at the contact that is worst represented.

use palpate_core::glam::{DMat3, DVec3};
use palpate_core::{Contact, Pose};

/// A seed has a share of a contact if the squared distance to the nearest seed over that to this one is above this.
const REACH: f64 = 0.25;

/// Distances are blurred by this part of the probe's radius: contacts that move by less hardly change their shares.
const BLUR: f64 = 0.05;

/// How far opposite directions are apart, in radii of the probe.
const OPPOSITE: f64 = 2.0;

/// The part of the way to the mean of its contacts that a seed goes in a call.
const STEP: f64 = 0.125;

/// Steps of Lloyd's method from nothing.
const FIRST_STEPS: u32 = 8;

/// Of the radius of a plane's contacts, as far as its point may be from their mean to have their torque.
const FURTHEST: f64 = 1.0;

/// A plane is left out if no more than this part of its contacts' pushes remains in their sum.
const CANCELLED: f64 = 1e-9;

/// A contact, and with which part of the stiffness it pushes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weighed {
    /// In world axes.
    pub contact: Contact,
    /// Of the stiffness, above 0.
    pub weight: f64,
}

/// What stands for some contacts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    /// In world axes. It pushes with its weight as they do together.
    pub contact: Contact,
    /// Of the stiffness.
    pub weight: f64,
    /// Root mean square distance of the contacts from its point, m.
    pub radius: f64,
}

/// The workspace, with the seeds carried from call to call.
#[derive(Clone, Debug)]
pub(crate) struct Merging {
    capacity: usize,
    /// Of the probe, m.
    radius: f64,
    /// In the probe's frame: places and unit normals.
    seeds: Vec<(DVec3, DVec3)>,
    sums: Vec<Sums>,
    planes: Vec<Plane>,
}

/// A seed with the sums over its contacts' shares.
#[derive(Clone, Copy, Debug)]
struct Sums {
    /// In world axes.
    point: DVec3,
    normal: DVec3,
    /// Squared distance from the contact at hand, and share of it.
    distance: f64,
    share: f64,
    /// Σ f, for f = w (δ + d), m; Σ f **p** about the seed; Σ f |p|² likewise.
    push: f64,
    moment: DVec3,
    spread: f64,
    /// Σ f **n**, m, Σ f **p** × **n** about the seed, m², and Σ w **n** **n**ᵀ.
    force: DVec3,
    torque: DVec3,
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

    fn mean(&self) -> (DVec3, DVec3) {
        if self.push > 0.0 {
            (self.point + self.moment / self.push, self.force.try_normalize().unwrap_or(self.normal))
        } else {
            (self.point, self.normal)
        }
    }

    /// Adds a part of a contact.
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

    fn plane(&self, tolerance: f64) -> Option<Plane> {
        let size = self.force.length();
        if self.push <= 0.0 || size <= CANCELLED * self.push {
            return None;
        }
        let normal = self.force / size;
        // As stiff along its normal as they are.
        let weight = normal.dot(self.stiffness * normal);
        let depth = size / weight - tolerance;
        let mean = self.moment / self.push;
        let radius = (self.spread / self.push - mean.length_squared()).max(0.0).sqrt();
        // Where the force has their torque, but for what is along it.
        let left = self.torque - mean.cross(self.force);
        let aside = self.force.cross(left) / (size * size);
        let point = self.point + mean + aside.clamp_length_max(FURTHEST * radius);
        let contact = Contact { point, scene_point: point - depth * normal, normal, depth };
        (weight > 0.0 && depth.is_finite()).then_some(Plane { contact, weight, radius })
    }
}

impl Merging {
    /// For a probe of a radius (m); at most so many planes, at least one.
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

    /// The planes of contacts within a tolerance (m), with the probe at a pose. Deterministic; allocates nothing.
    pub fn run(&mut self, contacts: &[Weighed], tolerance: f64, probe_pose: &Pose) -> &[Plane] {
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

    /// Shares the contacts out among the seeds.
    fn share(&mut self, contacts: &[Weighed], tolerance: f64) {
        for Weighed { contact, weight } in contacts.iter().filter(|one| one.contact.depth > -tolerance) {
            let mut nearest = f64::INFINITY;
            for sums in &mut self.sums {
                sums.distance = distance(sums, contact, self.radius);
                nearest = nearest.min(sums.distance);
            }
            let mut claims = 0.0;
            for sums in &mut self.sums {
                sums.share = (nearest / sums.distance - REACH).max(0.0);
                claims += sums.share;
            }
            for sums in self.sums.iter_mut().filter(|sums| sums.share > 0.0) {
                sums.add(contact, weight * (sums.share / claims), tolerance);
            }
        }
    }

    /// Adds a seed at the contact that is worst represented; `false` where there is no room or no need.
    fn add_seed(&mut self, contacts: &[Weighed], tolerance: f64) -> bool {
        if self.sums.len() == self.capacity {
            return false;
        }
        let blur = (BLUR * self.radius).powi(2);
        let mut worst = (None, 0.0);
        for Weighed { contact, weight } in contacts {
            let away = self.sums.iter().map(|sums| distance(sums, contact, self.radius) - blur);
            // One that is as near as rounding tells is there already.
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

    /// Moves the seeds on for the next call, and drops those without contacts.
    fn carry(&mut self, probe_pose: &Pose) {
        let to_probe = probe_pose.inverse();
        self.seeds.clear();
        for sums in self.sums.iter().filter(|sums| sums.push > 0.0) {
            let (point, normal) = sums.mean();
            let point = sums.point.lerp(point, STEP);
            let normal = sums.normal.lerp(normal, STEP).try_normalize().unwrap_or(normal);
            self.seeds.push((to_probe.transform_point(point), to_probe.transform_vector(normal)));
        }
    }
}

/// Squared distance of a contact from a seed, by place and direction, blurred, m².
fn distance(seed: &Sums, contact: &Contact, radius: f64) -> f64 {
    let turned = 0.5 * OPPOSITE * radius * seed.normal.distance(contact.normal);
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

    /// Contacts on a sphere's lower side, as many as a wide contact has.
    fn contacts(rng: &mut StdRng, count: usize) -> Vec<Weighed> {
        let one = |rng: &mut StdRng| {
            let normal = (vector(rng) - 1.5 * DVec3::Z).normalize();
            let (point, depth) = (normal + 0.05 * vector(rng), rng.random_range(-0.9 * D..3.0 * D));
            let contact = Contact { point, scene_point: point - depth * normal, normal, depth };
            Weighed { contact, weight: rng.random_range(0.01..0.2) }
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
            // What is left of the torque is about the planes' normals.
            assert!(most < 0.5 / capacity as f64, "{capacity} planes: a lever of {most} radii is left");
        }
    }

    #[test]
    fn as_many_planes_as_contacts_are_the_contacts() {
        let mut rng = StdRng::seed_from_u64(0x3E27);
        let mut merging = Merging::new(16, 1.0);
        let ends = [(-DVec3::X, DVec3::Z), (DVec3::X, DVec3::Z), (DVec3::X, -DVec3::Z), (DVec3::Y, DVec3::Y)];
        let found: Vec<Weighed> = ends
            .into_iter()
            .map(|(point, normal)| {
                let depth = rng.random_range(-0.5 * D..D);
                let contact = Contact { point, scene_point: point - depth * normal, normal, depth };
                Weighed { contact, weight: rng.random_range(0.1..1.0) }
            })
            .collect();
        let planes = merging.run(&found, D, &Pose::IDENTITY);
        assert_eq!(planes.len(), found.len());
        for Weighed { contact, weight } in &found {
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
    fn what_cancels_is_left_out() {
        let mut merging = Merging::new(1, 1.0);
        let contact = |normal: DVec3| Weighed {
            contact: Contact { point: DVec3::ZERO, scene_point: DVec3::ZERO, normal, depth: 0.0 },
            weight: 0.5,
        };
        assert!(merging.run(&[contact(DVec3::Z), contact(-DVec3::Z)], D, &Pose::IDENTITY).is_empty());
        assert!(merging.run(&[], D, &Pose::IDENTITY).is_empty());
        assert_eq!(merging.run(&[contact(DVec3::Z)], D, &Pose::IDENTITY).len(), 1);
    }
}
