//! The demonstrations file: what is written is read, and nothing else is believed.

use super::*;
use crate::EnvConfig;
use proptest::prelude::*;

fn header(observation_space: ObservationSpace) -> DemosHeader {
    DemosHeader {
        env: EnvConfig::default(),
        observation_space,
        action_dims: 2,
        action_range: ActionRange::Raw,
        mode: "stochastic".into(),
    }
}

/// The content of the golden file.
fn golden() -> Demonstrations {
    let episode = |seed: u64, steps: usize, outcome| Episode {
        seed,
        score: 1000.0 / 3.0 + seed as f64,
        outcome,
        frames: (0..steps * 84 * 84).map(|i| ((i / 84 * 3) as u8).wrapping_add(seed as u8)).collect(),
        vectors: vec![],
        actions: (0..steps * 2).map(|i| i as f32 / 7.0 - 1.5).collect(),
    };
    Demonstrations {
        header: header(ObservationSpace::Image { height: 84, width: 84, stack: 4 }),
        episodes: vec![episode(7, 3, Outcome::Finished), episode(u64::MAX, 2, Outcome::TimeLimit)],
    }
}

fn golden_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/demonstrations-v1.bin")
}

#[test]
fn a_file_of_version_1_is_read_for_ever() {
    // Users keep such files in their caches. A change of the format needs another magic and this test as it is.
    assert_eq!(Demonstrations::read(&golden_path()).unwrap(), golden());
}

#[test]
#[ignore = "writes the golden file again"]
fn write_the_golden_file() {
    golden().write(&golden_path()).unwrap();
}

fn written(demos: &Demonstrations) -> Vec<u8> {
    let mut bytes = Vec::new();
    demos.write_to(&mut bytes).unwrap();
    bytes
}

#[test]
fn equal_content_gives_equal_bytes() {
    assert_eq!(written(&golden()), written(&golden().clone()));
    let mut other = golden();
    other.episodes[0].actions[0] += 1e-6;
    assert_ne!(written(&golden()), written(&other));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn what_is_written_is_read(
        lengths in prop::collection::vec(0usize..5, 0..4),
        vectors: bool,
        score: f64,
        values in prop::collection::vec(-3.0f32..3.0, 1..9),
    ) {
        let space = if vectors {
            ObservationSpace::Vector { len: 3 }
        } else {
            ObservationSpace::Image { height: 2, width: 3, stack: 4 }
        };
        let cycle = |n: usize| values.iter().copied().cycle().take(n).collect::<Vec<f32>>();
        let episodes = lengths.iter().map(|steps| Episode {
            seed: *steps as u64,
            score: if score.is_nan() { 0.0 } else { score },
            outcome: Outcome::Failed,
            frames: if vectors { vec![] } else { vec![9; steps * 6] },
            vectors: if vectors { cycle(steps * 3) } else { vec![] },
            actions: cycle(steps * 2),
        }).collect();
        let demos = Demonstrations { header: header(space), episodes };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("demos");
        demos.write(&path).unwrap();
        prop_assert_eq!(demos.steps(), lengths.iter().sum::<usize>());
        prop_assert_eq!(Demonstrations::read(&path).unwrap(), demos);
    }

    #[test]
    fn a_file_cut_off_anywhere_is_damaged_or_foreign(part in 0.0..1.0f64) {
        let bytes = written(&golden());
        let error = read_bytes(&bytes[..(bytes.len() as f64 * part) as usize]).unwrap_err();
        prop_assert!(matches!(error, DemosError::Damaged { .. } | DemosError::Foreign { .. }), "{}", error);
    }

    #[test]
    fn a_garbled_byte_is_found(at in 0.0..1.0f64, change in 1u8..=255) {
        let mut bytes = written(&golden());
        let at = (bytes.len() as f64 * at) as usize;
        bytes[at] ^= change;
        // A change of the header may be another valid header; what comes back must then differ only there.
        if let Ok(demos) = read_bytes(&bytes) {
            prop_assert_eq!(demos.episodes, golden().episodes);
        }
    }
}

fn read_bytes(bytes: &[u8]) -> Result<Demonstrations, DemosError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("demos");
    std::fs::write(&path, bytes).unwrap();
    Demonstrations::read(&path)
}

#[test]
fn foreign_and_missing_files_say_what_they_are() {
    let foreign = read_bytes(b"PNG\x89 something").unwrap_err().to_string();
    assert!(foreign.contains(r"begins with `PNG\x89 som`, expected `DRILDM01`"), "{foreign}");
    let missing = Demonstrations::read(Path::new("/nowhere/demos")).unwrap_err().to_string();
    assert!(missing.starts_with("cannot read /nowhere/demos"), "{missing}");
}

#[test]
fn more_after_the_last_episode_is_damage() {
    let mut bytes = written(&golden());
    let twice = bytes.clone();
    bytes.extend(twice);
    assert!(matches!(read_bytes(&bytes), Err(DemosError::Damaged { .. })));
}

#[test]
fn an_episode_whose_lengths_do_not_fit_is_not_written() {
    let mut demos = golden();
    demos.episodes[1].frames.pop();
    let error = demos.write(Path::new("/nowhere")).unwrap_err().to_string();
    assert!(error.starts_with("episode 1: 14111 pixels and 0 vector values for 2 steps"), "{error}");
}
