//! Recordings of a session with a tool of two bodies: one row per haptic step.

use palpate_core::{Pose, Wrench};

use super::record::{Recorded, numbers_of_pose, numbers_of_wrench};

/// State of one haptic step of a hinged tool, in SI units and world axes unless a field says otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HingedRecord {
    /// Time since the start, s.
    pub time: f64,
    /// Pose of the device as it was read, in its own axes and at its own scale; the last good one where a
    /// reading was refused.
    pub device: Pose,
    /// Pose at which the device holds the first mesh's frame, in the world. Not written to recordings.
    pub handle: Pose,
    /// Angle of the gripper as it was read, rad; the last good one where a reading was refused.
    pub gripper: f64,
    /// Poses of the mesh frames of the two bodies in the world after the step.
    pub objects: [Pose; 2],
    /// Angle of the hinge after the step, rad.
    pub angle: f64,
    /// Wrench sent to the device, in its axes: force, and torque about its handle's origin.
    pub coupling: Wrench,
    /// Torque sent to the gripper, N·m; a positive one opens the gripper.
    pub torque: f64,
    /// Torque of the hinge's stops on the second body, N·m; a positive one opens the hinge.
    pub stop: f64,
    /// Contact wrench on each body: force, and torque about its centre of mass.
    pub contact: [Wrench; 2],
    /// Deepest penetration of each body that its latest contact query found, m; 0 without penetration.
    pub depth: [f64; 2],
    /// Number of contacts of each body's latest contact query, before clustering.
    pub contacts: [u32; 2],
    /// Age of the older of the contact models in use, s; NaN before the first.
    pub model_age: f64,
}

/// Column names, in order.
#[rustfmt::skip]
const COLUMNS: [&str; 49] = [
    "t",
    "device_px", "device_py", "device_pz", "device_qx", "device_qy", "device_qz", "device_qw",
    "gripper",
    "first_px", "first_py", "first_pz", "first_qx", "first_qy", "first_qz", "first_qw",
    "second_px", "second_py", "second_pz", "second_qx", "second_qy", "second_qz", "second_qw",
    "angle",
    "coupling_fx", "coupling_fy", "coupling_fz", "coupling_tx", "coupling_ty", "coupling_tz",
    "torque", "stop",
    "first_fx", "first_fy", "first_fz", "first_tx", "first_ty", "first_tz",
    "second_fx", "second_fy", "second_fz", "second_tx", "second_ty", "second_tz",
    "first_depth", "second_depth", "first_contacts", "second_contacts", "model_age",
];

impl Recorded for HingedRecord {
    const COLUMNS: &'static [&'static str] = &COLUMNS;

    const BLANK: Self = Self {
        time: 0.0,
        device: Pose::IDENTITY,
        handle: Pose::IDENTITY,
        gripper: 0.0,
        objects: [Pose::IDENTITY; 2],
        angle: 0.0,
        coupling: Wrench::ZERO,
        torque: 0.0,
        stop: 0.0,
        contact: [Wrench::ZERO; 2],
        depth: [0.0; 2],
        contacts: [0; 2],
        model_age: f64::NAN,
    };

    fn row(&self) -> impl Iterator<Item = f64> {
        let [first, second] = &self.objects;
        std::iter::once(self.time)
            .chain(numbers_of_pose(&self.device))
            .chain([self.gripper])
            .chain(numbers_of_pose(first))
            .chain(numbers_of_pose(second))
            .chain([self.angle])
            .chain(numbers_of_wrench(&self.coupling))
            .chain([self.torque, self.stop])
            .chain(numbers_of_wrench(&self.contact[0]))
            .chain(numbers_of_wrench(&self.contact[1]))
            .chain(self.depth)
            .chain(self.contacts.map(f64::from))
            .chain([self.model_age])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_has_a_number_for_each_column() {
        let record = HingedRecord {
            time: 1.0,
            gripper: 2.0,
            angle: 3.0,
            torque: 4.0,
            stop: 5.0,
            depth: [6.0, 7.0],
            contacts: [8, 9],
            model_age: 10.0,
            ..HingedRecord::BLANK
        };
        let row: Vec<f64> = record.row().collect();
        assert_eq!(row.len(), COLUMNS.len());
        let of = |name: &str| COLUMNS.iter().position(|column| *column == name).map(|i| row[i]);
        let named = [
            ("t", 1.0),
            ("gripper", 2.0),
            ("angle", 3.0),
            ("torque", 4.0),
            ("stop", 5.0),
            ("second_qw", 1.0),
            ("second_depth", 7.0),
            ("second_contacts", 9.0),
            ("model_age", 10.0),
        ];
        for (name, value) in named {
            assert_eq!(of(name), Some(value), "{name}");
        }
    }
}
