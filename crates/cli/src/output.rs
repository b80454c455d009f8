//! Results, on standard output as a table or as JSON.

use std::io::{Write, stdout};
use std::path::Path;

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
        stdout().lock().write_all(text.as_bytes())?;
    } else {
        std::fs::write(path, text).map_err(|error| Failure::writing(path, error))?;
    }
    Ok(())
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
            writeln!(out, "{}", cells.join("  ").trim_end())?;
        }
        Ok(())
    }
}
