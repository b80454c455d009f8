//! Sessions in their own threads, beside the threads of a host.

use std::any::Any;
use std::convert::Infallible;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

use palpate_core::Pose;
use palpate_device::DeviceError;

use crate::contact_loop::monitor::ContactMonitor;
use crate::haptic::reactions::Reactions;
use crate::run::renderer::HapticRenderer;
use crate::run::session::Session;
use crate::run::settings_editor::SettingsEditor;
use crate::scene::editor::SceneEditor;
use crate::tool::Tool;
use crate::tool::rigid::Rigid;

/// Running session, with its editors and monitors. It ends when its [`handle`](Self::handle) is stopped or
/// dropped.
///
/// [`split`](Self::split) or destructuring it allows each part to move to another thread:
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
    /// Editor of the scene.
    pub scene: SceneEditor,
    /// Editor of the settings.
    pub settings: SettingsEditor,
    /// Monitor of the contacts of each body.
    pub contacts: T::PerBody<ContactMonitor>,
    /// Queue of contact reactions on scene objects.
    pub reactions: Reactions,
    /// Handle that shows the steps, and ends the session.
    pub handle: SessionHandle<T>,
}

/// Handle of a running session: shows its steps, and ends it. When it is [stopped](Self::stop) or dropped,
/// the session ends, and the device receives a wrench of zero.
#[derive(Debug)]
pub struct SessionHandle<T: Tool = Rigid> {
    latest: triple_buffer::Output<Option<T::Record>>,
    stop: Arc<AtomicBool>,
    device_error: Arc<OnceLock<DeviceError>>,
    /// `None` once it has been joined.
    thread: Option<JoinHandle<Session>>,
}

/// A panic ended a session: usually one of the device's driver, since the engine's loops do not panic. The
/// session's measurements are lost.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a panic ended the session: {message}")]
pub struct SessionPanic {
    /// Message of the panic.
    pub message: String,
}

impl SessionPanic {
    fn new(panic: &(dyn Any + Send)) -> Self {
        let text = panic.downcast_ref::<&str>().copied();
        let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
        Self { message: text.unwrap_or("no message").to_owned() }
    }
}

impl<T: Tool> HapticRenderer<T> {
    /// Renders in real time, in its own threads, until it is stopped. Editors, monitors and reactions that
    /// were taken from the renderer before continue to work.
    ///
    /// # Errors
    /// If the system refuses a thread.
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
    /// Splits the session into its handle, the editor of the scene and the contact monitor, which may each
    /// move to another thread. Destructuring gives the editor of settings and the reactions as well.
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
    /// Record of the latest step, some milliseconds old; `None` before the first. It does not wait for a
    /// step.
    pub fn latest(&mut self) -> Option<&T::Record> {
        self.latest.read().as_ref()
    }

    /// Whether the session still runs: until it is stopped, or the device's driver panics.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }

    /// First error of the device, if any. The session continues after an error, and sends no wrench until the
    /// device answers again.
    pub fn device_error(&self) -> Option<&DeviceError> {
        self.device_error.get()
    }

    /// Ends the session.
    ///
    /// # Errors
    /// If the device's driver panicked.
    pub fn stop(mut self) -> Result<Session, SessionPanic> {
        self.stop.store(true, Ordering::Release);
        #[expect(clippy::expect_used, reason = "the thread is only taken here and in drop")]
        let thread = self.thread.take().expect("a thread that has not been joined");
        thread.join().map_err(|panic| SessionPanic::new(panic.as_ref()))
    }
}

impl<T: Tool> Drop for SessionHandle<T> {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // The result is not needed; a panic of the driver has already ended the session.
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
