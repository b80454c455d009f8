//! Contact clustering (§5.4.2, Eqs 5.32–5.36): K-means over the contact points **p** with weights δ + d, seeded by the
//! clusters of the previous call, such that force and torque are continuous in the contacts.
//!
//! Algorithms 5.4.1–5.4.4 give each contact to one cluster, as often as it takes to settle. Where a contact is about as
//! near to two, rounding decides; the representatives jump, and the force with them. Departures:
//!
//! - A contact is shared: the nearest seed has all of it where every other is more than about twice as far ([`REACH`]),
//!   and shares pass smoothly from one to the other in between. Shares depend on the seeds and the contact's own point
//!   alone, so that a contact that comes in with no weight alters nothing.
//! - A cluster pushes no more than its contacts together: its δ + d is Eq. 5.34's, but at most |Σ (δ + d) **n**|. The
//!   two differ only if a cluster has less than a whole contact, or contacts whose normals are more than a right angle
//!   apart. Otherwise next to nothing of a deep contact would push like all of it, and normals that cancel leave no
//!   direction.
//! - The seeds are kept in the probe's frame and make one step of Lloyd's method per call, once the representatives are
//!   known: a part ([`STEP`]) of the way to the mean of their contacts, less if these weigh little ([`INERTIA`]). The
//!   iteration so goes on from call to call.
//! - A seed whose contacts weigh nothing is dropped, which alters nothing. With fewer seeds than min(K, n) some are
//!   added at contacts that cost most in Eq. 5.32, and gain influence in the course of many calls ([`GROWTH`]).
//! - Without seeds, at the first call or when nothing pushed in the last, the first is at the contact that weighs most,
//!   and a bounded number of steps is made at once.
//!
//! For given seeds force and torque are continuous functions of the contacts' points, normals, depths and weights, and
//! so are the seeds carried on; which seeds there are changes only where they have no influence. While contacts rest,
//! seeds that settle and gain influence still change the force, by a small part per call.
//!
//! Contacts of which only a part counts ([`PatchContact::weight`]) weigh that much less. Clusters without weight, or
//! whose contacts cancel one another, are left out. Clusters come out by decreasing δ.

use palpate_core::glam::DVec3;
use palpate_core::{Contact, Pose};

use crate::contact::PatchContact;
use crate::tolerances::CANCELLED_NORMALS;

/// A seed has a share of a contact if the squared distance to the nearest seed over that to this one, both
/// [blurred](BLUR), is above this.
const REACH: f64 = 0.25;

/// Distances from seeds are blurred by this many tolerances d: contacts that move by less hardly change their shares.
const BLUR: f64 = 2.0;

/// The most of the way to the mean of its contacts that a seed goes in one call.
const STEP: f64 = 0.125;

/// A seed goes half as far if its contacts weigh this many tolerances d.
const INERTIA: f64 = 1.0;

/// The part of its influence that an added seed gains per call; more where its penalty is small beside those felt, to
/// which it may add this part.
const GROWTH: f64 = 1.0 / 64.0;

/// Steps of Lloyd's method from nothing.
const FIRST_STEPS: u32 = 16;

/// A cluster of contacts: the representative contact, and what it stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cluster {
    /// The representative (Eqs 5.33–5.36), in world axes.
    pub contact: Contact,
    /// w: accumulated weight Σ (δ + d), m.
    pub weight: f64,
    /// Root mean square distance of its contacts from the representative's point, by their weight, m.
    pub radius: f64,
}

