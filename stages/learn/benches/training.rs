//! How fast agents learn and act on one thread, in the thesis's networks on made-up observations.
//!
//! `cargo bench -p dril-learn --bench training [-- WORD...] [--json]` runs the cases whose names hold all words, on every
//! path of the kernels that the machine can run. Figures are per second of processor time, so that other work on the
//! machine does not enter (but for the caches they share), with the share of the path's peak of fused multiply-adds,
//! which is measured first. `--list` prints the names.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program for people")]

use dril_envs::{ActionSpace, Frame, ObservationSpace};
use dril_kinds::{Algorithm, Network, PolicyFamily, UpdateParams};
use dril_learn::algorithms::ensemble::{self, Ensemble};
use dril_learn::algorithms::imitation::Imitator;
use dril_learn::algorithms::ppo::{Advantages, Update};
use dril_learn::kernels::{self, Path};
use dril_learn::nn::{Gradients, Optimizer, OptimizerSettings};
use dril_learn::play::act::act;
use dril_learn::policy::{Architecture, Policy};
use dril_learn::training::rollout::Rollout;
use dril_learn::worker;
use dril_stage_api::Seed;
use rand::Rng;

mod peak;

const ACTIONS: ActionSpace = ActionSpace::Continuous { dims: 2 };

const PARAMS: UpdateParams = UpdateParams {
    n_epochs: 1_000_000,
    n_minibatches: 1,
    clip_range: 0.1,
    ent_coef: 0.01,
    vf_coef: 0.5,
    max_grad_norm: 0.5,
    gamma: 0.99,
    gae_lambda: 0.95,
};

/// How often each case is measured; the best counts, since neighbours can only take away.
const SPELLS: usize = 5;

/// One case: what is measured, the floating-point operations of one sample or frame, and the measurement.
struct Case {
    name: String,
    flops: f64,
    run: Box<dyn Fn() -> f64>,
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let flag = |name: &str| arguments.iter().any(|word| word == name);
    let words: Vec<&String> = arguments.iter().filter(|word| !word.starts_with("--")).collect();
    let wanted = |name: &str| words.iter().all(|word| name.split(' ').any(|part| part == word.as_str()));
    worker::prepare();
    // The portable path is for processors without vectors and for tests.
    let mut paths = kernels::paths();
    paths.retain(|path| *path != Path::Portable);
    // Measured before anything else, on every path that is printed.
    let peaks: Vec<f64> = paths.iter().map(|path| peak::peak(*path, 3)).collect();
    for case in cases().into_iter().filter(|case| wanted(&case.name)) {
        if flag("--list") {
            println!("{}", case.name);
            continue;
        }
        for (path, peak) in paths.iter().zip(&peaks) {
            let rate = kernels::forced(*path, || (case.run)());
            let share = rate * case.flops / 1e9 / peak;
            let (name, path) = (&case.name, format!("{path:?}").to_lowercase());
            match flag("--json") {
                true => println!(
                    "{{\"case\":\"{name}\",\"path\":\"{path}\",\"per_cpu_second\":{rate:.1},\"peak_gflops\":{peak:.1},\
                     \"share\":{share:.3}}}"
                ),
                false => {
                    println!("{name:<40} {path:<9} {rate:>9.0} /CPU-second {:>5.0} % of peak", 100.0 * share)
                }
            }
        }
    }
}

/// Names are words; what is counted stands last.
fn cases() -> Vec<Case> {
    let mut cases: Vec<Case> = Vec::new();
    let mut add = |name: String, flops: f64, run: Box<dyn Fn() -> f64>| cases.push(Case { name, flops, run });
    for (network, name) in [(Network::DrilCnn, "dril-cnn"), (Network::ExpertCnn, "expert-cnn")] {
        let forward = forward_flops(network, true);
        for minibatch in [64, 125, 256] {
            let case = format!("ppo {name} minibatch {minibatch} samples");
            let flops = 3.0 * forward - FIRST_LAYER;
            add(case, flops, Box::new(move || ppo(network, minibatch)));
        }
        add(format!("acting {name} batch 8 frames"), forward, Box::new(move || acting(network, 8)));
    }
    for batch in [32, 100] {
        let flops = 3.0 * forward_flops(Network::DrilCnn, false) - FIRST_LAYER;
        add(format!("bc dril-cnn batch {batch} samples"), flops, Box::new(move || bc(batch)));
    }
    let flops = 3.0 * ensemble_flops() - FIRST_LAYER;
    add("ensemble batch 100 samples".into(), flops, Box::new(|| ensemble(100)));
    let mlp = 2.0 * 2.0 * (8.0 * 64.0 + 64.0 * 64.0 + 64.0 * 2.0);
    add("ppo mlp minibatch 64 samples".into(), 3.0 * mlp, Box::new(|| ppo(Network::Mlp, 64)));
    add("acting mlp batch 1 observations".into(), mlp, Box::new(|| acting(Network::Mlp, 1)));
    cases
}

/// Operations of the first convolution, whose gradient of the input nobody needs.
const FIRST_LAYER: f64 = 2.0 * 400.0 * 256.0 * 32.0;

/// Operations of the three convolutions, with so many filters in the last one.
fn convolutions(filters: f64) -> f64 {
    FIRST_LAYER + 2.0 * (81.0 * 512.0 * 64.0 + 49.0 * 576.0 * filters)
}

