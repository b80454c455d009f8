//! Walks against the search of all triangles, and descents against all vertices.

use glam::DQuat;
use palpate_core::TriMesh;
use palpate_models::Model;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::*;

fn random(rng: &mut StdRng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
}

/// A box with these edges, m, about the origin.
fn block(edges: DVec3) -> TriMesh {
    let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from((i >> 1) & 1), f64::from(i >> 2)) - 0.5;
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    TriMesh::new((0..8).map(|i| corner(i) * edges).collect(), triangles).expect("a mesh")
}

/// The least distance of a point from the triangles that meet at a place on the surface.
fn around(mesh: &TriMesh, place: DVec3, p: DVec3) -> f64 {
    let meets = |face: usize| nearest_on_triangle(place, &mesh.corners(face)).0.distance(place) < 1e-12;
    let touching = (0..mesh.triangles().len()).filter(|&face| meets(face));
    touching
        .map(|other| nearest_on_triangle(p, &mesh.corners(other)).0.distance(p))
        .fold(f64::INFINITY, f64::min)
}

/// A point near the surface of a mesh, within a share of its bounding radius.
fn near(mesh: &TriMesh, share: f64, rng: &mut StdRng) -> DVec3 {
    let [a, b, c] = mesh.corners(rng.random_range(0..mesh.triangles().len()));
    let (u, v) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
    a + (b - a) * u + (c - a) * v + random(rng) * share * mesh.bounding_sphere().radius
}

/// From a neighbour of the nearest face a walk ends at the nearest point, except at concave edges: there it
/// may end over a face beside it, which is a local minimum of the distance.
#[test]
fn walks_end_at_the_nearest_point() {
    let mut rng = StdRng::seed_from_u64(0xFEA7);
    for (model, convex) in [
        (Model::Ellipsoid, true),
        (Model::Block, true),
        (Model::Torus, false),
        (Model::Cup, false),
        (Model::Gear, false),
    ] {
        let mesh = model.generate(3000).expect("in range");
        let radius = mesh.bounding_sphere().radius;
        let (features, exact) = (FeatureMesh::new(&mesh), ExactDistance::new(&mesh));
        let (mut other, mut inside, rounds) = (0, 0, 1500);
        for round in 0..rounds {
            let p = near(&mesh, 0.01, &mut rng);
            let wanted = exact.nearest(p, 0);
            let corner = mesh.triangles()[wanted.triangle as usize][round % 3];
            let start = features.faces_around.of(corner)[0];
            let found = features.walk(p, start);
            let own = features.nearest(p);
            let close = |a: f64, b: f64| (a - b).abs() < 1e-12 * radius;
            assert!(close(own.distance, wanted.distance), "{model:?}, round {round}: {own:?}, {wanted:?}");
            assert!(
                found.distance.abs() > wanted.distance.abs() - 1e-12 * radius,
                "{model:?}, round {round}"
            );
            assert!(close(found.point.distance(p), found.distance.abs()), "{model:?}, round {round}");
            inside += u32::from(wanted.distance < 0.0);
            if close(found.distance, wanted.distance) {
                continue;
            }
            other += 1;
            let least = around(&mesh, found.point, p);
            assert!(close(found.distance.abs(), least), "{model:?}, round {round}: {found:?} is no minimum");
            assert!(!convex || wanted.distance < 0.0, "{model:?}, round {round}: {found:?}, {wanted:?}");
        }
        assert!((300..1200).contains(&inside), "{model:?}: {inside} inside");
        assert!(other * 300 < rounds, "{model:?}: {other} of {rounds} walks end elsewhere");
    }
}

