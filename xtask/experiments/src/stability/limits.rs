//! Limits: the stiffest wall that a bare device renders, found by bisection, against what theory says it is.
//!
//! Both conditions are about passivity: any hand, however it moves, is to get no energy out of device and wall. That is the
//! same as stability only where the hand is as bad as can be. For springs a device that no hand holds is bad enough
//! (Colgate and Schenkel with B = 0; Abbott and Okamura, where the push is such that rounding hurts most). With virtual damping
//! the worst is a hand that moves the handle to and fro once in two samples, as straight as it can; the limit is where it gets
//! energy out.

use palpate::device::Hand;

use super::grid::{Plan, pairs};
use super::page::{Section, Table, Verdict, row};
use super::wall::{Motion, Velocity, WallCase};

/// How far a limit may be from theory's.
const WITHIN: f64 = 0.2;
/// Limits are looked for between theory's divided and multiplied by this, in so many halvings: to 1 %.
const RANGE: f64 = 3.0;
const HALVINGS: usize = 8;
/// Parts of the force of an encoder step by which the push is varied.
const PUSHES: usize = 8;
/// A handle that friction holds moves by less than this part of an encoder step; one that goes from step to step, by more.
const REST: f64 = 1e-6;
/// N: so much that the handle stays in the wall; and how long friction may take to bring it to rest, s.
const PUSH: f64 = 20.0;
const LONG: f64 = 8.0;

/// Which condition it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Condition {
    /// b > K T/2, without friction, rounding and virtual damping.
    Spring,
    /// b > K T/2 + B.
    Damped,
    /// K ≤ min(2 b/T, 2 f_c/Δ).
    Rounded,
}

impl Condition {
    const ALL: [Self; 3] = [Self::Spring, Self::Damped, Self::Rounded];

    fn name(self) -> &'static str {
        match self {
            Self::Spring => "Colgate and Schenkel, springs",
            Self::Damped => "Colgate and Schenkel, springs with dampers",
            Self::Rounded => "Abbott and Okamura",
        }
    }

    /// The stiffest wall that it allows, N/m.
    fn stiffest(self, case: &WallCase) -> f64 {
        let wall = case.sampled();
        let held = 2.0 * (wall.device_damping - wall.damping) / wall.period;
        if self == Self::Rounded { held.min(2.0 * wall.friction / wall.quantum) } else { held }
    }

    fn holds(self, case: &WallCase) -> Result<bool, String> {
        match self {
            Self::Spring => Ok(case.run()?.outcome.is_stable()),
            Self::Damped => Ok(case.shaken()? <= 0.0),
            Self::Rounded => {
                let step = case.stiffness * case.quantum / PUSHES as f64;
                for part in 0..PUSHES {
                    let pushed = WallCase { push: case.push + part as f64 * step, ..*case };
                    if pushed.run()?.amplitude > REST * case.quantum {
                        return Ok(false);
                    }
                }
                Ok(true)
            }
        }
    }

    /// The stiffest wall that holds, N/m, with all softer ones that were tried.
    fn measured(self, case: &WallCase) -> Result<f64, String> {
        let theory = self.stiffest(case);
        let (mut low, mut high) = (theory / RANGE, theory * RANGE);
        for _ in 0..HALVINGS {
            let stiffness = (low * high).sqrt();
            if self.holds(&WallCase { stiffness, ..*case })? { low = stiffness } else { high = stiffness }
        }
        Ok((low * high).sqrt())
    }

    /// The device without a hand, by rate and damping, and by virtual damping or encoder step.
    fn cases(self, plan: &Plan) -> Vec<WallCase> {
        let bare = WallCase {
            hand: ("none", Hand::NONE),
            push: PUSH,
            quantum: 0.0,
            friction: false,
            velocity: Velocity::BackwardDifference,
            ..WallCase::base(Motion::Translation)
        };
        let periods = plan.choose(&[2e-4, 5e-4, 1e-3, 2e-3], &[5e-4, 1e-3]);
        let dampings = plan.choose(&[0.5, 1.0, 2.0], &[1.0]);
        let rates = pairs(&periods, &dampings);
        let with = |period, device_damping| WallCase { period, device_damping, ..bare };
        match self {
            Self::Spring => rates.into_iter().map(|(period, b)| with(period, b)).collect(),
            Self::Damped => {
                let parts = plan.choose(&[0.0, 0.2, 0.4, 0.6, 0.8], &[0.5]);
                let cases = pairs(&rates, &parts).into_iter();
                cases.map(|((period, b), part)| WallCase { damping: part * b, ..with(period, b) }).collect()
            }
            Self::Rounded => {
                let quanta = plan.choose(&[1e-5, 3e-5, 1e-4], &[3e-5]);
                let cases = pairs(&rates, &quanta).into_iter();
                cases
                    .map(|((period, b), quantum)| WallCase {
                        quantum,
                        friction: true,
                        duration: LONG,
                        ..with(period, b)
                    })
                    .collect()
            }
        }
    }
}

/// Makes the map.
///
/// # Errors
/// If a case cannot be simulated.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let cases: Vec<(Condition, WallCase)> = Condition::ALL
        .into_iter()
        .flat_map(|condition| condition.cases(plan).into_iter().map(move |case| (condition, case)))
        .collect();
    let measured = plan.each("limits", &cases, |(condition, case)| condition.measured(case))?;
    let ratio =
        |(condition, case): &(Condition, WallCase), measured: f64| measured / condition.stiffest(case);
    let rows = cases.iter().zip(&measured).map(|(of, &found)| {
        let (condition, case) = of;
        let WallCase { period, device_damping, damping, quantum, .. } = *case;
        row![
            condition.name(),
            period,
            device_damping,
            damping,
            quantum,
            condition.stiffest(case),
            found,
            ratio(of, found)
        ]
    });
    let verdicts = Condition::ALL.into_iter().map(|condition| {
        let of_it = cases.iter().zip(&measured).filter(|((of, _), _)| *of == condition);
        let ratios: Vec<f64> = of_it.map(|(of, &found)| ratio(of, found)).collect();
        let beyond = ratios.iter().filter(|ratio| (**ratio - 1.0).abs() > WITHIN).count();
        let (least, most) =
            ratios.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), &r| (low.min(r), high.max(r)));
        Verdict::new(
            format!("the stiffest wall is within 20 % of the limit of {}", condition.name()),
            !ratios.is_empty() && beyond == 0,
            format!("{beyond} of {} are not; {least:.3} to {most:.3} of it", ratios.len()),
        )
    });
    Ok(Section {
        title: "Limits: the stiffest wall against theory",
        paragraphs: vec![
            "The handle of a premium-1.5 that no hand holds meets a wall, by sampling rate, damping of the device, virtual damping \
             and encoder step. For springs a steady push of 20 N leans on the wall; where positions are rounded it is varied in \
             eight parts of an encoder step's force, and stable is what friction brings to rest, whatever the push. With virtual \
             damping a hand moves the handle by 1 mm to and fro behind the wall's surface, once in two samples, and the limit is \
             where it gets energy out of device and wall together. Each limit is found by bisection, to 1 %."
                .to_owned(),
        ],
        pictures: Vec::new(),
        tables: vec![Table {
            name: "limits".to_owned(),
            columns: vec![
                "condition",
                "period_s",
                "device_damping_ns_m",
                "damping_ns_m",
                "encoder_step_m",
                "limit_n_m",
                "measured_n_m",
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
        assert_eq!(section.verdicts.len(), 3);
        for verdict in &section.verdicts {
            assert!(verdict.holds, "{verdict:?}");
        }
    }
}
