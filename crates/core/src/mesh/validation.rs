//! Validation of triangle meshes.
//!
//! Conventions, where usage differs:
//! - A triangle that names a vertex twice has no sides: it counts as degenerate and is ignored otherwise.
//!   Triangles without area and duplicates are not ignored, so that a duplicate makes its edges non-manifold.
//! - *Closed* means that each edge belongs to exactly two triangles. A mesh with an edge of four triangles
//!   encloses a volume but is not closed in this sense, since it does not determine which of them are
//!   neighbours.
//! - *Oriented* is judged at edges of two triangles, where it is defined.
//! - Components are connected across edges; meeting at a vertex alone does not connect.

use serde::Serialize;

use super::adjacency::is_collapsed;
use super::{Adjacency, EdgeKind, TriMesh};

/// Height of a triangle over its longest side, as a multiple of the bounding radius, up to which the triangle
/// has no area. Some thousand times the rounding of a coordinate: the direction of such a triangle's normal
/// is noise.
pub const NEGLIGIBLE_HEIGHT: f64 = 1e-12;

/// Defects of a mesh, found by [`TriMesh::validate`]: their number, and the first element with each.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ValidationReport {
    /// Vertices that a triangle refers to.
    pub vertices: usize,
    /// Triangles, degenerate ones included.
    pub triangles: usize,
    /// Whether there are triangles, and every edge belongs to exactly two.
    pub closed: bool,
    /// Whether no edge belongs to more than two triangles, and the triangles around each vertex form one
    /// fan.
    pub manifold: bool,
    /// Whether no two triangles that share an edge disagree on which side is outside.
    pub oriented: bool,
    /// Edges of one triangle.
    pub boundary_edges: usize,
    /// Edges of three or more triangles.
    pub nonmanifold_edges: usize,
    /// Edges of two triangles that disagree on which side is outside.
    pub misoriented_edges: usize,
    /// Fans of triangles (connected across edges at the vertex) beyond the first, summed over the vertices:
    /// the number of vertices to add for each fan to have its own.
    pub nonmanifold_vertices: usize,
    /// Triangles that name a vertex twice or have no area.
    pub degenerate: usize,
    /// Degenerate triangles with three different vertices.
    pub zero_area: usize,
    /// Triangles with the same vertices as an earlier one, in whatever order.
    pub duplicate: usize,
    /// Vertices with a coordinate that is not a finite number.
    pub nonfinite: usize,
    /// Vertices that no triangle refers to.
    pub unreferenced: usize,
    /// Connected components.
    pub components: usize,
    /// Radius of the [bounding sphere](TriMesh::bounding_sphere), m.
    pub bounding_radius: f64,
    /// Signed volume, m³: negative when the triangles face inwards. For a surface with a border, or one that
    /// is not oriented, the sum of the signed tetrahedra that the triangles span with the origin. Triangles
    /// with a vertex that is not finite are left out.
    pub volume: f64,
    /// The first offending element of each kind found.
    pub first: FirstOffenders,
}

/// An edge with a defect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct OffendingEdge {
    /// Its vertices, the lower first.
    pub vertices: [u32; 2],
    /// The first triangle at it.
    pub triangle: u32,
}

/// The first offending element of each kind, where there is one: vertices and triangles by index, edges in
/// order of their first triangle. Absent kinds are left out when serialized.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FirstOffenders {
    /// An edge of one triangle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub boundary_edge: Option<OffendingEdge>,
    /// An edge of three or more triangles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nonmanifold_edge: Option<OffendingEdge>,
    /// An edge whose two triangles disagree on which side is outside.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub misoriented_edge: Option<OffendingEdge>,
    /// A vertex whose triangles form more than one fan.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nonmanifold_vertex: Option<u32>,
    /// A triangle that names a vertex twice or has no area.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub degenerate: Option<u32>,
    /// A triangle that repeats an earlier one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duplicate: Option<u32>,
    /// A vertex with a coordinate that is not a finite number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nonfinite: Option<u32>,
    /// A vertex that no triangle refers to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unreferenced: Option<u32>,
    /// Two triangles that intersect. Validation does not look for them; palpate-mesh-io does, and fills this
    /// in.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub self_intersection: Option<[u32; 2]>,
}

