//! The contact query against every pair of triangles.

use std::collections::{HashMap, HashSet};

use crate::oracle::{Triangle, normal};
use crate::solids::{Body, Kind, clusters, hierarchy, pose, singles, star, torus, vector};
use palpate_clod_build::{BuildOptions, build, unwatched};
use palpate_collide::{
    ContactQuery, ErrorMetrics, MAX_CONTACTS, MAX_PAIRS, PatchContact, QueryError, QueryObject, QueryOutcome,
    QuerySettings, Shape,
};
use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Clod, Pose, TriMesh};
use rand::{RngExt, SeedableRng, rngs::StdRng};

const SEED: u64 = 0x0B5E_55ED;

/// Whether no neighbouring triangle on either side undercuts the pair, and (on solids) some triangle at each
/// of the points faces the other.
fn is_local_minimum(
    a: &Body,
    b: &Body,
    (ta, tb): (&[Triangle], &[Triangle]),
    (i, j, distance): (usize, usize, f64),
) -> bool {
    let (x, y) = crate::oracle::nearest(ta[i], tb[j]);
    let eps = 1e-9;
    let on = |t: &[Triangle], k: usize, p: DVec3| crate::oracle::point_triangle(p, t[k]).distance(p) < eps;
    let at_x: Vec<usize> = a.neighbours(i).into_iter().filter(|k| on(ta, *k, x)).collect();
    let at_y: Vec<usize> = b.neighbours(j).into_iter().filter(|k| on(tb, *k, y)).collect();
    // Jointly, not one side at a time: two crossing edges may shorten only by moving both.
    let undercut =
        at_x.iter().any(|k| at_y.iter().any(|l| crate::oracle::distance(ta[*k], tb[*l]) < distance - eps));
    let direction = (y - x) / distance;
    let front = |solid: bool, t: &[Triangle], at: &[usize], n: DVec3| {
        !solid || at.iter().any(|k| normal(t[*k]).dot(n) > 1e-6)
    };
    !undercut && front(a.solid, ta, &at_x, direction) && front(b.solid, tb, &at_y, -direction)
}

#[derive(Default, Debug)]
struct Tally {
    disjoint: usize,
    intersecting: usize,
    contacts: usize,
    minima: usize,
    worst: f64,
}

#[expect(clippy::too_many_arguments)]
fn check(
    a: &Body,
    pose_a: &Pose,
    b: &Body,
    pose_b: &Pose,
    tolerance: f64,
    query: &mut ContactQuery,
    tally: &mut Tally,
    context: &str,
) {
    let outcome = query.run(pose_a, pose_b, &QuerySettings::new(tolerance)).unwrap();
    let (ta, tb) = (crate::oracle::placed(&a.mesh, pose_a), crate::oracle::placed(&b.mesh, pose_b));
    let pairs = crate::oracle::pairs_within(&ta, &tb, tolerance);
    let scale = a.radius.max(b.radius);
    let contacts = query.contacts();
    sane(contacts, &outcome, tolerance, scale, context);

    let mut exact = HashMap::<(u32, u32), f64>::new();
    for &(i, j, d) in &pairs {
        let entry = exact.entry((a.leaf_of[i], b.leaf_of[j])).or_insert(f64::INFINITY);
        *entry = entry.min(d);
    }
    let mut reported = HashMap::<(u32, u32), Vec<&PatchContact>>::new();
    for contact in contacts {
        reported.entry((contact.probe_node, contact.scene_node)).or_default().push(contact);
    }
    let intersecting: HashSet<(u32, u32)> =
        pairs.iter().filter(|p| p.2 == 0.0).map(|&(i, j, _)| (a.leaf_of[i], b.leaf_of[j])).collect();
    for pair in &intersecting {
        let found = reported.get(pair);
        assert!(found.is_some(), "{context}: patches {pair:?} intersect, and have no contact");
        assert!(found.unwrap().iter().any(|c| c.contact.depth >= 0.0), "{context}: {pair:?}");
    }
    if intersecting.is_empty() {
        tally.disjoint += 1;
        let plain = pairs.iter().map(|p| p.2).reduce(f64::min);
        match (plain, outcome.smallest_distance) {
            (Some(plain), Some(found)) => {
                tally.worst = tally.worst.max((plain - found).abs() / scale);
                assert!((plain - found).abs() <= 1e-9 * scale, "{context}: {plain} {found}");
            }
            (None, None) => {}
            other => panic!("{context}: plain and found distance {other:?}"),
        }
        for (pair, found) in &reported {
            let least = found.iter().map(|c| c.contact.distance()).fold(f64::INFINITY, f64::min);
            let plain = exact.get(pair).copied().unwrap_or(f64::INFINITY);
            assert!((least - plain).abs() <= 1e-9 * scale, "{context}: {pair:?} {least} {plain}");
        }
    } else {
        tally.intersecting += 1;
    }
    for &(i, j, d) in &pairs {
        if d == 0.0 || !is_local_minimum(a, b, (&ta, &tb), (i, j, d)) {
            continue;
        }
        tally.minima += 1;
        let (x, y) = crate::oracle::nearest(ta[i], tb[j]);
        // Equal pairs that share a vertex or an edge, or are parallel, need only one contact.
        let near = |c: &&PatchContact| {
            (c.contact.distance() - d).abs() < 1e-9 * scale
                && ((c.contact.point.distance(x) < 1e-7 * scale
                    && c.contact.scene_point.distance(y) < 1e-7 * scale)
                    || (c.probe_node, c.scene_node) == (a.leaf_of[i], b.leaf_of[j]))
        };
        let sunk = reported
            .get(&(a.leaf_of[i], b.leaf_of[j]))
            .is_some_and(|found| found.iter().any(|c| c.contact.depth >= 0.0));
        assert!(sunk || contacts.iter().any(|c| near(&c)), "{context}: local minimum {d} at {x} {y}");
    }
    tally.contacts += contacts.len();
}

