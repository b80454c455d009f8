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
    (0..count).map(|_| contact(vector(rng), rng.random_range(-D..2.0 * D), vector(rng).normalize())).collect()
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

/// A clustering with a history of random contacts, and the next contacts; at random places or on a grid, so
/// that many are equally near to two seeds.
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
            let Cluster { contact, weight, radius } = found.unwrap_or_else(|| panic!("Eq. 5.33, {context}"));
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
    // The largest observed change is 26 EPSILON D; it may be more if shared contacts hardly push.
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
        // One more contact with a tiny penalty, and one more with a tiny weight, as when contacts appear or
        // vanish.
        changed.push(contact(vector(&mut rng), EPSILON * D - D, vector(&mut rng).normalize()));
        let weight = EPSILON;
        changed.push(PatchContact { weight, ..contact(vector(&mut rng), D, vector(&mut rng).normalize()) });
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
            found.contact.depth = (found.contact.depth + EPSILON * D * rng.random_range(-1.0..1.0)).max(-D);
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
    // Contacts move, appear and vanish. The force changes by their motion and by the influence that seeds
    // gain: the largest observed change is 0.27 D per step, and 4 D if each contact belongs to one cluster as
    // printed.
    const STEPS: usize = 20_000;
    for seed in SEED..SEED + 20 {
        let mut rng = StdRng::seed_from_u64(seed);
        let mut clustering = Clustering::new(5);
        let paths: Vec<_> = (0..20).map(|_| (vector(&mut rng), vector(&mut rng), vector(&mut rng))).collect();
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
    let pose = Pose::new(DVec3::new(0.3, -2.0, 1.0), DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 2.0));
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
    // All at once, and one after another.
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
    // Two tight bunches; after a large motion of the probe the clusters are still the bunches.
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
            // Contacts without weight do not count, and the others nearly cancel.
            assert!(found.iter().all(|c| c.contact.point.distance(far) < 0.03));
            assert!(
                found.iter().all(|c| c.contact.scene_point.is_finite() && c.contact.normal.is_normalized())
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
