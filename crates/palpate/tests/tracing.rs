//! Spans and events for `tracing`: they are emitted at the beginning and the end of work, never by the loops'
//! threads.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::thread::ThreadId;

use palpate::device::{Emulation, IntendedPath};
use palpate::{HapticRenderer, Object, Pose};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Metadata, Subscriber};

/// Subscriber that notes the names of spans and events, and the threads that emit them.
#[derive(Clone, Default)]
struct Notes(Arc<Mutex<Vec<(&'static str, ThreadId)>>>);

impl Notes {
    fn note(&self, metadata: &Metadata<'_>) {
        if metadata.target().starts_with("palpate") {
            let mut notes = self.0.lock().expect("nobody panics");
            notes.push((metadata.name(), std::thread::current().id()));
        }
    }
}

impl Subscriber for Notes {
    fn enabled(&self, _: &Metadata<'_>) -> bool {
        true
    }

    fn new_span(&self, span: &Attributes<'_>) -> Id {
        self.note(span.metadata());
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        self.note(event.metadata());
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

#[test]
fn sessions_emit_spans_and_loops_emit_nothing() {
    let notes = Notes::default();
    tracing::subscriber::set_global_default(notes.clone()).expect("the first");
    let probe = Object::model("ellipsoid@500").expect("a model");
    let device = Emulation::default().open(IntendedPath::from(Pose::IDENTITY)).expect("a device");
    let renderer = HapticRenderer::builder(probe.clone())
        .touching(probe, Pose::IDENTITY)
        .on(Box::new(device))
        .expect("a renderer");
    let session =
        renderer.run_realtime(0.2, &AtomicBool::new(false), |_| Ok::<_, std::convert::Infallible>(()));
    assert!(session.is_ok_and(|session| session.haptic.steps > 0 && session.contact.query.count() > 0));
    let notes = notes.0.lock().expect("nobody panics");
    for name in ["open", "new", "run_realtime"] {
        assert!(notes.iter().any(|(noted, _)| *noted == name), "{name} of {notes:?}");
    }
    let here = std::thread::current().id();
    assert!(notes.iter().all(|(_, thread)| *thread == here), "{notes:?}");
}
