//! `palpate check`.

use std::path::Path;

use palpate::core::mesh::{OffendingEdge, ValidationReport};
use palpate::mesh_io::{self, LoadWarning, Openings, RepairEffect, RepairSummary};
use palpate::open_mesh;
use serde::Serialize;

use crate::arguments::CheckArguments;
use crate::failure::Failure;
use crate::{output, progress};

/// Result of the check: validation report, self-intersections and verdict.
#[derive(Serialize)]
struct Check {
    #[serde(flatten)]
    report: ValidationReport,
    self_intersections: u64,
    openings: Openings,
    /// Whether repair was asked for.
    #[serde(skip)]
    asked: bool,
    /// What repair changed, and the surface before and after; null without repair, or if it changed nothing.
    repair: Option<Repair>,
    verdict: Verdict,
    /// Faults that prevent a hierarchy; empty if the mesh is ready.
    faults: Vec<String>,
    /// Warnings of the loader.
    warnings: Vec<String>,
}

/// A repair as JSON.
#[derive(Clone, Copy, Serialize)]
struct Repair {
    changes: RepairSummary,
    #[serde(flatten)]
    effect: RepairEffect,
}

/// Whether a hierarchy can be built from a mesh, and whether it holds out what it touches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
enum Verdict {
    #[serde(rename = "ready")]
    Ready,
    /// A hierarchy can be built, but the surface has openings.
    #[serde(rename = "open")]
    Open,
    /// A hierarchy can be built, but repair dropped surface.
    #[serde(rename = "lost surface")]
    LostSurface,
    #[serde(rename = "needs --repair")]
    NeedsRepair,
    /// Faults remain after the repair, or the mesh is empty.
    #[serde(rename = "not usable")]
    NotUsable,
}

pub fn run(arguments: &CheckArguments) -> Result<(), Failure> {
    output::check_files(&[Path::new(&arguments.mesh)], arguments.json.file().as_slice())?;
    let opened = open_mesh(&arguments.mesh, &arguments.reading.options())?;
    progress::warn_of_loading(&arguments.mesh, &opened.warnings);
    let mut report = opened.mesh.validate();
    let crossings = mesh_io::self_intersections(&opened.mesh);
    report.first.self_intersection = crossings.first;
    let self_intersections = crossings.count as u64;
    let faults = faults(&report, self_intersections);
    let openings = mesh_io::openings(&opened.mesh);
    let repair = opened.warnings.iter().find_map(|warning| match warning {
        LoadWarning::Repaired { changes, effect } => Some(Repair { changes: *changes, effect: *effect }),
        _ => None,
    });
    let verdict = match faults.is_empty() {
        true if repair.is_some_and(|repair| repair.effect.lost_surface()) => Verdict::LostSurface,
        true if !report.closed => Verdict::Open,
        true => Verdict::Ready,
        false if report.triangles == 0 || arguments.reading.repair => Verdict::NotUsable,
        false => Verdict::NeedsRepair,
    };
    let warnings = progress::words(&opened.warnings);
    let check = Check {
        report,
        self_intersections,
        openings,
        asked: arguments.reading.repair,
        repair,
        verdict,
        faults,
        warnings,
    };
    output::result(&arguments.json, &check, |table| print(&check, &arguments.mesh, table))
}

