//! Bodies that contacts push and whose motion a host computes.
//!
//! A host takes the impulses of contacts in steps of its own world, so that its answer comes late: by tens of
//! milliseconds where it steps at the rate of a display. Until then a body moves here as impulses p move it,
//! by R M⁻¹ p. What the host says of an earlier time is held against where the body was here at that time,
//! and the difference is taken over gradually.

use arrayvec::ArrayVec;
use glam::{DMat3, DVec3};
use palpate_core::{Pose, Twist};

use super::Constraint;
use super::response::Response;
use crate::algebra::vector::{Six, add};
use crate::body::Body;

/// Largest number of bodies that a step pushes. With more, steps with several take longer.
pub(crate) const MAX_PUSHED: usize = 3;

/// Number of past steps that a host's state is held against. With fewer, states that come late are held
/// against a later time.
const MAX_PAST: usize = 64;

/// Time in which a difference to the host is taken over, in delays, and at least, s. With less, the body
/// jerks at each answer; with more, it stays off for longer.
const TAKE_OVER: (f64, f64) = (1.0, 2e-3);

/// Difference to the host, m at the device and rad, beyond which a body was put elsewhere and is placed there
/// at once. With less, it jumps where a host answers late; with more, it strikes what lies on its way.
const ELSEWHERE: (f64, f64) = (0.05, 1.0);

/// State of a body, told by its host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HostState {
    /// Time at which it had this state, s.
    pub time: f64,
    /// Pose of its centre of mass.
    pub pose: Pose,
    /// Velocity of its centre of mass, and angular velocity.
    pub twist: Twist,
}

/// A body that contacts push, as it moves until its host answers.
#[derive(Clone, Debug)]
pub struct PushedBody {
    coordinates: Coordinates,
    /// Pose of the centre of mass, and its twist.
    pose: Pose,
    twist: Twist,
    /// What is left to take over from the host.
    off: Difference,
    /// What this step takes over.
    taken: Difference,
    /// Twist of its surface in this step, of the centre of mass.
    surface: Twist,
    /// Impulses of this step.
    pushed: Six,
    /// Acceleration by other forces, as gravity, m/s² and rad/s².
    load: Twist,
    /// Time from an impulse to the host's answer, s.
    delay: f64,
    /// Times, poses and twists after the last steps, the oldest at `next` once all places are taken.
    past: ArrayVec<(f64, Pose, Twist), MAX_PAST>,
    next: usize,
    host: HostState,
    response: Response,
    /// Lengths of the world for those at the device.
    scale: f64,
}

/// A pose and a twist less others.
#[derive(Clone, Copy, Debug, Default)]
struct Difference {
    shift: DVec3,
    turn: DVec3,
    twist: Twist,
}

/// The coordinates z of a body.
#[derive(Clone, Copy, Debug)]
struct Coordinates {
    root_mass: f64,
    /// L, and its inverse.
    lower: DMat3,
    inverse: DMat3,
}

/// The bodies that the contacts of one step push.
pub(crate) struct Pushed<'a> {
    bodies: &'a [PushedBody],
    /// Indices of those that the step moves.
    moved: ArrayVec<u8, MAX_PUSHED>,
}

impl<'a> Pushed<'a> {
    /// Those that contacts push first.
    pub fn new<'c>(bodies: &'a [PushedBody], contacts: impl IntoIterator<Item = &'c Constraint>) -> Self {
        let mut moved = ArrayVec::new();
        if !bodies.is_empty() {
            for index in contacts.into_iter().filter_map(|contact| contact.pushed) {
                if !moved.contains(&index) && usize::from(index) < bodies.len() && !moved.is_full() {
                    moved.push(index);
                }
            }
        }
        Self { bodies, moved }
    }

    /// Number of those that the step moves.
    pub fn len(&self) -> usize {
        self.moved.len()
    }

    /// The body that a contact pushes, and its place in the step, if the step moves it.
    #[inline(always)]
    pub fn of(&self, contact: &Constraint) -> Option<(usize, &PushedBody)> {
        let index = contact.pushed?;
        let slot = self.moved.iter().position(|moved| *moved == index)?;
        Some((slot, self.bodies.get(usize::from(index))?))
    }
}

