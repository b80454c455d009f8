//! Points of the two bodies' surfaces near each other: the places that a body must not pass, whose distances
//! are cheap to read again at another pose.

use arrayvec::ArrayVec;
use glam::{DVec3, Vec3, Vec3A};
use palpate_core::Pose;
use wide::f32x4;

use crate::body::FieldBody;
use crate::query::FieldQuery;
use crate::samples::Sample;
use crate::selection::SelectedFour;
use crate::tree::Piece;

/// A sample of one body's surface near the other body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Its number among the samples of its own body.
    pub sample: usize,
    /// Its position in the frame of its own body's mesh, m.
    pub point: DVec3,
    /// Whether it is on the probe's surface, or on the scene object's.
    pub is_probe: bool,
    /// Its signed distance from the other body at the query's pose, approximately, m.
    pub distance: f64,
    /// The place on the probe's surface, in the probe's axes from its centre, m.
    pub on_probe: Vec3A,
    /// Unit normal out of the probe, in its axes.
    pub normal: Vec3A,
}

/// A part of a body's surface and a sphere around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePart {
    /// Centre of the sphere in the mesh's frame, m.
    pub center: DVec3,
    /// Radius of the sphere, m.
    pub radius: f64,
    /// Lower bound on the signed distance of the centre from the other body, m.
    pub distance: f64,
}

impl FieldQuery {
    /// Passes on the samples of the last query that are within its tolerance, with these bodies at these
    /// poses.
    pub fn surface_points(
        &self,
        (probe, probe_pose): (&FieldBody, &Pose),
        (scene, scene_pose): (&FieldBody, &Pose),
        mut to: impl FnMut(&SurfacePoint),
    ) {
        let tolerance = self.tolerance();
        let sides = self.sides_at(probe, scene, &(scene_pose.inverse() * *probe_pose));
        for ((side, body), selection) in sides.iter().zip([probe, scene]).zip(self.selections()) {
            for SelectedFour { points, samples, .. } in selection.fours() {
                let read = side.read(&points);
                if read.in_contact == 0 {
                    continue;
                }
                side.contacts(&points, &read, |lane, touch| {
                    let Some(&sample) = samples.get(lane) else { return };
                    to(&SurfacePoint {
                        sample: body.samples.number(sample),
                        point: body.samples.center() + body.samples.point(sample).as_dvec3(),
                        is_probe: touch.is_probe,
                        distance: (1.0 - f64::from(touch.reach)) * tolerance,
                        on_probe: touch.point,
                        normal: touch.normal,
                    });
                });
            }
        }
    }
}

impl FieldBody {
    /// Number of samples of all levels.
    pub fn samples(&self) -> usize {
        self.samples.number(Sample { level: self.samples.levels.len() as u8, index: 0 })
    }

    /// Signed distances (m) of four points in the mesh's frame (m) from the surface, and their gradients.
    /// Beyond the band they are bounds.
    pub fn distances(&self, points: [DVec3; 4]) -> [(f64, DVec3); 4] {
        let spacing = self.field.spacing();
        let at = points.map(|point| ((point - self.field.origin()) / spacing).as_vec3());
        let [x, y, z] = [0, 1, 2].map(|axis| f32x4::new(at.map(|at| at[axis])));
        let [distance, gx, gy, gz] = self.field.read::<true>(&[x, y, z]).map(f32x4::to_array);
        std::array::from_fn(|lane| {
            let gradient = Vec3::new(gx[lane], gy[lane], gz[lane]).as_dvec3();
            (f64::from(distance[lane]) * spacing, gradient)
        })
    }

    /// Passes on parts of this body's surface, with radii of at most about `size` (m), that make up all of it
    /// that is from a least to a largest distance (m) from another body at a relative pose. Returns `false`
    /// if there are more than `most`. The least distance has to be within the other body's band.
    pub fn parts_within(
        &self,
        other: &Self,
        to_other: &Pose,
        (least, largest): (f64, f64),
        (size, most): (f64, usize),
        mut to: impl FnMut(&SurfacePart),
    ) -> bool {
        let mut count = 0;
        let mut stack = ArrayVec::<Piece, 128>::new();
        stack.push(self.tree.whole());
        while let Some(piece) = stack.pop() {
            let (center, radius) = self.tree.sphere(&piece);
            let [low, high] = other.field.bounds(to_other.transform_point(center));
            if low - radius > largest || high + radius < least {
                continue;
            }
            if let Some(halves) = self.tree.halves(&piece).filter(|_| radius > size) {
                if halves.into_iter().any(|half| stack.try_push(half).is_err()) {
                    return false;
                }
                continue;
            }
            count += 1;
            if count > most {
                return false;
            }
            to(&SurfacePart { center, radius, distance: low });
        }
        true
    }

    /// A lower bound on the distance between this body and another at a relative pose (m): at most `enough`
    /// (m), and 0 if the bodies may touch, or one may be inside the other. How close it is to the distance,
    /// and what is said of distances below `least` (m): see [`SurfaceTree`](crate::SurfaceTree::clearance).
    pub fn clearance(&self, other: &Self, to_other: &Pose, (least, enough): (f64, f64)) -> f64 {
        let apart = self.tree.clearance(&other.tree, to_other, (least, enough));
        let holds = |inner: &Self, outer: &Self, to_outer: &Pose| {
            inner.tree.parts().any(|point| {
                // Every point is further than that from the surface: one that is not known to be less deep is
                // inside.
                outer.field.bounds(to_outer.transform_point(point))[0] <= -apart
            })
        };
        let is_inside = apart > 0.0
            && self.tree.may_contain(&other.tree, to_other)
            && (holds(self, other, to_other) || holds(other, self, &to_other.inverse()));
        if is_inside { 0.0 } else { apart }
    }
}

#[cfg(test)]
mod tests;