impl ValidationReport {
    /// Whether the surface is closed, 2-manifold and consistently oriented, faces outwards and is made of
    /// finite numbers, so that inside and outside are defined. (It may still intersect itself.)
    pub fn is_solid(&self) -> bool {
        self.closed && self.manifold && self.oriented && self.nonfinite == 0 && self.volume > 0.0
    }
}

/// Counts elements and remembers the first.
struct Tally<T> {
    count: usize,
    first: Option<T>,
}

impl<T> Tally<T> {
    fn of(elements: impl Iterator<Item = T>) -> Self {
        let mut elements = elements;
        let first = elements.next();
        Self { count: usize::from(first.is_some()) + elements.count(), first }
    }
}

impl TriMesh {
    /// Finds all defects of the mesh but self-intersection. Any mesh is accepted; the time is that of a few
    /// sorts of its triangles.
    pub fn validate(&self) -> ValidationReport {
        let adjacency = self.adjacency();
        let bounding_radius = self.bounding_sphere().radius;
        let indices = |flags: Vec<bool>| {
            Tally::of((0..).zip(flags).filter(|(_, flag)| *flag).map(|(i, _): (u32, _)| i))
        };

        let mut unused = vec![true; self.vertices.len()];
        for &v in self.triangles.iter().flatten() {
            unused[v as usize] = false;
        }
        let unreferenced = indices(unused);
        let nonfinite = indices(self.vertices.iter().map(|p| !p.is_finite()).collect());

        let collapsed = self.triangles.iter().filter(|corners| is_collapsed(**corners)).count();
        let degenerate = indices(
            (0..self.triangles.len())
                .map(|t| is_collapsed(self.triangles[t]) || self.has_no_area(t, bounding_radius))
                .collect(),
        );
        let duplicate = indices(self.repeats_earlier());

        let edges = |kind: EdgeKind| offending_edges(&adjacency, kind);
        let boundary = edges(EdgeKind::Boundary);
        let nonmanifold = edges(EdgeKind::NonManifold);
        let misoriented = edges(EdgeKind::Misoriented);
        let (nonmanifold_vertices, first_nonmanifold_vertex) = self.extra_fans(&adjacency);

        ValidationReport {
            vertices: self.vertices.len() - unreferenced.count,
            triangles: self.triangles.len(),
            closed: !adjacency.edges().is_empty() && boundary.count == 0 && nonmanifold.count == 0,
            manifold: nonmanifold.count == 0 && nonmanifold_vertices == 0,
            oriented: misoriented.count == 0,
            boundary_edges: boundary.count,
            nonmanifold_edges: nonmanifold.count,
            misoriented_edges: misoriented.count,
            nonmanifold_vertices,
            degenerate: degenerate.count,
            zero_area: degenerate.count - collapsed,
            duplicate: duplicate.count,
            nonfinite: nonfinite.count,
            unreferenced: unreferenced.count,
            components: adjacency.components().1 as usize,
            bounding_radius,
            volume: self.signed_volume(&adjacency),
            first: FirstOffenders {
                boundary_edge: boundary.first,
                nonmanifold_edge: nonmanifold.first,
                misoriented_edge: misoriented.first,
                nonmanifold_vertex: first_nonmanifold_vertex,
                degenerate: degenerate.first,
                duplicate: duplicate.first,
                nonfinite: nonfinite.first,
                unreferenced: unreferenced.first,
                self_intersection: None,
            },
        }
    }

