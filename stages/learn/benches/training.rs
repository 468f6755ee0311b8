//! How fast agents learn and act on one thread, in the thesis's networks on made-up observations.
//!
//! `cargo bench -p dril-learn --bench training [-- WORD...] [--json]` runs the cases whose names hold all words. Figures
//! are per second of processor time, so that other work on the machine does not enter (but for the caches they share);
//! the last column is per second of the clock. `--list` prints the names.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program for people")]

use std::time::Instant;

use dril_envs::Frame;
use dril_kinds::{Algorithm, Network, PolicyFamily, Precision, UpdateSettings};
use dril_learn::act::act;
use dril_learn::ensemble::{self, Ensemble};
use dril_learn::fast;
use dril_learn::imitation::Imitator;
use dril_learn::net::Observation;
use dril_learn::optim::{Adam, AdamSettings};
use dril_learn::policy::{Architecture, Policy};
use dril_learn::rollout::{Advantages, Rollout};
use dril_learn::update::Update;
use dril_stage_api::Seed;
use rand::Rng;

const SETTINGS: UpdateSettings = UpdateSettings {
    algorithm: Algorithm::Ppo,
    epochs: 1_000_000,
    minibatches: 1,
    clip_range: 0.1,
    entropy_coef: 0.01,
    value_coef: 0.5,
    max_grad_norm: 0.5,
    gamma: 0.99,
    gae_lambda: 0.95,
};

/// Seconds of processor time for each of five spells.
const SPELL: f64 = 0.6;

type Case = (String, Box<dyn Fn() -> Rates>);

/// Things done per second of processor time and of the clock.
struct Rates {
    cpu: f64,
    clock: f64,
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let flag = |name: &str| arguments.iter().any(|word| word == name);
    let words: Vec<&String> = arguments.iter().filter(|word| !word.starts_with("--")).collect();
    let wanted = |name: &str| words.iter().all(|word| name.split(' ').any(|part| part == word.as_str()));
    fast::prepare();
    if !flag("--json") && !flag("--list") {
        println!("{:<44} {:>12} {:>12}", "", "/CPU-second", "/second");
    }
    for (name, run) in cases().into_iter().filter(|(name, _)| wanted(name)) {
        if flag("--list") {
            println!("{name}");
            continue;
        }
        let Rates { cpu, clock } = run();
        match flag("--json") {
            true => println!("{{\"case\":\"{name}\",\"per_cpu_second\":{cpu:.1},\"per_second\":{clock:.1}}}"),
            false => println!("{name:<44} {cpu:>12.0} {clock:>12.0}"),
        }
    }
}

/// Names are words; what is counted stands last.
fn cases() -> Vec<Case> {
    let mut cases: Vec<Case> = Vec::new();
    let mut add = |name: String, run: Box<dyn Fn() -> Rates>| cases.push((name, run));
    for (precision, short) in [(Precision::Fp32, "fp32"), (Precision::Bf16, "bf16")] {
        for (network, name) in [(Network::DrilCnn, "dril-cnn"), (Network::ExpertCnn, "expert-cnn")] {
            for minibatch in [64, 125, 256] {
                let case = format!("ppo {name} {short} minibatch {minibatch} samples");
                add(case, Box::new(move || ppo(network, precision, minibatch)));
            }
            add(
                format!("acting {name} {short} batch 8 frames"),
                Box::new(move || acting(network, precision, 8)),
            );
        }
        for batch in [32, 100] {
            add(format!("bc dril-cnn {short} batch {batch} samples"), Box::new(move || bc(precision, batch)));
        }
        add(format!("ensemble {short} batch 100 samples"), Box::new(move || ensemble(precision, 100)));
    }
    add("ppo mlp fp32 minibatch 64 samples".into(), Box::new(|| ppo(Network::Mlp, Precision::Fp32, 64)));
    add("acting mlp fp32 batch 1 observations".into(), Box::new(|| acting(Network::Mlp, Precision::Fp32, 1)));
    cases
}

fn observation(network: Network) -> Observation {
    match network {
        Network::Mlp => Observation::Vector { len: 8 },
        _ => Observation::Images { height: 84, width: 84, stack: 4 },
    }
}

fn policy(network: Network, precision: Precision) -> Policy {
    let (family, observation) = (PolicyFamily::Beta, observation(network));
    let architecture = Architecture { network, family, observation, actions: 2 };
    let mut policy = Policy::new(architecture, &mut Seed(1).stream("init")).unwrap();
    policy.params.set_precision(precision);
    policy
}

