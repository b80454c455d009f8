//! Session that a genome encodes: settings, a device with its hand, the scene, and the faults.

use palpate::device::{Axes, Emulation, Hand, Handle, Specification};
use palpate::dynamics::IntegratorKind;
use palpate::glam::DVec3;
use palpate::settings::{ContactSearch, HandlePlace, Response, TextureSettings};
use palpate::{Pose, Settings};

use super::faults::{FAULTS, Fault};
use super::genome::{Genes, Genome};
use super::hand::Motion;
use super::models::{PAIRS, Pair};

/// Session that a genome encodes.
#[derive(Clone, Debug)]
pub struct Plan {
    pub settings: Settings,
    pub integrator: IntegratorKind,
    pub emulation: Emulation,
    pub hand: Motion,
    pub world: World,
    pub contacts: Timing,
    /// Time between two steps of the host, in periods of the session, and the share of it that varies from
    /// step to step.
    pub host: (f64, f64),
    /// Whether the host passes the true duration of a step rather than the period.
    pub passes_elapsed: bool,
    pub edits: Vec<Edit>,
    pub faults: Vec<Fault>,
    /// Count of the genome's numbers that were read.
    pub read: u16,
}

/// Rate of contact queries, Hz, and their duration, s.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    pub rate: f64,
    pub latency: f64,
}

/// Scene of a session.
#[derive(Clone, Debug)]
pub enum World {
    /// Planes, found by a query of the host's own.
    Planes(Vec<Plane>),
    /// Models, found by the engine's contact loop.
    Models(Models),
}

/// Plane that exerts contact forces.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// Outward normal, world axes.
    pub normal: DVec3,
    /// Distance along the normal from the hand's starting place, m at the device; and the amplitude (m) and
    /// frequency (Hz) of its swing.
    pub height: f64,
    pub swing: (f64, f64),
    /// Whether contacts have the plane's velocity.
    pub reports_velocity: bool,
    /// Start and end of its presence, s.
    pub there: (f64, f64),
    /// Contact stiffness (N/m), damping (N·s/m) and tolerance (m).
    pub stiffness: f64,
    pub damping: f64,
    pub tolerance: f64,
    /// Distance of the touching points from the object's centre, bounding radii; and the braking time, s.
    pub spread: f64,
    pub braking: f64,
}

/// Models that come into contact.
#[derive(Clone, Copy, Debug)]
pub struct Models {
    pub pair: Pair,
    /// Pose of the scene object relative to the grasped one at the start, in sums of their bounding radii.
    pub place: Pose,
    /// Amplitude of its motion (m) and of its turning (rad), their frequency (Hz), and the rate at which the
    /// host reports its pose (Hz).
    pub moves: Option<(f64, f64, f64, f64)>,
    /// Mass with which it reacts to contacts, kg.
    pub mobility: Option<f64>,
}

/// Change that a host makes in a session.
#[derive(Clone, Copy, Debug)]
pub struct Edit {
    /// Time of the change, s.
    pub time: f64,
    pub change: Change,
}

#[derive(Clone, Copy, Debug)]
pub enum Change {
    /// Factors of the stiffness and damping of contacts and of the coupling; coefficient of friction; slew in
    /// peaks per second.
    Settings {
        contact: (f64, f64),
        coupling: (f64, f64),
        friction: f64,
        slew: Option<f64>,
        passivity: bool,
    },
    /// Moves, removes, adds or scales the scene object.
    Place(Pose),
    Remove,
    Add(Pose),
    Replace(f64),
}

/// Largest number of changes and of planes in a session.
const EDITS: usize = 4;
const PLANES: usize = 6;

