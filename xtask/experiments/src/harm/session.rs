//! Runs the session that a genome encodes, and measures how near it came to harm.

use std::collections::{BTreeMap, VecDeque};
use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use palpate::device::{HapticDevice as _, IntendedPath};
use palpate::dynamics::{ContactClass, ContactParameters, Friction, LinearContactModel, MovingBody};
use palpate::glam::{DMat3, DVec3};
use palpate::promises::{ENERGY_BOUND, Invariant, RUNAWAY_SPEED};
use palpate::settings::{ContactSettings, CouplingSettings, OutputSettings};
use palpate::{
    Contact, ContactLoop, ContactUpdate, DynamicBody, HapticLoop, HapticRenderer, Object, Pose, Scene,
    SceneEditor, SceneId, Settings, SettingsEditor, Twist, Wrench,
};
use rand::RngExt as _;
use rand::rngs::StdRng;
use serde::Serialize;

use super::bench::{Bench, Tamper};
use super::faults::Kind;
use super::genome::Genome;
use super::judge::Step;
use super::plan::{Change, Edit, Plan, Plane, World};
use super::search::{Column, Trial};

/// Largest number of steps in a session: those with high rates end earlier.
const MAX_STEPS: u64 = 150_000;

/// Time without a contact or fault after which the hand counts as in free space, s.
const MIN_FREE_TIME: f64 = 0.3;

/// Delay of a step from which the device holds a wrench for too long to judge the handle's speed, s.
const LATE_STEP: f64 = 5e-3;

/// Time after a fault within which the wrench is checked, s, or a step and a half if that is longer.
const AFTER_FAULT: f64 = 1e-3;

/// Value relative to a bound from which the bound counts as broken: 1, with a margin for rounding.
pub const BROKEN: f64 = 1.0 + 1e-6;

/// Shortest engagement with which the wrench after a fault is checked, s: with none it is back at once.
const MIN_ENGAGEMENT: f64 = 0.02;

/// Share of the peak below which a wrench cannot make the handle run away.
const MIN_DRIVING_SHARE: f64 = 0.1;

/// Figure of a session: the largest value of a quantity relative to its bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Measure {
    /// One of the engine's own checks.
    Engine(Invariant),
    /// Checks at the device: wrench not finite, above the peak, faster than the slew rate, and not zero in a
    /// fault.
    SeenFinite,
    SeenPeak,
    SeenSlew,
    SeenFault,
    /// Wrench within a millisecond after a fault from which it has to come up from zero, relative to the
    /// peak.
    AfterFault,
    /// Energy that came out of the device in free space, relative to the bound on energy.
    FreeEnergy,
    /// True speed of the handle along the wrench, relative to the speed at which the engine drops the wrench.
    TrueSpeed,
}

impl Measure {
    /// All measures, starting with those of which a value above 1 is harm.
    pub const ALL: [Self; 15] = [
        Self::Engine(Invariant::Finite),
        Self::Engine(Invariant::Peak),
        Self::Engine(Invariant::Slew),
        Self::Engine(Invariant::Fault),
        Self::Engine(Invariant::Engagement),
        Self::Engine(Invariant::Energy),
        Self::Engine(Invariant::Heat),
        Self::Engine(Invariant::Runaway),
        Self::SeenFinite,
        Self::SeenPeak,
        Self::SeenSlew,
        Self::SeenFault,
        Self::AfterFault,
        Self::FreeEnergy,
        Self::TrueSpeed,
    ];

    pub fn name(self) -> String {
        match self {
            Self::Engine(invariant) => invariant.name().to_owned(),
            Self::SeenFinite => "finite, as seen".to_owned(),
            Self::SeenPeak => "peak, as seen".to_owned(),
            Self::SeenSlew => "slew, as seen".to_owned(),
            Self::SeenFault => "fault, as seen".to_owned(),
            Self::AfterFault => "wrench after a fault".to_owned(),
            Self::FreeEnergy => "energy in free space".to_owned(),
            Self::TrueSpeed => "speed along the wrench".to_owned(),
        }
    }

    /// Returns whether the engine promises a value of at most 1, so that more is harm.
    pub fn is_promised(self) -> bool {
        !matches!(self, Self::AfterFault | Self::FreeEnergy | Self::TrueSpeed)
    }

