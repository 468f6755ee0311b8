//! `dril-pipe cache push`, `pull` and `remote-status`: results between this store and a shared cache.

use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use dril_stage_api::Registry;
use serde_json::{Value, json};

use crate::cli::args::TransferArgs;
use crate::cli::commands::inspect::size;
use crate::cli::pipeline;
use crate::cli::shared::{self, Shared};
use crate::cli::terminal::{count, print, print_error, printable};
use crate::error::{Error, ErrorKind, exit_codes};
use crate::plan::{self, Plan, Verdict};
use crate::remote::{Compared, Difference, Problem, Pushed};
use crate::store::{Key, Store};

pub(super) fn push(args: &TransferArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let (store, shared) = open(args)?;
    if shared.remote.is_read_only() {
        let text = format!("`{}` can only be read", shared.url);
        return Err(Error::new(ErrorKind::Usage, text).hint("give results to `s3://…` or `file://…`"));
    }
    let (keys, not_made) = keys_here(args, registry, &store)?;
    let pushed = shared.remote.push(&store, &keys, &AtomicBool::new(false), &|| {});
    if args.json {
        let json = json!({
            "remote": shared.url, "new": pushed.new, "known": pushed.known, "contents": pushed.contents,
            "bytes": pushed.bytes, "not_made": not_made, "different": differences(&pushed.different),
            "failed": problems(&pushed.failed), "given_up": pushed.given_up,
        });
        print(&format!("{json:#}\n"))?;
    } else {
        print(&pushed_text(&shared.url, &pushed, not_made))?;
    }
    Ok(report(&shared.url, &pushed.different, &pushed.failed, pushed.given_up.as_deref(), "did not give"))
}

fn pushed_text(url: &str, pushed: &Pushed, not_made: usize) -> String {
    let (new, contents) = (count(pushed.new, "result"), count(pushed.contents, "content"));
    let mut text = format!("gave {new} and {contents}, {}, to {}", size(pushed.bytes), printable(url));
    if pushed.known > 0 {
        text += &format!("; {} were there already", pushed.known);
    }
    if not_made > 0 {
        text += &format!("; {} not made yet", count(not_made, "stage"));
    }
    text + "\n"
}

pub(super) fn pull(args: &TransferArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let (store, shared) = open(args)?;
    // Results of the pipeline that are here are not asked for.
    let mut before = 0;
    let pulled = match args.pipeline() {
        Some(pipeline) => {
            let source = pipeline::source(&pipeline);
            let graph = source.load(registry)?;
            let plan = || plan::plan(&graph, &store, &source.base()).map_err(Error::from);
            let (plan, taken) = shared::take(&shared, &store, &AtomicBool::new(false), plan)?;
            before = keys_of(&plan).0.len().saturating_sub(taken.results());
            taken.pulled
        }
        None => {
            let keys = shared.remote.keys().map_err(|error| Error::new(ErrorKind::Io, error))?;
            vec![shared.remote.pull(&store, &keys, &AtomicBool::new(false), &|| {})?]
        }
    };
    let sum = |what: fn(&crate::remote::Pulled) -> usize| pulled.iter().map(what).sum::<usize>();
    let (new, absent) = (sum(|it| it.new.len()), sum(|it| it.absent));
    let known = before.max(sum(|it| it.known));
    let (contents, bytes) = (sum(|it| it.contents), pulled.iter().map(|it| it.bytes).sum::<u64>());
    let refused: Vec<Problem> = pulled.iter().flat_map(|it| it.refused.clone()).collect();
    let given_up = shared.remote.given_up();
    if args.json {
        let json = json!({
            "remote": shared.url, "new": new, "known": known, "absent": absent, "contents": contents,
            "bytes": bytes, "refused": problems(&refused), "given_up": given_up,
        });
        print(&format!("{json:#}\n"))?;
    } else {
        let (results, contents) = (count(new, "result"), count(contents, "content"));
        let mut text =
            format!("took {results} and {contents}, {}, from {}", size(bytes), printable(&shared.url));
        if known > 0 {
            text += &format!("; {known} were here already");
        }
        if absent > 0 {
            text += &format!("; {absent} are not there");
        }
        print(&(text + "\n"))?;
    }
    Ok(report(&shared.url, &[], &refused, given_up.as_deref(), "did not take"))
}

