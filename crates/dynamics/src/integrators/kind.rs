//! The choice of an integrator by name.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::body::BodyState;
use crate::integrators::{
    ForwardEuler, FullyImplicit, Integrator, QuasiStatic, RungeKutta4, SemiImplicit, SymplecticEuler,
};
use crate::step::{Frame, Step};

/// The integrators, each with its default settings.
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

    /// The name, as [`FromStr`] takes it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SemiImplicit => "semi-implicit",
            Self::FullyImplicit => "fully-implicit",
            Self::ForwardEuler => "forward-euler",
            Self::SymplecticEuler => "symplectic-euler",
            Self::RungeKutta4 => "runge-kutta-4",
            Self::QuasiStatic => "quasi-static",
        }
    }
}

impl Integrator for IntegratorKind {
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
