//! What the sources must not contain.

#![allow(clippy::expect_used)]

use std::path::{Path, PathBuf};

/// Folders under `stages/` whose code has to give the same bits on every machine.
const PORTABLE: [&str; 1] = ["envs/src"];

/// Functions of `f32` and `f64` that the standard library takes from the C library, whose bits depend on the processor;
/// and `powi`, whose bits are not specified.
const FOREIGN: [&str; 28] = [
    "sin", "cos", "sin_cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh",
    "acosh", "atanh", "exp", "exp2", "exp_m1", "ln", "ln_1p", "log", "log2", "log10", "powf", "powi",
    "hypot", "cbrt", "gamma", "ln_gamma",
];

/// Lines with a call of such a function, as a method or by its path. Tests at the end of a file do not count.
fn foreign_calls(source: &str) -> Vec<(usize, &str)> {
    let code = source.lines().enumerate().take_while(|(_, line)| line.trim() != "#[cfg(test)]");
    let calls = |line: &str| {
        let line = line.split("//").next().unwrap_or_default();
        let method = |name: &&str| line.contains(&format!(".{name}("));
        let path = |name: &&str| {
            ["f32::", "f64::", "Float::"].iter().any(|of| {
                line.match_indices(&format!("{of}{name}")).any(|(at, found)| {
                    !line[at + found.len()..].starts_with(|c: char| c.is_alphanumeric() || c == '_')
                })
            })
        };
        FOREIGN.iter().any(|name| method(name) || path(name))
    };
    code.filter(|(_, line)| calls(line)).map(|(at, line)| (at + 1, line)).collect()
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("the folder is there");
    let paths = entries.map(|entry| entry.expect("an entry").path());
    let name = |path: &Path| path.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_owned();
    paths
        .flat_map(|path| if path.is_dir() { sources(&path) } else { vec![path] })
        .filter(|path| name(path).ends_with(".rs") && !name(path).ends_with("tests.rs"))
        .collect()
}

#[test]
fn nothing_that_reaches_a_result_calls_the_c_librarys_mathematics() {
    let stages = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut found = String::new();
    for path in PORTABLE.iter().flat_map(|folder| sources(&stages.join(folder))) {
        for (line, text) in foreign_calls(&std::fs::read_to_string(&path).expect("a text")) {
            found += &format!("{}:{line}: {}\n", path.display(), text.trim());
        }
    }
    assert!(found.is_empty(), "use `dril_stage_api::math` instead:\n{found}");
}

#[test]
fn calls_are_found_as_methods_and_by_path_but_not_in_comments_or_tests() {
    let source = "let a = x.sin();\nlet b = math::sin(x); // x.sin()\nlet c = ys.map(f64::sin_cos);\n\
                  let d = y.sinus() + f64::sinus(y);\nlet e = y.powi(2);\n#[cfg(test)]\nlet f = x.sin();";
    let lines: Vec<usize> = foreign_calls(source).into_iter().map(|(line, _)| line).collect();
    assert_eq!(lines, [1, 3, 5]);
}
