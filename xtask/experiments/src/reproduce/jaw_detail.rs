//! Regions of the lower jaw that are simplified and merged first, and the patches that cover its teeth
//! (§3.3.6, Fig. 3.8).
//!
//! The fields that the model is generated from decide whether a point is on the gum or on a tooth's crown.
//! Edge collapses are counted by the vertices that they remove, one each, and merges by the patches.

use std::collections::{BTreeMap, HashSet};

use palpate::core::Clod;
use palpate::core::clod::Node;
use palpate::glam::DVec3;
use palpate::models::{JawPart, Model};
use palpate_report::LevelPictures;
use palpate_report::raster::View;

use super::outcome::{Finding, Reproduction};
use super::pictures::svg;
use super::rendering::open;
use crate::stability::page::{Table, row};

/// Levels that the figure shows, after the original mesh.
const SHOWN: [usize; 5] = [0, 1, 2, 4, 7];
/// Level at which the dissertation says that a tooth is one patch.
const COVERED_LEVEL: usize = 7;
/// Share above which a part counts as most of a whole, or as covering it.
const MAJORITY: f64 = 0.5;
/// Width of a picture, pixels.
const WIDTH: u32 = 800;
/// Angle of the close-up above the horizon, degrees.
const ELEVATION: f64 = 35.0;
/// Number of crowns in the close-up.
const CROWNS: usize = 3;

/// Amounts on the gum and on the crowns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Split {
    gum: f64,
    crowns: f64,
}

impl Split {
    fn add(&mut self, part: JawPart, amount: f64) {
        *(if part == JawPart::Gum { &mut self.gum } else { &mut self.crowns }) += amount;
    }

    fn minus(self, other: Self) -> Self {
        Self { gum: self.gum - other.gum, crowns: self.crowns - other.crowns }
    }

    fn gum_share(self) -> f64 {
        self.gum / (self.gum + self.crowns)
    }
}

/// Surface of the full mesh, and operations on it between M_0 and M_1, by region.
#[derive(Clone, Copy, Debug, Default)]
struct Regions {
    area: Split,
    triangles: Split,
    patches: Split,
    collapses: Split,
    merges: Split,
}

impl Regions {
    fn new(clod: &Clod, part_of: &impl Fn(DVec3) -> JawPart) -> Self {
        let mut found = Self::default();
        let areas: Vec<BTreeMap<JawPart, f64>> =
            clod.leaves().map(|leaf| areas_of(clod, &leaf, part_of)).collect();
        for (leaf, areas) in clod.leaves().zip(&areas) {
            for (part, area) in areas {
                found.area.add(*part, *area);
            }
            found.patches.add(mainly(areas), 1.0);
            for triangle in clod.patch(&leaf) {
                found.triangles.add(part_of(middle(clod, &leaf, triangle)), 1.0);
            }
        }
        if clod.levels.len() > 1 {
            found.collapses = vertices(clod, 0, part_of).minus(vertices(clod, 1, part_of));
            let first = clod.levels[0].nodes.start;
            for node in clod.level(1) {
                let children = node.children.clone();
                let mut merged: BTreeMap<JawPart, f64> = BTreeMap::new();
                for child in children.clone() {
                    for (part, area) in &areas[(child - first) as usize] {
                        *merged.entry(*part).or_default() += area;
                    }
                }
                found.merges.add(mainly(&merged), children.len().saturating_sub(1) as f64);
            }
        }
        found
    }

    /// Returns whether most operations are on the gums, and more than if they were spread evenly.
    fn is_mostly_at_the_gums(&self) -> bool {
        let blind = self.area.gum_share().max(self.triangles.gum_share());
        [self.collapses, self.merges].iter().all(|done| done.gum_share() > blind.max(MAJORITY))
    }
}

fn middle(clod: &Clod, node: &Node, triangle: [u32; 3]) -> DVec3 {
    triangle.map(|corner| clod.hull(node)[corner as usize]).iter().sum::<DVec3>() / 3.0
}

