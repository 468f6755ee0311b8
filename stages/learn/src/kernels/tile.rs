//! Sums of products for a small block of results that is held in registers: the inner loop of all layers.
//!
//! A block has up to 12 rows of 32 numbers with AVX-512 (24 of its 32 registers) and up to 6 of 16 with AVX2 (12 of 16).
//! Each step of a sum multiplies one number of each row with one or two vectors, so that a multiplication takes half a
//! load or less.
#![allow(unsafe_code)]

use super::vector::{LANES, Simd};

/// Rows of the largest block.
pub const MOST_ROWS: usize = 12;

/// What one side of the products reads: in step (o, i), at `starts + o · outer + i · inner`.
#[derive(Clone, Copy)]
pub struct Side<'a, const COUNT: usize> {
    /// All of its numbers.
    pub numbers: &'a [f32],
    /// Where each row, or each vector of a row, begins.
    pub starts: [usize; COUNT],
    /// From an outer step to the next.
    pub outer: usize,
    /// From an inner step to the next.
    pub inner: usize,
}

impl<const COUNT: usize> Side<'_, COUNT> {
    /// # Panics
    /// A step would read `width` numbers beyond the end.
    #[inline(always)]
    fn check(&self, (outer, inner): (usize, usize), width: usize) {
        let mut last = 0;
        for start in self.starts {
            last = last.max(start);
        }
        let end = last + (outer - 1) * self.outer + (inner - 1) * self.inner + width;
        assert!(end <= self.numbers.len(), "a block reads beyond its operand");
    }

    #[inline(always)]
    fn pointers(&self, outer: usize) -> [*const f32; COUNT] {
        let mut pointers = [self.numbers.as_ptr(); COUNT];
        for (pointer, start) in pointers.iter_mut().zip(self.starts) {
            *pointer = pointer.wrapping_add(start + outer * self.outer);
        }
        pointers
    }
}

/// `first`, and one further `apart` for each of the others.
#[inline(always)]
pub fn starts_of<const N: usize>(first: usize, apart: usize) -> [usize; N] {
    let mut starts = [first; N];
    for (at, start) in starts.iter_mut().enumerate() {
        *start += at * apart;
    }
    starts
}

/// `sums[r][j] += Σ a[r] · b[j]` over all steps, (0, 0), (0, 1), … (1, 0), …: one fused multiply-add for each, in order.
#[inline(always)]
pub fn add_products<S: Simd, const R: usize, const N: usize>(
    simd: S,
    sums: &mut [[S::V; N]; R],
    steps: (usize, usize),
    a: &Side<R>,
    b: &Side<N>,
) {
    if steps.0 == 0 || steps.1 == 0 {
        return;
    }
    a.check(steps, 1);
    b.check(steps, LANES);
    let mut block = *sums;
    for outer in 0..steps.0 {
        let (rows, vectors) = (a.pointers(outer), b.pointers(outer));
        let (mut at_a, mut at_b) = (0, 0);
        for _ in 0..steps.1 {
            // SAFETY: `check` compared the last place that is read with the end of the slices.
            unsafe {
                let mut right = [simd.splat(0.0); N];
                for j in 0..N {
                    right[j] = simd.load_at(vectors[j].add(at_b));
                }
                for r in 0..R {
                    let left = simd.splat(*rows[r].add(at_a));
                    for j in 0..N {
                        block[r][j] = simd.mul_add(left, right[j], block[r][j]);
                    }
                }
            }
            at_a += a.inner;
            at_b += b.inner;
        }
    }
    *sums = block;
}

/// Results of which `R` rows, from `first` on, are computed at once. `rows` must be `#[inline(always)]`.
pub trait Block<S: Simd> {
    /// Computes these rows.
    fn rows<const R: usize>(&mut self, simd: S, first: usize);
}

/// Computes `rows` rows in as few blocks as possible, of sizes that differ by one at most: in a block of few rows the
/// multipliers wait for their own results.
#[inline(always)]
pub fn in_blocks<S: Simd, B: Block<S>>(simd: S, rows: usize, block: &mut B) {
    if rows == 0 {
        return;
    }
    let count = rows.div_ceil(S::ROWS);
    let (size, larger) = (rows / count, rows % count);
    let middle = larger * (size + 1);
    if larger > 0 {
        of_one_size(simd, size + 1, (0, middle), block);
    }
    of_one_size(simd, size, (middle, rows), block);
}

#[inline(always)]
fn of_one_size<S: Simd, B: Block<S>>(simd: S, size: usize, range: (usize, usize), block: &mut B) {
    macro_rules! of {
        ($size:literal) => {
            simd.outlined(
                #[inline(always)]
                || {
                    let mut first = range.0;
                    while first < range.1 {
                        block.rows::<$size>(simd, first);
                        first += $size;
                    }
                },
            )
        };
    }
    match size {
        12 if S::ROWS >= 12 => of!(12),
        11 if S::ROWS >= 11 => of!(11),
        10 if S::ROWS >= 10 => of!(10),
        9 if S::ROWS >= 9 => of!(9),
        8 if S::ROWS >= 8 => of!(8),
        7 if S::ROWS >= 7 => of!(7),
        6 if S::ROWS >= 6 => of!(6),
        5 if S::ROWS >= 5 => of!(5),
        4 => of!(4),
        3 => of!(3),
        2 => of!(2),
        _ => {
            for first in range.0..range.1 {
                block.rows::<1>(simd, first);
            }
        }
    }
}
