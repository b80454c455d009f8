//! Distance and intersection queries against every pair of triangles, and tracked queries against fresh ones.

use std::f64::consts::PI;

use crate::oracle::Triangle;
use crate::solids::{Kind, clusters, hierarchy, pose, rotation, singles, star, torus, vector};
use allocation_counter::measure;
use palpate_collide::{Intersection, NearestPoints, ProximityQuery, QueryError, QueryObject, Shape};
use palpate_core::glam::{DQuat, DVec3};
use palpate_core::{Pose, TriMesh};
use rand::{SeedableRng, rngs::StdRng};

const SEED: u64 = 0x0D15_7A9C;

struct Body {
    name: &'static str,
    mesh: TriMesh,
    shape: Shape,
    radius: f64,
    solid: bool,
}

impl Body {
    fn new(name: &'static str, mesh: TriMesh, patches: &[Vec<u32>], kind: Kind) -> Self {
        let shape = Shape::new(hierarchy(&mesh, patches, kind).0);
        let radius = shape.clod().source.bounding_radius;
        Self { name, mesh, shape, radius, solid: kind != Kind::Open }
    }

    /// By the hierarchy builder, whose hulls are simplified and whose levels have an error.
    fn built(name: &'static str, mesh: TriMesh) -> Self {
        let options = palpate_clod_build::BuildOptions::default();
        let clod = palpate_clod_build::build(&mesh, &options, &mut palpate_clod_build::unwatched).unwrap();
        let shape = Shape::new(clod);
        let radius = shape.clod().source.bounding_radius;
        Self { name, mesh, shape, radius, solid: true }
    }
}

fn scaled(mesh: &TriMesh, scale: DVec3) -> TriMesh {
    TriMesh::new(mesh.vertices().iter().map(|v| *v * scale).collect(), mesh.triangles().to_vec()).unwrap()
}

/// A square of `n` × `n` quads, bent by `height`.
fn sheet(n: u32, height: impl Fn(f64, f64) -> f64) -> TriMesh {
    let at = |i: u32| 2.0 * f64::from(i) / f64::from(n) - 1.0;
    let vertices = (0..=n)
        .flat_map(|i| (0..=n).map(move |j| (at(i), at(j))))
        .map(|(x, y)| DVec3::new(x, y, height(x, y)))
        .collect();
    let quad = |i: u32, j: u32| {
        let [p, q, r, s] =
            [i * (n + 1) + j, (i + 1) * (n + 1) + j, (i + 1) * (n + 1) + j + 1, i * (n + 1) + j + 1];
        [[p, q, r], [p, r, s]]
    };
    TriMesh::new(vertices, (0..n).flat_map(|i| (0..n).flat_map(move |j| quad(i, j))).collect()).unwrap()
}

fn together(parts: &[(&TriMesh, DVec3)]) -> TriMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for (mesh, offset) in parts {
        let first = vertices.len() as u32;
        vertices.extend(mesh.vertices().iter().map(|v| *v + *offset));
        triangles.extend(mesh.triangles().iter().map(|t| t.map(|v| v + first)));
    }
    TriMesh::new(vertices, triangles).unwrap()
}

fn flipped(mesh: &TriMesh) -> TriMesh {
    let triangles = mesh.triangles().iter().map(|[p, q, r]| [*p, *r, *q]).collect();
    TriMesh::new(mesh.vertices().to_vec(), triangles).unwrap()
}

fn bumpy() -> TriMesh {
    star(3, |v| 1.0 + 0.25 * (5.0 * v.x).sin() * (4.0 * v.y + 1.0).sin())
}

fn bodies() -> Vec<Body> {
    let ball = star(3, |_| 1.0);
    let whole = |mesh: &TriMesh| vec![(0..mesh.triangles().len() as u32).collect::<Vec<u32>>()];
    let ring = torus(1.0, 0.35, 24, 12);
    let sheet = sheet(8, |x, y| 0.4 * x * x - 0.3 * x * y);
    let needle =
        TriMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::new(2.0, 0.0, 0.0)], vec![[0, 1, 2]]).unwrap();
    let triangle = TriMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]).unwrap();
    let disc = scaled(&ball, DVec3::new(1.2, 0.9, 1e-4));
    vec![
        Body::new("ball", ball.clone(), &whole(&ball), Kind::Contained),
        Body::new("star", bumpy(), &clusters(&bumpy(), 5), Kind::Loose),
        Body::new("coarse star", bumpy(), &clusters(&bumpy(), 40), Kind::Loose),
        Body::new("torus", ring.clone(), &singles(&ring), Kind::Contained),
        Body::new("sheet", sheet.clone(), &clusters(&sheet, 3), Kind::Open),
        Body::new("disc", disc.clone(), &clusters(&disc, 60), Kind::Contained),
        Body::new("triangle", triangle.clone(), &singles(&triangle), Kind::Open),
        Body::new("needle", needle.clone(), &singles(&needle), Kind::Open),
        Body::built("built torus", torus(0.9, 0.3, 30, 20)),
        Body::built("built star", bumpy()),
    ]
}

