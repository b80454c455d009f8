//! Explanations of a session's events.

use palpate::Events;
use palpate::telemetry::{Span, Spans};

use crate::grouped;
use crate::quantity::quantity;

/// What the count of an event is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Counted {
    /// Times that it happened.
    Times,
    /// Haptic steps; it lasts for several, and a session's [`Spans`] have its duration.
    Lasting,
    /// Things of this name: one, and several.
    Things(&'static str, &'static str),
}

/// Field name, what is counted, and meaning of each event of [`Events`].
pub const EVENTS: [(&str, Counted, &str); 33] = [
    (
        "device_refused",
        Counted::Lasting,
        "the device did not answer, reported a motion that is not finite, or refused a wrench",
    ),
    (
        "device_jumped",
        Counted::Things("reading", "readings"),
        "the device reported a position that a hand cannot reach so fast; its last valid pose was held",
    ),
    (
        "device_stale",
        Counted::Lasting,
        "the device repeated its previous reading, with the same time; its velocity was kept",
    ),
    (
        "rebased",
        Counted::Times,
        "the device returned at another pose than it was lost at; the object stayed, and the hand continues from there",
    ),
    (
        "waited",
        Counted::Lasting,
        "the object was held back, since it could have touched surfaces that no contact query had found yet",
    ),
    (
        "withheld",
        Counted::Lasting,
        "the driver had sent zero instead of the wrench, which was then ramped up from zero",
    ),
    (
        "late",
        Counted::Times,
        "a step came late while the hand kept moving; the wrench was ramped up from zero",
    ),
    (
        "runaway",
        Counted::Times,
        "the handle moved along the wrench faster than a hand lets it; the wrench was dropped and ramped up from zero",
    ),
    (
        "energy_created",
        Counted::Times,
        "more energy had come out than can have been stored; the wrench was dropped and ramped up from zero",
    ),
    (
        "hot",
        Counted::Lasting,
        "actuators exceeded their continuous rating; the wrench was limited below its peak",
    ),
    ("device_ended", Counted::Lasting, "the replayed motion had ended"),
    (
        "step_refused",
        Counted::Lasting,
        "steps had no finite solution; the object stood still and no wrench was sent",
    ),
    ("reseated", Counted::Times, "20 steps in a row failed; the object was moved to the hand"),
    (
        "contacts_unsettled",
        Counted::Things("haptic step", "haptic steps"),
        "the set of pushing contacts was still changing when the step ended; one may have been left out",
    ),
    (
        "step_unconverged",
        Counted::Things("haptic step", "haptic steps"),
        "the integrator did not converge; its last iterate was used",
    ),
    ("saturated", Counted::Lasting, "the wrench was reduced towards the device's peak"),
    (
        "slewed",
        Counted::Lasting,
        "the rate of change of the wrench was limited to what the device can follow",
    ),
    ("faded", Counted::Lasting, "the wrench was faded out or in because contact models were overdue"),
    (
        "engaging",
        Counted::Lasting,
        "the wrench was ramped up from zero: after the start, a failure of the device, or the clutch",
    ),
    ("clutched", Counted::Lasting, "the clutch was held: the device moved without the object"),
    (
        "reaction_dropped",
        Counted::Things("push", "pushes"),
        "a force on a scene object was lost because its queue was full: take reactions in every step of the host",
    ),
    (
        "damped",
        Counted::Lasting,
        "the passivity controller added damping because more energy came out of the session than went in",
    ),
    (
        "proxy_engaged",
        Counted::Things("contact step", "contact steps"),
        "contacts pushed the object back because it was too deep in a surface or had passed through one",
    ),
    (
        "texture_undersampled",
        Counted::Things("textured contact", "textured contacts"),
        "a textured contact slid too far between two contact steps: raise the contact rate, or make the texture coarser",
    ),
    (
        "texture_folded",
        Counted::Things("part of a textured contact", "parts of textured contacts"),
        "part of a textured surface overhangs as seen along the contact normal, so its depth is approximate",
    ),
    (
        "texture_backend_lost",
        Counted::Things("contact step", "contact steps"),
        "the backend of textured contacts failed, was late or had no room; the CPU took over",
    ),
    (
        "contact_overflow",
        Counted::Things("contact", "contacts"),
        "there were more contacts than a step holds; the shallowest or farthest were left out: give fewer clusters, or objects with coarser meshes",
    ),
    (
        "contact_refused",
        Counted::Things("contact or query", "contacts or queries"),
        "a contact query was given a pose, or found a contact, that is not finite",
    ),
    (
        "not_converged",
        Counted::Things("pair of patches", "pairs of patches"),
        "the distance of two convex patches did not converge",
    ),
    (
        "edit_refused",
        Counted::Things("change", "changes"),
        "a change of the scene could not be made: the object is not there, or its texture cannot be rendered",
    ),
    (
        "model_dropped",
        Counted::Things("contact model", "contact models"),
        "a contact model was lost because the haptic loop had not fetched earlier ones: see the deadlines",
    ),
    (
        "contact_thread_lost",
        Counted::Times,
        "the contact thread has ended by a panic; no more contacts are found, and the wrench has faded",
    ),
    (
        "record_dropped",
        Counted::Things("row", "rows"),
        "a row of the recording was lost because the recorder could not keep up: record to a faster disk, or at a lower rate",
    ),
];

