//! Size of hierarchies of contact levels of detail: Table 3.2 (§3.5.1), and coarse models of Table 4.1
//! (§4.5).

use palpate::Object;
use palpate::models::Model;
use palpate_report::{Curve, LogAxis, LogPlot, Table32, draw_log_log};

use palpate_tests::shared;

use super::outcome::{Finding, Reproduction};
use super::rendering::open;
use crate::stability::page::{Table, row};

/// Models of Table 3.2.
const BENCHMARK: [Model; 8] = [
    Model::LowerJaw,
    Model::UpperJaw,
    Model::BallJointBall,
    Model::BallJointSocket,
    Model::GolfClub,
    Model::GolfBall,
    Model::Cup,
    Model::Spoon,
];
/// Largest numbers of triangles and patches of a coarsest level in Table 3.2, and its range of level counts.
const COARSEST: (u32, u32) = (1532, 256);
const LEVELS: (u32, u32) = (14, 18);
/// Factor by which counts may exceed the dissertation's, since the models differ from its at the same size.
const MARGIN: f64 = 1.5;

/// Returns whether a hierarchy resembles the dissertation's of the same model: in size, simplification and
/// number of levels.
fn is_alike(ours: &Table32, theirs: &Table32) -> bool {
    let within = |ours: u32, most: u32| f64::from(ours) <= MARGIN * f64::from(most);
    let size = f64::from(ours.original_triangles) / f64::from(theirs.original_triangles);
    (0.95..1.05).contains(&size)
        && within(ours.simplified_triangles, COARSEST.0)
        && within(ours.simplified_patches, COARSEST.1)
        && f64::from(ours.levels) * MARGIN >= f64::from(LEVELS.0)
        && within(ours.levels, LEVELS.1)
        && ours.finest_resolution.is_some_and(|finest| finest > 2.0 * ours.coarsest_resolution)
}

/// Repeats Table 3.2.
///
/// # Errors
/// If a model cannot be built, or the plot cannot be drawn.
pub fn benchmark_models(name: &str) -> Result<Reproduction, String> {
    let mut rows = Vec::new();
    let mut curves = Vec::new();
    let mut alike = Vec::new();
    let mut words = Vec::new();
    for model in BENCHMARK {
        let object = open(model.name())?;
        let (ours, theirs) = (Table32::of(&object.clod), Table32::published(model).ok_or("no such row")?);
        for (whose, of) in [("palpate", ours), ("dissertation", theirs)] {
            rows.push(entries(model.name(), whose, &of));
        }
        curves.push(levels_of(model.name(), &object));
        alike.push(is_alike(&ours, &theirs));
        words.push(format!(
            "{} {} ({}) triangles, {} ({}) patches, {} ({}) levels",
            model.name(),
            ours.simplified_triangles,
            theirs.simplified_triangles,
            ours.simplified_patches,
            theirs.simplified_patches,
            ours.levels,
            theirs.levels
        ));
    }
    // The plot has as many colours as curves remain. The halves of the ball joint are alike, and so are the
    // jaws.
    curves.retain(|curve| !["ball-joint-socket", "upper-jaw"].contains(&curve.name.as_str()));
    Ok(Reproduction {
        finding: Finding {
            claim: "Models of 40,180 to 177,876 triangles are simplified to coarsest levels of 122 to 1,532 triangles and 8 to 256 convex \
                    patches, in 14 to 18 levels."
                .to_owned(),
            measured: format!(
                "Coarsest levels, in brackets the dissertation's: {}. The models are generated, of the same size and similar shape: its own \
                 are not published.",
                words.join("; ")
            ),
            condition: format!(
                "Each model has as many triangles, give or take 5 %; its coarsest level that is not free has at most {MARGIN} times 1,532 \
                 triangles and 256 patches; levels are 14 to 18, give or take as much; and resolution falls by more than half."
            ),
            holds: alike.iter().all(|alike| *alike),
        },
        table: Table { name: name.to_owned(), columns: COLUMNS.to_vec(), rows },
        timing: None,
        plot: plot_of("Levels of the benchmark models (Table 3.2)", curves)?,
    })
}

const COLUMNS: [&str; 10] = [
    "model",
    "of",
    "original_triangles",
    "original_patches",
    "simplified_triangles",
    "simplified_patches",
    "finest_resolution",
    "coarsest_resolution",
    "free_levels",
    "levels",
];

