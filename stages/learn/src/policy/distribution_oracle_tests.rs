//! Rows against libtorch's autograd in double precision.

use tch::{Kind, Tensor};

use super::*;
use crate::policy::oracle;

/// A case's numbers as leaves of libtorch's graph in double precision.
struct Leaves {
    leaves: Vec<Tensor>,
    samples: Tensor,
}

impl Leaves {
    fn new(case: &Case) -> Self {
        let rows = case.batch().len() as i64;
        let leaf = |values: &[f32], rows: i64| {
            Tensor::from_slice(values).to_kind(Kind::Double).view([rows, -1]).set_requires_grad(true)
        };
        let mut leaves = vec![leaf(&case.first, rows)];
        if !case.second.is_empty() {
            leaves.push(leaf(&case.second, rows));
        }
        if !case.shared.is_empty() {
            leaves.push(leaf(&case.shared, 1));
        }
        let samples = Tensor::from_slice(&case.samples).to_kind(Kind::Double).view([rows, -1]);
        Self { leaves, samples }
    }

    fn log_prob_and_entropy(&self, family: PolicyFamily) -> (Tensor, Tensor) {
        let (first, x) = (&self.leaves[0], &self.samples);
        match family {
            PolicyFamily::Gaussian => {
                let log_std = &self.leaves[1];
                (oracle::gaussian_log_prob(first, log_std, x), oracle::gaussian_entropy(first, log_std))
            }
            PolicyFamily::Beta => {
                let (alpha, beta) = (oracle::beta_shape(first), oracle::beta_shape(&self.leaves[1]));
                (oracle::beta_log_prob(&alpha, &beta, x), oracle::beta_entropy(&alpha, &beta))
            }
            PolicyFamily::Categorical => {
                (oracle::categorical_log_prob(first, x), oracle::categorical_entropy(first))
            }
        }
    }

    /// The cloning loss, summed over rows.
    fn cloning_loss(&self, family: PolicyFamily, demonstrated: &[f32]) -> Tensor {
        let first = &self.leaves[0];
        let rows = first.size()[0];
        let demonstrated = Tensor::from_slice(demonstrated).to_kind(Kind::Double).view([rows, -1]);
        let mean = match family {
            PolicyFamily::Gaussian => first.shallow_clone(),
            PolicyFamily::Beta => {
                let (alpha, beta) = (oracle::beta_shape(first), oracle::beta_shape(&self.leaves[1]));
                oracle::beta_mean(&alpha, &beta) * 2.0 - 1.0
            }
            PolicyFamily::Categorical => {
                return oracle::categorical_cross_entropy(first, &demonstrated) * rows as f64;
            }
        };
        oracle::action_loss(&mean, &demonstrated) * rows as f64
    }

    fn gradients(&self, objective: &Tensor) -> Vec<f64> {
        let leaves: Vec<&Tensor> = self.leaves.iter().collect();
        let gradients = Tensor::run_backward(&[objective], &leaves, false, false);
        let flat = leaves.iter().zip(gradients).map(|(leaf, gradient)| {
            // A leaf that the objective does not depend on has no gradient.
            if gradient.defined() { gradient } else { leaf.zeros_like() }.contiguous().view([-1])
        });
        flat.flat_map(|gradient| Vec::<f64>::try_from(gradient).unwrap()).collect()
    }
}

/// Equal but for the rounding to single precision of each addition.
fn assert_close(found: &[f64], wanted: &[f64], what: &str) {
    assert_eq!(found.len(), wanted.len());
    for (found, wanted) in found.iter().zip(wanted) {
        assert!((found - wanted).abs() < 3e-7 * (wanted.abs() + 0.01), "{what}: {found}, expected {wanted}");
    }
}

#[test]
fn values_and_gradients_equal_those_of_libtorch_in_double_precision() {
    for family in FAMILIES {
        for (seed, spread) in [(1, 0.5), (2, 3.0), (3, 15.0), (4, 300.0)] {
            // So wide a spread of logits leaves one choice only.
            let case = Case::random(family, 5, 3, spread, seed);
            let leaves = Leaves::new(&case);
            let (log_probs, entropies) = leaves.log_prob_and_entropy(family);
            let pairs = [(case.log_probs(), &log_probs), (case.entropies(), &entropies)];
            for (found, wanted) in pairs {
                let wanted = Vec::<f64>::try_from(wanted.detach().contiguous()).unwrap();
                for (found, wanted) in found.iter().zip(wanted) {
                    // Its softplus is the identity beyond 20.
                    let near = (found - wanted).abs() < 1e-7 * (1.0 + wanted.abs());
                    assert!(near, "{family:?} {spread}: {found}, expected {wanted}");
                }
            }
            let weights = random_weights(5, &mut Seed(seed).stream("weights"));
            let row = |values: Vec<f64>| Tensor::from_slice(&values);
            let objective = (log_probs * row(weights.iter().map(|w| w.log_prob).collect())
                + entropies * row(weights.iter().map(|w| w.entropy).collect()))
            .sum(Kind::Double);
            let found = case.gradient_of_objective(&weights).all();
            assert_close(&found, &leaves.gradients(&objective), &format!("{family:?} {spread}"));
        }
    }
}

#[test]
fn cloning_equals_that_of_libtorch_in_double_precision() {
    for family in FAMILIES {
        // Many predictions of the Gaussian are saturated, one lies on the corner, where there is a gradient.
        let mut case = Case::random(family, 4, 3, 2.0, 9);
        case.first[0] = 1.0;
        let demonstrated: Vec<f32> = match family {
            PolicyFamily::Categorical => vec![2.0, 0.0, 1.0, 1.0],
            PolicyFamily::Gaussian | PolicyFamily::Beta => (0..12).map(|at| at as f32 * 0.3 - 1.6).collect(),
        };
        let leaves = Leaves::new(&case);
        let loss = leaves.cloning_loss(family, &demonstrated);
        let (found, wanted) = (case.cloning_loss(&demonstrated), loss.double_value(&[]));
        assert!((found - wanted).abs() < 1e-12 * (1.0 + wanted), "{family:?}: {found}, expected {wanted}");
        let found = case.gradient_of_cloning(&demonstrated).all();
        assert_close(&found, &leaves.gradients(&loss), &format!("{family:?}"));
    }
}
