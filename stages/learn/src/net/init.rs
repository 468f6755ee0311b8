//! How weights begin. Every number comes from a stream of the stage's seed: torch's own generator is global state, and
//! what reaches a result must not depend on it.

use dril_stage_api::StreamRng;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use tch::{Kind, Tensor};

/// The distribution that a parameter's first values are drawn from.
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
    pub(crate) fn draw(self, shape: &[i64], stream: &mut StreamRng) -> Vec<f32> {
        let count = shape.iter().product::<i64>() as usize;
        match self {
            Self::Constant(value) => vec![value; count],
            Self::FanIn(fan_in) => {
                let bound = 1.0 / (fan_in.max(1) as f32).sqrt();
                (0..count).map(|_| (2.0 * stream.random::<f32>() - 1.0) * bound).collect()
            }
            Self::Orthogonal(gain) => orthogonal(shape, gain, stream),
        }
    }
}

/// Q of the QR decomposition of a normal matrix, with the signs of R's diagonal so that it is uniformly distributed
/// (Mezzadri 2007).
fn orthogonal(shape: &[i64], gain: f32, stream: &mut StreamRng) -> Vec<f32> {
    let rows = shape[0];
    let cols = shape[1..].iter().product::<i64>();
    let (tall, short) = (rows.max(cols), rows.min(cols));
    let normals: Vec<f32> = (0..tall * short).map(|_| StandardNormal.sample(stream)).collect();
    let (q, r) = Tensor::linalg_qr(&Tensor::from_slice(&normals).view([tall, short]), "reduced");
    let signed = q * r.diagonal(0, 0, 1).sign();
    let matrix = if rows < cols { signed.transpose(0, 1) } else { signed };
    let matrix = (matrix * f64::from(gain)).contiguous().to_kind(Kind::Float);
    crate::fast::memory::values(&matrix).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_stage_api::Seed;

    #[test]
    fn an_orthogonal_matrix_has_orthogonal_rows_or_columns_of_the_gains_length() {
        crate::fast::prepare();
        for shape in [[6_i64, 15], [15, 6], [4, 4]] {
            let values = Init::Orthogonal(2.0).draw(&shape, &mut Seed(3).stream("init"));
            let matrix = Tensor::from_slice(&values).view(shape);
            let gram = if shape[0] <= shape[1] { matrix.mm(&matrix.tr()) } else { matrix.tr().mm(&matrix) };
            let size = shape[0].min(shape[1]);
            let wanted = Tensor::eye(size, (Kind::Float, tch::Device::Cpu)) * 4.0;
            assert!((gram - wanted).abs().max().double_value(&[]) < 1e-5, "{shape:?}");
        }
    }

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
