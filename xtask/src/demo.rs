//! `cargo xtask demo`: from a fresh clone to Table 22 at smoke size and a lap of a trained agent, in one command.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::Error;
use crate::{libtorch, process};

/// Builds in release mode, runs the thesis pipeline's smoke profile with `extra` arguments and shows its Table 22.
///
/// # Errors
/// Those of [`libtorch::ensure`], of the build and of the run (whose exit code is passed on).
pub fn run(root: &Path, extra: &[String]) -> Result<(), Error> {
    libtorch::ensure(root)?;
    process::run(&mut process::cargo(root, &["build", "--release"]))?;
    let program = target_folder(root, std::env::var_os("CARGO_TARGET_DIR").map(PathBuf::from))
        .join("release/dril-pipe");
    let mut pipeline = Command::new(program);
    pipeline.current_dir(root).args(["run", "pipelines/thesis.yaml", "--profile", "smoke"]).args(extra);
    process::run(&mut pipeline)?;
    show(&root.join(results_folder(extra)))
}

/// Where the run put its tables: the default of this pipeline and profile, or the folder of `--out`.
fn results_folder(extra: &[String]) -> PathBuf {
    let mut args = extra.iter();
    let named = args.find_map(|arg| match arg.strip_prefix("--out") {
        Some("") => Some(None),
        Some(rest) => rest.strip_prefix('=').map(Some),
        None => None,
    });
    let folder = named.and_then(|value| value.or_else(|| args.next().map(String::as_str)));
    PathBuf::from(folder.unwrap_or("results/thesis-smoke"))
}

/// As cargo, run in `root`, sees it.
fn target_folder(root: &Path, variable: Option<PathBuf>) -> PathBuf {
    root.join(variable.filter(|folder| !folder.as_os_str().is_empty()).unwrap_or_else(|| "target".into()))
}

fn show(results: &Path) -> Result<(), Error> {
    let table = results.join("table22.md");
    let text = fs::read_to_string(&table).map_err(Error::io("read", &table))?;
    println!("\n{}\nAll tables and figures: {}", text.trim_end(), results.display());
    println!("A lap of the kept expert: {}", results.join("laps.gif").display());
    println!("The report, with both: {}", results.join("report.html").display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_results_are_in_the_chosen_folder() {
        let folder =
            |args: &[&str]| results_folder(&args.iter().map(ToString::to_string).collect::<Vec<_>>());
        assert_eq!(folder(&["--jobs", "2"]), Path::new("results/thesis-smoke"));
        assert_eq!(folder(&["--out", "a", "--jobs", "2"]), Path::new("a"));
        assert_eq!(folder(&["--out=b"]), Path::new("b"));
        assert_eq!(folder(&["--outer"]), Path::new("results/thesis-smoke"));
    }

    #[test]
    fn the_target_folder_is_cargos() {
        let root = Path::new("/p");
        assert_eq!(target_folder(root, None), Path::new("/p/target"));
        assert_eq!(target_folder(root, Some("".into())), Path::new("/p/target"));
        assert_eq!(target_folder(root, Some("/tmp/t".into())), Path::new("/tmp/t"));
        assert_eq!(target_folder(root, Some("t".into())), Path::new("/p/t"));
    }
}
