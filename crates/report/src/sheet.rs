//! Contact sheets: pictures in rows, each with a caption below.

use crate::lettering;
use crate::picture::Picture;

/// A picture of a sheet, with its caption.
#[derive(Clone, Debug)]
pub struct Tile {
    /// Picture with an aspect ratio of four to three; it is reduced to fit.
    pub picture: Picture,
    /// Lines of the caption: lower case letters, digits, commas, full stops and hyphens; other characters
    /// leave gaps.
    pub caption: Vec<String>,
}

/// Colour of the sheet, sRGB.
const PAPER: [u8; 3] = [255; 3];
/// Colour of captions, sRGB.
const INK: [u8; 3] = [40; 3];
/// Height of a line of lettering with the space below it, dots.
const LINE_HEIGHT: u32 = 10;
/// Space between captions and pictures, dots.
const GAP: u32 = 4;

/// Arranges tiles in rows of `columns`, each `width` pixels wide, with `dot` pixels for a dot of the
/// lettering.
pub fn contact_sheet(tiles: &[Tile], columns: u32, width: u32, dot: u32) -> Picture {
    let columns = columns.clamp(1, (tiles.len() as u32).max(1));
    let rows = (tiles.len() as u32).div_ceil(columns);
    let height = width * 3 / 4;
    let lines = tiles.iter().map(|tile| tile.caption.len() as u32).max().unwrap_or(0);
    let pitch = height + (lines * LINE_HEIGHT + GAP) * dot;
    let mut sheet = Picture::filled(columns * width, rows * pitch, PAPER);
    for (index, tile) in (0..).zip(tiles) {
        let (left, top) = (index % columns * width, index / columns * pitch);
        sheet.place(&tile.picture.reduced(width, height), left, top);
        for (line, text) in (0..).zip(&tile.caption) {
            let indent = width.saturating_sub(lettering::width(text, dot)) / 2;
            let down = height + (GAP + line * LINE_HEIGHT) * dot;
            lettering::write(&mut sheet, text, left + indent, top + down, dot, INK);
        }
    }
    sheet
}
