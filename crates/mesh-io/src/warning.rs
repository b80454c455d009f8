//! Warnings about a mesh that a loader accepted.

use std::fmt;
use std::ops::RangeInclusive;

use palpate_core::TriMesh;

use crate::{LoadOptions, RepairEffect, RepairSummary, openings};

/// Bounding radii (m) for which the file's unit is not doubted: from the smallest screw to a room.
const PLAUSIBLE_RADIUS: RangeInclusive<f64> = 5e-4..=5.0;

/// Bounding radii (m) of most objects that a hand can hold.
const HANDHELD_RADIUS: RangeInclusive<f64> = 5e-3..=1.0;

/// Scales that may be suggested, in metres per unit of the file, in the order in which they are tried: metre,
/// millimetre, micrometre, centimetre. An inch is not needed: where it makes a mesh plausible, one of these
/// does too.
const CANDIDATE_SCALES: [f64; 4] = [1.0, 1e-3, 1e-6, 1e-2];

/// A warning about a loaded mesh: content that was left out, a repair, a doubtful unit.
///
/// [`Display`](fmt::Display) gives one line, in the terms of this crate's [`LoadOptions`].
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum LoadWarning {
    /// The size of the mesh suggests that the file is in another unit: its bounding radius is below 0.5 mm or
    /// above 5 m.
    Units {
        /// Bounding radius as loaded, m.
        radius: f64,
        /// The [`LoadOptions::scale`] with which the mesh would have a bounding radius of 5 mm to 1 m, else
        /// one of 0.5 mm to 5 m: the first that fits of metres, millimetres, micrometres and centimetres.
        /// `None` if none fits.
        suggested: Option<f64>,
    },
    /// All vertices are at the same position.
    SinglePoint,
    /// The mesh was repaired, as [`LoadOptions::repair`] asked for.
    Repaired {
        /// The changes.
        changes: RepairSummary,
        /// What they did to the surface.
        effect: RepairEffect,
    },
    /// Repair could not unite parts that intersect, and dropped surface that could be touched: things may
    /// fall in.
    LostSurface {
        /// Area lost, m².
        area: f64,
        /// Area before, m², hidden surfaces included.
        of: f64,
    },
    /// The surface has openings, so that it does not hold out what fits through them.
    Open {
        /// Number of closed lines of edges at which the surface ends.
        openings: usize,
        /// Largest extent of an opening, m.
        largest: f64,
    },
    /// Line elements were skipped: they are not part of the surface.
    Lines {
        /// Number of line elements skipped.
        count: usize,
    },
    /// Point elements were skipped: they are not part of the surface.
    Points {
        /// Number of point elements skipped.
        count: usize,
    },
    /// Free-form curves and surfaces were skipped.
    FreeForm {
        /// Number of curves and surfaces skipped.
        count: usize,
    },
    /// Faces of fewer than three corners were skipped.
    IncompleteFaces {
        /// Number of faces skipped.
        count: usize,
        /// Place of the first one: `line 7` or `face 7`.
        first: String,
    },
    /// Polygons of fewer than three different corners were skipped.
    CollapsedPolygons {
        /// Number of polygons skipped.
        count: usize,
    },
    /// Polygons that cross or touch themselves, or have no area, were cut into fans.
    FannedPolygons {
        /// Number of such polygons.
        count: usize,
    },
    /// Corners after the last whole triangle of a glTF primitive were ignored.
    LeftoverCorners {
        /// Number of primitives with such corners.
        primitives: usize,
    },
    /// Bytes after the last triangle of a binary STL file were ignored.
    TrailingBytes {
        /// Number of bytes ignored.
        count: u64,
    },
    /// Skins and morph targets of a glTF file were ignored: the mesh has its rest shape.
    AtRest,
    /// A glTF file has no scene: each mesh was loaded once, without a placement.
    NoScene,
    /// An extension of a glTF file was ignored.
    IgnoredExtension {
        /// The extension's name.
        name: &'static str,
        /// Consequence for the mesh.
        effect: &'static str,
    },
}

