//! Contact clustering (§5.4.2, Algorithms 5.4.1–5.4.4, Eqs 5.32–5.36): K-means over the contact points **p** with weights
//! δ + d, seeded by the clusters of the previous call.
//!
//! Departures, all where the text is silent or its formulas have no value:
//!
//! - The previous representatives are kept in the probe's frame, so that the seeds follow its motion.
//! - Without previous representatives the furthest contact (Alg. 5.4.2) is not defined: the first seed is the deepest.
//! - Lloyd's iteration is bounded, since a fixed point of floating-point sums need not be reached (Alg. 5.4.1's `until`).
//!   It ends when no contact changes its cluster: the sums are then the same again, so that is the same fixed point.
//! - With n ≤ K contacts each is its own cluster, which is where the algorithms end if no two are at one point. Two
//!   that are stay two, as the text says ("I only create n clusters"); as printed the second would have no contact and
//!   no weight.
//! - With n > K, a cluster left without contacts (a representative at the same point as another's, or a centroid that the
//!   others have crowded out) is dropped: its formulas are 0/0.
//! - A cluster whose weights are all 0 (every δ = −d) takes the plain mean, and one whose normals cancel the normal of
//!   its deepest contact. A weight that is negative by rounding counts as 0.
//! - Contacts of which only a part counts ([`PatchContact::weight`]) weigh that much less, and a cluster whose contacts
//!   make up less than one has that part of δ + d, so that contacts that come in or go out by their weight do so smoothly.
//! - Clusters come out by decreasing δ, as Alg. 5.4.1 wants them in. Removing those of small δ first (Alg. 5.4.2) never
//!   applies: with n > K there are never more old clusters than new, and with fewer contacts no seeds are needed.
//!
//! The closest pairs of Algorithm 5.4.2 are found by keeping every old cluster's nearest contact and renewing it only
//! when another cluster has taken it: the same pairs in the same order, mostly in O(n K).

use palpate_core::glam::DVec3;
use palpate_core::{Contact, Pose};

use crate::PatchContact;

/// Bound on Lloyd's iterations.
const MAX_ITERATIONS: u32 = 64;

const NONE: u32 = u32::MAX;

/// A cluster of contacts: the representative contact, and what it stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cluster {
    /// The representative (Eqs 5.33–5.36), in world axes.
    pub contact: Contact,
    /// w: accumulated weight Σ (δ + d), m.
    pub weight: f64,
}

/// The workspace of the clustering, with the memory of the previous frame's representatives.
#[derive(Clone, Debug)]
pub struct Clustering {
    capacity: usize,
    /// Old representatives in the probe's frame, by decreasing δ.
    previous: Vec<DVec3>,
    /// The same in world axes, with each one's nearest free contact and the squared distance.
    seeds: Vec<Seed>,
    /// S.p of the new clusters.
    centers: Vec<Accumulated>,
    /// Per contact: its cluster.
    assigned: Vec<u32>,
    /// Per contact: squared distance to the nearest representative while seeding; negative once it is one itself.
    nearest: Vec<f64>,
    clusters: Vec<Cluster>,
    iterations: u32,
}

#[derive(Clone, Copy, Debug)]
struct Seed {
    point: DVec3,
    contact: u32,
    distance: f64,
}

/// A cluster while it is being formed.
#[derive(Clone, Copy, Debug)]
struct Accumulated {
    point: DVec3,
    weighted: DVec3,
    plain: DVec3,
    weight: f64,
    count: usize,
}

impl Accumulated {
    fn at(point: DVec3) -> Self {
        Self { point, weighted: DVec3::ZERO, plain: DVec3::ZERO, weight: 0.0, count: 0 }
    }
}

impl Clustering {
    /// A workspace for at most `k` clusters (K), at least one.
    pub fn new(k: usize) -> Self {
        let capacity = k.max(1);
        Self {
            capacity,
            previous: Vec::with_capacity(capacity),
            seeds: Vec::with_capacity(capacity),
            centers: Vec::with_capacity(capacity),
            assigned: Vec::new(),
            nearest: Vec::new(),
            clusters: Vec::with_capacity(capacity),
            iterations: 0,
        }
    }

