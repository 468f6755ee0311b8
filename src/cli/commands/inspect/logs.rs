//! Finds logs: of every instance of a stage the newest one, whichever run it is from.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::rc::Rc;

use super::ids;
use crate::error::{Error, ErrorKind};
use crate::resolve::Pattern;
use crate::spec::suggest;
use crate::store::{Key, PastRun, Store};

/// The log of an instance.
pub(super) struct Log {
    /// The run that started it.
    pub run: Rc<PastRun>,
    /// Its name in that run.
    pub id: String,
    /// The log.
    pub path: PathBuf,
}

/// The logs of the instances that a pattern means.
#[derive(Default)]
pub(super) struct Logs {
    /// By the names of the instances.
    pub found: BTreeMap<String, Log>,
    /// Instances that no run has started.
    pub never: BTreeSet<String>,
}

/// Those of one run.
///
/// # Errors
/// It started no such stage.
pub(super) fn of_run(store: &Store, word: &str, pattern: &Pattern<'_>, run: &str) -> Result<Logs, Error> {
    let mut logs = Logs::default();
    let past = Rc::new(store.past_run(run)?);
    logs.add(&past, |id| pattern.means_id(id));
    if logs.found.is_empty() {
        let known = past.stages.keys().cloned().collect();
        return Err(none(word, pattern, &format!("as run {run}"), &known));
    }
    Ok(logs)
}

/// The newest ones. Instances are those that runs of one pipeline and profile have had: of the latest run that has such a stage,
/// if one of its instances has a log.
///
/// # Errors
/// No run has started such a stage.
pub(super) fn newest(store: &Store, word: &str, pattern: &Pattern<'_>) -> Result<Logs, Error> {
    let mut pipelines: Vec<Vec<Rc<PastRun>>> = Vec::new();
    let mut known = BTreeSet::new();
    for id in store.run_ids()? {
        let mut run = store.past_run(&id)?;
        if pipelines.is_empty() {
            known.extend(run.stages.keys().cloned());
        }
        run.stages.retain(|id, _| pattern.means_id(id));
        if run.stages.is_empty() {
            continue;
        }
        let same = |other: &&mut Vec<Rc<PastRun>>| {
            (&other[0].pipeline, &other[0].profile) == (&run.pipeline, &run.profile)
        };
        match pipelines.iter_mut().find(same) {
            Some(runs) => runs.push(Rc::new(run)),
            None => pipelines.push(vec![Rc::new(run)]),
        }
    }
    for runs in pipelines {
        let logs = of_pipeline(store, &runs)?;
        if !logs.found.is_empty() {
            return Ok(logs);
        }
    }
    Err(none(word, pattern, &format!("in `{}`", store.root().display()), &known))
}

/// The newest logs of runs of one pipeline, latest first.
fn of_pipeline(store: &Store, runs: &[Rc<PastRun>]) -> Result<Logs, Error> {
    let mut logs = Logs::default();
    // Instances whose axes have other names now are not there any more.
    let mut axes: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    let mut keys: BTreeMap<&str, Key> = BTreeMap::new();
    for run in runs {
        let now: BTreeMap<&str, Vec<&str>> = run.stages.keys().map(|id| ids::axes(id)).collect();
        for (name, its) in now {
            axes.entry(name).or_insert(its);
        }
        let is_current = |id: &str| {
            let (name, its) = ids::axes(id);
            axes.get(name) == Some(&its)
        };
        logs.add(run, is_current);
        for (id, stage) in run.stages.iter().filter(|(id, _)| is_current(id)) {
            logs.never.insert(id.clone());
            if let Some(key) = stage.key {
                keys.entry(id).or_insert(key);
            }
        }
    }
    logs.never.retain(|id| !logs.found.contains_key(id));
    logs.under_other_names(store, &keys)?;
    Ok(logs)
}

impl Logs {
    /// Adds the logs of a run for instances that have none yet.
    fn add(&mut self, run: &Rc<PastRun>, is_meant: impl Fn(&str) -> bool) {
        let started = run.stages.iter().filter(|(id, stage)| stage.fate.was_started() && is_meant(id));
        for (id, _) in started {
            if !self.found.contains_key(id)
                && let Some(path) = run.log_of(id)
            {
                self.found.insert(id.clone(), Log { run: Rc::clone(run), id: id.clone(), path });
            }
        }
    }

    /// Finds results that were made by a stage with another name, or in another pipeline.
    fn under_other_names(&mut self, store: &Store, keys: &BTreeMap<&str, Key>) -> Result<(), Error> {
        let mut wanted: Vec<(String, Key)> =
            self.never.iter().filter_map(|id| Some((id.clone(), *keys.get(id.as_str())?))).collect();
        if wanted.is_empty() {
            return Ok(());
        }
        for id in store.run_ids()? {
            let run = Rc::new(store.past_run(&id)?);
            let started = run.stages.iter().filter(|(_, stage)| stage.fate.was_started());
            let started: BTreeMap<Key, &String> =
                started.filter_map(|(id, stage)| Some((stage.key?, id))).collect();
            wanted.retain(|(wanted, key)| {
                let found = started.get(key).and_then(|id| Some((*id, run.log_of(id)?)));
                let Some((id, path)) = found else { return true };
                self.never.remove(wanted);
                self.found.insert(wanted.clone(), Log { run: Rc::clone(&run), id: id.clone(), path });
                false
            });
            if wanted.is_empty() {
                break;
            }
        }
        Ok(())
    }
}

/// The error where no run has started a stage; `known` are stages of runs.
fn none(word: &str, pattern: &Pattern<'_>, place: &str, known: &BTreeSet<String>) -> Error {
    let error = Error::new(ErrorKind::Usage, format!("no run {place} started a stage `{word}`"));
    let name = word.split('[').next().unwrap_or(word).trim();
    let of_it: Vec<&str> = known.iter().map(String::as_str).filter(|id| ids::parts(id).0 == name).collect();
    let names: BTreeSet<&str> = known.iter().map(|id| ids::parts(id).0).collect();
    if known.is_empty() {
        error.hint("there are no runs; `--cache DIR` or DRIL_PIPE_CACHE names another cache")
    } else if known.iter().any(|id| pattern.means_id(id)) {
        error.hint("`dril-pipe runs` lists the runs, `dril-pipe status FILE` the stages of a pipeline")
    } else if of_it.is_empty() {
        error.hint(suggest::hint(name, "the stages of runs", names))
    } else {
        error.hint(format!("its instances in runs are {}", suggest::list(&of_it)))
    }
}
