//! Motion of the proxy as a god-object: it moves towards the grasped object in steps that go no further than
//! the known contacts allow (Zilles and Salisbury 1995; with six degrees of freedom, Ortega, Redon and
//! Coquillart 2007).

use palpate_core::glam::DMat3;
use palpate_core::{Contact, Pose, Twist};
use palpate_dynamics::{BodyState, MotionLimit, constrained_motion};

use super::contact::{ProxyContact, carried, motion_between};
use super::finder::{ContactFinder, QueryReport};
use super::{Proxy, Side};

/// Largest depth of the proxy, in tolerances d. With more, it could be deeper in a thin wall than half the
/// wall's thickness and leave on the wrong side.
const ALLOWED_DEPTH: f64 = 0.25;

/// Depth to which a motion is planned, in tolerances d. It is less than allowed, so that the effects that the
/// plan leaves out (rotation, contacts not known yet) do not make the proxy too deep at once.
const PLANNED_DEPTH: f64 = 0.2;

/// Motion of any point, in tolerances d, that is tried even if the known contacts leave no room for it.
/// Without it the proxy sticks where the bound on its rotation uses up all room.
const SAFE_STRIDE: f64 = 0.5;

/// Largest motion of any point, in tolerances d, that is accepted without bringing the proxy nearer to its
/// goal.
const NEGLIGIBLE_MOTION: f64 = 1e-3;

/// Largest number of queries in a contact step. The next step continues the motion.
const MAX_QUERIES: usize = 8;

impl Proxy {
    /// Moves towards a pose of the object's centre of mass, as far as surfaces allow.
    pub fn follow(&mut self, goal: &Pose, finder: &mut impl ContactFinder) -> QueryReport {
        let mut report = QueryReport::default();
        let has_side = matches!(self.side, Side::Kept | Side::Disturbed);
        if !(has_side && self.approach(goal, finder, &mut report)) {
            // The side is not known, or lost: restart at the object.
            self.found.clear();
            self.manifold.clear();
            let complete = self.find(goal, finder, &mut report);
            self.accept(goal, finder);
            if self.side != Side::Disabled {
                let kept = self.is_within(ALLOWED_DEPTH, complete, finder);
                self.side = if kept { Side::Kept } else { Side::Unknown };
            }
        }
        self.lag = if self.pose == *goal { 0.0 } else { self.length(&motion_between(&self.pose, goal)) };
        report
    }

    /// Moves towards a pose; `false` if the proxy penetrates too deep and its side is lost.
    ///
    /// Each round plans a motion with the known contacts and queries the contacts at its end. A pose is
    /// accepted if no contact there is deeper than allowed and it is nearer to the goal; otherwise the new
    /// contacts are kept for the next plan, and a pose that was too deep halves the next motion.
    fn approach(&mut self, goal: &Pose, finder: &mut impl ContactFinder, report: &mut QueryReport) -> bool {
        if self.side == Side::Disturbed && !self.move_clear(finder, report) {
            return false;
        }
        let mut caution = 1.0;
        for _ in 0..MAX_QUERIES {
            let wanted = motion_between(&self.pose, goal);
            let motion = self.plan(&wanted, 0.0);
            let share = self.share_without_contact(&motion);
            let whole = share * caution >= 1.0;
            let next =
                if whole && motion == wanted { *goal } else { self.pose.moved(&motion, share * caution) };
            let complete = self.find(&next, finder, report);
            let shallow = self.is_within(ALLOWED_DEPTH, complete, finder);
            if !(shallow && (next == *goal || self.is_nearer(&motion, share * caution, &next, goal))) {
                self.avoid(&next, finder);
                if !shallow {
                    caution *= 0.5;
                }
                continue;
            }
            self.accept(&next, finder);
            if whole {
                return true;
            }
            caution = 1.0;
        }
        // Out of queries: find the contacts at the pose reached.
        let pose = self.pose;
        let complete = self.find(&pose, finder, report);
        self.accept(&pose, finder);
        self.is_within(ALLOWED_DEPTH, complete, finder)
    }

    /// Whether a share of a motion, to the pose `next`, brings the proxy nearer to its goal, or is
    /// negligible. Nearness is measured by ½ **u**ᵀ M **u** for the motion **u** that is left. Plans know one
    /// point of each pair of convex patches; where the contact jumps between two points, motions planned with
    /// each in turn could lead back and forth without end.
    fn is_nearer(&self, motion: &Twist, share: f64, next: &Pose, goal: &Pose) -> bool {
        let left = |from: &Pose| {
            let twist = motion_between(from, goal);
            self.body.kinetic_energy(&BodyState { pose: self.pose, twist })
        };
        self.length(motion) * share < NEGLIGIBLE_MOTION * self.tolerance || left(next) < left(&self.pose)
    }

    /// Moves the proxy clear of objects that have moved; `false` if it still penetrates, as between closing
    /// surfaces.
    fn move_clear(&mut self, finder: &mut impl ContactFinder, report: &mut QueryReport) -> bool {
        for _ in 0..MAX_QUERIES {
            let motion = self.plan(&Twist::ZERO, f64::NEG_INFINITY);
            let pose = self.pose.moved(&motion, 1.0);
            let complete = self.find(&pose, finder, report);
            if self.is_within(ALLOWED_DEPTH, complete, finder) {
                self.accept(&pose, finder);
                return true;
            }
            // Deeper than d, the side that the surface came from is not known.
            if !self.is_within(1.0, complete, finder) {
                return false;
            }
            self.avoid(&pose, finder);
        }
        false
    }

