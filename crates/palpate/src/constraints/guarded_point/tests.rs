//! Guarded points against distances of lines, planes and all vertices.

use palpate_core::TriMesh;
use palpate_core::glam::DQuat;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::*;
use crate::constraints::test_meshes;

fn random(rng: &mut StdRng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
}

/// A roof of 0.1 m along x with its ridge on the x axis, at 45°.
fn roof() -> FeatureMesh {
    let end = |x: f64| [DVec3::new(x, 0.0, 0.0), DVec3::new(x, -0.02, -0.02), DVec3::new(x, 0.02, -0.02)];
    let triangles =
        vec![[0, 1, 2], [3, 5, 4], [0, 2, 5], [0, 5, 3], [0, 3, 4], [0, 4, 1], [1, 4, 5], [1, 5, 2]];
    let triangles = triangles.into_iter().map(|[a, b, c]: [u32; 3]| [a, c, b]).collect();
    FeatureMesh::new(&TriMesh::new([end(-0.05), end(0.05)].concat(), triangles).expect("a roof"))
}

fn block(edges: DVec3) -> FeatureMesh {
    FeatureMesh::new(&test_meshes::block(edges))
}

/// A knife of 10 mm along x, with a blade of 20 µm at z = 0.
fn knife() -> FeatureMesh {
    let wide = test_meshes::block(DVec3::new(0.01, 2e-3, 6e-3));
    let tapered = |vertex: &DVec3| {
        let width = if vertex.z < 0.0 { 0.01 } else { 1.0 };
        *vertex * DVec3::new(1.0, width, 1.0) + DVec3::Z * 3e-3
    };
    let vertices = wide.vertices().iter().map(tapered).collect();
    FeatureMesh::new(&TriMesh::new(vertices, wide.triangles().to_vec()).expect("a knife"))
}

/// A point that starts near `home` (m, in its own frame).
fn new((home, length): (DVec3, f64), is_probe: bool, frames: &Frames<'_>) -> GuardedPoint {
    let own = frames.own(is_probe);
    let place = own.place_near(home);
    let leash = Leash { home: own.position(&place), length: length as f32 };
    GuardedPoint::new((place, leash), 0, is_probe, 0, (frames, 0.0))
}

fn measure(
    point: &mut GuardedPoint,
    probe: (&FeatureMesh, &Pose),
    object: (&FeatureMesh, &Pose),
) -> Measured {
    // As many steps as pass between two queries.
    let mut measured = point.measure(&Frames::new(probe, object), point.slack, f64::INFINITY);
    for _ in 0..20 {
        measured = point.measure(&Frames::new(probe, object), point.slack, f64::INFINITY);
    }
    measured
}

/// What a point stands for and does not descend to is beside where it started, and not beside where it has
/// come to.
#[test]
fn what_a_reserve_hides_is_measured_from_there() {
    const WITHIN: f32 = 2e-3;
    let probe = FeatureMesh::new(&test_meshes::block(DVec3::splat(0.02)));
    let plate = FeatureMesh::new(&test_meshes::block(DVec3::new(0.2, 0.2, 0.02)));
    // Aslant over the plate, lowest at the corner with x = 10 mm, to which points from the other one descend.
    let turn = DQuat::from_rotation_y(0.5) * DQuat::from_rotation_x(-0.1);
    let corner = |x: f64| DVec3::new(x, 0.01, -0.01);
    let pose = Pose::new(DVec3::Z * (1e-3 - (turn * corner(0.01)).z), turn);
    let frames = Frames::new((&probe, &pose), (&plate, &Pose::from_translation(DVec3::Z * -0.01)));
    for x in [0.01, -0.01] {
        let point = new((corner(x), 0.1), true, &frames);
        assert!((f64::from(point.slack) - 1e-3).abs() < 1e-6, "from {x} m it is at {} m", point.slack);
        let reserve = |hidden| {
            let leash = Leash { home: corner(x), length: 0.1 };
            Reserve::new((probe.place_near(corner(x)), leash), 0, true, 0, (0.0, hidden))
        };
        let distance = reserve(WITHIN).closest(&frames).distance;
        assert!((distance - pose.transform_point(corner(x)).z).abs() < 1e-9, "{x} m: {distance} m");
        let slacks = [WITHIN, 0.0].map(|hidden| f64::from(reserve(hidden).slack_at(distance)));
        assert!((slacks[0] - (distance - f64::from(WITHIN))).abs() < 1e-9, "{x} m: {slacks:?} m");
        assert!((slacks[1] - distance).abs() < 1e-9, "{x} m: {slacks:?} m");
    }
}

/// A surface bends along the line between two faces, also where the direction from beyond the second one has
/// a part along that line, as past its end.
#[test]
fn a_surface_bends_along_the_line_between_faces() {
    let ridge = roof();
    let [on, beyond] = [-0.01, 0.01].map(|y| ridge.nearest(DVec3::new(0.0, y, 0.0)));
    let aslant = ClosestPoint { normal: (beyond.normal + DVec3::X * 0.05).normalize(), ..beyond };
    for (end, is_straight) in [(beyond, true), (aslant, false)] {
        let line = touching_features::bend(&ridge, on.normal, &end).normalize();
        assert!(line.x.abs() > 1.0 - 1e-12, "{end:?}: {line}");
        let direct = on.normal.cross(end.normal).normalize();
        assert_eq!(direct.x.abs() > 1.0 - 1e-12, is_straight, "across the direction: {direct}");
    }
    // At a corner, whichever of its faces a walk has come to.
    let corner = ridge.nearest(DVec3::new(0.06, 0.04, -0.02));
    assert!(matches!(corner.feature, MeshFeature::Vertex(_)), "{corner:?}");
    for face in [beyond.face, ridge.face_near(DVec3::new(0.05, 0.0, -0.01), 0)] {
        let end = ClosestPoint { face, feature: corner.feature, ..aslant };
        let line = touching_features::bend(&ridge, on.normal, &end).normalize();
        assert!(line.x.abs() > 1.0 - 1e-12, "face {face}: {line}");
    }
}

