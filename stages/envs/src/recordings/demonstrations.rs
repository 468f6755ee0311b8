//! The file format of recorded episodes.
//!
//! Layout: 8 bytes of magic with the version, the length of a JSON header as u32, the header, and a zstd stream. In the
//! stream, per episode: seed u64, score f64, outcome u8, steps u32, then the actions as f32, then the frames. All
//! numbers are little-endian. Equal content gives equal bytes.

use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{EnvConfig, ObservationSpace, Outcome};

/// First bytes of a file; the last two are the version.
const MAGIC: [u8; 8] = *b"DRILDM01";
/// Maximum length of the header; a longer one is treated as damage.
const MOST_HEADER: u32 = 1 << 20;
/// Maximum number of steps per episode; more is treated as damage.
const MOST_STEPS: u32 = 1 << 26;
/// zstd level: 510 bytes a frame in 80 us; level 9 takes four times as long for 6 % less.
const LEVEL: i32 = 6;
/// Window of the compressor, log2 of bytes: covers a whole episode.
const WINDOW_LOG: u32 = 23;

/// Why a demonstrations file cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DemosError {
    /// Opening, reading or writing failed.
    #[error("cannot {action} {path}: {source}", path = path.display())]
    Io {
        /// `read` or `write`.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// Not a demonstrations file, or one of another version.
    #[error("{path} is not a demonstrations file: it begins with `{seen}`, expected `{expected}`", path = path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Its first bytes, escaped.
        seen: String,
        /// The expected first bytes.
        expected: String,
    },
    /// Truncated or corrupted.
    #[error("{path} is damaged: {message}; record or copy it again", path = path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What was seen and what was expected.
        message: String,
    },
    /// An episode that does not match the header.
    #[error("episode {episode}: {message}")]
    Inconsistent {
        /// Index of the episode.
        episode: usize,
        /// What was seen and what was expected.
        message: String,
    },
}

/// Range of the actions in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActionRange {
    /// Unbounded, as the policy chose them.
    Raw,
    /// Clipped to [-1, 1].
    Clipped,
    /// Within [-1, 1] by construction of the policy.
    Bounded,
}

/// Metadata shared by all episodes of a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DemosHeader {
    /// The environment of the episodes.
    pub env: EnvConfig,
    /// Observation space.
    pub observation_space: ObservationSpace,
    /// Action dimensions; 1 for discrete actions.
    pub action_dims: usize,
    /// Range of the actions.
    pub action_range: ActionRange,
    /// How the expert chose its actions: `deterministic`, `stochastic` or `scripted`.
    pub mode: String,
}

/// One recorded episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    /// Seed of the environment.
    pub seed: u64,
    /// Sum of the rewards.
    pub score: f64,
    /// How it ended.
    pub outcome: Outcome,
    /// The frame before each action, `steps * frame_len` bytes; empty for vector observations.
    pub frames: Vec<u8>,
    /// The vector before each action, `steps * len` values; empty for image observations.
    pub vectors: Vec<f32>,
    /// The actions as the policy chose them, `steps * action_dims` values.
    pub actions: Vec<f32>,
}

/// Recorded episodes.
#[derive(Clone, Debug, PartialEq)]
pub struct Demonstrations {
    /// Their metadata.
    pub header: DemosHeader,
    /// The episodes, in the order they were recorded.
    pub episodes: Vec<Episode>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileHeader {
    #[serde(flatten)]
    common: DemosHeader,
    episodes: u32,
}

impl Episode {
    /// Number of steps, for actions of `dims` values.
    pub fn steps(&self, dims: usize) -> usize {
        self.actions.len() / dims.max(1)
    }
}

impl Demonstrations {
    /// Total number of steps.
    pub fn steps(&self) -> usize {
        self.episodes.iter().map(|episode| episode.steps(self.header.action_dims)).sum()
    }

