use glam::{DMat3, DVec3};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use super::{Hull, HullBuilder, Shape, elevation, hull_faces};

const THICKNESS: f64 = 1e-13;

fn hull(points: &[DVec3]) -> Hull {
    HullBuilder::default().hull(points, THICKNESS)
}

fn random(rng: &mut StdRng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
}

fn random_rotation(rng: &mut StdRng) -> DMat3 {
    let q = glam::DQuat::from_xyzw(
        rng.random_range(-1.0..1.0),
        rng.random_range(-1.0..1.0),
        rng.random_range(-1.0..1.0),
        rng.random_range(0.1..1.0),
    );
    DMat3::from_quat(q.normalize())
}

/// A point is extreme if some plane through it and two others has all the rest strictly below it, or (for a
/// triangle with others in its plane) if it is a corner there. Tested plainly in O(n⁴), for points in general
/// position.
fn extreme_by_brute_force(points: &[DVec3]) -> Vec<u32> {
    let n = points.len();
    let mut extreme = vec![false; n];
    for a in 0..n {
        for b in 0..n {
            for c in 0..n {
                if a == b || b == c || c == a {
                    continue;
                }
                let below = (0..n)
                    .filter(|d| ![a, b, c].contains(d))
                    .all(|d| elevation(points[a], points[b], points[c], points[d]) < 0.0);
                if below {
                    (extreme[a], extreme[b], extreme[c]) = (true, true, true);
                }
            }
        }
    }
    (0..n as u32).filter(|v| extreme[*v as usize]).collect()
}

/// Checks (for points of about unit size) that the faces form a closed surface of genus 0, that all points
/// lie below them, and that the extreme points alone have the same hull.
fn check(points: &[DVec3], hull: &Hull, tolerance: f64) {
    assert_eq!(hull.shape, Shape::Polytope);
    let mut sides = std::collections::HashMap::new();
    for face in &hull.faces {
        for k in 0..3 {
            let fresh = sides.insert((face[k], face[(k + 1) % 3]), ()).is_none();
            assert!(fresh, "side {} to {} is there twice", face[k], face[(k + 1) % 3]);
        }
        let [a, b, c] = face.map(|v| points[v as usize]);
        // Three points may span a face although only exact arithmetic shows that they are not on a line.
        let area = (b - a).cross(c - a).length().max(1e-3);
        for (v, p) in points.iter().enumerate() {
            let above = elevation(a, b, c, *p);
            assert!(above <= tolerance * area, "point {v} is {:e} above {face:?}", above / area);
        }
    }
    assert!(sides.keys().all(|(a, b)| sides.contains_key(&(*b, *a))), "the faces do not close");
    let mut used: Vec<u32> = hull.faces.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    assert_eq!(used.len() + hull.faces.len(), sides.len() / 2 + 2, "not a sphere");

    let extreme: Vec<DVec3> = hull.extreme.iter().map(|v| points[*v as usize]).collect();
    let again = self::hull(&extreme);
    for face in &again.faces {
        let [a, b, c] = face.map(|v| extreme[v as usize]);
        let area = (b - a).cross(c - a).length().max(1e-3);
        for (v, p) in points.iter().enumerate() {
            let above = elevation(a, b, c, *p);
            assert!(
                above <= 2.0 * tolerance * area,
                "point {v} is {:e} outside of the extreme points",
                above / area
            );
        }
    }
}

#[test]
fn random_points_agree_with_brute_force() {
    let seed = 7;
    println!("seed {seed}");
    let mut rng = StdRng::seed_from_u64(seed);
    for round in 0..300 {
        let points: Vec<DVec3> = (0..4 + round % 12).map(|_| random(&mut rng)).collect();
        let hull = hull(&points);
        check(&points, &hull, THICKNESS);
        assert_eq!(hull.extreme, extreme_by_brute_force(&points), "round {round}");
    }
}

#[test]
fn integer_points_with_many_coincidences() {
    let seed = 8;
    println!("seed {seed}");
    let mut rng = StdRng::seed_from_u64(seed);
    for round in 0..2000 {
        let side = 1 + round % 4;
        let points: Vec<DVec3> = (0..4 + round % 60)
            .map(|_| DVec3::from_array(std::array::from_fn(|_| f64::from(rng.random_range(-side..=side)))))
            .collect();
        let hull = hull(&points);
        if hull.shape == Shape::Polytope {
            check(&points, &hull, THICKNESS);
            // Every extreme point is the only one that is farthest in some direction: it is not in the hull
            // of the rest.
            for v in &hull.extreme {
                let p = points[*v as usize];
                let rest: Vec<DVec3> = points.iter().copied().filter(|q| *q != p).collect();
                let rest_hull = self::hull(&rest);
                if rest_hull.shape == Shape::Polytope {
                    let outside = rest_hull.faces.iter().any(|f| {
                        let [a, b, c] = f.map(|v| rest[v as usize]);
                        elevation(a, b, c, p) > 0.0
                    });
                    assert!(outside, "round {round}: {p} is not extreme");
                }
            }
        }
    }
}

