//! Rectangular windows in structured patches, and round openings made of them.

use palpate_core::glam::DVec2;

/// A rectangular opening in a grid: the cells from `low` up to below `high`.
#[derive(Clone, Copy)]
pub(crate) struct Window {
    pub(crate) low: [usize; 2],
    pub(crate) high: [usize; 2],
}

impl Window {
    /// Vertices along its border.
    pub(crate) const fn border(&self) -> usize {
        2 * (self.high[0] - self.low[0] + self.high[1] - self.low[1])
    }

    pub(crate) const fn cells(&self) -> usize {
        (self.high[0] - self.low[0]) * (self.high[1] - self.low[1])
    }

    /// Cells along each axis.
    pub(crate) const fn size(&self) -> [usize; 2] {
        [self.high[0] - self.low[0], self.high[1] - self.low[1]]
    }

    pub(crate) const fn holds_cell(&self, i: usize, j: usize) -> bool {
        self.low[0] <= i && i < self.high[0] && self.low[1] <= j && j < self.high[1]
    }

    pub(crate) const fn holds_node(&self, i: usize, j: usize) -> bool {
        self.low[0] < i && i < self.high[0] && self.low[1] < j && j < self.high[1]
    }

    /// The nodes along the border, from the low corner along the first axis, then the second, and back.
    pub(crate) fn nodes(&self) -> impl Iterator<Item = [usize; 2]> {
        let ([i0, j0], [i1, j1]) = (self.low, self.high);
        (i0..i1)
            .map(move |i| [i, j0])
            .chain((j0..j1).map(move |j| [i1, j]))
            .chain((i0 + 1..=i1).rev().map(move |i| [i, j1]))
            .chain((j0 + 1..=j1).rev().map(move |j| [i0, j]))
    }
}

/// A window whose border is deformed into an ellipse, with the grid around it: coordinates are lengths on the
/// plain surface.
pub(crate) struct Opening {
    /// Middle of the window on the plain grid.
    pub(crate) center: DVec2,
    /// Middle of the ellipse.
    pub(crate) middle: DVec2,
    /// Half the window's size on the plain grid.
    pub(crate) half: DVec2,
    /// Half axes of the ellipse.
    pub(crate) radii: DVec2,
    /// Extent of the displaced grid, in multiples of `half` along each axis (above 1 each).
    pub(crate) reach: f64,
}

impl Opening {
    /// An ellipse about `middle` for a window with the given low and high corner on the plain grid, in
    /// `cells` cells. The grid is displaced up to `room` from the window's middle, and on a coarse grid as
    /// far as needed to keep its cells open.
    pub(crate) fn new(
        [low, high]: [DVec2; 2],
        cells: [usize; 2],
        middle: DVec2,
        radii: DVec2,
        room: f64,
    ) -> Self {
        let (center, half) = (0.5 * (low + high), 0.5 * (high - low));
        let step = 2.0 * half / DVec2::new(cells[0] as f64, cells[1] as f64);
        let needed = ((middle - center).abs() + radii + 0.7 * step) / half;
        let reach = (room / half.max_element()).max(needed.max_element());
        Self { center, middle, half, radii, reach }
    }

    /// Displaced position of a point of the plain grid outside the window.
    pub(crate) fn displace(&self, point: DVec2) -> DVec2 {
        let scaled = (point - self.center) / self.half;
        let distance = scaled.abs().max_element();
        if distance >= self.reach || distance == 0.0 {
            return point;
        }
        let part = (distance - 1.0) / (self.reach - 1.0);
        let on_square = scaled / distance;
        let border = self.middle + self.radii * circle(on_square);
        border.lerp(self.center + self.reach * self.half * on_square, part)
    }

    /// Direction, on the unit circle, of a node on the window's border or outside it.
    pub(crate) fn direction(&self, point: DVec2) -> DVec2 {
        circle((point - self.center) / self.half)
    }
}

/// Draws the square from -1 to 1 out into the unit disc, concentric squares into concentric circles (P.
/// Shirley and K. Chiu 1997). Each axis stays where it is, and cells keep their area: none is crushed at the
/// corners.
pub(crate) fn disc(in_square: DVec2) -> DVec2 {
    let size = in_square.abs().max_element();
    if size == 0.0 { DVec2::ZERO } else { size * circle(in_square / size) }
}

/// The point of the unit circle for a direction that is spaced evenly along a square.
fn circle(on_square: DVec2) -> DVec2 {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
    let DVec2 { x, y } = on_square;
    let angle = if x.abs() >= y.abs() {
        FRAC_PI_4 * y / x + if x < 0.0 { 2.0 * FRAC_PI_2 } else { 0.0 }
    } else {
        FRAC_PI_2 - FRAC_PI_4 * x / y + if y < 0.0 { 2.0 * FRAC_PI_2 } else { 0.0 }
    };
    DVec2::from_angle(angle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_opening_is_round_and_does_not_move_the_rest() {
        let opening = Opening {
            center: DVec2::new(1.0, 2.0),
            middle: DVec2::new(1.2, 1.9),
            half: DVec2::new(2.0, 3.0),
            radii: DVec2::new(2.5, 2.5),
            reach: 2.0,
        };
        let window = Window { low: [0, 0], high: [4, 6] };
        assert_eq!(window.nodes().count(), window.border());
        let mut turns = 0.0;
        let mut last: Option<DVec2> = None;
        for [i, j] in window.nodes().chain([[0, 0]]) {
            let plain = DVec2::new(i as f64 - 1.0, j as f64 - 1.0);
            let moved = opening.displace(plain) - opening.middle;
            assert!((moved.length() - 2.5).abs() < 1e-12, "{plain} comes to lie {moved} from the centre");
            assert!(moved.distance(2.5 * opening.direction(plain)) < 1e-12);
            turns += last.map_or(0.0, |last| last.angle_to(moved)) / std::f64::consts::TAU;
            last = Some(moved);
        }
        assert!((turns - 1.0).abs() < 1e-12, "the border goes {turns} times around");
        let far = DVec2::new(5.0, 2.5);
        assert!(opening.displace(far).distance(far) < 1e-12);
    }
}
