//! Intersections between triangles: of one mesh with itself, or of two placed meshes.
//!
//! They are found exactly (Shewchuk's adaptive predicates, crate `robust`), so that a model reported free of
//! self-intersections has none, to the last bit of its coordinates. A bounding-volume hierarchy finds the
//! candidates.

mod broad;
mod triangles;

use glam::DVec3;
use palpate_core::{Pose, TriMesh};
use rayon::prelude::*;

pub(crate) use broad::Boxes;
pub(crate) use triangles::{Plane, collinear, cross};

use crate::weld::equal_positions;

/// The pairs of triangles of a mesh that intersect.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct SelfIntersections {
    /// Number of pairs.
    pub count: usize,
    /// The first of them in lexicographic order: two triangle indices, the smaller first.
    pub first: Option<[u32; 2]>,
}

/// Counts the pairs of triangles of a mesh that intersect beyond the vertices and edges that they share;
/// touching counts.
///
/// Two triangles share the vertices that are at bitwise equal positions, whether or not the mesh is welded.
/// Those that share none intersect if they have a point in common. Those that share one vertex do if they
/// have any other point in common. Those that share an edge do if one is folded flat onto the other.
/// Duplicates (three shared vertices) and degenerate triangles (without area, or with a coordinate that is
/// not finite) are defects of other kinds and are left out here. Runs in parallel; the result does not depend
/// on the number of threads. Takes O(n log n) for a surface; a soup in which all pairs intersect takes O(n²).
pub fn self_intersections(mesh: &TriMesh) -> SelfIntersections {
    let mut vertices = mesh.vertices().to_vec();
    normalise(&mut vertices);
    let same = equal_positions(&vertices);
    let search = Search::new(&vertices, mesh.triangles(), &same);
    let of_each = search.of_each(0..mesh.triangles().len(), usize::MAX, |pairs| SelfIntersections {
        count: pairs.len(),
        first: pairs.first().copied(),
    });
    of_each.into_iter().fold(SelfIntersections::default(), |all, own| SelfIntersections {
        count: all.count + own.count,
        first: all.first.or(own.first),
    })
}

/// The pairs of triangles that [`self_intersections`] counts, the smaller index first, in lexicographic
/// order; at most `limit` for each smaller index, and none for further ones once there are `enough`. The
/// vertices must be [normalised](normalise); `same` are their [classes](equal_positions).
pub(crate) fn crossing_pairs(
    vertices: &[DVec3],
    triangles: &[[u32; 3]],
    same: &[u32],
    limit: usize,
    enough: usize,
) -> Vec<[u32; 2]> {
    /// Triangles that are searched at once, in parallel.
    const AT_ONCE: usize = 4096;
    let search = Search::new(vertices, triangles, same);
    let mut pairs = Vec::new();
    for first in (0..triangles.len()).step_by(AT_ONCE) {
        if pairs.len() >= enough {
            break;
        }
        let range = first..triangles.len().min(first + AT_ONCE);
        pairs.extend(search.of_each(range, limit, |pairs| pairs).into_iter().flatten());
    }
    pairs
}

/// A mesh and the hierarchy in which pairs are searched.
struct Search<'a> {
    vertices: &'a [DVec3],
    /// The corners of triangles, as classes of equal positions.
    ids: Vec<[u32; 3]>,
    boxes: Boxes,
    tree: obvhs::bvh2::Bvh2,
}

impl<'a> Search<'a> {
    fn new(vertices: &'a [DVec3], triangles: &[[u32; 3]], same: &[u32]) -> Self {
        let ids: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(|v| same[v as usize])).collect();
        let corners = |t: usize| ids[t].map(|v| vertices[v as usize]);
        let boxes =
            Boxes::of_one_mesh(ids.len(), |t| Some(corners(t)).filter(|&[a, b, c]| !collinear(a, b, c)));
        let tree = boxes.tree();
        Self { vertices, ids, boxes, tree }
    }

    /// Results of `take` for some triangles, from their pairs with later ones: the first `limit` in ascending
    /// order.
    fn of_each<T: Send>(
        &self,
        triangles: std::ops::Range<usize>,
        limit: usize,
        take: impl Fn(Vec<[u32; 2]>) -> T + Sync,
    ) -> Vec<T> {
        let corners = |t: usize| self.ids[t].map(|v| self.vertices[v as usize]);
        let ids = &self.ids;
        triangles
            .into_par_iter()
            .map_init(Vec::new, |candidates, i| {
                self.boxes.overlapping(i, &self.boxes, &self.tree, candidates);
                candidates.retain(|&j| j as usize > i);
                candidates.sort_unstable();
                let crossing = |&j: &u32| cross(&corners(i), &ids[i], &corners(j as usize), &ids[j as usize]);
                let found = candidates.iter().copied().filter(crossing).take(limit);
                take(found.map(|j| [i as u32, j]).collect())
            })
            .collect()
    }
}

