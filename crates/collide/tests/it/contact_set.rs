//! The contact set: known answers, and definitions by brute force over all triangles and vertices.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use crate::oracle::{Triangle, is_inside, normal, to_surface};
use crate::solids::{Body, Kind, clusters, hierarchy, pose, rotation, singles, star, torus, vector};
use allocation_counter::measure;
use palpate_clod_build::{BuildOptions, unwatched};
use palpate_collide::{
    ContactQuery, ContactSet, ContactSetError, ContactSetOutcome, ContactSetSettings, PatchContact,
    QueryObject, QuerySettings, Shape,
};
use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Pose, TriMesh};
use rand::{RngExt, SeedableRng, rngs::StdRng};

const SEED: u64 = 0x5E75_0FC0;

/// A query with the contact set of its contacts.
struct Pipeline {
    query: ContactQuery,
    set: ContactSet,
    /// Size of the bodies, m.
    size: f64,
}

impl Pipeline {
    fn new(probe: &Shape, scene: &Shape) -> Self {
        Self { query: ContactQuery::new(probe, scene), set: ContactSet::new(probe, scene), size: 1.0 }
    }

    fn run(
        &mut self,
        poses: [&Pose; 2],
        tolerance: f64,
        settings: &ContactSetSettings,
    ) -> (Vec<PatchContact>, ContactSetOutcome) {
        self.query.run(poses[0], poses[1], &QuerySettings::new(tolerance)).unwrap();
        let found = self.set.run(self.query.contacts(), poses[0], poses[1], settings).unwrap().to_vec();
        let outcome = *self.set.outcome();
        assert!(!outcome.truncated, "{outcome:?}");
        assert_eq!(outcome.penetrating + outcome.separated, found.len());
        assert!(found.is_sorted_by(|x, y| x.contact.depth >= y.contact.depth || x.contact.depth >= 0.0));
        for PatchContact { contact, .. } in &found {
            assert!((contact.normal.length() - 1.0).abs() < 1e-9, "{contact:?}");
            let offset = contact.point - contact.depth * contact.normal - contact.scene_point;
            assert!(offset.length() <= 1e-9 * self.size, "Eq. 5.36, {contact:?}");
        }
        (found, outcome)
    }
}

fn whole(mesh: &TriMesh) -> Vec<Vec<u32>> {
    vec![(0..mesh.triangles().len() as u32).collect()]
}

fn shape(mesh: &TriMesh, patches: &[Vec<u32>], kind: Kind) -> Shape {
    Shape::new(hierarchy(mesh, patches, kind).0)
}

fn scaled(mesh: &TriMesh, scale: f64) -> TriMesh {
    TriMesh::new(mesh.vertices().iter().map(|v| *v * scale).collect(), mesh.triangles().to_vec()).unwrap()
}

fn box_mesh(half: DVec3) -> TriMesh {
    let corner =
        |i: u32| half * DVec3::from_array([0, 1, 2].map(|k| if i >> k & 1 == 1 { 1.0 } else { -1.0 }));
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    TriMesh::new((0..8).map(corner).collect(), triangles).unwrap()
}

