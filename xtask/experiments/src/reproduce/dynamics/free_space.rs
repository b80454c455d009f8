//! Light body that follows the device through free space, by integrator and mass (§5.5.2, Fig. 5.6).

use palpate::device::MotionPath;
use palpate::dynamics::IntegratorKind;
use palpate::glam::{DQuat, DVec3};
use palpate::settings::{ContactSearch, CouplingSettings, HandlePlace, SearchSettings, ToolSettings};
use palpate::{Object, Pose, Scene, Settings};

use palpate_tests::smooth;

use super::{ANGULAR_STIFFNESS, COUPLING, COUPLING_STIFFNESS, DEVIATION, angular_damping, most, plot, table};
use crate::progress::each;
use crate::reproduce::outcome::{Finding, Reproduction};
use crate::reproduce::rendering::{open, path};
use crate::stability::grid::{logarithmic, pairs};
use palpate_measure::{Experiment, Trace};

/// Coupling damping, N·s/m: low, so that the spring carries the body. The dissertation does not give it.
const COUPLING_DAMPING: f64 = 1.0;
const SECONDS: f64 = 2.5;
/// Time from which the session's wrench has come up, s.
const START: f64 = 0.25;
/// Masses that are compared, kg: those of Backward Euler, and that of the explicit methods.
const MASSES: [f64; 3] = [1e-3, 0.01, 0.1];

/// Number of masses in the stability search.
const MASS_COUNT: usize = 80;

const METHODS: [(&str, IntegratorKind); 3] = [
    ("Backward Euler", IntegratorKind::SemiImplicit),
    ("Runge-Kutta IV", IntegratorKind::RungeKutta4),
    ("Forward Euler", IntegratorKind::ForwardEuler),
];

/// Results.
#[derive(Clone, Debug)]
pub struct Found {
    /// Smallest mass of each method from which all larger ones were stable, kg; infinite if there is none.
    pub least: [f64; 3],
    /// Largest deviations (m) and forces (N) by Backward Euler with each of [`MASSES`].
    pub deviation: [f64; 3],
    pub force: [f64; 3],
}

impl Found {
    /// Returns whether the results are as claimed.
    pub fn is_as_claimed(&self) -> bool {
        let [backward, runge_kutta, forward] = self.least;
        let [_, light, heavy] = self.deviation;
        backward <= MASSES[0]
            && (0.06..0.08).contains(&runge_kutta)
            && (0.09..0.11).contains(&forward)
            && (5.0..20.0).contains(&(heavy / light))
            && self.force[2] > self.force[1]
    }
}

fn session<'a>(
    (spoon, damping): (&'a Object, f64),
    scene: &'a Scene,
    mass: f64,
    integrator: IntegratorKind,
) -> Experiment<'a> {
    let settings = Settings {
        tool: ToolSettings {
            // The hand's path is that of the mesh's frame.
            handle: HandlePlace::MeshOrigin,
            mass,
            ..ToolSettings::default()
        },
        coupling: CouplingSettings {
            stiffness: Some(COUPLING_STIFFNESS),
            damping: Some(COUPLING_DAMPING),
            angular_stiffness: Some(ANGULAR_STIFFNESS),
            angular_damping: Some(damping),
        },
        search: SearchSettings { method: ContactSearch::Levels, ..SearchSettings::default() },
        ..Settings::default()
    };
    Experiment {
        probe: spoon,
        scene,
        settings,
        integrator,
        contact_rate: 1000.0,
        frozen: false,
        seconds: SECONDS,
    }
}

/// Returns the path of a spoon that is swung with up to 35 m/s².
fn swing() -> Result<MotionPath, String> {
    path(SECONDS + 0.1, |time| {
        let (a, b, c) = (12.0 * time, 17.0 * time, 7.0 * time);
        let begun = smooth(0.0, 0.4, time);
        let place = DVec3::new(0.1 * a.sin(), 0.07 * b.sin(), 0.08 * (c.cos() - 1.0)) * begun;
        Pose::new(
            place,
            DQuat::from_scaled_axis(DVec3::new(0.5 * b.sin(), 0.7 * c.sin(), 0.4 * a.sin()) * begun),
        )
    })
}