    /// Returns whether a value near 1 is a finding. Limits that the engine saturates at reach 1 by design.
    pub fn is_sought(self) -> bool {
        use Invariant::{Energy, Fault, Heat, Runaway};
        match self {
            Self::Engine(invariant) => matches!(invariant, Energy | Fault | Heat | Runaway),
            Self::SeenFinite | Self::SeenPeak | Self::SeenSlew => false,
            Self::SeenFault | Self::AfterFault | Self::FreeEnergy | Self::TrueSpeed => true,
        }
    }
}

/// Sessions with faults, of a length (s).
pub struct Sessions {
    pub seconds: f64,
}

impl Trial for Sessions {
    fn columns(&self) -> Vec<Column> {
        let column = |measure: &Measure| Column {
            name: measure.name(),
            is_promised: measure.is_promised(),
            is_sought: measure.is_sought(),
        };
        Measure::ALL.iter().map(column).collect()
    }

    fn run(&self, genome: &Genome) -> Outcome {
        run(genome, self.seconds, as_asked)
    }
}

/// Leaves a wrench as it is.
pub fn as_asked(wrench: &Wrench, _: &Wrench) -> Wrench {
    *wrench
}

/// Result of a session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Outcome {
    /// The settings were refused, with the reason.
    Refused(String),
    Ended(Ended),
    /// The engine panicked.
    Panicked(String),
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Ended {
    /// Values of the measures, relative to their bounds.
    pub parts: Vec<f64>,
    /// Whether one is above its bound that is promised to keep it, or the engine found an invariant broken.
    pub harm: bool,
    /// Writes in which the engine found an invariant broken, by its name.
    pub broken: BTreeMap<&'static str, u64>,
    pub steps: u64,
    /// Count of the genome's numbers that were read.
    pub read: u16,
    /// Whether anything was touched.
    pub touched: bool,
    /// What the session was, and what came of it.
    pub note: String,
}

impl Outcome {
    /// Returns whether a promise of the engine was broken, or it panicked.
    pub fn is_harm(&self) -> bool {
        match self {
            Self::Refused(_) => false,
            Self::Panicked(_) => true,
            Self::Ended(ended) => ended.harm,
        }
    }

    /// Returns what `session` returns, and catches panics in it.
    pub fn caught(session: impl FnOnce() -> Result<Ended, String>) -> Self {
        match std::panic::catch_unwind(AssertUnwindSafe(session)) {
            Ok(Ok(ended)) => Self::Ended(ended),
            Ok(Err(why)) => Self::Refused(why),
            Err(panic) => {
                let text = panic.downcast_ref::<String>().map(String::as_str);
                let text = text.or(panic.downcast_ref::<&str>().copied());
                Self::Panicked(text.unwrap_or("panicked").to_owned())
            }
        }
    }
}

/// Runs the session of a genome, and catches panics in it.
pub fn run(genome: &Genome, seconds: f64, tamper: Tamper) -> Outcome {
    Outcome::caught(|| {
        let plan = Plan::of(genome, seconds);
        let read = plan.read;
        Ok(Ended { read, ..Running::start(plan, genome, tamper)?.run(seconds) })
    })
}

/// A session under way.
struct Running {
    plan: Plan,
    rng: StdRng,
    haptic: HapticLoop,
    contact: ContactLoop,
    bench: Bench,
    settings: SettingsEditor,
    scene: SceneEditor,
    object: Option<SceneId>,
    /// Centre of mass of the grasped object at the start, and the object's radius, m.
    center: DVec3,
    radius: f64,
    pending: VecDeque<(f64, ContactUpdate)>,
    /// Times of the next query and of the next motion of the scene object that the host reports, s.
    next_query: f64,
    next_report: f64,
    /// Time of the newest contact model, as the host knows it, s.
    newest: f64,
    edits: VecDeque<Edit>,
    /// Time since which the hand has been in free space, s; and the work of the hand by then plus the
    /// kinetic energy that may come out, J.
    free: Option<(f64, f64)>,
    /// Time of the last late step, s.
    late: f64,
    touches: bool,
    touched: bool,
    /// Time of the last fault after which the wrench has to come up from zero, s.
    fault: Option<f64>,
    worst: Worst,
}

