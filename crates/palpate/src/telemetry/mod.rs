//! Measurements of a session: histograms of times, extremes of forces, counts of events.

pub(crate) mod hinged_record;
pub(crate) mod record;

use hdrhistogram::Histogram;
use serde::Serialize;

/// Histogram of times, from 1 ns to 100 s with three significant digits. Recording never allocates.
#[derive(Clone, Debug)]
pub struct Times(Histogram<u64>);

impl Times {
    /// Makes an empty histogram. Allocates all memory, and writes to it once.
    pub fn new() -> Self {
        // The bounds are constants that the histogram accepts.
        #[allow(clippy::expect_used)]
        let mut counts = Histogram::new_with_bounds(1, 100_000_000_000, 3).expect("constant bounds");
        // The system maps pages of zeros only when they are first written. The black box keeps the compiler
        // from leaving out writes of zeros over zeros.
        std::hint::black_box(&mut counts).clear();
        Self(counts)
    }

    /// Adds a time, ns; times above 100 s count as 100 s.
    pub fn record(&mut self, nanoseconds: u64) {
        self.0.saturating_record(nanoseconds.max(1));
    }

    /// Adds all times of another histogram.
    fn add(&mut self, other: &Self) {
        // Both have the same bounds.
        let _ = self.0.add(&other.0);
    }

    /// Number of recorded times.
    pub fn count(&self) -> u64 {
        self.0.len()
    }

    /// Number of recorded times from `low` to `high` (ns), both included, at the histogram's resolution.
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
        /// Counts of unusual events. The loops count every event, and log none.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
        pub struct Events {
            $($(#[$doc])* pub $event: u64,)*
        }

        impl Events {
            /// Sums the events of two loops, or of two times.
            #[must_use]
            pub fn and(&self, other: &Self) -> Self {
                Self { $($event: self.$event + other.$event,)* }
            }
        }
    };
}

/// How often an event of [`Events`] that lasts began, and how long it lasted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Span {
    /// Number of times: steps in a row with the event are one.
    pub times: u64,
    /// Duration of all of them together, s.
    pub seconds: f64,
}

/// Declares the [`Spans`]: those events that last for several haptic steps.
macro_rules! spans {
    ($($event:ident,)*) => {
        /// How often, and how long, the events were that last for several haptic steps. Their counts in
        /// [`Events`] are of steps.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
        pub struct Spans {
            $(
                #[doc = concat!("The event [`", stringify!($event), "`](Events::", stringify!($event), ").")]
                pub $event: Span,
            )*
        }

        impl Spans {
            /// Counts the events of a step of `dt` (s): those whose counts have changed. One that did not
            /// last since the step `before` began.
            fn pass(&mut self, [before, last, now]: [&Events; 3], dt: f64) {
                $(
                    if now.$event > last.$event {
                        self.$event.times += u64::from(last.$event == before.$event);
                        self.$event.seconds += dt;
                    }
                )*
            }
        }
    };
}

spans! {
    device_refused,
    device_stale,
    device_ended,
    waited,
    withheld,
    hot,
    step_refused,
    saturated,
    slewed,
    faded,
    engaging,
    clutched,
    damped,
}

events! {
    /// The device did not answer, reported a motion that is not finite or a place far outside its workspace,
    /// or refused a wrench; its last good pose was held. No wrench is sent while the device does not answer,
    /// nor after 10 ms without a good reading. While more than one reading in five is refused for long, the
    /// other readings are not trusted either.
    device_refused,
    /// The device reported a place that no hand could have moved it to since the last reading; its last good
    /// pose was held. The new place is accepted after five such readings in a row, or after more where many
    /// were refused; the wrench then rises from zero.
    device_jumped,
    /// The device repeated a reading, by its time stamp: its velocity was held. After 25 ms the device counts
    /// as lost.
    device_stale,
    /// The device reappeared more than 5 mm or 0.1 rad from where it was lost, or from where it was when the
    /// session was made: the object stays, and follows the hand from there.
    rebased,
    /// The object was held back in a step, since it could have touched surfaces that no contact query has
    /// found yet; it follows when the next query has.
    waited,
    /// The driver had sent zero in place of the wrench, which then rose from zero.
    withheld,
    /// A step was so late that only a part of the time was integrated, and the hand had moved meanwhile: the
    /// wrench rose from zero.
    late,
    /// The handle ran along the wrench at more than 0.8 m/s or 20 rad/s, as if the hand had let go: the
    /// wrench was dropped, and rose from zero.
    runaway,
    /// The energy that had come out exceeded the energy that can have been stored by half of the bound: the
    /// wrench was dropped, and rose from zero.
    energy_created,
    /// The wrench was limited to less than the peak, because the actuators had rendered more than they can
    /// sustain.
    hot,
    /// The device had no more readings: a replayed path reached its end.
    device_ended,
    /// The step had no finite solution; the object's state was held and no wrench sent.
    step_refused,
    /// The step failed 20 times in a row: the object was placed where the hand is, at rest.
    reseated,
    /// The set of pushing contacts was still changing when the step ended, so that one may have been left
    /// out.
    contacts_unsettled,
    /// An iterative integrator did not converge: the step was taken with its last iterate, or
    /// semi-implicitly.
    step_unconverged,
    /// The wrench exceeded three quarters of the device's peak, and was reduced to stay below the peak.
    saturated,
    /// The rate of change of the wrench was limited.
    slewed,
    /// The wrench was faded: contact models were overdue, or had been within the last timeout.
    faded,
    /// The wrench was rising, after the start or after a failure of the device or of a step; or falling and
    /// rising for the clutch.
    engaging,
    /// The clutch was held: the device moved without the object.
    clutched,
    /// The reaction on an object of the scene was lost because there were too many of them.
    reaction_dropped,
    /// The passivity controller added damping, because more energy had come out than can have been stored.
    damped,
    /// A contact step in which the grasped object was deeper in a surface than its proxy may be, or had been
    /// carried past a surface, so that contacts pushed it back.
    proxy_engaged,
    /// A textured contact slid by more than a texel of its grid between two contact steps, so that its detail
    /// is felt at another frequency or not at all: raise the contact rate, or make the texture coarser.
    texture_undersampled,
    /// More than a tenth of a quarter of a textured contact's grid folds over itself, as seen along the
    /// contact normal, so that its depth is approximate (§4.6.1).
    texture_folded,
    /// A contact step whose textured contacts the processor computed because their backend failed: it was
    /// lost, did not answer within 20 ms, could not be created, or had no room for so many contacts. The loss
    /// of a backend is counted once; the processor computes all contacts after it.
    texture_backend_lost,
    /// A contact was left out of a contact model, which holds 16 touching contacts, and 4 more that the
    /// object only approaches; the shallowest are left out. Lower
    /// [`SearchSettings::clusters`](crate::settings::SearchSettings::clusters): it limits the touching
    /// contacts of all static objects, and separately those of each moving one. Or a contact query found more
    /// than a million contacts, and dropped the shallowest.
    contact_overflow,
    /// A contact query found nothing because its pose was not finite; or a contact, or the depth of a quarter
    /// of a textured contact's grid, was not finite and was left out.
    contact_refused,
    /// A pair of convex hulls did not converge in a contact query.
    not_converged,
    /// A change of the scene could not be made: the object does not exist, or its texture cannot be rendered.
    edit_refused,
    /// A contact model was lost because the haptic loop had not fetched the earlier ones.
    model_dropped,
    /// The contact thread of a hosted session has ended by a panic: no more contacts are found, and the
    /// wrench has faded.
    contact_thread_lost,
    /// Rows of the recording were lost because the recorder could not keep up.
    record_dropped,
}

