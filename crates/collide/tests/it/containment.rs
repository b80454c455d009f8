//! Parts of one object that are wholly inside the other, against winding numbers, distances and crossings
//! summed over all triangles.

use std::f64::consts::PI;

use crate::oracle::{Triangle, intersect, is_inside, placed, to_surface};
use crate::solids::{Kind, clusters, hierarchy, pose, rotation, singles, star, torus, vector};
use allocation_counter::measure;
use palpate_collide::{
    ContactQuery, ContactSet, ContactSetOutcome, ContactSetSettings, Containment, PatchContact,
    QuerySettings, Shape,
};
use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Pose, TriMesh};
use rand::{RngExt, SeedableRng, rngs::StdRng};

const SEED: u64 = 0x1451_DE00;

/// Small against all bodies here, m.
const TOLERANCE: f64 = 0.01;

/// A mesh in parts, with a hierarchy over all.
struct Solid {
    parts: Vec<TriMesh>,
    whole: TriMesh,
    shape: Shape,
}

impl Solid {
    fn new(parts: Vec<TriMesh>, patch: usize, kind: Kind) -> Self {
        let whole = together(&parts);
        let patches = if patch == 1 { singles(&whole) } else { clusters(&whole, patch) };
        let shape = Shape::new(hierarchy(&whole, &patches, kind).0);
        Self { parts, whole, shape }
    }
}

fn together(parts: &[TriMesh]) -> TriMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for part in parts {
        let first = vertices.len() as u32;
        vertices.extend_from_slice(part.vertices());
        triangles.extend(part.triangles().iter().map(|t| t.map(|v| v + first)));
    }
    TriMesh::new(vertices, triangles).unwrap()
}

fn moved(mesh: &TriMesh, by: DVec3, scale: f64) -> TriMesh {
    TriMesh::new(mesh.vertices().iter().map(|v| scale * *v + by).collect(), mesh.triangles().to_vec())
        .unwrap()
}

fn turned_over(mesh: &TriMesh) -> TriMesh {
    TriMesh::new(mesh.vertices().to_vec(), mesh.triangles().iter().map(|[i, j, k]| [*i, *k, *j]).collect())
        .unwrap()
}

fn box_mesh(half: DVec3) -> TriMesh {
    let corner =
        |i: u32| half * DVec3::from_array([0, 1, 2].map(|k| if i >> k & 1 == 1 { 1.0 } else { -1.0 }));
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    TriMesh::new((0..8).map(corner).collect(), triangles).unwrap()
}

fn ball(radius: f64, times: usize) -> TriMesh {
    star(times, |_| radius)
}

fn bumpy() -> TriMesh {
    star(4, |v| 1.0 + 0.12 * (7.0 * v.x).sin() * (6.0 * v.y + 1.0).sin() * (5.0 * v.z).cos())
}

/// What all triangles say of a part: whether all its vertices are inside a surface (by winding numbers) that
/// none of its triangles meets, and the largest distance of its vertices from that surface.
fn by_brute_force(part: &[Triangle], other: &[Triangle]) -> Option<f64> {
    let mut points: Vec<DVec3> = part.iter().flatten().copied().collect();
    points.sort_unstable_by(|p, q| p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z)));
    points.dedup();
    if !points.iter().all(|point| is_inside(*point, other)) {
        return None;
    }
    let around = |t: &Triangle| (t[0].min(t[1]).min(t[2]), t[0].max(t[1]).max(t[2]));
    let meets = |t: &Triangle, u: &Triangle| {
        let ((low, high), (from, to)) = (around(t), around(u));
        low.cmple(to).all() && high.cmpge(from).all() && intersect(*t, *u)
    };
    if part.iter().any(|t| other.iter().any(|u| meets(t, u))) {
        return None;
    }
    points.iter().map(|point| to_surface(*point, other)).reduce(f64::max)
}

/// A query and its contact set, beside a search for parts inside that knows nothing of the contacts.
struct Pipeline {
    query: ContactQuery,
    set: ContactSet,
    containment: Containment,
}

impl Pipeline {
    fn new(probe: &Solid, scene: &Solid) -> Self {
        let (probe, scene) = (&probe.shape, &scene.shape);
        Self {
            query: ContactQuery::new(probe, scene),
            set: ContactSet::new(probe, scene),
            containment: Containment::new(probe, scene),
        }
    }

