//! Surface deviation s of a patch from the original mesh (§3.3.5), as a bound that holds for every point.
//!
//! It is the Hausdorff distance between a patch and the part of the original mesh that it represents, each
//! measured to the whole surface of the other level: no point of the patch is further than s from the
//! original mesh, and no point of the patches that were merged into it is further than s from the simplified
//! mesh. The dissertation does not say how it is computed.
//!
//! Two facts bound how far the points of a triangle are from a surface. The distance to one triangle of the
//! surface is a convex function, so that it is largest at a corner: no point is further from any one triangle
//! of the surface than the farthest corner. And distances change no faster than positions: no point is
//! further from the surface than the farthest corner is, plus the triangle's extent. Both hold for any convex
//! piece of a triangle, and with any point of it in place of the corners. Where the lower of these bounds is
//! not close enough to a deviation that is known to occur in the patch, the triangle is divided and its
//! pieces are bounded likewise (after Tang, Lee, Kim 2009). The number of divisions is limited, and the bound
//! reached then is still valid.
//!
//! The work is in finding nearest triangles: of all vertices, and of the middles of pieces. It stays small
//! because
//! - the deviations of all vertices, in both directions, are computed first: then most triangles need no
//!   division;
//! - a piece that is not much larger than the triangle nearest to its middle is cut along that triangle's
//!   sides, which leaves a part that one triangle bounds well. So the number of pieces is about the number of
//!   overlaps between triangles of the two surfaces, rather than the number needed to resolve their edges;
//! - each search starts from the triangle that the one before found: it then only has to be confirmed.

use glam::DVec3;
use rayon::prelude::*;

use crate::hull::Plane;
use crate::nearest::{NearestSearch, ROUNDING, distance_to_triangle};
use crate::surface::Surface;

/// Relative tolerance of a bound: the largest excess over a deviation that is known to occur, as a fraction
/// of it. A smaller one costs time; a larger one makes the hierarchy refine earlier than needed.
const RELATIVE_TOLERANCE: f64 = 0.1;

/// Absolute tolerance of a bound, added to the relative one, as a fraction of the level's sampling distance
/// 1/r (Eq. 3.1). A smaller one would not be felt: φ = s/r² (§3.4) measures a volume, with an area of the
/// square of that distance.
const ABSOLUTE_TOLERANCE: f64 = 0.01;

/// Largest number of divisions of a triangle. With fewer, bounds are looser.
const MAX_DIVISIONS: u32 = 20;

/// Largest ratio of a piece's radius to the longest side of the nearest triangle at which the piece is cut
/// along that triangle's sides; larger pieces are halved.
const MAX_CUT_RATIO: f64 = 2.0;

/// Distance by which these cuts are moved outwards, as a fraction of the distance that is possible in a plane
/// parallel to the triangle within the accepted bound.
const CUT_MARGIN: f64 = 0.3;

/// Smallest extent that a cut separates, as a fraction of the piece's radius.
const MIN_CUT: f64 = 0.05;

/// Number of triangles that are bounded in one batch, and of vertices whose nearest triangles are found in
/// one batch. The results of a batch do not depend on others, nor on the number of threads.
const BATCH: usize = 512;

/// A point, the triangle of the other surface that is nearest to it, and its distance.
#[derive(Clone, Copy, Default)]
struct Corner {
    point: DVec3,
    nearest: u32,
    distance: f64,
}

/// Surface deviation s of each patch of a level, in unit coordinates. `patches` are the patches' triangles in
/// the level's surface, `origins` the triangles of the original surface that they represent, near ones one
/// after the other as far as possible. `spacing` is the level's sampling distance 1/r.
pub(crate) fn surface_deviations(
    original: &Surface,
    origins: &[Vec<u32>],
    level: &Surface,
    patches: &[Vec<u32>],
    spacing: f64,
) -> Vec<f64> {
    let near_enough = ABSOLUTE_TOLERANCE * spacing;
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
            .flat_map(|(group, triangles)| triangles.chunks(BATCH).map(move |part| (group, part)))
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

/// The vertices of some triangles of one surface, each with the nearest triangle of another surface.
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
        .par_chunks(BATCH)
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

/// Largest distance of a vertex of some triangles from the other surface.
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
    /// Absolute tolerance of the bound.
    near_enough: f64,
    /// The bound for the triangles included so far.
    bound: f64,
    /// Convex pieces yet to be bounded.
    pieces: Vec<Piece>,
    /// Corners of the pieces, those of the last piece at the end.
    corners: Vec<DVec3>,
    piece: Vec<DVec3>,
    rest: Vec<DVec3>,
}

