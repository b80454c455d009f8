//! Time stepping that stops at collisions (§3.4.4).
//!
//! A step is divided so that no point of the body goes further than [`Settings::travel`] from query to query. Each part is a
//! free flight with a query at its end. Where [`CollisionEvents`] tells that surfaces met on the way, the
//! body is set back to the estimated instant t_c of the first event, the response is applied there, and the time that is left
//! is divided anew.
//!
//! Setting back rather than projecting out: a body that is put where it first touched has lost no kinetic energy and gained no
//! potential energy by the detection, and its approach velocity is that of the impact. What penetrates all the same does so
//! because the estimate is one, or because the resolution has changed under a body in contact: that is projected out, by a
//! fifth of the depth from query to query, which does work ([`StepOutcome::lifted`]) but adds no velocity.
//!
//! Where the resolution has changed there may be no instant at which surfaces meet: coarse patches apart at the beginning,
//! finer ones that penetrate at the end, and neither ever touching. As §3.4.4 has it, the response is applied at the estimate
//! with what touches there, or else with the contact of the event. Where it has not, the estimate is good if the query saw
//! the surfaces coming, and is followed by bisection if it did not, since they came from beyond its reach. That ends too, with
//! the contact of the event, when the way that is left is shorter than what surfaces collide at: patches that were not
//! near at the beginning may be there at the end at another resolution than their neighbours.
//!
//! Time goes on in any case. Contacts that penetrate at a beginning make no events, but take impulses if they approach
//! after a flight. What does not come deeper in a flight than surfaces collide at is left to its end: resting contact, and
//! contacts that are deep only because the resolution has changed. And at most [`EVENTS`] events are followed until a flight
//! ends. Should there be more, it is taken as it is, its contacts respond at its end, and [`StepOutcome::exhausted`] counts it.

use glam::DVec3;
use palpate_collide::{
    CollisionEvent, CollisionEvents, ContactQuery, PatchContact, QueryError, QueryOutcome, Shape,
};
use palpate_core::{Pose, Twist};

use crate::body::{BodyState, RigidBody};
use crate::contacts::Touching;
use crate::flight::fly;
use crate::impact::{Law, solve, strike};
use crate::outcome::{Impact, QuerySample, StepError, StepOutcome};
use crate::settings::{Settings, SettingsError};

/// Most collision events that are followed in one flight.
const EVENTS: usize = 16;

/// Most flights that a step is divided into.
const FLIGHTS: f64 = 10_000.0;

/// Part of the depth that is projected out after each flight.
const PROJECTED: f64 = 0.2;

/// Approach speeds below this part of the fastest point's are none.
const APPROACH: f64 = 1e-9;

/// A free rigid body above a static one.
#[derive(Clone, Debug)]
pub struct Simulation {
    body: RigidBody,
    scene_pose: Pose,
    settings: Settings,
    state: BodyState,
    time: f64,
    query: ContactQuery,
    events: CollisionEvents,
    /// Contacts at the beginning of a flight.
    before: Vec<PatchContact>,
    touching: Touching,
    impacts: Vec<Impact>,
    samples: Vec<QuerySample>,
    /// Furthest point of the body from the centre of mass, m, and a ball around the scene object, in its frame.
    reach: f64,
    scene_ball: (DVec3, f64),
    /// The duration of the step, s.
    duration: f64,
    /// Since when, and from where, the body has not moved.
    still: (f64, Pose),
}

impl Simulation {
    /// A simulation of a body with a shape, above a static shape at a pose, from a state on.
    ///
    /// # Errors
    /// If a setting or the state is not valid, or the objects cannot be queried.
    pub fn new(
        body: RigidBody,
        shape: &Shape,
        scene: &Shape,
        scene_pose: Pose,
        start: BodyState,
        settings: Settings,
    ) -> Result<Self, SettingsError> {
        settings.validate(&start, &scene_pose)?;
        let center = body.center_of_mass();
        let furthest = |shape: &Shape, from: DVec3| {
            shape.clod().vertices.iter().map(|vertex| vertex.distance(from)).fold(0.0, f64::max)
        };
        let scene_center = scene.clod().source.center;
        let mut simulation = Self {
            body,
            scene_pose,
            settings,
            state: start,
            time: 0.0,
            query: ContactQuery::new(shape, scene),
            events: CollisionEvents::new(shape, scene),
            before: Vec::new(),
            touching: Touching::new(shape, scene),
            impacts: Vec::with_capacity(64),
            samples: Vec::with_capacity(64),
            reach: furthest(shape, center),
            scene_ball: (scene_center, furthest(scene, scene_center)),
            duration: 0.0,
            still: (0.0, start.pose),
        };
        simulation.look(&start)?;
        simulation.remember();
        Ok(simulation)
    }

