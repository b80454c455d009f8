//! Selected samples: those that may be in contact until the bodies have moved by a margin, each with the area
//! that it represents.

use glam::Vec3;
use palpate_core::Pose;
use wide::f32x4;

use crate::samples::{Sample, SurfaceSamples};
use crate::slack::Change;

/// Samples of one body's surface, about the centre of its samples, m.
#[derive(Clone, Debug)]
pub struct Selection {
    points: [Vec<f32>; 3],
    /// Areas, as fractions of a cell's squared edge.
    areas: Vec<f32>,
    /// Distances inside the limit of reach at selection, in reaches.
    reaches: Vec<f32>,
    samples: Vec<Sample>,
    /// Fours of the regions that are near the other body.
    pub near: Vec<u32>,
}

impl Selection {
    pub fn new() -> Self {
        Self {
            points: [const { Vec::new() }; 3],
            areas: Vec::new(),
            reaches: Vec::new(),
            samples: Vec::new(),
            near: Vec::new(),
        }
    }

    pub fn clear(&mut self) {
        self.points.iter_mut().for_each(Vec::clear);
        self.areas.clear();
        self.reaches.clear();
        self.samples.clear();
        self.near.clear();
    }

    pub fn push(&mut self, point: Vec3, area: f32, reach: f32, sample: Sample) {
        self.points.iter_mut().zip(point.to_array()).for_each(|(axis, x)| axis.push(x));
        self.areas.push(area);
        self.reaches.push(reach);
        self.samples.push(sample);
    }

    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// The samples four at a time. The last point is repeated to fill up the last four.
    pub fn fours(&self) -> impl Iterator<Item = SelectedFour<'_>> {
        let [x, y, z] = self.points.each_ref().map(|axis| axis.chunks(4).map(filled));
        let which = self.areas.chunks(4).zip(self.reaches.chunks(4).map(filled)).zip(self.samples.chunks(4));
        x.zip(y).zip(z).zip(which).map(|(((x, y), z), ((areas, reaches), samples))| SelectedFour {
            points: [x, y, z],
            areas,
            reaches,
            samples,
        })
    }

    /// Largest motion, m, of any point that was near the other body at selection, and of any other point.
    pub fn moved(&self, samples: &SurfaceSamples, level: usize, change: &Change, tolerance: f64) -> [f64; 2] {
        let center = samples.center();
        if level == 0 {
            let [_, most] = change.largest(center, std::iter::empty(), tolerance);
            return [most; 2];
        }
        let spheres = &samples.levels[level].spheres;
        change.largest(center, self.near.iter().map(|four| &spheres[*four as usize]), tolerance)
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        let numbers =
            self.points.iter().chain([&self.areas, &self.reaches]).map(Vec::capacity).sum::<usize>();
        numbers * size_of::<f32>()
            + self.samples.capacity() * size_of::<Sample>()
            + self.near.capacity() * size_of::<u32>()
    }
}

/// Samples of both bodies' surfaces that were selected at one pose and hold at all poses around it.
#[derive(Clone, Debug)]
pub struct Held {
    pub sides: [Selection; 2],
    /// The pose of selection, probe to scene object; `None` if there is no selection.
    pub at: Option<Pose>,
    /// Whether all samples needed were selected; false if a limit ended the selection.
    pub is_complete: bool,
    /// Largest approach and largest recession of a sample since selection, at the last reading, m.
    pub changes: Option<[f64; 2]>,
}

impl Held {
    pub fn new() -> Self {
        Self { sides: [0; 2].map(|_| Selection::new()), at: None, is_complete: true, changes: None }
    }

    /// Number of samples of both sides.
    pub fn len(&self) -> usize {
        self.sides.iter().map(Selection::len).sum()
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.sides.iter().map(Selection::bytes).sum()
    }
}

/// Four samples of a selection, or fewer at its end.
pub struct SelectedFour<'a> {
    pub points: [f32x4; 3],
    pub areas: &'a [f32],
    /// Distances inside the limit of reach at selection, in reaches.
    pub reaches: f32x4,
    pub samples: &'a [Sample],
}

/// Up to four numbers, the last repeated.
#[inline]
fn filled(numbers: &[f32]) -> f32x4 {
    match numbers.as_array() {
        Some(four) => f32x4::new(*four),
        None => f32x4::new([0, 1, 2, 3].map(|lane| numbers[lane.min(numbers.len() - 1)])),
    }
}