    fn run(&mut self, probe: &Pose, scene: &Pose) -> (Vec<PatchContact>, ContactSetOutcome) {
        self.query.run(probe, scene, &QuerySettings::new(TOLERANCE)).unwrap();
        let settings = ContactSetSettings::new(0.1 * TOLERANCE);
        let found = self.set.run(self.query.contacts(), probe, scene, &settings).unwrap().to_vec();
        let outcome = *self.set.outcome();
        assert_eq!(outcome.penetrating + outcome.separated, found.len());
        assert!(found.is_sorted_by(|x, y| x.contact.depth >= y.contact.depth || y.contact.depth < 0.0));
        for PatchContact { contact, .. } in &found {
            assert!((contact.normal.length() - 1.0).abs() < 1e-9, "{contact:?}");
            let offset = contact.point - contact.depth * contact.normal - contact.scene_point;
            assert!(offset.length() <= 1e-9, "Eq. 5.36, {contact:?}");
        }
        let alone = self.containment.run(probe, scene).unwrap();
        assert!(alone.iter().all(|one| found.contains(one)), "{alone:?} of {found:?}");
        assert_eq!(self.containment.parts(), outcome.contained);
        (found, outcome)
    }

    /// Whether the query itself found anything that penetrates.
    fn meets(&self) -> bool {
        self.query.contacts().iter().any(|found| found.contact.depth >= 0.0)
    }
}

/// Counts of what a sweep came across.
#[derive(Debug, Default)]
struct Tally {
    /// Poses with parts inside, and those of them that the query alone says nothing of.
    inside: usize,
    unseen: usize,
    /// Poses at which surfaces cross, and at which nothing overlaps.
    crossing: usize,
    apart: usize,
}

/// Random poses of a probe in and around a scene object.
fn sweep(probe: &Solid, scene: &Solid, reach: f64, rounds: usize, name: &str) -> Tally {
    let mut rng = StdRng::seed_from_u64(SEED);
    let mut pipeline = Pipeline::new(probe, scene);
    let mut tally = Tally::default();
    for round in 0..rounds {
        let place = vector(&mut rng);
        let scene_pose = pose(&mut rng, place);
        let at = place + reach * vector(&mut rng);
        let probe_pose = pose(&mut rng, at);
        let context = format!("{name}, seed {SEED:#x}, round {round}");
        let (found, outcome) = pipeline.run(&probe_pose, &scene_pose);
        let poses = [&probe_pose, &scene_pose];
        let bodies = [probe, scene];
        let mut contained = [0; 2];
        let mut deepest: f64 = 0.0;
        for side in 0..2 {
            let other = bodies[1 - side];
            if !other.shape.clod().source.solid {
                continue;
            }
            let surface = placed(&other.whole, poses[1 - side]);
            for part in &bodies[side].parts {
                if let Some(depth) = by_brute_force(&placed(part, poses[side]), &surface) {
                    contained[side] += 1;
                    deepest = deepest.max(depth);
                }
            }
        }
        assert_eq!(outcome.contained, contained, "{context}: {outcome:?}");
        let told = found.first().map_or(0.0, |found| found.contact.depth.max(0.0));
        assert!(told >= deepest - 1e-9, "{context}: {told} m, where a vertex is {deepest} m deep");
        if contained != [0; 2] {
            tally.inside += 1;
            tally.unseen += usize::from(!pipeline.meets());
        } else if outcome.regions > 0 {
            tally.crossing += 1;
        } else {
            assert!(told == 0.0, "{context}: {told} m");
            tally.apart += 1;
        }
    }
    tally
}

#[test]
fn small_bodies_inside_and_around_a_bumpy_ball() {
    let small =
        Solid::new(vec![moved(&torus(1.0, 0.3, 8, 5), DVec3::new(0.05, 0.0, 0.0), 0.12)], 1, Kind::Contained);
    let bumpy = Solid::new(vec![bumpy()], 3, Kind::Loose);
    for (probe, scene, name) in [(&small, &bumpy, "inside"), (&bumpy, &small, "around")] {
        let tally = sweep(probe, scene, 0.9, 150, name);
        // The control: without the search for parts inside nothing would be told of these.
        assert!(tally.unseen > 30 && tally.crossing > 10 && tally.apart > 10, "{name}: {tally:?}");
    }
}

