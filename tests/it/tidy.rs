//! The rules of the house that no compiler checks: sizes, openings, who may depend on whom, who may touch what.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A source file may have this many lines.
const MOST_LINES: usize = 500;
/// A file that only assembles a program may have this many.
const MOST_LINES_OF_MAIN: usize = 35;

/// Modules of the engine and the modules that each may name. `error` and `cli` stand above all.
const LAYERS: [(&str, &[&str]); 11] = [
    ("fsx", &[]),
    ("kinds", &["fsx"]),
    ("spec", &[]),
    ("resolve", &["spec"]),
    ("store", &["fsx"]),
    ("settings", &["spec", "fsx"]),
    ("remote", &["store", "fsx"]),
    ("plan", &["resolve", "store", "fsx"]),
    ("exec", &["plan", "resolve", "spec", "store", "fsx"]),
    ("cluster", &["exec", "settings", "spec", "store", "fsx"]),
    ("session", &["exec", "plan", "resolve", "spec", "store", "fsx", "error"]),
];

/// Packages of the workspace and those that each may depend on.
const PACKAGES: [(&str, &str, &[&str]); 8] = [
    (
        "Cargo.toml",
        "dril-pipe",
        &["dril-stage-api", "dril-envs", "dril-kinds", "dril-learn", "dril-parity", "dril-report"],
    ),
    ("stages/api/Cargo.toml", "dril-stage-api", &[]),
    ("stages/envs/Cargo.toml", "dril-envs", &["dril-stage-api"]),
    ("stages/kinds/Cargo.toml", "dril-kinds", &["dril-stage-api", "dril-envs"]),
    ("stages/learn/Cargo.toml", "dril-learn", &["dril-stage-api", "dril-envs", "dril-kinds"]),
    ("stages/parity/Cargo.toml", "dril-parity", &["dril-stage-api", "dril-envs"]),
    ("stages/report/Cargo.toml", "dril-report", &["dril-stage-api"]),
    ("xtask/Cargo.toml", "xtask", &[]),
];

/// Heavy libraries and the one package that may link each.
const OWNERS: [(&str, &str); 4] =
    [("tch", "dril-learn"), ("rapier2d", "dril-envs"), ("clap", "dril-pipe"), ("object_store", "dril-pipe")];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// All files below these paths whose name ends so, relative to the root, sorted.
fn files(starts: &[&str], ending: &str) -> Vec<PathBuf> {
    fn walk(path: &Path, ending: &str, found: &mut Vec<PathBuf>) {
        if path.is_dir() {
            for entry in std::fs::read_dir(path).unwrap() {
                walk(&entry.unwrap().path(), ending, found);
            }
        } else if path.to_string_lossy().ends_with(ending) {
            found.push(path.strip_prefix(root()).unwrap().to_owned());
        }
    }
    let mut found = Vec::new();
    for start in starts {
        walk(&root().join(start), ending, &mut found);
    }
    found.sort();
    found
}