/// Two ridges that cross: the point is on one edge where it is nearest to the other.
#[test]
fn crossed_edges_are_nearest_where_they_cross() {
    let roof = roof();
    let mut rng = StdRng::seed_from_u64(0x60A1);
    for round in 0..800 {
        let gap = [1e-3, 1e-4, 1e-5, -1e-4][round % 4];
        let is_probe = round % 8 < 4;
        let angle = rng.random_range(0.3..2.8);
        // The upper roof is turned over, so that its ridge is its lowest edge.
        let turned = DQuat::from_rotation_z(angle) * DQuat::from_rotation_x(std::f64::consts::PI);
        let shift = DVec3::new(rng.random_range(-0.02..0.02), rng.random_range(-0.005..0.005), gap);
        let (upper, lower) = (Pose::new(shift, turned), Pose::IDENTITY);
        // Lines along x, and along (cos, sin) through the shift, cross in plan.
        let along = DVec3::new(angle.cos(), angle.sin(), 0.0);
        let crossing = shift - along * (shift.y / along.y);
        let (probe, object) = ((&roof, &upper), (&roof, &lower));
        let own = if is_probe { &upper } else { &lower };
        let from = crossing + own.transform_vector(DVec3::X) * rng.random_range(-0.02..0.02);
        let home = own.inverse().transform_point(from);
        let mut point = new((home, 0.05), is_probe, &Frames::new(probe, object));
        let found = measure(&mut point, probe, object);
        let place = found.point.distance(crossing);
        assert!((found.distance - gap).abs() < 2e-8, "round {round}: {found:?}, but {gap} m");
        // Twice the slope that counts as level.
        assert!(found.normal.distance(DVec3::NEG_Z) < 4e-3, "round {round}: {found:?}");
        // A point of the object is measured at its nearest on the probe.
        assert!(place < gap.abs() + 2e-5, "round {round}: {found:?}, not {crossing}");
    }
}

/// Where points of one ridge are where it crosses another one, and that slides, those that follow the first
/// come to where they go by themselves. One whose leash ends before does not follow.
#[test]
fn points_at_the_same_features_go_on_together() {
    const GAP: f64 = 1e-4;
    let roof = roof();
    let mut rng = StdRng::seed_from_u64(0x60A8);
    let (mut led, mut leashed) = (0, 0);
    for round in 0..400 {
        let is_probe = round % 2 == 0;
        let angle = rng.random_range(0.5..2.6);
        let turned = DQuat::from_rotation_z(angle) * DQuat::from_rotation_x(std::f64::consts::PI);
        let at = |shift: f64| Pose::new(DVec3::new(shift, 0.0, GAP), turned);
        let (start, end) = (at(0.0), at(rng.random_range(-5e-3..5e-3)));
        let object = (&roof, &Pose::IDENTITY);
        let starting = Frames::new((&roof, &start), object);
        // Both start at the crossing.
        let mut points = [0.02, rng.random_range(1e-3..8e-3)]
            .map(|length| new((DVec3::ZERO, length), is_probe, &starting));
        points.iter_mut().for_each(|point| {
            measure(point, (&roof, &start), object);
        });
        let frames = Frames::new((&roof, &end), object);
        let [was, short] = points;
        let found = points[0].measure(&frames, points[0].slack, f64::INFINITY);
        let mut alone = points[1];
        let by_itself = measure(&mut alone, (&roof, &end), object);
        let own = frames.own(is_probe);
        let [now, mut next] = points;
        let follows = next.follow((&was, &now), &frames, 1e-6);
        let leash = alone.leash();
        assert_eq!(follows, leash.holds(own.position(&now.place)), "round {round}");
        let apart = own.position(&alone.place).distance(own.position(&now.place));
        assert_eq!(apart < 1e-7, follows, "round {round}: {apart} m");
        if follows {
            led += 1;
            assert!(by_itself.point.distance(found.point) < 1e-7, "round {round}: {by_itself:?}, {found:?}");
            assert_eq!(next.leash().length, leash.length, "it keeps its own");
        } else {
            leashed += 1;
            // One that its leash holds leads none that may go on.
            let (mut held, mut on) = (short, was);
            measure(&mut held, (&roof, &end), object);
            assert!(!on.follow((&short, &held), &frames, 1e-6), "round {round}: {held:?}");
        }
        // Nor does one lead another elsewhere on its edge: where that lies on a face, both hold it.
        let mut along = new((DVec3::X * 1e-3, 0.1), is_probe, &starting);
        along.place = own.place_near(DVec3::X * 1e-3);
        (along.face, along.edge) = (was.face, was.edge);
        assert!(!along.follow((&was, &now), &frames, 1e-6), "round {round}");
        // From another feature, nothing is known of where it goes.
        let mut elsewhere = new((DVec3::new(0.0, 0.02, -0.02), 0.1), is_probe, &starting);
        elsewhere.place = own.place_near(DVec3::new(0.03, 0.02, -0.02));
        assert!(!elsewhere.follow((&was, &now), &frames, 1e-6), "round {round}");
    }
    assert!(led > 100 && leashed > 30, "{led} and {leashed}");
}

/// Ridges that overlap at a low angle, with a point that its leash holds away from where they cross: by
/// several depths along its ridge, though it is beside the other one. It holds them where they cross; out of
/// the nearest face they would slide sideways, and further in.
#[test]
fn edges_that_overlap_at_a_low_angle_are_held_where_they_cross() {
    const DEPTH: f64 = 1e-4;
    let roof = roof();
    let mut rng = StdRng::seed_from_u64(0x60A7);
    for round in 0..200 {
        let is_probe = round % 2 == 0;
        let angle = rng.random_range(0.1..0.3);
        let turned = DQuat::from_rotation_z(angle) * DQuat::from_rotation_x(std::f64::consts::PI);
        let (upper, lower) = (Pose::new(DVec3::NEG_Z * DEPTH, turned), Pose::IDENTITY);
        let (probe, object) = ((&roof, &upper), (&roof, &lower));
        let own = if is_probe { &upper } else { &lower };
        // As far beside the other ridge as half of the depth.
        let from = 0.5 * DEPTH / f64::sin(angle) * if round % 4 < 2 { 1.0 } else { -1.0 };
        let home =
            own.transform_vector(DVec3::X) * from + if is_probe { upper.translation } else { DVec3::ZERO };
        let home = own.inverse().transform_point(home);
        let mut point = new((home, 1e-7), is_probe, &Frames::new(probe, object));
        let found = measure(&mut point, probe, object);
        assert!((found.distance + DEPTH).abs() < 1e-8, "round {round}, {angle}: {found:?}");
        assert!(found.normal.distance(DVec3::NEG_Z) < 1e-6, "round {round}, {angle}: {found:?}");
    }
}

