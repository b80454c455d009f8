//! Support mapping: the extreme point of a hull in a direction.
//!
//! Small hulls are scanned. Larger ones have a [`SupportMap`]: the sphere of directions as a cube, whose
//! faces are quadtrees of square cells, finer where the hull is round, each with the few points that can be
//! extreme in it. Unlike hill climbing this needs no hull faces, which a hierarchy does not store, cannot get
//! stuck on coplanar points, and takes no longer if the direction has changed much.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use palpate_core::clod::Points;
use palpate_core::glam::DVec3;

use crate::tolerances::SUPPORT_SLACK;

/// Largest number of points of a cell that is not quartered.
const CELL_POINTS: usize = 6;

/// Largest depth of a quadtree.
const MAX_DEPTH: u32 = 12;

/// Largest number of cells of a map per point of the hull.
const CELLS_PER_POINT: usize = 2;

/// Largest number of points of a cell in which each is compared with all others, rather than with five.
const ALL_COMPARED: usize = 24;

/// A convex hull as the set of its extreme points, in its own frame.
#[derive(Clone, Copy, Debug)]
pub struct Hull<'a> {
    points: HullPoints<'a>,
    map: Option<&'a SupportMap>,
}

/// Points of a hull.
#[derive(Clone, Copy, Debug)]
pub enum HullPoints<'a> {
    /// A slice of points.
    Row(&'a [DVec3]),
    /// Points of a hierarchy's node.
    Node(Points<'a>),
}

impl<'a> From<&'a [DVec3]> for HullPoints<'a> {
    fn from(points: &'a [DVec3]) -> Self {
        Self::Row(points)
    }
}

impl<'a, const N: usize> From<&'a [DVec3; N]> for HullPoints<'a> {
    fn from(points: &'a [DVec3; N]) -> Self {
        Self::Row(points)
    }
}

impl<'a> From<&'a Vec<DVec3>> for HullPoints<'a> {
    fn from(points: &'a Vec<DVec3>) -> Self {
        Self::Row(points)
    }
}

impl<'a> From<Points<'a>> for HullPoints<'a> {
    fn from(points: Points<'a>) -> Self {
        Self::Node(points)
    }
}

impl<'a> Hull<'a> {
    /// The hull of some points (m), at least one. Some may not be extreme.
    pub fn new(points: impl Into<HullPoints<'a>>) -> Self {
        Self::with_map(points, None)
    }

    /// The hull of some points with a map made of the same points.
    pub fn with_map(points: impl Into<HullPoints<'a>>, map: Option<&'a SupportMap>) -> Self {
        let hull = Self { points: points.into(), map };
        debug_assert!(hull.len() > 0 && map.is_none_or(|map| map.count as usize == hull.len()));
        hull
    }

    /// Number of points.
    #[expect(clippy::len_without_is_empty, reason = "there is at least one")]
    #[inline]
    pub fn len(&self) -> usize {
        match self.points {
            HullPoints::Row(points) => points.len(),
            HullPoints::Node(points) => points.len(),
        }
    }

    /// A point, m.
    #[inline]
    pub fn point(&self, index: u32) -> DVec3 {
        match self.points {
            HullPoints::Row(points) => points[index as usize],
            HullPoints::Node(points) => points[index as usize],
        }
    }

    /// Calls `each` with the points, m, in their order.
    #[inline]
    pub fn each_point(&self, mut each: impl FnMut(DVec3)) {
        match self.points {
            HullPoints::Row(points) => points.iter().for_each(|point| each(*point)),
            HullPoints::Node(points) => points.iter().for_each(|point| each(*point)),
        }
    }

    /// Whether all points satisfy a condition.
    #[inline]
    pub fn all_points(&self, mut condition: impl FnMut(DVec3) -> bool) -> bool {
        match self.points {
            HullPoints::Row(points) => points.iter().all(|point| condition(*point)),
            HullPoints::Node(points) => points.iter().all(|point| condition(*point)),
        }
    }

