//! Limits and abilities of a device.

use serde::{Deserialize, Deserializer, Serialize};

use crate::mechanics::Handle;

/// A subset of the six axes: translation along and rotation about x, y, z of the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Axes {
    /// Translation along x, y, z.
    pub translation: [bool; 3],
    /// Rotation about x, y, z.
    pub rotation: [bool; 3],
}

impl Axes {
    /// All six.
    pub const ALL: Self = Self { translation: [true; 3], rotation: [true; 3] };
    /// Translation only.
    pub const TRANSLATION: Self = Self { translation: [true; 3], rotation: [false; 3] };
    /// None.
    pub const NONE: Self = Self { translation: [false; 3], rotation: [false; 3] };

    /// Number of axes in the set.
    pub fn count(&self) -> usize {
        self.translation.iter().chain(&self.rotation).filter(|&&axis| axis).count()
    }
}

/// Name, limits and abilities of a device. A limit that the device does not have is infinite (`null` in
/// JSON); an ability that it lacks is zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Specification {
    /// Make and model.
    pub name: String,
    /// Peak force, N; a larger one is clipped to it.
    #[serde(deserialize_with = "or_infinite")]
    pub peak_force: f64,
    /// Force that can be sustained without overheating, N.
    #[serde(deserialize_with = "or_infinite")]
    pub continuous_force: f64,
    /// Peak torque, N·m.
    #[serde(deserialize_with = "or_infinite")]
    pub peak_torque: f64,
    /// Torque that can be sustained without overheating, N·m.
    #[serde(deserialize_with = "or_infinite")]
    pub continuous_torque: f64,
    /// Largest stiffness that the device renders stably at 1 kHz, N/m.
    #[serde(deserialize_with = "or_infinite")]
    pub stiffness: f64,
    /// Largest angular stiffness that the device renders stably at 1 kHz, N·m/rad.
    #[serde(deserialize_with = "or_infinite")]
    pub angular_stiffness: f64,
    /// Largest virtual damping that the device renders stably together with `stiffness`, N·s/m.
    #[serde(deserialize_with = "or_infinite")]
    pub damping: f64,
    /// Largest virtual angular damping together with `angular_stiffness`, N·m·s/rad.
    #[serde(deserialize_with = "or_infinite")]
    pub angular_damping: f64,
    /// Radius of the workspace around the device's origin, m.
    #[serde(deserialize_with = "or_infinite")]
    pub workspace_radius: f64,
    /// Smallest change of position that is sensed, m; 0 if sensing is not quantised.
    pub encoder_step: f64,
    /// Smallest change of orientation that is sensed, rad.
    pub angular_encoder_step: f64,
    /// Delay of the reported twist behind the handle's motion, s.
    pub velocity_delay: f64,
    /// Time from a motion of the handle to the wrench that answers it, beyond the sampling of the haptic
    /// loop, s: the latency of the connection in both directions. 0 if a wrench takes effect as soon as it
    /// is written. The longer it is, the softer the coupling is chosen and the slower its damper.
    ///
    /// A device reached by messages sends a reading with one message and is answered after the next: its
    /// delay is the time between two messages plus the time in which an answer takes effect. Drivers of
    /// devices that were not measured state that sum for the usual rate of messages. An emulation delays by
    /// whole substeps.
    #[serde(default)]
    pub delay: f64,
    /// Axes whose motion is reported; the others read zero.
    pub sensed: Axes,
    /// Axes along and about which a wrench reaches the hand; other components of a wrench are dropped.
    pub actuated: Axes,
    /// Mechanics of the handle, if known: its damping and friction bound what the device renders passively.
    /// An [`Emulation`](crate::Emulation) moves by its own handle regardless of this one.
    pub handle: Option<Handle>,
}

/// JSON has no infinity, and null stands for it.
pub(crate) fn or_infinite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}
