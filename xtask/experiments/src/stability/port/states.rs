//! States of contact, found by driving a session into contact.

use palpate::device::{Emulation, IntendedPath, Specification, Task};
use palpate::glam::{DQuat, DVec3};
use palpate::models::{MetricThread, PegFit};
use palpate::{Object, Pose, Scene, Wrench, explore};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::super::assembly;
use super::super::grid::Plan;
use super::driven::{Driven, PERIOD, Port, constrained};

/// Speed at which the handle goes into contact, m/s, or that at [`ARM`] for a turn.
const SPEED: f64 = 0.02;
/// Length at which turns count as motions and torques as forces, m: the size of the parts.
pub const ARM: f64 = 0.02;
/// Wrench that ends the way into contact, N: the force, with the torque at [`ARM`].
const PRESS: (f64, f64) = (0.6, 1.2);
/// Sceneries of the states: jaws (0) twice as often as the peg (2), and the nut (1) least, whose queries take
/// longest.
const ORDER: [usize; 10] = [0, 1, 2, 0, 0, 2, 0, 0, 2, 0];
/// Time for the way, and for coming to rest after it, s.
const LONGEST_WAY: f64 = 3.0;
const SETTLING: f64 = 0.4;

/// Two objects that come into contact.
pub struct Scenery {
    pub name: &'static str,
    pub held: Object,
    pub scene: Scene,
}

/// A state of contact of a scenery, by the way that leads there.
#[derive(Clone, Copy, Debug)]
pub struct State {
    pub scenery: usize,
    /// Pose of the held mesh at the start.
    pub start: Pose,
    /// Direction of the handle's motion, with the turn times [`ARM`].
    pub way: (DVec3, DVec3),
    /// Wrench that ends the way, N.
    pub press: f64,
}

/// What the hand feels at a state with the handle at rest.
#[derive(Clone, Copy, Debug)]
pub struct AtRest {
    /// Wrench with which the hand holds the handle there.
    pub felt: Wrench,
    /// Largest change of the force from step to step, N: 0 if the object is at rest, too.
    pub restless: f64,
}

/// What varies between sessions at one state.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    /// Delay of the device, s, and that which the session is told, by which it chooses the coupling.
    pub delay: f64,
    pub told_delay: f64,
    /// Whether readings are rounded to encoder steps.
    pub encoders: bool,
    /// Rate of contact queries, Hz.
    pub rate: f64,
    /// Coefficient of friction of the contacts.
    pub friction: f64,
}

impl Conditions {
    /// The device as the session is told of it.
    fn specification(&self) -> Specification {
        let mut specification = Emulation::default().specification;
        specification.delay = self.told_delay;
        if !self.encoders {
            specification.encoder_step = 0.0;
            specification.angular_encoder_step = 0.0;
        }
        specification
    }
}

