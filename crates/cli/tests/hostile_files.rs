//! Invalid files: each command ends in time with a result or a one-line error, and never panics.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Time after which a command counts as hanging. Simplifying the worst file takes half a minute in a
/// development build on an idle machine.
const TIMEOUT: Duration = Duration::from_secs(180);

/// Runs `palpate`, and returns its exit code and standard error.
fn palpate(arguments: &[&str], folder: &Path) -> (i32, String) {
    let begun = Instant::now();
    let mut child = Command::new(env!("CARGO_BIN_EXE_palpate"))
        .args(arguments)
        .env("XDG_CACHE_HOME", folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary starts");
    // Another thread reads standard error, so that a full pipe does not look like a hang.
    let mut pipe = child.stderr.take().expect("piped");
    let reader = std::thread::spawn(move || std::io::read_to_string(&mut pipe));
    let status = loop {
        if let Some(status) = child.try_wait().expect("waiting") {
            break status;
        }
        if begun.elapsed() > TIMEOUT {
            child.kill().expect("kill");
            panic!("palpate {arguments:?} took longer than {TIMEOUT:?}");
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    let stderr = reader.join().expect("reader").expect("UTF-8");
    (status.code().unwrap_or_else(|| panic!("palpate {arguments:?} died: {status}; {stderr}")), stderr)
}

/// Runs a command that must exit with 0 and a result, or with 1 and one line. Returns the exit code and
/// standard error.
fn ends_well(arguments: &[&str], folder: &Path) -> (i32, String) {
    let (code, stderr) = palpate(arguments, folder);
    let errors: Vec<&str> = stderr.lines().filter(|line| !line.contains(": warning: ")).collect();
    match code {
        0 => assert!(errors.is_empty(), "palpate {arguments:?}: {stderr}"),
        1 => assert!(
            errors.len() == 1 && errors[0].starts_with("palpate: "),
            "palpate {arguments:?}: {stderr}"
        ),
        _ => panic!("palpate {arguments:?} exited with {code}: {stderr}"),
    }
    assert!(!stderr.contains("panicked"), "palpate {arguments:?}: {stderr}");
    (code, stderr)
}

/// Runs every command on a file. Returns the outcomes of building it without and with repair.
fn every_command(file: &str, folder: &Path) -> [(i32, String); 2] {
    let trajectory = folder.join("trajectory.csv");
    std::fs::write(&trajectory, "t,px,py,pz,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n0.001,0,0,0.001,0,0,0,1\n")
        .expect("write");
    let trajectory = trajectory.to_str().expect("UTF-8");
    let clod = folder.join("out.clod");
    let clod = clod.to_str().expect("UTF-8");
    ends_well(&["check", file, "--json"], folder);
    ends_well(&["check", file, "--repair"], folder);
    let built = ends_well(&["build", file, "-o", clod], folder);
    let repaired = ends_well(&["build", file, "-o", clod, "--repair"], folder);
    assert!(built.0 != 0 || repaired.0 == 0, "{file}: repair has to leave alone what builds");
    ends_well(&["inspect", file], folder);
    if repaired.0 == 0 {
        ends_well(&["inspect", clod, "--json"], folder);
    }
    if built.0 == 0 {
        ends_well(
            &["query", file, "ellipsoid", "--trajectory", trajectory, "--tolerance", "1%", "--json"],
            folder,
        );
        ends_well(&["run", "ellipsoid", file, "--lockstep", "--seconds", "0.05", "--json"], folder);
    }
    [built, repaired]
}

fn shared(path: &str) -> Option<PathBuf> {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")).join(path);
    if !folder.exists() {
        // Written to the stream, because the test runner captures the print macros.
        let _ = writeln!(std::io::stderr(), "skipped: {} is absent", folder.display());
        return None;
    }
    Some(folder)
}

fn files_in(folder: &Path) -> Vec<String> {
    let entries = folder.read_dir().expect("folder").map(|entry| entry.expect("entry").path());
    let mut files: Vec<String> = entries
        .filter(|path| path.is_file() && path.extension().is_none_or(|extension| extension != "md"))
        .map(|path| path.to_str().expect("UTF-8").to_owned())
        .collect();
    files.sort();
    files
}

/// Size (bytes) above which files take minutes in a development build.
const MAX_DEVELOPMENT_BYTES: u64 = 400_000;

#[test]
fn nasty_meshes_end_well() {
    nasty_meshes(4, |bytes| bytes <= MAX_DEVELOPMENT_BYTES);
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-cli --test hostile_files -- --ignored"]
fn nasty_meshes_of_full_size_end_well() {
    nasty_meshes(5, |bytes| bytes > MAX_DEVELOPMENT_BYTES);
}

fn nasty_meshes(at_least: usize, size: impl Fn(u64) -> bool) {
    let Some(folder) = shared("models/nasty") else { return };
    let temporary = tempfile::tempdir().expect("temporary folder");
    let mut files = files_in(&folder);
    files.retain(|file| size(Path::new(file).metadata().expect("a file").len()));
    assert!(files.len() >= at_least, "{files:?}");
    for file in files {
        let [(code, why), repaired] = every_command(&file, temporary.path());
        assert!(code == 1 && why.contains("(the first of ") && why.contains("--repair"), "{file}: {why}");
        let (code, why) = repaired;
        assert!(code == 0 && why.contains(": warning: repaired: "), "{file}: {why}");
    }
}

#[test]
fn nasty_loader_files_end_well() {
    let Some(folder) = shared("models/nasty/loader") else { return };
    let temporary = tempfile::tempdir().expect("temporary folder");
    let files = files_in(&folder);
    assert!(files.len() >= 50, "{files:?}");
    for file in files {
        every_command(&file, temporary.path());
    }
}

#[test]
fn generated_invalid_files_end_well() {
    let temporary = tempfile::tempdir().expect("temporary folder");
    let folder = temporary.path();
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).expect("write");
        path.to_str().expect("UTF-8").to_owned()
    };
    for (name, bytes) in [
        ("empty.obj", &b""[..]),
        ("empty.stl", b""),
        ("empty.glb", b""),
        ("empty.ply", b""),
        ("empty.clod", b""),
        ("noise.clod", &[0x5a; 300]),
        ("noise.stl", &[0xff; 300]),
        ("range.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n"),
        ("overflow.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n"),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("huge.obj", b"v 1e308 0 0\nv -1e308 1e308 0\nv 0 1 1e308\nf 1 2 3\n"),
        ("tiny.obj", b"v 1e-300 0 0\nv 0 1e-300 0\nv 0 0 1e-300\nf 1 2 3\n"),
        ("point.obj", b"v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n"),
        ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("what.xyz", b"v 0 0 0"),
    ] {
        every_command(&write(name, bytes), folder);
    }
    every_command("no/such/file.obj", folder);
    every_command(folder.to_str().expect("UTF-8"), folder);
}
