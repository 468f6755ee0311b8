//! Initial weights. Every number is drawn from a stream of the stage's seed.

use dril_stage_api::StreamRng;
use rand::RngExt;

use super::orthogonal::orthogonal;

/// The distribution of a parameter's initial values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Init {
    /// All equal.
    Constant(f32),
    /// Uniform in ±1/√fan_in: what PyTorch's `Linear` and `Conv2d` do by default, for weights and biases alike
    /// (Kaiming-uniform with a = √5).
    FanIn(usize),
    /// A matrix (first dimension × the rest) with orthonormal rows or columns, times the gain (Saxe et al. 2014).
    Orthogonal(f32),
}

impl Init {
    /// Draws the values of a parameter of that shape, row-major.
    pub(crate) fn draw(self, shape: &[usize], stream: &mut StreamRng) -> Vec<f32> {
        let count = shape.iter().product::<usize>();
        match self {
            Self::Constant(value) => vec![value; count],
            Self::FanIn(fan_in) => {
                let bound = 1.0 / (fan_in.max(1) as f32).sqrt();
                (0..count).map(|_| (2.0 * stream.random::<f32>() - 1.0) * bound).collect()
            }
            Self::Orthogonal(gain) => orthogonal(shape[0], shape[1..].iter().product(), gain, stream),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_stage_api::Seed;

    #[test]
    fn fan_in_values_fill_their_interval_and_equal_streams_give_equal_values() {
        let draw = |seed| Init::FanIn(25).draw(&[100, 25], &mut Seed(seed).stream("init"));
        let values = draw(1);
        let (low, high) = values.iter().fold((0.0_f32, 0.0_f32), |(l, h), &v| (l.min(v), h.max(v)));
        assert!((-0.2..-0.19).contains(&low) && (0.19..=0.2).contains(&high), "{low} {high}");
        assert_eq!(values, draw(1));
        assert_ne!(values, draw(2));
    }
}
