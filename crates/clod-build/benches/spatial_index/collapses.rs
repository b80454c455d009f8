//! The collapses that the indices are put through: the shortest edges first, to their midpoints, each vertex at most
//! once in a pass.

use std::collections::HashSet;

use glam::DVec3;
use palpate_core::TriMesh;
use palpate_models::Model;

use crate::box_tree::{Bounds, EMPTY};

pub struct Collapse {
    /// The box around the fan of the merged vertex.
    pub query: Bounds,
    pub moved: Vec<(u32, Bounds)>,
    pub removed: Vec<u32>,
}

pub struct Collapses {
    /// The boxes of the triangles before.
    pub boxes: Vec<Bounds>,
    pub all: Vec<Collapse>,
}

fn bounds(points: impl Iterator<Item = DVec3>) -> Bounds {
    points.fold(EMPTY, |(low, high), p| (low.min(p), high.max(p)))
}

impl Collapses {
    pub fn of_a_torus(triangles: usize) -> Self {
        let mesh = Model::Torus.generate(triangles).expect("within range");
        let mut points = mesh.vertices().to_vec();
        let mut triangles = mesh.triangles().to_vec();
        // Which triangles of the first mesh those of the mesh at hand are.
        let mut origin: Vec<u32> = (0..triangles.len() as u32).collect();
        let first =
            triangles.iter().map(|t| bounds(t.iter().map(|v| points[*v as usize]))).collect::<Vec<_>>();
        let mut all = Vec::new();
        while triangles.len() > first.len() / 16 {
            let mesh = TriMesh::new(points.clone(), triangles.clone()).expect("its vertices are there");
            let adjacency = mesh.adjacency();
            let mut edges = adjacency.edges().to_vec();
            let length = |[a, b]: [u32; 2]| points[a as usize].distance_squared(points[b as usize]);
            edges.sort_by(|e, f| length(*e).total_cmp(&length(*f)));
            let mut locked = vec![false; points.len()];
            let neighbours = |v: u32| -> HashSet<u32> {
                let corners =
                    adjacency.vertex_triangles(v).iter().flat_map(|t| mesh.triangles()[*t as usize]);
                corners.filter(|w| *w != v).collect()
            };
            let before = triangles.len();
            let mut gone = 0;
            for [kept, lost] in edges {
                if locked[kept as usize] || locked[lost as usize] {
                    continue;
                }
                let around = [neighbours(kept), neighbours(lost)];
                if around[0].intersection(&around[1]).count() != 2 {
                    continue;
                }
                for v in around.iter().flatten() {
                    locked[*v as usize] = true;
                }
                points[kept as usize] = 0.5 * (points[kept as usize] + points[lost as usize]);
                let mut fan: Vec<u32> =
                    [kept, lost].iter().flat_map(|v| adjacency.vertex_triangles(*v)).copied().collect();
                fan.sort_unstable();
                fan.dedup();
                let (removed, moved): (Vec<u32>, Vec<u32>) = fan
                    .into_iter()
                    .partition(|t| [kept, lost].iter().all(|v| mesh.triangles()[*t as usize].contains(v)));
                let moved: Vec<(u32, Bounds)> = moved
                    .into_iter()
                    .map(|t| {
                        let corners = &mut triangles[t as usize];
                        *corners = corners.map(|v| if v == lost { kept } else { v });
                        (origin[t as usize], bounds(corners.iter().map(|v| points[*v as usize])))
                    })
                    .collect();
                for t in &removed {
                    triangles[*t as usize] = [kept; 3];
                }
                gone += removed.len();
                let query = moved.iter().fold(EMPTY, |a, (_, b)| (a.0.min(b.0), a.1.max(b.1)));
                let removed = removed.into_iter().map(|t| origin[t as usize]).collect();
                all.push(Collapse { query, moved, removed });
                // A quarter a pass, so that edges stay of like length.
                if 4 * gone > before {
                    break;
                }
            }
            if gone == 0 {
                break;
            }
            let left: Vec<usize> =
                (0..triangles.len()).filter(|t| triangles[*t][0] != triangles[*t][1]).collect();
            origin = left.iter().map(|t| origin[*t]).collect();
            triangles = left.iter().map(|t| triangles[*t]).collect();
        }
        Self { boxes: first, all }
    }
}
