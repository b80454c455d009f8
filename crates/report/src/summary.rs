//! Summary of a session in words: first what was felt, then how well the loops kept up.

use palpate::Summary;
use palpate::summary::RealtimeSetup;
use palpate::telemetry::Percentiles;

use crate::events::{happened, in_words};
use crate::grouped;
use crate::quantity::{force, length, quantity, rate};

/// Returns a session's summary as readable rows of a name and a value.
pub fn measured(summary: &Summary) -> Vec<(&'static str, String)> {
    let mut rows = felt(summary);
    rows.extend(kept_up(summary));
    rows.extend(summary.stages.iter().map(|(&stage, why)| (stage, why.clone())));
    if !summary.unused_settings.is_empty() {
        let unused: Vec<String> = summary.unused_settings.iter().map(ToString::to_string).collect();
        rows.push(("settings without effect", unused.join("; ")));
    }
    let events = happened(&summary.events, &summary.spans);
    if events.is_empty() {
        rows.push(("events", "none".to_owned()));
    }
    rows.extend(events.into_iter().map(|(name, count, meaning)| (name, format!("{count}: {meaning}"))));
    rows
}

/// Returns rows about touch, depth and force.
fn felt(summary: &Summary) -> Vec<(&'static str, String)> {
    let touch = match summary.first_touch_s {
        Some(first) => format!("first after {}", quantity(first, "s")),
        None => "nothing was touched".to_owned(),
    };
    let (most, last) = (summary.contacts_max as usize, summary.contacts_at_end as usize);
    let contacts = format!("at most {}, {} at the end", grouped(most), grouped(last));
    let mut rows = vec![
        ("touch", touch),
        ("deepest penetration", depth(summary)),
        ("largest force sent to the device", force(summary.coupling_force_max)),
    ];
    // Contacts that are near and do not push would contradict the first row.
    rows.extend(summary.first_touch_s.map(|_| ("contacts", contacts)));
    rows.push(("largest coupling stretch", length(summary.coupling_stretch_max)));
    rows
}

/// Describes the deepest penetration, or why there was none.
fn depth(summary: &Summary) -> String {
    if summary.depth_max > 0.0 {
        return length(summary.depth_max);
    }
    let penalties = summary.stages.get("contact response").is_some_and(|it| it.starts_with("penalties"));
    match summary.first_touch_s {
        None => "0: nothing was touched".to_owned(),
        Some(_) if penalties => {
            let tolerance = length(summary.tolerance);
            format!("0: contacts were held within the tolerance of {tolerance}, before surfaces met")
        }
        Some(_) => "0: contacts kept the surfaces from overlapping".to_owned(),
    }
}

/// Returns rows about rates, durations and deadlines.
fn kept_up(summary: &Summary) -> Vec<(&'static str, String)> {
    let Summary { haptic, contact, .. } = summary;
    let simulated = haptic.scheduling == "lockstep";
    let steps = grouped(haptic.steps as usize);
    let mut rows = vec![
        ("deadlines", haptic.missed_verdict()),
        ("duration", quantity(summary.seconds, "s")),
        ("haptic rate", format!("{}, {steps} steps", rate(haptic.rate_hz))),
        ("haptic step", percentiles(&haptic.step_ns, 1e-9)),
    ];
    if !simulated {
        rows.push(("wake-up lateness", percentiles(&haptic.wake_us, 1e-6)));
        rows.push(("scheduling of the haptic thread", haptic.scheduling.clone()));
    }
    rows.extend(summary.realtime.iter().map(|setup| ("real-time set-up", limits(setup))));
    rows.push(("contact rate", rate(contact.rate_hz)));
    rows.push(("contact query time", percentiles(&contact.query_us, 1e-6)));
    if let Some(longer) = contact.longer_than_slot {
        let kept_up = match longer {
            0 => "every query would have kept up in real time".to_owned(),
            1 => "1 query took longer than the time to the next one, and would have been late in real time"
                .to_owned(),
            more => format!(
                "{} queries took longer than the time to the next one, and would have been late in real time",
                grouped(more as usize)
            ),
        };
        rows.push(("contact loop", kept_up));
    }
    rows.push(("lowest net energy at the device (negative: created)", quantity(summary.energy_min_j, "J")));
    rows.push(("safety limits", safety_limits(summary)));
    if summary.dissipated_j > 0.0 {
        rows.push(("energy taken out by the passivity controller", quantity(summary.dissipated_j, "J")));
    }
    rows
}