/// Operations of a forward pass of one sample, with or without the critic; two heads of two outputs each.
fn forward_flops(network: Network, critic: bool) -> f64 {
    let with = |shared: f64, critics: f64| shared + if critic { critics } else { 0.0 };
    match network {
        Network::ExpertCnn => with(
            convolutions(32.0) + 2.0 * (1568.0 * 512.0 + 2.0 * 512.0 * 512.0 + 4.0 * 512.0),
            2.0 * (512.0 * 512.0 + 512.0),
        ),
        _ => with(
            convolutions(64.0) + 2.0 * (3136.0 * 512.0 + 512.0 * 512.0 + 4.0 * 512.0),
            2.0 * (3136.0 * 512.0 + 512.0),
        ),
    }
}

/// The same of an ensemble of five, whose members see a fifth of the batch each.
fn ensemble_flops() -> f64 {
    convolutions(64.0) + 2.0 * (3136.0 * 512.0 + 2.0 * 512.0 * 512.0 + 2.0 * 512.0)
}

fn observation(network: Network) -> ObservationSpace {
    match network {
        Network::Mlp => ObservationSpace::Vector { len: 8 },
        _ => ObservationSpace::Image { height: 84, width: 84, stack: 4 },
    }
}

fn policy(network: Network) -> Policy {
    let (family, observation) = (PolicyFamily::Beta, observation(network));
    let architecture = Architecture { network, family, observation, actions: ACTIONS };
    Policy::new(architecture, &mut Seed(1).stream("init")).unwrap()
}

/// A rollout of noise.
fn rollout(observation: ObservationSpace, entries: usize) -> Rollout {
    let mut rollout = Rollout::new(observation, 2, 1, entries);
    let mut stream = Seed(1).stream("frames");
    let mut pixels = vec![0; 84 * 84];
    for t in 0..=entries {
        stream.fill_bytes(&mut pixels);
        let vector: Vec<f32> = pixels[..8].iter().map(|&pixel| f32::from(pixel) / 128.0 - 1.0).collect();
        let frame = match observation {
            ObservationSpace::Image { .. } => Frame::Image(&pixels),
            ObservationSpace::Vector { .. } => Frame::Vector(&vector),
        };
        rollout.frames.set(rollout.slot(t, 0), frame, t == 0);
    }
    rollout.samples.fill(0.4);
    rollout
}

fn ppo(network: Network, minibatch: usize) -> f64 {
    let mut policy = policy(network);
    let ids = policy.params().ids().collect();
    let mut adam = Optimizer::new(policy.params(), ids, OptimizerSettings::default());
    let mut gradients = Gradients::new(policy.params());
    let rollout = rollout(observation(network), 2048);
    let wave = |entry: usize| (entry as f32).sin();
    let advantages =
        Advantages { advantages: (0..2048).map(wave).collect(), returns: (0..2048).map(wave).collect() };
    let params = UpdateParams { n_minibatches: (2048 / minibatch) as u64, ..PARAMS };
    let (mut update, mut stream) = (Update::new(advantages), Seed(1).stream("minibatch"));
    rate(minibatch, || {
        let entries = update.next_minibatch((Algorithm::Ppo, &params), &mut stream).unwrap();
        let learner = (&mut policy, &mut adam, &mut gradients);
        update.learn(learner, &rollout, &entries, (Algorithm::Ppo, &params), 1e-5).unwrap();
    })
}

fn acting(network: Network, batch: usize) -> f64 {
    let (policy, rollout) = (policy(network), rollout(observation(network), batch));
    let slots: Vec<usize> = (0..batch).map(|t| rollout.slot(t, 0)).collect();
    let mut stream = Seed(1).stream("action");
    rate(batch, || {
        act(&policy, &rollout.frames.gather(&slots), 0.0, &mut stream);
    })
}

fn bc(batch: usize) -> f64 {
    imitate(policy(Network::DrilCnn), batch)
}

fn ensemble(batch: usize) -> f64 {
    let observation = observation(Network::DrilCnn);
    let architecture = ensemble::EnsembleArchitecture { observation, actions: ACTIONS, members: 5 };
    imitate(Ensemble::new(architecture, &mut Seed(1).stream("init")).unwrap(), batch)
}

fn imitate(mut model: impl Imitator, batch: usize) -> f64 {
    let mut adam = Optimizer::new(model.params(), model.trained(), OptimizerSettings::default());
    let mut gradients = Gradients::new(model.params());
    let rollout = rollout(observation(Network::DrilCnn), 2048);
    let targets = vec![0.3_f32; batch * 2];
    let mut next = 0;
    rate(batch, || {
        next = (next + 7) % (2048 - batch);
        let slots: Vec<usize> = (next..next + batch).map(|t| rollout.slot(t, 0)).collect();
        gradients.clear();
        model.learn(&rollout.frames.gather(&slots), &targets, &mut gradients);
        assert!(adam.step(model.params_mut(), &gradients, 1e-5, None));
    })
}

/// How many things are done in a second of processor time, `each` a call, after some calls to warm up.
fn rate(each: usize, mut call: impl FnMut()) -> f64 {
    (0..5).for_each(|_| call());
    peak::per_cpu_second(SPELLS, call) * each as f64
}