impl PushedBody {
    /// A body as its host tells of it.
    pub fn new(body: &Body, host: &HostState) -> Self {
        let coordinates = Coordinates::new(body);
        let slow = coordinates.of(&host.pose, &host.twist);
        Self {
            coordinates,
            pose: host.pose,
            twist: host.twist,
            off: Difference::default(),
            taken: Difference::default(),
            surface: host.twist,
            pushed: [0.0; 6],
            load: Twist::ZERO,
            delay: TAKE_OVER.1,
            past: ArrayVec::new(),
            next: 0,
            host: *host,
            response: Response::free(slow),
            scale: 1.0,
        }
    }

    /// The body in a world in which lengths are `scale` times those at the device.
    #[must_use]
    pub fn at_scale(self, scale: f64) -> Self {
        Self { scale, ..self }
    }

    /// Pose of the centre of mass.
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Velocity of the centre of mass, and angular velocity, after the last step.
    pub fn twist(&self) -> &Twist {
        &self.twist
    }

    /// Velocity of the centre of mass, and angular velocity, as contacts of this step see them.
    pub fn surface_twist(&self) -> &Twist {
        &self.surface
    }

    /// Starts at a pose of the centre of mass, with a twist of it, in place of the host's.
    pub fn start(&mut self, pose: &Pose, twist: &Twist) {
        (self.pose, self.twist, self.surface) = (*pose, *twist, *twist);
    }

    /// Takes note of the delay from an impulse to the host's answer, s.
    pub fn set_delay(&mut self, delay: f64) {
        self.delay = delay;
    }

    /// Takes note of the acceleration by other forces than contacts, m/s² and rad/s².
    pub fn set_load(&mut self, load: &Twist) {
        self.load = *load;
    }

    /// Takes note of what the host says, if it is new.
    pub fn apply_host_state(&mut self, host: &HostState) {
        if *host == self.host {
            return;
        }
        self.host = *host;
        // The newest place in the past that is not later.
        let then = (0..self.past.len()).map(|back| (self.next + MAX_PAST - 1 - back) % MAX_PAST);
        let then = then.filter_map(|index| self.past.get(index));
        let mut known = (&self.pose, &self.twist);
        for (time, pose, twist) in then {
            known = (pose, twist);
            if *time <= host.time {
                break;
            }
        }
        let (pose, twist) = known;
        self.off = Difference {
            shift: host.pose.translation - pose.translation,
            turn: pose.rotation_vector_to(&host.pose),
            twist: Twist::new(host.twist.linear - twist.linear, host.twist.angular - twist.angular),
        };
        let Difference { shift, turn, .. } = self.off;
        if shift.length() > ELSEWHERE.0 * self.scale || turn.length() > ELSEWHERE.1 {
            self.place(host);
        }
    }

    /// Starts to respond as a body does that moves with an acceleration (m/s² and rad/s²) under the load: one
    /// that lies on a table does not fall until its host answers.
    pub fn start_response(&mut self, acceleration: &Twist) {
        let [load, seen, told] =
            [&self.load, acceleration, &self.host.twist].map(|twist| self.coordinates.of(&self.pose, twist));
        self.response = Response::steady(&load, &seen, &told, self.delay);
        self.update_response();
    }

    /// Learns from what the host has said how the body responds.
    pub fn update_response(&mut self) {
        self.response.update(self.coordinates.root_mass * self.scale, self.delay);
    }

    /// Puts the body where its host says that it is. It then responds as a free one does.
    pub fn place(&mut self, host: &HostState) {
        self.response = Response::free(self.coordinates.of(&host.pose, &host.twist));
        (self.host, self.pose, self.twist, self.surface) = (*host, host.pose, host.twist, host.twist);
        self.off = Difference::default();
        self.past.clear();
        self.next = 0;
    }

    /// Begins a step of `dt` (s).
    pub fn begin(&mut self, dt: f64) {
        self.pushed = [0.0; 6];
        let share = (dt / (TAKE_OVER.0 * self.delay).max(TAKE_OVER.1)).min(1.0);
        self.taken = self.off.scaled(share);
        self.off = self.off.scaled(1.0 - share);
        let load = self.coordinates.of(&self.pose, &self.load);
        let fallen = self.coordinates.twist(&self.pose, &self.response.shared(&load));
        let Difference { shift, turn, twist } = self.taken;
        self.twist.linear += twist.linear + fallen.linear * dt;
        self.twist.angular += twist.angular + fallen.angular * dt;
        self.surface = Twist::new(self.twist.linear + shift / dt, self.twist.angular + turn / dt);
    }

