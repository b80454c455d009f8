//! Check of the libraries of device makers. Their files are searched where the system's loader searches; none
//! is loaded, since a library may run any code when it is loaded.

use std::path::{Path, PathBuf};

use palpate::device::sdk::SdkLibrary;

use super::finding::{Finding, Verdict};

pub fn finding() -> Finding {
    let folders = folders();
    let found = SdkLibrary::ALL.map(|library| (library, find(&library, &folders)));
    verdict_on(&found)
}

fn verdict_on(found: &[(SdkLibrary, Option<PathBuf>)]) -> Finding {
    const NAME: &str = "libraries of device makers";
    let seen: Vec<String> = found
        .iter()
        .map(|(library, file)| {
            let driver = if library.compiled_in { "driver compiled in" } else { "driver not compiled in" };
            let file = file.as_ref().map_or("not found".to_owned(), |file| file.display().to_string());
            format!("{}: {file}, {driver}", library.maker)
        })
        .collect();
    let features: Vec<&str> = found
        .iter()
        .filter(|(library, file)| file.is_some() && !library.compiled_in)
        .map(|(library, _)| library.feature)
        .collect();
    let missing: Vec<&str> = found
        .iter()
        .filter(|(library, file)| file.is_none() && library.compiled_in)
        .map(|(library, _)| library.remedy)
        .collect();
    let usable = found.iter().any(|(library, file)| file.is_some() && library.compiled_in);
    let seen = seen.join("; ");
    if !features.is_empty() {
        let build = format!(
            "build with the driver: `cargo build --release -p palpate-cli --features {}`",
            features.join(",")
        );
        Finding::new(NAME, Verdict::CouldBeBetter, seen).with_remedy(build)
    } else if usable {
        Finding::new(NAME, Verdict::Good, seen)
    } else if missing.is_empty() {
        Finding::new(NAME, Verdict::Unknown, seen)
            .with_remedy("needed only for devices of these makers: install the maker's SDK")
    } else {
        Finding::new(NAME, Verdict::CouldBeBetter, seen).with_remedy(missing.join("; "))
    }
}

/// File that the environment names, or else the first of the maker's file names that exists in one of the
/// folders.
fn find(library: &SdkLibrary, folders: &[PathBuf]) -> Option<PathBuf> {
    let named = library.named_file().filter(|file| file.is_file());
    named.or_else(|| {
        let files = library.names.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
        files.into_iter().find(|file| file.is_file())
    })
}

/// Folders in which the system's loader searches for libraries.
fn folders() -> Vec<PathBuf> {
    let variable = if cfg!(windows) {
        "PATH"
    } else if cfg!(target_os = "macos") {
        "DYLD_LIBRARY_PATH"
    } else {
        "LD_LIBRARY_PATH"
    };
    let named = std::env::var_os(variable);
    let mut folders: Vec<PathBuf> = named
        .iter()
        .flat_map(std::env::split_paths)
        .filter(|folder| !folder.as_os_str().is_empty())
        .collect();
    if cfg!(unix) {
        let usual = ["/usr/local/lib", "/usr/lib", "/lib", "/usr/lib64", "/lib64"].map(PathBuf::from);
        folders.extend(configured(Path::new("/etc")).into_iter().chain(usual));
    }
    folders
}

/// Folders that `ld.so.conf` and the files in `ld.so.conf.d` list, in `etc`.
fn configured(etc: &Path) -> Vec<PathBuf> {
    let files = std::fs::read_dir(etc.join("ld.so.conf.d")).into_iter().flatten().flatten();
    let files = std::iter::once(etc.join("ld.so.conf")).chain(files.map(|entry| entry.path()));
    let texts = files.filter_map(|file| std::fs::read_to_string(file).ok());
    texts
        .flat_map(|text| {
            let folders = text.lines().map(str::trim).filter(|line| line.starts_with('/'));
            folders.map(PathBuf::from).collect::<Vec<_>>()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_found_in_configured_folders() {
        let folder = tempfile::tempdir().unwrap();
        let (etc, lib) = (folder.path().join("etc"), folder.path().join("lib"));
        std::fs::create_dir_all(etc.join("ld.so.conf.d")).unwrap();
        std::fs::create_dir(&lib).unwrap();
        std::fs::write(etc.join("ld.so.conf"), "include /etc/ld.so.conf.d/*.conf\n").unwrap();
        std::fs::write(etc.join("ld.so.conf.d/maker.conf"), format!("# here\n{}\n", lib.display())).unwrap();
        let folders = configured(&etc);
        if cfg!(unix) {
            assert_eq!(folders, std::slice::from_ref(&lib));
        }
        let library = SdkLibrary { variable: "PALPATE_NO_SUCH_VARIABLE", ..SdkLibrary::FORCE_DIMENSION };
        assert_eq!(find(&library, std::slice::from_ref(&lib)), None);
        let file = lib.join(library.names[1]);
        std::fs::write(&file, "").unwrap();
        assert_eq!(find(&library, &[lib]), Some(file));
    }

    #[test]
    fn remedies_follow_what_is_missing() {
        let library = |compiled_in| SdkLibrary { compiled_in, ..SdkLibrary::OPEN_HAPTICS };
        let found = |compiled_in, there: bool| {
            verdict_on(&[(library(compiled_in), there.then(|| PathBuf::from("/lib/libHD.so")))])
        };
        assert_eq!(found(true, true).verdict, Verdict::Good);
        assert_eq!(found(false, false).verdict, Verdict::Unknown);
        assert!(found(false, true).remedy.unwrap().ends_with("--features open-haptics`"));
        assert!(found(true, false).remedy.unwrap().contains("install OpenHaptics"));
    }
}
