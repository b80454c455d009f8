//! Which way a session finds its contacts: by levels of detail or as representatives.

use std::fmt;

use super::by_fields::{ByFields, FieldNeeds};
use crate::contact::representative::FieldError;
use crate::scene::object::Object;
use crate::settings::{ContactSearch, Settings};

/// A part of an object's surface, by its area, that may bound thin walls: ends of edges sharper than 45° do.
const THIN: f64 = 0.01;

/// The largest error of a field, in tolerances, that forces are still true with.
const ROUGH: f64 = 0.25;

/// The largest lattice constant of a field, in tolerances, that is worth making it.
const COARSE: f64 = 1.5;

/// Why contacts are found by levels of detail.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ByLevels {
    AskedFor,
    /// s₀ is above 0.
    Detail,
    Budget,
    Texture,
    NoField(FieldError),
    Thin {
        name: String,
        share: f64,
    },
    Rough {
        name: String,
        error: f64,
    },
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
            Self::Budget => write!(f, "queries have a time limit"),
            Self::Texture => write!(f, "an object has a haptic texture"),
            Self::NoField(error) => write!(f, "{error}"),
            Self::Thin { name, share } => {
                write!(
                    f,
                    "{name}: {:.0} % of its surface bound walls thinner than the tolerance",
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
                    "{name}: its distance field is off by up to {:.0} % of the tolerance",
                    100.0 * error
                )
            }
        }
    }
}

/// What finds contacts in fields, or why levels do: for a probe and scene objects, each with its place and whether it is to have a
/// workspace from the start.
///
/// # Errors
/// If the error of contacts that is asked for is out of range.
pub(super) fn choose<'a>(
    probe: &Object,
    objects: impl Iterator<Item = (usize, &'a Object, bool)> + Clone,
    tolerance: f64,
    settings: &Settings,
) -> Result<Result<Box<ByFields>, ByLevels>, FieldError> {
    let all = || std::iter::once(probe).chain(objects.clone().map(|(_, object, _)| object));
    let why = match settings.search.method {
        ContactSearch::Levels => Some(ByLevels::AskedFor),
        _ if all().any(|object| object.texture().is_some()) => Some(ByLevels::Texture),
        ContactSearch::Automatic if settings.detail.error > 0.0 => Some(ByLevels::Detail),
        ContactSearch::Automatic if settings.detail.query_budget.is_some() => Some(ByLevels::Budget),
        _ => None,
    };
    if let Some(why) = why {
        return Ok(Err(why));
    }
    let needs = FieldNeeds::new(tolerance, settings, probe)?;
    if settings.search.method == ContactSearch::Automatic
        && let Some(why) = all().find_map(|object| unfit(&needs, object))
    {
        return Ok(Err(why));
    }
    let mut fields = match ByFields::new(needs, probe, settings.search.clusters) {
        // As good as is possible with it.
        Err(open) => return Ok(Err(ByLevels::NoField(open))),
        Ok(fields) => fields,
    };
    for (place, object, reserved) in objects {
        if let Err(open) = fields.insert(place, object, reserved) {
            return Ok(Err(ByLevels::NoField(open)));
        }
    }
    Ok(Ok(Box::new(fields)))
}

/// Why contacts with an object are not found in its field, where nothing else is asked for.
pub(super) fn unfit(needs: &FieldNeeds, object: &Object) -> Option<ByLevels> {
    if object.texture().is_some() {
        return Some(ByLevels::Texture);
    }
    let lattice = needs.lattice(object) / needs.tolerance();
    if lattice > COARSE {
        return Some(ByLevels::Coarse { name: object.name.clone(), lattice });
    }
    let field = match needs.of(object) {
        Ok(field) => field,
        Err(error) => return Some(ByLevels::NoField(error)),
    };
    let name = object.name.clone();
    let (share, error) = (field.thin_share(), field.error() / needs.tolerance());
    if share > THIN {
        Some(ByLevels::Thin { name, share })
    } else if error > ROUGH {
        Some(ByLevels::Rough { name, error })
    } else {
        None
    }
}