    /// The change of its twist by an impulse (N·s) with a moment about its centre of mass (N·m·s).
    pub fn change(&self, (linear, angular): (DVec3, DVec3)) -> Twist {
        let z = self.coordinates.impulse(&self.pose, linear, angular);
        self.coordinates.twist(&self.pose, &self.response.shared(&z))
    }

    /// Adds an impulse (N·s) at a point (m).
    pub fn push(&mut self, impulse: DVec3, point: DVec3) {
        let impulse = self.coordinates.row(&self.pose, point, impulse);
        add(&mut self.pushed, 1.0, &impulse);
    }

    /// Ends a step of `dt` (s) at a time (s): the body moves.
    pub fn end(&mut self, dt: f64, time: f64) {
        let change = self.coordinates.twist(&self.pose, &self.response.shared(&self.pushed));
        self.twist.linear += change.linear;
        self.twist.angular += change.angular;
        let moved =
            Twist::new(self.twist.linear * dt + self.taken.shift, self.twist.angular * dt + self.taken.turn);
        let load = self.coordinates.of(&self.pose, &self.load);
        let told = self.coordinates.of(&self.pose, &self.host.twist);
        self.response.observe(&self.pushed, &load, &told, dt, self.delay);
        self.pose = self.pose.moved(&moved, 1.0);
        if self.past.is_full() {
            self.past[self.next] = (time, self.pose, self.twist);
        } else {
            self.past.push((time, self.pose, self.twist));
        }
        self.next = (self.next + 1) % MAX_PAST;
        if !(self.pose.is_valid() && self.twist.is_finite()) {
            let host = self.host;
            self.place(&host);
        }
    }

    /// The scaled row Cᵀ z of a unit velocity along an axis at a point (m).
    pub(super) fn row(&self, point: DVec3, axis: DVec3) -> Six {
        let row = self.coordinates.row(&self.pose, point, axis);
        let mut scaled = [0.0; 6];
        for (entries, value) in self.response.root.iter().zip(row) {
            add(&mut scaled, value, entries);
        }
        scaled
    }
}

impl Difference {
    fn scaled(&self, share: f64) -> Self {
        let Self { shift, turn, twist } = *self;
        let twist = Twist::new(twist.linear * share, twist.angular * share);
        Self { shift: shift * share, turn: turn * share, twist }
    }
}

impl Coordinates {
    fn new(body: &Body) -> Self {
        // L of the inertia: columns of glam's matrices come first.
        let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] = body.inertia.to_cols_array_2d();
        let a = xx.sqrt();
        let (b, c) = (xy / a, xz / a);
        let d = (yy - b * b).max(0.0).sqrt();
        let e = (yz - b * c) / d;
        let f = (zz - c * c - e * e).max(0.0).sqrt();
        let lower = DMat3::from_cols(DVec3::new(a, b, c), DVec3::new(0.0, d, e), DVec3::new(0.0, 0.0, f));
        Self { root_mass: body.mass.sqrt(), lower, inverse: lower.inverse() }
    }

    /// z of a twist.
    fn of(&self, pose: &Pose, twist: &Twist) -> Six {
        let linear = twist.linear * self.root_mass;
        let angular = self.lower.transpose() * (pose.rotation.conjugate() * twist.angular);
        [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    }

    /// The twist of z.
    fn twist(&self, pose: &Pose, z: &Six) -> Twist {
        let [x, y, z, u, v, w] = *z;
        let angular = pose.rotation * (self.inverse.transpose() * DVec3::new(u, v, w));
        Twist::new(DVec3::new(x, y, z) / self.root_mass, angular)
    }

    /// Zᵀ Jᵀ: z of an impulse at a point.
    fn row(&self, pose: &Pose, point: DVec3, impulse: DVec3) -> Six {
        self.impulse(pose, impulse, (point - pose.translation).cross(impulse))
    }

    /// z of an impulse and its moment about the centre of mass.
    fn impulse(&self, pose: &Pose, linear: DVec3, angular: DVec3) -> Six {
        let linear = linear / self.root_mass;
        let angular = self.inverse * (pose.rotation.conjugate() * angular);
        [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    }
}
