//! The cup of Table 3.2 and §5.5: a mug with a wall and a handle, within a sphere of radius 8 cm, through
//! whose handle the [`spoon`](crate::spoon) passes (Fig. 5.7).
//!
//! The body is turned on a lathe, with two windows; the handle is a tube between them.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use palpate_core::{
    TriMesh,
    glam::{DVec2, DVec3},
};

use crate::lathe::{Lathe, Profile};
use crate::path::Path;
use crate::stitched::{Cap, Stitched, cells, fit, reversed};
use crate::window::{Opening, Window};

pub(crate) const MIN_TRIANGLES: usize = 900;

/// Outer radius at the foot and at the rim, height, and thickness of the wall, mm.
const FOOT: f64 = 36.0;
const RIM: f64 = 43.0;
const HEIGHT: f64 = 104.0;
const WALL: f64 = 4.5;
/// Rounding of the outer and the inner bottom edge.
const OUTER_FILLET: f64 = 5.0;
const INNER_FILLET: f64 = 10.0;
/// Half the distance between the ends of the handle's centre line, their mean height, and its reach from the
/// wall.
const HANDLE_HALF: f64 = 32.0;
const HANDLE_HEIGHT: f64 = 54.0;
const HANDLE_REACH: f64 = 34.0;
/// Half axes of the handle, along the wall's circumference and across, mm; and the same where it meets the
/// wall.
const HANDLE: DVec2 = DVec2::new(6.5, 4.2);
const JOINT: DVec2 = DVec2::new(8.0, 7.5);
/// Distance from the handle's middle within which the wall's grid is displaced.
const JOINT_ROOM: f64 = 13.0;
/// Length over which the handle widens towards the wall.
const FLARE: f64 = 5.0;

/// Outer radius of the wall at a height.
fn outer(z: f64) -> f64 {
    FOOT + (RIM - FOOT) * (z / HEIGHT).clamp(0.0, 1.0).powf(0.8)
}

/// The pieces of the profile, from the foot over the rim to the inner bottom.
fn pieces() -> Vec<Path> {
    let lip = 0.5 * WALL;
    let top = HEIGHT - lip;
    let bottom = WALL + INNER_FILLET;
    vec![
        Path::cubic(
            DVec2::new(outer(OUTER_FILLET) - OUTER_FILLET, 0.0),
            DVec2::new(1.5 * OUTER_FILLET, 0.0),
            DVec2::new(outer(OUTER_FILLET), OUTER_FILLET),
            DVec2::new(0.2, 1.5 * OUTER_FILLET),
        ),
        Path::new(|t| {
            let z = OUTER_FILLET + t * (top - OUTER_FILLET);
            DVec2::new(outer(z), z)
        }),
        Path::arc(DVec2::new(outer(top) - lip, top), lip, 0.0, PI),
        Path::new(|t| {
            let z = top + t * (bottom - top);
            DVec2::new(outer(z) - WALL, z)
        }),
        Path::cubic(
            DVec2::new(outer(bottom) - WALL, bottom),
            DVec2::new(-0.4, -1.5 * INNER_FILLET),
            DVec2::new(outer(bottom) - WALL - INNER_FILLET, WALL),
            DVec2::new(-1.5 * INNER_FILLET, 0.0),
        ),
    ]
}

/// Index of the outer wall among the pieces.
const OUTER_WALL: usize = 1;

/// The centre line of the handle as (distance from the axis, height), from the upper window to the lower.
fn handle_path() -> Path {
    let end = |z: f64| outer(z);
    let (high, low) = (HANDLE_HEIGHT + HANDLE_HALF, HANDLE_HEIGHT - HANDLE_HALF);
    Path::new(|t| {
        let angle = FRAC_PI_2 - PI * t;
        let (sin, cos) = angle.sin_cos();
        let power = |value: f64| value.signum() * value.abs().powf(2.0 / 2.7);
        let wall = end(high) + (end(low) - end(high)) * t;
        DVec2::new(wall + HANDLE_REACH * power(cos.max(0.0)), HANDLE_HEIGHT + HANDLE_HALF * power(sin))
    })
}

