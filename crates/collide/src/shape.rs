//! A hierarchy prepared for queries: packed data of its nodes for the descent, and search structures over
//! their hulls.

use std::sync::{Arc, OnceLock};

use palpate_core::Clod;
use palpate_core::clod::{Node, Points};
use palpate_core::glam::DVec3;

use crate::ball::Ball;
use crate::convex::{Hull, SupportMap};
use crate::detail::{Detail, SupportAreas};
use crate::patch::{Incidence, Patch};
use crate::patchwork::{Parts, Patchwork};
use crate::tolerances::CONVEX_PATCH;

/// Index that stands for no search structure.
const NONE: u32 = u32::MAX;

/// A hierarchy prepared for queries. Cheap to clone: all queries with an object, and all its instances, share
/// it.
#[derive(Clone, Debug)]
pub struct Shape(Arc<Prepared>);

#[derive(Debug)]
struct Prepared {
    clod: Arc<Clod>,
    /// Extra data of each node.
    extras: Vec<Extra>,
    /// Search structures of nodes with a large hull or patch.
    searches: Vec<Search>,
    supports: Vec<SupportMap>,
    incidences: Vec<Incidence>,
    /// Bound on any coordinate, m.
    coordinates: f64,
    /// The surface of each level, made on first use.
    patchwork: OnceLock<Patchwork>,
    /// Its connected parts, made on first use.
    parts: OnceLock<Parts>,
}

/// Data of a node for queries, besides the hierarchy.
#[derive(Clone, Copy, Debug)]
struct Extra {
    areas: SupportAreas,
    /// Index into [`Prepared::searches`] or [`NONE`], with the bit [`EXACT`] set or cleared.
    search: u32,
}

/// Flag of a closed patch whose vertices are all below its triangles' planes, up to rounding.
const EXACT: u32 = 1 << 31;

/// Search structures of a node with a large hull or patch: indices, or [`NONE`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Search {
    /// Map of the bounding hull, in [`Prepared::supports`].
    support: u32,
    /// Map of the patch's hull, in the same list; the same map unless points were added to bound
    /// descendants.
    patch_support: u32,
    /// Triangles at the patch's vertices, in [`Prepared::incidences`].
    incidence: u32,
}

/// Placeholder of a node without search structures.
const NO_SEARCH: Search = Search { support: NONE, patch_support: NONE, incidence: NONE };

/// The part of a node that the descent reads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packed {
    pub center: DVec3,
    pub radius: f64,
    pub hausdorff: f64,
    pub first_child: u32,
    pub last_child: u32,
}

impl Packed {
    /// A leaf that is only a bounding sphere.
    #[cfg(test)]
    pub fn sphere(center: DVec3, radius: f64) -> Self {
        Self { center, radius, hausdorff: 0.0, first_child: 0, last_child: 0 }
    }

    pub fn is_leaf(&self) -> bool {
        self.first_child == self.last_child
    }
}

impl Shape {
    /// Prepares a hierarchy.
    pub fn new(clod: impl Into<Arc<Clod>>) -> Self {
        let shared = clod.into();
        let clod: &Clod = &shared;
        let (mut searches, mut supports, mut incidences) = (Vec::new(), Vec::new(), Vec::new());
        let unit = area_unit(clod);
        let mut extras = Vec::with_capacity(clod.nodes().len());
        for node in clod.nodes() {
            let search = Search::of(clod, &node, &mut supports, &mut incidences);
            let mut index = NONE ^ EXACT;
            if search != NO_SEARCH {
                index = searches.len() as u32;
                searches.push(search);
            }
            let map = supports.get(search.patch_support as usize);
            if node.children.is_empty() && node.all_real && is_convex(clod, &node, map) {
                index |= EXACT;
            }
            extras.push(Extra { areas: SupportAreas::of(clod, &node, unit), search: index });
        }
        let coordinates = clod.vertices.iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
        searches.shrink_to_fit();
        supports.shrink_to_fit();
        incidences.shrink_to_fit();
        Self(Arc::new(Prepared {
            clod: shared,
            extras,
            searches,
            supports,
            incidences,
            coordinates,
            patchwork: OnceLock::new(),
            parts: OnceLock::new(),
        }))
    }

    /// The hierarchy.
    pub fn clod(&self) -> &Clod {
        &self.0.clod
    }

    /// The largest tolerance d of contact queries with this shape as their probe, m: its bounding radius.
    ///
    /// With a larger d nearly every pair of patches would be a contact, and their number and memory would
    /// grow with the product of both objects' patches.
    pub fn max_tolerance(&self) -> f64 {
        self.clod().bounding_radius()
    }

