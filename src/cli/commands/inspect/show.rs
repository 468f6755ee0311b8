//! `dril-pipe show`: key, parameters, outputs and provenance of a stage, up to the roots.

use std::fmt::Write as _;
use std::process::ExitCode;

use dril_stage_api::Registry;
use serde_json::{Value, json};

use super::{age, epoch, pick_stages, seconds, size};
use crate::cli::args::ShowArgs;
use crate::cli::terminal::{Style, Terminal, cut, print, printable, shown};
use crate::cli::{columns, pipeline};
use crate::error::Error;
use crate::plan::{self, Plan, Verdict};
use crate::resolve::{Origin, StageIndex};
use crate::store::{Digest, Key, Record, Store};

/// Longer values are cut; `--json` has them in full.
const LONGEST_VALUE: usize = 100;
/// The number of upstream stages that are listed; `--json` has all.
const MOST_ROOTS: usize = 60;

pub(in crate::cli) fn main(args: &ShowArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let graph = pipeline::source(&args.look.pipeline).load(registry)?;
    let store = pipeline::store(&args.look.store)?;
    let picked = pick_stages(&graph, &args.look.stages)?;
    let plan = plan::plan(&graph, &store, &pipeline::source(&args.look.pipeline).base())?;
    let viewer = Viewer { plan: &plan, store: &store, terminal: Terminal::stdout() };
    if args.look.json {
        let all = picked.iter().map(|stage| viewer.json(*stage)).collect::<Result<Vec<_>, _>>()?;
        print(&format!("{:#}\n", Value::Array(all)))?;
    } else {
        let pages = picked.iter().map(|stage| viewer.page(*stage)).collect::<Result<Vec<_>, _>>()?;
        print(&pages.join("\n"))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// An artifact that a stage reads.
struct InputSource {
    port: &'static str,
    from: String,
    digest: Option<Digest>,
}

struct Viewer<'a> {
    plan: &'a Plan<'a>,
    store: &'a Store,
    terminal: Terminal,
}

impl Viewer<'_> {
    fn key(&self, stage: StageIndex) -> (&'static str, Option<Key>) {
        match self.plan.verdict(stage) {
            Some(Verdict::Cached { key, .. }) => ("up to date", Some(*key)),
            Some(Verdict::Run { key, .. }) => ("not built yet", Some(*key)),
            _ => ("not built yet, and its inputs are not known yet", None),
        }
    }

    fn record(&self, stage: StageIndex) -> Result<Option<Record>, Error> {
        match self.plan.verdict(stage) {
            Some(Verdict::Cached { key, .. }) => Ok(self.store.record(key)?),
            _ => Ok(None),
        }
    }

    fn origins(&self, stage: StageIndex) -> Vec<InputSource> {
        let graph = self.plan.graph;
        let mut origins = Vec::new();
        for wire in &graph.stages[stage].inputs {
            for source in &wire.sources {
                let (from, digest) = match &source.from {
                    Origin::File { path, key, .. } => {
                        (format!("file {path}"), self.plan.files.get(key).map(|file| file.digest))
                    }
                    Origin::Stage { stage, output } => {
                        let digest = match self.plan.verdict(*stage) {
                            Some(Verdict::Cached { outputs, .. }) => {
                                outputs.get(*output).map(|stored| stored.digest)
                            }
                            _ => None,
                        };
                        (format!("{}.{output}", graph.stages[*stage].id), digest)
                    }
                };
                origins.push(InputSource { port: wire.port, from, digest });
            }
        }
        origins
    }

    fn page(&self, stage: StageIndex) -> Result<String, Error> {
        let node = &self.plan.graph.stages[stage];
        let (standing, key) = self.key(stage);
        let record = self.record(stage)?;
        let mut text = format!("{}: {standing}\n", self.terminal.paint(Style::Strong, &node.id));
        let seed = node.seed.map_or("not seeded".to_owned(), |seed| format!("seed {}", seed.0));
        let _ =
            writeln!(text, "  kind        {}, revision {}, {seed}", node.kind.name(), node.kind.revision());
        if let Some(key) = key {
            let _ = writeln!(text, "  key         {key}");
        }
        if let (Some(record), Some(key)) = (&record, key) {
            let made = self.store.made_at(&key)?.map(age).unwrap_or_default();
            let by = if record.stage == *node.id { String::new() } else { format!(" as `{}`", record.stage) };
            let print = &record.fingerprint;
            let made_by = format!("dril-pipe {} on {}", print.tool, print.platform);
            let _ = writeln!(
                text,
                "  built       {made}{by}, took {}, {}",
                seconds(record.seconds),
                printable(&made_by)
            );
        }
        text += &self.parameters(&node.params);
        text += &self.outputs(record.as_ref());
        text += &self.inputs(stage);
        text += &self.provenance(stage)?;
        Ok(text)
    }

    fn table(&self, title: &str, rows: &[Vec<String>]) -> String {
        if rows.is_empty() {
            return String::new();
        }
        let body = columns::render(rows, usize::MAX, &|_, cell| cell);
        let body: String = body.split_inclusive('\n').map(|line| format!("  {line}")).collect();
        format!("  {title}\n{body}")
    }

    fn parameters(&self, params: &Value) -> String {
        let rows = params.as_object().into_iter().flatten();
        let row = |(name, value): (&String, &Value)| {
            vec![name.clone(), cut(&printable(&value.to_string()), LONGEST_VALUE)]
        };
        self.table("parameters", &rows.map(row).collect::<Vec<_>>())
    }

    fn outputs(&self, record: Option<&Record>) -> String {
        let rows = record.iter().flat_map(|record| &record.outputs).map(|(name, stored)| {
            let path = shown(&self.store.blob_path(&stored.digest));
            vec![name.clone(), stored.digest.short(), size(stored.bytes), path]
        });
        self.table("outputs", &rows.collect::<Vec<_>>())
    }

    fn inputs(&self, stage: StageIndex) -> String {
        let rows = self.origins(stage).into_iter().map(|origin| {
            let digest = origin.digest.map_or("(not built yet)".to_owned(), |digest| digest.short());
            vec![origin.port.to_owned(), digest, printable(&origin.from)]
        });
        self.table("inputs", &rows.collect::<Vec<_>>())
    }

    /// All stages upstream, roots first.
    fn provenance(&self, stage: StageIndex) -> Result<String, Error> {
        let mut before = self.plan.roots_to(stage);
        before.retain(|index| *index != stage);
        let mut rows = Vec::new();
        for index in before.iter().take(MOST_ROOTS) {
            let node = &self.plan.graph.stages[*index];
            let (standing, key) = self.key(*index);
            let made = match (self.record(*index)?, key) {
                (Some(record), Some(key)) => {
                    let made = self.store.made_at(&key)?.map(age).unwrap_or_default();
                    format!("built {made}, took {}", seconds(record.seconds))
                }
                _ => standing.to_owned(),
            };
            let kind = format!("{} r{}", node.kind.name(), node.kind.revision());
            rows.push(vec![node.id.to_string(), kind, key.map(|key| key.short()).unwrap_or_default(), made]);
        }
        let mut text = self.table("upstream, roots first", &rows);
        if let Some(more) = before.len().checked_sub(MOST_ROOTS).filter(|more| *more > 0) {
            let _ = writeln!(text, "    and {more} more; `--json` lists all");
        }
        let mut files = Vec::new();
        for index in self.plan.roots_to(stage) {
            for origin in self.origins(index).into_iter().filter(|origin| origin.from.starts_with("file ")) {
                let row = vec![
                    printable(origin.from.trim_start_matches("file ")),
                    origin.digest.map(|digest| digest.short()).unwrap_or_default(),
                ];
                if !files.contains(&row) {
                    files.push(row);
                }
            }
        }
        Ok(text + &self.table("files from outside", &files))
    }

    fn json(&self, stage: StageIndex) -> Result<Value, Error> {
        let mut json = self.entry(stage)?;
        let before = self.plan.roots_to(stage).into_iter().filter(|index| *index != stage);
        json["provenance"] = before.map(|index| self.entry(index)).collect::<Result<Vec<_>, _>>()?.into();
        Ok(json)
    }

    fn entry(&self, stage: StageIndex) -> Result<Value, Error> {
        let node = &self.plan.graph.stages[stage];
        let (_, key) = self.key(stage);
        let record = self.record(stage)?;
        let inputs = self.origins(stage).into_iter();
        let inputs: Vec<Value> = inputs
            .map(|origin| json!({ "port": origin.port, "from": origin.from, "digest": origin.digest }))
            .collect();
        let mut json = json!({
            "stage": *node.id, "kind": node.kind.name(), "revision": node.kind.revision(),
            "seed": node.seed.map(|seed| seed.0), "params": node.params, "key": key, "made": record.is_some(),
            "inputs": inputs,
        });
        if let (Some(record), Some(key)) = (record, key) {
            let path = |digest: &Digest| self.store.blob_path(digest).to_string_lossy().into_owned();
            let outputs = record.outputs.iter().map(|(name, stored)| {
                json!({
                    "output": name, "digest": stored.digest, "bytes": stored.bytes, "path": path(&stored.digest),
                })
            });
            json["outputs"] = outputs.collect::<Vec<_>>().into();
            json["seconds"] = json!(record.seconds);
            json["made_as"] = json!(record.stage);
            json["made_at"] = json!(self.store.made_at(&key)?.map(epoch));
            json["fingerprint"] = json!(record.fingerprint);
        }
        Ok(json)
    }
}