struct Plan {
    lathe: Lathe,
    profile: Profile,
    /// Rows along the handle.
    handle: usize,
    /// Steps from border to centre of the outer and the inner bottom.
    bottoms: [Cap; 2],
}

impl Plan {
    fn new(edge: f64, stretch: f64) -> Self {
        let around = cells(TAU * RIM, edge * stretch, 12);
        let profile = Profile::new(pieces(), edge / stretch, 2);
        let (first, rows) = profile.piece(OUTER_WALL);
        let step = pieces()[OUTER_WALL].length() / rows as f64;
        // Windows of an even number of cells, centred on a column and on a row.
        let half_columns = cells(0.85 * JOINT.x, edge * stretch, 1);
        let half_rows = cells(0.85 * JOINT.y, step, 1);
        let row = |height: f64| {
            let highest = first + rows - half_rows - 1;
            (first + ((height - OUTER_FILLET) / step).round() as usize)
                .clamp(first + half_rows + 1, highest.max(first + half_rows + 1))
        };
        let middle = around / 2;
        let window = |row: usize| Window {
            low: [middle - half_columns, row - half_rows],
            high: [middle + half_columns, row + half_rows],
        };
        let windows =
            vec![window(row(HANDLE_HEIGHT + HANDLE_HALF)), window(row(HANDLE_HEIGHT - HANDLE_HALF))];
        let inner_bottom = profile.at(profile.rows() as f64).x;
        let bottom = |radius: f64| Cap::new(around, cells(radius, edge / stretch, 2));
        Self {
            lathe: Lathe { around, rows: profile.rows(), windows },
            handle: cells(handle_path().length(), edge * stretch, 8),
            bottoms: [bottom(outer(OUTER_FILLET) - OUTER_FILLET), bottom(inner_bottom)],
            profile,
        }
    }

    fn triangles(&self) -> usize {
        let handle = 2 * self.lathe.windows[0].border() * self.handle;
        self.lathe.triangles() + handle + self.bottoms.iter().map(Cap::triangles).sum::<usize>()
    }

    /// The opening of a window, in arc length around and height.
    fn opening(&self, window: &Window) -> Opening {
        let height = |row: usize| self.profile.at(row as f64).y;
        let (low, high) = (height(window.low[1]), height(window.high[1]));
        let center = DVec2::new(0.0, 0.5 * (low + high));
        let columns = (window.high[0] - window.low[0]) as f64;
        let half = 0.5 * columns * TAU * outer(center.y) / self.lathe.around as f64;
        let corners = [DVec2::new(-half, low), DVec2::new(half, high)];
        Opening::new(corners, window.size(), center, JOINT, JOINT_ROOM)
    }
}

