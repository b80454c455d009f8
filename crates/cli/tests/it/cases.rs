//! Small inputs that have failed for people, read from `../shared/cases` beside the repository. Each is run
//! as its own README says, beside a control for which the same check fails.

#![expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use palpate::Pose;
use palpate::glam::{DQuat, DVec3};
use serde_json::Value;

/// A case's folder, and one for what it writes.
struct Case {
    inputs: PathBuf,
    outputs: tempfile::TempDir,
}

/// A session's summary and recording.
struct Session {
    summary: Value,
    columns: Vec<String>,
    rows: Vec<Vec<f64>>,
}

/// A row of a recording.
#[derive(Clone, Copy)]
struct Step<'a> {
    session: &'a Session,
    row: usize,
}

impl Case {
    /// None, said on standard error, if the folder is absent.
    fn open(name: &str) -> Option<Self> {
        let inputs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/cases").join(name);
        if !inputs.is_dir() {
            // Written to the stream, because the test runner captures the print macros.
            let _ = writeln!(std::io::stderr(), "skipped: {} is absent", inputs.display());
            return None;
        }
        Some(Self { inputs, outputs: tempfile::tempdir().expect("temporary folder") })
    }

    /// Runs `palpate` in the case's folder: its exit code, standard output and standard error.
    fn palpate(&self, arguments: &str) -> (i32, String, String) {
        let output = Command::new(env!("CARGO_BIN_EXE_palpate"))
            .args(arguments.split_whitespace())
            .current_dir(&self.inputs)
            .env("XDG_CACHE_HOME", self.outputs.path())
            .output()
            .expect("the binary starts");
        let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
        (output.status.code().expect("no signal"), text(output.stdout), text(output.stderr))
    }

    fn json(&self, arguments: &str) -> Value {
        let (code, stdout, stderr) = self.palpate(arguments);
        assert_eq!(code, 0, "palpate {arguments}: {stderr}");
        serde_json::from_str(&stdout).expect("JSON")
    }

    /// Writes an input of a control, and returns its path.
    fn write(&self, name: &str, text: &str) -> String {
        let path = self.outputs.path().join(name);
        std::fs::write(&path, text).expect("written");
        path.to_str().expect("UTF-8").to_owned()
    }

    /// Writes a scene file with one of the inputs, placed by another line, and returns its path.
    fn write_scene(&self, model: &str, placed: &str) -> String {
        let model = self.inputs.join(model);
        self.write("scene.toml", &format!("[[object]]\nmodel = {model:?}\n{placed}\n"))
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.inputs.join(name)).expect("an input")
    }

    /// Runs a session, `palpate run` before `arguments`.
    fn run(&self, arguments: &str) -> Session {
        let record = self.outputs.path().join("r.csv");
        let summary = self.json(&format!("run {arguments} --json --record {}", record.display()));
        let text = std::fs::read_to_string(record).expect("a recording");
        let mut lines = text.lines();
        let columns = lines.next().expect("a header").split(',').map(str::to_owned).collect();
        let numbers = |line: &str| line.split(',').map(|n| n.parse().unwrap_or(f64::NAN)).collect();
        Session { summary, columns, rows: lines.map(numbers).collect() }
    }
}

impl Session {
    fn steps(&self) -> impl Iterator<Item = Step<'_>> {
        (0..self.rows.len()).map(|row| Step { session: self, row })
    }

    fn between(&self, from: f64, to: f64) -> impl Iterator<Item = Step<'_>> {
        self.steps().filter(move |step| (from..to).contains(&step.get("t")))
    }

    fn max(&self, of: impl Fn(Step<'_>) -> f64) -> f64 {
        self.steps().map(of).fold(f64::NEG_INFINITY, f64::max)
    }
}

