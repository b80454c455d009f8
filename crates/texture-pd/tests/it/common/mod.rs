//! Plates whose relief is a given function, and the exact depth of two of them.
#![allow(dead_code, reason = "each test uses a part of it")]

use std::sync::Arc;

use glam::{DQuat, DVec2, DVec3};
use palpate_core::mesh::UvMesh;
use palpate_core::{Pose, TriMesh};
use palpate_texture_pd::{Domain, HeightImage, SurfaceSet, TextureContact, TexturedSurface, Wrap};

/// Height over the plate's plane at (x, y), m.
pub type Relief = dyn Fn(DVec2) -> f64;

/// A square in the plane z = 0 around the origin, of two triangles that face along z.
pub fn square(half: f64) -> UvMesh {
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, y]| DVec2::new(x, y));
    let triangles = vec![[0, 1, 2], [0, 2, 3]];
    let uv = triangles.iter().map(|t: &[u32; 3]| t.map(|i| 0.5 * (corners[i as usize] + 1.0))).collect();
    let vertices = corners.iter().map(|corner| (*corner * half).extend(0.0)).collect();
    UvMesh::new(TriMesh::new(vertices, triangles).unwrap(), uv).unwrap()
}

/// Samples the relief at the centres of `texels` × `texels` texels of a square plate.
pub fn plate(half: f64, texels: u32, relief: &Relief) -> Arc<TexturedSurface> {
    let at = |index: u32| ((f64::from(index) + 0.5) / f64::from(texels) * 2.0 - 1.0) * half;
    let heights =
        (0..texels * texels).map(|i| relief(DVec2::new(at(i % texels), at(i / texels))) as f32).collect();
    let image = HeightImage::new(texels, texels, heights, [Wrap::Clamp; 2]).unwrap();
    Arc::new(TexturedSurface::textured(&square(half), &image, 0.5).unwrap())
}

/// Two plates face to face: B lies in z = 0, and A, turned over, at some height with its own z downwards.
pub struct Plates<'a> {
    pub half: f64,
    pub relief_a: &'a Relief,
    pub relief_b: &'a Relief,
}

/// Returns the pose of A with its plane z = 0 at `height`, turned over.
pub fn turned_over(place: DVec2, height: f64, turn: DVec3) -> Pose {
    let over = DQuat::from_rotation_x(std::f64::consts::PI);
    Pose::new(place.extend(height), DQuat::from_scaled_axis(turn) * over)
}

impl Plates<'_> {
    pub fn surfaces(&self, texels: u32) -> (SurfaceSet, [palpate_texture_pd::SurfaceId; 2]) {
        let mut set = SurfaceSet::default();
        let ids =
            [self.relief_a, self.relief_b].map(|relief| set.add(&plate(self.half, texels, relief)).unwrap());
        (set, ids)
    }

    pub fn contact(
        &self,
        ids: [palpate_texture_pd::SurfaceId; 2],
        pose: Pose,
        half_size: f64,
    ) -> TextureContact {
        TextureContact {
            a: ids[0],
            pose_a: pose,
            center: pose.translation + DVec3::new(0.001, -0.002, 0.01),
            b: ids[1],
            pose_b: Pose::IDENTITY,
            normal: -DVec3::Z,
            point: pose.translation.with_z(0.0),
            half_size,
            reach: 0.5 * self.half,
            domain: Domain::WHOLE,
        }
    }

    /// Returns the depth below B's surface of the point of A at (x, y) on its plate, m.
    fn overlap(&self, pose: &Pose, at: DVec2) -> f64 {
        let point = pose.transform_point(at.extend((self.relief_a)(at)));
        (self.relief_b)(point.truncate()) - point.z
    }

    /// Returns the largest overlap around a point of A's plate, to rounding, by successively finer grids.
    pub fn depth(&self, pose: &Pose, around: DVec2, half_size: f64) -> f64 {
        let (mut best, mut around, mut half) = (f64::NEG_INFINITY, around, half_size);
        let mut cells = 100;
        while half > 1e-9 {
            let middle = around;
            for i in 0..=cells {
                for j in 0..=cells {
                    let offset = DVec2::new(f64::from(i), f64::from(j)) / f64::from(cells) * 2.0 - 1.0;
                    let at = middle + offset * half;
                    let overlap = self.overlap(pose, at);
                    if overlap > best {
                        (best, around) = (overlap, at);
                    }
                }
            }
            half *= 4.0 / f64::from(cells);
            cells = 12;
        }
        best
    }
}

/// Returns a pose shifted and rotated about a point, world axes.
pub fn moved(pose: &Pose, center: DVec3, shift: DVec3, turn: DVec3) -> Pose {
    let rotation = DQuat::from_scaled_axis(turn);
    Pose::new(center + rotation * (pose.translation - center) + shift, (rotation * pose.rotation).normalize())
}
