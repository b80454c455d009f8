//! A session whose haptic loop and device are the host's: a simulator, a driver of its own, a game engine.
//!
//! Contacts are found in a thread of their own, as fast as they can be; the host's step is a haptic step, which does not
//! allocate, lock, block or panic, and uses the latest of them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use palpate_core::{Pose, Wrench};
use palpate_device::{
    DeviceError, DeviceState, Gripper, GripperSpecification, GripperState, HapticDevice, Specification,
    Status,
};

use crate::contact::monitor::ContactMonitor;
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

/// A session that a host steps, and what else the host does with it. It comes apart, so that each part can go to a thread of its
/// own: `let HostedSession { stepper, scene, contacts, .. } = session;`.
#[derive(Debug)]
pub struct HostedSession<T: Tool = Rigid> {
    /// Changes its scene.
    pub scene: SceneEditor,
    /// Changes its settings.
    pub settings: SettingsEditor,
    /// Shows the contacts of each body.
    pub contacts: T::PerBody<ContactMonitor>,
    /// Reports what contacts push the scene's objects with.
    pub reactions: Reactions,
    /// Takes its haptic steps.
    pub stepper: HostedStepper<T>,
}

/// Takes the haptic steps of a session, in the thread that owns the device. The session's contact threads end when this is
/// dropped.
#[derive(Debug)]
pub struct HostedStepper<T: Tool = Rigid> {
    haptic: HapticLoop<T>,
    contacts: Vec<ToContact>,
    now: f64,
    latest: Option<T::Record>,
    ended: Arc<AtomicBool>,
    /// Find contacts, one for each body. They end before their time only by a panic.
    contact_threads: Vec<JoinHandle<()>>,
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
        let theirs = Box::new(OfTheHost { specification, state: device, gripper: None });
        HapticRenderer::new(probe, scene, theirs, settings)?.host()
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
    /// Puts a tool with a hinge into the hand that holds a device of that specification, where the device and its gripper (rad) now are,
    /// and `scene` around it.
    ///
    /// # Errors
    /// As [`HapticRenderer::hinged`], or if the system gives no thread.
    pub fn hinged(
        tool: &HingedTool,
        scene: Scene,
        (specification, device): (Specification, DeviceState),
        (gripper_specification, gripper_angle): (GripperSpecification, f64),
        settings: Settings,
        gripper: &GripperSettings,
    ) -> Result<Self, HostError> {
        let fingers = HostsGripper { specification: gripper_specification, angle: gripper_angle };
        let theirs = Box::new(OfTheHost { specification, state: device, gripper: Some(fingers) });
        HapticRenderer::hinged(tool, scene, theirs, settings, gripper)?.host()
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
    /// A session for a host that reads and writes the device itself, with contacts found in threads of their own. The renderer's
    /// device is given up.
    ///
    /// # Errors
    /// If the system gives no thread.
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
            // Where there is no thread, dropping the stepper ends those before.
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
    /// A haptic step, if `dt` (s) is above 0.
    fn advance(&mut self, dt: f64, device: &DeviceState, gripper_angle: Option<f64>) {
        if !(dt > 0.0 && dt.is_finite()) {
            return;
        }
        ToContact::receive(&mut self.contacts, &mut self.haptic);
        self.now += dt;
        let (record, _) = self.haptic.advance(Some(device), gripper_angle, self.now, dt);
        if self.contact_threads.iter().any(JoinHandle::is_finished) {
            self.haptic.telemetry_mut().events.contact_thread_lost = 1;
        }
        ToContact::send(&mut self.contacts, &self.haptic, self.now);
        self.latest = Some(record);
    }

    /// The record of the last step; none before the first.
    pub fn latest(&self) -> Option<&T::Record> {
        self.latest.as_ref()
    }

    /// Holds the clutch, or lets it go ([`HapticLoop::set_clutch`]).
    pub fn set_clutch(&mut self, held: bool) {
        self.haptic.set_clutch(held);
    }

    /// Events in haptic steps.
    pub fn events(&self) -> Events {
        self.haptic.telemetry().events
    }
}

impl HostedStepper {
    /// A haptic step of `dt` seconds, the device being in a state: the wrench to send to it, in its axes, about its
    /// handle's origin. A `dt` that is not above 0 changes nothing, and gives the wrench of the last step. Of one above 20 ms and five
    /// periods no more than that is integrated.
    ///
    /// The host sends zero when it ends, before it drops this: nothing else does.
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
    /// A haptic step as [`HostedStepper::step`], with the gripper's angle (rad): the wrench to send to the device, and the torque (N·m)
    /// to send to the gripper, positive where it opens it.
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
    gripper: Option<HostsGripper>,
}

/// Its gripper, likewise.
#[derive(Debug)]
struct HostsGripper {
    specification: GripperSpecification,
    angle: f64,
}

impl Gripper for HostsGripper {
    fn specification(&self) -> &GripperSpecification {
        &self.specification
    }

    fn read(&mut self, now: f64) -> Result<GripperState, DeviceError> {
        // As with any gripper the angle is finite.
        let angle = if self.angle.is_finite() { self.angle } else { 0.0 };
        Ok(GripperState { time: now, angle, status: Status::OK })
    }

    fn write(&mut self, _: f64) -> Result<(), DeviceError> {
        Ok(())
    }
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
