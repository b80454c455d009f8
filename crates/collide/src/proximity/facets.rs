//! The nearest triangles of two leaf patches.
//!
//! A patch of many triangles has a tree of axis-aligned boxes over them; pairs of boxes, and then of triangles, that are
//! no nearer than the best pair are dropped. The boxes of b are enclosed by boxes along a's axes.

use palpate_core::Clod;
use palpate_core::clod::Node;
use palpate_core::glam::{DMat3, DVec3};

use super::triangles::{self, Nearest, Triangle};
use crate::convex::Placement;

/// Most triangles of a cell.
const CELL: usize = 8;
const NONE: u32 = u32::MAX;

/// The boxes over the triangles of all leaf patches of a hierarchy that have more than fit in one.
#[derive(Clone, Debug, Default)]
pub(crate) struct Facets {
    /// The first leaf node.
    first: u32,
    /// Per leaf, its root among the cells, or [`NONE`].
    roots: Vec<u32>,
    cells: Vec<Cell>,
    /// Triangles of the cells, as indices into their patch.
    order: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Cell {
    center: DVec3,
    half: DVec3,
    /// First of `order`; or, of a cell with `count` 0, the second child. The first child follows its parent.
    first: u32,
    count: u32,
}

impl Facets {
    /// Prepares the leaf patches of a hierarchy.
    pub fn new(clod: &Clod) -> Self {
        let leaves = clod.levels.first().map_or(0..0, |level| level.nodes.clone());
        let mut facets = Self { first: leaves.start, ..Self::default() };
        for leaf in leaves {
            let node = &clod.nodes[leaf as usize];
            let root = if node.triangles.len() > CELL { facets.cells.len() as u32 } else { NONE };
            facets.roots.push(root);
            if root != NONE {
                let mut order: Vec<u32> = (0..node.triangles.len() as u32).collect();
                facets.split(clod, node, &mut order);
            }
        }
        facets
    }

    fn split(&mut self, clod: &Clod, node: &Node, triangles: &mut [u32]) {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for corner in triangles.iter().flat_map(|t| corners(clod, node, *t)) {
            (low, high) = (low.min(corner), high.max(corner));
        }
        let cell = self.cells.len();
        self.cells.push(Cell {
            center: (low + high) / 2.0,
            // A little more, for rounding.
            half: (high - low) / 2.0 + (low.abs() + high.abs()) * (2.0 * f64::EPSILON),
            first: self.order.len() as u32,
            count: triangles.len() as u32,
        });
        if triangles.len() <= CELL {
            self.order.extend_from_slice(triangles);
            return;
        }
        let axis = (high - low).max_position();
        let middle = |t: u32| corners(clod, node, t).map(|c| c[axis]).iter().sum::<f64>();
        let half = triangles.len() / 2;
        triangles.select_nth_unstable_by(half, |s, t| middle(*s).total_cmp(&middle(*t)).then(s.cmp(t)));
        let (first, second) = triangles.split_at_mut(half);
        self.split(clod, node, first);
        (self.cells[cell].first, self.cells[cell].count) = (self.cells.len() as u32, 0);
        self.split(clod, node, second);
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.roots) + size_of_val(&*self.cells) + size_of_val(&*self.order)
    }

    fn root(&self, leaf: u32) -> u32 {
        self.roots.get((leaf - self.first) as usize).copied().unwrap_or(NONE)
    }
}

fn corners(clod: &Clod, node: &Node, triangle: u32) -> Triangle {
    let points = clod.hull(node);
    clod.patch(node)[triangle as usize].map(|v| points[v as usize])
}

/// A leaf patch with its boxes.
#[derive(Clone, Copy)]
pub(crate) struct Leaf<'a> {
    facets: &'a Facets,
    points: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    root: u32,
}

impl<'a> Leaf<'a> {
    pub fn new(clod: &'a Clod, facets: &'a Facets, leaf: u32) -> Self {
        let node = &clod.nodes[leaf as usize];
        Self { facets, points: clod.hull(node), triangles: clod.patch(node), root: facets.root(leaf) }
    }

    pub fn corners(&self, triangle: u32) -> Triangle {
        self.triangles[triangle as usize].map(|v| self.points[v as usize])
    }

