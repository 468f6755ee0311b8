//! Memory: tensors as plain slices, and the allocator's settings.
#![allow(unsafe_code)]

use tch::{Device, Kind, Tensor};

/// Tells glibc to keep freed memory instead of returning it to the system.
///
/// A training step frees some 6 MB of gradients and activations; by default each such block is unmapped, and the next
/// step pays for new pages. Gain measured: 8 to 30 % of a training step.
pub fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: `mallopt` only sets three numbers in the allocator and may be called at any time.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, 1 << 30);
        libc::mallopt(libc::M_TRIM_THRESHOLD, i32::MAX);
        libc::mallopt(libc::M_TOP_PAD, 64 << 20);
    }
}

/// The values of a dense `f32` tensor on the CPU, row-major.
///
/// The tensor must be contiguous; other code must not write to its storage while the slice lives, which holds because
/// torch computes only when called and one thread owns all tensors.
pub fn values(tensor: &Tensor) -> &[f32] {
    check(tensor, Kind::Float);
    // SAFETY: checked to be contiguous `f32` on the CPU, so `numel` values lie at `data_ptr`; the borrow keeps the
    // storage alive.
    unsafe { std::slice::from_raw_parts(tensor.data_ptr().cast::<f32>(), tensor.numel()) }
}

/// As [`values`], to be changed.
pub fn values_mut(tensor: &mut Tensor) -> &mut [f32] {
    check(tensor, Kind::Float);
    // SAFETY: as in `values`; the exclusive borrow excludes another slice made from this tensor.
    unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast::<f32>(), tensor.numel()) }
}

/// The values of a dense tensor of bytes on the CPU, row-major; see [`values`].
pub fn bytes(tensor: &Tensor) -> &[u8] {
    check(tensor, Kind::Uint8);
    // SAFETY: as in `values`, with bytes.
    unsafe { std::slice::from_raw_parts(tensor.data_ptr().cast::<u8>(), tensor.numel()) }
}

/// As [`bytes`], to be changed.
pub fn bytes_mut(tensor: &mut Tensor) -> &mut [u8] {
    check(tensor, Kind::Uint8);
    // SAFETY: as in `bytes`; the exclusive borrow excludes another slice made from this tensor.
    unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast::<u8>(), tensor.numel()) }
}

/// The bits of a dense bfloat16 tensor on the CPU, row-major, to be changed.
pub fn halves_mut(tensor: &mut Tensor) -> &mut [u16] {
    check(tensor, Kind::BFloat16);
    // SAFETY: checked to be contiguous 16-bit numbers on the CPU, so `numel` of them lie at `data_ptr`; the exclusive
    // borrow excludes another slice made from this tensor.
    unsafe { std::slice::from_raw_parts_mut(tensor.data_ptr().cast::<u16>(), tensor.numel()) }
}

fn check(tensor: &Tensor, kind: Kind) {
    assert!(
        tensor.kind() == kind && tensor.device() == Device::Cpu && tensor.is_contiguous(),
        "expected a contiguous tensor of {kind:?} on the CPU, not of {:?}",
        tensor.kind()
    );
}
