//! A session whose haptic loop and device are the host's: a simulator, a driver of its own, a game engine.
//!
//! Contacts are found in a thread of their own, as fast as they can be; the host's step is a haptic step, which does not
//! allocate, lock, block or panic, and uses the latest of them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use palpate_core::{Pose, Wrench};
use palpate_device::{DeviceError, DeviceState, HapticDevice, Specification};
use palpate_dynamics::BodyState;
use rtrb::{Consumer, RingBuffer};

use crate::contact::ContactUpdate;
use crate::contact::monitor::Watch;
use crate::haptic::HapticLoop;
use crate::haptic::reactions::Reactions;
use crate::run::realtime::{MODEL_RING, run_contact};
use crate::run::renderer::{HapticRenderer, RendererError};
use crate::run::settings_editor::SettingsEditor;
use crate::scene::Scene;
use crate::scene::editor::SceneEditor;
use crate::scene::object::Object;
use crate::settings::Settings;
use crate::telemetry::Events;
use crate::telemetry::record::Record;

/// A session that a host steps, and what else the host does with it. It comes apart, so that each part can go to a thread of its
/// own: `let HostedSession { stepper, scene, contacts, .. } = session;`.
#[derive(Debug)]
pub struct HostedSession {
    /// Changes its scene.
    pub scene: SceneEditor,
    /// Changes its settings.
    pub settings: SettingsEditor,
    /// Shows its contacts.
    pub contacts: Watch,
    /// Reports what contacts push the scene's objects with.
    pub reactions: Reactions,
    /// Takes its haptic steps.
    pub stepper: HostedStepper,
}

/// Takes the haptic steps of a session, in the thread that owns the device. The session's contact thread ends when this is
/// dropped.
#[derive(Debug)]
pub struct HostedStepper {
    haptic: HapticLoop,
    models: Consumer<ContactUpdate>,
    state: triple_buffer::Input<(f64, BodyState)>,
    now: f64,
    latest: Option<Record>,
    ended: Arc<AtomicBool>,
    /// Finds contacts. It ends before its time by a panic alone.
    contact_thread: Option<JoinHandle<()>>,
}

/// Why a hosted session could not be started.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// As with any session.
    #[error(transparent)]
    Renderer(#[from] RendererError),
    /// The system gives no thread.
    #[error("no thread for the contact loop: {0}")]
    Thread(#[from] std::io::Error),
}

impl HostedSession {
    /// Puts `probe` into the hand that holds a device of that specification, where the device now is, and `scene` around it.
    ///
    /// # Errors
    /// As [`HapticRenderer::new`], or if the system gives no thread.
    pub fn new(
        probe: Object,
        scene: Scene,
        specification: Specification,
        device: DeviceState,
        settings: Settings,
    ) -> Result<Self, HostError> {
        let theirs = Box::new(OfTheHost { specification, state: device });
        let mut renderer = HapticRenderer::new(probe, scene, theirs, settings)?;
        let (scene, contacts) = (renderer.scene_editor(), renderer.watch());
        let (settings, reactions) = (renderer.settings_editor(), renderer.reactions());
        let (haptic, mut contact, _) = renderer.into_loops();
        let (models_in, models) = RingBuffer::new(MODEL_RING);
        let (state, state_out) = triple_buffer::triple_buffer(&(0.0, *haptic.body_state()));
        let ended = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&ended);
        let contact_thread = std::thread::Builder::new()
            .name("palpate contacts".to_owned())
            .spawn(move || drop(run_contact(&mut contact, state_out, models_in, &flag)))?;
        let stepper = HostedStepper {
            haptic,
            models,
            state,
            now: 0.0,
            latest: None,
            ended,
            contact_thread: Some(contact_thread),
        };
        Ok(Self { scene, settings, contacts, reactions, stepper })
    }

    /// As [`HostedStepper::step`].
    pub fn step(&mut self, dt: f64, device: &DeviceState) -> Wrench {
        self.stepper.step(dt, device)
    }

    /// As [`HostedStepper::latest`].
    pub fn latest(&self) -> Option<&Record> {
        self.stepper.latest()
    }

    /// As [`HostedStepper::object_pose`].
    pub fn object_pose(&self) -> Pose {
        self.stepper.object_pose()
    }

    /// As [`HostedStepper::set_clutch`].
    pub fn set_clutch(&mut self, held: bool) {
        self.stepper.set_clutch(held);
    }

    /// As [`HostedStepper::events`].
    pub fn events(&self) -> Events {
        self.stepper.events()
    }
}

