//! The choice between the two contact searches of a session: by levels of detail, or as representatives in
//! distance fields.

pub(crate) mod by_fields;
pub mod representative;

use std::fmt;

use self::by_fields::{ByFields, FieldNeeds};
use self::representative::FieldError;
use crate::scene::field::Fitness;
use crate::scene::object::Object;
use crate::settings::{ContactSearch, Response, Settings};

/// Number of scene objects with a full workspace from the start. Those of further objects are allocated, or
/// grow, when they are first within reach.
pub(crate) const RESERVED: usize = 16;

/// Largest fraction of an object's surface area that may bound thin walls; ends of edges sharper than 45° do.
/// With more, fields confuse the two sides of walls.
const MAX_THIN_SHARE: f64 = 0.01;

/// Largest error of a field, in tolerances. With more, forces at light touch are wrong.
const MAX_FIELD_ERROR: f64 = 0.25;

/// Largest lattice constant of a field, in tolerances. With more, the field would not be accurate enough to
/// be worth building.
const MAX_LATTICE: f64 = 1.5;

/// Reason why contacts are found by levels of detail.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ByLevels {
    AskedFor,
    /// s₀ is above 0.
    Detail,
    Texture,
    /// No field is read for constraints.
    Constraints,
    NoField(FieldError),
    /// An object has more than [`MAX_THIN_SHARE`] of its surface on thin walls.
    Thin {
        name: String,
        share: f64,
    },
    /// The error of a field, in tolerances, would be above [`MAX_FIELD_ERROR`].
    Rough {
        name: String,
        error: f64,
    },
    /// The lattice constant of a field, in tolerances, would be above [`MAX_LATTICE`].
    Coarse {
        name: String,
        lattice: f64,
    },
}

impl fmt::Display for ByLevels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AskedFor => write!(f, "by the setting"),
            Self::Detail => write!(f, "detail is to be left out"),
            Self::Texture => write!(f, "an object has a haptic texture"),
            Self::Constraints => write!(f, "constraints need no distance field"),
            Self::NoField(error) => write!(f, "{error}"),
            Self::Thin { name, share } => {
                write!(
                    f,
                    "{name}: {:.0} % of its surface bounds walls thinner than the tolerance",
                    100.0 * share
                )
            }
            Self::Coarse { name, lattice } => {
                write!(
                    f,
                    "{name}: its distance field would have a lattice constant of {lattice:.1} tolerances"
                )
            }
            Self::Rough { name, error } => {
                write!(
                    f,
                    "{name}: its distance field would be off by up to {:.0} % of the tolerance",
                    100.0 * error
                )
            }
        }
    }
}

/// Chooses the contact search for a probe and the scene objects at their places: the search in fields, with
/// workspaces for the first [`RESERVED`] objects, or the reason for levels.
///
/// # Errors
/// If the contact error in the settings is out of range.
pub(crate) fn choose(
    probe: &Object,
    objects: &[Option<&Object>],
    tolerance: f64,
    settings: &Settings,
) -> Result<Result<Box<ByFields>, ByLevels>, FieldError> {
    let all = || std::iter::once(probe).chain(objects.iter().flatten().copied());
    let why = match settings.search.method {
        ContactSearch::Levels => Some(ByLevels::AskedFor),
        _ if all().any(|object| object.texture().is_some()) => Some(ByLevels::Texture),
        // Constraints are found at full resolution in any case.
        ContactSearch::Automatic
            if settings.detail.error > 0.0 && settings.contact.response == Response::Penalty =>
        {
            Some(ByLevels::Detail)
        }
        _ => None,
    };
    if let Some(why) = why {
        return Ok(Err(why));
    }
    let needs = FieldNeeds::new(tolerance, settings, probe)?;
    let is_automatic = settings.search.method == ContactSearch::Automatic;
    // Fields take seconds to make. The few penalty contacts beside constraints are with light objects.
    let has_constraints = settings.contact.response == Response::Constraints && probe.features().is_some();
    if is_automatic && has_constraints {
        return Ok(Err(ByLevels::Constraints));
    }
    if is_automatic && let Some(why) = all().find_map(|object| unfit(&needs, object)) {
        return Ok(Err(why));
    }
    let mut fields = match ByFields::new(needs, probe, settings.search.clusters) {
        Err(open) => return Ok(Err(ByLevels::NoField(open))),
        Ok(fields) => fields,
    };
    let is_reserved = settings.contact.response == Response::Penalty;
    for (place, object) in objects.iter().enumerate() {
        if let Some(object) = object
            && let Err(open) = fields.insert(place, object, is_reserved && place < RESERVED)
        {
            return Ok(Err(ByLevels::NoField(open)));
        }
    }
    Ok(Ok(Box::new(fields)))
}

/// Returns why contacts with an object are not found in its field, if the search is chosen automatically.
pub(crate) fn unfit(needs: &FieldNeeds, object: &Object) -> Option<ByLevels> {
    if object.texture().is_some() {
        return Some(ByLevels::Texture);
    }
    let lattice = needs.lattice(object) / needs.tolerance();
    if lattice > MAX_LATTICE {
        return Some(ByLevels::Coarse { name: object.name.clone(), lattice });
    }
    // A field that would be refused is not made.
    let Fitness { thin: share, error } = match object.fitness(&needs.options()) {
        Ok(fitness) => fitness,
        Err(error) => return Some(ByLevels::NoField(error)),
    };
    let name = object.name.clone();
    let error = error / needs.tolerance();
    if share > MAX_THIN_SHARE {
        Some(ByLevels::Thin { name, share })
    } else if error > MAX_FIELD_ERROR {
        Some(ByLevels::Rough { name, error })
    } else {
        None
    }
}
