//! `cargo xtask libtorch`: decides which libtorch the build will use, checks it, and installs one when there is none.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::Error;
use crate::wheels::{self, VERSION};
use crate::{install, process};

/// Where the build takes libtorch from.
#[derive(Debug, PartialEq, Eq)]
enum Source {
    /// `.libtorch` in the project's root, which this command makes.
    Own,
    /// A folder that the user named in `LIBTORCH`.
    Given(PathBuf),
    /// The torch package of the user's Python (`LIBTORCH_USE_PYTORCH`).
    Python,
}

/// Makes sure that the libtorch which the build will use is there; downloads it only when it has to.
///
/// # Errors
/// When the user's libtorch cannot be used, the host lacks something, or the installation fails.
pub fn ensure(root: &Path) -> Result<(), Error> {
    let own = root.join(".libtorch");
    match source(std::env::var_os("LIBTORCH"), std::env::var_os("LIBTORCH_USE_PYTORCH"), &own) {
        Source::Python => check_python(),
        Source::Given(folder) => {
            check_given(&folder)?;
            println!("libtorch {VERSION}: {} (from LIBTORCH)", folder.display());
            Ok(())
        }
        Source::Own => {
            install::ensure(root, &own)?;
            println!("libtorch {VERSION}: {}", own.display());
            Ok(())
        }
    }
}

/// Cargo's configuration sets `LIBTORCH` to the project's own folder when the user has not set it, so only another
/// folder is a choice of the user's. torch-sys lets `LIBTORCH_USE_PYTORCH` win over `LIBTORCH`.
fn source(libtorch: Option<OsString>, use_pytorch: Option<OsString>, own: &Path) -> Source {
    if use_pytorch.is_some() {
        return Source::Python;
    }
    match libtorch {
        Some(folder) if !folder.is_empty() && !same(Path::new(&folder), own) => Source::Given(folder.into()),
        _ => Source::Own,
    }
}

/// Whether two paths name one place; the last part may be missing, and its folder may be reached through a link.
fn same(a: &Path, b: &Path) -> bool {
    let real = |path: &Path| Some(path.parent()?.canonicalize().ok()?.join(path.file_name()?));
    a == b || real(a).is_some_and(|a| real(b) == Some(a))
}

fn check_given(folder: &Path) -> Result<(), Error> {
    let unusable = |problem: String| Error::Libtorch {
        problem: format!("LIBTORCH is `{}`, but {problem}", folder.display()),
        remedy: format!(
            "let LIBTORCH name the folder of a libtorch {VERSION} that holds lib/ and include/, \
             or unset it and run `cargo xtask libtorch`"
        ),
    };
    if !folder.is_absolute() {
        return Err(unusable("that is no absolute path".to_owned()));
    }
    for part in ["lib", "include"] {
        if !folder.join(part).is_dir() {
            return Err(unusable(format!("there is no folder `{part}` in it")));
        }
    }
    match fs::read_to_string(folder.join("build-version")) {
        Ok(text) if wheels::is_right_version(&text) => Ok(()),
        Ok(text) => Err(unusable(format!("its build-version is `{}`, expected `{VERSION}`", text.trim()))),
        Err(_) => {
            Err(unusable(format!("it has no readable file `build-version`, expected `{VERSION}` in it")))
        }
    }
}

fn check_python() -> Result<(), Error> {
    // torch-sys asks the same interpreter.
    let python = if std::env::var_os("VIRTUAL_ENV").is_some() { "python" } else { "python3" };
    let script = "import torch; print(torch.__version__)";
    let version = process::output(Command::new(python).args(["-c", script]));
    match version.as_deref().map(str::trim) {
        Some(version) if wheels::is_right_version(version) => {
            println!("libtorch {version}: from `{python}` (LIBTORCH_USE_PYTORCH is set)");
            Ok(())
        }
        seen => Err(Error::Libtorch {
            problem: format!(
                "LIBTORCH_USE_PYTORCH is set, and `{python}` has {}, expected torch {VERSION}",
                seen.map_or_else(|| "no torch that can be imported".to_owned(), |v| format!("torch {v}"))
            ),
            remedy: format!("`{python} -m pip install torch=={VERSION}`, or unset LIBTORCH_USE_PYTORCH"),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scratch(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("dril-xtask-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_missing_empty_or_own_libtorch_variable_means_the_projects_own_folder() {
        let own = Path::new("/p/.libtorch");
        for value in [None, Some(""), Some("/p/.libtorch")] {
            assert_eq!(source(value.map(Into::into), None, own), Source::Own);
        }
    }

    #[test]
    fn the_own_folder_is_recognised_through_a_link_and_before_it_exists() {
        let root = scratch("link");
        std::os::unix::fs::symlink(&root, root.join("alias")).unwrap();
        let alias = root.join("alias/.libtorch").into_os_string();
        assert_eq!(source(Some(alias), None, &root.join(".libtorch")), Source::Own);
        fs::remove_dir_all(&root).unwrap();
    }

    #[test]
    fn another_folder_is_the_users_and_python_wins_over_it() {
        let own = Path::new("/p/.libtorch");
        assert_eq!(source(Some("/opt/lt".into()), None, own), Source::Given("/opt/lt".into()));
        assert_eq!(source(Some("/opt/lt".into()), Some("1".into()), own), Source::Python);
    }

    #[test]
    fn a_build_tag_does_not_matter_but_the_version_does() {
        assert!(wheels::is_right_version("2.13.0\n") && wheels::is_right_version("2.13.0+cu130"));
        assert!(
            !wheels::is_right_version("2.13.1")
                && !wheels::is_right_version("2.13.00")
                && !wheels::is_right_version("")
        );
    }

    #[test]
    fn a_given_libtorch_is_checked_part_by_part() {
        let folder = scratch("given");
        let problem = || check_given(&folder).unwrap_err().to_string();
        assert!(problem().contains("`lib`"));
        fs::create_dir(folder.join("lib")).unwrap();
        assert!(problem().contains("`include`"));
        fs::create_dir(folder.join("include")).unwrap();
        assert!(problem().contains("build-version"));
        fs::write(folder.join("build-version"), "2.5.1\n").unwrap();
        assert!(problem().contains("is `2.5.1`, expected `2.13.0`"));
        fs::write(folder.join("build-version"), "2.13.0+cpu\n").unwrap();
        assert!(check_given(&folder).is_ok());
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_relative_libtorch_is_refused_since_every_crate_builds_in_another_folder() {
        assert!(check_given(Path::new("lt")).unwrap_err().to_string().contains("absolute"));
    }
}
