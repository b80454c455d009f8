//! Volume, centre of mass and inertia of a solid of uniform density, as polyhedral integrals.
//!
//! The divergence theorem turns the integrals of 1, xᵢ and xᵢxⱼ over a solid into sums over its surface
//! triangles (Mirtich, *Fast and accurate computation of polyhedral mass properties*, 1996; Eberly,
//! *Polyhedral mass properties*, 2002). Equivalently, and as done here, each triangle (a, b, c) contributes
//! the signed tetrahedron that it spans with the origin: with d = det(a, b, c) and s = a + b + c these are
//! d/6, d s/24 and d (aaᵀ + bbᵀ + ccᵀ + ssᵀ)/120.
//!
//! The origin is the middle of the bounding box, coordinates relative to it are exact, and the sums are
//! carried in double-double arithmetic: neither distance from the file's origin nor slenderness costs digits,
//! and the error of the result is its rounding to f64.

use glam::{DMat3, DVec3};

use super::bounding::power_of_two_near;
use super::double_double::DoubleDouble;
use super::{Adjacency, MeshError, TriMesh};

/// Mass properties of a solid of uniform density.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassProperties {
    /// Mass, kg.
    pub mass: f64,
    /// Volume, m³.
    pub volume: f64,
    /// Centre of mass, m, in the mesh's frame.
    pub center_of_mass: DVec3,
    /// Inertia tensor about the centre of mass, kg·m², in the mesh's axes.
    pub inertia: DMat3,
}

/// Thickness (volume over area), as a multiple of the bounding radius, that rounding of the coordinates alone
/// makes: a thinner mesh encloses no volume.
const NEGLIGIBLE_THICKNESS: f64 = 1e-15;

/// Half extents (m) for which r⁵, and so the inertia, stays far within the range of f64.
const HALF_EXTENTS: std::ops::Range<f64> = 1e-50..1e50;

impl TriMesh {
    /// Mass properties at a uniform density (kg/m³).
    ///
    /// The divergence theorem requires that, at every edge, as many triangles run in one direction as in the
    /// other. A closed, oriented 2-manifold fulfils this, and so do solids that touch along an edge. Where
    /// shells overlap, the common volume counts once for each.
    ///
    /// # Errors
    /// If a triangle has a vertex that is not finite; if the surface is open, inconsistently oriented, inside
    /// out (as a whole, or in part so that the tensor is not that of a body) or without volume; if the
    /// density is not positive and finite; or if the results are not within the range of f64.
    pub fn mass_properties(&self, density: f64) -> Result<MassProperties, MeshError> {
        if !(density.is_finite() && density > 0.0) {
            return Err(MeshError::BadDensity);
        }
        for (triangle, corners) in self.triangles.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|v| !self.vertices[**v as usize].is_finite()) {
                return Err(MeshError::NonFinite { triangle, vertex });
            }
        }
        if let Some((edge, triangle, directions_pair_off)) = unbalanced_edge(self, &self.adjacency()) {
            let triangle = triangle as usize;
            return Err(if directions_pair_off {
                MeshError::Misoriented { edge, triangle }
            } else {
                MeshError::Open { edge, triangle }
            });
        }
        let frame = LocalFrame::of_box(self).ok_or(MeshError::NoVolume)?;
        if !HALF_EXTENTS.contains(&frame.unit) {
            return Err(MeshError::OutOfRange);
        }

        let mut integrals = Integrals::default();
        for t in 0..self.triangles.len() {
            integrals.add(self.corners(t).map(|p| frame.local(p)));
        }
        let volume = integrals.volume() * frame.unit.powi(3);
        let solid = integrals.solid()?;
        let mass = density * volume;
        let inertia = solid.inertia * (mass * frame.unit * frame.unit);
        if !(mass.is_normal() && volume.is_normal() && inertia.is_finite()) {
            return Err(MeshError::OutOfRange);
        }
        Ok(MassProperties { mass, volume, center_of_mass: frame.center + solid.center * frame.unit, inertia })
    }

    /// The signed volume, m³: the sum of the signed tetrahedra of all triangles with finite vertices. For a
    /// surface without border this is the enclosed volume, whatever the origin; for a surface with one it
    /// depends on the origin, and that of the mesh's frame is taken. 0 when out of the range of f64.
    pub(super) fn signed_volume(&self, adjacency: &Adjacency) -> f64 {
        let finite = (0..self.triangles.len())
            .map(|t| self.corners(t))
            .filter(|corners| corners.iter().all(|p| p.is_finite()));
        let closed =
            unbalanced_edge(self, adjacency).is_none() && finite.clone().count() == self.triangles.len();
        let frame = if closed { LocalFrame::of_box(self) } else { LocalFrame::of_origin(self) };
        let Some(frame) = frame else { return 0.0 };
        let mut six_volumes = DoubleDouble::default();
        for corners in finite {
            six_volumes += determinant(corners.map(|p| frame.local(p)));
        }
        // One factor at a time, since the cube of the unit alone may leave the range.
        let volume = six_volumes.value() / 6.0 * frame.unit * frame.unit * frame.unit;
        if volume.is_finite() { volume } else { 0.0 }
    }
}

