//! The invariants of a hierarchy that queries rely on, checked once so that queries need not.
//!
//! Time is linear in the size of the hierarchy even for hostile data, since nodes may not share vertices or
//! triangles. Numbers are printed as `{:?}`, with an exponent where it is shorter: `{}` writes hundreds of
//! digits for damaged ones.

use std::ops::Range;

use glam::DVec3;

use super::{ClodError, NO_NODE, Node, Parts};

/// Largest distance of a hull vertex outside its node's bounding sphere, as a multiple of the object's
/// bounding radius: some thousand times the rounding of a coordinate.
const SPHERE_SLACK: f64 = 1e-9;

/// Largest length accepted, m; the smallest bounding radius is its reciprocal. Fifth powers of such lengths,
/// which inertia needs, are far within the range of f64.
const MAX_LENGTH: f64 = 1e50;

impl Parts {
    /// Checks every invariant that queries rely on:
    ///
    /// - The levels hold the nodes, coarsest first, and the coarsest level is the root alone. Free levels are
    ///   the coarsest, and level 0 is not free.
    /// - The nodes form one tree: each child is one level finer and names its parent, and only level 0 has
    ///   leaves. The children follow one another in the order of their parents.
    /// - The hull vertices follow one another in the order of the nodes, and so do the patch triangles. Each
    ///   hull has a vertex, and an extreme one; the points added to it stand right before. Each node has
    ///   triangles unless its level is free; they name three different vertices of its hull.
    /// - Numbers are finite, and areas, radii and distances not negative; the tolerance is between 0 and 1;
    ///   lengths are at most 1e50 m, and the bounding radius is at least 1e-50 m. Hulls lie within their
    ///   bounding spheres, to within 1e-9 of the object's bounding radius. The inertia tensor is symmetric
    ///   and positive definite.
    ///
    /// The bounds that s, h and the spheres put on the descendants are not checked: it would take as long as
    /// to compute them.
    ///
    /// # Errors
    /// [`ClodError::Invalid`], which names the first element that breaks an invariant.
    pub fn validate(&self) -> Result<(), ClodError> {
        self.validate_source()?;
        self.validate_levels()?;
        let mut next = (0, 0);
        for index in 0..self.nodes.len() {
            next = self
                .validate_node(index, next)
                .map_err(|what| ClodError::invalid(format!("node {index}"), what))?;
        }
        for (what, end, count) in [
            ("hull vertices", next.0, self.vertices.len()),
            ("patch triangles", next.1, self.triangles.len()),
        ] {
            if end as usize != count {
                return Err(ClodError::invalid(what, format!("the nodes use {end} of {count}")));
            }
        }
        let mut next_child = 1;
        for (index, node) in self.nodes.iter().enumerate().filter(|(_, node)| !node.children.is_empty()) {
            if node.children.start != next_child {
                let what = format!("its children are {:?}: they should begin at {next_child}", node.children);
                return Err(ClodError::invalid(format!("node {index}"), what));
            }
            next_child = node.children.end;
        }
        Ok(())
    }

    fn validate_source(&self) -> Result<(), ClodError> {
        let source = &self.source;
        let inertia = source.unit_inertia;
        let [x, y, z] = [inertia.x_axis, inertia.y_axis, inertia.z_axis];
        let positive_definite =
            x.x > 0.0 && x.x * y.y > x.y * y.x && inertia.determinant() > 0.0 && inertia.is_finite();
        let asymmetry =
            (inertia - inertia.transpose()).to_cols_array().iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        let complaint = if !(1.0 / MAX_LENGTH..=MAX_LENGTH).contains(&source.bounding_radius) {
            "the bounding radius is not a positive number within range"
        } else if !(0.0..=1.0).contains(&source.tolerance) {
            "the tolerance is not between 0 and 1 of the bounding radius"
        } else if !within_range(source.center) || !within_range(source.center_of_mass) {
            "the centre, or the centre of mass, is not finite and within range"
        } else if !(source.volume.is_finite() && source.volume >= 0.0) {
            "the volume is negative or not a finite number"
        } else if !positive_definite || asymmetry > SPHERE_SLACK * (x.x + y.y + z.z) {
            "the inertia tensor is not symmetric and positive definite"
        } else {
            return Ok(());
        };
        Err(ClodError::invalid("source", complaint))
    }

    fn validate_levels(&self) -> Result<(), ClodError> {
        let counts = [
            ("levels", self.levels.len()),
            ("nodes", self.nodes.len()),
            ("hull vertices", self.vertices.len()),
            ("patch triangles", self.triangles.len()),
        ];
        for (what, count) in counts {
            if count >= u32::MAX as usize {
                return Err(ClodError::invalid(
                    what,
                    format!("there are {count}, more than 32-bit indices can name"),
                ));
            }
        }
        if self.support_areas.len() != self.vertices.len() {
            return Err(ClodError::invalid(
                "support areas",
                format!("there are {} for {} hull vertices", self.support_areas.len(), self.vertices.len()),
            ));
        }
        if self.levels.is_empty() {
            return Err(ClodError::invalid("levels", "there are none"));
        }
        let mut next = 0;
        for (index, level) in self.levels.iter().enumerate().rev() {
            let finer_is_free = index > 0 && self.levels[index - 1].free;
            let complaint = if level.nodes.start != next || level.nodes.end <= next {
                format!("its nodes are {:?}, but the coarser levels end at {next}", level.nodes)
            } else if level.nodes.end as usize > self.nodes.len() {
                format!("its nodes are {:?} of {}", level.nodes, self.nodes.len())
            } else if !(level.resolution.is_finite() && level.resolution >= 0.0) {
                format!("its resolution is {:?}", level.resolution)
            } else if finer_is_free && !level.free {
                "it is not free although the finer level is".to_owned()
            } else if index == 0 && level.free {
                "it is the full mesh and cannot be free".to_owned()
            } else if next == 0 && level.nodes.end != 1 {
                format!("it is the coarsest and should be the root alone, but has {} nodes", level.nodes.end)
            } else {
                next = level.nodes.end;
                continue;
            };
            return Err(ClodError::invalid(format!("level {index}"), complaint));
        }
        if next as usize != self.nodes.len() {
            return Err(ClodError::invalid(
                "levels",
                format!("they hold {next} of {} nodes", self.nodes.len()),
            ));
        }
        Ok(())
    }

