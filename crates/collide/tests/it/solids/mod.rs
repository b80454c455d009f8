//! Procedural meshes, and hierarchies over them that are independent of the builder: given patches, and above
//! them free levels by pairing neighbours along a median split. Hulls are stored as all their vertices.
#![allow(dead_code)]

use std::collections::HashSet;

use palpate_collide::Shape;
use palpate_core::clod::{Level, NO_NODE, Node, Parts, Source};
use palpate_core::glam::{DMat3, DQuat, DVec3};
use palpate_core::{Clod, Pose, TriMesh};
use rand::{RngExt, rngs::StdRng};

/// Relation of the patches of a test hierarchy to the solid.
#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    /// A closed mesh whose patches' hulls are inside it.
    Contained,
    /// A closed mesh whose hulls may protrude.
    Loose,
    /// An open mesh.
    Open,
}

pub fn vector(rng: &mut StdRng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
}

pub fn rotation(rng: &mut StdRng) -> DQuat {
    loop {
        let q = DQuat::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        if (0.01..1.0).contains(&q.length_squared()) {
            return q.normalize();
        }
    }
}

pub fn pose(rng: &mut StdRng, translation: DVec3) -> Pose {
    Pose::new(translation, rotation(rng))
}

/// A sphere from an octahedron refined `times` times, with its radius modulated along each direction.
pub fn star(times: usize, radius: impl Fn(DVec3) -> f64) -> TriMesh {
    let mut vertices = vec![DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z];
    let mut triangles: Vec<[u32; 3]> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..times {
        let mut middles = std::collections::HashMap::new();
        let mut refined = Vec::new();
        for t in &triangles {
            let m: [u32; 3] = std::array::from_fn(|i| {
                let (p, q) = (t[i], t[(i + 1) % 3]);
                *middles.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    vertices.push((vertices[p as usize] + vertices[q as usize]).normalize());
                    vertices.len() as u32 - 1
                })
            });
            refined.extend([[t[0], m[0], m[2]], [m[0], t[1], m[1]], [m[2], m[1], t[2]], m]);
        }
        triangles = refined;
    }
    let vertices = vertices.into_iter().map(|v| v * radius(v)).collect();
    TriMesh::new(vertices, triangles).unwrap()
}

