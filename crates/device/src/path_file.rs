//! Recorded motions as text: a header `t,px,py,pz,qx,qy,qz,qw`, then one sample a line: seconds, metres and a
//! unit quaternion. Numbers are written with as many digits as it takes to read the same number back.
//!
//! A session's recording can be read as well: of its columns, `t` and the object's pose, `object_px` to
//! `object_qw`. Time stamps since 1970, as those of ROS bags, count from the first.
//!
//! Lines are split here, without a CSV parser: so an error names the line that an editor shows, the length of
//! a line is bounded, and a stray quotation mark cannot swallow the rest of the file. No field needs quoting.

use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Write};
use std::path::Path;

use glam::{DQuat, DVec3};
use palpate_core::Pose;

use crate::PathError;
use crate::path::{Interpolation, Keyframe, MotionPath, checked};
use crate::sample_time::{Origin, Refusal, SampleTime};

/// The first line of a recorded motion.
pub const PATH_HEADER: &str = "t,px,py,pz,qx,qy,qz,qw";

const FORMAT: SampleFormat<8> = SampleFormat {
    header: ["t", "px", "py", "pz", "qx", "qy", "qz", "qw"],
    recording: [
        "t",
        "object_px",
        "object_py",
        "object_pz",
        "object_qx",
        "object_qy",
        "object_qz",
        "object_qw",
    ],
    header_remedy: "let the file begin with the line t,px,py,pz,qx,qy,qz,qw, or give a recording of a session",
    sample_remedy: "give eight numbers: t,px,py,pz,qx,qy,qz,qw",
};
/// Longest line, bytes. Eight numbers take some 200; a longer line is not a sample, and may be a whole binary
/// file.
const MAX_LINE: u64 = 4096;

impl MotionPath {
    /// Reads a recorded motion from a file.
    ///
    /// # Errors
    /// If the file cannot be read, or as [`read`](Self::read).
    pub fn load(file: &Path, interpolation: Interpolation) -> Result<Self, PathError> {
        let open =
            File::open(file).map_err(|source| PathError::Io { file: file.into(), access: "read", source })?;
        Self::read(BufReader::with_capacity(1 << 16, open), file, interpolation)
    }

    /// Reads a recorded motion; `file` names the input in errors.
    ///
    /// # Errors
    /// If the input cannot be read or has no sample, or its header or a line is not valid: with the line and
    /// a remedy.
    pub fn read(input: impl BufRead, file: &Path, interpolation: Interpolation) -> Result<Self, PathError> {
        let keyframes = read_samples(input, file, &FORMAT, |numbers, previous| {
            let [time, px, py, pz, qx, qy, qz, qw] = numbers;
            let pose = Pose::new(DVec3::new(px, py, pz), DQuat::from_xyzw(qx, qy, qz, qw));
            checked(Keyframe { time, pose }, previous)
        })?;
        Ok(Self::from_checked(keyframes, interpolation))
    }

    /// Writes the samples to a file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, file: &Path) -> Result<(), PathError> {
        let write = || {
            let mut out = BufWriter::new(File::create(file)?);
            self.write(&mut out)?;
            out.flush()
        };
        write().map_err(|source| PathError::Io { file: file.into(), access: "written", source })
    }

    /// Writes the samples.
    ///
    /// # Errors
    /// If `out` cannot be written to.
    pub fn write(&self, mut out: impl Write) -> io::Result<()> {
        writeln!(out, "{PATH_HEADER}")?;
        for Keyframe { time, pose: Pose { translation: p, rotation: q } } in self.keyframes() {
            writeln!(out, "{time},{},{},{},{},{},{},{}", p.x, p.y, p.z, q.x, q.y, q.z, q.w)?;
        }
        Ok(())
    }
}

