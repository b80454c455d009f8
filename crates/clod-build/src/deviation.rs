//! s: the surface deviation of a patch from the original mesh (§3.3.5), as a bound that holds for every point.
//!
//! The Hausdorff distance between a patch and the part of the original mesh that it stands for, each measured to the
//! whole surface of the other level: no point of the patch is further than s from the original mesh, and no point of
//! the patches that went into it further than s from the simplified mesh. The dissertation does not say how it is
//! computed.
//!
//! Two facts bound how far the points of a triangle are from a surface. The distance to one triangle of the surface is
//! a convex function, so that it is largest at a corner: whichever one triangle of the surface is taken, no point is
//! further than the farthest corner is from it. And distances change no faster than positions: no point is further than
//! the farthest corner is from the surface plus the triangle's extent. Both hold for any convex piece of a triangle and
//! any point of it in place of the corners. Where the lower of these bounds is not near enough to what is known to
//! occur in the patch, the triangle is divided and its pieces are bounded likewise (after Tang, Lee, Kim 2009). That
//! ends after a set number of divisions, and whatever bound is then reached is a true one.
//!
//! The work is in finding nearest triangles: of all vertices, and of the middles of pieces. It stays small because
//! - what occurs is learnt first, from all vertices in both directions: then most triangles need no division;
//! - a piece that is not much larger than the triangle nearest to its middle is cut along that triangle's sides, which
//!   leaves a part that one triangle bounds well; so there are about as many pieces as there are places where triangles
//!   of the two surfaces lie on each other, rather than as many as it takes to resolve their edges;
//! - each search starts from the triangle that the one before found: it then only has to be confirmed.

use glam::DVec3;
use rayon::prelude::*;

use crate::hull::Plane;
use crate::nearest::{NearestSearch, ROUNDING, distance_to_triangle};
use crate::surface::Surface;

/// A bound is near enough if it is above a deviation that is known to occur by no more than this part of it ...
const RELATIVE: f64 = 0.1;

/// ... plus this part of the level's sampling distance 1/r (Eq. 3.1). Less would not be felt: what φ = s/r² (§3.4)
/// measures is a volume over the square of that distance.
const ABSOLUTE: f64 = 0.01;

/// How often a triangle is divided at most.
const MOST_DIVISIONS: u32 = 20;

/// Pieces are halved while they are larger, from middle to corner, than the nearest triangle by this factor; then cut
/// along its sides ...
const HALVED_ABOVE: f64 = 2.0;

/// ... moved outwards by this part of how far a plane parallel to the triangle could be gone along within the accepted
/// bound ...
const MARGIN: f64 = 0.3;

/// ... where this much, as part of the size of the piece, is beyond.
const LEAST_CUT: f64 = 0.05;

/// Triangles that are bounded in one go, and vertices whose nearest triangles are found in one go. The results of a
/// part do not depend on others, nor then on the number of threads.
const PART: usize = 512;

/// A point, the triangle of the other surface that is nearest to it, and how far that is.
#[derive(Clone, Copy, Default)]
struct Corner {
    point: DVec3,
    nearest: u32,
    distance: f64,
}