    /// Advances by a duration (s).
    ///
    /// # Errors
    /// If the duration is not positive and finite, or the body too fast for it, or the objects cannot be queried where it
    /// gets to. Nothing has changed then.
    pub fn step(&mut self, duration: f64) -> Result<StepOutcome, StepError> {
        self.impacts.clear();
        self.samples.clear();
        if !(duration.is_finite() && duration > 0.0) {
            return Err(StepError::Duration { duration });
        }
        self.duration = duration;
        let end = self.time + duration;
        let before = (self.state, self.time, self.still);
        let mut outcome = StepOutcome::default();
        let (mut left, mut flights, mut followed) = (duration, 0.0, 0);
        while left > 0.0 {
            let (parts, speed) = self.parts(left);
            let flight = left / parts;
            let advanced = if flights + parts > FLIGHTS {
                Err(StepError::TooFast { speed, duration, travel: self.settings.travel })
            } else {
                self.advance(flight, followed < EVENTS, &mut outcome).map_err(StepError::from)
            };
            let advanced = match advanced {
                Ok(advanced) => advanced,
                Err(error) => {
                    (self.state, self.time, self.still) = before;
                    self.impacts.clear();
                    self.samples.clear();
                    self.look(&before.0)?;
                    self.remember();
                    return Err(error);
                }
            };
            if let Some(passed) = advanced {
                followed += 1;
                left -= passed;
            } else {
                (followed, flights) = (0, flights + 1.0);
                left = if parts > 1.0 { left - flight } else { 0.0 };
            }
        }
        // Sums of parts round.
        self.time = end;
        self.note_stillness();
        outcome.impacts = self.impacts.len();
        outcome.micro = self.impacts.iter().filter(|impact| impact.micro).count();
        outcome.queries = self.samples.len();
        Ok(outcome)
    }

    /// The number of flights that a time (s) is divided into, and how fast the fastest point gets in it, m/s.
    fn parts(&self, time: f64) -> (f64, f64) {
        let Settings { gravity, tolerance, travel, .. } = self.settings;
        let Twist { linear, angular } = self.state.twist;
        let speed = linear.length() + gravity.length() * time + angular.length() * self.reach;
        let (center, radius) = self.scene_ball;
        let apart = self.scene_pose.transform_point(center).distance(self.state.pose.translation);
        let clear = apart - radius - self.reach - tolerance;
        if !speed.is_finite() {
            return (f64::INFINITY, speed);
        }
        // As far as the balls around the bodies are apart nothing can be passed unseen.
        ((speed * time / travel.max(0.5 * clear)).ceil().max(1.0), speed)
    }

    /// A flight of a duration (s), with the response to the contacts at its end; or to a collision on its way, if it may be
    /// followed, and then the time until that.
    fn advance(
        &mut self,
        duration: f64,
        follow: bool,
        outcome: &mut StepOutcome,
    ) -> Result<Option<f64>, QueryError> {
        let end = self.flown(duration);
        self.look_at(&end, duration)?;
        let event = self.first_event(&end, duration);
        let Some(event) = event.filter(|_| follow) else {
            outcome.exhausted += usize::from(event.is_some());
            self.land(end, duration, None, outcome);
            return Ok(None);
        };
        outcome.events += 1;
        outcome.switched += usize::from(event.switched);
        let (met, passed, event) = self.locate(event, duration, outcome)?;
        self.land(met, passed, Some(&event), outcome);
        Ok(Some(passed))
    }

