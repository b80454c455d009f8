//! Repair: turns any triangles into an oriented 2-manifold, with or without boundary, that does not intersect
//! itself, and counts the changes.
//!
//! The steps, in this order, repeated until they change nothing:
//!
//! 1. triangles with a coordinate that is not finite and duplicates are dropped; triangles without area are
//!    dropped, or removed such that the triangles around them stay connected ([`slivers`]); cracks along
//!    which two borders run, with vertices of their own, are closed;
//! 2. triangles are turned to agree with their neighbours, closed components to face outwards
//!    ([`orientation`]);
//! 3. where sheets meet at an edge or a vertex, each sheet gets its own copy of it ([`parting`]);
//! 4. solids that overlap are united, and open surfaces cut along their intersections ([`union`]);
//! 5. where that is not possible, some of the triangles that intersect are dropped, so as to lose little
//!    area, and the holes that this makes are closed where that is possible without another intersection
//!    ([`crossings`], [`holes`]);
//! 6. openings smaller than a fiftieth of the mesh are closed.
//!
//! Vertices move only where a crack is closed, an edge is shorter than rounding, or planes that intersect are
//! apart by rounding. Surface is added over cut holes and small openings alone. Where a hole stays open, so
//! does the mesh. What step 5 loses is measured ([`effect`]).

mod crossings;
mod duplicates;
mod effect;
mod holes;
mod orientation;
mod parting;
mod slivers;
mod union;

use std::fmt;

pub use effect::RepairEffect;
use glam::DVec3;
use orientation::Components;
use palpate_core::TriMesh;
use serde::Serialize;

use crate::intersect::{normalise, unnormalised};
use crate::weld;

/// Numbers of changes that [`repair`] made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RepairSummary {
    /// Triangles dropped because a corner is infinite or not a number.
    pub nonfinite_triangles: usize,
    /// Triangles removed because two corners are at the same position, or the height over the longest side
    /// is below 10⁻¹² bounding radii, or below the width of the crack that they border.
    pub degenerate_triangles: usize,
    /// Triangles dropped because an earlier one has the same three positions, in either orientation.
    pub duplicate_triangles: usize,
    /// Vertices merged with another: at triangles without area, that is closer than 10⁻¹² bounding radii; at
    /// a crack, than 5 · 10⁻⁴ bounding radii.
    pub merged_vertices: usize,
    /// Triangles cut in two or more at a vertex that lies on one of their edges: a vertex of a crack (a
    /// T-junction) or of a triangle without area.
    pub split_triangles: usize,
    /// Triangles turned over, to agree with their neighbours or to face outwards.
    pub flipped_triangles: usize,
    /// Closed components that were turned as a whole to face outwards.
    pub inverted_components: usize,
    /// Components without a consistent orientation (like a Möbius strip), which were cut open.
    pub nonorientable_components: usize,
    /// Copies of vertices made to separate sheets that meet at an edge or a vertex.
    pub duplicated_vertices: usize,
    /// Triangles dropped at an edge where sheets meet, because copies of its vertices do not separate them.
    pub unparted_triangles: usize,
    /// Closed components that overlapped others or themselves, and were united.
    pub united_components: usize,
    /// Triangles cut in two or more along the lines in which they intersect others.
    pub cut_triangles: usize,
    /// Triangles dropped because they are inside the union.
    pub hidden_triangles: usize,
    /// Triangles dropped because they intersect others and could not be united with them.
    pub intersecting_triangles: usize,
    /// Triangles around intersecting ones that were removed as well, so that the hole could be closed.
    pub surrounding_triangles: usize,
    /// Holes left by triangles that were dropped for intersecting others, and closed again.
    pub filled_holes: usize,
    /// Triangles made to close those holes.
    pub filling_triangles: usize,
    /// Vertices dropped because no triangle uses them, or not any longer.
    pub unreferenced_vertices: usize,
}