fn sources() -> Vec<PathBuf> {
    files(&["build.rs", "src", "stages", "tests", "xtask"], ".rs")
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The lines of code of a file of the engine, with their numbers: no comments, and nothing from its tests on.
fn code(path: &Path) -> Vec<(usize, String)> {
    let is_test = path.file_stem().is_some_and(|stem| stem.to_string_lossy().ends_with("tests"));
    let all = if is_test { String::new() } else { text(path) };
    let lines = all.lines().take_while(|line| line.trim() != "#[cfg(test)]").enumerate();
    let code = lines.filter(|(_, line)| !line.trim_start().starts_with("//"));
    code.map(|(number, line)| (number + 1, line.to_owned())).collect()
}

/// The module of a file of the engine: `plan` for `src/plan/key.rs` and `src/plan.rs`.
fn module(path: &Path) -> String {
    let inside = path.strip_prefix("src").unwrap();
    inside.components().next().unwrap().as_os_str().to_string_lossy().trim_end_matches(".rs").to_owned()
}

fn engine() -> Vec<(String, PathBuf)> {
    let all = files(&["src"], ".rs").into_iter();
    all.map(|path| (module(&path), path)).filter(|(module, _)| module != "bin" && module != "main").collect()
}

/// Fails with one line for each breach.
fn none(breaches: &[String], rule: &str) {
    assert!(breaches.is_empty(), "{rule}:\n  {}", breaches.join("\n  "));
}

#[test]
fn no_source_file_is_longer_than_500_lines() {
    let long = sources().into_iter().map(|path| (text(&path).lines().count(), path));
    let long: Vec<String> = long
        .filter(|(lines, _)| *lines >= MOST_LINES)
        .map(|(lines, path)| format!("{}: {lines}", path.display()))
        .collect();
    none(&long, "split these files");
}

#[test]
fn every_source_file_opens_with_what_it_is() {
    let silent = sources().into_iter().filter(|path| !text(path).starts_with("//! "));
    let silent: Vec<String> = silent.map(|path| path.display().to_string()).collect();
    none(&silent, "open these files with `//!`: what it is, and why");
}

#[test]
fn programs_only_assemble() {
    let mut mains = files(&["src/bin"], ".rs");
    mains.push("src/main.rs".into());
    for path in mains {
        assert!(text(&path).lines().count() < MOST_LINES_OF_MAIN, "{}", path.display());
    }
}

/// The names under every `[…dependencies]` heading but those for tests and builds.
fn dependencies(manifest: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut inside = false;
    for line in manifest.lines() {
        if let Some(heading) = line.strip_prefix('[') {
            let heading = heading.trim_end_matches(']');
            inside = heading.ends_with("dependencies")
                && !["workspace.", "dev-", "build-"].iter().any(|start| heading.starts_with(start));
        } else if inside && let Some((name, _)) = line.split_once(['.', '=', ' ']) {
            found.insert(name.trim().to_owned());
        }
    }
    found
}

#[test]
fn packages_depend_in_one_direction() {
    let ours: BTreeSet<&str> = PACKAGES.iter().map(|(_, name, _)| *name).collect();
    let mut breaches = Vec::new();
    for (manifest, package, allowed) in PACKAGES {
        let dependencies = dependencies(&text(Path::new(manifest)));
        assert!(package == "xtask" || dependencies.len() > 1, "{manifest} was not understood");
        let wrong = dependencies.iter().map(String::as_str).filter(|name| ours.contains(name));
        breaches.extend(
            wrong.filter(|name| !allowed.contains(name)).map(|name| format!("{package} depends on {name}")),
        );
    }
    none(&breaches, "see docs/architecture.md");
    let members = files(&["stages", "xtask"], "Cargo.toml").len() + 1;
    assert_eq!(members, PACKAGES.len(), "a package is missing in this test");
}

#[test]
fn heavy_libraries_have_one_owner() {
    for (library, owner) in OWNERS {
        let users = PACKAGES
            .iter()
            .filter(|(manifest, _, _)| dependencies(&text(Path::new(manifest))).contains(library));
        let users: Vec<&str> = users.map(|(_, package, _)| *package).collect();
        assert_eq!(users, [owner], "{library}");
    }
}

#[test]
fn the_engine_alone_builds_without_any_stage() {
    let manifest = text(Path::new("Cargo.toml"));
    for (_, package, _) in
        PACKAGES.iter().filter(|(path, name, _)| path.starts_with("stages") && *name != "dril-stage-api")
    {
        let line = manifest
            .lines()
            .find(|line| line.starts_with(&format!("{package} =")) && line.contains("workspace"));
        assert!(line.is_some_and(|line| line.contains("optional = true")), "{package} must be optional");
    }
    let named = engine().into_iter().filter(|(_, path)| {
        code(path).iter().any(|(_, line)| {
            ["dril_envs", "dril_kinds", "dril_learn", "dril_parity", "dril_report"]
                .iter()
                .any(|name| line.contains(name))
        })
    });
    let named: Vec<String> = named.map(|(_, path)| path.display().to_string()).collect();
    none(&named, "only src/main.rs and src/bin name the stage crates");
}

#[test]
fn modules_depend_in_one_direction() {
    let layers: BTreeMap<&str, &[&str]> = LAYERS.into_iter().collect();
    let mut breaches = Vec::new();
    for (module, path) in engine() {
        let Some(allowed) = layers.get(&*module) else { continue };
        for (number, line) in code(&path) {
            for after in line.split("crate::").skip(1) {
                assert!(!after.starts_with('{'), "{}:{number}: one `use` for each module", path.display());
                let named: String = after.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
                let is_module = layers.contains_key(&*named) || named == "cli" || named == "error";
                if is_module && named != module && !allowed.contains(&&*named) {
                    breaches.push(format!("{}:{number}: {module} names {named}", path.display()));
                }
            }
        }
    }
    none(&breaches, "see docs/architecture.md");
    let known: BTreeSet<&str> = layers.keys().copied().chain(["cli", "error", "lib"]).collect();
    for (module, path) in engine() {
        assert!(known.contains(&*module), "{} is in no layer", path.display());
    }
}

/// Lines of the engine's code with one of these words, outside the modules that may have them.
fn uses(words: &[&str], except: &[&str]) -> Vec<String> {
    let mut found = Vec::new();
    for (module, path) in engine().into_iter().filter(|(module, _)| !except.contains(&&**module)) {
        for (number, line) in code(&path) {
            if words.iter().any(|word| line.contains(word)) {
                found.push(format!("{}:{number}: [{module}] {}", path.display(), line.trim()));
            }
        }
    }
    found
}

#[test]
fn only_cli_prints_reads_the_environment_or_exits() {
    let words = ["println!", "print!(", "env::var", "env::args", "process::exit"];
    // A command sees the variables that it is allowed to see, and starts a program: that is all it does.
    none(&uses(&words, &["cli", "kinds"]), "this belongs to src/cli");
}

#[test]
fn only_fsx_touches_files() {
    let mut uses =
        uses(&["std::fs", "fs::read", "fs::write", "fs::create", "fs::remove", "File::open"], &["fsx"]);
    // A file that is open already may be passed on.
    uses.retain(|line| !line.ends_with("use std::fs::File;"));
    none(&uses, "this belongs to src/fsx");
}

#[test]
fn parse_and_resolve_do_no_input_or_output() {
    let pure = ["spec", "resolve"];
    let words = ["std::io", "std::net", "std::process", "std::time", "std::thread", "Instant", "SystemTime"];
    let uses = uses(
        &words,
        &[
            "cli", "error", "exec", "fsx", "kinds", "lib", "plan", "remote", "session", "settings",
            "cluster", "store",
        ],
    );
    // How to say that a file could not be read is no reading, and a time that is written down asks no clock.
    let is_value = |line: &String| line.contains("io::Error") || line.ends_with("use std::time::Duration;");
    let uses: Vec<String> = uses.into_iter().filter(|line| !is_value(line)).collect();
    none(&uses, &format!("{} must stay pure", pure.join(" and ")));
}

#[test]
fn one_place_reads_the_command_line() {
    let uses = uses(&["clap::"], &[]);
    let others: Vec<String> = uses.into_iter().filter(|line| !line.starts_with("src/cli/args")).collect();
    none(&others, "clap belongs to src/cli/args.rs and the files below it");
}

#[test]
fn one_file_talks_to_servers() {
    let mut uses = uses(&["object_store::", "tokio::", "reqwest", "futures_util::"], &[]);
    uses.retain(|line| !line.starts_with("src/remote/servers.rs"));
    none(&uses, "asynchronous code belongs to src/remote/servers.rs");
}

#[test]
fn no_file_names_a_path_of_a_particular_machine() {
    let places = ["work/", "home/", "root/", "Users/"].map(|place| format!("/{place}"));
    let starts =
        ["src", "stages", "tests", "xtask", "docs", "pipelines", "README.md", "CHANGELOG.md", "Cargo.toml"];
    let endings = [".rs", ".md", ".toml", ".yaml", ".csv", ".snap", ".json"];
    let mut breaches = Vec::new();
    for path in endings.iter().flat_map(|ending| files(&starts, ending)) {
        let bytes = std::fs::read(root().join(&path)).unwrap();
        for (number, line) in String::from_utf8_lossy(&bytes).lines().enumerate() {
            let named = places.iter().find(|place| {
                line.match_indices(&***place)
                    .any(|(at, _)| !line[..at].ends_with(|c: char| c.is_alphanumeric()))
            });
            if named.is_some() {
                breaches.push(format!("{}:{}: {}", path.display(), number + 1, line.trim()));
            }
        }
    }
    none(&breaches, "say it without the path");
}

#[test]
fn tests_that_the_pages_name_exist() {
    let all: String = sources().iter().map(|path| text(path)).collect();
    let is_word =
        |word: &&&str| word.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    for page in ["docs/architecture.md", "docs/fidelity.md"] {
        let page_text = text(Path::new(page));
        let named: BTreeSet<&str> =
            page_text.split('`').skip(1).step_by(2).filter(|word| word.matches('_').count() >= 3).collect();
        assert!(named.len() > 5, "{page} names the tests of what it states");
        let gone = named.iter().filter(is_word).filter(|word| !all.contains(&format!("fn {word}(")));
        let gone: Vec<String> = gone.map(|word| word.to_string()).collect();
        none(&gone, &format!("{page} names tests that do not exist"));
    }
}

#[test]
fn links_between_pages_lead_somewhere() {
    let mut broken = Vec::new();
    for page in files(&["docs", "README.md", "CHANGELOG.md"], ".md") {
        let folder = root().join(page.parent().unwrap());
        for after in text(&page).split("](").skip(1) {
            let link = after.split([')', ' ']).next().unwrap_or_default();
            let (target, anchor) = link.split_once('#').unwrap_or((link, ""));
            if target.contains("://") {
                continue;
            }
            let path = if target.is_empty() { root().join(&page) } else { folder.join(target) };
            let leads = match anchor {
                "" => path.exists(),
                _ => anchors(&std::fs::read_to_string(&path).unwrap_or_default()).contains(anchor),
            };
            if !leads {
                broken.push(format!("{}: {link}", page.display()));
            }
        }
    }
    none(&broken, "links to nowhere");
}

/// The anchors of the headings of a page, as Git forges make them.
fn anchors(page: &str) -> BTreeSet<String> {
    let headings =
        page.lines().filter_map(|line| line.strip_prefix('#').map(|rest| rest.trim_start_matches('#')));
    let kept = |c: &char| c.is_alphanumeric() || [' ', '-', '_'].contains(c);
    let slug = |heading: &str| heading.trim().chars().filter(kept).collect::<String>();
    headings.map(|heading| slug(heading).to_lowercase().replace(' ', "-")).collect()
}
