//! Layers of the engine's crates: modules use only layers below them, and no two files use each other in a
//! circle.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use syn::visit::Visit;

/// Crates in which no two files may use each other in a circle.
const WITHOUT_CIRCLES: [&str; 9] =
    ["clod-build", "collide", "core", "device", "dynamics", "field", "mesh-io", "palpate", "texture-pd"];

/// Crates whose `lib.rs` lists its layers under `# Layers`.
const WITH_FLOORS: [&str; 2] = ["collide", "palpate"];

/// Path of a module from the crate's root.
type Module = Vec<String>;

fn sources(krate: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates").join(krate).join("src")
}

/// Returns the files of a crate by their modules.
fn modules(krate: &str) -> BTreeMap<Module, PathBuf> {
    let mut folders = vec![(sources(krate), Vec::new())];
    let mut found = BTreeMap::new();
    while let Some((folder, module)) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            let name = path.file_stem().expect("a name").to_string_lossy().into_owned();
            if path.is_dir() {
                folders.push((path, [module.clone(), vec![name]].concat()));
            } else if path.extension().is_some_and(|extension| extension == "rs") && name != "tests" {
                let here = if ["mod", "lib"].contains(&name.as_str()) { Vec::new() } else { vec![name] };
                found.insert([module.clone(), here].concat(), path);
            }
        }
    }
    found
}

/// Paths that a file names, from the crate's root, outside its tests.
struct Paths<'a> {
    module: &'a [String],
    modules: &'a BTreeMap<Module, PathBuf>,
    found: BTreeSet<Module>,
}

impl Paths<'_> {
    fn add(&mut self, path: &[String]) {
        let Some((first, rest)) = path.split_first() else { return };
        let base = match first.as_str() {
            "crate" => &[],
            "self" => self.module,
            "super" => &self.module[..self.module.len().saturating_sub(1)],
            child if self.modules.contains_key(&[self.module, &[child.to_owned()]].concat()) => {
                self.found.insert([self.module, path].concat());
                return;
            }
            _ => return,
        };
        self.found.insert([base, rest].concat());
    }

    fn add_tree(&mut self, before: &[String], tree: &syn::UseTree) {
        match tree {
            syn::UseTree::Path(path) => {
                self.add_tree(&[before, &[path.ident.to_string()]].concat(), &path.tree);
            }
            syn::UseTree::Name(name) => self.add(&[before, &[name.ident.to_string()]].concat()),
            syn::UseTree::Rename(name) => self.add(&[before, &[name.ident.to_string()]].concat()),
            syn::UseTree::Glob(_) => self.add(before),
            syn::UseTree::Group(group) => group.items.iter().for_each(|item| self.add_tree(before, item)),
        }
    }
}

impl<'ast> Visit<'ast> for Paths<'_> {
    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        // A module that re-exports its children does not use them.
        if matches!(item.vis, syn::Visibility::Inherited) {
            self.add_tree(&[], &item.tree);
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names: Vec<String> = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
        self.add(&names);
        syn::visit::visit_path(self, path);
    }

    /// `pub(super)` is not a use.
    fn visit_visibility(&mut self, _: &'ast syn::Visibility) {}

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        let of_tests = item.attrs.iter().any(|attribute| attribute.path().is_ident("cfg"));
        if !of_tests {
            syn::visit::visit_item_mod(self, item);
        }
    }
}

/// Returns the other modules that each module of a crate uses.
fn uses(krate: &str) -> BTreeMap<Module, BTreeSet<Module>> {
    let modules = modules(krate);
    let used_by = |(module, path): (&Module, &PathBuf)| {
        let text = fs::read_to_string(path).expect("a source");
        let file = syn::parse_file(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut paths = Paths { module, modules: &modules, found: BTreeSet::new() };
        paths.visit_file(&file);
        let owner =
            |named: &Module| (1..=named.len()).rev().find_map(|len| modules.get_key_value(&named[..len]));
        let used = paths.found.iter().filter_map(owner).map(|(used, _)| used.clone());
        (module.clone(), used.filter(|used| used != module).collect())
    };
    modules.iter().filter(|(module, _)| !module.is_empty()).map(used_by).collect()
}

/// Returns a circle of modules, if there is one.
fn circle(uses: &BTreeMap<Module, BTreeSet<Module>>) -> Option<Vec<Module>> {
    fn visit<'a>(
        module: &'a Module,
        uses: &'a BTreeMap<Module, BTreeSet<Module>>,
        path: &mut Vec<&'a Module>,
        done: &mut BTreeSet<&'a Module>,
    ) -> Option<Vec<Module>> {
        if let Some(start) = path.iter().position(|&passed| passed == module) {
            return Some(path[start..].iter().map(|&passed| passed.clone()).collect());
        }
        if !done.insert(module) {
            return None;
        }
        path.push(module);
        let found = uses.get(module)?.iter().find_map(|used| visit(used, uses, path, done));
        path.pop();
        found
    }
    let mut done = BTreeSet::new();
    uses.keys().find_map(|module| visit(module, uses, &mut Vec::new(), &mut done))
}

