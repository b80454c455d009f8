//! What a session measures of itself: histograms of times, extremes of forces, counts of events.

pub(crate) mod hinged_record;
pub(crate) mod record;

use hdrhistogram::Histogram;
use serde::Serialize;

/// Times in nanoseconds, from 1 ns to 100 s with three significant digits. Recording never allocates.
#[derive(Clone, Debug)]
pub struct Times(Histogram<u64>);

impl Times {
    /// An empty histogram; allocates once, and touches what it allocates.
    pub fn new() -> Self {
        // The bounds are constants that the histogram accepts.
        #[allow(clippy::expect_used)]
        let mut counts = Histogram::new_with_bounds(1, 100_000_000_000, 3).expect("constant bounds");
        // Memory that is zero as it comes from the system is there only once it is written; the compiler must not know that it
        // is zero.
        std::hint::black_box(&mut counts).clear();
        Self(counts)
    }

    /// Adds a time, ns; longer ones than 100 s count as 100 s.
    pub fn record(&mut self, nanoseconds: u64) {
        self.0.saturating_record(nanoseconds.max(1));
    }

    /// Adds all times of another histogram.
    fn add(&mut self, other: &Self) {
        // Both have the same bounds.
        let _ = self.0.add(&other.0);
    }

    /// How many times were recorded.
    pub fn count(&self) -> u64 {
        self.0.len()
    }

    /// How many recorded times lie from `low` to `high`, both in ns and included, at the histogram's resolution.
    pub fn count_between(&self, low: u64, high: u64) -> u64 {
        self.0.count_between(low.max(1), high.max(1))
    }

    /// Percentiles, in nanoseconds divided by `unit`.
    pub fn percentiles(&self, unit: f64) -> Percentiles {
        let at = |quantile| self.0.value_at_quantile(quantile) as f64 / unit;
        Percentiles { p50: at(0.5), p99: at(0.99), p999: at(0.999), max: self.0.max() as f64 / unit }
    }
}

impl Default for Times {
    fn default() -> Self {
        Self::new()
    }
}

/// Percentiles of a histogram.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
    /// Largest.
    pub max: f64,
}

