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

/// Computes `rows` rows of a result block by block: `|first| block(…)` is called as `block::<SIZE>(…)`, with `most` for
/// `SIZE` in the first rows (see [`in_large_blocks`]), then with 4 and 1. No other sizes: with more copies of a kernel in
/// one function the compiler no longer proves its indices, and it is a quarter slower.
macro_rules! in_blocks {
    ($most:ident, $rows:expr, |$first:ident| $block:ident($($argument:expr),* $(,)?)) => {{
        let large = $crate::fast::vector::in_large_blocks($rows, $most);
        let mut $first = 0;
        while $first < large {
            $block::<$most>($($argument),*);
            $first += $most;
        }
        while $first + 4 <= $rows {
            $block::<4>($($argument),*);
            $first += 4;
        }
        for $first in $first..$rows {
            $block::<1>($($argument),*);
        }
    }};
}
pub(crate) use in_blocks;

/// How many of the rows [`in_blocks`] computes in blocks of `most`. In a block of few rows the adders wait for each other,
/// so the rest takes over a large block where that makes blocks of 4 of it: 8 rows are 4 and 4, and not 6 and 2.
#[inline(always)]
pub fn in_large_blocks(rows: usize, most: usize) -> usize {
    let rest = rows % most;
    match rest {
        2 | 3 if rows > most => rows - rest - most,
        _ => rows - rest,
    }
}

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

#[cfg(test)]
mod tests {
    fn note<const SIZE: usize>(first: usize, blocks: &mut Vec<(usize, usize)>) {
        blocks.push((first, SIZE));
    }

    fn blocks<const MOST: usize>(rows: usize) -> Vec<(usize, usize)> {
        let mut blocks = Vec::new();
        in_blocks!(MOST, rows, |first| note(first, &mut blocks));
        blocks
    }

    #[test]
    fn blocks_cover_all_rows_in_order() {
        for rows in 0..100 {
            for blocks in [blocks::<1>(rows), blocks::<6>(rows), blocks::<12>(rows)] {
                let covered: Vec<usize> =
                    blocks.iter().flat_map(|(first, size)| *first..first + size).collect();
                assert_eq!(covered, (0..rows).collect::<Vec<_>>());
            }
        }
        assert_eq!(blocks::<6>(8), [(0, 4), (4, 4)]);
        assert_eq!(blocks::<6>(9), [(0, 4), (4, 4), (8, 1)]);
        assert_eq!(blocks::<6>(16), [(0, 6), (6, 6), (12, 4)]);
    }
}
