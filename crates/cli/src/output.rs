//! Results, on standard output as a table or as JSON, and the files that a command writes.

use std::fs::{File, OpenOptions};
use std::io::{self, Write, stdout};
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::arguments::Json;
use crate::failure::Failure;

/// Prints or writes `value` as JSON where that was asked for; otherwise prints the rows of a table.
pub fn result(json: &Json, value: &impl Serialize, table: impl FnOnce(&mut Table)) -> Result<(), Failure> {
    let Some(path) = &json.json else {
        let mut rows = Table::default();
        table(&mut rows);
        return rows.print();
    };
    let mut text =
        serde_json::to_string_pretty(value).map_err(|error| Failure::Message(format!("JSON: {error}")))?;
    text.push('\n');
    if path == Path::new("-") {
        stdout().lock().write_all(text.as_bytes()).map_err(|error| Failure::printing(&error))?;
    } else {
        std::fs::write(path, text).map_err(|error| Failure::writing(path, error))?;
    }
    Ok(())
}

/// Refuses, before the work, files to write that cannot be written or that are another file of the command as well.
pub fn check_files(read: &[&Path], write: &[&Path]) -> Result<(), Failure> {
    let mut taken: Vec<PathBuf> = read.iter().filter_map(|path| identity(path)).collect();
    for path in write {
        probe(path).map_err(|error| Failure::writing(path, error))?;
        let Some(identity) = identity(path) else { continue };
        if taken.contains(&identity) {
            let path = path.display();
            return Err(Failure::Message(format!(
                "{path} would be overwritten: it is named twice; give another file"
            )));
        }
        taken.push(identity);
    }
    Ok(())
}

/// Refuses a file to write whose name does not say what it will hold.
pub fn check_extension(path: &Path, extension: &str) -> Result<(), Failure> {
    if path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension)) {
        return Ok(());
    }
    let path = path.display();
    Err(Failure::Message(format!("{path}: the output's name must end in .{extension}")))
}

/// The absolute path of a regular file or of one that may become one; none for a device, a pipe or a built-in model.
fn identity(path: &Path) -> Option<PathBuf> {
    match path.canonicalize() {
        Ok(full) => full.is_file().then_some(full),
        Err(_) => Some(folder(path).canonicalize().ok()?.join(path.file_name()?)),
    }
}

/// Opens a file for writing, and leaves no trace of it.
fn probe(path: &Path) -> io::Result<()> {
    match path.metadata() {
        Ok(data) if data.is_file() || data.is_dir() => OpenOptions::new().append(true).open(path).map(drop),
        Ok(_) => Ok(()),
        Err(_) => {
            File::create_new(path)?;
            std::fs::remove_file(path)
        }
    }
}

fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Rows of cells, printed with aligned columns.
#[derive(Default)]
pub struct Table(Vec<Vec<String>>);

impl Table {
    /// Adds a row.
    pub fn row<const N: usize>(&mut self, cells: [&dyn std::fmt::Display; N]) {
        self.0.push(cells.iter().map(ToString::to_string).collect());
    }

    fn print(&self) -> Result<(), Failure> {
        let columns = self.0.iter().map(Vec::len).max().unwrap_or(0);
        let width = |column: usize| {
            let cells = self.0.iter().filter_map(|row| row.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..columns).map(width).collect();
        let mut out = stdout().lock();
        for row in &self.0 {
            let cells: Vec<String> =
                row.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}")).collect();
            writeln!(out, "{}", cells.join("  ").trim_end()).map_err(|error| Failure::printing(&error))?;
        }
        Ok(())
    }
}
