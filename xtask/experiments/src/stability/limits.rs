//! Stiffest wall that a bare device renders, found by bisection, compared with theory.
//!
//! The conditions are about passivity: no hand, however it moves, may extract energy from device and wall.
//! That equals stability only for the worst hand. For springs, a device that no hand holds is the worst case
//! (Colgate and Schenkel with B = 0; Diolaiti and others with a delay; Abbott and Okamura, with the force
//! under which rounding is worst). With virtual damping, the worst hand moves the handle to and fro at the
//! frequency that needs the most damping; the limit is where it extracts energy.

use palpate::device::Hand;

use super::grid::{Plan, pairs};
use super::levered::LeverCase;
use super::page::{Section, Table, Verdict, row};
use super::wall::{Motion, Velocity, WallCase};

/// Largest relative deviation of a limit from theory.
const MAX_DEVIATION: f64 = 0.1;
/// Factor below and above theory between which a limit is searched, and number of bisections, which resolve 1
/// %.
const SEARCH_FACTOR: f64 = 3.0;
const HALVINGS: usize = 8;
/// Number of pushing forces, evenly spaced between the forces of two successive encoder steps.
const PUSHES: usize = 8;
/// Amplitude, in encoder steps, below which friction holds a handle. One that jumps between steps moves by
/// more.
const MAX_REST_AMPLITUDE: f64 = 1e-6;
/// Disturbance of a handle, relative to its depth in the wall.
const DISTURBANCE: f64 = 0.2;
/// Depth to which the handle is pushed into a wall with rounded positions, m: so large that friction does
/// little of the braking. Time that it has to come to rest, s.
const DEPTH: f64 = 0.02;
const REST_TIME: f64 = 8.0;
/// Lagged damper: its damping in units of the device's, and its lag in units of T/2 + t_d.
const LAGGED: (f64, f64) = (5.0, 10.0);

/// Conditions from theory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Condition {
    /// b > K (T/2 + t_d), without friction, rounding and virtual damping.
    Spring,
    /// General condition, with a virtual damper on differences of position, possibly with a lag.
    Damped,
    /// K ≤ min(2 b/T, 2 f_c/Δ).
    Rounded,
    /// b_θ > (k_θ + k_c ℓ²) (T/2 + t_d) for a handle that a hand keeps from moving.
    Lever,
    /// The same together with that of translation.
    FreeLever,
}

/// Case whose limit is searched.
#[derive(Clone, Copy, Debug)]
enum Case {
    Wall(WallCase),
    Lever(LeverCase),
}

impl Case {
    fn with(self, stiffness: f64) -> Self {
        match self {
            Self::Wall(case) => Self::Wall(WallCase { stiffness, ..case }),
            Self::Lever(case) => Self::Lever(LeverCase { stiffness, ..case }),
        }
    }
}

impl Condition {
    const ALL: [Self; 5] = [Self::Spring, Self::Damped, Self::Rounded, Self::Lever, Self::FreeLever];

