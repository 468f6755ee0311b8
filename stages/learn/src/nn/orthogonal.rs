//! Matrices with orthonormal rows or columns, uniformly distributed (Saxe et al. 2014, Mezzadri 2007).
//!
//! LAPACK's decomposition uses a BLAS that selects its code by the processor, so its last bits differ between machines.
//! Here, the order of sums is fixed: eight partial sums, which the compiler can keep in vectors of any length, added
//! pairwise at the end.

use dril_stage_api::{StreamRng, draw};

/// Number of partial sums.
const LANES: usize = 8;

/// Columns that are projected together, so that an earlier column is read once for several.
const BLOCK: usize = 4;

/// If projection leaves less than this fraction of a column's length, rounding errors dominate the rest, and it is projected
/// again ("twice is enough", Parlett 1998).
const TWICE_BELOW: f64 = 0.1;

/// A matrix of `rows` × `cols`, row-major, whose rows (where there are fewer of them) or columns are orthogonal to each
/// other and have the length `gain`: the Q of the QR decomposition of a matrix of normal numbers with a positive
/// diagonal of R.
pub fn orthogonal(rows: usize, cols: usize, gain: f32, stream: &mut StreamRng) -> Vec<f32> {
    let (tall, short) = (rows.max(cols), rows.min(cols));
    // Column by column, so that inner loops run along memory.
    let mut columns: Vec<f64> = (0..tall * short).map(|_| draw::normal(stream)).collect();
    orthonormalize(&mut columns, tall);
    let value =
        |tall_at: usize, short_at: usize| (columns[short_at * tall + tall_at] * f64::from(gain)) as f32;
    let mut matrix = Vec::with_capacity(rows * cols);
    for row in 0..rows {
        let at = |col: usize| if rows < cols { value(col, row) } else { value(row, col) };
        matrix.extend((0..cols).map(at));
    }
    matrix
}

/// Makes columns of the length `tall`, no more than that, orthonormal by modified Gram-Schmidt.
fn orthonormalize(columns: &mut [f64], tall: usize) {
    if tall == 0 {
        return;
    }
    for first in (0..columns.len() / tall).step_by(BLOCK) {
        let (done, rest) = columns.split_at_mut(first * tall);
        let count = (rest.len() / tall).min(BLOCK);
        let block = &mut rest[..count * tall];
        let before: Vec<f64> = block.chunks_exact(tall).map(length).collect();
        project_block(done, block, tall);
        for at in 0..count {
            let (earlier, column) = block[..(at + 1) * tall].split_at_mut(at * tall);
            project(earlier, column);
            if length(column) < TWICE_BELOW * before[at] {
                project(done, column);
                project(earlier, column);
            }
            let scale = 1.0 / length(column);
            column.iter_mut().for_each(|value| *value *= scale);
        }
    }
}

/// Takes off the columns of a block what lies along the orthonormal columns of `done`.
fn project_block(done: &[f64], block: &mut [f64], tall: usize) {
    for direction in done.chunks_exact(tall) {
        for column in block.chunks_exact_mut(tall) {
            take_off(direction, column);
        }
    }
}

/// The same for one column.
fn project(done: &[f64], column: &mut [f64]) {
    for direction in done.chunks_exact(column.len()) {
        take_off(direction, column);
    }
}

/// column − ⟨direction, column⟩ direction.
fn take_off(direction: &[f64], column: &mut [f64]) {
    let along = dot(direction, column);
    for (value, direction) in column.iter_mut().zip(direction) {
        *value -= along * direction;
    }
}

fn length(column: &[f64]) -> f64 {
    dot(column, column).sqrt()
}

/// The scalar product, with sums in the order that [`LANES`] fixes.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    let (a, b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a.zip(b) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let pairs = [sums[0] + sums[4], sums[1] + sums[5], sums[2] + sums[6], sums[3] + sums[7]];
    (pairs[0] + pairs[2]) + (pairs[1] + pairs[3]) + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_stage_api::Seed;

    fn stream() -> StreamRng {
        Seed(3).stream("init")
    }

    /// The largest distance of the rows' scalar products from those of orthogonal rows of that length.
    fn worst(matrix: &[f32], rows: usize, cols: usize, gain: f64) -> f64 {
        // Of the rows, or of the columns where those are fewer.
        let short = rows.min(cols);
        let at = |short_at: usize, tall_at: usize| {
            let at = if rows < cols { short_at * cols + tall_at } else { tall_at * cols + short_at };
            f64::from(matrix[at])
        };
        let mut worst = 0.0_f64;
        for i in 0..short {
            for j in 0..=i {
                let product: f64 = (0..rows.max(cols)).map(|k| at(i, k) * at(j, k)).sum();
                let wanted = if i == j { gain * gain } else { 0.0 };
                worst = worst.max((product - wanted).abs());
            }
        }
        worst
    }

    #[test]
    fn rows_or_columns_are_orthogonal_and_have_the_gains_length() {
        for (rows, cols, gain) in
            [(6, 15, 2.0), (15, 6, 1.0), (4, 4, 1.0), (1, 1, 3.0), (1, 64, 0.01), (128, 128, 1.0)]
        {
            let matrix = orthogonal(rows, cols, gain, &mut stream());
            assert_eq!(matrix.len(), rows * cols);
            let worst = worst(&matrix, rows, cols, gain.into());
            assert!(worst < 1e-6 * f64::from(gain * gain), "{rows}x{cols}: {worst:e}");
        }
    }

    #[test]
    fn columns_that_are_nearly_parallel_come_out_orthogonal_too() {
        let tall = 40;
        let mut stream = stream();
        let mut columns: Vec<f64> = (0..tall * 6).map(|_| draw::normal(&mut stream)).collect();
        let (first, others) = columns.split_at_mut(tall);
        for column in others.chunks_exact_mut(tall) {
            for (value, first) in column.iter_mut().zip(&*first) {
                *value = first + 1e-9 * draw::normal(&mut stream);
            }
        }
        orthonormalize(&mut columns, tall);
        for i in 0..6 {
            for j in 0..=i {
                let product = dot(&columns[i * tall..][..tall], &columns[j * tall..][..tall]);
                let wanted = if i == j { 1.0 } else { 0.0 };
                assert!((product - wanted).abs() < 1e-14, "{i} {j}: {product:e}");
            }
        }
    }

    #[test]
    fn numbers_are_spread_as_those_of_a_uniformly_distributed_matrix() {
        // Each entry of a uniformly distributed unit vector of length n has mean 0 and variance 1/n; a decomposition
        // whose signs are not made positive has a first row of one sign.
        let (mut sum, mut squares, draws) = (0.0, 0.0, 2_000);
        let mut stream = stream();
        for _ in 0..draws {
            let first = f64::from(orthogonal(4, 4, 1.0, &mut stream)[0]);
            sum += first;
            squares += first * first;
        }
        let n = f64::from(draws);
        assert!((sum / n).abs() < 5.0 * (0.25 / n).sqrt(), "{}", sum / n);
        assert!((squares / n - 0.25).abs() < 0.025, "{}", squares / n);
    }

    #[test]
    fn every_bit_is_the_same_on_every_machine() {
        let mut hasher = blake3::Hasher::new();
        for (rows, cols) in [(64, 64), (13, 70), (100, 9)] {
            for value in orthogonal(rows, cols, 1.5, &mut stream()) {
                hasher.update(&value.to_le_bytes());
            }
        }
        assert_eq!(&hasher.finalize().to_hex()[..16], "0f835e08f4defca9");
    }
}
