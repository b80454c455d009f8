//! Reference contacts, computed slowly and without the engine: points all over both surfaces, sampled ever
//! more densely, with their signed distances from the other mesh by parry. The wrench is that of the
//! [`AreaLaw`], which converges with the density.

use std::error::Error;

use palpate::core::mesh::Sphere;
use palpate::glam::DVec3;
use palpate::{Contact, Pose, TriMesh, Wrench};
use palpate_field::{AreaContact, AreaLaw};
use rayon::prelude::*;

use crate::parry::SignedDistance;
use crate::scenarios::Scenario;

/// Lattice constant of the law, relative to the probe's radius.
pub const LAW_REACH: f64 = 0.25;
/// Largest distance of the first samples, relative to the probe's radius.
const FIRST_SPACING: f64 = 0.02;
/// Relative change of the force below which sampling stops, and largest number of samples. The spacing is
/// halved until then.
const MAX_CHANGE: f64 = 0.01;
const MAX_SAMPLES: usize = 4_000_000;

/// Both bodies of a scenario, prepared for sampling.
pub struct Reference {
    sides: [Side; 2],
    law: AreaLaw,
    tolerance: f64,
    radius: f64,
}

struct Side {
    mesh: TriMesh,
    /// Bounding sphere of each triangle.
    spheres: Vec<Sphere>,
    /// Neighbouring triangle across each edge.
    neighbours: Vec<[Option<u32>; 3]>,
    distance: SignedDistance,
}

/// Reference contacts at a pose.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Wrench for a stiffness of 1 N/m, about the probe's origin.
    pub wrench: Wrench,
    /// Largest depth of any sample, m, if one is within the tolerance.
    pub deepest: Option<f64>,
    /// Connected parts of either surface that are inside the other body.
    pub regions: Vec<Region>,
    /// Relative change of the force when the spacing was halved for the last time.
    pub change: f64,
    /// Number of samples within the tolerance.
    pub samples: usize,
}

/// Connected part of a surface that is inside the other body.
#[derive(Clone, Copy, Debug)]
pub struct Region {
    /// Largest depth in it, m.
    pub depth: f64,
    /// Place of the largest depth, in scene axes, m.
    pub place: DVec3,
    /// Lower corner of its bounding box, in scene axes, m.
    pub low: DVec3,
    /// Upper corner of its bounding box, in scene axes, m.
    pub high: DVec3,
}

impl Reference {
    /// Prepares a scenario's bodies.
    ///
    /// # Errors
    /// If parry refuses a mesh.
    pub fn new(scenario: &Scenario) -> Result<Self, Box<dyn Error>> {
        let side = |body: &crate::scenarios::Body| -> Result<Side, Box<dyn Error>> {
            let adjacency = body.mesh.adjacency();
            let count = body.mesh.triangles().len();
            Ok(Side {
                spheres: (0..count).map(|t| around(body.mesh.corners(t))).collect(),
                neighbours: (0..count as u32)
                    .map(|t| std::array::from_fn(|side| adjacency.neighbour(t, side as u32)))
                    .collect(),
                distance: SignedDistance::new(body)?,
                mesh: body.mesh.clone(),
            })
        };
        let sphere = scenario.probe.mesh.bounding_sphere();
        Ok(Self {
            sides: [side(&scenario.probe)?, side(&scenario.scene)?],
            law: AreaLaw::new(sphere.center, sphere.radius, LAW_REACH),
            tolerance: scenario.tolerance,
            radius: scenario.probe.object.bounding_radius(),
        })
    }

    /// Returns the reference at a pose of the probe; the scene object stands at the origin.
    pub fn at(&mut self, pose: &Pose) -> Truth {
        let near: [Vec<u32>; 2] = std::array::from_fn(|side| self.near(side, pose));
        let mut spacing = FIRST_SPACING * self.radius;
        let mut contacts = self.sampled(&near, pose, spacing);
        let mut wrench = self.law.wrench(&contacts, self.tolerance, pose, pose.translation);
        let mut change = if contacts.is_empty() { 0.0 } else { f64::INFINITY };
        while change > MAX_CHANGE && 4 * contacts.len() < MAX_SAMPLES {
            spacing /= 2.0;
            contacts = self.sampled(&near, pose, spacing);
            let finer = self.law.wrench(&contacts, self.tolerance, pose, pose.translation);
            change = wrench.force.distance(finer.force) / finer.force.length();
            wrench = finer;
        }
        Truth {
            wrench,
            deepest: contacts.iter().map(|found| found.contact.depth).reduce(f64::max),
            regions: self.regions(&near, pose, spacing),
            change,
            samples: contacts.len(),
        }
    }

    /// Returns the wrench of contacts from another method by the same law.
    pub fn wrench(&mut self, contacts: &[AreaContact], pose: &Pose) -> Wrench {
        self.law.wrench(contacts, self.tolerance, pose, pose.translation)
    }