/// s of the patches of a level, in unit coordinates: `patches` are their triangles in the level's surface, `origins` the
/// triangles of the original surface that they stand for, those near each other one after the other as far as possible.
/// `spacing` is the level's sampling distance 1/r.
pub(crate) fn surface_deviations(
    original: &Surface,
    origins: &[Vec<u32>],
    level: &Surface,
    patches: &[Vec<u32>],
    spacing: f64,
) -> Vec<f64> {
    let near_enough = ABSOLUTE * spacing;
    let there = corners(patches, level, original);
    let back = corners(origins, original, level);
    let known: Vec<f64> = patches
        .par_iter()
        .zip(origins)
        .map(|(patch, origins)| farthest(patch, level, &there).max(farthest(origins, original, &back)))
        .collect();
    let mut bounds = known.clone();
    for (groups, from, corners, target) in
        [(patches, level, &there, original), (origins, original, &back, level)]
    {
        let parts: Vec<(usize, &[u32])> = groups
            .iter()
            .enumerate()
            .flat_map(|(group, triangles)| triangles.chunks(PART).map(move |part| (group, part)))
            .collect();
        let found: Vec<f64> = parts
            .par_iter()
            .map_init(
                || Divider::new(target),
                |divider, (group, part)| {
                    divider.begin(known[*group], near_enough);
                    for t in *part {
                        divider.include(from.triangles[*t as usize].map(|v| corners[v as usize]));
                    }
                    divider.bound
                },
            )
            .collect();
        for ((group, _), bound) in parts.iter().zip(found) {
            bounds[*group] = bounds[*group].max(bound);
        }
    }
    bounds
}

/// For the vertices of triangles of one surface the nearest triangles of another.
fn corners(groups: &[Vec<u32>], from: &Surface, target: &Surface) -> Vec<Corner> {
    let mut corners = vec![Corner::default(); from.points.len()];
    let mut met = vec![false; from.points.len()];
    let order: Vec<u32> = groups
        .iter()
        .flatten()
        .flat_map(|t| from.triangles[*t as usize])
        .filter(|v| !std::mem::replace(&mut met[*v as usize], true))
        .collect();
    let found: Vec<Vec<Corner>> = order
        .par_chunks(PART)
        .map(|part| {
            let mut search = NearestSearch::new(target);
            let mut nearest = target.tree().order.first().copied().unwrap_or(0);
            let find = |v: &u32| {
                let point = from.points[*v as usize];
                let (found, distance) = search.nearest(point, nearest);
                nearest = found;
                Corner { point, nearest, distance }
            };
            part.iter().map(find).collect()
        })
        .collect();
    for (v, corner) in order.iter().zip(found.into_iter().flatten()) {
        corners[*v as usize] = corner;
    }
    corners
}

/// The distance of that vertex of some triangles which is farthest from the other surface.
fn farthest(triangles: &[u32], from: &Surface, corners: &[Corner]) -> f64 {
    triangles
        .iter()
        .flat_map(|t| from.triangles[*t as usize])
        .map(|v| corners[v as usize].distance)
        .fold(0.0, f64::max)
}

/// Bounds the deviation of part of a patch.
struct Divider<'a> {
    search: NearestSearch<'a>,
    /// The largest deviation of the patch that is known to occur.
    known: f64,
    /// How far above `known` the bound may be besides a part of it.
    near_enough: f64,
    /// The bound on what has been taken in.
    bound: f64,
    /// Convex pieces yet to be bounded.
    pieces: Vec<Piece>,
    /// Their corners, those of the last at the end.
    corners: Vec<DVec3>,
    piece: Vec<DVec3>,
    rest: Vec<DVec3>,
}

/// A piece of a triangle.
#[derive(Clone, Copy)]
struct Piece {
    /// How many corners it has.
    corners: usize,
    /// A triangle of the other surface that may be near.
    near: u32,
    /// How many divisions it has come from.
    divisions: u32,
}

impl<'a> Divider<'a> {
    fn new(target: &'a Surface) -> Self {
        Self {
            search: NearestSearch::new(target),
            known: 0.0,
            near_enough: 0.0,
            bound: 0.0,
            pieces: Vec::new(),
            corners: Vec::new(),
            piece: Vec::new(),
            rest: Vec::new(),
        }
    }

    /// Begins a part of a patch.
    fn begin(&mut self, known: f64, near_enough: f64) {
        (self.known, self.near_enough, self.bound) = (known, near_enough, 0.0);
    }

    /// No bound up to this matters.
    fn accepted(&self) -> f64 {
        self.bound.max(self.known * (1.0 + RELATIVE) + self.near_enough)
    }

