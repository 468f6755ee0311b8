//! The part of the measurement that needs two machines: one leads, the other attends. They communicate through files alone.
//!
//! Who attends creates `peer-…` and touches it; who leads finds it and writes the name of a folder into it. In that folder the two
//! answer each other: `ping-3` of the leader is answered by `pong-3`.

use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use super::{Check, FOLDER, Health, new_file, unique, unique_name};
use crate::fsx::{self, FsError, Result, clock, heartbeat, host};

/// How often each looks for what the other wrote.
const LOOK: Duration = Duration::from_millis(2);
/// How long an answer may take: network file systems show a new file after a minute at the latest.
const PATIENCE: Duration = Duration::from_secs(90);
/// How often one that attends touches its file; after five times that period it counts as gone.
const TOUCH: Duration = Duration::from_secs(1);
/// Answers that are measured, where they come quickly.
const ROUNDS: usize = 20;
/// Files that both try to create.
const RACES: usize = 100;
/// A delay that is felt.
const SLOW: Duration = Duration::from_secs(1);
/// Clocks that differ by more are not one clock.
const CLOCKS: Duration = Duration::from_secs(2);

/// How a process attended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Attended {
    /// It took part in a measurement, whose results the leader shows.
    Done,
    /// Nobody led one.
    Alone,
}

/// Takes part in a measurement of `folder` that begins on another machine within `patience`.
///
/// # Errors
/// Files cannot be written, or the leader does not answer any more.
pub fn attend(folder: &Path, patience: Duration) -> Result<Attended> {
    let place = folder.join(FOLDER);
    std::fs::metadata(folder).map_err(FsError::at("access", folder))?;
    fsx::create_dir_all(&place)?;
    let card = place.join(unique_name("peer"));
    fsx::write(&card, b"")?;
    let ended = answer(&place, &card, patience);
    let _ = std::fs::remove_file(&card);
    let _ = std::fs::remove_dir(&place);
    ended
}

fn answer(place: &Path, card: &Path, patience: Duration) -> Result<Attended> {
    let (began, mut touched) = (Instant::now(), Instant::now());
    let room = loop {
        if let Some(room) = line(card)? {
            break place.join(room);
        }
        if began.elapsed() > patience {
            return Ok(Attended::Alone);
        }
        if touched.elapsed() > TOUCH {
            touched = Instant::now();
            let _ = heartbeat::touch(card);
        }
        std::thread::sleep(LOOK * 10);
    };
    let mut round = 0;
    loop {
        let said = wait_for(&room.join(format!("ping-{round}")))?;
        // What was written before a file that is there must be there, too.
        let state = fsx::read_if_there(&room.join("state"))?.unwrap_or_default();
        let current = state == said.as_bytes();
        let answer = match said.as_str() {
            "race" => won(&room)?,
            "lock" => locked(&room).to_string(),
            _ => current.to_string(),
        };
        put(&room, &format!("pong-{round}"), &answer)?;
        if said == "end" {
            return Ok(Attended::Done);
        }
        round += 1;
    }
}

/// Leads a measurement with each process that attends; one check that says how to start one where there is none.
pub(super) fn lead(place: &Path) -> Result<Vec<Check>> {
    let now = clock::now(place);
    let mut checks = Vec::new();
    for card in fsx::list(place)? {
        let name = card.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_owned();
        let Some(peer) = name.strip_prefix("peer-") else { continue };
        let age =
            fsx::modified(&card)?.and_then(|touched| now.duration_since(touched).ok()).unwrap_or_default();
        if age > TOUCH * 5 {
            // It was killed.
            let _ = std::fs::remove_file(&card);
            continue;
        }
        let machine = peer.rsplitn(3, '-').last().unwrap_or(peer).to_owned();
        checks.extend(measure(place, &card, &machine)?);
    }
    if checks.is_empty() {
        let seen = "not measured: no other machine answers";
        let means = "run `dril-pipe cache doctor DIR --peer` on another machine first, then this again";
        checks.push(Check::new("peer", Health::Unknown, seen, means));
    }
    Ok(checks)
}

/// The leader's side.
struct Talk {
    room: PathBuf,
    round: usize,
}

/// What came back, and when.
struct Answer {
    said: String,
    took: Duration,
    /// The time of the file system for the question and for the answer.
    stamps: (SystemTime, SystemTime),
}

impl Talk {
    fn ask(&mut self, word: &str) -> Result<Answer> {
        fsx::overwrite(&self.room.join("state"), word.as_bytes())?;
        let (ping, pong) = (format!("ping-{}", self.round), self.room.join(format!("pong-{}", self.round)));
        self.round += 1;
        put(&self.room, &ping, word)?;
        let began = Instant::now();
        let said = wait_for(&pong)?;
        let took = began.elapsed();
        let stamp = |path: &Path| Ok::<_, FsError>(fsx::modified(path)?.unwrap_or(SystemTime::UNIX_EPOCH));
        Ok(Answer { said, took, stamps: (stamp(&self.room.join(ping))?, stamp(&pong)?) })
    }
}

fn measure(place: &Path, card: &Path, machine: &str) -> Result<Vec<Check>> {
    let room = unique_name("room");
    let mut talk = Talk { room: place.join(&room), round: 0 };
    fsx::create_dir(&talk.room)?;
    let room = room.to_string_lossy().into_owned();
    fsx::overwrite(card, format!("{room}\n").as_bytes())?;
    let checks = questions(&mut talk, machine);
    let _ = std::fs::remove_dir_all(&talk.room);
    checks
}