/// Describes whether the sent wrenches kept their invariants.
fn safety_limits(summary: &Summary) -> String {
    let broken = summary.invariants.iter().filter(|(_, kept)| kept.broken > 0);
    let broken: Vec<String> =
        broken.map(|(name, kept)| format!("{name} broken {}", in_words(kept.broken))).collect();
    if broken.is_empty() { "all kept".to_owned() } else { broken.join(", ") }
}

/// Describes the requests that the operating system did not grant, with the remedy for each.
fn limits(setup: &RealtimeSetup) -> String {
    let limited = setup.limited();
    if limited.is_empty() {
        return "all requests were granted".to_owned();
    }
    let said: Vec<String> = limited.iter().map(|(what, outcome)| format!("{what}: {outcome}")).collect();
    said.join("; ")
}

/// Formats percentiles of times in units of `unit` (s).
fn percentiles(of: &Percentiles, unit: f64) -> String {
    let time = |value: f64| quantity(value * unit, "s");
    format!("median {}, p99 {}, p99.9 {}, max {}", time(of.p50), time(of.p99), time(of.p999), time(of.max))
}

#[cfg(test)]
mod tests {
    use palpate::Events;
    use palpate::settings::UnusedSetting;
    use palpate::summary::{ContactSummary, HapticSummary};
    use palpate::telemetry::{Span, Spans};
    use palpate::threads::{Outcome, Role, State, ThreadSetup};

    use super::*;

    fn outcome(state: State, remedy: Option<&str>) -> Outcome {
        Outcome { state, detail: "as it is".to_owned(), remedy: remedy.map(str::to_owned) }
    }

    /// Setup of a session in which all requests were granted.
    fn setup() -> RealtimeSetup {
        let granted = || outcome(State::Granted, None);
        let thread = |role| ThreadSetup {
            role,
            scheduling: granted(),
            processors: outcome(State::NotAsked, None),
            timer_slack: granted(),
            stack: granted(),
            denormals: granted(),
        };
        let (haptic, contact) = (thread(Role::Haptic), thread(Role::Contact));
        RealtimeSetup { device: None, haptic, contact: Some(contact), memory: granted() }
    }

    #[test]
    fn missing_privileges_are_named_with_the_remedy() {
        let all = summary();
        assert_eq!(value(&measured(&all), "real-time set-up"), "all requests were granted");
        let mut setup = setup();
        setup.memory = outcome(State::Refused, Some("raise the limit"));
        setup.device = Some(ThreadSetup {
            role: Role::Device,
            scheduling: outcome(State::Granted, Some("ask for more")),
            ..setup.haptic.clone()
        });
        let some = Summary { realtime: Some(setup), ..all };
        let said =
            "scheduling of the device thread: as it is; ask for more; memory: as it is; raise the limit";
        assert_eq!(value(&measured(&some), "real-time set-up"), said);
        let rows = measured(&Summary { realtime: None, ..some });
        assert!(rows.iter().all(|(name, _)| *name != "real-time set-up"), "on a simulated clock: {rows:?}");
    }

