//! A batch of pairs of height patches, and what comes of a pair.

use thiserror::Error;

/// The largest grid: texels along a side of a patch.
pub const MAX_GRID: u32 = 4096;
/// The most heights in a batch: a gibibyte of them.
const MAX_HEIGHTS: usize = 1 << 28;

/// Why a batch could not be put together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum PairsError {
    /// The grid is empty or too fine.
    #[error("a grid of {size} × {size} texels; give a size from 1 to {MAX_GRID}")]
    Size {
        /// Texels along a side.
        size: u32,
    },
    /// A patch's heights do not fill the grid.
    #[error(
        "a patch of {found} heights on a grid of {expected} texels; give one height a texel, NaN for none"
    )]
    Heights {
        /// How many heights were given.
        found: usize,
        /// How many texels there are.
        expected: usize,
    },
    /// A pair names a patch that the batch does not hold.
    #[error(
        "patch {patch} in a batch of {patches}; pair patches that were added since the batch was last cleared"
    )]
    Patch {
        /// The patch.
        patch: u32,
        /// How many there are.
        patches: u32,
    },
    /// The batch would hold too many heights.
    #[error("a batch of more than {MAX_HEIGHTS} heights; evaluate it in parts")]
    TooLarge,
}

/// A patch of a [`PatchPairs`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Patch(u32);

/// Height patches over grids of the same size, and the pairs of them to evaluate. A patch may be in many pairs,
/// as B is in the eleven configurations of A that differencing takes (§4.4.2).
///
/// A height is n · x in metres, for **n** pointing out of A; row after row, the texel in column i and row j at
/// index j·size + i. A height that is NaN, infinite, or 2⁶⁴ m and beyond means that the patch has no surface at
/// that texel.
#[derive(Clone, Debug)]
pub struct PatchPairs {
    size: u32,
    heights: Vec<f32>,
    /// For each pair, the index of A's and of B's first height: the layout that the kernels bind.
    pairs: Vec<[u32; 2]>,
}

impl PatchPairs {
    /// An empty batch for grids of `size` × `size` texels.
    pub fn new(size: u32) -> Result<Self, PairsError> {
        if !(1..=MAX_GRID).contains(&size) {
            return Err(PairsError::Size { size });
        }
        Ok(Self { size, heights: Vec::new(), pairs: Vec::new() })
    }

    /// Texels along a side.
    pub fn size(&self) -> u32 {
        self.size
    }

    /// How many pairs there are to evaluate.
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Whether there is no pair to evaluate.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Forgets patches and pairs and keeps the memory.
    pub fn clear(&mut self) {
        self.heights.clear();
        self.pairs.clear();
    }

    /// Adds a patch by its heights, m.
    pub fn add_patch(&mut self, heights: &[f32]) -> Result<Patch, PairsError> {
        let expected = self.texels() as usize;
        if heights.len() != expected {
            return Err(PairsError::Heights { found: heights.len(), expected });
        }
        if self.heights.len() + expected > MAX_HEIGHTS {
            return Err(PairsError::TooLarge);
        }
        let patch = Patch(self.patches());
        self.heights.extend_from_slice(heights);
        Ok(patch)
    }

    /// Adds a pair to evaluate: A, whose outward direction is **n**, and B.
    pub fn add_pair(&mut self, a: Patch, b: Patch) -> Result<(), PairsError> {
        let patches = self.patches();
        if let Some(&Patch(patch)) = [a, b].iter().find(|patch| patch.0 >= patches) {
            return Err(PairsError::Patch { patch, patches });
        }
        if self.pairs.len() >= MAX_HEIGHTS {
            return Err(PairsError::TooLarge);
        }
        self.pairs.push([a.0 * self.texels(), b.0 * self.texels()]);
        Ok(())
    }

    /// Texels of a patch.
    pub(crate) fn texels(&self) -> u32 {
        self.size * self.size
    }

    fn patches(&self) -> u32 {
        (self.heights.len() / self.texels() as usize) as u32
    }

    pub(crate) fn heights(&self) -> &[f32] {
        &self.heights
    }

    pub(crate) fn pairs(&self) -> &[[u32; 2]] {
        &self.pairs
    }

    /// What a kernel's answer, bits of the depth and texel, says.
    pub(crate) fn decode(&self, [depth, texel]: [u32; 2]) -> Option<DirectionalDepth> {
        (texel < self.texels()).then(|| DirectionalDepth {
            depth: f32::from_bits(depth),
            column: texel % self.size,
            row: texel / self.size,
        })
    }
}

/// The directional penetration depth of a pair and where it is reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectionalDepth {
    /// δ_n, m; negative, minus the gap along **n**, when the patches do not overlap.
    pub depth: f32,
    /// Column of the texel where it is reached; of several, the texel with the lowest index.
    pub column: u32,
    /// Row of that texel.
    pub row: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_batches_are_refused_with_what_to_do() {
        assert_eq!(PatchPairs::new(0).unwrap_err(), PairsError::Size { size: 0 });
        assert!(PatchPairs::new(4097).unwrap_err().to_string().contains("from 1 to 4096"));
        let mut pairs = PatchPairs::new(3).unwrap();
        assert!(
            pairs
                .add_patch(&[0.0; 8])
                .unwrap_err()
                .to_string()
                .starts_with("a patch of 8 heights on a grid of 9")
        );
        let patch = pairs.add_patch(&[0.0; 9]).unwrap();
        assert_eq!(pairs.add_pair(patch, Patch(1)), Err(PairsError::Patch { patch: 1, patches: 1 }));
        pairs.add_pair(patch, patch).unwrap();
        pairs.clear();
        assert!(pairs.is_empty());
        assert_eq!(pairs.add_pair(patch, patch), Err(PairsError::Patch { patch: 0, patches: 0 }));
    }
}
