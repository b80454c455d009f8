//! The events of a session in plain words.

use palpate::Events;

/// Each event of [`Events`] by the name of its field, and what it means.
pub const EVENTS: [(&str, &str); 32] = [
    (
        "device_refused",
        "the device did not answer, reported a motion that is not finite, or refused a wrench",
    ),
    (
        "device_jumped",
        "the device reported a place that no hand could have reached so fast; its last good pose was held",
    ),
    ("device_stale", "the device's reading was the one before, by its time; its velocity went on"),
    (
        "rebased",
        "the device was found elsewhere than it was lost; the object stayed, and the hand went on from there",
    ),
    ("withheld", "the driver had sent zero in place of the wrench, which then came up from zero"),
    ("late", "a step came late while the hand moved on; the wrench came up from zero"),
    (
        "runaway",
        "the handle ran along the wrench faster than a hand lets it; the wrench was dropped and came up from zero",
    ),
    (
        "energy_created",
        "more energy had come out than can have been stored; the wrench was dropped and came up from zero",
    ),
    ("hot", "actuators were asked for more than they can keep up, and given less than the peak"),
    ("device_ended", "the replayed motion had come to its end"),
    ("step_refused", "the step had no finite solution; the object stood still and no wrench was sent"),
    ("reseated", "no step could be taken 20 times in a row; the object was put where the hand is"),
    (
        "contacts_unsettled",
        "which contacts push was still changing when the step ended, so that one may have been left out",
    ),
    ("step_unconverged", "the integrator did not converge; the step was taken as far as it came"),
    ("saturated", "the wrench was reduced towards what the device can render"),
    ("slewed", "the change of the wrench was limited to what the device can follow"),
    ("faded", "the wrench was faded out or in, for contact models were overdue"),
    (
        "engaging",
        "the wrench was coming up from zero: after the start, a failure of the device, or the clutch",
    ),
    ("clutched", "the clutch was held: the device moved without the object"),
    ("reaction_dropped", "a push on an object of the scene was lost for want of room"),
    (
        "damped",
        "the passivity controller added damping, for more energy came out of the session than went in",
    ),
    (
        "held_back",
        "contacts pushed the object back, for it was too deep in a surface or had passed through one",
    ),
    (
        "texture_undersampled",
        "a textured contact slid too far between two looks: run the contact loop faster, or make the texture coarser",
    ),
    (
        "texture_folded",
        "part of a textured surface overhangs as seen along the contact, so that its depth is approximate",
    ),
    ("texture_backend_lost", "what computed textured contacts failed; the processor went on"),
    (
        "contact_overflow",
        "there were more contacts than a contact model has room for; the shallowest were left out: lower the number of clusters",
    ),
    ("contact_refused", "a contact query was given a pose, or found a contact, that is not finite"),
    ("not_converged", "the distance of two convex patches did not converge"),
    ("edit_refused", "a change of the scene could not be made"),
    ("model_dropped", "a contact model was lost, for the haptic loop had not fetched the ones before"),
    (
        "contact_thread_lost",
        "the contact thread has ended by a panic; no more contacts are found, and the wrench has faded",
    ),
    ("record_dropped", "a row of the recording was lost, for the recorder could not keep up"),
];

/// The events that happened: name, how often, what it means.
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
    fn what_did_not_happen_is_left_out() {
        assert!(happened(&Events::default()).is_empty());
        let events = Events { slewed: 3, record_dropped: 1, ..Events::default() };
        let found: Vec<_> = happened(&events).into_iter().map(|(name, count, _)| (name, count)).collect();
        assert_eq!(found, [("slewed", 3), ("record_dropped", 1)]);
    }
}