/// A closed profile (radius, height) turned about z, counterclockwise seen with z up and the radius to the
/// right.
fn turned(profile: &[(f64, f64)], around: u32) -> TriMesh {
    let count = profile.len() as u32;
    let at = |i: u32, j: u32| (i % around) * count + j % count;
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for i in 0..around {
        let (sine, cosine) = (f64::from(i) / f64::from(around) * TAU).sin_cos();
        vertices.extend(profile.iter().map(|(r, z)| DVec3::new(r * cosine, r * sine, *z)));
        for j in 0..count {
            triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    TriMesh::new(vertices, triangles).unwrap()
}

const SEVERAL: ContactSetSettings = ContactSetSettings { merge: 1e-6, spacing: 0.3, max_vertices: 1 << 16 };

#[test]
fn a_ball_pressed_into_a_block_is_one_contact() {
    let mut rng = StdRng::seed_from_u64(SEED);
    let (ball, block) = (star(4, |_| 1.0), box_mesh(DVec3::new(4.0, 4.0, 2.0)));
    // Half the square of the longest edge's angle: how far the facets are inside the sphere.
    let facets = 0.01;
    for (size, scale) in [(1, 1.0), (6, 1e-3), (40, 1e3), (5_000, 1.0)] {
        let (ball, block) = (scaled(&ball, scale), scaled(&block, scale));
        let probe = shape(&ball, &clusters(&ball, size), Kind::Contained);
        let scene = shape(&block, &singles(&block), Kind::Contained);
        let mut pipeline = Pipeline { size: scale, ..Pipeline::new(&probe, &scene) };
        for press in [0.001, 0.05, 0.3] {
            // The scene is placed anywhere; the ball's pole, a vertex, comes down on the block first.
            let place = vector(&mut rng) * 3.0 * scale;
            let scene_pose = pose(&mut rng, place);
            for turn in [DQuat::IDENTITY, rotation(&mut rng)] {
                let above = DVec3::new(0.3, 0.2, 3.0 - press) * scale;
                let probe_pose = scene_pose * Pose::new(above, turn);
                let settings = ContactSetSettings::new(0.05 * scale);
                let (found, outcome) = pipeline.run([&probe_pose, &scene_pose], 0.01 * scale, &settings);
                let context = format!("patches of {size}, scale {scale}, press {press}, {outcome:?}");
                if turn != DQuat::IDENTITY && press < facets {
                    continue;
                }
                assert_eq!((outcome.regions, found.len()), (1, 1), "{context}");
                let Some(PatchContact { contact, .. }) = found.first() else { panic!("{context}") };
                let short = if turn == DQuat::IDENTITY { 1e-9 } else { facets };
                let depth = contact.depth / scale;
                assert!(depth <= press + 1e-9 && depth >= press - short, "{context}: {contact:?}");
                let down = scene_pose.transform_vector(-DVec3::Z);
                assert!(contact.normal.dot(down) > 1.0 - 1e-9, "{context}: {contact:?}");
                let bottom = scene_pose.transform_point(above - DVec3::Z * scale);
                assert!(contact.point.distance(bottom) < 0.15 * scale, "{context}: {contact:?}");
            }
        }
    }
}

#[test]
fn two_bumps_are_two_contacts() {
    let at = [1.0, -1.0].map(|side: f64| DVec3::new(side * 0.4_f64.sin(), 0.0, -(0.4_f64.cos())));
    let heights = [0.2, 0.19];
    let bump = |v: DVec3, i: usize| heights[i] * (-40.0 * v.distance_squared(at[i])).exp();
    let mesh = star(5, |v| 1.0 + bump(v, 0) + bump(v, 1));
    let block = box_mesh(DVec3::new(3.0, 3.0, 1.0));
    let lowest = |side: f64| {
        let of_side = mesh.vertices().iter().filter(|v| v.x * side > 0.0);
        of_side.map(|v| v.z).fold(f64::INFINITY, f64::min)
    };
    let probe = shape(&mesh, &clusters(&mesh, 3), Kind::Loose);
    let scene = shape(&block, &singles(&block), Kind::Contained);
    let mut pipeline = Pipeline::new(&probe, &scene);
    for press in [0.02, 0.05] {
        let height = 1.0 - lowest(1.0).min(lowest(-1.0)) - press;
        let up = Pose::from_translation(DVec3::new(0.1, 0.05, height));
        let (found, outcome) = pipeline.run([&up, &Pose::IDENTITY], 0.005, &ContactSetSettings::new(0.05));
        assert_eq!((outcome.regions, outcome.by_vertices, found.len()), (2, 2, 2), "{outcome:?}");
        let mut depths = [1.0, -1.0].map(|side| 1.0 - (height + lowest(side)));
        depths.sort_unstable_by(|x, y| y.total_cmp(x));
        for (one, depth) in found.iter().zip(depths) {
            assert!((one.contact.depth - depth).abs() < 1e-12, "{found:?} {depths:?}");
        }
        let apart = found[0].contact.point.distance(found[1].contact.point);
        assert!((0.7..1.2).contains(&apart), "{apart}");
    }
}

/// A peg in a hole that is too tight by 0.02 all around.
#[test]
fn a_peg_in_a_tight_hole_is_pushed_from_all_sides() {
    let hole = turned(&[(1.0, -0.5), (2.0, -0.5), (2.0, 0.5), (1.0, 0.5), (1.0, 0.0)], 48);
    let heights: Vec<f64> = (0..=20).map(|i| f64::from(i) * 0.1 - 1.0).collect();
    let profile: Vec<(f64, f64)> =
        heights.iter().map(|z| (1.02, *z)).chain([(0.1, 1.0), (0.1, -1.0)]).collect();
    let peg = turned(&profile, 48);
    let probe = shape(&peg, &singles(&peg), Kind::Contained);
    let scene = shape(&hole, &singles(&hole), Kind::Contained);
    let mut pipeline = Pipeline::new(&probe, &scene);
    let turn = Pose::new(DVec3::new(0.0, 0.0, 0.03), DQuat::from_rotation_z(PI / 48.0));
    let (one, outcome) = pipeline.run([&turn, &Pose::IDENTITY], 1e-3, &ContactSetSettings::new(0.1));
    assert_eq!((outcome.regions, one.len(), outcome.by_vertices), (1, 1, 1), "{outcome:?}");
    let flat = 1.02 - (PI / 48.0).cos();
    assert!((one[0].contact.depth - flat).abs() < 1e-9, "{flat}: {:?}", one[0]);

    let (several, outcome) = pipeline.run([&turn, &Pose::IDENTITY], 1e-3, &SEVERAL);
    assert_eq!(outcome.regions, 1);
    assert!((12..60).contains(&several.len()), "{}", several.len());
    let mut angles: Vec<f64> = several.iter().map(|c| c.contact.point.y.atan2(c.contact.point.x)).collect();
    angles.sort_unstable_by(f64::total_cmp);
    angles.push(angles[0] + TAU);
    assert!(angles.windows(2).all(|two| two[1] - two[0] < 1.0), "{angles:?}");
    for (i, one) in several.iter().enumerate() {
        let outward = DVec3::new(one.contact.point.x, one.contact.point.y, 0.0).normalize();
        assert!(one.contact.normal.dot(outward) > 0.99, "{one:?}");
        assert!(several[..i].iter().all(|c| c.contact.point.distance(one.contact.point) > 0.3));
    }
}

#[test]
fn a_corner_pressed_into_a_box_is_as_deep_as_pressed() {
    let mesh = box_mesh(DVec3::ONE);
    // Stands on its corner.
    let turn = DQuat::from_rotation_arc(DVec3::ONE.normalize(), -DVec3::Z);
    for patches in [singles(&mesh), clusters(&mesh, 2), whole(&mesh)] {
        let body = shape(&mesh, &patches, Kind::Contained);
        let mut pipeline = Pipeline::new(&body, &body);
        for press in [1e-6, 0.01, 0.1, 0.3] {
            let up = Pose::new(DVec3::new(0.2, 0.1, 1.0 + 3f64.sqrt() - press), turn);
            let (found, outcome) = pipeline.run([&up, &Pose::IDENTITY], 0.01, &ContactSetSettings::new(0.05));
            assert_eq!((outcome.regions, found.len()), (1, 1), "{outcome:?}, {press}, {found:?}");
            let contact = found[0].contact;
            assert!((contact.depth - press).abs() < 1e-9, "{press}: {contact:?}");
            assert!(contact.normal.distance(-DVec3::Z) < 1e-6, "{press}: {contact:?}");
            assert!(contact.point.distance(DVec3::new(0.2, 0.1, 1.0 - press)) < 1e-9, "{contact:?}");
        }
    }
}

/// Two crossing bars: no vertex is inside, and the depth is that of the pair of edges.
#[test]
fn crossing_edges_keep_the_depth_of_their_patches() {
    let bar = box_mesh(DVec3::new(3.0, 0.5, 0.5));
    let body = shape(&bar, &singles(&bar), Kind::Contained);
    let mut pipeline = Pipeline::new(&body, &body);
    let edge_down = DQuat::from_rotation_x(PI / 4.0);
    let across = DQuat::from_rotation_z(PI / 2.0);
    for press in [1e-3, 0.1] {
        let up = Pose::new(DVec3::new(0.0, 0.0, 2.0 * 0.5 * 2f64.sqrt() - press), across * edge_down);
        let scene = Pose::new(DVec3::ZERO, edge_down);
        let (found, outcome) = pipeline.run([&up, &scene], 1e-4, &ContactSetSettings::new(0.05));
        assert_eq!((outcome.regions, outcome.inside, found.len()), (1, 0, 1), "{outcome:?}");
        assert!((found[0].contact.depth - press).abs() < 1e-9, "{press}: {found:?}");
    }
}

#[test]
fn separated_convex_bodies_have_one_contact() {
    let mut rng = StdRng::seed_from_u64(SEED + 1);
    let ball = star(4, |v| 1.0 / (v / DVec3::new(1.0, 0.8, 0.7)).length());
    for size in [1, 6, 50] {
        let body = shape(&ball, &clusters(&ball, size), Kind::Contained);
        let mut pipeline = Pipeline::new(&body, &body);
        let mut single = 0;
        for round in 0..60 {
            let probe_pose = pose(&mut rng, DVec3::ZERO);
            let along = rng.random_range(1.5..2.2);
            let direction = vector(&mut rng).normalize();
            let scene_pose = pose(&mut rng, direction * along);
            let (found, outcome) =
                pipeline.run([&probe_pose, &scene_pose], 0.2, &ContactSetSettings::new(0.0));
            if outcome.regions == 0 && !found.is_empty() {
                // The distance of disjoint convex bodies has one local minimum.
                assert_eq!(found.len(), 1, "seed {:#x}, round {round}: {found:#?}", SEED + 1);
                single += 1;
            }
        }
        assert!(single > 10, "{single}");
    }
}

/// Pairs of triangles that no pair of triangles at their nearest points undercuts, and that face each other
/// there: the points, and the distance.
fn local_minima(
    [a, b]: [&Body; 2],
    [ta, tb]: [&[Triangle]; 2],
    pairs: &[(usize, usize, f64)],
) -> Vec<(usize, usize, DVec3, DVec3, f64)> {
    let eps = 1e-9;
    let mut minima = Vec::new();
    for &(i, j, distance) in pairs.iter().filter(|pair| pair.2 > 0.0) {
        let (x, y) = crate::oracle::nearest(ta[i], tb[j]);
        let on =
            |t: &[Triangle], k: usize, p: DVec3| crate::oracle::point_triangle(p, t[k]).distance(p) < eps;
        let at_x: Vec<usize> = a.neighbours(i).into_iter().filter(|k| on(ta, *k, x)).collect();
        let at_y: Vec<usize> = b.neighbours(j).into_iter().filter(|k| on(tb, *k, y)).collect();
        let undercut = at_x
            .iter()
            .any(|k| at_y.iter().any(|l| crate::oracle::distance(ta[*k], tb[*l]) < distance - eps));
        let direction = (y - x) / distance;
        let faces = |t: &[Triangle], at: &[usize], n: DVec3| at.iter().any(|k| normal(t[*k]).dot(n) > 1e-6);
        if !undercut && faces(ta, &at_x, direction) && faces(tb, &at_y, -direction) {
            minima.push((i, j, x, y, distance));
        }
    }
    minima
}

/// Disjoint sets without path compression.
struct Partition(Vec<usize>);

impl Partition {
    fn root(&self, mut i: usize) -> usize {
        while self.0[i] != i {
            i = self.0[i];
        }
        i
    }

    fn join(&mut self, i: usize, j: usize) {
        let (i, j) = (self.root(i), self.root(j));
        self.0[i.max(j)] = i.min(j);
    }
}

/// Regions by their definition: pairs of intersecting triangles that share vertices on both sides, and
/// vertices inside, joined along edges up to the first triangle that they pass through. Per region: the
/// largest distance of its vertices (0 without any), and its pairs.
fn regions(
    bodies: [&Body; 2],
    placed: [&[Triangle]; 2],
    pairs: &[(usize, usize, f64)],
) -> Vec<(f64, Vec<(usize, usize)>)> {
    let crossing: Vec<(usize, usize)> = pairs.iter().filter(|p| p.2 == 0.0).map(|p| (p.0, p.1)).collect();
    let index: HashMap<(usize, usize), usize> = crossing.iter().copied().zip(0..).collect();
    let mut inside = HashMap::new();
    let mut depths = Vec::new();
    for side in 0..2 {
        for v in 0..bodies[side].mesh.vertices().len() {
            let t = bodies[side].around[v][0];
            let corner = bodies[side].mesh.triangles()[t].iter().position(|w| *w as usize == v).unwrap();
            let point = placed[side][t][corner];
            if is_inside(point, placed[1 - side]) {
                inside.insert((side, v), crossing.len() + depths.len());
                depths.push(to_surface(point, placed[1 - side]));
            }
        }
    }
    let mut parts = Partition((0..crossing.len() + depths.len()).collect());
    for (n, &(i, j)) in crossing.iter().enumerate() {
        for k in bodies[0].neighbours(i) {
            for l in bodies[1].neighbours(j) {
                if let Some(m) = index.get(&(k, l)) {
                    parts.join(n, *m);
                }
            }
        }
    }
    for side in 0..2 {
        for (t, corners) in bodies[side].mesh.triangles().iter().enumerate() {
            for k in 0..6 {
                let (from, to) = if k < 3 { (k, (k + 1) % 3) } else { ((k + 1) % 3, k - 3) };
                let Some(&v) = inside.get(&(side, corners[from] as usize)) else { continue };
                let edge = [placed[side][t][from], placed[side][t][to]];
                let crossed = |u: usize| {
                    let [a, b, c] = placed[1 - side][u];
                    let n = (b - a).cross(c - a);
                    n.dot(a - edge[0]) / n.dot(edge[1] - edge[0])
                };
                let first = (0..placed[1 - side].len())
                    .filter(|u| crate::oracle::segment_crosses(edge, placed[1 - side][*u]))
                    .min_by(|x, y| crossed(*x).total_cmp(&crossed(*y)));
                match first {
                    Some(u) => parts.join(v, index[&if side == 0 { (t, u) } else { (u, t) }]),
                    None => parts.join(v, inside[&(side, corners[to] as usize)]),
                }
            }
        }
    }
    let mut found = HashMap::<usize, (f64, Vec<(usize, usize)>)>::new();
    for (n, &pair) in crossing.iter().enumerate() {
        found.entry(parts.root(n)).or_default().1.push(pair);
    }
    for (n, &depth) in (crossing.len()..).zip(&depths) {
        let best = &mut found.entry(parts.root(n)).or_default().0;
        *best = best.max(depth);
    }
    found.into_values().collect()
}

#[derive(Debug, Default)]
struct Tally {
    minima: usize,
    regions: usize,
    several: usize,
    by_vertices: usize,
    by_patches: usize,
}

/// The contact set against the definitions.
fn check(bodies: [&Body; 2], poses: [&Pose; 2], pipeline: &mut Pipeline, tally: &mut Tally, context: &str) {
    let tolerance = 0.25;
    let (found, outcome) = pipeline.run(poses, tolerance, &ContactSetSettings::new(0.0));
    let placed: [Vec<Triangle>; 2] =
        [0, 1].map(|side| crate::oracle::placed(&bodies[side].mesh, poses[side]));
    let placed = [&*placed[0], &*placed[1]];
    let pairs = crate::oracle::pairs_within(placed[0], placed[1], tolerance);
    let sunk: HashMap<(u32, u32), f64> = pipeline
        .query
        .contacts()
        .iter()
        .filter(|c| c.contact.depth >= 0.0)
        .map(|c| ((c.probe_node, c.scene_node), c.contact.depth))
        .collect();
    let leaves = |i: usize, j: usize| (bodies[0].leaf_of[i], bodies[1].leaf_of[j]);

    let minima = local_minima(bodies, placed, &pairs);
    let separated = &found[outcome.penetrating..];
    for &(i, j, x, y, distance) in &minima {
        // Parallel features have many pairs of nearest points, of which the patches report one.
        let is = |c: &&PatchContact| {
            (c.contact.distance() - distance).abs() < 1e-9
                && (c.contact.point.distance(x) + c.contact.scene_point.distance(y) < 1e-6
                    || (c.probe_node, c.scene_node) == leaves(i, j))
        };
        let missed = !sunk.contains_key(&leaves(i, j)) && !separated.iter().any(|c| is(&c));
        assert!(!missed, "{context}: local minimum {distance} at {x} {y}");
    }
    for c in separated {
        let of_contact = |m: &&(usize, usize, DVec3, DVec3, f64)| {
            (m.4 - c.contact.distance()).abs() < 1e-8
                && m.2.distance(c.contact.point) + m.3.distance(c.contact.scene_point) < 1e-6
        };
        assert!(minima.iter().any(|m| of_contact(&m)), "{context}: no local minimum, {c:?}");
    }
    tally.minima += separated.len();

    let expected = regions(bodies, placed, &pairs);
    assert_eq!(outcome.regions, expected.len(), "{context}: {expected:?}");
    let mut depths: Vec<f64> = expected
        .iter()
        .map(|(depth, pairs)| {
            let of_pairs = pairs.iter().map(|(i, j)| sunk[&leaves(*i, *j)]).fold(0.0, f64::max);
            tally.by_vertices += usize::from(*depth >= of_pairs);
            tally.by_patches += usize::from(*depth < of_pairs);
            depth.max(of_pairs)
        })
        .collect();
    depths.sort_unstable_by(|x, y| y.total_cmp(x));
    for (one, depth) in found.iter().zip(&depths) {
        assert!((one.contact.depth - depth).abs() < 1e-9, "{context}: {depths:?}, found {one:?}");
    }
    tally.regions += expected.len();
    tally.several += usize::from(expected.len() > 1);
}

fn sweep(bodies: [&Body; 2], range: (f64, f64), rounds: usize, name: &str) -> Tally {
    let mut rng = StdRng::seed_from_u64(SEED + 2);
    let mut pipeline = Pipeline::new(&bodies[0].shape, &bodies[1].shape);
    let mut tally = Tally::default();
    for round in 0..rounds {
        let direction = vector(&mut rng).normalize();
        let along = rng.random_range(range.0..range.1);
        let scene = pose(&mut rng, DVec3::ONE);
        let probe = pose(&mut rng, scene.translation + direction * along);
        let context = format!("{name}, seed {:#x}, round {round}", SEED + 2);
        check(bodies, [&probe, &scene], &mut pipeline, &mut tally, &context);
    }
    assert!(tally.minima > 10 && tally.regions > 10 && tally.by_vertices > 5, "{name}: {tally:?}");
    tally
}

fn bumpy() -> TriMesh {
    star(3, |v| 1.0 + 0.12 * (7.0 * v.x).sin() * (6.0 * v.y + 1.0).sin() * (5.0 * v.z).cos())
}

#[test]
fn bumpy_balls_by_brute_force() {
    let body = Body::new(bumpy(), &singles(&bumpy()), Kind::Contained);
    sweep([&body, &body], (1.7, 2.2), 80, "bumpy balls");
}

/// The hulls of these patches protrude, and their depth does not count in regions with vertices inside.
#[test]
fn loose_patches_by_brute_force() {
    let mesh = bumpy();
    let body = Body::new(mesh.clone(), &clusters(&mesh, 4), Kind::Loose);
    let mut rng = StdRng::seed_from_u64(SEED + 3);
    let mut pipeline = Pipeline::new(&body.shape, &body.shape);
    let mut compared = 0;
    for round in 0..60 {
        let direction = vector(&mut rng).normalize();
        let scene = pose(&mut rng, DVec3::ONE);
        let along = rng.random_range(1.6..2.1);
        let probe = pose(&mut rng, DVec3::ONE + direction * along);
        let (found, outcome) = pipeline.run([&probe, &scene], 0.02, &ContactSetSettings::new(0.0));
        let placed = [&probe, &scene].map(|pose| crate::oracle::placed(&body.mesh, pose));
        let mut deepest: f64 = 0.0;
        for side in 0..2 {
            for point in placed[side].iter().flatten().filter(|p| is_inside(**p, &placed[1 - side])) {
                deepest = deepest.max(to_surface(*point, &placed[1 - side]));
            }
        }
        if outcome.by_vertices > 0 && outcome.by_vertices == outcome.regions {
            let context = format!("seed {:#x}, round {round}: {deepest}, {outcome:?}", SEED + 3);
            assert!((found[0].contact.depth - deepest).abs() < 1e-9, "{context}");
            compared += 1;
        }
    }
    assert!(compared > 15, "{compared}");
}

#[test]
fn rings_by_brute_force() {
    let mesh = torus(1.0, 0.25, 24, 10);
    let ring = Body::new(mesh.clone(), &singles(&mesh), Kind::Contained);
    let ball = Body::new(bumpy(), &singles(&bumpy()), Kind::Contained);
    let tally = sweep([&ring, &ring], (0.6, 2.4), 80, "rings");
    assert!(tally.several > 5, "{tally:?}");
    sweep([&ring, &ball], (0.8, 2.2), 60, "ring on ball");
}

/// Contact sets scale with all lengths.
#[test]
fn the_size_of_the_bodies_does_not_matter() {
    let mesh = bumpy();
    let runs = [1.0, 1e-3, 1e3].map(|scale| {
        let mesh = scaled(&mesh, scale);
        let body = shape(&mesh, &clusters(&mesh, 4), Kind::Loose);
        let mut pipeline = Pipeline { size: scale, ..Pipeline::new(&body, &body) };
        let mut rng = StdRng::seed_from_u64(SEED + 4);
        let mut depths = Vec::new();
        for _ in 0..40 {
            let direction = vector(&mut rng).normalize();
            let along = rng.random_range(1.7..2.2) * scale;
            let scene = pose(&mut rng, DVec3::ONE * scale);
            let probe = pose(&mut rng, scene.translation + direction * along);
            let settings =
                ContactSetSettings { spacing: 0.2 * scale, ..ContactSetSettings::new(0.03 * scale) };
            let (found, outcome) = pipeline.run([&probe, &scene], 0.05 * scale, &settings);
            depths.push((outcome.regions, found.iter().map(|c| c.contact.depth / scale).collect::<Vec<_>>()));
        }
        depths
    });
    assert!(runs[0].iter().map(|(regions, _)| regions).sum::<usize>() > 10);
    for other in &runs[1..] {
        for ((regions, depths), (same_regions, same_depths)) in runs[0].iter().zip(other) {
            assert_eq!((regions, depths.len()), (same_regions, same_depths.len()));
            assert!(
                depths.iter().zip(same_depths).all(|(x, y)| (x - y).abs() < 1e-8),
                "{depths:?} {same_depths:?}"
            );
        }
    }
}

/// Open meshes have no inside; a solid on one side is measured from that side.
#[test]
fn shells_keep_the_depth_of_their_patches() {
    let mesh = bumpy();
    let open = shape(&mesh, &singles(&mesh), Kind::Open);
    let solid = shape(&mesh, &singles(&mesh), Kind::Contained);
    let up = Pose::from_translation(DVec3::new(1.85, 0.1, 0.0));
    let settings = ContactSetSettings::new(0.0);
    let run = |probe: &Shape, scene: &Shape| {
        let mut pipeline = Pipeline::new(probe, scene);
        let (found, outcome) = pipeline.run([&up, &Pose::IDENTITY], 0.02, &settings);
        let deepest = pipeline.query.contacts().iter().map(|c| c.contact.depth).fold(0.0, f64::max);
        (found[0].contact.depth, deepest, outcome)
    };
    let (depth, of_patches, outcome) = run(&open, &open);
    assert_eq!((depth, outcome.measured), (of_patches, 0));
    let (both, ..) = run(&solid, &solid);
    let (one, _, outcome) = run(&open, &solid);
    assert!(outcome.inside > 0 && one <= both + 1e-12, "{one} {both}");
}

#[test]
fn invalid_input_is_refused() {
    let mesh = bumpy();
    let body = shape(&mesh, &singles(&mesh), Kind::Contained);
    let mut query = ContactQuery::new(&body, &body);
    let up = Pose::from_translation(DVec3::new(1.85, 0.1, 0.0));
    query.run(&up, &Pose::IDENTITY, &QuerySettings::new(0.05)).unwrap();
    let good = query.contacts().to_vec();
    let mut set = ContactSet::new(&body, &body);
    let mut refuses = |contacts: &[PatchContact], pose: &Pose, settings: &ContactSetSettings| {
        let error = set.run(contacts, pose, &Pose::IDENTITY, settings).err();
        assert_eq!(set.contacts().is_empty(), error.is_some());
        error
    };
    let settings = ContactSetSettings::new(0.01);
    assert_eq!(refuses(&good, &up, &settings), None);
    let with = |change: &dyn Fn(&mut PatchContact)| {
        let mut contacts = good.clone();
        change(&mut contacts[3]);
        contacts
    };
    let fourth = Some(ContactSetError::Contact { index: 3 });
    assert_eq!(refuses(&with(&|c| c.probe_node = u32::MAX), &up, &settings), fourth);
    assert_eq!(refuses(&with(&|c| c.scene_node = 0), &up, &settings), fourth, "a free node");
    assert_eq!(refuses(&with(&|c| c.contact.depth = f64::NAN), &up, &settings), fourth);
    assert_eq!(refuses(&with(&|c| c.contact.point.x = f64::INFINITY), &up, &settings), fourth);
    for merge in [-1.0, f64::NAN, f64::INFINITY] {
        let error = refuses(&good, &up, &ContactSetSettings::new(merge));
        assert!(matches!(error, Some(ContactSetError::Merge { .. })), "{error:?}");
    }
    let error = refuses(&good, &up, &ContactSetSettings { spacing: f64::NAN, ..settings });
    assert!(matches!(error, Some(ContactSetError::Spacing { .. })), "{error:?}");
    let error = refuses(&good, &Pose::from_translation(DVec3::NAN), &settings);
    assert_eq!(error, Some(ContactSetError::Pose { object: QueryObject::Probe }));
    // Contacts at places without objects are meaningless, but must not cause a panic.
    refuses(&good, &Pose::from_translation(DVec3::splat(1e300)), &settings);
    refuses(&with(&|c| c.contact.point = DVec3::splat(1e18)), &up, &ContactSetSettings::new(0.0));
}

#[test]
fn work_is_bounded_by_the_vertices_allowed() {
    let mesh = bumpy();
    let body = shape(&mesh, &singles(&mesh), Kind::Contained);
    let mut query = ContactQuery::new(&body, &body);
    let up = Pose::from_translation(DVec3::new(1.6, 0.1, 0.0));
    query.run(&up, &Pose::IDENTITY, &QuerySettings::new(0.01)).unwrap();
    let mut set = ContactSet::new(&body, &body);
    let mut last = 0.0;
    for max_vertices in [0, 10, 50, 10_000] {
        let settings = ContactSetSettings { max_vertices, ..ContactSetSettings::new(0.0) };
        let depth = set.run(query.contacts(), &up, &Pose::IDENTITY, &settings).unwrap()[0].contact.depth;
        let outcome = set.outcome();
        assert!(outcome.measured <= max_vertices && outcome.truncated == (max_vertices < 1000));
        assert!(depth >= last - 1e-12, "{depth} after {last}");
        last = depth;
    }
}

#[test]
fn a_warm_run_does_not_allocate_and_repeats_itself() {
    let mesh = bumpy();
    let fine = shape(&mesh, &singles(&mesh), Kind::Contained);
    let loose = shape(&mesh, &clusters(&mesh, 40), Kind::Loose);
    let open = shape(&mesh, &clusters(&mesh, 4), Kind::Open);
    for (probe, scene) in [(&fine, &fine), (&loose, &fine), (&loose, &loose), (&open, &fine)] {
        let mut query = ContactQuery::new(probe, scene);
        let mut set = ContactSet::new(probe, scene);
        let settings =
            ContactSetSettings { spacing: set.noticeable_spacing(), ..ContactSetSettings::new(0.02) };
        let poses: Vec<Pose> = (0..40)
            .map(|step| {
                let t = f64::from(step) / 40.0;
                Pose::new(DVec3::new(2.4 - t, 0.3 * t, 0.1), DQuat::from_rotation_y(t))
            })
            .collect();
        let contacts: Vec<Vec<PatchContact>> = poses
            .iter()
            .map(|pose| {
                query.run(pose, &Pose::IDENTITY, &QuerySettings::new(0.05)).unwrap();
                query.contacts().to_vec()
            })
            .collect();
        let mut pass = |expected: &mut Vec<Vec<PatchContact>>| {
            for (index, (pose, contacts)) in poses.iter().zip(&contacts).enumerate() {
                let found = set.run(contacts, pose, &Pose::IDENTITY, &settings).unwrap();
                match expected.get(index) {
                    Some(expected) => assert_eq!(found, expected),
                    None => expected.push(found.to_vec()),
                }
            }
        };
        let mut expected = Vec::new();
        assert!(measure(|| pass(&mut expected)).count_total > 0, "the counter counts");
        assert_eq!(measure(|| pass(&mut expected)).count_total, 0);
        assert!(expected.iter().map(Vec::len).sum::<usize>() > 20);
    }
}

/// At coarser nodes regions are those of the coarser surfaces, within the error threshold.
#[test]
fn coarser_levels_have_the_same_regions() {
    let built = |mesh: &TriMesh| {
        let options = BuildOptions::default();
        Shape::new(palpate_clod_build::build(mesh, &options, &mut unwatched).unwrap())
    };
    let probe = built(&star(5, |v| 1.0 + 0.01 * (25.0 * v.x).sin() * (23.0 * v.y).sin()));
    let scene = built(&star(5, |v| 1.0 + 0.3 * v.z * v.z));
    let mut rng = StdRng::seed_from_u64(SEED + 5);
    let mut pipeline = Pipeline::new(&probe, &scene);
    let (mut coarse, mut compared) = (0, 0);
    for round in 0..40 {
        let direction = vector(&mut rng).normalize();
        let along = rng.random_range(1.8..2.1);
        let scene_pose = pose(&mut rng, DVec3::ONE);
        let probe_pose = pose(&mut rng, DVec3::ONE + direction * along);
        let settings = ContactSetSettings::new(0.05);
        let (fine, outcome) = pipeline.run([&probe_pose, &scene_pose], 0.02, &settings);
        let error = 0.04;
        pipeline
            .query
            .run(&probe_pose, &scene_pose, &QuerySettings { error: error.into(), ..QuerySettings::new(0.02) })
            .unwrap();
        let found = pipeline.set.run(pipeline.query.contacts(), &probe_pose, &scene_pose, &settings).unwrap();
        let level = |c: &PatchContact| probe.clod().node(c.probe_node).level;
        coarse += found.iter().filter(|c| level(c) > 0).count();
        let depths = [fine.first(), found.first()].map(|c| c.map_or(-0.02, |c| c.contact.depth));
        let context = format!("seed {:#x}, round {round}: {depths:?} {outcome:?}", SEED + 5);
        assert!((depths[0] - depths[1]).abs() < 2.0 * error, "{context}");
        if depths.iter().all(|depth| *depth > error) {
            assert_eq!((outcome.regions, pipeline.set.outcome().regions), (1, 1), "{context}");
            compared += 1;
        }
    }
    assert!(coarse > 10 && compared > 10, "{coarse} coarse contacts, {compared} compared");
}
