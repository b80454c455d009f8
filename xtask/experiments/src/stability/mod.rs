//! Stability maps: where the engine is stable, by mass, stiffness, rates, delays and other parameters, found
//! by simulation.
//!
//! `cargo xtask stability [NAME…|all] [--quick] [--out FOLDER]` writes for each map its results as CSV,
//! pictures of them, and a page, `stability.md`, that describes them. Every number and every verdict on the
//! page is computed from the results; the same arguments give the same files, whatever the number of threads.

mod assembly;
mod body;
mod conditions;
mod contacts;
pub mod extremes;
mod geometry;
pub mod grid;
mod lever;
mod levered;
mod limits;
pub mod meshes;
mod metered;
pub mod page;
mod peg;
pub mod port;
mod pressing;
mod rate;
mod rig;
mod session;
#[cfg(test)]
mod tests;
mod thin_wall;
mod turn;
mod wall;
mod z_width;

use std::error::Error;
use std::path::PathBuf;

use grid::{Plan, ScanCase};
use page::Section;

/// Arguments of `cargo xtask stability`.
#[derive(clap::Args, Clone, Debug)]
pub struct Arguments {
    /// Maps to make, or all.
    #[arg(value_enum, default_value = "all")]
    names: Vec<Name>,
    /// Uses coarse grids and a short session: minutes.
    #[arg(long)]
    quick: bool,
    /// Folder for tables, pictures and the page.
    #[arg(long, value_name = "FOLDER", default_value = "target/stability")]
    out: PathBuf,
    /// Haptic steps of the map `session` [default: ten million, 200,000 with --quick].
    #[arg(long)]
    steps: Option<u64>,
    /// The only cases of the scans of `extremes`, as in their table, and nothing else of that map.
    #[arg(long, value_name = "HELD,TOUCHED,KG,HZ", num_args = 1.., conflicts_with = "quick")]
    scans: Vec<ScanCase>,
}

/// The maps, in the order of the page.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum Name {
    All,
    ZWidth,
    Limits,
    Body,
    Rate,
    Contacts,
    Lever,
    Turn,
    ThinWall,
    Peg,
    Extremes,
    Insertion,
    Nut,
    Locking,
    Port,
    Session,
}

impl Name {
    const MAPS: [Self; 15] = [
        Self::ZWidth,
        Self::Limits,
        Self::Body,
        Self::Rate,
        Self::Contacts,
        Self::Lever,
        Self::Turn,
        Self::ThinWall,
        Self::Peg,
        Self::Extremes,
        Self::Insertion,
        Self::Nut,
        Self::Locking,
        Self::Port,
        Self::Session,
    ];

    fn make(self, plan: &Plan) -> Result<Section, String> {
        match self {
            Self::ZWidth => z_width::map(plan),
            Self::Limits => limits::map(plan),
            Self::Body => body::map(plan),
            Self::Rate => rate::map(plan),
            Self::Contacts => contacts::map(plan),
            Self::Lever => lever::map(plan),
            Self::Turn => turn::map(plan),
            Self::ThinWall => thin_wall::map(plan),
            Self::Peg => peg::map(plan),
            Self::Extremes => extremes::map(plan),
            Self::Insertion => assembly::insertion::map(plan),
            Self::Nut => assembly::nut::map(plan),
            Self::Locking => assembly::locking::map(plan),
            Self::Port => port::map(plan),
            Self::Session => session::map(plan),
            Self::All => Err("all is not a map".to_owned()),
        }
    }

    fn word(self) -> String {
        use clap::ValueEnum;
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// Default number of haptic steps of the session, in full and quick.
const STEPS: u64 = 10_000_000;
const QUICK_STEPS: u64 = 200_000;

/// Makes the maps and prints the name of the page.
///
/// # Errors
/// If a case cannot be simulated, or a file cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(&arguments.out)
        .map_err(|error| format!("cannot create the folder {}: {error}", arguments.out.display()))?;
    let steps = arguments.steps.unwrap_or(if arguments.quick { QUICK_STEPS } else { STEPS });
    let plan = Plan { quick: arguments.quick, steps, scans: arguments.scans.clone() };
    let all = arguments.names.contains(&Name::All);
    let mut sections = Vec::new();
    for name in Name::MAPS.into_iter().filter(|name| all || arguments.names.contains(name)) {
        let section = name.make(&plan).map_err(|error| format!("{}: {error}", name.word()))?;
        section.write(&arguments.out)?;
        sections.push(section);
    }
    let page = page::render(&command(arguments), &sections);
    let path = arguments.out.join("stability.md");
    std::fs::write(&path, page).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
    println!("{}", path.display());
    Ok(())
}

/// Returns the command that reproduces the files.
fn command(arguments: &Arguments) -> String {
    let mut words = vec!["cargo xtask stability".to_owned()];
    words.extend(arguments.names.iter().map(|name| name.word()));
    if arguments.quick {
        words.push("--quick".to_owned());
    }
    words.extend(arguments.steps.map(|steps| format!("--steps {steps}")));
    if !arguments.scans.is_empty() {
        words.push("--scans".to_owned());
        words.extend(arguments.scans.iter().map(ScanCase::to_string));
    }
    words.join(" ")
}