    fn name(self) -> &'static str {
        match self {
            Self::Spring => "Colgate and Schenkel with a delay, springs",
            Self::Damped => "Colgate and Schenkel with a delay, springs with dampers",
            Self::Rounded => "Abbott and Okamura",
            Self::Lever => "rotation with a lever",
            Self::FreeLever => "translation and rotation with a lever",
        }
    }

    /// Returns the stiffest wall that the condition allows, N/m; for a lever, N·m/rad.
    fn stiffest(self, case: &Case) -> f64 {
        let wall = match case {
            Case::Lever(case) => return case.stiffest(),
            Case::Wall(case) => case.sampled(),
        };
        match self {
            Self::Damped => wall.stiffest_passive(),
            Self::Rounded => wall.stiffest_without_hand().min(2.0 * wall.friction / wall.quantum),
            Self::Spring | Self::Lever | Self::FreeLever => wall.stiffest_without_hand(),
        }
    }

    fn holds(self, case: &Case) -> Result<bool, String> {
        let case = match case {
            Case::Lever(case) => return case.settles(),
            Case::Wall(case) => case,
        };
        match self {
            Self::Damped => Ok(case.shaken()? <= 0.0),
            Self::Rounded => comes_to_rest(case),
            Self::Spring | Self::Lever | Self::FreeLever => case.swing_dies_away(DISTURBANCE),
        }
    }

    /// Measures the stiffest wall that is stable, assuming that softer ones are.
    fn measured(self, case: &Case) -> Result<f64, String> {
        let theory = self.stiffest(case);
        let (mut low, mut high) = (theory / SEARCH_FACTOR, theory * SEARCH_FACTOR);
        for _ in 0..HALVINGS {
            let stiffness = (low * high).sqrt();
            if self.holds(&case.with(stiffness))? { low = stiffness } else { high = stiffness }
        }
        Ok((low * high).sqrt())
    }

    fn cases(self, plan: &Plan) -> Vec<Case> {
        let delays = plan.choose(&[0.0, 1e-3, 2e-3, 5e-3], &[0.0, 2e-3]);
        match self {
            Self::Spring => {
                let cases = pairs(&Motion::ALL, &pairs(&delays, &devices(plan))).into_iter();
                cases
                    .map(|(motion, (delay, device))| WallCase { delay, ..bare(motion, device) })
                    .map(Case::Wall)
                    .collect()
            }
            Self::Damped => damped(plan, &delays),
            Self::Rounded => {
                let quanta = plan.choose(&[1e-5, 3e-5, 1e-4], &[3e-5]);
                let cases = pairs(&devices(plan), &quanta).into_iter();
                let rounded = |(device, quantum)| WallCase {
                    quantum,
                    friction: true,
                    duration: REST_TIME,
                    ..bare(Motion::Translation, device)
                };
                cases.map(rounded).map(Case::Wall).collect()
            }
            Self::Lever | Self::FreeLever => {
                let levers = plan.choose(&[0.0, 0.05, 0.1, 0.2], &[0.0, 0.1]);
                let cases = pairs(&pairs(&levers, &delays), &devices(plan)).into_iter();
                let held = self == Self::Lever;
                let case = |((lever, delay), (period, device_damping))| LeverCase {
                    lever,
                    held,
                    period,
                    delay,
                    device_damping,
                    stiffness: f64::NAN,
                };
                cases.map(case).map(Case::Lever).collect()
            }
        }
    }

    /// Returns the map's row for a case.
    fn row(self, case: &Case, found: f64) -> Vec<String> {
        let limit = self.stiffest(case);
        let (motion, wall, lever) = match case {
            Case::Wall(wall) => (wall.motion.word(), wall.sampled(), 0.0),
            Case::Lever(case) => (Motion::Rotation.word(), case.sampled(), case.lever),
        };
        row![
            self.name(),
            motion,
            wall.period,
            wall.delay,
            lever,
            wall.device_damping,
            wall.damping,
            wall.lag,
            wall.quantum,
            limit,
            found,
            found / limit
        ]
    }
}

/// Returns pairs of a sampling period and a device damping.
fn devices(plan: &Plan) -> Vec<(f64, f64)> {
    let periods = plan.choose(&[2e-4, 5e-4, 1e-3, 2e-3], &[5e-4, 1e-3]);
    pairs(&periods, &plan.choose(&[0.5, 1.0, 2.0], &[1.0]))
}

/// Returns a device without a hand, with a sampling period (s) and damping.
fn bare(motion: Motion, (period, device_damping): (f64, f64)) -> WallCase {
    WallCase {
        hand: ("none", Hand::NONE),
        quantum: 0.0,
        friction: false,
        velocity: Velocity::BackwardDifference,
        period,
        device_damping,
        ..WallCase::base(motion)
    }
}

