//! What the contact loop sees, for those who look at it while it runs: a window, a host's debug view.
//!
//! It is handed over through a triple buffer, the latest wins: the contact loop neither waits for a watcher nor allocates for
//! one.

use palpate_core::Clod;
use palpate_core::glam::DVec3;

/// Most patches and pushes of one look; what is beyond them is left out.
const MOST: usize = 512;

/// Two patches that touch, or are within the tolerance of each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchingPatches {
    /// The scene object, by the number of its [`SceneId`](crate::SceneId).
    pub object: usize,
    /// The probe's patch: a node of its hierarchy, whose level says at which resolution it is felt.
    pub probe_node: u32,
    /// The scene object's.
    pub scene_node: u32,
    /// How much of the contact counts, 0 to 1: the rest is made up by finer patches.
    pub weight: f64,
}

/// A push on the probe: that of a cluster of contacts, or of a textured contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push {
    /// Where on the probe's surface, m; world axes.
    pub point: DVec3,
    /// Unit normal of the contact, out of the probe; world axes. Of a textured contact, the direction in which the depth
    /// grows fastest as the probe shifts.
    pub normal: DVec3,
    /// Penalty force on the probe, N: k(δ + d) along −`normal`, without damping and friction; world axes.
    pub force: DVec3,
    /// Penetration depth δ, m; negative where the surfaces are apart.
    pub depth: f64,
}

/// What one contact step saw.
#[derive(Clone, Debug, PartialEq)]
pub struct Sight {
    /// Time of the body state that it is about, s; NaN before the first.
    pub time: f64,
    /// The patches that touch.
    pub patches: Vec<TouchingPatches>,
    /// What pushes the probe.
    pub pushes: Vec<Push>,
}

impl Default for Sight {
    /// Nothing, with room for all that it may come to hold.
    fn default() -> Self {
        Self { time: f64::NAN, patches: Vec::with_capacity(MOST), pushes: Vec::with_capacity(MOST) }
    }
}

impl Sight {
    /// Empties it, for what is at `time` (s).
    fn clear(&mut self, time: f64) {
        self.time = time;
        self.patches.clear();
        self.pushes.clear();
    }

    /// Adds patches, if there is room.
    pub(crate) fn add_patches(&mut self, patches: TouchingPatches) {
        if self.patches.len() < MOST {
            self.patches.push(patches);
        }
    }

    /// Adds a push, if there is room.
    pub(crate) fn add_push(&mut self, push: Push) {
        if self.pushes.len() < MOST {
            self.pushes.push(push);
        }
    }
}

/// The colour of a level, wherever touching patches are shown: from red, the full mesh, to blue, the coarsest that can be felt. Red,
/// green, blue and opacity.
pub fn level_color(clod: &Clod, level: u32) -> [u8; 4] {
    let coarsest = clod.levels.iter().rposition(|level| !level.free).unwrap_or(0).max(1);
    let hue = 4.0 * (f64::from(level) / coarsest as f64).clamp(0.0, 1.0);
    // Red, yellow, green, cyan, blue.
    let channel = |peak: f64| ((2.0 - (hue - peak).abs()).clamp(0.0, 1.0) * 255.0).round() as u8;
    [channel(0.0), channel(2.0), channel(4.0), 255]
}

/// Watches the contacts of a session, from any thread. Made by [`HapticRenderer::watch`](crate::HapticRenderer::watch).
#[derive(Debug)]
pub struct Watch(triple_buffer::Output<Sight>);

impl Watch {
    /// The latest that was seen.
    pub fn latest(&mut self) -> &Sight {
        self.0.read()
    }
}

/// The side of the contact loop: a buffer for each watch. What is seen is written for the first, and copied to the others.
#[derive(Debug)]
pub(crate) struct Watched {
    first: triple_buffer::Input<Sight>,
    others: Vec<triple_buffer::Input<Sight>>,
}

impl Watched {
    pub fn new() -> (Self, Watch) {
        let (first, output) = triple_buffer::TripleBuffer::default().split();
        (Self { first, others: Vec::new() }, Watch(output))
    }

    /// One more watch.
    pub fn also(&mut self) -> Watch {
        let (input, output) = triple_buffer::TripleBuffer::default().split();
        self.others.push(input);
        Watch(output)
    }

    /// A new look at what is at `time` (s), empty.
    pub fn begin(&mut self, time: f64) -> &mut Sight {
        let sight = self.first.input_buffer_mut();
        sight.clear(time);
        sight
    }

    /// The look that was begun.
    pub fn sight(&mut self) -> &mut Sight {
        self.first.input_buffer_mut()
    }

    /// Hands over what was seen.
    pub fn show(&mut self) {
        let Self { first, others } = self;
        let seen = first.input_buffer_mut();
        for other in others {
            let copy = other.input_buffer_mut();
            copy.clear(seen.time);
            copy.patches.extend_from_slice(&seen.patches);
            copy.pushes.extend_from_slice(&seen.pushes);
            other.publish();
        }
        first.publish();
    }
}
