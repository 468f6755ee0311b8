//! `ro-crate-metadata.json`: contents and provenance of the archive.
//!
//! Follows RO-Crate 1.1, the profiles Process Run Crate 0.5 and Workflow Run Crate 0.5 (researchobject.org/workflow-run-crate)
//! and Workflow RO-Crate 1.0: the pipeline file is the main entity, the run a `CreateAction` with it as instrument, and
//! every stage a `CreateAction` with its kind as instrument, its inputs as objects and its outputs as results.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde_json::{Value, json};

use super::BLOBS;
use crate::store::run::civil;
use crate::store::{Digest, Key, PastRun, Record};

/// The profiles that the archive conforms to, with name and version.
const PROFILES: [(&str, &str, &str); 3] = [
    ("https://w3id.org/ro/wfrun/process/0.5", "Process Run Crate", "0.5"),
    ("https://w3id.org/ro/wfrun/workflow/0.5", "Workflow Run Crate", "0.5"),
    ("https://w3id.org/workflowhub/workflow-ro-crate/1.0", "Workflow RO-Crate", "1.0"),
];

/// The profile of the pipeline file.
const WORKFLOW: (&str, &str, &str) = (
    "https://bioschemas.org/profiles/ComputationalWorkflow/1.0-RELEASE",
    "Bioschemas ComputationalWorkflow",
    "1.0-RELEASE",
);

/// The name of a pipeline file that includes no other.
const ALONE: &str = "pipeline.yaml";

/// True for a relative path that does not leave its folder.
fn stays_inside(path: &str) -> bool {
    !path.contains('\\') && Path::new(path).components().all(|part| matches!(part, Component::Normal(_)))
}

/// The contents of the archive.
pub(super) struct Crate<'a> {
    pub run: &'a PastRun,
    pub records: &'a BTreeMap<Key, Record>,
    pub blobs: &'a BTreeMap<Digest, u64>,
    pub logs: &'a BTreeSet<PathBuf>,
}

impl Crate<'_> {
    /// The pipeline file and those that it includes, with their names in the archive and their texts, the file itself first; none
    /// where the run's manifest has no text.
    pub fn pipeline(&self) -> Vec<(String, &str)> {
        let manifest = &self.run.manifest;
        let Some(main) = manifest["source"].as_str() else { return Vec::new() };
        let Some(parts) = manifest["parts"].as_object() else { return vec![(ALONE.to_owned(), main)] };
        let path = manifest["source_path"].as_str().filter(|path| stays_inside(path));
        let parts = parts.iter().filter_map(|(path, text)| Some((path.as_str(), text.as_str()?)));
        let parts =
            parts.filter(|(path, _)| stays_inside(path) && Some(*path) != manifest["source_path"].as_str());
        let all = std::iter::once((path.unwrap_or(ALONE), main)).chain(parts);
        all.map(|(path, text)| (format!("pipeline/{path}"), text)).collect()
    }

    /// The name of the pipeline file in the archive.
    fn main(&self) -> Option<String> {
        self.pipeline().into_iter().next().map(|(name, _)| name)
    }
}

/// The JSON-LD document.
pub(super) fn describe(all: &Crate<'_>) -> Value {
    let mut graph = vec![descriptor(), root(all)];
    for (id, name, version) in PROFILES {
        graph.push(json!({ "@id": id, "@type": "CreativeWork", "name": name, "version": version }));
    }
    graph.extend(workflow(all));
    graph.push(engine(all));
    graph.push(whole_run(all));
    graph.extend(kinds(all));
    for (key, record) in all.records {
        graph.push(action(all, key, record));
        graph.extend(parameters(key, record));
    }
    graph.extend(files(all));
    json!({
        "@context": ["https://w3id.org/ro/crate/1.1/context", "https://w3id.org/ro/terms/workflow-run/context"],
        "@graph": graph,
    })
}

/// References to entities: one alone, several as a list.
fn ids(ids: impl IntoIterator<Item = String>) -> Value {
    let mut all: Vec<Value> = ids.into_iter().map(|id| json!({ "@id": id })).collect();
    if all.len() == 1 { all.remove(0) } else { Value::Array(all) }
}

fn descriptor() -> Value {
    json!({
        "@id": "ro-crate-metadata.json", "@type": "CreativeWork", "about": { "@id": "./" },
        "conformsTo": ids(["https://w3id.org/ro/crate/1.1", PROFILES[2].0].map(str::to_owned)),
    })
}

