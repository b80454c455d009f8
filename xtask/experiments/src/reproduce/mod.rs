//! Experiments of the dissertation, repeated: its claims, our measurements, and whether each claim holds.
//!
//! `cargo xtask reproduce [NAME…|all] [--json] [--out FOLDER]` writes for each figure its values as CSV and a
//! plot as SVG, and all of them as one page, `index.html`. It prints a table of verdicts, or with `--json` a
//! list of them. Each verdict is computed from a stated condition.

mod dynamics;
mod jaw_detail;
mod levels;
mod outcome;
pub(crate) mod page;
mod pictures;
mod queries;
pub(crate) mod relief;
mod rendering;
mod rigid_body;
mod roughness;

use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use outcome::{Outcome, Reproduction};

/// Arguments of `cargo xtask reproduce`.
#[derive(clap::Args, Clone, Debug)]
pub struct Arguments {
    /// Figures and tables to reproduce, or all.
    #[arg(value_enum, default_value = "all")]
    names: Vec<Name>,
    /// Prints the outcomes as a JSON list.
    #[arg(long)]
    json: bool,
    /// Folder for values and plots.
    #[arg(long, value_name = "FOLDER", default_value = "target/reproduce")]
    out: PathBuf,
}

/// Experiments, in the order of the dissertation.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum Name {
    All,
    /// Hierarchies of the benchmark models.
    #[value(name = "table-3.2")]
    Table3_2,
    /// Hierarchies of real meshes.
    #[value(name = "table-3.2-real")]
    Table3_2Real,
    /// Levels of the lower jaw.
    #[value(name = "fig-3.7")]
    Figure3_7,
    /// Levels of the lower jaw's teeth and gums.
    #[value(name = "fig-3.8")]
    Figure3_8,
    /// Contact queries of moving jaws.
    #[value(name = "fig-3.15")]
    Figure3_15,
    /// Contact queries of scanned dental casts.
    #[value(name = "fig-3.15-real")]
    Figure3_15Real,
    /// Contact queries of a golf club and ball.
    #[value(name = "fig-3.16")]
    Figure3_16,
    /// Levels at contacts of a spoon that falls and slides, by its velocity.
    #[value(name = "fig-3.18")]
    Figure3_18,
    /// Contact queries of a spoon in a cup.
    #[value(name = "fig-3.19")]
    Figure3_19,
    /// Full and coarse resolution of the textured models.
    #[value(name = "table-4.1")]
    Table4_1,
    /// Roughness by probe diameter.
    #[value(name = "fig-4.8")]
    Figure4_8,
    /// Roughness by applied force.
    #[value(name = "fig-4.9")]
    Figure4_9,
    /// Roughness by exploratory speed.
    #[value(name = "fig-4.10")]
    Figure4_10,
    /// A ridged block dragged over a gear.
    #[value(name = "fig-4.14")]
    Figure4_14,
    /// A ridged block turned on another.
    #[value(name = "fig-4.15")]
    Figure4_15,
    /// Time that a file on a CAD part takes.
    #[value(name = "fig-4.16")]
    Figure4_16,
    /// Non-linear coupling stiffness.
    #[value(name = "fig-5.4")]
    Figure5_4,
    /// Free-space motion by integrator and mass.
    #[value(name = "fig-5.6")]
    Figure5_6,
    /// Spoon and cup by integrator, mass and contact stiffness.
    #[value(name = "fig-5.8")]
    Figure5_8,
    /// Jaws with and without the linearised contact model.
    #[value(name = "fig-5.10")]
    Figure5_10,
    /// Textured and flat plate.
    #[value(name = "fig-5.12")]
    Figure5_12,
}

impl Name {
    const EACH: [Self; 21] = [
        Self::Table3_2,
        Self::Table3_2Real,
        Self::Figure3_7,
        Self::Figure3_8,
        Self::Figure3_15,
        Self::Figure3_15Real,
        Self::Figure3_16,
        Self::Figure3_18,
        Self::Figure3_19,
        Self::Table4_1,
        Self::Figure4_8,
        Self::Figure4_9,
        Self::Figure4_10,
        Self::Figure4_14,
        Self::Figure4_15,
        Self::Figure4_16,
        Self::Figure5_4,
        Self::Figure5_6,
        Self::Figure5_8,
        Self::Figure5_10,
        Self::Figure5_12,
    ];