impl Step<'_> {
    fn get(&self, column: &str) -> f64 {
        let at = self.session.columns.iter().position(|name| name == column);
        self.session.rows[self.row][at.unwrap_or_else(|| panic!("no column {column}"))]
    }

    fn vector<const N: usize>(&self, prefix: &str, axes: [&str; N]) -> [f64; N] {
        axes.map(|axis| self.get(&format!("{prefix}{axis}")))
    }

    fn force(&self, of: &str) -> f64 {
        norm(self.vector(&format!("{of}_f"), ["x", "y", "z"]))
    }

    /// Pose of the object's mesh frame.
    fn pose(&self) -> Pose {
        let position = self.vector("object_p", ["x", "y", "z"]);
        let rotation = self.vector("object_q", ["x", "y", "z", "w"]);
        Pose::new(DVec3::from_array(position), DQuat::from_array(rotation))
    }
}

fn norm<const N: usize>(vector: [f64; N]) -> f64 {
    vector.iter().map(|c| c * c).sum::<f64>().sqrt()
}

/// Vertices of an OBJ file.
fn vertices(text: &str) -> Vec<DVec3> {
    let of = |line: &str| {
        let mut numbers = line.strip_prefix("v ")?.split_whitespace().map(|n| n.parse().expect("a number"));
        Some(DVec3::from_array([0; 3].map(|_| numbers.next().expect("three numbers"))))
    };
    text.lines().filter_map(of).collect()
}

#[test]
fn nine_objects_are_felt_as_eight() {
    let Some(case) = Case::open("nine-objects") else { return };
    let follows = |scene: &str| {
        let session =
            case.run(&format!("plate.obj {scene} --device emulated:path=press.csv --lockstep --seconds 4"));
        let worst =
            |from, to, of: &dyn Fn(Step<'_>) -> f64| session.between(from, to).map(of).fold(0.0, f64::max);
        let worst = [
            worst(1.0, 3.0, &|step| (step.get("object_pz") - 9e-3).abs()),
            worst(3.2, 3.25, &|step| (step.get("object_px") - 5e-3).abs()),
            worst(3.745, 3.755, &|step| (step.get("object_pz") - 16e-3).abs()),
            worst(3.75, 4.0, &|step| step.force("coupling")),
        ];
        println!("{scene}: {worst:?}");
        worst[0] < 0.02e-3 && worst[1] < 0.3e-3 && worst[2] < 0.5e-3 && worst[3] < 0.2
    };
    assert!(follows("balls8.toml"));
    assert!(follows("balls9.toml"));
    // Control: one ball of nine does not hold the plate level.
    assert!(!follows(&case.write_scene("ball.obj", "position = [-0.02, -0.02, 0.0]")));
}

#[test]
fn a_needle_does_not_enter_a_slab() {
    let Some(case) = Case::open("poke") else { return };
    let needle = vertices(&case.read("needle.obj"));
    let deepest = |path: &str, rate: u32, more: &str| {
        let session = case.run(&format!(
            "needle.obj slab3.toml --device emulated:path={path} --lockstep --contact-rate {rate} --seconds 2 {more}"
        ));
        let lowest = |step: Step<'_>| {
            let pose = step.pose();
            needle.iter().map(|vertex| pose.transform_point(*vertex).z).fold(f64::INFINITY, f64::min)
        };
        let deepest = session.max(|step| -lowest(step));
        println!("{path} at {rate} Hz {more}: {:.4} mm deep", deepest * 1e3);
        deepest
    };
    for path in ["poke_0.2.csv", "poke_0.4.csv"] {
        for rate in [50, 100, 200, 500] {
            assert!(deepest(path, rate, "") < 0.02e-3);
        }
    }
    assert!(deepest("poke_0.2.csv", 50, "--response penalty") > 0.02e-3);
}

