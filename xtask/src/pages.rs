//! The last check of `cargo xtask test`: report pages in a real browser (`tools/pages/check.mjs`). It needs Chromium,
//! Node.js and npm; where one is missing, it is skipped.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::Error;
use crate::process;

/// What Chromium is called on different systems.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
/// The example pipelines whose reports are opened, beside the pages that the tests of `dril-report` write.
const EXAMPLES: [&str; 3] = ["pi", "words", "fit"];

/// Checks the pages; gives the reason where they cannot be checked here.
///
/// # Errors
/// A page has a defect, or cannot be written.
pub fn check(root: &Path) -> Result<Option<String>, Error> {
    let Some(browser) = browser() else {
        let names = BROWSERS.join("`, `");
        return Ok(Some(format!("none of `{names}` is installed (`apt-get install chromium`)")));
    };
    for program in ["node", "npm"] {
        if process::output(Command::new(program).arg("--version")).is_none() {
            return Ok(Some(format!("`{program}` is not installed (`apt-get install nodejs npm`)")));
        }
    }
    let tools = root.join("tools/pages");
    if !tools.join("node_modules/puppeteer-core").is_dir() || !tools.join("node_modules/axe-core").is_dir() {
        let mut install = Command::new("npm");
        install.args(["install", "--no-audit", "--no-fund"]).current_dir(&tools);
        if let Err(error) = process::run(&mut install) {
            return Ok(Some(format!("its packages cannot be installed: {error}")));
        }
    }
    let folder = root.join("target/pages");
    let pages = write(root, &folder)?;
    let mut check = Command::new("node");
    check.current_dir(root).arg(tools.join("check.mjs")).arg("--chromium").arg(browser);
    check.arg("--out").arg(folder.join("screenshots")).args(pages);
    process::run(&mut check)?;
    Ok(None)
}

/// The first browser that runs, by its path: puppeteer does not search `PATH`.
fn browser() -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    let folders: Vec<PathBuf> = std::env::split_paths(&path).filter(|folder| folder.is_absolute()).collect();
    let mut programs = BROWSERS.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
    programs.find(|program| process::output(Command::new(program).arg("--version")).is_some())
}

/// Writes the pages; gives their files.
fn write(root: &Path, folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut tests =
        process::cargo(root, &["test", "--quiet", "--package", "dril-report", "--test", "it", "html"]);
    process::run(tests.env("DRIL_PIPE_PAGES", folder))?;
    // The largest page is there for its size; laying it out takes minutes.
    let is_left_out = |folder: &Path| EXAMPLES.iter().chain(&["large"]).any(|name| folder.ends_with(name));
    let mut pages: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(Error::io("read", folder))?
        .filter_map(|entry| Some(entry.ok()?.path().join("report.html")).filter(|page| page.is_file()))
        .filter(|page| !page.parent().is_some_and(is_left_out))
        .collect();
    pages.sort();
    for name in EXAMPLES {
        let out = folder.join(name);
        let file = format!("pipelines/examples/{name}/{name}.yaml");
        let mut run =
            process::cargo(root, &["run", "--quiet", "--bin", "dril-pipe", "--", "run", &file, "--quiet"]);
        run.arg("--out").arg(&out).arg("--cache").arg(folder.join("cache"));
        process::run(&mut run)?;
        pages.push(out.join("report.html"));
    }
    Ok(pages)
}
