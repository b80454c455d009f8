//! Blending of one contact model into the next, so that a new model makes no step in force (design of the
//! multirate loop, §5.1.2).
//!
//! For a time after a model has arrived, the body feels both: the old one with the share 1 − w of its gains
//! and the new one with w, which grows from step to step. Both are unilateral and follow the body's motion,
//! so that no contact ever attracts, and the blend is never stiffer than the stiffer of the two. Friction is
//! [taken over](LinearContactModel::take_over_friction) at once, with the same wrench. A model that arrives
//! during a blend waits, or is replaced by a newer one.

use palpate_core::Pose;

use crate::body::BodyState;
use crate::penalty::LinearContactModel;

/// The contacts of a haptic loop, blended from the models that arrive.
#[derive(Clone, Debug)]
pub struct ContactBlend {
    /// Contacts that the body feels.
    felt: LinearContactModel,
    /// Models before and after, while one blends into the other.
    outgoing: LinearContactModel,
    incoming: LinearContactModel,
    /// Model that has arrived during the blend, and the duration of its own blend, s.
    waiting: LinearContactModel,
    waiting_duration: Option<f64>,
    /// Time since the blend began, s.
    elapsed: f64,
    /// Duration of the blend, s; 0 if there is none.
    duration: f64,
}

impl Default for ContactBlend {
    fn default() -> Self {
        Self::new()
    }
}

impl ContactBlend {
    /// Longest duration of a blend, s. With longer ones contacts are felt late.
    pub const MAX_DURATION: f64 = 5e-3;

    /// A blend without contacts.
    pub const fn new() -> Self {
        let none = LinearContactModel::empty(&Pose::IDENTITY, f64::NAN);
        Self {
            felt: none,
            outgoing: none,
            incoming: none,
            waiting: none,
            waiting_duration: None,
            elapsed: 0.0,
            duration: 0.0,
        }
    }

    /// Contacts that the body feels in the next step.
    pub fn model(&self) -> &LinearContactModel {
        &self.felt
    }

    /// Takes a model that has arrived, with the body at `state`. It is blended in over `duration` (s), or at
    /// once if that is not positive; during a blend it waits for the end of it. Its surfaces are those of
    /// `age` (s) ago and are advanced by that, unless it is NaN.
    pub fn arrive(&mut self, model: &LinearContactModel, state: &BodyState, age: f64, duration: f64) {
        if self.is_blending() {
            self.waiting.assign(model);
            self.waiting.advance(age);
            self.waiting_duration = Some(duration);
        } else {
            self.incoming.assign(model);
            self.incoming.advance(age);
            self.start(state, duration);
        }
    }

    /// Lets friction yield at its limit, advances surfaces, and shifts the share to the new model.
    /// Called before each step of `dt` (s), with the state at its start.
    pub fn advance(&mut self, state: &BodyState, dt: f64) {
        if !self.is_blending() {
            self.felt.settle(state);
            self.felt.advance(dt);
            return;
        }
        for model in [&mut self.outgoing, &mut self.incoming] {
            model.settle(state);
            model.advance(dt);
        }
        self.waiting.advance(dt);
        self.elapsed += dt;
        if self.is_blending() {
            self.mix();
            return;
        }
        self.felt.assign(&self.incoming);
        self.duration = 0.0;
        if let Some(duration) = self.waiting_duration.take() {
            self.incoming.assign(&self.waiting);
            self.start(state, duration);
        }
    }

    fn is_blending(&self) -> bool {
        self.elapsed < self.duration
    }

    /// Starts to blend the incoming model in.
    fn start(&mut self, state: &BodyState, duration: f64) {
        self.incoming.take_over_friction(&self.felt, state);
        (self.elapsed, self.duration) = (0.0, duration);
        if self.is_blending() {
            // The incoming model has no share yet: the felt contacts do not change until the next step.
            self.outgoing.assign(&self.felt);
        } else {
            self.felt.assign(&self.incoming);
        }
    }