pub fn torus(major: f64, minor: f64, around: u32, across: u32) -> TriMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for i in 0..around {
        for j in 0..across {
            let u = f64::from(i) / f64::from(around) * std::f64::consts::TAU;
            let v = f64::from(j) / f64::from(across) * std::f64::consts::TAU;
            let r = major + minor * v.cos();
            vertices.push(DVec3::new(r * u.cos(), r * u.sin(), minor * v.sin()));
            let at = |i: u32, j: u32| (i % around) * across + j % across;
            triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    TriMesh::new(vertices, triangles).unwrap()
}

/// One patch per triangle.
pub fn singles(mesh: &TriMesh) -> Vec<Vec<u32>> {
    (0..mesh.triangles().len() as u32).map(|t| vec![t]).collect()
}

/// Connected patches of up to `size` triangles. Convex only when the mesh bounds a convex body.
pub fn clusters(mesh: &TriMesh, size: usize) -> Vec<Vec<u32>> {
    let mut across = std::collections::HashMap::<(u32, u32), Vec<u32>>::new();
    for (t, c) in (0u32..).zip(mesh.triangles()) {
        for i in 0..3 {
            let (p, q) = (c[i], c[(i + 1) % 3]);
            across.entry((p.min(q), p.max(q))).or_default().push(t);
        }
    }
    let mut taken = vec![false; mesh.triangles().len()];
    let mut patches = Vec::new();
    for t in 0..taken.len() as u32 {
        if taken[t as usize] {
            continue;
        }
        taken[t as usize] = true;
        let mut patch = vec![t];
        let mut next = 0;
        while next < patch.len() && patch.len() < size {
            let c = mesh.triangles()[patch[next] as usize];
            next += 1;
            for i in 0..3 {
                let (p, q) = (c[i], c[(i + 1) % 3]);
                for &other in &across[&(p.min(q), p.max(q))] {
                    if !taken[other as usize] && patch.len() < size {
                        taken[other as usize] = true;
                        patch.push(other);
                    }
                }
            }
        }
        patches.push(patch);
    }
    patches
}

/// A hierarchy over patches, and per leaf (by position in level 0) the patch's triangles.
pub fn hierarchy(mesh: &TriMesh, patches: &[Vec<u32>], kind: Kind) -> (Clod, Vec<Vec<u32>>) {
    let middle = |patch: &Vec<u32>| {
        patch.iter().map(|t| mesh.corners(*t as usize).iter().sum::<DVec3>()).sum::<DVec3>()
            / (3 * patch.len()) as f64
    };
    let mut order: Vec<Vec<u32>> = patches.to_vec();
    fn sort(order: &mut [Vec<u32>], middle: &impl Fn(&Vec<u32>) -> DVec3) {
        if order.len() < 3 {
            return;
        }
        let (low, high) = order
            .iter()
            .map(middle)
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |b, m| (b.0.min(m), b.1.max(m)));
        let extent = (high - low).to_array();
        let axis = (0..3).max_by(|&i, &j| extent[i].total_cmp(&extent[j])).unwrap();
        order.sort_by(|p, q| middle(p)[axis].total_cmp(&middle(q)[axis]));
        let half = (order.len() / 2).next_multiple_of(2);
        let (first, second) = order.split_at_mut(half);
        sort(first, middle);
        sort(second, middle);
    }
    sort(&mut order, &middle);

    // Bottom up: per level, each node's mesh vertices and children.
    let corners = |patch: &Vec<u32>| {
        let mut v: Vec<u32> = patch.iter().flat_map(|t| mesh.triangles()[*t as usize]).collect();
        v.sort_unstable();
        v.dedup();
        v
    };
    let mut levels: Vec<Vec<(Vec<u32>, usize)>> = vec![order.iter().map(|p| (corners(p), 0)).collect()];
    while levels.last().unwrap().len() > 1 {
        let merged = levels
            .last()
            .unwrap()
            .chunks(2)
            .map(|pair| {
                let mut v: Vec<u32> = pair.iter().flat_map(|(v, _)| v.clone()).collect();
                v.sort_unstable();
                v.dedup();
                (v, pair.len())
            })
            .collect();
        levels.push(merged);
    }
    let mut parts = Parts {
        levels: Vec::new(),
        nodes: Vec::new(),
        vertices: Vec::new(),
        support_areas: Vec::new(),
        triangles: Vec::new(),
        source: Source {
            vertices: mesh.vertices().len() as u32,
            triangles: mesh.triangles().len() as u32,
            tolerance: 1e-6,
            solid: kind != Kind::Open,
            bounding_radius: mesh.vertices().iter().map(|v| v.length()).fold(0.0, f64::max),
            center: DVec3::ZERO,
            volume: 0.0,
            center_of_mass: DVec3::ZERO,
            unit_inertia: DMat3::IDENTITY,
        },
    };
    let mut parents: Vec<u32> = vec![NO_NODE];
    for (height, level) in levels.iter().enumerate().rev() {
        let first = parts.nodes.len() as u32;
        let mut child = first + level.len() as u32;
        let mut next_parents = Vec::new();
        for (index, (vertices, children)) in level.iter().enumerate() {
            let start = parts.vertices.len() as u32;
            parts.vertices.extend(vertices.iter().map(|v| mesh.vertices()[*v as usize]));
            let points = &parts.vertices[start as usize..];
            let center = points.iter().sum::<DVec3>() / points.len() as f64;
            let radius = points.iter().map(|p| p.distance(center)).fold(0.0, f64::max);
            let first_triangle = parts.triangles.len() as u32;
            if height == 0 {
                for t in &order[index] {
                    let local =
                        mesh.triangles()[*t as usize].map(|v| vertices.binary_search(&v).unwrap() as u32);
                    parts.triangles.push(local);
                }
            }
            parts.nodes.push(Node {
                parent: parents[index],
                children: child..child + *children as u32,
                level: height as u32,
                vertices: start..parts.vertices.len() as u32,
                extreme: vertices.len() as u32,
                triangles: first_triangle..parts.triangles.len() as u32,
                center,
                radius,
                deviation: 0.0,
                added: 0,
                hausdorff: 0.0,
                contained: kind == Kind::Contained,
                all_real: height == 0 && kind == Kind::Contained && levels[0].len() == 1,
            });
            next_parents.extend(std::iter::repeat_n(first + index as u32, *children));
            child += *children as u32;
        }
        parents = next_parents;
        if height == 0 {
            for node in &mut parts.nodes[first as usize..] {
                node.children = 0..0;
            }
        }
        parts.levels.push(Level {
            nodes: first..parts.nodes.len() as u32,
            triangles: mesh.triangles().len() as u32,
            resolution: 1.0,
            free: height > 0,
        });
    }
    parts.levels.reverse();
    parts.support_areas = vec![0.0; parts.vertices.len()];
    (Clod::pack(&parts).expect("it is valid"), order)
}

/// A mesh with its patches, for brute force.
pub struct Body {
    pub mesh: TriMesh,
    pub clod: Clod,
    pub shape: Shape,
    /// Leaf node of each triangle.
    pub leaf_of: Vec<u32>,
    pub radius: f64,
    pub solid: bool,
    /// Triangles at each vertex.
    pub around: Vec<Vec<usize>>,
}

impl Body {
    pub fn new(mesh: TriMesh, patches: &[Vec<u32>], kind: Kind) -> Self {
        let (clod, order) = hierarchy(&mesh, patches, kind);
        let first = clod.levels[0].nodes.start;
        let mut leaf_of = vec![0; mesh.triangles().len()];
        for (leaf, patch) in (first..).zip(&order) {
            patch.iter().for_each(|t| leaf_of[*t as usize] = leaf);
        }
        let mut around = vec![Vec::new(); mesh.vertices().len()];
        for (t, corners) in mesh.triangles().iter().enumerate() {
            corners.iter().for_each(|v| around[*v as usize].push(t));
        }
        let radius = clod.source.bounding_radius;
        Self {
            mesh,
            shape: Shape::new(clod.clone()),
            clod,
            leaf_of,
            radius,
            solid: kind != Kind::Open,
            around,
        }
    }

    /// Triangles that share a vertex with one, itself included.
    pub fn neighbours(&self, triangle: usize) -> HashSet<usize> {
        self.mesh.triangles()[triangle].iter().flat_map(|v| self.around[*v as usize].clone()).collect()
    }
}