/// The least distance of two sets of triangles, skipping pairs by spheres only.
fn least_distance(a: &[Triangle], b: &[Triangle]) -> f64 {
    let sphere = |t: &Triangle| {
        let center = t.iter().sum::<DVec3>() / 3.0;
        (center, t.iter().map(|c| c.distance(center)).fold(0.0, f64::max))
    };
    let spheres: Vec<_> = b.iter().map(sphere).collect();
    let mut least = f64::INFINITY;
    for t in a {
        let (center, radius) = sphere(t);
        for (u, (other, size)) in b.iter().zip(&spheres) {
            if center.distance(*other) - radius - size < least {
                least = least.min(crate::oracle::distance(*t, *u));
            }
        }
    }
    least
}

/// How often the surface goes around a point, by the sum of the solid angles.
fn is_inside(triangles: &[Triangle], point: DVec3) -> bool {
    let angle: f64 = triangles
        .iter()
        .map(|t| {
            let [p, q, r] = t.map(|c| (c - point).normalize());
            2.0 * p.dot(q.cross(r)).atan2(1.0 + p.dot(q) + q.dot(r) + r.dot(p))
        })
        .sum();
    (angle / (4.0 * PI)).round() != 0.0
}

fn plain_intersection(
    a: (&Body, &[Triangle]),
    b: (&Body, &[Triangle]),
    distance: f64,
    eps: f64,
) -> Intersection {
    if distance <= eps {
        return Intersection::SurfacesMeet;
    }
    if b.0.solid && a.1.iter().flatten().any(|p| is_inside(b.1, *p)) {
        return Intersection::ProbeInside;
    }
    if a.0.solid && b.1.iter().flatten().any(|p| is_inside(a.1, *p)) {
        return Intersection::SceneInside;
    }
    Intersection::Apart
}

fn on_surface(triangles: &[Triangle], point: DVec3) -> f64 {
    let to_edge = |e: [DVec3; 2]| crate::oracle::point_segment(point, e).distance(point);
    // By its edges too, as one without area is given.
    let to = |t: &Triangle| {
        let inner = crate::oracle::point_triangle(point, *t).distance(point);
        crate::oracle::edges(*t).map(to_edge).into_iter().fold(inner, f64::min)
    };
    triangles.iter().map(to).fold(f64::INFINITY, f64::min)
}

fn found(answer: Option<NearestPoints>) -> NearestPoints {
    answer.expect("no bound on the distance")
}

#[test]
fn agrees_with_every_pair_of_triangles() {
    let bodies = bodies();
    let mut rng = StdRng::seed_from_u64(SEED);
    let mut outcomes = [0; 4];
    for a in &bodies {
        for b in &bodies {
            let mut query = ProximityQuery::new(&a.shape, &b.shape);
            for round in 0..12 {
                let context = format!("seed {SEED:#x}: {} on {}, round {round}", a.name, b.name);
                let size = a.radius + b.radius;
                let from_center = vector(&mut rng) * size * [0.2, 0.6, 0.9][round % 3];
                let scene_pose = pose(&mut rng, 3.0 * DVec3::Y);
                let probe_pose = Pose::new(scene_pose.translation + from_center, rotation(&mut rng));
                let (ta, tb) = (
                    crate::oracle::placed(&a.mesh, &probe_pose),
                    crate::oracle::placed(&b.mesh, &scene_pose),
                );
                let plain = least_distance(&ta, &tb);
                let eps = 1e-9 * size;

                let nearest = found(query.distance(&probe_pose, &scene_pose, f64::INFINITY).unwrap());
                let d = nearest.distance;
                assert!((d - plain).abs() <= eps, "{context}: {d} {plain}");
                assert!((nearest.on_probe.distance(nearest.on_scene) - d).abs() <= eps, "{context}");
                assert!(on_surface(&ta, nearest.on_probe) <= eps, "{context}: {nearest:?}");
                assert!(on_surface(&tb, nearest.on_scene) <= eps, "{context}: {nearest:?}");

                let within = query.distance(&probe_pose, &scene_pose, 1.01 * plain).unwrap();
                assert!((found(within).distance - plain).abs() <= eps, "{context}");
                if plain > 0.0 {
                    let beyond = query.distance(&probe_pose, &scene_pose, 0.99 * plain).unwrap();
                    assert_eq!(beyond, None, "{context}");
                }
                let expected = plain_intersection((a, &ta), (b, &tb), plain, 0.0);
                for _ in 0..2 {
                    assert_eq!(query.intersects(&probe_pose, &scene_pose).unwrap(), expected, "{context}");
                    query.reset();
                }
                outcomes[match expected {
                    Intersection::Apart => 0,
                    Intersection::SurfacesMeet => 1,
                    Intersection::ProbeInside => 2,
                    _ => 3,
                }] += 1;
            }
        }
    }
    assert!(outcomes[0] > 200 && outcomes[1] > 200, "{outcomes:?}");
}