/// The pairs of triangles, one of each of two placed meshes, that have a point in common; touching counts.
///
/// Each pair is a triangle of `a` and one of `b`. At most `limit` pairs are returned: the first in
/// lexicographic order. The vertices of both are rounded once, when the poses transform them to the world
/// frame; the rest is exact.
pub fn intersecting_pairs(
    a: &TriMesh,
    pose_a: &Pose,
    b: &TriMesh,
    pose_b: &Pose,
    limit: usize,
) -> Vec<[u32; 2]> {
    let placed = |mesh: &TriMesh, pose: &Pose| -> Vec<DVec3> {
        mesh.vertices().iter().map(|v| pose.transform_point(*v)).collect()
    };
    let mut vertices = placed(a, pose_a);
    vertices.extend(placed(b, pose_b));
    normalise(&mut vertices);
    let (vertices_a, vertices_b) = vertices.split_at(a.vertices().len());
    let corners_a = |t: usize| a.triangles()[t].map(|v| vertices_a[v as usize]);
    let corners_b = |t: usize| b.triangles()[t].map(|v| vertices_b[v as usize]);
    let boxes_a = Boxes::new(a.triangles().len(), |t| Some(corners_a(t)));
    let boxes_b = Boxes::new(b.triangles().len(), |t| Some(corners_b(t)));
    let tree = boxes_b.tree();
    let mut pairs = Vec::new();
    let mut candidates = Vec::new();
    for i in 0..a.triangles().len() {
        boxes_a.overlapping(i, &boxes_b, &tree, &mut candidates);
        candidates.sort_unstable();
        for &j in &candidates {
            if pairs.len() == limit {
                return pairs;
            }
            if triangles::meet(&corners_a(i), &corners_b(j as usize)) {
                pairs.push([i as u32, j]);
            }
        }
    }
    pairs
}

/// Scales the largest finite coordinate to between 1/2 and 1 by a power of two, which is exact: the
/// predicates and the f32 boxes then neither overflow nor underflow. Returns the power's exponent, for
/// [`unnormalised`].
pub(crate) fn normalise(vertices: &mut [DVec3]) -> i32 {
    let largest =
        vertices.iter().filter(|v| v.is_finite()).map(|v| v.abs().max_element()).fold(0.0_f64, f64::max);
    if largest == 0.0 {
        return 0;
    }
    // In two steps, since the factor itself can lie outside the range of f64.
    let exponent = largest.log2().floor() as i32 + 1;
    let half = exponent / 2;
    for v in vertices {
        *v = *v * 2.0_f64.powi(-half) * 2.0_f64.powi(half - exponent);
    }
    exponent
}

/// The vertex that [`normalise`] made `vertex` of.
pub(crate) fn unnormalised(vertex: DVec3, exponent: i32) -> DVec3 {
    let half = exponent / 2;
    vertex * 2.0_f64.powi(half) * 2.0_f64.powi(exponent - half)
}

