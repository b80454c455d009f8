//! What is left of a session when it has ended.

use std::collections::BTreeMap;

use palpate_device::Specification;
use serde::Serialize;

use crate::object::Object;
use crate::renderer::HapticRenderer;
use crate::settings::Settings;
use crate::telemetry::{ContactTelemetry, Events, HapticTelemetry, Percentiles};

/// Which clock a session ran by.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Clock {
    /// Real time; says how the haptic thread was scheduled.
    Real {
        /// The scheduling class obtained, and why no better one.
        scheduling: String,
    },
    /// Simulated time.
    Simulated,
}

/// An ended session.
#[derive(Clone, Debug)]
pub struct Session {
    /// How long it lasted, s.
    pub seconds: f64,
    /// Which clock it ran by.
    pub clock: Clock,
    /// What the haptic loop measured.
    pub haptic: HapticTelemetry,
    /// What the contact loop measured.
    pub contact: ContactTelemetry,
    /// Which stages the scene switched on or off, and why.
    pub stages: BTreeMap<&'static str, String>,
}

/// The machine-readable summary of a session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Duration, s.
    pub seconds: f64,
    /// The haptic loop.
    pub haptic: HapticSummary,
    /// The contact loop.
    pub contact: ContactSummary,
    /// Deepest penetration, m.
    pub depth_max: f64,
    /// Largest coupling force, N.
    pub coupling_force_max: f64,
    /// Smallest energy absorbed at the device port, J.
    pub energy_min_j: f64,
    /// Energy that the passivity controller took out, J.
    pub dissipated_j: f64,
    /// Which stages ran, and why.
    pub stages: BTreeMap<&'static str, String>,
    /// Counts of events.
    pub events: Events,
}

/// The haptic loop in a [`Summary`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HapticSummary {
    /// Steps a second, Hz.
    pub rate_hz: f64,
    /// Steps.
    pub steps: u64,
    /// Periods skipped.
    pub missed_deadlines: u64,
    /// Duration of a step, ns.
    pub step_ns: Percentiles,
    /// Lateness of the wake-up, µs.
    pub wake_us: Percentiles,
    /// How the thread was scheduled; `lockstep` on a simulated clock.
    pub scheduling: String,
}

/// The contact loop in a [`Summary`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ContactSummary {
    /// Queries a second, Hz.
    pub rate_hz: f64,
    /// Duration of a query with clustering and linearisation, µs.
    pub query_us: Percentiles,
}

impl Session {
    /// Closes the device and keeps what was measured.
    pub(crate) fn close(mut renderer: HapticRenderer, seconds: f64, clock: Clock) -> Self {
        let stages = renderer.stages();
        if renderer.device.close().is_err() {
            renderer.haptic.telemetry_mut().events.device_refused += 1;
        }
        let haptic = renderer.haptic.telemetry().clone();
        let contact = renderer.contact.telemetry().clone();
        #[cfg(feature = "tracing")]
        tracing::info!(
            seconds,
            steps = haptic.steps,
            missed_deadlines = haptic.missed_deadlines,
            contact_steps = contact.query.count(),
            depth_max = haptic.depth_max,
            "session ended"
        );
        Self { seconds, clock, haptic, contact, stages }
    }

    /// The machine-readable summary.
    pub fn summary(&self) -> Summary {
        let (haptic, contact) = (&self.haptic, &self.contact);
        let rate = |count: u64| if self.seconds > 0.0 { count as f64 / self.seconds } else { 0.0 };
        let scheduling = match &self.clock {
            Clock::Real { scheduling } => scheduling.clone(),
            Clock::Simulated => "lockstep".to_owned(),
        };
        Summary {
            seconds: self.seconds,
            haptic: HapticSummary {
                rate_hz: rate(haptic.steps),
                steps: haptic.steps,
                missed_deadlines: haptic.missed_deadlines,
                step_ns: haptic.step.percentiles(1.0),
                wake_us: haptic.wake.percentiles(1000.0),
                scheduling,
            },
            contact: ContactSummary {
                rate_hz: rate(contact.query.count()),
                query_us: contact.query.percentiles(1000.0),
            },
            depth_max: haptic.depth_max,
            coupling_force_max: haptic.coupling_force_max,
            energy_min_j: haptic.energy_min,
            dissipated_j: haptic.dissipated,
            stages: self.stages.clone(),
            events: haptic.events.and(&contact.events),
        }
    }
}

