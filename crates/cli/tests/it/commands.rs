//! Output of each command, as a user or a program sees it.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn palpate(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_palpate"))
        .args(arguments)
        .current_dir(folder)
        // Shared, since distance fields take seconds to make.
        .env("XDG_CACHE_HOME", concat!(env!("CARGO_TARGET_TMPDIR"), "/cache"))
        .output()
        .expect("the binary starts")
}

/// Runs a command that must succeed, and returns its standard output. Of files with an open surface it may
/// warn.
fn succeeds(arguments: &[&str], folder: &Path) -> String {
    let output = palpate(arguments, folder);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "palpate {arguments:?}: {stderr}");
    let open = |line: &str| line.contains(": warning: the surface is open ");
    assert!(stderr.lines().all(open), "no progress where standard error is no terminal: {stderr}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

fn json(arguments: &[&str], folder: &Path) -> Value {
    serde_json::from_str(&succeeds(arguments, folder)).expect("JSON")
}

/// Keys of an object, in alphabetical order.
fn keys(value: &Value) -> Vec<&str> {
    value.as_object().expect("an object").keys().map(String::as_str).collect()
}

/// Keys and more keys, in alphabetical order.
fn and<'a>(mut own: Vec<&'a str>, more: &[&'a str]) -> Vec<&'a str> {
    own.extend(more);
    own.sort_unstable();
    own
}

#[test]
fn models_are_listed_exported_and_checked() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let models = json(&["models", "--json"], folder);
    assert_eq!(models.as_array().map(Vec::len), Some(24));
    assert_eq!(succeeds(&["models"], folder).lines().count(), 24);

    succeeds(&["export", "ellipsoid@500", "-o", "e.obj"], folder);
    let check = json(&["check", "e.obj", "--json"], folder);
    let direct = json(&["check", "ellipsoid@500", "--json"], folder);
    assert_eq!(check, direct, "what was exported is what was generated");
    for key in ["closed", "manifold", "oriented"] {
        assert_eq!(check[key], Value::Bool(true), "{key}");
    }
    for key in
        ["boundary_edges", "nonmanifold_edges", "misoriented_edges", "degenerate", "duplicate", "nonfinite"]
    {
        assert_eq!(check[key], 0, "{key}");
    }
    assert_eq!(check["self_intersections"], 0);
    assert_eq!(check["components"], 1);
    assert_eq!(check["first"], serde_json::json!({}));

    let scaled = json(&["check", "e.obj", "--scale", "2", "--json"], folder);
    let ratio = scaled["volume"].as_f64().unwrap() / check["volume"].as_f64().unwrap();
    assert!((ratio - 8.0).abs() < 1e-9, "{ratio}");
}

#[test]
fn a_hierarchy_is_built_and_inspected() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let printed = succeeds(&["build", "torus@4000", "-o", "t.clod", "--json", "built.json"], folder);
    assert!(printed.is_empty(), "--json FILE writes and prints nothing: {printed}");
    let written = std::fs::read_to_string(folder.join("built.json")).expect("built.json");
    let built: Value = serde_json::from_str(&written).expect("JSON");
    let inspected = json(&["inspect", "t.clod", "--json"], folder);
    assert_eq!(built["levels"], inspected["levels"]);
    assert_eq!(
        keys(&inspected),
        [
            "bounding_radius",
            "bytes",
            "levels",
            "name",
            "patches",
            "peak_rss_bytes",
            "published",
            "seconds",
            "table",
            "triangles",
            "vertices"
        ]
    );
    let levels = inspected["levels"].as_array().expect("levels");
    assert_eq!(levels[0]["level"], 0);
    assert_eq!(levels[0]["patches"], inspected["patches"]);
    assert_eq!(levels[levels.len() - 1]["patches"], 1);
    assert!(levels[0]["resolution"].as_f64().is_some_and(|r| r > 0.0));
    assert_eq!(levels[0]["free"], false);
    assert_eq!(inspected["published"], Value::Null, "Table 3.2 has no torus");

    // The printed figures are those of the file.
    let printed = succeeds(&["inspect", "t.clod"], folder);
    let mut blocks = printed.split("\n\n");
    let table: Vec<&str> = blocks.next().expect("Table 3.2").lines().collect();
    assert_eq!(table.len(), 2, "{printed}");
    let columns: Vec<&str> = table[1].split_whitespace().collect();
    let number = |text: &str| text.replace(',', "").parse::<u64>().ok();
    let of_table = |key: &str| inspected["table"][key].as_u64();
    assert_eq!(columns[0], "t.clod");
    assert_eq!(number(columns[1]), of_table("original_triangles"));
    assert_eq!(number(columns[4]), of_table("simplified_patches"));
    assert_eq!(number(columns[8]), Some(levels.len() as u64));
    let rows: Vec<&str> = blocks.next().expect("levels").lines().skip(1).collect();
    assert_eq!(rows.len(), levels.len());
    for (row, level) in rows.iter().zip(levels) {
        let cells: Vec<&str> = row.split_whitespace().collect();
        for (column, key) in [(0, "level"), (1, "triangles"), (2, "patches"), (8, "bytes")] {
            assert_eq!(number(cells[column]), level[key].as_u64(), "{key}: {row}");
        }
        assert_eq!(cells.get(9) == Some(&"free"), level["free"] == Value::Bool(true), "{row}");
        let radius = inspected["bounding_radius"].as_f64().unwrap();
        let percent = 100.0 * level["max_hausdorff"].as_f64().unwrap() / radius;
        assert_eq!(cells[7], format!("{percent:.3}"), "{row}");
    }
}

#[test]
fn levels_are_drawn() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    succeeds(&["build", "torus@1000", "-o", "t.clod"], folder);
    let inspected = json(&["inspect", "t.clod", "--json"], folder);
    let levels = inspected["levels"].as_array().expect("levels");
    let count = levels.len();
    assert!(levels[0]["patches"].as_u64() > Some(8) && count > 2, "{levels:?}");
    let open = |path: &str| image::open(folder.join(path)).expect(path).into_rgb8();
    // Colours far from grey, with a coarse resolution.
    let hues = |path: &str| {
        let vivid = |pixel: &[u8; 3]| pixel.iter().max().unwrap() - pixel.iter().min().unwrap() > 60;
        let picture = open(path);
        let hues = picture.pixels().map(|pixel| pixel.0).filter(vivid).map(|pixel| pixel.map(|v| v / 64));
        hues.collect::<std::collections::HashSet<_>>().len()
    };
    succeeds(&["inspect", "t.clod", "--render", "all", "--size", "200"], folder);
    for (level, data) in levels.iter().enumerate() {
        let path = format!("all/level-{level:02}.png");
        assert_eq!(open(&path).dimensions(), (200, 150));
        // Neighbouring patches of a surface differ in colour; a hull may hide the others.
        let several = data["free"] == false && data["patches"].as_u64() > Some(8);
        let wanted = if level == 0 { 3 } else { 1 + usize::from(several) };
        assert!(hues(&path) >= wanted, "{path}: {} hues of {data}", hues(&path));
    }
    assert_eq!(open("all/levels.png").width() % 200, 0);
    assert_eq!(std::fs::read_dir(folder.join("all")).unwrap().count(), count + 1);

    // Levels can be chosen, even the root's free level; the folder may exist; a direction changes the
    // picture.
    std::fs::create_dir(folder.join("some")).unwrap();
    let last = count - 1;
    let chosen = format!("0,{last}");
    let arguments = ["inspect", "t.clod", "--render", "some", "--size", "200", "--levels", &chosen];
    succeeds(&[&arguments[..], &["--azimuth", "-100", "--elevation", "-20"]].concat(), folder);
    assert_eq!(std::fs::read_dir(folder.join("some")).unwrap().count(), 3);
    assert!(hues(&format!("some/level-{last:02}.png")) >= 1);
    assert!(open("some/level-00.png") != open("all/level-00.png"));
}

#[test]
fn pictures_that_cannot_be_written_are_refused() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    succeeds(&["build", "ellipsoid@500", "-o", "e.clod"], folder);
    std::fs::write(folder.join("file"), "kept").unwrap();
    std::fs::create_dir(folder.join("there")).unwrap();
    for (arguments, said) in [
        (&["--render", "file"][..], "file"),
        (&["--render", "no/such/folder"], "no/such/folder"),
        (&["--render", "new", "--levels", "99"], "the levels 0 to"),
        (&["--render", "there", "--json", "there/levels.png"], "named twice"),
    ] {
        let output = palpate(&[&["inspect", "e.clod"], arguments].concat(), folder);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), stderr.lines().count()), (Some(1), 1), "{arguments:?}: {stderr}");
        assert!(stderr.contains(said), "{arguments:?} should mention '{said}': {stderr}");
    }
    assert_eq!(std::fs::read_to_string(folder.join("file")).unwrap(), "kept");
    assert!(!folder.join("new").exists() && !folder.join("no").exists());
    assert_eq!(std::fs::read_dir(folder.join("there")).unwrap().count(), 0);
    for usage in [
        &["--size", "400"][..],
        &["--render", "d", "--size", "1"],
        &["--render", "d", "--size", "100000"],
        &["--render", "d", "--levels", "one"],
        &["--render", "d", "--azimuth", "nan"],
    ] {
        let output = palpate(&[&["inspect", "e.clod"], usage].concat(), folder);
        assert_eq!(output.status.code(), Some(2), "{usage:?}");
    }
}