    /// Combines the models: gains w of the incoming one and 1 − w of the outgoing one, with w = elapsed /
    /// duration.
    fn mix(&mut self) {
        let share = self.elapsed / self.duration;
        self.felt.assign(&self.incoming);
        self.felt.scale_from(0, share);
        let first = self.felt.contacts().len();
        self.felt.extend(&self.outgoing, u64::MAX);
        self.felt.scale_from(first, 1.0 - share);
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::{Contact, Wrench};
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;
    use crate::differences::{random_direction, random_pose, random_twist, random_vector};
    use crate::penalty::{
        ContactClass, ContactParameters, CurvedContact, FoundContact, Friction, MAX_APPROACHING,
        MAX_CLUSTERS, MAX_PENALTY_CONTACTS, MovingBody,
    };

    const STEP: f64 = 1e-3;

    fn random_model(rng: &mut StdRng, pose: &Pose) -> LinearContactModel {
        let contacts = (0..rng.random_range(0..=16)).map(|_| {
            let point = pose.translation + random_vector(rng, 0.05);
            let (normal, depth) = (random_direction(rng), rng.random_range(-0.001..0.003));
            Contact { point, scene_point: point - normal * depth, normal, depth }
        });
        let contacts: Vec<_> = contacts.collect();
        let parameters = ContactParameters {
            stiffness: 1000.0,
            damping: 1.0,
            tolerance: 0.001,
            friction: Friction::coulomb(0.5),
        };
        LinearContactModel::from_contacts(contacts, pose, &parameters, 0.0)
    }

    fn distance(a: &Wrench, b: &Wrench) -> f64 {
        (*a - *b).force.length() + 10.0 * (*a - *b).torque.length()
    }

    /// Models arrive at random: on a body at rest the wrench changes to that of each in equal steps at most,
    /// and is that of the last one in the end.
    #[test]
    fn no_model_arrives_with_a_step() {
        let seed = 71;
        let mut rng = StdRng::seed_from_u64(seed);
        let pose = random_pose(&mut rng, 0.3);
        let state = BodyState::at_rest(pose);
        for case in 0..200 {
            let mut blend = ContactBlend::new();
            let steps = rng.random_range(2..10);
            let duration = f64::from(steps) * STEP;
            let (mut felt, mut last) = (Wrench::ZERO, blend.felt);
            for _ in 0..50 {
                if rng.random_bool(0.3) {
                    last = random_model(&mut rng, &pose);
                    blend.arrive(&last, &state, 0.0, duration);
                }
                let most = distance(&blend.incoming.wrench(&state), &blend.outgoing.wrench(&state))
                    / f64::from(steps);
                blend.advance(&state, STEP);
                let now = blend.model().wrench(&state);
                let change = distance(&now, &felt);
                assert!(
                    change <= most * (1.0 + 1e-6) + 1e-9,
                    "seed {seed}, case {case}: {change} N of {most}"
                );
                felt = now;
            }
            (0..20).for_each(|_| blend.advance(&state, STEP));
            let normal = |model: &LinearContactModel| {
                let mut smooth = *model;
                smooth.contacts_mut().iter_mut().for_each(|c| c.friction = Friction::NONE);
                smooth.wrench(&state)
            };
            let (found, wanted) = (normal(blend.model()), normal(&last));
            assert!(distance(&found, &wanted) < 1e-9, "seed {seed}, case {case}: {found:?} {wanted:?}");
        }
    }

    /// A model with as many contacts of each class as it has room for, all with as many curvature terms as
    /// there may be.
    fn full_model(rng: &mut StdRng, pose: &Pose) -> LinearContactModel {
        let mut model = LinearContactModel::empty(pose, 0.0);
        let gains =
            ContactParameters { stiffness: 1000.0, damping: 0.0, tolerance: 0.0, friction: Friction::NONE };
        let classes = [
            (ContactClass::Touching, MAX_CLUSTERS),
            (ContactClass::Approaching { braking_time: 0.01 }, MAX_APPROACHING),
        ];
        for (class, count) in classes {
            for _ in 0..count {
                let mut second = [[0.0; 6]; 6];
                (0..6).for_each(|i| second[i][i] = rng.random_range(50.0..100.0));
                let contact = CurvedContact {
                    point: pose.translation + random_vector(rng, 0.05),
                    depth: rng.random_range(0.001..0.003),
                    linear: random_direction(rng),
                    angular: random_vector(rng, 0.05),
                    second,
                    lever: 0.05,
                };
                model.push(class, FoundContact::Curved(&contact, pose), &gains, &MovingBody::STILL);
            }
        }
        model
    }

    /// Halfway from one full model to another, the body feels half of each.
    #[test]
    fn two_full_models_blend_without_loss() {
        let mut rng = StdRng::seed_from_u64(73);
        let pose = random_pose(&mut rng, 0.3);
        let (old, new) = (full_model(&mut rng, &pose), full_model(&mut rng, &pose));
        let state = BodyState::at_rest(pose.moved(&random_twist(&mut rng, 1e-4, 1e-3), 1.0));
        let mut blend = ContactBlend::new();
        blend.arrive(&old, &state, 0.0, 0.0);
        blend.arrive(&new, &state, 0.0, 2.0 * STEP);
        blend.advance(&state, STEP);
        let felt = blend.model();
        assert_eq!(felt.contacts().len(), MAX_PENALTY_CONTACTS);
        let terms = old.curvature_terms().len() + new.curvature_terms().len();
        assert_eq!(terms, 3 * MAX_PENALTY_CONTACTS);
        assert_eq!((felt.curvature_terms().len(), felt.overflow()), (terms, 0));
        let expected = (old.wrench(&state) + new.wrench(&state)) * 0.5;
        let off = distance(&felt.wrench(&state), &expected);
        assert!(off < 1e-9 * expected.force.length(), "{off} N");
    }

    #[test]
    fn without_a_duration_a_model_counts_at_once() {
        let mut rng = StdRng::seed_from_u64(72);
        let pose = random_pose(&mut rng, 0.3);
        let state = BodyState::at_rest(pose);
        let mut blend = ContactBlend::new();
        for _ in 0..20 {
            let model = random_model(&mut rng, &pose);
            blend.arrive(&model, &state, 0.0, 0.0);
            assert_eq!(blend.model().contacts().len(), model.contacts().len());
            blend.advance(&state, STEP);
        }
    }
}
