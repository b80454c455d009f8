//! Recordings of a session: one row per haptic step.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use palpate_core::glam::DVec3;
use palpate_core::{Pose, Wrench};
use serde::Serialize;

/// Row of a recording: numbers under column names.
pub trait Recorded: Copy + std::fmt::Debug + Send + 'static {
    /// Column names, in order.
    const COLUMNS: &'static [&'static str];

    /// Record without a step.
    #[doc(hidden)]
    const BLANK: Self;

    /// The numbers, in the order of [`COLUMNS`](Self::COLUMNS).
    fn row(&self) -> impl Iterator<Item = f64>;
}

/// Values of which a record is made, besides the step of the tool.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct StepData {
    pub time: f64,
    /// Pose of the device as it was read, in its axes.
    pub device: Pose,
    /// Pose at which the device holds the first mesh's frame, in the world.
    pub handle: Pose,
    /// Angle of the gripper as it was read, rad.
    pub gripper: f64,
    /// Wrench sent to the device, in its axes.
    pub coupling: Wrench,
    /// Torque sent to the gripper, N·m.
    pub torque: f64,
    /// Contact model in use of each body.
    pub models: [ModelData; 2],
}

/// Time, pose and result of the query that a contact model comes from.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct ModelData {
    /// Time of the body state that the query saw, s; NaN before the first.
    pub time: f64,
    /// Pose of the body's centre of mass that the query saw.
    pub pose: Pose,
    /// Deepest penetration, m.
    pub depth: f64,
    /// Number of contacts before clustering.
    pub contacts: u32,
}

impl ModelData {
    /// Data before the first query: no contacts, with the body at a pose.
    pub(crate) const fn none(pose: Pose) -> Self {
        Self { time: f64::NAN, pose, depth: 0.0, contacts: 0 }
    }
}

/// Seven numbers of a pose: position, and quaternion x, y, z, w.
pub(crate) fn numbers_of_pose(pose: &Pose) -> [f64; 7] {
    let (x, q) = (pose.translation, pose.rotation);
    [x.x, x.y, x.z, q.x, q.y, q.z, q.w]
}

/// Six numbers of a wrench: force and torque.
pub(crate) fn numbers_of_wrench(wrench: &Wrench) -> [f64; 6] {
    let (f, t) = (wrench.force, wrench.torque);
    [f.x, f.y, f.z, t.x, t.y, t.z]
}

/// State of one haptic step, in SI units and world axes unless a field says otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Record {
    /// Time since the start, s.
    pub time: f64,
    /// Pose of the device as it was read, in its own axes and at its own scale; the last good one where a
    /// reading was refused.
    pub device: Pose,
    /// Pose at which the device holds the mesh's frame, in the world: the object is there while nothing
    /// holds it back. It stays in place while the clutch is held. Not written to recordings.
    pub handle: Pose,
    /// Pose of the grasped object's mesh frame in the world after the step.
    pub object: Pose,
    /// Wrench sent to the device, in its axes: force, and torque about its handle's origin.
    pub coupling: Wrench,
    /// Contact wrench on the grasped object: force, and torque about its centre of mass.
    pub contact: Wrench,
    /// Deepest penetration that the latest contact query found, m; 0 without penetration.
    pub depth: f64,
    /// Number of contacts of the latest contact query, before clustering.
    pub contacts: u32,
    /// Age of the contact model in use, s; NaN before the first.
    pub model_age: f64,
}

impl Record {
    /// Stretch of the coupling, m: distance, in the world, of the object's grasp from where the device holds
    /// it. `grasp` is the grasp's position in the mesh's frame, as in
    /// [`Summary::grasp`](crate::Summary::grasp).
    ///
    /// The origins of the two frames may be much further apart: a small rotation of the object against the
    /// device shifts the origin by the angle times its distance from the grasp.
    pub fn stretch(&self, grasp: DVec3) -> f64 {
        self.handle.transform_point(grasp).distance(self.object.transform_point(grasp))
    }
}