    /// Returns triangles of one body that may be within the tolerance of the other.
    fn near(&self, side: usize, pose: &Pose) -> Vec<u32> {
        let [own, other] = [&self.sides[side], &self.sides[1 - side]];
        let spheres = own.spheres.par_iter().enumerate();
        let near = spheres.filter(|(_, sphere)| {
            let at = to_other(side, pose, sphere.center);
            other.distance.at(at) < sphere.radius + self.tolerance
        });
        near.map(|(triangle, _)| triangle as u32).collect()
    }

    /// Returns the samples within the tolerance.
    fn sampled(&self, near: &[Vec<u32>; 2], pose: &Pose, spacing: f64) -> Vec<AreaContact> {
        let mut contacts = Vec::new();
        for (side, near) in near.iter().enumerate() {
            contacts.par_extend(near.par_iter().flat_map_iter(|triangle| {
                let samples = samples(self.sides[side].mesh.corners(*triangle as usize), spacing);
                let normal = self.normal(side, *triangle);
                samples.into_iter().filter_map(move |(point, area)| {
                    let contact = self.contact(side, pose, point, normal);
                    (contact.depth > -self.tolerance).then_some(AreaContact { contact, area })
                })
            }));
        }
        contacts
    }

    fn normal(&self, side: usize, triangle: u32) -> DVec3 {
        let [a, b, c] = self.sides[side].mesh.corners(triangle as usize);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// Returns the contact of a point of one body, in that body's frame, with the other; `normal` is that of
    /// its face.
    fn contact(&self, side: usize, pose: &Pose, point: DVec3, normal: DVec3) -> Contact {
        let at = to_other(side, pose, point);
        let (nearest, distance) = self.sides[1 - side].distance.nearest(at);
        // From outside to the other body's surface, from inside the reverse: out of the body that the point
        // is on.
        let towards = (nearest - at) * distance.signum();
        let outwards = to_other_vector(side, pose, normal);
        let unit = if distance.abs() > 1e-9 * self.radius { towards.normalize() } else { outwards };
        let depth = -distance;
        let (on_own, on_other) = (at, at - depth * unit);
        if side == 0 {
            // The other body is the scene object, at the origin.
            Contact { point: on_own, scene_point: on_other, normal: unit, depth }
        } else {
            let world = |p| pose.transform_point(p);
            let normal = -pose.transform_vector(unit);
            Contact { point: world(on_other), scene_point: world(on_own), normal, depth }
        }
    }

    /// Returns connected parts of either surface with samples inside the other body.
    fn regions(&self, near: &[Vec<u32>; 2], pose: &Pose, spacing: f64) -> Vec<Region> {
        let mut regions = Vec::new();
        for (side, near) in near.iter().enumerate() {
            let own = &self.sides[side];
            // The deepest sample of each triangle that is inside the other body.
            let inside: Vec<(u32, Region)> = near
                .par_iter()
                .filter_map(|triangle| {
                    let corners = own.mesh.corners(*triangle as usize);
                    let normal = self.normal(side, *triangle);
                    let points = samples(corners, spacing).into_iter().map(|(point, _)| point);
                    let contacts = points.chain(corners).map(|point| self.contact(side, pose, point, normal));
                    let deepest = contacts.max_by(|p, q| p.depth.total_cmp(&q.depth))?;
                    if deepest.depth <= 0.0 {
                        return None;
                    }
                    let world = |p: DVec3| if side == 0 { pose.transform_point(p) } else { p };
                    let corners = corners.map(world);
                    let place = if side == 0 { deepest.point } else { deepest.scene_point };
                    let low = corners.into_iter().fold(DVec3::INFINITY, DVec3::min);
                    let high = corners.into_iter().fold(DVec3::NEG_INFINITY, DVec3::max);
                    Some((*triangle, Region { depth: deepest.depth, place, low, high }))
                })
                .collect();
            // Triangles that share an edge are merged by flood fill.
            let mut of_triangle: std::collections::HashMap<u32, Region> = inside.iter().copied().collect();
            for (first, _) in &inside {
                let Some(mut region) = of_triangle.remove(first) else { continue };
                let mut stack = vec![*first];
                while let Some(triangle) = stack.pop() {
                    for next in own.neighbours[triangle as usize].into_iter().flatten() {
                        let Some(further) = of_triangle.remove(&next) else { continue };
                        if further.depth > region.depth {
                            (region.depth, region.place) = (further.depth, further.place);
                        }
                        region.low = region.low.min(further.low);
                        region.high = region.high.max(further.high);
                        stack.push(next);
                    }
                }
                regions.push(region);
            }
        }
        regions
    }
}

/// The largest depth of any point of either surface along a path, by parry. A distance changes by no more
/// than the way between two points, so that a triangle need not be cut up when its centroid, and as much as
/// it reaches around that, is less deep than what was found.
pub struct Depths {
    sides: [Triangles; 2],
    distances: [SignedDistance; 2],
    /// Bounding sphere of the probe.
    around: Sphere,
    /// Largest distance that a point of the probe can have moved along the path, m.
    travelled: f64,
    last: Option<Pose>,
    /// Largest error of depths, m.
    error: f64,
}

struct Triangles {
    corners: Vec<[DVec3; 3]>,
    /// `travelled` until which each triangle is outside the other body; 0 if it was not when it was measured.
    outside_until: Vec<f64>,
}

/// Largest error of depths, relative to the probe's radius.
const DEPTH_ERROR: f64 = 3e-5;

impl Depths {
    /// Prepares a scenario's bodies.
    ///
    /// # Errors
    /// If parry refuses a mesh.
    pub fn new(scenario: &Scenario) -> Result<Self, Box<dyn Error>> {
        let Scenario { probe, scene, .. } = scenario;
        let triangles = |body: &crate::scenarios::Body| {
            let corners: Vec<_> = (0..body.mesh.triangles().len()).map(|t| body.mesh.corners(t)).collect();
            Triangles { outside_until: vec![0.0; corners.len()], corners }
        };
        let around = probe.mesh.bounding_sphere();
        Ok(Self {
            sides: [triangles(probe), triangles(scene)],
            distances: [SignedDistance::new(probe)?, SignedDistance::new(scene)?],
            error: DEPTH_ERROR * around.radius,
            around,
            travelled: 0.0,
            last: None,
        })
    }

