//! Sweeps of texture spacing while one quantity is varied.

use palpate_report::{LogAxis, LogPlot, draw_log_log};

use super::curve::Curve;
use super::depth::{HEIGHT, Profile, Sampling};
use super::hand::{Hand, Stroke, Vibration, vibration};
use crate::progress::each;
use crate::reproduce::outcome::{Finding, Reproduction};
use crate::stability::grid::{logarithmic, pairs};
use crate::stability::page::{Table, row};

/// Probe and its motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Diameter D, m.
    pub diameter: f64,
    pub stroke: Stroke,
}

/// Setups that differ in one quantity, and the claim about their curves.
#[derive(Clone, Debug)]
pub struct Study {
    pub title: &'static str,
    /// Name of the quantity that differs.
    pub varied: &'static str,
    pub setups: Vec<Setup>,
    /// Returns the setup's value of that quantity, with its unit.
    pub value: fn(&Setup) -> String,
    pub claim: &'static str,
    /// Condition that [`Self::judge`] checks, in words.
    pub condition: &'static str,
    /// Returns whether the setups' curves are as claimed.
    pub judge: fn(&[Curve]) -> bool,
    /// Further evidence on the claim, as a sentence.
    pub detail: fn(&[Curve]) -> String,
}

/// Resolution of the spacings and of the sampled depths.
#[derive(Clone, Debug)]
pub struct Sweep {
    /// Distances between ridges, with evenly spaced logarithms, m.
    pub spacing: Vec<f64>,
    pub sampling: Sampling,
}

impl Sweep {
    /// Returns a sweep from 0.5 to 8 mm.
    pub fn new(count: usize, sampling: Sampling) -> Self {
        Self { spacing: logarithmic(0.5e-3, 8e-3, count), sampling }
    }
}

/// Motions of one hand: for each setup, one for each spacing.
#[derive(Clone, Debug)]
pub struct Swept {
    pub vibrations: Vec<Vibration>,
    pub curves: Vec<Curve>,
}

impl Study {
    /// Simulates each hand's motions.
    ///
    /// # Errors
    /// If a depth cannot be found.
    pub fn run(&self, name: &str, sweep: &Sweep, hands: &[Hand]) -> Result<Vec<Swept>, String> {
        let mut diameters: Vec<f64> = self.setups.iter().map(|setup| setup.diameter).collect();
        diameters.dedup();
        let surfaces = pairs(&diameters, &sweep.spacing);
        let profiles = each(&format!("{name} depth"), &surfaces, |(diameter, spacing)| {
            Profile::new(*diameter, *spacing, &sweep.sampling)
        })?;
        let profile = |setup: &Setup, spacing: usize| {
            let diameter = diameters.iter().position(|diameter| *diameter == setup.diameter);
            profiles.get(diameter.unwrap_or(0) * sweep.spacing.len() + spacing).ok_or("no such profile")
        };
        let places: Vec<usize> = (0..sweep.spacing.len()).collect();
        let cases = pairs(hands, &pairs(&self.setups, &places));
        let vibrations = each(&format!("{name} motion"), &cases, |(hand, (setup, spacing))| {
            Ok(vibration(hand, &setup.stroke, profile(setup, *spacing)?))
        })?;
        let of_hand = vibrations.chunks(self.setups.len() * sweep.spacing.len());
        Ok(of_hand.map(|vibrations| Swept::new(vibrations, &sweep.spacing)).collect())
    }
}

impl Swept {
    fn new(vibrations: &[Vibration], spacing: &[f64]) -> Self {
        let curves = vibrations.chunks(spacing.len()).map(|vibrations| Curve {
            spacing: spacing.to_vec(),
            acceleration: vibrations.iter().map(|vibration| vibration.acceleration).collect(),
        });
        Self { vibrations: vibrations.to_vec(), curves: curves.collect() }
    }
}

/// Number of spacings in a sweep, and resolution of the depths.
const SPACINGS: usize = 25;
const SAMPLING: Sampling = Sampling { positions: 160, grid: 192 };

