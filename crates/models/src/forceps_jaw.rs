//! A jaw of forceps, for a tool of two bodies (§6.2.3): a boss with the hole of the hinge, and a tapered beak
//! with a flat gripping face.
//!
//! The hinge's axis is z through the origin; the beak lies along x below the plane y = 0, in which the
//! gripping face is. The boss takes the lower half of the thickness, so that a second jaw, turned half a turn
//! about x, has its own beside it: at equal origins the two gripping faces then meet, and the second jaw
//! opens by turning about z.

use palpate_core::{
    TriMesh,
    glam::{DVec2, DVec3},
};

use crate::box_lattice::BoxLattice;
use crate::relief::smooth_step;
use crate::stitched::{Stitched, cells, fit, reversed};
use crate::window::{Opening, Window};

pub(crate) const MIN_TRIANGLES: usize = 600;

/// x of the back of the boss, mm.
const BACK: f64 = -5.5;
/// x of the tip, mm.
const TIP: f64 = 60.0;
/// Radius of the boss, mm.
const BOSS: f64 = 6.0;
/// Radius of the hole, mm.
const HOLE: f64 = 2.0;
/// x to which the outline of the boss blends into that of the beak, and from which its thickness does, mm.
const NECK: f64 = 9.0;
/// x to which the thickness of the boss blends into that of the beak, and where the gripping face begins, mm.
const FACE: f64 = 13.0;
/// Half the thickness of boss and beak, mm.
const HALF: f64 = 4.0;
/// Gap between the two bosses, mm.
const PLAY: f64 = 0.1;

/// Lowest and highest y at x.
fn height(x: f64) -> (f64, f64) {
    // Flat in the middle, so that the hole is round.
    let boss = BOSS * (1.0 - (x / 7.5).powi(4)).max(0.0).sqrt();
    let beak = -5.5 + 3.7 * smooth_step(FACE, 1.6 * TIP, x) / smooth_step(FACE, 1.6 * TIP, TIP);
    let to_beak = smooth_step(1.0, NECK, x);
    let low = if x < 1.0 { -boss } else { -BOSS + (beak + BOSS) * to_beak };
    let high = if x < 1.0 { boss } else { BOSS * (1.0 - to_beak) };
    (low, high)
}

/// Lowest and highest z at x.
fn thickness(x: f64) -> (f64, f64) {
    let half = HALF - 2.6 * smooth_step(FACE, TIP, x);
    (-half, -0.5 * PLAY + (half + 0.5 * PLAY) * smooth_step(NECK, FACE, x))
}

/// Division of the jaw.
struct Plan {
    lattice: BoxLattice,
    /// Rows of the hole's wall.
    rows: usize,
}

impl Plan {
    fn new(edge: f64, stretch: f64) -> Self {
        let along = cells(TIP - BACK, edge * stretch, 12);
        let across = cells(8.0, edge / stretch, 4);
        let node = |x: f64| ((x - BACK) / (TIP - BACK) * along as f64).round() as usize;
        let (low, high) = (node(-HOLE).max(1), node(HOLE).max(node(-HOLE).max(1) + 1));
        let margin = (across / 3).max(1);
        let window = Window { low: [low, margin], high: [high, across - margin] };
        Self {
            lattice: BoxLattice {
                cells: [along, across, cells(6.0, edge / stretch, 1)],
                windows: vec![window],
            },
            rows: cells(HALF, edge / stretch, 1),
        }
    }

    fn triangles(&self) -> usize {
        let wall = self.lattice.windows.iter().map(|window| 2 * window.border() * self.rows);
        self.lattice.triangles() + wall.sum::<usize>()
    }

    /// A node on the plain grid: x, and y as on the boss.
    fn plain(&self, i: usize, j: usize) -> DVec2 {
        let [along, across, _] = self.lattice.cells;
        let part = 2.0 * j as f64 / across as f64 - 1.0;
        DVec2::new(BACK + (TIP - BACK) * i as f64 / along as f64, BOSS * part)
    }

    fn opening(&self) -> Opening {
        let Window { low, high } = self.lattice.windows[0];
        let corners = [self.plain(low[0], low[1]), self.plain(high[0], high[1])];
        let size = [high[0] - low[0], high[1] - low[1]];
        Opening::new(corners, size, DVec2::ZERO, DVec2::splat(HOLE), 0.8 * BOSS)
    }
}

pub(crate) fn build(triangles: usize) -> TriMesh {
    let plan = fit(triangles, 2.0 * (TIP - BACK) * (5.0 + 6.0), Plan::new, Plan::triangles);
    let opening = plan.opening();
    let layers = plan.lattice.cells[2];
    let place = |[i, j, k]: [usize; 3]| {
        let at = opening.displace(plan.plain(i, j));
        let (low, high) = height(at.x);
        let (bottom, top) = thickness(at.x);
        let y = low + (high - low) * 0.5 * (at.y / BOSS + 1.0);
        DVec3::new(at.x, y, bottom + (top - bottom) * k as f64 / layers as f64)
    };
    let mut mesh = Stitched::default();
    for borders in plan.lattice.build(&mut mesh, place) {
        // The wall of the hole is seen from its axis: from the bottom's border, the other way round.
        let (bottom, top) = (reversed(&borders.bottom), reversed(&borders.top));
        let ends: Vec<[DVec3; 2]> =
            bottom.iter().zip(&top).map(|(b, t)| [mesh.position(*b), mesh.position(*t)]).collect();
        let below_top = mesh.tube(&bottom, plan.rows - 1, |row, index| {
            let [b, t] = ends[index];
            b.lerp(t, row as f64 / plan.rows as f64)
        });
        mesh.band(&below_top, &top);
    }
    mesh.finish(1e-3)
}