/// A knife that lies across the end of a plate, a little in it, with a point on the diagonal of its blade,
/// which is a strip of 20 µm. The diagonal has no normal across both edges, and the strip's borders need not
/// have one. Out of the plate's end the knife would slide along itself, and sink in where nothing holds it.
#[test]
fn a_narrow_blade_is_held_across_the_end_of_a_plate() {
    const DEPTH: f64 = 1e-4;
    let knife = knife();
    let plate = block(DVec3::new(0.02, 0.02, 0.01));
    let end = Pose::from_translation(DVec3::new(-0.01, 0.0, -0.005));
    for (roll, yaw) in [(0.0, 0.0), (0.05, 0.2), (-0.05, 0.2), (0.2, -0.3), (-0.2, -0.3)] {
        let turn = DQuat::from_rotation_z(yaw) * DQuat::from_rotation_y(0.03) * DQuat::from_rotation_x(roll);
        let pose = Pose::new(DVec3::NEG_Z * DEPTH, turn);
        let mut point = new((DVec3::X * -DEPTH, 1e-7), true, &Frames::new((&knife, &pose), (&plate, &end)));
        assert!(matches!(point.place, Place::Edge(..)) && knife.sharpness(point.place.into()) == 0.0);
        let found = measure(&mut point, (&knife, &pose), (&plate, &end));
        assert!((found.distance + DEPTH).abs() < 0.1 * DEPTH, "{roll}, {yaw}: {found:?}");
        assert!(found.normal.dot(DVec3::NEG_Z) > 0.99, "{roll}, {yaw}: {found:?}");
    }
}

/// The blade of a knife crosses an edge under it. From one side of the blade, the other end of the edge looks
/// to be deep inside.
#[test]
fn a_descent_does_not_pass_under_a_blade() {
    let mut rng = StdRng::seed_from_u64(0xB1AD);
    let (knife, cube) = (knife(), block(DVec3::splat(0.02)));
    // An edge of the cube is along x, at the top.
    let half = 0.01 * 2.0_f64.sqrt();
    let object = Pose::new(DVec3::NEG_Z * half, DQuat::from_rotation_x(std::f64::consts::FRAC_PI_4));
    for round in 0..400 {
        let gap = rng.random_range(1e-6..1e-5);
        let yaw = std::f64::consts::FRAC_PI_2 + rng.random_range(-0.5..0.5);
        let roll: f64 = rng.random_range(-1.0..1.0);
        // The lower border of the blade is at that gap over the edge.
        let pose = Pose::new(
            DVec3::Z * (gap + 1e-5 * roll.sin().abs()),
            DQuat::from_rotation_z(yaw) * DQuat::from_rotation_x(roll),
        );
        let frames = Frames::new((&knife, &pose), (&cube, &object));
        let home = DVec3::new(rng.random_range(-2e-4..2e-4), 0.01, 0.01);
        // As though it had come there in short moves.
        let mut point = new((home, 3e-3), false, &frames);
        (point.place, point.stride) = (cube.place_near(home), rng.random_range(1.0..8.0) / 64.0);
        point.face = knife.face_near(pose.inverse().transform_point(object.transform_point(home)), 0);
        let found = point.measure_on(&frames, 0.0, 1e-6);
        assert!(
            found.is_settled && (found.nearest - gap).abs() < 1e-7,
            "round {round}: {found:?}, not {gap} m"
        );
    }
}

/// Distance of a point from a block (edges, and middle, m), m.
fn to_block((edges, at): (DVec3, DVec3), point: DVec3) -> f64 {
    test_meshes::to_block(edges, point - at)
}

/// Two blocks (edges, and middles, m) as one surface.
fn two_blocks(blocks: [(DVec3, DVec3); 2]) -> FeatureMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for (edges, at) in blocks {
        let (block, first) = (test_meshes::block(edges), vertices.len() as u32);
        vertices.extend(block.vertices().iter().map(|vertex| *vertex + at));
        triangles.extend(block.triangles().iter().map(|triangle| triangle.map(|vertex| vertex + first)));
    }
    FeatureMesh::new(&TriMesh::new(vertices, triangles).expect("two blocks"))
}

/// A corner before a wall of a body that also has a plate, which comes down on the corner along the wall. The
/// corner stays as far from the wall, and turns to the plate before that could be nearer than it tells.
#[test]
fn a_point_turns_to_what_comes_in_from_beside() {
    let wall = (DVec3::new(0.01, 0.1, 0.1), DVec3::X * 0.01);
    let plate = (DVec3::new(0.02, 0.1, 0.004), DVec3::new(-0.006, 0.0, 0.032));
    let both = two_blocks([wall, plate]);
    let cube = block(DVec3::splat(0.01));
    let corner = Pose::from_translation(DVec3::new(-0.005, -0.005, -0.005));
    const REACH: f64 = 1e-4;
    const STEP: f64 = 1e-4;
    let at = |gone: f64| Pose::from_translation(DVec3::NEG_Z * gone);
    let home = DVec3::splat(0.005);
    let mut point = new((home, 1e-6), true, &Frames::new((&cube, &corner), (&both, &at(0.0))));
    assert!((f64::from(point.slack) - 0.005).abs() < 1e-5, "{point:?}: before the wall");
    let (mut turns, mut looks) = (0, 0);
    for step in 1..=299 {
        let gone = f64::from(step) * STEP;
        let frames = Frames::new((&cube, &corner), (&both, &at(gone)));
        let distance = point.measure(&frames, point.slack, REACH).distance;
        let (clear, turned) = point.look_around(&frames, distance, (REACH, 1e-7), gone);
        looks += u32::from(clear == distance);
        turns += u32::from(turned);
        let there = corner.transform_point(point.ends(&frames)[0]) + DVec3::Z * gone;
        let truth = to_block(wall, there).min(to_block(plate, there));
        assert!(clear.min(distance) <= truth + 1e-9, "step {step}: {clear} m and {distance} m, not {truth}");
        assert!(clear >= REACH || clear >= truth - 1e-9, "step {step}: {clear} m, not {truth}");
    }
    assert!(turns == 1 && looks < 40, "turned {turns} times, looked {looks} times");
}

