//! A session in threads of its own, for a host that has other things to do.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use palpate_core::Pose;

use crate::reactions::Reactions;
use crate::record::Record;
use crate::renderer::HapticRenderer;
use crate::scene_editor::SceneEditor;
use crate::session::Session;
use crate::settings_editor::SettingsEditor;
use crate::watch::Watch;

/// A session that runs. It ends when it is [stopped](Self::stop) or dropped, and the device is sent a wrench of zero then.
#[derive(Debug)]
pub struct RunningSession {
    /// Changes its scene.
    pub scene: SceneEditor,
    /// Changes its settings.
    pub settings: SettingsEditor,
    /// Shows its contacts.
    pub contacts: Watch,
    /// Tells what its contacts push the scene's objects with.
    pub reactions: Reactions,
    latest: triple_buffer::Output<Option<Record>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Session>>,
}

impl HapticRenderer {
    /// Renders in real time, in threads of its own, until it is stopped.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn spawn(mut self) -> std::io::Result<RunningSession> {
        let (scene, contacts, reactions) = (self.scene_editor(), self.watch(), self.reactions());
        let settings = self.settings_editor();
        let (mut shown, latest) = triple_buffer::triple_buffer(&None);
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        let run = move || {
            let sink = |record: &Record| {
                shown.write(Some(*record));
                Ok::<(), Infallible>(())
            };
            match self.run_realtime(f64::INFINITY, &flag, sink) {
                Ok(session) => session,
                Err(never) => match never {},
            }
        };
        let thread = std::thread::Builder::new().name("palpate".to_owned()).spawn(run)?;
        Ok(RunningSession { scene, settings, contacts, reactions, latest, stop, thread: Some(thread) })
    }
}

impl RunningSession {
    /// The latest step that is known, without waiting for one: some milliseconds old. None before the first.
    pub fn latest(&mut self) -> Option<&Record> {
        self.latest.read().as_ref()
    }

    /// Pose of the grasped object's mesh frame in the world, as of the latest step.
    pub fn object_pose(&mut self) -> Option<Pose> {
        self.latest().map(|record| record.object)
    }

    /// Whether it still runs: it does until it is stopped, unless the device's driver panics.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }

    /// Ends the session.
    ///
    /// # Panics
    /// If the device's driver has.
    pub fn stop(mut self) -> Session {
        self.stop.store(true, Ordering::Release);
        // It is there until this or a drop.
        #[expect(clippy::expect_used, reason = "taken here and in drop alone")]
        let thread = self.thread.take().expect("a thread that has not been joined");
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

impl Drop for RunningSession {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A driver's panic ended the session already.
            let _ = thread.join();
        }
    }
}