#[test]
fn a_trajectory_is_queried() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    // The ellipsoid descends onto the golf ball from far away until it is inside.
    let radius = json(&["check", "golf-ball@5000", "--json"], folder)["bounding_radius"].as_f64().unwrap();
    let mut csv = String::from("t,px,py,pz,qx,qy,qz,qw\n");
    for i in 0..=40 {
        csv.push_str(&format!(
            "{},0,0,{},0,0,0,1\n",
            f64::from(i) * 1e-3,
            radius * (3.0 - 0.06 * f64::from(i))
        ));
    }
    std::fs::write(folder.join("t.csv"), csv).unwrap();
    let arguments = [
        "query",
        "ellipsoid@500",
        "golf-ball@5000",
        "--trajectory",
        "t.csv",
        "--tolerance",
        "2%",
        "--json",
        "--exact",
        "--contacts",
        "c.csv",
    ];
    let replay = json(&arguments, folder);
    assert_eq!(
        keys(&replay["summary"]),
        [
            "contacts_median",
            "front_max",
            "front_median",
            "max_us",
            "median_us",
            "memory_bytes",
            "p99_us",
            "poses",
            "probe_inside",
            "scene_inside"
        ]
    );
    let poses = replay["poses"].as_array().expect("poses");
    assert_eq!(poses.len(), 41);
    assert_eq!(poses[0]["contacts"], 0);
    assert_eq!(poses[0]["distance_min"], Value::Null);
    let deepest = &poses[40];
    assert!(deepest["depth_max"].as_f64().is_some_and(|depth| depth > 0.0), "{deepest}");
    assert!(
        deepest["force"][2].as_f64().is_some_and(|force| force > 0.0),
        "the ball pushes back up: {deepest}"
    );
    // Queries from the roots give the same contacts. An error threshold and a budget shorten the front.
    let replayed = |options: &[&str]| json(&[&arguments[..8], options].concat(), folder);
    let cold = replayed(&["--cold"]);
    let counts = |replay: &Value| -> Vec<u64> {
        replay["poses"].as_array().unwrap().iter().map(|pose| pose["contacts"].as_u64().unwrap()).collect()
    };
    assert_eq!(counts(&cold), counts(&replay));
    // Both objects are convex except for the dimples: few regions, with one contact each.
    assert!(counts(&replay).iter().all(|count| *count < 20), "{:?}", counts(&replay));
    let fronts = |replay: &Value| -> f64 {
        replay["poses"].as_array().unwrap().iter().map(|pose| pose["front"].as_f64().unwrap()).sum()
    };
    for options in [&["--error", "10%"][..], &["--error", "10%", "--interpolate"], &["--budget-us", "50"]] {
        let coarse = replayed(options);
        assert!(fronts(&coarse) < fronts(&replay), "{options:?}: {} {}", fronts(&coarse), fronts(&replay));
        assert!(counts(&coarse)[40] > 0, "{options:?}: {:?}", counts(&coarse));
    }
    let rows = std::fs::read_to_string(folder.join("c.csv")).unwrap();
    let contacts: u64 = poses.iter().map(|pose| pose["contacts"].as_u64().unwrap()).sum();
    assert_eq!(rows.lines().count() as u64, contacts + 1);
    assert!(rows.starts_with("t,px,py,pz,nx,ny,nz,depth,level_probe,level_scene\n"), "{rows:.80}");
    assert!(rows.lines().skip(1).all(|row| row.ends_with(",0,0")), "full resolution");

    let with_error = arguments.map(|argument| if argument == "--exact" { "--error=5%" } else { argument });
    let coarse = json(&with_error, folder);
    let front = |replay: &Value| replay["summary"]["front_max"].as_f64().unwrap();
    assert!(front(&coarse) < front(&replay), "{} {}", coarse["summary"], replay["summary"]);
    let rows = std::fs::read_to_string(folder.join("c.csv")).unwrap();
    assert!(rows.lines().skip(1).any(|row| !row.ends_with(",0")), "no coarse contact: {rows:.400}");
}

/// A ball deep in another body touches nothing: it is told to be inside, with a depth, by every way to find
/// contacts, and so is a body around a ball. Nothing is inside an open mesh.
#[test]
fn what_is_wholly_inside_is_told() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let radius = json(&["check", "golf-ball@5000", "--json"], folder)["bounding_radius"].as_f64().unwrap();
    // Octahedra are balls enough: one is closed, of the other a face is missing.
    let faces = ["1 3 5", "3 2 5", "2 4 5", "4 1 5", "3 1 6", "2 3 6", "4 2 6", "1 4 6"];
    let octahedron = |size: f64, faces: &[&str]| {
        let tips = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
        let tips = tips.map(|tip| tip.map(|side| (size * f64::from(side)).to_string()).join(" "));
        let lines = tips.iter().map(|tip| format!("v {tip}")).chain(faces.iter().map(|f| format!("f {f}")));
        lines.collect::<Vec<_>>().join("\n")
    };
    std::fs::write(folder.join("small.obj"), octahedron(0.2 * radius, &faces)).unwrap();
    std::fs::write(folder.join("open.obj"), octahedron(radius, &faces[..7])).unwrap();
    // Out of the surface into the middle.
    let heights: Vec<f64> = (0..=16).map(|i| 1.4 - 0.0875 * f64::from(i)).collect();
    let write = |name: &str, sign: f64| {
        let row = |(i, height): (usize, &f64)| format!("{i},{},0,0,0,0,0,1\n", sign * height * radius);
        let rows: String = heights.iter().enumerate().map(row).collect();
        std::fs::write(folder.join(name), format!("t,px,py,pz,qx,qy,qz,qw\n{rows}")).unwrap();
    };
    write("in.csv", 1.0);
    write("around.csv", -1.0);
    let query = |probe: &str, scene: &str, path: &str, tolerance: &str, options: &[&str]| {
        let all = ["query", probe, scene, "--trajectory", path, "--tolerance", tolerance];
        [&all[..], options].concat().into_iter().map(str::to_owned).collect::<Vec<_>>()
    };
    let tolerance = (0.02 * radius).to_string();
    let [ball, small] = ["golf-ball@5000", "small.obj"];
    for options in [&[][..], &["--error", "5%"], &["--representative", "1%"]] {
        for (probe, scene, path, side) in [(small, ball, "in.csv", 0), (ball, small, "around.csv", 1)] {
            if options.contains(&"--representative") && side == 1 {
                // The error asked for is a fraction of the probe's radius: too coarse for the small one.
                continue;
            }
            let words = query(probe, scene, path, &tolerance, &[options, &["--json"]].concat());
            let replay = json(&words.iter().map(String::as_str).collect::<Vec<_>>(), folder);
            let names = [["probe_inside", "scene_inside"], ["scene_inside", "probe_inside"]][side];
            let poses = replay["poses"].as_array().expect("poses");
            let mut inside = 0;
            for (pose, height) in poses.iter().zip(&heights) {
                let depth = pose["depth_max"].as_f64().unwrap() / radius;
                let context = format!("{options:?}, {probe}, {height}: {pose}");
                // Dimples are less than 0.05 of the radius deep.
                if *height < 0.75 {
                    assert_eq!(pose[names[0]], true, "{context}");
                    assert!(depth >= 1.15 - height && depth <= 1.21 - height, "{context}");
                    assert_eq!(pose["distance_min"], 0.0, "{context}");
                } else if *height > 1.21 {
                    assert!(pose[names[0]] == false && depth == 0.0, "{context}");
                }
                assert_eq!(pose[names[1]], false, "{context}");
                inside += u64::from(pose[names[0]] == true);
            }
            assert_eq!(replay["summary"][names[0]], inside);
            assert!(inside >= 9 && replay["summary"][names[1]] == 0, "{}", replay["summary"]);
        }
    }
    let words = query(small, "open.obj", "in.csv", &tolerance, &["--json"]);
    let replay = json(&words.iter().map(String::as_str).collect::<Vec<_>>(), folder);
    for found in [&replay["summary"], &replay["poses"][16]] {
        assert!(found["probe_inside"].is_null() && !found["scene_inside"].is_null(), "{found}");
    }
    let words = query(small, "open.obj", "in.csv", &tolerance, &[]);
    let printed = palpate(&words.iter().map(String::as_str).collect::<Vec<_>>(), folder);
    let printed = String::from_utf8_lossy(&printed.stdout).into_owned();
    assert!(printed.contains("the probe unknown, since the scene object's mesh is open"), "{printed}");
}

#[test]
fn lockstep_sessions_are_reproducible() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let run = |record: &str| {
        json(
            &[
                "run",
                "ellipsoid@500",
                "golf-ball@5000",
                "--lockstep",
                "--contact-rate",
                "250",
                "--seconds",
                "3",
                "--record",
                record,
                "--report",
                "r.html",
                "--mass",
                "0.05",
                "--json",
            ],
            folder,
        )
    };
    let summary = run("a.csv");
    run("b.csv");
    assert_eq!(
        keys(&summary),
        [
            "contact",
            "contacts_at_end",
            "contacts_max",
            "coupling_force_max",
            "coupling_stretch_max",
            "depth_max",
            "device_error",
            "dissipated_j",
            "energy_min_j",
            "events",
            "first_touch_s",
            "grasp",
            "haptic",
            "invariants",
            "realtime",
            "seconds",
            "spans",
            "stages",
            "tolerance",
            "unused_settings"
        ]
    );
    assert!(summary["realtime"].is_null(), "nothing is asked for on a simulated clock");
    assert_eq!(summary["haptic"]["steps"], 3000);
    assert_eq!(summary["contact"]["rate_hz"], 250.0);
    let (a, b) = (std::fs::read(folder.join("a.csv")).unwrap(), std::fs::read(folder.join("b.csv")).unwrap());
    assert!(a == b, "two lockstep recordings differ");
    assert_eq!(a.iter().filter(|&&byte| byte == b'\n').count(), 3001);
    let html = std::fs::read_to_string(folder.join("r.html")).unwrap();
    assert!(html.contains("<svg") && html.contains("</html>"));
    assert!(!html.contains("href=") && html.matches("src=").count() == 1, "the report stands alone");
    let (_, picture) = html.split_once("src=\"data:image/png;base64,").expect("a picture");
    assert!(picture.find('"').is_some_and(|length| (10_000..400_000).contains(&length)));
    for said in ["mass</th><td>0.05 kg", "tolerance</th>", "palpate 0.", "(blue) at "] {
        assert!(html.contains(said), "{said}");
    }
}

