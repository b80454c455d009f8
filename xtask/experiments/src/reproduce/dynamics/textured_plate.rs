//! Probe with a round tip on a plate with ridges 8 mm high, moved to the right and faster back (§5.5.4, Fig.
//! 5.12).

use palpate::dynamics::IntegratorKind;
use palpate::glam::DVec3;
use palpate::settings::{
    ContactSearch, ContactSettings, CouplingSettings, HandlePlace, SearchSettings, TextureSettings,
    ToolSettings,
};
use palpate::{Pose, Scene, Settings};
use palpate_tests::{ridged_plate, smooth};

use super::{COUPLING, DEPTH, plot, table};
use crate::reproduce::outcome::{Finding, Reproduction};
use crate::reproduce::rendering::{open, path};
use palpate_measure::{Experiment, Sample, Trace, mean};

/// Height of the ridges and their distance, m. The dissertation does not give the distance.
const HEIGHT: f64 = 8e-3;
const SPACING: f64 = 0.04;
/// Radius of the probe's tip; depth beyond the flat plate that the hand aims at; displacement to either side,
/// m.
const TIP: f64 = 0.01;
const PRESS: f64 = 0.01;
const STROKE: f64 = 0.12;
/// Times at which the hand begins to press, to move, to move back, and ends, s.
const TIMES: [f64; 4] = [0.5, 1.5, 5.0, 6.75];
/// Rate of the contact loop, Hz; that of the dissertation was slightly higher.
const CONTACT_RATE: f64 = 500.0;

/// Results while the probe moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Standard deviations of the coupling force to the right and back, N: on ridges, and on the flat plate.
    pub ridged: [f64; 2],
    pub flat: [f64; 2],
    /// Force peaks on the ridges, to the right and back.
    pub peaks: [usize; 2],
    /// Deepest penetration on ridges, m.
    pub depth: f64,
    pub stable: bool,
}

impl Found {
    fn of([ridged, flat]: &[Trace; 2]) -> Self {
        let [_, moving, back, end] = TIMES;
        let spans = [moving..back, back..end - 0.1];
        let forces = |trace: &Trace, times: &std::ops::Range<f64>| -> Vec<f64> {
            let within = |sample: &&Sample| times.contains(&sample.time);
            trace.samples.iter().filter(within).map(|sample| sample.coupling).collect()
        };
        let spread = |trace: &Trace| spans.each_ref().map(|span| deviation(&forces(trace, span)));
        Self {
            ridged: spread(ridged),
            flat: spread(flat),
            peaks: spans.each_ref().map(|span| peaks(&forces(ridged, span))),
            depth: ridged.samples.iter().map(|sample| sample.depth).fold(0.0, f64::max),
            stable: ridged.is_stable() && flat.is_stable(),
        }
    }

    /// Returns whether the results are as claimed.
    pub fn is_as_claimed(&self) -> bool {
        let ridges = 2.0 * STROKE / SPACING;
        let counted = |peaks: &usize| (*peaks as f64 - ridges).abs() <= 1.0;
        self.stable
            && self.ridged.iter().zip(self.flat).all(|(ridged, flat)| *ridged > 10.0 * flat && *ridged > 0.05)
            && self.peaks.iter().all(counted)
            && self.depth < 0.25 * HEIGHT
    }
}

fn deviation(values: &[f64]) -> f64 {
    let center = mean(values.iter().copied());
    mean(values.iter().map(|value| (value - center).powi(2))).sqrt()
}

/// Counts how often values rise from half a standard deviation below their mean to half of one above it.
fn peaks(values: &[f64]) -> usize {
    let (mean, deviation) = (mean(values.iter().copied()), deviation(values));
    let (mut count, mut low) = (0, false);
    for value in values {
        if *value < mean - 0.5 * deviation {
            low = true;
        } else if low && *value > mean + 0.5 * deviation {
            count += 1;
            low = false;
        }
    }
    count
}