#[derive(Clone, Copy, Debug, Default)]
struct Worst {
    finite: f64,
    after_fault: f64,
    free_energy: f64,
    true_speed: f64,
}

impl Running {
    fn start(plan: Plan, genome: &Genome, tamper: Tamper) -> Result<Self, String> {
        let (probe, object) = plan.pair().objects();
        let path: IntendedPath = plan.hand.clone().path();
        let open = |path| plan.emulation.clone().open(path).map_err(|error| error.to_string());
        let bench = Bench::new(open(path)?, &plan.settings, tamper, genome.rng());
        let radius = probe.bounding_radius();
        let scene = match &plan.world {
            World::Planes(_) => Scene::new(),
            World::Models(models) => {
                let place = placed(&plan.settings, &models.place, probe, object);
                Scene::new().with(object.clone(), place)
            }
        };
        let stand_in = Box::new(open(Pose::IDENTITY.into())?);
        let renderer = HapticRenderer::new(probe.clone(), scene, stand_in, plan.settings);
        let mut renderer = renderer.map_err(|error| error.to_string())?;
        renderer.set_integrator(Arc::new(plan.integrator));
        let (settings, mut scene) = (renderer.settings_editor(), renderer.scene_editor());
        let object = match &plan.world {
            World::Planes(_) => None,
            World::Models(models) => {
                if let Some(mass) = models.mobility {
                    let body = DynamicBody {
                        mass,
                        inertia: DMat3::from_diagonal(DVec3::splat(0.4 * mass * radius * radius)),
                        center_of_mass: DVec3::ZERO,
                        gravity: DVec3::ZERO,
                        period: 1e-3,
                    };
                    scene.set_dynamics(SceneId(0), Some(body)).map_err(|error| error.to_string())?;
                }
                Some(SceneId(0))
            }
        };
        let (haptic, contact, _) = renderer.into_loops();
        let center = haptic.body_state().pose.translation;
        let mut edits = plan.edits.clone();
        edits.sort_by(|a, b| a.time.total_cmp(&b.time));
        Ok(Self {
            rng: genome.rng(),
            haptic,
            contact,
            bench,
            settings,
            scene,
            object,
            center,
            radius,
            pending: VecDeque::new(),
            next_query: 0.0,
            next_report: 0.0,
            newest: f64::NAN,
            edits: edits.into(),
            free: None,
            late: f64::NEG_INFINITY,
            touches: false,
            touched: false,
            fault: None,
            worst: Worst::default(),
            plan,
        })
    }

    fn run(mut self, seconds: f64) -> Ended {
        let period = 1.0 / self.plan.settings.timing.rate;
        let (often, varies) = self.plan.host;
        let (mut time, mut now, mut steps) = (0.0, 0.0, 0);
        while time < seconds && steps < MAX_STEPS {
            let mut elapsed = period * often * (1.0 + varies * self.rng.random_range(-1.0..1.0));
            let (faults, rng) = (&self.plan.faults, &mut self.rng);
            self.bench.faults.clear();
            self.bench.faults.extend(faults.iter().filter(|fault| fault.is_there(time, rng)));
            if let Some(late) = self.bench.is_there(Kind::Late) {
                elapsed += late.between(1e-3, 0.5) * self.rng.random_range(0.0..1.0);
            }
            let seen = now;
            time += elapsed;
            now += elapsed;
            let dt = self.reported(period, elapsed);
            let back = self.bench.is_there(Kind::ClockBack).map_or(0.0, |fault| fault.between(1e-4, 1.0));
            self.bench.time = time;
            self.edit(time);
            self.look(seen, time);
            if self.newest.is_nan() {
                self.newest = now;
            }
            self.bench.step = Step { now: now - back, dt, contacts: self.newest };
            self.step(elapsed);
            steps += 1;
        }
        self.end(steps)
    }

    /// Returns the duration of a step that the host passes, s.
    fn reported(&self, period: f64, elapsed: f64) -> f64 {
        let is_there = |kind| self.bench.is_there(kind);
        if is_there(Kind::StepZero).is_some() {
            return 0.0;
        }
        if let Some(fault) = is_there(Kind::StepHuge) {
            return fault.between(0.01, 1e6);
        }
        if let Some(fault) = is_there(Kind::StepNegative) {
            return -fault.between(1e-6, 10.0);
        }
        if let Some(fault) = is_there(Kind::StepNotFinite) {
            return if fault.size < 0.5 { f64::NAN } else { f64::INFINITY };
        }
        if self.plan.passes_elapsed { elapsed } else { period }
    }

