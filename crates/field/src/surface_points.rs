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

/// A sample of one body's surface near the other body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Its number among the samples of its own body.
    pub sample: usize,
    /// Its position in the frame of its own body's mesh, m.
    pub point: Vec3,
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
    /// Signed distance of the centre from the other body; a lower bound beyond the band, m.
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
                        point: body.samples.point(sample),
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

    /// Four parts of this body's surface, with their distances from another body at a relative pose; the
    /// radius of one that is missing is negative.
    fn four_parts(&self, level: usize, four: usize, other: &Self, to_other: &Pose) -> [SurfacePart; 4] {
        // The surface between two of the finest samples is less than their spacing from one of them.
        let gap = (f64::from(self.samples.area)).sqrt() * MAX_GAP;
        let [x, y, z, radius] = self.samples.levels[level].spheres[four].map(f32x4::to_array);
        let centers: [DVec3; 4] = std::array::from_fn(|lane| Vec3::new(x[lane], y[lane], z[lane]).as_dvec3());
        let distances = other.distances(centers.map(|center| to_other.transform_point(center)));
        std::array::from_fn(|lane| SurfacePart {
            center: centers[lane],
            radius: f64::from(radius[lane]) + gap,
            distance: distances[lane].0,
        })
    }

    /// Passes on parts of this body's surface, with radii of at most about `size` (m), that make up all of it
    /// that is from a least to a largest distance (m) from another body at a relative pose. Returns `false`
    /// if there are more than `most`.
    pub fn parts_within(
        &self,
        other: &Self,
        to_other: &Pose,
        (least, largest): (f64, f64),
        (size, most): (f64, usize),
        mut to: impl FnMut(&SurfacePart),
    ) -> bool {
        let mut count = 0;
        let mut stack = ArrayVec::<(usize, usize), 128>::new();
        stack.push((self.samples.levels.len().saturating_sub(1), 0));
        while let Some((level, four)) = stack.pop() {
            for (lane, part) in self.four_parts(level, four, other, to_other).into_iter().enumerate() {
                let SurfacePart { radius, distance, .. } = part;
                if radius < 0.0 || distance - radius > largest || distance + radius < least {
                    continue;
                }
                let below = 4 * four + lane;
                if radius > size && level > 1 && below < self.samples.levels[level - 1].spheres.len() {
                    if stack.try_push((level - 1, below)).is_err() {
                        return false;
                    }
                    continue;
                }
                count += 1;
                if count > most {
                    return false;
                }
                to(&part);
            }
        }
        true
    }

    /// A lower bound on the distance between this body and another at a relative pose (m), from spheres
    /// around parts of this one's surface; at most `enough` (m), and 0 if the surfaces may touch. Bounds
    /// below `least` (m) are not as large as they could be.
    pub fn clearance(&self, other: &Self, to_other: &Pose, (least, enough): (f64, f64)) -> f64 {
        let (needed, mut least) = (least, enough);
        let mut read = 0;
        let mut stack = ArrayVec::<(f64, usize, usize), 128>::new();
        stack.push((f64::NEG_INFINITY, self.samples.levels.len().saturating_sub(1), 0));
        while let Some((bound, level, four)) = stack.pop() {
            if bound >= least {
                continue;
            }
            if least < needed {
                // Any part that was left out may be nearer still.
                return 0.0;
            }
            read += 1;
            let mut children = ArrayVec::<(f64, usize, usize), 4>::new();
            for (lane, part) in self.four_parts(level, four, other, to_other).into_iter().enumerate() {
                let bound = part.distance - part.radius;
                if part.radius < 0.0 || bound >= least {
                    continue;
                }
                let below = 4 * four + lane;
                let refined = level > 1
                    && read < MAX_READ
                    && below < self.samples.levels[level - 1].spheres.len()
                    && stack.len() + children.len() < stack.capacity();
                if refined {
                    children.push((bound, level - 1, below));
                } else {
                    least = bound;
                }
            }
            // The nearest is popped first.
            children.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
            stack.extend(children);
        }
        least.max(0.0)
    }
}

/// Largest distance of a point of the surface from the finest samples, in their spacings. With less, a bound
/// on clearance could be too large.
const MAX_GAP: f64 = 1.5;

/// Number of readings of four spheres after which a clearance is not refined further. With more, it costs as
/// much as a query of contacts.
const MAX_READ: usize = 2048;

#[cfg(test)]
mod tests;
