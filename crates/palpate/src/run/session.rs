//! Results of an ended session: measurements, and the machine-readable summary.

use std::collections::BTreeMap;

use palpate_core::glam::DVec3;
use palpate_device::Specification;
use palpate_realtime::{Outcome, State, ThreadSetup};
use serde::Serialize;

use crate::contact_loop::ContactLoop;
use crate::haptic::invariants::InvariantRecord;
use crate::run::machine::MachineLoad;
use crate::run::renderer::HapticRenderer;
use crate::run::settings_editor::SettingsEditor;
use crate::scene::object::Object;
use crate::settings::{ContactSettings, OutputSettings, Settings, ToolSettings, UnusedSetting};
use crate::telemetry::{ContactTelemetry, Events, HapticTelemetry, Percentiles, Spans};
use crate::tool::Tool;

/// [`HapticSummary::scheduling`] on a simulated clock.
const LOCKSTEP: &str = "lockstep";

/// Clock of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Clock {
    /// Real time.
    Real {
        /// Requests to the operating system, and their outcomes.
        setup: Box<RealtimeSetup>,
    },
    /// Simulated time.
    Simulated,
}

/// Requests of a real-time session to the operating system, and their outcomes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RealtimeSetup {
    /// Thread that exchanges reports with the device; `None` if the device has no such thread.
    pub device: Option<ThreadSetup>,
    /// Haptic thread.
    pub haptic: ThreadSetup,
    /// Contact thread of the first body.
    pub contact: Option<ThreadSetup>,
    /// Locking of the process's memory.
    pub memory: Outcome,
}

impl RealtimeSetup {
    /// Requests that the operating system refused, wholly or in part, for lack of a privilege: their names
    /// and outcomes.
    pub fn limited(&self) -> Vec<(String, &Outcome)> {
        let threads = [
            ("device", self.device.as_ref()),
            ("haptic", Some(&self.haptic)),
            ("contact", self.contact.as_ref()),
        ];
        let threads = threads.into_iter().filter_map(|(name, setup)| Some((name, setup?)));
        let outcomes = threads.flat_map(|(name, setup)| {
            setup.outcomes().map(|(what, outcome)| (format!("{what} of the {name} thread"), outcome))
        });
        let limited = |outcome: &Outcome| outcome.state == State::Refused || outcome.remedy.is_some();
        outcomes
            .chain([("memory".to_owned(), &self.memory)])
            .filter(|(_, outcome)| limited(outcome))
            .collect()
    }
}

/// Ended session.
#[derive(Clone, Debug)]
pub struct Session {
    /// Duration, s.
    pub seconds: f64,
    /// Clock of the session.
    pub clock: Clock,
    /// Measurements of the haptic loop.
    pub haptic: HapticTelemetry,
    /// Measurements of the contact loops.
    pub contact: ContactTelemetry,
    /// Load of the machine, for the haptic thread; empty on a simulated clock.
    pub machine: MachineLoad,
    /// Distance tolerance d of the contact queries, m.
    pub tolerance: f64,
    /// First error of the device, in the words of its driver, if any.
    pub device_error: Option<String>,
    /// Position of the [grasp](crate::settings::ToolSettings::grasp) in the mesh's frame, m.
    pub grasp: DVec3,
    /// Stages of the pipeline: on or off, and why.
    pub stages: BTreeMap<&'static str, String>,
    /// Settings that were given and had no effect, and why.
    pub unused_settings: Vec<UnusedSetting>,
    /// Checks of the wrenches that were sent against the bounds that the engine promises, by
    /// [`Invariant`](crate::promises::Invariant).
    pub invariants: BTreeMap<&'static str, InvariantRecord>,
}

