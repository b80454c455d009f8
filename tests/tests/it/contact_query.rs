//! Full-resolution contact queries, on real meshes against brute force over all pairs of triangles, and on
//! built-in ones against hierarchies without levels of detail.

use std::collections::{BTreeMap, HashSet};
use std::sync::OnceLock;

use palpate::clod_build::{BuildOptions, build, unwatched};
use palpate::collide::{ContactQuery, PatchContact, QuerySettings, Shape};
use palpate::core::Clod;
use palpate::glam::{DQuat, DVec3};
use palpate::mesh_io::intersecting_pairs;
use palpate::models::Model;
use palpate::{Pose, TriMesh};
use palpate_tests::brute_force::{self, nearest_on_triangle, triangle_distance};
use palpate_tests::{leaf_of_triangle, shared_mesh};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

struct Body {
    mesh: TriMesh,
    clod: Clod,
    shape: Shape,
    radius: f64,
}

impl Body {
    fn load(path: &str) -> Option<Self> {
        let mesh = shared_mesh(path)?;
        // At full resolution; `levels_of_detail_lose_no_contact` covers the other levels.
        let options = BuildOptions { simplify: false, ..BuildOptions::default() };
        let clod = build(&mesh, &options, &mut unwatched).expect(path);
        let radius = clod.bounding_radius();
        Some(Self { mesh, shape: Shape::new(clod.clone()), clod, radius })
    }

    fn patch(&self, node: u32, pose: &Pose) -> Vec<[DVec3; 3]> {
        let node = self.clod.node(node);
        let hull = self.clod.hull(&node);
        let corner = |local: u32| pose.transform_point(hull[local as usize]);
        self.clod.patch(node).iter().map(|triangle| triangle.map(corner)).collect()
    }
}

/// Checks poses of the probe, some where the bodies are disjoint and near, and some where they intersect.
/// `tolerance` is d relative to the probe's radius.
fn check(probe_path: &str, scene_path: &str, tolerance: f64, poses: &[Pose]) {
    let (Some(probe), Some(scene)) = (Body::load(probe_path), Body::load(scene_path)) else { return };
    check_bodies(&probe, &scene, tolerance, poses);
}

fn check_bodies(probe: &Body, scene: &Body, tolerance: f64, poses: &[Pose]) {
    let tolerance = tolerance * probe.radius;
    let eps = 1e-6 * probe.radius;
    let settings = QuerySettings::new(tolerance);
    let mut query = ContactQuery::new(&probe.shape, &scene.shape);
    let probe_leaf = leaf_of_triangle(&probe.clod, &probe.mesh);
    let scene_leaf = leaf_of_triangle(&scene.clod, &scene.mesh);
    let (mut disjoint, mut intersecting) = (0, 0);
    for (index, pose) in poses.iter().enumerate() {
        let outcome = query.run(pose, &Pose::IDENTITY, &settings).unwrap();
        assert!(outcome.dropped == 0 && outcome.not_converged == 0, "pose {index}: {outcome:?}");
        for found in query.contacts() {
            let contact = &found.contact;
            assert!((contact.normal.length() - 1.0).abs() < 1e-9, "pose {index}: {contact:?}");
            assert!(contact.depth >= -tolerance - eps, "pose {index}: {contact:?}");
        }
        let crossing = intersecting_pairs(&probe.mesh, pose, &scene.mesh, &Pose::IDENTITY, usize::MAX);
        if crossing.is_empty() {
            disjoint += 1;
            check_disjoint(index, pose, probe, scene, &query, outcome.smallest_distance, tolerance, eps);
        } else {
            intersecting += 1;
            let found: HashSet<(u32, u32)> =
                query.contacts().iter().map(|found| (found.probe_node, found.scene_node)).collect();
            for &[a, b] in &crossing {
                let pair = (probe_leaf[a as usize], scene_leaf[b as usize]);
                assert!(
                    found.contains(&pair),
                    "pose {index}: triangles {a} and {b} intersect without a contact"
                );
            }
        }
    }
    assert!(disjoint >= 3 && intersecting >= 2, "{disjoint} disjoint and {intersecting} intersecting poses");
}

