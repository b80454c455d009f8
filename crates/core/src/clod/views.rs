//! Views of the arrays of a packed hierarchy.

use std::iter::FusedIterator;
use std::ops::{Index, Range};

use glam::DVec3;

use super::{Clod, Node};

/// A range of a hierarchy's nodes.
#[derive(Clone, Debug)]
pub struct Nodes<'a> {
    pub(super) clod: &'a Clod,
    pub(super) range: Range<u32>,
}

impl<'a> Nodes<'a> {
    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.range.len()
    }

    /// Whether the view is empty.
    pub fn is_empty(&self) -> bool {
        self.range.is_empty()
    }

    /// The nodes, in their order.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = Node> + ExactSizeIterator + Clone + use<'a> {
        let clod = self.clod;
        self.range.clone().map(|index| clod.node(index))
    }

    /// The first node.
    pub fn first(&self) -> Option<Node> {
        self.iter().next()
    }
}

impl Iterator for Nodes<'_> {
    type Item = Node;

    fn next(&mut self) -> Option<Node> {
        self.range.next().map(|index| self.clod.node(index))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.range.size_hint()
    }
}

impl ExactSizeIterator for Nodes<'_> {}

impl FusedIterator for Nodes<'_> {}

/// Points of a hull, m.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a> {
    all: &'a [DVec3],
    indices: &'a [u32],
}

impl<'a> Points<'a> {
    pub(super) fn new(all: &'a [DVec3], indices: &'a [u32]) -> Self {
        Self { all, indices }
    }

    /// Number of points.
    #[inline]
    pub fn len(&self) -> usize {
        self.indices.len()
    }

    /// Whether the view is empty.
    pub fn is_empty(&self) -> bool {
        self.indices.is_empty()
    }

    /// The points, in their order.
    #[inline]
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &'a DVec3> + ExactSizeIterator + Clone + use<'a> {
        let all = self.all;
        self.indices.iter().map(move |index| &all[*index as usize])
    }

    /// The first `count` points.
    ///
    /// # Panics
    /// If there are fewer.
    #[inline]
    #[must_use]
    pub fn first(&self, count: usize) -> Self {
        Self { all: self.all, indices: &self.indices[..count] }
    }

    /// A copy of the points, m.
    pub fn to_vec(&self) -> Vec<DVec3> {
        self.iter().copied().collect()
    }
}

impl Index<usize> for Points<'_> {
    type Output = DVec3;

    #[inline]
    fn index(&self, index: usize) -> &DVec3 {
        &self.all[self.indices[index] as usize]
    }
}

impl<'a> IntoIterator for Points<'a> {
    type Item = &'a DVec3;
    type IntoIter = PointsIter<'a>;

    fn into_iter(self) -> PointsIter<'a> {
        PointsIter { all: self.all, indices: self.indices.iter() }
    }
}

/// An iterator over the points of a hull.
#[derive(Clone, Debug)]
pub struct PointsIter<'a> {
    all: &'a [DVec3],
    indices: std::slice::Iter<'a, u32>,
}

impl<'a> Iterator for PointsIter<'a> {
    type Item = &'a DVec3;

    fn next(&mut self) -> Option<&'a DVec3> {
        self.indices.next().map(|index| &self.all[*index as usize])
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.indices.size_hint()
    }
}

impl ExactSizeIterator for PointsIter<'_> {}

/// D, the support areas of points of a hull, m².
#[derive(Clone, Copy, Debug)]
pub struct Areas<'a> {
    all: &'a [f64],
    indices: &'a [u32],
}

impl<'a> Areas<'a> {
    pub(super) fn new(all: &'a [f64], indices: &'a [u32]) -> Self {
        Self { all, indices }
    }

    /// Number of areas.
    pub fn len(&self) -> usize {
        self.indices.len()
    }

    /// Whether the view is empty.
    pub fn is_empty(&self) -> bool {
        self.indices.is_empty()
    }

    /// The areas, in the points' order.
    #[inline]
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = f64> + ExactSizeIterator + Clone + use<'a> {
        let all = self.all;
        self.indices.iter().map(move |index| all[*index as usize])
    }
}

impl Index<usize> for Areas<'_> {
    type Output = f64;

    #[inline]
    fn index(&self, index: usize) -> &f64 {
        &self.all[self.indices[index] as usize]
    }
}

/// Triangles of a patch, as indices into the hull vertices of its node.
#[derive(Clone, Copy, Debug)]
pub struct Triangles<'a>(pub(super) Corners<'a>);

/// Corners in as few bytes as the largest hull allows.
#[derive(Clone, Copy, Debug)]
pub(super) enum Corners<'a> {
    Bytes(&'a [[u8; 3]]),
    Shorts(&'a [[u16; 3]]),
    Words(&'a [[u32; 3]]),
}

impl<'a> Triangles<'a> {
    /// A view of triangles that are not in a hierarchy.
    pub fn of(triangles: &'a [[u32; 3]]) -> Self {
        Self(Corners::Words(triangles))
    }

    /// Number of triangles.
    #[inline]
    pub fn len(&self) -> usize {
        match self.0 {
            Corners::Bytes(all) => all.len(),
            Corners::Shorts(all) => all.len(),
            Corners::Words(all) => all.len(),
        }
    }

    /// Whether the view is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The triangle at an index.
    ///
    /// # Panics
    /// If the index is out of range.
    #[inline]
    pub fn at(&self, index: usize) -> [u32; 3] {
        match self.0 {
            // Written out, since the compiler does not inline a map here.
            Corners::Bytes(all) => {
                let [i, j, k] = all[index];
                [u32::from(i), u32::from(j), u32::from(k)]
            }
            Corners::Shorts(all) => {
                let [i, j, k] = all[index];
                [u32::from(i), u32::from(j), u32::from(k)]
            }
            Corners::Words(all) => all[index],
        }
    }

    /// Whether any triangle fulfils a condition.
    #[inline]
    pub fn any(&self, mut condition: impl FnMut([u32; 3]) -> bool) -> bool {
        match self.0 {
            Corners::Bytes(all) => {
                all.iter().any(|&[i, j, k]| condition([u32::from(i), u32::from(j), u32::from(k)]))
            }
            Corners::Shorts(all) => {
                all.iter().any(|&[i, j, k]| condition([u32::from(i), u32::from(j), u32::from(k)]))
            }
            Corners::Words(all) => all.iter().any(|corners| condition(*corners)),
        }
    }

    /// The triangles, in their order.
    #[inline]
    pub fn iter(&self) -> TrianglesIter<'a> {
        TrianglesIter { triangles: *self, range: 0..self.len() }
    }
}

impl<'a> IntoIterator for Triangles<'a> {
    type Item = [u32; 3];
    type IntoIter = TrianglesIter<'a>;

    fn into_iter(self) -> TrianglesIter<'a> {
        self.iter()
    }
}

/// An iterator over the triangles of a patch.
#[derive(Clone, Debug)]
pub struct TrianglesIter<'a> {
    triangles: Triangles<'a>,
    range: Range<usize>,
}

impl Iterator for TrianglesIter<'_> {
    type Item = [u32; 3];

    #[inline]
    fn next(&mut self) -> Option<[u32; 3]> {
        self.range.next().map(|index| self.triangles.at(index))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.range.size_hint()
    }
}

impl ExactSizeIterator for TrianglesIter<'_> {}