/// Machine-readable summary of a session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Duration, s.
    pub seconds: f64,
    /// Haptic loop.
    pub haptic: HapticSummary,
    /// Contact loops.
    pub contact: ContactSummary,
    /// Requests to the operating system, and their outcomes; `None` on a simulated clock.
    pub realtime: Option<RealtimeSetup>,
    /// Time of the first step in which a contact pushed, with more than 1 µN at the device, s; `None` if none
    /// did.
    pub first_touch_s: Option<f64>,
    /// Largest number of contacts that were known at once, before clustering, whether they pushed or not.
    pub contacts_max: u32,
    /// Number of contacts known at the end of the session.
    pub contacts_at_end: u32,
    /// Distance tolerance d of the contact queries, m: penalty contacts push from this distance on.
    pub tolerance: f64,
    /// Deepest penetration, m.
    pub depth_max: f64,
    /// Position of the [grasp](crate::settings::ToolSettings::grasp) in the mesh's frame, m.
    pub grasp: DVec3,
    /// Largest [stretch](crate::Record::stretch) of the coupling, m: distance of the object's grasp from
    /// where the device holds it.
    pub coupling_stretch_max: f64,
    /// Largest coupling force, N.
    pub coupling_force_max: f64,
    /// Smallest energy absorbed at the device port, J.
    pub energy_min_j: f64,
    /// Energy that the passivity controller dissipated, J.
    pub dissipated_j: f64,
    /// First error of the device, in the words of its driver, if any.
    pub device_error: Option<String>,
    /// Stages of the pipeline: on or off, and why.
    pub stages: BTreeMap<&'static str, String>,
    /// Settings that were given and had no effect, and why.
    pub unused_settings: Vec<UnusedSetting>,
    /// Checks of the wrenches that were sent against the bounds that the engine promises, by
    /// [`Invariant`](crate::promises::Invariant).
    pub invariants: BTreeMap<&'static str, InvariantRecord>,
    /// Counts of events. Those that last are counted in each step.
    pub events: Events,
    /// How often, and how long, events were that last.
    pub spans: Spans,
}

/// Summary of the haptic loop. Values that the operating system does not report are `None`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HapticSummary {
    /// Rate of steps, Hz.
    pub rate_hz: f64,
    /// Number of steps.
    pub steps: u64,
    /// Number of skipped periods.
    pub missed_deadlines: u64,
    /// Number of skipped periods that passed while the previous step was still running.
    pub missed_by_step: u64,
    /// Number of skipped periods for which the machine woke the thread late.
    pub missed_by_machine: u64,
    /// Processor time that other virtual machines took during the session, summed over all processors, s.
    pub stolen_s: Option<f64>,
    /// Number of times that the haptic thread was preempted.
    pub preempted: Option<u64>,
    /// Time for which the haptic thread was ready to run but waited for a processor, s.
    pub run_delay_s: Option<f64>,
    /// Number of page faults of the haptic thread.
    pub page_faults: Option<u64>,
    /// Duration of a step, ns.
    pub step_ns: Percentiles,
    /// Lateness of wake-ups, µs.
    pub wake_us: Percentiles,
    /// Scheduling of the thread; `lockstep` on a simulated clock.
    pub scheduling: String,
}

/// Summary of the contact loops.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ContactSummary {
    /// Rate of contact queries, Hz.
    pub rate_hz: f64,
    /// Duration of a query with clustering and linearisation, µs.
    pub query_us: Percentiles,
    /// Number of queries that took longer in real time than the simulated time between two queries, and
    /// would have missed this contact rate; `None` in real time.
    pub longer_than_slot: Option<u64>,
}

impl Session {
    /// Closes the device, and collects the measurements.
    pub(crate) fn close<T: Tool>(
        mut renderer: HapticRenderer<T>,
        seconds: f64,
        clock: Clock,
        machine: MachineLoad,
    ) -> Self {
        let (stages, unused_settings) = (renderer.stages(), renderer.unused_settings());
        if let Err(error) = renderer.device.close() {
            renderer.haptic.telemetry_mut().events.device_refused += 1;
            renderer.haptic.keep_device_error(error);
        }
        let device_error = renderer.haptic.device_error().map(ToString::to_string);
        let grasp = renderer.grasp().translation;
        let invariants = renderer.haptic.invariants().summary();
        let haptic = renderer.haptic.telemetry().clone();
        let contact = renderer.contact_telemetry();
        #[cfg(feature = "tracing")]
        tracing::info!(
            seconds,
            steps = haptic.steps,
            missed_deadlines = haptic.missed_deadlines,
            contact_steps = contact.query.count(),
            depth_max = haptic.depth_max,
            "session ended"
        );
        let tolerance = renderer.contacts[0].tolerance();
        Self {
            seconds,
            clock,
            haptic,
            contact,
            machine,
            tolerance,
            device_error,
            grasp,
            stages,
            unused_settings,
            invariants,
        }
    }

