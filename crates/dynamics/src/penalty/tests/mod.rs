//! Tests of the contact model.

mod budget;
mod curvature;
mod friction;
mod model;