    fn cell(&self, cell: u32) -> Option<&'a Cell> {
        self.facets.cells.get(cell as usize)
    }

    /// The two children of a cell that has any.
    fn children(&self, cell: u32) -> Option<[u32; 2]> {
        self.cell(cell).filter(|inner| inner.count == 0).map(|inner| [cell + 1, inner.first])
    }

    /// The triangles of a cell without children, with their boxes, as placed by `place`.
    fn collect(&self, cell: u32, place: impl Fn(DVec3) -> DVec3, boxed: &mut Boxed) {
        let count = self.cell(cell).map_or(self.triangles.len(), |inner| inner.count as usize);
        boxed.len = count.min(CELL);
        for (index, slot) in boxed.facets[..boxed.len].iter_mut().enumerate() {
            let triangle = match self.cell(cell) {
                Some(inner) => self.facets.order[inner.first as usize + index],
                None => index as u32,
            };
            let corners = self.corners(triangle).map(&place);
            let [p, q, r] = corners;
            *slot = BoxedTriangle { triangle, corners, low: p.min(q).min(r), high: p.max(q).max(r) };
        }
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct BoxedTriangle {
    triangle: u32,
    corners: Triangle,
    low: DVec3,
    high: DVec3,
}

#[derive(Clone, Debug, Default)]
struct Boxed {
    facets: [BoxedTriangle; CELL],
    len: usize,
}

/// The nearest triangles of two patches, by index into them, and their nearest points in a's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NearestFacets {
    pub nearest: Nearest,
    pub triangles: [u32; 2],
}

/// Buffers for the nearest triangles of two patches.
#[derive(Clone, Debug)]
pub(crate) struct FacetSearch {
    /// Pairs of cells, with the squared distance of their boxes.
    stack: Vec<(u32, u32, f64)>,
    a: Boxed,
    b: Boxed,
    /// Pairs of triangles compared so far.
    pub compared: usize,
}

impl FacetSearch {
    pub fn new() -> Self {
        // Trees are balanced: more levels than this do not come up.
        Self { stack: Vec::with_capacity(128), a: Boxed::default(), b: Boxed::default(), compared: 0 }
    }

    pub fn capacity(&self) -> usize {
        self.stack.capacity()
    }

    /// The nearest triangles, if their squared distance is less than `limit` (m²); any as soon as that is no more than
    /// `enough` (m²).
    pub fn run(
        &mut self,
        a: &Leaf,
        b: &Leaf,
        placement: &Placement,
        mut limit: f64,
        enough: f64,
    ) -> Option<NearestFacets> {
        let turned = DMat3::from_cols(
            placement.rotation.x_axis.abs(),
            placement.rotation.y_axis.abs(),
            placement.rotation.z_axis.abs(),
        );
        let mut best = None;
        self.stack.clear();
        self.stack.push((a.root, b.root, 0.0));
        while let Some((cell_a, cell_b, squared)) = self.stack.pop() {
            if squared >= limit {
                continue;
            }
            let pairs = match (a.children(cell_a), b.children(cell_b)) {
                (None, None) => {
                    if let Some(found) = self.compare(a, b, [cell_a, cell_b], placement, limit) {
                        (best, limit) = (Some(found), found.nearest.squared);
                        if limit <= enough {
                            break;
                        }
                    }
                    continue;
                }
                (Some(children), None) => children.map(|child| (child, cell_b)),
                (None, Some(children)) => children.map(|child| (cell_a, child)),
                (Some(of_a), Some(of_b)) => {
                    let size = |leaf: &Leaf, cell| {
                        leaf.cell(cell).map_or(0.0, |inner: &Cell| inner.half.length_squared())
                    };
                    if size(a, cell_a) >= size(b, cell_b) {
                        of_a.map(|child| (child, cell_b))
                    } else {
                        of_b.map(|child| (cell_a, child))
                    }
                }
            };
            let gap = |(cell_a, cell_b)| gap(a.cell(cell_a), b.cell(cell_b), placement, &turned);
            let [first, second] = pairs.map(|pair| (pair.0, pair.1, gap(pair)));
            let (near, far) = if first.2 <= second.2 { (first, second) } else { (second, first) };
            self.stack.extend([far, near]);
        }
        best
    }

    /// Every triangle of one cell with every one of another.
    fn compare(
        &mut self,
        a: &Leaf,
        b: &Leaf,
        [cell_a, cell_b]: [u32; 2],
        placement: &Placement,
        mut limit: f64,
    ) -> Option<NearestFacets> {
        a.collect(cell_a, |p| p, &mut self.a);
        b.collect(cell_b, |p| placement.point(p), &mut self.b);
        let mut best = None;
        for one in &self.a.facets[..self.a.len] {
            for other in &self.b.facets[..self.b.len] {
                let gap = (one.low - other.high).max(other.low - one.high).max(DVec3::ZERO);
                if gap.length_squared() >= limit {
                    continue;
                }
                self.compared += 1;
                if let Some(nearest) = triangles::nearest(&one.corners, &other.corners, limit) {
                    limit = nearest.squared;
                    best = Some(NearestFacets { nearest, triangles: [one.triangle, other.triangle] });
                }
            }
        }
        best
    }
}

/// Squared lower bound on the distance of two cells; 0 if one has no box.
fn gap(a: Option<&Cell>, b: Option<&Cell>, placement: &Placement, turned: &DMat3) -> f64 {
    let (Some(a), Some(b)) = (a, b) else { return 0.0 };
    let apart = (a.center - placement.point(b.center)).abs() - a.half - *turned * b.half;
    apart.max(DVec3::ZERO).length_squared()
}