/// A box above a plate: the point descends to the lowest corner, and follows as the box turns.
#[test]
fn a_point_follows_the_lowest_corner_of_a_turning_box() {
    let (cube, plate) = (block(DVec3::splat(0.02)), block(DVec3::new(0.2, 0.2, 0.01)));
    let mut rng = StdRng::seed_from_u64(0x60A2);
    let at = Pose::from_translation(DVec3::NEG_Z * 0.005);
    let corners = |pose: &Pose| {
        let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from((i >> 1) & 1), f64::from(i >> 2)) - 0.5;
        (0..8).map(|i| pose.transform_point(corner(i) * 0.02)).min_by(|a, b| a.z.total_cmp(&b.z))
    };
    let (mut changes, mut rests) = (0, 0);
    for round in 0..100 {
        let axis = random(&mut rng).normalize();
        let turned = |angle: f64| {
            let rotation = DQuat::from_axis_angle(axis, angle) * DQuat::from_rotation_x(0.4);
            let lowest = corners(&Pose::new(DVec3::ZERO, rotation)).expect("corners").z;
            Pose::new(DVec3::Z * (1e-4 - lowest), rotation)
        };
        let start = turned(0.0);
        let home = start.inverse().transform_point(corners(&start).expect("corners") + DVec3::X * 2e-3);
        let mut point = new((home, 0.1), true, &Frames::new((&cube, &start), (&plate, &at)));
        let mut place = start.inverse().transform_point(corners(&start).expect("corners"));
        // At 2 rad/s for a radian, in steps of 1 ms.
        for step in 0..=500 {
            let pose = turned(f64::from(step) * 2e-3);
            let frames = Frames::new((&cube, &pose), (&plate, &at));
            // At rest it is measured as by a descent.
            if let Some((position, closest)) = point.at_rest(&frames) {
                let mut same = point;
                let Descent { position: wanted, closest: by_descent, is_settled } =
                    same.descend(&frames, MAX_MOVES, f64::NEG_INFINITY);
                assert!(is_settled, "{round}, {step}");
                let parts = |found: &ClosestPoint| (found.point, found.distance, found.normal, found.face);
                assert_eq!((position, parts(&closest)), (wanted, parts(&by_descent)), "{round}, {step}");
                assert_eq!((same.place, same.face, same.stride), (point.place, point.face, point.stride));
                rests += 1;
            }
            let found = point.measure(&frames, point.slack, f64::INFINITY);
            let lowest = corners(&pose).expect("corners");
            let now = pose.inverse().transform_point(lowest);
            changes += u32::from(now.distance(place) > 1e-3);
            place = now;
            // Level edges are left late, at the slope that counts as level.
            let off = found.distance - lowest.z;
            assert!((-1e-9..5e-5).contains(&off), "round {round}, step {step}: {found:?}, not {lowest}");
            assert!(found.normal.distance(DVec3::NEG_Z) < 1e-6, "round {round}, step {step}: {found:?}");
        }
    }
    assert!(changes > 30, "the lowest corner changes {changes} times");
    assert!(rests > 1000, "the point rests in {rests} steps");
}

/// A corner of the scene's object below a face of the probe is found from either side, with the same normal.
#[test]
fn points_of_the_object_have_the_probes_normal() {
    let (cube, plate) = (block(DVec3::splat(0.02)), block(DVec3::new(0.2, 0.2, 0.01)));
    // A corner upwards, 0.1 mm below the plate.
    let up = DQuat::from_rotation_arc(DVec3::ONE.normalize(), DVec3::Z);
    let top = 0.01 * 3.0_f64.sqrt();
    let object = Pose::new(DVec3::new(0.013, -0.02, -top), up);
    let probe = Pose::from_translation(DVec3::Z * (0.005 + 1e-4));
    let tip = DVec3::splat(0.01);
    let mut point =
        new((tip - DVec3::X * 2e-3, 0.01), false, &Frames::new((&plate, &probe), (&cube, &object)));
    let found = measure(&mut point, (&plate, &probe), (&cube, &object));
    assert!((found.distance - 1e-4).abs() < 1e-9, "{found:?}");
    assert!(found.normal.distance(DVec3::NEG_Z) < 1e-9, "{found:?}");
    assert!(found.point.distance(DVec3::new(0.013, -0.02, 1e-4)) < 1e-6, "{found:?}");
}

/// A slab with a grid of vertices on its top and bottom, all of which are level, m.
fn tiled(edges: DVec3, cells: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let side = cells + 1;
    let at = |i: u32, j: u32, top: u32| (i * side + j) * 2 + top;
    let share = |i: u32| f64::from(i) / f64::from(cells) - 0.5;
    let vertices = (0..side * side * 2).map(|k| {
        let (i, j) = (k / 2 / side, k / 2 % side);
        DVec3::new(share(i), share(j), f64::from(k % 2) - 0.5) * edges
    });
    let mut triangles = Vec::new();
    let mut quad = |[a, b, c, d]: [u32; 4]| triangles.extend([[a, b, c], [a, c, d]]);
    for i in 0..cells {
        for j in 0..cells {
            quad([at(i, j, 1), at(i + 1, j, 1), at(i + 1, j + 1, 1), at(i, j + 1, 1)]);
            quad([at(i, j, 0), at(i, j + 1, 0), at(i + 1, j + 1, 0), at(i + 1, j, 0)]);
        }
        quad([at(i, 0, 0), at(i + 1, 0, 0), at(i + 1, 0, 1), at(i, 0, 1)]);
        quad([at(i + 1, cells, 0), at(i, cells, 0), at(i, cells, 1), at(i + 1, cells, 1)]);
        quad([at(cells, i, 0), at(cells, i + 1, 0), at(cells, i + 1, 1), at(cells, i, 1)]);
        quad([at(0, i + 1, 0), at(0, i, 0), at(0, i, 1), at(0, i + 1, 1)]);
    }
    (vertices.collect(), triangles)
}

/// Contacts of a box with a flat plate of many facets are along the plate's normal, and the plate is on its
/// own side of them: by all of its vertices. The points start off the places that touch, on short leashes, as
/// those of a query often do. The mere directions between nearest points are across.
#[test]
fn contacts_with_a_flat_plate_are_along_its_normal() {
    let mut rng = StdRng::seed_from_u64(0x60A3);
    let (floor, triangles) = tiled(DVec3::new(0.1, 0.1, 0.01), 17);
    let plate = FeatureMesh::new(&TriMesh::new(floor.clone(), triangles).expect("a mesh"));
    let edges = DVec3::new(0.02, 0.012, 0.008);
    let cube = block(edges);
    let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from((i >> 1) & 1), f64::from(i >> 2)) - 0.5;
    let corners: Vec<DVec3> = (0..8).map(|i| corner(i) * edges).collect();
    let object = Pose::from_translation(DVec3::NEG_Z * 0.005);
    let (mut touching, mut oblique, mut mere) = (0, 0, 0);
    for round in 0..4000 {
        // Flat on the floor, on an edge, and on a corner.
        let tilt = match round % 3 {
            0 => DQuat::IDENTITY,
            1 => DQuat::from_rotation_y(rng.random_range(0.01..0.7)),
            _ => DQuat::from_scaled_axis(0.6 * random(&mut rng)),
        };
        let rotation = DQuat::from_rotation_z(rng.random_range(-3.0..3.0)) * tilt;
        let lowest = corners.iter().map(|v| (rotation * *v).z).fold(f64::INFINITY, f64::min);
        let gap = [1e-6, 1e-7, 1e-5, -2e-7][round / 3 % 4];
        let shift = 0.03 * random(&mut rng).with_z(0.0);
        let probe = Pose::new(shift + DVec3::Z * (gap - lowest), rotation);
        let frames = Frames::new((&cube, &probe), (&plate, &object));
        let is_probe = round % 2 == 0;
        // Near a corner of the box, in both frames.
        let near = probe.transform_point(corners[rng.random_range(0..8)]) + 3e-3 * random(&mut rng);
        let own = if is_probe { &probe } else { &object };
        let home = own.inverse().transform_point(near.with_z(0.0));
        let mut point = new((home, rng.random_range(1e-4..1e-2)), is_probe, &frames);
        let found = point.measure(&frames, point.slack, f64::INFINITY);
        if found.distance > 1e-3 {
            continue;
        }
        let Measured { point: at, normal, distance, .. } = found;
        let over = |v: DVec3| normal.dot(v - at);
        let under = floor.iter().map(|v| over(object.transform_point(*v))).fold(f64::INFINITY, f64::min);
        // A slope that counts as level, along the plate.
        let level = 2e-3 * 0.15;
        assert!(under > distance - level, "round {round}: {found:?}, the plate {under} m");
        touching += 1;
        oblique += u32::from(normal.z > -0.99);
        let descent = point.descend(&frames, MAX_MOVES, f64::NEG_INFINITY);
        mere += u32::from(point.measured(&frames, &descent).normal.z > -0.99);
    }
    assert!(touching > 500 && oblique == 0, "{touching} touch, {oblique} across");
    assert!(mere > 50, "{mere} of {touching} mere directions are across");
}

