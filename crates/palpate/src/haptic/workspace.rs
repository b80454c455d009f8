//! The mapping of the device into the world, with the clutch, which moves the device without the object, and
//! rebasing, which does the same after the hand was lost.

use palpate_core::{Pose, Twist};
use palpate_device::DeviceState;
use palpate_dynamics::{DeviceMapping, DeviceMotion};

/// The device's mapping with its clutch (indexing).
///
/// While the clutch is held, the hand's image in the world stays where it was when the clutch was pressed,
/// and the object with it. On release the mapping's origin and the handle's orientation are set so that the
/// device maps to that image: nothing moves in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Workspace {
    mapping: DeviceMapping,
    /// The clutch button, counted from 0.
    button: Option<u32>,
    /// Whether the host holds the clutch.
    held_by_host: bool,
    /// Pose of the hand's image while the clutch is held.
    held: Option<Pose>,
}

/// Smallest displacement of a lost hand, m and rad, at which the mapping is rebased. With more, the object
/// jumps to where the hand is found.
const MIN_REBASE: (f64, f64) = (5e-3, 0.1);

impl Workspace {
    pub fn new(mapping: DeviceMapping, button: Option<u32>) -> Self {
        Self { mapping, button, held_by_host: false, held: None }
    }

    pub fn mapping(&self) -> &DeviceMapping {
        &self.mapping
    }

    /// Whether the clutch was held at the last call of [`Self::locate`].
    pub fn clutched(&self) -> bool {
        self.held.is_some()
    }

    /// Holds or releases the clutch on behalf of the host.
    pub fn ask_clutch(&mut self, held: bool) {
        self.held_by_host = held;
    }

    /// Rebases the mapping of a hand that was lost at one pose of the device and found at another, so that
    /// its image does not move; `false` if the two are close or the clutch is held.
    pub fn rebase(&mut self, lost: &Pose, found: &Pose) -> bool {
        let distance = lost.translation.distance(found.translation);
        let turn = lost.rotation_vector_to(found).length();
        // While the clutch is held the image stays in any case.
        let elsewhere = self.held.is_none() && (distance > MIN_REBASE.0 || turn > MIN_REBASE.1);
        if elsewhere {
            self.mapping = self.mapping.rebased(found, &self.mapping.pose(lost));
        }
        elsewhere
    }

    /// Motion of the hand's image in the world for a state of the device.
    pub fn locate(&mut self, device: &DeviceState) -> DeviceMotion {
        let pressed =
            self.button.is_some_and(|button| device.buttons.checked_shr(button).unwrap_or(0) & 1 == 1);
        let here = self.mapping.pose(&device.pose);
        if self.held_by_host || pressed {
            return DeviceMotion::at_rest(*self.held.get_or_insert(here));
        }
        let pose = match self.held.take() {
            Some(held) => {
                self.mapping = self.mapping.rebased(&device.pose, &held);
                held
            }
            None => here,
        };
        DeviceMotion { pose, twist: self.mapping.twist(&device.twist) }
    }
}

/// The motion of the point at `grasp` in the frame of the handle.
pub(crate) fn motion_at(handle: &DeviceMotion, grasp: &Pose) -> DeviceMotion {
    let pose = handle.pose * *grasp;
    let arm = pose.translation - handle.pose.translation;
    DeviceMotion { pose, twist: Twist::new(handle.twist.velocity_at(arm), handle.twist.angular) }
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::{DQuat, DVec3};
    use palpate_device::Status;

    use super::*;

    fn device(x: f64, turn: f64, buttons: u32) -> DeviceState {
        let pose = Pose::new(DVec3::X * x, DQuat::from_rotation_z(turn));
        DeviceState { time: 0.0, pose, twist: Twist::new(DVec3::X, DVec3::Z), buttons, status: Status::OK }
    }

    fn workspace() -> Workspace {
        let base = Pose::new(DVec3::new(0.1, -0.2, 0.3), DQuat::from_rotation_x(0.5));
        Workspace::new(DeviceMapping::new(2.0, base), Some(1))
    }

    fn close(one: &Pose, other: &Pose) -> bool {
        one.translation.distance(other.translation) < 1e-12 && one.rotation_vector_to(other).length() < 1e-12
    }

    /// While the clutch is held, by its button or by the host, the hand's image stays and is at rest; on
    /// release it goes on from there.
    #[test]
    fn a_clutch_moves_the_device_and_nothing_else() {
        for by_host in [false, true] {
            let mut workspace = workspace();
            let button = if by_host { 0 } else { 0b10 };
            let before = workspace.locate(&device(0.0, 0.0, 0)).pose;
            workspace.ask_clutch(by_host);
            for step in 0..5 {
                let image = workspace.locate(&device(0.01 * f64::from(step), 0.1 * f64::from(step), button));
                assert!(close(&image.pose, &before) && image.twist == Twist::ZERO, "step {step}");
                assert!(workspace.clutched());
            }
            workspace.ask_clutch(false);
            let released = workspace.locate(&device(0.04, 0.4, 0));
            assert!(close(&released.pose, &before) && !workspace.clutched());
            // From there a metre at the device is two in the world.
            let moved = workspace.locate(&device(0.05, 0.4, 0));
            let distance = moved.pose.translation.distance(before.translation);
            assert!((distance - 0.02).abs() < 1e-12, "{distance} m");
            assert!((moved.twist.linear.length() - 2.0).abs() < 1e-12);
        }
        // Other buttons do not act as a clutch.
        let mut other = workspace();
        other.locate(&device(0.0, 0.0, 0b101));
        assert!(!other.clutched());
    }

    /// The image of a hand that is found far from where it was lost stays; that of a nearer one follows.
    #[test]
    fn a_hand_that_is_found_far_away_moves_nothing() {
        for (moved, turned, rebased) in
            [(0.004, 0.0, false), (0.006, 0.0, true), (0.0, 0.09, false), (0.0, 0.11, true)]
        {
            let mut workspace = workspace();
            let (lost, found) = (device(0.0, 0.0, 0), device(moved, turned, 0));
            let before = workspace.locate(&lost).pose;
            assert_eq!(workspace.rebase(&lost.pose, &found.pose), rebased, "{moved} m, {turned} rad");
            assert_eq!(close(&workspace.locate(&found).pose, &before), rebased, "{moved} m, {turned} rad");
        }
    }
}