/// The first edge (in order of its vertices) at which the triangles' directions do not cancel, a triangle at
/// it, and whether the number of triangles is even, so that turning some of them would make them cancel.
fn unbalanced_edge(mesh: &TriMesh, adjacency: &Adjacency) -> Option<([u32; 2], u32, bool)> {
    (0..adjacency.edges().len() as u32).find_map(|edge| {
        let sides = adjacency.edge_sides(edge);
        let upward = sides.iter().filter(|side| mesh.half_edge(**side).is_sorted()).count();
        (2 * upward != sides.len())
            .then(|| (adjacency.edges()[edge as usize], sides[0].triangle(), sides.len().is_multiple_of(2)))
    })
}

/// Coordinates relative to a centre, in units of a power of two near the half extent. They are exact.
struct LocalFrame {
    center: DVec3,
    unit: f64,
}

impl LocalFrame {
    /// The frame about the middle of the bounding box of the triangles' vertices; `None` without a finite
    /// extent.
    fn of_box(mesh: &TriMesh) -> Option<Self> {
        let sphere = mesh.bounding_sphere();
        Self::new(sphere.center, sphere.radius)
    }

    /// The frame about the origin; `None` if all vertices are there.
    fn of_origin(mesh: &TriMesh) -> Option<Self> {
        let reach = mesh.vertices.iter().filter(|p| p.is_finite()).map(|p| p.abs().max_element());
        Self::new(DVec3::ZERO, reach.fold(0.0, f64::max))
    }

    fn new(center: DVec3, reach: f64) -> Option<Self> {
        (reach > 0.0).then(|| Self { center, unit: power_of_two_near(reach) })
    }

    fn local(&self, p: DVec3) -> [DoubleDouble; 3] {
        let inverse = 1.0 / self.unit;
        [0, 1, 2].map(|i| DoubleDouble::difference(p[i] * inverse, self.center[i] * inverse))
    }
}

/// Triple product a · (b × c).
fn determinant([a, b, c]: [[DoubleDouble; 3]; 3]) -> DoubleDouble {
    a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
}

/// Index pairs (i, j) of a symmetric tensor's entries xx, yy, zz, xy, yz, zx.
const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)];

/// Sums over tetrahedra: 6 ∫1, 24 ∫xᵢ and 120 ∫xᵢxⱼ; and the area of the surface.
#[derive(Default)]
struct Integrals {
    area: f64,
    one: DoubleDouble,
    first: [DoubleDouble; 3],
    second: [DoubleDouble; 6],
}

/// A body of unit mass in local coordinates.
struct UnitSolid {
    center: DVec3,
    inertia: DMat3,
}

impl Integrals {
    fn add(&mut self, corners: [[DoubleDouble; 3]; 3]) {
        let [a, b, c] = corners;
        // d/6 is the volume of the tetrahedron, d s/24 its ∫x and d (aaᵀ + bbᵀ + ccᵀ + ssᵀ)/120 its ∫xxᵀ.
        let d = determinant(corners);
        let s = [0, 1, 2].map(|i| a[i] + b[i] + c[i]);
        let [p, q, r] = corners.map(|corner| DVec3::from_array(corner.map(DoubleDouble::value)));
        self.area += (q - p).cross(r - p).length() / 2.0;
        self.one += d;
        for (sum, s) in self.first.iter_mut().zip(s) {
            *sum += d * s;
        }
        for (sum, (i, j)) in self.second.iter_mut().zip(PAIRS) {
            *sum += d * (a[i] * a[j] + b[i] * b[j] + c[i] * c[j] + s[i] * s[j]);
        }
    }

