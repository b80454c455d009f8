//! Rapier colliders of palpate objects.
//!
//! The hand feels palpate's mesh; bodies feel one another's colliders. The two may differ, and coarser
//! colliders are faster: a level of the object's hierarchy is selected.

use std::collections::HashMap;

use palpate::Object;
use palpate::core::Clod;
use palpate::core::clod::Node;
use palpate::glam::DVec3;
use rapier3d::dynamics::MassProperties;
use rapier3d::geometry::{ColliderBuilder, SharedShape, TriMeshBuilderError};
use rapier3d::math;

use crate::convert::to_vector;

/// Relative difference of a box's volume from that of its bounding box that counts as rounding.
const ROUNDING: f64 = 1e-9;

/// Thickness of the hull of a flat patch, in bounding radii.
const THICKNESS: f64 = 1e-3;

/// Reason why an object has no collider.
#[derive(Debug, thiserror::Error)]
pub enum ColliderError {
    /// The mesh is not closed.
    #[error(
        "{name} is not closed, so it is not a solid; give it a fixed body and surface_collider, or repair the mesh"
    )]
    NotSolid {
        /// Name of the object.
        name: String,
    },
    /// The mass is invalid.
    #[error("{name}: a mass of {mass} kg; give one above 0")]
    Mass {
        /// Name of the object.
        name: String,
        /// Given mass, kg.
        mass: f64,
    },
    /// The hierarchy has no such level.
    #[error("{name} has levels 0 to {last}, but no level {level}")]
    Level {
        /// Name of the object.
        name: String,
        /// Requested level.
        level: usize,
        /// Coarsest level.
        last: usize,
    },
    /// No convex part has a volume that f32 can represent.
    #[error(
        "{name}: no part of level {level} has a volume in f32; choose a finer level, or another unit of length"
    )]
    NoParts {
        /// Name of the object.
        name: String,
        /// Requested level.
        level: usize,
    },
    /// Rapier refused the triangles.
    #[error("{name}: {source}")]
    Triangles {
        /// Name of the object.
        name: String,
        /// Error of rapier.
        source: TriMeshBuilderError,
    },
}

/// Returns a collider for a body of any type, in the frame of the object's mesh, with a mass (kg) that is
/// distributed evenly in the mesh.
///
/// It consists of the convex hulls of a level of the object's hierarchy, from 0, the finest, where they
/// follow the surface and may be many (`object.clod.level(n).len()`), to the last, the coarsest, where there
/// are few or one. A box along the mesh's axes is exactly one.
///
/// The hulls of fine levels are those of pieces of the surface, and leave the inside of a non-convex body
/// empty. A flat piece is a thousandth of the object's radius thick, and a body pressed on many such pieces
/// sinks in by about that, or more. Coarser levels support heavy bodies better.
///
/// # Errors
/// If the mesh is not closed, the mass is not above 0 and finite, there is no such level, or none of its
/// hulls has a volume.
pub fn solid_collider(object: &Object, level: usize, mass: f64) -> Result<ColliderBuilder, ColliderError> {
    let clod = &*object.clod;
    let name = || object.name.clone();
    if !(mass > 0.0 && (mass as f32) > 0.0 && (mass as f32).is_finite()) {
        return Err(ColliderError::Mass { name: name(), mass });
    }
    if !clod.source.solid {
        return Err(ColliderError::NotSolid { name: name() });
    }
    if level >= clod.levels.len() {
        return Err(ColliderError::Level { name: name(), level, last: clod.levels.len() - 1 });
    }
    let parts: Vec<(math::Pose, SharedShape)> = match exact_box(clod) {
        Some((middle, half)) => {
            let half = to_vector(half);
            vec![(
                math::Pose::from_translation(to_vector(middle)),
                SharedShape::cuboid(half.x, half.y, half.z),
            )]
        }
        None => {
            let hulls = clod.level(level).iter().filter_map(|node| hull(clod, &node));
            hulls.map(|hull| (math::Pose::IDENTITY, hull)).collect()
        }
    };
    if parts.is_empty() {
        return Err(ColliderError::NoParts { name: name(), level });
    }
    let source = &clod.source;
    let inertia = (source.unit_inertia * mass).to_cols_array().map(|x| x as f32);
    let properties = MassProperties::with_inertia_matrix(
        to_vector(source.center_of_mass),
        mass as f32,
        math::Matrix::from_cols_array(&inertia),
    );
    Ok(ColliderBuilder::compound(parts).mass_properties(properties))
}

/// Returns a collider for a fixed or kinematic body, in the frame of the object's mesh: its triangles at full
/// resolution. It has no inside, and no mass.
///
/// # Errors
/// If there is no triangle.
pub fn surface_collider(object: &Object) -> Result<ColliderBuilder, ColliderError> {
    let mut vertices = Vec::new();
    let mut numbers = HashMap::new();
    let mut triangles = Vec::new();
    for leaf in object.clod.leaves() {
        let hull = object.clod.hull(&leaf);
        for triangle in object.clod.patch(&leaf) {
            triangles.push(triangle.map(|corner| {
                let vertex = to_vector(hull[corner as usize]);
                *numbers.entry(vertex.to_array().map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
                    vertices.push(vertex);
                    vertices.len() as u32 - 1
                })
            }));
        }
    }
    // Triangles that rounding has collapsed are left out.
    triangles.retain(|[a, b, c]| a != b && b != c && c != a);
    let builder = ColliderBuilder::trimesh(vertices, triangles)
        .map_err(|source| ColliderError::Triangles { name: object.name.clone(), source })?;
    Ok(builder.density(0.0))
}

/// Returns the middle and half the size of an object that is a box along the mesh's axes, m.
fn exact_box(clod: &Clod) -> Option<(DVec3, DVec3)> {
    let corners = clod.leaves().iter().flat_map(|leaf| clod.hull(leaf));
    let (low, high) = corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), corner| {
        (low.min(*corner), high.max(*corner))
    });
    let size = high - low;
    let volume = size.element_product();
    // A solid with the volume of its bounding box fills it.
    ((clod.source.volume - volume).abs() <= ROUNDING * volume).then(|| ((low + high) * 0.5, size * 0.5))
}

/// Returns the convex hull of a node; for a flat patch, with some thickness behind it.
fn hull(clod: &Clod, node: &Node) -> Option<SharedShape> {
    // Includes the points of finer levels' hulls outside its own.
    let points = clod.bounding_hull(node);
    let depth = THICKNESS * clod.source.bounding_radius;
    let corners = clod.hull(node);
    let area: DVec3 = clod
        .patch(node)
        .iter()
        .map(|triangle| triangle.map(|corner| corners[corner as usize]))
        .map(|[a, b, c]| (b - a).cross(c - a))
        .sum();
    let normal = area.normalize_or_zero();
    let along = |point: &DVec3| normal.dot(*point);
    let low = points.iter().map(along).fold(f64::INFINITY, f64::min);
    let high = points.iter().map(along).fold(f64::NEG_INFINITY, f64::max);
    let flat = normal != DVec3::ZERO && high - low < depth;
    let behind = points.iter().filter(|_| flat).map(|point| *point - normal * depth);
    let points: Vec<math::Vector> = points.iter().copied().chain(behind).map(to_vector).collect();
    SharedShape::convex_hull(&points)
}