/// On a simulated clock, a replayed device renders the same wrenches, bit for bit.
#[test]
fn a_recorded_device_is_replayed_exactly() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let run = |device: &str, record: &str, kept: &str| {
        let session =
            ["run", "ellipsoid@500", "golf-ball@5000", "--lockstep", "--seconds", "4", "--friction", "0.3"];
        let files = ["--device", device, "--record", record, "--record-device", kept];
        json(&[&session[..], &files, &["--json"]].concat(), folder);
        std::fs::read(folder.join(record)).unwrap()
    };
    let first = run("emulated:touch", "first.csv", "device.csv");
    assert!(first.len() > 100_000);
    let again = run("replay:device.csv", "again.csv", "device.rec");
    assert!(first == again, "the replayed text");
    let compact = run("replay:device.rec", "compact.csv", "last.csv");
    assert!(first == compact, "the replayed compact form");
    let files = ["device.csv", "last.csv"].map(|name| std::fs::read(folder.join(name)).unwrap());
    assert!(files[0] == files[1], "a recording of a replayed recording is that recording");
    // A session with an enabling button that is not held.
    let held =
        ["run", "ellipsoid@500", "golf-ball@5000", "--lockstep", "--seconds", "1", "--enable-button", "0"];
    json(&[&held[..], &["--record-device", "held.csv", "--json"]].concat(), folder);
    let held = std::fs::read_to_string(folder.join("held.csv")).unwrap();
    // The device is not enabled, and wrenches during contact are withheld.
    assert!(held.lines().skip(2).all(|line| line.ends_with(",0,4096") || line.ends_with(",0,12288")));
    assert!(held.lines().skip(2).any(|line| line.ends_with(",0,4096")));
    // A path of the same poses without velocities gives another twist, and so other wrenches.
    let poses: String = String::from_utf8(files[0].clone())
        .unwrap()
        .lines()
        .skip(2)
        .map(|line| line.split(',').skip(1).take(8).collect::<Vec<_>>().join(",") + "\n")
        .collect();
    std::fs::write(folder.join("poses.csv"), format!("t,px,py,pz,qx,qy,qz,qw\n{poses}")).unwrap();
    assert!(first != run("replay:poses.csv", "bare.csv", "bare.rec"));
}

#[test]
fn detail_is_felt_on_coarse_meshes() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let mut square = String::new();
    for (x, y) in [(-1, -1), (1, -1), (1, 1), (-1, 1)] {
        let place = [0.05 * f64::from(x), 0.05 * f64::from(y)];
        square += &format!("v {} {} 0\nvt {} {}\n", place[0], place[1], 10 * x, 640 * y);
    }
    std::fs::write(folder.join("plate.obj"), square + "f 1/1 2/2 3/3 4/4\n").unwrap();
    let ridge = |x: u32| (32_000.0 * (1.0 + (std::f64::consts::TAU * f64::from(x) / 64.0).cos())) as u16;
    let ridges = image::ImageBuffer::from_fn(64, 1, |x, _| image::Luma([ridge(x)]));
    ridges.save(folder.join("ridges.png")).unwrap();
    let run = |arguments: &[&str]| {
        let always = ["--lockstep", "--seconds", "3", "--tolerance", "2e-4", "--json"];
        json(&[&["run", "ellipsoid@500"], arguments, &always].concat(), folder)
    };
    // A glTF file that names the image has the same detail.
    let corners = [[-0.05_f32, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]];
    let places = corners.iter().flat_map(|[x, y]| [*x, *y, 0.0]);
    let uv = corners.iter().flat_map(|[x, y]| [200.0 * x, -12_800.0 * y]);
    let mut data: Vec<u8> = places.chain(uv).flat_map(f32::to_le_bytes).collect();
    data.extend([0, 1, 2, 0, 2, 3]);
    std::fs::write(folder.join("plate.bin"), &data).unwrap();
    let plate = serde_json::json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [
            {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}
        ]}],
        "materials": [{"extras": {"heightTexture": {"index": 0, "amplitude": 0.001}}}],
        "textures": [{"source": 0}], "images": [{"uri": "ridges.png"}],
        "buffers": [{"uri": "plate.bin", "byteLength": data.len()}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 32},
            {"buffer": 0, "byteOffset": 80, "byteLength": 6}
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
             "min": [-0.05, -0.05, 0.0], "max": [0.05, 0.05, 0.0]},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5121, "count": 6, "type": "SCALAR"}
        ]
    });
    std::fs::write(folder.join("plate.gltf"), plate.to_string()).unwrap();
    let flat = run(&["plate.obj"]);
    let image = ["plate.obj", "--scene-heights", "ridges.png", "--amplitude", "0.001"];
    let ridged = run(&image);
    let named = run(&["plate.gltf"]);
    let baked = run(&["block@300", "--scene-detail", "block@20000", "--texel", "5e-4"]);
    assert_eq!(flat["stages"]["textures"], "off: no object has a haptic texture");
    let repaired =
        palpate(&["run", "ellipsoid@500", "plate.gltf", "--repair", "--lockstep", "--seconds", "1"], folder);
    assert!(repaired.status.success() && String::from_utf8_lossy(&repaired.stderr).contains("left out"));
    let force = |summary: &Value| summary["coupling_force_max"].as_f64().expect("a force");
    assert!((force(&named) / force(&ridged) - 1.0).abs() < 1e-3, "{named}, {ridged}");
    assert!((force(&flat) / force(&ridged) - 1.0).abs() > 1e-2, "{flat}, {ridged}");
    for summary in [&ridged, &named, &baked] {
        let textures = summary["stages"]["textures"].as_str().expect("a stage");
        assert!(textures.starts_with("on, computed by CPU: scene "), "{textures}");
        assert!(summary["coupling_force_max"].as_f64().is_some_and(|force| force > 0.1), "{summary}");
    }
    for (arguments, what) in [
        (["--scene-heights", "ridges.png"].as_slice(), "amplitude"),
        (&["--scene-heights", "none.png", "--amplitude", "1e-3"], "none.png"),
        (&["--scene-heights", "ridges.png", "--amplitude", "-1"], "amplitude"),
        (&["--scene-detail", "block", "--texel", "0"], "texel"),
        (&["--scene-heights", "ridges.png", "--amplitude", "1e-3", "--texture-reach", "0"], "half-size"),
    ] {
        let given = ["run", "ellipsoid@500", "plate.obj", "--lockstep", "--seconds", "1"];
        let output = palpate(&[&given, arguments].concat(), folder);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && stderr.contains(what), "{arguments:?}: {stderr}");
    }
}

#[test]
fn a_real_time_session_keeps_count() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let summary = json(
        &["run", "ellipsoid@500", "golf-ball@5000", "--seconds", "0.5", "--record", "a.csv", "--json"],
        folder,
    );
    let number = |path: &str| summary.pointer(path).and_then(Value::as_u64).expect(path);
    assert_eq!(number("/haptic/steps") + number("/haptic/missed_deadlines"), 500, "{summary}");
    let rows = std::fs::read_to_string(folder.join("a.csv")).unwrap().lines().count() as u64;
    assert_eq!(rows, 1 + number("/haptic/steps") - number("/events/record_dropped"));
    assert!(summary["contact"]["rate_hz"].as_f64().is_some_and(|rate| rate > 0.0), "{summary}");
}

#[test]
fn devices_are_listed() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let devices = json(&["devices", "--json"], folder.path());
    let devices = devices.as_array().expect("a list");
    assert!(
        devices.iter().any(|device| device["address"].as_str().is_some_and(|a| a.starts_with("emulated")))
    );
    // The udev rules are printed whether or not a device is plugged in.
    let listed = succeeds(&["devices"], folder.path());
    assert!(listed.contains("emulated:premium-1.5") && listed.contains("hid:"), "{listed}");
    let rules = succeeds(&["devices", "--udev"], folder.path());
    assert!(
        rules.lines().all(|line| line.starts_with("# ") || line.starts_with("KERNEL==\"hidraw*\", ")),
        "{rules}"
    );
    assert!(rules.contains("256f") && rules.contains("16c0"));
}

