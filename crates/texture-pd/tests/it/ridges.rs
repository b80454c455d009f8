//! Two blocks with the same parallel ridges, as in §4.5.2: shifted along and across the ridges, and rotated
//! on each other.
//!
//! Depths are smooth maxima with a temperature of some µm. Interlocked ridges fit everywhere at once, so the
//! place of the largest overlap is arbitrary there, and its gradient jumps from flank to flank.

#![allow(clippy::print_stdout, reason = "it prints what it finds")]

use std::f64::consts::TAU;

use crate::common::{Plates, turned_over};
use glam::{DVec2, DVec3};
use palpate_core::Pose;
use palpate_texture_pd::{
    CpuBackend, DepthQuery, DepthSettings, SurfaceId, SurfaceSet, TextureContact, TextureDepth,
};

/// Spacing and half the height of the ridges, m. They lie along y.
const SPACING: f64 = 0.004;
const AMPLITUDE: f64 = 0.0003;
/// Half the side of the blocks' contact, m: four ridges.
const WINDOW: f64 = 0.008;
/// Temperature τ, m, and texels along a side of the grid. On top of a ridge overlaps stay within τ for more
/// than a texel, so the sum over texels does not depend on their position.
const TEMPERATURE: f64 = 15e-6;
const GRID: u32 = 200;
/// Depth of interlocked blocks, without the part that a smooth maximum adds, m.
const PRESSED: f64 = 0.0001;

fn relief(at: DVec2) -> f64 {
    AMPLITUDE * (TAU * at.x / SPACING).cos()
}

const BLOCKS: Plates = Plates { half: 0.02, relief_a: &relief, relief_b: &relief };

struct Blocks {
    surfaces: SurfaceSet,
    ids: [SurfaceId; 2],
    query: DepthQuery,
}

impl Blocks {
    fn new() -> Self {
        let (surfaces, ids) = BLOCKS.surfaces(512);
        Self { surfaces, ids, query: DepthQuery::new() }
    }

    /// Depth of block A shifted from where it stands ridge on ridge, and rotated about n, at the height at
    /// which interlocked blocks have the depth [`PRESSED`].
    fn depth(&mut self, shift: DVec2, turn: f64) -> TextureDepth {
        let pose: Pose = turned_over(shift, -PRESSED, DVec3::Z * turn);
        let contact = TextureContact { center: pose.translation, ..BLOCKS.contact(self.ids, pose, WINDOW) };
        let settings = DepthSettings { grid: GRID, temperature: TEMPERATURE, ..DepthSettings::default() };
        let found = self.query.run(&self.surfaces, &[contact], &settings, &mut CpuBackend::new());
        found.unwrap()[0].unwrap()
    }
}

/// Texture force for a stiffness of 1 N/m (Eq. 4.12).
fn force(found: &TextureDepth) -> DVec3 {
    -found.depth * found.linear
}

#[test]
fn no_force_along_the_ridges() {
    let mut blocks = Blocks::new();
    let (mut along, mut across) = (0.0_f64, 0.0_f64);
    for row in 0..8 {
        for column in 0..16 {
            let shift = DVec2::new(f64::from(column) / 16.0 * SPACING, f64::from(row) / 8.0 * SPACING);
            let force = force(&blocks.depth(shift, 0.0));
            along = along.max(force.y.abs());
            across = across.max(force.x.abs());
        }
    }
    println!("largest force along the ridges {along:.2e} N, across {across:.2e} N");
    assert!(along < 0.01 * across, "{along} along, {across} across");
}

#[test]
fn block_pulled_across_the_ridges_moves_in_steps() {
    let mut blocks = Blocks::new();
    // One period from ridge on ridge, at a fixed height.
    let count: usize = 80;
    let found: Vec<TextureDepth> = (0..count)
        .map(|index| blocks.depth(DVec2::X * (SPACING * index as f64 / count as f64), 0.0))
        .collect();
    // The largest overlap is 2 a |cos|; the smooth maximum adds a few temperatures.
    for (index, found) in found.iter().enumerate() {
        let phase = std::f64::consts::PI * index as f64 / count as f64;
        let overlap = PRESSED + 2.0 * AMPLITUDE * phase.cos().abs();
        assert!((found.depth - overlap).abs() < 10.0 * TEMPERATURE, "{index}: {} for {overlap}", found.depth);
        // The force points away from the ridges, towards where they interlock.
        if ![0, count / 2].contains(&index) {
            assert!(
                force(found).x * (0.5 - index as f64 / count as f64) > 0.0,
                "{index}: {:?}",
                found.linear
            );
        }
    }
    // A constant force presses the blocks together, so the depth is constant and the height follows from it.
    // A spring with a moving end pulls block A slowly, against a damper.
    let (pressing, stiffness, damping, step) = (1.0, 200.0, 20.0, 1e-3);
    let speed = 0.002;
    let value = |at: f64, of: &dyn Fn(&TextureDepth) -> f64| {
        let place = (at / SPACING).rem_euclid(1.0) * count as f64;
        let [low, high] = [0, 1].map(|next| of(&found[(place as usize + next) % count]));
        low + place.fract() * (high - low)
    };
    let mut at = 0.5 * SPACING;
    let (mut slow, mut fast, mut heights) = (0, 0, Vec::new());
    let steps = (4.0 * SPACING / speed / step) as usize;
    for index in 0..steps {
        let end = 0.5 * SPACING + speed * index as f64 * step;
        let pull = stiffness * (end - at) - pressing * value(at, &|found| found.linear.x);
        slow += usize::from(pull / damping < 0.5 * speed);
        fast += usize::from(pull / damping > 5.0 * speed);
        at += step * pull / damping;
        heights.push(value(at, &|found| found.depth));
    }
    let raised = |&height: &f64| height > PRESSED + AMPLITUDE;
    let tops = heights.windows(2).filter(|pair| !raised(&pair[0]) && raised(&pair[1])).count();
    println!("{slow} of {steps} steps at rest, {fast} fast; {tops} ridges passed");
    assert!(2 * slow > steps, "{slow} of {steps}");
    assert!(fast > 0 && 10 * fast < steps, "{fast} of {steps}");
    assert!((2..=4).contains(&tops), "{tops}");
}

#[test]
fn interlocked_block_rises_as_it_is_rotated_and_is_turned_back() {
    let mut blocks = Blocks::new();
    let interlocked = DVec2::X * (0.5 * SPACING);
    let straight = blocks.depth(interlocked, 0.0);
    // Up to the angle at which the contact's ends stand ridge on ridge.
    let most = 0.5 * SPACING / WINDOW;
    for sign in [-1.0, 1.0] {
        let mut last = straight.depth;
        for index in 1..=12 {
            let turn = sign * most * f64::from(index) / 15.0;
            let found = blocks.depth(interlocked, turn);
            assert!(found.depth > last, "turned by {turn}: {} after {last}", found.depth);
            let torque = -found.depth * found.angular.z;
            assert!(torque * sign < 0.0, "turned by {turn}: {torque}");
            last = found.depth;
        }
        let rise = last - straight.depth;
        println!("turned by {:.3} rad it rises by {:.3} mm", sign * most * 0.8, 1e3 * rise);
        assert!(rise > AMPLITUDE, "{rise}");
    }
    // Without rotation there is no torque.
    let turned = blocks.depth(interlocked, 0.1 * most);
    assert!(straight.angular.z.abs() < 0.01 * turned.angular.z.abs(), "{straight:?}");
}
