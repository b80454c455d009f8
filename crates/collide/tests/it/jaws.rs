//! The scenarios of the two jaws, and of the spoon in the cup, along their paths, against every pair of
//! triangles.
#![expect(clippy::print_stdout, reason = "tests say what they skip and measure")]

use std::collections::{HashMap, HashSet};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use palpate_clod_build::{BuildOptions, unwatched};
use palpate_collide::{ContactQuery, ContactSet, ContactSetSettings, QuerySettings, Shape};
use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Clod, Pose, TriMesh};

struct Body {
    mesh: TriMesh,
    clod: Clod,
    shape: Shape,
    /// Leaf node of each triangle.
    leaf_of: Vec<u32>,
}

fn load(path: &Path) -> Body {
    let mesh = palpate_mesh_io::load(path, &palpate_mesh_io::LoadOptions::default()).unwrap().mesh;
    let clod = palpate_clod_build::build(&mesh, &BuildOptions::default(), &mut unwatched).unwrap();
    let key = |mut corners: [DVec3; 3]| {
        corners.sort_by(|p, q| p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z)));
        corners.map(|c| c.to_array().map(f64::to_bits))
    };
    let mut leaves = HashMap::new();
    for index in clod.levels[0].nodes.clone() {
        let node = clod.node(index);
        for triangle in clod.patch(&node) {
            leaves.insert(key(triangle.map(|v| clod.hull(&node)[v as usize])), index);
        }
    }
    let leaf_of = (0..mesh.triangles().len()).map(|t| leaves[&key(mesh.corners(t))]).collect();
    Body { mesh, shape: Shape::new(clod.clone()), clod, leaf_of }
}

fn path_of_poses(path: &Path) -> Vec<Pose> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines()
        .skip(1)
        .map(|line| {
            let x: Vec<f64> = line.split(',').map(|x| x.parse().unwrap()).collect();
            Pose::new(DVec3::new(x[1], x[2], x[3]), DQuat::from_xyzw(x[4], x[5], x[6], x[7]).normalize())
        })
        .collect()
}

/// The optional test data. Without it a message is printed and the test is skipped.
fn shared() -> Option<PathBuf> {
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    if !shared.is_dir() {
        // Written to the stream directly, since the test runner captures the output of the print macros.
        let _ = writeln!(std::io::stderr(), "skipped: no ../shared folder with models beside the repository");
        return None;
    }
    Some(shared)
}

/// The lower and the upper jaw.
fn jaws(shared: &Path) -> &'static [Body; 2] {
    static JAWS: OnceLock<[Body; 2]> = OnceLock::new();
    let models = shared.join("models/scenarios");
    JAWS.get_or_init(|| ["jaw_lower.obj", "jaw_upper.obj"].map(|file| load(&models.join(file))))
}

fn run([probe, scene]: &[Body; 2], poses: &[Pose]) {
    let radius = probe.clod.bounding_radius();
    let tolerance = 0.01 * radius;
    let mut query = ContactQuery::new(&probe.shape, &scene.shape);
    let settings = QuerySettings::new(tolerance);
    let mut chosen: Vec<&Pose> = poses.iter().step_by(450).collect();
    let mut disjoint = 0;
    for pose in poses.iter().step_by(5) {
        if disjoint == 4 {
            break;
        }
        let outcome = query.run(pose, &Pose::IDENTITY, &settings).unwrap();
        if outcome.smallest_distance.is_some_and(|d| d > 0.0) {
            disjoint += 1;
            chosen.push(pose);
        }
    }
    assert!(disjoint > 0);
    let scene_triangles = crate::oracle::placed(&scene.mesh, &Pose::IDENTITY);
    for pose in chosen {
        let outcome = query.run(pose, &Pose::IDENTITY, &settings).unwrap();
        assert!(outcome.dropped == 0 && outcome.not_converged == 0, "{outcome:?}");
        let pairs = crate::oracle::pairs_within(
            &crate::oracle::placed(&probe.mesh, pose),
            &scene_triangles,
            tolerance,
        );
        let leaves = |&(i, j, _): &(usize, usize, f64)| (probe.leaf_of[i], scene.leaf_of[j]);
        let meeting: HashSet<(u32, u32)> = pairs.iter().filter(|p| p.2 == 0.0).map(leaves).collect();
        let mut exact = HashMap::<(u32, u32), f64>::new();
        for pair in &pairs {
            let entry = exact.entry(leaves(pair)).or_insert(f64::INFINITY);
            *entry = entry.min(pair.2);
        }
        let mut found = HashMap::<(u32, u32), f64>::new();
        for c in query.contacts() {
            let entry = found.entry((c.probe_node, c.scene_node)).or_insert(f64::INFINITY);
            *entry = entry.min(c.contact.distance());
        }
        let least = pairs.iter().map(|p| p.2).reduce(f64::min);
        println!(
            "{} triangle pairs within d, {} patch pairs, {} of them intersecting; least {least:?}; {outcome:?}",
            pairs.len(),
            exact.len(),
            meeting.len(),
        );
        match (least, outcome.smallest_distance) {
            (Some(x), Some(y)) if meeting.is_empty() => assert!((x - y).abs() <= 1e-9 * radius, "{x} {y}"),
            (Some(_), Some(y)) => assert_eq!(y, 0.0),
            (x, y) => assert_eq!(x, y),
        }
        for pair in &meeting {
            assert_eq!(found.get(pair), Some(&0.0), "patches {pair:?} intersect");
        }
        // If hulls overlap and the triangles do not meet, the solids overlap, and no distance is reported.
        for (pair, distance) in found.iter().filter(|(_, d)| **d > 0.0) {
            let plain = exact.get(pair).copied().unwrap_or(f64::INFINITY);
            assert!((plain - distance).abs() <= 1e-9 * radius, "{pair:?}: {plain} {distance}");
        }
    }
}

