//! Distance fields of objects, made by `palpate-field`, and contact queries between two of them.

use std::sync::Arc;

use palpate_core::glam::DVec3;
use palpate_core::{Pose, TriMesh};
pub(crate) use palpate_field::REVISION as FIELD_REVISION;
use palpate_field::{
    AreaContact, FeatureMesh, FieldBody, FieldOptions, FieldOutcome, FieldQuery, FieldSettings,
};

use crate::scene::walls::thin_share;

/// Reach of the area law, and edge of the cells that contacts represent, in bounding radii of the probe. With
/// a larger reach fewer contacts represent larger areas.
pub(crate) const FIELD_REACH: f64 = 0.25;

/// Width of the band around a surface in which its field holds distances, in tolerances. Sessions look ahead
/// as far as this, and bodies may be as far from their proxies; with a narrower band, contacts there are
/// missed.
const BAND: f64 = 4.0;

/// Options of the fields of objects, for contacts within a tolerance (m).
pub(crate) fn field_options(tolerance: f64) -> FieldOptions {
    FieldOptions { band: BAND * tolerance, ..FieldOptions::new(tolerance) }
}

/// Representative contacts cannot be found with an object.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FieldError {
    /// The error allowed for contacts is out of range.
    #[error(
        "the error of representative contacts is {given} m; give metres from {finest:.3e} to {coarsest:.3e}, 0.02 % to 1 % of \
         the bounding radius of {name}"
    )]
    Error {
        /// Name of the probe.
        name: String,
        /// Error given, m.
        given: f64,
        /// Smallest error accepted, m.
        finest: f64,
        /// Largest error accepted, m.
        coarsest: f64,
    },
    /// The object's surface is too far from its frame's origin.
    #[error(
        "{name}: its surface, with a bounding radius of {radius:.3e} m, is {away:.3e} m from the origin of its \
         frame, too far for double precision; move it to the origin, and give its place as a pose"
    )]
    FarFromOrigin {
        /// Name of the object.
        name: String,
        /// Distance from the origin, m.
        away: f64,
        /// Bounding radius, m.
        radius: f64,
    },
    /// The object's surface is open.
    #[error(
        "{name}: its surface is not closed, so that representative contacts cannot distinguish inside from outside"
    )]
    Open {
        /// Name of the object.
        name: String,
    },
}

/// Largest distance of a surface from its frame's origin, in its bounding radii. Further away positions have
/// steps in double precision that contacts feel.
const MAX_AWAY: f64 = 1e9;

/// Surface of an object and its distance field.
#[derive(Clone, Debug)]
pub struct Field {
    body: FieldBody,
    thin: f64,
}

/// How well a distance field stands for an object's surface, which is known before it is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fitness {
    /// [`Field::thin_share`].
    pub thin: f64,
    /// [`Field::error`], m.
    pub error: f64,
}

impl Fitness {
    pub(crate) fn of(mesh: &TriMesh, options: &FieldOptions) -> Self {
        Self { thin: thin_share(mesh, options.tolerance), error: FieldBody::expected_error(mesh, options) }
    }
}

/// Checks that positions of a mesh's surface are accurate in double precision.
pub(crate) fn check_place(name: &str, mesh: &TriMesh) -> Result<(), FieldError> {
    let sphere = mesh.bounding_sphere();
    let away = sphere.center.length();
    if away <= MAX_AWAY * sphere.radius {
        return Ok(());
    }
    Err(FieldError::FarFromOrigin { name: name.to_owned(), away, radius: sphere.radius })
}

impl Field {
    pub(crate) fn new(mesh: &TriMesh, features: Arc<FeatureMesh>, options: &FieldOptions) -> Self {
        let body = FieldBody::sharing(mesh, features, options);
        Self { body, thin: thin_share(mesh, options.tolerance) }
    }

    /// How well it stands for the object's surface.
    pub(crate) fn fitness(&self) -> Fitness {
        Fitness { thin: self.thin, error: self.error() }
    }

    /// Error of depths that are read in the field, m ([`FieldBody::error`]).
    pub fn error(&self) -> f64 {
        self.body.error()
    }

    /// Fraction of the surface's area that bounds walls thinner than the tolerance d. Near such walls the
    /// field does not reliably show on which side a point is.
    pub fn thin_share(&self) -> f64 {
        self.thin
    }

    /// Memory in use, bytes.
    pub fn bytes(&self) -> usize {
        self.body.bytes()
    }

    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = self.body.to_bytes();
        bytes.extend_from_slice(&self.thin.to_le_bytes());
        bytes
    }

    /// Reads the output of [`to_bytes`](Self::to_bytes); `None` if the bytes are not valid.
    pub(crate) fn from_bytes(bytes: &[u8], features: Arc<FeatureMesh>) -> Option<Self> {
        let (body, thin) = bytes.split_last_chunk()?;
        let thin = f64::from_le_bytes(*thin);
        let body = FieldBody::from_bytes(body, features).ok()?;
        (0.0..=1.0).contains(&thin).then_some(Self { body, thin })
    }
}

/// Makes the workspace of queries between a probe and a scene object.
pub(crate) fn new_query(probe: &Field, scene: &Field) -> FieldQuery {
    FieldQuery::new(&probe.body, &scene.body, FIELD_REACH)
}

/// Finds the contacts of two fields at poses, and appends them to `into`.
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

/// Welds equal corners of triangles into a mesh. Triangles without area are left out: they have no normal,
/// and all their points are on their neighbours.
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
