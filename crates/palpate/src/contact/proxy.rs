//! The proxy: where the grasped object would be if it could not pass through surfaces (§5.6.1).
//!
//! Penalty forces know the object's present pose only: once it is deeper in a thin wall than half of that, or was carried
//! across between two contact queries, the nearest way out is the wrong one. The proxy is moved from where it was towards
//! the object, in steps of which none goes further than the contacts that were found before it allow, and stops where it
//! would penetrate more than a trace. From there it slides on as far as the surfaces let it
//! ([`constrained_motion`]): a god-object (Zilles and Salisbury 1995; of six degrees of freedom, Ortega, Redon and
//! Coquillart 2007). The contacts are those of the proxy, and their planes push the object back to it.
//!
//! Two convex patches have one contact only at a time, which jumps from corner to corner as they rock on one another. One that has
//! jumped is remembered where it was, as persistent contact manifolds of rigid-body engines do, until the surfaces there are
//! further apart than d or have slid by as much; it weighs less the further they have slid, and the nearer to it they touch now.
//!
//! Scene objects that move take along what was found of them, and the proxy goes out of their way before it follows. Where it
//! cannot, between two that close on it, or where an object is put over it, it starts anew where the grasped object is.
//!
//! The coarse meshes of textured objects may sink into one another by their recess, as far as detail lies back in them.
//!
//! Where the object itself penetrates no more than that trace, and has come there without passing anything, it is its own
//! proxy, with one query a step.

use palpate_collide::{PatchContact, QueryError, QuerySettings, SceneOutcome, SceneQuery};
use palpate_core::glam::{DMat3, DVec3};
use palpate_core::{Contact, Pose, Twist};
use palpate_dynamics::{Body, BodyState, MotionLimit, constrained_motion};

/// The penetration, in tolerances, up to which the proxy may go, and to which its motion is planned.
const SHALLOW: f64 = 0.25;
const PLANNED: f64 = 0.2;

/// A motion that takes no point further than this, in tolerances, is tried whatever turning may do on its way.
const STRIDE: f64 = 0.5;

/// One that takes no point further than this, in tolerances, need not bring the proxy nearer.
const TRACE: f64 = 1e-3;

/// Contacts closer than d are the same if their normals' cosine is above this.
const SAME_DIRECTION: f64 = 0.9;

/// The point where two patches touch has jumped if it is so far from where it was on the proxy, in tolerances.
const JUMP: f64 = 0.25;

/// Contacts that are remembered, at most.
const REMEMBERED: usize = 64;

/// Contacts that there is room for from the start.
const MOST: usize = 512;

/// Queries in a step of the contact loop, at most. What is left of the way is gone in the next.
const LOOKS: usize = 8;

/// What finds contacts for a proxy.
pub(crate) trait Search {
    /// Whether two patches have one contact only at a time, which jumps.
    const JUMPS: bool;

    /// How far contacts are looked for, m.
    fn reach(&self) -> f64;

    /// Looks for the contacts of the probe with its mesh's frame at a pose; `true` if all objects in reach were looked at.
    fn look(&mut self, mesh: &Pose, followed: &mut Followed) -> bool;

    /// The contacts of the last look.
    fn contacts(&self) -> impl Iterator<Item = Found>;

    /// The largest depths, m, that the last look found in scene objects, by their places.
    fn depths(&self) -> impl Iterator<Item = (usize, f64)>;
}

/// By levels of detail.
pub(crate) struct LevelSearch<'a> {
    pub scene: &'a mut SceneQuery,
    /// The tolerance is the reach.
    pub settings: QuerySettings,
}

impl Search for LevelSearch<'_> {
    const JUMPS: bool = true;

    fn reach(&self) -> f64 {
        self.settings.tolerance
    }

    fn look(&mut self, mesh: &Pose, followed: &mut Followed) -> bool {
        let outcome = self.scene.run(mesh, &self.settings);
        followed.count(&outcome);
        outcome.is_ok_and(|outcome| outcome.invalid == 0)
    }

    fn contacts(&self) -> impl Iterator<Item = Found> {
        self.scene.contacts().flat_map(|with| {
            let object = with.object.place();
            with.contacts.iter().map(move |&contact| Found { contact, object })
        })
    }

    fn depths(&self) -> impl Iterator<Item = (usize, f64)> {
        self.scene.contacts().filter_map(|with| Some((with.object.place(), with.outcome.deepest?)))
    }
}

