//! Rigid body dynamics with haptic manipulation (chapter 5): the coupling's spring, integrators in free space
//! and in contact, the linearised contact model, textures (Figs. 5.4, 5.6, 5.8, 5.10, 5.12).

pub mod free_space;
pub mod jaws;
pub mod saturation;
pub mod spoon_and_cup;
pub mod textured_plate;

use palpate::Object;
use palpate::dynamics::Body;
use palpate_report::{Curve, Figure, draw};

use palpate_measure::Sample;

use crate::stability::page::{Table, row};

/// Coupling of the dissertation in §5.5.2 and §5.5.3, N/m and N·m/rad.
const COUPLING_STIFFNESS: f64 = 200.0;
const ANGULAR_STIFFNESS: f64 = 0.6;
/// Mass from which Forward Euler is stable in the dissertation, kg.
const FORWARD_EULER_MASS: f64 = 0.1;

/// Returns the angular damping of the coupling, N·m·s/rad. The dissertation does not give it. This is the
/// damping with which Forward Euler in steps of 1 ms is stable from [`FORWARD_EULER_MASS`] on, for rotation
/// about the axis of least inertia (h b_θ/I < 2). The other methods are judged with the same damping:
/// Runge-Kutta IV's limit is 2.785, so that it needs 72 g.
fn angular_damping(object: &Object) -> Result<f64, String> {
    let body = Body::new(FORWARD_EULER_MASS, object.clod.source.unit_inertia * FORWARD_EULER_MASS);
    Ok(2.0 * body.map_err(|error| error.to_string())?.principal_moments().x / 1e-3)
}

/// Session and its name in plots and tables.
type Named<'a> = (&'a str, &'a [Sample]);

/// Plotted quantity of a session: name, unit, and its value in a sample.
type Quantity = (&'static str, &'static str, fn(&Sample) -> f64);

const DEPTH: Quantity = ("maximum local penetration depth", "mm", |sample| 1e3 * sample.depth);
const DEVIATION: Quantity = ("coupling deviation", "mm", |sample| 1e3 * sample.deviation);
const CONTACT: Quantity = ("contact force", "N", |sample| sample.contact);
const COUPLING: Quantity = ("coupling force", "N", |sample| sample.coupling);

/// Plots each quantity over time, one below the other.
fn plot(title: &str, sessions: &[Named<'_>], quantities: &[Quantity]) -> Result<String, String> {
    let figure = |&(name, unit, value): &Quantity| Figure {
        caption: format!("{title}: {name}."),
        across: "s".to_owned(),
        axis: format!("{name}, {unit}"),
        curves: sessions
            .iter()
            .map(|(session, samples)| Curve {
                name: (*session).to_owned(),
                points: samples.iter().map(|sample| (sample.time, value(sample))).collect(),
            })
            .collect(),
    };
    let figures: Vec<Figure> = quantities.iter().map(figure).collect();
    draw(&figures).map_err(|error| error.to_string())
}

/// Returns a table with a row per millisecond of each session.
fn table(name: &str, sessions: &[Named<'_>]) -> Table {
    let rows = sessions.iter().flat_map(|(session, samples)| {
        samples.iter().map(move |&Sample { time, deviation, turn, coupling, contact, depth, .. }| {
            row![*session, time, deviation, turn, coupling, contact, depth]
        })
    });
    let columns =
        ["session", "t", "deviation_m", "deviation_rad", "coupling_force_n", "contact_force_n", "depth_m"];
    Table { name: name.to_owned(), columns: columns.to_vec(), rows: rows.collect() }
}

/// Returns the largest value of a quantity in a time interval (s).
fn most(samples: &[Sample], times: std::ops::Range<f64>, value: fn(&Sample) -> f64) -> f64 {
    samples.iter().filter(|sample| times.contains(&sample.time)).map(value).fold(0.0, f64::max)
}

/// Returns the root mean square of a quantity in a time interval (s).
fn root_mean_square(samples: &[Sample], times: std::ops::Range<f64>, value: impl Fn(&Sample) -> f64) -> f64 {
    let squares: Vec<f64> = samples
        .iter()
        .filter(|sample| times.contains(&sample.time))
        .map(|sample| value(sample).powi(2))
        .collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
}
