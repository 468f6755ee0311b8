//! The node's side of a pilot: takes stages from a queue, one after the other, until there are none for a while, it is asked
//! to end, or its time is nearly over. It saves what a job of its own costs each stage: seconds of scheduling.

use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use dril_stage_api::Registry;

use super::handoff::Home;
use super::node::{Assigned, Interrupted, Node, report};
use super::queue::{Entry, Orders, PilotFolder, Queue};
use crate::fsx;

/// The argument that makes this program a pilot: `dril-pipe __pilot FOLDER`.
pub const PILOT: &str = "__pilot";

/// Pauses between two looks into an empty queue: short at first, since one result often makes the next stage ready.
const PAUSES: (Duration, Duration) = (Duration::from_millis(10), Duration::from_millis(500));

/// How often a network file system has to look again for what is in the queue.
const REFRESH: Duration = Duration::from_secs(1);

/// Runs a pilot to its end.
///
/// # Errors
/// Its files cannot be read or written. The scheduler then knows that the job failed, and the engine runs the stage elsewhere.
pub fn run_pilot(folder: &Path, assigned: &Assigned, registry: &Registry) -> Result<ExitCode, String> {
    let folder = PilotFolder(folder.to_owned());
    let name = rustix::system::uname().nodename().to_string_lossy().into_owned();
    work(&folder, assigned, registry)
        .map(|()| ExitCode::SUCCESS)
        .map_err(|error| format!("on node `{name}`: {error}"))
}

fn work(folder: &PilotFolder, assigned: &Assigned, registry: &Registry) -> fsx::Result<()> {
    // A job that was started again after its end has no folder, or finds the note.
    if folder.has_ended()? {
        return Ok(());
    }
    let Some(orders) = folder.orders()? else { return Ok(()) };
    fsx::write_atomic(&folder.0.join("job"), assigned.job.as_bytes())?;
    let pilots = folder.0.parent().unwrap_or(&folder.0);
    let queue = Queue::new(pilots, &orders.class);
    let node = Node::new(assigned, registry);
    if let Some(seconds) = orders.stop_after {
        node.stop_after(seconds);
    }
    // A job that was requeued finds the stage that it ran.
    for entry in folder.taken()? {
        run(&node, folder, &queue, &orders, &entry)?;
    }
    take_until_the_end(&node, folder, &queue, &orders)?;
    folder.end()?;
    // There may be no engine to do it.
    folder.remove()
}

fn take_until_the_end(
    node: &Node<'_>,
    folder: &PilotFolder,
    queue: &Queue,
    orders: &Orders,
) -> fsx::Result<()> {
    let idle = Duration::try_from_secs_f64(orders.idle).unwrap_or(Duration::MAX);
    let (mut since, mut pause, mut refreshed) = (Instant::now(), PAUSES.0, Instant::now());
    while !node.is_stopping() {
        let mut found = false;
        if refreshed.elapsed() >= REFRESH {
            refreshed = Instant::now();
            queue.refresh();
        }
        // A listing is used up before the next one: with thousands of stages it is expensive.
        for entry in queue.list()? {
            if node.is_stopping() {
                break;
            }
            if folder.take(queue, &entry)? {
                found = true;
                run(node, folder, queue, orders, &entry)?;
            }
        }
        if found {
            (since, pause) = (Instant::now(), PAUSES.0);
        } else if since.elapsed() >= idle || folder.shall_end()? || folder.orders()?.is_none() {
            // Without its orders it was retired.
            break;
        } else {
            std::thread::sleep(pause);
            pause = (pause + pause / 8).min(PAUSES.1);
        }
    }
    Ok(())
}

/// Runs a stage that was taken.
fn run(
    node: &Node<'_>,
    folder: &PilotFolder,
    queue: &Queue,
    orders: &Orders,
    entry: &Entry,
) -> fsx::Result<()> {
    let home = Home::new(orders.jobs.join(entry.key()));
    // Its engine has given it up.
    if home.handoff()?.is_none() {
        return folder.finish(entry);
    }
    match node.run(&home) {
        Ok(Some(ended)) => {
            report(&home, &ended)?;
            folder.finish(entry)
        }
        Ok(None) => folder.finish(entry),
        // The job was preempted or cancelled, and the stage stopped: another pilot may continue it at once.
        Err(Interrupted) => {
            home.release()?;
            folder.give_back(queue, entry)
        }
    }
}