/// The workspace of the clustering, with the seeds carried from call to call.
///
/// ```
/// use palpate_collide::{Clustering, ContactQuery, QuerySettings, Shape};
/// use palpate_core::glam::DVec3;
/// use palpate_core::{Pose, Wrench};
///
/// # use palpate_clod_build::{BuildOptions, build, unwatched};
/// # use palpate_core::TriMesh;
/// # let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)) * 0.1;
/// # let cube = TriMesh::new((0..8).map(corner).collect(), vec![
/// #     [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
/// #     [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
/// # ])?;
/// # let tips = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z].map(|tip| 0.05 * tip);
/// # let octahedron = TriMesh::new(tips.to_vec(), vec![
/// #     [0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5],
/// # ])?;
/// # let shape_of = |mesh: &TriMesh| build(mesh, &BuildOptions::default(), &mut unwatched).map(Shape::new);
/// # let (octahedron, cube) = (shape_of(&octahedron)?, shape_of(&cube)?);
/// let (tolerance, stiffness) = (0.002, 1000.0); // m, N/m
/// let mut query = ContactQuery::new(&octahedron, &cube);
/// let mut clustering = Clustering::new(5);
/// let probe_pose = Pose::from_translation(DVec3::new(0.04, 0.05, 0.149));
/// query.run(&probe_pose, &Pose::IDENTITY, &QuerySettings::new(tolerance))?;
///
/// // The penalty wrench on the probe, about its frame's origin: k (δ + d) along −n at each representative.
/// let clusters = clustering.run(query.contacts(), tolerance, &probe_pose);
/// assert!((1..=5).contains(&clusters.len()));
/// let wrench = clusters.iter().map(|cluster| cluster.contact).fold(Wrench::ZERO, |sum, contact| {
///     let force = -contact.normal * stiffness * (contact.depth + tolerance);
///     sum + Wrench::from_force_at(force, contact.point - probe_pose.translation)
/// });
/// assert!(wrench.force.z > 0.0); // the cube pushes the octahedron up
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Clustering {
    capacity: usize,
    /// Points around which clusters form, in the probe's frame, the oldest first.
    seeds: Vec<DVec3>,
    /// How many of the seeds have all their influence.
    grown: usize,
    /// How much the others have, 0 to 1.
    growth: f64,
    sums: Vec<Sums>,
    clusters: Vec<Cluster>,
    iterations: u32,
}

/// A seed with the sums over its contacts' shares.
#[derive(Clone, Copy, Debug)]
struct Sums {
    /// The seed, in world axes.
    seed: DVec3,
    /// Squared distance of the seed from the contact at hand, blurred, m².
    distance: f64,
    /// The seed's share of that contact, 0 to 1.
    share: f64,
    /// Σ (δ + d), m.
    weight: f64,
    /// Σ (δ + d)², m².
    depth: f64,
    /// Σ (δ + d) p about the seed, m².
    point: DVec3,
    /// Σ (δ + d) |p|² likewise, m³.
    spread: f64,
    /// Σ (δ + d) n, m.
    push: DVec3,
}

impl Sums {
    fn at(seed: DVec3) -> Self {
        Self {
            seed,
            distance: 0.0,
            share: 0.0,
            weight: 0.0,
            depth: 0.0,
            point: DVec3::ZERO,
            spread: 0.0,
            push: DVec3::ZERO,
        }
    }

    /// Eq. 5.33; the seed without contacts.
    fn mean(&self) -> DVec3 {
        if self.weight > 0.0 { self.seed + self.point / self.weight } else { self.seed }
    }

    /// δ + d by Eq. 5.34, m, at most the contacts' in all.
    fn penalty(&self) -> f64 {
        self.weight.min(self.depth / self.weight)
    }

    /// Eqs 5.33–5.36, with a part of the penalty.
    fn cluster(&self, part: f64, tolerance: f64) -> Option<Cluster> {
        let push = self.push.length();
        if part == 0.0 || push <= CANCELLED_NORMALS * self.weight {
            return None;
        }
        let normal = self.push / push;
        let depth = part * self.penalty().min(push) - tolerance;
        let point = self.mean();
        let contact = Contact { point, scene_point: point - depth * normal, normal, depth };
        let variance = self.spread / self.weight - (point - self.seed).length_squared();
        Some(Cluster { contact, weight: self.weight, radius: variance.max(0.0).sqrt() })
    }
}

impl Clustering {
    /// A workspace for at most `k` clusters (K), at least one.
    pub fn new(k: usize) -> Self {
        let capacity = k.max(1);
        Self {
            capacity,
            seeds: Vec::with_capacity(capacity),
            grown: 0,
            growth: 0.0,
            sums: Vec::with_capacity(capacity),
            clusters: Vec::with_capacity(capacity),
            iterations: 0,
        }
    }