impl Plan {
    /// Decodes a genome for a session of some seconds.
    pub fn of(genome: &Genome, seconds: f64) -> Self {
        let mut genes = genome.genes();
        let g = &mut genes;
        let by_models = g.chance(0.3);
        let pair = g.pick(&PAIRS);
        let pair = if by_models { pair } else { Pair::Ellipsoid };
        let mut emulation = emulation(g);
        let (settings, integrator) = settings(g, pair, by_models);
        emulation.substep = (0.5 / settings.timing.rate).clamp(2e-5, 2e-4);
        let hand = Motion::of(g, seconds);
        let planes = (0..PLANES).map(|index| g.maybe(0.9 / (1 + index) as f64, |g| plane(g, seconds)));
        let planes: Vec<Plane> = planes.collect::<Vec<_>>().into_iter().flatten().collect();
        let models = models(g, pair);
        let rate = g.log(20.0, 1000.0);
        let contacts = Timing {
            rate: if by_models { rate.min(pair.most_queries()) } else { rate },
            latency: g.log(1e-4, 0.1).min(3.0 / rate),
        };
        let even = g.chance(0.8);
        let (often, varies) = (g.log(0.3, 3.0), g.range(0.0, 0.9));
        let host = (if even { 1.0 } else { often }, if g.chance(0.7) { 0.0 } else { varies });
        let passes_elapsed = g.chance(0.4);
        let edits = (0..EDITS).map(|_| g.maybe(0.3, |g| edit(g, seconds))).collect::<Vec<_>>();
        let faults = (0..FAULTS).map(|_| g.maybe(0.45, |g| Fault::of(g, seconds))).collect::<Vec<_>>();
        let world = if by_models { World::Models(models) } else { World::Planes(planes) };
        Self {
            settings,
            integrator,
            emulation,
            hand,
            world,
            contacts,
            host,
            passes_elapsed,
            edits: edits.into_iter().flatten().collect(),
            faults: faults.into_iter().flatten().collect(),
            read: genes.read(),
        }
    }

    /// Returns the pair of objects, with the one that is in the hand.
    pub fn pair(&self) -> Pair {
        match &self.world {
            World::Planes(_) => Pair::Ellipsoid,
            World::Models(models) => models.pair,
        }
    }
}

/// Draws from all valid settings, most often near the usual ones.
fn settings(g: &mut Genes<'_>, pair: Pair, by_models: bool) -> (Settings, IntegratorKind) {
    let radius = pair.radius();
    let usual_rate = g.chance(0.6);
    let rate = g.log_or((100.0, 4000.0), 0.2, (10.0, 20_000.0));
    // The order of the draws is part of the format of genomes.
    let mut settings = Settings::default();
    settings.timing.rate = if usual_rate { 1000.0 } else { rate };
    settings.tool.mass = g.log_or((1e-3, 10.0), 0.15, (1e-5, 1e4));
    settings.contact.stiffness = g.log_or((10.0, 1e5), 0.15, (1e-3, 1e8));
    settings.contact.damping = g.maybe(0.4, |g| g.log_or((1e-3, 1e3), 0.1, (1e-6, 1e6)));
    settings.contact.friction = g.maybe(0.5, |g| g.log_or((0.02, 1.5), 0.1, (1e-3, 100.0))).unwrap_or(0.0);
    settings.contact.static_friction = g.maybe(0.3, |g| g.log_or((0.02, 1.5), 0.1, (1e-3, 100.0)));
    settings.coupling.stiffness = g.maybe(0.5, |g| g.log_or((1.0, 1e4), 0.2, (1e-3, 1e7)));
    settings.coupling.damping = g.maybe(0.3, |g| g.log_or((1e-2, 1e2), 0.2, (1e-5, 1e6)));
    settings.coupling.angular_stiffness = g.maybe(0.4, |g| g.log_or((1e-3, 10.0), 0.2, (1e-6, 1e6)));
    settings.coupling.angular_damping = g.maybe(0.3, |g| g.log_or((1e-5, 1.0), 0.2, (1e-8, 1e6)));
    // Some tolerances exceed the object's size and are refused.
    settings.search.tolerance = g.maybe(0.4, |g| radius * g.log(1e-4, 1.2));
    settings.search.method = g.pick(&[
        ContactSearch::Automatic,
        ContactSearch::Levels,
        ContactSearch::Levels,
        ContactSearch::Representatives,
    ]);
    // Constraints take longer to search than penalties.
    let constrained = settings.search.method == ContactSearch::Automatic;
    settings.contact.response = if constrained { Response::Constraints } else { Response::Penalty };
    settings.search.representative_error = g.maybe(0.2, |g| radius * g.pick(&[0.0003, 0.001, 0.003]));
    settings.detail.error = g.maybe(0.3, |g| g.log(1e-5, 1e-2)).unwrap_or(0.0);
    settings.detail.interpolation = g.chance(0.7);
    // A time budget would make sessions irreproducible.
    settings.detail.query_budget = None;
    settings.search.clusters = g.range(1.0, 17.0) as usize;
    settings.search.braking = g.chance(0.75);
    settings.search.proxy = g.chance(0.75);
    settings.textures = TextureSettings {
        grid: g.range(2.0, 16.0) as u32,
        half_size: None,
        temperature: g.maybe(0.3, |g| g.log(1e-6, 1e-2)),
        ..TextureSettings::default()
    };
    settings.tool.grasp = g.maybe(0.3, |g| Pose::new(g.vector(2.0 * radius), g.turn(3.0)));
    settings.tool.handle = g.pick(&[HandlePlace::Automatic, HandlePlace::Grasp, HandlePlace::MeshOrigin]);
    settings.timing.contact_timeout = g.log(1e-3, 1.0);
    settings.timing.engagement = g.maybe(0.9, |g| g.log(1e-3, 2.0)).unwrap_or(0.0);
    settings.device.workspace_scale =
        g.maybe(0.4, |g| g.log_or((0.1, 10.0), 0.2, (1e-4, 1e4))).unwrap_or(1.0);
    settings.device.frame = Pose::new(g.vector(0.5), g.turn(3.0));
    settings.device.clutch_button = g.maybe(0.4, |_| 0);
    settings.output.force_slew = g.maybe(0.3, |g| g.log(1.0, 1e5));
    settings.output.torque_slew = g.maybe(0.3, |g| g.log(1e-2, 1e4));
    settings.output.passivity_controller = g.chance(0.5);
    settings.tool.unusual_size = true;
    let other = g.pick(&IntegratorKind::ALL);
    let integrator = if g.chance(0.4) { other } else { IntegratorKind::SemiImplicit };
    let usual = g.pick(&[0.01, 0.02]);
    if !by_models {
        // A host's own query does not use distance fields, which take seconds to build.
        settings.search.method = ContactSearch::Levels;
    }
    if by_models && settings.search.method != ContactSearch::Levels {
        // Each tolerance needs distance fields of its own, which take seconds to build.
        settings.search.tolerance = Some(usual * radius);
    }
    (settings, integrator)
}