/// Reproduces a study at full resolution.
///
/// # Errors
/// If it cannot be simulated or drawn.
pub fn reproduce(study: &Study, name: &str) -> Result<Reproduction, String> {
    let hands = [&[Hand::REFERENCE][..], &Hand::corners()].concat();
    let sweep = Sweep::new(SPACINGS, SAMPLING);
    let swept = study.run(name, &sweep, &hands)?;
    let [reference, corners @ ..] = swept.as_slice() else { return Err("no hand".to_owned()) };
    let holds = (study.judge)(&reference.curves);
    let agree: Vec<Hand> = hands[1..]
        .iter()
        .zip(corners)
        .filter(|(_, swept)| (study.judge)(&swept.curves))
        .map(|(hand, _)| *hand)
        .collect();
    Ok(Reproduction {
        finding: Finding {
            claim: study.claim.to_owned(),
            measured: measured(study, reference, &agree),
            condition: study.condition.to_owned(),
            holds,
        },
        table: table(study, name, &sweep, &hands, &swept),
        timing: None,
        plot: plot(study, reference)?,
    })
}

/// Describes the maxima, the further evidence, and which other hands agree.
fn measured(study: &Study, swept: &Swept, agree: &[Hand]) -> String {
    let maxima = study.setups.iter().zip(&swept.curves).map(|(setup, curve)| {
        let (at, top) = curve.peak();
        format!("{}: {top:.2} m/s² at {:.2} mm", (study.value)(setup), 1e3 * at)
    });
    let maxima: Vec<String> = maxima.collect();
    let other = swept.vibrations.iter().filter(|vibration| !vibration.periodic).count();
    let agree: Vec<String> = agree
        .iter()
        .map(|Hand { mass, stiffness, damping }| format!("{mass} kg {stiffness} N/m {damping} N·s/m"))
        .collect();
    let Hand { mass, stiffness, damping } = Hand::REFERENCE;
    format!(
        "Maxima by {}: {}. {} {other} of {} motions do not repeat with the texture. Ridges of {} mm; a hand of {mass} kg, \
         {stiffness} N/m, {damping} N·s/m. The condition is met by {} of the 8 hands at the corners of the ranges as well{}",
        study.varied,
        maxima.join("; "),
        (study.detail)(&swept.curves),
        swept.vibrations.len(),
        1e3 * HEIGHT,
        agree.len(),
        if agree.is_empty() || agree.len() == 8 {
            ".".to_owned()
        } else {
            format!(": {}.", agree.join(", "))
        },
    )
}

fn table(study: &Study, name: &str, sweep: &Sweep, hands: &[Hand], swept: &[Swept]) -> Table {
    let setups = pairs(&study.setups, &sweep.spacing);
    let rows = hands.iter().zip(swept).flat_map(|(hand, swept)| {
        setups.iter().zip(&swept.vibrations).map(|((setup, spacing), vibration)| {
            let Setup { diameter, stroke: Stroke { force, speed } } = setup;
            let Hand { mass, stiffness, damping } = hand;
            row![
                mass,
                stiffness,
                damping,
                diameter,
                force,
                speed,
                spacing,
                vibration.acceleration,
                vibration.periodic
            ]
        })
    });
    let columns = [
        "hand_mass_kg",
        "hand_stiffness_n_m",
        "hand_damping_ns_m",
        "diameter_m",
        "force_n",
        "speed_m_s",
        "spacing_m",
        "acceleration_m_s2",
        "periodic",
    ];
    Table { name: name.to_owned(), columns: columns.to_vec(), rows: rows.collect() }
}

fn plot(study: &Study, swept: &Swept) -> Result<String, String> {
    let curves = study.setups.iter().zip(&swept.curves).map(|(setup, curve)| palpate_report::Curve {
        name: (study.value)(setup),
        points: curve.spacing.iter().map(|at| 1e3 * at).zip(curve.acceleration.iter().copied()).collect(),
    });
    let plot = LogPlot {
        title: study.title.to_owned(),
        x: LogAxis { name: "texture spacing, mm".to_owned(), marks: vec![0.5, 1.0, 2.0, 4.0, 8.0] },
        y: LogAxis {
            name: "largest acceleration, m/s²".to_owned(),
            marks: vec![0.2, 0.5, 1.0, 2.0, 5.0, 10.0],
        },
        curves: curves.collect(),
        scattered: Vec::new(),
    };
    draw_log_log(&plot).map_err(|error| error.to_string())
}
