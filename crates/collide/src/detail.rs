//! The detail that a node leaves out (§3.4.3), for the refinement test.

use palpate_core::Clod;
use palpate_core::clod::Node;

/// Smallest, largest and mean support area D of the extreme points of a patch, in a unit of the hierarchy:
/// the first two are rounded outwards, so that they remain bounds, and the mean to 2⁻²⁴.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SupportAreas([f32; 3]);

impl SupportAreas {
    /// The support areas of a node, in units of `unit`, m².
    pub fn of(clod: &Clod, node: &Node, unit: f64) -> Self {
        let areas = || clod.support_areas(node).iter().take(node.extreme as usize);
        let least = areas().fold(f64::INFINITY, f64::min) / unit;
        let largest = areas().fold(0.0, f64::max) / unit;
        let mean = areas().sum::<f64>() / f64::from(node.extreme.max(1)) / unit;
        let (low, high) = (least as f32, largest as f32);
        let low = if f64::from(low) > least { low.next_down() } else { low };
        let high = if f64::from(high) < largest { high.next_up() } else { high };
        Self([low, high, mean as f32].map(|area| area.min(f32::MAX)))
    }
}

/// Values of a node for the refinement test.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Detail {
    /// φ = s/r² (Eq. 3.6), m³: 0 at full resolution, infinite on free levels, which always have to be
    /// refined.
    pub missing: f64,
    /// Resolution of the children's level, 1/m: 0 if that is free, infinite without children.
    pub child_resolution: f64,
    /// Smallest D of the patch's extreme points, m².
    pub least_area: f64,
    /// Largest D of the patch's extreme points, m².
    pub largest_area: f64,
    /// Mean D of the patch's extreme points, m².
    pub mean_area: f64,
}

impl Detail {
    /// The detail of a node whose support areas are in units of `unit`, m².
    pub fn of(clod: &Clod, node: &Node, areas: &SupportAreas, unit: f64) -> Self {
        let level = &clod.levels[node.level as usize];
        let missing = if level.free {
            f64::INFINITY
        } else if node.children.is_empty() || node.deviation == 0.0 {
            0.0
        } else {
            node.deviation / (level.resolution * level.resolution)
        };
        let child_resolution = if node.children.is_empty() {
            f64::INFINITY
        } else {
            let level = &clod.levels[node.level as usize - 1];
            if level.free { 0.0 } else { level.resolution }
        };
        let [least_area, largest_area, mean_area] = areas.0.map(|area| unit * f64::from(area));
        Self { missing, child_resolution, least_area, largest_area, mean_area }
    }
}
