//! Properties of the built-in models: sizes of the dissertation's tables, closed, 2-manifold, oriented, free
//! of self-intersections, reproducible.

use palpate::mesh_io::self_intersections;
use palpate::models::Model;

/// Triangle count above which models take minutes to examine in a development build.
const MAX_QUICK_TRIANGLES: usize = 41_000;

#[test]
fn models_are_sound_and_as_large_as_in_the_dissertation() {
    sound_and_as_large_as_in_the_dissertation(|triangles| triangles <= MAX_QUICK_TRIANGLES);
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-tests --test it built_in_models:: -- --ignored"]
fn large_models_of_full_size_are_sound() {
    sound_and_as_large_as_in_the_dissertation(|triangles| triangles > MAX_QUICK_TRIANGLES);
}

fn sound_and_as_large_as_in_the_dissertation(size: impl Fn(usize) -> bool) {
    for model in Model::ALL.into_iter().filter(|model| size(model.default_triangles())) {
        let name = model.name();
        let asked = model.default_triangles();
        let mesh = model.generate(asked).expect(name);
        let triangles = mesh.triangles().len();
        assert!(
            (triangles as f64 / asked as f64 - 1.0).abs() <= 0.02,
            "{name}: {triangles} triangles for {asked}"
        );
        let report = mesh.validate();
        assert!(report.closed && report.manifold && report.oriented, "{name}: {report:?}");
        assert_eq!((report.degenerate, report.duplicate, report.components), (0, 0, 1), "{name}: {report:?}");
        assert!(report.volume > 0.0, "{name}: {report:?}");
        let crossings = self_intersections(&mesh);
        assert_eq!(crossings.count, 0, "{name}: {:?}", crossings.first);
        assert_eq!(model.generate(asked).as_ref(), Ok(&mesh), "{name} differs when generated again");
    }
}

#[test]
fn models_follow_the_count_asked_for() {
    follow_the_count(8_000);
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-tests --test it built_in_models:: -- --ignored"]
fn models_follow_the_count_asked_for_in_further_cases() {
    follow_the_count(21_000);
}

fn follow_the_count(asked: usize) {
    for model in Model::ALL {
        let mesh = model.generate(asked).unwrap_or_else(|error| panic!("{error}"));
        let triangles = mesh.triangles().len();
        assert!(
            (triangles as f64 / asked as f64 - 1.0).abs() <= 0.02,
            "{}: {triangles} triangles for {asked}",
            model.name()
        );
        let report = mesh.validate();
        assert!(report.is_solid(), "{}@{asked}: {report:?}", model.name());
        assert_eq!(self_intersections(&mesh).count, 0, "{}@{asked}", model.name());
        if model.default_triangles() > MAX_QUICK_TRIANGLES {
            let again = model.generate(asked);
            assert_eq!(again.as_ref(), Ok(&mesh), "{}@{asked} differs when generated again", model.name());
        }
    }
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-tests --test it built_in_models:: -- --ignored"]
fn fine_models_do_not_cross_themselves() {
    for model in Model::ALL {
        let mesh = model.generate(320_000).unwrap_or_else(|error| panic!("{error}"));
        assert!(mesh.validate().is_solid() && self_intersections(&mesh).count == 0, "{}", model.name());
    }
}
