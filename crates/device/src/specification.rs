//! What a device is and what it can do.

use serde::{Deserialize, Deserializer, Serialize};

use crate::mechanics::Handle;

/// Which of the six axes something holds for: x, y, z of translation and of rotation, in the device's axes.
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

    /// How many axes it holds for.
    pub fn count(&self) -> usize {
        self.translation.iter().chain(&self.rotation).filter(|&&axis| axis).count()
    }
}

/// What a device is and what it can do. A limit that the device does not set is infinite (`null` in JSON); an
/// ability that it lacks is zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Specification {
    /// Make and model.
    pub name: String,
    /// Largest force for a moment, N; a longer one is clipped to it.
    #[serde(deserialize_with = "or_infinite")]
    pub peak_force: f64,
    /// Force that can be kept up without overheating, N.
    #[serde(deserialize_with = "or_infinite")]
    pub continuous_force: f64,
    /// Largest torque for a moment, N·m.
    #[serde(deserialize_with = "or_infinite")]
    pub peak_torque: f64,
    /// Torque that can be kept up without overheating, N·m.
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
    /// Smallest change of position that is sensed, m; 0 when sensing is not quantised.
    pub encoder_step: f64,
    /// Smallest change of orientation that is sensed, rad.
    pub angular_encoder_step: f64,
    /// How far the reported twist lags behind the handle, s.
    pub velocity_delay: f64,
    /// Time from a motion of the handle to the wrench that answers it, beyond the sampling of the haptic loop, s: what the way
    /// to the device and back takes. 0 where the wrench is there as soon as it is written. The coupling is chosen the softer
    /// and its damper the slower for it. A device that is reached by messages sends what it has read with one, and is answered
    /// after the next: its delay is the time between two of them and that in which an answer takes effect. Drivers of devices
    /// that were not measured state that sum for the usual rate of messages; an emulation keeps to it in whole substeps.
    #[serde(default)]
    pub delay: f64,
    /// The axes whose motion is reported; the others read zero.
    pub sensed: Axes,
    /// The axes along and about which a wrench reaches the hand; other components of a wrench are dropped.
    pub actuated: Axes,
    /// What the handle resists motion with, where that is known: its damping and friction bound what the device
    /// renders passively. An [`Emulation`](crate::Emulation) moves by its own handle, whatever stands here.
    pub handle: Option<Handle>,
}

/// JSON has no infinity, and null stands for it.
fn or_infinite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}