/// A piece of a triangle.
#[derive(Clone, Copy)]
struct Piece {
    /// Number of its corners.
    corners: usize,
    /// A triangle of the other surface that may be near.
    near: u32,
    /// Number of divisions that made it.
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

    /// Largest bound that is close enough to a known deviation.
    fn accepted(&self) -> f64 {
        self.bound.max(self.known * (1.0 + RELATIVE_TOLERANCE) + self.near_enough)
    }

    /// Raises the bound to include the points of a triangle.
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

    /// Largest distance of a corner of the current piece from a triangle of the other surface.
    fn farthest_from(&self, triangle: u32) -> f64 {
        let corners = self.search.surface().corners(triangle);
        self.piece.iter().map(|p| distance_to_triangle(*p, corners)).fold(0.0, f64::max)
    }

    /// Bounds the last piece, or replaces it by parts of it.
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
            // The first of those that are equally far but for rounding.
            if p.distance_squared(middle) > (1.0 + 1e-9) * far.distance_squared(middle) { p } else { far }
        });
        let radius = far_corner.distance(middle);
        let mut bound = distance + radius;
        if bound > accepted {
            bound = bound.min(self.farthest_from(nearest));
        }
        if bound <= accepted || divisions == MAX_DIVISIONS {
            self.bound = self.bound.max(bound);
            return;
        }
        if self.cut_along_sides(nearest, middle, radius, divisions) {
            // The rest of the piece lies over the triangle.
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

    /// Cuts the current piece along the sides of the triangle that is nearest to its middle, and makes pieces
    /// of the parts beyond them. Returns false if the piece is too large for this, or there is too little
    /// beyond the sides.
    fn cut_along_sides(&mut self, nearest: u32, middle: DVec3, radius: f64, divisions: u32) -> bool {
        let surface = self.search.surface();
        let normal = surface.planes[nearest as usize].normal;
        let [a, b, c] = surface.corners(nearest);
        let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a)).sqrt();
        if radius > MAX_CUT_RATIO * longest || normal == DVec3::ZERO {
            return false;
        }
        let height = self.piece.iter().map(|p| normal.dot(*p - a).abs()).fold(0.0, f64::max);
        let margin = CUT_MARGIN * (self.accepted().powi(2) - height * height).max(0.0).sqrt();
        let mut divided = false;
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let outward = (to - from).cross(normal).normalize_or_zero();
            let plane = Plane { normal: outward, offset: outward.dot(from) + margin };
            let beyond = self.piece.iter().map(|p| plane.height(*p)).fold(0.0, f64::max);
            // The middle stays, so that the parts are smaller by far.
            if plane.height(middle) < 0.0 && beyond > MIN_CUT * radius {
                self.cut_off(plane, nearest, divisions);
                divided = true;
            }
        }
        divided
    }

    /// Cuts off the part of the current piece above a plane as a piece of its own.
    fn cut_off(&mut self, plane: Plane, near: u32, divisions: u32) {
        self.rest.clear();
        let first = self.corners.len();
        for k in 0..self.piece.len() {
            let (p, q) = (self.piece[k], self.piece[(k + 1) % self.piece.len()]);
            let (hp, hq) = (plane.height(p), plane.height(q));
            // Points on the plane, but for rounding, belong to both parts.
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

    /// A plain reference: every triangle is divided at the middles of its sides until its farthest corner and
    /// its extent, or the triangle nearest to a corner, bound its deviation closely. Returns the largest
    /// deviation that occurs, and a bound.
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
            let near_enough = ABSOLUTE_TOLERANCE * spacing;
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
                assert!(bound <= (1.0 + RELATIVE_TOLERANCE) * most + near_enough + 1e-12, "{what}");
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
        assert!((0.125..=0.125 * (1.0 + RELATIVE_TOLERANCE)).contains(&bounds[0]), "{bounds:?}");
    }
}