#[allow(clippy::too_many_arguments)] // Local to this test.
fn check_disjoint(
    index: usize,
    pose: &Pose,
    probe: &Body,
    scene: &Body,
    query: &ContactQuery,
    smallest: Option<f64>,
    tolerance: f64,
    eps: f64,
) {
    let truth = brute_force::distance(&probe.mesh, pose, &scene.mesh, &Pose::IDENTITY, tolerance);
    match (truth, smallest) {
        (None, None) => {}
        (Some(truth), Some(found)) => {
            assert!((truth - found).abs() < eps, "pose {index}: distance {found}, brute force {truth}");
        }
        // At exactly the tolerance either answer is right.
        (Some(d), None) | (None, Some(d)) => assert!((d - tolerance).abs() < eps, "pose {index}: {d}"),
    }
    for found in query.contacts() {
        let contact = &found.contact;
        assert!(contact.depth <= 0.0, "pose {index}: depth {} of disjoint bodies", contact.depth);
        let patches = [probe.patch(found.probe_node, pose), scene.patch(found.scene_node, &Pose::IDENTITY)];
        let mut exact = f64::INFINITY;
        for a in &patches[0] {
            for b in &patches[1] {
                exact = exact.min(triangle_distance(a, b).0);
            }
        }
        // A pair of patches may have several local minima, so these need not be its nearest points.
        assert!(-contact.depth > exact - eps, "pose {index}: {contact:?}, brute force {exact}");
        for (point, patch) in [(contact.point, &patches[0]), (contact.scene_point, &patches[1])] {
            let off =
                patch.iter().map(|t| nearest_on_triangle(point, t).distance(point)).fold(f64::MAX, f64::min);
            assert!(off < eps, "pose {index}: a contact point is {off} m off its patch");
        }
        let gap = contact.point + contact.normal * -contact.depth - contact.scene_point;
        assert!(gap.length() < eps, "pose {index}: {contact:?}");
    }
}

#[test]
fn dental_casts_agree_with_brute_force() {
    // Stored in a common occlusal frame, not intersecting; the upper cast is lifted and pressed along z.
    let poses: Vec<Pose> = [0.0, -2e-3, -2.5e-3, -3e-3, -4e-3, -5e-3, -6e-3, -8e-3]
        .into_iter()
        .enumerate()
        .map(|(i, lift)| {
            let turn = DQuat::from_scaled_axis(DVec3::new(0.002, -0.001, 0.003) * i as f64);
            Pose::new(DVec3::new(1e-4 * i as f64, 0.0, lift), turn)
        })
        .collect();
    check("models/good/dental_cast_upper.obj", "models/good/dental_cast_lower.obj", 0.05, &poses);
}

#[test]
fn spoon_on_mug_agrees_with_brute_force() {
    // The mug stands with its rim at z = 81 mm; the spoon lies across it and is lowered.
    let poses: Vec<Pose> = [0.086, 0.083, 0.080, 0.078, 0.076, 0.074, 0.072, 0.070, 0.066]
        .into_iter()
        .enumerate()
        .map(|(i, height)| {
            let turn = DQuat::from_scaled_axis(DVec3::new(0.01, 0.02, 0.3) * i as f64);
            Pose::new(DVec3::new(2e-3 * i as f64, 0.0, height), turn)
        })
        .collect();
    check("models/good/ycb_spoon.obj", "models/good/ycb_mug.obj", 0.05, &poses);
}

/// Lifts of the peg, which stands on the floor of the hole face on face, and turns about its axis.
const PEG: [(f64, f64); 9] = [
    (1e-4, 0.2),
    (1e-6, 0.1),
    (1e-9, 0.0),
    (0.0, 0.0),
    (-1e-9, 0.3),
    (-1e-6, 0.0),
    (-2e-5, 0.2),
    (-5e-4, 0.1),
    (-1e-3, 0.0),
];

fn peg_and_hole() -> Option<&'static [Body; 2]> {
    static BODIES: OnceLock<Option<[Body; 2]>> = OnceLock::new();
    let load = || Some([Body::load("models/good/peg_8mm.obj")?, Body::load("models/good/hole_8mm.obj")?]);
    BODIES.get_or_init(load).as_ref()
}

fn standing((lift, turn): (f64, f64)) -> Pose {
    Pose::new(DVec3::Z * lift, DQuat::from_rotation_z(turn))
}

#[test]
fn peg_on_the_floor_of_its_hole_agrees_with_brute_force() {
    let Some([peg, hole]) = peg_and_hole() else { return };
    check_bodies(peg, hole, 0.005, &[0, 1, 2, 4, 7].map(|index| standing(PEG[index])));
}

#[test]
fn a_peg_in_the_floor_is_as_deep_as_it_was_pressed() {
    let Some([peg, hole]) = peg_and_hole() else { return };
    let mut query = ContactQuery::new(&peg.shape, &hole.shape);
    let settings = QuerySettings::new(1e-3 * peg.radius);
    for (lift, turn) in PEG.into_iter().filter(|(lift, _)| *lift <= 0.0) {
        let pose = standing((lift, turn));
        let outcome = query.run(&pose, &Pose::IDENTITY, &settings).unwrap();
        let deepest = outcome.deepest.expect("they touch");
        // A translation by this depth along z separates them, so no two pieces of theirs are deeper.
        assert!((deepest + lift).abs() < 1e-9 * peg.radius, "pressed {} m, found {deepest} m", -lift);
        let down = |c: &&PatchContact| c.contact.depth >= 0.999 * deepest && c.contact.normal.z < -0.999;
        assert!(query.contacts().iter().any(|c| down(&c)), "pressed {} m: nothing pushes up", -lift);
    }
}