/// Returns the area (m²) of each part in a patch.
fn areas_of(clod: &Clod, node: &Node, part_of: &impl Fn(DVec3) -> JawPart) -> BTreeMap<JawPart, f64> {
    let mut areas = BTreeMap::new();
    for triangle in clod.patch(node) {
        let [a, b, c] = triangle.map(|corner| clod.hull(node)[corner as usize]);
        let area = 0.5 * (b - a).cross(c - a).length();
        *areas.entry(part_of(middle(clod, node, triangle))).or_default() += area;
    }
    areas
}

/// Returns the part with the largest share of an area.
fn mainly(areas: &BTreeMap<JawPart, f64>) -> JawPart {
    areas.iter().max_by(|a, b| a.1.total_cmp(b.1)).map_or(JawPart::Gum, |(part, _)| *part)
}

/// Counts the vertices of a level's surface by region.
fn vertices(clod: &Clod, level: usize, part_of: &impl Fn(DVec3) -> JawPart) -> Split {
    let mut split = Split::default();
    let mut known = HashSet::new();
    for node in clod.level(level) {
        for corner in clod.patch(&node).iter().flatten() {
            let point = clod.hull(&node)[corner as usize];
            // Both signed zeros are the same coordinate with different bits.
            if known.insert(point.to_array().map(|coordinate| (coordinate + 0.0).to_bits())) {
                split.add(part_of(point), 1.0);
            }
        }
    }
    split
}

/// Patch of a level that covers a crown best.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Cover {
    tooth: usize,
    /// Share of the crown's area on the full mesh that the patch covers.
    of_crown: f64,
    /// Share of the patch's area that is on this crown.
    of_patch: f64,
}

impl Cover {
    /// Returns whether the patch is the tooth and little else: one patch over the whole jaw does not count.
    fn is_one_patch(&self) -> bool {
        self.of_crown > MAJORITY && self.of_patch > MAJORITY
    }

    /// Returns the measure by which covers are compared.
    fn mutual(&self) -> f64 {
        self.of_crown.min(self.of_patch)
    }
}

/// Returns, for each level, the best cover of each crown. A patch covers the surface of its descendants among
/// the leaves.
fn covers(clod: &Clod, part_of: &impl Fn(DVec3) -> JawPart) -> Vec<Vec<Cover>> {
    let mut areas: Vec<BTreeMap<JawPart, f64>> = vec![BTreeMap::new(); clod.nodes().len()];
    for (index, leaf) in clod.levels[0].nodes.clone().zip(clod.leaves()) {
        areas[index as usize] = areas_of(clod, &leaf, part_of);
    }
    // Children follow their parents, so going backwards visits children first.
    for index in (1..clod.nodes().len()).rev() {
        let parent = clod.node(index as u32).parent as usize;
        for (part, area) in areas[index].clone() {
            *areas[parent].entry(part).or_default() += area;
        }
    }
    let whole = areas[Clod::ROOT as usize].clone();
    let cover = |level: usize, tooth: usize| {
        let part = JawPart::Crown(tooth);
        let crown = whole.get(&part)?;
        let nodes = clod.levels[level].nodes.clone();
        let covered = nodes.filter_map(|node| {
            let areas = &areas[node as usize];
            let area = areas.get(&part)?;
            Some(Cover { tooth, of_crown: area / crown, of_patch: area / areas.values().sum::<f64>() })
        });
        covered.max_by(|a, b| a.mutual().total_cmp(&b.mutual()))
    };
    let level = |level| (0..JawPart::TEETH).filter_map(|tooth| cover(level, tooth)).collect();
    (0..clod.levels.len()).map(level).collect()
}

/// Returns, of the covers at a level, the one that is closest to being one patch.
fn best(covers: &[Cover]) -> Option<Cover> {
    covers.iter().copied().max_by(|a, b| a.mutual().total_cmp(&b.mutual()))
}