/// A box that is pressed onto such a plate tilts by less than what counts as level. The plate, which goes on
/// beyond the box, has the normal all the same: a tenth of a degree pushes sideways by a six-hundredth.
#[test]
fn a_slight_tilt_does_not_push_sideways() {
    let mut rng = StdRng::seed_from_u64(0x60A5);
    let (floor, triangles) = tiled(DVec3::new(0.1, 0.1, 0.01), 17);
    let plate = FeatureMesh::new(&TriMesh::new(floor, triangles).expect("a mesh"));
    let cube = block(DVec3::new(0.02, 0.012, 0.008));
    let object = Pose::from_translation(DVec3::NEG_Z * 0.005);
    let (mut tilted, mut mere) = (0, 0);
    for round in 0..2000 {
        let slope = rng.random_range(3e-4..9e-4);
        let tilt = DQuat::from_rotation_y(slope);
        let rotation = DQuat::from_rotation_z(rng.random_range(-3.0..3.0)) * tilt;
        let gap = [1e-6, 1e-7, 1e-5][round % 3];
        let shift = 0.03 * random(&mut rng).with_z(0.0);
        let up = 0.004 * slope.cos() + 0.01 * slope.sin() + gap;
        let probe = Pose::new(shift + DVec3::Z * up, rotation);
        let frames = Frames::new((&cube, &probe), (&plate, &object));
        // Near the box's lower edge, on the plate.
        let beside = DVec3::new(0.01, rng.random_range(-6e-3..6e-3), -0.004) + 2e-3 * random(&mut rng);
        let home = object.inverse().transform_point(probe.transform_point(beside).with_z(0.0));
        let mut point = new((home, rng.random_range(1e-4..1e-2)), false, &frames);
        let found = point.measure(&frames, point.slack, f64::INFINITY);
        let descent = point.descend(&frames, MAX_MOVES, f64::NEG_INFINITY);
        let across = |normal: DVec3| normal.with_z(0.0).length();
        mere += u32::from(across(point.measured(&frames, &descent).normal) > 2e-4);
        tilted += u32::from(found.distance.is_finite() && across(found.normal) > 2e-4);
    }
    assert!(tilted == 0 && mere > 500, "{tilted} are tilted, {mere} mere directions");
}

/// A box that lies over the rim of a plate, along which it is tilted as slightly, is not pushed along that.
#[test]
fn a_rim_does_not_push_along_itself() {
    let mut rng = StdRng::seed_from_u64(0x60A8);
    let (plate, cube) = (block(DVec3::new(0.1, 0.1, 0.01)), block(DVec3::new(0.02, 0.012, 0.008)));
    // The rim is at x = 0, along y.
    let object = Pose::from_translation(DVec3::new(-0.05, 0.0, -0.005));
    let (mut held, mut along, mut mere) = (0, 0.0_f64, 0);
    for _ in 0..2000 {
        let slope: f64 = rng.random_range(3e-4..1.9e-3);
        let rotation = DQuat::from_rotation_x(if rng.random() { slope } else { -slope })
            * DQuat::from_rotation_z(rng.random_range(-0.3..0.3));
        let corner = DVec3::new(0.01, 0.006, 0.004);
        let sides = [DVec3::new(1.0, 1.0, -1.0), DVec3::new(1.0, -1.0, -1.0)];
        let height =
            |side: DVec3| (rotation * (corner * side)).z.min((rotation * (corner * side.with_x(-1.0))).z);
        let lowest = height(sides[0]).min(height(sides[1]));
        let probe = Pose::new(DVec3::new(rng.random_range(-6e-3..6e-3), 0.0, 1e-6 - lowest), rotation);
        let frames = Frames::new((&cube, &probe), (&plate, &object));
        let near = DVec3::new(0.0, rng.random_range(-5e-3..5e-3), 0.0);
        let home = object.inverse().transform_point(near);
        let mut point = new((home, 10.0_f64.powf(rng.random_range(-5.0..-2.5))), false, &frames);
        let found = point.measure_on(&frames, point.slack, f64::INFINITY);
        let descent = point.descend(&frames, MAX_MOVES, f64::NEG_INFINITY);
        mere += u32::from(point.measured(&frames, &descent).normal.y.abs() > 2e-4);
        if found.distance.is_finite() {
            held += 1;
            along = along.max(found.normal.y.abs());
        }
    }
    assert!(held > 500 && mere > 500 && along < 2e-4, "{held} are held, {along} along it, {mere} mere");
}

/// A box whose bottom bends up by a tenth lies on such a plate, a few nanometres deep: from the bend, the
/// nearest way out is through the part that rises. The plate's normal holds it, as the bottom lies on that.
#[test]
fn a_bottom_that_bends_up_is_held_by_the_floor_it_lies_on() {
    let mut rng = StdRng::seed_from_u64(0x60A6);
    let plate = block(DVec3::new(0.1, 0.1, 0.01));
    let object = Pose::from_translation(DVec3::NEG_Z * 0.005);
    let (vertices, triangles) = tiled(DVec3::new(0.016, 0.016, 0.008), 8);
    let bent = |v: &DVec3| *v + DVec3::Z * (0.004 + 0.1 * (v.y - 0.002).max(0.0));
    let bottom =
        FeatureMesh::new(&TriMesh::new(vertices.iter().map(bent).collect(), triangles).expect("a mesh"));
    let (mut held, mut across) = (0, 0.0_f64);
    for _ in 0..2000 {
        let tilt = DQuat::from_rotation_x(rng.random_range(-1.5e-3..1.5e-3));
        let bend = DVec3::new([-0.002, 0.0, 0.002][rng.random_range(0..3)], 0.002, 0.0);
        let depth = rng.random_range(-1e-8..1e-8);
        let rotation = DQuat::from_rotation_z(rng.random_range(-3.0..3.0)) * tilt;
        let shift = (0.02 * random(&mut rng)).with_z(depth);
        let probe = Pose::new(shift - rotation * bend, rotation);
        let frames = Frames::new((&bottom, &probe), (&plate, &object));
        let mut point = new((bend, 10.0_f64.powf(rng.random_range(-9.0..-6.0))), true, &frames);
        let found = point.measure_on(&frames, point.slack, f64::INFINITY);
        if found.distance.is_finite() {
            held += 1;
            across = across.max(found.normal.with_z(0.0).length());
        }
    }
    assert!(held > 1000 && across < 2e-3, "{held} are held, {across} across");
}

