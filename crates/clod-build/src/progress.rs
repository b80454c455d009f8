//! What a build tells of its progress, and how it is told to stop.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

/// How long the callback is left alone between two calls within a stage.
const INTERVAL: Duration = Duration::from_millis(40);

/// What a build is doing, for its progress callback.
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
    /// How much of a whole build is done, from 0 to 1, when a fraction of this stage is: for progress bars with an estimate. Stages
    /// count by their share of the time for the models of Table 3.2, with simplification.
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

/// The progress callback of a build that nobody watches.
pub fn unwatched(_: Stage, _: f64) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// The callback broke the build off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cancelled;

/// Calls the callback, and not too often.
pub(crate) struct Progress<'a> {
    callback: &'a mut dyn FnMut(Stage, f64) -> ControlFlow<()>,
    stage: Stage,
    /// The most of the stage that was reported done.
    done: f64,
    last: Instant,
    muted: bool,
}

impl<'a> Progress<'a> {
    /// At the beginning of a build.
    pub fn new(callback: &'a mut dyn FnMut(Stage, f64) -> ControlFlow<()>) -> Self {
        Self { callback, stage: Stage::Mesh, done: 0.0, last: Instant::now(), muted: false }
    }

    /// A stage begins.
    pub fn begin(&mut self, stage: Stage) -> Result<(), Cancelled> {
        self.stage = stage;
        self.done = 0.0;
        self.tell(0.0)
    }

    /// A fraction of the stage is done. To be called as often as it is convenient.
    pub fn at(&mut self, done: f64) -> Result<(), Cancelled> {
        if self.muted || self.last.elapsed() < INTERVAL { Ok(()) } else { self.tell(done) }
    }

    /// The stage is done.
    pub fn end(&mut self) -> Result<(), Cancelled> {
        self.tell(1.0)
    }

    /// Says nothing, for a short part of a stage.
    pub fn muted(&mut self) -> Progress<'_> {
        Progress { callback: self.callback, muted: true, ..*self }
    }

    fn tell(&mut self, done: f64) -> Result<(), Cancelled> {
        self.last = Instant::now();
        // A stage that begins a part of it anew has lost nothing for those who watch.
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