/// A slide to and fro with turns, and every so often a jump.
fn motion(rng: &mut StdRng, steps: usize, size: f64) -> Vec<Pose> {
    let mut pose = Pose::new(DVec3::new(size, 0.0, 0.0), DQuat::IDENTITY);
    let mut direction = vector(rng);
    (0..steps)
        .map(|step| {
            if step % 40 == 39 {
                pose = Pose::new(vector(rng) * size, rotation(rng));
            }
            if step % 15 == 0 {
                // Towards the scene object, more or less.
                direction = vector(rng) - 2.0 * pose.translation / size;
            }
            // At times none at all, at times a large one.
            let length = [0.004, 0.0, 0.02, 0.0005, 0.1][(step / 7) % 5] * size;
            pose.translation += direction * length;
            let turn = DQuat::from_scaled_axis(vector(rng) * length / size);
            pose.rotation = (turn * pose.rotation).normalize();
            pose
        })
        .collect()
}

#[test]
fn a_tracked_query_finds_what_a_fresh_one_does() {
    let bodies = bodies();
    let mut rng = StdRng::seed_from_u64(SEED + 1);
    let mut outcomes = [0; 5];
    for (a, b) in [(1, 3), (2, 0), (3, 3), (9, 8), (5, 1), (4, 9), (6, 2), (7, 5)] {
        let (a, b) = (&bodies[a], &bodies[b]);
        let size = a.radius + b.radius;
        let mut tracked = ProximityQuery::new(&a.shape, &b.shape);
        let mut fresh = ProximityQuery::new(&a.shape, &b.shape);
        let (mut cost, mut fresh_cost) = (0, 0);
        // The scene object moves along: only the relative motion counts.
        let offset = vector(&mut rng);
        let frame = pose(&mut rng, offset);
        for (step, probe) in motion(&mut rng, 400, size).into_iter().enumerate() {
            let context = format!("seed {SEED:#x}: {} on {}, step {step}", a.name, b.name);
            let swing = Pose::new(DVec3::ZERO, DQuat::from_rotation_z(0.01 * step as f64));
            let (probe, scene) = (swing * frame * probe, swing * frame);
            fresh.reset();
            match step % 3 {
                0 => {
                    let answer = tracked.intersects(&probe, &scene).unwrap();
                    assert_eq!(answer, fresh.intersects(&probe, &scene).unwrap(), "{context}");
                    outcomes[answer as usize] += 1;
                }
                1 => {
                    let distance = found(tracked.distance(&probe, &scene, f64::INFINITY).unwrap()).distance;
                    let again = found(fresh.distance(&probe, &scene, f64::INFINITY).unwrap()).distance;
                    assert!((distance - again).abs() <= 1e-11 * size, "{context}: {distance} {again}");
                }
                _ => {
                    let upper = 0.05 * size;
                    let distance =
                        tracked.distance(&probe, &scene, upper).unwrap().map(|nearest| nearest.distance);
                    let again =
                        fresh.distance(&probe, &scene, upper).unwrap().map(|nearest| nearest.distance);
                    assert_eq!(distance.is_some(), again.is_some(), "{context}");
                    let gap = distance.unwrap_or(0.0) - again.unwrap_or(0.0);
                    assert!(gap.abs() <= 1e-11 * size, "{context}: {distance:?} {again:?}");
                }
            }
            assert!(fresh.effort().from_roots, "{context}");
            cost += tracked.effort().pairs;
            fresh_cost += fresh.effort().pairs;
        }
        assert!(cost < fresh_cost, "{} on {}: {cost} {fresh_cost}", a.name, b.name);
    }
    assert!(outcomes[0] > 100 && outcomes[1] > 100, "{outcomes:?}");
}