    /// Calls `each` with the index and the position (m) of every point whose dot product with a direction is
    /// at least `reach`.
    #[inline]
    pub fn each_beyond(&self, direction: DVec3, reach: f64, mut each: impl FnMut(u32, DVec3)) {
        // Loops compile to fewer instructions than iterator adapters.
        match self.points {
            HullPoints::Row(points) => {
                for (index, point) in (0u32..).zip(points) {
                    if point.dot(direction) >= reach {
                        each(index, *point);
                    }
                }
            }
            HullPoints::Node(points) => {
                for (index, point) in (0u32..).zip(points.iter()) {
                    if point.dot(direction) >= reach {
                        each(index, *point);
                    }
                }
            }
        }
    }

    /// Extent of the points along a direction: the largest dot product with it.
    pub fn end(&self, direction: DVec3) -> f64 {
        self.furthest(direction).1.dot(direction)
    }

    /// Index of the first point that lies furthest in a direction (of any length).
    pub fn support(&self, direction: DVec3) -> u32 {
        self.furthest(direction).0
    }

    /// Index and position (m) of the first point that lies furthest in a direction (of any length).
    pub fn furthest(&self, direction: DVec3) -> (u32, DVec3) {
        let found = match (self.map, self.points) {
            (None, HullPoints::Row(points)) => first_furthest((0u32..).zip(points), direction),
            (None, HullPoints::Node(points)) => first_furthest((0u32..).zip(points.iter()), direction),
            (Some(map), HullPoints::Row(points)) => map.furthest(|index| &points[index as usize], direction),
            (Some(map), HullPoints::Node(points)) => map.furthest(|index| &points[index as usize], direction),
        };
        found.unwrap_or_else(|| (0, self.point(0)))
    }
}

/// The first of some indexed points that lies furthest in a direction; `None` if all dot products are NaN.
#[inline]
fn first_furthest<'p>(
    points: impl Iterator<Item = (u32, &'p DVec3)>,
    direction: DVec3,
) -> Option<(u32, DVec3)> {
    let (mut best, mut furthest) = (None, f64::NEG_INFINITY);
    for (index, point) in points {
        let reach = point.dot(direction);
        if reach > furthest {
            (best, furthest) = (Some((index, point)), reach);
        }
    }
    best.map(|(index, point)| (index, *point))
}

/// Candidates for the extreme point of a hull, by direction.
#[derive(Clone, Debug)]
pub struct SupportMap {
    lists: Lists,
    /// Points of the hull.
    count: u32,
}

/// The cells: the six faces of the cube, then the quarters of each cell that is split. Each cell holds the
/// index of its first quarter or, with the highest bit set, that of its candidates: their number, then their
/// indices. The element types are the smallest that the hull allows.
#[derive(Clone, Debug)]
enum Lists {
    Small { cells: Box<[u16]>, candidates: Box<[u8]> },
    Medium { cells: Box<[u32]>, candidates: Box<[u16]> },
    Large { cells: Box<[u32]>, candidates: Box<[u32]> },
}

/// Flag of a cell with candidates.
const FILLED: u32 = 1 << 31;
const FILLED_SMALL: u16 = 1 << 15;

/// A cell while a map is built. Cells with the most points come first.
#[derive(Debug)]
struct Unfilled {
    candidates: Vec<u32>,
    cell: usize,
    square: Square,
    depth: u32,
}

impl Ord for Unfilled {
    fn cmp(&self, other: &Self) -> Ordering {
        self.candidates.len().cmp(&other.candidates.len()).then(other.cell.cmp(&self.cell))
    }
}

impl PartialOrd for Unfilled {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Unfilled {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Unfilled {}

/// Binary digits of a coordinate on a face of the cube.
const DIGITS: u32 = 30;

impl SupportMap {
    /// Smallest number of points for which a map is faster than a scan.
    pub const MIN_POINTS: usize = 28;