    /// Whether a triangle's height over its longest side is negligible beside the bounding radius (m); false
    /// if a corner is not finite, which is another defect.
    fn has_no_area(&self, triangle: usize, bounding_radius: f64) -> bool {
        let [a, b, c] = self.corners(triangle);
        if a == b || b == c || c == a {
            return true;
        }
        // In units of the radius, so that squares stay within the range of f64.
        let [u, v, w] = [b - a, c - a, c - b].map(|side| side / bounding_radius);
        let longest = u.length_squared().max(v.length_squared()).max(w.length_squared()).sqrt();
        u.cross(v).length() <= NEGLIGIBLE_HEIGHT * longest
    }

    /// Flags, one a triangle: true if an earlier triangle has the same three vertices.
    fn repeats_earlier(&self) -> Vec<bool> {
        let mut sorted: Vec<([u32; 3], u32)> = (self.triangles.iter().zip(0..))
            .filter(|(corners, _)| !is_collapsed(**corners))
            .map(|(corners, t)| {
                let mut corners = *corners;
                corners.sort_unstable();
                (corners, t)
            })
            .collect();
        sorted.sort_unstable();
        let mut repeats = vec![false; self.triangles.len()];
        for same in sorted.chunk_by(|a, b| a.0 == b.0) {
            for (_, t) in &same[1..] {
                repeats[*t as usize] = true;
            }
        }
        repeats
    }

    /// The number of fans beyond the first over all vertices, and the first vertex that has more than one.
    fn extra_fans(&self, adjacency: &Adjacency) -> (usize, Option<u32>) {
        let mut extra = 0;
        let mut first = None;
        // The fan of each of the vertex's triangles, as a union-find forest, and the (other vertex, triangle)
        // of each of its sides.
        let mut parent: Vec<usize> = Vec::new();
        let mut spokes: Vec<(u32, usize)> = Vec::new();
        for vertex in 0..self.vertices.len() as u32 {
            let around = adjacency.vertex_triangles(vertex);
            parent.clear();
            parent.extend(0..around.len());
            spokes.clear();
            for (i, t) in around.iter().enumerate() {
                spokes.extend(self.triangles[*t as usize].iter().filter(|v| **v != vertex).map(|v| (*v, i)));
            }
            spokes.sort_unstable();
            let mut fans = around.len();
            for pair in spokes.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
                let (a, b) = (root(&mut parent, pair[0].1), root(&mut parent, pair[1].1));
                if a != b {
                    parent[a.max(b)] = a.min(b);
                    fans -= 1;
                }
            }
            if fans > 1 {
                extra += fans - 1;
                first = first.or(Some(vertex));
            }
        }
        (extra, first)
    }
}

/// The root of an element's tree in a union-find forest; shortens the path to it.
fn root(parent: &mut [usize], mut element: usize) -> usize {
    while parent[element] != element {
        parent[element] = parent[parent[element]];
        element = parent[element];
    }
    element
}

