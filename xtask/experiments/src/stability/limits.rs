//! Limits: the stiffest wall that a bare device renders, found by bisection, against what theory says it is.
//!
//! The conditions are about passivity: any hand, however it moves, is to get no energy out of device and wall. That is the
//! same as stability only where the hand is as bad as can be. For springs a device that no hand holds is bad enough
//! (Colgate and Schenkel with B = 0; Diolaiti and others with a delay; Abbott and Okamura, where the push is such that rounding
//! hurts most). With virtual damping the worst is a hand that moves the handle to and fro at the frequency at which the device
//! needs most damping, as straight as it can; the limit is where it gets energy out.

use palpate::device::Hand;

use super::grid::{Plan, pairs};
use super::levered::LeverCase;
use super::page::{Section, Table, Verdict, row};
use super::wall::{Motion, Velocity, WallCase};

/// How far a limit may be from theory's.
const WITHIN: f64 = 0.1;
/// Limits are looked for between theory's divided and multiplied by this, in so many halvings: to 1 %.
const RANGE: f64 = 3.0;
const HALVINGS: usize = 8;
/// Parts of the force of an encoder step by which the push is varied, of which one is between two steps.
const PUSHES: usize = 8;
/// A handle that friction holds moves by less than this part of an encoder step; one that goes from step to step, by more.
const REST: f64 = 1e-6;
/// By what part of its depth in the wall a handle is disturbed.
const DISTURBED: f64 = 0.2;
/// How deep the handle is pushed into a wall where positions are rounded, m: so deep that friction is little of what brakes
/// it. How long it may take to come to rest, s.
const DEPTH: f64 = 0.02;
const LONG: f64 = 8.0;
/// A lagged damper, in the device's damping, and its lag in T/2 + t_d.
const LAGGED: (f64, f64) = (5.0, 10.0);

/// Which condition it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Condition {
    /// b > K (T/2 + t_d), without friction, rounding and virtual damping.
    Spring,
    /// The general one, with a virtual damper on differences of position, or on these through a lag.
    Damped,
    /// K ≤ min(2 b/T, 2 f_c/Δ).
    Rounded,
    /// b_θ > (k_θ + k_c ℓ²) (T/2 + t_d) for a handle that a hand keeps from moving.
    Lever,
    /// The same together with translation's.
    FreeLever,
}

/// What a limit is looked for of.
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

    /// The stiffest wall that it allows, N/m; of a lever, N·m/rad.
    fn stiffest(self, case: &Case) -> f64 {
        let wall = match case {
            Case::Lever(case) => return case.stiffest(),
            Case::Wall(case) => case.sampled(),
        };
        match self {
            Self::Damped => wall.stiffest_passive(),
            Self::Rounded => wall.stiffest_let_go().min(2.0 * wall.friction / wall.quantum),
            Self::Spring | Self::Lever | Self::FreeLever => wall.stiffest_let_go(),
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
            Self::Spring | Self::Lever | Self::FreeLever => case.swing_dies_away(DISTURBED),
        }
    }

    /// The stiffest wall that holds, with all softer ones that were tried.
    fn measured(self, case: &Case) -> Result<f64, String> {
        let theory = self.stiffest(case);
        let (mut low, mut high) = (theory / RANGE, theory * RANGE);
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
                    duration: LONG,
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

    /// The map's row of a case.
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

/// Rates with dampings of the device.
fn devices(plan: &Plan) -> Vec<(f64, f64)> {
    let periods = plan.choose(&[2e-4, 5e-4, 1e-3, 2e-3], &[5e-4, 1e-3]);
    pairs(&periods, &plan.choose(&[0.5, 1.0, 2.0], &[1.0]))
}

/// A device without a hand, sampled every so many seconds and of such a damping.
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

/// Dampers of parts of the device's damping, and one that is much more of it and lags.
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

/// Whether friction brings the handle to rest in a wall, whatever it is pushed with.
fn comes_to_rest(case: &WallCase) -> Result<bool, String> {
    for part in 0..PUSHES {
        let pushed = case.pushed(DEPTH, part as f64 / PUSHES as f64);
        if pushed.run()?.amplitude > REST * case.quantum {
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
        let beyond = ratios.iter().filter(|ratio| (**ratio - 1.0).abs() > WITHIN).count();
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
        let section = map(&Plan { quick: true, steps: 0 }).unwrap();
        assert_eq!(section.verdicts.len(), 5);
        for verdict in &section.verdicts {
            assert!(verdict.holds, "{verdict:?}");
        }
    }
}