    /// Makes a map of a hull's points, at least one.
    pub fn new(points: &[DVec3]) -> Self {
        let (mut cells, mut filled) = (vec![0; 6], Vec::new());
        let all: Vec<u32> = (0u32..).take(points.len()).collect();
        let face = |cell| {
            let square = Square::face(cell);
            Unfilled { candidates: square.candidates(points, &all), cell, square, depth: 0 }
        };
        let mut unfilled: BinaryHeap<Unfilled> = (0..6).map(face).collect();
        while let Some(next) = unfilled.pop() {
            let Unfilled { candidates, cell, square, depth } = &next;
            let room = cells.len() + 4 <= CELLS_PER_POINT * points.len();
            if candidates.len() > CELL_POINTS && *depth < MAX_DEPTH && room {
                let first = cells.len();
                let quarters: [Unfilled; 4] = std::array::from_fn(|quarter| {
                    let square = square.quarter(quarter);
                    let candidates = square.candidates(points, candidates);
                    Unfilled { candidates, cell: first + quarter, square, depth: depth + 1 }
                });
                // If the quarters would have most of the points again, the cell is not split.
                if quarters.iter().map(|quarter| quarter.candidates.len()).sum::<usize>()
                    <= 3 * candidates.len()
                {
                    cells[*cell] = first as u32;
                    cells.extend([0; 4]);
                    unfilled.extend(quarters);
                    continue;
                }
            }
            cells[*cell] = FILLED | filled.len() as u32;
            filled.push(candidates.len() as u32);
            filled.extend(candidates);
        }
        let cells = cells.into_iter();
        // The indices fit the chosen types.
        let lists = if points.len() <= 0xff && filled.len() < usize::from(FILLED_SMALL) {
            let small = |cell: u32| (cell & !FILLED) as u16 | ((cell & FILLED) >> 16) as u16;
            let candidates = filled.into_iter().map(|index| index as u8).collect();
            Lists::Small { cells: cells.map(small).collect(), candidates }
        } else if points.len() <= 0xffff {
            let candidates = filled.into_iter().map(|index| index as u16).collect();
            Lists::Medium { cells: cells.collect(), candidates }
        } else {
            Lists::Large { cells: cells.collect(), candidates: filled.into() }
        };
        Self { lists, count: points.len() as u32 }
    }

    /// Memory held, bytes, without itself.
    pub fn bytes(&self) -> usize {
        match &self.lists {
            Lists::Small { cells, candidates } => size_of_val(&**cells) + size_of_val(&**candidates),
            Lists::Medium { cells, candidates } => size_of_val(&**cells) + size_of_val(&**candidates),
            Lists::Large { cells, candidates } => size_of_val(&**cells) + size_of_val(&**candidates),
        }
    }

    #[inline]
    fn furthest<'p>(&self, point: impl Fn(u32) -> &'p DVec3, direction: DVec3) -> Option<(u32, DVec3)> {
        let (face, [u, v]) = on_cube(direction);
        let mut digit = DIGITS;
        let mut quarter = || {
            digit -= 1;
            ((u >> digit & 1) | (v >> digit & 1) << 1) as usize
        };
        let indexed = |index: u32| (index, point(index));
        match &self.lists {
            Lists::Small { cells, candidates } => {
                let mut cell = cells[face];
                while cell & FILLED_SMALL == 0 {
                    cell = cells[usize::from(cell) + quarter()];
                }
                let first = usize::from(cell ^ FILLED_SMALL);
                let candidates = &candidates[first + 1..=first + usize::from(candidates[first])];
                first_furthest(candidates.iter().map(|index| indexed(u32::from(*index))), direction)
            }
            Lists::Medium { cells, candidates } => {
                let first = descend(cells, face, quarter);
                let candidates = &candidates[first + 1..=first + usize::from(candidates[first])];
                first_furthest(candidates.iter().map(|index| indexed(u32::from(*index))), direction)
            }
            Lists::Large { cells, candidates } => {
                let first = descend(cells, face, quarter);
                let candidates = &candidates[first + 1..=first + candidates[first] as usize];
                first_furthest(candidates.iter().map(|index| indexed(*index)), direction)
            }
        }
    }
}

/// Descends from a face to the cell of a direction. Returns the index of its candidates.
fn descend(cells: &[u32], face: usize, mut quarter: impl FnMut() -> usize) -> usize {
    let mut cell = cells[face];
    while cell & FILLED == 0 {
        cell = cells[cell as usize + quarter()];
    }
    (cell ^ FILLED) as usize
}

/// The face of the cube that a direction goes through, and the coordinates there, in units of 2⁻ᴰᴵᴳᴵᵀˢ of its
/// sides.
fn on_cube(direction: DVec3) -> (usize, [u32; 2]) {
    let DVec3 { x, y, z } = direction;
    let (ax, ay, az) = (x.abs(), y.abs(), z.abs());
    let (axis, along, u, v) = if ax >= ay && ax >= az {
        (0, x, y, z)
    } else if ay >= az {
        (1, y, z, x)
    } else {
        (2, z, x, y)
    };
    let half = f64::from(1u32 << (DIGITS - 1));
    let scale = half / along.abs();
    // NaN becomes 0.
    let place = |x: f64| ((x * scale + half) as u32).min((1 << DIGITS) - 1);
    (2 * axis + usize::from(along < 0.0), [place(u), place(v)])
}

/// Corners of a cell, a square on a face of the cube of directions from −1 to 1.
#[derive(Clone, Copy, Debug)]
struct Square([DVec3; 4]);

impl Square {
    fn face(face: usize) -> Self {
        let sign = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
        let axes = DVec3::AXES;
        let (along, u, v) = (sign * axes[face / 2], axes[(face / 2 + 1) % 3], axes[(face / 2 + 2) % 3]);
        Self([along - u - v, along + u - v, along - u + v, along + u + v])
    }