/// The foot of a point on an edge is where a walk ends, for all that end outside of one, and for no others.
#[test]
fn points_over_edges_have_their_foot_where_walks_end() {
    let mut rng = StdRng::seed_from_u64(0xFEB8);
    for model in [Model::Ellipsoid, Model::Block, Model::Gear] {
        let mesh = model.generate(3000).expect("in range");
        let features = FeatureMesh::new(&mesh);
        let mut over = 0;
        for round in 0..6000 {
            let p = near(&mesh, 0.2, &mut rng);
            let wanted = features.nearest(p);
            for edge in features.edges_of(wanted.face) {
                let is_it = wanted.feature == MeshFeature::Edge(edge) && wanted.distance > 0.0;
                let found = features.over_edge(p, edge, wanted.face);
                // A point may be over edges of both ends of a notch; one is nearer.
                let found = found.filter(|found| is_it || found.distance <= wanted.distance);
                assert_eq!(found.is_some(), is_it, "{model:?}, round {round}: {wanted:?}, {found:?}");
                let Some(found) = found else { continue };
                over += 1;
                assert!(found.point.distance(wanted.point) < 1e-12, "{model:?}: {found:?}, {wanted:?}");
                assert!(found.normal.distance(wanted.normal) < 1e-9, "{model:?}: {found:?}, {wanted:?}");
                assert_eq!((found.feature, found.face), (wanted.feature, wanted.face), "{model:?}");
            }
        }
        assert!(over > 100, "{model:?}: {over} over edges");
    }
}

/// The place of an edge nearest to a line is no further from it than others, inside of the edge and a leash.
#[test]
fn places_nearest_to_a_line_are_nearer_than_others() {
    let mesh = block(DVec3::splat(2.0));
    let features = FeatureMesh::new(&mesh);
    let mut rng = StdRng::seed_from_u64(0xFEB9);
    let (mut inside, mut leashed) = (0, 0);
    for round in 0..500 {
        let edge = rng.random_range(0..features.edges.len() as u32);
        let [from, to] = features.ends(edge);
        let line = [random(&mut rng) * 2.0, random(&mut rng) * 2.0];
        let along = (line[1] - line[0]).normalize();
        let apart = |at: f64| (from.lerp(to, at) - line[0]).cross(along).length();
        let least = (0..=1000).map(|i| apart(f64::from(i) / 1000.0)).fold(f64::INFINITY, f64::min);
        let leash = |home: DVec3, length: f32| Leash { home, length };
        let Some(place) = features.place_nearest(edge, line, &leash(from, 9.0)) else {
            assert!(least > apart(0.0).min(apart(1.0)) - 1e-9, "round {round}: {least} inside");
            continue;
        };
        inside += 1;
        let Place::Edge(own, at) = place else { panic!("{place:?}") };
        assert!(own == edge && apart(at.into()) < least + 1e-9, "round {round}: {place:?}, {least}");
        let short = 0.5 * from.distance(to) as f32;
        let held = features.place_nearest(edge, line, &leash(from, short)).is_some();
        assert_eq!(held, leash(from, short).holds(features.position(&place)), "round {round}");
        leashed += u32::from(!held);
    }
    assert!(inside > 50 && leashed > 10, "{inside} inside, {leashed} of them beyond the leash");
    let [from, to] = features.ends(0);
    let beside = [from, to].map(|end| end + DVec3::ONE);
    let far = Leash { home: from, length: 9.0 };
    assert_eq!(features.place_nearest(0, beside, &far), None, "edges along each other");
}

/// A walk over more small faces than it may visit ends at the nearest point, too.
#[test]
fn long_walks_end_at_the_nearest_point() {
    let mut rng = StdRng::seed_from_u64(0xFEAE);
    let mesh = Model::Ellipsoid.generate(20_000).expect("in range");
    let radius = mesh.bounding_sphere().radius;
    let (features, exact) = (FeatureMesh::new(&mesh), ExactDistance::new(&mesh));
    let mut far = 0;
    for round in 0..2000 {
        let p = near(&mesh, 1.0, &mut rng);
        let wanted = exact.nearest(p, 0);
        let start = rng.random_range(0..mesh.triangles().len());
        if wanted.distance <= 0.0 || features.faces[start].normal.dot(p - mesh.corners(start)[0]) <= 0.0 {
            continue;
        }
        far += u32::from(mesh.corners(start)[0].distance(wanted.point) > 0.6 * radius);
        let found = features.walk(p, start as u32);
        assert!((found.distance - wanted.distance).abs() < 1e-12 * radius, "round {round}: {found:?}");
    }
    assert!(far > 20, "{far} walks are long");
}

