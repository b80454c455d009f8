//! Figures of a hierarchy of contact levels of detail: the columns of Table 3.2, and a row per level.

use palpate::core::Clod;
use palpate::core::clod::Level;
use palpate::models::Model;
use serde::Serialize;

/// Columns of Table 3.2 for one object.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Table32 {
    /// Number of triangles of the full mesh ("Orig. Tris").
    pub original_triangles: u32,
    /// Number of convex patches of the full mesh ("Orig. BVs").
    pub original_patches: u32,
    /// Number of triangles of the coarsest level that is not free ("Simp. Tris").
    pub simplified_triangles: u32,
    /// Number of convex patches of that level ("Simp. BVs").
    pub simplified_patches: u32,
    /// Resolution r_1 of the finest simplified level, which is level 1, times the bounding radius; `None` if
    /// there is no simplified level.
    pub finest_resolution: Option<f64>,
    /// Resolution r_λ of the coarsest level that is not free, times the bounding radius.
    pub coarsest_resolution: f64,
    /// Number of free levels.
    pub free_levels: u32,
    /// Number of all levels.
    pub levels: u32,
}

impl Table32 {
    /// Returns the columns for a hierarchy.
    pub fn of(clod: &Clod) -> Self {
        let free_levels = clod.levels.iter().filter(|level| level.free).count();
        let coarsest = (clod.levels.len() - free_levels).saturating_sub(1);
        let level = &clod.levels[coarsest];
        let normalised = |level: &Level| level.resolution * clod.bounding_radius();
        Self {
            original_triangles: clod.source.triangles,
            original_patches: clod.leaves().len() as u32,
            simplified_triangles: level.triangles,
            simplified_patches: level.nodes.len() as u32,
            finest_resolution: (coarsest > 0).then(|| normalised(&clod.levels[1])),
            coarsest_resolution: normalised(level),
            free_levels: free_levels as u32,
            levels: clod.levels.len() as u32,
        }
    }

    /// Returns the row of Table 3.2 of the dissertation for its own model of this name; both halves of the
    /// ball joint have the same row. Its models are not published; the built-in ones have the same sizes and
    /// similar shapes.
    pub fn published(model: Model) -> Option<Self> {
        let row = match model {
            Model::LowerJaw => (40_180, 11_323, 386, 64, 144.5, 12.23, 6, 15),
            Model::UpperJaw => (47_339, 14_240, 1_038, 222, 117.5, 19.21, 8, 15),
            Model::BallJointBall | Model::BallJointSocket => (137_060, 41_913, 122, 8, 169.9, 6.75, 3, 17),
            Model::GolfClub => (104_888, 27_586, 1_468, 256, 157.6, 8.31, 8, 16),
            Model::GolfBall => (177_876, 67_704, 826, 64, 216.3, 7.16, 6, 18),
            Model::Cup => (64_000, 15_490, 1_532, 241, 71.0, 7.70, 7, 14),
            Model::Spoon => (86_016, 16_125, 1_074, 61, 230.1, 13.57, 5, 14),
            _ => return None,
        };
        let (original_triangles, original_patches, simplified_triangles, simplified_patches, ..) = row;
        let (.., finest, coarsest_resolution, free_levels, levels) = row;
        Some(Self {
            original_triangles,
            original_patches,
            simplified_triangles,
            simplified_patches,
            finest_resolution: Some(finest),
            coarsest_resolution,
            free_levels,
            levels,
        })
    }
}

/// Figures of one level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelFigures {
    /// Number of triangles of the level's mesh; for a free level, of the coarsest level that is not free.
    pub triangles: u32,
    /// Number of patches, or of hulls of a free level.
    pub patches: u32,
    /// Resolution r, 1/m.
    pub resolution: f64,
    /// Whether the level was made by unconstrained merging.
    pub free: bool,
    /// Deviation s of the level's patches, m.
    pub deviation: Spread,
    /// Distance h of the level's hulls, m.
    pub hausdorff: Spread,
    /// Memory of the level, including the points that no finer level has, bytes.
    pub bytes: usize,
}

