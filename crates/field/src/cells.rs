//! Sums over the area of contact, a cell of the probe's surroundings and a direction at a time.

use glam::Vec3A;

/// No cell yet.
const NONE: u32 = u32::MAX;

/// A sample in contact, in the probe's frame from its centre, m.
#[derive(Clone, Copy, Debug)]
pub struct Touch {
    pub point: Vec3A,
    /// Out of the probe.
    pub normal: Vec3A,
    /// δ + d.
    pub reach: f32,
    /// m².
    pub area: f32,
    /// The cube of the probe's surroundings that the sample is in.
    pub cube: u32,
}

/// Sums over the area of contact in a cell, in the probe's frame from its centre, m.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    slot: u32,
    /// Σ a (δ + d).
    pub pressure: f32,
    /// Σ a (δ + d)², and the moment of it.
    pub weight: f32,
    pub moment: Vec3A,
    /// Σ a (δ + d)² **n**.
    pub push: Vec3A,
    /// The deepest sample.
    pub deepest: Touch,
}

/// The cells that hold contacts.
#[derive(Clone, Debug)]
pub struct Cells {
    /// By cube and direction.
    table: Vec<u32>,
    cells: Vec<Cell>,
    contacts: usize,
}

impl Cells {
    /// For so many cubes.
    pub fn new(cubes: usize) -> Self {
        Self { table: vec![NONE; 6 * cubes], cells: Vec::with_capacity(1024), contacts: 0 }
    }

    pub fn clear(&mut self) {
        for cell in self.cells.drain(..) {
            self.table[cell.slot as usize] = NONE;
        }
        self.contacts = 0;
    }

    /// Adds a part of a sample.
    #[inline]
    pub fn add(&mut self, touch: &Touch, share: f32) {
        self.contacts += 1;
        let size = touch.normal.abs();
        let axis = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let direction = 2 * axis as u32 + u32::from(touch.normal[axis] < 0.0);
        let slot = touch.cube * 6 + direction;
        let entry = &mut self.table[slot as usize];
        if *entry == NONE {
            *entry = self.cells.len() as u32;
            self.cells.push(Cell {
                slot,
                pressure: 0.0,
                weight: 0.0,
                moment: Vec3A::ZERO,
                push: Vec3A::ZERO,
                deepest: *touch,
            });
        }
        let cell = &mut self.cells[*entry as usize];
        let pressure = share * touch.area * touch.reach;
        cell.pressure += pressure;
        let weight = pressure * touch.reach;
        cell.weight += weight;
        cell.moment += weight * touch.point;
        cell.push += weight * touch.normal;
        if touch.reach > cell.deepest.reach {
            cell.deepest = *touch;
        }
    }

    /// Those that hold contacts.
    pub fn iter(&self) -> impl Iterator<Item = &Cell> {
        self.cells.iter()
    }

    /// Samples that were added.
    pub fn contacts(&self) -> usize {
        self.contacts
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.table.capacity() * size_of::<u32>() + self.cells.capacity() * size_of::<Cell>()
    }
}
