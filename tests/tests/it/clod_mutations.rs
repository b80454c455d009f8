//! Damaged `.clod` files: reading one ends in a hierarchy or an error, never a panic, and takes memory in
//! proportion to the file's size. Accepted hierarchies survive contact queries with a sound object.
//!
//! Most files are resealed (length and checksum corrected) after the damage, so that it reaches the checks
//! behind these. Some are damaged copies of loosened hierarchies, whose spheres, s and h are larger than
//! necessary: in these, wrong geometry is valid and reaches the queries.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use allocation_counter::measure;
use palpate::clod_build::{BuildOptions, build, unwatched};
use palpate::collide::{ContactQuery, QuerySettings, Shape};
use palpate::core::Clod;
use palpate::core::clod::{ClodError, Parts};
use palpate::glam::{DQuat, DVec3};
use palpate::models::Model;
use palpate::{Pose, TriMesh};
use rand::{Rng, RngExt, SeedableRng, rngs::StdRng};

const SEED: u64 = 0x00c1_0d00;

/// Offsets of the body's length and checksum in the header, and of the body.
const LENGTH_AT: usize = 12;
const CHECKSUM_AT: usize = 20;
const BODY_AT: usize = 24;
/// Offset at which the body's element counts end.
const COUNTS_END: usize = BODY_AT + 16;

/// Bounds on the memory held while reading: so many times the bytes of the file, since growing arrays are
/// moved, plus a constant for the decoded block and for messages.
const BYTES_PER_BYTE: u64 = 3;
const EXTRA_BYTES: u64 = 72 << 10;

/// One file in this many is also read from the disk, where its length is known beforehand.
const DISK_INTERVAL: usize = 50;

/// Longest time to read and query one file: a hundred times the usual time in a debug build on a loaded
/// machine.
const MAX_DURATION: Duration = Duration::from_secs(20);

#[test]
fn mutated_files_are_refused_or_usable() {
    mutate_files(20_000);
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-tests --test it clod_mutations:: -- --ignored"]
fn a_million_mutated_files_are_refused_or_usable() {
    mutate_files(1_000_000);
}

/// Counts of the files by result.
#[derive(Default)]
struct Tally {
    refused: AtomicUsize,
    accepted: AtomicUsize,
    changed: AtomicUsize,
    touching: AtomicUsize,
    /// Largest memory held while reading, in thousandths of what is allowed.
    memory: AtomicUsize,
    /// Longest time for one file, ms.
    longest: AtomicUsize,
}

fn mutate_files(count: usize) {
    let sound = hierarchy(&Model::Ellipsoid.generate(60).expect("within range"), false);
    let seeds = seeds();
    let folder = tempfile::tempdir().expect("temporary folder");
    let (tally, next) = (Tally::default(), AtomicUsize::new(0));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for thread in 0..threads {
            let path = folder.path().join(format!("{thread}.clod"));
            let (sound, seeds, tally, next) = (&sound, &seeds, &tally, &next);
            scope.spawn(move || {
                while let Some(case) = Some(next.fetch_add(1, Ordering::Relaxed)).filter(|c| *c < count) {
                    let mut random = StdRng::seed_from_u64(SEED + case as u64);
                    let bytes = mutated(seeds, &mut random);
                    let disk = (case % DISK_INTERVAL == 0).then_some(path.as_path());
                    // A failure has to be reproducible.
                    let checked = catch_unwind(AssertUnwindSafe(|| check(&bytes, seeds, sound, disk, tally)));
                    assert!(checked.is_ok(), "case {case} of seed {SEED:#x}, {} bytes", bytes.len());
                }
            });
        }
    });
    let [refused, accepted, changed, touching, memory, longest] =
        [tally.refused, tally.accepted, tally.changed, tally.touching, tally.memory, tally.longest]
            .map(AtomicUsize::into_inner);
    let summary = format!(
        "{count} files: {refused} refused, {accepted} accepted, {changed} of these unlike what they were made from, \
         {touching} in contact; memory at most {:.3} of the bound; longest {longest} ms",
        memory as f64 * 1e-3
    );
    assert_eq!(refused + accepted, count);
    assert!(refused > count / 10 && changed > count / 10 && touching > count / 10, "{summary}");
    say(&summary);
}