    /// The first collision event of a flight of a duration (s) to a state at which the query was made last, of surfaces that
    /// come deeper in it than they collide at.
    fn first_event(&mut self, end: &BodyState, duration: f64) -> Option<CollisionEvent> {
        self.events.reset();
        self.events.step(&self.before, self.settings.tolerance);
        let events = self.events.step(self.query.contacts(), self.settings.tolerance);
        let deepens = |event: &&CollisionEvent| {
            let velocity = end.twist.velocity_at(event.point - end.pose.translation);
            event.fraction < 1.0 && velocity.dot(event.normal) * duration > self.settings.touch()
        };
        events.iter().find(deepens).copied()
    }

    /// The instant of an event in a flight of a duration (s), and its state, at which the query is made last.
    fn locate(
        &mut self,
        mut event: CollisionEvent,
        duration: f64,
        outcome: &mut StepOutcome,
    ) -> Result<(BodyState, f64, CollisionEvent), QueryError> {
        let touch = self.settings.touch();
        let allowed = touch + self.before.iter().map(|found| found.contact.depth).fold(0.0, f64::max);
        let short = touch / self.fastest().max(f64::MIN_POSITIVE);
        let (mut apart, mut deep, mut part) = (0.0, duration, event.fraction);
        loop {
            let time = apart + part * (deep - apart);
            let state = self.flown(time);
            self.look_at(&state, time)?;
            let depths = self.query.contacts().iter().map(|found| found.contact.depth);
            let deepest = depths.fold(f64::NEG_INFINITY, f64::max);
            if event.switched {
                outcome.estimated += usize::from(deepest < -touch);
                return Ok((state, time, event));
            }
            if deepest > allowed {
                deep = time;
                event = self.first_event(&state, duration).unwrap_or(event);
            } else if deepest >= -touch {
                return Ok((state, time, event));
            } else {
                apart = time;
            }
            if deep - apart <= short {
                outcome.estimated += 1;
                let state = self.flown(apart);
                self.look_at(&state, apart)?;
                return Ok((state, apart, event));
            }
            part = 0.5;
        }
    }

    /// A bound on the speed of all points of the body, m/s.
    fn fastest(&self) -> f64 {
        self.state.twist.linear.length() + self.state.twist.angular.length() * self.reach
    }

    fn flown(&self, time: f64) -> BodyState {
        fly(&self.body, &self.state, self.settings.gravity, time)
    }

    /// Takes over a state at which the query was made last, and responds to its contacts.
    fn land(
        &mut self,
        state: BodyState,
        passed: f64,
        event: Option<&CollisionEvent>,
        outcome: &mut StepOutcome,
    ) {
        self.state = state;
        self.time += passed;
        let frame = self.body.frame(&state);
        let poses = [&frame, &self.scene_pose];
        self.touching.gather(self.query.contacts(), self.settings.touch(), &state, poses);
        let depth = self.touching.deepest();
        outcome.depth = outcome.depth.max(depth);
        if let Some(event) = event.filter(|_| self.touching.touches().is_empty()) {
            self.touching.add_event(event, &state);
        }
        self.remember();
        if self.touching.touches().is_empty() {
            return;
        }
        self.respond();
        if depth > 0.0 {
            self.project(outcome);
        }
    }

    /// Strikes the touching contacts, if any of them approach.
    fn respond(&mut self) {
        let Settings { gravity, restitution, friction, tolerance, travel, .. } = self.settings;
        let twist = self.state.twist;
        let fastest = self.fastest();
        let flight = self.duration.min(travel / fastest);
        // The speed whose bounce ends within the tolerance, or that gravity makes in two flights.
        let weight = gravity.length();
        let micro = (2.0 * weight * tolerance).sqrt().max(2.0 * weight * flight);
        let law = Law { restitution, friction, gravity, flight, micro };
        let (mut approach, mut collides) = (0.0f64, false);
        for touch in self.touching.touches_mut() {
            approach = approach.max(-twist.velocity_at(touch.arm).dot(touch.normal));
            collides |= law.aim(touch, &twist);
        }
        if approach <= APPROACH * fastest {
            return;
        }
        let energy_before = self.body.kinetic_energy(&self.state);
        self.state.twist = strike(&self.body, &self.state, self.touching.touches_mut(), friction);
        let touches = self.touching.touches();
        self.impacts.push(Impact {
            time: self.time,
            contacts: touches.iter().filter(|touch| touch.impulse != DVec3::ZERO).count(),
            micro: !collides,
            approach,
            impulse: touches.iter().map(|touch| touch.impulse).sum(),
            energy_before,
            energy_after: self.body.kinetic_energy(&self.state),
        });
    }