impl HostedStepper {
    /// A haptic step of `dt` seconds, the device being in a state: the wrench to send to it, in its axes, about its
    /// handle's origin. A `dt` that is not above 0 changes nothing, and gives the wrench of the last step. Of one above 20 ms and five
    /// periods no more than that is integrated.
    ///
    /// The host sends zero when it ends, before it drops this: nothing else does.
    pub fn step(&mut self, dt: f64, device: &DeviceState) -> Wrench {
        if !(dt > 0.0 && dt.is_finite()) {
            return self.latest.map_or(Wrench::ZERO, |record| record.coupling);
        }
        while let Ok(update) = self.models.pop() {
            self.haptic.update_contacts(&update);
        }
        self.now += dt;
        let record = self.haptic.step(device, self.now, dt);
        if self.contact_thread.as_ref().is_some_and(JoinHandle::is_finished) {
            self.haptic.telemetry_mut().events.contact_thread_lost = 1;
        }
        self.state.write((self.now, *self.haptic.body_state()));
        self.latest = Some(record);
        record.coupling
    }

    /// What the last step gave; none before the first.
    pub fn latest(&self) -> Option<&Record> {
        self.latest.as_ref()
    }

    /// Pose of the grasped object's mesh frame in the world.
    pub fn object_pose(&self) -> Pose {
        self.haptic.object_pose()
    }

    /// Holds the clutch, or lets it go ([`HapticLoop::set_clutch`]).
    pub fn set_clutch(&mut self, held: bool) {
        self.haptic.set_clutch(held);
    }

    /// What happened out of the ordinary in haptic steps.
    pub fn events(&self) -> Events {
        self.haptic.telemetry().events
    }
}

impl Drop for HostedStepper {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        if let Some(thread) = self.contact_thread.take() {
            // A panic of it was counted.
            let _ = thread.join();
        }
    }
}

/// The host's device as it was when the session began.
#[derive(Debug)]
struct OfTheHost {
    specification: Specification,
    state: DeviceState,
}

impl HapticDevice for OfTheHost {
    fn specification(&self) -> &Specification {
        &self.specification
    }

    fn read(&mut self, _: f64) -> Result<DeviceState, DeviceError> {
        Ok(self.state)
    }

    fn write(&mut self, _: &Wrench) -> Result<(), DeviceError> {
        Ok(())
    }

    fn close(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

#[cfg(all(test, feature = "models"))]
mod tests {
    use palpate_clod_build::unwatched;
    use palpate_core::glam::DVec3;
    use palpate_core::{Pose, Twist};
    use palpate_device::{Emulation, Status};

    use super::*;
    use crate::scene::object::{Object, OpenOptions};

    /// The thread that finds contacts panics while the hand presses: that is counted, and what it found last holds nothing.
    #[test]
    fn a_contact_thread_that_panics_is_told_and_its_planes_let_go() {
        let options = OpenOptions { cache: false, ..OpenOptions::default() };
        let open = |name| Object::open(name, &options, &mut unwatched).expect("a model");
        let [probe, plate] = ["ellipsoid@500", "ellipsoid@500"].map(open);
        let height = plate.bounding_radius();
        let scene = Scene::new().with(plate, Pose::from_translation(DVec3::NEG_Z * height));
        let specification = Emulation::default().specification;
        let at = |z: f64| DeviceState {
            time: 0.0,
            pose: Pose::from_translation(DVec3::Z * z),
            twist: Twist::ZERO,
            buttons: 0,
            status: Status::OK,
        };
        let above = 2.0 * height;
        let session = HostedSession::new(probe, scene, specification, at(above), Settings::default());
        let mut stepper = session.expect("a session").stepper;
        let mut steps = 0;
        let mut step = |stepper: &mut HostedStepper, z: f64| {
            steps += 1;
            let state = DeviceState { time: 1e-3 * f64::from(steps), ..at(z) };
            // As a host's clock does, so that contacts are found meanwhile.
            std::thread::sleep(std::time::Duration::from_micros(200));
            stepper.step(1e-3, &state).force.length()
        };
        let mut z = above;
        let mut force = 0.0;
        while force < 1.0 {
            assert!(z > -above, "nothing is felt");
            z -= 1e-4;
            force = step(&mut stepper, z);
        }
        stepper.ended.store(true, Ordering::Release);
        let panicking = std::thread::Builder::new().name("panics".into()).spawn(|| panic!("on purpose"));
        let found = stepper.contact_thread.replace(panicking.expect("a thread"));
        found.expect("a thread").join().expect("no panic");
        while !stepper.contact_thread.as_ref().is_some_and(JoinHandle::is_finished) {
            std::thread::yield_now();
        }
        assert_eq!(stepper.events().contact_thread_lost, 0);
        let after = (0..101).map(|_| step(&mut stepper, z)).last();
        assert_eq!((after, stepper.events().contact_thread_lost), (Some(0.0), 1));
    }
}