/// Makes jaws, nut and bolt, and peg and hole.
///
/// # Errors
/// If a model cannot be made.
pub fn sceneries(plan: &Plan) -> Result<Vec<Scenery>, String> {
    let names: [&'static str; 3] = ["jaws", "nut", "peg"];
    plan.each("port: models", &names, |&name| {
        let model = |name: &str| Object::model(name).map_err(|error| error.to_string());
        let mesh = |name, mesh| Object::from_mesh(name, &mesh).map_err(|error| error.to_string());
        let (held, fixed) = match name {
            "jaws" => (model("upper-jaw@4000")?, model("lower-jaw@4000")?),
            "nut" => {
                let [bolt, nut] = assembly::bolt_and_nut(&MetricThread::M16)?;
                (nut.object, bolt.object)
            }
            _ => {
                let fit = PegFit::LOOSE_8_MM;
                let fail = |error: palpate::models::ModelError| error.to_string();
                (mesh("peg", fit.peg(1000).map_err(fail)?)?, mesh("hole", fit.hole(1200).map_err(fail)?)?)
            }
        };
        Ok(Scenery { name, held, scene: Scene::new().with(fixed, Pose::IDENTITY) })
    })
}

/// Draws a number of states.
///
/// # Errors
/// If the jaws cannot be placed.
pub fn draw(count: usize, sceneries: &[Scenery]) -> Result<Vec<State>, String> {
    let mut rng = StdRng::seed_from_u64(5);
    let Scenery { held, scene, .. } = &sceneries[0];
    let path = explore::path(Task::Press, held, scene).map_err(|error| error.to_string())?;
    let IntendedPath::Function(mut path) = path else { return Err("a task moves".to_owned()) };
    let above = path(0.0).0.translation;
    Ok((0..count).map(|index| State::draw(ORDER[index % ORDER.len()], above, &mut rng)).collect())
}

impl State {
    fn draw(scenery: usize, above: DVec3, rng: &mut StdRng) -> Self {
        let mut part = |size: f64| rng.random_range(-size..=size);
        let any = DVec3::new(part(1.0), part(1.0), part(1.0));
        let turn = DVec3::new(part(1.0), part(1.0), part(1.0));
        let (start, way) = match scenery {
            // The jaws: from above, a little aslant and aside.
            0 => {
                let offset = above + DVec3::new(part(2e-3), part(2e-3), 0.0);
                (
                    Pose::new(offset, DQuat::from_scaled_axis(turn * 0.03)),
                    (DVec3::NEG_Z + any * 0.3, DVec3::ZERO),
                )
            }
            // The nut, three turns on: along the axis, aside or aslant.
            1 => {
                let turns = 3.0 + part(0.5);
                (assembly::nut::engaged(&MetricThread::M16, 8.0, turns), (any, turn * 0.3))
            }
            // The peg, in the hole: aside or aslant.
            _ => {
                let height = -0.010 + part(4e-3);
                let (aside, aslant) = (any * DVec3::new(1.0, 1.0, 0.0), turn * DVec3::new(1.0, 1.0, 0.0));
                (Pose::from_translation(DVec3::Z * height), (aside, aslant * 0.5))
            }
        };
        let press = rng.random_range(PRESS.0..PRESS.1);
        let size = (way.0.length_squared() + way.1.length_squared()).sqrt().max(1e-3);
        Self { scenery, start, way: (way.0 / size, way.1 / size), press }
    }

    /// Starts a session under some conditions and drives it into contact. Returns it with the handle's pose
    /// and what is felt there, or nothing if there is no contact on the way.
    ///
    /// # Errors
    /// If the session cannot start.
    pub fn reach(
        &self,
        sceneries: &[Scenery],
        conditions: &Conditions,
    ) -> Result<Option<(Driven, Pose, AtRest)>, String> {
        let Scenery { held, scene, .. } = &sceneries[self.scenery];
        let mut settings = constrained();
        settings.contact.friction = conditions.friction;
        let specification = conditions.specification();
        let (mut session, mut handle) =
            Driven::start((held, scene), &specification, settings, conditions.rate, &self.start)?;
        let still = (settings.timing.engagement / PERIOD) as usize + 10;
        for _ in 0..still {
            session.step(&handle);
        }
        let begun = handle;
        for step in 1..=(LONGEST_WAY / PERIOD) as usize {
            let way = SPEED * PERIOD * step as f64;
            let turn = DQuat::from_scaled_axis(self.way.1 * (way / ARM));
            handle = Pose::new(begun.translation + self.way.0 * way, turn * begun.rotation);
            let felt = session.step(&handle);
            if felt.force.length() + felt.torque.length() / ARM >= self.press {
                let mut last = [felt; 2];
                let mut restless: f64 = 0.0;
                for step in 0..(SETTLING / PERIOD) as usize {
                    last = [last[1], session.step(&handle)];
                    if step > (0.5 * SETTLING / PERIOD) as usize {
                        restless = restless.max((last[1].force - last[0].force).length());
                    }
                }
                let felt = Wrench::new(-last[1].force, -last[1].torque);
                return Ok(Some((session, handle, AtRest { felt, restless })));
            }
        }
        Ok(None)
    }
}