    /// Runs the experiment; `None` if it needs files of the optional test data that are absent.
    fn reproduce(self) -> Result<Option<Reproduction>, String> {
        let made = match self {
            Self::Table3_2Real => return levels::real_models(&self.word()),
            Self::Figure3_15Real => return queries::casts(&self.word()),
            Self::Table3_2 => levels::benchmark_models(&self.word()),
            Self::Figure3_7 => pictures::levels(&self.word()),
            Self::Figure3_8 => jaw_detail::lower_jaw(&self.word()),
            Self::Figure3_15 => queries::jaws(&self.word()),
            Self::Figure3_16 => queries::golf(&self.word()),
            Self::Figure3_18 => rigid_body::velocity::reproduce(&self.word()),
            Self::Figure3_19 => rigid_body::profile::reproduce(&self.word()),
            Self::Table4_1 => levels::textured_models(&self.word()),
            Self::Figure4_8 => roughness::reproduce(&roughness::probe_diameter(), &self.word()),
            Self::Figure4_9 => roughness::reproduce(&roughness::applied_force(), &self.word()),
            Self::Figure4_10 => roughness::reproduce(&roughness::exploratory_speed(), &self.word()),
            Self::Figure4_14 => relief::translation(&self.word()),
            Self::Figure4_15 => relief::rotation(&self.word()),
            Self::Figure4_16 => relief::timing(&self.word()),
            Self::Figure5_4 => dynamics::saturation::reproduce(&self.word()),
            Self::Figure5_6 => dynamics::free_space::reproduce(&self.word()),
            Self::Figure5_8 => dynamics::spoon_and_cup::reproduce(&self.word()),
            Self::Figure5_10 => dynamics::jaws::reproduce(&self.word()),
            Self::Figure5_12 => dynamics::textured_plate::reproduce(&self.word()),
            Self::All => Err("`all` is not an experiment".to_owned()),
        };
        made.map(Some)
    }

    fn word(self) -> String {
        use clap::ValueEnum;
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }

    fn run(self, out: &Path) -> Result<Option<Outcome>, String> {
        let start = Instant::now();
        let name = self.word();
        let made = self.reproduce().map_err(|error| format!("{name}: {error}"))?;
        let Some(reproduction) = made else {
            Outcome::forget(out, &name)?;
            return Ok(None);
        };
        reproduction.write(out, &name)?;
        let outcome = Outcome::new(name, reproduction.finding, start.elapsed().as_secs_f64());
        outcome.write(out)?;
        Ok(Some(outcome))
    }
}

/// Repeats the experiments and prints their outcomes.
///
/// # Errors
/// If an experiment cannot be simulated, or a file cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(&arguments.out)
        .map_err(|error| format!("cannot create the folder {}: {error}", arguments.out.display()))?;
    let all = arguments.names.contains(&Name::All);
    let names = Name::EACH.into_iter().filter(|name| all || arguments.names.contains(name));
    let names: Vec<Name> = names.collect();
    let bar = ProgressBar::with_draw_target(Some(names.len() as u64), ProgressDrawTarget::stderr_with_hz(4));
    if let Ok(style) = ProgressStyle::with_template("{msg:16} {bar:32} {pos}/{len} {elapsed}") {
        bar.set_style(style);
    }
    let (mut outcomes, mut skipped) = (Vec::new(), Vec::new());
    for name in names {
        bar.set_message(name.word());
        match name.run(&arguments.out)? {
            Some(outcome) => outcomes.push(outcome),
            None => skipped.push(name.word()),
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let page = page::write(&arguments.out)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&outcomes)?);
    } else {
        print!("{}", outcome::table(&outcomes));
        for name in skipped {
            println!("{name:10} skipped: its files are absent");
        }
        println!("Values, plots and a page of all: {}", page.display());
    }
    Ok(())
}

/// Returns the names of the experiments, in order.
fn names() -> impl Iterator<Item = String> {
    Name::EACH.into_iter().map(Name::word)
}
