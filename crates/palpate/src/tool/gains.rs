//! Gains of a session: those that the settings give, and the others chosen for the tool and the device.

use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_device::{GripperSpecification, Specification};
use palpate_dynamics::{
    Body, ContactParameters, Friction, PortAxes, PortLimits, Sampling, SlewLimit, VirtualCoupling,
};

use crate::scene::placement::HandlePlacement;
use crate::settings::{
    ContactSettings, CouplingSettings, OutputSettings, SLEW_TIME, SearchSettings, Settings, SettingsError,
    ToolSettings,
};

/// Properties of a tool that its gains depend on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grasped {
    /// The whole tool as one body, in the first body's axes.
    pub whole: Body,
    /// Centre of mass of the whole tool relative to that of the first body, m.
    pub center: DVec3,
    /// Centre of mass of the first body in its mesh's frame, m.
    pub first_center: DVec3,
    /// Smallest bounding radius of the tool's bodies, m.
    pub radius: f64,
}

/// Gains of a session.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gains {
    /// Frame that the coupling holds, in the first mesh's frame.
    pub grasp: Pose,
    pub placement: HandlePlacement,
    pub coupling: VirtualCoupling,
    /// Limits of the device's port, at the device.
    pub limits: PortLimits,
    /// Lags of velocity and angular velocity for the coupling's dampers, s; 0 for the device's own.
    pub velocity_lags: (f64, f64),
    pub contacts: ContactParameters,
    pub slew: SlewLimit,
    /// Largest damping of the passivity controller, N·s/m and N·m·s/rad at the device; 0 where it is off.
    pub max_damping: (f64, f64),
}

impl Gains {
    /// Chooses the gains for a tool and a device.
    ///
    /// # Errors
    /// If a setting is out of range.
    pub fn new(
        settings: &Settings,
        grasped: &Grasped,
        specification: &Specification,
    ) -> Result<Self, SettingsError> {
        settings.check()?;
        let Grasped { whole, center, first_center, radius } = grasped;
        if let Some(value) = settings.search.tolerance.filter(|tolerance| tolerance > radius) {
            let expected = "metres, at most the bounding radius of the grasped object";
            return Err(SettingsError { name: "tolerance", value, expected });
        }
        let grasp = settings.tool.grasp.unwrap_or(Pose::from_translation(*first_center));
        let in_first = Pose::from_translation(-*first_center) * grasp;
        let about_center = Pose::new(in_first.translation - *center, in_first.rotation);
        let placement = HandlePlacement::at(settings, grasp.translation, specification);
        let limits =
            port_limits(specification, 1.0 / settings.timing.rate).with_lever(placement.lever(&grasp));
        let (coupling, critical) = couplings(settings, whole, about_center, &limits);
        let velocity_lags = velocity_lags(settings, (&coupling, &critical), &limits);
        let coupling = VirtualCoupling { grasp: in_first, ..coupling };
        let contacts = ContactParameters {
            stiffness: settings.contact.stiffness,
            damping: settings
                .contact
                .damping
                .unwrap_or(2.0 * (settings.contact.stiffness * whole.mass).sqrt()),
            tolerance: settings.search.tolerance.unwrap_or_else(|| default_tolerance(settings, *radius)),
            friction: Friction {
                static_coefficient: settings.contact.static_friction.unwrap_or(settings.contact.friction),
                dynamic_coefficient: settings.contact.friction,
            },
        };
        Ok(Self {
            grasp,
            placement,
            coupling,
            limits,
            velocity_lags,
            contacts,
            slew: slew(settings, &limits),
            max_damping: max_damping(settings, &coupling, &limits),
        })
    }

    /// Fills in the settings that are `None` with the gains chosen here.
    pub fn fill_in(&self, settings: &Settings) -> Settings {
        let Self { grasp, coupling, contacts, slew, .. } = *self;
        Settings {
            contact: ContactSettings {
                damping: Some(contacts.damping),
                static_friction: Some(contacts.friction.static_coefficient),
                ..settings.contact
            },
            coupling: CouplingSettings {
                stiffness: Some(coupling.linear_stiffness),
                damping: Some(coupling.linear_damping),
                angular_stiffness: Some(coupling.angular_stiffness),
                angular_damping: Some(coupling.angular_damping),
            },
            search: SearchSettings { tolerance: Some(contacts.tolerance), ..settings.search },
            tool: ToolSettings { grasp: Some(grasp), ..settings.tool },
            output: OutputSettings {
                force_slew: Some(slew.force),
                torque_slew: Some(slew.torque),
                ..settings.output
            },
            ..*settings
        }
    }
}

/// Limits of the device's port by its specification, sampled every `period` seconds.
fn port_limits(specification: &Specification, period: f64) -> PortLimits {
    let handle = specification.handle.as_ref();
    // Axes without an actuator render nothing.
    let driven = |axes: [bool; 3], peak: f64| if axes.contains(&true) { peak } else { 0.0 };
    PortLimits {
        translation: PortAxes {
            stiffness: specification.stiffness,
            damping: specification.damping,
            viscous: handle.map(|handle| handle.damping),
            friction: handle.map(|handle| handle.friction),
            peak: driven(specification.actuated.translation, specification.peak_force),
            step: specification.encoder_step,
        },
        rotation: PortAxes {
            stiffness: specification.angular_stiffness,
            damping: specification.angular_damping,
            viscous: handle.map(|handle| handle.angular_damping),
            friction: handle.map(|handle| handle.angular_friction),
            peak: driven(specification.actuated.rotation, specification.peak_torque),
            step: specification.angular_encoder_step,
        },
        lever: 0.0,
        sampling: Sampling {
            period,
            delay: specification.delay,
            velocity_delay: specification.velocity_delay,
        },
    }
}

