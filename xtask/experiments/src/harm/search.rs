//! Random sessions, and then repeated mutations of the worst of them.

use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use serde_json::{Value, json};

use super::genome::{Genome, mixed};
use super::session::{BROKEN, Ended, Outcome};
use crate::progress;

/// Number of worst sessions of each measure that are kept as parents.
const PARENTS: usize = 8;
/// Sessions per round; parents are selected anew after each round.
const ROUND_SESSIONS: usize = 200;

/// Sessions of which a search looks for the worst.
pub trait Trial: Sync {
    /// The measures, in the order of [`Ended::parts`].
    fn columns(&self) -> Vec<Column>;

    /// Runs the session of a genome.
    fn run(&self, genome: &Genome) -> Outcome;
}

/// A measure of sessions: the largest value of a quantity relative to its bound.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    pub name: String,
    /// Whether a value above 1 is harm.
    pub is_promised: bool,
    /// Whether the search looks for values near 1 and above.
    pub is_sought: bool,
}

/// Parameters of a search.
#[derive(Clone, Copy, Debug)]
pub struct Search {
    pub sessions: usize,
    pub seed: u64,
    /// Share of the sessions that are drawn at random; the others are mutations of the worst.
    pub random: f64,
}

/// One of the worst sessions by a measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Worst {
    pub part: f64,
    pub genome: Genome,
    /// What the session was and what came of it ([`Ended::note`]).
    pub note: String,
}

/// Results of a search.
#[derive(Clone, Debug, Default)]
pub struct Found {
    pub columns: Vec<Column>,
    pub sessions: usize,
    pub refused: usize,
    pub touched: usize,
    pub steps: u64,
    /// Sessions with the largest values of each measure, the worst first; and the number of sessions above
    /// 1.
    pub worst: Vec<Vec<Worst>>,
    pub above: Vec<usize>,
    pub harm: Vec<(Genome, Outcome)>,
    /// Count of a genome's numbers that sessions read.
    read: u16,
}

impl Search {
    /// Runs a search: at first at random and then near the worst. It is deterministic.
    pub fn run(&self, trial: &dyn Trial) -> Found {
        let mut found = Found::new(trial);
        let mut rng = StdRng::seed_from_u64(self.seed);
        let mut next = self.seed;
        while found.sessions - found.refused < self.sessions {
            let left = (self.sessions + found.refused - found.sessions).min(ROUND_SESSIONS);
            let done = found.sessions - found.refused;
            let round: Vec<Genome> = (0..left)
                .map(|_| {
                    next = mixed(next);
                    let random = (done as f64) < self.random * self.sessions as f64 || rng.random_bool(0.1);
                    let parent = if random { None } else { found.parent(&mut rng) };
                    parent.map_or(Genome::new(next), |parent| parent.mutated(found.read, &mut rng))
                })
                .collect();
            found.add_all(trial, &round, &format!("{done}/{}", self.sessions));
        }
        found
    }
}

impl Found {
    fn new(trial: &dyn Trial) -> Self {
        let columns = trial.columns();
        let (worst, above) = (vec![Vec::new(); columns.len()], vec![0; columns.len()]);
        Self { columns, worst, above, ..Self::default() }
    }

    /// Runs these sessions alone.
    pub fn of(trial: &dyn Trial, genomes: &[Genome]) -> Self {
        let mut found = Self::new(trial);
        found.add_all(trial, genomes, "sessions");
        found
    }

    fn add_all(&mut self, trial: &dyn Trial, genomes: &[Genome], name: &str) {
        let ran = progress::each(name, genomes, |genome| Ok(trial.run(genome)));
        for (genome, outcome) in genomes.iter().zip(ran.unwrap_or_default()) {
            self.add(genome, outcome);
        }
    }

    fn add(&mut self, genome: &Genome, outcome: Outcome) {
        self.sessions += 1;
        match &outcome {
            Outcome::Refused(_) => self.refused += 1,
            Outcome::Panicked(_) => {}
            Outcome::Ended(Ended { parts, steps, touched, read, note, .. }) => {
                self.steps += steps;
                self.touched += usize::from(*touched);
                self.read = self.read.max(*read);
                for (index, part) in parts.iter().enumerate() {
                    self.above[index] += usize::from(*part > BROKEN);
                    let worst = &mut self.worst[index];
                    let place = worst.partition_point(|other| other.part >= *part);
                    if place < PARENTS && *part > 0.0 {
                        worst
                            .insert(place, Worst { part: *part, genome: genome.clone(), note: note.clone() });
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
        let sought = self.columns.iter().zip(&self.worst).filter(|(column, _)| column.is_sought);
        let kept: Vec<&Vec<_>> = sought.map(|(_, worst)| worst).filter(|worst| !worst.is_empty()).collect();
        let worst = kept.get(rng.random_range(0..kept.len().max(1)))?;
        worst.get(rng.random_range(0..worst.len())).map(|worst| &worst.genome)
    }

    /// Returns the results as JSON.
    pub fn json(&self) -> Value {
        let measures =
            self.columns.iter().zip(&self.worst).zip(&self.above).map(|((column, worst), above)| {
                let worst: Vec<Value> = worst
                    .iter()
                    .map(|it| json!({ "part": it.part, "session": it.genome.to_string(), "note": it.note }))
                    .collect();
                json!({ "name": column.name, "promised": column.is_promised, "above": above, "worst": worst })
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