/// Returns a model's row in the table, in the order of [`COLUMNS`].
fn entries(model: &str, whose: &str, of: &Table32) -> Vec<String> {
    row![
        model,
        whose,
        of.original_triangles,
        of.original_patches,
        of.simplified_triangles,
        of.simplified_patches,
        of.finest_resolution.unwrap_or(f64::NAN),
        of.coarsest_resolution,
        of.free_levels,
        of.levels
    ]
}

/// Returns triangles over resolution of the levels that are not free, the finest last.
fn levels_of(model: &str, object: &Object) -> Curve {
    let levels = object.clod.levels.iter().filter(|level| !level.free);
    let radius = object.bounding_radius();
    let mut points: Vec<(f64, f64)> =
        levels.skip(1).map(|level| (level.resolution * radius, f64::from(level.triangles))).collect();
    points.reverse();
    Curve { name: model.to_owned(), points }
}

fn plot_of(title: &str, curves: Vec<Curve>) -> Result<String, String> {
    let plot = LogPlot {
        title: title.to_owned(),
        x: LogAxis {
            name: "resolution times radius".to_owned(),
            marks: vec![5.0, 10.0, 20.0, 50.0, 100.0, 200.0],
        },
        y: LogAxis { name: "triangles".to_owned(), marks: vec![100.0, 1e3, 1e4, 1e5] },
        curves,
        scattered: Vec::new(),
    };
    draw_log_log(&plot).map_err(|error| error.to_string())
}

/// Meshes of the optional test data that others scanned or constructed; the first six are drawn.
const REAL: [&str; 14] = [
    "dental_cast_lower.obj",
    "human_mandible.obj",
    "femur_left.stl",
    "scallop_120k.glb",
    "ycb_mug.obj",
    "gear_large.obj",
    "dental_cast_upper.obj",
    "ycb_golf_ball.obj",
    "ycb_hammer.obj",
    "ycb_spoon.obj",
    "dog_body.stl",
    "bracket.stl",
    "nut_m16.obj",
    "bolt_m16.obj",
];

/// Returns whether a mesh of any size is simplified as far as the dissertation's.
fn is_simplified(of: &Table32) -> bool {
    f64::from(of.simplified_triangles) <= MARGIN * f64::from(COARSEST.0)
        && f64::from(of.simplified_patches) <= MARGIN * f64::from(COARSEST.1)
        && of.finest_resolution.is_some_and(|finest| finest > 2.0 * of.coarsest_resolution)
}

/// Repeats Table 3.2 on real meshes; `None` if their files are absent.
///
/// # Errors
/// The same as [`benchmark_models`].
pub fn real_models(name: &str) -> Result<Option<Reproduction>, String> {
    let (mut rows, mut curves, mut short) = (Vec::new(), Vec::new(), Vec::new());
    for file in REAL {
        let Some(path) = shared(&format!("models/good/{file}")) else { return Ok(None) };
        let object = open(path.to_str().ok_or("the path is not Unicode")?)?;
        let found = Table32::of(&object.clod);
        rows.push(entries(file, "palpate", &found));
        if curves.len() < 6 {
            curves.push(levels_of(file, &object));
        }
        if !is_simplified(&found) {
            let Table32 { original_triangles, simplified_triangles, simplified_patches, .. } = found;
            short.push(format!(
                "{file} of {original_triangles} triangles to {simplified_triangles} triangles and {simplified_patches} patches"
            ));
        }
    }
    let simplified = REAL.len() - short.len();
    let rest = if short.is_empty() { String::new() } else { format!("; not {}", short.join(", ")) };
    Ok(Some(Reproduction {
        finding: Finding {
            claim: "The same of meshes that were scanned, or constructed by others: coarsest levels of up to 1,532 triangles and 256 \
                    convex patches."
                .to_owned(),
            measured: format!("{simplified} of {} meshes are simplified as far{rest}.", REAL.len()),
            condition: format!(
                "Of each mesh the coarsest level that is not free has at most {MARGIN} times 1,532 triangles and 256 patches, and \
                 resolution falls by more than half."
            ),
            holds: short.is_empty(),
        },
        table: Table { name: name.to_owned(), columns: COLUMNS.to_vec(), rows },
        timing: None,
        plot: plot_of("Levels of real meshes (as Table 3.2)", curves)?,
    }))
}

/// Models of Table 4.1: triangles at full and at low resolution and bounding volumes at low resolution in the
/// dissertation, and the smallest triangle count of the generated model.
const TEXTURED: [(Model, [u32; 3], usize); 6] = [
    (Model::Block, [65_536, 16, 1], 300),
    (Model::Gear, [25_600, 1600, 1], 1600),
    (Model::Hammer, [433_152, 518, 210], 800),
    (Model::CadPart, [658_432, 720, 390], 8000),
    (Model::File, [285_824, 632, 113], 632),
    (Model::Torus, [128_000, 532, 114], 532),
];
/// Largest share of triangles at low resolution in Table 4.1, that of the gear, with a margin.
const MAX_LOW_SHARE: f64 = 1.05 / 16.0;