    /// Clusters the contacts of one query, found with tolerance d (m), at the probe's pose. Deterministic: equal input
    /// gives equal output after equal history. Allocates nothing.
    pub fn run(&mut self, contacts: &[PatchContact], tolerance: f64, probe_pose: &Pose) -> &[Cluster] {
        self.clusters.clear();
        self.sums.clear();
        self.sums.extend(self.seeds.iter().map(|seed| Sums::at(probe_pose.transform_point(*seed))));
        self.iterations = 1;
        if self.sums.is_empty() {
            self.add_seeds(contacts, tolerance);
            self.grown = self.sums.len();
            for _ in 0..FIRST_STEPS {
                self.iterations += 1;
                self.share(contacts, tolerance);
                for sums in &mut self.sums {
                    *sums = Sums::at(sums.mean());
                }
            }
        }
        self.share(contacts, tolerance);
        for (index, sums) in self.sums.iter().enumerate() {
            let part = if index < self.grown { 1.0 } else { self.growth };
            self.clusters.extend(sums.cluster(part, tolerance));
        }
        // Sorting by insertion: K is small, and equal depths keep their order.
        for index in 1..self.clusters.len() {
            let mut at = index;
            while at > 0 && self.clusters[at - 1].contact.depth < self.clusters[at].contact.depth {
                self.clusters.swap(at - 1, at);
                at -= 1;
            }
        }
        self.carry(contacts, tolerance, probe_pose);
        &self.clusters
    }

    /// The clusters of the last call, by decreasing δ.
    pub fn clusters(&self) -> &[Cluster] {
        &self.clusters
    }

    /// Steps of Lloyd's method in the last call.
    pub fn iterations(&self) -> u32 {
        self.iterations
    }

    /// Forgets the seeds.
    pub fn reset(&mut self) {
        self.seeds.clear();
        self.clusters.clear();
    }

    /// Shares the contacts out among the seeds and sums up their shares (Algorithms 5.4.3 and 5.4.4).
    fn share(&mut self, contacts: &[PatchContact], tolerance: f64) {
        let blur = BLUR * tolerance;
        for contact in contacts {
            let weight = weight(contact, tolerance);
            if weight <= 0.0 {
                continue;
            }
            let Contact { point, normal, depth, .. } = contact.contact;
            for sums in &mut self.sums {
                sums.distance = sums.seed.distance_squared(point) + blur * blur + f64::MIN_POSITIVE;
                sums.share = 0.0;
            }
            divide(&mut self.sums, 1.0);
            if self.grown < self.sums.len() {
                // The others' shares are in between those beside the growing seeds and those without them.
                let grown = &mut self.sums[..self.grown];
                grown.iter_mut().for_each(|sums| sums.share *= self.growth);
                divide(grown, 1.0 - self.growth);
            }
            for sums in self.sums.iter_mut().filter(|sums| sums.share > 0.0) {
                let weight = sums.share * weight;
                sums.weight += weight;
                sums.depth += weight * (depth + tolerance);
                sums.point += weight * (point - sums.seed);
                sums.spread += weight * (point - sums.seed).length_squared();
                sums.push += weight * normal;
            }
        }
    }

    /// Moves the seeds on, drops those without contacts and adds new ones, for the next call.
    fn carry(&mut self, contacts: &[PatchContact], tolerance: f64, probe_pose: &Pose) {
        for index in (0..self.sums.len()).rev() {
            if self.sums[index].weight <= 0.0 {
                self.sums.remove(index);
                self.grown -= usize::from(index < self.grown);
            }
        }
        for sums in &mut self.sums {
            let part = STEP * sums.weight / (sums.weight + INERTIA * tolerance);
            sums.seed += part * (sums.mean() - sums.seed);
        }
        if self.grown < self.sums.len() {
            let penalty = |sums: &[Sums]| sums.iter().map(Sums::penalty).sum::<f64>();
            let (grown, growing) = self.sums.split_at(self.grown);
            let growing = penalty(growing);
            let felt = penalty(grown) + self.growth * growing;
            self.growth += GROWTH * (felt / growing).max(1.0);
            if self.growth >= 1.0 {
                self.grown = self.sums.len();
            }
        } else if !self.sums.is_empty() {
            self.add_seeds(contacts, tolerance);
            self.growth = 0.0;
        }
        let to_probe = probe_pose.inverse();
        self.seeds.clear();
        self.seeds.extend(self.sums.iter().map(|sums| to_probe.transform_point(sums.seed)));
    }

