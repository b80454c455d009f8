//! Bolt and nut with an ISO metric thread.
//!
//! The basic profile is that of ISO 68-1: an equilateral triangle of height H = √3/2 · P, cut off by H/8 at
//! the major diameter d and by H/4 at the minor diameter of the nut, D₁ = d − 5/4 · H. The bolt's root is cut
//! off at d₃ = d − 17/12 · H (ISO 724), flat where a real one is rounded. Bolt and nut are moved away from
//! the basic profile by an allowance each, as the tolerance classes of ISO 965-1 do.
//!
//! The axis is z and the thread is right-handed. With u = z − P θ/2π, θ being the angle about z, a crest of
//! the bolt and a groove of the nut are at u = 0: bolt and nut are engaged at equal poses, and wherever the
//! nut is turned by φ about z and moved by P φ/2π along it. Rows of vertices follow the helix, so that flanks
//! and edges have the pitch at any resolution. The bolt's vertices are on its surface and the middles of the
//! nut's edges on its own: polygons never take from the clearance.

use std::f64::consts::{PI, TAU};

use palpate_core::{TriMesh, glam::DVec3};

use crate::stitched::{Cap, Stitched, cells, fit, reversed};
use crate::{MAX_TRIANGLES, ModelError};

pub(crate) const MIN_BOLT_TRIANGLES: usize = 7000;
pub(crate) const MIN_NUT_TRIANGLES: usize = 4000;

/// Tangent of the angle between a flank and the plane across the axis.
const FLANK: f64 = 0.577_350_269_189_625_8;
/// Length of the bolt's shank over the diameter, and height of its head.
const SHANK: f64 = 2.0;
const HEAD: f64 = 0.625;
/// Length of the neck between head and thread, in pitches.
const NECK: f64 = 1.5;
/// Height of the nut (ISO 4032: 14.8 mm for M16), and width across the flats of head and nut, in diameters.
const NUT: f64 = 0.925;
const ACROSS_FLATS: f64 = 1.5;
/// How far the chamfers at the ends of a thread go beyond it, in pitches. Rows of vertices that would be
/// slivers at the end are left out there, where nothing of the thread is left.
const CHAMFER: f64 = 0.2;
/// Least distance of a row of vertices from the end of the thread, in pitches.
const LEAST_ROW: f64 = 0.06;

/// Dimensions of an ISO metric thread with its allowances. Lengths in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MetricThread {
    /// Nominal diameter d.
    pub diameter: f64,
    /// Pitch P: travel along the axis in one turn.
    pub pitch: f64,
    /// How much smaller all radii of the bolt are than those of the basic profile.
    pub bolt_allowance: f64,
    /// How much larger all radii of the nut are than those of the basic profile.
    pub nut_allowance: f64,
}

impl MetricThread {
    /// M16 × 2 in the middle of the tolerances 6g/6H: pitch diameters 14.583 mm (14.503 to 14.663) and
    /// 14.807 mm (14.701 to 14.913), against 14.701 mm of the basic profile (ISO 965-1, 965-2).
    pub const M16: Self =
        Self { diameter: 0.016, pitch: 0.002, bolt_allowance: 0.059e-3, nut_allowance: 0.053e-3 };

    /// The thread with a radial clearance (m) between nut and bolt, half of it taken from each.
    pub fn with_clearance(self, radial: f64) -> Self {
        Self { bolt_allowance: 0.5 * radial, nut_allowance: 0.5 * radial, ..self }
    }

    /// Radial clearance between nut and bolt, m. Along the axis a nut has √3/3 of it to either side, and half
    /// of it between the flanks, along their normal.
    pub fn clearance(&self) -> f64 {
        self.bolt_allowance + self.nut_allowance
    }

    /// Diameter at which ridges and grooves of the basic profile are equally wide, d₂ = d − 3/4 · H, m.
    pub fn pitch_diameter(&self) -> f64 {
        self.diameter - 0.75 * self.triangle_height()
    }

    /// Minor diameter of the nut's basic profile, D₁, m.
    pub fn minor_diameter(&self) -> f64 {
        self.diameter - 1.25 * self.triangle_height()
    }

    /// Root diameter of the bolt without its allowance, d₃, m.
    pub fn root_diameter(&self) -> f64 {
        self.diameter - 17.0 / 12.0 * self.triangle_height()
    }

    /// Height of the triangle of the profile, H, m.
    fn triangle_height(&self) -> f64 {
        0.75_f64.sqrt() * self.pitch
    }