/// A box that leaves a wall which its top lies against, turned by next to nothing: the wall's end is beside
/// its sides by less than rounding. Along them nothing pushes.
#[test]
fn the_end_of_a_wall_does_not_hold_what_slides_along_it() {
    let mut rng = StdRng::seed_from_u64(0x60A7);
    let wall = block(DVec3::new(0.1, 0.1, 0.01));
    let object = Pose::from_translation(DVec3::new(0.0, -0.05, 0.005));
    // Its sides along x have many flat edges.
    let (vertices, triangles) = tiled(DVec3::new(0.01, 0.02, 0.006), 9);
    let turned = |v: &DVec3| DVec3::new(v.z, v.y, v.x);
    let triangles = triangles.into_iter().map(|[a, b, c]| [a, c, b]).collect();
    let mesh = TriMesh::new(vertices.iter().map(turned).collect(), triangles).expect("a mesh");
    let body = FeatureMesh::new(&mesh);
    let mut touching = 0;
    for _ in 0..4000 {
        let turn = DQuat::from_scaled_axis(10.0_f64.powf(rng.random_range(-9.0..-7.0)) * random(&mut rng));
        let along = rng.random_range(-8e-3..8e-3);
        let gap = [0.0, 1e-10, -1e-10, 1e-9][rng.random_range(0..4)];
        let probe = Pose::new(DVec3::new(0.0, along, -0.005 - gap), turn);
        let frames = Frames::new((&body, &probe), (&wall, &object));
        // Near the upper edge of a side, where the wall ends.
        let side = if rng.random() { 0.003 } else { -0.003 };
        let near = DVec3::new(side, -along, 0.005) + 1e-4 * random(&mut rng);
        let mut point = new((near, 10.0_f64.powf(rng.random_range(-5.0..-2.5))), true, &frames);
        let found = point.measure(&frames, point.slack, f64::INFINITY);
        if found.distance < 1e-6 {
            touching += 1;
            assert!(found.normal.x.abs() < 2e-3, "{found:?}");
        }
    }
    assert!(touching > 500, "{touching} touch");
}

/// A box whose corner or lower edge is beside a plate's edge, where the next tile goes on, by a part of the
/// distance at which surfaces are held apart. The plate's face has the normal, not the direction aslant.
#[test]
fn what_is_beside_an_edge_by_less_than_surfaces_are_apart_is_over_the_face() {
    let (cube, plate) = (block(DVec3::splat(0.02)), block(DVec3::new(0.1, 0.1, 0.01)));
    let object = Pose::from_translation(DVec3::new(-0.05, 0.0, -0.005));
    let apart = 1.2e-6;
    for yaw in [0.0, 0.4] {
        let rotation = DQuat::from_rotation_z(yaw);
        let corner = DVec3::new(-0.01, if yaw > 0.0 { 0.01 } else { -0.01 }, -0.01);
        for (beside, is_over) in [(1e-9, true), (3e-8, true), (9e-8, true), (6e-7, false), (3e-6, false)] {
            let at = DVec3::new(beside, 0.0, apart);
            let probe = Pose::new(at - rotation * corner, rotation);
            let frames = Frames::new((&cube, &probe), (&plate, &object));
            for (home, is_probe) in
                [(corner, true), (object.inverse().transform_point(at.with_x(0.0)), false)]
            {
                let mut point = new((home, 1e-3), is_probe, &frames);
                let found = point.measure_on(&frames, point.slack, f64::INFINITY);
                let case = format!("yaw {yaw}, {beside} m beside, {is_probe}: {found:?}");
                assert!((found.distance - DVec3::new(beside, 0.0, apart).length()).abs() < 1e-8, "{case}");
                let across = found.normal.x.abs();
                assert!(if is_over { across < 1e-9 } else { across > 0.1 }, "{case}");
            }
        }
    }
}

/// A box over a slot, turned by a sixth of a degree, whose lower edge would cross the rim beyond its end: it
/// is held across the rim, along which nothing pushes.
#[test]
fn edges_that_lie_nearly_along_each_other_are_held_across_the_scenes() {
    let (cube, rim) = (block(DVec3::splat(0.02)), block(DVec3::new(0.055, 0.02, 0.02)));
    // The rim is along x, up to x = 5 mm.
    let object = Pose::from_translation(DVec3::new(-0.0225, -0.01, -0.01));
    let turn = DQuat::from_rotation_z(-0.003);
    let lower = DVec3::new(4e-3, -0.01, -0.01);
    let mut aslant = 0;
    for (beside, up) in [(1e-5, 2e-6), (4e-5, 1e-5), (1e-5, 1e-5)] {
        let probe = Pose::new(DVec3::new(4e-3, beside, up) - turn * lower, turn);
        let frames = Frames::new((&cube, &probe), (&rim, &object));
        let mut point = new((lower, 2e-4), true, &frames);
        let found = point.measure_on(&frames, point.slack, f64::INFINITY);
        let case = format!("{beside} m beside, {up} m up: {found:?}");
        assert!(found.distance.is_finite() && found.normal.x.abs() < 1e-9, "{case}");
        aslant += u32::from(found.normal.y < -0.1);
    }
    assert!(aslant > 1, "{aslant} are aslant: the case shows little");
}

/// A point that has last tried short ways goes on to a corner where each of these is less than rounding.
#[test]
fn short_ways_do_not_end_beside_a_corner() {
    let (cube, plate) = (block(DVec3::splat(0.02)), block(DVec3::new(0.2, 0.2, 0.01)));
    let object = Pose::from_translation(DVec3::NEG_Z * 0.005);
    let rotation = DQuat::from_rotation_y(0.08) * DQuat::from_rotation_x(0.05);
    let corner = DVec3::new(0.01, -0.01, -0.01);
    let gap = 1e-6;
    let probe = Pose::new(DVec3::Z * (gap - (rotation * corner).z), rotation);
    let frames = Frames::new((&cube, &probe), (&plate, &object));
    for along in [DVec3::NEG_X, DVec3::Y] {
        for way in [1.5e-6, 2.5e-6, 1e-5, 1e-3] {
            let mut point = new((corner, 0.01), true, &frames);
            point.place = cube.place_near(corner + along * way);
            point.stride = FeatureMesh::MIN_STRIDE as f32;
            assert!(matches!(point.place, Place::Edge(..)), "{:?}", point.place);
            let found = point.measure_on(&frames, point.slack, f64::INFINITY);
            assert!((found.distance - gap).abs() < 1e-8, "{way} m from the corner: {found:?}");
        }
    }
}