/// Prints to the stream directly, since the test runner captures the print macros.
fn say(text: &str) {
    use std::io::Write as _;
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Reads a file, and uses it if it is accepted.
fn check(bytes: &[u8], seeds: &[Vec<u8>], sound: &Clod, disk: Option<&Path>, tally: &Tally) {
    let begun = Instant::now();
    let allowed = BYTES_PER_BYTE * bytes.len() as u64 + EXTRA_BYTES;
    let mut read = None;
    let memory = measure(|| read = Some(Clod::read(bytes))).bytes_max;
    assert!(memory <= allowed, "{memory} bytes of memory to read {}", bytes.len());
    let read = read.expect("it was read");
    tally.memory.fetch_max((1000 * memory / allowed) as usize, Ordering::Relaxed);

    if let Some(path) = disk {
        std::fs::write(path, bytes).expect("the temporary folder can be written to");
        let mut loaded = None;
        let memory = measure(|| loaded = Some(Clod::load(path))).bytes_max;
        assert!(memory <= allowed, "{memory} bytes of memory to load {}", bytes.len());
        match (&read, loaded.expect("it was loaded")) {
            (Ok(one), Ok(other)) => assert!(*one == other),
            (Err(_), Err(_)) | (Ok(_), Err(ClodError::Overlong { .. })) => {}
            (one, other) => panic!("read gives {:?}, load {:?}", one.as_ref().err(), other.err()),
        }
    }

    match read {
        Ok(clod) => {
            tally.accepted.fetch_add(1, Ordering::Relaxed);
            let touching = touches(&clod, sound);
            tally.touching.fetch_add(usize::from(touching), Ordering::Relaxed);
            let again = bytes_of(&Parts::read(bytes).expect("it was read before"));
            assert!(bytes.starts_with(&again), "what was read is not what was written");
            tally.changed.fetch_add(usize::from(!seeds.contains(&again)), Ordering::Relaxed);
        }
        Err(error) => {
            tally.refused.fetch_add(1, Ordering::Relaxed);
            let message = error.to_string();
            assert!(!message.is_empty() && !message.contains('\n') && message.len() < 400, "{message}");
        }
    }
    let took = begun.elapsed();
    assert!(took < MAX_DURATION, "{took:?}");
    tally.longest.fetch_max(took.as_millis() as usize, Ordering::Relaxed);
}

/// Returns whether queries with a sound object, as probe and as scene, find contacts.
fn touches(clod: &Clod, sound: &Clod) -> bool {
    let radius = sound.bounding_radius();
    let most = clod.nodes().len() * sound.nodes().len();
    // At full resolution, and with some error.
    let settings = [0.0, 0.02]
        .map(|e| QuerySettings { error: (e * radius).into(), ..QuerySettings::new(0.02 * radius) });
    let mut found = false;
    let mut ask = |probe: &Clod, scene: &Clod, poses: &[Pose; 2]| {
        let (probe_shape, scene_shape) = (Shape::new(probe.clone()), Shape::new(scene.clone()));
        let mut query = ContactQuery::with_capacity(&probe_shape, &scene_shape, 256, 4096);
        for (pose, settings) in poses.iter().flat_map(|pose| settings.each_ref().map(|s| (pose, s))) {
            // A damaged probe may be smaller than the tolerance for the sound object.
            let tolerance = settings.tolerance.min(probe_shape.max_tolerance());
            let settings = QuerySettings { tolerance, ..*settings };
            let outcome = query.run(pose, &Pose::IDENTITY, &settings).unwrap();
            assert!(outcome.visited <= most, "{outcome:?} for {most} pairs of nodes");
            assert!(outcome.deepest.is_none_or(|depth| !depth.is_nan()), "{outcome:?}");
            assert_eq!(outcome.contacts, query.contacts().len());
            for contact in query.contacts() {
                let c = &contact.contact;
                let numbers = [c.point, c.scene_point, c.normal].map(|v| v.is_finite());
                assert!(numbers == [true; 3] && c.depth.is_finite(), "{c:?}");
                assert!((contact.probe_node as usize) < probe.nodes().len());
                assert!((contact.scene_node as usize) < scene.nodes().len());
            }
            found |= outcome.contacts > 0;
        }
    };
    // Overlapping, then beside one another, turned so that no axes agree.
    let turn = DQuat::from_scaled_axis(DVec3::new(0.3, -0.7, 0.4));
    let poses = [(0.3, DQuat::IDENTITY), (1.0, turn)].map(|(reach, rotation)| Pose {
        translation: DVec3::new(0.5, 0.6, 0.62) * reach * (radius + clod.bounding_radius().min(radius)),
        rotation,
    });
    ask(clod, sound, &poses);
    ask(sound, clod, &poses);
    found
}

fn hierarchy(mesh: &TriMesh, simplify: bool) -> Clod {
    let options = BuildOptions { simplify, ..BuildOptions::default() };
    build(mesh, &options, &mut unwatched).expect("the model builds")
}

fn bytes_of(clod: &Parts) -> Vec<u8> {
    let mut bytes = Vec::new();
    clod.write(&mut bytes).expect("the hierarchy is valid");
    bytes
}

/// Returns the files that are mutated.
fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for (model, triangles, simplify) in [
        (Model::Ellipsoid, 60, false),
        (Model::Ellipsoid, 100, true),
        (Model::Torus, 400, true),
        (Model::Block, 300, false),
        (Model::Spoon, 400, true),
    ] {
        let Ok(mesh) = model.generate(triangles) else { panic!("{} has fewest triangles", model.name()) };
        // All of one size, so that they touch the sound object.
        let radius = mesh.bounding_sphere().radius;
        let vertices = mesh.vertices().iter().map(|v| *v * (0.03 / radius)).collect();
        let mesh = TriMesh::new(vertices, mesh.triangles().to_vec()).expect("the same triangles");
        let mut clod = hierarchy(&mesh, simplify).parts();
        seeds.push(bytes_of(&clod));
        for node in &mut clod.nodes {
            (node.radius, node.hausdorff) = (1e6 * node.radius, 10.0 * node.hausdorff);
        }
        seeds.push(bytes_of(&clod));
    }
    seeds
}

