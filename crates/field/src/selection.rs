//! Selected samples: those that may be in contact until the bodies have moved by a margin, each with the area that it stands for.

use glam::Vec3;
use palpate_core::Pose;
use wide::f32x4;

use crate::samples::{Sample, SurfaceSamples};
use crate::slack::{Change, REGIONS};

/// Samples of one body's surface, in the body's frame, m.
#[derive(Clone, Debug)]
pub struct Selection {
    points: [Vec<f32>; 3],
    /// As parts of a cell's squared edge.
    areas: Vec<f32>,
    /// How far within reach they were, in reaches.
    reaches: Vec<f32>,
    samples: Vec<Sample>,
    /// Fours of the regions that are near the other body.
    pub near: Vec<u32>,
}

impl Selection {
    pub fn new() -> Self {
        const USUAL: usize = 8192;
        Self {
            points: [0; 3].map(|_| Vec::with_capacity(USUAL)),
            areas: Vec::with_capacity(USUAL),
            reaches: Vec::with_capacity(USUAL),
            samples: Vec::with_capacity(USUAL),
            near: Vec::with_capacity(REGIONS),
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

    /// Four at a time. The last of the points are repeated so that they make up four.
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

    /// How far anything near the other body has moved since a pose at most, and at most how far anything has that was not near, m.
    pub fn moved(&self, samples: &SurfaceSamples, level: usize, change: &Change, tolerance: f64) -> [f64; 2] {
        if level == 0 {
            let [_, most] = change.largest(std::iter::empty(), tolerance);
            return [most; 2];
        }
        let spheres = &samples.levels[level].spheres;
        change.largest(self.near.iter().map(|four| &spheres[*four as usize]), tolerance)
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

/// Samples of both bodies' surfaces that were selected at one pose, and serve at all poses around it.
#[derive(Clone, Debug)]
pub struct Held {
    pub sides: [Selection; 2],
    /// The pose that they were selected at, probe to scene object; none where there are none.
    pub at: Option<Pose>,
    /// By how much one of the samples was nearer at most when they were read last, and by how much one was further away, m.
    pub changes: Option<[f64; 2]>,
}

impl Held {
    pub fn new() -> Self {
        Self { sides: [0; 2].map(|_| Selection::new()), at: None, changes: None }
    }

    /// Samples of both sides.
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
    /// How far within reach they were when they were selected, in reaches.
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
