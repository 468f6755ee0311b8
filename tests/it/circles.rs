//! No source file depends on itself through others: imports between the files of a crate form no circle.
//!
//! Imports between a module and the modules inside it are not compared, since a submodule is a part of what its parent defines.
//! All other imports have one direction. Unit tests do not count.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The crates of the workspace.
const CRATES: [&str; 8] = [
    "src",
    "stages/api/src",
    "stages/envs/src",
    "stages/kinds/src",
    "stages/learn/src",
    "stages/parity/src",
    "stages/report/src",
    "xtask/src",
];

/// The path of a module from the root of its crate.
type Module = Vec<String>;

/// The modules of a crate, what each imports, and the names that each brings into its scope.
struct Crate {
    modules: BTreeMap<Module, Source>,
}

#[derive(Default)]
struct Source {
    /// Paths of `use` declarations, with whether they are re-exports.
    uses: Vec<(bool, Vec<String>)>,
    /// Other paths in the code.
    paths: Vec<Vec<String>>,
}

impl Crate {
    fn read(folder: &Path) -> Self {
        let mut modules = BTreeMap::new();
        let mut open = vec![(folder.to_owned(), Module::new())];
        let has_library = folder.join("lib.rs").exists();
        while let Some((folder, above)) = open.pop() {
            for entry in std::fs::read_dir(&folder).unwrap() {
                let path = entry.unwrap().path();
                let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
                let module: Module = above.iter().cloned().chain([stem.clone()]).collect();
                let is_root = above.is_empty() && stem == if has_library { "lib" } else { "main" };
                let is_program = above.is_empty() && (stem == "bin" || has_library && stem == "main");
                if is_program || stem.ends_with("tests") {
                    continue;
                } else if path.is_dir() {
                    open.push((path, module));
                } else if path.extension().is_some_and(|extension| extension == "rs") {
                    let module = if is_root || stem == "mod" { above.clone() } else { module };
                    modules.insert(module, Source::parse(&std::fs::read_to_string(&path).unwrap()));
                }
            }
        }
        Self { modules }
    }

    /// The path from the root of the crate; `None` for one of another crate.
    fn absolute(&self, module: &Module, path: &[String]) -> Option<Vec<String>> {
        let mut base = module.clone();
        match path.first()?.as_str() {
            "crate" => Some(path[1..].to_vec()),
            "self" => Some([base, path[1..].to_vec()].concat()),
            "super" => {
                let levels = path.iter().take_while(|part| *part == "super").count();
                base.truncate(base.len().checked_sub(levels)?);
                Some([base, path[levels..].to_vec()].concat())
            }
            first => {
                let child = [base, vec![first.to_owned()]].concat();
                let is_child = self.modules.contains_key(&child);
                is_child.then(|| [child, path[1..].to_vec()].concat())
            }
        }
    }

    /// The module that defines what a path names, through re-exports.
    fn defining(&self, path: &[String], depth: usize) -> Option<Module> {
        let length = (0..=path.len()).rev().find(|length| self.modules.contains_key(&path[..*length]))?;
        let module: Module = path[..length].to_vec();
        let Some(name) = path.get(length) else { return Some(module) };
        let imported = self.modules[&module].uses.iter().find(|(_, used)| used.last() == Some(name));
        let target = imported.and_then(|(_, used)| self.absolute(&module, used));
        match target.filter(|target| depth > 0 && target != path) {
            Some(target) => self.defining(&[&target[..], &path[length + 1..]].concat(), depth - 1),
            None => Some(module),
        }
    }

    /// The modules that a module depends on, without those that contain it or that it contains.
    fn dependencies(&self, module: &Module) -> BTreeSet<Module> {
        let source = &self.modules[module];
        let used = source.uses.iter().map(|(_, path)| self.absolute(module, path));
        let named = source.paths.iter().map(|path| {
            let imported = source.uses.iter().find(|(_, used)| used.last() == path.first());
            match imported {
                Some((_, used)) => self.absolute(module, &[&used[..], &path[1..]].concat()),
                None => self.absolute(module, path),
            }
        });
        let found = used.chain(named).flatten().filter_map(|path| self.defining(&path, 5));
        let is_apart = |other: &Module| !other.starts_with(module) && !module.starts_with(other);
        found.filter(is_apart).collect()
    }

    /// All circles: sets of modules that depend on each other.
    fn circles(&self) -> Vec<BTreeSet<String>> {
        let direct: BTreeMap<&Module, BTreeSet<Module>> =
            self.modules.keys().map(|module| (module, self.dependencies(module))).collect();
        let reached = |from: &Module| {
            let mut reached = BTreeSet::new();
            let mut open: Vec<&Module> = direct[from].iter().collect();
            while let Some(module) = open.pop() {
                if reached.insert(module) {
                    open.extend(&direct[module]);
                }
            }
            reached
        };
        let reached: BTreeMap<&Module, BTreeSet<&Module>> =
            self.modules.keys().map(|module| (module, reached(module))).collect();
        let mut circles: Vec<BTreeSet<String>> = Vec::new();
        for (module, others) in &reached {
            if !others.contains(module) {
                continue;
            }
            let on_circle = others.iter().filter(|other| reached[**other].contains(module));
            let circle = on_circle.map(|module| module.join("::")).collect();
            if !circles.contains(&circle) {
                circles.push(circle);
            }
        }
        circles
    }
}

