//! Recordings as files.
//!
//! Compact: `PALPDEV1`, the length (u32) of a JSON text and that text, `{"specification": …}`; then 128 bytes
//! a reading: now, the state's time, position, quaternion (x, y, z, w), velocity and angular velocity as f64,
//! buttons and status as u32, all little-endian. Text: the JSON behind `# `, a header, and a line a reading
//! with as many digits as it takes to read the same number back.
//!
//! A session may end in the middle of a reading: an incomplete last one is left out.

use std::fs::File;
use std::io::{BufWriter, Read as _, Write};
use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist};
use serde::{Deserialize, Serialize};

use super::{Reading, Recording, check};
use crate::{DeviceState, PathError, Specification, Status};

const MAGIC: &[u8; 8] = b"PALPDEV1";
const HEADER: &str = "now,t,px,py,pz,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz,buttons,status";
/// Count of numbers in a reading, and its size in bytes.
const READING_NUMBERS: usize = 15;
const READING_BYTES: usize = READING_NUMBERS * 8 + 8;
/// Largest accepted length of the JSON text, bytes; it is under a kilobyte in practice.
const MAX_JSON_BYTES: u32 = 1 << 16;

const REMEDY: &str = "give a file that --record-device has written";

#[derive(Serialize)]
struct About<'a> {
    specification: &'a Specification,
}

#[derive(Deserialize)]
struct Described {
    specification: Specification,
}

/// Writes readings to a file as they come: text where the file's name ends in `.csv`, else compact.
#[derive(Debug)]
pub struct RecordingWriter<W: Write> {
    output: BufWriter<W>,
    text: bool,
}

impl RecordingWriter<File> {
    /// Creates a file and starts a recording.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(file: &Path, specification: &Specification) -> std::io::Result<Self> {
        let text = is_text(file);
        Self::new(File::create(file)?, specification, text)
    }
}

impl<W: Write> RecordingWriter<W> {
    /// Starts a recording, as text or compact.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn new(output: W, specification: &Specification, text: bool) -> std::io::Result<Self> {
        let mut output = BufWriter::new(output);
        let about = serde_json::to_string(&About { specification })?;
        if text {
            writeln!(output, "# {about}\n{HEADER}")?;
        } else {
            output.write_all(MAGIC)?;
            output.write_all(&(about.len() as u32).to_le_bytes())?;
            output.write_all(about.as_bytes())?;
        }
        Ok(Self { output, text })
    }

    /// Adds a reading.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&mut self, reading: &Reading) -> std::io::Result<()> {
        let DeviceState { buttons, status, .. } = reading.state;
        let words = [buttons, status.bits()];
        if self.text {
            for number in numbers(reading) {
                write!(self.output, "{number},")?;
            }
            return writeln!(self.output, "{},{}", words[0], words[1]);
        }
        numbers(reading).iter().try_for_each(|number| self.output.write_all(&number.to_le_bytes()))?;
        words.iter().try_for_each(|word| self.output.write_all(&word.to_le_bytes()))
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(mut self) -> std::io::Result<()> {
        self.output.flush()
    }
}

impl Recording {
    /// Writes the recording to a file, as [`RecordingWriter`] does.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save(&self, file: &Path) -> std::io::Result<()> {
        let mut writer = RecordingWriter::create(file, &self.specification)?;
        self.readings.iter().try_for_each(|reading| writer.write(reading))?;
        writer.finish()
    }

    /// Reads a recording of either form from a file.
    ///
    /// # Errors
    /// If the file cannot be read or is not a recording: with the position of the first fault.
    pub fn load(file: &Path) -> Result<Self, PathError> {
        let io = |source| PathError::Io { file: file.into(), access: "read", source };
        let mut bytes = Vec::new();
        File::open(file).and_then(|mut open| open.read_to_end(&mut bytes)).map_err(io)?;
        Self::parse(&bytes, file)
    }

    /// Reads a recording from the bytes of a file; `file` names it in errors.
    ///
    /// # Errors
    /// If the bytes are not a recording: with the position of the first fault.
    pub fn parse(bytes: &[u8], file: &Path) -> Result<Self, PathError> {
        let (specification, readings) =
            if bytes.starts_with(MAGIC) { compact(&bytes[MAGIC.len()..], file)? } else { text(bytes, file)? };
        if readings.is_empty() {
            return Err(PathError::Empty { file: Some(file.into()) });
        }
        Ok(Self::of_checked(specification, readings))
    }

    /// Whether a file is a recording, judged by its first bytes.
    pub(crate) fn is_one(file: &Path) -> bool {
        let mut start = [0; 8];
        let read = File::open(file).and_then(|mut open| open.read_exact(&mut start));
        read.is_ok() && (start == *MAGIC || start.starts_with(b"# {"))
    }
}

fn is_text(file: &Path) -> bool {
    file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("csv"))
}