pub(crate) fn build(triangles: usize) -> TriMesh {
    let plan = fit(triangles, 75_000.0, Plan::new, Plan::triangles);
    let around = plan.lathe.around;
    let openings: Vec<Opening> = plan.lathe.windows.iter().map(|window| plan.opening(window)).collect();
    let (wall_first, wall_rows) = plan.profile.piece(OUTER_WALL);
    // Position of a node on the plain surface by arc length from the handle's middle and by height.
    let plain = |column: usize, row: usize, opening: &Opening| {
        let turn = (column as f64 - (around / 2) as f64) / around as f64;
        DVec2::new(TAU * turn * outer(opening.center.y), plan.profile.at(row as f64).y)
    };
    let on_wall = |radius: f64, arc: f64, height: f64| {
        let (sin, cos) = arc.sin_cos();
        DVec3::new(radius * cos, radius * sin, height)
    };

    let mut mesh = Stitched::default();
    let body = plan.lathe.build(&mut mesh, |column, row| {
        let at = plan.profile.at(row as f64);
        let turn = (column as f64 - (around / 2) as f64) / around as f64;
        if (wall_first + 1..wall_first + wall_rows).contains(&row) {
            for opening in &openings {
                let from = plain(column, row, opening);
                let to = opening.displace(from);
                if to != from {
                    return on_wall(outer(to.y), to.x / outer(opening.center.y), to.y);
                }
            }
        }
        on_wall(at.x, TAU * turn, at.y)
    });

    let disc = |border: &[u32], mesh: &Stitched| {
        let rim = mesh.position(border[0]);
        (rim.truncate().length(), rim.z)
    };
    let half_turn = if around % 2 == 0 { 0.5 } else { 0.5 * (around - 1) as f64 / around as f64 };
    let (radius, height) = disc(&body.first, &mesh);
    mesh.cap(&reversed(&body.first), &plan.bottoms[0], |part, turn| {
        on_wall(radius * part, TAU * (-turn - half_turn), height)
    });
    let (radius, height) = disc(&body.last, &mesh);
    mesh.cap(&body.last, &plan.bottoms[1], |part, turn| {
        on_wall(radius * part, TAU * (turn - half_turn), height)
    });

    join_handle(&mut mesh, &plan, &openings, &body.windows);
    // The bounding sphere of the cup as drawn here, measured on the finished mesh, has a radius of this many
    // mm.
    const BOUNDING_RADIUS: f64 = 78.9;
    mesh.finish(0.08 / BOUNDING_RADIUS)
}

/// Draws the handle from the upper to the lower window.
fn join_handle(mesh: &mut Stitched, plan: &Plan, openings: &[Opening], borders: &[Vec<u32>]) {
    let window = plan.lathe.windows[0];
    let half =
        DVec2::new((window.high[0] - window.low[0]) as f64, (window.high[1] - window.low[1]) as f64) / 2.0;
    let on_grid = Opening { center: DVec2::ZERO, half, ..openings[0] };
    let nodes: Vec<[usize; 2]> =
        window.nodes().map(|[i, j]| [i - window.low[0], j - window.low[1]]).collect();
    let directions: Vec<DVec2> =
        nodes.iter().map(|[i, j]| on_grid.direction(DVec2::new(*i as f64, *j as f64) - half)).collect();
    // Arriving at the lower window the handle has turned over: up has become down.
    let rows = window.high[1] - window.low[1];
    let lower: Vec<u32> = nodes
        .iter()
        .map(|[i, j]| {
            let mirrored = [*i, rows - j];
            borders[1][nodes.iter().position(|node| *node == mirrored).expect("a window is symmetric")]
        })
        .collect();

    let path = handle_path();
    let length = path.length();
    let ideal = |part: f64, direction: DVec2| {
        let (center, tangent) = path.at(part);
        let from_wall = length * part.min(1.0 - part);
        let axes = HANDLE + (JOINT - HANDLE) * (-(from_wall / FLARE).powi(2)).exp();
        let normal = tangent.perp();
        DVec3::new(center.x, 0.0, center.y)
            + axes.x * direction.x * DVec3::Y
            + axes.y * direction.y * DVec3::new(normal.x, 0.0, normal.y)
    };
    // The wall is curved and the windows fall on rows: the deviation of the ends decreases along the handle.
    let deviation = |border: &[u32], part: f64, mesh: &Stitched| -> Vec<DVec3> {
        border
            .iter()
            .zip(&directions)
            .map(|(vertex, direction)| mesh.position(*vertex) - ideal(part, *direction))
            .collect()
    };
    let (start, end) = (deviation(&borders[0], 0.0, mesh), deviation(&lower, 1.0, mesh));
    let last = mesh.tube(&borders[0], plan.handle - 1, |row, index| {
        let part = row as f64 / plan.handle as f64;
        let fades = |distance: f64| (1.0 - distance * length / (5.0 * FLARE)).max(0.0).powi(2);
        ideal(part, directions[index]) + fades(part) * start[index] + fades(1.0 - part) * end[index]
    });
    mesh.band(&last, &lower);
}