#[test]
fn a_flat_floor_does_not_push_sideways() {
    let Some(case) = Case::open("ghost-edges") else { return };
    let is_level = |scene: &str| {
        let session =
            case.run(&format!("slider.obj {scene} --device emulated:path=sl_x.csv --lockstep --seconds 3.3"));
        let axes = ["x", "y", "z"];
        let slide: Vec<_> = session.between(1.2, 2.95).collect();
        let sideways =
            slide.iter().map(|step| norm(step.vector("contact_f", ["x", "y"]))).fold(0.0, f64::max);
        let up = slide.iter().map(|step| step.get("contact_fz")).sum::<f64>() / slide.len() as f64;
        let jump = slide.windows(2).flat_map(|two| {
            let [from, to] = [0, 1].map(|i| two[i].vector("coupling_f", axes));
            [0, 1, 2].map(|i| (to[i] - from[i]).abs())
        });
        let jump = jump.fold(0.0, f64::max);
        println!("{scene}: {sideways:.4} N sideways, {up:.3} N up, {jump:.4} N a step");
        assert!(up > 0.2, "the slider rests on the floor");
        sideways < 0.01 && jump < 0.04
    };
    assert!(is_level("fb1.obj"));
    // Control: a floor that is tilted by 3 degrees about y.
    let (sine, cosine) = 1.5_f64.to_radians().sin_cos();
    let rotation = format!("rotation = [0.0, {sine}, 0.0, {cosine}]");
    assert!(!is_level(&case.write_scene("fb1.obj", &rotation)));
}

#[test]
fn a_ball_far_from_a_plate_is_not_held_back() {
    let Some(case) = Case::open("free-air-drag") else { return };
    let is_free = |scene: &str, rate: u32| {
        let session = case.run(&format!(
            "pb3.obj {scene} --device emulated:path=hov160.csv --lockstep --contact-rate {rate} --seconds 2"
        ));
        let force = session.max(|step| step.force("coupling"));
        let waited = session.summary["events"]["waited"].as_u64().unwrap_or(0);
        println!("{scene} at {rate} Hz: {force:.3} N, waited {waited}");
        waited == 0 && force < 1.0
    };
    for rate in [50, 100, 200, 500] {
        assert!(is_free("fb0.obj", rate));
    }
    // Control: a plate at the path's height.
    assert!(!is_free(&case.write_scene("fb0.obj", "position = [0.0, 0.0, 0.157]"), 100));
}

#[test]
fn late_contacts_do_not_drag() {
    let Some(case) = Case::open("late-rate-drag") else { return };
    let is_felt_in_time = |scene: &str, rate: u32| {
        let session = case.run(&format!(
            "sph10.obj {scene} --device emulated:path=slow.csv --lockstep --seconds 4.5 --contact-rate {rate}"
        ));
        let force =
            |from, to| session.between(from, to).map(|step| step.force("coupling")).fold(0.0, f64::max);
        let touch = session.summary["first_touch_s"].as_f64();
        let (before, pressed) = (force(0.0, 2.17), force(2.4, 3.4));
        println!("{scene} at {rate} Hz: {before:.3} N, then {pressed:.3} N, first touch {touch:?}");
        before < 0.2 && pressed > 0.2 && touch.is_some_and(|touch| (touch - 2.18).abs() < 0.02)
    };
    for rate in [20, 30, 35] {
        assert!(is_felt_in_time("sheet.obj", rate));
    }
    // Control: the sheet 0.5 mm higher.
    assert!(!is_felt_in_time(&case.write_scene("sheet.obj", "position = [0.0, 0.0, 5e-4]"), 35));
}

#[test]
fn the_exact_query_sees_a_ball_that_is_inside() {
    let Some(case) = Case::open("exact-blind-inside") else { return };
    let inside = |trajectory: &str| {
        let query = case.json(&format!(
            "query ball-golf-ball.obj golf-ball@20000 --trajectory {trajectory} --tolerance 0.5e-3 --exact --json"
        ));
        let poses = query["poses"].as_array().expect("poses");
        let deep = |pose: &&Value| pose["depth_max"].as_f64().is_some_and(|depth| depth >= 2e-3);
        (poses.iter().filter(deep).count(), poses.len())
    };
    assert_eq!(inside("inside-golf-ball.csv"), (100, 100));
    let outside = case.read("inside-golf-ball.csv").lines().map(move_up).collect::<Vec<_>>().join("\n");
    assert_eq!(inside(&case.write("outside.csv", &outside)), (0, 100));
}

