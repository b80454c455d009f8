//! Representative contacts (`palpate-field`): few contacts at true geometry, each with the area of the
//! surface that it represents, found in the distance fields of objects. The facade uses that crate only here
//! and in `scene::field`.

use std::sync::Arc;
use std::time::Duration;

use palpate_core::{Pose, Wrench};
pub use palpate_field::{AreaContact, FieldOptions};
use palpate_field::{AreaLaw, FieldOutcome, FieldQuery, FieldSettings};

use crate::scene::field::{FIELD_REACH, field_options, find, new_query};
pub use crate::scene::field::{Field, FieldError};
use crate::scene::object::Object;

/// Default error of contacts (EPS), as a fraction of the probe's bounding radius.
pub const DEFAULT_ERROR: f64 = 0.0005;

/// Smallest EPS, as a fraction of the probe's bounding radius: fields are not more accurate than that.
pub const FINEST_ERROR: f64 = 0.0002;

/// Largest EPS, as a fraction of the probe's bounding radius: fewer samples miss features.
pub const COARSEST_ERROR: f64 = 0.01;

/// Approximate lattice constant of an object's field, m.
pub(crate) fn lattice(object: &Object, options: &FieldOptions) -> f64 {
    let area: f64 = object.triangles().map(|[a, b, c]| (b - a).cross(c - a).length() / 2.0).sum();
    options.lattice(area)
}

/// Checks that contacts can be found to within an error (EPS, m) on a probe.
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

/// Outcome and cost of a [`RepresentativeQuery`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RepresentativeOutcome {
    /// Number of contacts found.
    pub contacts: usize,
    /// EPS reached, m: the error of the depths that contacts push by ([`FieldOutcome::error`]).
    pub error: f64,
    /// `false` where the finest samples were left to the next queries: bodies are fast, or the time is
    /// limited.
    pub is_complete: bool,
    /// Whether the objects penetrate deeper than their fields reach, so that contacts push by less than
    /// their depth.
    pub is_too_deep: bool,
    /// Number of distances looked up at places of either surface, counting four places as one.
    pub asked: usize,
    /// Largest penetration depth, m; negative where the surfaces are apart. `None` without contacts.
    pub deepest: Option<f64>,
}

impl RepresentativeQuery {
    /// Creates a query for contacts within a tolerance (d, m), to within about an error (EPS, m). Builds the
    /// objects' fields where they are missing.
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

    /// Limits the time of each run. Contacts that there is no time for are left out, the finest first.
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

    /// Forgets the objects' poses: the next run starts from scratch.
    pub fn reset(&mut self) {
        self.query.reset();
    }

    /// The contacts of the last run, in world axes. Some have no area: the deepest places, which do not push.
    pub fn contacts(&self) -> &[AreaContact] {
        &self.found
    }

    /// The wrench (N, N·m about the probe frame's origin, world axes) of the last run's contacts on the probe
    /// at a stiffness (N/m), by [`AreaLaw`]. The probe has to be at the pose of that run. Sessions use the
    /// stiffness K k ([`SearchSettings::clusters`](crate::settings::SearchSettings::clusters)).
    pub fn wrench(&mut self, probe_pose: &Pose, stiffness: f64) -> Wrench {
        let Self { law, found, settings, .. } = self;
        let unit = law.wrench(found, settings.tolerance, probe_pose, probe_pose.translation);
        Wrench { force: unit.force * stiffness, torque: unit.torque * stiffness }
    }

    /// Memory held, including the fields, bytes.
    pub fn bytes(&self) -> usize {
        self.probe.bytes() + self.scene.bytes() + self.query.bytes()
    }
}

/// The force law for contacts of a probe.
pub(crate) fn law(probe: &Object) -> AreaLaw {
    let source = &probe.clod.source;
    AreaLaw::new(source.center, source.bounding_radius, FIELD_REACH)
}