/// The proxy, and what it touches.
#[derive(Clone, Debug)]
pub(crate) struct Proxy {
    body: Body,
    /// Centre of mass in the mesh's frame, m.
    center_of_mass: DVec3,
    /// Bounding radius about the centre of mass, m.
    radius: f64,
    /// d, m.
    tolerance: f64,
    /// By how much the coarse mesh may sink into each scene object, m; 0 for those beyond the list.
    recesses: Vec<f64>,
    /// Whether there is to be one; otherwise it always is where the object is.
    enabled: bool,
    /// Of the centre of mass.
    pose: Pose,
    /// Whether the proxy penetrates no more than a trace there, and so is on the side of all surfaces that it came from.
    sound: bool,
    /// How far any point of the object was from where the proxy has it when it had followed last, at most, m.
    lag: f64,
    /// All contacts within the reach (m) there, by pairs of patches.
    found: Vec<Found>,
    reach: f64,
    /// Whether the scene has changed since.
    stale: bool,
    /// What was found before that.
    before: Vec<Found>,
    /// Contacts in which it was too deep where it was to go, and those that have jumped elsewhere between the same patches, as its
    /// present pose has them.
    remembered: Vec<Found>,
    limits: Vec<MotionLimit>,
    multipliers: Vec<f64>,
}

/// A contact with a scene object.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found {
    pub contact: PatchContact,
    /// By the scene's order.
    pub object: usize,
}

impl Found {
    /// Scene object and patches that it is between.
    fn pair(&self) -> (usize, u32, u32) {
        (self.object, self.contact.probe_node, self.contact.scene_node)
    }
}

/// How a step of the proxy went.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Followed {
    /// Number of contacts that queries dropped.
    pub dropped: usize,
    /// Whether a query failed, or left out an object that cannot be queried.
    pub refused: bool,
    /// Pairs that did not converge, in all queries.
    pub not_converged: usize,
}

impl Followed {
    fn count(&mut self, outcome: &Result<SceneOutcome, QueryError>) {
        match outcome {
            Ok(SceneOutcome { query, invalid, .. }) => {
                self.dropped += query.dropped;
                self.refused |= *invalid > 0;
                self.not_converged += query.not_converged;
            }
            Err(_) => self.refused = true,
        }
    }
}

impl Proxy {
    pub fn new(
        body: Body,
        center_of_mass: DVec3,
        radius: f64,
        tolerance: f64,
        recesses: Vec<f64>,
        enabled: bool,
    ) -> Self {
        Self {
            body,
            center_of_mass,
            radius,
            tolerance,
            recesses,
            enabled,
            pose: Pose::IDENTITY,
            sound: false,
            lag: 0.0,
            found: Vec::with_capacity(MOST),
            before: Vec::with_capacity(MOST),
            reach: 0.0,
            stale: false,
            remembered: Vec::with_capacity(REMEMBERED),
            limits: Vec::with_capacity(MOST),
            multipliers: Vec::with_capacity(MOST),
        }
    }

    /// Where it is: the pose of the centre of mass.
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// How far any point of the object was from where the proxy has it when it had followed last, at most, m.
    pub fn lag(&self) -> f64 {
        self.lag
    }

    /// Contacts there, within the reach last asked for, and those remembered that hold the proxy as well.
    pub fn contacts(&self) -> impl Iterator<Item = &Found> {
        self.found.iter().chain(&self.remembered)
    }

    /// Contacts there alone.
    pub fn found(&self) -> &[Found] {
        &self.found
    }