    /// Adds seeds, in all at most as many as contacts with weight: the first at the heaviest contact, each other at the
    /// one that costs most in Eq. 5.32.
    fn add_seeds(&mut self, contacts: &[PatchContact], tolerance: f64) {
        let most =
            self.capacity.min(contacts.iter().filter(|contact| weight(contact, tolerance) > 0.0).count());
        while self.sums.len() < most {
            let mut best = (None, 0.0);
            for contact in contacts {
                let distance = self.sums.iter().map(|sums| sums.seed.distance_squared(contact.contact.point));
                let merit = weight(contact, tolerance) * distance.reduce(f64::min).unwrap_or(1.0);
                if merit > best.1 {
                    best = (Some(contact.contact.point), merit);
                }
            }
            let Some(point) = best.0 else { break };
            self.sums.push(Sums::at(point));
        }
    }
}

/// Adds the seeds' shares of a part of a contact, by their distances from it.
fn divide(seeds: &mut [Sums], part: f64) {
    let nearest = seeds.iter().map(|sums| sums.distance).fold(f64::INFINITY, f64::min);
    let claim = |sums: &Sums| (nearest / sums.distance - REACH).max(0.0);
    let claims: f64 = seeds.iter().map(claim).sum();
    for sums in seeds {
        sums.share += part * claim(sums) / claims;
    }
}