/// The hollow of a shell is outside of its material; the shell's inner surface may be inside the other.
#[test]
fn the_hollow_of_a_shell_is_outside() {
    let shell = Solid::new(vec![ball(1.0, 3), turned_over(&ball(0.6, 3))], 1, Kind::Contained);
    let small = Solid::new(vec![ball(0.1, 1)], 1, Kind::Contained);
    let middle = Solid::new(vec![ball(0.8, 3)], 1, Kind::Contained);
    let mut pipeline = Pipeline::new(&small, &shell);
    for (at, inside) in [(0.0, 0), (0.3, 0), (0.8, 1), (1.3, 0)] {
        for turn in [DQuat::IDENTITY, DQuat::from_rotation_x(1.0)] {
            let probe = Pose::new(DVec3::X * at, turn);
            let (found, outcome) = pipeline.run(&probe, &Pose::IDENTITY);
            assert_eq!((outcome.contained, found.len()), ([inside, 0], inside), "at {at} m: {found:?}");
        }
    }
    // The ball's surface is in the shell's material, and the hollow's surface in the ball.
    let (found, outcome) = Pipeline::new(&middle, &shell).run(&Pose::IDENTITY, &Pose::IDENTITY);
    assert_eq!((outcome.contained, found.len()), ([1, 1], 2), "{found:?}");
    let tally = sweep(&small, &shell, 0.8, 100, "shell");
    assert!(tally.unseen > 10 && tally.crossing > 10 && tally.apart > 10, "{tally:?}");
    // A shell around a ball in its hollow touches it nowhere; a shell in a shell is inside with both
    // surfaces.
    let tiny = Solid::new(
        vec![moved(&ball(1.0, 2), DVec3::ZERO, 0.1), turned_over(&moved(&ball(0.6, 2), DVec3::ZERO, 0.1))],
        1,
        Kind::Contained,
    );
    let tally = sweep(&shell, &tiny, 0.8, 60, "shell around a shell");
    assert!(tally.unseen > 5 && tally.apart > 5, "{tally:?}");
}

/// Of several pieces each is looked at by itself, and a piece inside a piece that faces the same way is solid
/// all through.
#[test]
fn pieces_are_told_one_by_one() {
    let pair = Solid::new(
        vec![moved(&ball(0.1, 1), DVec3::X * 0.4, 1.0), moved(&ball(0.15, 1), -DVec3::X * 0.4, 1.0)],
        1,
        Kind::Contained,
    );
    let pieces = Solid::new(
        vec![
            moved(&ball(0.5, 3), DVec3::X * 0.7, 1.0),
            moved(&box_mesh(DVec3::splat(0.5)), -DVec3::X * 0.7, 1.0),
        ],
        4,
        Kind::Loose,
    );
    for (probe, scene, name) in [(&pair, &pieces, "pair in pieces"), (&pieces, &pair, "pieces around a pair")]
    {
        let tally = sweep(probe, scene, 0.9, 150, name);
        assert!(tally.unseen > 20 && tally.crossing > 20 && tally.apart > 10, "{name}: {tally:?}");
    }
    let nested = Solid::new(vec![ball(1.0, 3), ball(0.5, 3)], 1, Kind::Contained);
    let small = Solid::new(vec![ball(0.1, 1)], 1, Kind::Contained);
    let mut pipeline = Pipeline::new(&small, &nested);
    for at in [0.0, 0.2, 0.65, 0.8] {
        let (found, outcome) = pipeline.run(&Pose::from_translation(DVec3::Y * at), &Pose::IDENTITY);
        assert_eq!(outcome.contained, [1, 0], "at {at} m");
        // The way out is through the outer ball, whose facets are up to 1.5 % of its radius inside of it.
        let depth = 1.0 + 0.1 - at;
        assert!((found[0].contact.depth - depth).abs() < 0.02, "at {at} m: {found:?}");
    }
}

