//! Errors of queries and contact sets.

use std::fmt;

use palpate_core::Pose;

/// One of the two objects of a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QueryObject {
    /// The probe: the grasped object, out of which contact normals point.
    Probe,
    /// The scene object.
    Scene,
}

impl fmt::Display for QueryObject {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Probe => "probe",
            Self::Scene => "scene object",
        })
    }
}

/// Reason why a query was not made. It has no contacts then; the next query may succeed.
///
/// The error is `Copy` and holds no text, so that a real-time loop can return it: the message is formatted
/// when it is displayed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum QueryError {
    /// A pose is not [valid](palpate_core::Pose::is_valid).
    #[error("the pose of the {object} is not valid: give a finite translation and a rotation of unit length")]
    Pose {
        /// The object that was placed.
        object: QueryObject,
    },
    /// The tolerance d is negative, not a number, or larger than
    /// [`Shape::max_tolerance`](crate::Shape::max_tolerance) of the probe.
    #[error("the tolerance is {given} m: give 0 to {most} m, the probe's bounding radius")]
    Tolerance {
        /// The given tolerance, m.
        given: f64,
        /// The largest accepted tolerance, m.
        most: f64,
    },
    /// The haptic error metric s₀ is negative or not finite.
    #[error("the error s₀ is {given} m: give a finite length, 0 or more, or no haptic metric")]
    HapticMetric {
        /// The given threshold, m.
        given: f64,
    },
    /// The velocity metric's time is negative, or its time or twist not finite.
    #[error("the velocity metric is not valid: give a finite time, 0 s or more, and a finite twist")]
    VelocityMetric,
    /// The view metric's pixels are negative, a size is not positive, or a number is not finite.
    #[error(
        "the view metric is not valid: give a finite camera position, pixels of 0 or more, and near plane, frustum and \
         image sizes above 0"
    )]
    ViewMetric,
}

impl QueryError {
    /// Checks that an object can be placed at a pose.
    pub(crate) fn check_pose(pose: &Pose, object: QueryObject) -> Result<(), Self> {
        if pose.is_valid() { Ok(()) } else { Err(Self::Pose { object }) }
    }
}

/// Reason why a contact set was not made. It is empty then.
///
/// The error is `Copy` and holds no text, like [`QueryError`].
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ContactSetError {
    /// A pose is not [valid](palpate_core::Pose::is_valid).
    #[error("the pose of the {object} is not valid: give a finite translation and a rotation of unit length")]
    Pose {
        /// The object that was placed.
        object: QueryObject,
    },
    /// The merging distance is negative or not finite.
    #[error("the merging distance is {given} m: give a finite length, 0 or more")]
    Merge {
        /// The given distance, m.
        given: f64,
    },
    /// The spacing is negative or not a number.
    #[error("the spacing is {given} m: give 0 or more; infinity keeps one contact for each region")]
    Spacing {
        /// The given spacing, m.
        given: f64,
    },
    /// A contact is not finite, or its nodes are not patches of these objects.
    #[error(
        "contact {index} is not finite or not between patches of these objects: pass the contacts of a query between \
         the same two shapes"
    )]
    Contact {
        /// Index of the first such contact.
        index: usize,
    },
}

impl ContactSetError {
    /// Checks that the probe and the scene object can be placed at their poses.
    pub(crate) fn check_poses(poses: [&Pose; 2]) -> Result<(), Self> {
        let objects = [QueryObject::Probe, QueryObject::Scene];
        match poses.into_iter().zip(objects).find(|(pose, _)| !pose.is_valid()) {
            Some((_, object)) => Err(Self::Pose { object }),
            None => Ok(()),
        }
    }
}
