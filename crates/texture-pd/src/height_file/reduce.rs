//! Conversion of samples to displacements: to grey, averaged if the image is too large, and all finite.

use super::decode::{Raw, Samples};
use super::options::HeightOptions;

/// Weights of red, green and blue in luma (Rec. 709).
const LUMA: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Displacements, with a record of the conversions for warnings.
pub(super) struct Reduced {
    pub width: u32,
    pub height: u32,
    /// Displacements, m; NaN where no texel of the file was finite.
    pub values: Vec<f32>,
    /// Number of texels of the file that are not finite, and column and row of the first.
    pub missing: Option<(u64, [u32; 2])>,
    /// Side of the averaged blocks, in texels of the file.
    block: u32,
    coloured: bool,
    transparent: bool,
}

/// Converts samples to displacements, averaged over blocks if the image has more than `side` texels along a
/// side.
pub(super) fn reduce(raw: &Raw, options: &HeightOptions, side: u32) -> Reduced {
    let block = raw.width.max(raw.height).div_ceil(side);
    let (width, height) = (raw.width.div_ceil(block), raw.height.div_ceil(block));
    let mut reduced = Reduced {
        width,
        height,
        values: Vec::with_capacity(width as usize * height as usize),
        missing: None,
        block,
        coloured: false,
        transparent: false,
    };
    // If a side is not a multiple of the block's, some blocks are one texel shorter, so none is shifted by
    // more than that.
    let span = |at: u32, from: u32, to: u32| {
        let bound = |at: u32| (u64::from(at) * u64::from(from) / u64::from(to)) as u32;
        bound(at)..bound(at + 1)
    };
    for row in 0..height {
        for column in 0..width {
            let (mut sum, mut count) = (0.0, 0_u32);
            for y in span(row, raw.height, height) {
                for x in span(column, raw.width, width) {
                    if let Some(value) = reduced.grey(raw, x, y) {
                        sum += value;
                        count += 1;
                    }
                }
            }
            let displacement = (sum / f64::from(count) - options.midlevel) * options.amplitude;
            reduced.values.push(if count == 0 { f32::NAN } else { displacement as f32 });
        }
    }
    reduced
}

impl Reduced {
    /// Returns the grey value of a texel, if it is finite.
    fn grey(&mut self, raw: &Raw, x: u32, y: u32) -> Option<f64> {
        let first = (y as usize * raw.width as usize + x as usize) * raw.channels;
        let sample = |channel: usize| raw.samples.value(first + channel);
        self.transparent |= raw.channels.is_multiple_of(2) && sample(raw.channels - 1) != 1.0;
        let value = if raw.channels < 3 {
            sample(0)
        } else {
            let colour = [sample(0), sample(1), sample(2)];
            if colour[0] == colour[1] && colour[1] == colour[2] {
                colour[0]
            } else {
                self.coloured |= colour.iter().all(|value| value.is_finite());
                LUMA.iter().zip(colour).map(|(weight, value)| weight * value).sum()
            }
        };
        if value.is_finite() {
            return Some(value);
        }
        // Texels are visited block by block, so the first one found need not be the first of the file.
        let (count, first) = self.missing.unwrap_or((0, [x, y]));
        let first = if [y, x] < [first[1], first[0]] { [x, y] } else { first };
        self.missing = Some((count + 1, first));
        None
    }

    /// Returns warnings about conversions that the user should know of, one line each.
    pub(super) fn warnings(&self, raw: &Raw, amplitude: f64) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.block > 1 {
            warnings.push(format!(
                "the image of {} x {} texels is averaged over blocks of up to {block} x {block} to {} x {}: finer detail is \
                 lost",
                raw.width,
                raw.height,
                self.width,
                self.height,
                block = self.block
            ));
        }
        if self.coloured {
            warnings
                .push("colours are turned into luma (Rec. 709): check that the image holds heights".into());
        }
        if self.transparent {
            warnings.push("the alpha channel is ignored".into());
        }
        if let Some((count, [column, row])) = self.missing {
            warnings.push(format!(
                "texels that are not finite numbers, filled in from the nearest ones that are: {count}, the first in column \
                 {column}, row {row}"
            ));
        }
        if !matches!(raw.samples, Samples::Float(_)) && raw.bits <= 8 {
            let bits = raw.bits;
            let step = amplitude / f64::from((1_u32 << bits) - 1);
            warnings.push(format!(
                "heights of {bits} bits come in steps of {step:.3e} m: 16 bits or floats are smoother"
            ));
        }
        if raw.is_lossy {
            warnings.push(
                "the file's compression changes heights from texel to texel: lossless files are smoother"
                    .into(),
            );
        }
        warnings
    }
}

/// Fills in NaN values layer by layer from their surroundings inwards. Each becomes the mean of those of its
/// neighbours that were known before its layer. Returns whether any value was known.
pub(super) fn fill(values: &mut [f32], width: usize) -> bool {
    let height = values.len() / width;
    let around = |at: usize| {
        let (x, y) = (at % width, at / width);
        (y.saturating_sub(1)..(y + 2).min(height)).flat_map(move |row| {
            (x.saturating_sub(1)..(x + 2).min(width)).map(move |column| row * width + column)
        })
    };
    let mut layer: Vec<usize> = (0..values.len())
        .filter(|&at| values[at].is_nan() && around(at).any(|near| !values[near].is_nan()))
        .collect();
    let mut filled = Vec::new();
    while !layer.is_empty() {
        filled.clear();
        filled.extend(layer.iter().map(|&at| {
            let near = || around(at).map(|near| values[near]).filter(|value| !value.is_nan());
            (near().map(f64::from).sum::<f64>() / near().count() as f64) as f32
        }));
        for (&at, &value) in layer.iter().zip(&filled) {
            values[at] = value;
        }
        layer = layer.iter().flat_map(|&at| around(at)).filter(|&at| values[at].is_nan()).collect();
        layer.sort_unstable();
        layer.dedup();
    }
    values.first().is_some_and(|value| !value.is_nan())
}