    /// Clusters the contacts of one query, found with tolerance d (m), at the probe's pose. Deterministic: equal input
    /// gives equal output after equal history. Allocates only when there are more contacts than ever before.
    pub fn run(&mut self, contacts: &[PatchContact], tolerance: f64, probe_pose: &Pose) -> &[Cluster] {
        self.clusters.clear();
        self.centers.clear();
        self.assigned.clear();
        self.nearest.clear();
        self.iterations = 0;
        if contacts.len() <= self.capacity {
            self.clusters.extend(contacts.iter().map(|contact| Cluster {
                contact: faded(&contact.contact, contact.weight, tolerance),
                weight: weight(contact, tolerance),
            }));
        } else {
            self.assigned.resize(contacts.len(), NONE);
            self.nearest.resize(contacts.len(), f64::INFINITY);
            self.seed_from_previous(contacts, probe_pose);
            self.seed_furthest(contacts);
            self.iterate(contacts, tolerance);
            self.represent(contacts, tolerance);
        }
        // Sorting by insertion: K is small, and equal depths keep their order.
        for index in 1..self.clusters.len() {
            let mut at = index;
            while at > 0 && self.clusters[at - 1].contact.depth < self.clusters[at].contact.depth {
                self.clusters.swap(at - 1, at);
                at -= 1;
            }
        }
        let to_probe = probe_pose.inverse();
        self.previous.clear();
        self.previous.extend(self.clusters.iter().map(|c| to_probe.transform_point(c.contact.point)));
        &self.clusters
    }

    /// The clusters of the last call, by decreasing δ.
    pub fn clusters(&self) -> &[Cluster] {
        &self.clusters
    }

    /// Lloyd's iterations of the last call.
    pub fn iterations(&self) -> u32 {
        self.iterations
    }

    /// Forgets the previous representatives.
    pub fn reset(&mut self) {
        self.previous.clear();
        self.clusters.clear();
    }

    /// First part of Algorithm 5.4.2: old clusters hand over to the contacts nearest to them, closest pair first.
    fn seed_from_previous(&mut self, contacts: &[PatchContact], probe_pose: &Pose) {
        self.seeds.clear();
        for &point in self.previous.iter().take(self.capacity) {
            let point = probe_pose.transform_point(point);
            let mut seed = Seed { point, contact: NONE, distance: f64::INFINITY };
            seed.renew(contacts, &self.nearest);
            self.seeds.push(seed);
        }
        while !self.seeds.is_empty() {
            let mut best = 0;
            for index in 1..self.seeds.len() {
                if self.seeds[index].distance < self.seeds[best].distance {
                    best = index;
                }
            }
            let seed = self.seeds.remove(best);
            if seed.contact == NONE {
                continue;
            }
            self.add_center(contacts, seed.contact as usize);
            for other in &mut self.seeds {
                if other.contact == seed.contact {
                    other.renew(contacts, &self.nearest);
                }
            }
        }
    }

    /// Second part of Algorithm 5.4.2: the remaining clusters start at the contacts furthest from those there are. The
    /// first of all starts at the deepest contact.
    fn seed_furthest(&mut self, contacts: &[PatchContact]) {
        while self.centers.len() < self.capacity {
            let mut best = (NONE, f64::NEG_INFINITY);
            for (index, contact) in (0u32..).zip(contacts) {
                let merit = if self.centers.is_empty() {
                    contact.contact.depth
                } else {
                    self.nearest[index as usize]
                };
                if merit > best.1 {
                    best = (index, merit);
                }
            }
            if best.0 == NONE || (!self.centers.is_empty() && best.1 < 0.0) {
                break;
            }
            self.add_center(contacts, best.0 as usize);
        }
    }

    fn add_center(&mut self, contacts: &[PatchContact], index: usize) {
        let point = contacts[index].contact.point;
        self.centers.push(Accumulated::at(point));
        for (nearest, contact) in self.nearest.iter_mut().zip(contacts) {
            *nearest = nearest.min(contact.contact.point.distance_squared(point));
        }
        self.nearest[index] = -1.0;
    }

    /// Lloyd's method: Algorithms 5.4.3 and 5.4.4 in turn, until nothing changes.
    fn iterate(&mut self, contacts: &[PatchContact], tolerance: f64) {
        for _ in 0..MAX_ITERATIONS {
            self.iterations += 1;
            for center in &mut self.centers {
                *center = Accumulated::at(center.point);
            }
            let mut moved = false;
            for (contact, assigned) in contacts.iter().zip(&mut self.assigned) {
                let point = contact.contact.point;
                let mut best = (0, f64::INFINITY);
                for (index, center) in (0u32..).zip(&self.centers) {
                    let distance = center.point.distance_squared(point);
                    if distance < best.1 {
                        best = (index, distance);
                    }
                }
                moved |= *assigned != best.0;
                *assigned = best.0;
                let center = &mut self.centers[best.0 as usize];
                let weight = weight(contact, tolerance);
                center.weighted += weight * point;
                center.plain += point;
                center.weight += weight;
                center.count += 1;
            }
            for center in &mut self.centers {
                if center.weight > 0.0 {
                    center.point = center.weighted / center.weight;
                } else if center.count > 0 {
                    center.point = center.plain / center.count as f64;
                }
            }
            // Equal assignments give equal representatives.
            if !moved {
                break;
            }
        }
    }

