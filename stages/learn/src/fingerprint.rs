//! The fingerprint of a result, for its record: the version of libtorch, and the type of processor.
//!
//! A result of `device: cpu` depends on neither. libtorch, used for `device: cuda`, selects its kernels by the hardware,
//! and different kernels sum in a different order.

use dril_stage_api::Ctx;

/// Adds the fingerprint to the record of the stage's result.
pub fn record(ctx: &mut Ctx<'_>) {
    ctx.made_with(&[("libtorch", LIBTORCH), ("cpu", &cpu())]);
}

/// The libtorch that this program was linked with.
pub const LIBTORCH: &str = env!("DRIL_LIBTORCH");

/// The processor's vendor and its widest vector instructions, as `AuthenticAMD avx512-bf16`.
pub fn cpu() -> String {
    #[cfg(target_arch = "x86_64")]
    {
        format!("{} {}", vendor(), widest())
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        std::env::consts::ARCH.to_owned()
    }
}

/// The vendor string of `cpuid`.
#[cfg(target_arch = "x86_64")]
fn vendor() -> String {
    let leaf = std::arch::x86_64::__cpuid(0);
    let letters: Vec<u8> = [leaf.ebx, leaf.edx, leaf.ecx].into_iter().flat_map(u32::to_le_bytes).collect();
    String::from_utf8_lossy(&letters).trim_matches(|letter: char| letter.is_control()).to_owned()
}

/// The widest instruction set that oneDNN distinguishes.
#[cfg(target_arch = "x86_64")]
fn widest() -> &'static str {
    let sets = [
        ("avx512-fp16", is_x86_feature_detected!("avx512fp16")),
        ("avx512-bf16", is_x86_feature_detected!("avx512bf16")),
        ("avx512-vnni", is_x86_feature_detected!("avx512vnni")),
        ("avx512", is_x86_feature_detected!("avx512bw") && is_x86_feature_detected!("avx512dq")),
        ("avx2", is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")),
        ("avx", is_x86_feature_detected!("avx")),
    ];
    sets.into_iter().find(|(_, there)| *there).map_or("sse4", |(name, _)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_and_the_processor_have_names() {
        assert!(LIBTORCH.starts_with("2."), "{LIBTORCH}");
        assert!(!cpu().is_empty() && cpu().chars().all(|letter| letter.is_ascii_graphic() || letter == ' '));
    }
}
