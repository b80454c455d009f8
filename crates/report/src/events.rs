//! Explanations of a session's events.

use palpate::Events;

/// Field name and meaning of each event of [`Events`].
pub const EVENTS: [(&str, &str); 33] = [
    (
        "device_refused",
        "the device did not answer, reported a motion that is not finite, or refused a wrench",
    ),
    (
        "device_jumped",
        "the device reported a position that a hand cannot reach so fast; its last valid pose was held",
    ),
    ("device_stale", "the device repeated its previous reading, with the same time; its velocity was kept"),
    (
        "rebased",
        "the device returned at another pose than it was lost at; the object stayed, and the hand continues from there",
    ),
    (
        "waited",
        "the object was held back, since it could have touched surfaces that no contact query had found yet",
    ),
    ("withheld", "the driver had sent zero instead of the wrench, which was then ramped up from zero"),
    ("late", "a step came late while the hand kept moving; the wrench was ramped up from zero"),
    (
        "runaway",
        "the handle moved along the wrench faster than a hand lets it; the wrench was dropped and ramped up from zero",
    ),
    (
        "energy_created",
        "more energy had come out than can have been stored; the wrench was dropped and ramped up from zero",
    ),
    ("hot", "actuators exceeded their continuous rating; the wrench was limited below its peak"),
    ("device_ended", "the replayed motion had ended"),
    ("step_refused", "the step had no finite solution; the object stood still and no wrench was sent"),
    ("reseated", "20 steps in a row failed; the object was moved to the hand"),
    (
        "contacts_unsettled",
        "the set of pushing contacts was still changing when the step ended; one may have been left out",
    ),
    ("step_unconverged", "the integrator did not converge; its last iterate was used"),
    ("saturated", "the wrench was reduced towards the device's peak"),
    ("slewed", "the rate of change of the wrench was limited to what the device can follow"),
    ("faded", "the wrench was faded out or in because contact models were overdue"),
    (
        "engaging",
        "the wrench was ramped up from zero: after the start, a failure of the device, or the clutch",
    ),
    ("clutched", "the clutch was held: the device moved without the object"),
    ("reaction_dropped", "a force on a scene object was lost because its queue was full"),
    (
        "damped",
        "the passivity controller added damping because more energy came out of the session than went in",
    ),
    (
        "proxy_engaged",
        "contacts pushed the object back because it was too deep in a surface or had passed through one",
    ),
    (
        "texture_undersampled",
        "a textured contact slid too far between two contact steps: raise the contact rate, or make the texture coarser",
    ),
    (
        "texture_folded",
        "part of a textured surface overhangs as seen along the contact normal, so its depth is approximate",
    ),
    ("texture_backend_lost", "the backend of textured contacts failed; the CPU took over"),
    (
        "contact_overflow",
        "there were more contacts than a contact model holds; the shallowest were left out: lower the number of clusters",
    ),
    ("contact_refused", "a contact query was given a pose, or found a contact, that is not finite"),
    ("not_converged", "the distance of two convex patches did not converge"),
    ("edit_refused", "a change of the scene could not be made"),
    ("model_dropped", "a contact model was lost because the haptic loop had not fetched earlier ones"),
    (
        "contact_thread_lost",
        "the contact thread has ended by a panic; no more contacts are found, and the wrench has faded",
    ),
    ("record_dropped", "a row of the recording was lost because the recorder could not keep up"),
];

/// Returns the events that happened: name, count and meaning.
pub(crate) fn happened(events: &Events) -> Vec<(&'static str, u64, &'static str)> {
    let counts = serde_json::to_value(events).unwrap_or_default();
    let count = |name: &str| counts.get(name).and_then(serde_json::Value::as_u64).unwrap_or(0);
    let named = EVENTS.into_iter().map(|(name, meaning)| (name, count(name), meaning));
    named.filter(|(_, count, _)| *count > 0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_event_is_explained_once() {
        let fields = serde_json::to_value(Events::default()).expect("JSON");
        let fields = fields.as_object().expect("fields");
        for name in fields.keys() {
            let found: Vec<_> = EVENTS.iter().filter(|(known, _)| known == name).collect();
            assert_eq!(found.len(), 1, "{name}: explain it in EVENTS");
            assert!(found[0].1.len() > 20 && !found[0].1.contains('_'), "{name}");
        }
        assert_eq!(fields.len(), EVENTS.len(), "an event in EVENTS is gone");
    }

    #[test]
    fn events_that_did_not_happen_are_left_out() {
        assert!(happened(&Events::default()).is_empty());
        let events = Events { slewed: 3, record_dropped: 1, ..Events::default() };
        let found: Vec<_> = happened(&events).into_iter().map(|(name, count, _)| (name, count)).collect();
        assert_eq!(found, [("slewed", 3), ("record_dropped", 1)]);
    }
}
