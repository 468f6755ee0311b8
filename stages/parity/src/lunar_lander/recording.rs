//! The recordings of a folder.

use std::collections::BTreeSet;
use std::path::Path;

use dril_envs::lunar_lander::simulation::Draws;

use crate::error::CheckError;
use crate::npz::{Array, Npz};

/// The file looked for.
pub const FILE: &str = "lunar_traces.npz";

/// The recordings of a folder.
#[derive(Debug)]
pub struct Recordings {
    traces: Npz,
}

/// One scripted flight.
#[derive(Clone, Debug)]
pub struct Run {
    /// Main engine and sideways, per step.
    pub actions: Array,
    /// Observation per moment.
    pub observations: Array,
    /// Reward per moment.
    pub rewards: Array,
    /// Lander and legs per moment: x y angle vx vy spin each, then the legs' angles and whether the lander is awake.
    pub bodies: Array,
    /// The two dispersion draws of each moment, in [-1, 1); the first are those of the reset.
    pub dispersion: Array,
}

impl Run {
    /// The sum of the rewards.
    pub fn total(&self) -> f64 {
        self.rewards.values.iter().sum()
    }

    /// True where the lander came to rest.
    pub fn landed(&self) -> bool {
        self.rewards.values.last() == Some(&100.0)
    }

    /// The dispersion draws of a step.
    pub fn draws(&self, step: usize) -> Option<[f64; 2]> {
        (step + 1 < self.dispersion.rows()).then(|| [0, 1].map(|i| self.dispersion.row(step + 1)[i]))
    }
}

impl Recordings {
    /// Reads what there is; none where nothing was recorded.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn open(folder: &Path) -> Result<Option<Self>, CheckError> {
        let path = folder.join(FILE);
        Ok(path.exists().then(|| Npz::open(&path)).transpose()?.map(|traces| Self { traces }))
    }

    /// Seeds of the recordings.
    pub fn seeds(&self) -> Vec<u64> {
        self.traces.names().filter_map(|name| name.strip_prefix("heights_")?.parse().ok()).collect()
    }

    /// Names of the scripts.
    pub fn scripts(&self) -> BTreeSet<String> {
        let keys = self.traces.names().filter_map(|name| name.strip_prefix("b_")?.split_once('_'));
        keys.map(|(_, script)| script.to_owned()).collect()
    }

    /// One array of a seed.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn array(&self, part: &str, seed: u64) -> Result<Array, CheckError> {
        self.traces.array(&format!("{part}_{seed}"))
    }

    /// What an episode with this seed began with.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn draws(&self, seed: u64) -> Result<Draws, CheckError> {
        let (heights, force) = (self.array("heights", seed)?.values, self.array("force", seed)?.values);
        let fail = |array: &str, values: &[f64]| CheckError::Format {
            name: format!("{FILE}: `{array}_{seed}`"),
            message: format!("{} values, expected 12 heights and 2 forces", values.len()),
        };
        Ok(Draws {
            heights: heights.as_slice().try_into().map_err(|_| fail("heights", &heights))?,
            force: force.as_slice().try_into().map_err(|_| fail("force", &force))?,
        })
    }

    /// The flight of a script with a seed; none where it was not recorded.
    ///
    /// # Errors
    /// One of its arrays cannot be read.
    pub fn run(&self, seed: u64, script: &str) -> Result<Option<Run>, CheckError> {
        let key = format!("{seed}_{script}");
        if !self.traces.names().any(|name| name == format!("b_{key}")) {
            return Ok(None);
        }
        let array = |letter: &str| self.traces.array(&format!("{letter}_{key}"));
        let run = Run {
            actions: array("a")?,
            observations: array("o")?,
            rewards: array("r")?,
            bodies: array("b")?,
            dispersion: array("d")?,
        };
        let moments = run.actions.rows() + 1;
        let fits = [(&run.observations, 8), (&run.rewards, 1), (&run.bodies, 21), (&run.dispersion, 2)]
            .iter()
            .all(|(array, width)| array.values.len() == moments * width);
        if fits && run.actions.values.len() == (moments - 1) * 2 {
            Ok(Some(run))
        } else {
            let name = format!("{FILE}: `{key}`");
            Err(CheckError::Format { name, message: "its arrays differ in length".into() })
        }
    }
}
