//! The lines of an OBJ file that bear on the surface, in a form that `tobj` reads rightly.

use std::fmt::Display;
use std::io::{self, BufRead, Read, Write};

use super::fault::{Untextured, check_corners};
use super::lines::{Counts, Lines, words};
use crate::formats::surface::Skipped;
use crate::formats::text::parse_number;

/// The input of `tobj` in place of the file, line by line. Each vertex has its number in the file, from 0, as
/// its colour.
pub(super) struct Feed<'a> {
    lines: Lines<'a>,
    textured: bool,
    faces_per_model: usize,
    /// The line that `tobj` is reading.
    line: Vec<u8>,
    /// Number of bytes of the line read so far.
    read: usize,
    /// Vertices and texture coordinates so far.
    pub counts: Counts,
    pub faces: usize,
    pub skipped: Skipped,
    pub untextured: Untextured,
}

impl<'a> Feed<'a> {
    pub(super) fn new(bytes: &'a [u8], textured: bool, faces_per_model: usize) -> Self {
        Self {
            lines: Lines::new(bytes),
            textured,
            faces_per_model,
            line: Vec::new(),
            read: 0,
            counts: Counts::default(),
            faces: 0,
            skipped: Skipped::default(),
            untextured: Untextured::default(),
        }
    }

    /// Makes the next line. An error stops `tobj`; [`first_fault`](super::fault::first_fault) then finds its
    /// reason.
    fn advance(&mut self) -> io::Result<()> {
        let out = &mut self.line;
        out.clear();
        self.read = 0;
        while out.is_empty() {
            let Some((number, line)) = self.lines.next() else { return Ok(()) };
            let mut words = words(line);
            let keyword = words.next();
            match keyword {
                Some(b"v") => {
                    put_numbers("v", words.take(3), out);
                    put_number(self.counts.vertices, out);
                    out.extend_from_slice(b" 0 0");
                }
                Some(b"vt") if self.textured => {
                    let mut given = words.take(2).peekable();
                    let missing_v = given.peek().map(|_| b"0".as_slice());
                    put_numbers("vt", given.chain(missing_v).take(2), out);
                }
                Some(b"f" | b"fo") => {
                    out.push(b'f');
                    if words.map(|corner| put(needed(corner, self.textured), out)).count() < 3 {
                        out.clear();
                        self.skipped.incomplete.push(number);
                        continue;
                    }
                    if self.textured {
                        let missing = check_corners(line, true, self.counts, None)
                            .map_err(|_| io::ErrorKind::InvalidData)?;
                        self.untextured.count(missing, number);
                    }
                    self.faces += 1;
                    if self.faces.is_multiple_of(self.faces_per_model) {
                        out.extend_from_slice(b"\no");
                    }
                }
                Some(b"l") => self.skipped.lines += 1,
                Some(b"p") => self.skipped.points += 1,
                Some(b"curv" | b"curv2" | b"surf") => self.skipped.freeform += 1,
                _ => {}
            }
            self.counts.add(keyword);
        }
        // `tobj` splits words at spaces that are not ASCII, too.
        if !out.is_ascii() {
            return Err(io::ErrorKind::InvalidData.into());
        }
        out.push(b'\n');
        Ok(())
    }
}

impl BufRead for Feed<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.read == self.line.len() {
            self.advance()?;
        }
        Ok(&self.line[self.read..])
    }

    fn consume(&mut self, bytes: usize) {
        self.read += bytes;
    }
}

impl Read for Feed<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.fill_buf()?.read(buffer)?;
        self.consume(read);
        Ok(read)
    }
}

fn put(word: &[u8], line: &mut Vec<u8>) {
    line.push(b' ');
    line.extend_from_slice(word);
}

/// The start of a face's corner (`7`, `7/1`, `7/1/3`) up to its vertex, or its texture coordinate.
fn needed(corner: &[u8], textured: bool) -> &[u8] {
    let mut slashes = corner.iter().enumerate().filter(|(_, b)| **b == b'/').map(|(at, _)| at);
    match slashes.nth(usize::from(textured)) {
        // Without a vertex, the corner is left for `tobj` to refuse.
        Some(end @ 1..) => &corner[..end],
        _ => corner,
    }
}

/// Appends a keyword and numbers; those with a `#`, such as `1.#IND`, as Rust writes them.
fn put_numbers<'a>(keyword: &str, words: impl Iterator<Item = &'a [u8]>, line: &mut Vec<u8>) {
    line.extend_from_slice(keyword.as_bytes());
    for word in words {
        match word.contains(&b'#').then(|| parse_number(word)).flatten() {
            Some(number) => put_number(number, line),
            None => put(word, line),
        }
    }
}

fn put_number(number: impl Display, line: &mut Vec<u8>) {
    write!(line, " {number}").expect("a vector takes what is written");
}
