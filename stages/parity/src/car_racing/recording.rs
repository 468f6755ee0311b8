//! The recordings of a folder.

use std::collections::BTreeSet;
use std::path::Path;

use dril_envs::car_racing::track::{DRAWS, Track};
use serde::Deserialize;

use crate::error::CheckError;
use crate::npz::{Array, Npz};

/// The recordings of a folder; a file that is not there is none.
#[derive(Debug, Default)]
pub struct Recordings {
    /// Draws, way points, tiles and kerbs by seed.
    pub tracks: Option<Npz>,
    /// Scripted runs.
    pub traces: Option<Npz>,
    /// Images of gym's version 0.
    pub v0_frames: Option<Npz>,
    /// Images of Gymnasium's version 3.
    pub v3_frames: Option<Npz>,
    /// Results of the runs.
    pub meta: Option<Meta>,
}

/// Results of the runs.
#[derive(Clone, Debug, Deserialize)]
pub struct Meta {
    /// One per seed and script.
    pub runs: Vec<RunMeta>,
}

/// The result of one run.
#[derive(Clone, Debug, Deserialize)]
pub struct RunMeta {
    /// Seed of the recording.
    pub seed: u64,
    /// Name of the script.
    pub script: String,
    /// Steps driven.
    pub steps: usize,
    /// Tiles visited.
    pub visited: usize,
    /// Sum of the rewards.
    pub ret: f64,
}

/// One scripted run.
#[derive(Clone, Debug)]
pub struct Run {
    /// Seed and script, as arrays are named.
    pub key: String,
    /// Steering, gas and brake per step.
    pub actions: Array,
    /// State per moment: x y angle vx vy yaw-rate, joint angles, wheel speeds, wheel phases.
    pub states: Array,
    /// Reward per moment.
    pub rewards: Array,
    /// Tiles visited per moment.
    pub visited: Array,
    /// Tiles under each wheel per moment.
    pub contacts: Array,
}

/// The files looked for; without the first there is nothing to replay.
pub const FILES: [&str; 4] = ["car_tracks.npz", "car_traces.npz", "car_v0_frames.npz", "car_frames.npz"];

impl Recordings {
    /// Reads what there is; none where no track was recorded.
    ///
    /// # Errors
    /// A file that cannot be read, or recordings without their tracks.
    pub fn open(folder: &Path) -> Result<Option<Self>, CheckError> {
        let [tracks, traces, v0_frames, v3_frames] = FILES.map(|name| {
            let path = folder.join(name);
            path.exists().then(|| Npz::open(&path)).transpose()
        });
        let found = Self {
            tracks: tracks?,
            traces: traces?,
            v0_frames: v0_frames?,
            v3_frames: v3_frames?,
            meta: read_json(&folder.join("car_meta.json"))?,
        };
        match (&found.tracks, [&found.traces, &found.v0_frames, &found.v3_frames].iter().any(|f| f.is_some()))
        {
            (Some(_), _) => Ok(Some(found)),
            (None, false) => Ok(None),
            (None, true) => Err(CheckError::Format {
                name: folder.join(FILES[0]).display().to_string(),
                message: "is missing, and nothing else can be replayed without its tracks".into(),
            }),
        }
    }

    /// Seeds whose track was recorded.
    pub fn seeds(&self) -> Vec<u64> {
        let names = self.tracks.iter().flat_map(Npz::names);
        names.filter_map(|name| name.strip_prefix("draws_")?.parse().ok()).collect()
    }

    /// The track of a seed, made from its recorded draws.
    ///
    /// # Errors
    /// There are no such draws, or they make no track.
    pub fn track(&self, seed: u64) -> Result<Track, CheckError> {
        let name = format!("draws_{seed}");
        let fail = |message: &str| CheckError::Format { name: name.clone(), message: message.into() };
        let draws = self.tracks.as_ref().ok_or_else(|| fail("no tracks were recorded"))?.array(&name)?;
        let made = Track::generate(draws.values.iter().copied());
        let (track, attempts) = made.ok_or_else(|| fail("these draws close no track"))?;
        if attempts * DRAWS == draws.values.len() {
            Ok(track)
        } else {
            Err(fail(&format!("the track closed after {attempts} attempts, recorded are {}", draws.rows())))
        }
    }

    /// Names of the scripts, without those that need a driver.
    pub fn scripts(&self) -> BTreeSet<String> {
        let names = self.traces.iter().flat_map(Npz::names);
        let keys = names.filter_map(|name| name.strip_prefix("c_")?.split_once('_'));
        keys.map(|(_, script)| script.to_owned()).collect()
    }

    /// The run of a script with a seed; none where it was not recorded.
    ///
    /// # Errors
    /// One of its arrays cannot be read.
    pub fn run(&self, seed: u64, script: &str) -> Result<Option<Run>, CheckError> {
        let key = format!("{seed}_{script}");
        let Some(traces) =
            self.traces.as_ref().filter(|npz| npz.names().any(|name| name == format!("c_{key}")))
        else {
            return Ok(None);
        };
        let array = |letter: &str| traces.array(&format!("{letter}_{key}"));
        let run = Run {
            actions: array("a")?,
            states: array("s")?,
            rewards: array("r")?,
            visited: array("v")?,
            contacts: array("c")?,
            key,
        };
        let moments = run.actions.rows() + 1;
        let fits = [(&run.states, 18), (&run.rewards, 1), (&run.visited, 1), (&run.contacts, 4)]
            .iter()
            .all(|(array, width)| array.values.len() == moments * width);
        if fits && run.actions.values.len() == (moments - 1) * 3 {
            Ok(Some(run))
        } else {
            Err(CheckError::Format { name: run.key, message: "its arrays differ in length".into() })
        }
    }
}

/// The results of a game's runs; none where the file is not there.
fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<Option<T>, CheckError> {
    if !path.exists() {
        return Ok(None);
    }
    let text = std::fs::read(path).map_err(|source| CheckError::Io { path: path.to_owned(), source })?;
    serde_json::from_slice(&text)
        .map(Some)
        .map_err(|error| CheckError::Format { name: path.display().to_string(), message: error.to_string() })
}