fn questions(talk: &mut Talk, machine: &str) -> Result<Vec<Check>> {
    let (mut delays, mut stale, mut offsets) = (Vec::new(), 0, Vec::new());
    let began = Instant::now();
    for round in 0..ROUNDS {
        let answer = talk.ask(&format!("round {round}"))?;
        stale += usize::from(answer.said != "true");
        offsets.push(offset(&answer));
        delays.push(answer.took);
        // Where each answer takes half a minute, a few are enough.
        if round > 0 && began.elapsed() > PATIENCE {
            break;
        }
    }
    delays.sort_unstable();
    let (middle, longest) = (delays[delays.len() / 2], delays[delays.len() - 1]);
    let health = if longest > SLOW { Health::Degraded } else { Health::Ok };
    let seen =
        format!("`{machine}` answers after {} ms, at most {} ms", middle.as_millis(), longest.as_millis());
    let means =
        "results of other machines become visible this late; see `acdirmin` and `lookupcache` in nfs(5)";
    let mut checks = vec![Check::new("visible", health, seen, means)];

    let health = if stale == 0 { Health::Ok } else { Health::Fails };
    let seen = format!("{} of {} changed files were read as they are", delays.len() - stale, delays.len());
    let means = "a machine may see an old file after a new one: do not share a store here";
    checks.push(Check::new("current", health, seen, means));

    // Half of the answers may be late, but none comes before its question.
    let apart = offsets.iter().copied().min().unwrap_or_default();
    let health = if apart > CLOCKS { Health::Fails } else { Health::Ok };
    let seen = match apart > CLOCKS {
        true => format!("files are stamped by clocks that differ by {:.1} s", apart.as_secs_f64()),
        false => "files of both machines are stamped by one clock".to_owned(),
    };
    let means = "engines on other machines could be taken for dead: synchronise the clocks, or do not share a store here";
    checks.push(Check::new("one clock", health, seen, means));
    checks.push(race(talk)?);
    checks.push(shared_lock(talk, machine)?);
    talk.ask("end")?;
    Ok(checks)
}

/// How far the stamps of question and answer are from what the time in between allows.
fn offset(answer: &Answer) -> Duration {
    match answer.stamps.1.duration_since(answer.stamps.0) {
        Ok(later) => later.saturating_sub(answer.took),
        Err(earlier) => earlier.duration(),
    }
}

/// Both create the same files at the same time.
fn race(talk: &mut Talk) -> Result<Check> {
    let room = talk.room.clone();
    let (here, there) = std::thread::scope(|scope| {
        let here = scope.spawn(move || won(&room));
        let there = talk.ask("race");
        (here.join().unwrap_or_else(|_| Ok(String::new())), there)
    });
    let (here, there) = (here?, there?.said);
    let mut all: Vec<usize> =
        [&here, &there].iter().flat_map(|won| won.split(' ')).filter_map(|name| name.parse().ok()).collect();
    all.sort_unstable();
    let health = if all.iter().copied().eq(0..RACES) { Health::Ok } else { Health::Fails };
    let seen = format!("{} of {RACES} files had one creator", unique(&all));
    let means = "two engines could build the same stage: do not share a store here";
    Ok(Check::new("create, both", health, seen, means))
}

/// Which of the files this process created, in an order that is the other one's backwards.
fn won(room: &Path) -> Result<String> {
    // Not empty, also where the other one was faster every time: an empty line is no answer.
    let mut won = vec!["won".to_owned()];
    for name in 0..RACES {
        let path = room.join(format!("race-{name}"));
        match new_file(&path) {
            Ok(_) => won.push(name.to_string()),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(FsError::at("make", &path)(error)),
        }
    }
    Ok(won.join(" "))
}

/// Kernel locks across machines, which nothing relies on.
fn shared_lock(talk: &mut Talk, machine: &str) -> Result<Check> {
    let path = talk.room.join("lock");
    let file = fsx::create(&path)?;
    let seen = match file.lock() {
        Err(_) => "there are no kernel locks",
        Ok(()) if talk.ask("lock")?.said == "true" => "kernel locks are seen by both machines",
        Ok(()) if machine == host::this().name => "the other process does not see kernel locks",
        Ok(()) => "kernel locks hold on one machine; leases do the rest",
    };
    Ok(Check::new("flock, both", Health::Ok, seen, ""))
}

/// True where another process has the lock.
fn locked(room: &Path) -> bool {
    let lock = fsx::open(&room.join("lock")).map(|file| file.try_lock().is_err());
    lock.unwrap_or(false)
}

/// Writes a line to a file that appears as a whole.
fn put(room: &Path, name: &str, said: &str) -> Result<()> {
    let draft = room.join(format!("{name}.new"));
    fsx::write(&draft, format!("{said}\n").as_bytes())?;
    fsx::rename(&draft, &room.join(name))
}

fn wait_for(path: &Path) -> Result<String> {
    let began = Instant::now();
    loop {
        if let Some(said) = line(path)? {
            return Ok(said);
        }
        if began.elapsed() > PATIENCE {
            let error = io::Error::new(io::ErrorKind::TimedOut, "the other process does not answer");
            return Err(FsError::at("read", path)(error));
        }
        std::thread::sleep(LOOK);
    }
}

/// The line in a file; `None` where there is no file or no whole line.
fn line(path: &Path) -> Result<Option<String>> {
    let text = fsx::read_if_there(path)?.and_then(|bytes| String::from_utf8(bytes).ok());
    Ok(text.and_then(|text| Some(text.strip_suffix('\n')?.to_owned())).filter(|text| !text.is_empty()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_that_wins_no_race_still_answers() {
        let room = tempfile::tempdir().unwrap();
        let (all, none) = (won(room.path()).unwrap(), won(room.path()).unwrap());
        assert_eq!((all.split(' ').count(), none.split(' ').count()), (1 + RACES, 1));
        put(room.path(), "pong-0", &none).unwrap();
        assert_eq!(line(&room.path().join("pong-0")).unwrap(), Some(none));
    }
}
