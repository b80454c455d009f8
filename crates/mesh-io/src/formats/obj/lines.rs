//! The lines of an OBJ file and their words, split as `tobj` splits them.

/// Numbers of vertices and texture coordinates, in a file or before some line of it.
#[derive(Clone, Copy, Default)]
pub(super) struct Counts {
    pub vertices: usize,
    pub coordinates: usize,
}

impl Counts {
    /// Counts a line that starts with `keyword`.
    pub(super) fn add(&mut self, keyword: Option<&[u8]>) {
        match keyword {
            Some(b"v") => self.vertices += 1,
            Some(b"vt") => self.coordinates += 1,
            _ => {}
        }
    }
}

/// The lines of a file with their numbers; lines that a backslash continues are joined.
pub(super) struct Lines<'a> {
    rest: Option<&'a [u8]>,
    separator: u8,
    /// Number of the last line given (of its first part, if it was continued), from 1.
    number: usize,
    /// Lines taken from `rest`.
    taken: usize,
    joined: Vec<u8>,
}

impl<'a> Lines<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let separator = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
        Self { rest: Some(bytes), separator, number: 0, taken: 0, joined: Vec::new() }
    }

    pub(super) fn next(&mut self) -> Option<(usize, &[u8])> {
        let mut line = self.take()?;
        self.number = self.taken;
        if !line.ends_with(b"\\") {
            return Some((self.number, line));
        }
        self.joined.clear();
        while let Some(part) = line.strip_suffix(b"\\") {
            self.joined.extend_from_slice(part);
            self.joined.push(b' ');
            line = self.take().unwrap_or_default();
        }
        self.joined.extend_from_slice(line);
        Some((self.number, &self.joined))
    }

    fn take(&mut self) -> Option<&'a [u8]> {
        let rest = self.rest?;
        let end = rest.iter().position(|&b| b == self.separator);
        self.rest = end.map(|end| &rest[end + 1..]);
        self.taken += 1;
        Some(rest[..end.unwrap_or(rest.len())].trim_ascii())
    }
}

/// The words of a line before a comment, split as `tobj` splits them.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> + Clone {
    line.split(|b| matches!(b, b'\t'..=b'\r' | b' '))
        .filter(|word| !word.is_empty())
        .take_while(|word| !word.starts_with(b"#"))
}