/// A line of a trajectory, 0.1 m higher.
fn move_up(line: &str) -> String {
    let mut numbers: Vec<String> = line.split(',').map(str::to_owned).collect();
    if let Ok(z) = numbers[3].parse::<f64>() {
        numbers[3] = (z + 0.1).to_string();
    }
    numbers.join(",")
}

#[test]
fn overlapping_boxes_are_united_and_hold_a_ball() {
    let Some(case) = Case::open("overlapping-boxes-repair") else { return };
    let check = case.json("check tray5.obj --repair --json");
    let volume = check["volume"].as_f64().expect("a volume");
    assert!(check["closed"] == true && (volume / 1.1995e-4 - 1.0).abs() < 1e-3, "{check}");
    let unrepaired = case.json("check tray5.obj --json");
    assert!((unrepaired["volume"].as_f64().expect("a volume") / 1.1995e-4 - 1.0).abs() > 1e-3);

    // Of a surface that is whole, each of the balls just beside it is seen.
    let unseen = |scene: &str| {
        let query = case.json(&format!(
            "query ball5.obj {scene} --trajectory outside.csv --tolerance 1e-3 --exact --scene-repair --json"
        ));
        let poses = query["poses"].as_array().expect("poses");
        poses.iter().filter(|pose| pose["contacts"] == 0).count()
    };
    // The wall's top is tilted: without friction, the ball slides off it.
    let holds = |scene: &str| {
        let session = case.run(&format!(
            "ball5.obj {scene} --scene-repair --device emulated:path=press.csv --lockstep --seconds 3 --friction 0.3"
        ));
        let last = session.steps().last().expect("steps");
        println!("{scene}: z = {:.3} mm, {:.2} N", last.get("object_pz") * 1e3, last.force("contact"));
        (last.get("object_pz") - 31.3e-3).abs() < 0.1e-3 && last.force("contact") > 1.5
    };
    assert_eq!(unseen("tray5.obj"), 0);
    assert!(holds("tray5.obj"));
    // Control: the tray without the wall that the ball is pressed on.
    let tray = case.read("tray5.obj");
    let without = without_parts_above(&tray, 0.02);
    let lowered = case.write("tray4.obj", &without);
    assert!(unseen(&lowered) > 0);
    assert!(!holds(&lowered));
}

/// An OBJ file without the faces that reach above a height (m).
fn without_parts_above(text: &str, height: f64) -> String {
    let vertices = vertices(text);
    let stays = |line: &&str| {
        let Some(face) = line.strip_prefix("f ") else { return true };
        let index = |corner: &str| corner.split('/').next().and_then(|n| n.parse::<usize>().ok());
        face.split_whitespace().filter_map(index).all(|i| vertices[i - 1].z < height)
    };
    text.lines().filter(stays).collect::<Vec<_>>().join("\n")
}

#[test]
fn t_junctions_are_mended() {
    let Some(case) = Case::open("tjunction-repair") else { return };
    for (file, volume) in [("hex11.obj", 2.0434e-6), ("hex1386.obj", 3.2423e-6)] {
        let repaired = case.json(&format!("check {file} --repair --json"));
        let found = repaired["volume"].as_f64().expect("a volume");
        assert!(repaired["closed"] == true && (found / volume - 1.0).abs() < 1e-3, "{file}: {repaired}");
        assert_eq!(case.json(&format!("check {file} --json"))["closed"], false, "{file}");
    }
}