/// Returns cases with dampers below the device's damping, and with a much larger one that lags.
fn damped(plan: &Plan, delays: &[f64]) -> Vec<Case> {
    let parts = plan.choose(&[0.0, 0.2, 0.4, 0.6, 0.8], &[0.5]);
    let mut cases = Vec::new();
    for (motion, (delay, device)) in pairs(&Motion::ALL, &pairs(delays, &devices(plan))) {
        let bare = WallCase { delay, ..bare(motion, device) };
        let (times, lags) = LAGGED;
        let velocity = Velocity::Lagged(lags * (0.5 * bare.period + delay));
        cases.extend(parts.iter().map(|part| WallCase { damping: part * bare.device_damping, ..bare }));
        cases.push(WallCase { damping: times * bare.device_damping, velocity, ..bare });
    }
    cases.into_iter().map(Case::Wall).collect()
}

/// Returns whether friction brings the handle to rest in a wall, whatever force pushes it.
fn comes_to_rest(case: &WallCase) -> Result<bool, String> {
    for part in 0..PUSHES {
        let pushed = case.pushed(DEPTH, part as f64 / PUSHES as f64);
        if pushed.run()?.amplitude > MAX_REST_AMPLITUDE * case.quantum {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Makes the map.
///
/// # Errors
/// If a case cannot be simulated.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let cases: Vec<(Condition, Case)> = Condition::ALL
        .into_iter()
        .flat_map(|condition| condition.cases(plan).into_iter().map(move |case| (condition, case)))
        .collect();
    let measured = plan.each("limits", &cases, |(condition, case)| condition.measured(case))?;
    let rows = cases.iter().zip(&measured).map(|((condition, case), &found)| condition.row(case, found));
    let verdicts = Condition::ALL.into_iter().map(|condition| {
        let of_it = cases.iter().zip(&measured).filter(|((of, _), _)| *of == condition);
        let ratios: Vec<f64> = of_it.map(|((_, case), &found)| found / condition.stiffest(case)).collect();
        let beyond = ratios.iter().filter(|ratio| (**ratio - 1.0).abs() > MAX_DEVIATION).count();
        let (least, most) =
            ratios.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), &r| (low.min(r), high.max(r)));
        Verdict::new(
            format!("the stiffest wall is within 10 % of the limit of {}", condition.name()),
            !ratios.is_empty() && beyond == 0,
            format!("{beyond} of {} are not; {least:.3} to {most:.3} of it", ratios.len()),
        )
    });
    Ok(Section {
        title: "Limits: the stiffest wall against theory",
        paragraphs: vec![
            "The handle of a premium-1.5 that no hand holds meets a wall, by sampling rate, delay, damping of the device, virtual damping \
             with its lag, and encoder step, in translation and in rotation (as at the lever arm of its inertia). For springs a steady \
             push of 1 N leans on the wall, and stable is where a disturbance dies away. Where positions are rounded the \
             handle is pushed 20 mm deep, varied in eight parts of an encoder step's force, and stable is what friction brings to rest, whatever the push. With virtual \
             damping a hand moves the handle by 0.1 mm to and fro behind the wall's surface at the frequency that asks most of the \
             device, and the limit is where it gets energy out of device and wall together. With a lever it is the engine's coupling to \
             a body that stands still, grasped away from the handle, and the limit is that of k_θ + k_c ℓ², of which each is half: once \
             for a handle that is kept from moving, once for one that moves as well. Each limit is found by bisection, to 1 %."
                .to_owned(),
        ],
        pictures: Vec::new(),
        tables: vec![Table {
            name: "limits".to_owned(),
            columns: vec![
                "condition",
                "motion",
                "period_s",
                "delay_s",
                "lever_m",
                "device_damping_ns_m",
                "damping_ns_m",
                "lag_s",
                "encoder_step_m",
                "limit",
                "measured",
                "ratio",
            ],
            rows: rows.collect(),
        }],
        verdicts: verdicts.collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_emulated_device_has_the_limits_of_theory() {
        let section = map(&Plan { quick: true, steps: 0, scans: Vec::new() }).unwrap();
        assert_eq!(section.verdicts.len(), 5);
        for verdict in &section.verdicts {
            assert!(verdict.holds, "{verdict:?}");
        }
    }
}