#[test]
fn errors_name_the_fault_and_a_remedy() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    std::fs::write(folder.join("t.csv"), "t,px,py,pz,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n0,0,zero,0,0,0,0,1\n")
        .unwrap();
    let good = "t,px,py,pz,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n";
    std::fs::write(folder.join("ok.csv"), good).unwrap();
    std::fs::create_dir(folder.join("sub")).unwrap();
    succeeds(&["export", "ellipsoid@500", "-o", "m.obj"], folder);
    let mesh = std::fs::read(folder.join("m.obj")).unwrap();
    for (arguments, said) in [
        (&["check", "golf-bal"][..], "golf-ball"),
        (&["check", "golf-ball@many"], "golf-ball@20000"),
        (&["check", "golf-ball@3"], "golf-ball"),
        (&["check", "golf-ball", "--scale", "-1"], "scale"),
        (&["check", "missing.obj"], "missing.obj"),
        (&["check", "mesh.dwg"], ".obj"),
        (&["inspect", "missing.clod"], "missing.clod"),
        (&["export", "cup-low", "-o", "no/such/folder/cup.obj"], "no/such/folder/cup.obj"),
        (&["run", "cup-low", "spoon-low", "--device", "phantom"], "emulated"),
        (
            &["run", "cup-low", "spoon-low", "--device", "emulated:task=fly"],
            "`task=fly`: give one of explore, press",
        ),
        (
            &["run", "cup-low", "spoon-low", "--device", "emulated:path=ok.csv", "--record", "ok.csv"],
            "named twice",
        ),
        (&["run", "cup-low", "spoon-low", "--mass", "-1"], "mass"),
        // Millimetres read as metres: the error names the factor, and the option to accept the size.
        (&["run", "m.obj", "m.obj", "--scale", "1000"], "m.obj: the bounding radius of "),
        (&["run", "m.obj", "m.obj", "--scale", "1000"], "for it alone) by 0.001, or give --unusual-size"),
        (&["run", "cup-low", "spoon-low", "--seconds", "-1"], "seconds"),
        (&["run", "cup-low", "spoon-low", "--contact-rate", "nan", "--lockstep"], "contact-rate"),
        (&["run", "cup-low", "spoon-low", "--tolerance", "0"], "tolerance"),
        (&["run", "cup-low", "spoon-low", "--tolerance", "1"], "bounding radius"),
        (&["run", "cup-low", "spoon-low", "--record", "."], "."),
        (&["run", "cup-low", "spoon-low", "--report", "no/such/folder/r.html"], "no/such/folder/r.html"),
        (&["run", "cup-low", "spoon-low", "--seconds", "80000", "--report", "r.html"], "--record"),
        (&["query", "cup-low", "spoon-low", "--trajectory", "t.csv", "--tolerance", "1%"], "t.csv:3"),
        (&["query", "cup-low", "spoon-low", "--trajectory", "ok.csv", "--tolerance", "1"], "bounding radius"),
        (&["query", "cup-low", "spoon-low", "--trajectory", ".", "--tolerance", "1%"], "directory"),
        // An output file must not be an input file, and must have the extension of its format.
        (&["build", "m.obj", "-o", "./m.obj"], ".clod"),
        (&["build", "M.CLOD", "-o", "x.clod"], "hierarchy"),
        (&["build", "m.obj", "-o", "c.clod", "--json", "sub/../m.obj"], "named twice"),
        (&["export", "cup-low", "-o", "cup.stl"], ".obj"),
        (&["run", "m.obj", "cup-low", "--record", "m.obj"], "named twice"),
        (&["run", "cup-low", "spoon-low", "--record", "a.csv", "--report", "a.csv"], "named twice"),
        (&["run", "cup-low", "spoon-low", "--device", "replay:ok.csv", "--record", "ok.csv"], "named twice"),
    ] {
        let output = palpate(arguments, folder);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "palpate {arguments:?}: {stderr}");
        // A warning of the loader may come before.
        let refusals = stderr.lines().filter(|line| !line.contains(": warning: "));
        assert_eq!(refusals.count(), 1, "{stderr}");
        assert!(stderr.contains(said), "palpate {arguments:?} should mention '{said}': {stderr}");
    }
    assert!(std::fs::read(folder.join("m.obj")).unwrap() == mesh, "an input was overwritten");
    assert_eq!(std::fs::read_to_string(folder.join("ok.csv")).unwrap(), good, "an input was overwritten");
    for leftover in ["a.csv", "r.html", "c.clod", "x.clod", "cup.stl"] {
        assert!(!folder.join(leftover).exists(), "{leftover} was left by a command that was refused");
    }
    for usage in
        [&["frobnicate"][..], &["check"], &["query", "cup", "spoon"], &["run", "cup", "spoon", "--rate", "x"]]
    {
        assert_eq!(palpate(usage, folder).status.code(), Some(2), "palpate {usage:?}");
    }
}

#[test]
fn extensions_may_be_upper_case_and_null_devices_written_twice() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    succeeds(&["build", "ellipsoid@500", "-o", "E.CLOD"], folder);
    assert_eq!(json(&["inspect", "E.CLOD", "--json"], folder)["triangles"], 500);
    if Path::new("/dev/null").exists() {
        let null = "/dev/null";
        succeeds(
            &[
                "run",
                "E.CLOD",
                "E.CLOD",
                "--lockstep",
                "--seconds",
                "0.1",
                "--record",
                null,
                "--report",
                null,
                "--json",
                null,
            ],
            folder,
        );
    }
}

#[test]
fn a_session_runs_with_any_integrator() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let session = |more: &[&str]| {
        let run =
            ["run", "ellipsoid@500", "ellipsoid@500", "--lockstep", "--seconds", "2", "--record", "r.csv"];
        succeeds(&[&run, more].concat(), folder.path());
        std::fs::read_to_string(folder.path().join("r.csv")).expect("recording")
    };
    let default = session(&[]);
    assert_eq!(session(&["--integrator", "semi-implicit"]), default);
    for name in ["fully-implicit", "forward-euler", "symplectic-euler", "runge-kutta-4", "quasi-static"] {
        assert!(session(&["--integrator", name]) != default, "{name} gives what the default does");
    }
    let wrong = palpate(&["run", "ellipsoid@500", "ellipsoid@500", "--integrator", "rk4"], folder.path());
    let message = String::from_utf8_lossy(&wrong.stderr);
    assert!(
        !wrong.status.success() && message.contains("rk4") && message.contains("quasi-static"),
        "{message}"
    );
}

#[test]
fn a_summary_lists_the_stages_and_their_reasons() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let arguments = ["run", "ellipsoid@500", "torus@4000", "--lockstep", "--seconds", "0.01"];
    let printed = succeeds(&arguments, folder.path());
    for (stage, why) in [
        ("contact query", "on: one scene object"),
        ("device", "Phantom Premium 1.5 6DOF (emulated): on: force along x, y, z, torque about x, y, z"),
        ("contact response", "constraints"),
        ("contact search", "on the meshes: contacts are constraints"),
        ("hierarchy", "probe ellipsoid@500: off, one convex hull; scene torus@4000: on, "),
        ("braking", "off: contacts are constraints"),
        ("clustering", "off: contacts are constraints"),
        ("proxy", "off: contacts are constraints"),
        ("integrator", "semi-implicit"),
        ("textures", "off: "),
        ("friction", "off: "),
        ("engaging", "once, for 10.0 ms: the wrench was ramped up"),
        ("safety limits", "all kept"),
        ("touch", "nothing was touched"),
        ("deepest penetration", "0: nothing was touched"),
    ] {
        let row = printed.lines().find(|line| line.starts_with(&format!("{stage}  ")));
        assert!(row.is_some_and(|row| row.contains(why)), "{stage}: {why}\n{printed}");
    }
    assert!(printed.starts_with("touch"), "what was felt comes first: {printed}");
    let penalties =
        succeeds(&[&arguments[..], &["--response", "penalty", "--error", "1%"]].concat(), folder.path());
    for (stage, why) in [
        ("contact response", "penalties: by the setting"),
        ("contact search", "levels of detail: by the setting"),
        ("hierarchy", "probe ellipsoid@500: off, one convex hull; scene torus@4000: on, "),
        ("braking", "on: by its setting"),
        ("clustering", "on beyond 5 contacts"),
        ("proxy", "on: by its setting"),
    ] {
        let row = penalties.lines().find(|line| line.starts_with(&format!("{stage}  ")));
        assert!(row.is_some_and(|row| row.contains(why)), "{stage}: {why}\n{penalties}");
    }
    assert!(
        printed.contains("--report FILE.html") && printed.contains("ellipsoid@500 torus@4000"),
        "{printed}"
    );
}

/// With a contact query in each haptic step the first touch is that of the recording, and not "nothing".
#[test]
fn the_summary_does_not_contradict_the_recording() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    for (rate, response) in [("1000", "constraints"), ("999", "constraints"), ("1000", "penalty")] {
        let run = [
            "run",
            "ellipsoid@500",
            "golf-ball@5000",
            "--lockstep",
            "--seconds",
            "2",
            "--contact-rate",
            rate,
        ];
        let summary =
            json(&[&run[..], &["--response", response, "--json", "--record", "r.csv"]].concat(), folder);
        let recording = std::fs::read_to_string(folder.join("r.csv")).expect("a recording");
        let pushed = recording.lines().skip(1).find_map(|line| {
            let numbers: Vec<f64> = line.split(',').map(|field| field.parse().expect("a number")).collect();
            let force = numbers[21..24].iter().map(|part| part * part).sum::<f64>().sqrt();
            (force > 1e-6).then_some(numbers[0])
        });
        assert!(pushed.is_some_and(|time| (1.3..1.6).contains(&time)), "{rate} Hz, {response}: {pushed:?} s");
        assert_eq!(summary["first_touch_s"].as_f64(), pushed, "{rate} Hz, {response}");
        // What lasts is told as a time; the count is of steps.
        let (steps, span) = (&summary["events"]["engaging"], &summary["spans"]["engaging"]);
        assert_eq!(span["times"], 1, "{span}");
        let seconds = span["seconds"].as_f64().expect("a time");
        assert!(
            (seconds - 1e-3 * steps.as_f64().expect("a count")).abs() < 1e-9,
            "{seconds} s, {steps} steps"
        );
    }
}

/// A trajectory with the time stamps of a clock that counts since 1970, as a ROS bag has them, gives what the
/// same motion from 0 gives, wherever one is read.
#[test]
fn time_stamps_of_trajectories_count_from_the_first() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    for (name, first) in [("plain.csv", 0_u64), ("stamped.csv", 1_767_225_600)] {
        let rows = (0..200_u64).map(|i| {
            // 20 ms apart, and so that the fraction does not begin at 0.
            let time = 5 + 2 * i;
            let height = 0.12 - 4e-4 * i as f64;
            format!("{}.{:02},0,0,{height},0,0,0,1\n", first + time / 100, time % 100)
        });
        let text = format!("t,px,py,pz,qx,qy,qz,qw\n{}", rows.collect::<String>());
        std::fs::write(folder.join(name), text).expect("written");
    }
    let query = |name: &str| {
        let query = ["query", "ellipsoid@500", "golf-ball@1000", "--trajectory", name, "--tolerance", "1%"];
        json(&[&query[..], &["--json"]].concat(), folder)["poses"].as_array().expect("poses").clone()
    };
    let (plain, stamped) = (query("plain.csv"), query("stamped.csv"));
    assert_eq!((plain.len(), stamped.len()), (200, 200));
    for (one, other) in plain.iter().zip(&stamped) {
        let [from_zero, from_first] = [one, other].map(|pose| pose["t"].as_f64().expect("a time"));
        assert!((from_zero - 0.05 - from_first).abs() < 1e-12, "{from_zero} and {from_first} s");
        assert_eq!((&one["contacts"], &one["force"]), (&other["contacts"], &other["force"]));
    }
    for device in ["replay:", "emulated:path="] {
        let record = |name: &str| {
            let device = format!("{device}{name}");
            let run = [
                "run",
                "ellipsoid@500",
                "golf-ball@1000",
                "--lockstep",
                "--seconds",
                "4",
                "--device",
                &device,
            ];
            json(&[&run[..], &["--json", "--record", "r.csv"]].concat(), folder);
            let recording = std::fs::read_to_string(folder.join("r.csv")).expect("a recording");
            let last = recording.lines().last().expect("rows");
            last.split(',').map(|field| field.parse().expect("a number")).collect::<Vec<f64>>()
        };
        let (plain, stamped) = (record("plain.csv"), record("stamped.csv"));
        let most = plain.iter().zip(&stamped).map(|(one, other)| (one - other).abs()).fold(0.0, f64::max);
        assert!(most < 1e-6, "{device}: {plain:?} and {stamped:?}");
        assert!(plain[10] < 0.1, "{device}: the hand has moved: {plain:?}");
    }
}

