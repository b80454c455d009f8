//! Camera that orbits about its target.

use std::f64::consts::{FRAC_PI_2, TAU};

use palpate::glam::dcamera::rh::{proj, view};
use palpate::glam::{DMat3, DVec3, Mat4};

/// Vertical field of view, rad.
const FIELD: f64 = 0.7;
/// Smallest distance of the camera, m; near and far clipping planes, in distances from the target.
const MIN_DISTANCE: f64 = 1e-4;
const NEAR: f64 = 0.02;
const FAR: f64 = 50.0;

/// Camera that looks at a point, with the world's z axis up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Target point, m.
    pub target: DVec3,
    /// Distance from the target, m.
    pub distance: f64,
    /// Azimuth about the vertical from the -y axis, rad.
    pub yaw: f64,
    /// Elevation above the horizon, rad.
    pub pitch: f64,
}

impl Camera {
    /// Returns a camera that sees a whole sphere.
    pub fn around(center: DVec3, radius: f64) -> Self {
        let distance = (1.2 * radius / (0.5 * FIELD).sin()).max(MIN_DISTANCE);
        Self { target: center, distance, yaw: 0.5, pitch: 0.35 }
    }

    /// Returns its axes in the world as columns: right, up and back.
    pub fn axes(&self) -> DMat3 {
        let (sin_yaw, cos_yaw) = self.yaw.sin_cos();
        let (sin_pitch, cos_pitch) = self.pitch.sin_cos();
        let back = DVec3::new(sin_yaw * cos_pitch, -cos_yaw * cos_pitch, sin_pitch);
        let right = DVec3::new(cos_yaw, sin_yaw, 0.0);
        DMat3::from_cols(right, back.cross(right), back)
    }

    /// Returns its position, m.
    pub fn eye(&self) -> DVec3 {
        self.target + self.axes().z_axis * self.distance
    }

    /// Returns the projection from the world to a picture with an aspect ratio (width over height); depths
    /// are from 0 to 1.
    pub fn clip_from_world(&self, aspect: f64) -> Mat4 {
        let projection = proj::directx::perspective(
            FIELD,
            aspect.clamp(0.01, 100.0),
            NEAR * self.distance,
            FAR * self.distance,
        );
        let seen = view::look_at_mat4(self.eye(), self.target, DVec3::Z);
        (projection * seen).as_mat4()
    }

    /// Orbits about the target, by a drag to the right and down in heights of the picture.
    pub fn orbit(&mut self, right: f64, down: f64) {
        self.yaw = (self.yaw - right * TAU * 0.5).rem_euclid(TAU);
        self.pitch = (self.pitch + down * TAU * 0.5).clamp(0.02 - FRAC_PI_2, FRAC_PI_2 - 0.02);
    }

    /// Moves nearer by a factor.
    pub fn zoom(&mut self, factor: f64) {
        if factor.is_finite() && factor > 0.0 {
            self.distance = (self.distance / factor).clamp(MIN_DISTANCE, 1e4);
        }
    }

    /// Returns the displacement in the world, perpendicular to the line of sight at the target, for a drag to
    /// the right and down in heights of the picture, m.
    pub fn across(&self, right: f64, down: f64) -> DVec3 {
        let height = 2.0 * self.distance * (0.5 * FIELD).tan();
        let axes = self.axes();
        (axes.x_axis * right - axes.y_axis * down) * height
    }
}

#[cfg(test)]
mod tests {
    use palpate::glam::Vec3;

    use super::*;

    fn seen(camera: &Camera, place: DVec3) -> Vec3 {
        camera.clip_from_world(1.5).project_point3(place.as_vec3())
    }

    /// A dragged point stays under the pointer: `across` is the displacement that moves the picture by as
    /// much.
    #[test]
    fn a_dragged_point_stays_under_the_pointer() {
        let mut camera = Camera::around(DVec3::new(0.1, -0.2, 0.3), 0.05);
        for turn in 0..20 {
            camera.orbit(0.13, if turn < 10 { 0.05 } else { -0.09 });
            let middle = seen(&camera, camera.target);
            assert!(middle.truncate().length() < 1e-5 && (0.0..1.0).contains(&middle.z));
            // A quarter of the height to the right, an eighth down; the picture is 2 high and 3 wide.
            let moved = seen(&camera, camera.target + camera.across(0.25, 0.125));
            assert!((moved.x - 0.5 / 1.5).abs() < 1e-4 && (moved.y + 0.25).abs() < 1e-4, "{moved}");
            assert!((camera.axes().determinant() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_sphere_is_seen_whole_and_never_lost() {
        let (center, radius) = (DVec3::new(0.0, 1.0, 0.0), 0.2);
        let mut camera = Camera::around(center, radius);
        for side in [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z] {
            let place = seen(&camera, center + side * radius);
            assert!(place.abs().max_element() < 1.0, "{place}");
        }
        camera.zoom(f64::NAN);
        camera.zoom(1e300);
        camera.orbit(1e3, 1e9);
        assert!(camera.distance > 0.0 && seen(&camera, center).is_finite());
    }
}
