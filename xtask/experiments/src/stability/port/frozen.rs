//! A negative control: a contact whose force is frozen from one query to the next, as a session must not
//! have.

use palpate::dynamics::{
    Body, BodyState, DeviceMotion, Frame, Integrator as _, IntegratorKind, LinearContactModel,
    VirtualCoupling,
};
use palpate::glam::DVec3;
use palpate::{Pose, Twist, Wrench};

use super::super::rig::ball;
use super::driven::{PERIOD, Port};

/// Stiffness of the contact, N/m: softer than the coupling, since a stiffer one would not even be stable with
/// the handle at rest.
const STIFFNESS: f64 = 200.0;
/// Mass of the body, kg, and depth of the handle in the surface, m.
const MASS: f64 = 0.1;
const DEPTH: f64 = 2e-3;

/// A ball on a surface at z = 0, with the engine's coupling and step.
pub struct Frozen {
    body: Body,
    coupling: VirtualCoupling,
    state: BodyState,
    last: Pose,
    every: u64,
    steps: u64,
    /// Force that the last query found, and the one that is in use, N.
    found: f64,
    force: f64,
}

impl Frozen {
    /// Starts with stiffnesses (N/m, N·m/rad) and contacts at a rate (Hz). Returns the handle's pose.
    ///
    /// # Errors
    /// If the body is refused.
    pub fn start((linear, angular): (f64, f64), rate: f64) -> Result<(Self, Pose), String> {
        let handle = Pose::from_translation(DVec3::NEG_Z * DEPTH);
        let body = ball(MASS)?;
        let coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, linear, angular);
        let every = (1.0 / (rate * PERIOD)).round().max(1.0) as u64;
        let state = BodyState::at_rest(handle);
        Ok((Self { body, coupling, state, last: handle, every, steps: 0, found: 0.0, force: 0.0 }, handle))
    }
}

impl Port for Frozen {
    fn step(&mut self, handle: &Pose) -> Wrench {
        if self.steps.is_multiple_of(self.every) {
            self.force = self.found;
            self.found = STIFFNESS * (-self.state.pose.translation.z).max(0.0);
        }
        self.steps += 1;
        let moved = Twist::new(
            (handle.translation - self.last.translation) / PERIOD,
            self.last.rotation_vector_to(handle) / PERIOD,
        );
        self.last = *handle;
        let frame = Frame {
            body: &self.body,
            device: &DeviceMotion { pose: *handle, twist: moved },
            coupling: &self.coupling,
            contacts: &LinearContactModel::empty(&self.state.pose, 0.0),
            gravity: DVec3::Z * (self.force / self.body.mass),
        };
        let step = IntegratorKind::default().step(&frame, &self.state, PERIOD);
        self.state = step.state;
        step.coupling
    }
}