/// Only what is nearer than asked is found, and it is the nearest.
#[test]
fn searches_of_a_ball_agree_with_those_of_all() {
    let mut rng = StdRng::seed_from_u64(0xFEAF);
    let mesh = Model::Gear.generate(3000).expect("in range");
    let features = FeatureMesh::new(&mesh);
    let mut none = 0;
    for round in 0..2000 {
        let p = near(&mesh, 0.02, &mut rng);
        let wanted = features.nearest(p);
        let within = wanted.distance.abs() * rng.random_range(0.5..2.0);
        match features.nearer(p, within) {
            Some(found) => assert_eq!(found.distance, wanted.distance, "round {round}"),
            None => none += 1,
        }
        assert_eq!(features.nearer(p, within).is_some(), within > wanted.distance.abs(), "round {round}");
    }
    assert!((200..1800).contains(&none), "{none} of nothing");
}

/// Directions beside a box's features: their normals do not rise, and others by their slope.
#[test]
fn directions_rise_outside_of_the_normals_of_features() {
    let mesh = block(DVec3::splat(2.0));
    let features = FeatureMesh::new(&mesh);
    let mut rng = StdRng::seed_from_u64(0xFEB0);
    let mut outside = 0;
    for round in 0..3000 {
        let p = DVec3::new(rng.random_range(-1.5..1.5), rng.random_range(-1.5..1.5), 1.2);
        let found = features.nearest(p);
        // The direction from the nearest point is a normal of what that is on, by definition.
        assert!(features.rise(found.feature, found.normal) < 1e-9, "round {round}: {found:?}");
        let other = random(&mut rng).normalize();
        // The steepest way along the box's faces at the point.
        let inside =
            |axis: DVec3| if found.point.dot(axis) < 1.0 - 1e-12 { other.dot(axis) } else { f64::MIN };
        let ways = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z].map(inside);
        let steepest = ways.into_iter().fold(f64::MIN, f64::max);
        let rise = features.rise(found.feature, other);
        assert_eq!(rise > 1e-6, steepest > 1e-6, "round {round}: {found:?}, {other}");
        outside += u32::from(rise > 1e-6);
    }
    assert!(outside > 1000, "{outside} directions are outside");
    // The diagonal of a face has its normal alone.
    let flat = (0..features.edges.len() as u32).filter(|edge| !features.is_sharp(*edge));
    for edge in flat {
        let normal = features.faces[features.sides[edge as usize][0] as usize].normal;
        let lean = DQuat::from_axis_angle(normal.any_orthonormal_vector(), 0.1) * normal;
        assert!(features.rise(MeshFeature::Edge(edge), normal) < 1e-12);
        assert!(features.rise(MeshFeature::Edge(edge), lean) > 0.05);
    }
}