    /// Writes the file; equal content gives equal bytes.
    ///
    /// # Errors
    /// An episode does not match the header, or the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), DemosError> {
        for (index, episode) in self.episodes.iter().enumerate() {
            self.header
                .fits(episode)
                .map_err(|message| DemosError::Inconsistent { episode: index, message })?;
        }
        let io = |source| DemosError::Io { action: "write", path: path.to_owned(), source };
        self.write_to(BufWriter::new(File::create(path).map_err(io)?)).map_err(io)
    }

    fn write_to(&self, mut file: impl Write) -> std::io::Result<()> {
        let header = FileHeader { common: self.header.clone(), episodes: count(self.episodes.len())? };
        let header = serde_json::to_vec(&header)?;
        file.write_all(&MAGIC)?;
        file.write_all(&count(header.len())?.to_le_bytes())?;
        file.write_all(&header)?;
        let mut body = zstd::Encoder::new(file, LEVEL)?;
        body.include_checksum(true)?;
        body.window_log(WINDOW_LOG)?;
        for episode in &self.episodes {
            let steps = count(episode.steps(self.header.action_dims))?;
            body.write_all(&episode.seed.to_le_bytes())?;
            body.write_all(&episode.score.to_le_bytes())?;
            body.write_all(&[outcome_code(episode.outcome)])?;
            body.write_all(&steps.to_le_bytes())?;
            write_floats(&mut body, &episode.actions)?;
            write_floats(&mut body, &episode.vectors)?;
            body.write_all(&episode.frames)?;
        }
        body.finish()?.flush()
    }

    /// Reads the file.
    ///
    /// # Errors
    /// The file cannot be read, has another format or version, or is damaged.
    pub fn read(path: &Path) -> Result<Self, DemosError> {
        let mut episodes = Vec::new();
        let header = Self::read_each(path, |_, episode| episodes.push(episode))?;
        Ok(Self { header, episodes })
    }

    /// Reads the file and passes the episodes to `each` one by one, so that only one is in memory; returns the metadata.
    ///
    /// # Errors
    /// As [`Demonstrations::read`]; episodes passed on before the error are complete.
    pub fn read_each(
        path: &Path,
        each: impl FnMut(&DemosHeader, Episode),
    ) -> Result<DemosHeader, DemosError> {
        let io = |source| DemosError::Io { action: "read", path: path.to_owned(), source };
        let mut file = BufReader::new(File::open(path).map_err(io)?);
        let mut magic = Vec::new();
        (&mut file).take(MAGIC.len() as u64).read_to_end(&mut magic).map_err(io)?;
        if magic != MAGIC {
            return Err(DemosError::Foreign {
                path: path.to_owned(),
                seen: magic.escape_ascii().to_string(),
                expected: MAGIC.escape_ascii().to_string(),
            });
        }
        read_body(file, each).map_err(|message| DemosError::Damaged { path: path.to_owned(), message })
    }
}

fn read_body(
    mut file: impl BufRead,
    mut each: impl FnMut(&DemosHeader, Episode),
) -> Result<DemosHeader, String> {
    let length = u32::from_le_bytes(bytes(&mut file, "the header's length")?);
    if length > MOST_HEADER {
        return Err(format!("a header of {length} bytes, expected at most {MOST_HEADER}"));
    }
    let mut header = vec![0; length as usize];
    file.read_exact(&mut header).map_err(|error| format!("the header ends early: {error}"))?;
    let header: FileHeader =
        serde_json::from_slice(&header).map_err(|error| format!("the header cannot be read: {error}"))?;
    let mut body = zstd::Decoder::with_buffer(file).map_err(|error| error.to_string())?;
    body.window_log_max(WINDOW_LOG).map_err(|error| error.to_string())?;
    for index in 0..header.episodes {
        let episode = read_episode(&mut body, &header.common);
        each(&header.common, episode.map_err(|message| format!("episode {index}: {message}"))?);
    }
    match body.read(&mut [0; 1]) {
        Ok(0) => Ok(header.common),
        Ok(_) => Err(format!("there is more after {} episodes", header.episodes)),
        Err(error) => Err(format!("the end cannot be read: {error}")),
    }
}

