//! `palpate check`.

use std::path::Path;

use palpate::core::mesh::ValidationReport;
use palpate::{mesh_io, open_mesh};
use serde::Serialize;

use crate::arguments::CheckArguments;
use crate::failure::Failure;
use crate::{output, progress};

/// The validation report with what needs a spatial index.
#[derive(Serialize)]
struct Check {
    #[serde(flatten)]
    report: ValidationReport,
    self_intersections: u64,
}

pub fn run(arguments: &CheckArguments) -> Result<(), Failure> {
    output::check_files(&[Path::new(&arguments.mesh)], arguments.json.file().as_slice())?;
    let opened = open_mesh(&arguments.mesh, &arguments.reading.options())?;
    progress::warn_of_loading(&arguments.mesh, &opened.warnings);
    let mut report = opened.mesh.validate();
    let crossings = mesh_io::self_intersections(&opened.mesh);
    report.first.self_intersection = crossings.first;
    let check = Check { report, self_intersections: crossings.count as u64 };
    output::result(&arguments.json, &check, |table| {
        let Check { report: r, self_intersections } = &check;
        let yes = |answer: bool| if answer { "yes" } else { "no" };
        let at = |first: Option<String>| first.map_or(String::new(), |first| format!("first: {first}"));
        let edge = |first: &Option<palpate::core::mesh::OffendingEdge>| {
            at(first
                .as_ref()
                .map(|e| format!("{}–{} of triangle {}", e.vertices[0], e.vertices[1], e.triangle)))
        };
        let first = &r.first;
        table.row([&"vertices", &r.vertices]);
        table.row([&"triangles", &r.triangles]);
        table.row([&"closed", &yes(r.closed)]);
        table.row([&"2-manifold", &yes(r.manifold)]);
        table.row([&"oriented", &yes(r.oriented)]);
        table.row([&"components", &r.components]);
        table.row([&"boundary edges", &r.boundary_edges, &edge(&first.boundary_edge)]);
        table.row([&"non-manifold edges", &r.nonmanifold_edges, &edge(&first.nonmanifold_edge)]);
        table.row([&"misoriented edges", &r.misoriented_edges, &edge(&first.misoriented_edge)]);
        table.row([&"degenerate triangles", &r.degenerate, &at(first.degenerate.map(|i| i.to_string()))]);
        table.row([&"duplicate triangles", &r.duplicate, &at(first.duplicate.map(|i| i.to_string()))]);
        table.row([&"non-finite vertices", &r.nonfinite, &at(first.nonfinite.map(|i| i.to_string()))]);
        let crossing = first.self_intersection.map(|[a, b]| format!("triangles {a} and {b}"));
        table.row([&"self-intersections", self_intersections, &at(crossing)]);
        table.row([&"bounding radius", &format!("{:.6} m", r.bounding_radius)]);
        table.row([&"volume", &format!("{:.6e} m³", r.volume)]);
    })
}
