//! Signed distance fields of meshes, and contacts found in them: few, each with the area that it stands for.

mod area_law;
mod bricks;
mod cells;
mod exact;
mod query;
mod samples;
mod slack;

pub use area_law::{AreaContact, AreaLaw};
pub use bricks::DistanceField;
pub use exact::{ExactDistance, Nearest};
pub use query::{FieldBody, FieldOutcome, FieldQuery, FieldSettings};
pub use samples::SurfaceSamples;