#[test]
fn jaws_along_their_path() {
    let Some(shared) = shared() else { return };
    run(jaws(&shared), &path_of_poses(&shared.join("trajectories/jaws.csv")));
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-collide --test it -- --ignored"]
fn spoon_in_the_cup_of_full_size() {
    let Some(shared) = shared() else { return };
    let bodies = ["spoon.obj", "cup.obj"].map(|file| load(&shared.join("models/scenarios").join(file)));
    run(&bodies, &path_of_poses(&shared.join("trajectories/spooncup.csv")));
}

/// Regions of intersection of the jaws: no vertex of either jaw near them is deeper than the deepest
/// region, and one is as deep unless the region's depth is that of two patches.
#[test]
fn jaws_are_as_deep_as_their_vertices() {
    let Some(shared) = shared() else { return };
    let bodies = jaws(&shared);
    let poses = path_of_poses(&shared.join("trajectories/jaws.csv"));
    let radius = bodies[0].clod.bounding_radius();
    let settings = QuerySettings::new(0.01 * radius);
    let mut query = ContactQuery::new(&bodies[0].shape, &bodies[1].shape);
    let mut set = ContactSet::new(&bodies[0].shape, &bodies[1].shape);
    let (mut compared, mut exact) = (0, 0);
    for pose in poses.iter().step_by(97) {
        query.run(pose, &Pose::IDENTITY, &settings).unwrap();
        let found = set
            .run(query.contacts(), pose, &Pose::IDENTITY, &ContactSetSettings::new(0.01 * radius))
            .unwrap();
        let Some(deepest) = found.first().copied().filter(|c| c.contact.depth > 0.0) else { continue };
        let placed = [pose, &Pose::IDENTITY];
        let placed: [_; 2] =
            std::array::from_fn(|side| crate::oracle::placed(&bodies[side].mesh, placed[side]));
        let near: Vec<DVec3> =
            query.contacts().iter().filter(|c| c.contact.depth > 0.0).map(|c| c.contact.point).collect();
        let mut plain: f64 = 0.0;
        for side in 0..2 {
            let mut points: Vec<DVec3> = placed[side].iter().flatten().copied().collect();
            points.retain(|p| near.iter().any(|q| p.distance(*q) < 0.01 * radius));
            points.sort_unstable_by(|p, q| p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)));
            points.dedup();
            // The inside test is made only for vertices that would be deeper.
            for point in points {
                let to =
                    |t: &crate::oracle::Triangle| crate::oracle::point_triangle(point, *t).distance(point);
                let depth = placed[1 - side].iter().map(to).fold(f64::INFINITY, f64::min);
                if depth > plain && crate::oracle::is_inside(point, &placed[1 - side]) {
                    plain = depth;
                }
            }
        }
        let depth = deepest.contact.depth;
        println!("{} regions; vertices {plain}, deepest {depth}", set.outcome().regions);
        assert!(plain <= depth + 1e-9 * radius, "a vertex is {plain} m deep, the deepest region {depth}");
        compared += 1;
        let by_vertex = (plain - depth).abs() < 1e-9 * radius;
        let by_patches = query.contacts().iter().any(|c| c.contact == deepest.contact);
        assert!(by_vertex || by_patches, "vertices {plain}, found {depth}");
        exact += usize::from(by_vertex);
    }
    assert!(compared > 4 && exact > 1, "{exact} of {compared}");
}