fn sane(contacts: &[PatchContact], outcome: &QueryOutcome, tolerance: f64, scale: f64, context: &str) {
    assert!(outcome.dropped == 0 && outcome.not_converged == 0, "{context}: {outcome:?}");
    assert_eq!(outcome.contacts, contacts.len());
    for PatchContact { contact, .. } in contacts {
        assert!((contact.normal.length() - 1.0).abs() < 1e-9, "{context}: {contact:?}");
        assert!(
            contact.depth.is_finite() && contact.depth >= -tolerance * (1.0 + 1e-9),
            "{context}: {contact:?}"
        );
        let offset = contact.point - contact.depth * contact.normal - contact.scene_point;
        assert!(offset.length() <= 1e-9 * scale, "{context}: Eq. 5.36, {contact:?}");
    }
}

/// Poses from far apart to deep penetration: `along` is the distance of the centres.
fn sweep(a: &Body, b: &Body, tolerance: f64, range: (f64, f64), rounds: usize, name: &str) -> Tally {
    let mut rng = StdRng::seed_from_u64(SEED);
    let mut query = ContactQuery::new(&a.shape, &b.shape);
    let mut tally = Tally::default();
    for round in 0..rounds {
        let direction = vector(&mut rng).normalize();
        let along = rng.random_range(range.0..range.1);
        let pose_b = pose(&mut rng, vector(&mut StdRng::seed_from_u64(round as u64)) * 3.0);
        let pose_a = pose(&mut rng, pose_b.translation + direction * along);
        let context = format!("{name}, seed {SEED:#x}, round {round}");
        check(a, &pose_a, b, &pose_b, tolerance, &mut query, &mut tally, &context);
    }
    assert!(tally.disjoint > 0 && tally.intersecting > 0 && tally.minima > 0, "{name}: {tally:?}");
    tally
}

fn bumpy() -> TriMesh {
    star(3, |v| 1.0 + 0.12 * (7.0 * v.x).sin() * (6.0 * v.y + 1.0).sin() * (5.0 * v.z).cos())
}

#[test]
fn single_triangles_of_two_bumpy_balls() {
    let patches = singles(&bumpy());
    let body = Body::new(bumpy(), &patches, Kind::Contained);
    sweep(&body, &body, 0.05, (1.75, 2.3), 60, "bumpy balls");
}

