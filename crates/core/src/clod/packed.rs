//! The hierarchy in little memory.
//!
//! - A point that several hulls have is stored once, in full; hulls are indices. So is D, the support area
//!   that belongs to it.
//! - Triangles name their corners in one byte each, unless a hull has more than 256 vertices.
//! - A node's centre, radius, s and h are 32-bit floats, in units of a power of two next to the bounding
//!   radius, about the bounding sphere's centre: so the precision depends neither on the unit in which an
//!   object is modelled nor on its distance from the origin. Radii, s and h are rounded up, radii also by the
//!   rounding of the centre, so that they still bound what they bounded.
//! - A node's vertices, triangles and children end where those of the next node begin.

use std::borrow::Borrow;
use std::hash::{BuildHasher, RandomState};
use std::ops::Range;

use glam::{DVec3, Vec3};

use super::views::Corners;
use super::{Areas, ClodError, Level, Node, Nodes, Parts, Points, Source, Triangles};

/// Flag of a node whose hull is verified not to protrude, in the word of its level.
const CONTAINED: u32 = 1 << 31;
/// Flag of a node whose patch covers the whole hull, in the word of its level.
const ALL_REAL: u32 = 1 << 30;

/// Free slot in the hash table of points.
const FREE: u32 = u32::MAX;

/// A hierarchy of contact levels of detail, in little memory. Lengths in metres, in the object's own frame.
///
/// Made of [`Parts`], or read from a `.clod` file. Radii, s and h of nodes are up to 2⁻²³ larger than those
/// that it was made of, and radii by up to 2⁻²² of the bounding radius; all else is the same.
#[derive(Clone, Debug, PartialEq)]
pub struct Clod {
    /// Levels, the full mesh (index 0) first, the root's level last.
    pub levels: Vec<Level>,
    /// The points of all hulls, m. Points that are equal, and have equal support areas, are there once.
    pub vertices: Vec<DVec3>,
    /// The mesh that the hierarchy was built from.
    pub source: Source,
    /// D of each vertex, m².
    areas: Vec<f64>,
    /// The nodes, and a sentinel at whose ranges those of the last node end.
    nodes: Vec<Packed>,
    /// Hull vertices of all nodes, in the nodes' order, as indices into `vertices`.
    hulls: Vec<u32>,
    /// Triangles of all patches, in the nodes' order.
    triangles: Packing,
    /// Unit of the nodes' lengths, m: a power of two.
    unit: f64,
}

/// A node in little memory. Lengths are in the hierarchy's unit.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Packed {
    /// Position relative to the bounding sphere's centre.
    center: Vec3,
    radius: f32,
    deviation: f32,
    hausdorff: f32,
    parent: u32,
    first_child: u32,
    /// First vertex of its bounding hull.
    first_vertex: u32,
    first_triangle: u32,
    extreme: u32,
    added: u32,
    /// Level, with [`CONTAINED`] and [`ALL_REAL`].
    level: u32,
}

/// Triangles with corners of as many bytes as they need.
#[derive(Clone, Debug, PartialEq)]
enum Packing {
    Bytes(Vec<[u8; 3]>),
    Shorts(Vec<[u16; 3]>),
    Words(Vec<[u32; 3]>),
}

impl Packing {
    fn new(triangles: &[[u32; 3]]) -> Self {
        let largest = triangles.iter().flatten().copied().max().unwrap_or(0);
        // No cast truncates: the largest corner fits.
        match largest {
            0..=0xff => Self::Bytes(triangles.iter().map(|t| t.map(|corner| corner as u8)).collect()),
            0x100..=0xffff => Self::Shorts(triangles.iter().map(|t| t.map(|corner| corner as u16)).collect()),
            _ => Self::Words(triangles.to_vec()),
        }
    }

    #[inline]
    fn get(&self, range: Range<u32>) -> Triangles<'_> {
        let range = range.start as usize..range.end as usize;
        Triangles(match self {
            Self::Bytes(all) => Corners::Bytes(&all[range]),
            Self::Shorts(all) => Corners::Shorts(&all[range]),
            Self::Words(all) => Corners::Words(&all[range]),
        })
    }

    fn len(&self) -> usize {
        match self {
            Self::Bytes(all) => all.len(),
            Self::Shorts(all) => all.len(),
            Self::Words(all) => all.len(),
        }
    }

    /// Size of a triangle in bytes.
    fn bytes_each(&self) -> usize {
        match self {
            Self::Bytes(_) => size_of::<[u8; 3]>(),
            Self::Shorts(_) => size_of::<[u16; 3]>(),
            Self::Words(_) => size_of::<[u32; 3]>(),
        }
    }
}

