//! Volume, centre of mass and inertia of a solid of uniform density, as polyhedral integrals.
//!
//! The divergence theorem turns the integrals of 1, xᵢ and xᵢxⱼ over a solid into sums over its surface triangles
//! (Mirtich, *Fast and accurate computation of polyhedral mass properties*, 1996; Eberly, *Polyhedral mass properties*,
//! 2002). Equivalently, and as done here, each triangle (a, b, c) contributes the signed tetrahedron that it spans with
//! the origin: with d = det(a, b, c) and s = a + b + c these are d/6, d s/24 and d (aaᵀ + bbᵀ + ccᵀ + ssᵀ)/120.
//!
//! The origin is the middle of the bounding box, coordinates relative to it are exact, and the sums are carried in
//! double-double arithmetic: neither distance from the file's origin nor slenderness costs digits, and the error of the
//! result is its rounding to f64.

use glam::{DMat3, DVec3};

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

/// A volume below this multiple of the cube of the half extent is what rounding of the coordinates alone makes.
const NEGLIGIBLE_VOLUME: f64 = 1e-15;

/// Half extents (m) for which r⁵, and so the inertia, stays far within the range of f64.
const HALF_EXTENTS: std::ops::Range<f64> = 1e-50..1e50;

impl TriMesh {
    /// Mass properties at a uniform density (kg/m³).
    ///
    /// What is needed of the surface is what the divergence theorem needs: at every edge as many triangles run one way as
    /// the other. A closed, oriented 2-manifold has that; so have solids that touch along an edge. Where shells overlap,
    /// the common volume counts once for each.
    ///
    /// # Errors
    /// If a triangle has a vertex that is not finite; if the surface is open, inconsistently oriented, inside out
    /// (as a whole, or in part so that the tensor is not one of a body) or without volume; if the density is not
    /// positive and finite; or if the results are not within the range of f64.
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

    /// The signed volume, m³: the sum of the signed tetrahedra of all triangles with finite vertices. For a surface
    /// without border that is the enclosed volume, whatever the origin; for another one it depends on the origin, and that
    /// of the mesh's frame is taken. 0 when out of the range of f64.
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

/// The first edge (in order of its vertices) at which the triangles' directions do not cancel, a triangle at it,
/// and whether the number of triangles is even, so that turning some of them would make them cancel.
fn unbalanced_edge(mesh: &TriMesh, adjacency: &Adjacency) -> Option<([u32; 2], u32, bool)> {
    (0..adjacency.edges().len() as u32).find_map(|edge| {
        let sides = adjacency.edge_sides(edge);
        let upward = sides.iter().filter(|side| mesh.half_edge(**side).is_sorted()).count();
        (2 * upward != sides.len())
            .then(|| (adjacency.edges()[edge as usize], sides[0].triangle(), sides.len().is_multiple_of(2)))
    })
}

/// Coordinates relative to a centre, in units of a power of two near the half extent. Nothing is lost in them.
struct LocalFrame {
    center: DVec3,
    unit: f64,
}

impl LocalFrame {
    /// The frame about the middle of the bounding box of the triangles' vertices; none without finite extent.
    fn of_box(mesh: &TriMesh) -> Option<Self> {
        let sphere = mesh.bounding_sphere();
        Self::new(sphere.center, sphere.radius)
    }

    /// The frame about the origin; none if all vertices are there.
    fn of_origin(mesh: &TriMesh) -> Option<Self> {
        let reach = mesh.vertices.iter().filter(|p| p.is_finite()).map(|p| p.abs().max_element());
        Self::new(DVec3::ZERO, reach.fold(0.0, f64::max))
    }

    fn new(center: DVec3, reach: f64) -> Option<Self> {
        // The largest power of two whose reciprocal is also a normal number bounds the unit from both sides.
        let exponent =
            if reach > 0.0 { reach.log2().floor().clamp(-1021.0, 1021.0) as i32 } else { return None };
        Some(Self { center, unit: 2f64.powi(exponent) })
    }

    fn local(&self, p: DVec3) -> [DoubleDouble; 3] {
        let inverse = 1.0 / self.unit;
        [0, 1, 2].map(|i| DoubleDouble::difference(p[i] * inverse, self.center[i] * inverse))
    }
}

/// a · (b × c).
fn determinant([a, b, c]: [[DoubleDouble; 3]; 3]) -> DoubleDouble {
    a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
}

/// Index pairs (i, j) of a symmetric tensor's entries xx, yy, zz, xy, yz, zx.
const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)];

/// Sums over tetrahedra: 6 ∫1, 24 ∫xᵢ and 120 ∫xᵢxⱼ.
#[derive(Default)]
struct Integrals {
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
        let d = determinant(corners);
        let s = [0, 1, 2].map(|i| a[i] + b[i] + c[i]);
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

    /// Centre of mass and inertia about it.
    fn solid(&self) -> Result<UnitSolid, MeshError> {
        let volume = self.volume();
        if volume.abs() <= NEGLIGIBLE_VOLUME {
            return Err(MeshError::NoVolume);
        }
        if volume < 0.0 {
            return Err(MeshError::Inverted);
        }
        // Central second moments C = ∫xᵢxⱼ − (∫xᵢ)(∫xⱼ)/V. Multiplied by 96·6V, the difference needs no division
        // before the cancellation is over: 96·6V·C = 0.8·(6V)(120∫xᵢxⱼ) − (24∫xᵢ)(24∫xⱼ), and 0.8 = 4/5.
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
        let trace = xx + yy + zz;
        Ok(UnitSolid {
            center: DVec3::from_array(self.first.map(DoubleDouble::value)) / (24.0 * volume),
            inertia: DMat3::from_diagonal(DVec3::splat(trace)) - covariance,
        })
    }
}
