//! Contacts between two meshes by parry3d (f64): its contact manifolds, and all pairs of triangles within the
//! tolerance by a traversal of both of its bounding volume hierarchies. The signed distances of distance
//! grids are also parry's.
//!
//! Some of parry's tolerances are absolute (a manifold is kept while its points move by less than 1e-3):
//! lengths are scaled here so that the probe's radius is `RADIUS`.

use std::error::Error;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::Path;

use palpate::glam::DVec3;
use palpate::{Contact, Pose};
use palpate_field::AreaContact;
use parry3d_f64::math::{Matrix, Pose as Isometry, Rotation, Vector};
use parry3d_f64::partitioning::BvhNode;
use parry3d_f64::query::details::{ContactManifoldsWorkspace, contact_support_map_support_map};
use parry3d_f64::query::{
    self, ContactManifold, DefaultQueryDispatcher, PersistentQueryDispatcher as _, PointQuery as _,
    TrackedContact,
};
use parry3d_f64::shape::{TriMesh, TriMeshBuilderError, TriMeshFlags};

use crate::method::Method;
use crate::point_shell::DistanceGrid;
use crate::scenarios::{Body, Scenario};

/// Radius of the probe in parry's units.
const RADIUS: f64 = 100.0;

/// Probe and scene object as parry's meshes.
struct ParryPair {
    probe: TriMesh,
    scene: TriMesh,
    /// Parry's units per metre.
    scale: f64,
    tolerance: f64,
}

impl ParryPair {
    fn new(scenario: &Scenario, flags: TriMeshFlags) -> Result<Self, TriMeshBuilderError> {
        let scale = RADIUS / scenario.probe.object.bounding_radius();
        let mesh = |body: &Body| mesh(body, scale, flags);
        Ok(Self {
            probe: mesh(&scenario.probe)?,
            scene: mesh(&scenario.scene)?,
            scale,
            tolerance: scale * scenario.tolerance,
        })
    }

    /// Returns the bytes of memory that both meshes hold.
    fn bytes(&self) -> usize {
        self.probe.total_memory_size() + self.scene.total_memory_size()
    }

    /// Returns the scene object's pose in the probe's frame.
    fn scene_in_probe(&self, pose: &Pose) -> Isometry {
        let rotation = Rotation::from_array(pose.rotation.to_array());
        Isometry::from_parts(vector(pose.translation, self.scale), rotation).inverse()
    }

    /// Returns the area (m²) of the smaller of two triangles.
    fn area(&self, probe: u32, scene: u32) -> f64 {
        let area = self.probe.triangle(probe).area().min(self.scene.triangle(scene).area());
        area / (self.scale * self.scale)
    }

    /// Converts a contact in the probe's frame to scene axes.
    fn placed(&self, point: Vector, normal: Vector, distance: f64, pose: &Pose) -> Contact {
        let point = pose.transform_point(DVec3::from_array(point.to_array()) / self.scale);
        let normal = pose.transform_vector(DVec3::from_array(normal.to_array()));
        let depth = -distance / self.scale;
        Contact { point, scene_point: point - depth * normal, normal, depth }
    }
}

/// Contact manifolds of oriented meshes, with normals limited to what the neighbouring triangles allow. They
/// persist from query to query, as in parry.
pub struct Manifolds {
    pair: ParryPair,
    manifolds: Vec<ContactManifold<(), ()>>,
    workspace: Option<ContactManifoldsWorkspace>,
}

impl Manifolds {
    /// Builds the meshes of a scenario's bodies.
    ///
    /// # Errors
    /// If parry refuses a mesh.
    pub fn new(scenario: &Scenario) -> Result<Self, TriMeshBuilderError> {
        let pair = ParryPair::new(scenario, TriMeshFlags::ORIENTED | TriMeshFlags::FIX_INTERNAL_EDGES)?;
        Ok(Self { pair, manifolds: Vec::new(), workspace: None })
    }
}

impl Method for Manifolds {
    fn run(&mut self, pose: &Pose) {
        let ParryPair { probe, scene, tolerance, .. } = &self.pair;
        let found = DefaultQueryDispatcher.contact_manifolds(
            &self.pair.scene_in_probe(pose),
            probe,
            scene,
            *tolerance,
            &mut self.manifolds,
            &mut self.workspace,
        );
        assert!(found.is_ok(), "parry has manifolds between meshes");
    }

    /// Appends the manifolds' points within the tolerance, which share the area.
    fn append_contacts(&self, pose: &Pose, found: &mut Vec<AreaContact>) {
        for manifold in &self.manifolds {
            let within = |point: &&TrackedContact<()>| point.dist < self.pair.tolerance;
            let count = manifold.points.iter().filter(within).count();
            let area = self.pair.area(manifold.subshape1, manifold.subshape2) / count as f64;
            found.extend(manifold.points.iter().filter(within).map(|point| AreaContact {
                contact: self.pair.placed(point.local_p1, manifold.local_n1, point.dist, pose),
                area,
            }));
        }
    }

    /// Includes both meshes; parry does not report the size of the manifolds.
    fn bytes(&self) -> usize {
        self.pair.bytes()
    }
}