/// Column names of a recording, in order.
#[rustfmt::skip]
pub const COLUMNS: [&str; 30] = [
    "t",
    "device_px", "device_py", "device_pz", "device_qx", "device_qy", "device_qz", "device_qw",
    "object_px", "object_py", "object_pz", "object_qx", "object_qy", "object_qz", "object_qw",
    "coupling_fx", "coupling_fy", "coupling_fz", "coupling_tx", "coupling_ty", "coupling_tz",
    "contact_fx", "contact_fy", "contact_fz", "contact_tx", "contact_ty", "contact_tz",
    "depth", "contacts", "model_age",
];

impl Recorded for Record {
    const COLUMNS: &'static [&'static str] = &COLUMNS;

    const BLANK: Self = Self {
        time: 0.0,
        device: Pose::IDENTITY,
        handle: Pose::IDENTITY,
        object: Pose::IDENTITY,
        coupling: Wrench::ZERO,
        contact: Wrench::ZERO,
        depth: 0.0,
        contacts: 0,
        model_age: f64::NAN,
    };

    fn row(&self) -> impl Iterator<Item = f64> {
        std::iter::once(self.time)
            .chain(numbers_of_pose(&self.device))
            .chain(numbers_of_pose(&self.object))
            .chain(numbers_of_wrench(&self.coupling))
            .chain(numbers_of_wrench(&self.contact))
            .chain([self.depth, self.contacts.into(), self.model_age])
    }
}

/// Writer of a recording as CSV: the header [`COLUMNS`](Recorded::COLUMNS), then one row per step, in full
/// precision, so that reading it back gives the same numbers.
#[derive(Debug)]
pub struct RecordWriter<W: Write, R = Record> {
    out: csv::Writer<W>,
    record: std::marker::PhantomData<fn(&R)>,
}

impl<R: Recorded> RecordWriter<File, R> {
    /// Creates a file for a recording.
    ///
    /// # Errors
    /// If the file cannot be created or written.
    pub fn create(path: &Path) -> io::Result<Self> {
        Self::new(File::create(path)?)
    }
}

impl<W: Write, R: Recorded> RecordWriter<W, R> {
    /// Begins a recording on any writer.
    ///
    /// # Errors
    /// If the header cannot be written.
    pub fn new(out: W) -> io::Result<Self> {
        let mut out = csv::Writer::from_writer(out);
        out.write_record(R::COLUMNS)?;
        Ok(Self { out, record: std::marker::PhantomData })
    }

    /// Writes a row.
    ///
    /// # Errors
    /// If the row cannot be written.
    pub fn write(&mut self, record: &R) -> io::Result<()> {
        for number in record.row() {
            self.out.write_field(number.to_string())?;
        }
        Ok(self.out.write_record(None::<&[u8]>)?)
    }

    /// Flushes the buffered rows. Call it at the end, so that an error is not lost.
    ///
    /// # Errors
    /// If the rows cannot be written.
    pub fn finish(mut self) -> io::Result<()> {
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DQuat;

    use super::*;

    /// A rotation about the grasp does not stretch the coupling, however far it moves the frame's origin.
    #[test]
    fn the_stretch_is_measured_at_the_grasp() {
        let grasp = DVec3::new(0.1, 0.0, 0.0);
        let turn = Pose::new(DVec3::ZERO, DQuat::from_rotation_z(0.04));
        let about_grasp = Pose::from_translation(grasp) * turn * Pose::from_translation(-grasp);
        let handle = Pose::new(DVec3::new(0.3, -0.2, 0.1), DQuat::from_rotation_x(1.2));
        let shift = Pose::from_translation(DVec3::new(0.0, 4e-4, -3e-4));
        let record = Record { handle, object: shift * handle * about_grasp, ..Record::BLANK };
        assert!((record.stretch(grasp) - 5e-4).abs() < 1e-12, "{}", record.stretch(grasp));
        let origins = record.handle.translation.distance(record.object.translation);
        assert!(origins > 3e-3 && (record.stretch(DVec3::ZERO) - origins).abs() < 1e-15, "{origins}");
    }
}