    /// Moves the body a part of the way out of what it penetrates: a plastic impact of displacements.
    fn project(&mut self, outcome: &mut StepOutcome) {
        let most = self.settings.touch();
        for (touch, depth) in self.touching.with_depths() {
            touch.target = (PROJECTED * depth).clamp(0.0, most) * touch.normal;
        }
        let still = BodyState::at_rest(self.state.pose);
        let way = solve(&self.body, &still, self.touching.touches_mut(), 0.0);
        let reached = way.linear.length() + way.angular.length() * self.reach;
        // Contacts that face one another ask for more than any way out gives.
        if reached.is_finite() && reached <= self.settings.travel {
            let before = self.body.potential_energy(&self.state, self.settings.gravity);
            self.state.pose = self.state.pose.moved(&way, 1.0);
            outcome.lifted += self.body.potential_energy(&self.state, self.settings.gravity) - before;
        }
    }

    /// Queries at a state.
    fn look(&mut self, state: &BodyState) -> Result<QueryOutcome, QueryError> {
        let mut settings = self.settings.query();
        if let Some(velocity) = &mut settings.error.velocity {
            velocity.twist = self.body.frame_twist(state);
        }
        let frame = self.body.frame(state);
        self.query.run(&frame, &self.scene_pose, &settings)
    }

    /// Queries at a state that is reached some time (s) from now, for the record.
    fn look_at(&mut self, state: &BodyState, ahead: f64) -> Result<(), QueryError> {
        let outcome = self.look(state)?;
        let (pose, twist) = (self.body.frame(state), self.body.frame_twist(state));
        self.samples.push(QuerySample { time: self.time + ahead, pose, twist, outcome });
        Ok(())
    }

    /// Takes the contacts of the last query for the beginning of what follows.
    fn remember(&mut self) {
        self.before.clear();
        self.before.extend_from_slice(self.query.contacts());
    }

    fn note_stillness(&mut self) {
        let (_, from) = self.still;
        let now = self.state.pose;
        let way =
            now.translation.distance(from.translation) + now.rotation_vector_to(&from).length() * self.reach;
        if way > self.settings.tolerance {
            self.still = (self.time, now);
        }
    }

    /// Where the body is and how it moves.
    pub fn state(&self) -> &BodyState {
        &self.state
    }

    /// Sets the body elsewhere. How long it has been still is counted anew.
    ///
    /// # Errors
    /// If the state is not finite, or the objects cannot be queried there.
    pub fn set_state(&mut self, state: BodyState) -> Result<(), SettingsError> {
        if !state.is_valid() {
            return Err(SettingsError::State);
        }
        self.look(&state)?;
        self.state = state;
        self.still = (self.time, state.pose);
        self.remember();
        Ok(())
    }

    /// The body.
    pub fn body(&self) -> &RigidBody {
        &self.body
    }

    /// Time since the simulation began, s.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// How long no point of the body has been further than [`Settings::tolerance`] from where it was, s: a body at rest is
    /// still for long, one that turns back at the top of its way only for an instant.
    pub fn still_for(&self) -> f64 {
        self.time - self.still.0
    }

    /// Kinetic and potential energy, J.
    pub fn energy(&self) -> f64 {
        let potential = self.body.potential_energy(&self.state, self.settings.gravity);
        self.body.kinetic_energy(&self.state) + potential
    }

    /// Impacts of the last step, in their order.
    pub fn impacts(&self) -> &[Impact] {
        &self.impacts
    }

    /// Queries of the last step, in their order: more than once for a time from which the body was set back.
    pub fn samples(&self) -> &[QuerySample] {
        &self.samples
    }

    /// Contacts of the last query, with the nodes of the bodies' levels.
    pub fn contacts(&self) -> &[PatchContact] {
        self.query.contacts()
    }
}
