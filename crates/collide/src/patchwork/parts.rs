//! The connected parts of a surface at full resolution, and which of them bound the solid.
//!
//! A solid has several parts where it is hollow, or in several pieces. A part inside a piece that faces the
//! same way, such as a ball in a ball, is buried: there is solid on both sides of it. What is inside the
//! solid is told from the other parts, on which solid has one side only, so that the side of the nearest one
//! decides.

use palpate_core::Clod;
use palpate_core::glam::DVec3;

use super::nearest::NearestSearch;
use super::neighbours::Neighbours;
use super::trees::Patchwork;
use crate::disjoint_sets::DisjointSets;

/// Index of no part.
const NO_PART: u32 = u32::MAX;

/// Number of vertices of a part by which it is found to be buried.
const PROBED: usize = 8;

/// The connected parts of the surface of level 0.
///
/// Memory: 8 bytes a vertex of that level, 4 a node, and 57 a part.
#[derive(Clone, Debug, Default)]
pub(crate) struct Parts {
    /// Part of each mesh vertex of level 0.
    of_vertex: Vec<u32>,
    /// Part of each node; none for one with leaves of several.
    of_node: Vec<u32>,
    /// Start of each part's vertices; one more at the end.
    starts: Vec<u32>,
    /// Mesh vertices by part, those near each other mostly one after the other.
    vertices: Vec<u32>,
    /// Lowest and highest corner of the box around each part, m.
    boxes: Vec<[DVec3; 2]>,
    /// Whether each part bounds the solid: none does if the mesh is open.
    bounding: Vec<bool>,
}

impl Parts {
    /// Finds the parts of a hierarchy's surface.
    pub fn new(clod: &Clod, surface: &Patchwork) -> Self {
        let mut parts = Self::default();
        parts.connect(surface);
        parts.name_nodes(clod, &surface.neighbours);
        parts.bounding = vec![clod.source.solid; parts.len()];
        if clod.source.solid && parts.len() > 1 {
            let inverted: Vec<bool> =
                (0..parts.len() as u32).map(|p| parts.is_inverted(p, surface)).collect();
            let mut search = NearestSearch::default();
            parts.bounding = (0..parts.len() as u32)
                .map(|part| parts.is_bounding(part, surface, &inverted, &mut search))
                .collect();
        }
        parts
    }

    /// Divides the vertices of level 0 among the parts.
    fn connect(&mut self, surface: &Patchwork) {
        let neighbours = &surface.neighbours;
        let triangles = || surface.of_level(0).iter().copied();
        let count = triangles().flat_map(|t| neighbours.ends(t)).max().map_or(0, |last| last as usize + 1);
        let mut sets = DisjointSets::default();
        sets.clear(count);
        for [i, j, k] in triangles().map(|t| neighbours.ends(t)) {
            sets.join(i, j);
            sets.join(j, k);
        }
        self.of_vertex = vec![NO_PART; count];
        // In the order of the tree, whose neighbours are neighbours in space.
        let mut order = Vec::with_capacity(count);
        let mut seen = vec![false; count];
        for vertex in triangles().flat_map(|t| neighbours.ends(t)) {
            if std::mem::replace(&mut seen[vertex as usize], true) {
                continue;
            }
            order.push(vertex);
            let root = sets.root(vertex) as usize;
            if self.of_vertex[root] == NO_PART {
                self.of_vertex[root] = self.boxes.len() as u32;
                self.boxes.push([DVec3::INFINITY, DVec3::NEG_INFINITY]);
            }
            let part = self.of_vertex[root];
            self.of_vertex[vertex as usize] = part;
            let (point, [low, high]) = (neighbours.point(vertex), self.boxes[part as usize]);
            self.boxes[part as usize] = [low.min(point), high.max(point)];
        }
        order.sort_by_key(|vertex| self.of_vertex[*vertex as usize]);
        let part_of = |vertex: &u32| self.of_vertex[*vertex as usize];
        self.starts =
            (0..=self.boxes.len() as u32).map(|p| order.partition_point(|v| part_of(v) < p) as u32).collect();
        self.vertices = order;
    }

