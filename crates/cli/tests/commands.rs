//! What each command gives, as a user or a program sees it.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn palpate(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_palpate"))
        .args(arguments)
        .current_dir(folder)
        .env("XDG_CACHE_HOME", folder.join("cache"))
        .output()
        .expect("the binary starts")
}

/// Runs a command that must succeed; its standard output.
fn succeeds(arguments: &[&str], folder: &Path) -> String {
    let output = palpate(arguments, folder);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "palpate {arguments:?}: {stderr}");
    assert!(stderr.is_empty(), "no progress where standard error is no terminal: {stderr}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

fn json(arguments: &[&str], folder: &Path) -> Value {
    serde_json::from_str(&succeeds(arguments, folder)).expect("JSON")
}

/// The keys of an object, in order of their names.
fn keys(value: &Value) -> Vec<&str> {
    value.as_object().expect("an object").keys().map(String::as_str).collect()
}

#[test]
fn models_are_listed_exported_and_checked() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    let models = json(&["models", "--json"], folder);
    assert_eq!(models.as_array().map(Vec::len), Some(17));
    assert_eq!(succeeds(&["models"], folder).lines().count(), 17);

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
        ["bounding_radius", "levels", "patches", "peak_rss_bytes", "seconds", "triangles", "vertices"]
    );
    let levels = inspected["levels"].as_array().expect("levels");
    assert_eq!(levels[0]["level"], 0);
    assert_eq!(levels[0]["patches"], inspected["patches"]);
    assert_eq!(levels[levels.len() - 1]["patches"], 1);
    assert!(levels[0]["resolution"].as_f64().is_some_and(|r| r > 0.0));
    assert_eq!(levels[0]["free"], false);
}

#[test]
fn a_trajectory_is_queried() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    // The ellipsoid comes down on the golf ball from far away until it is inside.
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
            "poses"
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
    let rows = std::fs::read_to_string(folder.join("c.csv")).unwrap();
    let contacts: u64 = poses.iter().map(|pose| pose["contacts"].as_u64().unwrap()).sum();
    assert_eq!(rows.lines().count() as u64, contacts + 1);
    assert!(rows.starts_with("t,px,py,pz,nx,ny,nz,depth,level_probe,level_scene\n"), "{rows:.80}");
}

#[test]
fn a_lockstep_session_is_recorded_and_reported_twice_alike() {
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
            "coupling_force_max",
            "depth_max",
            "energy_min_j",
            "events",
            "haptic",
            "seconds",
            "stages"
        ]
    );
    assert_eq!(summary["haptic"]["steps"], 3000);
    assert_eq!(summary["contact"]["rate_hz"], 250.0);
    let (a, b) = (std::fs::read(folder.join("a.csv")).unwrap(), std::fs::read(folder.join("b.csv")).unwrap());
    assert!(a == b, "two lockstep recordings differ");
    assert_eq!(a.iter().filter(|&&byte| byte == b'\n').count(), 3001);
    let html = std::fs::read_to_string(folder.join("r.html")).unwrap();
    assert!(html.contains("<svg") && html.contains("</html>"));
    assert!(!html.contains("src=") && !html.contains("href="), "the report stands alone");
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
}

#[test]
fn refusals_say_what_and_what_to_do() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    std::fs::write(folder.join("t.csv"), "t,px,py,pz,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n0,0,zero,0,0,0,0,1\n")
        .unwrap();
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
        (&["run", "cup-low", "spoon-low", "--mass", "-1"], "mass"),
        (&["run", "cup-low", "spoon-low", "--seconds", "-1"], "seconds"),
        (&["query", "cup-low", "spoon-low", "--trajectory", "t.csv", "--tolerance", "1%"], "t.csv:3"),
    ] {
        let output = palpate(arguments, folder);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "palpate {arguments:?}: {stderr}");
        assert_eq!(stderr.lines().count(), 1, "{stderr}");
        assert!(stderr.contains(said), "palpate {arguments:?} should mention '{said}': {stderr}");
    }
    for usage in
        [&["frobnicate"][..], &["check"], &["query", "cup", "spoon"], &["run", "cup", "spoon", "--rate", "x"]]
    {
        assert_eq!(palpate(usage, folder).status.code(), Some(2), "palpate {usage:?}");
    }
}