    fn quarter(&self, quarter: usize) -> Self {
        Self(self.0.map(|corner| (corner + self.0[quarter]) / 2.0))
    }

    /// The points that can be extreme in the cell: those that no other point leads at all four corners. A dot
    /// product is linear in the direction, so a point that leads at the corners leads in the whole cell.
    fn candidates(&self, points: &[DVec3], among: &[u32]) -> Vec<u32> {
        let reaches: Vec<[f64; 4]> =
            among.iter().map(|&index| self.0.map(|corner| points[index as usize].dot(corner))).collect();
        let furthest = |reach: &dyn Fn(&[f64; 4]) -> f64| {
            (0..among.len()).max_by(|&i, &j| reach(&reaches[i]).total_cmp(&reach(&reaches[j]))).unwrap_or(0)
        };
        let few: [usize; 5] = std::array::from_fn(|corner| match corner {
            4 => furthest(&|reach| reach.iter().sum()),
            corner => furthest(&|reach| reach[corner]),
        });
        let all = if among.len() <= ALL_COMPARED { 0..among.len() } else { 0..0 };
        let behind = |own: usize| {
            few.into_iter().chain(all.clone()).any(|rival| {
                let lead = |corner: usize| reaches[rival][corner] - reaches[own][corner];
                let lead = lead(0).min(lead(1)).min(lead(2)).min(lead(3));
                let apart = || points[among[own] as usize].distance(points[among[rival] as usize]);
                lead > 0.0 && lead > SUPPORT_SLACK * apart()
            })
        };
        (0..among.len()).filter(|&own| !behind(own)).map(|own| among[own]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    #[test]
    fn a_map_finds_what_a_scan_finds() {
        let mut rng = StdRng::seed_from_u64(0x5EED_0001);
        for round in 0..200 {
            let count = rng.random_range(1..400);
            let shape = round % 4;
            let points: Vec<DVec3> = (0..count)
                .map(|_| {
                    let p = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
                    match shape {
                        0 => p * DVec3::new(1.0, 1.0, 0.0),
                        // A cap, like a patch of a round body.
                        1 => DVec3::new(p.x, p.y, 10.0 - 0.1 * p.length_squared()),
                        _ => 3.0 * p.normalize_or_zero(),
                    }
                })
                .collect();
            let map = SupportMap::new(&points);
            let (scanned, hull) = (Hull::new(&points), Hull::with_map(&points, Some(&map)));
            for trial in 0..60 {
                let mut direction = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
                if trial % 3 == 0 {
                    // Directions on the cells' borders.
                    direction = (8.0 * direction).round();
                }
                let (found, expected) = (hull.support(direction), scanned.support(direction));
                assert_eq!(found, expected, "seed 0x5EED_0001, round {round}, {direction}");
            }
        }
    }

    #[test]
    fn equal_points_and_odd_directions_are_handled() {
        let points = vec![DVec3::ONE; 1000];
        let map = SupportMap::new(&points);
        let hull = Hull::with_map(&points, Some(&map));
        for direction in [DVec3::X, DVec3::ZERO, DVec3::INFINITY, DVec3::NAN] {
            assert!(hull.support(direction) < 1000);
        }
    }
}