#[test]
fn the_unit_of_length_does_not_matter() {
    let mesh = bumpy();
    let ring = torus(1.0, 0.35, 24, 12);
    let mut rng = StdRng::seed_from_u64(SEED + 2);
    let mut random_pose = || Pose::new(vector(&mut rng) * 1.6, rotation(&mut rng));
    let poses: Vec<Pose> = (0..40).map(|_| random_pose()).collect();
    let mut unit = Vec::new();
    for scale in [1.0, 1e-3, 1e3, 1e-6] {
        let body = |mesh: &TriMesh, patches: &[Vec<u32>]| {
            Body::new("", scaled(mesh, DVec3::splat(scale)), patches, Kind::Loose)
        };
        let (a, b) = (body(&mesh, &clusters(&mesh, 5)), body(&ring, &clusters(&ring, 9)));
        let mut query = ProximityQuery::new(&a.shape, &b.shape);
        for (index, pose) in poses.iter().enumerate() {
            let placed = Pose::new(pose.translation * scale, pose.rotation);
            let distance =
                found(query.distance(&placed, &Pose::IDENTITY, f64::INFINITY).unwrap()).distance / scale;
            let answer = query.intersects(&placed, &Pose::IDENTITY).unwrap();
            if scale == 1.0 {
                unit.push((distance, answer));
            }
            assert!((distance - unit[index].0).abs() < 1e-11, "seed {SEED:#x}, scale {scale}, pose {index}");
            assert_eq!(answer, unit[index].1, "seed {SEED:#x}, scale {scale}, pose {index}");
        }
    }
    let meeting = unit.iter().filter(|(_, answer)| answer.intersects()).count();
    assert!((5..35).contains(&meeting), "{meeting}");
}

#[test]
fn enclosed_solids_intersect() {
    let small = star(1, |_| 0.1);
    let large = star(3, |_| 1.0);
    let shell = together(&[(&large, DVec3::ZERO), (&flipped(&star(2, |_| 0.6)), DVec3::ZERO)]);
    let pair = together(&[(&small, DVec3::ZERO), (&small, DVec3::new(1.4, 0.0, 0.0))]);
    let body = |mesh: &TriMesh, kind| Body::new("", mesh.clone(), &singles(mesh), kind).shape;
    let [small_one, large_one, shell, pair] = [&small, &large, &shell, &pair].map(|m| body(m, Kind::Loose));
    let open = body(&large, Kind::Open);
    let at = |x: f64| Pose::from_translation(DVec3::new(x, 0.0, 0.0));
    let ask =
        |a: &Shape, b: &Shape, x: f64| ProximityQuery::new(a, b).intersects(&at(x), &Pose::IDENTITY).unwrap();

    assert_eq!(ask(&small_one, &large_one, 0.0), Intersection::ProbeInside);
    assert_eq!(ask(&large_one, &small_one, 0.0), Intersection::SceneInside);
    assert_eq!(ask(&small_one, &large_one, 0.95), Intersection::SurfacesMeet);
    assert_eq!(ask(&small_one, &large_one, 1.2), Intersection::Apart);
    assert_eq!(ask(&small_one, &open, 0.0), Intersection::Apart, "an open mesh has no inside");
    assert_eq!(ask(&open, &small_one, 0.0), Intersection::Apart);
    assert_eq!(ask(&small_one, &shell, 0.0), Intersection::Apart, "in the cavity");
    assert_eq!(ask(&small_one, &shell, 0.8), Intersection::ProbeInside, "in the wall");
    // Only the second of the two balls is inside.
    assert_eq!(ask(&pair, &large_one, -1.2), Intersection::ProbeInside);
    assert_eq!(ask(&large_one, &pair, 1.2), Intersection::SceneInside);
    assert_eq!(ask(&pair, &large_one, -0.7), Intersection::ProbeInside);

    // Along a path through the wall, with and without jumps over it.
    let mut query = ProximityQuery::new(&small_one, &large_one);
    for steps in [300, 9] {
        for step in 0..=steps {
            let x = 1.5 - 3.0 * f64::from(step) / f64::from(steps);
            let (near, far) = (x.abs() - 0.1, x.abs() + 0.1);
            let answer = query.intersects(&at(x), &Pose::IDENTITY).unwrap();
            // The balls are polyhedra, a little smaller than round.
            if near > 1.0 {
                assert_eq!(answer, Intersection::Apart, "{x}");
            } else if far < 0.98 {
                assert_eq!(answer, Intersection::ProbeInside, "{x}");
            }
            if steps == 300 && (0.01..0.15).contains(&(far - 1.0)) {
                assert_eq!(answer, Intersection::SurfacesMeet, "{x}");
            }
        }
    }
    // From the middle the surface is as far as the solid is thick.
    let nearest = found(query.distance(&Pose::IDENTITY, &Pose::IDENTITY, f64::INFINITY).unwrap());
    assert!((0.85..0.9).contains(&nearest.distance), "{nearest:?}");
}