    /// Checks a node whose hull vertices and triangles should begin at `next`; returns where they end.
    fn validate_node(&self, index: usize, next: (u32, u32)) -> Result<(u32, u32), String> {
        let node = &self.nodes[index];
        self.validate_links(index as u32, node)?;
        let first = next.0.saturating_add(node.added);
        follows(&node.vertices, first, self.vertices.len())
            .map_err(|what| format!("its hull vertices {what}"))?;
        follows(&node.triangles, next.1, self.triangles.len())
            .map_err(|what| format!("its triangles {what}"))?;
        let free = self.levels[node.level as usize].free;
        let hull_size = node.vertices.end - node.vertices.start;
        if !(1..=hull_size).contains(&node.extreme) {
            return Err(format!("{} of its {hull_size} hull vertices are said to be extreme", node.extreme));
        }
        if free != node.triangles.is_empty() {
            return Err(if free { "it is free but has triangles" } else { "it has no triangles" }.to_owned());
        }
        for triangle in self.patch(node) {
            let [a, b, c] = *triangle;
            if a.max(b).max(c) >= hull_size || a == b || b == c || c == a {
                return Err(format!(
                    "triangle {triangle:?} does not name three of its {hull_size} hull vertices"
                ));
            }
        }

        if !within_range(node.center) {
            return Err("its centre is not finite and within range".to_owned());
        }
        for (what, value) in [("radius", node.radius), ("deviation", node.deviation), ("h", node.hausdorff)] {
            if !(0.0..=MAX_LENGTH).contains(&value) {
                return Err(format!("its {what} is {value:?}"));
            }
        }
        let reach = node.radius
            + SPHERE_SLACK * self.source.bounding_radius
            + 4.0 * f64::EPSILON * node.center.length();
        let own = next.0 as usize..node.vertices.end as usize;
        for (i, (vertex, area)) in self.vertices[own.clone()].iter().zip(&self.support_areas[own]).enumerate()
        {
            if !within_range(*vertex) || vertex.distance(node.center) > reach {
                let at = vertex.to_array();
                return Err(format!("its hull vertex {i}, {at:?}, is not within its bounding sphere"));
            }
            if !(area.is_finite() && *area >= 0.0) {
                return Err(format!("the support area of its hull vertex {i} is {area:?}"));
            }
        }
        Ok((node.vertices.end, node.triangles.end))
    }

    /// Checks a node's place in the tree. Over all nodes: each but the root is a child of the one node that
    /// it names, one level coarser; hence every node is reached from the root, once.
    fn validate_links(&self, index: u32, node: &Node) -> Result<(), String> {
        let level =
            self.levels.get(node.level as usize).ok_or_else(|| format!("it is on level {}", node.level))?;
        if !level.nodes.contains(&index) {
            return Err(format!(
                "it is said to be on level {}, whose nodes are {:?}",
                node.level, level.nodes
            ));
        }
        if index == Self::ROOT {
            if node.parent != NO_NODE {
                return Err(format!("it is the root and has a parent, {}", node.parent));
            }
        } else if !self.nodes.get(node.parent as usize).is_some_and(|parent| parent.children.contains(&index))
        {
            return Err(format!("it is not a child of the parent that it names, {}", node.parent));
        }
        let Range { start, end } = node.children;
        if node.level == 0 {
            return if start == end && end as usize <= self.nodes.len() {
                Ok(())
            } else {
                Err(format!("it is a leaf, but its children are {start}..{end}"))
            };
        }
        let finer = &self.levels[node.level as usize - 1].nodes;
        if start >= end || start < finer.start || end > finer.end {
            return Err(format!("its children are {start}..{end}, but the next finer level is {finer:?}"));
        }
        // Stops at the first child of another parent, so that overlapping ranges cost no more than disjoint
        // ones.
        match (start..end).find(|child| self.nodes[*child as usize].parent != index) {
            Some(child) => Err(format!("its child {child} names another parent")),
            None => Ok(()),
        }
    }
}

/// Checks that a range begins at `next` and ends within `count`.
fn follows(range: &Range<u32>, next: u32, count: usize) -> Result<(), String> {
    if range.start != next || range.end < next || range.end as usize > count {
        return Err(format!("are {range:?}: they should begin at {next}, and there are {count}"));
    }
    Ok(())
}

fn within_range(point: DVec3) -> bool {
    point.abs().max_element() <= MAX_LENGTH && point.is_finite()
}