/// Returns a file of the seeds, damaged once or, half the time, up to five times.
fn mutated(seeds: &[Vec<u8>], random: &mut StdRng) -> Vec<u8> {
    let pick = |random: &mut StdRng| &seeds[random.random_range(0..seeds.len())];
    let mut bytes = pick(random).clone();
    for _ in 0..if random.random() { 1 } else { random.random_range(2..=5) } {
        if bytes.len() <= COUNTS_END + 8 {
            break;
        }
        match random.random_range(0..12) {
            0 => {
                let at = random.random_range(BODY_AT..bytes.len());
                bytes[at] ^= 1 << random.random_range(0..8);
            }
            1 => {
                let at = random.random_range(0..bytes.len());
                bytes[at] = random.random();
            }
            2 => bytes.truncate(random.random_range(0..bytes.len())),
            3 => splice(&mut bytes, pick(random), random),
            4 => {
                // Words are swapped, such as two nodes' children.
                let [a, b] = [0; 2].map(|_| word(&bytes, random));
                let words = [a, b].map(|at| bytes[at..at + 4].to_vec());
                bytes[a..a + 4].copy_from_slice(&words[1]);
                bytes[b..b + 4].copy_from_slice(&words[0]);
            }
            5 => {
                let at = BODY_AT + 4 * random.random_range(0..4usize);
                integer(&mut bytes, at, random);
            }
            6 | 7 => {
                let at = word(&bytes, random);
                integer(&mut bytes, at, random);
            }
            _ => {
                let at = word(&bytes, random);
                number(&mut bytes, at, random);
            }
        }
    }
    if random.random_range(0..16) > 0 {
        reseal(&mut bytes, random);
    }
    bytes
}

