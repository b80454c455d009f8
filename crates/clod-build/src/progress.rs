//! Progress reports of a build, and its cancellation.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

/// Shortest time between two calls of the callback within a stage.
const INTERVAL: Duration = Duration::from_millis(40);

/// A stage of a build, for its progress callback.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stage {
    /// Checking and indexing the mesh.
    Mesh,
    /// Surface convex decomposition (§3.3.1).
    Decomposition,
    /// Sensation preserving simplification (§3.3.3), where it is asked for.
    Simplification,
    /// Merging patches up to the root (§3.3.3).
    Hierarchy,
    /// Error metric parameters (§3.3.5).
    Parameters,
}

impl Stage {
    /// Fraction of the whole build that is done, from 0 to 1, when a fraction of this stage is: for progress
    /// bars with an estimate. Stages are weighted with their share of the time for the models of Table 3.2,
    /// with simplification.
    pub fn of_build(self, fraction: f64) -> f64 {
        let (begin, end) = match self {
            Self::Mesh => (0.0, 0.01),
            Self::Decomposition => (0.01, 0.1),
            Self::Simplification => (0.1, 0.9),
            Self::Hierarchy => (0.9, 0.91),
            Self::Parameters => (0.91, 1.0),
        };
        begin + (end - begin) * fraction.clamp(0.0, 1.0)
    }
}

impl std::fmt::Display for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Mesh => "mesh",
            Self::Decomposition => "convex decomposition",
            Self::Simplification => "simplification",
            Self::Hierarchy => "hierarchy",
            Self::Parameters => "parameters",
        })
    }
}

/// A progress callback that does nothing.
pub fn unwatched(_: Stage, _: f64) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// The callback cancelled the build.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cancelled;

/// Calls the callback, at intervals of at least [`INTERVAL`].
pub(crate) struct Progress<'a> {
    callback: &'a mut dyn FnMut(Stage, f64) -> ControlFlow<()>,
    stage: Stage,
    /// Largest fraction of the stage that was reported done.
    done: f64,
    last: Instant,
    muted: bool,
}

impl<'a> Progress<'a> {
    /// Progress at the beginning of a build.
    pub fn new(callback: &'a mut dyn FnMut(Stage, f64) -> ControlFlow<()>) -> Self {
        Self { callback, stage: Stage::Mesh, done: 0.0, last: Instant::now(), muted: false }
    }

    /// Begins a stage.
    pub fn begin(&mut self, stage: Stage) -> Result<(), Cancelled> {
        self.stage = stage;
        self.done = 0.0;
        self.report(0.0)
    }

    /// Reports that a fraction of the stage is done. May be called often: most calls return at once.
    pub fn at(&mut self, done: f64) -> Result<(), Cancelled> {
        if self.muted || self.last.elapsed() < INTERVAL { Ok(()) } else { self.report(done) }
    }

    /// Ends the stage.
    pub fn end(&mut self) -> Result<(), Cancelled> {
        self.report(1.0)
    }

    /// A progress that reports nothing, for a short part of a stage.
    pub fn muted(&mut self) -> Progress<'_> {
        Progress { callback: self.callback, muted: true, ..*self }
    }

    fn report(&mut self, done: f64) -> Result<(), Cancelled> {
        self.last = Instant::now();
        // A stage may repeat a part of its work; the reported progress does not go back.
        self.done = done.max(self.done).min(1.0);
        match (self.callback)(self.stage, self.done) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Cancelled),
        }
    }
}

impl From<Cancelled> for crate::BuildError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BuildOptions, build};

    #[test]
    fn progress_of_a_build_never_goes_back() {
        let mesh = palpate_models::Model::Torus.generate(2000).expect("in range");
        let mut done = vec![0.0];
        let watch = &mut |stage: Stage, fraction| {
            done.push(stage.of_build(fraction));
            ControlFlow::Continue(())
        };
        build(&mesh, &BuildOptions::default(), watch).expect("a good mesh");
        assert!(done.is_sorted() && done.last() == Some(&1.0), "{done:?}");
    }
}