    /// Takes a haptic step that ends `elapsed` (s) after the one before.
    fn step(&mut self, elapsed: f64) {
        let bench = &mut self.bench;
        // The parameters of the emulated hands are in range.
        if bench.take_hold().is_err() {
            self.worst.finite = f64::INFINITY;
        }
        bench.press();
        self.haptic.set_clutch(bench.is_there(Kind::Clutched).is_some());
        let held = *bench.held();
        let Step { now, dt, .. } = bench.step;
        let record = self.haptic.step_device(bench, now, dt);
        if !(record.object.is_valid() && record.contact.is_finite() && record.coupling.is_finite()) {
            self.worst.finite = f64::INFINITY;
        }

        let time = bench.time;
        let specification = bench.specification();
        let (force_peak, torque_peak) = (specification.peak_force, specification.peak_torque);
        let twist = bench.twist();
        let speed = |held: DVec3, peak: f64, velocity: DVec3, fastest: f64| {
            let size = held.length();
            if size > MIN_DRIVING_SHARE * peak { velocity.dot(held) / (size * fastest) } else { 0.0 }
        };
        if elapsed > LATE_STEP {
            self.late = time;
        }
        // While a host sleeps, the device holds the last wrench, so the handle's speed is not judged.
        if time - self.late > MIN_FREE_TIME {
            let linear = speed(held.force, force_peak, twist.linear, RUNAWAY_SPEED.0);
            let angular = speed(held.torque, torque_peak, twist.angular, RUNAWAY_SPEED.1);
            self.worst.true_speed = self.worst.true_speed.max(linear).max(angular);
        }

        let lost = [Kind::Unread, Kind::Elsewhere, Kind::Unwritten, Kind::Withheld];
        if lost.into_iter().any(|kind| bench.is_there(kind).is_some()) {
            self.fault = Some(time);
        } else if self.fault.is_some_and(|fault| time - fault <= AFTER_FAULT.max(1.5 * elapsed))
            && self.plan.settings.timing.engagement >= MIN_ENGAGEMENT
        {
            let part = |size: f64, peak: f64| if size > 0.0 { size / peak } else { 0.0 };
            let sent = bench.held();
            let part = part(sent.force.length(), force_peak).max(part(sent.torque.length(), torque_peak));
            self.worst.after_fault = self.worst.after_fault.max(part);
        }

        let work = bench.device().work();
        if self.touches || !bench.faults.is_empty() {
            self.free = None;
            return;
        }
        let (since, given) = self.free.unwrap_or((time, work));
        let moving =
            self.haptic.body_state().twist.linear.length_squared() * 0.5 * self.plan.settings.tool.mass;
        let scale = self.plan.settings.device.workspace_scale;
        // The kinetic energy of the object, ½ m v², may come out on top of the work done so far.
        let given = if time - since > MIN_FREE_TIME { given } else { work + moving / (scale * scale) };
        self.free = Some((since, given));
        let bound = ENERGY_BOUND.0 * force_peak + ENERGY_BOUND.1 * torque_peak;
        if bound > 0.0 {
            self.worst.free_energy = self.worst.free_energy.max((work - given) / bound);
        }
    }

    /// Queries contacts for the state of the step before, and hands over the models that are due.
    fn look(&mut self, seen: f64, time: f64) {
        let period = 1.0 / self.plan.contacts.rate;
        let missing = self.bench.is_there(Kind::NoContacts).is_some();
        if time >= self.next_query && !missing {
            self.move_object(time);
            let mut update = match &self.plan.world {
                World::Models(_) => self.contact.step(self.haptic.body_state(), seen),
                World::Planes(planes) => {
                    let parameters = self.settings.settings();
                    found(planes, &self.haptic, (self.center, self.radius), &parameters, seen)
                }
            };
            let body = self.haptic.body_state().pose.translation;
            for fault in &self.bench.faults {
                fault.spoil_contacts(&mut update, body);
            }
            let late = self.bench.is_there(Kind::LateContacts).map_or(0.0, |fault| fault.between(1e-3, 1.0));
            self.pending.push_back((time + self.plan.contacts.latency + late, update));
            self.next_query = time.max(self.next_query + period);
        }
        while let Some((_, update)) = self.pending.pop_front_if(|(due, _)| *due <= time) {
            self.haptic.update_contacts(&update);
            self.newest = update.time;
            self.touches = !update.model.is_empty();
            self.touched |= update.contacts > 0;
        }
    }