/// All pairs of triangles within the tolerance, each with its contact by GJK and EPA.
pub struct TrianglePairs {
    pair: ParryPair,
    /// Contacts with their triangles.
    found: Vec<(query::Contact, [u32; 2])>,
}

impl TrianglePairs {
    /// Builds the meshes of a scenario's bodies.
    ///
    /// # Errors
    /// If parry refuses a mesh.
    pub fn new(scenario: &Scenario) -> Result<Self, TriMeshBuilderError> {
        Ok(Self { pair: ParryPair::new(scenario, TriMeshFlags::empty())?, found: Vec::new() })
    }
}

impl Method for TrianglePairs {
    fn run(&mut self, pose: &Pose) {
        self.found.clear();
        let ParryPair { probe, scene, tolerance, .. } = &self.pair;
        let placement = self.pair.scene_in_probe(pose);
        let rotation = Matrix::from_quat(placement.rotation);
        let back = rotation.transpose();
        let (extent, extent_back) = (rotation.abs(), back.abs());
        // Boxes are separated if they are further apart than the tolerance along an axis of one of them.
        let near = |a: &BvhNode, b: &BvhNode| {
            let (size_a, size_b) = (a.maxs() - a.mins(), b.maxs() - b.mins());
            let between = placement * b.center() - a.center();
            let reach_a = (size_a + extent * size_b) * 0.5 + *tolerance;
            let reach_b = (size_b + extent_back * size_a) * 0.5 + *tolerance;
            between.abs().cmple(reach_a).all() && (back * between).abs().cmple(reach_b).all()
        };
        for (a, b) in probe.bvh().leaf_pairs(scene.bvh(), near) {
            let (first, second) = (probe.triangle(a), scene.triangle(b));
            let contact = contact_support_map_support_map(&placement, &first, &second, *tolerance);
            self.found.extend(contact.map(|contact| (contact, [a, b])));
        }
    }

    fn append_contacts(&self, pose: &Pose, found: &mut Vec<AreaContact>) {
        found.extend(self.found.iter().map(|(contact, [a, b])| AreaContact {
            contact: self.pair.placed(contact.point1, contact.normal1, contact.dist, pose),
            area: self.pair.area(*a, *b),
        }));
    }

    fn bytes(&self) -> usize {
        self.pair.bytes() + self.found.capacity() * size_of::<(query::Contact, [u32; 2])>()
    }
}

/// Signed distances of points from a body, by parry's projection and pseudo-normals.
pub struct SignedDistance {
    mesh: TriMesh,
    scale: f64,
}

impl SignedDistance {
    /// Prepares a body.
    ///
    /// # Errors
    /// If parry refuses a mesh.
    pub fn new(body: &Body) -> Result<Self, TriMeshBuilderError> {
        let scale = RADIUS / body.object.bounding_radius();
        Ok(Self { mesh: mesh(body, scale, TriMeshFlags::ORIENTED)?, scale })
    }

    /// Returns the signed distance at a point of the body's frame, m; negative inside.
    pub fn at(&self, point: DVec3) -> f64 {
        self.nearest(point).1
    }

    /// Returns the point of the surface nearest to a point, both in the body's frame, m, and the signed
    /// distance, m.
    pub fn nearest(&self, point: DVec3) -> (DVec3, f64) {
        let found = self.mesh.project_local_point(vector(point, self.scale), false);
        let nearest = DVec3::from_array(found.point.to_array()) / self.scale;
        let distance = nearest.distance(point);
        (nearest, if found.is_inside { -distance } else { distance })
    }
}

/// Returns the distance grid of a body: from a folder if it is there, or else built.
///
/// # Errors
/// If parry refuses the mesh, or the folder cannot be written to.
pub fn distance_grid(
    body: &Body,
    samples: usize,
    tolerance: f64,
    folder: Option<&Path>,
) -> Result<DistanceGrid, Box<dyn Error>> {
    let distance = SignedDistance::new(body)?;
    // Three diagonals of a cell, with `samples` cells across the bounding sphere.
    let band = 2.0 * tolerance + 6.0 * body.object.bounding_radius() / samples as f64;
    let build = || DistanceGrid::new(&body.mesh, samples, tolerance, band, |point| distance.at(point));
    let Some(folder) = folder else { return Ok(build()) };
    let mut hasher = DefaultHasher::new();
    body.mesh.triangles().hash(&mut hasher);
    for vertex in body.mesh.vertices() {
        vertex.to_array().map(f64::to_bits).hash(&mut hasher);
    }
    tolerance.to_bits().hash(&mut hasher);
    let name = format!("distance-{samples}-{:016x}.distances", hasher.finish());
    Ok(DistanceGrid::cached(&folder.join(name), build)?)
}

fn mesh(body: &Body, scale: f64, flags: TriMeshFlags) -> Result<TriMesh, TriMeshBuilderError> {
    let vertices = body.mesh.vertices().iter().map(|vertex| vector(*vertex, scale)).collect();
    TriMesh::with_flags(vertices, body.mesh.triangles().to_vec(), flags)
}

fn vector(v: DVec3, scale: f64) -> Vector {
    Vector::from_array((v * scale).to_array())
}
