//! Faults of a session, and their times.

use palpate::device::{DeviceState, Status};
use palpate::dynamics::PenaltyContact;
use palpate::glam::{DQuat, DVec3};
use palpate::{ContactUpdate, Twist};
use rand::RngExt as _;
use rand::rngs::StdRng;

use super::genome::Genes;

/// Largest number of faults in a session.
pub const FAULTS: usize = 10;

/// Kinds of faults: of the device, the host's clock, contacts and the hand, and actions of the user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The device does not answer, refuses a wrench, or its driver sends zero instead.
    Unread,
    Unwritten,
    Withheld,
    /// The device does not answer, and then reports another place.
    Elsewhere,
    /// A reading repeats the one before, with its time or with a new one.
    Repeated,
    Restamped,
    /// A pose is displaced and turned: by the same amount while the fault lasts, or by another each time.
    Jumped,
    Scattered,
    NotFinite,
    Huge,
    Flipped,
    NotUnit,
    /// A velocity is zero, reversed or arbitrary.
    Velocity,
    /// A reading's time runs backwards, stays, or is not a number.
    Stamped,
    Status,
    /// Steps come late, or the host reports a time that is wrong or not a number.
    Late,
    ClockBack,
    StepZero,
    StepHuge,
    StepNegative,
    StepNotFinite,
    /// Contacts are missing, late, invalid, far away, or of another time.
    NoContacts,
    LateContacts,
    WrongContacts,
    FarContacts,
    OldContacts,
    /// The hand lets go, or grips with another hand's impedance.
    LetGo,
    Gripped,
    Clutched,
    Pressed,
}

impl Kind {
    pub const ALL: [Self; 30] = [
        Self::Unread,
        Self::Unwritten,
        Self::Withheld,
        Self::Elsewhere,
        Self::Repeated,
        Self::Restamped,
        Self::Jumped,
        Self::Scattered,
        Self::NotFinite,
        Self::Huge,
        Self::Flipped,
        Self::NotUnit,
        Self::Velocity,
        Self::Stamped,
        Self::Status,
        Self::Late,
        Self::ClockBack,
        Self::StepZero,
        Self::StepHuge,
        Self::StepNegative,
        Self::StepNotFinite,
        Self::NoContacts,
        Self::LateContacts,
        Self::WrongContacts,
        Self::FarContacts,
        Self::OldContacts,
        Self::LetGo,
        Self::Gripped,
        Self::Clutched,
        Self::Pressed,
    ];
}

/// A fault that lasts for a time, once or repeatedly.
#[derive(Clone, Copy, Debug)]
pub struct Fault {
    pub kind: Kind,
    /// Start, duration and period of repetition, s.
    begin: f64,
    lasts: f64,
    period: Option<f64>,
    /// Share of the steps in which it acts meanwhile.
    share: f64,
    /// Severity, from 0 to 1.
    pub size: f64,
    direction: DVec3,
    turn: DQuat,
}

impl Fault {
    pub fn of(g: &mut Genes<'_>, seconds: f64) -> Self {
        Self {
            kind: g.pick(&Kind::ALL),
            begin: g.range(0.0, seconds),
            lasts: g.log(1e-3, 0.15 * seconds),
            period: g.maybe(0.3, |g| g.log(2e-3, 1.0)),
            share: g.maybe(0.3, |g| g.log(0.01, 1.0)).unwrap_or(1.0),
            size: g.unit(),
            direction: g.direction(),
            turn: g.turn(3.0),
        }
    }

    /// Returns whether the fault acts in a step at a time (s).
    pub fn is_there(&self, time: f64, rng: &mut StdRng) -> bool {
        let since = time - self.begin;
        // A repeated fault acts for half of each period.
        let on = self.period.is_none_or(|period| since.rem_euclid(period) < 0.5 * period);
        (0.0..self.lasts).contains(&since) && on && (self.share >= 1.0 || rng.random_bool(self.share))
    }