#[test]
fn what_makes_no_sense_is_refused() {
    let mesh = bumpy();
    let body = Body::new("", mesh.clone(), &clusters(&mesh, 4), Kind::Loose).shape;
    let mut query = ProximityQuery::new(&body, &body);
    let good = Pose::from_translation(DVec3::new(3.0, 0.0, 0.0));
    let before = query.distance(&good, &Pose::IDENTITY, f64::INFINITY).unwrap();
    let bad = [
        Pose::from_translation(DVec3::new(f64::NAN, 0.0, 0.0)),
        Pose::from_translation(DVec3::new(0.0, f64::INFINITY, 0.0)),
        Pose::new(DVec3::ZERO, DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0)),
        Pose::new(DVec3::ZERO, DQuat::from_xyzw(0.0, f64::NAN, 0.0, 1.0)),
    ];
    for pose in bad {
        let [probe, scene] =
            [QueryObject::Probe, QueryObject::Scene].map(|object| QueryError::Pose { object });
        assert_eq!(query.distance(&pose, &good, 1.0), Err(probe));
        assert_eq!(query.distance(&good, &pose, 1.0), Err(scene));
        assert_eq!(query.intersects(&pose, &good), Err(probe));
    }
    for upper in [f64::NAN, -1.0, f64::NEG_INFINITY] {
        let error = query.distance(&good, &Pose::IDENTITY, upper);
        assert!(matches!(error, Err(QueryError::UpperBound { .. })), "{error:?}");
    }
    assert_eq!(
        query.distance(&good, &Pose::IDENTITY, f64::INFINITY).unwrap(),
        before,
        "nothing is left of it"
    );
    // Far, but finite; and too far for a squared distance.
    for translation in [1e200, f64::MAX] {
        let pose = Pose::from_translation(DVec3::splat(translation));
        let error = Err(QueryError::TooFarApart);
        assert_eq!(query.distance(&pose, &Pose::IDENTITY, f64::INFINITY), error);
        assert_eq!(
            query.intersects(&pose, &Pose::from_translation(-pose.translation)),
            Err(QueryError::TooFarApart)
        );
    }
    let far = Pose::from_translation(DVec3::splat(1e100));
    assert_eq!(query.intersects(&far, &Pose::IDENTITY).unwrap(), Intersection::Apart);
    assert_eq!(query.distance(&far, &Pose::IDENTITY, 1.0), Ok(None));
    assert_eq!(query.distance(&good, &Pose::IDENTITY, f64::INFINITY).unwrap(), before);
}

#[test]
fn a_warm_query_does_not_allocate() {
    let bodies = bodies();
    let mut rng = StdRng::seed_from_u64(SEED + 3);
    for (a, b) in [(1, 3), (2, 0), (0, 0), (9, 8), (4, 9)] {
        let (a, b) = (&bodies[a], &bodies[b]);
        let poses = motion(&mut rng, 120, a.radius + b.radius);
        let mut query = ProximityQuery::new(&a.shape, &b.shape);
        let mut pass = || {
            query.reset();
            let mut sum = 0.0;
            for pose in &poses {
                sum += query
                    .distance(pose, &Pose::IDENTITY, f64::INFINITY)
                    .unwrap()
                    .map_or(0.0, |nearest| nearest.distance);
                sum += f64::from(u8::from(query.intersects(pose, &Pose::IDENTITY).unwrap().intersects()));
            }
            sum
        };
        let warm = pass();
        assert_eq!(measure(|| assert_eq!(pass().to_bits(), warm.to_bits())).count_total, 0);
        assert!(warm > 1.0, "{warm}");
    }
}
