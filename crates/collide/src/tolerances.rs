//! Numeric tolerances of the whole crate, each with its unit and the effect of a change.
//!
//! All are relative, so that results depend neither on the unit of length nor on an object's distance from
//! the origin. Three quantities recur:
//!
//! - The *precision* of a pair is [`PRECISION`] times the size of the hulls plus the rounding of coordinates,
//!   m.
//! - The *looseness* of a pair is the largest distance of patches from their hulls, m: the builder's
//!   tolerance, which the hierarchy holds ([`Source::tolerance`](palpate_core::clod::Source::tolerance)).
//! - The *rounding* of coordinates is [`COORDINATE_ROUNDING`] times the largest one, m.
//!
//! Constants that trade speed for tightness, and change no answer, are in the modules that use them.

// Lengths and coordinates.

/// Smallest length that counts as more than zero, as a fraction of the size of the hulls involved. Larger:
/// surfaces that are apart count as touching. Smaller: searches reach the limit of rounding and do not
/// converge.
pub(crate) const PRECISION: f64 = 1e-12;

/// Bound on the error of a transformed coordinate, as a fraction of the largest one. Smaller: bounds on
/// motion and on distances no longer hold far from the origin, and contacts are missed.
pub(crate) const COORDINATE_ROUNDING: f64 = 4.0 * f64::EPSILON;

/// Slack for rounding in a computed length or squared length that has to bound the true one, as a fraction of
/// it. Larger: pairs are tested more often than needed. Smaller than some 1e-15: bounds fail, and
/// contacts are missed.
pub(crate) const ROUNDING_SLACK: f64 = 1e-9;

/// Distance below which points are the same, as a fraction of the sizes of the patches that they are on.
/// Larger: small features count as one, and true minima are dropped. Smaller: one contact is reported by
/// several triangles.
pub(crate) const SAME_POINT: f64 = 1e-9;

/// Difference below which contacts and depths are equal, in multiples of the precision. Larger:
/// distinct contacts are merged. Smaller: equal ones are reported twice.
pub(crate) const SAME_CONTACT: f64 = 16.0;

/// Motion bound after which a contact query counts from zero again, in radii of both bodies. Larger: rounding
/// of the sum outgrows the gaps that it is compared with. Smaller: the whole front is tested more often.
pub(crate) const PAIR_MOTION_LIMIT: f64 = 1e3;

/// Motion bound after which the broad phase counts from zero again, in radii of the probe. Larger and
/// smaller: as for [`PAIR_MOTION_LIMIT`]; the broad phase adds its rounding to each step and compares larger
/// gaps.
pub(crate) const SCENE_MOTION_LIMIT: f64 = 1e6;

/// Slack of the broad phase, as a fraction of lengths: the quaternion of a valid pose may be off unit length
/// by 1e-6, which scales rotated vectors by as much. Smaller: objects in reach may get no query.
pub(crate) const UNIT_QUATERNION_SLACK: f64 = 1e-5;

/// Slack on the rotation of a node's points about its centre, as a fraction of it: the node's
/// sphere is rounded to 32-bit floats. Smaller: a separating axis may be trusted for too long, and contacts
/// are missed.
pub(crate) const TURN_SLACK: f64 = 1e-6;

/// Slack on the squared distance of two triangles' bounding spheres, as a fraction of it. Smaller: pairs of
/// triangles right at the tolerance may be missed.
pub(crate) const TRIANGLE_SPHERE_SLACK: f64 = 1e-12;

// Distance of convex hulls (GJK).

/// Height of a simplex that counts as zero, as a fraction of its longest edge; of a tetrahedron, squared
/// against squared face areas. Larger: thin simplices lose their nearest point. Smaller: their barycentric
/// weights are noise.
pub(crate) const FLAT_SIMPLEX: f64 = 1e-12;

/// Barycentric coordinate below which the origin may be outside of a tetrahedron's face. Smaller: rounding
/// may leave out the nearest face. Larger: faces are tested needlessly.
pub(crate) const OUTSIDE_FACE: f64 = 1e-6;

/// Gap between the bounds on a distance that still counts as converged, in multiples of the precision, as
/// rounding leaves it for needle-like simplices. Larger: inexact distances pass. Smaller: exact ones are
/// counted as not converged.
pub(crate) const CONVERGED_GAP: f64 = 100.0;