    /// Takes in how far the points of a triangle are from the other surface.
    fn include(&mut self, corners: [Corner; 3]) {
        let [a, b, c] = corners;
        let farthest = a.distance.max(b.distance).max(c.distance);
        if a.nearest == b.nearest && b.nearest == c.nearest {
            self.bound = self.bound.max(farthest);
            return;
        }
        // No point of a triangle is further than this from its nearest corner.
        let longest = a.point.distance(b.point).max(b.point.distance(c.point)).max(c.point.distance(a.point));
        let bound = farthest + longest / 3f64.sqrt();
        if bound <= self.accepted() {
            self.bound = self.bound.max(bound);
            return;
        }
        self.corners.extend(corners.map(|c| c.point));
        self.pieces.push(Piece { corners: 3, near: a.nearest, divisions: 0 });
        while let Some(piece) = self.pieces.pop() {
            self.bound_or_divide(piece);
        }
    }

    /// How far a corner of the piece at hand is from a triangle of the other surface at most.
    fn farthest_from(&self, triangle: u32) -> f64 {
        let corners = self.search.surface().corners(triangle);
        self.piece.iter().map(|p| distance_to_triangle(*p, corners)).fold(0.0, f64::max)
    }

    /// Bounds the last piece, or puts parts of it in its place.
    fn bound_or_divide(&mut self, Piece { corners, near, divisions }: Piece) {
        let first = self.corners.len() - corners;
        self.piece.clear();
        self.piece.extend_from_slice(&self.corners[first..]);
        self.corners.truncate(first);
        let middle = self.piece.iter().sum::<DVec3>() / corners as f64;
        let (nearest, distance) = self.search.nearest(middle, near);
        self.known = self.known.max(distance);
        let accepted = self.accepted();
        let far_corner = self.piece.iter().copied().fold(middle, |far, p| {
            // Of those equally far but for rounding, the first.
            if p.distance_squared(middle) > (1.0 + 1e-9) * far.distance_squared(middle) { p } else { far }
        });
        let radius = far_corner.distance(middle);
        let mut bound = distance + radius;
        if bound > accepted {
            bound = bound.min(self.farthest_from(nearest));
        }
        if bound <= accepted || divisions == MOST_DIVISIONS {
            self.bound = self.bound.max(bound);
            return;
        }
        if self.cut_along_sides(nearest, middle, radius, divisions) {
            // What is left lies over the triangle.
            let bound = self.farthest_from(nearest);
            if bound <= accepted {
                self.bound = self.bound.max(bound);
                return;
            }
        } else {
            let along = (far_corner - middle).normalize_or_zero();
            self.cut_off(Plane { normal: along, offset: along.dot(middle) }, nearest, divisions);
        }
        self.pieces.push(Piece { corners: self.piece.len(), near: nearest, divisions: divisions + 1 });
        self.corners.extend_from_slice(&self.piece);
    }

