//! Sums over the area of contact, a cell of the probe's surroundings and a direction at a time.

use glam::Vec3A;

use crate::samples::Sample;

/// No cell yet.
const NONE: u32 = u32::MAX;

/// A sample in contact, in the probe's frame from its centre, m.
#[derive(Clone, Copy, Debug)]
pub struct ContactSample {
    pub point: Vec3A,
    /// Out of the probe.
    pub normal: Vec3A,
    /// δ + d, in tolerances.
    pub reach: f32,
    /// What it stands for, as a part of a cell's squared edge: in these units nothing is too small for single precision.
    pub area: f32,
    /// The cube of the probe's surroundings that the sample is in.
    pub cube: u32,
    /// Whether it is on the probe's surface, or on the scene object's.
    pub is_probe: bool,
    /// Which it is.
    pub sample: Sample,
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
    /// Σ a (δ + d)³, and Σ a² (δ + d)² over the samples, for the part that each counts for.
    pub cubes: f32,
    pub squares: f32,
    /// The deepest sample.
    pub deepest: ContactSample,
}

impl Cell {
    /// How far off the mean of δ + d is by which the cell pushes, in tolerances: the standard error of samples that are anywhere.
    /// Those that are in equal parts of the surface, each anywhere in its part, are about twice as near the mean.
    pub fn error(&self) -> f32 {
        let mean = self.weight / self.pressure;
        let count = self.pressure * self.pressure / self.squares;
        // Few samples may be alike by chance, and one always is: as if there were another, half of the mean off.
        let unseen = 0.25 * mean * mean / count;
        let variance = (self.cubes / self.pressure - mean * mean).max(0.0) + unseen;
        (variance / count).sqrt()
    }

    /// Whether a sample of the cell is inside the other body, so that it is among the deepest of the parts of cubes.
    pub fn penetrates(&self) -> bool {
        self.deepest.reach > 1.0
    }

    /// Joins another cell with this one.
    fn join(&mut self, other: &Self) {
        self.pressure += other.pressure;
        self.weight += other.weight;
        self.moment += other.moment;
        self.push += other.push;
        self.cubes += other.cubes;
        self.squares += other.squares;
        if other.deepest.reach > self.deepest.reach {
            self.deepest = other.deepest;
        }
    }
}

/// Parts of a cube's edge; each part of a cube has a deepest place of its own.
const PARTS: u32 = 4;

/// The cells that hold contacts.
#[derive(Clone, Debug)]
pub struct Cells {
    /// By cube and direction.
    table: Vec<u32>,
    cells: Vec<Cell>,
    contacts: usize,
    /// Cubes along each axis, and parts of cubes in a unit of length (1/m).
    across: u32,
    per_unit: f32,
    /// By part.
    parts: Vec<u32>,
    /// The deepest sample of each part in which bodies penetrate, with the part.
    deepest: Vec<(u32, ContactSample)>,
}

impl Cells {
    /// For so many cubes along each axis, of an edge (m).
    pub fn new(across: u32, edge: f64) -> Self {
        let cubes = across.pow(3) as usize;
        Self {
            table: vec![NONE; 6 * cubes],
            cells: Vec::with_capacity(1024),
            contacts: 0,
            across,
            per_unit: (f64::from(PARTS) / edge) as f32,
            parts: vec![NONE; cubes * PARTS.pow(3) as usize],
            deepest: Vec::with_capacity(4096),
        }
    }

    pub fn clear(&mut self) {
        for cell in self.cells.drain(..) {
            self.table[cell.slot as usize] = NONE;
        }
        for (part, _) in self.deepest.drain(..) {
            self.parts[part as usize] = NONE;
        }
        self.contacts = 0;
    }

