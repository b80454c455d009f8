//! Representative contacts (`palpate-field`): few contacts at true geometry, each with the area that it stands for, found in the
//! distance fields of objects. All that the facade asks of that crate is asked here.

use std::sync::Arc;
use std::time::Duration;

use palpate_core::{Pose, Wrench};
pub use palpate_field::{AreaContact, FieldOptions};
use palpate_field::{AreaLaw, FieldOutcome, FieldQuery, FieldSettings};

use crate::scene::field::{FIELD_REACH, field_options, find, new_query};
pub use crate::scene::field::{Field, FieldError};
use crate::scene::object::Object;

/// EPS where none is asked for: what contacts may be off by, as a part of the probe's bounding radius.
pub const USUAL_ERROR: f64 = 0.0005;

/// The finest EPS, as a part of the probe's bounding radius: fields are not as true as that.
pub const FINEST_ERROR: f64 = 0.0002;

/// The coarsest EPS, as a part of the probe's bounding radius: fewer samples miss features.
pub const COARSEST_ERROR: f64 = 0.01;

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
    /// ([`SearchSettings::clusters`](crate::settings::SearchSettings::clusters)).
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

/// The law for contacts of a probe.
pub(crate) fn law(probe: &Object) -> AreaLaw {
    let source = &probe.clod.source;
    AreaLaw::new(source.center, source.bounding_radius, FIELD_REACH)
}