impl LevelFigures {
    /// Returns the figures of each level, the full mesh first.
    pub fn of(clod: &Clod) -> Vec<Self> {
        let figures = |(index, level): (usize, &Level)| {
            let nodes = clod.level(index);
            Self {
                triangles: level.triangles,
                patches: nodes.len() as u32,
                resolution: level.resolution,
                free: level.free,
                deviation: Spread::of(nodes.iter().map(|node| node.deviation)),
                hausdorff: Spread::of(nodes.iter().map(|node| node.hausdorff)),
                bytes: clod.level_bytes(index),
            }
        };
        clod.levels.iter().enumerate().map(figures).collect()
    }
}

/// Median and maximum of some values; 0 for no values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Median; for an even number of values the mean of the middle two.
    pub median: f64,
    /// Maximum.
    pub max: f64,
}

impl Spread {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.collect();
        values.sort_unstable_by(f64::total_cmp);
        let Some(&max) = values.last() else { return Self { median: 0.0, max: 0.0 } };
        let middle = values.len() / 2;
        let median = if values.len().is_multiple_of(2) {
            0.5 * (values[middle - 1] + values[middle])
        } else {
            values[middle]
        };
        Self { median, max }
    }
}

#[cfg(test)]
mod tests {
    use palpate::clod_build::{BuildOptions, build, unwatched};

    use super::*;

    fn torus(simplify: bool) -> Clod {
        let mesh = Model::Torus.generate(4_000).expect("torus");
        let options = BuildOptions { simplify, ..BuildOptions::default() };
        build(&mesh, &options, &mut unwatched).expect("hierarchy")
    }

    #[test]
    fn the_columns_are_those_of_the_levels_they_name() {
        let clod = torus(true);
        let table = Table32::of(&clod);
        // For comparison, walk down from the root to the first level that is not free.
        let coarsest = clod.levels.iter().rposition(|level| !level.free).expect("level 0 is not free");
        assert!(coarsest > 1, "simplification made levels");
        assert_eq!(table.original_triangles, clod.levels[0].triangles);
        assert_eq!(table.original_patches as usize, clod.level(0).len());
        let triangles: usize = clod.level(coarsest).iter().map(|node| node.triangles.len()).sum();
        assert_eq!(table.simplified_triangles as usize, triangles);
        assert_eq!(table.simplified_patches as usize, clod.level(coarsest).len());
        assert!(table.finest_resolution.is_some_and(|finest| finest > table.coarsest_resolution));
        assert_eq!(table.coarsest_resolution, clod.levels[coarsest].resolution * clod.bounding_radius());
        assert_eq!(
            (table.free_levels + coarsest as u32 + 1, table.levels as usize),
            (table.levels, clod.levels.len())
        );
    }

    #[test]
    fn without_simplification_there_is_no_finest_simplified_level() {
        let table = Table32::of(&torus(false));
        assert_eq!(table.finest_resolution, None);
        assert_eq!(
            (table.simplified_triangles, table.free_levels),
            (table.original_triangles, table.levels - 1)
        );
    }

    #[test]
    fn memory_of_levels_adds_up_to_that_of_the_hierarchy() {
        let clod = torus(true);
        let bytes: usize = LevelFigures::of(&clod).iter().map(|level| level.bytes).sum();
        assert_eq!(bytes + size_of::<Clod>(), clod.total_bytes());
    }

    #[test]
    fn published_rows_are_of_models_of_the_same_size() {
        let published: Vec<Model> =
            Model::ALL.into_iter().filter(|model| Table32::published(*model).is_some()).collect();
        // Seven rows; that of the ball joint counts for both of its halves.
        assert_eq!(published.len(), 8);
        for model in published {
            let triangles = Table32::published(model).map(|row| row.original_triangles as usize);
            assert_eq!(triangles, Some(model.default_triangles()), "{}", model.name());
        }
    }

    #[test]
    fn spread_has_median_and_maximum() {
        let spread = |values: &[f64]| Spread::of(values.iter().copied());
        assert_eq!(spread(&[]), Spread { median: 0.0, max: 0.0 });
        assert_eq!(spread(&[3.0, 1.0, 2.0]), Spread { median: 2.0, max: 3.0 });
        assert_eq!(spread(&[4.0, 1.0, 2.0, 3.0]), Spread { median: 2.5, max: 4.0 });
    }
}