#[test]
fn close_fits_are_searched_without_fields_that_are_thrown_away() {
    let Some(case) = Case::open("cad-slow-queries") else { return };
    let kept = |arguments: &str| {
        let (code, _, stderr) = case.palpate(arguments);
        assert_eq!(code, 0, "palpate {arguments}: {stderr}");
        let bytes = |entry: std::io::Result<std::fs::DirEntry>| entry.and_then(|entry| entry.metadata());
        let folder = case.outputs.path().join("palpate");
        let files =
            folder.read_dir().map(|files| files.filter_map(|file| bytes(file).ok()).collect::<Vec<_>>());
        files.map_or(0, |files| files.iter().map(std::fs::Metadata::len).sum::<u64>())
    };
    let slot = kept("run cube20.obj uslot.obj --lockstep --seconds 0.01");
    // Control: the field of a cup is kept.
    let cup = kept("run ellipsoid@500 cup@2000 --lockstep --seconds 0.01");
    println!("{slot} bytes, {cup} bytes");
    assert!(slot < 100_000 && cup > 100_000, "{slot} bytes, {cup} bytes");
}

#[test]
fn the_depths_of_a_key_in_its_hub_are_there() {
    let Some(case) = Case::open("cad-slow-queries") else { return };
    let session = case.run("keyshaft0.obj hub2um.obj --device emulated:path=key.csv --lockstep --seconds 4");
    let recorded = session.max(|step| step.get("depth"));
    let query = case.json(&format!(
        "query keyshaft0.obj hub2um.obj --trajectory {} --tolerance 1e-4 --exact --json",
        case.outputs.path().join("r.csv").display()
    ));
    let poses = query["poses"].as_array().expect("poses");
    let exact = poses.iter().filter_map(|pose| pose["depth_max"].as_f64()).fold(0.0, f64::max);
    println!("recorded {recorded:.2e} m, exact {exact:.2e} m over {} poses", poses.len());
    assert!((recorded - exact).abs() < 5e-6 && exact < 0.02e-3);
}

#[test]
fn a_plate_over_many_balls_is_held_from_its_first_step() {
    let Some(case) = Case::open("many-objects-first-query") else { return };
    let deepest = |scene: &str, more: &str| {
        let session =
            case.run(&format!("plate.obj {scene} --device emulated:path=press.csv --seconds 1.5 {more}"));
        // Balls of 6 mm stand under a plate 6 mm thick.
        let low = session.max(|step| 9e-3 - step.get("object_pz"));
        println!("{scene} {more}: {:.4} mm deep", low * 1e3);
        assert!(low > -0.05e-3, "the plate comes down to the balls");
        low
    };
    assert!(deepest("balls64.toml", "--lockstep") < 0.02e-3);
    assert!(deepest("balls64.toml", "") < 0.02e-3);
    // Control: one ball does not hold the plate level.
    let one = case.write_scene("ball.obj", "position = [-0.02, -0.02, 0.0]");
    assert!(deepest(&one, "--lockstep") > 0.02e-3);
}

#[test]
fn the_first_touch_is_when_a_force_is_felt() {
    let Some(case) = Case::open("first-touch-null") else { return };
    let touch = |rate: u32, seconds: u32| {
        let session = case.run(&format!(
            "ellipsoid@500 golf-ball@5000 --lockstep --seconds {seconds} --contact-rate {rate}"
        ));
        session.summary["first_touch_s"].as_f64()
    };
    for rate in [500, 999, 1000] {
        let touch = touch(rate, 3);
        assert!(touch.is_some_and(|touch| (1.46..1.49).contains(&touch)), "{rate} Hz: {touch:?}");
    }
    assert_eq!(touch(1000, 1), None, "the hand is still on its way");
}