fn root(all: &Crate<'_>) -> Value {
    let run = all.run;
    let mut parts: Vec<String> = all.pipeline().into_iter().map(|(name, _)| name).collect();
    parts.extend(["run/run.json", "run/events.jsonl"].map(str::to_owned));
    parts.extend(all.blobs.keys().map(blob));
    parts.extend(all.records.keys().map(|key| format!("records/{key}.json")));
    parts.extend(all.logs.iter().map(|path| log(path)));
    let mentions = std::iter::once("#run".to_owned()).chain(all.records.keys().map(action_id));
    let mut root = json!({
        "@id": "./", "@type": "Dataset",
        "name": format!("{}, profile {}: run {}", run.pipeline, run.profile, run.id),
        "description": "One run of an experiment pipeline: its results, what they were made from, and how.",
        "datePublished": iso(run.began),
        "license": "The results are under the licence of those who made them.",
        "conformsTo": ids(PROFILES.map(|(id, _, _)| id.to_owned())),
        "hasPart": ids(parts), "mentions": ids(mentions),
    });
    if let Some(main) = all.main() {
        root["mainEntity"] = json!({ "@id": main });
    }
    root
}

fn workflow(all: &Crate<'_>) -> Vec<Value> {
    let files = all.pipeline();
    let Some(((main, text), parts)) = files.split_first() else { return Vec::new() };
    let version = |text: &str| format!("blake3:{}", Digest::of(text.as_bytes()));
    let mut workflow = json!({
        "@id": main, "@type": ["File", "SoftwareSourceCode", "ComputationalWorkflow"],
        "name": all.run.pipeline, "programmingLanguage": { "@id": "#dril-pipe-yaml" },
        "encodingFormat": "application/yaml", "version": version(text), "conformsTo": { "@id": WORKFLOW.0 },
    });
    if !parts.is_empty() {
        workflow["hasPart"] = ids(parts.iter().map(|(name, _)| name.clone()));
    }
    let included = parts.iter().map(|(name, text)| {
        json!({
            "@id": name, "@type": ["File", "SoftwareSourceCode"], "name": name,
            "programmingLanguage": { "@id": "#dril-pipe-yaml" }, "encodingFormat": "application/yaml",
            "version": version(text),
        })
    });
    let mut all = vec![
        workflow,
        json!({ "@id": WORKFLOW.0, "@type": "CreativeWork", "name": WORKFLOW.1, "version": WORKFLOW.2 }),
        json!({
            "@id": "#dril-pipe-yaml", "@type": "ComputerLanguage", "name": "dril-pipe pipeline file",
            "encodingFormat": "application/yaml",
        }),
    ];
    all.extend(included);
    all
}

fn engine(all: &Crate<'_>) -> Value {
    let version = all.run.manifest["fingerprint"]["tool"].as_str().unwrap_or_default();
    json!({ "@id": "#engine", "@type": "SoftwareApplication", "name": "dril-pipe", "softwareVersion": version })
}

fn whole_run(all: &Crate<'_>) -> Value {
    let run = all.run;
    let made: BTreeSet<Digest> = all.records.values().flat_map(outputs).collect();
    let read: BTreeSet<Digest> =
        all.records.values().flat_map(inputs).filter(|digest| !made.contains(digest)).collect();
    let mut action = json!({
        "@id": "#run", "@type": "CreateAction", "name": format!("run {}", run.id),
        "description": format!("the run of all stages of {}, profile {}", run.pipeline, run.profile),
        "startTime": iso(run.began),
        "instrument": { "@id": all.main().unwrap_or_else(|| "#engine".to_owned()) },
        "object": ids(read.iter().map(|digest| at(all, digest))), "result": ids(made.iter().map(blob)),
    });
    if let Some(end) = run.end {
        action["endTime"] = json!(iso(run.time(end.seconds)));
        let done = end.failed + end.skipped + end.stopped == 0;
        let status = if done { "CompletedActionStatus" } else { "FailedActionStatus" };
        action["actionStatus"] = json!(format!("http://schema.org/{status}"));
    }
    action
}

fn kinds(all: &Crate<'_>) -> Vec<Value> {
    let kinds: BTreeSet<(&str, u32)> =
        all.records.values().map(|record| (record.kind.as_str(), record.revision)).collect();
    let kind = |(name, revision): (&str, u32)| {
        json!({
            "@id": kind_id(name, revision), "@type": "SoftwareApplication", "name": format!("stage kind {name}"),
            "softwareVersion": revision.to_string(), "isPartOf": { "@id": "#engine" },
        })
    };
    kinds.into_iter().map(kind).collect()
}

