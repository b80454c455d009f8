//! Mesh files for palpate: OBJ, glTF, STL and PLY loading, exact welding, repair, and exact intersection
//! checks.
//!
//! ```no_run
//! use palpate_mesh_io::{LoadOptions, load, self_intersections};
//!
//! // A model in millimetres.
//! let options = LoadOptions { scale: 0.001, ..LoadOptions::default() };
//! let loaded = load("bracket.stl".as_ref(), &options)?;
//! loaded.warnings.iter().for_each(|warning| eprintln!("{warning}"));
//! assert_eq!(self_intersections(&loaded.mesh).count, 0);
//! # Ok::<(), palpate_mesh_io::LoadError>(())
//! ```
//!
//! Files are not trusted: whatever the bytes, [`load`] and [`load_uv`] return a mesh or an error of one line
//! that says what is wrong, where, and what to do. They do not panic or recurse, and their memory is bounded
//! by the size of the files (and for glTF, whose nodes can repeat a mesh, by a limit of its own). The parsers
//! of other crates (JSON and GLB of `gltf`, binary STL of `stl_io`, OBJ of `tobj`) get only data whose
//! lengths are checked. Indices, counts and offsets are resolved here, except for the indices of OBJ files,
//! which `tobj` checks; those on which it overflows are refused before.

mod error;
mod formats;
mod intersect;
mod load;
mod openings;
mod polygon;
mod repair;
mod textured;
mod warning;
mod weld;
mod write;

pub use error::LoadError;
pub use intersect::{SelfIntersections, intersecting_pairs, self_intersections};
pub use load::{LoadOptions, LoadedMesh, load};
pub use openings::{Openings, openings};
pub use repair::{RepairEffect, RepairSummary, repair};
pub use textured::{HeightTexture, LoadedUvMesh, TextureWrap, load_uv, names_height_texture};
pub use warning::LoadWarning;
pub use weld::weld;
pub use write::write_obj;