impl fmt::Display for RepairSummary {
    /// Writes the changes in words; "nothing" if there are none.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let done = [
            (
                self.nonfinite_triangles,
                "triangles with a coordinate that is infinite or not a number dropped",
            ),
            (self.degenerate_triangles, "triangles without area removed"),
            (self.duplicate_triangles, "duplicate triangles dropped"),
            (self.merged_vertices, "vertices merged"),
            (self.split_triangles, "triangles split at a vertex on their edge"),
            (self.flipped_triangles, "triangles turned over"),
            (self.inverted_components, "closed components turned to face outwards"),
            (self.nonorientable_components, "components that cannot be oriented cut open"),
            (self.duplicated_vertices, "vertices copied to separate sheets"),
            (self.unparted_triangles, "triangles dropped where sheets cannot be separated"),
            (self.united_components, "closed components united"),
            (self.cut_triangles, "triangles cut where they intersect"),
            (self.hidden_triangles, "triangles inside the union dropped"),
            (self.intersecting_triangles, "intersecting triangles dropped"),
            (self.surrounding_triangles, "triangles around them replaced"),
            (self.filled_holes, "holes that these left closed"),
            (self.filling_triangles, "triangles made to close them"),
            (self.unreferenced_vertices, "unused vertices dropped"),
        ];
        let mut first = true;
        for (count, what) in done.iter().filter(|(count, _)| *count > 0) {
            let comma = if first { "" } else { ", " };
            write!(f, "{comma}{what}: {count}")?;
            first = false;
        }
        if first { f.write_str("nothing") } else { Ok(()) }
    }
}

/// Largest number of rounds of all steps, before triangles that are still faulty are dropped. More rounds
/// keep more of badly broken meshes, and take longer.
const MAX_ROUNDS: usize = 8;

/// Number of the first rounds in which intersecting parts are united rather than cut out. The first unites;
/// others unite what rounding made intersect.
const UNITING_ROUNDS: usize = 5;

/// Number of the first rounds in which cracks are closed whose sides do not coincide exactly.
const CLOSING_ROUNDS: usize = 2;

/// Number of intersecting pairs that are united even if there were fewer in the round before.
const ALWAYS_UNITED: usize = 100;

/// Difference, in sizes of the mesh, up to which coordinates along an axis are made equal where parts
/// intersect.
const LEVEL: f64 = 1e-12;

/// Largest number of times that all rounds are repeated.
const MAX_PASSES: usize = 2;

/// Repairs a mesh: see the summary's fields for what is done. [Weld](crate::weld()) it first: triangles are
/// neighbours only if they have the indices of two vertices in common.
///
/// The result has no self-intersection, and its [validation](TriMesh::validate) reports a 2-manifold that is
/// oriented, without degenerate, duplicate or non-finite triangles and, if it is closed, of a volume that is
/// not negative. It may be empty. Copies of a vertex that separate two sheets are at the same position:
/// welding such a mesh again undoes the separation. Repairing it again changes nothing, but in some tangles
/// of faces that lie on each other. Triangles that are kept stay in order; those that are made come last.
pub fn repair(mesh: &TriMesh) -> (TriMesh, RepairSummary) {
    let (repaired, summary, _) = repair_measured(mesh);
    (repaired, summary)
}

/// [Repairs](repair) a mesh, and measures what that does to its surface.
pub(crate) fn repair_measured(mesh: &TriMesh) -> (TriMesh, RepairSummary, RepairEffect) {
    let mut work = Work::new(mesh);
    work.drop_nonfinite();
    let nonorientable = Components::new(&work.mesh()).nonorientable;
    work.summary.nonorientable_components = nonorientable.iter().filter(|&&n| n).count();
    // Dropped triangles leave borders, which may be cracks again.
    for _ in 0..MAX_PASSES {
        if !work.pass() {
            break;
        }
    }
    work.orient();
    let lost = std::mem::take(&mut work.lost);
    let (repaired, summary) = work.finish();
    let effect = RepairEffect::of(mesh, &repaired, &lost);
    (repaired, summary, effect)
}

/// A triangle under repair.
#[derive(Clone, Copy, Debug)]
struct Piece {
    corners: [u32; 3],
    /// Whether it has been turned over.
    turned: bool,
}

/// A mesh under repair.
struct Work {
    /// The mesh's vertices, then copies of them, m.
    vertices: Vec<DVec3>,
    /// The same vertices times a power of two, so that the largest coordinate is near 1.
    points: Vec<DVec3>,
    pieces: Vec<Piece>,
    /// The points are the vertices over two to this power.
    exponent: i32,
    /// Number of vertices of the original mesh.
    original: usize,
    /// Whether each later vertex is a copy, which separates sheets.
    copied: Vec<bool>,
    /// Number of intersecting pairs up to which parts are united.
    most: usize,
    /// Whether parts have been united.
    united: bool,
    /// Triangles dropped where their surface may be lost, m.
    lost: Vec<[DVec3; 3]>,
    changed: bool,
    summary: RepairSummary,
}