impl DemosHeader {
    /// Checks the lengths of an episode.
    fn fits(&self, episode: &Episode) -> Result<(), String> {
        if self.action_dims == 0 || !episode.actions.len().is_multiple_of(self.action_dims) {
            return Err(format!(
                "{} action values, expected a multiple of {}",
                episode.actions.len(),
                self.action_dims
            ));
        }
        let steps = episode.steps(self.action_dims);
        let [pixels, values] = self.frame_lens().map(|len| len * steps);
        if episode.frames.len() != pixels || episode.vectors.len() != values {
            let (seen_pixels, seen_values) = (episode.frames.len(), episode.vectors.len());
            return Err(format!(
                "{seen_pixels} pixels and {seen_values} vector values for {steps} steps, expected {pixels} and {values}"
            ));
        }
        Ok(())
    }

    /// Pixels and vector values per step.
    fn frame_lens(&self) -> [usize; 2] {
        match &self.observation_space {
            ObservationSpace::Image { height, width, .. } => [height.saturating_mul(*width), 0],
            ObservationSpace::Vector { len } => [0, *len],
        }
    }
}

fn read_episode(body: &mut impl Read, header: &DemosHeader) -> Result<Episode, String> {
    let seed = u64::from_le_bytes(bytes(body, "the seed")?);
    let score = f64::from_le_bytes(bytes(body, "the score")?);
    let [code] = bytes(body, "the outcome")?;
    let outcome = outcome_of(code).ok_or_else(|| format!("outcome {code}, expected 0 to 3"))?;
    let steps = u32::from_le_bytes(bytes(body, "the number of steps")?);
    if steps > MOST_STEPS {
        return Err(format!("{steps} steps, expected at most {MOST_STEPS}"));
    }
    let [pixels, values] = header.frame_lens();
    let actions = read_floats(body, steps as usize, header.action_dims, "the actions")?;
    let vectors = read_floats(body, steps as usize, values, "the vectors")?;
    let frames = read_many(body, steps as usize, pixels, "the frames")?;
    Ok(Episode { seed, score, outcome, frames, vectors, actions })
}

fn bytes<const N: usize>(from: &mut impl Read, what: &str) -> Result<[u8; N], String> {
    let mut bytes = [0; N];
    from.read_exact(&mut bytes).map_err(|error| format!("{what} cannot be read: {error}"))?;
    Ok(bytes)
}

/// Reads `count * each` bytes. Does not trust the product: memory grows only as far as there is data.
fn read_many(from: &mut impl Read, count: usize, each: usize, what: &str) -> Result<Vec<u8>, String> {
    let wanted = count.checked_mul(each).ok_or_else(|| format!("{what}: {count} times {each} bytes"))?;
    let mut read = Vec::new();
    let result = from.take(wanted as u64).read_to_end(&mut read);
    result.map_err(|error| format!("{what} cannot be read: {error}"))?;
    if read.len() < wanted {
        return Err(format!("{what} end after {} of {wanted} bytes", read.len()));
    }
    Ok(read)
}

fn read_floats(from: &mut impl Read, count: usize, each: usize, what: &str) -> Result<Vec<f32>, String> {
    let raw = read_many(from, count, each.saturating_mul(4), what)?;
    Ok(raw.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

fn write_floats(to: &mut impl Write, values: &[f32]) -> std::io::Result<()> {
    values.iter().try_for_each(|value| to.write_all(&value.to_le_bytes()))
}

fn count(len: usize) -> std::io::Result<u32> {
    u32::try_from(len).map_err(|_| std::io::Error::other(format!("{len} is more than a file can count")))
}

fn outcome_code(outcome: Outcome) -> u8 {
    match outcome {
        Outcome::Running => 0,
        Outcome::Finished => 1,
        Outcome::Failed => 2,
        Outcome::TimeLimit => 3,
    }
}

fn outcome_of(code: u8) -> Option<Outcome> {
    [Outcome::Running, Outcome::Finished, Outcome::Failed, Outcome::TimeLimit].get(usize::from(code)).copied()
}

#[cfg(test)]
#[path = "demonstrations_tests.rs"]
mod tests;