/// δ + d, m, as far as the contact counts.
fn weight(contact: &PatchContact, tolerance: f64) -> f64 {
    contact.weight * (contact.contact.depth + tolerance).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::glam::DQuat;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    const SEED: u64 = 0x000C_1C57;
    const D: f64 = 0.05;

    fn contact(point: DVec3, depth: f64, normal: DVec3) -> PatchContact {
        let contact = Contact { point, scene_point: point - depth * normal, normal, depth };
        PatchContact { contact, probe_node: 0, scene_node: 0, weight: 1.0 }
    }

    fn vector(rng: &mut StdRng) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
    }

    fn random(rng: &mut StdRng, count: usize) -> Vec<PatchContact> {
        (0..count)
            .map(|_| contact(vector(rng), rng.random_range(-D..2.0 * D), vector(rng).normalize()))
            .collect()
    }

    /// Force and torque about the origin, at 1 N/m (Eq. 5.37).
    fn wrench(clusters: &[Cluster]) -> (DVec3, DVec3) {
        clusters.iter().fold((DVec3::ZERO, DVec3::ZERO), |(force, torque), cluster| {
            let Contact { point, normal, depth, .. } = cluster.contact;
            let push = -normal * (depth + D).max(0.0);
            (force + push, torque + point.cross(push))
        })
    }

    fn difference(one: (DVec3, DVec3), other: (DVec3, DVec3)) -> f64 {
        one.0.distance(other.0).max(one.1.distance(other.1))
    }

    /// A clustering with some history of random contacts, and those to come; at random places or, so that many are as
    /// near to one seed as to another, on a grid.
    fn history(rng: &mut StdRng) -> (Clustering, Vec<PatchContact>) {
        let mut clustering = Clustering::new(rng.random_range(1..=16));
        let grid = rng.random_range(0..2) == 0;
        let mut contacts = Vec::new();
        for _ in 0..rng.random_range(2..5) {
            let count = rng.random_range(1..40);
            contacts = random(rng, count);
            for found in &mut contacts {
                found.weight = if rng.random_range(0..2) == 0 { 1.0 } else { rng.random_range(0.0..1.0) };
                if grid {
                    found.contact.point = (2.0 * found.contact.point).round() / 2.0;
                }
            }
            for _ in 0..rng.random_range(1..80) {
                clustering.run(&contacts, D, &Pose::IDENTITY);
            }
        }
        (clustering, contacts)
    }

    /// Bunches of contacts with similar normals, far apart from one another: any clustering has to find them.
    fn bunches(rng: &mut StdRng, count: usize) -> Vec<Vec<PatchContact>> {
        (0..count)
            .map(|index| {
                let at = DVec3::new(3.0 * index as f64, 0.0, 0.0);
                (0..rng.random_range(1..20))
                    .map(|_| {
                        let normal = (DVec3::Z + 0.3 * vector(rng)).normalize();
                        contact(at + 0.1 * vector(rng), rng.random_range(-0.5 * D..2.0 * D), normal)
                    })
                    .collect()
            })
            .collect()
    }

    #[test]
    fn representatives_of_separate_bunches_are_as_printed() {
        let mut rng = StdRng::seed_from_u64(SEED);
        for round in 0..400 {
            let context = format!("seed {SEED:#x}, round {round}");
            let k = rng.random_range(1..8);
            let bunches = bunches(&mut rng, k);
            let found = Clustering::new(k).run(&bunches.concat(), D, &Pose::IDENTITY).to_vec();
            assert_eq!(found.len(), k, "{context}");
            assert!(found.is_sorted_by(|x, y| x.contact.depth >= y.contact.depth), "{context}");
            for own in bunches {
                let own: Vec<Contact> = own.iter().map(|found| found.contact).collect();
                let sum: f64 = own.iter().map(|c| c.depth + D).sum();
                let point = own.iter().map(|c| (c.depth + D) * c.point).sum::<DVec3>() / sum;
                let depth = own.iter().map(|c| (c.depth + D) * c.depth).sum::<f64>() / sum;
                let normal = own.iter().map(|c| (c.depth + D) * c.normal).sum::<DVec3>().normalize();
                let found = found.iter().find(|found| found.contact.point.distance(point) < 1e-12);
                let Cluster { contact, weight, radius } =
                    found.unwrap_or_else(|| panic!("Eq. 5.33, {context}"));
                assert!((contact.depth - depth).abs() < 1e-12, "Eq. 5.34, {context}");
                assert!(contact.normal.distance(normal) < 1e-12, "Eq. 5.35, {context}");
                let spread = own.iter().map(|c| (c.depth + D) * c.point.distance_squared(point)).sum::<f64>();
                assert!((radius - (spread / sum).sqrt()).abs() < 1e-7, "radius, {context}");
                let offset = contact.point - contact.depth * contact.normal;
                assert!(contact.scene_point.distance(offset) < 1e-12, "Eq. 5.36, {context}");
                assert!((weight - sum).abs() < 1e-12, "{context}");
            }
        }
    }

    #[test]
    fn force_and_torque_are_continuous() {
        // Seen is a change of up to 26 EPSILON D; it may be more where contacts that are shared hardly push.
        const EPSILON: f64 = 1e-9;
        const BOUND: f64 = 1e3;
        let mut largest: f64 = 0.0;
        for seed in SEED..SEED + 4000 {
            let mut rng = StdRng::seed_from_u64(seed);
            let (clustering, contacts) = history(&mut rng);
            let before = wrench(clustering.clone().run(&contacts, D, &Pose::IDENTITY));
            let mut changed = contacts.clone();
            for found in &mut changed {
                found.contact.point += EPSILON * vector(&mut rng);
                found.contact.normal = (found.contact.normal + EPSILON * vector(&mut rng)).normalize();
                found.contact.depth += EPSILON * D * rng.random_range(-1.0..1.0);
                found.weight = (found.weight + EPSILON * rng.random_range(-1.0..1.0)).clamp(0.0, 1.0);
            }
            // One more whose penalty, and one more whose weight, is hardly any: contacts on their way in or out.
            changed.push(contact(vector(&mut rng), EPSILON * D - D, vector(&mut rng).normalize()));
            let weight = EPSILON;
            changed
                .push(PatchContact { weight, ..contact(vector(&mut rng), D, vector(&mut rng).normalize()) });
            let after = wrench(clustering.clone().run(&changed, D, &Pose::IDENTITY));
            largest = largest.max(difference(before, after) / (EPSILON * D));
            assert!(largest < BOUND, "seed {seed:#x}: {largest} EPSILON D");
        }
    }

    #[test]
    fn carried_seeds_are_continuous() {
        const EPSILON: f64 = 1e-9;
        let mut largest: f64 = 0.0;
        for seed in SEED..SEED + 4000 {
            let mut rng = StdRng::seed_from_u64(seed);
            let (clustering, contacts) = history(&mut rng);
            let mut changed = contacts.clone();
            for found in &mut changed {
                found.contact.point += EPSILON * vector(&mut rng);
                found.contact.depth =
                    (found.contact.depth + EPSILON * D * rng.random_range(-1.0..1.0)).max(-D);
            }
            let [one, other] = [contacts, changed].map(|contacts| {
                let mut clustering = clustering.clone();
                clustering.run(&contacts, D, &Pose::IDENTITY);
                clustering
            });
            for (one, other) in one.seeds[..one.grown].iter().zip(&other.seeds) {
                largest = largest.max(one.distance(*other) / EPSILON);
                assert!(largest < 1e3, "seed {seed:#x}: {largest} EPSILON");
            }
        }
    }

    #[test]
    fn force_follows_contacts_that_move() {
        // Contacts wander, come and go. The force changes by their motion and by what seeds gain in influence: seen is
        // a change of up to 0.27 D per step, and of 4 D where each contact belongs to one cluster as printed.
        const STEPS: usize = 20_000;
        for seed in SEED..SEED + 20 {
            let mut rng = StdRng::seed_from_u64(seed);
            let mut clustering = Clustering::new(5);
            let paths: Vec<_> =
                (0..20).map(|_| (vector(&mut rng), vector(&mut rng), vector(&mut rng))).collect();
            let mut last = None;
            for step in 0..STEPS {
                let t = step as f64 / STEPS as f64;
                let wave = |phase: DVec3, speed: DVec3| {
                    let angles = std::f64::consts::TAU * (phase + 3.0 * t * speed);
                    DVec3::new(angles.x.sin(), angles.y.sin(), angles.z.sin())
                };
                let contacts: Vec<PatchContact> = paths
                    .iter()
                    .map(|(a, b, c)| {
                        contact(
                            wave(*a, *b),
                            2.0 * D * wave(*b, *c).x,
                            (wave(*c, *a) + 2.0 * DVec3::Z).normalize(),
                        )
                    })
                    .filter(|found| found.contact.depth > -D)
                    .collect();
                let now = wrench(clustering.run(&contacts, D, &Pose::IDENTITY));
                let change = last.map_or(0.0, |last| difference(last, now));
                assert!(change < 0.5 * D, "seed {seed:#x}, step {step}: {change}");
                last = Some(now);
            }
        }
    }

    #[test]
    fn covariant() {
        let mut rng = StdRng::seed_from_u64(SEED + 3);
        let pose =
            Pose::new(DVec3::new(0.3, -2.0, 1.0), DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 2.0));
        let scale = 8.0;
        let (mut here, mut there) = (Clustering::new(5), Clustering::new(5));
        let mut contacts = random(&mut rng, 30);
        for round in 0..200 {
            for found in &mut contacts {
                found.contact.point += 0.01 * vector(&mut rng);
            }
            let moved: Vec<PatchContact> = contacts
                .iter()
                .map(|found| {
                    let Contact { point, normal, depth, .. } = found.contact;
                    contact(pose.transform_point(scale * point), scale * depth, pose.rotation * normal)
                })
                .collect();
            let found = here.run(&contacts, D, &Pose::IDENTITY);
            let moved = there.run(&moved, scale * D, &pose);
            assert_eq!(found.len(), moved.len());
            for (found, moved) in found.iter().zip(moved) {
                let context = format!("seed {SEED:#x}, round {round}");
                let point = pose.transform_point(scale * found.contact.point);
                assert!(moved.contact.point.distance(point) < 1e-7, "{context}");
                assert!((moved.contact.depth - scale * found.contact.depth).abs() < 1e-7, "{context}");
                let normal = pose.rotation * found.contact.normal;
                assert!(moved.contact.normal.distance(normal) < 1e-7, "{context}");
            }
        }
    }

    #[test]
    fn few_contacts_are_their_own_clusters() {
        let mut rng = StdRng::seed_from_u64(SEED + 1);
        assert!(Clustering::new(5).run(&[], D, &Pose::IDENTITY).is_empty());
        // All at once, and one after the other.
        let mut late = Clustering::new(5);
        for count in 1..=5 {
            let contacts: Vec<PatchContact> = (0..count)
                .map(|index| {
                    contact(
                        DVec3::X * index as f64,
                        rng.random_range(-0.5 * D..2.0 * D),
                        vector(&mut rng).normalize(),
                    )
                })
                .collect();
            for _ in 0..1000 {
                late.run(&contacts, D, &Pose::IDENTITY);
            }
            for found in [Clustering::new(5).run(&contacts, D, &Pose::IDENTITY), late.clusters()] {
                assert_eq!(found.len(), count);
                let same = |one: &Contact, other: &Contact| {
                    one.point.distance(other.point) < 1e-9
                        && one.normal.distance(other.normal) < 1e-9
                        && (one.depth - other.depth).abs() < 1e-9
                };
                assert!(contacts.iter().all(|c| found.iter().any(|f| same(&f.contact, &c.contact))));
                assert!(found.is_sorted_by(|x, y| x.contact.depth >= y.contact.depth));
            }
        }
    }

    #[test]
    fn seeds_follow_the_probe() {
        // Two tight bunches; after a large motion of the probe the clusters are the bunches still, found at once.
        let mut rng = StdRng::seed_from_u64(SEED + 2);
        let bunch = |rng: &mut StdRng, at: DVec3| -> Vec<PatchContact> {
            random(rng, 20)
                .iter()
                .map(|c| contact(at + 0.01 * c.contact.point, c.contact.depth, DVec3::Z))
                .collect()
        };
        let local: Vec<PatchContact> = [bunch(&mut rng, DVec3::X), bunch(&mut rng, -DVec3::X)].concat();
        let mut clustering = Clustering::new(2);
        clustering.run(&local, D, &Pose::IDENTITY);
        let pose = Pose::new(DVec3::new(5.0, 1.0, 0.0), DQuat::from_rotation_z(3.0));
        let moved: Vec<PatchContact> = local
            .iter()
            .map(|c| contact(pose.transform_point(c.contact.point), c.contact.depth, DVec3::Z))
            .collect();
        let before: Vec<DVec3> = clustering.clusters().iter().map(|c| c.contact.point).collect();
        let after = clustering.run(&moved, D, &pose).to_vec();
        for (old, new) in before.iter().zip(&after) {
            assert!(pose.transform_point(*old).distance(new.contact.point) < 1e-9);
        }
        assert_eq!(clustering.iterations(), 1);
    }

    #[test]
    fn weightless_and_opposed_contacts_stay_finite() {
        let far = DVec3::X;
        let contacts = [
            contact(DVec3::ZERO, -D, DVec3::Z),
            contact(DVec3::Y * 0.02, -D, DVec3::Z),
            contact(far, 0.01, DVec3::Z),
            contact(far + DVec3::Y * 0.02, 0.01, -DVec3::Z),
        ];
        for tolerance in [D, 0.0] {
            let mut clustering = Clustering::new(2);
            for _ in 0..100 {
                let found = clustering.run(&contacts, tolerance, &Pose::IDENTITY);
                // Those without weight count nothing, and the others' sum is all but nothing.
                assert!(found.iter().all(|c| c.contact.point.distance(far) < 0.03));
                assert!(
                    found
                        .iter()
                        .all(|c| c.contact.scene_point.is_finite() && c.contact.normal.is_normalized())
                );
                assert!(wrench(found).0.length() < if tolerance > 0.0 { 0.1 * D } else { 1e9 });
            }
            assert!(clustering.run(&contacts[..2], tolerance, &Pose::IDENTITY).is_empty());
            let alone = clustering.run(&contacts[2..3], tolerance, &Pose::IDENTITY)[0].contact;
            assert!(alone.point == far && (alone.depth - 0.01).abs() < 1e-12);
        }
    }

    #[test]
    fn equal_contacts_make_one_cluster() {
        let mut clustering = Clustering::new(3);
        let contacts = vec![contact(DVec3::ONE, 0.01, DVec3::Z); 10];
        let found = clustering.run(&contacts, D, &Pose::IDENTITY);
        assert_eq!(found.len(), 1);
        assert!((found[0].weight - 10.0 * (0.01 + D)).abs() < 1e-12);
    }
}
