//! The backend that computes texture depths, and its replacement while a session runs.

use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::time::Duration;

use palpate_texture_pd::{Backend, DepthQuery, DepthSettings, Fallback, SurfaceSet, TextureContact};

use super::error::TextureError;
use crate::settings::TextureBackend;
use crate::telemetry::Events;

/// Longest time that a contact step waits for a GPU before the processor computes its textured contacts: some
/// periods of a contact loop, which a hand feels as a short lag.
const GPU_DEADLINE: Duration = Duration::from_millis(20);

/// A backend, or why there is none.
type Made = Result<Box<dyn Backend>, TextureError>;

/// The processor, or another backend with the processor to fall back on; and the backend that replaces it
/// once it is made.
#[derive(Default)]
pub(super) struct Computing {
    backend: Fallback,
    /// Failures of the backend that events already count.
    counted_failures: u64,
    coming: Option<Receiver<Made>>,
}

impl Computing {
    /// Replaces the backend.
    pub fn set(&mut self, mut backend: Box<dyn Backend>) {
        backend.set_deadline(GPU_DEADLINE);
        *self = Self { backend: Fallback::new(backend), ..Self::default() };
    }

    /// Replaces the backend once a thread has made another.
    pub fn set_when_made(&mut self, make: impl FnOnce() -> Made + Send + 'static) {
        let (send, coming) = mpsc::sync_channel(1);
        // Without a thread the channel is closed, which the next step counts.
        let _ = std::thread::Builder::new().name("palpate-gpu-start".into()).spawn(move || {
            // The receiver is gone where the scene has no texture any more.
            let _ = send.send(make());
        });
        self.coming = Some(coming);
    }

    /// Name of the backend.
    pub fn name(&self) -> &str {
        self.backend.name()
    }

    /// Whether another backend than the processor computes.
    pub fn has_other(&self) -> bool {
        self.backend.has_other()
    }

    /// Replaces the backend by the one that was made since.
    pub fn update(&mut self, events: &mut Events) {
        match self.coming.as_ref().map(Receiver::try_recv) {
            None | Some(Err(TryRecvError::Empty)) => {}
            Some(Ok(Ok(backend))) => self.set(backend),
            Some(Ok(Err(_)) | Err(TryRecvError::Disconnected)) => {
                events.texture_backend_lost += 1;
                self.coming = None;
            }
        }
    }

    /// Computes the depths of contacts into `query`; `false` if that failed, which is counted.
    pub fn run(
        &mut self,
        query: &mut DepthQuery,
        surfaces: &SurfaceSet,
        contacts: &[TextureContact],
        settings: &DepthSettings,
        events: &mut Events,
    ) -> bool {
        let computed = query.run(surfaces, contacts, settings, &mut self.backend).is_ok();
        let failures = self.backend.failures();
        events.texture_backend_lost += failures - std::mem::replace(&mut self.counted_failures, failures);
        events.contact_refused += u64::from(!computed);
        computed
    }
}

/// Maker of a backend, which takes long.
pub(super) type Maker = Box<dyn FnOnce() -> Made + Send>;

/// Returns the maker of the backend that the settings ask for, if that is not the processor: the GPU's, or
/// the faster of both for `typical` contacts, as many as there may be with one object.
#[cfg(feature = "gpu")]
pub(super) fn maker(
    chosen: TextureBackend,
    surfaces: &SurfaceSet,
    settings: DepthSettings,
    typical: impl FnOnce() -> Vec<TextureContact>,
) -> Option<Maker> {
    if chosen == TextureBackend::Processor {
        return None;
    }
    let (contacts, surfaces) = (typical(), surfaces.clone());
    Some(Box::new(move || {
        if chosen == TextureBackend::Auto {
            return Ok(Box::new(palpate_texture_pd::AutoBackend::new(&surfaces, &contacts, &settings)?));
        }
        let mut gpu = palpate_texture_pd::WgpuBackend::new()?;
        // The first batch uploads the textures. If it fails, later ones fail as well, which is counted.
        let _ = DepthQuery::new().run(&surfaces, &contacts, &settings, &mut gpu);
        Ok(Box::new(gpu))
    }))
}

/// Returns the maker of the backend that the settings ask for: a GPU's cannot be made.
#[cfg(not(feature = "gpu"))]
pub(super) fn maker(
    chosen: TextureBackend,
    _: &SurfaceSet,
    _: DepthSettings,
    _: impl FnOnce() -> Vec<TextureContact>,
) -> Option<Maker> {
    let missing = || -> Made {
        let reason = "palpate was built without its feature `gpu`".to_owned();
        Err(palpate_texture_pd::BackendError::NoAdapter { reason }.into())
    };
    (chosen == TextureBackend::Gpu).then(|| Box::new(missing) as Maker)
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use palpate_texture_pd::{BackendError, CpuBackend};

    use super::*;

    fn updated(computing: &mut Computing, events: &mut Events) {
        let begun = Instant::now();
        while computing.coming.is_some() {
            assert!(begun.elapsed().as_secs() < 60, "no backend was made");
            computing.update(events);
        }
    }

    #[test]
    fn the_processor_computes_until_another_backend_is_made() {
        let (mut computing, mut events) = (Computing::default(), Events::default());
        let (go, wait) = mpsc::channel::<()>();
        computing.set_when_made(move || {
            let _ = wait.recv();
            Ok(Box::new(CpuBackend::new()))
        });
        computing.update(&mut events);
        assert!(!computing.has_other() && computing.coming.is_some());
        go.send(()).expect("the thread waits");
        updated(&mut computing, &mut events);
        assert!(computing.has_other());
        assert_eq!(events, Events::default());
    }

    #[test]
    fn backends_that_cannot_be_made_are_counted() {
        let (mut computing, mut events) = (Computing::default(), Events::default());
        computing.set_when_made(|| Err(BackendError::NoAdapter { reason: "none".into() }.into()));
        updated(&mut computing, &mut events);
        // As without a thread.
        computing.coming = Some(mpsc::sync_channel(1).1);
        updated(&mut computing, &mut events);
        assert_eq!((events.texture_backend_lost, computing.name()), (2, "CPU"));
    }
}