fn offending_edges(adjacency: &Adjacency, kind: EdgeKind) -> Tally<OffendingEdge> {
    let of_kind = (0..).zip(adjacency.edge_kinds()).filter(|(_, k)| **k == kind);
    let found = of_kind.map(|(edge, _): (u32, _)| OffendingEdge {
        vertices: adjacency.edges()[edge as usize],
        triangle: adjacency.edge_sides(edge)[0].triangle(),
    });
    Tally { count: found.clone().count(), first: found.min_by_key(|edge| (edge.triangle, edge.vertices)) }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    use super::super::test_shapes::{cuboid, mapped, reversed, sphere, tangle, tetrahedron, together};
    use super::*;

    fn block() -> TriMesh {
        cuboid(DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0))
    }

    fn with_triangles(mesh: &TriMesh, change: impl FnOnce(&mut Vec<[u32; 3]>)) -> ValidationReport {
        let mut triangles = mesh.triangles().to_vec();
        change(&mut triangles);
        TriMesh::new(mesh.vertices().to_vec(), triangles).unwrap().validate()
    }

    #[test]
    fn solids_have_no_defects() {
        for mesh in [block(), tetrahedron(), sphere(0.02, 3), together(&[block(), tetrahedron()])] {
            let report = mesh.validate();
            assert!(report.is_solid(), "{report:?}");
            assert_eq!(report.first, FirstOffenders::default());
            let wrong = [report.degenerate, report.duplicate, report.nonfinite, report.nonmanifold_vertices];
            assert_eq!(wrong, [0; 4]);
        }
        let report = block().validate();
        assert_eq!((report.vertices, report.triangles, report.components), (8, 12, 1));
        assert_eq!((report.volume, report.bounding_radius), (6.0, 14f64.sqrt() / 2.0));
    }

    #[test]
    fn each_defect_is_counted_and_its_first_element_named() {
        let mesh = block();
        let report = with_triangles(&mesh, |t| {
            t.remove(4);
        });
        assert!(!report.closed && report.manifold && report.oriented);
        assert_eq!(report.boundary_edges, 3);
        // Triangle 4, [0, 1, 5], leaves the sides of 3, [1, 7, 5], and of two later ones open.
        let first = OffendingEdge { vertices: [1, 5], triangle: 3 };
        assert_eq!(report.first.boundary_edge, Some(first));

        let report = with_triangles(&mesh, |t| t[7].swap(0, 1));
        assert!(report.closed && report.manifold && !report.oriented && !report.is_solid());
        assert_eq!(report.misoriented_edges, 3);

        let report = with_triangles(&mesh, |t| t.push([t[3][1], t[3][0], t[3][2]]));
        assert_eq!((report.duplicate, report.first.duplicate, report.nonmanifold_edges), (1, Some(12), 3));
        assert!(!report.closed && !report.manifold && report.oriented);
        assert_eq!(report.first.nonmanifold_edge.unwrap().triangle, 2);

        let report = with_triangles(&mesh, |t| t.extend([[5, 5, 2], [0, 1, 0]]));
        assert_eq!((report.degenerate, report.zero_area, report.first.degenerate), (2, 0, Some(12)));
        assert!(report.is_solid() && report.triangles == 14);

        let report = reversed(&mesh).validate();
        assert!(report.closed && report.manifold && report.oriented && !report.is_solid());
        assert_eq!(report.volume, -6.0);
    }

    #[test]
    fn fans_that_meet_at_a_vertex_are_counted() {
        // Three tetrahedra that share vertex 0.
        let parts = [DVec3::ONE, DVec3::new(-1.0, -1.0, 1.0), DVec3::new(1.0, -1.0, -1.0)];
        let three = together(&parts.map(|signs| mapped(&tetrahedron(), |p| p * signs)));
        let triangles = three.triangles().iter().map(|t| t.map(|v| if v % 4 == 0 { 0 } else { v })).collect();
        let report = TriMesh::new(three.vertices().to_vec(), triangles).unwrap().validate();
        assert_eq!((report.nonmanifold_vertices, report.first.nonmanifold_vertex), (2, Some(0)));
        assert!(report.closed && !report.manifold && report.components == 3);
        assert_eq!((report.vertices, report.unreferenced, report.first.unreferenced), (10, 2, Some(4)));
    }

    #[test]
    fn triangles_without_area_are_found_at_any_scale() {
        for scale in [1e-200, 1e-12, 1.0, 1e200] {
            let vertices =
                [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.5, 1e-9, 0.0], [0.2, 0.9, 0.1]];
            let vertices = vertices.iter().map(|p| DVec3::from_array(*p) * scale).collect();
            let mesh = TriMesh::new(vertices, vec![[0, 1, 4], [0, 1, 3], [0, 1, 2]]).unwrap();
            let report = mesh.validate();
            // A height of 1e-9 is thin, but more than rounding.
            assert_eq!(
                (report.degenerate, report.zero_area, report.first.degenerate),
                (1, 1, Some(2)),
                "{scale}"
            );
        }
        let point = TriMesh::new(vec![DVec3::ONE; 3], vec![[0, 1, 2]]).unwrap();
        assert_eq!(point.validate().zero_area, 1);
    }

    #[test]
    fn fans_and_duplicates_agree_with_plain_counting() {
        const SEED: u64 = 41;
        let random = &mut StdRng::seed_from_u64(SEED);
        let mut fans_seen = 0;
        for round in 0..1000 {
            let (vertices, triangles) = (random.random_range(3..12), random.random_range(0..25));
            let mesh = tangle(random, vertices, triangles);
            let report = mesh.validate();
            let sound: Vec<[u32; 3]> =
                mesh.triangles().iter().copied().filter(|t| !is_collapsed(*t)).collect();
            let mut extra = 0;
            for v in 0..vertices {
                let mut fans: Vec<Vec<[u32; 3]>> = Vec::new();
                for t in sound.iter().filter(|t| t.contains(&v)) {
                    let touches =
                        |fan: &Vec<[u32; 3]>| fan.iter().any(|o| t.iter().any(|w| *w != v && o.contains(w)));
                    let (joined, mut apart): (Vec<_>, Vec<_>) = fans.into_iter().partition(touches);
                    apart.push([joined.concat(), vec![*t]].concat());
                    fans = apart;
                }
                extra += fans.len().saturating_sub(1);
            }
            fans_seen += extra;
            assert_eq!(report.nonmanifold_vertices, extra, "seed {SEED}, round {round}");
            let sorted = |mut t: [u32; 3]| {
                t.sort_unstable();
                t
            };
            let repeats =
                (0..sound.len()).filter(|i| sound[..*i].iter().any(|t| sorted(*t) == sorted(sound[*i])));
            assert_eq!(report.duplicate, repeats.count(), "seed {SEED}, round {round}");
        }
        assert!(fans_seen > 100);
    }

    #[test]
    fn any_numbers_are_accepted_and_the_report_is_finite() {
        const SEED: u64 = 42;
        let random = &mut StdRng::seed_from_u64(SEED);
        let odd =
            [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0, 1e308, -1.7e308, 5e-324, 1e-300, 1.0];
        for _ in 0..2000 {
            let coordinate = |random: &mut StdRng| odd[random.random_range(0..odd.len())];
            let vertices: Vec<DVec3> =
                (0..6).map(|_| DVec3::from_array([0; 3].map(|_| coordinate(random)))).collect();
            let nonfinite = vertices.iter().filter(|p| !p.is_finite()).count();
            let triangles =
                (0..random.random_range(0..12)).map(|_| [0; 3].map(|_| random.random_range(0..6))).collect();
            let mesh = TriMesh::new(vertices, triangles).unwrap();
            let report = mesh.validate();
            assert_eq!(report.nonfinite, nonfinite, "seed {SEED}");
            assert!(report.volume.is_finite(), "seed {SEED}: {mesh:?}");
            assert!(!report.bounding_radius.is_nan(), "seed {SEED}: {mesh:?}");
            if let Ok(properties) = mesh.mass_properties(1000.0) {
                assert!(properties.mass > 0.0 && properties.inertia.is_finite(), "seed {SEED}: {mesh:?}");
            }
        }
        let report = TriMesh::default().validate();
        assert!(!report.closed && report.manifold && report.oriented && report.components == 0);
    }

    #[test]
    fn the_json_has_the_documented_fields() {
        let report = with_triangles(&block(), |t| t.truncate(11));
        let json = serde_json::to_value(&report).unwrap();
        for field in [
            "vertices",
            "triangles",
            "closed",
            "manifold",
            "oriented",
            "boundary_edges",
            "nonmanifold_edges",
            "misoriented_edges",
            "degenerate",
            "duplicate",
            "nonfinite",
            "components",
            "bounding_radius",
            "volume",
        ] {
            assert!(json[field].is_number() || json[field].is_boolean(), "{field}: {json}");
        }
        let first = json["first"].as_object().unwrap();
        assert_eq!(first.keys().collect::<Vec<_>>(), ["boundary_edge"]);
        assert_eq!(json["first"]["boundary_edge"]["vertices"], serde_json::json!([4, 6]), "{json}");
    }
}
