//! Body coupled to a device that a hand holds, in contact with simple shapes: the engine's two loops without
//! its queries.

use std::collections::VecDeque;

use palpate::device::{EmulatedDevice, Emulation, HapticDevice, IntendedPath};
use palpate::dynamics::{
    Body, BodyState, ContactBlend, ContactParameters, DeviceMotion, Frame, Friction, Integrator as _,
    IntegratorKind, LinearContactModel, VirtualCoupling, saturate,
};
use palpate::glam::{DMat3, DVec3};
use palpate::{Contact, Pose};

use super::geometry::{BALL, Geometry};
use palpate_measure::{Outcome, judge};

/// Parameters of a simulation.
#[derive(Clone, Debug)]
pub struct Rig {
    pub integrator: IntegratorKind,
    pub body: Body,
    pub coupling: VirtualCoupling,
    pub parameters: ContactParameters,
    pub geometry: Geometry,
    /// Rate of contact queries, Hz, each of which takes its whole period. The haptic loop is as fast, and at
    /// least 1 kHz.
    pub contact_rate: f64,
    /// Whether the contact force is frozen between queries at the state that the query saw, instead of
    /// following the contact model. For balls, on which forces exert no torque.
    pub frozen: bool,
    pub emulation: Emulation,
    /// Pose of the body's centre of mass at the start.
    pub start: Pose,
    /// Simulated time, s; the last second is judged.
    pub duration: f64,
}

/// Result of a simulation.
#[derive(Clone, Copy, Debug)]
pub struct RigResult {
    pub outcome: Outcome,
    /// Largest peak-to-peak motion over the last half second, of handle and body, m; rotations at a lever
    /// arm of [`BALL`].
    pub amplitude: f64,
    /// Largest force sent, N, and its mean over the last half second.
    pub largest_force: f64,
    pub held_force: f64,
    /// Largest torque sent, N·m.
    pub largest_torque: f64,
    /// Lowest energy of the session, J: energy in the coupling at the start, plus energy that had flowed in
    /// from the device.
    pub port_energy: f64,
    /// Number of steps without a solution.
    pub refused: u64,
    /// Deviation of the coupling at the end, m and rad.
    pub deviation: (f64, f64),
}

/// Default simulated time, s; the last second is judged.
pub const DURATION: f64 = 2.0;
/// Distance from which a handle counts as diverged, m.
const MAX_DISTANCE: f64 = 2.0;

/// Returns a solid ball of radius [`BALL`].
pub fn ball(mass: f64) -> Result<Body, String> {
    let inertia = DMat3::from_diagonal(DVec3::splat(0.4 * mass * BALL * BALL));
    Body::new(mass, inertia).map_err(|error| error.to_string())
}

impl Rig {
    /// Returns a body held by the default device as in a session: coupled with half of the stiffness that the
    /// device renders, and with critically damped contacts of `stiffness` (N/m).
    pub fn new(body: Body, grasp: Pose, stiffness: f64, geometry: Geometry) -> Self {
        let emulation = Emulation::default();
        let device = &emulation.specification;
        let (linear, angular) = (0.5 * device.stiffness, 0.5 * device.angular_stiffness);
        let mut coupling = VirtualCoupling::critically_damped(&body, grasp, linear, angular);
        coupling.max_force = device.peak_force;
        coupling.max_torque = device.peak_torque;
        let damping = 2.0 * (stiffness * body.mass).sqrt();
        Self {
            integrator: IntegratorKind::default(),
            body,
            coupling,
            parameters: ContactParameters {
                stiffness,
                damping,
                tolerance: 0.01 * BALL,
                friction: Friction::NONE,
            },
            geometry,
            contact_rate: 500.0,
            frozen: false,
            emulation,
            start: Pose::from_translation(DVec3::Z * super::pressing::CLEARANCE),
            duration: DURATION,
        }
    }

    /// Returns the amplitude up to which a motion counts as rest, m: two encoder steps, or the dead zone in
    /// which friction holds the handle against the coupling.
    fn floor(&self) -> f64 {
        let Emulation { specification, handle, .. } = &self.emulation;
        let linear = 2.0 * handle.friction / self.coupling.linear_stiffness;
        let angular = 2.0 * handle.angular_friction / self.coupling.angular_stiffness * BALL;
        (2.0 * specification.encoder_step).max(linear).max(angular)
    }

    /// Simulates a hand that holds the handle where `path` says, relative to its start.
    ///
    /// # Errors
    /// If the device refuses its parameters.
    pub fn run(mut self, path: fn(f64) -> (DVec3, DVec3)) -> Result<RigResult, String> {
        let handle = self.start * self.coupling.grasp;
        let intended = IntendedPath::function(move |time| {
            let (offset, velocity) = path(time);
            let pose = Pose { translation: handle.translation + offset, ..handle };
            (pose, palpate::Twist::new(velocity, DVec3::ZERO))
        });
        self.run_held(intended)
    }