/// Runs the sessions, with so many masses in the stability search.
///
/// # Errors
/// If a session cannot be run.
pub fn find(
    name: &str,
    methods: &[(&str, IntegratorKind); 3],
    masses: usize,
) -> Result<(Found, [Trace; 3]), String> {
    let spoon = open("spoon-low")?;
    let damping = angular_damping(&spoon)?;
    let scene = Scene::new();
    let swing = swing()?;
    let masses = logarithmic(5e-4, 0.2, masses);
    let cases = pairs(methods, &masses);
    let stable = each(name, &cases, |((_, integrator), mass)| {
        Ok(session((&spoon, damping), &scene, *mass, *integrator)
            .replay(swing.clone())
            .map_err(|error| error.to_string())?
            .is_stable())
    })?;
    let mut least = [f64::INFINITY; 3];
    for (least, stable) in least.iter_mut().zip(stable.chunks(masses.len())) {
        let unstable = stable.iter().rposition(|stable| !stable);
        *least = masses.get(unstable.map_or(0, |last| last + 1)).copied().unwrap_or(f64::INFINITY);
    }
    let [one, ten, hundred] = MASSES.map(|mass| {
        session((&spoon, damping), &scene, mass, methods[0].1)
            .replay(swing.clone())
            .map_err(|error| error.to_string())
    });
    let traces = [one?, ten?, hundred?];
    let largest = |value| traces.each_ref().map(|trace: &Trace| most(&trace.samples, START..SECONDS, value));
    let found = Found {
        least,
        deviation: largest(|sample| sample.deviation),
        force: largest(|sample| sample.coupling),
    };
    Ok((found, traces))
}

/// Repeats the experiment.
///
/// # Errors
/// If a session cannot be run or drawn.
pub fn reproduce(name: &str) -> Result<Reproduction, String> {
    let (found, traces) = find(name, &METHODS, MASS_COUNT)?;
    let names = MASSES.map(|mass| format!("Backward Euler, {} g", 1e3 * mass));
    let mut sessions: Vec<_> =
        names.iter().map(String::as_str).zip(traces.iter().map(|trace| &*trace.samples)).collect();
    let (spoon, scene) = (open("spoon-low")?, Scene::new());
    let damping = angular_damping(&spoon)?;
    let explicit = [1, 2].map(|method| {
        session((&spoon, damping), &scene, MASSES[2], METHODS[method].1)
            .replay(swing()?)
            .map_err(|error| error.to_string())
    });
    let [runge_kutta, forward] = explicit;
    let (runge_kutta, forward) = (runge_kutta?, forward?);
    sessions.push(("Runge-Kutta IV, 100 g", &runge_kutta.samples));
    sessions.push(("Forward Euler, 100 g", &forward.samples));
    let grams = |mass: f64| format!("{:.2} g", 1e3 * mass);
    let [backward, rk, fe] = found.least.map(grams);
    let listed = |values: [f64; 3], unit: f64| values.map(|value| format!("{:.3}", unit * value)).join(", ");
    Ok(Reproduction {
        finding: Finding {
            claim: "Backward Euler is stable with a mass as small as 1 g, Runge-Kutta IV and Forward Euler only with more than 70 and \
                    100 g; the coupling deviation is about linear in the mass (2 mm at 10 g, 17 mm at 100 g), and the coupling force \
                    grows with it (0.5 N, 3.5 N)."
                .to_owned(),
            measured: format!(
                "Stable from {backward} by Backward Euler (the least tried is 0.5 g), {rk} by Runge-Kutta IV, {fe} by Forward \
                 Euler. Largest deviations by Backward Euler with 1, 10 and 100 g: {} mm, largest forces {} N. Damping is not given: \
                 the linear one is {COUPLING_DAMPING} N·s/m, the angular one such that Forward Euler needs 100 g.",
                listed(found.deviation, 1e3),
                listed(found.force, 1.0)
            ),
            condition: "Backward Euler is stable from 1 g on, Runge-Kutta IV from between 60 and 80 g on and Forward Euler from between 90 \
                        and 110 g on; the deviation at 100 g is 5 to 20 times that at 10 g, and the force \
                        is larger."
                .to_owned(),
            holds: found.is_as_claimed(),
        },
        table: table(name, &sessions),
        timing: None,
        plot: plot("Free space (Fig. 5.6)", &sessions, &[DEVIATION, COUPLING])?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_objects_need_implicit_integration() {
        let (found, _) = find("test", &METHODS, MASS_COUNT).unwrap();
        assert!(found.is_as_claimed(), "{found:?}");
        // Forward Euler in place of Backward Euler.
        let [backward, runge_kutta, forward] = METHODS;
        let (swapped, _) = find("test", &[forward, runge_kutta, backward], MASS_COUNT).unwrap();
        assert!(!swapped.is_as_claimed(), "{swapped:?}");
    }
}
