//! Check of the folder in which built hierarchies are stored.

use std::fs::File;
use std::path::Path;

use super::finding::{Finding, Verdict};

const NAME: &str = "cache of hierarchies";

pub fn finding() -> Finding {
    match palpate::cache_folder() {
        Some(folder) => check(&folder),
        None => {
            let seen =
                "the system names no cache folder for this user: hierarchies are built each time".to_owned();
            Finding::new(NAME, Verdict::CouldBeBetter, seen)
                .with_remedy("set XDG_CACHE_HOME or HOME to a folder of yours")
        }
    }
}

fn check(folder: &Path) -> Finding {
    let files: Vec<u64> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| entry.metadata().ok())
        .filter(std::fs::Metadata::is_file)
        .map(|data| data.len())
        .collect();
    let (count, bytes) = (files.len(), files.iter().sum::<u64>());
    let shown = folder.display();
    let held = match count {
        0 => format!("{shown}: empty"),
        1 => format!("{shown}: 1 file, {:.1} MB", bytes as f64 / 1e6),
        _ => format!("{shown}: {count} files, {:.1} MB", bytes as f64 / 1e6),
    };
    match try_to_write(folder) {
        Ok(()) => Finding::new(NAME, Verdict::Good, format!("{held}, writable")),
        Err(error) => {
            let seen = format!("{held}, not writable ({error}): hierarchies are built each time");
            let remedy =
                format!("give your user write access to {shown}, or set XDG_CACHE_HOME to a folder of yours");
            Finding::new(NAME, Verdict::CouldBeBetter, seen).with_remedy(remedy)
        }
    }
}

/// Creates and removes a file in the folder, or in the nearest folder above it that exists.
fn try_to_write(folder: &Path) -> std::io::Result<()> {
    let there = folder.ancestors().find(|folder| folder.exists()).unwrap_or(folder);
    let file = there.join(format!(".palpate-doctor-{}", std::process::id()));
    File::create_new(&file)?;
    std::fs::remove_file(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_measured_and_left_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        let cache = folder.path().join("palpate");
        let missing = check(&cache);
        assert_eq!(missing.verdict, Verdict::Good);
        assert!(missing.measured.ends_with("empty, writable") && !cache.exists(), "{missing:?}");
        std::fs::create_dir(&cache).unwrap();
        std::fs::write(cache.join("a.clod"), vec![0; 2_500_000]).unwrap();
        let filled = check(&cache);
        assert!(filled.measured.ends_with("1 file, 2.5 MB, writable"), "{filled:?}");
        assert_eq!(std::fs::read_dir(&cache).unwrap().count(), 1);
        // A file is in place of the folder.
        let blocked = check(&cache.join("a.clod/palpate"));
        assert_eq!(blocked.verdict, Verdict::CouldBeBetter);
        assert!(blocked.remedy.is_some_and(|remedy| remedy.contains("XDG_CACHE_HOME")));
    }
}
