//! `import`: a file or folder from outside, identified by its content. It runs nothing: the engine hashes the file when it plans
//! and copies it into the store when a stage reads it.

use std::path::Path;

use dril_stage_api::{
    Arity, Artifact, Ctx, Describe, Input, Needs, Outside, Ports, Problems, Stage, StageError, port_name,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Imports a file or folder.
pub struct Import;

/// Parameters of `import`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ImportParams {
    /// The file or folder, relative to the folder of the pipeline file; a folder ends with `/`.
    path: String,
    /// The artifact type: `policy`, `scores`, `table`, ... By default `file`, or `folder` if the path ends with `/`.
    #[serde(default, rename = "type", skip_serializing_if = "Option::is_none")]
    artifact: Option<Artifact>,
    /// The expected blake3 digest: the 64 digits that `b3sum` prints; for a folder, those in the error message.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    blake3: Option<String>,
    /// Globs that are excluded from a folder: of a name at any depth (`*.log`) or, with a `/`, of a path in the folder
    /// (`/data/raw`, `notes/**`). By default, what programs and editors leave behind: `__pycache__`, `*.pyc`, `.git`, `*~`, `.*.swp`
    /// and similar (see the manual). A list replaces these; `[]` excludes nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    exclude: Option<Vec<String>>,
}

/// The default of `exclude`: files that change when code is merely run or viewed.
const LEFT_OUT: [&str; 19] = [
    "__pycache__",
    "*.py[co]",
    ".ipynb_checkpoints",
    ".mypy_cache",
    ".pytest_cache",
    ".ruff_cache",
    ".git",
    ".hg",
    ".svn",
    ".idea",
    ".vscode",
    "*~",
    ".*.sw[a-p]",
    ".sw[a-p]",
    ".#*",
    "#*#",
    ".DS_Store",
    "Thumbs.db",
    ".nfs*",
];

impl ImportParams {
    fn left_out(&self) -> Vec<String> {
        match (&self.exclude, self.artifact()) {
            (Some(globs), Artifact::FOLDER) => globs.clone(),
            (None, Artifact::FOLDER) => LEFT_OUT.map(str::to_owned).into(),
            _ => Vec::new(),
        }
    }

    fn artifact(&self) -> Artifact {
        let plain = if self.path.ends_with('/') { Artifact::FOLDER } else { Artifact::FILE };
        self.artifact.unwrap_or(plain)
    }

    fn extension(&self) -> &str {
        let ending = Path::new(&self.path).extension().and_then(|ending| ending.to_str());
        match self.artifact() {
            Artifact::FOLDER => "",
            artifact => ending.filter(|ending| is_ending(ending)).unwrap_or(artifact.extension()),
        }
    }
}

/// The path without the `/` that marks a folder.
fn bare(path: &str) -> &str {
    let bare = path.trim_end_matches('/');
    if bare.is_empty() { path } else { bare }
}

/// True for a valid file extension.
pub(super) fn is_ending(text: &str) -> bool {
    !text.is_empty()
        && text.len() <= 20
        && text.chars().all(|c| c.is_ascii_alphanumeric() || "_-".contains(c))
}

impl Describe for Import {
    const KIND: &'static str = "import";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "imports a file or folder from outside, identified by its content";
    const SEEDED: bool = false;
    type Params = ImportParams;

    fn check(params: &ImportParams, problems: &mut Problems) {
        if params.path.is_empty() || params.path.contains('\0') {
            problems.add(
                "path",
                format!("`path` is `{}`, expected a file or folder", params.path.escape_debug()),
            );
        }
        match params.artifact {
            Some(Artifact::ANY) => {
                problems.add("type", "`type` is `any`, expected a specific type such as `file` or `folder`")
            }
            Some(artifact) if artifact != Artifact::FOLDER && params.path.ends_with('/') => {
                problems.add(
                    "type",
                    format!("`type` is `{artifact}`, but a path that ends with `/` is a folder"),
                );
            }
            _ => {}
        }
        for (at, glob) in params.exclude.iter().flatten().enumerate() {
            if let Err(error) = globset::Glob::new(glob) {
                let message = format!("`{}` is not a valid glob: {}", glob.escape_debug(), error.kind());
                problems.add(&format!("exclude.{at}"), message);
            }
        }
        if let Some(digest) = &params.blake3 {
            let is_hex = |c: char| c.is_ascii_digit() || ('a'..='f').contains(&c);
            if digest.len() != 64 || !digest.chars().all(is_hex) {
                problems
                    .add("blake3", "`blake3` is not a digest, expected 64 hexadecimal digits in lower case");
            }
        }
    }

    fn ports(params: &ImportParams) -> Ports {
        let content = "the imported file or folder";
        let mut ports = Ports::new()
            .with_input(Input {
                name: "outside",
                artifact: params.artifact(),
                arity: Arity::One,
                about: "filled from `path`",
            })
            .output("content", params.artifact(), port_name(params.extension()), content);
        ports.outside = Some(Outside {
            param: "path",
            path: bare(&params.path).to_owned(),
            blake3: params.blake3.clone(),
            exclude: params.left_out(),
        });
        ports
    }

    fn needs(_: &ImportParams) -> Needs {
        Needs::seconds(0.1)
    }
}

impl Stage for Import {
    type Kind = Self;

    fn run(_: &ImportParams, _: &mut Ctx<'_>) -> Result<(), StageError> {
        Err(StageError::failed("the engine imports files itself; this kind is never run"))
    }
}
