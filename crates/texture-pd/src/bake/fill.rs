//! Filling of the texels of a chart whose rays hit nothing.

/// Order of extrapolation in the layers next to known texels. It falls with the distance, because noise grows
/// and distant texels have little influence. Farther away values are means of their neighbours.
const EXTRAPOLATION_ORDERS: [u32; 5] = [3, 3, 2, 2, 2];

/// Number of smoothing passes over holes.
const SMOOTHING_PASSES: usize = 32;

/// Directions to the eight neighbours of a texel.
const AROUND: [[isize; 2]; 8] = [[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, 1], [1, -1], [-1, -1]];

/// A grid of values in which some are still missing.
struct Field<'a> {
    values: &'a mut [f64],
    /// 0 for a known texel, else the layer in which it was filled, or [`MISSING`].
    layers: Vec<u8>,
    width: usize,
    /// Largest difference of an extrapolated value from the range of its neighbours.
    step: f64,
}

/// Layer of a texel that is not filled yet.
const MISSING: u8 = u8::MAX;

/// Fills the NaN texels of a grid with rows of `width`. Next to known texels values are extrapolated, to the
/// order that the known texels in a line allow and by up to `step` per texel. Farther away they are means of
/// their neighbours, and where `matters` (holes in a triangle) they are smoothed until they are nearly
/// harmonic. The result does not depend on the order of texels, except in that smoothing, which follows the
/// grid's. All texels become 0 if none is known.
pub(super) fn fill(values: &mut [f64], width: usize, step: f64, matters: impl Fn(usize) -> bool) {
    let known = values.iter().filter(|value| value.is_finite());
    let [low, high] = known.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(*v), h.max(*v)]);
    if low > high {
        values.fill(0.0);
        return;
    }
    let limits = [2.0 * low - high, 2.0 * high - low];
    let layers = values.iter().map(|value| if value.is_finite() { 0 } else { MISSING }).collect();
    let mut field = Field { values, layers, width, step };
    // A front of missing texels next to known ones moves outwards, a layer at a time. Values of a layer are
    // computed before any is stored, so they do not depend on the order.
    let mut front: Vec<usize> = (0..field.values.len())
        .filter(|at| field.layers[*at] == MISSING && field.around(*at, 1).any(|at| field.layers[at] == 0))
        .collect();
    let mut holes = Vec::new();
    let mut layer = 1;
    while !front.is_empty() {
        let order = EXTRAPOLATION_ORDERS.get(usize::from(layer) - 1);
        let value = |at: &usize| match order {
            Some(order) => field.extrapolated(*at, *order).clamp(limits[0], limits[1]),
            None => field.mean(*at),
        };
        let filled: Vec<f64> = front.iter().map(value).collect();
        for (at, value) in front.iter().zip(filled) {
            field.values[*at] = value;
            field.layers[*at] = layer;
        }
        if order.is_none() {
            holes.extend(front.iter().copied().filter(|at| matters(*at)));
        }
        let mut next: Vec<usize> = front
            .iter()
            .flat_map(|at| field.around(*at, 1).filter(|at| field.layers[*at] == MISSING).collect::<Vec<_>>())
            .collect();
        next.sort_unstable();
        next.dedup();
        front = next;
        layer = (layer + 1).min(MISSING - 1);
    }
    // Gauss–Seidel iterations of Laplace's equation over the holes.
    holes.sort_unstable();
    for _ in 0..SMOOTHING_PASSES {
        for at in &holes {
            field.values[*at] = field.mean(*at);
        }
    }
}