impl fmt::Display for LoadWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Units { radius, suggested: Some(scale) } => write!(
                f,
                "the bounding radius of {radius:.3e} m suggests a wrong unit: try a scale of {scale}"
            ),
            Self::Units { radius, suggested: None } => write!(
                f,
                "the bounding radius of {radius:.3e} m suggests a wrong unit: set the scale to the metres per unit \
                 of the file"
            ),
            Self::SinglePoint => f.write_str("all vertices are at the same point"),
            Self::Repaired { changes, effect: e } => write!(
                f,
                "repaired: {changes}; volume {:.5e} m³ before and {:.5e} m³ after, area {:.5e} m² before and {:.5e} m² \
                 after",
                e.volume_before, e.volume_after, e.area_before, e.area_after
            ),
            Self::LostSurface { area, of } => write!(
                f,
                "repair dropped {area:.3e} m² of {of:.3e} m² of surface where parts intersect: things may fall in there"
            ),
            Self::Open { openings, largest } => write!(
                f,
                "the surface is open ({openings} openings, the largest {largest:.3e} m across): it has no inside, and \
                 things may pass through"
            ),
            Self::Lines { count } => {
                write!(f, "line elements skipped, which are not part of the surface: {count}")
            }
            Self::Points { count } => {
                write!(f, "point elements skipped, which are not part of the surface: {count}")
            }
            Self::FreeForm { count } => {
                write!(f, "free-form curves or surfaces skipped (convert them to polygons): {count}")
            }
            Self::IncompleteFaces { count, first } => {
                write!(f, "faces of fewer than three corners skipped, the first at {first}: {count}")
            }
            Self::CollapsedPolygons { count } => {
                write!(f, "polygons of fewer than three different corners skipped: {count}")
            }
            Self::FannedPolygons { count } => write!(
                f,
                "polygons that cross or touch themselves or have no area cut into fans (check the result): {count}"
            ),
            Self::LeftoverCorners { primitives } => write!(
                f,
                "primitives with corners left over after the last triangle, which are ignored: {primitives}"
            ),
            Self::TrailingBytes { count } => write!(f, "{count} bytes after the last triangle ignored"),
            Self::AtRest => f.write_str("skins and morph targets ignored: the mesh has its rest shape"),
            Self::NoScene => {
                f.write_str("the file has no scene: each mesh is loaded once, where it was modelled")
            }
            Self::IgnoredExtension { name, effect } => write!(f, "{name} ignored: {effect}"),
        }
    }
}

impl LoadWarning {
    /// Warning about the openings of a surface, `None` if it is closed.
    pub fn of_openings(mesh: &TriMesh) -> Option<Self> {
        let found = openings(mesh);
        (found.count > 0).then_some(Self::Open { openings: found.count, largest: found.largest })
    }

    /// Warning about the size of a mesh with this bounding radius (m), `None` if it is plausible. The
    /// suggested scale is a factor on the radius, as for a file that was loaded with a scale of 1.
    pub fn of_size(radius: f64) -> Option<Self> {
        Self::of_loaded_size(radius, &LoadOptions::default())
    }

    /// Warning about the size of a mesh with this bounding radius (m), loaded with `options`; `None` if it is
    /// plausible.
    pub(crate) fn of_loaded_size(radius: f64, options: &LoadOptions) -> Option<Self> {
        if radius == 0.0 {
            return Some(Self::SinglePoint);
        }
        if PLAUSIBLE_RADIUS.contains(&radius) {
            return None;
        }
        let in_file = radius / options.scale;
        let suggested = [HANDHELD_RADIUS, PLAUSIBLE_RADIUS].iter().find_map(|plausible| {
            CANDIDATE_SCALES.into_iter().find(|scale| plausible.contains(&(in_file * scale)))
        });
        Some(Self::Units { radius, suggested })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn units(radius: f64, scale: f64) -> Option<Option<f64>> {
        let options = LoadOptions { scale, ..LoadOptions::default() };
        LoadWarning::of_loaded_size(radius, &options).map(|warning| match warning {
            LoadWarning::Units { radius: reported, suggested } => {
                assert_eq!(reported, radius);
                suggested
            }
            other => panic!("{other:?}"),
        })
    }

    #[test]
    fn a_radius_gives_the_unit_that_makes_it_plausible() {
        for (radius, expected) in [
            // A mandible in millimetres and in micrometres.
            (77.7, Some(Some(1e-3))),
            (77_700.0, Some(Some(1e-6))),
            (0.05, None),
            (PLAUSIBLE_RADIUS.start().next_down(), Some(None)),
            (*PLAUSIBLE_RADIUS.start(), None),
            (*PLAUSIBLE_RADIUS.end(), None),
            (PLAUSIBLE_RADIUS.end().next_up(), Some(Some(1e-3))),
            // Too large for a hand in every unit, but a piece of furniture in millimetres.
            (2000.0, Some(Some(1e-3))),
            (1e-9, Some(None)),
            (1e12, Some(None)),
            (f64::INFINITY, Some(None)),
        ] {
            assert_eq!(units(radius, 1.0), expected, "{radius}");
        }
    }

    #[test]
    fn the_suggestion_replaces_the_scale_that_was_given() {
        // Files in metres, centimetres and millimetres, each loaded with the wrong scale.
        assert_eq!(units(0.077 * 1e-3, 1e-3), Some(Some(1.0)));
        assert_eq!(units(2.5 * 1e-6, 1e-6), Some(Some(1e-2)));
        assert_eq!(units(77.0 * 1e-6, 1e-6), Some(Some(1e-3)));
        assert_eq!(LoadWarning::of_size(0.0), Some(LoadWarning::SinglePoint));
    }

    /// Wherever inches would make a mesh plausible, one of the candidate scales does too.
    #[test]
    fn inches_are_not_needed() {
        for exponent in -600..=600 {
            let radius = 10.0_f64.powf(f64::from(exponent) / 100.0);
            let inches = PLAUSIBLE_RADIUS.contains(&(radius * 0.0254));
            assert!(!inches || units(radius, 1.0) != Some(None), "{radius}");
        }
    }
}