/// Past a corner, the distance along an edge bends evenly: a point that has gone too far comes back to its
/// minimum, and not halfway there time and again.
#[test]
fn a_point_comes_to_rest_before_a_corner_in_few_moves() {
    const AWAY: f64 = 0.01;
    let (roof, cube) = (roof(), block(DVec3::splat(0.02)));
    let down = DQuat::from_rotation_arc(DVec3::ONE.normalize(), DVec3::NEG_Z);
    let corner = DVec3::new(0.011, 0.0, AWAY);
    let object = Pose::new(corner - down * DVec3::splat(0.01), down);
    let frames = Frames::new((&roof, &Pose::IDENTITY), (&cube, &object));
    for start in [-0.04, 0.0, 0.0105, 0.012, 0.03] {
        let mut point = new((DVec3::X * start, 0.2), true, &frames);
        for stride in [1.0, 0.25, FeatureMesh::MIN_STRIDE as f32] {
            (point.place, point.stride) = (roof.place_near(DVec3::X * start), stride);
            let Descent { closest, is_settled, .. } = point.descend(&frames, 16, f64::INFINITY);
            let away = closest.distance - AWAY;
            assert!(is_settled && away.abs() < 1e-8, "from {start} m by {stride}: {away} m too far");
        }
    }
}

/// A rod of 60 mm with one of its edges below, which goes down along x and passes a place, m: at `along`
/// from its middle. `down` is the sine of the angle, `around` an angle about the vertical; the rod is as wide
/// as it is high, times `width`. Returns it, its pose, and that place in its own frame.
fn aslant(place: DVec3, width: f64, (along, down, around): (f64, f64, f64)) -> (FeatureMesh, Pose, DVec3) {
    let mesh = test_meshes::block(DVec3::new(0.06, 4e-3, 4e-3));
    let roll = DQuat::from_rotation_x(std::f64::consts::FRAC_PI_4);
    let vertices =
        mesh.vertices().iter().map(|vertex| roll * *vertex * DVec3::new(1.0, width, 1.0)).collect();
    let rod = FeatureMesh::new(&TriMesh::new(vertices, mesh.triangles().to_vec()).expect("a rod"));
    let rotation = DQuat::from_rotation_z(around) * DQuat::from_rotation_y(down.asin());
    let own = DVec3::new(along, 0.0, -2e-3 * std::f64::consts::SQRT_2);
    (rod, Pose::new(place - rotation * own, rotation), own)
}

/// A point on an edge that goes on beyond its leash holds the edge where it is, unless that is steep: then a
/// point is nearer where it goes on.
#[test]
fn a_leash_holds_edges_that_are_not_steep() {
    const GAP: f64 = 1e-4;
    let (plate, object) = (block(DVec3::new(0.4, 0.4, 0.01)), Pose::from_translation(DVec3::NEG_Z * 0.005));
    for (slope, is_held) in
        [(0.05, true), (0.2, true), (0.29, true), (0.31, false), (0.5, false), (0.8, false)]
    {
        for around in [0.0, 0.4, 2.0] {
            let lower = DVec3::new(0.05, 0.03, GAP);
            let (rod, pose, own) = aslant(lower, 1.0, (0.03, slope, around));
            let frames = Frames::new((&rod, &pose), (&plate, &object));
            let mut point = new((own - DVec3::X * 0.03, 5e-3), true, &frames);
            let found = point.measure(&frames, point.slack, f64::INFINITY);
            let end = pose.transform_point(own - DVec3::X * 0.025);
            assert!(found.is_settled && found.point.distance(end) < 1e-7, "{slope}: {found:?}, not {end}");
            assert!((found.nearest - end.z).abs() < 1e-8, "{slope}: {found:?}, not {} m", end.z);
            assert_eq!(found.distance.is_finite(), is_held, "{slope}: {found:?}");
            if is_held {
                assert!((found.distance - end.z).abs() < 1e-8, "{slope}: {found:?}, not {} m", end.z);
                assert!(found.normal.distance(DVec3::NEG_Z) < 1e-9, "{slope}: {found:?}");
            }
            // On a leash that lets it go, it is at the corner.
            let mut point = new((own - DVec3::X * 0.03, 0.05), true, &frames);
            let found = point.measure(&frames, point.slack, f64::INFINITY);
            assert!((found.distance - GAP).abs() < 1e-9, "{slope}: {found:?}");
        }
    }
}

/// A point inside a flat part of a plate, below a face that comes nearer beyond its leash: a point is nearer
/// there, and this one does not push aslant of the plate. Where the face is level, it is held.
#[test]
fn a_leash_holds_no_flat_part_that_is_not_level() {
    const GAP: f64 = 2e-3;
    let (plate, cover) = (block(DVec3::new(0.4, 0.4, 0.01)), block(DVec3::new(0.3, 0.3, 0.01)));
    let object = Pose::from_translation(DVec3::NEG_Z * 0.005);
    for (slope, is_held) in [(0.0, true), (0.01, false), (0.06, false), (0.2, false)] {
        let rotation = DQuat::from_rotation_y(slope);
        // Over the middle of the plate, which is on a diagonal between its triangles.
        let pose = Pose::new(DVec3::Z * GAP - rotation * DVec3::NEG_Z * 0.005, rotation);
        let frames = Frames::new((&cover, &pose), (&plate, &object));
        let mut point = new((DVec3::Z * 0.005, 5e-3), false, &frames);
        let found = point.measure_on(&frames, point.slack, f64::INFINITY);
        assert_eq!(found.distance.is_finite(), is_held, "{slope}: {found:?}");
        let (most, least) = (GAP, GAP * slope.cos() - 5.1e-3 * slope);
        assert!(found.nearest < most + 1e-9 && found.nearest > least - 1e-9, "{slope}: {found:?}");
    }
}