/// A point outside of a convex body is found from any face that faces it.
#[test]
fn walks_over_a_convex_body_start_anywhere_in_view() {
    let mut rng = StdRng::seed_from_u64(0xFEA8);
    for mesh in [Model::Ellipsoid.generate(500).expect("in range"), block(DVec3::new(0.1, 0.05, 0.02))] {
        let radius = mesh.bounding_sphere().radius;
        let (features, exact) = (FeatureMesh::new(&mesh), ExactDistance::new(&mesh));
        let mut walks = 0;
        for round in 0..8000 {
            let p = near(&mesh, 0.5, &mut rng);
            let wanted = exact.nearest(p, 0).distance;
            let start = rng.random_range(0..mesh.triangles().len());
            let normal = features.faces[start].normal;
            if wanted <= 0.0 || normal.dot(p - mesh.corners(start)[0]) <= 0.0 {
                continue;
            }
            walks += 1;
            let found = features.walk(p, start as u32);
            assert!((found.distance - wanted).abs() < 1e-12 * radius, "round {round}: {found:?}, {wanted}");
            let gradient = (p - found.point) / wanted;
            assert!(found.normal.distance(gradient) < 1e-6, "round {round}: {found:?}, {gradient}");
        }
        assert!(walks > 400, "{walks} walks");
    }
}

#[test]
fn distances_from_faces_edges_and_vertices_of_a_box() {
    let mesh = block(DVec3::splat(2.0));
    let features = FeatureMesh::new(&mesh);
    let third = 1.0 / 3.0_f64.sqrt();
    for (p, distance, normal) in [
        (DVec3::new(0.3, 0.1, 1.5), 0.5, DVec3::Z),
        (DVec3::new(0.3, 0.1, 0.9), -0.1, DVec3::Z),
        (DVec3::new(0.3, 0.1, 1.0), 0.0, DVec3::Z),
        (DVec3::new(0.3, -1.3, 1.4), 0.5, DVec3::new(0.0, -0.6, 0.8)),
        (DVec3::new(0.3, -1.0, 1.0), 0.0, DVec3::new(0.0, -1.0, 1.0).normalize()),
        (DVec3::new(2.0, -2.0, 2.0), 3.0_f64.sqrt(), DVec3::new(third, -third, third)),
        (DVec3::new(1.0, -1.0, 1.0), 0.0, DVec3::new(third, -third, third)),
    ] {
        let found = features.nearest(p);
        assert!((found.distance - distance).abs() < 1e-12, "{p}: {found:?}");
        assert!(found.normal.distance(normal) < 1e-12, "{p}: {found:?}, not {normal}");
    }
    // Inside, near an edge, the nearer face is found from each that meets there.
    for face in 0..12 {
        if features.corners(face).iter().any(|corner| corner.y < 0.0 && corner.z > 0.0) {
            let found = features.walk(DVec3::new(0.3, -0.9, 0.99), face);
            assert!((found.distance + 0.01).abs() < 1e-12, "from {face}: {found:?}");
        }
    }
    // On both sides of an edge, the sign does not depend on the face at which a walk starts.
    for face in 0..12 {
        let found = features.walk(DVec3::new(0.3, -0.99, 0.99), face);
        assert!(found.distance < 0.0, "from {face}: {found:?}");
        let found = features.walk(DVec3::new(0.3, -1.01, 1.01), face);
        assert!(found.distance > 0.0, "from {face}: {found:?}");
    }
}

#[test]
fn open_meshes_have_the_sign_of_the_nearest_side() {
    let vertices = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]| DVec3::new(x, y, 0.0));
    let mesh = TriMesh::new(vertices.to_vec(), vec![[0, 1, 2], [0, 2, 3]]).expect("a sheet");
    let (features, exact) = (FeatureMesh::new(&mesh), ExactDistance::new(&mesh));
    let mut rng = StdRng::seed_from_u64(0xFEA9);
    for round in 0..500 {
        let p = random(&mut rng) * 2.0;
        for face in [0, 1] {
            let (found, wanted) = (features.walk(p, face), exact.nearest(p, 0).distance);
            assert!(
                (found.distance.abs() - wanted.abs()).abs() < 1e-12,
                "round {round}: {found:?}, {wanted}"
            );
            assert_eq!(found.distance < 0.0, p.z < 0.0, "round {round}: {found:?}");
        }
    }
    // A single triangle, and three that share an edge, have no neighbours to walk to, or one too many.
    let sheet = TriMesh::new(vertices.to_vec(), vec![[0, 1, 2]]).expect("a triangle");
    assert_eq!(FeatureMesh::new(&sheet).nearest(DVec3::new(0.5, 0.25, 0.5)).distance, 0.5);
    let mut fan = vertices.to_vec();
    fan.push(DVec3::new(0.5, 0.5, 1.0));
    let fan = TriMesh::new(fan, vec![[0, 1, 2], [2, 0, 3], [0, 2, 4]]).expect("a fan");
    let features = FeatureMesh::new(&fan);
    for round in 0..500 {
        let p = random(&mut rng) * 2.0;
        let found = features.walk(p, round % 3);
        assert!(found.distance.is_finite() && found.normal.is_finite(), "round {round}: {found:?}");
    }
}

