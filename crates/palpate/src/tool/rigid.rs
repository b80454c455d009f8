//! A tool of one rigid body.

use std::sync::Arc;

use palpate_core::Wrench;
use palpate_core::glam::DVec3;
use palpate_dynamics::{
    Body, BodyState, ConstrainedStep, Frame, Integrator, PushedBody, Recovery, VirtualCoupling,
    constrained_step,
};

use super::{BodyLoads, Hand, Moves, NO_CONTACTS, Tool, ToolStep};
use crate::telemetry::record::{Record, StepData};

/// A tool of one rigid body, as [`HapticRenderer::new`](crate::HapticRenderer::new) holds it.
#[derive(Clone, Debug)]
pub struct Rigid {
    pub(crate) body: Body,
    pub(crate) coupling: VirtualCoupling,
    pub(crate) state: BodyState,
    pub(crate) recovery: Recovery,
    /// Centre of mass in the mesh's frame, m.
    pub(crate) center_of_mass: DVec3,
    pub(crate) integrator: Arc<dyn Integrator>,
}

impl Moves for Rigid {
    fn body_state(&self, _: usize) -> BodyState {
        self.state
    }

    fn center_of_mass(&self, _: usize) -> DVec3 {
        self.center_of_mass
    }

    fn coupling(&self) -> &VirtualCoupling {
        &self.coupling
    }

    fn set_coupling(&mut self, coupling: VirtualCoupling) {
        self.coupling = coupling;
    }

    fn integrator(&self) -> &'static str {
        self.integrator.name()
    }

    fn energy(&self, hand: &Hand) -> f64 {
        self.coupling.potential_energy(&self.state, &hand.device) + self.body.kinetic_energy(&self.state)
    }

    fn step(&mut self, hand: &Hand, loads: &mut [BodyLoads<'_>], pushed: &[PushedBody], dt: f64) -> ToolStep {
        let load = loads.first_mut();
        let frame = Frame {
            body: &self.body,
            device: &hand.device,
            coupling: &self.coupling,
            contacts: load.as_ref().map_or(&NO_CONTACTS, |load| load.model),
            gravity: DVec3::ZERO,
        };
        let ConstrainedStep { step, held_back, recovery } = match load {
            Some(load) if load.constrained => {
                let BodyLoads { constraints, bound, .. } = load;
                constrained_step(&frame, &self.state, constraints, pushed, bound, &self.recovery, dt)
            }
            _ => self.integrator.step(&frame, &self.state, dt).into(),
        };
        (self.state, self.recovery.speed) = (step.state, recovery);
        ToolStep {
            status: step.status,
            waited: held_back,
            coupling: step.coupling,
            gripper: 0.0,
            stop: 0.0,
            contacts: [step.contact, Wrench::ZERO],
        }
    }

    fn push(&mut self, linear: DVec3, angular: DVec3) {
        let pushed = self.body.pushed(&self.state, linear, angular);
        if pushed.is_finite() {
            self.state.twist = pushed;
        }
    }

    fn reseat(&mut self, hand: &Hand) -> bool {
        let relaxed = self.coupling.relaxed_pose(&hand.device.pose);
        let valid = relaxed.is_valid();
        if valid {
            self.state = BodyState::at_rest(relaxed);
        }
        valid
    }
}

impl Tool for Rigid {
    type Record = Record;
    type PerBody<X> = X;

    fn record(&self, data: &StepData, step: &ToolStep) -> Record {
        let [model, _] = data.models;
        Record {
            time: data.time,
            device: data.device,
            handle: data.handle,
            object: self.object_pose(0),
            coupling: data.coupling,
            contact: step.contacts[0],
            depth: model.depth,
            contacts: model.contacts,
            model_age: data.time - model.time,
        }
    }

    fn per_body<X>(mut values: impl Iterator<Item = X>) -> Option<X> {
        values.next()
    }
}
