//! Pictures of the lower jaw's levels (§3.3.6, Fig. 3.7).

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use palpate::core::Clod;
use palpate::models::Model;
use palpate_report::{LevelPictures, Picture, views};

use super::outcome::{Finding, Reproduction};
use super::rendering::open;
use crate::stability::page::{Table, row};

/// Levels that the figure shows.
const SHOWN: [usize; 5] = [0, 3, 6, 11, 14];
/// Width of a picture, pixels.
const WIDTH: u32 = 800;

/// Returns whether levels 3 and 6 are made by simplification, and 11 and 14 by merging hulls.
fn is_completed_by_merging(free: &[bool]) -> bool {
    let is_free = |level: usize| free.get(level).copied();
    [3, 6].iter().all(|level| is_free(*level) == Some(false))
        && [11, 14].iter().all(|level| is_free(*level) == Some(true))
}

/// Returns a picture as an SVG document.
pub(super) fn svg(picture: &Picture) -> Result<String, String> {
    let png = picture.to_png().map_err(|error| error.to_string())?;
    let (width, height) = (picture.width(), picture.height());
    let data = STANDARD.encode(png);
    Ok(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\">\
         <image width=\"{width}\" height=\"{height}\" href=\"data:image/png;base64,{data}\"/></svg>\n"
    ))
}

fn drawn(clod: &Clod, levels: &[usize]) -> Result<String, String> {
    let pictures = LevelPictures::new(clod, &views::of_model(Model::LowerJaw), WIDTH);
    let there = levels.iter().filter(|level| **level < clod.levels.len());
    let shown: Vec<(usize, Picture)> = there.map(|level| (*level, pictures.level(*level))).collect();
    svg(&pictures.sheet(&shown))
}

fn table(name: &str, clod: &Clod) -> Table {
    let rows = clod
        .levels
        .iter()
        .enumerate()
        .map(|(level, of)| row![level, of.triangles, clod.level(level).len(), of.free]);
    let columns = vec!["level", "triangles", "patches", "free"];
    Table { name: name.to_owned(), columns, rows: rows.collect() }
}

/// Repeats Fig. 3.7.
///
/// # Errors
/// If the jaw cannot be built, or a picture cannot be drawn.
pub fn levels(name: &str) -> Result<Reproduction, String> {
    let jaw = open(Model::LowerJaw.name())?;
    let free: Vec<bool> = jaw.clod.levels.iter().map(|level| level.free).collect();
    let first = free.iter().position(|free| *free).unwrap_or(free.len());
    Ok(Reproduction {
        finding: Finding {
            claim: "Levels 3 and 6 of the lower jaw are made by sensation preserving simplification, levels 11 and 14 by pairwise merging \
                    of convex hulls, which completes the hierarchy."
                .to_owned(),
            measured: format!(
                "Of {} levels the first {first} are made by simplification, the others by merging: it goes further here.",
                free.len()
            ),
            condition: "Levels 3 and 6 are not free, levels 11 and 14 are.".to_owned(),
            holds: is_completed_by_merging(&free),
        },
        table: table(name, &jaw.clod),
        timing: None,
        plot: drawn(&jaw.clod, &SHOWN)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_that_are_not_merged_fail() {
        let levels = |first: usize| (0..15).map(|level| level >= first).collect::<Vec<_>>();
        assert!(is_completed_by_merging(&levels(9)));
        for other in [levels(5), levels(12), levels(15), Vec::new()] {
            assert!(!is_completed_by_merging(&other), "{other:?}");
        }
    }
}
