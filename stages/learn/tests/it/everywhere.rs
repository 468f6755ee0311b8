//! The same bytes on every x86-64 machine: each algorithm gives its golden digest, whatever the libraries of the system
//! are configured to assume about the processor.
//!
//! Libraries choose their code by the processor when a process starts, so the variations run in child processes. A
//! golden digest that another processor does not reproduce is a bug; one that changes with the code means that results
//! change: raise the kind's REVISION.

use std::process::{Command, Stdio};

use dril_stage_api::testing::Bench;

use crate::kill::{JOB, write_job};
use crate::worlds::{self, World, digests};

/// What MKL, libtorch and glibc can be configured with.
const VARIATIONS: [&[(&str, &str)]; 4] = [
    &[],
    &[("MKL_CBWR", "COMPATIBLE"), ("ATEN_CPU_CAPABILITY", "default")],
    &[("MKL_CBWR", "AVX2"), ("ATEN_CPU_CAPABILITY", "avx2")],
    // Both spellings: before and since glibc 2.33.
    &[("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-AVX2_Usable,-FMA_Usable,-AVX512F_Usable,-AVX2,-FMA,-AVX512F")],
];

/// The digest of all outputs, computed in a child process.
fn digest(make: &dyn Fn() -> Bench, variables: &[(&str, &str)]) -> String {
    let bench = make();
    let status = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "kill::run_the_job_that_the_parent_names", "--ignored", "--nocapture"])
        .env(JOB, write_job(&bench))
        .envs(variables.iter().copied())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .unwrap();
    assert!(status.success());
    let mut hasher = blake3::Hasher::new();
    digests(&bench).iter().for_each(|digest| {
        hasher.update(digest.as_bytes());
    });
    hasher.finalize().to_hex()[..16].to_owned()
}

fn gives(golden: &str, make: &dyn Fn() -> Bench) {
    for variables in VARIATIONS {
        assert_eq!(digest(make, variables), golden, "{variables:?}");
    }
}

#[test]
fn an_expert_of_carracing_has_the_same_bytes_everywhere() {
    gives("9443e81c3af7befd", &|| worlds::ppo(4));
}

#[test]
fn an_expert_of_lunar_lander_has_the_same_bytes_everywhere() {
    gives("ed5a9cc3804d3446", &|| worlds::lander(6));
}

#[test]
fn a_clone_has_the_same_bytes_everywhere() {
    gives("d283e7c78387b183", &|| worlds::bc(40));
}

#[test]
fn an_ensemble_has_the_same_bytes_everywhere() {
    gives("fc98c2c95c008d0e", &|| worlds::ensemble(40));
}

#[test]
fn dril_has_the_same_bytes_everywhere() {
    let world = World::make();
    gives("5751dd2ee73df84a", &|| world.dril(4));
}
