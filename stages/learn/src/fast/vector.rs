//! One source, compiled for several widths of vectors, of which a machine uses the widest that it has.
//!
//! All kernels of this room are plain loops over arrays of 16 numbers with fused multiply-adds. The order of the sums
//! stands in the source and not in the width of a register, so every width gives the same bits, and so does every
//! processor that fuses.

/// Numbers side by side in every loop: one register of AVX-512, two of AVX2.
pub const LANES: usize = 16;

/// As many numbers.
pub type Lanes = [f32; LANES];

/// `pub fn name(args)` that runs `body::<ROWS>(args)`, compiled three times. `ROWS` is how many rows of a result are
/// computed at once: as many as there are registers for (12 with AVX-512, else 6).
macro_rules! widest {
    ($(#[$about:meta])* pub fn $name:ident($($arg:ident: $type:ty),* $(,)?) = $body:ident) => {
        $(#[$about])*
        pub fn $name($($arg: $type),*) {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f,fma")]
                fn avx512($($arg: $type),*) {
                    $body::<12>($($arg),*);
                }
                #[target_feature(enable = "avx2,fma")]
                fn avx2($($arg: $type),*) {
                    $body::<6>($($arg),*);
                }
                if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("fma") {
                    #[allow(unsafe_code)]
                    // SAFETY: the instructions were found on this machine.
                    return unsafe { avx512($($arg),*) };
                }
                if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                    #[allow(unsafe_code)]
                    // SAFETY: the instructions were found on this machine.
                    return unsafe { avx2($($arg),*) };
                }
            }
            $body::<6>($($arg),*);
        }
    };
}
pub(crate) use widest;

/// The first `LANES` numbers of a slice, which has that many.
#[inline(always)]
pub fn lanes(numbers: &[f32]) -> &Lanes {
    &numbers.as_chunks().0[0]
}

/// As [`lanes`], to be changed.
#[inline(always)]
pub fn lanes_mut(numbers: &mut [f32]) -> &mut Lanes {
    &mut numbers.as_chunks_mut().0[0]
}

/// `sums += factor · numbers`, fused.
#[inline(always)]
pub fn add_scaled(sums: &mut Lanes, factor: f32, numbers: &Lanes) {
    for (sum, number) in sums.iter_mut().zip(numbers) {
        *sum = factor.mul_add(*number, *sum);
    }
}
