//! Where the hand is in the world: the device's mapping, the clutch by which it is moved without the object, and the same for a hand
//! that is found elsewhere.

use palpate_core::{Pose, Twist};
use palpate_device::DeviceState;
use palpate_dynamics::{DeviceMapping, DeviceMotion};

/// The device's mapping with its clutch (indexing).
///
/// While the clutch is held the hand's image in the world stays where it was when it was pressed, and the object with
/// it. On release the mapping's origin and the handle's orientation are set so that the device is there: nothing in the
/// world notices either.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Workspace {
    mapping: DeviceMapping,
    /// The button, counted from 0, that is the clutch.
    button: Option<u32>,
    /// Whether the host holds the clutch.
    asked: bool,
    /// Where the hand's image stays while the clutch is held.
    held: Option<Pose>,
}

/// A hand that is found further away than this, m and rad, holds the object where it is.
const ELSEWHERE: (f64, f64) = (5e-3, 0.1);

impl Workspace {
    pub fn new(mapping: DeviceMapping, button: Option<u32>) -> Self {
        Self { mapping, button, asked: false, held: None }
    }

    pub fn mapping(&self) -> &DeviceMapping {
        &self.mapping
    }

    /// Whether the clutch was held at the last call of [`Self::locate`].
    pub fn clutched(&self) -> bool {
        self.held.is_some()
    }

    /// Holds the clutch for the host, or lets it go for it.
    pub fn ask_clutch(&mut self, held: bool) {
        self.asked = held;
    }

    /// Lets a hand that was lost at one pose of the device and found at another, further away than a hand holds still, go on from
    /// where its image was: whether it does.
    pub fn rebase(&mut self, lost: &Pose, found: &Pose) -> bool {
        let way = lost.translation.distance(found.translation);
        let turn = lost.rotation_vector_to(found).length();
        // While the clutch is held the image stays in any case.
        let elsewhere = self.held.is_none() && (way > ELSEWHERE.0 || turn > ELSEWHERE.1);
        if elsewhere {
            self.mapping = self.mapping.rebased(found, &self.mapping.pose(lost));
        }
        elsewhere
    }

    /// Where the hand is in the world for a state of the device.
    pub fn locate(&mut self, device: &DeviceState) -> DeviceMotion {
        let pressed =
            self.button.is_some_and(|button| device.buttons.checked_shr(button).unwrap_or(0) & 1 == 1);
        let here = self.mapping.pose(&device.pose);
        if self.asked || pressed {
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
