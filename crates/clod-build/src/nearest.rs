//! The nearest point of triangles and of surfaces.

use glam::DVec3;

use crate::surface::Surface;

/// The point of a triangle that is nearest to a point (Ericson 2005, §5.1.5); triangles without area too.
pub(crate) fn nearest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    if va > 0.0 && vb > 0.0 && vc > 0.0 {
        let sum = va + vb + vc;
        let inner = a + ab * (vb / sum) + ac * (vc / sum);
        // In a sliver rounding may take any side for the inside.
        if sum > 1e-8 * ab.length_squared() * ac.length_squared() && inner.is_finite() {
            return inner;
        }
    }
    let on_side = |from: DVec3, to: DVec3| {
        let along = to - from;
        let t = along.dot(p - from) / along.length_squared();
        from + along * if t.is_finite() { t.clamp(0.0, 1.0) } else { 0.0 }
    };
    [on_side(a, b), on_side(b, c), on_side(c, a)]
        .into_iter()
        .min_by(|x, y| x.distance_squared(p).total_cmp(&y.distance_squared(p)))
        .unwrap_or(a)
}

/// How far a point is from a triangle.
pub(crate) fn distance_to_triangle(p: DVec3, corners: [DVec3; 3]) -> f64 {
    p.distance(nearest_on_triangle(p, corners))
}

/// The triangle of a surface that is nearest to a point, and how far it is; of those equally near, the first found.
pub(crate) fn nearest_triangle(surface: &Surface, p: DVec3) -> (u32, f64) {
    let tree = surface.tree();
    let squared_to = |index: u32| {
        let node = &tree.nodes[index as usize];
        p.clamp(node.low, node.high.max(node.low)).distance_squared(p)
    };
    let mut best = (0, f64::INFINITY);
    let mut stack = vec![(0u32, 0.0)];
    while let Some((index, squared)) = stack.pop() {
        if squared >= best.1 {
            continue;
        }
        let node = &tree.nodes[index as usize];
        if node.count > 0 {
            for &t in tree.items(node) {
                let [a, b, c] = surface.triangles[t as usize];
                if a == b && b == c {
                    continue;
                }
                let squared = nearest_on_triangle(p, surface.corners(t)).distance_squared(p);
                if squared < best.1 {
                    best = (t, squared);
                }
            }
        } else {
            let children = [index + 1, node.first].map(|c| (c, squared_to(c)));
            let [near, far] =
                if children[0].1 <= children[1].1 { children } else { [children[1], children[0]] };
            stack.extend([far, near]);
        }
    }
    (best.0, best.1.sqrt())
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn nearest_points_against_a_grid() {
        let seed = 81;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        for round in 0..300 {
            let mut random = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let (p, a, b) = (2.0 * random(), random(), random());
            // Some on a line, some a point.
            let c = [random(), a + 0.3 * (b - a), a][round % 3];
            let b = if round % 9 == 2 { a } else { b };
            let found = distance_to_triangle(p, [a, b, c]);
            let n = 60;
            let mut least = f64::INFINITY;
            for i in 0..=n {
                for j in 0..=n - i {
                    let (u, v) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                    least = least.min(p.distance(a + (b - a) * u + (c - a) * v));
                }
            }
            assert!(found <= least + 1e-12 && found >= least - 0.05, "round {round}: {found} {least}");
        }
    }

    #[test]
    fn nearest_triangle_agrees_with_trying_all() {
        let seed = 82;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        let mesh = palpate_models::Model::Torus.generate(1000).expect("within range");
        let sphere = mesh.bounding_sphere();
        let surface = Surface::new(&mesh, sphere.center, sphere.radius);
        for _ in 0..200 {
            let p = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let all = (0..surface.triangles.len() as u32)
                .map(|t| distance_to_triangle(p, surface.corners(t)))
                .fold(f64::INFINITY, f64::min);
            let (t, distance) = nearest_triangle(&surface, p);
            assert_eq!(distance, all);
            assert_eq!(distance_to_triangle(p, surface.corners(t)), all);
        }
    }
}
