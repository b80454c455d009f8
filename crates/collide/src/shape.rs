//! A hierarchy prepared for queries: what the descent reads of its nodes, packed, and search structures over their hulls.

use std::sync::{Arc, OnceLock};

use palpate_core::Clod;
use palpate_core::clod::Node;
use palpate_core::glam::DVec3;

use crate::ball::Ball;
use crate::contact_set::patchwork::Patchwork;
use crate::convex::{Hull, SupportMap};
use crate::patch::{Incidence, Patch, Plane};
use crate::proximity::SurfaceIndex;
use crate::query::refinement::Detail;

const NONE: u32 = u32::MAX;

/// A closed patch whose vertices are this fraction of its radius below its triangles' planes is its own hull.
const CONVEX: f64 = 1e-10;

/// A hierarchy prepared for queries. Cheap to clone: all queries with an object, and all its instances, share it.
#[derive(Clone, Debug)]
pub struct Shape(Arc<Prepared>);

#[derive(Debug)]
struct Prepared {
    clod: Arc<Clod>,
    nodes: Vec<Packed>,
    details: Vec<Detail>,
    supports: Vec<SupportMap>,
    incidences: Vec<Incidence>,
    /// Of the hierarchy's triangles.
    planes: Vec<Plane>,
    /// Bound on any coordinate, m.
    coordinates: f64,
    /// For distance queries, made by the first.
    surface: OnceLock<SurfaceIndex>,
    /// How the patches hang together, once that was asked for.
    patchwork: OnceLock<Patchwork>,
}

/// What the descent reads of a node.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packed {
    pub center: DVec3,
    pub radius: f64,
    pub hausdorff: f64,
    pub first_child: u32,
    pub last_child: u32,
    /// Index into [`Prepared::supports`], or [`NONE`].
    support: u32,
    /// Likewise for the patch alone: the same unless points were added to bound descendants.
    patch_support: u32,
    /// Index into [`Prepared::incidences`], or [`NONE`].
    incidence: u32,
    /// A closed patch whose vertices are all below its triangles' planes, to rounding.
    exact: bool,
}

impl Packed {
    /// A leaf of nothing but its bounding sphere.
    #[cfg(test)]
    pub fn sphere(center: DVec3, radius: f64) -> Self {
        Self {
            center,
            radius,
            hausdorff: 0.0,
            first_child: 0,
            last_child: 0,
            support: NONE,
            patch_support: NONE,
            incidence: NONE,
            exact: false,
        }
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
        let (mut supports, mut incidences) = (Vec::new(), Vec::new());
        let nodes: Vec<Packed> = clod
            .nodes
            .iter()
            .map(|node| {
                let mut support_of = |points: &[DVec3]| {
                    if points.len() < SupportMap::WORTHWHILE {
                        return NONE;
                    }
                    supports.push(SupportMap::new(points));
                    supports.len() as u32 - 1
                };
                let support = support_of(clod.bounding_hull(node));
                let patch_support = if node.added > 0 && !node.triangles.is_empty() {
                    support_of(clod.extreme(node))
                } else {
                    support
                };
                let incidence = if node.triangles.len() >= Incidence::WORTHWHILE {
                    incidences.push(Incidence::new(node.vertices.len(), clod.patch(node)));
                    incidences.len() as u32 - 1
                } else {
                    NONE
                };
                Packed {
                    center: node.center,
                    radius: node.radius,
                    hausdorff: node.hausdorff,
                    first_child: node.children.start,
                    last_child: node.children.end,
                    support,
                    patch_support,
                    incidence,
                    exact: node.children.is_empty()
                        && node.all_real
                        && is_convex(clod, node, supports.get(support as usize)),
                }
            })
            .collect();
        let details = clod.nodes.iter().map(|node| Detail::of(clod, node)).collect();
        let coordinates = clod.vertices.iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
        Self(Arc::new(Prepared {
            planes: planes_of(clod, &nodes, &supports),
            clod: shared,
            nodes,
            details,
            supports,
            incidences,
            coordinates,
            surface: OnceLock::new(),
            patchwork: OnceLock::new(),
        }))
    }

    /// The hierarchy.
    pub fn clod(&self) -> &Clod {
        &self.0.clod
    }

    /// The largest tolerance d of contact queries that have this shape as their probe, m: its bounding radius.
    ///
    /// Contacts stand for places where surfaces touch or are about to. With a larger d nearly every pair of patches would
    /// be one, and their number, with the memory for them, would grow with the product of both objects' patches.
    pub fn max_tolerance(&self) -> f64 {
        self.clod().bounding_radius()
    }

