//! s: the surface deviation of a patch from the original mesh (§3.3.5), as a bound that holds for every point.
//!
//! The Hausdorff distance between a patch and the part of the original mesh that it stands for, each measured to the whole
//! surface of the other level: no point of the patch is further than s from the original mesh, and no point of the patches
//! that went into it further than s from the simplified mesh. The dissertation does not say how it is computed.
//!
//! The distance to one triangle is a convex function, so that over a triangle it is bounded by its values at the corners.
//! Hence a triangle is no further from a surface than the farthest of its corners from whichever triangle of the
//! surface suits all corners best; and, distances changing no faster than positions, no further than its corners plus its
//! own extent. Where this bound is not near enough to what the corners show, the triangle is divided (Tang, Lee, Kim
//! 2009). That ends within a set number of divisions, and whatever bound is then reached is a true one.

use glam::DVec3;
use rayon::prelude::*;

use crate::nearest::{distance_to_triangle, nearest_triangle};
use crate::surface::Surface;

/// A bound is near enough if it is above a deviation that is known to occur by no more than this part of it ...
const RELATIVE: f64 = 0.1;

/// ... plus this, in unit coordinates.
const ABSOLUTE: f64 = 2e-4;

/// Halvings of a triangle's sides at most.
const MOST_DIVISIONS: u32 = 7;

/// A bound on the deviation, and the largest deviation that is known to occur.
#[derive(Clone, Copy, Debug, Default)]
struct Range {
    known: f64,
    bound: f64,
}

#[derive(Clone, Copy)]
struct Corner {
    point: DVec3,
    nearest: u32,
    distance: f64,
}

fn corner(point: DVec3, target: &Surface) -> Corner {
    let (nearest, distance) = nearest_triangle(target, point);
    Corner { point, nearest, distance }
}

impl Range {
    /// Takes in how far the points of a triangle are from a surface.
    fn include(&mut self, corners: [Corner; 3], target: &Surface, stack: &mut Vec<([Corner; 3], u32)>) {
        stack.clear();
        stack.push((corners, 0));
        while let Some((corners, depth)) = stack.pop() {
            let farthest = corners.iter().map(|c| c.distance).fold(0.0, f64::max);
            self.known = self.known.max(farthest);
            let accepted = self.bound.max(self.known * (1.0 + RELATIVE) + ABSOLUTE);
            let [a, b, c] = corners.map(|c| c.point);
            // No point of a triangle is further than this from its nearest corner.
            let extent = a.distance(b).max(b.distance(c)).max(c.distance(a)) / 3f64.sqrt();
            let mut bound = farthest + extent;
            for k in 0..3 {
                if bound <= accepted {
                    break;
                }
                let one = target.corners(corners[k].nearest);
                bound =
                    bound.min(corners.iter().map(|c| distance_to_triangle(c.point, one)).fold(0.0, f64::max));
            }
            if bound <= accepted || depth == MOST_DIVISIONS {
                self.bound = self.bound.max(bound);
                continue;
            }
            let middle = |k: usize, l: usize| corner(0.5 * (corners[k].point + corners[l].point), target);
            let (ab, bc, ca) = (middle(0, 1), middle(1, 2), middle(2, 0));
            let [a, b, c] = corners;
            stack.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]].map(|t| (t, depth + 1)));
        }
    }
}

/// For groups of triangles of one surface, how far each is at most from another surface.
fn deviations(groups: &[Vec<u32>], from: &Surface, target: &Surface) -> Vec<f64> {
    let corners: Vec<Corner> = from.points.par_iter().map(|p| corner(*p, target)).collect();
    groups
        .par_iter()
        .map_init(Vec::new, |stack, group| {
            let mut range = Range::default();
            for t in group {
                let [a, b, c] = from.triangles[*t as usize].map(|v| corners[v as usize]);
                range.include([a, b, c], target, stack);
            }
            range.bound
        })
        .collect()
}

/// s of the patches of a level, in unit coordinates: `patches` are their triangles in the level's surface, `origins` the
/// triangles of the original surface that they stand for.
pub(crate) fn surface_deviations(
    original: &Surface,
    origins: &[Vec<u32>],
    level: &Surface,
    patches: &[Vec<u32>],
) -> Vec<f64> {
    let there = deviations(patches, level, original);
    let back = deviations(origins, original, level);
    there.iter().zip(&back).map(|(a, b)| a.max(*b)).collect()
}

#[cfg(test)]
mod tests {
    use palpate_models::Model;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn no_point_is_further_and_the_bound_is_near() {
        let seed = 95;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        let fine = Model::GolfBall.generate(6000).expect("within range");
        let coarse = Model::GolfBall.generate(1000).expect("within range");
        let sphere = fine.bounding_sphere();
        let [fine, coarse] = [fine, coarse].map(|m| Surface::new(&m, sphere.center, sphere.radius));
        for (from, to) in [(&fine, &coarse), (&coarse, &fine)] {
            let groups: Vec<Vec<u32>> =
                (0..from.triangles.len() as u32 / 50).map(|g| (50 * g..50 * g + 50).collect()).collect();
            let bounds = deviations(&groups, from, to);
            for (group, bound) in groups.iter().zip(bounds) {
                let mut farthest = 0.0f64;
                for _ in 0..1500 {
                    let [a, b, c] = from.corners(group[rng.random_range(0..group.len())]);
                    let (u, v): (f64, f64) = (rng.random(), rng.random());
                    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                    farthest = farthest.max(nearest_triangle(to, a + (b - a) * u + (c - a) * v).1);
                }
                assert!(farthest <= bound, "{farthest} {bound}");
                assert!(bound <= 1.3 * farthest + 2.0 * ABSOLUTE, "{farthest} {bound}");
            }
        }
    }
}
