//! `dataset`: the first episodes of a recording, with actions in the requested range.

use dril_envs::{ActionRange as Recorded, ActionSpace, Demonstrations};
use dril_kinds::{ActionRange, DatasetParams};
use dril_stage_api::{Ctx, Stage, StageError};

/// The stage `dataset`.
#[derive(Clone, Copy, Debug)]
pub struct DatasetStage;

/// The name of both ports.
const PORT: &str = "demonstrations";

impl Stage for DatasetStage {
    type Kind = dril_kinds::Dataset;

    fn run(params: &DatasetParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let path = ctx.input(PORT)?;
        let wrong = |message: String| StageError::input(PORT, path, message);
        let demos = Demonstrations::read(path).map_err(|error| wrong(error.to_string()))?;
        let demos = first(demos, params.trajectories as usize).map_err(wrong)?;
        let (_, space) = demos.header.env.spaces().map_err(|error| wrong(error.to_string()))?;
        if let ActionSpace::Discrete { .. } = space
            && params.actions != ActionRange::Raw
        {
            return Err(wrong(
                "has discrete actions, which have no range; set `actions` to `raw`".to_owned(),
            ));
        }
        let demos = with_range(demos, params.actions).map_err(wrong)?;
        demos.write(ctx.output(PORT)?).map_err(StageError::failed)
    }
}

/// The first `count` episodes, so that smaller datasets are subsets of larger ones.
fn first(mut demos: Demonstrations, count: usize) -> Result<Demonstrations, String> {
    let seen = demos.episodes.len();
    if seen < count {
        return Err(format!(
            "has {seen} episodes, expected at least {count} (`trajectories`); record more, or lower `trajectories`"
        ));
    }
    demos.episodes.truncate(count);
    Ok(demos)
}

/// Brings actions into the requested range.
fn with_range(mut demos: Demonstrations, range: ActionRange) -> Result<Demonstrations, String> {
    for (index, episode) in demos.episodes.iter_mut().enumerate() {
        if episode.actions.iter().any(|action| action.is_nan()) {
            return Err(format!("episode {index} has an action that is not a number"));
        }
        match range {
            ActionRange::Clipped => {
                episode.actions.iter_mut().for_each(|action| *action = action.clamp(-1.0, 1.0));
            }
            ActionRange::Bounded => {
                if let Some(action) = episode.actions.iter().find(|action| action.abs() > 1.0) {
                    return Err(format!(
                        "episode {index} has an action of {action}, expected all within [-1, 1]; set `actions` to \
                         `clipped`, or record a policy with bounded actions"
                    ));
                }
            }
            ActionRange::Raw => {}
        }
    }
    match range {
        ActionRange::Clipped => demos.header.action_range = Recorded::Clipped,
        ActionRange::Bounded => demos.header.action_range = Recorded::Bounded,
        ActionRange::Raw => {}
    }
    Ok(demos)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::transitions::tests::image_demos;
    use dril_stage_api::testing::Bench;
    use serde_json::json;

    /// What the stage makes of two episodes, the first beginning with this action.
    fn run(actions: &str, trajectories: u64, action: f32) -> Result<Demonstrations, StageError> {
        let params = json!({ "actions": actions, "trajectories": trajectories });
        let folder = tempfile::tempdir().unwrap();
        let recording = folder.path().join("recording.demos");
        image_demos(3, action).write(&recording).unwrap();
        let bench = Bench::new::<DatasetStage>(&params, 1).unwrap().input(PORT, &recording, &[]);
        bench.run()?;
        Ok(Demonstrations::read(&bench.output(PORT).unwrap()).unwrap())
    }

    #[test]
    fn the_first_episodes_are_taken_and_their_actions_clipped() {
        let set = run("clipped", 1, 2.5).unwrap();
        assert_eq!(set.episodes.len(), 1);
        assert_eq!(set.episodes[0].seed, 1);
        assert_eq!(set.episodes[0].actions[..2], [1.0, 0.01]);
        assert_eq!(set.header.action_range, Recorded::Clipped);
    }

    #[test]
    fn raw_actions_stay_as_they_were_recorded() {
        assert_eq!(run("raw", 2, -7.0).unwrap(), image_demos(3, -7.0));
    }

    #[test]
    fn bounded_actions_must_be_within_the_range() {
        assert_eq!(run("bounded", 2, -1.0).unwrap().header.action_range, Recorded::Bounded);
        let message = run("bounded", 2, 1.5).unwrap_err().to_string();
        assert!(message.contains("episode 0 has an action of 1.5"), "{message}");
    }

    #[test]
    fn too_few_episodes_are_an_error_that_counts_them() {
        let message = run("clipped", 3, 0.0).unwrap_err().to_string();
        assert!(message.contains("has 2 episodes, expected at least 3"), "{message}");
    }
}
