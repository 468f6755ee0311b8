//! The shared cache that a command uses: from the command line, `dril-pipe.toml` and the environment.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use dril_stage_api::{Kind, Registry};

use super::terminal::{print_error, printable};
use crate::error::{Error, ErrorKind};
use crate::fsx;
use crate::plan::{Plan, Reason, Verdict, key_of_record};
use crate::remote::{Address, Problem, Pulled, Pushed, Remote, RemoteError, Secret, variables_of};
use crate::settings::{self, Mode, RemoteSettings, Settings, SettingsError};
use crate::store::{Key, Store};

/// The environment variable with the secret that signs records.
const SECRET: &str = "DRIL_PIPE_REMOTE_SECRET";
/// Requests that may be under way at the same time, unless it is set.
const PARALLEL: usize = 32;
/// When a connection on which nothing moves is given up, unless it is set.
const TIMEOUT: Duration = Duration::from_secs(20);
/// Variables that say where keys come from, other than from the files of the AWS tools.
const KEYS: [&str; 5] = [
    "AWS_ACCESS_KEY_ID",
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
    "AWS_SKIP_SIGNATURE",
];

/// A shared cache, and what to do with it.
pub(super) struct Shared {
    pub remote: Remote,
    pub mode: Mode,
    pub url: String,
}

/// The settings for a pipeline file, or for the current folder. Names of kinds in them are checked against `registry`.
///
/// # Errors
/// A settings file cannot be read, or has a mistake.
pub(super) fn settings(pipeline: Option<&Path>, registry: Option<&Registry>) -> Result<Settings, Error> {
    let near = pipeline.and_then(Path::parent).unwrap_or(Path::new("")).join(settings::FILE);
    let folder = std::env::var_os("XDG_CONFIG_HOME").filter(|value| !value.is_empty()).map(PathBuf::from);
    let folder = folder.or_else(|| Some(home()?.join(".config")));
    let far = folder.map(|folder| folder.join("dril-pipe").join(settings::FILE));
    // A home that may not be looked into, as that of the user who called `su`, has no settings for this one.
    let far = far.filter(|far| matches!(fsx::entry(far), Ok(Some(_))));
    let files: Vec<PathBuf> = std::iter::once(near).chain(far).collect();
    let check = || {
        let settings = Settings::read(&files)?;
        if let Some(registry) = registry {
            let known: Vec<&str> = registry.iter().map(Kind::name).collect();
            Settings::check_kinds(&files, &known)?;
        }
        Ok(settings)
    };
    check().map_err(|error: SettingsError| {
        Error::new(ErrorKind::Usage, error).hint("docs/cluster.md lists all settings with their defaults")
    })
}

/// The user's home folder, if there is one.
pub(super) fn home() -> Option<PathBuf> {
    std::env::var_os("HOME").filter(|value| !value.is_empty()).map(PathBuf::from)
}

/// The shared cache that `url` (from the command line) or the settings name; `None` for none.
///
/// # Errors
/// The settings or the URL are wrong, or it is asked for in a program that was built without.
pub(super) fn open(
    url: Option<&str>,
    mode: Option<Mode>,
    pipeline: Option<&Path>,
) -> Result<Option<Shared>, Error> {
    if url == Some("off") {
        return Ok(None);
    }
    let settings = settings(pipeline, None)?.remote;
    // An endpoint from the settings belongs to the cache that they name.
    let same = url.is_none() || url == settings.url.as_deref();
    let Some(chosen) = url.map(str::to_owned).or_else(|| settings.url.clone()) else { return Ok(None) };
    let address = Address {
        parallel: settings.parallel.map_or(PARALLEL, usize::from),
        timeout: settings.timeout.unwrap_or(TIMEOUT),
        secret: secret(&settings)?,
        variables: variables(&chosen, &settings, same)?,
        url: chosen,
    };
    match Remote::open(&address, |record| key_of_record(record).ok()) {
        Ok(remote) => {
            let mode = mode.or(settings.mode).unwrap_or_default();
            Ok(Some(Shared { remote, mode, url: address.url }))
        }
        Err(RemoteError::NotBuilt) if url.is_none() => {
            let text =
                "this program was built without shared caches, so that of `dril-pipe.toml` is not used";
            print_error(&format!("warning: {text}\n  = hint: {BUILD}\n"));
            Ok(None)
        }
        Err(RemoteError::NoAnswer(why)) => {
            Ok(Some(Shared { remote: Remote::gone(why), mode: Mode::Read, url: address.url }))
        }
        Err(error @ RemoteError::NotBuilt) => Err(Error::new(ErrorKind::Usage, error).hint(BUILD)),
        Err(error) => Err(Error::new(ErrorKind::Usage, error)),
    }
}

const BUILD: &str = "build it with `cargo build --release --features remote`";

/// As [`open`], and there must be one.
///
/// # Errors
/// As [`open`], or none is named.
pub(super) fn need(url: Option<&str>, pipeline: Option<&Path>) -> Result<Shared, Error> {
    open(url, None, pipeline)?.ok_or_else(|| {
        Error::new(ErrorKind::Usage, "no shared cache is named")
            .hint("name one by `--remote URL`, or in `dril-pipe.toml` as `url` under `[remote]`")
    })
}

