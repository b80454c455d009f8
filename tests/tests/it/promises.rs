//! Docs page on the engine's promises to the hand: the invariants and tests that it names exist.

use std::fs;
use std::path::Path;

use palpate::promises::Invariant;

#[test]
fn the_page_names_every_promise_and_only_existing_tests() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace");
    let page = fs::read_to_string(root.join("docs/promises.md")).expect("the page");
    for invariant in Invariant::ALL {
        assert!(page.contains(&format!("| `{}` |", invariant.name())), "{}", invariant.name());
    }
    let named: Vec<(&str, &str)> =
        page.split('`').skip(1).step_by(2).filter_map(|code| code.rsplit_once("::")).collect();
    let tests =
        named.iter().filter(|(path, test)| path.starts_with(char::is_lowercase) && test.contains('_'));
    let mut count = 0;
    for (path, test) in tests {
        count += 1;
        let module = path.split("::").next().expect("a module");
        let found = [
            "tests/tests/it",
            "crates/palpate/src/haptic",
            "crates/palpate/src/scene",
            "crates/palpate/src/run",
            "crates/device/tests/it",
            "crates/cli/tests/it",
        ]
        .iter()
        .filter_map(|folder| fs::read_to_string(root.join(folder).join(format!("{module}.rs"))).ok())
        .any(|source| source.contains(&format!("fn {test}(")));
        assert!(found, "{path}::{test} does not exist");
    }
    assert!(count > 15, "{count} tests are named");
}
