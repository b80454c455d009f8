//! Distance fields of objects, made by `palpate-field`, and what is asked of two of them.

use palpate_core::glam::DVec3;
use palpate_core::{Pose, TriMesh};
pub(crate) use palpate_field::REVISION as FIELD_REVISION;
use palpate_field::{AreaContact, FieldBody, FieldOptions, FieldOutcome, FieldQuery, FieldSettings};

use crate::scene::walls::thin_share;

/// Reach of the law, and edge of the cells that contacts stand for, as parts of the probe's bounding radius.
pub(crate) const FIELD_REACH: f64 = 0.25;

/// How far fields know distances, in tolerances: as far as sessions look ahead, and for a body behind its proxy.
const BAND: f64 = 4.0;

/// What the fields of objects are made with, for contacts within a tolerance (m).
pub(crate) fn field_options(tolerance: f64) -> FieldOptions {
    FieldOptions { band: BAND * tolerance, ..FieldOptions::new(tolerance) }
}

/// Why an object has no field.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FieldError {
    /// The error of contacts is out of range.
    #[error(
        "the error of representative contacts is {given} m; give metres from {finest:.3e} to {coarsest:.3e}, 0.02 % to 1 % of \
         the bounding radius of {name}"
    )]
    Error {
        /// The probe's name.
        name: String,
        /// What was asked for, m.
        given: f64,
        /// The least that can be, m.
        finest: f64,
        /// The most, m.
        coarsest: f64,
    },
    /// Its surface is open.
    #[error(
        "{name}: its surface is not closed, so that representative contacts cannot tell inside from outside"
    )]
    Open {
        /// The object's name.
        name: String,
    },
}

/// An object's surface and its distance field.
#[derive(Clone, Debug)]
pub struct Field {
    body: FieldBody,
    thin: f64,
}

impl Field {
    pub(crate) fn new(mesh: &TriMesh, options: &FieldOptions) -> Self {
        Self { body: FieldBody::new(mesh, options), thin: thin_share(mesh, options.tolerance) }
    }

    /// By how much depths are off that are read in the field, m ([`FieldBody::error`]).
    pub fn error(&self) -> f64 {
        self.body.error()
    }

    /// The part of the surface, by its area, that bounds walls thinner than the tolerance d. Of such the field does not tell well on
    /// which side a place is.
    pub fn thin_share(&self) -> f64 {
        self.thin
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.body.bytes()
    }

    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = self.body.to_bytes();
        bytes.extend_from_slice(&self.thin.to_le_bytes());
        bytes
    }

    /// What [`to_bytes`](Self::to_bytes) gave; `None` of anything else.
    pub(crate) fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (body, thin) = bytes.split_last_chunk()?;
        let thin = f64::from_le_bytes(*thin);
        let body = FieldBody::from_bytes(body).ok()?;
        (0.0..=1.0).contains(&thin).then_some(Self { body, thin })
    }
}

/// A workspace for queries of a probe with a scene object.
pub(crate) fn new_query(probe: &Field, scene: &Field) -> FieldQuery {
    FieldQuery::new(&probe.body, &scene.body, FIELD_REACH)
}

/// Adds the contacts of two fields at poses.
pub(crate) fn find(
    query: &mut FieldQuery,
    (probe, probe_pose): (&Field, &Pose),
    (scene, scene_pose): (&Field, &Pose),
    settings: &FieldSettings,
    into: &mut Vec<AreaContact>,
) -> FieldOutcome {
    query.run(&probe.body, &scene.body, probe_pose, scene_pose, settings);
    query.append_contacts(&probe.body, probe_pose, into);
    query.outcome()
}

/// A mesh of the triangles of a surface whose corners are told one by one, equal ones welded. Triangles without area are left out:
/// they have no normal, and no other point than their neighbours.
pub(crate) fn welded(triangles: impl Iterator<Item = [DVec3; 3]>) -> Option<TriMesh> {
    let (mut vertices, mut places) = (Vec::new(), std::collections::HashMap::new());
    let mut place = |corner: DVec3| {
        // −0 is 0.
        *places.entry((corner + 0.0).to_array().map(f64::to_bits)).or_insert_with(|| {
            vertices.push(corner);
            vertices.len() as u32 - 1
        })
    };
    let triangles: Vec<[u32; 3]> = triangles
        .filter(|[a, b, c]| (b - a).cross(c - a).length_squared() > 0.0)
        .map(|triangle| triangle.map(&mut place))
        .collect();
    TriMesh::new(vertices, triangles).ok().filter(|mesh| !mesh.triangles().is_empty())
}
