//! Sessions as programs run them, held against where the surfaces are by geometry or by an exact query.

mod bodies;
mod constraints;
mod encoder_steps;
mod fits;
mod inner_edges;
mod many_objects;
mod plain_scenes;
mod scaled_world;
mod summary;
mod uneven_steps;
