//! Intended motion of the hand.

use std::f64::consts::TAU;

use palpate::device::IntendedPath;
use palpate::glam::{DQuat, DVec3};
use palpate::{Pose, Twist};
use palpate_tests::smooth;

use super::genome::Genes;

const SINES: usize = 3;
const MOVES: usize = 4;
/// Step of the finite differences that give velocities, s.
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
    /// Amplitudes, m and rad.
    offset: DVec3,
    turn: DVec3,
    /// Angular frequency, rad/s, and phase, rad.
    rate: f64,
    phase: f64,
    /// Sine of the phase, subtracted so that the motion starts at 0.
    start: f64,
}

/// Move by a displacement (m) and a turn (rad), from one time to another, s.
#[derive(Clone, Copy, Debug)]
struct Move {
    offset: DVec3,
    turn: DVec3,
    from: f64,
    to: f64,
}

impl Motion {
    pub fn of(g: &mut Genes<'_>, seconds: f64) -> Self {
        let sines = std::array::from_fn(|_| {
            let phase = g.range(0.0, TAU);
            Sine {
                offset: g.direction() * g.log(1e-4, 0.08),
                turn: g.direction() * g.log(1e-3, 0.8),
                rate: TAU * g.log(0.1, 6.0),
                phase,
                start: phase.sin(),
            }
        });
        let tremor = g.maybe(0.3, |g| Sine {
            offset: g.direction() * g.log(1e-5, 2e-3),
            turn: g.direction() * g.log(1e-4, 0.05),
            rate: TAU * g.range(6.0, 30.0),
            phase: 0.0,
            start: 0.0,
        });
        let moves = std::array::from_fn(|_| {
            g.maybe(0.5, |g| {
                let from = g.range(0.0, seconds);
                let offset = g.direction() * g.log(1e-3, 0.1);
                Move { offset, turn: g.direction() * g.log(1e-2, 1.0), from, to: from + g.log(0.02, 1.0) }
            })
        });
        Self { sines, tremor, moves }
    }

    /// Returns the displacement (m) and turn (rad) at a time (s); the sines are 0 at time 0.
    fn at(&self, time: f64) -> (DVec3, DVec3) {
        let (mut offset, mut turn) = (DVec3::ZERO, DVec3::ZERO);
        for sine in self.sines.iter().chain(&self.tremor) {
            let part = (sine.rate * time + sine.phase).sin() - sine.start;
            offset += sine.offset * part;
            turn += sine.turn * part;
        }
        for one in self.moves.iter().flatten() {
            let part = smooth(one.from, one.to, time);
            offset += one.offset * part;
            turn += one.turn * part;
        }
        (offset, turn)
    }

    pub fn path(self) -> IntendedPath {
        IntendedPath::function(move |time| {
            let ((offset, turn), (next_offset, next_turn)) = (self.at(time), self.at(time + STEP));
            // The derivative of the rotation vector approximates the angular velocity well for turns this
            // small.
            let twist = Twist::new((next_offset - offset) / STEP, (next_turn - turn) / STEP);
            (Pose::new(offset, DQuat::from_scaled_axis(turn)), twist)
        })
    }
}
