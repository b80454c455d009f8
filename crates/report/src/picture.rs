//! Pictures with 8 bits per channel in sRGB, written as PNG.

use std::io;
use std::path::Path;

/// A picture, stored in rows from the top, each from the left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    width: u32,
    pixels: Vec<[u8; 3]>,
}

impl Picture {
    /// Creates a picture of one colour.
    pub fn filled(width: u32, height: u32, color: [u8; 3]) -> Self {
        Self { width, pixels: vec![color; width as usize * height as usize] }
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.pixels.len().checked_div(self.width as usize).unwrap_or(0) as u32
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> &[[u8; 3]] {
        &self.pixels
    }

    /// All pixels, row by row, mutable.
    pub fn pixels_mut(&mut self) -> &mut [[u8; 3]] {
        &mut self.pixels
    }

    /// Returns the pixel in a column and a row.
    ///
    /// # Panics
    /// If it is outside the picture.
    pub fn pixel(&self, column: u32, row: u32) -> [u8; 3] {
        self.pixels[self.index(column, row)]
    }

    /// Sets the pixel in a column and a row; pixels outside the picture are ignored.
    pub fn set(&mut self, column: u32, row: u32, color: [u8; 3]) {
        if column < self.width && row < self.height() {
            let index = self.index(column, row);
            self.pixels[index] = color;
        }
    }

    /// Copies another picture into this one with its top left corner in a column and a row; parts outside are
    /// clipped.
    pub fn place(&mut self, other: &Self, left: u32, top: u32) {
        for row in 0..other.height() {
            for column in 0..other.width {
                self.set(left + column, top + row, other.pixel(column, row));
            }
        }
    }

    /// Returns the picture at a smaller size. Each pixel is the mean of those that it covers, even in part.
    #[must_use]
    pub fn reduced(&self, width: u32, height: u32) -> Self {
        let covered = |index: u32, from: u32, to: u32| {
            let end = ((index + 1) * from).div_ceil(to).min(from);
            (index * from / to)..end
        };
        let mut reduced = Self::filled(width, height, [0; 3]);
        for row in 0..height {
            let rows = covered(row, self.height(), height);
            for column in 0..width {
                let columns = covered(column, self.width, width);
                let mut sum = [0; 3];
                for y in rows.clone() {
                    for x in columns.clone() {
                        let pixel = self.pixel(x, y);
                        (0..3).for_each(|channel| sum[channel] += u32::from(pixel[channel]));
                    }
                }
                let count = (rows.len() * columns.len()).max(1) as u32;
                reduced.set(column, row, sum.map(|sum| ((sum + count / 2) / count) as u8));
            }
        }
        reduced
    }

    /// Encodes the picture as a PNG file.
    ///
    /// # Errors
    /// If it cannot be encoded, for example because it has no pixels.
    pub fn to_png(&self) -> io::Result<Vec<u8>> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.width, self.height());
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_compression(png::Compression::High);
        encoder.write_header()?.write_image_data(self.pixels.as_flattened())?;
        Ok(file)
    }

    /// Writes the picture to a PNG file.
    ///
    /// # Errors
    /// If it cannot be encoded or written.
    pub fn save(&self, path: &Path) -> io::Result<()> {
        std::fs::write(path, self.to_png()?)
    }

    fn index(&self, column: u32, row: u32) -> usize {
        row as usize * self.width as usize + column as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient(width: u32, height: u32) -> Picture {
        let mut picture = Picture::filled(width, height, [0; 3]);
        for row in 0..height {
            for column in 0..width {
                picture.set(column, row, [column as u8, row as u8, (column * row) as u8]);
            }
        }
        picture
    }

    #[test]
    fn png_holds_the_picture() {
        let picture = gradient(7, 5);
        let read = image::load_from_memory(&picture.to_png().expect("PNG")).expect("a picture").to_rgb8();
        assert_eq!(read.dimensions(), (picture.width(), picture.height()));
        assert!(read.pixels().map(|pixel| pixel.0).eq(picture.pixels().iter().copied()));
        assert!(Picture::filled(0, 3, [0; 3]).to_png().is_err());
    }

    #[test]
    fn reduced_picture_has_the_means() {
        let reduced = gradient(8, 4).reduced(4, 2);
        // The mean of columns 2 and 3, and of rows 2 and 3: halves are rounded up.
        assert_eq!(reduced.pixel(1, 1)[..2], [3, 3]);
        assert_eq!(Picture::filled(9, 9, [200, 3, 77]).reduced(4, 2), Picture::filled(4, 2, [200, 3, 77]));
    }

    #[test]
    fn placed_picture_is_clipped() {
        let mut picture = Picture::filled(4, 4, [9; 3]);
        picture.place(&gradient(3, 3), 2, 3);
        assert_eq!(
            (picture.pixel(3, 3), picture.pixel(1, 3), picture.pixel(3, 2)),
            ([1, 0, 0], [9; 3], [9; 3])
        );
    }
}
