//! The god-object: the proxy goes towards the grasped object, in steps of which none goes further than the known contacts allow (Zilles
//! and Salisbury 1995; with six degrees of freedom, Ortega, Redon and Coquillart 2007).

use palpate_core::glam::DMat3;
use palpate_core::{Contact, Pose, Twist};
use palpate_dynamics::{BodyState, MotionLimit, constrained_motion};

use super::contact::{ProxyContact, carried, motion_between};
use super::finder::{ContactFinder, QueryReport};
use super::{Proxy, Side};

/// Depth of the proxy, in tolerances d, up to which it is on the side that it came from. With more, it could be deeper in a thin wall
/// than half of that.
const ALLOWED_DEPTH: f64 = 0.25;

/// Depth, in tolerances d, to which a motion is planned: less than is allowed, so that what the plan leaves out (turning, contacts not
/// known yet) does not make it too deep at once.
const PLANNED_DEPTH: f64 = 0.2;

/// Motion of any point, in tolerances d, that is tried whatever the known contacts say. Without it the proxy sticks where turning uses up
/// all room.
const SAFE_STRIDE: f64 = 0.5;

/// Motion of any point, in tolerances d, that need not bring the proxy nearer to its goal.
const NEGLIGIBLE_MOTION: f64 = 1e-3;

/// Largest number of queries in a contact step. The rest of the way is gone in the next.
const MAX_QUERIES: usize = 8;

impl Proxy {
    /// Moves towards a pose of the object's centre of mass, as far as surfaces let it.
    pub fn follow(&mut self, goal: &Pose, finder: &mut impl ContactFinder) -> QueryReport {
        let mut report = QueryReport::default();
        let has_side = matches!(self.side, Side::Kept | Side::Disturbed);
        if !(has_side && self.approach(goal, finder, &mut report)) {
            // It has no side that it could be kept on: it begins anew at the object.
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

    /// Goes towards a pose; `false` if a surface has come over the proxy that it could not give way to.
    fn approach(&mut self, goal: &Pose, finder: &mut impl ContactFinder, report: &mut QueryReport) -> bool {
        if self.side == Side::Disturbed && !self.gives_way(finder, report) {
            return false;
        }
        // Halved as often as it was too deep.
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
            if !(shallow && (next == *goal || self.is_worth(&motion, share * caution, &next, goal))) {
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
        self.stays(finder, report)
    }

    /// Whether a share of a motion, to a pose, brings the proxy nearer to its goal, or is negligible. The contacts that a motion is
    /// planned by hold one point of each pair of convex patches; where another point touches there, the way back may be planned from
    /// that, and so on for ever.
    fn is_worth(&self, motion: &Twist, share: f64, next: &Pose, goal: &Pose) -> bool {
        let left = |from: &Pose| {
            let twist = motion_between(from, goal);
            self.body.kinetic_energy(&BodyState { pose: self.pose, twist })
        };
        self.length(motion) * share < NEGLIGIBLE_MOTION * self.tolerance || left(next) < left(&self.pose)
    }

    /// Goes out of the way of objects that have moved; `false` if it penetrates nevertheless, as between surfaces that close on it.
    fn gives_way(&mut self, finder: &mut impl ContactFinder, report: &mut QueryReport) -> bool {
        for _ in 0..MAX_QUERIES {
            let motion = self.plan(&Twist::ZERO, f64::NEG_INFINITY);
            let pose = self.pose.moved(&motion, 1.0);
            let complete = self.find(&pose, finder, report);
            if self.is_within(ALLOWED_DEPTH, complete, finder) {
                self.accept(&pose, finder);
                return true;
            }
            // Deeper than d it is not known from which side the surface came.
            if !self.is_within(1.0, complete, finder) {
                return false;
            }
            self.avoid(&pose, finder);
        }
        false
    }

    /// Finds the contacts where it is; `false` if it penetrates there.
    fn stays(&mut self, finder: &mut impl ContactFinder, report: &mut QueryReport) -> bool {
        let pose = self.pose;
        let complete = self.find(&pose, finder, report);
        self.accept(&pose, finder);
        self.is_within(ALLOWED_DEPTH, complete, finder)
    }

    /// The motion nearest to a wanted one that goes past no plane of the contacts, each of which leaves it no less room than
    /// `least` (m): where that is below 0, it comes back from planes that it is past.
    fn plan(&mut self, wanted: &Twist, least: f64) -> Twist {
        let planned = PLANNED_DEPTH * self.tolerance;
        // How far it may come back is not known before.
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

    /// The share of a motion in which no point of the object goes deeper into known contacts than allowed, however it turns, nor further
    /// than the reach into what is not known; but at least a safe stride.
    fn share_without_contact(&self, motion: &Twist) -> f64 {
        let allowed = ALLOWED_DEPTH * self.tolerance;
        let turning = motion.angular.length() * self.radius;
        let length = self.length(motion);
        let free = |room: f64, way: f64| if way > room { room.max(0.0) / way } else { 1.0 };
        let share = self.contacts().fold(free(self.reach + allowed, length), |share: f64, found| {
            let Contact { normal, depth, .. } = found.contact.contact;
            let way = motion.linear.dot(normal) + turning;
            share.min(free(found.allowed(allowed) - depth, way))
        });
        share.max(free(SAFE_STRIDE * self.tolerance, length))
    }

    /// Whether the last query was `complete` and found no contact deeper than so many tolerances beyond the object's recess.
    fn is_within(&self, tolerances: f64, complete: bool, finder: &impl ContactFinder) -> bool {
        let allowed = |object: usize| tolerances * self.tolerance + self.recess(object);
        complete && finder.depths().all(|(object, depth)| depth <= allowed(object))
    }

    /// Finds the contacts at a pose; `true` if all objects in reach were queried.
    fn find(&self, pose: &Pose, finder: &mut impl ContactFinder, report: &mut QueryReport) -> bool {
        finder.find(&(*pose * Pose::from_translation(-self.center_of_mass)), report)
    }

    /// Goes where the last query was.
    fn accept<F: ContactFinder>(&mut self, pose: &Pose, finder: &F) {
        for found in self.found.iter_mut().chain(self.manifold.contacts_mut()) {
            found.contact.contact = carried(&found.contact.contact, &self.pose, pose);
        }
        std::mem::swap(&mut self.found, &mut self.before);
        self.found.clear();
        let recesses = &self.recesses;
        let with_recess = |found: ProxyContact| ProxyContact {
            recess: recesses.get(found.object).copied().unwrap_or(0.0),
            ..found
        };
        self.found.extend(finder.contacts().map(with_recess));
        self.found.sort_unstable_by_key(ProxyContact::pair);
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

    /// Keeps the contacts that the last query, at `pose`, found the proxy to be too deep in.
    fn avoid(&mut self, pose: &Pose, finder: &impl ContactFinder) {
        let planned = PLANNED_DEPTH * self.tolerance;
        for found in finder.contacts() {
            let found = ProxyContact { recess: self.recess(found.object), ..found };
            if found.contact.contact.depth > found.allowed(planned) {
                let mut kept = found;
                kept.contact.contact = carried(&found.contact.contact, pose, &self.pose);
                self.manifold.keep(kept);
            }
        }
    }
}