/// The printed summary has convenient units, and says how to open the report.
#[test]
fn the_printed_summary_has_convenient_units() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let arguments =
        ["run", "ellipsoid@500", "golf-ball@1000", "--lockstep", "--seconds", "3", "--report", "r.html"];
    let printed = succeeds(&arguments, folder.path());
    let row = |name: &str| {
        let found = printed.lines().find(|line| line.starts_with(&format!("{name}  ")));
        found.unwrap_or_else(|| panic!("{name}: {printed}")).trim_start_matches(name).trim().to_owned()
    };
    assert!(row("touch").starts_with("first after "), "{printed}");
    let most = row("contacts");
    assert!(most.starts_with("at most ") && most.ends_with(" at the end"), "{most}");
    assert!(
        row("deepest penetration").ends_with(" mm") || row("deepest penetration").starts_with("0: contacts")
    );
    assert!(row("largest coupling stretch").ends_with(" mm"), "{printed}");
    assert!(row("lowest net energy at the device (negative: created)").ends_with('J'), "{printed}");
    assert!(row("haptic rate").starts_with("1.00 kHz, 3,000 steps"), "{printed}");
    assert!(row("haptic step").contains("µs") && !printed.contains(" ns,"), "{printed}");
    assert!(printed.contains("The report is r.html; open it in a browser"), "{printed}");
}

/// A golf ball descends onto a plate and slides: representative contacts push straight up, as exact ones do.
#[test]
fn representative_contacts_are_reported_with_their_areas() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let radius = json(&["check", "golf-ball@5000", "--json"], folder)["bounding_radius"].as_f64().unwrap();
    let mut csv = String::from("t,px,py,pz,qx,qy,qz,qw\n");
    for i in 0..=20 {
        let (x, z) = (2e-4 * f64::from(i), radius * (1.04 - 0.0025 * f64::from(i)));
        csv.push_str(&format!("{},{x},0.01,{z},0,0,0,1\n", f64::from(i) * 1e-3));
    }
    std::fs::write(folder.join("t.csv"), csv).unwrap();
    let arguments =
        ["query", "golf-ball@5000", "plate", "--trajectory", "t.csv", "--tolerance", "2%", "--json"];
    let replayed = |options: &[&str]| json(&[&arguments[..], options].concat(), folder);
    let [exact, found] =
        [&["--exact"][..], &["--representative", "0.2%", "--contacts", "c.csv"]].map(replayed);
    assert_eq!(keys(&found["summary"]), and(keys(&exact["summary"]), &["eps"]));
    assert_eq!(keys(&found["poses"][0]), and(keys(&exact["poses"][0]), &["eps", "complete", "too_deep"]));
    let eps = found["summary"]["eps"].as_f64().unwrap();
    assert!(eps > 0.0 && eps < 0.02 * radius, "{eps}");
    // From scratch all samples are read; from pose to pose those that there is work for, while it comes near.
    let complete = |replay: &Value| {
        let poses = replay["poses"].as_array().unwrap().iter();
        poses.filter(|pose| pose["complete"] == true).count()
    };
    assert_eq!(complete(&replayed(&["--representative", "0.2%", "--cold"])), 21);
    assert!(complete(&found) > 5, "{} complete queries", complete(&found));
    // One microsecond is not enough, which is reported; there are still forces.
    let hurried = replayed(&["--representative", "0.2%", "--budget-us", "1"]);
    let poses =
        || hurried["poses"].as_array().unwrap().iter().filter(|pose| pose["contacts"].as_u64() > Some(0));
    assert!(poses().count() > 5 && poses().any(|pose| pose["complete"] == false), "{hurried}");
    assert!(hurried["summary"]["eps"].as_f64().unwrap() >= eps);
    let numbers = |pose: &Value, key: &str| -> Vec<f64> {
        pose[key].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
    };
    let length = |vector: &[f64]| vector.iter().map(|x| x * x).sum::<f64>().sqrt();
    let mut pushed = 0;
    for (pose, wanted) in found["poses"].as_array().unwrap().iter().zip(exact["poses"].as_array().unwrap()) {
        let (own, other) = (numbers(pose, "force"), numbers(wanted, "force"));
        let (depth, truth) = (pose["depth_max"].as_f64().unwrap(), wanted["depth_max"].as_f64().unwrap());
        // The spacing of the field's lattice is 4 % of the radius here.
        assert!((depth - truth).abs() < 2e-3 * radius, "{depth} m for {truth} m");
        // Where the surfaces barely touch, one method finds the contact slightly before the other.
        if length(&other) > 0.05 {
            pushed += 1;
            let along = own.iter().zip(&other).map(|(x, y)| x * y).sum::<f64>();
            let angle = (along / (length(&own) * length(&other))).min(1.0).acos().to_degrees();
            // Normals are those of the dimples, slightly tilted: 3.0° was measured before the limit was set.
            assert!(angle < 5.0, "{angle}° at t = {} s", pose["t"]);
            // Representative forces average the depth over the area of contact, whose largest depth is the
            // exact one; of exact contacts each of up to 5 clusters pushes.
            let share = length(&own) / length(&other);
            assert!((0.15..1.1).contains(&share), "{share} of the exact force");
            assert!(pose["contacts"].as_u64().unwrap() <= 60, "{} contacts", pose["contacts"]);
        }
    }
    assert!(pushed > 10, "{pushed} poses pushed");
    assert_eq!(found["poses"][0]["contacts"], 0);
    assert_eq!(found["poses"][0]["distance_min"], Value::Null);
    let rows = std::fs::read_to_string(folder.join("c.csv")).unwrap();
    assert!(rows.starts_with("t,px,py,pz,nx,ny,nz,depth,area\n"), "{rows}");
    let counts = found["poses"].as_array().unwrap().iter().map(|pose| pose["contacts"].as_u64().unwrap());
    assert_eq!(rows.lines().count() as u64 - 1, counts.sum::<u64>());
    let areas: f64 =
        rows.lines().skip(1).map(|row| row.split(',').next_back().unwrap().parse::<f64>().unwrap()).sum();
    assert!(areas > 0.0);
    // A second run gives the same result, except for the times.
    let forces = |replay: &Value| -> Vec<Vec<f64>> {
        replay["poses"].as_array().unwrap().iter().map(|pose| numbers(pose, "force")).collect()
    };
    assert_eq!(forces(&replayed(&["--representative", "0.2%"])), forces(&found));
    // Options that conflict, and invalid values.
    for with in [&["--exact"][..], &["--error", "1%"], &["--interpolate"]] {
        let words = [&arguments[..], &["--representative"], with].concat();
        let output = palpate(&words, folder);
        assert_eq!(output.status.code(), Some(2), "{with:?}");
        assert!(String::from_utf8_lossy(&output.stderr).contains("--representative"), "{with:?}");
    }
    assert_eq!(
        palpate(&[&arguments[..], &["--representative", "much"]].concat(), folder).status.code(),
        Some(2)
    );
    for refused in ["0", "5%", "1e-9"] {
        let output = palpate(&[&arguments[..], &["--representative", refused]].concat(), folder);
        assert_eq!(output.status.code(), Some(1), "{refused}");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains("--representative") && said.contains("0.02 % to 1 %"), "{said}");
    }
}

/// A session renders representative contacts by an option or a scene file, reproducibly.
#[test]
fn sessions_render_representative_contacts() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let run = |scene: &str, record: &str, options: &[&str]| {
        let all = ["--lockstep", "--seconds", "1.5", "--response", "penalty", "--record", record];
        json(&[&["run", "ellipsoid@500", scene, "--json"], &all[..], options].concat(), folder)
    };
    let summary = run("golf-ball@1000", "first.csv", &["--representative", "0.5%"]);
    let stage = |summary: &Value| summary["stages"]["contact search"].as_str().expect("a stage").to_owned();
    assert_eq!(stage(&summary), "distance fields, depth error about 0.00008 m");
    assert!(summary["contacts_max"].as_u64() > Some(0), "nothing was touched: {summary}");
    run("golf-ball@1000", "second.csv", &["--representative", "0.5%"]);
    let read = |file: &str| std::fs::read_to_string(folder.join(file)).expect(file);
    assert!(read("first.csv") == read("second.csv"), "a session is not the same again");
    let scene = "[[object]]\nmodel = \"golf-ball@1000\"\n[settings]\nsearch.method = \"Representatives\"\n\
                 search.representative_error = 8e-5\n";
    std::fs::write(folder.join("scene.toml"), scene).unwrap();
    run("scene.toml", "third.csv", &[]);
    assert!(read("first.csv") == read("third.csv"), "the scene file says the same");
    // An error threshold selects levels of detail.
    let levels = run("scene.toml", "levels.csv", &["--error", "1%"]);
    assert!(stage(&levels).starts_with("levels of detail"), "{}", stage(&levels));
    for with in [&["--error", "1%"][..], &["--no-interpolation"], &["--budget-us", "100"]] {
        let words = [&["run", "ellipsoid@500", "golf-ball@1000", "--representative"], with].concat();
        assert_eq!(palpate(&words, folder).status.code(), Some(2), "{with:?}");
    }
    let refused = palpate(&["run", "ellipsoid@500", "golf-ball@1000", "--representative", "5%"], folder);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(1) && said.contains("(--representative)"), "{said}");
}