    /// Eqs 5.34–5.36, once the clusters have settled.
    fn represent(&mut self, contacts: &[PatchContact], tolerance: f64) {
        for (index, center) in (0u32..).zip(&self.centers) {
            if center.count == 0 {
                continue;
            }
            let (mut depth, mut normal, mut presence) = (0.0, DVec3::ZERO, 0.0);
            let mut deepest: Option<&Contact> = None;
            for (contact, _) in contacts.iter().zip(&self.assigned).filter(|(_, s)| **s == index) {
                let share = if center.weight > 0.0 {
                    weight(contact, tolerance) / center.weight
                } else {
                    1.0 / center.count as f64
                };
                presence += contact.weight;
                let contact = &contact.contact;
                depth += share * contact.depth;
                normal += share * contact.normal;
                if deepest.is_none_or(|deepest| contact.depth > deepest.depth) {
                    deepest = Some(contact);
                }
            }
            let fallback = deepest.map_or(DVec3::Z, |contact| contact.normal);
            let normal = if normal.length() > 1e-6 { normal.normalize() } else { fallback };
            let representative =
                Contact { point: center.point, scene_point: center.point - depth * normal, normal, depth };
            self.clusters.push(Cluster {
                contact: faded(&representative, presence, tolerance),
                weight: center.weight,
            });
        }
    }
}

impl Seed {
    /// Finds the nearest contact that is no representative yet.
    fn renew(&mut self, contacts: &[PatchContact], nearest: &[f64]) {
        (self.contact, self.distance) = (NONE, f64::INFINITY);
        for ((index, contact), nearest) in (0u32..).zip(contacts).zip(nearest) {
            let distance = contact.contact.point.distance_squared(self.point);
            if *nearest >= 0.0 && distance < self.distance {
                (self.contact, self.distance) = (index, distance);
            }
        }
    }
}

/// δ + d, m, as far as the contact counts.
fn weight(contact: &PatchContact, tolerance: f64) -> f64 {
    contact.weight * (contact.contact.depth + tolerance).max(0.0)
}