/// Declares the counts of [`Events`], so that each is in their sum.
macro_rules! events {
    ($($(#[$doc:meta])* $event:ident,)*) => {
        /// Number of times that something out of the ordinary happened. Every event is counted, none is logged from the loop.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
        pub struct Events {
            $($(#[$doc])* pub $event: u64,)*
        }

        impl Events {
            /// The events of two loops, or of two times.
            #[must_use]
            pub fn and(&self, other: &Self) -> Self {
                Self { $($event: self.$event + other.$event,)* }
            }
        }
    };
}

events! {
    /// The device did not answer, reported a motion that is not finite or a place far outside its workspace, or refused a wrench; its
    /// last good pose was held. Nothing is sent while it does not answer, nor when no reading has been good for 10 ms. Where more than
    /// one in five is refused for long, the others are not good either.
    device_refused,
    /// The device reported a place that no hand could have moved it to since the last reading; its last good pose was
    /// held. It is believed after five readings in a row, or more where many were refused, and the wrench then comes up from zero.
    device_jumped,
    /// The device's reading was the one before, by its time: its velocity was held. After 25 ms the device counts as lost.
    device_stale,
    /// The device was found more than 5 mm or 0.1 rad from where it was lost, or from where it was when the session was made: the
    /// object stays, and the hand goes on from there.
    rebased,
    /// The driver had sent zero in place of the wrench, which then came up from zero.
    withheld,
    /// A step came so late that not all of the time was integrated, and the hand had moved meanwhile: the wrench came up from zero.
    late,
    /// The handle ran along the wrench at more than 0.8 m/s or 20 rad/s, as one that is let go of does: the wrench was dropped, and
    /// came up from zero.
    runaway,
    /// More energy had come out than can have been stored, by half of the bound: the wrench was dropped, and came up from zero.
    energy_created,
    /// Actuators had been asked for more than they can keep up, and were given less than the peak.
    hot,
    /// The device has no more to give: a replayed path came to its end.
    device_ended,
    /// The step had no finite solution; the object's state was held and no wrench sent.
    step_refused,
    /// No step could be taken 20 times in a row: the object was put where the hand is, at rest.
    reseated,
    /// The set of pushing contacts was still changing when the step ended, so that one may have been left out.
    contacts_unsettled,
    /// An iterative integrator did not converge, and the step was taken as far as it came or semi-implicitly.
    step_unconverged,
    /// The wrench was reduced towards what the device can render: it was above three quarters of it.
    saturated,
    /// The wrench was limited in how fast it changes.
    slewed,
    /// The wrench was faded: contact models were overdue, or had been within the last timeout.
    faded,
    /// The wrench was coming up, after the start, or after the device or the step had failed; or going down and coming
    /// up for the clutch.
    engaging,
    /// The clutch was held: the device moved without the object.
    clutched,
    /// A contact pushed one object of the scene more than there is room for, whose reaction was lost.
    reaction_dropped,
    /// The passivity controller added damping, for more energy had come out than can have been in.
    damped,
    /// A contact step in which the grasped object was deeper in a surface than its proxy may be, or had been carried past
    /// one, so that contacts push it back.
    held_back,
    /// A textured contact slid further between two looks at it than a texel of its grid, so that detail is felt at another
    /// frequency or not at all: let the contact loop run faster, or make the texture coarser.
    texture_undersampled,
    /// A quarter of a textured contact's grid of which more than a tenth folds over itself as seen along the contact, so that
    /// its depth is approximated (§4.6.1).
    texture_folded,
    /// A contact step whose textured contacts the processor computed, as what was to do so failed at them: it was lost, had not
    /// answered within 20 ms, could not be made, or they were too many for it. What is lost is counted once, and the processor
    /// has computed them since.
    texture_backend_lost,
    /// A contact was left out of a contact model, which holds 16 touching contacts, and 4 more that the object only approaches; the
    /// shallowest are left out. Lower [`SearchSettings::clusters`](crate::settings::SearchSettings::clusters): there are up to as many
    /// touching contacts of all still objects, and again of each moving one. Or it was dropped, one of the shallowest of more than a
    /// million of a contact query.
    contact_overflow,
    /// A contact query was refused, its pose not being finite, and found nothing; or a contact was not finite, or the depth of a
    /// quarter of a textured contact's grid, and was left out.
    contact_refused,
    /// A pair of convex hulls did not converge in a contact query.
    not_converged,
    /// A change of the scene could not be made: of an object that is not there, or with a texture that cannot be rendered.
    edit_refused,
    /// A contact model was lost because the haptic loop had not fetched the earlier ones.
    model_dropped,
    /// The contact thread of a hosted session has ended, by a panic: no more contacts are found, and the wrench has faded.
    contact_thread_lost,
    /// Rows of the recording were lost because the recorder could not keep up.
    record_dropped,
}

/// What the haptic loop measured.
#[derive(Clone, Debug, Default)]
pub struct HapticTelemetry {
    /// Haptic steps.
    pub steps: u64,
    /// Periods skipped because the loop woke too late for them.
    pub missed_deadlines: u64,
    /// Those of them that passed while the step before was still running. A step that lost the processor halfway counts as
    /// long here.
    pub missed_by_step: u64,
    /// The rest: the step before had ended in time, but the machine woke the thread late.
    pub missed_by_machine: u64,
    /// Duration of a step, device included.
    pub step: Times,
    /// Lateness of the wake-up.
    pub wake: Times,
    /// Deepest penetration that a contact query reported, m.
    pub depth_max: f64,
    /// Time of the first step that a contact was known in, s: of surfaces closer to each other than the tolerance d.
    pub first_touch: Option<f64>,
    /// Most contacts that a contact query found, before clustering.
    pub contacts_max: u32,
    /// Contacts of the latest query.
    pub contacts_now: u32,
    /// Largest stretch of the coupling, m: how far the grasp was from where the device holds it
    /// ([`Record::stretch`](crate::Record::stretch)).
    pub stretch_max: f64,
    /// Largest coupling force, N.
    pub coupling_force_max: f64,
    /// Energy that has flowed from the device into the session, J. A passive session keeps it above zero but for what
    /// holding the wrench over a period creates.
    ///
    /// The work of the wrench that was held over each period, on the displacement that the device reported: exact but
    /// for the rounding of its encoders (see [`PassivityObserver`](palpate_dynamics::PassivityObserver)).
    pub energy: f64,
    /// The smallest value of [`energy`](Self::energy), J.
    pub energy_min: f64,
    /// Energy that the passivity controller's damping took out of the hand's motion, J.
    pub dissipated: f64,
    /// Events.
    pub events: Events,
}

/// What the contact loop measured.
#[derive(Clone, Debug, Default)]
pub struct ContactTelemetry {
    /// Contact query with clustering and linearisation.
    pub query: Times,
    /// On a simulated clock, how many queries took longer in real time than the simulated time between two of them.
    pub longer_than_slot: Option<u64>,
    /// Events.
    pub events: Events,
}

impl ContactTelemetry {
    /// Adds what another contact loop measured.
    pub(crate) fn add(&mut self, other: &Self) {
        self.query.add(&other.query);
        self.longer_than_slot = match (self.longer_than_slot, other.longer_than_slot) {
            (Some(one), Some(two)) => Some(one + two),
            (one, two) => one.or(two),
        };
        self.events = self.events.and(&other.events);
    }
}