/// A rollout of noise.
fn rollout(observation: Observation, entries: usize) -> Rollout {
    let mut rollout = Rollout::new(observation, 2, 1, entries);
    let mut stream = Seed(1).stream("frames");
    let mut pixels = vec![0; 84 * 84];
    for t in 0..=entries {
        stream.fill_bytes(&mut pixels);
        let vector: Vec<f32> = pixels[..8].iter().map(|&pixel| f32::from(pixel) / 128.0 - 1.0).collect();
        let frame = match observation {
            Observation::Images { .. } => Frame::Image(&pixels),
            Observation::Vector { .. } => Frame::Vector(&vector),
        };
        rollout.frames.set(rollout.slot(t, 0), frame, t == 0);
    }
    rollout.samples.fill(0.4);
    rollout
}

fn ppo(network: Network, precision: Precision, minibatch: usize) -> Rates {
    let mut policy = policy(network, precision);
    let ids = policy.params.ids().collect();
    let mut adam = Adam::new(&policy.params, ids, AdamSettings::default());
    let rollout = rollout(observation(network), 2048);
    let wave = |entry: usize| (entry as f32).sin();
    let advantages =
        Advantages { advantages: (0..2048).map(wave).collect(), returns: (0..2048).map(wave).collect() };
    let settings = UpdateSettings { minibatches: (2048 / minibatch) as u64, ..SETTINGS };
    let (mut update, mut stream) = (Update::new(advantages), Seed(1).stream("minibatch"));
    rates(minibatch, || {
        let entries = update.next_minibatch(&settings, &mut stream).unwrap();
        update.learn(&mut policy, &mut adam, &rollout, &entries, &settings, 1e-5).unwrap();
    })
}

fn acting(network: Network, precision: Precision, batch: usize) -> Rates {
    let (policy, rollout) = (policy(network, precision), rollout(observation(network), batch));
    let slots: Vec<usize> = (0..batch).map(|t| rollout.slot(t, 0)).collect();
    let mut stream = Seed(1).stream("action");
    rates(batch, || {
        act(&policy, &rollout.frames.gather(&slots), 0.0, &mut stream);
    })
}

fn bc(precision: Precision, batch: usize) -> Rates {
    let mut policy = policy(Network::DrilCnn, precision);
    let mut adam = Adam::new(&policy.params, policy.actor_ids(), AdamSettings::default());
    let rollout = rollout(observation(Network::DrilCnn), 2048);
    let targets = tch::Tensor::from_slice(&vec![0.3_f32; batch * 2]).view([batch as i64, 2]);
    let mut next = 0;
    rates(batch, || {
        next = (next + 7) % (2048 - batch);
        let slots: Vec<usize> = (next..next + batch).map(|t| rollout.slot(t, 0)).collect();
        let seen = rollout.frames.gather_for(&slots, precision);
        let (_, gradients) = policy.loss_and_gradients(&seen, &targets, adam.ids());
        adam.step(&mut policy.params, &gradients, 1e-5, None);
    })
}

fn ensemble(precision: Precision, batch: usize) -> Rates {
    let observation = observation(Network::DrilCnn);
    let architecture = ensemble::Architecture { observation, actions: 2, members: 5, choices: false };
    let mut ensemble = Ensemble::new(architecture, &mut Seed(1).stream("init")).unwrap();
    ensemble.params.set_precision(precision);
    let mut adam = Adam::new(&ensemble.params, ensemble.trained(), AdamSettings::default());
    let rollout = rollout(observation, 2048);
    let targets = tch::Tensor::from_slice(&vec![0.3_f32; batch * 2]).view([batch as i64, 2]);
    let mut next = 0;
    rates(batch, || {
        next = (next + 7) % (2048 - batch);
        let slots: Vec<usize> = (next..next + batch).map(|t| rollout.slot(t, 0)).collect();
        let seen = rollout.frames.gather_for(&slots, precision);
        let (_, gradients) = ensemble.loss_and_gradients(&seen, &targets, adam.ids());
        adam.step(&mut ensemble.params, &gradients, 1e-5, None);
    })
}

/// Calls a second, after some calls to warm up, times `each`. The best of five spells, since neighbours can only take
/// away.
fn rates(each: usize, mut call: impl FnMut()) -> Rates {
    (0..5).for_each(|_| call());
    let mut best = Rates { cpu: 0.0, clock: 0.0 };
    for _ in 0..5 {
        let (cpu, clock) = (cpu_seconds(), Instant::now());
        let mut calls = 0;
        while cpu_seconds() - cpu < SPELL {
            call();
            calls += 1;
        }
        let done = (calls * each) as f64;
        best.cpu = best.cpu.max(done / (cpu_seconds() - cpu));
        best.clock = best.clock.max(done / clock.elapsed().as_secs_f64());
    }
    best
}

fn cpu_seconds() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    #[allow(unsafe_code)]
    // SAFETY: the call only writes the time into the struct given.
    unsafe {
        libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &raw mut time);
    }
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