    /// Axis-aligned bounds of the surface at full resolution, mesh frame, m: the smallest and the largest x, y and z;
    /// `None` without triangles. Computed anew by each call.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.clod().bounds()
    }

    /// Bytes of memory held, besides the hierarchy itself.
    pub fn bytes(&self) -> usize {
        let Prepared { nodes, details, supports, incidences, planes, surface, patchwork, .. } = &*self.0;
        size_of_val(&**nodes)
            + size_of_val(&**planes)
            + size_of_val(&**details)
            + supports.iter().map(SupportMap::bytes).sum::<usize>()
            + incidences.iter().map(Incidence::bytes).sum::<usize>()
            + surface.get().map_or(0, SurfaceIndex::bytes)
            + patchwork.get().map_or(0, Patchwork::bytes)
    }

    /// How the patches hang together; found out when first asked.
    pub(crate) fn patchwork(&self) -> &Patchwork {
        self.0.patchwork.get_or_init(|| Patchwork::new(self.clod()))
    }

    /// Whether it has no nodes.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.nodes.is_empty()
    }

    /// Bound on any coordinate, m.
    pub(crate) fn coordinates(&self) -> f64 {
        self.0.coordinates
    }

    pub(crate) fn node(&self, node: u32) -> &Packed {
        &self.0.nodes[node as usize]
    }

    pub(crate) fn detail(&self, node: u32) -> &Detail {
        &self.0.details[node as usize]
    }

    /// Whether there is such a node, and it has a patch: contacts may be reported with it.
    pub(crate) fn has_patch(&self, node: u32) -> bool {
        self.0.details.get(node as usize).is_some_and(|detail| !detail.is_free())
    }

    /// The bounding hull of a node.
    pub(crate) fn hull(&self, node: u32) -> Hull<'_> {
        let support = self.0.supports.get(self.node(node).support as usize);
        Hull::with_map(self.clod().bounding_hull(&self.clod().nodes[node as usize]), support)
    }

    /// The hull of a node's patch.
    pub(crate) fn patch_hull(&self, node: u32) -> Hull<'_> {
        let support = self.0.supports.get(self.node(node).patch_support as usize);
        Hull::with_map(self.clod().extreme(&self.clod().nodes[node as usize]), support)
    }

    /// D, the support areas (m²) of a node's vertices.
    pub(crate) fn support_areas(&self, node: u32) -> &[f64] {
        self.clod().support_areas(&self.clod().nodes[node as usize])
    }

    /// A sphere around the whole body.
    pub(crate) fn ball(&self) -> Ball {
        let Packed { center, radius, .. } = *self.node(Clod::ROOT);
        Ball { center, radius }
    }

    /// What distance queries need besides; the first call prepares it.
    pub(crate) fn surface(&self) -> &SurfaceIndex {
        self.0.surface.get_or_init(|| SurfaceIndex::new(self.clod()))
    }

    pub(crate) fn patch(&self, node: u32) -> Patch<'_> {
        let Packed { patch_support, incidence, exact, .. } = *self.node(node);
        let (support, incidence) =
            (self.0.supports.get(patch_support as usize), self.0.incidences.get(incidence as usize));
        let node = &self.clod().nodes[node as usize];
        let planes = &self.0.planes[node.triangles.start as usize..node.triangles.end as usize];
        Patch::of_node(self.clod(), node, planes, support, incidence, exact)
    }

    /// The first descendant that is a leaf, has several children, or, unless the query is exact, may be fine enough.
    pub(crate) fn pass_through(&self, mut node: u32, exact: bool) -> u32 {
        loop {
            let Packed { first_child, last_child, .. } = *self.node(node);
            let fine_enough = !exact && !self.detail(node).is_free();
            if last_child - first_child != 1 || fine_enough {
                return node;
            }
            node = first_child;
        }
    }

    /// Most nodes that can wait on the stack below any node: siblings along one path from root to leaf.
    pub(crate) fn path_width(&self) -> usize {
        let mut width = vec![0usize; self.0.nodes.len()];
        for (index, node) in self.0.nodes.iter().enumerate().rev() {
            let below = (node.first_child..node.last_child).map(|c| width[c as usize]).max().unwrap_or(0);
            width[index] = below + (node.last_child - node.first_child) as usize;
        }
        width.first().copied().unwrap_or(0)
    }
}

/// The planes of all triangles of a hierarchy, in their order.
fn planes_of(clod: &Clod, nodes: &[Packed], supports: &[SupportMap]) -> Vec<Plane> {
    let of_node = |(node, packed): (&Node, &Packed)| {
        let vertices = clod.hull(node);
        let hull = Hull::with_map(clod.extreme(node), supports.get(packed.patch_support as usize));
        let planes = clod.patch(node).iter().map(move |corners| {
            let plane = Plane::of(corners.map(|v| vertices[v as usize]));
            let top = hull.points()[hull.support(plane.normal) as usize].dot(plane.normal);
            Plane { top: top.max(plane.offset), ..plane }
        });
        planes.collect::<Vec<_>>()
    };
    clod.nodes.iter().zip(nodes).filter(|(node, _)| !node.triangles.is_empty()).flat_map(of_node).collect()
}

/// Whether no vertex of a patch's hull is above the planes of its triangles, to rounding.
fn is_convex(clod: &Clod, node: &Node, map: Option<&SupportMap>) -> bool {
    let points = clod.hull(node);
    let hull = Hull::with_map(clod.extreme(node), map);
    clod.patch(node).iter().all(|corners| {
        let [p, q, r] = corners.map(|v| points[v as usize]);
        let normal = (q - p).cross(r - p).normalize_or_zero();
        let top = hull.points()[hull.support(normal) as usize];
        normal.dot(top - p) <= CONVEX * node.radius
    })
}
