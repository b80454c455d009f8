//! Time stepping that stops at collisions (§3.4.4).
//!
//! A step is divided so that no point of the body moves farther than [`Settings::travel`] between queries.
//! Each part is a free flight with a query at its end. If [`CollisionEvents`] reports that surfaces met
//! during the flight, the body is set back to the estimated time t_c of the first event, the response is
//! applied there, and the remaining time is divided again.
//!
//! The body is set back rather than projected out: at the place of its first touch the detection has cost no
//! kinetic energy and added no potential energy, and its approach velocity is that of the impact. Some
//! penetration remains, because t_c is an estimate, or because the resolution has changed under a body in
//! contact. It is projected out by a fifth of the depth per query, which does work ([`StepOutcome::lifted`])
//! but adds no velocity.
//!
//! If the resolution has changed, there may be no time at which surfaces meet: coarse patches are apart at
//! the beginning, finer ones penetrate at the end, and neither pair ever touches. As in §3.4.4, the response
//! is then applied at the estimate, with the contacts that touch there, or else with the contact of the
//! event. If the resolution has not changed, the estimate is good if the first query found the surfaces
//! within its reach. If not, bisection refines it. Bisection also ends, with the contact of the event, once
//! the remaining motion is shorter than the distance at which surfaces collide: patches that were not near at
//! the beginning may have another resolution at the end than their neighbours.
//!
//! Time advances in any case. Contacts that penetrate at the beginning of a flight make no events, but take
//! impulses if they approach at its end. Contacts that do not deepen in a flight by more than the distance at
//! which surfaces collide also wait for its end: resting contact, and contacts that are deep only because the
//! resolution has changed. At most [`MAX_EVENTS`] events are followed per flight. With more, the flight is
//! completed, its contacts respond at its end, and [`StepOutcome::exhausted`] counts it.

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

/// Maximum number of collision events that are followed in one flight.
const MAX_EVENTS: usize = 16;

/// Maximum number of flights in a step; a faster body is refused.
const MAX_FLIGHTS: f64 = 10_000.0;

/// Part of the depth that is projected out after each flight. Larger values make resting bodies jitter.
const PROJECTION_SHARE: f64 = 0.2;

/// Approach speed, as a part of the fastest point's speed, at or below which contacts do not respond.
const MIN_APPROACH: f64 = 1e-9;

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
    /// Largest distance of the body's points from the centre of mass, m.
    reach: f64,
    /// Bounding sphere of the scene object in its frame: centre and radius, m.
    scene_ball: (DVec3, f64),
    /// Duration of the step, s.
    duration: f64,
    /// Time, s, and pose since which the body has not moved.
    still: (f64, Pose),
}