impl Field<'_> {
    /// Returns the texel `steps` away in a direction, if it is in the grid.
    fn toward(&self, at: usize, [dx, dy]: [isize; 2], steps: isize) -> Option<usize> {
        let (width, height) = (self.width as isize, (self.values.len() / self.width) as isize);
        let (x, y) = (at as isize % width + dx * steps, at as isize / width + dy * steps);
        ((0..width).contains(&x) && (0..height).contains(&y)).then(|| (y * width + x) as usize)
    }

    /// Iterates over the texels `steps` away in the eight directions.
    fn around(&self, at: usize, steps: isize) -> impl Iterator<Item = usize> {
        AROUND.into_iter().filter_map(move |direction| self.toward(at, direction, steps))
    }

    /// Returns the value of the texel `steps` away in a direction, if it is known or filled.
    fn filled(&self, at: usize, direction: [isize; 2], steps: isize) -> Option<f64> {
        let at = self.toward(at, direction, steps)?;
        (self.layers[at] != MISSING).then(|| self.values[at])
    }

    /// Returns the mean of the extrapolations, of an order up to `highest`, from the directions with the most
    /// known texels in a line.
    fn extrapolated(&self, at: usize, highest: u32) -> f64 {
        let mut best = (0, 0.0, 0.0);
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for direction in AROUND {
            let [a, b, c] = [1, 2, 3].map(|steps| self.filled(at, direction, steps));
            // Quadratic, linear and constant extrapolation.
            let (order, value) = match (a, b, c) {
                (Some(a), Some(b), Some(c)) if highest >= 3 => (3, 3.0 * (a - b) + c),
                (Some(a), Some(b), _) => (2, 2.0 * a - b),
                (Some(a), None, _) => (1, a),
                (None, ..) => continue,
            };
            range = a.map_or(range, |a| [range[0].min(a), range[1].max(a)]);
            if order > best.0 {
                best = (order, 0.0, 0.0);
            }
            if order == best.0 {
                best = (order, best.1 + value, best.2 + 1.0);
            }
        }
        (best.1 / best.2).clamp(range[0] - self.step, range[1] + self.step)
    }

    /// Returns the mean of the known and filled neighbours.
    fn mean(&self, at: usize) -> f64 {
        let known = self.around(at, 1).filter(|at| self.layers[*at] != MISSING);
        let (sum, count) = known.fold((0.0, 0.0), |(sum, count), at| (sum + self.values[at], count + 1.0));
        sum / count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadratic_goes_on_next_to_known_texels() {
        let value = |at: usize| {
            let (x, y) = ((at % 12) as f64, (at / 12) as f64);
            0.02 * x * x - 0.03 * x * y + y
        };
        let is_known = |at: usize| (3..9).contains(&(at % 12)) && (3..9).contains(&(at / 12));
        let mut values: Vec<f64> =
            (0..144).map(|at| if is_known(at) { value(at) } else { f64::NAN }).collect();
        fill(&mut values, 12, f64::INFINITY, |_| false);
        for (at, filled) in values.into_iter().enumerate() {
            assert!(filled.is_finite());
            if (1..11).contains(&(at % 12)) && (1..11).contains(&(at / 12)) {
                assert!((filled - value(at)).abs() < 1e-9, "{at}: {filled} {}", value(at));
            }
        }
    }

    #[test]
    fn extrapolation_of_steep_values_is_limited() {
        // The slope grows towards the end of the known texels.
        let known = |x: usize| if x < 6 { 2f64.powi(x as i32) } else { f64::NAN };
        let mut values: Vec<f64> = (0..120).map(|at| known(at % 12)).collect();
        fill(&mut values, 12, 1.5, |_| false);
        let largest = values.iter().copied().fold(0.0, f64::max);
        assert!((33.5..=39.5).contains(&largest), "{largest}");
    }

    #[test]
    fn hole_is_filled_from_its_surroundings_and_an_empty_grid_with_zeros() {
        let is_known = |at: usize| at % 20 < 4 || at % 20 > 15 || at / 20 < 4 || at / 20 > 15;
        let mut values: Vec<f64> =
            (0..400).map(|at| if is_known(at) { (at % 20) as f64 } else { f64::NAN }).collect();
        fill(&mut values, 20, 2.0, |_| true);
        for (at, filled) in values.into_iter().enumerate() {
            assert!((filled - (at % 20) as f64).abs() < 1.0, "{at}: {filled}");
        }
        let mut nothing = vec![f64::NAN; 6];
        fill(&mut nothing, 3, 1.0, |_| true);
        assert_eq!(nothing, [0.0; 6]);
    }
}