/// A recording is a trajectory of the object's poses.
#[test]
fn recordings_are_replayed_as_trajectories() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let pair = ["ellipsoid@500", "golf-ball@1000"];
    let run = |device: &str, record: &str| {
        let options = ["--lockstep", "--seconds", "1.5", "--device", device, "--record", record, "--json"];
        json(&[&["run"], &pair[..], &options].concat(), folder)
    };
    run("emulated", "first.csv");
    let rows = |file: &str| -> Vec<Vec<String>> {
        let text = std::fs::read_to_string(folder.join(file)).expect(file);
        text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
    };
    let first = rows("first.csv");
    let object = first[0].iter().position(|name| name == "object_px").expect("a column");
    let replay = json(
        &[&["query"], &pair[..], &["--trajectory", "first.csv", "--tolerance", "1%", "--json"]].concat(),
        folder,
    );
    assert_eq!(replay["poses"].as_array().map(Vec::len), Some(first.len() - 1));
    // The same poses, given as a path, give the same contacts.
    let mut path = String::from("t,px,py,pz,qx,qy,qz,qw\n");
    for row in &first[1..] {
        path += &format!("{},{}\n", row[0], row[object..object + 7].join(","));
    }
    std::fs::write(folder.join("path.csv"), path).expect("written");
    let direct = json(
        &[&["query"], &pair[..], &["--trajectory", "path.csv", "--tolerance", "1%", "--json"]].concat(),
        folder,
    );
    let found = |replay: &Value| -> Vec<Value> {
        let poses = replay["poses"].as_array().expect("poses");
        poses.iter().map(|pose| serde_json::json!([pose["t"], pose["contacts"], pose["force"]])).collect()
    };
    assert_eq!(found(&replay), found(&direct));
    // Replayed as a device, the recording holds the object where it was.
    run("replay:first.csv", "second.csv");
    let device = first[0].iter().position(|name| name == "device_px").expect("a column");
    let (second, step) = (rows("second.csv"), 700);
    let number = |row: &[String], column: usize| row[column].parse::<f64>().expect("a number");
    for axis in 0..3 {
        // A path starts with its first sample; in a recording that is the one after the first period.
        let (then, now) = (number(&first[step + 1], object + axis), number(&second[step], device + axis));
        assert!((then - now).abs() < 1e-6, "axis {axis}: {then} {now}");
    }
    run(&format!("emulated:hand=firm,path={}", folder.join("first.csv").display()), "third.csv");
    let output = palpate(
        &["query", "cup-low", "spoon-low", "--trajectory", "second.json", "--tolerance", "1%"],
        folder,
    );
    assert!(!output.status.success());
}

/// `build` accepts the meshes that `check` calls ready, and both name `--repair` where it helps.
#[test]
fn the_verdict_of_check_is_that_of_build() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    succeeds(&["export", "ellipsoid@500", "-o", "good.obj"], folder);
    let good = std::fs::read_to_string(folder.join("good.obj")).expect("exported");
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).expect("written");
    let faces: Vec<&str> = good.lines().filter(|line| line.starts_with("f ")).collect();
    let vertices = good.lines().filter(|line| line.starts_with("v ")).count();
    write("duplicate.obj", &format!("{good}{}\n", faces[7]));
    let turned = |line: &str| {
        let words: Vec<&str> = line.split(' ').collect();
        if words[0] == "f" {
            format!("f {} {} {}\n", words[1], words[3], words[2])
        } else {
            format!("{line}\n")
        }
    };
    write("inside-out.obj", &good.lines().map(turned).collect::<String>());
    // A second ellipsoid, shifted by a part of its size, intersects the first.
    let shift = |line: &str| {
        let words: Vec<f64> = line.split(' ').skip(1).map(|word| word.parse().expect("a number")).collect();
        match line.chars().next() {
            Some('v') => format!("v {} {} {}\n", words[0] + 0.003, words[1] + 0.002, words[2]),
            _ => {
                let corners: Vec<String> = words.iter().map(|w| (w + vertices as f64).to_string()).collect();
                format!("f {}\n", corners.join(" "))
            }
        }
    };
    let second: String =
        good.lines().filter(|line| line.starts_with("v ") || line.starts_with("f ")).map(shift).collect();
    write("crossing.obj", &(good.clone() + &second));
    let open: String =
        good.lines().filter(|line| *line != faces[0]).map(|line| format!("{line}\n")).collect();
    write("open.obj", &open);
    for (file, expected) in [
        ("good.obj", "ready"),
        ("open.obj", "open"),
        ("duplicate.obj", "needs --repair"),
        ("inside-out.obj", "needs --repair"),
        ("crossing.obj", "needs --repair"),
    ] {
        let usable = expected != "needs --repair";
        let check = json_with_warnings(&["check", file, "--json"], folder);
        let built = palpate(&["build", file, "-o", "x.clod"], folder);
        assert_eq!(
            (check["verdict"].as_str(), built.status.success()),
            (Some(expected), usable),
            "{file}: {check}"
        );
        let warned = String::from_utf8_lossy(&built.stderr).contains("the surface is open (1 openings");
        assert_eq!(warned, expected == "open", "{file}: {built:?}");
        let output = palpate(&["check", file], folder);
        let printed = String::from_utf8(output.stdout).expect("text");
        let verdict = printed.lines().find(|line| line.starts_with("verdict")).expect("a verdict");
        assert_eq!(verdict.contains("--repair"), expected != "ready", "{verdict}");
        if !usable {
            let repaired = json_with_warnings(&["check", file, "--repair", "--json"], folder);
            assert_eq!(repaired["verdict"], "ready", "{file}: {repaired}");
            let inspected = palpate(&["inspect", file, "--repair", "--json"], folder);
            assert!(inspected.status.success(), "inspect takes what it recommends");
        }
    }
    // The JSON of a mesh in millimetres has the warning about the unit.
    let large = json_with_warnings(&["check", "good.obj", "--scale", "1000", "--json"], folder);
    let warnings = large["warnings"].as_array().expect("a list");
    assert!(warnings.iter().any(|line| line.as_str().is_some_and(|line| line.contains("unit"))), "{large}");
    assert_eq!(json(&["check", "good.obj", "--json"], folder)["warnings"], serde_json::json!([]));
}

/// Runs a command that must succeed and may print warnings, and parses its JSON.
fn json_with_warnings(arguments: &[&str], folder: &Path) -> Value {
    let output = palpate(arguments, folder);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// The meshes of a pair can be scaled independently.
#[test]
fn the_meshes_of_a_pair_are_scaled_one_by_one() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    succeeds(&["export", "ellipsoid@500", "-o", "metres.obj"], folder);
    let metres = std::fs::read_to_string(folder.join("metres.obj")).expect("exported");
    let in_millimetres = |line: &str| match line.strip_prefix("v ") {
        Some(place) => {
            let scaled =
                place.split(' ').map(|word| (1e3 * word.parse::<f64>().expect("a number")).to_string());
            format!("v {}\n", scaled.collect::<Vec<_>>().join(" "))
        }
        None => format!("{line}\n"),
    };
    std::fs::write(folder.join("mm.obj"), metres.lines().map(in_millimetres).collect::<String>())
        .expect("written");
    let deepest = |probe: &str, options: &[&str]| {
        // In a longer session the probe slides, and differences in rounding grow.
        let run = ["run", probe, "golf-ball@1000", "--lockstep", "--seconds", "2", "--json"];
        json_with_warnings(&[&run[..], options].concat(), folder)["coupling_force_max"]
            .as_f64()
            .expect("a force")
    };
    let wanted = deepest("metres.obj", &[]);
    assert!(wanted > 0.05, "{wanted} N");
    let scaled = deepest("mm.obj", &["--probe-scale", "0.001"]);
    assert!((scaled / wanted - 1.0).abs() < 1e-6, "{scaled} N, {wanted} N");
    let both = deepest("mm.obj", &["--scale", "0.001", "--scene-scale", "1"]);
    assert_eq!(both, scaled, "a mesh's own scale goes before that of both");
    std::fs::write(folder.join("scene.toml"), "[[object]]\nmodel = \"golf-ball@1000\"\n").expect("written");
    let output = palpate(&["run", "metres.obj", "scene.toml", "--scene-repair"], folder);
    assert!(String::from_utf8_lossy(&output.stderr).contains("in the scene file"), "{output:?}");
}

/// Errors name the remedy: the feature of a driver or a window, the largest value of a setting.
#[test]
fn errors_name_the_feature_or_the_limit() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    std::fs::write(folder.join("no.clod"), b"glTF\x02\0\0\0").expect("written");
    std::fs::write(folder.join("no.glb"), b"\x89PNG\r\n\x1a\n\0\0\0\0").expect("written");
    let pair = ["cup-low", "spoon-low"];
    let mut cases = vec![
        (vec!["--error", "250%"], "at most 100%"),
        (vec!["--error", "5"], "at most 100%"),
        (vec!["--lockstep", "--contact-rate", "2000"], "at most 1000 Hz"),
        (vec!["--lockstep", "--contact-rate", "300", "--rate", "200"], "at most 200 Hz"),
    ];
    for (kind, compiled_in) in [
        ("haply", cfg!(feature = "haply")),
        ("force-dimension", cfg!(feature = "force-dimension")),
        ("open-haptics", cfg!(feature = "open-haptics")),
        ("haption", cfg!(feature = "haption")),
    ] {
        if !compiled_in {
            cases.push((vec!["--device", kind], "cargo run --release -p palpate-cli --features"));
        }
    }
    let mut refusals: Vec<(Vec<&str>, &str)> = Vec::new();
    for (options, said) in cases {
        refusals.push(([&["run"], &pair[..], &options].concat(), said));
    }
    if !cfg!(feature = "view") {
        refusals.push((vec!["view", "cup-low", "spoon-low"], "--features view -- view cup-low spoon-low"));
    }
    refusals.push((vec!["inspect", "no.clod"], "67 6c 54 46 02 00 00 00 (hexadecimal)"));
    refusals.push((vec!["check", "no.glb"], "89 50 4e 47 (hexadecimal)"));
    let trajectory = "t,px,py,pz,qx,qy,qz,qw\n0,0,0,1,0,0,0,1\n";
    std::fs::write(folder.join("t.csv"), trajectory).expect("written");
    let query =
        ["query", "cup-low", "spoon-low", "--trajectory", "t.csv", "--tolerance", "1%", "--error", "101%"];
    refusals.push((query.to_vec(), "at most 100%"));
    for (arguments, said) in refusals {
        let output = palpate(&arguments, folder);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), stderr.lines().count()), (Some(1), 1), "{arguments:?}: {stderr}");
        assert!(stderr.contains(said), "{arguments:?} should mention '{said}': {stderr}");
    }
}