#[test]
fn rings_through_each_other() {
    let ring = torus(1.0, 0.25, 24, 10);
    let patches = singles(&ring);
    let body = Body::new(ring, &patches, Kind::Contained);
    sweep(&body, &body, 0.04, (0.6, 2.4), 60, "rings");
}

#[test]
fn patches_of_convex_balls() {
    let ball = star(3, |v| 1.0 + 0.3 * v.z * v.z);
    for size in [2, 5, 40] {
        let body = Body::new(ball.clone(), &clusters(&ball, size), Kind::Contained);
        sweep(&body, &body, 0.05, (1.9, 2.6), 40, &format!("patches of {size}"));
    }
}

#[test]
fn a_whole_ellipsoid_pressed_into_bumps() {
    let ellipsoid = star(4, |v| 1.0 / (v / DVec3::new(1.0, 0.7, 0.5)).length());
    let everything = vec![(0..ellipsoid.triangles().len() as u32).collect()];
    let probe = Body::new(ellipsoid, &everything, Kind::Contained);
    assert!(probe.clod.node(0).all_real);
    let ground = star(4, |v| 3.0 + 0.02 * (31.0 * v.x).sin() * (29.0 * v.y).sin() * (27.0 * v.z).sin());
    let patches = singles(&ground);
    let scene = Body::new(ground, &patches, Kind::Contained);
    sweep(&probe, &scene, 0.04, (3.4, 4.05), 40, "ellipsoid on bumps");
}

#[test]
fn patches_whose_hulls_protrude() {
    let mesh = bumpy();
    let patches = clusters(&mesh, 4);
    let body = Body::new(mesh, &patches, Kind::Loose);
    sweep(&body, &body, 0.05, (1.75, 2.3), 40, "protruding hulls");
}

#[test]
fn open_shells_touch_from_both_sides() {
    let ball = star(3, |v| 1.0 + 0.05 * (9.0 * v.x).sin());
    let half: Vec<[u32; 3]> = (0..ball.triangles().len())
        .filter(|t| ball.corners(*t).iter().all(|c| c.z > -1e-9))
        .map(|t| ball.triangles()[t])
        .collect();
    let shell = TriMesh::new(ball.vertices().to_vec(), half).unwrap();
    for size in [1, 4] {
        let body = Body::new(shell.clone(), &clusters(&shell, size), Kind::Open);
        sweep(&body, &body, 0.05, (0.05, 2.2), 40, &format!("shells in patches of {size}"));
    }
}

fn box_mesh(half: DVec3) -> TriMesh {
    let corner =
        |i: u32| half * DVec3::from_array([0, 1, 2].map(|k| if i >> k & 1 == 1 { 1.0 } else { -1.0 }));
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    TriMesh::new((0..8).map(corner).collect(), triangles).unwrap()
}

/// Boxes in aligned poses: every nearest pair is parallel to others, and every number is known.
#[test]
fn aligned_boxes() {
    let whole = |mesh: &TriMesh| vec![(0..mesh.triangles().len() as u32).collect::<Vec<u32>>()];
    let mesh = box_mesh(DVec3::new(1.0, 0.8, 0.6));
    for (patches, name) in
        [(singles(&mesh), "triangles"), (whole(&mesh), "whole"), (clusters(&mesh, 2), "pairs")]
    {
        let body = Body::new(mesh.clone(), &patches, Kind::Contained);
        let mut query = ContactQuery::new(&body.shape, &body.shape);
        let mut tally = Tally::default();
        for gap in [0.0301, 1e-3, 1e-6, 1e-9] {
            let up = Pose::from_translation(DVec3::new(0.3, 0.2, 1.2 + gap));
            check(&body, &up, &body, &Pose::IDENTITY, 0.05, &mut query, &mut tally, name);
            for c in query.contacts().iter().filter(|c| (c.contact.depth + gap).abs() < 1e-6 * gap) {
                assert!(c.contact.normal.dot(-DVec3::Z) > 1.0 - 1e-6, "{name} {gap}: {c:?}");
            }
        }
        // Touching to the last bit, and penetrating.
        for depth in [0.0, 1e-12, 1e-9, 1e-4, 0.01] {
            let up = Pose::from_translation(DVec3::new(0.3, 0.2, 1.2 - depth));
            let outcome = query.run(&up, &Pose::IDENTITY, &QuerySettings::new(0.05)).unwrap();
            sane(query.contacts(), &outcome, 0.05, 1.0, name);
            let down = query
                .contacts()
                .iter()
                .filter(|c| (c.contact.depth - depth).abs() < 1e-10 && c.contact.normal.z < -1.0 + 1e-9);
            assert!(down.count() > 0, "{name}, depth {depth}: {:#?}", query.contacts());
        }
    }
}