impl Source {
    fn parse(text: &str) -> Self {
        let code = code(text);
        let mut source = Self::default();
        let mut rest = String::new();
        for statement in code.split_inclusive(';') {
            match declaration(statement) {
                Some((before, is_public, tree)) => {
                    rest.push_str(before);
                    let mut paths = Vec::new();
                    tree_paths(tree.trim_end_matches(';'), &[], &mut paths);
                    source.uses.extend(paths.into_iter().map(|path| (is_public, path)));
                }
                None => rest.push_str(statement),
            }
        }
        let is_part = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
        for word in rest.split(|c: char| !is_part(c)).filter(|word| word.contains("::")) {
            let path: Vec<String> =
                word.split("::").take_while(|part| !part.is_empty()).map(str::to_owned).collect();
            if path.len() > 1 {
                source.paths.push(path);
            }
        }
        source
    }
}

/// Text before a `use` declaration at the end of a statement, whether it is public, and its tree.
fn declaration(statement: &str) -> Option<(&str, bool, &str)> {
    let at = statement.rfind("use ")?;
    let before = &statement[..at];
    let is_start = before.is_empty() || before.ends_with([' ', '\n', '}', ')']);
    let tree = &statement[at + 4..];
    let is_tree = statement.ends_with(';') && !tree.contains(['(', '=', '.', '"']);
    let line = before.rsplit('\n').next().unwrap_or_default();
    (is_start && is_tree).then_some((before, line.trim_start().starts_with("pub"), tree))
}

/// The paths of a `use` tree.
fn tree_paths(tree: &str, above: &[String], paths: &mut Vec<Vec<String>>) {
    let tree = tree.trim();
    let (head, inside) = match tree.split_once('{') {
        Some((head, inside)) => (head, Some(inside.trim_end().trim_end_matches('}'))),
        None => (tree.split(" as ").next().unwrap_or_default(), None),
    };
    let parts = head.split("::").map(str::trim).filter(|part| !part.is_empty()).map(str::to_owned);
    let path: Vec<String> = above.iter().cloned().chain(parts).collect();
    let Some(inside) = inside else {
        return paths.push(path);
    };
    let mut depth = 0;
    let branches = inside.split(|c: char| {
        depth += i32::from(c == '{') - i32::from(c == '}');
        c == ',' && depth == 0
    });
    let branches: Vec<&str> = branches.filter(|branch| !branch.trim().is_empty()).collect();
    branches.into_iter().for_each(|branch| tree_paths(branch, &path, paths));
}

/// The code of a file: no comments, no texts, no unit tests.
fn code(text: &str) -> String {
    let end = text.find("\n#[cfg(test)]\nmod tests {").unwrap_or(text.len());
    let mut code = String::new();
    for line in text[..end].lines() {
        let line = line.split("//").next().unwrap_or_default();
        let mut is_text = false;
        for (number, part) in line.split('"').enumerate() {
            is_text = number % 2 == 1;
            if !is_text {
                code.push_str(part);
            }
        }
        if !is_text {
            code.push('\n');
        }
    }
    code
}

#[test]
fn imports_between_files_form_no_circle() {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    for name in CRATES {
        found.extend(
            Crate::read(&root.join(name)).circles().iter().map(|circle| format!("{name}: {circle:?}")),
        );
    }
    assert!(found.is_empty(), "move what these files share to a file of its own:\n{}", found.join("\n"));
}

#[test]
fn a_circle_is_found_through_groups_and_re_exports_but_not_between_parent_and_child() {
    let source = |text: &str| Source::parse(text);
    let module = |path: &str| -> Module {
        path.split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect()
    };
    let crate_of = |files: &[(&str, &str)]| Crate {
        modules: files.iter().map(|(path, text)| (module(path), source(text))).collect(),
    };
    let circle = crate_of(&[
        ("", "mod a;\nmod b;"),
        ("a", "mod inner;\npub use inner::Thing;\nuse crate::{b::{self, other::{Deep}}};"),
        ("a::inner", "use super::helper;"),
        ("b", "fn f() { super::a::make() } // use crate::c;"),
        ("b::other", "use crate::a::inner::Thing;"),
    ]);
    let expected: Vec<BTreeSet<String>> = Vec::new();
    assert_ne!(circle.circles(), expected);
    let tree = crate_of(&[
        ("", "mod a;\nmod b;\npub use a::Thing;"),
        ("a", "mod inner;\nuse inner::Part;\nuse crate::b::Other;"),
        ("a::inner", "use super::Thing;"),
        ("b", "let text = \"crate::a::Thing\";"),
    ]);
    assert_eq!(tree.circles(), expected);
}