/// Runs the sessions on ridges of a height (m) and on the flat plate.
fn find(height: f64) -> Result<(Found, [Trace; 2]), String> {
    let (stylus, flat) = (open("stylus")?, Scene::new().with(open("plate")?, Pose::IDENTITY));
    let ridges = if height > 0.0 {
        Scene::new().with(ridged_plate(height, SPACING), Pose::IDENTITY)
    } else {
        flat.clone()
    };
    let [begun, moving, back, end] = TIMES;
    let intended = path(end + 0.2, |time| {
        let along = STROKE * (2.0 * (smooth(moving, back, time) - smooth(back, end, time)) - 1.0);
        let above = TIP + 0.5 * HEIGHT + 0.002;
        let height = above - (above - TIP + PRESS) * smooth(begun, moving, time);
        Pose::from_translation(DVec3::new(along, 0.003, height))
    })?;
    let session = |scene| Experiment {
        probe: &stylus,
        scene,
        settings: Settings {
            tool: ToolSettings {
                // The hand's path is that of the mesh's frame.
                handle: HandlePlace::MeshOrigin,
                mass: 0.01,
                ..ToolSettings::default()
            },
            contact: ContactSettings { stiffness: 2000.0, ..ContactSettings::default() },
            coupling: CouplingSettings {
                stiffness: Some(200.0),
                angular_stiffness: Some(3.0),
                ..CouplingSettings::default()
            },
            search: SearchSettings {
                tolerance: Some(2e-4),
                method: ContactSearch::Levels,
                ..SearchSettings::default()
            },
            textures: TextureSettings { ..TextureSettings::default() },
            ..Settings::default()
        },
        integrator: IntegratorKind::default(),
        contact_rate: CONTACT_RATE,
        frozen: false,
        seconds: end,
    };
    // Both plates get the same trajectory.
    let rendered = |scene| session(scene).replay(intended.clone()).map_err(|error| error.to_string());
    let traces = [rendered(&ridges)?, rendered(&flat)?];
    Ok((Found::of(&traces), traces))
}

/// Repeats the experiment.
///
/// # Errors
/// If a session cannot be run or drawn.
pub fn reproduce(name: &str) -> Result<Reproduction, String> {
    let (found, traces) = find(HEIGHT)?;
    let sessions = [("textured plate", &*traces[0].samples), ("flat plate", &*traces[1].samples)];
    let listed = |values: [f64; 2]| values.map(|value| format!("{value:.3}")).join(" and ");
    Ok(Reproduction {
        finding: Finding {
            claim: "On the textured plate penetration depth and feedback force oscillate with the ridges, on the flat one they do not, and \
                    the interaction is stable with contacts found 400 times a second."
                .to_owned(),
            measured: format!(
                "To the right and faster back, the force's standard deviation is {} N on ridges and {} N on the flat plate; it has {} \
                 and {} peaks where {} ridges are passed. Depth on ridges up to {:.2} mm. Both are {}.",
                listed(found.ridged),
                listed(found.flat),
                found.peaks[0],
                found.peaks[1],
                2.0 * STROKE / SPACING,
                1e3 * found.depth,
                if found.stable { "stable" } else { "not stable" }
            ),
            condition: format!(
                "Both are stable; the force varies by more than 0.05 N and ten times as much as on the flat plate, with as many peaks as \
                 ridges, give or take one; depth stays below {} mm; contacts are found {CONTACT_RATE} times a second.",
                250.0 * HEIGHT
            ),
            holds: found.is_as_claimed(),
        },
        table: table(name, &sessions),
        timing: None,
        plot: plot("Textured plate (Fig. 5.12)", &sessions, &[DEPTH, COUPLING])?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[ignore = "for a release build: cargo test --release -p palpate-experiments -- --ignored"]
    fn ridges_make_the_force_oscillate_at_length() {
        let (found, _) = find(HEIGHT).unwrap();
        assert!(found.is_as_claimed(), "{found:?}");
        let (flat, _) = find(0.0).unwrap();
        assert!(!flat.is_as_claimed(), "{flat:?}");
    }
}
