//! Sums over the area of contact, by cell: a cube of the probe's surroundings and a direction.

use glam::Vec3A;

use crate::samples::Sample;
use crate::sparse::Index;

/// A sample in contact, in the probe's frame from its centre, m.
#[derive(Clone, Copy, Debug)]
pub struct ContactSample {
    pub point: Vec3A,
    /// Unit normal out of the probe.
    pub normal: Vec3A,
    /// δ + d, in tolerances.
    pub reach: f32,
    /// Area that it represents, as a fraction of a cell's squared edge: in these units no area is too small
    /// for single precision.
    pub area: f32,
    /// The cube of the probe's surroundings that the sample is in.
    pub cube: u32,
    /// Whether it is on the probe's surface, or on the scene object's.
    pub is_probe: bool,
    /// The sample of that surface.
    pub sample: Sample,
}

/// Sums over the area of contact in a cell, in the probe's frame from its centre, m.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    slot: u32,
    /// Σ a (δ + d).
    pub pressure: f32,
    /// Σ a (δ + d)², and its first moment, Σ a (δ + d)² **x**.
    pub weight: f32,
    pub moment: Vec3A,
    /// Σ a (δ + d)² **n**.
    pub push: Vec3A,
    /// Σ a (δ + d)³, and Σ a² (δ + d)² over the samples, each times its weight.
    pub cubes: f32,
    pub squares: f32,
    /// The deepest sample.
    pub deepest: ContactSample,
}

impl Cell {
    /// Standard error of the mean of δ + d by which the cell pushes, in tolerances, for independent samples.
    /// Stratified samples have about half of it.
    pub fn error(&self) -> f32 {
        let mean = self.weight / self.pressure;
        let count = self.pressure * self.pressure / self.squares;
        // Few samples may be equal by chance, and a single one has no variance: as if there were another, off
        // by half of the mean.
        let unseen = 0.25 * mean * mean / count;
        let variance = (self.cubes / self.pressure - mean * mean).max(0.0) + unseen;
        (variance / count).sqrt()
    }

    /// Whether a sample of the cell is inside the other body, and so among the candidates for the deepest of
    /// a part of a cube.
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

/// δ + d, in tolerances, beyond which samples are candidates for the deepest. With more, what is inside only
/// between samples is missed; with less, there are more candidates.
const NEARLY_INSIDE: f32 = 0.6;

/// Number of parts of a cube's edge; the deepest sample of each part of a cube is kept.
const PARTS: u32 = 6;

/// The cells that hold contacts.
#[derive(Clone, Debug)]
pub struct Cells {
    /// Places in `cells`, by cube and direction.
    slots: Index,
    cells: Vec<Cell>,
    contacts: usize,
    /// Cubes along each axis, and parts of cubes in a unit of length (1/m).
    across: u32,
    per_unit: f32,
    /// Places in `deepest`, by part.
    parts: Index,
    /// The deepest sample of each part in which bodies penetrate, or nearly, with the part.
    deepest: Vec<(u32, ContactSample)>,
}

impl Cells {
    /// No cells, for `across` cubes along each axis, with an edge (m).
    pub fn new(across: u32, edge: f64) -> Self {
        Self {
            slots: Index::default(),
            cells: Vec::new(),
            contacts: 0,
            across,
            per_unit: (f64::from(PARTS) / edge) as f32,
            parts: Index::default(),
            deepest: Vec::new(),
        }
    }

    pub fn clear(&mut self) {
        self.slots.clear();
        self.cells.clear();
        self.parts.clear();
        self.deepest.clear();
        self.contacts = 0;
    }

    /// Adds a sample to the candidates for the deepest of its part.
    fn propose(&mut self, touch: &ContactSample) {
        let across = PARTS * self.across;
        // Relative to the centre of the probe, which is at a corner of cubes.
        let at = (touch.point * self.per_unit + (across / 2) as f32).to_array();
        // Casts saturate.
        let [x, y, z] = at.map(|at| (at as u32).min(across - 1));
        let part = (z * across + y) * across + x;
        let place = self.parts.get_or_insert(part, self.deepest.len());
        match self.deepest.get_mut(place) {
            Some((_, deepest)) if touch.reach > deepest.reach => *deepest = *touch,
            Some(_) => {}
            None => self.deepest.push((part, *touch)),
        }
    }

    /// Adds a sample with a weight `part` (0 to 1).
    #[inline]
    pub fn add(&mut self, touch: &ContactSample, part: f32) {
        self.contacts += 1;
        // The direction is the signed axis with the largest component of the normal.
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
        let place = self.slots.get_or_insert(slot, self.cells.len());
        if place == self.cells.len() {
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
        let cell = &mut self.cells[place];
        let whole = touch.area * touch.reach;
        let pressure = part * whole;
        cell.pressure += pressure;
        let weight = pressure * touch.reach;
        cell.weight += weight;
        cell.moment += weight * touch.point;
        cell.push += weight * touch.normal;
        cell.cubes += weight * touch.reach;
        // Weighted with `part` rather than its square: the mean of two selections is at least as accurate as
        // they are on average.
        cell.squares += pressure * whole;
        if touch.reach > cell.deepest.reach {
            cell.deepest = *touch;
        }
        if touch.reach > NEARLY_INSIDE {
            self.propose(touch);
        }
    }

    /// The deepest samples of the parts of cubes in which bodies penetrate, or nearly.
    pub fn deepest(&self) -> impl Iterator<Item = &ContactSample> {
        self.deepest.iter().map(|(_, touch)| touch)
    }

    /// Keeps only the `most` deepest of the deepest samples of parts, the deepest first. No more samples can
    /// be added then.
    pub fn keep_deepest(&mut self, most: usize) {
        self.deepest.sort_unstable_by(|a, b| b.1.reach.total_cmp(&a.1.reach).then_with(|| a.0.cmp(&b.0)));
        self.deepest.truncate(most);
    }

    /// Edge of a part of a cube, m.
    pub fn part(&self) -> f32 {
        1.0 / self.per_unit
    }

    /// Joins cells of neighbouring cubes with the same direction until there are at most `most`, or one a
    /// direction; `across` is the number of cubes along each axis.
    pub fn bound(&mut self, most: usize, across: u32) {
        let mut edge = 1;
        while self.cells.len() > most && edge < across {
            edge *= 2;
            let large = across.div_ceil(edge);
            self.slots.clear();
            let mut kept = 0;
            for index in 0..self.cells.len() {
                let cell = self.cells[index];
                // Joined cells have the slots of larger cubes, twice as large each time.
                let across = across.div_ceil(edge / 2);
                let (cube, direction) = (cell.slot / 6, cell.slot % 6);
                let [x, y, z] =
                    [cube % across, cube / across % across, cube / (across * across)].map(|i| i / 2);
                let slot = ((z * large + y) * large + x) * 6 + direction;
                let place = self.slots.get_or_insert(slot, kept);
                if place < kept {
                    self.cells[place].join(&cell);
                } else {
                    self.cells[kept] = Cell { slot, ..cell };
                    kept += 1;
                }
            }
            self.cells.truncate(kept);
        }
    }

    /// The cells that hold contacts.
    pub fn iter(&self) -> impl Iterator<Item = &Cell> {
        self.cells.iter()
    }

    /// Number of samples added.
    pub fn contacts(&self) -> usize {
        self.contacts
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.slots.bytes()
            + self.parts.bytes()
            + self.cells.capacity() * size_of::<Cell>()
            + self.deepest.capacity() * size_of::<(u32, ContactSample)>()
    }
}
