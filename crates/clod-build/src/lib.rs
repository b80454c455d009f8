//! Builds contact levels of detail: surface convex decomposition and hierarchy of convex hulls.