/// An edge that comes nearer beyond the end of a plate is held across both edges, from either surface: it may
/// slide along itself, and along the plate's edge. Over a plate that goes on, it is held along its normal.
#[test]
fn edges_are_held_across_the_end_of_a_plate() {
    const GAP: f64 = 1e-4;
    let object = Pose::from_translation(DVec3::NEG_Z * 0.005);
    for (length, ends) in [(0.1, true), (0.2, false)] {
        let (vertices, triangles) = tiled(DVec3::new(length, 0.1, 0.01), 60);
        let facets = FeatureMesh::new(&TriMesh::new(vertices, triangles).expect("a mesh"));
        let plain = block(DVec3::new(length, 0.1, 0.01));
        for (slope, around) in [(0.02, 0.0), (0.1, 0.3), (0.25, -0.3), (0.25, 0.6)] {
            // 20 mm of the rod are beyond the plate's end.
            let place = DVec3::new(0.05, 2e-3, if ends { GAP } else { GAP + 0.02 * slope });
            let (rod, pose, own) = aslant(place, 0.2, (0.01, slope, around));
            let along = pose.transform_vector(DVec3::X);
            let across = if ends { along.cross(DVec3::Y).normalize() } else { DVec3::Z };
            let normal = -across * across.z.signum();
            for (is_probe, plate) in [(true, &plain), (false, &facets)] {
                let frames = Frames::new((&rod, &pose), (plate, &object));
                // 8 mm before the end.
                let beside = own - DVec3::X * 0.01;
                let home = if is_probe {
                    beside
                } else {
                    object.inverse().transform_point(pose.transform_point(beside).with_z(0.0))
                };
                let mut point = new((home, 2e-3), is_probe, &frames);
                let found = point.measure(&frames, point.slack, f64::INFINITY);
                let what = format!("{length} m, {slope}, {around}, {is_probe}: {found:?}, not {normal}");
                assert!(found.normal.distance(normal) < 1e-6, "{what}");
                let height = found.point.z;
                let wanted = if is_probe { height / -normal.z } else { height * -normal.z };
                assert!((found.distance - wanted).abs() < 1e-8, "{what}, {wanted} m");
            }
        }
    }
}

/// A point among thin walls of small faces is told to overlap only where it is inside of one, also if it goes
/// through walls. A mere walk from step to step is not: it takes the far sides of walls for overlaps.
#[test]
fn a_point_among_walls_overlaps_where_it_is_inside() {
    let mut rng = StdRng::seed_from_u64(0x60A4);
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for wall in 0..8 {
        let (own, faces) = tiled(DVec3::new(4e-3, 4e-3, 2e-4), 16);
        let first = vertices.len() as u32;
        vertices.extend(own.into_iter().map(|v| v + DVec3::Z * 5e-4 * (f64::from(wall) - 3.5)));
        triangles.extend(faces.into_iter().map(|face| face.map(|corner| corner + first)));
    }
    let walls = FeatureMesh::new(&TriMesh::new(vertices, triangles).expect("walls"));
    let size = 2e-6;
    let tip = block(DVec3::splat(size));
    let object = Pose::IDENTITY;
    let at = |center: DVec3| Pose::from_translation(center);
    let mut center = DVec3::Z * 2.5e-4;
    let mut point = new((DVec3::ZERO, 1e-3), true, &Frames::new((&tip, &at(center)), (&walls, &object)));
    let mut slack = point.slack;
    let (mut inside, mut outside, mut wrong) = (0, 0, 0);
    let mut walked = walls.nearest(center);
    for step in 0..20_000 {
        // Mostly by little, at times by more than a wall is thick.
        let length = [1e-6, 1e-5, 3e-5, 3e-4][rng.random_range(0..4)];
        let next = (center + length * random(&mut rng)).clamp(DVec3::splat(-1.9e-3), DVec3::splat(1.9e-3));
        slack -= next.distance(center) as f32;
        center = next;
        walked = walls.walk(center, walked.face);
        wrong += u32::from(walked.distance < 0.0 && walls.nearest(center).distance > 0.0);
        let pose = at(center);
        let frames = Frames::new((&tip, &pose), (&walls, &object));
        let found = point.measure(&frames, slack, 0.0);
        slack = found.distance as f32;
        point.slack = slack;
        let truth = walls.nearest(found.point).distance;
        if found.distance < 0.0 {
            // Another point of the tip may be the one inside.
            assert!(truth < 2.0 * size, "step {step}: {found:?}, but {truth} m");
            inside += 1;
        } else {
            outside += 1;
        }
    }
    assert!(inside > 500 && outside > 500, "{inside} inside, {outside} outside");
    assert!(wrong > 50, "mere walks are wrong {wrong} times");
}

/// A rod of many rings hangs aslant over a block: a point that starts at its upper end does not get to the
/// lower one in the moves of a query. It does not claim more than is known to be clear.
#[test]
fn a_descent_that_is_cut_short_claims_the_room_that_is_known() {
    let rod = |rings: u32| {
        let at = |ring: u32, i: u32| {
            let around = DQuat::from_rotation_x(std::f64::consts::FRAC_PI_4 * f64::from(i % 8)) * DVec3::Y;
            // Slightly bent, so that each ring is one of vertices to stop at.
            let along = f64::from(ring) / f64::from(rings);
            DVec3::new(0.1 * along, 0.0, -2e-3 * (along + 0.5 * (along - along * along))) + around * 0.002
        };
        let vertices = (0..=rings).flat_map(|ring| (0..8).map(move |i| at(ring, i))).collect();
        let index = |ring: u32, i: u32| 8 * ring + i % 8;
        let sides = (0..rings).flat_map(|ring| (0..8).map(move |i| (ring, i))).flat_map(|(ring, i)| {
            let [a, b] = [index(ring, i), index(ring, i + 1)];
            [[a, b, b + 8], [a, b + 8, a + 8]]
        });
        let last = 8 * rings;
        let ends = (1..7).flat_map(|i| [[0, i + 1, i], [last, last + i, last + i + 1]]);
        FeatureMesh::new(&TriMesh::new(vertices, sides.chain(ends).collect()).expect("a rod"))
    };
    let (ground, pose) = (block(DVec3::new(1.0, 1.0, 0.1)), Pose::from_translation(DVec3::NEG_Z * 0.1));
    for (rings, is_found) in [(40, true), (600, false)] {
        let rod = rod(rings);
        let frames = Frames::new((&rod, &Pose::IDENTITY), (&ground, &pose));
        let lowest = 0.05 - 2e-3 - 0.002;
        for least in [0.0, 0.03] {
            let place = Place::Vertex(6);
            let leash = Leash { home: rod.position(&place), length: 0.2 };
            let point = GuardedPoint::new((place, leash), 0, true, 0, (&frames, least));
            let (slack, least) = (f64::from(point.slack), f64::from(least));
            assert!(slack < lowest + 1e-6, "{rings} rings: {slack} m of {lowest} m claimed");
            assert_eq!(slack > lowest - 1e-4, is_found, "{rings} rings: {slack} m of {lowest} m claimed");
            assert!(is_found || slack == least, "{rings} rings: {slack} m claimed where {least} m are known");
        }
    }
}