    /// Makes the machine-readable summary.
    pub fn summary(&self) -> Summary {
        let (haptic, contact) = (&self.haptic, &self.contact);
        let rate = |count: u64| if self.seconds > 0.0 { count as f64 / self.seconds } else { 0.0 };
        let realtime = match &self.clock {
            Clock::Real { setup } => Some(RealtimeSetup::clone(setup)),
            Clock::Simulated => None,
        };
        let scheduling = realtime.as_ref().map_or(LOCKSTEP.to_owned(), |it| it.haptic.scheduling_line());
        Summary {
            seconds: self.seconds,
            haptic: HapticSummary {
                rate_hz: rate(haptic.steps),
                steps: haptic.steps,
                missed_deadlines: haptic.missed_deadlines,
                missed_by_step: haptic.missed_by_step,
                missed_by_machine: haptic.missed_by_machine,
                stolen_s: self.machine.stolen_s,
                preempted: self.machine.preempted,
                run_delay_s: self.machine.run_delay_s,
                page_faults: self.machine.page_faults,
                step_ns: haptic.step.percentiles(1.0),
                wake_us: haptic.wake.percentiles(1000.0),
                scheduling,
            },
            contact: ContactSummary {
                rate_hz: rate(contact.query.count()),
                query_us: contact.query.percentiles(1000.0),
                longer_than_slot: contact.longer_than_slot,
            },
            realtime,
            first_touch_s: haptic.first_touch,
            contacts_max: haptic.contacts_max,
            contacts_at_end: haptic.contacts_now,
            tolerance: self.tolerance,
            depth_max: haptic.depth_max,
            grasp: self.grasp,
            coupling_stretch_max: haptic.stretch_max,
            coupling_force_max: haptic.coupling_force_max,
            energy_min_j: haptic.energy_min,
            dissipated_j: haptic.dissipated,
            device_error: self.device_error.clone(),
            stages: self.stages.clone(),
            unused_settings: self.unused_settings.clone(),
            invariants: self.invariants.clone(),
            events: haptic.events.and(&contact.events),
            spans: haptic.spans,
        }
    }
}

impl HapticSummary {
    /// Sentence that says how many deadlines were missed, and why.
    pub fn missed_verdict(&self) -> String {
        if self.scheduling == LOCKSTEP {
            return "No deadline could be missed: the clock was simulated.".to_owned();
        }
        let deadlines = grouped(self.steps + self.missed_deadlines);
        let missed = grouped(self.missed_deadlines);
        let (by_machine, by_step) = (self.missed_by_machine, self.missed_by_step);
        let mut causes = Vec::new();
        if by_machine > 0 {
            let seen = self.machine_signs();
            let seen = if seen.is_empty() { String::new() } else { format!(" ({})", seen.join(", ")) };
            causes.push(format!("{} because the machine woke the thread late{seen}", grouped(by_machine)));
        }
        if by_step > 0 {
            causes.push(format!("{} because the step took longer than its period", grouped(by_step)));
        }
        match causes.as_slice() {
            [] => format!("None of {deadlines} deadlines was missed."),
            causes => format!("{missed} of {deadlines} deadlines missed: {}.", causes.join(", ")),
        }
    }

    /// Reports of the operating system that explain why the machine was late.
    fn machine_signs(&self) -> Vec<String> {
        let stolen = self.stolen_s.filter(|stolen| *stolen > 0.0);
        let waited = self.run_delay_s.filter(|waited| *waited >= 1e-3);
        let preempted = self.preempted.filter(|times| *times > 0);
        let signs = [
            stolen.map(|s| format!("other virtual machines took {s:.2} s of processor time")),
            preempted.map(|times| match times {
                1 => "the thread was preempted once".to_owned(),
                times => format!("the thread was preempted {} times", grouped(times)),
            }),
            waited.map(|s| format!("it waited {s:.3} s for a processor")),
        ];
        signs.into_iter().flatten().collect()
    }
}