    fn volume(&self) -> f64 {
        self.one.value() / 6.0
    }

    /// The body of unit mass: its centre of mass, and its inertia about that.
    fn solid(&self) -> Result<UnitSolid, MeshError> {
        let volume = self.volume();
        // The radius is between one and two of the local units.
        if volume.abs() <= NEGLIGIBLE_THICKNESS * self.area {
            return Err(MeshError::NoVolume);
        }
        if volume < 0.0 {
            return Err(MeshError::Inverted);
        }
        // Central second moments C = ∫xᵢxⱼ − (∫xᵢ)(∫xⱼ)/V. Multiplied by 96·6V, the difference needs no
        // division before the cancellation is over: 96·6V·C = 0.8·(6V)(120∫xᵢxⱼ) − (24∫xᵢ)(24∫xⱼ), and 0.8 =
        // 4/5.
        let five = DoubleDouble::difference(5.0, 0.0);
        let mut covariance = [0.0; 6];
        for ((entry, sum), (i, j)) in covariance.iter_mut().zip(self.second).zip(PAIRS) {
            let central = (self.one * sum).scaled(4.0) - five * self.first[i] * self.first[j];
            *entry = central.value() / (480.0 * 6.0 * volume * volume);
        }
        let [xx, yy, zz, xy, yz, zx] = covariance;
        let covariance = DMat3::from_cols_array(&[xx, xy, zx, xy, yy, yz, zx, yz, zz]);
        let positive = xx > 0.0 && xx * yy > xy * xy && covariance.determinant() > 0.0;
        if !positive {
            return Err(MeshError::PartlyInverted);
        }
        Ok(UnitSolid {
            center: DVec3::from_array(self.first.map(DoubleDouble::value)) / (24.0 * volume),
            inertia: DMat3::from_cols_array(&[yy + zz, -xy, -zx, -xy, zz + xx, -yz, -zx, -yz, xx + yy]),
        })
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    use super::super::test_shapes::{
        cuboid, mapped, reversed, rotation, sphere, tangle, tetrahedron, together,
    };
    use super::*;

    fn largest(matrix: DMat3) -> f64 {
        matrix.to_cols_array().into_iter().fold(0.0, |largest, entry| entry.abs().max(largest))
    }

    fn assert_close(ours: &MassProperties, expected: &MassProperties, tolerance: f64, size: f64) {
        assert!((ours.mass / expected.mass - 1.0).abs() <= tolerance, "{ours:?}, expected {expected:?}");
        assert!((ours.volume / expected.volume - 1.0).abs() <= tolerance, "{ours:?}, expected {expected:?}");
        let off_center = ours.center_of_mass.distance(expected.center_of_mass);
        assert!(off_center <= tolerance * size, "{ours:?}, expected {expected:?}");
        let off = largest(ours.inertia - expected.inertia);
        assert!(off <= tolerance * largest(expected.inertia), "{ours:?}, expected {expected:?}");
    }

    fn box_properties(low: DVec3, high: DVec3, density: f64) -> MassProperties {
        let size = high - low;
        let volume = size.x * size.y * size.z;
        let squares = size * size;
        MassProperties {
            mass: density * volume,
            volume,
            center_of_mass: (low + high) / 2.0,
            inertia: DMat3::from_diagonal(DVec3::splat(squares.element_sum()) - squares)
                * (density * volume / 12.0),
        }
    }

    /// Properties of a body moved rigidly.
    fn moved(p: &MassProperties, rotation: DQuat, translation: DVec3) -> MassProperties {
        let matrix = DMat3::from_quat(rotation);
        MassProperties {
            center_of_mass: rotation * p.center_of_mass + translation,
            inertia: matrix * p.inertia * matrix.transpose(),
            ..*p
        }
    }

    #[test]
    fn boxes_are_exact() {
        let (low, high) = (DVec3::new(0.1, -0.7, 3.0), DVec3::new(0.15, 2.0, 3.001));
        let ours = cuboid(low, high).mass_properties(2700.0).unwrap();
        // The sizes lose digits by subtraction in the expectation, not in the mesh.
        assert_close(&ours, &box_properties(low, high, 2700.0), 1e-12, 3.0);
        let ours = cuboid(DVec3::ZERO, DVec3::new(1.0, 2.0, 4.0)).mass_properties(1.0).unwrap();
        assert_close(&ours, &box_properties(DVec3::ZERO, DVec3::new(1.0, 2.0, 4.0), 1.0), 1e-15, 1.0);
    }

    #[test]
    fn the_corner_tetrahedron_is_exact() {
        let ours = tetrahedron().mass_properties(6.0).unwrap();
        // Central second moments per unit mass: 3/80 on the diagonal, −1/80 off it.
        let covariance =
            DMat3::from_cols_array(&[3.0, -1.0, -1.0, -1.0, 3.0, -1.0, -1.0, -1.0, 3.0]) * (1.0 / 80.0);
        let inertia = DMat3::IDENTITY * (9.0 / 80.0) - covariance;
        let expected =
            MassProperties { mass: 1.0, volume: 1.0 / 6.0, center_of_mass: DVec3::splat(0.25), inertia };
        assert_close(&ours, &expected, 1e-15, 1.0);
    }

    #[test]
    fn spheres_converge_quadratically() {
        let radius: f64 = 0.03;
        let volume = 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
        let errors: Vec<[f64; 2]> = (2..6)
            .map(|levels| {
                let p = sphere(radius, levels).mass_properties(1000.0).unwrap();
                assert!(p.center_of_mass.length() < 1e-15 * radius);
                let inertia = 0.4 * 1000.0 * volume * radius * radius;
                [1.0 - p.volume / volume, 1.0 - p.inertia.x_axis.x / inertia]
            })
            .collect();
        for pair in errors.windows(2) {
            for (coarse, fine) in pair[0].iter().zip(pair[1]) {
                assert!((3.5..4.5).contains(&(coarse / fine)), "{errors:?}");
            }
        }
        assert!(errors[3][0] < 2e-3);
    }

    #[test]
    fn a_translation_that_coordinates_can_hold_changes_no_bit() {
        const SEED: u64 = 31;
        let random = &mut StdRng::seed_from_u64(SEED);
        // Multiples of 2⁻²⁰ moved by 2³⁰ still fit into 53 bits.
        let grid = 2f64.powi(-20);
        let blob =
            mapped(&sphere(1.0, 3), |p| ((p * (1.0 + 0.1 * random.random::<f64>())) / grid).round() * grid);
        let shift = DVec3::new(2f64.powi(30), -3.0 * 2f64.powi(29), 5.0);
        let [here, there] =
            [DVec3::ZERO, shift].map(|by| mapped(&blob, |p| p + by).mass_properties(1.0).unwrap());
        assert_eq!(here.volume, there.volume);
        assert_eq!(here.inertia, there.inertia);
        assert!((here.center_of_mass + shift).distance(there.center_of_mass) <= 2f64.powi(-22));
    }

    #[test]
    fn inertia_turns_with_the_mesh() {
        const SEED: u64 = 32;
        let random = &mut StdRng::seed_from_u64(SEED);
        for _ in 0..50 {
            let shape = DVec3::from_array([0; 3].map(|_| random.random_range(0.1..2.0)));
            let mesh = mapped(&tetrahedron(), |p| p * shape);
            let (turn, shift) = (rotation(random), DVec3::splat(random.random_range(-5.0..5.0)));
            let expected = moved(&mesh.mass_properties(800.0).unwrap(), turn, shift);
            let ours = mapped(&mesh, |p| turn * p + shift).mass_properties(800.0).unwrap();
            assert_close(&ours, &expected, 1e-12, 5.0);
        }
    }

    /// Bodies far apart, where sums about one origin lose most digits of f64.
    #[test]
    fn small_bodies_far_apart_keep_their_digits() {
        let small = cuboid(DVec3::ZERO, DVec3::ONE);
        let pair = together(&[small.clone(), mapped(&small, |p| p + DVec3::new(2f64.powi(20), 0.0, 0.0))]);
        let ours = pair.mass_properties(1.0).unwrap();
        assert_eq!(ours.volume, 2.0);
        assert_eq!(ours.inertia.x_axis.x, 2.0 / 6.0);
        // Each is half of 2²⁰ m from the common centre of mass.
        let expected = 2.0 * 2f64.powi(38) + 2.0 / 6.0;
        assert!((ours.inertia.y_axis.y / expected - 1.0).abs() < 1e-15);
    }

    #[test]
    fn cavities_are_subtracted() {
        let (outer, inner) = (DVec3::splat(2.0), DVec3::new(1.0, 0.5, 0.25));
        let hollow = together(&[cuboid(-outer, outer), reversed(&cuboid(-inner, inner))]);
        let [full, hole] = [outer, inner].map(|half| box_properties(-half, half, 10.0));
        let expected = MassProperties {
            mass: full.mass - hole.mass,
            volume: full.volume - hole.volume,
            center_of_mass: DVec3::ZERO,
            inertia: full.inertia - hole.inertia,
        };
        assert_close(&hollow.mass_properties(10.0).unwrap(), &expected, 1e-15, 1.0);
    }

    #[test]
    fn solids_that_touch_along_an_edge_are_accepted() {
        let [a, b] = [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0)].map(|low| cuboid(low, low + DVec3::ONE));
        // The second box's vertices 0 and 4 are the first one's 3 and 7.
        let shared = |v: u32| match v {
            8 => 3,
            12 => 7,
            other => other,
        };
        let both = together(&[a, b]);
        let triangles = both.triangles().iter().map(|t| t.map(shared)).collect();
        let joined = TriMesh::new(both.vertices().to_vec(), triangles).unwrap();
        assert_eq!(joined.validate().nonmanifold_edges, 1);
        assert_eq!(joined.mass_properties(1.0).unwrap().volume, 2.0);
    }

