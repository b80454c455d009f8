//! Measurement of the cost and accuracy of the haptic rendering engine's settings.
//!
//! An [`Experiment`] is a session on a simulated clock with a full record, which includes the states of the
//! grasped object at contact queries. Along such a [`BodyPath`], [`Profile`]s of contact steps with different
//! settings are compared with a profile at full resolution: their durations, and the [`Difference`] of their
//! wrenches. [`stability_margin`] computes how much stiffer contacts could be, and [`judge`] defines
//! stability. [`Vibration`] measures what a hand feels of a session's chatter, and [`Deepest`] how far its
//! poses penetrate. [`recommend`] tries settings on a user's own objects and picks those that keep within a
//! time.

mod deepest;
mod difference;
mod error;
mod experiment;
mod frozen;
mod judge;
mod margin;
mod phase;
mod profile;
mod recommend;
mod statistics;
mod vibration;

pub use deepest::Deepest;
pub use difference::{Deviation, Difference, VIBRATION_FREQUENCY, rms_above};
pub use error::MeasureError;
pub use experiment::{Experiment, Query, Sample, Trace};
pub use frozen::frozen;
pub use judge::{Outcome, judge};
pub use margin::{MAX_EXPONENT, MIN_EXPONENT, pressed, stability_margin};
pub use phase::{Held, Phase, phases};
pub use profile::{BodyPath, Profile, contact_loop, penetration};
pub use recommend::{Choice, Hand, Measured, Recommendation, Request, choices, recommend};
pub use statistics::{correlation, mean, quantile};
pub use vibration::{Band, Level, Vibration, high_passed};