/// The doctor answers in time on any machine, and never fails.
#[test]
fn the_doctor_reports_on_all_subjects() {
    const SUBJECTS: [&str; 10] = [
        "real-time scheduling",
        "timer lateness",
        "locked memory",
        "stolen time",
        "processor frequency",
        "processors",
        "graphics adapters",
        "HID devices",
        "libraries of device makers",
        "cache of hierarchies",
    ];
    let folder = tempfile::tempdir().expect("temporary folder");
    let blocked = folder.path().join("file");
    std::fs::write(&blocked, "").expect("written");
    let cache = blocked.join("cache");
    let doctor = |arguments: &[&str], bare: bool| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
        command.args(arguments).current_dir(folder.path());
        if bare {
            command.env_clear().env("VK_ICD_FILENAMES", "/nonexistent").env("XDG_CACHE_HOME", &cache);
        }
        let begun = std::time::Instant::now();
        let output = command.output().expect("the binary starts");
        let seconds = begun.elapsed().as_secs_f64();
        // Graphics drivers may write to standard error.
        let stderr = String::from_utf8_lossy(&output.stderr);
        let own = stderr.contains("palpate") || stderr.contains("panicked");
        assert!(output.status.success() && !own, "{output:?}");
        assert!(seconds < 10.0, "{seconds} s");
        String::from_utf8(output.stdout).expect("UTF-8")
    };
    for bare in [false, true] {
        let report: Value = serde_json::from_str(&doctor(&["doctor", "--json"], bare)).expect("JSON");
        let findings = report["findings"].as_array().expect("a list");
        let names: Vec<&str> = findings.iter().filter_map(|finding| finding["name"].as_str()).collect();
        assert_eq!(names, SUBJECTS);
        for finding in findings {
            let verdict = finding["verdict"].as_str().expect("a verdict");
            assert!(["good", "could be better", "bad", "unknown"].contains(&verdict), "{finding}");
            assert!(finding["measured"].as_str().is_some_and(|text| !text.is_empty()), "{finding}");
            assert!(finding["remedy"].is_string() || finding["remedy"].is_null(), "{finding}");
        }
        let at = |key: &str| report["lateness_us"][key].as_f64().expect("a number");
        assert!(at("p50") <= at("p99") && at("p99") <= at("p999") && at("p999") <= at("max"), "{report}");
        assert!(at("wakes") + at("missed") >= 1000.0, "{report}");
        let bins = report["lateness_us"]["histogram"].as_array().expect("a list");
        let counted: f64 = bins.iter().filter_map(|bin| bin["count"].as_f64()).sum();
        assert_eq!(counted, at("wakes"));
        let line = report["limits_line"].as_str().expect("a line");
        let (user, rest) = line.split_once(' ').expect("two words");
        assert_eq!(rest, "- rtprio 85");
        if cfg!(unix) {
            let id = Command::new("id").arg("-un").output().expect("id");
            assert_eq!(user, String::from_utf8_lossy(&id.stdout).trim());
        }
        if bare {
            let cache =
                findings.iter().find(|finding| finding["name"] == "cache of hierarchies").expect("found");
            assert_eq!(cache["verdict"], "could be better", "{cache}");
        }
    }
    let printed = doctor(&["doctor"], true);
    for subject in SUBJECTS {
        assert!(printed.contains(subject), "{subject}: {printed}");
    }
    assert!(printed.contains('█') && printed.contains("lateness of"), "{printed}");
}

/// Each task of the emulated hand is in contact for its part of the time, parameters of the device apply, and
/// a device that drives three axes reports that.
#[test]
fn the_emulated_hand_does_its_task() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let run = |device: &str, seconds: &str| {
        let session = ["run", "ellipsoid@500", "golf-ball@1000", "--lockstep", "--json", "--record", "r.csv"];
        json(&[&session[..], &["--seconds", seconds, "--device", device]].concat(), folder)
    };
    // Fraction of the recorded steps with a contact force.
    let touching = || {
        let mut rows = csv::Reader::from_path(folder.join("r.csv")).expect("a recording");
        let column =
            rows.headers().expect("a header").iter().position(|name| name == "contact_fz").expect("a column");
        let forces: Vec<f64> =
            rows.records().map(|row| row.expect("a row")[column].parse().expect("a number")).collect();
        assert!(forces.iter().any(|force| *force > 0.1), "nothing is pressed");
        forces.iter().filter(|force| **force > 0.0).count() as f64 / forces.len() as f64
    };
    for (task, seconds, part) in [
        ("explore", "10", 0.6..0.9),
        ("press", "4", 0.4..0.9),
        ("stroke", "4", 0.3..0.7),
        ("scrub", "10", 0.7..1.0),
        ("tap", "4", 0.2..0.7),
        ("peg-insertion", "8", 0.6..0.9),
    ] {
        let summary = run(&format!("emulated:omega,hand=firm,task={task}"), seconds);
        let touching = touching();
        assert!(part.contains(&touching), "{task}: in contact {touching} of the time");
        assert_eq!(summary["stages"]["device"], "omega.6 (emulated): on: force along x, y, z, no torque");
    }
    let gentle = run("emulated:omega,hand=firm,task=press,peak_force=0.1", "1");
    let most = gentle["coupling_force_max"].as_f64().expect("a force");
    assert!(most > 0.05 && most <= 0.1 + 1e-12, "{most} N");
    std::fs::write(folder.join("path.csv"), "t,px,py,pz,qx,qy,qz,qw\n0,0,0,1,0,0,0,1\n").expect("a path");
    let away = run(&format!("emulated:hand=firm,path={}", folder.join("path.csv").display()), "1");
    assert_eq!(away["coupling_force_max"].as_f64(), Some(0.0));
}

#[cfg(target_os = "linux")]
mod streams {
    use std::ffi::OsStr;
    use std::fs::File;
    use std::os::unix::ffi::OsStrExt;
    use std::process::Stdio;

    use super::*;

    #[test]
    fn a_closed_pipe_is_not_an_error() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let (reader, writer) = std::io::pipe().expect("pipe");
        drop(reader);
        let output = Command::new(env!("CARGO_BIN_EXE_palpate"))
            .arg("models")
            .current_dir(folder.path())
            .stdout(writer)
            .output()
            .expect("the binary starts");
        assert_eq!((output.status.code(), output.stderr.len()), (Some(0), 0), "{output:?}");
    }

    #[test]
    fn a_full_disk_is_reported() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let full = || File::options().write(true).open("/dev/full").expect("/dev/full");
        let run = ["run", "ellipsoid@500", "ellipsoid@500", "--seconds", "60", "--record", "/dev/full"];
        for (arguments, said) in [(&["models"][..], "standard output"), (&run, "/dev/full")] {
            let output = Command::new(env!("CARGO_BIN_EXE_palpate"))
                .args(arguments)
                .env("XDG_CACHE_HOME", folder.path())
                .stdout(full())
                .output()
                .expect("the binary starts");
            let stderr = String::from_utf8_lossy(&output.stderr);
            assert_eq!((output.status.code(), stderr.lines().count()), (Some(1), 1), "{stderr}");
            assert!(stderr.contains(said), "{stderr}");
        }
    }

    #[test]
    fn a_failure_without_standard_error_still_has_an_exit_code() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let (reader, writer) = std::io::pipe().expect("pipe");
        drop(reader);
        let status = Command::new(env!("CARGO_BIN_EXE_palpate"))
            .args(["check", "missing.obj"])
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .stderr(writer)
            .status()
            .expect("the binary starts");
        assert_eq!(status.code(), Some(1));
    }

    #[test]
    fn file_names_need_not_be_utf_8() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let name = OsStr::from_bytes(b"r\xff.html");
        let output = Command::new(env!("CARGO_BIN_EXE_palpate"))
            .args(["run", "ellipsoid@500", "ellipsoid@500", "--lockstep", "--seconds", "0.01", "--report"])
            .arg(name)
            .current_dir(folder.path())
            .env("XDG_CACHE_HOME", folder.path())
            .output()
            .expect("the binary starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(folder.path().join(name).exists());
        // The name of a mesh must be UTF-8.
        let mesh = OsStr::from_bytes(b"m\xff.obj");
        let output =
            Command::new(env!("CARGO_BIN_EXE_palpate")).arg("check").arg(mesh).output().expect("start");
        assert_eq!(output.status.code(), Some(2));
    }

    #[test]
    fn an_interrupted_session_ends_in_order() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let folder = folder.path();
        for signal in ["INT", "TERM"] {
            let mut child = Command::new(env!("CARGO_BIN_EXE_palpate"))
                .args([
                    "run",
                    "ellipsoid@500",
                    "ellipsoid@500",
                    "--seconds",
                    "3600",
                    "--json",
                    "--record",
                    "r.csv",
                ])
                .current_dir(folder)
                .env("XDG_CACHE_HOME", folder)
                .stdout(Stdio::piped())
                .spawn()
                .expect("the binary starts");
            // When the file has rows, the recorder's buffer was written once, so the session is running.
            while std::fs::metadata(folder.join("r.csv")).map_or(0, |file| file.len()) < 1000 {
                assert!(child.try_wait().expect("waiting").is_none(), "the session ended by itself");
                std::thread::sleep(std::time::Duration::from_millis(5));
            }
            let kill = Command::new("kill").args([format!("-{signal}"), child.id().to_string()]).status();
            assert!(kill.expect("kill").success());
            let output = child.wait_with_output().expect("the session ends");
            assert!(output.status.success(), "{signal}: {:?}", output.status);
            let summary: Value = serde_json::from_slice(&output.stdout).expect("JSON");
            let rows = std::fs::read_to_string(folder.join("r.csv")).expect("recording");
            let steps = summary["haptic"]["steps"].as_u64().expect("steps");
            let dropped = summary["events"]["record_dropped"].as_u64().expect("a count");
            assert_eq!(rows.lines().count() as u64, 1 + steps - dropped, "{signal}");
            assert!(rows.ends_with('\n') && rows.lines().all(|row| row.split(',').count() == 30), "{signal}");
            std::fs::remove_file(folder.join("r.csv")).expect("recording");
        }
    }
}

