//! Properties of real meshes agree with figures computed by other programs.

use palpate_tests::{shared, shared_mesh};
use serde_json::Value;

#[test]
fn validation_agrees_with_the_figures() {
    let Some(file) = shared("models/figures.json") else { return };
    let text = std::fs::read_to_string(file).expect("figures.json");
    let figures: serde_json::Map<String, Value> = serde_json::from_str(&text).expect("figures.json");
    assert!(figures.len() > 20, "{} models", figures.len());
    for (name, figure) in &figures {
        let Some(mesh) = shared_mesh(&format!("models/{name}")) else { continue };
        let report = mesh.validate();
        let number = |key: &str| figure[key].as_f64().unwrap_or_else(|| panic!("{name}: {key}"));
        for (key, value) in [
            ("V", report.vertices),
            ("F", report.triangles),
            ("bndE", report.boundary_edges),
            ("nmE", report.nonmanifold_edges),
            ("badOrientE", report.misoriented_edges),
            ("nmV", report.nonmanifold_vertices),
            ("dupF", report.duplicate),
            ("comps", report.components),
            ("nonfinite", report.nonfinite),
        ] {
            assert_eq!(value as f64, number(key), "{name}: {key}");
        }
        let degenerate = number("idxdeg") + number("zeroarea");
        assert_eq!(report.degenerate as f64, degenerate, "{name}: degenerate triangles");
        for (key, value) in
            [("closed", report.closed), ("manifold", report.manifold), ("oriented", report.oriented)]
        {
            assert_eq!(Some(value), figure[key].as_bool(), "{name}: {key}");
        }
        let radius = number("R");
        assert!((report.bounding_radius / radius - 1.0).abs() < 1e-6, "{name}: {}", report.bounding_radius);
        if figure["closed"].as_bool() == Some(true) {
            let volume = number("vol");
            assert!((report.volume / volume - 1.0).abs() < 1e-6, "{name}: volume {}", report.volume);
        }
    }
}
