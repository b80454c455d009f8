//! Contact clustering (§5.4.2, Eqs 5.32–5.36): K-means over the contact points **p** with weights δ + d,
//! seeded by the clusters of the previous call, such that force and torque are continuous in the contacts.
//!
//! Algorithms 5.4.1–5.4.4 assign each contact to one cluster, and iterate until the assignment is stable. If
//! a contact is about equally near to two, rounding decides; the representatives jump, and the force with
//! them. Departures:
//!
//! - The assignment is soft: the nearest seed has all of a contact if every other is more than about twice as
//!   far ([`SHARING_RATIO`]), and the shares change smoothly in between. Shares depend only on the seeds and
//!   the contact's own point, so that a contact that appears with no weight changes nothing.
//! - A cluster pushes no more than its contacts together: its δ + d is that of Eq. 5.34, but at most |Σ (δ +
//!   d) **n**|. The two differ only if a cluster has less than a whole contact, or contacts whose normals are
//!   more than a right angle apart. Otherwise a tiny share of a deep contact would push like all of it, and
//!   normals that cancel leave no direction.
//! - The seeds are kept in the probe's frame and make one step of Lloyd's method in each call, after the
//!   representatives are known: a fraction ([`SEED_STEP`]) of the displacement to the mean of their contacts,
//!   less if these have little weight ([`INERTIA`]). So the iteration continues from call to call.
//! - A seed whose contacts have no weight is dropped, which changes nothing. If there are fewer seeds than
//!   min(K, n), some are added at contacts that cost most in Eq. 5.32, and gain influence over many calls
//!   ([`GROWTH`]).
//! - Without seeds, in the first call or if nothing pushed in the last, the first seed is at the contact with
//!   the largest weight, and a bounded number of steps is made at once.
//!
//! For given seeds, force and torque are continuous functions of the contacts' points, normals, depths and
//! weights, and so are the seeds carried on; seeds are added or dropped only while they have no influence.
//! While contacts rest, seeds that settle and gain influence still change the force, by a small amount per
//! call.
//!
//! Contacts that are counted in part ([`PatchContact::weight`]) have accordingly less weight. Clusters
//! without weight, or whose contacts cancel one another, are left out. Clusters are sorted by decreasing δ.

#[cfg(test)]
mod tests;

use palpate_core::glam::DVec3;
use palpate_core::{Contact, Pose};

use crate::contact::PatchContact;
use crate::tolerances::CANCELLED_NORMALS;

/// Smallest ratio of squared distances, both [blurred](BLUR), to the nearest seed over to this one, for which
/// a seed has a share of a contact. Smaller: more contacts are shared, and clusters move together. At 1 the
/// nearest seed has all, and the force jumps.
const SHARING_RATIO: f64 = 0.25;

/// Length by which distances from seeds are blurred, in tolerances d: contacts that move by less hardly
/// change their shares.
const BLUR: f64 = 2.0;

/// Largest fraction of the displacement to the mean of its contacts that a seed moves by in one call. Larger:
/// seeds settle sooner, and the force changes faster while contacts rest.
const SEED_STEP: f64 = 0.125;

/// Weight of its contacts, in tolerances d, for which a seed moves by half of the [`SEED_STEP`]. Smaller:
/// seeds with hardly any contact jump.
const INERTIA: f64 = 1.0;

/// Fraction of its influence that an added seed gains per call; more if its penalty is small against those
/// felt, to which it may add this fraction. Larger: the force changes faster while contacts rest.
const GROWTH: f64 = 1.0 / 64.0;

/// Number of steps of Lloyd's method in a call without seeds.
const FIRST_STEPS: u32 = 16;

/// A cluster of contacts with its representative contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cluster {
    /// The representative (Eqs 5.33–5.36), in world axes.
    pub contact: Contact,
    /// w: accumulated weight Σ (δ + d), m.
    pub weight: f64,
    /// Weighted root mean square distance of its contacts from the representative's point, m.
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
    /// Number of seeds with full influence.
    grown: usize,
    /// Influence of the other seeds, 0 to 1.
    growth: f64,
    sums: Vec<Sums>,
    clusters: Vec<Cluster>,
}

/// A seed with the sums over its contacts' shares.
#[derive(Clone, Copy, Debug)]
struct Sums {
    /// The seed, in world axes.
    seed: DVec3,
    /// Squared distance of the seed from the contact being shared out, blurred, m².
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

    /// The weighted mean of the contacts' points, m (Eq. 5.33); the seed if there are none.
    fn mean(&self) -> DVec3 {
        if self.weight > 0.0 { self.seed + self.point / self.weight } else { self.seed }
    }

    /// δ + d by Eq. 5.34, Σ (δ + d)² / Σ (δ + d), m, but at most the sum of the contacts' own.
    fn penalty(&self) -> f64 {
        self.weight.min(self.depth / self.weight)
    }

    /// The cluster with its representative (Eqs 5.33–5.36), with a fraction of the penalty.
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
        }
    }

    /// Clusters the contacts of one query, found with tolerance d (m), at the probe's pose. Deterministic:
    /// equal input gives equal output after equal history. Allocates nothing.
    pub fn run(&mut self, contacts: &[PatchContact], tolerance: f64, probe_pose: &Pose) -> &[Cluster] {
        self.clusters.clear();
        self.sums.clear();
        self.sums.extend(self.seeds.iter().map(|seed| Sums::at(probe_pose.transform_point(*seed))));
        if self.sums.is_empty() {
            self.add_seeds(contacts, tolerance);
            self.grown = self.sums.len();
            for _ in 0..FIRST_STEPS {
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
        // Insertion sort: K is small, and equal depths keep their order.
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

    /// Discards the seeds.
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
                // Shares of grown seeds are interpolated between those with and those without the growing
                // seeds.
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

    /// Moves the seeds, drops those without contacts and adds new ones, for the next call.
    fn carry(&mut self, contacts: &[PatchContact], tolerance: f64, probe_pose: &Pose) {
        for index in (0..self.sums.len()).rev() {
            if self.sums[index].weight <= 0.0 {
                self.sums.remove(index);
                self.grown -= usize::from(index < self.grown);
            }
        }
        for sums in &mut self.sums {
            let part = SEED_STEP * sums.weight / (sums.weight + INERTIA * tolerance);
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

    /// Adds seeds, at most as many in all as contacts with weight: the first at the heaviest contact, each
    /// other at the one that costs most in Eq. 5.32.
    fn add_seeds(&mut self, contacts: &[PatchContact], tolerance: f64) {
        let limit =
            self.capacity.min(contacts.iter().filter(|contact| weight(contact, tolerance) > 0.0).count());
        while self.sums.len() < limit {
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

/// Adds the seeds' shares of a part of a contact: part · c_i / Σ c_j with c_i = max(0, D_min / D_i −
/// [`SHARING_RATIO`]) for squared distances D.
fn divide(seeds: &mut [Sums], part: f64) {
    let nearest = seeds.iter().map(|sums| sums.distance).fold(f64::INFINITY, f64::min);
    let claim = |sums: &Sums| (nearest / sums.distance - SHARING_RATIO).max(0.0);
    let claims: f64 = seeds.iter().map(claim).sum();
    for sums in seeds {
        sums.share += part * claim(sums) / claims;
    }
}

/// Weight of a contact, m: δ + d times [`PatchContact::weight`].
fn weight(contact: &PatchContact, tolerance: f64) -> f64 {
    contact.weight * (contact.contact.depth + tolerance).max(0.0)
}