/// The smallest f32 that is not less than `x`.
fn rounded_up(x: f64) -> f32 {
    let near = x as f32;
    if f64::from(near) < x { near.next_up() } else { near }
}

/// The power of two next to a length, m: neither more than it nor less than half of it.
fn unit_of(length: f64) -> f64 {
    // Validation accepts only lengths that are normal numbers, so clearing the fraction leaves the power of
    // two.
    f64::from_bits(length.to_bits() & !((1 << 52) - 1))
}

impl Clod {
    /// Index of the root node.
    pub const ROOT: u32 = 0;

    /// Packs a hierarchy.
    ///
    /// # Errors
    /// If it is not [valid](Parts::validate), or a node is further than 1e38 bounding radii from the object's
    /// centre.
    pub fn pack(parts: &Parts) -> Result<Self, ClodError> {
        parts.validate()?;
        Self::pack_valid(parts)
    }

    /// Packs a hierarchy that is valid.
    pub(super) fn pack_valid(parts: &Parts) -> Result<Self, ClodError> {
        if parts.levels.len() > ALL_REAL as usize {
            return Err(ClodError::invalid("levels", "there are too many"));
        }
        let unit = unit_of(parts.source.bounding_radius);
        let mut nodes = Vec::with_capacity(parts.nodes.len() + 1);
        for (index, node) in parts.nodes.iter().enumerate() {
            let packed = Packed::new(node, parts.nodes.len() as u32, parts.source.center, unit);
            if !(packed.center.is_finite()
                && packed.radius.max(packed.deviation).max(packed.hausdorff).is_finite())
            {
                let what = "it is too large, or too far away, for the object's bounding radius";
                return Err(ClodError::invalid(format!("node {index}"), what));
            }
            nodes.push(packed);
        }
        let end = |count: usize| count as u32;
        nodes.push(Packed {
            center: Vec3::ZERO,
            radius: 0.0,
            deviation: 0.0,
            hausdorff: 0.0,
            parent: super::NO_NODE,
            first_child: end(parts.nodes.len()),
            first_vertex: end(parts.vertices.len()),
            first_triangle: end(parts.triangles.len()),
            extreme: 0,
            added: 0,
            level: 0,
        });
        let (vertices, areas, hulls) = shared(parts);
        Ok(Self {
            levels: parts.levels.clone(),
            vertices,
            source: parts.source.clone(),
            areas,
            nodes,
            hulls,
            triangles: Packing::new(&parts.triangles),
            unit,
        })
    }

    /// The hierarchy in parts.
    pub fn parts(&self) -> Parts {
        Parts {
            levels: self.levels.clone(),
            nodes: self.nodes().collect(),
            vertices: self.hulls.iter().map(|index| self.vertices[*index as usize]).collect(),
            support_areas: self.hulls.iter().map(|index| self.areas[*index as usize]).collect(),
            triangles: self.triangles.get(0..self.triangles.len() as u32).iter().collect(),
            source: self.source.clone(),
        }
    }

    /// A node.
    ///
    /// # Panics
    /// If no node has this index.
    #[inline]
    pub fn node(&self, index: u32) -> Node {
        let [node, next] = self.with_next(index);
        let first_vertex = node.first_vertex + node.added;
        let free_of_flags = node.level & !(CONTAINED | ALL_REAL);
        Node {
            parent: node.parent,
            children: node.first_child..next.first_child,
            level: free_of_flags,
            vertices: first_vertex..next.first_vertex,
            extreme: node.extreme,
            added: node.added,
            triangles: node.first_triangle..next.first_triangle,
            center: node.center(self.source.center, self.unit),
            radius: self.unit * f64::from(node.radius),
            deviation: self.unit * f64::from(node.deviation),
            hausdorff: self.unit * f64::from(node.hausdorff),
            contained: node.level & CONTAINED != 0,
            all_real: node.level & ALL_REAL != 0,
        }
    }

    /// A node, if there is one with this index.
    pub fn get(&self, index: u32) -> Option<Node> {
        self.nodes().range.contains(&index).then(|| self.node(index))
    }

