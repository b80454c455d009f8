//! A session in threads of its own, for a host that has other things to do.

use std::any::Any;
use std::convert::Infallible;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

use palpate_core::Pose;
use palpate_device::DeviceError;

use crate::contact::monitor::ContactMonitor;
use crate::haptic::reactions::Reactions;
use crate::run::renderer::HapticRenderer;
use crate::run::session::Session;
use crate::run::settings_editor::SettingsEditor;
use crate::scene::editor::SceneEditor;
use crate::tool::Tool;
use crate::tool::rigid::Rigid;

/// A session that runs, and what a host does with it. It ends when its [`handle`](Self::handle) is stopped or dropped.
///
/// The parts can be taken apart, each to a thread of its own, with [`split`](Self::split) or by destructuring:
///
/// ```
/// # use palpate::device::Emulation;
/// # use palpate::{HapticRenderer, Object, Pose};
/// # let device = Box::new(Emulation::default().open(Pose::IDENTITY)?);
/// # let renderer = HapticRenderer::builder(Object::model("ellipsoid@500")?).on(device)?;
/// let (handle, mut scene, contacts) = renderer.spawn()?.split();
/// # let ball = Object::model("golf-ball@2000")?;
/// let editing = std::thread::spawn(move || scene.add(&ball, Pose::IDENTITY));
/// # drop(contacts);
/// # editing.join().expect("no panic")?;
/// let session = handle.stop()?;
/// # assert_eq!(session.summary().events.edit_refused, 0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct RunningSession<T: Tool = Rigid> {
    /// Changes its scene.
    pub scene: SceneEditor,
    /// Changes its settings.
    pub settings: SettingsEditor,
    /// Shows the contacts of each body.
    pub contacts: T::PerBody<ContactMonitor>,
    /// Reports what contacts push the scene's objects with.
    pub reactions: Reactions,
    /// Shows its steps, and ends it.
    pub handle: SessionHandle<T>,
}

/// Shows the steps of a session that runs in threads of its own. The session ends when this is [stopped](Self::stop) or
/// dropped; the device is sent a wrench of zero then.
#[derive(Debug)]
pub struct SessionHandle<T: Tool = Rigid> {
    latest: triple_buffer::Output<Option<T::Record>>,
    stop: Arc<AtomicBool>,
    device_error: Arc<OnceLock<DeviceError>>,
    /// `None` once it has been joined.
    thread: Option<JoinHandle<Session>>,
}

/// A panic ended a session: of its device's driver, as a rule, for the engine's loops do not panic. What the session
/// measured is lost.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a panic ended the session: {message}")]
pub struct SessionPanic {
    /// What the panic said.
    pub message: String,
}

impl SessionPanic {
    fn new(panic: &(dyn Any + Send)) -> Self {
        let text = panic.downcast_ref::<&str>().copied();
        let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
        Self { message: text.unwrap_or("it did not say why").to_owned() }
    }
}

impl<T: Tool> HapticRenderer<T> {
    /// Renders in real time, in threads of its own, until it is stopped. Editors, watches and reactions that were taken of the
    /// renderer before work on.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn spawn(mut self) -> std::io::Result<RunningSession<T>> {
        let (scene, contacts, reactions) = (self.scene_editor(), self.contact_monitor(), self.reactions());
        let settings = self.settings_editor();
        let device_error = self.haptic.shared_device_error();
        let (mut shown, latest) = triple_buffer::triple_buffer(&None);
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        let run = move || {
            let sink = |record: &T::Record| {
                shown.write(Some(*record));
                Ok::<(), Infallible>(())
            };
            match self.run_realtime(f64::INFINITY, &flag, sink) {
                Ok(session) => session,
                Err(never) => match never {},
            }
        };
        let thread = std::thread::Builder::new().name("palpate".to_owned()).spawn(run)?;
        let handle = SessionHandle { latest, stop, device_error, thread: Some(thread) };
        Ok(RunningSession { scene, settings, contacts, reactions, handle })
    }
}

impl<T: Tool> RunningSession<T> {
    /// The handle, the editor of the scene and the watch of contacts, which may each go to another thread. Destructuring gives the
    /// editor of settings and the reactions as well.
    pub fn split(self) -> (SessionHandle<T>, SceneEditor, T::PerBody<ContactMonitor>) {
        (self.handle, self.scene, self.contacts)
    }

    /// As [`SessionHandle::latest`].
    pub fn latest(&mut self) -> Option<&T::Record> {
        self.handle.latest()
    }

    /// As [`SessionHandle::is_running`].
    pub fn is_running(&self) -> bool {
        self.handle.is_running()
    }

    /// As [`SessionHandle::device_error`].
    pub fn device_error(&self) -> Option<&DeviceError> {
        self.handle.device_error()
    }

    /// As [`SessionHandle::stop`].
    ///
    /// # Errors
    /// If the device's driver panicked.
    pub fn stop(self) -> Result<Session, SessionPanic> {
        self.handle.stop()
    }
}

impl<T: Tool> SessionHandle<T> {
    /// The latest step that is known, without waiting for one: some milliseconds old. None before the first.
    pub fn latest(&mut self) -> Option<&T::Record> {
        self.latest.read().as_ref()
    }

    /// Whether it still runs: it does until it is stopped, unless the device's driver panics.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }

    /// The first error that the device gave, if any. The session goes on after one: it sends no wrench until the device
    /// answers again.
    pub fn device_error(&self) -> Option<&DeviceError> {
        self.device_error.get()
    }

    /// Ends the session.
    ///
    /// # Errors
    /// If the device's driver panicked.
    pub fn stop(mut self) -> Result<Session, SessionPanic> {
        self.stop.store(true, Ordering::Release);
        // It is there until this or a drop.
        #[expect(clippy::expect_used, reason = "taken here and in drop alone")]
        let thread = self.thread.take().expect("a thread that has not been joined");
        thread.join().map_err(|panic| SessionPanic::new(panic.as_ref()))
    }
}

impl<T: Tool> Drop for SessionHandle<T> {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A driver's panic ended the session already.
            let _ = thread.join();
        }
    }
}

impl RunningSession {
    /// As [`SessionHandle::object_pose`].
    pub fn object_pose(&mut self) -> Option<Pose> {
        self.handle.object_pose()
    }
}

impl SessionHandle {
    /// Pose of the grasped object's mesh frame in the world, as of the latest step.
    pub fn object_pose(&mut self) -> Option<Pose> {
        self.latest().map(|record| record.object)
    }
}