/// Returns the events that happened: name, count in words, and meaning.
pub(crate) fn happened(events: &Events, spans: &Spans) -> Vec<(&'static str, String, &'static str)> {
    let counts = serde_json::to_value(events).unwrap_or_default();
    let count = |name: &str| counts.get(name).and_then(serde_json::Value::as_u64).unwrap_or(0);
    let named = EVENTS.into_iter().map(|(name, counted, meaning)| (name, counted, count(name), meaning));
    let happened = named.filter(|(.., count, _)| *count > 0);
    happened
        .map(|(name, counted, count, meaning)| {
            let span = span_of(spans, name).filter(|span| span.times > 0);
            let words = match (counted, span) {
                (_, Some(Span { times: 1, seconds })) => format!("once, for {}", quantity(seconds, "s")),
                (_, Some(Span { times, seconds })) => {
                    format!("{}, for {} in all", in_words(times), quantity(seconds, "s"))
                }
                (Counted::Things(one, _), None) if count == 1 => format!("1 {one}"),
                (Counted::Things(_, several), None) => format!("{} {several}", grouped(count as usize)),
                (Counted::Times | Counted::Lasting, None) => in_words(count),
            };
            (name, words, meaning)
        })
        .collect()
}

/// How often, and how long, an event was that lasts.
fn span_of(spans: &Spans, name: &str) -> Option<Span> {
    let spans = serde_json::to_value(spans).ok()?;
    let span = spans.get(name)?;
    Some(Span { times: span.get("times")?.as_u64()?, seconds: span.get("seconds")?.as_f64()? })
}

/// How often something happened.
pub(crate) fn in_words(count: u64) -> String {
    if count == 1 { "once".to_owned() } else { format!("{} times", grouped(count as usize)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_event_is_explained_once() {
        let fields = serde_json::to_value(Events::default()).expect("JSON");
        let fields = fields.as_object().expect("fields");
        for name in fields.keys() {
            let found: Vec<_> = EVENTS.iter().filter(|(known, ..)| known == name).collect();
            assert_eq!(found.len(), 1, "{name}: explain it in EVENTS");
            assert!(found[0].2.len() > 20 && !found[0].2.contains('_'), "{name}");
            let lasts = span_of(&Spans::default(), name).is_some();
            assert_eq!(lasts, found[0].1 == Counted::Lasting, "{name}: what is counted?");
        }
        assert_eq!(fields.len(), EVENTS.len(), "an event in EVENTS is gone");
    }

    /// What was lost for want of room or time, by name, comes with a remedy.
    #[test]
    fn limits_that_were_reached_come_with_a_remedy() {
        for name in ["contact_overflow", "reaction_dropped", "model_dropped", "record_dropped"] {
            let (.., meaning) = EVENTS.iter().find(|(known, ..)| *known == name).expect("an event");
            let remedy = meaning.rsplit_once(": ").map(|(_, remedy)| remedy);
            let begins = |word| remedy.is_some_and(|remedy| remedy.starts_with(word));
            assert!(["give", "take", "see", "record"].into_iter().any(begins), "{name}: {meaning}");
        }
    }

    #[test]
    fn counts_are_of_what_is_named() {
        assert!(happened(&Events::default(), &Spans::default()).is_empty());
        let events = Events {
            engaging: 198,
            waited: 690,
            record_dropped: 1,
            contact_overflow: 1200,
            late: 2,
            ..Events::default()
        };
        let spans = Spans {
            engaging: Span { times: 1, seconds: 0.198 },
            waited: Span { times: 3, seconds: 0.69 },
            ..Spans::default()
        };
        let found: Vec<_> =
            happened(&events, &spans).into_iter().map(|(name, words, _)| (name, words)).collect();
        let expected = [
            ("waited", "3 times, for 690 ms in all"),
            ("late", "2 times"),
            ("engaging", "once, for 198 ms"),
            ("contact_overflow", "1,200 contacts"),
            ("record_dropped", "1 row"),
        ];
        assert_eq!(found, expected.map(|(name, words)| (name, words.to_owned())));
    }
}
