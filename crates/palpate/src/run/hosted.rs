//! Sessions whose haptic loop and device belong to a host: a simulator, its own driver, a game engine.
//!
//! Contacts are found in separate threads, as fast as possible. The host's step is a haptic step, which does
//! not allocate, lock, block or panic, and uses the latest contacts.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use palpate_core::{Pose, Wrench};
use palpate_device::{
    DeviceError, DeviceState, Gripper, GripperSpecification, GripperState, HapticDevice, Specification,
    Status,
};

use crate::contact_loop::monitor::ContactMonitor;
use crate::haptic::HapticLoop;
use crate::haptic::reactions::Reactions;
use crate::run::realtime::{ToContact, channels, run_contact};
use crate::run::renderer::{HapticRenderer, RendererError};
use crate::run::settings_editor::SettingsEditor;
use crate::scene::Scene;
use crate::scene::editor::SceneEditor;
use crate::scene::object::Object;
use crate::settings::Settings;
use crate::settings::gripper::GripperSettings;
use crate::telemetry::Events;
use crate::tool::Tool;
use crate::tool::hinged::{Hinged, HingedTool};
use crate::tool::rigid::Rigid;

/// Session that a host steps, with its editors and monitors. Destructure it to move each part to another
/// thread: `let HostedSession { stepper, scene, contacts, .. } = session;`.
#[derive(Debug)]
pub struct HostedSession<T: Tool = Rigid> {
    /// Editor of the scene.
    pub scene: SceneEditor,
    /// Editor of the settings.
    pub settings: SettingsEditor,
    /// Monitor of the contacts of each body.
    pub contacts: T::PerBody<ContactMonitor>,
    /// Queue of contact reactions on scene objects.
    pub reactions: Reactions,
    /// Stepper of the haptic loop.
    pub stepper: HostedStepper<T>,
}

/// Stepper of the haptic loop of a session, for the thread that owns the device. Dropping it ends the
/// session's contact threads.
#[derive(Debug)]
pub struct HostedStepper<T: Tool = Rigid> {
    haptic: HapticLoop<T>,
    contacts: Vec<ToContact>,
    now: f64,
    latest: Option<T::Record>,
    ended: Arc<AtomicBool>,
    /// Contact thread of each body. One that ends before the stepper is dropped has panicked.
    contact_threads: Vec<JoinHandle<()>>,
}