    #[test]
    fn meshes_that_are_not_solids_are_refused() {
        let block = cuboid(DVec3::ZERO, DVec3::ONE);
        let properties = |mesh: &TriMesh| mesh.mass_properties(1.0);
        assert_eq!(properties(&TriMesh::default()), Err(MeshError::NoVolume));
        assert_eq!(properties(&reversed(&block)), Err(MeshError::Inverted));
        for density in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(block.mass_properties(density), Err(MeshError::BadDensity));
        }

        let mut triangles = block.triangles().to_vec();
        let [a, b, c] = triangles[5];
        triangles[5] = [a, c, b];
        let flipped = TriMesh::new(block.vertices().to_vec(), triangles.clone()).unwrap();
        assert!(matches!(properties(&flipped), Err(MeshError::Misoriented { .. })));
        triangles.remove(5);
        let open = TriMesh::new(block.vertices().to_vec(), triangles).unwrap();
        assert!(
            matches!(properties(&open), Err(MeshError::Open { edge, .. }) if edge.iter().all(|v| [a, b, c].contains(v)))
        );

        let sheet = TriMesh::new(block.vertices().to_vec(), vec![[0, 1, 2], [0, 2, 1]]).unwrap();
        assert_eq!(properties(&sheet), Err(MeshError::NoVolume));
        let mut vertices = block.vertices().to_vec();
        vertices[6].y = f64::NAN;
        let broken = TriMesh::new(vertices, block.triangles().to_vec()).unwrap();
        assert!(matches!(properties(&broken), Err(MeshError::NonFinite { vertex: 6, .. })));
        for scale in [1e-300, 1e-80, 1e80, 1e300] {
            assert_eq!(properties(&mapped(&block, |p| p * scale)), Err(MeshError::OutOfRange));
        }
        // An inverted shell outside of the body is no cavity.
        let hole = reversed(&mapped(&block, |p| 0.9 * p + DVec3::X * 50.0));
        assert_eq!(properties(&together(&[block, hole])), Err(MeshError::PartlyInverted));
    }

    #[test]
    fn the_volume_of_an_open_surface_is_about_the_origin() {
        const SEED: u64 = 33;
        let random = &mut StdRng::seed_from_u64(SEED);
        for _ in 0..200 {
            let mesh = tangle(random, 9, 15);
            let plain: f64 = (0..15).map(|t| mesh.corners(t)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
            assert!((mesh.validate().volume - plain).abs() < 1e-14, "seed {SEED}");
        }
    }
}
