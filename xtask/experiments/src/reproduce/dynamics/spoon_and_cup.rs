//! Spoon pressed onto a cup, by integrator, mass and contact stiffness (§5.5.3, Fig. 5.8).

use palpate::dynamics::IntegratorKind;
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{
    ContactSearch, ContactSettings, CouplingSettings, HandlePlace, SearchSettings, ToolSettings,
};
use palpate::{Pose, Scene, Settings};
use palpate_tests::first_touch;

use super::{
    ANGULAR_STIFFNESS, CONTACT, COUPLING, COUPLING_STIFFNESS, DEPTH, DEVIATION, angular_damping, most, plot,
    root_mean_square, table,
};
use crate::reproduce::outcome::{Finding, Reproduction};
use crate::reproduce::rendering::{open, path};
use palpate_measure::{Experiment, Trace};

/// Session: name, integrator, mass (kg) and contact stiffness (N/m).
type Setup = (&'static str, IntegratorKind, f64, f64);
const SETUPS: [Setup; 3] = [
    ("Runge-Kutta IV, 100 g, 2 kN/m", IntegratorKind::RungeKutta4, 0.1, 2e3),
    ("Backward Euler, 10 g, 2 kN/m", IntegratorKind::SemiImplicit, 0.01, 2e3),
    ("Backward Euler, 100 g, 10 kN/m", IntegratorKind::SemiImplicit, 0.1, 1e4),
];
/// Times at which the hand starts, has pressed down, has rubbed, and ends, s.
const TIMES: [f64; 4] = [0.2, 0.7, 2.2, 2.5];
/// Depth beyond the touch that the hand aims at, and height from which it comes, m.
const PRESS: f64 = 12e-3;
const ABOVE: f64 = 30e-3;
/// The dissertation's bounds on the depth, m.
const DEPTHS: [f64; 2] = [6e-4, 2e-4];

/// Results with Backward Euler at 10 g, with 100 g and stiffer contact, and with Runge-Kutta IV.
#[derive(Clone, Debug)]
pub struct Found {
    /// Largest depths with 2 kN/m and 10 kN/m by Backward Euler, m.
    pub depth: [f64; 2],
    /// Force at the device in contact over that in free space, root mean squares: with 10 g, and with 100 g
    /// by Runge-Kutta IV.
    pub contrast: [f64; 2],
    /// Largest coupling force with 10 g, N.
    pub force: f64,
    /// Difference of contact and coupling force relative to the latter, root mean squares, with 10 g.
    pub difference: f64,
    pub stable: bool,
}

impl Found {
    fn of([runge_kutta, light, stiff]: &[Trace; 3], free: f64) -> Self {
        let [set_out, pressed, rubbed, _] = TIMES;
        let contrast = |trace: &Trace| {
            let force = |times| root_mean_square(&trace.samples, times, |sample| sample.coupling);
            force(pressed..rubbed) / force(set_out + 0.05..free)
        };
        let whole = 0.0..f64::INFINITY;
        let apart =
            root_mean_square(&light.samples, pressed..rubbed, |sample| sample.contact - sample.coupling);
        Self {
            depth: [light, stiff].map(|trace| most(&trace.samples, whole.clone(), |sample| sample.depth)),
            contrast: [light, runge_kutta].map(contrast),
            force: most(&light.samples, whole.clone(), |sample| sample.coupling),
            difference: apart / root_mean_square(&light.samples, pressed..rubbed, |sample| sample.coupling),
            stable: light.is_stable() && stiff.is_stable(),
        }
    }

    /// Returns whether the results are as claimed.
    pub fn is_as_claimed(&self) -> bool {
        self.stable
            && self.depth.iter().zip(DEPTHS).all(|(depth, limit)| *depth < limit)
            && self.force > 0.5
            && self.contrast[0] > 2.0 * self.contrast[1]
            && self.difference < 0.05
    }
}

/// Runs the three sessions.
///
/// # Errors
/// If a session cannot be run.
fn find(setups: &[Setup; 3]) -> Result<(Found, [Trace; 3]), String> {
    let (spoon, cup) = (open("spoon-low")?, open("cup-low")?);
    let damping = angular_damping(&spoon)?;
    let touch = first_touch(&spoon, &cup);
    let scene = Scene::new().with(cup, Pose::IDENTITY);
    let [set_out, pressed, rubbed, end] = TIMES;
    let between = |from: f64, to: f64, time: f64| palpate_tests::smooth(from, to, time);
    let intended = path(end + 0.1, |time| {
        let down = between(set_out, pressed, time);
        let phase = std::f64::consts::TAU * (time.clamp(pressed, rubbed) - pressed);
        let height = ABOVE - (ABOVE + PRESS) * down;
        let place = touch + DVec3::new(5e-3 * phase.sin(), 0.0, height);
        Pose::new(place, DQuat::from_rotation_z(0.05 * phase.sin()))
    })?;
    let session = |&(_, integrator, mass, contact_stiffness): &Setup| Experiment {
        probe: &spoon,
        scene: &scene,
        settings: Settings {
            tool: ToolSettings {
                // The hand's path is that of the mesh's frame.
                handle: HandlePlace::MeshOrigin,
                mass,
                ..ToolSettings::default()
            },
            contact: ContactSettings::penalties(contact_stiffness),
            coupling: CouplingSettings {
                stiffness: Some(COUPLING_STIFFNESS),
                angular_stiffness: Some(ANGULAR_STIFFNESS),
                angular_damping: Some(damping),
                ..CouplingSettings::default()
            },
            search: SearchSettings {
                tolerance: Some(1e-4),
                method: ContactSearch::Levels,
                ..SearchSettings::default()
            },
            ..Settings::default()
        },
        integrator,
        contact_rate: 1000.0,
        frozen: false,
        seconds: end,
    };
    let recorded = session(&SETUPS[1]).record(intended).map_err(|error| error.to_string())?;
    let [a, b, c] = setups
        .each_ref()
        .map(|setup| session(setup).replay(recorded.clone()).map_err(|error| error.to_string()));
    let traces = [a?, b?, c?];
    // Time before the first touch, in the session that recorded the path.
    let touched =
        traces[1].samples.iter().find(|sample| sample.contact > 0.0).map_or(end, |sample| sample.time);
    Ok((Found::of(&traces, touched), traces))
}

/// Repeats the experiment.
///
/// # Errors
/// If a session cannot be run or drawn.
pub fn reproduce(name: &str) -> Result<Reproduction, String> {
    let (found, traces) = find(&SETUPS)?;
    let sessions: Vec<_> =
        SETUPS.iter().map(|setup| setup.0).zip(traces.iter().map(|trace| &*trace.samples)).collect();
    let Found { depth, contrast, force, difference, .. } = found;
    Ok(Reproduction {
        finding: Finding {
            claim: "The spoon goes less than 0.6 mm deep into the cup with 2 kN/m, and less than 0.2 mm with 10 kN/m, at up to \
                    0.8 N; with 10 g by Backward Euler contact differs clearly from free space, with 100 g by Runge-Kutta IV it does not; \
                    contact and coupling force almost coincide."
                .to_owned(),
            measured: format!(
                "Depth {:.3} mm with 2 kN/m and {:.3} mm with 10 kN/m, at up to {force:.2} N. The force in contact is {:.1} times \
                 that in free space with 10 g, {:.1} times with 100 g by Runge-Kutta IV. Contact and coupling force differ by \
                 {:.2} %. All three are {}: the oscillations of the dissertation's Runge-Kutta IV and 10 kN/m do not occur.",
                1e3 * depth[0],
                1e3 * depth[1],
                contrast[0],
                contrast[1],
                100.0 * difference,
                if traces.iter().all(Trace::is_stable) { "stable" } else { "not stable" },
            ),
            condition: "Backward Euler is stable, with depths below 0.6 and 0.2 mm at more than 0.5 N; the contrast of contact to free \
                        space is more than twice that of Runge-Kutta IV; forces of contact and coupling differ by less than 5 %."
                .to_owned(),
            holds: found.is_as_claimed(),
        },
        table: table(name, &sessions),
        timing: None,
        plot: plot("Spoon and cup (Fig. 5.8)", &sessions, &[DEPTH, DEVIATION, CONTACT, COUPLING])?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_needs_stiffness_and_contrast_needs_a_light_body() {
        let (found, _) = find(&SETUPS).unwrap();
        assert!(found.is_as_claimed(), "{found:?}");
        // Softer contact, and a heavier body.
        let [runge_kutta, light, stiff] = SETUPS;
        let (soft, _) = find(&[runge_kutta, (light.0, light.1, light.2, 200.0), stiff]).unwrap();
        assert!(!soft.is_as_claimed() && soft.depth[0] > DEPTHS[0], "{soft:?}");
        let (heavy, _) = find(&[runge_kutta, (light.0, light.1, 0.1, light.3), stiff]).unwrap();
        assert!(!heavy.is_as_claimed() && heavy.contrast[0] < 2.0 * heavy.contrast[1], "{heavy:?}");
    }
}
