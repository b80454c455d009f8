//! The choice of an integrator by name.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::{ForwardEuler, FullyImplicit, QuasiStatic, RungeKutta4, SymplecticEuler};
use crate::body::BodyState;
use crate::integrators::{Integrator, SemiImplicit};
use crate::step::{Frame, Step};

/// The integrators, each with its default settings.
///
/// | integrator | order | stiff springs and light bodies |
/// |---|---|---|
/// | [`SemiImplicit`] | 1 | stable; one linear system for each change of contacts |
/// | [`FullyImplicit`] | 1 | stable; some linear systems more |
/// | [`ForwardEuler`] | 1 | diverges: a mode of rate b/m needs dt b/m < 2 |
/// | [`SymplecticEuler`] | 1 | diverges: later than forward Euler without damping, as early with much |
/// | [`RungeKutta4`] | 4 while no contact opens or closes | diverges: dt b/m < 2.785 |
/// | [`QuasiStatic`] | no dynamics | nothing to diverge; the body has no mass |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IntegratorKind {
    /// [`SemiImplicit`]: `semi-implicit`.
    #[default]
    SemiImplicit,
    /// [`FullyImplicit`]: `fully-implicit`.
    FullyImplicit,
    /// [`ForwardEuler`]: `forward-euler`.
    ForwardEuler,
    /// [`SymplecticEuler`]: `symplectic-euler`.
    SymplecticEuler,
    /// [`RungeKutta4`]: `runge-kutta-4`.
    #[serde(rename = "runge-kutta-4")]
    RungeKutta4,
    /// [`QuasiStatic`]: `quasi-static`.
    QuasiStatic,
}

impl IntegratorKind {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::SemiImplicit,
        Self::FullyImplicit,
        Self::ForwardEuler,
        Self::SymplecticEuler,
        Self::RungeKutta4,
        Self::QuasiStatic,
    ];
}

impl Integrator for IntegratorKind {
    fn name(&self) -> &'static str {
        match self {
            Self::SemiImplicit => SemiImplicit.name(),
            Self::FullyImplicit => FullyImplicit::default().name(),
            Self::ForwardEuler => ForwardEuler.name(),
            Self::SymplecticEuler => SymplecticEuler.name(),
            Self::RungeKutta4 => RungeKutta4.name(),
            Self::QuasiStatic => QuasiStatic::default().name(),
        }
    }

    fn step(&self, frame: &Frame<'_>, state: &BodyState, dt: f64) -> Step {
        match self {
            Self::SemiImplicit => SemiImplicit.step(frame, state, dt),
            Self::FullyImplicit => FullyImplicit::default().step(frame, state, dt),
            Self::ForwardEuler => ForwardEuler.step(frame, state, dt),
            Self::SymplecticEuler => SymplecticEuler.step(frame, state, dt),
            Self::RungeKutta4 => RungeKutta4.step(frame, state, dt),
            Self::QuasiStatic => QuasiStatic::default().step(frame, state, dt),
        }
    }
}

impl fmt::Display for IntegratorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A name that is no integrator's.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "there is no integrator \"{name}\"; give semi-implicit, fully-implicit, forward-euler, symplectic-euler, \
     runge-kutta-4 or quasi-static"
)]
pub struct UnknownIntegrator {
    /// The name given.
    pub name: String,
}

impl FromStr for IntegratorKind {
    type Err = UnknownIntegrator;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let found = Self::ALL.into_iter().find(|kind| kind.name() == name);
        found.ok_or_else(|| UnknownIntegrator { name: name.to_owned() })
    }
}