    /// Finds the part of each node, from the leaves up.
    fn name_nodes(&mut self, clod: &Clod, neighbours: &Neighbours) {
        self.of_node = vec![NO_PART; clod.nodes().len()];
        for index in (0..self.of_node.len()).rev() {
            let node = clod.node(index as u32);
            self.of_node[index] = if node.children.is_empty() {
                let first = node.triangles.clone().next();
                first.map_or(NO_PART, |triangle| self.of_triangle(neighbours, triangle))
            } else {
                let below = &self.of_node[node.children.start as usize..node.children.end as usize];
                below[0] | if below.iter().all(|part| *part == below[0]) { 0 } else { NO_PART }
            };
        }
    }

    /// Whether a part of a closed surface faces inwards, as that of a cavity does: its volume is negative.
    fn is_inverted(&self, part: u32, surface: &Patchwork) -> bool {
        let neighbours = &surface.neighbours;
        let [low, high] = self.boxes[part as usize];
        let middle = low.midpoint(high);
        let own = surface.of_level(0).iter().filter(|t| self.of_triangle(neighbours, **t) == part);
        let volume = |t: &u32| {
            let [p, q, r] = neighbours.corners(*t).map(|corner| corner - middle);
            p.dot(q.cross(r))
        };
        own.map(volume).sum::<f64>() < 0.0
    }

    /// Whether a part has solid on one side only, by the winding numbers of all others about its vertices.
    /// (Where parts cross each other, which the mesh ought not to have, some vertices are buried and some are
    /// not: then the part counts as bounding.)
    fn is_bounding(
        &self,
        part: u32,
        surface: &Patchwork,
        inverted: &[bool],
        search: &mut NearestSearch,
    ) -> bool {
        let vertices = self.vertices(part);
        let own = if inverted[part as usize] { -1 } else { 1 };
        let step = vertices.len().div_ceil(PROBED);
        vertices.iter().step_by(step).any(|vertex| {
            let point = surface.neighbours.point(*vertex);
            let others = (0..self.len() as u32).filter(|other| *other != part && self.box_has(*other, point));
            let turns = others.map(|other| {
                let is_of = |t: u32| self.of_triangle(&surface.neighbours, t) == other;
                let nearest = search.among(surface, point, None, is_of);
                let behind = nearest.is_some_and(|nearest| nearest.is_behind(surface, point));
                i32::from(behind) - i32::from(inverted[other as usize])
            });
            let turns: i32 = turns.sum();
            (turns > 0) != (turns + own > 0)
        })
    }

    fn box_has(&self, part: u32, point: DVec3) -> bool {
        let [low, high] = self.boxes[part as usize];
        point.cmpge(low).all() && point.cmple(high).all()
    }

    /// Number of parts.
    pub fn len(&self) -> usize {
        self.boxes.len()
    }

    /// The mesh vertices of a part, at least three.
    pub fn vertices(&self, part: u32) -> &[u32] {
        &self.vertices[self.starts[part as usize] as usize..self.starts[part as usize + 1] as usize]
    }

    /// The part of a node; `None` for one with leaves of several parts.
    pub fn of_node(&self, node: u32) -> Option<u32> {
        Some(self.of_node[node as usize]).filter(|part| *part != NO_PART)
    }

    /// The part of a triangle of level 0.
    pub fn of_triangle(&self, neighbours: &Neighbours, triangle: u32) -> u32 {
        self.of_vertex[neighbours.ends(triangle)[0] as usize]
    }

    /// Whether a triangle of level 0 has solid on one side only.
    pub fn bounds(&self, neighbours: &Neighbours, triangle: u32) -> bool {
        self.bounding[self.of_triangle(neighbours, triangle) as usize]
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        let Self { of_vertex, of_node, starts, vertices, boxes, bounding } = self;
        let lists = [of_vertex, of_node, starts, vertices].map(|list| size_of_val(&**list));
        lists.iter().sum::<usize>() + size_of_val(&**boxes) + size_of_val(&**bounding)
    }
}
