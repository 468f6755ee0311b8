//! Small trainings of the four algorithms, from made-up demonstrations.

use std::path::PathBuf;

use dril_envs::{ActionRange, Demonstrations, DemosHeader, EnvConfig, Episode, Outcome};
use dril_learn::algorithms::bc::BcStage;
use dril_learn::algorithms::dril::DrilStage;
use dril_learn::algorithms::ensemble::EnsembleStage;
use dril_learn::algorithms::ppo_stage::PpoStage;
use dril_stage_api::testing::Bench;
use dril_stage_api::{Stage, math};
use serde_json::{Value, json};

/// The digests of a stage's outputs.
pub fn digests(bench: &Bench) -> Vec<blake3::Hash> {
    let outputs = bench.job().outputs.values();
    outputs.map(|output| blake3::hash(&std::fs::read(&output.path).unwrap())).collect()
}

fn env() -> Value {
    json!({ "car-racing": { "time_limit": 30 } })
}

fn bench<S: Stage>(params: &Value) -> Bench {
    Bench::new::<S>(params, 5).unwrap()
}

/// Two numbers seen, two done: little to compute, much to save.
fn with_numbers<S: Stage>(params: &Value) -> Bench {
    let bench = bench::<S>(params);
    let path = bench.folder().join("in.demos");
    let episode = |seed: u64| {
        let seen: Vec<f32> = (0..160).map(|at| math::sinf(at as f32 * 0.3 + seed as f32)).collect();
        let actions = seen.iter().map(|value| 0.5 - value).collect();
        Episode { seed, score: 1.0, outcome: Outcome::Finished, frames: Vec::new(), vectors: seen, actions }
    };
    let header = DemosHeader {
        env: EnvConfig::default(),
        observation_space: dril_envs::ObservationSpace::Vector { len: 2 },
        action_dims: 2,
        action_range: ActionRange::Bounded,
        mode: "stochastic".to_owned(),
    };
    Demonstrations { header, episodes: (0..5).map(episode).collect() }.write(&path).unwrap();
    bench.input("demonstrations", &path, &[])
}

/// Images and what a car does in them.
fn images() -> Demonstrations {
    let env = EnvConfig::default();
    let (observation_space, action) = env.spaces().unwrap();
    let (pixels, action_dims) = (observation_space.frame_len(), action.action_len());
    let episode = Episode {
        seed: 1,
        score: 910.0,
        outcome: Outcome::Finished,
        frames: (0..12 * pixels).map(|at| (at % 251) as u8).collect(),
        vectors: Vec::new(),
        actions: (0..12 * action_dims).map(|at| math::sinf(at as f32)).collect(),
    };
    let (action_range, mode) = (ActionRange::Bounded, "stochastic".to_owned());
    let header = DemosHeader { env, observation_space, action_dims, action_range, mode };
    Demonstrations { header, episodes: vec![episode] }
}

/// So many updates in CarRacing.
pub fn ppo(updates: u64) -> Bench {
    let params = json!({
        "env": env(), "policy": "beta", "n_envs": 2, "n_steps": 16, "total_timesteps": 32 * updates, "n_epochs": 2,
        "n_minibatches": 4
    });
    bench::<PpoStage>(&params)
}

/// So many updates on LunarLander, with scaled observations and rewards.
pub fn lander(updates: u64) -> Bench {
    let params = json!({
        "env": { "lunar-lander": { "time_limit": 60 } }, "policy": "gaussian", "n_envs": 2, "n_steps": 64,
        "total_timesteps": 128 * updates, "n_epochs": 3, "n_minibatches": 4, "normalize_observations": true,
        "normalize_reward": true
    });
    bench::<PpoStage>(&params)
}

/// So many passes over numbers.
pub fn bc(epochs: u64) -> Bench {
    let params = json!({ "policy": "beta", "n_epochs": epochs, "patience": epochs, "batch_size": 32 });
    with_numbers::<BcStage>(&params)
}

/// So many passes over numbers.
pub fn ensemble(epochs: u64) -> Bench {
    with_numbers::<EnsembleStage>(&json!({ "n_members": 2, "n_epochs": epochs, "batch_size": 64 }))
}

/// What DRIL starts from.
pub struct World {
    _folder: tempfile::TempDir,
    demonstrations: PathBuf,
    policy: PathBuf,
    ensemble: PathBuf,
}

impl World {
    /// Clones images for one pass, and trains two members on them.
    pub fn make() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let demonstrations = folder.path().join("demos");
        images().write(&demonstrations).unwrap();
        let made = |bench: Bench, port: &str| {
            let bench = bench.input("demonstrations", &demonstrations, &[]);
            bench.run().unwrap();
            let path = folder.path().join(port);
            std::fs::copy(bench.output(port).unwrap(), &path).unwrap();
            path
        };
        let clone = json!({ "policy": "beta", "n_epochs": 1, "batch_size": 4 });
        let policy = made(Bench::new::<BcStage>(&clone, 5).unwrap(), "policy");
        let members = json!({ "n_members": 2, "n_epochs": 1, "batch_size": 4 });
        let ensemble = made(Bench::new::<EnsembleStage>(&members, 5).unwrap(), "ensemble");
        Self { _folder: folder, demonstrations, policy, ensemble }
    }

    /// So many updates in CarRacing.
    pub fn dril(&self, updates: u64) -> Bench {
        let params = json!({
            "env": env(), "n_envs": 2, "n_steps": 16, "total_timesteps": 32 * updates, "n_epochs": 2, "n_minibatches": 4,
            "bc_batch_size": 8, "peak_window": 2
        });
        bench::<DrilStage>(&params)
            .input("policy", &self.policy, &[])
            .input("ensemble", &self.ensemble, &[])
            .input("demonstrations", &self.demonstrations, &[])
    }
}
