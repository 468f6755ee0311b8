//! `dril-pipe run`: brings every stage of a pipeline up to date and copies its results.

use std::process::ExitCode;
use std::time::{Duration, Instant};

use dril_stage_api::Registry;

use super::{page, plan, recheck};
use crate::cli::args::RunArgs;
use crate::cli::report::{self, Ending};
use crate::cli::shared::{Exchange, Taken};
use crate::cli::terminal::{Style, Terminal, count, duration, print, shown};
use crate::cli::{executor, giving, pipeline, resources, shared, signals, warnings};
use crate::error::{Error, ErrorKind, exit_codes};
use crate::exec::{Executed, Options};
use crate::session::{LockMode, UpToDate};

pub(in crate::cli) fn main(args: &RunArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let began = Instant::now();
    let settings = shared::settings(Some(&args.pipeline.file), Some(registry))?;
    let cluster = executor::cluster(&args.executor.executor, settings)?;
    let mut options = options(args, began, cluster.is_some())?;
    executor::adapt(&mut options, args, cluster.as_ref());
    let session = pipeline::session(&args.pipeline, &args.store, registry)?
        .selection(args.select.selection())
        .lock(lock_mode(args))
        .options(options.clone());
    let session = match &args.out {
        Some(folder) => session.results_folder(folder),
        None => session,
    };
    if !(args.check_determinism || args.json || args.dry_run)
        && let Some(found) = session.up_to_date()?
    {
        nothing_to_do(args, &found, began.elapsed())?;
        return Ok(ExitCode::SUCCESS);
    }
    let loaded = session.load()?;
    resources::warn_of_unused(&args.resources, loaded.resources());
    let warnings = warnings::show(&loaded);
    if args.dry_run {
        plan::show(&loaded.plan()?, warnings, session.store(), args.json)?;
        return Ok(ExitCode::SUCCESS);
    }
    let stop = signals::stop_flag()?;
    let shared =
        shared::open(args.remote.url.as_deref(), args.remote_mode.mode(), Some(&args.pipeline.file))?;
    let (plan, taken) = match shared.as_ref().filter(|shared| shared.mode.reads()) {
        Some(shared) => shared::take(shared, session.store(), &stop, || loaded.draft())?,
        None => (loaded.draft()?, Taken::default()),
    };
    loaded.check(&plan)?;
    let prepared = loaded.prepare(plan)?;
    let mut reporter = report::choose(args, loaded.graph(), began);
    reporter.planned(prepared.plan(), options.threads);
    let runner = executor::runner(args, cluster, session.store().root())?;
    let (finished, given) = giving::beside(shared.as_ref(), session.store(), &stop, |on_event| {
        prepared.execute(&*runner, &stop, &mut |event| {
            on_event(event);
            reporter.event(event);
        })
    });
    let (finished, exchange) = (finished?, Exchange { taken, given });
    // The work is done and in the store: its end is reported, even if copying the results failed.
    let error = finished.error.as_ref();
    let mut code = error.map_or_else(|| exit_code(&finished.executed), |error| error.kind().exit_code());
    let exchanged = shared.as_ref().map(|_| &exchange);
    reporter.ended(&Ending { finished: &finished, exchange: exchanged, exit_code: code });
    if let Some(shared) = &shared {
        exchange.warn(shared);
    }
    page::after_run(args, loaded.whole_graph(), session.store(), &finished.folder);
    if args.check_determinism && code == exit_codes::OK {
        drop(reporter);
        code = recheck::main(args, loaded.graph(), session.store(), &*runner, &options, &stop, began)?;
    }
    Ok(ExitCode::from(code))
}

fn lock_mode(args: &RunArgs) -> LockMode {
    match (args.lock, args.locked) {
        (true, _) => LockMode::Write,
        (_, true) => LockMode::Check,
        _ => LockMode::Update,
    }
}

fn options(args: &RunArgs, began: Instant, on_cluster: bool) -> Result<Options, Error> {
    // Stages run in folders of their own.
    let curves = args.tensorboard.as_ref().map(std::path::absolute).transpose().map_err(|error| {
        Error::new(ErrorKind::Io, format!("`--tensorboard`: cannot determine the current folder: {error}"))
    })?;
    let mut options = Options {
        checkpoint_seconds: args.checkpoint_every,
        curves,
        keep_going: !args.fail_fast,
        deadline: args.time.and_then(|time| began.checked_add(time)),
        resources: resources::units(&args.resources, on_cluster)?,
        ..Options::default()
    };
    if let Some(jobs) = args.jobs {
        options.threads = jobs.get();
    }
    Ok(options)
}

/// A stop outranks a failure: the run is not over, and the next one retries what failed anyway.
fn exit_code(executed: &Executed) -> u8 {
    let outcome = &executed.outcome;
    if outcome.is_complete() {
        exit_codes::OK
    } else if outcome.out_of_time {
        exit_codes::OUT_OF_TIME
    } else if outcome.stopped > 0 {
        exit_codes::INTERRUPTED
    } else {
        exit_codes::STAGE_FAILED
    }
}

/// Says what a planned run without work says, with the same warnings.
fn nothing_to_do(args: &RunArgs, found: &UpToDate, took: Duration) -> Result<(), Error> {
    resources::warn_of_unused(&args.resources, &found.resources);
    warnings::print(&found.warnings);
    if args.quiet {
        return Ok(());
    }
    let terminal = Terminal::stdout();
    let title = terminal.paint(Style::Strong, &format!("{}, profile {}", found.pipeline, found.profile));
    let stages = usize::try_from(found.stages).unwrap_or(usize::MAX);
    let nothing = terminal.paint(Style::Good, "nothing to do");
    let mut text = format!("{title}: {}, {stages} cached\n", count(stages, "stage"));
    text += &format!("{nothing}: 0 stages executed, all {stages} cached, in {}\n", duration(took));
    if let Some(folder) = &found.results {
        text += &format!("results: {} ({})\n", shown(folder), count(found.result_files, "file"));
    }
    print(&text)
}