#[test]
fn a_start_in_an_overlap_is_free_along_what_surfaces_face() {
    let Some(case) = Case::open("interference-start") else { return };
    let shaft = |more: &str| {
        let session = case.run(&format!(
            "sqshaft.obj sqm50.obj --device emulated:path=key.csv --lockstep --seconds 4 {more}"
        ));
        let along = session.max(|step| step.get("contact_fz").abs());
        let energy = session.summary["energy_min_j"].as_f64().expect("an energy");
        println!("shaft {more}: {along:.3} N along the hole, {energy:.2e} J");
        (along, energy)
    };
    let (along, energy) = shaft("");
    assert!(along < 0.1 && energy > -1e-4);
    assert!(shaft("--response penalty").0 > 0.1);
    let ball = |scene: &str, rate: u32| {
        let session = case.run(&format!(
            "sph5.obj {scene} --device emulated:path=sq.csv --lockstep --seconds 3.6 --contact-rate {rate}"
        ));
        let along = session.max(|step| norm(step.vector("coupling_f", ["x", "y"])));
        let last = session.steps().last().expect("steps").get("object_px");
        println!("ball in {scene}, {rate} Hz: {along:.3} N along the plates, ends at {:.2} mm", last * 1e3);
        along < 0.3 && (last - 50e-3).abs() < 1e-3
    };
    // At 1 kHz, steps that were taken again held it at the plates' ends.
    for rate in [1000, 500, 100] {
        assert!(ball("squeeze.toml", rate), "{rate} Hz");
    }
    // Control: a plate in its way.
    assert!(!ball(&case.write_scene("bx.obj", "position = [0.028, 0.0, 0.0]"), 500));
}

#[test]
fn a_cube_tips_over_a_slot_of_its_width_without_overlap() {
    let Some(case) = Case::open("zero-clearance-slot") else { return };
    let [cube, slot] = ["cube20.obj", "uslot.obj"].map(|file| vertices(&case.read(file)));
    assert!(slot.iter().all(|v| v.x.abs() > 9.9e-3), "the slot's walls stand at x = 10 mm and -10 mm");
    // Corners of the cube in the slot's walls. Rims in the cube's faces are in the depth that is told.
    let overlap = |step: Step<'_>| {
        let pose = step.pose();
        let in_walls = cube.iter().map(|corner| {
            let DVec3 { x, z, .. } = pose.transform_point(*corner);
            let beyond = x.abs() - 10e-3;
            beyond.min(10e-3 - z)
        });
        in_walls.fold(f64::NEG_INFINITY, f64::max)
    };
    let deepest = |rate: u32, more: &str| {
        let session = case.run(&format!(
            "cube20.obj uslot.obj --device emulated:path=slot.csv --lockstep --seconds 5 --contact-rate {rate} {more}"
        ));
        let (told, deepest) = (session.max(|step| step.get("depth")), session.max(overlap));
        println!("{rate} Hz {more}: {:.4} mm, told {:.4}", deepest * 1e3, told * 1e3);
        deepest.max(told)
    };
    assert!(deepest(500, "") < 0.02e-3);
    assert!(deepest(50, "") < 0.02e-3);
    assert!(deepest(500, "--response penalty") > 0.02e-3);
}

#[test]
fn times_of_clocks_are_taken_from_the_first() {
    let Some(case) = Case::open("epoch-times") else { return };
    let query = |trajectory: &str| {
        case.palpate(&format!(
            "query ellipsoid@500 golf-ball@5000 --trajectory {trajectory} --tolerance 1% --json"
        ))
    };
    let (code, stdout, stderr) = query("ros.csv");
    assert_eq!(code, 0, "{stderr}");
    let result: Value = serde_json::from_str(&stdout).expect("JSON");
    let poses = result["poses"].as_array().expect("poses");
    let (times, expected) = (poses.iter().map(|pose| pose["t"].as_f64()), [0.0, 0.1, 1.2]);
    assert_eq!(poses.len(), expected.len());
    for (time, expected) in times.zip(expected) {
        assert!(time.is_some_and(|time| (time - expected).abs() < 1e-3), "{time:?}, not {expected}");
    }
    let backwards = case.read("ros.csv").replacen("1767225601.2", "1767225500.2", 1);
    let (code, _, stderr) = query(&case.write("backwards.csv", &backwards));
    assert_eq!(code, 1, "{stderr}");
}
