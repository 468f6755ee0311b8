//! The other side of `report --against`: an earlier run of the cache or an archive of `cache export`, as plain data. It has the
//! stages whose results exist, by the names that they had in that run: a record has the name of the first stage that made it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use dril_stage_api::Registry;
use dril_stage_api::outcome::{OutputOutcome, PipelineOutcome, StageOutcome, State};

use crate::cli::commands::inspect::pick_run;
use crate::error::{Error, ErrorKind};
use crate::fsx;
use crate::plan::key_of_record;
use crate::store::{ArchivedRun, Key, Record, Store};

/// What the pipeline is compared with; the folder into which an archive is unpacked is removed with this value.
pub(super) struct Other {
    /// Its name in the report.
    pub(super) name: String,
    pub(super) outcome: PipelineOutcome,
    _unpacked: Option<Unpacked>,
}

impl Other {
    /// The run or archive that `word` names.
    ///
    /// # Errors
    /// There is none, or the archive cannot be read.
    pub(super) fn load(word: &str, store: &Store, registry: &Registry) -> Result<Self, Error> {
        let file = Path::new(word);
        if matches!(fsx::entry(file)?, Some(fsx::Entry::File(_))) {
            return Self::of_archive(file, registry);
        }
        let run = store.past_run(&pick_run(store, word)?)?;
        let mut stages = Vec::new();
        for (id, stage) in &run.stages {
            if let Some(key) = &stage.key
                && let Some(record) = store.record(key)?
            {
                stages.push(done(id, key, &record, store, registry));
            }
        }
        let outcome = outcome(run.pipeline, run.profile, stages);
        Ok(Self { name: run.id, outcome, _unpacked: None })
    }

    fn of_archive(file: &Path, registry: &Registry) -> Result<Self, Error> {
        let unpacked = Unpacked::new()?;
        let store = Store::open(&unpacked.0)?;
        let imported = store.import_archive(file, |record| key_of_record(record).ok())?;
        if let Some(refusal) = imported.refused.first() {
            let text = format!("`{}` is damaged: `{}`: {}", file.display(), refusal.name, refusal.why);
            return Err(Error::new(ErrorKind::Io, text).hint("export the run again"));
        }
        let run = ArchivedRun::read(file)?;
        let records: BTreeMap<Key, Record> = store.records()?.into_iter().collect();
        let named: BTreeSet<Key> = run.keys.values().copied().collect();
        let unnamed = records.iter().filter(|(key, _)| !named.contains(*key));
        let all = run.keys.iter().filter_map(|(id, key)| Some((id.as_str(), key, records.get(key)?)));
        let all = all.chain(unnamed.map(|(key, record)| (record.stage.as_str(), key, record)));
        let stages = all.map(|(id, key, record)| done(id, key, record, &store, registry)).collect();
        let profile = if run.profile.is_empty() { "of the archive".to_owned() } else { run.profile };
        let outcome = outcome(run.pipeline, profile, stages);
        let name = file.file_name().map_or_else(|| file.to_owned(), PathBuf::from).display().to_string();
        Ok(Self { name, outcome, _unpacked: Some(unpacked) })
    }
}

/// A folder for the contents of an archive, removed on drop.
struct Unpacked(PathBuf);

impl Unpacked {
    fn new() -> Result<Self, Error> {
        let folder = std::env::temp_dir().join(format!("dril-pipe-against-{}", std::process::id()));
        fsx::create_dir_all(&folder)?;
        Ok(Self(folder))
    }
}

impl Drop for Unpacked {
    fn drop(&mut self) {
        // If this fails, the folder stays among the temporary files.
        let _ = fsx::remove_dir_all(&self.0);
    }
}

fn outcome(pipeline: String, profile: String, stages: Vec<StageOutcome>) -> PipelineOutcome {
    PipelineOutcome {
        pipeline,
        profile,
        first_profile: None,
        command: Vec::new(),
        tool: String::new(),
        stages,
    }
}

/// A stage with a result in the store.
fn done(id: &str, key: &Key, record: &Record, store: &Store, registry: &Registry) -> StageOutcome {
    let (name, labels) = parts(id);
    StageOutcome {
        name: name.to_owned(),
        id: id.to_owned(),
        labels,
        kind: record.kind.clone(),
        revision: record.revision,
        params: record.params.clone(),
        chosen: BTreeMap::new(),
        seed: record.seed,
        state: State::Done,
        key: Some(key.hex()),
        inputs: Vec::new(),
        outputs: outputs(record, store, registry),
        seconds: Some(record.seconds),
        made_with: BTreeMap::new(),
    }
}

/// The outputs with known types: those of kinds that this program has.
fn outputs(record: &Record, store: &Store, registry: &Registry) -> Vec<OutputOutcome> {
    let ports = registry.get(&record.kind).and_then(|kind| kind.ports(&record.params).ok());
    let output = |port: &dril_stage_api::Output| {
        let stored = record.outputs.get(port.name).filter(|stored| !stored.folder)?;
        Some(OutputOutcome {
            name: port.name.to_owned(),
            artifact: port.artifact,
            extension: port.extension.to_owned(),
            digest: stored.digest.hex(),
            bytes: stored.bytes,
            path: store.blob_path(&stored.digest),
            file: None,
        })
    };
    ports.iter().flat_map(|ports| &ports.outputs).filter_map(output).collect()
}

/// Name and coordinates of an instance, `clone[policy=beta, demonstrations=1]`.
fn parts(id: &str) -> (&str, Vec<(String, String)>) {
    let Some((name, rest)) = id.split_once('[') else { return (id, Vec::new()) };
    let pair = |text: &str| text.split_once('=').map(|(axis, value)| (axis.to_owned(), value.to_owned()));
    (name, rest.trim_end_matches(']').split(", ").filter_map(pair).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_instance_is_its_name_and_its_coordinates() {
        let (name, labels) = parts("clone[policy=beta, demonstrations=1]");
        assert_eq!(name, "clone");
        let expected = [("policy", "beta"), ("demonstrations", "1")];
        assert_eq!(labels, expected.map(|(axis, value)| (axis.to_owned(), value.to_owned())));
        assert_eq!(parts("table"), ("table", Vec::new()));
    }
}