#[test]
fn grid_on_a_cube_has_eight_extreme_points() {
    let mut points = Vec::new();
    for k in 0..11 * 11 * 11 {
        let p = DVec3::new(f64::from(k % 11), f64::from(k / 11 % 11), f64::from(k / 121)) / 10.0;
        if p.to_array().iter().any(|x| *x == 0.0 || *x == 1.0) {
            points.push(p);
        }
    }
    let exact = hull(&points);
    assert_eq!(exact.extreme.len(), 8);
    check(&points, &exact, THICKNESS);

    // Turned, the facets are flat up to rounding only.
    let mut rng = StdRng::seed_from_u64(9);
    for _ in 0..50 {
        let turn = random_rotation(&mut rng);
        let turned: Vec<DVec3> = points.iter().map(|p| turn * *p).collect();
        let hull = hull(&turned);
        check(&turned, &hull, 2.0 * THICKNESS);
        // Corners that were reached late leave an earlier point behind that rounding holds just outside of a
        // facet.
        assert!(exact.extreme.iter().all(|v| hull.extreme.contains(v)), "{:?}", hull.extreme);
        assert!(hull.extreme.len() <= 32, "{:?}", hull.extreme);
    }
}

#[test]
fn noise_on_flat_facets_keeps_the_hull_closed() {
    let mut rng = StdRng::seed_from_u64(10);
    println!("seed 10");
    for exponent in 6..17 {
        let noise = 10f64.powi(-exponent);
        let turn = random_rotation(&mut rng);
        let points: Vec<DVec3> = (0..600)
            .map(|k| {
                let mut p = random(&mut rng);
                p[k % 3] = if k % 2 == 0 { 1.0 } else { -1.0 } + noise * rng.random_range(-1.0..1.0);
                turn * p
            })
            .collect();
        let hull = hull(&points);
        check(&points, &hull, 2.0 * THICKNESS);
    }
}

/// Points in a plane whose rounding makes a hull that is just thick enough: the planes of its faces hardly
/// distinguish points outside its rim. These are from a ball that is cut flat.
#[test]
fn corners_of_a_hull_of_rounding_remain() {
    let corner = [0.23399916396238246, -0.1707113225680762, -0.5327635324997839];
    let points = [
        [0.2233003077627732, -0.18924228508867738, -0.5199891634007607],
        [0.2269268582656352, -0.18296091536149783, -0.5155537787509339],
        [0.2304786170149717, -0.17680908875143972, -0.5201274658786057],
        corner,
        [0.2336936661834138, -0.1712404602428467, -0.5413512857482341],
    ]
    .map(DVec3::from_array);
    let hull = HullBuilder::default().hull(&points, 1e-14);
    assert!(hull.extreme.contains(&3), "{hull:?}");

    let seed = 13;
    println!("seed {seed}");
    let mut rng = StdRng::seed_from_u64(seed);
    for round in 0..3000 {
        let turn = random_rotation(&mut rng);
        let noise = THICKNESS * 2f64.powi(round % 8 - 3);
        let corners: Vec<DVec3> = (0..4 + round % 9)
            .map(|_| {
                let angle = rng.random_range(0.0..std::f64::consts::TAU);
                turn * DVec3::new(angle.cos(), angle.sin(), 0.9) + noise * random(&mut rng)
            })
            .collect();
        let hull = self::hull(&corners);
        assert_eq!(hull.extreme.len(), corners.len(), "round {round}: {hull:?}");
    }
}

#[test]
fn sphere_keeps_every_point() {
    let mut rng = StdRng::seed_from_u64(11);
    let points: Vec<DVec3> = (0..5000).map(|_| random(&mut rng).normalize()).collect();
    let hull = hull(&points);
    assert!(hull.extreme.len() > 4990, "{}", hull.extreme.len());
    assert_eq!(hull.faces.len(), 2 * hull.extreme.len() - 4);
}

#[test]
fn flat_sets() {
    let p = DVec3::new(0.3, -0.2, 0.9);
    assert_eq!(hull(&[p]).shape, Shape::Point);
    assert_eq!(hull(&[p, p, p, p, p]), Hull { shape: Shape::Point, extreme: vec![0], faces: vec![] });
    let line: Vec<DVec3> =
        [3.0, -1.0, 0.0, 4.0, 4.0, 2.0].iter().map(|t| p + *t * DVec3::new(0.1, 0.2, 0.3)).collect();
    let segment = hull(&line);
    assert_eq!((segment.shape, &segment.extreme[..1]), (Shape::Segment, &[1][..]));
    let mut rng = StdRng::seed_from_u64(12);
    for _ in 0..100 {
        let turn = random_rotation(&mut rng);
        let square: Vec<DVec3> = (0..121)
            .map(|k| turn * DVec3::new(f64::from(k % 11) / 10.0, f64::from(k / 11) / 10.0, 0.0))
            .collect();
        let hull = hull(&square);
        assert_eq!(hull.shape, Shape::Polygon);
        for corner in [0, 10, 110, 120] {
            assert!(hull.extreme.contains(&corner), "{:?}", hull.extreme);
        }
    }
}

#[test]
fn faces_to_draw_enclose_solids_and_show_both_sides_of_polygons() {
    let cube: Vec<DVec3> =
        (0..8).map(|k| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2))).collect();
    let volume: f64 = hull_faces(&cube)
        .iter()
        .map(|face| {
            let [a, b, c] = face.map(|v| cube[v as usize]);
            a.dot(b.cross(c)) / 6.0
        })
        .sum();
    assert!((volume - 1.0).abs() < 1e-12, "{volume}");
    let area = |faces: &[[u32; 3]]| -> DVec3 {
        let doubled = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| cube[v as usize]);
            (b - a).cross(c - a)
        };
        0.5 * faces.iter().map(doubled).sum::<DVec3>()
    };
    let square = hull_faces(&cube[..4]);
    assert_eq!((square.len(), area(&square)), (4, DVec3::ZERO));
    assert_eq!(area(&[square[0], square[2]]).length(), 1.0);
    for few in 0..3 {
        assert!(hull_faces(&cube[..few]).is_empty());
    }
}
