//! Signed distance fields of meshes, and representative contacts found in them: few contacts, each with the
//! surface area that it represents.

mod area_law;
mod body;
mod bricks;
mod cells;
mod deepest;
mod exact;
mod features;
mod format;
mod front;
mod query;
mod samples;
mod sampling;
mod selection;
mod selector;
mod side;
mod slack;
mod sparse;
mod steady;

/// Revision of the bodies, raised whenever the same mesh and options give another [`FieldBody`].
pub const REVISION: u32 = 4;

pub use area_law::{AreaContact, AreaLaw};
pub use body::{FieldBody, FieldOptions};
pub use bricks::DistanceField;
pub use exact::{ExactDistance, Nearest};
pub use features::{
    ClosestPoint, FeatureMesh, FeatureTree, Leash, MeshFeature, Node as FeatureNode, Place, lowest_share,
    where_nearest,
};
pub use format::FormatError;
pub use query::{FieldOutcome, FieldQuery, FieldSettings};
pub use samples::SurfaceSamples;