    /// Generates the bolt with about `triangles` triangles. Its head bears at z = 0; the shank, two diameters
    /// long, points up.
    ///
    /// # Errors
    /// If the dimensions are not those of a thread, or the number of triangles is out of range.
    pub fn bolt(&self, triangles: usize) -> Result<TriMesh, ModelError> {
        self.check("bolt", triangles, MIN_BOLT_TRIANGLES)?;
        Ok(bolt(self, triangles))
    }

    /// Generates the hexagonal nut with about `triangles` triangles; its centre is the origin.
    ///
    /// # Errors
    /// As [`MetricThread::bolt`].
    pub fn nut(&self, triangles: usize) -> Result<TriMesh, ModelError> {
        self.check("nut", triangles, MIN_NUT_TRIANGLES)?;
        Ok(nut(self, triangles))
    }

    /// Height of the nut, m.
    pub fn nut_height(&self) -> f64 {
        NUT * self.diameter
    }

    /// Height of the bolt's end above the bearing face of its head, m.
    pub fn bolt_length(&self) -> f64 {
        SHANK * self.diameter
    }

    fn check(&self, model: &'static str, asked: usize, min: usize) -> Result<(), ModelError> {
        let scaled =
            |length: f64, low: f64, high: f64| (low * self.pitch..=high * self.pitch).contains(&length);
        let sound = (1e-4..=1.0).contains(&self.diameter)
            && self.pitch.is_finite()
            && scaled(self.diameter, 5.0, 16.0)
            && scaled(self.bolt_allowance, 0.0, 0.1)
            && scaled(self.nut_allowance, 0.0, 0.1);
        if !sound {
            let expected =
                "a thread of 0.1 mm to 1 m diameter, 5 to 16 pitches, with allowances of up to 0.1 pitch";
            return Err(ModelError::Dimensions { model, expected });
        }
        if !(min..=MAX_TRIANGLES).contains(&asked) {
            return Err(ModelError::OutOfRange { model, asked, min, max: MAX_TRIANGLES });
        }
        Ok(())
    }
}

/// Threaded surface about the z axis between two planes, with a chamfer at either end. Lengths in mm.
struct Threaded {
    pitch: f64,
    /// Radii of the flats at u = 0 and half a pitch from it.
    outer: f64,
    inner: f64,
    bottom: f64,
    top: f64,
    /// Whether the chamfers cut off the outside, as on a bolt, or the inside.
    external: bool,
}

impl Threaded {
    /// Radius at a height over the helix of the outer flats' middle.
    fn thread_radius(&self, over_helix: f64) -> f64 {
        let off = (over_helix - self.pitch * (over_helix / self.pitch).round()).abs();
        (self.outer - (off - self.pitch / 16.0).max(0.0) / FLANK).max(self.inner)
    }

    /// Radius at a height over the helix and a height z.
    fn radius(&self, over_helix: f64, z: f64) -> f64 {
        let inside = (z - self.bottom).min(self.top - z);
        let thread = self.thread_radius(over_helix);
        if self.external {
            thread.min(self.end_radius() + inside)
        } else {
            thread.max(self.end_radius() - inside)
        }
    }

    /// Radius at the ends.
    fn end_radius(&self) -> f64 {
        let beyond = CHAMFER * self.pitch;
        if self.external { self.inner - beyond } else { self.outer + beyond }
    }

    /// Heights of the rows of vertices over the helix within a pitch: edges, and `flank` cells on each flank.
    fn rows(&self, flank: usize) -> Vec<f64> {
        let crest = self.pitch / 16.0;
        let root = crest + (self.outer - self.inner) * FLANK;
        let down = (0..=flank).map(|cell| crest + (root - crest) * cell as f64 / flank as f64);
        let up = (0..=flank).map(|cell| self.pitch - root + (root - crest) * cell as f64 / flank as f64);
        down.chain(up).collect()
    }