    /// Plans the motion **u** = (**v**, **ω**) nearest to a wanted one that crosses no contact's plane:
    ///
    /// min ½ (**u** − **u**_w)ᵀ M (**u** − **u**_w), with (**v** + **ω** × **r**_i) · **n**_i ≤ room_i for
    /// all contacts i,
    ///
    /// where room_i = max(allowed depth − δ_i, `least`), m. With `least` below 0 the motion also backs out of
    /// planes that the proxy is too deep in; with 0 it only goes no deeper.
    fn plan(&mut self, wanted: &Twist, least: f64) -> Twist {
        let planned = PLANNED_DEPTH * self.tolerance;
        // A plane further away than the motion is long cannot limit it. A motion that backs out may be of any
        // length.
        let length = if least < 0.0 { f64::INFINITY } else { self.length(wanted) };
        let mut limits = std::mem::take(&mut self.limits);
        limits.clear();
        limits.extend(self.contacts().filter_map(|found| {
            let Contact { point, normal, depth, .. } = found.contact.contact;
            let room = (found.allowed(planned) - depth).max(least);
            let arm = point - self.pose.translation;
            (length > room).then_some(MotionLimit { direction: normal, arm, room })
        }));
        self.limits = limits;
        let Self { limits, multipliers, .. } = self;
        multipliers.resize(limits.len(), 0.0);
        let rotation = DMat3::from_quat(self.pose.rotation);
        constrained_motion(&self.body, &rotation, wanted, limits, multipliers)
    }

    /// Bound on the displacement of any point of the object by a motion, m: |v| + |ω| r.
    fn length(&self, motion: &Twist) -> f64 {
        motion.linear.length() + motion.angular.length() * self.radius
    }

    /// Conservative advancement: the share of a motion after which no point is deeper in the known contacts
    /// than allowed. A point moves along **n** by at most **v** · **n** + |**ω**| r, and the surfaces that
    /// are not known are at least the reach away. The share is at least a safe stride.
    fn share_without_contact(&self, motion: &Twist) -> f64 {
        let allowed = ALLOWED_DEPTH * self.tolerance;
        let turning = motion.angular.length() * self.radius;
        let length = self.length(motion);
        let free = |room: f64, bound: f64| if bound > room { room.max(0.0) / bound } else { 1.0 };
        let share = self.contacts().fold(free(self.reach + allowed, length), |share: f64, found| {
            let Contact { normal, depth, .. } = found.contact.contact;
            let bound = motion.linear.dot(normal) + turning;
            share.min(free(found.allowed(allowed) - depth, bound))
        });
        share.max(free(SAFE_STRIDE * self.tolerance, length))
    }

    /// Whether the last query was `complete` and found no contact deeper than a number of `tolerances` plus
    /// the object's recess.
    fn is_within(&self, tolerances: f64, complete: bool, finder: &impl ContactFinder) -> bool {
        let allowed = |object: usize| tolerances * self.tolerance + self.recess(object);
        complete && finder.depths().all(|(object, depth)| depth <= allowed(object))
    }

    /// Finds the contacts at a pose; `true` if all objects in reach were queried.
    fn find(&self, pose: &Pose, finder: &mut impl ContactFinder, report: &mut QueryReport) -> bool {
        finder.find(&(*pose * Pose::from_translation(-self.center_of_mass)), report)
    }

    /// Moves the proxy to the pose of the last query and takes over its contacts.
    fn accept<F: ContactFinder>(&mut self, pose: &Pose, finder: &F) {
        // The contacts so far, carried to the new pose, are those that the new ones may have jumped from.
        for found in self.found.iter_mut().chain(self.manifold.contacts_mut()) {
            found.contact.contact = carried(&found.contact.contact, &self.pose, pose);
        }
        std::mem::swap(&mut self.found, &mut self.before);
        let mut found = std::mem::take(&mut self.found);
        found.clear();
        found.extend(finder.contacts().map(|found| self.with_recess(found)));
        found.sort_unstable_by_key(ProxyContact::pair);
        self.found = found;
        self.pose = *pose;
        self.reach = finder.reach();
        if self.side == Side::Disturbed {
            self.side = Side::Kept;
        }
        if F::CONTACTS_JUMP {
            self.manifold.keep_jumped(&self.before, &self.found);
        }
        self.manifold.weigh(&self.found);
    }

    /// Keeps the contacts of the last query, at the rejected `pose`, that are deeper than planned, so that
    /// the next plan avoids them.
    fn avoid(&mut self, pose: &Pose, finder: &impl ContactFinder) {
        let planned = PLANNED_DEPTH * self.tolerance;
        for found in finder.contacts() {
            let mut found = self.with_recess(found);
            if found.contact.contact.depth > found.allowed(planned) {
                found.contact.contact = carried(&found.contact.contact, pose, &self.pose);
                self.manifold.keep(found);
            }
        }
    }

    fn with_recess(&self, found: ProxyContact) -> ProxyContact {
        ProxyContact { recess: self.recess(found.object), ..found }
    }
}