/// Draws a close-up of a tooth between its neighbours, from outside and above.
fn drawn(clod: &Clod, tooth: usize, part_of: &impl Fn(DVec3) -> JawPart) -> Result<String, String> {
    let mut crowns: BTreeMap<usize, Vec<DVec3>> = BTreeMap::new();
    for node in clod.leaves() {
        for point in clod.hull(node) {
            if let JawPart::Crown(tooth) = part_of(*point) {
                crowns.entry(tooth).or_default().push(*point);
            }
        }
    }
    let center = |tooth: &usize| crowns[tooth].iter().sum::<DVec3>() / crowns[tooth].len() as f64;
    if !crowns.contains_key(&tooth) {
        return Err(format!("there is no tooth {tooth}"));
    }
    let from = center(&tooth);
    let mut nearest: Vec<usize> = crowns.keys().copied().collect();
    nearest.sort_by(|a, b| center(a).distance(from).total_cmp(&center(b).distance(from)));
    let shown: Vec<DVec3> = nearest.iter().take(CROWNS).flat_map(|tooth| crowns[tooth].clone()).collect();
    let outwards = from - clod.source.center;
    let view = View::from_degrees(outwards.y.atan2(outwards.x).to_degrees(), ELEVATION);
    let pictures = LevelPictures::close_up(clod, &view, WIDTH, &shown);
    let there = SHOWN.iter().filter(|level| **level < clod.levels.len());
    let levels: Vec<_> = there.map(|level| (*level, pictures.level(*level))).collect();
    svg(&pictures.sheet(&levels))
}

fn table(name: &str, found: &Regions, covers: &[Vec<Cover>]) -> Table {
    let mut rows = Vec::new();
    for (what, of) in [
        ("area", found.area),
        ("triangles", found.triangles),
        ("patches", found.patches),
        ("collapses", found.collapses),
        ("merges", found.merges),
    ] {
        rows.push(row![what, "", "", of.gum, of.crowns, of.gum_share(), "", ""]);
    }
    for (level, covers) in covers.iter().enumerate() {
        for Cover { tooth, of_crown, of_patch } in covers {
            rows.push(row!["cover", level, tooth, "", "", "", of_crown, of_patch]);
        }
    }
    let columns = vec!["what", "level", "tooth", "gum", "crowns", "gum_share", "of_crown", "of_patch"];
    Table { name: name.to_owned(), columns, rows }
}