fn emulation(g: &mut Genes<'_>) -> Emulation {
    let names: Vec<&'static str> = Emulation::presets().map(|(name, _)| name).collect();
    let preset = Emulation::preset(g.pick(&names)).unwrap_or_default();
    let changed = g.chance(0.6);
    let Emulation { specification: s, handle, .. } = &preset;
    let peaks = (g.log(0.3, 60.0), g.log(0.01, 5.0));
    let shares = (g.log(0.05, 1.5), g.log(0.05, 1.5));
    let limits = [g.log(50.0, 1e4), g.log(0.05, 50.0), g.log(0.3, 30.0), g.log(1e-3, 0.3)].map(|limit| {
        let none = g.chance(0.1);
        if none { f64::INFINITY } else { limit }
    });
    let none_known = g.chance(0.1);
    let axes = |g: &mut Genes<'_>| {
        let all = g.pick(&[Axes::ALL, Axes::ALL, Axes::ALL, Axes::TRANSLATION]);
        let some = Axes {
            translation: std::array::from_fn(|_| g.chance(0.7)),
            rotation: std::array::from_fn(|_| g.chance(0.5)),
        };
        if g.chance(0.1) { some } else { all }
    };
    let (sensed, actuated) = (axes(g), axes(g));
    let own = Handle {
        mass: g.log(0.01, 1.0),
        damping: g.log(0.02, 10.0),
        friction: g.maybe(0.7, |g| g.log(0.005, 1.0)).unwrap_or(0.0),
        inertia: g.log(5e-6, 5e-3),
        angular_damping: g.log(2e-5, 0.05),
        angular_friction: g.maybe(0.7, |g| g.log(1e-5, 0.02)).unwrap_or(0.0),
    };
    let known = g.chance(0.7);
    let other = Specification {
        peak_force: peaks.0,
        continuous_force: if none_known { 0.0 } else { shares.0 * peaks.0 },
        peak_torque: peaks.1,
        continuous_torque: if none_known { 0.0 } else { shares.1 * peaks.1 },
        stiffness: limits[0],
        angular_stiffness: limits[1],
        damping: limits[2],
        angular_damping: limits[3],
        workspace_radius: g.log(0.03, 1.0),
        encoder_step: g.maybe(0.8, |g| g.log(1e-6, 1e-3)).unwrap_or(0.0),
        angular_encoder_step: g.maybe(0.8, |g| g.log(1e-5, 1e-2)).unwrap_or(0.0),
        velocity_delay: g.maybe(0.8, |g| g.log(5e-4, 0.02)).unwrap_or(0.0),
        delay: g.maybe(0.5, |g| g.log(1e-4, 5e-3)).unwrap_or(0.0),
        sensed,
        actuated,
        handle: known.then_some(own),
        ..s.clone()
    };
    let hand = g.pick(&Hand::PRESETS).1;
    let grip = Hand {
        mass: g.log(0.01, 1.0),
        damping: g.log(0.1, 30.0),
        stiffness: g.log(5.0, 3000.0),
        inertia: g.log(1e-5, 1e-2),
        angular_damping: g.log(1e-4, 0.3),
        angular_stiffness: g.log(0.01, 20.0),
        ..Hand::NONE
    };
    let hand = if g.chance(0.5) { grip } else { hand };
    // The delay that the driver states may be wrong.
    let (specification, handle) = if changed { (other, own) } else { (s.clone(), *handle) };
    Emulation { specification, handle, hand, substep: 1e-4, catch_up: 2.0 }
}