/// Rows of the result: each count with the first offending element.
fn print(check: &Check, mesh: &str, table: &mut output::Table) {
    let Check { report: r, self_intersections, faults, .. } = check;
    let yes = |answer: bool| if answer { "yes" } else { "no" };
    let at = |first: Option<String>| first.map_or(String::new(), |first| format!("first: {first}"));
    let number = |first: Option<u32>| at(first.map(|number| number.to_string()));
    let edge = |first: &Option<OffendingEdge>| {
        let OffendingEdge { vertices: [from, to], triangle } = first.as_ref()?;
        Some(format!("{from}–{to} of triangle {triangle}"))
    };
    let first = &r.first;
    table.row([&"vertices", &r.vertices]);
    table.row([&"triangles", &r.triangles]);
    table.row([&"closed", &yes(r.closed)]);
    table.row([&"2-manifold", &yes(r.manifold)]);
    table.row([&"oriented", &yes(r.oriented)]);
    table.row([&"components", &r.components]);
    table.row([&"boundary edges", &r.boundary_edges, &at(edge(&first.boundary_edge))]);
    table.row([&"non-manifold edges", &r.nonmanifold_edges, &at(edge(&first.nonmanifold_edge))]);
    table.row([&"misoriented edges", &r.misoriented_edges, &at(edge(&first.misoriented_edge))]);
    table.row([&"non-manifold vertices", &r.nonmanifold_vertices, &number(first.nonmanifold_vertex)]);
    table.row([&"degenerate triangles", &r.degenerate, &number(first.degenerate)]);
    table.row([&"duplicate triangles", &r.duplicate, &number(first.duplicate)]);
    table.row([&"non-finite vertices", &r.nonfinite, &number(first.nonfinite)]);
    let crossing = first.self_intersection.map(|[a, b]| format!("triangles {a} and {b}"));
    table.row([&"self-intersections", self_intersections, &at(crossing)]);
    table.row([&"bounding radius", &format!("{:.6} m", r.bounding_radius)]);
    table.row([&"volume", &format!("{:.6e} m³", r.volume)]);
    if check.openings.count > 0 {
        let across = format!("the largest {:.6} m across", check.openings.largest);
        table.row([&"openings", &check.openings.count, &across]);
    }
    if let Some(Repair { effect, .. }) = &check.repair {
        let rows = [
            ("volume before repair", effect.volume_before, "m³"),
            ("area before repair", effect.area_before, "m²"),
            ("area after repair", effect.area_after, "m²"),
            ("surface lost", effect.lost_area, "m²"),
        ];
        for (name, quantity, unit) in rows {
            table.row([&name, &format!("{quantity:.6e} {unit}")]);
        }
    }
    let doubts = if check.warnings.is_empty() { "" } else { "; see the warnings" };
    table.row([&"verdict", &format!("{}{doubts}", check.verdict.in_words(mesh, check))]);
    if !(faults.is_empty() && r.closed) {
        table.row([&"", &"vertices and triangles are counted from 0, vertices after equal ones were merged"]);
    }
}

impl Verdict {
    fn in_words(self, mesh: &str, check: &Check) -> String {
        let faults = check.faults.join(", ");
        match self {
            Self::Ready => {
                "ready: a hierarchy can be built from it, and nothing passes through it".to_owned()
            }
            Self::Open => {
                let remedy = if check.asked {
                    "close them in the program that it came from"
                } else {
                    "--repair closes cracks; close holes in the program that it came from"
                };
                let Openings { count, largest } = check.openings;
                format!(
                    "open: a hierarchy can be built from it, but things may pass through {count} openings, up to \
                     {largest:.3e} m across: {remedy}"
                )
            }
            Self::LostSurface => {
                let lost = check.repair.map_or(0.0, |repair| repair.effect.lost_area);
                format!(
                    "lost surface: a hierarchy can be built from it, but {lost:.3e} m² of surface were dropped where \
                     parts intersect, and things may fall in there: unite them in the program that it came from"
                )
            }
            Self::NeedsRepair => {
                format!(
                    "needs --repair ({faults}): `palpate build {mesh} --repair -o FILE.clod`, or run with --repair"
                )
            }
            Self::NotUsable => format!("not usable ({faults}): correct it in the program that it came from"),
        }
    }
}

/// Faults of a mesh that prevent a hierarchy.
fn faults(report: &ValidationReport, self_intersections: u64) -> Vec<String> {
    let counted = [
        (report.nonfinite as u64, "vertices that are not finite"),
        (report.degenerate as u64, "degenerate triangles"),
        (report.duplicate as u64, "duplicate triangles"),
        (report.nonmanifold_edges as u64, "non-manifold edges"),
        (report.misoriented_edges as u64, "misoriented edges"),
        (report.nonmanifold_vertices as u64, "fans of triangles that meet the rest at a vertex only"),
        (self_intersections, "self-intersections"),
    ];
    let mut faults: Vec<String> = counted
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{count} {what}"))
        .collect();
    if report.triangles == 0 {
        faults.push("there is no triangle".to_owned());
    }
    if report.closed && report.volume < 0.0 {
        faults.push("the triangles face inwards".to_owned());
    }
    faults
}