/// Measurements of the haptic loop.
#[derive(Clone, Debug, Default)]
pub struct HapticTelemetry {
    /// Number of haptic steps.
    pub steps: u64,
    /// Number of periods skipped because the loop woke too late for them.
    pub missed_deadlines: u64,
    /// Number of skipped periods that passed while the previous step was still running. A step that lost the
    /// processor halfway counts as long here.
    pub missed_by_step: u64,
    /// Number of the other skipped periods: the previous step had ended in time, but the machine woke the
    /// thread late.
    pub missed_by_machine: u64,
    /// Durations of steps, device included.
    pub step: Times,
    /// Lateness of wake-ups.
    pub wake: Times,
    /// Deepest penetration that a contact query reported, m.
    pub depth_max: f64,
    /// Time of the first step in which a contact pushed, s: with a force of more than 1 µN at the device.
    pub first_touch: Option<f64>,
    /// Largest number of contacts that were known at once, before clustering, whether they pushed or not.
    pub contacts_max: u32,
    /// Number of contacts known in the last step.
    pub contacts_now: u32,
    /// Largest stretch of the coupling, m: distance of the grasp from where the device holds it
    /// ([`Record::stretch`](crate::Record::stretch)).
    pub stretch_max: f64,
    /// Largest coupling force, N.
    pub coupling_force_max: f64,
    /// Energy that has flowed from the device into the session, J. In a passive session it stays above zero,
    /// except for the energy that is created by holding the wrench over a period.
    ///
    /// It is the work of the wrench that was held over each period, on the displacement that the device
    /// reported: exact except for the rounding of its encoders (see
    /// [`PassivityObserver`](palpate_dynamics::PassivityObserver)).
    pub energy: f64,
    /// Smallest value of [`energy`](Self::energy), J.
    pub energy_min: f64,
    /// Energy that the passivity controller's damping took out of the hand's motion, J.
    pub dissipated: f64,
    /// Counts of events.
    pub events: Events,
    /// How often, and how long, events were that last.
    pub spans: Spans,
    /// Counts of events after the last step, and after the one before.
    counted: [Events; 2],
}

impl HapticTelemetry {
    /// Ends a step of `dt` (s): adds the events since the last one to their spans.
    pub(crate) fn pass(&mut self, dt: f64) {
        let [before, last] = &self.counted;
        self.spans.pass([before, last, &self.events], dt);
        self.counted = [self.counted[1], self.events];
    }
}

/// Measurements of the contact loop.
#[derive(Clone, Debug, Default)]
pub struct ContactTelemetry {
    /// Durations of contact queries with clustering and linearisation.
    pub query: Times,
    /// Number of queries that took longer in real time than the simulated time between two queries; `None`
    /// in real time.
    pub longer_than_slot: Option<u64>,
    /// Counts of events.
    pub events: Events,
}

impl ContactTelemetry {
    /// Adds the measurements of another contact loop.
    pub(crate) fn add(&mut self, other: &Self) {
        self.query.add(&other.query);
        self.longer_than_slot = match (self.longer_than_slot, other.longer_than_slot) {
            (Some(one), Some(two)) => Some(one + two),
            (one, two) => one.or(two),
        };
        self.events = self.events.and(&other.events);
    }
}