fn action(all: &Crate<'_>, key: &Key, record: &Record) -> Value {
    let read = inputs(record).map(|digest| at(all, &digest));
    let params =
        parameters(key, record).into_iter().filter_map(|param| param["@id"].as_str().map(str::to_owned));
    let mut action = json!({
        "@id": action_id(key), "@type": "CreateAction", "name": record.stage,
        "instrument": { "@id": kind_id(&record.kind, record.revision) },
        "object": ids(read.chain(params).collect::<BTreeSet<_>>()),
        "result": ids(outputs(record).map(|digest| blob(&digest)).collect::<BTreeSet<_>>()),
        "actionStatus": "http://schema.org/CompletedActionStatus",
        "description": format!("key {key}, took {:.3} s on {}", record.seconds, record.fingerprint.platform),
    });
    // A cached result was built by an earlier run, whose clock is not known here.
    if let Some(stage) =
        all.run.stages.values().find(|stage| stage.key == Some(*key) && stage.seconds.is_some())
    {
        let (end, took) = (all.run.time(stage.at), stage.seconds.unwrap_or_default());
        action["startTime"] = json!(iso(all.run.time((stage.at - took).max(0.0))));
        action["endTime"] = json!(iso(end));
    }
    action
}

fn parameters(key: &Key, record: &Record) -> Vec<Value> {
    let fields = record.params.as_object().into_iter().flatten();
    let value = |value: &Value| match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    let seed = record.seed.map(|seed| ("seed".to_owned(), seed.to_string()));
    let all = fields.map(|(name, param)| (name.clone(), value(param))).chain(seed);
    all.map(|(name, value)| {
        json!({
            "@id": format!("#param-{}-{name}", key.short()), "@type": "PropertyValue", "name": name, "value": value,
        })
    })
    .collect()
}

fn files(all: &Crate<'_>) -> Vec<Value> {
    let mut names: BTreeMap<Digest, (String, String)> = BTreeMap::new();
    for record in all.records.values() {
        for item in record.inputs.iter().flat_map(|input| &input.items) {
            names.entry(item.digest).or_insert_with(|| (item.from.clone(), String::new()));
        }
        for (name, stored) in &record.outputs {
            names.insert(stored.digest, (format!("{}.{name}", record.stage), stored.extension.clone()));
        }
    }
    let mut files = Vec::new();
    for (digest, (name, extension)) in names {
        let mut file = json!({ "@id": at(all, &digest), "@type": "File", "name": name, "identifier": format!("blake3:{digest}") });
        if let Some(bytes) = all.blobs.get(&digest) {
            file["contentSize"] = json!(bytes.to_string());
        }
        if !extension.is_empty() {
            file["encodingFormat"] = json!(media_type(&extension));
        }
        files.push(file);
    }
    let note = |name: &str, kind: &str| json!({ "@id": name, "@type": "File", "encodingFormat": kind, "name": name });
    files.push(note("run/run.json", "application/json"));
    files.push(note("run/events.jsonl", "application/jsonl"));
    files.extend(all.records.keys().map(|key| note(&format!("records/{key}.json"), "application/json")));
    files.extend(all.logs.iter().map(|path| note(&log(path), "text/plain")));
    files
}

fn media_type(extension: &str) -> &str {
    match extension {
        "csv" => "text/csv",
        "md" => "text/markdown",
        "txt" => "text/plain",
        "json" => "application/json",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        _ => "application/octet-stream",
    }
}

fn inputs(record: &Record) -> impl Iterator<Item = Digest> {
    record.inputs.iter().flat_map(|input| &input.items).map(|item| item.digest)
}

fn outputs(record: &Record) -> impl Iterator<Item = Digest> {
    record.outputs.values().map(|stored| stored.digest)
}

/// A blob: its entry in the archive, or an identifier for one that is not in it.
fn at(all: &Crate<'_>, digest: &Digest) -> String {
    if all.blobs.contains_key(digest) { blob(digest) } else { format!("#blake3-{digest}") }
}

fn blob(digest: &Digest) -> String {
    format!("{BLOBS}{digest}")
}

fn log(path: &Path) -> String {
    format!("logs/{}", path.file_name().unwrap_or_default().to_string_lossy())
}

fn action_id(key: &Key) -> String {
    format!("#action-{key}")
}

fn kind_id(name: &str, revision: u32) -> String {
    format!("#kind-{name}-{revision}")
}

/// A time as `2026-11-22T03:45:12+00:00`.
fn iso(time: SystemTime) -> String {
    let seconds = time.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    let (year, month, day) = civil(seconds / 86_400);
    let (hour, minute, second) = (seconds / 3600 % 24, seconds / 60 % 60, seconds % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}+00:00")
}