impl Work {
    fn new(mesh: &TriMesh) -> Self {
        let mut points = mesh.vertices().to_vec();
        let exponent = normalise(&mut points);
        Self {
            vertices: mesh.vertices().to_vec(),
            points,
            pieces: mesh.triangles().iter().map(|&corners| Piece { corners, turned: false }).collect(),
            exponent,
            original: mesh.vertices().len(),
            copied: Vec::new(),
            most: usize::MAX,
            united: false,
            lost: Vec::new(),
            changed: false,
            summary: RepairSummary::default(),
        }
    }

    /// All steps until they change nothing. Returns whether anything changed.
    fn pass(&mut self) -> bool {
        let mut any = false;
        for round in 0..MAX_ROUNDS {
            self.changed = false;
            self.remove_slivers();
            self.close_cracks(round < CLOSING_ROUNDS);
            self.orient();
            // Before faces that are there twice are dropped, and before sheets are parted: solids that share
            // a face or an edge are still whole.
            let mut pairs = if round < UNITING_ROUNDS { self.crossings() } else { Vec::new() };
            if !pairs.is_empty() && self.level() {
                pairs = self.crossings();
            }
            // While that makes intersections fewer, it goes on.
            let united = pairs.len() <= self.most && self.unite(&pairs);
            if !pairs.is_empty() {
                self.most = (pairs.len() - 1).max(ALWAYS_UNITED);
            }
            if united {
                // Slivers go before sheets are parted: the surface is still closed.
                any = true;
                continue;
            }
            self.drop_duplicates();
            self.part();
            let pairs = self.crossings();
            self.cut_crossings(&pairs, true);
            if !self.changed {
                self.close_openings();
            }
            if !self.changed {
                return any;
            }
            any = true;
        }
        // From here on edges are only made manifold and triangles dropped, so that the loop ends.
        while self.changed {
            self.changed = false;
            self.drop_duplicates();
            self.drop_degenerate();
            self.part();
            let pairs = self.crossings();
            self.cut_crossings(&pairs, false);
        }
        any
    }

    /// Makes coordinates equal that differ by roundings, so that planes along the axes that are meant to be
    /// one are. Returns whether any changed.
    fn level(&mut self) -> bool {
        let mut used: Vec<u32> = self.pieces.iter().flat_map(|piece| piece.corners).collect();
        used.sort_unstable();
        used.dedup();
        let mut changed = false;
        for axis in 0..3 {
            let value = |points: &[DVec3], v: u32| points[v as usize][axis];
            let mut order = used.clone();
            order.sort_by(|a, b| value(&self.points, *a).total_cmp(&value(&self.points, *b)));
            let (Some(low), Some(high)) = (order.first(), order.last()) else { return false };
            let near = LEVEL * (value(&self.points, *high) - value(&self.points, *low));
            let mut first = f64::NEG_INFINITY;
            for v in order {
                let own = value(&self.points, v);
                if own - first > near || !own.is_finite() {
                    first = own;
                } else if own != first {
                    self.points[v as usize][axis] = first;
                    self.vertices[v as usize] = unnormalised(self.points[v as usize], self.exponent);
                    changed = true;
                }
            }
        }
        changed
    }

    /// The pieces as a mesh; triangles and vertices keep their numbers.
    fn mesh(&self) -> TriMesh {
        let triangles = self.pieces.iter().map(|piece| piece.corners).collect();
        TriMesh::new(self.points.clone(), triangles).expect("corners stay within the vertices")
    }

    /// The height below which a triangle has no area: that of [`TriMesh::validate`].
    fn negligible(&self) -> f64 {
        palpate_core::mesh::NEGLIGIBLE_HEIGHT * weld::drop_unreferenced(&self.mesh()).bounding_sphere().radius
    }

    fn positions(&self, corners: [u32; 3]) -> [DVec3; 3] {
        corners.map(|v| self.points[v as usize])
    }

    /// Twice the area of a triangle.
    fn doubled_area(&self, corners: [u32; 3]) -> f64 {
        let [a, b, c] = self.positions(corners);
        (b - a).cross(c - a).length()
    }

    /// Whether a triangle has no area, as [`TriMesh::validate`] sees it.
    fn has_no_area(&self, corners: [u32; 3], negligible: f64) -> bool {
        let [a, b, c] = self.positions(corners);
        if a == b || b == c || c == a {
            return true;
        }
        let [u, v, w] = [b - a, c - a, c - b];
        let longest = u.length_squared().max(v.length_squared()).max(w.length_squared()).sqrt();
        // Twice the margin, so that the bounding radius after repair cannot make a kept triangle degenerate.
        u.cross(v).length() <= 2.0 * negligible * longest
    }

