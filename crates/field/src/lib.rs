//! Signed distance fields of meshes, and contacts found in them: few, each with the area that it stands for.

mod area_law;
mod body;
mod bricks;
mod cells;
mod deepest;
mod exact;
mod format;
mod front;
mod query;
mod samples;
mod sampling;
mod selection;
mod selector;
mod side;
mod slack;
mod steady;

/// Changes whenever the same mesh and options make another body.
pub const REVISION: u32 = 3;

pub use area_law::{AreaContact, AreaLaw};
pub use body::{FieldBody, FieldOptions};
pub use bricks::DistanceField;
pub use exact::{ExactDistance, Nearest};
pub use format::FormatError;
pub use query::{FieldOutcome, FieldQuery, FieldSettings};
pub use samples::SurfaceSamples;