    /// Returns a value between bounds by the severity, spaced logarithmically.
    pub fn between(&self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.size)
    }

    /// Returns the error of a pose: translation, m, and rotation.
    pub fn offset(&self) -> (DVec3, DQuat) {
        (self.direction * self.between(1e-3, 0.5), DQuat::IDENTITY.slerp(self.turn, self.size))
    }

    /// Applies the fault to a reading.
    pub fn spoil(&self, state: &mut DeviceState, last: Option<&DeviceState>, rng: &mut StdRng) {
        let choice = (self.size * 8.0) as u32;
        let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY][choice as usize % 3];
        match self.kind {
            Kind::Repeated => *state = *last.unwrap_or(state),
            Kind::Restamped => *state = DeviceState { time: state.time, ..*last.unwrap_or(state) },
            Kind::Jumped => {
                let (translation, turn) = self.offset();
                state.pose.translation += translation;
                state.pose.rotation = (turn * state.pose.rotation).normalize();
            }
            Kind::Scattered => {
                let most = self.between(1e-3, 0.5);
                state.pose.translation +=
                    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-most..most)));
            }
            Kind::NotFinite => match choice {
                0..3 => state.pose.translation.x = odd,
                3..6 => state.pose.rotation.w = odd,
                _ => state.twist.linear.y = odd,
            },
            Kind::Huge => match choice {
                0..3 => state.pose.translation.x = 1e300,
                3..6 => state.twist.linear = DVec3::splat(1e300),
                _ => state.twist.angular.z = 1e160,
            },
            Kind::Flipped => state.pose.rotation = -state.pose.rotation,
            Kind::NotUnit => state.pose.rotation *= self.between(1e-3, 1e3),
            Kind::Velocity => {
                state.twist = match choice {
                    0..3 => Twist::ZERO,
                    3..5 => Twist::new(-state.twist.linear, -state.twist.angular),
                    _ => Twist::new(
                        self.direction * self.between(0.1, 100.0),
                        self.direction * self.between(1.0, 1e3),
                    ),
                }
            }
            Kind::Stamped => {
                state.time = match choice {
                    0..3 => state.time - self.between(1e-4, 1.0),
                    3..5 => last.map_or(state.time, |last| last.time),
                    5 => f64::NAN,
                    6 => f64::INFINITY,
                    _ => state.time + rng.random_range(-0.01..0.01),
                }
            }
            Kind::Status => {
                let all = [Status::HELD, Status::NOT_ENABLED, Status::GAP, Status::SILENT, Status::ENDED];
                state.status |= all[choice as usize % all.len()];
            }
            _ => {}
        }
    }

    /// Applies the fault to a contact model.
    pub fn spoil_contacts(&self, update: &mut ContactUpdate, body: DVec3) {
        let choice = (self.size * 8.0) as u32;
        match self.kind {
            Kind::WrongContacts => {
                let odd = [f64::NAN, f64::INFINITY, 1e300, -1.0][choice as usize % 4];
                let mut plane = PenaltyContact {
                    scene_point: body,
                    normal: -self.direction,
                    stiffness: 1e3,
                    damping: 1.0,
                    ..PenaltyContact::default()
                };
                match choice / 2 {
                    0 => plane.stiffness = odd,
                    1 => plane.damping = odd,
                    2 => plane.scene_point.z = odd,
                    _ => plane.normal = self.direction * odd,
                }
                update.model.push_contact(plane);
                update.contacts += 1;
            }
            Kind::FarContacts => {
                let depth = self.between(0.1, 1e3);
                update.model.push_contact(PenaltyContact {
                    scene_point: body + self.direction * depth,
                    normal: -self.direction,
                    stiffness: self.between(10.0, 1e5),
                    damping: 1.0,
                    ..PenaltyContact::default()
                });
                update.contacts += 1;
                update.depth = depth;
            }
            Kind::OldContacts => {
                update.time += match choice {
                    0..3 => -self.between(1e-3, 10.0),
                    3..6 => self.between(1e-3, 10.0),
                    6 => f64::NAN,
                    _ => f64::NEG_INFINITY,
                }
            }
            _ => {}
        }
    }
}