pub(super) fn status(args: &TransferArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let (store, shared) = open(args)?;
    let (keys, not_made) = keys_here(args, registry, &store)?;
    // Only to say how many there are in all; a plain HTTP server cannot tell.
    let all = match shared.remote.is_read_only() {
        true => None,
        false => Some(shared.remote.keys().map_err(|error| Error::new(ErrorKind::Io, error))?.len()),
    };
    let compared = shared.remote.compare(&store, &keys);
    if args.json {
        let keys = |keys: &[Key]| keys.iter().map(Key::hex).collect::<Vec<_>>();
        let json = json!({
            "remote": shared.url, "results": all, "there": keys(&compared.there),
            "absent": keys(&compared.absent), "not_made": not_made,
            "different": differences(&compared.different), "refused": problems(&compared.refused),
            "given_up": compared.given_up,
        });
        print(&format!("{json:#}\n"))?;
    } else {
        print(&status_text(&shared.url, all, &compared, not_made))?;
    }
    let Compared { different, refused, given_up, .. } = &compared;
    Ok(report(&shared.url, different, refused, given_up.as_deref(), "cannot use"))
}

fn status_text(url: &str, all: Option<usize>, compared: &Compared, not_made: usize) -> String {
    let (there, absent) = (compared.there.len(), compared.absent.len());
    let mut text = printable(url);
    if let Some(all) = all {
        text += &format!(": {}", count(all, "result"));
    }
    text += &format!("\nof {} here, {there} there and {absent} not", count(there + absent, "result"));
    if not_made > 0 {
        text += &format!("; {} not made yet", count(not_made, "stage"));
    }
    text + "\n"
}

fn open(args: &TransferArgs) -> Result<(Store, Shared), Error> {
    let store = pipeline::store(&args.store)?;
    let file = args.pipeline().map(|pipeline| pipeline.file);
    let shared = shared::need(args.remote.url.as_deref(), file.as_deref())?;
    Ok((store, shared))
}

/// The results here that are meant, and how many stages of the pipeline have none.
fn keys_here(args: &TransferArgs, registry: &Registry, store: &Store) -> Result<(Vec<Key>, usize), Error> {
    let Some(pipeline) = args.pipeline() else {
        let keys: Vec<Key> = store.records()?.into_iter().map(|(key, _)| key).collect();
        return Ok((keys, 0));
    };
    let source = pipeline::source(&pipeline);
    let graph = source.load(registry)?;
    let plan = plan::plan(&graph, store, &source.base())?;
    Ok(keys_of(&plan))
}

/// The keys of a plan's results that are here, and how many stages have none.
fn keys_of(plan: &Plan<'_>) -> (Vec<Key>, usize) {
    let cached = plan.steps.iter().filter_map(|(_, verdict)| match verdict {
        Verdict::Cached { key, .. } => Some(*key),
        _ => None,
    });
    let mut keys: Vec<Key> = cached.collect();
    let not_made = plan.steps.len() - keys.len();
    keys.sort_unstable();
    keys.dedup();
    (keys, not_made)
}

fn differences(different: &[Difference]) -> Vec<Value> {
    let json = |it: &Difference| {
        json!({
            "key": it.key.hex(), "stage": it.stage, "output": it.output, "here": it.here, "there": it.there,
        })
    };
    different.iter().map(json).collect()
}

fn problems(problems: &[Problem]) -> Vec<Value> {
    problems.iter().map(|problem| json!({ "key": problem.key.hex(), "why": problem.why })).collect()
}

/// Prints what went wrong; the exit code.
fn report(
    url: &str,
    different: &[Difference],
    failed: &[Problem],
    given_up: Option<&str>,
    did_not: &str,
) -> ExitCode {
    for difference in different {
        print_error(&format!("error: {}\n", printable(&difference.to_string())));
    }
    for Problem { key, why } in failed {
        print_error(&format!("error: {did_not} the result {}: {}\n", key.short(), printable(why)));
    }
    if let Some(why) = given_up {
        let hint = "what was transferred stays; the same command continues from there";
        let (url, why) = (printable(url), printable(why));
        print_error(&format!("error: `{url}` does not answer: {why}\n  = hint: {hint}\n"));
        return ExitCode::from(exit_codes::IO);
    }
    let fine = different.is_empty() && failed.is_empty();
    ExitCode::from(if fine { exit_codes::OK } else { exit_codes::CHECK_FAILED })
}
