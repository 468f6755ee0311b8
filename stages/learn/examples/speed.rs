//! How fast agents learn and act on one thread, in the thesis's networks on made-up frames.
//!
//! `cargo run --release -p dril-learn --example speed`. Figures are per second of processor time, so that other work on
//! the machine does not enter (but for the caches they share); the last column is per second of the clock.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program for people")]

use std::time::Instant;

use dril_envs::Frame;
use dril_kinds::{Network, PolicyFamily, UpdateSettings};
use dril_learn::act::act;
use dril_learn::fast;
use dril_learn::imitation::action_loss;
use dril_learn::net::Observation;
use dril_learn::optim::{Adam, AdamSettings};
use dril_learn::policy::{Architecture, Policy};
use dril_learn::rollout::{Advantages, Rollout};
use dril_learn::update::Update;
use dril_stage_api::Seed;
use rand::Rng;

const SETTINGS: UpdateSettings = UpdateSettings {
    epochs: 1_000_000,
    minibatches: 1,
    clip_range: 0.1,
    entropy_coef: 0.01,
    value_coef: 0.5,
    max_grad_norm: 0.5,
    gamma: 0.99,
    gae_lambda: 0.95,
};

fn main() {
    fast::prepare();
    println!("{:<44} {:>12} {:>12}", "", "/CPU-second", "/second");
    for (network, name) in [(Network::DrilCnn, "dril-cnn"), (Network::ExpertCnn, "expert-cnn")] {
        for minibatch in [64, 125, 256] {
            report(&format!("ppo {name}, minibatch {minibatch}, samples"), ppo(network, minibatch));
        }
        report(&format!("acting {name}, 8 at a time, frames"), acting(network, 8));
    }
    for batch in [32, 100] {
        report(&format!("bc dril-cnn, batch {batch}, samples"), bc(batch));
    }
}

fn report(name: &str, (cpu, wall): (f64, f64)) {
    println!("{name:<44} {cpu:>12.0} {wall:>12.0}");
}

fn policy(network: Network) -> Policy {
    let observation = Observation::Images { height: 84, width: 84, stack: 4 };
    let architecture = Architecture { network, family: PolicyFamily::Beta, observation, actions: 2 };
    Policy::new(architecture, &mut Seed(1).stream("init")).unwrap()
}

/// A rollout of frames of noise.
fn rollout(entries: usize) -> Rollout {
    let observation = Observation::Images { height: 84, width: 84, stack: 4 };
    let mut rollout = Rollout::new(observation, 2, 1, entries);
    let mut stream = Seed(1).stream("frames");
    let mut pixels = vec![0; 84 * 84];
    for t in 0..=entries {
        stream.fill_bytes(&mut pixels);
        rollout.frames.set(rollout.slot(t, 0), Frame::Image(&pixels), t == 0);
    }
    rollout.samples.fill(0.4);
    rollout
}

fn ppo(network: Network, minibatch: usize) -> (f64, f64) {
    let mut policy = policy(network);
    let ids = policy.params.ids().collect();
    let mut adam = Adam::new(&policy.params, ids, AdamSettings::default());
    let rollout = rollout(2048);
    let wave = |entry: usize| (entry as f32).sin();
    let advantages =
        Advantages { advantages: (0..2048).map(wave).collect(), returns: (0..2048).map(wave).collect() };
    let settings = UpdateSettings { minibatches: (2048 / minibatch) as u64, ..SETTINGS };
    let (mut update, mut stream) = (Update::new(advantages), Seed(1).stream("minibatch"));
    rate(minibatch, || {
        let entries = update.next_minibatch(&settings, &mut stream).unwrap();
        update.learn(&mut policy, &mut adam, &rollout, &entries, &settings, 1e-5).unwrap();
    })
}

fn acting(network: Network, batch: usize) -> (f64, f64) {
    let (policy, rollout) = (policy(network), rollout(batch));
    let slots: Vec<usize> = (0..batch).map(|t| rollout.slot(t, 0)).collect();
    let mut stream = Seed(1).stream("action");
    rate(batch, || {
        act(&policy, &rollout.frames.gather(&slots), 0.0, &mut stream);
    })
}

fn bc(batch: usize) -> (f64, f64) {
    let mut policy = policy(Network::DrilCnn);
    let mut adam = Adam::new(&policy.params, policy.actor_ids(), AdamSettings::default());
    let rollout = rollout(2048);
    let targets = tch::Tensor::from_slice(&vec![0.3_f32; batch * 2]).view([batch as i64, 2]);
    let mut next = 0;
    rate(batch, || {
        next = (next + 7) % (2048 - batch);
        let slots: Vec<usize> = (next..next + batch).map(|t| rollout.slot(t, 0)).collect();
        let actions = policy.distribution(&rollout.frames.gather(&slots)).mean_action();
        let gradients = policy.params.gradients(&action_loss(&actions, &targets), adam.ids());
        adam.step(&mut policy.params, &gradients, 1e-5, None);
    })
}

/// Calls a second, after some calls to warm up, times `each`: per second of processor time and of the clock. The best
/// of five spells, since neighbours can only take away.
fn rate(each: usize, mut call: impl FnMut()) -> (f64, f64) {
    (0..5).for_each(|_| call());
    let mut best = (0.0_f64, 0.0_f64);
    for _ in 0..5 {
        let (cpu, clock) = (cpu_seconds(), Instant::now());
        let mut calls = 0;
        while cpu_seconds() - cpu < 0.6 {
            call();
            calls += 1;
        }
        let done = (calls * each) as f64;
        best = (best.0.max(done / (cpu_seconds() - cpu)), best.1.max(done / clock.elapsed().as_secs_f64()));
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
