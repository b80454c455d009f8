//! Contact queries between hierarchies of convex hulls, and contact clustering.
