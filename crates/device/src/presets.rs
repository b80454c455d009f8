//! Emulations of real devices.
//!
//! Peak force, torque, stiffness and workspace are the makers' figures (3D Systems, Force Dimension,
//! Haption). Continuous values, encoder steps, damping ceilings and the mechanics of the handle are typical
//! figures of the class, not measurements of a unit: check them against one before calling it supported.
//! There is no delay: an emulation applies a wrench as soon as it is written, whatever the latency of the
//! real device.

use crate::emulated::Emulation;
use crate::hand::Hand;
use crate::mechanics::Handle;
use crate::specification::{Axes, Specification};

/// Name and a one-line description of each preset.
const PRESETS: [(&str, &str); 6] = [
    ("premium-1.5", "Phantom Premium 1.5 6DOF, 8.5 N and 0.19 N·m (default)"),
    ("premium-3.0", "Phantom Premium 3.0 6DOF, 22 N and 0.19 N·m, half a metre of reach"),
    ("touch", "Touch, 3.3 N, senses six axes and drives three"),
    ("omega", "omega.6, 12 N, stiff, senses six axes and drives three"),
    ("sigma.7", "sigma.7, 20 N and 0.4 N·m"),
    ("virtuose-6d", "Virtuose 6D, 30 N and 3 N·m, arm's reach"),
];

impl Default for Emulation {
    /// The Phantom Premium 1.5 6DOF.
    fn default() -> Self {
        Self::preset("premium-1.5").expect("the default preset is in the list")
    }
}

impl Emulation {
    /// The emulation of a real device: one of [`Emulation::presets`].
    ///
    /// Peak force, torque, stiffness and workspace are the maker's; the rest are typical figures of the
    /// class, not measurements of a unit.
    pub fn preset(name: &str) -> Option<Self> {
        let specification = specification(name)?;
        let handle = specification.handle?;
        Some(Self { specification, handle, hand: Hand::default(), substep: 1e-4, catch_up: 0.1 })
    }

    /// Name and a one-line description of each preset.
    pub fn presets() -> impl Iterator<Item = (&'static str, &'static str)> {
        PRESETS.into_iter()
    }
}

/// Specification of the preset with this name.
fn specification(name: &str) -> Option<Specification> {
    let six = Axes::ALL;
    Some(match name {
        "premium-1.5" => Specification {
            name: "Phantom Premium 1.5 6DOF (emulated)".into(),
            peak_force: 8.5,
            continuous_force: 1.4,
            peak_torque: 0.188,
            continuous_torque: 0.188,
            stiffness: 800.0,
            angular_stiffness: 0.3,
            damping: 2.0,
            angular_damping: 0.002,
            workspace_radius: 0.12,
            encoder_step: 3e-5,
            angular_encoder_step: 1e-4,
            velocity_delay: 3e-3,
            delay: 0.0,
            sensed: six,
            actuated: six,
            handle: Some(Handle {
                mass: 0.075,
                damping: 1.0,
                friction: 0.04,
                inertia: 1e-4,
                angular_damping: 1e-3,
                angular_friction: 1e-3,
            }),
        },
        "premium-3.0" => Specification {
            name: "Phantom Premium 3.0 6DOF (emulated)".into(),
            peak_force: 22.0,
            continuous_force: 3.0,
            peak_torque: 0.188,
            continuous_torque: 0.188,
            stiffness: 1000.0,
            angular_stiffness: 0.3,
            damping: 2.0,
            angular_damping: 0.002,
            workspace_radius: 0.25,
            encoder_step: 2e-5,
            angular_encoder_step: 1e-4,
            velocity_delay: 3e-3,
            delay: 0.0,
            sensed: six,
            actuated: six,
            handle: Some(Handle {
                mass: 0.1,
                damping: 2.0,
                friction: 0.1,
                inertia: 1e-4,
                angular_damping: 1e-3,
                angular_friction: 1e-3,
            }),
        },
        "touch" => Specification {
            name: "Touch (emulated)".into(),
            peak_force: 3.3,
            continuous_force: 0.88,
            peak_torque: 0.0,
            continuous_torque: 0.0,
            stiffness: 400.0,
            angular_stiffness: 0.0,
            damping: 2.0,
            angular_damping: 0.0,
            workspace_radius: 0.075,
            encoder_step: 5.5e-5,
            angular_encoder_step: 1e-3,
            velocity_delay: 3e-3,
            delay: 0.0,
            sensed: six,
            actuated: Axes::TRANSLATION,
            handle: Some(Handle {
                mass: 0.045,
                damping: 0.8,
                friction: 0.1,
                inertia: 3e-5,
                angular_damping: 5e-4,
                angular_friction: 5e-4,
            }),
        },
        "omega" => Specification {
            name: "omega.6 (emulated)".into(),
            peak_force: 12.0,
            continuous_force: 12.0,
            peak_torque: 0.0,
            continuous_torque: 0.0,
            stiffness: 5000.0,
            angular_stiffness: 0.0,
            damping: 5.0,
            angular_damping: 0.0,
            workspace_radius: 0.075,
            encoder_step: 1e-5,
            angular_encoder_step: 1.5e-3,
            velocity_delay: 2e-3,
            delay: 0.0,
            sensed: six,
            actuated: Axes::TRANSLATION,
            handle: Some(Handle {
                mass: 0.1,
                damping: 3.6,
                friction: 0.1,
                inertia: 5e-5,
                angular_damping: 5e-4,
                angular_friction: 5e-4,
            }),
        },
        "sigma.7" => Specification {
            name: "sigma.7 (emulated)".into(),
            peak_force: 20.0,
            continuous_force: 12.0,
            peak_torque: 0.4,
            continuous_torque: 0.2,
            stiffness: 4000.0,
            angular_stiffness: 1.0,
            damping: 5.0,
            angular_damping: 0.005,
            workspace_radius: 0.075,
            encoder_step: 1e-5,
            angular_encoder_step: 2e-4,
            velocity_delay: 2e-3,
            delay: 0.0,
            sensed: six,
            actuated: six,
            handle: Some(Handle {
                mass: 0.1,
                damping: 3.6,
                friction: 0.1,
                inertia: 2e-4,
                angular_damping: 2e-3,
                angular_friction: 2e-3,
            }),
        },
        "virtuose-6d" => Specification {
            name: "Virtuose 6D (emulated)".into(),
            peak_force: 30.0,
            continuous_force: 8.5,
            peak_torque: 3.0,
            continuous_torque: 1.0,
            stiffness: 1500.0,
            angular_stiffness: 30.0,
            damping: 5.0,
            angular_damping: 0.02,
            workspace_radius: 0.45,
            encoder_step: 2e-5,
            angular_encoder_step: 1e-4,
            velocity_delay: 2e-3,
            delay: 0.0,
            sensed: six,
            actuated: six,
            handle: Some(Handle {
                mass: 0.1,
                damping: 3.0,
                friction: 0.1,
                inertia: 1e-3,
                angular_damping: 0.01,
                angular_friction: 5e-3,
            }),
        },
        _ => return None,
    })
}