    /// Makes pieces of what the piece at hand has beyond the sides of the triangle that is nearest to its middle. Tells
    /// whether it had anything worth while there, and is not too large for this to be useful.
    fn cut_along_sides(&mut self, nearest: u32, middle: DVec3, radius: f64, divisions: u32) -> bool {
        let surface = self.search.surface();
        let normal = surface.planes[nearest as usize].normal;
        let [a, b, c] = surface.corners(nearest);
        let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a)).sqrt();
        if radius > HALVED_ABOVE * longest || normal == DVec3::ZERO {
            return false;
        }
        let height = self.piece.iter().map(|p| normal.dot(*p - a).abs()).fold(0.0, f64::max);
        let margin = MARGIN * (self.accepted().powi(2) - height * height).max(0.0).sqrt();
        let mut divided = false;
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let outward = (to - from).cross(normal).normalize_or_zero();
            let plane = Plane { normal: outward, offset: outward.dot(from) + margin };
            let beyond = self.piece.iter().map(|p| plane.height(*p)).fold(0.0, f64::max);
            // The middle stays, so that the parts are smaller by far.
            if plane.height(middle) < 0.0 && beyond > LEAST_CUT * radius {
                self.cut_off(plane, nearest, divisions);
                divided = true;
            }
        }
        divided
    }

    /// Makes a piece of its own of what the piece at hand has above a plane.
    fn cut_off(&mut self, plane: Plane, near: u32, divisions: u32) {
        self.rest.clear();
        let first = self.corners.len();
        for k in 0..self.piece.len() {
            let (p, q) = (self.piece[k], self.piece[(k + 1) % self.piece.len()]);
            let (hp, hq) = (plane.height(p), plane.height(q));
            // What is on the plane, but for rounding, is of both.
            if hp <= ROUNDING {
                self.rest.push(p);
            }
            if hp >= -ROUNDING {
                self.corners.push(p);
            }
            if hp.min(hq) < -ROUNDING && hp.max(hq) > ROUNDING {
                let cut = p + (q - p) * (hp / (hp - hq));
                self.rest.push(cut);
                self.corners.push(cut);
            }
        }
        self.pieces.push(Piece { corners: self.corners.len() - first, near, divisions: divisions + 1 });
        std::mem::swap(&mut self.piece, &mut self.rest);
    }
}