    /// The rows with vertices in a column at a part of a turn, and their heights over the helix.
    fn column<'a>(&self, rows: &'a [f64], turn: f64) -> impl Iterator<Item = (i64, f64)> + use<'a> {
        let (pitch, per_pitch) = (self.pitch, rows.len() as i64);
        let least = LEAST_ROW * pitch;
        let (low, high) = (self.bottom + least - pitch * turn, self.top - least - pitch * turn);
        let (first, last) = ((low / pitch).floor() as i64, (high / pitch).ceil() as i64);
        (first..last)
            .flat_map(move |coil| {
                let at = move |(row, height): (usize, &f64)| {
                    (coil * per_pitch + row as i64, *height + coil as f64 * pitch)
                };
                rows.iter().enumerate().map(at)
            })
            .filter(move |(_, height)| (low..=high).contains(height))
    }

    /// Number of triangles.
    fn triangles(&self, around: usize, rows: &[f64]) -> usize {
        let in_column = |column: usize| self.column(rows, column as f64 / around as f64).count() + 1;
        2 * (0..around).map(in_column).sum::<usize>()
    }

    /// Adds the surface, seen from outside the axis or from it, and gives the rings at its bottom and its
    /// top.
    fn build(&self, mesh: &mut Stitched, around: usize, rows: &[f64]) -> (Vec<u32>, Vec<u32>) {
        let stretch = if self.external { 1.0 } else { 1.0 / (PI / around as f64).cos() };
        let place = |radius: f64, turn: f64, z: f64| {
            let (sin, cos) = (TAU * turn).sin_cos();
            DVec3::new(stretch * radius * cos, stretch * radius * sin, z)
        };
        let bottom = mesh.ring(around, |turn| place(self.end_radius(), turn, self.bottom));
        let top = mesh.ring(around, |turn| place(self.end_radius(), turn, self.top));
        let columns: Vec<Vec<(i64, u32)>> = (0..around)
            .map(|column| {
                let turn = column as f64 / around as f64;
                let vertex = |(row, over_helix): (i64, f64)| {
                    let z = over_helix + self.pitch * turn;
                    (row, mesh.vertex(place(self.radius(over_helix, z), turn, z)))
                };
                let between: Vec<_> = self.column(rows, turn).map(vertex).collect();
                let ends = [(i64::MIN / 2, bottom[column]), (i64::MAX / 2, top[column])];
                [&ends[..1], &between, &ends[1..]].concat()
            })
            .collect();
        for column in 0..around {
            // After a whole turn, a row continues as the row one pitch further up.
            let shift = if column + 1 == around { rows.len() as i64 } else { 0 };
            join(mesh, &columns[column], &columns[(column + 1) % around], shift, self.external);
        }
        (bottom, top)
    }
}

/// Joins two neighbouring columns of vertices, each in the order of its rows; rows of the second count
/// `shift` less.
fn join(mesh: &mut Stitched, from: &[(i64, u32)], to: &[(i64, u32)], shift: i64, outward: bool) {
    let triangle = |mesh: &mut Stitched, [a, b, c]: [u32; 3]| {
        mesh.triangle(if outward { [a, b, c] } else { [a, c, b] });
    };
    let (mut i, mut j) = (0, 0);
    while i + 1 < from.len() || j + 1 < to.len() {
        let (a, b) = (from[i].1, to[j].1);
        let (next_a, next_b) = (from.get(i + 1), to.get(j + 1));
        let row_a = next_a.map_or(i64::MAX, |next| next.0);
        // The ends of the columns are no rows and belong together.
        let row_b = next_b.map_or(i64::MAX, |next| next.0 - if j + 2 < to.len() { shift } else { 0 });
        match (next_a, next_b) {
            (Some(&(_, up_a)), Some(&(_, up_b))) if row_a == row_b => {
                mesh.quad(if outward { [a, b, up_b, up_a] } else { [a, up_a, up_b, b] });
                (i, j) = (i + 1, j + 1);
            }
            (Some(&(_, up_a)), _) if row_a < row_b => {
                triangle(mesh, [a, b, up_a]);
                i += 1;
            }
            (_, Some(&(_, up_b))) => {
                triangle(mesh, [a, b, up_b]);
                j += 1;
            }
            (_, None) => break,
        }
    }
}

/// Division of a bolt or a nut.
struct Plan {
    around: usize,
    /// Heights of the rows in a pitch.
    rows: Vec<f64>,
    /// Rows of cells along the sides of the hexagon, across its faces, and along the neck.
    side: usize,
    face: usize,
    neck: usize,
}

impl Plan {
    fn new(thread: &MetricThread, threaded: &Threaded, height: f64, edge: f64, stretch: f64) -> Self {
        let diameter = 1e3 * thread.diameter;
        let around = cells(PI * diameter, edge / stretch, 48).div_ceil(6) * 6;
        let flank = (threaded.outer - threaded.inner) / FLANK.atan().cos();
        // Their number does not matter to the shape: they make up the number of triangles.
        let coarse = 3.0 * PI * diameter / around as f64 * stretch.powi(3);
        Self {
            around,
            rows: threaded.rows(cells(flank, 2.0 * edge * stretch, 1)),
            side: cells(height, coarse, 1),
            face: cells(0.25 * diameter, coarse, 1),
            neck: cells(NECK * threaded.pitch, coarse, 1),
        }
    }

    fn cap(&self) -> Cap {
        Cap::new(self.around, (self.around as f64 / TAU).round() as usize)
    }
}