fn numbers(reading: &Reading) -> [f64; READING_NUMBERS] {
    let DeviceState { time, pose, twist, .. } = reading.state;
    let ([x, y, z], [a, b, c, d]) = (pose.translation.to_array(), pose.rotation.to_array());
    let ([u, v, w], [p, q, r]) = (twist.linear.to_array(), twist.angular.to_array());
    [reading.now, time, x, y, z, a, b, c, d, u, v, w, p, q, r]
}

fn reading(numbers: [f64; READING_NUMBERS], [buttons, status]: [u32; 2]) -> Reading {
    let [now, time, x, y, z, a, b, c, d, u, v, w, p, q, r] = numbers;
    let pose = Pose { translation: DVec3::new(x, y, z), rotation: DQuat::from_xyzw(a, b, c, d) };
    let twist = Twist::new(DVec3::new(u, v, w), DVec3::new(p, q, r));
    Reading { now, state: DeviceState { time, pose, twist, buttons, status: Status::from_bits(status) } }
}

fn refused(file: &Path, place: u64, what: String) -> PathError {
    PathError::Line { what, file: PathBuf::from(file), line: place, remedy: REMEDY }
}

fn described(text: &str, file: &Path) -> Result<Specification, PathError> {
    let described: Result<Described, _> = serde_json::from_str(text);
    let Described { specification } =
        described.map_err(|error| refused(file, 1, format!("not a description of a device ({error})")))?;
    Ok(specification)
}

fn compact(bytes: &[u8], file: &Path) -> Result<(Specification, Vec<Reading>), PathError> {
    let short = || refused(file, 1, "no complete description of a device".into());
    let (length, rest) = bytes.split_first_chunk::<4>().ok_or_else(short)?;
    let length = u32::from_le_bytes(*length);
    let about = rest.get(..length.min(MAX_JSON_BYTES) as usize).ok_or_else(short)?;
    let about = std::str::from_utf8(about).map_err(|_| short())?;
    let specification = described(about, file)?;
    let mut last = f64::NEG_INFINITY;
    let (whole, _) = rest[about.len()..].as_chunks::<READING_BYTES>();
    let parse = |(index, bytes): (usize, &[u8; READING_BYTES])| {
        let (words, rest) = bytes.as_chunks::<8>();
        debug_assert!(rest.is_empty());
        let numbers = std::array::from_fn(|i| f64::from_le_bytes(words[i]));
        let [a, b, c, d, e, f, g, h] = words[READING_NUMBERS];
        let reading = reading(numbers, [[a, b, c, d], [e, f, g, h]].map(u32::from_le_bytes));
        match check(&reading, &mut last) {
            None => Ok(reading),
            Some(what) => Err(refused(file, index as u64 + 1, format!("{what} (in readings)"))),
        }
    };
    let readings = whole.iter().enumerate().map(parse).collect::<Result<_, _>>()?;
    Ok((specification, readings))
}

fn text(bytes: &[u8], file: &Path) -> Result<(Specification, Vec<Reading>), PathError> {
    let mut lines = bytes.split_inclusive(|byte| *byte == b'\n').zip(1..);
    let mut next = || {
        let (line, number) = lines.next()?;
        let whole = line.ends_with(b"\n");
        Some((std::str::from_utf8(line).map(str::trim), number, whole))
    };
    let about = match next() {
        Some((Ok(line), ..)) => line.strip_prefix("# "),
        _ => None,
    };
    let about = about.ok_or_else(|| refused(file, 1, "not a description of a device".into()))?;
    let specification = described(about, file)?;
    match next() {
        Some((Ok(HEADER), ..)) => {}
        _ => return Err(refused(file, 2, format!("no header {HEADER:?}"))),
    }
    let (mut readings, mut last) = (Vec::new(), f64::NEG_INFINITY);
    while let Some((line, number, whole)) = next() {
        if !whole {
            break;
        }
        let fault = |what: &str| refused(file, number, what.into());
        let line = line.map_err(|_| fault("bytes that are not UTF-8 text"))?;
        let mut fields = line.split(',');
        let mut numbers = [0.0; READING_NUMBERS];
        for number in &mut numbers {
            let field = fields.next().and_then(|field| field.parse().ok());
            *number = field.ok_or_else(|| fault("a field that is missing or not a number"))?;
        }
        let mut words = [0; 2];
        for word in &mut words {
            let field = fields.next().and_then(|field| field.parse().ok());
            *word = field.ok_or_else(|| fault("buttons or status that are missing or not a number"))?;
        }
        if fields.next().is_some() {
            return Err(fault("more than 17 fields"));
        }
        let reading = reading(numbers, words);
        if let Some(what) = check(&reading, &mut last) {
            return Err(fault(what));
        }
        readings.push(reading);
    }
    Ok((specification, readings))
}
