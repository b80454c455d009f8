//! Tests of the contact model.

mod curvature;
mod friction;
mod model;