/// Ends of a descent towards a plane below, as guarded points make it. `leash` limits it.
fn descend(features: &FeatureMesh, mut place: Place, up: DVec3, leash: &Leash) -> (Place, u32) {
    let (mut stride, mut tries) = (1.0, 0);
    while let Some(next) = features.descend(&place, up, stride, leash) {
        tries += 1;
        assert!(tries < 10_000, "{place:?} moves for ever");
        let fell = up.dot(features.position(&place) - features.position(&next));
        if fell > 1e-9 {
            (place, stride) = (next, 1.0);
        } else if stride < 1e-3 {
            break;
        } else {
            stride *= 0.25;
        }
    }
    (place, tries)
}

const FREE: Leash = Leash { home: DVec3::ZERO, length: 1e3 };

#[test]
fn descents_over_convex_bodies_end_at_the_lowest_vertex() {
    let mut rng = StdRng::seed_from_u64(0xFEAA);
    for mesh in [Model::Ellipsoid.generate(500).expect("in range"), block(DVec3::new(0.1, 0.05, 0.02))] {
        let features = FeatureMesh::new(&mesh);
        let radius = mesh.bounding_sphere().radius;
        for round in 0..300 {
            let up = random(&mut rng).normalize();
            let from = features.place_near(near(&mesh, 0.0, &mut rng));
            let (place, _) = descend(&features, from, up, &FREE);
            let lowest = mesh.vertices().iter().map(|v| up.dot(*v)).fold(f64::INFINITY, f64::min);
            let found = up.dot(features.position(&place));
            // Slopes below a thousandth count as level.
            assert!(found - lowest < 2e-3 * radius, "round {round}: {place:?} is {} m up", found - lowest);
        }
    }
}

/// A place on an edge is the lowest if no point of the two faces beside it is lower, and only then.
#[test]
fn places_on_edges_are_lowest_where_both_faces_rise() {
    let mut rng = StdRng::seed_from_u64(0xFEAD);
    for mesh in [Model::Cup.generate(2000).expect("in range"), block(DVec3::new(0.1, 0.05, 0.02))] {
        let features = FeatureMesh::new(&mesh);
        let (mut rising, mut falling) = (0, 0);
        for round in 0..3000 {
            let edge = rng.random_range(0..features.edges.len()) as u32;
            let place = Place::Edge(edge, rng.random_range(0.1..0.9));
            let position = features.position(&place);
            // Between the faces' normals, so that both may rise.
            let [a, b] = features.sides[edge as usize].map(|face| features.faces[face as usize].normal);
            let up = -(a * rng.random_range(-0.2..1.0) + b * rng.random_range(-0.2..1.0)).normalize();
            // Points along the faces' edges lie in all directions over both faces.
            let around = features.sides[edge as usize].iter().flat_map(|face| {
                let corners = mesh.corners(*face as usize);
                (0..150).map(move |i| corners[i / 50].lerp(corners[(i / 50 + 1) % 3], (i % 50) as f64 / 50.0))
            });
            let slopes = around.map(|point| up.dot(point - position) / point.distance(position));
            let least = slopes.fold(f64::INFINITY, f64::min);
            let is_lowest = features.is_lowest(&place, up, 1.0, &FREE);
            assert_eq!(is_lowest, features.descend(&place, up, 1.0, &FREE).is_none(), "round {round}");
            // Slopes near the smallest that counts may go either way.
            if least < -2.0 * MIN_SLOPE {
                assert!(!is_lowest, "round {round}: {place:?}, {up}, {least}");
                falling += 1;
            } else if least > -0.5 * MIN_SLOPE {
                assert!(is_lowest, "round {round}: {place:?}, {up}, {least}");
                rising += 1;
            }
        }
        assert!(rising > 100 && falling > 100, "{rising} rise, {falling} fall");
    }
}

