//! Forward Euler in (x, R, P, L).

use crate::body::BodyState;
use crate::integrators::Integrator;
use crate::step::{Frame, Step, StepStatus};

/// Forward Euler: everything advances at the rates of the start of the step.
///
/// A free body keeps its momenta, and gains energy. It is here to compare with (Fig. 5.6): with stiff springs
/// or light bodies it diverges, until the step is held for [`Overflow`](crate::StepFailure::Overflow).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ForwardEuler;

impl Integrator for ForwardEuler {
    fn name(&self) -> &'static str {
        "forward-euler"
    }

    fn step(&self, frame: &Frame<'_>, state: &BodyState, dt: f64) -> Step {
        if let Some(refused) = frame.refused(state, dt) {
            return refused;
        }
        let (load, active) = frame.load(state);
        let pose = state.pose.moved(&state.twist, dt);
        let twist = frame.pushed(state, &(load * dt), &frame.body.inertia.inverse(), &pose);
        frame.ended(state, &BodyState { pose, twist }, active, StepStatus::default())
    }
}