/// Writes a number with commas between groups of three digits.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

impl<T: Tool> HapticRenderer<T> {
    /// Measurements of the contact loops of all bodies.
    fn contact_telemetry(&self) -> ContactTelemetry {
        let mut all = ContactTelemetry::default();
        self.contacts.iter().for_each(|contact| all.add(contact.telemetry()));
        all
    }

    /// Stages of the pipeline with the scene and the settings as they are: on or off, and why.
    pub fn stages(&self) -> BTreeMap<&'static str, String> {
        let settings = self.latest_settings();
        let mut stages = BTreeMap::from([
            ("device", self.device_stage()),
            ("friction", friction_stage(&settings.contact)),
            ("hierarchy", self.hierarchy_stage()),
            ("integrator", self.haptic.tool.integrator().to_owned()),
            ("passivity controller", on_or_off(settings.output.passivity_controller)),
        ]);
        let of_bodies: Vec<_> = self.contacts.iter().map(|contact| contact.stages(&settings)).collect();
        if let Some((first, others)) = of_bodies.split_first() {
            for (index, (stage, what)) in first.iter().enumerate() {
                let differing = others.iter().map(|other| &other[index].1).find(|other| *other != what);
                let both = |other: &String| format!("first body: {what}; second body: {other}");
                stages.insert(stage, differing.map_or_else(|| what.clone(), both));
            }
        }
        stages
    }

    /// Settings that are given and that nothing in this session uses, with the reasons. The scene is taken as
    /// it is; the summary has those of the whole session.
    pub fn unused_settings(&self) -> Vec<UnusedSetting> {
        let settings = self.latest_settings();
        // What one body of a tool has no use for, the other may use.
        let mut of_bodies = self.contacts.iter().map(|contact| contact.unused(&settings));
        let mut unused = of_bodies.next().unwrap_or_default();
        for other in of_bodies {
            unused.retain(|setting| other.contains(setting));
        }
        if self.contacts.len() > 1 && settings.tool.mass != ToolSettings::default().mass {
            unused.push(UnusedSetting { name: "tool.mass", why: "each body of the tool has its own mass" });
        }
        let OutputSettings { force_slew, torque_slew, passivity_controller } = settings.output;
        let Specification { actuated, peak_force, peak_torque, .. } = self.device.specification();
        let force = actuated.translation.contains(&true) && *peak_force > 0.0;
        let torque = actuated.rotation.contains(&true) && *peak_torque > 0.0;
        let given = [
            ("output.force_slew", force_slew.is_some() && !force, "the device renders no force"),
            ("output.torque_slew", torque_slew.is_some() && !torque, "the device renders no torque"),
            (
                "output.passivity_controller",
                passivity_controller && !force && !torque,
                "the device renders neither force nor torque",
            ),
        ];
        unused.extend(given.into_iter().filter(|it| it.1).map(|(name, _, why)| UnusedSetting { name, why }));
        unused
    }

    /// Settings with those that editors have changed.
    fn latest_settings(&self) -> Settings {
        self.editor_of_settings().map_or(*self.settings(), SettingsEditor::settings)
    }

    /// Objects with their roles, those of the tool first.
    fn objects(&self) -> impl Iterator<Item = (&'static str, &Object)> {
        let scene = self.contacts[0].scene_objects().map(|object| ("scene", object));
        self.bodies().iter().map(|body| ("probe", body)).chain(scene)
    }

    fn hierarchy_stage(&self) -> String {
        if self.contacts.iter().all(ContactLoop::is_by_fields) {
            return "off: contacts are found in distance fields".to_owned();
        }
        let objects: Vec<String> = self
            .objects()
            .map(|(role, Object { name, clod, .. })| match clod.leaves().len() {
                1 => format!("{role} {name}: off, one convex hull"),
                leaves => {
                    format!("{role} {name}: on, {leaves} convex patches in {} levels", clod.levels.len())
                }
            })
            .collect();
        objects.join("; ")
    }

    /// Axes along and about which the device renders, and those along and about which it senses no motion.
    fn device_stage(&self) -> String {
        let Specification { name, actuated, sensed, .. } = self.device.specification();
        let felt = match (named(actuated.translation), named(actuated.rotation)) {
            (None, None) => "off: no force and no torque".to_owned(),
            (Some(force), None) => format!("on: force along {force}, no torque"),
            (None, Some(torque)) => format!("on: torque about {torque}, no force"),
            (Some(force), Some(torque)) => format!("on: force along {force}, torque about {torque}"),
        };
        let unsensed = match (named(sensed.translation.map(|it| !it)), named(sensed.rotation.map(|it| !it))) {
            (None, None) => String::new(),
            (Some(shift), None) => format!("; no motion along {shift} is sensed"),
            (None, Some(turn)) => format!("; no turn about {turn} is sensed"),
            (Some(shift), Some(turn)) => {
                format!("; no motion along {shift} and no turn about {turn} is sensed")
            }
        };
        format!("{name}: {felt}{unsensed}")
    }
}