/// A hosted session could not be started.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// The renderer could not be made.
    #[error(transparent)]
    Renderer(#[from] RendererError),
    /// The system refuses a thread.
    #[error("no thread for the contact loop: {0}")]
    Thread(#[from] std::io::Error),
}

impl HostedSession {
    /// Makes a session with `probe` in the hand, at the present state of the host's device, and `scene`
    /// around it.
    ///
    /// # Errors
    /// As [`HapticRenderer::new`], or if the system refuses a thread.
    pub fn new(
        probe: Object,
        scene: Scene,
        specification: Specification,
        device: DeviceState,
        settings: Settings,
    ) -> Result<Self, HostError> {
        let device = Box::new(HostDevice { specification, state: device, gripper: None });
        HapticRenderer::new(probe, scene, device, settings)?.host()
    }

    /// As [`HostedStepper::step`].
    pub fn step(&mut self, dt: f64, device: &DeviceState) -> Wrench {
        self.stepper.step(dt, device)
    }

    /// As [`HostedStepper::object_pose`].
    pub fn object_pose(&self) -> Pose {
        self.stepper.object_pose()
    }
}

impl HostedSession<Hinged> {
    /// Makes a session with a hinged tool in the hand, at the present state of the host's device and angle of
    /// its gripper (rad), and `scene` around it.
    ///
    /// # Errors
    /// As [`HapticRenderer::hinged`], or if the system refuses a thread.
    pub fn hinged(
        tool: &HingedTool,
        scene: Scene,
        (specification, device): (Specification, DeviceState),
        (gripper_specification, gripper_angle): (GripperSpecification, f64),
        settings: Settings,
        gripper: &GripperSettings,
    ) -> Result<Self, HostError> {
        let fingers = HostGripper { specification: gripper_specification, angle: gripper_angle };
        let device = Box::new(HostDevice { specification, state: device, gripper: Some(fingers) });
        HapticRenderer::hinged(tool, scene, device, settings, gripper)?.host()
    }

    /// As [`HostedStepper::step`].
    pub fn step(&mut self, dt: f64, device: &DeviceState, gripper_angle: f64) -> (Wrench, f64) {
        self.stepper.step(dt, device, gripper_angle)
    }

    /// As [`HostedStepper::object_poses`].
    pub fn object_poses(&self) -> [Pose; 2] {
        self.stepper.object_poses()
    }
}

impl<T: Tool> HapticRenderer<T> {
    /// Turns the renderer into a session for a host that reads and writes the device itself, and starts its
    /// contact threads. The renderer's own device is dropped.
    ///
    /// # Errors
    /// If the system refuses a thread.
    pub fn host(mut self) -> Result<HostedSession<T>, HostError> {
        let (scene, contacts) = (self.scene_editor(), self.contact_monitor());
        let (settings, reactions) = (self.settings_editor(), self.reactions());
        let Self { haptic, contacts: loops, .. } = self;
        let ended = Arc::new(AtomicBool::new(false));
        let mut stepper = HostedStepper {
            haptic,
            contacts: Vec::new(),
            now: 0.0,
            latest: None,
            ended,
            contact_threads: Vec::new(),
        };
        for (body, mut contact) in loops.into_iter().enumerate() {
            let (to_contact, from_haptic) = channels(stepper.haptic.tool.body_state(body));
            let ended = Arc::clone(&stepper.ended);
            // If the system refuses this thread, dropping the stepper ends the ones already started.
            let thread = std::thread::Builder::new()
                .name("palpate contacts".to_owned())
                .spawn(move || drop(run_contact(&mut contact, from_haptic, &ended)))?;
            stepper.contacts.push(to_contact);
            stepper.contact_threads.push(thread);
        }
        Ok(HostedSession { scene, settings, contacts, reactions, stepper })
    }
}

impl<T: Tool> HostedSession<T> {
    /// As [`HostedStepper::latest`].
    pub fn latest(&self) -> Option<&T::Record> {
        self.stepper.latest()
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

impl<T: Tool> HostedStepper<T> {
    /// Takes a haptic step, if `dt` (s) is finite and above 0.
    fn advance(&mut self, dt: f64, device: &DeviceState, gripper_angle: Option<f64>) {
        if !(dt > 0.0 && dt.is_finite()) {
            return;
        }
        ToContact::receive(&mut self.contacts, &mut self.haptic);
        self.now += dt;
        let (record, _) = self.haptic.advance(Some(device), gripper_angle, self.now, dt);
        if self.contact_threads.iter().any(JoinHandle::is_finished) {
            self.haptic.telemetry_mut().events.contact_thread_lost = 1;
            self.haptic.end_contacts();
        }
        ToContact::send(&mut self.contacts, &self.haptic, self.now);
        self.latest = Some(record);
    }

    /// Record of the latest step; `None` before the first.
    pub fn latest(&self) -> Option<&T::Record> {
        self.latest.as_ref()
    }

    /// Holds or releases the clutch ([`HapticLoop::set_clutch`]).
    pub fn set_clutch(&mut self, held: bool) {
        self.haptic.set_clutch(held);
    }

    /// Counts of events in haptic steps.
    pub fn events(&self) -> Events {
        self.haptic.telemetry().events
    }
}

impl HostedStepper {
    /// Takes a haptic step of `dt` seconds, with the device's state. Returns the wrench to send to the
    /// device, in its axes, about its handle's origin. A `dt` that is not above 0 changes nothing, and
    /// returns the wrench of the latest step. At most 20 ms or five periods of `dt`, whichever is longer, are
    /// integrated.
    ///
    /// The host must send a wrench of zero to the device before it drops the stepper: the stepper does not.
    pub fn step(&mut self, dt: f64, device: &DeviceState) -> Wrench {
        self.advance(dt, device, None);
        self.latest.map_or(Wrench::ZERO, |record| record.coupling)
    }

    /// Pose of the grasped object's mesh frame in the world.
    pub fn object_pose(&self) -> Pose {
        self.haptic.object_pose()
    }
}

impl HostedStepper<Hinged> {
    /// Takes a haptic step as [`HostedStepper::step`], with the gripper's angle (rad). Returns the wrench to
    /// send to the device, and the torque (N·m) to send to the gripper; a positive one opens the gripper.
    pub fn step(&mut self, dt: f64, device: &DeviceState, gripper_angle: f64) -> (Wrench, f64) {
        self.advance(dt, device, Some(gripper_angle));
        self.latest.map_or((Wrench::ZERO, 0.0), |record| (record.coupling, record.torque))
    }

    /// Poses of the two bodies' mesh frames in the world.
    pub fn object_poses(&self) -> [Pose; 2] {
        self.haptic.object_poses()
    }
}

impl<T: Tool> Drop for HostedStepper<T> {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        for thread in self.contact_threads.drain(..) {
            // A panic of the thread was counted as an event.
            let _ = thread.join();
        }
    }
}

/// Host's device, in its state when the session began.
#[derive(Debug)]
struct HostDevice {
    specification: Specification,
    state: DeviceState,
    gripper: Option<HostGripper>,
}

/// Gripper of a host's device, at its angle when the session began.
#[derive(Debug)]
struct HostGripper {
    specification: GripperSpecification,
    angle: f64,
}

impl Gripper for HostGripper {
    fn specification(&self) -> &GripperSpecification {
        &self.specification
    }

    fn read(&mut self, now: f64) -> Result<GripperState, DeviceError> {
        // The trait promises a finite angle.
        let angle = if self.angle.is_finite() { self.angle } else { 0.0 };
        Ok(GripperState { time: now, angle, status: Status::OK })
    }

    fn write(&mut self, _: f64) -> Result<(), DeviceError> {
        Ok(())
    }
}

impl HapticDevice for HostDevice {
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

    fn gripper(&mut self) -> Option<&mut dyn Gripper> {
        self.gripper.as_mut().map(|gripper| gripper as &mut dyn Gripper)
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

    /// The contact thread panics while the hand presses: the panic is counted, and the last contacts fade
    /// out.
    #[test]
    fn a_panic_of_the_contact_thread_is_counted_and_its_contacts_fade() {
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
            // Like the clock of a host, this leaves time to find contacts.
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
        let found = stepper.contact_threads.pop();
        stepper.contact_threads.push(panicking.expect("a thread"));
        found.expect("a thread").join().expect("no panic");
        while !stepper.contact_threads.iter().any(JoinHandle::is_finished) {
            std::thread::yield_now();
        }
        assert_eq!(stepper.events().contact_thread_lost, 0);
        let after = (0..101).map(|_| step(&mut stepper, z)).last();
        assert_eq!((after, stepper.events().contact_thread_lost), (Some(0.0), 1));
    }
}