#[test]
fn descents_stay_on_their_leash() {
    let mut rng = StdRng::seed_from_u64(0xFEAB);
    let mut limited = 0;
    for model in [Model::Ellipsoid, Model::Torus, Model::Cup] {
        let mesh = model.generate(2000).expect("in range");
        let (features, radius) = (FeatureMesh::new(&mesh), mesh.bounding_sphere().radius);
        for round in 0..300 {
            let up = random(&mut rng).normalize();
            let home = near(&mesh, 0.0, &mut rng);
            let from = features.place_near(home);
            // A place may start outside of a short leash, and is not moved further out then.
            let length = (radius * 10_f64.powf(rng.random_range(-3.0..0.0))) as f32;
            let leash = Leash { home, length };
            let most = f64::from(length).max(features.position(&from).distance(home)) + 1e-6 * radius;
            let (place, _) = descend(&features, from, up, &leash);
            let away = features.position(&place).distance(home);
            assert!(away <= most, "{model:?}, round {round}: {away} m from home, not {most}");
            let free = descend(&features, from, up, &FREE).0;
            limited += u32::from(features.position(&free).distance(home) > most);
        }
    }
    assert!(limited > 300, "{limited} leashes are needed");
}

/// A place some millionths of an edge from its end goes on to that, though its stride is shorter than a step.
#[test]
fn a_descent_with_a_short_stride_gets_to_a_vertex() {
    let mesh = block(DVec3::new(0.1, 0.05, 0.02));
    let features = FeatureMesh::new(&mesh);
    let up = DVec3::new(0.3, 0.4, 0.866).normalize();
    for edge in 0..features.edges.len() as u32 {
        let [from, to] = features.ends(edge);
        for share in [1.3e-6, 1.8e-6, 2e-6, 1e-5, 5e-5, 1e-4] {
            // The end that is lower, of edges that are not level.
            let rise = up.dot(to - from) / from.distance(to);
            if rise.abs() < 0.01 {
                continue;
            }
            let place = Place::Edge(edge, (if rise > 0.0 { share } else { 1.0 - share }) as f32);
            let next = features.descend(&place, up, FeatureMesh::MIN_STRIDE, &FREE);
            assert!(!features.is_lowest(&place, up, FeatureMesh::MIN_STRIDE, &FREE));
            let fell = next.map(|next| up.dot(features.position(&place) - features.position(&next)));
            assert!(fell.is_some_and(|fell| fell > 0.0), "edge {edge}, {share}: {next:?}, {fell:?}");
        }
    }
}

/// A leash of half an edge from its middle ends at both of its vertices. From one of them down is along the
/// edge, though it is steeper along another one, on which the leash leaves nothing, or little.
#[test]
fn a_descent_goes_on_where_its_leash_does() {
    let features = FeatureMesh::new(&block(DVec3::new(0.1, 0.05, 0.02)));
    let corner = DVec3::new(-0.05, -0.025, -0.01);
    for (steep, spare) in [(0.9, 0.0), (0.9, 1e-6), (0.99, 1e-6)] {
        for length in [0.05_f32.next_down(), 0.05, 0.05 + spare] {
            let leash = Leash { home: corner.with_x(0.0), length };
            let up = -DVec3::new((1.0_f64 - steep * steep).sqrt(), 0.0, steep);
            let (place, _) = descend(&features, features.place_near(corner), up, &leash);
            let found = features.position(&place);
            // No further up than the other vertex.
            assert!(up.dot(found - corner.with_x(0.05)) < 1e-6, "{steep}, {length}: {found}");
        }
    }
}