    #[inline]
    fn with_next(&self, index: u32) -> [&Packed; 2] {
        [&self.nodes[index as usize], &self.nodes[index as usize + 1]]
    }

    /// All nodes, the root first, level by level down to the leaves (level 0).
    pub fn nodes(&self) -> Nodes<'_> {
        Nodes { clod: self, range: 0..(self.nodes.len() - 1) as u32 }
    }

    /// The nodes of a level, by its index in [`levels`](Self::levels).
    pub fn level(&self, level: usize) -> Nodes<'_> {
        Nodes { clod: self, range: self.levels[level].nodes.clone() }
    }

    /// The nodes of the full mesh, level 0.
    pub fn leaves(&self) -> Nodes<'_> {
        self.level(0)
    }

    /// The children of a node; empty for a leaf.
    pub fn children(&self, node: impl Borrow<Node>) -> Nodes<'_> {
        Nodes { clod: self, range: node.borrow().children.clone() }
    }

    /// All hull vertices of a node, m, extreme points first.
    #[inline]
    pub fn hull(&self, node: impl Borrow<Node>) -> Points<'_> {
        Points::new(&self.vertices, &self.hulls[whole_range(node.borrow())])
    }

    /// The extreme points of a node's hull, m.
    #[inline]
    pub fn extreme(&self, node: impl Borrow<Node>) -> Points<'_> {
        Points::new(&self.vertices, &self.hulls[extreme_range(node.borrow())])
    }

    /// The points, m, whose convex hull stands for a node and, but for h, its descendants when nodes are
    /// culled: the extreme points of its own hull, and others that bring h down (§3.6.2). Not all of them
    /// need be extreme.
    #[inline]
    pub fn bounding_hull(&self, node: impl Borrow<Node>) -> Points<'_> {
        Points::new(&self.vertices, &self.hulls[super::bounding_range(node.borrow())])
    }

    /// D, the support areas (m²) of a node's hull vertices, in the order of [`hull`](Self::hull).
    #[inline]
    pub fn support_areas(&self, node: impl Borrow<Node>) -> Areas<'_> {
        Areas::new(&self.areas, &self.hulls[whole_range(node.borrow())])
    }

    /// D, the support areas (m²) of the points of a node's [`bounding_hull`](Self::bounding_hull), in their
    /// order.
    #[inline]
    pub fn bounding_areas(&self, node: impl Borrow<Node>) -> Areas<'_> {
        Areas::new(&self.areas, &self.hulls[super::bounding_range(node.borrow())])
    }

    /// The surface triangles of a node's patch, as indices into [`hull`](Self::hull).
    #[inline]
    pub fn patch(&self, node: impl Borrow<Node>) -> Triangles<'_> {
        self.triangles.get(node.borrow().triangles.clone())
    }

    /// Surface triangles of all patches.
    pub fn patch_triangles(&self) -> usize {
        self.triangles.len()
    }

    /// Radius of the bounding sphere of the mesh that the hierarchy was built from, m.
    pub fn bounding_radius(&self) -> f64 {
        self.source.bounding_radius
    }

    /// Axis-aligned bounds of the surface at full resolution, mesh frame, m: the smallest and the largest x,
    /// y and z; `None` without triangles.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let corners = self.leaves().flat_map(|leaf| {
            let hull = self.hull(&leaf);
            self.patch(&leaf).iter().flatten().map(move |corner| hull[corner as usize])
        });
        corners.fold(None, |bounds, corner| {
            let (min, max) = bounds.unwrap_or((corner, corner));
            Some((min.min(corner), max.max(corner)))
        })
    }

    /// The hierarchy of the object made larger by a factor about its frame's origin; `None` if the factor is
    /// not positive and finite, or so large or small that lengths or areas are lost.
    pub fn scaled(&self, factor: f64) -> Option<Self> {
        Self::pack_valid(&self.parts().scaled(factor)?).ok()
    }

    /// Memory that a level takes, in bytes, with the points that no finer level has.
    pub fn level_bytes(&self, level: usize) -> usize {
        // Points are numbered from the finest level on.
        let points = |level: usize| self.hulls[self.hulls_of(level)].iter().map(|index| index + 1).max();
        let finer = (0..level).filter_map(points).max().unwrap_or(0);
        let own = points(level).unwrap_or(0).saturating_sub(finer) as usize;
        let triangles: usize = self.level(level).map(|node| node.triangles.len()).sum();
        size_of::<Level>()
            // The sentinel counts as one of the leaves.
            + (self.levels[level].nodes.len() + usize::from(level == 0)) * size_of::<Packed>()
            + own * (size_of::<DVec3>() + size_of::<f64>())
            + size_of_val(&self.hulls[self.hulls_of(level)])
            + triangles * self.triangles.bytes_each()
    }

    /// Range of the hull vertices of a level among all.
    fn hulls_of(&self, level: usize) -> Range<usize> {
        let Range { start, end } = self.levels[level].nodes;
        let first = |node: u32| self.nodes[node as usize].first_vertex as usize;
        first(start)..first(end)
    }

    /// Memory that the hierarchy takes, in bytes, apart from spare capacity.
    pub fn total_bytes(&self) -> usize {
        size_of::<Self>()
            + size_of_val(&*self.levels)
            + size_of_val(&*self.vertices)
            + size_of_val(&*self.areas)
            + size_of_val(&*self.nodes)
            + size_of_val(&*self.hulls)
            + self.triangles.len() * self.triangles.bytes_each()
    }
}