/// Distance of the hexagon's border from the axis, mm.
fn hexagon(thread: &MetricThread, turn: f64) -> f64 {
    let sixth = TAU / 6.0;
    let angle = (TAU * turn).rem_euclid(sixth) - 0.5 * sixth;
    0.5 * 1e3 * ACROSS_FLATS * thread.diameter / angle.cos()
}

fn around_axis(radius: f64, turn: f64, z: f64) -> DVec3 {
    let (sin, cos) = (TAU * turn).sin_cos();
    DVec3::new(radius * cos, radius * sin, z)
}

pub(crate) fn bolt(thread: &MetricThread, triangles: usize) -> TriMesh {
    let (diameter, pitch) = (1e3 * thread.diameter, 1e3 * thread.pitch);
    let (length, head) = (SHANK * diameter, HEAD * diameter);
    let threaded = Threaded {
        pitch,
        outer: 0.5 * diameter - 1e3 * thread.bolt_allowance,
        inner: 1e3 * (0.5 * thread.root_diameter() - thread.bolt_allowance),
        bottom: NECK * pitch,
        top: length,
        external: true,
    };
    let plan = fit(
        triangles,
        PI * diameter * (2.0 * length + 2.0 * head + diameter),
        |edge, stretch| Plan::new(thread, &threaded, head, edge, stretch),
        |plan| {
            threaded.triangles(plan.around, &plan.rows)
                + 2 * plan.around * (plan.side + plan.face + plan.neck)
                + 2 * plan.cap().triangles()
        },
    );
    let turn = |index: usize| index as f64 / plan.around as f64;
    let mut mesh = Stitched::default();
    let (neck, tip) = threaded.build(&mut mesh, plan.around, &plan.rows);
    let end = threaded.end_radius();
    mesh.cap(&tip, &plan.cap(), |part, turn| around_axis(part * end, turn, length));

    let base = mesh.ring(plan.around, |turn| around_axis(hexagon(thread, turn), turn, -head));
    let rim = mesh.tube(&base, plan.side, |row, index| {
        let z = -head + head * row as f64 / plan.side as f64;
        around_axis(hexagon(thread, turn(index)), turn(index), z)
    });
    let foot = mesh.tube(&rim, plan.face, |row, index| {
        let part = row as f64 / plan.face as f64;
        let border = hexagon(thread, turn(index));
        around_axis(border + (end - border) * part, turn(index), 0.0)
    });
    let below = mesh.tube(&foot, plan.neck - 1, |row, index| {
        around_axis(end, turn(index), threaded.bottom * row as f64 / plan.neck as f64)
    });
    mesh.band(&below, &neck);
    mesh.cap(&reversed(&base), &plan.cap(), |part, turn| {
        let turn = 1.0 - turn;
        around_axis(part * hexagon(thread, turn), turn, -head)
    });
    mesh.finish(1e-3)
}

pub(crate) fn nut(thread: &MetricThread, triangles: usize) -> TriMesh {
    let (diameter, pitch) = (1e3 * thread.diameter, 1e3 * thread.pitch);
    let half = 0.5 * NUT * diameter;
    let threaded = Threaded {
        pitch,
        outer: 0.5 * diameter + 1e3 * thread.nut_allowance,
        inner: 1e3 * (0.5 * thread.minor_diameter() + thread.nut_allowance),
        bottom: -half,
        top: half,
        external: false,
    };
    let plan = fit(
        triangles,
        PI * diameter * (4.0 * half + 4.0 * half + diameter),
        |edge, stretch| Plan::new(thread, &threaded, 2.0 * half, edge, stretch),
        |plan| threaded.triangles(plan.around, &plan.rows) + 2 * plan.around * (plan.side + 2 * plan.face),
    );
    let turn = |index: usize| index as f64 / plan.around as f64;
    let mut mesh = Stitched::default();
    let (bottom, top) = threaded.build(&mut mesh, plan.around, &plan.rows);
    // From the bore's lower ring outwards, up the sides, and inwards to the upper ring.
    let bore = threaded.end_radius() / (PI / plan.around as f64).cos();
    let across =
        |part: f64, turn: f64, z: f64| around_axis(bore + (hexagon(thread, turn) - bore) * part, turn, z);
    let rim =
        mesh.tube(&bottom, plan.face, |row, index| across(row as f64 / plan.face as f64, turn(index), -half));
    let upper = mesh.tube(&rim, plan.side, |row, index| {
        across(1.0, turn(index), -half + 2.0 * half * row as f64 / plan.side as f64)
    });
    let inner = mesh.tube(&upper, plan.face - 1, |row, index| {
        across(1.0 - row as f64 / plan.face as f64, turn(index), half)
    });
    mesh.band(&inner, &top);
    mesh.finish(1e-3)
}
