//! The environments give the same bits on every x86-64 machine: whole episodes against digests that are kept here, in
//! this process and in others whose C library is configured not to use parts of the processor.

#![allow(clippy::unwrap_used)]

mod episodes;

use std::process::Command;

/// What glibc can be configured with (read when a process starts). It then takes its functions without these instructions.
const GLIBC: [&str; 3] = [
    "glibc.cpu.hwcaps=-AVX2,-AVX512F,-FMA,-FMA4,-AVX",
    "glibc.cpu.hwcaps=-FMA",
    "glibc.cpu.hwcaps=-AVX2_Usable,-AVX512F_Usable,-FMA_Usable,-FMA4_Usable",
];

#[test]
fn episodes_have_the_bits_that_they_have_on_every_machine() {
    let found = episodes::all().unwrap();
    assert_eq!(found.each_ref().map(|(name, digest)| (*name, digest.as_str())), episodes::GOLDEN);
}

#[test]
fn the_c_librarys_choice_of_code_does_not_matter() {
    for tunables in GLIBC {
        let output = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "episodes_have_the_bits_that_they_have_on_every_machine"])
            .env("GLIBC_TUNABLES", tunables)
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && text.contains("1 passed"), "{tunables}: {text}");
    }
}