impl Packed {
    fn new(node: &Node, count: u32, origin: DVec3, unit: f64) -> Self {
        let center = ((node.center - origin) / unit).as_vec3();
        let mut packed = Self {
            center,
            radius: 0.0,
            deviation: rounded_up(node.deviation / unit),
            hausdorff: rounded_up(node.hausdorff / unit),
            parent: node.parent,
            // A leaf has no children, wherever its empty range is.
            first_child: if node.children.is_empty() { count } else { node.children.start },
            first_vertex: node.vertices.start - node.added,
            first_triangle: node.triangles.start,
            extreme: node.extreme,
            added: node.added,
            level: node.level
                | if node.contained { CONTAINED } else { 0 }
                | if node.all_real { ALL_REAL } else { 0 },
        };
        let aside = packed.center(origin, unit).distance(node.center);
        packed.radius = rounded_up((node.radius + aside * (1.0 + 4.0 * f64::EPSILON)) / unit);
        packed
    }

    /// Centre in the object's frame, m.
    #[inline]
    fn center(&self, origin: DVec3, unit: f64) -> DVec3 {
        origin + unit * self.center.as_dvec3()
    }
}

/// Range of a node's hull vertices among all.
fn whole_range(node: &Node) -> Range<usize> {
    node.vertices.start as usize..node.vertices.end as usize
}

/// Range of the extreme points of a node's hull among all hull vertices.
fn extreme_range(node: &Node) -> Range<usize> {
    node.vertices.start as usize..(node.vertices.start + node.extreme) as usize
}

/// The different hull vertices with their areas, and for each hull vertex its index among them. Those of the
/// finest level come first, since most queries read these.
fn shared(parts: &Parts) -> (Vec<DVec3>, Vec<f64>, Vec<u32>) {
    let mut vertices = Vec::new();
    let mut areas = Vec::new();
    let mut hulls = vec![0; parts.vertices.len()];
    // A hash table with open addressing, at most half full. The seed is random, so that no file can make it
    // slow.
    let mut table = vec![FREE; (2 * parts.vertices.len()).next_power_of_two().max(2)];
    let (mask, seed) = (table.len() - 1, RandomState::new());
    let key = |vertex: DVec3, area: f64| [vertex.x, vertex.y, vertex.z, area].map(f64::to_bits);
    for level in &parts.levels {
        let nodes = &parts.nodes[level.nodes.start as usize..level.nodes.end as usize];
        let first = nodes.first().map_or(0, |node| node.vertices.start - node.added);
        let last = nodes.last().map_or(0, |node| node.vertices.end);
        for (at, hull) in hulls.iter_mut().enumerate().take(last as usize).skip(first as usize) {
            let (vertex, area) = (parts.vertices[at], parts.support_areas[at]);
            let mut place = seed.hash_one(key(vertex, area)) as usize & mask;
            *hull = loop {
                let taken = table[place];
                if taken == FREE {
                    table[place] = vertices.len() as u32;
                    vertices.push(vertex);
                    areas.push(area);
                    break table[place];
                }
                if key(vertices[taken as usize], areas[taken as usize]) == key(vertex, area) {
                    break taken;
                }
                place = (place + 1) & mask;
            };
        }
    }
    vertices.shrink_to_fit();
    areas.shrink_to_fit();
    (vertices, areas, hulls)
}