fn secret(settings: &RemoteSettings) -> Result<Option<Secret>, Error> {
    let (text, from) = match (std::env::var_os(SECRET), &settings.secret_file) {
        (Some(text), _) => (text.into_string().unwrap_or_default(), SECRET.to_owned()),
        (None, Some(file)) => {
            (String::from_utf8_lossy(&fsx::read(file)?).into_owned(), format!("`{}`", file.display()))
        }
        (None, None) => return Ok(None),
    };
    let short =
        || Error::new(ErrorKind::Usage, format!("the secret in {from} is shorter than 16 characters"));
    Secret::new(&text).map(Some).ok_or_else(short)
}

/// How to reach the server: the environment, then the settings where they are meant for it, then the files of the AWS
/// tools.
fn variables(url: &str, settings: &RemoteSettings, same: bool) -> Result<BTreeMap<String, String>, Error> {
    if !url.starts_with("s3://") {
        return Ok(BTreeMap::new());
    }
    let text = |(name, value): (std::ffi::OsString, std::ffi::OsString)| {
        Some((name.into_string().ok()?, value.into_string().ok()?))
    };
    let mut variables: BTreeMap<String, String> =
        std::env::vars_os().filter_map(text).filter(|(name, _)| name.starts_with("AWS_")).collect();
    if same {
        let set = [("AWS_ENDPOINT_URL", &settings.endpoint), ("AWS_DEFAULT_REGION", &settings.region)];
        for (name, value) in set {
            if let Some(value) = value {
                variables.insert(name.to_owned(), value.clone());
            }
        }
    }
    let profile = variables.get("AWS_PROFILE").cloned();
    if profile.is_some() || !KEYS.iter().any(|name| variables.contains_key(*name)) {
        let profile = profile.unwrap_or_else(|| "default".to_owned());
        for (variable, name) in
            [("AWS_SHARED_CREDENTIALS_FILE", "credentials"), ("AWS_CONFIG_FILE", "config")]
        {
            let path = variables.get(variable).map(PathBuf::from);
            let Some(path) = path.or_else(|| Some(home()?.join(".aws").join(name))) else { continue };
            let bytes = fsx::read_if_there(&path)?.unwrap_or_default();
            for (name, value) in variables_of(&String::from_utf8_lossy(&bytes), &profile) {
                variables.entry(name).or_insert(value);
            }
        }
    }
    Ok(variables)
}

/// What a run took from the shared cache and gave to it.
#[derive(Debug, Default)]
pub(super) struct Exchange {
    /// What was taken before the run.
    pub taken: Taken,
    /// What was given while it went on.
    pub given: Pushed,
}

impl Exchange {
    /// Prints what went wrong. Nothing of it changes how the run ended: its results are here.
    pub fn warn(&self, shared: &Shared) {
        for different in &self.given.different {
            print_error(&format!("warning: {}\n", printable(&different.to_string())));
        }
        let refused = self.taken.pulled.iter().flat_map(|pulled| &pulled.refused);
        for (what, problems) in
            [("take", refused.collect::<Vec<_>>()), ("give", self.given.failed.iter().collect())]
        {
            if let Some(Problem { key, why }) = problems.first() {
                let more = match problems.len() {
                    1 => String::new(),
                    all => format!(" (and {} more)", all - 1),
                };
                let why = printable(why);
                print_error(&format!("warning: did not {what} the result {}{more}: {why}\n", key.short()));
            }
        }
        if let Some(why) = shared.remote.given_up() {
            let (url, why) = (printable(&shared.url), printable(&why));
            let hint = "`dril-pipe cache push` gives later what is missing there";
            print_error(&format!(
                "warning: the shared cache `{url}` does not answer, and was left alone: {why}\n  = hint: {hint}\n"
            ));
        }
    }
}

/// What came of taking results for a plan.
#[derive(Debug, Default)]
pub(super) struct Taken {
    /// One for each time that the cache was asked. Keeps what was taken from being removed.
    pub pulled: Vec<Pulled>,
}

impl Taken {
    /// Results that were taken.
    pub fn results(&self) -> usize {
        self.pulled.iter().map(|pulled| pulled.new.len()).sum()
    }

    /// Their bytes.
    pub fn bytes(&self) -> u64 {
        self.pulled.iter().map(|pulled| pulled.bytes).sum()
    }
}

/// Makes a plan, takes what the shared cache has of its stages, and plans again, until nothing more comes: the keys of the
/// next stages are known only once the results before them are here.
///
/// # Errors
/// No plan can be made, or the store cannot be written.
pub(super) fn take<'g>(
    shared: &Shared,
    store: &Store,
    stop: &AtomicBool,
    mut plan: impl FnMut() -> Result<Plan<'g>, Error>,
) -> Result<(Plan<'g>, Taken), Error> {
    let mut asked: HashSet<Key> = HashSet::new();
    let mut taken = Taken::default();
    loop {
        let now = plan()?;
        let keys: Vec<Key> = now
            .steps
            .iter()
            .filter_map(|(_, verdict)| match verdict {
                Verdict::Run { key, why } if **why != [Reason::Forced] => Some(*key),
                _ => None,
            })
            .filter(|key| asked.insert(*key))
            .collect();
        if keys.is_empty() || shared.remote.given_up().is_some() {
            return Ok((now, taken));
        }
        let pulled = shared.remote.pull(store, &keys, stop, &|| {})?;
        let nothing = pulled.new.is_empty() && pulled.known == 0;
        taken.pulled.push(pulled);
        if nothing {
            return Ok((now, taken));
        }
    }
}