/// A contact of which only a part counts, in all: δ + d is that part of what it was.
fn faded(contact: &Contact, part: f64, tolerance: f64) -> Contact {
    if part >= 1.0 {
        return *contact;
    }
    let depth = part * (contact.depth + tolerance) - tolerance;
    Contact { scene_point: contact.point - depth * contact.normal, depth, ..*contact }
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

    fn random(rng: &mut StdRng, count: usize) -> Vec<PatchContact> {
        (0..count)
            .map(|_| {
                let v = |rng: &mut StdRng| {
                    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
                };
                contact(v(rng), rng.random_range(-D..2.0 * D), v(rng).normalize())
            })
            .collect()
    }

    /// Algorithms 5.4.1–5.4.4 as printed, with plain searches.
    fn plain(contacts: &[PatchContact], old: &[DVec3], k: usize) -> Vec<(DVec3, DVec3, f64, f64)> {
        let m = k.min(contacts.len());
        let p = |i: usize| contacts[i].contact.point;
        let mut free: Vec<usize> = (0..contacts.len()).collect();
        let mut old: Vec<DVec3> = old.iter().copied().take(m).collect();
        let mut centers: Vec<DVec3> = Vec::new();
        while !old.is_empty() {
            let mut best = (f64::INFINITY, 0, 0);
            for (o, from) in old.iter().enumerate() {
                for (f, i) in free.iter().enumerate() {
                    if p(*i).distance_squared(*from) < best.0 {
                        best = (p(*i).distance_squared(*from), o, f);
                    }
                }
            }
            old.remove(best.1);
            centers.push(p(free.remove(best.2)));
        }
        while centers.len() < m {
            let reach = |i: usize| {
                if centers.is_empty() {
                    return contacts[i].contact.depth;
                }
                centers.iter().map(|c| c.distance_squared(p(i))).fold(f64::INFINITY, f64::min)
            };
            let mut best = 0;
            for f in 0..free.len() {
                if reach(free[f]) > reach(free[best]) {
                    best = f;
                }
            }
            centers.push(p(free.remove(best)));
        }
        let mut assigned = vec![usize::MAX; contacts.len()];
        loop {
            let next: Vec<usize> = (0..contacts.len())
                .map(|i| {
                    let d = |j: usize| centers[j].distance_squared(p(i));
                    (0..m).fold(0, |best, j| if d(j) < d(best) { j } else { best })
                })
                .collect();
            for (j, center) in centers.iter_mut().enumerate() {
                let own = || (0..contacts.len()).filter(|i| next[*i] == j);
                let w: f64 = own().map(|i| contacts[i].contact.depth + D).sum();
                if w > 0.0 {
                    *center = own().map(|i| (contacts[i].contact.depth + D) * p(i)).sum::<DVec3>() / w;
                }
            }
            if next == assigned {
                break;
            }
            assigned = next;
        }
        let mut out: Vec<(DVec3, DVec3, f64, f64)> = (0..m)
            .filter(|j| assigned.contains(j))
            .map(|j| {
                let own = || contacts.iter().zip(&assigned).filter(|(_, s)| **s == j).map(|(c, _)| c.contact);
                let w: f64 = own().map(|c| c.depth + D).sum();
                let depth = own().map(|c| (c.depth + D) * c.depth).sum::<f64>() / w;
                let normal = own().map(|c| (c.depth + D) * c.normal).sum::<DVec3>().normalize();
                (centers[j], normal, depth, w)
            })
            .collect();
        out.sort_by(|x, y| y.2.total_cmp(&x.2));
        out
    }

    #[test]
    fn agrees_with_the_algorithms_as_printed() {
        let mut rng = StdRng::seed_from_u64(SEED);
        for round in 0..400 {
            let k = rng.random_range(1..8);
            let mut clustering = Clustering::new(k);
            let mut old: Vec<DVec3> = Vec::new();
            for frame in 0..3 {
                let count = rng.random_range(1..60);
                let contacts = random(&mut rng, count);
                let found = clustering.run(&contacts, D, &Pose::IDENTITY);
                let context = format!("seed {SEED:#x}, round {round}, frame {frame}");
                let expected = plain(&contacts, &old, k);
                assert_eq!(found.len(), expected.len(), "{context}");
                for (one, (point, normal, depth, weight)) in found.iter().zip(expected) {
                    assert!(one.contact.point.distance(point) < 1e-9, "{context}");
                    assert!(one.contact.normal.distance(normal) < 1e-9, "{context}");
                    assert!((one.contact.depth - depth).abs() < 1e-12, "{context}");
                    assert!((one.weight - weight).abs() < 1e-9, "{context}");
                    let offset = one.contact.point - one.contact.depth * one.contact.normal;
                    assert!(one.contact.scene_point.distance(offset) < 1e-12, "Eq. 5.36, {context}");
                }
                old = found.iter().map(|c| c.contact.point).collect();
            }
        }
    }

    #[test]
    fn few_contacts_are_their_own_clusters() {
        let mut rng = StdRng::seed_from_u64(SEED + 1);
        let mut clustering = Clustering::new(5);
        assert!(clustering.run(&[], D, &Pose::IDENTITY).is_empty());
        for count in 1..=5 {
            let contacts = random(&mut rng, count);
            let found = clustering.run(&contacts, D, &Pose::IDENTITY);
            assert_eq!(found.len(), count);
            assert!(contacts.iter().all(|c| found.iter().any(|f| f.contact == c.contact)));
            assert!(found.is_sorted_by(|x, y| x.contact.depth >= y.contact.depth));
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
        assert!(clustering.iterations() <= 2);
    }

    #[test]
    fn weightless_and_opposed_contacts_stay_finite() {
        let mut clustering = Clustering::new(2);
        let far = DVec3::X;
        let contacts = [
            contact(DVec3::ZERO, -D, DVec3::Z),
            contact(DVec3::Y * 0.2, -D, DVec3::Z),
            contact(far, 0.01, DVec3::Z),
            contact(far + DVec3::Y * 0.2, 0.01, -DVec3::Z),
        ];
        let found = clustering.run(&contacts, D, &Pose::IDENTITY);
        assert_eq!(found.len(), 2);
        // Eq. 5.35's sum is zero: the normal of one of the two.
        assert_eq!(found[0].contact.normal.z.abs(), 1.0);
        assert!(found[0].contact.point.distance(far + DVec3::Y * 0.1) < 1e-12);
        assert_eq!(found[1].weight, 0.0);
        assert!(found[1].contact.point.distance(DVec3::Y * 0.1) < 1e-12);
        assert!(found.iter().all(|c| c.contact.point.is_finite() && c.contact.depth.is_finite()));
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
