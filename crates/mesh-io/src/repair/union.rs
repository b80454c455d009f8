//! Union of solids that overlap, and cutting of open surfaces along the lines in which they intersect.
//!
//! The arrangement of the triangles (Zhou et al. 2016, "Mesh arrangements for solid geometry"; crate
//! `manifold-rust`, in exact arithmetic) cuts every triangle along its intersections with others, so that
//! pieces meet only at common edges. Winding numbers of the closed components say which sides of a piece are
//! inside. A piece with one side inside is a piece of the union's surface; a piece with both sides inside is
//! hidden and dropped; a piece with both sides outside belongs to an open surface, and stays.
//!
//! A component may be inside out in places, where it crosses itself. Inside is therefore where the winding
//! number is not 0, so that nothing that can be touched from outside is lost.
//!
//! Vertices where triangles cross are rounded, which can make pieces cross again by some roundings. The next
//! round finds them.

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::DVec3;
use manifold_rust::linalg::Vec3;
use manifold_rust::robust::cells::{ANTI, NORMAL, Wall, build_cells, windings};
use manifold_rust::robust::exact::rational::R3;
use manifold_rust::robust::intersection_graph::{IntersectionGraph, Piece as GraphPiece, build_graph};

use super::orientation::Components;
use super::{Piece, Work, root};
use crate::intersect::{Boxes, unnormalised};
use crate::weld::equal_positions;

/// Largest number of intersecting pairs in a group of components that is united, some ten microseconds each.
const MAX_PAIRS: usize = 500_000;

/// Largest number, over a group's triangles, of pairs of others that cut one and overlap in it by their
/// boxes. Their segments may cross there, and each costs 0.02 to 0.1 ms of exact arithmetic.
const MAX_COMPARED: usize = 200_000;

/// Number of intersections of a group from which, if it is as many as there are triangles, it is a tangle.
const MIN_TANGLE: usize = 200;

/// Largest number of others that one triangle of a group may intersect, for the depth of recursion.
const MAX_CUTS: usize = 5_000;

/// Share of a group's area up to which walls without thickness are folds.
const MAX_FOLDS: f64 = 1e-3;

/// Components whose boxes are connected by overlaps, of which some intersect.
#[derive(Default)]
struct Group {
    /// The triangles of closed components.
    solid: Vec<u32>,
    /// The triangles of open components that intersect others.
    open: Vec<u32>,
    /// Number of closed components.
    shells: usize,
}

/// What the arrangement leaves of a group.
struct Remainder {
    /// Positions of vertices that pieces use.
    points: Vec<DVec3>,
    /// The triangle of the group that each kept piece lies on, as an index into its solid and then its open
    /// triangles; the corners of the piece; and whether it is turned over.
    pieces: Vec<(usize, [u32; 3], bool)>,
    /// Number of pieces that each triangle was cut into.
    cuts: Vec<u32>,
}

impl Work {
    /// Unites the closed components that overlap, and cuts open ones along their intersections. Returns
    /// whether anything changed. `pairs` are all triangles that intersect.
    pub(super) fn unite(&mut self, pairs: &[[u32; 2]]) -> bool {
        if pairs.is_empty() || pairs.len() >= MAX_PAIRS {
            return false;
        }
        let mut crossed = vec![false; self.pieces.len()];
        pairs.iter().flatten().for_each(|t| crossed[*t as usize] = true);
        let groups = self.groups(pairs);
        let mut gone = vec![false; self.pieces.len()];
        let mut made = Vec::new();
        for group in groups {
            // A fault of the library must not end the caller's program: the intersections are cut out then.
            let Ok(remainder) = catch_unwind(AssertUnwindSafe(|| self.arrange(&group, &crossed))) else {
                continue;
            };
            let triangles: Vec<u32> = group.solid.iter().chain(&group.open).copied().collect();
            let mut kept = vec![false; triangles.len()];
            remainder.pieces.iter().for_each(|(triangle, _, _)| kept[*triangle] = true);
            let cut = remainder.cuts.iter().filter(|count| **count > 1).count();
            let hidden = kept.iter().filter(|kept| !**kept).count();
            if cut == 0 && hidden == 0 {
                continue;
            }
            self.summary.cut_triangles += cut;
            self.summary.hidden_triangles += hidden;
            self.summary.united_components += group.shells;
            triangles.iter().for_each(|t| gone[*t as usize] = true);
            let vertex_of = self.vertices_at(&remainder.points);
            for (triangle, corners, turned) in remainder.pieces {
                let before = self.pieces[triangles[triangle] as usize];
                let piece =
                    Piece { corners: corners.map(|v| vertex_of[v as usize]), turned: before.turned ^ turned };
                made.push(piece);
            }
        }
        if made.is_empty() {
            return false;
        }
        self.retain(|i| !gone[i]);
        self.pieces.extend(made);
        (self.changed, self.united) = (true, true);
        true
    }