/// Without the check of sizes, a hand that moved by metres felt 6.4 N.
#[test]
fn a_probe_in_wrong_units_is_refused_and_harmless_if_accepted() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    for scale in
        [["--scale", "1000"], ["--probe-scale", "1000"], ["--probe-scale", "100"], ["--probe-scale", "0.001"]]
    {
        let session =
            [&["run", "spoon-low", "ellipsoid@500", "--lockstep", "--seconds", "5"][..], &scale].concat();
        let refused = palpate(&[&session[..], &["--record", "r.csv"]].concat(), folder);
        let message = String::from_utf8_lossy(&refused.stderr);
        assert!(refused.status.code() == Some(1) && message.contains("suggests a wrong unit"), "{message}");
        assert!(!folder.join("r.csv").exists(), "something was started");
        succeeds(&[&session[..], &["--unusual-size", "--record", "r.csv"]].concat(), folder);
        let rows = std::fs::read_to_string(folder.join("r.csv")).expect("a recording");
        let free = rows.lines().skip(1).filter_map(|row| {
            let columns: Vec<f64> = row.split(',').map(|column| column.parse().expect("a number")).collect();
            let force = columns[15..18].iter().map(|part| part * part).sum::<f64>().sqrt();
            (columns[28] == 0.0).then_some(force)
        });
        let most = free.fold(0.0, f64::max);
        assert!(most < 0.2, "{scale:?}: {most} N without contact");
        std::fs::remove_file(folder.join("r.csv")).expect("a recording");
    }
}

/// The recommended command runs, its settings fit into the time, and they leave out detail only if time is
/// short.
#[test]
fn settings_are_recommended_that_run_takes() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let pair = ["ellipsoid@500", "golf-ball@5000"];
    let recommend = |budget: &str| {
        let options = ["--budget-us", budget, "--seconds", "1.5", "--rate", "200", "--json"];
        json(&[["recommend"].as_slice(), &pair, &options].concat(), folder)
    };
    let easy = recommend("100000");
    assert_eq!(easy["chosen"]["fits"], true);
    assert_eq!(easy["chosen"]["felt"]["force"]["mean"], 0.0, "{}", easy["chosen"]);
    assert_eq!(
        easy["command"],
        "palpate run ellipsoid@500 golf-ball@5000 --response penalty --error 0 --rate 200"
    );
    let hard = recommend("1");
    assert_eq!(hard["chosen"]["fits"], false, "{}", hard["chosen"]);
    let tried = hard["tried"].as_array().expect("a list");
    assert!(tried.len() > 5 && tried.iter().any(|one| one["felt"]["force"]["mean"].as_f64() > Some(0.0)));

    let command = hard["command"].as_str().expect("words").to_owned();
    let mut words: Vec<&str> = command.split(' ').skip(1).collect();
    words.extend(["--lockstep", "--seconds", "0.1"]);
    succeeds(&words, folder);

    let table = succeeds(&["recommend", pair[0], pair[1], "--task", "press", "--seconds", "1"], folder);
    assert!(table.contains("recommended") && table.contains("->"), "{table}");
    for (refused, said) in [
        (["--task", "juggle"], "peg-insertion"),
        (["--budget-us", "0"], "microseconds"),
        (["--seconds", "-1"], "give more than 0"),
    ] {
        let output = palpate(&[["recommend"].as_slice(), &pair, &refused].concat(), folder);
        assert!(!output.status.success(), "{refused:?}");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(stderr.contains(said), "{refused:?}: {stderr}");
    }
}

/// A scene file's objects and settings are rendered; options of the command line override its settings.
#[test]
fn scene_files_are_rendered() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let scene = "[[object]]\nmodel = \"golf-ball@2000\"\n[[object]]\nmodel = \"ellipsoid@500\"\n\
                 position = [0.0, 0.0, -0.5]\n[settings]\ncontact.friction = 0.5\nsearch.clusters = 3\n";
    std::fs::write(folder.join("scene.toml"), scene).expect("written");
    let run = |more: &[&str]| {
        let run = ["run", "ellipsoid@500", "scene.toml", "--lockstep", "--seconds", "0.2", "--json"];
        json(&[run.as_slice(), more].concat(), folder)
    };
    let stages = &run(&[])["stages"];
    assert_eq!(stages["contact query"], "on: 2 scene objects");
    assert_eq!(stages["friction"], "on: coefficient 0.5");
    // Constraints have no use for clusters, and the user is told so.
    assert_eq!(stages["clustering"], "off: contacts are constraints");
    assert_eq!(run(&["--response", "penalty"])["stages"]["clustering"], "on beyond 3 contacts");
    let unused = |more: &[&str]| run(more)["unused_settings"].clone();
    let clusters = "[{\"name\":\"search.clusters\",\"why\":\"contacts are constraints\"}]";
    assert_eq!(unused(&[]).to_string(), clusters);
    assert_eq!(unused(&["--response", "penalty"]).to_string(), "[]", "negative control");
    let integrated = unused(&["--contact-stiffness", "500", "--integrator", "symplectic-euler"]);
    assert_eq!(integrated[0]["name"], "contact.response", "constraints are not integrated so: {integrated}");
    assert!(
        integrated.as_array().is_some_and(|unused| unused.len() == 1),
        "penalties use the rest: {integrated}"
    );
    assert_eq!(run(&["--friction", "0.1"])["stages"]["friction"], "on: coefficient 0.1");
    std::fs::write(folder.join("scene.toml"), "[[object]]\nmodel = 3\n").expect("written");
    let output = palpate(&["run", "ellipsoid@500", "scene.toml"], folder);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && stderr.contains("scene.toml: line 2"), "{stderr}");
}

#[test]
fn a_hinged_tool_is_rendered_with_a_gripper() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let tool = "limits = [0.0, 0.8]\n[first]\nmodel = \"forceps-jaw@800\"\nmass = 0.05\n\
                [second]\nmodel = \"forceps-jaw@800\"\nmass = 0.05\nhinge.rotation = [1, 0, 0, 0]\n";
    std::fs::write(folder.join("forceps.toml"), tool).expect("written");
    std::fs::write(folder.join("fingers.csv"), "t,angle\n0,0.5\n0.5,0.0\n1,0.0\n").expect("written");
    // A ball of 5 mm lies between the tips of the jaws, on both sides of which they open.
    let hand =
        "t,px,py,pz,qx,qy,qz,qw\n0,0,0,0,0,0,-0.124674733,0.992197667\n0.5,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n";
    std::fs::write(folder.join("hand.csv"), hand).expect("written");
    let scene = "[[object]]\nmodel = \"ellipsoid@500\"\nscale = 0.2\nposition = [0.045, 0.0, 0.0]\n\
                 [settings]\ntool.grasp = { translation = [0, 0, 0], rotation = [0, 0, 0, 1] }\n";
    std::fs::write(folder.join("scene.toml"), scene).expect("written");
    let held = ["run", "--tool", "forceps.toml", "scene.toml", "--lockstep", "--seconds", "1", "--json"];
    let device = ["--device", "emulated:gripper=fingers.csv,path=hand.csv", "--record", "run.csv"];
    let summary = json(&[held.as_slice(), &device].concat(), folder);
    assert_eq!(summary["haptic"]["steps"], 1000);

    let first_touch = summary["first_touch_s"].as_f64();
    let recording = std::fs::read_to_string(folder.join("run.csv")).expect("a recording");
    let mut rows = recording.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = rows.next().expect("a header");
    let rows: Vec<_> = rows.collect();
    let value = |row: &[&str], name: &str| -> f64 {
        row[header.iter().position(|column| *column == name).expect(name)].parse().expect("a number")
    };
    assert_eq!(rows.len(), 1000);
    // Either body may be the first to touch.
    let force = |row: &[&str], body: &str| {
        let parts = ["fx", "fy", "fz"].map(|axis| value(row, &format!("{body}_{axis}")));
        parts.iter().map(|part| part * part).sum::<f64>().sqrt()
    };
    let pushed = rows.iter().find(|row| force(row, "first").max(force(row, "second")) > 1e-6);
    assert!(pushed.is_some() && first_touch == pushed.map(|row| value(row, "t")), "{first_touch:?}");
    let opened = value(&rows[0], "angle");
    assert!((opened - 0.5).abs() < 5e-3, "opened as far as the fingers: {opened}");
    let last = rows.last().expect("rows");
    assert!(value(last, "angle") > value(last, "gripper") + 0.02, "the ball holds the jaws apart: {last:?}");
    assert!(value(last, "torque").abs() > 1e-3, "the fingers feel it: {last:?}");

    for (arguments, said) in [
        (held.to_vec(), "no gripper"),
        (["run", "--tool", "missing.toml", "scene.toml"].to_vec(), "missing.toml"),
        (
            ["run", "--tool", "scene.toml", "scene.toml"].to_vec(),
            "scene.toml: line 1: unknown field `object`",
        ),
        ([held.as_slice(), &["--report", "run.html"]].concat(), "--report"),
        ([held.as_slice(), &["--mass", "0.1"]].concat(), "--mass"),
        ([held.as_slice(), &["--probe-scale", "2"]].concat(), "--probe-scale"),
        ([held.as_slice(), &["--probe-detail", "ellipsoid"]].concat(), "--probe-detail"),
        (["run", "ellipsoid@500"].to_vec(), "<SCENE>"),
    ] {
        let output = palpate(&arguments, folder);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && stderr.contains(said), "{arguments:?}: {stderr}");
    }
}