/// Columns of a kind of recorded motion with `N` numbers in a sample, of which the first is the time, and the
/// remedies that errors give.
pub(crate) struct SampleFormat<const N: usize> {
    /// Columns of a file of this kind alone.
    pub header: [&'static str; N],
    /// The corresponding columns of a session's recording.
    pub recording: [&'static str; N],
    pub header_remedy: &'static str,
    pub sample_remedy: &'static str,
}

/// Reads the samples of a recorded motion. `sample` makes a keyframe of a line's numbers and the time (s) of
/// the sample before, or refuses it.
pub(crate) fn read_samples<const N: usize>(
    mut input: impl BufRead,
    file: &Path,
    format: &SampleFormat<N>,
    sample: impl Fn([f64; N], Option<f64>) -> Result<Keyframe, Refusal>,
) -> Result<Vec<Keyframe>, PathError> {
    let mut keyframes: Vec<Keyframe> = Vec::new();
    let mut line = Vec::new();
    let mut number = 0;
    let mut columns: Option<Columns<N>> = None;
    let mut origin = Origin::default();
    loop {
        line.clear();
        let taken = input
            .by_ref()
            .take(MAX_LINE + 1)
            .read_until(b'\n', &mut line)
            .map_err(|source| PathError::Io { file: file.into(), access: "read", source })?;
        if taken == 0 {
            break;
        }
        number += 1;
        let refuse = |what: String, remedy| PathError::Line { what, file: file.into(), line: number, remedy };
        let text = text_of(&line).map_err(|Refusal { what, remedy }| refuse(what, remedy))?;
        if text.is_empty() {
            continue;
        }
        let Some(columns) = &columns else {
            let header = || format!("header `{}`", text.chars().take(80).collect::<String>());
            let known = Columns::of_header(text, format);
            columns = Some(known.ok_or_else(|| refuse(header(), format.header_remedy))?);
            continue;
        };
        let (time, mut numbers) = columns.parse(text).map_err(|what| refuse(what, columns.remedy(format)))?;
        let previous = keyframes.last().map(|keyframe| keyframe.time);
        let keyframe = origin.time_of(time).and_then(|time| {
            numbers[0] = time;
            sample(numbers, previous)
        });
        let keyframe = keyframe.map_err(|refusal| refuse(refusal.what, refusal.remedy))?;
        keyframes.push(keyframe);
    }
    if keyframes.is_empty() {
        return Err(PathError::Empty { file: Some(file.into()) });
    }
    Ok(keyframes)
}

/// A line's text, without a byte order mark and surrounding spaces.
fn text_of(line: &[u8]) -> Result<&str, Refusal> {
    if line.len() as u64 > MAX_LINE {
        let what = format!("a line of more than {MAX_LINE} bytes");
        return Err(Refusal { what, remedy: "give a text file with one sample a line" });
    }
    let text = std::str::from_utf8(line).map_err(|_| Refusal {
        what: "bytes that are not UTF-8 text".into(),
        remedy: "give a text file, not a binary one",
    })?;
    Ok(text.trim_start_matches('\u{feff}').trim())
}

/// Positions of a sample's numbers in a line.
#[derive(Debug)]
struct Columns<const N: usize> {
    /// Index of each number among the fields.
    places: [usize; N],
    /// Number of fields in a line.
    count: usize,
}

impl<const N: usize> Columns<N> {
    /// Columns by the header of a file of a kind, or of a session's recording.
    fn of_header(header: &str, format: &SampleFormat<N>) -> Option<Self> {
        let names: Vec<&str> = header.split(',').map(str::trim).collect();
        if names == format.header {
            return Some(Self { places: std::array::from_fn(|place| place), count: N });
        }
        let mut places = [0; N];
        for (place, wanted) in places.iter_mut().zip(format.recording) {
            *place = names.iter().position(|name| *name == wanted)?;
        }
        Some(Self { places, count: names.len() })
    }

    fn remedy(&self, format: &SampleFormat<N>) -> &'static str {
        if self.count == N {
            format.sample_remedy
        } else {
            "give a recording as it was written, with a number for each column of its header"
        }
    }

    /// The time of a line, and all its numbers.
    fn parse(&self, text: &str) -> Result<(SampleTime, [f64; N]), String> {
        let (mut time, mut numbers) = (SampleTime::ZERO, [0.0; N]);
        let mut count = 0;
        for field in text.split(',') {
            let field = field.trim();
            if let Some(wanted) = self.places.iter().position(|place| *place == count) {
                let wrong = || format!("`{}` is not a number", field.chars().take(40).collect::<String>());
                if wanted == 0 {
                    time = SampleTime::parse(field).ok_or_else(wrong)?;
                } else {
                    numbers[wanted] = field.parse().map_err(|_| wrong())?;
                }
            }
            count += 1;
        }
        if count != self.count {
            return Err(format!("{count} fields"));
        }
        Ok((time, numbers))
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    fn read(text: &[u8]) -> Result<MotionPath, String> {
        MotionPath::read(text, Path::new("hand.csv"), Interpolation::Smooth)
            .map_err(|error| error.to_string())
    }

    #[test]
    fn written_samples_read_back_bit_for_bit() {
        let mut rng = StdRng::seed_from_u64(11);
        let keyframes = (0..500)
            .map(|i| {
                let mut number = || rng.random_range(-2.0..2.0);
                let pose = Pose::new(
                    DVec3::new(number(), number(), number()),
                    DQuat::from_xyzw(number(), number(), number(), number()).normalize(),
                );
                Keyframe { time: f64::from(i) * 0.001 + 1.0 / 3.0, pose }
            })
            .collect();
        let path = MotionPath::new(keyframes, Interpolation::Smooth).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("path.csv");
        path.save(&file).unwrap();
        assert_eq!(MotionPath::load(&file, Interpolation::Smooth).unwrap(), path);
    }

    #[test]
    fn blank_lines_carriage_returns_spaces_and_a_byte_order_mark_are_skipped() {
        let path = read(
            "\u{feff}t, px,py,pz,qx,qy,qz,qw\r\n\r\n0, 1,2,3, 0,0,0,1\r\n\n 1,1,2,3,0,0,0,-1".as_bytes(),
        );
        assert_eq!(path.unwrap().keyframes().len(), 2);
    }

    #[test]
    fn a_recording_gives_the_poses_of_its_object() {
        let header =
            "t,device_px,object_px,object_py,object_pz,object_qx,object_qy,object_qz,object_qw,model_age";
        let path = read(format!("{header}\n0.5,9,1,2,3,0,0,0,1,NaN\n0.6,9,4,5,6,0,0,1,0,0.1\n").as_bytes());
        let path = path.unwrap();
        let [first, last] = path.keyframes() else { panic!("two samples") };
        assert_eq!((first.time, first.pose), (0.5, Pose::from_translation(DVec3::new(1.0, 2.0, 3.0))));
        let turned = Pose::new(DVec3::new(4.0, 5.0, 6.0), DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0));
        assert_eq!((last.time, last.pose), (0.6, turned));
        let short = read(format!("{header}\n0.5,9,1,2,3,0,0,0,1\n").as_bytes()).unwrap_err();
        assert!(short.contains("9 fields at hand.csv:2; give a recording as it was written"), "{short}");
        let without = header.replace("object_qw,", "");
        assert!(read(format!("{without}\n").as_bytes()).unwrap_err().contains("header `t,device_px"));
    }

    /// Time stamps of a recorder that counts since 1970, with nanoseconds, give the motion of the same
    /// samples that count from 0, however the file came about.
    #[test]
    fn time_stamps_count_from_the_first() {
        let mut rng = StdRng::seed_from_u64(13);
        let (mut stamped, mut plain) = (format!("{PATH_HEADER}\n"), format!("{PATH_HEADER}\n"));
        let (first, mut elapsed) = (1_767_225_600_123_456_789_u64, 0_u64);
        for _ in 0..500 {
            use std::fmt::Write as _;
            let pose = format!("{},0.1,{},0,0,0,1", rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
            let at = first + elapsed;
            writeln!(stamped, "{}.{:09},{pose}", at / 1_000_000_000, at % 1_000_000_000).unwrap();
            writeln!(plain, "{}.{:09},{pose}", elapsed / 1_000_000_000, elapsed % 1_000_000_000).unwrap();
            elapsed += rng.random_range(100_000..20_000_000);
        }
        let (stamped, plain) = (read(stamped.as_bytes()).unwrap(), read(plain.as_bytes()).unwrap());
        for (one, other) in stamped.keyframes().iter().zip(plain.keyframes()) {
            assert!((one.time - other.time).abs() < 1e-14 + 1e-15 * other.time, "{} s", one.time);
            assert_eq!(one.pose, other.pose);
        }
        let recording = "t,object_px,object_py,object_pz,object_qx,object_qy,object_qz,object_qw,depth\n\
            1767225600.5,0,0,0,0,0,0,1,0\n1767225600.501,0,0,1,0,0,0,1,0\n";
        let read_back = read(recording.as_bytes()).unwrap();
        assert!((read_back.keyframes()[1].time - 1e-3).abs() < 1e-15);
        // What is written is read back as it is.
        let mut written = Vec::new();
        stamped.write(&mut written).unwrap();
        assert_eq!(read(&written).unwrap(), stamped);
        // In memory there is less of a stamp, but the difference is exact.
        let stamp = |time| Keyframe { time, pose: Pose::IDENTITY };
        let stamps = vec![stamp(1_767_225_600.25), stamp(1_767_225_600.75)];
        let path = MotionPath::new(stamps, Interpolation::Linear).unwrap();
        assert_eq!(path.keyframes().iter().map(|it| it.time).collect::<Vec<_>>(), [0.0, 0.5]);
    }

    #[test]
    fn errors_name_the_file_and_the_line() {
        let head = "t,px,py,pz,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n\n";
        for (row, expected) in [
            ("1,0,0,0,0,0,0", "7 fields at hand.csv:4; give eight numbers"),
            ("1,0,0,0,0,0,0,1,0", "9 fields at hand.csv:4"),
            ("1,0,zero,0,0,0,0,1", "`zero` is not a number at hand.csv:4"),
            ("1,0,nan,0,0,0,0,1", "position [0, NaN, 0] at hand.csv:4; give finite metres"),
            ("0,0,0,0,0,0,0,1", "time 0 s after 0 s at hand.csv:4; sort"),
            ("1,0,0,0,0,0,0,2", "of length 2 at hand.csv:4; give unit quaternions"),
            ("inf,0,0,0,0,0,0,1", "time inf s at hand.csv:4"),
            ("1,\"0\n", "not a number at hand.csv:4"),
            ("1767225600,0,0,0,0,0,0,1", "time 1767225600 s at hand.csv:4; give finite seconds, at most 1e9"),
        ] {
            let message = read(format!("{head}{row}\n").as_bytes()).unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
        let milliseconds = read(b"t,px,py,pz,qx,qy,qz,qw\n1767225600123,0,0,0,0,0,0,1\n").unwrap_err();
        assert!(
            milliseconds.contains("at hand.csv:2; give finite seconds, not milliseconds"),
            "{milliseconds}"
        );
        assert!(read(b"").unwrap_err().contains("hand.csv holds no sample"));
        assert!(read(b"t,px,py,pz,qx,qy,qz,qw\n").unwrap_err().contains("hand.csv holds no sample"));
        assert!(read(b"0,0,0,0,0,0,0,1\n").unwrap_err().contains("header `0,0,0,0,0,0,0,1` at hand.csv:1"));
        assert!(read(&[0xff, 0xfe, 0x00]).unwrap_err().contains("not UTF-8 text at hand.csv:1"));
        assert!(read(&vec![b' '; 1 << 20]).unwrap_err().contains("more than 4096 bytes at hand.csv:1"));
        let missing =
            MotionPath::load(Path::new("no/such.csv"), Interpolation::Smooth).unwrap_err().to_string();
        assert!(missing.starts_with("no/such.csv: "), "{missing}");
    }

    #[test]
    fn random_bytes_and_broken_rows_never_panic() {
        let mut rng = StdRng::seed_from_u64(12);
        let alphabet = b"0123456789+-.eE,\n\r \"infNa\xff";
        for _ in 0..20_000 {
            let mut text = b"t,px,py,pz,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n".to_vec();
            text.extend((0..rng.random_range(0..60)).map(|_| alphabet[rng.random_range(0..alphabet.len())]));
            if let Ok(path) = read(&text) {
                assert!(path.at(rng.random_range(-1.0..10.0)).pose.is_valid());
            }
        }
    }

    #[test]
    fn a_million_rows_are_read() {
        let mut text = String::from("t,px,py,pz,qx,qy,qz,qw\n");
        for i in 0..1_000_000 {
            use std::fmt::Write;
            writeln!(text, "{},0.1,{},0.3,0,0,0,1", f64::from(i) * 1e-3, f64::from(i) * 1e-6).unwrap();
        }
        let path = read(text.as_bytes()).unwrap();
        assert_eq!(path.keyframes().len(), 1_000_000);
        let point = path.at(500.0005);
        assert!((point.pose.translation.y - 0.500_000_5).abs() < 1e-12);
        assert!((point.twist.linear.y - 1e-3).abs() < 1e-9);
    }
}