    fn move_object(&mut self, time: f64) {
        let World::Models(models) = &self.plan.world else { return };
        let (Some((amplitude, turn, frequency, report_rate)), Some(id)) = (models.moves, self.object) else {
            return;
        };
        if time < self.next_report {
            return;
        }
        self.next_report = time + self.rng.random_range(0.3..1.7) / report_rate;
        let (probe, object) = models.pair.objects();
        let place = placed(&self.plan.settings, &models.place, probe, object);
        let rate = std::f64::consts::TAU * frequency;
        let (sine, cosine) = (rate * time).sin_cos();
        let axis = place.rotation * DVec3::Z;
        let pose = Pose::new(
            place.translation + axis * (amplitude * sine),
            palpate::glam::DQuat::from_axis_angle(axis, turn * sine) * place.rotation,
        );
        let twist = Twist::new(axis * (amplitude * rate * cosine), axis * (turn * rate * cosine));
        // An object that was removed cannot be moved.
        let _ = self.scene.set_motion(id, pose, twist);
    }

    /// Makes the changes that are due. Changes that the session refuses have no effect.
    fn edit(&mut self, time: f64) {
        while let Some(Edit { change, .. }) = self.edits.pop_front_if(|edit| edit.time <= time) {
            let World::Models(models) = &self.plan.world else {
                self.set(&change);
                // The contact loop applies the change.
                self.contact.step(self.haptic.body_state(), time);
                continue;
            };
            let (probe, object) = models.pair.objects();
            let at = |pose: &Pose| placed(&self.plan.settings, pose, probe, object);
            match (change, self.object) {
                (Change::Settings { .. }, _) => self.set(&change),
                (Change::Place(pose), Some(id)) => {
                    let _ = self.scene.set_pose(id, at(&pose));
                }
                (Change::Remove, Some(id)) => {
                    let _ = self.scene.remove(id);
                    self.object = None;
                }
                (Change::Add(pose), _) => {
                    self.object = self.scene.add(object, at(&pose)).ok().or(self.object)
                }
                // With representatives, each size needs a distance field of its own, which takes seconds to
                // build.
                (Change::Replace(scale), Some(id))
                    if self.plan.settings.search.method == palpate::settings::ContactSearch::Levels =>
                {
                    if let Some(scaled) = object.scaled(scale) {
                        let _ = self.scene.replace(id, &scaled, at(&models.place));
                    }
                }
                _ => {}
            }
        }
    }

    fn set(&mut self, change: &Change) {
        let Change::Settings { contact, coupling, friction, slew, passivity } = *change else { return };
        let before = self.settings.settings();
        let specification = self.bench.specification();
        let settings = Settings {
            contact: ContactSettings {
                stiffness: before.contact.stiffness * contact.0,
                damping: before.contact.damping.map(|damping| damping * contact.1),
                friction,
                ..before.contact
            },
            coupling: CouplingSettings {
                stiffness: before.coupling.stiffness.map(|stiffness| stiffness * coupling.0),
                damping: before.coupling.damping.map(|damping| damping * coupling.1),
                ..before.coupling
            },
            output: OutputSettings {
                force_slew: slew
                    .map(|slew| slew * specification.peak_force.max(1e-3))
                    .or(before.output.force_slew),
                torque_slew: slew
                    .map(|slew| slew * specification.peak_torque.max(1e-3))
                    .or(before.output.torque_slew),
                passivity_controller: passivity,
            },
            ..before
        };
        if self.settings.set(settings.live()).is_ok() {
            self.bench.judge.change(&settings);
        }
    }

