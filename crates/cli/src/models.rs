//! `palpate models` and `palpate export`.

use std::fs::File;
use std::io::BufWriter;

use palpate::models::Model;
use serde::Serialize;

use crate::arguments::{ExportArguments, ModelsArguments};
use crate::failure::Failure;
use crate::output;

#[derive(Serialize)]
struct Entry {
    name: &'static str,
    triangles: usize,
    description: &'static str,
}

pub fn list(arguments: &ModelsArguments) -> Result<(), Failure> {
    let entries = Model::ALL.map(|model| Entry {
        name: model.name(),
        triangles: model.default_triangles(),
        description: model.description(),
    });
    output::result(&arguments.json, &entries, |table| {
        for entry in &entries {
            table.row([&entry.name, &format!("{:>7}", entry.triangles), &entry.description]);
        }
    })
}

pub fn export(arguments: &ExportArguments) -> Result<(), Failure> {
    let (model, triangles) = Model::parse(&arguments.model)?;
    let path = &arguments.output;
    output::check_extension(path, "obj")?;
    output::check_files(&[], &[path])?;
    let mesh = model.generate(triangles)?;
    let written =
        File::create(path).and_then(|file| palpate::mesh_io::write_obj(&mesh, BufWriter::new(file)));
    written.map_err(|error| Failure::writing(path, error))
}
