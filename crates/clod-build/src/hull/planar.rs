//! The hull of points in a plane: Andrew's monotone chain, exact turns.

use glam::{DVec2, DVec3};
use robust::{Coord, orient2d};

/// Projection of a point on the two axes in which a plane of this normal is least foreshortened.
fn flatten(normal: DVec3, p: DVec3) -> DVec2 {
    let size = normal.abs();
    if size.x >= size.y && size.x >= size.z {
        DVec2::new(p.y, p.z)
    } else if size.y >= size.z {
        DVec2::new(p.z, p.x)
    } else {
        DVec2::new(p.x, p.y)
    }
}

/// The corners of the convex polygon around points that lie in a plane of the given normal, in order around
/// it. Points on its sides are left out. With fewer than three corners the points lie on a line.
pub(crate) fn polygon(points: &[DVec3], normal: DVec3) -> Vec<u32> {
    let flat: Vec<DVec2> = points.iter().map(|p| flatten(normal, *p)).collect();
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_unstable_by(|a, b| {
        let (p, q) = (flat[*a as usize], flat[*b as usize]);
        p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(a.cmp(b))
    });
    order.dedup_by(|a, b| flat[*a as usize] == flat[*b as usize]);
    let turns_left = |a: u32, b: u32, c: u32| {
        let [a, b, c] = [a, b, c].map(|v| Coord { x: flat[v as usize].x, y: flat[v as usize].y });
        orient2d(a, b, c) > 0.0
    };
    let half = |chain: &mut Vec<u32>, order: &mut dyn Iterator<Item = &u32>| {
        let base = chain.len();
        for &v in order {
            while let [.., a, b] = chain[base..] {
                if turns_left(a, b, v) {
                    break;
                }
                chain.pop();
            }
            chain.push(v);
        }
        chain.pop();
    };
    let mut chain = Vec::with_capacity(order.len() + 1);
    half(&mut chain, &mut order.iter());
    half(&mut chain, &mut order.iter().rev());
    chain
}