    /// Keeps the pieces for which `keep` holds; returns the number dropped.
    fn retain(&mut self, mut keep: impl FnMut(usize) -> bool) -> usize {
        let before = self.pieces.len();
        let mut index = 0;
        self.pieces.retain(|_| {
            index += 1;
            keep(index - 1)
        });
        let gone = before - self.pieces.len();
        self.changed |= gone > 0;
        gone
    }

    fn drop_nonfinite(&mut self) {
        let finite: Vec<bool> =
            self.pieces.iter().map(|p| self.positions(p.corners).iter().all(|x| x.is_finite())).collect();
        self.summary.nonfinite_triangles += self.retain(|i| finite[i]);
    }

    /// Remembers pieces that are about to be dropped with their surface.
    fn note_loss(&mut self, dropped: &[bool]) {
        let lost = self.pieces.iter().zip(dropped).filter(|(_, dropped)| **dropped);
        self.lost.extend(lost.map(|(piece, _)| piece.corners.map(|v| self.vertices[v as usize])));
    }

    fn drop_degenerate(&mut self) {
        let negligible = self.negligible();
        let keep: Vec<bool> = self.pieces.iter().map(|p| !self.has_no_area(p.corners, negligible)).collect();
        self.summary.degenerate_triangles += self.retain(|i| keep[i]);
    }

    /// Turns triangles to agree with their neighbours, and closed components to face outwards.
    fn orient(&mut self) {
        let mesh = self.mesh();
        let mut components = Components::new(&mesh);
        self.summary.inverted_components += components.face_outwards(&mesh);
        for (piece, _) in self.pieces.iter_mut().zip(&components.flipped).filter(|(_, flip)| **flip) {
            piece.corners.swap(1, 2);
            piece.turned ^= true;
            self.changed = true;
        }
    }

    /// Adds a copy of a vertex, at the same position.
    fn copy_of(&mut self, vertex: u32) -> u32 {
        self.add_vertex(self.vertices[vertex as usize], self.points[vertex as usize], true);
        self.changed = true;
        self.vertices.len() as u32 - 1
    }

    fn add_vertex(&mut self, vertex: DVec3, point: DVec3, copied: bool) {
        self.vertices.push(vertex);
        self.points.push(point);
        self.copied.push(copied);
    }

    fn finish(mut self) -> (TriMesh, RepairSummary) {
        let mut used = vec![false; self.vertices.len()];
        for v in self.pieces.iter().flat_map(|piece| piece.corners) {
            used[v as usize] = true;
        }
        let kept = |range: std::ops::Range<usize>| used[range].iter().filter(|u| **u).count();
        self.summary.unreferenced_vertices = self.original - kept(0..self.original);
        let copies =
            used[self.original..].iter().zip(&self.copied).filter(|(used, copied)| **used && **copied);
        self.summary.duplicated_vertices = copies.count();
        self.summary.flipped_triangles = self.pieces.iter().filter(|piece| piece.turned).count();
        let triangles = self.pieces.iter().map(|piece| piece.corners).collect();
        let mesh = TriMesh::new(self.vertices, triangles).expect("corners stay within the vertices");
        (weld::drop_unreferenced(&mesh), self.summary)
    }
}