impl Simulation {
    /// Creates a simulation of a body with a shape, above a static shape at a pose, that starts from a state.
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
        simulation.query_at(&start)?;
        simulation.keep_contacts();
        Ok(simulation)
    }

    /// Advances by a duration (s).
    ///
    /// # Errors
    /// If the duration is not positive and finite, the body is too fast for it, or a contact query fails. The
    /// state is then unchanged.
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
        // `left`: time that remains; `followed`: events since the last completed flight.
        let (mut left, mut flights, mut followed) = (duration, 0.0, 0);
        while left > 0.0 {
            let (parts, speed) = self.flights_for(left);
            let flight = left / parts;
            let advanced = if flights + parts > MAX_FLIGHTS {
                Err(StepError::TooFast { speed, duration, travel: self.settings.travel })
            } else {
                self.advance(flight, followed < MAX_EVENTS, &mut outcome).map_err(StepError::from)
            };
            let advanced = match advanced {
                Ok(advanced) => advanced,
                // Restore the state from before the step.
                Err(error) => {
                    (self.state, self.time, self.still) = before;
                    self.impacts.clear();
                    self.samples.clear();
                    self.query_at(&before.0)?;
                    self.keep_contacts();
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
        // Sums of parts have rounding errors.
        self.time = end;
        self.note_stillness();
        outcome.impacts = self.impacts.len();
        outcome.micro = self.impacts.iter().filter(|impact| impact.micro).count();
        outcome.queries = self.samples.len();
        Ok(outcome)
    }

    /// Returns the number of flights into which a time (s) is divided, and the largest speed of a point in
    /// it, m/s.
    fn flights_for(&self, time: f64) -> (f64, f64) {
        let Settings { gravity, tolerance, travel, .. } = self.settings;
        let Twist { linear, angular } = self.state.twist;
        let speed = linear.length() + gravity.length() * time + angular.length() * self.reach;
        let (center, radius) = self.scene_ball;
        let apart = self.scene_pose.transform_point(center).distance(self.state.pose.translation);
        let clear = apart - radius - self.reach - tolerance;
        if !speed.is_finite() {
            return (f64::INFINITY, speed);
        }
        // While the bounding spheres are apart, half the gap can be moved without a query.
        ((speed * time / travel.max(0.5 * clear)).ceil().max(1.0), speed)
    }

    /// Advances by a flight of a duration (s), with the response to the contacts at its end. If there is a
    /// collision before, and events may be followed, it advances to the collision, responds, and returns the
    /// time until it.
    fn advance(
        &mut self,
        duration: f64,
        follow: bool,
        outcome: &mut StepOutcome,
    ) -> Result<Option<f64>, QueryError> {
        let end = self.flown(duration);
        self.query_and_record(&end, duration)?;
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

    /// Returns the first collision event of a flight of a duration (s) that ends at the state of the last
    /// query. Only surfaces that deepen by more than the distance at which they collide count.
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

    /// Returns the time of an event in a flight of a duration (s), with the state there, which is also that
    /// of the last query.
    fn locate(
        &mut self,
        mut event: CollisionEvent,
        duration: f64,
        outcome: &mut StepOutcome,
    ) -> Result<(BodyState, f64, CollisionEvent), QueryError> {
        // Interval [apart, deep] of the time: surfaces are apart at its beginning, and too deep at its end.
        let touch = self.settings.touch();
        let allowed = touch + self.before.iter().map(|found| found.contact.depth).fold(0.0, f64::max);
        let short = touch / self.fastest().max(f64::MIN_POSITIVE);
        let (mut apart, mut deep, mut part) = (0.0, duration, event.fraction);
        loop {
            let time = apart + part * (deep - apart);
            let state = self.flown(time);
            self.query_and_record(&state, time)?;
            let depths = self.query.contacts().iter().map(|found| found.contact.depth);
            let deepest = depths.fold(f64::NEG_INFINITY, f64::max);
            // A change of resolution: no time exists at which surfaces meet, so the estimate is final.
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
                self.query_and_record(&state, apart)?;
                return Ok((state, apart, event));
            }
            part = 0.5;
        }
    }

    /// Returns an upper bound of the speed of the body's points, m/s.
    fn fastest(&self) -> f64 {
        self.state.twist.linear.length() + self.state.twist.angular.length() * self.reach
    }

    /// Returns the state after a free flight of some time, s.
    fn flown(&self, time: f64) -> BodyState {
        fly(&self.body, &self.state, self.settings.gravity, time)
    }

    /// Moves the body to the state of the last query, and responds to its contacts.
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
        self.keep_contacts();
        if self.touching.touches().is_empty() {
            return;
        }
        self.respond();
        if depth > 0.0 {
            self.project(outcome);
        }
    }

    /// Applies impulses at the touching contacts, if any of them approaches.
    fn respond(&mut self) {
        let Settings { gravity, restitution, friction, tolerance, travel, .. } = self.settings;
        let twist = self.state.twist;
        let fastest = self.fastest();
        let flight = self.duration.min(travel / fastest);
        // The larger of the speed whose bounce ends within the tolerance d, √(2 g d), and of gravity's in two
        // flights.
        let weight = gravity.length();
        let micro = (2.0 * weight * tolerance).sqrt().max(2.0 * weight * flight);
        let law = Law { restitution, friction, gravity, flight, micro };
        let (mut approach, mut collides) = (0.0f64, false);
        for touch in self.touching.touches_mut() {
            approach = approach.max(-twist.velocity_at(touch.arm).dot(touch.normal));
            collides |= law.aim(touch, &twist);
        }
        if approach <= MIN_APPROACH * fastest {
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

    /// Moves the body out of penetrations by a part of their depth. Displacements are solved for like the
    /// velocities of a plastic impact.
    fn project(&mut self, outcome: &mut StepOutcome) {
        let most = self.settings.touch();
        for (touch, depth) in self.touching.with_depths() {
            touch.target = (PROJECTION_SHARE * depth).clamp(0.0, most) * touch.normal;
        }
        let still = BodyState::at_rest(self.state.pose);
        let displacement = solve(&self.body, &still, self.touching.touches_mut(), 0.0);
        let reached = displacement.linear.length() + displacement.angular.length() * self.reach;
        // Contacts that face one another may have no finite solution.
        if reached.is_finite() && reached <= self.settings.travel {
            let before = self.body.potential_energy(&self.state, self.settings.gravity);
            self.state.pose = self.state.pose.moved(&displacement, 1.0);
            outcome.lifted += self.body.potential_energy(&self.state, self.settings.gravity) - before;
        }
    }

    /// Runs the contact query at a state.
    fn query_at(&mut self, state: &BodyState) -> Result<QueryOutcome, QueryError> {
        let mut settings = self.settings.query();
        if let Some(velocity) = &mut settings.error.velocity {
            velocity.twist = self.body.frame_twist(state);
        }
        let frame = self.body.frame(state);
        self.query.run(&frame, &self.scene_pose, &settings)
    }

    /// Runs the contact query at a state that is reached in `ahead` (s), and records a sample.
    fn query_and_record(&mut self, state: &BodyState, ahead: f64) -> Result<(), QueryError> {
        let outcome = self.query_at(state)?;
        let (pose, twist) = (self.body.frame(state), self.body.frame_twist(state));
        self.samples.push(QuerySample { time: self.time + ahead, pose, twist, outcome });
        Ok(())
    }

    /// Keeps the contacts of the last query as those at the beginning of the next flight.
    fn keep_contacts(&mut self) {
        self.before.clear();
        self.before.extend_from_slice(self.query.contacts());
    }

    /// Restarts the time of rest if the body has moved by more than the tolerance.
    fn note_stillness(&mut self) {
        let (_, from) = self.still;
        let now = self.state.pose;
        let moved =
            now.translation.distance(from.translation) + now.rotation_vector_to(&from).length() * self.reach;
        if moved > self.settings.tolerance {
            self.still = (self.time, now);
        }
    }

    /// Pose and velocity of the body.
    pub fn state(&self) -> &BodyState {
        &self.state
    }

    /// Moves the body to another state. The time of rest starts again.
    ///
    /// # Errors
    /// If the state is not finite, or the objects cannot be queried there.
    pub fn set_state(&mut self, state: BodyState) -> Result<(), SettingsError> {
        if !state.is_valid() {
            return Err(SettingsError::State);
        }
        self.query_at(&state)?;
        self.state = state;
        self.still = (self.time, state.pose);
        self.keep_contacts();
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

    /// Time for which no point of the body has moved by more than [`Settings::tolerance`], s. It grows for a
    /// body at rest, and stays short for one that reverses at the top of its path.
    pub fn still_for(&self) -> f64 {
        self.time - self.still.0
    }

    /// Sum of kinetic and potential energy, J.
    pub fn energy(&self) -> f64 {
        let potential = self.body.potential_energy(&self.state, self.settings.gravity);
        self.body.kinetic_energy(&self.state) + potential
    }

    /// Impacts of the last step, in order of time.
    pub fn impacts(&self) -> &[Impact] {
        &self.impacts
    }

    /// Queries of the last step, in the order in which they were made. Times repeat where the body was set
    /// back.
    pub fn samples(&self) -> &[QuerySample] {
        &self.samples
    }

    /// Contacts of the last query, with the nodes of the bodies' levels.
    pub fn contacts(&self) -> &[PatchContact] {
        self.query.contacts()
    }
}