/// Limits of a gripper's port by its specification.
pub(crate) fn gripper_port(specification: &GripperSpecification) -> PortAxes {
    PortAxes {
        stiffness: specification.stiffness,
        damping: specification.damping,
        viscous: specification.handle.map(|handle| handle.damping),
        friction: specification.handle.map(|handle| handle.friction),
        peak: specification.peak_torque,
        step: specification.encoder_step,
    }
}

/// Largest default of the distance tolerance, m at the device: 1 % of a bounding radius of 0.2 m, about the
/// largest object that a hand wields. Surfaces push from this distance on; with a larger tolerance, large
/// objects, and those read in a wrong unit, would feel cushioned before they visibly touch.
const MAX_DEFAULT_TOLERANCE: f64 = 2e-3;

/// Default distance tolerance d, m: 1 % of the bounding radius, at most [`MAX_DEFAULT_TOLERANCE`] at the
/// device.
fn default_tolerance(settings: &Settings, radius: f64) -> f64 {
    (0.01 * radius).min(MAX_DEFAULT_TOLERANCE * settings.device.workspace_scale)
}

/// Coupling with the gains that the settings give, and the others chosen for the body and the device; and the
/// same with critical damping where none is given.
fn couplings(
    settings: &Settings,
    body: &Body,
    grasp: Pose,
    limits: &PortLimits,
) -> (VirtualCoupling, VirtualCoupling) {
    let limits = limits.in_world(settings.device.workspace_scale);
    let chosen = VirtualCoupling::auto(body, grasp, &limits);
    let linear = settings.coupling.stiffness.unwrap_or(chosen.linear_stiffness);
    let angular = settings.coupling.angular_stiffness.unwrap_or(chosen.angular_stiffness);
    let critical = VirtualCoupling::critically_damped(body, grasp, linear, angular).limited_to(&limits);
    let given = |coupling: VirtualCoupling| VirtualCoupling {
        linear_damping: settings.coupling.damping.unwrap_or(coupling.linear_damping),
        angular_damping: settings.coupling.angular_damping.unwrap_or(coupling.angular_damping),
        ..coupling
    };
    let default = critical.damped_within(&limits);
    let coupling = given(default);
    // Gains that were filled in by a session make the same one again.
    (coupling, if coupling == default { critical } else { given(critical) })
}

/// Lags (s) of the device's velocities for the dampers: those that passivity needs. Where motion is estimated
/// between encoder steps, velocities are differences of the estimates, whose lag is no less than that of the
/// device's own.
fn velocity_lags(
    settings: &Settings,
    (coupling, critical): (&VirtualCoupling, &VirtualCoupling),
    limits: &PortLimits,
) -> (f64, f64) {
    let (linear, angular) = limits.in_world(settings.device.workspace_scale).long_lags(coupling, critical);
    let estimated = |axes: &PortAxes, lag: f64| {
        if axes.step > 0.0 && axes.peak > 0.0 { lag.max(limits.sampling.velocity_delay) } else { lag }
    };
    let lags = (estimated(&limits.translation, linear), estimated(&limits.rotation, angular));
    // Equal lags at a lever stay equal.
    if limits.lever > 0.0 && linear == angular {
        let longest = lags.0.max(lags.1);
        return (longest, longest);
    }
    lags
}

/// Largest rate of change of the wrench at the device.
fn slew(settings: &Settings, limits: &PortLimits) -> SlewLimit {
    SlewLimit {
        force: settings.output.force_slew.unwrap_or(limits.translation.peak / SLEW_TIME),
        torque: settings.output.torque_slew.unwrap_or(limits.rotation.peak / SLEW_TIME),
    }
}

/// Largest damping (N·s/m, N·m·s/rad) that the passivity controller may add at the device: the damping that
/// is passive there beside the coupling's springs; 0 while the controller is off.
fn max_damping(settings: &Settings, coupling: &VirtualCoupling, limits: &PortLimits) -> (f64, f64) {
    if !settings.output.passivity_controller {
        return (0.0, 0.0);
    }
    let scale = settings.device.workspace_scale;
    let (linear, angular) = limits.in_world(scale).largest_dampings(coupling);
    (linear, angular / (scale * scale))
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DMat3;
    use palpate_device::Emulation;

    use super::*;

    /// Settings that a session filled in make the same gains again, and those of heavy objects lag longer
    /// than their damping needs.
    #[test]
    fn gains_that_were_filled_in_stay() {
        let specification = Emulation::default().specification;
        for mass in [1e-3, 0.1, 1.0, 10.0] {
            let whole = Body::new(mass, DMat3::from_diagonal(DVec3::splat(mass * 4e-4))).expect("a body");
            let grasped = Grasped { whole, center: DVec3::ZERO, first_center: DVec3::ZERO, radius: 0.03 };
            let settings =
                Settings { tool: ToolSettings { mass, ..ToolSettings::default() }, ..Settings::default() };
            let first = Gains::new(&settings, &grasped, &specification).expect("gains");
            let again = Gains::new(&first.fill_in(&settings), &grasped, &specification).expect("gains");
            assert_eq!(
                (first.coupling, first.velocity_lags),
                (again.coupling, again.velocity_lags),
                "{mass} kg"
            );
            let needed = first.limits.velocity_lags(&first.coupling).0.max(specification.velocity_delay);
            assert_eq!(
                first.velocity_lags.0 > 1.5 * needed,
                mass > 0.5,
                "{mass} kg: {:?}",
                first.velocity_lags
            );
        }
    }
}
