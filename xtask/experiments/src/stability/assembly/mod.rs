//! Assembly in sessions of the engine: a nut turned on a bolt, a thread that locks itself, and pegs that are
//! held aslant by a hand that trembles.

pub mod insertion;
pub mod locking;
pub mod nut;

mod exact;
mod session;
#[cfg(test)]
mod tests;

use palpate::models::MetricThread;
use palpate::settings::{ContactSettings, ToolSettings};
use palpate::{Object, Settings, TriMesh};

/// Density of steel, kg/m³.
const STEEL: f64 = 7850.0;
/// Rate of contact queries, Hz.
const RATE: f64 = 500.0;
/// Deepest penetration that assembly may have, m.
const MAX_DEPTH: f64 = 2e-5;

/// How contacts respond in the sessions of these maps. The last one is judged; the others are compared with
/// it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Response {
    name: &'static str,
    contact: ContactSettings,
}

/// All responses. Only what a task needs differs from the default settings: friction, and the mass.
fn responses() -> Vec<Response> {
    [
        ("penalties", palpate::settings::Response::Penalty),
        ("constraints", palpate::settings::Response::Constraints),
    ]
    .map(|(name, response)| Response {
        name,
        contact: ContactSettings { response, ..ContactSettings::default() },
    })
    .into()
}

impl Response {
    /// Settings of a session with a coefficient of friction, in which a steel part is held.
    fn settings(&self, friction: f64, part: &Part) -> Settings {
        Settings {
            contact: ContactSettings { friction, ..self.contact },
            tool: ToolSettings { mass: part.mass(), ..ToolSettings::default() },
            ..Settings::default()
        }
    }
}

/// A part with its mesh, for judging.
#[derive(Clone)]
pub struct Part {
    pub object: Object,
    mesh: TriMesh,
}

impl Part {
    fn new(name: &str, mesh: TriMesh) -> Result<Self, String> {
        let object = Object::from_mesh(name, &mesh).map_err(|error| error.to_string())?;
        Ok(Self { object, mesh })
    }

    /// Mass in steel, kg.
    fn mass(&self) -> f64 {
        STEEL * self.object.clod.source.volume
    }
}

/// Bolt and nut with a thread, fine enough that their polygons are off by less than 10 µm.
pub fn bolt_and_nut(thread: &MetricThread) -> Result<[Part; 2], String> {
    let bolt = thread.bolt(BOLT_TRIANGLES).map_err(|error| error.to_string())?;
    let nut = thread.nut(NUT_TRIANGLES).map_err(|error| error.to_string())?;
    Ok([Part::new("bolt", bolt)?, Part::new("nut", nut)?])
}

/// Numbers of triangles of bolt and nut.
const BOLT_TRIANGLES: usize = 12_000;
const NUT_TRIANGLES: usize = 7_000;