/// A plate whose rim is one patch: its hull is the plate, with the two large faces virtual. An object pressed
/// into the plate touches that hull far from any of its triangles.
#[test]
fn pressing_past_virtual_faces_is_no_deeper_than_the_press() {
    let plate = box_mesh(DVec3::new(1.0, 1.0, 0.1));
    let plate = Body::new(plate, &[vec![0, 1], vec![2, 3], (4..12).collect()], Kind::Contained);
    let peg = box_mesh(DVec3::new(0.2, 0.1, 0.3));
    for (patches, name) in [
        (vec![(0..12).collect()], "whole"),
        (singles(&peg), "triangles"),
        (clusters(&peg, 5), "patches of 5"),
    ] {
        let peg = Body::new(peg.clone(), &patches, Kind::Contained);
        let mut query = ContactQuery::new(&peg.shape, &plate.shape);
        for press in [0.0, 1e-12, 1e-9, 1e-5, 1e-3, 0.02] {
            let pose = Pose::from_translation(DVec3::new(0.5, -0.3, 0.4 - press));
            let outcome = query.run(&pose, &Pose::IDENTITY, &QuerySettings::new(1e-3)).unwrap();
            sane(query.contacts(), &outcome, 1e-3, 1.0, name);
            assert!(!query.contacts().is_empty(), "{name}, press {press}");
            for PatchContact { contact, .. } in query.contacts() {
                assert!(contact.depth <= press + 1e-11, "{name}, press {press}: {contact:?}");
                let aside = (contact.point - pose.translation).abs() - DVec3::new(0.2, 0.1, 0.3);
                assert!(aside.max_element() < 1e-9, "{name}, press {press}: off the peg, {contact:?}");
            }
        }
    }
}

/// Faces in one plane, in frames where rounding makes them slightly apart or penetrating: a tolerance of 0
/// finds them.
#[test]
fn faces_in_one_plane_touch_at_zero_tolerance() {
    let mut rng = StdRng::seed_from_u64(SEED + 3);
    let mesh = box_mesh(DVec3::new(1.0, 0.8, 0.6));
    for patches in [singles(&mesh), clusters(&mesh, 2), vec![(0..12).collect()]] {
        let body = Body::new(mesh.clone(), &patches, Kind::Contained);
        let mut query = ContactQuery::new(&body.shape, &body.shape);
        for round in 0..200 {
            let scene = pose(&mut rng, DVec3::new(3.0, -40.0, 0.7));
            let probe = scene * Pose::from_translation(DVec3::new(0.3, 0.2, 1.2));
            query.run(&probe, &scene, &QuerySettings::new(0.0)).unwrap();
            assert!(!query.contacts().is_empty(), "seed {:#x}, round {round}", SEED + 3);
        }
    }
}

/// Two triangles crossing like an X, at every angle and offset: always a contact, and a depth no larger than
/// they are.
#[test]
fn crossing_triangles_always_touch() {
    let mut rng = StdRng::seed_from_u64(SEED + 1);
    for round in 0..3_000 {
        let slim = if round % 3 == 0 { 1e-3 } else { 1.0 };
        let mut triangle = || {
            let mesh = TriMesh::new(
                (0..3).map(|_| vector(&mut rng) * DVec3::new(1.0, slim, 1.0)).collect(),
                vec![[0, 1, 2]],
            );
            Body::new(mesh.unwrap(), &[vec![0]], if round % 2 == 0 { Kind::Contained } else { Kind::Open })
        };
        let (a, b) = (triangle(), triangle());
        let (ta, tb) = (
            crate::oracle::placed(&a.mesh, &Pose::IDENTITY),
            crate::oracle::placed(&b.mesh, &Pose::IDENTITY),
        );
        let mut query = ContactQuery::new(&a.shape, &b.shape);
        let outcome = query.run(&Pose::IDENTITY, &Pose::IDENTITY, &QuerySettings::new(0.0)).unwrap();
        let context = format!("seed {:#x}, round {round}: {ta:?} {tb:?} {:?}", SEED + 1, query.contacts());
        sane(query.contacts(), &outcome, 0.0, 1.0, &context);
        if crate::oracle::intersect(ta[0], tb[0]) {
            assert_eq!(query.contacts().len(), 1, "{context}");
            assert!(query.contacts()[0].contact.depth <= 2.0 * 3f64.sqrt(), "{context}");
        }
    }
}