    fn summary() -> Summary {
        Summary {
            seconds: 10.0,
            haptic: HapticSummary {
                rate_hz: 999.9,
                steps: 9_999,
                missed_deadlines: 1,
                missed_by_step: 0,
                missed_by_machine: 1,
                stolen_s: None,
                preempted: None,
                run_delay_s: None,
                page_faults: Some(0),
                step_ns: Percentiles { p50: 16_975.0, p99: 24_100.0, p999: 30_000.0, max: 1_200_000.0 },
                wake_us: Percentiles { p50: 1.0, p99: 20.0, p999: 50.0, max: 1100.0 },
                scheduling: "SCHED_FIFO, priority 80".to_owned(),
            },
            contact: ContactSummary {
                rate_hz: 750.0,
                query_us: Percentiles { p50: 300.0, p99: 800.0, p999: 900.0, max: 1000.0 },
                longer_than_slot: None,
            },
            realtime: Some(setup()),
            first_touch_s: Some(0.412),
            contacts_max: 1204,
            contacts_at_end: 3,
            tolerance: 1e-4,
            depth_max: 4.3e-5,
            coupling_stretch_max: 4.3e-4,
            grasp: palpate::glam::DVec3::ZERO,
            device_error: None,
            coupling_force_max: 1.2345,
            energy_min_j: -1e-6,
            dissipated_j: 0.0,
            stages: [("friction", "off".to_owned()), ("contact response", "penalties".to_owned())].into(),
            unused_settings: vec![UnusedSetting { name: "search.clusters", why: "contacts are constraints" }],
            invariants: std::collections::BTreeMap::new(),
            events: Events { slewed: 1, saturated: 2000, ..Events::default() },
            spans: Spans {
                slewed: Span { times: 1, seconds: 0.001 },
                saturated: Span { times: 3, seconds: 2.0 },
                ..Spans::default()
            },
        }
    }

    fn value<'a>(rows: &'a [(&str, String)], name: &str) -> &'a str {
        &rows.iter().find(|(known, _)| *known == name).unwrap_or_else(|| panic!("no row {name}: {rows:?}")).1
    }

    #[test]
    fn felt_quantities_come_first_in_suitable_units() {
        let rows = measured(&summary());
        let first: Vec<&str> = rows[..5].iter().map(|(name, _)| *name).collect();
        assert_eq!(
            first,
            [
                "touch",
                "deepest penetration",
                "largest force sent to the device",
                "contacts",
                "largest coupling stretch"
            ]
        );
        for (name, expected) in [
            ("touch", "first after 412 ms"),
            ("deepest penetration", "0.0430 mm"),
            ("largest force sent to the device", "1.23 N"),
            ("contacts", "at most 1,204, 3 at the end"),
            ("largest coupling stretch", "0.430 mm"),
            ("safety limits", "all kept"),
            ("settings without effect", "search.clusters: contacts are constraints"),
            ("lowest net energy at the device (negative: created)", "-1.00 µJ"),
            ("haptic rate", "1.00 kHz, 9,999 steps"),
            ("haptic step", "median 17.0 µs, p99 24.1 µs, p99.9 30.0 µs, max 1.20 ms"),
            ("deadlines", "1 of 10,000 deadlines missed: 1 because the machine woke the thread late."),
        ] {
            assert_eq!(value(&rows, name), expected, "{name}");
        }
        assert!(
            value(&rows, "slewed").starts_with("once, for 1.00 ms: the rate of change of the wrench"),
            "{rows:?}"
        );
        assert!(value(&rows, "saturated").starts_with("3 times, for 2.00 s in all: "), "{rows:?}");
    }

    #[test]
    fn depth_of_zero_is_explained() {
        let held = Summary { depth_max: 0.0, ..summary() };
        assert_eq!(
            value(&measured(&held), "deepest penetration"),
            "0: contacts were held within the tolerance of 0.100 mm, before surfaces met"
        );
        let stages = [("contact response", "constraints".to_owned())].into();
        let constrained = Summary { stages, ..held.clone() };
        assert_eq!(
            value(&measured(&constrained), "deepest penetration"),
            "0: contacts kept the surfaces from overlapping"
        );
        let nothing = Summary { first_touch_s: None, ..held };
        let rows = measured(&nothing);
        assert_eq!(rows[0], ("touch", "nothing was touched".to_owned()));
        assert_eq!(value(&rows, "deepest penetration"), "0: nothing was touched");
    }

    #[test]
    fn simulated_clock_is_never_late() {
        let mut simulated = summary();
        simulated.haptic.scheduling = "lockstep".to_owned();
        simulated.contact.longer_than_slot = Some(2);
        let rows = measured(&simulated);
        assert!(rows.iter().all(|(name, _)| !name.starts_with("wake-up")), "{rows:?}");
        assert!(value(&rows, "contact loop").starts_with("2 queries took longer"), "{rows:?}");
    }
}