#[cfg(test)]
mod tests {
    use glam::DQuat;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    fn soup(random: &mut StdRng, triangles: usize, size: f64) -> TriMesh {
        let mut vertices = Vec::new();
        for _ in 0..triangles {
            let middle = DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0)));
            vertices.extend((0..3).map(|_| {
                // A coarse grid makes vertices coincide and triangles share edges.
                let offset = DVec3::from_array(std::array::from_fn(|_| random.random_range(-size..size)));
                ((middle + offset) * 16.0).round() / 16.0
            }));
        }
        let count = vertices.len() as u32;
        TriMesh::new(vertices, (0..count / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect()).unwrap()
    }

    #[test]
    fn counts_as_all_against_all_do() {
        let seed = 11;
        let mut random = StdRng::seed_from_u64(seed);
        for size in [0.1, 0.3, 1.0] {
            let mesh = soup(&mut random, 400, size);
            let ids = equal_positions(mesh.vertices());
            let id = |t: usize| mesh.triangles()[t].map(|v| ids[v as usize]);
            let flat = |t: usize| {
                let [a, b, c] = mesh.corners(t);
                collinear(a, b, c)
            };
            let mut expected = SelfIntersections::default();
            for i in 0..400 {
                for j in i + 1..400 {
                    let crosses = cross(&mesh.corners(i), &id(i), &mesh.corners(j), &id(j));
                    if crosses && !flat(i) && !flat(j) {
                        expected.count += 1;
                        expected.first = expected.first.or(Some([i as u32, j as u32]));
                    }
                }
            }
            assert!(expected.count > 10, "seed {seed}: {expected:?}");
            assert_eq!(self_intersections(&mesh), expected, "seed {seed}, size {size}");
            assert_eq!(
                self_intersections(&crate::weld(&mesh)),
                expected,
                "welding changes nothing; seed {seed}"
            );
        }
    }

    /// Long parts that are not aligned with an axis, for which the boxes are turned.
    #[test]
    fn splinters_are_counted_as_all_against_all_do() {
        let seed = 12;
        let mut random = StdRng::seed_from_u64(seed);
        let along = DVec3::new(0.6, -0.5, 0.62);
        let count = 600;
        let mut vertices = Vec::new();
        for _ in 0..count {
            let mut near = || DVec3::from_array(std::array::from_fn(|_| random.random_range(-0.05..0.05)));
            let from = near();
            vertices.extend([from, from + along + 0.2 * near(), from + 0.3 * near()]);
        }
        let ids: Vec<[u32; 3]> = (0..count).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let mesh = TriMesh::new(vertices, ids.clone()).unwrap();
        let mut expected = SelfIntersections::default();
        for i in 0..count as usize {
            for j in i + 1..count as usize {
                if cross(&mesh.corners(i), &ids[i], &mesh.corners(j), &ids[j]) {
                    expected.count += 1;
                    expected.first = expected.first.or(Some([i as u32, j as u32]));
                }
            }
        }
        assert!(expected.count > 100, "seed {seed}: {expected:?}");
        assert_eq!(self_intersections(&mesh), expected, "seed {seed}");
        let corners = |t: usize| Some(mesh.corners(t));
        let candidates = |boxes: &Boxes| -> usize {
            let (tree, mut found) = (boxes.tree(), Vec::new());
            let mut of = |i| {
                boxes.overlapping(i, boxes, &tree, &mut found);
                found.len()
            };
            (0..count as usize).map(&mut of).sum()
        };
        let [plain, turned] = [Boxes::new(600, corners), Boxes::of_one_mesh(600, corners)];
        assert!(2 * candidates(&turned) < candidates(&plain), "turning the boxes pays");
    }

    #[test]
    fn pairs_of_placed_meshes_are_those_of_all_against_all() {
        let seed = 13;
        let mut random = StdRng::seed_from_u64(seed);
        let (a, b) = (soup(&mut random, 150, 0.3), soup(&mut random, 150, 0.3));
        let pose_a =
            Pose::new(DVec3::new(0.1, -0.2, 0.3), DQuat::from_scaled_axis(DVec3::new(0.3, 1.0, -0.5)));
        let pose_b = Pose::from_translation(DVec3::new(0.2, 0.0, 0.0));
        let placed = |mesh: &TriMesh, pose: &Pose, t: usize| mesh.corners(t).map(|p| pose.transform_point(p));
        let mut expected = Vec::new();
        for i in 0..150 {
            for j in 0..150 {
                if triangles::meet(&placed(&a, &pose_a, i), &placed(&b, &pose_b, j)) {
                    expected.push([i as u32, j as u32]);
                }
            }
        }
        assert!(expected.len() > 50, "seed {seed}");
        assert_eq!(intersecting_pairs(&a, &pose_a, &b, &pose_b, usize::MAX), expected);
        assert_eq!(intersecting_pairs(&a, &pose_a, &b, &pose_b, 7), expected[..7]);
        let far = Pose::from_translation(DVec3::splat(10.0));
        assert!(intersecting_pairs(&a, &pose_a, &b, &far, usize::MAX).is_empty());
    }

    /// A power of two changes no sign, up to the ends of the range of f64.
    #[test]
    fn the_unit_does_not_matter() {
        let mesh = soup(&mut StdRng::seed_from_u64(17), 300, 0.3);
        let expected = self_intersections(&mesh);
        for factor in [2.0_f64.powi(-900), 2.0_f64.powi(900)] {
            let vertices = mesh.vertices().iter().map(|v| *v * factor).collect();
            let scaled = TriMesh::new(vertices, mesh.triangles().to_vec()).unwrap();
            assert_eq!(self_intersections(&scaled), expected, "{factor:e}");
        }
    }

    #[test]
    fn degenerate_meshes_have_no_intersections() {
        let none = SelfIntersections::default();
        assert_eq!(self_intersections(&TriMesh::default()), none);
        let at_origin = TriMesh::new(vec![DVec3::ZERO; 3], vec![[0, 1, 2], [0, 0, 0]]).unwrap();
        assert_eq!(self_intersections(&at_origin), none);
        let mut vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::splat(f64::NAN)];
        let broken =
            TriMesh::new(vertices.clone(), vec![[0, 1, 3], [1, 2, 3], [0, 1, 2], [2, 0, 1]]).unwrap();
        assert_eq!(
            self_intersections(&broken),
            none,
            "duplicates and triangles that are not finite are not counted here"
        );
        vertices[3] = DVec3::new(0.5, 0.5, 0.0);
        let folded = TriMesh::new(vertices, vec![[0, 1, 2], [1, 0, 3]]).unwrap();
        assert_eq!(self_intersections(&folded), SelfIntersections { count: 1, first: Some([0, 1]) });
    }
}