/// Repeats Fig. 3.8.
///
/// # Errors
/// If the jaw cannot be built, or a picture cannot be drawn.
pub fn lower_jaw(name: &str) -> Result<Reproduction, String> {
    let jaw = open(Model::LowerJaw.name())?;
    let clod = &*jaw.clod;
    let part_of = |point| JawPart::of(Model::LowerJaw, point).unwrap_or(JawPart::Gum);
    let found = Regions::new(clod, &part_of);
    let covers = covers(clod, &part_of);
    let at = covers.get(COVERED_LEVEL).and_then(|covers| best(covers)).ok_or("the jaw has no such level")?;
    let first = covers.iter().position(|covers| best(covers).is_some_and(|best| best.is_one_patch()));
    let half = |part: &str, holds: bool| format!("{part} {}", if holds { "holds" } else { "falls short" });
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    Ok(Reproduction {
        finding: Finding {
            claim: "Between the original mesh M_0 and M_1 most of the simplification and merging takes place at the gums, which have detail \
                    at the highest resolution. At M_7 one particular tooth is covered by a single convex patch."
                .to_owned(),
            measured: format!(
                "{}: at the gums, which are {} of the surface, {} of its triangles and {} of its patches, are {} of {} collapses and {} of \
                 {} merges. {}: at level {COVERED_LEVEL} (of {} triangles in {} patches) {} of the crown of tooth {} goes into one patch, of \
                 which it is {}; {}.",
                half("The first part", found.is_mostly_at_the_gums()),
                percent(found.area.gum_share()),
                percent(found.triangles.gum_share()),
                percent(found.patches.gum_share()),
                percent(found.collapses.gum_share()),
                found.collapses.gum + found.collapses.crowns,
                percent(found.merges.gum_share()),
                found.merges.gum + found.merges.crowns,
                half("The second", at.is_one_patch()),
                clod.levels[COVERED_LEVEL].triangles,
                clod.level(COVERED_LEVEL).len(),
                percent(at.of_crown),
                at.tooth,
                percent(at.of_patch),
                first.map_or("so it is with more than half of each at no level".to_owned(), |level| format!(
                    "with more than half of each it is so from level {level} on"
                ))
            ),
            condition: format!(
                "Of collapses and of merges, more than {} are at the gums, and more than the gums' share of the surface and of its \
                 triangles; of some tooth's crown more than {} goes into one patch of level {COVERED_LEVEL}, and more than as much of the patch \
                 is of it.",
                percent(MAJORITY),
                percent(MAJORITY)
            ),
            holds: found.is_mostly_at_the_gums() && at.is_one_patch(),
        },
        table: table(name, &found, &covers),
        timing: None,
        plot: drawn(clod, at.tooth, &part_of)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jaw() -> palpate::Object {
        open("lower-jaw@10000").unwrap()
    }

    fn part_of(point: DVec3) -> JawPart {
        JawPart::of(Model::LowerJaw, point).unwrap()
    }

    #[test]
    fn operations_that_do_not_depend_on_place_fail() {
        let split = |gum: f64| Split { gum, crowns: 1.0 - gum };
        let of = |collapses: f64, merges: f64| Regions {
            area: split(0.7),
            triangles: split(0.4),
            patches: split(0.5),
            collapses: split(collapses),
            merges: split(merges),
        };
        assert!(of(0.9, 0.8).is_mostly_at_the_gums());
        for (collapses, merges) in [(0.7, 0.7), (0.6, 0.6), (0.9, 0.3), (0.3, 0.9)] {
            assert!(!of(collapses, merges).is_mostly_at_the_gums(), "{collapses} {merges}");
        }
        // A minority of all operations, however much above its share, is not most of them.
        let few = Regions { area: split(0.1), triangles: split(0.1), ..of(0.45, 0.45) };
        assert!(!few.is_mostly_at_the_gums());
    }

    /// With gum and crowns swapped, exactly one of the two has most of the operations, if they depend on
    /// place.
    #[test]
    fn every_operation_is_counted_once_in_its_region() {
        let jaw = jaw();
        let found = Regions::new(&jaw.clod, &part_of);
        let turned = Regions::new(&jaw.clod, &|point| match part_of(point) {
            JawPart::Gum => JawPart::Crown(0),
            JawPart::Crown(_) => JawPart::Gum,
        });
        let total = |split: Split| split.gum + split.crowns;
        let merged = jaw.clod.level(0).len() - jaw.clod.level(1).len();
        assert_eq!(total(found.merges), merged as f64);
        // By Euler's formula an edge collapse removes two triangles of a closed surface.
        let triangles = jaw.clod.levels[0].triangles - jaw.clod.levels[1].triangles;
        assert_eq!(2.0 * total(found.collapses), f64::from(triangles));
        assert_eq!(total(found.triangles), f64::from(jaw.clod.source.triangles));
        assert_eq!(
            (found.collapses.gum, found.collapses.crowns),
            (turned.collapses.crowns, turned.collapses.gum)
        );
        assert!(found.is_mostly_at_the_gums() != turned.is_mostly_at_the_gums(), "{found:?}\n{turned:?}");
    }

    #[test]
    fn crowns_in_many_patches_or_in_part_of_one_fail() {
        let jaw = jaw();
        let covers = covers(&jaw.clod, &part_of);
        assert!(covers.iter().all(|covers| covers.len() == JawPart::TEETH));
        // The full mesh has many patches per crown, and the root has all crowns in one.
        let root = covers.last().unwrap();
        assert!(root.iter().all(|cover| cover.of_crown > 0.999 && !cover.is_one_patch()), "{root:?}");
        assert!(!covers[0].iter().any(Cover::is_one_patch));
        assert!(
            covers.iter().flatten().all(|cover| cover.of_crown <= 1.0 + 1e-9 && cover.of_patch <= 1.0 + 1e-9)
        );
    }

    /// Stripes across the jaw, as large as crowns, are not covered by a patch at any level.
    #[test]
    fn stripes_across_the_jaw_are_not_covered_by_a_patch() {
        let jaw = jaw();
        let stripes = |point: DVec3| {
            let stripe = (point.x / 1e-3).floor().rem_euclid(2.0 * JawPart::TEETH as f64) as usize;
            if stripe < JawPart::TEETH { JawPart::Crown(stripe) } else { JawPart::Gum }
        };
        for (level, covers) in covers(&jaw.clod, &stripes).iter().enumerate() {
            assert!(!covers.iter().any(Cover::is_one_patch), "level {level}: {covers:?}");
        }
    }
}