    fn end(mut self, steps: u64) -> Ended {
        let closed = self.bench.close();
        let invariants = self.haptic.invariants();
        let kept = |invariant| {
            let worst = invariants.record(invariant).worst;
            if worst.is_nan() { f64::INFINITY } else { worst }
        };
        let (seen, worst) = (self.bench.judge.parts, self.worst);
        let part = |measure: &Measure| match *measure {
            Measure::Engine(invariant) => kept(invariant),
            Measure::SeenFinite if closed.is_err() => f64::INFINITY,
            Measure::SeenFinite => seen.finite.max(worst.finite),
            Measure::SeenPeak => seen.peak,
            Measure::SeenSlew => seen.slew,
            Measure::SeenFault => seen.silence,
            Measure::AfterFault => worst.after_fault,
            Measure::FreeEnergy => worst.free_energy,
            Measure::TrueSpeed => worst.true_speed,
        };
        let broken = Invariant::ALL.iter().map(|it| (it.name(), invariants.record(*it).broken));
        let broken: BTreeMap<_, _> = broken.filter(|(_, times)| *times > 0).collect();
        let parts: Vec<f64> = Measure::ALL.iter().map(part).collect();
        let above = |(measure, part): (&Measure, &f64)| measure.is_promised() && *part > BROKEN;
        Ended {
            harm: !broken.is_empty() || Measure::ALL.iter().zip(&parts).any(above),
            parts,
            broken,
            steps,
            touched: self.touched,
            ..Ended::default()
        }
    }
}

/// Returns the pose of the scene object in the world, for a place given in sums of the objects' radii.
fn placed(settings: &Settings, place: &Pose, probe: &Object, object: &Object) -> Pose {
    let radii = probe.bounding_radius() + object.bounding_radius();
    let Pose { translation, rotation } = settings.device.frame;
    Pose::new(translation + place.translation * radii, place.rotation * rotation)
}

/// Contact query of a host: points of the object behind planes.
fn found(
    planes: &[Plane],
    haptic: &HapticLoop,
    (center, radius): (DVec3, f64),
    settings: &Settings,
    time: f64,
) -> ContactUpdate {
    const CORNERS: [DVec3; 4] = [
        DVec3::new(1.0, 1.0, 1.0),
        DVec3::new(-1.0, -1.0, 1.0),
        DVec3::new(-1.0, 1.0, -1.0),
        DVec3::new(1.0, -1.0, -1.0),
    ];
    let pose = haptic.body_state().pose;
    let scale = settings.device.workspace_scale;
    let mut update = ContactUpdate::none();
    (update.model, update.time) = (LinearContactModel::empty(&pose, time), time);
    for plane in planes.iter().filter(|plane| (plane.there.0..plane.there.1).contains(&time)) {
        let (amplitude, frequency) = plane.swing;
        let (sine, cosine) = (std::f64::consts::TAU * frequency * time).sin_cos();
        let height = scale * (plane.height + amplitude * sine);
        let velocity = plane.normal * (scale * amplitude * std::f64::consts::TAU * frequency * cosine);
        let twist = if plane.reports_velocity { Twist::new(velocity, DVec3::ZERO) } else { Twist::ZERO };
        let motion = MovingBody { twist, object: None };
        let parameters = ContactParameters {
            stiffness: plane.stiffness,
            damping: plane.damping,
            tolerance: scale * plane.tolerance,
            friction: Friction {
                static_coefficient: settings.contact.static_friction.unwrap_or(settings.contact.friction),
                dynamic_coefficient: settings.contact.friction,
            },
        };
        let count = if plane.spread > 0.0 { CORNERS.len() } else { 1 };
        for corner in &CORNERS[..count] {
            let point = pose.translation + pose.rotation * *corner * (0.577 * radius * plane.spread);
            let depth = height - plane.normal.dot(point - center);
            let contact =
                Contact { point, scene_point: point + plane.normal * depth, normal: -plane.normal, depth };
            let touches = depth > -parameters.tolerance;
            if touches || (plane.braking > 0.0 && depth > -0.1 * scale) {
                let class = if touches {
                    ContactClass::Touching
                } else {
                    ContactClass::Approaching { braking_time: plane.braking }
                };
                update.model.push(class, contact, &parameters, &motion);
                update.contacts += u32::from(touches);
                update.depth = update.depth.max(depth);
            }
        }
    }
    update
}