    /// Simulates a hand that follows a path of its own.
    ///
    /// # Errors
    /// If the device refuses its parameters.
    pub fn run_held(&mut self, intended: IntendedPath) -> Result<RigResult, String> {
        let mut device = self.emulation.clone().open(intended).map_err(|error| error.to_string())?;
        let mut run = Running::new(self);
        let rate = self.contact_rate.max(1000.0);
        let steps = (self.duration * rate).round() as usize;
        let mut trace = Vec::with_capacity(steps);
        for step in 1..=steps {
            run.advance(self, &mut device, step as f64 / rate, 1.0 / rate)?;
            trace.push(run.coordinates(&device));
            if device.handle().0.translation.length() > MAX_DISTANCE {
                run.result.refused += 1;
                break;
            }
        }
        let last = rate as usize;
        let mut result = run.result;
        if result.refused > 0 || trace.len() < steps {
            (result.outcome, result.amplitude) = (Outcome::Diverged, f64::INFINITY);
        } else {
            (result.outcome, result.amplitude) = judge(&trace[steps - last..], self.floor());
        }
        result.held_force = run.held / (0.5 * last as f64);
        Ok(result)
    }
}

/// State of a simulation.
struct Running {
    state: BodyState,
    contacts: ContactBlend,
    /// Acceleration by the frozen force, m/s².
    frozen: DVec3,
    /// Pending contact models, with the times from which they are in use.
    pending: VecDeque<(f64, LinearContactModel, DVec3)>,
    queries: u64,
    found: Vec<Contact>,
    motion: DeviceMotion,
    held: f64,
    /// Energy in the coupling at the start, J.
    stored: f64,
    result: RigResult,
}

impl Running {
    fn new(rig: &Rig) -> Self {
        Self {
            state: BodyState::at_rest(rig.start),
            contacts: ContactBlend::new(),
            frozen: DVec3::ZERO,
            pending: VecDeque::new(),
            queries: 0,
            found: Vec::new(),
            motion: DeviceMotion::default(),
            held: 0.0,
            stored: f64::NAN,
            result: RigResult {
                outcome: Outcome::Diverged,
                amplitude: f64::INFINITY,
                largest_force: 0.0,
                held_force: 0.0,
                largest_torque: 0.0,
                port_energy: 0.0,
                refused: 0,
                deviation: (f64::NAN, f64::NAN),
            },
        }
    }

    fn advance(
        &mut self,
        rig: &mut Rig,
        device: &mut EmulatedDevice,
        now: f64,
        dt: f64,
    ) -> Result<(), String> {
        let slack = 1e-6 * dt;
        if (self.queries as f64 / rig.contact_rate) < now - slack {
            let arrival = (self.queries + 1) as f64 / rig.contact_rate;
            let (model, frozen) = self.query(rig, now - dt);
            self.pending.push_back((arrival, model, frozen));
            self.queries += 1;
        }
        while let Some((_, model, frozen)) = self.pending.pop_front_if(|(at, ..)| *at <= now + slack) {
            self.contacts.arrive(
                &model,
                &self.state,
                0.0,
                (1.0 / rig.contact_rate).min(ContactBlend::MAX_DURATION),
            );
            self.frozen = frozen;
        }
        let read = device.read(now).map_err(|error| error.to_string())?;
        self.motion = DeviceMotion { pose: read.pose, twist: read.twist };
        if self.stored.is_nan() {
            self.stored = rig.coupling.potential_energy(&self.state, &self.motion);
        }
        self.contacts.advance(&self.state, dt);
        let frame = Frame {
            body: &rig.body,
            device: &self.motion,
            coupling: &rig.coupling,
            contacts: self.contacts.model(),
            gravity: self.frozen,
        };
        let step = rig.integrator.step(&frame, &self.state, dt);
        self.state = step.state;
        let limits = &rig.emulation.specification;
        let sent = saturate(&step.coupling, limits.peak_force, limits.peak_torque);
        device.write(&sent).map_err(|error| error.to_string())?;

        let result = &mut self.result;
        result.refused += u64::from(step.status.failure.is_some());
        result.largest_force = result.largest_force.max(sent.force.length());
        result.largest_torque = result.largest_torque.max(sent.torque.length());
        result.port_energy = result.port_energy.min(self.stored - device.work());
        if now > rig.duration - 0.5 + slack {
            self.held += sent.force.length();
        }
        let relaxed = rig.coupling.relaxed_pose(&self.motion.pose);
        let turn = self.state.pose.rotation_vector_to(&relaxed).length();
        result.deviation = (self.state.pose.translation.distance(relaxed.translation), turn);
        Ok(())
    }

    /// Returns the contact model at the present state, and, if frozen, the acceleration by its force.
    fn query(&mut self, rig: &mut Rig, time: f64) -> (LinearContactModel, DVec3) {
        rig.geometry.contacts(&self.state, rig.parameters.tolerance, &mut self.found);
        let contacts = self.found.iter().copied();
        let model = LinearContactModel::from_contacts(contacts, &self.state.pose, &rig.parameters, time);
        if rig.frozen {
            let force = model.wrench(&self.state).force;
            return (LinearContactModel::empty(&self.state.pose, time), force / rig.body.mass);
        }
        (model, DVec3::ZERO)
    }

    /// Returns positions of handle and body, and the body's rotation at the lever arm, m.
    fn coordinates(&self, device: &EmulatedDevice) -> [f64; 9] {
        let handle = device.handle().0.translation;
        let place = self.state.pose.translation;
        let turn = Pose::IDENTITY.rotation_vector_to(&self.state.pose) * BALL;
        [handle.x, handle.y, handle.z, place.x, place.y, place.z, turn.x, turn.y, turn.z]
    }
}