#[test]
fn a_turned_mesh_descends_alike() {
    // Neither rounding nor the order of triangles decides where a descent ends.
    let mesh = Model::Ellipsoid.generate(500).expect("in range");
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, 0.8, -1.1);
    let turned = TriMesh::new(
        mesh.vertices().iter().map(|v| turn * *v).collect(),
        mesh.triangles().iter().rev().copied().collect(),
    )
    .expect("a mesh");
    let (first, second) = (FeatureMesh::new(&mesh), FeatureMesh::new(&turned));
    let mut rng = StdRng::seed_from_u64(0xFEAC);
    for round in 0..100 {
        let (up, from) = (random(&mut rng).normalize(), rng.random_range(0..mesh.vertices().len()) as u32);
        let end = |features: &FeatureMesh, up: DVec3| {
            up.dot(features.position(&descend(features, Place::Vertex(from), up, &FREE).0))
        };
        let (a, b) = (end(&first, up), end(&second, turn * up));
        assert!((a - b).abs() < 2e-3 * mesh.bounding_sphere().radius, "round {round}: {a}, {b}");
    }
}

/// A leash that joins two reaches wherever either does, and is no longer than from end to end.
#[test]
fn joined_leashes_cover_both() {
    let mut rng = StdRng::seed_from_u64(0x1EA5);
    let mut inside = 0;
    for _ in 0..2000 {
        let [a, b] = [0, 1].map(|_| Leash { home: random(&mut rng), length: rng.random_range(0.0..2.0) });
        let joined = a.joined(&b);
        let away = a.home.distance(b.home);
        let ends = f64::from(a.length) + f64::from(b.length) + away;
        let most = f64::from(a.length.max(b.length)).max(0.5 * ends);
        assert!(f64::from(joined.length) <= most + 1e-6, "{a:?}, {b:?}: {joined:?}");
        for leash in [a, b] {
            let towards = (leash.home - joined.home).normalize_or(DVec3::X);
            let far = leash.home + towards * f64::from(leash.length);
            let beyond = far.distance(joined.home) - f64::from(joined.length);
            assert!(beyond < 1e-6, "{a:?}, {b:?}: {joined:?}, {beyond} m beyond");
        }
        let is_inside = a.covers(&b) || b.covers(&a);
        assert_eq!(is_inside, joined.length == a.length.max(b.length), "{a:?}, {b:?}: {joined:?}");
        inside += u32::from(is_inside);
    }
    assert!((200..1800).contains(&inside), "{inside} are inside another");
}

/// The distance from a box's edges is that by formula, also from a triangle that has a mere corner on one of
/// them. The diagonals of its faces do not count.
#[test]
fn sharp_edges_are_found_around_corners() {
    let half = 0.5 * DVec3::new(0.04, 0.02, 0.06);
    let mesh = block(2.0 * half);
    let features = FeatureMesh::new(&mesh);
    let mut rng = StdRng::seed_from_u64(0x54A2);
    for _ in 0..500 {
        let mut p = random(&mut rng) * half;
        let axis = rng.random_range(0..3);
        p[axis] = half[axis] * p[axis].signum();
        let face = features.face_near(p, 0);
        let found = features.to_sharp_edge(face, p, 0.5);
        let beside = [(axis + 1) % 3, (axis + 2) % 3].map(|other| half[other] - p[other].abs());
        assert!((found - beside[0].min(beside[1])).abs() < 1e-12, "{p}: {found} m");
        assert_eq!(features.to_sharp_edge(face, p, 1.1), f64::INFINITY);
    }
}
