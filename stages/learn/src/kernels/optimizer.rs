//! The optimizer's inner loop (Adam, and RMSprop as a special case), and the sum of squares for gradient norms.
//!
//! One pass over memory: torch's optimizer makes one for each of a dozen operations and takes 4 to 10 ms for 2.2 million
//! parameters, where this takes about 1 ms. Every operation is elementwise and rounded separately (none is fused), so the
//! order of operations is that of the formulas in [`step`].

use super::vector::{Kernel, LANES, Simd, lanes, lanes_mut, load_some, run, store_some};

/// The coefficients of one step, the same for all parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Factor on the gradient (the clip of the global norm).
    pub scale: f32,
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// Learning rate over the first moment's bias correction.
    pub rate: f32,
    /// One over the root of the second moment's bias correction.
    pub root: f32,
    /// Added to the denominator.
    pub epsilon: f32,
}

/// One step for one parameter: `value`, first moment `m`, second moment `v` and gradient are equally long.
///
/// With g = gradient · scale: m ← beta1 · m + (1 − beta1) · g, v ← beta2 · v + (1 − beta2) · g²,
/// value ← value − rate · m / (√v · root + epsilon).
pub fn step(value: &mut [f32], m: &mut [f32], v: &mut [f32], gradient: &[f32], with: Step) {
    run(Steps { value, m, v, gradient, with });
}

struct Steps<'a> {
    value: &'a mut [f32],
    m: &'a mut [f32],
    v: &'a mut [f32],
    gradient: &'a [f32],
    with: Step,
}

impl Kernel for Steps<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { value, m, v, gradient, with } = self;
        let chunks = value.chunks_mut(LANES).zip(m.chunks_mut(LANES)).zip(v.chunks_mut(LANES));
        for (((value, m), v), gradient) in chunks.zip(gradient.chunks(LANES)) {
            let read = |numbers: &[f32]| load_some(simd, numbers);
            let numbers = moved(simd, [read(value), read(m), read(v), read(gradient)], with);
            store_some(simd, numbers[0], value);
            store_some(simd, numbers[1], m);
            store_some(simd, numbers[2], v);
        }
    }
}

/// Value, first and second moment after a step.
#[inline(always)]
fn moved<S: Simd>(simd: S, [value, m, v, gradient]: [S::V; 4], with: Step) -> [S::V; 3] {
    let times = |factor: f32, vector| simd.mul(simd.splat(factor), vector);
    let g = times(with.scale, gradient);
    let m = simd.add(times(with.beta1, m), times(1.0 - with.beta1, g));
    let v = simd.add(times(with.beta2, v), times(1.0 - with.beta2, simd.mul(g, g)));
    let below = simd.add(times(with.root, simd.sqrt(v)), simd.splat(with.epsilon));
    [simd.sub(value, simd.div(times(with.rate, m), below)), m, v]
}

/// The sum of squares. Within blocks of 4096 numbers, 64 interleaved sums are accumulated in single precision by fused
/// multiply-adds (number i of a block in sum i mod 64); these are then added in double precision, in order.
pub fn sum_of_squares(values: &[f32]) -> f64 {
    let mut total = 0.0;
    run(Squares { values, total: &mut total });
    total
}

/// Number of accumulator vectors: enough to keep the multipliers busy.
const SUMS: usize = 4;

struct Squares<'a> {
    values: &'a [f32],
    total: &'a mut f64,
}

impl Kernel for Squares<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for block in self.values.chunks(4096) {
            let mut sums = [simd.splat(0.0); SUMS];
            let rows = block.chunks_exact(SUMS * LANES);
            let rest = rows.remainder();
            for row in rows {
                for at in 0..SUMS {
                    let numbers = simd.load(lanes(&row[at * LANES..]));
                    sums[at] = simd.mul_add(numbers, numbers, sums[at]);
                }
            }
            for (at, numbers) in rest.chunks(LANES).enumerate() {
                let numbers = load_some(simd, numbers);
                sums[at] = simd.mul_add(numbers, numbers, sums[at]);
            }
            let mut numbers = [0.0; SUMS * LANES];
            for at in 0..SUMS {
                simd.store(sums[at], lanes_mut(&mut numbers[at * LANES..]));
            }
            *self.total += numbers.iter().map(|&number| f64::from(number)).sum::<f64>();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sum_of_squares_is_the_sum_of_squares() {
        let values: Vec<f32> = (0..10_001).map(|at| at as f32 / 1000.0).collect();
        let wanted: f64 = values.iter().map(|&v| f64::from(v).powi(2)).sum();
        assert!((sum_of_squares(&values) / wanted - 1.0).abs() < 1e-6);
        assert_eq!(sum_of_squares(&[]), 0.0);
    }

    #[test]
    fn a_step_is_that_of_the_formulas() {
        let with = Step { scale: 0.5, beta1: 0.9, beta2: 0.99, rate: 0.1, root: 2.0, epsilon: 1e-3 };
        let (mut value, mut m, mut v) = ([1.0, -1.0], [0.25, 0.0], [0.5, 0.0]);
        step(&mut value, &mut m, &mut v, &[4.0, -2.0], with);
        let wanted = |value: f64, m: f64, v: f64, g: f64| {
            let (m, v) = (0.9 * m + 0.1 * g, 0.99 * v + 0.01 * g * g);
            [value - 0.1 * m / (v.sqrt() * 2.0 + 1e-3), m, v]
        };
        let wanted = [wanted(1.0, 0.25, 0.5, 2.0), wanted(-1.0, 0.0, 0.0, -1.0)];
        for (at, wanted) in wanted.iter().enumerate() {
            for (found, wanted) in [value[at], m[at], v[at]].iter().zip(wanted) {
                assert!((f64::from(*found) - wanted).abs() < 1e-6, "{found} is not {wanted}");
            }
        }
    }
}