    /// Adds a sample where the bodies penetrate to those that may be the deepest of their part.
    fn penetrate(&mut self, touch: &ContactSample) {
        let across = PARTS * self.across;
        // From the centre of the probe, which is at a corner of cubes.
        let at = (touch.point * self.per_unit + (across / 2) as f32).to_array();
        // Casts saturate.
        let [x, y, z] = at.map(|at| (at as u32).min(across - 1));
        let part = (z * across + y) * across + x;
        let entry = &mut self.parts[part as usize];
        match self.deepest.get_mut(*entry as usize) {
            Some((_, deepest)) if touch.reach > deepest.reach => *deepest = *touch,
            Some(_) => {}
            None => {
                *entry = self.deepest.len() as u32;
                self.deepest.push((part, *touch));
            }
        }
    }

    /// Adds a sample, which counts for a part (0 to 1).
    #[inline]
    pub fn add(&mut self, touch: &ContactSample, part: f32) {
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
                cubes: 0.0,
                squares: 0.0,
                deepest: *touch,
            });
        }
        let cell = &mut self.cells[*entry as usize];
        let whole = touch.area * touch.reach;
        let pressure = part * whole;
        cell.pressure += pressure;
        let weight = pressure * touch.reach;
        cell.weight += weight;
        cell.moment += weight * touch.point;
        cell.push += weight * touch.normal;
        cell.cubes += weight * touch.reach;
        // The mean of two results is no further off than they are on average.
        cell.squares += pressure * whole;
        if touch.reach > cell.deepest.reach {
            cell.deepest = *touch;
        }
        if touch.reach > 1.0 {
            self.penetrate(touch);
        }
    }

    /// The deepest samples of the parts of cubes in which bodies penetrate.
    pub fn deepest(&self) -> impl Iterator<Item = &ContactSample> {
        self.deepest.iter().map(|(_, touch)| touch)
    }

    /// Leaves the deepest so many of the deepest samples of parts; these, with those deeper than all others first.
    pub fn keep_deepest(&mut self, most: usize, first: usize) -> impl Iterator<Item = &mut ContactSample> {
        let order = |a: &(u32, ContactSample), b: &(u32, ContactSample)| {
            b.1.reach.total_cmp(&a.1.reach).then_with(|| a.0.cmp(&b.0))
        };
        if most < self.deepest.len() {
            self.deepest.select_nth_unstable_by(most, order);
            for (part, _) in self.deepest.drain(most..) {
                self.parts[part as usize] = NONE;
            }
        }
        if first < self.deepest.len() {
            self.deepest.select_nth_unstable_by(first, order);
        }
        self.deepest.iter_mut().map(|(_, touch)| touch)
    }

    /// Joins cells of neighbouring cubes with the same direction until there are no more than some, or one a direction; `across` is the
    /// number of cubes along each axis.
    pub fn bound(&mut self, most: usize, across: u32) {
        let mut edge = 1;
        while self.cells.len() > most && edge < across {
            edge *= 2;
            let large = across.div_ceil(edge);
            for cell in &self.cells {
                self.table[cell.slot as usize] = NONE;
            }
            let mut kept = 0;
            for index in 0..self.cells.len() {
                let cell = self.cells[index];
                // Slots of cubes that have been joined are those of larger cubes, twice as large each time.
                let across = across.div_ceil(edge / 2);
                let (cube, direction) = (cell.slot / 6, cell.slot % 6);
                let [x, y, z] =
                    [cube % across, cube / across % across, cube / (across * across)].map(|i| i / 2);
                let slot = ((z * large + y) * large + x) * 6 + direction;
                let entry = &mut self.table[slot as usize];
                if (*entry as usize) < kept && self.cells[*entry as usize].slot == slot {
                    self.cells[*entry as usize].join(&cell);
                } else {
                    *entry = kept as u32;
                    self.cells[kept] = Cell { slot, ..cell };
                    kept += 1;
                }
            }
            self.cells.truncate(kept);
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
        (self.table.capacity() + self.parts.capacity()) * size_of::<u32>()
            + self.cells.capacity() * size_of::<Cell>()
            + self.deepest.capacity() * size_of::<(u32, ContactSample)>()
    }
}
