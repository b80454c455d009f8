//! Where a hand means to go.

use std::f64::consts::TAU;

use palpate::device::IntendedPath;
use palpate::glam::{DQuat, DVec3};
use palpate::{Pose, Twist};
use palpate_tests::smooth;

use super::genome::Genes;

const SINES: usize = 3;
const MOVES: usize = 4;
/// Of the difference that stands for a derivative, s.
const STEP: f64 = 1e-5;

/// Sums of sines, a tremor, and moves from one place to another.
#[derive(Clone, Debug)]
pub struct Motion {
    sines: [Sine; SINES],
    tremor: Option<Sine>,
    moves: [Option<Move>; MOVES],
}

#[derive(Clone, Copy, Debug)]
struct Sine {
    /// m and rad.
    way: DVec3,
    turn: DVec3,
    /// rad/s and rad.
    rate: f64,
    phase: f64,
    /// Sine of the phase.
    start: f64,
}

/// By a way (m) and a turn (rad), from one time to another, s.
#[derive(Clone, Copy, Debug)]
struct Move {
    way: DVec3,
    turn: DVec3,
    from: f64,
    to: f64,
}

impl Motion {
    pub fn of(g: &mut Genes<'_>, seconds: f64) -> Self {
        let sines = std::array::from_fn(|_| {
            let phase = g.range(0.0, TAU);
            Sine {
                way: g.direction() * g.log(1e-4, 0.08),
                turn: g.direction() * g.log(1e-3, 0.8),
                rate: TAU * g.log(0.1, 6.0),
                phase,
                start: phase.sin(),
            }
        });
        let tremor = g.maybe(0.3, |g| Sine {
            way: g.direction() * g.log(1e-5, 2e-3),
            turn: g.direction() * g.log(1e-4, 0.05),
            rate: TAU * g.range(6.0, 30.0),
            phase: 0.0,
            start: 0.0,
        });
        let moves = std::array::from_fn(|_| {
            g.maybe(0.5, |g| {
                let from = g.range(0.0, seconds);
                let way = g.direction() * g.log(1e-3, 0.1);
                Move { way, turn: g.direction() * g.log(1e-2, 1.0), from, to: from + g.log(0.02, 1.0) }
            })
        });
        Self { sines, tremor, moves }
    }

    /// Offset (m) and turn (rad) at a time (s): none at 0.
    fn at(&self, time: f64) -> (DVec3, DVec3) {
        let (mut way, mut turn) = (DVec3::ZERO, DVec3::ZERO);
        for sine in self.sines.iter().chain(&self.tremor) {
            let part = (sine.rate * time + sine.phase).sin() - sine.start;
            way += sine.way * part;
            turn += sine.turn * part;
        }
        for one in self.moves.iter().flatten() {
            let part = smooth(one.from, one.to, time);
            way += one.way * part;
            turn += one.turn * part;
        }
        (way, turn)
    }

    pub fn path(self) -> IntendedPath {
        IntendedPath::function(move |time| {
            let ((way, turn), (later, turned)) = (self.at(time), self.at(time + STEP));
            // The spin is the turn's rate, which is near enough for turns this small.
            let twist = Twist::new((later - way) / STEP, (turned - turn) / STEP);
            (Pose::new(way, DQuat::from_scaled_axis(turn)), twist)
        })
    }
}