    fn groups(&self, pairs: &[[u32; 2]]) -> Vec<Group> {
        let mesh = self.mesh();
        let components = Components::new(&mesh);
        let members = &self.bodies(&components);
        let closed: Vec<bool> = members.iter().map(|triangles| self.encloses(triangles)).collect();
        let mut component = vec![0u32; self.pieces.len()];
        for (c, triangles) in members.iter().enumerate() {
            triangles.iter().for_each(|t| component[*t as usize] = c as u32);
        }
        let mut partners: Vec<Vec<u32>> = vec![Vec::new(); self.pieces.len()];
        for [a, b] in pairs {
            partners[*a as usize].push(*b);
            partners[*b as usize].push(*a);
        }
        let mut crossed = vec![false; members.len()];
        for triangle in pairs.iter().flatten() {
            crossed[component[*triangle as usize] as usize] = true;
        }
        let boxes = Boxes::new(members.len(), |c| {
            let corners = || members[c].iter().flat_map(|t| mesh.corners(*t as usize));
            let [low, high] = corners()
                .fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], p| [low.min(p), high.max(p)]);
            (closed[c] || crossed[c]).then_some([low, high, high])
        });
        let tree = boxes.tree();
        let mut group: Vec<u32> = (0..members.len() as u32).collect();
        let mut found = Vec::new();
        for c in 0..members.len() {
            boxes.overlapping(c, &boxes, &tree, &mut found);
            for other in &found {
                let (a, b) = (root(&mut group, c as u32), root(&mut group, *other));
                group[a.max(b) as usize] = a.min(b);
            }
        }
        let mut groups: Vec<Group> = (0..members.len()).map(|_| Group::default()).collect();
        let (mut total, mut compared) = (vec![0; members.len()], vec![0; members.len()]);
        for (c, triangles) in members.iter().enumerate() {
            let own = root(&mut group, c as u32) as usize;
            if closed[c] {
                groups[own].solid.extend(triangles);
                groups[own].shells += 1;
            } else if crossed[c] {
                groups[own].open.extend(triangles);
            }
            for t in triangles {
                let cutting = &partners[*t as usize];
                total[own] += cutting.len();
                if cutting.len() > MAX_CUTS {
                    compared[own] = MAX_COMPARED + 1;
                } else if compared[own] <= MAX_COMPARED {
                    compared[own] += self.crowding(*t, cutting);
                }
            }
        }
        (groups.into_iter().enumerate())
            .filter(|(g, group)| {
                // Open surfaces that cross all over are no more than that when they are cut.
                let is_open = group.open.len() > group.solid.len();
                let is_tangle = is_open && total[*g] >= group.open.len().max(MIN_TANGLE);
                (1..=2 * MAX_PAIRS).contains(&total[*g]) && compared[*g] <= MAX_COMPARED && !is_tangle
            })
            .map(|(_, mut group)| {
                group.solid.sort_unstable();
                group.open.sort_unstable();
                group
            })
            .collect()
    }

    /// The number of pairs of the triangles that cut `t` whose boxes overlap in the box of `t`.
    fn crowding(&self, t: u32, cutting: &[u32]) -> usize {
        let bounds = |t: u32| {
            let [a, b, c] = self.positions(self.pieces[t as usize].corners);
            [a.min(b).min(c), a.max(b).max(c)]
        };
        let common = |a: [DVec3; 2], b: [DVec3; 2]| [a[0].max(b[0]), a[1].min(b[1])];
        let own = bounds(t);
        let parts: Vec<[DVec3; 2]> = cutting.iter().map(|other| common(own, bounds(*other))).collect();
        let overlap = |i: usize, j: usize| {
            let [low, high] = common(parts[i], parts[j]);
            low.cmple(high).all()
        };
        (0..parts.len()).map(|i| (0..i).filter(|j| overlap(i, *j)).count()).sum()
    }

    /// Components that share edges, as one body where they enclose a volume together only; else as they are.
    fn bodies(&self, components: &Components) -> Vec<Vec<u32>> {
        let same = equal_positions(&self.points);
        let members = components.members();
        let mut body: Vec<u32> = (0..members.len() as u32).collect();
        let mut at_edge: HashMap<[u32; 2], u32> = HashMap::new();
        for (c, triangles) in (0u32..).zip(members).filter(|(c, _)| !components.is_closed(*c as usize)) {
            for [u, v] in triangles.iter().flat_map(|t| directed(self.pieces[*t as usize].corners, &same)) {
                let other = *at_edge.entry([u.min(v), u.max(v)]).or_insert(c);
                let (a, b) = (root(&mut body, c), root(&mut body, other));
                body[a.max(b) as usize] = a.min(b);
            }
        }
        let mut joined: Vec<Vec<usize>> = vec![Vec::new(); members.len()];
        for c in 0..members.len() {
            joined[root(&mut body, c as u32) as usize].push(c);
        }
        let mut bodies = Vec::new();
        for parts in joined.iter().filter(|parts| !parts.is_empty()) {
            let all: Vec<u32> = parts.iter().flat_map(|c| &members[*c]).copied().collect();
            if parts.len() == 1 || self.encloses(&all) {
                bodies.push(all);
            } else {
                bodies.extend(parts.iter().map(|c| members[*c].clone()));
            }
        }
        bodies
    }

    /// Whether the sides of triangles cancel, by position, so that they enclose a volume.
    fn encloses(&self, triangles: &[u32]) -> bool {
        // Vertices at one position count as one: a body may have been cut open along a seam of copies.
        let mut sum: HashMap<[[u64; 3]; 2], i64> = HashMap::new();
        let key = |v: u32| self.points[v as usize].to_array().map(|x| (x + 0.0).to_bits());
        for t in triangles {
            let [a, b, c] = self.pieces[*t as usize].corners.map(key);
            for [u, v] in [[a, b], [b, c], [c, a]] {
                *sum.entry([u.min(v), u.max(v)]).or_default() += i64::from(u < v) - i64::from(v < u);
            }
        }
        sum.values().all(|sum| *sum == 0)
    }

    fn arrange(&self, group: &Group, crossed: &[bool]) -> Remainder {
        let corners = |t: &u32| {
            self.positions(self.pieces[*t as usize].corners).map(|p| Vec3 { x: p.x, y: p.y, z: p.z })
        };
        let solid: Vec<[Vec3; 3]> = group.solid.iter().map(corners).collect();
        let open: Vec<[Vec3; 3]> = group.open.iter().map(corners).collect();
        let graph = self.graph([(&group.solid, &solid), (&group.open, &open)], crossed);
        let complex = build_cells(&graph);
        // Windings about the closed components; open ones have none.
        let winding = windings(&graph, &complex, [&solid, &[]]);
        let origin = |piece: usize| {
            let piece = &graph.pieces[piece];
            piece.tri + if piece.mesh == 0 { 0 } else { solid.len() }
        };
        let mut cuts = vec![0; solid.len() + open.len()];
        (0..graph.pieces.len()).for_each(|piece| cuts[origin(piece)] += 1);
        let points: Vec<DVec3> = graph.verts_f64.iter().map(|p| DVec3::new(p.x, p.y, p.z)).collect();
        // Walls of solids with both sides outside have no thickness: they stay if they are more than folds.
        let (mut pieces, mut thin) = (Vec::new(), Vec::new());
        for &Wall { rep, .. } in &complex.walls {
            let inside = |side| winding.w[complex.cell(rep, side)][0] != 0;
            let [a, b, c] = graph.pieces[rep].vi;
            match (inside(NORMAL), inside(ANTI)) {
                (true, true) => {}
                (true, false) => pieces.push((origin(rep), [a, c, b], true)),
                (false, false) if origin(rep) < solid.len() => thin.push((origin(rep), [a, b, c], false)),
                (false, _) => pieces.push((origin(rep), [a, b, c], false)),
            }
        }
        let area = |pieces: &[(usize, [u32; 3], bool)]| -> f64 {
            let doubled = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).length();
            pieces.iter().map(|(_, corners, _)| doubled(corners.map(|v| points[v as usize]))).sum()
        };
        if area(&thin) > MAX_FOLDS * area(&pieces) {
            pieces.append(&mut thin);
        }
        Remainder { points, pieces, cuts }
    }

    /// The arrangement. Only the triangles that intersect others are given to the library, which would search
    /// for the pairs anew, along the axes alone; the others are whole pieces.
    fn graph(&self, meshes: [(&[u32], &[[Vec3; 3]]); 2], crossed: &[bool]) -> IntersectionGraph {
        let cut = meshes.map(|(triangles, corners)| {
            let list = triangles.iter().zip(corners).enumerate();
            list.filter(|(_, (t, _))| crossed[**t as usize])
                .map(|(i, (_, c))| (i, *c))
                .unzip::<_, _, Vec<_>, Vec<_>>()
        });
        let mut graph = build_graph(&cut[0].1, &cut[1].1);
        for piece in &mut graph.pieces {
            piece.tri = cut[usize::from(piece.mesh)].0[piece.tri];
        }
        let key = |p: &Vec3| [p.x, p.y, p.z].map(|x| (x + 0.0).to_bits());
        // Where roundings of points coincide, the one that is exact is meant.
        let mut number: HashMap<[u64; 3], u32> = HashMap::new();
        for (i, p) in (0u32..).zip(&graph.verts_f64) {
            if graph.verts[i as usize] == R3::from_vec3(*p) {
                number.insert(key(p), i);
            }
        }
        for (mesh, (triangles, corners)) in (0u8..).zip(meshes) {
            for (tri, (t, corners)) in triangles.iter().zip(corners).enumerate() {
                if crossed[*t as usize] {
                    continue;
                }
                let vi = corners.map(|p| {
                    *number.entry(key(&p)).or_insert_with(|| {
                        graph.verts.push(R3::from_vec3(p));
                        graph.verts_f64.push(p);
                        graph.verts.len() as u32 - 1
                    })
                });
                graph.pieces.push(GraphPiece { mesh, tri, vi, flipped: false });
            }
        }
        graph
    }

    /// The vertices at some positions: the first of the mesh that is there, or a new one.
    fn vertices_at(&mut self, positions: &[DVec3]) -> Vec<u32> {
        let before = self.points.len();
        self.points.extend_from_slice(positions);
        let same = equal_positions(&self.points);
        self.points.truncate(before);
        let mut number = vec![u32::MAX; positions.len()];
        for (i, &first) in same[before..].iter().enumerate() {
            number[i] = match (first as usize).checked_sub(before) {
                None => first,
                Some(earlier) if earlier < i => number[earlier],
                Some(_) => {
                    self.add_vertex(unnormalised(positions[i], self.exponent), positions[i], false);
                    self.points.len() as u32 - 1
                }
            };
        }
        number
    }
}

/// The sides of a triangle in its direction, between classes of equal positions.
fn directed(corners: [u32; 3], same: &[u32]) -> [[u32; 2]; 3] {
    let [a, b, c] = corners.map(|v| same[v as usize]);
    [[a, b], [b, c], [c, a]]
}