/// Rounding error of the lower bound between hulls that almost touch: this times the square of the precision,
/// over their distance, m. Larger and smaller: as for [`CONVERGED_GAP`].
pub(crate) const AXIS_ROUNDING: f64 = 1e9;

/// Slack by which one point of a hull has to lead another to rule it out in a cell of directions, as a
/// fraction of their distance. Smaller: rounding may find a direction in the cell beside its own, and with it
/// the wrong support point.
pub(crate) const SUPPORT_SLACK: f64 = 1e-9;

// Penetration of convex hulls (EPA).

/// Volume up to which a tetrahedron is too thin to start from, as a fraction of the cube of its longest edge.
/// Larger: warm starts are lost. Smaller: the polytope starts with faces whose normals are noise.
pub(crate) const THIN_TETRAHEDRON: f64 = 1e-6;

/// Squared normal (edge × edge) of a face without a plane, as a fraction of the fourth power of its longest
/// edge. Larger: true faces are left out. Smaller: slivers get random normals, and the polytope stops being
/// convex.
pub(crate) const SLIVER_FACE: f64 = 1e-28;

/// Height above a face from which a new vertex sees it, in multiples of the precision. Larger: the polytope
/// becomes concave. Smaller or 0: rounding breaks coplanar faces apart, and expansion ends early.
pub(crate) const VISIBLE_HEIGHT: f64 = 0.01;

/// Largest distance of a face's vertices from the plane of the answer, in multiples of the precision, for it
/// to lie in it. Smaller: the witness points may be taken from a coplanar face that the origin does not
/// project into.
pub(crate) const COPLANAR_HEIGHT: f64 = 64.0;

/// Gap of a penetration depth that still counts as exact, as a fraction of the patches' radii. It only
/// affects the count [`QueryOutcome::not_converged`](crate::QueryOutcome::not_converged).
pub(crate) const ACCEPTED_DEPTH_GAP: f64 = 1e-6;

// Real surface of patches.

/// Distance from a triangle within which a witness point lies on it, as a fraction of the patch's radius.
/// Larger: points on virtual faces become contacts. Smaller: points on real ones are decided by the
/// triangles, which takes longer.
pub(crate) const ON_TRIANGLE: f64 = 1e-9;

/// Sine of the largest angle by which a triangle may be turned away and still face a direction. Larger:
/// surfaces seen from behind make contacts. Smaller: those seen edge-on are lost to rounding.
pub(crate) const FACING: f64 = 1e-9;

/// Error (rad) of the direction between two nearest points, times their distance over the
/// precision. Larger and smaller: as for [`FACING`].
pub(crate) const NORMAL_ROUNDING: f64 = 1e-3;

/// Largest height of a vertex above a triangle's plane for which a closed patch counts as its own hull, as a
/// fraction of the patch's radius. Larger: real surface is assumed where the hull bridges dents. Smaller:
/// patches that are convex up to rounding take the slower path.
pub(crate) const CONVEX_PATCH: f64 = 1e-10;

/// Height below the furthest point up to which vertices belong to the same feature of a hull, as a fraction
/// of the patch's radius. Smaller: nearly parallel features count as unique, and a contact between them is
/// dropped.
pub(crate) const FEATURE_HEIGHT: f64 = 1e-7;

/// Sine of the angle below which two edges are parallel, so that their nearest points are not unique.
/// Smaller: as for [`FEATURE_HEIGHT`]. Larger: more pairs are decided by their triangles, which takes longer.
pub(crate) const PARALLEL_EDGES: f64 = 1e-6;

/// Sine of the angle below which the common normal of two edges is not tried as a direction of penetration.
/// Smaller: the direction is noise.
pub(crate) const COMMON_NORMAL: f64 = 1e-9;

// Refinement and clusters.

/// Error threshold that replaces s₀ = 0 when a time-critical query orders pairs by s*/s₀, m. Pairs
/// with a smaller s* count as fine enough; above that, any value gives the same order.
pub(crate) const NOMINAL_ERROR: f64 = 1e-12;

/// Smallest length of the weighted sum of a cluster's normals, as a fraction of its weight. Smaller: the
/// direction of a cluster whose contacts cancel out is noise.
pub(crate) const CANCELLED_NORMALS: f64 = 1e-12;
