//! Filtered edge collapse (§3.3.4): the atomic operation of the simplification.
//!
//! Departures. If the position v̂ is not feasible itself, the search starts from the last feasible position
//! on the path to it. If no position is valid on the path from v̂ to ṽ, the paths from the middle of the edge
//! and from its ends are tried: the surface of a lathe or an extrusion, whose patches have flat
//! quadrilaterals inside, leaves the vertex hardly any other position.

use super::filter::Path;
use super::star::Star;
use super::state::State;

/// K: number of steps of the bisection for a valid position (§3.3.4).
const BISECTIONS: usize = 3;

/// Collapses an edge (§3.3.4). Returns the patches that it has changed; `None` if no position is valid.
pub(crate) fn collapse(state: &mut State, ends: [u32; 2], star: &mut Star) -> Option<Vec<u32>> {
    if !state.fans.star(&state.surface.triangles, ends, star) {
        return None;
    }
    let near = state.neighbourhood();
    let path = near.path(star, &state.quadric(ends));
    let filtered = path.filtered;
    let [p, q] = ends.map(|v| state.surface.points[v as usize]);
    // On the border, only the minimum of the quadric keeps the border's shape.
    let starts = if star.border { 1 } else { 4 };
    [path.least, 0.5 * (p + q), p, q]
        .into_iter()
        .take(starts)
        .find_map(|least| along(state, star, &Path { least, filtered }))
}

/// Collapses to the valid position nearest to the filtered one, among those tried on a path. Returns the
/// patches changed.
fn along(state: &mut State, star: &Star, path: &Path) -> Option<Vec<u32>> {
    let (low, high) = state.neighbourhood().feasible(star, path, &state.patch_of, state.tolerance())?;
    // u of the best valid position and of an invalid one that is nearer to the goal; the last one tried.
    let (mut good, mut bad, mut last, mut steps) = (high, low, low, 0);
    state.collapse(star, |valid| {
        let next = match valid {
            None => Some(low),
            Some(true) if last == low => None,
            Some(false) if last == low && high > low => Some(high),
            Some(false) if last == low || last == high => None,
            Some(valid) => {
                *(if valid { &mut good } else { &mut bad }) = last;
                (steps < BISECTIONS).then(|| {
                    steps += 1;
                    0.5 * (good + bad)
                })
            }
        };
        last = next.unwrap_or(last);
        next.map(|u| path.at(u))
    })
}