/// The vertex that `vertex` is merged into: the root of its tree. Shortens the path to it.
pub(crate) fn root(target: &mut [u32], mut vertex: u32) -> u32 {
    while target[vertex as usize] != vertex {
        target[vertex as usize] = target[target[vertex as usize] as usize];
        vertex = target[vertex as usize];
    }
    vertex
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    const QUADS: [[u32; 4]; 6] =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];

    /// Adds a cube to a mesh's lists, facing outwards.
    fn cube(
        vertices: &mut Vec<DVec3>,
        triangles: &mut Vec<[u32; 3]>,
        center: DVec3,
        half: f64,
        inwards: bool,
    ) {
        let first = vertices.len() as u32;
        let sign = |i: u32, bit: u32| if i >> bit & 1 == 1 { half } else { -half };
        vertices.extend((0..8).map(|i| center + DVec3::new(sign(i, 0), sign(i, 1), sign(i, 2))));
        for [a, b, c, d] in QUADS.map(|q| q.map(|v| first + v)) {
            triangles.extend(if inwards { [[a, c, b], [a, d, c]] } else { [[a, b, c], [a, c, d]] });
        }
    }

    fn cubes(list: &[(f64, f64, bool)]) -> TriMesh {
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for &(x, half, inwards) in list {
            cube(&mut vertices, &mut triangles, DVec3::X * x, half, inwards);
        }
        TriMesh::new(vertices, triangles).unwrap()
    }

    fn volume(mesh: &TriMesh) -> f64 {
        (0..mesh.triangles().len()).map(|t| mesh.corners(t)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    #[test]
    fn counts_what_it_drops() {
        let mesh = cubes(&[(0.0, 1.0, false)]);
        let mut vertices = mesh.vertices().to_vec();
        vertices.extend([DVec3::NAN, DVec3::new(0.0, -1.0, -1.0), DVec3::splat(9.0)]);
        let mut triangles = mesh.triangles().to_vec();
        // Not finite; two corners the same; three on a line; a copy, and one turned over.
        triangles.extend([[0, 1, 8], [3, 3, 4], [0, 1, 9], [2, 3, 0], [3, 2, 0]]);
        let (repaired, summary) = repair(&TriMesh::new(vertices, triangles).unwrap());
        let expected = RepairSummary {
            nonfinite_triangles: 1,
            degenerate_triangles: 2,
            duplicate_triangles: 2,
            unreferenced_vertices: 3,
            ..RepairSummary::default()
        };
        assert_eq!(summary, expected);
        assert_eq!(repaired, mesh);
    }

    #[test]
    fn any_turning_of_triangles_is_undone() {
        let seed = 29;
        let mut random = StdRng::seed_from_u64(seed);
        let mesh = cubes(&[(0.0, 1.0, false), (5.0, 2.0, false)]);
        for case in 0..200 {
            let turned =
                mesh.triangles().iter().map(|&[a, b, c]| if random.random() { [a, c, b] } else { [a, b, c] });
            let (repaired, summary) =
                repair(&TriMesh::new(mesh.vertices().to_vec(), turned.collect()).unwrap());
            assert_eq!(summary.nonorientable_components, 0);
            let bounds = repaired
                .adjacency()
                .edge_kinds()
                .iter()
                .all(|k| *k == palpate_core::mesh::EdgeKind::Manifold);
            assert!(bounds, "seed {seed}, case {case}: some edge is misoriented");
            assert!((volume(&repaired) - 72.0).abs() < 1e-9, "seed {seed}, case {case}");
        }
    }

    #[test]
    fn cavities_stay_and_bodies_face_outwards() {
        for (name, shells, expected, inverted) in [
            ("inside out", vec![(0.0, 1.0, true)], 8.0, 1),
            ("hollow", vec![(0.0, 2.0, false), (0.0, 1.0, true)], 56.0, 0),
            ("hollow, inside out", vec![(0.0, 2.0, true), (0.0, 1.0, false)], 56.0, 2),
            ("two bodies, one inside out", vec![(0.0, 2.0, false), (9.0, 1.0, true)], 72.0, 1),
            (
                "a body in a cavity",
                vec![(0.0, 3.0, false), (0.0, 2.0, true), (0.0, 1.0, false)],
                216.0 - 64.0 + 8.0,
                0,
            ),
            ("overlapping, not inside", vec![(0.0, 2.0, false), (2.0, 1.0, true)], 72.0, 1),
        ] {
            let mut work = Work::new(&cubes(&shells));
            work.orient();
            let (turned, summary) = work.finish();
            assert!((volume(&turned) - expected).abs() < 1e-9, "{name}: {}", volume(&turned));
            assert_eq!(summary.inverted_components, inverted, "{name}");
            let (repaired, summary) = repair(&cubes(&shells));
            assert_eq!(summary.intersecting_triangles, 0, "{name}: {summary}");
            let apart = summary.united_components == 0;
            assert_eq!(apart, name != "overlapping, not inside", "{name}: {summary}");
            assert!(!apart || repaired == turned, "{name}");
            // The cubes from -2 to 2 and from 1 to 3 have half of the smaller one in common.
            assert!(apart || (volume(&repaired) - 68.0).abs() < 1e-9, "{name}: {}", volume(&repaired));
        }
    }

    #[test]
    fn a_moebius_strip_is_named() {
        // Five triangles in a ring: a strip with an odd number of half turns.
        let vertices =
            (0..5).map(|i| DVec3::new(f64::from(i), f64::from(i * i), f64::from(i * i * i))).collect();
        let strip = TriMesh::new(vertices, (0..5).map(|i| [i, (i + 1) % 5, (i + 2) % 5]).collect()).unwrap();
        let (repaired, summary) = repair(&strip);
        assert_eq!(summary.nonorientable_components, 1);
        assert_eq!(repaired.triangles().len(), 5);
        assert_eq!(repair(&TriMesh::default()), (TriMesh::default(), RepairSummary::default()));
    }
}