impl HapticRenderer {
    /// Which stages of the pipeline the scene and the settings need, and why.
    pub fn stages(&self) -> BTreeMap<&'static str, String> {
        let settings = self.settings();
        let query = match self.scene().objects().len() {
            0 => "off: the scene is empty".to_owned(),
            1 => "on: one scene object".to_owned(),
            n => format!("on: {n} scene objects"),
        };
        let watched =
            if self.contact.is_watched() { "on: contacts are shown" } else { "off: nobody looks on" };
        BTreeMap::from([
            ("braking", on_or_off(settings.braking)),
            ("clustering", format!("on beyond {} contacts", settings.clusters)),
            ("contact query", query),
            ("device", self.device_stage()),
            ("friction", self.friction_stage()),
            ("hierarchy", self.hierarchy_stage()),
            ("integrator", settings.integrator.to_string()),
            ("interpolation between levels", self.interpolation_stage()),
            ("passivity controller", on_or_off(settings.passivity_controller)),
            ("proxy", on_or_off(settings.proxy)),
            ("textures", self.texture_stage()),
            ("time-critical queries", self.budget_stage()),
            ("watch", watched.to_owned()),
        ])
    }

    /// The objects with their roles, the probe first.
    fn objects(&self) -> impl Iterator<Item = (&'static str, &Object)> {
        let scene = self.scene().objects().iter().map(|placed| ("scene", &placed.object));
        std::iter::once(("probe", self.probe())).chain(scene)
    }

    fn hierarchy_stage(&self) -> String {
        let objects: Vec<String> = self
            .objects()
            .map(|(role, Object { name, clod, .. })| match clod.leaves().len() {
                1 => format!("{role} {name}: off, one convex hull"),
                leaves => {
                    format!("{role} {name}: on, {leaves} convex patches in {} levels", clod.levels.len())
                }
            })
            .collect();
        objects.join("; ")
    }

    fn budget_stage(&self) -> String {
        match self.settings().query_budget {
            None => "off: no limit is set".to_owned(),
            Some(seconds) => format!("on: at most {} µs each", 1e6 * seconds),
        }
    }

    fn interpolation_stage(&self) -> String {
        match self.contact.error() {
            error if error > 0.0 && !self.settings().interpolation => {
                format!("off, as asked for: detail is left out up to {error} m")
            }
            error if error > 0.0 => format!("on: detail is left out up to {error} m"),
            _ if self.settings().error > 0.0 => "off: every object is one convex hull".to_owned(),
            _ => "off: full resolution is asked for".to_owned(),
        }
    }

    fn friction_stage(&self) -> String {
        let Settings { friction, static_friction, .. } = *self.settings();
        match static_friction.filter(|at_rest| *at_rest != friction) {
            Some(at_rest) => format!("on: coefficient {friction}, at rest {at_rest}"),
            None if friction == 0.0 => "off: its coefficient is 0".to_owned(),
            None => format!("on: coefficient {friction}"),
        }
    }

    fn texture_stage(&self) -> String {
        let Some(backend) = self.contact.texture_backend() else {
            return "off: no object has a haptic texture".to_owned();
        };
        let textured = self.objects().filter(|(_, object)| object.texture().is_some());
        let textured: Vec<String> =
            textured.map(|(role, object)| format!("{role} {}", object.name)).collect();
        format!("on, computed by {backend}: {}", textured.join(", "))
    }

    /// What of a wrench the device makes felt, and which of the handle's motions it senses.
    fn device_stage(&self) -> String {
        let Specification { name, actuated, sensed, .. } = self.device.specification();
        let felt = match (named(actuated.translation), named(actuated.rotation)) {
            (None, None) => "off: no force, the device only moves".to_owned(),
            (Some(force), None) => format!("on: force along {force}, no torque"),
            (None, Some(torque)) => format!("on: torque about {torque}, no force"),
            (Some(force), Some(torque)) => format!("on: force along {force}, torque about {torque}"),
        };
        let unsensed = match (named(sensed.translation.map(|it| !it)), named(sensed.rotation.map(|it| !it))) {
            (None, None) => String::new(),
            (Some(shift), None) => format!("; no motion along {shift} is sensed"),
            (None, Some(turn)) => format!("; no turn about {turn} is sensed"),
            (Some(shift), Some(turn)) => {
                format!("; no motion along {shift} and no turn about {turn} is sensed")
            }
        };
        format!("{name}: {felt}{unsensed}")
    }
}

/// Of a stage that a setting switches.
fn on_or_off(on: bool) -> String {
    if on { "on: by its setting" } else { "off: by its setting" }.to_owned()
}

/// The names of the axes that are set.
fn named(axes: [bool; 3]) -> Option<String> {
    let names: Vec<&str> =
        ["x", "y", "z"].into_iter().zip(axes).filter(|&(_, set)| set).map(|(name, _)| name).collect();
    (!names.is_empty()).then(|| names.join(", "))
}
