//! A session as a list of numbers between 0 and 1, which can be drawn at random, mutated, and reproduced from
//! a line of text.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use palpate::glam::{DQuat, DVec3};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

/// Seed of all numbers, and the numbers that were changed since, by their index.
///
/// As text: the seed in hexadecimal digits, then a colon, and for each change three digits for the index and
/// four for the number.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Genome {
    seed: u64,
    changed: BTreeMap<u16, u16>,
}

/// Hexadecimal digits of an index, and of an index with its number.
const PLACE: usize = 3;
const CHANGE: usize = PLACE + 4;
/// Largest count of numbers.
pub const PLACES: u16 = 1 << (4 * PLACE);

impl Genome {
    pub fn new(seed: u64) -> Self {
        Self { seed, changed: BTreeMap::new() }
    }

    /// Returns the random numbers of events within the session.
    pub fn rng(&self) -> StdRng {
        StdRng::seed_from_u64(self.seed)
    }

    /// Returns a reader of the numbers, at the first.
    pub fn genes(&self) -> Genes<'_> {
        Genes { genome: self, next: 0 }
    }

    fn number(&self, place: u16) -> u16 {
        let drawn = || (mixed(self.seed ^ mixed(u64::from(place) + 1)) >> 48) as u16;
        self.changed.get(&place).copied().unwrap_or_else(drawn)
    }

    /// Returns a copy in which some of the numbers that were read are drawn anew or changed a little.
    #[must_use]
    pub fn mutated(&self, read: u16, rng: &mut StdRng) -> Self {
        let mut other = self.clone();
        let most = *[1, 2, 4, 8, 16].get(rng.random_range(0..5)).unwrap_or(&1);
        for _ in 0..most {
            let place = rng.random_range(0..read.clamp(1, PLACES));
            let number = if rng.random_bool(0.5) {
                rng.random()
            } else {
                let step = rng.random_range(-3000..=3000);
                (i32::from(self.number(place)) + step).clamp(0, i32::from(u16::MAX)) as u16
            };
            other.changed.insert(place, number);
        }
        other
    }
}

/// Returns a well mixed number (splitmix64).
pub fn mixed(number: u64) -> u64 {
    let mut z = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl fmt::Display for Genome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:x}", self.seed)?;
        if !self.changed.is_empty() {
            f.write_str(":")?;
        }
        self.changed.iter().try_for_each(|(place, number)| write!(f, "{place:03x}{number:04x}"))
    }
}

impl FromStr for Genome {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("'{text}' is not a session; give a seed, or a session that a search has printed");
        let (seed, changes) = text.split_once(':').unwrap_or((text, ""));
        let seed = u64::from_str_radix(seed, 16).map_err(|_| wrong())?;
        if !changes.is_ascii() || !changes.len().is_multiple_of(CHANGE) {
            return Err(wrong());
        }
        let number = |digits: &str| u16::from_str_radix(digits, 16).map_err(|_| wrong());
        let changes = (0..changes.len()).step_by(CHANGE).map(|at| {
            let (place, value) = changes[at..at + CHANGE].split_at(PLACE);
            Ok((number(place)?, number(value)?))
        });
        Ok(Self { seed, changed: changes.collect::<Result<_, String>>()? })
    }
}

/// Reader of a genome's numbers, in order. Each value reads the same count of numbers whatever they are, so
/// that a change of one leaves the other values as they were.
#[derive(Clone, Debug)]
pub struct Genes<'a> {
    genome: &'a Genome,
    next: u16,
}

impl Genes<'_> {
    /// Returns the count of numbers that were read.
    pub fn read(&self) -> u16 {
        self.next
    }

    /// Returns a number above 0 and below 1.
    pub fn unit(&mut self) -> f64 {
        let number = self.genome.number(self.next);
        self.next = (self.next + 1) % PLACES;
        (f64::from(number) + 0.5) / 65_536.0
    }

    pub fn chance(&mut self, share: f64) -> bool {
        self.unit() < share
    }

    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + self.unit() * (high - low)
    }

    /// Returns a number between bounds, with its logarithm evenly distributed.
    pub fn log(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.unit())
    }

    /// Returns [`Self::log`] of the usual range, or of a wider range with the probability `share`.
    pub fn log_or(&mut self, usual: (f64, f64), share: f64, wide: (f64, f64)) -> f64 {
        let (usual, wide) = (self.log(usual.0, usual.1), self.log(wide.0, wide.1));
        if self.chance(share) { wide } else { usual }
    }

    pub fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[(self.unit() * from.len() as f64) as usize]
    }

    pub fn maybe<T>(&mut self, share: f64, make: impl FnOnce(&mut Self) -> T) -> Option<T> {
        let is_some = self.chance(share);
        let made = make(self);
        is_some.then_some(made)
    }

    /// Returns a vector with components up to a size.
    pub fn vector(&mut self, size: f64) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|_| self.range(-size, size)))
    }

    pub fn direction(&mut self) -> DVec3 {
        self.vector(1.0).try_normalize().unwrap_or(DVec3::Z)
    }

    /// Returns a rotation by at most an angle, rad.
    pub fn turn(&mut self, most: f64) -> DQuat {
        let axis = self.direction();
        DQuat::from_axis_angle(axis, self.range(0.0, most))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_genome_is_restored_from_its_text() {
        let mut rng = StdRng::seed_from_u64(5);
        let mut genome = Genome::new(0x1234);
        assert_eq!(genome.to_string(), "1234");
        for _ in 0..20 {
            genome = genome.mutated(300, &mut rng);
            assert_eq!(genome.to_string().parse(), Ok(genome.clone()));
        }
        for wrong in ["", "x", "12:1", "12:0001234g"] {
            assert!(wrong.parse::<Genome>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_change_keeps_the_other_numbers() {
        let genome = Genome::new(7);
        let other = Genome { changed: BTreeMap::from([(3, 9)]), ..genome.clone() };
        let numbers = |genome: &Genome| (0..20).map(|place| genome.number(place)).collect::<Vec<_>>();
        let (one, two) = (numbers(&genome), numbers(&other));
        assert!(one.iter().zip(&two).enumerate().all(|(place, (a, b))| (a == b) == (place != 3)));
        assert_eq!(two[3], 9);
    }
}
