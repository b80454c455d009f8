//! Hierarchies of random shape over the patches of a built one.

use std::collections::HashSet;

use palpate::core::Clod;
use palpate::core::clod::{Level, NO_NODE, Node, Parts};
use palpate::glam::DVec3;
use rand::RngExt as _;
use rand::rngs::StdRng;
use rand::seq::SliceRandom as _;

/// Node under construction: the points that its hull has to enclose, and its children on the level below.
struct Group {
    points: Vec<DVec3>,
    /// Indices in the order of the level below.
    children: std::ops::Range<usize>,
}

/// Returns a hierarchy with the leaves of another one, and above them free levels of nodes with one to five
/// children each. Children are taken in the order of the leaves along a random line or, one time in four, in
/// random order. Every hull encloses all below it.
///
/// # Panics
/// If the hierarchy is not valid.
/// If the hierarchy is not valid.
pub fn random_tree(built: &Clod, random: &mut StdRng) -> Clod {
    let mut leaves: Vec<Node> = built.leaves().collect();
    if random.random_range(0..4) == 0 {
        leaves.shuffle(random);
    } else {
        let line = DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0)));
        leaves.sort_by(|a, b| a.center.dot(line).total_cmp(&b.center.dot(line)));
    }
    let of_leaf = |node: &Node| Group { points: built.extreme(node).to_vec(), children: 0..0 };
    let mut levels: Vec<Vec<Group>> = vec![leaves.iter().map(of_leaf).collect()];
    while let Some(below) = levels.last().filter(|level| level.len() > 1) {
        let mut level = Vec::new();
        let mut first = 0;
        while first < below.len() {
            let end = (first + random.random_range(1..6)).min(below.len());
            let bits = |p: &DVec3| p.to_array().map(f64::to_bits);
            let mut seen = HashSet::new();
            let mut points: Vec<DVec3> = below[first..end].iter().flat_map(|g| &g.points).copied().collect();
            points.retain(|p| seen.insert(bits(p)));
            level.push(Group { points, children: first..end });
            first = end;
        }
        levels.push(level);
    }

    let mut parts = Parts {
        levels: Vec::new(),
        nodes: Vec::new(),
        vertices: Vec::new(),
        support_areas: Vec::new(),
        triangles: Vec::new(),
        source: built.source.clone(),
    };
    let mut parents = vec![NO_NODE];
    for (height, level) in levels.iter().enumerate().rev() {
        let first = parts.nodes.len() as u32;
        let below = first + level.len() as u32;
        let mut next_parents = Vec::new();
        for (place, group) in level.iter().enumerate() {
            let (start, first_triangle) = (parts.vertices.len() as u32, parts.triangles.len() as u32);
            let node = if height == 0 {
                parts.vertices.extend(built.hull(&leaves[place]));
                parts.triangles.extend(built.patch(&leaves[place]));
                Node { added: 0, ..leaves[place].clone() }
            } else {
                parts.vertices.extend_from_slice(&group.points);
                let center = group.points.iter().sum::<DVec3>() / group.points.len() as f64;
                let radius = group.points.iter().map(|p| p.distance(center)).fold(0.0, f64::max);
                Node {
                    extreme: group.points.len() as u32,
                    center,
                    radius,
                    hausdorff: 0.0,
                    contained: false,
                    all_real: false,
                    ..built.node(Clod::ROOT)
                }
            };
            let children = below + group.children.start as u32..below + group.children.end as u32;
            next_parents.extend(group.children.clone().map(|_| first + place as u32));
            parts.nodes.push(Node {
                parent: parents[place],
                children: if height == 0 { 0..0 } else { children },
                level: height as u32,
                vertices: start..parts.vertices.len() as u32,
                triangles: first_triangle..parts.triangles.len() as u32,
                added: 0,
                ..node
            });
        }
        parents = next_parents;
        let nodes = first..parts.nodes.len() as u32;
        parts.levels.push(Level { nodes, free: height > 0, ..built.levels[0].clone() });
    }
    parts.levels.reverse();
    parts.support_areas = vec![0.0; parts.vertices.len()];
    Clod::pack(&parts).expect("the tree is valid")
}
