//! Page of the results, with its tables and pictures.

use std::fmt::Write as _;
use std::path::Path;

use palpate_report::{HeatMap, draw_heat_maps};

/// Condition with its result.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// Condition that should hold.
    pub statement: String,
    pub holds: bool,
    /// Measured result, in numbers.
    pub found: String,
}

impl Verdict {
    pub fn new(statement: impl Into<String>, holds: bool, found: impl Into<String>) -> Self {
        Self { statement: statement.into(), holds, found: found.into() }
    }
}

/// Results of one kind, a row per case.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Name of the file, without its extension.
    pub name: String,
    pub columns: Vec<&'static str>,
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// Writes the table into a folder as CSV.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), String> {
        let path = folder.join(format!("{}.csv", self.name));
        let fail = |error: csv::Error| format!("cannot write {}: {error}", path.display());
        let mut out = csv::Writer::from_path(&path).map_err(fail)?;
        out.write_record(&self.columns).map_err(fail)?;
        for row in &self.rows {
            out.write_record(row).map_err(fail)?;
        }
        out.flush().map_err(|error| fail(error.into()))
    }
}

/// Makes a row of a table from values.
macro_rules! row {
    ($($value:expr),* $(,)?) => { vec![$($crate::stability::page::Entry::entry(&$value)),*] };
}
pub(crate) use row;

/// Value that a table can hold.
pub trait Entry {
    fn entry(&self) -> String;
}

impl Entry for f64 {
    /// Formats with six significant digits.
    fn entry(&self) -> String {
        let rounded: f64 = format!("{self:.5e}").parse().unwrap_or(*self);
        if rounded == 0.0 || (1e-4..1e7).contains(&rounded.abs()) || !rounded.is_finite() {
            format!("{}", rounded + 0.0)
        } else {
            format!("{rounded:e}")
        }
    }
}

macro_rules! entries {
    ($($kind:ty),*) => {
        $(impl Entry for $kind {
            fn entry(&self) -> String {
                self.to_string()
            }
        })*
    };
}
entries!(&str, String, bool, u32, u64, usize);

impl<E: Entry> Entry for &E {
    fn entry(&self) -> String {
        (*self).entry()
    }
}

/// Picture of a map.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Name of the file, without its extension.
    pub name: String,
    pub caption: String,
    pub maps: Vec<HeatMap>,
    /// Number of maps per row.
    pub columns: usize,
}

/// Section of the page about one map.
#[derive(Clone, Debug, Default)]
pub struct Section {
    pub title: &'static str,
    pub paragraphs: Vec<String>,
    pub tables: Vec<Table>,
    pub pictures: Vec<Picture>,
    pub verdicts: Vec<Verdict>,
}

impl Section {
    /// Writes tables and pictures into a folder.
    ///
    /// # Errors
    /// If a file cannot be written, or a picture cannot be drawn.
    pub fn write(&self, folder: &Path) -> Result<(), String> {
        for table in &self.tables {
            table.write(folder)?;
        }
        for picture in &self.pictures {
            let path = folder.join(format!("{}.svg", picture.name));
            let svg = draw_heat_maps(&picture.maps, picture.columns).map_err(|error| error.to_string())?;
            std::fs::write(&path, svg)
                .map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        }
        Ok(())
    }
}

/// Returns the page in Markdown.
pub fn render(command: &str, sections: &[Section]) -> String {
    let mut page = String::new();
    let _ = writeln!(page, "# Where palpate is stable\n\n```sh\n{command}\n```\n");
    let verdicts = || sections.iter().flat_map(|section| &section.verdicts);
    let held = verdicts().filter(|verdict| verdict.holds).count();
    let _ = writeln!(
        page,
        "Everything here is simulated on emulated devices and hands and computed from the tables beside this page. Of \
         {} conditions {held} hold.\n",
        verdicts().count()
    );
    for section in sections {
        let _ = writeln!(page, "## {}\n", section.title);
        for paragraph in &section.paragraphs {
            let _ = writeln!(page, "{paragraph}\n");
        }
        for picture in &section.pictures {
            let _ = writeln!(page, "![{}]({}.svg)\n\n{}\n", picture.name, picture.name, picture.caption);
        }
        for verdict in &section.verdicts {
            let word = if verdict.holds { "holds" } else { "falls short" };
            let _ = writeln!(page, "- **{word}**: {} ({})", verdict.statement, verdict.found);
        }
        let files: Vec<String> =
            section.tables.iter().map(|table| format!("[{0}.csv]({0}.csv)", table.name)).collect();
        let _ = writeln!(page, "\nTables: {}\n", files.join(", "));
    }
    page
}
