//! The linear algebra that a step needs.

pub(crate) mod eigen;
pub(crate) mod linear_solve;
pub(crate) mod rotation;
pub(crate) mod vector;