    /// How deep the proxy may be in a scene object, m, where it may be so deep in one that is not textured.
    fn allowed(&self, object: usize, depth: f64) -> f64 {
        depth + self.recesses.get(object).unwrap_or(&0.0)
    }

    /// By how much the coarse mesh may sink into each scene object, m, from now on.
    pub fn set_recesses(&mut self, recesses: Vec<f64>) {
        self.recesses = recesses;
    }

    /// What was found may hold no longer.
    pub fn scene_has_changed(&mut self) {
        self.stale = true;
        self.found.clear();
        self.remembered.clear();
    }

    /// A scene object has moved from one pose to another: what was found of it moves along, and so stays on its side.
    pub fn object_has_moved(&mut self, object: usize, from: &Pose, to: &Pose) {
        self.stale = true;
        let motion = *to * from.inverse();
        let found = self.found.iter_mut().chain(&mut self.remembered);
        for Found { contact, .. } in found.filter(|found| found.object == object) {
            let Contact { point, scene_point, normal, depth } = contact.contact;
            let plane = motion.transform_point(point - normal * depth);
            let normal = motion.transform_vector(normal);
            let scene_point = motion.transform_point(scene_point);
            contact.contact = Contact { point, scene_point, normal, depth: (point - plane).dot(normal) };
        }
    }

    /// Moves towards the pose of the object's centre of mass, as far as surfaces let it.
    pub fn follow(&mut self, goal: &Pose, search: &mut impl Search) -> Followed {
        let mut followed = Followed::default();
        if !(self.enabled && self.sound && self.approach(goal, search, &mut followed)) {
            // It has no side that it could be kept on.
            self.found.clear();
            self.remembered.clear();
            let complete = self.look(goal, search, &mut followed);
            self.accept(goal, search);
            self.sound = self.is_within(SHALLOW, complete, search);
        }
        self.lag = if self.pose == *goal { 0.0 } else { self.length(&motion_between(&self.pose, goal)) };
        followed
    }

    /// Goes towards a pose; `false` if a surface has come over the proxy that it could not give way to.
    fn approach(&mut self, goal: &Pose, search: &mut impl Search, followed: &mut Followed) -> bool {
        if self.stale && !self.gives_way(search, followed) {
            return false;
        }
        // Halved as often as it was too deep.
        let mut caution = 1.0;
        for _ in 0..LOOKS {
            let wanted = motion_between(&self.pose, goal);
            let motion = self.plan(&wanted, 0.0);
            let share = self.share_without_contact(&motion);
            let whole = share * caution >= 1.0;
            let next =
                if whole && motion == wanted { *goal } else { self.pose.moved(&motion, share * caution) };
            let complete = self.look(&next, search, followed);
            let shallow = self.is_within(SHALLOW, complete, search);
            if !(shallow && (next == *goal || self.is_worth(&motion, share * caution, &next, goal))) {
                self.avoid(&next, search);
                if !shallow {
                    caution *= 0.5;
                }
                continue;
            }
            self.accept(&next, search);
            if whole {
                return true;
            }
            caution = 1.0;
        }
        self.stays(search, followed)
    }

    /// Whether a share of a motion, to a pose, brings the proxy nearer to its goal, or is but a trace. The contacts that a motion
    /// is planned by know one point of each pair of convex patches; where another one holds there, the way back may be
    /// planned from that, and so on.
    fn is_worth(&self, motion: &Twist, share: f64, next: &Pose, goal: &Pose) -> bool {
        let left = |from: &Pose| {
            let twist = motion_between(from, goal);
            self.body.kinetic_energy(&BodyState { pose: self.pose, twist })
        };
        self.length(motion) * share < TRACE * self.tolerance || left(next) < left(&self.pose)
    }

    /// Goes out of the way of what has moved; `false` if it penetrates nevertheless, as between surfaces that close on it.
    fn gives_way(&mut self, search: &mut impl Search, followed: &mut Followed) -> bool {
        for _ in 0..LOOKS {
            let motion = self.plan(&Twist::ZERO, f64::NEG_INFINITY);
            let pose = self.pose.moved(&motion, 1.0);
            let complete = self.look(&pose, search, followed);
            if self.is_within(SHALLOW, complete, search) {
                self.accept(&pose, search);
                return true;
            }
            // From which side that came over it is not known.
            if !self.is_within(1.0, complete, search) {
                return false;
            }
            self.avoid(&pose, search);
        }
        false
    }