    /// Returns the largest depth at the path's next pose, m; 0 if the bodies are apart.
    pub fn next(&mut self, pose: &Pose) -> f64 {
        let last = self.last.replace(*pose).unwrap_or(*pose);
        let turn = (last.rotation.inverse() * pose.rotation).to_scaled_axis().length();
        let center = self.around.center;
        self.travelled += pose.transform_point(center).distance(last.transform_point(center));
        self.travelled += self.around.radius * turn;
        let (travelled, error, mut deepest) = (self.travelled, self.error, 0.0);
        for (side, triangles) in self.sides.iter_mut().enumerate() {
            let other = &self.distances[1 - side];
            let depth = |point: DVec3| -other.at(to_other(side, pose, point));
            let each = triangles.corners.par_iter().zip(&mut triangles.outside_until);
            let near: Vec<(f64, &[DVec3; 3])> = each
                .filter(|(_, until)| **until <= travelled)
                .map(|(corners, until)| {
                    let Sphere { center, radius } = around(*corners);
                    let bound = depth(center) + radius;
                    *until = if bound < 0.0 { travelled - bound } else { 0.0 };
                    (bound, corners)
                })
                .filter(|(bound, _)| *bound > 0.0)
                .collect();
            let corners = near.par_iter().flat_map_iter(|(_, corners)| corners.iter());
            deepest = corners.map(|corner| depth(*corner)).reduce(|| deepest, f64::max);
            let least = deepest + error;
            let within = near.into_par_iter().filter(|(bound, _)| *bound > least);
            deepest = within
                .map(|(_, corners)| largest(*corners, least, error, &depth))
                .reduce(|| deepest, f64::max);
        }
        deepest
    }
}

/// Returns the largest depth in a triangle to within an error (m), if it is above a least one.
fn largest(corners: [DVec3; 3], least: f64, error: f64, depth: &impl Fn(DVec3) -> f64) -> f64 {
    let (mut found, mut stack) = (0.0_f64, vec![corners]);
    while let Some([a, b, c]) = stack.pop() {
        let Sphere { center, radius } = around([a, b, c]);
        let own = depth(center);
        found = found.max(own);
        if own + radius <= least.max(found + error) {
            continue;
        }
        let [ab, bc, ca] = [a.midpoint(b), b.midpoint(c), c.midpoint(a)];
        stack.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    found
}

/// Transforms a point of one body into the other's frame: side 0 is the probe, at a pose, and side 1 the
/// scene object, at the origin.
fn to_other(side: usize, pose: &Pose, point: DVec3) -> DVec3 {
    if side == 0 { pose.transform_point(point) } else { pose.inverse().transform_point(point) }
}

fn to_other_vector(side: usize, pose: &Pose, vector: DVec3) -> DVec3 {
    if side == 0 { pose.transform_vector(vector) } else { pose.inverse().transform_vector(vector) }
}

fn around(corners: [DVec3; 3]) -> Sphere {
    let center = (corners[0] + corners[1] + corners[2]) / 3.0;
    let radius = corners.iter().map(|corner| corner.distance(center)).fold(0.0, f64::max);
    Sphere { center, radius }
}

/// Returns the centroids and areas of equal parts of a triangle, none longer than the spacing.
fn samples([a, b, c]: [DVec3; 3], spacing: f64) -> Vec<(DVec3, f64)> {
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    let parts = (longest / spacing).ceil().clamp(1.0, 1000.0) as u32;
    let area = (b - a).cross(c - a).length() / 2.0 / f64::from(parts * parts);
    let (u, v) = ((b - a) / f64::from(parts), (c - a) / f64::from(parts));
    let mut found = Vec::with_capacity((parts * parts) as usize);
    for i in 0..parts {
        for j in 0..parts - i {
            let corner = a + f64::from(i) * u + f64::from(j) * v;
            found.push((corner + (u + v) / 3.0, area));
            if i + j + 1 < parts {
                found.push((corner + (u + v) * (2.0 / 3.0), area));
            }
        }
    }
    found
}