/// Returns the offset of a word, in the first part of the body half the time: levels and nodes come first.
fn word(bytes: &[u8], random: &mut StdRng) -> usize {
    let words = (bytes.len() - BODY_AT) / 4 - 1;
    let words = if random.random() { words } else { (words / 4).max(1) };
    BODY_AT + 4 * random.random_range(0..words)
}

/// Replaces or inserts a stretch of another file, or removes one.
fn splice(bytes: &mut Vec<u8>, other: &[u8], random: &mut StdRng) {
    let length = 4 * random.random_range(1..64usize).min(other.len() / 8);
    let from = BODY_AT + 4 * random.random_range(0..(other.len() - length - BODY_AT) / 4);
    let at = word(bytes, random);
    let end = (at + length).min(bytes.len());
    match random.random_range(0..4) {
        0 => drop(bytes.drain(at..end)),
        1 => drop(bytes.splice(at..at, other[from..from + length].iter().copied())),
        _ => bytes[at..end].copy_from_slice(&other[from..from + end - at]),
    }
}

/// Makes a word an index that is nearly right, or an extreme one.
fn integer(bytes: &mut [u8], at: usize, random: &mut StdRng) {
    let Some(field) = bytes.get_mut(at..at + 4) else { return };
    let old = u32::from_le_bytes([field[0], field[1], field[2], field[3]]);
    let new = match random.random_range(0..8) {
        0 => u32::MAX,
        1 => u32::MAX - random.random_range(0..4),
        2 => 0x7fff_ffff + random.random_range(0..3),
        3 => 0,
        4 => old.wrapping_add(1),
        5 => old.wrapping_sub(1),
        6 => random.random_range(0..64),
        _ => random.next_u32(),
    };
    field.copy_from_slice(&new.to_le_bytes());
}

/// Makes two words another number: one near by, or an extreme one.
fn number(bytes: &mut [u8], at: usize, random: &mut StdRng) {
    let Some((field, _)) = bytes.get_mut(at..).and_then(|rest| rest.split_first_chunk_mut::<8>()) else {
        return;
    };
    let old = f64::from_le_bytes(*field);
    let new = match random.random_range(0..16) {
        0 => f64::NAN,
        1 => f64::INFINITY,
        2 => f64::NEG_INFINITY,
        3 => 0.0,
        4 => -old,
        5 => f64::MAX,
        6 => f64::from_bits(random.random_range(0..1 << 20)),
        7 => 1e50,
        8 => -1e49,
        9 => 1e-300,
        10 => old * 10f64.powi(random.random_range(-20..=20)),
        11 => f64::from_bits(random.random()),
        _ => old + random.random_range(-0.03..0.03),
    };
    *field = new.to_le_bytes();
}

/// Corrects the body's checksum in the header, and nearly always its length.
fn reseal(bytes: &mut [u8], random: &mut StdRng) {
    if bytes.len() < BODY_AT {
        return;
    }
    let (header, body) = bytes.split_at_mut(BODY_AT);
    if random.random_range(0..32) > 0 {
        header[LENGTH_AT..CHECKSUM_AT].copy_from_slice(&(body.len() as u64).to_le_bytes());
    } else if random.random() {
        header[LENGTH_AT..CHECKSUM_AT].copy_from_slice(&random.random::<u64>().to_le_bytes());
    }
    header[CHECKSUM_AT..].copy_from_slice(&crc32fast::hash(body).to_le_bytes());
}