/// Returns whether a model's triangles at full and low resolution and its patches match its row.
fn is_coarse([full, low, patches]: [u32; 3], [theirs, _, volumes]: [u32; 3]) -> bool {
    let size = f64::from(full) / f64::from(theirs);
    let left = f64::from(low) / f64::from(full);
    (0.95..1.05).contains(&size) && left <= MAX_LOW_SHARE && (volumes > 1 || patches == 1)
}

/// Repeats Table 4.1.
///
/// # Errors
/// If a model cannot be built, or the plot cannot be drawn.
pub fn textured_models(name: &str) -> Result<Reproduction, String> {
    let (mut rows, mut words, mut curves, mut alike) = (Vec::new(), Vec::new(), Vec::new(), true);
    for (model, theirs, coarse) in TEXTURED {
        let full = model.generate(model.default_triangles()).map_err(|error| error.to_string())?;
        let object = open(&format!("{}@{coarse}", model.name()))?;
        let full = full.triangles().len() as u32;
        let ours = [full, object.clod.source.triangles, object.clod.leaves().len() as u32];
        for (whose, [full, low, patches]) in [("palpate", ours), ("dissertation", theirs)] {
            rows.push(row![model.name(), whose, full, low, patches]);
        }
        words.push(format!(
            "{} {} to {} triangles ({}), {} patches ({})",
            model.name(),
            ours[0],
            ours[1],
            theirs[1],
            ours[2],
            theirs[2]
        ));
        let point = |of: [u32; 3]| vec![(f64::from(of[1]), f64::from(of[0]))];
        curves.push(Curve { name: model.name().to_owned(), points: [point(ours), point(theirs)].concat() });
        alike &= is_coarse(ours, theirs);
    }
    let plot = LogPlot {
        title: "Textured models, ours joined to the dissertation's (Table 4.1)".to_owned(),
        x: LogAxis { name: "triangles at low resolution".to_owned(), marks: vec![10.0, 100.0, 1e3, 1e4] },
        y: LogAxis { name: "triangles at full resolution".to_owned(), marks: vec![1e4, 1e5, 1e6] },
        curves,
        scattered: Vec::new(),
    };
    Ok(Reproduction {
        finding: Finding {
            claim: "Models of 25,600 to 658,432 triangles are reduced to 16 to 1,600 triangles, block and gear to one convex patch; their \
                    detail is in textures."
                .to_owned(),
            measured: format!(
                "In brackets the dissertation's at low resolution: {}. Block, hammer and CAD part are not generated coarser.",
                words.join("; ")
            ),
            condition: "Each model has as many triangles at full resolution, give or take 5 %, at low resolution at most a sixteenth of them \
                        (and 5 %), and block and gear are one convex patch."
                .to_owned(),
            holds: alike,
        },
        table: Table {
            name: name.to_owned(),
            columns: vec!["model", "of", "full_triangles", "low_triangles", "low_patches"],
            rows,
        },
        timing: None,
        plot: draw_log_log(&plot).map_err(|error| error.to_string())?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_that_are_not_reduced_fail() {
        let (_, theirs, _) = TEXTURED[1];
        assert!(is_coarse(theirs, theirs));
        let [full, low, patches] = theirs;
        assert!(!is_coarse([full, full, patches], theirs) && !is_coarse([full, low, 2], theirs));
        assert!(!is_coarse([full / 2, low / 2, patches], theirs));
    }

    #[test]
    fn a_hierarchy_that_is_not_simplified_fails() {
        let object = open("spoon").unwrap();
        let (ours, theirs) = (Table32::of(&object.clod), Table32::published(Model::Spoon).unwrap());
        assert!(is_alike(&ours, &theirs), "{ours:?}");
        // Variants: only the finest level, and a flat list of patches.
        let Table32 { original_triangles, original_patches, .. } = ours;
        let unsimplified = Table32 {
            simplified_triangles: original_triangles,
            simplified_patches: original_patches,
            ..ours
        };
        assert!(!is_alike(&unsimplified, &theirs));
        assert!(!is_alike(&Table32 { levels: 2, ..ours }, &theirs));
        assert!(!is_alike(&Table32 { finest_resolution: None, ..ours }, &theirs));
    }
}
