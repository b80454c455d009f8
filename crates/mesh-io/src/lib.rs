//! Mesh files for palpate: OBJ, glTF, STL and PLY loading, welding, repair and self-intersection checks.

mod error;
mod gltf_scene;
mod intersect;
mod load;
mod obj;
mod ply;
mod polygon;
mod repair;
mod stl;
mod weld;
mod write;

pub use error::LoadError;
pub use intersect::{SelfIntersections, intersecting_pairs, self_intersections};
pub use load::{LoadOptions, LoadedMesh, load};
pub use repair::{RepairSummary, repair};
pub use weld::weld;
pub use write::write_obj;