/// A ball sunk into a block of fine triangles: the depth is that of the ball's lowest point.
#[test]
fn depth_of_a_ball_in_a_plane() {
    let n = 24;
    let vertices = (0..=n).flat_map(|i| {
        (0..=n).map(move |j| DVec3::new(f64::from(i), f64::from(j), 0.0) * 0.1 - DVec3::new(1.2, 1.2, 0.0))
    });
    let at = |i: u32, j: u32| i * (n + 1) + j;
    let cells = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
    let triangles = cells.flat_map(|(i, j)| {
        [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
    });
    let plane = TriMesh::new(vertices.collect(), triangles.collect()).unwrap();
    let patches = singles(&plane);
    // As part of a solid's surface, only its upper side counts.
    let scene = Body::new(plane, &patches, Kind::Contained);
    let ball = star(4, |_| 1.0);
    let probe = Body::new(ball.clone(), &[(0..ball.triangles().len() as u32).collect()], Kind::Contained);
    let mut query = ContactQuery::new(&probe.shape, &scene.shape);
    for depth in [1e-6, 1e-3, 0.01, 0.05] {
        let up = Pose::new(DVec3::new(0.013, 0.021, 1.0 - depth), DQuat::IDENTITY);
        let outcome = query.run(&up, &Pose::IDENTITY, &QuerySettings::new(0.01)).unwrap();
        sane(query.contacts(), &outcome, 0.01, 1.0, "ball in plane");
        // The lowest vertex of the ball is at its pole.
        let deepest = outcome.deepest.unwrap();
        assert!((deepest - depth).abs() < 0.02 * depth + 1e-12, "{depth}: {deepest}");
        for c in query.contacts().iter().filter(|c| c.contact.depth > 0.5 * depth) {
            assert!(c.contact.normal.z < -0.8, "{depth}: {c:?}");
        }
    }
}

#[test]
fn swapping_the_bodies_swaps_the_contacts() {
    let mesh = bumpy();
    let ball = star(2, |v| 0.8 + 0.1 * v.x);
    let a = Body::new(mesh.clone(), &singles(&mesh), Kind::Contained);
    let b = Body::new(ball.clone(), &clusters(&ball, 6), Kind::Contained);
    let mut rng = StdRng::seed_from_u64(SEED + 2);
    let (mut there, mut back) =
        (ContactQuery::new(&a.shape, &b.shape), ContactQuery::new(&b.shape, &a.shape));
    for round in 0..40 {
        let direction = vector(&mut rng).normalize() * rng.random_range(1.9..2.1);
        let (pose_a, pose_b) = (pose(&mut rng, DVec3::ONE), pose(&mut rng, DVec3::ONE + direction));
        let settings = QuerySettings::new(0.1);
        let one = there.run(&pose_a, &pose_b, &settings).unwrap();
        let other = back.run(&pose_b, &pose_a, &settings).unwrap();
        assert_eq!(one.contacts, other.contacts, "seed {:#x}, round {round}", SEED + 2);
        let close = |x: Option<f64>, y: Option<f64>| match (x, y) {
            (Some(x), Some(y)) => (x - y).abs() < 1e-9,
            (x, y) => x == y,
        };
        assert!(close(one.smallest_distance, other.smallest_distance), "round {round}: {one:?} {other:?}");
        assert!(close(one.deepest, other.deepest), "round {round}: {one:?} {other:?}");
    }
}

/// Contacts scale with all lengths, at full resolution and at coarser levels, and their number does not
/// change.
#[test]
fn the_unit_of_length_does_not_matter() {
    let seed = SEED + 3;
    let mut rng = StdRng::seed_from_u64(seed);
    let meshes = [bumpy(), torus(0.8, 0.3, 40, 16)];
    let built = meshes.map(|mesh| build(&mesh, &BuildOptions::default(), &mut unwatched).unwrap());
    let exact = QuerySettings::new(0.02);
    let coarse = QuerySettings { error: 0.025.into(), ..exact };
    let kinds = [exact, coarse, QuerySettings { interpolate: true, ..coarse }];
    let poses: Vec<Pose> = (0..60)
        .map(|_| {
            let away = vector(&mut rng).normalize() * rng.random_range(1.2..2.1);
            pose(&mut rng, away)
        })
        .collect();
    let mut powers: Vec<f64> = (0..6).map(|_| rng.random_range(-3.0..3.0)).collect();
    powers.extend([-3.0, 3.0]);
    let run = |scale: f64| {
        let shapes = [0, 1].map(|i: usize| Shape::new(built[i].scaled(scale).unwrap()));
        let mut found = Vec::new();
        for kind in &kinds {
            let mut query = ContactQuery::new(&shapes[0], &shapes[1]);
            let haptic = kind.error.haptic.map(|error| error * scale);
            let error = ErrorMetrics { haptic, ..kind.error };
            let settings = QuerySettings { tolerance: kind.tolerance * scale, error, ..*kind };
            for pose in &poses {
                let placed = Pose::new(pose.translation * scale, pose.rotation);
                query.run(&placed, &Pose::IDENTITY, &settings).unwrap();
                let mut contacts = query.contacts().to_vec();
                contacts.iter_mut().for_each(|PatchContact { contact: c, .. }| {
                    (c.point, c.scene_point, c.depth) =
                        (c.point / scale, c.scene_point / scale, c.depth / scale);
                });
                // The order of contacts is not guaranteed.
                contacts.sort_by(|x, y| {
                    let nodes = |c: &PatchContact| (c.probe_node, c.scene_node);
                    nodes(x).cmp(&nodes(y)).then(x.contact.depth.total_cmp(&y.contact.depth))
                });
                found.push(contacts);
            }
        }
        found
    };
    let unit = run(1.0);
    let count = |found: &[Vec<PatchContact>]| found.iter().map(Vec::len).sum::<usize>();
    assert!(count(&unit[..poses.len()]) > 1000 && count(&unit[poses.len()..]) > 500, "{}", count(&unit));
    for scale in powers.into_iter().map(|power| 10f64.powf(power)) {
        for (index, (one, other)) in unit.iter().zip(run(scale)).enumerate() {
            let context = format!("seed {seed:#x}, scale {scale}, query {index}");
            assert_eq!(one.len(), other.len(), "{context}");
            for (x, y) in one.iter().zip(&other) {
                assert_eq!((x.probe_node, x.scene_node), (y.probe_node, y.scene_node), "{context}");
                let (a, b) = (&x.contact, &y.contact);
                let same = (a.depth - b.depth).abs() < 1e-9
                    && a.point.distance(b.point) < 1e-7
                    && a.scene_point.distance(b.scene_point) < 1e-7
                    && a.normal.distance(b.normal) < 1e-6
                    && (x.weight - y.weight).abs() < 1e-7;
                assert!(same, "{context}: {x:?} {y:?}");
            }
        }
    }
}

/// Queries know the tolerance that patches were built with: where it is larger, more pairs are decided
/// triangle by triangle, whichever of the two shapes has it.
#[test]
fn the_larger_tolerance_of_both_shapes_counts() {
    let mesh = bumpy();
    let (clod, _) = hierarchy(&mesh, &clusters(&mesh, 4), Kind::Contained);
    let mut parts = clod.parts();
    parts.source.tolerance = 1e-2;
    let [tight, loose] = [clod, Clod::pack(&parts).unwrap()].map(Shape::new);
    let by_triangles = |probe: &Shape, scene: &Shape| {
        let pose = Pose::from_translation(1.95 * DVec3::X);
        let outcome = ContactQuery::new(probe, scene).run(&pose, &Pose::IDENTITY, &QuerySettings::new(0.1));
        outcome.unwrap().by_triangles
    };
    let least = by_triangles(&tight, &tight);
    let both = [by_triangles(&tight, &loose), by_triangles(&loose, &tight)];
    assert!(
        both[0] > least && both[0] == both[1] && both[0] == by_triangles(&loose, &loose),
        "{least}, {both:?}"
    );
}

#[test]
fn buffers_grow_and_bad_input_is_refused() {
    let mesh = bumpy();
    let body = Body::new(mesh.clone(), &singles(&mesh), Kind::Contained);
    let mut query = ContactQuery::with_capacity(&body.shape, &body.shape, 100, 1 << 12);
    let near = Pose::from_translation(DVec3::X * 0.01);
    let open = QuerySettings::new(0.3);
    let grown = query.run(&near, &Pose::IDENTITY, &open).unwrap();
    assert!(grown.dropped == 0 && grown.reallocated && grown.contacts == query.contacts().len());
    let again = query.run(&near, &Pose::IDENTITY, &open).unwrap();
    assert!(!again.reallocated);

    let lost = Pose::from_translation(DVec3::new(f64::NAN, 0.0, 0.0));
    let mut refused = |probe: &Pose, scene: &Pose, settings: QuerySettings| {
        let error = query.run(probe, scene, &settings).unwrap_err();
        assert!(query.contacts().is_empty(), "{error}");
        error
    };
    let origin = Pose::IDENTITY;
    assert_eq!(refused(&lost, &origin, open), QueryError::Pose { object: QueryObject::Probe });
    assert_eq!(refused(&near, &lost, open), QueryError::Pose { object: QueryObject::Scene });
    let most = body.shape.max_tolerance();
    for given in [-1.0, 1.001 * most, f64::INFINITY] {
        let error = refused(&near, &origin, QuerySettings::new(given));
        assert_eq!(error, QueryError::Tolerance { given, most });
        assert!(error.to_string().contains(&format!("0 to {most} m")), "{error}");
    }
    let unknown = refused(&near, &origin, QuerySettings::new(f64::NAN));
    assert!(matches!(unknown, QueryError::Tolerance { .. }));
    let negative = QuerySettings { error: (-1.0).into(), ..open };
    assert_eq!(refused(&near, &origin, negative), QueryError::HapticMetric { given: -1.0 });
    // The largest tolerance is accepted, and an error does not affect later queries.
    assert!(query.run(&near, &origin, &QuerySettings::new(most)).unwrap().contacts > grown.contacts);
    assert_eq!(query.run(&near, &origin, &open).unwrap().contacts, grown.contacts);
}

/// Two hollow balls of which a quarter of all pairs of triangles are within a radius: the shallowest contacts
/// are dropped, and memory is bounded. Within half of that all contacts are kept.
#[test]
fn a_growing_workspace_stops_at_its_bounds() {
    let mesh = star(4, |_| 1.0);
    let body = Body::new(mesh.clone(), &singles(&mesh), Kind::Open);
    let mut query = ContactQuery::new(&body.shape, &body.shape);
    let near = Pose::from_translation(DVec3::X * 0.01);
    let most = body.shape.max_tolerance();
    let half = query.run(&near, &Pose::IDENTITY, &QuerySettings::new(0.5 * most)).unwrap();
    assert!(half.dropped == 0 && half.contacts == query.contacts().len(), "{half:?}");
    assert!(half.contacts > 100_000, "{half:?}");
    let whole = query.run(&near, &Pose::IDENTITY, &QuerySettings::new(most)).unwrap();
    assert!(whole.contacts > MAX_CONTACTS && !whole.front_overflow, "{whole:?}");
    assert!(query.contacts().len() <= MAX_CONTACTS && whole.front_high_water <= MAX_PAIRS);
    assert_eq!(query.contacts().len() + whole.dropped, whole.contacts);
    let depths = query.contacts().iter().map(|found| found.contact.depth);
    assert_eq!(depths.reduce(f64::max), whole.deepest, "the deepest is never dropped");
    assert!(query.bytes() < 800_000_000, "{} bytes", query.bytes());
}
