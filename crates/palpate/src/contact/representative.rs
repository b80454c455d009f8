//! Representative contacts (`palpate-field`): few contacts at true geometry, each with the area that it stands for, found in the
//! distance fields of objects. All that the facade asks of that crate is asked here.

use std::sync::Arc;
use std::time::Duration;

use palpate_core::glam::DVec3;
use palpate_core::{Pose, TriMesh, Wrench};
pub use palpate_field::AreaContact;
use palpate_field::FieldBody;
pub use palpate_field::FieldOptions;
use palpate_field::FieldOutcome;
pub(crate) use palpate_field::REVISION as FIELD_REVISION;
pub(crate) use palpate_field::{AreaLaw, FieldQuery, FieldSettings};

use crate::scene::object::Object;
use crate::scene::walls::thin_share;

/// EPS where none is asked for: what contacts may be off by, as a part of the probe's bounding radius.
pub const USUAL_ERROR: f64 = 0.0005;

/// The finest EPS, as a part of the probe's bounding radius: fields are not as true as that.
pub const FINEST_ERROR: f64 = 0.0002;

/// The coarsest EPS, as a part of the probe's bounding radius: fewer samples miss features.
pub const COARSEST_ERROR: f64 = 0.01;

/// Reach of the law, and edge of the cells that contacts stand for, as parts of the probe's bounding radius.
const REACH: f64 = 0.25;

/// How far fields know distances, in tolerances: as far as sessions look ahead, and for a body behind its proxy.
const BAND: f64 = 4.0;

/// What the fields of objects are made with, for contacts within a tolerance (m).
pub(crate) fn field_options(tolerance: f64) -> FieldOptions {
    FieldOptions { band: BAND * tolerance, ..FieldOptions::new(tolerance) }
}

/// The lattice constant that the field of an object has, about, m.
pub(crate) fn lattice(object: &Object, options: &FieldOptions) -> f64 {
    let area: f64 = object.triangles().map(|[a, b, c]| (b - a).cross(c - a).length() / 2.0).sum();
    options.lattice(area)
}

/// Whether contacts can be told to an error (EPS, m) on a probe.
///
/// # Errors
/// If the error is below [`FINEST_ERROR`] or above [`COARSEST_ERROR`] of the probe's bounding radius.
pub(crate) fn check_error(error: f64, probe: &Object) -> Result<(), FieldError> {
    let radius = probe.bounding_radius();
    if (FINEST_ERROR * radius..=COARSEST_ERROR * radius).contains(&error) {
        return Ok(());
    }
    let [finest, coarsest] = [FINEST_ERROR, COARSEST_ERROR].map(|part| part * radius);
    Err(FieldError::Error { name: probe.name.clone(), given: error, finest, coarsest })
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

/// Finds the representative contacts between two objects.
#[derive(Clone, Debug)]
pub struct RepresentativeQuery {
    probe: Arc<Field>,
    scene: Arc<Field>,
    query: FieldQuery,
    law: AreaLaw,
    settings: FieldSettings,
    found: Vec<AreaContact>,
}

/// What a [`RepresentativeQuery`] found, and what it cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RepresentativeOutcome {
    /// Contacts found.
    pub contacts: usize,
    /// EPS reached, m: how far off the depths are that contacts push by ([`FieldOutcome::error`]).
    pub error: f64,
    /// Whether there was time for all that was asked for.
    pub is_complete: bool,
    /// Whether the objects are deeper in one another than their fields know, so that contacts push by less than their depth.
    pub is_too_deep: bool,
    /// Places of either surface that were asked for their distance from the other, four at a time.
    pub asked: usize,
    /// The deepest penetration, m; none where there is no contact. Negative where the surfaces are apart.
    pub deepest: Option<f64>,
}

impl RepresentativeQuery {
    /// Of contacts within a tolerance (d, m), off by no more than an error (EPS, m), about. Makes the objects' fields, where they
    /// have none yet.
    ///
    /// # Errors
    /// If the error is out of range, or an object's surface is not closed.
    pub fn new(probe: &Object, scene: &Object, tolerance: f64, error: f64) -> Result<Self, FieldError> {
        check_error(error, probe)?;
        let options = field_options(tolerance);
        let (own, other) = (probe.field(options)?, scene.field(options)?);
        let query = new_query(&own, &other);
        let settings = FieldSettings { error, ..FieldSettings::new(tolerance) };
        Ok(Self { probe: own, scene: other, query, law: law(probe), settings, found: Vec::new() })
    }

    /// The same with a limit to the time that a run takes: what there is no time for is left out, the finest first.
    #[must_use]
    pub fn with_budget(mut self, budget: Option<Duration>) -> Self {
        self.settings.budget = budget;
        self
    }

    /// Finds the contacts with both objects at their poses (object frame to world).
    pub fn run(&mut self, probe_pose: &Pose, scene_pose: &Pose) -> RepresentativeOutcome {
        self.found.clear();
        let Self { probe, scene, query, settings, found, .. } = self;
        let outcome = find(query, (probe, probe_pose), (scene, scene_pose), settings, found);
        let FieldOutcome { error, is_complete, is_too_deep, .. } = outcome;
        RepresentativeOutcome {
            contacts: found.len(),
            error,
            is_complete,
            is_too_deep,
            asked: outcome.spheres + outcome.samples,
            deepest: found.iter().map(|found| found.contact.depth).reduce(f64::max),
        }
    }

    /// Forgets where the objects were: the next run begins anew.
    pub fn reset(&mut self) {
        self.query.reset();
    }

    /// The contacts of the last run, in world axes. Some stand for no area: the deepest places, which push nothing.
    pub fn contacts(&self) -> &[AreaContact] {
        &self.found
    }

    /// The wrench (N, N·m about the probe frame's origin, world axes) that the contacts of the last run, which was at this pose of
    /// the probe, push it with at a stiffness (N/m), by [`AreaLaw`]. That of sessions is K k
    /// ([`Settings::clusters`](crate::Settings::clusters)).
    pub fn wrench(&mut self, probe_pose: &Pose, stiffness: f64) -> Wrench {
        let Self { law, found, settings, .. } = self;
        let unit = law.wrench(found, settings.tolerance, probe_pose, probe_pose.translation);
        Wrench { force: unit.force * stiffness, torque: unit.torque * stiffness }
    }

    /// Bytes of memory held, the fields included.
    pub fn bytes(&self) -> usize {
        self.probe.bytes() + self.scene.bytes() + self.query.bytes()
    }
}

/// A workspace for queries of a probe with a scene object.
pub(crate) fn new_query(probe: &Field, scene: &Field) -> FieldQuery {
    FieldQuery::new(&probe.body, &scene.body, REACH)
}

/// The law for contacts of a probe.
pub(crate) fn law(probe: &Object) -> AreaLaw {
    let source = &probe.clod.source;
    AreaLaw::new(source.center, source.bounding_radius, REACH)
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
