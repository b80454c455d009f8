//! A uniform grid, hashed: each triangle stands in all of the cells that its box meets.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use glam::{DVec3, IVec3};

use crate::Index;
use crate::box_tree::{Bounds, EMPTY, meet};

/// Multiplies and rotates, which is enough for cells.
#[derive(Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for b in bytes {
            self.write_i32(i32::from(*b));
        }
    }

    fn write_i32(&mut self, x: i32) {
        self.0 = (self.0.rotate_left(5) ^ u64::from(x as u32)).wrapping_mul(0x517c_c1b7_2722_0a95);
    }
}

/// With `AGAIN`, it is made anew with larger cells whenever half of the triangles are gone.
pub struct Grid<const AGAIN: bool> {
    boxes: Vec<Bounds>,
    cells: HashMap<IVec3, Vec<u32>, BuildHasherDefault<CellHasher>>,
    /// Cells are this to the power of -1.
    fineness: f64,
    /// The last query that each triangle was found by.
    seen: Vec<u32>,
    queries: u32,
}

impl<const AGAIN: bool> Grid<AGAIN> {
    fn range(fineness: f64, bounds: Bounds) -> impl Iterator<Item = IVec3> {
        let cell = |p: DVec3| (p * fineness).floor().as_ivec3();
        let (low, high) =
            if bounds == EMPTY { (IVec3::ONE, IVec3::ZERO) } else { (cell(bounds.0), cell(bounds.1)) };
        (low.x..=high.x).flat_map(move |x| {
            (low.y..=high.y).flat_map(move |y| (low.z..=high.z).map(move |z| IVec3::new(x, y, z)))
        })
    }

    fn insert(&mut self, triangle: u32) {
        for cell in Self::range(self.fineness, self.boxes[triangle as usize]) {
            self.cells.entry(cell).or_default().push(triangle);
        }
    }

    fn take_out(&mut self, triangle: u32) {
        for cell in Self::range(self.fineness, self.boxes[triangle as usize]) {
            if let Some(here) = self.cells.get_mut(&cell) {
                here.retain(|t| *t != triangle);
            }
        }
    }
}

impl<const AGAIN: bool> Index for Grid<AGAIN> {
    fn new(boxes: &[Bounds]) -> Self {
        let live = || boxes.iter().filter(|b| **b != EMPTY);
        // The longest side of a triangle's box is about the length of an edge.
        let edge =
            live().map(|(low, high)| (*high - *low).max_element()).sum::<f64>() / live().count() as f64;
        let mut grid = Self {
            boxes: boxes.to_vec(),
            cells: HashMap::default(),
            fineness: edge.recip(),
            seen: vec![0; boxes.len()],
            queries: 0,
        };
        for t in 0..boxes.len() as u32 {
            grid.insert(t);
        }
        grid
    }

    fn count(&mut self, query: Bounds) -> usize {
        self.queries += 1;
        let mut count = 0;
        for cell in Self::range(self.fineness, query) {
            for &t in self.cells.get(&cell).into_iter().flatten() {
                if std::mem::replace(&mut self.seen[t as usize], self.queries) != self.queries {
                    count += usize::from(meet(self.boxes[t as usize], query));
                }
            }
        }
        count
    }

    fn moved(&mut self, triangle: u32, bounds: Bounds) {
        self.take_out(triangle);
        self.boxes[triangle as usize] = bounds;
        self.insert(triangle);
    }

    fn removed(&mut self, triangle: u32) {
        self.take_out(triangle);
        self.boxes[triangle as usize] = EMPTY;
    }

    fn halved(&mut self) {
        if AGAIN {
            *self = Self::new(&self.boxes);
        }
    }
}
