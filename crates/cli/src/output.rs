//! Output of commands: results as a table or JSON, and checks of the files to write.

use std::fs::{File, OpenOptions};
use std::io::{self, Write, stdout};
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::arguments::Json;
use crate::failure::Failure;

/// Prints or writes `value` as JSON if `--json` was given; otherwise prints the rows of a table.
pub fn result(json: &Json, value: &impl Serialize, table: impl FnOnce(&mut Table)) -> Result<(), Failure> {
    text_or_json(json, value, || {
        let mut rows = Table::default();
        table(&mut rows);
        rows.lines().into_iter().map(|row| row + "\n").collect()
    })
}

/// Prints or writes `value` as JSON if `--json` was given; otherwise prints `text`.
pub fn text_or_json(
    json: &Json,
    value: &impl Serialize,
    text: impl FnOnce() -> String,
) -> Result<(), Failure> {
    let Some(path) = &json.json else {
        return stdout().lock().write_all(text().as_bytes()).map_err(|error| Failure::printing(&error));
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

/// Refuses, before the work, output files that cannot be written or that the command also reads or writes
/// otherwise.
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

/// Refuses an output file whose extension is not that of its format.
pub fn check_extension(path: &Path, extension: &str) -> Result<(), Failure> {
    if path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension)) {
        return Ok(());
    }
    let path = path.display();
    Err(Failure::Message(format!("{path}: the output's name must end in .{extension}")))
}

/// Absolute path of a regular file, or of one that can be created; `None` for a device, a pipe or a built-in
/// model.
fn identity(path: &Path) -> Option<PathBuf> {
    match path.canonicalize() {
        Ok(full) => full.is_file().then_some(full),
        Err(_) => Some(folder(path).canonicalize().ok()?.join(path.file_name()?)),
    }
}

/// Tries to open a file for writing, and leaves it unchanged.
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

/// Refuses an output folder that is not a folder or cannot be created. A folder that did not exist does not
/// exist afterwards.
pub fn check_folder(path: &Path) -> Result<(), Failure> {
    let refused = |error: io::Error| Failure::writing(path, error);
    if path.exists() {
        return if path.is_dir() { Ok(()) } else { Err(refused(io::ErrorKind::NotADirectory.into())) };
    }
    std::fs::create_dir(path).and_then(|()| std::fs::remove_dir(path)).map_err(refused)
}

/// Rows of cells, printed with aligned columns. An empty row separates blocks, whose columns are aligned
/// independently.
#[derive(Default)]
pub struct Table(Vec<Vec<String>>);

impl Table {
    /// Adds a row.
    pub fn row<const N: usize>(&mut self, cells: [&dyn std::fmt::Display; N]) {
        self.0.push(cells.iter().map(ToString::to_string).collect());
    }

    fn lines(&self) -> Vec<String> {
        let blocks: Vec<&[Vec<String>]> = self.0.split(|row| row.is_empty()).collect();
        blocks.into_iter().map(aligned).collect::<Vec<_>>().join(&[String::new()][..])
    }
}

/// Lines of a block, each column as wide as its widest cell.
fn aligned(rows: &[Vec<String>]) -> Vec<String> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells: Vec<String> =
            row.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}")).collect();
        cells.join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_within_each_block() {
        let mut table = Table::default();
        table.row([&"level", &"r"]);
        table.row([&10, &"λ"]);
        table.row([]);
        table.row([&"a", &"b"]);
        assert_eq!(table.lines(), ["level  r", "10     λ", "", "a  b"]);
        assert!(Table::default().lines().is_empty());
    }
}