    /// Looks again where it is; `false` if it penetrates there.
    fn stays(&mut self, search: &mut impl Search, followed: &mut Followed) -> bool {
        let pose = self.pose;
        let complete = self.look(&pose, search, followed);
        self.accept(&pose, search);
        self.is_within(SHALLOW, complete, search)
    }

    /// The motion nearest to a wanted one that goes past no plane of the contacts, each of which leaves it no less room than
    /// `least` (m): where that is less than 0, it comes back from those that it is past.
    fn plan(&mut self, wanted: &Twist, least: f64) -> Twist {
        let planned = PLANNED * self.tolerance;
        // How far it may come back is not known before.
        let length = if least < 0.0 { f64::INFINITY } else { self.length(wanted) };
        let mut limits = std::mem::take(&mut self.limits);
        limits.clear();
        limits.extend(self.contacts().filter_map(|found| {
            let Contact { point, normal, depth, .. } = found.contact.contact;
            let room = (self.allowed(found.object, planned) - depth).max(least);
            let arm = point - self.pose.translation;
            (length > room).then_some(MotionLimit { direction: normal, arm, room })
        }));
        self.limits = limits;
        let Self { limits, multipliers, .. } = self;
        multipliers.resize(limits.len(), 0.0);
        let rotation = DMat3::from_quat(self.pose.rotation);
        constrained_motion(&self.body, &rotation, wanted, limits, multipliers)
    }

    /// How far, m, a motion takes any point of the object, at most.
    fn length(&self, motion: &Twist) -> f64 {
        motion.linear.length() + motion.angular.length() * self.radius
    }

    /// The share of a motion in which no point of the object goes deeper into what was found than allowed, however it
    /// turns, nor further than the reach into what was not found; but at least a stride.
    fn share_without_contact(&self, motion: &Twist) -> f64 {
        let allowed = SHALLOW * self.tolerance;
        let turning = motion.angular.length() * self.radius;
        let length = self.length(motion);
        let free = |room: f64, way: f64| if way > room { room.max(0.0) / way } else { 1.0 };
        let share = self.contacts().fold(free(self.reach + allowed, length), |share: f64, found| {
            let Contact { normal, depth, .. } = found.contact.contact;
            let way = motion.linear.dot(normal) + turning;
            share.min(free(self.allowed(found.object, allowed) - depth, way))
        });
        share.max(free(STRIDE * self.tolerance, length))
    }

    /// Whether the last look was `complete` and found no contact deeper than so many tolerances, of objects that are not
    /// textured.
    fn is_within(&self, tolerances: f64, complete: bool, search: &impl Search) -> bool {
        let allowed = |object: usize| self.allowed(object, tolerances * self.tolerance);
        complete && search.depths().all(|(object, depth)| depth <= allowed(object))
    }

    /// Looks at a pose; `true` if all objects in reach were looked at.
    fn look(&self, pose: &Pose, search: &mut impl Search, followed: &mut Followed) -> bool {
        search.look(&(*pose * Pose::from_translation(-self.center_of_mass)), followed)
    }

    /// Is where the last look was.
    fn accept<S: Search>(&mut self, pose: &Pose, search: &S) {
        for found in self.found.iter_mut().chain(&mut self.remembered) {
            found.contact.contact = carried(&found.contact.contact, &self.pose, pose);
        }
        std::mem::swap(&mut self.found, &mut self.before);
        self.found.clear();
        self.found.extend(search.contacts());
        self.found.sort_unstable_by_key(Found::pair);
        self.pose = *pose;
        self.reach = search.reach();
        self.stale = false;
        if S::JUMPS {
            self.remember_jumps();
        }
        self.weigh_remembered();
    }