    /// Axis-aligned bounds of the surface at full resolution, mesh frame, m: the smallest and the largest x,
    /// y and z; `None` without triangles. Computed in each call.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.clod().bounds()
    }

    /// Memory held, bytes, without the hierarchy itself.
    pub fn bytes(&self) -> usize {
        let Prepared { extras, searches, supports, incidences, patchwork, parts, .. } = &*self.0;
        size_of::<Prepared>()
            + size_of_val(&**extras)
            + size_of_val(&**searches)
            + size_of_val(&**supports)
            + size_of_val(&**incidences)
            + supports.iter().map(SupportMap::bytes).sum::<usize>()
            + incidences.iter().map(Incidence::bytes).sum::<usize>()
            + patchwork.get().map_or(0, Patchwork::bytes)
            + parts.get().map_or(0, Parts::bytes)
    }

    /// The surface of each level, made on first use.
    pub(crate) fn patchwork(&self) -> &Patchwork {
        self.0.patchwork.get_or_init(|| Patchwork::new(self.clod()))
    }

    /// The connected parts of the surface at full resolution, found on first use.
    pub(crate) fn parts(&self) -> &Parts {
        self.0.parts.get_or_init(|| Parts::new(self.clod(), self.patchwork()))
    }

    /// Bound on any coordinate, m.
    pub(crate) fn coordinates(&self) -> f64 {
        self.0.coordinates
    }

    #[inline]
    pub(crate) fn node(&self, node: u32) -> Packed {
        let Node { center, radius, hausdorff, children, .. } = self.clod().node(node);
        Packed { center, radius, hausdorff, first_child: children.start, last_child: children.end }
    }

    /// Radius of a node's bounding sphere, m.
    #[inline]
    pub(crate) fn radius(&self, node: u32) -> f64 {
        self.clod().node(node).radius
    }

    #[inline]
    pub(crate) fn detail(&self, node: u32) -> Detail {
        let clod = self.clod();
        Detail::of(clod, &clod.node(node), &self.0.extras[node as usize].areas, area_unit(clod))
    }

    /// Whether a node has no patch, so that no contacts can be reported with it.
    #[inline]
    pub(crate) fn is_free(&self, node: u32) -> bool {
        let clod = self.clod();
        clod.levels[clod.node(node).level as usize].free
    }

    /// Whether there is such a node and it has a patch, so that contacts may be reported with it.
    pub(crate) fn has_patch(&self, node: u32) -> bool {
        (node as usize) < self.0.extras.len() && !self.is_free(node)
    }

    fn search(&self, node: u32) -> Search {
        let index = self.0.extras[node as usize].search & !EXACT;
        self.0.searches.get(index as usize).copied().unwrap_or(NO_SEARCH)
    }

    /// The bounding hull of a node.
    #[inline]
    pub(crate) fn hull(&self, node: u32) -> Hull<'_> {
        let support = self.0.supports.get(self.search(node).support as usize);
        Hull::with_map(self.clod().bounding_hull(self.clod().node(node)), support)
    }

    /// The hull of a node's patch.
    #[inline]
    pub(crate) fn patch_hull(&self, node: u32) -> Hull<'_> {
        let support = self.0.supports.get(self.search(node).patch_support as usize);
        Hull::with_map(self.clod().extreme(self.clod().node(node)), support)
    }

    /// D, the support area (m²) of each of a node's vertices.
    pub(crate) fn support_area(&self, node: u32) -> impl Fn(u32) -> f64 {
        let areas = self.clod().support_areas(self.clod().node(node));
        move |vertex| areas[vertex as usize]
    }

    /// A sphere around the whole body.
    pub(crate) fn ball(&self) -> Ball {
        let Packed { center, radius, .. } = self.node(Clod::ROOT);
        Ball { center, radius }
    }

    pub(crate) fn patch(&self, node: u32) -> Patch<'_> {
        let Search { patch_support, incidence, .. } = self.search(node);
        let (support, incidence) =
            (self.0.supports.get(patch_support as usize), self.0.incidences.get(incidence as usize));
        let exact = self.0.extras[node as usize].search & EXACT != 0;
        Patch::of_node(self.clod(), &self.clod().node(node), support, incidence, exact)
    }

    /// The first node on the path down from a node, itself included, that is a leaf, has several children,
    /// or, unless the query is exact, may be fine enough.
    pub(crate) fn pass_through(&self, mut node: u32, exact: bool) -> u32 {
        loop {
            let Packed { first_child, last_child, .. } = self.node(node);
            let fine_enough = !exact && !self.is_free(node);
            if last_child - first_child != 1 || fine_enough {
                return node;
            }
            node = first_child;
        }
    }

    /// Largest number of nodes that can wait on the stack below any node: the siblings along a path from root
    /// to leaf.
    pub(crate) fn path_width(&self) -> usize {
        let mut width = vec![0usize; self.0.extras.len()];
        for index in (0..width.len()).rev() {
            let Packed { first_child, last_child, .. } = self.node(index as u32);
            let below = (first_child..last_child).map(|c| width[c as usize]).max().unwrap_or(0);
            width[index] = below + (last_child - first_child) as usize;
        }
        width.first().copied().unwrap_or(0)
    }
}

/// The unit of a hierarchy's support areas, m²: R².
fn area_unit(clod: &Clod) -> f64 {
    clod.bounding_radius() * clod.bounding_radius()
}

impl Search {
    /// Makes the search structures of a node. Hulls and patches too small to gain from them have none.
    fn of(clod: &Clod, node: &Node, supports: &mut Vec<SupportMap>, incidences: &mut Vec<Incidence>) -> Self {
        let mut support_of = |points: Points| {
            if points.len() < SupportMap::MIN_POINTS {
                return NONE;
            }
            supports.push(SupportMap::new(&points.to_vec()));
            supports.len() as u32 - 1
        };
        let support = support_of(clod.bounding_hull(node));
        let has_own = node.added > 0 && !node.triangles.is_empty();
        let patch_support = if has_own { support_of(clod.extreme(node)) } else { support };
        let incidence = if node.triangles.len() >= Incidence::MIN_TRIANGLES {
            incidences.push(Incidence::new(node.vertices.len(), clod.patch(node)));
            incidences.len() as u32 - 1
        } else {
            NONE
        };
        Self { support, patch_support, incidence }
    }
}

/// Whether no vertex of a patch's hull is above the planes of its triangles, up to rounding.
fn is_convex(clod: &Clod, node: &Node, map: Option<&SupportMap>) -> bool {
    let points = clod.hull(node);
    let hull = Hull::with_map(clod.extreme(node), map);
    clod.patch(node).iter().all(|corners| {
        let [p, q, r] = corners.map(|v| points[v as usize]);
        let normal = (q - p).cross(r - p).normalize_or_zero();
        let top = hull.point(hull.support(normal));
        normal.dot(top - p) <= CONVEX_PATCH * node.radius
    })
}