fn friction_stage(contact: &ContactSettings) -> String {
    let ContactSettings { friction, static_friction, .. } = *contact;
    match static_friction.filter(|at_rest| *at_rest != friction) {
        Some(at_rest) => format!("on: coefficient {friction}, at rest {at_rest}"),
        None if friction == 0.0 => "off: its coefficient is 0".to_owned(),
        None => format!("on: coefficient {friction}"),
    }
}

/// State of a stage that a setting switches.
fn on_or_off(on: bool) -> String {
    if on { "on: by its setting" } else { "off: by its setting" }.to_owned()
}

/// Names of the axes that are set; `None` if no axis is.
fn named(axes: [bool; 3]) -> Option<String> {
    let names: Vec<&str> =
        ["x", "y", "z"].into_iter().zip(axes).filter(|&(_, set)| set).map(|(name, _)| name).collect();
    (!names.is_empty()).then(|| names.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary(steps: u64, by_machine: u64, by_step: u64) -> HapticSummary {
        HapticSummary {
            rate_hz: 1000.0,
            steps,
            missed_deadlines: by_machine + by_step,
            missed_by_step: by_step,
            missed_by_machine: by_machine,
            stolen_s: None,
            preempted: None,
            run_delay_s: None,
            page_faults: None,
            step_ns: Percentiles::default(),
            wake_us: Percentiles::default(),
            scheduling: "normal".to_owned(),
        }
    }

    #[test]
    fn missed_deadlines_are_explained() {
        let both = HapticSummary { stolen_s: Some(0.4), preempted: Some(35), ..summary(9_988, 11, 1) };
        assert_eq!(
            both.missed_verdict(),
            "12 of 10,000 deadlines missed: 11 because the machine woke the thread late (other virtual machines took \
             0.40 s of processor time, the thread was preempted 35 times), 1 because the step took longer than its period."
        );
        // The sentence leaves out counters that were not measured or are zero.
        assert_eq!(
            summary(999, 1, 0).missed_verdict(),
            "1 of 1,000 deadlines missed: 1 because the machine woke the thread late."
        );
        let quiet = HapticSummary {
            stolen_s: Some(0.0),
            preempted: Some(0),
            run_delay_s: Some(0.0),
            ..summary(1, 2_000_000, 0)
        };
        assert_eq!(
            quiet.missed_verdict(),
            "2,000,000 of 2,000,001 deadlines missed: 2,000,000 because the machine woke the thread late."
        );
        // The load of the machine does not explain a long step.
        let long = HapticSummary { stolen_s: Some(0.4), preempted: Some(35), ..summary(99, 0, 1) };
        assert_eq!(
            long.missed_verdict(),
            "1 of 100 deadlines missed: 1 because the step took longer than its period."
        );
        assert_eq!(summary(10_000, 0, 0).missed_verdict(), "None of 10,000 deadlines was missed.");
        let simulated = HapticSummary { scheduling: LOCKSTEP.to_owned(), ..summary(100, 0, 0) };
        assert_eq!(simulated.missed_verdict(), "No deadline could be missed: the clock was simulated.");
    }
}