/// Nothing is inside an open mesh; an open mesh may be inside a solid.
#[test]
fn open_meshes_have_no_inside() {
    let small = Solid::new(vec![ball(0.1, 1)], 1, Kind::Contained);
    let sheet = TriMesh::new(vec![DVec3::ZERO, DVec3::X * 0.2, DVec3::Y * 0.2], vec![[0, 1, 2]]).unwrap();
    let sheet = Solid::new(vec![sheet], 1, Kind::Open);
    let [open, solid] = [Kind::Open, Kind::Contained].map(|kind| Solid::new(vec![bumpy()], 1, kind));
    for (probe, scene, inside) in
        [(&small, &open, 0), (&small, &solid, 1), (&sheet, &solid, 1), (&sheet, &open, 0)]
    {
        let (found, outcome) = Pipeline::new(probe, scene).run(&Pose::IDENTITY, &Pose::IDENTITY);
        assert_eq!((outcome.contained, found.len()), ([inside, 0], inside), "{found:?}");
    }
}

/// In a convex body the depth is the least motion that ends the penetration, up to the cones of directions.
#[test]
fn the_depth_is_the_way_out() {
    let mut rng = StdRng::seed_from_u64(SEED + 1);
    let small = Solid::new(vec![ball(0.1, 2)], 1, Kind::Contained);
    let inner = Solid::new(vec![box_mesh(DVec3::new(0.3, 0.02, 0.02))], 1, Kind::Contained);
    let outer = Solid::new(vec![ball(1.0, 4)], 3, Kind::Contained);
    let plate = Solid::new(vec![box_mesh(DVec3::new(1.0, 1.0, 0.1))], 1, Kind::Contained);
    for round in 0..60 {
        // A ball in a ball.
        let off = rng.random_range(0.05..0.85);
        let at = vector(&mut rng).normalize() * off;
        let probe = pose(&mut rng, at);
        let (found, outcome) = Pipeline::new(&small, &outer).run(&probe, &Pose::IDENTITY);
        assert_eq!((outcome.contained, found.len()), ([1, 0], 1), "round {round}");
        let contact = found[0].contact;
        assert!((contact.depth - (1.1 - off)).abs() < 0.01, "round {round}, off by {off}: {contact:?}");
        // Moved out along the contact, the bodies are apart; by half of that, they are not.
        let out = |part: f64| Pose { translation: at - part * contact.depth * contact.normal, ..probe };
        let (found, outcome) = Pipeline::new(&small, &outer).run(&out(1.0 + 1e-6), &Pose::IDENTITY);
        assert!(
            outcome.regions == 0 && outcome.contained == [0, 0],
            "round {round}: {outcome:?} {contact:?} {found:?}"
        );
        let (_, outcome) = Pipeline::new(&small, &outer).run(&out(0.5), &Pose::IDENTITY);
        assert!(outcome.regions > 0, "round {round}");
        // The same the other way round, but for directions on the border of two cones.
        let (back, _) = Pipeline::new(&outer, &small).run(&Pose::IDENTITY, &probe);
        assert!((back[0].contact.depth - contact.depth).abs() < 0.005, "round {round}: {back:?} {contact:?}");
        assert!(back[0].contact.normal.dot(contact.normal) < -0.9, "round {round}: {back:?} {contact:?}");

        // A bar in a plate comes out sideways; its deepest vertex is not as deep as that.
        let lift = rng.random_range(-0.05..0.05);
        let turn = DQuat::from_rotation_z(rng.random_range(0.0..PI));
        let bar = Pose::new(DVec3::new(0.0, 0.0, lift), turn);
        let (found, outcome) = Pipeline::new(&inner, &plate).run(&bar, &Pose::IDENTITY);
        assert_eq!(outcome.contained, [1, 0], "round {round}");
        let depth = 0.1 + 0.02 - f64::abs(lift);
        assert!((found[0].contact.depth - depth).abs() < 1e-9, "round {round}: {depth} m for {found:?}");
        assert!(depth > 0.1 - 0.02 + f64::abs(lift) || f64::abs(lift) > 0.02);
    }
}