fn plane(g: &mut Genes<'_>, seconds: f64) -> Plane {
    let from = g.maybe(0.4, |g| g.range(0.0, seconds)).unwrap_or(0.0);
    let lasts = g.maybe(0.4, |g| g.log(0.01, seconds)).unwrap_or(f64::INFINITY);
    Plane {
        normal: g.direction(),
        height: g.range(-0.06, 0.02),
        swing: g.maybe(0.3, |g| (g.log(1e-4, 0.05), g.log(0.1, 20.0))).unwrap_or_default(),
        reports_velocity: g.chance(0.5),
        there: (from, from + lasts),
        stiffness: g.log_or((10.0, 1e5), 0.1, (1e-2, 1e8)),
        damping: g.log_or((1e-2, 200.0), 0.1, (1e-6, 1e6)),
        tolerance: g.maybe(0.5, |g| g.log(1e-5, 5e-3)).unwrap_or(0.0),
        spread: g.maybe(0.7, |g| g.log(0.01, 2.0)).unwrap_or(0.0),
        braking: g.maybe(0.2, |g| g.log(1e-4, 0.05)).unwrap_or(0.0),
    }
}

fn models(g: &mut Genes<'_>, pair: Pair) -> Models {
    Models {
        pair,
        place: Pose::new(g.direction() * g.range(0.0, 1.3), g.turn(3.0)),
        moves: g.maybe(0.35, |g| (g.log(1e-4, 0.05), g.log(1e-3, 0.5), g.log(0.1, 10.0), g.log(5.0, 500.0))),
        mobility: g.maybe(0.2, |g| g.log(1e-3, 10.0)),
    }
}

fn edit(g: &mut Genes<'_>, seconds: f64) -> Edit {
    let time = g.range(0.0, seconds);
    let settings = Change::Settings {
        contact: (g.log(0.01, 100.0), g.log(0.01, 100.0)),
        coupling: (g.log(0.01, 100.0), g.log(0.01, 100.0)),
        friction: g.range(0.0, 2.0),
        slew: g.maybe(0.4, |g| g.log(0.1, 1e4)),
        passivity: g.chance(0.5),
    };
    let place = Pose::new(g.direction() * g.range(0.0, 1.3), g.turn(3.0));
    let scale = g.log(0.5, 2.0);
    let scene = g.pick(&[Change::Place(place), Change::Remove, Change::Add(place), Change::Replace(scale)]);
    Edit { time, change: if g.chance(0.5) { settings } else { scene } }
}
