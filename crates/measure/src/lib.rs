//! What settings of the haptic rendering engine cost, and what accuracy they buy.
//!
//! An [`Experiment`] is a session on a simulated clock that keeps all that happened, among it the states of the grasped object
//! that contact queries saw. Along such a [`BodyPath`], [`Profile`]s of contact steps with different settings are compared
//! with one at full resolution: how long they took, and how far their wrenches are from it ([`Difference`]).
//! [`stability_margin`] tells how much stiffer contacts could be, and [`judge`] what counts as stable. [`recommend`] tries settings
//! on a user's own objects and picks those that keep within a time.

mod difference;
mod error;
mod experiment;
mod frozen;
mod judge;
mod margin;
mod profile;
mod recommend;
mod statistics;

pub use difference::{AUDIBLE, Deviation, Difference, rms_above};
pub use error::MeasureError;
pub use experiment::{Experiment, Query, Sample, Trace};
pub use frozen::frozen;
pub use judge::{Outcome, judge};
pub use margin::{STIFFEST, WEAKEST, pressed, stability_margin};
pub use profile::{BodyPath, Profile, contact_loop, penetration};
pub use recommend::{Choice, Hand, Measured, Recommendation, Request, choices, recommend};
pub use statistics::{correlation, mean, quantile};