#[cfg(test)]
mod tests {
    use palpate_models::Model;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// The plain way: every triangle is divided at the middles of its sides until the farthest of its corners and its
    /// extent tell its deviation, or the triangle nearest to one of them does. Gives the largest that occurs, and a
    /// bound.
    fn plain_deviation(group: &[u32], from: &Surface, target: &Surface, near_enough: f64) -> (f64, f64) {
        let mut search = NearestSearch::new(target);
        let (mut known, mut bound) = (0.0f64, 0.0f64);
        let mut stack: Vec<[DVec3; 3]> = group.iter().map(|t| from.corners(*t)).collect();
        while let Some([a, b, c]) = stack.pop() {
            let found = [a, b, c].map(|p| search.nearest(p, 0));
            let farthest = found.iter().map(|f| f.1).fold(0.0, f64::max);
            known = known.max(farthest);
            let extent = a.distance(b).max(b.distance(c)).max(c.distance(a));
            let on_one = found.map(|(t, _)| {
                let one = target.corners(t);
                [a, b, c].iter().map(|p| distance_to_triangle(*p, one)).fold(0.0, f64::max)
            });
            let above = on_one.iter().copied().fold(farthest + extent, f64::min);
            if above <= known + near_enough {
                bound = bound.max(above);
            } else {
                let (ab, bc, ca) = (0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a));
                stack.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
            }
        }
        (known, bound)
    }

    /// Two surfaces, the coarse one's triangles in groups and the fine one's that are nearest to them.
    fn two_levels(
        fine: (Model, usize),
        coarse: (Model, usize),
    ) -> (Surface, Vec<Vec<u32>>, Surface, Vec<Vec<u32>>) {
        let [fine, coarse] =
            [fine, coarse].map(|(model, triangles)| model.generate(triangles).expect("within range"));
        let sphere = fine.bounding_sphere();
        let [fine, coarse] = [fine, coarse].map(|m| Surface::new(&m, sphere.center, sphere.radius));
        let group = 30;
        let patches: Vec<Vec<u32>> = coarse.tree().order.chunks(group).map(<[u32]>::to_vec).collect();
        let mut place = vec![0; coarse.triangles.len()];
        for (k, patch) in patches.iter().enumerate() {
            patch.iter().for_each(|t| place[*t as usize] = k);
        }
        let mut origins = vec![Vec::new(); patches.len()];
        let mut search = NearestSearch::new(&coarse);
        for t in 0..fine.triangles.len() as u32 {
            let middle = fine.corners(t).iter().sum::<DVec3>() / 3.0;
            origins[place[search.nearest(middle, 0).0 as usize]].push(t);
        }
        (fine, origins, coarse, patches)
    }

    #[test]
    fn no_point_is_further_and_the_bound_is_near() {
        let seed = 95;
        println!("seed {seed}");
        let mut rng = StdRng::seed_from_u64(seed);
        for (fine, coarse) in [
            ((Model::GolfBall, 6000), (Model::GolfBall, 1000)),
            ((Model::GolfBall, 3000), (Model::GolfBall, 2500)),
            ((Model::LowerJaw, 6000), (Model::LowerJaw, 3000)),
            ((Model::GolfBall, 4000), (Model::Torus, 400)),
        ] {
            let (original, origins, level, patches) = two_levels(fine, coarse);
            let spacing = 0.05;
            let near_enough = ABSOLUTE * spacing;
            let bounds = surface_deviations(&original, &origins, &level, &patches, spacing);
            assert_eq!(bounds.len(), patches.len());
            for (k, bound) in bounds.into_iter().enumerate() {
                let mut sampled = 0.0f64;
                let (mut known, mut most) = (0.0f64, 0.0f64);
                for (group, from, to) in [(&patches[k], &level, &original), (&origins[k], &original, &level)]
                {
                    let mut search = NearestSearch::new(to);
                    for _ in 0..if group.is_empty() { 0 } else { 500 } {
                        let [a, b, c] = from.corners(group[rng.random_range(0..group.len())]);
                        let (u, v): (f64, f64) = (rng.random(), rng.random());
                        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                        sampled = sampled.max(search.nearest(a + (b - a) * u + (c - a) * v, 0).1);
                    }
                    let plain = plain_deviation(group, from, to, near_enough);
                    (known, most) = (known.max(plain.0), most.max(plain.1));
                }
                let what = format!("{fine:?}, patch {k}: {sampled} {known} {most}, bound {bound}");
                assert!(sampled <= bound + 1e-12 && known <= bound + 1e-12, "{what}");
                assert!(bound <= (1.0 + RELATIVE) * most + near_enough + 1e-12, "{what}");
            }
        }
    }

    #[test]
    fn a_surface_does_not_deviate_from_itself() {
        let mesh = Model::LowerJaw.generate(3000).expect("within range");
        let sphere = mesh.bounding_sphere();
        let surface = Surface::new(&mesh, sphere.center, sphere.radius);
        let groups: Vec<Vec<u32>> = surface.tree().order.chunks(40).map(<[u32]>::to_vec).collect();
        let bounds = surface_deviations(&surface, &groups, &surface, &groups, 0.0);
        assert!(bounds.iter().all(|s| *s <= 1e-12), "{bounds:?}");
    }

    #[test]
    fn a_shifted_plate_deviates_by_the_shift() {
        // Two squares of different triangles, one above the other by an eighth.
        let square = |n: u32, z: f64| {
            let at = |k: u32| f64::from(k) / f64::from(n) - 0.5;
            let points = (0..=n).flat_map(|y| (0..=n).map(move |x| DVec3::new(at(x), at(y), z))).collect();
            let triangles = (0..n * n)
                .flat_map(|k| {
                    let v = k / n * (n + 1) + k % n;
                    [[v, v + 1, v + n + 1], [v + 1, v + n + 2, v + n + 1]]
                })
                .collect();
            Surface::from_parts(points, triangles, 1.0, DVec3::ZERO)
        };
        let (fine, coarse) = (square(40, 0.0), square(3, 0.125));
        let all = |surface: &Surface| vec![(0..surface.triangles.len() as u32).collect::<Vec<u32>>()];
        let bounds = surface_deviations(&fine, &all(&fine), &coarse, &all(&coarse), 0.0);
        assert!((0.125..=0.125 * (1.0 + RELATIVE)).contains(&bounds[0]), "{bounds:?}");
    }
}