/// Returns the depths of the contacts of each pair of patches, in ascending order.
fn depths_by_patches(
    bodies: &[Body; 2],
    pose: &Pose,
    query: &mut ContactQuery,
    tolerance: f64,
) -> BTreeMap<[[[u64; 3]; 3]; 2], Vec<f64>> {
    let [probe, scene] = bodies;
    let settings = QuerySettings::new(tolerance);
    let outcome = query.run(pose, &Pose::IDENTITY, &settings).unwrap();
    assert!(outcome.dropped == 0 && outcome.not_converged == 0, "{outcome:?}");
    // The patches of the full mesh are the same in another order, and are identified by their first triangle.
    let name = |body: &Body, node: u32| {
        let triangles = body.patch(node, &Pose::IDENTITY).into_iter();
        triangles.map(|corners| corners.map(|p| p.to_array().map(f64::to_bits))).min().expect("a triangle")
    };
    let mut found: BTreeMap<_, Vec<f64>> = BTreeMap::new();
    for PatchContact { contact, probe_node, scene_node, .. } in query.contacts() {
        let patches = [name(probe, *probe_node), name(scene, *scene_node)];
        found.entry(patches).or_default().push(contact.depth);
    }
    found.values_mut().for_each(|depths| depths.sort_unstable_by(f64::total_cmp));
    found
}

/// The levels above the leaves only decide which leaves are visited; no contact may be lost.
#[test]
fn levels_of_detail_lose_no_contact() {
    const SEED: u64 = 0x10_5e;
    let mut random = StdRng::seed_from_u64(SEED);
    let usual = BuildOptions::default();
    let choices = [
        BuildOptions { simplify: false, ..usual.clone() },
        usual.clone(),
        BuildOptions { bounding_points: 0, ..usual.clone() },
        BuildOptions { carried: false, ..usual },
    ];
    for models in [[Model::UpperJaw, Model::LowerJaw], [Model::Torus, Model::Cup]] {
        let meshes = models.map(|model| model.generate(3000).expect("in range"));
        let built = choices.clone().map(|options| {
            meshes.clone().map(|mesh| {
                let clod = build(&mesh, &options, &mut unwatched).expect("a model builds");
                let radius = clod.bounding_radius();
                Body { mesh, shape: Shape::new(clod.clone()), clod, radius }
            })
        });
        let regular = |body: &Body| body.clod.levels.iter().filter(|level| !level.free).count();
        assert!(built[0].iter().all(|b| regular(b) == 1) && built[1].iter().all(|b| regular(b) > 2));
        let mut queries: Vec<_> =
            built.iter().map(|[probe, scene]| ContactQuery::new(&probe.shape, &scene.shape)).collect();
        let [probe, scene] = &built[0];
        let tolerance = 0.03 * probe.radius;
        let eps = 1e-8 * probe.radius;
        let (mut contacts, mut poses) = (0, 0);
        for pose in 0..30 {
            let mut vector = || DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0)));
            let (turn, direction) = (DQuat::from_scaled_axis(3.0 * vector()), vector().normalize());
            let middle = scene.clod.source.center
                + direction * random.random_range(0.2..1.1) * (probe.radius + scene.radius);
            let pose_of_probe = Pose::new(middle - turn * probe.clod.source.center, turn);
            let place = format!("{models:?}, seed {SEED:#x}, pose {pose}");
            // Rounding decides whether a contact at exactly the tolerance is found.
            let mut found = built.iter().zip(&mut queries).map(|(bodies, query)| {
                let mut found = depths_by_patches(bodies, &pose_of_probe, query, tolerance);
                found.retain(|_, depths| {
                    depths.retain(|depth| *depth > eps - tolerance);
                    !depths.is_empty()
                });
                found
            });
            let plain = found.next().expect("the plain hierarchy");
            contacts += plain.len();
            poses += usize::from(!plain.is_empty());
            for other in found {
                assert!(plain.keys().eq(other.keys()), "{place}: {} and {}", plain.len(), other.len());
                for (a, b) in plain.values().zip(other.values()) {
                    let same = a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < eps);
                    assert!(same, "{place}: {a:?} and {b:?}");
                }
            }
        }
        assert!(
            contacts > 250 && (5..30).contains(&poses),
            "{models:?}: {contacts} contacts in {poses} poses"
        );
    }
}