    /// Remembers what was found between two patches before, where they touch elsewhere now.
    fn remember_jumps(&mut self) {
        for at in 0..self.before.len() {
            let before = self.before[at];
            let near = before.contact.contact.depth > -self.tolerance;
            let jumped = |(_, distance): (_, f64)| distance > JUMP * self.tolerance;
            if near && self.now_of(&before).is_some_and(jumped) {
                self.remember(before);
            }
        }
    }

    /// What the present contact of the same pair of patches that is nearest to an earlier one weighs, and how far apart
    /// they are on the proxy, m.
    fn now_of(&self, earlier: &Found) -> Option<(f64, f64)> {
        let pair = earlier.pair();
        let first = self.found.partition_point(|found| found.pair() < pair);
        let of_pair = self.found[first..].iter().take_while(|found| found.pair() == pair);
        let point = earlier.contact.contact.point;
        of_pair
            .map(|found| (found.contact.weight, found.contact.contact.point.distance(point)))
            .min_by(|one, other| one.1.total_cmp(&other.1))
    }

    /// Forgets what has come further apart than d or slid as far along the surface, and weighs the rest as its pair of patches:
    /// less where it has slid, or is within d of where they touch now.
    fn weigh_remembered(&mut self) {
        let tolerance = self.tolerance;
        let mut remembered = std::mem::take(&mut self.remembered);
        remembered.retain_mut(|found| {
            let Contact { point, scene_point, normal, depth } = found.contact.contact;
            let slid = (point - scene_point).reject_from(normal).length() / tolerance;
            let (weight, aside) = self.now_of(found).unwrap_or_default();
            found.contact.weight = weight * (aside / tolerance).min(1.0) * (1.0 - slid).max(0.0);
            depth > -tolerance && slid < 1.0
        });
        self.remembered = remembered;
    }

    /// Remembers in what the last query, at `pose`, found the proxy to be too deep.
    fn avoid(&mut self, pose: &Pose, search: &impl Search) {
        let planned = PLANNED * self.tolerance;
        for Found { contact: found, object } in search.contacts() {
            if found.contact.depth > self.allowed(object, planned) {
                let contact = carried(&found.contact, pose, &self.pose);
                self.remember(Found { contact: PatchContact { contact, ..found }, object });
            }
        }
    }

    /// Remembers a contact, in place of what was known of it. Where there is no room for it, the shallowest gives way.
    fn remember(&mut self, found: Found) {
        let Contact { point, normal, depth, .. } = found.contact.contact;
        let same = |other: &Found| {
            let Contact { point: there, normal: towards, .. } = other.contact.contact;
            other.pair() == found.pair()
                && there.distance(point) < self.tolerance
                && towards.dot(normal) > SAME_DIRECTION
        };
        let depth_of = |found: &Found| found.contact.contact.depth;
        let shallower = |one: &&mut Found, other: &&mut Found| depth_of(one).total_cmp(&depth_of(other));
        if let Some(known) = self.remembered.iter().position(same) {
            self.remembered[known] = found;
        } else if self.remembered.len() < REMEMBERED {
            self.remembered.push(found);
        } else if let Some(shallowest) = self.remembered.iter_mut().min_by(shallower)
            && depth_of(shallowest) < depth
        {
            *shallowest = found;
        }
    }
}

/// The motion (a twist for the time of 1) from one pose to another.
pub(crate) fn motion_between(from: &Pose, to: &Pose) -> Twist {
    Twist::new(to.translation - from.translation, from.rotation_vector_to(to))
}

/// A contact of the body at one pose of its centre of mass, as its plane holds the body at another: the point moves with
/// the body, the plane stays.
pub(crate) fn carried(contact: &Contact, from: &Pose, to: &Pose) -> Contact {
    if from == to {
        return *contact;
    }
    let arm = from.rotation.conjugate() * (contact.point - from.translation);
    let point = to.transform_point(arm);
    Contact { point, depth: contact.depth + (point - contact.point).dot(contact.normal), ..*contact }
}
