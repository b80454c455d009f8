//! Random sessions, and then repeated mutations of the worst of them.

use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use serde_json::{Value, json};

use super::as_asked;
use super::genome::{Genome, mixed};
use super::session::{BROKEN, Ended, Measure, Outcome, run};
use crate::progress;

/// Number of worst sessions of each measure that are kept as parents.
const PARENTS: usize = 8;
/// Sessions per round; parents are selected anew after each round.
const ROUND_SESSIONS: usize = 200;

/// Parameters of a search.
#[derive(Clone, Copy, Debug)]
pub struct Search {
    pub sessions: usize,
    pub seed: u64,
    pub seconds: f64,
}

/// Results of a search.
#[derive(Clone, Debug, Default)]
pub struct Found {
    pub sessions: usize,
    pub refused: usize,
    pub touched: usize,
    pub steps: u64,
    /// Sessions with the largest values of each measure, the worst first; and the number of sessions above
    /// 1.
    pub worst: [Vec<(f64, Genome)>; Measure::ALL.len()],
    pub above: [usize; Measure::ALL.len()],
    pub harm: Vec<(Genome, Outcome)>,
    /// Count of a genome's numbers that sessions read.
    read: u16,
}

impl Search {
    /// Runs a search, half of it at random and half near the worst. It is deterministic.
    pub fn run(&self) -> Found {
        let mut found = Found::default();
        let mut rng = StdRng::seed_from_u64(self.seed);
        let mut next = self.seed;
        while found.sessions - found.refused < self.sessions {
            let left = (self.sessions + found.refused - found.sessions).min(ROUND_SESSIONS);
            let done = found.sessions - found.refused;
            let round: Vec<Genome> = (0..left)
                .map(|_| {
                    next = mixed(next);
                    let random = 2 * done < self.sessions || rng.random_bool(0.1);
                    let parent = if random { None } else { found.parent(&mut rng) };
                    parent.map_or(Genome::new(next), |parent| parent.mutated(found.read, &mut rng))
                })
                .collect();
            self.add(&round, &format!("{done}/{}", self.sessions), &mut found);
        }
        found
    }

    /// Runs these sessions alone.
    pub fn of(&self, genomes: &[Genome]) -> Found {
        let mut found = Found::default();
        self.add(genomes, "sessions", &mut found);
        found
    }

    fn add(&self, genomes: &[Genome], name: &str, found: &mut Found) {
        let ran = progress::each(name, genomes, |genome| Ok(run(genome, self.seconds, as_asked)));
        for (genome, outcome) in genomes.iter().zip(ran.unwrap_or_default()) {
            found.add(genome, outcome);
        }
    }
}

impl Found {
    fn add(&mut self, genome: &Genome, outcome: Outcome) {
        self.sessions += 1;
        match &outcome {
            Outcome::Refused(_) => self.refused += 1,
            Outcome::Panicked(_) => {}
            Outcome::Ended(Ended { parts, steps, touched, read, .. }) => {
                self.steps += steps;
                self.touched += usize::from(*touched);
                self.read = self.read.max(*read);
                for (index, part) in parts.iter().enumerate() {
                    self.above[index] += usize::from(*part > BROKEN);
                    let worst = &mut self.worst[index];
                    let place = worst.partition_point(|(other, _)| other >= part);
                    if place < PARENTS && *part > 0.0 {
                        worst.insert(place, (*part, genome.clone()));
                        worst.truncate(PARENTS);
                    }
                }
            }
        }
        if outcome.is_harm() {
            self.harm.push((genome.clone(), outcome));
        }
    }

    /// Picks one of the worst by one of the measures that are sought.
    fn parent(&self, rng: &mut StdRng) -> Option<&Genome> {
        let sought = Measure::ALL.iter().zip(&self.worst).filter(|(measure, _)| measure.is_sought());
        let kept: Vec<&Vec<_>> = sought.map(|(_, worst)| worst).filter(|worst| !worst.is_empty()).collect();
        let worst = kept.get(rng.random_range(0..kept.len().max(1)))?;
        worst.get(rng.random_range(0..worst.len())).map(|(_, genome)| genome)
    }

    /// Returns the results as JSON.
    pub fn json(&self) -> Value {
        let measures = Measure::ALL.iter().zip(&self.worst).zip(&self.above).map(|((measure, worst), above)| {
            let worst: Vec<Value> = worst
                .iter()
                .map(|(part, genome)| json!({ "part": part, "session": genome.to_string() }))
                .collect();
            json!({ "name": measure.name(), "promised": measure.is_promised(), "above": above, "worst": worst })
        });
        let harm = self
            .harm
            .iter()
            .map(|(genome, outcome)| json!({ "session": genome.to_string(), "outcome": outcome }));
        json!({
            "sessions": self.sessions,
            "refused": self.refused,
            "touched": self.touched,
            "steps": self.steps,
            "measures": measures.collect::<Vec<_>>(),
            "harm": harm.collect::<Vec<_>>(),
        })
    }
}
