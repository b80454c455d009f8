//! The form of comments.

use std::fs;
use std::path::{Path, PathBuf};

/// Width of comments, columns: that of code.
const WIDTH: usize = 110;

/// Comments fit the width, tables and code in them aside.
#[test]
fn comments_are_wrapped() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folders = ["benches", "crates", "examples", "fuzz", "shaders", "tests", "xtask"];
    let mut open: Vec<PathBuf> = folders.iter().map(|folder| root.join(folder)).collect();
    let (mut wide, mut read) = (Vec::new(), 0);
    while let Some(path) = open.pop() {
        if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
            open.extend(fs::read_dir(&path).expect("a folder").map(|entry| entry.expect("an entry").path()));
        }
        if !path.extension().is_some_and(|extension| ["rs", "wgsl"].iter().any(|kind| extension == *kind)) {
            continue;
        }
        read += 1;
        let mut in_code = false;
        for (index, line) in fs::read_to_string(&path).expect("code").lines().enumerate() {
            let Some(comment) = line.trim_start().strip_prefix("//") else { continue };
            let comment = comment.trim_start_matches(['/', '!', ' ']);
            in_code ^= comment.starts_with("```");
            if !in_code && !comment.starts_with('|') && line.chars().count() > WIDTH {
                wide.push(format!("{}:{}", path.display(), index + 1));
            }
        }
    }
    assert!(read > 500, "{read} files");
    assert!(wide.is_empty(), "comments wider than {WIDTH} columns: {wide:#?}");
}