/// A path from afar through the surface to the middle: the depth grows, and does not jump back where the
/// surfaces come apart again inside.
#[test]
fn the_depth_goes_on_where_surfaces_come_apart_inside() {
    let small = Solid::new(vec![ball(0.1, 2)], 1, Kind::Contained);
    for (patch, kind) in [(1, Kind::Contained), (4, Kind::Contained), (30, Kind::Loose)] {
        let outer = Solid::new(vec![ball(1.0, 4)], patch, kind);
        let mut pipeline = Pipeline::new(&small, &outer);
        let (mut last, mut inside) = (0.0, 0);
        for step in 0..200 {
            let at = 1.2 - 0.005 * f64::from(step);
            let (found, outcome) = pipeline.run(&Pose::from_translation(DVec3::Z * at), &Pose::IDENTITY);
            let depth = found.first().map_or(0.0, |found| found.contact.depth.max(0.0));
            assert!(depth >= last - 0.01, "patches of {patch}, at {at} m: {depth} m after {last} m");
            assert!((depth - (1.1 - at).max(0.0)).abs() < 0.02, "patches of {patch}, at {at} m: {depth} m");
            last = depth;
            inside += outcome.contained[0];
        }
        assert!((130..142).contains(&inside), "{inside} poses inside");
    }
}

/// Surfaces that are apart, or cross, cost at most one measured vertex a part, and none while the bodies move
/// by less than the distance.
#[test]
fn other_poses_cost_next_to_nothing() {
    let small = Solid::new(vec![ball(0.1, 2)], 1, Kind::Contained);
    let outer = Solid::new(vec![torus(1.0, 0.3, 48, 24)], 3, Kind::Loose);
    let (mut containment, mut set, mut query) = (
        Containment::new(&small.shape, &outer.shape),
        ContactSet::new(&small.shape, &outer.shape),
        ContactQuery::new(&small.shape, &outer.shape),
    );
    // In the hole of the ring, then into its surface.
    let mut measured = Vec::new();
    for step in 0..400 {
        let probe = Pose::from_translation(DVec3::X * (0.001 * f64::from(step) + 0.3));
        query.run(&probe, &Pose::IDENTITY, &QuerySettings::new(TOLERANCE)).unwrap();
        let apart = !query.contacts().iter().any(|found| found.contact.depth >= 0.0);
        set.run(query.contacts(), &probe, &Pose::IDENTITY, &ContactSetSettings::new(0.001)).unwrap();
        assert_eq!(set.outcome().contained, [0, 0], "step {step}");
        if apart {
            assert!(set.outcome().measured <= 2, "step {step}: {:?}", set.outcome());
            measured.push(set.outcome().measured);
        }
        assert!(containment.run(&probe, &Pose::IDENTITY).unwrap().is_empty());
    }
    let total: usize = measured.iter().sum();
    assert!(measured.len() > 200 && total < measured.len() / 4, "{total} in {} poses", measured.len());
}

#[test]
fn a_warm_run_with_parts_inside_does_not_allocate() {
    let small = Solid::new(vec![ball(0.1, 2)], 1, Kind::Contained);
    let outer = Solid::new(vec![bumpy()], 3, Kind::Loose);
    let mut rng = StdRng::seed_from_u64(SEED + 2);
    let poses: Vec<Pose> = (0..60)
        .map(|_| {
            let at = vector(&mut rng) * 0.8;
            Pose::new(at, rotation(&mut rng))
        })
        .collect();
    let mut pipeline = Pipeline::new(&small, &outer);
    let mut pass = || {
        let mut inside = 0;
        for probe in &poses {
            pipeline.query.run(probe, &Pose::IDENTITY, &QuerySettings::new(TOLERANCE)).unwrap();
            let settings = ContactSetSettings::new(0.001);
            pipeline.set.run(pipeline.query.contacts(), probe, &Pose::IDENTITY, &settings).unwrap();
            pipeline.containment.run(probe, &Pose::IDENTITY).unwrap();
            inside += pipeline.set.outcome().contained[0];
        }
        inside
    };
    let warm = pass();
    assert!(warm > 10, "{warm}");
    assert_eq!(measure(|| assert_eq!(pass(), warm)).count_total, 0);
    let refused = pipeline.containment.run(&Pose::from_translation(DVec3::NAN), &Pose::IDENTITY);
    assert!(refused.is_err() && pipeline.containment.contacts().is_empty());
    assert_eq!(pipeline.containment.parts(), [0, 0]);
}