/// Returns the layers of a crate by module, counted from 1, from the numbered list under `# Layers` in its
/// `lib.rs`.
fn floors(krate: &str) -> BTreeMap<String, usize> {
    let text = fs::read_to_string(sources(krate).join("lib.rs")).expect("lib.rs");
    let doc = text.lines().filter_map(|line| line.strip_prefix("//!")).map(str::trim);
    let list = doc.skip_while(|line| *line != "# Layers").skip(1).take_while(|line| !line.starts_with("# "));
    let mut floors = BTreeMap::new();
    for line in list {
        let Some((number, rest)) = line.split_once(". ") else { continue };
        let Ok(floor) = number.parse::<usize>() else { continue };
        let names = rest.split(':').next().expect("names");
        floors.extend(names.split('`').skip(1).step_by(2).map(|name| (name.to_owned(), floor)));
    }
    floors
}

/// Returns uses that run upwards: a module, and one in the same layer or above that it uses.
fn upward(uses: &BTreeMap<Module, BTreeSet<Module>>, floors: &BTreeMap<String, usize>) -> Vec<String> {
    let floor =
        |module: &Module| *floors.get(&module[0]).unwrap_or_else(|| panic!("`{}` is on no floor", module[0]));
    let all = uses.iter().flat_map(|(module, used)| used.iter().map(move |used| (module, used)));
    let other = all.filter(|(module, used)| module[0] != used[0]);
    other
        .filter(|(module, used)| floor(used) >= floor(module))
        .map(|(module, used)| format!("{} uses {}", module.join("::"), used.join("::")))
        .collect()
}

#[test]
fn modules_use_only_floors_below() {
    for krate in WITH_FLOORS {
        let floors = floors(krate);
        assert!(floors.len() > 4, "{krate}: {floors:?}");
        let found = upward(&uses(krate), &floors);
        assert!(found.is_empty(), "{krate}: {found:#?}");
        // The check must fail with the layers upside down.
        let highest = floors.values().max().expect("floors");
        let turned = floors.iter().map(|(name, floor)| (name.clone(), highest + 1 - floor)).collect();
        assert!(!upward(&uses(krate), &turned).is_empty(), "{krate}");
    }
}

#[test]
fn no_files_use_each_other_in_a_circle() {
    for krate in WITHOUT_CIRCLES {
        let mut uses = uses(krate);
        assert_eq!(circle(&uses), None, "{krate}");
        // One more use makes a circle, which must be found.
        let (user, used) = uses
            .iter()
            .find_map(|(module, used)| Some((module.clone(), used.first()?.clone())))
            .expect("a module that uses another");
        uses.entry(used).or_default().insert(user);
        assert!(circle(&uses).is_some(), "{krate}");
    }
}

/// The table "Where is …?" of ARCHITECTURE.md names existing files and code.
#[test]
fn the_table_of_places_in_the_code_is_true() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let page = fs::read_to_string(root.join("ARCHITECTURE.md")).expect("the page");
    let rows: Vec<&str> = page
        .lines()
        .skip_while(|line| !line.starts_with("## Where is"))
        .skip(1)
        .take_while(|line| !line.starts_with("## "))
        .filter(|line| line.starts_with("| ") && line.contains("]("))
        .collect();
    assert!(rows.len() >= 6, "{rows:?}");
    for row in rows {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let files = cells[2].split("](").skip(1).filter_map(|link| link.split(')').next());
        let texts: Vec<String> = files
            .map(|file| fs::read_to_string(root.join(file)).unwrap_or_else(|error| panic!("{file}: {error}")))
            .collect();
        for named in cells[3].split('`').skip(1).step_by(2) {
            assert!(texts.iter().any(|text| text.contains(named)), "{}: no {named}", cells[1]);
        }
    }
}

/// The names in the glossary are those of the code that it links.
#[test]
fn the_glossary_names_what_the_code_does() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let page = fs::read_to_string(docs.join("glossary.md")).expect("the page");
    let mut named = 0;
    for link in page.split("[`").skip(1) {
        let (name, rest) = link.split_once("`](").expect("a link");
        let file = docs.join(rest.split([')', '#']).next().expect("a path"));
        assert!(file.exists(), "{name}: no {}", file.display());
        if name.contains(['.', '/']) || file.is_dir() {
            continue;
        }
        let text = fs::read_to_string(&file).expect("code");
        let last = name.rsplit("::").next().expect("a name");
        assert!(text.contains(last), "no {name} in {}", file.display());
        named += 1;
    }
    assert!(named >= 25, "{named}");
}
